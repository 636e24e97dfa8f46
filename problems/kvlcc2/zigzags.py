"""Ten zigzag tests of HSVA, 2 Hz, read for any of the models."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from oed_sysid import Channels, Dataset, read_csv
from oed_sysid.data.third_party import fetch, registered

FOLDER = "kvlcc2_hsva_zigzag/HSVA"
# 20 Hz to 2 Hz. Above 1 Hz the signals hold less than 0.6 mm/s, 0.005 deg/s and 0.01 deg,
# so nothing that matters is folded back; corners of the rudder's ramps move by < 0.25 s.
STEP = 10


def run_name(path: str) -> str:
    """Return ``20_05`` for ``.../HSVA_CPMC_KVLCC2_Z_20_05.csv``: rudder and switch heading."""
    return Path(path).stem.removeprefix("HSVA_CPMC_KVLCC2_Z_")


def zigzags(channels: Channels, *, step: int = STEP) -> Dataset:
    """Return the ten runs; every ``step``-th of the 20 samples per second."""
    paths = {run_name(path): path for path in registered(FOLDER)}
    records = [
        read_csv(fetch(path), channels, name=name)[0].thin(step) for name, path in paths.items()
    ]
    return Dataset(tuple(records))


def zigzag_reader(channels: Channels) -> Callable[[], Dataset]:
    """Return what a problem calls for its records."""
    return lambda: zigzags(channels)
