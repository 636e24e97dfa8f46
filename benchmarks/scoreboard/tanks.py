"""Cascaded tanks: named physics, structure chosen on the estimation record alone.

From Torricelli's law one effect is added at a time. Of the three that lower the error of the
estimation record most without a parameter at a bound, the one is taken that predicts masked
blocks best (each block of an eighth, the first excepted, by a fit that did not see it), as long
as this error falls. A structure is also fitted along a second way, and the better minimum is kept.
The validation record starts from the same unknown levels as the estimation record, as its
authors say; saturated readings are compared with predictions cut at the end of the range.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.scoreboard.row import (
    Row,
    Table,
    attempted,
    first_readable,
    missing,
    place,
    read_table,
)
from oed_sysid import Channels, Dataset, Model, MultipleShooting, Record, load_problem, read_csv
from oed_sysid.data.third_party import fetch
from oed_sysid.errors import DataError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.likelihood.fit import Fit

VALIDATION = "cascaded_tanks/validation.csv"


PUBLISHED = "cascaded_tanks/dataBenchmark.csv"


ESTIMATION = "cascaded_tanks/estimation.csv"


FORM = (
    "the 1024 validation samples, in the form of estimation.csv (t_s,u_V,y_V; the published "
    "dataBenchmark.csv is read as well)"
)


SAMPLES, SAMPLING = 1024, 4.0  # s


LOWEST, HIGHEST = -1.0, 11.0  # V, of pump and level


SAME = 1e-3  # V; five digits are kept of the estimation record


def at_hand() -> list[str]:
    """Files that may hold the validation record."""
    return [path for path in (VALIDATION, PUBLISHED) if place(path).is_file()]


def read_validation(channels: Channels) -> tuple[Record, str]:
    """The validation record, and which file it is from.

    Raises
    ------
    DataError
        If none of the files holds it.
    """
    paths = (place(VALIDATION), place(PUBLISHED))
    (columns, name), fault = first_readable(paths, (_own_form, _published_form))
    record = Record("validation", columns[0], columns[1], columns[2], channels, name)
    return record, f"{name}, because {fault}" if fault else name


def _own_form(path: Path) -> tuple[tuple[np.ndarray, ...], str]:
    """Times, input and level of a file with columns t_s, u_V and y_V."""
    table = read_table(path, {"t_s": ("t", "time_s", "time"), "u_V": ("u",), "y_V": ("y",)})
    _check_length(table.file, len(table))
    times = table.numbers("t_s")
    steps = np.diff(times)
    if np.abs(steps - SAMPLING).max() > 0.01 * SAMPLING:
        line = table.lines[int(np.argmax(np.abs(steps - SAMPLING))) + 1]
        raise DataError(
            f"{path.name} has steps of {steps.min():g} to {steps.max():g} s (line {line}); "
            f"expected {SAMPLING:g} s between samples. Correct t_s."
        )
    return _checked(path.name, table.numbers("u_V"), table.numbers("y_V"), times - times[0])


def _published_form(path: Path) -> tuple[tuple[np.ndarray, ...], str]:
    """The validation columns of the published table, its estimation columns compared."""
    names = ("uEst", "uVal", "yEst", "yVal")
    table = read_table(path, {**{name: () for name in names}, "Ts": ()})
    _check_length(table.file, len(table))
    sampling = table.numbers("Ts", slice(0, 1))[0]
    if abs(sampling - SAMPLING) > 0.01 * SAMPLING:
        raise DataError(f"{path.name} has Ts {sampling:g} s; expected {SAMPLING:g} s. Correct it.")
    own = _estimation()
    if own is not None:
        for name, column in (("uEst", "u_V"), ("yEst", "y_V")):
            if np.abs(table.numbers(name) - own.numbers(column)).max() > SAME:
                raise DataError(
                    f"{path.name}: {name} is not {column} of estimation.csv. Are columns swapped, "
                    "or is it another measurement? Put the published table there."
                )
    times = SAMPLING * np.arange(SAMPLES)
    return _checked(path.name, table.numbers("uVal"), table.numbers("yVal"), times)


def _check_length(file: str, rows: int) -> None:
    if rows != SAMPLES:
        raise DataError(
            f"{file} has {rows} samples; expected the {SAMPLES} of the official validation record. "
            "Put the whole record there."
        )


def _checked(
    file: str, pump: np.ndarray, level: np.ndarray, times: np.ndarray
) -> tuple[tuple[np.ndarray, ...], str]:
    """Columns in volts that are not those of the estimation record."""
    for name, column in (("the input", pump), ("the level", level)):
        if column.min() < LOWEST or column.max() > HIGHEST:
            raise DataError(
                f"{file}: {name} reaches from {column.min():g} to {column.max():g}; expected 0 to "
                "10 V. Give volts."
            )
    own = _estimation()
    if own is not None and np.abs(level - own.numbers("y_V")).max() < SAME:
        raise DataError(
            f"{file} holds the level of the estimation record, which was fitted to. Put the "
            "validation samples there."
        )
    return (times, pump[:, np.newaxis], level[:, np.newaxis]), file


def _estimation() -> Table | None:
    """The estimation record, if it is there."""
    path = place(ESTIMATION)
    return read_table(path, {"u_V": (), "y_V": ()}) if path.is_file() else None


FULL = 10.0  # V


BLOCKS = 8


SHORTLIST = 3  # candidates of a round that are judged by masked blocks


BEST = "0.191 V, Schoukens et al., results listed at nonlinearbenchmark.org"


# A brim is hard: water above it spills at once, as near as short steps follow; 1/s.
HARD = {"upper_overflow": "E_upper_overflow", "lower_overflow": "E_lower_overflow"}


SPILL, STEP = 2.0, 0.5


BEGIN = {"E_outflow_inertia": 2.0}  # s, away from zero, where the delay has no slope


CANDIDATES = (
    "linear_input",
    "upper_overflow",
    "lower_overflow",
    "level_exponent",
    "level_zero",
    "dead_voltage",
    "outflow_inertia",
    "pump_curve",
    "leak",
)


def read(path: str, model: Model) -> Record:
    """A record whose readings at the end of the range are marked missing."""
    whole = read_csv(place(path), model.channels)[0]
    level = whole.output("level")
    return whole.with_outputs(np.where(level < FULL, level, np.nan)[:, np.newaxis])


def begin() -> Model:
    """Torricelli's law, in steps that a hard brim allows."""
    return replace(load_problem("cascaded_tanks").variant("torricelli").model, step=STEP)


