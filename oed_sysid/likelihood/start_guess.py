"""States that no sensor measures, guessed from those that sensors do measure.

A measured pitch angle has a slope, and ``theta' = q`` turns it into a pitch
rate; a measured depth and ``z' = -u sin(theta) + w cos(theta)`` give a heave
velocity. Equations that hold whatever the unknown parameters are (kinematics,
and outputs that are functions of several states) are solved sample by sample.
The result only starts an estimation; it never enters its result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError, ModelError
from oed_sysid.physics.model import Model
from oed_sysid.text import expressions

# Samples of the smoothing window, each twice as long as the one before: that with the least noise
# and bias together is taken.
WINDOWS = tuple(2**k + 1 for k in range(2, 7))
# What is known of a state before anything is measured, in units of its scale.
VAGUE = 10.0


@dataclass(frozen=True, eq=False)
class Guess:
    """Series of one state, shape ``(n_times,)``, and roughly how far it may be off.

    ``std`` is that of the median sample, ``rms`` of all samples: a speed that follows from
    ``z' = -u sin(theta)`` is good while the vehicle pitches and worthless where it is level.
    """

    series: np.ndarray
    std: float
    rms: float


Equation = tuple[Callable[[dict[str, np.ndarray]], np.ndarray], frozenset[str], np.ndarray, float]


def kinematic_states(
    model: Model, record: Record, measured: Mapping[int, np.ndarray]
) -> dict[int, Guess]:
    """Guess unmeasured states from parameter-free equations.

    Parameters
    ----------
    model : Model
        The model; only its kinematics, signals and outputs are used.
    record : Record
        What was measured.
    measured : mapping
        Position of a state to its series ``(n_times,)``, free of gaps.

    Returns
    -------
    dict
        Position of an unmeasured state to its :class:`Guess`; states about
        which the equations say nothing are left out.
    """
    names = model.state_names
    if len(measured) == len(names):
        return {}
    known = {names[position]: series for position, series in measured.items()}
    slopes = {name: slope(record.times, series) for name, series in known.items()}
    guesses: dict[int, Guess] = {}
    # States found in one round have slopes in the next: a position gives a
    # velocity, and a velocity whatever its own parameter-free equation holds.
    for _ in range(2):
        wanted = [name for name in names if name not in known]
        found = _solve(model, record, known, slopes, wanted) if wanted else {}
        for name, guess in found.items():
            guesses[names.index(name)] = guess
            known[name] = guess.series
            slopes[name] = slope(record.times, guess.series)
        if not found:
            break
    return guesses


def slope(times: np.ndarray, series: np.ndarray) -> tuple[np.ndarray, float]:
    """Time derivative of a noisy series and its typical error.

    Local parabolas over a window; of several windows the one with the least
    sum of noise (from third differences) and bias (from the window before).
    """
    # Here, not above: it takes longer to import than the whole package, and with every
    # state measured nothing is guessed.
    from scipy.signal import savgol_filter

    n = len(series)
    step = np.gradient(times)
    # Third differences of white noise have 20 times its variance; 0.6745 is the normal median.
    noise = np.median(np.abs(np.diff(series, 3))) / 0.6745 / np.sqrt(20.0) if n > 8 else 0.0
    best, least = np.gradient(series, times), np.inf
    before = None
    for window in WINDOWS:
        if window > n:
            break
        # The ends of all but the first are replaced below: there any of the cheap ways will do.
        ends = "interp" if before is None else "nearest"
        trial = savgol_filter(series, window, 2, deriv=1, mode=ends) / step
        variance = float(12.0 * noise**2 / window**3 / np.median(step) ** 2)
        bias = 0.0
        if before is not None:
            # At the ends a long window looks one way only; the shorter one is less biased.
            half = window // 2
            trial[:half], trial[-half:] = before[0][:half], before[0][-half:]
            spread = float(np.mean((trial - before[0]) ** 2))
            bias = max(spread - (before[1] - variance), 0.0)
        if bias + variance < least:
            best, least = trial, bias + variance
        before = trial, variance
    floor = 1e-3 * float(np.std(best)) + 1e-12
    return best, float(np.sqrt(least)) + floor if np.isfinite(least) else floor


def _solve(
    model: Model,
    record: Record,
    known: dict[str, np.ndarray],
    slopes: Mapping[str, tuple[np.ndarray, float]],
    wanted: list[str],
) -> dict[str, Guess]:
    """Gauss-Newton at every sample at once, on all wanted states that occur."""
    equations, wanted = _telling(_equations(model, record, slopes), known, wanted)
    if not equations:
        return {}
    scales = {state.name: state.scale for state in model.states if state.name in wanted}
    vague = VAGUE * np.array([scales[name] for name in wanted])
    values = np.zeros((len(record.times), len(wanted)))
    with np.errstate(all="ignore"):
        for _ in range(5):  # the equations of one sample are nearly linear
            matrix, right = _normal(equations, known, scales, values)
            matrix = matrix + np.diag(vague**-2)
            right = right - values / vague**2
            if not (np.isfinite(matrix).all() and np.isfinite(right).all()):
                return {}
            # A Gauss-Newton step for every sample at once, each with its own few unknowns.
            values = values + np.linalg.solve(matrix, right[:, :, None])[:, :, 0]
    variances = np.linalg.inv(matrix).diagonal(axis1=1, axis2=2)
    std, rms = np.sqrt(np.median(variances, axis=0)), np.sqrt(np.mean(variances, axis=0))
    # A state that stayed as vague as before is left to simulation.
    return {
        name: Guess(values[:, i], float(std[i]), float(rms[i]))
        for i, name in enumerate(wanted)
        if std[i] < 0.5 * vague[i]
    }


def _telling(
    equations: list[Equation], known: Mapping[str, np.ndarray], wanted: list[str]
) -> tuple[list[Equation], list[str]]:
    """Equations that hold nothing but what is known or wanted, and what of it they hold."""
    equations = [e for e in equations if e[1] & set(wanted)]
    told = [name for name in wanted if any(name in e[1] for e in equations)]
    return [e for e in equations if e[1] <= {*known, *told}], told


def _normal(
    equations: list[Equation],
    known: Mapping[str, np.ndarray],
    scales: Mapping[str, float],
    values: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of every sample, ``(n_times, n, n)`` and ``(n_times, n)``.

    Derivatives by the states of ``scales`` are central differences at ``values``.
    """
    n, size = values.shape
    matrix, right = np.zeros((n, size, size)), np.zeros((n, size))
    here = {**known, **dict(zip(scales, values.T, strict=True))}
    for function, _, target, error in equations:
        residual = (target - function(here)) / error
        rows = np.empty((n, size))
        for i, (name, scale) in enumerate(scales.items()):
            h = 1e-4 * scale
            up = function(here | {name: here[name] + h})
            rows[:, i] = (up - function(here | {name: here[name] - h})) / (2 * h * error)
        matrix += rows[:, :, None] * rows[:, None, :]
        right += rows * residual[:, None]
    return matrix, right


