"""Files that are not quite tables of measurements, with what has to be said about each.

The channels are those of a ship: rudder [rad] in, heading psi [rad] and yaw rate
r [rad/s] out. ``REFUSED`` end in a DataError that contains the words, ``NOTED``
are read and noted with the words, ``READ`` are read as the good file is.
"""

from __future__ import annotations

import io
import math
import zipfile
from collections.abc import Callable
from typing import Any

from bad_input import text_of
from benchmarks.tables import tables
from oed_sysid.physics.channels import Channels, Input, Output

CHANNELS = Channels(
    (Input("rudder", "rad"),), (Output("psi", "rad", "heading"), Output("r", "rad/s", "yaw rate"))
)
HEADER = ("t [s]", "rudder [deg]", "psi [deg]", "r [deg/s]")
N_ROWS = 12


def cells() -> list[list[str]]:
    """Rows of a plausible log."""
    return [
        [
            f"{0.5 * i:g}",
            f"{10 * (-1) ** (i // 4)}",
            f"{12 + 3 * math.sin(0.4 * i):.3f}",
            f"{1.2 * math.cos(0.4 * i):.3f}",
        ]
        for i in range(N_ROWS)
    ]


def table(
    header: tuple[str, ...] | list[str] = HEADER,
    rows: list[list[str]] | None = None,
    *,
    between: str = ",",
    end: str = "\n",
) -> str:
    """Text of a table."""
    body = [list(header), *(cells() if rows is None else rows)]
    return end.join(between.join(row) for row in body) + end


def cell(row: int, column: int, text: str, **options: str) -> str:
    """The log with one cell replaced; rows count from 0, the first below the header."""
    rows = cells()
    rows[row][column] = text
    return table(rows=rows, **options)


def head(column: int, text: str) -> str:
    """The log with one header replaced."""
    header = list(HEADER)
    header[column] = text
    return table(header)


def column(index: int, change: Callable[[int, str], str], header: str | None = None) -> str:
    """The log with all cells of one column changed, given number and text."""
    rows = cells()
    for number, row in enumerate(rows):
        row[index] = change(number, row[index])
    headers = list(HEADER)
    if header is not None:
        headers[index] = header
    return table(headers, rows)


def comma(text: str) -> str:
    """Decimal commas for points."""
    return text.replace(".", ",")


def semicolons() -> str:
    """The log as a German spreadsheet writes it."""
    return table(rows=[[comma(one) for one in row] for row in cells()], between=";")


def workbook() -> bytes:
    """The smallest thing that a spreadsheet program would call its own."""
    target = io.BytesIO()
    with zipfile.ZipFile(target, "w") as packed:
        packed.writestr("xl/worksheets/sheet1.xml", "<worksheet/>")
    return target.getvalue()


GOOD = table()
ISO = "2024-05-31T12:00:{:04.1f}"

