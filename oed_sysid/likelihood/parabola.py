r"""How far a likelihood is the parabola that its standard errors take it for.

Along the direction in which all unknowns follow one parameter, :math:`C e_k/\sigma_k` with the
covariance :math:`C` of all, twice the negative log-likelihood rises by :math:`d^2` at :math:`d`
standard errors if it is one. Where weak records leave a curved or a flat valley it rises by another
amount: the true values then lie many standard errors away, and the interval is no ± at all. Asked
is the parameter that the records tell least, in its own size (Bates & Watts 1980, JRSS B 42, 1;
Donaldson & Schnabel 1987, Technometrics 29, 67).
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from oed_sysid.likelihood.departures import CLEARLY
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.likelihood.gauss_newton import Point, solve, whitened
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.unknowns import Limits


def steepness(fit: Estimate) -> tuple[str, np.ndarray] | None:
    """The parameter that records tell least, and the rise of twice the cost beside it.

    Parameters
    ----------
    fit : Estimate
        That ended.

    Returns
    -------
    str
        Name of the parameter.
    ndarray (2,)
        Rise below and above the estimate, over that of a parabola; infinite where no trajectory is
        finite, one beyond a bound. None where nothing is told of any.
    """
    finite = np.isfinite([fit.std_errors[name] for name in fit.names])
    if not finite.any():
        return None
    objective, limits, matrix, unknowns = _posed(fit)
    covariance = inverse_of(matrix)
    errors = np.sqrt(np.diag(covariance))[: len(fit.names)]
    size = np.maximum(np.abs(unknowns[: len(fit.names)]), np.finfo(float).tiny)
    weakest = int(np.argmax(np.where(finite, errors / size, -1.0)))
    if not errors[weakest] > 0.0:
        return None
    step = CLEARLY * covariance[:, weakest] / errors[weakest]
    lower, upper = limits.lower, limits.upper
    begin, rises = objective(unknowns), np.ones(2)
    for k, side in enumerate((-1.0, 1.0)):
        end = unknowns + side * step
        beyond = (end < lower) | (end > upper)
        # A bound ends what a parameter may be; a level that would be less than nothing is nothing.
        if not beyond[: len(fit.names)].any():
            rises[k] = (objective(np.clip(end, lower, upper)) - begin) / CLEARLY**2
    return fit.names[weakest], rises


Posed = tuple[Callable[[np.ndarray], float], Limits, np.ndarray, np.ndarray]


def _posed(fit: Estimate) -> Posed:
    """Twice the cost of a fit, limits, information and values of all its unknowns."""
    if fit.innovations is not None:
        problem, unknowns = posed_again(fit, levels=True)
        now = whitened(problem, Point(unknowns, ()))
        matrix, _ = problem.limits.with_priors(now.equations.matrix, now.equations.right, unknowns)
        return problem.objective, problem.limits, matrix, unknowns
    shooting = Shooting(fit.model, fit.dataset, fit.sigma)
    end = solve(shooting, shooting.warm_point(fit), max_iterations=1)
    at = end.point.unknowns
    matrix, _ = shooting.limits.with_priors(end.matrix, end.right, at)
    count = sum(int(np.isfinite(record.outputs).sum()) for record in fit.dataset)

    def objective(other: np.ndarray) -> float:
        return count * shooting.misfit(shooting.continuous(other))

    return objective, shooting.limits, matrix, at
