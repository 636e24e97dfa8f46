"""The same in Python: a study as one script of calls of the public API."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from oed_sysid.cli.study import DEFAULT_MODEL, Study, Task, grouped
from oed_sysid.cli.tasks import Aim, Allowed, Assumed, Bounds, Effort, Expected

_HEAD = '''"""Repeats a study of {title}.

Put it beside the folders of the records (records.zip) and run it. It prints the reports, and writes
an HTML page and, of a fit, a file for `oed-sysid report` and `oed-sysid export`.
"""

from pathlib import Path

import numpy as np

import oed_sysid
from oed_sysid import MultipleShooting, load_problem, read_csv
from oed_sysid.cli.limit_words import with_limits
from oed_sysid.design import (
    Budget, Caution, Detect, Discriminate, Knowledge, Levels, Multisines, ProgrammeSearch, Pulses,
    Search, Trial, design_programme,
)
from oed_sysid.evidence.usual import equipped

HERE = Path(__file__).parent
problem = load_problem({source!r}{variant})
channels = problem.channels
train = {train}
test = {test}
estimator = MultipleShooting(noise={noise!r})
problem = equipped(problem, train)  # usual candidates, if it names none
'''
_FAMILIES = {"levels": "Levels()", "multisine": "Multisines()", "pulses": "Pulses()"}


def part_of(task: Task, study: Study, options: Mapping[str, Any]) -> str:
    """Return the lines that repeat a task; they follow :func:`whole`'s head.

    Examples
    --------
    >>> from oed_sysid.cli.tasks import TASKS
    >>> study = Study.named("remus_diving_plane")
    >>> print(part_of(TASKS["rank"], study, {"experiment": ("steps",)}))
    runs = [problem.experiment(name) for name in ['steps']]
    print(oed_sysid.rank_parameters(problem.model, runs).report())
    <BLANKLINE>
    """
    parameters = inspect.signature(task.run).parameters.values()
    defaults = {one.name: one.default for one in parameters if one.kind is one.KEYWORD_ONLY}
    return _PARTS[task.name](study, **defaults | grouped(task.run, options)).lstrip("\n")


def whole(study: Study, parts: Iterable[str]) -> str:
    """Return a script that does everything that was asked for.

    Parameters
    ----------
    study : Study
        Whose records stand beside the script, in ``train`` and ``test``.
    parts : iterable of str
        From :func:`part_of`.
    """
    reading = 'read_csv(HERE / "{}", channels)'
    head = _HEAD.format(
        title=study.problem.title.replace('"', "'").replace("\\", "/"),
        source=study.source,
        variant="" if study.variant == DEFAULT_MODEL else f", variant={study.variant!r}",
        train=reading.format("train") if study.train is not None else "None",
        test=reading.format("test") if study.test is not None else "None",
        noise=study.noise,
    )
    return "\n".join([head, *dict.fromkeys(parts)])


def _check(study: Study) -> str:
    both = study.train is not None and study.test is not None
    records = "oed_sysid.Dataset((*train, *test))" if both else "train" if study.train else "test"
    return f"""
records = {records}
print(oed_sysid.check(records, problem).report())
"""


def _fit(study: Study) -> str:
    judged = "" if study.test is None else "print(nominal.predict(test).report())\n"
    return f"""
nominal = estimator.fit(problem.model, train)
print(nominal.report())
nominal.save(HERE / "fit.json")
{judged}"""


def _compare(study: Study, added: tuple[str, ...]) -> str:
    names = [group.split("+") for group in added]
    models = "".join(
        f'models["with {" and ".join(one)}"] = problem.model + [{_effects(one)}]\n' for one in names
    )
    return f"""
models = {{"nominal": problem.model}}
{models}fits = {{name: estimator.fit(model, train) for name, model in models.items()}}
print(oed_sysid.compare(fits, test).report())
"""


def _diagnose(study: Study) -> str:
    return f"""
diagnosis = oed_sysid.diagnose(
    problem.model, train, candidates=problem.effects, known_noise={study.known_noise}
)
print(diagnosis.report())
"""


def _improve(study: Study, max_effects: int, no_terms: bool = False) -> str:
    return f"""
