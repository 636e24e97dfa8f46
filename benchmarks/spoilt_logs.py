"""Exam of the check of logs: faults put into simulated logs, and logs without any.

    python -m benchmarks.documents check --write [--only faults clean inputs copies]

Two vehicles that share nothing with the package: a diving plane and a ship, zigzags and steps,
with random forces. Three records of 900 samples at three speeds; noise is declared to nobody.
``named`` is the right kind and signal as a suspect finding (or among its alternatives), ``first``
the strongest of them, ``suspect`` anything suspect at all. ``inputs`` spoils those of a shipped
problem whose true parameters are drawn from the priors of its model. ``copies`` spoils the records
of a hidden-effect case, training and validation alike, for the check and `improve`: none may be
certified, that is said to be adequate, or a disturbance, without a word about the fault.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.harness import Row
from benchmarks.tables import tables
from benchmarks.truth import gauss_markov, runge_kutta
from oed_sysid import (
    Dataset,
    Experiment,
    Input,
    Model,
    Output,
    Parameter,
    Problem,
    Record,
    State,
    check,
    improve,
    load_problem,
    read_csv,
)
from oed_sysid.errors import OedSysidError
from oed_sysid.evidence.check import LogCheck
from oed_sysid.experiments.schedules import FromRecord
from oed_sysid.experiments.simulation import simulate

Signals = dict[str, np.ndarray]
Shape = Callable[[Signals, np.ndarray], np.ndarray]
SAMPLES, FINER = 900, 5
DATA = tables(__file__)
HIDDEN_EFFECTS = Path(os.environ.get("OED_SYSID_DATA", ".")) / "hidden_effects"

# -- kinematics of the vehicles; their dynamics the check does not use ---------------------


def kinematic_model(name: str, kinematics: dict[str, str], units: dict[str, str]) -> Model:
    """Kinematics with first-order responses of all velocities."""
    rates = {n: f"(K*fin - {n})/T" for n in units if n not in kinematics}
    return Model(
        name,
        states=tuple(State(n, u) for n, u in units.items()),
        inputs=(Input("fin", "rad"),),
        outputs=tuple(Output(n, u) for n, u in units.items()),
        kinematics=kinematics | rates,
        parameters=(Parameter("K", 1.0), Parameter("T", 5.0, "s")),
    )


def diving_plane() -> Model:
    """Surge, heave and pitch."""
    return kinematic_model(
        "diving plane",
        {"theta": "q", "z": "-u*sin(theta) + w*cos(theta)"},
        {"u": "m/s", "w": "m/s", "q": "rad/s", "theta": "rad", "z": "m"},
    )


# Position and heading in the horizontal plane.
PLANE = {"x": "u*cos(psi) - v*sin(psi)", "y": "u*sin(psi) + v*cos(psi)", "psi": "r"}


def ship() -> Model:
    """Surge, sway and yaw."""
    return kinematic_model(
        "ship",
        PLANE,
        {"u": "m/s", "v": "m/s", "r": "rad/s", "psi": "rad", "x": "m", "y": "m"},
    )


def hidden_effect_cases() -> dict[str, tuple[Problem, Dataset]]:
    """Training records of all hidden-effect cases, by name."""
    problem = load_problem("remus_diving_plane")
    folders = sorted(HIDDEN_EFFECTS.glob("case_*"))
    return {
        folder.name: (problem, read_csv(sorted(folder.glob("train_*.csv")), problem.channels))
        for folder in folders
    }


# -- how they move ---------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Craft:
    """A vehicle: what it logs at which noise and step, and how it moves."""

    name: str
    model: Model
    step: float
    noise: dict[str, float]
    rates: Callable[[np.ndarray, float, np.ndarray, float], np.ndarray]
    speeds: tuple[float, float, float]
    angle: float
    period: float
    force: tuple[float, float, float]

    @property
    def units(self) -> dict[str, str]:
        """Units of the signals by name."""
        return {output.name: output.unit for output in self.model.outputs}

    def run(self, number: int, rng: np.random.Generator) -> Signals:
        """True signals of one record, ``(n,)`` each: a zigzag on command of time, and forces."""
        h, n = self.step / FINER, (SAMPLES + 60) * FINER
        speed = self.speeds[number]
        x = np.zeros(len(self.units))
        x[0] = speed
        force = np.zeros(3)
        rows = np.empty((n, x.size))
        period = self.period * rng.uniform(0.8, 1.2)

        def rate(y: np.ndarray, _: int, command: float, push: np.ndarray) -> np.ndarray:
            return self.rates(y, command, push, speed)

        for k in range(n):
            rows[k] = x
            t = k * h
            command = self.angle * np.sign(np.sin(2.0 * np.pi * t / period))
            force += -force * h / 4.0 + np.sqrt(2.0 * h / 4.0) * rng.standard_normal(3)
            x = runge_kutta(rate, x, h, command, np.array(self.force) * force)
        return {name: rows[60 * FINER :, i] for i, name in enumerate(self.units)}


def _dive(x: np.ndarray, fin: float, push: np.ndarray, speed: float) -> np.ndarray:
    u, w, q, theta, _ = x
    return np.array(
        [
            -0.3 * (u - speed) - 1.2 * q * q + push[0],
            -0.9 * u * w + 0.35 * u * q + 0.25 * u * u * fin + push[1],
            -1.1 * u * q - 0.4 * u * w - 0.9 * u * u * fin - 0.35 * np.sin(theta) + push[2],
            q,
            -u * np.sin(theta) + w * np.cos(theta),
        ]
    )


def _sail(x: np.ndarray, rudder: float, push: np.ndarray, speed: float) -> np.ndarray:
    u, v, r, psi, _, _ = x
    return np.array(
        [
            -0.06 * (u - speed) + 0.5 * v * r + push[0],
            -0.25 * v - 0.25 * u * r + 0.01 * u * u * rudder + push[1],
            -0.08 * u * r - 0.02 * v - 0.5 * r * abs(r) + 0.004 * u * u * rudder + push[2],
            r,
            u * np.cos(psi) - v * np.sin(psi),
            u * np.sin(psi) + v * np.cos(psi),
        ]
    )


DIVER = Craft(
    "diving plane", diving_plane(), 0.1,
    {"u": 0.02, "w": 0.02, "q": 0.004, "theta": 0.004, "z": 0.03},
    _dive, (1.0, 1.5, 2.1), 0.2, 16.0, (0.02, 0.03, 0.03),
)  # fmt: skip
SHIP = Craft(
    "ship", ship(), 0.5,
    {"u": 0.03, "v": 0.03, "r": 0.002, "psi": 0.004, "x": 0.3, "y": 0.3},
    _sail, (2.0, 3.0, 4.0), 0.35, 90.0, (0.01, 0.01, 0.0006),
)  # fmt: skip
CRAFT = (DIVER, SHIP)


@dataclass(frozen=True)
class Spoil:
    """A fault: what may be said of it, and how it is made of the signals of record ``k``.

    ``where`` is ``true`` for faults between vehicle and sensor, on the fine grid and before noise,
    or ``log`` for those of what was written.
    """

    kind: str
    signals: tuple[str, ...]
    sizes: tuple[float, ...]
    make: Callable[[Signals, np.ndarray, float, int], None]
    where: str = "true"
    also: tuple[str, ...] = field(default=())


def fault(make: Callable[..., None]) -> Callable[..., Callable[..., None]]:
    """A kind of fault that waits for signals, times, size and record once it has its names."""
    return lambda *given, **options: lambda s, t, size, k: make(s, t, size, k, *given, **options)


@fault
def _add(s: Signals, t: np.ndarray, size: float, k: int, name: str, *, shape: Shape,
         only: int | None = None) -> None:  # fmt: skip
    if only in (None, k):
        s[name] = s[name] + size * shape(s, t)


@fault
def times(s: Signals, t: np.ndarray, size: float, k: int, *names: str,
          only: int | None = None) -> None:  # fmt: skip
    """Signals that are so many times what they should be."""
    for name in names if only in (None, k) else ():
        s[name] = s[name] * size


@fault
def _late(s: Signals, t: np.ndarray, size: float, k: int, *names: str, clock: bool = False) -> None:
    shift = size * (t - t[0]) if clock else size
    for name in names:
        early = s[name][0] + (t - shift - t[0]) * (s[name][5] - s[name][0]) / (t[5] - t[0])
        s[name] = np.where(t - shift < t[0], early, np.interp(t - shift, t, s[name]))


@fault
def _scattered(s: Signals, t: np.ndarray, size: float, k: int, *names: str) -> None:
    rng = np.random.default_rng((k, int(1e6 * abs(s["u"][7]))))
    taken = t + size * rng.standard_normal(t.size)
    for name in names:
        s[name] = np.interp(taken, t, s[name])


@fault
def _lag(s: Signals, t: np.ndarray, size: float, k: int, name: str) -> None:
    y, h = s[name].copy(), t[1] - t[0]
    for i in range(1, y.size):
        y[i] = y[i - 1] + h / size * (s[name][i - 1] - y[i - 1])
    s[name] = y


@fault
def swap(s: Signals, t: np.ndarray, size: float, k: int, a: str, b: str) -> None:
    """Two signals, each in the other's place."""
    s[a], s[b] = s[b], s[a]


