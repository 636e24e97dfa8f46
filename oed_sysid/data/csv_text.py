"""The text of a file: its encoding, its lines, and what it is if it is no text.

Loggers and spreadsheets write UTF-8, UTF-16 with a mark, and Latin-1 (for the
degree sign); those are read. Everything else is said by its name.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from oed_sysid.errors import DataError

_EXPORT = "Open it there and save it as CSV (comma separated, UTF-8), or use oed-sysid import"
# How files that are often taken for tables begin, what they are, and what to do.
_KINDS: tuple[tuple[bytes, str, str], ...] = (
    (b"PK\x03\x04", "an Excel workbook, or another ZIP archive", _EXPORT),
    (b"\xd0\xcf\x11\xe0", "an old Excel workbook (XLS)", _EXPORT),
    (b"\x1f\x8b", "a gzip archive", "Unpack it first"),
    (b"BZh", "a bzip2 archive", "Unpack it first"),
    (b"\xfd7zXZ", "an xz archive", "Unpack it first"),
    (b"7z\xbc\xaf", "a 7-Zip archive", "Unpack it first"),
    (b"%PDF", "a PDF document", "Export the table as CSV"),
    (b"\x89PNG", "a picture", "Give the numbers that it was drawn from"),
    (b"\xff\xd8\xff", "a picture", "Give the numbers that it was drawn from"),
    (b"\x89HDF", "an HDF5 or MATLAB 7.3 file", "Export the table as CSV"),
    (
        b"MATLAB 5.0",
        "a MATLAB file",
        "Export the table with writetable(T, 'file.csv'), or use oed-sysid import",
    ),
    (b"\x93NUMPY", "a NumPy array", "Make a Record of it, or write it as CSV with headers"),
    (b"PAR1", "a Parquet file", "Use oed-sysid import, or export the table as CSV"),
    (b"SQLite format 3", "an SQLite database", "Export the table as CSV"),
    (b"#ROSBAG", "a ROS bag", "Use oed-sysid import"),
    (b"ULog\x01", "a PX4 log (ULog)", "Use oed-sysid import"),
    (b"\xa3\x95\x80", "an ArduPilot log (DataFlash)", "Use oed-sysid import"),
    (b"\x89MCAP0", "an MCAP file", "Use oed-sysid import"),
    (b"\x80\x04\x95", "a Python pickle", "Write the table as CSV"),
)
_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
# Larger than any table that fits into memory as Python text.
LARGEST = 4 * 1024**3
_CONTROL = dict.fromkeys((*range(9), *range(14, 32), 127))


def lines_of(path: Path) -> list[tuple[int, str]]:
    """Return the lines of a text file with their numbers, the first being 1.

    Blank lines and lines that start with ``#`` are left out. Line ends of any
    system are understood, also mixed.

    Raises
    ------
    DataError
        If the file is missing, cannot be read, or is no text.
    """
    text = _text(path)
    return [
        (number, line)
        for number, line in enumerate(_split(text), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]


def _split(text: str) -> list[str]:
    """Lines, whatever system they end on."""
    return re.split(r"\r\n|\n|\r", text) if "\r" in text else text.split("\n")


def _text(path: Path) -> str:
    if "\0" in str(path) or not path.exists():
        raise DataError(f"There is no file {str(path)!r}. Check the path.")
    if path.is_dir():
        raise DataError(f"{str(path)!r} is a folder. Give a file in it.")
    try:
        if path.stat().st_size > LARGEST:
            raise DataError(f"{path.name} has more than {LARGEST >> 30} GB. Cut it into parts.")
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}.") from None
    for start, what, advice in _KINDS:
        if content.startswith(start):
            raise DataError(f"{path.name} is {what}, not text. {advice}.")
    for mark, encoding in _MARKS:
        if content.startswith(mark):
            try:
                return _checked(path, content.decode(encoding))
            except UnicodeDecodeError as error:
                raise DataError(
                    f"{path.name} is marked as {encoding.upper()} but breaks off or is damaged at "
                    f"byte {error.start}. Write it again, as UTF-8."
                ) from None
    if content.count(0) > len(content) // 5:
        raise DataError(_wide(path, content))
    try:
        return _checked(path, content.decode("utf-8"))
    except UnicodeDecodeError:
        return _checked(path, content.decode("latin-1"))


def _wide(path: Path, content: bytes) -> str:
    """Say what a file full of zero bytes is."""
    even, odd = content[::2].count(0), content[1::2].count(0)
    if max(even, odd) > 0.4 * len(content) / 2 and min(even, odd) < 0.1 * len(content) / 2:
        return (
            f"{path.name} seems to be UTF-16 without the mark that says so. Save it as UTF-8 "
            "(comma separated)."
        )
    return (
        f"{path.name} consists mostly of zero bytes: the logger had no power, or the copy failed. "
        "Copy it again, or leave it out."
    )


def _checked(path: Path, text: str) -> str:
    """Refuse bytes that no text has."""
    if len(text.translate(_CONTROL)) == len(text):
        return text
    at = next(index for index, letter in enumerate(text) if ord(letter) in _CONTROL)
    row = len(_split(text[:at]))
    byte = ord(text[at])
    what = "a zero byte" if byte == 0 else f"the control character {byte:#04x}"
    raise DataError(
        f"Row {row} of {path.name} holds {what}, so the file is damaged or no text. Copy it again, "
        "or cut it before this row."
    )
