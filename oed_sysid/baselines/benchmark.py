"""Estimators against each other, on problems whose truth is known.

>>> from oed_sysid.baselines.benchmark import benchmark
>>> result = benchmark(
...     ["nomoto_sparse_heading"], ["multiple_shooting", "heading_differences"],
...     noise=[1.0], seeds=1,
... )
>>> [row.estimator for row in result.rows]
['multiple_shooting', 'heading_differences']
"""

from oed_sysid.baselines.comparison import (
    PROBLEMS,
    Benchmark,
    Row,
    Verdict,
    as_csv,
    as_markdown,
    benchmark,
    measure,
    verdicts,
)
from oed_sysid.baselines.contest import (
    CONTESTANTS,
    OURS,
    POPULATIONS,
    QUICK,
    UNITS,
    Cell,
    Contestant,
    Outcome,
    Scenario,
    load_scenario,
    run_cell,
)
from oed_sysid.baselines.world import WORLDS, World

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
