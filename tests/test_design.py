"""Criteria, families of commands, limits and the designs that come out."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cache

import numpy as np
import pytest
from altered import trials
from motion import small

from oed_sysid import Dataset, Experiment, Fit, Force, Limits, Model, MultipleShooting, NoiseModel
from oed_sysid.compiled.kernels import kernel
from oed_sysid.design import (
    Design,
    Discriminate,
    DOptimal,
    DsOptimal,
    Grid,
    Knowledge,
    Levels,
    Multisines,
    Pulses,
    Robust,
    Search,
    Trial,
    ZigZags,
    design_experiment,
)
from oed_sysid.design.criteria import Measure, Setting, eliminate
from oed_sysid.design.knowledge import ExpectedInformation
from oed_sysid.design.objective import Objective
from oed_sysid.design.trial import Task
from oed_sysid.errors import DesignError
from oed_sysid.experiments.manoeuvres import Doublet, ThreeTwoOneOne
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.information import information_of, noise_of
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text.csv_table import read_table

LIMITS = Limits(
    inputs={"rudder": (-0.35, 0.35)}, rates={"rudder": 0.2}, signals={"psi": (-0.6, 0.6)}
)


def ship(**changes: object) -> Model:
    """Yaw with linear and quadratic damping and a rudder of its own lag."""
    law = {"psi": "r", "r": "b*rudder - d*r - c*r*abs(r)"}
    values, noise = {"b": 0.12, "d": 0.4, "c": 1.5}, {"psi": 5e-3, "r": 2e-3}
    signals = "psi [rad], r [rad/s] <- rudder [rad]"
    model = small("small ship", signals, law, values, noise, scales={"r": 0.1}, step=0.25)
    return replace(model, **changes)  # type: ignore[arg-type]


def quick(model: Model | object = None, **changes: object) -> Design:
    """Small design task, a few hundred milliseconds."""
    settings = {
        "limits": LIMITS, "duration": 40.0, "sample_time": 0.5, "family": Levels(20),
        "n_starts": 2, "n_candidates": 25, "n_steps": 10, "n_workers": 1,
        "rng": np.random.default_rng(4), "caution": "auto" if isinstance(model, Fit) else None,
    } | changes  # fmt: skip
    taken: dict[str, object] = {
        word: kind(**{f.name: settings.pop(f.name) for f in fields(kind) if f.name in settings})
        for word, kind in (("trial", Trial), ("search", Search), ("knowledge", Knowledge))
    }
    return design_experiment(model or ship(), **taken, **settings)  # type: ignore[arg-type]


def sea(level: float, colour: float = 0.0) -> NoiseModel:
    """Random yaw acceleration of three seconds, and colour of the rate sensor."""
    return NoiseModel(
        np.array([5e-3, 2e-3]), np.array([0.0, colour]), np.array([level]), colour_time=1.0,
        force_time=3.0, outputs=("psi", "r"), places=("force r",),
    )  # fmt: skip


def straight() -> Model:
    """The ship believed to have linear damping only."""
    return ship().with_values({"c": 0.0}).fix("c")


def weak_and_strong(rng: np.random.Generator) -> Dataset:
    """Runs of 3-2-1-1 of the ship, of small and of large rudder angles."""
    settings = {"duration": 60.0, "sample_time": 0.25}
    steps = [ThreeTwoOneOne("rudder", size, unit_time=5.0) for size in (0.1, 0.35)]
    runs = [Experiment(f"run {i}", one, **settings) for i, one in enumerate(steps, 1)]
    return trials(ship(), runs, rng)


def assert_slope(measure: Measure, rows: np.ndarray, rng: np.random.Generator) -> None:
    """The gradient of a measure of information is what differences find along a direction."""
    matrix = rows.T @ rows
    _, gradient = measure(matrix)
    direction = rng.standard_normal(matrix.shape)
    direction = direction @ direction.T
    slope = (measure(matrix + 1e-6 * direction)[0] - measure(matrix - 1e-6 * direction)[0]) / 2e-6
    assert np.sum(gradient * direction) == pytest.approx(slope, rel=1e-5)


@cache
def plain() -> Design:
    """One D-optimal design that several tests look at."""
    return quick()


@pytest.fixture
def designed() -> Design:
    """That design."""
    return plain()


def grid(rate: float = np.inf) -> Grid:
    """Eighty samples of one input."""
    one = np.ones(1)
    return Grid(np.arange(81) * 0.5, ("rudder",), -0.35 * one, 0.35 * one, 0 * one, rate * one)


SETTING = Setting(ship(), ("b", "d", "c"), np.array([0.12, 0.4, 1.5]), noise_of(ship()))
DOUBLET = Experiment(
    "doublet", Doublet("rudder", 0.2, pulse_time=8.0), duration=40.0, sample_time=0.5
)
TURN = Experiment("turn", Doublet("rudder", 0.2, pulse_time=5.0), duration=20.0, sample_time=0.5)


def test_discrimination_gradient_equals_differences() -> None:
    """The soft minimum over pairs has the derivative that differences find."""
    rivals = (Force("a", {"r": "E_a*psi"}, (Parameter("E_a", 0.1),)),
              Force("e", {"r": "E_e*r**3"}, (Parameter("E_e", 1.0),)))  # fmt: skip
    criterion = Discriminate(rivals)
    measure = criterion.bind(replace(SETTING, shifts=criterion.shifts(ship())))
    rng = np.random.default_rng(1)
    assert_slope(measure, rng.standard_normal((20, 5)), rng)


def test_elimination_is_the_inverse_block() -> None:
    """Eliminated information is the inverse of a block of the inverse."""
    rows = np.random.default_rng(2).standard_normal((12, 5))
    matrix = rows.T @ rows
    reduced, _ = eliminate(matrix, 2)
    np.testing.assert_allclose(reduced, np.linalg.inv(np.linalg.inv(matrix)[2:, 2:]), rtol=1e-9)


@pytest.mark.parametrize(
    "family",
    [Levels(20), Multisines(8), Pulses(2)],
    ids=lambda family: family.name,
)
def test_families_keep_actuator_limits(family: Levels) -> None:
    """Any numbers between 0 and 1 give commands within range and rate, from trim."""
    fitted = grid(rate=0.2)
    shape = family.on(fitted)
    numbers = np.random.default_rng(3).random((50, shape.size))
    commands = shape.commands(numbers)
    assert commands.shape == (50, 81, 1)
    assert np.abs(commands).max() <= 0.35 + 1e-12
    assert np.abs(np.diff(commands, axis=1)).max() <= 0.2 * 0.5 + 1e-12
    assert np.all(commands[:, 0] == 0)
    assert np.ptp(commands, axis=0).max() > 0.2


@pytest.mark.parametrize("family", [Levels(20), Multisines(8)])
def test_families_find_their_own_members(family: Levels) -> None:
    """Numbers fitted to a member's commands give that member back."""
    shape = family.on(grid())
    numbers = 0.5 + 0.05 * np.random.default_rng(3).standard_normal((1, shape.size))
    commands = shape.commands(numbers)
    found = shape.start(commands[0])
    np.testing.assert_allclose(shape.commands(found[None])[:, 1:], commands[:, 1:], atol=2e-3)


