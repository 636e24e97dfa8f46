"""Files under faults: full disk, no permission, killed writer, foreign hands."""

from __future__ import annotations

import errno
import hashlib
import os
import pickle
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

from oed_sysid import Fit, OedSysidError, new_problem, write_csv
from oed_sysid.cli.terminal import store
from oed_sysid.errors import FileError, ProblemError
from oed_sysid.results import Report, save_figure
from oed_sysid.runtime import files
from oed_sysid.runtime.journal import CellStore

ROOT = Path(__file__).resolve().parent.parent
FIT = Fit.load(ROOT / "tests" / "saved" / "fit_format_1.json")
SMALL = "what was there before\n"


def figure(path: Path) -> None:
    """Write a picture with more than a few bytes."""
    drawn = Figure()
    drawn.subplots().plot(np.sin(np.arange(500.0)))
    save_figure(drawn, path)


WRITERS: dict[str, tuple[str, Callable[[Path], object]]] = {
    "text": ("txt", lambda path: files.write_text(path, "x" * 50_000)),
    "fit": ("json", FIT.save),
    "JSON of a command": ("json", lambda path: store({"values": list(range(9_000))}, path)),
    "CSV": ("csv", lambda path: write_csv(FIT.dataset[0], path)),
    "page": ("html", lambda path: Report("A", "b", ("c" * 50_000,)).write(path)),
    "figure": ("png", figure),
}
writers = pytest.mark.parametrize(("ending", "write"), WRITERS.values(), ids=WRITERS)


@contextmanager
def room_for(n_bytes: int) -> Iterator[None]:
    """Have the system refuse, as on a full disk, any file longer than this."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (n_bytes, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@writers
def test_full_disk_leaves_the_older_file(
    tmp_path: Path, ending: str, write: Callable[[Path], object]
) -> None:
    """A disk that is full in the middle of a file leaves the older one intact and no rest."""
    place = tmp_path / f"result.{ending}"
    place.write_text(SMALL)
    with room_for(600), pytest.raises(OedSysidError, match="cannot be written"):
        write(place)
    assert place.read_text() == SMALL
    assert [entry.name for entry in tmp_path.iterdir()] == [place.name]
    write(place)
    assert place.stat().st_size > 600


@writers
def test_full_disk_at_the_very_end(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    ending: str,
    write: Callable[[Path], object],
) -> None:
    """A disk that is found full only when the file is brought to it is no different."""

    def full(_handle: int) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    place = tmp_path / f"result.{ending}"
    place.write_text(SMALL)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(OedSysidError, match="No space left on device"):
        write(place)
    assert place.read_text() == SMALL
    assert len(list(tmp_path.iterdir())) == 1


@writers
def test_place_that_cannot_be_written(
    tmp_path: Path, ending: str, write: Callable[[Path], object]
) -> None:
    """A file in the way of a folder, and a folder in the way of a file, are said in words."""
    (tmp_path / "file").write_text(SMALL)
    with pytest.raises(FileError, match="cannot be written"):
        write(tmp_path / "file" / f"result.{ending}")
    (tmp_path / f"folder.{ending}").mkdir()
    with pytest.raises(FileError, match="is a folder"):
        write(tmp_path / f"folder.{ending}")


def test_no_permission(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A folder without permission, and a file that the user protected, are not written to."""
    place = tmp_path / "result.txt"
    place.write_text(SMALL)
    open_file = os.open

    def refuse(path: str, flags: int, *rest: int) -> int:
        if flags & os.O_CREAT:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))
        return open_file(path, flags, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(os, "open", refuse)
        with pytest.raises(FileError, match="Permission denied"):
            files.write_text(place, "new")
    with monkeypatch.context() as patch:
        patch.setattr(os, "access", lambda path, mode: False)
        with pytest.raises(FileError, match="write-protected"):
            files.write_text(place, "new")
    assert place.read_text() == SMALL


def test_links_modes_and_devices_are_kept(tmp_path: Path) -> None:
    """A link is written through, permissions stay, a device is written to directly."""
    real, link = tmp_path / "real.txt", tmp_path / "link.txt"
    real.write_text(SMALL)
    real.chmod(0o640)
    link.symlink_to(real)
    files.write_text(link, "new ünd \udc80")
    assert link.is_symlink()
    assert real.read_bytes() == "new ünd \\udc80".encode()
    assert real.stat().st_mode & 0o777 == 0o640
    files.write_text("/dev/null", "gone")
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("round_", range(3))
def test_killed_writer_leaves_a_whole_file(tmp_path: Path, round_: int) -> None:
    """Kill -9 in the middle of writing leaves one of the versions, complete."""
    place = tmp_path / "result.txt"
    program = (
        "import sys; from oed_sysid.runtime.files import write_text\n"
        "for n in range(10**6): write_text(sys.argv[1], f'{n % 10}' * 4_000_000)\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", program, str(place)],
        env=os.environ | {"PYTHONPATH": str(ROOT)},
    )
    deadline = time.monotonic() + 30
    while not place.exists() and time.monotonic() < deadline:
        time.sleep(0.005)
    time.sleep(0.02 + 0.013 * round_)
    process.send_signal(signal.SIGKILL)
    process.wait()
    content = place.read_text()
    assert len(content) == 4_000_000
    assert len(set(content)) == 1


