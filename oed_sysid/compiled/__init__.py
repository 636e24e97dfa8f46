"""C sources that are compiled together with generated code."""
