r"""Regression in the frequency domain, while the vehicle sails and afterwards.

Rows of an equation of motion over the interval from :math:`t_k` to :math:`t_{k+1}`
(:mod:`oed_sysid.baselines.equations`), :math:`y_k = \Phi_k \theta + e_k`, are summed as they come,

.. math:: Y(\omega) = \sum_k h_k\, y_k\, e^{-j \omega t_{k+1/2}}, \qquad
          X(\omega) = \sum_k h_k\, \Phi_k\, e^{-j \omega t_{k+1/2}},

at frequencies of a band. The difference :math:`(x_{k+1} - x_k)/h_k` in a row is a rate within that
band, so that nothing has to be differentiated: noise and waves outside of it do not count, and a
band of waves within it is left out. Then

.. math:: \hat\theta = A^{-1} b, \quad A = \sum_i \frac{\Re(X_i^* X_i)}{\sigma_i^2}, \quad
          b = \sum_i \frac{\Re(X_i^* Y_i)}{\sigma_i^2}, \quad
          \mathrm{cov}\,\hat\theta = \max\left(1, \frac{T_0}{T}\right) A^{-1}

with the error :math:`\sigma_i^2` of each equation from what is left of it. Frequencies are
multiples of :math:`1/T_0`; before :math:`T_0` has passed they are not independent. Memory and time
per sample do not grow.

The coherence of a response with an input is that of their differences from sample to sample,
summed over neighbouring frequencies,

.. math:: \gamma^2 = \frac{|\sum Y U^*|^2}{\sum |Y|^2 \sum |U|^2}.

References
----------
E. A. Morelli, Real-time parameter estimation in the frequency domain, AIAA 99-4043 (1999);
*Journal of Guidance, Control, and Dynamics* 23 (2000) 812-818.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.baselines.equations import (
    RegressionForm,
    regression_form,
    rows_from,
    states_of,
)
from oed_sysid.baselines.online import EquationStream, Stream
from oed_sysid.baselines.regression import Baseline, Regression, solve_rows
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DataError, ModelError
from oed_sysid.likelihood.start_guess import check_channels
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
NEIGHBOURS = 5

Band = tuple[float, float]


@dataclass(frozen=True)
class FourierRegression(Baseline):
    """Equation error in a band of frequencies.

    Linear in the free parameters, every state of the equations measured. It needs no start values
    and gives good ones: waves beyond the band of the motion do not reach it.

    Parameters
    ----------
    band : (float, float) or None
        Lowest and highest frequency, Hz. By default from the inverse of the record's length to
        twice the fastest motion of the nominal model; zero is in it where a parameter is constant.
    without : sequence of (float, float)
        Bands left out, Hz, such as that of the waves.

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
        form, runs, count = regression_form(model), [], 0
        for record in dataset:
            length = float(record.times[-1] - record.times[0])
            period = float(np.median(np.diff(record.times)))
            frequencies = frequencies_of(form, length, period, self.band, self.without)
            states = states_of(form, record.outputs)
            rows = rows_from(form, record.times, states, record.inputs, "trapezoid")
            sums = summed(frequencies, record.times - record.times[0], *rows)
            runs.append(real_rows(frequencies, *sums))
            count += len(frequencies)
        # Fourier sums at multiples of 1 / length are independent, whatever colour the noise has.
        found = solve_rows(form, *zip(*runs, strict=True), coloured="never")
        return replace(found, facts={"n_frequencies": count})


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
    low, high = band or (0.0 if _is_constant(form) else 0.5 / length, _fastest(form, highest))
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


