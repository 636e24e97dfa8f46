"""Commands that are no tasks of a study: problems, records, saved fits, campaigns, benchmarks."""

from __future__ import annotations

import importlib
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

import oed_sysid
from oed_sysid.cli import SUSPECT
from oed_sysid.cli.reading import read_records
from oed_sysid.cli.study import Study
from oed_sysid.cli.tasks import Bounds, Weather, numbers, patterns_of, predicted, write_runs
from oed_sysid.cli.tasks import band as band_of
from oed_sysid.cli.terminal import answer, asked, draw, note, progress, quiet, say, store, write
from oed_sysid.errors import DataError, DesignError, OedSysidError
from oed_sysid.runtime.display import Figure, Table, as_dict, counted
from oed_sysid.runtime.files import check_place, write_text

if TYPE_CHECKING:
    from oed_sysid import Experiment, Fit, Model, Problem
    from oed_sysid.baselines.fourier import FourierStream
    from oed_sysid.data.logs import Log, LogMapping
    from oed_sysid.runtime.display import Report
    from oed_sysid.runtime.parallel import CellProgress


def problems(
    problem: str | None = None,
    model: str | None = None,
) -> None:
    """List the shipped problems, or describe one.

    [bold]Example[/bold]: oed-sysid problems remus_diving_plane
    """
    if problem is not None:
        store(_described(oed_sysid.load_problem(problem, variant=model)))
        return
    found = []
    for name in oed_sysid.list_problems():
        try:
            found.append(oed_sysid.load_problem(name))
        except OedSysidError as error:
            # One faulty folder must not hide the others.
            note(f"Problem {name!r} cannot be loaded: {error}")
    rows = [(p.name, str(len(p.model.free_names)), str(len(p.effects)), p.title) for p in found]
    if quiet():
        answer(" ".join(one.name for one in found))
    else:
        headers = ("problem", "parameters", "candidates", "title")
        say("\n".join(Table(headers, rows, words=(3,)).lines()))
    store({"problems": [_summary(one) for one in found]})


def _described(problem: Problem) -> dict[str, object]:
    """Describe a problem, and return the facts."""
    equations = problem.model.equations().splitlines()
    runs = [run.describe() for run in problem.experiments.values()] or ["none"]
    _answer(problem.describe())
    for title, lines in (("Equations of motion", equations), ("Experiments", runs)):
        say("\n".join([f"\n{title}", *(f"  {line}" for line in lines)]))
    notes = {"notes": list(problem.notes())} if problem.notes() else {}
    return {**_summary(problem), "equations": equations, **notes}


def _answer(text: str) -> None:
    """Print a text whose first line is the answer."""
    first, _, rest = text.partition("\n")
    answer(first, rest)


_summary = as_dict(
    "name", "title", models="variants", inputs="model.input_names", outputs="model.output_names",
    free_parameters="model.free_names", experiments=lambda problem: [*problem.experiments],
    candidates=lambda problem: [effect.name for effect in problem.effects],
)  # fmt: skip


def new(
    folder: Path,
    template: str = "generic",
    log: Path | None = None,
    inputs: list[str] | None = None,
) -> None:
    """Write a starter folder for a vehicle of your own.

    [bold]Example[/bold]: oed-sysid new my_auv --template auv
    """
    made = oed_sysid.new_problem(folder, template=template, log=log, inputs=tuple(inputs or ()))
    answer(f"Written: {made}")
    # A mapping beside the records: fields were told by names and numbers, and some are asked.
    if log is not None and (made / "data" / "mapping.toml").exists():
        _told(log, oed_sysid.open_log(log), None, "", made)
        say("Commands are named with --input; a reading is corrected in data/mapping.toml there.")
    folder_word = shlex.quote(str(made))
    say(f"Next: edit {Path(made) / 'problem.py'}, then run  oed-sysid problems {folder_word}")
    store({"folder": str(made)})


