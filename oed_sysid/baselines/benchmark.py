"""Estimators against each other, on problems whose truth is known.

>>> from oed_sysid.baselines.benchmark import benchmark
>>> result = benchmark(
...     ["nomoto_sparse_heading"], ["multiple_shooting", "heading_differences"],
...     noise=[1.0], seeds=1,
... )
>>> [row.estimator for row in result.rows]
['multiple_shooting', 'heading_differences']
"""

from __future__ import annotations

import csv
import io
import math
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from itertools import chain, groupby, product
from pathlib import Path

import numpy as np

from oed_sysid.baselines.contest import (
    BELIEVERS,
    OURS,
    OURS_BELIEVING,
    QUICK,
    UNITS,
    Cell,
    Outcome,
    contestant_by_name,
    load_scenario,
    run_cell,
)
from oed_sysid.baselines.world import IDEAL, world_by_name
from oed_sysid.errors import ProblemError
from oed_sysid.runtime.constants import IMMATERIAL, RANK_TOLERANCE
from oed_sysid.runtime.display import as_dict
from oed_sysid.runtime.parallel import CellProgress, run_cells

__all__ = ["PROBLEMS", "Benchmark", "Row", "Verdict", "benchmark", "measure", "verdicts"]

# A parameter counts as determined where the data allow a standard error below this share.
DETERMINED = 0.25


@dataclass(frozen=True)
class Row:
    """One estimator on one problem at one noise level and sampling, over all seeds.

    Attributes
    ----------
    problem, estimator, noise, noise_unit, sampling
        As in :class:`~oed_sysid.baselines.contest.Cell`.
    n_runs, n_failed, n_without : int
        Runs; those that did not converge; those without any estimate.
    refused : str
        Why the estimator cannot treat the problem; empty if it can.
    rmse_determined : float
        Relative root mean square error over seeds and the parameters that the
        data determine to 25 % or better. Runs without estimates count as 100 %.
    n_determined, n_parameters : int
        How many these are, of how many.
    rmse : float
        The same over all parameters: mostly about those that nobody can know.
    median_rmse : float
        Median over all parameters of their root mean square errors.
    bound : float
        Root mean square of the Cramér-Rao bounds of the determined parameters:
        what an unbiased estimator with unknown start states can reach.
    bias : float
        Median over parameters of the absolute mean error, relative; with few
        seeds it contains much scatter.
    coverage : float
        Share of stated 95 % intervals that hold the truth; NaN without noise.
    prediction : float
        Median over seeds of the error on the validation run, units of noise.
    seconds, iterations : float
        Medians over seeds.
    reason : str
        What the failures said, the commonest of them.
    by_seed : tuple of float
        ``rmse_determined`` of each run alone.
    world : str
        What the records hold that no model says.

    Examples
    --------
    What :func:`measure` makes of the runs of one setting.
    """

    problem: str
    estimator: str
    noise: float
    noise_unit: str
    sampling: int
    n_runs: int
    n_failed: int
    n_without: int
    refused: str
    rmse_determined: float
    n_determined: int
    n_parameters: int
    rmse: float
    median_rmse: float
    bound: float
    bias: float
    coverage: float
    prediction: float
    seconds: float
    iterations: float
    reason: str
    by_seed: tuple[float, ...]
    world: str = IDEAL

    @property
    def setting(self) -> tuple[str, float, str, int, str]:
        """Problem, noise, its unit, sampling and world."""
        return self.problem, self.noise, self.noise_unit, self.sampling, self.world

    to_dict = as_dict()


@dataclass(frozen=True)
class Verdict:
    """One estimator against another in one setting.

    ``outcome`` is ``better`` or ``worse`` if the errors of determined parameters
    differ by more than 5 % and the runs agree about it. Fewer than five runs agree
    if none says the contrary by more than 5 %; more do if the mean logarithm of the
    ratio, run by run, is two standard errors from zero. ``equal`` means shown to be
    so: no run, or of five and more that mean with its two standard errors, leaves
    the range of 10 %. What is neither is ``undecided``. ``ratio`` is the other's
    error over ours.

    Examples
    --------
    >>> Verdict("ship", 1.0, 1, "multiple_shooting", "ekf", "better", 1.8).outcome
    'better'
    """

    problem: str
    noise: float
    sampling: int
    ours: str
    other: str
    outcome: str
    ratio: float
    world: str = IDEAL

    to_dict = as_dict()


