"""Damaged logs of eight formats: what their parsers do, each in a process of its own.

    python -m benchmarks.damaged --files 800 --seed 1

Good logs are cut, overwritten, shuffled and given lengths that are none; inside the archive of a
workbook as well. Counted by format: read, refused in words, ended by the limits or by a crash
(which the parent says in words too), and what no rule foresaw: a traceback of the child, or more
than ten seconds of computing.
"""

from __future__ import annotations

import io
import os
import random
import signal
import sys
import tempfile
import warnings
import zipfile
from collections import Counter
from pathlib import Path

import numpy as np

from benchmarks.fuzz import mangled
from benchmarks.harness import ROOT, Row, exam
from oed_sysid.data import formats
from oed_sysid.runtime.constants import TABLE_BYTES

sys.path.insert(0, str(ROOT / "tests"))

from log_writers import Voyage, write_bag, write_dataflash, write_mcap, write_nmea, write_ulog

LIMIT = 10  # s of computing
FORMATS = {
    ".xlsx": "Excel", ".parquet": "Parquet", ".mat": "MATLAB", ".ulg": "PX4 ULog",
    ".bin": "ArduPilot DataFlash", ".bag": "ROS 1 bag", ".mcap": "MCAP", ".nmea": "NMEA 0183",
}  # fmt: skip
WORDS = {
    "read": "read", "refused": "refused in words", "SIGXCPU": "ended by the limits",
    "uncaught": "uncaught",
}  # fmt: skip


def good_files(folder: Path) -> list[Path]:
    """One log of each format."""
    import pandas
    from openpyxl import Workbook
    from scipy.io import savemat

    v = Voyage(np.arange(0.0, 12.0, 0.1), np.arange(0.0, 12.0, 0.1), np.arange(-0.5, 12.0, 2.0))
    psi, r, rudder = v.psi(v.t_psi), v.r(v.t_r), v.rudder(v.t_rudder)
    columns = {"t [s]": v.t_psi, "psi [deg]": np.degrees(psi), "r [deg/s]": np.degrees(r)}
    book = Workbook()
    book.active.append(list(columns))
    for row in zip(*columns.values(), strict=True):
        book.active.append([float(value) for value in row])
    book.save(folder / "run.xlsx")
    pandas.DataFrame(columns).to_parquet(folder / "run.parquet")
    savemat(folder / "run.mat", {"run": {"t": v.t_psi, "psi": psi}}, do_compression=True)
    return [
        folder / "run.xlsx",
        folder / "run.parquet",
        folder / "run.mat",
        write_ulog(
            folder / "run.ulg",
            {
                "vehicle_attitude": (v.t_psi, {"q": v.quaternion(v.t_psi)}),
                "actuator_controls_0": (v.t_rudder, {"control": rudder}),
            },
        ),
        write_dataflash(
            folder / "run.bin",
            {"ATT": (v.t_psi, {"Yaw": np.degrees(psi)}), "IMU": (v.t_r, {"GyrZ": r})},
            {"ATT.Yaw": "h", "IMU.GyrZ": "E"},
        ),
        write_bag(folder / "run.bag", v, version=1),
        write_mcap(folder / "run.mcap", {"nav": (v.t_psi, {"psi": psi})}),
        write_nmea(folder / "run.nmea", v, stamped=True),
    ]


def damaged(rng: random.Random, content: bytes) -> bytes:
    """A log that was cut, overwritten, or whose parts were moved."""
    if content.startswith(b"PK") and rng.random() < 0.5:
        return _workbook(rng, content)
    return mangled(
        rng, content, rng.randbytes, (b"\0", b"\xff", b"\x7f", b"9"), (1, 2, 4, 8, 64, 700)
    )


def _workbook(rng: random.Random, content: bytes) -> bytes:
    """A workbook whose archive is whole and whose sheets are damaged."""
    out = io.BytesIO()
    with zipfile.ZipFile(io.BytesIO(content)) as old, zipfile.ZipFile(out, "w") as new:
        for name in old.namelist():
            part = old.read(name)
            if rng.random() < (0.7 if "sheet" in name else 0.1):
                part = part.replace(b"A1:C121", rng.choice((b"A1:XFD1048576", b"C9:A1", b"x")))
                part = damaged(rng, part)
            new.writestr(name, part)
    return out.getvalue()


def outcome(path: Path, target: Path) -> tuple[str, float]:
    """How a child ends that reads a file as :func:`oed_sysid.data.open_log` has it read."""
    child = os.fork()
    if child == 0:
        os.environ["OED_SYSID_LIMITS"] = f"{LIMIT} {TABLE_BYTES}"
        os.dup2(os.open(os.devnull, os.O_WRONLY), 2)
        code = 1
        try:
            formats.serve(str(path), str(target))
            code = 0
        except SystemExit as end:
            code = int(end.code or 0)
        finally:
            os._exit(code)
    _, status, used = os.wait4(child, 0)
    seconds = used.ru_utime + used.ru_stime
    if os.WIFSIGNALED(status):
        return signal.Signals(os.WTERMSIG(status)).name, seconds
    words = {0: "read", 2: "refused"}.get(os.WEXITSTATUS(status), "uncaught")
    told = target.with_suffix(".txt")
    if words == "refused" and path.name not in told.read_text("utf-8"):
        words = "uncaught"
    return words, seconds


def counted(*, files: int = 800, seed: int = 1) -> list[Row]:
    """Outcomes by format, and the longest time, s.

    Parameters
    ----------
    files : int
        how many are damaged
    seed : int
        of the damage
    """
    warnings.simplefilter("ignore")
    rng, tally = random.Random(seed), Counter[tuple[str, str]]()
    slowest: dict[str, float] = {}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        good = good_files(folder)
        for number in range(files):
            source = good[number % len(good)]
            path = folder / f"damaged{source.suffix}"
            path.write_bytes(damaged(rng, source.read_bytes()))
            words, seconds = outcome(path, folder / "out.npz")
            tally[source.suffix, words] += 1
            slowest[source.suffix] = max(slowest.get(source.suffix, 0.0), seconds)
            if words == "uncaught":
                print(f"uncaught: file {number} of seed {seed}, {source.suffix}")
    ended = {kind for _, kind in tally} - {*WORDS}
    rows = list[Row]()
    for suffix, name in FORMATS.items():
        counts = {words: tally[suffix, kind] for kind, words in WORDS.items()}
        # A parser that is ended in other ways has crashed; the reader says so in words.
        counts["crash"] = sum(tally[suffix, kind] for kind in ended)
        rows.append({"format": name, "files": sum(counts.values()), **counts,
                     "slowest, s": round(slowest.get(suffix, 0.0), 2)})  # fmt: skip
    return rows


if __name__ == "__main__":
    exam(counted, lambda row: row["uncaught"] or row["slowest, s"] > LIMIT)
