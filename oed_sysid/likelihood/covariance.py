r"""How uncertain estimates are, from the Jacobian and the residuals at the optimum.

Residuals of a time series may be coloured, see
:func:`~oed_sysid.likelihood.information.coloured_score_covariance`. Those of independent tests,
such as
captive ones, cannot: with :math:`J_j` and :math:`e_j` the Jacobian and the residuals of test
:math:`j` in units of the noise, :math:`C` the covariance if the noise is as declared and
:math:`H_j = J_j C J_j'`, the middle of their sandwich is

.. math::
    B = \sum_j J_j' \left(e_j e_j' + S H_j S\right) J_j, \qquad
    S_{ii}^2 = \max\left(1, \frac{\sum_j e_{ji}^2}{\sum_j (1 - H_{jii})}\right),

in whatever order they stand (White 1980, Econometrica 48; :math:`H_j` is what the fit has taken out
of the residuals, so that :math:`B` is unbiased where the noise is as declared, :math:`S = 1`). It
is used where the squares of an output are larger than chance makes them, and is
:math:`\sum_j J_j' J_j` otherwise.

Innovations that oscillate with a period of their own, as waves and swell leave them.

A filter takes disturbance forces for first-order Gauss-Markov processes. Those of a sea with a
narrow
spectrum leave innovations that are nearly white from sample to sample, and yet power about one
frequency, where a vehicle that is moved there tells most of its parameters. Over ``R`` blocks of
``n`` innovations ``e`` in units of their standard deviation, and ``2 w + 1`` neighbouring
frequencies, white ones have

.. math::
    \hat S(f_i) = \frac{1}{R\,(2 w + 1)} \sum_{r, |j| \le w}
    \frac1n \Big| \sum_k e^r_k\, e^{-2 \pi \mathrm{i}\, (i + j) k / n} \Big|^2, \qquad
    2 R\,(2 w + 1)\, \hat S \sim \chi^2_{2 R (2 w + 1)}.

Where a peak is clear, errors are those of the sandwich :math:`H^{-1} B H^{-1}`, with ``B`` from
the autocovariances of the innovations over several periods
(:func:`~oed_sysid.likelihood.information.coloured_score_covariance`), and never below
:math:`H^{-1}`.

Scores of windows (:mod:`oed_sysid.likelihood.windows`) are not independent where residuals are
coloured: ``B`` is then their covariance, neighbours within a tenth of the record included (Newey &
West 1987, Econometrica 55). Where windows are too few for that, the covariance is :math:`H^{-1}`
times the residuals' mean square in units of the noise and the samples per independent one.
Independent tests add to ``B`` what stands above, priors as much as they say.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import chdtrc, gammaincc

from oed_sysid.data.dataset import Record
from oed_sysid.data.record import sampled_alike
from oed_sysid.likelihood.between_records import CHANCE, FEWEST, Sources, sources_of
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.estimate import by_name
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.information import (
    COLOUR_LIMIT,
    Information,
    coloured_score_covariance,
    counted_samples,
    own_samples,
)
from oed_sysid.likelihood.noise_levels import RARE
from oed_sysid.likelihood.projection import eliminate, inverse_of, project_out, share_of
from oed_sysid.likelihood.shooting import Linearisation, Loss, Point, Shooting
from oed_sysid.likelihood.unknowns import Posed
from oed_sysid.likelihood.windows import Windows
from oed_sysid.runtime.constants import NEGLIGIBLE


def sandwich(white: np.ndarray, middle: np.ndarray) -> np.ndarray:
    """Covariance :math:`H^{-1} B H^{-1}` of the parameters that are seen at all.

    Parameters
    ----------
    white : ndarray (n, n)
        :math:`H^{-1}`, infinite on the diagonal where nothing is seen, zero beside it.
    middle : ndarray (n, n)
        :math:`B`, the covariance of the summed scores.
    """
    seen = np.where(np.isfinite(white), white, 0.0)
    return np.where(np.isfinite(white), seen @ middle @ seen, white)


@dataclass(frozen=True, eq=False)
class Errors:
    """What the end of a search says of the shared parameters, everything else estimated along.

    Attributes
    ----------
    information : Information
        As if one-step errors were white.
    covariance : ndarray (n_shared, n_shared)
        As they are.
    sources : Sources or None
        What priors and each record say.
    coloured : bool
        Whether the covariance holds their autocorrelation.
    scattered : bool
        Whether it holds that independent tests scatter more than declared.
    """

    information: Information
    covariance: np.ndarray
    sources: Sources | None = None
    coloured: bool = False
    scattered: bool = False


def asks(coloured: str, found: bool) -> bool:
    """Whether errors hold what was or was not found in the residuals."""
    return coloured == "always" or (coloured == "auto" and found)


@dataclass(frozen=True, eq=False)
class Scores:
    """One-step errors and their derivatives by the shared parameters, all else estimated along.

    Attributes
    ----------
    records : sequence of Record
    jacobians : list of ndarray (n_times, n_outputs, n_shared)
        In units of the errors' standard deviation, zero where nothing was measured.
    errors : list of ndarray (n_times, n_outputs)
        In that unit, NaN where nothing was measured.
    """

    records: Sequence[Record]
    jacobians: list[np.ndarray]
    errors: list[np.ndarray]

    @property
    def series(self) -> list[int]:
        """Positions of the records that are series in time."""
        return [i for i, record in enumerate(self.records) if not record.independent]

    @cached_property
    def tests(self) -> tuple[np.ndarray, np.ndarray]:
        """Rows and errors of all independent tests."""
        chosen = [i for i, record in enumerate(self.records) if record.independent]
        rows, errors = (
            np.concatenate([every[0][:0], *(every[i] for i in chosen)])
            for every in (self.jacobians, self.errors)
        )
        return rows, errors

    def _leverage(self, white: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Degrees of freedom and sums of squares of tests by output, and their ``H = J C J'``."""
        rows, errors = self.tests
        taken = rows @ np.where(np.isfinite(white), white, 0.0) @ rows.transpose(0, 2, 1)
        freedom = np.isfinite(errors).sum(axis=0) - np.einsum("tii->i", taken)
        return freedom, np.nansum(errors**2, axis=0), taken

    def stray(self, white: np.ndarray) -> bool:
        """Whether independent tests scatter more than chance lets their declared noise do.

        ``white`` is the covariance ``C`` if noise is as declared, ``(n_shared, n_shared)``.
        """
        if not white.size:
            return False
        freedom, squares, _ = self._leverage(white)
        told = freedom > 0.5
        # Chance of as large a chi-squared sum, times the outputs that are asked.
        chances = gammaincc(0.5 * freedom[told], 0.5 * squares[told])
        return bool((chances * np.sum(told) < RARE).any())

    def of_tests(self, white: np.ndarray, *, scattered: bool) -> np.ndarray:
        r"""Covariance of the summed scores of tests, from their residuals where ``scattered``.

        :math:`\sum_j J_j' (e_j e_j' + S H_j S) J_j`, or :math:`\sum_j J_j' J_j`, see the head of
        this module.
        """
        rows, errors = self.tests
        if not scattered:
            flat = rows.reshape(-1, rows.shape[2])
            return np.asarray(flat.T @ flat)
        freedom, squares, taken = self._leverage(white)
        each = np.einsum("tip,ti->tp", rows, np.nan_to_num(errors))
        # Never below the declared noise: few tests may scatter little by chance.
        lost = np.sqrt(np.maximum(1.0, squares / np.maximum(freedom, 1.0)))  # S
        rows = rows * lost[:, None]
        return np.asarray(each.T @ each + np.einsum("tip,tij,tjq->pq", rows, taken, rows))

    def white(self, size: np.ndarray | float = 1.0) -> np.ndarray:
        """Covariance of the summed scores of all series, were their errors white of some size."""
        n_shared, size = self.jacobians[0].shape[2], np.atleast_1d(size)[:, None]
        flat = [(self.jacobians[index] * size).reshape(-1, n_shared) for index in self.series]
        return sum((one.T @ one for one in flat), np.zeros((n_shared, n_shared)))

    def coloured(self, memory: float | None = None) -> np.ndarray:
        """The same from the autocovariances of the errors, over ``memory`` seconds where given."""
        n_shared = self.jacobians[0].shape[2]
        middle = np.zeros((n_shared, n_shared))
        for group in sampled_alike([self.records[i] for i in self.series]):
            own = [self.series[i] for i in group]
            # Lags are counted in samples, so that records of one sample time stand together.
            step = self.records[own[0]].sample_time
            middle += coloured_score_covariance(
                [self.jacobians[i] for i in own],
                [self.errors[i] for i in own],
                lags=None if memory is None else int(np.ceil(memory / step)),
            )
        return middle