def simulate(
    problem: str,
    experiment: list[str] | None = None,
    out: Path | None = None,
    model: str | None = None,
    seed: int = 0,
    no_noise: bool = False,
    truth: bool = False,
) -> None:
    """Simulate experiments of a problem and write what would be logged as CSV.

    [bold]Example[/bold]: oed-sysid simulate remus_diving_plane --out runs/
    """
    import numpy as np

    chosen = oed_sysid.load_problem(problem, variant=model)
    simulated = chosen.true_model() if truth else chosen.model
    wanted = patterns_of(chosen, experiment)
    files = _files(wanted, out)
    for file in files:
        check_place(file)
    rng = np.random.default_rng(seed)
    records = []
    with progress("Simulating") as show:
        for number, (one, file) in enumerate(zip(wanted, files, strict=True)):
            show.say(f"simulating {one.name}")
            records.append(oed_sysid.simulate(simulated, one, rng=rng, noise=not no_noise))
            oed_sysid.write_csv(records[-1], file)
            show.share((number + 1) / len(wanted))
    for one, file in zip(wanted, files, strict=True):
        answer(str(file)) if quiet() else say(f"{file}: {one.describe()}")
    facts = {"files": list(map(str, files)), "seed": seed, "noise": not no_noise, "truth": truth}
    store(facts, records=map(oed_sysid.Dataset, zip(records)))
    draw(Figure("figure_record", records[0], ""), asked("picture"))
    if asked("picture") is not None and len(records) > 1:
        note(f"The picture shows {records[0].name}; choose another with --experiment.")
    if chosen.truth and not truth:
        note("Simulated with the nominal values; --truth simulates the problem's truth.")


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


def import_(
    log: list[Path],
    listing: bool = False,
    find: str = "",
    mapping: Path | None = None,
    draft: Path | None = None,
    problem: str | None = None,
    model: str | None = None,
    out: Path | None = None,
) -> None:
    """Make records of a vehicle's own log: say what its fields are, map them to channels, check.

    Without a mapping fields are told by their numbers: what was read as what is shown before and
    after, with what should be confirmed; --out writes records of it, and the mapping beside them.
    Of several logs the first tells the mapping, and the others are read by it.
    Ends with exit code 4 when the log is suspect; the records are written all the same.

    [bold]Example[/bold]: oed-sysid import trial.csv --out my_ship/sea

    [bold]Example[/bold]: oed-sysid import trial.ulg --list

    [bold]Example[/bold]: oed-sysid import trial.ulg --map ship.toml --out my_ship/sea
    """
    chosen = oed_sysid.read_mapping(mapping) if mapping is not None else None
    found = [*map(_opened, log)]
    named = problem or ("" if chosen is None else chosen.problem)
    meant = oed_sysid.load_problem(_place(named, mapping), variant=model).model if named else None
    if draft is not None and not listing:
        _draft(log[0], found[0], meant, named, draft)
        return
    if chosen is None and not listing and not find:
        chosen = _told(log[0], found[0], meant, named, out)
    if listing or chosen is None:
        _list(log, found, find)
    elif mapping is not None or out is not None:
        _import(found, chosen, meant, out or Path("data"))


def _opened(log: Path) -> Log:
    """A log, and a word while it is read."""
    with progress(f"Reading {log.name}"):
        return oed_sysid.open_log(log)


def _told(
    log: Path, found: Log, model: Model | None, named: str, out: Path | None
) -> LogMapping | None:
    """Say what the numbers of a log tell, before and after; None where they tell nothing."""
    from oed_sysid.data.logs import draft, recognise
    from oed_sysid.data.recognise import called

    told = recognise(found)
    channels = None if model is None else model.channels
    told = told if channels is None else called(told, channels, found)
    made = draft(found, channels, problem=named, found=told)
    if made is None and out is None:
        return None
    if made is None:
        raise DataError(
            f"No field of {log.name} is known by its name or its numbers, so that nothing is "
            "written. --list shows all fields: name those that are meant, and their units, in a "
            "mapping, and give it with --map."
        )
    lost = [] if channels is None else [n for n in channels.input_names if n not in made.inputs]
    doubts = sum(bool(one.doubts) for one in told.guesses) + bool(told.doubts) + len(lost)
    questions = f"{counted(doubts, 'question')} below" if doubts else "nothing has to be asked"
    answer(f"{log.name}: {counted(len(told.guesses), 'field')} recognised, {questions}.")
    say(told.table(found))
    if told.doubts:
        say(f"Please confirm: the clock counts in {told.time_unit}.")
    if lost:
        say(f"Please add to the mapping, with field or constant: {', '.join(lost)}.")
    if out is None:
        checked = oed_sysid.check(oed_sysid.import_log(found, made, channels).dataset, model)
        say(checked.report())
        say(f"Next: oed-sysid import {shlex.quote(str(log))} --out data   (and the mapping there)")
        store(
            {"log": str(log), "kind": found.kind, **told.to_dict()} | {"check": checked.to_dict()}
        )
    return made


