"""Which parameters can be told apart: collinearity and the best subset.

Structural identifiability: what no manoeuvre and no accuracy could separate.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import qr

from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.information.bound import prior_factor, rows_to_parameters, triangle, whitened_factor
from oed_sysid.information.noise import Noise
from oed_sysid.information.response import Play, respond
from oed_sysid.likelihood.information import Information
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Report, Section, Table, as_dict, as_text

# Brun et al. call subsets between 10 and 15 critical.
COLLINEARITY_LIMIT = 15.0


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
    columns = _columns(information, names or information.names)
    norms = np.linalg.norm(columns, axis=0)
    if not np.all(norms > 0):
        return float(np.inf)
    if columns.shape[0] < columns.shape[1]:
        return float(np.inf)
    smallest = np.linalg.svd(columns / norms, compute_uv=False)[-1]
    return float(1.0 / smallest) if smallest > 1e-14 else float(np.inf)


def collinear_groups(
    information: Information, *, size: int = 2, limit: float = COLLINEARITY_LIMIT
) -> tuple[tuple[tuple[str, ...], float], ...]:
    """Sets of ``size`` parameters whose collinearity index passes a limit, worst first.

    A set that contains a smaller one that already passes is still listed;
    look at pairs first, then at triples.
    """
    found = [
        (group, collinearity_index(information, group))
        for group in combinations(information.names, size)
    ]
    return tuple(sorted((f for f in found if f[1] > limit), key=lambda f: -f[1]))


@dataclass(frozen=True)
class Subset:
    """Parameters in the order in which data can determine them.

    Attributes
    ----------
    order : tuple of str
        All parameters; each adds the most information that those before do
        not have (QR with column pivoting).
    collinearity : tuple of float
        Index of the first 1, 2, ... of them.
    relative_errors : tuple of float
        Largest relative standard error among the first 1, 2, ..., the others fixed.
    size : int
        How many of them can be estimated together.
    limit : float
        The collinearity that was allowed.
    """

    order: tuple[str, ...]
    collinearity: tuple[float, ...]
    relative_errors: tuple[float, ...]
    size: int
    limit: float

    @property
    def names(self) -> tuple[str, ...]:
        """The best identifiable subset."""
        return self.order[: self.size]

    @property
    def left_out(self) -> tuple[str, ...]:
        """Parameters to fix, best first."""
        return self.order[self.size :]

    def words(self, source: str = "") -> str:
        """How many parameters can be estimated, and which not."""
        fixed = f"; fix {', '.join(self.left_out)}" if self.left_out else ""
        n = len(self.order)
        return f"{self.size} of {n} parameters can be estimated together{source}{fixed}."

    def document(self) -> Report:
        """Return the subset in words and as a table."""
        rows = [
            (f"{i + 1}", name, f"{index:.3g}", f"{error:.2%}", "" if i < self.size else "x")
            for i, (name, index, error) in enumerate(
                zip(self.order, self.collinearity, self.relative_errors, strict=True)
            )
        ]
        headers = ("", "parameter", "collinearity", "worst rel. error", "to fix")
        fixed = ", ".join(self.left_out) or "none"
        title = (
            f"{self.size} of {len(self.order)} parameters can be estimated together "
            f"(collinearity at most {self.limit:g}); to fix: {fixed}"
        )
        table = Table(headers, rows, words=(1,))
        return Report(
            "", answer=self.words(), sections=(Section(title, (), (table,), heading=True),)
        )

    report = as_text

    to_dict = as_dict("order", "collinearity", "relative_errors", "limit", identifiable="names")


def identifiable_subset(
    information: Information,
    values: Mapping[str, float],
    *,
    limit: float = COLLINEARITY_LIMIT,
    largest_error: float = np.inf,
) -> Subset:
    """Find the largest set of parameters that data determine together.

    Parameters
    ----------
    information : Information
        Of all candidates, without priors.
    values : mapping of str to float
        Values, which make sensitivities relative; a zero counts as its scale.
    limit : float
        Largest collinearity index.
    largest_error : float
        Largest relative standard error that any of them may have.

    References
    ----------
    G. H. Golub, V. Klema, G. W. Stewart, Rank degeneracy and least squares
    problems, Stanford report STAN-CS-76-559 (1976): subset by pivoted QR.
    M. Burth, G. C. Verghese, M. Velez-Reyes, Subset selection for improved
    parameter estimation in on-line identification of a synchronous generator,
    *IEEE Trans. Power Systems* 14 (1999) 218-225.
    """
    names = information.names
    sizes = np.array([abs(values.get(n, 0.0)) for n in names])
    sizes = np.where(sizes > 0, sizes, information.scales)
    relative = information.factor / information.scales * sizes
    _, _, pivots = qr(relative, mode="economic", pivoting=True)
    order = tuple(names[i] for i in pivots)
    indices, errors = [], []
    for count in range(1, len(order) + 1):
        indices.append(collinearity_index(information, order[:count]))
        sub = rows_to_parameters(information.factor / information.scales, pivots[:count].tolist())
        bound = Information(order[:count], sub, np.ones(count)).std_errors
        errors.append(float(np.max(bound / sizes[pivots[:count]])))
    allowed = [
        count
        for count in range(1, len(order) + 1)
        if indices[count - 1] <= limit and errors[count - 1] <= largest_error
    ]
    return Subset(order, tuple(indices), tuple(errors), max(allowed, default=0), limit)


def _columns(information: Information, names: Sequence[str]) -> np.ndarray:
    unknown = [name for name in names if name not in information.names]
    if unknown:
        raise DesignError(
            f"There is no information on {', '.join(unknown)}; only on "
            f"{', '.join(information.names)}."
        )
    return information.factor[:, [information.names.index(name) for name in names]]


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

    def report(self) -> str:
        """Return the verdict in words."""
        head = (
            f"Structure: rank {self.rank} of {len(self.names)} over {len(self.ranks)} random sets "
            f"of values, {self.n_runs} random manoeuvres each (smallest share {self.margin:.1e})."
        )
        if self.identifiable:
            return f"{head}\nAll parameters are locally identifiable from these outputs."
        return "\n".join(
            [head, "No manoeuvre separates:", *(f"  {text}" for text in self.directions)]
        )

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

    Raises
    ------
    DesignError
        If an input has no range, or no run stays finite.
    """
    if missing := [name for name in model.input_names if name not in inputs]:
        raise DesignError(f"The input {missing[0]!r} has no range. Give inputs={{...}} for all.")
    names = tuple(p.name for p in model.free_parameters if not p.per_record)
    found = []
    for _ in range(n_points):
        drawn = _draw(model, rng, spread)
        factors = []
        for _ in range(n_runs):
            play = _random_play(drawn, inputs, rng, duration, sample_time, initial or {})
            try:
                response = respond(drawn, play)
            except SimulationError:
                continue
            spans = np.ptp(response.outputs, axis=0)
            noise = Noise(np.where(spans > 0, spans, 1.0), ((),) * len(spans))
            factors.append(
                whitened_factor(drawn, response.jacobian, response.present, noise, start)
            )
        if factors:
            scales = np.array([drawn.parameter(name).magnitude for name in names])
            rows = np.vstack([*factors, prior_factor(drawn, names, None)])
            found.append(Information(names, triangle(rows) * scales, scales))
    if not found:
        raise DesignError(
            f"No random run of model {model.name!r} stays finite. Make the ranges of the inputs "
            "smaller, the runs shorter, or give initial={...} in the operating range."
        )
    best = max(found, key=lambda information: information.rank)
    _, values, _ = best._svd
    margin = values[best.rank - 1] / values[0] if best.rank else 0.0
    return Structure(
        names,
        best.rank,
        tuple(information.rank for information in found),
        best.null_directions(),
        float(margin),
        n_runs,
    )


