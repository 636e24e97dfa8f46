"""The headlines of Xu, Zou and Yin (2012): a tanker's derivatives while it sails a zigzag.

Feeds a 5/5 zigzag sample by sample to the published recursion (of the inverse), to the one by
Cholesky and to the one of flat cost, prints the errors as they settle and how far each is from
the batch solution. Where the measured zigzags of KVLCC2 are at hand, K and T as the paper forms
them: the mean of three runs. ``--figures FOLDER`` draws the derivatives as they settle and what
they predict for a zigzag that was not seen.
"""

from __future__ import annotations

import argparse
import warnings
from pathlib import Path

import numpy as np

from oed_sysid import Dataset, load_problem
from oed_sysid.baselines import LeastSquaresSVM
from oed_sysid.baselines.equations import regression_form, rows_of
from oed_sysid.baselines.online import EquationStream, IncrementalLSSVM, RecursiveLSSVM
from oed_sysid.baselines.support_vectors import train
from oed_sysid.errors import DataError, PrecisionWarning
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.results import new_figure

WEIGHT = 3e5  # as published
STEP, SAMPLES = 1.5, 100  # s, and number: the measured example as published
RUNS = ("25_05", "15_05", "10_01")
PUBLISHED = (-0.2559, 15.6816)  # K, 1/s, and T, s
# Rudder and rate of a step: its first samples, as the difference equation says, or their mean.
INSTANT, AVERAGE = np.array([1.0, 0, 0, 0]), np.array([0.5, 1.0, 1.0, 0.5]) / 3
MACHINES = {
    "inverse": lambda weight: IncrementalLSSVM(C=weight, method="inverse"),
    "Cholesky": lambda weight: IncrementalLSSVM(C=weight, method="cholesky"),
    "flat": lambda weight: RecursiveLSSVM(C=weight),
}
problem = load_problem("online_ship")
NAMES = ("Y_v", "Y_r", "Y_delta", "N_v", "N_r", "N_delta")


def on_line(rule: str = "trapezoid") -> dict:
    """Coefficients after every sample of the 5/5 zigzag, and the distance from the batch."""
    record = simulate(problem.model, problem.experiment("zigzag_5_5"), noise=False)
    stream = EquationStream(problem.model, rule=rule)
    machines = {kind: {e: make(WEIGHT) for e in ("v", "r")} for kind, make in MACHINES.items()}
    pending: dict[str, list] = {"v": [], "r": []}
    history = []
    for k, moment in enumerate(record.times):
        sample = {name: record.output(name)[k] for name in record.channels.output_names}
        for row in stream.push(float(moment), sample | {"delta": record.input("delta")[k]}):
            if row.equation not in pending:
                continue
            rows = pending[row.equation]
            rows.append(row)
            for kind in machines.values():
                machine = kind[row.equation]
                if len(rows) == 2:  # the published start
                    machine.start([one.features for one in rows], [one.target for one in rows])
                elif len(rows) > 2:
                    machine.update(row.features, row.target)
        if len(pending["r"]) >= 6:
            flat = machines["flat"]
            history.append((k, np.hstack([flat[e].coefficients for e in ("v", "r")])))
    batch = LeastSquaresSVM(C=WEIGHT, rule=rule).fit(problem.model, Dataset((record,)))
    apart = {
        kind: max(
            np.abs(m.coefficients / [batch.values[n] for n in stream.names(e)] - 1).max()
            for e, m in own.items()
        )
        for kind, own in machines.items()
    }
    truth = np.array([problem.truth[name] for name in NAMES])
    return {
        "record": record,
        "samples": np.array([k for k, _ in history]),
        "errors": 100 * (np.array([values for _, values in history]) / truth - 1),
        "apart": apart,
        "model": problem.model.with_values(dict(zip(NAMES, history[-1][1], strict=True))),
    }


