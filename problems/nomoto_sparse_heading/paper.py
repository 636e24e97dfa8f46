"""The headline of Han, Bai, Yu and Lian (2023): K and T from headings of every 0.5 s.

Prints the mean error of K and T, relative to what 0.1 s gives as in the paper and
against the truth, over other ships and with noise, and multiple shooting on the raw
sparse headings beside it. ``--figures FOLDER`` draws the headings that each predicts and
the errors against the noise.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from scipy.interpolate import CubicSpline, PchipInterpolator

from oed_sysid import Dataset, MultipleShooting, Record, load_problem
from oed_sysid.baselines import HeadingDifferences
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.results import new_figure

problem = load_problem("nomoto_sparse_heading")
CASES = {
    "K 2, T 0.3": ("default", "zigzag_15_15"),
    "K 0.5, T 0.6": ("K0.5_T0.6", "fast_rudder"),
    "K 0.5, T 1": ("K0.5_T1", "fast_rudder"),
    "K 0.5, T 2": ("K0.5_T2", "fast_rudder"),
}
NOISES = (0.0, 0.0005, 0.002)  # rad
CURVES = ("0.5 s", "spiral", "cubic")
COLUMNS = (*(f"{way}, to 0.1 s" for way in CURVES), *CURVES, "shooting")


# -- sparse headings filled in ---------------------------------------------------------

INTERPOLATED = {
    "cubic": lambda times, values, grid: CubicSpline(times, values)(grid),
    "pchip": lambda times, values, grid: PchipInterpolator(times, values)(grid),
    "linear": lambda times, values, grid: np.interp(grid, times, values),
}
METHODS = ("spiral", *INTERPOLATED)
# Turns of the direction below this are straight lines.
STRAIGHT = 1e-9


def dense_times(times: np.ndarray, factor: int) -> np.ndarray:
    """Times of ``factor`` equal steps within each interval, shape ``((n - 1) * factor + 1,)``."""
    index = np.arange((len(times) - 1) * factor + 1) / factor
    return np.interp(index, np.arange(len(times)), times)


def archimedes_spiral(
    times: np.ndarray,
    values: np.ndarray,
    factor: int,
    *,
    tangent: str = "chord",
    scale: float = 1.0,
) -> np.ndarray:
    r"""Join samples by pieces of Archimedes spirals in the plane of time and value.

    From the point :math:`A_i` a spiral
    :math:`A_i + k\vartheta\,(\cos(\rho\vartheta + \sigma), \sin(\rho\vartheta + \sigma))`
    leaves in the direction :math:`\sigma` of the curve before and turns until it
    meets :math:`A_{i+1}`: with :math:`\beta` the direction of the chord,
    :math:`\rho = \mathrm{sign}(\beta - \sigma)`, it ends at
    :math:`\vartheta^* = |\beta - \sigma|` and :math:`k = |A_{i+1} - A_i|/\vartheta^*`
    is the only scale that meets the point. The result depends on the units of
    time and value, as angles in a plane of unlike quantities do.

    Parameters
    ----------
    times, values : ndarray (n,)
        Samples; published in s and rad.
    factor : int
        Steps per interval.
    tangent : str
        Direction at which the next spiral leaves: ``"chord"``, from the last
        inserted point to the sample, as published (a disturbance of the
        direction decays by ``(factor - 1)/factor`` per interval), or
        ``"exact"``, that of the curve's end (it does not decay at all).
    scale : float
        Multiplies the values while curves are drawn.

    Returns
    -------
    ndarray ((n - 1) * factor + 1,)

    References
    ----------
    Han, Bai, Yu & Lian (2023), Ship Science and Technology 45(7), eq. 17-23; the
    scale ``k`` and the local sense of turning are completed here (README of the
    problem ``nomoto_sparse_heading``).
    """
    heights = values * scale
    grid = dense_times(times, factor)
    dense = np.empty(len(grid))
    dense[0] = heights[0]
    # The first piece is the chord itself (eq. 21).
    direction = np.arctan2(heights[1] - heights[0], times[1] - times[0])
    for i in range(len(times) - 1):
        inner = slice(i * factor + 1, (i + 1) * factor + 1)
        start = np.array([times[i], heights[i]])
        end = np.array([times[i + 1], heights[i + 1]])
        dense[inner], final = _piece(start, end, direction, grid[inner])
        if tangent == "exact":
            direction = final
        else:
            last = (i + 1) * factor
            direction = np.arctan2(dense[last] - dense[last - 1], grid[last] - grid[last - 1])
    return dense / scale


def _piece(
    start: np.ndarray, end: np.ndarray, direction: float, wanted: np.ndarray
) -> tuple[np.ndarray, float]:
    """One spiral at the wanted times, and the direction at its end."""
    chord = end - start
    beta = float(np.arctan2(chord[1], chord[0]))
    turn = float((beta - direction + np.pi) % (2 * np.pi) - np.pi)
    if abs(turn) < STRAIGHT:
        heights = start[1] + (wanted - start[0]) * chord[1] / chord[0]
        return heights, beta
    sense, last = np.sign(turn), abs(turn)
    k = float(np.hypot(*chord)) / last
    angle = last * (wanted - start[0]) / chord[0]
    low, high = np.zeros_like(angle), np.full_like(angle, last)
    for _ in range(60):
        phase = sense * angle + direction
        error = start[0] + k * angle * np.cos(phase) - wanted
        slope = k * (np.cos(phase) - sense * angle * np.sin(phase))
        low, high = np.where(error <= 0, angle, low), np.where(error > 0, angle, high)
        with np.errstate(divide="ignore", invalid="ignore"):
            step = angle - error / slope
        inside = np.isfinite(step) & (step >= low) & (step <= high)
        new = np.where(inside, step, 0.5 * (low + high))
        if np.max(np.abs(new - angle)) < 1e-14:
            break
        angle = new
    heights = start[1] + k * angle * np.sin(sense * angle + direction)
    heights[-1] = end[1]
    return heights, beta + float(sense * np.arctan(last))


def densify(times: np.ndarray, values: np.ndarray, factor: int, *, method: str) -> np.ndarray:
    """Values ``((n - 1) * factor + 1,)`` at equal steps within each interval of the samples.

    They are no measurements: they carry no information that the sparse ones lack.
    """
    if method == "spiral":
        return archimedes_spiral(times, values, factor)
    return np.asarray(INTERPOLATED[method](times, values, dense_times(times, factor)))


def reconstruct(record: Record, factor: int, *, method: str) -> Record:
    """Record with every output filled in and inputs linear between samples."""
    grid = dense_times(record.times, factor)
    outputs = [densify(record.times, one, factor, method=method) for one in record.outputs.T]
    inputs = [np.interp(grid, record.times, one) for one in record.inputs.T]
    name, both = f"{record.name}_{method}", (np.column_stack(inputs), np.column_stack(outputs))
    return Record(name, grid, *both, record.channels)


# -- estimates ---------------------------------------------------------------------------


def gain_and_time(record: Record) -> np.ndarray:
    """K and T by the published difference equation."""
    fit = HeadingDifferences().fit(problem.model, Dataset((record,)))
    return np.array([fit.values["K"], fit.values["T"]])


def share(found: np.ndarray, reference: np.ndarray) -> float:
    """Mean error of K and T in per cent."""
    return float(100 * np.abs(found / reference - 1).mean())


def clean_record(case: str) -> Record:
    """The zigzag of a ship, every 0.01 s, without noise."""
    variant, experiment = CASES[case]
    ship = problem.variant(variant)
    return simulate(ship.model, ship.experiment(experiment), noise=False)


def one(case: str, noise: float, seed: int) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """K and T by every way from one realisation; and those from 0.1 s."""
    clean, rng = clean_record(case), np.random.default_rng(seed)
    record = clean.with_outputs(clean.outputs + noise * rng.normal(size=clean.outputs.shape))
    sparse = record.thin(50)
    curves = (sparse, *(reconstruct(sparse, 5, method=way) for way in CURVES[1:]))
    found = {way: gain_and_time(curve) for way, curve in zip(CURVES, curves, strict=True)}
    found["shooting"] = shooting(case, sparse)
    return found, gain_and_time(record.thin(10))


def shooting(case: str, record: Record) -> np.ndarray:
    """K and T by multiple shooting on the headings as they are."""
    start = problem.variant(CASES[case][0]).model.with_values({"K": 1.0, "T": 1.0})
    fit = MultipleShooting(disturbances="none").fit(start, Dataset((record,)))
    return np.array([fit.values["K"], fit.values["T"]])


def true_values(case: str) -> np.ndarray:
    """K and T of a ship."""
    values = problem.variant(CASES[case][0]).model.values
    return np.array([values["K"], values["T"]])


def signed(case: str) -> dict[str, np.ndarray]:
    """Errors of K and T against the truth, per cent, ``(2,)``, by every way without noise.

    Beside the ways of `one`: differences at 0.1 s, and multiple shooting on headings of every
    0.5 s with the rudder of every 0.1 s.
    """
    found, reference = one(case, 0.0, 0)
    fine = clean_record(case).thin(10)
    outputs = np.full_like(fine.outputs, np.nan)
    outputs[::5] = fine.outputs[::5]
    found |= {"0.1 s": reference, "fine rudder": shooting(case, fine.with_outputs(outputs))}
    return {way: 100 * (pair / true_values(case) - 1) for way, pair in found.items()}


def errors(case: str, noise: float, seeds: int = 10) -> np.ndarray:
    """Mean errors in the order of ``COLUMNS``, per cent."""
    truth, rows = true_values(case), []
    for seed in range(1 if noise == 0 else seeds):
        found, reference = one(case, noise, seed)
        rows.append(
            [share(found[way], reference) for way in CURVES]
            + [share(found[way], truth) for way in (*CURVES, "shooting")]
        )
    return np.mean(rows, axis=0)


def prediction(case: str, noise: float = 0.0) -> dict[str, np.ndarray]:
    """Headings that each way's K and T give for the same rudder, rad."""
    record = clean_record(case)
    found, _ = one(case, noise, 0)
    model = problem.variant(CASES[case][0]).model
    return {"truth": record.outputs[:, 0]} | {
        way: simulate_inputs(
            model.with_values(dict(zip("KT", pair, strict=True))),
            record.times,
            inputs=record.inputs,
        ).outputs[:, 0]
        for way, pair in found.items()
    }


