"""Documents as HTML: pages with figures in one self-contained file, and notebooks.

A document (:class:`~oed_sysid.runtime.display.Report`) names its figures; they are drawn here.
Angles are in degrees, ± is half of a 95 % interval.
"""

from __future__ import annotations

import base64
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from html import escape
from importlib import import_module
from typing import Any

import jinja2
import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure as Drawing

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.errors import DataError, OedSysidError
from oed_sysid.physics.model import Model
from oed_sysid.results import improvement_plots
from oed_sysid.results.chart import Chart
from oed_sysid.results.style import finding, new_figure, signal_of
from oed_sysid.runtime.display import TWO_SIDED_95, Figure, Report, Section, Table, interval
from oed_sysid.runtime.version import __version__
from oed_sysid.text.units import shown_unit


@dataclass(frozen=True)
class Picture:
    """A figure inside a page.

    Parameters
    ----------
    source : str
        Data URI of the picture.
    caption : str
        What it shows and how to read it.
    finding : str
        What is to be seen, in words, for those who cannot see it.
    chart : Chart, optional
        The same to be pointed at, where a screen can.

    Examples
    --------
    >>> Picture("data:image/svg+xml;base64,", "Heading and yaw rate.").caption
    'Heading and yaw rate.'
    """

    source: str
    caption: str
    finding: str = ""
    chart: Chart | None = None

    @classmethod
    def of(cls, drawing: Drawing, caption: str, chart: Chart | None = None) -> Picture:
        """Embed a figure as SVG; dense point clouds in it may be rasterised."""
        target = io.BytesIO()
        # A fixed salt and no date: the same result gives the same bytes.
        with mpl.rc_context({"svg.hashsalt": "oed_sysid"}):
            drawing.savefig(target, format="svg", metadata={"Date": None})
        coded = base64.b64encode(target.getvalue()).decode("ascii")
        return cls(f"data:image/svg+xml;base64,{coded}", caption, finding(drawing), chart)


def draw(figure: Figure) -> Drawing:
    """Draw a figure of a document."""
    if (described := chart(figure)) is not None:
        drawing, axes = new_figure(1, 1, size=figure.size or (6.4, 3.6))
        described.on(axes[0, 0])
        return drawing
    function = getattr(import_module("oed_sysid.results"), figure.name)
    options = dict(figure.options)
    if figure.size is not None and not figure.name.startswith("figure_"):
        options["ax"] = new_figure(1, 1, size=figure.size)[1][0, 0]
    made: Any = function(figure.subject, *figure.arguments, **options)
    return made if isinstance(made, Drawing) else made.figure


def chart(figure: Figure) -> Chart | None:
    """Describe a figure of a document, where there is one description for print and screen."""
    describe = getattr(improvement_plots, figure.name.replace("plot_", "chart_", 1), None)
    if describe is None or not figure.name.startswith("plot_"):
        return None
    return describe(figure.subject, *figure.arguments)


def drawn(part: Any) -> Any:
    """Return a document or a section with its figures as pictures."""
    if isinstance(part, Report):
        told = (one for one in part.sections if one.only != "text" and not one.is_empty)
        return replace(part, sections=tuple(map(drawn, told)))
    if isinstance(part, Section):
        return replace(part, figures=tuple(map(drawn, part.figures)))
    return Picture.of(draw(part), part.caption, chart(part)) if isinstance(part, Figure) else part


def html(part: Report | Section, template: str) -> str:
    """Return a document, its summary or a section as HTML."""
    shown = part if template == "summary" else drawn(part)
    page = _environment().get_template(f"{template}.html.j2")
    return page.render(part=shown, version=__version__)