def _import(
    logs: Sequence[Log],
    mapping: LogMapping,
    model: Model | None,
    out: Path,
) -> None:
    """Write a CSV file for every record of some logs, and say what the check of all found."""
    channels = None if model is None else model.channels
    results = [oed_sysid.import_log(log, mapping, channels) for log in logs]
    dataset = oed_sysid.Dataset(tuple(record for one in results for record in one.dataset))
    if out.suffix.lower() == ".csv":
        raise DataError(f"{out} is a file. Give a folder to --out: every cut becomes a file in it.")
    files = write_runs(dataset, out, "--out", [log.path for log in logs])
    mapping.write(out / "mapping.toml")
    notes = [line for one in results for line in one.notes]
    for line in notes:
        note(line)
    checked = oed_sysid.check(dataset, model)
    answer(f"{counted(len(files), 'record')} written to {out}. {checked.verdict}")
    for file, record in zip(files, dataset, strict=True):
        rate = record.n_samples / max(record.duration, 1e-9)
        say(f"{file}: {record.duration:.1f} s, {record.n_samples} rows ({rate:.3g} per second)")
    say(checked.report())
    draw(Figure("figure_record", dataset.records[0], ""), asked("picture"))
    of = {"log": str(logs[0].path)} if len(logs) == 1 else {"logs": [str(x.path) for x in logs]}
    facts = {**of, "files": list(map(str, files)), "notes": notes}
    store({**facts, "check": checked.to_dict()}, records=[dataset])
    if checked.suspect:
        raise typer.Exit(SUSPECT)


def _list(logs: Sequence[Path], opened: Sequence[Log], find: str) -> None:
    """Say which fields every log has."""
    for log, found in zip(logs, opened, strict=True):
        _answer(found.describe(find))
        keys = ("field", "samples", "rate", "span", "unit", "range")
        rows = [dict(zip(keys, row, strict=True)) for row in found.rows(find)]
        store({"log": str(log), "kind": found.kind, "fields": rows})


def _draft(log: Path, found: Log, model: Model | None, named: str, place: Path) -> None:
    """Write a first mapping from names, numbers and units."""
    if model is None:
        raise DataError("--draft needs --problem: whose channels are wanted?")
    if (made := _told(log, found, model, named, place)) is not None:
        made.write(place)
        note(f"Written: {place}. Read it: what is asked is a guess.")


def _place(named: str, mapping: Path | None) -> str:
    """A problem's folder as seen from here, or from beside the mapping file."""
    beside = mapping.parent / named if mapping is not None else None
    if not Path(named).is_dir() and beside is not None and beside.is_dir():
        return str(beside)
    return named


