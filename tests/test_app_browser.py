"""The application in a browser: what a user does, what the page then shows and keeps.

Needs the extra 'app', playwright and a Chromium of the system; nothing is downloaded.
"""

from __future__ import annotations

import io
import os
import re
import shutil
import socket
import subprocess
import sys
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import page_walk
from oed_sysid import Fit, load_problem, new_problem, read_csv
from oed_sysid.app.choices import at_hand
from oed_sysid.data.mapping import parse
from oed_sysid.experiments.catalogue import catalogue_folder

pytest.importorskip("streamlit", reason="needs the extra 'app'")
playwright = pytest.importorskip("playwright.sync_api", reason="needs playwright")

CHROMIUM = next(
    (path for name in ("chromium", "chromium-browser", "google-chrome")
     if (path := shutil.which(name))),
    None,
)  # fmt: skip
pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium: install the package chromium"),
]
PATIENCE = 300_000.0  # ms, for a loaded computer that compiles; a free one needs a tenth


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The folder that `oed-sysid new` writes."""
    return new_problem(tmp_path_factory.mktemp("browser") / "my_ship")


@pytest.fixture(name="server", scope="module")
def _server(tmp_path_factory, ship: Path) -> Iterator[tuple[str, int]]:
    """Address and process number of the application, with a shelf of its own."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    folder = tmp_path_factory.mktemp("cache")
    environment = os.environ | {"OED_SYSID_CACHE": str(folder)}
    environment.pop("OED_SYSID_APP_SECRET", None)
    run = subprocess.Popen(
        [sys.executable, "-m", "oed_sysid.cli", "app", str(ship), "--no-browser", "--port",
         str(port)],
        env=environment, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
    )  # fmt: skip
    assert run.stdout is not None
    address = ""
    while not address:
        line = run.stdout.readline()
        assert line, "the server ended"
        found = re.search(r"http://\S+", line)
        address = found.group(0) if found else ""
    deadline = time.monotonic() + 60.0
    while time.monotonic() < deadline:
        try:
            socket.create_connection(("localhost", port), timeout=0.5).close()
            break
        except OSError:
            time.sleep(0.2)
    yield address, run.pid
    run.terminate()
    run.wait(20)


@pytest.fixture(name="browser", scope="module")
def _browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(name="page")
def _page(server: tuple[str, int], browser: Any) -> Iterator[Any]:
    page = opened(browser, server[0])
    yield page
    page.close()


def opened(browser: Any, address: str):
    """A tab, its first page drawn."""
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(PATIENCE)
    page.goto(address)
    settled(page)
    return page


def settled(page: Any) -> None:
    """Wait until the page is drawn."""
    page.get_by_role("heading", level=2).first.wait_for()
    page.wait_for_timeout(300)
    page.wait_for_function("() => !document.querySelector('[data-testid=stStatusWidget]')")


def go(page: Any, title: str) -> None:
    """Open a page by the navigation."""
    page.get_by_role("link", name=title, exact=True).click()
    page.get_by_role("heading", level=2, name=title, exact=True).wait_for()
    settled(page)


def press(page: Any, name: str) -> None:
    """Press a button."""
    page.get_by_role("button", name=name, exact=True).first.click()


def choose(page: Any, label: str, option: str) -> None:
    """Choose in a select box."""
    box = page.get_by_role("combobox", name=re.compile(f"{re.escape(label)}$")).first
    box.click()
    box.fill(option)
    page.get_by_role("option", name=option, exact=True).first.click()
    settled(page)


def downloaded(page: Any, name: str) -> bytes:
    """What a download button gives."""
    with page.expect_download() as waiting:
        page.get_by_role("button", name=name, exact=True).first.click()
    return Path(waiting.value.path()).read_bytes()


def finished(page: Any) -> str:
    """The verdict, once the work is done."""
    verdict = page.locator(".verdict").first
    verdict.wait_for()
    settled(page)
    return str(verdict.inner_text())


def with_problem(page: Any, name: str) -> None:
    """Choose a shipped problem."""
    choose(page, "Problem", name)
    page.get_by_role("heading", level=2, name=load_problem(name).title).wait_for()
    settled(page)


def children(number: int) -> set[int]:
    """Processes that a process has started and that still run."""
    found = set()
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            facts = place.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(facts[1]) == number and facts[0] != "Z":
            found.add(int(place.parent.name))
    return found


def no_error(page: Any) -> None:
    """Nobody is told that anything is wrong."""
    assert page.locator("[data-testid=stAlertContentError]").count() == 0