@fault
def earth(s: Signals, t: np.ndarray, size: float, k: int, a: str, b: str, angle: str, *,
          sign: float) -> None:  # fmt: skip
    """Velocities in earth axes."""
    c, d = np.cos(s[angle]), sign * np.sin(s[angle])
    s[a], s[b] = c * s[a] + d * s[b], -d * s[a] + c * s[b]


@fault
def _tilt(s: Signals, t: np.ndarray, size: float, k: int, a: str, b: str) -> None:
    s[a], s[b] = s[a] - size * s[b], s[b] + size * s[a]


@fault
def _written(s: Signals, t: np.ndarray, size: float, k: int, name: str, *,
             change: Callable[[np.ndarray, float], np.ndarray]) -> None:  # fmt: skip
    s[name] = change(s[name], size)


def _hit(y: np.ndarray, size: float) -> np.ndarray:
    rows = np.random.default_rng(int(1e6 * abs(y[0]))).choice(y.size, 9, replace=False)
    y = y.copy()
    y[rows] += size * np.resize([1.0, -1.0], 9)
    return y


def _lose(y: np.ndarray, size: float) -> np.ndarray:
    y = y.copy()
    for first in (100, 333, 480, 700, 811):
        y[first : first + int(size)] = 0.0
    return y


def _freeze(y: np.ndarray, size: float) -> np.ndarray:
    y = y.copy()
    y[400 : 400 + int(size)] = y[400]
    return y


