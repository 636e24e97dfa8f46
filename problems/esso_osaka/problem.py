"""Esso Osaka, a 3 m tanker model in a pond with wind: turns, zigzags and runs astern."""

from __future__ import annotations

import math
from dataclasses import replace

from oed_sysid import Experiment, Limits, Problem
from oed_sysid.experiments.manoeuvres import TurningCircle, ZigZag

from .manoeuvring import MMG
from .missing import WIND, effects
from .particulars import SOURCE
from .records import records

RATE = math.radians(20.0)  # per second, of the logged rudder
LIMITS = Limits(
    inputs={"delta": (-math.radians(35.0), math.radians(35.0)), "n": (-20.0, 20.0)},
    rates={"delta": RATE},
)
CALM = {"n": 10.0, "wind_north": 0.0, "wind_east": 0.0}


def _experiments() -> dict[str, Experiment]:
    """A zigzag and a turning circle in calm air."""
    common = {
        "sample_time": 0.5,
        "constants": CALM,
        "initial": {"u": 0.35},
        "limits": LIMITS,
    }
    angle = math.radians(20.0)
    return {
        "zigzag_20_20": Experiment(
            "zigzag_20_20", ZigZag("delta", angle, angle, rate=RATE), duration=150.0, **common
        ),
        "turning_circle_35": Experiment(
            "turning_circle_35",
            TurningCircle("delta", math.radians(35.0), rate=RATE),
            duration=250.0,
            **common,
        ),
    }


with_wind = replace(MMG + WIND, name="MMG model for low speeds, wind included")
problem = Problem(
    "esso_osaka",
    MMG,
    title="Esso Osaka tanker, 3 m model, in wind",
    models={"wind": with_wind},
    effects=effects(),
    experiments=_experiments(),
    limits=LIMITS,
    records=lambda: records(MMG.channels),
    published={
        # Simulator of the same laboratory, parameters as shipped, four windows of 100 s.
        "rms_100_s": {"u_mps": 0.044, "v_mps": 0.029, "r_degps": 0.97},
    },
    references=(
        SOURCE,
        "Miyauchi et al. (2022), J. Mar. Sci. Technol. 27, 1065-1083.",
        "Yoshimura, Nakao & Ishibashi (2009), Unified mathematical model for ocean and harbour "
        "manoeuvring, MARSIM.",
    ),
    description="Twelve free runs in a pond: the model without wind fails; find out why.",
)
