r"""Locate where a model fails: at which stage of the signal chain, in which equation, when.

At one place of the chain after the other a disturbance of level ``s`` is let into the linear
deviations along the smoothed path, its level estimated by restricted likelihood (parameters and
start states projected out), and its gain over white noise alone compared:

.. math:: 2 \log L_R(s) = -\log\det V(s) - \log\det J' V(s)^{-1} J - r' P(s)\, r

Free parameters absorb part of a missing force. What is smoothed from the residuals, the
*residual force*, is the rest; a candidate is put through the same projection and the same
smoother before it is compared with it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import SimulationError
from oed_sysid.evidence.by_motion import in_words
from oed_sysid.evidence.rank import Ranking
from oed_sysid.likelihood.disturbances import Place, places
from oed_sysid.likelihood.fit import align
from oed_sysid.likelihood.gauss_newton import FilteredSolution
from oed_sysid.likelihood.kalman import Deviations
from oed_sysid.likelihood.linearisation import Along, along, smoothed_states
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.restricted_likelihood import Grounds, Restricted, restricted
from oed_sysid.likelihood.smoother import Smoothed, smooth
from oed_sysid.runtime.display import as_dict

# Correlation times of the disturbances that are tried, s: passing and lasting.
CORRELATION_TIMES = (1.0, 20.0)
# Places that are judged once more where they themselves are disturbed.
N_REFINED = 4
# Gain in twice the log-likelihood below which no place is accused: chance gives more in
# less than one of a hundred records, fourteen places looked at.
CLEAR = 12.0
# Places whose gain is this near the best cannot be told from it.
GROUP_WIDTH = 6.0
# Share of its gain that a kinematic relation has to be ahead of other places: it is exact, and
# mostly stands for two sensors that disagree.
IDENTITY = 0.01
# Candidates whose signatures are put beside the residual forces.
N_RIVALS = 2
# Most pieces into which a record is cut where deviations grow along it.
MOST_PIECES = 8
# Places that a report lists.
LISTED = 8

WORDS = {
    "actuator": "between the command and the actual {signal}",
    "flow": "in the flow past the hull, {signal}",
    "force": "in the forces of the {signal} equation",
    "kinematics": "in the kinematics of {signal}",
    "sensor": "in the measurement of {signal}",
}


# Levels that are tried first, in units that move some output by its noise, and the
# ratio within which the best is settled.
LEVELS = (0.03, 0.12, 0.5, 2.0, 8.0)
SETTLED = 1.15
# At the edge of the levels tried, so small a gain is not followed; nor is the level of a place
# that explains less than this share of what another does.
FLAT, FAINT = 0.2, 0.1
# Levels tried beyond the first ones, at most.
MOST_ROUNDS = 6
# Relinearisations of the most likely places.
REFINEMENTS = 2


@dataclass(frozen=True, eq=False)
class Located:
    """Where a model fails.

    Attributes
    ----------
    places : tuple of Place
        Largest gain first.
    gains : dict
        Log-likelihood gain that a disturbance at each place brings over white
        noise alone, keys such as ``"force Z"``.
    levels : dict
        Most likely standard deviation of that disturbance, in its unit.
    force_names : tuple of str
        Equations, in the order of the columns of ``forces``.
    forces : tuple of Series
        Smoothed residual forces, all let in together, per record.
    discrepancies : dict
        For the places with the largest gain, the smoothed disturbance there
        if nothing else is wrong; one :class:`Series` per record.
    signatures : dict
        For every rival, the residual forces ``(n_times, n_forces)`` that would
        be seen if it were the truth and nothing were noisy, per record.
    agreement : dict
        Correlation of each signature with the residual forces, in units of
        their standard errors.
    by_motion : str
        Of independent tests, which no disturbance links, where the model fails as a function of
        motions and inputs, in words; empty for time series.
    """

    places: tuple[Place, ...]
    gains: dict[str, float]
    levels: dict[str, float]
    force_names: tuple[str, ...]
    forces: tuple[Series, ...]
    discrepancies: dict[str, tuple[Series, ...]]
    signatures: dict[str, tuple[np.ndarray, ...]]
    agreement: dict[str, float]
    by_motion: str = ""

    @classmethod
    def nothing(cls, fit: FilteredSolution) -> Located:
        """A finding without any gain, where locating was not possible."""
        where = places(fit.problem.model)
        zero = {place.name: 0.0 for place in where}
        return cls(where, zero, dict(zero), (), (), {}, {}, {})

    @property
    def evidence(self) -> dict[str, float]:
        """Earlier name of ``gains``."""
        return self.gains

    @property
    def best(self) -> str | None:
        """Place with the largest gain; None where chance explains all of it."""
        name = self.places[0].name
        return name if self.gains[name] > CLEAR else None

    @property
    def group(self) -> tuple[str, ...]:
        """The best place and those that these records cannot tell from it."""
        if self.best is None:
            return ()
        top = self.gains[self.best]
        near = (name for name, gain in self.gains.items() if abs(top - gain) < GROUP_WIDTH)
        return tuple(near)

    @property
    def verdict(self) -> str:
        """The finding in one or two sentences."""
        if self.by_motion:
            return self.by_motion
        if self.best is None:
            return (
                "No place stands out: noise of the sensors, as strong as it has to be, explains "
                "what is left as well as a disturbance at any one place would."
            )
        words = {place.name: _words(place) for place in self.places}
        text = f"Something is missing {words[self.best]}"
        rivals = [words[name] for name in self.group if name != self.best]
        if rivals:
            text += ", or as likely " + ", or ".join(rivals)
        later = [name for name in self.gains if name not in self.group]
        if later:
            lag = self.gains[self.best] - self.gains[later[0]]
            text += f" (next: {later[0]}, log-likelihood gain {lag:.0f} lower)" if lag > 0 else ""
        return text + "."

    def report(self) -> str:
        """Return the finding as text."""
        rows = [("where the model fails", "log-likelihood gain", "behind the best", "size", "unit")]
        top = max(self.gains.values())
        for place in self.places[:LISTED]:
            gain = self.gains[place.name]
            if gain > CLEAR:
                size = f"{self.levels[place.name]:.2g}"
                rows.append((place.name, _count(gain), _count(top - gain), size, place.unit))
        lines = [*align(rows), ""] if len(rows) > 1 else []
        lines.append(self.verdict)
        if self.best is not None:
            lines += [
                "The smoothed residual force is the part of the missing force that the free",
                "parameters could not absorb, not the missing force itself: compare it with the",
                "signature of a candidate, which has been through the same projection.",
            ]
        if self.agreement:
            pairs = [("candidate", "agreement with the residual forces")]
            pairs += [(name, f"{value:.2f}") for name, value in self.agreement.items()]
            lines += ["", *align(pairs)]
        return "\n".join(lines)

    to_dict = as_dict(
        "best", "group", "verdict", "gains", "levels", "discrepancies", "signatures", "agreement",
        units=lambda self: {place.name: place.unit for place in self.places},
        forces=lambda self: {"names": self.force_names, "records": self.forces},
    )  # fmt: skip


def along_fit(fit: FilteredSolution, unit: NoiseModel, *, pieces: int = 1) -> tuple[Along, Dataset]:
    """Linearise a fit along its smoothed trajectories.

    Where deviations grow beyond all bounds along a record (missing damping, an unstable
    vehicle), records are cut, each piece with start states of its own.

    Returns
    -------
    linear : Along
    dataset : Dataset
        The records, possibly cut, in the order of the stretches.
    """
    problem = fit.problem
    passes = problem.passes(fit.point.unknowns, columns=False)
    size = problem.kernel.n_full
    kept = np.arange(size) if problem.own is None else problem.own
    records, nodes, local = [], [], []
    for record, part, own in zip(problem.records, passes, fit.local, strict=True):
        edges = np.linspace(0, record.n_samples, pieces + 1).astype(int)
        for number, (first, stop) in enumerate(pairwise(edges)):
            records.append(_piece(record, first, stop, number) if pieces > 1 else record)
            nodes.append(part.path[first:stop, kept])
            local.append(own)
    dataset = Dataset(tuple(records))
    model = problem.model.with_values(fit.values)
    try:
        noise = forces_only(fit.noise, len(unit.force))
        linear = along(model, model.free_names, dataset, nodes, noise, unit, local)
    except SimulationError:
        if pieces >= MOST_PIECES or min(r.n_samples for r in records) < 40:
            raise
        return along_fit(fit, unit, pieces=2 * pieces)
    return linear, dataset


def forces_only(noise: NoiseModel, count: int) -> NoiseModel:
    """The first disturbances of a noise model: the forces of the equations."""
    return replace(
        noise,
        force=noise.force[:count],
        force_time=noise.force_time[:count],
        places=noise.places[:count],
    )


def _piece(record: Record, first: int, stop: int, number: int) -> Record:
    part = slice(first, stop)
    return replace(
        record,
        name=f"{record.name}, part {number + 1}",
        times=record.times[part],
        inputs=record.inputs[part],
        outputs=record.outputs[part],
    )


def locate(
    fit: FilteredSolution,
    unit: NoiseModel,
    rivals: Mapping[str, FilteredSolution] | None = None,
    *,
    correlation_times: Sequence[float] = CORRELATION_TIMES,
) -> Located:
    """Locate where a model fails.

    At one place of the chain after the other (every actuator, flow, equation,
    kinematic relation and sensor) a disturbance is let in, its variance
    estimated by restricted maximum likelihood, and the gain in likelihood over
    white noise compared. Parameters and initial states are projected out: what
    they can explain accuses no place.

    Parameters
    ----------
    fit : FilteredSolution
        The present model, with estimated noise levels.
    unit : NoiseModel
        Natural size of every level.
    rivals : mapping of str to FilteredSolution, optional
        Fits of models that may be right, as a ranking's refits hold them;
        their signatures are put beside the residual forces.
    correlation_times : sequence of float
        Of the disturbances, s; for every place the likelier one counts.
    """
    if fit.problem.dataset.only_tests:
        return replace(Located.nothing(fit), by_motion=in_words(fit))
    linear, dataset = along_fit(fit, unit)
    first: dict[Place, Evidence] = {}
    for time in correlation_times:
        for part in evidence(linear, correlation_time=time):
            if part.place not in first or part.gain > first[part.place].gain:
                first[part.place] = part
    ordered = sorted(first.values(), key=lambda part: -part.gain)
    found = [
        refined(linear, part) if position < N_REFINED and part.gain > CLEAR else part
        for position, part in enumerate(ordered)
    ]
    # Of places that are one and the same to the records, the equation is named first.
    found.sort(key=lambda part: (-round(_weight(part)), part.place.stage != "force"))
    times = [record.times for record in dataset]
    smoother = residual_forces(linear)
    forces = smoother.series(times)
    signatures = {}
    if len(dataset) == len(fit.problem.dataset):
        for name, rival in (rivals or {}).items():
            changes = [
                simulated(rival, index) - record.outputs for index, record in enumerate(dataset)
            ]
            if all(np.isfinite(part).any() for part in changes):
                signatures[name] = smoother.signature(changes)
    return Located(
        places=tuple(part.place for part in found),
        gains={part.place.name: part.gain for part in found},
        levels={part.place.name: part.level for part in found},
        force_names=tuple(linear.where[i].signal for i in linear.forces),
        forces=forces,
        discrepancies={
            part.place.name: _discrepancy(part, times)
            for part in found[:N_REFINED]
            if part.gain > CLEAR
        },
        signatures=signatures,
        agreement={name: agreement(forces, parts) for name, parts in signatures.items()},
    )


def simulated(fit: FilteredSolution, index: int) -> np.ndarray:
    """Outputs of a fit's model on its own along one record, ``(n_times, n_outputs)``."""
    return fit.problem.alone(fit.point.unknowns, index)[0]


