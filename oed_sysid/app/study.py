"""What is being studied: a problem, its training and its validation records."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field

import numpy as np

from oed_sysid.data.dataset import Dataset, together
from oed_sysid.errors import DataError
from oed_sysid.evidence.usual import equipped
from oed_sysid.experiments.problem import Problem


@dataclass(frozen=True, eq=False)
class Study:
    """A problem and the records that were chosen for it.

    Parameters
    ----------
    source : str
        Shipped name or folder of the problem, as the user gave it.
    variant : str
        Which of its models is the nominal one.
    problem : Problem
        The problem, that model as the nominal one; usual candidates are added where it names none.
    train, test : Dataset or None
        Training records; validation records.
    known_noise : bool
        Whether the declared noise levels are trusted.
    is_equipped : bool
        Whether the candidates are usual ones, because the problem names none.
    """

    source: str
    variant: str
    problem: Problem
    train: Dataset | None = None
    test: Dataset | None = None
    known_noise: bool = False
    is_equipped: bool = field(init=False, default=False)

    def __post_init__(self) -> None:
        if self.train is not None and not self.problem.effects:
            object.__setattr__(self, "problem", equipped(self.problem, self.train))
            object.__setattr__(self, "is_equipped", True)

    @property
    def key(self) -> tuple[str, ...]:
        """What it is, by content: equal studies have equal results."""
        model = self.problem.model
        return (
            self.source,
            self.variant,
            digest(model.content, repr(self.problem.effects), repr(self.problem.limits)),
            content(self.train),
            content(self.test),
            str(self.known_noise),
        )

    @property
    def noise(self) -> str:
        """The estimator's setting for noise levels."""
        return "given" if self.known_noise else "auto"

    def training(self) -> Dataset:
        """Return the training records.

        Raises
        ------
        DataError
            If none were chosen.
        """
        if self.train is None:
            raise DataError("There is no training record. Choose one on the page Problem.")
        return self.train

    def records(self) -> Dataset:
        """Return all chosen records.

        Raises
        ------
        DataError
            If there are none.
        """
        if self.train is None or self.test is None:
            return self.training() if self.test is None else self.test
        return together(self.train, self.test)

    def validation(self) -> Dataset:
        """Return the validation records.

        Raises
        ------
        DataError
            If none were chosen.
        """
        if self.test is None:
            raise DataError("There is no validation record. Choose one on the page Problem.")
        return self.test


def content(dataset: Dataset | None) -> str:
    """Digest of the names and numbers of records."""
    if dataset is None:
        return "none"
    parts: list[str | bytes] = []
    for record in dataset:
        parts.append(record.name)
        parts += [_bytes(part) for part in (record.times, record.inputs, record.outputs)]
    return digest(*parts)


def digest(*parts: str | bytes) -> str:
    """Short hash of texts or bytes."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
        total.update(b"\0")
    return total.hexdigest()[:16]


def _bytes(values: np.ndarray) -> bytes:
    return np.ascontiguousarray(values).tobytes()
