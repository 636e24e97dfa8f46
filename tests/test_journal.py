"""Long calculations that are cut off: what was finished is kept, and the next call goes on."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from benchmarks.killed import journalled, killed
from oed_sysid import Limits, new_problem
from oed_sysid.likelihood.archive import encode
from oed_sysid.runtime.journal import Journal, opened, package_digest

# Three steps of random numbers; the number of calls of the work is written beside.
THREE_STEPS = """
import os, signal, sys
from pathlib import Path
import numpy as np
from oed_sysid.runtime.journal import Journal

folder, last = Path(sys.argv[1]), int(sys.argv[2])
journal = Journal(folder / "journal", tell=print)
journal.open({"task": "three steps"})
rng = np.random.default_rng(5)
numbers = []
for step in range(3):
    def work():
        with open(folder / "calls", "a") as file:
            file.write(f"{step}\\n")
        return rng.standard_normal(3)
    numbers.append(journal.once("draw", work, rng=rng))
    if step == last:
        os.kill(os.getpid(), signal.SIGKILL)
numbers = [n.tolist() for n in numbers]
(folder / "numbers").write_text(repr([*numbers, float(rng.random())]))
"""


@pytest.fixture(autouse=True)
def interruptible() -> Iterator[None]:
    """Ctrl-C as in a terminal: a process in the background begins with it ignored."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def journal_of(folder: Path, task: str = "test") -> Journal:
    """A journal that is open."""
    journal = Journal(folder)
    journal.open({"task": task})
    return journal


def test_killed_process_goes_on_where_it_was(tmp_path: Path) -> None:
    """Killed after every step, a program does each step once and draws the same numbers."""
    for last in (0, 1, 9):
        run = [sys.executable, "-c", THREE_STEPS, str(tmp_path), str(last)]
        subprocess.run(run, check=last == 9)
    rng = np.random.default_rng(5)
    expected = [rng.standard_normal(3).tolist() for _ in range(3)]
    assert (tmp_path / "numbers").read_text() == repr([*expected, float(rng.random())])
    assert (tmp_path / "calls").read_text().split() == ["0", "1", "2"]


@pytest.mark.slow
def test_killed_command_ends_with_the_same_result() -> None:
    """A design, killed twice: no step is done twice, the result is equal."""
    command = journalled("design auv_diving_plane --duration 60")
    found = killed(command, kills=2, rng=np.random.default_rng(1))
    assert (found["killed"], found["equal"]) == (2, "yes")
    assert (found["steps written again"], found["files left"]) == (0, 0)


def test_torn_and_planted_steps_are_done_again(tmp_path: Path) -> None:
    """A step that is cut short, or was written by somebody else, is never unpickled."""
    journal_of(tmp_path).once("number", lambda: 1.5)
    (file,) = tmp_path.glob("*/*.step")
    whole = file.read_bytes()
    for content in (whole[:-3], whole[:20], b"", bytes(32) + whole[32:]):
        file.write_bytes(content)
        assert journal_of(tmp_path).once("number", lambda: 2.5) == 2.5
        assert journal_of(tmp_path).once("number", lambda: 3.5) == 2.5


def test_other_content_is_another_journal(tmp_path: Path) -> None:
    """Steps belong to what shaped them: other settings, another label, another program."""
    assert journal_of(tmp_path, "a").once("number", lambda: 1) == 1
    assert journal_of(tmp_path, "b").once("number", lambda: 2) == 2
    assert journal_of(tmp_path, "a").once("other", lambda: 3) == 3
    assert len(package_digest()) == 64


def test_fresh_forgets_and_close_removes(tmp_path: Path) -> None:
    """Starting over calculates again; after the end nothing is left."""
    journal_of(tmp_path).once("number", lambda: 1)
    said: list[str] = []
    again = Journal(tmp_path, fresh=True, tell=said.append)
    again.open({"task": "test"})
    assert again.once("number", lambda: 2) == 2
    assert said == []
    third = Journal(tmp_path, tell=said.append)
    third.open({"task": "test"})
    assert "after 1 step of an earlier call" in said[0]
    third.close()
    assert list(tmp_path.iterdir()) == []


def test_shared_objects_are_not_written(tmp_path: Path) -> None:
    """Records that the caller has stay out of the files, and come back as the caller's."""

    class Big:
        def __init__(self) -> None:
            self.values = np.zeros(100_000)

    big = Big()
    for expected in (0, 1):
        journal = Journal(tmp_path)
        journal.open({"task": "share"}, shared={"big": big})
        pair = journal.once("pair", lambda: (big, 3.0))
        assert pair[0] is big
        assert journal.n_read == expected
    (file,) = tmp_path.glob("*/*.step")
    assert file.stat().st_size < 1000


