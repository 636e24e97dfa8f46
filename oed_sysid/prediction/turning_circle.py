"""Turning circles predicted from a fit, with the uncertainty of what was fitted.

A turning circle is seldom among the records that a model was fitted to. This is
where an extrapolation is made, and where its uncertainty has to be said.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.special import ndtri

from oed_sysid.errors import DataError, ModelError, SimulationError, listed
from oed_sysid.experiments.base import above_zero, optional, positive
from oed_sysid.experiments.indices import TurningIndices, turning_indices
from oed_sysid.experiments.manoeuvres import TurningCircle
from oed_sysid.experiments.simulation import equilibrium, simulate_batch
from oed_sysid.likelihood.estimator import check_choice, check_count
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.channels import Output, State
from oed_sysid.physics.model import Model
from oed_sysid.prediction.draws import asked, parameter_sets
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import (
    TWO_SIDED_95,
    Report,
    Section,
    Table,
    as_dict,
    as_text,
    interval,
)
from oed_sysid.text.units import shown_unit

SIDES = ("starboard", "port")
# States of a turn, zero or steady on a straight course.
TURNING = ("v", "r", "p", "phi")
# Heading change that is simulated: a full turn, then half a turn to call steady.
TURN = 3.0 * math.pi
NEAR_AMIDSHIPS = math.radians(10.0)
LENGTHS = ("advance", "transfer", "tactical_diameter", "steady_diameter")
_UNITS = {**dict.fromkeys(LENGTHS, "m"), "time_90": "s", "time_180": "s", "speed_ratio": "1"}
QUANTITIES: Mapping[str, str] = {**_UNITS, "drift": "rad"}


@dataclass(frozen=True, eq=False)
class TurningPrediction:
    """Turning circles to one or both sides.

    Attributes
    ----------
    model : str
        Name of the model.
    rudder : float
        Held rudder angle, rad, without sign.
    speed : float
        Approach speed, m/s.
    length : float or None
        Ship length, m.
    nominal : mapping of str to mapping
        Per side (``"starboard"``, ``"port"``) each of :data:`QUANTITIES` at the
        fitted values; NaN where the turn never gets steady.
    draws : mapping of str to mapping of str to ndarray (n_draws,)
        The same for parameters drawn from the fit's covariance.
    unfinished : mapping of str to int
        Draws that never turned by 180 degrees; they are NaN in ``draws``.
    neutral : float
        Rudder angle of the straight approach at the fitted values, rad; zero where the approach
        was asked to be amidships.
    caveat : str
        Why the intervals are too narrow; empty where nothing says so.
    notes : tuple of str
        What the approach is not, in sentences: straight, or steady.
    """

    model: str
    rudder: float
    speed: float
    length: float | None
    nominal: Mapping[str, Mapping[str, float]]
    draws: Mapping[str, Mapping[str, np.ndarray]] = field(repr=False)
    unfinished: Mapping[str, int]
    neutral: float = 0.0
    caveat: str = ""
    notes: tuple[str, ...] = ()

    @property
    def sides(self) -> tuple[str, ...]:
        """Sides that were predicted."""
        return tuple(self.nominal)

    def value(self, quantity: str, side: str) -> float:
        """Return one quantity at the fitted values, in SI units."""
        return self.nominal[side][quantity]

    def std(self, quantity: str, side: str) -> float:
        """Return its standard deviation; NaN without draws."""
        values = self.draws[side][quantity]
        seen = values[np.isfinite(values)]
        return float(np.std(seen)) if len(seen) > 1 else math.nan

    def interval(self, quantity: str, side: str, level: float = 0.95) -> tuple[float, float]:
        """Return the interval about the nominal value that normal draws would give."""
        half = float(ndtri(0.5 + level / 2)) * self.std(quantity, side)
        value = self.value(quantity, side)
        return value - half, value + half

    def quantities(self, *names: str) -> dict[str, float]:
        """Quantities at the fitted values, all or the named, by ``"quantity side"``."""
        chosen = names or tuple(QUANTITIES)
        return {f"{q} {side}": self.value(q, side) for q in chosen for side in self.sides}

    def document(self) -> Report:
        """Return the prediction as a table, in metres and in ship lengths."""
        lengths = [] if self.length is None else list(self.sides)
        rows = []
        for quantity, unit in QUANTITIES.items():
            factor, shown = shown_unit(unit)
            cells = [self._cell(quantity, side, factor) for side in self.sides]
            scaled = [
                self._cell(quantity, side, 1 / (self.length or 1)) if quantity in LENGTHS else ""
                for side in lengths
            ]
            rows.append((quantity.replace("_", " "), *cells, shown, *scaled))
        headers = ("", *self.sides, "unit", *(f"{side} [L]" for side in lengths))
        neutral = f"straight approach with the rudder at {math.degrees(self.neutral):.2f} deg"
        assumed = [f"predicted by {self.model}; ± is half of a 95 % interval", *self.notes]
        if self.neutral:
            assumed.insert(1, neutral)
        after = [
            f"{count} draws never turned by 180 degrees to {side}: the interval is too narrow."
            for side, count in self.unfinished.items()
            if count
        ]
        return Report(
            f"turning circle, rudder {math.degrees(self.rudder):.3g} deg, {self.speed:.4g} m/s",
            answer=f"Turning circle predicted by {self.model}.",
            sections=(
                Section("Assumptions", assumed, indent=2),
                Section("Circle", tables=(Table(headers, rows),), indent=2),
                Section("Caveats", [*after, *filter(None, [self.caveat])], indent=2),
            ),
        )

    report = as_text

    def _cell(self, quantity: str, side: str, factor: float) -> str:
        value, std = self.value(quantity, side) * factor, self.std(quantity, side) * factor
        return interval(value, TWO_SIDED_95 * std) if math.isfinite(value) else "not steady"

    to_dict = as_dict(
        "model", "rudder", "speed", "length", "neutral", "unfinished", "caveat", "notes",
        sides=lambda self: {
            side: {
                quantity: {
                    "value": self.value(quantity, side),
                    "std": self.std(quantity, side),
                    "unit": unit,
                }
                for quantity, unit in QUANTITIES.items()
            }
            for side in self.sides
        },
    )  # fmt: skip


def turning_circle(
    fit_or_model: Fit | Model,
    *,
    speed: float,
    rudder: float = math.radians(35.0),
    side: str = "both",
    rate: float | None = None,
    length: float | None = None,
    approach: str = "neutral",
    n_draws: int = 100,
    rng: np.random.Generator | None = None,
) -> TurningPrediction:
    r"""Predict turning circles from a straight approach.

    The approach is an equilibrium: at the given speed the rudder stands where nothing turns or
    pushes the ship sideways, which for a single screw is not amidships. A model without such an
    angle within ten degrees begins amidships, which the result notes, and so does every model with
    ``approach="amidships"``. The speed is an equilibrium if it is the one that the propulsion
    keeps; where the two differ by more than a tenth the result notes that as well. Draws begin
    from the approach at the fitted values.

    The model needs a state ``psi``. Its ``u`` and ``v`` carry the track; a model
    without them keeps its speed and does not drift, and says nothing about either.

    Parameters
    ----------
    fit_or_model : Fit or Model
        A fit gives uncertainty, a model only its values.
    speed : float
        Approach speed, m/s; also the start value of ``u``.
    rudder : float
        Held rudder angle, rad, without sign: which sign turns to which side is
        found by simulation.
    side : str
        ``"starboard"``, ``"port"`` or ``"both"``.
    rate : float, optional
        Rudder rate, rad/s; by default the rudder jumps.
    length : float, optional
        Ship length, m, for results in lengths.
    approach : str
        ``"neutral"`` or ``"amidships"``.
    n_draws : int
        Parameter sets drawn from the fit's covariance, parameters that differ by
        record from their scatter over the records; values beyond a bound are set
        to it.
    rng : numpy.random.Generator, optional
        Source of the draws; by default one with a fixed seed.

    Returns
    -------
    TurningPrediction

    Raises
    ------
    ModelError
        If the model cannot turn, or a parameter of the fit is not identifiable.
    SimulationError
        If the turn diverges.

    References
    ----------
    IMO Resolution MSC.137(76), Annex, 4.2.2 (2002).

    Examples
    --------
    >>> from oed_sysid import Input, Parameter
    >>> ship = Model(
    ...     "Nomoto", (State("psi", "rad"), State("r", "rad/s")), (Input("rudder", "rad"),),
    ...     (Output("psi", "rad"),), {"psi": "r", "r": "(0.1*rudder - r)/10"},
    ... )
    >>> circle = turning_circle(ship, speed=1.0, rudder=0.2, side="port")
    >>> print(round(circle.value("steady_diameter", "port"), 1))  # 2 U/(K rudder)
    100.0
    """
    fit, model = asked(fit_or_model)
    wanted = SIDES if side == "both" else (side,)
    _check(wanted, approach, speed, rudder, length, rate, n_draws)
    tracked = _with_track(model, speed)
    steered = _rudder_input(model)
    # The track adds states, no parameters: draws are those of the model, in the order of the
    # other.
    kept = [model.parameter_names.index(name) for name in tracked.parameter_names]
    table = np.array(parameter_sets(fit, model, n_draws, rng))[:, kept]
    start = dict.fromkeys({"u"} & set(model.state_names), speed)
    trim: float = 0.0
    notes: list[str] = []
    if approach == "neutral":
        trim, start, notes = _approach(model, steered, start)
    notes += _unsteady(model, steered, trim, start)
    orders = [
        # A circle's rudder is counted from amidships, wherever the approach had it.
        TurningCircle(steered, sign * rudder - trim, rate=rate, trim=trim)
        for sign in (1.0, -1.0)
    ]
    turns = _Turner(tracked, table, start).turns(orders, wanted)
    unfinished = {name: sum(one is None for one in members) for name, members in turns.items()}
    empty = dict.fromkeys(QUANTITIES, math.nan)
    known = {name: [one or empty for one in members] for name, members in turns.items()}
    return TurningPrediction(
        model.name, rudder, speed, length, {name: known[name][0] for name in wanted},
        {
            name: {q: np.array([one[q] for one in members[1:]]) for q in QUANTITIES}
            for name, members in known.items()
        },
        unfinished, trim, "" if fit is None else fit.caveat, tuple(notes),
    )  # fmt: skip


def _check(
    wanted: Sequence[str],
    approach: str,
    speed: float,
    rudder: float,
    length: float | None,
    rate: float | None,
    n_draws: int,
) -> None:
    """Refuse words and numbers that no turn has."""
    if not set(wanted) <= set(SIDES):
        raise ModelError(f"side is {wanted[0]!r}. Choose starboard, port or both.")
    check_choice("approach", approach, ("neutral", "amidships"))
    check_count("n_draws", n_draws, 0)
    owner = "The turning circle"
    positive(owner, "speed", speed, "Give the approach speed in m/s.")
    positive(owner, "rudder", rudder)
    if rudder > math.pi / 2:
        raise ModelError(
            f"rudder is {rudder:g}, an angle in rad of at most a quarter of a turn. If these are "
            f"degrees, give math.radians({rudder:g}), which is {math.radians(rudder):.2g}."
        )
    optional(above_zero("Give the length of the ship in m, or None."))(owner, "length", length)
    optional(above_zero("Give rad/s, or None for a rudder that jumps."))(owner, "rate", rate)


def _approach(
    model: Model, steered: str, start: Mapping[str, float]
) -> tuple[float, dict[str, float], list[str]]:
    """Neutral rudder and states of a straight course, and what it is not, in a sentence.

    Amidships where there is no such course nearby.
    """
    turning = [name for name in TURNING if name in model.state_names]
    held = {"psi": 0.0, **start} | dict.fromkeys({"r"}.intersection(turning), 0.0)
    if not turning:
        return 0.0, dict(start), []
    try:
        found = equilibrium(model, fixed=held, free=(steered,), steady=turning)
        trim = found.inputs[steered]
        why = ""
        if not found.ok:
            why = "no rudder angle was found that keeps a course."
        elif abs(trim) > NEAR_AMIDSHIPS:
            why = (
                f"a course takes {math.degrees(trim):.1f} deg, which is beyond the "
                f"{math.degrees(NEAR_AMIDSHIPS):g} deg of a neutral rudder."
            )
    except SimulationError as error:
        why = str(error)
    if why:
        begins = "The approach begins with the rudder amidships and is not straight"
        return 0.0, dict(start), [f"{begins}: {why}"]
    return trim, {name: found.states[name] for name in model.state_names if name != "psi"}, []


def _unsteady(model: Model, steered: str, trim: float, start: Mapping[str, float]) -> list[str]:
    """A sentence about a speed of approach that the propulsion does not keep."""
    if "u" not in model.state_names:
        return []
    held = {name: start.get(name, 0.0) for name in ("psi", *TURNING) if name in model.state_names}
    added = model.all_state_names[len(model.states) :]
    try:
        found = equilibrium(
            model, inputs={steered: trim}, fixed=held, steady=("u", *added), guess=start
        )
    except SimulationError:
        return []
    speed, kept = start["u"], found.states["u"]
    if found.ok and abs(kept - speed) <= IMMATERIAL * speed:
        return []
    runs = f"the ship keeps {kept:.3g} m/s" if found.ok else "no speed is kept"
    return [
        f"The approach at {speed:.3g} m/s is not steady: with this propulsion {runs} on a straight "
        "course. Speed ratio, times and lengths hold that change of speed."
    ]


def _rudder_input(model: Model) -> str:
    if len(model.inputs) != 1:
        raise ModelError(
            f"Model {model.name!r} has the inputs {listed(model.input_names)}; a "
            "turning circle needs a model with the rudder as its only input. Fix the others at "
            "their values by replacing them with parameters."
        )
    return model.input_names[0]


def _with_track(model: Model, speed: float) -> Model:
    """Return the model with its track as states and ideal sensors for them."""
    if "psi" not in model.state_names:
        raise ModelError(f"Model {model.name!r} has no state 'psi'. A turn is told by its heading.")
    surge = "u" if "u" in model.state_names else f"{speed!r}"
    sway = "v" if "v" in model.state_names else "0"
    track = {
        "track_north": f"{surge}*cos(psi) - {sway}*sin(psi)",
        "track_east": f"{surge}*sin(psi) + {sway}*cos(psi)",
    }
    return replace(
        model,
        states=(*model.states, *(State(name, "m", scale=10.0) for name in track)),
        kinematics={**model.kinematics, **track},
        outputs=(
            *(Output(name, "m") for name in track),
            Output("heading", "rad", expression="psi"),
            Output("speed", "m/s", expression=f"sqrt({surge}*{surge} + {sway}*{sway})"),
        ),
        effects=tuple(effect for effect in model.effects if effect.stage != "sensor"),
    )


@dataclass(frozen=True, eq=False)
class _Turner:
    """A model with its track, a table of its parameters, and the start of every turn."""

    model: Model
    table: np.ndarray
    start: Mapping[str, float]

    def turns(
        self, orders: Sequence[TurningCircle], wanted: Sequence[str]
    ) -> dict[str, list[dict[str, float] | None]]:
        """Quantities of all parameter sets by the side that is reached, of the wanted ones."""
        turns: dict[str, list[dict[str, float] | None]] = {}
        for order in orders:
            times, paths = self.turned(order)
            # Signs of rudders differ from log to log; the heading says to which side it turned.
            reached = "starboard" if paths[0, -1, 2] > paths[0, 0, 2] else "port"
            if reached not in {*wanted} - turns.keys():
                continue
            if len(self.table) > 1:
                # Slower draws need longer than the fitted values do.
                times, paths = self.paths(order, 1.5 * times[-1], len(self.table))
            turns[reached] = [_quantities(times, path) for path in paths]
            if turns[reached][0] is None:
                raise SimulationError(
                    f"Model {self.model.name!r} does not turn by 180 degrees to {reached}."
                )
        if missing := [name for name in wanted if name not in turns]:
            raise ModelError(
                f"Model {self.model.name!r} turns to the same side with either rudder; nothing "
                f"turns it to {missing[0]}. Check the sign and the size of its rudder force."
            )
        return turns

    def turned(self, order: TurningCircle) -> tuple[np.ndarray, np.ndarray]:
        """Simulate long enough for a turn of one and a half circles, if there is one."""
        horizon = 100 * self.model.step
        for _ in range(12):  # each twice as long, until the heading has changed by TURN
            times, paths = self.paths(order, horizon, 1)
            if not np.isfinite(paths).all():
                raise SimulationError(
                    f"Model {self.model.name!r} diverges in the turn, {order.describe()}. Its "
                    "terms may not hold at this drift and yaw rate: see the range of the records "
                    "it was fitted to."
                )
            if abs(paths[0, -1, 2] - paths[0, 0, 2]) > TURN:
                break
            horizon *= 2.0
        return times, paths

    def paths(self, order: TurningCircle, duration: float, n: int) -> tuple[np.ndarray, np.ndarray]:
        """Simulate the first ``n`` rows of the table, two samples a step."""
        times = np.arange(0.0, duration, 0.5 * self.model.step)
        inputs = {order.input: order.waveform()(times)}
        return times, simulate_batch(
            self.model, times, inputs=inputs, values=self.table[:n], initials=self.start
        )


def _quantities(times: np.ndarray, path: np.ndarray) -> dict[str, float] | None:
    """Return the quantities of one turn, None if it has no tactical diameter."""
    if not np.isfinite(path).all():
        return None
    north, east, heading, speed = path.T
    try:
        indices: TurningIndices = turning_indices(times, north, east, heading, speed=speed)
    except DataError:
        return None
    names = {name: name for name in QUANTITIES} | {"speed_ratio": "steady_speed_ratio"}
    found = {name: getattr(indices, index) for name, index in names.items()}
    return {name: math.nan if value is None else float(value) for name, value in found.items()}
