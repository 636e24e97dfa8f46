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
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import oed_sysid
from oed_sysid.cli import BAD_INPUT
from oed_sysid.cli.study import DEFAULT_MODEL, Study
from oed_sysid.cli.tasks import TASKS, predicted
from oed_sysid.cli.terminal import Shown
from oed_sysid.runtime.display import Figure, interval

if TYPE_CHECKING:
    from oed_sysid.data.dataset import Dataset
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
    began = time.perf_counter()
    try:
        diving_plane(out)
        pond(out / "pond")
        tanker(out / "tanker")
    except oed_sysid.OedSysidError as error:
        print(f"Error: {error}", file=sys.stderr)
        return BAD_INPUT
    print(f"\nDone in {time.perf_counter() - began:.0f} s.")
    return 0


def diving_plane(out: Path) -> Improvement:
    """Find what the model of a small underwater vehicle lacks."""
    problem = oed_sysid.load_problem("remus_diving_plane")
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
    if not _at_hand("The pond", POND_DATA):
        return None
    problem = oed_sysid.load_problem("esso_osaka")
    train, test = problem.data().split(test=POND_TEST)
    _title("A real tanker model in a pond, and a model that knows no wind")
    _introduce(problem, train, test)

    def pieces(runs: Dataset, duration: float) -> Dataset:
        return oed_sysid.Dataset(tuple(part for run in runs for part in run.segments(duration)))

    estimator = oed_sysid.MultipleShooting(disturbances="none", noise="given")
    calm = estimator.fit(problem.model, pieces(train, POND_FIT))
    asked = tuple(run.thin(2) for run in pieces(train, POND_AHEAD) if "random" not in run.name)
    found = oed_sysid.diagnose(calm.model, oed_sysid.Dataset(asked), candidates=problem.effects)
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
        parts = pieces(oed_sysid.Dataset((run,)), POND_AHEAD)
        before, after = (
            math.degrees(fit.predict(parts, initial="first").rms["psi"]) for fit in (calm, better)
        )
        errors[run.name] = (before, after)
        print(f"    {run.name:22} without {before:6.1f}   with {effect.name} {after:6.1f}")
    first = oed_sysid.Dataset((pieces(test, POND_AHEAD)[0],))
    labels = {"labels": ["without", f"with {effect.name}"]}
    predictions = [fit.predict(first, initial="first") for fit in (calm, better)]
    picture = Figure("figure_predictions", predictions, "", options=labels)
    _draw({"prediction": picture}, out)
    return errors


def _at_hand(story: str, place: str) -> bool:
    """Whether the measured records of a story are there; say so where they are not."""
    from oed_sysid.data.third_party import data_folder, registered

    folder = data_folder()
    found = all((folder / path).is_file() for path in registered(place))
    if not found:
        print(f"\n({story}'s story is left out: its measured records are not in {folder}.)")
    return found


def _draw(pictures: Mapping[str, Figure], out: Path) -> None:
    """Write pictures as PNG files, and say where."""
    from oed_sysid.results import save_figure
    from oed_sysid.results.page import draw

    for name, figure in pictures.items():
        save_figure(draw(figure), out / f"{name}.png", dpi=130)
    print(f"Pictures  {out.resolve()}/*.png")


def tanker(out: Path) -> Improvement | None:
    """Find what a model with a linear hull lacks in real zigzags of a tanker; None without data."""
    from oed_sysid.results import new_figure, plot_zigzag, save_figure

    if not _at_hand("The tanker", TANKER_DATA):
        return None
    problem = oed_sysid.load_problem("kvlcc2", variant="linear_hull")
    data = problem.data()
    train, test = (
        oed_sysid.Dataset(tuple(data[run].thin(2) for run in runs))
        for runs in (TANKER_TRAIN, TANKER_TEST)
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
    comparison, size = outcome.comparison, (8.0, 4.6)
    assert comparison is not None
    print(f"\nReport    {outcome.document().write(out / 'report.html').resolve()}")
    pictures = {
        "located": Figure("plot_located", found.location, "", size=size),
        "ranking": Figure("plot_ranking", found.ranking, "", size=size),
        "error": Figure("plot_error_fall", found, "", size=size),
        "outputs": Figure("plot_comparison", comparison, "", size=size),
        "prediction": predicted(comparison.models),
    }
    _draw(pictures, out)
    return found


def _say_sizes(fit: Fit, effect: Effect) -> None:
    """Say the amplitudes of an effect with their 95 % intervals."""
    for name in effect.amplitude_names:
        low, high = fit.interval(name)
        unit = fit.model.parameter(name).unit
        said = interval(fit.values[name], 0.5 * (high - low))
        print(f"    {name} = {said} {'' if unit in ('', '1') else unit} (95 %)")


def _title(text: str) -> None:
    print(f"\n{text}\n{'-' * len(text)}")


if __name__ == "__main__":
    sys.exit(main())
