"""The application in a browser: what a user does, what the page then shows and keeps.

Needs the extra 'app', playwright and a Chromium of the system; nothing is downloaded. With
`OED_SYSID_GOLDEN=update` the walk draws the pictures of the tutorial anew (`docs/walk_*.png`).
"""

from __future__ import annotations

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

from oed_sysid import load_problem, new_problem

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
VIEW = {"width": 1280, "height": 900}
PATIENCE = 300_000.0  # ms, for a loaded computer that compiles; a free one needs a tenth


@pytest.fixture(name="ship", scope="module")
def _ship(tmp_path_factory) -> Path:
    """The folder that `oed-sysid new` writes."""
    return new_problem(tmp_path_factory.mktemp("browser") / "my_ship")


@pytest.fixture(name="server", scope="module")
def _server(tmp_path_factory, ship: Path) -> Iterator[str]:
    """Address of the application, with a shelf of its own."""
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
    yield address
    run.terminate()
    run.wait(20)


@pytest.fixture(name="browser", scope="module")
def _browser() -> Iterator[Any]:
    with playwright.sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(name="page")
def _page(server: str, browser: Any) -> Iterator[Any]:
    page = opened(browser, server)
    yield page
    page.close()


def opened(browser: Any, address: str):
    """A tab, its first page drawn."""
    page = browser.new_page(viewport=VIEW)
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


# The vehicle's runs under the names that a German crew gives their files, and the columns.
FILES = {
    "zigzag_10_10": "Zickzack_10", "zigzag_20_20": "Zickzack_20", "turning_circle": "Drehkreis",
}  # fmt: skip
TIME = "Zeit [s]"
COLUMNS = {"rudder": "Ruderlage [°]", "psi": "Kurs [°]", "r": "Drehrate [°/min]"}
# Pictures of the tutorial: the step, which is their file, and their height, pixels.
PICTURES = {"data": 1500, "check": 900, "fit": 1000, "missing": 1060, "export": 620}


def foreign_logs(ship: Path, folder: Path) -> list[Path]:
    """Logs of a ship in CSV: semicolons, decimal commas, degrees; the heading within one turn."""
    made, records = [], load_problem(ship).data()
    for name, file in FILES.items():
        run = records[name]
        heading = np.degrees(run.output("psi")) % 360.0
        rate = 60.0 * np.degrees(run.output("r"))
        rows = np.column_stack([run.times, np.degrees(run.input("rudder")), heading, rate])
        lines = [";".join((TIME, *COLUMNS.values()))]
        for row in rows:
            cells = ("" if np.isnan(cell) else f"{cell:.4f}".replace(".", ",") for cell in row)
            lines.append(";".join(cells))
        made.append(folder / f"{file}.csv")
        made[-1].write_text("\n".join(lines) + "\n", encoding="utf-8")
    return made


