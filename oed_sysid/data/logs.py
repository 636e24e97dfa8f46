"""Logs in: the files that vehicles write, as records.

:func:`~oed_sysid.data.formats.open_log` reads PX4 ULog, ArduPilot DataFlash, ROS 1 and 2 bags,
MCAP, NMEA 0183, MATLAB, Excel, Parquet and CSV, each with its own library (``pip install
"oed_sysid[logs]"``); :func:`~oed_sysid.data.formats.log_of` takes pandas and xarray objects. A
:class:`~oed_sysid.data.mapping.LogMapping`, kept as a small text file, says which field is which
channel, and :func:`~oed_sysid.data.records.import_log` makes records of it, with every sample at
its own time.
"""

from oed_sysid.data.formats import log_of, open_log
from oed_sysid.data.log import Log, Series
from oed_sysid.data.mapping import LogMapping, Source, read_mapping
from oed_sysid.data.recognise import Guess, Recognised, draft, recognise
from oed_sysid.data.records import Imported, import_log
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
