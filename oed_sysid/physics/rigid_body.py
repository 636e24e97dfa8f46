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
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError, located
from oed_sysid.physics import frames
from oed_sysid.physics.base import Effect, Environment, Force, amplitude
from oed_sysid.physics.channels import SAYS, Input, Output, State
from oed_sysid.physics.frames import Matrix, Place, Texts, cross, minus, plus, text_of, times
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.table import FOSSEN, SNAME, SOURCES, hull_derivatives
from oed_sysid.runtime.display import counted
from oed_sysid.text import expressions, notation

Number = float | Parameter

PROPULSION = FOSSEN.replace("control,", "control, ch. 9,")
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

    Examples
    --------
    What :func:`rigid_body` returns; see there.
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
        sizes = frames.SIZES | dict(scales or {})
        names = (*self.velocities, *self.kinematics)
        return tuple(
            State(
                name, frames.UNITS[name], frames.LABELS.get(name, "attitude"), sizes.get(name, 1.0)
            )
            for name in names
        )

    def outputs(self, noise: Mapping[str, float | None] | None = None) -> tuple[Output, ...]:
        """Measured states; ``noise`` names which, with their standard deviation if known.

        By default everything is measured, a quaternion as roll, pitch and yaw (yaw between
        -180 and 180 degrees). ``e0 e1 e2 e3`` are the unit quaternion itself.
        """
        plain = [n for n in self.kinematics if n not in (*frames.QUATERNION, *self.angles)]
        usual = [*self.velocities, *self.angles, *plain]
        whole = ("e0", "e1", "e2", "e3") if "de0" in self.kinematics else ()
        seen = {**self.angles, **{e: f"{e}/sqrt(e_norm)" for e in whole}}
        wanted = dict.fromkeys(usual) if noise is None else dict(noise)
        located(ModelError, "This body measures no", wanted, [*usual, *whole])
        return tuple(
            Output(
                name,
                frames.UNITS.get(name, "1"),
                frames.LABELS.get(name, "attitude"),
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
        if "de0" in self.kinematics:
            turned = frames.quaternion_of(phi, theta, psi)
        else:
            given = {"phi": phi, "theta": theta, "psi": psi}
            turning = [name for name, value in given.items() if value]
            located(ModelError, "This body has no angle", turning, self.angles)
            turned = {name: given[name] for name in self.angles}
        states = (*self.velocities, *self.kinematics)
        located(ModelError, "This body has no state", motion, states)
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
        listed = [_parameter(value, name, "", "") for name, value in _named(coefficients)]
        for parameter in listed:
            parsed = notation.parse(parameter.name)
            moving = {factor.symbol for factor in parsed.factors} & set(frames.VELOCITIES)
            if parsed.axis not in self.axes or not moving <= set(self.velocities):
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
        place, own = placed(name, at)
        along = [text_of(component) for component in direction]
        force = [times(thrust, component) for component in along]
        moment = [
            plus(lever, times(torque, component))
            for lever, component in zip(cross(place, force), along, strict=True)
        ]
        return Force(
            name,
            _on(self.axes, [*force, *moment], name),
            (*parameters, *own),
            description=f"thrust of {name}",
            source=PROPULSION,
            needs="several thrusts at several speeds",
            amplitudes=(),
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
        place, own = placed(name, at)
        if isinstance(normal, str):
            located(ModelError, f"Fin {name!r} has the normal", [normal], NORMALS)
        side = [text_of(c) for c in (NORMALS[normal] if isinstance(normal, str) else normal)]
        # The fin sees the flow of its own place: the motion of the origin and what it is swept by.
        flow, swept = self._present("uvw", "{}_r"), cross(self._present("pqr"), place)
        ahead, *across = (plus(v, w) for v, w in zip(flow, swept, strict=True))
        into = plus(*(times(n, part) for n, part in zip(side[1:], across, strict=True)))
        u, v = f"{name}_u", f"{name}_v" if into != "0" else "0"
        slope = _parameter(lift, f"L_{name}", "kg/m", f"lift slope of {name}", lower=0.0)
        parameters = [slope]
        # u (u delta - v): lift at the small angle of attack delta - v/u times u squared.
        push = times(slope.name, u, plus(times(u, deflection), minus(v)))
        force = [times(push, n) for n in side]
        if drag is not None:
            words = f"drag of a deflected {name}"
            loss = _parameter(drag, f"D_{name}", "kg/m", words, lower=0.0)
            parameters.append(loss)
            force[0] = plus(force[0], minus(times(loss.name, f"{u}**2", f"({deflection})**2")))
        return Force(
            name,
            _on(self.axes, [*force, *cross(place, force)], name),
            (*parameters, *own),
            definitions={u: ahead, v: into} if v != "0" else {u: ahead},
            description=f"lift{' and drag' if drag is not None else ''} of {name}",
            source=SOURCES["PRESTERO"],
            needs=f"{deflection} of varied size at several speeds",
            amplitudes=tuple(p.name for p in parameters if not p.fixed),
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
            rows = zip(speeds, self.rotation, strict=True)
            seen = [times(sizes[side].name, row[column]) for side, row in rows if side in sizes]
            if velocity in self.velocities:
                terms[f"{velocity}_r"] = plus(f"{velocity}_r", *map(minus, seen))
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
        (i,) = located(ModelError, "There is no accelerometer along", [axis], "xyz")
        place, spin = [text_of(c) for c in at], self._present("pqr")
        turn = self._present("pqr", "dot({})")
        parts = (
            self._present("uvw", "dot({})"),
            cross(spin, self._present("uvw")),
            cross(turn, place),
            cross(spin, cross(spin, place)),  # centripetal, of the place of the instrument
        )
        weight = "0" if gravity == 0 else minus(times(text_of(gravity), self.rotation[2][i]))
        text = plus(*(part[i] for part in parts), weight)
        return Output(name, "m/s^2", f"acceleration along {axis}", text, noise_std=noise_std)

    # -- numbers -------------------------------------------------------------------

    def _present(self, names: str, form: str = "{}") -> list[str]:
        """Motions as texts, zero where the body has none."""
        return [form.format(name) if name in self.velocities else "0" for name in names]

    @property
    def flow(self) -> dict[str, str]:
        """Signals of the velocity through the water, ``{"u": "u_r", ...}``."""
        return {v: f"{v}_r" for v in "uvw" if v in self.velocities}

    def inertia_matrix(self, part: str = "total") -> np.ndarray:
        """Inertia about the origin, ``(6, 6)``: ``"rigid"``, ``"added"`` or their sum."""
        chosen = {"rigid": (self.rigid,), "added": (self.added,), "total": (self.rigid, self.added)}
        located(ModelError, "Inertia has no part", [part], chosen)
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
    texts, parameters = ["0", "0", "0"], list[Parameter]()
    for i, value in enumerate(at):
        if isinstance(value, Parameter) or float(value) != 0.0:
            own = f"{'xyz'[i]}_{name}"
            parameters.append(_parameter(value, own, "m", f"place of {name}", fixed=True))
            texts[i] = parameters[-1].name
    return texts, parameters


def _named(given: Mapping[str, Number] | Sequence[Parameter]) -> list[tuple[str, Number]]:
    """Numbers or parameters with their names; one may be there twice."""
    return [*given.items()] if isinstance(given, Mapping) else [(one.name, one) for one in given]


def _parameter(value: Number, name: str, unit: str, words: str, **facts: Any) -> Parameter:
    """A parameter as it was given, or one that is made of a number."""
    if isinstance(value, Parameter):
        return value
    return Parameter(name, float(value), unit, description=words, **facts)


def _on(axes: Collection[str], six: Sequence[frames.Component], name: str = "") -> dict[str, str]:
    """Terms of the axes that a body has; none is an error of what has a name."""
    pairs = zip(frames.AXES, six, strict=True)
    terms = {axis: str(text) for axis, text in pairs if axis in axes and text != "0"}
    if name and not terms:
        raise ModelError(SAYS["no_axis"].format(name=name, axes=", ".join(axes)))
    return terms


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

    Returns
    -------
    Output
        A measured force.
    """
    text = f'force("{axis}")' if effect is None else f'force("{axis}", "{effect}")'
    return Output(name, unit, f"measured force {axis}", text, noise_std=noise_std)


# -- numbers in, parts of a model out ----------------------------------------------------


def rigid_body(
    dof: int | Sequence[str] = 6,
    *,
    mass: Number,
    inertia: Sequence[Number] | Mapping[str, Number] | Number,
    centre_of_gravity: Sequence[Number] = (0.0, 0.0, 0.0),
    added_mass: Mapping[str, Number] | Sequence[Parameter] = (),
    weight: Number | None = None,
    buoyancy: Number | None = None,
    centre_of_buoyancy: Sequence[Number] = (0.0, 0.0, 0.0),
    metacentric_height: Sequence[Number] | Number | None = None,
    heave_stiffness: Number | None = None,
    attitude: str = "euler",
    position: Sequence[str] | None = None,
) -> RigidBody:
    """Return the equations of motion of a rigid body in water.

    Every number becomes a fixed parameter of the standard name (``m``, ``x_G``,
    ``I_xx``, ``W``, ``B``, ``z_B``, ``GM_T``, ``Y_vdot`` ...); give a
    :class:`~oed_sysid.Parameter` to state bounds or a prior, or to free it.

    Parameters
    ----------
    dof : int or sequence of str
        3 (surge, sway, yaw), 4 (and roll), 6, or names such as
        ``("surge", "heave", "pitch")``. Angles of rotations that are left out are zero.
    mass : float or Parameter
        In kg.
    inertia : sequence, mapping or number
        Moments of inertia **about the origin** in kg m²: ``(I_xx, I_yy, I_zz)``, a
        mapping such as ``{"zz": 3.5, "xz": 0.1}`` with products of inertia, or one
        number where only one rotation is free.
    centre_of_gravity, centre_of_buoyancy : sequence
        x, y and z from the origin in m.
    added_mass : mapping or sequence of Parameter
        Acceleration derivatives such as ``{"Y_vdot": -35.5, "Y_rdot": 1.93}``, negative
        on the diagonal. Of a symmetric pair (``Y_rdot`` and ``N_vdot``) give one.
    weight, buoyancy : float or Parameter, optional
        In N; without a weight there is no restoring force. Without a buoyancy it
        equals the weight.
    metacentric_height : number or pair, optional
        Of a floating body: transverse, or transverse and longitudinal, in m; weight is
        then needed and buoyancy is not.
    heave_stiffness : float or Parameter, optional
        Of a floating body, in N/m.
    attitude : {"euler", "quaternion"}
        The latter has no singularity and needs all three rotations.
    position : sequence of str, optional
        Which of ``x y z`` to carry as states; by default all that can change, without the depth
        of a floating body that does not heave.

    Returns
    -------
    RigidBody
        Parts of a model; give them to :class:`~oed_sysid.physics.model.Model`.

    Raises
    ------
    ModelError
        If the parts do not fit together; the message says which.

    Examples
    --------
    >>> from oed_sysid import Input
    >>> body = rigid_body(
    ...     3, mass=23.8, inertia=1.76, centre_of_gravity=(0.046, 0, 0),
    ...     added_mass={"X_udot": -2.0, "Y_vdot": -10.0, "N_rdot": -1.0},
    ... )
    >>> boat = body.model(
    ...     "boat", inputs=[Input("T", "N"), Input("M_z", "N m")],
    ...     effects=[body.thruster("push", "T"), body.hull({"X_u": -0.7, "Y_v": -0.9})],
    ... )
    >>> print(next(line for line in boat.equations().splitlines() if "u' =" in line))
    (m - X_udot) u' = P_y r + A_y r - X_udot r (v - v_r) + T + X_u u_r
    """
    body = _Body(_active(dof))
    active, axes, oriented = body.active, body.axes, _oriented(attitude, body.active)
    body.add("m", mass, "kg", "mass")
    body.centre("gravity", centre_of_gravity)
    body.moments(inertia)
    # M_RB and M_A as texts; only constants that are not zero come into the equations.
    rigid = frames.rigid_matrix(body.names)
    added = frames.added_matrix(body.added_mass(added_mass))
    # Rigid-body forces go with the velocity over ground, those of the water with the velocity
    # through it; a steady current turns in body axes.
    velocity = [v if v in active else "0" for v in frames.VELOCITIES]
    through = [f"{v}_r" if v in "uvw" and v != "0" else v for v in velocity]
    drift = [f"({v} - {v}_r)" if v in active else "0" for v in "uvw"]
    floats = metacentric_height is not None or heave_stiffness is not None
    if floats:
        restoring = body.floating(weight, metacentric_height, heave_stiffness)
    else:
        restoring = body.submerged(weight, buoyancy, centre_of_buoyancy, oriented.rotation[2])
    positions = _positions(oriented, velocity, position)
    if position is None and floats and "w" not in active:
        # Without heave a heeled hull that sways would sink by its geometry alone.
        positions.pop("z", None)
    return RigidBody(
        velocities=active,
        axes=axes,
        kinematics=oriented.states | positions,
        inertia=_inertia((rigid, added), axes),
        signals=oriented.signals | {f"{v}_r": v for v in active if v in "uvw"},
        effects=(
            *body.coriolis("rigid_body", rigid, velocity, "PH"),
            *body.coriolis("added_mass", added, through, "AB", drift),
            *restoring,
        ),
        parameters=tuple(body.parameters),
        angles=oriented.angles,
        rotation=oriented.rotation,
        rigid=rigid,
        added=added,
    )


def _oriented(attitude: str, active: Sequence[str]) -> frames.Attitude:
    """The attitude as Euler angles or as a quaternion."""
    located(ModelError, "There is no attitude", [attitude], ("euler", "quaternion"))
    if attitude == "euler":
        return frames.euler(active)
    if not {"p", "q", "r"} <= set(active):
        raise ModelError("A quaternion needs roll, pitch and yaw. Use attitude='euler' here.")
    return frames.quaternion()


def _positions(oriented: frames.Attitude, velocity: Texts, wanted: Texts | None) -> dict[str, str]:
    """Rates of the positions in NED that are carried as states."""
    ground = {
        name: plus(*(times(e, v) for e, v in zip(row, velocity[:3], strict=True)))
        for name, row in zip("xyz", oriented.rotation, strict=True)
    }
    moving = [name for name, rate in ground.items() if rate != "0"]
    names = moving if wanted is None else wanted
    located(ModelError, "This body changes no position", names, moving)
    return {name: ground[name] for name in names}


def _active(dof: int | Sequence[str]) -> tuple[str, ...]:
    if isinstance(dof, int):
        if dof not in frames.DEGREES:
            raise ModelError(f"{dof} degrees of freedom are not named. Choose 3, 4, 6 or names.")
        return tuple(frames.DEGREES[dof])
    located(ModelError, "There is no motion", dof, (*frames.MOTIONS, *frames.VELOCITIES))
    chosen = {frames.MOTIONS.get(name, name) for name in dof}
    return tuple(v for v in frames.VELOCITIES if v in chosen)


def _size(value: Number) -> float:
    return value.value if isinstance(value, Parameter) else float(value)


class _Body:
    """A body on its way: its motions, its axes, and its constants under their standard names."""

    def __init__(self, active: tuple[str, ...]) -> None:
        self.active = active
        self.axes = {frames.AXES[frames.VELOCITIES.index(v)]: v for v in active}
        self.parameters: list[Parameter] = []

    @property
    def names(self) -> dict[str, float]:
        """Constants so far, by name."""
        return {p.name: p.value for p in self.parameters}

    def add(
        self, name: str, value: Number, unit: str, words: str, *, optional: bool = False
    ) -> str:
        """Keep a constant and return its name; an optional zero is left out."""
        if optional and not isinstance(value, Parameter) and float(value) == 0.0:
            return "0"
        made = _parameter(value, name, unit, words, fixed=True)
        self.parameters.append(replace(made, name=name, unit=made.unit or unit))
        return name

    def centre(self, of: str, values: Sequence[Number]) -> list[str]:
        """Keep the coordinates of the centre of gravity or buoyancy; return their names."""
        if len(values) != 3:
            raise ModelError(f"centre_of_{of} has {len(values)} numbers; give x, y and z.")
        names = [f"{letter}_{of[0].upper()}" for letter in "xyz"]
        words = f"centre of {of}"
        pairs = zip(names, values, strict=True)
        return [self.add(name, value, "m", words, optional=True) for name, value in pairs]

    def moments(self, inertia: Sequence[Number] | Mapping[str, Number] | Number) -> None:
        """Keep moments and products of inertia."""
        known = ("xx", "yy", "zz", "xy", "xz", "yz")
        turning = [pair for pair, rate in zip(known, "pqr", strict=False) if rate in self.active]
        if isinstance(inertia, Mapping):
            located(ModelError, "There is no inertia", inertia, known)
            found = dict(inertia)
        else:
            if isinstance(inertia, float | int | Parameter):
                values, pairs = [inertia], turning
            else:
                values, pairs = list(inertia), list(known[:3])
            if len(values) != len(pairs):
                raise ModelError(
                    f"{counted(len(values), 'moment')} of inertia for "
                    f"{counted(len(turning), 'rotation')}. Give (I_xx, I_yy, I_zz)."
                )
            found = dict(zip(pairs, values, strict=True))
        for pair in turning:
            if (size := _size(found.get(pair, 0.0))) <= 0.0:
                raise ModelError(f"I_{pair} is {size:g}; a free rotation needs one above zero.")
        for pair, value in found.items():
            self.add(f"I_{pair}", value, "kg m^2", "inertia about the origin", optional=True)

    def added_mass(self, given: Mapping[str, Number] | Sequence[Parameter]) -> list[str]:
        """Keep the acceleration derivatives; return their names."""
        places: dict[tuple[str, ...], str] = {}
        for name, value in _named(given):
            parsed = notation.parse(name)
            if not parsed.is_dot:
                raise ModelError(
                    f"Added mass {name!r} is no acceleration derivative, as 'Y_vdot' is."
                )
            moved = frames.VELOCITIES[frames.AXES.index(parsed.axis)], parsed.factors[0].symbol
            if not {*moved} <= {*self.active}:
                raise ModelError(
                    f"Added mass {name!r} does not belong to a body with {self.active}."
                )
            # M_A is symmetric for potential flow without forward speed: one of a pair says both.
            key = tuple(sorted(moved))
            if key in places:
                raise ModelError(SAYS["same_entry"].format(other=places[key], name=name))
            # The acceleration derivatives are minus the added masses: Y_vdot = -A_22.
            if moved[0] == moved[1] and (size := _size(value)) > 0:
                raise ModelError(f"Added mass {name!r} is {size:g}; derivatives are negative.")
            places[key] = name
            self.add(name, value, notation.unit(name), parsed.description)
        return list(places.values())

    def coriolis(
        self, name: str, matrix: Matrix, velocity: Texts, letters: str, drift: Texts | None = None
    ) -> list[Effect]:
        """Coriolis-centripetal forces of one inertia matrix as an effect, if there are any."""
        symbols = [f"{letter}_{axis}" for letter in letters for axis in "xyz"]
        definitions, forces = frames.gyroscopic(matrix, velocity, symbols)
        if drift is not None:
            turning = frames.current_rotation(matrix, velocity, drift)
            forces = [plus(force, extra) for force, extra in zip(forces, turning, strict=True)]
        terms = _on(self.axes, forces)
        if not terms:
            return []
        used = {n: t for n, t in definitions.items() if any(n in text for text in terms.values())}
        words = f"momentum of the {'body' if drift is None else 'water'} in turning axes"
        return [_of_body(name, terms, words, used)]

    def submerged(
        self, weight: Number | None, buoyancy: Number | None, centre: Sequence[Number], down: Texts
    ) -> list[Effect]:
        """Weight and buoyancy at their centres, if it has a weight."""
        if weight is None:
            if buoyancy is not None:
                raise ModelError("This body has a buoyancy and no weight. Give both, or none.")
            return []
        heavy = self.add("W", weight, "N", "weight")
        light = heavy if buoyancy is None else self.add("B", buoyancy, "N", "buoyancy")
        gravity = [name if name in self.names else "0" for name in ("x_G", "y_G", "z_G")]
        # r_G W - r_B B, the lever of the restoring moment, section 4.1.
        levers = [
            plus(times(one, heavy), minus(times(other, light)))
            for one, other in zip(gravity, self.centre("buoyancy", centre), strict=True)
        ]
        excess = "0" if light == heavy else f"({heavy} - {light})"
        six = [*(times(excess, part) for part in down), *cross(levers, down)]
        terms = _on(self.axes, six)
        return [_of_body("restoring", terms, "weight and buoyancy")] if terms else []

    def floating(
        self,
        weight: Number | None,
        heights: Sequence[Number] | Number | None,
        stiffness: Number | None,
    ) -> list[Effect]:
        """Metacentric moments and heave stiffness of a floating body."""
        terms: dict[str, str] = {}
        if heights is not None:
            if weight is None:
                raise ModelError("A metacentric height needs the weight: give weight=... in N.")
            heavy = self.add("W", weight, "N", "weight")
            listed = [heights] if isinstance(heights, float | int | Parameter) else list(heights)
            sides = (("K", "phi", "GM_T"), ("M", "theta", "GM_L"))
            for height, (axis, angle, name) in zip(listed, sides, strict=False):
                if axis in self.axes:
                    self.add(name, height, "m", "metacentric height")
                    # Metacentric stability, K = -W GM_T sin(phi): section 4.2, moderate angles.
                    terms[axis] = f"-{heavy}*{name}*sin({angle})"
        if stiffness is not None:
            if "Z" not in self.axes:
                raise ModelError("A heave stiffness needs heave among the degrees of freedom.")
            terms["Z"] = f"-{self.add('Z_z', stiffness, 'N/m', 'heave stiffness')}*z"
        if not terms:
            raise ModelError("Metacentric heights of a body that neither rolls nor pitches.")
        return [_of_body("restoring", terms, "floating body")]


def _inertia(matrices: Sequence[Matrix], axes: Mapping[str, str]) -> dict[tuple[str, str], str]:
    places = [(axis, v) for axis in axes for v in axes.values()]
    rows = [(frames.AXES.index(a), frames.VELOCITIES.index(v)) for a, v in places]
    texts = [
        plus(*(matrix[key] for matrix in matrices for key in {(i, j), (j, i)} if key in matrix))
        for i, j in rows
    ]
    return {place: text for place, text in zip(places, texts, strict=True) if text != "0"}


def _of_body(
    name: str, terms: Mapping[str, str], words: str, definitions: Mapping[str, str] | None = None
) -> Force:
    parts = definitions or {}
    return Force(name, terms, definitions=parts, description=words, source=FOSSEN, amplitudes=())
