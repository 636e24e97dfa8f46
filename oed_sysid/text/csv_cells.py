"""One cell of a table: the number or the time that it holds, or what is wrong with it."""

from __future__ import annotations

import re
from datetime import UTC, datetime

# A sample that was not taken, in the words of loggers, spreadsheets and programs.
MISSING = frozenset(
    {"", "nan", "na", "n/a", "#n/a", "null", "none", "nat", "<na>", "-nan", "nan(ind)", "-nan(ind)"}
    | {"1.#qnan", "-1.#qnan", "1.#ind", "-1.#ind", "nan(snan)", "missing"}
)
_CLOCK = re.compile(r"(\d{1,3}):(\d{2}):(\d{2}(?:[.,]\d+)?)")
_DATE = re.compile(r"\d{4}-\d{2}-\d{2}[T ]\d{2}:\d{2}")
_DIGITS = r"\d+(?:[.,]\d+)?(?:[eE][+-]?\d+)?"
# Patterns of cells that are no number, and what to do about them.
_COMPLAINTS: tuple[tuple[re.Pattern[str], str], ...] = tuple(
    (re.compile(pattern, re.IGNORECASE), words)
    for pattern, words in (
        (r"[+-]?0x[0-9a-f]+", "is hexadecimal. Write decimal numbers"),
        (
            r"[+-]?\d{1,3}(?:,\d{3})+\.\d*|[+-]?\d{1,3}(?:\.\d{3})+,\d*|[+-]?\d{1,3}(?:['’ \u00a0"
            r"\u202f\u2009]\d{3})+(?:[.,]\d*)?|[+-]?\d{1,3}(?:\.\d{3}){2,}|[+-]?\d{1,3}(?:,\d{3}){2,}",
            "has separators of thousands. Write the number without them",
        ),
        (
            r"[+-]?\d+,\d+(?:e[+-]?\d+)?",
            "has a decimal comma in a file with commas between cells. Write a decimal point, or "
            "put semicolons between cells",
        ),
        (r"(?=.*_)[+-]?[\d_]+(?:\.[\d_]*)?(?:e[+-]?\d+)?", "has an underscore. Write digits only"),
        (
            r"(?=.*[\u2010-\u2015\u2212\ufe63\uff0d])[\u2010-\u2015\u2212\ufe63\uff0d+-]?[\d.,]+.*",
            "has a minus sign of typesetting. Write the one of the keyboard (-)",
        ),
        (
            r"(?=.*[^\x00-\x7f])[+-]?[\d.,．，]+(?:e[+-]?\d+)?",
            "has digits of another script. Write 0 to 9 and a decimal point",
        ),
        (r"[+-]?\d+[·‧∙]\d+", "has a raised decimal mark. Write a decimal point"),
        (r"\(\s*[\d.,]+\s*\)", "is a negative number as accountants write it. Write a minus sign"),
        (r"[+-]?\d+\.?\d*e[+-]?", "breaks off in its exponent. Write the whole number"),
        (r"[+-]?\d+\.?\d*[fFlL]", "has the suffix of a program's constant. Write digits only"),
        (r"(?:1\.)?#inf|-?1\.#inf", "is infinite. Leave the cell empty for a missing sample"),
        (r"['‘].*['’]", "stands between single quotes. Write numbers without quotes"),
        (r"[\[({].*[\])}]", "holds several numbers. Write one column for each"),
        (r"[€$£¥]\s*[\d.,]+", "is an amount of money. Write a number in the unit of the header"),
        (
            r"\d{1,3}:\d{2}(?::\d{2})?(?:[.,]\d+)?\s*[ap]\.?m\.?",
            "is a time of twelve hours. Write seconds, or times such as 13:05:00.5",
        ),
        (
            r"\d{1,3}:\d{2}(?:[.,]\d+)?",
            "is a time without seconds, or without hours. Write seconds, or times such as "
            "00:05:00.5",
        ),
        (
            r"(?:[a-z]{3,9}\.?,?\s+)?(?:[a-z]{3,9}\.?\s+\d{1,2}|\d{1,2}\.?\s+[a-z]{3,9}\.?),?\s+\d.*",
            "is a date in words. Write seconds, or ISO times such as 2024-05-31T12:00:00.5Z",
        ),
        (r"[+-]?\d+\.?\d*d[+-]?\d+", "has a Fortran exponent. Write e instead of d"),
        (
            r"#\w+[/!?]\S*",
            "is an error of the spreadsheet. Mend the formula, or leave the cell empty",
        ),
        (r"=.*", "is a formula. Save the values instead"),
        (r"[+-]?inf(?:inity)?", "is infinite. Leave the cell empty for a missing sample"),
        (
            rf"[+-]?{_DIGITS}\s*(?:°|%|[^\W\d_][\w/^²³·*]*)",
            "holds a unit. Write the unit into the header, as 'psi [deg]', and numbers below it",
        ),
        (
            r"\d{1,2}[./-]\d{1,2}[./-]\d{2,4}.*|\d{4}/\d{1,2}/\d{1,2}.*|\d{4}-\d{2}-\d{2}.*",
            "is a date in a form that can be read in two ways, or without a time. Write seconds, "
            "or ISO times such as 2024-05-31T12:00:00.5Z",
        ),
        (r"true|false|on|off|yes|no", "is a word. Write 1 and 0"),
        (r"\d+[°º].*", "is in degrees and minutes. Write decimal degrees"),
        (r"[+-]?[\d.]+[+-][\d.]+[ij]", "is a complex number. Write real and imaginary part apart"),
    )
)