def _fastest(form: RegressionForm, highest: float) -> float:
    """Highest frequency of the default band, Hz: twice the fastest motion of the nominal model.

    Eigenvalues at rest and at the scales of the states; of unmoving models the whole band.
    """
    graph, model = form.graph, form.model
    rows = [graph.state_names.index(name) for name in form.needed]
    scales = np.array([state.scale for state in model.states])
    size = len(graph.state_names)
    poles = [0.0]
    for size_of_motion in (0.0, 1.0):
        x = np.zeros(size)
        x[: len(scales)] = size_of_motion * scales
        jacobian = np.array(
            graph.rates.jacobian()(
                x, np.zeros(graph.actuate.size1_out(0)), model.value_vector, 0.0, np.zeros(size)
            )[0]
        )
        block = jacobian[np.ix_(rows, rows)]
        if np.isfinite(block).all() and len(rows):
            poles.append(float(np.abs(np.linalg.eigvals(block)).max()))
    # From rad/s to Hz, and an octave of room.
    found = 2.0 * max(poles) / (2 * np.pi)
    return min(found, highest) if found > 0 else highest


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


def real_rows(
    frequencies: np.ndarray, *sums: np.ndarray, factor: float = 1.0
) -> tuple[np.ndarray, ...]:
    r"""Real and imaginary parts as rows, each counting by a factor, one if independent.

    :math:`\Re(X^* X) = \Re X^T \Re X + \Im X^T \Im X`; at zero there is no imaginary part.
    """
    moving = frequencies > 0
    return tuple(np.sqrt(factor) * np.concatenate([part.real, part.imag[moving]]) for part in sums)


@dataclass(eq=False)
class FourierStream(Stream):
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
        self._before: list[tuple[np.ndarray, ...]] = []
        self._start = 0.0
        self._begin()

    def _begin(self) -> None:
        form, n = self._stream.form, len(self.frequencies)
        shape = (n, len(form.equations))
        self._sums = np.zeros(shape, complex), np.zeros((*shape, len(form.names)), complex)
        n_signals = len(self.model.input_names) + len(self.model.output_names)
        self._signals = np.zeros((n, n_signals), complex)
        self._solved: tuple[np.ndarray, np.ndarray] | None = None
        self.length = 0.0  # of what has been summed, s
        self._stream.start()

    @property
    def n_samples(self) -> int:
        """Number of samples taken, of all runs."""
        return self._stream.run.count

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
        self._solved = None

    def _runs(self) -> list[tuple[np.ndarray, ...]]:
        """Rows of all runs; those of one that goes on count by how much of it is over."""
        # Frequencies are those of the whole run: of a part of it their sums depend on each other.
        factor = min(1.0, self.length / self.duration)
        return [*self._before, real_rows(self.frequencies, *self._sums, factor=factor)]

    def estimate(self) -> tuple[np.ndarray, np.ndarray]:
        """Estimates ``(n_free,)`` in the order of ``model.free_names``, and their covariance."""
        if self._solved is None:
            # Rows that count less are fewer, too.
            targets, regressors = zip(*self._runs(), strict=True)
            *whole, part = map(len, targets)
            count = sum(whole) + min(1.0, self.length / self.duration) * part
            found = solve_rows(
                self._stream.form, targets, regressors, coloured="never", count=count
            )
            self._solved = found.estimates, found.covariance
        return self._solved

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
        n_inputs, found = len(self.model.input_names), {}
        for i, command in enumerate(self.model.input_names):
            for j, response in enumerate(self.model.output_names, start=n_inputs):
                cross = np.abs((groups[:, :, j] * groups[:, :, i].conj()).sum(axis=1)) ** 2
                total = power[:, i].sum() * power[:, j].sum()
                # |S_xy|^2 / (S_xx S_yy) over neighbouring frequencies, one alone being always
                # coherent.
                part = cross / np.maximum(power[:, i] * power[:, j], 1e-300)
                weight = power[:, j] / max(power[:, j].sum(), 1e-300)
                found[command, response] = float(part @ weight) if total > 0 else 0.0
        return found

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
            silent = [
                f"{response} hardly answers {command}"
                for (command, response), share in self.coherence().items()
                if share < 2.0 / NEIGHBOURS
            ]
            why = f" ({silent[0]})" if silent else ""
            return f"next run: {words}, this one does not excite it{why}"
        return f"go on: {words}, about {max(needed - elapsed, 0.0):.0f} s more at this excitation"
