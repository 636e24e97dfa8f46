"""A designed programme: which runs in which order, what they will tell, how near the optimum."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from textwrap import wrap

import numpy as np

from oed_sysid.data.csv_table import write_table
from oed_sysid.design.accuracy import TRUSTED, AccuracyRange, stated
from oed_sysid.design.assurance import Assurance
from oed_sysid.design.discrimination import told_apart
from oed_sysid.design.library import Candidate
from oed_sysid.design.quantities import percent
from oed_sysid.design.reveal import SURE, Chance, missing_physics
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

    def document(self, *, title: str = "") -> Report:
        """Return the programme: danger first, then runs, accuracy and certificate."""
        errors = self.relative_errors
        worst = int(errors.argmax())
        drawing = Figure(
            "figure_programme", self,
            "Every run: its command and the motion that the model predicts; dotted: what all but "
            "the most extreme of the possible vehicles stay within; dashed: limits. Right: "
            "expected relative standard errors.",
        )  # fmt: skip
        told = "\n".join(missing_physics(self.misfits, self.chances))
        return Report(
            title=title or self.model.name,
            subtitle=f"Programme, criterion {self.criterion}",
            headline=f"Programme for {self.model.name}: {len(self.runs)} runs, {self.hours:.3g} h "
            f"with {self.turnaround / 60:.3g} min between runs",
            answer=self._answer(),
            warnings=self._dangers(),
            head=(
                ("random forces", "none" if self.sea is None else sea_words(self.sea)),
                ("measured", ", ".join(self.outputs)),
            ),
            numbers=(
                ("runs", str(len(self.runs))),
                ("time", f"{self.hours:.3g} h"),
                (f"std. error, worst: {self.names[worst]}", f"{100 * errors[worst]:.2g} %"),
            ),
            sections=(
                self._plan(drawing),
                Section("Accuracy to expect", (), (self.accuracy(),), indent=2),
                Section("What this is worth", self._worth(), indent=2),
                Section("Missing physics", listing=told),
                Section("Compared", self._options(), indent=2),
            ),
        )

    report = as_text

    def _dangers(self) -> list[str]:
        if self.danger_together:
            return [f"{self.danger_together} Stand by to stop."]
        if not self.unsafe:
            return []
        worst = min(self.unsafe, key=lambda name: self.assurances[name].probability)
        left = 1 - self.assurances[worst].probability
        return [
            f"DANGER: {worst!r} leaves its limits on {left:.0%} of the vehicles that are possible. "
            "Stand by to stop, or begin with a gentle run and plan from its fit."
        ]

    def _plan(self, drawing: Figure) -> Section:
        rows = []
        for number, run in enumerate(self.runs, start=1):
            kept = self.assurances.get(run.name)
            probability = "-" if kept is None or not kept.limited else f"{kept.probability:.0%}"
            length = f"{float(run.experiment.duration or 0.0):g} s"
            rows.append((str(number), run.name, length, probability))
        marked = tuple(i for i, run in enumerate(self.runs) if run.name in self.unsafe)
        table = Table(("", "run", "length", "limits kept"), rows, words=(1,), marked=marked)
        words = []
        if self.limited:
            checked = max(one.n_checked for one in self.assurances.values())
            words.append(f"all together keep them on {self.kept:.0%} of {checked} vehicles")
        return Section("What to run", words, (table,), (drawing,), indent=2)

    def _worth(self) -> list[str]:
        return wrap(
            f"Of what the best programme of these {len(self.candidates)} runs could tell, this "
            f"one tells {self.share:.1%} (criterion {self.criterion}; the weights are within "
            f"{max(self.gap, 0.0):.1g} of their optimum). Refined commands made it "
            f"{self.refined_factor:.3g} times as telling; greedy selection would reach "
            f"{self.greedy_share:.1%} of the selection before. The bound holds for these runs, "
            "these forces and a model of this structure; other commands may do better.",
            _WIDTH,
        )

    def _options(self) -> list[str]:
        lines = [] if self.standard is None else wrap(self._compared(), _WIDTH)
        for words, (_, factor) in self.sensor_options.items():
            lines.append(f"With optional sensors {words}: information times {factor:.3g}.")
        return lines + [f"Not determined: {text}." for text in self.information.null_directions()]

    def _answer(self) -> str:
        """How many runs and hours, what they tell, and whether they keep their limits."""
        kept = {n: one.probability for n, one in self.assurances.items() if one.limited}
        words = f"{counted(len(self.runs), 'run')}, {self.hours:.3g} h"
        if self.unsafe:
            worst = min(self.unsafe, key=lambda name: kept[name])
            words = (
                f"DANGER: {worst!r} leaves its limits on {1 - kept[worst]:.0%} of possible "
                f"vehicles; {words}"
            )
        elif self.is_unsafe_together:
            words = (
                f"DANGER: on {1 - self.kept:.0%} of possible vehicles one run or another leaves "
                f"its limits; {words}"
            )
        words += f": {self._told()}"
        if self.standard is not None:
            ratio = self.standard.ratio
            words += (
                f"; standard trials would need {ratio:.2g} × the ship time"
                if np.isfinite(ratio)
                else "; standard trials would never tell as much"
            )
        if not kept:
            words += "; no limit on the motion was given"
        elif not self.unsafe:
            together = "all runs keep" if len(kept) > 1 else "the run keeps"
            words += f"; {together} the limits on {self.kept:.0%} of possible vehicles"
        return f"{words}."

    def _told(self) -> str:
        """What the programme was asked for, and how much of it is reached."""
        if self.misfits:
            (first, second), least = min(self.misfits.items(), key=lambda one: one[1])
            return (
                f"{first} and {second} are told apart with a probability of {told_apart(least):.0%}"
            )
        if self.chances:
            before = sum(one.before >= SURE for one in self.chances)
            after = sum(one.after >= SURE for one in self.chances)
            n = len(self.chances)
            return f"{after} of {n} effects would show, should they be missing (before: {before})"
        errors = self.relative_errors
        worst = int(errors.argmax())
        words = f"the least certain of {counted(len(errors), 'parameter')} is {self.names[worst]}, "
        if self.sea is not None and not errors[worst] <= TRUSTED:
            return words + "which stays unidentified"
        words += f"± {share(TWO_SIDED_95 * errors[worst])} (95 %)"
        if self.prior is not None:
            before = self.prior.std_errors[worst] / self.sizes[worst]
            known = f", ± {share(TWO_SIDED_95 * before)} before"
            words += known if np.isfinite(before) else ""
        return words

    def _compared(self) -> str:
        assert self.standard is not None
        trials = ", ".join(self.standard.names)
        if not np.isfinite(self.standard.hours):
            return f"The standard programme ({trials}) never tells as much."
        return (
            f"The standard programme ({trials}) needs {self.standard.hours:.3g} h for the same "
            f"criterion, {self.standard.ratio:.3g} times the ship time."
        )

    def accuracy(self) -> Table:
        """Expected relative standard errors of every parameter."""
        columns: dict[str, Sequence[str]] = {}
        if self.prior is not None:
            columns["before"] = [percent(e) for e in self.prior.std_errors / self.sizes]
        columns["after"] = [stated(error, self.sea) for error in self.relative_errors]
        if self.spread is not None:
            columns["other vehicles"] = [self.spread.words(name) for name in self.names]
        if self.standard is not None:
            errors = self.standard.errors
            columns["standard trials"] = [stated(errors[name], self.sea) for name in self.names]
        values = [f"{self.model.values[name]:.4g}" for name in self.names]
        rows = list(zip(self.names, values, *columns.values(), strict=True))
        return Table(("parameter", "value", *columns), rows)

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
