"""Objects in a notebook: a sentence, a table of numbers, equations typeset.

Angles are in degrees, ± is half of a 95 % interval. Numbers keep the digits that their
uncertainty deserves.
"""

from __future__ import annotations

import math
from functools import singledispatch
from html import escape

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.design import Design, Programme
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.compare import Comparison, Diagnosis
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.results.fit_page import fit_verdict
from oed_sysid.results.page import Section, Table
from oed_sysid.results.style import TWO_SIDED_95
from oed_sysid.text.units import shown_unit

_MOST_ROWS = 30


@singledispatch
def html(thing: object) -> str:
    """Return an object as HTML, to be put inside a notebook.

    Parameters
    ----------
    thing : Model, Dataset, Record, Fit, Comparison, Diagnosis, Improvement, Design, ...
        What is shown.

    Raises
    ------
    OedSysidError
        If nothing is known about such objects.
    """
    raise OedSysidError(f"A {type(thing).__name__} has no picture in a notebook; print it.")


@html.register
def _model(model: Model) -> str:
    rows = []
    for name in model.parameter_names:
        p = model.parameter(name)
        kind = "fixed" if p.fixed else "per record" if p.per_record else "free"
        prior = ""
        if p.prior_mean is not None and p.prior_spread is not None:
            prior = f"{p.prior_mean:.4g} ± {TWO_SIDED_95 * p.prior_spread:.2g}"
        rows.append((name, f"{p.value:.5g}", p.unit, kind, prior))
    table = Table(("parameter", "value", "unit", "", "prior (95 %)"), tuple(rows[:_MOST_ROWS]),
                  caption=_more(len(rows)))  # fmt: skip
    equations = f"<div>$$\\begin{{aligned}}{_aligned(model)}\\end{{aligned}}$$</div>"
    return _whole(model, (), (table,), before=equations)


def _aligned(model: Model) -> str:
    return escape(r" \\ ".join(model.latex().splitlines()), quote=False)


@html.register
def _record(record: Record) -> str:
    return _whole(record, (), (_records([record]),))


@html.register
def _dataset(dataset: Dataset) -> str:
    return _whole(dataset, (), (_records(list(dataset)),))


def _records(records: list[Record]) -> Table:
    channels = records[0].channels
    names: list[Input | Output] = [*channels.inputs, *channels.outputs]
    rows = []
    for record in records[:_MOST_ROWS]:
        spans = []
        for channel in names:
            inside = channel.name in channels.input_names
            values = record.input(channel.name) if inside else record.output(channel.name)
            spans.append(_span(shown_unit(channel.unit)[0] * values))
        rows.append((record.name, f"{record.duration:.4g}", str(record.n_samples), *spans))
    units = (shown_unit(channel.unit)[1] or "-" for channel in names)
    heads = (f"{c.name} [{unit}]" for c, unit in zip(names, units, strict=True))
    headers = ("record", "length [s]", "samples", *heads)
    return Table(headers, tuple(rows), caption=_more(len(records)))


