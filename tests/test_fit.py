"""What a fit says about itself: numbers against direct computation, words, files."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import norm
from test_information import ar1
from yaw_vehicle import NOISE, yaw_data, yaw_model

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.display import rounded


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit with a gap in its data and one local parameter."""
    data = yaw_data(1)
    outputs = data[1].outputs.copy()
    outputs[10:30, 0] = np.nan
    data = Dataset((data[0], data[1].with_outputs(outputs), data[2]))
    model = yaw_model(K=Parameter("K", 0.1, "1/s", per_record=True))
    return MultipleShooting(noise=NOISE).fit(model, data)


def test_frame_holds_what_the_table_says(fit: Fit) -> None:
    """Values, errors and intervals of the frame are those of the fit."""
    frame = fit.to_dataframe()
    assert list(frame.index) == list(fit.names)
    for name in fit.names:
        assert frame.loc[name, "value"] == fit.values[name]
        assert (frame.loc[name, "low"], frame.loc[name, "high"]) == fit.interval(name)
        assert frame.loc[name, "unit"] == fit.model.parameter(name).unit


def test_likelihood_and_criteria(fit: Fit) -> None:
    """Log-likelihood, AIC and BIC agree with densities added up one by one."""
    total = 0.0
    for residual in fit.residuals:
        densities = norm.logpdf(residual, scale=NOISE)
        total += float(np.nansum(densities))
    assert fit.log_likelihood == pytest.approx(total)
    n_unknowns = 2 + 3 * (2 + 1)
    assert fit.n_unknowns == n_unknowns
    assert fit.n_observations == 2 * (200 + 120 + 61) - 20
    assert fit.aic == pytest.approx(2 * n_unknowns - 2 * total)
    assert fit.bic == pytest.approx(n_unknowns * np.log(fit.n_observations) - 2 * total)


def test_residuals_are_measured_minus_model(fit: Fit) -> None:
    """Residuals, predictions and root mean squares belong together."""
    for record, prediction, residual in zip(
        fit.dataset, fit.predictions, fit.residuals, strict=True
    ):
        assert np.allclose(record.outputs - prediction, residual, equal_nan=True)
    stacked = np.vstack(fit.residuals)
    assert fit.rms["psi"] == pytest.approx(np.sqrt(np.nanmean(stacked[:, 0] ** 2)))
    assert fit.normalised_rms == pytest.approx(np.sqrt(np.nanmean((stacked / NOISE) ** 2)))


def test_interval_and_correlation(fit: Fit) -> None:
    """Intervals are normal quantiles; the correlation has ones on its diagonal."""
    low, high = fit.interval("T", 0.9)
    assert high - low == pytest.approx(2 * 1.6448536 * fit.std_errors["T"])
    assert 0.5 * (high + low) == pytest.approx(fit.values["T"])
    assert np.allclose(np.diag(fit.correlation), 1.0)


def test_report_holds_what_a_paper_needs(fit: Fit) -> None:
    """Records, observations, status, every parameter with its error and every output."""
    text = fit.report()
    for piece in ("yaw fitted by multiple shooting", "a, b, c", "742", "converged", "std. error"):
        assert piece in text
    for name, value in fit.values.items():
        assert f"{name} " in text
        assert rounded(value, fit.std_errors[name]) in text
    assert "rms residual" in text
    assert "K per record: a 0.1" in text
    assert "None" not in text
    assert "nan" not in text


def test_report_names_idle_inputs() -> None:
    """A rudder that never moves is said to excite nothing, and what it does is not identifiable."""
    data = Dataset(
        tuple(
            record.__class__(
                record.name,
                record.times,
                np.zeros_like(record.inputs),
                record.outputs,
                record.channels,
            )
            for record in yaw_data(2)
        )
    )
    report = MultipleShooting(noise="estimate").fit(yaw_model(), data).report()
    assert "Input delta never moves in any record" in report
    assert "Not identifiable: K does not influence any output" in report


def test_saved_fit_comes_back(fit: Fit, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A fit read from its file reports, predicts and continues as the original."""
    path = tmp_path / "fit.json"
    fit.save(path)
    json.loads(path.read_text(), parse_constant=lambda text: pytest.fail(f"{text} is not JSON"))
    again = Fit.load(path)
    assert again.model == fit.model
    assert again.report() == fit.report()
    assert np.array_equal(again.covariance, fit.covariance)
    for first, second in zip(fit.residuals, again.residuals, strict=True):
        assert np.array_equal(first, second, equal_nan=True)
    resumed = MultipleShooting(noise=NOISE).fit(again.model, again.dataset, warm=again)
    assert resumed.iterations <= 2


def test_infinite_errors_survive_the_file(tmp_path) -> None:  # type: ignore[no-untyped-def]
    """What is not identifiable is still so after loading."""
    data = yaw_data(3)
    model = yaw_model().with_values({"K": 0.0, "alpha": 1.0}).fix("K")
    quiet = Dataset(tuple(r.with_outputs(0.0 * r.outputs + NOISE) for r in data))
    fit = MultipleShooting(noise=NOISE).fit(model, quiet)
    fit.save(tmp_path / "fit.json")
    assert np.array_equal(Fit.load(tmp_path / "fit.json").covariance, fit.covariance)


@pytest.mark.parametrize("content", ["{}", "not json", '{"fit": {"class": "Popen", "fields": {}}}'])
def test_other_files_are_refused(tmp_path, content: str) -> None:  # type: ignore[no-untyped-def]
    """A file that holds no fit is an error that says what to do; nothing in it is executed."""
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(DataError, match="saved fit"):
        Fit.load(path)
    with pytest.raises(DataError, match="cannot be read"):
        Fit.load(tmp_path / "absent.json")


def test_coloured_residuals_widen_the_errors() -> None:
    """Slow noise of the same size gives larger, honest errors, and the report says why."""
    rng = np.random.default_rng(4)
    white = yaw_data(4, noise=np.zeros(2))
    slow = Dataset(
        tuple(
            record.with_outputs(record.outputs + NOISE * ar1(record.n_samples, 0.9, rng, 2))
            for record in white
        )
    )
    white_only = MultipleShooting(noise=NOISE, disturbances="none")
    fit = white_only.fit(yaw_model(), slow)
    plain = replace(white_only, coloured="never").fit(yaw_model(), slow)
    assert fit.coloured
    assert "correlated in time" in fit.report()
    ratio = np.sqrt(np.diag(fit.covariance) / np.diag(plain.covariance))
    # Independent samples are (1 - 0.9) / (1 + 0.9) of all: errors are up to 4.4 times larger.
    assert np.all(ratio > 1.5)
    assert np.all(ratio < 6.0)
    never = MultipleShooting(noise=NOISE).fit(yaw_model(), yaw_data(4))
    assert not never.coloured


def test_dictionary_is_plain(fit: Fit) -> None:
    """The fit as plain data passes through JSON."""
    data = json.loads(json.dumps(fit.to_dict()))
    assert [p["name"] for p in data["parameters"]] == list(fit.names)
    assert data["status"]["code"] == "converged"
