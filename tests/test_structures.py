"""Averages of structures that records do not separate."""

from __future__ import annotations

import json

import numpy as np
import pytest

from oed_sysid import Dataset, Force, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.errors import DataError, ModelError, SimulationError
from oed_sysid.likelihood.captive import CaptiveTests
from oed_sysid.prediction.structures import Structure, average_structures, ladder, peak_input
from tests.turning_ship import record as turning_record

SHOOTING = MultipleShooting(disturbances="none")
TIMES = np.arange(0.0, 10.0, 0.2)


def body(drag: str, *parameters: str) -> Model:
    """A body that slows down."""
    force = Force("drag", {"X": drag}, tuple(Parameter(name, 1.0, "1") for name in parameters))
    return Model(
        drag,
        (State("u", "m/s"),),
        (),
        (Output("u", "m/s", noise_std=0.01),),
        axes={"X": "u"},
        inertia={("X", "u"): "10"},
        effects=(force,),
    )


LINEAR = Structure("linear", body("-a*u", "a"), SHOOTING)
QUADRATIC = Structure("quadratic", body("-b*u*abs(u)", "b"), SHOOTING)
CUBIC = Structure("cubic", body("-d*u**3", "d"), SHOOTING)


def runs(*speeds: float) -> Dataset:
    """Quadratic drag of 2 kg/m, integrated in closed form, with noise."""
    rng = np.random.default_rng(0)
    records = []
    for speed in speeds:
        clean = speed / (1 + 0.2 * speed * TIMES[:, None])
        noisy = clean + 0.01 * rng.standard_normal(clean.shape)
        empty = np.empty((len(TIMES), 0))
        records.append(Record(f"from {speed}", TIMES, empty, noisy, LINEAR.model.channels))
    return Dataset(tuple(records))


def resistance(fit) -> dict[str, float]:
    """Resistance at 4 m/s, twice the strongest record."""
    powers = {"a": 4.0, "b": 16.0, "d": 64.0}
    return {"resistance": sum(fit.values[name] * powers[name] for name in fit.names)}


def first(run: Record) -> float:
    """Strength: speed at the start."""
    return float(run.output("u")[0])


def test_the_right_structure_carries_the_average() -> None:
    """Weights are the scores to minus the fourth, and the interval holds the truth."""
    average = average_structures(
        (LINEAR, QUADRATIC, CUBIC),
        runs(0.5, 1.0, 1.5, 2.0),
        purpose=resistance,
        strength=first,
        horizon=5.0,
    )
    best = average.structures[0]
    assert best.name == "quadratic"
    assert best.weight > 0.9
    low, high = average.interval("resistance")
    assert low < 32.0 < high
    scores = np.array([one.score for one in average.structures])
    weights = np.array([one.weight for one in average.structures])
    assert weights == pytest.approx(scores**-4.0 / np.sum(scores**-4.0))
    expected = sum(one.weight * one.values["resistance"] for one in average.structures)
    assert average.values["resistance"] == pytest.approx(expected)
    spread = average.between["resistance"] ** 2 + average.within["resistance"] ** 2
    floor = 0.015 * average.values["resistance"]
    assert average.std["resistance"] == pytest.approx(np.sqrt(spread + floor**2))
    assert json.loads(json.dumps(average.to_dict()))["structures"][0]["name"] == "quadratic"


def test_forces_nobody_fitted_decide_where_records_cannot() -> None:
    """Slow runs alone leave the power open; a towing test at 4 m/s closes it."""
    slow = runs(0.5, 0.55, 0.6)
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0, "power": 2.0}
    without, with_tests = (
        average_structures((LINEAR, QUADRATIC), slow, tests=tests, **settings)
        for tests in (None, towing)
    )
    share = [
        next(one.weight for one in average.structures if one.name == "quadratic")
        for average in (without, with_tests)
    ]
    assert share[1] > share[0]
    errors = [abs(average.values["resistance"] - 32.0) for average in (without, with_tests)]
    assert errors[1] < errors[0]


def test_what_fails_weighs_nothing_and_is_named() -> None:
    """A purpose that one structure cannot serve takes it out of the average."""

    def picky(fit) -> dict[str, float]:
        if fit.names == ("a",):
            raise SimulationError("It never turns. Look elsewhere.")
        return resistance(fit)

    data = runs(0.5, 1.0, 2.0)
    average = average_structures(
        (LINEAR, QUADRATIC), data, purpose=picky, strength=first, horizon=5.0
    )
    assert [one.weight for one in average.structures] == pytest.approx([1.0, 0.0])
    assert average.structures[1].note == "It never turns"
    assert average.between["resistance"] == 0.0
    with pytest.raises(ModelError, match="No structure gives"):
        average_structures((LINEAR, LINEAR), data, purpose=picky, strength=first, horizon=5.0)


