r"""Delays of single signals, from the slope of what a model predicts.

An output that comes late by :math:`\tau` leaves :math:`-\tau\,\dot h` in its residual, an
input that acts late :math:`\tau\,\partial y/\partial\tau`, found by simulating with the shifted
input. With ``g`` this column and ``J`` those of all unknowns, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad s = g'\epsilon - g'J(J'J)^{+}J'\epsilon, \quad
    \hat\tau = s/I, \quad \operatorname{std}\hat\tau = I^{-1/2},

a score test at delay zero with everything else estimated too (Cox & Hinkley 1974, ch. 9).

Actuators that did not begin at their first command.

What an actuator remembers (the angle of a fin that lags, the side of a play) begins at the first
command of a record. Where the true one was :math:`s` beside it, the outputs miss
:math:`s\,\partial y/\partial m_0`, and parameters bend to it. As for delays
(:mod:`oed_sysid.likelihood.departures`), with ``g`` this column of one record, ``J`` those of all
unknowns and :math:`\epsilon` the residuals, in units of noise,

.. math:: I = g'g - g'J(J'J)^{+}J'g, \quad \hat s = \frac{g'(1 - J(J'J)^{+}J')\epsilon}{I}, \quad
    \operatorname{std}\hat s = I^{-1/2} .

:func:`~oed_sysid.physics.unknown_start` makes it one of the unknowns.

Inputs that act reversed, or in another unit, than the start values say.

An input of the other sign is a coefficient of the other sign: the fit converges, its residuals are
noise, and every controller designed with it steers to the wrong side. Kinematics cannot see it, but
the start values of the nominal model can. With :math:`y(d, p)` the model's outputs for an input
:math:`d`, parameters :math:`p_j` of a set :math:`F` that went to a value of about :math:`k` times
their start values, and all others left alone, the input is named where

.. math:: \left\| \frac{y(k\,d,\; p_F / k) - y(d,\; p)}{\sigma} \right\|_{rms} < \epsilon :

read in another unit (:math:`k = 180/\pi`, say) or with the other sign (:math:`k = -1`), the same
trajectories have the parameters that were expected. No parameter that the records give and that
has the expected sign can be part of :math:`F`, so that one start value of the wrong sign among
several right ones says nothing.

White noise in the log of an input: how much.

The level is that of third differences, which hardly see a command; it is noise where fourth
differences say the same,

.. math:: \sigma^2 = \operatorname{median}(\Delta^3 u)^2 \,/\, (0.4549 \cdot 20).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import Kernel, Run, kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.estimate import ActuatorStart, Delay, Estimate
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Input
from oed_sysid.physics.model import Model

# Standard errors from which a departure counts: one output in 10^5 by chance.
CLEAR = 4.5
# Share of independent samples below which residuals are coloured.
COLOUR_SHARE = 0.8
# Share of the misfit beyond noise that a delay must explain where residuals are coloured.
DELAY_SHARE = 0.3


@dataclass(frozen=True, eq=False)
class _Evidence:
    """What one record says of departures ``g``, its own unknowns estimated along.

    Attributes
    ----------
    record : str
    raw, own : ndarray (n_departures,)
        ``g'g``, before and after its start states and parameters took their part.
    cross : ndarray (n_shared, n_departures)
        Products with the columns of the shared parameters.
    slope : ndarray (n_departures,)
        ``g'e``.
    squares, count : float
        Sum of squares and number of the residuals in units of noise.
    """

    record: str
    raw: np.ndarray
    own: np.ndarray
    cross: np.ndarray
    slope: np.ndarray
    squares: float
    count: int


@dataclass(frozen=True, eq=False)
class _Shared:
    """Inverse information and slope of the shared parameters over all records."""

    inverse: np.ndarray
    slope: np.ndarray

    def scores(
        self, raw: np.ndarray, own: np.ndarray, cross: np.ndarray, slope: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Information ``I`` and score ``s`` of departures, all parameters estimated along.

        Zero information where nothing is left of a departure.
        """
        information = own - np.einsum("ij,ik,kj->j", cross, self.inverse, cross)
        seen = information > 1e-9 * np.maximum(raw, 1e-300)
        return np.where(seen, information, 0.0), slope - cross.T @ (self.inverse @ self.slope)


