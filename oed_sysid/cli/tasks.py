"""The tasks of a study, one function each, and the table of them.

Options that belong together are groups, under the same names in every task that has them: what a
trial may do (:class:`Bounds`), what it is for (:class:`Aim`), what is known and expected
(:class:`Weather`, :class:`Expected`), how it is sought (:class:`Effort`), and what a programme may
cost (:class:`Allowed`). Each makes the objects of :mod:`oed_sysid.design` that it stands for.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import oed_sysid
from oed_sysid.cli import DONE, INTERRUPTED, NO_RESULT, SUSPECT
from oed_sysid.cli.study import Outcome, Study, Task
from oed_sysid.cli.terminal import Shown, invocation
from oed_sysid.errors import DataError, DesignError, FileError, ProblemError, located
from oed_sysid.runtime.display import Figure
from oed_sysid.runtime.files import make_folder, write_text

if TYPE_CHECKING:
    from oed_sysid import Experiment, Fit, Limits, Model, Problem, Record
    from oed_sysid.design import Design, Servo
    from oed_sysid.evidence.compare import Comparison, ModelMisfit
    from oed_sysid.evidence.result import LogCheck
    from oed_sysid.physics.base import Effect
    from oed_sysid.runtime.display import Report
    from oed_sysid.runtime.parallel import CellProgress

NOMINAL, IMPROVED = "nominal", "improved"


# -- groups of options -------------------------------------------------------------------


@dataclass(frozen=True)
class Bounds:
    """What a trial may do: its length, s, and limits in words."""

    duration: float | None = None
    limit: tuple[str, ...] = ()

    def limits(self, problem: Problem, show: Shown) -> Limits:
        """Return the limits of the problem, changed by those in words."""
        from oed_sysid.cli.limit_words import with_limits

        limits, said = with_limits(problem.model, problem.limits, self.limit)
        for words in said:
            show.note(f"Limit: {words}.")
        return limits


@dataclass(frozen=True)
class Aim:
    """What a trial is for: sharper parameters, rivals told apart, or effects made visible."""

    criterion: str = "D"
    discriminate: tuple[str, ...] = ()
    detect: tuple[str, ...] = ()

    def made(self, study: Study) -> Any:
        """Return the criterion of the design."""
        from oed_sysid.design import Detect, Discriminate
        from oed_sysid.design.choices import CRITERIA, named

        if self.discriminate and self.detect:
            raise DesignError("Give --discriminate or --detect: one run has one aim.")
        if not (self.discriminate or self.detect):
            return named("criterion", self.criterion, CRITERIA)()
        problem = study.equipped
        if self.discriminate:
            return Discriminate([problem.effect(rival) for rival in self.discriminate])
        if self.detect != ("all",):
            return Detect([problem.effect(one) for one in self.detect])
        if not problem.effects:
            raise DesignError(f"Problem {problem.name!r} has no candidate effect. Name none.")
        return Detect(problem.effects)


@dataclass(frozen=True)
class Weather:
    """The disturbance forces that a trial will meet, and how wrong coefficients may be.

    ``cluster`` and ``jobs`` say where the vehicles that are possible are simulated.
    """

    sea: str | None = None
    uncertainty: float | None = None
    cluster: str | None = None
    jobs: int = 1

    def spread(self, show: Shown) -> AbstractContextManager[None]:
        """Simulate vehicles over processes or a cluster, and tell how far they are."""
        from oed_sysid.runtime.parallel import spread_over

        return spread_over(self.cluster, n_jobs=self.jobs, progress=partial(_simulated, show))

    def noise(
        self, problem: Problem, nominal: Fit | Model, show: Shown, runs: Sequence[Experiment] = ()
    ) -> Any:
        """Noise of a sea that ``runs`` meet; None leaves it to the fit, or to declared levels."""
        if self.sea is None:
            return None
        from oed_sysid.information import sea_noise, sea_words

        model: Model = getattr(nominal, "model", nominal)  # type: ignore[arg-type]
        sizes = {"length": problem.length, "draught": problem.draught}
        found = sea_noise(model, self.sea, problem.experiments.values(), runs=runs, sizes=sizes)
        show.note(f"Disturbance forces: {sea_words(found)}.")
        return found


@dataclass(frozen=True)
class Expected(Weather):
    """What is known before a trial: ``after`` names a saved fit; see :func:`known`."""

    after: Path | None = None


def known(study: Study, after: Path | None, show: Shown) -> Fit | Model:
    """Return the nominal model, or a fit: at hand, of the training records, or from a file."""
    if after is None:
        return study.problem.model
    if (fit := study.saved.get(after.name)) is not None:
        return fit
    if study.train is not None:
        return fits_of(study, {"": study.problem.model}, show)[""]
    return oed_sysid.Fit.load(after)


@dataclass(frozen=True)
class Effort:
    """How a manoeuvre is sought: kind of command, how long, how safely."""

    family: str = "levels"
    avoid: tuple[str, ...] = ()
    effort: str = "quick"
    certainty: float | None = None
    seed: int = 0

    def search(self) -> Any:
        """Return the settings of the search."""
        from oed_sysid.design import Search
        from oed_sysid.design.choices import EFFORTS, FAMILIES, named

        if self.avoid and self.family != "multisine":
            raise DesignError("Frequencies can be avoided by sines only: add --family multisine.")
        bands = {"forbidden": [band("--avoid", text) for text in self.avoid]} if self.avoid else {}
        family = named("family", self.family, FAMILIES)(**bands)
        return Search(family, *named("effort", self.effort, EFFORTS))

    def caution(self, spread: float | None) -> Any:
        """How limits are kept: surely, unless somebody said how surely."""
        from oed_sysid.design import Caution

        if self.certainty:
            return Caution(self.certainty, spread)
        return "auto" if self.certainty is None else None


@dataclass(frozen=True)
class Allowed:
    """What a programme may cost."""

    runs: int | None = None
    hours: float | None = None
    turnaround: float = 10.0
    sensor: tuple[str, ...] = ()

    def budget(self) -> Any:
        """Return the budget."""
        from oed_sysid.design import Budget

        sensors = numbers("--sensor", self.sensor)
        return Budget(self.hours, self.runs, 60.0 * self.turnaround, sensors)


def _simulated(show: Shown, state: CellProgress) -> None:
    """Tell how many parts of the vehicles are simulated."""
    show.say(f"simulating other vehicles, part {state.n_done} of {state.n_cells}")


def numbers(option: str, given: Sequence[str], form: str = "NAME=NUMBER") -> dict[str, float]:
    """Numbers by name, as an option writes them.

    >>> numbers("--goal", ["all=5%", "M_uw=3"])
    {'all': 5.0, 'M_uw': 3.0}
    """
    found = {}
    for text in given:
        name, _, number = text.partition("=")
        try:
            found[name.strip()] = float(number.rstrip("%"))
        except ValueError:
            raise DesignError(f"{option} {text}: write {form}.") from None
    return found


def band(option: str, text: str) -> tuple[float, float]:
    """Two frequencies, Hz, as an option writes them.

    >>> band("--waves", "0.05:0.2")
    (0.05, 0.2)
    """
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        low, high = 1.0, 0.0
    if not 0 <= low < high:
        raise DesignError(f"{option} {text}: write bands as 0.1:0.2, LOW:HIGH in Hz.")
    return low, high


def patterns_of(problem: Problem, names: Sequence[str] | None) -> list[Experiment]:
    """Experiments that lend settings: those named, or all of the problem."""
    if not (names or problem.experiments):
        raise ProblemError(
            f"Problem {problem.name!r} has no experiment to take settings from. Add one to its "
            "problem.py."
        )
    return [problem.experiment(name) for name in names or problem.experiments]


# -- what is asked -----------------------------------------------------------------------


def check(study: Study, show: Shown) -> Outcome:
    """Check logs for faults before any model: signs, units, axes, bias, delay, spikes and more.

    Ends with exit code 4 when the log is suspect.

    [bold]Example[/bold]: oed-sysid check remus_diving_plane dive_*.csv --html check.html
    """
    records = study.records()  # a fault between the two, such as the same run in both, as well
    found = oed_sysid.check(records, study.problem)
    # Where no equation relates the signals, the log itself is what there is to see.
    log = Figure("figure_record", next(iter(records)), "")
    return Outcome(
        found, found.document(), found.to_dict(),
        partial(found.document, records, title=study.problem.title),
        Figure("figure_check", found, "") if found.balances else log,
        status=_status([], suspect=found.suspect),
    )  # fmt: skip


def fit(study: Study, show: Shown) -> Outcome:
    """Estimate the parameters of a problem's model from measured records.

    [bold]Example[/bold]: oed-sysid fit remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv --save fit.json
    """
    from oed_sysid.data.dataset import check_disjoint
    from oed_sysid.evidence.check import advised, with_estimates

    model, train = study.problem.model, study.training()
    if study.test is not None:
        check_disjoint(train, study.test)
    log = oed_sysid.check(train, study.problem)
    study, left_out = _as_measured(study, log)
    result = fits_of(study, {"": model}, show)[""]
    before, log = log, with_estimates(log, result)
    told = (one.says for one in log.findings if one not in before.findings and not one.suspect)
    above = _above(log, "\n".join(filter(None, (left_out, *told))))
    result = advised(result, log)
    facts = {**result.to_dict(), "log": log.to_dict()}
    text, comparison, figure = result.report(), None, Figure("figure_fit", result, "")
    if study.test is not None:
        show.say("predicting")
        comparison = oed_sysid.compare({model.name: result}, study.test)
        text += f"\n\n{comparison.report()}"
        facts["validation"] = comparison.to_dict()
        figure = predicted([comparison.best])
    return Outcome(
        result, result.document(comparison), facts, partial(result.document, comparison, log=log),
        figure, text, above, fits={NOMINAL: result}, comparison=comparison,
        status=_status([result], suspect=log.suspect),
    )  # fmt: skip


def compare(
    study: Study, show: Shown, *, added: tuple[str, ...] = (), frequency: bool = False
) -> Outcome:
    """Fit to training records and say where predictions of validation records fail.

    [bold]Example[/bold]: oed-sysid compare remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv
    """
    from oed_sysid.data.dataset import check_disjoint

    study.training()
    validation = study.validation()
    models, saved = _models(study.equipped if added else study.problem, added)
    for one in saved.values():
        check_disjoint(one.dataset, validation)
    log = _log_of(study)
    study, left_out = _as_measured(study, log)
    outcome = _compared(study, show, fits_of(study, models, show) | saved, log, left_out)
    if frequency and outcome.comparison is not None:
        return _with_frequency(outcome, outcome.comparison)
    return outcome


def _with_frequency(outcome: Outcome, comparison: Comparison) -> Outcome:
    """A comparison with the frequency responses of records and models."""
    from oed_sysid.evidence.frequency import compare_frequency

    found = compare_frequency(comparison)

    def added(document: Report) -> Report:
        return replace(document, sections=(*document.sections, found.section()))

    make = outcome.document
    facts = {**outcome.facts, "frequency": found.to_dict()}
    return replace(outcome, said=added(outcome.said), facts=facts, make=lambda: added(make()))


def _as_measured(study: Study, log: LogCheck) -> tuple[Study, str]:
    """The study with only what was measured in its training records, and words on the rest."""
    from oed_sysid.evidence.corrections import as_measured

    train, left_out = as_measured(study.training(), log)
    return replace(study, train=train), "\n".join(left_out)


def _above(log: LogCheck, left_out: str) -> str:
    """What stands above a result: what is wrong with the log, and what was left out of it."""
    return "\n".join(filter(None, (log.warning(), left_out)))


def _log_of(study: Study) -> LogCheck:
    """Check of training and validation records together, which have no run in common."""
    from oed_sysid.data.dataset import check_disjoint, together

    train, validation = study.training(), study.validation()
    check_disjoint(train, validation)
    return oed_sysid.check(together(train, validation), study.problem).without("duplicate")


def reduce(study: Study, show: Shown, *, keep: tuple[str, ...] = ()) -> Outcome:
    """Fix what training records cannot tell, fit the smaller model, and check it on validation.

    [bold]Example[/bold]: oed-sysid reduce remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv
    """
    from oed_sysid.evidence.chance import threshold

    log, model = _log_of(study), study.problem.model
    study, left_out = _as_measured(study, log)
    fits = fits_of(study, {NOMINAL: model}, show)
    full = fits[NOMINAL]
    ranking = oed_sysid.rank_parameters(
        full.model, study.training(), noise=full, initial_states=full.initial_states
    )
    fixed = [name for name in ranking.together.advised("fix") if name not in keep]
    told = ranking.together.words(" from these records")
    lost = 0.0
    if fixed:
        fits |= fits_of(study, {"reduced": model.fix(*fixed)}, show)
        lost = 2.0 * (full.log_likelihood - fits["reduced"].log_likelihood)
        chance = threshold(1, len(fixed))
        told += (
            f" With {', '.join(fixed)} fixed at their nominal values twice the log-likelihood "
            f"falls by {lost:.3g}; chance alone takes {chance:.3g} in one case of a hundred: "
        ) + (
            "the records do not miss them."
            if lost <= chance
            else "these values are wrong. Keep some of them free (--keep), or correct them."
        )
    outcome = _compared(study, show, fits, log, left_out)
    more = {"fixed": fixed, "lost": lost, "subset": ranking.together.to_dict()}
    sections = (*outcome.said.sections, *ranking.together.document().sections)
    said = replace(outcome.said, answer=told, sections=sections)
    return replace(outcome, said=said, facts={**outcome.facts, **more})


def _compared(
    study: Study, show: Shown, fits: Mapping[str, Fit], log: LogCheck, left_out: str
) -> Outcome:
    """What validation records say of several fits."""
    from oed_sysid.evidence.check import advised, with_estimates

    validation = study.validation()
    show.say("predicting")
    result = oed_sysid.compare(fits, validation)
    log = with_estimates(log, fits[result.best.label])
    fits = {name: advised(one, log) for name, one in fits.items()}
    notes = [
        f"The fit of {n} ended as {one.status}" for n, one in fits.items() if not one.status.ok
    ]
    for name, one in fits.items():
        notes += [f"Do not use the fit of {name}: {concern.text}" for concern in one.grave]
    return Outcome(
        result, result.document(), {**result.to_dict(), "log": log.to_dict()},
        partial(result.document, title=study.problem.title, log=log), predicted(result.models),
        above=_above(log, left_out), notes=tuple(notes), fits=dict(fits), comparison=result,
        status=_status(list(fits.values()), suspect=log.suspect),
    )  # fmt: skip


def predicted(models: Sequence[ModelMisfit]) -> Figure:
    """Return the picture of what models of a comparison predict."""
    options = {"labels": [part.label for part in models]}
    return Figure("figure_predictions", [part.prediction for part in models], "", options=options)


def _candidates(problem: Problem, show: Shown) -> Sequence[Effect]:
    """The candidates of a problem; which of its lists it has left out is noted."""
    if problem.lacking:
        show.note(f"Candidates left out: {problem.lacking}.")
    return problem.effects


def diagnose(study: Study, show: Shown) -> Outcome:
    """Say where a model fails and which effects may be missing, without adding any.

    [bold]Example[/bold]: oed-sysid diagnose remus_diving_plane dive_1.csv dive_2.csv
    """
    problem, train = study.problem, study.training()
    log = oed_sysid.check(train, problem)
    show.say("looking where the model fails, and scoring all candidates")
    result = oed_sysid.diagnose(
        problem.model, train, candidates=_candidates(problem, show), known_noise=study.known_noise,
        disturbances=study.acting,
    )  # fmt: skip
    return Outcome(
        result, result.document(), result.to_dict(),
        partial(result.document, train, title=problem.title),
        Figure("figure_diagnosis", result.location, "", (result.ranking,)),
        above=log.warning(), status=_status([], suspect=log.suspect),
    )  # fmt: skip


def improve(study: Study, show: Shown, *, max_effects: int = 4, no_terms: bool = False) -> Outcome:
    """Find the effects that a model lacks, and test the claim on validation records.

    [bold]Example[/bold]: oed-sysid improve remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv --save better.json
    """
    problem = study.problem
    result = oed_sysid.improve(
        problem.model, study.training(), study.test, candidates=_candidates(problem, show),
        known_noise=study.known_noise, disturbances=study.acting, max_effects=max_effects,
        terms=not no_terms, progress=partial(_round, show, max_effects), journal=show.journal,
    )  # fmt: skip
    fits = {NOMINAL: result.base_fit} | ({IMPROVED: result.fit} if result.steps else {})
    show.say("predicting")
    # What the search itself has read and judged on.
    read, sigma = result.yardstick.records, result.yardstick.sigma
    comparison = oed_sysid.compare(fits, read.get("test", read["train"]), sigma=sigma)
    return Outcome(
        result, result.document(), result.to_dict(),
        partial(result.document, comparison, train=read["train"], title=problem.title),
        Figure("plot_error_fall", result, "", size=None), fits=fits, comparison=comparison,
        status=_status([], suspect=bool(result.remains.suspect)),
    )  # fmt: skip


@dataclass(frozen=True)
class Assumed:
    """What a ranking takes as given: noise of the sensors, a sea, and what is known besides."""

    noise: tuple[str, ...] = ()
    sea: str | None = None
    priors: str | None = None
    after: Path | None = None

    def measured(self, model: Model) -> Model:
        """The model with these standard deviations of its outputs."""
        levels = numbers("--noise", self.noise, "OUTPUT=STD, such as r=0.001")
        located(DesignError, "--noise: there is no output", levels, model.output_names)
        outputs = (replace(o, noise_std=levels.get(o.name, o.noise_std)) for o in model.outputs)
        return replace(model, outputs=tuple(outputs)) if levels else model

    def known(self, model: Model) -> Any:
        """Nothing, the problem's priors, or every value to a share."""
        if self.priors in (None, "none", "model"):
            return "model" if self.priors == "model" else None
        try:
            share = float(self.priors or "")
        except ValueError:
            share = 0.0
        if not share > 0:
            raise DesignError(f"--priors is {self.priors!r}. Give none, model, or a share as 0.3.")
        return {p.name: share * p.reference for p in model.free_parameters}


