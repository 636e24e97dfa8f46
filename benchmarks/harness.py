"""What all benchmarks share: how they measure, keep results, go on where they stopped, and print.

A result is a line of JSON in ``benchmarks/results``. It names its case, so that it is never
computed again, and the revision of the code that it depends on.
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import platform
import subprocess
import sys
import time
import traceback
from collections.abc import Callable, Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from importlib.metadata import version
from pathlib import Path
from types import UnionType
from typing import Any, get_args, get_origin

import numpy as np
from joblib import Parallel, delayed

from benchmarks.truth import NOISE
from oed_sysid import Dataset, Model, Record, simulate_inputs
from oed_sysid.runtime.files import write_text

ROOT = Path(__file__).resolve().parent.parent
RESULTS = ROOT / "benchmarks" / "results"
# Linear algebra on one thread: what a benchmark's processes are started with.
ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
# Standard errors on either side of an estimate that a 95 % interval has.
TWO_SIDED_95 = 1.96
# Where dives of the REMUS-like vehicle begin.
START = {"u": 1.5, "z": 10.0}
Row = dict[str, Any]

# -- measuring ---------------------------------------------------------------------


def least(
    work: Callable[[], object],
    repeats: int = 15,
    clock: Callable[[], float] = time.process_time,
) -> float:
    """Least processor time of several warm calls, s: what other loads on the machine leave.

    Processor time counts all threads of this process, so a call that spreads over threads gains
    nothing by it here; ``time.perf_counter`` is the time that passes.
    """
    work()
    taken = []
    for _ in range(repeats):
        began = clock()
        work()
        taken.append(clock() - began)
    return min(taken)


@dataclass(frozen=True)
class Measured:
    """What was measured beside its target.

    Parameters
    ----------
    what : str
        In words.
    value : float
        What was found, in ``unit``.
    target : float
        What was aimed at.
    unit : str
        Of both; empty for ratios.
    at_most : bool
        Whether the target is an upper limit, or else a lower one.
    """

    what: str
    value: float
    target: float
    unit: str = ""
    at_most: bool = True

    @property
    def met(self) -> bool:
        """Whether the value keeps the target."""
        return self.value <= self.target if self.at_most else self.value >= self.target

    def __str__(self) -> str:
        relation, ended = "<=" if self.at_most else ">=", "met" if self.met else "MISSED"
        stated = f"{self.value:.3g} {self.unit}".strip()
        return f"{self.what:<58} {stated:>10}   target {relation} {self.target:g}: {ended}"


def machine() -> str:
    """Processor, load and versions: numbers mean little without them."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if "model name" in line)
    except (OSError, StopIteration):
        pass
    load = f", load {os.getloadavg()[0]:.1f}" if hasattr(os, "getloadavg") else ""
    libraries = ", ".join(f"{one} {version(one.lower())}" for one in ("NumPy", "SciPy", "CasADi"))
    return f"{name}, {os.cpu_count()} cores{load}; Python {platform.python_version()}, {libraries}"


@cache
def revision(*code: str) -> str:
    """Revision of the code, with a plus where files of it are changed.

    Parameters
    ----------
    *code : str
        Folders that a number depends on, beside the package and its problems.
    """

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    changed = git("status", "--porcelain", "--", "oed_sysid", "problems", *code)
    return git("rev-parse", "--short", "HEAD") + ("+" if changed else "")


# -- keeping, and going on ------------------------------------------------------------


@dataclass(frozen=True)
class Store:
    """Finished cases, one line of JSON each.

    Parameters
    ----------
    path : Path
    key : callable
        Name of a case, from its row.
    """

    path: Path
    key: Callable[[Row], Hashable] = lambda row: row["key"]

    def rows(self) -> list[Row]:
        """Finished cases; a line that a killed run has cut short is left out."""
        if not self.path.exists():
            return []
        found = []
        for line in self.path.read_text(encoding="utf-8").splitlines():
            try:
                found.append(json.loads(line))
            except json.JSONDecodeError:
                continue
        return found

    def done(self) -> dict[Hashable, Row]:
        """Finished cases by name."""
        return {self.key(row): row for row in self.rows()}

    def add(self, *rows: Row) -> None:
        """Keep more cases, with the revision of the code."""
        self.path.parent.mkdir(parents=True, exist_ok=True)
        text = self.path.read_text(encoding="utf-8") if self.path.exists() else ""
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            write_text(self.path, whole)
        with self.path.open("a", encoding="utf-8") as file:
            for row in rows:
                file.write(json.dumps({**row, "revision": revision("benchmarks")}) + "\n")


def places_of(error: BaseException) -> list[str]:
    """Where an error went through: files without their folders, which differ between machines."""
    frames = traceback.extract_tb(error.__traceback__)
    return [f"{Path(one.filename).name}:{one.lineno}" for one in frames]