# Columns of the departures of one record: its index, its run, derivatives by its full start state.
Signatures = Callable[[int, Run, np.ndarray], np.ndarray]


def _evidence(
    fit: Estimate, runner: Kernel, signatures: Signatures, fewest: int = 1
) -> tuple[list[_Evidence], _Shared] | None:
    """What every record says of departures; None where a trajectory is not finite."""
    n_shared, free, n_own = len(fit.names), fit.model.free_names, runner.n_own
    local = [n_own + free.index(name) for name in free if name not in fit.names]
    order = [n_own + free.index(name) for name in fit.names]
    order += [*range(n_own), *local]
    found: list[_Evidence] = []
    shared, gradient = np.zeros((n_shared, n_shared)), np.zeros(n_shared)
    for index, record in enumerate(fit.dataset):
        if record.independent or record.n_samples < fewest:
            continue
        known = _sensitivities(runner, fit, index)
        if known is None:
            return None
        run, by_start, jacobian = known
        scaled = fit.residuals[index] / fit.sigma
        present = np.isfinite(scaled)
        rows = np.concatenate([jacobian[:, :, order], signatures(index, run, by_start)], axis=2)
        rows, errors = (rows / fit.sigma[:, None])[present], scaled[present]
        if not np.isfinite(rows).all():
            return None
        raw = rows[:, len(order) :]
        apart = np.column_stack([rows[:, :n_shared], raw, errors])
        apart = apart - _projected(rows[:, n_shared : len(order)], apart)
        base, g, left = apart[:, :n_shared], apart[:, n_shared:-1], apart[:, -1]
        shared += base.T @ base
        gradient += base.T @ left
        found.append(
            _Evidence(
                record.name,
                np.sum(raw**2, axis=0),
                np.sum(g**2, axis=0),
                base.T @ g,
                g.T @ left,
                float(errors @ errors),
                len(errors),
            )
        )
    return found, _Shared(_inverse(shared), gradient)


def estimate_delays(fit: Estimate) -> tuple[Delay, ...]:
    """Score estimates of the delays of all outputs and inputs at a fit with white noise.

    See the equations above; residuals that are coloured enlarge the standard errors by the root
    of the ratio of all to independent samples, those larger than declared by their misfit.
    """
    runner = kernel(fit.model)
    signals = [(name, "output") for name in fit.model.output_names]
    signals += [(name, "input") for name in fit.model.input_names]

    def late(index: int, run: Run, _: np.ndarray) -> np.ndarray:
        return _later(runner, fit, index, run)

    found = _evidence(fit, runner, late, fewest=3)
    if found is None or not found[0]:
        return ()
    parts, shared = found
    information, score = shared.scores(
        *(sum(getattr(part, name) for part in parts) for name in ("raw", "own", "cross", "slope"))
    )
    squares, count = sum(part.squares for part in parts), sum(part.count for part in parts)
    excess = max(squares - count, 1e-9)
    # Where the noise is larger than declared, errors are too.
    misfit = max(squares / max(count, 1), 1.0)
    slow = _slowness(fit)
    delays = []
    for column in np.flatnonzero(information):
        name, kind = signals[column]
        inflation = slow[column] if kind == "output" else max(slow)
        own = information[column]
        gain = float(score[column] ** 2 / own)
        std = float(np.sqrt(misfit * inflation / own))
        delays.append(
            Delay(name, kind, float(score[column] / own), std, gain, min(gain / excess, 1.0))
        )
    return tuple(delays)


def _slowness(fit: Estimate) -> list[float]:
    """Samples over independent samples of every output."""
    return [max(n, 1) / max(some, 1.0) for some, n in fit.effective_samples().values()]


