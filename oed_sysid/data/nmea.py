r"""NMEA 0183 sentences in a text file, parsed with pynmea2.

Few sentences have a time. Where lines begin with one (a number of seconds, an ISO time, or a
tag block ``\c:1700000000*hh\``), it is used. Otherwise the position sentences' own times (RMC,
GGA, GLL, ZDA) are the clock, and the sentences between two of them are spread evenly.
"""

from __future__ import annotations

import contextlib
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import counted_on
from oed_sysid.data.log import Log, Rows, assemble, topics_of
from oed_sysid.errors import DataError, library
from oed_sysid.text.csv_table import text_lines

_SENTENCE = re.compile(r"[$!][A-Z][A-Z0-9]{2,}[,*].*")
_TAG = re.compile(r"\\[^\\]*?c:(\d{9,16})[^\\]*\\")


def read_nmea(path: Path) -> Log:
    """Read a file of NMEA 0183 sentences.

    Topics are talker and sentence (``HEHDT``), fields those of pynmea2; latitude and longitude
    are in degrees, north and east positive.

    Parameters
    ----------
    path : Path
        The file.

    Raises
    ------
    DataError
        If pynmea2 is missing, or no sentence can be read or timed.
    """
    parsed, bad = _sentences(path)
    if not parsed:
        raise DataError(
            f"{path.name} holds no NMEA 0183 sentence with a right checksum ({bad} were refused). "
            "Log whole lines, from $ to the checksum."
        )
    notes = [f"{bad} of {bad + len(parsed)} sentences were torn and left out."] if bad else []
    times, words = _times(path, [stamp for _, _, stamp, _ in parsed], [t for *_, t in parsed])
    notes += [words] if words else []
    rows: Rows = {}
    for (topic, numbers, _, _), time in zip(parsed, times, strict=True):
        rows.setdefault(topic, []).append((time, numbers))
    return assemble(path, "NMEA 0183", topics_of(rows), notes=notes)


def sentence_of(line: str) -> tuple[float | None, str, dict[str, float]] | None:
    """Logger's time in front, type and numbers of one line; None if it holds no whole sentence.

    Parameters
    ----------
    line : str
        From a logger or a port.
    """
    before, sentence = _parsed(line)
    return sentence and (_stamp(before), sentence.sentence_type, _numbers(sentence))


def _parsed(line: str) -> tuple[str, Any]:
    """What stands in front of a sentence, and the sentence; None if there is no whole one."""
    pynmea2 = library("pynmea2", "Reading NMEA 0183 sentences")
    if (found := _SENTENCE.search(line)) is None:
        return line, None
    try:
        return line[: found.start()], pynmea2.parse(found.group().strip(), check=True)
    except Exception:  # a wrong checksum or a torn line
        return line, None


_Parsed = tuple[str, dict[str, float], float | None, float | None]


def _sentences(path: Path) -> tuple[list[_Parsed], int]:
    """Topic, numbers, time of the logger and time of day of every sentence; how many are torn."""
    parsed: list[_Parsed] = []
    lines = [line for _, line in text_lines(path) if _SENTENCE.search(line)]
    for line in lines:
        before, sentence = _parsed(line)
        if sentence is not None:
            topic = f"{getattr(sentence, 'talker', '') or ''}{sentence.sentence_type}"
            if sentence.sentence_type == "RPM":  # engines (E) and shafts (S) take turns
                topic += f"_{sentence.source}{sentence.engine_no}"
            parsed.append((topic, _numbers(sentence), _stamp(before), _time_of_day(sentence)))
    return parsed, len(lines) - len(parsed)


def _numbers(sentence: Any) -> dict[str, float]:
    names = [name for _, name, *_ in getattr(sentence, "fields", ())] + ["latitude", "longitude"]
    result = {}
    for name in names:
        if name not in ("lat", "lon", "timestamp", "datestamp"):
            with contextlib.suppress(TypeError, ValueError):
                result[name] = float(getattr(sentence, name, None))  # type: ignore[arg-type]
    return result


def _stamp(before: str) -> float | None:
    """Time of the logger in front of a sentence, in s."""
    tag = _TAG.search(before)
    if tag:
        value = float(tag[1])
        return value * 1e-3 if value > 1e11 else value
    text = before.strip().strip(",;: \t[]")
    number = re.fullmatch(r"\d+(\.\d+)?", text)
    if number:
        return float(text)
    try:
        moment = datetime.fromisoformat(text)
    except ValueError:
        return None
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _time_of_day(sentence: Any) -> float | None:
    moment = getattr(sentence, "timestamp", None)
    if moment is None or isinstance(moment, str):
        return None
    return 3600.0 * moment.hour + 60.0 * moment.minute + moment.second + 1e-6 * moment.microsecond


def _times(
    path: Path, stamps: list[float | None], of_day: list[float | None]
) -> tuple[np.ndarray, str]:
    """Time of every sentence, and what was done to find it."""
    if all(stamp is not None for stamp in stamps):
        return np.array(stamps, dtype=float), ""
    known = [index for index, time in enumerate(of_day) if time is not None]
    if not known:
        raise DataError(
            f"{path.name} has no times: neither its lines nor a sentence (RMC, GGA, GLL, ZDA) "
            "says when. Log with a time in front of each line."
        )
    moments = np.array([of_day[index] for index in known], dtype=float)
    moments = counted_on(moments)
    # Sentences of one moment come after each other: the first of them has the time.
    first = np.concatenate([[True], np.diff(moments) > 0.0])
    places, values = np.array(known)[first].astype(float), moments[first]
    if len(values) < 2:
        raise DataError(f"{path.name} covers a single moment. Nothing moves in it.")
    # Before the first known moment and after the last one, at the usual pace.
    pace, last = (values[-1] - values[0]) / (places[-1] - places[0]), len(stamps) - 1.0
    begin, end = values[0] - pace * places[0], values[-1] + pace * (last - places[-1])
    times = np.interp(np.arange(last + 1.0), [0.0, *places, last], [begin, *values, end])
    step = float(np.median(np.diff(values)))
    return times, (
        f"Only {len(known)} of {len(stamps)} sentences have a time; the others are spread evenly "
        f"between these ({step:.3g} s apart), which may be wrong by as much. A logger that writes "
        "a time in front of each line is better."
    )
