"""Where an estimation begins: checks, an earlier fit, and how far a start is off."""

from __future__ import annotations

import numpy as np

from oed_sysid.errors import DataError
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.shooting import Point, Shooting
from oed_sysid.physics.model import Model

# Mean square misfit, in noise units, from which a start is far; from which it is
# doubtful; and which a good fit stays below.
FAR, DOUBTFUL, GOOD = 500.0, 30.0, 4.0


def check_enough_samples(shooting: Shooting) -> None:
    """Raise :class:`DataError` where there are fewer samples than unknowns."""
    layout = shooting.layout
    n_samples = sum(int(np.isfinite(record.outputs).sum()) for record in shooting.records)
    n_priors = int(np.count_nonzero(shooting.limits.prior_weight))
    n_states = layout.n_records * layout.n_own
    if n_samples + n_priors < layout.n_unknowns - min(int(shooting.limits.held.sum()), n_states):
        raise DataError(
            f"{n_samples} measured samples and {n_priors} priors cannot determine "
            f"{layout.n_unknowns} unknowns ({len(layout.shared)} parameters and, for each of "
            f"{layout.n_records} records, {layout.n_own} initial states and {len(layout.local)} "
            "parameters of its own). Add records, fix parameters, or give them a prior_std."
        )


def warm_model(model: Model, warm: Fit) -> Model:
    """Return the model with its free parameters at an earlier fit's values, within bounds."""
    free = {parameter.name: parameter for parameter in model.free_parameters}
    earlier = warm.model.values | warm.values
    return model.with_values(
        {
            name: float(np.clip(earlier[name], parameter.lower, parameter.upper))
            for name, parameter in free.items()
            if name in earlier and np.isfinite(earlier[name])
        }
    )


def warm_unknowns(shooting: Shooting, warm: Fit) -> np.ndarray:
    """Start values with the initial states and local parameters of an earlier fit.

    They are taken where the earlier fit saw a record of the same name.
    """
    unknowns, layout = shooting.start_unknowns(), shooting.layout
    for index, record in enumerate(shooting.records):
        if record.name not in warm.dataset.names:
            continue
        earlier = warm.dataset.names.index(record.name)
        if warm.dataset[earlier].times[0] != record.times[0]:
            continue
        states = dict(zip(warm.model.state_names, warm.initial_states[earlier], strict=True))
        own = np.array([states.get(name, np.nan) for name in shooting.model.state_names])
        values = warm.local_values[earlier]
        local = {n: values[n] for n in layout.local_names if n in values}
        shooting.fill(unknowns, index, own, local)
    return np.clip(unknowns, shooting.limits.lower, shooting.limits.upper)


def warm_point(shooting: Shooting, warm: Fit | None) -> Point:
    """Start on the trajectory of an earlier fit; on the measurements without, or if it diverges."""
    if warm is None:
        return shooting.start_point()
    unknowns = warm_unknowns(shooting, warm)
    point = shooting.continuous(unknowns)
    if all(np.isfinite(nodes).all() for nodes in point.nodes):
        return point
    return shooting.start_point(unknowns)


def misfit(shooting: Shooting, point: Point) -> float:
    """Mean square residual in units of noise; infinite where the model diverges."""
    squares, count = 2.0 * shooting.limits.prior_cost(point.unknowns), 0
    for index, record in enumerate(shooting.records):
        run = shooting.run(point.unknowns, index, point.nodes[index])
        present = np.isfinite(record.outputs)
        scaled = ((record.outputs - run.outputs) / shooting.sigma)[present]
        if not run.ok or not np.isfinite(scaled).all():
            return np.inf
        squares += float(scaled @ scaled)
        count += len(scaled)
    return squares / max(count, 1)
