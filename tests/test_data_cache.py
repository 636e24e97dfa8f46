"""Third-party data is used where it is, recognised by digest, and never half-written."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from oed_sysid.data import third_party as data_cache
from oed_sysid.data.third_party import DataFile
from oed_sysid.errors import DataError

# Head and tail of the published HSVA_CPMC_KVLCC2_Z_10_10_S.dat (columns narrowed).
HSVA_DAT = """\
 HSVA, experimental data CPMC
 KVLCC2
 Z10\N{DEGREE SIGN}/10\N{DEGREE SIGN} starting to starboard
 Time series of motions
 .000000000 2.933305000 -.007193220 .000000010 1.177561350 -.003030130 -.000286057 .012336880\
 .000000000 10.229500000 40.974000000 1.021930000
 1.200000000 4.345051700 -.010017870 .002092630 1.176769120 -.004495190 .079950649 .049971660\
 -5.517580000 10.229500000 44.423000000 1.079360000
 66.950000000 73.919864000 .929713510 -30.021376590 .908725230 -.514772730 .360638775 .042913600\
 -9.985350000 10.229500000 46.763000000 1.122940000
 67.000000000 73.965247580 .904039510 -30.001994480 .908321930 -.515217610 .367562368 .054969630\
 -9.985350000 10.229500000 46.847000000 1.125220000
"""
HSVA_CSV = """\
t_s,x0_m,y0_m,psi_deg,dx0_mps,dy0_mps,r_degps,phi_deg_inferred,delta_deg,n_rps,thrust_N,\
torque_Nm,u_mps_derived,v_mps_derived
0,2.933305,-0.00719322,1e-08,1.1775613,-0.00303013,-0.000286057,0.01233688,0,10.2295,40.974,\
1.02193,1.1775613,-0.0030301302
1.2,4.3450517,-0.01001787,0.00209263,1.1767691,-0.00449519,0.079950649,0.04997166,-5.51758,\
10.2295,44.423,1.07936,1.176769,-0.0045381695
66.95,73.919864,0.92971351,-30.021377,0.90872523,-0.51477273,0.36063878,0.0429136,-9.98535,\
10.2295,46.763,1.12294,1.0443622,0.0089459973
67,73.965248,0.90403951,-30.001994,0.90832193,-0.51521761,0.36756237,0.05496963,-9.98535,\
10.2295,46.847,1.12522,1.0442384,0.0080057765
"""


def digest(content: bytes) -> str:
    """SHA-256 of some bytes."""
    return hashlib.sha256(content).hexdigest()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty data folder, named by the environment."""
    monkeypatch.setenv("OED_SYSID_DATA", str(tmp_path))
    return tmp_path


@pytest.fixture
def register(monkeypatch: pytest.MonkeyPatch) -> Callable[[DataFile], str]:
    """Add a file to the registry for one test."""

    def add(file: DataFile) -> str:
        monkeypatch.setitem(data_cache._REGISTRY, file.path, file)
        return file.path

    return add