def report(
    saved: Path,
    out: Path = Path("report.html"),
    validate: list[str] | None = None,
    problem: str | None = None,
) -> None:
    """Write the report on a saved fit, with its predictions of validation records.

    [bold]Example[/bold]: oed-sysid report fit.json --validate dive_3.csv --html fit.html
    """
    from oed_sysid.likelihood.archive import is_numbers_of_fit, read_json, read_result
    from oed_sysid.results import numbers_page

    content = read_json(saved)
    if is_numbers_of_fit(content):
        note(f"Written: {numbers_page(content).write(out)}")
        note(
            f"{saved} holds the numbers of a fit only. For pictures and predictions repeat the fit "
            "with --save FILE and report on that file."
        )
        if validate or asked("picture") is not None:
            raise DataError(
                f"{saved} holds no model, so it predicts nothing. Repeat the fit with --save FILE, "
                "or leave out --validate and --picture."
            )
        store(content)
        return
    kept = _kept(saved, problem)
    made = read_result(saved, "fit")[1]
    if made.get("command"):
        note(f"Made by oed_sysid {made.get('version')}: {made['command']}")
    comparison = judged = None
    if validate:
        usual = [record.sample_time for record in kept.dataset]
        judged = read_records(validate, kept.model, usual)
    with progress("Judging the fit"):
        if judged is not None:
            comparison = oed_sysid.compare({kept.model.name: kept}, judged)
        document = kept.document(comparison)
    answer(document.answer, "" if comparison is None else comparison.verdict)
    note(f"Written: {document.write(out)}")
    store(kept.to_dict() | ({"validation": comparison.to_dict()} if comparison else {}))
    own = Figure("figure_fit", kept, "")
    draw(own if comparison is None else predicted([comparison.best]), asked("picture"))


def _kept(file: Path, problem: str | None) -> Fit:
    """A saved fit; functions of CasADi that its model calls are those of its problem."""
    if problem is not None:
        oed_sysid.load_problem(problem)
    return oed_sysid.Fit.load(file)


def export(
    fit: Path,
    kind: str = "",
    out: Path = Path("model"),
    at: list[str] | None = None,
    problem: str | None = None,
) -> None:
    """Write a fitted model for another program, with the covariance of its parameters.

    Without --as it lists what it can write.

    [bold]Example[/bold]: oed-sysid export better.json --as c --out my_auv_c
    """
    from oed_sysid.export import KINDS
    from oed_sysid.export import export as export_model

    if not kind:
        answer("\n".join(Table(("--as", "writes"), [*KINDS.items()], words=(1,)).lines()))
        store({"kinds": KINDS})
        return
    trim = numbers("--at", at or (), "NAME=VALUE, such as u=1.5")
    result = _kept(fit, problem)
    files = list(export_model(result, kind, out, trim=trim or None))
    n = len(result.names)
    answer(f"{result.model.name} as {kind}, with {n} parameters and their covariance: {files[0]}")
    for file in files[1:]:
        say(str(file))
    if not result.status.ok:
        note(f"The fit ended as {result.status}")
    store({"model": result.model.name, "kind": kind, "files": list(map(str, files))})


def watch(
    problem: str,
    source: str,
    duration: float | None = None,
    period: float | None = None,
    band: str | None = None,
    waves: str | None = None,
    goal: float = 10.0,
    places: list[str] | None = None,
    silence: float = 10.0,
    model: str | None = None,
    html_file: Path | None = None,
) -> None:
    """Estimate while the run goes on: what is known by now, and whether to go on.

    Fourier regression of every equation of motion; frequencies of waves hardly count. The page is
    written anew with every line that is printed and loads itself again. What is known at the end
    are start values of a fit.

    [bold]Example[/bold]: oed-sysid watch remus_diving_plane --source dive_1.csv --silence 0.5
    """
    from oed_sysid.data.live import Place, samples

    study = Study.named(problem, model)
    stream = _stream(
        study.problem, duration, period,
        band=band_of("--band", band) if band else None,
        without=(band_of("--waves", waves),) if waves else (),
    )  # fmt: skip
    pairs = (text.partition("=") for text in places or ())
    found = {name: Place.of(place) for name, _, place in pairs}
    channels, told = study.problem.model.channels, -float("inf")
    if html_file is not None:
        note(f"As the run goes on: {html_file}")
    step, pause = stream.period, max(0.05 * stream.duration, stream.period)
    for time, sample in samples(source, channels, places=found, period=step, silence=silence):
        stream.push(time, sample)
        if time - told >= pause and stream.n_samples > 2:
            told = time
            note(f"{time:6.0f} s  {stream.advice(goal / 100)}")
            _live_page(stream.document(title=study.problem.title, goal=goal / 100), html_file)
    if stream.n_samples < 3:
        raise DataError(f"{source!r} gave {counted(stream.n_samples, 'sample')}; nothing is known.")
    document = stream.document(title=study.problem.title, goal=goal / 100)
    _live_page(document, html_file, over=True)
    answer(document.answer, document.text())
    store(stream.to_dict())


