r"""Measurement noise before there are residuals.

How rough the sea is: disturbance forces before anybody has measured them.

A word stands for forces that, within their time :math:`\tau`, would on their own move each
velocity by a share :math:`\kappa` of what a reference manoeuvre moves it by:

.. math:: \sigma_j =
    \frac{\kappa\; \mathrm{rms}(x_j - \bar x_j)}{\tau\; \partial \dot x_j/\partial w_j}

with :math:`\kappa` of 1, 5 and 15 per cent for *calm*, *moderate* and *rough*. Waves of a period
:math:`T` have :math:`T/2\pi` in the place of :math:`\tau`, within which a harmonic force moves a
velocity by as much: accuracy needs their level, period, width and shape. This compares the sea with
the manoeuvre and knows nothing of wave heights. A fit of an earlier record, whose levels are
estimated, is better wherever there is one.

**Forces of a swell** from its significant height, its period and where it comes from
(:class:`Swell`). Waves that are long against the cross-section of a hull carry it along as they
carry the water in its place: the force is that of the displaced and the added mass in the water's
acceleration :math:`a` (Taylor's formula), and what the model's own hull and restoring forces
:math:`f` make of the water's velocity :math:`v` and of its slope and rise :math:`\eta`, taken
relative to it,

.. math:: F = M a - \frac{\partial f}{\partial v} v - \frac{\partial f}{\partial \eta} \eta ,

with the inertia :math:`M` of the model, which holds the displaced mass since a vehicle floats or is
neutrally buoyant. Linear deep-water waves of the angular frequency :math:`\omega` and amplitude one
that run towards :math:`\chi` from the bow move the water at the mean depth :math:`h`, averaged over
the length :math:`L`, by

.. math::
    (u, v, w) &= \omega\, e^{-k h} \frac{\sin s}{s}\, (\cos\chi, \sin\chi, -i), \qquad
    k = \omega^2 / g, \quad s = \tfrac12 k L \cos\chi \\
    (p, q, r) &= \omega\, e^{-k h} \left(-k \sin\chi\, \frac{\sin s}{s},\;
    G k \cos\chi,\; -i\, G k \cos\chi \sin\chi\right), \qquad
    G = \frac{3 (\sin s - s \cos s)}{s^3}

Angular rates are those of the straight line through the velocities along the length that is
nearest in least squares. With :math:`H_s = 4\sigma` a level is :math:`|F| H_s / 4`. At the speed
:math:`U` waves are met at :math:`\omega - k U \cos\chi`.

It leaves out: diffraction by hulls that are no longer small against the waves (length over five
beams at least), damping by the water's rotation, shallow water, and that the forces of one wave
belong together: every equation gets a draw of its own. A fit of a record in such waves knows more.

References
----------
G. I. Taylor, The forces on a body placed in a curved or converging stream of fluid, *Proc. Royal
Society A* 120 (1928) 260-283. J. N. Newman, *Marine hydrodynamics*, MIT Press (1977), sections 4.17
and 6.4. O. M. Faltinsen, *Sea loads on ships and offshore structures* (1990), chapters 2 and 3.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from math import cos, degrees, exp, pi, radians, sin
from typing import Any

import numpy as np
from scipy.constants import g as GRAVITY

from oed_sysid.errors import DesignError, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate_inputs, trajectory_of
from oed_sysid.experiments.steady import Equilibrium, linearise
from oed_sysid.information.response import SAYS, Levels, acting
from oed_sysid.likelihood.between_records import FEWEST
from oed_sysid.likelihood.disturbances import Place, chosen_places, with_disturbance_inputs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.physics.model import Model


def noise_of(
    model: Model,
    levels: Levels = None,
    *,
    changed: Mapping[str, float] | None = None,
) -> np.ndarray:
    """Return the standard deviations of the noise of a model's outputs, ``(n_outputs,)``.

    Parameters
    ----------
    model : Model
        Its outputs' ``noise_std`` are the levels unless others are given.
    levels : mapping or sequence of float, optional
        Standard deviations, by output or in the outputs' order.
    changed : mapping of str to float, optional
        Levels of a single experiment.

    Returns
    -------
    ndarray (n_outputs,)
        In the outputs' units.

    Raises
    ------
    DesignError
        If a level is missing or not positive.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> noise_of(load_problem("nomoto_sparse_heading").model, {"psi": 0.01})
    array([0.01])
    """
    stds: dict[str, float | None] = {o.name: o.noise_std for o in model.outputs}
    stds |= {**_by_output(model, levels), **(changed or {})}
    for name, std in stds.items():
        if std is None or not (np.isfinite(std) and std > 0):
            raise DesignError(SAYS["no_noise"].format(name=name, std=std))
    return np.array([stds[name] for name in model.output_names], dtype=float)


def _by_output(model: Model, levels: Levels) -> Mapping[str, float]:
    """Levels by output; none where none are given."""
    names = model.output_names
    if levels is None or isinstance(levels, Mapping):
        located(DesignError, f"Model {model.name!r} has no output", levels or {}, names)
        return levels or {}
    given = np.asarray(levels, dtype=float)
    if given.shape != (len(names),):
        raise DesignError(SAYS["noise_levels"].format(given=given, names=", ".join(names)))
    return dict(zip(names, given.tolist(), strict=True))


SEAS = {"still": 0.0, "calm": 0.01, "moderate": 0.05, "rough": 0.15}
# Correlation time of first-order forces when none is given, s; longer where samples are rare.
USUAL_TIME = 2.0
# Relative width of waves of which only the period is given, about that of swell.
USUAL_WIDTH = 0.2
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def sea_noise(
    model: Model,
    sea: str,
    reference: Iterable[Experiment],
    *,
    runs: Sequence[Experiment] = (),
    sizes: Mapping[str, float | None] | None = None,
) -> NoiseModel:
    """Return the noise of a model's sensors, and disturbance forces of a sea.

    Parameters
    ----------
    model : Model
        Its outputs' ``noise_std`` are the white levels.
    sea : str
        ``still`` (no forces), ``calm``, ``moderate``, ``rough``; or levels by equation,
        ``"Z=0.3,M=0.06"`` in N, N m or the state's unit per second. ``time=5`` after either sets
        the correlation time, s (else 2 s or four samples, whichever is longer); ``period=8`` makes
        it waves of that period, s, of a relative ``bandwidth`` of 0.2 unless ``bandwidth=0.3`` says
        another. ``swell=0.3m,8s,030deg`` is a swell of that significant height and peak period that
        comes from there, clockwise from the bow (:class:`Swell`); ``fit.json`` takes the forces of
        a saved fit.
    reference : iterable of Experiment
        What words are compared with: the manoeuvre that moves a velocity most counts.
    runs : sequence of Experiment
        What will meet a swell; by default those of the reference.
    sizes : mapping of str to float, optional
        ``length`` and ``draught`` of the vehicle for a swell, m.

    Returns
    -------
    NoiseModel

    Raises
    ------
    DesignError
        If the words are not understood.

    Examples
    --------
    >>> from oed_sysid import Experiment, Input, Model, Output, Parameter, State
    >>> from oed_sysid.experiments.manoeuvres import Doublet
    >>> nomoto = Model(
    ...     "Nomoto", (State("r", "rad/s"),), (Input("rudder", "rad"),),
    ...     (Output("r", "rad/s", noise_std=1e-3),), {"r": "(K*rudder - r)/T"},
    ...     parameters=(Parameter("K", 0.1, "1/s"), Parameter("T", 10.0, "s")),
    ... )
    >>> test = Experiment("doublet", Doublet("rudder", 0.2, pulse_time=20.0), duration=80.0)
    >>> noise = sea_noise(nomoto, "moderate", [test])
    >>> noise.places, noise.force.round(5), noise.force_time
    (('force r',), array([0.00022]), array([2.]))
    """
    known = tuple(reference)
    calm = NoiseModel.white_only(noise_of(model), model.output_names)
    if sea.startswith("swell="):
        swell = Swell.of(sea, {"bandwidth": USUAL_WIDTH, **(sizes or {})})
        return replace(calm, seas=(swell.sea(model, tuple(runs) or known),))
    if sea.lower().endswith(".json"):
        return _of_fit(calm, model, sea)
    return _in_words(calm, model, sea, known)


def _in_words(
    calm: NoiseModel,
    model: Model,
    sea: str,
    known: tuple[Experiment, ...],
) -> NoiseModel:
    """The sensors' noise with the forces of a word, or of levels by equation."""
    word, given = _understood(sea)
    wave, width = given.pop("period", None), given.pop("bandwidth", USUAL_WIDTH)
    # Forces faster than the fewest samples of a period are white noise to a record.
    usual = max([USUAL_TIME, *(FEWEST * run.sample_time for run in known)])
    lasting = given.pop("time", usual) if wave is None else wave / (2.0 * np.pi)
    if not lasting > 0 or any(level < 0 for level in given.values()):
        raise DesignError(f"The sea {sea!r} has a level below zero or no time. Correct it.")
    if word is not None and given:
        raise DesignError(f"Give the sea as a word or as levels, not both: {sea!r}.")
    if word is not None and SEAS[word] == 0.0:
        return calm
    found = chosen_places(model, tuple(given) if word is None else "all")
    levels = np.array([*given.values()], dtype=float)
    if word is not None:
        levels = SEAS[word] * natural_forces(model, found, known) / lasting
    places = tuple(place.name for place in found)
    if wave is not None:
        named = dict(zip(places, levels.tolist(), strict=True))
        return replace(calm, seas=(Sea(period=wave, bandwidth=width, levels=named),))
    return replace(calm, force=levels, force_time=np.full(len(levels), lasting), places=places)


