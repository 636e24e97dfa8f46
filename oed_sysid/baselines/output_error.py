"""Output error: single shooting, the special case of one interval per record."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.estimator import Solver
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.physics.model import Model


@dataclass(frozen=True)
class OutputError:
    """Maximum likelihood by single shooting: simulate from the start, compare, improve.

    Same optimum and errors as :class:`MultipleShooting`, but it starts from the
    model's values alone: where their trajectory runs away from the measured one,
    so does the search. It is here to be compared with.

    Parameters
    ----------
    noise, loss, max_iterations, tolerance, coloured
        See :class:`MultipleShooting`.

    References
    ----------
    Ljung (1999), System identification: theory for the user, sec. 7.2 (output-
    error models).

    Examples
    --------
    >>> OutputError(loss="student").name
    'output error (single shooting)'
    """

    noise: str | Sequence[float] = "auto"
    loss: str = "square"
    max_iterations: int = 100
    tolerance: float = 1e-6
    coloured: str = "auto"

    def __post_init__(self) -> None:
        self._engine()

    def _engine(self) -> MultipleShooting:
        return MultipleShooting(
            interval=math.inf,
            start="near",
            noise=self.noise,
            loss=self.loss,
            solver=Solver(max_iterations=self.max_iterations, tolerance=self.tolerance),
            coloured=self.coloured,
            disturbances="none",
        )

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return "output error (single shooting)"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters and initial states."""
        return replace(self._engine().fit(model, dataset), estimator=self.name)
