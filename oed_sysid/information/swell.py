r"""Forces of a swell from its significant height, its period and where it comes from.

Waves that are long against the cross-section of a hull carry it along as they carry the water in
its place: the force is that of the displaced and the added mass in the water's acceleration
:math:`a` (Taylor's formula), and what the model's own hull and restoring forces :math:`f` make of
the water's velocity :math:`v` and of its slope and rise :math:`\eta`, taken relative to it,

.. math:: F = M a - \frac{\partial f}{\partial v} v - \frac{\partial f}{\partial \eta} \eta ,

with the inertia :math:`M` of the model, which holds the displaced mass since a vehicle floats or is
neutrally buoyant. Linear deep-water waves of the angular frequency :math:`\omega` and amplitude one
that run towards :math:`\chi` from the bow move the water at the mean depth :math:`h`, averaged over
the length :math:`L`, by

.. math::
    (u, v, w) &= \omega\, e^{-k h} \frac{\sin s}{s}\, (\cos\chi, \sin\chi, -i), \qquad
    k = \omega^2 / g, \quad s = \tfrac12 k L \cos\chi \\
    (p, q, r) &= \omega\, e^{-k h} \left(-k \sin\chi\, \frac{\sin s}{s},\;
    G k \cos\chi,\; -i\, G k \cos\chi \sin\chi\right), \qquad
    G = \frac{3 (\sin s - s \cos s)}{s^3}

Angular rates are those of the straight line through the velocities along the length that is
nearest in least squares. With :math:`H_s = 4\sigma` a level is :math:`|F| H_s / 4`. At the speed
:math:`U` waves are met at :math:`\omega - k U \cos\chi`.

It leaves out: diffraction by hulls that are no longer small against the waves (length over five
beams at least), damping by the water's rotation, shallow water, and that the forces of one wave
belong together: every equation gets a draw of its own. A fit of a record in such waves knows more.

References
----------
G. I. Taylor, The forces on a body placed in a curved or converging stream of fluid, *Proc. Royal
Society A* 120 (1928) 260-283. J. N. Newman, *Marine hydrodynamics*, MIT Press (1977), sections 4.17
and 6.4. O. M. Faltinsen, *Sea loads on ships and offshore structures* (1990), chapters 2 and 3.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import cos, exp, pi, radians, sin
from typing import Any

import numpy as np

from oed_sysid.errors import DesignError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import trajectory_of
from oed_sysid.experiments.steady import Equilibrium, linearise
from oed_sysid.likelihood.disturbances import chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.noise_model import Sea
from oed_sysid.physics.model import Model

GRAVITY = 9.81  # m/s2
_VELOCITIES = ("u", "v", "w")
_RATES = ("p", "q", "r")
_FORM = "swell=0.3m,8s,030deg"
_QUANTITY = re.compile(r"([-+]?[\d.]+)\s*(m/s|m|s|deg|)")


@dataclass(frozen=True)
class Swell:
    """A swell as people state it, and what its forces depend on besides.

    Parameters
    ----------
    height : float
        Significant height, m.
    period : float
        Of the peak, s.
    direction : float
        From where it comes, clockwise from the bow when a run begins, rad.
    bandwidth : float
        See :class:`~oed_sysid.likelihood.noise_model.Sea`.
    length, draught, speed : float, optional
        Of the vehicle, m and m/s, where neither model nor runs tell.
    """

    height: float
    period: float
    direction: float
    bandwidth: float
    length: float | None = None
    draught: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        sizes = (self.height, self.period, self.length, self.draught)
        if not all(size is None or size > 0 for size in sizes):
            raise DesignError(f"{self} has a size that is not above zero. Correct it.")

    @classmethod
    def of(cls, text: str, known: Mapping[str, float | None]) -> Swell:
        """Return the swell of ``swell=0.3m,8s,030deg``, followed by ``length=7`` and the like.

        Parameters
        ----------
        text : str
        known : mapping of str to float
            What counts where ``text`` says nothing; the bandwidth at least.

        Examples
        --------
        >>> found = Swell.of("swell=0.3m,8s,030deg,length=7", {"bandwidth": 0.2})
        >>> found.height, found.period, round(found.direction, 3), found.length
        (0.3, 8.0, 0.524, 7.0)
        """
        first, *rest = (part.strip() for part in text.removeprefix("swell=").split(","))
        given: dict[str, Any] = dict(known)
        by_unit = {"m": "height", "s": "period", "deg": "direction"}
        more = {"bandwidth": "", "length": "m", "draught": "m", "speed": "m/s"}
        for part in (first, *rest):
            name, _, words = part.rpartition("=")
            found = _QUANTITY.fullmatch(words.strip())
            unit = found[2] if found else None
            key = name.strip() if name else by_unit.get(unit or "", "")
            fits = unit in ("", more.get(key)) if name else bool(key)
            if found is None or not fits or (name and key not in more):
                raise DesignError(
                    f"{part!r} in the sea {text!r} is not understood. Write {_FORM}: significant "
                    "height, peak period, and from where it comes, clockwise from the bow; then "
                    f"what else is known of {', '.join(more)}, such as length=7."
                )
            given[key] = float(found[1])
        if missing := [f"its {key}, in {u}" for u, key in by_unit.items() if key not in given]:
            raise DesignError(f"The sea {text!r} lacks {' and '.join(missing)}. Write {_FORM}.")
        return cls(**{**given, "direction": radians(given["direction"])})

    def sea(self, model: Model, runs: Sequence[Experiment]) -> Sea:
        """Return its narrow-band forces on a model in the equations in which forces may act.

        Parameters
        ----------
        model : Model
        runs : sequence of Experiment
            The mean speed and depth of their nominal motion count, and the commands of the first.

        Raises
        ------
        DesignError
            If length, draught or speed are known neither from the model nor from the runs, or an
            equation is that of no velocity.
        """
        place = chosen_places(model, "all")
        axes = [model.axes.get(one.signal, one.signal) for one in place]
        if unknown := [name for name in axes if name not in (*_VELOCITIES, *_RATES)]:
            raise DesignError(
                f"A height of waves becomes forces on velocities u, v, w, p, q, r; model "
                f"{model.name!r} has an equation of {unknown[0]!r}. Give levels by equation."
            )
        straight, commands = _straight(model, runs)
        speed = straight.get("u")
        if speed is None:
            speed = self._known(model, "speed", self.speed, "speed=1.5")
        depth = straight.get("z", 0.0)
        if not depth > 0:
            depth = 0.5 * self._known(model, "draught", self.draught, "draught=0.4")
        water = self._water(self._known(model, "length", self.length, "length=7"), depth)
        wide = with_disturbance_inputs(model, place)
        given = [*map(float, commands), *(0.0 for _ in place)]
        point = dict(zip(wide.input_names, given, strict=True))
        linear = linearise(wide, Equilibrium(straight, point, {}, (), (), True, "straight ahead"))
        states = list(linear.state_labels)
        # What the water does to each state, and which of them the forces take relative to it.
        moved = {name: water.get(name, 0.0) for name in states if name not in _RATES}
        rows = [states.index(name) for name in axes]
        rate = np.array([2j * pi / self.period * water[name] for name in axes])
        rate -= np.asarray(linear.A)[rows] @ np.array([moved.get(name, 0.0) for name in states])
        by_force = np.asarray(linear.B)[rows, len(model.inputs) :]
        level = np.abs(np.linalg.solve(by_force, rate)) * self.height / 4.0
        # What is nothing by symmetry is nothing but for rounding.
        dust = 1e-12 * float(level.max(initial=0.0))
        acting = {p.name: float(one) for p, one in zip(place, level, strict=True) if one > dust}
        return Sea(
            self._met(speed), self.bandwidth, acting, height=self.height, direction=self.direction
        )

    def _met(self, speed: float) -> float:
        """Period at which a vehicle meets the waves, s."""
        omega = 2.0 * pi / self.period
        met = abs(omega - omega**2 / GRAVITY * speed * cos(self.direction + pi))
        if not met > 1e-9 * omega:
            raise DesignError(
                f"At {speed:g} m/s the vehicle runs as fast as waves of {self.period:g} s: it does "
                "not meet them. Choose another heading."
            )
        return 2.0 * pi / met

    def _water(self, length: float, depth: float) -> dict[str, complex]:
        """Motion of the water by state for waves of amplitude one."""
        omega, k = 2.0 * pi / self.period, (2.0 * pi / self.period) ** 2 / GRAVITY
        ahead, across = -cos(self.direction), -sin(self.direction)
        along = k * ahead
        s = 0.5 * along * length
        mean = float(np.sinc(s / pi))
        # The series near zero, where the quotient loses its digits.
        slope = 3.0 * (sin(s) - s * cos(s)) / s**3 if abs(s) > 1e-2 else 1.0 - s**2 / 10.0
        size = omega * exp(-k * depth)
        found: dict[str, complex] = {
            "u": size * mean * ahead,
            "v": size * mean * across,
            "w": -1j * size * mean,
            "p": -size * mean * k * across,
            "q": size * slope * along,
            "r": -1j * size * slope * along * across,
        }
        # Displacements: slope of the surface and its rise.
        pairs = {"phi": "p", "theta": "q", "z": "w"}
        return found | {name: found[rate] / (1j * omega) for name, rate in pairs.items()}

    def _known(self, model: Model, what: str, given: float | None, example: str) -> float:
        """A size of the vehicle: said, or a constant of the model that is described as such."""
        if given is not None:
            return given
        for one in model.all_parameters:
            if one.fixed and one.description.startswith(what):
                return one.value
        raise DesignError(
            f"A height of waves becomes forces with the vehicle's {what}, which neither problem "
            f"nor model {model.name!r} states. Add it to the sea: {_FORM},{example}; or give "
            "levels by equation, or the fit of a record in such waves."
        )


def _straight(model: Model, runs: Sequence[Experiment]) -> tuple[dict[str, float], np.ndarray]:
    """State straight ahead at the mean speed and depth of the nominal motion; first commands."""
    nominal = [trajectory_of(model, run) for run in runs]
    mean = {
        name: float(np.mean([run.signal(name).mean() for run in nominal])) * (name in ("u", "z"))
        for name in nominal[0].state_names
    }
    return mean, nominal[0].inputs[0]
