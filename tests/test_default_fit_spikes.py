"""The default fit on records with spikes: close to the clean fit, no spikes taken for forces."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, State
from oed_sysid.data.record import Record
from oed_sysid.likelihood import multiple_shooting
from oed_sysid.likelihood.fit import Fit
from oed_sysid.runtime.display import told

NOISE = np.array([0.02, 0.003, 0.002])
TRUE = {"K": 0.09, "T": 9.0, "a": 0.012, "drag": 0.03}
SHIP = Model(
    "ship with speed",
    states=(
        State("u", "m/s", "speed", scale=2.0),
        State("psi", "rad", "heading"),
        State("r", "rad/s", "yaw rate", scale=0.05),
    ),
    inputs=(Input("rudder", "rad"), Input("thrust", "m/s^2")),
    outputs=(
        Output("u", "m/s", noise_std=NOISE[0]),
        Output("psi", "rad", noise_std=NOISE[1]),
        Output("r", "rad/s", noise_std=NOISE[2]),
    ),
    kinematics={
        "u": "push - a*u*abs(u) - drag*u**2*delta**2",
        "psi": "r",
        "r": "(K*u/2*delta - r)/T",
    },
    actuators={"delta": "rudder", "push": "thrust"},
    parameters=(
        Parameter("K", 0.07, "1/s"),
        Parameter("T", 12.0, "s", lower=0.5),
        Parameter("a", 0.015, "1/m"),
        Parameter("drag", 0.02, "1/m"),
    ),
    step=1.0,
)


def record(name: str, rng: np.random.Generator, period: float, force: float = 0.0) -> Record:
    """A zigzag by the clock at varying thrust, integrated by SciPy."""
    times = np.arange(0.0, 300.0, 1.0)
    rudder = 0.35 * np.sign(np.sin(2 * np.pi * times / period)) * (times > 10)
    thrust = 0.05 + 0.02 * np.sign(np.sin(2 * np.pi * times / 170.0))

    def rates(_: float, state: np.ndarray, delta: float, push: float, moved: float) -> list[float]:
        u, _psi, r = state
        return [
            push - TRUE["a"] * u * abs(u) - TRUE["drag"] * u**2 * delta**2,
            r,
            (TRUE["K"] * u / 2 * delta - r) / TRUE["T"] + moved,
        ]

    states = np.empty((len(times), 3))
    states[0] = 1.8, 0.1, 0.0
    moved, memory = 0.0, np.exp(-0.1)
    for k in range(len(times) - 1):
        now = solve_ivp(
            rates, (0.0, 1.0), states[k], args=(rudder[k], thrust[k], moved), rtol=1e-8, atol=1e-10
        )
        states[k + 1] = now.y[:, -1]
        if force:
            moved = memory * moved + force * np.sqrt(1 - memory**2) * rng.standard_normal()
    outputs = states + NOISE * rng.standard_normal(states.shape)
    return Record(name, times, np.column_stack([rudder, thrust]), outputs, SHIP.channels)


def clean(seed: int, force: float = 0.0) -> Dataset:
    """Two zigzags, with a random yaw acceleration of ten seconds if asked for."""
    rng = np.random.default_rng(seed)
    return Dataset((record("a", rng, 60.0, force), record("b", rng, 44.0, force)))


def spoilt(data: Dataset, seed: int, share: float, size: float, one_sided: bool) -> Dataset:
    """The same records with a share of samples off by so many noise levels."""
    rng = np.random.default_rng(1000 + seed)

    def outputs(one: Record) -> np.ndarray:
        hit = rng.random(one.outputs.shape) < share
        signs = 1.0 if one_sided else rng.choice([-1.0, 1.0], hit.shape)
        return one.outputs + hit * signs * size * NOISE

    return Dataset(tuple(one.with_outputs(outputs(one)) for one in data))


def largest_departure(fit: Fit, other: Fit) -> float:
    """Largest difference of two fits' values in standard errors of the second."""
    errors = other.std_errors
    return max(abs(fit.values[name] - other.values[name]) / errors[name] for name in fit.names)


@pytest.mark.parametrize("one_sided", [False, True])
@pytest.mark.parametrize("share", [0.005, 0.02, 0.05])
def test_spikes_do_not_become_process_noise(share: float, one_sided: bool) -> None:
    """Spikes of 5 to 50 noise levels: values and errors stay those of the clean records."""
    for seed in range(3):
        data = clean(seed)
        without = MultipleShooting().fit(SHIP, data)
        assert without.noise.is_white
        for size in (5.0, 20.0, 50.0):
            fit = MultipleShooting().fit(SHIP, spoilt(data, seed, share, size, one_sided))
            assert fit.status.ok
            # Spikes of five noise levels are partly within what normal noise does.
            small = size < 10.0
            assert fit.noise.is_white or small
            assert largest_departure(fit, without) < (4.0 if small else 1.5)
            for name, value in TRUE.items():
                assert abs(fit.values[name] / value - 1) < 0.2
                assert fit.std_errors[name] < (2.5 if small else 1.6) * without.std_errors[name]


