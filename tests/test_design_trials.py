"""Trials: what is avoided, limits that hold on other vehicles, sea room and files."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from html import escape
from itertools import pairwise

import numpy as np
import pytest
from motion import small
from scipy.integrate import solve_ivp
from scipy.stats import binom
from test_design import LIMITS, grid, plain, quick, sea, ship

from oed_sysid import Dataset, Experiment, Force, Limits, MultipleShooting, Parameter, load_problem
from oed_sysid.design import (
    Caution,
    Design,
    Discriminate,
    Levels,
    Multisines,
    Search,
    Servo,
    Trial,
    TrialCard,
    ZigZags,
    assess_limits,
    campaign,
    design_experiment,
    write_bag,
    write_overrides,
)
from oed_sysid.design.vehicles import (
    UNCERTAINTY,
    LimitBounds,
    Scenarios,
    at_least,
    draw_models,
    in_own_waves,
)
from oed_sysid.errors import DesignError, FileError
from oed_sysid.experiments.manoeuvres import Doublet, Piecewise
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.information import sea_noise
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model
from oed_sysid.results import figure_card
from oed_sysid.results.design_plots import DANGER
from oed_sysid.runtime.display import told
from oed_sysid.runtime.parallel import CellProgress, ParallelError, spread_over


def test_forbidden_frequencies_get_no_power() -> None:
    """The designed command has no power in the band, and still tells most things."""
    band = (0.08, 0.16)
    found = quick(family=Multisines(7, forbidden=[band]))
    commands = found.trajectory.inputs[1:, 0]
    power = np.abs(np.fft.rfft(commands)) ** 2
    frequencies = np.fft.rfftfreq(len(commands), 0.5)
    inside = (frequencies >= band[0]) & (frequencies <= band[1])
    assert inside.sum() >= 3
    assert power[inside].sum() < 1e-12 * power.sum()
    free = quick(family=Multisines(7)).trajectory.inputs[1:, 0]
    assert (np.abs(np.fft.rfft(free)) ** 2)[inside].sum() > 1e-3 * power.sum()
    assert found.gain(found.references[0])[0] > 1.0
    assert "outside 0.08 to 0.16 Hz" in found.report()


def test_bands_keep_range_and_rate_and_are_checked() -> None:
    """Commands are made smaller instead of clipped; impossible bands are named."""
    fitted = grid(rate=0.2)
    shape = Multisines(8, forbidden=[(0.1, 0.12)]).on(fitted)
    commands = shape.commands(np.random.default_rng(0).random((20, shape.size)))
    assert np.abs(commands).max() <= 0.35 + 1e-12
    assert np.abs(np.diff(commands, axis=1)).max() <= 0.1 + 1e-12
    with pytest.raises(DesignError, match="outside the forbidden bands"):
        Multisines(8, forbidden=[(0.0, 0.24)]).on(fitted)
    with pytest.raises(DesignError, match="is none"):
        Multisines(8, forbidden=[(0.3, 0.1)])


@pytest.mark.slow
def test_speed_distance_depth_and_return_are_kept_together() -> None:
    """An AUV loses little speed, stays in its box and comes back to its depth and trim."""
    problem = load_problem("auv_diving_plane")
    limits = replace(
        problem.limits, signals={"u": (1.30, np.inf), "x": (-np.inf, 56.0), "z": (98.0, 102.0)}
    )
    end = {"z": (99.8, 100.2), "theta": (-0.02, 0.02)}
    found = design_experiment(
        problem.model,
        Trial(
            limits=limits, duration=40.0, sample_time=0.5, initial={"u": 1.34, "z": 100.0}, end=end
        ),
        rng=np.random.default_rng(0),
        search=Search(family=Levels(16), n_starts=1, n_candidates=15, n_steps=10, n_workers=1),
    )
    # Another integration step, so that nothing is kept by the coincidence of one.
    run = simulate(replace(problem.model, step=0.05), found.experiment, noise=False)
    for name, (low, high) in limits.signals.items():
        values, margin = run.output(name), 1e-4
        assert values.min() >= low - margin
        assert values.max() <= high + margin
    for name, (low, high) in end.items():
        assert low - 1e-4 <= run.output(name)[-1] <= high + 1e-4
    assert np.ptp(run.output("theta")) > 0.05


@pytest.mark.slow
def test_distance_that_nothing_can_keep_is_named() -> None:
    """Who runs for forty seconds goes further than thirty metres, and is told so."""
    problem = load_problem("auv_diving_plane")
    limits = replace(problem.limits, signals={"x": (-np.inf, 30.0)})
    with pytest.raises(DesignError, match=r"x is 5\d\.\d+ m .*above its limit of 30 m"):
        design_experiment(
            problem.model,
            Trial(limits=limits, duration=40.0, sample_time=0.5, initial={"u": 1.34, "z": 100.0}),
            rng=np.random.default_rng(0),
            search=Search(family=Levels(6), n_starts=1, n_candidates=3, n_steps=2, n_workers=1),
        )


def test_campaign_learns_from_each_run() -> None:
    """Wrong beliefs are corrected: later designs start near the truth, and the truth is found."""
    truth = ship()
    nominal = truth.with_values({"b": 0.08, "d": 0.55, "c": 1.0})
    rng = np.random.default_rng(2)
    search = Search(Levels(12), n_starts=1, n_candidates=5, n_steps=3, n_workers=1)
    stages = campaign(
        nominal, Trial(LIMITS, duration=40.0, sample_time=0.5, name="run"),
        lambda experiment: simulate(truth, replace(experiment, limits=Limits()), rng=rng), 2,
        design=partial(design_experiment, rng=rng, search=search, caution=None),
    )  # fmt: skip
    assert [stage.record.name for stage in stages] == ["run_1", "run_2"]
    first, second = stages
    errors = second.fit.information.std_errors
    assert second.design.model.values == first.fit.model.values
    assert np.all(errors < first.fit.information.std_errors)
    true = np.array([truth.values[name] for name in second.fit.names])
    found = np.array([second.fit.values[name] for name in second.fit.names])
    assert np.all(np.abs(found - true) < 4 * errors)
    # The second design knew the vehicle and keeps its limits on it, up to what is still uncertain.
    replayed = simulate(truth, replace(second.design.experiment, limits=Limits()), noise=False)
    assert np.abs(replayed.output("psi")).max() < 0.6 * 1.05


def test_discriminating_design_decides_where_a_zigzag_does_not() -> None:
    """Rivals that fit a zigzag alike are told apart by estimation from the designed run."""
    rivals = (
        Force("cubic", {"r": "-E_cubic*r**3"}, (Parameter("E_cubic", 0.0, scale=30.0),)),
        Force("stall", {"r": "-E_stall*rudder**3"}, (Parameter("E_stall", 0.0, scale=0.15),)),
    )
    found = quick(criterion=Discriminate(rivals, size=1.0), n_starts=2)
    truth = ship() + rivals[1].with_values({"E_stall": 0.15})
    estimator = MultipleShooting(noise="given", coloured="never", disturbances="none")
    rng = np.random.default_rng(1)

    def margin(experiment: object) -> float:
        """How much better the true rival fits than the wrong one, in twice the log-likelihood."""
        data = Dataset((simulate(truth, replace(experiment, limits=Limits()), rng=rng),))
        wrong, right = (estimator.fit(ship() + rival, data) for rival in rivals)
        return 2 * (wrong.cost - right.cost)

    zigzag = found.references[-1].experiment
    designed = [margin(found.experiment) for _ in range(4)]
    standard = [margin(zigzag) for _ in range(4)]
    assert max(standard) < 6
    assert all(value > 16 for value in designed)
    assert np.mean(designed) == pytest.approx(found.misfits["stall", "cubic"], rel=0.5)


CAUTION = Caution(0.9, 0.3, n_sets=60, n_checks=300)


@pytest.fixture(scope="module", name="careful")
def _careful() -> Design:
    """A design that keeps its limits on nine of ten vehicles, coefficients 30 % wrong."""
    return quick(caution=CAUTION)


def _reaches(commands: np.ndarray, b: float, d: float, c: float) -> tuple[float, float]:
    """Lowest and highest heading by SciPy's adaptive integrator, equations written anew."""

    def rates(_: float, x: np.ndarray, rudder: float) -> list[float]:
        return [x[1], b * rudder - d * x[1] - c * x[1] * abs(x[1])]

    low, high, x = 0.0, 0.0, np.zeros(2)
    edges = [0, *(np.flatnonzero(np.diff(commands[:-1])) + 1), len(commands) - 1]
    for first, last in pairwise(edges):
        times = 0.5 * np.arange(first, last + 1)
        span, held = (times[0], times[-1]), (commands[first],)
        path = solve_ivp(rates, span, x, t_eval=times, args=held, rtol=1e-7, atol=1e-9).y
        low, high, x = min(low, path[0].min()), max(high, path[0].max()), path[:, -1]
    return low, high


