"""Vehicles that nobody tuned for (:mod:`benchmarks.other_vehicles.run`)."""

from benchmarks.harness import study
from benchmarks.other_vehicles.run import STORE, cases, table
from benchmarks.rates import summary

study(cases, table, STORE, tell=summary)
