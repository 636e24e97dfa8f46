r"""The one verdict on what a model leaves: noise, a disturbance, structure, or not known.

It is decided here only, from whole runs (:mod:`oed_sysid.likelihood.whole_runs`): could sensors and
process noise as estimated have left the runs of the training and of the validation records?

================== ================================================================================
kind               where
================== ================================================================================
log suspect        the log contradicts itself: nothing is certified
structure missing  the disturbance follows motion and commands, or has another level elsewhere; or
                   runs lie beyond what the noise model would have left, or are worse with process
                   noise than without by more than it brings
not known          a question could not be asked, or the noise of a sensor was not declared and what
                   is left is no white noise of it
disturbance        process noise acts, and all of that was asked
adequate           sensor noise alone
================== ================================================================================

The likelihood with disturbance forces is compared with that without, everything else estimated
anew. Where they bring less than chance may, whole runs are judged without them: a verdict is asked
with the noise that it names. A force is asked whether its level is the same on the validation
records and whether it follows motion and commands (:mod:`oed_sysid.likelihood.laws`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.sentences import say
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.departures import TWOFOLD
from oed_sysid.likelihood.disturbances import places
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.laws import Law, laws
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.likelihood.whole_runs import WholeRuns
from oed_sysid.runtime.display import as_dict

# Twice the log-likelihood that disturbances may gain before they count as real: what chance rarely
# gives of a level and its time at fourteen places.
REMAINDER_LIMIT = threshold(14, 2)


@dataclass(frozen=True)
class RandomForceFound:
    """One disturbance force that is left.

    Attributes
    ----------
    place, unit : str
        Where it acts, ``"force Z"``, and the unit of its level.
    level, time : float
        Standard deviation and correlation time, s; of a sea its period.
    gain : float
        What dropping it (or the whole sea), all else estimated again, loses in twice the
        log-likelihood.
    elsewhere : float
        Its level on the validation records; NaN without any.
    told : bool
        Whether the validation records tell the levels estimated there from those of the training.
    narrow_band : bool
        Whether it is that of a sea.
    """

    place: str
    unit: str
    level: float
    time: float
    gain: float
    elsewhere: float
    told: bool = True
    narrow_band: bool = False

    to_dict = as_dict(
        "place", "unit", "level", "time", "gain", "narrow_band", level_on_validation="elsewhere"
    )

    @property
    def is_the_same_elsewhere(self) -> bool:
        """Whether its level on validation records is about that on the training records.

        Level and time of a short force are told together only, and each badly where records are
        short: levels that differ say nothing where the records are as likely with the same ones.
        Another day has another sea. One that differs by more is tied to the manoeuvre.
        """
        if np.isnan(self.elsewhere) or not self.told or self.narrow_band:
            return True
        low, high = sorted((self.level, self.elsewhere))
        return bool(low > 0 and high / low < TWOFOLD)

    @property
    def text(self) -> str:
        """The force in words, for instance ``disturbance force in Z, 0.31 N, 2.0 s``."""
        stage, _, signal = self.place.partition(" ")
        what = {"actuator": f"noise on {signal}", "force": f"disturbance force in {signal}"}
        name = what.get(stage, f"disturbance {stage} of {signal}")
        time = f", {self.time:.2g} s" if self.time > 0 else ""
        if self.narrow_band:
            name, time = f"narrow-band {name}", f", period {self.time:.2g} s"
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
        Those that are real, largest gain first; all that act where none of them is alone.
    training, validation : WholeRuns or None
        What whole runs say; None where they were not asked.
    tied : tuple of str
        Terms or effects that would explain what is left but were not confirmed.
    follows : tuple of Law
        Disturbances that are functions of motion and commands; None where that was not asked.
    suspect : str
        Why the log contradicts itself; empty where it does not.
    unjudged : tuple of str
        What the check of the log could not judge, in words.
    fit : FilteredSolution, optional
        Without disturbances where none is real: whole runs are then asked of it.

    Examples
    --------
    ``improve(...).remains``; see :func:`~oed_sysid.evidence.improve`.
    """

    forces: float
    sensor_time: float | None
    random: tuple[RandomForceFound, ...] = ()
    training: WholeRuns | None = None
    validation: WholeRuns | None = None
    tied: tuple[str, ...] = ()
    follows: tuple[Law, ...] | None = None
    suspect: str = ""
    unjudged: tuple[str, ...] = ()
    fit: FilteredSolution | None = None

    @property
    def is_noise(self) -> bool:
        """Whether no disturbance is needed any more, in a log that can be trusted."""
        return self.forces < REMAINDER_LIMIT and not self.suspect

    @property
    def judges(self) -> WholeRuns | None:
        """Whole runs that sizes are told of: on validation records where there are any."""
        return self.training if self.validation is None else self.validation

    @property
    def structured(self) -> tuple[str, ...]:
        """What in the forces themselves says that they hold structure, in words."""
        found = [one.text for one in self.follows or ()]
        if self.tied and self.random:
            names = ", ".join(self.tied[:3])
            found.append(f"{names} would explain part of it but is not confirmed")
        if not all(force.is_the_same_elsewhere for force in self.random):
            found.append("its level differs between training and validation records")
        return tuple(found)

    @property
    def beyond(self) -> tuple[str, ...]:
        """What in whole runs neither sensors nor process noise could have left, in words."""
        both = {"training": self.training, "validation": self.validation}
        asked = {records: runs.objections for records, runs in both.items() if runs is not None}
        return tuple(f"{one} ({records})" for records, found in asked.items() for one in found)

    @property
    def open_questions(self) -> tuple[str, ...]:
        """What could not be asked, in words."""
        asked = [runs for runs in (self.validation, self.training) if runs is not None]
        found = [*self.unjudged, *([] if asked else ["whole runs were not asked"])]
        # What the validation records leave open, the training records mostly do, too.
        found += next((runs.open_questions for runs in asked if runs.open_questions), ())
        if (self.random or self.sensor_time is not None) and self.follows is None:
            found.append("whether what is left follows inputs and motion was not asked")
        return tuple(found)

    @property
    def kind(self) -> str:
        """One of the five kinds at the head of this module."""
        if self.suspect:
            return "log suspect"
        if self.beyond or self.structured:
            return "structure missing"
        if self.open_questions:
            return "not known"
        return "adequate" if self.is_noise else "disturbance"

    @property
    def sentence(self) -> str:
        """What is left, with its size."""
        listed, time = "; ".join(force.text for force in self.random), self.sensor_time
        checked = self.random and not np.isnan(self.random[0].elsewhere)
        same = ", about the same on the validation records" if checked else ""
        return say(
            "remains",
            self.kind,
            suspect=self.suspect,
            found="; ".join((*self.beyond, *self.structured)),
            open="; ".join(self.open_questions),
            stands=f" where process noise stands ({listed})" * bool(listed),
            beside=f"; process noise: {listed}" * bool(listed),
            acts=f": {listed}{same}" * bool(listed),
            colour="" if time is None else f", correlated over about {time:.2g} s at the sensors",
            size=f" On its own the model misses {self.size}." * bool(self.size),
        )

    @property
    def size(self) -> str:
        """Whole-run errors beyond noise, in units and per cent of the signals; the largest."""
        return "" if self.judges is None else self.judges.sizes

    to_dict = as_dict(
        "kind", "sensor_time", "random", "tied", "follows", "training", "validation",
        "open_questions",
        gain_of_forces="forces",
        shares=lambda self: {} if self.judges is None else self.judges.shares,
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
    every = np.ones(len(noise.force), dtype=bool)
    declared = noise.seas if study.setting.seas else ()
    quiet = _without(study, fit, every, declared)
    forces = max(_lost(fit, quiet), 0.0)
    if quiet is not None and forces < REMAINDER_LIMIT:
        # Small forces that nobody names would widen what whole runs may leave.
        time = _sensor_time(study, quiet)
        return Remains(forces, time, follows=() if time is None else followed(quiet), fit=quiet)
    validated = None if study.validation is None else study.on_records(fit, study.validation)
    acting = sorted(_forces(study, fit, validated), key=lambda force: -force.gain)
    # Each of some that stand for one another costs little; together they are real.
    found = tuple(one for one in acting if one.gain > REMAINDER_LIMIT) or tuple(acting)
    return Remains(forces, _sensor_time(study, fit), found, follows=followed(fit))


def followed(fit: FilteredSolution) -> tuple[Law, ...] | None:
    """Disturbances of a fit that follow motion and commands, asked as of any fit: levels held."""
    problem = fit.problem
    held = problem.posed(problem.levels.starting(fit.noise).held())
    return laws(held, held.beside(fit.point.unknowns).unknowns)


def _forces(
    study: Study, fit: FilteredSolution, validated: FilteredSolution | None
) -> Iterator[RandomForceFound]:
    """Every disturbance force that acts, and its level on the validation records."""
    noise, elsewhere, told = fit.noise, dict[tuple[str, bool], float](), False
    if validated is not None and study.validation is not None:
        elsewhere = {one[:2]: one[2] for one in _strengths(validated.noise)}
        # Whether validation records are clearly likelier with levels of their own.
        same = study.on_records(fit, study.validation, same_forces=True)
        told = _lost(validated, same) > REMAINDER_LIMIT
    units = {place.name: place.unit for place in places(study.base)}
    seas = study.setting.seas and noise.seas  # declared ones are given, not asked
    none = np.zeros(len(noise.force), dtype=bool)
    for name, narrow_band, level, time in _strengths(noise):
        if narrow_band and seas:
            continue
        gone = none if narrow_band else np.array([place == name for place in noise.places])
        without = _without(study, fit, gone, seas if narrow_band else noise.seas)
        other = elsewhere.get((name, narrow_band), np.nan)
        yield RandomForceFound(
            name, units.get(name, ""), level, time, _lost(fit, without), other, told, narrow_band
        )


def _strengths(noise: NoiseModel) -> Iterator[tuple[str, bool, float, float]]:
    """Place, whether of a sea, level, and time or period of every disturbance that acts."""
    for name, level, time in zip(noise.places, noise.force, noise.force_time, strict=True):
        if level > 0:
            yield name, False, float(level), float(time)
    for sea in noise.on().seas:  # of seas of single records their mean
        for name, level in (sea.levels or {}).items():
            if level > 0:
                yield name, True, level, float(sea.period or np.nan)


def _without(
    study: Study, fit: FilteredSolution, gone: np.ndarray, seas: Sequence[Sea]
) -> FilteredSolution | None:
    """The fit without some disturbances and all but some seas, all else estimated again."""
    levels = study.levels(replace(fit.noise, seas=tuple(seas)), study.train).without_forces(gone)
    return study.with_levels(fit, levels)


def _lost(fit: FilteredSolution, without: FilteredSolution | None) -> float:
    return np.inf if without is None else without.objective - fit.objective


def _sensor_time(study: Study, fit: FilteredSolution) -> float | None:
    """Correlation time of coloured sensors where it is clear."""
    noise = fit.noise
    if not noise.has_colour:
        return None
    white = replace(noise, white=noise.sensors, colour=0 * noise.colour)
    if _lost(fit, study.with_levels(fit, study.levels(white, study.train))) < REMAINDER_LIMIT:
        return None
    loudest = int(np.argmax(noise.colour / noise.white))
    return float(noise.colour_time[loudest])
