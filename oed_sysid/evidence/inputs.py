r"""Inputs, which kinematics cannot see, against the nominal model.

With the states measured, the nominal model says how each of them changes over a sample, and the
contrast of :mod:`~oed_sysid.evidence.contrasts` is that of any equation between signals,

.. math:: e(t) = x(t) - c - \int^t f(x, u, p)\,dt,

with the nominal forces as the mean of the free ones. Inputs are signals of it, and so are
parameters: constants whose errors are as large as their declared priors, a quarter at least. These
errors and a constant force in each record are in every regression, so that an input is at fault
only by what they leave; physics that the model lacks is autocorrelated noise of the contrast and
widens all intervals alike, a sea those of what acts in its band. Asked are the sign, unit, column,
offset, scale and delay of every input that moves. Where no prior is declared only delays are
asked: an input of the other sign is a coefficient of the other sign.

Between runs the fit itself is asked (:func:`between_runs`), without errors in the regressors: with
information :math:`H_i` and score :math:`g_i` of record *i* about the shared parameters at the
estimate, start states eliminated, changes :math:`\delta_i` of parameters in single records have

.. math:: I_{ij} = \delta_{ij} H_i - H_i H^{-1} H_j, \qquad
    s_i = g_i - H_i H^{-1} \sum_j g_j, \qquad H = \sum_i H_i + \text{priors},

and the same search chooses among them.

A state whose sensor is dead or missing is taken from the kinematics where these give it at every
sample; a record in which they do not is left out of the judgement.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import combinations, groupby, product

import numpy as np
from scipy.fft import idct
from scipy.linalg import block_diag

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.contrasts import (
    LARGEST,
    MOST_BLOCKS,
    RARER,
    UNEXPLAINED,
    Candidate,
    Found,
    Question,
    System,
    contrasts,
    plain_readings,
)
from oed_sysid.evidence.corrections import ORDER, corrected
from oed_sysid.evidence.readings import diagnosed
from oed_sysid.evidence.relations import LEAST_PRIOR, READINGS, Relation
from oed_sysid.evidence.result import Correction, Finding, Judged
from oed_sysid.evidence.screens import Fault, marked, screen
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.traces import Trace, fast_noise
from oed_sysid.evidence.words import Log, judged_row, said, screened_inputs
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.noise_levels import Runs, parabolas, white_level
from oed_sysid.likelihood.projection import score_beside
from oed_sysid.likelihood.start_guess import (
    kinematic_states,
    measured_columns,
    measured_states,
    needed_by,
    touched,
)
from oed_sysid.physics.channels import Input, State
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import NEGLIGIBLE

# What is asked of an input.
ASKED = ("sign", "unit", "bias", "scale", "delay", "step", "lost")

NO_PRIORS = SAYS["log"]["no priors"]
# Exact coincidences that no measured input has; at a limit an actuator stays rightly.
REPEATED = ("held", "frozen", "dropouts")


@dataclass(frozen=True)
class Nominal(Relation):
    """How a state changes by the nominal model: from states, inputs and parameters."""

    run: Kernel = field(kw_only=True)

    def __call__(self, values: Mapping[str, np.ndarray], times: np.ndarray) -> np.ndarray:
        """Mean rate of the state from every sample to the next, ``(n_times,)``; the last is 0."""
        table = np.column_stack([times, *(values[name] for name in self.signals)])
        changes = _changes(self.run, table.shape, table.tobytes())
        column: np.ndarray = changes[:, self.run.model.state_names.index(self.target)]
        return column

    def integral(self, times: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Sum of mean rates over the steps, ``(n_times, k)``."""
        steps = np.diff(times)[:, None] * columns[:-1]
        return np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(steps, axis=0)])

    def sampled(
        self, times: np.ndarray, rates: np.ndarray, known: np.ndarray, leaps: np.ndarray
    ) -> np.ndarray:
        """Nothing: rates are means over the steps, ``(3, n_times)``."""
        return np.zeros((3, times.size))