# What no change of the log in ``csv_files.toml`` gives.
MADE: dict[str, str | bytes] = {
    "header only": table(rows=[]),
    "Excel workbook": workbook(),
    "old Excel workbook": b"\xd0\xcf\x11\xe0" + b"\0" * 600,
    "gzip": b"\x1f\x8b\x08\0" + b"\x99" * 50,
    "xz": b"\xfd7zXZ\0" + b"\x99" * 50,
    "MATLAB": b"MATLAB 5.0 MAT-file" + b"\0" * 200,
    "random bytes": bytes(range(1, 256)) * 4,
    "zero bytes": b"\0" * 4096,
    "zero bytes at the end": GOOD.encode() + b"\0" * 64,
    "UTF-16 cut in a letter": GOOD.encode("utf-16")[:-1],
    "one row": table(rows=cells()[:1]),
    "four rows": table(rows=cells()[:4]),
    "no header": table(header=cells()[0], rows=cells()[1:]),
    "clock in digits": column(0, lambda i, _: f"{115954 + i + 4040 * (i > 5)}"),
    "date in digits": column(0, lambda i, _: f"{20240531120000 + i}"),
    "row too short": cell(4, 3, "1").replace(",1\n", "\n", 1),
    "cut in the last row": GOOD[: GOOD.rindex(",")],
    "header repeated": GOOD + GOOD,
    "commas in the header only": semicolons().replace(";", ",", 3),
    "tabs in the rows only": table(between="\t").replace("\t", ",", 3),
    "spaces": table(("t_s", "rudder_deg", "psi_deg", "r_degps"), between=" "),
    "bars": table(between="|"),
    "cell of many letters": cell(4, 2, "x" * 200_000),
    "header without end": head(2, "psi [" + "(" * 500),
    "clock set back": column(0, lambda i, x: f"{0.5 * (i % 6):g}"),
    "time decreases": column(0, lambda i, x: f"{-0.5 * i:g}"),
    "times rounded together": column(0, lambda i, x: f"{i // 3}"),
    "dates without a time": column(0, lambda i, x: f"2024-05-{i + 1:02d}"),
    "ISO times, one of them in another form": column(
        0, lambda i, x: ISO.format(i) if i != 5 else "12:00:05"
    ),
    "ISO times that run over midnight without a date": column(
        0, lambda i, x: f"{(23 + (i > 3)) % 24:02d}:59:{i:02d}"
    ),
    "ISO times, some with a zone": column(0, lambda i, x: ISO.format(i) + "Z" * (i > 3)),
    "60 seconds": column(0, lambda i, x: f"12:00:{55 + i}"),
    "milliseconds since 1970 in a column of seconds": column(
        0, lambda i, x: f"{1717156800000 + 500 * i}"
    ),
    "microseconds since 1970 in a column of seconds": column(
        0, lambda i, x: f"{1717156800000000 + 500000 * i}"
    ),
    "decimal commas between commas": comma(GOOD),
    "decimal comma and thousands": semicolons().replace("12,000", "1.012,000", 1),
    "point among decimal commas": semicolons().replace("12,000", "12.000", 1),
    "outputs all empty": table(rows=[[*row[:2], "", ""] for row in cells()]),
    "sentinel in many rows": column(3, lambda i, x: "-999" if i % 2 else x),
    "AIS": "!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C\n" * 3,
    "pairs of name and value": "".join(f"t={i} rudder=10 psi={i} r=0\n" for i in range(9)),
    "messages of a program": "".join(
        f"2024-05-31 12:00:{i:02d} INFO rudder 10 psi {i}\n" for i in range(9)
    ),
    "table of Markdown": "".join(f"| {' | '.join(row)} |\n" for row in (list(HEADER), *cells())),
    "table of LaTeX": table(between=" & ", end=" \\\\\n"),
    "column of row numbers": table(("", *HEADER), [["1", *row] for row in cells()]),
    "days of a spreadsheet": column(0, lambda i, x: f"{45443.5 + i * 5.787e-6:.8f}"),
    "days of MATLAB": column(0, lambda i, x: f"{739403.5 + i * 5.787e-6:.9f}"),
    "clock set on the way": column(0, lambda i, x: f"{0.5 * i + 1717156800 * (i > 5)}"),
    "end of summer time": column(0, lambda i, x: f"2024-10-27T{2 - i // 6:02d}:59:{i + 40}"),
    "two thousand other columns": table(
        ("t [s]", *(f"c{i} [m]" for i in range(2000))), [[f"{i}"] * 2001 for i in range(6)]
    ),
    "compass that crosses north": column(2, lambda i, x: f"{(350 + 4 * i) % 360}"),
    "time of day": column(0, lambda i, x: f"12:59:{i / 2 + 50:04.1f}" if i < 20 else "", "time"),
    "seconds since 1970": column(0, lambda i, x: f"{1717156800 + 0.5 * i}"),
    "milliseconds since 1970": column(0, lambda i, x: f"{1717156800000 + 500 * i}", "t [ms]"),
    "nanoseconds since 1970": column(
        0, lambda i, x: f"{1717156800 * 10**9 + 500000000 * i}", "t [ns]"
    ),
    "milliseconds called seconds": column(0, lambda i, x: f"{500 * i}"),
    "degrees called radians": column(2, lambda i, x: f"{30 * i}", "psi [rad]"),
    "rate of another world": column(3, lambda i, x: f"{1e5 * i}"),
}


def content_of(row: dict[str, Any]) -> str | bytes:
    """What a row of the table makes of the good log."""
    if row["kind"] in MADE:
        return MADE[row["kind"]]
    if "column" in row:
        index, form, *header = row["column"]
        return column(index, lambda n, _: form.format(n=n, t=0.5 * n), *header)
    if "cell" in row:
        return cell(*row["cell"])
    return head(*row["head"]) if "head" in row else text_of(row, GOOD)


# Kind, content, words.
REFUSED, NOTED = (
    tuple((row["kind"], content_of(row), tuple(row["words"])) for row in tables(__file__)[part])
    for part in ("refused", "noted")
)

READ: tuple[tuple[str, str | bytes], ...] = (
    ("good", GOOD),
    ("UTF-8 with mark", GOOD.encode("utf-8-sig")),
    ("UTF-16, little end first", b"\xff\xfe" + GOOD.encode("utf-16-le")),
    ("UTF-16, big end first", b"\xfe\xff" + GOOD.encode("utf-16-be")),
    ("UTF-32", GOOD.encode("utf-32")),
    ("Latin-1", table((*HEADER[:2], "psi [°]", HEADER[3])).encode("latin-1")),
    ("DOS line ends", table(end="\r\n")),
    ("old Macintosh line ends", table(end="\r")),
    ("mixed line ends", GOOD.replace("\n", "\r\n", 5).replace("\n", "\r", 2)),
    ("semicolons and decimal commas", semicolons()),
    ("tabs", table(between="\t")),
    ("spaces around cells", GOOD.replace(",", " , ")),
    ("quotes", "\n".join(",".join(f'"{c}"' for c in li.split(",")) for li in GOOD.splitlines())),
    ("comments and blank lines", "# log\n\n" + GOOD.replace("\n", "\n\n# a\n", 3)),
    ("trailing separators", GOOD.replace("\n", ",\n")),
    (
        "columns of text beside",
        table((*HEADER, "mode"), [[*row, "AUTO"] for row in cells()]),
    ),
    ("time in milliseconds", column(0, lambda i, x: f"{500 * i}", "t [ms]")),
    ("delimiter named by a spreadsheet", "sep=,\n" + GOOD),
    ("semicolon named by a spreadsheet", "sep=;\n" + semicolons()),
    ("empty rows", GOOD.replace("\n", "\n,,,\n", 3) + ",,,\n,,,\n"),
    ("form feeds", GOOD.replace("\n", "\n\f\n", 5)),
    (
        "not a number, as Windows programs write it",
        table((*HEADER, "z [m]"), [[*r, "-1.#IND"] for r in cells()]),
    ),
    ("words for missing samples", table((*HEADER, "z [m]"), [[*r, "N/A"] for r in cells()])),
)
