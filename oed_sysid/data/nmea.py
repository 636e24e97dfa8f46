r"""NMEA 0183 sentences in a text file, parsed with pynmea2.

Few sentences have a time. Where lines begin with one (a number of seconds, an ISO time, or a
tag block ``\c:1700000000*hh\``), it is used. Otherwise the position sentences' own times (RMC,
GGA, GLL, ZDA) are the clock, and the sentences between two of them are spread evenly.
"""

from __future__ import annotations

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.csv_columns import DAY
from oed_sysid.data.log import Log, assemble, library
from oed_sysid.errors import DataError
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
    rows: dict[str, list[tuple[float, dict[str, float]]]] = {}
    for (topic, numbers, _, _), time in zip(parsed, times, strict=True):
        rows.setdefault(topic, []).append((time, numbers))
    topics = {}
    for topic, messages in rows.items():
        names = dict.fromkeys(name for _, numbers in messages for name in numbers)
        values = {
            name: np.array([numbers.get(name, np.nan) for _, numbers in messages]) for name in names
        }
        if values:
            topics[topic] = (np.array([time for time, _ in messages]), values)
    return assemble(path, "NMEA 0183", topics, notes=notes)


def sentence_of(line: str) -> tuple[float | None, str, dict[str, float]] | None:
    """Logger's time in front, type and numbers of one line; None if it holds no whole sentence.

    Parameters
    ----------
    line : str
        From a logger or a port.
    """
    pynmea2 = library("pynmea2", "NMEA 0183 sentences")
    if (found := _SENTENCE.search(line)) is None:
        return None
    try:
        sentence = pynmea2.parse(found.group().strip(), check=True)
    except Exception:  # a wrong checksum or a torn line
        return None
    return _stamp(line[: found.start()]), sentence.sentence_type, _numbers(sentence)


_Parsed = tuple[str, dict[str, float], float | None, float | None]


def _sentences(path: Path) -> tuple[list[_Parsed], int]:
    """Topic, numbers, time of the logger and time of day of every sentence; how many are torn."""
    pynmea2 = library("pynmea2", "NMEA 0183 sentences")
    parsed: list[_Parsed] = []
    bad = 0
    for found in filter(None, (_SENTENCE.search(line) for _, line in text_lines(path))):
        try:
            sentence = pynmea2.parse(found.group().strip(), check=True)
        except Exception:  # a wrong checksum or a torn line
            bad += 1
            continue
        before = found.string[: found.start()]
        topic = f"{getattr(sentence, 'talker', '') or ''}{sentence.sentence_type}"
        parsed.append((topic, _numbers(sentence), _stamp(before), _time_of_day(sentence)))
    return parsed, bad


def _numbers(sentence: Any) -> dict[str, float]:
    result = {}
    for _, name, *_ in getattr(sentence, "fields", ()):
        if name in ("lat", "lon", "timestamp", "datestamp"):
            continue
        value = getattr(sentence, name, None)
        try:
            result[name] = float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError):
            continue
    for name in ("latitude", "longitude"):
        value = getattr(sentence, name, None)
        if isinstance(value, float):
            result[name] = value
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
    since = timedelta(hours=moment.hour, minutes=moment.minute, seconds=moment.second)
    return since.total_seconds() + moment.microsecond * 1e-6


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
    # Times of day that go back by more than half a day are those of the next.
    back = np.flatnonzero(np.diff(moments) < -0.5 * DAY)
    for index in back:
        moments[index + 1 :] += DAY
    # Sentences of one moment come after each other: the first of them has the time.
    first = np.concatenate([[True], np.diff(moments) > 0.0])
    places, values = np.array(known)[first].astype(float), moments[first]
    if len(values) < 2:
        raise DataError(f"{path.name} covers a single moment. Nothing moves in it.")
    every = np.arange(len(stamps), dtype=float)
    times = np.interp(every, places, values)
    # Beyond the last known moment, at the usual pace.
    pace = (values[-1] - values[0]) / (places[-1] - places[0])
    late, early = every > places[-1], every < places[0]
    times[late] = values[-1] + pace * (every[late] - places[-1])
    times[early] = values[0] - pace * (places[0] - every[early])
    step = float(np.median(np.diff(values)))
    return times, (
        f"Only {len(known)} of {len(stamps)} sentences have a time; the others are spread evenly "
        f"between these ({step:.3g} s apart), which may be wrong by as much. A logger that writes "
        "a time in front of each line is better."
    )
