"""Published experiments: AUV, sparse headings, tanker, sailboat and torpedo, number by number."""

from __future__ import annotations

from dataclasses import replace
from math import radians

import numpy as np
import pytest
from published import PUBLISHED

from benchmarks.documents.published import paper
from benchmarks.documents.published.sailboat import errors, exact, gibbs, in_errors
from oed_sysid import Dataset, Record, load_problem, simulate, simulate_inputs
from oed_sysid.baselines import EquationError, HeadingDifferences
from oed_sysid.errors import DataError, ModelError

PROBLEM = load_problem("auv_diving_plane")
RECORD = simulate(PROBLEM.model, PROBLEM.experiment("zigzag_5_5"), noise=False)
SCRIPT = paper("auv_diving_plane")
# An independent program's total sensitivity to a change of each coefficient by 20 per cent.
SENSITIVITY = PUBLISHED["sensitivity"]


def test_manoeuvre() -> None:
    """The zigzag is the one that an independent program made."""
    assert RECORD.n_samples == PROBLEM.published["samples"] + 1
    assert RECORD.output("u")[-1] == pytest.approx(1.353, abs=5e-4)
    theta = np.degrees(RECORD.output("theta"))
    assert (theta.min(), theta.max()) == pytest.approx((-5.77, 5.85), abs=5e-3)
    assert np.degrees(np.abs(RECORD.output("q")).max()) == pytest.approx(1.049, abs=5e-4)
    fin = RECORD.input("delta_s")
    assert np.sum(np.diff(np.sign(fin[1:])) != 0) == 4


def test_straight_speed() -> None:
    """Without fin the thrust drives the vehicle at 1.471 m/s, where drag equals it."""
    times = np.arange(0, 3000, 0.5)
    level = dict.fromkeys(("Z_uu_prime", "M_uu_prime"), 0.0)
    run = simulate_inputs(PROBLEM.model.with_values(level), times, inputs={"delta_s": 0.0})
    assert run.signal("u")[-1] == pytest.approx(1.471, abs=1e-3)


def test_sensitivities() -> None:
    """Sensitivities equal an independent program's, so the order of importance does too."""
    found = SCRIPT.sensitivities(RECORD)
    for name, expected in SENSITIVITY.items():
        assert found[name] == pytest.approx(expected, abs=1e-4), name


PROBLEM_HEADING = load_problem("nomoto_sparse_heading")
SCRIPT_HEADING = paper("nomoto_sparse_heading")
METHODS, dense_times, densify = (
    SCRIPT_HEADING.METHODS,
    SCRIPT_HEADING.dense_times,
    SCRIPT_HEADING.densify,
)
archimedes_spiral, reconstruct = SCRIPT_HEADING.archimedes_spiral, SCRIPT_HEADING.reconstruct
# An independent program's mean of |dK| and |dT| relative to 0.1 s, per cent.
INDEPENDENT = {
    ("default", "zigzag_15_15"): (10.65, 33.10, 1.38, 2.01, 2.54, 14.22),
    ("K0.5_T0.6", "fast_rudder"): (5.12, 11.58, 2.34, 2.10, 3.38, 12.81),
    ("K0.5_T1", "fast_rudder"): (4.23, 11.95, 2.02, 1.56, 1.89, 10.41),
    ("K0.5_T2", "fast_rudder"): (3.91, 11.98, 0.92, 0.62, 1.09, 9.63),
}


def gain_and_time(record: Record, scheme: str = "forward") -> np.ndarray:
    """K and T by differences of the heading."""
    fit = HeadingDifferences(scheme).fit(PROBLEM_HEADING.model, Dataset((record,)))
    return np.array([fit.values["K"], fit.values["T"]])


@pytest.mark.parametrize(("variant", "experiment"), INDEPENDENT, ids=lambda text: text)
def test_error_table(variant: str, experiment: str) -> None:
    """Errors of sparse sampling and of every curve equal an independent program's."""
    problem = PROBLEM_HEADING.variant(variant)
    record = simulate(problem.model, problem.experiment(experiment), noise=False)
    sparse = record.thin(50)
    reference = gain_and_time(record.thin(10))
    candidates = [record.thin(20), sparse]
    candidates += [reconstruct(sparse, 5, method=m) for m in METHODS]
    found = [50 * np.abs(gain_and_time(c) / reference - 1).sum() for c in candidates]
    assert found == pytest.approx(INDEPENDENT[variant, experiment], abs=6e-3)


