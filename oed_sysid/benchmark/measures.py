"""What many runs of an estimator amount to, and who is better than whom."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import groupby

import numpy as np

from oed_sysid.benchmark.cell import Cell, Outcome
from oed_sysid.benchmark.world import IDEAL
from oed_sysid.display import as_dict

# A parameter counts as determined where the data allow a standard error below this share.
DETERMINED = 0.25
# Two estimators are not told apart where their errors differ by less than this share.
EQUAL = 0.05
# They are called alike where even the scatter of the runs leaves no room for more than this.
ALIKE = 0.1
# From so many runs on their scatter is known well enough to be used.
MANY = 5
# Less than this no measurement is about.
EXACT = 1e-6


@dataclass(frozen=True)
class Row:
    """One estimator on one problem at one noise level and sampling, over all seeds.

    Attributes
    ----------
    problem, estimator, noise, noise_unit, sampling
        As in :class:`~oed_sysid.benchmark.cell.Cell`.
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
    """

    problem: str
    noise: float
    sampling: int
    ours: str
    other: str
    outcome: str
    ratio: float

    to_dict = as_dict()


def measure(outcomes: Iterable[Outcome]) -> tuple[Row, ...]:
    """Aggregate runs over seeds; rows keep the order of settings, the best first in each."""
    order: dict[tuple[str, int, float, str], int] = {}
    for outcome in (several := tuple(outcomes)):
        order.setdefault(_setting(outcome.cell), len(order))
    several = tuple(sorted(several, key=lambda one: order[_setting(one.cell)]))
    rows = []
    for _, group in groupby(several, key=lambda one: order[_setting(one.cell)]):
        by_name: dict[str, list[Outcome]] = {}
        for outcome in group:
            by_name.setdefault(outcome.cell.estimator, []).append(outcome)
        rows += sorted((_row(runs) for runs in by_name.values()), key=_rank)
    return tuple(rows)


def verdicts(rows: Sequence[Row], ours: str) -> tuple[Verdict, ...]:
    """Compare one estimator with all others that can treat the problem."""
    mine = {row.setting: row for row in rows if row.estimator == ours and not row.refused}
    found = []
    for row in rows:
        if row.estimator == ours or row.refused or row.setting not in mine:
            continue
        own = mine[row.setting]
        ratio = max(row.rmse_determined, EXACT) / max(own.rmse_determined, EXACT)
        logs = np.log(np.maximum(row.by_seed, EXACT) / np.maximum(own.by_seed, EXACT))
        outcome = "equal" if _alike(logs) else "undecided"
        if abs(np.log(ratio)) > np.log(1 + EQUAL) and _told_apart(logs):
            outcome = "better" if ratio > 1 else "worse"
        found.append(
            Verdict(row.problem, row.noise, row.sampling, ours, row.estimator, outcome, ratio)
        )
    return tuple(found)


def _told_apart(logs: np.ndarray) -> bool:
    """Whether paired runs on the same data, as logarithms of ratios, say who is better."""
    if len(logs) >= MANY:
        return bool(abs(np.mean(logs)) > _two_errors(logs))
    slack = np.log(1 + EQUAL)
    return bool((logs >= -slack).all() or (logs <= slack).all())


def _alike(logs: np.ndarray) -> bool:
    """Whether paired runs say that nobody is ahead by more than :data:`ALIKE`."""
    if len(logs) >= MANY:
        return bool(abs(np.mean(logs)) + _two_errors(logs) < np.log(1 + ALIKE))
    return bool((np.abs(logs) < np.log(1 + ALIKE)).all())


def _two_errors(logs: np.ndarray) -> float:
    return 2.0 * float(np.std(logs, ddof=1)) / np.sqrt(len(logs))


def _setting(cell: Cell) -> tuple[str, int, float, str]:
    return cell.problem, cell.sampling, cell.noise, cell.world


def _rank(row: Row) -> tuple[bool, float]:
    return bool(row.refused), row.rmse_determined


def _row(runs: Sequence[Outcome]) -> Row:
    cell = runs[0].cell
    names = tuple(runs[0].bounds)
    # One run without estimates is as wrong as knowing nothing.
    errors = np.array([[run.errors.get(name, -1.0) for name in names] for run in runs])
    bounds = np.sqrt(np.mean([[run.bounds[n] ** 2 for n in names] for run in runs], axis=0))
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
        n_parameters=len(names),
        rmse=_root_mean_square(each),
        median_rmse=float(np.median(each)),
        bound=_root_mean_square(bounds[known]),
        bias=float(np.median(np.abs(errors.mean(axis=0)))),
        coverage=float(np.mean(covered)) if covered else float("nan"),
        prediction=_over(runs, lambda run: run.prediction),
        seconds=_over(runs, lambda run: run.seconds),
        iterations=_over(runs, lambda run: float(run.iterations)),
        reason="" if refused else max(failures, key=failures.count, default=""),
        by_seed=tuple(_root_mean_square(run[known]) for run in errors),
        world=cell.world,
    )


def _over(runs: Sequence[Outcome], value: Callable[[Outcome], float]) -> float:
    return float(np.median([value(run) for run in runs]))


def _root_mean_square(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2))) if values.size else float("nan")
