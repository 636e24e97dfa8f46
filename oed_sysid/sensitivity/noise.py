"""Measurement noise before there are residuals: levels, and colour as autoregression."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import DesignError
from oed_sysid.information import autocorrelation
from oed_sysid.model import Model

Levels = Mapping[str, float] | Sequence[float] | np.ndarray | None
Colour = Mapping[str, float | Sequence[float]] | None


@dataclass(frozen=True, eq=False)
class Noise:
    r"""Stationary Gaussian noise of each output, white or autoregressive.

    .. math:: e_k = \sum_i a_i e_{k-i} + \sigma_a \varepsilon_k

    Parameters
    ----------
    sigma : ndarray (n_outputs,)
        Standard deviation of :math:`e`, in the outputs' units.
    coefficients : tuple of tuple of float
        Autoregression of each output; empty for white noise.
    """

    sigma: np.ndarray
    coefficients: tuple[tuple[float, ...], ...]

    @property
    def is_white(self) -> bool:
        """Whether all outputs have white noise."""
        return not any(self.coefficients)

    def whiten(self, values: np.ndarray, present: np.ndarray) -> np.ndarray:
        """Turn noise into independent noise of unit variance.

        Parameters
        ----------
        values : ndarray (n_times, n_outputs, ...)
            Residuals, or their derivatives.
        present : ndarray of bool (n_times, n_outputs)
            Samples that were measured; the others become zero.

        Returns
        -------
        ndarray, shape of ``values``

        Notes
        -----
        The first samples, and those after a gap, use the best predictors of
        lower order, so that the transform is exact for a stationary
        autoregression without gaps. Across a gap what is left of the
        correlation is not used, which makes bounds slightly pessimistic.
        """
        extra = (1,) * (values.ndim - 2)
        scaled = values / self.sigma.reshape(1, -1, *extra)
        if not present.all():
            scaled = np.where(present.reshape(*present.shape, *extra), scaled, 0.0)
        if self.is_white:
            return scaled
        whitened = scaled.copy()
        for column, autoregression in enumerate(self.coefficients):
            if not autoregression:
                continue
            predictors, deviations = _predictors(autoregression)
            before = _samples_before(present[:, column])
            series = scaled[:, column]
            for order, (predictor, deviation) in enumerate(
                zip(predictors, deviations, strict=True)
            ):
                last = order == len(predictors) - 1
                rows = np.flatnonzero(
                    present[:, column] & (before >= order if last else before == order)
                )
                guess = sum(
                    (a * series[rows - lag] for lag, a in enumerate(predictor, start=1)),
                    np.zeros_like(series[rows]),
                )
                whitened[rows, column] = (series[rows] - guess) / deviation
        return whitened


def noise_of(
    model: Model,
    levels: Levels = None,
    coloured: Colour = None,
    *,
    changed: Mapping[str, float] | None = None,
) -> Noise:
    """Return the noise of a model's outputs.

    Parameters
    ----------
    model : Model
        Its outputs' ``noise_std`` are the levels unless others are given.
    levels : mapping or sequence of float, optional
        Standard deviations, by output or in the outputs' order.
    coloured : mapping of str to float or sequence of float, optional
        Autoregression by output; a single number is the lag-one correlation.
    changed : mapping of str to float, optional
        Levels of a single experiment.

    Raises
    ------
    DesignError
        If a level is missing or not positive, or an autoregression unstable.
    """
    names = model.output_names
    stds: dict[str, float | None] = {o.name: o.noise_std for o in model.outputs}
    if isinstance(levels, Mapping):
        _known(model, levels)
        stds |= levels
    elif levels is not None:
        given = np.asarray(levels, dtype=float)
        if given.shape != (len(names),):
            raise DesignError(
                f"There are {given.size} noise levels for the outputs {', '.join(names)}. "
                "Give one each."
            )
        stds = dict(zip(names, map(float, given), strict=True))
    stds |= dict(changed or {})
    for name, std in stds.items():
        if std is None or not (np.isfinite(std) and std > 0):
            raise DesignError(
                f"The noise of {name!r} is {std}. Accuracy cannot be predicted without it: give "
                f"Output(noise_std=...) or noise={{{name!r}: standard deviation}}."
            )
    _known(model, coloured or {})
    colours = tuple(_autoregression(name, (coloured or {}).get(name, ())) for name in names)
    return Noise(np.array([stds[name] for name in names], dtype=float), colours)


def fitted_colour(
    residuals: Sequence[np.ndarray], names: Sequence[str], *, order: int = 2
) -> dict[str, tuple[float, ...]]:
    """Estimate the autoregression of residuals (Yule-Walker).

    Parameters
    ----------
    residuals : sequence of ndarray (n_times, n_outputs)
        Per record; NaN where nothing was measured.
    names : sequence of str
        Outputs.
    order : int
        Order of the autoregression.

    Returns
    -------
    dict of str to tuple of float
        For the ``coloured`` argument; outputs with correlations inside the
        sampling error of white noise are left out.
    """
    found: dict[str, tuple[float, ...]] = {}
    for column, name in enumerate(names):
        series = [r[:, column] for r in residuals if np.isfinite(r[:, column]).sum() > 10 * order]
        if not series:
            continue
        counts = np.array([np.isfinite(s).sum() for s in series], dtype=float)
        rho = sum(n * autocorrelation(s, order) for n, s in zip(counts, series, strict=True))
        rho = np.asarray(rho) / counts.sum()
        if np.abs(rho[1:]).max() < 3.0 / np.sqrt(counts.sum()):
            continue
        lags = np.abs(np.subtract.outer(np.arange(order), np.arange(order)))
        found[name] = tuple(map(float, np.linalg.solve(rho[lags], rho[1:])))
    return found


def _known(model: Model, given: Mapping[str, object]) -> None:
    for name in given:
        if name not in model.output_names:
            raise DesignError(
                f"Noise is given for {name!r}, which is no output of model {model.name!r}. It has "
                f"{', '.join(model.output_names)}."
            )


def _autoregression(name: str, given: float | Sequence[float]) -> tuple[float, ...]:
    coefficients = (float(given),) if isinstance(given, int | float) else tuple(map(float, given))
    if coefficients and not np.all(np.abs(_reflections(coefficients)) < 1):
        raise DesignError(
            f"The colour of {name!r}, {coefficients}, is not stationary. Correlations have to be "
            "below one in size."
        )
    return () if not any(coefficients) else coefficients


def _reflections(coefficients: tuple[float, ...]) -> np.ndarray:
    """Partial correlations of an autoregression, first lag first (Levinson, downwards)."""
    present = np.array(coefficients)
    found = []
    while len(present):
        last = present[-1]
        found.append(last)
        if abs(last) >= 1:
            break
        present = (present[:-1] + last * present[-2::-1]) / (1 - last**2)
    return np.array(found[::-1])


def _predictors(coefficients: tuple[float, ...]) -> tuple[list[np.ndarray], list[float]]:
    """Best predictors of order 0, 1, ..., and the deviation each leaves (Levinson)."""
    predictor, variance = np.zeros(0), 1.0
    predictors, deviations = [predictor], [1.0]
    for reflection in _reflections(coefficients):
        predictor = np.append(predictor - reflection * predictor[::-1], reflection)
        variance *= 1 - reflection**2
        predictors.append(predictor)
        deviations.append(float(np.sqrt(variance)))
    return predictors, deviations


def _samples_before(present: np.ndarray) -> np.ndarray:
    """Number of measured samples directly before each sample."""
    index = np.arange(len(present))
    last_gap = np.maximum.accumulate(np.where(present, -1, index))
    count = index - last_gap - 1
    return np.where(present, count, 0)