def _of_fit(calm: NoiseModel, model: Model, path: str) -> NoiseModel:
    """The sensors' noise with the forces that a saved fit has estimated."""
    if (found := Fit.load(path).noise) is None or not found.has_forces:
        raise DesignError(SAYS["no_forces_found"].format(path=path))
    found = acting(model, found)
    return replace(found, white=calm.white, colour=calm.colour, colour_time=calm.colour_time,
                   outputs=calm.outputs)  # fmt: skip


def _understood(sea: str) -> tuple[str | None, dict[str, float]]:
    """Word of a sea, if it begins with one, and what is assigned in it."""
    parts = [part.strip() for part in sea.split(",") if part.strip()]
    word = parts.pop(0) if parts and "=" not in parts[0] else None
    if word is not None and word not in SEAS:
        raise DesignError(SAYS["no_sea"].format(sea=sea, words=", ".join(SEAS)))
    given = {}
    for part in parts:
        name, _, number = map(str.strip, part.partition("="))
        if not (name and _NUMBER.fullmatch(number)):
            raise DesignError(f"{part!r} in the sea {sea!r} is not understood. Write NAME=NUMBER.")
        given[name] = float(number)
    return word, given


def natural_forces(
    model: Model, found: tuple[Place, ...], runs: tuple[Experiment, ...]
) -> np.ndarray:
    """Forces that in one second would move each velocity by what manoeuvres move it.

    Returns
    -------
    ndarray (n_places,)
    """
    if not runs:
        raise DesignError("A sea in words is compared with a manoeuvre. Give one, or levels.")
    states = [model.axes.get(p.signal, p.signal) for p in found]
    nominal = [trajectory_of(model, run) for run in runs]
    # The run that moves a velocity most is what a sea has to compete with.
    motion = np.max([[np.std(run.signal(n)) for n in states] for run in nominal], axis=0)
    first = nominal[0]
    wide, n = with_disturbance_inputs(model, found), len(found)

    def after_a_step(forces: np.ndarray) -> np.ndarray:
        commands = np.tile([*first.inputs[0], *forces], (2, 1))
        run = simulate_inputs(wide, [0.0, model.step], inputs=commands, initial=own)
        return np.array([run.signal(name)[1] for name in states])

    # One short step with and without each unit force: d x'/d w without asking for the masses.
    own = first.states[0, : len(model.states)]
    moved = np.array([after_a_step(unit) for unit in np.eye(n)])
    answer = np.abs(np.diag(moved - after_a_step(np.zeros(n)))) / model.step
    if not np.all(answer > 0):
        blind = found[int(np.argmin(answer))].name
        raise DesignError(f"A random {blind} moves nothing in model {model.name!r}. Give levels.")
    return motion / answer


