"""The same in Python: a study as one script of calls of the public API.

The text of the script stands in ``study.py.j2``, one macro for every task.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterable, Mapping
from functools import cache
from pathlib import Path
from typing import Any

import jinja2

from oed_sysid.cli.study import Study, Task, grouped


@cache
def _texts() -> Any:
    """The macros of the template, as functions."""
    text = Path(__file__).with_name("study.py.j2").read_text(encoding="utf-8")
    environment = jinja2.Environment(undefined=jinja2.StrictUndefined, keep_trailing_newline=True)
    environment.filters["repr"] = repr
    return environment.from_string(text).module


def part_of(task: Task, study: Study, options: Mapping[str, Any]) -> str:
    """Return the lines that repeat a task; they follow :func:`whole`'s head.

    Examples
    --------
    >>> from oed_sysid.cli.tasks import TASKS
    >>> study = Study.named("remus_diving_plane")
    >>> print(part_of(TASKS["check"], study, {}), end="")
    records = test
    print(oed_sysid.check(records, problem).report())
    """
    parameters = inspect.signature(task.run).parameters.values()
    defaults = {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY}
    return str(getattr(_texts(), task.name)(study, **defaults | grouped(task.run, options)))


def whole(study: Study, parts: Iterable[str]) -> str:
    """Return a script that does everything that was asked for.

    Parameters
    ----------
    study : Study
        Whose records stand beside the script, in ``train`` and ``test``.
    parts : iterable of str
        From :func:`part_of`.
    """
    return "\n".join([str(_texts().head(study)), *dict.fromkeys(parts)])
