"""What is simulated: random forces, and sensors that are not as declared."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

MEDIUM = (0.1, 0.3, 0.06)  # X [N], Z [N], M [N m]


@dataclass(frozen=True)
class Manoeuvre:
    """A zigzag: fin or rudder amplitude and switching angle in degrees, thrust in N.

    It turns when the measured angle plus ``lead`` (s) times its measured rate
    passes the switching angle; or, with a finite ``hold``, every so many seconds.
    """

    name: str
    amplitude: float
    switch: float
    thrust: float = 0.0
    duration: float | None = None
    lead: float = 0.0
    hold: float = math.inf


ZIGZAGS = (
    Manoeuvre("zigzag_5_5", 5.0, 5.0, 5.0),
    Manoeuvre("zigzag_10_10", 10.0, 10.0, 9.0),
    Manoeuvre("zigzag_15_12", 15.0, 12.0, 10.0),
)
CLOCKED = tuple(
    replace(zigzag, name=f"clocked_{i}", hold=hold)
    for i, (zigzag, hold) in enumerate(zip(ZIGZAGS, (3.5, 3.4, 3.3), strict=True))
)
CALM = tuple(Manoeuvre(f"calm_{i}", 1.0, 1.0, thrust) for i, thrust in enumerate((5.0, 9.0, 10.0)))
FRESH = Manoeuvre("zigzag_12_8", 12.0, 8.0, 8.0)
# An unstable vehicle turns before its pitch angle can no longer be caught.
STEADIED = tuple(
    Manoeuvre(f"steadied_{switch:g}", 15.0, switch, thrust, lead=2.0)
    for switch, thrust in ((28.0, 7.0), (34.0, 8.5), (40.0, 10.0), (34.0, 9.0))
)
GENTLE = (Manoeuvre("gentle", 2.0, 3.0, 9.0, 30.0),)
RUDDER = (
    Manoeuvre("zigzag_10_10", 10.0, 10.0),
    Manoeuvre("zigzag_20_20", 20.0, 20.0),
    Manoeuvre("zigzag_15_30", 15.0, 30.0),
)


@dataclass(frozen=True)
class Scenario:
    """One way in which vehicle and sensors are disturbed.

    Attributes
    ----------
    name, title : str
    vehicle : str
    records : tuple of Manoeuvre
        What is fitted to.
    fresh : Manoeuvre
        What is predicted.
    force : tuple of float
        Standard deviation of each random force.
    force_time : float
        Their time, s.
    swell : float or None
        The forces have a JONSWAP spectrum with this peak period instead, s.
    pole : float or None
        The vehicle is made unstable in pitch with this pole, 1/s.
    level : float
        Sensor noise over the declared one.
    colour : float
        First-order autoregressive coefficient of the noise of output ``coloured``.
    coloured : int
    spikes : float
        Share of samples with a spike of ``spike_size`` standard deviations.
    one_sided : bool
        All spikes go up.
    fin_noise : float
        White noise of the logged first input, deg.
    missing : float
        Share of samples that were not taken.
    dropped : float
        Share of rows that the log does not have: the sampling is irregular. A
        row in which the command changes is always there.
    hidden : bool
        The fitted model does not know the parameters that differ from record to record.
    may_flag : bool
        Wrong sensors: intervals hold, or the report says that they may not.
    """

    name: str
    title: str
    vehicle: str = "remus"
    records: tuple[Manoeuvre, ...] = ZIGZAGS
    fresh: Manoeuvre = FRESH
    force: tuple[float, ...] = (0.0, 0.0, 0.0)
    force_time: float = 2.0
    swell: float | None = None
    pole: float | None = None
    level: float = 1.0
    colour: float = 0.0
    coloured: int = 3
    spikes: float = 0.0
    spike_size: float = 10.0
    one_sided: bool = False
    fin_noise: float = 0.0
    missing: float = 0.0
    dropped: float = 0.0
    hidden: bool = False
    may_flag: bool = False


def _times(factor: float) -> tuple[float, ...]:
    return tuple(factor * level for level in MEDIUM)


_YAW = Scenario(
    "yaw_zero",
    "yaw model, a rudder zero of each record",
    vehicle="yaw",
    records=RUDDER,
    fresh=Manoeuvre("zigzag_12_15", 12.0, 15.0),
    force=(0.0,),
    force_time=10.0,
)

SCENARIOS = {
    scenario.name: scenario
    for scenario in (
        Scenario("white", "white noise as declared"),
        Scenario("tiny", "random forces, 0.1 x medium", force=_times(0.1)),
        Scenario("small", "random forces, 0.3 x medium", force=_times(0.3)),
        Scenario("medium", "random forces 0.1 N, 0.3 N, 0.06 N m, 2 s", force=_times(1.0)),
        Scenario("medium_5s", "the same, 5 s", force=_times(1.0), force_time=5.0),
        Scenario(
            "medium_clock",
            "medium, fin reversed by the clock",
            records=CLOCKED,
            fresh=replace(FRESH, hold=3.4),
            force=_times(1.0),
        ),
        Scenario("large", "random forces, 3 x medium", force=_times(3.0)),
        Scenario("large_calm", "3 x medium, fin within 1 deg", force=_times(3.0), records=CALM),
        Scenario(
            "unstable",
            "medium, pitch pole +0.5 1/s",
            records=STEADIED[:3],
            fresh=STEADIED[3],
            force=_times(1.0),
            pole=0.5,
        ),
        *(
            Scenario(
                f"swell_{period:g}",
                f"medium, JONSWAP with peak at {period:g} s",
                force=_times(1.0),
                swell=period,
                may_flag=True,
            )
            for period in (3.0, 6.0, 12.0)
        ),
        Scenario("missing", "medium, half of the samples missing", force=_times(1.0), missing=0.5),
        Scenario("irregular", "medium, 60 % of the rows missing", force=_times(1.0), dropped=0.6),
        Scenario("colour_0.6", "noise of theta: AR(1), 0.6", colour=0.6, may_flag=True),
        Scenario("colour_0.8", "noise of theta: AR(1), 0.8", colour=0.8, may_flag=True),
        Scenario("noise_2x", "noise 2 x declared", level=2.0, may_flag=True),
        Scenario("spikes", "2 % spikes of 10 sigma", spikes=0.02, may_flag=True),
        Scenario("spikes_up", "2 % spikes, one-sided", spikes=0.02, one_sided=True, may_flag=True),
        Scenario("fin_0.1", "logged fin with 0.1 deg noise", fin_noise=0.1, may_flag=True),
        Scenario("fin_0.5", "logged fin with 0.5 deg noise", fin_noise=0.5, may_flag=True),
        Scenario("weak", "weak trial: 30 s, fin within 2 deg", records=GENTLE),
        Scenario(
            "weak_small", "weak trial, 0.3 x medium forces", records=GENTLE, force=_times(0.3)
        ),
        _YAW,
        replace(
            _YAW,
            name="yaw_zero_hidden",
            title="the same, the model knows no zero",
            hidden=True,
            may_flag=True,
        ),
        replace(
            _YAW, name="yaw_zero_force", title="rudder zeros and a random moment", force=(3e-4,)
        ),
    )
}