def test_interrupted_step_is_not_kept(tmp_path: Path) -> None:
    """What answers Ctrl-C with its best so far is not taken for finished."""

    def answers() -> int:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt:
            return 1
        return 2

    journal = journal_of(tmp_path)
    with pytest.raises(KeyboardInterrupt):
        journal.once("number", answers)
    assert journal_of(tmp_path).once("number", lambda: 3) == 3
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_full_disk_costs_the_journal_not_the_result(tmp_path: Path) -> None:
    """Where nothing can be written the work goes on, and that is said once."""
    (tmp_path / "file").write_text("in the way")
    journal = Journal(tmp_path / "file" / "below")
    journal.open({"task": "test"})
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        assert journal.once("one", lambda: 1) == 1
        assert journal.once("two", lambda: 2) == 2
    assert len(said) == 1
    assert "no longer kept" in str(said[0].message)


def test_state_of_an_unfinished_step(tmp_path: Path) -> None:
    """A search goes on from its last state, and its result takes the state's place."""
    journal = journal_of(tmp_path)

    def stops() -> int:
        assert journal.state() is None
        journal.keep(7)
        raise RuntimeError

    with pytest.raises(RuntimeError):
        journal.once("search", stops)
    again = journal_of(tmp_path)
    assert again.once("search", lambda: again.state() + 1) == 8
    assert [path.suffix for path in sorted(tmp_path.glob("*/*"))] == [".step", ".txt"]


def test_old_journals_are_dropped(tmp_path: Path) -> None:
    """What was abandoned more than a month ago is removed when a new journal begins."""
    journal_of(tmp_path, "old").once("number", lambda: 1)
    (old,) = tmp_path.iterdir()
    for path in old.iterdir():
        os.utime(path, (1e9, 1e9))
    (tmp_path / "mine").mkdir()
    journal_of(tmp_path, "new").once("number", lambda: 1)
    assert not old.exists()
    assert (tmp_path / "mine").is_dir()


def test_settings_without_equality_keep_nothing(tmp_path: Path) -> None:
    """A criterion of the user's own that cannot be told from another is not resumed."""
    settings = {"limits": Limits(), "criterion": object()}
    kept = opened(Journal(tmp_path), "design", lambda: encode(settings))
    assert kept.folder is None
    kept = opened(Journal(tmp_path), "design", lambda: encode(settings | {"criterion": 1}))
    assert kept.place is not None


def test_refinement_resumes_in_the_middle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Cut off between two linearisations, a refinement ends where the whole one ends."""
    from oed_sysid import load_problem
    from oed_sysid.design import Search, Trial, design_experiment
    from oed_sysid.runtime import journal as module

    monkeypatch.setattr(module, "NEGLIGIBLE", np.inf)  # every state is kept
    problem = load_problem("auv_diving_plane")

    def run(journal: Journal | None, stop_after: int) -> tuple[float, int]:
        rounds = 0

        def count(_: object) -> None:
            nonlocal rounds
            rounds += 1
            if rounds == stop_after:
                raise KeyboardInterrupt

        found = design_experiment(
            problem.model,
            Trial(limits=problem.limits, duration=40.0, sample_time=0.5),
            rng=np.random.default_rng(4),
            progress=count,
            journal=journal,
            search=Search(n_starts=1, n_candidates=5, n_steps=6, n_workers=1),
        )
        return found.value, found.n_evaluations

    whole = run(None, -1)
    with pytest.raises(KeyboardInterrupt):
        run(Journal(tmp_path), 4)
    assert len(list(tmp_path.glob("*/*.state"))) == 1
    assert run(Journal(tmp_path), -1) == whole


def test_interrupted_command_says_what_is_kept(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C in the ranking leaves the nominal fit to the next call, which says so."""
    from oed_sysid.cli import main
    from oed_sysid.evidence import search as module

    folder = new_problem(tmp_path / "ship")
    command = ["improve", str(folder), "--train", str(folder / "data" / "zigzag_10_10.csv")]
    command += ["--max-effects", "1", "--journal", str(tmp_path / "journal")]

    def interrupted(*_: object, **__: object) -> None:
        signal.raise_signal(signal.SIGINT)

    with monkeypatch.context() as patch:
        patch.setattr(module, "rank", interrupted)
        assert main(command) == 130
    assert "1 finished step is kept" in capsys.readouterr().err
    assert main(command) == 0
    assert "Going on after 1 step of an earlier call" in capsys.readouterr().err
    assert list((tmp_path / "journal").iterdir()) == []


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk_at_the_end_keeps_the_work(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A design whose result does not fit on the disk is not searched for again."""
    from oed_sysid.cli import main

    command = ["design", "auv_diving_plane", "--duration", "30", "--journal", str(tmp_path)]
    assert main([*command, "--json", "/dev/full"]) == 2
    said = capsys.readouterr().err
    assert "cannot be written" in said
    assert "finished steps are kept" in said
    (place,) = tmp_path.iterdir()
    times = {path.name: path.stat().st_mtime_ns for path in place.glob("*.step")}
    assert len(times) > 5
    assert main([*command, "--json", "/dev/full"]) == 2
    assert {path.name: path.stat().st_mtime_ns for path in place.glob("*.step")} == times
    assert main([*command, "--json", str(tmp_path / "design.json")]) == 0
    assert [path.name for path in tmp_path.iterdir()] == ["design.json"]
