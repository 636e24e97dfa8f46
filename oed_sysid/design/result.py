r"""What is designed: a run or a programme of runs, what it will tell, what it respects.

Accuracy is the bound :math:`s_i = \sqrt{[F^{-1}]_{ii}}` of the information after the runs, prior
knowledge included, as a share :math:`s_i / |\theta_i|` of the values; "times smaller than a
zigzag's" is the ratio of the geometric means

.. math:: \exp \frac1n \sum_i \log \frac{s_i^{zigzag}}{s_i}

On the sea-trial card orders merge a ramp within the actuator's rate into one line.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from textwrap import wrap

import numpy as np

from oed_sysid.data.dataset import Record
from oed_sysid.design.assurance import TRUSTED, AccuracyRange, Assurance, PredictedTracks, stated
from oed_sysid.design.criteria import SURE, Detection, missing_physics, told_apart
from oed_sysid.design.library import Candidate, Reference
from oed_sysid.design.vehicles import between, outside, percent, quantity, span, units_of
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import Trajectory, simulate
from oed_sysid.information.noise import sea_words
from oed_sysid.information.ranking import POOR
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
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
from oed_sysid.runtime.files import make_folder
from oed_sysid.text.csv_table import write_table

# Characters of a line of a printed card: A4 in a readable type.
WIDTH = 92
# Relative error up to which a coefficient counts as found.
_GOOD = 0.05
STAND_BY = "Stand by to stop, or begin with a gentle run and plan from its fit."
NO_LIMIT = (
    "NO LIMIT on the motion was given. Compare the ranges above with what depth, attitude and sea "
    "room allow; in doubt design anew with limits (such as --max-pitch 20)."
)
NOT_SAFE = (
    "That is NOT safe unless the coefficients are known better: stand by to stop, fly a gentler "
    "run first, or design with --certainty 0.95."
)
STOP = (
    "Stop when a limit is passed: controls neutral, recover, keep the log. Part of a run is useful."
)


class _Accuracy:
    """What a designed run and a designed programme say of accuracy alike."""

    model: Model
    information: Information
    prior: Information | None
    sea: NoiseModel | None
    spread: AccuracyRange | None

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


def write_commands(
    path: Path, model: Model, run: Trajectory | Record | Experiment, *, predicted: bool = False
) -> Path:
    """Write the commands of a run, and its outputs where wanted, with units in the header."""
    made = simulate(model, run, noise=False) if isinstance(run, Experiment) else run
    columns = {"t [s]": made.times}
    channels: list[Input | Output] = [*model.inputs, *(model.outputs if predicted else ())]
    for channel, values in zip(channels, np.hstack([made.inputs, made.outputs]).T, strict=False):
        columns[f"{channel.name} [{channel.unit or '-'}]"] = values
    write_table(path, list(columns), np.column_stack(list(columns.values())))
    return path


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

    _repr_html_ = as_html

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
            warnings=self._warnings(),
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
                Section("Missing physics", listing=told),
                Section("Sea-trial card", listing=self.sea_trial_card(), only="page"),
            ),
        )  # fmt: skip

    report = as_text

    def _warnings(self) -> list[str]:
        return [] if self.assurance is None else [*filter(None, [self.assurance.danger])]

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
        return lines + self._undetermined()

    def accuracy(self, *, sort: bool = False) -> Table:
        """Expected relative standard errors; sorted, the best first."""
        others = {one.name: one.information.std_errors / self.sizes for one in self.references}
        table = self._table("this run", others)
        if not sort:
            return table
        return replace(table, rows=[table.rows[i] for i in np.argsort(self.relative_errors)])

    def card(self, tracks: PredictedTracks | None = None, *, title: str = "") -> Report:
        """Return the sea-trial card as a page: danger first, then what to run and where it goes.

        Parameters
        ----------
        tracks : PredictedTracks, optional
            From :func:`~oed_sysid.design.predicted_tracks`.
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
            warnings=self._warnings(),
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
        experiment, model, units = self.experiment, self.model, units_of(self.model)
        if experiment.reacts and experiment.excitation is not None:
            orders = [f"  {experiment.excitation.describe()}"]
        else:
            orders = self._orders(units)
        dangers = [f"{danger} Read WATCH before anything else." for danger in self._warnings()]
        lines = wrap(" ".join(dangers), WIDTH)
        lines += [*self._conditions(units), "", "RUN", *orders, "", *self._motion(units)]
        lines += ["", "WATCH", *self._watch(units), "", *self._to_expect(), ""]
        if told := missing_physics(self.misfits, self.chances):
            lines += ["MISSING PHYSICS", *told, ""]
        stated = [
            (o.name, quantity(o.noise_std, o.unit))
            for o in model.outputs
            if o.noise_std is not None
        ]
        lines += wrap(f"Noise assumed: {', '.join(map(' '.join, stated))}.", WIDTH)
        if self.sea is not None:
            lines += wrap(f"Disturbance forces assumed: {sea_words(self.sea)}.", WIDTH)
        last = (
            "Write down wind, sea, current, loading, battery, and anything touched during the run."
        )
        return "\n".join([*lines, last])

    def _conditions(self, units: Mapping[str, str]) -> list[str]:
        """How long, from where, what is held, and within which range orders stay."""
        experiment, model = self.experiment, self.model
        duration = float(experiment.duration or 0.0)
        given = [f"{n} = {quantity(v, units[n])}" for n, v in experiment.initial.items() if v]
        speeds = [s.name for s in model.states if s.name in ("u", "v", "w")]
        if speeds and not any(experiment.initial.get(n, 0.0) for n in speeds):
            given.insert(0, "rest (no speed)")
        lines = [
            f"SEA TRIAL CARD   {experiment.name}   ({model.name})",
            "=" * WIDTH,
            f"Length      {duration:g} s ({duration / 60:.1f} min), one run; log every "
            f"{experiment.sample_time:g} s or faster, commands and measurements on one clock",
            f"Start from  {', '.join(given) or 'rest'}; controls neutral, steady",
            "            log 10 s or more before the first order and after the last",
        ]
        if held := [f"{n} = {quantity(v, units[n])}" for n, v in experiment.constants.items()]:
            lines.append(f"Hold        {', '.join(held)}")
        for name, pair in experiment.limits.inputs.items():
            if name not in experiment.constants:
                rate = experiment.limits.rates.get(name)
                most = "" if rate is None else f", at most {quantity(rate, units[name])}/s"
                lines.append(f"Orders of   {name}: {span(*pair, units[name])}{most}")
        return lines

    def _orders(self, units: Mapping[str, str]) -> list[str]:
        """Orders as rows: when each begins, where it leads, and when it is reached."""
        times, inputs = self.trajectory.times, self.trajectory.inputs
        found = []
        for index, name in enumerate(self.model.input_names):
            way = np.sign(np.diff(inputs[:, index]))
            # A ramp within the rate limit is one order, not one for every sample.
            begins = np.flatnonzero(np.diff(way, prepend=0.0))
            for first, after in zip(begins, [*begins[1:], len(way)], strict=True):
                if way[first]:
                    found.append((first + 1, after, name, inputs[after, index]))
        if not found:
            return ["  no orders: leave all controls as they are"]
        lines = [f"  {'at t [s]':>8}  {'order':<26} {'reached [s]':>11}"]
        for first, last, name, value in sorted(found)[:40]:
            order = f"{name} to {quantity(value, units[name])}"
            lines.append(f"  {times[first]:>8.6g}  {order:<26} {times[last]:>11.6g}")
        if len(found) > 40:
            lines.append(f"  ... and {len(found) - 40} more")
        lines.append(f"  {times[-1]:>8.6g}  end of the run: controls neutral, recover")
        return [*lines, "  By hand: these orders. Better: play the table that --out writes."]

    def _motion(self, units: Mapping[str, str]) -> list[str]:
        """Predicted ranges, what other vehicles would do, and where to stop."""
        model, safe = self.model, self.assurance
        rows = [("", "predicted", "95 % of vehicles", "stop outside")]
        for name in dict.fromkeys((*model.state_names, *model.output_names)):
            values, unit = self.trajectory.signal(name), units[name]
            other = None if safe is None else safe.ranges.get(name)
            limit = self.experiment.limits.signals.get(name)
            said = "-" if other is None else between(*other, unit)
            stop = "" if limit is None else span(*limit, unit)
            rows.append((name, between(values.min(), values.max(), unit), said, stop))
        lines = ["EXPECT"]
        for name, own, theirs, stop in rows:
            vehicles = "" if safe is None else f" {theirs:<24}"
            lines.append(f"  {name:<10} {own:<24}{vehicles} {stop}".rstrip())
        if safe is not None:
            lines.append(f"  95 % of vehicles: {safe.drawn}, {safe.n_checked} simulated")
        return lines

    def _watch(self, units: Mapping[str, str]) -> list[str]:
        """What is reached, how surely limits are kept, and when to stop."""
        limits, safe = self.experiment.limits.signals, self.assurance
        words = [] if limits else [NO_LIMIT]
        if safe is not None and limits:
            words += [f"Certainty: {safe.report()}.", *([] if safe.is_safe else [NOT_SAFE])]
        words += [f"reached in the prediction: {text}" for text in self.active]
        words += [] if self.active else ["no limit is reached in the prediction"]
        words += [STOP] if limits else []
        lines = []
        for text in words:
            lines += wrap(text, WIDTH - 4, initial_indent="  - ", subsequent_indent="    ")
        if safe is None or not safe.rules:
            return lines
        lines += ["", "STOP THE RUN (controls neutral, recover) when"]
        for rule in safe.rules:
            bounds = outside(rule.lower, rule.upper, units[rule.signal])
            why = "before its limit" if rule.limited else "outside what is expected"
            lines.append(f"  {rule.signal:<8} {bounds:<36} {why}; fires on {rule.fires:.1%}")
        any_fires = f"  Any of these fires on {safe.any_fires:.1%} of {safe.n_checked} vehicles."
        return [*lines, any_fires]

    def _to_expect(self) -> list[str]:
        """Accuracy against standard manoeuvres, and which parameters will be found."""
        kind = "white noise" if self.sea is None else "noise and disturbance forces"
        lines = [f"ACCURACY TO EXPECT (standard error / value; {kind} as below)"]
        for reference in self.references:
            mean, worst = self.gain(reference)
            note = f", {reference.note}" if reference.note else ""
            lines.append(
                f"  Against a {reference.name}{note}, equally long: errors {mean:.2g} times "
                f"smaller on geometric mean, {worst:.2g} times for the worst."
            )
        lines += [f"  {line}" for line in self.accuracy(sort=True).lines()]
        usable = POOR if self.sea is None else TRUSTED
        for title, low, high in (
            (f"Found to {_GOOD:.0%} or better", 0.0, _GOOD),
            (f"Found to {usable:.0%}", _GOOD, usable),
            ("NOT found by this run; hold at nominal values, or add runs", usable, np.inf),
        ):
            inside = (low < self.relative_errors) & (self.relative_errors <= high)
            if names := [name for name, found in zip(self.names, inside, strict=True) if found]:
                text = f"{title}: {', '.join(names)}"
                lines += wrap(text, WIDTH, initial_indent="  ", subsequent_indent="    ")
        return lines

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
        write_commands(Path(path), self.model, self.trajectory, predicted=predicted)


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

    def words(self) -> str:
        """How long they take, in a sentence."""
        trials = ", ".join(self.names)
        if not np.isfinite(self.hours):
            return f"The standard programme ({trials}) never tells as much."
        return (
            f"The standard programme ({trials}) needs {self.hours:.3g} h for the same criterion, "
            f"{self.ratio:.3g} times the ship time."
        )


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
    chances : tuple of Detection
        For effects to be detected: how surely each would show.
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
    chances: tuple[Detection, ...] = ()

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
        found = self.assurances.items()
        return tuple(name for name, one in found if one.limited and not one.is_enough)

    @property
    def is_unsafe_together(self) -> bool:
        """Whether one run or another leaves its limits on more vehicles than wanted."""
        wanted = [one.wanted for one in self.assurances.values() if one.limited and one.wanted]
        return bool(wanted) and self.kept < max(wanted)

    @property
    def danger(self) -> str:
        """What stands first where limits are likely to be left; empty where not."""
        if self.unsafe:
            worst = min(self.unsafe, key=lambda name: self.assurances[name].probability)
            left = 1 - self.assurances[worst].probability
            return f"DANGER: {worst!r} leaves its limits on {left:.0%} of possible vehicles"
        if self.is_unsafe_together:
            left = 1 - self.kept
            return (
                f"DANGER: on {left:.0%} of possible vehicles one run or another leaves its limits"
            )
        return ""

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
        together = []
        if self.limited:
            checked = max(one.n_checked for one in self.assurances.values())
            together.append(f"all together keep them on {self.kept:.0%} of {checked} vehicles")
        worth = (
            f"Of what the best programme of these {len(self.candidates)} runs could tell, this "
            f"one tells {self.share:.1%} (criterion {self.criterion}; the weights are within "
            f"{max(self.gap, 0.0):.1g} of their optimum). Refined commands made it "
            f"{self.refined_factor:.3g} times as telling; greedy selection would reach "
            f"{self.greedy_share:.1%} of the selection before. The bound holds for these runs, "
            "these forces and a model of this structure; other commands may do better."
        )
        compared = [] if self.standard is None else wrap(self.standard.words(), WIDTH)
        for words, (_, factor) in self.sensor_options.items():
            compared.append(f"With optional sensors {words}: information times {factor:.3g}.")
        compared += self._undetermined()
        told = "\n".join(missing_physics(self.misfits, self.chances))
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
                Section("Missing physics", listing=told),
                Section("Compared", compared, indent=2),
            ),
        )

    report = as_text

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
            ratio = self.standard.ratio
            words += (
                f"; standard trials would need {ratio:.2g} × the ship time"
                if np.isfinite(ratio)
                else "; standard trials would never tell as much"
            )
        if not self.limited:
            words += "; no limit on the motion was given"
        elif not self.unsafe:
            n_limited = sum(one.limited for one in self.assurances.values())
            together = "all runs keep" if n_limited > 1 else "the run keeps"
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
        if self.sea is not None and not self.relative_errors.max() <= TRUSTED:
            return f"{self._least_certain()[0]}, which stays unidentified"
        before = self.prior_errors[int(self.relative_errors.argmax())]
        known = f", ± {share(TWO_SIDED_95 * before)} before" if np.isfinite(before) else ""
        return ", ".join(self._least_certain()) + known

    def accuracy(self) -> Table:
        """Expected relative standard errors of every parameter."""
        others = {}
        if self.standard is not None:
            errors = [self.standard.errors[name] for name in self.names]
            others["standard trials"] = np.array(errors)
        return self._table("after", others)

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
            word = "".join(c if c.isalnum() else "_" for c in run.name)
            path = place / f"{number:02d}_{word}.csv"
            written.append(write_commands(path, self.model, run.experiment))
        return tuple(written)
