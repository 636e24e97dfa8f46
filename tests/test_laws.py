"""Does what was taken for random follow motion and commands? The score test of unknown laws."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from marks import slow
from motion import small
from steered_ship import LEVEL, NOISE, PERIOD, TIME, WIDTH, YAW, Share, nothing, sailed

from benchmarks.truth import gauss_markov
from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.evidence.improve import improve
from oed_sysid.likelihood import laws as laws_module
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.laws import IN_THE_RUN, Law, laws, unresolved
from oed_sysid.likelihood.noise_model import Levels, NoiseModel, Sea


def asked(seed: int, answer: float, law: Share) -> tuple[Law, ...]:
    """Laws at the true values and levels, of two records."""
    data = Dataset(sailed(2 * seed + k, answer, law) for k in (0, 1))
    force = np.array([LEVEL])
    noise = NoiseModel(
        np.full(2, NOISE), np.zeros(2), force, TIME, TIME, ("psi", "r"), ("force r",)
    )
    problem = Filtered(YAW, data, Levels.of(noise, noise).held())
    found = laws(problem, problem.point([np.zeros(2)] * 2).unknowns)
    assert found is not None
    return found


@pytest.mark.parametrize("answer", [0.3, *slow(0.0)])
def test_the_statistic_of_a_true_disturbance_is_chi_squared(
    answer: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also where a helmsman answers it: mean and variance over 24 seas, by those of chance."""
    monkeypatch.setattr(laws_module, "RARE", 1.0)
    monkeypatch.setattr(laws_module, "CHUNK", 4)
    found = [law for seed in range(24) for law in asked(seed, answer, nothing)]
    assert len(found) == 24
    freedom = np.array([law.freedom for law in found])
    away = (np.array([law.statistic for law in found]) - freedom) / np.sqrt(2.0 * freedom)
    assert abs(away.mean()) < 4 / np.sqrt(24)
    assert 0.6 < away.std() < 1.4


