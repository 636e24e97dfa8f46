r"""How rough the sea is: random forces before anybody has measured them.

A word stands for forces that, within their time :math:`\tau`, would on their own move each
velocity by a share :math:`\kappa` of what a reference manoeuvre moves it by:

.. math:: \sigma_j =
    \frac{\kappa\; \mathrm{rms}(x_j - \bar x_j)}{\tau\; \partial \dot x_j/\partial w_j}

with :math:`\kappa` of 1, 5 and 15 per cent for *calm*, *moderate* and *rough*. This compares the
sea with the manoeuvre and knows nothing of wave heights: a fit of an earlier record, whose levels
are estimated, is better wherever there is one.
"""

from __future__ import annotations

import re
from collections.abc import Iterable

import numpy as np

from oed_sysid.errors import DesignError
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.filtered import disturbed_model
from oed_sysid.model import Model
from oed_sysid.noise.disturbances import Place, chosen_places, disturbance
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity.noise import noise_of
from oed_sysid.sensitivity.response import plays
from oed_sysid.simulation import simulate_inputs

SEAS = {"still": 0.0, "calm": 0.01, "moderate": 0.05, "rough": 0.15}
USUAL_TIME = 2.0
# Shortest time in samples: forces faster than that are white noise to a record.
_SHORTEST = 4.0
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?")


def sea_noise(
    model: Model, sea: str, reference: Iterable[Experiment], *, time: float | None = None
) -> NoiseModel:
    """Return the noise of a model's sensors, and random forces of a sea.

    Parameters
    ----------
    model : Model
        Its outputs' ``noise_std`` are the white levels.
    sea : str
        ``still`` (no forces), ``calm``, ``moderate``, ``rough``; or levels by equation,
        ``"Z=0.3,M=0.06"`` in N, N m or the state's unit per second. ``time=5`` after either sets
        the correlation time, s.
    reference : iterable of Experiment
        What words are compared with: the manoeuvre that moves a velocity most counts.
    time : float, optional
        Correlation time where ``sea`` says nothing, s; 2 s or four samples, whichever is longer.

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
    >>> from oed_sysid.manoeuvres import Doublet
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
    runs = tuple(reference)
    white = noise_of(model).sigma
    parts = [part.strip() for part in sea.split(",") if part.strip()]
    word = parts.pop(0) if parts and "=" not in parts[0] else None
    if word is not None and word not in SEAS:
        raise DesignError(
            f"The sea {sea!r} is not understood. Say {', '.join(SEAS)}, or levels by equation "
            "such as Z=0.3,M=0.06,time=2."
        )
    given = dict(_assignment(sea, part) for part in parts)
    period = given.pop("time", time)
    if period is None:
        sample = max((run.sample_time for run in runs), default=0.0)
        period = max(USUAL_TIME, _SHORTEST * sample)
    if not period > 0 or any(level < 0 for level in given.values()):
        raise DesignError(f"The sea {sea!r} has a level below zero or no time. Correct it.")
    if word is not None and given:
        raise DesignError(f"Give the sea as a word or as levels, not both: {sea!r}.")
    if word is None:
        found = chosen_places(model, tuple(given))
        levels = np.array(list(given.values()), dtype=float)
    elif SEAS[word] == 0.0:
        return NoiseModel.white_only(white, model.output_names)
    else:
        found = chosen_places(model, "all")
        levels = SEAS[word] * natural_forces(model, found, runs) / period
    return NoiseModel(
        white, np.zeros_like(white), levels, force_time=period, outputs=model.output_names,
        places=tuple(place.name for place in found),
    )  # fmt: skip


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
    motion = np.zeros(len(found))
    for play in plays(model, runs):
        run = simulate_inputs(model, play.times, inputs=play.inputs, initial=play.initial)
        motion = np.maximum(motion, [np.std(run.signal(name)) for name in states])
    names = [disturbance(place).parameters[0].name for place in found]
    wide = disturbed_model(model, names)
    step = np.array([0.0, model.step])
    first = plays(model, runs[0])[0]
    commands = np.repeat(first.inputs[:1], 2, axis=0)
    still = simulate_inputs(wide, step, inputs=commands, initial=first.initial)
    answers = []
    for name, state in zip(names, states, strict=True):
        moved = simulate_inputs(
            wide.with_values({name: 1.0}), step, inputs=commands, initial=first.initial
        )
        answers.append((moved.signal(state)[1] - still.signal(state)[1]) / model.step)
    answer = np.abs(np.array(answers))
    if not np.all(answer > 0):
        blind = found[int(np.argmin(answer))].name
        raise DesignError(f"A random {blind} moves nothing in model {model.name!r}. Give levels.")
    return motion / answer


def sea_words(noise: NoiseModel) -> str:
    """Return levels and times of the random forces in words.

    >>> sea_words(NoiseModel.white_only(np.ones(1)))
    'none'
    """
    parts = [
        f"{place.removeprefix('force ')} {level:.3g}"
        for place, level in zip(noise.places, noise.force, strict=True)
        if level > 0
    ]
    if not parts:
        return "none"
    times = np.unique(noise.force_time[noise.force > 0].round(6))
    return f"{', '.join(parts)} over {', '.join(f'{t:.3g}' for t in times)} s"


def _assignment(sea: str, part: str) -> tuple[str, float]:
    name, equals, number = part.partition("=")
    if not (equals and name.strip() and _NUMBER.fullmatch(number.strip())):
        raise DesignError(f"{part!r} in the sea {sea!r} is not understood. Write NAME=NUMBER.")
    return name.strip(), float(number)
