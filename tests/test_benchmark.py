"""The comparison of estimators: honest measures, nothing run twice, failures counted."""

from __future__ import annotations

import ast
import csv
import io
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from commands import told
from marks import slow
from turning_ship import SHIP, record

from benchmarks.disjoint import simulated
from benchmarks.harness import ROOT, Store, study
from oed_sysid.baselines.benchmark import (
    PROBLEMS,
    Benchmark,
    benchmark,
    measure,
    verdict_table,
    verdicts,
)
from oed_sysid.baselines.contest import CONTESTANTS, Cell, Outcome, load_scenario, run_cell
from oed_sysid.cli import BAD_INPUT, commands, main
from oed_sysid.errors import ModelError, ProblemError
from oed_sysid.results.estimator_plots import figure_benchmark

TWO = ("multiple_shooting", "heading_differences")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Store of the small grid."""
    return tmp_path_factory.mktemp("runs")


@pytest.fixture(scope="module")
def small(folder: Path) -> Benchmark:
    """Two estimators on one problem at two levels with two seeds."""
    return benchmark(["nomoto_sparse_heading"], TWO, noise=[0.0, 1.0], seeds=2, store=folder)


def outcome(estimator: str, errors: list[float], *, seed: int = 0) -> Outcome:
    """A run with these errors of parameters a, b; the data determine a to 1 % and b not."""
    return Outcome(
        Cell("invented", estimator, 1.0, seed=seed),
        "converged", "", dict(zip("ab", errors, strict=True)), {"a": True, "b": False},
        {"a": 0.01, "b": 5.0}, 1.0, 3, 0.1,
    )  # fmt: skip


def test_simulation_beats_differences(small: Benchmark) -> None:
    """Multiple shooting is exact without noise and near the bound with it; differences are not."""
    rows = {(row.estimator, row.noise): row for row in small.rows}
    assert rows["multiple_shooting", 0.0].rmse < 1e-5
    assert np.isnan(rows["multiple_shooting", 0.0].coverage)
    best = rows["multiple_shooting", 1.0]
    assert 0.2 * best.bound < best.rmse_determined < 3.0 * best.bound
    assert rows["heading_differences", 0.0].rmse > 0.05
    assert all(verdict.outcome == "better" for verdict in small.verdicts())


def test_finished_runs_are_not_run_again(
    small: Benchmark, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A second call reads the store; a grid with one more seed runs that seed alone."""
    ran: list[Cell] = []

    def counted(cell: Cell) -> Outcome:
        ran.append(cell)
        return run_cell(cell)

    monkeypatch.setattr("oed_sysid.baselines.benchmark.run_cell", counted)
    again = benchmark(["nomoto_sparse_heading"], TWO, noise=[0.0, 1.0], seeds=2, store=folder)
    assert ran == []
    assert [row.rmse for row in again.rows] == [row.rmse for row in small.rows]
    benchmark(["nomoto_sparse_heading"], TWO, noise=[1.0], seeds=3, store=folder)
    assert [cell.seed for cell in ran] == [2, 2]


def test_all_estimators_get_the_same_data() -> None:
    """Noise and start values depend on the seed, not on the estimator or the noise level."""
    first = Cell("online_ship", "ekf", 0.5, seed=3)
    other = Cell("online_ship", "multiple_shooting", 3.0, seed=3)
    for purpose in ("noise", "start"):
        assert first.rng(purpose).normal() == other.rng(purpose).normal()
        assert first.rng(purpose).normal() != replace(first, seed=4).rng(purpose).normal()


def test_settings_of_an_estimator_are_part_of_the_name_of_a_run() -> None:
    """Two contestants, or two noise levels, never share a stored result."""
    cell = Cell("online_ship", "ekf", 0.5)
    changed = [replace(cell, estimator="ukf"), replace(cell, noise=1.0), replace(cell, spread=0.1)]
    changed += [replace(cell, noise_unit="declared"), replace(cell, sampling=2)]
    assert len({one.key for one in (cell, *changed)}) == 6


def test_failures_are_counted_and_cost(monkeypatch: pytest.MonkeyPatch) -> None:
    """An estimator that gives up is recorded as such, and its error is that of knowing nothing."""

    def gives_up(*_: object) -> None:
        raise np.linalg.LinAlgError("singular matrix")

    monkeypatch.setattr("oed_sysid.baselines.EquationError.fit", gives_up)
    found = run_cell(Cell("online_ship", "equation_error", 1.0))
    assert (found.status, found.failed, found.errors) == ("error", True, {})
    assert "singular matrix" in found.message
    (row,) = measure([found])
    assert (row.n_failed, row.n_without, row.rmse) == (1, 1, 1.0)
    assert not row.refused
    assert row.prediction == np.inf


def test_faults_of_programs_are_not_taken_for_failures(monkeypatch: pytest.MonkeyPatch) -> None:
    """A misspelt name somewhere ends the run instead of entering a table of methods."""

    def misspelt(*_: object) -> None:
        raise NameError("savgol")

    monkeypatch.setattr("oed_sysid.baselines.EquationError.fit", misspelt)
    with pytest.raises(NameError):
        run_cell(Cell("online_ship", "equation_error", 1.0))


