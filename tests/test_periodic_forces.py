"""A periodic force is named in the equation where it acts, in long records too."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oed_sysid import Dataset, Model, Record, load_problem, simulate
from oed_sysid.evidence.rank import Ranking, rank, threshold
from oed_sysid.evidence.score import lines
from oed_sysid.evidence.study import Study
from oed_sysid.physics import wave_force

AUV = load_problem("remus_diving_plane")
SHIP = load_problem("kvlcc2", variant="mmg")
# Sizes of a wave in each equation, N and N m, that move the vehicle by some noise levels.
SIZES = {"X": 0.4, "Z": 1.0, "M": 0.3}, {"X": 6.0, "Y": 12.0, "N": 20.0}


def ranked(problem: object, sizes: dict[str, float], axis: str, omega: float) -> Ranking:
    """Waves as candidates in every equation of a vehicle that one acts on, 400 s long."""
    model: Model = problem.model  # type: ignore[attr-defined]
    runs = [replace(e, duration=400.0) for e in list(problem.experiments.values())[:2]]  # type: ignore[attr-defined]
    waves = {a: wave_force(f"wave_{a}", a, frequency=0.6, scale=s) for a, s in sizes.items()}
    truth = model
    if axis:
        present = {f"E_wave_{axis}_cos": sizes[axis], f"omega_wave_{axis}": omega}
        truth = model + waves[axis].with_values(present)
    records = []
    for index, run in enumerate(runs):
        seen = simulate(truth, run, noise=True, rng=np.random.default_rng([3, index]))
        records.append(
            Record(f"run_{index}", seen.times, seen.inputs, seen.outputs, model.channels)
        )
    study, fit = Study.begin(
        model, Dataset(records), None, tuple(waves.values()), known_noise=True, disturbances="none"
    )
    return rank(study, fit, study.candidates)


OMEGAS = 0.713, 0.476  # between the grid's frequencies
CASES = [
    (vehicle, own, axis) for vehicle, own in zip((AUV, SHIP), SIZES, strict=True) for axis in own
]


@pytest.mark.parametrize(
    ("problem", "sizes", "axis", "omega"),
    [
        pytest.param(*case, omega, marks=() if (i + j) % 2 else pytest.mark.slow)
        for i, case in enumerate(CASES)
        for j, omega in enumerate(OMEGAS)
    ],
)
def test_wave_is_named_where_it_acts(
    problem: object, sizes: dict[str, float], axis: str, omega: float
) -> None:
    """The right equation is first, alone in its group, and the frequency right."""
    found = ranked(problem, sizes, axis, omega)
    best = found.refits[0]
    assert best.name == f"wave_{axis}"
    assert best.gain > found.needed(best)
    assert [one.name for one in found.group()] == [f"wave_{axis}"]
    assert best.fit.values[f"omega_wave_{axis}"] == pytest.approx(omega, abs=0.004)
    # The score alone is most of the refit's gain: its frequency was not missed.
    assert best.score.statistic > 0.5 * best.gain


@pytest.mark.parametrize(("problem", "sizes"), [(AUV, SIZES[0]), (SHIP, SIZES[1])])
def test_no_wave_is_found_where_there_is_none(problem: object, sizes: dict[str, float]) -> None:
    """The best of many frequencies gains by chance; what a claim needs counts them."""
    found = ranked(problem, sizes, "", 0.0)
    assert all(one.gain < found.needed(one) for one in found.refits)
    for score in found.scores:
        assert score.trials == pytest.approx(0.48 * 400.0 / (2 * np.pi), rel=0.01)
        assert found.needed_by(score) > threshold(len(sizes), score.freedom)


def test_chance_of_the_best_frequency() -> None:
    """In white noise the best line passes what a claim needs no oftener than it should."""
    t = np.arange(0.0, 600.0, 1.0)
    trials = 0.5 * 600.0 / (2 * np.pi)
    strict, loose, count = 0, 0, 200
    for seed in range(count):
        noise = np.random.default_rng([9, seed]).standard_normal((len(t), 1))
        (omega, *_) = lines([t], [noise], 0.4, 0.9)
        power = 2.0 * abs(np.exp(-1j * omega * t) @ noise[:, 0]) ** 2 / len(t)
        strict += power > threshold(1, 3, 0.05, trials=trials)
        loose += power > threshold(1, 3, 0.05)
    assert strict <= 0.05 * count
    assert loose > 0.3 * count


def test_lines_are_none_where_a_record_is_short() -> None:
    """A record shorter than a swing tells no frequency."""
    t = np.arange(0.0, 4.0, 0.5)
    assert len(lines([t], [np.ones((len(t), 1))], 0.4, 0.6)) == 0
