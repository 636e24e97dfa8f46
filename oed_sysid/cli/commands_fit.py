"""Commands that estimate and judge: fit, compare, report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from oed_sysid.cli.options import (
    noise_settings,
)
from oed_sysid.cli.reading import read_records, read_records_of
from oed_sysid.cli.terminal import (
    INTERRUPTED,
    answer,
    deliver,
    draw,
    drawn,
    invocation,
    journal,
    note,
    progress,
    say_log,
)
from oed_sysid.errors import DataError

if TYPE_CHECKING:
    from oed_sysid.cli.terminal import Shown
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.evidence.compare import Comparison
    from oed_sysid.experiments.problem import Problem
    from oed_sysid.likelihood.fit import Fit
    from oed_sysid.physics.model import Model
    from oed_sysid.runtime.journal import Journal


def fit(
    problem: str,
    files: list[str],
    validate: list[str] | None = None,
    model: str | None = None,
    known_noise: bool = False,
    disturbances: str = "auto",
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
    save: Path | None = None,
    kept_in: Path | None = None,
    fresh: bool = False,
) -> None:
    """Estimate the parameters of a problem's model from measured records.

    [bold]Example[/bold]: oed-sysid fit remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv --save fit.json
    """
    from oed_sysid.data.dataset import check_disjoint
    from oed_sysid.evidence.check import quick_check
    from oed_sysid.evidence.compare import compare as compare_models
    from oed_sysid.experiments.problem import load_problem

    chosen = load_problem(problem, variant=model)
    dataset = read_records(files, chosen)
    validation = read_records(validate, chosen) if validate else None
    if validation is not None:
        check_disjoint(dataset, validation)
    log = quick_check(dataset, chosen.model)
    wanted = noise_settings(known_noise, disturbances)
    with journal(kept_in, fresh) as keep:
        with progress("Fitting") as show:
            result = _fits({"": chosen.model}, dataset, wanted, keep, show)[""]
            comparison = None
            if validation is not None:
                show.say("Predicting")
                comparison = compare_models({chosen.model.name: result}, validation)
        say_log(log)
        text, content = result.report(), {**result.to_dict(), "log": log.to_dict()}
        if comparison is not None:
            text += f"\n\n{comparison.report()}"
            content["validation"] = comparison.to_dict()
        deliver(
            result.document(comparison),
            content,
            text=text,
            page=partial(result.document, comparison, log=log),
            picture=partial(_figure, result, comparison),
            records=[dataset, validation],
        )
        if save is not None:
            command, settings = invocation()
            result.save(save, command=command, settings=settings)
            note(f"Written: {save}")
        _end([result], suspect=log.contradictory)


def compare(
    problem: str,
    files: list[str],
    validate: list[str],
    added: list[str] | None = None,
    model: str | None = None,
    known_noise: bool = False,
    disturbances: str = "auto",
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
    kept_in: Path | None = None,
    fresh: bool = False,
) -> None:
    """Fit to training records and say where predictions of validation records fail.

    [bold]Example[/bold]: oed-sysid compare remus_diving_plane dive_1.csv dive_2.csv
    --validate dive_3.csv
    """
    from oed_sysid.data.dataset import check_disjoint, together
    from oed_sysid.evidence.check import quick_check
    from oed_sysid.evidence.compare import compare as compare_models
    from oed_sysid.evidence.usual import equipped
    from oed_sysid.experiments.problem import load_problem

    chosen = load_problem(problem, variant=model)
    training, validation = (read_records(given, chosen) for given in (files, validate))
    models, kept = _models(equipped(chosen, training) if added else chosen, added or [])
    for used in (training, *(fit.dataset for fit in kept.values())):
        check_disjoint(used, validation)
    log = quick_check(together(training, validation), chosen.model).without("duplicate")
    wanted = noise_settings(known_noise, disturbances)
    with journal(kept_in, fresh) as keep:
        with progress("Fitting") as show:
            fits = _fits(models, training, wanted, keep, show) | kept
            show.say("Predicting")
            result = compare_models(fits, validation)
        say_log(log)
        labels = [part.label for part in result.models]
        predictions = [part.prediction for part in result.models]
        deliver(
            result.document(),
            {**result.to_dict(), "log": log.to_dict()},
            page=partial(result.document, title=chosen.title, log=log),
            picture=partial(drawn, "figure_predictions", predictions, labels=labels),
            records=[training, validation],
        )
        for name, fit in fits.items():
            if not fit.status.ok:
                note(f"The fit of {name} ended as {fit.status}")
            for concern in fit.grave:
                note(f"Do not use the fit of {name}: {concern.text}")
        _end(list(fits.values()), suspect=log.contradictory)


def _fits(
    models: Mapping[str, Model],
    dataset: Dataset,
    settings: Mapping[str, Any],
    keep: Journal,
    show: Shown,
) -> dict[str, Fit]:
    """One fit of each model; those that an interrupted call has finished are read."""
    from oed_sysid.likelihood.archive import encode
    from oed_sysid.likelihood.multiple_shooting import MultipleShooting

    estimator = MultipleShooting(**settings, progress=show.iteration)
    content = {
        "task": "fit",
        "models": [encode(model) for model in models.values()],
        "records": [[record.name, record.content_hash] for record in dataset],
        **settings,
    }
    keep.open(content, shared={"records": dataset})
    fits: dict[str, Fit] = {}
    for name, model in models.items():
        if name:
            show.say(f"Fitting {name}")

        def work(name: str = name, model: Model = model) -> Fit:
            fits[name] = estimator.fit(model, dataset, warm=keep.state())
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


def _end(fits: Sequence[Fit], *, suspect: bool) -> None:
    """Leave with the exit code that says whether the result can be used."""
    if any(fit.status.code == "interrupted" for fit in fits):
        raise typer.Exit(INTERRUPTED)
    if suspect or any(fit.grave or not fit.status.ok for fit in fits):
        raise typer.Exit(1)


def report(
    saved: Path,
    out: Path = Path("report.html"),
    validate: list[str] | None = None,
    picture: Path | None = None,
) -> None:
    """Write the report on a saved fit, with its predictions of validation records.

    [bold]Example[/bold]: oed-sysid report fit.json --validate dive_3.csv --out fit.html
    """
    from oed_sysid.evidence.compare import compare as compare_models
    from oed_sysid.likelihood.archive import is_numbers_of_fit, read_json, read_result
    from oed_sysid.likelihood.fit import Fit
    from oed_sysid.results import numbers_page

    content = read_json(saved)
    if is_numbers_of_fit(content):
        note(f"Written: {numbers_page(content).write(out)}")
        note(
            f"{saved} holds the numbers of a fit only. For pictures and predictions repeat the fit "
            "with --save FILE and report on that file."
        )
        if validate or picture is not None:
            raise DataError(
                f"{saved} holds no model, so it predicts nothing. Repeat the fit with --save FILE, "
                "or leave out --validate and --picture."
            )
        return
    kept = Fit.load(saved)
    made = read_result(saved, "fit")[1]
    if made.get("command"):
        note(f"Made by oed_sysid {made.get('version')}: {made['command']}")
    comparison = None
    if validate:
        comparison = compare_models({kept.model.name: kept}, read_records_of(validate, kept))
    document = kept.document(comparison)
    answer(document.answer, "" if comparison is None else comparison.verdict)
    note(f"Written: {document.write(out)}")
    draw(partial(_figure, kept, comparison), picture)


def _figure(fit: Fit, comparison: Comparison | None) -> Any:
    """Predictions of the validation records, or the fit where there are none."""
    if comparison is None:
        return drawn("figure_fit", fit)
    best = comparison.best
    return drawn("figure_predictions", [best.prediction], labels=[best.label])


def _models(problem: Problem, added: list[str]) -> tuple[dict[str, Model], dict[str, Fit]]:
    """The nominal model and one for each group of candidates added to it; and saved fits."""
    from oed_sysid.likelihood.fit import Fit

    models, kept = {"nominal": problem.model}, {}
    known = {effect.name for effect in problem.effects}
    for group in added:
        names = [name.strip() for name in group.split("+")]
        is_path = group.lower().endswith(".json") or Path(group).exists()
        if is_path and not known.issuperset(names):
            fit = Fit.load(group)
            if fit.model.channels != problem.channels:
                raise DataError(
                    f"{group} holds a fit of {fit.model.name!r}, whose inputs and outputs are not "
                    f"those of {problem.name!r}: they cannot be compared on the same records."
                )
            kept[Path(group).stem] = fit
            continue
        effects = [problem.effect(name) for name in names]
        models[f"with {' and '.join(effect.name for effect in effects)}"] = problem.model + effects
    return models, kept