def rank(
    study: Study, show: Shown, *, experiment: tuple[str, ...] = (), assumed: Assumed = Assumed()
) -> Outcome:
    """Rank parameters by what experiments tell about them, before fitting anything.

    [bold]Example[/bold]: oed-sysid rank remus_diving_plane --experiment zigzag_5_5 steps
    """
    problem, found = study.problem, known(study, assumed.after, show)
    model = assumed.measured(found if isinstance(found, oed_sysid.Model) else found.model)
    if study.train is not None and experiment:
        raise ProblemError("Give either --experiment or records, not both.")
    runs: Any = study.train
    if runs is None:
        runs = [problem.experiment(name) for name in experiment or problem.experiments]
    if not runs:
        raise ProblemError(
            f"Problem {problem.name!r} has no experiments. Add one to its problem.py, or give "
            "records."
        )
    show.say("computing sensitivities")
    planned = runs if study.train is None else ()
    forces = Weather(sea=assumed.sea).noise(problem, model, show, planned)
    ranking = oed_sysid.rank_parameters(model, runs, noise=forces, priors=assumed.known(model))
    facts = {"ranking": ranking.to_dict(), "subset": ranking.together.to_dict()}
    picture = Figure("plot_sensitivity", ranking, "", size=None)
    return Outcome(ranking, ranking.document(title=problem.title), facts, figure=picture)


