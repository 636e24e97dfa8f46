"""Physics written as text: notation, units, expressions, dimensions, typesetting."""

from typing import Any

from oed_sysid.runtime.tables import tables

# What is refused of tables, expressions and names.
SAYS: dict[str, Any] = tables(__file__, "sentences")