def adrift(
    seed: int, law: Callable[[float, float], float] = lambda command, into: 0.0, runs_of: str = "ab"
) -> Dataset:
    """Two records of three speeds under forces that last a while, and of what they add up to.

    The first force is also a law of the command and of the part of the run.
    """
    rng, runs = np.random.default_rng(seed), []
    damping, step, n = np.array([0.14, 0.13, 0.1]), 0.4, 300
    memory = np.exp(-step / TIME)
    decay = np.exp(-damping * step)
    reach = (1.0 - decay) / damping  # of a force that is held for a step
    for name in runs_of:
        speed, place, force = np.zeros((3, 3))
        force = LEVEL * rng.standard_normal(3)
        command, rows = np.repeat(rng.uniform(-1.0, 1.0, 10), n // 10), []
        for k, one in enumerate(command):
            rows.append([*speed, *place])
            pushed = 0.1 * one + force + law(one, k / n) * np.array([1.0, 0.0, 0.0])
            place = place + speed * reach + pushed * (step - reach) / damping
            speed = speed * decay + pushed * reach
            force = memory * force + np.sqrt(1.0 - memory**2) * LEVEL * rng.standard_normal(3)
        seen = np.array(rows) + NOISE * rng.standard_normal((n, 6))
        runs.append(Record(name, np.arange(n) * step, command, seen, ADRIFT.channels))
    return Dataset(runs)


ADRIFT = Model(
    "adrift",
    (*(State(f"v{i}", "m/s") for i in range(3)), *(State(f"x{i}", "m") for i in range(3))),
    (Input("u", "1"),),
    tuple(Output(name, "m", NOISE) for name in ("v0", "v1", "v2", "x0", "x1", "x2")),
    {
        **{f"v{i}": f"b{i}*u - {d}*v{i}" for i, d in enumerate((0.14, 0.13, 0.1))},
        **{f"x{i}": f"v{i}" for i in range(3)},
    },
    parameters=tuple(Parameter(f"b{i}", 0.1, "m/s^2") for i in range(3)),
)
DRIFTS = tuple(f"force v{i}" for i in range(3))


@pytest.mark.slow
def test_motion_that_wanders_makes_no_law(monkeypatch: pytest.MonkeyPatch) -> None:
    """Positions without springs make the statistic a third too large; what is drawn tells that."""
    monkeypatch.setattr(laws_module, "RARE", 3.0)  # one for each of three places
    monkeypatch.setattr(laws_module, "CHUNK", 4)
    noise = NoiseModel(
        np.full(6, NOISE), np.zeros(6), np.full(3, LEVEL), TIME, TIME, ADRIFT.output_names, DRIFTS
    )
    away: dict[str, list[float]] = {"plain": [], "corrected": []}
    for way, usual in (("plain", lambda *_: {}), ("corrected", laws_module._End.usual)):
        monkeypatch.setattr(laws_module._End, "usual", usual)
        for seed in range(8):
            problem = Filtered(ADRIFT, adrift(seed), Levels.of(noise, noise).held())
            found = laws(problem, problem.point([np.zeros(6)] * 2).unknowns)
            assert found is not None
            away[way] += [(one.statistic - one.freedom) / np.sqrt(2 * one.freedom) for one in found]
    assert len(away["plain"]) == 24
    assert abs(np.mean(away["corrected"])) < 4 / np.sqrt(24)
    assert np.mean(away["plain"]) > 4 / np.sqrt(24)


@pytest.mark.parametrize(
    ("law", "signal"),
    [
        (lambda command, into: 0.045 * (abs(command) - 0.5), "u"),
        *slow((lambda command, into: 0.04 * (into >= 0.5), f"{IN_THE_RUN}, a step at 59.8 s")),
    ],
)
def test_a_law_of_one_signal_is_not_lost_among_many(
    law: Callable[[float, float], float], signal: str
) -> None:
    """A kink of the command and a jump at half time, among some hundred functions."""
    noise = NoiseModel(
        np.full(6, NOISE), np.zeros(6), np.full(3, LEVEL), TIME, TIME, ADRIFT.output_names, DRIFTS
    )

    def told(data: Dataset) -> tuple[Law, ...]:
        problem = Filtered(ADRIFT, data, Levels.of(noise, noise).held())
        return laws(problem, problem.point([np.zeros(6)] * len(data)).unknowns) or ()

    (found,) = told(adrift(1, law))
    assert (found.place, found.signals) == ("force v0", (signal,))
    assert found.statistic > 1.5 * found.needed
    assert found.freedom < 15
    # In a single record a jump is an innovation of the force like others.
    single = told(adrift(1, law, "a"))
    assert not any(IN_THE_RUN in name for one in single for name in one.signals)
    assert not told(adrift(1))


@pytest.mark.parametrize("answer", [0.3, *slow(0.0)])
@pytest.mark.parametrize(
    ("law", "signal"),
    [
        (lambda r, psi, lagged: -60.0 * r * abs(r), "r"),
        (lambda r, psi, lagged: 0.6 * lagged, "delta"),
        (lambda r, psi, lagged: -0.04 * np.tanh(20.0 * (psi - 0.2)), "psi"),
    ],
)
def test_a_law_is_found_by_its_signal(law: Share, signal: str, answer: float) -> None:
    """Drag, a lagged answer to the command, a wall: with and without feedback."""
    for seed in (1, 2):
        (found,) = asked(seed, answer, law)
        assert found.place == "force r"
        assert signal in found.signals
        assert found.statistic > found.needed


@pytest.mark.parametrize("shape", ["displacement", *slow("velocity")])
def test_a_law_is_told_from_a_sea(shape: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """The score of a true sea of either shape is that of chance; a wall beside one is found."""

    def wall(r: float, psi: float, lagged: float) -> float:
        return -0.04 * np.tanh(20.0 * (psi - 0.2))

    sea = Sea(PERIOD, WIDTH, {"force r": LEVEL}, shape)
    noise = NoiseModel(
        np.full(2, NOISE), np.zeros(2), np.zeros(0), 1.0, 1.0, ("psi", "r"), (), seas=(sea,)
    )

    def found(seed: int, law: Share) -> Law:
        runs = tuple(sailed(2 * seed + k, 0.3, law, shape=shape) for k in (0, 1))
        problem = Filtered(YAW, Dataset(runs), Levels.of(noise, noise, seas=noise.seas).held())
        (told,) = laws(problem, problem.point([np.zeros(2)] * 2).unknowns) or ()
        return told

    if shape == "displacement":  # with power where a wall acts
        beside = found(1, wall)
        assert beside.statistic > beside.needed
    monkeypatch.setattr(laws_module, "RARE", 1.0)
    monkeypatch.setattr(laws_module, "CHUNK", 4)
    away = [(one.statistic - one.freedom) / np.sqrt(2.0 * one.freedom)
            for one in (found(seed, nothing) for seed in range(12))]  # fmt: skip
    assert abs(np.mean(away)) < 4 / np.sqrt(12)


def test_slow_noise_of_a_sensor_that_follows_the_motion() -> None:
    """A rate that reads too much at large headings, where nothing disturbs the vehicle."""
    quiet = YAW.with_values({})
    found = {}
    for name, drift in {"law": lambda r, psi, lagged: 0.3 * psi**2, "none": None}.items():
        rng = np.random.default_rng(5)
        runs = []
        for seed in (3, 4):
            run = sailed(seed, 0.5, nothing, drift=drift, level=0.0)
            slow = 0.0064 * gauss_markov(rng.standard_normal(run.n_samples), 0.95)
            runs.append(run.with_outputs(run.outputs + slow[:, None] * [0.0, 1.0]))
        noise = NoiseModel(
            np.full(2, NOISE), np.array([0.0, 0.01]), np.zeros(0), TIME, TIME, ("psi", "r"), ()
        )
        problem = Filtered(quiet, Dataset(runs), Levels.of(noise, noise).held())
        found[name] = laws(problem, problem.point([np.zeros(2)] * 2).unknowns)
    assert [law.place for law in found["law"] or ()] == ["noise of r"]


def ferry(seed: int, acts: Callable[[float], float], least: float = 0.3, n: int = 400) -> Record:
    """Speed under ordered thrust, of which a share acts that depends on the part of the run.

    Exact steps of a linear drag.
    """
    rng, step, u, rows = np.random.default_rng(seed), 0.5, 0.0, []
    order = np.repeat(rng.uniform(least, 1.0, 20), n // 20)
    for k, one in enumerate(order):
        rows.append(u + 0.01 * rng.standard_normal())
        u += (one * acts(k / n) - u) * -np.expm1(-step / 8.0)
    return Record(f"{seed}", step * np.arange(n), order[:, None], np.array(rows), FERRY.channels)


def whole(into: float) -> float:
    """All of the thrust acts, all the time."""
    return 1.0


def fading(into: float) -> float:
    """Thrust that fades by 15 % over the run."""
    return 1.0 - 0.15 * into


def failing(into: float) -> float:
    """Thrust that fails for a tenth of the run."""
    return float(not 0.26 < into < 0.37)


VALUES = [Parameter("k", 0.9, "m"), Parameter("T", 7.0, "s", lower=0.5)]
FERRY = small("ferry", "u [m/s] <- n [rad/s]", {"u": "(k*n - u)/T"}, VALUES, step=0.5)


def test_what_fades_follows_the_time_in_the_run() -> None:
    """The remark names time, and a fading gain is among usual candidates and is found."""
    train, validation = (Dataset(ferry(s, fading) for s in seeds) for seeds in ((1, 2, 3), (4,)))
    follows = MultipleShooting().fit(FERRY, train).whole_runs.follows
    assert follows
    assert IN_THE_RUN in follows[0].signals
    assert follows[0].text.startswith(f"force u follows {' and '.join(follows[0].signals)} (score")
    found = improve(FERRY, train, validation)
    assert [step.added for step in found.steps if step.added] == ["n_fading"]
    size, error = (of["E_n_fading"] for of in (found.fit.values, found.fit.std_errors))
    assert abs(size + 0.15 / 200.0) < 4.0 * error
    right = Dataset((ferry(5, whole), ferry(6, whole)))
    calm = MultipleShooting(disturbances="all").fit(FERRY, right)
    assert not calm.whole_runs.follows


@pytest.mark.parametrize("seed", [0, *slow(10)])
def test_what_fails_for_some_time_follows_the_time_in_the_run(seed: int) -> None:
    """A command ahead and astern that does nothing for a tenth of each run is no disturbance."""
    runs = Dataset(ferry(seed + k, failing, -1.0) for k in (1, 2))
    fit = MultipleShooting().fit(FERRY, runs)
    assert fit.noise.has_forces
    (law,) = fit.whole_runs.follows
    assert IN_THE_RUN in law.signals
    assert law.statistic > 60.0


def test_waves_too_fast_for_the_samples_are_not_asked() -> None:
    """A heading every 5 s does not show whether a rudder leads or answers waves of 4.5 s."""
    record = sailed(1, 0.3, nothing, shape="velocity")
    sparse = np.where(np.arange(len(record.times))[:, None] % 25, np.nan, record.outputs)
    sparse[:, 1] = np.nan
    for period, outputs, said in (
        (4.5, sparse, True),
        (12.0, sparse, False),
        (4.5, record.outputs, False),
    ):
        noise = NoiseModel.white_only(np.full(2, NOISE), ("psi", "r"))
        noise = replace(noise, seas=(Sea(period, bandwidth=0.3, levels={"force r": LEVEL}),))
        assert bool(unresolved(YAW, [record.with_outputs(outputs)], noise)) is said
        # Where the law is not asked, it is not denied, and whole runs are not asked either.
        problem = Filtered(
            YAW, Dataset((record.with_outputs(outputs),)), Levels.of(noise, noise).held()
        )
        asked_of = laws(problem, problem.point([np.zeros(2)]).unknowns)
        assert (asked_of is None) is said


@pytest.mark.slow
def test_a_fit_says_that_its_process_noise_follows_motion() -> None:
    """It has taken the work of a wall that the model lacks, and not that of nothing."""

    def wall(r: float, psi: float, lagged: float) -> float:
        return -0.04 * np.tanh(20.0 * (psi - 0.2))

    missing, true = (Dataset(sailed(k, 0.0, law) for k in (0, 1)) for law in (wall, nothing))
    fit = MultipleShooting().fit(YAW, missing)
    assert fit.noise.has_forces
    (law,) = fit.whole_runs.follows
    assert "psi" in law.signals
    assert fit.whole_runs.took_the_work
    right = MultipleShooting().fit(YAW, true)
    assert right.noise.has_forces
    assert not right.whole_runs.said
