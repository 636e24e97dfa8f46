"""What the pages ask for: each task calls the package and composes the page on its result."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from oed_sysid.app.jobs import Tell
from oed_sysid.app.records import archive
from oed_sysid.app.study import Study
from oed_sysid.data.dataset import Dataset, together
from oed_sysid.evidence.check import LogCheck, corrected_copies, quick_check
from oed_sysid.likelihood.multiple_shooting import MultipleShooting

if TYPE_CHECKING:
    from oed_sysid.evidence.compare import Comparison
    from oed_sysid.likelihood.fit import Fit
    from oed_sysid.physics.model import Model
    from oed_sysid.runtime.display import Report

NOMINAL = "nominal"
DRAWING = "drawing"


@dataclass(frozen=True, eq=False)
class Outcome:
    """A result of the package, and the page on it.

    Parameters
    ----------
    result : object
        The result.
    page : Report
        The report on it.
    fits : mapping of str to Fit
        Fitted models that may be kept and exported, by what they are called.
    comparison : Comparison, optional
        What these predict.
    """

    result: Any
    page: Report
    fits: Mapping[str, Fit] = field(default_factory=dict)
    comparison: Comparison | None = None


def check(study: Study, tell: Tell) -> Outcome:
    """Say whether the records agree with themselves."""
    from oed_sysid.evidence.check import check as look

    records = study.records()
    tell("checking the records")
    found = look(records, study.problem)
    tell(DRAWING)
    return Outcome(found, found.document(records, title=study.problem.title).drawn())


def corrected(study: Study, found: LogCheck) -> bytes:
    """Return a ZIP file with copies of the records in which the findings are undone."""
    copies, _ = corrected_copies(study.records(), study.problem, found)
    names = study.train.names if study.train is not None else ()
    train = tuple(record for record in copies if record.name in names)
    test = tuple(record for record in copies if record.name not in names)
    return archive(Dataset(train) if train else None, Dataset(test) if test else None)


def fit(study: Study, tell: Tell) -> Outcome:
    """Estimate the parameters of the nominal model."""
    log = quick_check(study.training(), study.problem.model)
    result = fitted(study, study.problem.model, tell)
    tell(DRAWING)
    return Outcome(result, result.document(log=log).drawn(), {NOMINAL: result})


def compare(study: Study, groups: Iterable[tuple[str, ...]], tell: Tell) -> Outcome:
    """Fit the nominal model, and with each group of effects added; judge on validation records."""
    from oed_sysid.evidence.compare import compare as compare_models

    validation = study.validation()
    models = {NOMINAL: study.problem.model}
    for names in groups:
        effects = [study.problem.effect(name) for name in names]
        models[f"with {' and '.join(names)}"] = study.problem.model + effects
    fits = {name: fitted(study, model, tell) for name, model in models.items()}
    tell("predicting the validation records")
    result = compare_models(fits, validation)
    records = together(study.training(), validation)
    log = quick_check(records, study.problem.model).without("duplicate")
    tell(DRAWING)
    page = result.document(title=study.problem.title, log=log).drawn()
    return Outcome(result, page, fits, result)


def diagnose(study: Study, tell: Tell) -> Outcome:
    """Say where the nominal model fails and what may be missing."""
    from oed_sysid.evidence.compare import diagnose as look

    problem, train = study.problem, study.training()
    tell("looking where the model fails, and scoring all candidates")
    result = look(problem.model, train, candidates=problem.effects, known_noise=study.known_noise)
    tell(DRAWING)
    return Outcome(result, result.document(train, title=problem.title).drawn())


def improve(study: Study, max_effects: int, tell: Tell) -> Outcome:
    """Find the effects that the nominal model lacks."""
    from oed_sysid.evidence.compare import compare as compare_models
    from oed_sysid.evidence.improve import improve as search
    from oed_sysid.evidence.preparation import prepared

    problem, train = study.problem, study.training()
    result = search(
        problem.model,
        train,
        study.test,
        candidates=problem.effects,
        known_noise=study.known_noise,
        max_effects=max_effects,
        progress=tell,
    )
    fits = {NOMINAL: result.base_fit} | ({"improved": result.fit} if result.steps else {})
    tell("predicting")
    ready = prepared(train, study.test)  # what the search itself has read and judged on
    judged = ready.validation or ready.train
    comparison = compare_models(fits, judged, sigma=result.yardstick.sigma)
    tell(DRAWING)
    page = result.document(comparison, train=ready.train, title=problem.title).drawn()
    return Outcome(result, page, fits, comparison)


def fitted(study: Study, model: Model, tell: Tell) -> Fit:
    """Fit a model to the training records."""

    def iteration(state: Any) -> None:
        tell(f"fitting: iteration {state.iteration}, cost {state.cost:.6g}")

    tell(f"fitting {model.name}")
    return MultipleShooting(noise=study.noise, progress=iteration).fit(model, study.training())
