"""The builder of a rigid body: numbers in, parts of a model out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from oed_sysid.errors import ModelError
from oed_sysid.physics import frames
from oed_sysid.physics.base import Effect, Force
from oed_sysid.physics.frames import (
    AXES,
    DEGREES,
    MOTIONS,
    VELOCITIES,
    Attitude,
    Matrix,
    cross,
    minus,
    plus,
    times,
)
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.rigid_body import FOSSEN, Number, RigidBody
from oed_sysid.text import notation


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
        Which of ``x y z`` to carry as states; by default all that can change.

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
    active = _active(dof)
    oriented = _oriented(attitude, active)
    constants = _masses(mass, centre_of_gravity, inertia, active)
    # M_RB and M_A as texts; only constants that are not zero come into the equations.
    rigid = frames.rigid_matrix(constants.names)
    added = frames.added_matrix(_added_mass(constants, added_mass, active))
    axes = {AXES[VELOCITIES.index(v)]: v for v in active}
    # Rigid-body forces go with the velocity over ground, those of the water with the velocity
    # through it; a steady current turns in body axes.
    velocity = [v if v in active else "0" for v in VELOCITIES]
    through = [f"{v}_r" if v in "uvw" and v != "0" else v for v in velocity]
    drift = [f"({v} - {v}_r)" if v in active else "0" for v in "uvw"]
    effects = [
        *_coriolis("rigid_body", rigid, velocity, "PH", axes),
        *_coriolis("added_mass", added, through, "AB", axes, drift),
    ]
    if metacentric_height is not None or heave_stiffness is not None:
        effects += _floating(constants, weight, metacentric_height, heave_stiffness, active)
    else:
        down = oriented.rotation[2]
        effects += _submerged(constants, weight, buoyancy, centre_of_buoyancy, down, axes)
    return RigidBody(
        velocities=active,
        axes=axes,
        kinematics=oriented.states | _positions(oriented, velocity, position),
        inertia=_inertia((rigid, added), axes),
        signals=oriented.signals | {f"{v}_r": v for v in active if v in "uvw"},
        effects=tuple(effects),
        parameters=tuple(constants.parameters),
        angles=oriented.angles,
        rotation=oriented.rotation,
        rigid=rigid,
        added=added,
    )


def _masses(
    mass: Number,
    centre: Sequence[Number],
    inertia: Sequence[Number] | Mapping[str, Number] | Number,
    active: Sequence[str],
) -> _Constants:
    """Mass, centre of gravity and moments of inertia under their standard names."""
    constants = _Constants()
    constants.add("m", mass, "kg", "mass")
    for letter, value in zip("xyz", _three("centre_of_gravity", centre), strict=True):
        constants.add(f"{letter}_G", value, "m", "centre of gravity", optional=True)
    for pair, value in _moments(inertia, active).items():
        constants.add(f"I_{pair}", value, "kg m^2", "inertia about the origin", optional=True)
    return constants


def _oriented(attitude: str, active: Sequence[str]) -> Attitude:
    """The attitude as Euler angles or as a quaternion."""
    if attitude not in ("euler", "quaternion"):
        raise ModelError(f"Attitude {attitude!r} is not known. Choose 'euler' or 'quaternion'.")
    if attitude == "euler":
        return frames.euler(active)
    if not {"p", "q", "r"} <= set(active):
        raise ModelError("A quaternion needs roll, pitch and yaw. Use attitude='euler' here.")
    return frames.quaternion()


def _positions(
    oriented: Attitude, velocity: Sequence[str], wanted: Sequence[str] | None
) -> dict[str, str]:
    """Rates of the positions in NED that are carried as states."""
    ground = {
        name: plus(*(times(e, v) for e, v in zip(row, velocity[:3], strict=True)))
        for name, row in zip("xyz", oriented.rotation, strict=True)
    }
    moving = [name for name, rate in ground.items() if rate != "0"]
    names = moving if wanted is None else wanted
    if unknown := [name for name in names if name not in moving]:
        raise ModelError(f"Position {unknown[0]!r} does not change; it has {', '.join(moving)}.")
    return {name: ground[name] for name in names}


class _Constants:
    """Parameters as they come, under their standard names."""

    def __init__(self) -> None:
        self.parameters: list[Parameter] = []

    @property
    def names(self) -> dict[str, float]:
        return {p.name: p.value for p in self.parameters}

    def add(
        self, name: str, value: Number, unit: str, words: str, *, optional: bool = False
    ) -> str:
        """Keep a constant and return its name; an optional zero is left out."""
        if isinstance(value, Parameter):
            self.parameters.append(replace(value, name=name, unit=value.unit or unit))
        elif float(value) != 0.0 or not optional:
            self.parameters.append(
                Parameter(name, float(value), unit, fixed=True, description=words)
            )
        else:
            return "0"
        return name


def _active(dof: int | Sequence[str]) -> tuple[str, ...]:
    if isinstance(dof, int):
        if dof not in DEGREES:
            raise ModelError(f"{dof} degrees of freedom are not named. Choose 3, 4, 6 or names.")
        return tuple(DEGREES[dof])
    chosen = {MOTIONS.get(name, name) for name in dof}
    if unknown := sorted(chosen - set(VELOCITIES)):
        raise ModelError(f"Unknown motion {unknown[0]!r}. Choose among {', '.join(MOTIONS)}.")
    return tuple(v for v in VELOCITIES if v in chosen)


def _three(name: str, values: Sequence[Number]) -> Sequence[Number]:
    if len(values) != 3:
        raise ModelError(f"{name} has {len(values)} numbers; give x, y and z.")
    return values


def _moments(
    inertia: Sequence[Number] | Mapping[str, Number] | Number, active: Sequence[str]
) -> dict[str, Number]:
    """Moments and products of inertia by pair of letters."""
    known = ("xx", "yy", "zz", "xy", "xz", "yz")
    if isinstance(inertia, Mapping):
        if unknown := [key for key in inertia if key not in known]:
            raise ModelError(f"Inertia {unknown[0]!r} is not known. Choose {', '.join(known)}.")
        found = dict(inertia)
    elif isinstance(inertia, float | int | Parameter):
        turning = [pair for pair, rate in zip(known, "pqr", strict=False) if rate in active]
        if len(turning) != 1:
            raise ModelError(
                f"One moment of inertia for {len(turning)} rotations. Give (I_xx, I_yy, I_zz)."
            )
        found = {turning[0]: inertia}
    else:
        found = dict(zip(("xx", "yy", "zz"), _three("inertia", inertia), strict=True))
    for letters, rate in (("xx", "p"), ("yy", "q"), ("zz", "r")):
        value = found.get(letters, 0.0)
        size = value.value if isinstance(value, Parameter) else float(value)
        if rate in active and size <= 0.0:
            raise ModelError(f"I_{letters} is {size:g}; a free rotation needs one above zero.")
    return found


def _added_mass(
    constants: _Constants,
    given: Mapping[str, Number] | Sequence[Parameter],
    active: Sequence[str],
) -> list[str]:
    """Add the acceleration derivatives; return their names."""
    pairs = given.items() if isinstance(given, Mapping) else [(p.name, p) for p in given]
    places: dict[tuple[int, int], str] = {}
    for name, value in pairs:
        parsed = notation.parse(name)
        if not parsed.is_dot:
            raise ModelError(f"Added mass {name!r} is no acceleration derivative, as 'Y_vdot' is.")
        i, j = AXES.index(parsed.axis), VELOCITIES.index(parsed.factors[0].symbol)
        if VELOCITIES[i] not in active or VELOCITIES[j] not in active:
            raise ModelError(f"Added mass {name!r} does not belong to a body with {active}.")
        key = (min(i, j), max(i, j))
        size = value.value if isinstance(value, Parameter) else float(value)
        # M_A is symmetric for potential flow without forward speed: one of a pair says both.
        if key in places:
            raise ModelError(
                f"Added mass {places[key]!r} and {name!r} are the same entry of a symmetric "
                "matrix. Give one of the two."
            )
        # The acceleration derivatives are minus the added masses: Y_vdot = -A_22.
        if i == j and size > 0:
            raise ModelError(f"Added mass {name!r} is {size:g}; derivatives are negative.")
        places[key] = name
        constants.add(name, value, notation.unit(name), parsed.description)
    return list(places.values())


def _inertia(matrices: Sequence[Matrix], axes: Mapping[str, str]) -> dict[tuple[str, str], str]:
    entries: dict[tuple[str, str], str] = {}
    for matrix in matrices:
        for (i, j), text in matrix.items():
            for row, column in {(i, j), (j, i)}:
                key = (AXES[row], VELOCITIES[column])
                if key[0] in axes and key[1] in axes.values():
                    entries[key] = plus(entries.get(key, "0"), text)
    order = {key: n for n, key in enumerate((a, v) for a in AXES for v in VELOCITIES)}
    return dict(sorted(entries.items(), key=lambda item: order[item[0]]))


def _coriolis(
    name: str,
    matrix: Matrix,
    velocity: Sequence[str],
    letters: str,
    axes: Mapping[str, str],
    drift: Sequence[str] | None = None,
) -> list[Effect]:
    """Coriolis-centripetal forces of one inertia matrix as an effect, if there are any."""
    symbols = [f"{letter}_{axis}" for letter in letters for axis in "xyz"]
    definitions, forces = frames.gyroscopic(matrix, velocity, symbols)
    if drift is not None:
        turning = frames.current_rotation(matrix, velocity, drift)
        forces = [plus(force, extra) for force, extra in zip(forces, turning, strict=True)]
    terms = {
        axis: text for axis, text in zip(AXES, forces, strict=True) if axis in axes and text != "0"
    }
    if not terms:
        return []
    used = {n: t for n, t in definitions.items() if any(n in text for text in terms.values())}
    words = "momentum of the water" if drift is not None else "momentum of the body"
    return [
        Force(
            name,
            terms,
            definitions=used,
            description=f"{words} in turning axes",
            source=FOSSEN,
            amplitudes=(),
        )
    ]


def _submerged(
    constants: _Constants,
    weight: Number | None,
    buoyancy: Number | None,
    centre: Sequence[Number],
    down: Sequence[str],
    axes: Mapping[str, str],
) -> list[Effect]:
    """Weight and buoyancy at their centres, if it has a weight."""
    if weight is None:
        if buoyancy is not None:
            raise ModelError("This body has a buoyancy and no weight. Give both, or none.")
        return []
    heavy = constants.add("W", weight, "N", "weight")
    light = heavy if buoyancy is None else constants.add("B", buoyancy, "N", "buoyancy")
    levers = []
    for letter, value in zip("xyz", _three("centre_of_buoyancy", centre), strict=True):
        lever = constants.add(f"{letter}_B", value, "m", "centre of buoyancy", optional=True)
        gravity = f"{letter}_G" if f"{letter}_G" in constants.names else "0"
        # r_G W - r_B B, the lever of the restoring moment, section 4.1.
        levers.append(plus(times(gravity, heavy), minus(times(lever, light))))
    excess = "0" if light == heavy else f"({heavy} - {light})"
    six = [*(times(excess, part) for part in down), *cross(levers, down)]
    terms = {axis: t for axis, t in zip(AXES, six, strict=True) if axis in axes and t != "0"}
    return (
        [Force("restoring", terms, description="weight and buoyancy", source=FOSSEN, amplitudes=())]
        if terms
        else []
    )


def _floating(
    constants: _Constants,
    weight: Number | None,
    heights: Sequence[Number] | Number | None,
    stiffness: Number | None,
    active: Sequence[str],
) -> list[Effect]:
    """Metacentric moments and heave stiffness of a floating body."""
    terms: dict[str, str] = {}
    if heights is not None:
        if weight is None:
            raise ModelError("A metacentric height needs the weight: give weight=... in N.")
        heavy = constants.add("W", weight, "N", "weight")
        listed = [heights] if isinstance(heights, float | int | Parameter) else list(heights)
        sides = (("K", "p", "phi", "GM_T"), ("M", "q", "theta", "GM_L"))
        for height, (axis, rate, angle, name) in zip(listed, sides, strict=False):
            if rate in active:
                constants.add(name, height, "m", "metacentric height")
                # Metacentric stability, K = -W GM_T sin(phi): section 4.2, moderate angles.
                terms[axis] = f"-{heavy}*{name}*sin({angle})"
    if stiffness is not None:
        if "w" not in active:
            raise ModelError("A heave stiffness needs heave among the degrees of freedom.")
        terms["Z"] = f"-{constants.add('Z_z', stiffness, 'N/m', 'heave stiffness')}*z"
    if not terms:
        raise ModelError("Metacentric heights of a body that neither rolls nor pitches.")
    return [Force("restoring", terms, description="floating body", source=FOSSEN, amplitudes=())]