def run_cases(
    store: Store,
    cases: Mapping[Any, Any],
    jobs: Callable[[Sequence[Any]], Iterable[Callable[[], Row]]] = iter,
    *,
    n_jobs: int = 1,
    minutes: float = 1e9,
    tell: Callable[[Row], str] = str,
    say: Callable[[str], None] = lambda text: print(text, flush=True),
) -> list[Row]:
    """Compute cases that are not in the store, keep each as soon as it is done.

    Parameters
    ----------
    store : Store
    cases : mapping
        What is wanted, by name: a call each.
    jobs : callable
        From those that are left to one call for each, where they are none themselves; may be lazy.
    n_jobs : int
        Processes.
    minutes : float
        Time after which no result is waited for.
    tell : callable
        A finished case in one line.
    say : callable
        Takes progress.

    Returns
    -------
    list of dict
        All wanted cases that are finished.
    """
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    done = store.done()
    left = [case for key, case in cases.items() if key not in done]
    say(f"{len(cases)} cases, {len(cases) - len(left)} of them done")
    began, deadline = time.perf_counter(), time.time() + 60.0 * minutes
    with Parallel(n_jobs=n_jobs, return_as="generator_unordered") as workers:
        found: Iterator[Row] = workers(delayed(call)() for call in jobs(left))
        for finished, row in enumerate(found, start=1):
            store.add(row)
            pace = (time.perf_counter() - began) / finished
            rest = pace * (len(left) - finished) / 60
            say(f"{finished}/{len(left)} {tell(row)} ({pace:.1f} s a case, {rest:.0f} min left)")
            if time.time() > deadline:
                say("out of time: the rest is left for the next run")
                break
    done = store.done()
    return [done[key] for key in cases if key in done]


# -- printing ------------------------------------------------------------------------


def markdown(head: Sequence[str], rows: Iterable[Sequence[object]]) -> list[str]:
    """Lines of a Markdown table.

    Examples
    --------
    >>> markdown(["a", "b"], [(1, 2)])
    ['| a | b |', '|---|---|', '| 1 | 2 |']
    """
    lines = [" | ".join(map(str, cells)) for cells in (head, *rows)]
    return [f"| {lines[0]} |", "|" + "---|" * len(head), *(f"| {line} |" for line in lines[1:])]


def table_of(rows: Sequence[Row]) -> list[str]:
    """Lines of a Markdown table of rows that have the same names.

    Examples
    --------
    >>> table_of([{"a": 1, "b": 2}])
    ['| a | b |', '|---|---|', '| 1 | 2 |']
    """
    return markdown([*rows[0]], [[*row.values()] for row in rows])


def tabulate(
    groups: Mapping[Hashable, Sequence[Row]], columns: Mapping[str, Callable[..., object]]
) -> list[str]:
    """Lines of a Markdown table with a line for each group of cases and a function per column.

    A function takes the name of the group and its cases.

    Examples
    --------
    >>> tabulate({"a": [{"n": 1}, {"n": 2}]}, {"name": lambda k, _: k, "n": lambda _, g: len(g)})
    ['| name | n |', '|---|---|', '| a | 2 |']
    """
    rows = ([column(key, group) for column in columns.values()] for key, group in groups.items())
    return markdown(list(columns), rows)


def grouped(rows: Iterable[Row], key: Callable[[Row], Hashable]) -> dict[Hashable, list[Row]]:
    """Cases by what they have in common, in the order in which they come."""
    found: dict[Hashable, list[Row]] = {}
    for row in rows:
        found.setdefault(key(row), []).append(row)
    return found


def between(page: str, begin: str, end: str, lines: Iterable[str]) -> str:
    """The page with what stands between two marks written anew, at its end without the marks."""
    body = "\n".join([begin, *lines, end])
    if begin not in page:
        return page.rstrip() + "\n\n" + body + "\n"
    before, _, rest = page.partition(begin)
    return before + body + rest.partition(end)[2]


def write_page(path: Path, text: str, name: str = "measured") -> None:
    """Write a page's tables between its marks; all else on it is left."""
    old = path.read_text(encoding="utf-8") if path.exists() else ""
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    write_text(path, between(old, begin, end, [text]))


# -- the command line -------------------------------------------------------------------


def known(name: str, names: Iterable[str], kind: str) -> str:
    """The name, if there is one like it.

    Raises
    ------
    SystemExit
        If there is none; the message lists those that there are.
    """
    if name not in (all_ := list(names)):
        raise SystemExit(f"there is no {kind} {name}; choose from {', '.join(all_)}")
    return name


def command(main: Callable[..., Any], arguments: Sequence[str] | None = None) -> Any:
    """Call a function as the command line says: its signature is the list of options.

    Positional parameters are arguments, the others options; ``bool`` is a flag, a sequence takes
    several values. Help is what the docstring's *Parameters* say.
    """
    (given,) = _parsed((main,), arguments)
    return main(**given)


def exam(counted: Callable[..., list[Row]], is_bad: Callable[[Row], object]) -> None:
    """Count as the command line says, print the rows; end with 1 if one is bad."""
    rows = command(counted)
    print("\n".join(table_of(rows)))
    sys.exit(any(map(is_bad, rows)))


