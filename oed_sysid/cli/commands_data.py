"""Commands around problems, records and models: problems, new, simulate, export, app."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from oed_sysid.cli.terminal import answer, draw, note, progress, quiet, say, store, table
from oed_sysid.errors import DataError, OedSysidError, ProblemError
from oed_sysid.runtime.files import check_place

if TYPE_CHECKING:
    from oed_sysid.experiments.experiment import Experiment
    from oed_sysid.experiments.problem import Problem


def problems(
    problem: str | None = None,
    model: str | None = None,
    json_file: Path | None = None,
) -> None:
    """List the shipped problems, or describe one.

    [bold]Example[/bold]: oed-sysid problems remus_diving_plane
    """
    from oed_sysid.experiments.problem import list_problems, load_problem

    if problem is not None:
        chosen = load_problem(problem, variant=model)
        first, *rest = chosen.describe().splitlines()
        answer(first, "\n".join(rest))
        say("\nEquations of motion")
        say("\n".join(f"  {line}" for line in chosen.model.equations().splitlines()))
        say("\nExperiments")
        say("\n".join(f"  {run.describe()}" for run in chosen.experiments.values()) or "  none")
        facts = _summary(chosen) | {"equations": chosen.model.equations().splitlines()}
        if notes := chosen.notes():
            facts["notes"] = list(notes)
        store(facts, json_file)
        return
    found, rows = [], []
    for name in list_problems():
        try:
            one = load_problem(name)
        except OedSysidError as error:
            # One faulty folder must not hide the others.
            note(f"Problem {name!r} cannot be loaded: {error}")
            continue
        found.append(one)
        rows.append((name, str(len(one.model.free_names)), str(len(one.effects)), one.title))
    if quiet():
        answer(" ".join(one.name for one in found))
    else:
        table(("problem", "parameters", "candidates", "title"), rows)
    store({"problems": [_summary(one) for one in found]}, json_file)


def new(
    folder: Path,
    template: str = "generic",
    log: Path | None = None,
    inputs: list[str] | None = None,
) -> None:
    """Write a starter folder for a vehicle of your own.

    [bold]Example[/bold]: oed-sysid new my_auv --template auv
    """
    from oed_sysid.experiments.problem import new_problem

    made = new_problem(folder, template=template, log=log, inputs=tuple(inputs or ()))
    answer(f"Written: {made}")
    folder_word = shlex.quote(str(made))
    say(f"Next: edit {Path(made) / 'problem.py'}, then run  oed-sysid problems {folder_word}")


def simulate(
    problem: str,
    experiment: list[str] | None = None,
    out: Path | None = None,
    model: str | None = None,
    seed: int = 0,
    no_noise: bool = False,
    truth: bool = False,
    picture: Path | None = None,
) -> None:
    """Simulate experiments of a problem and write what would be logged as CSV.

    [bold]Example[/bold]: oed-sysid simulate remus_diving_plane --out runs/
    """
    import numpy as np

    from oed_sysid.data.dataset import write_csv
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.experiments.simulation import simulate as run

    chosen = load_problem(problem, variant=model)
    simulated = chosen.true_model() if truth else chosen.model
    wanted = _experiments(chosen, experiment or [])
    files = _files(wanted, out)
    for file in files:
        check_place(file)
    rng = np.random.default_rng(seed)
    records = []
    with progress("Simulating") as show:
        for number, (one, file) in enumerate(zip(wanted, files, strict=True)):
            show.say(f"simulating {one.name}")
            records.append(run(simulated, one, rng=rng, noise=not no_noise))
            write_csv(records[-1], file)
            show.share((number + 1) / len(wanted))
    for one, file in zip(wanted, files, strict=True):
        answer(str(file)) if quiet() else say(f"{file}: {one.describe()}")
    if picture is not None:
        from oed_sysid.results import figure_record

        draw(partial(figure_record, records[0]), picture)
        if len(records) > 1:
            note(f"The picture shows {records[0].name}; choose another with --experiment.")
    if chosen.truth and not truth:
        note("Simulated with the nominal values; --truth simulates the problem's truth.")


def _experiments(problem: Problem, names: list[str]) -> list[Experiment]:
    if names:
        return [problem.experiment(name) for name in names]
    if not problem.experiments:
        raise ProblemError(
            f"Problem {problem.name!r} has no experiments. Add one to its problem.py: "
            "experiments={'name': Experiment(...)}."
        )
    return list(problem.experiments.values())


def _files(experiments: list[Experiment], out: Path | None) -> list[Path]:
    """File of each experiment; ``out`` names a file or a folder."""
    if out is not None and out.suffix.lower() == ".csv" and not out.is_dir():
        if len(experiments) > 1:
            raise DataError(
                f"{out} is one file, but there are {len(experiments)} experiments: "
                f"{', '.join(one.name for one in experiments)}. Choose one with --experiment, or "
                "give a folder."
            )
        return [out]
    return [(out or Path()) / f"{one.name}.csv" for one in experiments]


def _summary(problem: Problem) -> dict[str, object]:
    return {
        "name": problem.name,
        "title": problem.title,
        "models": list(problem.variants),
        "inputs": list(problem.model.input_names),
        "outputs": list(problem.model.output_names),
        "free_parameters": list(problem.model.free_names),
        "candidates": [effect.name for effect in problem.effects],
        "experiments": list(problem.experiments),
    }


def export(
    fit: Path,
    kind: str,
    out: Path = Path("model"),
    at: list[str] | None = None,
) -> None:
    """Write a fitted model for another program, with the covariance of its parameters.

    [bold]Example[/bold]: oed-sysid export better.json --as c --out my_auv_c
    """
    from oed_sysid.export import export as write
    from oed_sysid.likelihood.fit import Fit

    trim = {}
    for text in at or ():
        name, _, value = text.partition("=")
        try:
            trim[name.strip()] = float(value)
        except ValueError:
            raise DataError(f"--at {text!r} is no NAME=VALUE. Write --at u=1.5, say.") from None
    result = Fit.load(fit)
    files = list(write(result, kind, out, trim=trim or None))
    n = len(result.names)
    answer(f"{result.model.name} as {kind}, with {n} parameters and their covariance: {files[0]}")
    for file in files[1:]:
        say(str(file))
    if not result.status.ok:
        note(f"The fit ended as {result.status}")


def app(
    problem: str | None = None,
    port: int = 8501,
    no_browser: bool = False,
) -> None:
    """Open the same in a browser, on this computer only. Needs the extra 'app'.

    [bold]Example[/bold]: oed-sysid app remus_diving_plane
    """
    from oed_sysid.app.launch import start

    start(problem, port=port, browser=not no_browser)
