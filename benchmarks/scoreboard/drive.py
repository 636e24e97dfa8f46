r"""Positioning drive (EMPS): what `improve` finds, beside four parameters fitted by SciPy.

.. math:: m \dot v = F - F_v v - F_c \operatorname{sign} v + F_0

The reference shares no code with the package: steps of a millisecond in which dry friction stops
the carriage exactly, least squares of SciPy on the same half of the record. Both are judged by
whole runs of the other half and of the record with pulses, which nothing is chosen on; start states
are fitted to the run in both.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from scipy.optimize import least_squares

from benchmarks.scoreboard.row import Row, held_back, place
from oed_sysid import Dataset, Record, improve
from oed_sysid.evidence.improvement import Improvement
from problems.positioning_drive.problem import HALVES, ORIGINAL, THIN, original, problem, read

PULSES = "emps/DATA_EMPS_PULSES.mat"
STEP = 1e-3  # s
AUTHORS = np.abs([*problem.published.values()])  # kg, N s/m, N, N
MILLIMETRE = 1e-3
SOURCE = "whole-run error of four parameters by SciPy"


def sliding(values: np.ndarray, force: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Positions of a carriage that dry friction can stop, ``(n_samples,)``."""
    mass, viscous, dry, offset = values
    x, v = start
    lost = 0.5 * STEP * viscous / mass
    positions = np.empty(len(force))
    for k, push in enumerate(force):
        positions[k] = x
        # Trapezoidal in the viscous friction.
        free = (v * (1.0 - lost) + STEP * (push + offset) / mass) / (1.0 + lost)
        after = np.sign(free) * max(abs(free) - STEP * dry / mass, 0.0)
        x, v = x + 0.5 * STEP * (v + after), after
    return positions


def reference(force: np.ndarray, position: np.ndarray) -> np.ndarray:
    """Mass, viscous and dry friction and offset by SciPy, from half a record."""
    size = np.array([1.0, 10.0, 1.0, 0.3, MILLIMETRE, 0.01])

    def away(scaled: np.ndarray) -> np.ndarray:
        values = begin + size * scaled
        return (sliding(values[:4], force, values[4:]) - position)[::THIN] / MILLIMETRE

    begin = np.array([*AUTHORS, position[0], 0.0])
    return (begin + size * least_squares(away, np.zeros(6)).x)[:4]


def error(values: np.ndarray, force: np.ndarray, position: np.ndarray) -> float:
    """Rms error of a whole run whose start is fitted, m."""
    size = np.array([MILLIMETRE, 0.01])

    def away(scaled: np.ndarray) -> np.ndarray:
        start = np.array([position[0], 0.0]) + size * scaled
        return (sliding(values, force, start) - position)[::THIN] / MILLIMETRE

    return MILLIMETRE * float(np.sqrt(np.mean(least_squares(away, np.zeros(2)).fun ** 2)))


def rows(found: Improvement, parts: dict[str, Record], values: np.ndarray) -> Iterator[Row]:
    """Whole-run errors of both on records that nothing was fitted to."""
    added = ", ".join(step.added for step in found.steps)
    for what, record in parts.items():
        path = PULSES if record.source == PULSES else ORIGINAL
        force, position = original(place(path))
        if path == ORIGINAL:
            half = record.n_samples * THIN
            force, position = (signal[half : 2 * half] for signal in (force, position))
        own = 1e3 * found.fit.predict(Dataset((record,))).rms["x"]
        theirs = 1e3 * error(values, force, position)
        note = (
            f"mass, viscous friction + {added}; fitted to the first half; ratio {own / theirs:.2f}"
        )
        yield Row(what, own, f"{theirs:.2f} mm, {SOURCE}", "mm", note)


def score() -> list[Row]:
    """Second half, the record with pulses if it is there, and the parameters."""
    train, test = problem.data().split(test=HALVES[1])
    found = improve(problem.model, train, test, candidates=problem.effects)
    force, position = original(place(ORIGINAL))
    half = train[0].n_samples * THIN
    values = reference(force[:half], position[:half])
    told = list(
        rows(found, {"positioning drive, second half (it confirmed the effects)": test[0]}, values)
    )
    names = ("m", "X_v", "E_coulomb_friction", "X_0")
    for name, theirs, authors in zip(
        names, values * [1, -1, 1, 1], AUTHORS * [1, -1, 1, 1], strict=True
    ):
        if name not in found.fit.names:
            continue
        unit = found.fit.model.parameter(name).unit
        low, high = found.fit.interval(name)
        note = f"95 % interval {low:.4g} to {high:.4g}; authors of the record {authors:g}"
        published = f"{theirs:.4g} {unit}, SciPy"
        told.append(
            Row(f"positioning drive, {name}", found.fit.values[name], published, unit, note)
        )
    what = "positioning drive, record with force pulses"
    return told + held_back(
        what, SOURCE, PULSES, "the published MATLAB file",
        lambda: rows(found, {what: read(place(PULSES), PULSES)}, values),
    )  # fmt: skip
