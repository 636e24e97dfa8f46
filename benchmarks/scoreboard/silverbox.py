"""Silverbox: three official columns; structure and values from the multisine only.

The official records are parts of SNLS80mV (131,072 samples at 610.35 Hz): training 40,650 to
105,712, multisine test 105,712 to 127,400, arrow 100 to 40,575, arrow without extrapolation 100
to 32,100; the first 50 samples of a test may set the initial state and are not counted
(loader of nonlinearbenchmark.org).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from scipy.io import loadmat

from benchmarks.scoreboard.row import (
    Row,
    attempted,
    first_readable,
    missing,
    place,
    read_table,
    refused,
)
from oed_sysid import Dataset, Model, MultipleShooting, Record, improve, load_problem
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.fit import Fit
from problems.silverbox.problem import FINER, PADDING, SAMPLING, band_limited

WHOLE, ORIGINAL = "silverbox/SNLS80mV.csv", "silverbox/SNLS80mV.mat"
LENGTH = 131_072
LARGEST = 2.0  # V; the record stays below 0.4 V
FIRST = 50  # samples that may set the initial state
PARTS = {
    "multisine": ((105_712, 127_400), "0.36 mV"),
    "arrow": ((100, 40_575), "0.26 mV"),
    "arrow without extrapolation": ((100, 32_100), "0.32 mV"),
}
SOURCE = "best of the column, results listed at nonlinearbenchmark.org"


def learn() -> tuple[Model, Fit, tuple[str, ...]]:
    """Model with the effects that `improve` finds on two multisine parts, and its fit to both."""
    problem = load_problem("silverbox")
    data = problem.data()
    train, test = data.split(test="test_third_realisation")
    found = improve(problem.model, train, test, candidates=problem.effects, max_effects=4)
    model = problem.model
    for step in found.steps:
        model = model + step.effect
    fit = MultipleShooting(disturbances="none").fit(model, data)
    return model, fit, tuple(step.added for step in found.steps)


def whole() -> tuple[np.ndarray, np.ndarray, str]:
    """Input and response of SNLS80mV, V, and a remark on a file that could not be read.

    Raises
    ------
    DataError
        If neither file can be read.
    """
    paths = (place(WHOLE), place(ORIGINAL))
    (voltage, response), fault = first_readable(paths, (read_text, read_original))
    return voltage, response, f"; {paths[1].name} read, because {fault}" if fault else ""


def read_text(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Columns V1 and V2 of a text file, V."""
    table = read_table(path, {"V1": (), "V2": ()})
    return checked(table.numbers("V1"), table.numbers("V2"), path)


def read_original(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Variables V1 and V2 of a MATLAB file, V."""
    try:
        found = {name.upper(): value for name, value in loadmat(path).items()}
    except Exception as error:  # of several types, by what is wrong with the file
        raise DataError(
            f"{path.name} cannot be read as a MATLAB file up to version 7 ({str(error)[:80]}). "
            f"Save it in this form, or put {Path(WHOLE).name} beside it."
        ) from None
    if lacking := [name for name in ("V1", "V2") if name not in found]:
        known = ", ".join(name for name in found if not name.startswith("__"))
        raise DataError(
            f"{path.name} has no variable {lacking[0]}; it has {known or 'none'}. Expected V1, V2."
        )
    columns = [np.asarray(found[name], dtype=float).ravel() for name in ("V1", "V2")]
    return checked(columns[0], columns[1], path)


def checked(voltage: np.ndarray, response: np.ndarray, path: Path) -> tuple[np.ndarray, np.ndarray]:
    """The columns if they can be SNLS80mV: its length, in volts, V1 the input."""
    for name, column in (("V1", voltage), ("V2", response)):
        if len(column) != LENGTH:
            raise DataError(
                f"{path.name} has {len(column):,} rows of {name}; expected the {LENGTH:,} of "
                "SNLS80mV, because the official parts are counted from its beginning. Put the "
                "whole record there."
            )
        if not np.isfinite(column).all():
            raise DataError(f"{path.name} has values of {name} that are not finite. Correct them.")
        if np.abs(column).max() > LARGEST:
            raise DataError(
                f"{path.name} has values of {name} up to {np.abs(column).max():.3g}; expected at "
                f"most {LARGEST:g} V. Is it in mV? Give V."
            )
    return voltage, response


def part_of(
    voltage: np.ndarray, response: np.ndarray, ends: tuple[int, int], model: Model
) -> Record:
    """A part with its input between the samples, as the problem's own records have it."""
    first, last = ends
    margin = min(PADDING, first, len(voltage) - last)
    if margin < PADDING:
        left, right = max(PADDING - first, 0), max(PADDING - (len(voltage) - last), 0)
        voltage = np.pad(voltage, (left, right))
        fine = band_limited(voltage, first + left, last + left)
    else:
        fine = band_limited(voltage, first, last)
    outputs = np.full(len(fine), np.nan)
    outputs[::FINER] = response[first:last]
    times = np.arange(len(fine)) / (FINER * SAMPLING)
    return Record("part", times, fine, outputs, model.channels)


def simulated_error(fit: Fit, record: Record) -> float:
    """Rms of the simulation after the first samples, which set the initial state, V."""
    begin = record.window(0.0, record.times[FIRST * FINER])
    initial = fit.predict(Dataset((begin,))).initial_states[0]
    run = simulate_inputs(fit.model, record.times, inputs=record.inputs, initial=initial)
    away = (run.outputs - record.outputs)[FIRST * FINER :]
    return float(np.sqrt(np.nanmean(away**2)))


def score() -> list[Row]:
    """Three columns, and the validation realisation that is at hand."""
    model, fit, added = learn()
    note = f"linear + {', '.join(added)}; fitted to 3,500 samples of the multisine"
    problem = load_problem("silverbox")
    train, test = problem.data().split(test="test_third_realisation")
    alone = MultipleShooting(disturbances="none").fit(model, train)
    value = 1e3 * simulated_error(alone, test[0])
    rows = [
        Row(
            "Silverbox, another realisation of the training part",
            value,
            "-",
            "mV",
            "fitted to 1,500 samples; this part confirmed the effects",
        )
    ]
    titles = [(f"Silverbox, {name}", f"{best}, {SOURCE}") for name, (_, best) in PARTS.items()]
    if not (place(WHOLE).is_file() or place(ORIGINAL).is_file()):
        form = (
            f"SNLS80mV as two columns V1,V2 with a header ({LENGTH:,} rows; SNLS80mV.mat is read "
            "as well)"
        )
        return rows + [missing(what, published, WHOLE, form) for what, published in titles]
    try:
        voltage, response, remark = whole()
    except Exception as error:
        return rows + [refused(what, published, WHOLE, error) for what, published in titles]
    for (what, published), (ends, _) in zip(titles, PARTS.values(), strict=True):

        def one(what=what, published=published, ends=ends):
            record = part_of(voltage, response, ends, fit.model)
            error = 1e3 * simulated_error(fit, record)
            return [Row(what, error, published, "mV", note + remark)]

        rows += attempted(what, published, WHOLE, one)
    return rows
