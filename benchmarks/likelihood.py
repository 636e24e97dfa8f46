"""How long the likelihood with random forces takes: a pass, a fit, an improvement.

    OMP_NUM_THREADS=1 python -m benchmarks.likelihood

The five records of ``remus_diving_plane`` (something is hidden in them). *Narrow* is the filter of
the nominal model, *wide* that of the model with all candidates, which the search uses; *levels*
are tangents of all noise levels and times. The fit is that of ``MultipleShooting()`` to a data set
of :mod:`benchmarks.random_forces`, medium forces. Least processor time of some repetitions.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from benchmarks.measure import least, machine, verdict
from benchmarks.random_forces.scenarios import SCENARIOS
from benchmarks.random_forces.simulator import simulate
from benchmarks.random_forces.trial import _model, believed, dataset
from oed_sysid import Dataset, Model, MultipleShooting, improve, load_problem
from oed_sysid.compiled.filtering import filter_kernel
from oed_sysid.evidence.study import fitting_candidates
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.likelihood.filtered import Filtered, disturbed_model
from oed_sysid.likelihood.score_test import Setting
from oed_sysid.physics import Effect


def passes(model: Model, train: Dataset, effects: Sequence[Effect]) -> None:
    """Print the time of a pass for one sample."""
    places = chosen_places(model, "all")
    white = np.array([output.noise_std for output in model.outputs])
    setting = Setting.of(train, places, white, np.ones(len(white), dtype=bool))
    joined, _ = fitting_candidates(model, effects)
    start = [np.nan_to_num(record.outputs[0]) for record in train]
    noise = replace(setting.noise(model, 1.0), force=np.full(len(places), 0.3))
    unit = replace(noise, force=np.ones(len(places)))
    nothing = np.zeros(len(white), dtype=bool)
    free = setting.levels(train, noise, unit, nothing)
    n_samples = sum(record.n_samples for record in train)
    for name, wide in (("narrow", model), ("wide", model + joined)):
        kernel = filter_kernel(disturbed_model(wide, setting.disturbances))
        for words, levels in (("no levels", free.held()), (f"{len(free)} levels", free)):
            problem = Filtered(model, train, levels, kernel=kernel)
            point = problem.point(start, [{}] * len(start)).unknowns
            seconds = least(lambda problem=problem, point=point: problem.passes(point), 10)
            print(f"pass, {name}, {words}: {1e6 * seconds / n_samples:.2f} us a sample")


def main() -> None:
    """Print times of passes, a fit and an improvement."""
    problem = load_problem("remus_diving_plane")
    records = problem.data()
    train, test = (
        Dataset(tuple(r for r in records if r.name.startswith(kind))) for kind in ("train", "test")
    )
    print(machine())
    passes(problem.model, train, list(problem.effects))
    scenario = SCENARIOS["medium"]
    (drawn,) = simulate(scenario, 0, range(1))
    model = _model(scenario.vehicle).with_values(believed(scenario))
    data = dataset(scenario, model, drawn.runs)
    seconds = least(lambda: MultipleShooting().fit(model, data), 5)
    samples = sum(record.n_samples for record in data)
    label = f"fit with random forces, {samples} samples of {len(model.outputs)} outputs"
    print(verdict(label, 1e3 * seconds, 100.0, "ms"))
    earlier = MultipleShooting().fit(model, data)
    seconds = least(lambda: MultipleShooting().fit(model, data, warm=earlier), 5)
    print(verdict("the same from where an earlier fit ended", 1e3 * seconds, 100.0, "ms"))
    times = []
    for _ in range(3):
        began = time.process_time()
        found = improve(problem.model, train, test, candidates=problem.effects)
        times.append(time.process_time() - began)
    added = ", ".join(step.added for step in found.steps)
    print(verdict(f"improve, {len(problem.effects)} candidates ({added})", min(times), 4.0, "s"))


if __name__ == "__main__":
    main()
