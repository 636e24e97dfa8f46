"""The command check: its exit codes, files and refusals."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from oed_sysid import Dataset, load_problem, write_csv
from oed_sysid.cli import main
from oed_sysid.experiments.simulation import simulate


@pytest.fixture(scope="module")
def logs(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A folder with two good logs, and one with the pitch turned round."""
    problem = load_problem("remus_diving_plane")
    rng = np.random.default_rng(8)
    good, bad = tmp_path_factory.mktemp("good"), tmp_path_factory.mktemp("bad")
    for name in ("zigzag_5_5", "zigzag_10_10"):
        record = simulate(problem.model, problem.experiments[name], rng=rng)
        write_csv(record, good / f"{name}.csv")
        outputs = np.array(record.outputs)
        outputs[:, problem.model.output_names.index("theta")] *= -1.0
        write_csv(record.with_outputs(outputs), bad / f"{name}.csv")
    return good, bad


def test_good_logs_exit_0(logs, capsys) -> None:  # type: ignore[no-untyped-def]
    """Logs that agree end well and say so."""
    assert main(["check", "remus_diving_plane", str(logs[0])]) == 0
    assert "agree with each other" in capsys.readouterr().out


def test_suspect_logs_exit_1_with_report_page_and_copies(logs, tmp_path, capsys) -> None:  # type: ignore[no-untyped-def]
    """A wrong sign ends with 1, names the line, and its corrected copies pass."""
    plain, page, fixed = tmp_path / "check.json", tmp_path / "check.html", tmp_path / "fixed"
    command = ["check", "remus_diving_plane", str(logs[1]), "--json", str(plain)]
    assert main([*command, "--html", str(page), "--fix", str(fixed)]) == 1
    said = capsys.readouterr()
    assert 'Output("theta", "rad", sign=-1)' in said.out
    assert "Corrected in the copies" in said.err
    stored = json.loads(plain.read_text(encoding="utf-8"))
    assert stored["findings"][0]["kind"] == "sign"
    assert stored["findings"][0]["signals"] == ["theta"]
    assert "theta has the wrong sign" in page.read_text(encoding="utf-8")
    assert main(["check", "remus_diving_plane", str(fixed)]) == 0


def test_copies_never_overwrite_the_records(logs, capsys) -> None:  # type: ignore[no-untyped-def]
    """The folder of the records is refused for the copies."""
    before = sorted((p.name, p.read_bytes()) for p in logs[1].iterdir())
    command = ["check", "remus_diving_plane", str(logs[1]), "--fix", str(logs[1])]
    assert main(command) == 2
    assert "overwrite" in capsys.readouterr().err
    assert sorted((p.name, p.read_bytes()) for p in logs[1].iterdir()) == before


def test_public_names() -> None:
    """`check` and `quick_check` are at the top of the package and take a dataset and a model."""
    import oed_sysid

    problem = load_problem("remus_diving_plane")
    record = simulate(
        problem.model, problem.experiments["zigzag_5_5"], rng=np.random.default_rng(1)
    )
    data = Dataset((record,))
    assert oed_sysid.quick_check(data, problem.model).ok
    assert oed_sysid.check(data, problem, inputs=False).ok
