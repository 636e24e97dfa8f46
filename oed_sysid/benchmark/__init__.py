"""Estimators against each other, on problems whose truth is known.

>>> from oed_sysid.benchmark import benchmark
>>> result = benchmark(
...     ["nomoto_sparse_heading"], ["multiple_shooting", "heading_differences"],
...     noise=[1.0], seeds=1,
... )
>>> [row.estimator for row in result.rows]
['multiple_shooting', 'heading_differences']
"""

from oed_sysid.benchmark.cell import Cell, Outcome, run_cell
from oed_sysid.benchmark.contestants import CONTESTANTS, OURS, POPULATIONS, QUICK, Contestant
from oed_sysid.benchmark.grid import PROBLEMS, Benchmark, benchmark
from oed_sysid.benchmark.measures import Row, Verdict, measure, verdicts
from oed_sysid.benchmark.scenarios import UNITS, Scenario, load_scenario
from oed_sysid.benchmark.tables import as_csv, as_markdown
from oed_sysid.benchmark.world import WORLDS, World

__all__ = [
    "CONTESTANTS",
    "OURS",
    "POPULATIONS",
    "PROBLEMS",
    "QUICK",
    "UNITS",
    "WORLDS",
    "Benchmark",
    "Cell",
    "Contestant",
    "Outcome",
    "Row",
    "Scenario",
    "Verdict",
    "World",
    "as_csv",
    "as_markdown",
    "benchmark",
    "load_scenario",
    "measure",
    "run_cell",
    "verdicts",
]
