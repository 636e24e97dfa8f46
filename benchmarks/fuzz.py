"""Random input for everything that reads text: nothing but the package's own errors may come out.

    python -m benchmarks.fuzz --inputs 500000

Inputs are grown from good ones: pieces are cut, doubled and replaced by pieces that have caused
trouble somewhere (huge exponents, NaN, zero bytes, deep brackets). Counted are exceptions that are
no ``OedSysidError`` and inputs that take longer than two seconds. The same generator damages the
binary logs of :mod:`benchmarks.damaged`.
"""

from __future__ import annotations

import json
import random
import sys
import tempfile
import time
import warnings
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, AnyStr

import numpy as np

from benchmarks.harness import ROOT, Row, exam, known, places_of
from oed_sysid import Channels, Fit, Input, OedSysidError, Output, load_problem, read_csv
from oed_sysid.text import dimensions, expressions, notation, units

sys.path.insert(0, str(ROOT / "tests"))

from bad_input.problem_files import SOUND

SLOW = 2.0  # s of computing
# Share of the inputs, by what reads them.
SHARES = {"units": 0.36, "notation": 0.2, "expressions": 0.3, "csv": 0.12, "results": 0.017}
SHARES["problems"] = 1.0 - sum(SHARES.values())

# What has caused trouble somewhere.
_WORDS = """
nan NaN inf -inf 1e999 -1e999 1e-999 0x1F 1_000 1.2.3 --1 1,5 1.234,5 null None True #N/A =A1
99999999999 -0.0 ( ) (((( )))) [ ] { } " ' ^ ** * / // % << ~ ! @ ; , | : . - + < > <= == a<b<c
lambda x.y x[0] f(*a) __import__('os') 2024-05-31T12:00:00 12:00:00 31.05.2024 [deg] (m/s) {rad}
10**10**10 é µ ° ² ⁻ ∞ １ 𝛿
"""
TROUBLE = (
    *(" ", "\t", "\n", "\r\n", "\0", "\ufeff", "\u00a0", *_WORDS.split()),
    *("9" * 400, "(" * 300, "-" * 300, "a" * 5000, "1+" * 2000),
)


def mangled(
    rng: random.Random,
    content: AnyStr,
    noise: Callable[[int], AnyStr],
    trouble: Sequence[AnyStr] = TROUBLE,
    lengths: Sequence[int] = (0, 1, 2, 5, 20),
) -> AnyStr:
    """A text or a file that is cut off, overwritten with noise or trouble, cut out or repeated."""
    for _ in range(rng.choice((1, 1, 2, 4))):
        # Some near the beginning, which says how the rest is to be read.
        every, first = len(content), min(400, len(content))
        at = rng.randrange(every) if rng.random() < 0.6 else rng.randrange(first)
        length, kind = rng.choice(lengths), rng.random()
        if kind < 0.2:
            content = content[: max(at, 9)]
        elif kind < 0.45:
            content = content[:at] + noise(length) + content[at + length :]
        elif kind < 0.65:  # a length, a number or a text that has no end
            content = content[:at] + rng.choice(trouble) * length + content[at + length :]
        elif kind < 0.8:
            content = content[:at] + content[at + length :]
        else:
            again = content[rng.randrange(every) :][:length] * rng.choice((1, 3, 200))
            content = content[:at] + again + content[at:]
        content = content or trouble[0]
    return content


def spelt(rng: random.Random, pieces: Sequence[str]) -> Callable[[int], str]:
    """Noise of some pieces."""
    return lambda count: "".join(rng.choices(pieces, k=count))


def drawn(rng: random.Random, good: Sequence[str], pieces: tuple[str, ...], most: int) -> str:
    """A text of random pieces, or a good one that is mangled."""
    noise = spelt(rng, pieces)
    if rng.random() < 0.5:
        return noise(rng.randint(1, most))
    return mangled(rng, rng.choice(good), noise)


