"""Physics written as text: notation, units, expressions, dimensions, typesetting."""