def test_refusal_is_said_in_words() -> None:
    """Who cannot treat a problem is not ranked; the report says why."""
    result = benchmark(["nomoto_sparse_heading"], ["ls_svm", "ekf"], noise=[1.0], seeds=1)
    row = result.rows[-1]
    assert row.estimator == "ls_svm"
    assert "contain r, which no output measures" in row.refused
    assert "cannot: ls_svm: The regressions" in result.report()
    assert not [one for one in result.verdicts("ekf") if one.other == "ls_svm"]


def test_refusing_some_runs_only_is_failing() -> None:
    """An estimator that refuses one seed and not another has failed once."""
    refusing = replace(outcome("x", [0.0, 0.0], seed=1), status="refused", errors={})
    (row,) = measure([outcome("x", [0.1, 0.1]), refusing])
    assert not row.refused
    assert row.n_failed == 1


def test_measures() -> None:
    """Error, bias and coverage of two runs are those of a hand calculation."""
    (row,) = measure([outcome("x", [0.02, 2.0]), outcome("x", [-0.04, 1.0], seed=1)])
    assert row.n_determined == 1
    assert row.rmse_determined == pytest.approx(np.sqrt((0.02**2 + 0.04**2) / 2))
    assert row.bound == pytest.approx(0.01)
    assert row.rmse == pytest.approx(np.sqrt((0.02**2 + 0.04**2 + 4 + 1) / 4))
    assert row.bias == pytest.approx((0.01 + 1.5) / 2)
    assert row.coverage == 0.5


def test_few_runs_must_all_agree() -> None:
    """Who is better on average but not in every one of two runs is not called better."""
    ours = [outcome("multiple_shooting", [0.02, 0], seed=s) for s in range(2)]
    clear = [outcome("clear", [0.03, 0], seed=s) for s in range(2)]
    mixed = [outcome("mixed", [e, 0], seed=s) for s, e in enumerate([0.01, 0.05])]
    wins = [outcome("wins", [0.01, 0], seed=s) for s in range(2)]
    found = verdicts(measure([*ours, *clear, *mixed, *wins]), "multiple_shooting")
    assert {one.other: one.outcome for one in found} == {
        "clear": "better", "mixed": "undecided", "wins": "worse",
    }  # fmt: skip


def test_many_runs_may_disagree_a_little() -> None:
    """One run of ten against does not undo a clear difference; scatter alone is none."""
    rng = np.random.default_rng(0)
    scatter = np.exp(0.3 * rng.standard_normal(10))
    ours = [outcome("multiple_shooting", [0.02 * e, 0], seed=s) for s, e in enumerate(scatter)]
    factor = np.array([0.9, *[2.0] * 9])
    worse = [outcome("clear", [0.02 * e, 0], seed=s) for s, e in enumerate(scatter * factor)]
    shuffled = [outcome("mixed", [0.024 * e, 0], seed=s) for s, e in enumerate(scatter[::-1])]
    found = verdicts(measure([*ours, *worse, *shuffled]), "multiple_shooting")
    assert {one.other: one.outcome for one in found} == {"clear": "better", "mixed": "undecided"}


@pytest.mark.parametrize("n_runs", [3, 10])
def test_alike_is_shown_and_not_assumed(n_runs: int) -> None:
    """Runs that all give the same error are alike; a scatter of a third leaves it undecided."""
    scatter = np.tile([0.75, 1.0, 1.3], 4)[:n_runs]
    ours = [outcome("multiple_shooting", [0.02, 0], seed=s) for s in range(n_runs)]
    same = [outcome("same", [0.0202, 0], seed=s) for s in range(n_runs)]
    loose = [outcome("loose", [0.02 * e, 0], seed=s) for s, e in enumerate(scatter)]
    found = verdicts(measure([*ours, *same, *loose]), "multiple_shooting")
    assert {one.other: one.outcome for one in found} == {"same": "equal", "loose": "undecided"}
    assert "= 1 " in "".join(verdict_table(found))


@pytest.mark.parametrize("name", PROBLEMS)
def test_scenarios_keep_the_test_apart(name: str) -> None:
    """The run that judges differs from those learned from, and the model has no priors."""
    scenario = load_scenario(name)
    assert scenario.test.name not in {run.name for run in scenario.train}
    assert all(p.prior_std is None for p in scenario.model.free_parameters)
    assert (scenario.peaks > 0).all()
    assert scenario.noise(1.0) == pytest.approx(0.01 * scenario.peaks)


def test_filter_and_prior_know_the_same() -> None:
    """The contestant with beliefs gets the uncertainty that a Kalman filter assumes."""
    model = load_scenario("online_ship").model
    _, believed = CONTESTANTS["multiple_shooting_prior"].prepared(model, None, 0)
    for parameter in believed.free_parameters:
        assert parameter.prior_mean == parameter.value
        assert parameter.prior_std == pytest.approx(0.5 * parameter.magnitude)


