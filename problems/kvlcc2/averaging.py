r"""Predictions whose structure may be wrong: candidates averaged by how well they transfer.

Records often cannot tell structures apart that differ where a prediction is asked for, beyond
the records. No single test chooses well there, so three are multiplied. Let the records be sorted
by strength and a fit on those up to a rung be made for each rung. The *transfer score* of a
structure is

.. math:: S = s \cdot c \cdot \sqrt{d^2 + f^2}

with *s* the rms error, in units of the spread of each output, of predictions over segments of the
stronger records, begun at the first sample; *c* the geometric mean over the axes of the relative
error of forces at given motion that nothing was fitted to (1 where there are no such tests); and
*d* the rms relative change of the wanted quantities from rung to rung. Structures weigh
:math:`w_i \propto S_i^{-4}`, and

.. math::
    \bar q = \sum_i w_i q_i, \qquad
    \operatorname{var} q = \sum_i w_i (q_i - \bar q)^2 + \sum_i w_i v_i + (f \bar q)^2

where :math:`v_i` is the jackknife variance over the records and *f* what no record tells, 1.5 %
unless stated: the repeatability of such tests in one basin and between basins.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError, ModelError, OedSysidError, located
from oed_sysid.experiments.base import finite, positive
from oed_sysid.likelihood.captive import CaptiveTests
from oed_sysid.likelihood.estimator import Estimator
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.start_guess import first_state
from oed_sysid.physics.model import Model
from oed_sysid.prediction.jackknife import Purpose, leave_out
from oed_sysid.runtime.constants import RANK_TOLERANCE
from oed_sysid.runtime.display import (
    TWO_SIDED_95,
    Report,
    Section,
    Table,
    as_dict,
    as_text,
    rounded,
    share,
)

# Records whose strengths differ by less than this share are of one rung.
SAME_STRENGTH = 0.05
# Rungs of the ladder, the strongest records, which are only predicted, not counted.
MOST_RUNGS = 3
# Weights below this are not worth a jackknife.
LEAST_WEIGHT = 0.05


@dataclass(frozen=True, eq=False)
class Structure:
    """One candidate: a model and how it is fitted.

    Parameters
    ----------
    name : str
        For reports.
    model : Model
        Its values are the start values.
    estimator : Estimator
        Such as :class:`~oed_sysid.likelihood.multiple_shooting.MultipleShooting`; the weight of
        records against priors is one of its settings, so that it may be averaged over as well.
    tests : CaptiveTests, optional
        Forces at given motion that are fitted together with the records.
    """

    name: str
    model: Model
    estimator: Estimator
    tests: CaptiveTests | None = None

    def fit(self, dataset: Dataset) -> Fit:
        """Fit to records, and to the tests where it has some."""
        if self.tests is None:
            return self.estimator.fit(self.model, dataset)
        return self.tests.fit(self.estimator, self.model, dataset)  # type: ignore[arg-type]


@dataclass(frozen=True, eq=False)
class Transfer:
    """How one structure fares beyond what it was fitted to.

    Attributes
    ----------
    name : str
        Of the structure.
    step : float
        Error on stronger records, in units of the outputs' spread.
    forces : float
        Relative error of forces nobody fitted; 1 without such tests.
    drift : float
        Relative change of the wanted quantities from rung to rung.
    score : float
        Product of the three; infinite where a fit or a prediction failed.
    weight : float
        Share in the average.
    values : mapping of str to float
        The wanted quantities, from all records; empty where they could not be had.
    std : mapping of str to float
        Their jackknife standard deviations; empty where the weight is below five per cent.
    note : str
        What failed, in words; empty if nothing did.
    """

    name: str
    step: float
    forces: float
    drift: float
    score: float
    weight: float
    values: Mapping[str, float]
    std: Mapping[str, float]
    note: str = ""

    to_dict = as_dict("name", "weight", "step", "forces", "drift", "values", "note")


@dataclass(frozen=True, eq=False)
class StructureAverage:
    """Wanted quantities with an uncertainty that holds that of the structure.

    Attributes
    ----------
    values, std : mapping of str to float
        Average and standard deviation of each quantity.
    between, within : mapping of str to float
        The parts of the standard deviation that differ by structure, and by record.
    structures : tuple of Transfer
        The candidates, the heaviest first.
    rungs : tuple of tuple of str
        Records of each training rung.
    n_records : int
        Records in all.
    """

    values: Mapping[str, float]
    std: Mapping[str, float]
    between: Mapping[str, float] = field(repr=False)
    within: Mapping[str, float] = field(repr=False)
    structures: tuple[Transfer, ...] = field(repr=False)
    rungs: tuple[tuple[str, ...], ...] = field(repr=False)
    n_records: int = 0

    def interval(self, quantity: str, level: float = 0.95) -> tuple[float, float]:
        """Interval of one quantity, normal."""
        half = float(ndtri(0.5 + level / 2)) * self.std[quantity]
        return self.values[quantity] - half, self.values[quantity] + half

    def document(self) -> Report:
        """Return weights and quantities as tables."""
        sizes = ", ".join(str(len(rung)) for rung in self.rungs)
        title = (
            f"average of {len(self.structures)} structures; {self.n_records} records, "
            f"of which the weakest {sizes} predict the stronger"
        )
        weights = [
            (one.name, share(one.weight), f"{one.step:.3f}", f"{one.forces:.3f}",
             share(one.drift), one.note)
            for one in self.structures
        ]  # fmt: skip
        quantities = []
        for name, value in self.values.items():
            low, high = self.interval(name)
            half = 0.5 * (high - low)
            halves = (half, *(TWO_SIDED_95 * part[name] for part in (self.between, self.within)))
            shares = (share(one / abs(value)) if value else "-" for one in halves)
            ends = f"{rounded(low, half)} to {rounded(high, half)}"
            quantities.append((name, rounded(value, half), ends, *shares))
        first = ("structure", "weight", "step", "forces", "drift", "")
        second = ("quantity", "value", "95 % interval", "half width", "structure", "records")
        return Report(
            title,
            sections=(
                Section("Structures", tables=(Table(first, weights, words=(5,)),), indent=2),
                Section("Quantities", tables=(Table(second, quantities),), indent=2),
            ),
        )

    report = as_text

    to_dict = as_dict(
        "structures", "rungs",
        quantities=lambda self: {
            name: {
                "value": value,
                "std": self.std[name],
                "between": self.between[name],
                "within": self.within[name],
            }
            for name, value in self.values.items()
        },
    )  # fmt: skip


def peak_input(name: str) -> Callable[[Record], float]:
    """Strength of a record by the largest size of one of its inputs.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Input, Output
    >>> channels = Channels((Input("delta", "rad"),), (Output("r", "rad/s"),))
    >>> rudder = [[0.0], [-0.4], [-0.4], [0.1], [0.0]]
    >>> turn = Record("turn", np.arange(5.0), rudder, np.ones((5, 1)), channels)
    >>> peak_input("delta")(turn)
    0.4
    """
    return lambda record: float(np.abs(record.input(name)).max())


def ladder(
    dataset: Dataset, strength: Callable[[Record], float]
) -> tuple[tuple[tuple[str, ...], tuple[str, ...]], ...]:
    """Names of weaker records to fit and stronger ones to predict, for up to three rungs.

    Records within five per cent of each other's strength stay together, and a rung has two
    records at least: one alone seldom determines a model.

    Raises
    ------
    DataError
        If there are no two records that are weaker than another.
    """
    # Predicting stronger manoeuvres from weaker ones asks what a structure says beyond its data.
    ordered = sorted(dataset, key=strength)
    sizes = [strength(record) for record in ordered]
    edges = [
        i for i in range(2, len(sizes)) if sizes[i] > (1 + SAME_STRENGTH) * sizes[i - 1] + 1e-12
    ]
    if not edges:
        raise DataError(
            "No two records are weaker than the others (all are of one strength, or too few), so "
            "that none can be predicted from weaker ones. Add weaker or stronger manoeuvres, or "
            "choose another measure of strength."
        )
    names = [record.name for record in ordered]
    return tuple((tuple(names[:i]), tuple(names[i:])) for i in edges[-MOST_RUNGS:])


def average_structures(
    candidates: Sequence[Structure],
    dataset: Dataset,
    *,
    purpose: Purpose,
    strength: Callable[[Record], float],
    horizon: float,
    tests: CaptiveTests | None = None,
    scored: Sequence[str] = (),
    floor: float = 0.015,
) -> StructureAverage:
    """Average what several structures predict, by how well each transfers.

    Parameters
    ----------
    candidates : sequence of Structure
        Two or more.
    dataset : Dataset
        Records of several strengths.
    purpose : callable
        ``fit -> {name: number}``: what is wanted of the model, such as
        ``lambda fit: turning_circle(fit, ...).quantities()``. A model for one purpose is not the
        model for another, so this decides among structures too.
    strength : callable
        ``record -> number``, such as :func:`peak_input`.
    horizon : float
        Length of the segments in which stronger records are predicted, s.
    tests : CaptiveTests, optional
        Forces at given motion that no candidate was fitted to, compared test by test.
    scored : sequence of str
        Quantities whose stability counts; all by default. None may be about zero.
    floor : float
        Relative standard deviation that no record tells.

    Returns
    -------
    StructureAverage

    Raises
    ------
    ModelError
        If a candidate was fitted to some of ``tests``, none gives the quantities, they differ by
        structure or are about zero, or a setting is out of its range.
    DataError
        If all records are of one strength.

    Examples
    --------
    Drag of a body that slows down, linear or quadratic? Runs from 1 and 2 m/s say what 6 m/s does:

    >>> from oed_sysid import Force, MultipleShooting, Output, Parameter, State
    >>> def body(drag):
    ...     force = Force("drag", {"X": drag}, (Parameter("k", 2.0, "1"),))
    ...     return Model("body", (State("u", "m/s"),), (), (Output("u", "m/s", noise_std=0.01),),
    ...         axes={"X": "u"}, inertia={("X", "u"): "10"}, effects=(force,))
    >>> linear, quadratic = body("-k*u"), body("-k*u*abs(u)")
    >>> rng, times = np.random.default_rng(0), np.arange(0.0, 10.0, 0.2)
    >>> runs = [
    ...     Record(f"from {speed}", times, np.empty((50, 0)),
    ...         speed / (1 + 0.2 * speed * times[:, None]) + 0.01 * rng.standard_normal((50, 1)),
    ...         linear.channels)
    ...     for speed in (1.0, 1.5, 2.0)
    ... ]
    >>> shooting = MultipleShooting(disturbances="none")
    >>> average = average_structures(
    ...     [Structure("linear", linear, shooting), Structure("quadratic", quadratic, shooting)],
    ...     Dataset(tuple(runs)),
    ...     purpose=lambda fit: {"force at 6 m/s": fit.values["k"] * (
    ...         36.0 if "abs" in fit.model.effects[0].terms["X"] else 6.0)},
    ...     strength=lambda run: float(run.output("u")[0]), horizon=5.0,
    ... )
    >>> print(average.structures[0].name, round(average.values["force at 6 m/s"]))
    quadratic 72
    """
    if len(candidates) < 2:
        raise ModelError(f"{len(candidates)} structures are no average. Give two or more.")
    for one in candidates:
        if tests is not None and one.tests is not None and (seen := tests.shared(one.tests)):
            raise ModelError(
                f"Structure {one.name!r} was fitted to {seen} of the {tests.n_tests} tests that "
                "shall judge it. Judge with other tests, or fit without these."
            )
    rungs = ladder(dataset, strength)
    judge = _Judge(dataset, rungs, purpose, horizon, tests, tuple(scored), floor)
    found = [judge.transfer(one) for one in candidates]
    done = []
    for candidate, each, weight in zip(candidates, found, _weights(found), strict=True):
        std = {}
        if weight >= LEAST_WEIGHT:
            std = leave_out(candidate.fit, dataset, purpose).std_errors
        done.append(replace(each, weight=float(weight), std=std))
    return judge.averaged(done)


def _weights(found: Sequence[Transfer]) -> np.ndarray:
    """Share of each structure by its score; structures that give nothing, or others, are said."""
    scores = np.array([one.score for one in found])
    if not math.isfinite(best := min(scores)):
        raise ModelError(
            "No structure gives the wanted quantities: "
            + "; ".join(f"{one.name}: {one.note or 'not finite'}" for one in found)
        )
    usable = [one for one in found if one.values]
    for one in usable[1:]:
        if set(one.values) != set(usable[0].values):
            raise ModelError(
                f"The purpose gives {', '.join(usable[0].values)} with structure "
                f"{usable[0].name!r} and {', '.join(one.values)} with {one.name!r}. Return the "
                "same names for all."
            )
    # Nothing is better than no error at all.
    raw = (scores / best) ** -4 if best > 0 else (scores == 0).astype(float)
    return np.asarray(raw / raw.sum())


@dataclass(frozen=True, eq=False)
class _Judge:
    """What structures are judged by."""

    dataset: Dataset
    rungs: Sequence[tuple[tuple[str, ...], tuple[str, ...]]]
    purpose: Purpose
    horizon: float
    tests: CaptiveTests | None
    scored: tuple[str, ...]
    floor: float

    def __post_init__(self) -> None:
        owner = "The average of structures"
        positive(owner, "horizon", self.horizon, "Give seconds.")
        if finite(owner, "floor", self.floor) < 0:
            raise ModelError(f"floor is {self.floor}. Give a share, such as 0.015, or zero.")

    @cached_property
    def spread(self) -> np.ndarray:
        """Standard deviation of each output over all records, ``(n_outputs,)``."""
        spread = np.nanstd(np.vstack([record.outputs for record in self.dataset]), axis=0)
        return np.where(spread > 0, spread, np.inf)

    def chosen(self, names: Sequence[str]) -> Dataset:
        """Some of the records."""
        return Dataset(tuple(record for record in self.dataset if record.name in names))

    def wanted(self, fit: Fit) -> dict[str, float]:
        """The wanted quantities."""
        return {name: float(value) for name, value in self.purpose(fit).items()}

    def transfer(self, candidate: Structure) -> Transfer:
        """Score one structure; what fails makes its score infinite and is noted."""
        nothing = Transfer(candidate.name, math.inf, 1.0, math.inf, math.inf, 0.0, {}, {})
        early: list[dict[str, float]] = []
        try:
            whole = candidate.fit(self.dataset)
            values = self.wanted(whole)
            squares = np.zeros(2)
            for weaker, stronger in self.rungs:
                fit = candidate.fit(self.chosen(weaker))
                squares += self.step_error(fit.model, self.chosen(stronger))
                early.append(self.wanted(fit))
            forces = 1.0
            if self.tests is not None:
                errors = list(self.tests.relative_errors(whole.model).values())
                forces = float(np.exp(np.mean(np.log(errors))))
        except (OedSysidError, np.linalg.LinAlgError) as error:
            return replace(nothing, note=str(error).split(". ")[0])
        step = math.sqrt(squares[0] / max(squares[1], 1))
        moved = self.changes(candidate.name, values, early)
        drift = float(np.sqrt(np.mean(np.square(moved))))
        # A product: a structure has to do well in all three, in whatever units.
        score = step * forces * math.hypot(drift, self.floor)
        found = replace(nothing, step=step, forces=forces, drift=drift)
        if not all(map(math.isfinite, (score, *values.values()))):
            return replace(found, note="predictions are not finite")
        return replace(found, score=score, values=values)

    def step_error(self, model: Model, dataset: Dataset) -> tuple[float, int]:
        """Sum of squared errors over segments from their first samples, and how many there are.

        Nothing of the segments is estimated: unmeasured states begin at zero, parameters that
        differ by record at their mean.
        """
        held = model.fix(*model.free_names)
        compiled, values = kernel(held), held.value_vector
        total, count = 0.0, 0
        for part in (part for record in dataset for part in record.segments(self.horizon)):
            run = compiled.simulate(part.times, part.inputs, values, first_state(held, part))
            if not np.isfinite(run.outputs).all():
                return math.inf, 1
            seen = np.isfinite(part.outputs)
            errors = (run.outputs - part.outputs) / self.spread
            total += float(np.sum(np.square(errors[seen])))
            count += int(seen.sum())
        return total, count

    def changes(
        self, structure: str, values: Mapping[str, float], early: Sequence[Mapping[str, float]]
    ) -> list[float]:
        """Relative changes of the scored quantities from each rung to all records."""
        located(ModelError, "The purpose has no quantity", self.scored, values)
        if not values:
            raise ModelError("The purpose gives no quantity. Return at least one, by name.")
        moved = []
        for one in early:
            if set(one) != set(values):
                raise ModelError(
                    f"The purpose gives {', '.join(one) or 'nothing'} for a part of the records "
                    f"and {', '.join(values)} for all, with structure {structure!r}. Return the "
                    "same names."
                )
            for name in self.scored or values:
                if abs(values[name]) <= RANK_TOLERANCE * abs(one[name]) or values[name] == 0.0:
                    raise ModelError(
                        f"Quantity {name!r} is {values[name]:.3g} with structure {structure!r}: "
                        "a relative change of nothing says nothing. Name the others in scored, or "
                        "ask for a quantity that is not about zero."
                    )
                moved.append(one[name] / values[name] - 1.0)
        return moved

    def averaged(self, done: Sequence[Transfer]) -> StructureAverage:
        """Mean of the structures by their weights, and the three parts of its variance."""
        used = [one for one in done if one.weight > 0]
        # Those too light for a jackknife are taken to scatter as the others do.
        told = [one for one in used if one.std]
        share, known = (np.array([one.weight for one in some]) for some in (used, told))
        values, total, between, within = (dict[str, float]() for _ in range(4))
        for name in used[0].values:
            table = np.array([one.values[name] for one in used])
            part = np.array([one.std[name] for one in told])
            values[name] = float(share @ table)
            between[name] = float(np.sqrt(share @ (table - values[name]) ** 2))
            within[name] = float(np.sqrt(known @ part**2 / known.sum()))
            # Variances of structures, records, and what no record tells, as if independent.
            total[name] = math.hypot(between[name], within[name], self.floor * values[name])
        heaviest = tuple(sorted(done, key=lambda one: -one.weight))
        weaker = tuple(fitted for fitted, _ in self.rungs)
        n_records = len(self.dataset)
        return StructureAverage(values, total, between, within, heaviest, weaker, n_records)
