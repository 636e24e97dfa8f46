"""A page of the documents: a template of sentences, and numbers that were measured.

A template is Markdown with Jinja's placeholders. Numbers are measured section by section and
kept in ``benchmarks/results``, each section with the revision and the day that it is of, so that
a page can be written anew at once, and one section measured again without the others. A word that
numbers must carry, a verdict say, is written by `stands`, with its condition: where the numbers no
longer carry it, no page is written. What another command writes between marks stays as it is.
"""

from __future__ import annotations

import datetime
import functools
import importlib.util
import json
import math
import re
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import jinja2
import numpy as np

from benchmarks.harness import RESULTS, ROOT, revision

TEMPLATES = Path(__file__).resolve().parent / "templates"
Numbers = Mapping[str, Any]
# What numbers depend on beside the package and its problems.
CODE = ("examples", "benchmarks/documents")
# Marks on a page between which another command writes.
BLOCK = re.compile(r"<!-- ([\w ]+): begin -->\n<!-- \1: end -->")


class Unfounded(ValueError):
    """A sentence of a page that the measured numbers do not carry."""


def stands(words: str, condition: bool) -> str:
    """These words where the condition holds.

    Raises
    ------
    Unfounded
        Where it does not: the template says what the numbers no longer do.

    Examples
    --------
    >>> stands("yes", 0.3 < 1.0)
    'yes'
    """
    if not condition:
        raise Unfounded(
            f"the numbers do not carry {words!r}. Rewrite the sentence of the template."
        )
    return words


def number(value: float, form: str = ".3g") -> str:
    """A number in Python's format; without the sign of a zero.

    Examples
    --------
    >>> number(-0.004, ".1f"), number(0.0314), number(2.0, "+.1f"), number(12, "d")
    ('0.0', '0.0314', '+2.0', '12')
    """
    if form.endswith("d"):  # which has no sign of a zero to leave out
        return f"{value:{form}}"
    sign, rest = (form[0], form[1:]) if form[0] in "+- " else ("", form)
    return f"{value:{sign}z{rest}}"


def listed(values: Sequence[object], last: str = " and ") -> str:
    """Words of a list.

    Examples
    --------
    >>> listed([1, 2, 3]), listed(["one"])
    ('1, 2 and 3', 'one')
    """
    *first, end = [str(value) for value in values]
    return f"{', '.join(first)}{last}{end}" if first else end


def spanned(values: Sequence[float], form: str = ".3g") -> str:
    """Least and largest of some numbers; one where both read the same.

    Examples
    --------
    >>> spanned([3.0, 1.0, 2.0]), spanned([1.001, 1.002], ".1f")
    ('1 to 3', '1.0')
    """
    low, high = number(min(values), form), number(max(values), form)
    return low if low == high else f"{low} to {high}"


@dataclass(frozen=True)
class Page:
    """One page, its sections, and where they are kept.

    Parameters
    ----------
    name : str
        File in ``docs`` and in ``templates`` without ``.md``, and of its numbers.
    sections : mapping of str to callable
        Measures the numbers of each section: plain numbers, strings, lists and mappings.
    """

    name: str
    sections: Mapping[str, Callable[[], Numbers]]

    @property
    def target(self) -> Path:
        """The page itself."""
        return ROOT / "docs" / f"{self.name}.md"

    @property
    def kept(self) -> Path:
        """The numbers measured last."""
        return RESULTS / f"{self.name}.json"

    def stored(self) -> dict[str, dict[str, Any]]:
        """What was measured, by section: ``numbers``, ``revision``, ``day`` and ``seconds``."""
        if not self.kept.is_file():
            return {}
        found: dict[str, dict[str, Any]] = json.loads(self.kept.read_text(encoding="utf-8"))
        return found

    def measure(self, section: str) -> dict[str, Any]:
        """Measure one section and keep what was found."""
        began = time.perf_counter()
        numbers = self.sections[section]()
        found = {
            "revision": revision(*CODE),
            "day": datetime.datetime.now(tz=datetime.UTC).date().isoformat(),
            "seconds": round(time.perf_counter() - began, 1),
            "numbers": json.loads(json.dumps(numbers, default=_plain)),
        }
        kept = self.stored() | {section: found}
        ordered = {name: kept[name] for name in self.sections if name in kept}
        text = json.dumps(ordered, indent=1, ensure_ascii=False)
        self.kept.write_text(text + "\n", encoding="utf-8")
        return found

    def text(self) -> str:
        """The page from the numbers measured last.

        Raises
        ------
        Unfounded
            If a section was never measured, or a sentence is not carried by the numbers.
        """
        stored = self.stored()
        if missing := [name for name in self.sections if name not in stored]:
            raise Unfounded(
                f"{self.name}: not measured: {', '.join(missing)}. Run "
                f"`python -m benchmarks.documents {self.name}`."
            )
        environment = jinja2.Environment(
            loader=jinja2.FileSystemLoader(TEMPLATES),
            undefined=jinja2.StrictUndefined,
            autoescape=False,
            trim_blocks=True,
            lstrip_blocks=True,
            keep_trailing_newline=True,
        )
        environment.globals.update(stands=stands)
        environment.filters.update(
            number=number, listed=listed, spanned=spanned, degrees=math.degrees
        )
        numbers = {name: one["numbers"] for name, one in stored.items()}
        measured = {
            name: {k: one[k] for k in one if k != "numbers"} for name, one in stored.items()
        }
        template = environment.get_template(f"{self.name}.md")
        return self._with_blocks(template.render(**numbers, measured=measured))

    def _with_blocks(self, text: str) -> str:
        """The text with what other commands wrote between their marks on the present page."""
        page = self.target.read_text(encoding="utf-8") if self.target.is_file() else ""
        for name in BLOCK.findall(text):
            begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
            kept = page.partition(begin)[2].partition(end)[0]
            text = text.replace(begin + end, begin + kept + end)
        return text


def _plain(value: object) -> object:
    """What JSON can hold of an array or a number of NumPy's."""
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot keep {type(value).__name__} {value!r} among the numbers of a page")


@functools.cache
def paper(name: str) -> ModuleType:
    """What ``problems/NAME/paper.py`` computes; nothing is printed.

    Examples
    --------
    >>> paper("torpedo").N_GENERATIONS
    300
    """
    path = ROOT / "problems" / name / "paper.py"
    spec = importlib.util.spec_from_file_location(f"paper_{name}", path)
    if spec is None or spec.loader is None:
        raise ImportError(f"{path} cannot be read as a module.")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
