"""Kill long calculations again and again: nothing finished is lost, and the result is the same.

    python -m benchmarks.killed --kills 20

A command is killed (``SIGKILL``), every second time blindly within its first three seconds,
otherwise as soon as it has finished a step that was not there before, and called again until it
ends. Every finished step has to be left as it was written, the result to equal that of an
undisturbed run to the last bit, and no rest to stay behind. What keeps its state in a folder is
killed at moments drawn from its whole duration, each time from the same state.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, Row, exam

RECORDS = ROOT / "problems" / "remus_diving_plane" / "data"
COMMANDS: Mapping[str, tuple[str, ...]] = {
    "improve": (
        "improve",
        "remus_diving_plane",
        *(str(RECORDS / f"train_{name}.csv") for name in ("steps", "zigzag_10_10")),
        "--validate",
        str(RECORDS / "test_steps.csv"),
    ),
    "design": (
        *("design", "auv_diving_plane", "--duration", "90", "--effort", "thorough"),
        *("--certainty", "0.9"),
    ),
}
# Times, and how a file was made, differ from run to run.
VOLATILE = ("seconds", "oed_sysid", "duration_s", "made", "sha256")


@dataclass(frozen=True)
class Outcome:
    """What came of one command that was killed again and again.

    Attributes
    ----------
    kills : int
        How often it was killed; less than asked for if it ended before.
    rewritten : int
        Finished steps that a later call wrote again or lost.
    equal : bool
        Whether the result is that of the undisturbed run.
    left : int
        Files that stayed in the journal's folder.
    seconds, undisturbed : float
        Time of all calls together, and of one undisturbed call, s.
    """

    kills: int
    rewritten: int
    equal: bool
    left: int
    seconds: float
    undisturbed: float

    @property
    def ok(self) -> bool:
        """Whether nothing was lost."""
        return self.equal and not self.rewritten and not self.left


def killed(command: Sequence[str], *, kills: int, rng: np.random.Generator) -> Outcome:
    """Run a command undisturbed, then killed until it has been killed often enough.

    Parameters
    ----------
    command : sequence of str
        Arguments of ``oed-sysid`` without those for the result and the journal.
    kills : int
        How often to kill.
    rng : numpy.random.Generator
        Draws the times.
    """
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        began = time.monotonic()
        _start(command, place / "whole.json", place / "other").wait()
        undisturbed = time.monotonic() - began
        began, done, rewritten = time.monotonic(), 0, 0
        while True:
            before = _steps(place / "journal")
            process = _start(command, place / "killed.json", place / "journal")
            # Every second kill is blind, the others come when something new has been finished.
            if done < kills and done % 2:
                _wait(process, 3.0 * rng.random(), lambda: False)
            elif done < kills:
                known = set(before)
                _wait(process, np.inf, lambda known=known: set(_steps(place / "journal")) - known)
            else:
                process.wait()
            if process.poll() is not None:
                break
            process.send_signal(signal.SIGKILL)
            process.wait()
            done += 1
            if (place / "killed.json").exists():
                continue  # the work was done: what is kept may go
            after = _steps(place / "journal")
            rewritten += sum(after.get(name) != state for name, state in before.items())
        seconds = time.monotonic() - began
        equal = _result(place / "whole.json") == _result(place / "killed.json")
        left = sum(path.is_file() for path in (place / "journal").rglob("*"))
    return Outcome(done, rewritten, equal, left, seconds, undisturbed)


def _start(command: Sequence[str], result: Path, journal: Path) -> subprocess.Popen[bytes]:
    return _process([*command, "--json", str(result), "--journal", str(journal)])


def _process(words: Sequence[str]) -> subprocess.Popen[bytes]:
    full = [sys.executable, "-m", "oed_sysid.cli", *words]
    return subprocess.Popen(full, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _wait(process: subprocess.Popen[bytes], most: float, ready: Callable[[], object]) -> None:
    """Wait until something is ready, the process has ended, or the time is over."""
    began = time.monotonic()
    while process.poll() is None and time.monotonic() - began < most and not ready():
        time.sleep(0.02)


def _steps(journal: Path) -> dict[str, tuple[int, int]]:
    """Time and size of every finished step, by name."""
    found = {}
    for path in journal.rglob("*.step"):
        state = path.stat()
        found[path.name] = (state.st_mtime_ns, state.st_size)
    return found


def _result(path: Path) -> Any:
    return _without_times(json.loads(path.read_text(encoding="utf-8")))


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if k not in VOLATILE}
    return [_without_times(v) for v in value] if isinstance(value, list) else value


@dataclass(frozen=True)
class Work:
    """A command that keeps its state in a folder of its own.

    Parameters
    ----------
    begin : tuple of str
        What makes the state, undisturbed; empty where there is none.
    words : tuple of str
        What is killed; ``{folder}`` stands for the folder.
    after : tuple of str
        What answers from the state alone, where what is killed cannot be called twice.
    """

    begin: tuple[str, ...]
    words: tuple[str, ...]
    after: tuple[str, ...] = ()


FOLDER = "{folder}"
WORKS: Mapping[str, Work] = {
    "campaign": Work(
        ("campaign", FOLDER, "--problem", "remus_diving_plane", "--goal", "all=5", "--hours", "2"),
        ("campaign", FOLDER, "--record", str(RECORDS / "train_steps.csv")),
        ("campaign", FOLDER),
    ),
    "benchmark": Work(
        (),
        ("benchmark", "estimators", "--problems", "nomoto_sparse_heading", "--noise", "1",
         "--seeds", "2", "--estimators", "multiple_shooting", "ekf", "--out", FOLDER),
    ),
    "fit, saved": Work(
        (),
        ("fit", "remus_diving_plane", str(RECORDS / "train_steps.csv"), "--save",
         f"{FOLDER}/fit.json"),
    ),
}  # fmt: skip


def struck(work: Work, *, kills: int, rng: np.random.Generator) -> Outcome:
    """Kill what keeps its state in a folder at random moments, and call it again each time."""
    with tempfile.TemporaryDirectory() as name:
        place = Path(name)
        made, whole = place / "made", place / "whole"
        if work.begin:
            _call(work.begin, made)
        began = time.monotonic()
        _copied(made, whole)
        _call(work.words, whole)
        undisturbed = time.monotonic() - began
        wanted, same, rest, done = _state(work, whole), True, 0, 0
        assert wanted, "the undisturbed call left nothing"
        began = time.monotonic()
        for kill in range(kills):
            folder = place / f"killed_{kill}"
            _copied(made, folder)
            process = _process(_within(work.words, folder))
            _wait(process, undisturbed * rng.random(), lambda: False)
            if process.poll() is None:
                process.send_signal(signal.SIGKILL)
                process.wait()
                done += 1
            # What was finished before the blow may be refused the second time.
            _call(work.words, folder)
            same &= _state(work, folder) == wanted
            rest += sum(path.is_file() and path.suffix in (".tmp", ".part")
                        for path in folder.rglob("*"))  # fmt: skip
        return Outcome(done, 0, same, rest, time.monotonic() - began, undisturbed)


def _copied(made: Path, folder: Path) -> None:
    if made.exists():
        shutil.copytree(made, folder)


def _within(words: Sequence[str], folder: Path) -> list[str]:
    return [word.format(folder=folder) for word in words]


def _call(words: Sequence[str], folder: Path, *more: str) -> None:
    _process([*_within(words, folder), *more]).wait()


def _state(work: Work, folder: Path) -> Any:
    """What a state says: its answer, or the numbers of its files."""
    if work.after:
        answer = folder.with_suffix(".json")
        _call(work.after, folder, "--json", str(answer))
        return _result(answer)
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".json", ".csv"))
    return [
        (path.name, _result(path) if path.suffix == ".json" else len(path.read_text().splitlines()))
        for path in files
    ]


def counted(*, kills: int = 20, seed: int = 0) -> list[Row]:
    """What killing each command does to it.

    Parameters
    ----------
    kills : int
        of each command
    seed : int
        of their times
    """
    rows, rng = list[Row](), np.random.default_rng
    found = {name: killed(words, kills=kills, rng=rng(seed)) for name, words in COMMANDS.items()}
    found |= {name: struck(work, kills=kills, rng=rng(seed)) for name, work in WORKS.items()}
    for name, one in found.items():
        rows.append({"command": name, "killed": one.kills, "steps written again": one.rewritten,
                     "equal": "yes" if one.equal else "no", "files left": one.left,
                     "s": round(one.seconds), "undisturbed, s": round(one.undisturbed),
                     "ok": one.ok})  # fmt: skip
    return rows


if __name__ == "__main__":
    exam(counted, lambda row: not row["ok"])