def _later(runner: Kernel, fit: Estimate, index: int, run: Run) -> np.ndarray:
    """Derivatives of a record's outputs by the delay of every output and every input."""
    record, n_outputs = fit.dataset[index], len(fit.model.outputs)
    late = np.zeros((*run.outputs.shape, n_outputs + len(fit.model.inputs)))
    each = np.arange(n_outputs)
    late[:, each, each] = -np.gradient(run.outputs, record.times, axis=0)
    values, shift = values_of(fit, index), record.sample_time
    z0, _ = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
    for column in range(len(fit.model.inputs)):
        moved = record.inputs.copy()
        moved[:, column] = np.interp(record.times - shift, record.times, record.inputs[:, column])
        if not np.array_equal(moved, record.inputs):
            after = runner.run(record.times, moved, values, z0).outputs
            late[:, :, n_outputs + column] = (after - run.outputs) / shift
    return late


def clear_delay(fit: Estimate, delays: Sequence[Delay]) -> Delay | None:
    """The one delay that explains most, if it is significant and worth a word."""
    clear = [d for d in delays if abs(d.seconds) > CLEAR * d.std]
    if not clear:
        return None
    coloured = any(
        effective < COLOUR_SHARE * n for effective, n in fit.effective_samples().values()
    )
    if coloured:
        clear = [d for d in clear if d.share > DELAY_SHARE]
    return max(clear, key=lambda d: d.gain, default=None)


def values_of(fit: Estimate, index: int) -> np.ndarray:
    """All parameter values in one record."""
    values = fit.model.value_vector
    names = fit.model.parameter_names
    for name, value in (fit.local_values[index] if fit.local_values else {}).items():
        values[names.index(name)] = value
    return values


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

    found = _evidence(fit, kernel(fit.model), beside)
    if found is None:
        return ()
    parts, shared = found
    squares, count = sum(part.squares for part in parts), sum(part.count for part in parts)
    inflation = max(squares / max(count, 1), 1.0) * max(_slowness(fit), default=1.0)
    result = []
    for part in parts:
        information, score = shared.scores(part.raw, part.own, part.cross, part.slope)
        excess = max(part.squares - part.count, 1e-9)
        for position in np.flatnonzero(information):
            effect, signal, _ = columns[position]
            size = float(score[position] / information[position])
            std = float(np.sqrt(inflation / information[position]))
            share = min(size**2 * float(information[position]) / excess, 1.0)
            result.append(ActuatorStart(effect.name, signal, part.record, size, std, share))
    return tuple(sorted(result, key=lambda one: -abs(one.size / one.std)))


def clear_starts(fit: Estimate) -> tuple[ActuatorStart, ...]:
    """Starts that are not the first command, and, where residuals are coloured, worth a word."""
    clear = [one for one in estimate_starts(fit) if abs(one.size) > CLEAR * one.std]
    if any(some < COLOUR_SHARE * n for some, n in fit.effective_samples().values()):
        clear = [one for one in clear if one.share > DELAY_SHARE]
    return tuple(clear)


def _memories(model: Model) -> list[tuple[Effect, str, list[int]]]:
    """Effect, command and places in the full state of memories that begin at a command."""
    place = len(model.states) + sum(len(effect.states) for effect in model.effects)
    found = []
    for effect in model.effects:
        if effect.stage != "actuator":
            continue
        for signal in effect.terms:
            where = [place + i for i, m in enumerate(effect.memory) if m.initial == signal]
            if where:
                found.append((effect, signal, where))
        place += len(effect.memory)
    return found


def _sensitivities(
    runner: Kernel, fit: Estimate, index: int
) -> tuple[Run, np.ndarray, np.ndarray] | None:
    """A record's run, derivatives by the full start state, and by own states and parameters."""
    record, values = fit.dataset[index], values_of(fit, index)
    z0, dz0 = runner.start(fit.initial_states[index], record.inputs[0], values, record.times[0])
    run = runner.run(record.times, record.inputs, values, z0, sensitivities=True)
    found = run.output_sensitivities
    if found is None or not np.isfinite(found).all():
        return None
    jacobian = found[:, :, : runner.n_full] @ dz0
    jacobian[:, :, runner.n_own :] += found[:, :, runner.n_full :]
    return run, found[:, :, : runner.n_full], jacobian


