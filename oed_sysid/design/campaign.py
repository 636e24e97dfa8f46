r"""Design, measure, estimate, design again.

With all records up to run ``k`` the estimate and what is known of it are

.. math::
    \hat\theta_k = \arg\max_\theta \sum_{j \le k} \log L_j(\theta), \qquad
    F_k = \sum_{j \le k} F_j(\hat\theta_k)

and the next command is the best on them,

.. math:: u_{k+1} = \arg\max_u \varphi\left(F_k + F(u; \hat\theta_k)\right)

within limits that hold on the vehicles which :math:`F_k` leaves possible
(:mod:`oed_sysid.design.caution`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.design.experiment_design import design_experiment
from oed_sysid.design.result import Design
from oed_sysid.errors import DesignError
from oed_sysid.estimators import MultipleShooting
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.fit import Fit
from oed_sysid.model import Model


@dataclass(frozen=True, eq=False)
class Stage:
    """One run of a campaign.

    Attributes
    ----------
    design : Design
        What was proposed, on what was known then.
    record : Record
        What was measured.
    fit : Fit
        All records up to here together.
    """

    design: Design
    record: Record
    fit: Fit


def campaign(
    model: Model | Fit,
    measure: Callable[[Experiment], Record],
    n_runs: int,
    *,
    data: Dataset | None = None,
    estimator: MultipleShooting | None = None,
    **settings: Any,
) -> tuple[Stage, ...]:
    """Design a run, measure it, estimate from all records, and design the next one.

    Each design uses the values and the information of the latest fit, so that
    wrong beliefs at the beginning cost one run and not all of them.

    Parameters
    ----------
    model : Model or Fit
        The nominal vehicle at first.
    measure : callable
        Takes the designed experiment and returns the record: at sea the crew
        and a file, in a study :func:`oed_sysid.simulation.simulate`.
    n_runs : int
        How many.
    data : Dataset, optional
        Records in hand; they are estimated from as well.
    estimator : MultipleShooting, optional
        By default one that trusts the noise levels of the model.
    **settings
        As for :func:`~oed_sysid.design.design_experiment`.

    Returns
    -------
    tuple of Stage
        One for each run.

    Raises
    ------
    DesignError
        If a run does not determine the parameters, so that nothing can be
        designed on its result.
    """
    chosen = estimator or MultipleShooting(disturbances="none", noise="given")
    nominal: Model | Fit = model
    start = model.model if isinstance(model, Fit) else model
    records = tuple(data) if data is not None else ()
    stages: list[Stage] = []
    for index in range(n_runs):
        name = f"{settings.get('name', 'run')}_{index + 1}"
        design = design_experiment(nominal, **{**settings, "name": name})
        record = replace(measure(design.experiment), name=name)
        records = (*records, record)
        fit = chosen.fit(start, Dataset(records))
        if not fit.status.ok:
            raise DesignError(
                f"After run {name!r} the estimation did not converge ({fit.status}). Fix "
                "parameters that the runs do not show, or begin with a run of another kind."
            )
        stages.append(Stage(design, record, fit))
        nominal, start = fit, fit.model
    return tuple(stages)
