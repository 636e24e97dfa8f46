"""Foreign logs whose columns are renamed: what of them is read right, asked, or wrong in silence.

    python -m benchmarks.door --logs 120 --seed 20261127

Ships and underwater vehicles are simulated by SciPy with equations of motion of this file (nothing
of the package takes part), and logged as somebody else's logger would: names of five languages or
none at all (``door.toml``), other units, wraps, axes and signs, decimal commas, clocks of eight
kinds, columns shuffled among others that say nothing, and noise. Some headers say units, most do
not. Each log is read as by ``oed-sysid import``; every fact that the reader states is compared with
the truth. What it asks to be confirmed counts as asked, whether the guess is right or not.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from benchmarks.harness import command, markdown
from benchmarks.tables import tables
from oed_sysid.data.formats import open_log
from oed_sysid.data.log import Log
from oed_sysid.data.recognise import Recognised, recognise
from oed_sysid.text.units import to_si

# -- vehicles ----------------------------------------------------------------------------


def _commands(rng: np.random.Generator, t: np.ndarray, size: float, hold: float) -> np.ndarray:
    """Steps that are held for a while, with rests between them."""
    edges = np.cumsum(rng.uniform(0.5, 1.5, 400) * hold)
    levels = rng.choice([-1.0, 0.0, 1.0, 0.5, -0.5], 401) * size
    return levels[np.searchsorted(edges, t)]


def ship(rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """A ship or surface vehicle in the plane: surge, sway and yaw with a rudder and a propeller."""
    length = float(rng.choice([2.0, 8.0, 60.0, 180.0]))
    speed = float(rng.uniform(0.5, 0.9)) * np.sqrt(9.81 * length) * 0.35
    unit = length / speed
    step = float(rng.choice([0.5, 1.0, 2.0])) * unit / 20.0
    t = step * np.arange(int(rng.integers(900, 2500)))
    rudder = _commands(rng, t, np.radians(rng.uniform(10, 30)), 6.0 * unit)
    share = 1.0 + 0.15 * _commands(rng, t, 1.0, 15.0 * unit)
    current = rng.normal(scale=0.03 * speed, size=2)
    gain, lag = rng.uniform(0.6, 1.5), rng.uniform(1.0, 3.0)

    def motion(now: float, s: np.ndarray) -> list[float]:
        k = min(int(now / step), t.size - 1)
        u, v, r, psi = s[:4]
        du = (share[k] * speed - u) / (4.0 * unit) - 0.4 * abs(r) * abs(v)
        dv = -0.35 * u * r * 1.0 - 1.1 * u / length * v
        dr = (gain * u**2 / (length * speed) * rudder[k] - r - 6.0 * unit * r * abs(r)) / (
            lag * unit
        )
        x = u * np.cos(psi) - v * np.sin(psi) + current[0]
        y = u * np.sin(psi) + v * np.cos(psi) + current[1]
        return [du, dv, dr, r, x, y]

    start = [speed, 0.0, 0.0, rng.uniform(0.0, 6.0), 0.0, 0.0]
    s = solve_ivp(motion, (t[0], t[-1]), start, t_eval=t, max_step=step, rtol=1e-6).y
    names = ("u", "v", "r", "psi", "x", "y")
    signals = dict(zip(names, s, strict=True))
    return t, signals | {"rudder": rudder, "rpm": share * rng.uniform(1.5, 20.0)}


def diver(rng: np.random.Generator) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """An underwater vehicle in six degrees of freedom: attitude by Euler angles, depth."""
    step = float(rng.choice([0.1, 0.2]))
    t = step * np.arange(int(rng.integers(1200, 3000)))
    speed = rng.uniform(1.0, 2.5)
    fin = _commands(rng, t, np.radians(12.0), 8.0)
    rudder = _commands(rng, t, np.radians(15.0), 12.0)
    torque = _commands(rng, t, 0.05, 9.0)
    thrust = 1.0 + 0.2 * _commands(rng, t, 1.0, 20.0)

    def motion(now: float, s: np.ndarray) -> list[float]:
        k = min(int(now / step), t.size - 1)
        u, v, w, p, q, r, phi, theta, psi = s[:9]
        du = (thrust[k] * speed - u) / 6.0 + 0.3 * (v * r - w * q)
        dv, dw = -0.5 * u * r - 0.9 * v, 0.5 * u * q - 0.9 * w
        dp = torque[k] - 1.5 * p - 3.0 * np.sin(phi)
        dq = -0.4 * u * fin[k] - 1.2 * q - 0.35 * np.sin(theta)
        dr = 0.25 * u * rudder[k] - 1.0 * r
        turning = [
            p + (q * np.sin(phi) + r * np.cos(phi)) * np.tan(theta),
            q * np.cos(phi) - r * np.sin(phi),
            (q * np.sin(phi) + r * np.cos(phi)) / np.cos(theta),
        ]
        (a, b, c), (d, e, f) = np.cos([phi, theta, psi]), np.sin([phi, theta, psi])
        rx = np.array([[1, 0, 0], [0, a, -d], [0, d, a]])
        ry = np.array([[b, 0, e], [0, 1, 0], [-e, 0, b]])
        rz = np.array([[c, -f, 0], [f, c, 0], [0, 0, 1]])
        return [du, dv, dw, dp, dq, dr, *turning, *(rz @ ry @ rx @ [u, v, w])]

    start = [speed, *[0.0] * 7, rng.uniform(-3, 3), 0.0, 0.0, 150.0]
    s = solve_ivp(motion, (t[0], t[-1]), start, t_eval=t, max_step=step, rtol=1e-6).y
    names = ("u", "v", "w", "p", "q", "r", "phi", "theta", "psi", "x", "y", "z")
    signals = dict(zip(names, s, strict=True))
    return t, signals | {"rudder": rudder, "rpm": thrust * rng.uniform(10.0, 25.0)}


# -- loggers -----------------------------------------------------------------------------

DATA = tables(__file__)
SI, UNITS, SPREAD, NAMES = (DATA[part] for part in ("si", "units", "spread", "names"))
YAW = ("yaw", "Gier", "lacet", "guiñada", "imbardata")
CLOCKS = ("s", "ms", "clock", "iso", "german", "epoch", "epoch ms", "min")


@dataclass(frozen=True)
class Foreign:
    """A log in a file, and what is true of it: times in s, signals in SI by column name."""

    path: Path
    t: np.ndarray
    truth: dict[str, tuple[str, np.ndarray]]
    units: dict[str, str]
    words: str


def stamps(t: np.ndarray, how: str, rng: np.random.Generator) -> list[str]:
    """Times as a logger writes them."""
    start = datetime(2025, 5, 31, 9, 12, 7) + timedelta(seconds=float(rng.uniform(0, 9000)))
    if how in ("s", "ms", "min"):
        first = float(rng.choice([0.0, 0.0, 37.5]))
        return [f"{(first + one) / {'s': 1, 'ms': 1e-3, 'min': 60}[how]:.9g}" for one in t]
    if how.startswith("epoch"):
        digits = (1e3, "{:.0f}") if how.endswith("ms") else (1.0, "{:.3f}")
        return [digits[1].format((1.7e9 + one) * digits[0]) for one in t]
    moments = [start + timedelta(seconds=float(one)) for one in t]
    form = {"clock": "%H:%M:%S.%f", "iso": "%Y-%m-%dT%H:%M:%S.%f", "german": "%d.%m.%Y %H:%M:%S.%f"}
    return [m.strftime(form[how])[:-3] for m in moments]


def _pick(rng: np.random.Generator, pairs: Sequence[tuple[str, float]]) -> str:
    return str(rng.choice([n for n, _ in pairs], p=[p for _, p in pairs]))


@dataclass(frozen=True)
class Logger:
    """How somebody else logs: words, axes east-north-up or reversed, wrap, units in headers."""

    language: str
    enu: bool
    flipped: set[str]
    wrap: str
    says: bool

    def name(self, rng: np.random.Generator, role: str, least: int = 100, most: int = 999) -> str:
        """What a column is called; a number where columns have no names."""
        if self.language == "none":
            return f"ch{rng.integers(least, most)}"
        names = NAMES[self.language].get(role, [])
        if role == "psi" and self.enu:  # who counts from east does not call it a compass
            names = [one for one in names if any(w in one for w in YAW)]
        return str(rng.choice(names)) if names else role

    def logged(self, role: str, values: np.ndarray, unit: str) -> np.ndarray:
        """Values as they are written, of a signal in SI."""
        if self.enu and role == "psi":
            values = 0.5 * np.pi - values
        elif self.enu and role in ("v", "w", "q", "r", "theta"):
            values = -values
        factor = float(to_si(1.0, unit)[0])
        shown = (-values if role in self.flipped else values) / factor
        turn = 2 * np.pi / factor
        if role != "psi" or self.wrap == "continuous":
            return shown
        return shown % turn if self.wrap == "0..360" else (shown + turn / 2) % turn - turn / 2


def units_of(rng: np.random.Generator, signals: Iterable[str]) -> dict[str, str]:
    """Units of a logger by signal."""
    units = {n: _pick(rng, UNITS[SI[n]]) for n in signals}
    units |= {name: units["x"] for name in ("y",) if "x" in units}
    if rng.random() < 0.7:  # most loggers write speeds in one unit
        units |= {name: units["u"] for name in ("v", "w") if {"u", name} <= units.keys()}
    return units


def noisy(rng: np.random.Generator, name: str, values: np.ndarray) -> np.ndarray:
    """A measured signal; commands are as they are."""
    if name in ("rudder", "rpm"):
        return values
    size = SPREAD[SI[name]] * float(rng.uniform(0.3, 1.5))
    size = min(size, 0.05 * float(np.std(values)))
    return values + size * rng.standard_normal(values.size)


def written(
    path: Path,
    rng: np.random.Generator,
    logger: Logger,
    t: np.ndarray,
    columns: Mapping[str, np.ndarray],
) -> str:
    """Write a log, its columns in any order; how its clock counts."""
    how, clock = str(rng.choice(CLOCKS)), logger.name(rng, "t", 10, 99)
    comma = logger.language in ("de", "fr", "es", "it") and rng.random() < 0.7
    mark = ";" if comma else str(rng.choice([",", ";", "\t"]))
    heads = rng.permutation(list(columns)).tolist()
    place = int(rng.integers(0, 2)) * int(rng.integers(0, len(heads)))
    table = [[f"{v:.7g}" for v in columns[n]] for n in heads]
    table.insert(place, stamps(t, how, rng))
    heads.insert(place, clock)
    lines = [mark.join(row) for row in zip(*table, strict=True)]
    if comma and how != "german":
        lines = [line.replace(".", ",") for line in lines]
    path.write_text("\n".join([mark.join(heads), *lines]), encoding="utf-8")
    return how


def foreign(folder: Path, rng: np.random.Generator, number: int) -> Foreign:
    """Simulate a vehicle and log it in somebody else's way."""
    vehicle = ship if rng.random() < 0.55 else diver
    t, truth = vehicle(rng)
    language = str(rng.choice([*NAMES, "none"], p=[*[0.17] * 5, 0.15]))
    unsaid = [n for n in ("x y", "v", "w", "u", "rpm", "phi p", "r", "z") if rng.random() < 0.1]
    dropped = {one for group in unsaid for one in group.split()}
    signals = {name: values for name, values in truth.items() if name not in dropped}
    enu = rng.random() < 0.2
    flipped = {n for n in ("r", "z", "theta", "v", "rudder", "p") if rng.random() < 0.08}
    units = units_of(rng, signals)
    wrap = str(rng.choice(["0..360", "-180..180", "continuous"], p=[0.5, 0.35, 0.15]))
    logger = Logger(language, enu, flipped, wrap, says=rng.random() < 0.4)
    columns, told, said = {}, {}, {}
    for name, values in signals.items():
        seen = noisy(rng, name, values)
        header = logger.name(rng, name) + (f" [{units[name]}]" if logger.says else "")
        columns[header] = logger.logged(name, seen, units[name])
        told[header], said[header] = (name, values), units[name]
    for extra, level in {"temp": 18.0, "batt": 24.6, "status": 3.0}.items():
        walk = level + 0.003 * np.cumsum(rng.standard_normal(t.size))
        columns[logger.name(rng, extra, 1000, 1999)] = walk
    path = folder / f"log{number}.csv"
    how = written(path, rng, logger, t, columns)
    words = (
        f"{vehicle.__name__} {language} {how} {wrap}{' ENU' if enu else ''} "
        f"flipped={sorted(flipped & set(signals))} units={'said' if logger.says else 'unsaid'} "
        f"without {sorted(dropped)}"
    )
    return Foreign(path, t, told, said, words)


