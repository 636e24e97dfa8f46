"""The same vehicles as a stranger would write them with the package's public names."""
