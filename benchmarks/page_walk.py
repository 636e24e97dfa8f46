"""A stranger's walk by the page: from logs with foreign names and units to an exported FMU.

    OMP_NUM_THREADS=1 python -m benchmarks.page_walk [--docs]

Starts `oed-sysid app` with an empty cache, makes the folder of a new ship, gives three logs with
German headers, decimal commas, degrees within one turn and a rate in degrees a minute, and follows
the next step that the page advises to the exported model. Prints the clicks and the seconds of each
step; the numbers grow with the load of the machine, which is stated. With ``--docs`` the pictures
of the tutorial are drawn anew (`docs/walk_*.png`). The browser is that of the system.
"""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import ROOT, command, machine
from oed_sysid import new_problem
from oed_sysid.experiments.problem import load_problem

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PATIENCE = 300_000.0  # ms
VIEW = {"width": 1280, "height": 900}
# The vehicle's runs under the names that a German crew gives their files, and the columns.
FILES = {
    "zigzag_10_10": "Zickzack_10", "zigzag_20_20": "Zickzack_20", "turning_circle": "Drehkreis",
}  # fmt: skip
TIME = "Zeit [s]"
COLUMNS = {"rudder": "Ruderlage [°]", "psi": "Kurs [°]", "r": "Drehrate [°/min]"}
# Pictures of the tutorial: the step, its file and its height, pixels.
DOCS = {"data": 1500, "check": 900, "fit": 1000, "missing": 1060, "export": 620}


@contextmanager
def served() -> Iterator[str]:
    """Address of an application with an empty cache, ended afterwards."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as cache:
        run = subprocess.Popen(
            [sys.executable, "-m", "oed_sysid.cli", "app", "--no-browser", "--port", str(port)],
            env=os.environ | {"OED_SYSID_CACHE": cache},
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )  # fmt: skip
        try:
            assert run.stdout is not None
            found = next(filter(None, (re.search(r"http://\S+", line) for line in run.stdout)))
            while True:
                try:
                    socket.create_connection(("localhost", port), timeout=0.5).close()
                    break
                except OSError:
                    time.sleep(0.1)
            yield found.group(0)
        finally:
            run.terminate()
            run.wait(20)


@contextmanager
def browsed() -> Iterator[tuple[Any, str]]:
    """An empty page of the system's browser, and the address of an application for it."""
    from playwright.sync_api import sync_playwright

    browser_file = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    with served() as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_file, args=["--no-sandbox"])
        page = browser.new_page(viewport=VIEW)
        page.set_default_timeout(PATIENCE)
        yield page, address
        browser.close()


def foreign_logs(folder: Path) -> list[Path]:
    """Write three logs of a ship whose rudder acts on a yaw rate with quadratic damping.

    Returns
    -------
    list of Path
        CSV files: semicolons, decimal commas, degrees; the heading within one turn.
    """
    with tempfile.TemporaryDirectory() as place:
        problem = load_problem(new_problem(Path(place) / "ship"))
        records = {record.name: record for record in problem.data()}
    made = []
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
    """Somebody with a mouse: clicks are counted, an error that stands is a dead end.

    Parameters
    ----------
    page : playwright page
    """

    def __init__(self, page: Any) -> None:
        self.page, self.clicks = page, 0

    def settled(self) -> None:
        """Wait until the page is drawn."""
        state = "() => document.querySelector('.stApp')?.dataset.testScriptState === 'notRunning'"
        self.page.wait_for_timeout(300)
        self.page.wait_for_function(state)
        self.page.wait_for_timeout(300)

    def press(self, name: str | re.Pattern[str]) -> None:
        """Press a button."""
        exact = isinstance(name, str)
        self.page.get_by_role("button", name=name, exact=exact).first.click()
        self.clicks += 1
        self.settled()

    def choose(self, label: str, option: str) -> None:
        """Choose in a select box what does not stand there yet."""
        box = self.page.get_by_role("combobox", name=re.compile(f"{re.escape(label)}$")).first
        box.wait_for()
        shown = f"{box.input_value()} {box.get_attribute('aria-label') or ''}"
        if option in shown:
            return
        box.click()
        box.fill(option)
        self.page.get_by_role("option", name=option, exact=True).first.click()
        self.clicks += 2
        self.settled()

    def verdict(self) -> str:
        """What a report says first, once the work is done."""
        verdict = self.page.locator(".verdict").first
        verdict.wait_for()
        self.settled()
        return str(verdict.inner_text())

    def advised(self) -> str:
        """Go on to the step that the page advises; its title. Nothing may be said to be wrong."""
        failures = self.page.locator("[data-testid=stAlertContentError]").all_inner_texts()
        assert not failures, failures
        button = self.page.get_by_role("button", name=re.compile("Next: ")).first
        title = button.inner_text().rpartition("Next: ")[2].strip()
        self.press(re.compile("Next: "))
        heading = self.page.get_by_role("heading", level=2, name=title, exact=True)
        heading.first.wait_for()
        self.settled()
        return title


