r"""Fields that follow from others of the same topic: Euler angles, positions in metres.

A unit quaternion :math:`e_0, e_1, e_2, e_3` from body to earth axes gives (Diebel 2006, eq. 290)

.. math::
    \phi   = \operatorname{atan2}(2(e_2 e_3 + e_0 e_1),\; e_0^2 - e_1^2 - e_2^2 + e_3^2), \quad
    \theta = \arcsin(2(e_0 e_2 - e_1 e_3)), \quad
    \psi   = \operatorname{atan2}(2(e_1 e_2 + e_0 e_3),\; e_0^2 + e_1^2 - e_2^2 - e_3^2).

PX4 and ArduPilot give it for body axes forward-right-down in north-east-down. ROS (REP 103)
gives it for forward-left-up in east-north-up; in NED the same attitude has

.. math:: \phi_N = \phi, \qquad \theta_N = -\theta, \qquad \psi_N = \pi/2 - \psi .

Latitude and longitude become north and east of the first fix with the radii of curvature of the
ellipsoid WGS 84 there,

.. math:: R_M = a(1-e^2)/(1-e^2\sin^2\varphi)^{3/2}, \qquad R_N = a/\sqrt{1-e^2\sin^2\varphi},

good to 1e-4 of the distance within 10 km below 60 degrees of latitude.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from oed_sysid.data.series import Series

# Names of scalar part and vector part of a quaternion in one topic, and where they come from.
_QUATERNIONS = (
    ("q[0]", "q[1]", "q[2]", "q[3]"),
    ("Q1", "Q2", "Q3", "Q4"),
    ("q0", "q1", "q2", "q3"),
    ("e0", "e1", "e2", "e3"),
    ("qw", "qx", "qy", "qz"),
)
_ROS = ("orientation.w", "orientation.x", "orientation.y", "orientation.z")
_FIXES = (("lat", "lon"), ("Lat", "Lng"), ("latitude", "longitude"), ("Lat", "Lon"))
# Logs that hold whole numbers of 1e-7 degrees.
_WHOLE = 1e-7
_AXIS, _FLATTENING = 6378137.0, 1.0 / 298.257223563  # WGS 84, NIMA TR8350.2


def euler_angles(quaternion: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Roll, pitch and yaw of quaternions.

    Parameters
    ----------
    quaternion : numpy.ndarray
        Shape ``(n_samples, 4)``, scalar part first; normalised here.

    Returns
    -------
    roll, pitch, yaw : numpy.ndarray
        Shape ``(n_samples,)``, rad; NaN where the quaternion is zero or not finite.

    Examples
    --------
    >>> half = np.radians(40.0) / 2
    >>> roll, pitch, yaw = euler_angles(np.array([[np.cos(half), 0.0, 0.0, np.sin(half)]]))
    >>> print(np.degrees([roll[0], pitch[0], yaw[0]]).round(9))
    [ 0.  0. 40.]
    """
    length = np.sqrt(np.sum(np.square(quaternion), axis=1, keepdims=True))
    with np.errstate(invalid="ignore", divide="ignore"):
        w, x, y, z = np.where(length > 1e-6, quaternion / length, np.nan).T
    roll = np.arctan2(2 * (y * z + w * x), w * w - x * x - y * y + z * z)
    pitch = np.arcsin(np.clip(2 * (w * y - x * z), -1.0, 1.0))
    yaw = np.arctan2(2 * (x * y + w * z), w * w + x * x - y * y - z * z)
    return roll, pitch, yaw


def local_position(latitude: np.ndarray, longitude: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """North and east of the first fix.

    Parameters
    ----------
    latitude, longitude : numpy.ndarray
        Shape ``(n_samples,)``, degrees; NaN where there is no fix.

    Returns
    -------
    north, east : numpy.ndarray
        Shape ``(n_samples,)``, m.

    Examples
    --------
    >>> north, east = local_position(np.array([54.0, 54.001]), np.array([10.0, 10.001]))
    >>> print(north[1].round(2), east[1].round(2))
    111.31 65.58
    """
    good = np.flatnonzero(np.isfinite(latitude) & np.isfinite(longitude))
    if not good.size:
        return np.full(latitude.shape, np.nan), np.full(latitude.shape, np.nan)
    first = good[0]
    phi = np.radians(latitude[first])
    squared = _FLATTENING * (2.0 - _FLATTENING)
    root = 1.0 - squared * np.sin(phi) ** 2
    north = np.radians(latitude - latitude[first]) * _AXIS * (1.0 - squared) / root**1.5
    turn = (longitude - longitude[first] + 180.0) % 360.0 - 180.0
    east = np.radians(turn) * _AXIS / np.sqrt(root) * np.cos(phi)
    return north, east


def derived(topic: str, fields: Mapping[str, Series]) -> Iterator[Series]:
    """Yield what follows from the fields of one topic.

    Parameters
    ----------
    topic : str
        Its name.
    fields : mapping
        Field name to series.
    """
    for names in _QUATERNIONS:
        if all(name in fields for name in names):
            yield from _attitude(topic, fields, names, "", f"from {names[0]} to {names[3]}")
            break
    for prefix in {name[: -len(_ROS[0])] for name in fields if name.endswith(_ROS[0])}:
        parts = tuple(prefix + name for name in _ROS)
        if all(name in fields for name in parts):
            yield from _attitude(topic, fields, parts, f"{prefix}orientation.", "from quaternion")
            roll, pitch, yaw = _angles(fields, parts)
            times = fields[parts[0]].times
            turned = ((np.pi / 2 - yaw) + np.pi) % (2 * np.pi) - np.pi
            for name, values in (("roll", roll), ("pitch", -pitch), ("yaw", turned)):
                full = f"{topic}.{prefix}orientation.{name}_ned"
                yield Series(full, times, values, "rad", "NED, if the log is ENU and FLU")
    for lat, lon in _FIXES:
        if lat in fields and lon in fields:
            north, east = local_position(_degrees(fields[lat]), _degrees(fields[lon]))
            for name, values in (("north", north), ("east", east)):
                if name not in fields:
                    words = "of the first fix"
                    yield Series(f"{topic}.{name}", fields[lat].times, values, "m", words)
            break


def _angles(fields: Mapping[str, Series], names: tuple[str, ...]) -> tuple[np.ndarray, ...]:
    return euler_angles(np.column_stack([fields[name].values for name in names]))


def _attitude(
    topic: str, fields: Mapping[str, Series], names: tuple[str, ...], prefix: str, words: str
) -> Iterator[Series]:
    times = fields[names[0]].times
    for name, values in zip(("roll", "pitch", "yaw"), _angles(fields, names), strict=True):
        if name not in fields:
            yield Series(f"{topic}.{prefix}{name}", times, values, "rad", words)


def _degrees(series: Series) -> np.ndarray:
    """Degrees, NaN without a fix: receivers write zero, or values out of range."""
    values = series.values.astype(float)
    finite = values[np.isfinite(values)]
    if finite.size and np.abs(finite).max() > 400.0:
        values = values * _WHOLE
    return np.where((np.abs(values) > 1e-9) & (np.abs(values) <= 180.0), values, np.nan)
