"""The fits that an improvement returns: saved, loaded, predicting, and compared."""

from __future__ import annotations

import numpy as np
import pytest
from turning_ship import CANDIDATES, CUBIC, NOISE, SHIP, dataset

from oed_sysid import Dataset, Fit, Parameter, Record, compare, improve
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Sensor, sensor_bias

N3 = -15.0
BIASES = (0.02, -0.015)


@pytest.fixture(scope="module")
def found() -> Improvement:
    """A ship that lacks cubic damping, under a random yaw acceleration."""
    return improve(
        SHIP, dataset(11, N3, force=0.01), dataset(12, N3, force=0.01), candidates=CANDIDATES
    )


def test_every_step_is_a_fit(found: Improvement) -> None:
    """Nominal model and step are fits with noise model, innovations and errors that cover."""
    assert [step.added for step in found.steps] == ["cubic_damping"]
    assert len(found.fits) == 2
    for fit in found.fits:
        assert isinstance(fit, Fit)
        assert fit.noise is not None
        assert fit.noise.has_forces
        assert fit.innovations is not None
    last = found.fit
    for name, truth in (("K", 0.5), ("T", 4.0), ("n3", N3)):
        assert abs(last.values[name] - truth) < 4 * last.std_errors[name]
    assert last.log_likelihood - found.base_fit.log_likelihood > 10.0
    # What the step gained is the difference of the likelihoods of the two fits.
    gain = 2 * (last.log_likelihood - found.base_fit.log_likelihood)
    assert gain == pytest.approx(found.steps[0].gain, rel=0.1, abs=2.0)


def test_fits_are_saved_loaded_and_predict(found: Improvement, tmp_path) -> None:  # type: ignore[no-untyped-def]
    """A fit from its file predicts other records as the one that was written."""
    path = tmp_path / "improved.json"
    found.fit.save(path)
    again = Fit.load(path)
    other = dataset(13, N3)
    assert again.model.effect_names == ("cubic_damping",)
    assert again.predict(other).rms == pytest.approx(found.fit.predict(other).rms, rel=1e-9)
    assert again.log_likelihood == pytest.approx(found.fit.log_likelihood, rel=1e-9)
    errors = np.array(list(again.predict(other).rms.values()))
    np.testing.assert_allclose(errors, NOISE, rtol=0.2)


def test_the_error_table_is_what_compare_prints(found: Improvement) -> None:
    """Errors of every step, on training and validation records, are those of a comparison."""
    test = dataset(12, N3, force=0.01)
    names = list(SHIP.output_names)
    rms = [found.base_rms, *(step.rms for step in found.steps)]
    for records, key in ((found.fit.dataset, "train"), (test, "test")):
        compared = compare(list(found.fits), records)
        for part, errors in zip(compared.models, rms, strict=True):
            own = part.prediction.rms
            assert errors[key] == pytest.approx([own[name] for name in names], rel=1e-3)


def test_errors_in_units_of_the_noise_are_those_of_the_table(found: Improvement) -> None:
    """Relative errors follow from those of each output; both outputs have as many samples."""
    for errors, rms in (
        (found.base_error, found.base_rms),
        (found.final_error, found.steps[-1].rms),
    ):
        for key in ("train", "test"):
            expected = np.sqrt(np.mean((rms[key] / NOISE) ** 2))
            assert errors[key] == pytest.approx(expected, rel=1e-9)


def biased(seed: int, cubic: float = 0.0) -> Dataset:
    """Records of a ship whose gyro has another bias on each."""
    shifted: list[Record] = []
    for part, size in zip(dataset(seed, cubic), BIASES, strict=True):
        shifted.append(part.with_outputs(part.outputs + np.array([0.0, size])))
    return Dataset(shifted)


def test_a_bias_of_each_record_is_a_candidate() -> None:
    """Gyro biases that differ between records are claimed as such, each with its size."""
    bias = sensor_bias("bias_r", "r", "rad/s", scale=0.01, per_record=True)
    candidates = [CUBIC, CANDIDATES[1], bias]
    result = improve(SHIP, biased(21), biased(22), candidates=candidates)
    assert [step.added for step in result.steps] == ["bias_r"]
    assert "E_bias_r" not in result.fit.names
    for own, truth in zip(result.fit.local_values, BIASES, strict=True):
        assert own["E_bias_r"] == pytest.approx(truth, abs=0.002)
    assert result.final_error["test"] == pytest.approx(1.0, abs=0.08)


def test_a_bias_of_each_record_in_the_model_hides_nothing() -> None:
    """With record-wise biases in the nominal model the missing damping is found."""
    bias = Sensor(
        "bias", {"r": "r + b_r"}, (Parameter("b_r", 0.0, "rad/s", per_record=True, scale=0.01),)
    )
    candidates = [CUBIC, CANDIDATES[1]]
    result = improve(SHIP + bias, biased(31, N3), biased(32, N3), candidates=candidates)
    assert [step.added for step in result.steps] == ["cubic_damping"]
    assert abs(result.fit.values["n3"] - N3) < 4 * result.fit.std_errors["n3"]
    for own, truth in zip(result.fit.local_values, BIASES, strict=True):
        assert own["b_r"] == pytest.approx(truth, abs=0.003)