def recursion_gap(
    machine: IncrementalLSSVM | RecursiveLSSVM, features: np.ndarray, targets: np.ndarray
) -> float:
    """Largest relative distance of a recursion from the batch, after every sample.

    Parameters
    ----------
    machine : IncrementalLSSVM or RecursiveLSSVM
        Begins with two samples, as published.
    features : ndarray (n_samples, n_features)
    targets : ndarray (n_samples,)
    """
    machine.start(features[:2], targets[:2])
    worst = 0.0
    for k in range(2, len(targets)):
        machine.update(features[k], targets[k])
        # The recursion of flat cost is of the primal form, the others are of the dual.
        form = "primal" if isinstance(machine, RecursiveLSSVM) else "dual"
        batch = train(features[: k + 1], targets[: k + 1], C=machine.C, form=form)
        size = np.linalg.norm(batch.coefficients)
        away = np.linalg.norm(machine.coefficients - batch.coefficients)
        worst = max(worst, away / size, abs(machine.bias - batch.bias) / size)
    return float(worst)


def yaw_rows(noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Features ``(200, 3)`` and targets of the yaw equation, noise a share of the targets' spread."""
    record = simulate(problem.model, problem.experiment("zigzag_5_5"), noise=False)
    rows = rows_of(regression_form(problem.model), Dataset((record,)), rule="trapezoid")
    features, targets, _ = rows.equation(1)
    rng = np.random.default_rng(0)
    return features, targets + noise * targets.std() * rng.standard_normal(len(targets))


def discrete_zigzag(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Yaw rate and rudder, degrees, of the published discrete model under a 15/5 zigzag."""
    gain, time_constant = PUBLISHED
    rate, rudder = np.zeros(n + 1), np.zeros(n + 1)
    heading, order = 0.0, 15.0
    for k in range(n + 1):
        if order * (-heading) > 0 and abs(heading) >= 5:
            order = -order
        rudder[k] = order
        if k < n:
            rate[k + 1] = rate[k] + STEP / time_constant * (gain * order - rate[k])
            heading += STEP * 0.5 * (rate[k] + rate[k + 1])
    return rate, rudder


def second_example(noise: float, seed: int) -> np.ndarray:
    """K and T after 3 to 100 samples of the published model, ``(98, 2)``; noise of the rate's spread."""
    rate, rudder = discrete_zigzag(SAMPLES)
    rng = np.random.default_rng(seed)
    seen = rate + noise * rate.std() * rng.standard_normal(len(rate))
    machine = IncrementalLSSVM(C=WEIGHT)
    features, targets = np.column_stack([seen[:-1], rudder[:-1]]), np.diff(seen)
    machine.start(features[:2], targets[:2])
    found = []
    for row, target in zip(features[2:], targets[2:], strict=True):
        machine.update(row, target)
        by_rate, by_rudder = machine.coefficients
        found.append((-by_rudder / by_rate, -STEP / by_rate))
    return np.array(found)


def measured(average: np.ndarray, weight: float, unit: float) -> dict[str, np.ndarray]:
    """K and T of each measured run, ``(3, 2)``, by every recursion.

    Also the residual of the published recursion, ``(3,)``, and whether it warned.
    """
    data = load_problem("kvlcc2").data()
    found: dict[str, list] = {kind: [] for kind in MACHINES}
    residuals, warned = [], []
    for run in RUNS:
        rate, rudder = (unit * s for s in (data[run].output("r"), data[run].input("delta")))
        ends = np.arange(0, 3 * SAMPLES + 1, 3)  # 2 Hz records
        rows = np.array([[average @ s[k : k + 4] for s in (rate, rudder)] for k in ends[:-1]])
        targets = np.diff(rate[ends])
        for kind, make in MACHINES.items():
            machine = make(weight)
            machine.start(rows[:2], targets[:2])
            for row, target in zip(rows[2:], targets[2:], strict=True):
                machine.update(row, target)
            with warnings.catch_warnings(record=True) as said:
                warnings.simplefilter("always", PrecisionWarning)
                by_rate, by_rudder = machine.coefficients
                if kind == "inverse":
                    residuals.append(machine.residual)
                    warned.append(bool(said))
            found[kind].append((-by_rudder / by_rate, -STEP / by_rate))
    return {kind: np.array(values) for kind, values in found.items()} | {
        "residual": np.array(residuals),
        "warned": np.array(warned),
    }


def figures(folder: Path, found: dict) -> None:
    """Derivatives as they settle; the zigzag 10/10 predicted by those after the 5/5."""
    figure, grid = new_figure(1, 1, size=(7, 4))
    axes = grid[0, 0]
    for name, track, line in zip(NAMES, found["errors"].T, 3 * ("-", "--"), strict=True):
        axes.plot(found["samples"], track, line, label=name)
    axes.axhline(0.0, color="black", linewidth=0.8)
    axes.axvline(60, color="gray", linestyle=":", label="published: settled")
    axes.set(xlabel="samples of 3 s", ylabel="error [%]", ylim=(-10, 10))
    axes.legend(ncols=2)
    figure.savefig(folder / "tanker_derivatives.png", dpi=120)

    unseen = simulate(problem.model, problem.experiment("zigzag_10_10"), noise=False)
    run = simulate_inputs(found["model"], unseen.times, inputs=unseen.inputs)
    figure, grid = new_figure(3, 1, size=(7, 6), sharex=True)
    panels = grid[:, 0]
    labels = ("sway velocity v [m/s]", "yaw rate r [deg/s]", "heading psi [deg]")
    for k, (axes, label) in enumerate(zip(panels, labels, strict=True)):
        factor = np.degrees(1.0) if k else 1.0
        axes.plot(unseen.times, factor * unseen.outputs[:, k], color="black", label="simulator")
        axes.plot(unseen.times, factor * run.outputs[:, k], "--", color="C1", label="identified")
        axes.set_ylabel(label)
    panels[2].plot(
        unseen.times, np.degrees(unseen.input("delta")), ":", color="gray", label="rudder"
    )
    panels[2].legend(ncols=3)
    panels[2].set_xlabel("time [s]")
    figure.savefig(folder / "tanker_predictions.png", dpi=120)


def main(arguments: list[str] | None = None) -> None:
    """Print the headlines."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--figures", type=Path, help="folder for the figures")
    folder = parser.parse_args(arguments).figures
    found = on_line()
    print(f"{'samples':>8}" + "".join(f"{name:>10}" for name in NAMES) + "   errors in %")
    for count in (10, 30, 60, 100, 200):
        row = found["errors"][np.flatnonzero(found["samples"] == count)[0]]
        print(f"{count:8d}" + "".join(f"{error:10.2f}" for error in row))
    print("Distance from the batch, relative, after 200 samples:")
    for kind, apart in found["apart"].items():
        print(f"  {kind:10}{apart:.0e}")
    print("Published: derivatives settle after about 60 samples.")
    try:
        ways = {
            (unit, weight, label): measured(average, weight, factor)
            for unit, factor in (("rad", 1.0), ("deg", np.degrees(1.0)))
            for weight in (WEIGHT, 1e8)
            for label, average in (("at once", INSTANT), ("averaged", AVERAGE))
        }
    except DataError as error:
        print(f"The measured example is left out: {error}")
    else:
        print()
        print("Measured zigzags 25/5, 15/5 and 10/1, 100 samples of 1.5 s: mean K [1/s] and T [s]")
        print(f"{'unit':5}{'C':>7} {'rudder':9}{'published form':>18}{'left':>9}{'Cholesky':>18}")
        for (unit, weight, label), one in ways.items():
            pairs = [f"{k:8.3f} {t:7.2f}" for k, t in (one[w].mean(0) for w in MACHINES)]
            left = f"{one['residual'].max():.0e}"
            print(f"{unit:5}{weight:7.0e} {label:9}{pairs[0]:>18}{left:>9}{pairs[1]:>18}")
        print("'left' is the largest relative residual of the published form's own equations.")
        print("Published: -0.2559 1/s and 15.68 s, mean of the three.")
    if folder:
        folder.mkdir(parents=True, exist_ok=True)
        figures(folder, found)


if __name__ == "__main__":
    main()