def study(
    cases: Callable[..., Mapping[Any, Any]],
    table: Callable[[list[Row]], str],
    store: Store,
    *,
    calls: Callable[[Sequence[Any]], Iterable[Callable[[], Row]]] = iter,
    tell: Callable[[Row], str] = str,
    marks: str = "measured",
) -> None:
    """Run, as the command line says, what is not in a store yet, and print a table.

    Parameters
    ----------
    cases : callable
        What is wanted, by name; its signature is the list of options, beside those of all studies.
    table : callable
        Finished cases as Markdown.
    store : Store
        Where they are kept, unless the command line names another place.
    calls, tell : callable
        See :func:`run_cases`, of whose ``jobs`` the first is one.
    marks : str
        Between which the table stands on a page.
    """
    own, shared = _parsed((cases, _shared))
    kept = replace(store, path=shared["store"] or store.path)
    if shared["show"]:
        rows = kept.rows()
    else:
        how = {"n_jobs": shared["jobs"], "minutes": shared["minutes"]}
        rows = run_cases(kept, cases(**own), calls, tell=tell, **how)
    text = table(rows)
    print(text)
    if shared["table"]:
        write_page(shared["table"], text, marks)


def _shared(
    *,
    jobs: int = 1,
    minutes: float = 1e9,
    show: bool = False,
    store: Path | None = None,
    table: Path | None = None,
) -> None:
    """Take the options of all studies.

    Parameters
    ----------
    jobs : int
        processes
    minutes : float
        time after which the rest is left for the next run
    show : bool
        run nothing: print all that is finished
    store : Path
        where finished cases are kept, one line of JSON each
    table : Path
        write the table there as well
    """


def _parsed(
    functions: Sequence[Callable[..., Any]], arguments: Sequence[str] | None = None
) -> list[dict[str, Any]]:
    """Arguments of some functions from one command line, that of the first."""
    module = sys.modules[functions[0].__module__]
    text = inspect.getdoc(functions[0]) or ""
    parser = argparse.ArgumentParser(
        description=(module.__doc__ or text).partition("\n")[0],
        prog=f"python -m {module.__spec__.name if module.__spec__ else module.__name__}",
    )
    known = [inspect.signature(one, eval_str=True).parameters.values() for one in functions]
    for function, parameters in zip(functions, known, strict=True):
        said = (inspect.getdoc(function) or "").partition("Parameters\n----------\n")[2]
        _add_options(parser, parameters, dict(_said(said)))
    values = vars(parser.parse_args(arguments))
    # An empty list of arguments is the default.
    return [
        {n.name: n.default if values[n.name] == [] else values[n.name] for n in parameters}
        for parameters in known
    ]


def _add_options(
    parser: argparse.ArgumentParser,
    parameters: Iterable[inspect.Parameter],
    said: Mapping[str, str],
) -> None:
    for one in parameters:
        kind, several = _kind(one.annotation)
        options: dict[str, Any] = {"default": one.default, "help": said.get(one.name)}
        options |= {"action": "store_true"} if kind is bool else {"type": kind}
        name = f"--{one.name.replace('_', '-')}"
        if one.kind is not inspect.Parameter.KEYWORD_ONLY:
            name, several = one.name, several or "?"
        if several:
            options["nargs"] = several
        parser.add_argument(name, **options)


def _kind(annotation: Any) -> tuple[type, str]:
    """Type of one value, and how many there are."""
    if isinstance(annotation, UnionType):
        annotation = next(one for one in get_args(annotation) if one is not type(None))
    if get_origin(annotation) is None:
        return annotation, ""
    return get_args(annotation)[0], "*"


def _said(text: str) -> Iterator[tuple[str, str]]:
    """Names and words of a numpydoc list of parameters."""
    for block in text.split("\n\n")[0].splitlines():
        if " : " in block and not block.startswith(" "):
            name = block.partition(" : ")[0]
        elif block.strip():
            yield name, block.strip()


# -- models and records -----------------------------------------------------------------------


def named(records: Iterable[Record], kind: str) -> Dataset:
    """Records whose names begin with a word."""
    return Dataset(record for record in records if record.name.startswith(kind))


def ignorant(model: Model) -> Model:
    """The model without priors."""
    for parameter in model.free_parameters:
        model = model.with_parameter(replace(parameter, prior_mean=None, prior_std=None))
    return model


def scaled(model: Model, factor: float) -> Model:
    """The model with every free value times a factor."""
    return model.with_values({name: factor * model.values[name] for name in model.free_names})


def dive(
    model: Model,
    times: np.ndarray,
    *,
    ripple: bool = True,
    seed: int = 0,
) -> Record:
    """A noisy record of the diving plane: a square wave of the fin, with a sine on top."""
    fin = 0.1 * np.sign(np.sin(2 * np.pi * times / 14.0))
    fin = fin + 0.05 * np.sin(0.9 * times) * ripple
    run = simulate_inputs(model, times, inputs={"fin_command": fin, "thrust": 9.0}, initial=START)
    noise = NOISE * np.random.default_rng(seed).standard_normal(run.outputs.shape)
    return Record("dive", times, run.inputs, run.outputs + noise, model.channels)
