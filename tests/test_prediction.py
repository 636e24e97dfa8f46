"""Predictions of unseen records: what they assume and whether their bands hold."""

from __future__ import annotations

import numpy as np
import pytest
from yaw_vehicle import NOISE, TRUE, simulate_yaw, yaw_data, yaw_model, yaw_record

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting


@pytest.fixture(scope="module")
def fit() -> Fit:
    """A fit to a short record, so that its uncertainty matters."""
    data = Dataset((yaw_record("train", np.random.default_rng(0), n=80),))
    return MultipleShooting(noise=NOISE, coloured="never").fit(yaw_model(), data)


def new_record(seed: int, **options: object) -> Dataset:
    """A record that the fit has not seen."""
    rng = np.random.default_rng(100 + seed)
    return Dataset((yaw_record("test", rng, n=150, period=50.0, **options),))


def test_given_initial_state_is_used_as_it_is(fit: Fit) -> None:
    """With the state given, the prediction is the plain simulation."""
    data = new_record(0)
    prediction = fit.predict(data, initial={"psi": 0.1, "r": 0.01})
    record = data[0]
    expected = simulate_yaw(record.times, record.inputs[:, 0], np.array([0.1, 0.01]), fit.values)
    assert np.allclose(prediction.outputs[0], expected, atol=1e-10)
    assert np.all(prediction.model_std[0][0] < 1e-12)


def test_estimated_initial_state_is_the_least_squares_one(fit: Fit) -> None:
    """With parameters held, the initial state minimises the misfit on that record."""
    data = new_record(1)
    prediction = fit.predict(data)
    own = np.array(list(prediction.initial_states[0].values()))
    record = data[0]

    def cost(start: np.ndarray) -> float:
        model = simulate_yaw(record.times, record.inputs[:, 0], start, fit.values)
        return float(np.sum(((record.outputs - model) / NOISE) ** 2))

    for change in np.vstack([np.eye(2), -np.eye(2)]) * 1e-4:
        assert cost(own) < cost(own + change)
    assert prediction.way == "fit"
    assert "all shared parameters held" in prediction.report()


def test_bands_are_those_of_a_monte_carlo() -> None:
    """Model bands equal the spread of predictions over many training sets."""
    target = new_record(2, noise=np.zeros(2))
    given = {"psi": 0.1, "r": 0.01}
    predictions, stds = [], []
    for seed in range(150):
        train = Dataset((yaw_record("train", np.random.default_rng(seed), n=80),))
        fit = MultipleShooting(noise=NOISE, coloured="never").fit(yaw_model(), train)
        prediction = fit.predict(target, initial=given)
        predictions.append(prediction.outputs[0])
        stds.append(prediction.model_std[0])
    spread, stated = np.std(predictions, axis=0), np.median(stds, axis=0)
    late = slice(20, None)
    assert np.median(stated[late] / spread[late]) == pytest.approx(1.0, abs=0.12)


@pytest.mark.parametrize("initial", ["fit", "first"])
def test_bands_cover_new_measurements(fit: Fit, initial: str) -> None:
    """Bands of model and noise cover about 95 % of new samples."""
    shares = []
    for seed in range(30):
        shares.append(fit.predict(new_record(seed), initial=initial).coverage())
    for name in ("psi", "r"):
        mean = np.mean([share[name] for share in shares])
        # From a single sample the whole record errs together: thirty records say less.
        assert mean > (0.92 if initial == "fit" else 0.85)
        assert initial == "first" or mean < 0.98


def test_prediction_knows_missing_samples(fit: Fit) -> None:
    """Outputs are predicted at every time; only measured samples count in the errors."""
    record = new_record(3)[0]
    outputs = record.outputs.copy()
    outputs[:, 1] = np.nan
    outputs[::2, 0] = np.nan
    prediction = fit.predict(Dataset((record.with_outputs(outputs),)))
    assert np.isfinite(prediction.outputs[0]).all()
    assert np.isfinite(prediction.std[0]).all()
    assert np.isnan(prediction.rms["r"])
    assert prediction.rms["psi"] < 2 * NOISE[0]


def test_training_record_is_reproduced(fit: Fit) -> None:
    """On its own record the prediction is the fit."""
    prediction = fit.predict(fit.dataset)
    assert np.allclose(prediction.outputs[0], fit.predictions[0], atol=1e-6)


@pytest.mark.parametrize(
    ("initial", "words"),
    [("last", "Choose 'fit'"), ({"psi": 0.0}, "value for each"), ({"yaw": 0.0}, "value for each")],
)
def test_unclear_initial_states_are_refused(fit: Fit, initial: object, words: str) -> None:
    """What the prediction starts from has to be clear."""
    with pytest.raises(DataError, match=words):
        fit.predict(new_record(0), initial=initial)


def test_identifiable_combination_predicts_with_finite_bands() -> None:
    """A parameter that does not matter leaves bands finite; one that does makes them infinite."""
    data = yaw_data(5)
    model = yaw_model()
    still = Dataset(
        tuple(type(r)(r.name, r.times, 0 * r.inputs, r.outputs, r.channels) for r in data)
    )
    fit = MultipleShooting(noise=NOISE, coloured="never").fit(model, still)
    assert np.isinf(fit.std_errors["K"])
    assert np.isfinite(fit.predict(still).std[0]).all()
    assert np.isinf(fit.predict(data).std[0]).any()
    assert TRUE["K"] > 0
