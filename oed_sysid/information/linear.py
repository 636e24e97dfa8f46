"""Linear views of a model: stability on a straight course, Nomoto's indices.

Frequency responses are those of :func:`oed_sysid.experiments.simulation.linearise`, a
``control.StateSpace``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import DesignError, located
from oed_sysid.experiments.simulation import Equilibrium, linearise
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Report, Section, as_dict, as_text


@dataclass(frozen=True, eq=False)
class Stability:
    """Modes of a model on a straight course.

    Attributes
    ----------
    states : tuple of str
        States that take part; integrators (heading, position) are left out.
    poles : ndarray of complex
        1/s, least stable first.
    criterion : float
        Determinant of the sway-yaw matrix, 1/s2: above zero with a negative
        trace, the course is stable with fixed rudder.
    stable : bool
        Whether all poles have negative real parts.
    """

    states: tuple[str, ...]
    poles: np.ndarray
    criterion: float
    stable: bool

    def document(self) -> Report:
        """Return the modes in words."""
        title = (
            f"straight-line motion is {'stable' if self.stable else 'UNSTABLE'} with the controls "
            f"fixed (det A = {self.criterion:.4g} in {', '.join(self.states)})"
        )
        modes = tuple(_mode(pole) for pole in self.poles if pole.imag >= 0)
        return Report(title, sections=(Section("Modes", modes, indent=2),))

    report = as_text

    to_dict = as_dict()


def _mode(pole: complex) -> str:
    """A pole in words, 1/s."""
    if abs(pole.imag) > 1e-9:
        damping = -pole.real / abs(pole)
        return f"{pole.real:+.4g} +- {abs(pole.imag):.4g}j 1/s, damping ratio {damping:.3g}"
    lasting = f", time constant {-1 / pole.real:.4g} s" if pole.real else ""
    return f"{pole.real:+.4g} 1/s{lasting}"


def straight_line_stability(
    model: Model, point: Equilibrium, *, states: Sequence[str] = ("v", "r")
) -> Stability:
    """Poles of the motion that decides whether a course is kept.

    For sway and yaw the product of the poles is the criterion of straight-line
    stability, ``Y_v (N_r - m x_G u) - N_v (Y_r - m u) > 0`` over a positive
    determinant of the masses.

    Parameters
    ----------
    model : Model
        The model.
    point : Equilibrium
        Straight motion.
    states : sequence of str
        Velocities of the subsystem; ``("w", "q", "theta")`` in the diving plane.

    References
    ----------
    E. V. Lewis (ed.), *Principles of Naval Architecture*, SNAME (1989), vol.
    III, chapter IX, section 4.
    """
    matrix, _ = subsystem(model, point, states)
    poles = np.linalg.eigvals(matrix)
    # The least stable mode decides, so it comes first.
    poles = poles[np.argsort(-poles.real)]
    return Stability(
        tuple(states), poles, float(np.linalg.det(matrix)), bool(np.all(poles.real < 0))
    )


def subsystem(
    model: Model, point: Equilibrium, states: Sequence[str]
) -> tuple[np.ndarray, np.ndarray]:
    """Rows and columns of the linear model that belong to some states.

    Returns
    -------
    matrix : ndarray (n, n)
        In 1/s where the states have the same unit.
    inputs : ndarray (n, n_inputs)
    """
    linear = linearise(model, point)
    rows = located(DesignError, f"Model {model.name!r} has no state", states, linear.state_labels)
    return np.asarray(linear.A)[np.ix_(rows, rows)], np.asarray(linear.B)[rows]


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

    def document(self) -> Report:
        """Return the indices in one line."""
        first, second = self.time_constants
        return Report(
            f"K = {self.gain:.4g} 1/s, T1 = {first:.4g} s, T2 = {second:.4g} s, "
            f"T3 = {self.numerator_time:.4g} s, T = {self.first_order_time:.4g} s"
        )

    report = as_text


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
    lacking = f"Model {model.name!r} has no input"
    (column,) = located(DesignError, lacking, [rudder], model.input_names)
    matrix, columns = subsystem(model, point, (sway, yaw))
    return nomoto_of(matrix, columns[:, column])


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
    # K by Cramer's rule: the yaw rate of the steady turn at unit rudder, times the determinant.
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