@lru_cache(maxsize=128)
def _changes(run: Kernel, shape: tuple[int, int], table: bytes) -> np.ndarray:
    """Mean rates of all states over each step, ``(n_times, n_states)``; of all equations at once.

    The columns of the table are the times, states, inputs and free parameters.
    """
    model = run.model
    columns = np.frombuffer(table).reshape(shape)
    edges = np.cumsum([1, len(model.states), len(model.inputs)])
    times, own, inputs, free = np.split(columns, edges, axis=1)
    known = dict(zip(model.free_names, free[0], strict=True))
    vector = np.array([known.get(p.name, p.value) for p in model.all_parameters])
    times, nodes = times[:, 0], np.pad(own, ((0, 0), (0, run.n_full - run.n_own)))
    # What effects remember, of a command that acts late say, goes on through the record.
    nodes[0], _ = run.start(own[0], inputs[0], vector, times[0])
    steps = run.run(
        times, inputs, vector, nodes, starts=np.arange(times.size), from_nodes=run.n_own
    )
    ends = steps.ends[:-1]
    changes = (ends[:, : run.n_own] - own[:-1]) / np.diff(times)[:, None]
    # Where it diverges it explains nothing, in numbers that can still be squared.
    changes = np.nan_to_num(changes, nan=1e9, posinf=1e9, neginf=-1e9).clip(-1e9, 1e9)
    return np.concatenate([changes, np.zeros((1, run.n_own))])


def input_findings(
    dataset: Dataset,
    model: Model,
    fixes: Sequence[Correction],
    ranges: Mapping[str, tuple[float, float]] | None = None,
) -> tuple[list[Finding], list[Judged], str]:
    """Judge inputs: limits, signs, units, scales, delays, and whether two are swapped.

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
    asked : list of Judged
        What was asked of every input.
    reason : str
        Why inputs could not be judged by the motion, in a sentence; empty if they were.
    """
    if not model.inputs:
        return [], [], ""
    beyond = [*_beyond(dataset, model, ranges or {})]
    faults, measured = _repeated(dataset, model)
    repeated = [*screened_inputs(faults, measured)]
    told = _traces(dataset, model, fixes)
    asked = [*product(model.inputs, ASKED)]
    if isinstance(told, str):
        rows = [Judged(kind, one.name, "not tested", told) for one, kind in asked]
        return [*repeated, *beyond], rows, f"Signs and units of inputs: {told}."
    # A state that follows from others is smoothed over samples, and moves before what moves it.
    traces, derived = told
    traces = [trace.blank(marked(faults, trace.name, REPEATED)) for trace in traces]
    unlogged, traces = _unlogged(traces, _nominal(model), model)
    known = has_priors(model)
    question = _question(traces, model, timed=not derived)
    found, ended = diagnosed(traces, question)
    log = Log(dataset.channels, (), dataset.names, {t.name: t.ends for t in traces})
    # Forces that set in are what the vehicle met: rivals of a fault, and none themselves.
    sized = filter(lambda one: one.candidate.kind != "drift", ended.found)
    findings = [*map(log.reading, found), *map(log.sized, sized)]
    findings += _unread(unlogged, found)
    # What the motion says of an input holds what its range says.
    named = set().union(*(one.signals for one in findings))
    findings += [one for one in beyond if named.isdisjoint(one.signals)]
    whys = {} if known else dict.fromkeys({*ASKED} - {"delay"}, NO_PRIORS)
    if derived:
        whys |= dict.fromkeys(("delay", "step"), say("log", "untimed", names=", ".join(derived)))
    rows = [
        Judged(kind, one.name, "not tested", whys[kind])
        if kind in whys
        else judged_row(kind, one.name, one.unit, ended)
        for one, kind in asked
    ]
    return [*repeated, *findings], rows, "" if known else f"Signs and units of inputs: {NO_PRIORS}."


