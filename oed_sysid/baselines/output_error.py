"""Output error: single shooting, the special case of one interval per record."""

from __future__ import annotations

import math
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
    loss : str
        See :class:`MultipleShooting`.
    max_iterations : int
        Of the solver.

    References
    ----------
    Ljung (1999), System identification: theory for the user, sec. 7.2 (output-
    error models).

    Examples
    --------
    >>> OutputError(loss="student").name
    'output error (single shooting)'
    """

    loss: str = "square"
    max_iterations: int = 100

    def __post_init__(self) -> None:
        self._engine()

    def _engine(self) -> MultipleShooting:
        return MultipleShooting(
            interval=math.inf, start="near", loss=self.loss, disturbances="none",
            solver=Solver(max_iterations=self.max_iterations),
        )  # fmt: skip

    @property
    def name(self) -> str:
        """Name and settings, for reports."""
        return "output error (single shooting)"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters and initial states."""
        return replace(self._engine().fit(model, dataset), estimator=self.name)
