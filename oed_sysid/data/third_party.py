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
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

import numpy as np

from oed_sysid.data.record import closest
from oed_sysid.errors import DataError
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
    if path not in _REGISTRY:
        raise DataError(
            f"There is no registered data file {path!r}.{closest(path, _REGISTRY)} See "
            "oed_sysid.data.third_party.registered()."
        )
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
    return _fetch(describe(path), data_folder())


def fetch_all(prefix: str) -> tuple[Path, ...]:
    """Return the local paths of all files that begin with a prefix.

    Raises
    ------
    DataError
        If there is none, or one cannot be had.
    """
    paths = registered(prefix)
    if not paths:
        describe(prefix)
    return tuple(fetch(path) for path in paths)


def _fetch(file: DataFile, folder: Path) -> Path:
    place = folder / file.path
    if place.is_file():
        if _digest(place.read_bytes()) != file.sha256:
            raise DataError(
                f"{place} is not the file that is registered: its SHA-256 differs. Move it away, "
                f"and the original is fetched again ({file.source})."
            )
        return place
    if file.url is None:
        raise DataError(
            f"The data {file.path} is not in {folder} and cannot be downloaded in this form. "
            f"It comes from {file.source}. Put the converted file there, or set OED_SYSID_DATA to "
            "a folder that has it."
        )
    raw = _download(file, folder)
    content = file.convert(raw) if file.convert else raw
    if _digest(content) != file.sha256:
        raise DataError(
            f"{file.url} was downloaded, but does not give the registered {file.path}: its SHA-256 "
            f"differs. The source has changed; compare with {file.source}."
        )
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


def _github(repository: str, commit: str, path: str) -> str:
    return f"https://raw.githubusercontent.com/{repository}/{commit}/{quote(path)}"


_MANOEUVRING = (
    "martinlarsalbert/System-identification-of-Vessel-Manoeuvring-Models",
    "4b7ce53f0cc8ac159126fdda7d45e30c540be2d8",
)
_ROLL = (
    "martinlarsalbert/Prediction-of-roll-motion-using-fully-nonlinear-potential-flow-and-Ikedas-"
    "method",
    "cce8abde16a15a2ae45008e48b1bba9f4aeaaad4",
)
_TANKS = (
    "MiladBnit/Uncertainty-quantification-in-neural-state-space-models-applications",
    "2a565d57ca30bdf126da507c00ad1f1e481ca434",
)
_HSVA_LICENCE = (
    "no licence file in the repository (its .zenodo.json says MIT for the software); data of "
    "HSVA and the SIMMAN 2008 workshop"
)
_HMRI_LICENCE = (
    "no licence file in the repository (its .zenodo.json says MIT for the software); data of "
    "HMRI and the SIMMAN 2014 workshop"
)
_HSVA_FILES = {
    "10_01": "f10941f13749786e04313b3875421d6e2be1af6e931b16751f4999e6d6c91014",
    "10_05": "454ebfa54a4c08b40431f645027d7c7a1593d2f81494c1d3c9b924cd80b295e5",
    "10_10_P": "951ee2c586ebf37a8f2b661a7f47813a613a2655ed143e3c4233c3fa2437f5e4",
    "10_10_S": "d76ab12caead983a8d4aa85e908d0fbf4c0c502f90620b09dd1aa0bc6b9c2e75",
    "15_01": "ffebbb82a90027f8278dd6c55c02b9754f23ca6fcb4504b481dede93ed729fdd",
    "15_05": "4b28b839b57d8bec1c411c5082b4fcbc89951754b6a4cdec2574a63019bff7ff",
    "20_05": "451d65784654dbe32709a66fff4521b863b60a2cf8bef6b7960c43efc14f96b3",
    "20_10_S": "033e824cb4fe2deb23d26ec821299d8ec7ef0aff8786fe82c6478eef1abbcc19",
    "25_05": "dddbcebc2280187ad2d2206cad45d0049476f89b626ec3461ae58ff41101655e",
    "30_05": "f6c11fe3eff940d10f78d5452c2cb4e5d313b6e86d9a11073e6cf2a50202b7fa",
}

_ESSO = ("NAOE-5thLab/FRT-DS-ESSO", "e694dfd62932bff755f3bc975b5863d649023bc0")
_ESSO_LICENCE = (
    "CC BY-NC 4.0 (its file LICENSE: CC BY-NC-SA 4.0), not for commercial use; cite Wakita et al. "
    "(2022) and Miyauchi et al. (2022), J. Mar. Sci. Technol. 27"
)
# By kind of run and day, then by time of day.
_ESSO_FILES = {
    "random_06-Aug-2020": {
        "16_24_25_4": "61dcab5b97f0a039ce59ff18a5b6d6a67f1d35e0b1cdff536ac9192b8c89cc52",
        "16_24_25_5": "402ce69616c48f99f086a491811efd59cf26cc0a1f154c7ceeec844312eabcd4",
        "16_24_25_6": "875dfed9570e83b50e4ecbfe52ef18f12b3cfb18f0f8f4f71f0332691d128eba",
    },
    "turn_14-Sep-2020": {
        "13_39_32": "aedb10b620e00008acb2332ec180ca17a355cb9e2acba72244ebbfb167a9c7df",
        "14_16_04": "b7075a503a922d58ab0da91c3ee15b55bb9cede0d51ed5f4fb26277fac506775",
    },
    "turn_cut_14-Sep-2020": {
        "15_58_08": "7045db0012e33603955580c070522dc8a06d67e9a50972448acc3dbd86498ee7",
        "16_09_02": "c5620305b7f3e52f67e84cababff7c67f59ec2ca175b803b6dc2e17621b0c94a",
    },
    "zigzag_31-Jul-2020": {
        "13_22_52": "47d317d8405f88c524fc3e6646224ab4500c9b05184339dd35d14200a71cd8ff",
        "13_29_19": "72523ffd6240cd441a9ab32c0a0ab8dfb52b120b7e7e9be365ff3e51cced022d",
        "13_50_28": "e04f52593cc350281dc2d0b39750a48253fff9e35b3be11d28fc8fa157bbdffa",
        "13_57_45": "6047e035a67745103aa56924e500c3eeb4486f82476e6933e563ca9589db4b68",
        "14_03_39": "d6b7e81950d278c77b21f05f58c8b67a86a1e0f6d43ec57781bb8b9620e01480",
    },
}


