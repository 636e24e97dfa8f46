"""A designed experiment: what to run, what it will tell, what it respects."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from oed_sysid.data.csv_table import write_table
from oed_sysid.design.accuracy import AccuracyRange, stated
from oed_sysid.design.assurance import Assurance
from oed_sysid.design.card import sea_trial_card
from oed_sysid.design.quantities import percent
from oed_sysid.design.reference import Reference
from oed_sysid.design.reveal import Chance, missing_physics
from oed_sysid.design.tracks import Tracks
from oed_sysid.display import (
    TWO_SIDED_95,
    Figure,
    Report,
    Section,
    Table,
    as_dict,
    as_html,
    as_text,
    counted,
    share,
)
from oed_sysid.experiment import Experiment
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity.sea import sea_words
from oed_sysid.simulation import Trajectory


@dataclass(frozen=True, eq=False)
class Design:
    """Result of :func:`~oed_sysid.design.design_experiment`.

    Attributes
    ----------
    experiment : Experiment
        What to run; simulate it, or play :meth:`write_csv` on an autopilot.
    model : Model
        The model it was designed for, at the nominal values.
    trajectory : Trajectory
        What that model does.
    information : Information
        After the experiment, prior knowledge included, start states unknown.
    prior : Information or None
        Before it.
    references : tuple of Reference
        Standard manoeuvres of the same duration, within the same limits.
    criterion, parametrisation : str
        Their names.
    value : float
        Criterion reached.
    start_values : tuple of float
        Criterion reached from each start; a wide spread asks for more starts.
    active : tuple of str
        Limits that are reached, in words.
    misfits : mapping of (str, str) to float
        For discrimination: expected ``2 dlogL`` of the first rival over the second.
    n_evaluations : int
        Trajectories with sensitivities.
    seconds : float
    assurance : Assurance or None
        How surely limits are kept although the parameters are uncertain, if asked for.
    sea : NoiseModel or None
        Random forces and coloured sensors that the accuracy takes into account; None
        where noise is white.
    spread : AccuracyRange or None
        Accuracy on other vehicles that are possible, if asked for.
    chances : tuple of Chance
        For :class:`~oed_sysid.design.Reveal`: how surely each candidate effect would show.
    """

    experiment: Experiment
    model: Model
    trajectory: Trajectory = field(repr=False)
    information: Information = field(repr=False)
    prior: Information | None = field(repr=False)
    references: tuple[Reference, ...] = field(repr=False)
    criterion: str
    parametrisation: str
    value: float
    start_values: tuple[float, ...]
    active: tuple[str, ...]
    misfits: dict[tuple[str, str], float]
    n_evaluations: int
    seconds: float
    assurance: Assurance | None = None
    sea: NoiseModel | None = None
    spread: AccuracyRange | None = None
    chances: tuple[Chance, ...] = ()

    _repr_html_ = as_html

    def __repr__(self) -> str:
        worst = int(np.argmax(self.relative_errors))
        return (
            f"<Design {self.experiment.name!r} for {self.model.name!r}: "
            f"{self.experiment.duration:g} s, {self.names[worst]} least certain, "
            f"+/- {1.96 * self.relative_errors[worst]:.2%} (95 %)>"
        )

    # -- accuracy ------------------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters."""
        return self.information.names

    @property
    def sizes(self) -> np.ndarray:
        """Absolute values (or scales of zeros) that make errors relative, ``(n,)``."""
        return np.array([self.model.parameter(name).reference for name in self.names])

    @property
    def relative_errors(self) -> np.ndarray:
        """Expected standard errors as shares of the values, shape ``(n,)``."""
        return self.information.std_errors / self.sizes

    @property
    def prior_errors(self) -> np.ndarray:
        """The same before the experiment; infinite where nothing is known."""
        if self.prior is None:
            return np.full(len(self.names), np.inf)
        return self.prior.std_errors / self.sizes

    def gain(self, reference: Reference) -> tuple[float, float]:
        """How much larger a reference's errors are.

        Returns
        -------
        mean : float
            Ratio of the geometric means of all standard errors.
        worst : float
            Ratio of the largest relative errors.
        """
        theirs = reference.information.std_errors / self.sizes
        ours = self.relative_errors
        if not np.all(np.isfinite(theirs)):
            return float("inf"), float("inf")
        mean = float(np.exp(np.mean(np.log(theirs / ours))))
        return mean, float(theirs.max() / ours.max())

    # -- words ---------------------------------------------------------------------

    def document(self, *, title: str = "") -> Report:
        """Return what the design will tell, commands, motion and the sea-trial card."""
        errors, safe = self.relative_errors, self.assurance
        best, worst = int(np.nanargmin(errors)), int(np.nanargmax(errors))
        drawing = Figure(
            "figure_design", self,
            "Left: commands and the motion that the model predicts, with their limits. Right: "
            "expected relative standard errors before, after the design, and after zigzags.",
        )  # fmt: skip
        starts = ", ".join(f"{value:.4g}" for value in self.start_values)
        length, every = self.experiment.duration, self.experiment.sample_time
        told = "\n".join(missing_physics(self.misfits, self.chances))
        return Report(
            title=title or self.model.name,
            subtitle=f"Experiment {self.experiment.name!r}, criterion {self.criterion}",
            headline=f"Design of {self.experiment.name!r} for {self.model.name}",
            answer=self._answer(),
            warnings=[safe.danger] if safe is not None and safe.danger else [],
            head=(
                ("criterion", f"{self.criterion}: {self.value:.4g} (starts: {starts})"),
                ("family", self.parametrisation),
                ("run", f"{length:g} s, a sample every {every:g} s"),
                ("limits met", "; ".join(self.active) or "none is reached"),
                *([("certainty", safe.report())] if safe else []),
                ("effort", f"{self.n_evaluations} trajectories, {self.seconds:.1f} s"),
                *([("random forces", sea_words(self.sea))] if self.sea is not None else []),
            ),
            numbers=(
                ("length", f"{length:g} s"),
                (f"std. error, best: {self.names[best]}", f"{100 * errors[best]:.2g} %"),
                (f"std. error, worst: {self.names[worst]}", f"{100 * errors[worst]:.2g} %"),
            ),
            sections=(
                Section(
                    "What to run, and what it will tell", self._remarks(), (self.accuracy(),),
                    (drawing,), indent=2,
                ),
                Section("Missing physics", listing=told),
                Section("Sea-trial card", listing=self.sea_trial_card(), only="page"),
            ),
        )  # fmt: skip

    report = as_text

    def _answer(self) -> str:
        """What the run will tell, and whether it keeps its limits."""
        errors, found = TWO_SIDED_95 * self.relative_errors, self.assurance
        worst = int(errors.argmax())
        words = "" if found is None or found.is_safe else "DANGER: "
        words += (
            f"{self.experiment.name}: after {self.experiment.duration:g} s the least certain of "
            f"{counted(len(errors), 'parameter')} is {self.names[worst]}, ± {share(errors[worst])} "
            "(95 %)"
        )
        if self.references:
            reference = self.references[0]
            gain = self.gain(reference)[0]
            words += (
                f"; {reference.name} would leave {gain:.3g} × larger errors"
                if np.isfinite(gain)
                else f"; {reference.name} alone would not determine all of them"
            )
        if found is not None and found.limited:
            words += f"; limits kept on {found.probability:.0%} of possible vehicles"
        return f"{words}."

    def _remarks(self) -> list[str]:
        lines = []
        for reference in self.references:
            mean, worst = self.gain(reference)
            note = f" ({reference.note})" if reference.note else ""
            lines.append(
                f"Errors of {reference.name}{note} are {mean:.3g} times larger on geometric "
                f"mean, {worst:.3g} times for the worst parameter."
            )
        return lines + [f"Not determined: {text}." for text in self.information.null_directions()]

    def accuracy(self, *, sort: bool = False) -> Table:
        """Expected relative standard errors; sorted, the best first."""
        columns: dict[str, Sequence[str]] = {}
        if np.isfinite(self.prior_errors).any():
            columns["before"] = [percent(error) for error in self.prior_errors]
        columns["this run"] = [stated(error, self.sea) for error in self.relative_errors]
        if self.spread is not None:
            columns["other vehicles"] = [self.spread.words(name) for name in self.names]
        for one in self.references:
            errors = one.information.std_errors / self.sizes
            columns[one.name] = [stated(error, self.sea) for error in errors]
        values = [f"{self.model.values[name]:.4g}" for name in self.names]
        rows = list(zip(self.names, values, *columns.values(), strict=True))
        if sort:
            rows = [rows[i] for i in np.argsort(self.relative_errors)]
        return Table(("parameter", "value", *columns), rows)

    def card(self, tracks: Tracks | None = None, *, title: str = "") -> Report:
        """Return the sea-trial card as a page: danger first, then what to run and where it goes.

        Parameters
        ----------
        tracks : Tracks, optional
            From :func:`~oed_sysid.design.plausible_tracks`.
        title : str
        """
        safe = self.assurance
        verdict = []
        if safe is not None and safe.rules:
            verdict.append(
                f"Abort rules fire on {safe.any_fires:.1%} of {safe.n_checked} simulated vehicles."
            )
        drawings = [Figure("plot_orders", self, "Orders over time.", size=(7.2, 2.6))]
        if tracks is not None:
            caption = "Where the run goes: " + "; ".join(tracks.words()) + "."
            drawings.append(Figure("plot_tracks", tracks, caption, size=(5.4, 4.6)))
            verdict.append("Sea room: " + "; ".join(tracks.words()[:2]) + ".")
        return Report(
            title=title or self.model.name,
            subtitle=f"Sea-trial card of {self.experiment.name!r}",
            warnings=[safe.danger] if safe is not None and safe.danger else [],
            verdict=verdict or [f"Criterion {self.criterion}."],
            numbers=(
                ("length", f"{self.experiment.duration:g} s"),
                ("limits kept", "-" if safe is None else f"{safe.probability:.1%}"),
                ("stopped", "-" if safe is None else f"{safe.any_fires:.1%}"),
            ),
            sections=(
                Section("Card", listing=self.sea_trial_card()),
                Section("Orders and track", figures=drawings),
            ),
        )

    def sea_trial_card(self) -> str:
        """Return one page for the people who run the trial."""
        return sea_trial_card(self)

    to_dict = as_dict(
        "experiment", "criterion", "parametrisation", "value", "start_values", "sea",
        "assurance", "chances", "n_evaluations", "seconds",
        model="model.name",
        parameters=lambda self: [
            {"name": name, "value": self.model.values[name], "before": before, "after": after}
            for name, before, after in zip(
                self.names, self.prior_errors * self.sizes, self.information.std_errors,
                strict=True,
            )
        ],
        references=lambda self: [
            {
                "name": one.name,
                "note": one.note,
                "std_errors": one.information.std_errors,
                **dict(zip(("mean_gain", "worst_gain"), self.gain(one), strict=True)),
            }
            for one in self.references
        ],
        accuracy_range="spread", active_limits="active",
        misfits=lambda self: [[*pair, value] for pair, value in self.misfits.items()],
    )  # fmt: skip

    def write_csv(self, path: str | Path, *, predicted: bool = False) -> None:
        """Write the commands as a table that an autopilot can play.

        Times in s, commands in SI units named in the header, one row per
        sample, each command to be held until the next row.

        Parameters
        ----------
        path : str or Path
            The file, overwritten if it exists.
        predicted : bool
            Also write the outputs that the model predicts, to watch against;
            the file can then be read as a record.
        """
        columns = {"t [s]": self.trajectory.times}
        for channel, values in zip(self.model.inputs, self.trajectory.inputs.T, strict=True):
            columns[f"{channel.name} [{channel.unit or '-'}]"] = values
        if predicted:
            for output, values in zip(self.model.outputs, self.trajectory.outputs.T, strict=True):
                columns[f"{output.name} [{output.unit or '-'}]"] = values
        write_table(Path(path), list(columns), np.column_stack(list(columns.values())))