# -- the examination ---------------------------------------------------------------------


def examine(log: Foreign) -> list[tuple[str, str, str]]:
    """Fact, verdict (right, asked, wrong) and words of everything that should be known of a log."""
    opened = open_log(log.path)
    found = recognise(opened)
    rows = [_clock(log, opened, found)]
    by_field = {guess.field: guess for guess in found.guesses}
    for header, (role, values) in log.truth.items():
        guess = by_field.get(f"{log.path.stem}.{header}")
        facts = ["unit", *(["sign"] if role not in ("rudder", "rpm") else [])]
        facts += ["wrap"] if role == "psi" else []
        if guess is None or guess.role != role:
            taken = guess is not None and "field" not in guess.doubts
            what = "" if guess is None else f" taken for {guess.role}"
            rows += [(fact, "wrong" if taken else "asked", f"{role}{what}") for fact in facts]
            continue
        read = guess.sign * to_si(opened[guess.field].values - guess.trim, guess.unit)[0]
        right = right_facts(role, np.unwrap(read) if guess.wrap else read, values)
        doubted = dict.fromkeys(facts if "field" in guess.doubts else guess.doubts, "asked")
        how = f"read as [{guess.unit}] sign {guess.sign}: {guess.why}"
        for fact in facts:
            what = doubted.get(fact, "right" if right[fact] else "wrong")
            rows.append((fact, what, f"{role} [{log.units[header]}] {how}"))
    return rows


