r"""Departures of a log from a model: signals that are late, off, of another scale or place.

An output that comes late by :math:`\tau` leaves :math:`-\tau\,\dot h` in its residual, one whose
zero is off :math:`c` itself, one of a scale :math:`1 + s` :math:`s\,h`; an input that acts late
leaves :math:`\tau\,\partial y/\partial\tau`, found by simulating with the shifted input. With
``g`` this column and ``J`` those of all unknowns, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad s = g'\epsilon - g'J(J'J)^{+}J'\epsilon, \quad
    \hat\tau = s/I, \quad \operatorname{std}\hat\tau = I^{-1/2},

a score test at no departure with everything else estimated too (Cox & Hinkley 1974, ch. 9). All
compete: the one that explains most is named, others follow once it is mended.

What one instrument measures departs together. Outputs of one unit may be late by the same time, and
positions be those of a receiver, accelerations those of a unit, at :math:`\ell` from the origin,

.. math:: g = R\,e_i = \partial \dot\eta / \partial \nu_i , \qquad
    g = \dot\omega \times e_i + \omega \times (\omega \times e_i) ,

the direction of a body axis being what a velocity along it adds to the rates of the positions, and
:math:`\omega` the rates of turn. What one clock times is late by a share of the time since the
record began.

Actuators that did not begin at their first command.

What an actuator remembers (the angle of a fin that lags, the side of a gap) begins at the first
command of a record. Where the true one was :math:`s` beside it, the outputs miss
:math:`s\,\partial y/\partial m_0`, and parameters bend to it. As for delays
(:mod:`oed_sysid.likelihood.departures`), with ``g`` this column of one record, ``J`` those of all
unknowns and :math:`\epsilon` the residuals, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad \hat s = \frac{g'(1 - J(J'J)^{+}J')\epsilon}{I}, \quad
    \operatorname{std}\hat s = I^{-1/2} .

:func:`~oed_sysid.physics.unknown_start` makes it one of the unknowns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import TypeVar

import numpy as np
from scipy.special import ndtri

from oed_sysid.compiled.graph import build
from oed_sysid.compiled.kernels import Kernel, Run, by_unknowns, kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.likelihood.estimate import ActuatorStart, Departure, Estimate
from oed_sysid.likelihood.information import COLOUR_LIMIT
from oed_sysid.likelihood.noise_levels import RARE, parabolas
from oed_sysid.likelihood.projection import project_out, score_beside
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import BEYOND, MATERIAL, THREE_DIGITS
from oed_sysid.text import expressions

Departed = TypeVar("Departed", Departure, ActuatorStart)
# Standard errors from which one value is not another, or a signal is no noise.
CLEARLY = float(-ndtri(RARE))


def _slope_before(outputs: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Slopes ``(n_times, ...)`` from the sample before to each; none at the first."""
    rise = (outputs[1:].T - outputs[:-1].T) / np.diff(times)
    return np.concatenate([np.zeros_like(outputs[:1]), rise.T])


