"""Other people's tools on the same data; each module is run in a process of its own."""
