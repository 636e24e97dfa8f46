"""Cascaded tanks: a pump fills an upper tank, which drains into a lower one.

Only the level of the lower tank is measured. The nominal model is
linear; water that drains by gravity is not, and tanks overflow.
"""

from __future__ import annotations

import numpy as np

from oed_sysid import (
    Actuator,
    Dataset,
    ExtraState,
    Force,
    Input,
    Limits,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    Sensor,
    State,
    read_csv,
)
from oed_sysid.data.third_party import fetch
from oed_sysid.physics import actuator_lag, sensor_lag

FULL = 10.0  # V, reading of a full tank, and end of the sensor's range
LEVELS = (
    Parameter("full", FULL, "V", fixed=True, description="reading of a full tank"),
    Parameter("middle", 5.0, "V", fixed=True, description="linear and square-root outflow agree"),
    Parameter("lowest", 0.01, "V", fixed=True, description="keeps the root's slope finite"),
    Parameter("lowest_square", 0.01, "V^2", fixed=True, description="the same below a square"),
)
MIDDLE_OF_RECORD = 2048.0  # s
SHORTEST = Parameter(
    "shortest",
    0.5,
    "s",
    fixed=True,
    description="below it the delay of an outflow fades out, so that zero means absent",
)


def _root(level: str, lowest: str = "lowest") -> str:
    return f"sqrt(max({level}, {lowest}))"


STATES = (
    State("upper", "V", "level of the upper tank", scale=3.0),
    State("lower", "V", "level of the lower tank", scale=3.0),
)
INPUTS = (Input("pump", "V", "pump voltage", column="u_V"),)
OUTPUTS = (Output("level", "V", "level of the lower tank", "lower", column="y_V"),)
INFLOW = Parameter("inflow", 0.05, "1/s", lower=0.0, description="inflow per pump voltage")
ROOTS = {tank: f"drain_{tank}*{_root(tank)}" for tank in ("upper", "lower")}
LINEAR = {tank: f"drain_{tank}*{tank}" for tank in ("upper", "lower")}


def _balance(outflow: dict[str, str]) -> dict[str, str]:
    """Rates of both levels, V/s."""
    return {
        "upper": f"inflow*pump - {outflow['upper']}",
        "lower": f"{outflow['upper']} - {outflow['lower']}",
    }


torricelli = Model(
    name="cascaded tanks, Torricelli",
    states=STATES,
    inputs=INPUTS,
    outputs=OUTPUTS,
    kinematics=_balance(ROOTS),
    parameters=(
        *LEVELS,
        INFLOW,
        Parameter("drain_upper", 0.045, "V^0.5/s", lower=0.0, description="upper outlet"),
        Parameter("drain_lower", 0.05, "V^0.5/s", lower=0.0, description="lower outlet"),
    ),
    step=1.0,
)

model = Model(
    name="cascaded tanks, linear",
    states=STATES,
    inputs=INPUTS,
    outputs=OUTPUTS,
    kinematics=_balance(LINEAR),
    parameters=(
        *LEVELS,
        INFLOW,
        Parameter("drain_upper", 0.01, "1/s", lower=0.0, description="upper outlet"),
        Parameter("drain_lower", 0.01, "1/s", lower=0.0, description="lower outlet"),
    ),
    step=1.0,
)


def _outflow_inertia(outflow: dict[str, str]) -> Force:
    """Outflows that follow their steady values with a delay."""
    return Force(
        "outflow_inertia",
        {
            "upper": f"weight*({outflow['upper']} - flow_upper)",
            "lower": f"weight*(flow_upper - {outflow['upper']} + {outflow['lower']} - flow_lower)",
        },
        (
            Parameter("E_outflow_inertia", 0.0, "s", lower=0.0, upper=60.0, scale=5.0),
            SHORTEST,
        ),
        definitions={"weight": "min(E_outflow_inertia/shortest, 1)"},
        states=tuple(
            ExtraState(
                f"flow_{tank}",
                f"({steady} - flow_{tank})/max(E_outflow_inertia, shortest)",
                steady,
                "V/s",
            )
            for tank, steady in outflow.items()
        ),
        description="water in the outlets is not moved at once: outflow follows with a delay",
        needs="quick changes of the pump voltage",
    )


def _gravity(level: str) -> str:
    """Torricelli's outflow less the linear one."""
    return f"({_root(f'middle*{level}', 'lowest_square')} - {level})"