def _repeated(dataset: Dataset, model: Model) -> tuple[list[Fault], list[Trace]]:
    """Samples of measured inputs that stand still, drop out or are held, and these inputs.

    An input that is linear between samples and has noise was measured: as of outputs no two
    samples are equal. A command repeats itself.
    """
    noise = [
        white_level(list(series)) for series in zip(*(r.inputs.T for r in dataset), strict=True)
    ]
    levels = {
        one.name: level
        for one, (level, seen) in zip(model.inputs, noise, strict=True)
        if one.interpolation == "linear" and seen and level > 0.0
    }
    units = {one.name: one.unit for one in model.inputs}
    measured = [
        Trace(r.name, r.times, {n: r.input(n) for n in levels}, units, levels) for r in dataset
    ]
    shared = len(dataset) * len(levels)
    faults = [fault for trace in measured for fault in screen(trace, shared)]
    return [fault for fault in faults if fault.kind in REPEATED], measured


def _unread(unlogged: Sequence[Finding], readings: Sequence[Found]) -> list[Finding]:
    """Findings of inputs that no other reading of their numbers explains."""
    read = set().union(*(one.candidate.signals for one in readings))
    return [one for one in unlogged if read.isdisjoint(one.signals)]


def _still(traces: Sequence[Trace], model: Model) -> Iterator[tuple[str, list[Trace], slice]]:
    """Inputs that never move; of those that do the longest run of equal values of each record."""
    for name in model.input_names:
        if not _moves(traces, name):
            yield name, [*traces], slice(None)
            continue
        for trace in traces:
            runs = Runs.of(trace.values[name])
            longest = int(np.argmax(runs.length))
            first = int(runs.first[longest])
            yield name, [trace], slice(first, first + int(runs.length[longest]))


def _unlogged(
    traces: Sequence[Trace], equations: tuple[Relation, ...], model: Model
) -> tuple[list[Finding], list[Trace]]:
    r"""Inputs that stand still in the log, although the vehicle moves as if they did not.

    With :math:`d_i` the changes over about a second of what the nominal model leaves of equation
    *i* beside a constant error of the input, and :math:`g_i` those of the contrast of a unit of it,
    both over the root mean square of :math:`d_i`, a free input is
    :math:`\hat\delta = \sum_i g_i d_i / \sum_i g_i^2`. It is what was not logged where the model
    leaves more than a third of the changes of a state, and this input less than a third of that,
    in two equations at least: forces from outside seldom act in the ratio of its coefficients.

    Returns
    -------
    findings : list of Finding
    traces : list of Trace
        Without the samples of an input that moves elsewhere.
    """
    findings, left = list[Finding](), {trace.name: trace for trace in traces}
    for name, where, rows in _still(traces, model):
        cut = [t.during(rows) for t in where]
        changes = [one for t in cut for one in _changes_by(t, name, equations)]
        moves = max(float(np.nanmax(np.abs(t.values[name]))) for t in traces)
        most = LARGEST * moves if _moves(traces, name) else np.inf
        share = _left_by(np.concatenate(changes, axis=2), most) if changes else 1.0
        if share >= UNEXPLAINED:
            continue
        kind, records = "dead" if rows == slice(None) else "frozen", tuple(t.name for t in where)
        begin, end = cut[0].ends
        words = {
            "share": f"{100.0 * (1.0 - share**2):.0f}", "record": records[0], "at": begin,
            "size": end - begin,
        }  # fmt: skip
        findings.append(said(kind, (name,), records, words, row=f"input {kind}"))
        if kind == "frozen":
            inside = {name: np.arange(rows.start, rows.stop)}
            left[records[0]] = left[records[0]].blank(inside)
    return findings, [*left.values()]


