"""A designed programme: which runs in which order, what they will tell, how near the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import wrap

import numpy as np

from oed_sysid.data.csv_table import write_table
from oed_sysid.design.accuracy import AccuracyRange, stated
from oed_sysid.design.assurance import Assurance
from oed_sysid.design.library import Candidate
from oed_sysid.design.quantities import percent
from oed_sysid.design.reveal import Chance, missing_physics
from oed_sysid.display import as_dict, as_html
from oed_sysid.files import make_folder
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity.sea import sea_words
from oed_sysid.simulation import simulate

_WIDTH = 92


def joint_share(found: Sequence[Assurance]) -> float:
    """Share of the vehicles on which all of several runs, judged on the same ones, keep limits."""
    masks = [one.kept for one in found if one.limited]
    return float(np.logical_and.reduce(masks).mean()) if masks else 1.0


@dataclass(frozen=True)
class Standard:
    """Standard trials, to compare a programme with.

    Attributes
    ----------
    names : tuple of str
    hours : float
        Time after which, repeated as a whole, they would be worth as much; infinite if never.
    own_hours : float
        Time of the programme they are compared with.
    errors : mapping of str to float
        Relative errors after the programme's own time.
    """

    names: tuple[str, ...]
    hours: float
    own_hours: float
    errors: Mapping[str, float]

    to_dict = as_dict("names", "hours", "ratio")

    @property
    def ratio(self) -> float:
        """How many times more ship time they need."""
        return self.hours / self.own_hours


@dataclass(frozen=True, eq=False)
class Programme:
    """Result of :func:`~oed_sysid.design.design_programme`.

    Attributes
    ----------
    model : Model
        The nominal vehicle.
    runs : tuple of Candidate
        In the order in which they tell most first; one entry for each repetition.
    candidates : tuple of Candidate
        The library, refined runs included.
    weights : ndarray (n_candidates,)
        Repetitions in the relaxed optimum.
    information : Information
        After all runs on the nominal vehicle, prior knowledge included.
    prior : Information or None
    criterion : str
    value, relaxed, bound : float
        Criterion reached by whole runs, by weights, and what no programme of this library
        within the budget exceeds.
    share : float
        Information of the programme over that bound, as the criterion counts it.
    greedy_share : float
        What greedy selection from the unrefined library reaches of the exchanged selection.
    refined_factor : float
        How many times refined commands raised the information.
    n_library : int
        Candidates before refinement.
    assurances : mapping of str to Assurance
        How surely each run keeps its limits.
    sea : NoiseModel or None
    spread : AccuracyRange or None
        Errors on other vehicles that are possible.
    standard : Standard or None
    outputs : tuple of str
        What is measured.
    sensor_hours : float
    sensor_options : mapping of str to (value, factor)
        Sets of optional sensors: criterion, and information relative to the chosen one.
    turnaround : float
        s.
    budget : tuple of (hours or None, number of runs or None)
    seconds : float
    misfits : mapping of (str, str) to float
        For discrimination: expected ``2 dlogL`` of the first rival over the second.
    chances : tuple of Chance
        For effects to be revealed: how surely each would show.
    """

    model: Model
    runs: tuple[Candidate, ...]
    candidates: tuple[Candidate, ...] = field(repr=False)
    weights: np.ndarray = field(repr=False)
    information: Information = field(repr=False)
    prior: Information | None = field(repr=False)
    criterion: str
    value: float
    bound: float
    relaxed: float
    share: float
    greedy_share: float
    refined_factor: float
    n_library: int
    assurances: Mapping[str, Assurance] = field(repr=False)
    sea: NoiseModel | None
    spread: AccuracyRange | None
    standard: Standard | None
    outputs: tuple[str, ...]
    sensor_hours: float
    sensor_options: Mapping[str, tuple[float, float]]
    turnaround: float
    budget: tuple[float | None, int | None]
    seconds: float
    misfits: Mapping[tuple[str, str], float] = field(default_factory=dict)
    chances: tuple[Chance, ...] = ()

    _repr_html_ = as_html

    def __repr__(self) -> str:
        return f"<Programme for {self.model.name!r}: {len(self.runs)} runs, {self.hours:.3g} h>"

    @property
    def hours(self) -> float:
        """Time for everything, h."""
        return sum(run.cost for run in self.runs) / 3600.0 + self.sensor_hours

    @property
    def gap(self) -> float:
        """How far the weights may be below the best weights, in units of the criterion."""
        return self.bound - self.relaxed

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters."""
        return self.information.names

    @property
    def sizes(self) -> np.ndarray:
        """Values that make errors relative, ``(n,)``."""
        return np.array([self.model.parameter(name).reference for name in self.names])

    @property
    def relative_errors(self) -> np.ndarray:
        """Expected standard errors as shares of the values, ``(n,)``."""
        return self.information.std_errors / self.sizes

    @property
    def limited(self) -> bool:
        """Whether there is any limit on the motion."""
        return any(one.limited for one in self.assurances.values())

    @property
    def kept(self) -> float:
        """Share of the simulated vehicles on which all runs keep their limits."""
        return joint_share(list(self.assurances.values()))

    @property
    def unsafe(self) -> tuple[str, ...]:
        """Runs that leave their limits on more vehicles than wanted."""
        return tuple(
            name
            for name, one in self.assurances.items()
            if one.limited and one.wanted is not None and one.probability < one.wanted
        )

    @property
    def is_unsafe_together(self) -> bool:
        """Whether one run or another leaves its limits on more vehicles than wanted."""
        wanted = [one.wanted for one in self.assurances.values() if one.limited and one.wanted]
        return bool(wanted) and self.kept < max(wanted)

    @property
    def danger_together(self) -> str:
        """What is said where each run keeps its limits, and all of them together do not."""
        if self.unsafe or not self.is_unsafe_together:
            return ""
        return (
            f"DANGER: on {1 - self.kept:.0%} of the vehicles that are possible one run or another "
            "leaves its limits."
        )

    def report(self) -> str:
        """Return the programme as text; danger in the first line."""
        lines = []
        if self.danger_together:
            lines += wrap(f"{self.danger_together} Stand by to stop.", _WIDTH)
        if self.unsafe:
            worst = min(self.unsafe, key=lambda name: self.assurances[name].probability)
            lines += wrap(
                f"DANGER: {worst!r} leaves its limits on "
                f"{1 - self.assurances[worst].probability:.0%} of the vehicles that are possible. "
                "Stand by to stop, or begin with a gentle run and plan from its fit.", _WIDTH
            )  # fmt: skip
        lines.append(
            f"Programme for {self.model.name}: {len(self.runs)} runs, {self.hours:.3g} h with "
            f"{self.turnaround / 60:.3g} min between runs"
        )
        lines.append(
            f"  random forces {'none' if self.sea is None else sea_words(self.sea)}; measured "
            f"{', '.join(self.outputs)}"
        )
        lines += ["", f"  {'':>3} {'run':<44} {'length':>7} {'limits kept':>12}"]
        for number, run in enumerate(self.runs, start=1):
            kept = self.assurances.get(run.name)
            share = "-" if kept is None or not kept.limited else f"{kept.probability:.0%}"
            length = f"{float(run.experiment.duration or 0.0):g} s"
            lines.append(f"  {number:>3} {run.name:<44} {length:>7} {share:>12}")
        if self.limited:
            checked = max(one.n_checked for one in self.assurances.values())
            lines.append(f"      all together keep them on {self.kept:.0%} of {checked} vehicles")
        lines += ["", *self.accuracy_table(), ""]
        lines += wrap(
            f"  Of what the best programme of these {len(self.candidates)} runs could tell, this "
            f"one tells {self.share:.1%} (criterion {self.criterion}; the weights are within "
            f"{max(self.gap, 0.0):.1g} of their optimum). Refined commands made it "
            f"{self.refined_factor:.3g} times as telling; greedy selection would reach "
            f"{self.greedy_share:.1%} of the selection before. The bound holds for these runs, "
            "these forces and a model of this structure; other commands may do better.",
            _WIDTH, subsequent_indent="  ",
        )  # fmt: skip
        lines += missing_physics(self.misfits, self.chances)
        if self.standard is not None:
            lines += wrap(f"  {self._compared()}", _WIDTH, subsequent_indent="  ")
        for words, (_, factor) in self.sensor_options.items():
            lines.append(f"  With optional sensors {words}: information times {factor:.3g}.")
        lines += [f"  Not determined: {text}." for text in self.information.null_directions()]
        return "\n".join(lines)

    def _compared(self) -> str:
        assert self.standard is not None
        trials = ", ".join(self.standard.names)
        if not np.isfinite(self.standard.hours):
            return f"The standard programme ({trials}) never tells as much."
        return (
            f"The standard programme ({trials}) needs {self.standard.hours:.3g} h for the same "
            f"criterion, {self.standard.ratio:.3g} times the ship time."
        )

    def accuracy_table(self) -> list[str]:
        """Lines with the expected relative errors."""
        head = f"  {'parameter':<20} {'value':>11}"
        before = None if self.prior is None else self.prior.std_errors / self.sizes
        head += "" if before is None else f" {'before':>9}"
        head += f" {'after':>9}"
        head += "" if self.spread is None else f" {'other vehicles':>18}"
        head += "" if self.standard is None else f" {'standard trials':>16}"
        lines = [head]
        for i, name in enumerate(self.names):
            row = f"  {name:<20} {self.model.values[name]:>11.4g}"
            row += "" if before is None else f" {percent(before[i]):>9}"
            row += f" {stated(self.relative_errors[i], self.sea):>9}"
            row += "" if self.spread is None else f" {self.spread.words(name):>18}"
            if self.standard is not None:
                row += f" {stated(self.standard.errors[name], self.sea):>16}"
            lines.append(row)
        return lines

    to_dict = as_dict(
        "hours", "runs", "criterion", "value", "relaxed", "bound", "gap", "greedy_share",
        "refined_factor", "standard", "sea", "outputs", "chances", "seconds",
        model="model.name",
        runs=lambda self: [
            {
                "name": run.name,
                "kind": run.kind,
                "cost_s": run.cost,
                "experiment": run.experiment,
                "limits_kept": self.assurances[run.name],
            }
            for run in self.runs
        ],
        limits_kept=lambda self: self.kept if self.limited else None,
        share_of_bound="share",
        weights=lambda self: {
            run.name: x
            for run, x in zip(self.candidates, self.weights, strict=True)
            if x > 1e-6
        },
        parameters=lambda self: [
            {"name": name, "value": self.model.values[name], "relative_error": error}
            for name, error in zip(self.names, self.relative_errors, strict=True)
        ],
        accuracy_range="spread", sensors="sensor_options",
        misfits=lambda self: [[*pair, value] for pair, value in self.misfits.items()],
    )  # fmt: skip

    def write(self, folder: str | Path) -> tuple[Path, ...]:
        """Write the commands of every run as a table, numbered in order.

        Times in s, commands in SI units named in the header, each to be held until the next
        row; of a run that is closed over the vehicle, what the nominal one would command.

        Parameters
        ----------
        folder : str or Path
            Made if it is missing.

        Returns
        -------
        tuple of Path
        """
        place = make_folder(folder)
        written = []
        for number, run in enumerate(self.runs, start=1):
            record = simulate(self.model, run.experiment, noise=False)
            columns = {"t [s]": record.times}
            for channel, values in zip(self.model.inputs, record.inputs.T, strict=True):
                columns[f"{channel.name} [{channel.unit or '-'}]"] = values
            word = "".join(c if c.isalnum() else "_" for c in run.name)
            path = place / f"{number:02d}_{word}.csv"
            write_table(path, list(columns), np.column_stack(list(columns.values())))
            written.append(path)
        return tuple(written)
