"""Hidden effects: how often the improvement finds them (:mod:`benchmarks.missing_physics.run`)."""

from benchmarks.harness import study
from benchmarks.missing_physics.run import STORE, calls, cases, table
from benchmarks.rates import summary

study(cases, table, STORE, calls=calls, tell=summary)
