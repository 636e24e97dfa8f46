"""Random forces and imperfect sensors: coverage and errors (:mod:`benchmarks.random_forces`)."""

from benchmarks.harness import study
from benchmarks.random_forces.run import STORE, calls, cases, table

study(cases, table, STORE, calls=calls, tell=lambda row: f"{row['key']}: {row['fit']['status']}")
