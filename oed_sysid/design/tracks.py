r"""Where a run goes: the track, the range of plausible ones, and the sea room that it needs.

Of the nominal vehicle and of others drawn from what is known, in waves where any are expected, the
track is a state of the model (``x``, ``y``) or follows from its velocities,

.. math::
    \dot x = u \cos\psi - v \sin\psi, \quad \dot y = u \sin\psi + v \cos\psi
    \qquad\text{or}\qquad \dot x = u \cos\theta + w \sin\theta

in the horizontal plane from the start (x ahead, y to starboard), or along the course with depth
beneath it. The sea room is the box that all but a share of the vehicles stay within,

.. math:: [\,Q_{\alpha/2}(\min_t x),\; Q_{1 - \alpha/2}(\max_t x)\,]

and the same across, :math:`\alpha` being 5 %. A steady current is not in it: add its speed times
the length of the run.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.design.robust import draw_structures
from oed_sysid.errors import DesignError, OedSysidError
from oed_sysid.experiment import Experiment, Limits
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.noise.realisation import at_sea
from oed_sysid.simulation import Trajectory, simulate, simulate_inputs

_TAIL = 0.025


@dataclass(frozen=True, eq=False)
class Tracks:
    """Tracks of one run.

    Attributes
    ----------
    times : ndarray (n_times,)
        s.
    nominal : ndarray (n_times, 2)
        Of the nominal vehicle: ahead and to starboard, or along the course and depth, m.
    plausible : ndarray (n_vehicles, n_times, 2)
        Of others.
    is_vertical : bool
        Whether the second is depth.
    length : float or None
        Of the vehicle, m.
    """

    times: np.ndarray
    nominal: np.ndarray
    plausible: np.ndarray
    is_vertical: bool
    length: float | None = None

    @property
    def room(self) -> np.ndarray:
        """Box that all but the most extreme vehicles stay within, m.

        Returns
        -------
        ndarray (2, 2)
            Rows: along, across (or depth); columns: lowest, highest.
        """
        every = np.concatenate([self.nominal[None], self.plausible])
        low = np.quantile(every.min(axis=1), _TAIL, axis=0)
        high = np.quantile(every.max(axis=1), 1 - _TAIL, axis=0)
        own = self.nominal
        return np.column_stack(
            [np.minimum(low, own.min(axis=0)), np.maximum(high, own.max(axis=0))]
        )

    def words(self) -> list[str]:
        """Sea room in words, in metres and lengths of the vehicle."""
        (back, ahead), (first, last) = self.room
        lines = [f"ahead {self._far(ahead)}, astern of the start {self._far(abs(min(back, 0.0)))}"]
        if self.is_vertical:
            lines.append(f"depth {first:.3g} to {last:.3g} m")
        else:
            port, starboard = abs(min(first, 0.0)), max(last, 0.0)
            lines.append(f"to port {self._far(port)}, to starboard {self._far(starboard)}")
        spread = np.abs(self.plausible - self.nominal).max(axis=(1, 2))
        lines.append(
            f"other vehicles are up to {self._far(float(np.quantile(spread, 1 - _TAIL)))} from the "
            f"drawn track ({len(self.plausible)} simulated; no steady current)"
        )
        return lines

    def _far(self, metres: float) -> str:
        text = f"{metres:.3g} m"
        return text if self.length is None else f"{text} ({metres / self.length:.2g} L)"


def plausible_tracks(
    model: Model,
    experiment: Experiment,
    *,
    rng: np.random.Generator,
    spread: float | None = 0.3,
    prior: Information | None = None,
    others: Sequence[Model] = (),
    sea: NoiseModel | None = None,
    length: float | None = None,
    n_vehicles: int = 60,
) -> Tracks | None:
    """Simulate where a run goes on the nominal vehicle and on others.

    Parameters
    ----------
    model, experiment, rng, spread, prior, others, sea
        See :func:`~oed_sysid.design.assess_limits`.
    length : float, optional
        Of the vehicle, m.
    n_vehicles : int

    Returns
    -------
    Tracks or None
        None where the model knows no course: neither ``x`` and ``y``, nor surge with heading or
        pitch.

    Raises
    ------
    DesignError
        If the run diverges on most vehicles.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("kvlcc2", variant="mmg")
    >>> run = replace(ship.experiment("zigzag_10_10"), duration=60.0, feedback="true")
    >>> found = plausible_tracks(
    ...     ship.model, run, rng=np.random.default_rng(0), spread=0.1, n_vehicles=4, length=7.0
    ... )
    >>> found.plausible.shape[0], bool(50 < found.room[0, 1] < 80)
    (4, True)
    """
    free = replace(experiment, limits=Limits())
    record = simulate(model, free, noise=False)
    first = simulate_inputs(model, record.times, inputs=record.inputs, initial=free.initial)
    own = _track(first)
    if own is None:
        return None
    found = []
    for vehicle in draw_structures(model, others, spread, n_vehicles, prior, rng):
        try:
            meant, planned = vehicle, free
            if sea is not None and sea.has_forces:
                meant, planned = at_sea(vehicle, free, sea, rng=rng)
            commands = simulate(meant, planned, noise=False).inputs
            run = simulate_inputs(meant, free.times, inputs=commands, initial=free.initial)
        except OedSysidError:
            continue
        track = _track(run)
        if track is not None:
            found.append(track)
    if len(found) < max(1, n_vehicles // 2):
        raise DesignError(
            f"The run stays finite on {len(found)} of {n_vehicles} vehicles only, so that no sea "
            "room can be stated. Make it gentler, or shorter."
        )
    vertical = not _knows(first, "psi") and not (_knows(first, "x") and _knows(first, "y"))
    return Tracks(first.times, own, np.stack(found), vertical, length)


def _knows(run: Trajectory, name: str) -> bool:
    try:
        run.signal(name)
    except OedSysidError:
        return False
    return True


def _track(run: Trajectory) -> np.ndarray | None:
    """Track from the start, ``(n_times, 2)``."""
    if _knows(run, "x") and _knows(run, "y"):
        track = np.column_stack([run.signal("x"), run.signal("y")])
        return np.asarray(track - track[0])
    if not _knows(run, "u"):
        return None
    u = run.signal("u")
    if _knows(run, "psi"):
        psi = run.signal("psi") - run.signal("psi")[0]
        v = run.signal("v") if _knows(run, "v") else np.zeros_like(u)
        rates = np.column_stack([u * np.cos(psi) - v * np.sin(psi),
                                 u * np.sin(psi) + v * np.cos(psi)])  # fmt: skip
        return _integrated(run.times, rates)
    if not (_knows(run, "theta") and _knows(run, "z")):
        return None
    theta = run.signal("theta")
    w = run.signal("w") if _knows(run, "w") else np.zeros_like(u)
    along = _integrated(run.times, (u * np.cos(theta) + w * np.sin(theta))[:, None])
    return np.column_stack([along[:, 0], run.signal("z")])


def _integrated(times: np.ndarray, rates: np.ndarray) -> np.ndarray:
    """Integral from the first sample by the trapezoidal rule."""
    steps = 0.5 * (rates[1:] + rates[:-1]) * np.diff(times)[:, None]
    return np.concatenate([np.zeros((1, rates.shape[1])), np.cumsum(steps, axis=0)])