def numbers_page(content: Mapping[str, Any]) -> Report:
    """Compose a report from what ``oed-sysid fit --json`` wrote.

    Parameters
    ----------
    content : mapping
        As JSON returns it.

    Returns
    -------
    Report
        Call ``.write("page.html")``.

    Raises
    ------
    DataError
        If it is not what that command writes.

    Examples
    --------
    Of the file that ``oed-sysid fit ... --json fit.json`` wrote::

        numbers_page(json.loads(Path("fit.json").read_text())).write("fit.html")
    """
    try:
        return _numbers(content)
    except (LookupError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise DataError(
            f"The numbers of this fit cannot be read ({error!r:.80}): the file is damaged, or was "
            "changed by hand. Use a copy of it, or make it again."
        ) from error


def _numbers(content: Mapping[str, Any]) -> Report:
    code = str(content["status"]["code"])
    rows = [
        (one["name"], _number(one["value"]), _number(one["std_error"]), one["unit"])
        for one in content["parameters"]
    ]
    rms = content["rms"]
    levels = [(name, _number(rms[name]), _number(one)) for name, one in content["noise"].items()]
    made = content.get("oed_sysid", {})
    trust = (
        "The estimation converged."
        if code == "converged"
        else f"The estimation did not converge ({code}). Do not use the values."
    )
    origin = [
        f"oed_sysid {made.get('version', 'of unknown version')}: "
        f"{made.get('command', 'the command was not kept')}",
        *(f"{name}: {digest}" for name, digest in made.get("records", {}).items()),
    ]
    estimates = Table(("parameter", "value", "std. error", "unit"), rows, words=(0, 3))
    outputs = Table(("output", "rms residual", "noise"), levels, words=(0,))
    return Report(
        title=content["model"].strip(),
        subtitle=f"Fitted by {content.get('estimator')}; numbers only",
        verdict=(
            trust,
            "Model and data were not kept, so there are no pictures here: repeat the fit with "
            "--save FILE for those.",
        ),
        numbers=(
            ("misfit", f"{_number(content.get('normalised_rms'))} × noise"),
            ("parameters", str(len(rows))),
            ("status", code),
        ),
        sections=(
            Section("Estimates", tables=(estimates,)),
            Section("Outputs", tables=(outputs,)),
            Section("Where it comes from", paragraphs=origin),
        ),
    )


def _number(value: float | None) -> str:
    return "unknown" if value is None else f"{value:.6g}"


def style_sheet() -> str:
    """Return the rules (CSS) that pages and their parts are drawn with.

    Returns
    -------
    str

    Examples
    --------
    >>> style_sheet().count("{") == style_sheet().count("}")
    True
    """
    return _environment().get_template("style.css.j2").render()


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("oed_sysid.results", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )


# -- notebooks ---------------------------------------------------------------------------


def notebook(thing: object) -> str:
    """Return an object as HTML, to be put inside a notebook: a sentence, and its tables.

    Parameters
    ----------
    thing : Model, Dataset, Record, Fit, Comparison, Diagnosis, Improvement, Design, ...
        What is shown.

    Raises
    ------
    OedSysidError
        If nothing is known about such objects.
    """
    before = ""
    says: Sequence[str] = ()
    tables: Sequence[Table] = ()
    if isinstance(thing, Model):
        equations = escape(r" \\ ".join(thing.latex().splitlines()), quote=False)
        before = f"<div>$$\\begin{{aligned}}{equations}\\end{{aligned}}$$</div>"
        tables = [parameter_table(thing)]
    elif isinstance(thing, Record | Dataset):
        tables = [_records([thing] if isinstance(thing, Record) else list(thing))]
    elif hasattr(thing, "document"):
        document: Report = thing.document()
        says = document.first
        tables = [table for one in document.sections for table in one.tables]
    else:
        raise OedSysidError(f"A {type(thing).__name__} has no picture in a notebook; print it.")
    inner = Section("", says, tuple(map(_shortened, tables))).html()
    return f'<div class="oed-sysid"><p><b>{escape(str(thing))}</b></p>{before}{inner}</div>'


def _shortened(table: Table, most: int = 30) -> Table:
    """The first rows of a table; the document has all."""
    if len(table.rows) <= most:
        return table
    said = f"{table.caption} (the first {most} of {len(table.rows)})".strip()
    return replace(table, rows=table.rows[:most], caption=said)


def parameter_table(model: Model) -> Table:
    """Return the parameters of a model: value, unit, role, what is known before, meaning."""
    rows = []
    for one in model.all_parameters:
        role = "fixed" if one.fixed else "per record" if one.per_record else "estimated"
        known = ""
        if one.prior_mean is not None and one.prior_spread is not None:
            known = interval(one.prior_mean, TWO_SIDED_95 * one.prior_spread)
        rows.append((one.name, f"{one.value:.5g}", one.unit, role, known, one.description))
    headers = ("parameter", "value", "unit", "role", "prior (95 %)", "meaning")
    return Table(headers, rows, words=(5,))


def _records(records: list[Record]) -> Table:
    channels = records[0].channels.all
    rows = [
        (one.name, f"{one.duration:.4g}", str(one.n_samples),
         *(_span(signal_of(one, channel)) for channel in channels))
        for one in records
    ]  # fmt: skip
    heads = (f"{one.name} [{shown_unit(one.unit)[1] or '-'}]" for one in channels)
    return Table(("record", "length [s]", "samples", *heads), rows)


def _span(values: np.ndarray) -> str:
    finite = values[np.isfinite(values)]
    if not finite.size:
        return "not measured"
    low, high = float(finite.min()), float(finite.max())
    return f"{low:.3g}" if low == high else f"{low:.3g} to {high:.3g}"