@pytest.mark.slow
def test_stated_probability_holds_in_an_independent_simulation(careful: Design) -> None:
    """The share of violations found by another integrator agrees with the stated one."""
    stated = careful.assurance.probability
    assert stated >= 0.9
    rng = np.random.default_rng(99)
    n_vehicles = 80
    commands = careful.trajectory.inputs[:, 0]
    kept = 0
    for _ in range(n_vehicles):
        b, d, c = np.array([0.12, 0.4, 1.5]) * (1 + 0.3 * rng.uniform(-1, 1, 3))
        low, high = _reaches(commands, b, d, c)
        kept += low >= -0.6 and high <= 0.6
    assert binom.ppf(1e-3, n_vehicles, stated) <= kept <= binom.ppf(1 - 1e-3, n_vehicles, stated)


def test_caution_costs_little_and_its_absence_breaks_limits(careful: Design) -> None:
    """Without caution many of these vehicles leave the limits; with it most of the gain stays."""
    bold = plain()
    found = assess_limits(
        ship(), bold.experiment, limits=LIMITS, spread=0.3, rng=np.random.default_rng(5)
    )
    assert found.probability < 0.85
    assert sum(found.left.values()) == found.n_checked - found.n_kept
    for safe, free in zip(careful.references, bold.references, strict=True):
        assert careful.gain(safe)[0] > 0.6 * bold.gain(free)[0]
    assert "limits kept on" in careful.report()


