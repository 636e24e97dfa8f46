"""Locate where a model fails: at which stage of the signal chain, in which equation, when."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from oed_sysid.diagnosis.greybox import GreyBox, Task, residuals
from oed_sysid.diagnosis.place_evidence import Evidence, evidence, refined
from oed_sysid.diagnosis.rank import Ranking
from oed_sysid.diagnosis.residual_forces import ResidualForces, Series, agreement, residual_forces
from oed_sysid.fitting.fit import align
from oed_sysid.noise.disturbances import Place
from oed_sysid.noise.linearisation import along

# Correlation times of the disturbances that are tried, s: passing and lasting.
CORRELATION_TIMES = (1.0, 20.0)
# Places that are judged once more where they themselves are disturbed.
N_REFINED = 4
# Gain in twice the log-likelihood below which no place is accused: chance gives more in
# less than one of a hundred records, fourteen places looked at.
CLEAR = 12.0
# Places whose gain is this near the best cannot be told from it.
GROUP_WIDTH = 6.0
# Share of its gain that a kinematic relation has to be ahead of other places: it is exact, and
# mostly stands for two sensors that disagree.
IDENTITY = 0.01
# Candidates whose signatures are put beside the residual forces.
N_RIVALS = 2
# Places that a report lists.
LISTED = 8

WORDS = {
    "actuator": "between the command and the actual {signal}",
    "flow": "in the flow past the hull, {signal}",
    "force": "in the forces of the {signal} equation",
    "kinematics": "in the kinematics of {signal}",
    "sensor": "in the measurement of {signal}",
}


@dataclass(frozen=True, eq=False)
class Located:
    """Where a model fails.

    Attributes
    ----------
    places : tuple of Place
        Largest evidence first.
    evidence : dict
        Gain in twice the log-likelihood that a disturbance at each place
        brings over white noise alone, keys such as ``"force Z"``.
    levels : dict
        Most likely standard deviation of that disturbance, in its unit.
    force_names : tuple of str
        Equations, in the order of the columns of ``forces``.
    forces : tuple of Series
        Smoothed residual forces, all let in together, per record.
    discrepancies : dict
        For the places with the most evidence, the smoothed disturbance there
        if nothing else is wrong; one :class:`Series` per record.
    signatures : dict
        For every rival, the residual forces ``(n_times, n_forces)`` that would
        be seen if it were the truth and nothing were noisy, per record.
    agreement : dict
        Correlation of each signature with the residual forces, in units of
        their standard errors.
    """

    places: tuple[Place, ...]
    evidence: dict[str, float]
    levels: dict[str, float]
    force_names: tuple[str, ...]
    forces: tuple[Series, ...]
    discrepancies: dict[str, tuple[Series, ...]]
    signatures: dict[str, tuple[np.ndarray, ...]]
    agreement: dict[str, float]

    @property
    def best(self) -> str | None:
        """Place with the most evidence; None where chance explains all of it."""
        name = self.places[0].name
        return name if self.evidence[name] > CLEAR else None

    @property
    def group(self) -> tuple[str, ...]:
        """The best place and those that these records cannot tell from it."""
        if self.best is None:
            return ()
        top = self.evidence[self.best]
        near = (name for name, gain in self.evidence.items() if abs(top - gain) < GROUP_WIDTH)
        return tuple(near)

    @property
    def verdict(self) -> str:
        """The finding in one or two sentences."""
        if self.best is None:
            return (
                "No place stands out: noise of the sensors, as strong as it has to be, explains "
                "what is left as well as a disturbance at any one place would."
            )
        words = {place.name: _words(place) for place in self.places}
        text = f"Something is missing {words[self.best]}"
        rivals = [words[name] for name in self.group if name != self.best]
        if rivals:
            text += ", or as likely " + ", or ".join(rivals)
        later = [name for name in self.evidence if name not in self.group]
        if later:
            lag = self.evidence[self.best] - self.evidence[later[0]]
            text += f" (next: {later[0]}, {lag:.0f} less likely)" if lag > 0 else ""
        return text + "."

    def report(self) -> str:
        """Return the finding as text."""
        rows = [("where the model fails", "evidence", "less than best", "size", "unit")]
        top = max(self.evidence.values())
        for place in self.places[:LISTED]:
            gain = self.evidence[place.name]
            if gain > CLEAR:
                size = f"{self.levels[place.name]:.2g}"
                rows.append((place.name, _count(gain), _count(top - gain), size, place.unit))
        lines = [*align(rows), ""] if len(rows) > 1 else []
        lines.append(self.verdict)
        if self.best is not None:
            lines += [
                "The smoothed residual force is the part of the missing force that the free",
                "parameters could not absorb, not the missing force itself: compare it with the",
                "signature of a candidate, which has been through the same projection.",
            ]
        if self.agreement:
            pairs = [("candidate", "agreement with the residual forces")]
            pairs += [(name, f"{value:.2f}") for name, value in self.agreement.items()]
            lines += ["", *align(pairs)]
        return "\n".join(lines)

    def to_dict(self) -> dict[str, Any]:
        """Return the finding as plain data for JSON."""
        return {
            "best": self.best,
            "group": list(self.group),
            "verdict": self.verdict,
            "evidence": dict(self.evidence),
            "levels": dict(self.levels),
            "units": {place.name: place.unit for place in self.places},
            "forces": {
                "names": list(self.force_names),
                "records": [series.to_dict() for series in self.forces],
            },
            "discrepancies": {
                name: [series.to_dict() for series in parts]
                for name, parts in self.discrepancies.items()
            },
            "signatures": {
                name: [part.tolist() for part in parts] for name, parts in self.signatures.items()
            },
            "agreement": dict(self.agreement),
        }


def locate(
    task: Task,
    fit: GreyBox,
    rivals: Mapping[str, GreyBox] | None = None,
    *,
    correlation_times: Sequence[float] = CORRELATION_TIMES,
) -> Located:
    """Locate where a model fails.

    At one place of the chain after the other (every actuator, flow, equation,
    kinematic relation and sensor) a disturbance is let in, its variance
    estimated by restricted maximum likelihood, and the gain in likelihood over
    white noise compared. Parameters and initial states are projected out: what
    they can explain accuses no place.

    Parameters
    ----------
    task : Task
    fit : GreyBox
        The present model, with estimated noise levels.
    rivals : mapping of str to GreyBox, optional
        Fits of models that may be right, as a ranking's refits hold them;
        their signatures are put beside the residual forces.
    correlation_times : sequence of float
        Of the disturbances, s; for every place the likelier one counts.
    """
    linear = along(task, fit)
    first: dict[Place, Evidence] = {}
    for time in correlation_times:
        for part in evidence(linear, correlation_time=time):
            if part.place not in first or part.gain > first[part.place].gain:
                first[part.place] = part
    ordered = sorted(first.values(), key=lambda part: -part.gain)
    found = [
        refined(linear, part) if position < N_REFINED and part.gain > CLEAR else part
        for position, part in enumerate(ordered)
    ]
    # Of places that are one and the same to the records, the equation is named first.
    found.sort(key=lambda part: (-round(_weight(part)), part.place.stage != "force"))
    times = [record.times for record in task.dataset]
    smoother = residual_forces(linear)
    forces = smoother.series(times)
    signatures = {
        name: smoother.signature([-part for part in residuals(task.dataset, rival.outputs)])
        for name, rival in (rivals or {}).items()
    }
    return Located(
        places=tuple(part.place for part in found),
        evidence={part.place.name: part.gain for part in found},
        levels={part.place.name: part.level for part in found},
        force_names=tuple(linear.where[i].signal for i in linear.forces),
        forces=forces,
        discrepancies={
            part.place.name: _discrepancy(part, times)
            for part in found[:N_REFINED]
            if part.gain > CLEAR
        },
        signatures=signatures,
        agreement={name: agreement(forces, parts) for name, parts in signatures.items()},
    )


def _weight(part: Evidence) -> float:
    """Gain by which places are ordered; a geometric identity has to be accused clearly."""
    return part.gain * (1.0 - IDENTITY if part.place.stage == "kinematics" else 1.0)


def likeliest(ranking: Ranking) -> dict[str, GreyBox]:
    """Fits with each of the best candidates, for their signatures."""
    return {refit.name: refit.fit for refit in ranking.refits[:N_RIVALS]}


def _discrepancy(part: Evidence, times: Sequence[np.ndarray]) -> tuple[Series, ...]:
    """Disturbance of one place if nothing else is wrong."""
    return ResidualForces.of(part.grounds, part.noise, part.records).series(times)


def _words(place: Place) -> str:
    return WORDS[place.stage].format(signal=place.signal)


def _count(gain: float) -> str:
    return f"{gain:.0f}" if gain < 1e5 else f"{gain:.2g}"