def walk(page: Any, logs: list[Path], folder: Path, target: Path) -> Iterator[tuple[str, str, int]]:
    """Walk from the empty page to the exported unit.

    Parameters
    ----------
    page : playwright page
        At the address of the application.
    logs : list of Path
        From :func:`foreign_logs`.
    folder : Path
        Of the new vehicle; made.
    target : Path
        Where the exported archive is put.

    Yields
    ------
    step : str
        What was done; the page shows it.
    said : str
        What the page said.
    clicks : int
        So far; giving files is one, typing a name is one.
    """
    me = Walker(page)
    page.get_by_role("heading", level=2).first.wait_for()
    me.settled()
    yield "empty", "", me.clicks
    me.press("New vehicle")
    page.get_by_label("Folder to make").fill(str(folder))
    page.keyboard.press("Enter")
    me.clicks += 1
    me.settled()
    me.press("Make it")
    page.get_by_role("heading", name=folder.name.replace("_", " ").capitalize()).wait_for()
    page.get_by_text("My logs", exact=True).click()
    me.clicks += 1
    me.settled()
    page.locator("input[type=file]").first.set_input_files(logs)
    me.clicks += 1
    me.settled()
    if page.get_by_text("Column of time").count():
        me.choose("Column of time", TIME)
    for channel, column in COLUMNS.items():
        me.choose(f"Column of {channel}", f"{logs[0].stem}.{column}")
    wrapped = page.get_by_role("checkbox", name="Unwrap psi", exact=True)
    if wrapped.count() and not wrapped.is_checked():
        wrapped.check(force=True)
        me.clicks += 1
    page.locator(".js-plotly-plot").first.wait_for()
    me.settled()
    yield "data", "", me.clicks
    assert me.advised() == "Check the log"
    yield "check", me.verdict(), me.clicks
    assert me.advised() == "Fit"
    yield "fit", me.verdict(), me.clicks
    assert me.advised() == "What is missing"
    yield "missing", me.verdict(), me.clicks
    assert me.advised() == "Export"
    me.press("Write the model")
    with page.expect_download() as waiting:
        page.get_by_role("button", name=re.compile("^Model ")).first.click()
    me.clicks += 1
    waiting.value.save_as(target)
    yield "export", "", me.clicks


def main(*, docs: bool = False) -> None:
    """Walk, and print a table.

    Parameters
    ----------
    docs : bool
        whether the pictures of the tutorial are drawn anew
    """
    print(machine())
    with browsed() as (page, address), tempfile.TemporaryDirectory() as place:
        logs, began = foreign_logs(Path(place)), time.perf_counter()
        page.goto(address)
        for step, said, clicks in walk(page, logs, Path(place) / "mein_schiff", Path(place) / "x"):
            seconds = time.perf_counter() - began
            print(f"{step:<10}{clicks:>4} clicks{seconds:>8.1f} s  {said[:90]!r}", flush=True)
            if docs and step in DOCS:
                page.emulate_media(color_scheme="light")
                page.set_viewport_size({**VIEW, "height": DOCS[step]})
                page.wait_for_timeout(800)
                page.screenshot(path=str(ROOT / "docs" / f"walk_{step}.png"))
                page.set_viewport_size(VIEW)
            began = time.perf_counter()


if __name__ == "__main__":
    command(main)
