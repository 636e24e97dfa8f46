"""How soon the page answers a click, in a real browser.

    OMP_NUM_THREADS=1 python -m benchmarks.page_clicks

Starts `oed-sysid app` with an empty cache and works through a study of the REMUS-like vehicle in a
headless Chromium (playwright; the browser is that of the system). For each click: seconds until the
page shows the answer or that it is at work, and seconds until it is drawn. Target: 0.5 s to the
first. Nothing is waited for but the page, so that the numbers grow with the load of the machine,
which is stated.
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
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

from benchmarks.harness import command, machine

TARGET = 0.5  # s
PROBLEM, OTHER = "remus_diving_plane", "catamaran"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")
PAGES = (
    "Check the log",
    "Fit",
    "Where it fails",
    "What is missing",
    "Plan the next trial",
    "Report",
)
# What tells that a click is being answered: the bar over the page, which begins to show `_BAR`
# seconds after this state, or the line of a job.
_RUNNING = ".stApp:is([data-test-script-state=running], [data-test-script-state=rerunRequested])"
_BAR = 0.15  # s
_PATIENCE = 300_000.0  # ms


@contextmanager
def served(problem: str | None) -> Iterator[str]:
    """Address of an application with an empty cache, ended afterwards."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = free.getsockname()[1]
    with tempfile.TemporaryDirectory() as cache:
        run = subprocess.Popen(
            [sys.executable, "-m", "oed_sysid.cli", "app", *filter(None, [problem]),
             "--no-browser", "--port", str(port)],
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
def browsed(problem: str | None, height: int) -> Iterator[tuple[Any, str]]:
    """An empty page of the system's browser, and the address of an application for it."""
    from playwright.sync_api import sync_playwright

    browser_file = next((path for name in BROWSERS if (path := shutil.which(name))), None)
    with served(problem) as address, sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=browser_file, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": height})
        page.set_default_timeout(_PATIENCE)
        yield page, address
        browser.close()


# Notes the moments of the browser's own clock, in ms: the first press, and the first sign of work.
_CLOCK = """running => {
  const seen = window.oedSeen = {};
  const press = () => { seen.pressed ??= Date.now(); };
  for (const kind of ["pointerdown", "keydown"])
    document.addEventListener(kind, press, {capture: true, once: true});
  const look = () => {
    if (seen.pressed && document.querySelector(running)) seen.running ??= Date.now();
  };
  seen.watch?.disconnect();
  seen.watch = new MutationObserver(look);
  seen.watch.observe(document, {subtree: true, childList: true, attributes: true});
}"""


def clicked(page: Any, act: Callable[[], None], answer: str) -> tuple[float, float]:
    """Seconds from a click to the first sign, and to the drawn answer.

    The browser itself notes when it received the click and when it showed that it is being
    answered: the program that drives it takes tenths of a second for each step on a busy machine.

    Parameters
    ----------
    page : playwright page
        Where.
    act : callable
        The click.
    answer : str
        Selector of what the answer shows.
    """
    idle = f"() => !document.querySelector({_RUNNING!r})"
    page.wait_for_function(idle)
    page.evaluate(_CLOCK, _RUNNING)
    act()
    page.locator(answer).first.wait_for(state="attached")
    answered = time.time()
    page.wait_for_function(idle)
    drawn = time.time()
    noted = page.evaluate("window.oedSeen")
    pressed = noted["pressed"] / 1e3
    signs = [answered, *([noted["running"] / 1e3 + _BAR] if "running" in noted else [])]
    return min(signs) - pressed, drawn - pressed


def walk(page: Any) -> Iterator[tuple[str, float, float]]:
    """What was clicked, and both times."""
    for title in PAGES:
        link = page.get_by_role("link", name=title, exact=True)
        yield (f"page {title}", *clicked(page, link.click, f"h2:has-text('{title}')"))
    page.get_by_role("link", name="Fit", exact=True).click()
    page.locator("h2:has-text('Fit')").wait_for()
    fit = page.get_by_role("button", name="Fit", exact=True).first
    fit.wait_for()
    yield ("Fit", *clicked(page, fit.click, ".oed-busy"))
    stop = page.get_by_role("button", name="Stop", exact=True)
    yield ("Stop", *clicked(page, stop.click, ":text('Stopped.')"))
    page.get_by_role("link", name="Plan the next trial", exact=True).click()
    design = page.get_by_text("Design", exact=True).first
    design.wait_for()
    yield ("view Design", *clicked(page, design.click, "label:has-text('Length [s]')"))
    lower = "[data-testid=stSlider] input[type=range][aria-label^='stern plane'][aria-label$=start]"
    handle = page.locator(lower)
    handle.wait_for(state="attached")
    before = handle.get_attribute("aria-valuetext")
    handle.focus()
    moved = f"{lower}:not([aria-valuetext='{before}'])"
    yield ("slider, by keyboard", *clicked(page, lambda: handle.press("ArrowRight"), moved))
    page.get_by_role("link", name="Data", exact=True).click()
    box = page.get_by_role("combobox", name=re.compile("Problem$")).first
    box.wait_for()
    box.click()
    box.fill(OTHER)
    other = page.get_by_role("option", name=OTHER, exact=True).first
    other.wait_for()
    yield ("another problem", *clicked(page, other.click, "h2:has-text('Catamaran')"))
    tab = page.get_by_role("tab", name="Parameters", exact=True)
    yield ("tab Parameters", *clicked(page, tab.click, "th:has-text('prior')"))


def main() -> None:
    """Measure and print a table."""
    print(machine())
    print(f"{'click':<28}{'first sign':>12}{'drawn':>10}   target {TARGET} s to the first sign")
    with browsed(PROBLEM, 800) as (page, address):
        began = time.perf_counter()
        page.goto(address)
        page.locator(".js-plotly-plot").first.wait_for()
        print(f"{'opened, first of the server':<28}{'':>12}{time.perf_counter() - began:>8.2f} s")
        for what, first, drawn in walk(page):
            met = "met" if first <= TARGET else "MISSED"
            print(f"{what:<28}{first:>10.2f} s{drawn:>8.2f} s   {met}", flush=True)


if __name__ == "__main__":
    command(main)
