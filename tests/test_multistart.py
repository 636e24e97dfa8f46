"""Many starts find what one start misses."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Dataset, Model, Output, Parameter, State
from oed_sysid.baselines import OutputError
from oed_sysid.errors import ModelError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.multistart import Multistart
from oed_sysid.runtime.parallel import CellProgress

TRUTH = 1.3
# The misfit of a long oscillation has a valley for every number of periods.
OSCILLATOR = Model(
    "oscillator",
    (State("x", "m"), State("v", "m/s")),
    (),
    (Output("x", "m", noise_std=0.02),),
    kinematics={"x": "v", "v": "-omega**2*x"},
    parameters=(Parameter("omega", TRUTH, "rad/s", lower=0.5, upper=3.0),),
    step=0.1,
)


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Ten periods with noise."""
    from oed_sysid.data.record import Record

    times = np.arange(0.0, 50.0, 0.1)
    run = simulate_inputs(OSCILLATOR, times, inputs={}, initial={"x": 1.0})
    noise = 0.02 * np.random.default_rng(0).standard_normal(run.outputs.shape)
    outputs = run.outputs + noise
    return Dataset((Record("free", times, run.inputs, outputs, OSCILLATOR.channels),))


def test_many_starts_find_the_deepest_valley(data: Dataset) -> None:
    """Single shooting from 0.8 rad/s ends in a side valley; of 16 starts some do not."""
    wrong = OSCILLATOR.with_values({"omega": 0.8})
    single = OutputError().fit(wrong, data)
    assert abs(single.values["omega"] - TRUTH) > 0.05
    best = Multistart(OutputError(), n_starts=16, n_jobs=1).fit(wrong, data)
    assert best.status.ok
    assert best.values["omega"] == pytest.approx(TRUTH, abs=4 * best.std_errors["omega"])
    assert 1 <= best.attempts.arrived < 16
    assert best.log_likelihood == pytest.approx(max(best.attempts.log_likelihoods))
    assert best.attempts.start_values[0] == {"omega": 0.8}


def test_processes_and_a_store_change_nothing(data: Dataset, tmp_path: Path) -> None:
    """Two processes return what one does; a second call calculates nothing."""
    told: list[CellProgress] = []
    plan = Multistart(n_starts=4, n_jobs=2, store=tmp_path, progress=told.append)
    first = plan.fit(OSCILLATOR, data)
    again = plan.fit(OSCILLATOR, data)
    here = Multistart(n_starts=4, n_jobs=1).fit(OSCILLATOR, data)
    assert len(told) == 4
    assert first.values == again.values
    assert first.values["omega"] == pytest.approx(here.values["omega"], rel=1e-9)
    assert first.attempts.arrived == here.attempts.arrived == 4


def test_starts_fill_the_bounds_or_the_span() -> None:
    """Each of n equal parts of a range holds one start; without bounds the span counts."""
    starts = Multistart(n_starts=11).starts(OSCILLATOR)
    assert starts[0] == {"omega": TRUTH}
    shares = (np.array([s["omega"] for s in starts[1:]]) - 0.5) / 2.5
    assert sorted((10 * shares).astype(int)) == list(range(10))
    parameter = replace(OSCILLATOR.parameter("omega"), lower=-np.inf, upper=np.inf)
    free = Multistart(n_starts=50, span=2.0).starts(OSCILLATOR.with_parameter(parameter))
    values = np.array([s["omega"] for s in free])
    assert values.min() == pytest.approx(-TRUTH, abs=0.2)
    assert values.max() == pytest.approx(3 * TRUTH, abs=0.2)


def test_priors_count_among_starts(data: Dataset) -> None:
    """A result against the prior loses to one with it, whatever its likelihood alone."""
    from oed_sysid.likelihood.multistart import _goal

    fit: Fit = MultipleShooting().fit(OSCILLATOR, data)
    parameter = replace(
        OSCILLATOR.parameter("omega"), prior_mean=fit.values["omega"] + 0.2, prior_std=0.1
    )
    believed = replace(fit, model=fit.model.with_parameter(parameter))
    assert fit.log_likelihood - _goal(believed) == pytest.approx(2.0)


def test_mistakes_are_answered() -> None:
    """Too few starts, no span and nothing to estimate."""
    with pytest.raises(ModelError, match="Give 2 or more"):
        Multistart(n_starts=1)
    with pytest.raises(ModelError, match="positive"):
        Multistart(span=0.0)
    with pytest.raises(ModelError, match="no free parameter"):
        Multistart().starts(OSCILLATOR.fix("omega"))