def _clock(log: Foreign, opened: Log, found: Recognised) -> tuple[str, str, str]:
    """What is made of the times of a log."""
    factor = float(to_si(1.0, found.time_unit)[0]) / float(to_si(1.0, opened.clock_unit or "s")[0])
    span = (opened.span[1] - opened.span[0]) * factor
    good = abs(span / (log.t[-1] - log.t[0]) - 1.0) < 1e-3
    what = "asked" if found.doubts else "right" if good else "wrong"
    return "time", what, f"{found.time_unit} {span:.4g} s"


def right_facts(role: str, read: np.ndarray, values: np.ndarray) -> dict[str, bool]:
    """Whether unit and sign, and of a heading its wrap, are those of the truth."""
    if role == "u":  # hardly varies: its level tells more
        level = float(read.mean() / values.mean())
        return {"unit": abs(abs(level) - 1.0) < 0.1, "sign": level > 0.0}
    a, b = read - read.mean(), values - values.mean()
    slope = float(a @ b / (b @ b))
    right = {"unit": abs(abs(slope) - 1.0) < 0.15, "sign": slope > 0.0}
    if role == "psi":
        right["wrap"] = bool(abs(np.std(a) / np.std(b) - 1.0) < 0.15) or not right["unit"]
        right["sign"] &= bool(abs(np.angle(np.exp(1j * (read - values)).mean())) < 0.2)
    return right


