"""What is done with a vehicle: manoeuvres, experiments and their limits, simulation, problems."""

from typing import Any

from oed_sysid.runtime.tables import tables

# Sentences of runs and problems that cannot be had.
SAYS: dict[str, Any] = tables(__file__, "sentences")