effects = (
    Force(
        "gravity_outflow",
        {
            "upper": f"-E_gravity*drain_upper*{_gravity('upper')}",
            "lower": f"E_gravity*(drain_upper*{_gravity('upper')} - "
            f"drain_lower*{_gravity('lower')})",
        },
        (
            Parameter(
                "E_gravity",
                0.0,
                "1",
                lower=-1.0,
                upper=3.0,
                scale=0.5,
                description="0: outflow proportional to the level, 1: to its square root",
            ),
        ),
        description="tanks drain by gravity, as the square root of the level",
        source="Torricelli (1644); Schoukens & Noel (2017)",
        needs="levels from low to high",
    ),
    Force(
        "dead_voltage",
        {"upper": "-inflow*E_dead_voltage"},
        (Parameter("E_dead_voltage", 0.0, "V", lower=-3.0, upper=3.0, scale=0.5),),
        description="pump voltage without inflow",
        needs="low and high voltages",
    ),
    Force(
        "upper_overflow",
        {
            "upper": "-E_upper_overflow*max(upper - brim, 0)",
            "lower": "E_upper_overflow*share*max(upper - brim, 0)",
        },
        (
            Parameter("E_upper_overflow", 0.0, "1/s", lower=0.0, upper=0.5, scale=0.1),
            Parameter("brim", FULL, "V", lower=1.0, upper=20.0, description="upper tank's brim"),
            Parameter("share", 0.5, "1", lower=0.0, upper=1.0, description="caught below"),
        ),
        amplitudes=("E_upper_overflow",),
        description="the upper tank overflows; a part of it falls into the lower one",
        source="Schoukens & Noel (2017)",
        needs="a pump voltage above five volts for a minute",
    ),
    Force(
        "lower_overflow",
        {"lower": "-E_lower_overflow*max(lower - full, 0)"},
        (Parameter("E_lower_overflow", 0.0, "1/s", lower=0.0, upper=1.0, scale=0.1),),
        description="the lower tank overflows",
        source="Schoukens & Noel (2017)",
        needs="a level at the end of the range",
    ),
    Force(
        "leak",
        {"lower": "-E_leak"},
        (Parameter("E_leak", 0.0, "V/s", scale=0.01),),
        description="water lost, or gained, at a constant rate",
        needs="several levels",
    ),
    Actuator(
        "pump_curve",
        {"pump": "pump + E_pump_curve*pump**2"},
        (Parameter("E_pump_curve", 0.0, "1/V", lower=-0.1, upper=1.0, scale=0.05),),
        description="pump whose flow is not proportional to its voltage",
        needs="low and high voltages",
    ),
    actuator_lag("pump_lag", "pump", scale=5.0),
    sensor_lag("level_lag", "level", scale=5.0),
    # What the instrument makes of a level; a full tank reads FULL whatever the law.
    Sensor(
        "level_exponent",
        {"level": "level + full*(share_of_full**(1 + E_level_exponent) - share_of_full)"},
        (Parameter("E_level_exponent", 0.0, "1", lower=-0.8, upper=4.0, scale=0.3),),
        definitions={"share_of_full": "max(level, lowest)/full"},
        description="reading as a power of the level",
        needs="levels from low to high",
    ),
    Sensor(
        "level_zero",
        {"level": "E_level_zero + level*(1 - E_level_zero/full)"},
        (Parameter("E_level_zero", 0.0, "V", lower=-8.0, upper=8.0, scale=1.0),),
        description="reading of an empty tank",
        needs="levels from low to high",
    ),
)


def records() -> Dataset:
    """First half of the record to learn from, second half to judge by.

    At the end of its range the sensor says only that the level is not lower:
    those samples are marked missing.
    """
    whole = read_csv(fetch("cascaded_tanks/estimation.csv"), model.channels)[0]
    level = whole.output("level")
    whole = whole.with_outputs(np.where(level < FULL, level, np.nan)[:, np.newaxis])
    halves = {
        "train_first_half": whole.window(0.0, MIDDLE_OF_RECORD - 1.0),
        "test_second_half": whole.window(MIDDLE_OF_RECORD, whole.times[-1]),
    }
    return Dataset(
        tuple(
            Record(name, r.times - r.times[0], r.inputs, r.outputs, model.channels, r.source)
            for name, r in halves.items()
        )
    )


REFERENCES = (
    "Schoukens, Mattsson, Wigren & Noel (2016), Cascaded tanks benchmark combining soft and "
    "hard nonlinearities, Eindhoven University of Technology",
    "Schoukens & Noel (2017), Three benchmarks addressing open challenges in nonlinear "
    "system identification, IFAC World Congress",
)
LIMITS = Limits(inputs={"pump": (0.0, 7.0)})
law = Problem(
    name="cascaded_tanks_torricelli",
    title="Cascaded tanks with overflow, Torricelli's law believed",
    model=torricelli,
    effects=(
        *(effect for effect in effects if effect.name != "gravity_outflow"),
        _outflow_inertia(ROOTS),
    ),
    limits=LIMITS,
    records=records,
    references=REFERENCES,
    description="Outflow as the square root of the level is known; what else is missing?",
)
problem = Problem(
    name="cascaded_tanks",
    title="Cascaded tanks with overflow",
    model=model,
    others={"torricelli": law},
    effects=(*effects, _outflow_inertia(LINEAR)),
    limits=LIMITS,
    records=records,
    references=REFERENCES,
    description="Two levels, one sensor: find how the tanks drain and what happens when they fill.",
)