def _left_by(changes: np.ndarray, most: float) -> float:
    """Share of misfits that a free input leaves, 1 where it could not be told from a force.

    Changes are ``(3, n_equations, n)``: misfits, what a unit of the input makes, and left sides.
    A constant error of the input is none, and one whose root mean square would have to be larger
    than ``most`` leaves all.
    """
    left, column, side = changes
    left = left - column * (np.sum(column * left) / max(float(np.sum(column**2)), 1e-300))
    misfit, moved = (np.sqrt(np.mean(one**2, axis=1)) for one in (left, side))
    d, g = left / misfit[:, None], column / misfit[:, None]
    reach = np.sqrt(np.mean(g**2, axis=1))
    enters = reach > UNEXPLAINED * reach.max()
    if np.sum(enters) < 2 or not np.any(enters & (misfit > UNEXPLAINED * moved)):
        return 1.0
    d, g = d[enters], g[enters]
    free = np.sum(g * d, axis=0) / np.maximum(np.sum(g**2, axis=0), 1e-300)
    left_over = float(np.sqrt(np.mean((d - g * free) ** 2)))
    return left_over if np.mean(free**2) < most**2 else 1.0


def _changes_by(trace: Trace, name: str, equations: tuple[Relation, ...]) -> Iterator[np.ndarray]:
    """Changes of contrasts, of a unit of an input and of left sides, ``(3, n_equations, n)``."""
    pieces = [*contrasts(trace, equations, [Candidate("bias", (name,), "", 1.0, 0.0)])]
    whole = [piece.side.index for piece in pieces] == [*range(len(equations))]
    # A record that is broken, in one equation or in all, is left out.
    if whole and all(np.array_equal(piece.times, pieces[0].times) for piece in pieces):
        lag = max(1, round(1.0 / pieces[0].span))
        rows = [[p.residual for p in pieces], [p.columns[:, 0] for p in pieces],
                [p.target for p in pieces]]  # fmt: skip
        series = idct(np.pad(rows, ((0, 0), (0, 0), (1, 0))), norm="ortho")
        yield series[..., lag:] - series[..., :-lag]


def _beyond(
    dataset: Dataset, model: Model, ranges: Mapping[str, tuple[float, float]]
) -> Iterator[Finding]:
    """Inputs far beyond their declared limits, and angles beyond half a turn."""
    for index, channel in enumerate(model.inputs):
        values = np.concatenate([record.inputs[:, index] for record in dataset])
        largest = float(np.nanmax(np.abs(values)))
        declared = max(map(abs, ranges.get(channel.name, (np.inf,))))
        limit = min(WORTH_TELLING * declared, np.pi if channel.unit == "rad" else np.inf)
        if largest <= limit:
            continue
        units = [m for f, m in READINGS.get(channel.unit, ()) if f * largest <= limit]
        words = {
            "largest": largest, "unit": channel.unit,
            "allowed": f"{declared:.3g}" if np.isfinite(declared) else "half a turn",
            "as_if": f", as if it were in {' or '.join(units)}" if units else "",
        }  # fmt: skip
        name = (channel.name,)
        yield said("limit", name, dataset.names, words, size=largest, unit=channel.unit)


def _traces(
    dataset: Dataset, model: Model, fixes: Sequence[Correction]
) -> tuple[list[Trace], list[str]] | str:
    """States, inputs and parameters of records that have all of them, or why there are none.

    With the names of states that no sensor shows in some record.
    """
    known = [fix for fix in fixes if fix.kind in ORDER]
    with suppress(OedSysidError):
        mended = corrected(dataset, known) if known else dataset
        if found := [one for record in mended for one in _trace(record, model)]:
            return found, _derived(mended, model)
    return SAYS["log"]["no states"]


def _derived(dataset: Dataset, model: Model) -> list[str]:
    """States that no sensor shows in some record: they are smoothed from others."""
    shown = {
        k
        for k, column in measured_columns(model).items()
        if all(np.isfinite(record.outputs[:, column]).any() for record in dataset)
    }
    return [one.name for k, one in enumerate(model.states) if k not in shown]