def sea_words(noise: NoiseModel) -> str:
    """Return levels and times of the disturbance forces in words.

    >>> quiet = NoiseModel.white_only(np.ones(1))
    >>> sea_words(quiet)
    'none'
    >>> sea_words(replace(quiet, seas=(Sea(period=8.0, bandwidth=0.2, levels={"Z": 0.3}),)))
    'Z 0.3 in waves of 8 s, 20 % wide'
    >>> waves = Sea(period=7.2, bandwidth=0.2, levels={"Z": 0.3}, height=0.3, direction=-0.5236)
    >>> sea_words(replace(quiet, seas=(waves,)))  # doctest: +NORMALIZE_WHITESPACE
    'Z 0.3 in swell of 0.3 m from 30 deg to port of the bow at the start, met every 7.2 s, 20 %
    wide'

    Returns
    -------
    str
    """

    def levels(source: NoiseModel | Sea, sizes: Iterable[float]) -> str:
        each = zip(source.places, sizes, strict=True)
        return ", ".join(f"{p.removeprefix('force ')} {v:.3g}" for p, v in each if v > 0)

    said = []
    if listed := levels(noise, noise.force):
        times = np.unique(noise.force_time[noise.force > 0].round(6))
        said.append(f"{listed} over {', '.join(f'{t:.3g}' for t in times)} s")
    for sea in noise.seas:
        if listed := levels(sea, sea.level):
            width = 100.0 * float(sea.bandwidth or 0.0)
            said.append(f"{listed} in {_waves(sea)}, {width:.2g} % wide")
    return "; ".join(said) or "none"


