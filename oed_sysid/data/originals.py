"""From the files of third parties as they publish them to the form that this package reads.

Comma-separated, units in the headers; nothing is left out but what is said.
"""

from __future__ import annotations

import io

import numpy as np


def _table(headers: str, columns: np.ndarray, form: str) -> bytes:
    text = io.StringIO()
    np.savetxt(text, columns, fmt=form, delimiter=",", header=headers, comments="")
    return text.getvalue().encode()


def convert_hsva(raw: bytes) -> bytes:
    """Free-running tests of HSVA: name the columns, add velocities along the ship.

    The original has four lines of text and twelve columns without names. The
    velocity columns are earth-fixed, although the report calls them u and v:
    they equal the derivatives of the positions.
    """
    lines = raw.decode("latin-1").splitlines()[4:]
    data = np.array([line.split() for line in lines if line.strip()], dtype=float)
    psi = np.radians(data[:, 3])
    dx, dy = data[:, 4], data[:, 5]
    u = dx * np.cos(psi) + dy * np.sin(psi)
    v = -dx * np.sin(psi) + dy * np.cos(psi)
    headers = (
        "t_s,x0_m,y0_m,psi_deg,dx0_mps,dy0_mps,r_degps,phi_deg_inferred,delta_deg,n_rps,"
        "thrust_N,torque_Nm,u_mps_derived,v_mps_derived"
    )
    return _table(headers, np.column_stack([data, u, v]), "%.8g")


def convert_roll_decay(raw: bytes) -> bytes:
    """Roll decay tests of SSPA: units in the headers, seven digits."""
    data = np.loadtxt(io.BytesIO(raw), delimiter=",", skiprows=1)
    return _table("t_s,x_m,y_m,z_m,phi_rad,theta_rad,psi_rad", data, "%.7g")


def convert_captive(raw: bytes) -> bytes:
    """Captive tests of HMRI: the rows with a drift angle or a rudder angle, not both."""
    return b"".join(
        row for row in raw.splitlines(keepends=True) if b"drift + rudder angle" not in row
    )


def convert_tanks(raw: bytes) -> bytes:
    """Cascaded tanks: the estimation half, with times."""
    data = np.genfromtxt(io.BytesIO(raw), delimiter=",", names=True, deletechars='"')
    u, y = data["uEst"], data["yEst"]
    return _table("t_s,u_V,y_V", np.column_stack([4.0 * np.arange(len(u)), u, y]), "%.5g")