class Reduced:
    """One-step errors by the shared parameters, with everything else projected out.

    Initial states and per-record parameters are unknown too; what the data
    say about the shared parameters is what these cannot explain away.

    Parameters
    ----------
    records : sequence of Record
    rows : list of ndarray (n_times * n_outputs, n_shared)
        Whitened and reduced Jacobian by values, per record; zero where nothing was measured.
    prior_rows : list of ndarray (n_rows, n_shared)
        What priors add.
    errors : sequence of ndarray (n_times, n_outputs)
        In standard deviations, as the loss lets them count.
    gain : ndarray (n_outputs,)
        Slope of the errors as they count: 1 for least squares, less for robust losses.

    Attributes
    ----------
    told : Scores
    information : Information
        Of the shared parameters, as if errors were white.
    """

    information: Information

    def __init__(
        self,
        records: Sequence[Record],
        rows: list[np.ndarray],
        prior_rows: list[np.ndarray],
        errors: Sequence[np.ndarray],
        gain: np.ndarray,
    ) -> None:
        self.rows, self.prior_rows = rows, prior_rows
        # Errors count once with the slope of a robust loss, not twice.
        apart = [
            one.reshape(*error.shape, one.shape[1]) / np.sqrt(gain)[:, None]
            for one, error in zip(rows, errors, strict=True)
        ]
        self.told = Scores(records, apart, list(errors))

    @property
    def prior(self) -> np.ndarray:
        """Information of what is known before, ``(n_shared, n_shared)``."""
        return np.asarray(sum(rows.T @ rows for rows in self.prior_rows))

    def sandwich(self, series: np.ndarray, *, scattered: bool) -> np.ndarray:
        """Covariance ``H^-1 B H^-1`` of the shared parameters.

        Parameters
        ----------
        series : ndarray (n_shared, n_shared)
            Covariance of the summed scores of all series.
        scattered : bool
            Take that of independent tests from their own residuals.
        """
        white = self.information.covariance
        return sandwich(white, series + self.told.of_tests(white, scattered=scattered) + self.prior)

    @property
    def sources(self) -> Sources | None:
        """What priors and each record say of the shared parameters; None without any."""
        pairs = zip(self.told.jacobians, self.told.errors, strict=True)
        scores = [np.einsum("tip,ti->p", own, np.nan_to_num(errors)) for own, errors in pairs]
        matrices = [rows.T @ rows for rows in self.rows]
        return sources_of(
            matrices, scores, self.prior, self.told.records, gradient=self.gradient(scores)
        )

    def gradient(self, scores: Sequence[np.ndarray]) -> np.ndarray:
        """Slope of the whole, ``(n_shared,)``, with those of the records; zero at an optimum."""
        return np.zeros(len(self.prior))


