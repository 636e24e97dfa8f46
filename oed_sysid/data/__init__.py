"""Measured records: files, checks, reconstruction, third-party measurements."""

from typing import Any

from oed_sysid.runtime.tables import tables

# What is said of files, logs and records that cannot be read.
SAYS: dict[str, Any] = tables(__file__, "sentences")