def _hold(y: np.ndarray, size: float) -> np.ndarray:
    return np.repeat(y[:: int(size)], int(size))[: y.size]


def _join(y: np.ndarray, size: float) -> np.ndarray:
    rows = np.arange(y.size)
    return np.interp(rows, rows[:: int(size)], y[:: int(size)])


def _clip(y: np.ndarray, size: float) -> np.ndarray:
    low, high = np.quantile(y, [size, 1.0 - size])
    return np.clip(y, low, high)


@fault
def _struck(s: Signals, t: np.ndarray, size: float, k: int, name: str) -> None:
    rng = np.random.default_rng(3)
    hit = rng.random(t.size) < 0.01
    s[name] = s[name] + np.where(hit, size * rng.standard_normal(t.size), 0.0)


@fault
def _continued(s: Signals, t: np.ndarray, size: float, k: int, name: str) -> None:
    # What was measured before the record began is continued by a straight line.
    early = s[name][0] + (s[name][10] - s[name][0]) * (t - t[0] - size)
    noisy = early + 0.03 * np.random.default_rng(5).standard_normal(t.size)
    s[name] = np.where(t - size < t[0], noisy, np.interp(t - size, t, s[name]))


@fault
def _copied(s: Signals, t: np.ndarray, size: float, k: int, a: str, b: str) -> None:
    s[b] = s[a].copy()


MAKERS: dict[str, Callable[..., Callable[..., None]]] = {
    "add": _add, "times": times, "late": _late, "scattered": _scattered, "lag": _lag, "swap": swap,
    "earth": earth, "tilt": _tilt, "written": _written, "struck": _struck,
    "continued": _continued, "copied": _copied,
}  # fmt: skip