def _weight(part: Evidence) -> float:
    """Gain by which places are ordered; a geometric identity has to be accused clearly."""
    return part.gain * (1.0 - IDENTITY if part.place.stage == "kinematics" else 1.0)


def likeliest(ranking: Ranking) -> dict[str, FilteredSolution]:
    """Fits with each of the best candidates, for their signatures."""
    return {refit.name: refit.fit for refit in ranking.refits[:N_RIVALS]}


def _discrepancy(part: Evidence, times: Sequence[np.ndarray]) -> tuple[Series, ...]:
    """Disturbance of one place if nothing else is wrong."""
    return ResidualForces.of(part.grounds, part.noise, part.records).series(times)


def _words(place: Place) -> str:
    return WORDS[place.stage].format(signal=place.signal)


def _count(gain: float) -> str:
    return f"{gain:.0f}" if gain < 1e5 else f"{gain:.2g}"


@dataclass(frozen=True, eq=False)
class Evidence:
    """One place with the most likely size of its disturbance.

    Attributes
    ----------
    place : Place
    gain : float
        Gain in twice the log-likelihood over white noise alone.
    level : float
        Standard deviation of the disturbance, in the place's unit.
    grounds : Grounds
        Sensitivities and residuals of the linearisation that was used.
    records : sequence of Deviations
        Linear deviations driven at the place.
    noise : NoiseModel
        White noise and the disturbance.
    solution : Restricted
        With the unknowns that go with it.
    """

    place: Place
    gain: float
    level: float
    grounds: Grounds
    records: Sequence[Deviations]
    noise: NoiseModel
    solution: Restricted


