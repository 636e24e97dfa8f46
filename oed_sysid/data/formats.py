"""Which format a log has: by its first bytes, then by its name."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from oed_sysid.data.ardupilot import read_dataflash
from oed_sysid.data.log import Log
from oed_sysid.data.matlab import read_matlab
from oed_sysid.data.nmea import read_nmea
from oed_sysid.data.px4 import read_ulog
from oed_sysid.data.ros import read_bag, read_mcap
from oed_sysid.data.tables import read_csv_log, read_excel, read_parquet
from oed_sysid.errors import DataError

_STARTS: tuple[tuple[bytes, Callable[[Path], Log]], ...] = (
    (b"ULog\x01\x12\x35", read_ulog),
    (b"\xa3\x95", read_dataflash),
    (b"#ROSBAG", read_bag),
    (b"\x89MCAP0\r\n", read_mcap),
    (b"MATLAB 5.0", read_matlab),
    (b"\x89HDF", read_matlab),
    (b"PK\x03\x04", read_excel),
    (b"PAR1", read_parquet),
)
_ENDINGS: dict[str, Callable[[Path], Log]] = {
    ".ulg": read_ulog, ".bag": read_bag, ".mcap": read_mcap, ".mat": read_matlab,
    ".xlsx": read_excel, ".xlsm": read_excel, ".parquet": read_parquet, ".bin": read_dataflash,
    ".nmea": read_nmea, ".csv": read_csv_log, ".tsv": read_csv_log,
}  # fmt: skip
READ = (
    "PX4 ULog, ArduPilot DataFlash .bin, ROS 1 and ROS 2 bags, MCAP, NMEA 0183, MATLAB .mat, "
    "Excel, Parquet, CSV"
)


def open_log(path: str | Path) -> Log:
    r"""Open a log of any format that is known.

    Parameters
    ----------
    path : str or Path
        The file; of a ROS 2 bag, the folder.

    Returns
    -------
    Log
        Its numeric fields with their times.

    Raises
    ------
    DataError
        If the format is not known, the file is damaged, or the library that reads it is not
        installed.

    Examples
    --------
    >>> import tempfile
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     file = Path(folder) / "run.csv"
    ...     _ = file.write_text("t [s],psi [deg]\n0,1\n0.5,2\n1,3\n")
    ...     log = open_log(file)
    >>> print(log.kind, log.names, log["run.psi [deg]"].rate)
    CSV file ('run.psi [deg]',) 2.0
    """
    place = Path(path).expanduser()
    if "\0" in str(path) or not place.exists():
        raise DataError(f"There is no file {str(path)!r}. Check the path.")
    if place.is_dir():
        if (place / "metadata.yaml").exists():
            return read_bag(place)
        raise DataError(
            f"{str(path)!r} is a folder without metadata.yaml, so no ROS 2 bag. Give one log file, "
            "or write metadata.yaml with  ros2 bag reindex."
        )
    try:
        with place.open("rb") as stream:
            start = stream.read(1024)
    except OSError as error:
        raise DataError(f"{place} cannot be read: {error.strerror or error}.") from None
    if not start:
        raise DataError(f"{place.name} is empty: nothing was logged, or the copy failed.")
    for first, reader in _STARTS:
        if start.startswith(first):
            return reader(place)
    if any(mark in start for mark in (b"$GP", b"$GN", b"$HE", b"$II", b"$WI", b"!AI", b"$SD")):
        return read_nmea(place)
    ending = place.suffix.lower()
    if ending in (".csv", ".tsv", ".txt", ".dat"):
        return read_csv_log(place)
    if ending == ".nmea":
        return read_nmea(place)
    if ending in _ENDINGS:
        raise DataError(
            f"{place.name} ends like a log that is read, but does not begin like one: it is "
            "damaged, or something else. Copy it again from the vehicle."
        )
    raise DataError(f"{place.name} has no format that is known. Read are: {READ}.")