def test_guards_have_the_derivatives_of_differences() -> None:
    """Changes of limited signals from an edge on equal those of whole runs."""
    model, fitted = ship(), grid()
    shape = Levels(12).on(fitted)
    bounds = LimitBounds.of(model, Limits(signals={"psi": (-0.3, 0.3)}), {"r": (-0.1, 0.1)})
    scenarios = Scenarios(
        [model.with_values({"d": 0.3})], fitted.times, shape.edges, np.array([0.0, 0.01]), bounds
    )
    assert scenarios.bounds.names == ("psi",), "the end is a goal of the nominal vehicle"
    numbers = np.full((2, 12), 0.6)
    numbers[1, 7] = 0.9
    first, second = shape.commands(numbers)
    before, after = scenarios.run(0, first), scenarios.run(0, second)
    edge = int(np.searchsorted(shape.edges, np.flatnonzero((first != second)[:, 0])[0], "right"))
    changed = scenarios.change(0, before, second, edge - 1)
    start = shape.edges[edge - 1]
    np.testing.assert_allclose(changed, (after.signals - before.signals)[start:], atol=1e-12)


def test_waived_vehicles_do_not_count() -> None:
    """The level is that of the worst vehicle that still counts, and the first limit is named."""
    model, fitted = ship(), grid()
    bounds = LimitBounds.of(model, Limits(signals={"psi": (-0.3, 0.3)}))
    models = [model.with_values({"b": b}) for b in (0.05, 0.12, 0.2)]
    scenarios = Scenarios(models, fitted.times, np.array([0]), np.zeros(2), bounds, n_waived=1)
    commands = np.full((81, 1), 0.1)
    runs = [scenarios.run(i, commands) for i in range(3)]
    assert scenarios.level(runs) == runs[2].excess
    scenarios.waive(runs)
    assert scenarios.level(runs) == runs[1].excess
    assert scenarios.decisive(runs) == [1, 0]
    pushed = simulate_inputs(models[2], fitted.times, inputs=commands)
    assert bounds.first_left(pushed) == "psi upper limit"


