r"""Locate where a model fails: at which stage of the signal chain, in which equation, when.

At one place of the chain after the other a disturbance of first order is admitted: its level, its
time, the parameters and the start states are estimated together by the likelihood of
:mod:`oed_sysid.likelihood.filtered`, and its gain over white noise alone,

.. math:: 2 \Delta \ln L = -2 \ln L(0) + 2 \ln L(\hat\sigma, \hat\tau)

compared. What parameters and start states can explain accuses no place. A disturbance of a sensor
is autocorrelated noise of it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import pairwise

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.chance import threshold
from oed_sysid.evidence.misfit import in_words
from oed_sysid.evidence.rank import Ranking
from oed_sysid.evidence.residual_forces import ResidualForces, Series, let_in
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.traces import LEAST
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.disturbances import Place, places
from oed_sysid.likelihood.fit import MOST_DRAWN
from oed_sysid.likelihood.gauss_newton import FEW, NEAR, FilteredSolution, Iterate, solve_filtered
from oed_sysid.likelihood.noise_model import Levels, NoiseModel, correlation_times
from oed_sysid.likelihood.noise_parts import begun, likeliest_decade, solved
from oed_sysid.likelihood.score_test import LEAST_SEEN
from oed_sysid.runtime.constants import NEGLIGIBLE
from oed_sysid.runtime.display import Figure, Report, Section, Table, as_dict, as_text
from oed_sysid.text.units import shown_unit

# Statistic below which no place is accused: what chance rarely gives of fourteen places.
CLEAR = threshold(14, 1)

WORDS = {
    "actuator": "between the command and the actual {signal}",
    "flow": "in the flow past the hull, {signal}",
    "force": "in the forces of the {signal} equation",
    "kinematics": "in the kinematics of {signal}",
    "sensor": "in the measurement of {signal}",
}


@dataclass(frozen=True, eq=False)
class Located:
    """Where a model fails.

    Attributes
    ----------
    places : tuple of Place
        Largest gain first.
    gains : dict
        Likelihood-ratio statistic that a disturbance at each place brings over white
        noise alone, keys such as ``"force Z"``.
    levels : dict
        Most likely standard deviation of that disturbance, in its unit.
    force_names : tuple of str
        Equations, in the order of the columns of ``forces``.
    forces : tuple of Series
        Smoothed residual forces, all admitted together, per record.
    signatures : dict
        For every rival, the residual forces ``(n_times, n_forces)`` that would
        be seen if it were the truth and nothing were noisy, per record.
    by_motion : str
        Of independent tests, which no disturbance links, where the model fails as a function of
        motions and inputs, in words; empty for time series.

    Examples
    --------
    What :func:`~oed_sysid.evidence.locate` returns; see there.
    """

    places: tuple[Place, ...]
    gains: dict[str, float]
    levels: dict[str, float]
    force_names: tuple[str, ...]
    forces: tuple[Series, ...]
    signatures: dict[str, tuple[np.ndarray, ...]]
    by_motion: str = ""

    @classmethod
    def nothing(cls, fit: FilteredSolution) -> Located:
        """A finding without any gain, where locating was not possible."""
        where = places(fit.problem.model)
        zero = {place.name: 0.0 for place in where}
        return cls(where, zero, dict(zero), (), (), {})

    @property
    def top(self) -> float:
        """Largest gain; an identity of kinematics may have it and not be the best place."""
        return max(self.gains.values(), default=0.0)

    @property
    def equation(self) -> str:
        """Equation of the residual force with the largest gain; empty without any."""
        return max(self.force_names, key=lambda n: self.gains.get(f"force {n}", 0.0), default="")

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
        return tuple(n for n, gain in self.gains.items() if abs(top - gain) < GROUP_WIDTH)

    @property
    def verdict(self) -> str:
        """The finding in one or two sentences."""
        if self.by_motion:
            return self.by_motion
        if self.best is None:
            return SAYS["location"]["nowhere"]
        words = {p.name: WORDS[p.stage].format(signal=p.signal) for p in self.places}
        others = (words[name] for name in self.group if name != self.best)
        where = ", or as likely ".join((words[self.best], *others))
        later = next((name for name in self.gains if name not in self.group), self.best)
        behind = self.gains[self.best] - self.gains[later]
        more = say("location", "next", name=later, behind=behind) if behind > 0 else ""
        return say("location", "here", where=where, next=more)

    def document(self, train: Dataset | None = None) -> Report:
        """Return the finding; with the training records, residual forces against their signals."""
        headers = (
            "where the model fails", "likelihood-ratio statistic", "behind the best", "size",
            "unit",
        )  # fmt: skip
        rows = []
        for place in self.places[:MOST_DRAWN]:
            gain = self.gains[place.name]
            if gain > CLEAR:
                factor, unit = shown_unit(place.unit)
                size = f"{factor * self.levels[place.name]:.2g}"
                rows.append((place.name, f"{gain:,.0f}", f"{self.top - gain:,.0f}", size, unit))
        tables = [Table(headers, rows)] if rows else []
        words = [self.verdict]
        if self.best is not None:
            words.append(SAYS["location"]["residual"])
        title = "Where the nominal model fails"
        drawn = [] if self.by_motion else self._figures(train)
        part = Section(title, ["", *words] if rows else words, tables, drawn)
        return Report(title, sections=(part,))

    report = as_text

    def _figures(self, train: Dataset | None) -> list[Figure]:
        caption, size = (
            SAYS["captions"]["plot_located"],
            (7.6, 1.3 + 0.3 * min(len(self.gains), 14)),
        )
        drawings = [Figure("plot_located", self, SAYS["captions"]["plot_located"], size=size)]
        if self.best is not None and train is not None and self.force_names:
            caption = say("captions", "figure_force", equation=self.equation)
            drawings.append(Figure("figure_force", self, caption, (self.equation, train)))
        return drawings

    to_dict = as_dict(
        "best", "group", "verdict", "gains", "levels", "signatures",
        units=lambda self: {place.name: place.unit for place in self.places},
        forces=lambda self: {"names": self.force_names, "records": self.forces},
    )  # fmt: skip


def locate(
    fit: FilteredSolution,
    unit: NoiseModel,
    rivals: Mapping[str, FilteredSolution] | None = None,
    moved: FilteredSolution | None = None,
) -> Located:
    """Locate where a model fails.

    At one place of the chain after the other (every actuator, flow, equation, kinematic relation
    and sensor) a disturbance is admitted, estimated with everything else, and its gain over white
    noise alone compared.

    Parameters
    ----------
    fit : FilteredSolution
        The present model, with estimated noise levels.
    unit : NoiseModel
        Natural size of every level.
    rivals : mapping of str to FilteredSolution, optional
        Fits of models that may be right, as a ranking's refits hold them;
        their signatures are put beside the residual forces.
    moved : FilteredSolution, optional
        The present model with disturbance forces, which shows residual forces, where ``fit`` has
        none; by default ``fit``.
    """
    moved = moved or fit
    if fit.problem.dataset.only_tests:
        return replace(Located.nothing(fit), by_motion=in_words(fit))
    found = evidence(fit, unit)
    if found is None:
        return Located.nothing(fit)
    found.sort(key=lambda part: part.order)
    # Forces in all equations at once, whichever place is best: what they look like is a finding.
    smoother = ResidualForces(*let_in(moved, unit))
    placed = (place.partition(" ") for place in moved.noise.places)
    columns = {i: signal for i, (stage, _, signal) in enumerate(placed) if stage == "force"}
    forces = tuple(series.only([*columns]) for series in smoother.series())
    return Located(
        places=tuple(part.place for part in found),
        gains={part.place.name: part.gain for part in found},
        levels={part.place.name: part.level for part in found},
        force_names=tuple(columns.values()),
        forces=forces,
        signatures=_signatures(smoother, rivals or {}, [*columns]),
    )


def _signatures(
    smoother: ResidualForces, rivals: Mapping[str, FilteredSolution], chosen: Sequence[int]
) -> dict[str, tuple[np.ndarray, ...]]:
    """Residual forces that would be seen if a rival were the truth, of those that can be run.

    Nothing is noisy there, but what was not measured is not known.
    """
    found = {}
    for name, rival in rivals.items():
        records = rival.problem.records
        runs = [rival.problem.alone(rival.point.unknowns, i)[0] for i in range(len(records))]
        if all(np.isfinite(run).any() for run in runs):
            pairs = zip(runs, records, strict=True)
            seen = [np.where(np.isfinite(record.outputs), run, np.nan) for run, record in pairs]
            found[name] = tuple(part[:, chosen] for part in smoother.signature(seen))
    return found


def likeliest(ranking: Ranking) -> dict[str, FilteredSolution]:
    """Fits with the best candidate and with each that is not told from it, for their signatures."""
    return {refit.name: refit.fit for refit in ranking.group()}


@dataclass(frozen=True, eq=False)
class Evidence:
    """One place with its most likely disturbance.

    Attributes
    ----------
    place : Place
    quiet : FilteredSolution
        The fit to white noise alone.
    fit : FilteredSolution
        With that disturbance and white noise.
    """

    place: Place
    quiet: FilteredSolution
    fit: FilteredSolution

    @property
    def gain(self) -> float:
        """Gain in twice the log-likelihood over white noise alone."""
        return max(self.quiet.objective - self.fit.objective, 0.0)

    @property
    def order(self) -> tuple[int, bool]:
        """Key to sort by: the largest gain first; of places that are one, the equation.

        A geometric identity is exact, mostly stands for two sensors that disagree, and has to be
        ahead by more than what is immaterial.
        """
        exact = self.place.stage == "kinematics"
        return -round(self.gain * (1.0 - NEGLIGIBLE * exact)), self.place.stage != "force"

    @property
    def reach(self) -> float:
        """What the gain may become if the steps go on, as the last equations promise."""
        return self.gain + 2.0 * self.fit.promise * (self.fit.reason == "iterations")

    @property
    def level(self) -> float:
        """Standard deviation of the disturbance, in the place's unit."""
        if not self.gain:
            return 0.0
        noise = self.fit.noise
        return float(noise.colour.max() if self.place.stage == "sensor" else noise.force[0])