def _equations(
    model: Model, record: Record, slopes: Mapping[str, tuple[np.ndarray, float]]
) -> list[Equation]:
    """Parameter-free equations with a known left side, as functions of the states."""
    free = slopes.keys() - touched(model)
    told = [(text, slopes[s]) for s, text in model.kinematics.items() if s in free]
    told += _measured(model, record)
    found = [(_function(model, record, text), known) for text, known in told]
    return [(*one, *known) for one, known in found if one is not None]


def touched(model: Model) -> set[str]:
    """States, signals and outputs to which an effect adds something."""
    return {key for e in model.effects for key in e.terms if isinstance(key, str)}


def _measured(model: Model, record: Record) -> Iterator[tuple[str, tuple[np.ndarray, float]]]:
    """Expressions of outputs that are no state, with their series and typical errors."""
    for column, output in enumerate(model.outputs):
        series = _filled(record, column)
        known = output.source in model.state_names or output.name in touched(model)
        if series is not None and not known:
            error = output.noise_std or 0.02 * (float(np.std(series)) + 1e-12)
            yield output.source, (series, error)


def _filled(record: Record, column: int) -> np.ndarray | None:
    """Series of an output, linear over what is missing; None where next to nothing is measured."""
    series = record.outputs[:, column]
    present = np.isfinite(series)
    if present.sum() < 2:
        return None
    return np.interp(record.times, record.times[present], series[present])


def _function(
    model: Model, record: Record, text: str
) -> tuple[Callable[[dict[str, np.ndarray]], np.ndarray], frozenset[str]] | None:
    """Expression as a function of the states; None if anything unknown enters it."""
    needed = needed_by(model, text, {*model.state_names})
    if needed is None:
        return None
    used, ordered, constants = needed

    def evaluate(here: dict[str, np.ndarray]) -> np.ndarray:
        scope: dict[str, object] = {**constants, "t": record.times, **here}
        for name in ordered:
            scope[name] = expressions.to_numpy(model.signals[name], scope)
        return np.broadcast_to(expressions.to_numpy(text, scope), record.times.shape)

    return evaluate, frozenset(used)