def test_the_ladder_goes_from_weak_to_strong() -> None:
    """Records of one strength stay together, three rungs at most, the strongest never trained."""
    data = runs(0.5, 0.51, 1.0, 1.5, 2.0, 2.5)
    rungs = ladder(data, first)
    assert [len(weaker) for weaker, _ in rungs] == [3, 4, 5]
    assert all("from 2.5" in stronger for _, stronger in rungs)
    with pytest.raises(DataError, match="No two records"):
        ladder(runs(1.0, 1.001), first)
    zigzag = turning_record("zigzag", np.random.default_rng(0))
    assert peak_input("rudder")(zigzag) == 0.5


def test_judges_are_not_trained_on() -> None:
    """A structure that was fitted to the tests may not be judged by them."""
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    informed = Structure("informed", QUADRATIC.model, SHOOTING, towing)
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0}
    data = runs(0.5, 1.0, 2.0)
    with pytest.raises(ModelError, match="shall judge"):
        average_structures((informed, LINEAR), data, tests=towing, **settings)
    both = average_structures((informed, LINEAR), data, **settings)
    assert both.structures[0].name == "informed"
    assert both.values["resistance"] == pytest.approx(32.0, rel=0.02)


def test_copies_and_parts_of_the_judges_are_recognised() -> None:
    """Tests are compared by what they hold: motion, inputs and a force, not by who holds them."""
    towing = CaptiveTests("towing", {"u": [3.0, 4.0]}, {}, {"X": [-18.0, -32.0]}, {"X": 0.5})
    part = CaptiveTests("half", {"u": [4.0, 5.0]}, {}, {"X": [-32.0, -50.0]}, {"X": 1.0})
    again = CaptiveTests("again", {"u": [3.0, 4.0]}, {}, {"X": [-18.3, -31.8]}, {"X": 0.5})
    assert [towing.shared(other) for other in (towing, part, again)] == [2, 1, 0]
    settings = {"purpose": resistance, "strength": first, "horizon": 5.0}
    data = runs(0.5, 1.0, 2.0)
    for fitted, words in ((part, "1 of the 2 tests"), (towing, "2 of the 2 tests")):
        copy = CaptiveTests("copy", fitted.motions, {}, fitted.forces, fitted.noise)
        informed = Structure("informed", QUADRATIC.model, SHOOTING, copy)
        with pytest.raises(ModelError, match=words):
            average_structures((informed, LINEAR), data, tests=towing, **settings)
    repeated = Structure("repeated", QUADRATIC.model, SHOOTING, again)
    found = average_structures((repeated, LINEAR), data, tests=towing, **settings)
    assert found.structures[0].name == "repeated"


def of_zero(fit) -> dict[str, float]:
    """A wanted quantity, and one that is zero."""
    return {**resistance(fit), "side": 0.0}


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"purpose": of_zero}, "Quantity 'side' is 0 with structure 'linear'"),
        ({"purpose": lambda fit: {}}, "gives no quantity"),
        ({"purpose": lambda fit: fit.values}, "gives a with structure 'linear' and b with"),
        ({"scored": ["resistence"]}, "'resistence', which is none of .* 'resistance'"),
        ({"power": -4.0}, "power is -4.0. Give a number above zero"),
        ({"floor": -0.5}, "floor is -0.5. Give a share"),
        ({"horizon": 0.0}, "horizon is 0.0. Give seconds above zero"),
    ],
)
def test_settings_that_give_no_weights_are_refused(settings: dict, words: str) -> None:
    """Nothing about zero, no unknown or differing quantity, no negative power is averaged."""
    usual = {"purpose": resistance, "strength": first, "horizon": 5.0, **settings}
    with pytest.raises(ModelError, match=words):
        average_structures((LINEAR, QUADRATIC), runs(0.5, 1.0, 2.0), **usual)


def test_what_is_about_zero_may_be_wanted_and_not_scored() -> None:
    """The report leaves shares of nothing out."""
    usual = {"purpose": of_zero, "strength": first, "horizon": 5.0}
    average = average_structures(
        (LINEAR, QUADRATIC), runs(0.5, 1.0, 2.0), scored=["resistance"], **usual
    )
    assert average.values["side"] == 0.0
    (line,) = [line for line in average.report().splitlines() if line.startswith("  side")]
    assert line.split()[1:] == ["0", "0", "to", "0", "-", "-", "-"]
