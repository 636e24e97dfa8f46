r"""Inputs, which kinematics cannot see, against their limits and the nominal model.

From the measured states at the start of each short piece of a record the nominal model predicts
those at its end; with parameters :math:`p = p_0 + S\eta`, :math:`\eta \sim N(0, I)`, and their
sensitivities :math:`A`,

.. math:: x_{k+1} - \hat x(x_k, h(d), p_0) = A S \eta + \varepsilon, \qquad
    \varepsilon_i \sim N(0, v_i).

The evidence of a hypothesis :math:`h` about the inputs :math:`d` (another sign or unit, two
of them swapped, logged after the answer) is

.. math:: E_h = -\sum_i n_i \ln v_i - \eta^T \eta - \ln \det (I + S A^T V^{-1} A S),

with the variances estimated under it, so that physics which the model lacks widens all of them
alike. Only parameters with a declared prior say anything here: with the others free, an input of
the other sign is a coefficient of the other sign. Where the nominal model diverges with the inputs
as logged, a reading with which it does not is the finding. A scale is not asked: a prior forgives a
quarter, and beyond that missing physics takes its place.

A state whose sensor is dead or missing is taken from the kinematics where these give it at every
sample; a record in which they do not is left out of the judgement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.corrections import ORDER, corrected
from oed_sysid.evidence.relations import READINGS
from oed_sysid.evidence.result import Correction, Finding
from oed_sysid.evidence.words import COPY
from oed_sysid.likelihood.start_guess import kinematic_states, measured_states
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.text.expressions import names as names_in

# Twice the log-likelihood by which another reading of an input has to be ahead.
ACCEPTED = 20.0
# A lag is physics of an actuator as well as a fault of a log: it only competes.
LAGS = (0.0, 0.25, 0.5, 1.0, 2.0)
# An input this many times beyond its limit is in another unit.
BEYOND = 1.5
# Samples of a piece: the shortest over which motion stands out of noise is taken.
PIECES = (5, 10, 20, 40)
# Effort: of a record, from its beginning.
MOST_SAMPLES = 1500
# Fewer equations do not determine free parameters and a reading.
LEAST_PIECES = 30
# Motion over a piece against its noise before the piece is long enough.
VISIBLE = 6.0
# Without a declared prior a parameter may be anything.
FREE = 30.0
# A declared prior is not trusted beyond this share of its mean.
LEAST_PRIOR = 0.25
# Iterations of weights and parameters; with twelve a statistic of a spoilt log moved by 3 %.
SWEEPS = 4
# What is left of a state's changes is not believed to be smaller than this share of them.
EXACT = 1e-6


@dataclass(frozen=True)
class _Piecewise:
    """Short pieces of one record: where they start, states there, and the states that move."""

    record: Record
    starts: np.ndarray
    states: np.ndarray


@dataclass(frozen=True)
class _Trial:
    """Another reading of inputs: what is said of it, and what it makes of them."""

    kind: str
    names: tuple[str, ...]
    meaning: str = ""
    factor: float = 1.0
    lag: float = 0.0

    def inputs(self, record: Record) -> np.ndarray:
        """Inputs of a record as they are then read, ``(n_samples, n_inputs)``."""
        values = np.array(record.inputs)
        mine = [record.channels.input_names.index(name) for name in self.names]
        if self.kind == "swap":
            values[:, mine] = values[:, mine[::-1]]
        for k in mine:
            later = record.times - self.lag
            values[:, k] = self.factor * np.interp(later, record.times, values[:, k])
        return values


def input_findings(
    dataset: Dataset,
    model: Model,
    fixes: Sequence[Correction],
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[list[Finding], str]:
    """Judge inputs: limits, signs, units, delays, and whether two are swapped.

    Parameters
    ----------
    dataset : Dataset
        The records as logged.
    model : Model
        The nominal model.
    fixes : sequence of Correction
        What was found about the outputs; undone first.
    ranges : mapping of str to (float, float), optional
        Declared limits of inputs, SI.

    Returns
    -------
    findings : list of Finding
        Inputs beyond their limits, or that act otherwise than the nominal model's priors allow.
    reason : str
        Why inputs could not be judged by the motion, in a sentence; empty if they were.
    """
    if not model.inputs:
        return [], ""
    beyond = _beyond(dataset, model, ranges or {})
    found, reason = _by_motion(dataset, model, fixes)
    # What the motion says of an input holds what its range says.
    said = {name for one in found for name in one.signals}
    return [*found, *(one for one in beyond if not said & set(one.signals))], reason


def _beyond(
    dataset: Dataset, model: Model, ranges: Mapping[str, tuple[float, float]]
) -> list[Finding]:
    """Inputs far beyond their declared limits, and angles beyond half a turn."""
    result = []
    for index, channel in enumerate(model.inputs):
        values = np.concatenate([record.inputs[:, index] for record in dataset])
        largest = float(np.nanmax(np.abs(values)))
        low, high = ranges.get(channel.name, (-np.inf, np.inf))
        declared = max(abs(low), abs(high))
        limit = BEYOND * declared if np.isfinite(declared) else np.inf
        limit = min(limit, np.pi) if channel.unit == "rad" else limit
        if largest <= limit:
            continue
        units = [m for f, m in READINGS.get(channel.unit, ()) if f * largest <= limit]
        about = f", as if it were in {' or '.join(units)}" if units else ""
        allowed = f"{declared:.3g}" if np.isfinite(declared) else "half a turn"
        result.append(
            Finding(
                "limit",
                (channel.name,),
                dataset.names,
                f"{channel.name} reaches {largest:.3g} {channel.unit}, far beyond its limit of "
                f"{allowed}{about}.",
                f"the coefficients of {channel.name} are wrong by as much",
                "correct the unit in the header, or the limit in the problem",
                size=largest,
                unit=channel.unit,
            )
        )
    return result


def _by_motion(
    dataset: Dataset, model: Model, fixes: Sequence[Correction]
) -> tuple[list[Finding], str]:
    """Inputs that act otherwise than the nominal model and its priors say."""
    about = "Signs and units of inputs: "
    if all(p.prior_std is None for p in model.free_parameters):
        return [], (
            f"{about}no parameter of the model has a declared prior (prior_mean, prior_std) to "
            "hold them against."
        )
    known = [fix for fix in fixes if fix.kind in ORDER]
    try:
        pieces = _pieces(corrected(dataset, known) if known else dataset, model)
        run = kernel(model)
    except OedSysidError:
        pieces = None
    if not pieces:
        return [], (
            f"{about}not all states of the model are measured, or follow from those that are."
        )
    names = model.input_names
    base = max(_evidence(run, model, pieces, _Trial("delay", names, lag=lag)) for lag in LAGS)
    trials = list(_trials(dataset, model))
    scores = np.array([_evidence(run, model, pieces, one) for one in trials])
    scores = np.where(np.isfinite(scores), scores, -np.inf)
    best = float(np.max(scores, initial=-np.inf))
    if not np.isfinite(base) and not np.isfinite(best):
        return [], f"{about}the nominal model diverges from the measured states."
    gain = best - base
    if gain <= ACCEPTED:
        return [], ""
    # Of several readings the one that explains most; the others are judged once it is mended.
    return [_finding(dataset, model, trials[int(np.argmax(scores))], gain)], ""


def _trials(dataset: Dataset, model: Model) -> Iterator[_Trial]:
    """Signs and units of each input that moves, pairs that may be swapped, and late logging."""
    values = np.concatenate([record.inputs for record in dataset])
    units = {one.name: one.unit for one in model.inputs}
    for name, column in zip(units, values.T, strict=True):
        if np.ptp(column) > 0.0:
            yield _Trial("sign", (name,), "sign", -1.0)
        if np.any(column):
            for factor, meaning in READINGS.get(units[name], ()):
                yield _Trial("unit", (name,), meaning, factor)
    moving = [name for name, column in zip(units, values.T, strict=True) if np.ptp(column) > 0.0]
    for pair in combinations(moving, 2):
        if units[pair[0]] == units[pair[1]]:
            yield _Trial("swap", pair)
    # Inputs that were logged after the vehicle had answered them.
    step = max(record.sample_time for record in dataset)
    yield from (_Trial("delay", tuple(units), lag=-lag) for lag in LAGS if lag > 2.0 * step)


# What is said of an input, what it does to an estimate, and what mends it.
WORDS = {
    "sign": (
        "{name} acts with the other sign than the nominal model and its priors say.",
        "the coefficients of {name} are fitted to their mirror image",
        'Input("{name}", "{unit}", sign={sign:g})',
    ),
    "unit": (
        "{name} acts as if it were in {meaning}, not in {unit}.",
        "the coefficients of {name} are fitted {inverse:.3g} times as large",
        'write the header as "{column} [{meaning}]"',
    ),
    "twice": (
        "{name} acts {factor:.3g} times as strongly as logged: converted twice?",
        "the coefficients of {name} are fitted {inverse:.3g} times as large",
        f"{COPY}; or correct the unit in the header",
    ),
    "swap": (
        "{both} are in each other's column.",
        "both commands are fitted to the other one's forces",
        "exchange the two columns in the headers",
    ),
    "delay": (
        "the vehicle answers {both} about {late:.2g} s before the log shows them.",
        "lags of actuators and damping are wrong by as much",
        "shift the inputs back in time, or the outputs forward, before the columns are joined",
    ),
}


def _finding(dataset: Dataset, model: Model, one: _Trial, gain: float) -> Finding:
    channel = next(c for c in model.inputs if c.name == one.names[0])
    about = {
        "name": channel.name, "both": " and ".join(one.names), "unit": channel.unit,
        "sign": -channel.sign, "column": channel.column or channel.name, "late": -one.lag,
        "meaning": one.meaning, "factor": one.factor, "inverse": 1.0 / one.factor,
    }  # fmt: skip
    words = WORDS["twice" if "twice" in one.meaning else one.kind]
    says, changes, line = (text.format(**about) for text in words)
    fix = Correction(one.kind, one.names, one.factor) if one.kind in ("sign", "unit") else None
    return Finding(
        one.kind,
        one.names,
        dataset.names,
        says,
        changes,
        line,
        gain=gain if np.isfinite(gain) else None,
        alternatives=("a nominal model or priors that are wrong by as much",),
        correction=fix,
    )


def _pieces(dataset: Dataset, model: Model) -> list[_Piecewise] | None:
    """Records cut into pieces that are long enough for the motion to show; None if impossible."""
    series = []
    for record in dataset:
        last = record.times[:MOST_SAMPLES][-1]  # so many are enough here
        part = record.window(record.times[0], last) if record.n_samples > MOST_SAMPLES else record
        measured = measured_states(model, part)
        whole = measured | {
            k: guess.series
            for k, guess in kinematic_states(model, part, measured).items()
            # A guess that is lost at some samples would be judged as a wild motion there.
            if guess.rms < model.states[k].scale
        }
        if len(whole) == len(model.states):
            states = np.column_stack([whole[k] for k in range(len(model.states))])
            series.append((part, states))
    if not series:
        return None
    length = next((n for n in PIECES if _moves(series, model, n)), PIECES[-1])
    result = []
    for part, states in series:
        starts = np.arange(2, part.n_samples - length - 2, length)
        if starts.size >= 2:
            result.append(_Piecewise(part, starts, states))
    return result if sum(p.starts.size for p in result) >= LEAST_PIECES else None


def _moves(series: list[tuple[Record, np.ndarray]], model: Model, length: int) -> bool:
    """Whether states change visibly over pieces of a length."""
    columns = _dynamic(model)
    for _, states in series:
        moving = states[length:, columns] - states[:-length, columns]
        fast = np.median(np.abs(np.diff(states[:, columns], 4, axis=0)), axis=0) / 5.6
        if np.any(moving.std(axis=0) > VISIBLE * (fast + 1e-12)):
            return True
    return False


def _dynamic(model: Model) -> np.ndarray:
    """Positions of the states whose equations hold free parameters: the velocities of axes."""
    free, kinematics = set(model.free_names), model.kinematics.items()
    own = set(model.axes.values()) or {s for s, text in kinematics if names_in(text) & free}
    return np.array([i for i, name in enumerate(model.state_names) if name in own], dtype=int)


def _believed(p: Parameter) -> float:
    """How far a parameter may be from its prior mean."""
    if p.prior_std is None:
        return FREE * max(abs(p.value), 1e-3)
    return max(p.prior_std, LEAST_PRIOR * abs(p.prior_mean or p.value))


def _evidence(run: Kernel, model: Model, pieces: list[_Piecewise], trial: _Trial) -> float:
    """Logarithm of the evidence, times two, of inputs in another reading."""
    columns = _dynamic(model)
    if not columns.size:
        return -np.inf
    free = model.free_parameters
    scale = np.array([_believed(p) for p in free])
    shift = np.array([0.0 if p.prior_mean is None else p.prior_mean - p.value for p in free])
    rest, jacobian, moving = [], [], []
    for piece in pieces:
        record = piece.record
        inputs = trial.inputs(record)
        nodes = piece.states[piece.starts]
        if run.n_full > run.n_own:  # states of effects begin where own states and inputs say
            nodes = np.array(
                [
                    run.start(own, inputs[k], model.value_vector, record.times[k])[0]
                    for k, own in zip(piece.starts, nodes, strict=True)
                ]
            )
        first = piece.starts[0]
        done = run.run(
            record.times[first:],
            inputs[first:],
            model.value_vector,
            nodes,
            starts=piece.starts - first,
            sensitivities=True,
        )
        ends, slopes = done.ends[:-1], np.asarray(done.end_sensitivities)[:-1]
        seen = piece.states[piece.starts[1:]]
        moving.append(seen[:, columns])
        rest.append(seen[:, columns] - ends[:, columns])
        jacobian.append(slopes[:, columns, run.n_full :])
    e, a = np.concatenate(rest), np.concatenate(jacobian)
    if not (np.isfinite(e).all() and np.isfinite(a).all()):
        return -np.inf
    a = a * scale
    e = e - a @ (shift / scale)
    # The same under every hypothesis, so that a state that hardly moves decides nothing.
    least = EXACT**2 * np.concatenate(moving).var(axis=0) + 1e-30
    variances = np.maximum(e.var(axis=0), least)
    for _ in range(SWEEPS):
        weighted = a / variances[None, :, None]
        matrix = np.eye(len(scale)) + np.einsum("kip,kiq->pq", weighted, a)
        try:
            eta = np.linalg.solve(matrix, np.einsum("kip,ki->p", weighted, e))
        except np.linalg.LinAlgError:  # sensitivities so large that the unit matrix is lost
            return -np.inf
        left = e - a @ eta
        variances = np.maximum(np.mean(left**2, axis=0), least)
    n = len(e)
    return float(-n * np.sum(np.log(variances)) - eta @ eta - np.linalg.slogdet(matrix)[1])
