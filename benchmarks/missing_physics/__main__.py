"""``python -m benchmarks.missing_physics``: see :mod:`benchmarks.missing_physics.run`."""

from benchmarks.missing_physics.run import main

main()
