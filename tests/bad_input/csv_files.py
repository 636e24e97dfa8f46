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

# kind, content, words
REFUSED: tuple[tuple[str, str | bytes, tuple[str, ...]], ...] = (
    # -- what is no table at all
    ("empty", b"", ("is empty", "'t [s],theta [deg]'")),
    ("blank lines only", b"\n\n  \n", ("is empty",)),
    ("comments only", "# a\n# b\n", ("is empty",)),
    ("header only", table(rows=[]), ("holds no rows of numbers",)),
    ("Excel workbook", workbook(), ("Excel workbook", "save it as CSV")),
    ("old Excel workbook", b"\xd0\xcf\x11\xe0" + b"\0" * 600, ("old Excel workbook (XLS)",)),
    ("gzip", b"\x1f\x8b\x08\0" + b"\x99" * 50, ("gzip archive", "Unpack")),
    ("xz", b"\xfd7zXZ\0" + b"\x99" * 50, ("xz archive", "Unpack")),
    ("PDF", b"%PDF-1.7\n...", ("PDF document",)),
    ("PNG", b"\x89PNG\r\n\x1a\n", ("a picture",)),
    ("JPEG", b"\xff\xd8\xff\xe0", ("a picture",)),
    ("HDF5", b"\x89HDF\r\n\x1a\n", ("HDF5",)),
    ("MATLAB", b"MATLAB 5.0 MAT-file" + b"\0" * 200, ("MATLAB file", "writetable")),
    ("NumPy", b"\x93NUMPY\x01\0", ("NumPy array",)),
    ("Parquet", b"PAR1\x15\0", ("Parquet",)),
    ("SQLite", b"SQLite format 3\0", ("SQLite",)),
    ("ROS bag", b"#ROSBAG V2.0\n", ("ROS bag",)),
    ("PX4 log", b"ULog\x01\x12\x35", ("PX4 log",)),
    ("pickle", b"\x80\x04\x95\0\0", ("pickle",)),
    ("random bytes", bytes(range(1, 256)) * 4, ("control character", "Row 1")),
    ("zero bytes", b"\0" * 4096, ("zero bytes", "Copy it again")),
    ("zero bytes at the end", GOOD.encode() + b"\0" * 64, ("a zero byte", "Row 14")),
    ("zero byte in a cell", cell(3, 2, "1\0"), ("Row 5", "a zero byte")),
    ("JSON", '{"t": [0, 1]}\n{"t": [2]}\n', ("JSON",)),
    ("XML", "<?xml version='1.0'?>\n<a>1</a>\n", ("XML",)),
    ("web page", "<html>\n<body>404</body>\n</html>\n", ("web page",)),
    ("UTF-16 without mark", GOOD.encode("utf-16-le"), ("UTF-16 without the mark",)),
    ("UTF-16 without mark, big end first", GOOD.encode("utf-16-be"), ("UTF-16 without",)),
    ("UTF-16 cut in a letter", GOOD.encode("utf-16")[:-1], ("marked as UTF-16", "breaks off")),
    # -- layout
    ("one row", table(rows=cells()[:1]), ("has 1 samples; at least 5",)),
    ("four rows", table(rows=cells()[:4]), ("has 4 samples; at least 5",)),
    ("no header", table(header=cells()[0], rows=cells()[1:]), ("holds numbers, not headers",)),
    ("empty header cell", head(2, ""), ("Column 3", "has no header")),
    ("per cent of degrees", head(2, "psi [deg%]"), ("Unknown unit 'deg%'",)),
    ("degrees in per cent", head(2, "psi [deg/%]"), ("a part in a hundred of an angle",)),
    ("two units in one header", head(2, "psi_rad [deg]"), ("two units, rad and deg",)),
    ("letter of another script", head(1, "r\u0443dder [deg]"), ("Did you mean",)),
    ("unit of another script", head(2, "psi [d\u0435g]"), ("It is not 'deg'", "CYRILLIC SMALL LETTER IE")),
    ("clock in digits", column(0, lambda i, _: f"{115954 + i + 4040 * (i > 5)}"), ("a clock in digits",)),
    ("date in digits", column(0, lambda i, _: f"{20240531120000 + i}"), ("a date or a clock",)),
    ("header too short", table(HEADER[:3]), ("Row 2", "4 cells", "header has 3")),
    ("header too long", table((*HEADER, "z [m]")), ("Row 2", "4 cells", "header has 5")),
    ("row too short", cell(4, 3, "1").replace(",1\n", "\n", 1), ("Row 6", "3 cells")),
    ("row too long", cell(4, 3, "1,1"), ("Row 6", "5 cells", "header has 4")),
    ("cut in the last row", GOOD[: GOOD.rindex(",")], ("Row 13", "cut off")),
    ("quote not closed", cell(4, 2, '"12.0'), ("Row 6", "quotation mark")),
    ("footer", GOOD + "END\n", ("Row 14", "has 1 cell,")),
    ("header repeated", GOOD + table(), ("Row 14", "repeats the header")),
    ("duplicated header", head(3, "psi [deg]"), ("two columns 'psi [deg]'",)),
    ("same signal twice", head(3, "psi [rad]"), ("both look like 'psi'", "column=")),
    ("semicolons in the header only", table().replace(",", ";", 3), ("';'", "','")),
    ("commas in the header only", semicolons().replace(";", ",", 3), ("','", "';'")),
    ("tabs in the rows only", table(between="\t").replace("\t", ",", 3), ("','", r"'\t'")),
    ("spaces", table(("t_s", "rudder_deg", "psi_deg", "r_degps"), between=" "), ("has spaces",)),
    ("bars", table(between="|"), ("bars (|)",)),
    ("logger's preamble", "Logger 4, serial 1312\n" + GOOD, ("Row 2", "no header of it", "Put #")),
    (
        "units in a line of their own",
        table(("t", "rudder", "psi", "r"), [["s", "deg", "deg", "deg/s"], *cells()]),
        ("second line", "'t [s],rudder [deg],psi [deg],r [deg/s]'"),
    ),
    (
        "signals in rows",
        "t [s],0,1,2,3,4,5\nrudder [deg],0,0,5,5,5,5\npsi [deg],1,2,3,4,5,6\n",
        ("turn the table",),
    ),
    ("cell of many letters", cell(4, 2, "x" * 200_000), ("Row 6", "column 'psi [deg]'", "xxx...")),
    # -- headers, units
    ("no time column", head(0, "tick [s]"), ("no time column", "'tick [s]'", "time=...")),
    ("two time columns", head(1, "time [s]"), ("more than one time column",)),
    ("input missing", head(1, "helm [deg]"), ("no column 'rudder'", "Input(column=...)")),
    ("input in other letters", head(1, "Rudder [deg]"), ("no column 'rudder'", "Did you mean")),
    (
        "no output",
        table(("t [s]", "rudder [deg]", "heading [deg]", "rate [deg/s]")),
        ("none of the outputs psi, r", "'heading [deg]'"),
    ),
    ("unit missing", head(2, "psi"), ("'psi'", "has no unit", "'psi [rad]'")),
    ("unit of the input missing", head(1, "rudder"), ("'rudder'", "has no unit")),
    ("unit of the time missing", head(0, "t"), ("'t'", "has no unit", "'t [s]'")),
    ("unit empty", head(2, "psi []"), ("is in [1]", "needs [rad]")),
    ("unit unknown", head(2, "psi [grad]"), ("'psi [grad]'", "Unknown unit 'grad'")),
    ("unit misspelt", head(3, "r [deg/sec]"), ("Unknown unit 'sec'",)),
    ("unit of another dimension", head(2, "psi [m]"), ("is in [m]", "needs [rad]")),
    ("rate as an angle", head(3, "r [deg]"), ("is in [deg]", "needs [rad/s]")),
    ("revolutions for radians", head(3, "r [rpm]"), ("is in [rpm]", "needs [rad/s]")),
    ("time in metres", head(0, "t [m]"), ("is in [m]", "needs [s]")),
    ("unit with a huge exponent", head(2, "psi [rad^99999999999]"), ("rad^99999999999",)),
    ("header without end", head(2, "psi [" + "(" * 500), ("characters", "'psi [deg]'")),
    ("operator alone in a unit", head(3, "r [deg//s]"), ("'/' stands alone",)),
    ("two exponents in a unit", head(3, "r [deg s-1^2]"), ("Unknown unit '^'",)),
    ("brackets not closed", head(2, "psi [deg"), ("'psi [deg'", "not closed")),
    # -- time
    ("time repeats", cell(4, 0, "1.5"), ("Row 6", "time 1.5 repeats that of the row before")),
    ("time runs backwards", cell(4, 0, "0.2"), ("Row 6", "0.2 after 1.5 runs backwards")),
    ("clock set back", column(0, lambda i, x: f"{0.5 * (i % 6):g}"), ("Row 8", "backwards")),
    ("time decreases", column(0, lambda i, x: f"{-0.5 * i:g}"), ("log.csv", "in reverse")),
    ("time constant", column(0, lambda i, x: "0"), ("Row 3", "repeats")),
    ("time empty", cell(4, 0, ""), ("Row 6", "the time is empty")),
    ("time NaN", cell(4, 0, "NaN"), ("Row 6", "or no number (1 such row)")),
    ("time infinite", cell(4, 0, "inf"), ("Row 6", "not a finite number")),
    ("times rounded together", column(0, lambda i, x: f"{i // 3}"), ("Row 3", "repeats")),
    ("day before month", column(0, lambda i, x: f"31/05/2024 12:00:{i:02d}"), ("two ways", "ISO")),
    ("American dates", column(0, lambda i, x: f"05/31/2024 12:00:{i:02d}"), ("two ways", "ISO")),
    ("dates without a time", column(0, lambda i, x: f"2024-05-{i + 1:02d}"), ("without a time",)),
    (
        "ISO times, one of them in another form",
        column(0, lambda i, x: ISO.format(i) if i != 5 else "12:00:05"),
        ("Row 7", "no time in the form of the first"),
    ),
    (
        "ISO times that run over midnight without a date",
        column(0, lambda i, x: f"{(23 + (i > 3)) % 24:02d}:59:{i:02d}"),
        ("Row 6", "looks like midnight"),
    ),
    (
        "ISO times, some with a zone",
        column(0, lambda i, x: ISO.format(i) + "Z" * (i > 3)),
        ("Row 6", "no time in the form of the first"),
    ),
    ("60 seconds", column(0, lambda i, x: f"12:00:{55 + i}"), ("Row 7", "no time in the form")),
    (
        "milliseconds since 1970 in a column of seconds",
        column(0, lambda i, x: f"{1717156800000 + 500 * i}"),
        ("ms since 1970", "'t [ms]'"),
    ),
    (
        "microseconds since 1970 in a column of seconds",
        column(0, lambda i, x: f"{1717156800000000 + 500000 * i}"),
        ("us since 1970", "'t [us]'"),
    ),
    # -- cells
    ("word", cell(4, 2, "north"), ("Row 6", "'psi [deg]'", "'north' is not a number")),
    ("column of text", column(2, lambda i, x: "AUTO"), ("Row 2", "'AUTO' is not a number")),
    ("hexadecimal", cell(4, 2, "0x1F"), ("Row 6", "hexadecimal")),
    ("underscores", cell(4, 2, "1_000"), ("Row 6", "underscore")),
    ("Fortran exponent", cell(4, 2, "1.2D+01"), ("Row 6", "Fortran exponent")),
    ("two points", cell(4, 2, "1.2.3"), ("Row 6", "'1.2.3' is not a number")),
    ("two signs", cell(4, 2, "--1.2"), ("Row 6", "'--1.2' is not a number")),
    ("unit in the cell", cell(4, 2, "12.5 deg"), ("Row 6", "holds a unit", "header")),
    ("percent in the cell", cell(4, 2, "12.5%"), ("Row 6", "holds a unit")),
    ("degree sign in the cell", cell(4, 2, "12.5°"), ("Row 6", "holds a unit")),
    ("degrees and minutes", cell(4, 2, "12°30'"), ("Row 6", "decimal degrees")),
    ("complex number", cell(4, 2, "1.0+2.0j"), ("Row 6", "complex number")),
    ("truth values", column(1, lambda i, x: "true"), ("Row 2", "Write 1 and 0")),
    ("spreadsheet's error", cell(4, 2, "#DIV/0!"), ("Row 6", "error of the spreadsheet")),
    ("formula", cell(4, 2, "=B2*2"), ("Row 6", "formula")),
    ("decimal comma in quotes", cell(4, 2, '"12,5"'), ("Row 6", "decimal comma")),
    ("thousands in quotes", cell(4, 2, '"1,234.5"'), ("Row 6", "separators of thousands")),
    ("thousands with an apostrophe", cell(4, 2, "1'234.5"), ("Row 6", "separators of thousands")),
    ("thousands with a space", cell(4, 2, "1 234.5"), ("Row 6", "separators of thousands")),
    ("decimal commas between commas", comma(GOOD), ("Row 2", "decimal marks", "semicolons")),
    (
        "decimal comma and thousands",
        semicolons().replace("12,000", "1.012,000", 1),
        ("Row 2", "separators of thousands"),
    ),
    (
        "point among decimal commas",
        semicolons().replace("12,000", "12.000", 1),
        ("has decimal commas, but row 2 has a point", "thousands"),
    ),
    ("input empty", cell(4, 1, ""), ("Row 6", "input 'rudder' is empty", "known at every time")),
    ("input NaN", cell(4, 1, "nan"), ("Row 6", "input 'rudder'")),
    ("input infinite", cell(4, 1, "inf"), ("Row 6", "input 'rudder'")),
    ("output infinite", cell(4, 2, "inf"), ("Row 6", "output 'psi' is infinite")),
    ("output beyond all numbers", cell(4, 2, "1e999"), ("Row 6", "is infinite")),
    ("output huge", cell(4, 2, "1e200"), ("Row 6", "1e+200", "no measurement")),
    ("input huge", cell(4, 1, "-3e88"), ("Row 6", "-3e+88", "no measurement")),
    (
        "outputs all empty",
        table(rows=[[*row[:2], "", ""] for row in cells()]),
        ("no sample of any output", "psi, r"),
    ),
    ("sentinel -9999", cell(4, 2, "-9999"), ("-9999 in 1 rows", "row 6", "leave those cells")),
    ("sentinel 99999", cell(7, 3, "99999"), ("99999 in 1 rows", "row 9")),
    ("sentinel of NetCDF", cell(7, 3, "9.969209968386869e+36"), ("9.96921e+36", "row 9")),
    ("sentinel in an input", cell(4, 1, "-32768"), ("-32768", "row 6")),
    ("sentinel in many rows", column(3, lambda i, x: "-999" if i % 2 else x), ("-999 in 6 rows",)),
    # -- files of instruments and programs
    ("ROS bag (MCAP)", b"\x89MCAP0\r\n\x01\0", ("ROS bag (MCAP)", "oed-sysid import")),
    ("ArduPilot log", b"\xa3\x95\x80\x80\x59FMT\0", ("ArduPilot log", "oed-sysid import")),
    (
        "ArduPilot log as text",
        "FMT, 128, 89, FMT, BBnNZ, Type,Length,Name,Format,Columns\nATT, 1234, 0.1, 0.2\n",
        ("ArduPilot log", "oed-sysid import"),
    ),
    (
        "NMEA",
        "$GPRMC,123519,A,4807.038,N,01131.000,E,022.4,084.4,230394,003.1,W*6A\n"
        "$GPGGA,123519,4807.038,N,01131.000,E,1,08,0.9,545.4,M,46.9,M,,*47\n",
        ("NMEA 0183", "oed-sysid import"),
    ),
    ("AIS", "!AIVDM,1,1,,B,177KQJ5000G?tO`K>RA1wUbN0TKH,0*5C\n" * 3, ("NMEA 0183",)),
    ("Arrow", b"ARROW1\0\0\xff\xff", ("Arrow (Feather)", "as CSV")),
    ("NetCDF", b"CDF\x01\0\0\0\x10", ("NetCDF", "as CSV")),
    ("LabVIEW", b"TDSm\x0e\0\0\0", ("LabVIEW", "as CSV")),
    (
        "pointer of Git LFS",
        "version https://git-lfs.github.com/spec/v1\noid sha256:4d7a\nsize 12345\n",
        ("pointer", "git lfs pull"),
    ),
    ("encrypted", "-----BEGIN PGP MESSAGE-----\n\nhQEMA\n", ("encrypted", "Decrypt")),
    (
        "merge that was not finished",
        GOOD.replace("\n", "\n<<<<<<< HEAD\n", 1) + "=======\n1,2,3,4\n>>>>>>> other\n",
        ("Row 2", "merge", "two versions"),
    ),
    (
        "pairs of name and value",
        "".join(f"t={i} rudder=10 psi={i} r=0\n" for i in range(9)),
        ("pairs of name and value", "one column per name"),
    ),
    (
        "messages of a program",
        "".join(f"2024-05-31 12:00:{i:02d} INFO rudder 10 psi {i}\n" for i in range(9)),
        ("messages of a program",),
    ),
    (
        "table of Markdown",
        "".join(f"| {' | '.join(row)} |\n" for row in (list(HEADER), *cells())),
        ("bars (|)",),
    ),
    (
        "table of LaTeX",
        "".join(" & ".join(row) + " \\\\\n" for row in (list(HEADER), *cells())),
        ("LaTeX",),
    ),
    (
        "units in brackets in a line of their own",
        table(("t", "rudder", "psi", "r"), [["[s]", "[deg]", "[deg]", "[deg/s]"], *cells()]),
        ("second line", "'t [s],rudder [deg],psi [deg],r [deg/s]'"),
    ),
    (
        "line break in a header",
        GOOD.replace("psi [deg]", '"psi\n[deg]"', 1),
        ("quotation mark in the header", "one line"),
    ),
    ("mean below the columns", GOOD + "mean,0,12.1,0.3\n", ("Row 14", "'mean' is not a number")),
    ("column of row numbers", table(("", *HEADER), [["1", *row] for row in cells()]),
     ("Column 1", "has no header")),
    # -- cells as other programs write them
    ("infinity of a Windows program", cell(4, 2, "1.#INF"), ("Row 6", "is infinite")),
    ("minus sign of typesetting", cell(4, 2, "\u22121.2"), ("Row 6", "minus sign of typesetting")),
    ("digits of another script", cell(4, 2, "１２.５"), ("Row 6", "another script")),
    ("negative in brackets", cell(4, 2, "(1.2)"), ("Row 6", "accountants", "minus sign")),
    ("raised decimal mark", cell(4, 2, "12·5"), ("Row 6", "decimal point")),
    ("suffix of a constant", cell(4, 2, "1.2f"), ("Row 6", "suffix")),
    ("exponent broken off", cell(4, 2, "1.2e"), ("Row 6", "breaks off")),
    ("thin space", cell(4, 2, "1\u2009234"), ("Row 6", "separators of thousands")),
    ("single quotes", cell(4, 2, "'12.0'"), ("Row 6", "single quotes")),
    ("vector in a cell", cell(4, 2, '"[1.0, 2.0]"'), ("Row 6", "several numbers")),
    ("money", cell(4, 2, "€12"), ("Row 6", "money")),
    ("colours of a terminal", cell(4, 2, "\x1b[31m12\x1b[0m"), ("Row 6", "0x1b")),
    # -- times as other programs write them
    ("days of a spreadsheet", column(0, lambda i, x: f"{45443.5 + i * 5.787e-6:.8f}"),
     ("count days", "2024-05-31", "86400")),
    ("days of MATLAB", column(0, lambda i, x: f"{739403.5 + i * 5.787e-6:.9f}"),
     ("count days", "2024-05-31")),
    ("clock set on the way", column(0, lambda i, x: f"{0.5 * i + 1717156800 * (i > 5)}"),
     ("Row 8", "54 years later", "Cut the log")),
    ("twelve hours", column(0, lambda i, x: f"12:00:{i:02d} PM", "time"), ("Row 2", "twelve hours")),
    ("minutes and seconds", column(0, lambda i, x: f"00:{i:02d}.5", "time"), ("without hours",)),
    ("month in words", column(0, lambda i, x: f"May 31 2024 12:00:{i:02d}", "time"), ("in words",)),
    ("unit in the time", column(0, lambda i, x: f"{0.5 * i} s"), ("Row 2", "holds a unit")),
    ("year of two digits", column(0, lambda i, x: f"24-05-31 12:00:{i:02d}"), ("two ways",)),
    ("end of summer time", column(0, lambda i, x: f"2024-10-27T{2 - i // 6:02d}:59:{i + 40}"),
     ("Row 8", "runs backwards")),
    # -- headers as other programs write them
    ("unit in capitals", head(2, "psi [Deg]"), ("Unknown unit 'Deg'", "Did you mean 'deg'?")),
    ("unit in words", head(2, "psi [degrees]"), ("Unknown unit", "Did you mean 'deg'?")),
    ("degree sign in a wrong encoding", head(2, "psi [Â°]"), ("Did you mean 'deg'?",)),
    ("degree sign lost", head(2, "psi [\ufffd]"), ("Did you mean 'deg'?",)),
    ("per cent of full rudder", head(1, "rudder [%]"), ("is in [%]", "needs [rad]")),
    ("unit of truth values", head(1, "rudder [bool]"), ("Unknown unit 'bool'",)),
    ("two thousand other columns",
     table(("t [s]", *(f"c{i} [m]" for i in range(2000))), [[f"{i}"] * 2001 for i in range(6)]),
     ("no column 'rudder'", "and 1971 more")),
    ("compass that crosses north", column(2, lambda i, x: f"{(350 + 4 * i) % 360}"),
     ("jumps by a full turn", "from 358 to 2 deg. The angle is wrapped: declare Output(", "wrap=True")),
)  # fmt: skip

