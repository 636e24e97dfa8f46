"""Measured numbers of the documents and where they come from."""

from __future__ import annotations

import copy
import json
import math
import re
from pathlib import Path

import jinja2
import numpy as np
import pytest
from marks import MEASURED, slow
from matplotlib.image import imread

from benchmarks.documents import measured_data, page
from benchmarks.documents.__main__ import PAGES, main
from benchmarks.documents.page import Page, Unfounded
from benchmarks.documents.published import PAGE, auv, nomoto, paper, sailboat, tanker, torpedo

ROOT = Path(__file__).resolve().parent.parent
TEXTS = sorted(
    path.relative_to(ROOT)
    for folder in (".", "docs", "docs/walks", "oed_sysid", "problems/*", "examples")
    for path in ROOT.glob(f"{folder}/*.md")
)


@pytest.fixture
def small(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Page:
    """A page of its own, of two sections, in a folder of its own."""
    for name in ("docs", "templates"):
        (tmp_path / name).mkdir()
    monkeypatch.setattr(page, "TEMPLATES", tmp_path / "templates")
    monkeypatch.setattr(page, "RESULTS", tmp_path)
    monkeypatch.setattr(page.Page, "target", property(lambda self: tmp_path / "docs" / "small.md"))
    (tmp_path / "templates" / "small.md").write_text(
        'Gain {{ law.K | number(".2f") }}, {{ stands("stable", law.T > 0) }}, '
        '{{ runs.errors | spanned(".1f") }} in {{ measured.law.revision }}\n'
    )
    sections = {
        "law": lambda: {"K": np.float64(-0.125), "T": np.array(3.0)},
        "runs": lambda: {"errors": np.array([3.0, 1.0, 2.0])},
    }
    return Page("small", sections)


def test_numbers_are_kept_by_section(small: Page) -> None:
    """What was measured comes back as plain numbers, and a section leaves the others."""
    small.measure("runs")
    law = small.measure("law")
    kept = small.stored()
    assert list(kept) == ["law", "runs"]
    assert kept["law"]["numbers"] == {"K": -0.125, "T": 3.0}
    assert kept["runs"]["numbers"]["errors"] == [3.0, 1.0, 2.0]
    assert law["revision"] == page.revision(*page.CODE)
    assert small.text() == f"Gain -0.12, stable, 1.0 to 3.0 in {law['revision']}\n"


def test_words_that_numbers_do_not_carry_are_refused(small: Page) -> None:
    """A verdict falls with its number; a number that nobody measured is no blank."""
    small.measure("law")
    small.measure("runs")
    kept = small.stored()
    kept["law"]["numbers"]["T"] = -3.0
    small.kept.write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(Unfounded, match="stable"):
        small.text()
    kept["law"]["numbers"].pop("T")
    small.kept.write_text(json.dumps(kept), encoding="utf-8")
    with pytest.raises(jinja2.UndefinedError, match="T"):
        small.text()


@pytest.mark.parametrize("name", PAGES)
def test_pages_are_as_measured(name: str) -> None:
    """Every page in the documents is its template with the numbers kept."""
    assert main([name]) == 0


def test_what_there_is_not_is_answered_with_what_there_is() -> None:
    """A wrong page or section ends with the right ones, and --only goes with --write."""
    with pytest.raises(SystemExit, match="measured_data"):
        main(["weather"])
    with pytest.raises(SystemExit, match="roll_decay"):
        main(["measured_data"], only=["weather"], write=True)
    with pytest.raises(SystemExit, match="--write"):
        main(only=["roll_decay"])


@pytest.mark.parametrize("path", TEXTS, ids=str)
def test_rows_have_the_cells_of_their_table(path: Path) -> None:
    """A row of a table has as many cells as its head: none stands in a table of another kind."""
    wrong, cells, code = [], 0, False
    for number, line in enumerate((ROOT / path).read_text(encoding="utf-8").splitlines(), 1):
        code ^= line.startswith("```")
        if code or not line.startswith("|"):
            cells = 0
            continue
        plain = re.sub(r"`[^`]*`", "", line.replace(r"\|", ""))
        cells = cells or plain.count("|")
        if plain.count("|") != cells:
            wrong.append(number)
    assert wrong == []


@pytest.mark.slow
@MEASURED
def test_roll_decay_is_measured_again() -> None:
    """Restoring and damping are missing and found; at one amplitude neither is called for."""
    kept = measured_data.PAGE.stored()["roll_decay"]["numbers"]
    now = measured_data.roll_decay()
    assert [s["names"] for s in now["found"]["steps"]] == [
        s["names"] for s in kept["found"]["steps"]
    ]
    for one, other in zip(now["found"]["steps"], kept["found"]["steps"], strict=True):
        assert one["gain"] == pytest.approx(other["gain"], rel=0.02)
    assert now["errors"] == pytest.approx(kept["errors"], rel=0.02)
    added = " ".join(name for step in now["found"]["steps"] for name in step["names"])
    assert "restoring" in added
    assert "damping" in added
    assert math.degrees(now["errors"]["improved"]) < 0.03 < math.degrees(now["errors"]["linear"])
    tail = now["tail"]
    assert not tail["nonlinear"]
    assert not [name for name in tail["steps"] if "damping" in name or "restoring" in name]


@MEASURED
def test_noise_is_measured_again() -> None:
    """White levels of the measured signals come again."""
    kept = measured_data.PAGE.stored()["noise"]["numbers"]
    for name, found in measured_data.noise().items():
        assert found["level"] == pytest.approx(kept[name]["level"], rel=1e-6)
        assert found["seen"] == kept[name]["seen"]


FIGURES = {
    "auv_diving_plane": (
        "auv_fin_and_pitch.png",
        "auv_sensitivities.png",
        "auv_reduced_and_full.png",
    ),
    "online_ship": ("tanker_derivatives.png", "tanker_predictions.png"),
}
STORED = PAGE.stored()
KEPT = {name: one["numbers"] for name, one in STORED.items()}
# A number that decides a verdict of each kind, and a value at which it would be another.
DECISIVE = [
    ("auv", ["exact"], 1e-6),
    ("nomoto", ["published", "spiral, to 0.1 s"], 6.0),
    ("nomoto_noise", ["wins", 0], "K 0.5, T 1"),
    ("tanker", ["gaps", "inverse"], 1e-3),
    ("tanker_measured", ["warned", 0], False),
    ("sailboat", ["exact"], 1e-3),
    ("sailboat_coverage", ["mean", "exact"], 80.0),
    ("torpedo", ["free"], 11),
    ("torpedo_swarm", ["misfits", 1], 1.1),
]


def same(found: object, kept: object, **tolerance: float) -> None:
    """Numbers measured now are the kept ones; of lists and mappings, all of them."""
    plain = json.loads(json.dumps(found, default=np.ndarray.tolist))
    if isinstance(kept, dict):
        assert set(plain) <= set(kept)
        for name, value in plain.items():
            same(value, kept[name], **tolerance)
    elif isinstance(kept, list):
        assert len(plain) == len(kept)
        for one, other in zip(plain, kept, strict=True):
            same(one, other, **tolerance)
    elif isinstance(kept, float):
        assert plain == pytest.approx(kept, **(tolerance or {"rel": 2e-3}))
    else:
        assert plain == kept


@pytest.mark.slow
def test_auv() -> None:
    """Coefficients beyond 5 %, by run and way, and the errors of the reduced model."""
    script = paper("auv_diving_plane")
    found, kept = auv.zigzag(), KEPT["auv"]
    for name in ("free", "beyond", "explained", "removed", "reduced", "weighted"):
        same(found[name], kept[name])
    same(found["errors"]["simpson"], kept["errors"]["simpson"], abs=0.01)
    assert kept["exact"] < 1e-9
    assert max(found["shooting"].values()) < 0.01
    run = script.ways(script.excitations()["random steps 20"])
    counts = {way: len(script.beyond(values)) for way, values in run.items()}
    same(counts, KEPT["auv_excitations"]["runs"]["random steps 20"])


@pytest.mark.slow
def test_nomoto() -> None:
    """All errors without noise, and one row with it."""
    same(nomoto.without_noise(), KEPT["nomoto"], rel=2e-3, abs=1e-3)
    row = next(row for row in KEPT["nomoto_noise"]["rows"] if row["noise"] == 0.002)
    script = paper("nomoto_sparse_heading")
    errors = script.errors(row["case"], row["noise"], KEPT["nomoto_noise"]["seeds"])
    same(dict(zip(script.COLUMNS, errors, strict=True)), {n: row[n] for n in script.COLUMNS})


@pytest.mark.slow
def test_tanker() -> None:
    """Derivatives as they settle, the second example, and costs that do or do not grow."""
    kept = KEPT["tanker"]
    same({rule: tanker.after(rule) for rule in kept["errors"]}, kept["errors"])
    away = {
        str(noise): max(tanker.away(noise, seed) for seed in range(20)) for noise in (0.0, 0.01)
    }
    same(away, kept["second"], rel=1e-3, abs=1e-6)
    script = paper("online_ship")
    gap = script.recursion_gap(script.MACHINES["Cholesky"](script.WEIGHT), *script.yaw_rows())
    assert gap < 1e-11
    assert kept["gaps"]["Cholesky"] < 1e-11
    flat = tanker.updates(script.MACHINES["flat"](script.WEIGHT))
    assert flat["2000"] < 2 * flat["250"]


@MEASURED
def test_tanker_measured() -> None:
    """K and T of the measured zigzags where digits hold; where they do not, that they do not."""
    script, kept = paper("online_ship"), KEPT["tanker_measured"]
    for name, average in (("instant", script.INSTANT), ("average", script.AVERAGE)):
        sound = script.measured(average, script.WEIGHT, 1.0)
        same(sound["Cholesky"].mean(axis=0), kept["mean"][name], rel=1e-5)
    lost = script.measured(script.INSTANT, 1e8, 1.0)
    assert lost["warned"].all()
    assert lost["residual"].max() > 0.1


@pytest.mark.slow
def test_sailboat() -> None:
    """Errors, draws, intervals, forces and speeds, each of one realisation or a few."""
    script, kept = paper("sailboat"), KEPT["sailboat"]
    found = sailboat.errors(sailboat.gibbs(0.02, 0, n_draws=1000))
    same(max(found[name] for name in script.DOMINANT), kept["dominant"][0])
    same(max(found.values()), kept["weak"][0])
    joint = sailboat.gibbs(script.NOISE, 0, n_draws=2000)
    same(max(joint.posterior.r_hat.values()), kept["chains"]["joint"]["r_hat"], rel=1e-4)
    same(script.resultant_errors(joint.model), KEPT["sailboat_speed"]["forces"])
    worst = max(script.speed_error(sailboat.LEVELS[0], seed) for seed in range(sailboat.FEWER))
    same(worst, KEPT["sailboat_speed"]["errors"][0])
    same(sailboat.held(1), KEPT["sailboat_coverage"]["rows"][1], abs=3.0)  # one interval of 38
    rows = KEPT["sailboat_coverage"]["rows"]
    means = {kind: float(np.mean([row[kind] for row in rows])) for kind in sailboat.KINDS}
    same(means, KEPT["sailboat_coverage"]["mean"])


def test_torpedo() -> None:
    """What records allow, misfits of the true values, and shooting at 500 samples per second."""
    script = paper("torpedo")
    found, kept = torpedo.allowed(), KEPT["torpedo"]
    for name in ("free", "masses", "unknown", "known", "at_level"):
        same(found[name], kept[name])
    assert found["body_worst"] > 50.0  # in body axes the information is singular but for rounding
    assert found["shooting"]["error"] < 1e-5
    for row in KEPT["torpedo_swarm"]["rows"]:
        record = script.data(row["level"], row["seed"])[0]
        same(script.misfit(script.problem.truth, record), row["truth"])
    fit = script.shooting(torpedo.LEVEL, 3, "pitching_500_hz")
    same(max(script.errors(fit).values()), KEPT["torpedo_500_hz"]["largest"][3])


@pytest.mark.slow
def test_swarm() -> None:
    """Errors of the published search in one seed."""
    script = paper("torpedo")
    row = KEPT["torpedo_swarm"]["rows"][-1]
    found = script.errors(script.swarm_fit(row["level"], row["seed"]))
    same(found, row["errors"], rel=0.05, abs=0.1)


def changed(section: str, path: list, value: object) -> dict:
    """All that is kept, with one number another."""
    stored = copy.deepcopy(STORED)
    *way, last = path
    place = stored[section]["numbers"]
    for step in way:
        place = place[step]
    assert place[last] != value
    place[last] = value
    return stored


@pytest.mark.parametrize(("section", "path", "value"), DECISIVE)
def test_a_verdict_falls_with_its_number(
    section: str, path: list, value: object, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With another number the page is refused, not written with a verdict that it contradicts."""
    monkeypatch.setattr(page, "RESULTS", tmp_path)
    stored = changed(section, path, value)
    PAGE.kept.write_text(json.dumps(stored), encoding="utf-8")
    with pytest.raises(Unfounded, match="do not carry"):
        PAGE.text()


def test_a_number_that_decides_nothing_is_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Another number within a verdict stands in the page as it was measured."""
    monkeypatch.setattr(page, "RESULTS", tmp_path)
    stored = changed("nomoto", ["published", "spiral, to 0.1 s"], 1.57)
    PAGE.kept.write_text(json.dumps(stored), encoding="utf-8")
    before = PAGE.target.read_text(encoding="utf-8").splitlines()
    after = PAGE.text().splitlines()
    lines = [line for line, old in zip(after, before, strict=True) if line != old]
    assert len(lines) == 2  # the mean error itself, and what the spiral improves
    assert "| 1.57 % (" in lines[0]


@pytest.mark.parametrize("name", ["auv_diving_plane", *slow("online_ship")])
def test_figures_are_drawn(name: str, tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    """Each figure of the quick papers is a picture with ink on it."""
    script = paper(name)
    if name == "online_ship":
        script.figures(tmp_path, script.on_line())
    else:
        record = script.published_run()
        script.figures(tmp_path, record, script.sensitivities(record))
    assert {path.name for path in tmp_path.iterdir()} == set(FIGURES[name])
    for path in tmp_path.iterdir():
        picture = imread(path)[..., :3]
        assert 0.005 < np.mean(picture < 0.9) < 0.6, path.name


def cited() -> list[tuple[str, str]]:
    """File and name of every test that the document cites; '::name' is in the file before."""
    text = (ROOT / "docs" / "published.md").read_text(encoding="utf-8")
    found, file = [], ""
    for name, test in re.findall(r"`(test_\w+\.py)?::(test_\w+)`", text):
        file = name or file
        found.append((file, test))
    return found


@pytest.mark.parametrize(("file", "test"), cited())
def test_cited_tests_exist(file: str, test: str) -> None:
    """Every line of the table can be run."""
    assert f"def {test}(" in (ROOT / "tests" / file).read_text(encoding="utf-8")


def test_headings_against_the_truth() -> None:
    """Errors of K and T against the truth, and predictions, of sparse headings and curves."""
    script = paper("nomoto_sparse_heading")
    case = next(iter(script.CASES))
    signed, headings = script.signed(case), script.prediction(case)
    error = {
        way: float(np.sqrt(np.mean((heading - headings["truth"]) ** 2)))
        for way, heading in headings.items()
    }
    assert signed["0.1 s"] == pytest.approx((-2.25, -18.08), abs=0.01)
    assert signed["spiral"] == pytest.approx((0.31, -18.20), abs=0.01)
    assert error["spiral"] == pytest.approx(0.0215, abs=1e-4)
    assert error["cubic"] == pytest.approx(0.0227, abs=1e-4)
    assert error["0.5 s"] == pytest.approx(0.0799, abs=1e-4)
    assert signed["shooting"] == pytest.approx((2.24, -0.65), abs=0.01)
    assert np.abs(signed["fine rudder"]).max() < 0.1