# What a unit of each departure adds to outputs ``(n_times, n)`` at some times, s. An output that is
# late shows what was: y(t - d) = y(t) - d y'(t), with the slope before t. That after t would tell a
# filter's innovations of measurements to come, and right logs would seem early.
SHAPES: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "late": lambda outputs, times: -_slope_before(outputs, times),
    "slow": lambda outputs, times: -((times - times[0]) * _slope_before(outputs, times).T).T,
    "off": lambda outputs, _: np.ones_like(outputs),
    "scale": lambda outputs, _: outputs,
}
# What an input does that is late, s, or whose zero is off, in its unit.
ACTING = ("acts late", "acts off")
# Kinds that are a matter of time.
MOMENTS = ("late", "slow", "acts late")
# Axis of the body along which a receiver of positions may be away from the origin.
LEVERS = {"ahead": "X", "to starboard": "Y", "below": "Z"}


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What one record says of departures ``g``, its own unknowns estimated along.

    Attributes
    ----------
    record : str
    products : ndarray (n_shared + n_departures + 1, n_shared + n_departures + 1)
        Of the columns of the shared parameters, of ``g`` and of the residuals ``e``, start states
        and parameters of the record projected out.
    raw : ndarray (n_departures,)
        ``g'g``, before these took their part.
    squares, count : float
        Sum of squares and number of the residuals in units of noise.
    """

    record: str
    products: np.ndarray
    raw: np.ndarray
    squares: float
    count: int


# Columns of the departures of one record: its index, its run, derivatives by its full start state.
Signatures = Callable[[int, Run, np.ndarray], np.ndarray]


def _evidence(fit: Estimate, signatures: Signatures, fewest: int = 1) -> list[_Evidence]:
    """What every record says of departures; nothing where a trajectory is not finite."""
    n_shared, free, n_own = len(fit.names), fit.model.free_names, kernel(fit.model).n_own
    local = [n_own + free.index(name) for name in free if name not in fit.names]
    order = [n_own + free.index(name) for name in fit.names]
    order += [*range(n_own), *local]
    found: list[_Evidence] = []
    for index, record in enumerate(fit.dataset):
        if record.independent or record.n_samples < fewest:
            continue
        known = _sensitivities(fit, index)
        if known is None:
            return []
        run, by_start, jacobian = known
        scaled = fit.residuals[index] / fit.sigma
        present = np.isfinite(scaled)
        rows = np.concatenate([jacobian[:, :, order], signatures(index, run, by_start)], axis=2)
        rows, errors = (rows / fit.sigma[:, None])[present], scaled[present]
        if not np.isfinite(rows).all():
            return []
        raw = rows[:, len(order) :]
        apart = np.column_stack([rows[:, :n_shared], raw, errors])
        apart = project_out(rows[:, n_shared : len(order)], apart)
        square = float(errors @ errors)
        found.append(
            _Evidence(record.name, apart.T @ apart, np.sum(raw**2, axis=0), square, len(errors))
        )
    return found


@dataclass(frozen=True)
class _Score:
    """Size of a departure in a record (or in all), its error and what it explains."""

    column: int
    record: str
    size: float
    std: float
    gain: float
    share: float


def _scores(fit: Estimate, parts: Sequence[_Evidence], *, joint: bool) -> Iterator[_Score]:
    """Departures that the records tell, each record on its own or all ``joint``.

    Where the noise is larger than declared, errors are too.
    """
    if not parts:
        return
    numbers = [one.name for one in fields(_Evidence)[1:]]
    total = _Evidence("", *(sum(getattr(part, name) for part in parts) for name in numbers))
    misfit, n = max(total.squares / max(total.count, 1), 1.0), len(fit.names)
    shared, absent = np.split(np.arange(len(total.products) - 1), [n])
    for part in [total] if joint else parts:
        excess = max(part.squares - part.count, 1e-9)
        # All shared parameters estimated along, over all records.
        products = part.products.copy()
        products[:n, :n], products[:n, -1] = total.products[:n, :n], total.products[:n, -1]
        matrix, score = score_beside(products[:-1, :-1], products[:-1, -1], absent, shared)
        information = np.diag(matrix)
        for column in np.flatnonzero(information > 1e-9 * np.maximum(part.raw, 1e-300)):
            # One Gauss-Newton step from zero; what it explains is step times score.
            size = float(score[column] / information[column])
            gain, std = size * float(score[column]), float(np.sqrt(misfit / information[column]))
            share = min(gain / excess, 1.0)
            yield _Score(int(column), part.record, size, std, gain, share)


def asked_of(model: Model) -> list[tuple[tuple[str, ...], str]]:
    """Signals and kinds of the departures that are asked, of outputs and of inputs."""
    return [
        *(((name,), kind) for kind in SHAPES for name in model.output_names),
        *((signals, kind) for signals in of_one_unit(model) for kind in ("late", "slow")),
        *((signals, kind) for signals in instruments_of(model) for kind in LEVERS),
        *(((name,), kind) for kind in ACTING for name in model.input_names),
    ]


def of_one_unit(model: Model) -> list[tuple[str, ...]]:
    """Outputs of one unit, where there are several: one receiver may have measured them."""
    found = dict[str, tuple[str, ...]]()
    for one in model.outputs:
        found[one.unit] = (*found.get(one.unit, ()), one.name)
    return [signals for signals in found.values() if len(signals) > 1]


def positions_of(model: Model) -> tuple[str, ...]:
    """Outputs that are positions of the vehicle."""
    return tuple(
        one.name for one in model.outputs if one.unit == "m" and one.source in model.kinematics
    )


def accelerations_of(model: Model) -> dict[str, int]:
    """Outputs that are accelerations of the vehicle, and the body axis of each."""
    axes = {f"dot({model.axes.get(axis)})": i for i, axis in enumerate(LEVERS.values())}
    found = ((one.name, axes.keys() & expressions.names(one.source)) for one in model.outputs)
    return {name: axes[told.pop()] for name, told in found if len(told) == 1}


def instruments_of(model: Model) -> list[tuple[str, ...]]:
    """Outputs of a receiver and of accelerometers, of which it is asked where these are.

    A single position does not tell that from its zero. What turning does to accelerations needs no
    velocity along the arm: a heave and pitch model has accelerometers ahead.
    """
    positions, accelerations = positions_of(model), tuple(accelerations_of(model))
    return [*[positions] * (len(positions) > 1), *[accelerations] * bool(accelerations)]


def off_origin(
    model: Model, kind: str, values: np.ndarray, states: np.ndarray, times: np.ndarray
) -> np.ndarray:
    """What instruments 1 m off the origin add to positions and accelerations.

    Parameters
    ----------
    model : Model
    kind : str
        Of :data:`LEVERS`.
    values : ndarray (n_parameters,)
    states : ndarray (n_times, n_states)
        Of the vehicle, perhaps with those that effects add behind them.
    times : ndarray (n_times,)

    Returns
    -------
    ndarray (n_times, n_outputs)
    """
    graph, names = build(model), model.state_names
    own = np.zeros((graph.n_states, len(times)))
    own[: len(names)] = states[:, : len(names)].T
    faster = own.copy()
    if LEVERS[kind] in model.axes:
        faster[names.index(model.axes[LEVERS[kind]])] += 1.0
    before, after = (np.array(graph.rates(x, 0.0, values, times[None])) for x in (own, faster))
    turning = np.zeros((len(times), 3))
    for i, axis in enumerate("KMN"):
        if axis in model.axes:
            turning[:, i] = states[:, names.index(model.axes[axis])]
    arm = np.eye(3)[[*LEVERS].index(kind)]
    around = np.cross(turning, np.cross(turning, arm))
    around += np.cross(np.gradient(turning, times, axis=0), arm)
    accelerations, added = accelerations_of(model), np.zeros((len(times), len(model.outputs)))
    for column, output in enumerate(model.outputs):
        if output.name in positions_of(model):
            row = names.index(output.source)
            added[:, column] = after[row] - before[row]
        elif output.name in accelerations:
            added[:, column] = around[:, accelerations[output.name]]
    return added


def estimate_departures(fit: Estimate) -> tuple[Departure, ...]:
    """Score estimates of what may be wrong with single signals, at a fit with white noise.

    See the equations above; residuals that are coloured enlarge the standard errors by the root
    of the ratio of all to independent samples, those larger than declared by their misfit.
    """
    own = slowness(fit)
    found = []
    for one in _scores(fit, _evidence(fit, partial(_departed, fit), fewest=3), joint=True):
        signals, kind = asked_of(fit.model)[one.column]
        std = one.std * max(own[name] for name in (own if kind in ACTING else signals))
        numbers = one.size, std, one.gain, one.share
        found.append(Departure(signals[0], kind, *numbers, together=signals[1:]))
    return tuple(found)


def slowness(fit: Estimate) -> dict[str, float]:
    """Roots of samples over independent samples of every output."""
    counts = fit.effective_samples().items()
    return {name: float(np.sqrt(max(n, 1) / max(some, 1.0))) for name, (some, n) in counts}


def _departed(fit: Estimate, index: int, run: Run, _: np.ndarray) -> np.ndarray:
    """Derivatives of a record's outputs by every departure that is asked."""
    record, shift, model = fit.dataset[index], fit.dataset[index].sample_time, fit.model
    values, calm = values_of(fit, index), smoothed_inputs(record)
    known = np.array_equal(calm, record.inputs)
    smoothed = run.outputs if known else outputs_of(fit, index, calm)
    shapes = {kind: shape(smoothed, record.times) for kind, shape in SHAPES.items()}
    for kind in LEVERS if instruments_of(model) else ():
        shapes[kind] = off_origin(model, kind, values, run.states, record.times)
    columns = []
    for signals, kind in asked_of(model):
        if kind in shapes:
            columns.append(shapes[kind] * np.isin(model.output_names, signals))
            continue
        moved = acting(record, model.input_names.index(signals[0]), kind, shift).inputs
        # Commands are steps, without derivatives: the difference of two runs takes their place.
        still = np.array_equal(moved, record.inputs)
        after = run.outputs if still else outputs_of(fit, index, moved)
        columns.append((after - run.outputs) / shift)
    return np.stack(columns, axis=2)