improvement = oed_sysid.improve(
    problem.model, train, test, candidates=problem.effects,
    known_noise={study.known_noise}, max_effects={max_effects}, terms={not no_terms},
)
print(improvement.report())
improvement.fit.save(HERE / "improved.json")
"""


def _rank(study: Study, experiment: tuple[str, ...], assumed: Assumed) -> str:
    runs = f"[problem.experiment(name) for name in {list(experiment)!r}]" if experiment else "train"
    more = ""
    if assumed.sea is not None:
        more = f", noise={_noise(Expected(sea=assumed.sea))}"
    elif assumed.noise:
        model = study.problem.model
        levels = {o.name: o.noise_std for o in model.outputs} | assumed.levels(model)
        more = f", noise={levels!r}"
    if (known := assumed.known(study.problem.model)) is not None:
        more += f", priors={known!r}"
    return f"""
runs = {runs}
print(oed_sysid.rank_parameters(problem.model, runs{more}).report())
"""


def _design(
    study: Study, like: str | None, bounds: Bounds, aim: Aim, expected: Expected, effort: Effort
) -> str:
    search = effort.search()
    numbers = f"{search.n_starts}, {search.n_candidates}, {search.n_steps}"
    spread = None if expected.after else expected.uncertainty
    caution: Any = effort.caution(expected, spread)
    if effort.certainty:
        caution = f"Caution({effort.certainty!r}, {spread!r})"
    return f"""
pattern = problem.experiment({like or next(iter(study.problem.experiments))!r})
limits, _ = with_limits(problem.model, problem.limits, {list(bounds.limit)!r})
nominal = {_nominal(expected)}
design = oed_sysid.design_experiment(
    nominal, Trial.like(pattern, limits, duration={bounds.duration!r}),
    rng=np.random.default_rng({effort.seed}), criterion={_criterion(aim)},
    search=Search({_FAMILIES[effort.family]}, {numbers}),
    knowledge=Knowledge(noise={_noise(expected)}),
    caution={caution if effort.certainty else repr(caution)},
)
print(design.report())
design.write_csv(HERE / "design.csv")
"""


def _programme(
    study: Study,
    patterns: tuple[str, ...],
    allowed: Allowed,
    bounds: Bounds,
    aim: Aim,
    expected: Expected,
    rounds: int,
    seed: int,
) -> str:
    names = list(patterns or study.problem.experiments)
    budget = f"Budget({allowed.hours!r}, {allowed.runs!r}, {60.0 * allowed.turnaround!r})"
    spread = expected.uncertainty if expected.after else expected.spread(study.problem)
    durations = None if bounds.duration is None else (bounds.duration,)
    return f"""
limits, _ = with_limits(problem.model, problem.limits, {list(bounds.limit)!r})
nominal = {_nominal(expected)}
programme = design_programme(
    nominal, [problem.experiment(name) for name in {names!r}],
    limits=limits, rng=np.random.default_rng({seed}), budget={budget},
    criterion={_criterion(aim)},
    knowledge=Knowledge(noise={_noise(expected)}, spread={spread!r}),
    search=ProgrammeSearch(durations={durations!r}, n_rounds={rounds}),
)
print(programme.report())
programme.write(HERE / "runs")
"""


def _nominal(expected: Expected) -> str:
    return "estimator.fit(problem.model, train)" if expected.after else "problem.model"


def _noise(expected: Expected) -> str:
    if expected.sea is None:
        return "None"
    sea = f"problem.model, {expected.sea!r}, problem.experiments.values()"
    return f"oed_sysid.information.sea_noise({sea})"


def _criterion(aim: Aim) -> str:
    if aim.discriminate:
        return f"Discriminate([{_effects(aim.discriminate)}])"
    if aim.reveal:
        chosen = "problem.effects" if aim.reveal == ("all",) else f"[{_effects(aim.reveal)}]"
        return f"Detect({chosen})"
    return f"oed_sysid.{aim.criterion}Optimal()"


def _effects(names: Iterable[str]) -> str:
    return ", ".join(f"problem.effect({name!r})" for name in names)


_PARTS: dict[str, Callable[..., str]] = {
    "check": _check, "fit": _fit, "compare": _compare, "diagnose": _diagnose,
    "improve": _improve, "rank": _rank, "design": _design, "programme": _programme,
}  # fmt: skip
