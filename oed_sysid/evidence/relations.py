r"""Equations between measured signals that hold whatever the forces are.

.. math:: \dot y = f(s_1, s_2, \dots) \quad\text{or}\quad y = f(s_1, s_2, \dots)

Two sources: the equations that a model declares (kinematics and outputs in which no unknown
parameter occurs), and the kinematics of a rigid body where measured signals carry the standard
names (SNAME 1950; Fossen 2021, Handbook of Marine Craft, eqs. 2.26 and 2.38),

.. math::

    \dot\phi &= p + (q \sin\phi + r \cos\phi) \tan\theta, \quad
    \dot\theta = q \cos\phi - r \sin\phi, \quad
    \dot\psi = (q \sin\phi + r \cos\phi) / \cos\theta, \\
    (\dot x, \dot y, \dot z)^T &= R_z(\psi) R_y(\theta) R_x(\phi)\, (u, v, w)^T,

with the angles and rates that are not measured taken as zero.

Between samples a rate :math:`f` moves on, which its integral over a step :math:`h` shows by how
much its slope changes over the step, :math:`-\tfrac{h^2}{12} (\dot f_{k+1}^- - \dot f_k^+)`.
Where a command is held slopes jump at the samples, and those across samples do not show the motion
between them: a vehicle of natural frequency :math:`\omega_0` swings on, which is worth
:math:`h^2 \omega_0^2 / 12` of its rate. The nominal model, at the measured states and inputs, gives
slopes :math:`g^-, g^+` just before and after each sample, and leaves
:math:`d = \Delta f / \Delta t - (g^- + g^+)/2` of the slope across it. With
:math:`B(a^-, a^+) = -\sum \tfrac{h^2}{12} (a_{k+1}^- - a_k^+)` the integral is that by straight
lines plus :math:`B(g^-, g^+) + \gamma B(d, d)`: what the model leaves is held like a command
(:math:`\gamma = 0`) or goes on between samples (:math:`\gamma = 1`). Accelerations jump with a
command themselves, by :math:`J` at a sample, which was measured after the jump: over the step
before it the integral is :math:`\tfrac{h}{2} J` less. All of that is in doubt, because an actuator
that lags leaves no jump and is often in no nominal model.

Columns of a file that no channel asked for, but whose names say what they are.

A log often holds more than a model needs: positions beside a heading model, say. Where such a
column carries a usual name of a rigid body's motion, kinematics can use it.
"""

from __future__ import annotations

import contextlib
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence, Set
from dataclasses import dataclass, field, replace
from importlib.resources import files
from itertools import product
from pathlib import Path

import numpy as np

from oed_sysid.compiled.graph import build
from oed_sysid.data.csv_columns import Columns
from oed_sysid.data.record import Record, unwrapped
from oed_sysid.errors import DataError
from oed_sysid.likelihood.start_guess import needed_by, touched
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.text import expressions
from oed_sysid.text.csv_table import Table, read_table
from oed_sysid.text.units import parse_header, to_si

_TABLE = tomllib.loads(files("oed_sysid.data").joinpath("kinematics.toml").read_text("utf-8"))
STANDARD_UNITS: dict[str, str] = _TABLE["units"]
# Factor and meaning of the units that numbers may be in, by the unit that they should be in.
READINGS: dict[str, list[tuple[float, str]]] = _TABLE["readings"]
# A declared prior is not trusted beyond this share of its mean: nominal physics lacks as much.
LEAST_PRIOR = 0.25


