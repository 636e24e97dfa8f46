"""How it is run and shown: files, processes, results as data and documents."""
