r"""Score test: how much each candidate would explain, without refitting.

With innovations ``r`` in units of their standard deviation, their derivatives ``J`` by the
unknowns of a fit and ``s`` by an absent candidate, along the filtered path,

.. math:: T = \frac{(s' M r)^2}{s' M s}, \qquad M = I - J (J'J)^{-1} J'

is a chi-squared variable where the candidate is absent (Rao 1948), and to first order what
refitting with it would gain in twice the log-likelihood.

Frequencies at which a residual swings, to begin the search for a periodic force.

Over a record of length :math:`T` two frequencies are told apart from about :math:`2\pi / T` on, so
that a coarse grid of frequencies misses a wave in a long record: at all frequencies of the grid it
averages out, in every equation, and an equation that it does not act in may come first by chance. A
force that swings moves outputs with its frequency, so that the periodogram of the innovations
:math:`e` in units of their standard deviation (Schuster 1898; Lomb and Scargle where
samples are uneven), summed over records and outputs,

.. math::
    P(\omega) = \sum_i \frac{1}{n_i} \Bigl| \sum_k e_{ik}\, e^{-\mathrm{i}\omega t_{ik}} \Bigr|^2,

has its largest maxima where it is worth to begin.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from oed_sysid.compiled.filtering import FilterPass
from oed_sysid.evidence.study import Study
from oed_sysid.information.response import TANGENT
from oed_sysid.likelihood.estimate import by_name
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.projection import ABSORBED, inverse_of
from oed_sysid.physics import Effect
from oed_sysid.physics.parameters import Parameter

# Values of a shape parameter (a frequency, a time constant) that are tried: of the first; of every
# other one, and maxima of a periodogram.
N_SHAPES, N_OTHER_SHAPES = 11, 3
# Shares of a typical amplitude from nothing to which the change of the innovations is taken for
# effects with a kink at nothing, or a threshold, whose answer depends on the size.
SIZES = 0.3, 1.0, 3.0


@dataclass(frozen=True, eq=False)
class Score:
    """Evidence for one absent effect.

    Attributes
    ----------
    effect : Effect
    statistic : float
        Chi-squared statistic of the amplitudes, best shape.
    freedom : int
        Amplitudes, shape parameters, and start values of each record.
    estimate : dict
        One-step estimate of amplitudes (and the shape that goes with it).
    std_errors : dict
        Standard errors of the amplitudes, over all records.
    distinct : float
        Share of the effect's signature that free parameters cannot imitate.
    signature : ndarray (n_rows, n_amplitudes)
        Whitened sensitivities with existing unknowns projected out.
    trials : float
        Frequencies that the records tell apart, of which the best was taken; 1 where the effect
        does not swing in time.
    """

    effect: Effect
    statistic: float
    freedom: int
    estimate: dict[str, float]
    std_errors: dict[str, float]
    distinct: float
    signature: np.ndarray
    trials: float = 1.0

    @property
    def apart(self) -> int:
        """Freedoms that sizes which differ from record to record have beyond shared ones."""
        return self.signature.shape[1] - len(self.effect.amplitude_names)

    @property
    def absorbed(self) -> bool:
        """Whether the free parameters imitate the effect completely."""
        return self.distinct < ABSORBED


class Rows:
    """Innovations of all records in units of their standard deviation, with derivatives.

    ``passes``, ``times``, the innovations ``scaled`` so ``(n_times, n_outputs)``, NaN if none, and
    the ``parts`` of the rows that are theirs are per record. ``residual`` ``(n_rows,)`` holds every
    sample of every output, zero where it was not measured, and the priors; ``known`` are columns of
    the unknowns, ``extra`` those of ``smooth`` candidates along the same pass, by name.
    """

    def __init__(
        self,
        problem: Filtered,
        unknowns: np.ndarray,
        passes: Sequence[FilterPass],
        smooth: Sequence[str] = (),
    ) -> None:
        layout, limits, self.passes = problem.layout, problem.limits, passes
        n_known = layout.levels.start
        self.scaled = [part.innovations / np.sqrt(part.variances) for part in passes]
        self.times = [record.times for record in problem.records]
        every, more = [], np.arange(n_known, n_known + len(smooth))
        for index, part in enumerate(passes):
            columns = np.append(layout.record_columns(index), more)
            # The chain rule, where unknowns are logarithms; zero where nothing was measured.
            size = np.append(layout.record_slopes(unknowns, index), np.ones(len(smooth)))
            seen = np.isfinite(problem.records[index].outputs)[:, :, None]
            rows = np.where(seen, -size * part.rows[:, :, : len(size)], 0.0).reshape(-1, len(size))
            every.append(np.zeros((len(rows), n_known + len(smooth))))
            every[-1][:, columns] = rows
        ends = np.cumsum([0, *map(len, every)])
        self.parts = [slice(*ends) for ends in pairwise(ends)]
        held = np.flatnonzero(limits.prior_weight[:n_known] > 0)
        roots = np.sqrt(limits.prior_weight[held])
        every.append(roots[:, None] * np.eye(n_known + len(smooth))[held])
        away = roots * (limits.prior_mean[held] - unknowns[held])
        self.residual = np.concatenate([*map(_row, self.scaled), away])
        self.known, extra = np.split(np.concatenate(every), [n_known], axis=1)
        self.extra = dict(zip(smooth, extra.T, strict=True))

    def basis(self, apart: Sequence[int] | np.ndarray = ()) -> np.ndarray:
        """Orthonormal basis of what the unknowns explain, ``(n_rows, n)``, some left apart."""
        # Columns that move nothing cannot be scaled, and explain nothing.
        size = np.linalg.norm(self.known, axis=0)
        along = (size > 0) & ~np.isin(np.arange(len(size)), apart)
        return np.linalg.qr(self.known[:, along] / size[along])[0]

    def moved(self, innovations: Sequence[np.ndarray]) -> np.ndarray:
        """Rows by which innovations fall short of these, ``(n_rows,)``."""
        column = np.zeros(len(self.residual))
        pairs = zip(self.passes, innovations, strict=True)
        short = [_row((own.innovations - part) / np.sqrt(own.variances)) for own, part in pairs]
        column[: sum(map(len, short))] = np.concatenate(short)
        return column

    def by_record(self, columns: np.ndarray) -> np.ndarray:
        """A column for every record in place of one for all, ``(n_rows, n_columns*n_records)``."""
        apart = np.zeros((*columns.shape, len(self.parts)))
        for index, rows in enumerate(self.parts):
            apart[rows, :, index] = columns[rows]
        return apart.reshape(len(columns), -1)


def _row(scaled: np.ndarray) -> np.ndarray:
    """Numbers of all samples and outputs in a row, zero where there is none."""
    return np.nan_to_num(scaled).ravel()


def scores(
    study: Study,
    fit: FilteredSolution,
    candidates: Sequence[Effect],
    *,
    apart: Collection[str] = (),
) -> tuple[list[Score], np.ndarray]:
    """Score every candidate at a fit.

    Parameters
    ----------
    study : Study
        Its filter holds the candidates.
    fit : FilteredSolution
        Fit of the present model.
    candidates : sequence of Effect
        Absent effects.
    apart : collection of str
        Free parameters of the model that are not estimated along.

    Returns
    -------
    scores : list of Score
        Largest statistic first.
    residual : ndarray (n_rows,)
        Whitened innovations with the existing unknowns projected out.
    """
    candidates = [effect for effect in candidates if effect.amplitude_names]
    if not candidates:
        return [], np.zeros(0)
    fit = study.widened(fit)
    problem, unknowns = fit.problem, fit.point.unknowns
    plain = (e for e in candidates if not e.shape_names and two_sided(e))
    smooth = [name for effect in plain for name in effect.amplitude_names]
    names = (*problem.layout.free_names, *smooth)
    passes = problem.passes(unknowns, rows=True, gains=True, names=names)
    rows = Rows(problem, unknowns, passes, smooth)
    # Frisch-Waugh: what is left of residual and signature once the unknowns are refitted.
    basis = rows.basis(np.flatnonzero(np.isin(problem.layout.shared_names, [*apart])))

    def projected(columns: np.ndarray) -> np.ndarray:
        return columns - basis @ (basis.T @ columns)

    residual = projected(rows.residual)
    # Sizes and starts of single records are estimated anew on the validation records.
    n_records = len(rows.passes) + len(study.validation or ())
    best: dict[str, Score] = {}
    for effect, shape, raw in _variants(fit, candidates, rows):
        score = _score(effect, shape, raw, projected(raw), residual, n_records)
        if effect.name not in best or score.statistic > best[effect.name].statistic:
            best[effect.name] = replace(score, trials=_trials(effect, rows))
    return sorted(best.values(), key=lambda s: -s.statistic), residual


def imitated_by(
    study: Study, fit: FilteredSolution, effect: Effect, absorbed: Sequence[Effect]
) -> tuple[str, ...]:
    """Which of the candidates that free parameters imitate this one effect of the model imitates.

    Asked at a fit that has it: where noise stood in its place, signatures of what is slow were lost
    in that.
    """
    told, _ = scores(study, fit, absorbed, apart=effect.amplitude_names)
    return tuple(one.effect.name for one in told if not one.absorbed)


def _named(effect: Effect, names: Sequence[str]) -> list[Parameter]:
    """Parameters of an effect by their names."""
    known = {parameter.name: parameter for parameter in effect.parameters}
    return [known[name] for name in names]


def _score(
    effect: Effect,
    shape: dict[str, float],
    raw: np.ndarray,
    projected: np.ndarray,
    residual: np.ndarray,
    n_records: int,
) -> Score:
    """Score at one shape, from columns as they are and with the unknowns projected out."""
    names, sizes = effect.amplitude_names, _named(effect, effect.amplitude_names)
    size, left = np.linalg.norm(raw, axis=0), np.linalg.norm(projected, axis=0)
    distinct = float(np.min(left / np.where(size > 0, size, np.inf)))
    n_local = sum(one.per_record for one in sizes)
    each = n_local + len(effect.start_names)
    freedom = len(names) - n_local + len(effect.shape_names) + n_records * each
    if distinct < ABSORBED:
        nothing, endless = dict.fromkeys(names, 0.0), dict.fromkeys(names, np.inf)
        return Score(effect, 0.0, freedom, nothing, endless, distinct, 0 * projected)
    matrix = projected.T @ projected
    right = projected.T @ residual
    # Rao's score statistic: s' I^-1 s, the square of what one step would explain.
    inverse = inverse_of(matrix)
    amplitude, errors = inverse @ right, np.sqrt(np.maximum(np.diag(inverse), 0.0))
    statistic = float(right @ amplitude)
    count = len(names)
    if raw.shape[1] > count:  # one amplitude for every record
        amplitude = amplitude.reshape(count, -1).mean(axis=1)
        # What a size that all records share would be known to.
        errors = np.sum(errors.reshape(count, -1) ** -2.0, axis=1) ** -0.5
    lower, upper = [one.lower for one in sizes], [one.upper for one in sizes]
    # An effect whose sign physics gives is no evidence with the other one.
    if len(amplitude) == 1 and (lower[0] >= 0 > amplitude[0] or upper[0] <= 0 < amplitude[0]):
        statistic, amplitude = 0.0, np.zeros(1)
    estimate = by_name(names, np.clip(amplitude, lower, upper)) | shape
    std_errors = by_name(names, errors)
    return Score(effect, statistic, freedom, estimate, std_errors, distinct, projected)


def _variants(
    fit: FilteredSolution, candidates: Sequence[Effect], rows: Rows
) -> Iterator[tuple[Effect, dict[str, float], np.ndarray]]:
    """Columns ``(n_rows, n_amplitudes)`` of every candidate, for every shape it may have."""
    for effect in candidates:
        is_smooth = rows.extra.keys() >= {*effect.amplitude_names}
        smooth_sizes = (TANGENT,) if two_sided(effect) else SIZES
        for shape, size in product(_shapes(effect, rows), smooth_sizes):
            columns = (
                np.column_stack([rows.extra[name] for name in effect.amplitude_names])
                if is_smooth
                else _secant(fit, effect, shape, rows, size)
            )
            if columns is not None:
                sizes = _named(effect, effect.amplitude_names)
                apart = any(one.per_record for one in sizes)
                yield effect, shape, rows.by_record(columns) if apart else columns


def two_sided(effect: Effect) -> bool:
    """Whether amplitudes may have either sign; other effects often have a kink at zero."""
    return all(one.lower < 0 for one in _named(effect, effect.amplitude_names))


def _secant(
    fit: FilteredSolution, effect: Effect, shape: dict[str, float], rows: Rows, share: float
) -> np.ndarray | None:
    """Change of the innovations per unit of each amplitude, from nothing to a share of its size."""
    typical = _named(effect, effect.amplitude_names)
    groups = [[one] for one in typical] if two_sided(effect) else [typical]
    problem = fit.problem
    model, levels = problem.model + effect, problem.levels.starting(fit.noise).held()
    columns = []
    for group in groups:
        sizes = {one.name: min(share * one.magnitude, one.upper) for one in group}
        trial = problem.posed(levels, model=model.with_values(fit.values | shape | sizes))
        unknowns = trial.point(fit.initial, fit.local).unknowns
        found = problem.replayed(trial, unknowns, rows.passes)
        if found is None:
            return None
        columns.append(rows.moved(found) / sum(sizes.values()))
    return np.array(columns).T


def _swings(effect: Effect, parameter: Parameter) -> bool:
    """Whether a shape is the frequency of something that swings in time."""
    return parameter.unit == "rad/s" and "t" in effect.uses()


def _trials(effect: Effect, rows: Rows) -> float:
    """Frequencies that the longest record tells apart within the bounds of an effect."""
    longest = max(float(t[-1] - t[0]) for t in rows.times)
    swinging = (one for one in _named(effect, effect.shape_names) if _swings(effect, one))
    ranges = (one.upper - one.lower for one in swinging)
    widest = max(filter(np.isfinite, ranges), default=0.0)
    return max(1.0, widest * longest / (2.0 * np.pi))


def _shapes(effect: Effect, rows: Rows) -> list[dict[str, float]]:
    """Grid over the bounds of the shape parameters, fine in the first and coarse in others.

    Where a term swings in time, the frequencies at which the innovations do are beside the grid,
    which is coarser than a long record tells them apart.
    """
    axes: list[np.ndarray] = []
    for position, parameter in enumerate(_named(effect, effect.shape_names)):
        low, high = parameter.lower, parameter.upper
        if not (np.isfinite(low) and np.isfinite(high)):
            low, high = sorted((0.5 * parameter.value, 2.0 * parameter.value))
        spaced = np.geomspace if parameter.log else np.linspace
        grid = spaced(low, high, N_SHAPES if position == 0 else N_OTHER_SHAPES)
        if _swings(effect, parameter):
            found = lines(rows.times, rows.scaled, low, high)
            told = _trials(effect, rows)  # a grid that is coarser than that says nothing
            grid = np.append(grid if told < N_SHAPES or not len(found) else grid[:0], found)
        axes.append(grid)
    return [by_name(effect.shape_names, np.array(point)) for point in product(*axes)]


# Frequencies per 2 pi over the longest record.
PER_CYCLE = 4


def lines(
    times: Sequence[np.ndarray], innovations: Sequence[np.ndarray], low: float, high: float
) -> np.ndarray:
    """Frequencies of the largest maxima of the periodogram.

    Parameters
    ----------
    times : sequence of ndarray (n_times,)
        Of each record, s.
    innovations : sequence of ndarray (n_times, n_outputs)
        In units of their standard deviation; NaN where not measured.
    low, high : float
        Range, rad/s.

    Returns
    -------
    ndarray (n_lines,)
        Largest first, three at most, rad/s.

    Examples
    --------
    >>> t = np.arange(0.0, 600.0, 0.5)
    >>> found = lines([t], [np.cos(0.713 * t + 1.0)[:, None]], 0.4, 0.9)
    >>> print(f"{found[0]:.3f}")
    0.714
    """
    from scipy.signal import lombscargle  # takes half a second

    longest = max((float(t[-1] - t[0]) for t in times if len(t) > 1), default=0.0)
    count = int(np.ceil((high - low) * longest * PER_CYCLE / (2.0 * np.pi))) + 1
    # Frequencies beyond those that samples show are not looked through.
    if not (high > low and 3 <= count <= PER_CYCLE * max(map(len, times))):
        return np.zeros(0)
    frequencies = np.linspace(low, high, count)
    power = np.zeros(count)
    for t, part in zip(times, innovations, strict=True):
        for series in part.T[np.isfinite(part).sum(axis=0) > 1]:
            seen = np.isfinite(series)
            power += lombscargle(t[seen], series[seen], frequencies)
    padded = np.pad(power, 1, constant_values=-np.inf)
    peaks = np.flatnonzero((power >= padded[:-2]) & (power > padded[2:]))
    return frequencies[peaks[np.argsort(-power[peaks], kind="stable")][:N_OTHER_SHAPES]]
