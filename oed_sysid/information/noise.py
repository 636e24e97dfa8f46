r"""Measurement noise before there are residuals.

How rough the sea is: disturbance forces before anybody has measured them.

A word stands for forces that, within their time :math:`\tau`, would on their own move each
velocity by a share :math:`\kappa` of what a reference manoeuvre moves it by:

.. math:: \sigma_j =
    \frac{\kappa\; \mathrm{rms}(x_j - \bar x_j)}{\tau\; \partial \dot x_j/\partial w_j}

with :math:`\kappa` of 1, 5 and 15 per cent for *calm*, *moderate* and *rough*. Waves of a period
:math:`T` have :math:`T/2\pi` in the place of :math:`\tau`, within which a harmonic force moves a
velocity by as much: accuracy needs their level, period, width and shape. This compares the
sea with the manoeuvre and knows nothing of wave heights; a swell of some height is translated by
:mod:`oed_sysid.information.swell`. A fit of an earlier record, whose levels are estimated, is
better wherever there is one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import degrees

import numpy as np

from oed_sysid.errors import DesignError, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate_inputs, trajectory_of
from oed_sysid.information.response import Levels
from oed_sysid.information.swell import Swell
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

    Raises
    ------
    DesignError
        If a level is missing or not positive.
    """
    names = model.output_names
    stds: dict[str, float | None] = {o.name: o.noise_std for o in model.outputs}
    stds |= {**_by_output(model, levels), **(changed or {})}
    for name, std in stds.items():
        if std is None or not (np.isfinite(std) and std > 0):
            raise DesignError(
                f"The noise of {name!r} is {std}. Accuracy cannot be predicted without it: give "
                f"Output(noise_std=...) or noise={{{name!r}: standard deviation}}."
            )
    return np.array([stds[name] for name in names], dtype=float)


def _by_output(model: Model, levels: Levels) -> Mapping[str, float]:
    """Levels by output; none where none are given."""
    names = model.output_names
    if levels is None or isinstance(levels, Mapping):
        located(DesignError, f"Model {model.name!r} has no output", levels or {}, names)
        return levels or {}
    given = np.asarray(levels, dtype=float)
    if given.shape != (len(names),):
        raise DesignError(
            f"There are {given.size} noise levels for the outputs {', '.join(names)}. "
            "Give one each."
        )
    return dict(zip(names, given.tolist(), strict=True))


