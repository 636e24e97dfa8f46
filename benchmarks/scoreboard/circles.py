"""KVLCC2: 35 degree turning circles from zigzags of at most 30 degrees."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from benchmarks.scoreboard.row import Row, Table, missing, place, plain, read_table, refused
from oed_sysid import load_problem
from oed_sysid.errors import DataError
from oed_sysid.prediction.structures import StructureAverage, average_structures, peak_input
from problems.kvlcc2.captive import captive_tests
from problems.kvlcc2.structures import CIRCLES, HORIZON, SCORED, SIDES, candidates, circles

# Free-running tests of the 7 m model in lengths: Yasukawa & Yoshimura (2015), table 4.
MEASURED = {
    ("advance", "starboard"): (3.25, "-2.0 %"),
    ("advance", "port"): (3.11, "-1.8 %"),
    ("tactical_diameter", "starboard"): (3.34, "+3.1 %"),
    ("tactical_diameter", "port"): (3.08, "+6.2 %"),
}
SOURCE = "Alexandersson et al. (2022), Ocean Eng. 266, against circles of MARIN"
MODEL = "7 m model, table 4"
# Columns side, quantity, lengths: indices of circles that are not part of this repository.
JUDGES = "kvlcc2_circles/indices.csv"
# Full ships turn within 4.5 to 5 lengths at most (IMO MSC.137(76)); what is far outside was not
# divided by the length: the circles of a 3 m model are 9 to 10 m wide.
SMALLEST, LARGEST = 0.5, 8.0
SHORT = {"s": "starboard", "stbd": "starboard", "p": "port"}
OTHER_BASIN = "KVLCC2 35 deg circles of another basin"


@dataclass(frozen=True)
class Index:
    """One measured index in ship lengths, by whom, and what others predicted."""

    quantity: str
    side: str
    lengths: float
    published: str
    source: str


def read_indices(path: Path) -> tuple[list[Index], list[Exception]]:
    """The indices of a file, and what is wrong with lines that cannot be used.

    Raises
    ------
    DataError
        If the file as a whole cannot be used.
    """
    table = read_table(path, {"side": (), "quantity": ("index",), "lengths": ("length", "value")})
    found: list[Index] = []
    faults: list[Exception] = []
    for k in range(len(table)):
        try:
            found.append(_index(table, k))
        except DataError as error:
            faults.append(error)
    return found, faults


def _index(table: Table, k: int) -> Index:
    """Index of one row."""
    where = f"{table.file}, line {table.lines[k]}"
    given = {name: cells[k] for name, cells in table.columns.items()}
    side, quantity = plain(given["side"]), plain(given["quantity"])
    side = SHORT.get(side, side)
    if side not in SIDES:
        raise DataError(f"{where}: expected the side {' or '.join(SIDES)}, got {given['side']!r}.")
    if quantity not in CIRCLES:
        raise DataError(
            f"{where}: expected a quantity of {', '.join(CIRCLES)}, got {given['quantity']!r}."
        )
    value = float(table.numbers("lengths", slice(k, k + 1))[0])
    if not SMALLEST <= value <= LARGEST:
        raise DataError(
            f"{where}: {quantity} to {side} is {value:g}; expected {SMALLEST:g} to {LARGEST:g} "
            "ship lengths, positive to either side. Divide metres by the length between "
            "perpendiculars."
        )
    published = MEASURED.get((quantity, side), (0.0, ""))[1]
    return Index(quantity, side, value, published, where)


def judged() -> tuple[list[Index], list[Row]]:
    """Indices of the file of another basin, and rows for what is missing or at fault."""
    path = place(JUDGES)
    if not path.is_file():
        what = "side,quantity,lengths of circles measured from positions"
        return [], [missing(OTHER_BASIN, SOURCE, JUDGES, what)]
    try:
        found, faults = read_indices(path)
    except Exception as error:
        return [], [refused(OTHER_BASIN, SOURCE, JUDGES, error)]
    return found, [refused(OTHER_BASIN, SOURCE, JUDGES, fault) for fault in faults]


def score() -> list[Row]:
    """Errors of the average of structures, per cent of the measured index."""
    further, rows = judged()
    runs = load_problem("kvlcc2", variant="mmg").data()
    average = average_structures(
        candidates(runs),
        runs,
        purpose=circles,
        strength=peak_input("delta"),
        horizon=HORIZON,
        tests=captive_tests(),
        scored=[f"{quantity} {side}" for quantity in SCORED for side in SIDES],
    )
    print(average.report(), flush=True)
    table = [
        Index(quantity, side, value, published, MODEL)
        for (quantity, side), (value, published) in MEASURED.items()
    ]
    return rows + [row_of(one, average) for one in (*table, *further)]


def row_of(one: Index, average: StructureAverage) -> Row:
    """Error of the prediction of one index."""
    name = f"{one.quantity} {one.side}"
    low, high = average.interval(name)
    note = (
        f"predicted {average.values[name]:.2f} L, 95 % interval {low:.2f} to {high:.2f}; "
        f"measured {one.lengths:g} L ({one.source})"
    )
    which = f"{one.quantity.replace('_', ' ')} to {one.side}"
    circle = "KVLCC2 35 deg circle" + ("" if one.source == MODEL else " of another basin")
    published = f"{one.published}, {SOURCE}" if one.published else "-"
    return Row(
        f"{circle}, {which}, error",
        100 * (average.values[name] / one.lengths - 1),
        published,
        "%",
        note,
    )
