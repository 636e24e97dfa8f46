"""Units and symbols of fields that logs do not spell out but their formats define.

Sources: PX4 message definitions (``msg/*.msg``, comments in SI, NED and FRD frames), ROS REP 103
(SI units everywhere), and suffixes that loggers put into names.
"""

from __future__ import annotations

import re

from oed_sysid.errors import DataError
from oed_sysid.text.units import dimension, parse_header

# Field (topic.field) to unit and, where it is that of a body in NED axes, SNAME symbol.
_KNOWN: tuple[tuple[str, str, str], ...] = (
    # PX4
    (r"vehicle_angular_velocity(_\d+)?\.xyz\[0\]", "rad/s", "p"),
    (r"vehicle_angular_velocity(_\d+)?\.xyz\[1\]", "rad/s", "q"),
    (r"vehicle_angular_velocity(_\d+)?\.xyz\[2\]", "rad/s", "r"),
    (r"vehicle_angular_acceleration(_\d+)?\.xyz\[\d\]", "rad/s^2", ""),
    (r"vehicle_acceleration(_\d+)?\.xyz\[\d\]", "m/s^2", ""),
    (r"vehicle_attitude(_\d+)?\.roll", "rad", "phi"),
    (r"vehicle_attitude(_\d+)?\.pitch", "rad", "theta"),
    (r"vehicle_attitude(_\d+)?\.yaw", "rad", "psi"),
    (r"vehicle_local_position(_\d+)?\.x", "m", "x"),
    (r"vehicle_local_position(_\d+)?\.y", "m", "y"),
    (r"vehicle_local_position(_\d+)?\.z", "m", "z"),
    (r"vehicle_local_position(_\d+)?\.v[xyz]", "m/s", ""),
    (r"vehicle_local_position(_\d+)?\.a[xyz]", "m/s^2", ""),
    (r"vehicle_local_position(_\d+)?\.heading", "rad", "psi"),
    (r"vehicle_attitude_setpoint(_\d+)?\.(roll|pitch|yaw)_body", "rad", ""),
    (r"vehicle_rates_setpoint(_\d+)?\.(roll|pitch|yaw)", "rad/s", ""),
    (r"sensor_combined(_\d+)?\.gyro_rad\[0\]", "rad/s", "p"),
    (r"sensor_combined(_\d+)?\.gyro_rad\[1\]", "rad/s", "q"),
    (r"sensor_combined(_\d+)?\.gyro_rad\[2\]", "rad/s", "r"),
    (r"sensor_combined(_\d+)?\.accelerometer_m_s2\[\d\]", "m/s^2", ""),
    (r"sensor_gyro(_\d+)?\.[xyz]", "rad/s", ""),
    (r"sensor_accel(_\d+)?\.[xyz]", "m/s^2", ""),
    (r"(actuator_controls\w*|actuator_outputs|actuator_motors|actuator_servos)(_\d+)?\."
     r"(control|output)\[\d+\]", "1", ""),
    (r"wind(_estimate)?(_\d+)?\.windspeed_(north|east)", "m/s", ""),
    # ArduPilot, in its own words
    (r"ATT(_\d+)?\.Roll", "deg", "phi"),
    (r"ATT(_\d+)?\.Pitch", "deg", "theta"),
    (r"ATT(_\d+)?\.Yaw", "deg", "psi"),
    (r"IMU(_\d+)?\.GyrX", "rad/s", "p"),
    (r"IMU(_\d+)?\.GyrY", "rad/s", "q"),
    (r"IMU(_\d+)?\.GyrZ", "rad/s", "r"),
    (r"IMU(_\d+)?\.Acc[XYZ]", "m/s^2", ""),
    (r"RC(OU|IN)(_\d+)?\.C\d+", "us", ""),
    # ROS, REP 103
    (r".*\borientation\.[wxyz]", "1", ""),
    (r".*\bangular_velocity\.[xyz]", "rad/s", ""),
    (r".*\blinear_acceleration\.[xyz]", "m/s^2", ""),
    (r".*\b(twist\.)?linear\.[xyz]", "m/s", ""),
    (r".*\b(twist\.)?angular\.[xyz]", "rad/s", ""),
    (r".*\b(pose\.|point\.)position\.[xyz]|.*\btranslation\.[xyz]", "m", ""),
    (r".*\bforce\.[xyz]", "N", ""),
    (r".*\btorque\.[xyz]", "N m", ""),
    (r".*\bfluid_pressure", "Pa", ""),
    (r".*\b(latitude|longitude)", "deg", ""),
    # NMEA 0183 (the parser's names of sentence and field)
    (r"\w*HD[TM]\.heading|\w*HDG\.heading", "deg", "psi"),
    (r"\w*ROT\.rate_of_turn", "deg/min", "r"),
    (r"\w*(RMC|VTG)\.(spd_over_grnd|spd_over_grnd_kts)", "kn", ""),
    (r"\w*(RMC|VTG)\.true_(course|track)", "deg", ""),
    (r"\w*VTG\.spd_over_grnd_kmph", "km/h", ""),
    (r"\w*VHW\.water_speed_knots", "kn", "u"),
    (r"\w*VHW\.heading_(true|magnetic)", "deg", "psi"),
    (r"\w*RSA\.rsa_(starboard|port)", "deg", ""),
    (r"\w*(DPT\.depth|DBT\.depth_meters)", "m", ""),
    (r"\w*MWV\.wind_angle", "deg", ""),
)  # fmt: skip
_COMPILED = tuple((re.compile(pattern), unit, symbol) for pattern, unit, symbol in _KNOWN)
# Endings of names that loggers write without brackets.
_ENDINGS = (
    ("_m_s2", "m/s^2"), ("_m_s_s", "m/s^2"), ("_rad_s", "rad/s"), ("_deg_s", "deg/s"),
    ("_m_s", "m/s"), ("_rad", "rad"), ("_deg", "deg"), ("_pa", "Pa"), ("_celsius", "degC"),
    ("_celcius", "degC"), ("_meter", "m"), ("_rpm", "rpm"),
)  # fmt: skip
_SYMBOLS = {
    "phi": ("roll", "heel"),
    "theta": ("pitch",),
    "psi": ("yaw", "heading", "hdg", "compass"),
    "p": ("roll_rate", "rollspeed"),
    "q": ("pitch_rate", "pitchspeed"),
    "r": ("yaw_rate", "yawspeed", "rate_of_turn", "rot"),
    "z": ("depth",),
    "x": ("north",),
    "y": ("east",),
}