@pytest.mark.parametrize("family", [Levels(12), Pulses(1)])
def test_derivatives_equal_differences(family: Levels) -> None:
    """Derivatives through restarted trajectories equal central differences of whole runs."""
    expected = ExpectedInformation.of(ship(), DOptimal(), Knowledge())
    expected = replace(expected, before=np.diag(expected.scales() ** -2.0))
    limits = Limits(inputs=LIMITS.inputs, signals={"psi": (-0.3, 0.3)})
    trial = Trial(limits, 40.0, 0.5, initial={"r": 0.01}, end={"r": (-0.1, 0.1)})
    task = Task.of(expected, trial, np.random.default_rng(0))
    shape, bounds = family.on(task.grid), task.bounds
    objective = Objective(task, shape)
    numbers = 0.5 + 0.3 * (np.random.default_rng(5).random(shape.size) - 0.5)
    score = objective.score(numbers)
    slope = objective.linearise(score)
    for index in (0, shape.size // 2, shape.size - 1):
        step = np.zeros(shape.size)
        step[index] = 1e-4
        above, below = objective.score(numbers + step), objective.score(numbers - step)
        central = (above.value - below.value) / 2e-4
        assert slope.criterion[index] == pytest.approx(central, rel=2e-3, abs=1e-3)
        moved = (above.evaluations[0].signals - below.evaluations[0].signals)[
            :, bounds.columns
        ] / 2e-4
        np.testing.assert_allclose(
            slope.signals[0, :, :, index], moved, atol=2e-3 * np.abs(moved).max() + 1e-9
        )


def test_design_keeps_limits_and_beats_zigzags(designed: Design) -> None:
    """The design stays inside every limit when simulated anew, and tells more."""
    run = simulate_inputs(
        ship(), designed.trajectory.times, inputs=designed.experiment.commands(("rudder",))
    )
    assert LIMITS.violations(run.times, run.signals) == ()
    assert np.ptp(run.signal("psi")) > 0.5
    for reference in designed.references:
        record = simulate(ship(), reference.experiment, noise=False)
        assert np.abs(record.output("psi")).max() <= 0.6
        mean, _ = designed.gain(reference)
        assert mean > 1.3
    assert designed.value >= max(designed.start_values) - 1e-9


def towed(**settings: object) -> Design:
    """Small design for a towed body: the speed of tow has no zero in its range."""
    law = {"theta": "q", "q": "b*V*V*flap - d*V*q - k*theta"}
    values, noise = {"b": 0.1, "d": 0.3, "k": 0.5}, {"theta": 5e-3}
    signals = "theta [rad], q [rad/s] <- V [m/s], flap [rad]"
    model = small("towed body", signals, law, values, noise, scales={"q": 0.1}, step=0.25)
    given: dict[str, object] = {"duration": 30.0, "n_starts": 1, "family": Levels()}
    given |= {"n_candidates": 8, "n_steps": 2, "rng": np.random.default_rng(0)}
    return quick(model, **(given | settings))


def test_range_without_zero_has_its_middle_as_neutral() -> None:
    """A speed of 1.8 to 3.2 m/s begins at 2.5; the zigzag it is compared with moves the flap."""
    ranges = {"V": (1.8, 3.2), "flap": (-0.3, 0.3)}
    design = towed(limits=Limits(inputs=ranges))
    speed, flap = design.trajectory.inputs.T
    assert (speed[0], flap[0]) == (2.5, 0.0)
    assert speed.min() >= 1.8
    assert speed.max() <= 3.2
    assert [one.name for one in design.references] == ["zigzag 5/5", "zigzag 10/10"]
    for reference in design.references:
        record = simulate(design.model, reference.experiment, noise=False)
        assert np.all(record.input("V") == 2.5)
        assert np.ptp(record.input("flap")) > 0.1


@pytest.mark.parametrize("span", [(1.8, 3.2), (0.0, 3.2), (-3.2, 0.0)])
def test_only_input_without_room_about_zero(span: tuple[float, float]) -> None:
    """An input that zero leaves no room on one side is compared about the middle of its range."""
    design = towed(limits=Limits(inputs={"V": span}), constants={"flap": 0.1})
    assert np.isfinite(design.value)
    middle = sum(span) / 2
    for reference in design.references:
        commands = simulate(design.model, reference.experiment, noise=False).input("V")
        assert 0.0 < np.abs(commands - middle).max() < 0.2


def test_design_predicts_the_information_of_its_experiment(designed: Design) -> None:
    """The stated errors are those of the exported experiment, found independently."""
    again = information_of(ship(), designed.experiment)
    np.testing.assert_allclose(again.std_errors, designed.information.std_errors, rtol=1e-9)


def test_design_is_reported_and_stored(designed: Design, tmp_path: object) -> None:
    """Report, card and dictionary name what matters; the CSV holds the commands."""
    assert "times larger" in designed.report()
    card = designed.sea_trial_card()
    assert "+-34.38 deg" in card
    assert "40 s" in card
    stored = designed.to_dict()
    assert Experiment.from_dict(stored["experiment"]) == designed.experiment
    path = tmp_path / "commands.csv"  # type: ignore[operator]
    designed.write_csv(path)
    table = read_table(path)
    assert table.headers == ("t [s]", "rudder [rad]")
    np.testing.assert_array_equal(table.values[:, 0], designed.trajectory.times)
    np.testing.assert_array_equal(table.values[:, 1:], designed.trajectory.inputs)


def test_same_generator_same_design(designed: Design) -> None:
    """A design is reproducible from its generator's seed."""
    np.testing.assert_allclose(quick().trajectory.inputs, designed.trajectory.inputs, atol=1e-6)


def test_return_to_the_start_is_kept() -> None:
    """Limits on the end hold at the end."""
    found = quick(end={"psi": (-0.02, 0.02), "r": (-0.01, 0.01)})
    assert abs(found.trajectory.signal("psi")[-1]) <= 0.02 + 1e-9
    assert abs(found.trajectory.signal("r")[-1]) <= 0.01 + 1e-9


def test_impossible_limits_are_named() -> None:
    """Contradictions say which signal, where and how far."""
    with pytest.raises(DesignError, match="start already breaks"):
        quick(initial={"psi": 1.0})
    with pytest.raises(DesignError, match=r"psi is .* at the end, below its limit of 515.7 deg"):
        quick(limits=replace(LIMITS, signals={}), end={"psi": (9.0, 10.0)})
    with pytest.raises(DesignError, match="no finite range"):
        quick(inputs=["rudder"], limits=Limits())
    with pytest.raises(DesignError, match="no input 'fin'"):
        quick(inputs=["fin"])


def test_criterion_of_interest_improves_its_parameter(designed: Design) -> None:
    """Ds for one parameter determines it at least as well as D for all does."""
    found = quick(criterion=DsOptimal(("c",)), n_starts=3)
    index = found.names.index("c")
    assert found.relative_errors[index] < 1.02 * designed.relative_errors[index]


def test_prior_knowledge_is_completed() -> None:
    """After a fit the next design starts from its information and adds to it."""
    data = Dataset((simulate(ship(), TURN, rng=np.random.default_rng(0)),))
    fit = MultipleShooting(noise="given").fit(ship(), data)
    found = quick(fit, caution=None)
    np.testing.assert_allclose(found.prior.std_errors, fit.information.std_errors, rtol=1e-6)
    assert np.all(found.information.std_errors < found.prior.std_errors)


def test_zigzag_family_reacts_and_keeps_limits() -> None:
    """A designed zigzag is an experiment with feedback inside the bounds."""
    found = quick(family=ZigZags("psi"))
    assert found.experiment.reacts
    assert LIMITS.violations(found.trajectory.times, found.trajectory.signals) == ()
    assert found.gain(found.references[0])[0] > 1.0
    card = found.sea_trial_card()
    assert "psi" in found.experiment.excitation.feedback
    assert "NO LIMIT" not in card


def test_robust_design_keeps_limits_for_all_sampled_vehicles() -> None:
    """A robust design stays inside for the drawn values, and loses little at the nominal."""
    robust = Robust(DOptimal(), spread=0.3, n_sets=3, worst=True)
    found = quick(criterion=robust)
    outside = []
    rng = np.random.default_rng(4)
    for _ in range(3):
        drawn = ship().with_values(
            {n: v * (1 + 0.3 * rng.uniform(-1, 1)) for n, v in ship().values.items()}
        )
        run = simulate_inputs(drawn, found.trajectory.times, inputs=found.trajectory.inputs)
        outside += LIMITS.violations(run.times, run.signals)
    assert outside == []
    assert "worst D over 4 sets" in found.report()


def test_discrimination_raises_the_misfit_between_rivals() -> None:
    """A design to discriminate separates rivals better than one to identify."""
    rivals = (
        Force("cubic", {"r": "E_cubic*r**3"}, (Parameter("E_cubic", 0.0, scale=2.0),)),
        Force("restoring", {"r": "E_restoring*psi"}, (Parameter("E_restoring", 0.0, scale=0.02),)),
    )
    found = quick(criterion=Discriminate(rivals, size=1.0), n_starts=2)
    assert set(found.misfits) == {
        ("cubic", "small ship"),
        ("cubic", "restoring"),
        ("restoring", "small ship"),
        ("restoring", "cubic"),
    }
    # Refit of the nominal model to noise-free data of the rival: the real misfit.
    truth = ship() + rivals[0].with_values({"E_cubic": 2.0})
    data = Dataset((simulate(truth, found.experiment, noise=False),))
    fit = MultipleShooting(noise="given", coloured="never", disturbances="none").fit(ship(), data)
    assert 2 * fit.cost == pytest.approx(found.misfits["cubic", "small ship"], rel=0.3)
    assert min(found.misfits.values()) > _smallest_misfit(rivals, plain().trajectory.inputs)


def _smallest_misfit(rivals: tuple[Force, ...], commands: np.ndarray) -> float:
    """Smallest pairwise misfit of given commands, by dense least squares."""
    model = ship()
    found = Discriminate(rivals, size=1.0).shifts(model)
    times = np.arange(len(commands)) * 0.5
    runner = kernel(model)
    run = runner.run(times, commands, model.value_vector, np.zeros(2), sensitivities=True)
    assert run.output_sensitivities is not None
    sigma = np.array([5e-3, 2e-3])
    base = (run.output_sensitivities / sigma[:, None]).reshape(-1, 5)
    shifts = []
    for rival, factor in zip(found.models, found.factors, strict=True):
        other = simulate_inputs(rival, times, inputs=commands)
        shifts.append((factor * (other.outputs - run.outputs) / sigma).ravel())
    smallest = np.inf
    for i, shift in enumerate(shifts):
        for extra in ([], *([s] for j, s in enumerate(shifts) if j != i)):
            columns = np.column_stack([base, *extra])
            left = shift - columns @ np.linalg.lstsq(columns, shift, rcond=None)[0]
            smallest = min(smallest, float(left @ left))
    return smallest
