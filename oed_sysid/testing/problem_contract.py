"""The contract of a problem folder, to be run on every problem that is added.

>>> import tempfile
>>> from pathlib import Path
>>> from oed_sysid.experiments.problem import new_problem
>>> with tempfile.TemporaryDirectory() as place:
...     check_problem(new_problem(Path(place) / "my_ship"), rng=np.random.default_rng(1))
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.problem import Problem, load_problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.information import information_of
from oed_sysid.physics import Effect
from oed_sysid.testing.effect_contract import check_effect

# What a README speaks of, and words that show it does.
TOPICS = {
    "where it comes from": r"source|paper|doi|published|reference|simulated from",
    "its axes or units": r"\baxes\b|\bunits?\b|\bSI\b|positive|\brad\b",
}
# What success means stands under a heading or a bold word of its own.
SUCCESS = r"^(#+ .*|\*\*[^*]*)success"
# Errors of an unmeasured output have no size; any will do to see what influences what.
ANY_NOISE = 1e-2


def check_problem(
    name_or_folder: str | Path,
    *,
    rng: np.random.Generator,
    effects: bool = True,
    records: bool = True,
) -> None:
    """Check everything that the commands rely on in a problem folder.

    * It loads, so that dimensions follow from its terms, and its README says where it comes
      from, in which axes or units, and what success means. In which unit bare numbers
      were read is printed.
    * Every candidate effect keeps the contract of :func:`check_effect`, among it that it
      is absent at zero; the problem's references may stand for its own.
    * Every experiment can be simulated, within finite numbers.
    * Its records can be read, and have the model's channels.
    * Every free parameter influences the experiments or records in a way of its own, or
      the README names it.

    Parameters
    ----------
    name_or_folder : str or Path
        As for :func:`oed_sysid.load_problem`.
    rng : numpy.random.Generator
        Source of the random points.
    effects : bool
        Whether to check the candidates, which takes about a second each.
    records : bool
        Whether to read the records; they may be third-party data that is not there.

    Raises
    ------
    AssertionError
        With a line for every broken promise.
    """
    try:
        problem = load_problem(name_or_folder)
    except OedSysidError as error:
        raise AssertionError(f"Problem {name_or_folder}:\n- does not load: {error}") from None
    for note in problem.notes():
        print(f"Problem {problem.name!r}: {note}")
    text, broken = _readme(name_or_folder)
    data = None
    if records and problem.records is not None:
        data, more = _records(problem)
        broken += more
    broken += _simulations(problem)
    broken += _identifiable(problem, data, text)
    if effects:
        for effect in problem.effects:
            broken += _effect(problem, effect, rng)
    if broken:
        lines = "\n".join(f"- {line}" for line in broken)
        raise AssertionError(f"Problem {problem.name!r}:\n{lines}")


def _readme(name_or_folder: str | Path) -> tuple[str, list[str]]:
    shipped = catalogue_folder()
    folder = Path(name_or_folder).expanduser()
    if shipped is not None and (shipped / str(name_or_folder)).is_dir():
        folder = shipped / str(name_or_folder)
    file = (folder if folder.is_dir() else folder.parent) / "README.md"
    if not file.is_file():
        return "", [f"has no README.md in {file.parent}"]
    text = file.read_text(encoding="utf-8")
    broken = [
        f"README.md does not say {topic}"
        for topic, words in TOPICS.items()
        if not re.search(words, text, re.IGNORECASE)
    ]
    if not re.search(SUCCESS, text, re.IGNORECASE | re.MULTILINE):
        broken.append("README.md has no heading or bold word that says what success means")
    return text, broken


def _records(problem: Problem) -> tuple[Dataset | None, list[str]]:
    try:
        data = problem.data()
    except OedSysidError as error:
        return None, [f"its records cannot be read: {error}"]
    broken = []
    if not len(data):
        broken.append("its records are none")
    elif data.channels.output_names != problem.channels.output_names:
        broken.append(
            f"its records hold {data.channels.output_names}, its model measures "
            f"{problem.channels.output_names}"
        )
    broken += [
        f"record {record.name!r} holds no measurement"
        for record in data
        if not np.isfinite(record.outputs).any()
    ]
    return data, broken


def _simulations(problem: Problem) -> list[str]:
    broken = []
    for name, experiment in problem.experiments.items():
        try:
            record = simulate(problem.model, experiment, noise=False)
        except OedSysidError as error:
            broken.append(f"experiment {name!r} cannot be simulated: {error}")
            continue
        if not (np.isfinite(record.outputs).all() and np.isfinite(record.inputs).all()):
            broken.append(f"experiment {name!r} leaves the numbers")
    return broken


def _identifiable(problem: Problem, data: Dataset | None, readme: str) -> list[str]:
    """Combinations of free parameters that nothing shows and the README does not name."""
    runs: list[Experiment] | Dataset = list(problem.experiments.values())
    runs = runs or data or []
    if not runs or not problem.model.free_parameters:
        return []
    noise = {o.name: o.noise_std or ANY_NOISE for o in problem.model.outputs}
    try:
        information = information_of(problem.model, runs, noise=noise, priors=None)
    except OedSysidError as error:
        return [f"what its parameters do cannot be told: {error}"]
    broken = []
    for words in information.null_directions():
        named = [n for n in information.names if re.search(rf"\b{re.escape(n)}\b", words)]
        if not any(re.search(rf"\b{re.escape(n)}\b", readme) for n in named):
            broken.append(f"not identifiable, and README.md does not say so: {words}")
    return broken


def _effect(problem: Problem, effect: Effect, rng: np.random.Generator) -> list[str]:
    inputs = {
        name: bounds
        for name, bounds in problem.limits.inputs.items()
        if name in problem.model.input_names and np.isfinite(bounds).all()
    }
    starts = [e.initial for e in problem.experiments.values()]
    initial = {k: v for k, v in (dict(starts[0]) if starts else {}).items()
               if k in problem.model.state_names}  # fmt: skip
    try:
        check_effect(
            effect, problem.model, rng=rng, initial=initial, inputs=inputs, n_times=20, n_points=1
        )
    except AssertionError as error:
        lines = str(error).split("\n- ")[1:]
        # The problem's own references may be those of its candidates; and without an experiment
        # nobody says where a run begins that would wake an effect up.
        if problem.references:
            lines = [line for line in lines if line != "has no source"]
        if not problem.experiments:
            lines = [line for line in lines if "changes no output" not in line]
        return [f"candidate {effect.name!r} {line}" for line in lines]
    return []