def test_starter_folder_whole_or_not_at_all(tmp_path: Path) -> None:
    """A full disk leaves no half of a starter folder behind."""
    with room_for(2048), pytest.raises(ProblemError, match="cannot be written"):
        new_problem(tmp_path / "my_ship")
    assert not (tmp_path / "my_ship").exists()


# -- whom to trust ---------------------------------------------------------------------


@pytest.mark.parametrize("mode", [0o777, 0o770, 0o722])
def test_folder_that_others_can_write_to_is_not_private(tmp_path: Path, mode: int) -> None:
    """Neither such a folder nor what is in it, however deep, is trusted."""
    inner = tmp_path / "shared" / "inner"
    inner.mkdir(parents=True)
    (inner / "file").write_text("")
    assert files.private(inner / "file")
    (tmp_path / "shared").chmod(mode)
    assert not files.private(tmp_path / "shared")
    # The user's own group may hold the folders above, but never the file itself.
    if mode != 0o770:
        assert not files.private(inner / "file")


def test_what_another_user_owns_is_not_private(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Files of another user are not trusted, whatever their permissions."""
    (tmp_path / "file").write_text("")
    assert files.private(tmp_path / "file")
    monkeypatch.setattr(files, "user", lambda: os.geteuid() + 1)
    assert not files.private(tmp_path / "file")
    assert not files.private(tmp_path / "missing")


PLANTED = "int answer(void) { return 666; }"
OURS = "int answer(void) { return 1; }"


ANSWER = f"""
from oed_sysid.compiled.compile import load_source
print(load_source("answer", lambda: "{OURS}", what="a number").answer())
"""
KEY = "from oed_sysid.runtime.files import secret_key; print(secret_key().hex())"


def plant(folder: Path) -> None:
    """Put another library, with its right digest, where ours is kept."""
    (library,) = folder.glob("answer-*.so")
    code = folder / "planted.c"
    code.write_text(PLANTED)
    built = folder / "planted.so"
    subprocess.run(["cc", "-shared", "-fPIC", str(code), "-o", str(built)], check=True)
    os.replace(built, library)
    library.with_suffix(".sha256").write_text(hashlib.sha256(library.read_bytes()).hexdigest())


def fresh(program: str, cache: Path) -> str:
    """What a program prints in a process of its own, with its warnings."""
    done = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"OED_SYSID_CACHE": str(cache), "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip() + done.stderr


def test_planted_kernel_is_not_loaded(tmp_path: Path) -> None:
    """A library with a right digest in a folder that others can write to never runs."""
    assert fresh(ANSWER, tmp_path).startswith("1")
    plant(tmp_path)
    # In a private folder the user put it there; this shows that the plant would work.
    assert fresh(ANSWER, tmp_path).startswith("666")
    tmp_path.chmod(0o777)
    said = fresh(ANSWER, tmp_path)
    assert said.startswith("1")
    assert "Others can write to" in said
    assert "chmod go-w" in said


def test_library_that_others_can_change_is_built_again(tmp_path: Path) -> None:
    """In a private folder, one library with loose permissions is replaced by our own."""
    assert fresh(ANSWER, tmp_path).startswith("1")
    plant(tmp_path)
    (library,) = tmp_path.glob("answer-*.so")
    library.chmod(0o777)
    assert fresh(ANSWER, tmp_path).startswith("1")
    assert library.stat().st_mode & 0o022 == 0


class Bomb:
    """A pickle that leaves a trace when it is read."""

    def __init__(self, trace: Path) -> None:
        self.trace = trace

    def __reduce__(self) -> tuple:
        return (Path.write_text, (self.trace, "ran"))


def test_foreign_cell_is_never_unpickled(tmp_path: Path) -> None:
    """A cell with the digest that anyone can make is left alone; our own is read."""
    trace, cells = tmp_path / "trace", CellStore(tmp_path / "cells")
    cells.write("ours", 1.5)
    body = pickle.dumps(("theirs", Bomb(trace)))
    cells.path("theirs").write_bytes(hashlib.sha256(body).digest() + body)
    assert cells.find(["ours", "theirs"]) == {"ours": 1.5}
    assert not trace.exists()


def test_key_is_secret_and_lasts(tmp_path: Path) -> None:
    """Two processes share one key, which only the user can read; a loose one is replaced."""
    first = fresh(KEY, tmp_path)
    assert len(first) == 64
    assert fresh(KEY, tmp_path) == first
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
    (tmp_path / "key").chmod(0o644)
    assert fresh(KEY, tmp_path) != first
    assert (tmp_path / "key").stat().st_mode & 0o777 == 0o600
