"""The walks of docs/walks: from a vehicle's own log to an exported improved model, as written."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import numpy as np
import pytest
from marks import slow
from walk_logs import WRITERS, Trial

from oed_sysid import Fit, load_problem, new_problem, read_csv
from oed_sysid.cli import DONE, SUSPECT, main
from oed_sysid.data.mapping import parse
from oed_sysid.experiments.starter import TEMPLATES

WALKS = Path(__file__).resolve().parent.parent / "docs" / "walks"
PAGES = sorted(path.stem for path in WALKS.glob("*.md"))


def steps(kind: str) -> list[tuple[str, str]]:
    """Fenced blocks of a page with their languages, in order."""
    text = (WALKS / f"{kind}.md").read_text(encoding="utf-8")
    return re.findall(r"^```(\w*)\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def mapping_of(kind: str) -> str:
    """The mapping that a page shows."""
    (text,) = (block for language, block in steps(kind) if language == "toml")
    return text


def write_log(kind: str, folder: Path, template: Path | None = None) -> Trial:
    """The log of a page, from the records of its template."""
    template = template or new_problem(folder / "template", template=kind)
    trial = Trial.of(load_problem(template).data())
    WRITERS[kind](trial, folder)
    return trial


def test_there_are_four_kinds() -> None:
    """Every page has a log of its own kind."""
    assert sorted(WRITERS) == PAGES


@pytest.mark.parametrize("kind", ["ship", "usv", *slow("auv", "torpedo")])
def test_logs_become_the_records_that_they_were(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Imported with the page's mapping, every run has its samples, and the check finds nothing."""
    monkeypatch.chdir(tmp_path)
    folder = new_problem(tmp_path / parse(mapping_of(kind)).problem, template=kind)
    write_log(kind, tmp_path, folder)
    Path(f"{kind}.toml").write_text(mapping_of(kind))
    command = next(
        line
        for language, block in steps(kind)
        if not language
        for line in block.splitlines()
        if "--map" in line
    )
    problem = load_problem(folder)
    assert main(shlex.split(command)[1:]) == DONE
    records = read_csv(f"my_{kind}/sea", problem.channels)
    for record, original in zip(records, problem.data(), strict=True):
        assert record.n_samples == original.n_samples
        np.testing.assert_allclose(record.inputs, original.inputs, rtol=1e-5, atol=1e-6)
        for name in problem.channels.output_names:
            values = record.output(name)
            kept = np.isfinite(values)
            assert kept.sum() >= original.n_samples // 2
            away = values[kept] - original.output(name)[kept]
            if name == "psi":  # known up to full turns
                away -= 2 * np.pi * np.round(away[0] / (2 * np.pi))
            # Logs in single precision, degrees and rpm keep seven digits.
            limit = 1e-5 + 1e-7 * np.abs(original.output(name)).max()
            np.testing.assert_allclose(away, 0.0, atol=limit)


@pytest.mark.slow
@pytest.mark.parametrize("kind", PAGES)
def test_walk(
    kind: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    """Every command and every line of code of a page ends well, and what is hidden is found."""
    monkeypatch.chdir(tmp_path)
    write_log(kind, tmp_path)
    commands = 0
    for language, block in steps(kind):
        if language == "toml":
            Path(f"{kind}.toml").write_text(block)
        elif language == "python":
            capsys.readouterr()
            exec(block, {})
            assert re.search(r"\d", capsys.readouterr().out)
        else:
            for line in block.splitlines():
                # Without the lag of its propellers the inertia of this one is far from its prior.
                far = kind == "usv" and line.startswith("oed-sysid fit")
                assert main(shlex.split(line)[1:]) == (SUSPECT if far else DONE), line
                commands += 1
    assert commands >= 5
    better = Fit.load("better.json")
    assert TEMPLATES[kind]["hidden"] in better.model.effect_names
    page = (WALKS / f"{kind}.md").read_text(encoding="utf-8")
    assert f"`{TEMPLATES[kind]['hidden']}` is found" in page
