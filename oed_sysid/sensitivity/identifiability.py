"""Which parameters can be told apart: collinearity and the best subset."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from scipy.linalg import qr

from oed_sysid.display import Report, Section, Table, as_dict, as_text
from oed_sysid.errors import DesignError
from oed_sysid.information import Information
from oed_sysid.sensitivity.bound import rows_to_parameters

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
        From :func:`~oed_sysid.sensitivity.bound.information_of`, without priors.
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
