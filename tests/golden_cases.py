"""The records on which behaviour is frozen: every shipped problem, calm and disturbed."""

from __future__ import annotations

import os
from functools import cache
from typing import Any

import numpy as np
import pytest

from oed_sysid import Dataset, Fit, Problem, Record, diagnose, improve, load_problem, simulate
from oed_sysid.evidence.compare import Diagnosis
from oed_sysid.evidence.improvement import Improvement
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.realisation import simulate_at_sea

# Problem, or problem/variant: the shipped records that are fitted; none means all.
SHIPPED: dict[str, tuple[str, ...]] = {
    "cascaded_tanks/torricelli": ("train_first_half",),
    "catamaran": (),
    "esso_osaka": ("zigzag_12_30",),
    "kvlcc2": ("10_10_P", "10_10_S"),
    "remus_6dof": ("cruise", "fast"),
    "remus_diving_plane": ("train_steps", "train_zigzag_10_10"),
    "roll_decay": (),
    "silverbox": ("train_first_realisation",),
    "slocum_glider/corrected_pitch": ("train_dive_2",),
}
# Those whose records are part of the sources.
OWN = ("catamaran", "remus_6dof", "remus_diving_plane")
# Problems without records: the experiment, and the process noise of the disturbed one as
# equation, standard deviation and correlation time.
SIMULATED: dict[str, tuple[str, tuple[str, float, float]]] = {
    "auv_diving_plane": ("zigzag_5_5", ("M", 0.1, 2.0)),
    "nomoto_sparse_heading": ("zigzag_15_15", ("N", 0.02, 1.0)),
    "online_ship": ("zigzag_10_10", ("N", 2e-6, 20.0)),
    "sailboat": ("reach_20_20", ("N", 5.0, 2.0)),
    "torpedo": ("pitching", ("M", 500.0, 1.0)),
}
EVERY = (*SHIPPED, *SIMULATED)


@cache
def problem(name: str) -> Problem:
    """A shipped problem, or a variant of it."""
    title, _, variant = name.partition("/")
    return load_problem(title, variant=variant) if variant else load_problem(title)


def begin(record: Record, n_samples: int) -> Record:
    """The first samples of a record, where it has more."""
    return record.window(record.times[0], record.times[min(n_samples, record.n_samples) - 1])


@cache
def records(name: str, *, disturbed: bool = False) -> Dataset:
    """Records to fit, cut where they are very long."""
    case = problem(name)
    if name in SHIPPED:
        if name.partition("/")[0] not in OWN and "OED_SYSID_DATA" not in os.environ:
            pytest.skip("OED_SYSID_DATA names no folder of third-party data")
        data = case.data()
        chosen = [data[one] for one in SHIPPED[name] or data.names]
        return Dataset(begin(one, 1500) for one in chosen)
    named, (equation, level, time) = SIMULATED[name]
    experiment, model = case.experiment(named), case.model
    rng = np.random.default_rng(7)
    if not disturbed:
        return Dataset([begin(simulate(model, experiment, rng=rng), 300)])
    noise = NoiseModel(
        white=np.array([output.noise_std for output in model.outputs]),
        colour=np.zeros(len(model.outputs)),
        force=np.array([level]),
        force_time=np.array([time]),
        outputs=model.output_names,
        places=(f"force {equation}",),
    )
    return Dataset([begin(simulate_at_sea(model, experiment, noise, rng=rng), 300)])


@cache
def fit_of(name: str, *, disturbed: bool = False, disturbances: str = "none") -> Fit:
    """Fit of the records of a case."""
    data = records(name, disturbed=disturbed)
    return MultipleShooting(disturbances=disturbances).fit(problem(name).model, data)


def facts(fit: Fit) -> dict[str, Any]:
    """What of a fit is frozen."""
    noise = fit.noise
    levels = {
        "white": dict(zip(noise.outputs, map(float, noise.white), strict=True)),
        "colour": dict(zip(noise.outputs, map(float, noise.colour), strict=True)),
        "force": dict(zip(noise.places, map(float, noise.force), strict=True)),
    }
    return {
        "values": {
            n: {"value": float(v), "std_error": float(fit.std_errors[n])}
            for n, v in fit.values.items()
        },
        "cost": float(fit.cost),
        "sigma": [float(one) for one in fit.sigma],
        "status": fit.status.code,
        "concerns": sorted({f"{c.kind} {c.signal} {c.record}".strip() for c in fit.concerns}),
        "grave": sorted({one.kind for one in fit.grave}),
        "levels": {k: {n: v for n, v in of.items() if v > 0} for k, of in levels.items()},
    }


@cache
def improved_diver() -> Improvement:
    """The shipped diving vehicle, whose drag in heave is hidden, once for all tests."""
    case = problem("remus_diving_plane")
    data = case.data()
    train, test = (
        Dataset(one for one in data if one.name.startswith(part)) for part in ("train", "test")
    )
    return improve(case.model, train, test, candidates=case.effects)


@cache
def diagnosed_diver() -> Diagnosis:
    """Where the model of the diving vehicle fails, and the ranking of all its candidates."""
    case = problem("remus_diving_plane")
    return diagnose(case.model, records("remus_diving_plane"), candidates=case.effects)
