"""Hidden effects: how often the improvement finds them (:mod:`benchmarks.missing_physics.run`)."""

from benchmarks.harness import command
from benchmarks.missing_physics.run import main

command(main)