def acting(record: Record, column: int, kind: str, by: float) -> Record:
    """A record in which one input acts later by some seconds, or is larger by so much."""
    inputs = record.inputs.copy()
    if kind == "acts late":
        known = smoothed_inputs(record)[:, column]
        inputs[:, column] += np.interp(record.times - by, record.times, known) - known
    else:
        inputs[:, column] += by
    return record.with_inputs(inputs)


def undone(fit: Estimate, records: Dataset, one: Departure) -> Dataset:
    """Records as they would be without a departure, the noise of every sample as it is.

    A late output moves by whole samples, and by what the runs of a fit do between them; another
    loses what the departure makes of the runs; an input acts at its time. Where that is beyond the
    record it tells nothing, and the runs stand in place of the outputs.
    """
    result, model = list[Record](), fit.model
    for index, record in enumerate(records):
        times, outputs = record.times, record.outputs
        late = {"late": one.size, "acts late": one.size, "slow": one.size * (times - times[0])}
        moment = times - late.get(one.kind, 0.0)
        named = np.isin(model.output_names, one.signals)
        if one.kind in ACTING:
            record = acting(record, model.input_names.index(one.signal), one.kind, one.size)
            named[:] = True
        run = run_of(fit, index, record.inputs, kernel(model))
        if one.kind in ("late", "slow"):
            middle = 0.5 * (moment[1:] + moment[:-1])
            nearest = np.searchsorted(middle, times)
            between = [np.interp(moment[nearest], times, series) for series in run.outputs.T]
            outputs = outputs[nearest] + run.outputs - np.column_stack(between)
        elif one.kind not in ACTING:
            outputs = outputs - one.size * _shape(fit, index, run, one.kind)
        outside = ((times < moment[0]) | (times > moment[-1]))[:, None]
        outputs = np.where(outside, run.outputs, outputs)
        result.append(record.with_outputs(np.where(named, outputs, record.outputs)))
    return Dataset(tuple(result))