def test_closed_loop_keeps_limits_on_other_vehicles() -> None:
    """A cautious zigzag closes its loop on each vehicle and keeps the heading there."""
    found = quick(family=ZigZags("psi"), caution=replace(CAUTION, n_sets=20, n_checks=40))
    assert found.experiment.reacts
    assert found.assurance.probability >= 0.9
    again = assess_limits(
        ship(), found.experiment, limits=LIMITS, rng=np.random.default_rng(8), vehicles=40
    )
    assert again.probability >= 0.8


def test_nonsense_is_named() -> None:
    """A probability of two is answered with advice."""
    with pytest.raises(DesignError, match="probability 2"):
        Caution(2.0)
    with pytest.raises(DesignError, match="spread 3"):
        Caution(spread=3.0)


def test_priors_may_be_too_narrow() -> None:
    """Of declared priors every other vehicle is drawn three times as far; a fit is believed."""
    priors = Parameter("K", 0.2, "1/s", prior_std=0.01)
    ship = small("ship", "r [rad/s] <- d [rad]", {"r": "K*d - 0.1*r"}, [priors])
    rng = np.random.default_rng(0)
    drawn = np.array([one.values["K"] for one in draw_models(ship, None, 4000, None, rng)])
    assert np.std(drawn[::2]) == pytest.approx(0.01, rel=0.05)
    assert np.std(drawn[1::2]) == pytest.approx(0.03, rel=0.05)
    known = Information.from_matrix(("K",), np.array([[1e4]]), np.array([0.2]))
    drawn = np.array([one.values["K"] for one in draw_models(ship, None, 4000, known, rng)])
    assert np.std(drawn) == pytest.approx(0.01, rel=0.05)


def test_what_nobody_knows_may_be_far_off() -> None:
    """Beside a prior, coefficients without one are drawn up to a share of their value off."""
    values = [Parameter("K", 0.2, "1/s", prior_std=0.01), Parameter("c", 0.1, "1/s")]
    model = small("ship", "r [rad/s] <- d [rad]", {"r": "K*d - c*r"}, values)
    drawn = draw_models(model, None, 2000, None, np.random.default_rng(0))
    shares = np.array([one.values["c"] for one in drawn]) / 0.1 - 1.0
    assert np.abs(shares).max() == pytest.approx(UNCERTAINTY, rel=0.01)
    assert np.std(shares) == pytest.approx(UNCERTAINTY / np.sqrt(3.0), rel=0.05)
    assert np.std([one.values["K"] for one in drawn[::2]]) == pytest.approx(0.01, rel=0.1)


def test_the_stated_bound_is_that_of_the_binomial() -> None:
    """At the lower end so many or more would be kept in one case of twenty."""
    for kept, n in ((190, 200), (20, 20), (3, 200)):
        assert binom.sf(kept - 1, n, at_least(kept, n)) == pytest.approx(0.05, rel=1e-6)
    assert at_least(0, 50) == 0.0


