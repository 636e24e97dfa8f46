"""Random forces and imperfect sensors: coverage and errors (:mod:`benchmarks.random_forces`)."""

from benchmarks.harness import command
from benchmarks.random_forces.run import main

command(main)
