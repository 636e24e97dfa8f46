"""Inputs that act reversed where the model couples them with other coefficients."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from marks import slow

from oed_sysid import (
    PRBS,
    Dataset,
    Experiment,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    Piecewise,
    State,
    improve,
)
from oed_sysid.evidence.check import check, with_estimates
from oed_sysid.experiments.simulation import simulate
from oed_sysid.likelihood.input_factors import input_factors
from oed_sysid.physics import quadratic_drag
from oed_sysid.physics.bodies import rigid_body

BODY = rigid_body(
    ("surge", "sway", "yaw"),
    mass=400.0,
    inertia=300.0,
    added_mass={"X_udot": -20.0, "Y_vdot": -300.0, "Y_rdot": -20.0, "N_rdot": -200.0},
    position=(),
)
TRUE = {"X_absuu": -30.0, "Y_uv": -200.0, "Y_ur": 40.0, "N_uv": -60.0, "N_ur": -180.0}
BEGUN = {"X_absuu": -36.0, "Y_uv": -170.0, "Y_ur": 50.0, "N_uv": -45.0, "N_ur": -230.0}


def boat(values: dict[str, float], lift: float, *, lower: float = -np.inf) -> Model:
    """A boat whose rudder sees the flow at its place, so that it damps as well as steers."""
    slope = Parameter("L_rudder", lift, "kg/m", lower=lower)
    return BODY.model(
        "boat",
        inputs=(Input("rudder", "rad"), Input("thrust", "N")),
        actuators={"d": "rudder", "T": "thrust"},
        effects=(
            BODY.hull(values),
            BODY.fin("rudder", "d", at=(-1.5, 0, 0), normal="vertical", lift=slope),
            BODY.thruster("propeller", "T"),
        ),
        noise={"u": 0.02, "v": 0.02, "r": 0.003},
        step=0.1,
    )


def records(seed: int, reads: float) -> Dataset:
    """Two runs of the true boat, whose log holds the rudder times a factor."""
    rng, model = np.random.default_rng(seed), boat(TRUE, 35.0)
    found = []
    for name, thrust in (("slow", 80.0), ("fast", 150.0), ("other", 110.0)):
        steps = PRBS("rudder", 0.2, bit_time=1.0, seed=int(rng.integers(1, 100)))
        run = Experiment(
            name, steps, duration=25.0, sample_time=0.1,
            constants={"thrust": thrust}, initial={"u": np.sqrt(thrust / 30.0)},
        )  # fmt: skip
        one = simulate(model, run, rng=rng)
        found.append(replace(one, inputs=one.inputs * [reads, 1.0]))
    return Dataset(found)


@pytest.mark.parametrize(("lower", "seed"), [(-np.inf, 1), *slow((-np.inf, 2), (0.0, 1), (0.0, 2))])
def test_a_reversed_rudder_that_other_coefficients_make_up_for_is_named(
    lower: float, seed: int
) -> None:
    """The flow at the rudder asks for other hull derivatives; a bound hides the sign itself."""
    data = records(seed, -1.0)
    fit = MultipleShooting().fit(boat(BEGUN, 28.0, lower=lower), data)
    (said,) = input_factors(fit, fit.nominal)
    assert (said.reading.names, said.reading.factor) == (("rudder",), -1.0)
    assert "L_rudder" in said.values
    assert said.held == (() if lower < 0.0 else ("L_rudder",))
    assert [(c.kind, c.signal) for c in fit.concerns if c.kind == "input_factor"] == [
        ("input_factor", "rudder")
    ]
    if fit.status.ok:
        assert fit.report().startswith(f"Do not use these values: {said.text}")
    log = with_estimates(check(data, fit.model), fit)
    assert [f.signals for f in log.serious if f.kind == "input_factor"] == [("rudder",)]


@pytest.mark.parametrize("begun", [{"N_uv": 45.0}, *slow({}, {"Y_ur": -50.0})])
@pytest.mark.parametrize("lower", [0.0, *slow(-np.inf)])
def test_a_right_rudder_is_not_accused(lower: float, begun: dict[str, float]) -> None:
    """Also where a coefficient of the hull was expected with the other sign."""
    fit = MultipleShooting().fit(boat(BEGUN | begun, 28.0, lower=lower), records(3, 1.0))
    assert fit.values["L_rudder"] == pytest.approx(35.0, rel=0.1)
    assert input_factors(fit, fit.nominal) == ()


@pytest.mark.slow
def test_a_rudder_that_does_nothing_is_at_its_bound_and_not_reversed() -> None:
    """A lift of zero ends at its bound as often as not; the reversed rudder explains no more."""
    data = records(4, 1.0)
    rng = np.random.default_rng(0)
    foreign = [replace(r, inputs=rng.permutation(r.inputs)) for r in data]
    fit = MultipleShooting().fit(boat(BEGUN, 28.0, lower=0.0), Dataset(foreign))
    assert input_factors(fit, fit.nominal) == ()


@pytest.mark.slow
def test_nothing_is_searched_for_in_records_of_a_reversed_rudder() -> None:
    """What a search would add replaces the rudder; the log is suspect and nothing certified."""
    data = records(5, -1.0)
    train, test = Dataset((data[0], data[1])), Dataset((data[2],))
    drag = replace(quadratic_drag("drag", "N", "r"), terms={"r": "-E_drag*r*abs(r)"})
    found = improve(boat(BEGUN, 28.0, lower=0.0), train, test, candidates=[drag])
    assert not found.steps
    assert found.remains.kind == "log suspect"
    assert [f.signals for f in found.log.serious if f.kind == "input_factor"] == [("rudder",)]


TWIN = {"k": 4.0, "b": 0.9, "L_rudders": 12.0, "d_u": 60.0, "d_r": 900.0}


def twin(values: dict[str, float], priors: dict[str, float | None] | None = None) -> Model:
    """A boat of two screws and two rudders with shared coefficients and no declared priors."""
    push, turn = "(n_p*abs(n_p) + n_s*abs(n_s))", "(n_p*abs(n_p) - n_s*abs(n_s))"
    units = {"k": "kg m", "b": "m", "L_rudders": "kg", "d_u": "kg/m", "d_r": "kg m^2/s"}
    return Model(
        "twin",
        states=(State("u", "m/s", scale=2.0), State("r", "rad/s", scale=0.1)),
        inputs=(Input("n_p", "1/s"), Input("n_s", "1/s"), Input("d_p", "rad"), Input("d_s", "rad")),
        outputs=(Output("u", "m/s", noise_std=0.03), Output("r", "rad/s", noise_std=0.003)),
        kinematics={
            "u": f"(k*{push} - d_u*u*abs(u))/1100",
            "r": f"(k*b*{turn} + L_rudders*u**2*(d_p + d_s) - d_r*r)/2200",
        },
        parameters=tuple(
            Parameter(name, value, units[name], prior_std=(priors or {}).get(name))
            for name, value in values.items()
        ),
        step=0.2,
    )


def twin_records(seed: int) -> Dataset:
    """Two runs of steps of all four commands."""
    rng, found, names = np.random.default_rng(seed), [], ("n_p", "n_s", "d_p", "d_s")
    times = np.arange(0.0, 80.0, 8.0)
    for name in ("one", "two"):
        steps = rng.uniform(-1.0, 1.0, (times.size, 4))
        inputs = [7.0, 7.0, 0.0, 0.0] + steps * [4.0, 4.0, 0.4, 0.4]
        inputs[:, 3] = inputs[:, 2] + 0.1 * steps[:, 3]
        commands = [Piecewise(n, times, row) for n, row in zip(names, inputs.T, strict=True)]
        run = Experiment(name, commands, duration=80.0, sample_time=0.2, initial={"u": 1.5})
        found.append(simulate(twin(TWIN), run, rng=rng))
    return Dataset(found)


LOGGED = {
    "right": ([0, 1, 2, 3], [1.0, 1.0, 1.0, 1.0], ()),
    "exchanged": ([1, 0, 2, 3], [1.0, 1.0, 1.0, 1.0], ("n_p", "n_s")),
    "both reversed": ([0, 1, 2, 3], [1.0, 1.0, -1.0, -1.0], ("d_p", "d_s")),
    "both in degrees": ([0, 1, 2, 3], [1.0, 1.0, *[180.0 / np.pi] * 2], ("d_p", "d_s")),
}


@pytest.mark.parametrize("logged", LOGGED)
def test_inputs_that_share_coefficients_are_read_together(logged: str) -> None:
    """What two inputs do is told by one coefficient: neither alone explains its sign or size."""
    order, factors, expected = LOGGED[logged]
    data = Dataset([replace(r, inputs=r.inputs[:, order] * factors) for r in twin_records(1)])
    begun = {"k": 4.4, "b": 0.8, "L_rudders": 10.0, "d_u": 70.0, "d_r": 800.0}
    fit = MultipleShooting().fit(twin(begun), data)
    assert fit.status.ok
    assert [one.reading.names for one in input_factors(fit, fit.nominal)] == [expected][
        : bool(expected)
    ]
    told = twin(begun, {name: 0.25 * value for name, value in begun.items()})
    log = check(data, told)
    assert [set(one.signals) for one in log.serious] == [{*expected}][: bool(expected)]


@pytest.mark.parametrize("late", [0, 3])
def test_delays_of_inputs_are_told_without_priors(late: int) -> None:
    """No coefficient makes a vehicle move before its command; signs are left open."""
    data = twin_records(2)
    moved = [np.vstack([r.inputs[:1].repeat(late, axis=0), r.inputs[: r.n_samples - late]])
             for r in data]  # fmt: skip
    both = [
        np.column_stack([new[:, :2], r.inputs[:, 2:]]) for new, r in zip(moved, data, strict=True)
    ]
    logged = Dataset([replace(r, inputs=new) for r, new in zip(data, both, strict=True)])
    begun = {"k": 2.0, "b": 1.5, "L_rudders": 25.0, "d_u": 30.0, "d_r": 1800.0}
    found = check(logged, twin(begun))
    expected = [("delay", (name,)) for name in ("n_p", "n_s") if late]
    assert sorted((one.kind, one.signals) for one in found.serious) == expected
    assert all(one.size == pytest.approx(0.2 * late, abs=0.03) for one in found.serious)
    states = {one.fault: one.state for one in found.judged if one.signal == "n_p"}
    assert states["sign"] == "not tested"
    assert states["delay"] == ("found" if late else "tested")


def test_an_output_that_counts_the_other_way_is_named() -> None:
    """Heel is in nothing else that was measured: its coefficients turn, and no input does."""

    def rolls(c: float, b: float) -> Model:
        return Model(
            "ferry",
            states=(State("r", "rad/s", scale=0.02), State("phi", "rad"), State("p", "rad/s")),
            inputs=(Input("rudder", "rad"),),
            outputs=(Output("r", "rad/s", noise_std=0.001), Output("p", "rad/s", noise_std=0.002)),
            kinematics={
                "r": "(K*rudder - r)/T",
                "phi": "p",
                "p": "-0.4*phi - 0.1*p + c*r - b*rudder",
            },
            parameters=(
                Parameter("K", 0.1, "1/s"),
                Parameter("T", 9.0, "s"),
                Parameter("c", c, "1/s"),
                Parameter("b", b, "1/s^2"),
            ),
            step=0.5,
        )

    steps = PRBS("rudder", 0.3, bit_time=8.0, seed=4)
    run = Experiment("one", steps, duration=240.0, sample_time=0.5)
    record = simulate(rolls(0.5, 0.04), run, rng=np.random.default_rng(1))
    for turned, begun, expected in (
        ([1.0, -1.0], (0.4, 0.05), ("p",)),
        ([1.0, 1.0], (0.4, 0.05), ()),
        ([1.0, 1.0], (-0.4, 0.05), ()),  # a start value of the wrong sign among right ones
    ):
        data = Dataset([record.with_outputs(record.outputs * turned)])
        fit = MultipleShooting().fit(rolls(*begun), data)
        found = input_factors(fit, fit.nominal)
        assert [one.reading.names for one in found] == [expected] * bool(expected)
        log = with_estimates(check(data, fit.model), fit)
        assert [f.signals for f in log.serious] == [expected] * bool(expected)