def test_the_bound_holds_for_priors_that_are_too_narrow() -> None:
    """It is that of the vehicles drawn three times as far, by the closed form of their motion."""
    model = Model(
        "ship", (State("r", "rad/s"),), (Input("d", "rad", interpolation="hold"),),
        (Output("r", "rad/s"),), kinematics={"r": "K*d - r"},
        parameters=(Parameter("K", 0.2, "1/s", prior_std=0.02),),
    )  # fmt: skip
    run = Experiment("step", Piecewise("d", [0.0], [1.0]), duration=20.0, sample_time=0.5)
    drawn = draw_models(model, None, 200, None, np.random.default_rng(0))
    found = assess_limits(
        model, run, rng=np.random.default_rng(0), limits=Limits(signals={"r": (-1.0, 0.25)}),
        spread=None, vehicles=200,
    )  # fmt: skip
    # From rest r is K (1 - exp(-t)): within the limit as long as K is.
    kept = np.array([one.values["K"] * (1.0 - np.exp(-20.0)) <= 0.25 for one in drawn])
    assert found.n_kept == kept.sum()
    assert 0.5 < np.mean(kept[1::2]) < np.mean(kept[::2])
    assert binom.sf(kept[1::2].sum() - 1, 100, found.at_least) == pytest.approx(0.05, rel=1e-6)
    sure = assess_limits(
        model, run, rng=np.random.default_rng(0), limits=Limits(signals={"r": (-1.0, 0.25)}),
        spread=0.1, vehicles=200,
    )  # fmt: skip
    assert sure.at_least == at_least(200, 200)


SEA = sea(0.01)
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
    found = plain()
    safe = assess_limits(
        found.model, found.experiment, rng=np.random.default_rng(0), spread=0.4, vehicles=60
    )
    return replace(found, assurance=safe)


def turning() -> Model:
    """A vehicle that turns on a circle at a speed that it keeps."""
    law = {"u": "0*rudder", "psi": "r", "r": "(K*rudder - r)/0.01"}
    signals = "u [m/s], psi [rad], r [rad/s] <- rudder [rad]"
    return small("circle", signals, law, {"K [1/s]": 0.1}, {"psi": 0.01}, step=0.005)


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
    met = [in_own_waves(model, RUN, SEA, rng) for _ in range(2)]
    waves = [(vehicle, run.commands(vehicle.input_names)[:, 1:]) for vehicle, run in met]
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
    count = 0
    for vehicle in draw_models(ship(), 0.4, 60, None, np.random.default_rng(0)):
        heading = simulate(vehicle, replace(strong, limits=Limits()), noise=False).output("psi")
        count += np.abs(heading).max() > rule.upper
    assert rule.fires == pytest.approx(count / 60)
    assert found.any_fires >= rule.fires >= 1 - found.probability
    assert found.to_dict()["any_rule_fires"] == found.any_fires


@pytest.mark.slow
def test_after_a_fit_designs_are_cautious_by_themselves() -> None:
    """A fit tells how uncertain the vehicle is: its limits then hold on those that remain."""
    record = simulate(ship(), replace(RUN, limits=Limits()), rng=np.random.default_rng(0))
    estimator = MultipleShooting(noise="given", coloured="never", disturbances="none")
    fit = estimator.fit(ship(), Dataset((record,)))
    short = {"n_starts": 1, "n_candidates": 8, "n_steps": 3}
    found = quick(fit, **short)
    assert found.assurance.wanted == 0.95
    assert found.assurance.is_safe or found.sea_trial_card().startswith("DANGER")
    assert quick(fit, caution=None, **short).assurance is None
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
    assert "--certainty" not in risky.sea_trial_card()
    left = 1 - risky.assurance.probability
    for page in (risky.card().document(), risky.document()):
        first = page.html().partition('<p class="danger">')[2]
        assert first.startswith(told(f"DANGER: on {left:.0%} of the vehicles"))
        assert page.first[0] == told(risky.assurance.danger)
    assert '<p class="danger">' not in replace(design, assurance=None).card().document().html()