def _shape(fit: Estimate, index: int, run: Run, kind: str) -> np.ndarray:
    """What a unit of a departure of outputs adds to a run, ``(n_times, n_outputs)``."""
    times = fit.dataset[index].times
    if kind in LEVERS:
        return off_origin(fit.model, kind, values_of(fit, index), run.states, times)
    return SHAPES[kind](run.outputs, times)


def followed(
    fit: Estimate, first: Departure, refit: Callable[[Dataset], Estimate]
) -> tuple[Departure, float]:
    """A departure estimated to its end, and the log-likelihood of the records without it.

    Parameters
    ----------
    fit : Estimate
        To white noise, of the records as they are.
    first : Departure
        By one step from that.
    refit : callable
        The fit of other records.
    """
    best, told, before = first, -np.inf, fit.log_likelihood
    end, size = fit, first.size
    for _ in range(8):
        again = refit(undone(end, fit.dataset, replace(first, size=size)))
        more = estimate_departures(again) if np.isfinite(again.cost) else ()
        step = next((d for d in more if (d.signals, d.kind) == (first.signals, first.kind)), None)
        if step is None:
            break
        # The runs that set records right are those of the fit before.
        gained, before = again.log_likelihood - before, again.log_likelihood
        if again.log_likelihood > told:
            best, told = replace(first, size=size, std=step.std), again.log_likelihood
        if abs(step.size) < MATERIAL * step.std and gained < MATERIAL:
            break
        end, size = again, size + step.size
    # What one step promises counts only where no fit of the records set right has an end.
    return best, told if np.isfinite(told) else fit.log_likelihood + 0.5 * first.gain


def smoothed_inputs(record: Record, names: Sequence[str] | None = None) -> np.ndarray:
    """Inputs ``(n_times, n_inputs)``, some by parabolas: those linear between samples by default.

    Noise of what was measured is in the residuals, too: a departure that had it as well would be
    taken for late or early.
    """
    inputs = record.inputs.copy()
    for column, channel in enumerate(record.channels.inputs):
        if channel.interpolation == "linear" if names is None else channel.name in names:
            inputs[:, column] = parabolas(inputs[:, column])
    return inputs


def _clear(fit: Estimate, found: Sequence[Departed]) -> list[Departed]:
    """Departures that are significant, and, where residuals are coloured, worth a word."""
    clear = [one for one in found if abs(one.size) > BEYOND * one.std]
    if clear and any(some < COLOUR_LIMIT * n for some, n in fit.effective_samples().values()):
        return [one for one in clear if one.share > MATERIAL]
    return clear


def clear_departure(fit: Estimate, found: Sequence[Departure]) -> Departure | None:
    """The one departure of those found that explains most, if it is clear and worth a word.

    With those of which the records cannot tell it: a rate of a larger scale from an angle of a
    smaller one where the coefficient of the input is free.
    """
    clear = _clear(fit, found)
    if not clear:
        return None
    # Two that are one and the same differ by rounding: the zero of an input, or of what follows it.
    most = max(one.gain for one in clear)
    best = next(one for one in clear if one.gain >= (1.0 - THREE_DIGITS) * most)
    # In residuals as large and as correlated as those of the best.
    near = best.gain * (CLEARLY * best.std / best.size) ** 2
    others = (one for one in clear if one is not best and one.gain > best.gain - near)
    return replace(
        best, rivals=tuple(f"{' and '.join(one.signals)} ({one.kind})" for one in others)
    )