def _hosted(
    path: str,
    sha256: str,
    repository: tuple[str, str],
    original: str,
    licence: str,
    convert: Convert | None = None,
) -> DataFile:
    """File whose original is on GitHub; its digest is known only if it is used as it is."""
    name, commit = repository
    source = f"github.com/{name}, commit {commit}, {original}"
    url = _github(name, commit, original)
    return DataFile(
        path, sha256, source, licence, url, convert, raw_sha256=None if convert else sha256
    )


def _kind_of_run(run: str) -> str:
    """Folder of a run of Esso Osaka: turning, zigzag or random."""
    kind = run.partition("_")[0]
    return "turning" if kind == "turn" else kind


_FILES = (
    *(
        _hosted(
            f"kvlcc2_hsva_zigzag/HSVA_CPMC_KVLCC2_Z_{run}.csv",
            sha256,
            _MANOEUVRING,
            f"data/01_raw/kvlcc2_hsva/raw_data/HSVA_CPMC_KVLCC2_Z_{run}.dat",
            _HSVA_LICENCE,
            convert_hsva,
        )
        for run, sha256 in _HSVA_FILES.items()
    ),
    _hosted(
        "kvlcc2_hsva_zigzag/open_water_characteristics.csv",
        "a358b001ec968a928acd3cbc6f8c2f05a803925715ca5d3744d83ca57d6c96f6",
        _MANOEUVRING,
        "data/01_raw/kvlcc2_hsva/open_water_characteristics.csv",
        _HSVA_LICENCE,
    ),
    _hosted(
        "kvlcc2_hmri_captive/captive.csv",
        "f61510bfacb7d651f8ab69b2e2c02300533921cfe2c8452a0297a755ecdb2b26",
        _MANOEUVRING,
        "data/01_raw/kvlcc2/captive.csv",
        _HMRI_LICENCE,
        convert_captive,
    ),
    _hosted(
        "kvlcc2_hmri_captive/open_water_characteristics_captive.csv",
        "ae9d975a18dc3ae664c76c7696a146cb4670aeff966fed44ad26f66c9f5626f3",
        _MANOEUVRING,
        "data/01_raw/kvlcc2/open_water_characteristics_captive.csv",
        _HMRI_LICENCE,
    ),
    _hosted(
        "kvlcc2_roll_decay/model_test_21337.csv",
        "2d98fe330162a61426f54eb3b20af1aace7065aa8ed7f9e2a82302639652af50",
        _ROLL,
        "data/processed/roll decay KVLCC2/model_test_21337.csv",
        "MIT (same data: doi:10.17632/2stvkyngj9.1)",
        convert_roll_decay,
    ),
    *(
        _hosted(
            f"esso_osaka/{day}_{time}.csv",
            sha256,
            _ESSO,
            f"data/{_kind_of_run(day)}/{day}_{time}.csv",
            _ESSO_LICENCE,
        )
        for day, files in _ESSO_FILES.items()
        for time, sha256 in files.items()
    ),
    _hosted(
        "cascaded_tanks/estimation.csv",
        "9735b3dcd0c50e8f418968c0951ee271f2af61425c9e92f2c8103bbc838c8e27",
        _TANKS,
        "dataBenchmark.csv",
        "repository MIT; data of M. Schoukens et al. (2016)",
        convert_tanks,
    ),
    DataFile(
        "silverbox/multisine.csv",
        "0c4d3a8ec38d4ef2b7a2c55089f276d5d5d44c72d2273db6277c584a039368c2",
        "github.com/biaslab/nsi-silverbox, commit 728f07e4539d4f7da76a4778b52a756260b488ac, "
        "data/Silverbox: SNLS80mV, 26000 samples of the multisine part (V1, V2 in V, 610.35 Hz)",
        "repository MIT; data of T. Wigren and J. Schoukens (2013)",
    ),
    DataFile(
        "slocum_glider_comet2016/engineering_raw.csv",
        "32fdf888e16dbe614da408fa8f225d87041a336f781d2120d1e622044270abee",
        "github.com/smerckel/gliderflight, commit 0ad087b9b4d0adf4892c1ed5a3802fb813156c49, "
        "data/dbd, read with dbdreader 0.6.3",
        "MIT (L. Merckelbach, HZG)",
    ),
    DataFile(
        "slocum_glider_comet2016/gliderflight_data.csv",
        "2068705269486c38dfdf24c83b0f2e5592c9a3e26c015d2ddc6202696d4706ec",
        "github.com/smerckel/gliderflight, commit 0ad087b9b4d0adf4892c1ed5a3802fb813156c49, "
        "data/gliderflight_data.npy",
        "MIT (L. Merckelbach, HZG)",
    ),
)
_REGISTRY: dict[str, DataFile] = {file.path: file for file in _FILES}
