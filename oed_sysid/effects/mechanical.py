r"""Mechanical effects of motors, joints and linkages: friction, play, cogging, hysteresis.

Dry friction is smooth here, :math:`\operatorname{sgn} v \approx \tanh(v/v_0)`, so that
gradients exist; within about :math:`v_0` of rest the model creeps instead of sticking.
Choose :math:`v_0` well below the velocities that matter and the integration step well
below :math:`m v_0 / F_c`.
"""

from __future__ import annotations

from oed_sysid.effects.amplitudes import amplitude
from oed_sysid.effects.base import ExtraState, Force
from oed_sysid.effects.drag import linear_damping
from oed_sysid.parameters import Parameter

ARMSTRONG = "Armstrong-Helouvry et al. (1994), A survey of models ... for machines with friction."
DAHL = "Dahl (1968), A solid friction model, Aerospace Corporation TOR-0158(3107-18)-1."
NORDIN = "Nordin & Gutman (2002), Controlling mechanical systems with backlash, Automatica 38."
MOTOR = "Hanselman (2006), Brushless permanent magnet motor design, ch. 10 (cogging)."
WEN = "Wen (1976), Method for random vibration of hysteretic systems, J. Eng. Mech. 102."


def coulomb_friction(
    name: str,
    axis: str,
    velocity: str,
    *,
    unit: str = "N",
    velocity_unit: str = "m/s",
    smooth: float = 0.01,
    scale: float = 1.0,
    value: float = 0.0,
) -> Force:
    r"""Dry friction, :math:`-E\tanh(v/v_0)`; ``smooth`` is :math:`v_0`.

    >>> coulomb_friction("dry", "X", "v").terms
    {'X': '-E_dry*tanh(v/v0_dry)'}
    """
    size = amplitude(name, unit, scale=scale, value=value)
    width = Parameter(f"v0_{name}", smooth, velocity_unit, fixed=True, description="smoothing")
    return Force(
        name,
        {axis: f"-{size.name}*tanh({velocity}/{width.name})"},
        (size, width),
        amplitudes=(size.name,),
        description=f"dry friction against {velocity}",
        source=ARMSTRONG,
        needs=f"slow and fast {velocity} in both directions",
    )


def stribeck_friction(
    name: str,
    axis: str,
    velocity: str,
    *,
    unit: str = "N",
    velocity_unit: str = "m/s",
    smooth: float = 0.01,
    stribeck: float = 0.1,
    scale: float = 1.0,
    value: float = 0.0,
) -> Force:
    r"""Extra friction near rest, :math:`-E e^{-(v/v_s)^2}\tanh(v/v_0)`.

    Added to :func:`coulomb_friction` it makes breakaway larger than sliding friction
    by ``E``; ``stribeck`` is :math:`v_s`, known unless its parameter is freed.
    """
    size = amplitude(name, unit, scale=scale, value=value)
    width = Parameter(f"v0_{name}", smooth, velocity_unit, fixed=True, description="smoothing")
    fades = Parameter(
        f"vs_{name}", stribeck, velocity_unit, lower=smooth, fixed=True, description="Stribeck"
    )
    fading = f"exp(-({velocity}/{fades.name})**2)"
    return Force(
        name,
        {axis: f"-{size.name}*{fading}*tanh({velocity}/{width.name})"},
        (size, width, fades),
        amplitudes=(size.name,),
        description=f"friction near rest is larger than when {velocity} is large",
        source=ARMSTRONG,
        needs=f"{velocity} that crosses zero slowly",
    )


