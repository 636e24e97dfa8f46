"""Other vehicles: how often the improvement finds hidden effects (:mod:`.run`)."""

from benchmarks.other_vehicles.run import main

main()