def unit_of(name: str) -> str | None:
    """Unit of a field, from what its format defines or from its name; None if neither says.

    Parameters
    ----------
    name : str
        ``topic.field``.

    Examples
    --------
    >>> unit_of("vehicle_angular_velocity.xyz[2]"), unit_of("airspeed.true_airspeed_m_s")
    ('rad/s', 'm/s')
    >>> unit_of("imu.orientation.w"), unit_of("sheet.rudder [deg]"), unit_of("status.mode")
    ('1', 'deg', None)
    """
    for pattern, unit, _ in _COMPILED:
        if pattern.fullmatch(name):
            return unit
    bare = re.sub(r"\[\d+\]$", "", name)
    for ending, unit in _ENDINGS:
        if bare.endswith(ending):
            return unit
    header = name.rpartition(".")[2] if "[" not in name else name.split(".", 1)[-1]
    if re.search(r"\[\d*\]$", header):
        return None
    unit = parse_header(header)[1] or ""
    try:
        dimension(unit)
    except DataError:
        return None
    return unit or None


def symbol_of(name: str) -> str:
    """SNAME symbol of a field, empty if it has none that is known.

    Examples
    --------
    >>> symbol_of("vehicle_attitude.yaw"), symbol_of("boat.heading"), symbol_of("cpu.load")
    ('psi', 'psi', '')
    """
    for pattern, _, symbol in _COMPILED:
        if symbol and pattern.fullmatch(name):
            return symbol
    field = parse_header(name.rpartition(".")[2])[0].lower()
    return next((symbol for symbol, words in _SYMBOLS.items() if field in words), "")
