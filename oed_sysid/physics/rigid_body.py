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

*What is mounted on it.* A force :math:`F` at the place :math:`r` has the moment
:math:`r \times F` about the origin. A fin of normal :math:`n` (the side to which a positive
angle lifts) sees the flow :math:`v_f = \nu_{r1} + \omega \times r` of its own place,

.. math:: F = L\,u_f (u_f\,\delta - v_f \cdot n)\,n - D\,u_f^2\delta^2\,e_x, \qquad
          L = \tfrac{\rho}{2} S\,C_{L\alpha},

the lift of a thin wing at small angles of attack; Prestero (2001), section 4.4.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.physics import frames
from oed_sysid.physics.base import Effect, Environment, Force, amplitude
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.physics.frames import (
    AXES,
    LABELS,
    SIZES,
    UNITS,
    VELOCITIES,
    Component,
    Matrix,
    Place,
    cross,
    minus,
    plus,
    text_of,
    times,
)
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.table import SNAME, hull_derivatives
from oed_sysid.text import expressions, notation

Number = float | Parameter

FOSSEN = "Fossen (2011), Handbook of marine craft hydrodynamics and motion control, Wiley."
PROPULSION = FOSSEN.replace("control,", "control, ch. 9,")
PRESTERO = "Prestero (2001), Verification of a six-degree of freedom simulation model, MIT."
NORMALS: Mapping[str, Place] = {"horizontal": (0, 0, -1), "vertical": (0, 1, 0)}


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
        plain = [n for n in self.kinematics if n not in (*frames.QUATERNION, *self.angles)]
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
            turned = frames.quaternion_of(phi, theta, psi)
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
        return thruster(
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
        return fin(
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
        return frames.coriolis_matrix(self.inertia_matrix(part), np.asarray(velocity, float))


# -- what is mounted on a body, and what measures it ------------------------------------


def placed(name: str, at: Sequence[float | Parameter]) -> tuple[list[str], list[Parameter]]:
    """Coordinates of a place as texts, and a parameter for each that is not zero."""
    if len(at) != 3:
        raise ModelError(f"{name!r} has the place {at!r}; give x, y and z in m.")
    texts, parameters = [], []
    for letter, value in zip("xyz", at, strict=True):
        if not isinstance(value, Parameter) and float(value) == 0.0:
            texts.append("0")
            continue
        if not isinstance(value, Parameter):
            value = Parameter(
                f"{letter}_{name}", float(value), "m", fixed=True, description=f"place of {name}"
            )
        parameters.append(value)
        texts.append(value.name)
    return texts, parameters


def thruster(
    name: str,
    thrust: str,
    *,
    axes: Sequence[str],
    at: Sequence[float | Parameter] = (0.0, 0.0, 0.0),
    direction: Place = (1, 0, 0),
    torque: str = "0",
    parameters: Sequence[Parameter] = (),
) -> Force:
    """Thrust at a place in a direction; see :meth:`RigidBody.thruster`.

    >>> thruster("port", "T_p", axes="XYN", at=(-1.0, -0.5, 0.0)).terms
    {'X': 'T_p', 'N': '-y_port*T_p'}
    """
    place, own = placed(name, at)
    along = [text_of(component) for component in direction]
    force = [times(thrust, component) for component in along]
    moment = [
        plus(lever, times(torque, component))
        for lever, component in zip(cross(place, force), along, strict=True)
    ]
    return Force(
        name,
        _on(axes, [*force, *moment], name),
        (*parameters, *own),
        description=f"thrust of {name}",
        source=PROPULSION,
        needs="several thrusts at several speeds",
        amplitudes=(),
    )


def fin(
    name: str,
    deflection: str,
    *,
    axes: Sequence[str],
    flow: Sequence[str],
    turning: Sequence[str],
    at: Sequence[float | Parameter],
    normal: str | Place,
    lift: float | Parameter,
    drag: float | Parameter | None = None,
) -> Force:
    """Lift and drag of a fin; see :meth:`RigidBody.fin`."""
    place, own = placed(name, at)
    if isinstance(normal, str) and normal not in NORMALS:
        raise ModelError(
            f"Fin {name!r} has the normal {normal!r}. Choose horizontal, vertical, or (x, y, z)."
        )
    side = [text_of(c) for c in (NORMALS[normal] if isinstance(normal, str) else normal)]
    # The fin sees the flow of its own place: the motion of the origin and what it is swept by.
    swept = cross(turning, place)
    ahead, *across = (plus(v, w) for v, w in zip(flow, swept, strict=True))
    u, v = f"{name}_u", f"{name}_v"
    into = plus(*(times(n, part) for n, part in zip(side[1:], across, strict=True)))
    slope = _coefficient(lift, f"L_{name}", "kg/m", f"lift slope of {name}")
    parameters = [slope]
    # u (u delta - v): lift at the small angle of attack delta - v/u times u squared.
    angle = plus(times(u, deflection), minus(v)) if into != "0" else times(u, deflection)
    push = times(slope.name, u, angle)
    force = [times(push, n) for n in side]
    if drag is not None:
        loss = _coefficient(drag, f"D_{name}", "kg/m", f"drag of a deflected {name}")
        parameters.append(loss)
        force[0] = plus(force[0], minus(times(loss.name, f"{u}**2", f"({deflection})**2")))
    return Force(
        name,
        _on(axes, [*force, *cross(place, force)], name),
        (*parameters, *own),
        definitions={u: ahead, v: into} if into != "0" else {u: ahead},
        description=f"lift{' and drag' if drag is not None else ''} of {name}",
        source=PRESTERO,
        needs=f"{deflection} of varied size at several speeds",
        amplitudes=tuple(p.name for p in parameters if not p.fixed),
    )


def _coefficient(value: float | Parameter, name: str, unit: str, words: str) -> Parameter:
    if isinstance(value, Parameter):
        return value
    return Parameter(name, float(value), unit, lower=0.0, description=words)


def _on(axes: Sequence[str], six: Sequence[Component], name: str) -> dict[str, str]:
    """Terms of the axes that a body has; none is an error."""
    terms = {
        axis: str(text)
        for axis, text in zip(AXES, six, strict=True)
        if axis in axes and text != "0"
    }
    if not terms:
        raise ModelError(
            f"{name!r} acts on none of the axes {', '.join(axes)} of this body. Check its "
            "direction."
        )
    return terms


def accelerometer_text(
    axis: str, active: Collection[str], at: Place, down: Sequence[str], gravity: float
) -> str:
    """Specific force along a body axis; ``down`` is the direction of gravity in body axes.

    >>> accelerometer_text("y", "uvr", (0.3, 0, 0), ("0", "0", "1"), 9.81)
    'dot(v) + r*u + dot(r)*0.3'
    """
    if axis not in ("x", "y", "z"):
        raise ModelError(f"An accelerometer along {axis!r} does not exist. Choose x, y or z.")
    i = "xyz".index(axis)

    def present(names: str) -> list[str]:
        return [name if name in active else "0" for name in names]

    def rates(names: str) -> list[str]:
        return [f"dot({name})" if name in active else "0" for name in names]

    place, spin, speed = [text_of(c) for c in at], present("pqr"), present("uvw")
    # Centripetal acceleration of the place where the instrument is.
    turning = cross(spin, cross(spin, place))
    parts = (rates("uvw"), cross(spin, speed), cross(rates("pqr"), place), turning)
    weight = "0" if gravity == 0 else minus(times(text_of(gravity), down[i]))
    return plus(*(part[i] for part in parts), weight)


def load_cell(
    name: str,
    axis: str,
    effect: str | None = None,
    *,
    unit: str = "N",
    noise_std: float | None = None,
) -> Output:
    """Force on an axis as a measured signal: of all effects, or of one.

    >>> load_cell("stock", "Y", "rudder").source
    'force("Y", "rudder")'
    """
    text = f'force("{axis}")' if effect is None else f'force("{axis}", "{effect}")'
    return Output(name, unit, f"measured force {axis}", text, noise_std=noise_std)
