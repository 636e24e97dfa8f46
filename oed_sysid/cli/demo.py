"""The main job on one page: a model that lacks something, found, named and tested.

``python -m oed_sysid.cli.demo`` needs no network. It uses records of a small
underwater vehicle that come with the package; where measured records are in the
data folder (``OED_SYSID_DATA``), it tells two more stories: of a tanker in a
pond whose model knows no wind, and of a tanker's zigzags in a towing tank.
Everything is written to ``out/demo``.
"""

from __future__ import annotations

import math
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oed_sysid.cli.study import DEFAULT_MODEL

if TYPE_CHECKING:
    from oed_sysid.cli.study import Outcome
    from oed_sysid.data.dataset import Dataset, Record
    from oed_sysid.evidence.improvement import Improvement
    from oed_sysid.experiments.problem import Problem
    from oed_sysid.likelihood.fit import Fit
    from oed_sysid.physics.base import Effect

OUT = Path("out") / "demo"
AUV_TEST = ("test_steps", "test_zigzag_15_12")
# Rudder angle and switch heading of the tanker's zigzags, degrees.
TANKER_TRAIN = ("10_05", "20_05", "30_05")
TANKER_TEST = ("15_05", "25_05")
TANKER_DATA = "kvlcc2_hsva_zigzag/"
POND_DATA = "esso_osaka/"
POND_TEST = ("zigzag_12_30", "zigzag_12_20", "turn_10_port_35", "turn_10_starboard_20", "random_6")
# Fits look 25 s ahead, predictions and the search 100 s.
POND_FIT, POND_AHEAD = 25.0, 100.0


def main(out: Path = OUT) -> int:
    """Tell the stories and write their pictures and reports below ``out``."""
    from oed_sysid.errors import OedSysidError

    began = time.perf_counter()
    try:
        diving_plane(out)
        pond(out / "pond")
        tanker(out / "tanker")
    except OedSysidError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    print(f"\nDone in {time.perf_counter() - began:.0f} s.")
    return 0


def diving_plane(out: Path) -> Improvement:
    """Find what the model of a small underwater vehicle lacks."""
    from oed_sysid.experiments.problem import load_problem

    problem = load_problem("remus_diving_plane")
    train, test = problem.data().split(test=AUV_TEST)
    _title("A small underwater vehicle, five runs, and something hidden in them")
    _introduce(problem, train, test)
    return _search(problem, train, test, out, known_noise=True)


def pond(out: Path) -> dict[str, tuple[float, float]] | None:
    """Find the wind in measured runs of a tanker in a pond; None without data.

    Returns
    -------
    dict of str to tuple of float
        Error of the heading 100 s ahead on every validation record, degrees, before and after.
    """
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.data.third_party import data_folder, registered
    from oed_sysid.evidence.compare import diagnose
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.likelihood.multiple_shooting import MultipleShooting

    folder = data_folder()
    if not all((folder / path).is_file() for path in registered(POND_DATA)):
        print(f"\n(The pond's story is left out: its measured records are not in {folder}.)")
        return None
    problem = load_problem("esso_osaka")
    train, test = problem.data().split(test=POND_TEST)
    _title("A real tanker model in a pond, and a model that knows no wind")
    _introduce(problem, train, test)

    def pieces(runs: Dataset, duration: float) -> Dataset:
        return Dataset(tuple(part for run in runs for part in run.segments(duration)))

    estimator = MultipleShooting(disturbances="none", noise="given")
    calm = estimator.fit(problem.model, pieces(train, POND_FIT))
    asked = [run.thin(2) for run in pieces(train, POND_AHEAD) if "random" not in run.name]
    found = diagnose(calm.model, Dataset(tuple(asked)), candidates=problem.effects)
    print(found.report())
    effect = found.best
    if effect is None:
        print("\nNothing that is known is missing.")
        return {}
    better = estimator.fit(calm.model + effect, pieces(train, POND_FIT))
    print(f"\nMissing was {effect.name}: {effect.description}.")
    _say_sizes(better, effect)
    errors: dict[str, tuple[float, float]] = {}
    print("\nHeading 100 s ahead from its first sample, rms error in degrees, runs nobody fitted:")
    for run in test:
        parts = pieces(Dataset((run,)), POND_AHEAD)
        both = [
            math.degrees(fit.predict(parts, initial="first").rms["psi"]) for fit in (calm, better)
        ]
        errors[run.name] = (both[0], both[1])
        print(f"    {run.name:22} without {both[0]:6.1f}   with {effect.name} {both[1]:6.1f}")
    _draw_heading(calm, better, pieces(test, POND_AHEAD)[0], effect.name, out)
    return errors


def _draw_heading(calm: Fit, better: Fit, part: Record, name: str, out: Path) -> None:
    """One window of a validation record: measured heading, and both predictions."""
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.results import figure_predictions, save_figure

    predictions = [fit.predict(Dataset((part,)), initial="first") for fit in (calm, better)]
    figure = figure_predictions(predictions, labels=["without", f"with {name}"])
    save_figure(figure, out / "prediction.png", dpi=130)
    print(f"\nPicture   {(out / 'prediction.png').resolve()}")