def measure(outcomes: Iterable[Outcome]) -> tuple[Row, ...]:
    """Aggregate runs over seeds; rows keep the order of settings, the best first in each.

    Returns
    -------
    tuple of Row

    Examples
    --------
    >>> measure([])
    ()
    """
    # Estimators are compared within a setting only: problem, sampling, noise and world.
    settings: dict[tuple[str, int, float, str], dict[str, list[Outcome]]] = {}
    for outcome in outcomes:
        cell = outcome.cell
        by_name = settings.setdefault((cell.problem, cell.sampling, cell.noise, cell.world), {})
        by_name.setdefault(cell.estimator, []).append(outcome)

    def place(row: Row) -> tuple[bool, float]:
        return bool(row.refused), row.rmse_determined

    groups = (sorted(map(_row, by_name.values()), key=place) for by_name in settings.values())
    return tuple(chain.from_iterable(groups))


def logarithms_of_ratios(others: Sequence[float], own: Sequence[float]) -> np.ndarray:
    """Logarithms of ratios of errors, run by run, ``(n_runs,)``; less than a millionth is none.

    Pairs of runs are on the same records: what these have in common cancels.
    """
    return np.log(np.maximum(others, RANK_TOLERANCE) / np.maximum(own, RANK_TOLERANCE))


def verdicts(rows: Sequence[Row], ours: str) -> tuple[Verdict, ...]:
    """Compare one estimator with all others that can treat the problem.

    Returns
    -------
    tuple of Verdict
        One for each setting and other estimator.

    Examples
    --------
    >>> verdicts([], "multiple_shooting")
    ()
    """
    mine = {row.setting: row for row in rows if row.estimator == ours and not row.refused}
    found = []
    for row in rows:
        if row.estimator == ours or row.refused or row.setting not in mine:
            continue
        own = mine[row.setting]
        ratio = max(row.rmse_determined, RANK_TOLERANCE) / max(own.rmse_determined, RANK_TOLERANCE)
        outcome = _outcome(ratio, logarithms_of_ratios(row.by_seed, own.by_seed))
        where = row.problem, row.noise, row.sampling
        found.append(Verdict(*where, ours, row.estimator, outcome, ratio, row.world))
    return tuple(found)


def _outcome(ratio: float, logs: np.ndarray) -> str:
    """What paired runs on the same data say, as logarithms of the ratios of their errors.

    Errors that differ by an immaterial share are not told apart; they are equal where the scatter
    of the runs leaves no room for more. Many runs speak by their mean and its two standard errors,
    few by their extremes.
    """
    alike = np.log(1 + IMMATERIAL)
    low, high = float(logs.min()), float(logs.max())
    told_apart = low >= -alike or high <= alike
    if len(logs) >= 5:  # their scatter is known well enough to be used
        two_errors = 2.0 * float(np.std(logs, ddof=1)) / np.sqrt(len(logs))
        low, high = np.mean(logs) - two_errors, np.mean(logs) + two_errors
        told_apart = low > 0 or high < 0
    if abs(np.log(ratio)) > alike and told_apart:
        return "better" if ratio > 1 else "worse"
    return "equal" if max(-low, high) < alike else "undecided"


def _row(runs: Sequence[Outcome]) -> Row:
    cell = runs[0].cell
    errors, bounds = _errors_and_bounds(runs)
    known = bounds < DETERMINED
    each = np.sqrt(np.mean(errors**2, axis=0))
    covered = [held for run in runs for held in run.covered.values()]
    # Only an estimator that refuses throughout cannot; otherwise a refusal is a failure.
    refused = runs[0].message if all(run.status == "refused" for run in runs) else ""
    failures = [f"{run.status}: {run.message}".rstrip(": ") for run in runs if run.failed]
    return Row(
        problem=cell.problem,
        estimator=cell.estimator,
        noise=cell.noise,
        noise_unit=cell.noise_unit,
        sampling=cell.sampling,
        n_runs=len(runs),
        n_failed=len(failures),
        n_without=sum(not run.errors for run in runs),
        refused=refused,
        rmse_determined=_root_mean_square(each[known]),
        n_determined=int(known.sum()),
        n_parameters=len(bounds),
        rmse=_root_mean_square(each),
        median_rmse=float(np.median(each)),
        bound=_root_mean_square(bounds[known]),
        bias=float(np.median(np.abs(errors.mean(axis=0)))),
        coverage=float(np.mean(covered)) if covered else float("nan"),
        prediction=_median(runs, "prediction"),
        seconds=_median(runs, "seconds"),
        iterations=_median(runs, "iterations"),
        reason="" if refused else max(failures, key=failures.count, default=""),
        by_seed=tuple(map(_root_mean_square, errors[:, known])),
        world=cell.world,
    )