def _waves(sea: Sea) -> str:
    if sea.height is None or sea.direction is None:
        return f"waves of {sea.period:.3g} s"
    swell = f"swell of {sea.height:.3g} m from {bearing(sea.direction)} at the start"
    return f"{swell}, met every {sea.period:.3g} s"


def bearing(direction: float) -> str:
    """Return from where waves come, rad clockwise from the bow, as people on board say it.

    >>> bearing(0.0), bearing(np.radians(330.0)), bearing(np.pi)
    ('ahead', '30 deg to port of the bow', 'astern')
    """
    angle = round((degrees(direction) + 180.0) % 360.0 - 180.0)
    if angle in (0, -180):
        return "astern" if angle else "ahead"
    return f"{abs(angle)} deg to {'starboard' if angle > 0 else 'port'} of the bow"


_VELOCITIES = ("u", "v", "w")
_RATES = ("p", "q", "r")
_FORM = "swell=0.3m,8s,030deg"
_QUANTITY = re.compile(r"([-+]?[\d.]+)\s*(m/s|m|s|deg|)")


@dataclass(frozen=True)
class Swell:
    """A swell as people state it, and what its forces depend on besides.

    Parameters
    ----------
    height : float
        Significant height, m.
    period : float
        Of the peak, s.
    direction : float
        From where it comes, clockwise from the bow when a run begins, rad.
    bandwidth : float
        See :class:`~oed_sysid.likelihood.noise_model.Sea`.
    length, draught, speed : float, optional
        Of the vehicle, m and m/s, where neither model nor runs tell.
    """

    height: float
    period: float
    direction: float
    bandwidth: float
    length: float | None = None
    draught: float | None = None
    speed: float | None = None

    def __post_init__(self) -> None:
        sizes = (self.height, self.period, self.length, self.draught)
        if not all(size is None or size > 0 for size in sizes):
            raise DesignError(f"{self} has a size that is not above zero. Correct it.")

    @classmethod
    def of(cls, text: str, known: Mapping[str, float | None]) -> Swell:
        """Return the swell of ``swell=0.3m,8s,030deg``, followed by ``length=7`` and the like.

        Parameters
        ----------
        text : str
        known : mapping of str to float
            What counts where ``text`` says nothing; the bandwidth at least.

        Examples
        --------
        >>> found = Swell.of("swell=0.3m,8s,030deg,length=7", {"bandwidth": 0.2})
        >>> found.height, found.period, round(found.direction, 3), found.length
        (0.3, 8.0, 0.524, 7.0)
        """
        first, *rest = (part.strip() for part in text.removeprefix("swell=").split(","))
        given: dict[str, Any] = dict(known)
        by_unit = {"m": "height", "s": "period", "deg": "direction"}
        more = {"bandwidth": "", "length": "m", "draught": "m", "speed": "m/s"}
        for part in (first, *rest):
            name, _, words = part.rpartition("=")
            found = _QUANTITY.fullmatch(words.strip())
            unit = found[2] if found else None
            key = name.strip() if name else by_unit.get(unit or "", "")
            fits = unit in ("", more.get(key)) if name else bool(key)
            if found is None or not fits or (name and key not in more):
                raise DesignError(
                    f"{part!r} in the sea {text!r} is not understood. Write {_FORM}: significant "
                    "height, peak period, and from where it comes, clockwise from the bow; then "
                    f"what else is known of {', '.join(more)}, such as length=7."
                )
            given[key] = float(found[1])
        if missing := [f"its {key}, in {u}" for u, key in by_unit.items() if key not in given]:
            raise DesignError(f"The sea {text!r} lacks {' and '.join(missing)}. Write {_FORM}.")
        return cls(**{**given, "direction": radians(given["direction"])})

    def sea(self, model: Model, runs: Sequence[Experiment]) -> Sea:
        """Return its narrow-band forces on a model in the equations in which forces may act.

        Parameters
        ----------
        model : Model
        runs : sequence of Experiment
            The mean speed and depth of their nominal motion count, and the commands of the first.

        Raises
        ------
        DesignError
            If length, draught or speed are known neither from the model nor from the runs, or an
            equation is that of no velocity.
        """
        place = chosen_places(model, "all")
        axes = [model.axes.get(one.signal, one.signal) for one in place]
        if unknown := [name for name in axes if name not in (*_VELOCITIES, *_RATES)]:
            raise DesignError(SAYS["waves_on_other_axes"].format(model=model, unknown=unknown))
        straight, commands = _straight(model, runs)
        if (speed := straight.get("u")) is None:
            speed = self._known(model, "speed", self.speed, "speed=1.5")
        if not (depth := straight.get("z", 0.0)) > 0:
            depth = 0.5 * self._known(model, "draught", self.draught, "draught=0.4")
        water = self._water(self._known(model, "length", self.length, "length=7"), depth)
        wide = with_disturbance_inputs(model, place)
        given = [*map(float, commands), *(0.0 for _ in place)]
        point = dict(zip(wide.input_names, given, strict=True))
        linear = linearise(wide, Equilibrium(straight, point, {}, (), (), True, "straight ahead"))
        states = list(linear.state_labels)
        # What the water does to each state, and which of them the forces take relative to it.
        moved = {name: water.get(name, 0.0) for name in states if name not in _RATES}
        rows = [states.index(name) for name in axes]
        rate = np.array([2j * pi / self.period * water[name] for name in axes])
        rate -= np.asarray(linear.A)[rows] @ np.array([moved.get(name, 0.0) for name in states])
        by_force = np.asarray(linear.B)[rows, len(model.inputs) :]
        level = np.abs(np.linalg.solve(by_force, rate)) * self.height / 4.0
        # What is nothing by symmetry is nothing but for rounding.
        dust = 1e-12 * float(level.max(initial=0.0))
        acting = {p.name: float(one) for p, one in zip(place, level, strict=True) if one > dust}
        return Sea(
            self._met(speed), self.bandwidth, acting, height=self.height, direction=self.direction
        )

    def _met(self, speed: float) -> float:
        """Period at which a vehicle meets the waves, s."""
        omega = 2.0 * pi / self.period
        met = abs(omega - omega**2 / GRAVITY * speed * cos(self.direction + pi))
        if not met > 1e-9 * omega:
            raise DesignError(SAYS["as_fast_as_waves"].format(self, speed=speed))
        return 2.0 * pi / met

    def _water(self, length: float, depth: float) -> dict[str, complex]:
        """Motion of the water by state for waves of amplitude one."""
        omega, k = 2.0 * pi / self.period, (2.0 * pi / self.period) ** 2 / GRAVITY
        ahead, across = -cos(self.direction), -sin(self.direction)
        along = k * ahead
        s = 0.5 * along * length
        mean = float(np.sinc(s / pi))
        # The series near zero, where the quotient loses its digits.
        slope = 3.0 * (sin(s) - s * cos(s)) / s**3 if abs(s) > 1e-2 else 1.0 - s**2 / 10.0
        size = omega * exp(-k * depth)
        found: dict[str, complex] = {
            "u": size * mean * ahead,
            "v": size * mean * across,
            "w": -1j * size * mean,
            "p": -size * mean * k * across,
            "q": size * slope * along,
            "r": -1j * size * slope * along * across,
        }
        # Displacements: slope of the surface and its rise.
        pairs = {"phi": "p", "theta": "q", "z": "w"}
        return found | {name: found[rate] / (1j * omega) for name, rate in pairs.items()}

    def _known(self, model: Model, what: str, given: float | None, example: str) -> float:
        """A size of the vehicle: said, or a constant of the model that is described as such."""
        if given is not None:
            return given
        for one in model.all_parameters:
            if one.fixed and one.description.startswith(what):
                return one.value
        raise DesignError(
            f"A height of waves becomes forces with the vehicle's {what}, which neither problem "
            f"nor model {model.name!r} states. Add it to the sea: {_FORM},{example}; or give "
            "levels by equation, or the fit of a record in such waves."
        )


def _straight(model: Model, runs: Sequence[Experiment]) -> tuple[dict[str, float], np.ndarray]:
    """State straight ahead at the mean speed and depth of the nominal motion; first commands."""
    nominal = [trajectory_of(model, run) for run in runs]
    mean = {
        name: float(np.mean([run.signal(name).mean() for run in nominal])) * (name in ("u", "z"))
        for name in nominal[0].state_names
    }
    return mean, nominal[0].inputs[0]