def number(cell: str, *, comma: bool) -> float | None:
    """Number in a cell, NaN for a missing sample, None if it is something else.

    Parameters
    ----------
    cell : str
        The text.
    comma : bool
        Whether a comma may be the decimal mark.

    Examples
    --------
    >>> number("1,5", comma=True), number("1,5", comma=False), number(" n/a", comma=False)
    (1.5, None, nan)
    """
    text = cell.strip()
    if text.lower() in MISSING:
        return float("nan")
    if comma:
        if "," in text and "." in text:
            return None
        text = text.replace(",", ".", 1)
    if "_" in text or not text.isascii():
        return None
    try:
        return float(text)
    except ValueError:
        return None


def time_stamp(cell: str) -> tuple[float, str] | None:
    """Seconds of a time of day or of an ISO time, and which of the two; None for others.

    Seconds of an ISO time count from 1970, in UTC if it states a zone.

    Examples
    --------
    >>> time_stamp("00:01:02.5"), time_stamp("1970-01-01T00:00:01Z"), time_stamp("5.0")
    ((62.5, 'clock'), (1.0, 'zoned'), None)
    """
    text = cell.strip()
    match = _CLOCK.fullmatch(text)
    if match:
        hours, minutes, seconds = match.groups()
        parts = int(minutes), float(seconds.replace(",", "."))
        if parts[0] > 59 or parts[1] >= 60.0:
            return None
        return 3600.0 * int(hours) + 60.0 * parts[0] + parts[1], "clock"
    if not _DATE.match(text):
        return None
    try:
        moment = datetime.fromisoformat(text.replace(" UTC", "Z"))
    except ValueError:
        return None
    past = moment - datetime(1970, 1, 1, tzinfo=None if moment.tzinfo is None else UTC)
    # Whole seconds and the rest apart: microseconds survive.
    seconds_since = past.days * 86400 + past.seconds + past.microseconds * 1e-6
    return seconds_since, "zoned" if moment.tzinfo is not None else "date"


def complaint(cell: str) -> str:
    """Say what a cell holds instead of a number, and what to do.

    Examples
    --------
    >>> complaint("0x1F")
    "'0x1F' is hexadecimal. Write decimal numbers."
    """
    text = cell.strip()
    shown = repr(text if len(text) <= 40 else text[:37] + "...")
    for pattern, words in _COMPLAINTS:
        if pattern.fullmatch(text):
            return f"{shown} {words}."
    return f"{shown} is not a number. Leave the cell empty, or write nan, for a missing sample."
