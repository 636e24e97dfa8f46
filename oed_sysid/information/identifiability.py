"""Which parameters can be told apart: collinearity and the best subset.

Structural identifiability: what no manoeuvre and no accuracy could separate.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import combinations
from math import sqrt

import numpy as np

from oed_sysid.errors import DesignError, SimulationError, listed, located
from oed_sysid.information.bound import RunInformation
from oed_sysid.information.response import SAYS, CommandedRun, respond
from oed_sysid.likelihood.fit import ALIKE
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Report, Section, Table, as_dict, as_text, share
from oed_sysid.text import notation


def collinearity_index(information: Information, names: Sequence[str] | None = None) -> float:
    r"""Collinearity index of a set of parameters.

    .. math:: \gamma_K = 1 / \sqrt{\lambda_{\min}(\tilde S_K' \tilde S_K)}

    with the columns of :math:`\tilde S_K` normalised. A change of the outputs
    by one parameter can be undone by the others down to :math:`1/\gamma` of
    it. One is orthogonal, beyond 10 to 15 the set cannot be estimated
    together, infinity is an exact dependence. Parameters outside the set
    count as fixed, start states as unknown if they were in ``information``.

    Parameters
    ----------
    information : Information
        From :func:`~oed_sysid.information.bound.information_of`, without priors.
    names : sequence of str, optional
        The set; all by default.

    Returns
    -------
    float
        1 where the sensitivities are orthogonal, infinite where they are dependent.

    References
    ----------
    R. Brun, P. Reichert, H. R. Kuensch, Practical identifiability analysis of
    large environmental simulation models, *Water Resources Research* 37 (2001)
    1015-1030, equation 9.

    Examples
    --------
    >>> rows = np.array([[1.0, 0.9], [0.0, np.sqrt(0.19)]])
    >>> float(round(collinearity_index(Information.from_jacobian(("a", "b"), rows)), 3))
    3.162
    """
    known = information.names
    chosen = located(DesignError, "Information has no", names or known, known)
    columns = information.factor[:, chosen]
    norms = np.linalg.norm(columns, axis=0)
    if not np.all(norms > 0) or columns.shape[0] < columns.shape[1]:
        return float(np.inf)
    smallest = np.linalg.svd(columns / norms, compute_uv=False)[-1]
    return float(1.0 / smallest) if smallest > 1e-14 else float(np.inf)


# Up to here all sets are looked at that could be larger than the best one found: 2^17 at most.
ENUMERATED = 17
# A parameter of which nothing is known has a value that is wrong by this share.
ASSUMED = 0.3


@dataclass(frozen=True)
class Place:
    """One parameter beside the set that is estimated: what freeing and what fixing it costs.

    Attributes
    ----------
    name : str
    free : bool
        Whether it is of the set.
    error : float
        Relative standard error if it is estimated with the set, parameters outside it fixed.
    assumed : float
        Relative error of the value at which it would be fixed: its prior, else 30 %.
    bias : float
        Largest relative change of another parameter of the set if it is fixed so wrong.
    biased : str
        Which parameter that is.
    imitated : float
        Share of its effect on the outputs that the others of the set reproduce, 0 to 1.
    partners : tuple of (str, float)
        What 10 % more of it looks like: relative changes of those of the others that do most.
    """

    name: str
    free: bool
    error: float
    assumed: float
    bias: float
    biased: str
    imitated: float
    partners: tuple[tuple[str, float], ...]

    @property
    def advice(self) -> str:
        """``estimate``, ``prior`` (free beside its prior: the data know more), or ``fix``."""
        if self.free:
            return "estimate"
        return "prior" if self.error < self.assumed else "fix"

    to_dict = as_dict(
        *("name", "advice", "free", "error", "assumed", "bias", "biased", "imitated", "partners")
    )


@dataclass(frozen=True, eq=False)
class Subset:
    """The largest set of parameters that data determine together, and what each one costs.

    Attributes
    ----------
    places : tuple of Place
        All parameters: those of the set, then those to fix, each with the smallest error first.
    collinearity : float
        Index of the set.
    limit : float
        The collinearity that was allowed.
    reasons : tuple of str
        For every parameter to fix, which others imitate it, and what kind of run would tell.

    Examples
    --------
    What :func:`identifiable_subset` returns; see there.
    """

    places: tuple[Place, ...]
    collinearity: float
    limit: float
    reasons: tuple[str, ...] = ()

    @property
    def order(self) -> tuple[str, ...]:
        """All parameters, those of the set first."""
        return tuple(place.name for place in self.places)

    @property
    def size(self) -> int:
        """How many can be estimated together."""
        return sum(place.free for place in self.places)

    @property
    def names(self) -> tuple[str, ...]:
        """The best identifiable subset."""
        return self.order[: self.size]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Parameters outside it: to be kept near their priors, or fixed."""
        return self.order[self.size :]

    def advised(self, advice: str) -> tuple[str, ...]:
        """Names of the parameters with an advice of :attr:`Place.advice`."""
        return tuple(place.name for place in self.places if place.advice == advice)

    def words(self, source: str = "") -> str:
        """How many parameters can be estimated, and what to do with the others."""
        text = f"{self.size} of {len(self.order)} parameters can be estimated together{source}"
        if near := self.advised("prior"):
            text += f"; only with a prior (prior_std) {', '.join(near)}"
        if fixed := self.advised("fix"):
            text += f"; fix {', '.join(fixed)}"
        return f"{text}."

    def document(self) -> Report:
        """Return the subset in words and as a table."""
        words = {"estimate": "estimate", "prior": "with a prior", "fix": "fix"}
        rows = [
            (
                place.name,
                words[place.advice],
                share(place.error) if np.isfinite(place.error) else "none",
                share(place.assumed),
                f"{share(place.bias)} of {place.biased}" if place.bias > 0 else "none",
                share(1.0 - place.imitated) if place.imitated > 0 else "all",
            )
            for place in self.places
        ]
        headers = (
            "parameter", "", "rel. error if free", "if fixed wrong by", "largest bias",
            "effect of its own",
        )  # fmt: skip
        fixed = listed(self.advised("fix"))
        title = SAYS["together"].format(self, n=len(self.order), fixed=fixed)
        sections = [Section(title, (), (Table(headers, rows, words=(0, 1, 4)),), heading=True)]
        if self.reasons:
            sections.append(Section("What these runs cannot separate", list(self.reasons)))
        return Report("", answer=self.words(), sections=tuple(sections))

    report = as_text

    to_dict = as_dict(
        "order", "collinearity", "limit", "reasons", identifiable="names", parameters="places"
    )


def identifiable_subset(
    information: Information,
    values: Mapping[str, float],
    *,
    limit: float = 15.0,
    largest_error: float | None = None,
    assumed: Mapping[str, float] | None = None,
    motions: Mapping[str, np.ndarray] | None = None,
) -> Subset:
    r"""Find the largest set of parameters that data determine together.

    With :math:`S` the whitened sensitivities relative to the values, a set :math:`K` can be
    estimated, all others fixed, if :math:`\gamma_K` (:func:`collinearity_index`) and the errors

    .. math:: \sigma_i = \sqrt{[(S_K' S_K)^{-1}]_{ii}}

    are within their limits. Both grow with every parameter that joins, so that parts of a set that
    can be estimated can be estimated too. Of the largest sets the one with the smallest index is
    taken. It is searched by exchange: parameters join one by one, and swap places with those
    outside as long as the index falls or another one can join; up to 17 parameters, all larger
    sets are then tried. If :math:`j` is fixed at a value that is wrong by :math:`\delta_j`, the
    estimates of the others move by

    .. math:: b = (S_E' S_E)^{-1} S_E' S_j\, \delta_j, \qquad E = K \setminus j .

    Parameters
    ----------
    information : Information
        Of all candidates, without priors.
    values : mapping of str to float
        Values, which make sensitivities relative; a zero counts as its scale.
    limit : float
        Largest collinearity index; Brun et al. call subsets between 10 and 15 critical.
    largest_error : float
        Largest relative standard error that any of them may have; by default what is assumed of
        each: data that know less than that do not determine it.
    assumed : mapping of str to float, optional
        How wrong each would be if it were fixed, in its unit; 30 % of the value by default.
    motions : mapping of str to numpy.ndarray, optional
        States and inputs in the runs ``(n_times,)``, to say which of them keep one ratio.

    Returns
    -------
    Subset
        The set, what each parameter costs, and why the others are left out.

    References
    ----------
    R. Brun, P. Reichert, H. R. Kuensch (2001), as above: sets by collinearity.
    A. J. Miller, *Subset Selection in Regression*, 2nd ed. (2002), section 3.8: exchange.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> from oed_sysid.information import information_of
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> run = next(iter(ship.experiments.values()))
    >>> values = {p.name: p.value for p in ship.model.parameters}
    >>> found = identifiable_subset(information_of(ship.model, run), values)
    >>> found.limit
    15.0
    """
    names = information.names
    sizes = np.array([abs(values.get(n, 0.0)) for n in names])
    # A relative error of a value of zero means nothing: its scale stands for it.
    sizes = np.where(sizes > 0, sizes, information.scales)
    # R of a QR factorization serves as S: norms and angles of its columns are those of S.
    relative = information.factor / information.scales * sizes
    norms = np.linalg.norm(relative, axis=0)
    wrong = np.array([(assumed or {}).get(name, np.nan) for name in names]) / sizes
    wrong = np.where(np.isfinite(wrong), wrong, ASSUMED)
    errors = wrong if largest_error is None else np.full(len(names), largest_error)
    chosen = _Search(relative / np.where(norms > 0, norms, 1.0), norms, limit, errors).best()
    places = [_place(relative, names, chosen, index, wrong[index]) for index in range(len(names))]
    places.sort(key=lambda place: (not place.free, place.error))
    left_out = (place for place in places if not place.free and place.partners)
    reasons = [_reason(place, motions or {}) for place in left_out]
    index = collinearity_index(information, [names[i] for i in chosen]) if chosen else 0.0
    return Subset(tuple(places), index, limit, tuple(reasons))


class _Search:
    """Sets of columns whose smallest singular value stays above a bound."""

    def __init__(
        self, unit: np.ndarray, norms: np.ndarray, limit: float, errors: np.ndarray
    ) -> None:
        self.gram = unit.T @ unit
        self.norms = norms
        # gamma = 1 / sqrt(smallest eigenvalue of the Gram matrix of unit columns), so that a limit
        # on gamma is a floor under that eigenvalue.
        self.least = limit**-2.0
        self.errors = errors
        self.candidates = [i for i in range(len(norms)) if norms[i] > 0 and self._of([[i]])[0] > 0]

    def _smallest(self, sets: Sequence[Sequence[int]]) -> np.ndarray:
        """Smallest eigenvalue of every set of one size."""
        index = np.asarray(sets, dtype=int)
        return np.linalg.eigvalsh(self.gram[index[:, :, None], index[:, None, :]])[:, 0]

    def _of(self, sets: Sequence[Sequence[int]]) -> np.ndarray:
        """Smallest eigenvalue of every set of one size, 0 where it may not be estimated."""
        smallest = self._smallest(sets)
        # A share of rounding, so that a set at the limit does not come and go.
        fine = smallest >= self.least * (1.0 - 1e-9)
        if fine.any():
            index = np.asarray(sets, dtype=int)[fine]
            inverse = np.linalg.inv(self.gram[index[:, :, None], index[:, None, :]])
            # Of relative values: unit columns carry no size, the norms bring it back.
            variances = np.diagonal(inverse, axis1=1, axis2=2) / self.norms[index] ** 2
            fine[fine] = np.all(variances <= self.errors[index] ** 2, axis=1)
        return np.where(fine, smallest, 0.0)

    def best(self) -> list[int]:
        """The largest set, and of these the one whose columns are least alike."""
        # The better end of two exchanges: from nothing, and from all but those most alike.
        found = max(self._improved([]), self._improved(self._reduced()), key=self._worth)
        if len(self.candidates) > ENUMERATED:
            return found
        # From the largest size down, so that the first size with a set is the answer.
        for size in range(len(self.candidates), max(len(found), 1) - 1, -1):
            sets = list(combinations(self.candidates, size))
            values = self._of(sets)
            if values.max(initial=0.0) > 0:
                return list(sets[int(np.argmax(values))])
        return found

    def _worth(self, kept: Sequence[int]) -> tuple[int, float]:
        return len(kept), float(self._of([kept])[0]) if kept else 0.0

    def _reduced(self) -> list[int]:
        """Leave out one by one what makes the rest least alike, until the rest may be estimated."""
        kept = list(self.candidates)
        while kept and self._of([kept])[0] == 0.0:
            without = [[j for j in kept if j != k] for k in kept]
            kept = without[int(np.argmax(self._smallest(without)))] if without[0] else []
        return kept

    def _improved(self, kept: list[int]) -> list[int]:
        """Take the best of the first kind of move that improves the set, while there is one."""
        while True:
            for sets, threshold in self._moves(kept):
                values = self._of(sets) if sets else np.zeros(1)
                if values.max() > threshold:
                    kept = sets[int(np.argmax(values))]
                    break
            else:
                return kept

    def _moves(self, kept: list[int]) -> Iterator[tuple[list[list[int]], float]]:
        """Add one; put two for one; put one for one, which has to make the columns less alike."""
        outside = sorted({*self.candidates} - {*kept})
        rests = [[j for j in kept if j != k] for k in kept]
        yield [[*kept, i] for i in outside], 0.0
        yield [[*rest, i, j] for rest in rests for i, j in combinations(outside, 2)], 0.0
        least = self._worth(kept)[1] * (1.0 + 1e-9)
        yield [[*rest, i] for rest in rests for i in outside], least


def _place(
    relative: np.ndarray, names: Sequence[str], chosen: Sequence[int], index: int, wrong: float
) -> Place:
    """What one parameter costs, free and fixed."""
    others = [i for i in chosen if i != index]
    own = relative[:, index]
    # With this parameter last, its standard error is that beside the set, everything else fixed.
    order = [*others, index]
    bound = Information.from_jacobian([names[i] for i in order], relative[:, order])
    # b of the docstring for a unit error: what the others do to imitate this parameter.
    change = np.linalg.lstsq(relative[:, others], own, rcond=None)[0] if others else np.zeros(0)
    rest = own - relative[:, others] @ change
    size = float(own @ own)
    imitated = 1.0 - float(rest @ rest) / size if size > 0 else 0.0
    # In the metric of the data, whoever moves the outputs most does most of the imitation.
    effect = np.abs(change) * np.linalg.norm(relative[:, others], axis=0)
    most = [int(i) for i in np.argsort(-effect)[:3] if effect[i] > 0.2 * effect.max()]
    moved = zip(np.abs(change).tolist(), (names[i] for i in others), strict=True)
    bias, biased = max(moved, default=(0.0, ""))
    return Place(
        names[index],
        index in chosen,
        float(bound.std_errors[-1]),
        float(wrong),
        float(bias * wrong),
        biased,
        float(imitated),
        tuple((names[others[i]], float(0.1 * change[i])) for i in most),
    )


def _reason(place: Place, motions: Mapping[str, np.ndarray]) -> str:
    """Which parameters share a direction, and why, as a naval architect says it."""
    # Its error if all others were known: what they imitate is taken out.
    error = share(place.error)
    if place.error * sqrt(max(1.0 - place.imitated, 0.0)) > place.assumed:
        return str(SAYS["hardly_depend"].format(place, error=error, assumed=share(place.assumed)))
    partners = ", ".join(name for name, _ in place.partners)
    looks = " and ".join(f"{name} {change:+.1%}" for name, change in place.partners)
    facts = {"partners": partners, "looks": looks, "own_effect": 100 * (1 - place.imitated)}
    text: str = SAYS["hardly_separate"].format(place, **facts)
    if place.advice == "prior":
        text += SAYS["with_prior"].format(place, bias=share(place.bias), error=error)
    for partner, _ in place.partners:
        one, other = _symbols(place.name), _symbols(partner)
        own, its = sorted(set(one) - set(other)), sorted(set(other) - set(one))
        cosine = _cosine(one, other, motions)
        if len(own) != 1 or len(its) != 1 or not abs(cosine) > ALIKE:
            continue
        run = SAYS["runs"].get("".join(sorted(own + its)), "a run that moves them apart")
        said: str = SAYS["one_ratio"].format(own=own[0], its=its[0], cosine=cosine, run=run)
        return text + said
    return text


def _symbols(name: str) -> tuple[str, ...]:
    """Motions that a derivative multiplies, none if the name is no derivative's."""
    name = name.removesuffix("_prime")
    if not notation.is_derivative(name):
        return ()
    found = notation.parse(name)
    return () if found.is_dot else tuple(factor.symbol for factor in found.factors)


def _cosine(one: Sequence[str], other: Sequence[str], motions: Mapping[str, np.ndarray]) -> float:
    """Cosine between two products of motions; zero where one is not known or does not move."""
    if not one or not other or any(symbol not in motions for symbol in (*one, *other)):
        return 0.0
    first, second = (np.prod([motions[s] for s in product], axis=0) for product in (one, other))
    size = float(np.linalg.norm(first) * np.linalg.norm(second))
    return float(first @ second) / size if size else 0.0


@dataclass(frozen=True)
class Structure:
    """Rank of the sensitivities over random values and inputs.

    Attributes
    ----------
    names : tuple of str
        Parameters that were looked at.
    rank : int
        Largest rank met; below ``len(names)`` no data can determine all.
    ranks : tuple of int
        Rank at each random set of values.
    directions : tuple of str
        Combinations that stay free, in words, at the values with most rank.
    margin : float
        Smallest scaled singular value that counts, as a share of the largest;
        far above 1e-7 means that the verdict is clear.
    n_runs : int
        Random runs for each set of values.

    Examples
    --------
    What :func:`structural_identifiability` returns; see there.
    """

    names: tuple[str, ...]
    rank: int
    ranks: tuple[int, ...]
    directions: tuple[str, ...]
    margin: float
    n_runs: int

    @property
    def identifiable(self) -> bool:
        """Whether all parameters can be determined by some manoeuvre."""
        return self.rank == len(self.names)

    def document(self) -> Report:
        """Return the verdict in words."""
        head = SAYS["structure"].format(self, n=len(self.names), sets=len(self.ranks))
        words = "All parameters are locally identifiable from these outputs."
        section = Section("Verdict", (words,))
        if not self.identifiable:
            section = Section("No manoeuvre separates:", self.directions, heading=True, indent=2)
            words = f"{section.title} {'; '.join(self.directions)}"
        return Report(head, answer=words, sections=(section,))

    report = as_text

    to_dict = as_dict("names", "rank", "ranks", "identifiable", "directions", "margin")


def structural_identifiability(
    model: Model,
    *,
    inputs: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
    duration: float = 60.0,
    sample_time: float = 0.5,
    initial: Mapping[str, float] | None = None,
    spread: float = 0.3,
    n_points: int = 5,
    n_runs: int = 3,
    start: str = "unknown",
) -> Structure:
    """Check by rank whether the free parameters can be determined at all.

    At each of several random sets of values the sensitivities of several runs
    with random step inputs are put under each other, start states eliminated
    unless known. What stays without rank everywhere is a property of the
    equations and outputs, not of the manoeuvre.

    Parameters
    ----------
    model : Model
        The model; its outputs are what is measured.
    inputs : mapping of str to (lower, upper)
        Range in which every input is drawn.
    rng : numpy.random.Generator
        Source of values and inputs.
    duration, sample_time : float
        Length and sampling of the runs, s.
    initial : mapping of str to float, optional
        Start of the runs; states are scattered around it by a tenth of their
        scale, as a vehicle at rest shows less than one in motion.
    spread : float
        Relative half-width of the random values.
    n_points, n_runs : int
        Number of value sets, and of runs at each.
    start : {"unknown", "known"}
        Whether start states have to be estimated too.

    Returns
    -------
    Structure
        The rank, and the combinations that stay free.

    Raises
    ------
    DesignError
        If an input has no range, or no run stays finite.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading").model
    >>> found = structural_identifiability(ship, inputs={"delta": (-0.3, 0.3)},
    ...                                    rng=np.random.default_rng(0), n_points=2, n_runs=1)
    >>> found.rank, len(found.names)
    (2, 2)
    """
    if missing := [name for name in model.input_names if name not in inputs]:
        raise DesignError(f"The input {missing[0]!r} has no range. Give inputs={{...}} for all.")
    times = np.arange(0.0, duration + 0.5 * sample_time, sample_time)

    def random_run() -> CommandedRun:
        """Random steps of all inputs, from near the start."""
        commands = np.empty((len(times), len(model.inputs)))
        for column, name in enumerate(model.input_names):
            # Steps of random length hold both fast and slow motion.
            hold = max(1, int(rng.uniform(0.02, 0.15) * len(times)))
            levels = rng.uniform(*inputs[name], size=len(times) // hold + 1)
            commands[:, column] = np.repeat(levels, hold)[: len(times)]
        own = np.array([(initial or {}).get(state.name, 0.0) for state in model.states])
        own = own + 0.1 * rng.standard_normal(len(own)) * [state.scale for state in model.states]
        present = np.ones((len(times), len(model.outputs)), dtype=bool)
        return CommandedRun("random steps", times, commands, own, present)

    def at_random_values() -> Information | None:
        """Information of random runs at random values; None where none stays finite."""
        values = {}
        for one in model.free_parameters:
            centre = one.value or one.magnitude * rng.choice([-1.0, 1.0])
            values[one.name] = centre * (1 + spread * rng.uniform(-1, 1))
        drawn, factors = model.within_bounds(values), []
        for _ in range(n_runs):
            given = random_run()
            with suppress(SimulationError):
                spans = np.ptp(respond(drawn, given).outputs, axis=0)
                # Noise in proportion to what each output does: rank must not depend on units.
                told = RunInformation(drawn, np.where(spans > 0, spans, 1.0), start)
                factors.append(told.factor(given))
        return told.joint(factors, None) if factors else None

    if not (found := [*filter(None, (at_random_values() for _ in range(n_points)))]):
        raise DesignError(SAYS["none_finite"].format(model=model))
    # Rank may drop at special values; the largest one met is that of almost all values.
    best = max(found, key=lambda information: information.rank)
    _, values, _, _ = best._svd
    return Structure(
        model.shared_names,
        best.rank,
        tuple(information.rank for information in found),
        best.null_directions(),
        float(values[best.rank - 1] / values[0] if best.rank else 0.0),
        n_runs,
    )