def test_central_differences_are_of_second_order() -> None:
    """At 0.1 s central differences are far closer than the published forward ones."""
    problem = PROBLEM_HEADING.variant("K0.5_T1")
    record = simulate(problem.model, problem.experiment("fast_rudder"), noise=False).thin(10)
    truth = np.array([0.5, 1.0])
    forward, central = (
        np.abs(gain_and_time(record, s) / truth - 1).max() for s in ("forward", "central")
    )
    assert central < 0.1 * forward


@pytest.mark.parametrize("method", METHODS)
def test_curves_pass_through_the_samples(method: str) -> None:
    """Every method keeps the samples and is exact for a straight line."""
    rng = np.random.default_rng(0)
    times = np.cumsum(rng.uniform(0.3, 0.7, 12))
    values = np.sin(times)
    dense = densify(times, values, 5, method=method)
    assert dense[::5] == pytest.approx(values, abs=1e-12)
    line = densify(times, 2 * times - 1, 5, method=method)
    assert line == pytest.approx(2 * dense_times(times, 5) - 1, abs=1e-9)


def test_spiral_lies_on_an_archimedes_spiral() -> None:
    """Inserted points fulfil the polar equation: distance in proportion to the turn."""
    times, values = np.array([0.0, 1.0, 2.0]), np.array([0.0, 0.0, 1.0])
    dense, grid = archimedes_spiral(times, values, 20), dense_times(times, 20)
    from_corner = np.column_stack([grid[21:] - 1.0, dense[21:]])
    distance = np.hypot(*from_corner.T)
    bearing = np.arctan2(from_corner[:, 1], from_corner[:, 0])
    assert distance / bearing == pytest.approx(np.full(20, np.sqrt(2) / (np.pi / 4)), rel=1e-9)


def test_chord_rule_damps_a_disturbance_and_exact_tangents_do_not() -> None:
    """A kink in the first samples decays by 4/5 per interval with the published rule only."""
    times = np.arange(40.0)
    values = np.where(times == 0, 0.05, 0.0)
    wiggle = {
        tangent: np.abs(archimedes_spiral(times, values, 5, tangent=tangent)[-50:]).max()
        for tangent in ("chord", "exact")
    }
    assert wiggle["chord"] < 1e-4
    assert wiggle["exact"] > 1e-2


def test_impossible_input_is_refused() -> None:
    """Uneven records and other models are errors with advice."""
    record = simulate(
        PROBLEM_HEADING.model, PROBLEM_HEADING.experiment("zigzag_15_15"), noise=False
    ).thin(50)
    times = record.times.copy()
    times[5] += 0.1
    with pytest.raises(DataError, match="not sampled uniformly"):
        HeadingDifferences().fit(PROBLEM_HEADING.model, Dataset((replace(record, times=times),)))
    with pytest.raises(ModelError, match="expected K and T"):
        HeadingDifferences().fit(PROBLEM_HEADING.model.fix("K"), Dataset((record,)))


TANKER = load_problem("online_ship")
STEERED = simulate(TANKER.model, TANKER.experiment("zigzag_5_5"), noise=False)


def test_manoeuvre_ship() -> None:
    """The zigzag is the one that an independent program made."""
    assert STEERED.n_samples == TANKER.published["samples"] + 1
    assert np.degrees(np.abs(STEERED.output("psi")).max()) == pytest.approx(21.98, abs=0.01)
    assert np.degrees(np.abs(STEERED.output("r")).max()) == pytest.approx(0.2440, abs=1e-4)
    assert np.abs(STEERED.output("v")).max() == pytest.approx(0.599, abs=1e-3)
    assert np.sum(np.diff(np.sign(STEERED.input("delta")[1:])) != 0) == 2


def test_ship_is_unstable_on_course() -> None:
    """The dimensionless system matrix has the published entries and a negative determinant."""
    values = TANKER.model.values
    sway, yaw = values["inertia_Yv"], values["inertia_Nr"]
    matrix = np.array(
        [[values["Y_v"] / sway, values["Y_r"] / sway], [values["N_v"] / yaw, values["N_r"] / yaw]]
    )
    assert matrix == pytest.approx(np.array([[-0.5965, -0.3723], [-3.6607, -1.875]]), abs=1e-4)
    assert np.linalg.det(matrix) == pytest.approx(-0.2443, abs=1e-4)