def _draw(model: Model, rng: np.random.Generator, spread: float) -> Model:
    values = {}
    for parameter in model.free_parameters:
        centre = parameter.value or parameter.magnitude * rng.choice([-1.0, 1.0])
        drawn = centre * (1 + spread * rng.uniform(-1, 1))
        values[parameter.name] = float(np.clip(drawn, parameter.lower, parameter.upper))
    return model.with_values(values)


def _random_play(
    model: Model,
    inputs: Mapping[str, tuple[float, float]],
    rng: np.random.Generator,
    duration: float,
    sample_time: float,
    initial: Mapping[str, float],
) -> Play:
    times = np.arange(0.0, duration + 0.5 * sample_time, sample_time)
    columns = []
    for name in model.input_names:
        lower, upper = inputs[name]
        hold = max(1, int(rng.uniform(0.02, 0.15) * len(times)))
        levels = rng.uniform(lower, upper, size=len(times) // hold + 1)
        columns.append(np.repeat(levels, hold)[: len(times)])
    commands = np.column_stack(columns) if columns else np.empty((len(times), 0))
    own = np.array([initial.get(state.name, 0.0) for state in model.states])
    own = own + 0.1 * rng.standard_normal(len(own)) * [state.scale for state in model.states]
    present = np.ones((len(times), len(model.outputs)), dtype=bool)
    return Play("random steps", times, commands, own, present)
