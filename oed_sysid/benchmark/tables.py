"""Benchmarks as Markdown and as lines of a spreadsheet."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterable, Sequence
from dataclasses import fields
from itertools import groupby

from oed_sysid.benchmark.contestants import BELIEVERS, OURS, OURS_BELIEVING
from oed_sysid.benchmark.measures import Row, Verdict, verdicts
from oed_sysid.benchmark.scenarios import UNITS

HEADERS = (
    "estimator",
    "RMSE of determined, %",
    "median, %",
    "RMSE of all, %",
    "bias, %",
    "95 % interval holds, %",
    "prediction",
    "failed",
    "time, s",
    "iterations",
)
LEGEND = (
    "How many times larger the other's error of determined parameters is; **bold** where the other "
    "wins, = where the runs show that they are within 10 %, in brackets where they do not decide."
)


def as_markdown(results: Sequence[Row], ours: str = OURS) -> str:
    """Return all tables: one per problem, noise level and sampling, then the verdicts."""
    lines: list[str] = []
    for problem, of_problem in groupby(results, key=lambda row: row.problem):
        rows = list(of_problem)
        lines += [f"## {problem}", ""]
        for _, group in groupby(rows, key=lambda row: row.setting):
            lines += [*_setting_table([row for row in group if not row.refused]), ""]
        lines += [*_refusals(rows), *_reasons(rows)]
    if found := verdicts(results, ours):
        lines += [
            f"## {ours} against each of the others",
            "",
            LEGEND,
            "",
            *verdict_table(found),
            "",
        ]
    fair = [one for one in verdicts(results, OURS_BELIEVING) if one.other in BELIEVERS]
    if fair:
        lines += [f"## {OURS_BELIEVING} against those that believe start values too", ""]
        lines += [*verdict_table(fair), ""]
    return "\n".join(lines).rstrip() + "\n"


def verdict_table(found: Sequence[Verdict]) -> list[str]:
    """How many times smaller the error is: one line per problem and estimator."""
    levels = sorted({one.noise for one in found})
    lines = markdown_row(("problem", "other", *(f"noise {level:g}" for level in levels)))
    table = [lines, markdown_row(["---"] * (2 + len(levels)))]
    groups: dict[tuple[str, int, str], dict[float, Verdict]] = {}
    for one in found:
        groups.setdefault((one.problem, one.sampling, one.other), {})[one.noise] = one
    for (problem, sampling, other), cells in groups.items():
        shown = [_ratio(cells.get(level)) for level in levels]
        table.append(markdown_row((_sampled(problem, sampling), other, *shown)))
    return table


def as_csv(rows: Iterable[Row]) -> str:
    """Return one line per row with all its numbers."""
    buffer = io.StringIO()
    names = [field.name for field in fields(Row)]
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([getattr(row, name) for name in names])
    return buffer.getvalue()


def markdown_row(cells: Iterable[str]) -> str:
    """One line of a Markdown table."""
    return "| " + " | ".join(cells) + " |"


def _setting_table(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return []
    first = rows[0]
    runs = "one run" if first.n_runs == 1 else f"{first.n_runs} runs"
    title = (
        f"{_sampled('Noise', first.sampling)} {first.noise:g} {UNITS[first.noise_unit]}, "
        f"{runs} each; the data determine {first.n_determined} of {first.n_parameters} parameters, "
        f"at best to {_percent(first.bound)} %:"
    )
    table = [title, "", markdown_row(HEADERS), markdown_row(["---"] * len(HEADERS))]
    for row in rows:
        name = f"**{row.estimator}**" if row.estimator == OURS else row.estimator
        cells = (
            name,
            _percent(row.rmse_determined),
            _percent(row.median_rmse),
            _percent(row.rmse),
            _percent(row.bias),
            "-" if math.isnan(row.coverage) else f"{100 * row.coverage:.0f}",
            _short(row.prediction),
            f"{row.n_failed} of {row.n_runs}" if row.n_failed else "",
            _short(row.seconds),
            f"{row.iterations:.0f}",
        )
        table.append(markdown_row(cells))
    return table


def _refusals(rows: Sequence[Row]) -> list[str]:
    """Who cannot treat the problem, with the reason, each said once."""
    reasons: dict[str, list[str]] = {}
    for row in rows:
        names = reasons.setdefault(row.refused, [])
        if row.refused and row.estimator not in names:
            names.append(row.estimator)
    lines = [f"- cannot: {', '.join(names)}: {why}." for why, names in reasons.items() if why]
    return [*lines, ""] if lines else []


def _reasons(rows: Sequence[Row]) -> list[str]:
    """What failures said, each said once."""
    said: dict[str, list[str]] = {}
    for row in rows:
        if row.reason:
            names = said.setdefault(row.reason, [])
            if row.estimator not in names:
                names.append(row.estimator)
    lines = [f"- failed: {', '.join(names)}: {why.rstrip('.')}." for why, names in said.items()]
    return [*lines, ""] if lines else []


def _ratio(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    shown = f"{verdict.ratio:.2g}" if verdict.ratio < 1000 else "> 1000"
    marks = {"worse": f"**{shown}**", "equal": f"= {shown}", "undecided": f"({shown})"}
    return marks.get(verdict.outcome, shown)


def _sampled(text: str, sampling: int) -> str:
    return text if sampling == 1 else f"{text}, {sampling} x sample time"


def _percent(share: float) -> str:
    return _short(100.0 * share)


def _short(value: float) -> str:
    """Three digits, without exponents where numbers are ordinary."""
    if not math.isfinite(value):
        return "diverges" if math.isinf(value) else "-"
    if value == 0.0 or value < 1e-6:
        return "0"
    if 1e-3 <= value < 1e5:
        return f"{float(f'{value:.3g}'):g}"
    return f"{value:.1e}"
