"""The result of an estimation: values that are never without their uncertainty."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import ndtri

from oed_sysid.channels import Channels, Input, Output, State
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.effects import Actuator, Environment, ExtraState, Force, Inertia, Memory, Sensor
from oed_sysid.errors import DataError
from oed_sysid.fitting.archive import decode, encode
from oed_sysid.fitting.prediction import Initial, Prediction, predict
from oed_sysid.information import Information, Whiteness, whiteness
from oed_sysid.model import Function, Model
from oed_sysid.parameters import Parameter

# Residuals that count fewer independent samples than this share are coloured.
COLOUR_LIMIT = 0.8


@dataclass(frozen=True)
class Status:
    """How an estimation ended, and what to do about it.

    ``code`` is one of ``converged``, ``stalled``, ``iterations``,
    ``interrupted``, ``infeasible``, ``diverged``.
    """

    code: str
    advice: str

    @property
    def ok(self) -> bool:
        """Whether the values can be used."""
        return self.code == "converged"

    def __str__(self) -> str:
        return f"{self.code}: {self.advice}" if self.advice else self.code


@dataclass(frozen=True, eq=False)
class Fit:
    """Estimated parameters with uncertainty, residuals and a status that advises.

    Attributes
    ----------
    model : Model
        The model at the estimated values.
    dataset : Dataset
        What it was fitted to.
    estimator : str
        Name and settings of the estimator.
    names : tuple of str
        Estimated parameters.
    estimates : ndarray (n_free,)
        Their values.
    information : Information
        Of the estimated parameters, initial states eliminated, as if the
        residuals were white.
    covariance : ndarray (n_free, n_free)
        The covariance that is reported: the inverse information, or the
        sandwich covariance where residuals are coloured.
    coloured : bool
        Whether the sandwich is in use.
    sigma : ndarray (n_outputs,)
        Noise standard deviations, given or estimated.
    sigma_estimated : ndarray of bool (n_outputs,)
        Which of them were estimated.
    predictions, residuals : tuple of ndarray (n_times, n_outputs)
        Model outputs, and measured minus model, per record.
    states : tuple of ndarray (n_times, n_full)
        State trajectories, per record.
    initial_states : tuple of ndarray (n_own,)
        Estimated initial states, per record.
    local_values : tuple of mapping
        Values of per-record parameters, per record.
    cost : float
        Half the weighted sum of squares, priors included.
    status : Status
        How the estimation ended.
    iterations : int
    seconds : float
    """

    model: Model
    dataset: Dataset
    estimator: str
    names: tuple[str, ...]
    estimates: np.ndarray
    information: Information
    covariance: np.ndarray
    coloured: bool
    sigma: np.ndarray
    sigma_estimated: np.ndarray
    predictions: tuple[np.ndarray, ...]
    residuals: tuple[np.ndarray, ...]
    states: tuple[np.ndarray, ...]
    initial_states: tuple[np.ndarray, ...]
    local_values: tuple[Mapping[str, float], ...]
    cost: float
    status: Status
    iterations: int
    seconds: float
    extras: Mapping[str, Any] = field(default_factory=dict)

    # -- numbers -------------------------------------------------------------------

    @property
    def values(self) -> dict[str, float]:
        """Estimated value by name."""
        return dict(zip(self.names, map(float, self.estimates), strict=True))

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard error by name."""
        errors = np.sqrt(np.maximum(np.diag(self.covariance), 0.0))
        return dict(zip(self.names, map(float, errors), strict=True))

    @property
    def correlation(self) -> np.ndarray:
        """Correlation of the estimates, shape ``(n_free, n_free)``."""
        errors = np.sqrt(np.diag(self.covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            result = self.covariance / errors[:, None] / errors
        return np.where(np.isfinite(result), result, 0.0)

    @property
    def n_observations(self) -> int:
        """Number of measured samples, over all outputs."""
        return int(sum(np.isfinite(residual).sum() for residual in self.residuals))

    @property
    def log_likelihood(self) -> float:
        """Gaussian log-likelihood at the reported noise levels."""
        total = 0.0
        for residual in self.residuals:
            present = np.isfinite(residual)
            scaled = np.where(present, residual, 0.0) / self.sigma
            total -= 0.5 * float(np.sum(scaled**2))
            total -= float(np.sum(present * np.log(self.sigma * np.sqrt(2 * np.pi))))
        return total

    @property
    def n_unknowns(self) -> int:
        """Number of estimated values: parameters, initial states, noise levels."""
        local = sum(len(values) for values in self.local_values)
        states = sum(len(own) for own in self.initial_states)
        return len(self.names) + states + local + int(np.sum(self.sigma_estimated))

    @property
    def aic(self) -> float:
        """Akaike's information criterion; takes residuals as independent."""
        return 2.0 * self.n_unknowns - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Schwarz's information criterion; takes residuals as independent."""
        return self.n_unknowns * float(np.log(self.n_observations)) - 2.0 * self.log_likelihood

    @property
    def rms(self) -> dict[str, float]:
        """Root mean square residual of each output over all records, in its unit."""
        stacked = np.vstack(self.residuals)
        count = np.isfinite(stacked).sum(axis=0)
        squares = np.where(count > 0, np.nansum(stacked**2, axis=0) / np.maximum(count, 1), np.nan)
        return dict(zip(self.model.output_names, map(float, np.sqrt(squares)), strict=True))

    @property
    def normalised_rms(self) -> float:
        """Root mean square residual over all outputs, in units of the noise."""
        stacked = np.vstack(self.residuals) / self.sigma
        present = np.isfinite(stacked)
        return float(np.sqrt(np.mean(stacked[present] ** 2))) if present.any() else np.nan

    def interval(self, name: str, level: float = 0.95) -> tuple[float, float]:
        """Confidence interval of one parameter from its standard error."""
        half = ndtri(0.5 + level / 2) * self.std_errors[name]
        return float(self.values[name] - half), float(self.values[name] + half)

    def whiteness(self) -> dict[str, tuple[Whiteness, ...]]:
        """Whiteness of the residuals, by output, one entry per record that measured it."""
        return {
            name: tuple(
                whiteness(residual[:, column])
                for residual in self.residuals
                if np.isfinite(residual[:, column]).sum() > 10
            )
            for column, name in enumerate(self.model.output_names)
        }

    def effective_samples(self) -> dict[str, tuple[float, int]]:
        """Effective and actual number of samples of each output."""
        return {
            name: (
                float(sum(test.effective_samples for test in tests)),
                int(sum(test.n_samples for test in tests)),
            )
            for name, tests in self.whiteness().items()
        }

    def predict(self, dataset: Dataset, *, initial: Initial = "fit") -> Prediction:
        """Predict other records; see :func:`oed_sysid.fitting.prediction.predict`.

        Parameters
        ----------
        dataset : Dataset
            Records with the model's channels.
        initial : str or mapping
            ``"fit"`` estimates the initial states on each record with all
            shared parameters held, ``"first"`` takes the first measurements,
            a mapping gives the states.
        """
        shared = [p.name for p in self.model.free_parameters if not p.per_record]
        covariance = np.zeros((len(shared), len(shared)))
        known = [i for i, name in enumerate(shared) if name in self.names]
        columns = [self.names.index(shared[i]) for i in known]
        covariance[np.ix_(known, known)] = self.covariance[np.ix_(columns, columns)]
        return predict(self.model, dataset, covariance, self.sigma, initial=initial)

    def save(self, path: str | Path) -> None:
        """Write the fit, its model and its data to a JSON file; :meth:`load` reads it."""
        Path(path).write_text(json.dumps({"format": 1, "fit": encode(self)}), encoding="utf-8")

    @staticmethod
    def load(path: str | Path) -> Fit:
        """Read a fit from a file that :meth:`save` wrote."""
        try:
            content = json.loads(Path(path).read_text(encoding="utf-8"))
            data = content["fit"]
        except OSError as error:
            raise DataError(f"The fit {path} cannot be read: {error.strerror}.") from None
        except (ValueError, KeyError, TypeError):
            raise DataError(
                f"{path} does not hold a saved fit. Write it with fit.save()."
            ) from None
        fit = decode(data, ARCHIVED)
        if not isinstance(fit, Fit):
            raise DataError(f"{path} holds a {type(fit).__name__}, expected a fit.")
        return fit

    # -- words ---------------------------------------------------------------------

    def report(self) -> str:
        """Return the fit as text that can be pasted into a paper."""
        lines = [
            f"{self.model.name} fitted by {self.estimator}",
            f"  records       {', '.join(self.dataset.names)}",
            f"  observations  {self.n_observations}",
            f"  status        {self.status} ({self.iterations} iterations, {self.seconds:.2g} s)",
            f"  misfit        {self.normalised_rms:.3f} x noise over all outputs",
            "",
            *self._parameter_table(),
            *self._local_lines(),
            "",
            *self._output_table(),
        ]
        lines += self._warnings()
        return "\n".join(lines)

    def _parameter_table(self) -> list[str]:
        if not self.names:
            return ["  no free parameter: initial states only"]
        rows = [("parameter", "value", "std. error", "rel. %", "unit", "")]
        errors = self.std_errors
        for name, value in self.values.items():
            parameter = self.model.parameter(name)
            relative = 100 * errors[name] / abs(value) if value else np.inf
            note = ""
            if value <= parameter.lower or value >= parameter.upper:
                note = "at bound"
            elif not np.isfinite(errors[name]):
                note = "not identifiable"
            rows.append(
                (
                    name,
                    f"{value:.6g}",
                    f"{errors[name]:.2g}",
                    f"{relative:.2g}",
                    parameter.unit,
                    note,
                )
            )
        return [f"  {line}" for line in align(rows)]

    def _local_lines(self) -> list[str]:
        """Values of per-record parameters, one line each."""
        lines = []
        for name in self.local_values[0] if self.local_values else ():
            pairs = zip(self.dataset.names, self.local_values, strict=True)
            listed = ", ".join(f"{record} {values[name]:.4g}" for record, values in pairs)
            lines.append(
                f"  {name} per record: {listed} {self.model.parameter(name).unit}".rstrip()
            )
        return lines

    def _output_table(self) -> list[str]:
        rows = [("output", "rms residual", "noise", "", "eff. samples", "of", "unit")]
        effective = self.effective_samples()
        rms = self.rms
        for output, sigma, estimated in zip(
            self.model.outputs, self.sigma, self.sigma_estimated, strict=True
        ):
            count, total = effective[output.name]
            rows.append(
                (
                    output.name,
                    f"{rms[output.name]:.3g}",
                    f"{sigma:.3g}",
                    ("estimated" if estimated else "given") if total else "not measured",
                    f"{count:.0f}",
                    f"{total}",
                    output.unit,
                )
            )
        return [f"  {line}" for line in align(rows)]

    def _warnings(self) -> list[str]:
        lines = []
        commands = np.vstack([record.inputs for record in self.dataset])
        for channel, series in zip(self.model.inputs, commands.T, strict=True):
            if np.ptp(series) == 0.0:
                lines.append(
                    f"  Input {channel.name} never moves in any record: what it does cannot be "
                    "told from what else is constant."
                )
        if self.coloured:
            lines.append(
                "  Residuals are correlated in time (see eff. samples): standard errors are from "
                "the sandwich covariance."
            )
        lines += [f"  Not identifiable: {text}." for text in self.information.null_directions()]
        if bounded := [r.split()[0] for r in self._parameter_table() if r.endswith("at bound")]:
            lines.append(
                f"  {', '.join(bounded)} at bound: widen it if it may be wrong. A log that counts "
                "an angle the other way does this too: Input(..., sign=-1)."
            )
        correlation = self.correlation
        pairs = [
            (abs(correlation[i, j]), self.names[i], self.names[j], correlation[i, j])
            for i in range(len(self.names))
            for j in range(i)
            if abs(correlation[i, j]) > 0.95
        ]
        for _, first, second, value in sorted(pairs, reverse=True)[:6]:
            lines.append(f"  Correlation of {first} and {second}: {value:+.3f}.")
        return ["", *lines] if lines else []

    def to_dict(self) -> dict[str, Any]:
        """Return the fit as plain data for JSON."""
        return {
            "model": self.model.name,
            "estimator": self.estimator,
            "records": list(self.dataset.names),
            "status": {"code": self.status.code, "advice": self.status.advice},
            "iterations": self.iterations,
            "seconds": self.seconds,
            "cost": self.cost,
            "normalised_rms": self.normalised_rms,
            "parameters": [
                {
                    "name": name,
                    "value": value,
                    "std_error": self.std_errors[name],
                    "unit": self.model.parameter(name).unit,
                }
                for name, value in self.values.items()
            ],
            "covariance": self.covariance.tolist(),
            "coloured_residuals": self.coloured,
            "noise": dict(zip(self.model.output_names, self.sigma.tolist(), strict=True)),
            "rms": self.rms,
            "effective_samples": {k: list(v) for k, v in self.effective_samples().items()},
        }


def align(rows: Sequence[Sequence[str]]) -> list[str]:
    """Lay rows of text out in columns; the first column flush left, the others right."""
    widths = [max(len(row[i]) for row in rows) for i in range(len(rows[0]))]
    return [
        "  ".join(
            cell.ljust(width) if i == 0 else cell.rjust(width)
            for i, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]


# Everything that a saved fit is made of.
ARCHIVED: tuple[type, ...] = (
    *(Fit, Status, Information, Model, Function, Parameter, Dataset, Record, Channels),
    *(State, Input, Output, Actuator, Environment, Force, Inertia, Sensor, ExtraState, Memory),
)