class Walker:
    """Somebody with a mouse, whose clicks are counted: giving files is one, typing a name is one.

    Parameters
    ----------
    page : playwright page
    """

    def __init__(self, page: Any) -> None:
        self.page, self.clicks = page, 0

    def did(self, clicks: int = 1) -> None:
        """Count what was done, and wait until the page has answered it."""
        self.clicks += clicks
        state = "() => document.querySelector('.stApp')?.dataset.testScriptState === 'notRunning'"
        self.page.wait_for_timeout(300)
        self.page.wait_for_function(state)
        self.page.wait_for_timeout(300)

    def press(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).first.click()
        self.did()

    def choose(self, label: str, option: str) -> None:
        """Choose in a select box what does not stand there yet."""
        box = self.page.get_by_role("combobox", name=re.compile(f"{re.escape(label)}$")).first
        box.wait_for()
        if option not in f"{box.input_value()} {box.get_attribute('aria-label') or ''}":
            box.click()
            box.fill(option)
            self.page.get_by_role("option", name=option, exact=True).first.click()
            self.did(2)

    def advised(self, step: str) -> None:
        """Go on to the step that the page advises. Nothing may be said to be wrong."""
        assert self.page.locator("[data-testid=stAlertContentError]").count() == 0
        button = self.page.get_by_role("button", name=re.compile("Next: ")).first
        assert button.inner_text().rpartition("Next: ")[2].strip() == step
        button.click()
        self.page.get_by_role("heading", level=2, name=step, exact=True).first.wait_for()
        self.did()

    def verdict(self) -> str:
        """What a report says first, once the work is done."""
        verdict = self.page.locator(".verdict").first
        verdict.wait_for()
        self.did(0)
        return str(verdict.inner_text())

    def pictured(self, step: str) -> None:
        """Draw the page for the tutorial, if that is asked for."""
        if os.environ.get("OED_SYSID_GOLDEN") == "update":
            self.page.emulate_media(color_scheme="light")
            self.page.set_viewport_size({**VIEW, "height": PICTURES[step]})
            self.page.wait_for_timeout(800)
            docs = Path(__file__).resolve().parents[1] / "docs"
            self.page.screenshot(path=str(docs / f"walk_{step}.png"))
            self.page.set_viewport_size(VIEW)


def test_walk_of_a_stranger_from_foreign_logs_to_a_unit(
    browser: Any, server: str, ship: Path, tmp_path: Path
) -> None:
    """German headers, decimal commas, degrees a minute: to the exported unit in few clicks.

    The unit turns as the ship of the logs does: K rudder = r + E T r |r| when the rate is steady.
    """
    fmpy = pytest.importorskip("fmpy", reason="needs fmpy")
    page, logs = opened(browser, server), foreign_logs(ship, tmp_path)
    me, said = Walker(page), dict[str, str]()
    me.press("New vehicle")
    page.get_by_label("Folder to make").fill(str(tmp_path / "mein_schiff"))
    page.keyboard.press("Enter")
    me.did()
    me.press("Make it")
    page.get_by_role("heading", name="Mein schiff").wait_for()
    page.get_by_text("My logs", exact=True).click()
    me.did()
    page.locator("input[type=file]").first.set_input_files(logs)
    me.did()
    if page.get_by_text("Column of time").count():
        me.choose("Column of time", TIME)
    for channel, column in COLUMNS.items():
        me.choose(f"Column of {channel}", f"{logs[0].stem}.{column}")
    wrapped = page.get_by_role("checkbox", name="Unwrap psi", exact=True)
    if wrapped.count() and not wrapped.is_checked():
        wrapped.check(force=True)
        me.clicks += 1
    page.locator(".js-plotly-plot").first.wait_for()
    me.did(0)
    me.pictured("data")
    for step, title in (
        ("check", "Check the log"), ("fit", "Fit"), ("missing", "What is missing"),
    ):  # fmt: skip
        me.advised(title)
        said[step] = me.verdict()
        me.pictured(step)
    me.advised("Export")
    me.press("Write the model")
    with page.expect_download() as waiting:
        page.get_by_role("button", name=re.compile("^Model ")).first.click()
    me.clicks += 1
    waiting.value.save_as(tmp_path / "model.zip")
    me.pictured("export")
    page.close()
    assert "agree with each other" in said["check"]
    before, after = map(float, re.findall(r"from (\S+) to (\S+) × noise", said["missing"])[0])
    assert before > 20.0
    assert after < 1.3
    assert me.clicks <= 20
    with zipfile.ZipFile(tmp_path / "model.zip") as packed:
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


def test_a_job_is_stopped_by_its_button(page: Any) -> None:
    """Stop is said to have been heard, and the page offers to begin anew."""
    go(page, "What is missing")
    page.get_by_role("button", name="Find what is missing", exact=True).first.click()
    page.get_by_role("button", name="Stop", exact=True).first.click()
    page.get_by_text("Stopped.").wait_for()
    assert page.get_by_role("button", name="Find what is missing").is_visible()


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