def _trace(record: Record, model: Model) -> Iterator[Trace]:
    """States, inputs and parameters of a record; of a long one its beginning is enough."""
    record = record.window(-np.inf, record.times[: 6 * MOST_BLOCKS][-1])
    joined = _joined(record)
    measured = measured_states(model, joined)
    whole = measured | {
        k: guess.series
        for k, guess in kinematic_states(model, joined, measured).items()
        # A guess that is lost at some samples would be judged as a wild motion there.
        if guess.rms < model.states[k].scale
    }
    if len(whole) < len(model.states):
        return
    columns = measured_columns(model)
    own = {k: record.outputs[:, columns[k]] for k in measured if k in columns}
    values = {model.state_names[k]: series for k, series in (whole | own).items()}
    noise = {name: fast_noise(series) for name, series in values.items()}
    for k, guess in whole.items():
        name = model.state_names[k]
        present = np.isfinite(values[name])
        filled = np.where(present, values[name], guess)
        taken = parabolas(filled) if noise[name] else filled
        values[smooth(name)] = np.where(present, taken, np.nan)
    noise |= {smooth(name): level for name, level in noise.items()}
    values |= dict(zip(model.input_names, record.inputs.T, strict=True))
    for p in model.free_parameters:
        mean = p.value if p.prior_mean is None else p.prior_mean
        values[p.name] = np.full(record.n_samples, mean)
    channels: tuple[State | Input | Parameter, ...]
    channels = (*model.states, *model.inputs, *model.free_parameters)
    units = {channel.name: channel.unit for channel in channels}
    units |= {smooth(state.name): state.unit for state in model.states}
    yield Trace(record.name, record.times, values, units, dict.fromkeys(units, 0.0) | noise)


def _joined(record: Record) -> Record:
    """A record whose outputs are curves between their samples, but in long gaps.

    Rates of straight lines between positions that are sampled slowly make motion smaller.
    """
    trace, outputs = Trace.of(record, {}), record.outputs.copy()
    for name, series in trace.filled(trace.values).items():
        column = record.channels.output_names.index(name)
        outputs[:, column] = np.where(trace.usable([name]), series, outputs[:, column])
    return replace(record, outputs=outputs)


def smooth(name: str) -> str:
    """Name of a state as the nominal model takes it: by local parabolas.

    Noise in what a model is evaluated at stands in the contrast and in its regressors, which makes
    coefficients too small (errors in variables; Fuller 1987). Parabolas leave a quarter of its
    variance, as means over half as many samples do, but these would also make fast motion smaller,
    and begin its answer before its cause.
    """
    return f"{name} smoothed"


def _question(traces: Sequence[Trace], model: Model, *, timed: bool) -> Question:
    """What is asked of inputs, with errors of the parameters and constant forces beside it.

    Delays and lags where the states are ``timed``, alone where no parameter has a prior.
    """
    equations = _nominal(model)
    length = max(end - start for start, end in (t.ends for t in traces))
    moving = {one.name: one.unit for one in model.inputs if _moves(traces, one.name)}
    known = moving if has_priors(model) else {}
    common, local, single = list[Candidate](), list[Candidate](), list[Candidate]()
    if timed:
        common += _late(moving, traces[0].step)
    for name, unit in known.items():
        size = max(float(np.nanmax(np.abs(t.values[name]))) for t in traces)
        bias = Candidate("bias", (name,), unit, 0.3 * size, NEGLIGIBLE * size)
        lost = Candidate("lost", (name,), "1", 1.0, 0.5, rare=RARER)
        common += [bias, replace(lost, material=NEGLIGIBLE, rare=0.0)]
        # A zero that jumps is rarer than a force that sets in: two equations tell them.
        local += [lost, replace(bias, kind="step", rare=RARER)][: 1 + timed]
        single += [replace(lost, record=t.name) for t in traces]
    local += [_setting_in(one.target, traces) for one in equations]
    alone = tuple(single) if len(traces) > 1 else ()
    given = tuple(_given(traces, equations, model, length))
    readings = tuple(_readings(known))
    return Question(equations, tuple(common), alone, tuple(local), readings, given)


