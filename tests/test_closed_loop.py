"""Replay with the helmsman's law in the loop."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.errors import DataError, ModelError
from oed_sysid.predictions.closed_loop import CourseControl, ZigzagControl, closed_loop

STEP = 0.5


def ship(growth: float = 0.02) -> Model:
    """A ship unstable on course."""
    return Model(
        "unstable",
        (State("psi", "rad"), State("r", "rad/s", scale=0.1)),
        (Input("delta", "rad"),),
        (Output("psi", "rad", noise_std=0.003), Output("r", "rad/s", noise_std=0.001)),
        {"psi": "r", "r": "s*r + k*delta - c*r*abs(r)"},
        parameters=(
            Parameter("s", growth, "1/s"),
            Parameter("k", 0.05, "1/s^2"),
            Parameter("c", 3.0, "1/rad"),
        ),
        step=STEP,
    )


def steered(law, duration: float, rng: np.random.Generator, quiet: float = 1.0) -> Record:
    """A log of the ship under a law that sees noisy signals; plain arithmetic."""
    n = round(duration / STEP) + 1
    psi = r = 0.0
    rows, orders, memory, last = [], [], law.start(), 0.0
    for k in range(n):
        seen = np.array([psi, r]) + quiet * np.array([0.003, 0.001]) * rng.standard_normal(2)
        known = {"psi": float(seen[0]), "r": float(seen[1]), "time": k * STEP}
        wanted, memory = law.order(memory, known)
        last = float(np.clip(wanted, last - law.rate * STEP, last + law.rate * STEP))
        rows.append(seen)
        orders.append(last)
        for _ in range(50):
            r += STEP / 50 * (0.02 * r + 0.05 * last - 3.0 * r * abs(r))
            psi += STEP / 50 * r
    times = STEP * np.arange(n)
    return Record("log", times, np.array(orders)[:, None], np.array(rows), ship().channels)


HELM = CourseControl("delta", 1.0, 12.0, 0.3, limit=0.5, rate=0.2)


def test_a_helmsman_is_identified() -> None:
    """Gains of a course law come back from the log that it made."""
    log = steered(HELM, 300.0, np.random.default_rng(0))
    found = CourseControl.of(log, "delta")
    assert found.gain == pytest.approx(1.0, rel=0.15)
    assert found.damping == pytest.approx(12.0, rel=0.15)


def test_the_loop_holds_where_a_replayed_rudder_runs_away() -> None:
    """An unstable ship with a parameter a little off keeps its course in the loop alone."""
    log = steered(HELM, 400.0, np.random.default_rng(1))
    off = ship(0.024)
    replay = closed_loop(off, log, HELM)
    closed, opened = replay.rms()["psi"], replay.rms(open_loop=True)["psi"]
    assert closed < 0.05
    assert opened > 5 * closed
    assert "in the loop" in replay.report()


def test_a_zigzag_is_read_and_repeated() -> None:
    """Reversals are read at the headings that were ordered, and the replay follows the log."""
    turn = 0.17
    order = ZigzagControl(
        "delta", (0.2, -0.2, 0.2, -0.2), (turn, -turn, turn), (1, -1, 1), rate=0.2, execute=2.0
    )
    log = steered(order, 60.0, np.random.default_rng(2))
    found = ZigzagControl.of(log, "delta")
    assert found.orders == pytest.approx(order.orders, abs=0.01)
    assert found.reversals == pytest.approx(order.reversals, abs=0.02)
    assert found.towards == order.towards
    replay = closed_loop(ship(), log, found)
    begun = np.flatnonzero(np.abs(log.output("psi")) > turn)[0]
    last = begun + np.flatnonzero(np.sign(log.inputs[begun:, 0]) > 0)[-1]
    assert np.abs(replay.outputs - log.outputs)[:last, 0].max() < 0.15


def test_bands_by_draws_hold_in_the_loop() -> None:
    """A fit to one log predicts another, each draw in its own loop."""
    other = CourseControl("delta", 1.0, 12.0, -0.4, limit=0.5, rate=0.2)
    held = []
    for seed in range(4):
        rng = np.random.default_rng([3, seed])
        fit = MultipleShooting(disturbances="none").fit(
            ship(0.03), Dataset((steered(HELM, 120.0, rng),))
        )
        replay = closed_loop(fit, steered(other, 120.0, rng), other, n_draws=50)
        assert replay.failed == 0
        assert (replay.std[:, 0] >= 0.003).all()
        held += list(replay.coverage().values())
    assert np.mean(held) > 0.88


def test_what_is_no_law_is_said() -> None:
    """A rudder that answers nothing, or is never reversed, or is unknown, is refused."""
    rng = np.random.default_rng(4)
    log = steered(HELM, 60.0, rng)
    noise = Record(
        "noise", log.times, rng.standard_normal(log.inputs.shape), log.outputs, log.channels
    )
    with pytest.raises(DataError, match="no helmsman"):
        CourseControl.of(noise, "delta")
    held = Record("held", log.times, np.full(log.inputs.shape, 0.2), log.outputs, log.channels)
    with pytest.raises(DataError, match="no zigzag"):
        ZigzagControl.of(held, "delta")
    with pytest.raises(ModelError, match="has the inputs"):
        closed_loop(ship(), log, CourseControl("rudder", 1.0, 1.0, 0.0))