def test_swarm_and_the_told_fit_know_the_same() -> None:
    """Told start state and region, multiple shooting ends where the swarm does."""
    told, swarm = (
        run_cell(Cell("online_ship", name, 1.0))
        for name in ("multiple_shooting_disturbed_told", "differential_swarm")
    )
    for name, error in told.errors.items():
        assert error == pytest.approx(swarm.errors[name], abs=0.05 * told.bounds[name])


def test_impossible_grids_are_refused() -> None:
    """Unknown names, negative noise and a problem with one experiment are errors with advice."""
    with pytest.raises(ModelError, match="no estimator 'ekv'"):
        benchmark(["online_ship"], ["ekv"])
    with pytest.raises(ProblemError, match="negative"):
        benchmark(["online_ship"], ["ekf"], noise=[-1.0])
    with pytest.raises(ProblemError, match="at least one seed"):
        benchmark(["online_ship"], ["ekf"], seeds=0)


def test_tables_and_picture(small: Benchmark) -> None:
    """The spreadsheet has a line per row, the report names all, the picture has a panel."""
    lines = list(csv.DictReader(io.StringIO(small.to_csv())))
    assert [line["estimator"] for line in lines] == [row.estimator for row in small.rows]
    assert float(lines[0]["rmse"]) == small.rows[0].rmse
    assert "**multiple_shooting**" in small.report()
    ax = figure_benchmark(small).axes[0]
    assert ax.get_yticklabels()[0].get_text() == "multiple shooting"


def test_command(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """The command writes tables, picture and JSON, and refuses unknown names in words."""
    arguments = ["benchmark", "estimators", "--problems", "nomoto_sparse_heading"]
    arguments += ["--estimators", *TWO, "--noise", "1", "--seeds", "1", "--jobs", "1"]
    result = told(tmp_path, [*arguments, "--out", tmp_path / "out"])
    assert "| heading_differences |" in capsys.readouterr().out
    assert (tmp_path / "out" / "benchmark.png").stat().st_size > 10_000
    assert result["verdicts"][0]["outcome"] == "better"
    assert main(["benchmark", "estimators", "--estimators", "ekv"]) == BAD_INPUT
    assert "no estimator 'ekv'" in capsys.readouterr().err


def test_hidden_effects_need_a_checkout(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """From an installation the command says what is missing; from a checkout it runs the cases."""
    place = tmp_path / "site" / "oed_sysid" / "cli" / "commands.py"
    monkeypatch.setattr(commands, "__file__", str(place))
    assert main(["benchmark", "missing-physics", "none/white:1"]) == BAD_INPUT
    assert "source checkout" in capsys.readouterr().err


@pytest.mark.parametrize("variation", [0.0, *slow(0.15)])
def test_simulated_truth(variation: float) -> None:
    """Errors between records hold with one ship and with five, those of the fit less often then."""
    rng = np.random.default_rng(1)
    logs = [record(f"run_{i}", rng) for i in range(5)]
    found = simulated(SHIP, logs, variation, 25)
    assert found["between held"] > 0.85
    assert 0.6 < found["between"] < 1.3
    assert found["told"] < 0.2
    if variation:
        assert found["stated held"] < found["between held"]
    else:
        assert found["stated held"] > 0.85


def test_what_benchmarks_import_is_there() -> None:
    """Names that a benchmark takes from the package exist, also inside functions."""
    lost = []
    for path in sorted((ROOT / "benchmarks").glob("**/*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("oed_sysid"):
                code = compile(ast.Module([node], []), str(path), "exec")
                try:
                    exec(code, {})
                except ImportError as error:
                    lost.append(f"{path.name}: {error}")
    assert lost == []


def test_a_study_goes_on_where_it_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It has the options of its cases and those of all studies, and runs what is not kept."""
    ran: list[int] = []

    def work(number: int) -> dict:
        ran.append(number)
        return {"key": str(number), "square": number**2}

    def cases(*, numbers: int = 2) -> dict:
        """So many numbers.

        Parameters
        ----------
        numbers : int
            how many
        """
        return {str(number): partial(work, number) for number in range(numbers)}

    def table(rows: list[dict]) -> str:
        return f"sum {sum(row['square'] for row in rows)}"

    kept, page = Store(tmp_path / "kept.jsonl"), tmp_path / "page.md"

    def called(*words: str) -> str:
        monkeypatch.setattr("sys.argv", ["study", *words])
        study(cases, table, kept)
        return capsys.readouterr().out

    assert "2 cases, 0 of them done" in called()
    assert "sum 5" in called("--numbers", "3", "--table", str(page))
    assert ran == [0, 1, 2]
    assert "sum 5" in page.read_text(encoding="utf-8")
    assert called("--show", "--numbers", "1") == "sum 5\n"
    assert "sum 1" in called("--store", str(tmp_path / "other.jsonl"))
    assert ran == [0, 1, 2, 0, 1]
    assert all(row["revision"] for row in kept.rows())
