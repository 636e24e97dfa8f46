"""The grid: estimators, problems, noise, sampling and seeds; run, kept, never run twice."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from pathlib import Path

from oed_sysid.batch.parallel import CellProgress, run_cells
from oed_sysid.benchmark.cell import Cell, Outcome, run_cell
from oed_sysid.benchmark.contestants import OURS, QUICK, contestant_by_name
from oed_sysid.benchmark.measures import Row, Verdict, measure, verdicts
from oed_sysid.benchmark.scenarios import UNITS, load_scenario
from oed_sysid.benchmark.tables import as_csv, as_markdown
from oed_sysid.benchmark.world import IDEAL, world_by_name
from oed_sysid.display import as_dict
from oed_sysid.errors import ProblemError

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
    """

    outcomes: tuple[Outcome, ...]

    @cached_property
    def rows(self) -> tuple[Row, ...]:
        """One row per problem, noise, sampling and estimator, best first."""
        return measure(self.outcomes)

    def verdicts(self, ours: str = OURS) -> tuple[Verdict, ...]:
        """Where one estimator is better than each of the others, and where not."""
        return verdicts(self.rows, ours)

    def report(self) -> str:
        """Return the tables as Markdown."""
        return as_markdown(self.rows)

    def to_csv(self) -> str:
        """Return one line per row, for a spreadsheet."""
        return as_csv(self.rows)

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
        See :data:`oed_sysid.benchmark.contestants.CONTESTANTS`; by default all
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
        What the records hold that no model says, of :data:`oed_sysid.benchmark.world.WORLDS`.
    store : path, optional
        Folder that keeps finished runs; they are never run again.
    n_jobs : int
        Processes.
    progress : callable, optional
        Called after every run.

    Raises
    ------
    OedSysidError
        If a name is unknown, or a problem cannot be benchmarked.
    """
    if noise_unit not in UNITS:
        raise ProblemError(f"The unit of noise is {noise_unit!r}. Choose {' or '.join(UNITS)}.")
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
    cells = {
        cell.key: cell
        for cell in _cells(problems, estimators, noise, noise_unit, sampling, seeds, worlds)
    }
    outcomes = run_cells(run_cell, cells, store=store, n_jobs=n_jobs, progress=progress)
    return Benchmark(tuple(outcomes.values()))


def _cells(
    problems: Sequence[str],
    estimators: Sequence[str],
    noise: Sequence[float],
    unit: str,
    sampling: Sequence[int],
    seeds: int,
    worlds: Sequence[str],
) -> Iterator[Cell]:
    """First seed of everything first: a grid that is cut short is a smaller grid."""
    for seed in range(seeds):
        for problem in problems:
            for factor in sampling:
                for level, world in product(noise, worlds):
                    for name in estimators:
                        yield Cell(problem, name, float(level), unit, factor, seed, world=world)