# What changes the values of a signal as they are written.
CHANGES: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {
    "hit": _hit, "lose": _lose, "freeze": _freeze, "hold": _hold, "join": _join, "clip": _clip,
    "round": lambda y, size: np.round(y / size) * size, "kill": lambda y, size: 0.0 * y,
}  # fmt: skip


def shape_of(words: str, names: Mapping[str, Any]) -> Shape:
    """What is added to a signal, of size one: all along, growing, from and until a share of it."""
    kind, *numbers = words.split()
    start, stop = [*map(float, numbers), 2.0][:2] if numbers else (0.0, 2.0)
    shapes: dict[str, Shape] = {
        "one": lambda s, t: np.ones_like(t),
        "ramp": lambda s, t: (t - t[0]) / (t[-1] - t[0]),
        "lever": lambda s, t: names["arm"] * s[names["rate"]],
        "at": lambda s, t: (
            1.0 * ((t >= t[0] + start * (t[-1] - t[0])) & (t < t[0] + stop * (t[-1] - t[0])))
        ),
    }
    return shapes[kind]


def spoil_of(row: Mapping[str, Any], names: Mapping[str, Any], noise: Mapping[str, float]) -> Spoil:
    """A fault from its row of data, for a vehicle whose signals have these names."""

    def called(words: Sequence[str]) -> list[str]:
        every = [names.get(word, word) for word in words]
        return [name for one in every for name in ([one] if isinstance(one, str) else one)]

    signals = called(row["signals"])
    sizes = row.get("sizes") or [noise[signals[0]] * share for share in row["noise"]]
    maker, *words = row["make"]
    options = words.pop() if words and isinstance(words[-1], dict) else {}
    known = {"shape": lambda said: shape_of(said, names), "change": CHANGES.get,
             "sign": names.get, "only": int, "clock": bool}  # fmt: skip
    options = {option: known[option](said) for option, said in options.items()}
    make = MAKERS[maker](*called(words), **options)
    also = tuple(called(row.get("also", ())))
    return Spoil(row["kind"], tuple(signals), tuple(sizes), make, row.get("where", "true"), also)


def faults_of(craft: Craft) -> list[Spoil]:
    """All kinds of faults of one vehicle, with sizes."""
    names = {**DATA["names"][craft.name], "every": list(craft.noise)}
    return [spoil_of(row, names, craft.noise) for row in DATA["faults"]]


_COLOURS = {"white": 0.0, "AR 0.5": 0.5, "AR 0.9": 0.9, "Student 5": 0.0, "two rates": 0.0}


@cache
def truth(craft: Craft, seed: int) -> list[Signals]:
    """True signals of three records; kept, for all faults of all seeds."""
    rng = np.random.default_rng((seed, len(craft.name)))
    return [craft.run(k, rng) for k in range(3)]


def written(
    craft: Craft, seed: int, spoil: Spoil | None = None, size: float = 0.0, noise: str = "white"
) -> Dataset:
    """A log of three records, with a fault or none."""
    rng = np.random.default_rng((seed, 77))
    channels, colour, records = craft.model.channels, _COLOURS[noise], []
    for k, run in enumerate(truth(craft, seed)):
        signals = dict(run)
        fine = np.arange(signals["u"].size) * craft.step / FINER
        if spoil is not None and spoil.where == "true":
            steps = size * craft.step if spoil.kind in ("delay", "jitter") else size
            spoil.make(signals, fine, steps, k)
        log = {}
        for i, name in enumerate(craft.units):
            heavy = noise == "Student 5"
            e = rng.standard_t(5, SAMPLES) * 0.775 if heavy else rng.standard_normal(SAMPLES)
            e = gauss_markov(e, colour)
            log[name] = signals[name][::FINER][:SAMPLES] + craft.noise[name] * e
            if noise == "two rates" and i % 2:
                log[name][np.arange(SAMPLES) % 5 > 0] = np.nan
        t = fine[::FINER][:SAMPLES]
        if spoil is not None and spoil.where == "log":
            spoil.make(log, t, size, k)
        outputs = np.column_stack([log[n] for n in craft.units])
        records.append(Record(f"run_{k}", t, np.zeros((SAMPLES, 1)), outputs, channels))
    return Dataset(records)


