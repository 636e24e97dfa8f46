"""Vehicles that nobody tuned for (:mod:`benchmarks.other_vehicles.run`)."""

from benchmarks.harness import command
from benchmarks.other_vehicles.run import main

command(main)
