"""Silverbox: three official columns; structure and values from the multisine only.

The official records are parts of SNLS80mV (131,072 samples at 610.35 Hz): training 40,650 to
105,712, multisine test 105,712 to 127,400, arrow 100 to 40,575, arrow without extrapolation 100
to 32,100; the first 50 samples of a test may set the initial state and are not counted
(loader of nonlinearbenchmark.org).
"""

from __future__ import annotations

from functools import partial

import numpy as np

from benchmarks.scoreboard.row import Row, columns, held_back, place
from oed_sysid import Dataset, Fit, Model, MultipleShooting, Record, improve, load_problem
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs
from problems.silverbox.problem import FINER, PADDING, SAMPLING, band_limited

WHOLE = "silverbox/SNLS80mV.csv"
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


def whole() -> tuple[np.ndarray, np.ndarray]:
    """Input V1 and response V2 of SNLS80mV, V.

    Raises
    ------
    DataError
        If the file does not hold them.
    """
    voltage, response = columns(place(WHOLE), "V1", "V2")
    if len(voltage) != LENGTH:
        raise DataError(
            f"{len(voltage):,} rows; expected the {LENGTH:,} of SNLS80mV, because the official "
            "parts are counted from its beginning. Put the whole record there."
        )
    if (largest := np.abs([voltage, response]).max()) > LARGEST:
        raise DataError(f"values up to {largest:.3g}; expected {LARGEST:g} V at most. Give volts.")
    return voltage, response


def part_of(
    voltage: np.ndarray, response: np.ndarray, ends: tuple[int, int], model: Model
) -> Record:
    """A part with its input between the samples, as the problem's own records have it."""
    first, last = ends
    left, right = max(PADDING - first, 0), max(PADDING - (len(voltage) - last), 0)
    fine = band_limited(np.pad(voltage, (left, right)), first + left, last + left)
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
    train, test = load_problem("silverbox").data().split(test="test_third_realisation")
    alone = MultipleShooting(disturbances="none").fit(model, train)
    value = 1e3 * simulated_error(alone, test[0])
    what = "Silverbox, another realisation of the training part"
    said = "fitted to 1,500 samples; this part confirmed the effects"
    rows = [Row(what, value, "-", "mV", said)]

    def scored(what: str, published: str, ends: tuple[int, int]) -> list[Row]:
        error = 1e3 * simulated_error(fit, part_of(*whole(), ends, fit.model))
        return [Row(what, error, published, "mV", note)]

    form = f"SNLS80mV as two columns V1,V2 with a header ({LENGTH:,} rows)"
    for name, (ends, best) in PARTS.items():
        titles = f"Silverbox, {name}", f"{best}, {SOURCE}"
        rows += held_back(*titles, WHOLE, form, partial(scored, *titles, ends))
    return rows