def judged(craft: Craft, seed: int, spoil: Spoil, size: float) -> tuple[bool, bool, bool, str]:
    """Whether the fault comes first, is named at all, or anything is suspect; and what was said."""
    try:
        found = check(written(craft, seed, spoil, size), craft.model, inputs=False)
    except OedSysidError as error:  # refused with the line to write
        return True, True, True, type(error).__name__
    kinds = {spoil.kind} | {"clock": {"rate"}, "burst": {"spikes"}, "drift": {"bias"}}.get(
        spoil.kind, set()
    )
    names = {*spoil.signals, *spoil.also}

    def hit(one) -> bool:  # type: ignore[no-untyped-def]
        return one.kind in kinds and bool(names & set(one.signals))

    listed = found.serious or found.findings
    words = [w for one in found.serious for w in one.alternatives]
    other = any(
        k in w for k in kinds for w in words if any(f" {s}" in w or w.startswith(s) for s in names)
    )
    named = any(hit(one) for one in found.findings)
    first = bool(listed) and hit(listed[0])
    said = "; ".join(f"{o.name}{'@' + o.records[0] if len(o.records) == 1 else ''}" for o in listed)
    return first, named or other, found.suspect, said[:90]


def faults(seeds: range) -> list[Row]:
    """Every kind and size: how often it comes first, is named, and anything is suspect."""
    rows: list[Row] = []
    for craft in CRAFT:
        for spoil in faults_of(craft):
            for place, size in enumerate(spoil.sizes):
                found = [judged(craft, seed, spoil, size) for seed in seeds]
                counts = {
                    key: sum(one[at] for one in found)
                    for at, key in enumerate(("first", "named", "suspect"))
                }
                rows.append(
                    {
                        "vehicle": craft.name, "kind": spoil.kind, "signals": list(spoil.signals),
                        "size": size, "place": place, "of": len(found), **counts,
                        "missed": ["", *(said for first, *_, said in found if not first)][-1],
                    }
                )  # fmt: skip
    return rows


Act = Callable[[np.ndarray, np.ndarray, int], np.ndarray]


def replayed(
    truth: Model, experiment: Experiment, act: Act, number: int, rng: np.random.Generator
) -> Record:
    """A record in which something else acted than the commands of its first input, as logged."""
    logged = simulate(truth, experiment, rng=rng)
    acted = act(logged.times, logged.inputs[:, 0], number)
    replay = FromRecord(truth.input_names[0], logged.times, acted)
    run = simulate(truth, replace(experiment, manoeuvre=replay), rng=rng)
    return replace(run, inputs=logged.inputs)


def inputs(seeds: range) -> list[Row]:
    """Inputs of a shipped problem whose true values are drawn from the priors of its model."""
    problem, rows = load_problem("remus_diving_plane"), list[Row]()
    mine = {*problem.model.input_names}
    for kind in (*INPUTS, *ACTED):
        said = []
        for seed in seeds:
            found = check(Dataset(spoilt_inputs(problem, kind, seed)), problem)
            every = [one for one in found.findings if one.suspect or mine & {*one.signals}]
            said.append("; ".join(one.name + " (note)" * (not one.suspect) for one in every) or "-")
        counts = {words: said.count(words) for words in said}
        rows.append({"kind": kind, "said": counts, "of": len(said)})
    return rows


def spoilt_inputs(problem: Problem, kind: str, seed: int) -> Iterator[Record]:
    """Simulate the runs of a problem, true values drawn; the first input is spoilt in one way."""
    rng = np.random.default_rng((seed, 5))
    drawn = {p.name: float(rng.normal(p.prior_mean, p.prior_std))
             for p in problem.model.free_parameters if p.prior_std}  # fmt: skip
    vehicle = problem.model.with_values(drawn)
    for k, experiment in enumerate(problem.experiments.values()):
        if kind in ACTED:
            yield replayed(vehicle, experiment, ACTED[kind], k, rng)
            continue
        run = simulate(vehicle, experiment, rng=rng)
        spoilt = np.array(run.inputs)
        spoilt[:, 0] = INPUTS[kind](run.times, spoilt[:, 0])
        yield replace(run, inputs=spoilt)


