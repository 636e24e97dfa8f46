"""A size that all records share: whether it is one, and what is claimed where it is not."""

from __future__ import annotations

import numpy as np
import pytest

from oed_sysid import Dataset, Input, Model, Output, Parameter, Record, State
from oed_sysid.evidence.constancy import CHANCE, Sizes, imitates, sizes_by_record
from oed_sysid.evidence.rank import threshold
from oed_sysid.evidence.reconsider import without_imitations
from oed_sysid.evidence.search import Added, Standing
from oed_sysid.evidence.study import Study
from oed_sysid.physics import sensor_scale

SHIP = Model(
    name="Nomoto ship",
    states=(State("psi", "rad", scale=0.3), State("r", "rad/s", scale=0.05)),
    inputs=(Input("delta", "rad", interpolation="linear"),),
    outputs=(Output("psi", "rad"), Output("r", "rad/s")),
    kinematics={"psi": "r", "r": "(K*delta - r)/T"},
    parameters=(
        Parameter("K", 0.15, "1/s", lower=0.01, upper=2.0),
        Parameter("T", 10.0, "s", lower=0.5, upper=100.0),
    ),
    step=0.5,
)
SCALE = sensor_scale("scale_r", "r", scale=0.03)
STEP, FINE = 0.5, 0.05
PERIODS = (50.0, 36.0, 28.0, 19.0, 33.0, 22.0)


def records(seed: int, *, scale: float, smoothing: float, cubic: float) -> Dataset:
    """Zigzags of a ship, slow and quick, by Euler's rule at 0.05 s.

    Parameters
    ----------
    seed : int
    scale : float
        Relative error of the yaw rate.
    smoothing : float
        Variance of the symmetric window with which the yaw rate was smoothed, s^2: it is short by
        half of this times the square of the frequency.
    cubic : float
        Damping that the model does not have, s^2.
    """
    rng = np.random.default_rng((5, seed))
    runs = []
    for index, period in enumerate(PERIODS):
        times = np.arange(0.0, 100.0 + FINE / 2, FINE)
        rudder = 0.3 * np.clip(4 * np.sin(2 * np.pi * times / period), -1, 1)
        heading, rate = np.zeros(len(times)), np.zeros(len(times))
        for k in range(len(times) - 1):
            turn = (0.17 * rudder[k] - rate[k] - cubic * rate[k] ** 3) / 9.0
            rate[k + 1] = rate[k] + FINE * turn
            heading[k + 1] = heading[k] + FINE * 0.5 * (rate[k] + rate[k + 1])
        second = np.gradient(np.gradient(rate, FINE), FINE)
        seen = (1 + scale) * (rate + 0.5 * smoothing * second)
        outputs = np.column_stack([heading, seen])[:: round(STEP / FINE)]
        outputs += np.array([2e-4, 1e-5]) * rng.standard_normal(outputs.shape)
        chosen = slice(None, None, round(STEP / FINE))
        runs.append(
            Record(f"run_{index}", times[chosen], rudder[chosen, None], outputs, SHIP.channels)
        )
    return Dataset(runs)


def asked(seed: int, **truth: float) -> tuple[float, float, tuple[Sizes, ...]]:
    """Gain and size of a scale on four runs, two validating, and what speaks against it."""
    runs = list(records(seed, **truth))
    study, base = Study.begin(
        SHIP, Dataset(runs[:4]), Dataset(runs[4:]), [SCALE], known_noise=False
    )
    fit = study.estimate(study.candidates, base.values, base, max_iterations=25)
    assert fit is not None
    size = fit.values["E_scale_r"]
    return base.objective - fit.objective, size, imitates(study, fit, SCALE, lambda: base)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(
    ("scale", "smoothing", "claimed"),
    [
        (0.0, 0.2, False),  # the rate was smoothed: a scale gains, another in every record
        (0.002, 0.0, True),  # as small, but the same in every record
        (0.03, 0.2, True),  # large, beside the smoothing
    ],
)
def test_small_scale_is_claimed_where_it_is_the_same_in_all_records(
    seed: int, scale: float, smoothing: float, claimed: bool
) -> None:
    """On a ship whose damping is missing, by the sizes that records show and not by the gain."""
    gain, size, against = asked(seed, scale=scale, smoothing=smoothing, cubic=60.0)
    assert gain > 5 * threshold(1, 1)
    assert (not against) == claimed
    # The smoothing takes some tenths of a per cent of it.
    assert size == pytest.approx(scale, abs=0.0005 + 0.02 * smoothing)
    assert all(one.chance < CHANCE for one in against)


def test_claim_that_does_not_repeat_is_taken_back() -> None:
    """At its end a search drops such a claim and says why; one that repeats stays."""
    for smoothing, scale in ((0.2, 0.0), (0.0, 0.002)):
        runs = list(records(1, scale=scale, smoothing=smoothing, cubic=60.0))
        study, base = Study.begin(
            SHIP, Dataset(runs[:4]), Dataset(runs[4:]), [SCALE], known_noise=False
        )
        fit = study.estimate(study.candidates, base.values, base, max_iterations=25)
        assert fit is not None
        one = Added(study.candidates[0], None, 100.0, 10.0, 20.0, ("scale_r",))
        left = without_imitations(Standing(study, (one,), fit, (base, fit)))
        assert [effect.name for effect in left.effects] == (["scale_r"] if scale else [])
        assert len(left.doubts) == (0 if scale else 1)
        assert len(left.path) == len(left.added) + 1


def test_sizes_of_records_are_those_that_were_simulated() -> None:
    """Each record shows its own scale; Cochran's statistic is that of one size where it is one."""
    one = list(records(3, scale=0.01, smoothing=0.0, cubic=0.0))
    other = list(records(3, scale=0.02, smoothing=0.0, cubic=0.0))
    for runs, true in ((one, [0.01] * 6), ([*one[:3], *other[3:]], [0.01] * 3 + [0.02] * 3)):
        study, base = Study.begin(
            SHIP, Dataset(runs[:4]), Dataset(runs[4:6]), [SCALE], known_noise=False
        )
        fit = study.estimate(study.candidates, base.values, base)
        assert fit is not None
        (found,) = sizes_by_record(study, fit, SCALE)
        # The quickest zigzag, which turns least, tells it to a tenth.
        assert found.each == pytest.approx(true, rel=0.15)
        assert found.differ == (true[-1] != true[0])
        assert (found.chance > CHANCE) == (true[-1] == true[0])
        # A further ship of such a fleet.
        low, high = found.elsewhere
        assert low < np.mean(true) < high