def needed_by(
    model: Model, text: str, known: set[str]
) -> tuple[list[str], list[str], dict[str, float]] | None:
    """What of some known names an expression needs, and signals of the model, in their order.

    With the values of fixed parameters. None where anything else enters: what is estimated, a
    signal to which an effect adds something, a function of the user's.
    """
    constants = {p.name: p.value for p in model.all_parameters if p.fixed}
    inner = {name: model.signals[name] for name in model.signals.keys() - touched(model)}
    used, found = list[str](), set[str]()
    called, pending = {*expressions.functions(text)}, sorted(expressions.names(text))
    while pending:
        name = pending.pop(0)
        if name in known:
            used.append(name)
        elif name in inner:
            found.add(name)
            text = inner.pop(name)
            called |= expressions.functions(text)
            pending += sorted(expressions.names(text))
        elif name not in {*found, *constants, "t"}:
            return None
    inside = sorted(found, key=[*model.signals].index)
    return None if called - set(expressions.FUNCTIONS) else (used, inside, constants)


# Longest interval by default: over more samples a wrong model runs far from the
# measurements, and iterations grow with the record.
MOST_SAMPLES = 100


def check_channels(model: Model, dataset: Dataset) -> None:
    """Raise :class:`DataError` where records and model name different signals."""
    if isinstance(dataset, Record):
        raise DataError("Expected a dataset, got a single record. Write Dataset((record,)).")
    if not isinstance(dataset, Dataset) or not isinstance(model, Model):
        found = " and ".join(type(one).__name__ for one in (model, dataset))
        raise DataError(
            f"Expected a model and a dataset, got {found}. Records are put together by "
            "Dataset(records); check() takes the dataset first, everything else the model."
        )
    for record in dataset:
        for what in ("input", "output"):
            found, expected = (getattr(one, f"{what}_names") for one in (record.channels, model))
            if found != expected:
                raise DataError(
                    f"Record {record.name!r} has {what}s {found}, model {model.name!r} expects "
                    f"{expected}. Read it with the model's channels."
                )


def cut(record: Record, interval: float | None) -> np.ndarray:
    """Index of the first sample of each shooting interval."""
    n = len(record.times)
    if interval is None:
        length = min(max(5, int(np.ceil(n / 30))), MOST_SAMPLES)
        return np.arange(0, max(n - length // 2, 1), length, dtype=np.intc)
    if not interval > 0:
        raise ModelError(f"Shooting interval is {interval} s. Give a positive length.")
    if not np.isfinite(interval):
        return np.zeros(1, dtype=np.intc)
    edges = np.arange(record.times[0], record.times[-1], interval)
    starts = np.unique(np.searchsorted(record.times, edges - 1e-9))
    keep = [0]
    for start in starts[1:]:
        if start - keep[-1] >= 2 and n - start >= 2:
            keep.append(int(start))
    return np.array(keep, dtype=np.intc)


def measured_columns(model: Model) -> dict[int, int]:
    """Map the position of every state that is measured directly to its output."""
    return {
        model.state_names.index(output.source): column
        for column, output in enumerate(model.outputs)
        if output.source in model.state_names
    }


def measured_states(model: Model, record: Record) -> dict[int, np.ndarray]:
    """Smoothed series of every state that an output measures directly."""
    filled = {state: _filled(record, column) for state, column in measured_columns(model).items()}
    return {state: smooth(series) for state, series in filled.items() if series is not None}


def first_state(
    model: Model, record: Record, known: Mapping[str, float] | None = None
) -> np.ndarray:
    """State at the first sample, ``(n_states,)``: known, else measured, else zero."""
    own = np.zeros(len(model.states))
    for position, series in measured_states(model, record).items():
        own[position] = series[0]
    for name, value in (known or {}).items():
        own[model.state_names.index(name)] = value
    return own


def smooth(series: np.ndarray) -> np.ndarray:
    """Average over five samples, with straight-line ends."""
    if len(series) < 10:
        return series
    padded = np.concatenate(
        [2 * series[0] - series[2:0:-1], series, 2 * series[-1] - series[-2:-4:-1]]
    )
    # Point reflection at the ends keeps a straight line straight.
    return np.convolve(padded, np.full(5, 0.2), mode="valid")