def cogging(
    name: str,
    axis: str,
    angle: str,
    *,
    periods: int,
    unit: str = "N m",
    scale: float = 0.1,
) -> Force:
    r"""Cogging torque, :math:`E_c\cos n\vartheta + E_s\sin n\vartheta`, ``periods`` per turn."""
    parts = [amplitude(f"{name}_{part}", unit, scale=scale) for part in ("cos", "sin")]
    count = Parameter(f"n_{name}", float(periods), "1", fixed=True, description="periods per turn")
    cosine, sine = (part.name for part in parts)
    return Force(
        name,
        {
            axis: f"{cosine}*cos({count.name}*{angle}) + {sine}*sin({count.name}*{angle})",
        },
        (*parts, count),
        amplitudes=(cosine, sine),
        description=f"torque that repeats {periods} times a turn",
        source=MOTOR,
        needs="slow turning through many periods, in both directions",
    )


def dead_zone(
    name: str,
    axis: str,
    position: str,
    *,
    stiffness: float,
    unit: str = "m",
    stiffness_unit: str = "N/m",
    scale: float = 0.01,
    value: float = 0.0,
) -> Force:
    r"""Play in a spring: of a force :math:`-k x` the part within :math:`\pm E` is lost.

    The base model holds :math:`-k x` already; this adds :math:`k\,\mathrm{clip}(x, -E, E)`.
    """
    size = amplitude(name, unit, scale=scale, value=value, positive=True, description="half-width")
    spring = Parameter(f"k_{name}", stiffness, stiffness_unit, fixed=True, description="stiffness")
    return Force(
        name,
        {axis: f"{spring.name}*clip({position}, -{size.name}, {size.name})"},
        (size, spring),
        amplitudes=(size.name,),
        description=f"play of {position} within which the spring does not act",
        source=NORDIN,
        needs=f"small and large {position}",
    )


def dahl_friction(
    name: str,
    axis: str,
    velocity: str,
    *,
    stiffness: float,
    unit: str = "N",
    displacement_unit: str = "m",
    scale: float = 1.0,
    value: float = 0.0,
) -> Force:
    r"""Dry friction with memory (hysteresis), :math:`-E z`, :math:`\dot z = \sigma(v - |v| z)`.

    Presliding is elastic with stiffness :math:`E\sigma`; ``stiffness`` is :math:`\sigma`,
    the inverse of the displacement over which friction builds up.
    """
    size = amplitude(name, unit, scale=scale, value=value)
    rise = Parameter(
        f"sigma_{name}",
        stiffness,
        f"1/{displacement_unit}",
        lower=0.0,
        fixed=True,
        description="inverse of the presliding displacement",
    )
    bristle = f"z_{name}"
    rate = f"{rise.name}*({velocity} - abs({velocity})*{bristle})"
    return Force(
        name,
        {axis: f"-{size.name}*{bristle}"},
        (size, rise),
        states=(ExtraState(bristle, rate, "0", "1"),),
        amplitudes=(size.name,),
        description=f"dry friction against {velocity} that remembers its direction",
        source=DAHL,
        needs=f"reversals of {velocity}, small and large",
    )


def bouc_wen_hysteresis(
    name: str,
    axis: str,
    velocity: str,
    *,
    yielding: float,
    unit: str = "N",
    displacement_unit: str = "m",
    scale: float = 1.0,
    value: float = 0.0,
) -> Force:
    r"""Hysteretic restoring force of memory, :math:`-E z` with Bouc and Wen's rule.

    .. math:: \dot z = \bigl(v - \tfrac12(|v| |z| z + v z^2)\bigr)/x_y

    the case of equal shape constants and exponent two; ``yielding`` is :math:`x_y`, the
    displacement at which it yields, known unless its parameter is freed.
    """
    size = amplitude(name, unit, scale=scale, value=value)
    gives = Parameter(
        f"x_{name}", yielding, displacement_unit, lower=1e-6, fixed=True, description="yielding"
    )
    z, v = f"z_{name}", velocity
    rate = f"({v} - 0.5*(abs({v})*abs({z})*{z} + {v}*{z}**2))/{gives.name}"
    return Force(
        name,
        {axis: f"-{size.name}*{z}"},
        (size, gives),
        states=(ExtraState(z, rate, "0", "1"),),
        amplitudes=(size.name,),
        description=f"restoring force that remembers the path of {velocity}",
        source=WEN,
        needs=f"reversals of {velocity} of several sizes",
    )