def _errors_and_bounds(runs: Sequence[Outcome]) -> tuple[np.ndarray, np.ndarray]:
    """Relative errors ``(n_runs, n_parameters)``, root mean square of the Cramer-Rao bounds."""
    # One run without estimates is as wrong as knowing nothing.
    errors = np.array([[run.errors.get(name, -1.0) for name in run.bounds] for run in runs])
    bounds = np.array([list(run.bounds.values()) for run in runs])
    return errors, np.sqrt(np.mean(bounds**2, axis=0))


def _median(runs: Sequence[Outcome], name: str) -> float:
    return float(np.median([getattr(run, name) for run in runs]))


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")


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
        lines += _said(rows, "cannot", lambda row: row.refused)
        lines += _said(rows, "failed", lambda row: row.reason)
    if found := verdicts(results, ours):
        lines += [f"## {ours} against each of the others", "", LEGEND, ""]
        lines += [*verdict_table(found), ""]
    if fair := [one for one in verdicts(results, OURS_BELIEVING) if one.other in BELIEVERS]:
        lines += [f"## {OURS_BELIEVING} against those that believe start values too", ""]
        lines += [*verdict_table(fair), ""]
    return "\n".join(lines).rstrip() + "\n"


def verdict_table(found: Sequence[Verdict]) -> list[str]:
    """How many times smaller the error is: one line per problem and estimator."""
    levels = sorted({one.noise for one in found})
    groups: dict[tuple[str, str], dict[float, Verdict]] = {}
    for one in found:
        title = _where(_sampled(one.problem, one.sampling), one.world)
        groups.setdefault((title, one.other), {})[one.noise] = one
    table = [
        (title, other, *(_ratio(cells.get(level)) for level in levels))
        for (title, other), cells in groups.items()
    ]
    return _markdown(("problem", "other", *(f"noise {level:g}" for level in levels)), table)