def _stream(
    problem: Problem, duration: float | None, period: float | None, **bands: Any
) -> FourierStream:
    """The estimator of a run that lasts as long as an experiment of the problem, if none says."""
    from oed_sysid.baselines.fourier import FourierStream

    run = next(iter(problem.experiments.values()), None)
    if run is None and None in (duration, period):
        raise DesignError("The problem has no experiment. Give --duration and --period.")
    length = duration or float(getattr(run, "duration", None) or 0.0)
    step = period or float(getattr(run, "sample_time", 1.0))
    return FourierStream(problem.model, duration=length, period=step, **bands)


def _live_page(document: Report, path: Path | None, *, over: bool = False) -> None:
    """Write the page of a run; while that goes on it loads itself again every other second."""
    if path is not None:
        again = "" if over else '<meta http-equiv="refresh" content="2">'
        write_text(path, document.html().replace("<head>", f"<head>{again}", 1))


def campaign(
    folder: Path,
    problem: str | None = None,
    goal: list[str] | None = None,
    hours: float | None = None,
    record: Path | None = None,
    patterns: list[str] | None = None,
    turnaround: float = 10.0,
    model: str | None = None,
    seed: int = 0,
    *,
    bounds: Bounds = Bounds(),  # noqa: B008 (frozen)
    weather: Weather = Weather(),  # noqa: B008 (frozen)
) -> None:
    """Say after each run whether to stop, or what to run next and what that would tell.

    The state is a journal in FOLDER: the same command goes on after a break. Begin with --problem
    and --goal, then give each log with --record; the commands of the next run are written as
    next.csv.

    [bold]Example[/bold]: oed-sysid campaign trial --problem remus_diving_plane --goal all=5
    --hours 2
    """
    import numpy as np

    from oed_sysid.design import candidate_runs
    from oed_sysid.design.decision import Logbook
    from oed_sysid.design.vehicles import draw_models

    if _goes_on(folder, problem, goal):
        journal = Logbook.open(folder)
    else:
        study = Study.named(str(problem), model)
        own = study.problem.model
        with progress("Making candidate runs") as show:
            limits, rng = bounds.limits(study.problem, show), np.random.default_rng(seed)
            lent = patterns_of(study.problem, patterns)
            runs = candidate_runs(
                own, lent, limits=limits, rng=rng, turnaround=60.0 * turnaround,
                vehicles=draw_models(own, weather.uncertainty, 12, None, rng),
                durations=None if bounds.duration is None else (bounds.duration,),
            )  # fmt: skip
            journal = Logbook(
                folder, own, problem=study.source, variant=model, candidates=runs,
                goals={n: v / 100.0 for n, v in numbers("--goal", goal or ()).items()},
                hours=hours, seed=seed, sea=weather.noise(study.problem, own, show, lent),
            )  # fmt: skip
            journal.write()
    if record is not None:
        with progress("Estimating") as show:
            journal = journal.with_record(record)
    with progress("Deciding") as show, weather.spread(show):
        decision = journal.decide()
    report = decision.report()
    if journal.fit is not None:
        concerns = "; ".join(str(one) for one in journal.fit.concerns)
        estimate = f"{journal.fit.status} {concerns}".rstrip()
        report += f"\n  estimate from {len(journal.records)} records: {estimate}"
    answer(decision.answer(len(journal.records), journal.hours_used), report)
    note(f"Decided in {decision.seconds:.2f} s.")
    if (path := journal.write_next(decision)) is not None:
        note(f"Written: {path}")
    store(decision.to_dict())