_UNITS = "m s kg rad deg N kn rpm degC V Ohm Hz mN % 1 / * · ^ ** 2 -1 -2 ^2 ^(1/2) ^0.5 m2 s-1"
UNIT_PIECES = (*_UNITS.split(), " ", "(", ")")
_NOTATION = "X_ Y_ Z_ K_ M_ N_ _ abs u v w p q r phi theta delta dr ds db 0 dot _prime tau max"
NOTATION_PIECES = tuple(_NOTATION.split())
NAMES = ("u", "w", "q", "theta", "Z_absww", "m", "t")
EXPRESSION_PIECES = (
    *NAMES,
    *("+", "-", "*", "/", "**", "(", ")", ",", " ", "<", ">=", "2", "0.5", "-1", "1e-3", "0"),
    *(f"{name}(" for name in expressions.FUNCTIONS),
)
KNOWN = {"u": "m/s", "w": "m/s", "q": "rad/s", "theta": "rad", "Z_absww": "kg/m", "m": "kg"}
DIMENSIONS = {name: units.dimension(unit) for name, unit in KNOWN.items()}
POINT = {name: np.array([0.0, -1.5, 1e200]) for name in NAMES}
CHANNELS = Channels(
    (Input("fin", "rad"),), (Output("theta", "rad"), Output("q", "rad/s"), Output("z", "m"))
)
LOG = "t [s],fin [deg],theta [deg],q [deg/s],z [m],mode\n" + "".join(
    f"{0.5 * i},{(-1) ** i},{0.1 * i},{i % 3},{10 + i},AUTO\n" for i in range(8)
)
CSV_PIECES = (
    *("t [s]", "fin [deg]", "theta_rad", "z_m", "q (rad/s)", ",", ";", "\t", "\n", "\r", "0.5"),
    *("1e3", "-9999", "1e300", "#", "# note\n", '"', "AUTO", "1717156800.5", "1717156800500"),
)


def read_unit(rng: random.Random) -> str:
    """A unit, through conversion, dimension and back."""
    good = ("kg m^2/s^2", "deg/s", "N m s", "V^0.5/s", "kg/(m s)", "degC", "°/s", "m2")
    text = drawn(rng, good, UNIT_PIECES, 8)
    unit_of_header = units.parse_header(f"x [{text}]")[1]
    assert unit_of_header is None or isinstance(unit_of_header, str)
    values, si_unit = units.to_si(1.0, text)
    assert np.isfinite(values), text
    # What is printed is read as the same.
    assert units.dimension(si_unit) == units.dimension(text), text
    assert units.to_si(1.0, si_unit)[0] == 1.0, text
    return text


def read_name(rng: random.Random) -> str:
    """The name of a derivative, through everything that it says."""
    good = ("Z_absww", "M_uuds", "N_rdot", "X_0", "Y_phi", "tau_max_prime")
    text = drawn(rng, good, NOTATION_PIECES, 7)
    notation.latex(text)
    if notation.is_derivative(text):
        expressions.parse(notation.term(text))
        notation.prime_scale(text, density=1025.0, length=5.0, speed=1.5)
        notation.term_text(text)
        assert units.dimension(notation.unit(text)) == notation.parse(text).dimension, text
    return text


def read_expression(rng: random.Random) -> str:
    """An expression, through check, numbers, dimension and print."""
    good = ("Z_absww*w*abs(w)", "where(u > 0, u**2, -q)", "m*sqrt(u**2 + w**2)", "atan2(w, u)/2")
    text = drawn(rng, good, EXPRESSION_PIECES, 10)
    expressions.check(text, NAMES, where="fuzz")
    with np.errstate(all="ignore"):
        expressions.to_numpy(text, POINT)
    expressions.to_text(text)
    expressions.to_latex(text)
    dimensions.dimension_of(text, DIMENSIONS)
    return text