def _late(names: Iterable[str], step: float) -> Iterator[Candidate]:
    """Delays and lags of inputs, logged every so many seconds."""
    for name in names:
        late = Candidate("delay", (name,), "s", max(0.7, 3.0 * step), step)
        yield from (late, replace(late, kind="lag", positive=True))


def _setting_in(name: str, traces: Sequence[Trace]) -> Candidate:
    """A force on a state that sets in, as large as those that move the vehicle."""
    steep = (np.gradient(s, t.times) for t in traces for s in t.filled([name]).values())
    usual = max((float(np.std(rates)) for rates in steep), default=0.0) + 1e-12
    return Candidate("drift", (name,), "", usual, NEGLIGIBLE * usual)


def _nominal(model: Model) -> tuple[Nominal, ...]:
    """Equations of the states that forces act on."""
    run, known = kernel(model), {*model.state_names, *model.input_names}
    pushed = touched(model)
    own = set(model.axes.values()) or {
        state
        for state, text in model.kinematics.items()
        if state in pushed or needed_by(model, text, known) is None
    }
    inputs, asked = model.input_names, (*model.input_names, *model.free_names)
    every = (*map(smooth, model.state_names), *asked)
    return tuple(
        Nominal(target, every, "the nominal model", True, (), {}, asked, inputs, run=run)
        for target in model.state_names
        if target in own
    )


def _moves(traces: Sequence[Trace], name: str) -> bool:
    """Whether an input changes within a record."""
    series = (t.values[name][np.isfinite(t.values[name])] for t in traces)
    return any(one.size > 0 and np.ptp(one) > 0.0 for one in series)


def _given(
    traces: Sequence[Trace], equations: tuple[Nominal, ...], model: Model, length: float
) -> Iterator[Candidate]:
    """Errors of the parameters, and constant forces in each record."""
    for p in model.free_parameters:
        std = _believed(p)
        least = NEGLIGIBLE * max(abs(p.value), std)
        yield Candidate("bias", (p.name,), p.unit, std, least)
    for r, t in product(equations, traces):
        usual = float(np.nanstd(t.values[r.target])) / length + 1e-12
        yield Candidate("drift", (r.target,), "", usual, 0.0, record=t.name)


def has_priors(model: Model) -> bool:
    """Whether some parameter has a declared prior."""
    return any(p.prior_std is not None for p in model.free_parameters)


def _believed(p: Parameter) -> float:
    """How far a parameter may be from its prior mean; without a prior it may be anything."""
    if p.prior_std is None:
        return max(abs(p.value), NEGLIGIBLE) / NEGLIGIBLE
    return max(p.prior_std, LEAST_PRIOR * abs(p.prior_mean or p.value))


def _readings(moving: Mapping[str, str]) -> Iterator[Found]:
    """Signs and units of moving inputs, alone and all of a unit, and pairs that may be swapped."""
    ordered = sorted(moving, key=moving.__getitem__)
    alike = [tuple(some) for _, some in groupby(ordered, key=moving.__getitem__)]
    together = (some for some in alike if len(some) > 1)
    yield from plain_readings([*((name,) for name in moving), *together], moving)
    for pair in combinations(moving, 2):
        if moving[pair[0]] == moving[pair[1]]:
            yield Found(Candidate("swap", pair))


def scaled_inputs(fit: Fit) -> tuple[Finding, ...]:
    r"""Inputs whose coefficients all differ from their declared priors by one factor.

    With relative departures :math:`d` of the estimates from the prior means of the parameters that
    act through one input alone, and their covariance :math:`C`, prior less posterior, a factor
    :math:`1 + s` of the input has :math:`\hat s = 1'C^{-1}d / 1'C^{-1}1`, and its statistic is
    :math:`(1'C^{-1}d)^2 / 1'C^{-1}1`. One coefficient tells nothing that ``far`` would not.

    Parameters
    ----------
    fit : Fit
        Of a model whose parameters have declared priors.

    Returns
    -------
    tuple of Finding
        Of kind ``scale``, no fault of the log: priors may be wrong by as much.
    """
    told = _traces(fit.dataset, fit.model, ())
    if isinstance(told, str) or not fit.status.ok:
        return ()
    traces, _ = told
    # Where the records cannot tell a coefficient, they cannot tell what it is multiplied by.
    errors = dict(zip(fit.names, np.isfinite(fit.covariance).all(axis=1), strict=True))
    clear = [
        p for p in fit.model.free_parameters if p.prior_std and p.prior_mean and errors[p.name]
    ]
    log = Log(fit.dataset.channels, (), fit.dataset.names)
    result = list[Finding]()
    for name in (one for one in fit.model.input_names if _moves(traces, one)):
        own = [p for p in clear if _acts_through(traces[0], fit.model, p.name, name)]
        if len(own) > 1:
            result += map(log.sized, _common_factor(fit, name, own).found())
    return tuple(result)


