"""Many starts, the waterfall that they draw, and profile likelihood intervals."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest
from marks import slow
from motion import small
from scipy.optimize import brentq
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid import Dataset, Fit, Parameter, Record, simulate_inputs
from oed_sysid.baselines import MultipleShooting, OutputError
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.multistart import Multistart, _goal, profile
from oed_sysid.results import plot_waterfall
from oed_sysid.runtime.parallel import CellProgress

TRUTH = 1.3
# The misfit of a long oscillation has a valley for every number of periods.
OMEGA = Parameter("omega", TRUTH, "rad/s", lower=0.5, upper=3.0)
LAW = {"x": "v", "v": "-omega**2*x"}
OSCILLATOR = small("oscillator", "x [m], v [m/s]", LAW, [OMEGA], {"x": 0.02}, step=0.1)


@pytest.fixture(scope="module")
def data() -> Dataset:
    """Ten periods with noise."""
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


@pytest.mark.parametrize("n_jobs", [1, *slow(2)])
def test_processes_and_a_store_change_nothing(data: Dataset, tmp_path: Path, n_jobs: int) -> None:
    """Two processes, as of all cells, return what one does; a second call calculates nothing."""
    told: list[CellProgress] = []
    plan = Multistart(n_starts=4, n_jobs=n_jobs, store=tmp_path, progress=told.append)
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
    fit: Fit = MultipleShooting(disturbances="none").fit(OSCILLATOR, data)
    parameter = replace(
        OSCILLATOR.parameter("omega"), prior_mean=fit.values["omega"] + 0.2, prior_std=0.1
    )
    believed = replace(fit, model=fit.model.with_parameter(parameter))
    assert fit.log_likelihood - _goal(believed) == pytest.approx(2.0)


def test_mistakes_are_answered() -> None:
    """Too few starts, no span and nothing to estimate."""
    with pytest.raises(ModelError, match="2 or more"):
        Multistart(n_starts=1)
    with pytest.raises(ModelError, match="positive"):
        Multistart(span=0.0)
    with pytest.raises(ModelError, match="no free parameter"):
        Multistart().starts(OSCILLATOR.fix("omega"))


@pytest.fixture(scope="module")
def best(data: Dataset) -> Fit:
    """Single shooting from twelve starts: the true valley and side valleys."""
    single = MultipleShooting(
        interval=np.inf, start="near", noise="given", disturbances="none", coloured="never"
    )
    return Multistart(single, n_starts=12, n_jobs=1).fit(
        OSCILLATOR.with_values({"omega": 0.8}), data
    )


def test_every_start_is_drawn_and_the_plateau_is_marked(best: Fit) -> None:
    """Points are the sorted objectives; those of the best optimum are as many as arrived."""
    ax = plot_waterfall(best)
    drawn = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert 1 <= len(drawn["the best optimum"]) == best.attempts.arrived < 12
    above = np.sort(best.attempts.objectives) - np.min(best.attempts.objectives)
    marked = [drawn[k] for k in ("the best optimum", "other optima", "did not converge")
              if k in drawn]  # fmt: skip
    assert np.sort(np.concatenate(marked)) == pytest.approx(above)
    assert float(drawn["the model's own values"][0]) == pytest.approx(
        best.attempts.objectives[0] - np.min(best.attempts.objectives)
    )
    assert f"{best.attempts.arrived} of 12 starts" in ax.get_title(loc="left")
    plt.close(ax.figure)


def test_starts_that_diverged_are_counted(best: Fit) -> None:
    """An infinite objective is in the title, not in the picture."""
    objectives = best.attempts.objectives.copy()
    objectives[np.argmax(objectives)] = np.inf
    ax = plot_waterfall(replace(best, attempts=replace(best.attempts, objectives=objectives)))
    assert "1 diverged" in ax.get_title(loc="left")
    assert np.isfinite(ax.get_ylim()).all()
    plt.close(ax.figure)


def test_one_start_has_no_waterfall(best: Fit) -> None:
    """A plain fit says how to make one with starts."""
    with pytest.raises(DataError, match="Multistart"):
        plot_waterfall(replace(best, attempts=None))


KNOWN = {"noise": NOISE, "disturbances": "none"}
CHI2 = 3.841458820694124


def test_linear_parameter_has_the_standard_interval() -> None:
    """Where the misfit is a parabola, profile and standard error give the same interval."""
    line = small("line", "x [m]", {"x": "slope"}, {"slope [m/s]": 1.0})
    times = np.linspace(0, 10, 50)
    noise = 0.3 * np.random.default_rng(0).standard_normal(50)
    data = Dataset((Record("line", times, [], 0.5 * times + noise, line.channels),))
    fit = MultipleShooting(noise=[0.3], coloured="never", disturbances="none").fit(line, data)
    found = profile(fit, "slope")
    low, high = fit.interval("slope")
    width = high - low
    assert found.lower == pytest.approx(low, abs=2e-3 * width)
    assert found.upper == pytest.approx(high, abs=2e-3 * width)
    assert found.is_bounded
    expected = ((found.values - fit.values["slope"]) / fit.std_errors["slope"]) ** 2
    assert np.allclose(found.rises, expected, atol=1e-4)


RATE = Parameter("a", 1.0, "1/s", lower=0.0, upper=50.0)
DECAY = small("decay", "x [m]", {"x": "-a*x"}, [RATE], step=0.02)


def decay_fit(rate: float, seed: int, noise: float = 0.12) -> tuple[Dataset, object]:
    """A few noisy samples of a decay: strongly nonlinear in its rate."""
    times = np.linspace(0, 3, 8)
    rng = np.random.default_rng(seed)
    values = np.exp(-rate * times) + noise * rng.standard_normal(8)
    data = Dataset((Record("decay", times, [], values, DECAY.channels),))
    return data, MultipleShooting(noise=[noise], coloured="never", disturbances="none").fit(
        DECAY, data
    )


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_nonlinear_interval_is_the_closed_form(seed: int) -> None:
    """The initial value drops out in closed form: the ends solve one scalar equation."""
    data, fit = decay_fit(1.0, seed)
    times, values = data[0].times, data[0].outputs[:, 0]

    def twice_cost(rate: float) -> float:
        shape = np.exp(-rate * times)
        best = shape @ values / (shape @ shape)
        return float(np.sum((values - best * shape) ** 2)) / 0.12**2

    estimate = fit.values["a"]
    least = twice_cost(estimate)
    found = profile(fit, "a")
    lower = brentq(lambda a: twice_cost(a) - least - CHI2, -2.0, estimate)
    if lower < 0:
        assert found.lower == 0.0
        assert found.lower_end == "bound"
    else:
        assert found.lower == pytest.approx(lower, rel=5e-3)
    upper = brentq(lambda a: twice_cost(a) - least - CHI2, estimate, 49.0)
    assert found.upper == pytest.approx(upper, rel=5e-3)
    assert found.upper - estimate > 1.1 * (estimate - lower)  # asymmetric, as it should be


def test_open_end_is_said() -> None:
    """A decay faster than the sampling has no upper limit; the profile stops at the bound."""
    _, fit = decay_fit(8.0, 5, noise=0.1)
    found = profile(fit, "a")
    assert found.upper_end == "bound"
    assert "not because of the data" in found.report()
    free = fit.model.with_parameter(Parameter("a", fit.values["a"], "1/s", lower=0.0))
    wide = profile(MultipleShooting(noise=[0.1], disturbances="none").fit(free, fit.dataset), "a")
    assert wide.upper_end in ("open", "diverged")
    assert "do not bound it" in wide.report() or "diverges" in wide.report()
    assert not wide.is_bounded


def test_unseen_parameter_is_open_on_both_sides() -> None:
    """What no output depends on may take any value."""
    model = yaw_model(other=Parameter("other", 1.0))
    fit = MultipleShooting(coloured="never", **KNOWN).fit(model, yaw_data(0))
    found = profile(fit, "other")
    assert (found.lower, found.upper) == (-np.inf, np.inf)
    assert found.report().count("do not bound it") == 2


def test_coloured_residuals_widen_the_profile() -> None:
    """The threshold grows with the ratio of the sandwich to the white variance."""
    data = yaw_data(1)
    white = MultipleShooting(coloured="never", **KNOWN).fit(yaw_model(), data)
    forced = MultipleShooting(coloured="always", **KNOWN).fit(yaw_model(), data)
    ratio = forced.std_errors["T"] / white.std_errors["T"]
    widths = [found.upper - found.lower for found in (profile(f, "T") for f in (white, forced))]
    assert widths[1] / widths[0] == pytest.approx(ratio, rel=0.03)


def test_unknown_names_and_levels_are_refused() -> None:
    """The error lists what can be profiled."""
    fit = MultipleShooting(**KNOWN).fit(yaw_model(), yaw_data(0))
    with pytest.raises(ModelError, match="K, T, alpha"):
        profile(fit, "gain")
    with pytest.raises(ModelError, match="between 0 and 1"):
        profile(fit, "T", level=95)
