r"""What is random about a record: sensors, and forces that nobody measured.

For a record with states ``x``, outputs ``y`` and inputs ``u``

.. math::
    \dot x &= f(x, u, p) + G(x)\, w, \qquad
    w_j(t + \Delta) = \phi_j w_j(t) + \sqrt{1 - \phi_j^2}\, \sigma_j \epsilon,
    \quad \phi_j = e^{-\Delta/\tau_j} \\
    y_k &= h(x_k, p) + c_k + v_k

``w`` are first-order Gauss-Markov disturbances (level :math:`\sigma_j`, time :math:`\tau_j`),
``c`` coloured and ``v`` white errors of the sensors (Gelb 1974, *Applied optimal estimation*,
section 3.8). A :class:`NoiseModel` holds all levels and times; white noise alone is its simplest
case.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


@dataclass(frozen=True, eq=False)
class NoiseModel:
    """Standard deviations and correlation times of what disturbs a vehicle and its sensors.

    Attributes
    ----------
    white : ndarray (n_outputs,)
        White sensor noise, per sample, in the output's unit.
    colour : ndarray (n_outputs,)
        Coloured sensor noise (first-order Markov); zero where there is none.
    force : ndarray (n_forces,)
        Levels of the disturbances, in the unit of their place.
    colour_time, force_time : ndarray (n_outputs,), (n_forces,)
        Their correlation times, s; one number stands for all. Time zero is white from step
        to step.
    outputs, places : tuple of str
        Names, such as ``"q"`` and ``"force Z"`` or ``"actuator fin"``.
    """

    white: np.ndarray
    colour: np.ndarray
    force: np.ndarray
    colour_time: Any = 0.4
    force_time: Any = 1.0
    outputs: tuple[str, ...] = field(default=())
    places: tuple[str, ...] = field(default=())

    def __post_init__(self) -> None:
        for name, like in (("colour_time", self.white), ("force_time", self.force)):
            times = np.broadcast_to(np.asarray(getattr(self, name), dtype=float), like.shape)
            object.__setattr__(self, name, times.copy())

    @classmethod
    def white_only(cls, white: np.ndarray, outputs: Sequence[str] = ()) -> NoiseModel:
        """Noise of sensors that is white, and nothing else.

        >>> NoiseModel.white_only(np.array([0.1])).is_white
        True
        """
        white = np.asarray(white, dtype=float)
        return cls(white, np.zeros_like(white), np.zeros(0), outputs=tuple(outputs))

    @property
    def has_colour(self) -> bool:
        """Whether any sensor noise is coloured."""
        return bool(np.any(self.colour > 0))

    @property
    def has_forces(self) -> bool:
        """Whether any disturbance has a level above zero."""
        return bool(np.any(self.force > 0))

    @property
    def is_white(self) -> bool:
        """Whether nothing but white sensor noise is left."""
        return not (self.has_colour or self.has_forces)

    @property
    def sensors(self) -> np.ndarray:
        """Standard deviation of one measurement of each output, white and coloured together."""
        return np.hypot(self.white, self.colour)

    def with_levels(self, white: np.ndarray, colour: np.ndarray, force: np.ndarray) -> NoiseModel:
        """Return the same model with other levels."""
        return replace(self, white=white, colour=colour, force=force)

    def at_most(self, sensors: np.ndarray) -> NoiseModel:
        """Return the same model with sensors whose standard deviation is no larger than given."""
        share = np.minimum(1.0, sensors / np.maximum(self.sensors, 1e-300))
        return replace(self, white=share * self.white, colour=share * self.colour)

    def level(self, place: str) -> tuple[float, float]:
        """Level and time of the disturbance at one place; zero level where there is none."""
        if place not in self.places:
            return 0.0, np.nan
        index = self.places.index(place)
        return float(self.force[index]), float(self.force_time[index])

    def to_dict(self) -> dict[str, Any]:
        """Return the noise model as plain data for JSON."""
        sensors = zip(self.outputs, self.white, self.colour, self.colour_time, strict=True)
        forces = zip(self.places, self.force, self.force_time, strict=True)
        return {
            "sensors": {
                name: {"white": float(w), "colour": float(c), "time": float(t) if c else None}
                for name, w, c, t in sensors
            },
            "disturbances": {
                name: {"level": float(level), "time": float(t) if level else None}
                for name, level, t in forces
            },
        }
