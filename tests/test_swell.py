"""A swell of some height as forces: Taylor's formula, strips, hull forces, words."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks.truth import MASSES, TRUE, rates
from oed_sysid import (
    Experiment,
    Fit,
    Input,
    Model,
    MultipleShooting,
    Output,
    Parameter,
    State,
    load_problem,
)
from oed_sysid.cli import BAD_INPUT, main
from oed_sysid.cli.study import Study
from oed_sysid.design.decision import Logbook
from oed_sysid.errors import DesignError, ModelError
from oed_sysid.experiments.manoeuvres import Piecewise
from oed_sysid.information import sea_noise
from oed_sysid.likelihood.noise_model import Sea, forces_in, seas_in

MASS, ADDED, LENGTH = 30.0, {"u": 1.0, "v": 36.0, "w": 36.0}, 40.0
OMEGA = 2 * math.pi / 8.0
K = OMEGA**2 / 9.80665


def body(length: float = LENGTH) -> Model:
    """A slender body without any hull force, mass and added mass even along its length."""
    axes = {"X": "u", "Y": "v", "Z": "w", "M": "q", "N": "r"}
    spread = (MASS + ADDED["w"]) * length**2 / 12
    inertia = {(axis, s): MASS + ADDED[s] for axis, s in list(axes.items())[:3]}
    numbers = {**inertia, ("M", "q"): spread, ("N", "r"): spread}
    units = {name: "m/s" if name in "uvw" else "rad/s" for name in axes.values()}
    return Model(
        "body",
        (*(State(name, unit) for name, unit in units.items()), State("z", "m")),
        (Input("thrust", "N"),),
        tuple(Output(name, unit, noise_std=0.01) for name, unit in units.items()),
        {"z": "w"},
        axes=axes,
        inertia={key: f"{value!r}" for key, value in numbers.items()},
        parameters=(Parameter("L", length, "m", fixed=True, description="length"),),
    )


def at_depth(depth: float, speed: float = 0.0) -> list[Experiment]:
    """A run without commands."""
    start = {"z": depth, "u": speed}
    still = Piecewise("thrust", (0.0, 1.0), (0.0, 0.0))
    return [Experiment("run", still, duration=5.0, initial=start)]


def swell(model: Model, runs: list[Experiment], words: str) -> Sea:
    """The forces of a swell of 0.4 m and 8 s: standard deviation of the waves 0.1 m."""
    return sea_noise(model, f"swell=0.4m,8s,{words}", runs).seas[0]


def test_a_small_body_is_pushed_by_taylors_formula() -> None:
    """Head, beam and oblique seas, with depth: displaced and added mass times acceleration."""
    model = body(0.01)
    for degrees in (0.0, 90.0, 210.0):
        found = swell(model, at_depth(5.0), f"{degrees}deg").levels
        size = 0.1 * OMEGA**2 * math.exp(-5 * K)
        along, across = (abs(f(math.radians(degrees))) for f in (math.cos, math.sin))
        assert found.get("force X", 0.0) == pytest.approx((MASS + ADDED["u"]) * size * along)
        assert found.get("force Y", 0.0) == pytest.approx((MASS + ADDED["v"]) * size * across)
        assert found["force Z"] == pytest.approx((MASS + ADDED["w"]) * size)
        assert ("force Y" in found) == (degrees != 0.0)


def test_a_long_body_is_pushed_by_the_sum_of_its_strips() -> None:
    """Force and moment of waves two body lengths long are those of strips, one by one."""
    beta = math.radians(35.0)
    found = swell(body(), at_depth(8.0), "35deg").levels
    x = (np.arange(20000) + 0.5) / 20000 * LENGTH - LENGTH / 2
    wave = np.exp(1j * K * math.cos(beta) * x) * OMEGA**2 * math.exp(-8 * K) * 0.1
    share = (MASS + ADDED["v"]) / len(x)
    sums = {
        "force Y": share * np.sum(wave * math.sin(beta)),
        "force Z": share * np.sum(wave),
        "force M": share * np.sum(wave * x),
        "force N": share * np.sum(wave * x * math.sin(beta)),
    }
    for name, value in sums.items():
        assert found[name] == pytest.approx(abs(value), rel=1e-4), name
    assert abs(sums["force Y"]) < 0.9 * (MASS + ADDED["v"]) * 0.1 * OMEGA**2 * math.exp(-8 * K)


def test_waves_are_met_more_often_ahead_and_less_often_astern() -> None:
    """The period of encounter is that of Doppler; across the waves it is their own."""
    for degrees, sign in ((0.0, 1.0), (90.0, 0.0), (180.0, -1.0)):
        found = swell(body(), at_depth(5.0, 3.0), f"{degrees}deg")
        assert found.period == pytest.approx(2 * math.pi / (OMEGA + sign * 3.0 * K))
    with pytest.raises(DesignError, match="as fast as"):
        swell(body(), at_depth(5.0, 9.80665 / OMEGA), "180deg")


def test_hull_forces_feel_the_water_move() -> None:
    """On the diving plane lift and righting moment are those of equations written anew."""
    auv = load_problem("remus_diving_plane")
    run = replace(auv.experiment("zigzag_5_5"), duration=0.4, sample_time=0.1)
    found = sea_noise(auv.model, "swell=0.4m,8s,30deg,length=1.33", [run]).seas[0].levels
    u, depth = run.initial["u"], run.initial["z"]
    ahead = -math.cos(math.radians(30.0))
    size = 0.1 * OMEGA * math.exp(-depth * K)
    w = -1j * size
    slope = size * K * ahead / (1j * OMEGA)
    water = np.array([size * ahead, w, 0.0, slope, 0.0])
    thrust = run.constants["thrust"]
    state = np.array([u, 0.0, 0.0, 0.0, depth], dtype=complex)

    def rate(x: np.ndarray) -> np.ndarray:
        return np.array(rates(x, (0.0, thrust), TRUE, np.sin, np.cos)[:3])

    by_state = np.array([rate(state + 1e-20j * e).imag / 1e-20 for e in np.eye(5)]).T
    accelerations = 1j * OMEGA * np.array([size * ahead, w, size * K * ahead]) - by_state @ water
    m, inertia, x_udot, z_wdot, z_qdot, m_wdot, m_qdot = MASSES
    masses = np.array(
        [[m - x_udot, 0, 0], [0, m - z_wdot, -z_qdot], [0, -m_wdot, inertia - m_qdot]]
    )
    for name, value in zip("XZM", masses @ accelerations, strict=True):
        assert found[f"force {name}"] == pytest.approx(abs(value), rel=5e-3), name
    still = abs((masses @ (1j * OMEGA * np.array([size * ahead, w, size * K * ahead])))[1])
    assert found["force Z"] > 1.3 * still


@pytest.mark.parametrize(
    ("sea", "words"),
    [
        ("swell=0.3m,8s", "direction, in deg"),
        ("swell=8s,030deg", "height, in m"),
        ("swell=0.3m,8s,030deg,lenght=3", "lenght"),
        ("swell=0.3m,8s,030deg,speed=3m", "speed=3m"),
        ("swell=-0.3m,8s,030deg", "not above zero"),
    ],
)
def test_what_is_wrong_in_the_words_is_said(sea: str, words: str) -> None:
    """No quantity is guessed."""
    with pytest.raises(DesignError, match=words):
        sea_noise(body(), sea, at_depth(5.0))


def test_what_is_not_known_of_the_vehicle_is_said() -> None:
    """Length, draught and speed are asked for where neither model nor runs tell."""
    ship = load_problem("online_ship")
    runs = [ship.experiment("zigzag_5_5")]
    with pytest.raises(DesignError, match="draught"):
        sea_noise(ship.model, "swell=2m,8s,030deg", runs)
    found = sea_noise(ship.model, "swell=2m,8s,030deg,draught=18", runs).seas[0]
    assert found.period == pytest.approx(
        2 * math.pi / (OMEGA + 8.23 * K * math.cos(math.pi / 6))
    )  # the model's constant V
    auv = load_problem("remus_diving_plane")
    with pytest.raises(DesignError, match="length"):
        sea_noise(auv.model, "swell=2m,8s,030deg", auv.experiments.values())
    tanks = load_problem("nomoto_sparse_heading")
    with pytest.raises(DesignError, match="speed"):
        sea_noise(tanks.model, "swell=2m,8s,030deg,length=3,draught=1", tanks.experiments.values())


def test_a_fit_lends_the_sea_that_it_found(tmp_path: Path) -> None:
    """Its forces with the problem's sensors; a fit without any, or of others, is refused."""
    saved = Path(__file__).parent / "saved_fits" / "nomoto_format_1.json"
    fit = Fit.load(saved)
    outputs = tuple(replace(one, noise_std=0.01) for one in fit.model.outputs)
    model = replace(fit.model, outputs=outputs)
    with pytest.raises(DesignError, match="no disturbance"):
        sea_noise(model, str(saved), ())
    waves = Sea(period=7.0, bandwidth=0.3, levels={"r": 2e-3}, shape="velocity")
    assert fit.noise is not None
    replace(fit, noise=replace(fit.noise, seas=(waves,))).save(tmp_path / "fit.json")
    found = sea_noise(model, str(tmp_path / "fit.json"), ())
    assert found.seas == (waves,)
    assert found.white == pytest.approx(np.full(len(outputs), 0.01))
    with pytest.raises(ModelError):
        sea_noise(body(), str(tmp_path / "fit.json"), ())


