"""Slocum glider in the Baltic: a flight model without inertia, and what the log says.

The glider has no propeller: a pump changes its volume, and wings turn sinking and
rising into gliding. Pitch, volume and density of the water are measured and
enter as inputs; pressure and the speed through the water judge the model.

Forces act on the velocity through the water, u horizontal and w down. The steady
model of the literature is written as a motion with a fifth of the glider's mass,
which settles within a few seconds; the missing inertia is one of the candidates.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid import (
    Dataset,
    Environment,
    Force,
    Inertia,
    Input,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
)
from oed_sysid.data.third_party import fetch
from oed_sysid.physics import actuator_gain_error, actuator_offset, sensor_bias, sensor_scale

# The file holds the pitch as corrected by its authors; what the glider logged is undone here.
PITCH_SCALE, PITCH_OFFSET = 0.86, -0.004  # 1, rad
SPIKE = 0.40  # m/s: dives begin at 0.36; a few readings of the velocity log are beyond
SHALLOW = 3e4  # Pa: above three metres waves and the surface interfere
LONGEST_GAP = 10.0  # s between samples
TRAIN = (2, 5, 9)  # dives to learn from; the others judge


def _known(name: str, value: float, unit: str, description: str) -> Parameter:
    return Parameter(name, value, unit, fixed=True, description=description)


CONSTANTS = (
    _known("g", 9.81, "m/s^2", "gravity"),
    _known("S", 0.1, "m^2", "reference area"),
    _known("V_g", 70.0 / 1004.0, "m^3", "volume of the glider"),
    _known("m_settle", 14.0, "kg", "mass that stands for a motion without inertia"),
)

FLIGHT = Force(
    "lift_and_drag",
    {"X": "lift*w_r - drag*u_r", "Z": "-lift*u_r - drag*w_r"},
    (
        Parameter("C_D0", 0.15, "1", lower=0.01, description="drag at no angle of attack"),
        _known("C_D1", 10.5, "1", "drag due to the angle of attack squared"),
        _known("a_lift", 7.53, "1", "lift slope: hull 3.8, wings 3.73"),
    ),
    description="lift and drag of hull and wings",
)
WEIGHT = Force(
    "weight_and_buoyancy",
    {"Z": "g*(m_g - rho_w*(V_g*(1 - epsilon*P) + V_pump))"},
    (
        Parameter("m_g", 70.1, "kg", description="mass of the glider"),
        _known("epsilon", 5e-10, "1/Pa", "compressibility of the hull"),
    ),
    description="weight less buoyancy",
)

model = Model(
    name="Slocum glider, steady flight",
    states=(
        State("u", "m/s", "horizontal velocity", scale=0.3),
        State("w", "m/s", "sinking velocity", scale=0.15),
        State("z", "m", "depth", scale=10.0),
    ),
    inputs=(
        Input("pitch", "rad", "pitch, bow up", "linear", column="pitch"),
        Input("volume", "m^3", "volume pumped out", "linear", column="volume"),
        Input("density", "kg/m^3", "density of the water", "linear", column="density"),
    ),
    outputs=(
        Output("pressure", "Pa", "pressure", "P", noise_std=500.0),
        Output("speed", "m/s", "speed through the water", "V", noise_std=0.005),
    ),
    axes={"X": "u", "Z": "w"},
    inertia={("X", "u"): "m_settle", ("Z", "w"): "m_settle"},
    kinematics={"z": "w"},
    actuators={"theta": "pitch", "V_pump": "volume", "rho_w": "density"},
    signals={
        "u_r": "u",
        "w_r": "w",
        "V": "sqrt(u_r**2 + w_r**2 + 1e-6)",
        "P": "rho_w*g*z",
        # Along and across the hull; sine and cosine of the angle of attack.
        "ahead": "(u_r*cos(theta) - w_r*sin(theta))/V",
        "across": "(u_r*sin(theta) + w_r*cos(theta))/V",
        "pressure_area": "rho_w/2*S*V",
        "lift": "pressure_area*a_lift*across*ahead",
        "drag": "pressure_area*(C_D0 + C_D1*across**2)",
    },
    effects=(FLIGHT, WEIGHT),
    parameters=CONSTANTS,
    step=0.05,
)

corrected = replace(
    model,
    name="Slocum glider, steady flight, corrected pitch",
    actuators={**model.actuators, "theta": f"{PITCH_SCALE}*pitch + ({PITCH_OFFSET})"},
)


def _amplitude(name: str, unit: str, scale: float, text: str, lower: float = -np.inf) -> Parameter:
    return Parameter(
        f"E_{name}",
        0.0,
        unit,
        lower=max(lower, -20 * scale),
        upper=20 * scale,
        scale=scale,
        description=text,
    )


def _flow(name: str, lift: str, drag: str, scale: float, text: str) -> Force:
    """Candidate change of the lift or drag coefficient."""
    size = _amplitude(name, "1", scale, text)
    along, turned = f"pressure_area*{size.name}*{drag}", f"pressure_area*{size.name}*{lift}"
    return Force(
        name,
        {"X": f"{turned}*w_r - {along}*u_r", "Z": f"-{turned}*u_r - {along}*w_r"},
        (size,),
        description=text,
        needs="different pitch angles",
    )


# Added mass along and across the hull, as fractions of the mass (Merckelbach et al. 2019).
_TURN = "E_inertia*m_g*(k_across - k_along)*sin(theta)*cos(theta)"
INERTIA = Inertia(
    "inertia",
    {
        ("X", "u"): "E_inertia*(m_g*(1 + k_along*cos(theta)**2 + k_across*sin(theta)**2)"
        " - m_settle)",
        ("Z", "w"): "E_inertia*(m_g*(1 + k_along*sin(theta)**2 + k_across*cos(theta)**2)"
        " - m_settle)",
        ("X", "w"): _TURN,
        ("Z", "u"): _TURN,
    },
    (
        _amplitude("inertia", "1", 0.5, "1: mass and added mass as published", lower=0.0),
        _known("k_along", 0.2, "1", "added mass along the hull"),
        _known("k_across", 0.98, "1", "added mass across the hull"),
    ),
    amplitudes=("E_inertia",),
    description="mass and added mass",
    source="Merckelbach et al. (2019), J. Atmos. Oceanic Technol. 36(2), 281-296",
    needs="turns from diving to climbing",
)

effects = (
    INERTIA,
    actuator_gain_error("pitch_scale", "theta", scale=0.1),
    actuator_offset("pitch_offset", "theta", scale=0.02),
    actuator_gain_error("volume_scale", "V_pump", scale=0.05),
    Force(
        "hull_compressibility",
        {"Z": "g*rho_w*V_g*E_compressibility*P"},
        (_amplitude("compressibility", "1/Pa", 5e-10, "beyond the believed 5e-10"),),
        description="the hull yields more to pressure than believed",
        needs="depth",
    ),
    _flow("induced_drag", "0", "across**2", 5.0, "drag due to the angle of attack"),
    _flow("lift_slope", "across*ahead", "0", 2.0, "lift slope"),
    Force(
        "pump_drag",
        {
            axis: f"-pressure_area*E_pump_drag*V_pump/V_stroke*{velocity}"
            for axis, velocity in (("X", "u_r"), ("Z", "w_r"))
        },
        (
            _amplitude("pump_drag", "1", 0.02, "drag differs between dive and climb"),
            Parameter("V_stroke", 2.3e-4, "m^3", fixed=True, description="half stroke of the pump"),
        ),
        description="drag differs between dive and climb",
        needs="dives and climbs",
    ),
    Environment(
        "vertical_current",
        {"w_r": "w_r - E_vertical_current"},
        (_amplitude("vertical_current", "m/s", 0.02, "water sinking"),),
        description="steady vertical motion of the water, positive down",
        needs="dives and climbs, speed through the water measured",
    ),
    sensor_scale("speed_scale", "speed", scale=0.05),
    sensor_bias("speed_bias", "speed", "m/s", scale=0.02),
)


def _dives(pressure: np.ndarray) -> list[tuple[int, int]]:
    """First and last index of every stretch below ``SHALLOW``."""
    below = np.concatenate([[False], pressure > SHALLOW, [False]])
    edges = np.flatnonzero(np.diff(below.astype(int)))
    return [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]


def records() -> Dataset:
    """One record per dive and climb, from the first speed of the velocity log on.

    Times stay as irregular as they are.
    """
    path = fetch("slocum_glider_comet2016/gliderflight_data.csv")
    t, _, bar, pitch, cubic_cm, density, speed = np.genfromtxt(path, delimiter=",", skip_header=1).T
    speed = np.where(speed < SPIKE, speed, np.nan)
    logged = (pitch - PITCH_OFFSET) / PITCH_SCALE
    inputs = np.column_stack([logged, 1e-6 * cubic_cm, density])
    outputs = np.column_stack([1e5 * bar, speed])
    dives = []
    for number, (first, last) in enumerate(_dives(1e5 * bar), start=1):
        measured = np.flatnonzero(np.isfinite(speed[first : last + 1]))
        if not measured.size:
            continue
        rows = slice(first + measured[0], last + 1)
        if np.diff(t[rows]).max() > LONGEST_GAP:
            continue
        name = f"{'train' if number in TRAIN else 'test'}_dive_{number}"
        times = t[rows] - t[rows][0]
        dives.append(
            Record(name, times, inputs[rows], outputs[rows], model.channels, source=str(path))
        )
    return Dataset(tuple(dives))


problem = Problem(
    name="slocum_glider",
    title="Slocum glider Comet, diving plane, Baltic 2016",
    model=model,
    models={"corrected_pitch": corrected},
    effects=effects,
    records=records,
    published={
        "C_D0, steady": 0.1496,
        "m_g, steady, kg": 70.103,
        "rms error of speed, steady, m/s": 0.0480,
        "C_D0, dynamic": 0.1556,
        "m_g, dynamic, kg": 70.101,
        "rms error of speed, dynamic, m/s": 0.0285,
    },
    references=(
        "Merckelbach, Berger, Krahmann, Dengler & Carpenter (2019), A dynamic flight model for "
        "Slocum gliders and implications for turbulence microstructure measurements, J. Atmos. "
        "Oceanic Technol. 36(2), 281-296",
    ),
    description="The steady model fails at the turns, and the pitch it is given is not quite true.",
)
