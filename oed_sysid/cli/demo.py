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
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oed_sysid.data.dataset import Dataset, Record
    from oed_sysid.evidence.compare import Comparison
    from oed_sysid.evidence.improvement import Improvement
    from oed_sysid.experiments.problem import Problem
    from oed_sysid.likelihood.fit import Fit

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
    found, comparison = _search(problem, train, test, known_noise=True)
    _conclude(found, comparison)
    _write(found, comparison, train, out, problem.title)
    return found


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
    for name in effect.amplitude_names:
        low, high = better.interval(name)
        print(f"    {name} = {better.values[name]:.3g} (95 % interval {low:.3g} to {high:.3g})")
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
    found, comparison = _search(problem, train, test, known_noise=False, max_effects=1)
    _conclude(found, comparison)
    _write(found, comparison, train, out, problem.title)
    figure, axes = new_figure(len(test), 1, size=(8.0, 4.2 * len(test)))
    predictions = [part.prediction for part in comparison.models]
    labels = [part.label for part in comparison.models]
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
    problem: Problem, train: Dataset, test: Dataset, *, known_noise: bool, max_effects: int = 4
) -> tuple[Improvement, Comparison]:
    """Improve the model, then judge the fits before and after on the validation records."""
    from oed_sysid.evidence.compare import compare
    from oed_sysid.evidence.improve import improve

    found = improve(
        problem.model,
        train,
        test,
        candidates=problem.effects,
        known_noise=known_noise,
        max_effects=max_effects,
        progress=lambda text: print(f"... {text}", flush=True),
    )
    print()
    print(found.report())
    fits = {"nominal": found.base_fit} | ({"improved": found.fit} if found.steps else {})
    return found, compare(fits, test, sigma=found.yardstick.sigma)


def _conclude(found: Improvement, comparison: Comparison) -> None:
    """Say what was missing, how large it is, and what the model predicts with it."""
    print()
    known = {score.effect.name for score in found.ranking.scores}
    for step in found.steps:
        effect = found.model.effect(step.added)
        what = "Missing was" if step.added in known else "No known effect; a guess is"
        print(f"{what} {step.added}: {effect.description}.")
        for one in found.parameters:
            if one["name"] in effect.amplitude_names:
                half = 1.96 * one["std_error"]
                unit = "" if one["unit"] in ("", "1") else f"{one['unit']} "
                print(f"    {one['name']} = {one['value']:.4g} ± {half:.2g} {unit}(95 %)")
    before, after = found.base_error["test"], found.final_error["test"]
    print(
        f"On records that nothing was fitted to, the error falls from {before:.3g} to {after:.3g}"
    )
    print(f"times the noise. {comparison.best.verdict}")


def _write(
    found: Improvement, comparison: Comparison, train: Dataset, out: Path, title: str
) -> None:
    """Write the report, and its main pictures once more as PNG files."""
    from oed_sysid import results as report

    page = found.document(comparison, train=train, title=title)
    written = page.write(out / "report.html")
    single: dict[str, tuple[Callable[..., Any], Any]] = {
        "located": (report.plot_located, found.location),
        "ranking": (report.plot_ranking, found.ranking),
        "error": (report.plot_error_fall, found),
        "outputs": (report.plot_comparison, comparison),
    }
    drawn: dict[str, Any] = {}
    for name, (plot, result) in single.items():
        drawn[name], axes = report.new_figure(1, 1, size=(8.0, 4.6))
        plot(result, ax=axes[0, 0])
    drawn["prediction"] = report.figure_predictions(
        [part.prediction for part in comparison.models],
        labels=[part.label for part in comparison.models],
    )
    for name, figure in drawn.items():
        report.save_figure(figure, out / f"{name}.png", dpi=130)
    print(f"\nReport    {written.resolve()}\nPictures  {out.resolve()}/*.png")


def _title(text: str) -> None:
    print(f"\n{text}\n{'-' * len(text)}")


if __name__ == "__main__":
    sys.exit(main())