def design(
    study: Study,
    show: Shown,
    *,
    like: str | None = None,
    bounds: Bounds = Bounds(),
    aim: Aim = Aim(),
    expected: Expected = Expected(uncertainty=0.3),
    effort: Effort = Effort(),
) -> Outcome:
    """Design the manoeuvre that tells most about the parameters, within the limits.

    [bold]Example[/bold]: oed-sysid design auv_diving_plane --duration 120 --max-fin 10
    """
    import numpy as np

    from oed_sysid.design import Knowledge, Trial

    problem = study.problem
    pattern = patterns_of(problem, [like] if like else [])[0]
    limits = bounds.limits(problem, show)
    search, criterion = effort.search(), aim.made(study)
    nominal = known(study, expected.after, show)
    spread = None if expected.after else expected.uncertainty
    noise = expected.noise(problem, nominal, show, [pattern])
    with expected.spread(show):
        found = oed_sysid.design_experiment(
            nominal, Trial.like(pattern, limits, duration=bounds.duration),
            rng=np.random.default_rng(effort.seed), criterion=criterion, search=search,
            knowledge=Knowledge(noise=noise, spread=spread),
            caution=effort.caution(spread), journal=show.journal,
            progress=partial(_searching, show, search.n_starts, search.n_steps),
        )  # fmt: skip
        found = _on_other_vehicles(found, limits, spread, effort.seed, show)
    return Outcome(
        found, found.document(title=problem.title), found.to_dict(),
        figure=Figure("figure_design", found, ""), text=found.sea_trial_card(),
        settings={"seed": effort.seed},
    )  # fmt: skip