def _goes_on(folder: Path, problem: str | None, goal: Sequence[str] | None) -> bool:
    """Whether a folder holds a campaign, of which problem and goals are then known."""
    from oed_sysid.design.decision import Logbook

    if held := Logbook.exists(folder):
        if problem is not None or goal:
            raise DesignError(
                f"{str(folder)!r} holds a campaign already. Leave out --problem and --goal to go "
                "on with it, or name another folder."
            )
    elif problem is None or not goal:
        raise DesignError(
            f"There is no campaign in {str(folder)!r}. Begin one with --problem and --goal."
        )
    return held


def app(problem: str | None = None, port: int = 8501, no_browser: bool = False) -> None:
    """Open the same in a browser, on this computer only. Needs the extra 'app'.

    [bold]Example[/bold]: oed-sysid app remus_diving_plane
    """
    # The page stands above the command line, whose options it shows.
    importlib.import_module("oed_sysid.app.launch").start(
        problem, port=port, browser=not no_browser
    )


def estimators(
    problems: list[str] | None = None,
    names: list[str] | None = None,
    noise: list[float] | None = None,
    declared: bool = False,
    sampling: list[int] | None = None,
    worlds: list[str] | None = None,
    seeds: int = 3,
    jobs: int = 2,
    out: Path = Path("out/benchmark"),
) -> None:
    """Compare estimators: errors, bias, coverage, prediction, time, and who cannot or fails.

    [bold]Example[/bold]: oed-sysid benchmark estimators --problems online_ship --noise 0.5 1
    """
    from oed_sysid.baselines.benchmark import benchmark
    from oed_sysid.baselines.contest import CONTESTANTS

    chosen = list(CONTESTANTS) if names == ["all"] else names
    said = {
        "problems": problems, "estimators": chosen, "noise": noise, "sampling": sampling,
        "worlds": worlds,
    }  # fmt: skip
    given: dict[str, Any] = {name: value for name, value in said.items() if value}
    with progress("Running") as show:

        def tell(state: CellProgress) -> None:
            show.say(f"{state.n_done}/{state.n_cells} {state.key}")
            show.left(state.seconds_left)

        result = benchmark(
            seeds=seeds, noise_unit="declared" if declared else "peak", store=out / "runs",
            n_jobs=jobs, progress=tell, **given,
        )  # fmt: skip
    text = result.report()
    answer(result.answer, text)
    write(text, out / "benchmark.md")
    write(result.to_csv(), out / "benchmark.csv")
    if any(row.noise > 0 and not row.refused for row in result.rows):
        for file in (out / "benchmark.png", asked("picture")):
            draw(Figure("figure_benchmark", result, ""), file)
    store(result.to_dict())


def missing_physics(
    plan: str = "",
    jobs: int = 2,
    out: Path | None = None,
) -> None:
    """Hide effects in simulated vehicles and count how often the right one is found.

    Needs a checkout: the independent simulator is not part of an installation.

    [bold]Example[/bold]: oed-sysid benchmark missing-physics "single/white:2" --out hidden
    """
    checkout = Path(__file__).resolve().parents[2]
    if not (checkout / "benchmarks" / "missing_physics" / "run.py").is_file():
        raise OedSysidError(
            "The benchmark of hidden effects is part of the source checkout, not of an installed "
            "package. Get the sources and run this command from there."
        )
    if str(checkout) not in sys.path:
        sys.path.insert(0, str(checkout))
    study = importlib.import_module("benchmarks.missing_physics.run")
    harness = importlib.import_module("benchmarks.harness")
    kept = study.STORE if out is None else harness.Store(out / "missing_physics.jsonl")
    wanted = study.cases(plan or study.PLAN)
    told = {"tell": study.rates.summary, "say": note}
    rows = harness.run_cases(kept, wanted, study.calls, n_jobs=jobs, **told)
    found, text = study.measures(rows), study.table(rows)
    rates = (f"{one['name']} {one['value']:.3g} of {one['count']}" for one in found["rates"][:2])
    answer(f"{found['n_cases']} cases: {'; '.join(rates)}.", text)
    if out is not None:
        write(text + "\n", out / "missing_physics.md")
    store(found)