SEAS = {"still": 0.0, "calm": 0.01, "moderate": 0.05, "rough": 0.15}
# Correlation time of first-order forces when none is given, s; longer where samples are rare.
USUAL_TIME = 2.0
# Relative width of waves of which only the period is given, about that of swell.
USUAL_WIDTH = 0.2
# Shortest time in samples: forces faster than that are white noise to a record.
_SHORTEST = 4.0
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def sea_noise(
    model: Model,
    sea: str,
    reference: Iterable[Experiment],
    *,
    time: float | None = None,
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
        the correlation time, s; ``period=8`` makes it waves of that period, s, of a relative
        ``bandwidth`` of 0.2 unless ``bandwidth=0.3`` says another. ``swell=0.3m,8s,030deg`` is a
        swell of that significant height and peak period that comes from there, clockwise from
        the bow (:mod:`oed_sysid.information.swell`); ``fit.json`` takes the forces of a saved fit.
    reference : iterable of Experiment
        What words are compared with: the manoeuvre that moves a velocity most counts.
    time : float, optional
        Correlation time where ``sea`` says nothing, s; 2 s or four samples, whichever is longer.
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
    white = noise_of(model)
    calm = NoiseModel.white_only(white, model.output_names)
    if sea.startswith("swell="):
        swell = Swell.of(sea, {"bandwidth": USUAL_WIDTH, **(sizes or {})})
        return replace(calm, seas=(swell.sea(model, tuple(runs) or known),))
    if sea.lower().endswith(".json"):
        return _of_fit(calm, model, sea)
    return _in_words(calm, model, sea, known, time)


def _in_words(
    calm: NoiseModel,
    model: Model,
    sea: str,
    known: tuple[Experiment, ...],
    time: float | None,
) -> NoiseModel:
    """The sensors' noise with the forces of a word, or of levels by equation."""
    word, given = _understood(sea)
    wave, width = given.pop("period", None), given.pop("bandwidth", USUAL_WIDTH)
    usual = _usual_time(known) if time is None else time
    lasting = given.pop("time", usual) if wave is None else wave / (2.0 * np.pi)
    _check_stated(sea, word, given, lasting)
    if word is not None and SEAS[word] == 0.0:
        return calm
    found, levels = _acting(model, word, given, known, lasting)
    if wave is not None:
        named = dict(zip((place.name for place in found), map(float, levels), strict=True))
        waves = Sea(period=wave, bandwidth=width, levels=named)
        return replace(calm, seas=(waves,))
    places = tuple(place.name for place in found)
    times = np.full(len(levels), lasting)
    return replace(calm, force=levels, force_time=times, places=places)


def _check_stated(sea: str, word: str | None, given: Mapping[str, float], lasting: float) -> None:
    """Refuse levels below zero, no time, and a word beside levels."""
    if not lasting > 0 or any(level < 0 for level in given.values()):
        raise DesignError(f"The sea {sea!r} has a level below zero or no time. Correct it.")
    if word is not None and given:
        raise DesignError(f"Give the sea as a word or as levels, not both: {sea!r}.")


def _of_fit(calm: NoiseModel, model: Model, path: str) -> NoiseModel:
    """The sensors' noise with the forces that a saved fit has estimated."""
    fit = Fit.load(path)
    found = fit.noise
    if found is None or not found.has_forces:
        raise DesignError(
            f"The fit {path!r} found no disturbance forces. Say still, or take the fit of a record "
            "in such a sea."
        )
    acting = tuple(found.only(found.force > 0).places)
    chosen_places(model, (*acting, *(place for sea in found.seas for place in sea.places)))
    forces = found.only(found.force > 0)
    return replace(
        calm, force=forces.force, force_time=forces.force_time, places=forces.places,
        seas=tuple(sea for sea in found.seas if sea.acts),
    )  # fmt: skip


def _usual_time(runs: Iterable[Experiment]) -> float:
    return max([USUAL_TIME, *(_SHORTEST * run.sample_time for run in runs)])


def _acting(
    model: Model,
    word: str | None,
    given: Mapping[str, float],
    runs: tuple[Experiment, ...],
    lasting: float,
) -> tuple[tuple[Place, ...], np.ndarray]:
    """Where forces act and their levels: those given, or of a word."""
    if word is None:
        return chosen_places(model, tuple(given)), np.array([*given.values()], dtype=float)
    found = chosen_places(model, "all")
    return found, SEAS[word] * natural_forces(model, found, runs) / lasting


def _understood(sea: str) -> tuple[str | None, dict[str, float]]:
    """Word of a sea, if it begins with one, and what is assigned in it."""
    parts = [part.strip() for part in sea.split(",") if part.strip()]
    word = parts.pop(0) if parts and "=" not in parts[0] else None
    if word is not None and word not in SEAS:
        raise DesignError(
            f"The sea {sea!r} is not understood. Say {', '.join(SEAS)}, levels by equation such as "
            "Z=0.3,M=0.06,time=2, a swell such as swell=0.3m,8s,030deg, or the file of a fit."
        )
    given = {}
    for part in parts:
        name, equals, number = map(str.strip, part.partition("="))
        if not (equals and name and _NUMBER.fullmatch(number)):
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
    still = after_a_step(np.zeros(n))
    moved = np.array([after_a_step(unit) for unit in np.eye(n)])
    answer = np.abs(np.diag(moved - still)) / model.step
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
    """
    parts = [
        f"{place.removeprefix('force ')} {level:.3g}"
        for place, level in zip(noise.places, noise.force, strict=True)
        if level > 0
    ]
    said = []
    if parts:
        times = np.unique(noise.force_time[noise.force > 0].round(6))
        said.append(f"{', '.join(parts)} over {', '.join(f'{t:.3g}' for t in times)} s")
    for sea in noise.seas:
        levels = zip(sea.places, sea.level, strict=True)
        listed = ", ".join(f"{p.removeprefix('force ')} {v:.3g}" for p, v in levels if v > 0)
        if listed:
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
