"""Whose program the browser application runs, and who may ask it to."""

from __future__ import annotations

from pathlib import Path

import pytest
from app_pages import PATIENCE, fine, own_shelf, script, ship_folder, testing, typed  # noqa: F401

from oed_sysid import load_problem
from oed_sysid.app.launch import orders
from oed_sysid.app.records import read_uploads
from oed_sysid.errors import OedSysidError


def _other_folder(ship: Path, folder: Path, mark: Path) -> Path:
    """A copy of a problem that leaves a mark when it is run."""
    import shutil

    shutil.copytree(ship, folder)
    file = folder / "problem.py"
    file.write_text(f"open({str(mark)!r}, 'a').write('x')\n" + file.read_text())
    return folder


def test_a_strangers_problem_is_run_only_after_consent(ship: Path, tmp_path: Path) -> None:
    """A typed folder shows its program and waits for a button; other pages do not run it."""
    mark = tmp_path / "ran"
    folder = _other_folder(ship, tmp_path / "ferry", mark)
    app = typed(folder)
    assert not app.exception
    assert not mark.exists()
    assert "is run with your rights" in app.warning[0].value
    assert any("open(" in one.value for one in app.code)
    app.button(key="next").click().run()
    assert not mark.exists()
    assert "Agree to that on the page Problem" in app.error[0].value
    app = typed(folder)
    app.button(key="agree").click().run()
    assert mark.exists()
    assert fine(app).header[0].value == load_problem(folder).title


def test_consent_ends_where_others_can_write(ship: Path, tmp_path: Path) -> None:
    """In a folder that others can change, every change of the program asks again."""
    from oed_sysid.app.trust import NotTrustedError, check_trusted, consent

    folder = _other_folder(ship, tmp_path / "ferry", tmp_path / "ran")
    agreed = {consent(str(folder)): True}
    check_trusted(str(folder), agreed)
    (folder / "problem.py").write_text("import os\n")
    check_trusted(str(folder), agreed)
    folder.chmod(0o777)
    with pytest.raises(NotTrustedError):
        check_trusted(str(folder), agreed)
    agreed = {consent(str(folder)): True}
    check_trusted(str(folder), agreed)
    (folder / "problem.py").write_text("import sys\n")
    with pytest.raises(NotTrustedError, match=r"problem\.py"):
        check_trusted(str(folder), agreed)


def test_consent_of_one_session_is_none_of_another(ship: Path, tmp_path: Path) -> None:
    """What one window agreed to and uploaded is not there in the next."""
    mark = tmp_path / "ran"
    folder = _other_folder(ship, tmp_path / "ferry", mark)
    first = typed(folder)
    first.button(key="agree").click().run()
    second = typed(folder)
    assert "is run with your rights" in second.warning[0].value
    assert f"files:{folder}" not in second.session_state


def test_address_without_the_key_shows_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whoever does not know the secret of this run sees no page and runs nothing."""
    from oed_sysid.app.trust import SECRET

    monkeypatch.setenv(SECRET, "right")
    app = testing.AppTest.from_function(
        script, kwargs={"problem": "remus_diving_plane"}, default_timeout=PATIENCE
    )
    for wrong in (None, "wrong"):
        if wrong:
            app.query_params["key"] = wrong
        app.run()
        assert "does not carry the key" in app.error[0].value
        assert not app.header
        assert not app.selectbox
    app.query_params["key"] = "right"
    assert fine(app.run()).header[0].value == load_problem("remus_diving_plane").title


def test_uploads_are_limited_and_stay_in_their_folder(ship: Path, monkeypatch) -> None:
    """Too many bytes are refused in words, and no name leads out of the folder."""
    from oed_sysid.app import trust

    problem = load_problem(ship)
    good = (ship / "data" / "turning_circle.csv").read_bytes()
    names = ["../../out.csv", "..", "a/b\\c.csv", "x\0y.csv", "n" * 300 + ".csv"]
    records, refused, _ = read_uploads(problem, dict.fromkeys(names, good))
    assert records is not None
    assert refused == {}
    assert not any(set("/\\\0") & set(name) for name in records.names)
    monkeypatch.setattr(trust, "MOST_BYTES", 10)
    with pytest.raises(OedSysidError, match="takes up to"):
        trust.check_uploads({"a.csv": b"x" * 11})
    assert "--server.maxUploadSize=200" in orders("remus_diving_plane")