class ReducedProblem(Reduced):
    """Residuals of least squares.

    Parameters
    ----------
    shooting : Shooting
        The problem.
    lin : Linearisation
        At the optimum.
    unknowns : ndarray (n_unknowns,)
        The optimum.
    """

    def __init__(self, shooting: Shooting, lin: Linearisation, unknowns: np.ndarray) -> None:
        self.shooting = shooting
        layout, limits = shooting.layout, shooting.limits
        n_shared, keep = len(layout.shared), layout.n_own + layout.shared
        residuals = [residual / shooting.sigma for residual in lin.residuals]
        scores, gain = _scores(residuals, shooting.loss)
        # Derivatives by values, of parameters whose logarithm is unknown too.
        slopes, weight = layout.shared_values(unknowns)[1], np.sqrt(limits.prior_weight)
        found, prior_rows = [], [np.diag(weight[:n_shared] / slopes)]
        for index, residual in enumerate(residuals):
            size = np.isfinite(residual) * np.sqrt(gain) / shooting.sigma
            jacobian = lin.jacobians[index] * size[:, :, None]
            flat = jacobian.reshape(-1, jacobian.shape[2])
            columns = layout.record_columns(index)
            # What is held explains nothing away.
            drop = layout.own[~limits.held[columns[layout.own]]]
            # Priors are rows like measurements; the shared parameters do not enter them.
            inner = np.vstack([flat[:, drop], np.diag(weight[columns[drop]])])
            outer = np.vstack([flat[:, keep] / slopes, np.zeros((len(drop), n_shared))])
            reduced = project_out(inner, outer)
            found.append(reduced[: len(flat)])
            prior_rows.append(reduced[len(flat) :])
        super().__init__(shooting.records, found, prior_rows, scores, gain)
        scales = limits.scale[:n_shared] * slopes
        jacobian = np.vstack([*self.rows, *self.prior_rows])
        self.information = Information.from_jacobian(layout.shared_names, jacobian, scales)

    def errors(self, coloured: str, *, weighed: bool) -> Errors:
        """Errors of the shared parameters; of white residuals where they are not ``weighed``.

        Parameters
        ----------
        coloured : str
            See :class:`~oed_sysid.likelihood.summary.Procedure`.
        weighed : bool
        """
        information, told = self.information, self.told
        covariance, robust = information.covariance, self.shooting.loss is not None
        use, scattered = (
            asks(coloured, one) for one in (self.is_coloured, told.stray(information.covariance))
        )
        # Where every parameter is known, initial states alone were estimated.
        if len(covariance) and (((use or scattered) and weighed) or robust):
            covariance = self.sandwich(self._of_series(coloured=use), scattered=scattered)
        scattered = scattered and len(told.series) < len(told.records)
        return Errors(information, covariance, self.sources, use, scattered)

    @property
    def is_coloured(self) -> bool:
        """Whether residuals count clearly fewer independent samples than they have."""
        # Residuals far below the noise are rounding errors of a simulation, not noise.
        loud = any(np.nanmax(np.abs(s), initial=0.0) > NEGLIGIBLE for s in self._series)
        return loud and is_coloured(self._series)

    @property
    def _series(self) -> list[np.ndarray]:
        """Errors of the records that are series in time."""
        return [self.told.errors[i] for i in self.told.series]

    @property
    def _lost_freedom(self) -> float:
        """How much the fit has shrunk the residuals' variance, by independent samples."""
        count = sum(some for _, some in counted_samples(self._series))
        # n / (n - p) of least squares, with independent samples for n; where these are so few that
        # more than half is lost, no correction helps.
        return min(count / max(count - self.shooting.n_unknowns, 1.0), TWOFOLD)

    def _of_series(self, *, coloured: bool) -> np.ndarray:
        """Covariance of the summed scores of series, which robust losses leave smaller than H."""
        if coloured:
            # Long-run variance of the scores (Newey & West 1987).
            return self.told.coloured() * self._lost_freedom
        if self.shooting.loss is None:
            return self.told.white()
        errors = np.vstack(self.told.errors)
        count = np.maximum(np.isfinite(errors).sum(axis=0), 1)  # of a sensor that was silent none
        size = np.sqrt(np.nansum(errors**2, axis=0) / count)
        return self.told.white(size) * self._lost_freedom