def _span(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "not measured"
    low, high = float(finite.min()), float(finite.max())
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"


@html.register
def _fit(fit: Fit) -> str:
    rows = []
    for name, value in fit.values.items():
        half = TWO_SIDED_95 * fit.std_errors[name]
        share = f"{100 * half / abs(value):.2g} %" if value and math.isfinite(half) else ""
        words = f"± {half:.2g}" if math.isfinite(half) else "not identifiable"
        rows.append((name, f"{value:.5g}", words, share, fit.model.parameter(name).unit))
    estimates = Table(("parameter", "value", "95 %", "of the value", "unit"),
                      tuple(rows[:_MOST_ROWS]), caption=_more(len(rows)))  # fmt: skip
    left = []
    for output, sigma, estimated in zip(
        fit.model.outputs, fit.sigma, fit.sigma_estimated, strict=True
    ):
        factor, unit = shown_unit(output.unit)
        left.append(
            (
                output.name,
                f"{factor * fit.rms[output.name]:.3g}",
                f"{factor * sigma:.3g} {'estimated' if estimated else 'given'}",
                unit,
            )
        )
    residuals = Table(("output", "rms residual", "noise", "unit"), tuple(left))
    return _whole(fit, fit_verdict(fit), (estimates, residuals))


@html.register
def _comparison(comparison: Comparison) -> str:
    rows = []
    for part in comparison.models:
        for one in part.outputs:
            factor, unit = shown_unit(one.output.unit)
            rows.append(
                (
                    part.label,
                    one.output.name,
                    f"{factor * one.rmse:.3g}",
                    unit,
                    f"{one.relative:.3g}",
                    f"{100 * one.coverage:.0f} %",
                )
            )
    headers = ("model", "output", "rms error", "unit", "× noise", "inside 95 %")
    return _whole(comparison, comparison.verdict.splitlines(), (Table(headers, tuple(rows)),))


@html.register
def _diagnosis(diagnosis: Diagnosis) -> str:
    rows = [(name, f"{value:.4g}") for name, value in diagnosis.ranking.statistics()]
    table = Table(("candidate", "gain"), tuple(rows[:_MOST_ROWS]), caption=_more(len(rows)))
    return _whole(diagnosis, (diagnosis.location.verdict,), (table,))


@html.register
def _improvement(result: Improvement) -> str:
    pairs = [("nominal", "", result.base_error["train"], result.base_error["test"])]
    pairs += [
        (step.added, f"{step.gain:.4g}", step.train_error, step.test_error) for step in result.steps
    ]
    rows = tuple((name, gain, _number(a), _number(b)) for name, gain, a, b in pairs)
    table = Table(
        ("effect added", "gain", "training error [noise]", "validation error [noise]"), rows
    )
    says = (result.location.verdict, f"What is left: {result.conclusion}")
    return _whole(result, says, (table,))


@html.register
def _design(design: Design) -> str:
    known = bool(np.isfinite(design.prior_errors).any())
    others = [one.information.std_errors / design.sizes for one in design.references]
    rows = []
    for i, name in enumerate(design.names):
        errors = [design.relative_errors[i], *(column[i] for column in others)]
        before = [_half(design.prior_errors[i])] if known else []
        rows.append((name, f"{design.model.values[name]:.4g}", *before, *map(_half, errors)))
    headers = (
        "parameter", "value", *(["before ± (95 %)"] if known else []), "this run ± (95 %)",
        *(f"{one.name} ± (95 %)" for one in design.references),
    )  # fmt: skip
    says = [] if design.assurance is None else [_sentence(design.assurance.report())]
    says.append(f"Limits met: {'; '.join(design.active) or 'none is reached'}.")
    return _whole(design, says, (Table(headers, tuple(rows[:_MOST_ROWS])),))


@html.register
def _programme(programme: Programme) -> str:
    rows = tuple(
        (str(number), run.name, f"{run.experiment.duration:g}")
        for number, run in enumerate(programme.runs, start=1)
    )
    runs = Table(("", "run", "length [s]"), rows)
    known = tuple(
        (name, f"{programme.model.values[name]:.4g}", _half(error))
        for name, error in zip(programme.names, programme.relative_errors, strict=True)
    )
    errors = Table(("parameter", "value", "after all runs ± (95 %)"), known)
    return _whole(programme, (), (runs, errors))


@html.register
def _check(log: LogCheck) -> str:
    rows = tuple(
        ("suspect" if one.suspect else "good to know", one.says, one.fix) for one in log.findings
    )
    tables = (Table(("", "finding", "what to do"), rows, words=(1, 2)),) if rows else ()
    return _whole(log, log.unchecked, tables)


def _whole(
    thing: object, says: tuple[str, ...] | list[str], tables: tuple[Table, ...], *, before: str = ""
) -> str:
    """The object's own short text as a heading, sentences, then tables."""
    inner = Section("", tuple(says), tables).html()
    return f'<div class="oed-sysid"><p><b>{escape(str(thing))}</b></p>{before}{inner}</div>'


def _half(error: float) -> str:
    """Half of a 95 % interval as a share of the value, from a relative standard error."""
    return f"{100 * TWO_SIDED_95 * error:.2g} %" if math.isfinite(error) else "unknown"


def _number(value: float) -> str:
    return f"{value:.4g}" if math.isfinite(value) else "diverges" if math.isinf(value) else "-"


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:]}."


def _more(n: int) -> str:
    return "" if n <= _MOST_ROWS else f"the first {_MOST_ROWS} of {n}"