@dataclass(frozen=True)
class Relation:
    """One equation between measured signals.

    Parameters
    ----------
    target : str
        Signal on the left side.
    signals : tuple of str
        Signals on the right side.
    text : str
        The right side, for people.
    is_rate : bool
        Whether the left side is the rate of the target, rather than the target itself.
    steps : tuple of (str, str)
        Definitions to evaluate in order; the last one is the right side.
    constants : mapping
        Known constants in them.
    asked : tuple of str
        Signals of the right side whose errors are asked; all if not given.
    driven : tuple of str
        Those that may lose their effect: none of kinematics.
    model : Model, optional
        The nominal model, which says how measured states move between samples.
    """

    target: str
    signals: tuple[str, ...]
    text: str
    is_rate: bool
    steps: tuple[tuple[str, str], ...] = field(repr=False)
    constants: Mapping[str, float] = field(repr=False)
    asked: tuple[str, ...] = ()
    driven: tuple[str, ...] = ()
    model: Model | None = field(default=None, repr=False)

    @property
    def names(self) -> tuple[str, ...]:
        """All signals, the left side first."""
        return (self.target, *self.signals)

    def integral(self, times: np.ndarray, columns: np.ndarray) -> np.ndarray:
        """Cumulative integral of rates of :meth:`__call__`, ``(n_times, k)``; first row zero."""
        return integral(times, columns)

    def sampled(
        self, times: np.ndarray, rates: np.ndarray, known: np.ndarray, leaps: np.ndarray
    ) -> np.ndarray:
        r"""What motion between samples may change of the integral, ``(3, n_times)``.

        Parameters
        ----------
        times, rates : numpy.ndarray
            Shape ``(n_times,)``; rates of :meth:`__call__`.
        known : numpy.ndarray
            Shape ``(2, n_times)``: slopes of the rates by the nominal model, before and after each
            sample.
        leaps : numpy.ndarray
            Shape ``(n_times,)``: by how much the rates jump at each sample by the nominal model.

        Returns
        -------
        numpy.ndarray
            What jumps of the model's slopes and rates add to :meth:`integral`, whose :math:`\gamma`
            is one; the range that :math:`\gamma` leaves, :math:`B(d, d)`; and what the model may
            lack of its jumps.
        """
        mean, steps = known.mean(axis=0), np.diff(times)
        left = np.gradient(rates, times) - mean
        sides = np.array([known - mean, [left, left], LEAST_PRIOR * known])
        bent = -(steps**2) / 12.0 * (sides[:, 0, 1:] - sides[:, 1, :-1])
        bent -= np.outer([1.0, 0.0, 1.0], 0.5 * steps * leaps[1:])
        return np.pad(np.cumsum(bent, axis=1), ((0, 0), (1, 0)))

    def __str__(self) -> str:
        return f"{self.target}{chr(39) if self.is_rate else ''} = {expressions.to_text(self.text)}"

    def __call__(self, values: Mapping[str, np.ndarray], times: np.ndarray) -> np.ndarray:
        """Right side at every time, shape ``(n_times,)``; ``values`` by name of signal."""
        scope: dict[str, object] = {**self.constants, **values, "t": times}
        for name, text in self.steps:
            scope[name] = expressions.to_numpy(text, scope)
        return np.broadcast_to(np.asarray(scope[self.steps[-1][0]], dtype=float), times.shape)

    def slope(self, values: Mapping[str, np.ndarray], times: np.ndarray, name: str) -> np.ndarray:
        """Derivative of the right side by one signal, ``(n_times,)``."""
        return self.along(values, times, {name: np.ones(times.size)})

    def along(
        self, values: Mapping[str, np.ndarray], times: np.ndarray, added: Mapping[str, np.ndarray]
    ) -> np.ndarray:
        """Derivative of the right side by a factor of what is added to signals, ``(n_times,)``.

        By central differences of the whole series: what remembers answers later.
        """

        def size(series: np.ndarray) -> float:
            return float(np.sqrt(np.mean(series**2)))

        if not added:
            return np.zeros(times.size)
        sizes = ((size(values[n]) + 1e-3) / (size(one) + 1e-300) for n, one in added.items())
        h = 1e-4 * min(sizes)
        up, down = (
            self({**values, **{n: values[n] + by * one for n, one in added.items()}}, times)
            for by in (h, -h)
        )
        return (up - down) / (2.0 * h)

    def level(self, name: str) -> float:
        """Right side where one signal is 1 and all others are 0: its share at level attitude."""
        at = {n: np.full(2, float(n == name)) for n in self.signals}
        return float(self(at, np.zeros(2))[0])


def integral(times: np.ndarray, columns: np.ndarray) -> np.ndarray:
    """Cumulative integral of cubic Hermite splines through ``(n, k)`` samples; first row zero.

    Examples
    --------
    >>> t = np.linspace(0.0, 3.0, 31)
    >>> print(round(float(integral(t, np.cos(t)[:, None])[-1, 0] / np.sin(3.0)), 6))
    0.999996
    """
    steps = np.diff(times)[:, None]
    slopes = np.gradient(columns, times, axis=0)
    parts = 0.5 * steps * (columns[1:] + columns[:-1]) - steps**2 / 12.0 * np.diff(slopes, axis=0)
    return np.concatenate([np.zeros((1, columns.shape[1])), np.cumsum(parts, axis=0)])


