"""A page of words, tables and pictures, rendered as one self-contained HTML file."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import jinja2
import matplotlib as mpl
from matplotlib.figure import Figure

from oed_sysid.results.style import finding
from oed_sysid.runtime import files
from oed_sysid.runtime.version import __version__

_RESOLUTION = 110


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
    """

    source: str
    caption: str
    finding: str = ""

    @classmethod
    def of(cls, figure: Figure, caption: str) -> Picture:
        """Embed a figure as SVG; dense point clouds in it may be rasterised."""
        target = io.BytesIO()
        # A fixed salt and no date: the same result gives the same bytes.
        with mpl.rc_context({"svg.hashsalt": "oed_sysid"}):
            figure.savefig(target, format="svg", dpi=_RESOLUTION, metadata={"Date": None})
        coded = base64.b64encode(target.getvalue()).decode("ascii")
        return cls(f"data:image/svg+xml;base64,{coded}", caption, finding(figure))


@dataclass(frozen=True)
class Table:
    """Rows of text; ``words`` are the columns to set flush left, ``marked`` rows to stress."""

    headers: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    caption: str = ""
    words: tuple[int, ...] = ()
    marked: tuple[int, ...] = ()


@dataclass(frozen=True)
class Section:
    """One part of a page with its own heading."""

    title: str
    paragraphs: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    pictures: tuple[Picture, ...] = ()
    listing: str = ""

    def html(self) -> str:
        """Return the part below the heading as HTML, to be put inside another page."""
        return _template("section").render(section=self)


@dataclass(frozen=True)
class Page:
    """What a report says.

    Parameters
    ----------
    title, subtitle : str
        Heading, and what was done to what.
    verdict : tuple of str
        The outcome in sentences, before everything else.
    numbers : tuple of (str, str)
        The few numbers that matter most, by name.
    sections : tuple of Section
        The rest.

    Examples
    --------
    >>> page = Page("Trial", "two runs", ("It fits.",), (("misfit", "1.01 x noise"),))
    >>> "<dd>1.01 x noise</dd>" in page.html()
    True
    """

    title: str
    subtitle: str
    verdict: tuple[str, ...]
    numbers: tuple[tuple[str, str], ...] = ()
    sections: tuple[Section, ...] = ()

    def html(self) -> str:
        """Return the page as HTML that refers to nothing outside itself."""
        return _template("page").render(page=self, version=__version__)

    def summary_html(self) -> str:
        """Return verdict and numbers as HTML, to be put inside another page."""
        return _template("summary").render(page=self)

    def write(self, path: str | Path) -> Path:
        """Write the page and return its path.

        Raises
        ------
        FileError
            If the file cannot be written; an older one is untouched.
        """
        target = Path(path)
        files.write_text(target, self.html())
        return target


def style_sheet() -> str:
    """Return the rules (CSS) that pages and their parts are drawn with."""
    text: str = _environment().get_template("style.css.j2").render()
    return text


def _template(name: str) -> jinja2.Template:
    return _environment().get_template(f"{name}.html.j2")


@cache
def _environment() -> jinja2.Environment:
    return jinja2.Environment(
        loader=jinja2.PackageLoader("oed_sysid.results", "templates"),
        autoescape=True,
        undefined=jinja2.StrictUndefined,
    )