PROBLEM_SAILBOAT = load_problem("sailboat")
SCRIPT_SAILBOAT = paper("sailboat")
DATA = SCRIPT_SAILBOAT.clean


def test_number_of_terms() -> None:
    """The hull has the published 8, 10, 10 and 10 terms, with units from their names."""
    free = PROBLEM_SAILBOAT.model.free_names
    assert [sum(n.startswith(f"{axis}_") for n in free) for axis in "XYNK"] == [8, 10, 10, 10]
    assert PROBLEM_SAILBOAT.model.parameter("Y_absvv").unit == "kg/m"
    assert "Y_absvr |v| r" in PROBLEM_SAILBOAT.model.equations()


def test_exact_accelerations_give_all_derivatives() -> None:
    """With exact rates the regression returns all 38 numbers."""
    assert max(errors(exact()).values()) < 1e-6


def test_gibbs_finds_what_carries_the_forces() -> None:
    """With 2 % noise dominant derivatives return within 2 %, and the chains have mixed."""
    fit = gibbs(0.02, 0, n_draws=1000)
    for name in SCRIPT_SAILBOAT.DOMINANT:
        assert fit.values[name] == pytest.approx(PROBLEM_SAILBOAT.truth[name], rel=0.02), name
    assert max(fit.posterior.r_hat.values()) < 1.01
    rates = SCRIPT_SAILBOAT.noisy_rates(0, 0.02)
    least = EquationError(rule="exact", rates=rates, coloured="never").fit(
        PROBLEM_SAILBOAT.model, DATA
    )
    assert SCRIPT_SAILBOAT.apart(fit, least) < 0.15


def test_coordinate_draws_have_not_converged_where_joint_draws_have() -> None:
    """The published draw, one coefficient at a time, mixes slowly on this problem."""
    fit = gibbs(0.1, 1, draw="coordinate", n_draws=1000)
    assert fit.status.code == "iterations"
    assert min(fit.posterior.effective_draws.values()) < 200


def test_steady_sailing() -> None:
    """On a beam reach at 5 m/s the boat makes 1.6 m/s, heels to leeward and drifts little."""
    found = SCRIPT_SAILBOAT.steady(PROBLEM_SAILBOAT.model, 90.0, 40.0)
    assert found["u"] == pytest.approx(1.64, abs=0.01)
    assert -radians(8) < found["phi"] < -radians(3)
    leeway = -found["v"] / found["u"]
    assert np.sign(found["phi"]) * -leeway * -1 > 0 or abs(leeway) < radians(3)


def test_tacks_are_mirror_images() -> None:
    """With the wind from the other side everything but the speed changes sign."""
    starboard = SCRIPT_SAILBOAT.steady(PROBLEM_SAILBOAT.model, 60.0, 40.0)
    port = SCRIPT_SAILBOAT.steady(PROBLEM_SAILBOAT.model, -60.0, 40.0)
    for name, value in starboard.items():
        mirrored = value if name == "u" else -value
        assert port[name] == pytest.approx(mirrored, abs=1e-6), name


def test_no_wind_stops_the_boat() -> None:
    """Without wind the boat slows down, stands upright and loses energy all the time."""
    run = simulate_inputs(
        PROBLEM_SAILBOAT.model,
        np.arange(0, 120, 0.2),
        inputs={"delta": 0.0, "sheet": 0.5, "wind_speed": 0.0, "wind_from": 0.0},
        initial={"u": 1.0, "phi": 0.3},
    )
    assert run.signal("u")[-1] < 0.35
    assert abs(run.signal("phi")[-1]) < 1e-3
    values = PROBLEM_SAILBOAT.model.values
    energy = (
        0.5 * (values["m"] + values["m_x"]) * run.signal("u") ** 2
        + 0.5 * (values["m"] + values["m_y"]) * run.signal("v") ** 2
        + 0.5 * values["I_xx_total"] * run.signal("p") ** 2
        + 0.5 * values["I_zz_total"] * run.signal("r") ** 2
        + values["m"] * 9.81 * values["GM"] * (1 - np.cos(run.signal("phi")))
    )
    assert np.all(np.diff(energy) < 1e-3 * energy[0])