def _markdown(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> list[str]:
    """Lines of a Markdown table."""
    heads = tuple(heads)
    return [f"| {' | '.join(row)} |" for row in (heads, ["---"] * len(heads), *rows)]


def _setting_table(rows: Sequence[Row]) -> list[str]:
    if not rows:
        return []
    first = rows[0]
    runs = "one run" if first.n_runs == 1 else f"{first.n_runs} runs"
    title = (
        f"{_sampled('Noise', first.sampling)} {first.noise:g} {UNITS[first.noise_unit]}"
        f"{_where('', first.world)}, "
        f"{runs} each; the data determine {first.n_determined} of {first.n_parameters} parameters, "
        f"at best to {_percent(first.bound)} %:"
    )
    return [title, "", *_markdown(CELLS, ([cell(row) for cell in CELLS.values()] for row in rows))]


def _said(rows: Sequence[Row], word: str, why: Callable[[Row], str]) -> list[str]:
    """Who cannot treat the problem, or failed, and what was said about it, each said once."""
    names: dict[str, dict[str, None]] = {}
    for row in rows:
        if text := why(row).rstrip("."):
            names.setdefault(text, {})[row.estimator] = None
    lines = [f"- {word}: {', '.join(who)}: {text}." for text, who in names.items()]
    return [*lines, ""] if lines else []


def _ratio(verdict: Verdict | None) -> str:
    if verdict is None:
        return ""
    shown = f"{verdict.ratio:.2g}" if verdict.ratio < 1000 else "> 1000"
    marks = {"worse": f"**{shown}**", "equal": f"= {shown}", "undecided": f"({shown})"}
    return marks.get(verdict.outcome, shown)


def _sampled(text: str, sampling: int) -> str:
    return text if sampling == 1 else f"{text}, {sampling} x sample time"


def _where(text: str, world: str) -> str:
    return text if world == IDEAL else f"{text}, {world_by_name(world).title}"


def _percent(share: float) -> str:
    return _short(100.0 * share)


def _short(value: float) -> str:
    """Three digits, without exponents where numbers are ordinary."""
    if not math.isfinite(value):
        return "diverges" if math.isinf(value) else "-"
    if value < RANK_TOLERANCE:
        return "0"
    if 1e-3 <= value < 1e5:
        return f"{float(f'{value:.3g}'):g}"
    return f"{value:.1e}"


CELLS: Mapping[str, Callable[[Row], str]] = {
    "estimator": lambda row: f"**{row.estimator}**" if row.estimator == OURS else row.estimator,
    "RMSE of determined, %": lambda row: _percent(row.rmse_determined),
    "median, %": lambda row: _percent(row.median_rmse),
    "RMSE of all, %": lambda row: _percent(row.rmse),
    "bias, %": lambda row: _percent(row.bias),
    "95 % interval holds, %": lambda row: (
        "-" if math.isnan(row.coverage) else f"{100 * row.coverage:.0f}"
    ),
    "prediction": lambda row: _short(row.prediction),
    "failed": lambda row: f"{row.n_failed} of {row.n_runs}" if row.n_failed else "",
    "time, s": lambda row: _short(row.seconds),
    "iterations": lambda row: f"{row.iterations:.0f}",
}


PROBLEMS = (
    "auv_diving_plane",
    "nomoto_sparse_heading",
    "online_ship",
    "torpedo",
    "sailboat",
    "remus_diving_plane",
)


@dataclass(frozen=True)
class Benchmark:
    """Outcomes of a grid, and what they say.

    Attributes
    ----------
    outcomes : tuple of Outcome
        In the order of the grid.

    Examples
    --------
    >>> Benchmark(()).outcomes
    ()
    """

    outcomes: tuple[Outcome, ...]

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """One row per problem, noise, sampling and estimator, best first."""
        return measure(self.outcomes)

    def verdicts(self, ours: str = OURS) -> tuple[Verdict, ...]:
        """Where one estimator is better than each of the others, and where not."""
        return verdicts(self.rows, ours)

    @property
    def answer(self) -> str:
        """Who has the smallest errors, in how many settings."""
        settings: dict[object, str] = {}
        for row in self.rows:  # best first in each setting
            if not row.refused:
                settings.setdefault(row.setting, row.estimator)
        wins = Counter(settings.values()).most_common(3)
        said = ", ".join(f"{name} in {n} of {len(settings)} settings" for name, n in wins)
        return f"Smallest errors of the parameters that the data determine: {said}."

    def report(self) -> str:
        """Return the tables as Markdown."""
        return as_markdown(self.rows)

    def to_csv(self) -> str:
        """Return one line per row, for a spreadsheet."""
        buffer = io.StringIO()
        names = [field.name for field in fields(Row)]
        writer = csv.writer(buffer, lineterminator="\n")
        writer.writerow(names)
        writer.writerows([getattr(row, name) for name in names] for row in self.rows)
        return buffer.getvalue()

    to_dict = as_dict("rows", verdicts=lambda self: self.verdicts())


def benchmark(
    problems: Sequence[str] = PROBLEMS,
    estimators: Sequence[str] = QUICK,
    *,
    noise: Sequence[float] = (0.0, 0.5, 1.0, 3.0),
    noise_unit: str = "peak",
    sampling: Sequence[int] = (1,),
    seeds: int = 3,
    worlds: Sequence[str] = (IDEAL,),
    store: str | Path | None = None,
    n_jobs: int = 1,
    progress: Callable[[CellProgress], None] | None = None,
) -> Benchmark:
    """Run estimators on problems whose truth is known.

    Parameters
    ----------
    problems : sequence of str
        Shipped names, or folders of your own.
    estimators : sequence of str
        See :data:`oed_sysid.baselines.contest.CONTESTANTS`; by default all
        that do not search by whole populations.
    noise : sequence of float
        Levels, per cent of each output's peak, or multiples of declared noise.
    noise_unit : str
        ``"peak"`` or ``"declared"``.
    sampling : sequence of int
        Multiples of the problem's sample time.
    seeds : int
        Repetitions, with other noise and other start values.
    worlds : sequence of str
        What the records hold that no model says, of :data:`oed_sysid.baselines.world.WORLDS`.
    store : path, optional
        Folder that keeps finished runs; they are never run again.
    n_jobs : int
        Processes.
    progress : callable, optional
        Called after every run.

    Returns
    -------
    Benchmark
        With one outcome for each run of the grid.

    Raises
    ------
    OedSysidError
        If a name is unknown, or a problem cannot be benchmarked.

    Examples
    --------
    >>> found = benchmark(["nomoto_sparse_heading"], ["heading_differences"], noise=(0.0,), seeds=1)
    >>> [one.cell.estimator for one in found.outcomes]
    ['heading_differences']
    """
    if seeds < 1 or min(sampling, default=0) < 1:
        raise ProblemError("Give at least one seed, and sampling factors of 1 or more.")
    for name in estimators:
        contestant_by_name(name)
    for name in worlds:
        world_by_name(name)
    for name in problems:
        scenario = load_scenario(name)
        for level in noise:
            scenario.noise(level, noise_unit)
    # First seed of everything first: a grid that is cut short is a smaller grid.
    grid = product(range(seeds), problems, sampling, noise, worlds, estimators)
    cells = [
        Cell(problem, name, float(level), noise_unit, factor, seed, world=world)
        for seed, problem, factor, level, world, name in grid
    ]
    outcomes = run_cells(
        run_cell, {cell.key: cell for cell in cells}, store=store, n_jobs=n_jobs, progress=progress
    )
    return Benchmark(tuple(outcomes.values()))