def programme(
    study: Study,
    show: Shown,
    *,
    patterns: tuple[str, ...] = (),
    allowed: Allowed = Allowed(),
    bounds: Bounds = Bounds(),
    aim: Aim = Aim("A"),
    expected: Expected = Expected(),
    rounds: int = 1,
    seed: int = 0,
) -> Outcome:
    """Plan several runs together: which, how often, in which order, and how near the optimum.

    [bold]Example[/bold]: oed-sysid programme remus_diving_plane --runs 5 --hours 2 --sea moderate
    """
    import numpy as np

    from oed_sysid.design import Knowledge, ProgrammeSearch, design_programme

    problem = study.problem
    nominal = known(study, expected.after, show)
    durations = None if bounds.duration is None else (bounds.duration,)
    lent = patterns_of(problem, patterns)
    noise = expected.noise(problem, nominal, show, lent)
    with expected.spread(show):
        found = design_programme(
            nominal, lent, limits=bounds.limits(problem, show),
            rng=np.random.default_rng(seed), budget=allowed.budget(), criterion=aim.made(study),
            knowledge=Knowledge(noise=noise, spread=expected.uncertainty),
            search=ProgrammeSearch(durations=durations, n_rounds=rounds), progress=show.say,
        )  # fmt: skip
    return Outcome(
        found, found.document(title=problem.title), found.to_dict(),
        figure=Figure("figure_programme", found, ""),
        notes=(f"Planned in {found.seconds:.0f} s.",),
    )  # fmt: skip


