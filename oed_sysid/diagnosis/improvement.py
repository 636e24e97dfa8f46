"""The result of an improvement: every step kept, printable, and plain data on request."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from oed_sysid.diagnosis.advice import advice
from oed_sysid.diagnosis.conclusion import Remains
from oed_sysid.diagnosis.error_table import Errors, Yardstick
from oed_sysid.diagnosis.greybox import GreyBox
from oed_sysid.diagnosis.locate import Located
from oed_sysid.diagnosis.rank import Ranking
from oed_sysid.effects import Effect
from oed_sysid.fitting.fit import align
from oed_sysid.model import Model

# Evidence (gain less the cost of freedom) from which a candidate is mentioned as a hint.
HINT = 4.0


@dataclass(frozen=True, eq=False)
class Step:
    """One effect added.

    Attributes
    ----------
    effect : Effect
        What was added, at its estimates after the step.
    group : tuple of str
        Identifiers that these data cannot tell from it, itself first.
    evidence : float
        Gain in twice the log-likelihood on the training records.
    needed : float
        Gain that chance rarely exceeds, however many candidates were tried.
    test_gain : float
        The same gain on the untouched records; NaN without any.
    train_error, test_error : float
        Prediction errors after the step, in units of the noise.
    fit : GreyBox
        The fit after the step.
    rms : dict
        The same errors of each output in its unit, ``train`` and ``test``, ``(n_outputs,)``.
    """

    effect: Effect
    group: tuple[str, ...]
    evidence: float
    needed: float
    test_gain: float
    train_error: float
    test_error: float
    fit: GreyBox
    rms: Errors

    @property
    def added(self) -> str:
        """Identifier of the effect."""
        return self.effect.name


@dataclass(frozen=True, eq=False)
class Improvement:
    """What is missing, step by step, with the errors before and after.

    Attributes
    ----------
    model : Model
        The improved model at its estimates.
    base : Model
        The believed model at its estimates.
    steps : tuple of Step
    ranking : Ranking
        Of the first round.
    base_fit : GreyBox
    base_error, final_error : dict
        ``train`` and ``test`` errors in units of the noise.
    location : Located
        Where the believed model fails: stage, equation or sensor, and when.
    remains : Remains
        What is left unexplained after the last step.
    base_rms : dict
        Errors of each output in its unit, ``train`` and ``test``, ``(n_outputs,)``.
    yardstick : Yardstick
        Noise and spread of the signals, to compare errors with.
    rejected : tuple of str
        Best candidates that the untouched records refused.
    """

    model: Model
    base: Model
    steps: tuple[Step, ...]
    ranking: Ranking
    base_fit: GreyBox
    base_error: Mapping[str, float]
    final_error: Mapping[str, float]
    location: Located
    remains: Remains
    parameters: tuple[Mapping[str, Any], ...]
    base_rms: Errors
    yardstick: Yardstick
    rejected: tuple[str, ...] = ()
    proposed: tuple[Mapping[str, Any], ...] = ()

    @property
    def verdict(self) -> str:
        """``"missing"`` or ``"nothing_missing"``."""
        return "missing" if self.steps else "nothing_missing"

    @property
    def located(self) -> dict[str, float]:
        """Evidence, in twice the log-likelihood, for a disturbance at each place."""
        return dict(self.location.evidence)

    @property
    def advice(self) -> list[str]:
        """What to believe, what not, and what to do next at sea; one line each."""
        return advice(
            self.steps,
            self.ranking,
            self.parameters,
            explained=self.explained,
            commanded=bool(self.base.inputs),
        )

    @property
    def remainder(self) -> float:
        """Gain in twice the log-likelihood that unknown forces would still bring."""
        return self.remains.forces

    @property
    def explained(self) -> bool:
        """Whether what remains is noise: no disturbance is needed any more."""
        return self.remains.is_noise

    def at_step(self, count: int) -> Model:
        """Return the model after the first steps only: what came later is undone.

        Parameters
        ----------
        count : int
            Steps kept, 0 for the believed model; negative numbers count from the
            end, so that ``at_step(-1)`` undoes the last one.

        Returns
        -------
        Model
            At the estimates that were found after that step.
        """
        kept = self.steps[:count]
        if not kept:
            return self.base
        model = self.base + tuple(step.effect for step in kept)
        known = set(model.parameter_names)
        return model.with_values({k: v for k, v in kept[-1].fit.values.items() if k in known})

    def to_dict(self) -> dict[str, Any]:
        """Return the improvement as plain data for JSON."""
        return {
            "verdict": self.verdict,
            "steps": [
                {
                    "added": step.added,
                    "group": list(step.group),
                    "evidence": step.evidence,
                    "train_error": step.train_error,
                    "test_error": step.test_error,
                }
                for step in self.steps
            ],
            "ranking": [
                {"effect": name, "statistic": statistic}
                for name, statistic in self.ranking.statistics()
            ],
            "located": self.located,
            "base_error": dict(self.base_error),
            "final_error": dict(self.final_error),
            "proposed_terms": [dict(term) for term in self.proposed],
            "parameters": [dict(parameter) for parameter in self.parameters],
        }

    def report(self) -> str:
        """Return the improvement as a story with numbers."""
        return "\n".join(
            [
                *self._opening(),
                "",
                self.location.report(),
                "",
                self.ranking.report(),
                "",
                *self._story(),
                "",
                *self.yardstick.table(self.base_rms, self.steps[-1].rms if self.steps else None),
                "",
                *self.advice,
                "",
                *self._closing(),
            ]
        )

    def _opening(self) -> list[str]:
        error = self.base_error
        return [
            f"{self.base.name}",
            f"  as believed, it misses the training records by {error['train']:.2f} x noise"
            + ("" if np.isnan(error["test"]) else f", the untouched ones by {error['test']:.2f}"),
        ]

    def _story(self) -> list[str]:
        if not self.steps:
            lines = ["Nothing is missing that these records could show."]
            best = self.ranking.refits[0] if self.ranking.refits else None
            if best is not None and best.evidence > HINT:
                lines.append(
                    f"A hint, no more: {best.name} would gain {best.gain:.1f}, where "
                    f"{self.ranking.needed(best):.1f} are needed. A manoeuvre that excites it "
                    "would tell."
                )
            if self.rejected:
                lines.append(
                    "The untouched records refused "
                    + ", ".join(dict.fromkeys(self.rejected))
                    + ": what looked like it on the training records did not repeat."
                )
            return lines
        rows = [("effect added", "gain", "needed", "test gain", "train error", "test error")]
        rows.append(("(as believed)", "", "", "", *self._pair(self.base_error)))
        for step in self.steps:
            rows.append(
                (
                    step.added,
                    f"{step.evidence:.1f}",
                    f"{step.needed:.1f}",
                    "-" if np.isnan(step.test_gain) else f"{step.test_gain:.1f}",
                    *self._pair({"train": step.train_error, "test": step.test_error}),
                )
            )
        lines = align(rows)
        for step in self.steps:
            if len(step.group) > 1:
                lines.append(
                    f"These records cannot tell {step.added} from {', '.join(step.group[1:])}."
                )
        return lines

    @staticmethod
    def _pair(error: Mapping[str, float]) -> tuple[str, str]:
        test = "-" if np.isnan(error["test"]) else f"{error['test']:.3f}"
        return f"{error['train']:.3f}", test

    def _closing(self) -> list[str]:
        lines = []
        for term in self.proposed:
            lines.append(
                f"No known effect explains it alone: proposed is {term['term']} in the "
                f"{term['equation']} equation, {term['parameter']} = {term['value']:.4g} "
                f"{term['unit']}."
            )
            others = [name for name in term["group"] if name != term["term"]]
            if others:
                lines.append("These records cannot tell it from " + ", ".join(others[:8]) + ".")
            if term["replaces"]:
                lines.append("It takes the place of " + ", ".join(term["replaces"]) + ".")
        return lines + self._verdict()

    def _verdict(self) -> list[str]:
        if self.explained:
            colour = (
                ""
                if self.remains.sensor_time is None
                else f", correlated over about {self.remains.sensor_time:.2g} s at the sensors"
            )
            return [f"Verdict: the remaining misfit is noise at this level{colour}."]
        return [
            "Verdict: no known effect explains what remains "
            f"(disturbances still gain {self.remainder:.0f} in twice the log-likelihood)."
        ]