def _lagged(t: np.ndarray, y: np.ndarray) -> np.ndarray:
    """A lag of first order that delays by half a second in the mean, by Euler's backward rule."""
    answer = y.copy()
    for i in range(1, y.size):
        h = t[i] - t[i - 1]
        answer[i] = answer[i - 1] + h / (0.5 + h) * (y[i] - answer[i - 1])
    return answer


# Spoilt inputs: what was written of commands that acted, of times and commands.
INPUTS: dict[str, Callable[[np.ndarray, np.ndarray], np.ndarray]] = {
    "nothing": lambda t, y: y,
    "sign": lambda t, y: -y,
    "degrees": lambda t, y: np.degrees(y),
    "x 1.2": lambda t, y: 1.2 * y,
    "x 0.5": lambda t, y: 0.5 * y,
    "x 2": lambda t, y: 2.0 * y,
    "late 0.5 s": lambda t, y: np.interp(t - 0.5, t, y),
    "dead": lambda t, y: 0.0 * y,
}
# What acted of commands that were written, in the second record at least.
ACTED: dict[str, Act] = {
    "command, lag 0.5 s": lambda t, y, k: _lagged(t, y),
    "no effect from 0.6": lambda t, y, k: np.where((k == 1) & (t > 0.6 * t[-1]), 0.0, y),
    "no effect in a run": lambda t, y, k: 0.0 * y if k == 1 else y,
}


def clean(seeds: range) -> list[Row]:
    """False alarms on logs without a fault."""
    rows = list[Row]()
    for craft, noise in product(CRAFT, _COLOURS):
        logs = (written(craft, seed, noise=noise) for seed in seeds)
        alarms = sum(check(log, craft.model, inputs=False).suspect for log in logs)
        rows.append({"vehicle": craft.name, "noise": noise, "suspect": alarms, "of": len(seeds)})
    return rows


COPIES = {
    name: spoil_of(row, DATA["names"]["diving plane"], {}) for name, row in DATA["copies"].items()
}


def spoil(data: Dataset, name: str) -> Dataset:
    """Return copies of records with one fault of :data:`COPIES`."""
    one, records = COPIES[name], []
    for k, record in enumerate(data):
        names = (record.channels.input_names, record.channels.output_names)
        signals = {n: record.input(n) for n in names[0]} | {n: record.output(n) for n in names[1]}
        one.make(signals, record.times, one.sizes[0], k)
        parts = (np.column_stack([signals[n] for n in kind]) for kind in names)
        records.append(replace(record, **dict(zip(("inputs", "outputs"), parts, strict=True))))
    return Dataset(records)


def named_as(found: LogCheck, name: str) -> bool:
    """Whether a spoilt copy was named: its kind and signal, and nothing else as suspect."""
    one = COPIES[name]
    return len(found.serious) == 1 and found.named(one.kind, one.signals[0]) is not None


def copies() -> list[Row]:
    """Spoilt copies of a hidden-effect case through the check and the search."""
    cases = hidden_effect_cases()
    if not cases:
        raise SystemExit("no hidden_effects folder below OED_SYSID_DATA")
    problem, train = cases["case_010"]
    files = sorted((HIDDEN_EFFECTS / "case_010").glob("test_*.csv"))
    test, rows = read_csv(files, problem.channels), list[Row]()
    for name, one in COPIES.items():
        bad = spoil(train, name)
        found = check(bad, problem)
        result = improve(problem.model, bad, spoil(test, name), candidates=problem.effects)
        # A sensor effect on the signal that is wrong names the fault, in its own way.
        named = result.remains.kind == "log suspect" or any(
            step.effect.stage == "sensor"
            and one.signals[0] in " ".join(map(str, step.effect.terms))
            for step in result.steps
        )
        certified = not named and result.remains.kind in ("adequate", "disturbance")
        said = "named" if named_as(found, name) else found.verdict
        added = ", ".join(step.added for step in result.steps) or "-"
        rows.append({"spoilt": f"{one.kind} of {one.signals[0]}", "check": said,
                     "improve": result.remains.kind, "added": added,
                     "certified": certified})  # fmt: skip
    return rows


def as_they_are() -> list[Row]:
    """What the check says of the hidden-effect cases, in two of which a sensor errs."""
    return [
        {"case": name, "check": check(records, own).verdict}
        for name, (own, records) in hidden_effect_cases().items()
    ]
