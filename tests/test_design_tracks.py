"""Sea room, abort rules, other structures and waves in the caution, and files for autopilots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_design import LIMITS, quick, ship

from oed_sysid import (
    Dataset,
    Experiment,
    Force,
    Input,
    Limits,
    Model,
    MultipleShooting,
    NoiseModel,
    Output,
    Parameter,
    State,
)
from oed_sysid.design import (
    Caution,
    Design,
    Servo,
    assess_limits,
    write_bag,
    write_overrides,
)
from oed_sysid.design.vehicles import LimitBounds, Scenarios, in_waves
from oed_sysid.errors import DesignError, FileError
from oed_sysid.experiments.manoeuvres import Doublet, Piecewise
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.results import figure_card
from oed_sysid.results.design_plots import DANGER

SEA = NoiseModel(
    np.array([5e-3, 2e-3]),
    np.zeros(2),
    np.array([0.01]),
    force_time=3.0,
    outputs=("psi", "r"),
    places=("force r",),
)
RUN = Experiment(
    "doublet",
    Doublet("rudder", 0.1, pulse_time=10.0),
    duration=40.0,
    sample_time=0.5,
    limits=Limits(signals=LIMITS.signals),
)


@pytest.fixture(scope="module", name="design")
def _design() -> Design:
    """A small design whose limits are judged on vehicles up to 40 % off."""
    found = quick()
    safe = assess_limits(
        found.model, found.experiment, rng=np.random.default_rng(0), spread=0.4, vehicles=60
    )
    return replace(found, assurance=safe)


def turning() -> Model:
    """A vehicle that turns on a circle at a speed that it keeps."""
    return Model(
        "circle",
        (State("u", "m/s"), State("psi", "rad"), State("r", "rad/s")),
        (Input("rudder", "rad"),),
        (Output("psi", "rad", noise_std=0.01),),
        {"u": "0*rudder", "psi": "r", "r": "(K*rudder - r)/0.01"},
        parameters=(Parameter("K", 0.1, "1/s"),),
        step=0.005,
    )


def test_the_track_of_a_circle_is_a_circle_and_its_room_the_diameter() -> None:
    """At 2 m/s and 0.05 rad/s the radius is 40 m, all of it to starboard."""
    run = Experiment(
        "turn",
        Piecewise("rudder", [0.0], [0.5]),
        duration=130.0,
        sample_time=0.5,
        initial={"u": 2.0, "r": 0.05},
    )
    found = assess_limits(
        turning(), run, rng=np.random.default_rng(0), spread=0.01, vehicles=20
    ).tracks
    assert found is not None
    assert not found.is_vertical
    centre = found.nominal - np.array([0.0, 40.0])
    np.testing.assert_allclose(np.hypot(*centre.T), 40.0, atol=0.15)
    np.testing.assert_allclose(found.room, [[-40, 40], [0, 80]], atol=1.5)
    assert any("L)" in words for words in replace(found, length=10.0).words())
    assert assess_limits(ship(), RUN, rng=np.random.default_rng(0), vehicles=20).tracks is None


def test_waves_push_the_vehicles_of_the_search() -> None:
    """An uncertain vehicle in waves does what the simulator says of it with the same forces."""
    model = ship()
    bounds = LimitBounds.of(model, LIMITS)
    rng = np.random.default_rng(1)
    waves = in_waves([model, model], replace(RUN, limits=Limits()), SEA, rng)
    scenarios = Scenarios(
        [model, model], RUN.times, np.array([0]), np.zeros(2), bounds, waves=waves
    )
    commands = simulate(model, RUN, noise=False).inputs
    seen = [scenarios.run(index, commands).signals[:, 0] for index in (0, 1)]
    for (vehicle, forces), signal in zip(waves, seen, strict=True):
        assert forces.std() == pytest.approx(0.01, rel=0.6)
        run = simulate_inputs(vehicle, RUN.times, inputs=np.hstack([commands, forces]), initial={})
        np.testing.assert_allclose(signal, run.signal(bounds.names[0]), atol=1e-12)
    assert np.abs(seen[0] - seen[1]).max() > 1e-3


def test_other_structures_count_among_the_vehicles() -> None:
    """Where one of two structures leaves the limits on every vehicle, half of all vehicles do."""
    push = Force("push", {"r": "E_push"}, (Parameter("E_push", 0.3, fixed=True),))
    pushed = ship() + push
    found = assess_limits(
        ship(), RUN, rng=np.random.default_rng(0), spread=0.01, vehicles=20, others=[pushed]
    )
    alone = assess_limits(ship(), RUN, rng=np.random.default_rng(0), spread=0.01, vehicles=20)
    assert alone.n_kept == 20
    assert found.n_kept == 10


def test_abort_rules_fire_as_often_as_vehicles_pass_them() -> None:
    """A rule stands at nine tenths of its limit, and its rate is what simulations count."""
    strong = replace(RUN, manoeuvre=Doublet("rudder", 0.2, pulse_time=10.0))
    found = assess_limits(ship(), strong, rng=np.random.default_rng(0), spread=0.4, vehicles=60)
    (rule,) = (one for one in found.rules if one.signal == "psi")
    assert rule.limited
    assert rule.upper == pytest.approx(0.9 * LIMITS.signals["psi"][1])
    from oed_sysid.design.vehicles import draw_models

    count = 0
    for vehicle in draw_models(ship(), 0.4, 60, None, np.random.default_rng(0)):
        heading = simulate(vehicle, replace(strong, limits=Limits()), noise=False).output("psi")
        count += np.abs(heading).max() > rule.upper
    assert rule.fires == pytest.approx(count / 60)
    assert found.any_fires >= rule.fires >= 1 - found.probability
    assert found.to_dict()["any_rule_fires"] == found.any_fires


def test_after_a_fit_designs_are_cautious_by_themselves() -> None:
    """A fit tells how uncertain the vehicle is: its limits then hold on those that remain."""
    record = simulate(ship(), replace(RUN, limits=Limits()), rng=np.random.default_rng(0))
    estimator = MultipleShooting(noise="given", coloured="never", disturbances="none")
    fit = estimator.fit(ship(), Dataset((record,)))
    found = quick(fit)
    assert found.assurance is not None
    assert found.assurance.wanted == 0.95
    assert found.assurance.is_safe or found.sea_trial_card().startswith("DANGER")
    assert quick(fit, caution=None).assurance is None
    with pytest.raises(DesignError, match="Give a Caution"):
        quick(caution="always")
    with pytest.raises(DesignError):
        quick(fit, caution=Caution(1.5))


def test_the_card_is_one_page_with_danger_in_red(design: Design) -> None:
    """Text ends above the pictures; where limits are left on many vehicles the top is red."""
    risky = replace(design, assurance=replace(design.assurance, n_kept=30, left={"psi": 30}))
    for one, alarming in ((risky, True), (replace(design, assurance=None), False)):
        figure = figure_card(one.card())
        assert tuple(figure.get_size_inches()) == (8.27, 11.69)
        top = max(figure.axes, key=lambda ax: ax.get_position().y1).get_position().y1
        lowest = min(figure.texts, key=lambda text: text.get_position()[1])
        assert lowest.get_position()[1] > top
        assert (figure.texts[0].get_color() == DANGER) is alarming
    assert "STOP THE RUN" in risky.sea_trial_card()
    left = 1 - risky.assurance.probability
    for page in (risky.card().document(), risky.document()):
        first = page.html().partition('<p class="danger">')[2]
        assert first.startswith(f"DANGER: on {left:.0%} of the vehicles")
        assert page.first[0] == risky.assurance.danger
    assert '<p class="danger">' not in replace(design, assurance=None).card().document().html()


def test_the_first_line_warns_as_soon_as_less_is_kept_than_asked(design: Design) -> None:
    """Kept on 93 % is dangerous where 95 % were asked for, and not where nothing was."""
    kept = replace(design.assurance, n_kept=56, n_checked=60, left={"psi": 4}, limited=True)
    assert (
        replace(design, assurance=replace(kept, wanted=0.95)).document().answer.startswith("DANGER")
    )
    words = replace(design, assurance=replace(kept, wanted=None)).document().answer
    assert not words.startswith("DANGER")
    assert "limits kept on 93% of possible vehicles" in words


def test_overrides_hold_the_commands(design: Design, tmp_path) -> None:
    """Read back and turned into angles again, the pulses are the commands to half a microsecond."""
    ends = LIMITS.inputs["rudder"]
    servo = Servo(3, *ends)
    times, inputs = design.trajectory.times, design.trajectory.inputs
    path = write_overrides(
        tmp_path / "o.csv", design.model, times, inputs, servos={"rudder": servo}
    )
    table = np.genfromtxt(path, delimiter=",", skip_header=1)
    rows = np.searchsorted(table[:, 0], np.rint(1000 * times), side="right") - 1
    angles = ends[0] + (table[rows, 1] - 1100) / 800 * (ends[1] - ends[0])
    assert np.abs(angles - inputs[:, 0]).max() <= 0.51 / 800 * (ends[1] - ends[0])
    assert len(table) < len(times)
    with pytest.raises(DesignError, match="smaller range"):
        Servo(1, -0.01, 0.01).pulses(inputs[:, 0])
    with pytest.raises(DesignError, match="no input"):
        write_overrides(path, design.model, times, inputs, servos={"fin": servo})


def test_a_bag_plays_the_commands_at_their_times(design: Design, tmp_path) -> None:
    """A ROS 2 bag read back holds every command at its time."""
    highlevel = pytest.importorskip("rosbags.highlevel")
    typesys = pytest.importorskip("rosbags.typesys")
    times, inputs = design.trajectory.times, design.trajectory.inputs
    path = write_bag(tmp_path / "bag", design.model, times, inputs)
    store = typesys.get_typestore(typesys.Stores.ROS2_HUMBLE)
    with highlevel.AnyReader([path], default_typestore=store) as reader:
        told = [
            (nano, reader.deserialize(raw, link.msgtype).data)
            for link, nano, raw in reader.messages()
            if link.topic == "/commands/rudder"
        ]
    np.testing.assert_allclose([nano * 1e-9 for nano, _ in told], times, atol=1e-9)
    np.testing.assert_allclose([value for _, value in told], inputs[:, 0], rtol=1e-12)
    with pytest.raises(FileError, match="exists already"):
        write_bag(path, design.model, times, inputs)