def evidence(
    found: Along, chosen: Sequence[int] | None = None, *, correlation_time: float
) -> list[Evidence]:
    """Evidence for places of the chain, largest first.

    Parameters
    ----------
    found : Along
        The linearised model.
    chosen : sequence of int, optional
        Positions of the places to judge; all by default.
    correlation_time : float
        Of the disturbances, s.
    """
    chosen = range(len(found.where)) if chosen is None else chosen
    # A level that nobody declared must not make every misfit evidence for a disturbance.
    stated = all(output.noise_std is not None for output in found.system.model.outputs)
    grounds = replace(found.grounds, scale_known=stated)
    nothing = np.zeros_like(grounds.white)
    quiet = NoiseModel(grounds.white, nothing, np.zeros(1), force_time=correlation_time)
    records = [[stretch.alone(index) for stretch in found.stretches] for index in chosen]
    units = found.units(correlation_time)[list(chosen)]
    base = restricted(grounds, [quiet], [records[0]])[0].objective
    logs = np.log(LEVELS)
    tables = [
        {float(x): s for x, s in zip(logs, solutions, strict=True)}
        for solutions in _at_levels(grounds, quiet, records, np.outer(units, LEVELS))
    ]
    for _ in range(MOST_ROUNDS):
        gains = [base - table[_best(table)].objective for table in tables]
        trials = {
            i: x
            for i, x in enumerate(map(_next_level, tables))
            if x is not None and not gains[i] < FAINT * max(gains)
        }
        if not trials:
            break
        wanted = [records[i] for i in trials]
        sizes = np.array([[units[i] * np.exp(x)] for i, x in trials.items()])
        for (i, x), parts in zip(
            trials.items(), _at_levels(grounds, quiet, wanted, sizes), strict=True
        ):
            tables[i][x] = parts[0]
    best = [_best(table) for table in tables]
    result = []
    for position, index in enumerate(chosen):
        solution = tables[position][best[position]]
        level = solution.scale * float(units[position] * np.exp(best[position]))
        gain = max(base - solution.objective, 0.0)
        noise = replace(quiet, white=solution.scale * quiet.white, force=np.array([level]))
        lines = records[position]
        result.append(Evidence(found.where[index], gain, level, grounds, lines, noise, solution))
    return sorted(result, key=lambda e: -e.gain)


