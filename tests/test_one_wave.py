"""One wave in several equations: a vehicle that rolls and pitches, by a simulator of its own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from marks import slow
from motion import small
from scipy.signal import hilbert

from benchmarks.truth import gauss_markov, runge_kutta
from oed_sysid import Dataset, Fit, MultipleShooting, NoiseModel, Record, Sea
from oed_sysid.compiled.filtering import FIRST_PAIR, FOURTH, SEA_PHASE, SECOND_PAIR, rates
from oed_sysid.errors import ModelError
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.realisation import forces_of_sea

PERIOD = 8.0
TRUE = {"Kp": 0.30, "Kb": 0.3, "Kd": 0.5, "Mq": 0.8, "Mb": 2.0, "Md": 0.8}
# Standard deviations of the accelerations by waves, and by how much that in pitch is behind, rad.
PUSH, BEHIND = np.array([0.05, 0.08]), 1.4
# The same of runs against the swell and with it, and over which factor of its own frequency each
# wave is met: 2.5 m/s in deep water.
HEADINGS = {
    "head": (np.array([0.02, 0.09]), 1.5, lambda w: w + 2.5 * w**2 / 9.81),
    "following": (np.array([0.03, 0.07]), -1.8, lambda w: w - 2.5 * w**2 / 9.81),
}
UNITS = ("1/s", "1/s^2", "1/s^2")
RATES = {"phi": "p", "theta": "q", "p": "-Kp*p - Kb*phi + Kd*da", "q": "-Mq*q - Mb*theta + Md*de"}
NOISE = {"p": 4e-3, "q": 4e-3, "phi": 3e-3, "theta": 3e-3}
MODEL = small(
    "rolls and pitches",
    "p [rad/s], q [rad/s], phi [rad], theta [rad] <- da [rad], de [rad]",
    RATES,
    {f"{name} [{unit}]": 1.2 * TRUE[name] for name, unit in zip(TRUE, 2 * UNITS, strict=True)},
    NOISE,
    scales=dict.fromkeys(NOISE, 0.1),
    step=0.25,
)


def elevation(rng: np.random.Generator) -> np.ndarray:
    """Frequency, rad/s, amplitude and phase of eighty cosines of a JONSWAP spectrum, ``(3, 80)``.

    Hasselmann et al. (1973), peakedness 3.3; of a standard deviation of one.
    """
    peak = 2 * np.pi / PERIOD
    w = np.linspace(0.5, 2.5, 80) * peak + rng.uniform(-0.01, 0.01, 80)
    width = np.where(w < peak, 0.07, 0.09)
    power = w**-5.0 * np.exp(-1.25 * (peak / w) ** 4)
    power *= 3.3 ** np.exp(-((w - peak) ** 2) / (2 * width**2 * peak**2))
    return np.array([w, np.sqrt(2 * power / power.sum()), rng.uniform(0, 2 * np.pi, 80)])


def recorded(
    name: str,
    rng: np.random.Generator,
    halves: tuple[float, float],
    seas: Sequence[np.ndarray],
    push: np.ndarray = PUSH,
    behind: float = BEHIND,
    gusts: float = 0.0,
) -> Record:
    """One run with fins in squares of some half periods, an elevation of waves for each axis.

    Gusts besides have a share of their standard deviation, and times of 3 and 1 s.
    """
    times = 0.25 * np.arange(480)
    fins = np.column_stack([np.where(times // half % 2 < 1, 0.2, -0.2) for half in halves])
    # At the start, the middle and the end of each step.
    at = times[:, None, None] + np.array([[0.0], [0.125], [0.25]])
    waves = [
        np.cos(w * at + start - late) @ size
        for (w, size, start), late in zip(seas, (0.0, behind), strict=True)
    ]
    pushes = push * np.stack(waves, axis=-1)
    if gusts:
        drawn = rng.standard_normal((len(times), 2))
        kept = np.exp(-0.25 / np.array([3.0, 1.0]))
        blown = [gauss_markov(*one) for one in zip(drawn.T, kept, strict=True)]
        pushes += gusts * push * np.stack(blown, axis=-1)[:, None]

    def slope(x: np.ndarray, part: int, k: int) -> np.ndarray:
        p, q, phi, theta = x
        roll = -TRUE["Kp"] * p - TRUE["Kb"] * phi + TRUE["Kd"] * fins[k, 0]
        pitch = -TRUE["Mq"] * q - TRUE["Mb"] * theta + TRUE["Md"] * fins[k, 1]
        return np.array([roll + pushes[k, part, 0], pitch + pushes[k, part, 1], p, q])

    state, states = np.zeros(4), []
    for k in range(len(times)):
        states.append(state)
        state = runge_kutta(slope, state, 0.25, k)
    noise = [4e-3, 4e-3, 3e-3, 3e-3] * rng.standard_normal((len(times), 4))
    return Record(name, times, fins, states + noise, MODEL.channels)


@cache
def records(seed: int, *, one_wave: bool) -> Dataset:
    """Two runs in waves of one elevation, or of one for each axis."""
    rng, found = np.random.default_rng(seed), []
    for run, halves in enumerate(((11.0, 7.0), (5.0, 9.0))):
        seas = [elevation(rng)] * 2 if one_wave else [elevation(rng), elevation(rng)]
        found.append(recorded(f"run {run}", rng, halves, seas))
    return Dataset(found)


@cache
def on_headings(seed: int) -> Fit:
    """The default fit of two runs on reciprocal headings in one long-crested swell."""
    rng, found = np.random.default_rng(seed), []
    halves = ((11.0, 7.0), (5.0, 9.0))
    for (name, (push, behind, met)), half in zip(HEADINGS.items(), halves, strict=True):
        w, size, start = elevation(rng)
        found.append(recorded(name, rng, half, [np.array([met(w), size, start])] * 2, push, behind))
    return MultipleShooting().fit(MODEL, Dataset(found))


@cache
def fitted(seed: int, *, one_wave: bool) -> Fit:
    """The default fit."""
    return MultipleShooting().fit(MODEL, records(seed, one_wave=one_wave))


def in_gusts(seed: int, waves: float) -> Fit:
    """The default fit of two runs in gusts of two times, 0.64 of the standard push, and waves."""
    rng, found = np.random.default_rng(seed), []
    for run, halves in enumerate(((11.0, 7.0), (5.0, 9.0))):
        w, size, start = elevation(rng)
        seas = [np.array([w, waves * size, start])] * 2
        found.append(recorded(f"run {run}", rng, halves, seas, gusts=0.64))
    return MultipleShooting().fit(MODEL, Dataset(found))


def assert_right(fit: Fit) -> None:
    """Every parameter is within three of its standard errors."""
    for name, value in TRUE.items():
        assert abs(fit.values[name] - value) < 3.0 * fit.std_errors[name], name


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3, 4, 5])
def test_waves_are_told_beside_gusts(seed: int) -> None:
    """Waves alone explain no more than forces of first order; both together do far more."""
    fit = in_gusts(seed, 0.8)
    (sea,) = fit.noise.seas
    assert sea.period == pytest.approx(PERIOD, rel=0.15)
    assert sea.level == pytest.approx(0.8 * PUSH, rel=0.3)
    assert sea.shape == "jonswap"
    assert sea.phases is not None
    assert fit.noise.force == pytest.approx(0.64 * PUSH, rel=0.4)
    assert_right(fit)


@pytest.mark.parametrize("seed", [7, *slow(1, 2)])
def test_gusts_of_two_times_have_two(seed: int) -> None:
    """No sea is taken for them; of seed 7 the times gain less than what is claimed costs."""
    fit = in_gusts(seed, 0.0)
    assert not fit.noise.seas
    assert fit.noise.force_time == pytest.approx([3.0, 1.0], rel=0.4)
    assert fit.noise.force == pytest.approx(0.64 * PUSH, rel=0.3)
    assert_right(fit)


def test_records_on_reciprocal_headings_have_seas_of_their_own() -> None:
    """Period of encounter, levels and phase are those of each heading, and values hold."""
    fit = on_headings(1)
    assert [sea.records for sea in fit.noise.seas] == [("head",), ("following",)]
    for sea, (push, behind, met) in zip(fit.noise.seas, HEADINGS.values(), strict=True):
        assert sea.period == pytest.approx(2 * np.pi / met(2 * np.pi / PERIOD), rel=0.1)
        assert sea.level == pytest.approx(push, rel=0.4)
        first, second = (sea.phases or {}).values()
        assert np.exp(1j * (second - first)) == pytest.approx(np.exp(1j * behind), abs=0.1)
    for name, value in TRUE.items():
        assert abs(fit.values[name] - value) < 3.0 * fit.std_errors[name], name
        assert fit.std_errors[name] < 0.02 * value, name
    assert "forces on following have a period" in str(fit.report())
    assert {"sea 1 period", "sea 2 force q phase"} <= set(fit.noise_std)


def test_levels_of_seas_of_records_have_exact_slopes() -> None:
    """Slopes of the likelihood by every level are its differences; none tells of the other run."""
    problem, unknowns = posed_again(on_headings(1), levels=True)
    passes = problem.passes(unknowns)
    _, right = problem.gathered(unknowns, passes)
    block = problem.layout.levels
    for at, (kind, _) in enumerate(problem.levels.entries, start=block.start):
        ends = []
        step = 1e-4 if kind == SEA_PHASE else 1e-4 * max(abs(unknowns[at]), 1e-3)
        for way in (1, -1):
            moved = unknowns.copy()
            moved[at] += way * step
            ends.append(0.5 * sum(part.objective for part in problem.passes(moved, columns=False)))
        slope = (ends[0] - ends[1]) / (2 * step)
        assert -right[at] == pytest.approx(slope, rel=1e-3, abs=1e-3 / step * 1e-4), at
    told = np.array([part.level_slope != 0 for part in passes])
    of_sea = [name.startswith("sea ") for name in problem.levels.names]
    assert not told[:, of_sea].all(axis=0).any()
    assert told[:, of_sea].any(axis=0).all()


def test_noise_of_seas_of_records_on_others_is_their_mean() -> None:
    """A record meets its own sea; one that no sea knows, one of the mean of all."""
    seas = tuple(
        Sea(period, 0.2, {"K": level}, records=(name,))
        for name, period, level in (("a", 6.0, 3.0), ("b", 1.5, 4.0))
    )
    noise = replace(NoiseModel.white_only(np.array([0.1])), seas=seas)
    assert noise.on("b").seas == seas[1:]
    assert noise.on("a", "b").seas == seas
    (other,) = noise.on("c").seas
    assert other.records == ("c",)
    assert other.period == pytest.approx(3.0)
    assert other.level == pytest.approx([np.sqrt(12.5)])
    assert Sea.from_dict(seas[0].to_dict()) == seas[0]


@pytest.mark.parametrize("damping", [0.05, 0.15, 0.3])
def test_both_parts_of_a_wave_are_a_quarter_apart_and_alike(damping: float) -> None:
    """Their spectra from the rates: phase exact, amplitudes as the equation of the module says."""
    a, together = rates(FOURTH, damping)
    spread = -(a + a.T)  # of the noise, which enters one equation
    drive = spread[:, np.argmax(np.diag(spread))]

    def behind(w: float) -> complex:
        one, other = together @ np.linalg.solve(1j * w * np.eye(4) - a, drive)
        return complex(other / one)

    middle = np.sqrt(FIRST_PAIR * SECOND_PAIR)
    assert np.linalg.norm(together, axis=1) == pytest.approx([1.0, 1.0])
    assert np.angle(behind(middle)) == pytest.approx(-np.pi / 2, abs=1e-9)
    for r in (0.4, 0.7, 0.9, 1.2, 2.0):
        expected = (3 * r + r**3) / (1 + 3 * r**2)
        assert behind(r * middle) / behind(middle) == pytest.approx(expected, rel=1e-9)


def test_one_wave_in_two_equations_is_named_with_its_phase() -> None:
    """Period and phase are those of the sea, and values are within their intervals."""
    fit = fitted(1, one_wave=True)
    (wave,) = fit.noise.seas
    first, second = wave.phases.values()
    assert (second - first) % (2 * np.pi) == pytest.approx(BEHIND, abs=0.15)
    assert wave.period == pytest.approx(PERIOD, rel=0.1)
    for name, value in TRUE.items():
        assert abs(fit.values[name] - value) < 3.0 * fit.std_errors[name], name


@pytest.mark.slow
def test_one_wave_tells_derivatives_better_than_waves_apart() -> None:
    """Each axis says what pushes the other: stated errors fall to half, none rises."""
    together, apart = fitted(1, one_wave=True), fitted(1, one_wave=False)
    ratios = [together.std_errors[name] / apart.std_errors[name] for name in TRUE]
    assert np.exp(np.mean(np.log(ratios))) < 0.6
    assert max(ratios) < 1.0


def test_a_drawn_wave_is_what_its_phases_and_shares_say() -> None:
    """Coherence and phase of the analytic signals of both forces."""
    sea = Sea(
        period=8.0, bandwidth=0.1, levels={"K": 2.0, "M": 0.5},
        phases={"K": 0.3, "M": 1.5}, coherence={"K": 0.8, "M": 0.9},
    )  # fmt: skip
    times = 0.25 * np.arange(60_000)
    forces = forces_of_sea(sea, times, np.random.default_rng(0))
    assert forces.std(axis=0) == pytest.approx([2.0, 0.5], rel=0.05)
    one, other = hilbert(forces / forces.std(axis=0), axis=0).T
    together = np.mean(one * other.conj()) / 2.0
    assert np.abs(together) == pytest.approx(0.8 * 0.9, abs=0.05)
    assert np.angle(together) == pytest.approx(1.5 - 0.3, abs=0.05)


def test_phases_and_shares_are_given_for_every_place() -> None:
    """Else it is said which are missing; a share needs a phase."""
    levels = {"K": 2.0, "M": 0.5}
    with pytest.raises(ModelError, match="force M"):
        Sea(period=8.0, bandwidth=0.1, levels=levels, phases={"K": 0.0})
    with pytest.raises(ModelError, match="which records"):
        MultipleShooting(disturbances=Sea(period=8.0, records=("a",)))
    with pytest.raises(ModelError, match="and a phase"):
        Sea(period=8.0, bandwidth=0.1, levels=levels, coherence=levels)


def test_a_sea_of_one_wave_is_saved_and_restored() -> None:
    """With its phases and shares."""
    (wave,) = fitted(1, one_wave=True).noise.seas
    assert Sea.from_dict(wave.to_dict()) == wave
    assert wave.coherence is not None


def test_waves_of_their_own_in_each_equation_are_no_common_one() -> None:
    """Independent elevations leave the sea as it was."""
    (sea,) = fitted(1, one_wave=False).noise.seas
    assert sea.phases is None
