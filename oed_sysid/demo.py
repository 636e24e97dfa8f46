"""The main job on one page: a model that lacks something, found, named and tested.

``python -m oed_sysid.demo`` needs no network. It uses records of a small
underwater vehicle that come with the package; where the tank's measurements of
a tanker are in the data folder (``OED_SYSID_DATA``), it tells that story too.
Everything is written to ``out/demo``.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from oed_sysid.diagnosis.compare import Comparison
    from oed_sysid.diagnosis.improvement import Improvement
    from oed_sysid.problem import Problem

OUT = Path("out") / "demo"
TEST = ("test_steps", "test_zigzag_15_12")


def main(out: Path = OUT) -> int:
    """Tell the story and write its pictures and report below ``out``."""
    from oed_sysid.errors import OedSysidError

    began = time.perf_counter()
    try:
        diving_plane(out)
    except OedSysidError as error:
        print(f"Error: {error}", file=sys.stderr)
        return 2
    print(f"\nDone in {time.perf_counter() - began:.0f} s.")
    return 0


def diving_plane(out: Path) -> Improvement:
    """Find what the model of a small underwater vehicle lacks."""
    from oed_sysid.diagnosis.compare import compare
    from oed_sysid.diagnosis.improve import improve
    from oed_sysid.problem import load_problem
    from oed_sysid.report import improvement_page

    problem = load_problem("remus_diving_plane")
    data = problem.data()
    train, test = data.split(test=TEST)
    _title("1  A vehicle, a model, and five runs")
    print(f"{problem.title}. Believed: {len(problem.model.free_names)} parameters to estimate,")
    print(f"no disturbance. {len(problem.effects)} effects are on the list of what may be missing.")
    print(f"Learning from    {', '.join(train.names)}")
    print(f"Judging with     {', '.join(test.names)} (no choice looks at them)")
    print("\n".join(f"    {line}" for line in _dynamics(problem)))

    _title("2  Search: fit, locate, rank, add, refit")
    found = improve(
        problem.model, train, test, candidates=problem.effects, known_noise=True, progress=_tell
    )
    print()
    print(found.report())

    _title("3  What it is worth")
    models = {"as believed": found.base, "improved": found.model}
    comparison = compare(models if found.steps else {"as believed": found.base}, test)
    for part in comparison.models:
        print(f"- {part.verdict}")
    for step in found.steps:
        effect = found.model.effect(step.added)
        print(f"- Missing was {step.added}: {effect.description}.")
        for one in found.parameters:
            if one["name"] in effect.amplitude_names:
                print(
                    f"  {one['name']} = {one['value']:.4g} ± {1.96 * one['std_error']:.2g} "
                    f"{one['unit']} (95 %)"
                )

    page = improvement_page(found, comparison, title=problem.title)
    report = page.write(out / "report.html")
    _draw(found, comparison, out)
    print(f"\nReport    {report.resolve()}")
    print(f"Pictures  {out.resolve()}/*.png")
    return found


def _draw(found: Improvement, comparison: Comparison, out: Path) -> None:
    """Write the pictures of the story as PNG files."""
    from oed_sysid import report

    single: dict[str, tuple[Callable[..., Any], Any]] = {
        "located": (report.plot_located, found),
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
        figure.savefig(out / f"{name}.png", dpi=130)


def _dynamics(problem: Problem) -> list[str]:
    """Lines of the equations that hold rates."""
    lines = problem.model.equations().splitlines()
    return [line for line in lines if "'" in line]


def _title(text: str) -> None:
    print(f"\n{text}\n{'-' * len(text)}")


def _tell(text: str) -> None:
    print(f"... {text}", flush=True)


if __name__ == "__main__":
    sys.exit(main())