def is_coloured(residuals: Sequence[np.ndarray]) -> bool:
    """Whether residuals count fewer independent samples than a share of their number."""
    found = [*counted_samples(residuals)]
    total = sum(len(seen) for seen, _ in found)
    return total > 0 and sum(some for _, some in found) < COLOUR_LIMIT * total


def _scores(
    residuals: Sequence[np.ndarray], loss: Loss | None
) -> tuple[list[np.ndarray], np.ndarray]:
    """Residuals as the loss lets them count, and the mean slope of that by output."""
    if loss is None:
        return list(residuals), np.ones(residuals[0].shape[1])

    def score(residual: np.ndarray) -> np.ndarray:
        return residual * loss(residual)[1]

    stacked, h = np.vstack(residuals), 1e-4
    # H = J' J times the mean slope of the scores (Huber 1964), which is kept above zero.
    slopes = (score(stacked + h) - score(stacked - h)) / (2 * h)
    seen = np.isfinite(stacked)
    count = np.maximum(seen.sum(axis=0), 1)
    gain = np.where(seen, slopes, 0.0).sum(axis=0) / count
    return [score(residual) for residual in residuals], np.maximum(gain, 0.05)


@dataclass(frozen=True)
class Peak:
    """Power of innovations about one frequency.

    Attributes
    ----------
    output : str
    period : float
        At the centre of the power beyond that of white innovations, s.
    ratio : float
        Power there over that of white innovations.
    chance : float
        Of such a peak in white innovations, at any frequency.
    """

    output: str
    period: float
    ratio: float
    chance: float