def refined(found: Along, first: Evidence) -> Evidence:
    """Evidence for one place where the model is linearised with that disturbance let in.

    The parameters bend to a missing effect; where the right place is disturbed
    they straighten, and what a disturbance there does changes with them. At
    the wrong place they may bend further still: of what is found on the way
    the least counts, so that no place profits from a linearisation that does
    not settle.
    """
    base = first.solution.objective + first.gain
    settled = first
    linear, present = found, first
    gains = []
    for _ in range(REFINEMENTS):
        try:
            linear, present = _relinearised(linear, present)
        except (SimulationError, np.linalg.LinAlgError):
            gains.append(first.gain)
            break
        gain = base - present.solution.objective
        if not np.isfinite(gain):
            gains.append(first.gain)
            break
        gains.append(max(gain, 0.0))
        settled = present
    return replace(settled, gain=min(gains))


def _relinearised(linear: Along, present: Evidence) -> tuple[Along, Evidence]:
    """One step of :func:`refined`."""
    nodes = smoothed_states(linear, present.noise, present.records)
    system = linear.system.moved(present.solution.correction[: len(linear.system.names)])
    again = system.linearise(nodes, linear.noise)
    index = again.where.index(present.place)
    return again, evidence(again, [index], correlation_time=float(present.noise.force_time[0]))[0]


def _next_level(table: dict[float, Restricted]) -> float | None:
    """Logarithm of the level to try next; None where the best one is settled.

    The vertex of the parabola through the best level and its neighbours, or
    further out where the best one has a neighbour on one side only.
    """
    known = sorted(table)
    index = known.index(_best(table))
    if index in (0, len(known) - 1):
        inward = known[1] if index == 0 else known[-2]
        flat = table[inward].objective - table[known[index]].objective < FLAT
        return None if flat else 2.0 * known[index] - inward
    low, centre, high = known[index - 1 : index + 2]
    left, right = centre - low, high - centre
    below = (table[low].objective - table[centre].objective) / left
    above = (table[high].objective - table[centre].objective) / right
    if not np.isfinite(below + above):
        trial = centre - 0.5 * left if np.isfinite(below) else centre + 0.5 * right
    else:
        trial = centre + 0.5 * (below * right - above * left) / max(below + above, 1e-12)
    return None if min(abs(trial - x) for x in known) < np.log(SETTLED) else float(trial)


