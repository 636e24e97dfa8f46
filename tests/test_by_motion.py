"""Independent tests are asked where the model fails by motion and input, in whatever order."""

from __future__ import annotations

import numpy as np
import pytest
from test_captive import TRUTH, ship

from oed_sysid import Dataset, Force, MultipleShooting, diagnose, improve
from oed_sysid.errors import DataError
from oed_sysid.evidence.compare import compare
from oed_sysid.evidence.misfit import failing
from oed_sysid.evidence.preparation import prepared
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.captive import CaptiveTests
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics import amplitude
from oed_sysid.results import page as page_of
from oed_sysid.results import plot_output

NOISE, CROSSFLOW = 0.3, -60.0
CANDIDATES = (
    Force("yaw", {"N": "E_n*abs(r)*r"}, (amplitude("n", "kg m^2", scale=50.0),)),
    Force("crossflow", {"Y": "E_y*abs(v)*v"}, (amplitude("y", "kg/m", scale=50.0),)),
)


def fitted(order: np.ndarray | None = None) -> Fit:
    """Captive tests of a ship with a crossflow that the model lacks, sorted by drift or not."""
    rng = np.random.default_rng(1)
    v = np.repeat(np.linspace(-0.4, 0.4, 7), 15)
    r = np.tile(np.repeat(np.linspace(-0.15, 0.15, 5), 3), 7)
    delta = np.tile([-0.3, 0.0, 0.3], 35)
    sway = TRUTH["Y_v"] * v + TRUTH["Y_r"] * r + TRUTH["Y_d"] * delta + CROSSFLOW * np.abs(v) * v
    yaw = TRUTH["N_v"] * v + TRUTH["N_r"] * r + TRUTH["N_d"] * delta
    sway, yaw = (force + NOISE * rng.standard_normal(len(v)) for force in (sway, yaw))
    rows = np.arange(len(v)) if order is None else order
    tests = CaptiveTests(
        "basin",
        {"v": v[rows], "r": r[rows]},
        {"delta": delta[rows]},
        {"Y": sway[rows], "N": yaw[rows]},
        {"Y": NOISE, "N": NOISE},
    )
    return tests.fit(MultipleShooting(), ship())


SORTED, SHUFFLED = fitted(), fitted(np.random.default_rng(2).permutation(105))


def test_where_it_fails_is_a_function_of_drift_whatever_the_order() -> None:
    """The residual of the sway force is found by given drift, the same for shuffled rows."""
    texts = []
    for fit in (SORTED, SHUFFLED):
        study, base = Study.begin(fit.model, fit.dataset, None, CANDIDATES, known_noise=False)
        assert not base.noise.has_forces
        assert not base.noise.has_colour
        (found,) = failing(base)
        assert found.output.name == "force_Y"
        assert found.signal is not None
        assert found.signal.name == "v_held"
        assert found.values == pytest.approx(np.linspace(-0.4, 0.4, 7))
        # v|v| less its part along v, in units of the noise.
        v = np.linspace(-0.4, 0.4, 7)
        curve = CROSSFLOW * np.abs(v) * v
        curve = curve - v * (v @ curve) / (v @ v)
        assert found.means == pytest.approx(curve / NOISE, abs=4.5 / np.sqrt(15))
        assert found.share > 0.9
        texts.append(found.text)
        assert study.plain_error > 3.0
    assert texts[0] == texts[1]


def test_noise_depends_on_nothing() -> None:
    """With the crossflow in the model, nothing is said to fail."""
    wide = SORTED.model + CANDIDATES[1]
    again = MultipleShooting().fit(
        wide, SORTED.dataset, start_states=[{s.name: 0.0 for s in wide.states}]
    )
    _, base = Study.begin(again.model, SORTED.dataset, None, CANDIDATES[:1], known_noise=False)
    assert failing(base) == ()


def test_ranking_of_candidates_does_not_depend_on_the_order() -> None:
    """Scores and gains of sorted and of shuffled tests are the same."""
    ranked = [
        dict(diagnose(fit.model, fit.dataset, candidates=CANDIDATES).ranking.statistics())
        for fit in (SORTED, SHUFFLED)
    ]
    assert ranked[0]["crossflow"] > 300.0
    for name in ranked[0]:
        assert ranked[0][name] == pytest.approx(ranked[1][name], rel=1e-3, abs=1e-2)


def test_improve_learns_from_tests_drawn_by_lot_and_confirms_on_the_others() -> None:
    """The missing crossflow is found, its size right, and no time is spoken of."""
    found = improve(SORTED.model, SORTED.dataset, candidates=CANDIDATES)
    (step,) = found.steps
    assert step.added == "crossflow"
    assert step.test_gain > 50.0
    row = next(row for row in found.parameters if row["name"] == "E_y")
    assert abs(row["value"] - CROSSFLOW) < 4 * row["std_error"]
    assert found.location.by_motion
    assert max(found.location.gains.values()) == 0.0
    page = page_of(found, compare([found.base, found.model], SORTED.dataset))
    assert page.sections


def test_validation_tests_span_the_motions() -> None:
    """Of tests sorted by drift all drifts are kept, not the largest as at the end of a run."""
    part = prepared(SORTED.dataset, None)
    assert part.validation is not None
    column = SORTED.dataset.channels.input_names.index("v_held")
    for records in (part.train, part.validation):
        assert set(np.round(records[0].inputs[:, column], 6)) == set(
            np.round(np.linspace(-0.4, 0.4, 7), 6)
        )
    assert part.train.n_samples + part.validation.n_samples == 105
    with pytest.raises(DataError):
        part.train[0].__class__(
            "run",
            np.arange(3.0),
            np.zeros((3, 1)),
            np.zeros((3, 3)),
            ship().channels,
        ).tests(np.arange(2), "some")


def test_comparison_counts_tests_whole_and_looks_at_no_time() -> None:
    """Effective samples, worst test, correlations without lag, no forecasts, in any order."""
    sizes = []
    for fit in (SORTED, SHUFFLED):
        (part,) = compare([fit.model], fit.dataset).models
        force = part.output("force_Y")
        assert force.effective_samples == force.n_samples == 105
        assert all(one.lag == 0.0 for one in force.correlations)
        assert part.forecasts.n_forecasts == 0
        row = int(force.worst[1]) - 1
        worst = fit.residuals[0][row, fit.model.output_names.index("force_Y")]
        assert force.worst[3] == pytest.approx(abs(worst) / NOISE, rel=1e-6)
        sizes.append([force.worst[3], *sorted(abs(one.score) for one in force.correlations)])
    assert sizes[0] == pytest.approx(sizes[1], rel=1e-6)
    assert page_of(compare([SORTED.model], SORTED.dataset)).sections


def test_plot_of_tests_joins_nothing() -> None:
    """Rows are drawn by number, without a line from one to the next."""
    ax = plot_output(SORTED, "force_Y")
    assert ax.get_xlabel() == "test"
    assert all(line.get_linestyle() == "None" for line in ax.get_lines())
    assert ax.get_lines()[0].get_xdata() == pytest.approx(np.arange(1, 106))


def test_usual_candidates_are_not_made_of_a_towing_carriage() -> None:
    """Without candidates a search says what to do."""
    with pytest.raises(DataError, match="candidates"):
        improve(SORTED.model, Dataset(SORTED.dataset.records))
