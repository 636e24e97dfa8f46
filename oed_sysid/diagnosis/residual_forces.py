"""Residual forces: what must have acted beside the model, and what a candidate would leave.

Free parameters absorb part of a missing force. What is smoothed from the
residuals is the rest, so a candidate is put through the same projection and
the same smoother before it is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.noise.kalman import Deviations, NoiseModel
from oed_sysid.noise.linearisation import Along
from oed_sysid.noise.restricted_likelihood import Grounds, Restricted, restricted
from oed_sysid.noise.smoother import Smoothed, smooth


@dataclass(frozen=True, eq=False)
class Series:
    """Smoothed signals of one record.

    Attributes
    ----------
    times : ndarray (n_times,)
        In s.
    values, std : ndarray (n_times, n_signals)
        Expectation, and standard error with the uncertainty of parameters and
        initial states in it.
    """

    times: np.ndarray
    values: np.ndarray
    std: np.ndarray

    def to_dict(self) -> dict[str, list]:
        """Return plain data for JSON."""
        return {
            "times": self.times.tolist(),
            "values": self.values.tolist(),
            "std": self.std.tolist(),
        }


@dataclass(frozen=True, eq=False)
class ResidualForces:
    """Smoother of one linearised model under one noise model.

    Attributes
    ----------
    grounds : Grounds
        Sensitivities and residuals.
    noise : NoiseModel
    lines : sequence of Deviations
        Driven by what is smoothed.
    smoothed : tuple of Smoothed
        Of all columns, per record.
    solution : Restricted
        Parameters and initial states that go with the residuals.
    """

    grounds: Grounds
    noise: NoiseModel
    lines: Sequence[Deviations]
    smoothed: tuple[Smoothed, ...]
    solution: Restricted

    @classmethod
    def of(cls, grounds: Grounds, noise: NoiseModel, lines: Sequence[Deviations]) -> ResidualForces:
        """Smooth residuals and sensitivities of all records."""
        smoothed = tuple(
            smooth(noise, line, column) for line, column in zip(lines, grounds.columns, strict=True)
        )
        return cls(grounds, noise, lines, smoothed, restricted(grounds, [noise], [lines])[0])

    def series(self, times: Sequence[np.ndarray]) -> tuple[Series, ...]:
        """What was smoothed, per record."""
        result = []
        for index, (t, part) in enumerate(zip(times, self.smoothed, strict=True)):
            where = self.grounds.unknowns(index)
            absorbed = part.forces[:, :, :-1]
            values = part.forces[:, :, -1] - absorbed @ self.solution.correction[where]
            covariance = self.solution.covariance[np.ix_(where, where)]
            spread = np.sum((absorbed @ covariance) * absorbed, axis=2)
            result.append(Series(t, values, np.sqrt(part.std**2 + np.maximum(spread, 0.0))))
        return tuple(result)

    def signature(self, changes: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """What would be smoothed if the records differed from what they are.

        Parameters
        ----------
        changes : sequence of ndarray (n_times, n_outputs)
            What to add to the measurements, per record.

        Returns
        -------
        tuple of ndarray (n_times, n_forces)
        """
        columns = []
        for column, change in zip(self.grounds.columns, changes, strict=True):
            moved = column.copy()
            moved[:, :, -1] += change
            columns.append(moved)
        grounds = replace(self.grounds, columns=tuple(columns))
        step = restricted(grounds, [self.noise], [self.lines])[0].correction
        result = []
        for index, (line, column, part) in enumerate(
            zip(self.lines, columns, self.smoothed, strict=True)
        ):
            own = smooth(self.noise, line, column[:, :, -1:]).forces[:, :, 0]
            result.append(own - part.forces[:, :, :-1] @ step[self.grounds.unknowns(index)])
        return tuple(result)


def residual_forces(linear: Along) -> ResidualForces:
    """Smoother of all forces together."""
    return ResidualForces.of(linear.grounds, linear.noise, linear.joint)


def agreement(forces: Sequence[Series], signature: Sequence[np.ndarray]) -> float:
    """Correlation of residual forces and a signature, both in standard errors."""
    seen = np.concatenate([(s.values / s.std).ravel() for s in forces])
    expected = np.concatenate(
        [(part / s.std).ravel() for part, s in zip(signature, forces, strict=True)]
    )
    size = np.linalg.norm(seen) * np.linalg.norm(expected)
    return float(seen @ expected / size) if size > 0 else 0.0
