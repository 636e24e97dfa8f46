"""Commands that compare methods where the truth is known: benchmark estimators, missing-physics."""

from __future__ import annotations

import importlib
import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from oed_sysid.cli.arguments import Command
from oed_sysid.cli.options import described
from oed_sysid.cli.terminal import answer, draw, note, progress, store, write
from oed_sysid.errors import OedSysidError

if TYPE_CHECKING:
    from oed_sysid.runtime.parallel import CellProgress

app = typer.Typer(
    name="benchmark",
    help="Compare methods on problems whose truth is known.",
    no_args_is_help=True,
    rich_markup_mode="rich",
)


def estimators(
    problems: list[str] | None = None,
    names: list[str] | None = None,
    noise: list[float] | None = None,
    declared: bool = False,
    sampling: list[int] | None = None,
    seeds: int = 3,
    jobs: int = 2,
    out: Path = Path("out/benchmark"),
    json_file: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Compare estimators: errors, bias, coverage, prediction, time, and who cannot or fails.

    [bold]Example[/bold]: oed-sysid benchmark estimators --problems online_ship --noise 0.5 1
    """
    from oed_sysid.baselines.benchmark import CONTESTANTS, PROBLEMS, QUICK, benchmark
    from oed_sysid.results.benchmark_plots import figure_benchmark

    chosen = list(CONTESTANTS) if names == ["all"] else names or list(QUICK)
    with progress("Running") as show:

        def tell(state: CellProgress) -> None:
            show.say(f"{state.n_done}/{state.n_cells} {state.key}")
            show.left(state.seconds_left)

        result = benchmark(
            problems or list(PROBLEMS),
            chosen,
            noise=[0.0, 0.5, 1.0, 3.0] if noise is None else noise,
            noise_unit="declared" if declared else "peak",
            sampling=sampling or [1],
            seeds=seeds,
            store=out / "runs",
            n_jobs=jobs,
            progress=tell,
        )
    text = result.report()
    answer(result.answer, text)
    write(text, out / "benchmark.md")
    write(result.to_csv(), out / "benchmark.csv")
    if any(row.noise > 0 and not row.refused for row in result.rows):
        for file in (out / "benchmark.png", picture):
            draw(partial(figure_benchmark, result), file)
    store(result.to_dict(), json_file)


def missing_physics(
    plan: str = "",
    jobs: int = 2,
    out: Path | None = None,
    json_file: Path | None = None,
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
    module = importlib.import_module("benchmarks.missing_physics.run")
    tables = importlib.import_module("benchmarks.missing_physics.measures")
    settings = {} if out is None else {"results": out / "missing_physics.jsonl"}
    found = module.run(plan or module.PLAN, n_jobs=jobs, tell=note, **settings)
    text = tables.as_markdown(found)
    rates = (f"{one['name']} {one['value']:.3g} of {one['count']}" for one in found["rates"][:2])
    answer(f"{found['n_cases']} cases: {'; '.join(rates)}.", text)
    if out is not None:
        write(text + "\n", out / "missing_physics.md")
    store(found, json_file)


COMMANDS = (estimators, missing_physics)
for command in COMMANDS:
    app.command(name=command.__name__.replace("_", "-"), cls=Command)(described(command))
