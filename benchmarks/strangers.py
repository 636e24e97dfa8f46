r"""The frozen exam: vehicles, hidden effects and manoeuvres drawn from a seed.

    OMP_NUM_THREADS=1 python -m benchmarks.strangers --seed 20261124 --cases 300

A vehicle of one to six degrees of freedom has a speed each, and where it is moored or stands on
springs a displacement :math:`\dot x_i = v_i`,

.. math::

    \dot v_i = b_i\,\delta_{j(i)} - d_i v_i - k_i x_i + c_i v_0 v_{i-1} + h_i + w_i,

all but the coupling :math:`c_i` estimated from values 10 to 30 % off. The truth is integrated by
SciPy. The seed is new at every release, and no rule is tuned on it: rates of older seeds stay.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp
from scipy.linalg import expm, orth

from benchmarks.harness import RESULTS, TWO_SIDED_95, Row, Store, grouped, study, tabulate
from benchmarks.other_vehicles.judge import DETECTABLE
from benchmarks.rates import judged, nothing_else, share, summary
from benchmarks.truth import gauss_markov, runge_kutta
from oed_sysid import Dataset, Force, Input, Model, Output, Parameter, Record, State
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.physics import Effect, forces, signals

STORE = RESULTS / "strangers.jsonl"
# What is hidden, case after case; of an unlisted effect the candidates know nothing.
PATTERN = (
    "single", "none", "single", "unlisted", "single", "pair", "single", "none", "single", "single",
)  # fmt: skip
# Sizes in typical ones, noise in standard deviations of a signal, samples and records.
SIZES, NOISE, SAMPLES, RECORDS = (0.1, 100.0), 0.02, 400, 3
KINDS = (
    "quadratic", "offset", "friction", "cross", "actuator_lag", "actuator_offset", "deadband",
    "limit", "bias", "scale", "sensor_lag",
)  # fmt: skip
EXCITATIONS = ("steps", "autopilot", "sweep", "sea")
Sizes = Mapping[tuple[str, int], float]


@dataclass(frozen=True, eq=False)
class Stranger:
    """A vehicle: its numbers ``(n,)`` each, input of every equation, sample time in s."""

    gain: np.ndarray
    damping: np.ndarray
    spring: np.ndarray
    coupling: np.ndarray
    lever: np.ndarray
    sample: float
    noise: np.ndarray

    @property
    def times(self) -> np.ndarray:
        """Times of all samples, s."""
        return np.arange(SAMPLES) * self.sample

    @classmethod
    def drawn(cls, rng: np.random.Generator) -> Stranger:
        """Time constants of 1 to 10 s, half of the displacements on springs."""
        n = int(rng.integers(1, 7))
        damping = 1.0 / np.exp(rng.uniform(0.0, np.log(10.0), n))
        spring = damping**2 * rng.uniform(0.5, 3.0, n) * (rng.random(n) < 0.5)
        lever = np.arange(n) % max(1, (n + 1) // 2)
        coupling = np.where(np.arange(n) > 0, damping * rng.uniform(-0.5, 0.5, n), 0.0)
        gain = damping * rng.uniform(0.7, 1.4, n) * rng.choice([-1.0, 1.0], n)
        sample = 0.1 / float(damping.max())
        return cls(gain, damping, spring, coupling, lever, sample, np.ones(2 * n))

    @property
    def sea(self) -> np.ndarray:
        """Standard deviation of the force that a sea brings into every equation, ``(n,)``."""
        return 0.1 * self.damping

    @property
    def memory(self) -> float:
        """Correlation of that force from sample to sample."""
        return float(np.exp(-self.sample * np.median(self.damping)))

    def estimated(self) -> dict[str, float]:
        """What a nominal model estimates, by name."""
        rows = enumerate(zip(self.gain, self.damping, self.spring, strict=True))
        return {
            f"{name}{i}": float(value)
            for i, row in rows
            for name, value in zip("bdk", row, strict=True)
            if value
        }

    def run(
        self,
        excitation: str,
        seed: int,
        hidden: Sizes,
        values: Mapping[str, float],
        *,
        exact: bool = True,
        start: Sequence[float] = (),
    ) -> tuple[np.ndarray, np.ndarray]:
        """Commands ``(n_times, n_inputs)`` and what sensors without noise show."""
        rng, n, times = np.random.default_rng(seed), len(self.gain), self.times
        m = int(self.lever.max()) + 1
        b, d, k = (np.array([values.get(f"{w}{i}", 0.0) for i in range(n)]) for w in "bdk")
        levels = np.repeat(rng.uniform(-1.0, 1.0, (9, m)), -(-SAMPLES // 8), axis=0)
        if excitation == "sweep":
            rate = np.linspace(0.2, 2.0, SAMPLES) * np.median(self.damping)
            levels = np.cos(np.cumsum(rate * self.sample)[:, None] + rng.uniform(0, 6.28, m))
        sea = np.zeros((SAMPLES, n))
        if excitation == "sea":
            sea = self.sea * gauss_markov(rng.standard_normal((SAMPLES, n)), self.memory)
        size = lambda kind, at: hidden.get((kind, at), 0.0)  # noqa: E731
        state = np.zeros(2 * n + m)  # speeds, displacements, actuators
        state[: len(start)] = start
        commands, states = np.zeros((SAMPLES, m)), np.zeros((SAMPLES, 2 * n))

        def rates(_: float, z: np.ndarray, row: int) -> np.ndarray:
            """Commands and the sea are held over a sample."""
            v, x = z[:n], z[n : 2 * n]
            wanted = [_actuated(commands[row, j], j, size) for j in range(m)]
            lags = [size("actuator_lag", j) for j in range(m)]
            moved = [z[2 * n + j] if lags[j] else wanted[j] for j in range(m)]
            dv = b * np.array(moved)[self.lever] - d * v - k * x + sea[row]
            dv = dv + self.coupling * v[0] * np.roll(v, 1)
            for i in range(n):
                dv[i] += size("offset", i) - size("friction", i) * np.tanh(v[i] / 0.02)
                dv[i] += size("quadratic", i) * v[i] * abs(v[i]) + size("cross", i) * v[i - 1]
            da = [
                (w - a) / t if t else 0.0 for w, a, t in zip(wanted, z[2 * n :], lags, strict=True)
            ]
            return np.concatenate([dv, v, da])

        for row in range(SAMPLES):
            commands[row] = levels[row]
            if excitation == "autopilot":
                commands[row] -= np.sign(b[:m]) * state[:m]
            if row == 0:
                state[2 * n :] = [_actuated(commands[0, j], j, size) for j in range(m)]
            states[row] = state[: 2 * n]
            if exact:
                span = (times[row], times[row] + self.sample)
                state = solve_ivp(rates, span, state, args=(row,), rtol=1e-6, atol=1e-8).y[:, -1]
            else:
                state = runge_kutta(lambda z, _, at: rates(0.0, z, at), state, self.sample, row)
            if not np.all(np.abs(state) < 1e3):
                return commands, np.full((SAMPLES, 2 * n), np.nan)
        return commands, np.column_stack([self._sensed(y, i, size) for i, y in enumerate(states.T)])

    def _sensed(self, y: np.ndarray, i: int, size) -> np.ndarray:  # type: ignore[no-untyped-def]
        """One sensor; of a lag the exact answer to a signal that is linear between samples."""
        lag = size("sensor_lag", i)
        if lag:
            seen, h, out = float(y[0]), self.sample, [float(y[0])]
            for a, z in pairwise(y):
                slope = (z - a) / h
                seen = z - slope * lag + (seen - a + slope * lag) * np.exp(-h / lag)
                out.append(seen)
            y = np.array(out)
        return (1.0 + size("scale", i)) * y + size("bias", i)


def _actuated(command: float, j: int, size) -> float:  # type: ignore[no-untyped-def]
    """What an actuator does with a command before it lags."""
    dead, limit = size("deadband", j), size("limit", j)
    moved = np.sign(command) * max(abs(command) - dead, 0.0) + size("actuator_offset", j)
    return float(np.clip(moved, -1.0 / limit, 1.0 / limit) if limit else moved)


def candidates(truth: Stranger, level: np.ndarray) -> dict[tuple[str, int], Effect]:
    """Every effect that may be hidden, at its typical size; ``level`` of every sensor."""
    found: dict[tuple[str, int], Effect] = {}
    drive, lag = np.abs(truth.gain) * 0.5, 2.0 * truth.sample
    for i in range(len(truth.gain)):
        v = f"v{i}"
        power = {"quadratic": (f"{v}*abs({v})", level[i] ** 2), "offset": ("1", 1.0)}
        power |= {"cross": (f"v{i - 1}", level[i - 1])} if i else {}
        for kind, (text, size) in power.items():
            per = {"quadratic": "1/m", "offset": "m/s^2", "cross": "1/s"}[kind]
            own = Parameter(f"E_{kind}_{v}", 0.0, per, scale=0.1 * drive[i] / size)
            found[kind, i] = Force(f"{kind}_{v}", {v: f"{own.name}*{text}"}, (own,))
        found["friction", i] = forces.coulomb_friction(
            f"friction_{v}", v, v, smooth=0.02, unit="m/s^2", scale=0.1 * drive[i]
        )
    for j in range(int(truth.lever.max()) + 1):
        u = f"u{j}"
        found["actuator_lag", j] = signals.actuator_lag(f"actuator_lag_{u}", u, scale=lag)
        found["actuator_offset", j] = signals.actuator_offset(
            f"actuator_offset_{u}", u, "1", scale=0.05
        )
        found["deadband", j] = signals.deadband(f"deadband_{u}", u, "1", scale=0.05)
        found["limit", j] = signals.unknown_limit(f"limit_{u}", u, "1", scale=1.2)
    for i, (output, unit) in enumerate(_outputs(truth)):
        found["bias", i] = signals.sensor_bias(f"bias_{output}", output, unit, scale=0.1 * level[i])
        found["scale", i] = signals.sensor_scale(f"scale_{output}", output)
        found["sensor_lag", i] = signals.sensor_lag(f"sensor_lag_{output}", output, scale=lag)
    return found


def _outputs(truth: Stranger) -> list[tuple[str, str]]:
    n = len(truth.gain)
    return [(f"v{i}", "m/s") for i in range(n)] + [(f"x{i}", "m") for i in range(n)]


def nominal(truth: Stranger, values: Mapping[str, float], noise: np.ndarray) -> Model:
    """The nominal model at some values of what it estimates."""
    n = len(truth.gain)
    rates = {}
    for i in range(n):
        spring = f" - k{i}*x{i}" if truth.spring[i] else ""
        cross = f" + ({truth.coupling[i]!r})*v0*v{i - 1}" if i else ""
        rates[f"v{i}"] = f"b{i}*u{truth.lever[i]} - d{i}*v{i}{spring}{cross}".replace(
            "np.float64", ""
        )
        rates[f"x{i}"] = f"v{i}"
    units = {"b": "m/s^2", "d": "1/s", "k": "1/s^2"}
    return Model(
        name=f"stranger of {n} degrees of freedom",
        states=tuple(State(name, unit, scale=0.5) for name, unit in _outputs(truth)),
        inputs=tuple(Input(f"u{j}", "1") for j in range(int(truth.lever.max()) + 1)),
        outputs=tuple(
            Output(name, unit, expression=name, noise_std=float(level))
            for (name, unit), level in zip(_outputs(truth), noise, strict=True)
        ),
        kinematics=rates,
        parameters=tuple(Parameter(k, v, units[k[0]]) for k, v in values.items()),
        step=truth.sample,
    )


def shown(
    truth: Stranger, plan: Sequence[tuple[str, int]], hidden: Sizes, level: np.ndarray
) -> float:
    """Least statistic of leaving one effect out, all else re-estimated to first order.

    All else is parameters, and the speeds and displacements at which each record starts: without a
    spring the bias of a displacement's sensor is nothing else. Rows are in standard deviations of
    what sensors, and where there is one the sea, make of them.
    """
    values = truth.estimated()

    def rows(sizes: Sizes, at: Mapping[str, float]) -> np.ndarray:
        return np.array([truth.run(*one, sizes, at, exact=False)[1] for one in plan])

    whole = rows(hidden, values)
    slopes = [(rows(hidden, values | {k: v * 1.001}) - whole) / 1e-3 for k, v in values.items()]
    lost = [whole - rows({k: v for k, v in hidden.items() if k != one}, values) for one in hidden]
    starts = []
    for record, one in enumerate(plan):
        for moved in 1e-3 * np.eye(2 * len(truth.gain)):
            by_start = np.zeros_like(whole)
            run = truth.run(*one, hidden, values, exact=False, start=moved)[1]
            by_start[record] = (run - whole[record]) / 1e-3
            starts.append(by_start)
    columns = np.stack([*slopes, *starts, *lost], axis=-1)
    seas = [excitation == "sea" for excitation, _ in plan]
    white = np.concatenate(
        [whitened(truth, own, level, sea=sea) for own, sea in zip(columns, seas, strict=True)]
    ).reshape(-1, columns.shape[-1])
    if not np.isfinite(white).all():
        return np.nan  # too stiff for the quick integration: nothing is said
    known, effects = np.split(white, [len(slopes) + len(starts)], axis=1)
    basis = orth(known / np.maximum(np.linalg.norm(known, axis=0), 1e-300), rcond=1e-9)
    left = effects - basis @ (basis.T @ effects)
    return float(np.min(np.sum(left**2, axis=0), initial=np.inf))


def whitened(truth: Stranger, rows: np.ndarray, level: np.ndarray, *, sea: bool) -> np.ndarray:
    """Columns of outputs in standard deviations, each of what those before it do not tell.

    Where a sea acts that is a Kalman filter of every equation without its coupling: what an effect
    moves less than the sea would is not seen.

    Parameters
    ----------
    rows : ndarray (n_times, 2 n, n_columns)
        Speeds, then displacements.
    level : ndarray (2 n,)
        Standard deviations of the sensors.
    """
    if not sea:
        return rows / level[:, None]
    n, found, memory = len(truth.gain), np.empty_like(rows), truth.memory
    for i, (d, k) in enumerate(zip(truth.damping, truth.spring, strict=True)):
        pair, size = [i, n + i], truth.sea[i] ** 2
        # Speed, displacement and the force, which is held over a sample.
        step = expm(truth.sample * np.array([[-d, -k, 1.0], [1.0, 0.0, 0.0], [0.0, 0.0, 0.0]]))
        step[2, 2] = memory
        believed, covariance = np.zeros((3, rows.shape[2])), np.diag([0.0, 0.0, size])
        drive = np.diag([0.0, 0.0, size * (1.0 - memory**2)])
        for row, seen in enumerate(rows[:, pair]):
            spread = covariance[:2, :2] + np.diag(level[pair] ** 2)
            innovation = seen - believed[:2]
            found[row, pair] = np.linalg.solve(np.linalg.cholesky(spread), innovation)
            gain = np.linalg.solve(spread, covariance[:2]).T
            believed = step @ (believed + gain @ innovation)
            covariance = step @ (covariance - gain @ covariance[:2]) @ step.T + drive
    return found


def hidden_in(
    listed: Mapping[tuple[str, int], Effect], count: int, rng: np.random.Generator
) -> tuple[list[str], dict[tuple[str, int], float]]:
    """Two kinds of effect, and what of them is hidden, with its sizes."""
    there = {kind for kind, _ in listed}
    kinds = list(rng.choice([kind for kind in KINDS if kind in there], 2, replace=False))
    sizes = {}
    for kind in kinds[:count]:
        places = [key for key in listed if key[0] == kind]
        key = places[int(rng.integers(len(places)))]
        own = listed[key].parameters[0]
        factor = np.exp(rng.uniform(*np.log(SIZES))) * (rng.choice([-1, 1]) if own.lower < 0 else 1)
        sizes[key] = float(factor) * own.magnitude * (-1 if kind == "quadratic" else 1)
    return kinds, sizes


def drawn(seed: int, number: int) -> tuple[Row, Model, list[Record], list[Effect]]:
    """One case: what is true, the nominal model, records, the last to validate, and candidates."""
    rng = np.random.default_rng([seed, number])
    what, excitation = PATTERN[number % len(PATTERN)], EXCITATIONS[int(rng.integers(4))]
    truth = Stranger.drawn(rng)
    values = truth.estimated()
    plan = [(excitation, int(rng.integers(2**31))) for _ in range(RECORDS)]
    level = np.mean([truth.run(*one, {}, values)[1].std(axis=0) for one in plan], axis=0)
    listed = candidates(truth, level)
    kinds, sizes = hidden_in(listed, {"none": 0, "pair": 2}.get(what, 1), rng)
    while True:  # what diverges, or stops the vehicle, is drawn again at half the size
        runs = [truth.run(*one, sizes, values) for one in plan]
        moved = np.mean([y.std(axis=0) for _, y in runs], axis=0) / level
        if np.all((moved > 0.3) & (moved < 3.0)):
            break
        sizes = {key: 0.5 * size for key, size in sizes.items()}
    noise = NOISE * level
    wrong = {k: v * (1 + rng.uniform(0.1, 0.3) * rng.choice([-1, 1])) for k, v in values.items()}
    model = nominal(truth, wrong, noise)
    records = [
        Record(f"run_{i}", truth.times, u, y + noise * rng.standard_normal(y.shape), model.channels)
        for i, (u, y) in enumerate(runs)
    ]
    entry: Row = {
        "key": f"{seed}/{number}", "seed": seed, "what": what, "excitation": excitation,
        "freedom": len(truth.gain), "effects": [listed[key].name for key in sizes],
        "sizes": {listed[key].parameters[0].name: size for key, size in sizes.items()},
        "detectable": shown(truth, plan, sizes, noise) > DETECTABLE,
    }  # fmt: skip
    offered = [e for key, e in listed.items() if what != "unlisted" or key[0] != kinds[0]]
    return entry, model, records, offered


def judge(seed: int, number: int, limit: float) -> Row:
    """Draw one case, improve its nominal model, compare with what is hidden."""
    entry, model, (*train, last), offered = drawn(seed, number)

    def against_truth(found: Improvement | None) -> Row:
        if found is None:
            return {}
        values, errors = found.fit.values, found.fit.std_errors
        inside = [
            bool(abs(values[name] - size) < TWO_SIDED_95 * errors[name])
            for name, size in entry["sizes"].items()
            if name in errors
        ]
        return {"remains": found.remains.kind, "inside": inside}

    data = Dataset(train), Dataset((last,))
    return judged(entry, model, data, offered, against_truth, limit=limit)


def true_verdict(row: Row) -> bool:
    """Whether what is said of the remainder is so."""
    if row["what"] == "unlisted":
        # What only a sensor lacks, the check of the log may say.
        sensor = all(name.startswith(("bias", "scale", "sensor")) for name in row["effects"])
        said = {"structure missing", *(["log suspect"] if sensor else [])}
        return bool(row.get("steps")) or row.get("remains") in said
    right = {"disturbance", "adequate"} if row["excitation"] == "sea" else {"adequate"}
    return row.get("remains") in right


def _rate(rows: Sequence[Row], is_so) -> str:  # type: ignore[no-untyped-def]
    """Cases of which something is so, and how many there are."""
    one = share("", is_so, rows)
    n = one["count"]
    return f"{round(one['value'] * n)} of {n}" if n else "-"


def _shown(rows: Sequence[Row], *what: str) -> list[Row]:
    return [row for row in rows if row["what"] in what and row["detectable"]]


def table(rows: Sequence[Row]) -> str:
    """Rates by excitation as Markdown."""
    groups = grouped(rows, lambda row: row["excitation"])
    return _table("excitation", groups | {"all": list(rows)})


def dates(rows: Sequence[Row]) -> str:
    """Rates of every date as Markdown."""
    groups = grouped(rows, lambda row: row["seed"])
    return _table("date, cases", {f"{seed}, {len(g)}": g for seed, g in groups.items()})


def _table(title: str, groups: Mapping[str, list[Row]]) -> str:
    """Rates of groups as Markdown."""
    columns = {
        title: lambda name, _: name,
        "accepted and nothing else": lambda _, g: _rate(_shown(g, "single", "pair"), nothing_else),
        "size in its interval": lambda _, g: _rate(
            [{"in": ok} for row in g if nothing_else(row) for ok in row.get("inside", ())],
            lambda one: one["in"],
        ),
        "false claims, nothing hidden": lambda _, g: _rate(
            [row for row in g if row["what"] == "none"], lambda row: row.get("steps")
        ),
        "unlisted: said or explained": lambda _, g: _rate(_shown(g, "unlisted"), true_verdict),
        "verdict true": lambda _, g: _rate(
            [*_shown(g, "none"), *filter(nothing_else, _shown(g, "single", "pair"))], true_verdict
        ),
        "aborted": lambda _, g: sum("error" in row for row in g),
    }
    return "\n".join(tabulate(groups, columns))


def cases(
    *, seed: int = 20261124, cases: int = 300, limit: float = 300.0
) -> dict[str, partial[Row]]:
    """Cases of a date.

    Parameters
    ----------
    seed : int
        date of a release, as 20261124
    cases : int
        how many
    limit : float
        processor seconds for one improvement
    """
    return {f"{seed}/{number}": partial(judge, seed, number, limit) for number in range(cases)}


if __name__ == "__main__":
    study(cases, table, Store(STORE), tell=summary)
