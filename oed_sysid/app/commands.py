"""The same on the command line: what would repeat the work of a page."""

from __future__ import annotations

import shlex
from collections.abc import Iterable
from math import degrees

from oed_sysid.app.plans import DesignWish, ProgrammeWish
from oed_sysid.app.study import Study


def describe(study: Study) -> str:
    """Command that shows the problem."""
    return _line("problems", study)


def check(study: Study) -> str:
    """Command that checks the records."""
    folders = "train" * (study.train is not None) + " test" * (study.test is not None)
    return f"{_line('check', study)} {folders.strip()} --html check.html --fix corrected"


def fit(study: Study) -> str:
    """Commands that fit, and write the report with predictions of the validation records."""
    line = f"{_line('fit', study)} train{_noise(study)} --save fit.json --html fit.html"
    if study.test is not None:
        line += "\noed-sysid report fit.json --validate test --out report.html"
    return line


def compare(study: Study, groups: Iterable[tuple[str, ...]]) -> str:
    """Command that compares models on the validation records."""
    added = " ".join("+".join(names) for names in groups)
    more = f" --with {added}" if added else ""
    return f"{_line('compare', study)} {_records(study)}{more}{_noise(study)} --html compare.html"


def diagnose(study: Study) -> str:
    """Command that says where the model fails."""
    return f"{_line('diagnose', study)} train{_noise(study)} --html diagnose.html"


def improve(study: Study, max_effects: int) -> str:
    """Command that finds what is missing."""
    most = f" --max-effects {max_effects}"
    return (
        f"{_line('improve', study)} {_records(study)}{most}{_noise(study)} --html improve.html "
        "--json improve.json --save improved.json"
    )


def rank(study: Study, experiments: tuple[str, ...]) -> str:
    """Command that ranks parameters."""
    runs = f"--experiment {' '.join(experiments)}" if experiments else "train"
    return f"{_line('rank', study)} {runs} --html rank.html"


def design(study: Study, wish: DesignWish) -> str:
    """Command that designs an experiment."""
    parts = [_line("design", study), "--like", wish.like, "--duration", f"{wish.duration:g}"]
    units = {channel.name: channel.unit for channel in study.problem.model.inputs}
    for name, lower, upper in wish.ranges:
        unit = units[name]
        parts += ["--limit", f"{name}={_number(lower, unit)}:{_number(upper, unit)}"]
    model = study.problem.model
    units = (
        {one.name: one.unit for one in (*model.outputs,)}
        | {one.name: one.unit for one in model.states}
        | units
    )
    for name, lower, upper in wish.corridors:
        unit = units[name]
        parts += ["--limit", f"{name}={_number(lower, unit)}:{_number(upper, unit)}"]
    for name, rate in wish.rates:
        parts += ["--limit", f"{name}-rate={_number(rate, units[name])}"]
    parts += ["--discriminate", *wish.rivals] if wish.rivals else ["--criterion", wish.criterion]
    parts += ["--family", wish.family, "--effort", wish.effort, "--seed", str(wish.seed)]
    if wish.certainty is not None:
        parts += ["--certainty", f"{wish.certainty:g}"]
    if wish.after_fit:
        parts += ["--after", "fit.json"]
    return " ".join([*parts, "--out design.csv", "--card card.txt", "--html design.html"])


def programme(study: Study, wish: ProgrammeWish) -> str:
    """Command that plans several runs."""
    hours = "" if wish.hours is None else f" --hours {wish.hours:g}"
    return (
        f"{_line('programme', study)} --runs {wish.runs}{hours} --turnaround {wish.turnaround:g} "
        f"--criterion {wish.criterion} --seed {wish.seed} --out runs --html programme.html"
    )


def shown(unit: str) -> str:
    """Unit in which a command is entered: degrees for radians."""
    return unit.replace("rad", "deg") if unit in ("rad", "rad/s") else unit or "-"


def shown_rate(unit: str) -> str:
    """Unit in which the slope of a command is entered."""
    return f"{shown(unit).replace('-', '1')}/s"


def factor(unit: str) -> float:
    """How many of the shown unit are one of the unit."""
    return degrees(1.0) if unit in ("rad", "rad/s") else 1.0


def _number(value: float, unit: str) -> str:
    return f"{value * factor(unit):.12g}"


def _line(command: str, study: Study) -> str:
    model = "" if study.variant == "default" else f" --model {study.variant}"
    return f"oed-sysid {command} {shlex.quote(study.source)}{model}"


def _records(study: Study) -> str:
    return "train" + ("" if study.test is None else " --validate test")


def _noise(study: Study) -> str:
    return " --known-noise" if study.known_noise else ""
