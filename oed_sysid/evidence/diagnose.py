"""One look without adding anything: where a model fails and what might be missing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.locate import Located, likeliest, locate
from oed_sysid.evidence.rank import Ranking, rank
from oed_sysid.evidence.study import Study
from oed_sysid.evidence.usual import settled
from oed_sysid.likelihood.start_guess import check_channels
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import as_dict, as_html
from oed_sysid.runtime.threads import single_threaded


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Where a model fails on some records, and which effects would explain it.

    Attributes
    ----------
    model : Model
        The nominal model.
    location : Located
    ranking : Ranking
    """

    model: Model
    location: Located
    ranking: Ranking

    _repr_html_ = as_html

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.model.name!r}: lacks {', '.join(self.group) or 'nothing'}>"

    @property
    def best(self) -> Effect | None:
        """The likeliest effect, ready to be added; None where chance explains its gain."""
        for refit in self.ranking.refits[:1]:
            if refit.gain >= self.ranking.needed(refit):
                return refit.score.effect.with_values(refit.fit.values)
        return None

    @property
    def group(self) -> tuple[str, ...]:
        """Identifiers of the best effect and of those that cannot be told from it here."""
        if self.best is None:
            return ()
        names = [refit.name for refit in self.ranking.group()]
        return tuple(dict.fromkeys((*names, *self.ranking.alike(names[0]))))

    def report(self) -> str:
        """Return the diagnosis as text."""
        group = self.group
        if not group:
            verdict = "No candidate explains more than chance does."
        elif len(group) == 1:
            verdict = f"Missing, as far as these records can tell: {group[0]}."
        else:
            verdict = f"Missing, and these records cannot tell which: {', '.join(group)}."
        note = "Nothing has been added, and no validation record been asked: that is `improve`."
        return "\n".join(
            [self.model.name, self.location.report(), "", self.ranking.report(), "", verdict, note]
        )

    to_dict = as_dict(
        "group",
        best=lambda self: None if self.best is None else self.best.name,
        located="location.gains", ranking=lambda self: self.ranking.scored(),
        undetectable=lambda self: self.ranking.undetectable(),
    )  # fmt: skip


@single_threaded
def diagnose(
    model: Model,
    dataset: Dataset,
    *,
    candidates: Sequence[Effect] | None = None,
    known_noise: bool = False,
    disturbances: str | Sequence[str] = "auto",
) -> Diagnosis:
    """Locate where a model fails and rank what may be missing, adding nothing.

    Parameters
    ----------
    model : Model
        The nominal model.
    dataset : Dataset
        Measured records.
    candidates : sequence of Effect, optional
        What may be missing; without any, what usually is
        (:func:`~oed_sysid.evidence.usual.usual_effects`).
    known_noise : bool
    disturbances : str or sequence of str
        See :func:`oed_sysid.evidence.improve.improve`.
    """
    check_channels(model, dataset)
    candidates, _ = settled(model, dataset, candidates)
    study, fit = Study.begin(
        model, dataset, None, candidates, known_noise=known_noise, disturbances=disturbances
    )
    ranking = rank(study, fit, study.candidates)
    return Diagnosis(model, locate(fit, study.unit, likeliest(ranking)), ranking)