def nominal_sides(
    model: Model, times: np.ndarray, values: Mapping[str, np.ndarray], inputs: np.ndarray
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """What the nominal model says just before and just after each sample.

    Parameters
    ----------
    model : Model
        At its nominal values, with settled actuators; states that were not measured are nothing.
    times : numpy.ndarray
        Shape ``(n_times,)``, s.
    values : mapping of str to numpy.ndarray
        Measured signals, ``(n_times,)`` each, free of gaps.
    inputs : numpy.ndarray
        Shape ``(n_times, n_inputs)``; those that are held are as before until their sample.

    Returns
    -------
    dict, dict
        Rates of measured states, and outputs, ``(2, n_times)`` each; nothing where the model has
        no finite value.
    """
    graph, shown = build(model), {o.source: o.name for o in model.outputs}
    names, zero = [shown.get(state, "") for state in model.state_names], np.zeros(times.size)
    own = np.array([values.get(name, zero) for name in names])
    earlier = np.where(graph.linear_inputs, inputs, np.concatenate([inputs[:1], inputs[:-1]]))
    around = [
        graph.settled(own, commands.T, model.value_vector, times[None])
        for commands in (earlier, inputs)
    ]
    # Where it diverges it says nothing, in numbers that can still be squared.
    rates, outputs = (
        np.nan_to_num(np.array(sides), posinf=0.0, neginf=0.0).clip(-1e9, 1e9)
        for sides in zip(*around, strict=True)
    )
    return (
        {name: rates[:, k] for k, name in enumerate(names) if name},
        {name: outputs[:, k] for k, name in enumerate(model.output_names)},
    )


def names_of(relations: Iterable[Relation]) -> tuple[str, ...]:
    """All signals of some equations."""
    return tuple(dict.fromkeys(n for r in relations for n in r.names))


def relations(
    model: Model, spare: Iterable[str] = (), missing: Iterable[str] = ()
) -> tuple[Relation, ...]:
    """All equations between measured signals.

    Parameters
    ----------
    model : Model
        The model; only kinematics, signals, outputs and inputs are used.
    spare : iterable of str
        Measured signals with standard names that the model does not ask for.
    missing : iterable of str
        Outputs that were not measured.
    """
    absent = set(missing)
    outputs = [o for o in model.outputs if o.name not in absent]
    shown, measured = _measured(model, outputs)
    # Kinematics to which no effect adds anything.
    free = shown.keys() - touched(model)
    stated = [(shown[s], text, True) for s, text in model.kinematics.items() if s in free]
    stated += [(o.name, o.source, False) for o in outputs if o.source not in measured]
    stated += _accelerated(outputs, shown)
    declared = [_declared(model, *one, measured) for one in stated]
    found = tuple(filter(None, declared))
    # Where the model has an equation for one of these states, it knows better.
    taken = {*model.kinematics, *(r.target for r in found)}
    every = (*found, *standard(outputs, set(spare), taken))
    return tuple(replace(one, model=model) for one in every)


def _measured(model: Model, outputs: Iterable[Output]) -> tuple[dict[str, str], dict[str, str]]:
    """States that outputs show and nothing else, and everything that is known by measurement.

    So is a signal that nothing else that was measured gives, and a rate that an output names: an
    acceleration say.
    """
    named = {o.source: o.name for o in outputs}
    shown = {state: named[state] for state in model.state_names if state in named}
    inner = (signal for signal in model.signals if signal in named)
    known = {s: named[s] for s in inner if needed_by(model, s, {*shown}) is None}
    rates = {name: name for source, name in named.items() if source.startswith("dot(")}
    return shown, shown | known | rates


def _accelerated(
    outputs: Iterable[Output], shown: Mapping[str, str]
) -> Iterator[tuple[str, str, bool]]:
    """Rates of measured states from outputs that name them: of ``dot(u) - v*r`` it and ``v*r``."""
    for output, (state, name) in product(outputs, shown.items()):
        rate = f"dot({state})"
        rest = output.source.removeprefix(rate).strip()
        if output.source.startswith(rate) and rest[:1] in ("", "+", "-"):
            yield name, output.name + f" - ({rest})" * bool(rest), True


def _declared(
    model: Model, target: str, text: str, is_rate: bool, measured: Mapping[str, str]
) -> Relation | None:
    """Equation of the model over measured signals; None if anything unknown enters it."""
    used, inner, constants = needed_by(model, text, {*measured}) or ([], [], {})
    signals = tuple(dict.fromkeys(measured[s] for s in used))
    if not signals or (is_rate and not _is_kinematic(model, target, set(signals))):
        return None
    # Other names of measured signals, then inner signals in the order of the model.
    aliases = [(s, measured[s]) for s in dict.fromkeys(used) if measured[s] != s]
    steps = [*aliases, *((name, model.signals[name]) for name in inner)]
    steps.append((f"{target}_prime_", text))
    return Relation(target, signals, text, is_rate, tuple(steps), constants)


def _is_kinematic(model: Model, target: str, signals: set[str]) -> bool:
    """Whether a rate follows from motion alone, not from forces whose constants are known."""
    units = {o.name: o.unit for o in model.outputs}
    if units[target] in ("m/s", "rad/s"):
        accelerations = {name for name in signals if units[name] in ("m/s^2", "rad/s^2")}
        return bool(accelerations)
    return target not in signals or units[target] == "rad"


def standard(
    outputs: Sequence[Output], spare: Set[str] = frozenset(), taken: Set[str] = frozenset()
) -> Iterator[Relation]:
    """Equations of a rigid body for signals with standard names and units, save ``taken`` ones."""
    plain = {o.name: o.unit for o in outputs if o.expression in (None, o.name)}
    known = (spare & STANDARD_UNITS.keys()) - {o.name for o in outputs}
    known |= {name for name, unit in plain.items() if STANDARD_UNITS.get(name) == unit}
    for target in (one for one in _TABLE["equations"] if one in known - taken):
        names, text = _fullest(target, known)
        if text:
            signals = tuple(n for n in names if n in expressions.names(text))
            yield Relation(target, signals, text, True, ((f"{target}_prime_", text),), {})


def _fullest(target: str, known: set[str]) -> tuple[tuple[str, ...], str]:
    """Names and right side of the fullest form of a standard equation; empty if there is none."""
    forms = (((*need.split(), target), text) for need, text in _TABLE["equations"][target])
    return next((one for one in forms if known.issuperset(one[0])), ((), ""))


def standard_name(header: str) -> tuple[str, str] | None:
    """Return the standard name and the unit of a column; None if its header does not tell.

    Examples
    --------
    >>> standard_name("x_position_mid [m]"), standard_name("heading [deg]")
    (('x', 'm'), ('psi', 'deg'))
    >>> standard_name("dx0_mps"), standard_name("wind_dir_true [rad]")
    (None, None)
    """
    name, unit = parse_header(header)
    words = [word for word in name.lower().split("_") if word not in _TABLE["words"]["decoration"]]
    found = _TABLE["names"].get("_".join(words), "_".join(words))
    if found not in STANDARD_UNITS or unit is None:
        return None
    return found, unit


def spare_signals(record: Record) -> dict[str, np.ndarray]:
    """Signals that the file of a record holds beside its channels.

    Returns
    -------
    dict
        Standard name to series ``(n_samples,)`` in SI at the times of the record; empty if the
        record was not read from a file that is still there.
    """
    taken = {*record.channels.output_names, *record.channels.input_names}
    wanted: dict[str, tuple[str, str]] = {}
    for header in record.ignored_columns:
        name, unit = standard_name(header) or ("", "")
        if name and name not in taken:
            wanted.setdefault(name, (header, unit))
    if not wanted or not record.source:
        return {}
    # The check of what was read does not fail over what was not asked for.
    with contextlib.suppress(DataError, ValueError, IndexError, OSError):
        table = read_table(Path(record.source))
        times = Columns(table, {}).times(None)
        rows = np.clip(np.searchsorted(times, record.times), 0, times.size - 1)
        if np.allclose(times[rows], record.times, rtol=0.0, atol=1e-9):
            return dict(_read(table, rows, wanted))
    return {}


def _read(
    table: Table, rows: np.ndarray, wanted: Mapping[str, tuple[str, str]]
) -> Iterator[tuple[str, np.ndarray]]:
    """Some columns in SI, ``(n_rows,)`` each, where their unit is that of the name."""
    for name, (header, unit) in wanted.items():
        values, si_unit = to_si(table.values[rows, table.headers.index(header)], unit)
        if si_unit.replace(" ", "") == STANDARD_UNITS[name] and np.isfinite(values).any():
            yield name, unwrapped(values) if si_unit == "rad" else values
