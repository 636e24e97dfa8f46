r"""Regression in the frequency domain, while the vehicle sails and afterwards.

Rows of an equation of motion over the interval from :math:`t_k` to :math:`t_{k+1}`
(:mod:`oed_sysid.baselines.equations`), :math:`y_k = \Phi_k \theta + e_k`, are summed as they come,

.. math:: Y(\omega) = \sum_k h_k\, y_k\, e^{-j \omega t_{k+1/2}}, \qquad
          X(\omega) = \sum_k h_k\, \Phi_k\, e^{-j \omega t_{k+1/2}},

at frequencies of a band. The difference :math:`(x_{k+1} - x_k)/h_k` in a row is a rate within that
band, so that nothing has to be differentiated. Two things keep the estimates unbiased in waves and
noise, without anybody saying where these are:

- *Weights.* A frequency counts by one over the spectrum :math:`S(\omega)` of the error of its
  equation, what is left of :math:`|Y - X\theta|^2` in a Daniell window of :math:`\sqrt n` of
  :math:`n` frequencies (Brillinger 1981, chapter 5), estimated in turn with :math:`\theta`:
  frequencies of waves, or those at which differences are noise, hardly count.
- *Instruments.* Waves and noise are in the regressors, too, and bias least squares. What the
  measured inputs make of the model at the present estimates, :math:`Z(\omega)`, the same sums of
  the model's own run, holds neither (refined instrumental variables; Young 2011, chapter 7). The
  rows are projected onto it:

.. math:: \hat\theta = (\tilde X^T P \tilde X)^{-1} \tilde X^T P\, \tilde y, \quad
          P = \tilde Z (\tilde Z^T \tilde Z)^{-1} \tilde Z^T, \quad
          \mathrm{cov}\,\hat\theta = \max\left(1, \frac{T_0}{T}\right)
          (\tilde X^T P \tilde X)^{-1}

with real and imaginary parts as rows, divided by :math:`\sqrt{S/2}`. The first estimates, and those
of a model that diverges on these inputs, are those of :math:`P = 1`. Where a helmsman answers the
waves, inputs hold some of them, and a bias of that size stays. Frequencies are multiples of
:math:`1/T_0`; before :math:`T_0` has passed they are not independent. Memory does not grow beyond
:math:`T_0`, and neither does time per sample.

The coherence of a response with an input is that of their differences from sample to sample,
summed over neighbouring frequencies,

.. math:: \gamma^2 = \frac{|\sum Y U^*|^2}{\sum |Y|^2 \sum |U|^2}.

References
----------
E. A. Morelli, Real-time parameter estimation in the frequency domain, AIAA 99-4043 (1999);
*Journal of Guidance, Control, and Dynamics* 23 (2000) 812-818. P. C. Young, *Recursive estimation
and time-series analysis*, 2nd ed., Springer (2011). D. R. Brillinger, *Time series: data analysis
and theory* (1981).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np

from oed_sysid.baselines.equations import (
    RegressionForm,
    regression_form,
    rows_from,
    states_of,
)
from oed_sysid.baselines.online import EquationStream
from oed_sysid.baselines.regression import (
    Baseline,
    Regression,
    bounded_least_squares,
    column_norms,
    prior_rows,
)
from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.data.record import MINIMUM_SAMPLES
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.start_guess import check_channels, first_state
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import (
    TWO_SIDED_95,
    Report,
    Section,
    Table,
    as_text,
    counted,
    digits,
    share,
)

# Neighbouring frequencies of one value of the coherence; its bias is one over them.
NEIGHBOURS = MINIMUM_SAMPLES

Band = tuple[float, float]


@dataclass(frozen=True)
class FourierRegression(Baseline):
    """Equation error in a band of frequencies.

    Linear in the free parameters, every state of the equations measured. It needs no start values
    and gives good ones, also in waves.

    Parameters
    ----------
    band : (float, float) or None
        Lowest and highest frequency, Hz. By default from the inverse of the record's length to a
        fifth of the sampling rate; zero is in it where a parameter is constant.
    without : sequence of (float, float)
        Bands left out, Hz, such as that of an engine.

    Examples
    --------
    >>> from oed_sysid import Dataset, load_problem, simulate
    >>> ship = load_problem("online_ship")
    >>> model, run = ship.model, ship.experiment("zigzag_10_10")
    >>> fit = FourierRegression().fit(model, Dataset((simulate(model, run, noise=False),)))
    >>> worst = max(abs(fit.values[n] / model.values[n] - 1) for n in fit.names)
    >>> worst < 0.02
    True
    """

    band: Band | None = None
    without: Sequence[Band] = ()

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        band = "" if self.band is None else f", {self.band[0]:g} to {self.band[1]:g} Hz"
        return f"Fourier regression{band}"

    def _estimate(self, model: Model, dataset: Dataset) -> Regression:
        check_channels(model, dataset)
        form, runs = regression_form(model), []
        for record in dataset:
            length = float(record.times[-1] - record.times[0])
            period = float(np.median(np.diff(record.times)))
            frequencies = frequencies_of(form, length, period, self.band, self.without)
            sums = _sums_of(form, record, states_of(form, record.outputs), frequencies)
            runs.append(Sums(record, frequencies, *sums, length))
        return solved(form, runs)


@dataclass(frozen=True, eq=False)
class Sums:
    """Rows of one run at its frequencies.

    Attributes
    ----------
    record : Record
        Inputs for instruments, and outputs for where these begin.
    frequencies : ndarray (n_frequencies,)
        Hz.
    targets : ndarray of complex (n_frequencies, n_equations)
    regressors : ndarray of complex (n_frequencies, n_equations, n_free)
    length : float
        Of what has been summed, s.
    share : float
        Of the run that is over: of a part of it sums at its frequencies depend on each other.
    """

    record: Record
    frequencies: np.ndarray
    targets: np.ndarray
    regressors: np.ndarray
    length: float
    share: float = 1.0

    def instruments(self, form: RegressionForm, values: np.ndarray) -> np.ndarray | None:
        """Regressors of the model's own run at some values; None where it diverges."""
        model = form.model.with_values(dict(zip(form.names, map(float, values), strict=True)))
        begin = first_state(model, self.record, None)
        at = model.value_vector
        run = kernel(model).simulate(self.record.times, self.record.inputs, at, begin)
        return _sums_of(form, self.record, run.states, self.frequencies)[1] if run.ok else None