def _projected(columns: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Part of some rows that columns explain."""
    size = np.linalg.norm(columns, axis=0)
    u, values, _ = np.linalg.svd(columns[:, size > 0] / size[size > 0], full_matrices=False)
    basis = u[:, values > 1e-9 * values.max(initial=0.0)]
    return np.asarray(basis @ (basis.T @ rows))


def _inverse(matrix: np.ndarray) -> np.ndarray:
    """Inverse of an information in the directions that it sees."""
    scale = np.sqrt(np.maximum(np.diag(matrix), 0.0))
    scale = np.where(scale > 0, scale, 1.0)
    scaled = matrix / scale[:, None] / scale
    inverse = np.linalg.pinv(scaled, rcond=1e-12, hermitian=True)
    return np.asarray(inverse / scale[:, None] / scale)


DEGREE = np.pi / 180.0
# What a log may hold, by the unit that it was read in; only ratios that no guess is off by.
UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "rad": ((DEGREE, "degrees read as radians"), (1.0 / DEGREE, "radians read as degrees")),
    "rad/s": ((2.0 * np.pi / 60.0, "rpm read as rad/s"), (30.0 / np.pi, "rad/s read as rpm")),
    "1/s": ((1.0 / 60.0, "rpm read as 1/s"), (60.0, "1/s read as rpm")),
    "N": ((1e3, "kN read as N"), (1e-3, "N read as kN")),
}
# Standard errors from which on a value is not zero.
OWN_SIGN = 3.0
# Factor within which a start value has to be what the other unit would give.
NEAR = 2.0
# Change of the outputs, in noise levels, below which two runs are the same.
SAME = 0.1


@dataclass(frozen=True)
class OtherWay:
    """An input that acts otherwise than the start values say.

    Attributes
    ----------
    channel : Input
    factor : float
        The true input over the logged one: -1, or a ratio of units.
    unit : str
        What the log seems to hold; empty for a sign.
    values : mapping of str to (float, float)
        Parameters concerned: what was found, and the start value.
    """

    channel: Input
    factor: float
    unit: str
    values: Mapping[str, tuple[float, float]]

    @property
    def text(self) -> str:
        """What was expected, what was found, what to do."""
        name, unit = self.channel.name, self.channel.unit
        told = ", ".join(f"{key} is {a:.3g} for {b:.3g}" for key, (a, b) in self.values.items())
        if not self.unit:
            line = f'Input("{name}", "{unit}", sign={-self.channel.sign:g})'
            return (
                f"Input {name} acts with the sign reversed against the start values ({told}). With "
                "it reversed the same fit has the signs that were expected. If the log counts it "
                f"the other way, write {line}; if the start values are wrong, change their signs."
            )
        return (
            f"Input {name} acts {abs(self.factor):.3g} times as strongly as the start values say "
            f"({told}): its log seems to hold {self.unit}. Check the unit in its header; if that "
            "is right, change the start values."
        )


def other_way(fit: Estimate, nominal: Mapping[str, float]) -> tuple[OtherWay, ...]:
    """Inputs that act with another sign or in another unit than the start values say.

    Parameters
    ----------
    fit : Estimate
        Converged.
    nominal : mapping of str to float
        Values that the parameters were expected to have; zero says nothing.
    """
    errors = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    ratios, loose = {}, []
    for name, value in zip(fit.names, fit.estimates, strict=True):
        if name not in nominal or not nominal[name] or not abs(value) > OWN_SIGN * errors[name]:
            loose.append(name)  # the records do not say its sign, or nobody did before
        else:
            ratios[name] = float(value) / nominal[name]
    found = []
    for column, channel in enumerate(fit.model.inputs):
        for factor, unit in ((-1.0, ""), *UNITS.get(channel.unit, ())):
            if factor < 0.0:
                moved = [name for name, ratio in ratios.items() if ratio < 0.0]
            else:
                moved = [n for n, r in ratios.items() if 1.0 / NEAR < r / factor < NEAR]
            if moved and _is_the_same(fit, column, factor, moved, loose):
                values = {n: (float(fit.values[n]), nominal[n]) for n in moved}
                found.append(OtherWay(channel, factor, unit, values))
                break
    return tuple(found)


def _is_the_same(
    fit: Estimate, column: int, factor: float, moved: list[str], loose: list[str]
) -> bool:
    """Whether an input times a factor, and parameters divided by it, give the same outputs.

    Of parameters that say nothing those join that are needed: a coefficient that the records hardly
    show is divided, too, and the zero of a rudder is multiplied.
    """
    powers = dict.fromkeys(moved, -1)
    change = _change(fit, column, factor, powers)
    while change >= SAME:
        tried = {
            (name, power): _change(fit, column, factor, {**powers, name: power})
            for name in loose
            if name not in powers
            for power in ((-1,) if factor == -1.0 else (-1, 1))
        }
        best = min(tried, key=lambda one: tried[one], default=None)
        if best is None or not tried[best] < change:
            return False
        change = tried[best]
        powers[best[0]] = best[1]
    return True


def _change(fit: Estimate, column: int, factor: float, powers: Mapping[str, int]) -> float:
    """Root mean square change of the outputs, in noise levels; infinite where none can be said."""
    runner, change, count = kernel(fit.model), 0.0, 0
    scales = np.ones(len(fit.model.parameter_names))
    for name, power in powers.items():
        scales[fit.model.parameter_names.index(name)] = factor**power
    for index, record in enumerate(fit.dataset):
        if not np.ptp(record.inputs[:, column]):
            continue
        values, inputs = values_of(fit, index), np.array(record.inputs)
        other = values * scales
        inputs[:, column] *= factor
        ends = []
        for commands, numbers in ((record.inputs, values), (inputs, other)):
            own = fit.initial_states[index]
            start, _ = runner.start(own, commands[0], numbers, record.times[0])
            ends.append(runner.run(record.times, commands, numbers, start).outputs)
        scaled = ((ends[1] - ends[0]) / fit.sigma)[np.isfinite(record.outputs)]
        with np.errstate(over="ignore", invalid="ignore"):
            change, count = change + float(scaled @ scaled), count + len(scaled)
    size = float(np.sqrt(change / count)) if count else np.inf
    return size if np.isfinite(size) else np.inf


# White noise of a logged input, as a share of its spread: above, it is an excitation.
INPUT_SHARE = (1e-5, 0.3)
# Level of fourth differences over that of third ones, from which these are noise.
FLAT = 0.85


def fast_level(parts: Sequence[np.ndarray]) -> float:
    """Level of white noise with third differences as large as these; NaN without any.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> held = np.repeat([0.0, 0.3, -0.3], 200)
    >>> round(fast_level([held + 0.01 * rng.standard_normal(600)]), 3)
    0.01
    """
    pooled = [np.diff(part[np.isfinite(part)], 3) ** 2 for part in parts]
    differences = np.concatenate(pooled)
    return float(np.sqrt(np.median(differences) / 0.4549 / 20.0)) if len(differences) else np.nan


def is_noise(parts: Sequence[np.ndarray]) -> bool:
    """Whether the level of differences no longer falls from the third to the fourth order."""
    fourth = np.concatenate([np.diff(values, 4) ** 2 for values in parts])
    third = fast_level(parts)
    if not len(fourth) or not third > 0:
        return False
    return bool(np.sqrt(np.median(fourth) / 0.4549 / 70.0) > FLAT * third)


def shown_in_log(dataset: Dataset, name: str) -> float:
    """Level of white noise that would wiggle as fast as the log of an input does, in its unit.

    An upper limit: a command that changes from sample to sample has it, too.
    Infinite where no
    input has that name, or where records are too short to tell.

    Parameters
    ----------
    dataset : Dataset
    name : str
    """
    names = [channel.name for channel in dataset[0].channels.inputs]
    if name not in names:
        return float("inf")
    column = names.index(name)
    level = fast_level([record.inputs[:, column] for record in dataset])
    return level if np.isfinite(level) else float("inf")


def noisy_inputs(dataset: Dataset) -> dict[str, float]:
    """Level of the white noise of every input whose log shows some, in its unit.

    Parameters
    ----------
    dataset : Dataset
    """
    found = {}
    for column, name in enumerate(channel.name for channel in dataset[0].channels.inputs):
        series = [record.inputs[:, column] for record in dataset if not record.independent]
        if not series:
            continue
        level = fast_level(series)
        spread = float(np.std(np.concatenate(series)))
        low, high = INPUT_SHARE
        if spread > 0 and low * spread < level < high * spread and is_noise(series):
            found[name] = level
    return found
