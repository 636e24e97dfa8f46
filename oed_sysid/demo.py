"""The main job on one page: a model that lacks something, found, named and tested.

``python -m oed_sysid.demo`` needs no network. It uses records of a small
underwater vehicle that come with the package; where the towing tank's records
of a tanker are in the data folder (``OED_SYSID_DATA``), it tells that story
too. Everything is written to ``out/demo``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.diagnosis.compare import Comparison
    from oed_sysid.diagnosis.improvement import Improvement
    from oed_sysid.problem import Problem

OUT = Path("out") / "demo"
AUV_TEST = ("test_steps", "test_zigzag_15_12")
# Rudder angle and switch heading of the tanker's zigzags, degrees.
TANKER_TRAIN = ("10_05", "20_05", "30_05")
TANKER_TEST = ("15_05", "25_05")
TANKER_DATA = "kvlcc2_hsva_zigzag/"


def main(out: Path = OUT) -> int:
    """Tell the stories and write their pictures and reports below ``out``."""
    from oed_sysid.errors import OedSysidError

    began = time.perf_counter()
    try:
        diving_plane(out)
        tanker(out / "tanker")
    except OedSysidError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    print(f"\nDone in {time.perf_counter() - began:.0f} s.")
    return 0


def diving_plane(out: Path) -> Improvement:
    """Find what the model of a small underwater vehicle lacks."""
    from oed_sysid.problem import load_problem

    problem = load_problem("remus_diving_plane")
    train, test = problem.data().split(test=AUV_TEST)
    _title("A small underwater vehicle, five runs, and something hidden in them")
    _introduce(problem, train, test)
    found, comparison = _search(problem, train, test, known_noise=True)
    _conclude(found, comparison)
    _write(found, comparison, train, out, problem.title)
    return found


def tanker(out: Path) -> Improvement | None:
    """Find what a model with a linear hull lacks in real zigzags of a tanker; None without data."""
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.data.third_party import data_folder, registered
    from oed_sysid.problem import load_problem
    from oed_sysid.report import new_figure, plot_zigzag, save_figure

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
    """Say what is believed, and what it is confronted with."""
    model = problem.model
    print(f"Believed         {model.name}; {len(model.free_names)} parameters to estimate")
    print(f"Perhaps missing  {len(problem.effects)} candidate effects")
    print(f"Learning from    {', '.join(train.names)}")
    print(f"Judging with     {', '.join(test.names)} (no choice looks at them)")
    for line in model.equations().splitlines():
        if "' " in line and "<-" not in line:
            print(f"    {line}")
    print()


def _search(
    problem: Problem, train: Dataset, test: Dataset, *, known_noise: bool, max_effects: int = 4
) -> tuple[Improvement, Comparison]:
    """Improve the model, then judge the fits before and after on the validation records."""
    from oed_sysid.diagnosis.compare import compare
    from oed_sysid.diagnosis.improve import improve

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
    return found, compare(fits, test)


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
    from oed_sysid import report

    page = report.improvement_page(found, comparison, train=train, title=title)
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
