r"""What is designed: a run or a programme of runs, what it will tell, what it respects.

Accuracy is the bound :math:`s_i = \sqrt{[F^{-1}]_{ii}}` of the information after the runs, prior
knowledge included, as a share :math:`s_i / |\theta_i|` of the values; "times smaller than a
zigzag's" is the ratio of the geometric means

.. math:: \exp \frac1n \sum_i \log \frac{s_i^{zigzag}}{s_i}
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from textwrap import wrap

import numpy as np

from oed_sysid.design.assurance import NO_LIMIT, TRUSTED, AccuracyRange, Assurance, stated
from oed_sysid.design.card import WIDTH, TrialCard
from oed_sysid.design.criteria import SAYS, Detection, missing_physics, shown, told_apart
from oed_sysid.design.library import Candidate, Reference
from oed_sysid.design.vehicles import percent
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import Trajectory
from oed_sysid.information.noise import sea_words
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import IMMATERIAL
from oed_sysid.runtime.display import (
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
from oed_sysid.runtime.files import make_folder, write_text
from oed_sysid.text.csv_table import write_table

STAND_BY = "Stand by to stop, or begin with a gentle run and plan from its fit."


class _Accuracy:
    """What a designed run and a designed programme say of accuracy alike."""

    model: Model
    information: Information
    prior: Information | None
    sea: NoiseModel | None
    spread: AccuracyRange | None

    report = as_text
    _repr_html_ = as_html

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
        """Expected standard errors as shares of the values, ``(n,)``."""
        return self.information.std_errors / self.sizes

    @property
    def prior_errors(self) -> np.ndarray:
        """The same before the experiment; infinite where nothing is known."""
        if self.prior is None:
            return np.full(len(self.names), np.inf)
        return self.prior.std_errors / self.sizes

    def _least_certain(self) -> tuple[str, str]:
        """The parameter known least, in words, and its accuracy."""
        errors = self.relative_errors
        worst = int(errors.argmax())
        least = f"the least certain of {counted(len(errors), 'parameter')} is {self.names[worst]}"
        return least, f"± {share(TWO_SIDED_95 * errors[worst])} (95 %)"

    def _undetermined(self) -> list[str]:
        return [f"Not determined: {text}." for text in self.information.null_directions()]

    def _table(self, title: str, others: Mapping[str, np.ndarray]) -> Table:
        """Expected relative errors: before, after, on other vehicles, of other runs."""
        columns: dict[str, Sequence[str]] = {}
        if np.isfinite(self.prior_errors).any():
            columns["before"] = [percent(error) for error in self.prior_errors]
        columns[title] = [stated(error, self.sea) for error in self.relative_errors]
        if self.spread is not None:
            columns["other vehicles"] = [self.spread.words(name) for name in self.names]
        for name, errors in others.items():
            columns[name] = [stated(error, self.sea) for error in errors]
        values = [f"{self.model.values[name]:.4g}" for name in self.names]
        rows = list(zip(self.names, values, *columns.values(), strict=True))
        return Table(("parameter", "value", *columns), rows)


def write_commands(path: Path, model: Model, run: Trajectory) -> Path:
    """Write the commands of a run, with units in the header."""
    headers = ["t [s]", *(f"{one.name} [{one.unit or '-'}]" for one in model.inputs)]
    write_table(path, headers, np.column_stack([run.times, run.inputs]))
    return path


def write_run(path: Path, card: TrialCard) -> tuple[Path, Path]:
    """Write the commands of a run, and its card beside them."""
    table = write_commands(path, card.model, card.trajectory)
    page = path.with_suffix(".txt")
    write_text(page, card.text() + "\n")
    return table, page


@dataclass(frozen=True, eq=False)
class Design(_Accuracy):
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
        Disturbance forces and coloured sensors that the accuracy takes into account; None
        where noise is white.
    spread : AccuracyRange or None
        Accuracy on other vehicles that are possible, if asked for.
    chances : tuple of Detection
        For :class:`~oed_sysid.design.Detect`: how surely each candidate effect would show.

    Examples
    --------
    What :func:`~oed_sysid.design.design_experiment` returns; see there.
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
    chances: tuple[Detection, ...] = ()

    def __repr__(self) -> str:
        worst = int(np.argmax(self.relative_errors))
        return (
            f"<Design {self.experiment.name!r} for {self.model.name!r}: "
            f"{self.experiment.duration:g} s, {self.names[worst]} least certain, "
            f"± {share(TWO_SIDED_95 * self.relative_errors[worst])} (95 %)>"
        )

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

    def document(self, *, title: str = "") -> Report:
        """Return what the design will tell, commands, motion and the sea-trial card."""
        errors, safe = self.relative_errors, self.assurance
        best, worst = int(np.nanargmin(errors)), int(np.nanargmax(errors))
        drawing = Figure("figure_design", self, SAYS["design_drawn"])
        starts = ", ".join(f"{value:.4g}" for value in self.start_values)
        if safe and self.value < min(self.start_values, default=-np.inf):
            starts += "; gentler since, for vehicles that differ to keep the limits"
        length, every = self.experiment.duration, self.experiment.sample_time
        return Report(
            title=title or self.model.name,
            subtitle=f"Experiment {self.experiment.name!r}, criterion {self.criterion}",
            headline=f"Design of {self.experiment.name!r} for {self.model.name}",
            answer=self._answer(),
            warnings=self.card().warnings,
            head=(
                ("criterion", f"{self.criterion}: {self.value:.4g} (starts: {starts})"),
                ("family", self.parametrisation),
                ("run", f"{length:g} s, a sample every {every:g} s"),
                ("limits met", "; ".join(self.active) or "none is reached"),
                *([("certainty", safe.report())] if safe else []),
                ("effort", f"{self.n_evaluations} trajectories, {self.seconds:.1f} s"),
                *([("disturbance forces", sea_words(self.sea))] if self.sea is not None else []),
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
                missing_physics(self.misfits, self.chances),
                Section("Sea-trial card", listing=self.sea_trial_card(), only="page"),
            ),
        )  # fmt: skip

    def _answer(self) -> str:
        """What the run will tell, and whether it keeps its limits."""
        found = self.assurance
        words = "" if found is None or found.is_safe else "DANGER: "
        words += (
            f"{self.experiment.name}: after {self.experiment.duration:g} s "
            f"{', '.join(self._least_certain())}"
        )
        if self.references:
            reference = self.references[0]
            gain = self.gain(reference)[0]
            said = "reference_leaves" if np.isfinite(gain) else "reference_fails"
            words += SAYS[said].format(reference, gain=gain)
        if found is not None and found.limited:
            words += f"; limits kept on {found.probability:.0%} of possible vehicles"
        return f"{words}."

    def _remarks(self) -> list[str]:
        lines = []
        for reference in self.references:
            mean, worst = self.gain(reference)
            note = f" ({reference.note})" if reference.note else ""
            lines.append(SAYS["reference"].format(reference, note=note, mean=mean, worst=worst))
        return lines + self._undetermined()

    @property
    def others(self) -> dict[str, np.ndarray]:
        """Expected relative standard errors of standard manoeuvres, by name."""
        return {one.name: one.information.std_errors / self.sizes for one in self.references}

    def accuracy(self, *, sort: bool = False) -> Table:
        """Expected relative standard errors; sorted, the best first."""
        table = self._table("this run", self.others)
        if not sort:
            return table
        return replace(table, rows=[table.rows[i] for i in np.argsort(self.relative_errors)])

    def card(self, length: float | None = None) -> TrialCard:
        """Return what the people on board need, accuracy included.

        Parameters
        ----------
        length : float, optional
            Of the vehicle, m.
        """
        told = (self._to_expect(), missing_physics(self.misfits, self.chances))
        return TrialCard(
            self.model, self.experiment, self.trajectory, self.assurance, self.sea, self.active,
            told, length,
        )  # fmt: skip

    def sea_trial_card(self) -> str:
        """Return one page for the people who run the trial."""
        return self.card().text()

    def _to_expect(self) -> Section:
        """Accuracy beside standard manoeuvres, and which parameters will be found."""
        lines = self._remarks()
        for title, low, high in (
            (f"Found to {IMMATERIAL:.0%} or better", 0.0, IMMATERIAL),
            (f"Found to {TRUSTED:.0%}", IMMATERIAL, TRUSTED),
            ("NOT found by this run; hold at nominal values, or add runs", TRUSTED, np.inf),
        ):
            inside = (low < self.relative_errors) & (self.relative_errors <= high)
            if names := [name for name, found in zip(self.names, inside, strict=True) if found]:
                lines.append(f"{title}: {', '.join(names)}")
        title = "ACCURACY TO EXPECT (standard error / value)"
        return Section(title, lines, (self.accuracy(sort=True),), heading=True, indent=2)

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

    def write_csv(self, path: str | Path) -> None:
        """Write the commands as a table that an autopilot can play.

        Times in s, commands in SI units named in the header, one row per
        sample, each command to be held until the next row.

        Parameters
        ----------
        path : str or Path
            The file, overwritten if it exists.
        """
        write_commands(Path(path), self.model, self.trajectory)


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

    Examples
    --------
    >>> Standard(("zigzag_20_20",), 9.0, 3.0, {"K": 0.02}).hours
    9.0
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

    def words(self) -> str:
        """How long they take, in a sentence."""
        said = "standard_takes" if np.isfinite(self.hours) else "standard_never"
        return str(SAYS[said].format(self, trials=", ".join(self.names)))


@dataclass(frozen=True, eq=False)
class Programme(_Accuracy):
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
    chances : tuple of Detection
        For effects to be detected: how surely each would show.

    Examples
    --------
    What :func:`~oed_sysid.design.design_programme` returns; see there.
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
    chances: tuple[Detection, ...] = ()

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

    @cached_property
    def together(self) -> Assurance:
        """How surely all runs keep their limits."""
        return Assurance.joint(self.assurances.values())

    @property
    def limited(self) -> bool:
        """Whether there is any limit on the motion."""
        return self.together.limited

    @property
    def kept(self) -> float:
        """Share of the simulated vehicles on which all runs keep their limits."""
        return self.together.probability

    @property
    def unsafe(self) -> tuple[str, ...]:
        """Runs that leave their limits on more vehicles than wanted."""
        found = self.assurances.items()
        return tuple(name for name, one in found if one.limited and not one.is_enough)

    @property
    def danger(self) -> str:
        """What stands first where limits are likely to be left; empty where not."""
        if self.unsafe:
            worst = min(self.unsafe, key=lambda name: self.assurances[name].probability)
            left = 1 - self.assurances[worst].probability
            return str(SAYS["run_unsafe"].format(name=worst, left=left))
        kept = self.together.is_enough
        return "" if kept else SAYS["programme_unsafe"].format(left=1 - self.kept)

    def document(self, *, title: str = "") -> Report:
        """Return the programme: danger first, then runs, accuracy and certificate."""
        errors = self.relative_errors
        worst = int(errors.argmax())
        drawing = Figure("figure_programme", self, SAYS["programme_drawn"])
        together = []
        if self.limited:
            checked = self.together.n_checked
            together.append(f"all together keep them on {self.kept:.0%} of {checked} vehicles")
        worth = SAYS["worth"].format(self, n=len(self.candidates), gap=max(self.gap, 0.0))
        compared = [] if self.standard is None else wrap(self.standard.words(), WIDTH)
        for words, (_, factor) in self.sensor_options.items():
            compared.append(f"With optional sensors {words}: information times {factor:.3g}.")
        compared += self._undetermined()
        return Report(
            title=title or self.model.name,
            subtitle=f"Programme, criterion {self.criterion}",
            headline=f"Programme for {self.model.name}: {len(self.runs)} runs, {self.hours:.3g} h "
            f"with {self.turnaround / 60:.3g} min between runs",
            answer=self._answer(),
            warnings=[f"{self.danger}. {STAND_BY}"] if self.danger else [],
            head=(
                ("disturbance forces", "none" if self.sea is None else sea_words(self.sea)),
                ("measured", ", ".join(self.outputs)),
            ),
            numbers=(
                ("runs", str(len(self.runs))),
                ("time", f"{self.hours:.3g} h"),
                (f"std. error, worst: {self.names[worst]}", f"{100 * errors[worst]:.2g} %"),
            ),
            sections=(
                Section("What to run", together, (self._plan(),), (drawing,), indent=2),
                Section("Accuracy to expect", (), (self.accuracy(),), indent=2),
                Section("What this is worth", wrap(worth, WIDTH), indent=2),
                missing_physics(self.misfits, self.chances),
                Section("Compared", compared, indent=2),
            ),
        )

    def _plan(self) -> Table:
        rows = []
        for number, run in enumerate(self.runs, start=1):
            kept = self.assurances.get(run.name)
            probability = "-" if kept is None or not kept.limited else f"{kept.probability:.0%}"
            length = f"{float(run.experiment.duration or 0.0):g} s"
            rows.append((str(number), run.name, length, probability))
        marked = tuple(i for i, run in enumerate(self.runs) if run.name in self.unsafe)
        return Table(("", "run", "length", "limits kept"), rows, words=(1,), marked=marked)

    def _answer(self) -> str:
        """How many runs and hours, what they tell, and whether they keep their limits."""
        words = f"{self.danger}; " if self.danger else ""
        words += f"{counted(len(self.runs), 'run')}, {self.hours:.3g} h: {self._told()}"
        if self.standard is not None:
            said = "trials_need" if np.isfinite(self.standard.ratio) else "trials_fail"
            words += SAYS[said].format(self.standard)
        if not self.limited:
            words += f"; {NO_LIMIT}"
        elif not self.unsafe:
            n_limited = sum(one.limited for one in self.assurances.values())
            together = "all runs keep" if n_limited > 1 else "the run keeps"
            words += f"; {together} the limits on {self.kept:.0%} of possible vehicles"
        return f"{words}."

    def _told(self) -> str:
        """What the programme was asked for, and how much of it is reached."""
        if self.misfits:
            (first, second), least = min(self.misfits.items(), key=lambda one: one[1])
            return str(SAYS["apart"].format(first, second, chance=told_apart(least)))
        if self.chances:
            (n_before, n), n_all = shown(self.chances), len(self.chances)
            return f"{n} of {n_all} effects would show, should they be missing (before: {n_before})"
        if self.sea is not None and not self.relative_errors.max() <= TRUSTED:
            return f"{self._least_certain()[0]}, which stays unidentified"
        before = self.prior_errors[int(self.relative_errors.argmax())]
        known = f", ± {share(TWO_SIDED_95 * before)} before" if np.isfinite(before) else ""
        return ", ".join(self._least_certain()) + known

    @property
    def others(self) -> dict[str, np.ndarray]:
        """Expected relative standard errors of standard trials of the same time."""
        if self.standard is None:
            return {}
        return {"standard trials": np.array([self.standard.errors[name] for name in self.names])}

    def accuracy(self) -> Table:
        """Expected relative standard errors of every parameter."""
        return self._table("after", self.others)

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
        """Write the commands and the card of every run, numbered in order.

        Times in s, commands in SI units named in the header, each to be held until the next
        row; of a run that is closed over the vehicle, what the nominal one would command.

        Parameters
        ----------
        folder : str or Path
            Made if it is missing.

        Returns
        -------
        tuple of Path
            Tables, and the sea-trial card of each beside it.
        """
        place = make_folder(folder)
        written: list[Path] = []
        for number, run in enumerate(self.runs, start=1):
            word = "".join(c if c.isalnum() else "_" for c in run.name)
            path = place / f"{number:02d}_{word}.csv"
            safe = self.assurances.get(run.name)
            written += write_run(path, TrialCard.of(self.model, run.experiment, safe, self.sea))
        return tuple(written)