class Files:
    """Targets that read files, in a folder of their own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.text = (ROOT / "tests" / "saved" / "fit_format_1.json").read_text(encoding="utf-8")

    def log(self, rng: random.Random) -> str:
        """A log in CSV."""
        text = mangled(rng, LOG, spelt(rng, CSV_PIECES))
        encoding = rng.choice(("utf-8", "utf-8", "utf-8", "utf-16", "latin-1", "utf-8-sig"))
        content = text.encode(encoding, errors="replace")
        if rng.random() < 0.2:
            content = mangled(rng, content, rng.randbytes, (b"\0", b"\xff"))
        (self.folder / "log.csv").write_bytes(content)
        record = read_csv(self.folder / "log.csv", CHANNELS)[0]
        assert np.all(np.diff(record.times) > 0)
        assert np.all(np.isfinite(record.inputs))
        assert not np.any(np.isinf(record.outputs))
        return text

    def result(self, rng: random.Random) -> str:
        """A saved fit, damaged as text or in its structure."""
        if rng.random() < 0.3:
            pieces = ("null", "[", "]", "1e999", '{"class": "Fit"}', ", ")
            text = mangled(rng, self.text, spelt(rng, pieces))
        else:
            data = json.loads(self.text)
            for _ in range(rng.randint(1, 3)):
                damage(rng, data)
            text = json.dumps(data)
        (self.folder / "fit.json").write_bytes(text.encode("utf-8", errors="replace"))
        fit = Fit.load(self.folder / "fit.json")
        with np.errstate(all="ignore"):
            fit.to_dict()
        return text

    def problem(self, rng: random.Random) -> str:
        """A problem file with other numbers and other texts."""
        text = SOUND
        for _ in range(rng.randint(1, 3)):
            lines = text.split('"')
            at = rng.randrange(1, len(lines), 2)
            if rng.random() < 0.6:
                # A text is replaced by another text: nothing but data changes.
                piece = rng.choice((*TROUBLE, *UNIT_PIECES, *EXPRESSION_PIECES, *NAMES))
                lines[at] = repr(piece)[1:-1].replace('"', "")
            text = '"'.join(lines)
            number = rng.choice(("0.1", "12.0", "60.0", "0.05", "0.5", "0.3"))
            other = rng.choice(("0.0", "-1.0", "None", "1e400", "'a'", "1e-300", "True", "(1, 2)"))
            text = text.replace(number, other, 1) if rng.random() < 0.5 else text
        place = self.folder / "ferry"
        place.mkdir(exist_ok=True)
        (place / "problem.py").write_text(text, encoding="utf-8", errors="replace")
        load_problem(place).describe()
        return text


def damage(rng: random.Random, data: Any) -> None:
    """Change one entry somewhere in nested lists and dictionaries."""
    keys = list(data) if isinstance(data, dict) else list(range(len(data)))
    if not keys:
        return
    key = rng.choice(keys)
    inner = data[key]
    if isinstance(inner, dict | list) and inner and rng.random() < 0.85:
        damage(rng, inner)
        return
    choice = rng.choice((None, 0, -1, 1e308, True, "x", [], {}, [1], "nan", 10**30, ...))
    if choice is ...:
        del data[key]
    else:
        data[key] = choice


def counted(*, inputs: int = 20_000, seed: int = 0, only: str = "") -> list[Row]:
    """What comes out of each reader; what was uncaught is printed.

    The same seed gives the same inputs: each is that of ``random.Random("SEED-READER-NUMBER")``.

    Parameters
    ----------
    inputs : int
        all together
    seed : int
        of the inputs
    only : str
        one reader only
    """
    rows = list[Row]()
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        files = Files(Path(folder))
        readers: dict[str, Callable[[random.Random], str]] = {
            "units": read_unit, "notation": read_name, "expressions": read_expression,
            "csv": files.log, "results": files.result, "problems": files.problem,
        }  # fmt: skip
        for name, share in ({known(only, SHARES, "reader"): 1.0} if only else SHARES).items():
            ended = Counter[str]()
            for number in range(round(share * inputs)):
                began = time.process_time()
                try:
                    readers[name](random.Random(f"{seed}-{name}-{number}"))
                    ended["accepted"] += 1
                except OedSysidError:
                    ended["refused"] += 1
                except Exception as error:
                    ended["uncaught"] += 1
                    print(f"{name} {number}: {type(error).__name__} in {places_of(error)[-1]}")
                ended["slower than 2 s"] += time.process_time() - began > SLOW
            said = {w: ended[w] for w in ("accepted", "refused", "uncaught", "slower than 2 s")}
            rows.append({"reader": name, "inputs": round(share * inputs), **said})
    return rows


if __name__ == "__main__":
    exam(counted, lambda row: row["uncaught"] or row["slower than 2 s"])
