"""Parsers of foreign files in a process of their own, with limits of time, memory and numbers.

A damaged or hostile file makes a parser raise, loop, fill the memory or end the process. Whatever
it does happens to a child: the parent reads arrays without code (``.npz``, no pickles) and a
sentence, or says how the child ended.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path

import numpy as np

from oed_sysid.data.log import Log, Series
from oed_sysid.errors import DataError
from oed_sysid.runtime.constants import TABLE_BYTES

# Of computing: at least, and more per byte of the file.
SECONDS, SECONDS_PER_BYTE = 10.0, 5e-6
# Libraries of tables take tens of bytes for each of a compressed file.
MEMORY_PER_BYTE = 30
# Wall time over computing time: a machine may have other work.
PATIENCE = 6.0
# Numbers of one log.
MOST_NUMBERS = TABLE_BYTES // np.dtype(float).itemsize

# What a log says in words.
_WORDS = ("kind", "origin", "notes", "clock", "clock_unit")

_CHILD = "import json, sys; sys.path[:] = json.loads(sys.argv[1]); from oed_sysid.data import "
_CHILD += "formats; formats.serve(sys.argv[2], sys.argv[3])"


def read_apart(place: Path, words: str, advice: str) -> Log:
    """Read a log in a child process.

    Parameters
    ----------
    place : Path
        The file or folder.
    words : str
        What its format is called, for messages.
    advice : str
        What to do where the file is damaged.

    Raises
    ------
    DataError
        With the child's own words, or with how it ended.
    """
    size = sum(one.stat().st_size for one in (place, *place.rglob("*")) if one.is_file())
    seconds, memory = SECONDS + SECONDS_PER_BYTE * size, TABLE_BYTES + MEMORY_PER_BYTE * size
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        target = Path(folder) / "log.npz"
        command = [sys.executable, "-c", _CHILD, json.dumps(sys.path), str(place), str(target)]
        environment = os.environ | {
            "OED_SYSID_LIMITS": f"{seconds:.0f} {memory}",
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",  # each thread reserves memory
        }
        damaged = f"{place.name} cannot be read as {words}"
        try:
            child = subprocess.run(
                command,
                env=environment,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=PATIENCE * seconds,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise DataError(
                f"{damaged}: no end after {PATIENCE * seconds:.0f} s. {advice}"
            ) from None
        if child.returncode == 0 and target.exists():
            return _loaded(place, target)
        told = target.with_suffix(".txt")
        if told.exists():
            raise DataError(told.read_text("utf-8"))
        ended = f"ended with {child.returncode}"
        if child.returncode == -getattr(signal, "SIGXCPU", 0):
            ended = f"did not end after {seconds:.0f} s"
        elif child.returncode < 0:
            ended = f"crashed ({signal.Signals(-child.returncode).name})"
        last = child.stderr.decode("utf-8", "replace").strip().rpartition("\n")[2][:100]
        raise DataError(f"{damaged}: its parser {ended}{f' ({last})' if last else ''}. {advice}")


def guarded(reader: Callable[[Path], Log], place: Path, words: str, advice: str) -> Log:
    """Read a log; whatever goes wrong is a message with the file, and the byte where known."""
    try:
        log = reader(place)
    except DataError:
        raise
    except MemoryError:
        raise DataError(
            f"{place.name} cannot be read as {words}: it asks for more memory than a log of its "
            f"size can need. {advice}"
        ) from None
    except (Exception, SystemExit) as error:  # whatever a damaged file makes of a library
        at = next(
            (getattr(error, n) for n in ("start", "pos", "offset") if hasattr(error, n)), None
        )
        place_in = f" at byte {at}" if isinstance(at, int) else ""
        said = " ".join(str(error).split())[:120] or type(error).__name__
        raise DataError(
            f"{place.name} cannot be read as {words}{place_in} ({said}). {advice}"
        ) from None
    numbers = sum(series.values.size for series in log.series)
    if numbers > MOST_NUMBERS:
        raise DataError(
            f"{place.name} holds {numbers:.2g} numbers, more than {MOST_NUMBERS:.2g}. Cut it into "
            "parts."
        )
    return log


def serve(read: Callable[[Path], Log], place: Path, target: Path) -> None:
    """Read a log within the limits of the environment and leave it, or a sentence, in files."""
    seconds, memory = map(int, os.environ["OED_SYSID_LIMITS"].split())
    try:
        import resource
    except ImportError:  # Windows: the parent's clock is the only limit
        pass
    else:
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 1))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    try:
        log = read(place)
        _save(log, target)
    except DataError as error:
        target.with_suffix(".txt").write_text(str(error), "utf-8")
        sys.exit(2)


def _save(log: Log, target: Path) -> None:
    """Keep a log: the times of a topic once, all fields, and words as JSON."""
    arrays: dict[str, np.ndarray] = {}
    places: dict[int, str] = {}
    rows = []
    for index, one in enumerate(log.series):
        clock = places.setdefault(id(one.times), f"t{index}")
        arrays |= {clock: one.times, f"v{index}": one.values}
        rows.append((one.name, clock, one.unit, one.derived))
    told = {one.name: getattr(log, one.name) for one in fields(Log) if one.name in _WORDS}
    words = json.dumps({**told, "rows": rows})
    np.savez(target, words=np.array(words), **arrays)  # type: ignore[arg-type]


def _loaded(place: Path, target: Path) -> Log:
    """The log that a child left."""
    with np.load(target, allow_pickle=False) as arrays:
        words = json.loads(str(arrays["words"]))
        clocks = {clock: arrays[clock] for _, clock, _, _ in words["rows"]}
        series = tuple(
            Series(name, clocks[clock], arrays[f"v{index}"], unit, derived)
            for index, (name, clock, unit, derived) in enumerate(words["rows"])
        )
    told = {name: words[name] for name in _WORDS}
    return Log(place, series=series, **told | {"notes": tuple(told["notes"])})