def figures(folder: Path, table: dict[tuple[str, float], np.ndarray]) -> None:
    """Headings predicted, their errors, and errors of K and T against the noise."""
    case = next(iter(CASES))
    record, runs = clean_record(case), prediction(case)
    figure, grid = new_figure(2, 1, size=(7, 5.5), sharex=True)
    top, bottom = grid[:, 0]
    for way, heading in runs.items():
        style = {"color": "black"} if way == "truth" else {"linestyle": "--"}
        top.plot(record.times, np.degrees(heading), label=way, **style)
        if way != "truth":
            bottom.plot(record.times, np.degrees(heading - runs["truth"]), label=way)
    top.set(ylabel="heading psi [deg]", title=case)
    bottom.set(ylabel="error of psi [deg]", xlabel="time [s]")
    top.legend(ncols=3)
    bottom.legend(ncols=4)
    figure.savefig(folder / "nomoto_prediction.png", dpi=120)

    figure, grid = new_figure(2, 2, size=(8, 6), sharex=True, sharey=True)
    for axes, name in zip(grid.ravel(), CASES, strict=True):
        for k, way in enumerate(COLUMNS[3:], start=3):
            line = [table[name, noise][k] for noise in NOISES]
            axes.semilogy(1e3 * np.array(NOISES), line, "o-", label=way)
        axes.set_title(name)
    for axes in grid[-1]:
        axes.set_xlabel("noise of the heading [mrad]")
    for axes in grid[:, 0]:
        axes.set_ylabel("mean error of K and T [%]")
    grid[0, 0].legend()
    figure.savefig(folder / "nomoto_error_against_noise.png", dpi=120)


def main(arguments: list[str] | None = None) -> None:
    """Print the headline."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    folder = parser.parse_args(arguments).figures
    print(f"mean error, %{'':16}relative to 0.1 s{'':13}against the truth")
    print(f"{'':12}{'noise':>7}" + "".join(f"{way:>10}" for way in (*CURVES, *COLUMNS[3:])))
    table = {(case, noise): errors(case, noise) for case in CASES for noise in NOISES}
    for (case, noise), mean in table.items():
        print(f"{case:12}{noise:7.4f}" + "".join(f"{value:10.2f}" for value in mean))
    spiral, cubic = COLUMNS.index("spiral"), COLUMNS.index("cubic")
    wins = sum(mean[spiral] < mean[cubic] for mean in table.values())
    print()
    print(
        "Published, relative to 0.1 s: 33.5 from 0.5 s, 2.4 with the spiral, 3.4 with the cubic "
        f"spline. Here the spiral is closer to the truth than the spline in {wins} of "
        f"{len(table)} rows."
    )
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        figures(folder, table)


if __name__ == "__main__":
    main()
