"""The estimators that are compared, by short name, with the settings that are used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, cast

from oed_sysid.data.record import closest
from oed_sysid.errors import ModelError
from oed_sysid.estimators import (
    CovarianceMatrixAdaptation,
    DifferentialEvolution,
    DifferentialSwarm,
    EquationError,
    Estimator,
    GibbsRegression,
    HeadingDifferences,
    JointKalmanFilter,
    LeastSquaresSVM,
    MultipleShooting,
    OnlineRegression,
    OutputError,
    ParticleSwarm,
    SupportVectorRegression,
    TotalLeastSquares,
)
from oed_sysid.model import Model

OURS = "multiple_shooting"
OURS_DISTURBED = "multiple_shooting_disturbed"
OURS_BELIEVING = "multiple_shooting_prior"
OURS_DISTURBED_BELIEVING = "multiple_shooting_disturbed_prior"
# Take start values as a prior by their nature.
BELIEVERS = ("ekf", "ukf")
# What a Kalman filter takes a start value's uncertainty to be, if it is not told.
RELATIVE_PRIOR = 0.5


@dataclass(frozen=True)
class Contestant:
    """An estimator and what it is told besides the data and the start values.

    Parameters
    ----------
    estimator : Estimator
        With its settings.
    believes : bool
        Take start values as a prior of relative width 0.5. A Kalman filter
        does by its nature; for others it is a choice, and a fair comparison
        with the filter makes it.
    knows_start : bool
        Be told the true start state where there is one training run, as in the
        source of the differential swarm. An advantage over all others, which
        estimate or measure it.
    """

    estimator: Estimator
    believes: bool = False
    knows_start: bool = False

    def prepared(
        self, model: Model, start: Mapping[str, float] | None, seed: int
    ) -> tuple[Estimator, Model]:
        """Return the estimator with a seed, and the model with what is believed of it."""
        changes: dict[str, Any] = {"seed": seed} if hasattr(self.estimator, "seed") else {}
        if self.knows_start and start is not None:
            changes["initial"] = dict(start)
        estimator = self.estimator
        if changes:
            estimator = cast(Estimator, replace(cast(Any, estimator), **changes))
        return estimator, with_beliefs(model) if self.believes else model


# Defaults, but for what a benchmark needs: the published online weight, one process for a
# swarm that runs beside others, and Gibbs draws enough for a mean and an interval.
CONTESTANTS: Mapping[str, Contestant] = {
    OURS: Contestant(MultipleShooting(disturbances="none")),
    OURS_DISTURBED: Contestant(MultipleShooting(disturbances="auto", loss="auto")),
    OURS_BELIEVING: Contestant(MultipleShooting(disturbances="none"), believes=True),
    OURS_DISTURBED_BELIEVING: Contestant(
        MultipleShooting(disturbances="auto", loss="auto"), believes=True
    ),
    "output_error": Contestant(OutputError()),
    "equation_error": Contestant(EquationError()),
    "equation_error_simpson": Contestant(EquationError(rule="simpson")),
    "total_least_squares": Contestant(TotalLeastSquares()),
    "ls_svm": Contestant(LeastSquaresSVM()),
    "online_ls_svm": Contestant(OnlineRegression(C=3e5)),
    "svr": Contestant(SupportVectorRegression()),
    "gibbs": Contestant(GibbsRegression(n_draws=500, burn_in=200)),
    "ekf": Contestant(JointKalmanFilter()),
    "ukf": Contestant(JointKalmanFilter(kind="unscented")),
    "heading_differences": Contestant(HeadingDifferences()),
    "heading_differences_central": Contestant(HeadingDifferences("central")),
    "differential_swarm": Contestant(DifferentialSwarm(n_workers=1), knows_start=True),
    "differential_evolution": Contestant(DifferentialEvolution(n_workers=1), knows_start=True),
    "cma_es": Contestant(CovarianceMatrixAdaptation(n_workers=1), knows_start=True),
    "particle_swarm": Contestant(ParticleSwarm(n_workers=1), knows_start=True),
}
# Searches by whole populations of trajectories: minutes where others take fractions of a second.
POPULATIONS = tuple(name for name, one in CONTESTANTS.items() if one.knows_start)
QUICK = tuple(name for name in CONTESTANTS if name not in POPULATIONS)


def contestant_by_name(name: str) -> Contestant:
    """Return one estimator of the comparison.

    Examples
    --------
    >>> contestant_by_name("output_error").estimator.name
    'output error (single shooting)'
    """
    if name not in CONTESTANTS:
        raise ModelError(
            f"There is no estimator {name!r} in the benchmark. It has {', '.join(CONTESTANTS)}."
            + closest(name, CONTESTANTS)
        )
    return CONTESTANTS[name]


def with_beliefs(model: Model) -> Model:
    """Return the model whose free parameters have their values as prior means."""
    beliefs = {
        p.name: replace(p, prior_mean=p.value, prior_std=RELATIVE_PRIOR * p.magnitude)
        for p in model.free_parameters
    }
    effects = tuple(
        replace(effect, parameters=tuple(beliefs.get(p.name, p) for p in effect.parameters))
        for effect in model.effects
    )
    return replace(
        model,
        effects=effects,
        parameters=tuple(beliefs.get(p.name, p) for p in model.parameters),
    )
