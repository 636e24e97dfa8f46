"""Kill long calculations again and again: nothing finished is lost, and the result is the same.

    python -m benchmarks.killed --kills 20

A command is killed (``SIGKILL``) and called again until it ends: every second time blindly, at a
moment drawn from its whole duration, otherwise, if it keeps a journal, as soon as it has finished a
step that was not there before. If it ends before it was killed often enough, it begins anew from
the same state. Every finished step has to be left as it was written, what comes out to equal that
of an undisturbed run to the last bit, and no rest to stay behind.
"""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, Row, exam

RECORDS = ROOT / "problems" / "remus_diving_plane" / "data"
# Times, and how a file was made, differ from run to run.
VOLATILE = ("seconds", "oed_sysid", "duration_s", "made", "sha256")


@dataclass(frozen=True)
class Work:
    """A command that keeps what it has done in a folder.

    Parameters
    ----------
    words : str
        What is killed; ``{folder}`` stands for the folder, ``{records}`` for that of records.
    begin : str
        What makes the state that it begins with; empty where there is none.
    after : str
        What answers from the state alone, where what is killed cannot be called twice.
    """

    words: str
    begin: str = ""
    after: str = ""


def journalled(words: str) -> Work:
    """A command with a journal, and its result as JSON."""
    return Work(f"{words} --json {{folder}}/result.json --journal {{folder}}/journal")


WORKS = {
    "improve": journalled(
        "improve remus_diving_plane {records}/train_steps.csv {records}/train_zigzag_10_10.csv "
        "--validate {records}/test_steps.csv"
    ),
    "design": journalled("design auv_diving_plane --duration 90 --effort thorough --certainty 0.9"),
    "campaign": Work(
        "campaign {folder} --record {records}/train_steps.csv",
        "campaign {folder} --problem remus_diving_plane --goal all=5 --hours 2",
        "campaign {folder} --json {folder}.json",
    ),
    "benchmark": Work(
        "benchmark estimators --problems nomoto_sparse_heading --noise 1 --seeds 2 "
        "--estimators multiple_shooting ekf --out {folder}"
    ),
    "fit, saved": Work("fit remus_diving_plane {records}/train_steps.csv --save {folder}/fit.json"),
}


def killed(work: Work, *, kills: int, rng: np.random.Generator) -> Row:
    """Run a command undisturbed, then killed until it has been killed often enough.

    Parameters
    ----------
    work : Work
    kills : int
        How often to kill.
    rng : numpy.random.Generator
        Draws the times.

    Returns
    -------
    dict
        How often it was killed, finished steps that a later call wrote again or lost, whether what
        came out was equal each time, files that stayed, time of all calls and of an undisturbed
        one, s, and whether nothing was lost.
    """
    with tempfile.TemporaryDirectory() as name:
        made, whole, folder = (Path(name) / part for part in ("made", "whole", "killed"))
        made.mkdir()
        if work.begin:
            _called(work.begin, made).wait()
        began = time.monotonic()
        shutil.copytree(made, whole)
        _called(work.words, whole).wait()
        undisturbed = time.monotonic() - began
        wanted = _state(work, whole)
        assert wanted, "the undisturbed call left nothing"
        began, done, rewritten, rest, equal = time.monotonic(), 0, 0, 0, True
        while done < kills:
            shutil.copytree(made, folder)
            before: dict[str, tuple[int, int]] = {}
            while _struck(work, folder, before, undisturbed * rng.random(), done, kills):
                done += 1
                after = _steps(folder)
                # Where the work was done, what is kept may go.
                if not (folder / "result.json").exists():
                    rewritten += sum(after.get(step) != state for step, state in before.items())
                before = after
            equal &= _state(work, folder) == wanted
            files = [path for path in folder.rglob("*") if path.is_file()]
            rest += sum("journal" in p.parts or p.suffix in (".tmp", ".part") for p in files)
            shutil.rmtree(folder)
        seconds = time.monotonic() - began
    return {
        "killed": done, "steps written again": rewritten, "equal": "yes" if equal else "no",
        "files left": rest, "s": round(seconds), "undisturbed, s": round(undisturbed),
        "ok": equal and not rewritten and not rest,
    }  # fmt: skip


def _struck(
    work: Work, folder: Path, before: Mapping[str, Any], blindly: float, done: int, kills: int
) -> bool:
    """Whether a call was killed, rather than it ended before its blow, or without one."""
    began, process = time.monotonic(), _called(work.words, folder)
    if done >= kills:
        process.wait()
    by_step = "--journal" in work.words and done % 2 == 0
    while process.poll() is None:
        if set(_steps(folder)) - set(before) if by_step else time.monotonic() - began > blindly:
            process.send_signal(signal.SIGKILL)
            process.wait()
            return True
        time.sleep(0.02)
    return False


def _called(words: str, folder: Path) -> subprocess.Popen[bytes]:
    told = [word.format(folder=folder, records=RECORDS) for word in words.split()]
    full = [sys.executable, "-m", "oed_sysid.cli", *told]
    return subprocess.Popen(full, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _steps(folder: Path) -> dict[str, tuple[int, int]]:
    """Time and size of every finished step, by name."""
    found = {}
    for path in folder.rglob("*.step"):
        state = path.stat()
        found[path.name] = (state.st_mtime_ns, state.st_size)
    return found


def _state(work: Work, folder: Path) -> Any:
    """What a state says: its answer, or the numbers of its files."""
    if work.after:
        _called(work.after, folder).wait()
        return _without_times(json.loads(folder.with_suffix(".json").read_text(encoding="utf-8")))
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".json", ".csv"))
    return [
        (path.name, _without_times(json.loads(path.read_text(encoding="utf-8"))))
        if path.suffix == ".json"
        else (path.name, len(path.read_text(encoding="utf-8").splitlines()))
        for path in files
    ]


def _without_times(value: Any) -> Any:
    if isinstance(value, dict):
        return {k: _without_times(v) for k, v in value.items() if k not in VOLATILE}
    return [_without_times(v) for v in value] if isinstance(value, list) else value


def counted(*, kills: int = 20, seed: int = 0) -> list[Row]:
    """What killing each command does to it.

    Parameters
    ----------
    kills : int
        of each command
    seed : int
        of their times
    """
    return [
        {"command": name, **killed(work, kills=kills, rng=np.random.default_rng(seed))}
        for name, work in WORKS.items()
    ]


if __name__ == "__main__":
    exam(counted, lambda row: not row["ok"])