def examined(folder: Path, rng: np.random.Generator, number: int) -> list[tuple[str, str, str]]:
    """Facts of one log, which is simulated, written and read."""
    log = foreign(folder, rng, number)
    return [(fact, verdict, f"{words}  ({log.words})") for fact, verdict, words in examine(log)]


# What a log is counted among, by whether its columns have names.
COLUMNS = {True: "of these, named columns", False: "of these, columns without names"}


def run(*, logs: int = 30, seed: int = 20261127, verbose: bool = False, only: int = -1) -> None:
    """Examine so many logs."""
    titles = ("time", "unit", "sign", "wrap", "all", *COLUMNS.values())
    said: dict[str, list[str]] = {title: [] for title in titles}
    perfect = 0
    with tempfile.TemporaryDirectory() as folder:
        for number in range(logs) if only < 0 else [only]:
            rows = examined(Path(folder), np.random.default_rng([seed, number]), number)
            perfect += all(verdict == "right" for _, verdict, _ in rows)
            for fact, verdict, words in rows:
                for title in (fact, "all", COLUMNS[" none " not in words]):
                    said[title].append(verdict)
                if verdict == "wrong" or verbose:
                    print(f"log {number}: {fact} {verdict}: {words}")
    verdicts = ("right", "asked", "wrong")
    lines = [(title, *map(own.count, verdicts)) for title, own in said.items()]
    shares = [said["all"].count(verdict) / len(said["all"]) for verdict in verdicts]
    print("\n".join(markdown(["fact", *verdicts], lines)))
    print(f"{logs} logs: right {shares[0]:.1%}, asked {shares[1]:.1%}, wrong {shares[2]:.1%}; "
          f"{perfect} logs without a question or a mistake")  # fmt: skip


if __name__ == "__main__":
    command(run)
