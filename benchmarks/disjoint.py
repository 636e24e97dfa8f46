r"""Are errors between records honest, and how far does the fit's own statement fall short?

    python -m benchmarks.disjoint [--repeats 200] [--write]

A fit states errors from its residuals, and errors from the scatter between its records, to first
order (``fit.record_errors``). Two tables: how far the second exceed the first on measured zigzags,
whose truth nobody knows; and, with the measured rudder of the same zigzags moving a simulated ship
whose parameters are known and may vary from run to run,

.. math:: \sqrt{\operatorname{mean}(\hat p - p)^2 / \operatorname{mean} s^2}

by both kinds of error *s*, one if they are honest, and how often a 95 % interval holds the truth
(Student's with one degree of freedom less than there are records for those between them).
``--write`` writes the tables into docs/extrapolation.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.special import stdtrit

from benchmarks.harness import ROOT, command, markdown, named, write_page
from oed_sysid import Dataset, Model, MultipleShooting, Record, load_problem, simulate_inputs

PAGE = ROOT / "docs" / "extrapolation.md"
WHITE = MultipleShooting(disturbances="none")
# Noise of the simulated logs, and by how much their parameters vary from run to run.
HEADING_NOISE, RATE_NOISE, VARIATION = math.radians(0.1), math.radians(0.02), 0.1


def whole_table() -> list[str]:
    """All records fitted together: how far the scatter between them exceeds stated errors."""
    heading, motion = load_problem("kvlcc2"), load_problem("kvlcc2", variant="mmg")
    esso = load_problem("esso_osaka")
    zigzags = named(esso.data(), "zigzag")
    head = ("all records together", "records", "parameters", "told", "most", "median of all")
    rows: list[Sequence[object]] = []
    for ship, model, data in (
        ("KVLCC2, Nomoto", heading.model, heading.data()),
        ("KVLCC2, MMG", motion.model, motion.data()),
        ("Esso Osaka zigzags, MMG with wind", esso.models["wind"], zigzags),
    ):
        for name, estimator in (("white", WHITE), ("default", MultipleShooting())):
            fit = estimator.fit(model, data)
            assert fit.record_scatter is not None
            factor, clear = fit.record_scatter.exceeds(
                np.diag(fit.covariance), np.diag(fit.information.covariance)
            )
            most = f"{fit.names[int(np.argmax(factor))]} {factor.max():.1f} times"
            middle = f"{np.median(factor):.1f} times"
            rows.append((f"{ship}, {name}", len(data), len(factor), int(clear.sum()), most, middle))
            print(*rows[-1], sep=" | ", flush=True)
    return markdown(head, rows)


def simulated(
    model: Model, logs: Sequence[Record], variation: float, repeats: int, *, seed: int = 0
) -> dict[str, float]:
    """Fit logs whose measured rudder moves a ship that is a little another one in each run.

    Parameters
    ----------
    model : Model
        The truth on average, with two outputs, heading and rate.
    logs : sequence of Record
        Their times and inputs are taken.
    variation : float
        Relative standard deviation of each free parameter from run to run.
    repeats : int
        Data sets.

    Returns
    -------
    dict
        Errors over those stated by the fit and between records (``stated``, ``between``), the share
        of 95 % intervals of either that hold the truth (``stated held``, ``between held``), and of
        fits that say that their records differ (``told``).
    """
    names = model.free_names
    levels = np.array([HEADING_NOISE, RATE_NOISE])
    outputs = tuple(
        replace(output, noise_std=float(level))
        for output, level in zip(model.outputs, levels, strict=True)
    )
    model = replace(model, outputs=outputs)
    true = np.array([model.values[name] for name in names])
    errors, sizes, told = [], [], 0
    for repeat in range(repeats):
        rng = np.random.default_rng((seed, repeat))
        runs = []
        for log in logs:
            own = true * (1.0 + variation * rng.standard_normal(len(true)))
            at = model.with_values(dict(zip(names, map(float, own), strict=True)))
            run = simulate_inputs(at, log.times, inputs=log.inputs, initial={})
            noisy = run.outputs + levels * rng.standard_normal(run.outputs.shape)
            runs.append(Record(log.name, log.times, log.inputs, noisy, model.channels))
        fit = WHITE.fit(model, Dataset(runs))
        errors.append(fit.estimates - true)
        sizes.append([[own[n] for n in names] for own in (fit.std_errors, fit.record_errors)])
        told += any(concern.kind == "records_differ" for concern in fit.concerns)
    away, found = np.array(errors), {"told": told / repeats}
    for kind, size, freedom in zip(
        ("stated", "between"), np.moveaxis(sizes, 1, 0), (math.inf, len(logs) - 1), strict=True
    ):
        found[kind] = math.sqrt(np.mean(away**2 / np.mean(size**2, axis=0)))
        found[f"{kind} held"] = float(np.mean(np.abs(away) < stdtrit(freedom, 0.975) * size))
    return found


def truth_table(repeats: int) -> list[str]:
    """Nomoto's equation with the measured rudder of all zigzags, or of every second one."""
    problem = load_problem("kvlcc2")
    logs = list(problem.data())
    model = problem.model.with_values({"K": -0.2, "T": 12.0})
    head = ("simulated truth", "records", "stated by the fit", "between records", "told")
    rows = []
    for name, variation in (
        ("K and T the same in all runs", 0.0),
        (f"K and T vary by {100 * VARIATION:.0f} % from run to run", VARIATION),
    ):
        for chosen in (logs, logs[::2]):
            found = simulated(model, chosen, variation, repeats)
            cells = [
                f"{found[kind]:.2f}, {100 * found[f'{kind} held']:.0f} %"
                for kind in ("stated", "between")
            ]
            rows.append((name, len(chosen), *cells, f"{100 * found['told']:.0f} %"))
            print(*rows[-1], sep=" | ", flush=True)
    return markdown(head, rows)


def main(*, repeats: int = 200, write: bool = False) -> None:
    """Print both tables as they grow; write them into the page if asked to.

    Parameters
    ----------
    repeats : int
        simulated data sets
    write : bool
        write docs/extrapolation.md
    """
    lines = [*whole_table(), "", *truth_table(repeats)]
    if write:
        write_page(PAGE, "\n".join(lines), "disjoint")


if __name__ == "__main__":
    command(main)