def fits_of(study: Study, models: Mapping[str, Model], show: Shown) -> dict[str, Fit]:
    """One fit of each model; those that an interrupted call has finished are read."""
    from oed_sysid.likelihood.archive import encode

    train, keep = study.training(), show.journal
    settings: dict[str, Any] = {"noise": study.noise, "disturbances": study.acting}
    estimator = oed_sysid.MultipleShooting(**settings, progress=show.iteration)
    content = {
        "task": "fit",
        "models": [encode(model) for model in models.values()],
        "records": [[record.name, record.content_hash] for record in train],
        **settings,
    }
    keep.open(content, shared={"records": train})
    fits: dict[str, Fit] = {}
    for name, model in models.items():
        show.say(f"fitting {name or model.name}")

        def work(name: str = name, model: Model = model) -> Fit:
            fits[name] = estimator.fit(model, train, warm=keep.state())
            if fits[name].status.code == "interrupted":
                keep.keep(fits[name])
            return fits[name]

        try:
            fits[name] = keep.once(f"fit {name}", work)
        except KeyboardInterrupt:
            # The best so far is worth a report where it is all that was asked for.
            if name not in fits or len(models) > 1:
                raise
    return fits


def _models(problem: Problem, added: Sequence[str]) -> tuple[dict[str, Model], dict[str, Fit]]:
    """The nominal model and one for each group of candidates added to it; and saved fits."""
    models, saved = {NOMINAL: problem.model}, {}
    known = {effect.name for effect in problem.effects}
    for group in added:
        names = [name.strip() for name in group.split("+")]
        is_path = group.lower().endswith(".json") or Path(group).exists()
        if is_path and not known.issuperset(names):
            one = oed_sysid.Fit.load(group)
            if one.model.channels != problem.channels:
                raise DataError(
                    f"{group} holds a fit of {one.model.name!r}, whose inputs and outputs are not "
                    f"those of {problem.name!r}: they cannot be compared on the same records."
                )
            saved[Path(group).stem] = one
            continue
        effects = [problem.effect(name) for name in names]
        models[f"with {' and '.join(effect.name for effect in effects)}"] = problem.model + effects
    return models, saved


