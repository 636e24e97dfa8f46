"""A campaign on disk: candidates, goals and records of a trial that may be broken off at any time.

Every step ends by writing ``journal.json`` as a whole; what was being done when the power failed is
simply done again. Records are copied into the folder, so that it can be carried home.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset, read_csv
from oed_sysid.design.decision import Decision, decide, goals_of
from oed_sysid.design.library import Candidate
from oed_sysid.design.result import write_commands
from oed_sysid.errors import DesignError, FileError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import plain
from oed_sysid.runtime.files import write_bytes, write_text

NAME = "journal.json"
_FIT = "fit.json"
# What the journal holds of a logbook.
_KEPT = (
    "problem", "variant", "goals", "hours", "sea", "records", "runs", "proposed", "seed",
    "candidates",
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Logbook:
    """State of a campaign.

    Attributes
    ----------
    folder : Path
    problem : str
    variant : str or None
    candidates : tuple of Candidate
    goals : mapping of str to float
        Relative errors by parameter, or ``"all"``.
    hours : float or None
        For the whole trial.
    sea : NoiseModel or None
        Expected until a fit has found its own.
    records : tuple of str
        Files of the folder, in order.
    runs : tuple of str
        Names of the runs that were proposed, one for each record.
    proposed : str or None
        The run that is to be done next.
    seed : int
    model : Model or None
    fit : Fit or None
        Of all records.
    """

    folder: Path
    problem: str
    variant: str | None
    candidates: tuple[Candidate, ...]
    goals: Mapping[str, float]
    hours: float | None
    sea: NoiseModel | None
    records: Sequence[str] = ()
    runs: Sequence[str] = ()
    proposed: str | None = None
    seed: int = 0
    model: Model | None = field(default=None, repr=False)
    fit: Fit | None = field(default=None, repr=False)

    @staticmethod
    def exists(folder: str | Path) -> bool:
        """Whether a folder holds a campaign."""
        return (Path(folder) / NAME).is_file()

    @classmethod
    def begin(
        cls,
        folder: str | Path,
        model: Model,
        *,
        problem: str,
        candidates: Sequence[Candidate],
        goals: Mapping[str, float],
        variant: str | None = None,
        hours: float | None = None,
        sea: NoiseModel | None = None,
        seed: int = 0,
    ) -> Logbook:
        """Begin a campaign and write its journal.

        Raises
        ------
        DesignError
            If a goal is about nothing.
        """
        goals_of(model, goals)  # said now, not after the first run
        journal = cls(
            Path(folder), problem, variant, tuple(candidates), dict(goals), hours, sea, seed=seed,
            model=model,
        )  # fmt: skip
        journal.write()
        return journal

    @classmethod
    def open(cls, folder: str | Path) -> Logbook:
        """Read a campaign; give it its model with :meth:`of`.

        Raises
        ------
        FileError
            If the journal cannot be read.
        """
        place = Path(folder) / NAME
        try:
            data = json.loads(place.read_text(encoding="utf-8"))
            data = {name: data[name] for name in _KEPT}
            data["candidates"] = tuple(
                Candidate(**(one | {"experiment": Experiment.from_dict(one["experiment"])}))
                for one in data["candidates"]
            )
            data["sea"] = None if data["sea"] is None else _noise(data["sea"])
            return cls(Path(folder), **data)
        except (OSError, ValueError, KeyError, TypeError) as error:
            raise FileError(
                f"{str(place)!r} is no journal of a campaign ({error}). Begin another one, or "
                "restore it from a copy."
            ) from None

    def of(self, model: Model) -> Logbook:
        """Return the journal with its model, and the fit of its records if there is one."""
        stored = self.folder / _FIT
        fit = None
        if self.records:
            if stored.is_file():
                fit = Fit.load(stored)
            if fit is None or len(tuple(fit.dataset)) != len(self.records):
                fit = MultipleShooting().fit(model, self.dataset(model))
        return replace(self, model=model, fit=fit)

    def dataset(self, model: Model) -> Dataset:
        """All records."""
        return read_csv([self.folder / name for name in self.records], model.channels)

    @property
    def hours_used(self) -> float:
        """Time of the runs done, turnarounds included, h."""
        costs = {run.name: run.cost for run in self.candidates}
        return sum(costs.get(name, 0.0) for name in self.runs) / 3600.0

    def with_record(self, path: str | Path) -> Logbook:
        """Take a log in, estimate from all of them, and write the journal.

        Parameters
        ----------
        path : str or Path
            CSV of the run that was proposed last.

        Raises
        ------
        FileError, DataError
            If it cannot be read; nothing is changed then.
        """
        model = self._model
        try:
            content = Path(path).read_bytes()
        except OSError as error:
            raise FileError(f"{str(path)!r} cannot be read: {error.strerror}.") from None
        for name in self.records:
            if (self.folder / name).read_bytes() == content:
                raise DesignError(
                    f"{str(path)!r} is in the journal already, as {name}. Give the next log."
                )
        name = f"run_{len(self.records) + 1:02d}.csv"
        read_csv([Path(path)], model.channels)  # what cannot be read is not taken in
        write_bytes(self.folder / name, content)
        longer = replace(
            self, records=(*self.records, name), runs=(*self.runs, self.proposed or ""),
            proposed=None,
        )  # fmt: skip
        fit = MultipleShooting().fit(model, longer.dataset(model))
        fit.save(self.folder / _FIT)
        longer = replace(longer, fit=fit)
        longer.write()
        return longer

    def decide(self) -> Decision:
        """Stop, or what to run next."""
        model = self._model
        if self.fit is not None and not self.fit.status.ok:
            raise DesignError(
                f"The estimation from {len(self.records)} records did not converge "
                f"({self.fit.status}). Look at the records (oed-sysid check), or fix parameters "
                "that they do not show."
            )
        fitted = self.fit is not None and not self.fit.noise.is_white
        return decide(
            self.fit or model,
            self.candidates,
            goals_of(model, self.goals),
            rng=np.random.default_rng(self.seed),
            noise=None if fitted else self.sea,
            hours=None if self.hours is None else self.hours - self.hours_used,
        )

    def write_next(self, decision: Decision) -> Path | None:
        """Write the commands of the next run as ``next.csv`` and note it in the journal."""
        run = decision.next_run
        replace(self, proposed=None if run is None else run.name).write()
        if run is None:
            return None
        return write_commands(self.folder / "next.csv", decision.model, run.experiment)

    def write(self) -> None:
        """Write the journal, whole or not at all."""
        data = {name: getattr(self, name) for name in _KEPT}
        data["sea"] = None if self.sea is None else asdict(self.sea)
        write_text(self.folder / NAME, json.dumps(plain(data), indent=1) + "\n")

    @property
    def _model(self) -> Model:
        if self.model is None:
            raise DesignError("The logbook has no model yet. Give it with Logbook.of(model).")
        return self.model


def _noise(data: Mapping[str, Any]) -> NoiseModel:
    arrays = {
        name: np.array(data[name], dtype=float)
        for name in ("white", "colour", "force", "colour_time", "force_time")
    }
    names = {name: tuple(data[name]) for name in ("outputs", "places")}
    seas = tuple(Sea(**sea) for sea in data.get("seas", ()))
    return NoiseModel(**arrays, **names, seas=seas)  # type: ignore[arg-type]