def grow(model: Model, name: str) -> Model:
    """The model with one candidate more."""
    if name == "linear_input":
        return replace(model, inputs=(replace(model.inputs[0], interpolation="linear"),))
    effect = load_problem("cascaded_tanks").variant("torricelli").effect(name)
    if name in HARD:
        effect = replace(
            effect,
            parameters=tuple(
                replace(p, value=SPILL, upper=SPILL, fixed=True) if p.name == HARD[name] else p
                for p in effect.parameters
            ),
        )
    grown = model + effect
    return grown.with_values({n: v for n, v in BEGIN.items() if n in effect.amplitude_names})


def fit(model: Model, record: Record, *, start: str = "auto") -> Fit:
    """Least squares on one record."""
    own = Record(record.name, record.times, record.inputs, record.outputs, model.channels)
    return MultipleShooting(disturbances="none", noise=[0.15], start=start, max_iterations=40).fit(
        model, Dataset((own,))
    )


def at_bound(found: Fit) -> bool:
    """Whether an estimate lies within a hundredth of its range of a bound."""
    for parameter in found.model.free_parameters:
        low, high = parameter.lower, parameter.upper
        value = found.values[parameter.name]
        room = 0.01 * (high - low if np.isfinite(high - low) else abs(value))
        if (value - low < room and low != 0.0) or high - value < room:
            return True
    return False