def test_the_first_line_warns_as_soon_as_less_is_kept_than_asked(design: Design) -> None:
    """Kept on 93 % is dangerous where 95 % were asked for, and not where nothing was."""
    kept = replace(design.assurance, n_kept=56, n_checked=60, left={"psi": 4}, limited=True)
    assert (
        replace(design, assurance=replace(kept, wanted=0.95)).document().answer.startswith("DANGER")
    )
    words = replace(design, assurance=replace(kept, wanted=None)).document().answer
    assert not words.startswith("DANGER")
    assert "limits kept on 93 % of possible vehicles" in words


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


def test_a_card_is_made_of_any_run_and_names_the_side_of_each_order() -> None:
    """Orders are whole degrees with the side that the yaw rate follows; what is held has none."""
    law = {"psi": "r", "r": "(-0.1*rudder - r)/2 + 0*thrust"}
    signals = "psi [rad], r [rad/s] <- rudder [rad], thrust [N]"
    model = small("boat", signals, law, noise={"psi": 0.01})
    shape = Piecewise("rudder", [0.0, 5.0, 20.0], [0.0, 0.1, -0.2])
    run = Experiment("steps", shape, duration=40.0, sample_time=0.5, constants={"thrust": 9.0})
    page = TrialCard.of(model, run).document()
    # What a run begins from stands on the page as in the text.
    assert page.head
    assert all(escape(value) in page.html() for _, value in page.head)
    orders = page.sections[0].tables[0].rows
    assert [row[1] for row in orders[:2]] == [
        "rudder to 6 deg to port", "rudder to 11 deg to starboard",
    ]  # fmt: skip
    # A tenth of a degree more is no order for people.
    shape = Piecewise("rudder", [0.0, 5.0, 12.0, 20.0], [0.0, 0.1, 0.102, -0.2])
    run = Experiment("more", shape, duration=40.0, sample_time=0.5, constants={"thrust": 9.0})
    assert TrialCard.of(model, run).document().sections[0].tables[0].rows == orders
    # The speed that the equations hold is that of the approach, in knots of 1852 m/h.
    held = replace(model, parameters=(Parameter("U", 5.144, "m/s", fixed=True),))
    (start,) = (said for what, said in TrialCard.of(held, run).document().head if "start" in what)
    assert start.startswith("speed 10 knots")
    assert "knots" not in str(TrialCard.of(model, run).document().head)


@pytest.mark.slow
def test_vehicles_are_the_same_wherever_they_are_simulated() -> None:
    """In this process, in others and on a dask cluster; every part of them is told."""
    distributed = pytest.importorskip("distributed")
    auv = load_problem("remus_diving_plane")
    run = replace(auv.experiment("zigzag_10_10"), duration=20.0)
    waves = sea_noise(auv.model, "moderate", [run])

    def found() -> tuple[np.ndarray, dict]:
        one = assess_limits(
            auv.model, run, rng=np.random.default_rng(3), limits=auv.limits, vehicles=40, sea=waves
        )
        return one.kept, dict(one.ranges)

    kept, ranges = found()
    assert 0 < kept.sum() < 40
    told: list[CellProgress] = []
    with spread_over(n_jobs=2, progress=told.append):
        apart = found()
    assert np.array_equal(apart[0], kept)
    assert apart[1] == ranges
    assert [one.n_done for one in told] == list(range(1, told[-1].n_cells + 1))
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=True, dashboard_address=None
        ) as local,
        spread_over(local.scheduler_address),
    ):
        afar = found()
    assert np.array_equal(afar[0], kept)
    assert afar[1] == ranges


def test_a_cluster_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """Nobody waits for long, and the address is in the message."""
    distributed = pytest.importorskip("distributed")

    def impatient(address: str, timeout: float) -> object:
        assert timeout <= 10.0
        return client(address, timeout=0.05 * timeout)

    client = distributed.Client
    monkeypatch.setattr(distributed, "Client", impatient)
    with (
        pytest.raises(ParallelError, match=r"tcp://127\.0\.0\.1:9"),
        spread_over("tcp://127.0.0.1:9"),
    ):
        pass
