"""What is done with a vehicle: manoeuvres, experiments and their limits, simulation, problems."""

import tomllib
from pathlib import Path
from typing import Any

# Sentences of runs and problems that cannot be had.
SAYS: dict[str, Any] = tomllib.loads(Path(__file__).with_name("sentences.toml").read_text("utf-8"))