def _common_factor(fit: Fit, name: str, own: Sequence[Parameter]) -> System:
    """Normal equations of the share of an input that is missing, as some parameters have it."""
    rows = [fit.names.index(p.name) for p in own]
    mean = np.array([p.prior_mean for p in own], dtype=float)
    prior = np.diag([float(p.prior_std or np.inf) ** 2 for p in own])
    known = (prior - fit.covariance[np.ix_(rows, rows)]) / np.outer(mean, mean)
    away = np.array([fit.values[p.name] for p in own]) / mean - 1.0
    weights = np.linalg.pinv(known, hermitian=True).sum(axis=0)
    one = Candidate("lost", (name,), "1", 1.0, NEGLIGIBLE)
    return System.plain([one], weights.sum().reshape(1, 1), np.array([-weights @ away]))


def _acts_through(trace: Trace, model: Model, parameter: str, name: str) -> bool:
    """Whether a parameter changes no motion where one input is nothing, and some where it is."""
    off = trace.values | {name: np.zeros(trace.times.size)}

    def moves(values: Mapping[str, np.ndarray]) -> float:
        slopes = (r.slope(values, trace.times, parameter) for r in _nominal(model))
        return max(float(np.abs(one).max()) for one in slopes)

    return moves(off) < NEGLIGIBLE * moves(trace.values)


def between_runs(fit: Fit) -> tuple[Finding, ...]:
    """Parameters that are others in single records: *run 2 has 8 % more inertia*.

    Parameters
    ----------
    fit : Fit
        Of two records or more.

    Returns
    -------
    tuple of Finding
        Of kind ``run``, with the share of the value by which it differs; no fault of the log.
    """
    sources = fit.sources
    if sources is None or sources.n_records < 2 or not fit.status.ok:
        return ()
    own, scores = sources.matrices[1:], sources.scores[1:]
    whole = sources.matrices.sum(axis=0)
    values = [abs(fit.values[name]) for name in fit.names]
    series = [record.name for record in fit.dataset if not record.independent]
    units = {n: "1" if fit.values[n] else fit.model.parameter(n).unit for n in fit.names}
    faults = [
        Candidate("run", (name,), unit, 1.0, NEGLIGIBLE, record=record)
        for record, (name, unit) in product(series, units.items())
    ]
    across = np.concatenate(own)
    joint = np.block([[block_diag(*own), across], [across.T, whole]])
    right = np.concatenate([*scores, sources.scores.sum(axis=0)])
    single, shared = np.split(np.arange(len(right)), [len(across)])
    gram, right = score_beside(joint, right, single, shared)
    # Errors of correlated residuals are larger than the information says.
    with np.errstate(invalid="ignore", divide="ignore"):
        grown = np.diag(fit.covariance) / np.diag(fit.information.covariance)
    share = np.tile([value or 1.0 for value in values], len(series))
    grown = grown[np.isfinite(grown)]
    less = max(1.0, float(grown.mean()) if grown.size else 1.0)
    system = System.plain(faults, gram * np.outer(share, share) / less, right * share / less)
    log = Log(fit.dataset.channels, (), fit.dataset.names)
    return tuple(map(log.sized, system.found()))
