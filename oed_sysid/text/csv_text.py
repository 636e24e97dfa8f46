"""The text of a file: its encoding, its lines, and what it is if it is no text.

Loggers and spreadsheets write UTF-8, UTF-16 with a mark, and Latin-1 (for the
degree sign); those are read. Everything else is said by its name.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path

from oed_sysid.errors import DataError

_EXPORT = "Open it there and save it as CSV (comma separated, UTF-8)"
_IMPORT = "Turn it into CSV with: oed-sysid import"
# Sentences of instruments, and what a line of a program's messages looks like.
_SENTENCE = re.compile(r"[$!][A-Z]{2}[A-Z0-9]{3},")
_PAIRS = re.compile(r"\s*[A-Za-z_]\w*\s*[=:]\s*[-+.\w]+([,;\s]+[A-Za-z_]\w*\s*[=:]\s*[-+.\w]+)+\s*")
_MESSAGE = re.compile(r"\[?\d{4}-\d\d-\d\d[T ]\d\d:\d\d\S*\s+\[?[A-Z]{3,}\b.*")
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
        f"{_IMPORT}, or export the table with writetable(T, 'file.csv')",
    ),
    (b"\x93NUMPY", "a NumPy array", "Make a Record of it, or write it as CSV with headers"),
    (b"PAR1", "a Parquet file", _IMPORT),
    (b"SQLite format 3", "an SQLite database, such as a ROS 2 bag", _IMPORT),
    (b"#ROSBAG", "a ROS bag", _IMPORT),
    (b"ULog\x01", "a PX4 log (ULog)", _IMPORT),
    (b"\x89MCAP", "a ROS bag (MCAP)", _IMPORT),
    (b"\xa3\x95", "an ArduPilot log (DataFlash)", _IMPORT),
    (b"FMT, 128,", "an ArduPilot log (DataFlash)", _IMPORT),
    (b"ARROW1", "an Arrow (Feather) file", "Export the table as CSV"),
    (b"CDF\x01", "a NetCDF file", "Export the table as CSV"),
    (b"CDF\x02", "a NetCDF file", "Export the table as CSV"),
    (b"TDSm", "a LabVIEW file (TDMS)", "Export the table as CSV"),
    (b"bplist", "a binary property list", "Export the table as CSV"),
    (b"-----BEGIN ", "an encrypted or signed message", "Decrypt it first"),
    (
        b"version https://git-lfs",
        "the pointer that Git LFS keeps in place of a file",
        "Fetch the file itself with: git lfs pull",
    ),
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
    """Return the lines of a table with their numbers, the first being 1.

    Blank lines and lines that start with ``#`` are left out. Line ends of any
    system are understood, also mixed.

    Raises
    ------
    DataError
        If the file is missing, cannot be read, or is no table.
    """
    lines = text_lines(path)
    if lines and re.fullmatch(r"\"?sep=.\"?", lines[0][1].strip(), re.IGNORECASE):
        del lines[0]  # a spreadsheet's own word for its delimiter
    _check_kind(path, lines)
    return lines


def text_lines(path: Path) -> list[tuple[int, str]]:
    """Return the lines of any text file with their numbers; see :func:`lines_of`."""
    text = _text(path)
    return [
        (number, line)
        for number, line in enumerate(_split(text), start=1)
        # A row of delimiters alone holds nothing: spreadsheets append some.
        if line.strip(' \t,;\f\v"') and not line.lstrip().startswith("#")
    ]


def remark_before(path: Path, row: int) -> tuple[int, str] | None:
    """Number and text of the remark (``#``) right above a row; None if there is none."""
    for number, line in reversed(list(enumerate(_split(_text(path))[: row - 1], start=1))):
        if line.strip():
            text = line.lstrip()
            return (number, text.lstrip("#").strip()) if text.startswith("#") else None
    return None


def _check_kind(path: Path, lines: list[tuple[int, str]]) -> None:
    """Refuse text that is no table, in words of what it is."""
    first = [line for _, line in lines[:2]]
    if not first:
        return
    kinds = (
        (_SENTENCE.match, "sentences of instruments (NMEA 0183)", _IMPORT),
        (_PAIRS.fullmatch, "pairs of name and value", "Write one column per name, as CSV"),
        (_MESSAGE.fullmatch, "messages of a program", "Take the numbers out of them, as CSV"),
    )
    for is_one, what, advice in kinds:
        if all(is_one(line) for line in first):
            raise DataError(f"{path.name} holds {what}, not a table. {advice}.")
    if first[0].lstrip().startswith(r"{\rtf"):
        raise DataError(f"{path.name} is a document (RTF), not a table. Save it as CSV.")
    if " & " in first[0] and first[0].rstrip().endswith("\\\\"):
        raise DataError(f"{path.name} is a table of LaTeX. Write commas for & and drop the \\\\.")
    for number, line in lines:
        if line.startswith(("<<<<<<< ", ">>>>>>> ")) or line.rstrip() == "=======":
            raise DataError(
                f"Row {number} of {path.name} is a mark of a merge that Git could not finish: the "
                "file holds two versions. Choose one of them."
            )


def _split(text: str) -> list[str]:
    """Lines, whatever system they end on."""
    return re.split(r"\r\n|\n|\r", text) if "\r" in text else text.split("\n")


def _text(path: Path) -> str:
    if "\0" in str(path) or not path.exists():
        raise DataError(f"There is no file {str(path)!r}. Check the path.")
    if path.is_dir():
        raise DataError(f"{str(path)!r} is a folder. Give a file in it.")
    if not path.is_file():
        raise DataError(
            f"{str(path)!r} is a device or a pipe, not a file. Copy it to a file first."
        )
    try:
        if path.stat().st_size > LARGEST:
            raise DataError(f"{path.name} has more than {LARGEST >> 30} GB. Cut it into parts.")
        content = path.read_bytes()
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}.") from None
    for start, what, advice in _KINDS:
        if content.startswith(start):
            raise DataError(f"{path.name} is {what}, not a table. {advice}.")
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
