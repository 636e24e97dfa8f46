"""Nomoto's indices from a sway-yaw model."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import DesignError
from oed_sysid.model import Model
from oed_sysid.sensitivity.linear import subsystem
from oed_sysid.simulation import Equilibrium


@dataclass(frozen=True)
class Nomoto:
    r"""Second-order steering model.

    .. math:: \frac{r}{\delta} = \frac{K (1 + T_3 s)}{(1 + T_1 s)(1 + T_2 s)}

    Attributes
    ----------
    gain : float
        K, 1/s; yaw rate per rudder angle.
    time_constants : tuple of float
        T1 (the larger in size) and T2, s; T1 is negative for a ship that does
        not keep its course.
    numerator_time : float
        T3, s.
    """

    gain: float
    time_constants: tuple[float, float]
    numerator_time: float

    @property
    def first_order_time(self) -> float:
        """T = T1 + T2 - T3 of the first-order model, s (Nomoto 1957)."""
        return sum(self.time_constants) - self.numerator_time

    def prime(self, length: float, speed: float) -> Nomoto:
        """Return the nondimensional indices: K L/V and T V/L."""
        ratio = length / speed
        first, second = self.time_constants
        return Nomoto(
            self.gain * ratio, (first / ratio, second / ratio), self.numerator_time / ratio
        )

    def report(self) -> str:
        """Return the indices in one line."""
        first, second = self.time_constants
        return (
            f"K = {self.gain:.4g} 1/s, T1 = {first:.4g} s, T2 = {second:.4g} s, "
            f"T3 = {self.numerator_time:.4g} s, T = {self.first_order_time:.4g} s"
        )


def nomoto(
    model: Model, point: Equilibrium, *, rudder: str, sway: str = "v", yaw: str = "r"
) -> Nomoto:
    """Reduce a model with sway and yaw to Nomoto's indices.

    Parameters
    ----------
    model : Model
        The model.
    point : Equilibrium
        Straight motion.
    rudder : str
        Input.
    sway, yaw : str
        States.

    References
    ----------
    K. Nomoto, T. Taguchi, K. Honda, S. Hirano, On the steering qualities of
    ships, *International Shipbuilding Progress* 4 (1957) 354-370.
    """
    if rudder not in model.input_names:
        raise DesignError(
            f"Model {model.name!r} has no input {rudder!r}. It has {', '.join(model.input_names)}."
        )
    matrix, columns = subsystem(model, point, (sway, yaw))
    return nomoto_of(matrix, columns[:, model.input_names.index(rudder)])


def nomoto_of(matrix: np.ndarray, column: np.ndarray) -> Nomoto:
    """Nomoto's indices of ``d(v, r)/dt = matrix (v, r) + column delta``.

    Examples
    --------
    The tanker Esso 190 000 dwt in the bis system, linearised at 80 rpm:

    >>> matrix = np.array([[-0.5965, -0.3723], [-3.661, -1.875]])
    >>> tanker = nomoto_of(matrix, np.array([0.1133, -0.8755]))
    >>> print(round(tanker.gain, 2), np.round(tanker.time_constants, 2))
    3.83 [-10.5    0.39]
    """
    determinant, trace = np.linalg.det(matrix), np.trace(matrix)
    if abs(determinant) < 1e-12 * max(1e-300, float(np.abs(matrix).max()) ** 2):
        raise DesignError(
            "The sway-yaw matrix is singular: the course is neither stable nor unstable, and the "
            "gain is not finite. Change the speed or a derivative slightly."
        )
    rate = matrix[1, 0] * column[0] - matrix[0, 0] * column[1]
    # (1 + T1 s)(1 + T2 s) = 1 - trace/det s + 1/det s^2
    roots = np.roots([1.0, trace / determinant, 1.0 / determinant])
    if np.abs(roots.imag).max() > 1e-9 * np.abs(roots).max():
        raise DesignError(
            "Sway and yaw oscillate together, so that T1 and T2 are complex. Use "
            "straight_line_stability for the poles."
        )
    times = sorted(roots.real, key=lambda value: -abs(value))
    return Nomoto(
        float(rate / determinant), (float(times[0]), float(times[1])), float(column[1] / rate)
    )