def test_whole_loop_on_a_shipped_record(page: Any, ship: Path, tmp_path: Path) -> None:
    """From the problem to the report: what is downloaded reads back as the same fit."""
    name = "roll_decay" if at_hand(catalogue_folder() / "roll_decay") else str(ship)
    if name == "roll_decay":
        with_problem(page, name)
    page.locator(".js-plotly-plot").wait_for()
    go(page, "Check the log")
    finished(page)
    go(page, "Fit")
    press(page, "Fit")
    finished(page)
    no_error(page)
    go(page, "What is missing")
    press(page, "Find what is missing")
    assert "error on the validation records" in finished(page)
    page.get_by_text("More: signals").click()
    page.get_by_role("tab", name="Signal chain").click()
    page.locator(".oed-chain .place").nth(2).wait_for()
    go(page, "Report")
    with zipfile.ZipFile(io.BytesIO(downloaded(page, "Everything (ZIP)"))) as packed:
        packed.extractall(tmp_path)
    problem = load_problem(name)
    nominal, improved = (Fit.load(tmp_path / f"{name}.json") for name in ("nominal", "improved"))
    assert read_csv(tmp_path / "train", problem.channels).names == nominal.dataset.names
    # Costs are of noise models of their own; whole runs say which model is better.
    output = problem.model.output_names[0]
    assert improved.rms[output] < 0.5 * nominal.rms[output]
    assert {"study.py", "commands.sh", "fit.html", "improve.html"} <= {
        file.name for file in tmp_path.iterdir()
    }
    no_error(page)


def test_walk_of_a_stranger_from_foreign_logs_to_a_unit(
    browser: Any, server: tuple[str, int], tmp_path: Path
) -> None:
    """German headers, decimal commas, degrees a minute: to the exported unit in few clicks.

    The unit turns as the ship of the logs does: K rudder = r + E T r |r| when the rate is steady.
    """
    fmpy = pytest.importorskip("fmpy", reason="needs fmpy")
    page = opened(browser, server[0])
    logs, archive = page_walk.foreign_logs(tmp_path), tmp_path / "model.zip"
    told = {
        step: (said, clicks)
        for step, said, clicks in page_walk.walk(page, logs, tmp_path / "mein_schiff", archive)
    }
    page.close()
    assert "agree with each other" in told["check"][0]
    before, after = map(float, re.findall(r"from (\S+) to (\S+) × noise", told["missing"][0])[0])
    assert before > 20.0
    assert after < 1.3
    assert told["export"][1] <= 20
    with zipfile.ZipFile(archive) as packed:
        (unit,) = (name for name in packed.namelist() if name.endswith(".fmu"))
        packed.extract(unit, tmp_path)
    truth = load_problem(tmp_path / "mein_schiff").truth
    rudder, damping = np.radians(20.0), truth["E_yaw"] * truth["T"]
    steady = (np.sqrt(1.0 + 4.0 * damping * truth["K"] * rudder) - 1.0) / (2.0 * damping)
    table = [(0.0, rudder), (240.0, rudder)]
    held = np.array(table, dtype=[("time", float), ("rudder", float)])
    run = fmpy.simulate_fmu(
        str(tmp_path / unit), stop_time=240.0, output_interval=0.5, input=held, output=["r"],
        fmi_type="CoSimulation",
    )  # fmt: skip
    assert run["r"][-1] == pytest.approx(steady, rel=0.01)


def own_log(ship: Path) -> tuple[bytes, np.ndarray, np.ndarray]:
    """A record with other names, units, a turned axis and a heading within one turn."""
    problem = load_problem(ship)
    record = problem.data()["turning_circle"]
    psi, r = record.output("psi"), record.output("r")
    heading = np.degrees(psi) % 360.0
    lines = ["clock;compass [deg];gyro [deg/s];helm [deg]"]
    for t, h, rate, helm in zip(
        record.times, heading, -np.degrees(r), np.degrees(record.input("rudder")), strict=True
    ):
        cells = [f"{1000.0 * t:.3f}", *("" if np.isnan(x) else f"{x:.9f}" for x in (h, rate)),
                 f"{helm:.9f}"]  # fmt: skip
        lines.append(";".join(cells))
    return "\n".join(lines).encode(), psi, r


def test_own_csv_with_other_names_units_and_a_wrapped_heading(
    page: Any, ship: Path, tmp_path: Path
) -> None:
    """Columns are mapped by their numbers; the records are those they were made of."""
    content, psi, r = own_log(ship)
    file = tmp_path / "circle.csv"
    file.write_bytes(content)
    page.get_by_text("My logs", exact=True).click()
    settled(page)
    page.locator("input[type=file]").first.set_input_files(file)
    page.get_by_text("What the numbers say").wait_for()
    # A column chosen by hand brings its unit, its sign and its jumps; so does the guess.
    choose(page, "Column of psi", "not logged")
    choose(page, "Column of psi", "circle.compass [deg]")
    settled(page)
    assert page.get_by_role("checkbox", name="Unwrap psi", exact=True).is_checked()
    assert page.get_by_role("checkbox", name="Flip r", exact=True).is_checked()
    page.locator(".js-plotly-plot").wait_for()
    no_error(page)
    text = downloaded(page, "Mapping file").decode()
    mapping = parse(text)
    assert mapping.outputs["psi"].field == "circle.compass [deg]"
    assert (mapping.outputs["r"].sign, mapping.time_unit) == (-1, "ms")
    go(page, "Report")
    with zipfile.ZipFile(io.BytesIO(downloaded(page, "Records (ZIP)"))) as packed:
        packed.extractall(tmp_path)
    (record,) = read_csv(tmp_path / "train", load_problem(ship).channels)
    start = round((psi[0] - record.output("psi")[0]) / (2 * np.pi)) * 2 * np.pi
    np.testing.assert_allclose(record.output("psi") + start, psi, atol=1e-8)
    np.testing.assert_allclose(record.output("r"), r, atol=1e-9)
    assert np.nanmax(np.abs(np.diff(record.output("psi")))) < 0.5
    # Jobs of other pages leave the records as they were chosen.
    go(page, "Check the log")
    finished(page)
    go(page, "Fit")
    assert page.get_by_role("button", name="Fit", exact=True).count() == 1
    page.get_by_text(f"Training records: {record.name}").wait_for()
    no_error(page)