def _sums_of(
    form: RegressionForm, record: Record, states: np.ndarray, frequencies: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sums ``Y`` and ``X`` of a run with some states at its frequencies; see :func:`summed`."""
    rows = rows_from(form, record.times, states, record.inputs, "trapezoid")
    return summed(frequencies, record.times - record.times[0], *rows)


def solved(form: RegressionForm, runs: Sequence[Sums]) -> Regression:
    """Estimates from the sums of all runs: least squares, then with instruments.

    Priors enter as observations; bounds are kept.

    Parameters
    ----------
    form : RegressionForm
        Equations and names.
    runs : sequence of Sums
    """
    found, told = _weighted(form, runs, [run.regressors for run in runs]), -np.inf
    for _ in range(2):  # the second has the instruments of consistent estimates
        instruments = [run.instruments(form, found.estimates) for run in runs]
        if any(one is None or not np.isfinite(one).all() for one in instruments):
            break
        other = _weighted(form, runs, [one for one in instruments if one is not None])
        # All are consistent; the best instruments are those that leave most information.
        before, told = told, _size(other.information)
        if not told > before:
            break
        found = other
    return found


def _size(information: Information | None) -> float:
    """Logarithm of the determinant of an information, in units of the parameters' sizes."""
    assert information is not None
    matrix = information.matrix * np.outer(information.scales, information.scales)
    return float(np.linalg.slogdet(matrix)[1])


def _weighted(
    form: RegressionForm, runs: Sequence[Sums], instruments: Sequence[np.ndarray]
) -> Regression:
    """Estimates with some instruments, weights and estimates in turn until both settle."""
    model, n_free = form.model, len(form.names)
    frequencies = np.concatenate([run.frequencies for run in runs])
    order = np.argsort(frequencies, kind="stable")
    frequencies = frequencies[order]
    # Sums of a stationary error grow with the root of the length of a run.
    sizes = [1.0 / np.sqrt(max(run.length, np.finfo(float).tiny)) for run in runs]

    def joined(parts: Iterable[np.ndarray]) -> np.ndarray:
        return np.concatenate([p * size for p, size in zip(parts, sizes, strict=True)])[order]

    targets = joined(run.targets for run in runs)
    regressors = joined(run.regressors for run in runs)
    instrument = joined(instruments)
    shares = np.concatenate([np.full(len(run.frequencies), run.share) for run in runs])[order]
    # Real and imaginary part carry half of |e|^2 each; at zero there is a real part only.
    parts = np.where(frequencies > 0, 2.0, 1.0)
    numbers = float(parts @ shares)
    lost = numbers / max(numbers - n_free / len(form.equations), 1.0)
    known, known_targets = prior_rows(model)
    # The first weights are sizes of the targets, as if the parameters were zero.
    level = np.mean(np.abs(targets) ** 2, axis=0)
    floor = 1e-20 * np.where(level > 0, level, 1.0)  # below it errors are rounding
    spectrum = np.maximum(np.broadcast_to(level, targets.shape), floor)
    for _ in range(20):
        weights = np.sqrt((parts * shares)[:, None] / spectrum)
        right = _real_rows(frequencies, targets * weights).reshape(-1, 1)
        rows = _real_rows(frequencies, regressors * weights[:, :, None]).reshape(-1, n_free)
        other = _real_rows(frequencies, instrument * weights[:, :, None]).reshape(-1, n_free)
        told = _root(other) @ (other.T @ np.hstack([rows, right]))
        matrix = np.vstack([told[:, :-1], known])
        estimates = bounded_least_squares(
            matrix, np.concatenate([told[:, -1], known_targets]), model
        )
        errors = np.abs(targets - regressors @ estimates) ** 2
        before, spectrum = spectrum, np.maximum(lost * _smoothed(errors), floor)
        if np.abs(np.log(spectrum / before)).max() < 1e-3:  # of weights, far below their errors
            break
    scales = np.array([p.magnitude for p in model.free_parameters])
    information = Information.from_jacobian(form.names, matrix, scales)
    return Regression(
        estimates, information.covariance, information,
        facts={"n_frequencies": len(frequencies)},
    )  # fmt: skip


def _root(rows: np.ndarray) -> np.ndarray:
    """``A`` with ``A.T @ A`` the pseudo-inverse of ``rows.T @ rows``; ``A @ rows.T`` projects."""
    scale = 1.0 / column_norms(rows)
    values, vectors = np.linalg.eigh((rows.T @ rows) * np.outer(scale, scale))
    kept = values > 1e-12 * max(values[-1], 1e-300)
    return (vectors[:, kept] / np.sqrt(values[kept])).T * scale


def _smoothed(power: np.ndarray) -> np.ndarray:
    """Means over the nearest rows, as many as the root of all, shorter at the ends."""
    n = len(power)
    half = max(int(np.sqrt(n)) // 2, 1)
    total = np.vstack([np.zeros(power.shape[1]), np.cumsum(power, axis=0)])
    low = np.maximum(np.arange(n) - half, 0)
    high = np.minimum(np.arange(n) + half + 1, n)
    return (total[high] - total[low]) / (high - low)[:, None]


def frequencies_of(
    form: RegressionForm, length: float, period: float, band: Band | None, without: Sequence[Band]
) -> np.ndarray:
    """Frequencies ``(n_frequencies,)`` in Hz: multiples of one over a length, within the band.

    Parameters
    ----------
    form : RegressionForm
        Equations, for the default band.
    length, period : float
        Of a run and between its samples, s.
    band, without
        See :class:`FourierRegression`.

    Raises
    ------
    DataError
        If fewer frequencies are left than there are parameters of one equation.
    """
    highest = 0.2 / period  # above it a difference is no rate any more
    low, high = band or (0.0 if _is_constant(form) else 0.5 / length, highest)
    # Only multiples of one over the length are independent of each other.
    multiples = np.arange(int(min(high, highest) * length) + 1) / length
    kept = multiples[multiples >= low - 1e-12]
    for lower, upper in without:
        kept = kept[(kept < lower) | (kept > upper)]
    if 2 * len(kept) <= len(form.names):
        raise DataError(
            f"{len(kept)} frequencies from {low:.3g} to {min(high, highest):.3g} Hz are left for "
            f"{len(form.names)} parameters of {length:.3g} s. Give a longer run, a wider band, or "
            "leave less of it out."
        )
    return kept


def _is_constant(form: RegressionForm) -> bool:
    """Whether a parameter stands in an equation without a signal, as an offset does."""
    first, second = form.anywhere(2)
    return bool(((first == second) & (first != 0)).any())


def summed(
    frequencies: np.ndarray, times: np.ndarray, targets: np.ndarray, regressors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Sums ``Y`` and ``X`` over rows of an equation between samples; gaps count not.

    Parameters
    ----------
    frequencies : ndarray (n_frequencies,)
        Hz.
    times : ndarray (n_times,)
        Of the samples, s.
    targets : ndarray (n_times - 1, n_equations)
    regressors : ndarray (n_times - 1, n_equations, n_free)

    Returns
    -------
    targets : ndarray of complex (n_frequencies, n_equations)
    regressors : ndarray of complex (n_frequencies, n_equations, n_free)
    """
    steps, middle = np.diff(times), 0.5 * (times[1:] + times[:-1])
    whole = np.isfinite(targets) & np.isfinite(regressors).all(axis=2)
    # A row between two samples acts at their middle, for as long as they are apart.
    turned = steps * np.exp(-2j * np.pi * np.outer(frequencies, middle))
    left = np.where(whole, targets, 0.0)
    right = np.where(whole[:, :, None], regressors, 0.0)
    return turned @ left, np.tensordot(turned, right, axes=1)


def _real_rows(frequencies: np.ndarray, sums: np.ndarray) -> np.ndarray:
    r"""Real and imaginary parts as rows; at zero there is no imaginary part.

    :math:`\Re(X^* X) = \Re X^T \Re X + \Im X^T \Im X`.
    """
    return np.concatenate([sums.real, sums.imag[frequencies > 0]])


@dataclass(eq=False)
class FourierStream:
    """Estimates with errors while a vehicle sails, one sample at a time.

    Parameters
    ----------
    model : Model
        As for :class:`FourierRegression`; actuators without memory, their signals as inputs.
    duration : float
        Expected length of a run, s: frequencies are multiples of its inverse.
    period : float
        Between samples, s.
    band, without
        See :class:`FourierRegression`.

    Examples
    --------
    >>> from oed_sysid import load_problem, simulate
    >>> ship = load_problem("online_ship")
    >>> run = ship.experiment("zigzag_10_10")
    >>> record = simulate(ship.model, run, noise=False)
    >>> stream = FourierStream(ship.model, duration=run.duration, period=run.sample_time)
    >>> for k, t in enumerate(record.times):
    ...     sample = dict(zip(ship.model.input_names, record.inputs[k]))
    ...     stream.push(t, sample | dict(zip(ship.model.output_names, record.outputs[k])))
    >>> worst = max(abs(stream.values[n] / ship.model.values[n] - 1) for n in stream.values)
    >>> worst < 0.02
    True
    """

    model: Model
    duration: float
    period: float
    band: Band | None = None
    without: Sequence[Band] = ()

    def __post_init__(self) -> None:
        if not (self.duration > self.period > 0):
            raise ModelError(
                f"The run lasts {self.duration} s with a sample every {self.period} s. Give a "
                "length of many samples."
            )
        self._stream = EquationStream(self.model)
        self.frequencies = frequencies_of(
            self._stream.form, self.duration, self.period, self.band, self.without
        )
        self._before: list[Sums] = []
        self._start = 0.0
        self._begin()

    def _begin(self) -> None:
        form, n = self._stream.form, len(self.frequencies)
        shape = (n, len(form.equations))
        self._sums = np.zeros(shape, complex), np.zeros((*shape, len(form.names)), complex)
        n_signals = len(self.model.input_names) + len(self.model.output_names)
        self._signals = np.zeros((n, n_signals), complex)
        self._solved: tuple[np.ndarray, np.ndarray] | None = None
        # For instruments; no more than what a run of the expected length has.
        self._samples: list[tuple[float, np.ndarray, np.ndarray]] = []
        self.length = 0.0  # of what has been summed, s
        self._stream.start()

    @property
    def n_samples(self) -> int:
        """Number of samples taken, of all runs."""
        return self._stream.n_samples

    def start(self) -> None:
        """Begin a new run; what earlier ones told is kept."""
        self._before = self._runs()
        self._begin()

    def push(self, time: float, sample: Mapping[str, float]) -> None:
        """Take one sample.

        Parameters
        ----------
        time : float
            s, increasing within a run.
        sample : mapping of str to float
            Commands and measured outputs by name, SI units; a missing output is NaN.
        """
        for targets, regressors in self._stream.rows(time, sample):
            (before, *first), (_, *last) = self._stream.samples
            times = np.array([before, time]) - self._start
            new = summed(self.frequencies, times, targets[None], regressors[None])
            self._sums = self._sums[0] + new[0], self._sums[1] + new[1]
            # Differences whiten drifting signals, whose slow part would outweigh the rest.
            change = np.nan_to_num(np.concatenate(last) - np.concatenate(first))
            middle = np.exp(-2j * np.pi * self.frequencies * times.mean())
            self._signals += np.outer(middle, change)
            self.length += time - before
        if len(self._stream.samples) == 1:
            self._start = time
        if time - self._start <= self.duration + 0.5 * self.period:
            self._samples.append(self._stream.samples[-1])
        self._solved = None

    def _runs(self) -> list[Sums]:
        """Sums of all runs."""
        if len(self._samples) < MINIMUM_SAMPLES:
            return self._before
        times, inputs, outputs = (np.array(part) for part in zip(*self._samples, strict=True))
        record = Record("run", times, inputs, outputs, self.model.channels)
        share = min(1.0, self.length / self.duration)
        return [*self._before, Sums(record, self.frequencies, *self._sums, self.length, share)]

    def estimate(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimates ``(n_free,)`` in the order of ``model.free_names``, and their covariance."""
        if self._solved is None:
            if runs := self._runs():
                found = solved(self._stream.form, runs)
                self._solved = found.estimates, found.covariance
            else:
                known = np.array([p.value for p in self.model.free_parameters])
                self._solved = known, np.diag(np.full(len(known), np.inf))
        return self._solved

    @property
    def values(self) -> dict[str, float]:
        """Parameters as known by now."""
        return dict(zip(self.model.free_names, self.estimate()[0].tolist(), strict=True))

    @property
    def std_errors(self) -> dict[str, float]:
        """Their standard errors."""
        stds = np.sqrt(np.maximum(np.diag(self.estimate()[1]), 0.0))
        return dict(zip(self.model.free_names, stds.tolist(), strict=True))

    @property
    def relative_errors(self) -> dict[str, float]:
        """Standard errors over the sizes of the estimates, by name; inf where nothing is known."""
        values = self.values
        return {
            name: std / abs(values[name]) if values[name] and np.isfinite(std) else np.inf
            for name, std in self.std_errors.items()
        }

    def coherence(self) -> dict[tuple[str, str], float]:
        """Coherence of every response with every input over the band, weighed by its power."""
        n = len(self.frequencies) // NEIGHBOURS * NEIGHBOURS
        if n == 0 or self.length == 0.0:
            return {}
        groups = self._signals[:n].reshape(-1, NEIGHBOURS, self._signals.shape[1])
        power = (np.abs(groups) ** 2).sum(axis=1)
        cross = np.abs(np.einsum("gki,gkj->gij", groups.conj(), groups)) ** 2
        # |S_xy|^2 / (S_xx S_yy) over neighbouring frequencies, one alone being always coherent.
        parts = cross / np.maximum(power[:, :, None] * power[:, None, :], 1e-300)
        weights = power / np.maximum(power.sum(axis=0), 1e-300)
        n_inputs = len(self.model.input_names)
        found = np.einsum("gij,gj->ij", parts, weights)[:n_inputs, n_inputs:]
        pairs = product(self.model.input_names, self.model.output_names)
        return dict(zip(pairs, found.ravel().tolist(), strict=True))

    def document(self, *, title: str = "", goal: float = 0.1) -> Report:
        """Return where the run stands: advice, estimates with errors, coherence.

        Parameters
        ----------
        title : str
            By default the name of the model.
        goal : float
            Relative standard error that is enough.
        """
        estimates, errors = self.values, self.relative_errors
        rows = [
            (
                name, digits(value, 3), self.model.parameter(name).unit,
                "unknown" if errors[name] > 10 else f"± {share(TWO_SIDED_95 * errors[name])}",
            )
            for name, value in estimates.items()
        ]  # fmt: skip
        answers = [(c, r, f"{value:.2f}") for (c, r), value in self.coherence().items()]
        return Report(
            title=title or self.model.name,
            subtitle="While it sails",
            answer=f"{self.length:.0f} s: {self.advice(goal)}",
            sections=(
                Section(
                    "Estimates", (f"{len(self.frequencies)} frequencies up to "
                    f"{self.frequencies[-1]:.3g} Hz, {counted(self.n_samples, 'sample')}.",),
                    (Table(("parameter", "estimate", "unit", "95 %"), rows, words=(2,)),),
                ),
                Section(
                    "Which response answers which command", (),
                    (Table(("command", "response", "coherence"), answers, words=(1,)),),
                ),
            ),
        )  # fmt: skip

    report = as_text

    def to_dict(self) -> dict[str, Any]:
        """Return plain data."""
        return {
            "seconds": self.length, "samples": self.n_samples, "values": self.values,
            "relative_errors": self.relative_errors,
            "coherence": [[*pair, value] for pair, value in self.coherence().items()],
        }  # fmt: skip

    def advice(self, goal: float = 0.1) -> str:
        """What to do with the run: whether every parameter is known to within a relative error.

        Parameters
        ----------
        goal : float
            Relative standard error that is enough.
        """
        errors = self.relative_errors
        worst = max(errors, key=lambda name: errors[name])
        if errors[worst] <= goal:
            return f"enough: every parameter is within {goal:.0%} ({worst} {share(errors[worst])})"
        elapsed = self.length
        if not np.isfinite(errors[worst]):
            return f"go on: nothing is known of {worst} yet"
        # Errors fall with the root of time where the excitation goes on as it does.
        needed = elapsed * (errors[worst] / goal) ** 2
        words = f"{worst} is known to {errors[worst]:.0%}"
        if elapsed >= self.duration and needed > 2 * elapsed:
            weak = [pair for pair, value in self.coherence().items() if value < 2.0 / NEIGHBOURS]
            why = f" ({weak[0][1]} hardly answers {weak[0][0]})" if weak else ""
            return f"next run: {words}, this one does not excite it{why}"
        more = max(needed - elapsed, 0.0)
        runs = min(round(more / self.duration), 100)
        time = counted(runs, "run") + " as long as this" if runs > 1 else f"{more:.0f} s more"
        return f"go on: {words}, {'about' if runs < 100 else 'over'} {time} at this excitation"
