"""A designed experiment: what to run, what it will tell, what it respects."""

from __future__ import annotations

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
from oed_sysid.display import as_dict, as_html
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

    def report(self) -> str:
        """Return the design as text."""
        lines = [
            f"Design of {self.experiment.name!r} for {self.model.name}",
            f"  criterion    {self.criterion}: {self.value:.4g} "
            f"(starts: {', '.join(f'{v:.4g}' for v in self.start_values)})",
            f"  family       {self.parametrisation}",
            f"  run          {self.experiment.duration:g} s, a sample every "
            f"{self.experiment.sample_time:g} s",
            f"  limits met   {'; '.join(self.active) or 'none is reached'}",
            *([f"  certainty    {self.assurance.report()}"] if self.assurance else []),
            f"  effort       {self.n_evaluations} trajectories, {self.seconds:.1f} s",
            "",
            *([f"  random forces {sea_words(self.sea)}", ""] if self.sea is not None else []),
            *self.accuracy_table(),
        ]
        for reference in self.references:
            mean, worst = self.gain(reference)
            note = f" ({reference.note})" if reference.note else ""
            lines.append(
                f"  Errors of {reference.name}{note} are {mean:.3g} times larger on geometric "
                f"mean, {worst:.3g} times for the worst parameter."
            )
        lines += missing_physics(self.misfits, self.chances)
        lines += [f"  Not determined: {text}." for text in self.information.null_directions()]
        return "\n".join(lines)

    def accuracy_table(self, *, sort: bool = False) -> list[str]:
        """Lines with the expected relative standard errors; sorted, the best first."""
        known = bool(np.isfinite(self.prior_errors).any())
        head = f"  {'parameter':<20} {'value':>11}" + (f" {'before':>9}" if known else "")
        head += f" {'this run':>9}"
        if self.spread is not None:
            head += f" {'other vehicles':>15}"
        lines = [head + "".join(f" {reference.name:>14}" for reference in self.references)]
        columns = [r.information.std_errors / self.sizes for r in self.references]
        for i in np.argsort(self.relative_errors) if sort else range(len(self.names)):
            row = f"  {self.names[i]:<20} {self.model.values[self.names[i]]:>11.4g}"
            if known:
                row += f" {percent(self.prior_errors[i]):>9}"
            row += f" {self._percent(self.relative_errors[i]):>9}"
            if self.spread is not None:
                row += f" {self.spread.words(self.names[i]):>15}"
            lines.append(row + "".join(f" {self._percent(column[i]):>14}" for column in columns))
        return lines

    def _percent(self, error: float) -> str:
        return stated(error, self.sea)

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
