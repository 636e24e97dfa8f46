"""The same in Python: what would repeat the work of a page, and a whole study as one script."""

from __future__ import annotations

from collections.abc import Iterable

from oed_sysid.app.plans import DesignWish, ProgrammeWish
from oed_sysid.app.study import Study
from oed_sysid.design.choices import EFFORTS, UNCERTAINTY, usual_spread

_HEAD = '''"""Repeats a study of {title}.

Put it beside the folders of the records (records.zip) and run it. It prints the reports, and writes
an HTML page and, of a fit, a file for `oed-sysid report` and `oed-sysid export`.
"""

from pathlib import Path

import numpy as np

import oed_sysid
from oed_sysid import MultipleShooting, load_problem, read_csv

HERE = Path(__file__).parent
problem = load_problem({source!r}{variant})
channels = problem.channels
train = {train}
test = {test}
estimator = MultipleShooting(noise={noise!r})
'''


def check(study: Study) -> str:
    """Check the records."""
    both = study.train is not None and study.test is not None
    records = "oed_sysid.Dataset((*train, *test))" if both else "train" if study.train else "test"
    return _lines(
        f"records = {records}",
        "log = oed_sysid.check(records, problem)",
        "print(log.report())",
    )


def fit(study: Study) -> str:
    """Fit the nominal model, and predict the validation records."""
    lines = [
        "nominal = estimator.fit(problem.model, train)",
        "print(nominal.report())",
        'nominal.save(HERE / "fit.json")',
    ]
    if study.test is not None:
        lines.append("print(nominal.predict(test).report())")
    return _lines(*lines)


def compare(study: Study, groups: Iterable[tuple[str, ...]]) -> str:
    """Compare models on the validation records."""
    lines = ['models = {"nominal": problem.model}']
    for names in groups:
        effects = ", ".join(f"problem.effect({name!r})" for name in names)
        lines.append(f'models["with {" and ".join(names)}"] = problem.model + [{effects}]')
    return _lines(
        *lines,
        "fits = {name: estimator.fit(model, train) for name, model in models.items()}",
        "print(oed_sysid.compare(fits, test).report())",
    )


def diagnose(study: Study) -> str:
    """Say where the model fails."""
    return _lines(
        "diagnosis = oed_sysid.diagnose(",
        "    problem.model, train, candidates=problem.effects,",
        f"    known_noise={study.known_noise},",
        ")",
        "print(diagnosis.report())",
    )


def improve(study: Study, max_effects: int) -> str:
    """Find what is missing."""
    return _lines(
        "improvement = oed_sysid.improve(",
        "    problem.model, train, test, candidates=problem.effects,",
        f"    known_noise={study.known_noise}, max_effects={max_effects},",
        ")",
        "print(improvement.report())",
        'improvement.fit.save(HERE / "improved.json")',
    )


def rank(study: Study, experiments: tuple[str, ...]) -> str:
    """Rank parameters."""
    runs = f"[problem.experiment(name) for name in {list(experiments)!r}]"
    return _lines(
        f"runs = {runs if experiments else 'train'}",
        "print(oed_sysid.rank_parameters(problem.model, runs).report())",
    )


def design(study: Study, wish: DesignWish) -> str:
    """Design an experiment."""
    starts, candidates, steps = EFFORTS[wish.effort]
    family = {"levels": "Levels", "multisine": "Multisines", "pulses": "Pulses"}[wish.family]
    if wish.rivals:
        rivals = ", ".join(f"problem.effect({name!r})" for name in wish.rivals)
        criterion = f"Discriminate([{rivals}])"
    else:
        criterion = f"oed_sysid.{wish.criterion}Optimal()"
    ranges = {name: (lower, upper) for name, lower, upper in wish.ranges}
    corridors = {name: (lower, upper) for name, lower, upper in wish.corridors}
    caution = ""
    if wish.certainty is not None:
        spread = None if wish.after_fit else UNCERTAINTY
        caution = f"    caution=Caution({wish.certainty!r}, {spread!r}),"
    return _lines(
        "from dataclasses import replace",
        "",
        f"from oed_sysid.design import Caution, Discriminate, {family}, Search, Trial",
        "",
        f"pattern = problem.experiment({wish.like!r})",
        "limits = replace(",
        "    problem.limits,",
        f"    inputs={{**problem.limits.inputs, **{ranges!r}}},",
        f"    rates={{**problem.limits.rates, **{dict(wish.rates)!r}}},",
        f"    signals={{**problem.limits.signals, **{corridors!r}}},",
        ")",
        "nominal = estimator.fit(problem.model, train)"
        if wish.after_fit
        else "nominal = problem.model",
        "design = oed_sysid.design_experiment(",
        f"    nominal, Trial.like(pattern, limits, duration={wish.duration!r}),",
        f"    rng=np.random.default_rng({wish.seed}), criterion={criterion},",
        f"    search=Search({family}(), n_starts={starts}, n_candidates={candidates}, "
        f"n_steps={steps}),",
        *([caution] if caution else []),
        ")",
        "print(design.report())",
        'design.write_csv(HERE / "design.csv")',
    )


def programme(study: Study, wish: ProgrammeWish) -> str:
    """Plan several runs."""
    return _lines(
        "from oed_sysid.design import Budget, Knowledge, design_programme",
        "",
        "programme = design_programme(",
        "    problem.model, list(problem.experiments.values()), limits=problem.limits,",
        f"    budget=Budget({wish.hours!r}, {wish.runs}, {60.0 * wish.turnaround!r}),",
        f"    knowledge=Knowledge(spread={usual_spread(study.problem.model)!r}),",
        f"    criterion=oed_sysid.{wish.criterion}Optimal(), "
        f"rng=np.random.default_rng({wish.seed}),",
        ")",
        "print(programme.report())",
        'programme.write(HERE / "runs")',
    )


def whole(study: Study, parts: Iterable[str]) -> str:
    """Return a script that does everything that was asked for.

    Parameters
    ----------
    study : Study
        Whose records stand beside the script, in ``train`` and ``test``.
    parts : iterable of str
        What the functions above return.
    """
    variant = "" if study.variant == "default" else f", variant={study.variant!r}"
    reading = 'read_csv(HERE / "{}", channels)'
    head = _HEAD.format(
        title=study.problem.title.replace('"', "'").replace("\\", "/"),
        source=study.source,
        variant=variant,
        train=reading.format("train") if study.train is not None else "None",
        test=reading.format("test") if study.test is not None else "None",
        noise=study.noise,
    )
    if study.is_equipped:
        head += (
            "# The problem names no candidate effects: usual ones, with sizes from the records.\n"
            "from oed_sysid.evidence.usual import equipped\n\n"
            "problem = equipped(problem, train)\n"
        )
    return "\n".join([head, *dict.fromkeys(parts)])


def _lines(*lines: str) -> str:
    return "\n".join(lines) + "\n"