def test_spikes_beside_process_noise() -> None:
    """Where forces act too, they are estimated as on clean records, and spikes are counted."""
    data = clean(3, force=2e-4)
    without = MultipleShooting().fit(SHIP, data)
    assert not without.noise.is_white
    assert not without.excluded
    fit = MultipleShooting().fit(SHIP, spoilt(data, 3, 0.02, 20.0, False))
    assert fit.status.ok
    assert not fit.noise.is_white
    assert largest_departure(fit, without) < 1.0
    excluded = [concern for concern in fit.concerns if "excluded as spikes" in concern.text]
    assert {concern.signal for concern in excluded} == {"u", "psi", "r"}


def test_a_failed_fit_with_process_noise_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where the fit with process noise fails, values are those without, and the report says so."""
    data = clean(1, force=2e-4)
    white = MultipleShooting(disturbances="none").fit(SHIP, data)

    def fails(*_args: object, **_options: object) -> None:
        raise np.linalg.LinAlgError("Eigenvalues did not converge")

    for failure in (fails, lambda *_args, **_options: None):
        monkeypatch.setattr(multiple_shooting, "fit_disturbed", failure)
        fit = MultipleShooting().fit(SHIP, data)
        assert fit.values == pytest.approx(white.values, rel=1e-6)
        (concern,) = [one for one in fit.concerns if one.kind == "process_noise"]
        assert "these values are from the fit without it" in concern.text
        assert told(concern.text) in fit.report()


def test_a_stalled_fit_with_process_noise_gives_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """A fit with process noise that stalls is not returned where the other one ended well."""
    data = clean(1, force=2e-4)
    real = multiple_shooting.fit_disturbed

    def stalls(*args: Any, **options: Any) -> Any:
        return replace(real(*args, **options), reason="stalled")

    monkeypatch.setattr(multiple_shooting, "fit_disturbed", stalls)
    fit = MultipleShooting().fit(SHIP, data)
    assert fit.status.ok
    assert fit.noise.is_white
    assert "process_noise" in {concern.kind for concern in fit.concerns}
    # Who names what is disturbed gets what came of it.
    assert MultipleShooting(disturbances="all").fit(SHIP, data).status.code == "stalled"


def test_an_unstable_vehicle_gets_a_status() -> None:
    """Moved filters that overflow along 200 s of an unstable vehicle end in a status, advised."""
    model = Model(
        "unstable in pitch",
        states=(State("theta", "rad", scale=0.1), State("q", "rad/s", scale=0.1)),
        inputs=(Input("fin", "rad"),),
        outputs=(Output("theta", "rad", noise_std=0.01), Output("q", "rad/s", noise_std=0.01)),
        kinematics={"theta": "q", "q": "a*theta - c*q + b*ds"},
        actuators={"ds": "fin"},
        parameters=(
            Parameter("a", 0.8, "1/s^2"),
            Parameter("c", 0.3, "1/s"),
            Parameter("b", 1.2, "1/s^2"),
        ),
        step=0.1,
    )
    rng, times = np.random.default_rng(0), 0.1 * np.arange(2000)
    turns = 2 * np.pi * times
    probe = 0.2 * np.sign(np.sin(turns / 7.0)) + 0.1 * np.sign(np.sin(turns / 3.1))
    state, moved, outputs, fin = np.array([0.05, 0.0]), 0.0, [], []
    for k in range(len(times)):  # steadied by feedback of what is measured
        outputs.append(state + 0.01 * rng.standard_normal(2))
        fin.append(-2.0 * outputs[k][0] - outputs[k][1] + probe[k])
        for _ in range(10):
            middle = state + 0.005 * _pitch(state, fin[k], moved)
            state = state + 0.01 * _pitch(middle, fin[k], moved)
        moved = np.exp(-0.05) * moved + 0.2 * np.sqrt(1 - np.exp(-0.1)) * rng.standard_normal()
    data = Dataset((Record("a", times, np.array(fin)[:, None], np.array(outputs), model.channels),))
    fit = MultipleShooting().fit(model, data)
    assert fit.status.ok or fit.status.advice
    assert np.isfinite(fit.estimates).all()


def _pitch(state: np.ndarray, fin: float, moved: float) -> np.ndarray:
    return np.array([state[1], state[0] - 0.4 * state[1] + fin + moved])