def values_of(fit: Estimate, index: int) -> np.ndarray:
    """All parameter values in one record."""
    values = fit.model.value_vector
    names = fit.model.parameter_names
    for name, value in (fit.local_values[index] if fit.local_values else {}).items():
        values[names.index(name)] = value
    return values


def outputs_of(
    fit: Estimate,
    index: int,
    inputs: np.ndarray,
    *,
    runner: Kernel | None = None,
) -> np.ndarray:
    """Outputs of one record with other inputs; what remembers begins at its own first ones."""
    return run_of(fit, index, inputs, runner or kernel(fit.model)).outputs


def run_of(fit: Estimate, index: int, inputs: np.ndarray, runner: Kernel) -> Run:
    """The run of one record with other inputs; what remembers begins at its own first ones."""
    record, values = fit.dataset[index], values_of(fit, index)
    start, _ = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
    return runner.run(record.times, inputs, values, start)


def estimate_starts(fit: Estimate) -> tuple[ActuatorStart, ...]:
    """Score estimates of the starts of all actuators that begin at a command, largest first.

    Parameters
    ----------
    fit : Estimate
        To white noise. Residuals that are coloured enlarge the standard errors by the root of the
        ratio of all to independent samples, those larger than declared by their misfit.
    """
    columns = _memories(fit.model)
    if not columns:
        return ()

    def beside(_: int, __: Run, by_start: np.ndarray) -> np.ndarray:
        return np.stack([by_start[:, :, places].sum(axis=2) for *_, places in columns], axis=2)

    slow = max(slowness(fit).values(), default=1.0)
    found = [
        ActuatorStart(*columns[one.column][:2], one.record, one.size, slow * one.std, one.share)
        for one in _scores(fit, _evidence(fit, beside), joint=False)
    ]
    return tuple(sorted(found, key=lambda one: -abs(one.size / one.std)))


def clear_starts(fit: Estimate) -> tuple[ActuatorStart, ...]:
    """Starts that are clearly not the first command."""
    return tuple(_clear(fit, estimate_starts(fit)))


def _memories(model: Model) -> list[tuple[str, str, list[int]]]:
    """Effect, command and places in the full state of memories that begin at a command."""
    place = len(model.states) + sum(len(effect.states) for effect in model.effects)
    found = []
    for effect in model.effects:
        if effect.stage != "actuator":
            continue
        for signal in effect.terms:
            where = [place + i for i, m in enumerate(effect.memory) if m.initial == signal]
            if where:
                found.append((effect.name, signal, where))
        place += len(effect.memory)
    return found


def _sensitivities(fit: Estimate, index: int) -> tuple[Run, np.ndarray, np.ndarray] | None:
    """A record's run, derivatives by the full start state, and by own states and parameters."""
    record, values, runner = fit.dataset[index], values_of(fit, index), kernel(fit.model)
    z0, dz0 = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
    run = runner.run(record.times, record.inputs, values, z0, sensitivities=True)
    found = run.output_sensitivities
    if not np.isfinite(found).all():
        return None
    return run, found[:, :, : runner.n_full], by_unknowns(found, dz0, runner.n_own)


# Factor within which a start value has to be what the other unit would give, noise of an input what
# its log shows, an error that of another fit, and a disturbance on other records the same.
TWOFOLD = 2.0


def change_of_outputs(fit: Estimate, after: Callable[[int], np.ndarray | None]) -> float:
    """Root mean square change of the outputs, in noise levels; infinite where none can be said.

    Parameters
    ----------
    fit : Estimate
    after : callable
        Outputs of the record of an index, ``(n_times, n_outputs)``; None leaves it out.
    """
    change, count = 0.0, 0
    for index, record in enumerate(fit.dataset):
        other = after(index)
        if other is None:
            continue
        away = (other - outputs_of(fit, index, record.inputs)) / fit.sigma
        scaled = away[np.isfinite(record.outputs)]
        with np.errstate(over="ignore", invalid="ignore"):
            change, count = change + float(scaled @ scaled), count + len(scaled)
    size = float(np.sqrt(change / count)) if count else np.inf
    return size if np.isfinite(size) else np.inf
