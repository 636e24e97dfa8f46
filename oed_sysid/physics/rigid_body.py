r"""Equations of motion of a rigid body in water, with three to six degrees of freedom.

.. math::

    (M_{RB} + M_A)\,\dot\nu = -C_{RB}(\nu)\,\nu - C_A(\nu_r)\,\nu_r - g(\eta)
        + M_A \begin{pmatrix} -\omega \times v_c \\ 0 \end{pmatrix} + \tau

Velocities ``u v w p q r`` are in body axes (x forward, y to starboard, z down) about
an origin of the user's choice, positions in NED. ``u_r v_r w_r`` is the velocity through
the water; with a steady current :math:`v_c = \nu_1 - \nu_{r1}` the added inertia carries the
term of turning axes: a vehicle that drifts with the water moves as in still water.

Weight and buoyancy act along the third row of the rotation matrix, at the centres of
gravity and buoyancy; a floating body has :math:`K = -W\,\overline{GM}_T \sin\varphi`.

References
----------
Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley: sections
2.2 (attitude), 3.3 (rigid body), 4.1 and 4.2 (restoring), 6.3 (added mass), 8.3 (current).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.physics import appendages, attitude
from oed_sysid.physics import momentum as inertial
from oed_sysid.physics.base import Effect, Environment, Force, amplitude
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.model import Model
from oed_sysid.physics.momentum import VELOCITIES, Matrix
from oed_sysid.physics.motions import LABELS, SIZES, UNITS
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.sensing import accelerometer_text
from oed_sysid.physics.table import SNAME, hull_derivatives
from oed_sysid.physics.texts import Place, minus, plus, times
from oed_sysid.text import expressions, notation

Number = float | Parameter

FOSSEN = "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley."


@dataclass(frozen=True)
class RigidBody:
    """Parts of a model that a rigid body in water brings.

    Made by :func:`~oed_sysid.physics.rigid_body`.

    Attributes
    ----------
    velocities : tuple of str
        The degrees of freedom, among ``u v w p q r``.
    axes : dict of str to str
        ``axis -> velocity``.
    kinematics, inertia, signals : dict
        As a :class:`~oed_sysid.physics.model.Model` takes them.
    effects : tuple of Effect
        Coriolis-centripetal, added-mass and restoring forces.
    parameters : tuple of Parameter
        Masses, centres and added masses.
    angles : dict of str to str
        Roll, pitch and yaw as expressions of the states.
    rotation : tuple of tuple of str
        Rotation matrix from body axes to NED, as texts.
    """

    velocities: tuple[str, ...]
    axes: Mapping[str, str]
    kinematics: Mapping[str, str]
    inertia: Mapping[tuple[str, str], str]
    signals: Mapping[str, str]
    effects: tuple[Effect, ...]
    parameters: tuple[Parameter, ...]
    angles: Mapping[str, str]
    rotation: tuple[tuple[str, ...], ...]
    rigid: Matrix
    added: Matrix

    # -- a model -------------------------------------------------------------------

    def states(self, scales: Mapping[str, float] | None = None) -> tuple[State, ...]:
        """Velocities, then attitude and position, with typical sizes."""
        sizes = SIZES | dict(scales or {})
        names = (*self.velocities, *self.kinematics)
        return tuple(
            State(name, UNITS[name], LABELS.get(name, "attitude"), sizes.get(name, 1.0))
            for name in names
        )

    def outputs(self, noise: Mapping[str, float | None] | None = None) -> tuple[Output, ...]:
        """Measured states; ``noise`` names which, with their standard deviation if known.

        By default everything is measured, a quaternion as roll, pitch and yaw (yaw between
        -180 and 180 degrees). ``e0 e1 e2 e3`` are the unit quaternion itself.
        """
        plain = [n for n in self.kinematics if n not in (*attitude.QUATERNION, *self.angles)]
        usual = [*self.velocities, *self.angles, *plain]
        wanted = dict.fromkeys(usual) if noise is None else dict(noise)
        whole = ("e0", "e1", "e2", "e3") if "de0" in self.kinematics else ()
        turned = {e: f"{e}/sqrt(e_norm)" for e in whole}
        seen = {**self.angles, **turned}
        known = [*usual, *turned]
        if unknown := [name for name in wanted if name not in known]:
            raise ModelError(
                f"This body has no {unknown[0]!r} to measure. It has {', '.join(known)}."
            )
        return tuple(
            Output(
                name,
                UNITS.get(name, "1"),
                LABELS.get(name, "attitude"),
                None if seen.get(name, name) == name else seen[name],
                noise_std=std,
            )
            for name, std in wanted.items()
        )

    def model(
        self,
        name: str,
        *,
        inputs: Sequence[Input],
        effects: Sequence[Effect] = (),
        outputs: Sequence[Output] | None = None,
        noise: Mapping[str, float | None] | None = None,
        actuators: Mapping[str, str] | None = None,
        signals: Mapping[str, str] | None = None,
        parameters: Sequence[Parameter] = (),
        scales: Mapping[str, float] | None = None,
        step: float = 0.1,
    ) -> Model:
        """Return a model of this body with what else acts on it.

        Parameters
        ----------
        name : str
            Name of the model.
        inputs : sequence of Input
            Commanded signals.
        effects : sequence of Effect
            Hull, thrusters, fins and the rest.
        outputs : sequence of Output, optional
            Further measured signals, such as :meth:`accelerometer`.
        noise : mapping, optional
            Which motions are measured, and with what noise; see :meth:`outputs`.
        actuators, signals, parameters, step
            As of :class:`~oed_sysid.physics.model.Model`; signals come after the body's.
        scales : mapping, optional
            Typical sizes of states, where the defaults do not fit.
        """
        return Model(
            name,
            self.states(scales),
            tuple(inputs),
            (*self.outputs(noise), *(outputs or ())),
            kinematics=self.kinematics,
            axes=self.axes,
            inertia=self.inertia,
            actuators=actuators or {},
            signals={**self.signals, **(signals or {})},
            effects=(*self.effects, *effects),
            parameters=(*self.parameters, *parameters),
            step=step,
        )

    def start(
        self, *, phi: float = 0.0, theta: float = 0.0, psi: float = 0.0, **motion: float
    ) -> dict[str, float]:
        """Initial states from velocities, positions and Euler angles (rad).

        >>> from oed_sysid.physics.bodies import rigid_body
        >>> body = rigid_body(6, mass=10.0, inertia=(1, 2, 3), attitude="quaternion")
        >>> body.start(u=1.5, theta=0.0)["de0"]
        0.0
        """
        given = {"phi": phi, "theta": theta, "psi": psi}
        if "de0" in self.kinematics:
            turned = attitude.quaternion_of(phi, theta, psi)
        else:
            turned = {name: given[name] for name in self.angles}
            lost = [name for name, value in given.items() if value and name not in turned]
            if lost:
                raise ModelError(f"This body has no {lost[0]}: it has {', '.join(turned)}.")
        known = (*self.velocities, *self.kinematics)
        if unknown := [name for name in motion if name not in known]:
            raise ModelError(f"This body has no state {unknown[0]!r}: it has {', '.join(known)}.")
        return {**motion, **turned}

    # -- what acts on it -----------------------------------------------------------

    def hull(
        self,
        coefficients: Mapping[str, Number] | Sequence[Parameter],
        *,
        name: str = "hull",
        source: str = SNAME,
    ) -> Force:
        """Hull forces by hydrodynamic derivatives, such as ``{"Z_absww": -131.0}``.

        Velocities are those through the water. Numbers become free parameters.
        """
        listed = (
            [
                value if isinstance(value, Parameter) else Parameter(key, float(value))
                for key, value in coefficients.items()
            ]
            if isinstance(coefficients, Mapping)
            else list(coefficients)
        )
        for parameter in listed:
            parsed = notation.parse(parameter.name)
            missing = [
                factor.symbol
                for factor in parsed.factors
                if factor.symbol in VELOCITIES and factor.symbol not in self.velocities
            ]
            if parsed.axis not in self.axes or missing:
                raise ModelError(
                    f"Derivative {parameter.name!r} does not belong to a body with "
                    f"{' '.join(self.velocities)}."
                )
        return hull_derivatives(name, listed, symbols=self.flow, source=source)

    def thruster(
        self,
        name: str,
        thrust: str,
        *,
        at: Sequence[Number] = (0.0, 0.0, 0.0),
        direction: Place = (1, 0, 0),
        torque: str = "0",
        parameters: Sequence[Parameter] = (),
    ) -> Force:
        """Thruster at a place, along a direction in body axes.

        Parameters
        ----------
        name : str
            Name of the effect; coordinates become fixed parameters ``x_name`` ...
        thrust : str
            Thrust in N as an expression, for instance ``"T"`` or
            ``"T_nn*n*abs(n) + T_nu*abs(n)*u_r"``.
        at : sequence of float or Parameter
            x, y and z of the place in m.
        direction : sequence of float or str
            Unit vector; texts such as ``("cos(alpha)", "sin(alpha)", 0)`` turn it.
        torque : str
            Reaction of the propeller on the body about ``direction``, in N m.
        parameters : sequence of Parameter
            Those that ``thrust`` and ``torque`` introduce.
        """
        return appendages.thruster(
            name,
            thrust,
            axes=tuple(self.axes),
            at=at,
            direction=direction,
            torque=torque,
            parameters=parameters,
        )

    def fin(
        self,
        name: str,
        deflection: str,
        *,
        at: Sequence[Number],
        normal: str | Place,
        lift: Number,
        drag: Number | None = None,
    ) -> Force:
        r"""Fin or rudder: lift at small angles of attack, drag of its deflection.

        Parameters
        ----------
        name : str
            Name of the effect.
        deflection : str
            Signal of the angle in rad; ``"0"`` for a fixed fin.
        at : sequence of float or Parameter
            x, y and z of its centre of pressure in m.
        normal : "horizontal", "vertical" or sequence of float
            Side to which a positive angle lifts: up for a horizontal fin, to
            starboard for a vertical one, or a vector without x component.
        lift : float or Parameter
            :math:`\frac{\rho}{2} S\,C_{L\alpha}` in kg/m.
        drag : float or Parameter, optional
            Drag per :math:`u^2\delta^2` in kg/m.
        """
        turning = [rate if rate in self.velocities else "0" for rate in "pqr"]
        flow = [f"{v}_r" if v in self.velocities else "0" for v in "uvw"]
        return appendages.fin(
            name,
            deflection,
            axes=tuple(self.axes),
            flow=flow,
            turning=turning,
            at=at,
            normal=normal,
            lift=lift,
            drag=drag,
        )

    def current(
        self,
        name: str = "current",
        *,
        north: float = 0.0,
        east: float = 0.0,
        down: float | None = None,
        scale: float = 0.3,
    ) -> Environment:
        """Steady current in NED; ``down`` is left out unless it is given."""
        speeds = {"north": north, "east": east, "down": down}
        sizes = {
            side: amplitude(f"{name}_{side}", "m/s", scale=scale, value=value, bound=3.0)
            for side, value in speeds.items()
            if value is not None
        }
        terms = {}
        for column, velocity in enumerate("uvw"):
            if velocity in self.velocities:
                seen = [
                    minus(times(sizes[side].name, self.rotation[row][column]))
                    for row, side in enumerate(speeds)
                    if side in sizes
                ]
                terms[f"{velocity}_r"] = plus(f"{velocity}_r", *seen)
        return Environment(
            name,
            terms,
            tuple(sizes.values()),
            description="steady current",
            source=FOSSEN,
            needs="position or velocity over ground, on several headings (a turning circle)",
        )

    # -- what measures it ----------------------------------------------------------

    def accelerometer(
        self,
        name: str,
        axis: str,
        *,
        at: Place = (0, 0, 0),
        gravity: float = 9.80665,
        noise_std: float | None = None,
    ) -> Output:
        r"""Accelerometer along body axis ``"x"``, ``"y"`` or ``"z"``, in m/s².

        .. math:: f = \dot\nu_1 + \omega\times\nu_1 + \dot\omega\times r
                  + \omega\times(\omega\times r) - R^\top g

        Parameters
        ----------
        name : str
            Name of the output.
        axis : str
            Its direction.
        at : sequence of float or str
            Place in m; names of parameters are possible.
        gravity : float
            Acceleration of gravity; 0 where the instrument subtracts it.
        noise_std : float, optional
            Noise of the sensor.
        """
        text = accelerometer_text(
            axis, self.velocities, at, [self.rotation[2][i] for i in range(3)], gravity
        )
        return Output(name, "m/s^2", f"acceleration along {axis}", text, noise_std=noise_std)

    # -- numbers -------------------------------------------------------------------

    @property
    def flow(self) -> dict[str, str]:
        """Signals of the velocity through the water, ``{"u": "u_r", ...}``."""
        return {v: f"{v}_r" for v in "uvw" if v in self.velocities}

    def inertia_matrix(self, part: str = "total") -> np.ndarray:
        """Inertia about the origin, ``(6, 6)``: ``"rigid"``, ``"added"`` or their sum."""
        chosen = {"rigid": (self.rigid,), "added": (self.added,), "total": (self.rigid, self.added)}
        if part not in chosen:
            raise ModelError(f"Inertia has no part {part!r}. Choose {', '.join(chosen)}.")
        values = {p.name: p.value for p in self.parameters}
        matrix = np.zeros((6, 6))
        for entries in chosen[part]:
            for (i, j), text in entries.items():
                matrix[i, j] += float(expressions.to_numpy(text, values))
                matrix[j, i] = matrix[i, j]
        return matrix

    def coriolis_matrix(self, velocity: Sequence[float], part: str = "total") -> np.ndarray:
        """Skew Coriolis-centripetal matrix ``(6, 6)`` at a velocity ``(6,)``."""
        return inertial.coriolis_matrix(self.inertia_matrix(part), np.asarray(velocity, float))