def _status(fits: Sequence[Fit], *, suspect: bool) -> int:
    """Exit code that says whether fits can be used."""
    if any(one.status.code == "interrupted" for one in fits):
        return INTERRUPTED
    if suspect:
        return SUSPECT
    return NO_RESULT if any(one.grave or not one.status.ok for one in fits) else DONE


def _round(show: Shown, n_most: int, what: str) -> None:
    """Tell what is being done, and how long a search of so many rounds takes at most.

    The fit of the nominal model takes about as long as a round, and so does the search for the
    place where it fails, which comes after all rounds.
    """
    show.say(what)
    named = re.search(r"round (\d+)", what)
    done = int(named[1]) if named else (1 + n_most) * what.startswith("locating")
    show.share(done / (2 + n_most), at_most=True)


def _searching(show: Shown, n_starts: int, n_steps: int, now: Any) -> None:
    """Tell how far the search of a design is."""
    show.say(f"designing: start {now.start + 1}, round {now.round + 1}, {now.value:.4g}")
    # The three best starts are finished, in up to twice the rounds of the others.
    rounds = (n_starts + 2 * 3) * n_steps
    done = min(now.start, n_starts) + 2 * max(now.start - n_starts, 0)
    # Where other vehicles leave the limits the search begins again with stricter ones.
    done = (done * n_steps + now.round + 1) / rounds
    show.share(done, at_most=True, of="this pass")