def tanker(out: Path) -> Improvement | None:
    """Find what a model with a linear hull lacks in real zigzags of a tanker; None without data."""
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.data.third_party import data_folder, registered
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.results import new_figure, plot_zigzag, save_figure

    folder = data_folder()
    if not all((folder / path).is_file() for path in registered(TANKER_DATA)):
        print(f"\n(The tanker's story is left out: its measured records are not in {folder}.)")
        return None
    problem = load_problem("kvlcc2", variant="linear_hull")
    data = problem.data()
    train, test = (
        Dataset(tuple(data[run].thin(2) for run in runs)) for runs in (TANKER_TRAIN, TANKER_TEST)
    )
    _title("A real tanker's zigzags, and a model without the hull's nonlinear forces")
    _introduce(problem, train, test)
    found = _search(problem, train, test, out, max_effects=1)
    figure, axes = new_figure(len(test), 1, size=(8.0, 4.2 * len(test)))
    fits = {"nominal": found.base_fit} | ({"improved": found.fit} if found.steps else {})
    predictions, labels = [fit.predict(test) for fit in fits.values()], list(fits)
    for ax, record in zip(axes[:, 0], test, strict=True):
        # Positive rudder has its trailing edge to port here; the diagram shows it as logged.
        plot_zigzag(record, predictions, rudder="delta", labels=labels, ax=ax)
    save_figure(figure, out / "zigzag.png", dpi=130)
    return found


def _introduce(problem: Problem, train: Dataset, test: Dataset) -> None:
    """Say what the nominal model is, and what it is confronted with."""
    model = problem.model
    print(f"Nominal model    {model.name}; {len(model.free_names)} parameters to estimate")
    print(f"Perhaps missing  {len(problem.effects)} candidate effects")
    print(f"Training         {', '.join(train.names)}")
    print(f"Validation       {', '.join(test.names)} (no choice looks at them)")
    for line in model.equations().splitlines():
        if "' " in line and "<-" not in line:
            print(f"    {line}")
    print()


def _search(
    problem: Problem, train: Dataset, test: Dataset, out: Path, **settings: Any
) -> Improvement:
    """Improve the model and say what was missing; write the report and its main pictures."""
    from oed_sysid.cli.study import Study
    from oed_sysid.cli.tasks import TASKS
    from oed_sysid.cli.terminal import Shown

    known = settings.pop("known_noise", False)
    study = Study(problem.name, DEFAULT_MODEL, problem, train, test, known)
    told = Shown(told=lambda text: print(f"... {text}", flush=True))
    outcome = TASKS["improve"](study, told, settings)
    found: Improvement = outcome.result
    print(f"\n{found.report()}\n")
    candidates = {score.effect.name for score in found.ranking.scores}
    for step in found.steps:
        effect = found.model.effect(step.added)
        what = "Missing was" if step.added in candidates else "No known effect; a guess is"
        print(f"{what} {step.added}: {effect.description}.")
        _say_sizes(found.fit, effect)
    before, after = found.base_error["test"], found.final_error["test"]
    print(
        f"On records that nothing was fitted to, the error falls from {before:.3g} to {after:.3g} "
        "times the noise."
    )
    _draw_all(outcome, out)
    return found


def _say_sizes(fit: Fit, effect: Effect) -> None:
    """Say the amplitudes of an effect with their 95 % intervals."""
    from oed_sysid.runtime.display import interval

    for name in effect.amplitude_names:
        low, high = fit.interval(name)
        unit = fit.model.parameter(name).unit
        said = interval(fit.values[name], 0.5 * (high - low))
        print(f"    {name} = {said} {'' if unit in ('', '1') else unit} (95 %)")


def _draw_all(outcome: Outcome, out: Path) -> None:
    """Write the report, and its main pictures once more as PNG files."""
    from oed_sysid.results import save_figure
    from oed_sysid.results.page import draw
    from oed_sysid.runtime.display import Figure

    found, comparison = outcome.result, outcome.comparison
    assert comparison is not None
    written = outcome.document().write(out / "report.html")
    size = (8.0, 4.6)
    labels = {"labels": [part.label for part in comparison.models]}
    predictions = [part.prediction for part in comparison.models]
    for name, figure in {
        "located": Figure("plot_located", found.location, "", size=size),
        "ranking": Figure("plot_ranking", found.ranking, "", size=size),
        "error": Figure("plot_error_fall", found, "", size=size),
        "outputs": Figure("plot_comparison", comparison, "", size=size),
        "prediction": Figure("figure_predictions", predictions, "", options=labels),
    }.items():
        save_figure(draw(figure), out / f"{name}.png", dpi=130)
    print(f"\nReport    {written.resolve()}\nPictures  {out.resolve()}/*.png")


def _title(text: str) -> None:
    print(f"\n{text}\n{'-' * len(text)}")


if __name__ == "__main__":
    sys.exit(main())
