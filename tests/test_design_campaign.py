"""Whole stories: what is avoided, what is kept, and what designs decide in the end."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from test_design import LIMITS, grid, quick, ship

from oed_sysid import Dataset, Force, Limits, MultipleShooting, Parameter, load_problem
from oed_sysid.design import (
    Discriminate,
    Levels,
    Multisines,
    Search,
    Trial,
    campaign,
    design_experiment,
)
from oed_sysid.errors import DesignError
from oed_sysid.experiments.simulation import simulate


def test_forbidden_frequencies_get_no_power() -> None:
    """The designed command has no power in the band, and still tells most things."""
    band = (0.08, 0.16)
    found = quick(family=Multisines(7, forbidden=[band]))
    commands = found.trajectory.inputs[1:, 0]
    power = np.abs(np.fft.rfft(commands)) ** 2
    frequencies = np.fft.rfftfreq(len(commands), 0.5)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    assert inside.sum() >= 3
    assert power[inside].sum() < 1e-12 * power.sum()
    free = quick(family=Multisines(7)).trajectory.inputs[1:, 0]
    assert (np.abs(np.fft.rfft(free)) ** 2)[inside].sum() > 1e-3 * power.sum()
    assert found.gain(found.references[0])[0] > 1.0
    assert "outside 0.08 to 0.16 Hz" in found.report()


def test_bands_keep_range_and_rate_and_are_checked() -> None:
    """Commands are made smaller instead of clipped; impossible bands are named."""
    fitted = grid(rate=0.2)
    shape = Multisines(8, forbidden=[(0.1, 0.12)]).on(fitted)
    commands = shape.commands(np.random.default_rng(0).random((20, shape.size)))
    assert np.abs(commands).max() <= 0.35 + 1e-12
    assert np.abs(np.diff(commands, axis=1)).max() <= 0.1 + 1e-12
    with pytest.raises(DesignError, match="outside the forbidden bands"):
        Multisines(8, forbidden=[(0.0, 0.24)]).on(fitted)
    with pytest.raises(DesignError, match="is none"):
        Multisines(8, forbidden=[(0.3, 0.1)])


def test_speed_distance_depth_and_return_are_kept_together() -> None:
    """An AUV loses little speed, stays in its box and comes back to its depth and trim."""
    problem = load_problem("auv_diving_plane")
    limits = replace(
        problem.limits,
        signals={"u": (1.30, np.inf), "x": (-np.inf, 56.0), "z": (98.0, 102.0)},
    )
    end = {"z": (99.8, 100.2), "theta": (-0.02, 0.02)}
    found = design_experiment(
        problem.model,
        Trial(
            limits=limits, duration=40.0, sample_time=0.5, initial={"u": 1.34, "z": 100.0}, end=end
        ),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(16), n_starts=1, n_candidates=15, n_steps=10, n_workers=1),
    )
    # Another integration step, so that nothing is kept by the coincidence of one.
    run = simulate(replace(problem.model, step=0.05), found.experiment, noise=False)
    for name, (low, high) in limits.signals.items():
        values, margin = run.output(name), 1e-4
        assert values.min() >= low - margin
        assert values.max() <= high + margin
    for name, (low, high) in end.items():
        assert low - 1e-4 <= run.output(name)[-1] <= high + 1e-4
    assert np.ptp(run.output("theta")) > 0.05


def test_distance_that_nothing_can_keep_is_named() -> None:
    """Who runs for forty seconds goes further than thirty metres, and is told so."""
    problem = load_problem("auv_diving_plane")
    limits = replace(problem.limits, signals={"x": (-np.inf, 30.0)})
    with pytest.raises(DesignError, match=r"x is 5\d\.\d+ m .*above its limit of 30 m"):
        design_experiment(
            problem.model,
            Trial(limits=limits, duration=40.0, sample_time=0.5, initial={"u": 1.34, "z": 100.0}),
            rng=np.random.default_rng(0),
            search=Search(family=Levels(6), n_starts=1, n_candidates=3, n_steps=2, n_workers=1),
        )


def test_campaign_learns_from_each_run() -> None:
    """Wrong beliefs are corrected: later designs start near the truth, and the truth is found."""
    truth = ship()
    nominal = truth.with_values({"b": 0.08, "d": 0.55, "c": 1.0})
    rng = np.random.default_rng(2)
    search = Search(Levels(12), n_starts=1, n_candidates=10, n_steps=6, n_workers=1)
    stages = campaign(
        nominal, Trial(LIMITS, duration=40.0, sample_time=0.5, name="run"),
        lambda experiment: simulate(truth, replace(experiment, limits=Limits()), rng=rng), 2,
        design=partial(design_experiment, rng=rng, search=search),
    )  # fmt: skip
    assert [stage.record.name for stage in stages] == ["run_1", "run_2"]
    first, second = stages
    errors = second.fit.information.std_errors
    assert second.design.model.values == first.fit.model.values
    assert np.all(errors < first.fit.information.std_errors)
    true = np.array([truth.values[name] for name in second.fit.names])
    found = np.array([second.fit.values[name] for name in second.fit.names])
    assert np.all(np.abs(found - true) < 4 * errors)
    # The second design knew the vehicle and keeps its limits on it, up to what is still uncertain.
    replayed = simulate(truth, replace(second.design.experiment, limits=Limits()), noise=False)
    assert np.abs(replayed.output("psi")).max() < 0.6 * 1.05


def test_discriminating_design_decides_where_a_zigzag_does_not() -> None:
    """Rivals that fit a zigzag alike are told apart by estimation from the designed run."""
    rivals = (
        Force("cubic", {"r": "-E_cubic*r**3"}, (Parameter("E_cubic", 0.0, scale=30.0),)),
        Force("stall", {"r": "-E_stall*rudder**3"}, (Parameter("E_stall", 0.0, scale=0.15),)),
    )
    found = quick(criterion=Discriminate(rivals, size=1.0), n_starts=2)
    truth = ship() + rivals[1].with_values({"E_stall": 0.15})
    estimator = MultipleShooting(noise="given", coloured="never", disturbances="none")
    rng = np.random.default_rng(1)

    def margin(experiment: object) -> float:
        """How much better the true rival fits than the wrong one, in twice the log-likelihood."""
        data = Dataset((simulate(truth, replace(experiment, limits=Limits()), rng=rng),))
        wrong, right = (estimator.fit(ship() + rival, data) for rival in rivals)
        return 2 * (wrong.cost - right.cost)

    zigzag = found.references[-1].experiment
    designed = [margin(found.experiment) for _ in range(4)]
    standard = [margin(zigzag) for _ in range(4)]
    assert max(standard) < 6
    assert all(value > 16 for value in designed)
    assert np.mean(designed) == pytest.approx(found.misfits["stall", "cubic"], rel=0.5)
