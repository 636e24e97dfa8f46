"""Measured data of third parties: where it is, whether it is whole, how to get it.

The data does not belong to this project and is not shipped with it. A file is
looked for in the folder named by ``OED_SYSID_DATA`` (by default the user's
cache) and recognised by its digest. If it is not there, the original is
downloaded at the stated commit and brought into the form that this package
reads: comma-separated, units in the headers.

From the files of third parties as they publish them to the form that this package reads.

Comma-separated, units in the headers; nothing is left out but what is said.
"""

from __future__ import annotations

import hashlib
import io
import json
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path
from urllib.parse import quote

import numpy as np

from oed_sysid.data import SAYS
from oed_sysid.errors import DataError, located
from oed_sysid.runtime.files import write_bytes

# -- from the files of third parties as they publish them to the form that this package reads


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


# -- measured data of third parties ----------------------------------------------------


Convert = Callable[[bytes], bytes]


@dataclass(frozen=True)
class DataFile:
    """One file of third-party data.

    Parameters
    ----------
    path : str
        Place below the data folder, ``set/file.csv``.
    sha256 : str
        Digest of the file in the form that this package reads.
    source : str
        Repository and commit, or whom to ask.
    licence : str
        What is known about the right to use it.
    url : str or None
        Where the original can be downloaded; None if it cannot be had, or not
        be converted, without further tools.
    convert : callable or None
        From the bytes of the original to those of the file; None if it is
        used as it is.
    raw_sha256 : str or None
        Digest of the original; None where it is not known. The digest of the
        converted file is checked in any case.
    """

    path: str
    sha256: str
    source: str
    licence: str
    url: str | None = None
    convert: Convert | None = None
    raw_sha256: str | None = None


def data_folder() -> Path:
    """Folder that holds third-party data: ``$OED_SYSID_DATA``, or the user's cache."""
    stated = os.environ.get("OED_SYSID_DATA")
    if stated:
        return Path(stated).expanduser()
    import pooch  # slow to import, and needed for downloads only

    return Path(pooch.os_cache("oed_sysid"))


def registered(prefix: str = "") -> tuple[str, ...]:
    """Paths of all known files that begin with a prefix, such as ``"silverbox/"``.

    Examples
    --------
    >>> registered("cascaded_tanks/")
    ('cascaded_tanks/estimation.csv',)
    """
    return tuple(path for path in _REGISTRY if path.startswith(prefix))


def describe(path: str) -> DataFile:
    """Return what is known about a file: source, licence, digest.

    Raises
    ------
    DataError
        If the file is not registered.
    """
    located(DataError, "The register has no data file", [path], _REGISTRY)
    return _REGISTRY[path]


def fetch(path: str) -> Path:
    """Return the local path of a file; download and convert it if it is not there.

    Parameters
    ----------
    path : str
        One of :func:`registered`.

    Returns
    -------
    Path
        The file, whose digest has been checked.

    Raises
    ------
    DataError
        If it is unknown, damaged, or cannot be downloaded; the message says
        what to do by hand.
    """
    file, folder = describe(path), data_folder()
    place = folder / file.path
    if place.is_file():
        if _digest(place.read_bytes()) != file.sha256:
            raise DataError(SAYS["another_file"].format(place=place, file=file))
        return place
    if file.url is None:
        raise DataError(SAYS["no_download"].format(file=file, folder=folder))
    raw = _download(file, folder)
    content = file.convert(raw) if file.convert else raw
    if _digest(content) != file.sha256:
        raise DataError(SAYS["source_changed"].format(file=file))
    write_bytes(place, content)
    return place


def _download(file: DataFile, folder: Path) -> bytes:
    """Bytes of the original; it is kept in the folder ``originals``."""
    import pooch

    try:
        found = pooch.retrieve(
            file.url,
            known_hash=f"sha256:{file.raw_sha256}" if file.raw_sha256 else None,
            path=folder / "originals" / Path(file.path).parent,
            progressbar=False,
        )
    except Exception as error:  # requests, urllib3 and the file system each have their own
        reason = str(error).splitlines()[0][:200] if str(error) else type(error).__name__
        raise DataError(
            f"The data {file.path} is not in {folder} and could not be downloaded from {file.url} "
            f"({reason}). Without a network, copy it from a machine that has it, or set "
            "OED_SYSID_DATA to a folder that does."
        ) from None
    return Path(found).read_bytes()


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()


# -- registry ----------------------------------------------------------------------


_CONVERTERS: dict[str, Convert] = {
    "hsva": convert_hsva,
    "roll_decay": convert_roll_decay,
    "captive": convert_captive,
    "tanks": convert_tanks,
}


def _registered() -> Iterator[DataFile]:
    """Every file of ``third_party.json``: by repository, path to original and digest.

    The digest of an original is known only if it is used as it is.
    """
    table = files("oed_sysid.data").joinpath("third_party.json").read_text("utf-8")
    for group in json.loads(table):
        repository, commit = group["repository"], group["commit"]
        convert = _CONVERTERS.get(group.get("convert", ""))
        place = f"https://raw.githubusercontent.com/{repository}/{commit}/"
        for path, (original, sha256) in group["files"].items():
            source = f"github.com/{repository}, commit {commit}, {original}"
            url = place + quote(original) if group.get("download", True) else None
            raw = sha256 if url is not None and convert is None else None
            yield DataFile(path, sha256, source, group["licence"], url, convert, raw)


_REGISTRY: dict[str, DataFile] = {file.path: file for file in _registered()}
