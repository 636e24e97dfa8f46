"""KVLCC2, a 320 m tanker, as a 7 m model: ten real zigzag tests.

Three problems in one folder. The default sees the ship as a heading response
(rudder to heading and yaw rate) and starts from Nomoto's first-order equation.
``variant="mmg"`` sees a body in surge, sway and yaw; ``variant="linear_hull"``
is the same without the nonlinear hull forces.
"""

from __future__ import annotations

import math
from dataclasses import replace

from oed_sysid import Experiment, Limits, Problem, TurningCircle, ZigZag

from .heading import FIRST_ORDER, SECOND_ORDER, heading_effects
from .manoeuvring import MMG
from .missing import manoeuvring_effects
from .particulars import APPROACH_SPEED, RUDDER_RATE
from .zigzags import zigzag_reader

FULL_RUDDER = math.radians(35.0)
RATE = math.radians(RUDDER_RATE)
LIMITS = Limits(inputs={"delta": (-FULL_RUDDER, FULL_RUDDER)}, rates={"delta": RATE})

PUBLISHED = {
    "K": -0.2559,  # 1/s, mean over the 25/5, 15/5 and 10/1 zigzags
    "T": 15.6816,  # s
    "K_T_source": "online incremental LS-SVM, 100 samples at 1.5 s, difference equation",
    "first_overshoot_repeat_deg": (0.2, 0.5),
    # Free-running 7 m model of [2], table 4, in lengths: starboard, port. For comparison only.
    "turning_35_advance": (3.25, 3.11),
    "turning_35_tactical_diameter": (3.34, 3.08),
    "turning_35_error_advance": 0.02,  # Alexandersson et al. (2022), fitted to zigzags
    "turning_35_error_tactical_diameter": (0.03, 0.07),
}
REFERENCES = (
    "HSVA free-running tests of KVLCC2, SIMMAN 2008 workshop, Copenhagen.",
    "Yasukawa & Yoshimura (2015), J. Mar. Sci. Technol. 20, 37-52, doi:10.1007/s00773-014-0293-y.",
    "Alexandersson, Mao & Ringsberg (2022), Ocean Eng. 266, 112940.",
)


def _experiments(initial: dict[str, float]) -> dict[str, Experiment]:
    """Return the standard tests; a positive rudder turns this ship to port."""
    zigzag = {
        f"zigzag_{angle}_{switch}": Experiment(
            f"zigzag_{angle}_{switch}",
            ZigZag(
                "delta",
                math.radians(angle),
                math.radians(switch),
                first=-1,
                start=1.0,
                rate=RATE,
                sign=-1,
            ),
            duration=180.0,
            sample_time=0.5,
            initial=initial,
            limits=LIMITS,
        )
        for angle, switch in ((10, 10), (20, 20), (20, 5), (35, 5))
    }
    circle = Experiment(
        "turning_circle_35",
        TurningCircle("delta", -FULL_RUDDER, rate=RATE),
        duration=250.0,
        sample_time=0.5,
        initial=initial,
        limits=LIMITS,
    )
    return {**zigzag, "turning_circle_35": circle}


LINEAR_HULL = replace(MMG.without("hull_cubic"), name="MMG with a linear hull")
linear_hull = Problem(
    "kvlcc2_linear_hull",
    LINEAR_HULL,
    title="KVLCC2 tanker in surge, sway and yaw, hull forces linear",
    effects=manoeuvring_effects(),
    experiments=_experiments({"u": APPROACH_SPEED}),
    limits=LIMITS,
    records=zigzag_reader(LINEAR_HULL.channels),
    published=PUBLISHED,
    references=REFERENCES,
    description="Ten zigzags of HSVA; the hull's nonlinear forces are among the candidates.",
)
mmg = replace(
    linear_hull,
    name="kvlcc2_mmg",
    model=MMG,
    models={},
    effects=tuple(e for e in linear_hull.effects if e.name not in MMG.effect_names),
    title="KVLCC2 tanker in surge, sway and yaw, MMG standard model",
    description="Ten zigzags of HSVA; success is a 35 degree turning circle from zigzags alone.",
)
problem = Problem(
    "kvlcc2",
    FIRST_ORDER,
    title="KVLCC2 tanker, heading response",
    models={"second_order": FIRST_ORDER + SECOND_ORDER},
    others={"mmg": mmg, "linear_hull": linear_hull},
    effects=heading_effects(),
    experiments=_experiments({}),
    limits=LIMITS,
    records=zigzag_reader(FIRST_ORDER.channels),
    published=PUBLISHED,
    references=REFERENCES,
    description="Ten zigzags of HSVA; success is a held-out zigzag within the repeat scatter.",
)