def masked(found: Fit, record: Record) -> float:
    """Error of blocks that the fit did not see, V."""
    errors, n = [], record.n_samples
    for k in range(1, BLOCKS):
        block = slice(k * n // BLOCKS, (k + 1) * n // BLOCKS)
        outputs = record.outputs.copy()
        held, outputs[block] = outputs[block].copy(), np.nan
        hidden = record.with_outputs(outputs)
        again = fit(found.model, hidden, start="near")
        own = Dataset((replace(hidden, channels=again.model.channels),))
        errors.append(again.predict(own).outputs[0][block] - held)
    return float(np.sqrt(np.nanmean(np.concatenate(errors) ** 2)))


def rebuilt(names: set[str], record: Record) -> Fit:
    """Fit of a structure that is grown in the order of ``CANDIDATES``, each step from the last.

    Brim, share, dead voltage and the law of the reading can replace one another: which minimum a
    fit ends in depends on the way that led there.
    """
    found = fit(begin(), record)
    for name in [name for name in CANDIDATES if name in names]:
        found = fit(grow(found.model, name), record, start="near")
    return found


def choose(record: Record, *, tell=print) -> tuple[Fit, tuple[str, ...], float]:
    """Structure and fit from the estimation record alone, and its error on masked blocks."""
    best = fit(begin(), record)
    error, chosen = masked(best, record), []
    while left := [name for name in CANDIDATES if name not in chosen]:
        trials = {}
        for name in left:
            try:
                trials[name] = fit(grow(best.model, name), record, start="near")
            except ValueError as fault:  # a candidate that cannot be fitted is not chosen
                tell(f"  {name}: {str(fault)[:80]}")
        ranked = sorted(trials, key=lambda name: trials[name].rms["level"])
        for name in ranked[:SHORTLIST]:
            again = rebuilt({*chosen, name}, record)
            if again.rms["level"] < trials[name].rms["level"]:
                trials[name] = again
        judged = {
            name: masked(trials[name], record)
            for name in [name for name in ranked if not at_bound(trials[name])][:SHORTLIST]
        }
        for name, value in judged.items():
            tell(f"  {name}: {trials[name].rms['level']:.3f} V, masked blocks {value:.3f} V")
        name = min(judged, key=judged.__getitem__, default=None)
        if name is None or judged[name] >= error:
            break
        tell(f"+ {name}")
        best, error = trials[name], judged[name]
        chosen.append(name)
    return best, tuple(chosen), error


def validation_error(found: Fit, validation: Record) -> float:
    """Simulation error of a validation record, V."""
    run = simulate_inputs(
        found.model,
        validation.times,
        inputs=validation.inputs,
        initial=dict(zip(found.model.state_names, found.initial_states[0], strict=True)),
    )
    away = np.minimum(run.outputs[:, 0], FULL) - validation.output("level")
    return float(np.sqrt(np.mean(away**2)))


def score() -> list[Row]:
    """Estimation, masked blocks, and the official validation record if it is there."""
    fetch("cascaded_tanks/estimation.csv")
    record = read("cascaded_tanks/estimation.csv", begin())
    best, chosen, error = choose(record)
    note = "Torricelli + " + ", ".join(chosen)
    what = "cascaded tanks, official validation"

    def official() -> list[Row]:
        validation, remark = read_validation(best.model.channels)
        value = validation_error(best, validation)
        return [Row(what, value, BEST, "V", f"{note}; from {remark}")]

    rows = [
        Row("cascaded tanks, estimation record", best.rms["level"], "-", "V", note),
        Row("cascaded tanks, masked blocks of it", error, "-", "V", "chose the structure"),
    ]
    if not at_hand():
        return [*rows, missing(what, BEST, VALIDATION, FORM)]
    return rows + attempted(what, BEST, at_hand()[0], official)