def _best(table: dict[float, Restricted]) -> float:
    return min(table, key=lambda x: table[x].objective)


def _at_levels(
    grounds: Grounds,
    quiet: NoiseModel,
    records: Sequence[Sequence[Deviations]],
    levels: np.ndarray,
) -> list[list[Restricted]]:
    """Restricted likelihoods of every place at its levels, shape ``(n_places, n_levels)``."""
    models = [replace(quiet, force=np.array([level])) for level in levels.ravel()]
    lines = [part for part in records for _ in range(levels.shape[1])]
    found = restricted(grounds, models, lines)
    count = levels.shape[1]
    return [found[i * count : (i + 1) * count] for i in range(len(records))]


@dataclass(frozen=True, eq=False)
class Series:
    """Smoothed signals of one record.

    Attributes
    ----------
    times : ndarray (n_times,)
        In s.
    values, std : ndarray (n_times, n_signals)
        Expectation, and standard error with the uncertainty of parameters and
        initial states in it.
    """

    times: np.ndarray
    values: np.ndarray
    std: np.ndarray

    to_dict = as_dict("times", "values", "std")


@dataclass(frozen=True, eq=False)
class ResidualForces:
    """Smoother of one linearised model under one noise model.

    Attributes
    ----------
    grounds : Grounds
        Sensitivities and residuals.
    noise : NoiseModel
    lines : sequence of Deviations
        Driven by what is smoothed.
    smoothed : tuple of Smoothed
        Of all columns, per record.
    solution : Restricted
        Parameters and initial states that go with the residuals.
    """

    grounds: Grounds
    noise: NoiseModel
    lines: Sequence[Deviations]
    smoothed: tuple[Smoothed, ...]
    solution: Restricted

    @classmethod
    def of(cls, grounds: Grounds, noise: NoiseModel, lines: Sequence[Deviations]) -> ResidualForces:
        """Smooth residuals and sensitivities of all records."""
        smoothed = tuple(
            smooth(noise, line, column) for line, column in zip(lines, grounds.columns, strict=True)
        )
        return cls(grounds, noise, lines, smoothed, restricted(grounds, [noise], [lines])[0])

    def series(self, times: Sequence[np.ndarray]) -> tuple[Series, ...]:
        """What was smoothed, per record."""
        result = []
        for index, (t, part) in enumerate(zip(times, self.smoothed, strict=True)):
            where = self.grounds.unknowns(index)
            absorbed = part.forces[:, :, :-1]
            values = part.forces[:, :, -1] - absorbed @ self.solution.correction[where]
            covariance = self.solution.covariance[np.ix_(where, where)]
            spread = np.sum((absorbed @ covariance) * absorbed, axis=2)
            result.append(Series(t, values, np.sqrt(part.std**2 + np.maximum(spread, 0.0))))
        return tuple(result)

    def signature(self, changes: Sequence[np.ndarray]) -> tuple[np.ndarray, ...]:
        """What would be smoothed if the records differed from what they are.

        Parameters
        ----------
        changes : sequence of ndarray (n_times, n_outputs)
            What to add to the measurements, per record.

        Returns
        -------
        tuple of ndarray (n_times, n_forces)
        """
        columns = []
        for column, change in zip(self.grounds.columns, changes, strict=True):
            moved = column.copy()
            moved[:, :, -1] += change
            columns.append(moved)
        grounds = replace(self.grounds, columns=tuple(columns))
        step = restricted(grounds, [self.noise], [self.lines])[0].correction
        result = []
        for index, (line, column, part) in enumerate(
            zip(self.lines, columns, self.smoothed, strict=True)
        ):
            own = smooth(self.noise, line, column[:, :, -1:]).forces[:, :, 0]
            result.append(own - part.forces[:, :, :-1] @ step[self.grounds.unknowns(index)])
        return tuple(result)


def residual_forces(linear: Along) -> ResidualForces:
    """Smoother of all forces together."""
    return ResidualForces.of(linear.grounds, linear.noise, linear.joint)


def agreement(forces: Sequence[Series], signature: Sequence[np.ndarray]) -> float:
    """Correlation of residual forces and a signature, both in standard errors."""
    seen = np.concatenate([(s.values / s.std).ravel() for s in forces])
    expected = np.concatenate(
        [(part / s.std).ravel() for part, s in zip(signature, forces, strict=True)]
    )
    size = np.linalg.norm(seen) * np.linalg.norm(expected)
    return float(seen @ expected / size) if size > 0 else 0.0