def test_the_direction_stands_on_the_card_and_in_the_levels(tmp_path: Path) -> None:
    """A design in a swell: forces of this heading, and how the run has to begin."""
    told, card = tmp_path / "told.json", tmp_path / "card.txt"
    words = ["design", "remus_diving_plane", "--duration", "8", "--certainty", "0"]
    given = ["--sea", "swell=0.3m,8s,330deg", "--card", str(card), "--json", str(told)]
    assert main([*words, *given, "--quiet"]) == 0
    assert "begin with the swell from 30 deg to port of the bow" in card.read_text()
    assert main(["rank", "catamaran", "--sea", "swell=0.3m,8s,030deg", "--quiet"]) == 0
    assert main(["rank", "sailboat", "--sea", "swell=0.3m,8s,030deg", "--quiet"]) == BAD_INPUT


def test_a_campaign_for_a_swell_estimates_with_a_sea(tmp_path: Path) -> None:
    """A swell that was planned for is declared, nothing of it but that it acts; else all is asked.

    On the command line `sea` says the same beside names of equations.
    """
    model = body()
    calm = sea_noise(model, "still", ())
    swell = replace(calm, seas=(Sea(period=8.0, bandwidth=0.2, levels={"Z": 0.3}),))
    for expected, told in ((None, "auto"), (calm, "auto"), (swell, Sea())):
        campaign = Logbook(tmp_path, model, "body", None, (), {}, None, expected)
        assert campaign.estimator == MultipleShooting(disturbances=told)
    problem = load_problem("remus_diving_plane")
    study = Study("remus_diving_plane", "default", problem, disturbances="Z, sea")
    assert study.acting == ("Z", "sea")
    assert seas_in(study.acting) == (Sea(),)
    assert forces_in(study.acting) == ("Z",)
    assert forces_in("sea") == forces_in(Sea()) == "all"
    assert replace(study, disturbances="auto").acting == "auto"
