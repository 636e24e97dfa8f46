"""Public benchmarks with official splits, beside the published table and its source.

``python -m benchmarks.scoreboard [name ...]`` from the root of the repository scores the
benchmarks whose files are in the data folder (``OED_SYSID_DATA``), says which files the others
lack, and writes ``docs/scoreboard.md``. What is wrong with a file stands in its row and takes no
other row along. Each module has ``score() -> list[Row]``; a held-back part is scored as soon as its
file lies where the row of :func:`benchmarks.scoreboard.row.missing` says.
"""