def test_folder_is_named_by_the_environment(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """OED_SYSID_DATA decides; without it the user's cache is taken."""
    assert data_cache.data_folder() == folder
    monkeypatch.delenv("OED_SYSID_DATA")
    assert "oed_sysid" in str(data_cache.data_folder())


def test_present_file_is_used_without_network(
    folder: Path, register: Callable[[DataFile], str]
) -> None:
    """A converted file with the right digest is returned as it is."""
    content = b"t_s,y_V\n0,1\n"
    path = register(DataFile("set/a.csv", digest(content), "a repository", "MIT"))
    (folder / "set").mkdir()
    (folder / path).write_bytes(content)
    assert data_cache.fetch(path) == folder / path


def test_damaged_file_is_refused(folder: Path, register: Callable[[DataFile], str]) -> None:
    """Another digest is an error, not a silent use."""
    path = register(DataFile("set/a.csv", digest(b"good"), "a repository", "MIT"))
    (folder / "set").mkdir()
    (folder / path).write_bytes(b"bad")
    with pytest.raises(DataError, match="SHA-256 differs"):
        data_cache.fetch(path)


def test_download_is_converted_and_kept(
    folder: Path,
    tmp_path: Path,
    register: Callable[[DataFile], str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The original is fetched once, converted, checked and stored under its registered name."""
    asked = []

    def retrieve(url: str, known_hash: str | None, path: Path, progressbar: bool) -> str:
        asked.append((url, known_hash))
        original = tmp_path / "original.dat"
        original.write_bytes(HSVA_DAT.encode("latin-1"))
        return str(original)

    monkeypatch.setattr("pooch.retrieve", retrieve)
    path = register(
        DataFile(
            "set/z.csv",
            digest(HSVA_CSV.encode()),
            "a repository",
            "MIT",
            "https://example.org/z.dat",
            data_cache.convert_hsva,
        )
    )
    for _ in range(2):
        assert data_cache.fetch(path).read_text() == HSVA_CSV
    assert asked == [("https://example.org/z.dat", None)]
    wrong = register(
        DataFile("set/y.csv", "0" * 64, "a repository", "MIT", "https://example.org/y.dat")
    )
    with pytest.raises(DataError, match="The source has changed"):
        data_cache.fetch(wrong)
    assert not (folder / wrong).exists()


def test_offline_message_says_what_to_do(
    folder: Path, register: Callable[[DataFile], str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without network, or without a convertible source, the way by hand is named."""

    def unreachable(*_: object, **__: object) -> str:
        raise ConnectionError("no route to host")

    monkeypatch.setattr("pooch.retrieve", unreachable)
    url = "https://example.org/a.dat"
    path = register(DataFile("set/a.csv", "0" * 64, "a repository", "MIT", url))
    with pytest.raises(DataError, match=r"no route to host.*OED_SYSID_DATA"):
        data_cache.fetch(path)
    local = register(DataFile("set/b.csv", "0" * 64, "the author's archive", "MIT"))
    with pytest.raises(DataError, match=r"the author's archive.*OED_SYSID_DATA"):
        data_cache.fetch(local)


def test_unknown_name_gets_the_nearest() -> None:
    """A misspelt name is answered with the right one."""
    with pytest.raises(DataError, match=r"Did you mean 'silverbox/multisine\.csv'"):
        data_cache.fetch("silverbox/multisin.csv")
    with pytest.raises(DataError, match="register has no data file"):
        data_cache.fetch("nothing/")


def test_registry_is_complete() -> None:
    """Every entry has a digest, a source and a licence note; sources are pinned to a commit."""
    for path in data_cache.registered():
        file = data_cache.describe(path)
        assert len(file.sha256) == 64
        assert file.source
        assert file.licence
        if file.url:
            assert file.url.split("/")[5] in file.source


def test_hsva_conversion_gives_the_registered_form() -> None:
    """Rows of the published file become the registered rows, digit by digit."""
    assert data_cache.convert_hsva(HSVA_DAT.encode("latin-1")).decode() == HSVA_CSV


def test_other_conversions() -> None:
    """Roll decay, captive tests and tanks: headers with units, rounding, selection."""
    decay = (
        b"time,x,y,z,phi,theta,psi\n"
        b"0.0,-33.434045632576,-0.0032978987829735185,0.00016423687319265282,"
        b"0.00017453292519943296,8.726646259971648e-05,6.279694648675597\n"
        b"0.010003089904785156,-33.434045632576,-0.0032978987829735185,0.00016423687319265282,"
        b"0.00017453292519943296,-8.726646259971648e-05,6.279694648675597\n"
    )
    assert data_cache.convert_roll_decay(decay).decode().splitlines() == [
        "t_s,x_m,y_m,z_m,phi_rad,theta_rad,psi_rad",
        "0,-33.43405,-0.003297899,0.0001642369,0.0001745329,8.726646e-05,6.279695",
        "0.01000309,-33.43405,-0.003297899,0.0001642369,0.0001745329,-8.726646e-05,6.279695",
    ]
    captive = b"Run No.,test type\r\n319,rudder angle\r\n357,drift + rudder angle\r\n"
    assert data_cache.convert_captive(captive) == b"Run No.,test type\r\n319,rudder angle\r\n"
    tanks = b'"uEst","uVal","yEst","yVal","Ts",\n3.2567,1,5.205,2,4,\n3.2466,1,5.2154,2,,\n'
    assert data_cache.convert_tanks(tanks) == b"t_s,u_V,y_V\n0,3.2567,5.205\n4,3.2466,5.2154\n"


@pytest.mark.skipif(
    not (data_cache.data_folder() / "kvlcc2_hsva_zigzag").is_dir(),
    reason="third-party data is not in OED_SYSID_DATA",
)
def test_measured_zigzag_is_consistent() -> None:
    """Velocities of the measured 10/10 zigzag are the derivatives of its positions."""
    path = data_cache.fetch("kvlcc2_hsva_zigzag/HSVA_CPMC_KVLCC2_Z_10_10_S.csv")
    data = np.genfromtxt(path, delimiter=",", names=True)
    slope = np.gradient(data["x0_m"], data["t_s"])
    assert np.sqrt(np.mean((slope - data["dx0_mps"]) ** 2)) < 1e-3