NOTED: tuple[tuple[str, str | bytes, tuple[str, ...]], ...] = (
    ("ISO times", column(0, lambda i, x: ISO.format(i / 2), "time"), ("t = 0 is 2024-05-31T12",)),
    (
        "times with a date of day, month and year",
        column(0, lambda i, x: f"31.05.2024 12:00:{i / 2:04.1f}", "time"),
        ("t = 0 is 31.05.2024 12:00:00.0",),
    ),
    (
        "ISO times with a zone",
        column(0, lambda i, x: ISO.format(i / 2) + "+02:00", "timestamp"),
        ("t = 0 is 2024-05-31T12:00:00.0+02:00",),
    ),
    (
        "ISO times with a space",
        column(0, lambda i, x: ISO.format(i / 2).replace("T", " "), "t"),
        ("holds times of a clock",),
    ),
    (
        "time of day",
        column(0, lambda i, x: f"12:59:{i / 2 + 50:04.1f}" if i < 20 else "", "time"),
        ("t = 0 is 12:59:50.0",),
    ),
    (
        "seconds since 1970",
        column(0, lambda i, x: f"{1717156800 + 0.5 * i}"),
        ("counts from 1970", "t = 0 is 2024-05-31T12:00:00"),
    ),
    (
        "milliseconds since 1970",
        column(0, lambda i, x: f"{1717156800000 + 500 * i}", "t [ms]"),
        ("counts from 1970",),
    ),
    (
        "nanoseconds since 1970",
        column(0, lambda i, x: f"{1717156800 * 10**9 + 500000000 * i}", "t [ns]"),
        ("counts from 1970",),
    ),
    ("milliseconds called seconds", column(0, lambda i, x: f"{500 * i}"), ("milliseconds",)),
    ("degrees called radians", column(2, lambda i, x: f"{30 * i}", "psi [rad]"), ("three turns",)),
    ("rate of another world", column(3, lambda i, x: f"{1e5 * i}"), ("which no vehicle does",)),
    ("dead output", column(3, lambda i, x: "0.0"), ("is 0 in all 12 rows", "connected")),
    ("unit in braces", head(2, "psi {deg}"), ("'psi {deg}', which is not read",)),
    ("output in other letters", head(2, "Psi [deg]"), ("'Psi [deg]', which is not read",)),
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
