r"""What a model leaves unexplained: noise of sensors, disturbance forces, or structure.

The likelihood with disturbance forces is compared with that without, everything else estimated
anew. A force is *random* where its level is the same on the validation records, no term of the
dictionary explains it and it does not follow the motion
(:mod:`oed_sysid.evidence.residual_forces`);
*structure is missing* where something that repeats with the manoeuvre would. How much it matters is
the error of the model on its own, beside the spread of each signal.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.evidence.residual_forces import Repeated, repeated
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.disturbances import places
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.score_test import DRIFTS
from oed_sysid.runtime.display import as_dict

# Twice the log-likelihood that disturbances may gain before they count as real.
REMAINDER_LIMIT = 14.0
# Below this share of a signal's spread an error of the model is no reason to go on.
RELEVANT = 0.01
# Share of a signal's spread that cannot be noise of its sensor; and that which cannot be where it
# is slow and far above what the high-frequency content shows.
ABSORBED, DRIFTING = 0.5, 0.1
# Slow noise, over what was declared, that is no longer the declared sensor.
LOUDER = 2.5
# A level on other records that differs by more than this factor is tied to the manoeuvre.
SAME_LEVEL = 2.0


@dataclass(frozen=True)
class RandomForceFound:
    """One disturbance force that is left.

    Attributes
    ----------
    place, unit : str
        Where it acts, ``"force Z"``, and the unit of its level.
    level, time : float
        Standard deviation and correlation time, s.
    gain : float
        What dropping it, all else estimated again, loses in twice the log-likelihood.
    elsewhere : float
        Its level on the validation records; NaN without any.
    told : bool
        Whether the validation records tell the levels estimated there from those of the training.
    """

    place: str
    unit: str
    level: float
    time: float
    gain: float
    elsewhere: float
    told: bool = True

    to_dict = as_dict("place", "unit", "level", "time", "gain", level_on_validation="elsewhere")

    @property
    def is_the_same_elsewhere(self) -> bool:
        """Whether its level on validation records is about that on the training records.

        Level and time of a short force are told together only, and each badly where records are
        short: levels that differ say nothing where the records are as likely with the same ones.
        """
        if np.isnan(self.elsewhere) or not self.told:
            return True
        low, high = sorted((self.level, self.elsewhere))
        return bool(low > 0 and high / low < SAME_LEVEL)

    @property
    def text(self) -> str:
        """The force in words, for instance ``random force in Z, 0.31 N, 2.0 s``."""
        stage, _, signal = self.place.partition(" ")
        what = {"actuator": f"noise on {signal}", "force": f"random force in {signal}"}
        name = what.get(stage, f"random {stage} of {signal}")
        time = f", {self.time:.2g} s" if self.time > 0 else ""
        return f"{name}, {self.level:.2g} {self.unit}{time}".replace(" ,", ",")


@dataclass(frozen=True)
class Remains:
    """What a fit leaves unexplained.

    Attributes
    ----------
    forces : float
        Gain in twice the log-likelihood that disturbance forces bring over noise of the
        sensors alone.
    sensor_time : float or None
        Correlation time of the sensors' noise, s; None where white noise
        explains them too.
    random : tuple of RandomForceFound
        Those that are real, largest gain first.
    shares : mapping of str to float
        Error of the model on its own, as a share of each signal's spread; infinite where it leaves
        the numbers.
    over_wiggles : mapping of str to float
        The same error, over the declared noise of each signal, or over what its high-frequency
        content shows.
    declared : tuple of str
        Signals whose noise was declared.
    tied : tuple of str
        Terms or effects that would explain what is left but were not confirmed.
    follows : tuple of Repeated
        Forces taken for random that are functions of the motion; None where that was not asked.
    suspect : str
        Why the log contradicts itself; empty where it does not.
    """

    forces: float
    sensor_time: float | None
    random: tuple[RandomForceFound, ...] = ()
    shares: Mapping[str, float] | None = None
    over_wiggles: Mapping[str, float] | None = None
    declared: tuple[str, ...] = ()
    tied: tuple[str, ...] = ()
    follows: tuple[Repeated, ...] | None = None
    suspect: str = ""

    @property
    def is_noise(self) -> bool:
        """Whether no disturbance is needed any more, in a log that can be trusted."""
        return self.forces < REMAINDER_LIMIT and not self.suspect

    @property
    def is_absorbed(self) -> bool:
        """Whether noise is said to be what a model should explain: most of some signal."""
        return bool(self.shares) and max((self.shares or {}).values()) > ABSORBED

    @property
    def diverging(self) -> tuple[str, ...]:
        """Signals for which the model on its own diverges."""
        return tuple(name for name, share in (self.shares or {}).items() if share == np.inf)

    @property
    def drifting(self) -> tuple[str, ...]:
        """Signals whose misfit would be slow noise far above their high-frequency content."""
        if self.sensor_time is None or not self.over_wiggles:
            return ()
        shares = self.shares or {}
        found = []
        for name, ratio in self.over_wiggles.items():
            most, least = (LOUDER, RELEVANT) if name in self.declared else (DRIFTS, DRIFTING)
            if ratio > most and shares.get(name, 0.0) > least:
                found.append(name)
        return tuple(found)

    @property
    def kind(self) -> str:
        """``"adequate"``, ``"random forces"``, ``"structure missing"`` or ``"log suspect"``."""
        if self.suspect:
            return "log suspect"
        if self.diverging:
            return "structure missing"
        if self.is_noise or not self.random:
            return "structure missing" if self.is_absorbed or self.drifting else "adequate"
        same = all(force.is_the_same_elsewhere for force in self.random)
        if self.tied or self.follows or not same:
            small = self.shares and max(self.shares.values()) < RELEVANT
            return "adequate" if small else "structure missing"
        return "random forces"

    @property
    def sentence(self) -> str:
        """What is left, with its size."""
        if self.suspect:
            return f"log suspect: {self.suspect} Nothing is certified before that is put right."
        if self.diverging:
            return (
                "structure missing: on its own the model diverges in "
                f"{', '.join(self.diverging)}, whatever the likelihood says. Bound the parameters, "
                "or declare noise_std, and look at the values of the fit."
            )
        colour = (
            ""
            if self.sensor_time is None
            else f", correlated over about {self.sensor_time:.2g} s at the sensors"
        )
        if self.is_noise or not self.random:
            return self._without_forces(colour)
        return self._with_forces(colour)

    def _without_forces(self, colour: str) -> str:
        """The sentence where no disturbance force acts."""
        if self.kind != "structure missing":
            return f"adequate: the remaining misfit is noise at this level{colour}."
        if self.drifting and not self.is_absorbed:
            return (
                f"structure missing: on its own the model misses {self._shares()}{colour}. "
                f"That is {self._above()}: no noise of a sensor, unless it drifts."
            )
        return (
            f"structure missing: on its own the model misses {self._shares()}, which noise of "
            "the sensors cannot be. Declare noise_std, check signs, units and start values."
        )

    def _with_forces(self, colour: str) -> str:
        """The sentence where disturbance forces act."""
        listed = "; ".join(force.text for force in self.random)
        shares = self._shares()
        if self.kind == "adequate":
            return f"adequate: what is left ({listed}) moves no signal by more than {shares}."
        if self.kind == "random forces":
            checked = not np.isnan(self.random[0].elsewhere)
            same = ", about the same on the validation records" if checked else ""
            if self.follows is None:
                return f"{listed}{same}; no known effect or term explains it{colour}."
            return f"{listed}{same}; nothing in it repeats with the manoeuvre{colour}."
        if self.follows:
            why = "; ".join(one.text for one in self.follows)
        elif self.tied:
            why = f"{', '.join(self.tied[:3])} would explain part of it but is not confirmed"
        else:
            why = "its level differs between training and validation records"
        return (
            f"structure missing in {', '.join(f.place for f in self.random)} ({why}); on its own "
            f"the model misses {shares}."
        )

    def _above(self) -> str:
        """How far slow misfit is above the noise of the sensors."""
        ratios = self.over_wiggles or {}
        return ", ".join(
            f"{ratios[name]:.2g} times "
            + (
                "the declared noise of " * (name in self.declared)
                or "the high-frequency content of "
            )
            + name
            for name in self.drifting
        )

    def _shares(self) -> str:
        if not self.shares:
            return "an unknown share of the signals"
        worst = sorted(self.shares.items(), key=lambda pair: -pair[1])[:3]
        return ", ".join(f"{100 * share:.2g} % of {name}" for name, share in worst)

    to_dict = as_dict(
        "kind", "sensor_time", "random", "tied", "follows",
        gain_of_forces="forces",
        shares=lambda self: self.shares or {},
        over_wiggles=lambda self: self.over_wiggles or {},
    )  # fmt: skip


def remains(study: Study, fit: FilteredSolution) -> Remains:
    """Judge what a fit leaves.

    Parameters
    ----------
    study : Study
    fit : FilteredSolution
        With estimated noise levels.
    """
    noise = fit.noise
    if noise.is_white:
        return Remains(0.0, None)
    quiet = _without(study, fit, np.zeros(len(noise.force), dtype=bool))
    forces = np.inf if quiet is None else max(quiet.objective - fit.objective, 0.0)
    if not noise.has_forces:
        forces = 0.0
    time = _sensor_time(study, fit)
    if forces < REMAINDER_LIMIT:
        return Remains(forces, time)
    validated = None if study.validation is None else study.on_records(fit, study.validation)
    elsewhere = np.full(len(noise.force), np.nan) if validated is None else validated.noise.force
    told = validated is not None and _tells_levels(study, fit, validated)
    units = {place.name: place.unit for place in places(study.base)}
    found = []
    for index in np.flatnonzero(noise.force > 0):
        kept = np.ones(len(noise.force), dtype=bool)
        kept[index] = False
        without = _without(study, fit, kept)
        gain = np.inf if without is None else without.objective - fit.objective
        if gain > REMAINDER_LIMIT:
            name = noise.places[index]
            level, tau = float(noise.force[index]), float(noise.force_time[index])
            other = elsewhere[index]
            found.append(RandomForceFound(name, units.get(name, ""), level, tau, gain, other, told))
    found.sort(key=lambda force: -force.gain)
    follows = repeated(study, fit, validated) if found else None
    return Remains(forces, time, tuple(found), follows=follows)


def _tells_levels(study: Study, fit: FilteredSolution, validated: FilteredSolution) -> bool:
    """Whether validation records are clearly likelier with levels of their own."""
    assert study.validation is not None
    same = study.on_records(fit, study.validation, same_forces=True)
    return same is None or same.objective - validated.objective > REMAINDER_LIMIT


def _without(study: Study, fit: FilteredSolution, kept: np.ndarray) -> FilteredSolution | None:
    """The fit again with some disturbances only."""
    noise = fit.noise
    levels = study.levels(noise, study.train).without_forces(~kept)
    problem = study.problem_of(fit, levels)
    return study.solve(problem, problem.point(fit.initial, fit.local), max_iterations=8)


def _sensor_time(study: Study, fit: FilteredSolution) -> float | None:
    """Correlation time of coloured sensors where it is clear."""
    noise = fit.noise
    if not noise.has_colour:
        return None
    levels = study.setting.levels(
        study.train,
        noise.with_levels(noise.sensors, 0 * noise.colour, noise.force),
        study.unit,
        np.zeros(len(noise.colour), dtype=bool),
    )
    problem = study.problem_of(fit, levels)
    again = study.solve(problem, problem.point(fit.initial, fit.local), max_iterations=8)
    gain = np.inf if again is None else again.objective - fit.objective
    if gain < REMAINDER_LIMIT:
        return None
    loudest = int(np.argmax(noise.colour / noise.white))
    return float(noise.colour_time[loudest])
