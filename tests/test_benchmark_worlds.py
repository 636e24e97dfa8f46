"""Worlds that are not what the model says: each departs in what it names, and by how much."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from oed_sysid.baselines.benchmark import Benchmark, benchmark
from oed_sysid.baselines.contest import Cell, load_scenario, run_cell
from oed_sysid.baselines.world import WORLDS
from oed_sysid.errors import ProblemError
from oed_sysid.experiments.simulation import simulate

PROBLEM = "nomoto_sparse_heading"


def made(world: str, *, noise: bool = True, seed: int = 0, problem: str = PROBLEM) -> np.ndarray:
    """Outputs of the first training run of a problem."""
    scenario = load_scenario(problem)
    model = scenario.with_noise(scenario.noise(1.0))
    rng = np.random.default_rng(seed)
    return WORLDS[world].record(model, scenario.train[0], rng=rng, noise=noise).outputs


@pytest.fixture(scope="module")
def clean() -> np.ndarray:
    """The run without anything."""
    return made("ideal", noise=False)


@pytest.fixture(scope="module")
def sigma() -> np.ndarray:
    """Noise of 1 % of the peak."""
    return load_scenario(PROBLEM).noise(1.0)


def test_random_forces_scale_and_have_a_memory(clean: np.ndarray) -> None:
    """Ten per cent moves the ship five times as far as two, on the same draws."""
    two, ten = (made(name, noise=False) - clean for name in ("forces_2", "forces_10"))
    assert np.std(ten) == pytest.approx(5 * np.std(two), rel=0.05)
    assert np.std(two) > 0.003 * np.std(clean)


def test_coloured_noise_has_the_same_size_and_a_memory(
    clean: np.ndarray, sigma: np.ndarray
) -> None:
    """Noise of the same standard deviation that remembers five samples."""
    errors = np.concatenate([made("coloured", seed=seed) - clean for seed in range(6)])[:, 0]
    assert np.std(errors) == pytest.approx(sigma[0], rel=0.2)
    neighbour = np.corrcoef(errors[1:], errors[:-1])[0, 1]
    assert neighbour == pytest.approx(np.exp(-1 / 5), abs=0.08)


def test_spikes_and_sparse_samples(clean: np.ndarray, sigma: np.ndarray) -> None:
    """One sample in a hundred is far off; every fourth is kept."""
    errors = np.concatenate([made("spikes", seed=seed) - clean for seed in range(6)])
    assert np.mean(np.abs(errors) > 10 * sigma) == pytest.approx(0.01, abs=0.006)
    assert np.mean(np.isfinite(made("sparse"))) == pytest.approx(0.25, abs=0.01)


@pytest.mark.parametrize(
    "world", ["ideal", "declared_half", "declared_twice", "wrong_model", "far_start"]
)
@pytest.mark.parametrize("problem", ["auv_diving_plane", "remus_diving_plane"])
def test_worlds_without_anything_random_have_the_ideal_records(problem: str, world: str) -> None:
    """Run after run holds what the ideal world simulates, to the last digit."""
    scenario = load_scenario(problem)
    model = scenario.with_noise(scenario.noise(1.0))
    rng, other = (Cell(problem, "multiple_shooting", 1.0).rng("noise") for _ in "ab")
    for run in 2 * scenario.train:
        plain = simulate(model, run, rng=rng)
        record = WORLDS[world].record(model, run, rng=other, noise=True)
        assert np.array_equal(record.outputs, plain.outputs)
        assert np.array_equal(record.inputs, plain.inputs)


def test_what_a_world_adds_leaves_the_noise_as_it_is() -> None:
    """White noise of the second record is the same beside forces, colour and spikes."""
    scenario = load_scenario("auv_diving_plane")
    model = scenario.with_noise(scenario.noise(1.0))
    std = np.array([output.noise_std for output in model.outputs])
    errors = {}
    for world in ("ideal", "forces_5", "spikes", "sparse"):
        rng, silent = np.random.default_rng(4), np.random.default_rng(4)
        for run in 2 * scenario.train:
            noisy = WORLDS[world].record(model, run, rng=rng, noise=True).outputs
            clean = WORLDS[world].record(model, run, rng=silent, noise=False).outputs
        errors[world] = (noisy - clean) / std
    for world in ("forces_5", "spikes"):
        assert errors[world] == pytest.approx(errors["ideal"], abs=1e-9)
    kept = np.isfinite(errors["sparse"])
    assert errors["sparse"][kept] == pytest.approx(errors["ideal"][kept], abs=1e-9)


def test_what_is_believed_departs_and_truth_does_not() -> None:
    """Declared levels and known numbers differ from the truth as stated; free ones do not."""
    scenario = load_scenario("auv_diving_plane")
    model = scenario.with_noise(scenario.noise(1.0))
    half = WORLDS["declared_half"].believed(model, np.random.default_rng(0))
    assert half.outputs[0].noise_std == pytest.approx(0.5 * model.outputs[0].noise_std)
    wrong = WORLDS["wrong_model"].believed(model, np.random.default_rng(0))
    known = [p.name for p in model.all_parameters if p.fixed and p.value]
    off = np.array([wrong.values[name] / model.values[name] - 1 for name in known])
    assert 0.0 < np.abs(off).max() <= 0.05
    assert {n: wrong.values[n] for n in model.free_names} == {
        n: model.values[n] for n in model.free_names
    }


@pytest.mark.slow
def test_spikes_hurt_who_takes_them_for_motion(tmp_path: Path) -> None:
    """The disturbed fit leaves spikes out; the plain one is bent by them; tables say so."""
    result = benchmark(
        [PROBLEM],
        ["multiple_shooting", "multiple_shooting_disturbed"],
        noise=[1.0],
        seeds=8,
        worlds=["ideal", "spikes"],
        store=tmp_path,
    )
    assert isinstance(result, Benchmark)
    rows = {(row.world, row.estimator): row for row in result.rows}
    assert len(rows) == 4
    assert rows["spikes", "multiple_shooting"].rmse_determined > (
        1.2 * rows["spikes", "multiple_shooting_disturbed"].rmse_determined
    )


def test_names_of_runs_without_a_world_are_what_they_were() -> None:
    """A store from before there were worlds is still found; worlds have names of their own."""
    plain, world = (
        Cell(PROBLEM, "multiple_shooting", 1.0, world=name).key for name in ("ideal", "spikes")
    )
    assert "spikes" in world
    assert plain.startswith(f"{PROBLEM} multiple_shooting noise 1 seed 0 sampling 1 ")
    assert plain != world
    with pytest.raises(ProblemError, match="no world"):
        run_cell(Cell(PROBLEM, "multiple_shooting", 1.0, world="spike"))


def test_models_with_actuators_are_pushed_too() -> None:
    """A force sees the actuators, and the push comes beside them."""
    scenario = load_scenario("remus_diving_plane")
    model = scenario.with_noise(scenario.noise(1.0))
    assert model.actuators
    still, pushed = (
        WORLDS[name].record(model, scenario.train[0], rng=np.random.default_rng(0), noise=False)
        for name in ("ideal", "forces_5")
    )
    moved = np.std(pushed.outputs - still.outputs, axis=0) / np.std(still.outputs, axis=0)
    assert (moved > 0.003).all()
    assert (moved < 1.0).all()


@pytest.mark.slow
def test_bounds_count_what_the_world_adds() -> None:
    """Under disturbance forces nobody can reach what white noise alone would allow.

    The scatter of fits that look for forces themselves is that of the bound; the bound of white
    noise, several times smaller, is not.
    """
    cells = [
        Cell("auv_diving_plane", "multiple_shooting_disturbed", 1.0, seed=seed, world="forces_5")
        for seed in range(8)
    ]
    pushed = [run_cell(cell) for cell in cells]
    white = run_cell(replace(cells[0], world="ideal")).bounds
    names = list(white)
    errors = np.array([[run.errors[name] for name in names] for run in pushed])
    bounds = np.array([[run.bounds[name] for name in names] for run in pushed])
    ratio = np.sqrt(np.mean((errors / bounds) ** 2))
    assert ratio == pytest.approx(1.0, abs=0.25)
    assert np.sqrt(np.mean((errors / list(white.values())) ** 2)) > 2.5


def test_noise_of_a_world_is_what_its_records_hold() -> None:
    """Levels and times as drawn: forces by equation, colour beside white noise."""
    scenario = load_scenario("remus_diving_plane")
    model = scenario.with_noise(scenario.noise(1.0))
    run = scenario.train[0]
    two, ten = (WORLDS[name].noise(model, run) for name in ("forces_2", "forces_10"))
    assert ten.force == pytest.approx(5 * two.force)
    assert ten.places == ("force X", "force Z", "force M")
    assert ten.force_time == pytest.approx(4 * run.sample_time)
    mixed = WORLDS["all"].noise(model, run)
    assert mixed.sensors == pytest.approx([output.noise_std for output in model.outputs])
    assert mixed.colour == pytest.approx(mixed.white)
