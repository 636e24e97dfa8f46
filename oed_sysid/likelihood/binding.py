r"""Bounds and constraints that bind, and how far beyond them the records would go.

At the end of a constrained search the gradient is not zero. With information ``H`` and half the
negative gradient ``b`` of all unknowns, priors in both, the optimum of the quadratic model lies a
step :math:`\delta = H^{-1} b` away. A constraint :math:`g(p) \le 0` that is active with gradient
``a`` is exceeded there, and to first order its value is known, by

.. math:: a'\delta = \lambda\, a' H^{-1} a, \qquad \sigma_g = \sqrt{a' H^{-1} a}

so that Lagrange's multiplier of a single one is :math:`\lambda = a'\delta / \sigma_g^2`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.estimate import Binding
from oed_sysid.likelihood.filtered import Filtered
from oed_sysid.likelihood.nonlinear_program import UserConstraints
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Shooting

# Distance of a value from its limit, in standard errors, up to which it is on it.
ACTIVE = 1e-3


def binding(
    problem: Shooting | Filtered,
    unknowns: np.ndarray,
    matrix: np.ndarray,
    right: np.ndarray,
    constraints: Sequence[str] = (),
) -> tuple[Binding, ...]:
    """Name what binds at the end of a search, the farthest exceeded first.

    Parameters
    ----------
    problem : Shooting or Filtered
    unknowns : ndarray (n_unknowns,)
    matrix, right : ndarray (n_unknowns, n_unknowns), (n_unknowns,)
        Information and half the negative gradient there, priors excluded.
    constraints : sequence of str
        Among parameters, beside bounds.
    """
    limits, layout, model = problem.limits, problem.layout, problem.model
    if not constraints and not np.any((unknowns <= limits.lower) | (unknowns >= limits.upper)):
        return ()
    total, slope = limits.with_priors(matrix, right, unknowns)
    covariance = inverse_of(total)
    step = covariance @ slope
    columns = layout.record_columns(0)[layout.n_own :]
    values, slopes = layout.parameters(unknowns, 0), layout.slopes(unknowns[columns])
    found: list[tuple[str, float, np.ndarray]] = []
    for index, name in zip(layout.shared, layout.shared_names, strict=True):
        parameter = model.parameter(name)
        for sign, limit, relation in ((-1, parameter.lower, ">="), (1, parameter.upper, "<=")):
            gradient = np.zeros(len(unknowns))
            gradient[columns[index]] = sign * slopes[index]
            text = f"{name} {relation} {limit:.6g}"
            found.append((text, float(sign * (values[index] - limit)), gradient))
    if constraints:
        found += _constrained(problem, unknowns, UserConstraints(model, constraints))
    result = []
    for text, level, gradient in found:
        std = float(np.sqrt(max(float(gradient @ covariance @ gradient), 0.0)))
        beyond = float(gradient @ step)
        if std > 0 and abs(level) < ACTIVE * std and beyond > ACTIVE * std:
            result.append(Binding(text, beyond, std))
    return tuple(sorted(result, key=lambda one: -one.distance))


def _constrained(
    problem: Shooting | Filtered, unknowns: np.ndarray, user: UserConstraints
) -> Iterator[tuple[str, float, np.ndarray]]:
    """Text, excess and gradient of every constraint; along a path where it is exceeded most."""
    model, layout, runner = problem.model, problem.layout, kernel(problem.model)
    place = [model.parameter_names.index(name) for name in layout.free_names]
    for index, record in enumerate(problem.dataset):
        columns = layout.record_columns(index)
        own = unknowns[columns[: layout.n_own]]
        at = layout.parameters(unknowns, index)
        whole = model.with_values(dict(zip(layout.free_names, at, strict=True))).value_vector
        run = runner.simulate(record.times, record.inputs, whole, own, sensitivities=True)
        by_own_and_free = run.output_sensitivities
        if not run.ok or by_own_and_free is None:
            return
        slopes = layout.record_slopes(unknowns, index)
        for text, sample, excess, by_outputs, by_values in user.tightest(run.outputs, whole):
            row = np.concatenate([np.zeros(layout.n_own), by_values[place]])
            where = ""
            if sample is not None:
                row = row + by_outputs @ by_own_and_free[sample]
                where = f" at {record.times[sample]:g} s of {record.name}"
            elif index:
                continue
            gradient = np.zeros(len(unknowns))
            gradient[columns] = row * slopes
            yield f"{text}{where}", excess, gradient