def evidence(fit: FilteredSolution, unit: NoiseModel) -> list[Evidence] | None:
    """Evidence for every place of the chain, largest first; None where nothing can be told.

    Where the model diverges along a record on its own (missing damping, an unstable vehicle),
    records are cut, each piece with start states of its own.
    """
    shortest = min(record.n_samples for record in fit.problem.records)
    pieces = 1
    while pieces == 1 or shortest >= LEAST * pieces:
        bench = _Bench(fit, unit, pieces)
        if bench.quiet.finite is not None:
            return bench.judged(places(fit.problem.model))
        pieces *= 2
    return None


class _Bench:
    """What every place is judged by, with records in some pieces.

    Attributes
    ----------
    quiet : FilteredSolution
        The fit to white noise alone; not finite where the model diverges along a record.
    starts : list of ndarray (n_unknowns,)
        Unknowns but the levels: of the fit with disturbance forces, whose parameters have bent less
        to what is missing, and of that to white noise alone.
    unknown : ndarray of bool (n_outputs,)
        Sensors whose noise nobody declared: it must not make every misfit evidence.
    """

    def __init__(self, fit: FilteredSolution, unit: NoiseModel, pieces: int) -> None:
        model = fit.model
        dataset, initial, local = _cut(fit, pieces)
        white = np.maximum(fit.noise.white, LEAST_SEEN * unit.white)
        self.unknown = np.array([output.noise_std is None for output in model.outputs])
        noise = NoiseModel.white_only(white, model.output_names)
        levels = Levels.of(noise, noise, white=self.unknown)
        problem = fit.problem.posed(levels, model=model, dataset=dataset)
        point = problem.point(initial, local)
        self.quiet = solve_filtered(problem, point, polish=0)
        ends = (point.unknowns, self.quiet.point.unknowns)
        self.starts = [unknowns[: problem.layout.levels.start] for unknowns in ends]

    def judged(self, where: Sequence[Place]) -> list[Evidence]:
        """The most likely disturbance of every place, the likeliest first.

        All take a few steps; of those whose gain is no chance, the likeliest and those that their
        equations promise to bring near it go on to the end.
        """
        looked = ((one, solved(self._begun(one), FEW, tolerance=NEAR)) for one in where)
        found = [Evidence(place, self.quiet, fit.finite or self.quiet) for place, fit in looked]
        found.sort(key=lambda part: -part.reach)
        least = CLEAR
        for index, part in enumerate(found):
            if part.fit.reason == "iterations" and part.reach > least:
                here = part.fit.problem, part.fit.point
                end = solve_filtered(*here, tolerance=NEAR, polish=0, begin=part.fit.now)
                found[index] = replace(part, fit=end.finite or part.fit)
            least = max(least, found[index].gain - GROUP_WIDTH)
        return sorted(found, key=lambda part: -part.gain)

    def _begun(self, place: Place) -> Iterate:
        """The likeliest level at values of the fit with disturbance forces, or of the quiet one.

        The latter is asked where the former explains less than white noise alone does.
        """
        best = self._likeliest(place, self.starts[0])
        if best.cost < self.quiet.cost:
            return best
        return min(best, self._likeliest(place, self.starts[1]), key=lambda one: one.cost)

    def _likeliest(self, place: Place, others: np.ndarray) -> Iterate:
        """The likeliest of some decades of a level, about what its score at zero says."""
        first = self.quiet.problem.posed(self._levels(place, 1.0))
        nothing = first.beside(others).unknowns
        nothing[len(others)] = 0.0
        parts = [part for part in first.passes(nothing, levels_only=True) if part.ok]
        matrix, right = first.gathered(nothing, parts)
        told, score = float(matrix[len(others), len(others)]), float(right[len(others)])
        # The standard error of a variance is told^-1/2: the records tell of no less.
        least = told**-0.25 if told > 0 else 1.0
        size = max(least, np.sqrt(max(score, 0.0) / told)) if told > 0 else 1.0

        @cache
        def at(decade: int) -> Iterate:
            level = max(size * 10.0**decade, least)
            problem = self.quiet.problem.posed(self._levels(place, level))
            return begun(problem, problem.beside(others).unknowns)

        return at(likeliest_decade(lambda decade: 2.0 * at(decade).cost))

    def _levels(self, place: Place, size: float) -> Levels:
        """The level and time of one place unknown, and what nobody declared of the sensors."""
        noise = self.quiet.noise
        colour = np.array([place.name == f"sensor {name}" for name in noise.outputs])
        between = correlation_times(self.quiet.problem.dataset)
        time = float(np.sqrt(np.prod(between)))
        begin = replace(noise, colour=np.where(colour, size, 0.0), colour_time=time)
        begin = begin.with_places([] if any(colour) else [place.name], time, size)
        return Levels.of(
            begin,
            replace(begin, colour=np.full(len(colour), size)),
            white=self.unknown,
            colour=colour,
            force=True,
            times=between,
        )


def _cut(
    fit: FilteredSolution, pieces: int
) -> tuple[Dataset | None, list[np.ndarray], list[dict[str, float]]]:
    """Records of a fit in some pieces, None as they are, with start states on the filtered path."""
    problem = fit.problem
    if pieces == 1:
        return None, fit.initial, fit.local
    passes = problem.passes(fit.point.unknowns, columns=False)
    records, initial, local = [], [], []
    for record, part, own in zip(problem.records, passes, fit.local, strict=True):
        edges = np.linspace(0, record.n_samples, pieces + 1).astype(int)
        for number, (first, stop) in enumerate(pairwise(edges), start=1):
            cut = record.window(record.times[first], record.times[stop - 1])
            records.append(cut.rename(f"{record.name}, part {number}"))
            # On the filtered path, which stays with the record where the model alone would leave
            # it.
            initial.append(part.path[first, : len(problem.model.states)])
            local.append(own)
    return Dataset(tuple(records)), initial, local