def test_bad_csv_is_refused_in_words(page: Any, tmp_path: Path) -> None:
    """A file that cannot be used says why, and the page goes on."""
    file = tmp_path / "bad.csv"
    file.write_text("t [s],rudder [deg]\n0,1\n1,x\n")
    page.get_by_text("My CSV files", exact=True).click()
    settled(page)
    page.locator("input[type=file]").first.set_input_files(file)
    alert = page.locator("[data-testid=stAlertContentError]").first
    alert.wait_for()
    assert "bad.csv was refused" in alert.inner_text()
    assert "Traceback" not in page.content()
    page.get_by_text("With the problem", exact=True).click()
    page.locator(".js-plotly-plot").wait_for()
    settled(page)
    no_error(page)


def test_two_tabs_at_once(page: Any, browser: Any, server: tuple[str, int]) -> None:
    """Each tab keeps its own problem, also after a reload of both."""
    other = opened(browser, server[0])
    with_problem(other, "nomoto_sparse_heading")
    for tab in (page, other):
        tab.reload()
        settled(tab)
    titles = [tab.get_by_role("heading", level=2).first.inner_text() for tab in (page, other)]
    assert titles[1] == load_problem("nomoto_sparse_heading").title
    assert titles[0] != titles[1]
    other.close()


def test_stopped_job_ends_at_once(page: Any, server: tuple[str, int]) -> None:
    """Stop ends the process, and the page offers to begin anew."""
    with_problem(page, "remus_diving_plane")
    go(page, "What is missing")
    before = children(server[1])
    press(page, "Find what is missing")
    page.locator(".oed-busy").wait_for()
    deadline = time.monotonic() + 60.0
    while not (begun := children(server[1]) - before) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert begun
    press(page, "Stop")
    page.get_by_text("Stopped.").wait_for()
    deadline = time.monotonic() + 5.0
    while begun & children(server[1]) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not begun & children(server[1])
    assert page.get_by_role("button", name="Find what is missing").is_visible()


def test_reload_in_mid_job(page: Any, server: tuple[str, int]) -> None:
    """After a reload the same job is at work, and its result appears."""
    page.get_by_text("Noise levels are known").click()
    settled(page)
    go(page, "Fit")
    before = children(server[1])
    press(page, "Fit")
    page.locator(".oed-busy").wait_for()
    page.reload()
    settled(page)
    assert len(children(server[1]) - before) <= 1
    said = finished(page)  # the status, or what a report says before it
    assert "converged" in said or "Process noise" in said
    no_error(page)


def test_a_click_shows_a_bar_while_it_is_answered(page: Any) -> None:
    """The browser draws it as soon as the page's script runs, and takes it away afterwards."""
    page.wait_for_function(
        "() => document.querySelector('.stApp').dataset.testScriptState === 'notRunning'"
    )
    names = page.evaluate(  # in one go: the page may set its state in between
        "() => ['notRunning', 'running', 'rerunRequested'].map(state => {"
        " const page = document.querySelector('.stApp');"
        " page.dataset.testScriptState = state;"
        " return getComputedStyle(page, '::before').animationName })"
    )
    assert names == ["none", "oed-run", "oed-run"]


@pytest.mark.parametrize("width", [1280, 1920])
def test_nothing_is_clipped(page: Any, width: int) -> None:
    """No page is wider than the window, and every tab can be read."""
    page.set_viewport_size({"width": width, "height": 900})
    for title in ("", "Fit", "Plan the next trial", "Report"):
        if title:
            go(page, title)
        wide = page.evaluate(
            "() => { const m = document.querySelector('[data-testid=stMain]');"
            " return m.scrollWidth - m.clientWidth }"
        )
        assert wide <= 0
        for tab in page.get_by_role("tab").all():
            box = tab.bounding_box()
            assert box["x"] >= 0
            assert box["x"] + box["width"] <= width
