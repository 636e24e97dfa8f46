"""Whether trajectories hang on the integration step, which no estimation can mend.

A force that jumps with the state (a sign, an angle that leaps at 180 degrees)
makes a trajectory of fixed steps a staircase in the parameters: derivatives
miss the jumps, and iterations stall on a step of the stairs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.fit import Fit, Status
from oed_sysid.likelihood.gauss_newton import Solution
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.physics.model import Model

FINER = 4
# Root mean square change, in noise levels, from which the step is worth a word.
WORTH_SAYING = 0.5


def worst_step_error(shooting: Shooting, solution: Solution) -> tuple[float, str, str]:
    """Change that a finer step makes, in noise levels: the worst, its output and record.

    Parameters
    ----------
    shooting : Shooting
    solution : Solution
        Where its trajectories are simulated, without nodes.
    """
    model = shooting.model
    finer = kernel(replace(model, step=model.step / FINER))
    worst = (0.0, "", "")
    for index, record in enumerate(shooting.records):
        values = shooting.values(solution.point.unknowns, index)
        z0, _ = shooting.full_start(solution.point.unknowns, index)
        coarse, fine = (
            one.run(record.times, record.inputs, values, z0).outputs
            for one in (shooting.kernel, finer)
        )
        with np.errstate(invalid="ignore", over="ignore"):
            change = np.sqrt(np.mean(((coarse - fine) / shooting.sigma) ** 2, axis=0))
        for name, size in zip(model.output_names, change, strict=True):
            if np.isfinite(size) and size > worst[0]:
                worst = (float(size), name, record.name)
    return worst


def _or_stiff(model: Model) -> str:
    if model.integrator == "implicit":
        return ""
    return ", or take Model(integrator='implicit') if some of its motions die out within a step"


def with_step_advice(fit: Fit, shooting: Shooting, solution: Solution | None) -> Fit:
    """Add to the status of a failed fit that the step may be why."""
    if fit.status.ok or solution is None or solution.reason == "interrupted":
        return fit
    size, output, record = worst_step_error(shooting, solution)
    if size < WORTH_SAYING:
        return fit
    step = fit.model.step
    advice = (
        f"{fit.status.advice} The trajectories hang on the integration step: with "
        f"{step / FINER:g} s instead of {step:g} s, {output} of record {record!r} changes by "
        f"{size:.1f} noise levels. Reduce model.step{_or_stiff(fit.model)}; if that does not help, "
        "a force of the model jumps where the state passes some value: make it continuous."
    )
    return replace(fit, status=Status(fit.status.code, advice))