def _on_other_vehicles(
    found: Design, limits: Limits, spread: float | None, seed: int, show: Shown
) -> Design:
    """State how likely the limits are kept and, at sea, how accurate other vehicles become."""
    import numpy as np

    from oed_sysid.design import accuracy_range, assess_limits
    from oed_sysid.design.vehicles import CHECKED

    model, run = found.model, found.experiment
    known: dict[str, Any] = {"spread": spread, "prior": found.prior}
    if found.assurance is None:
        show.say("simulating other vehicles")
        stated = partial(assess_limits, model, run, rng=np.random.default_rng(seed), limits=limits,
                         vehicles=CHECKED, sea=found.sea, **known)  # fmt: skip
        found = replace(found, assurance=show.journal.once("assurance", stated))
    if found.sea is not None:
        show.say("accuracy on other vehicles")
        other = partial(accuracy_range, model, run, rng=np.random.default_rng(seed),
                        noise=found.sea, **known)  # fmt: skip
        found = replace(found, spread=show.journal.once("accuracy", other))
    return found


# -- what is written ---------------------------------------------------------------------


def write_runs(
    records: Iterable[Record], folder: Path, option: str = "", sources: Sequence[Path] = ()
) -> list[Path]:
    """Write one CSV file per record into a folder.

    Raises
    ------
    DataError
        If one would take the place of a source or of another one; ``option`` names the folder.
    """
    every = list(records)
    files = {folder / f"{one.name.replace('/', '_')}.csv": one for one in every}
    if {file.resolve() for file in files} & {source.resolve() for source in sources}:
        raise DataError(
            f"The records in {str(folder)!r} would overwrite those that they are made of. Give "
            f"another folder to {option}."
        )
    if len(files) < len(every):
        names = ", ".join(repr(one.name) for one in every)
        raise DataError(f"Two of the records {names} would be one file. Rename one of them.")
    make_folder(folder)
    for file, record in files.items():
        oed_sysid.write_csv(record, file)
    return list(files)


@dataclass(frozen=True)
class Files:
    """Files that an outcome is written to, and what is said of each."""

    def before(self, study: Study) -> None:
        """Say before the work what cannot be written."""

    def write(self, outcome: Outcome, study: Study) -> Iterator[str]:
        """Write them."""
        yield from ()


@dataclass(frozen=True)
class Saved(Files):
    """The fit, with how it was made."""

    save: Path | None = None

    def write(self, outcome: Outcome, study: Study) -> Iterator[str]:
        """Write the fit."""
        if self.save is not None:
            command, settings = invocation()
            fit = getattr(outcome.result, "fit", outcome.result)
            fit.save(self.save, command=command, settings=settings)
            yield f"Written: {self.save}"


@dataclass(frozen=True)
class Corrected(Files):
    """Copies of the records in which the findings of a check are undone."""

    fix: Path | None = None

    def write(self, outcome: Outcome, study: Study) -> Iterator[str]:
        """Write the copies."""
        from oed_sysid.evidence.check import corrected_copies, why_not_more

        if self.fix is None:
            return
        records = study.records()
        copies, done = corrected_copies(records, study.problem, outcome.result)
        for target in write_runs(copies, self.fix, "--fix", [Path(one.source) for one in records]):
            yield f"Written: {target}"
        yield from (f"Corrected in the copies: {line}" for line in done)
        if reason := why_not_more(outcome.result):
            yield f"Not corrected: {reason}"
        if not done:
            yield "Nothing to correct: the copies equal the records."


@dataclass(frozen=True)
class Tables(Files):
    """Commands of every run of a programme."""

    out: Path | None = None

    def write(self, outcome: Outcome, study: Study) -> Iterator[str]:
        """Write the tables."""
        if self.out is not None:
            yield from (f"Written: {path}" for path in outcome.result.write(self.out))