def test_trajectories_do_not_depend_on_the_step() -> None:
    """A finer integration step moves no signal by its noise, gybes included."""
    noise = np.array([output.noise_std for output in PROBLEM_SAILBOAT.model.outputs])
    for record, experiment in zip(DATA, PROBLEM_SAILBOAT.experiments.values(), strict=True):
        finer = simulate_inputs(
            replace(PROBLEM_SAILBOAT.model, step=0.01),
            record.times,
            inputs=record.inputs,
            initial=experiment.initial,
        )
        away = np.sqrt(np.mean(((finer.outputs - record.outputs) / noise) ** 2, axis=0))
        assert np.all(away < 0.5), record.name


def test_sail_changes_sides_without_a_jump() -> None:
    """A tenth of a degree on either side of dead astern the forces of the sail are almost equal."""
    loads = []
    for angle in (179.9, 180.1):
        run = simulate_inputs(
            PROBLEM_SAILBOAT.model,
            np.array([0.0, 0.01]),
            inputs={"delta": 0.0, "sheet": 0.9, "wind_speed": 6.0, "wind_from": radians(angle)},
            initial={"u": 0.8},
        )
        loads.append(run.signal("p")[-1])
    jumping = 1.225 / 2 * 0.512 * 5.2**2 * 0.85 / 0.709 * 0.01  # roll rate that half a jump makes
    assert abs(loads[0] - loads[1]) < 0.05 * jumping


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1, 2])
def test_multiple_shooting_from_far_starts(seed: int) -> None:
    """From start values up to 30 % off, 38 derivatives return within four standard errors."""
    fit = SCRIPT_SAILBOAT.from_afar(seed)
    # A gybe depends on the integration step, and the status says so; the simulator shares the step.
    assert fit.status.code in ("converged", "integration")
    assert in_errors(fit) < 4.0


PROBLEM_TORPEDO = load_problem("torpedo")
EXPERIMENT = PROBLEM_TORPEDO.experiment("pitching")
SCRIPT_TORPEDO = paper("torpedo")
START = SCRIPT_TORPEDO.START


def test_noise_levels_are_shares_of_the_peaks() -> None:
    """Declared noise is one per cent of each channel's peak excursion in the experiment."""
    outputs = simulate(PROBLEM_TORPEDO.model, EXPERIMENT, noise=False).outputs
    peaks = np.abs(outputs).max(axis=0)
    peaks[4:] = np.abs(outputs[:, 4:] - outputs[0, 4:]).max(axis=0)
    declared = np.array([output.noise_std for output in PROBLEM_TORPEDO.model.outputs])
    assert declared == pytest.approx(0.01 * peaks, rel=5e-3)
    attack = np.degrees(np.abs(np.arctan2(outputs[:, 1], outputs[:, 0])).max())
    assert attack < 16.0


def test_forces_against_a_hand_calculation() -> None:
    """First accelerations equal those of the source's equations in its own axes."""
    values = PROBLEM_TORPEDO.model.values
    u, w, q, theta, delta = 4.0, -0.5, 0.1, 0.2, 0.05
    vx, vy = u, -w
    speed = np.hypot(vx, vy)
    alpha = -np.arctan2(vy, vx)
    pressure = 0.5 * 1025.0 * speed**2 * values["S"]
    turn = q * 6.0 / speed
    cy = 0.04 + 2.40 * alpha + 0.52 * delta + 1.00 * turn
    mz = 0.012 + 0.55 * alpha - 0.235 * delta - 0.62 * turn
    axial = pressure * (-0.145 * np.cos(alpha) + cy * np.sin(alpha))
    normal = pressure * (0.145 * np.sin(alpha) + cy * np.cos(alpha))
    weight, buoyancy = values["G"], values["B"]
    matrix = np.array([[1275.0, 0, 0], [0, 2480.0, -700.0], [0, -700.0, 6200.0]])
    right = [
        values["T"] - (weight - buoyancy) * np.sin(theta) + axial + 1250.0 * vy * q,
        normal - (weight - buoyancy) * np.cos(theta) - 1250.0 * vx * q,
        pressure * 6.0 * mz + buoyancy * 0.31 * np.cos(theta),
    ]
    expected = np.linalg.solve(matrix, right)
    h = 1e-5
    run = simulate_inputs(
        PROBLEM_TORPEDO.model,
        [0.0, h],
        inputs={"delta": delta},
        initial={"u": u, "w": w, "q": q, "theta": theta},
    )
    rates = (run.states[1] - run.states[0]) / h
    found = [rates[0], -rates[1], rates[2]]
    assert found == pytest.approx(expected, rel=1e-3, abs=1e-4)