def spectral_peak(series: Sequence[np.ndarray], sample_time: float, output: str = "") -> Peak:
    """Clearest peak in the spectrum of one output.

    Parameters
    ----------
    series : sequence of ndarray (n_times,)
        Innovations over their standard deviations, a series a record, NaN where nothing was
        measured.
    sample_time : float
        Time between samples, s.
    output : str

    Returns
    -------
    Peak
        With chance one where there is nothing to search.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> swell = np.cos(2 * np.pi * np.arange(600) / 50)
    >>> found = spectral_peak([rng.standard_normal(600) + 0.4 * swell], 0.1)
    >>> round(found.period), found.chance < 1e-3
    (5, True)
    >>> spectral_peak([rng.standard_normal(600)], 0.1).chance < 0.05
    False
    """
    best = Peak(output, np.inf, 1.0, 1.0)
    usable = [one for one in series if np.mean(np.isfinite(one)) > 0.5]
    # One length of block for all records, so that their spectra add up.
    length = min([4096, *map(len, usable)])
    if not usable or length < 2 * FEWEST * FEWEST:
        return best
    blocks = np.vstack(
        [np.nan_to_num(one[: len(one) // length * length]).reshape(-1, length) for one in usable]
    )
    blocks = blocks[np.any(blocks, axis=1)]
    blocks = blocks / np.linalg.norm(blocks, axis=1, keepdims=True)
    # Each block in units of its own power: a loud manoeuvre counts as one block.
    power, count = (np.abs(np.fft.rfft(blocks)) ** 2).sum(axis=0), len(blocks)
    first, last = FEWEST, length // FEWEST
    # Neighbouring frequencies on either side that are taken together.
    widths = [width for width in (1, 3, 9) if 2 * width + 1 <= (last - first) // 2]
    tries = max((last - first) * len(widths), 1)
    for width in widths:
        # Of white series each sum is chi-squared with two degrees of freedom a line and block.
        sums = np.convolve(power[first : last + 1], np.ones(2 * width + 1), "valid")
        freedom = count * (2 * width + 1)
        chances = chdtrc(2 * freedom, 2.0 * sums)
        at = int(np.argmin(chances))
        chance = min(1.0, float(chances[at]) * tries)
        if chance < best.chance:
            bins = np.arange(first + at, first + at + 2 * width + 1)
            centre = np.average(bins, weights=np.maximum(power[bins] - count, 1e-9))
            period = float(length * sample_time / centre)
            best = Peak(output, period, float(sums[at] / freedom), chance)
    return best


def clear_peaks(
    whitened: Sequence[np.ndarray], records: Sequence[Record], outputs: Sequence[str]
) -> list[Peak]:
    """Outputs whose innovations have a clear peak, the clearest first.

    Parameters
    ----------
    whitened : sequence of ndarray (n_times, n_outputs)
        Innovations over their standard deviations, a part a record.
    records : sequence of Record
    outputs : sequence of str
        Their names.
    """
    found: list[Peak] = []
    for group in sampled_alike(records):
        regular = [i for i in group if _is_regular(records[i])]
        for column, name in enumerate(outputs):
            series, time = own_samples([whitened[i][:, column] for i in regular])
            if series:
                step = records[regular[0]].sample_time
                found.append(spectral_peak(series, time * step, name))
    clearest: dict[str, Peak] = {}
    for peak in sorted(found, key=lambda one: one.chance):
        if peak.chance * len(outputs) < CHANCE:
            clearest.setdefault(peak.output, peak)
    return list(clearest.values())


def _is_regular(record: Record) -> bool:
    """Whether samples follow one another, at intervals that differ by less than a tenth."""
    steps = np.diff(record.times)
    regular = len(steps) > 1 and bool(np.ptp(steps) < 0.1 * np.median(steps))
    return regular and not record.independent


def onto_shared(
    problem: Posed, unknowns: np.ndarray, index: int, matrix: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    r"""Combinations that carry scores of one record to the shared parameters, by their values.

    With :math:`M` the information of a record, :math:`s` its shared and :math:`o` its own unknowns,
    :math:`T = D^{-1} [I, -M_{so} M_{oo}^{-1}]`, so that :math:`T M T'` is the information once the
    own unknowns are estimated along.

    Parameters
    ----------
    problem : Posed
    unknowns : ndarray (n_unknowns,)
    index : int
        Of the record.
    matrix : ndarray (n, n)
        Of its start states and free parameters, or of the latter alone; what is known of its own
        unknowns is added to it in place.

    Returns
    -------
    onto : ndarray (n_shared, n)
    own : ndarray of int
        Positions of the own unknowns that are not held.
    """
    layout, limits = problem.layout, problem.limits
    first = layout.n_own + len(layout.free_names) - len(matrix)
    columns = layout.record_columns(index)[first:]
    shared = layout.n_own + layout.shared - first
    own = np.setdiff1d(np.arange(len(matrix)), shared)
    own = own[~limits.held[columns[own]]]
    matrix[own, own] += limits.prior_weight[columns[own]]
    onto = np.zeros((len(shared), len(matrix)))
    onto[:, shared] = np.eye(len(shared))
    # What the own unknowns take of a score of the shared ones.
    onto[:, own] = -share_of(matrix, shared, own)
    return onto / layout.shared_values(unknowns)[1][:, None], own


class ReducedFilter(Reduced):
    r"""Innovations of a filter.

    With the information ``H`` of all unknowns, start states, per-record parameters and levels ``o``
    are eliminated from that of the shared parameters ``p``,
    :math:`H_{pp} - H_{po} H_{oo}^{-1} H_{op}`, and from the derivatives of innovations, which are
    those at frozen gain.

    Parameters
    ----------
    problem : Filtered
    unknowns : ndarray (n_unknowns,)
        The optimum.
    matrix : ndarray (n_unknowns, n_unknowns)
        Information of all unknowns there, priors excluded.

    Attributes
    ----------
    passes : list of FilterPass
    std : list of ndarray (n_times, n_outputs)
        Standard deviations of the innovations, per record.
    """

    def __init__(self, problem: Filtered, unknowns: np.ndarray, matrix: np.ndarray) -> None:
        self.problem, self.unknowns = problem, unknowns
        layout, limits = problem.layout, problem.limits
        self._matrix = matrix + np.diag(limits.prior_weight)
        shared = np.arange(len(layout.shared))
        slopes = layout.shared_values(unknowns)[1]
        others = problem.open_unknowns(len(shared))
        # How everything follows the values of the shared parameters.
        onto = np.zeros((len(matrix), len(shared)))
        onto[shared, shared] = 1.0
        onto[others] = -share_of(self._matrix, shared, others).T
        reduced = onto.T @ self._matrix[:, shared]
        scales = limits.scale[shared] * slopes
        self.information = Information.from_matrix(
            layout.shared_names, reduced / slopes[:, None] / slopes, scales
        )
        onto /= slopes
        self._joint = problem.knowledge.information / slopes[:, None] / slopes
        self._pull = onto.T @ (limits.prior_weight * (limits.prior_mean - unknowns))
        self.passes = problem.passes(unknowns, rows=True)
        self.std = [np.sqrt(np.maximum(part.variances, 1e-300)) for part in self.passes]
        rows, errors = [], []
        for index, part in enumerate(self.passes):
            columns = layout.record_columns(index)
            size = layout.record_slopes(unknowns, index)
            # An innovation falls where the output rises; a gap says nothing.
            seen = np.isfinite(part.innovations)[..., None]
            jacobian = np.where(seen, -part.rows[..., : len(columns)], 0.0)
            rows.append(jacobian.reshape(-1, len(columns)) @ (size[:, None] * onto[columns]))
            errors.append(part.innovations / self.std[index])
        prior_rows = [np.sqrt(limits.prior_weight)[:, None] * onto]
        gain = np.ones(len(problem.model.outputs))
        super().__init__(problem.records, rows, prior_rows, errors, gain)

    @property
    def prior(self) -> np.ndarray:
        """Information of what is known before, ``(n_shared, n_shared)``."""
        return super().prior + self._joint

    def gradient(self, scores: Sequence[np.ndarray]) -> np.ndarray:
        """Slope of the whole; scores are approximate, so that it is not zero."""
        return np.asarray(self._pull + np.sum(scores, axis=0))

    @cached_property
    def peaks(self) -> list[Peak]:
        """Outputs whose innovations oscillate with a period of their own."""
        names = self.problem.model.output_names
        return clear_peaks(self.told.errors, self.told.records, names)

    def errors(self, coloured: str) -> Errors:
        """Errors of the shared parameters.

        Parameters
        ----------
        coloured : str
            ``"never"`` to hold what independent tests scatter beyond what was declared.
        """
        covariance, told = self.information.covariance, self.told
        tests = len(told.series) < len(told.records)
        scattered = tests and coloured != "never" and told.stray(covariance)
        if len(covariance) and (self.peaks or scattered):
            # Over several periods of what innovations remember.
            longest = 25.0 * max((peak.period for peak in self.peaks), default=0.0)
            series = told.coloured(longest) if self.peaks else told.white()
            covariance = self._no_less(self.sandwich(series, scattered=scattered))
        return Errors(self.information, covariance, self.sources, bool(self.peaks), scattered)

    def _no_less(self, robust: np.ndarray) -> np.ndarray:
        """A covariance, nowhere below that of white innovations."""
        least, found = np.diag(self.information.covariance), np.diag(robust)
        ratio = np.where(np.isfinite(least), least, 0.0) / np.where(found > 0, found, np.inf)
        grow = np.sqrt(np.maximum(1.0, ratio))
        return robust * grow[:, None] * grow

    @property
    def level_errors(self) -> dict[str, float]:
        """Standard errors of levels, relative, and of the logarithms of times."""
        levels, block = self.problem.levels, self.problem.layout.levels
        others = self.problem.open_unknowns(0)
        where = np.arange(block.start, block.stop)
        reduced = eliminate(self._matrix, where, others[others < block.start])
        variances = np.maximum(np.diag(inverse_of(reduced)), 0.0)
        errors = np.where(np.diag(reduced) > 0, np.sqrt(variances), np.inf)
        # Of a variance: twice the relative error of its root.
        values = np.where(levels.are_variances, 2.0 * self.unknowns[block], 1.0)
        relative = np.where(values > 0, errors / np.where(values > 0, values, 1.0), np.inf)
        return by_name(levels.names, relative)


# Share of a record's windows over which scores are taken to be related.
RELATED = 0.1


def errors_of_windows(problem: Windows, point: Point, coloured: str) -> Errors:
    """Errors of the shared parameters from windows of a horizon.

    Unless they are ``"never"`` to hold the colour of residuals, they are those at the head of this
    module.
    """
    shooting, unknowns = problem.shooting, point.unknowns
    layout, limits = shooting.layout, shooting.limits
    n_shared = len(layout.shared)
    slopes = layout.shared_values(unknowns)[1]
    prior = np.diag(limits.prior_weight[:n_shared] / slopes**2)
    told = _told_by_records(problem, point)
    tests = np.array([record.independent for record in shooting.records])
    matrices = np.array([matrix for matrix, _ in told])
    whole = prior + matrices.sum(axis=0)
    information = Information.from_matrix(
        layout.shared_names, whole, limits.scale[:n_shared] * slopes
    )
    sums = [rows.sum(axis=0) for _, rows in told]
    sources = sources_of(list(matrices), sums, prior, shooting.records)
    covariance = information.covariance
    use = coloured != "never" and problem.n_windows > 0
    if coloured == "never" or not n_shared:
        return Errors(information, covariance, sources, use)
    alone = _linearised_tests(shooting, np.flatnonzero(tests).tolist(), unknowns)
    scattered = alone is not None and (coloured == "always" or alone.stray(covariance))
    scores = [told[i][1] for i in np.flatnonzero(~tests)]
    white = matrices[~tests].sum(axis=0)
    # From the residuals where windows are few.
    few = problem.n_windows < FEWEST * n_shared
    middle = prior + (_inflation(problem, point) * white if few else sum(map(_summed, scores)))
    if alone is not None:
        middle += alone.of_tests(covariance, scattered=scattered)
    return Errors(information, sandwich(covariance, middle), sources, use, scattered)


def _told_by_records(problem: Windows, point: Point) -> list[tuple[np.ndarray, np.ndarray]]:
    """What every record says of the shared parameters, its own ones estimated along.

    Information ``(n_shared, n_shared)``, and scores of the windows in their order,
    ``(n_windows, n_shared)``.
    """
    shooting, n_free = problem.shooting, len(problem.shooting.layout.free_names)
    matrices = np.zeros((len(shooting.records), n_free, n_free))
    scores: list[list[np.ndarray]] = [[] for _ in shooting.records]
    for part, matrix, own in problem.told(point):
        matrices[part.record] += matrix
        scores[part.record].append(np.column_stack([part.starts[part.counted], own]))
    told = []
    for index, matrix in enumerate(matrices):
        onto, _ = onto_shared(shooting, point.unknowns, index, matrix)
        rows = np.vstack(scores[index])
        rows = rows[np.argsort(rows[:, 0]), 1:]
        told.append((onto @ matrix @ onto.T, rows @ onto.T))
    return told


def _linearised_tests(shooting: Shooting, tests: list[int], unknowns: np.ndarray) -> Scores | None:
    """Jacobian and residuals of independent tests; None without any."""
    if not tests:
        return None
    alone, own = shooting.part(tests, unknowns)
    found = alone.linearise(alone.continuous(own))
    assert found is not None
    return ReducedProblem(alone, found, own).told


def _summed(rows: np.ndarray) -> np.ndarray:
    """Covariance of the sum of a record's scores ``(n_windows, n_shared)``, neighbours related."""
    middle = rows.T @ rows
    reach = int(RELATED * len(rows)) + 1
    for lag in range(1, min(reach, len(rows) - 1) + 1):
        # Weights of Bartlett: the sum stays positive semidefinite.
        related = rows[lag:].T @ rows[:-lag]
        middle += (1 - lag / (reach + 1)) * (related + related.T)
    return np.asarray(middle)


def _inflation(problem: Windows, point: Point) -> float:
    """Mean square of the residuals in units of the noise, times samples per independent one."""
    shooting = problem.shooting
    series = [
        residual / shooting.sigma
        for record, residual in zip(shooting.records, problem.residuals(point), strict=True)
        if not record.independent
    ]
    ratios = [np.mean(seen**2) * len(seen) / some for seen, some in counted_samples(series, 10)]
    return max(float(np.mean(ratios)) if ratios else 0.0, 1.0)