@dataclass(frozen=True)
class Played(Files):
    """Commands of a design as those on board and their autopilots take them."""

    out: Path | None = None
    card: Path | None = None
    length: float | None = None
    servo: tuple[str, ...] = ()
    overrides: Path | None = None
    bag: Path | None = None
    controller: tuple[str, ...] = ()

    def before(self, study: Study) -> None:
        """Check the channels of the servos, and that no bag is in the way."""
        from oed_sysid.design.controllers import BY_SERVO

        if self.overrides is not None or {*BY_SERVO} & {*self._controllers()}:
            self._servos(study.problem.limits)
        if self.bag is not None and self.bag.exists():
            raise FileError(f"{str(self.bag)!r} exists already. Name a folder that does not.")

    def write(self, outcome: Outcome, study: Study) -> Iterator[str]:
        """Write table, card, pulses, bag and controllers.

        What one kind of file cannot hold is no reason to lose the others.
        """
        found, refused = outcome.result, []
        for path, write in self._writers(outcome, study.problem.title):
            try:
                write(path)
            except DesignError as error:
                refused.append(str(error))
            else:
                yield f"Written: {path}"
        if found.experiment.reacts and (self.overrides or self.bag):
            yield from self._as_table(found, outcome.settings["seed"])
        if refused:
            raise DesignError(" ".join(refused))

    def _writers(
        self, outcome: Outcome, title: str
    ) -> Iterator[tuple[Path, Callable[[Path], object]]]:
        """Every file that was asked for, and what writes it."""
        from oed_sysid import design
        from oed_sysid.design.controllers import BY_SERVO

        found, limits = outcome.result, outcome.result.experiment.limits
        table = found.model, found.trajectory.times, found.trajectory.inputs
        written: list[tuple[Path | None, Callable[[Path], object]]] = [
            (self.out, found.write_csv),
            (self.card, partial(self._write_card, outcome, title)),
            (self.overrides,
             lambda path: design.write_overrides(path, *table, servos=self._servos(limits))),
            (self.bag, lambda path: design.write_bag(path, *table)),
        ]  # fmt: skip
        yield from ((path, write) for path, write in written if path is not None)
        rules = None if found.assurance is None else found.assurance.rules
        for kind, place in self._controllers().items():
            servos = self._servos(limits) if kind in BY_SERVO else {}
            flown = partial(
                design.write_controller, model=found.model, experiment=found.experiment,
                kind=kind, aborts=rules, servos=servos,
            )  # fmt: skip
            yield place, flown

    def _as_table(self, found: Design, seed: int) -> Iterator[str]:
        """How surely limits are kept where a run that reacts is played as a table."""
        import numpy as np

        from oed_sysid import design

        closed = found.assurance
        if closed is not None and closed.limited:
            kept = design.assess_limits(
                found.model, design.played(found.model, found.experiment),
                rng=np.random.default_rng(seed), limits=found.experiment.limits,
                spread=closed.spread, prior=found.prior, vehicles=closed.n_checked, sea=found.sea,
            )  # fmt: skip
            yield f"Played as a table, without its feedback: {kept.report()}."

    def _controllers(self) -> dict[str, Path]:
        """Files of controllers by their kind."""
        from oed_sysid.cli.options import checked
        from oed_sysid.design.controllers import KINDS

        found = {}
        for text in self.controller:
            kind, _, place = text.partition("=")
            if kind not in KINDS or not place:
                raise DesignError(
                    f"--controller {text}: write KIND=FILE, a kind of {', '.join(KINDS)}."
                )
            found[kind] = checked("file", Path(place))
        return found

    def _write_card(self, outcome: Outcome, title: str, path: Path) -> None:
        """Write the card as text, as a page or as one sheet of A4."""
        from oed_sysid.results import figure_card, save_figure

        card, kind = outcome.result.card(self.length), path.suffix.lower()
        if kind == ".txt":
            write_text(path, card.text() + "\n")
        elif kind == ".html":
            card.document(title=title).write(path)
        else:
            save_figure(figure_card(card), path)

    def _servos(self, limits: Limits) -> dict[str, Servo]:
        """Servos of the inputs, from one end of their limits to the other."""
        from oed_sysid.design import Servo

        found = {}
        for text in self.servo:
            name, _, channel = text.partition("=")
            if name not in limits.inputs or not channel.isdigit():
                raise DesignError(
                    f"--servo {text}: write INPUT=CHANNEL, an input with a range: "
                    f"{', '.join(limits.inputs)}."
                )
            found[name] = Servo(int(channel), *limits.inputs[name])
        if not found:
            raise DesignError(
                "--overrides needs the channels of the inputs: --servo fin_command=1."
            )
        return found


TASKS = {
    one.name: one
    for one in (
        Task(check, "Check the log", "Checking", "files [validate]", Corrected, "--fix corrected"),
        Task(fit, "Fit", "Fitting", "files [validate] noise journal", Saved, "--save fit.json"),
        Task(compare, "Compare", "Fitting", "files validate noise journal"),
        Task(reduce, "Reduce: what the records can tell", "Fitting", "files validate noise"),
        Task(diagnose, "Diagnose: where it fails", "Looking", "files noise"),
        Task(improve, "Improve: what is missing", "Starting", "files [validate] noise journal",
             Saved, "--json improve.json --save improved.json"),
        Task(rank, "Rank: what trials tell", "Ranking", "[files]"),
        Task(design, "Design: the next trial", "Designing", "journal", Played,
             "--out design.csv --card card.txt"),
        Task(programme, "Programme: several runs", "Planning", "", Tables, "--out runs"),
    )
}  # fmt: skip