def delayed_force(
    name: str,
    axis: str,
    signal: str,
    *,
    unit: str,
    start: str,
    delay: float = 1.0,
    scale: float = 1.0,
    value: float = 0.0,
) -> Force:
    r"""Force of what a state or signal was a while ago, :math:`E\,x(t - \tau)`.

    The delay is Padé's approximation of order 2,
    :math:`(1 - \tau s/2 + \tau^2 s^2/12)/(1 + \tau s/2 + \tau^2 s^2/12)`: exact in steady
    motion, within 1 % up to :math:`\omega\tau = 1.3`. ``start`` is its value before the
    record, an expression of the model's own states; ``unit`` is that of ``E``.
    """
    size = amplitude(name, unit, scale=scale, value=value)
    tau = Parameter(f"tau_{name}", delay, "s", lower=1e-3, fixed=True, description="delay")
    low, high = f"low_{name}", f"high_{name}"
    t = tau.name
    # low is the signal through 1/(1 + ts/2 + t2s2/12), high its rate times tau, and second
    # its second derivative times tau squared.
    second = f"12*({signal} - {low}) - 6*{high}"
    return Force(
        name,
        {axis: f"{size.name}*({low} - {high}/2 + ({second})/12)"},
        (size, tau),
        states=(
            ExtraState(low, f"{high}/{t}", start),
            ExtraState(high, f"({second})/{t}", "0"),
        ),
        amplitudes=(size.name,),
        description=f"force of {signal} as it was a while ago",
        source="Golub & Van Loan (2013), Matrix computations, 9.3 (Pade approximation).",
        needs=f"quick changes of {signal}",
    )


def mechanical_effects(
    axis: str = "K",
    position: str = "phi",
    velocity: str = "p",
    *,
    force: float,
    rotates: bool = True,
    speed: float = 1.0,
    stiffness: float | None = None,
    periods: int = 6,
) -> tuple[Force, ...]:
    """Candidate effects of a motor, joint or pendulum.

    Parameters
    ----------
    axis, position, velocity : str
        Names in the model.
    force : float
        Typical torque in N m (force in N where it does not rotate).
    rotates : bool
        Whether the position is an angle.
    speed : float
        Typical velocity in rad/s (m/s).
    stiffness : float, optional
        Of a spring that the model holds; only then a dead zone is among the candidates.
    periods : int
        Cogging periods per turn.
    """
    load, turn = ("N m", "rad/s") if rotates else ("N", "m/s")
    way = "rad" if rotates else "m"
    slow = 0.02 * speed
    found: list[Force] = [
        linear_damping("viscous_friction", axis, velocity, scale=0.2 * force / speed),
        coulomb_friction(
            "coulomb_friction",
            axis,
            velocity,
            unit=load,
            velocity_unit=turn,
            smooth=slow,
            scale=0.1 * force,
        ),
        stribeck_friction(
            "stribeck_friction",
            axis,
            velocity,
            unit=load,
            velocity_unit=turn,
            smooth=slow,
            stribeck=0.1 * speed,
            scale=0.1 * force,
        ),
        dahl_friction(
            "dahl_friction",
            axis,
            velocity,
            unit=load,
            displacement_unit=way,
            stiffness=50.0,
            scale=0.1 * force,
        ),
    ]
    if rotates:
        found.append(cogging("cogging", axis, position, periods=periods, scale=0.1 * force))
    if stiffness is not None:
        found.append(
            dead_zone(
                "dead_zone",
                axis,
                position,
                stiffness=stiffness,
                unit=way,
                stiffness_unit=f"{load}/{way}",
                scale=0.1 * force / stiffness,
            )
        )
    return tuple(found)
