r"""The sea-trial card: one page of any run for the people who carry it out.

Orders merge a ramp within the actuator's rate into one line. An order has the side to which the
vehicle answers it: of the yaw and pitch rates :math:`r, q` along the run the one that follows the
command :math:`\delta` most closely,

.. math:: \rho = \frac{\sum_k (\delta_k - \delta_0)\, q_k}
    {\sqrt{\sum_k (\delta_k - \delta_0)^2 \sum_k q_k^2}}

with the sign of :math:`\rho`. Angles of orders are whole degrees, as people give them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from math import degrees
from textwrap import wrap

import numpy as np

from oed_sysid.design.assurance import Assurance, PredictedTracks
from oed_sysid.design.criteria import SAYS
from oed_sysid.design.vehicles import between, outside, quantity, span, units_of
from oed_sysid.errors import listed
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.simulation import Trajectory, trajectory_of
from oed_sysid.information.noise import bearing, sea_words
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Figure, Report, Section, Table

# Characters of a line of a printed card: A4 in a readable type.
WIDTH = 92
# Time that people need from one order to the next, s; quicker runs are for an autopilot.
BY_HAND = 10.0
# To which side a vehicle turns under a command, by the rate that follows it.
_SIDES = {"r": ("to port", "to starboard"), "q": ("bow down", "bow up")}


@dataclass(frozen=True, eq=False)
class TrialCard:
    """What the people on board need of one run.

    Attributes
    ----------
    model : Model
        The nominal vehicle.
    experiment : Experiment
    trajectory : Trajectory
        What the model does in it.
    assurance : Assurance or None
        How surely other vehicles keep the limits, and when to stop.
    sea : NoiseModel or None
        Disturbance forces that are expected.
    active : tuple of str
        Limits that are reached in the prediction, in words.
    told : tuple of Section
        What the run will tell.
    length : float or None
        Of the vehicle, m: the sea room is told in lengths, too.

    Examples
    --------
    ``design.sea_trial_card()`` writes one; see :func:`~oed_sysid.design.design_experiment`.
    """

    model: Model
    experiment: Experiment
    trajectory: Trajectory
    assurance: Assurance | None = None
    sea: NoiseModel | None = None
    active: Sequence[str] = ()
    told: Sequence[Section] = ()
    length: float | None = None

    @classmethod
    def of(
        cls,
        model: Model,
        experiment: Experiment,
        assurance: Assurance | None = None,
        sea: NoiseModel | None = None,
    ) -> TrialCard:
        """Return the card of any run; one that reacts closes its loop on the model."""
        run = trajectory_of(model, replace(experiment, limits=Limits()))
        return cls(model, experiment, run, assurance, sea)

    @cached_property
    def _units(self) -> dict[str, str]:
        return units_of(self.model)

    @property
    def warnings(self) -> list[str]:
        """What stands first where limits are likely to be left."""
        return [] if self.assurance is None else [*filter(None, [self.assurance.danger])]

    def text(self) -> str:
        """Return one page of text."""
        return "\n".join(folded(self.document().text().split("\n")))

    @property
    def tracks(self) -> PredictedTracks | None:
        """Where the run goes, where that is known."""
        found = None if self.assurance is None else self.assurance.tracks
        return None if found is None else replace(found, length=self.length)

    def document(self, *, title: str = "") -> Report:
        """Return the card as a page: danger first, then what to run and where it goes."""
        run, safe, tracks = self.experiment, self.assurance, self.tracks
        drawings = [Figure("plot_orders", self, "Orders over time.", size=(7.2, 2.6))]
        room = [] if tracks is None else tracks.words()
        if tracks is not None:
            caption = f"Where the run goes: {'; '.join(room)}."
            drawings.append(Figure("plot_tracks", tracks, caption, size=(5.4, 4.6)))
        return Report(
            title=title or self.model.name,
            subtitle=f"Sea-trial card of {run.name!r}",
            headline=f"SEA TRIAL CARD   {run.name}   ({self.model.name})",
            warnings=self.warnings,
            head=tuple(self._conditions()),
            numbers=(
                ("length", f"{run.duration:g} s"),
                ("limits kept", "-" if safe is None else f"{safe.probability:.1%}"),
                ("stopped", "-" if safe is None else f"{safe.any_fires:.1%}"),
            ),
            sections=(
                self._orders(),
                self._motion(),
                Section("WATCH", self._watch(), heading=True, indent=2),
                self._aborts(),
                Section("SEA ROOM", room, heading=True, indent=2),
                *self.told,
                self._record(),
                Section("Orders and track", figures=drawings, only="page"),
            ),
        )

    def _conditions(self) -> Iterable[tuple[str, str]]:
        """How long, from where, what is held, and within which range orders stay."""
        run, model, units = self.experiment, self.model, self._units
        yield (
            "length",
            f"{run.duration:g} s ({run.times[-1] / 60:.1f} min), one run; log every "
            f"{run.sample_time:g} s or faster, commands and measurements on one clock",
        )
        yield (
            "start from",
            f"{', '.join(self._start()) or 'rest'}; controls at trim, steady; log 10 s or more "
            "before the first order and after the last",
        )
        for name, value in run.constants.items():
            yield "hold", f"{name} = {quantity(value, units[name])}"
        for name in (name for name in run.limits.inputs if name not in run.constants):
            yield "orders of", self._range(name)
        levels = [f"{o.name} {quantity(o.noise_std, o.unit)}" for o in model.outputs if o.noise_std]
        yield "noise assumed", listed(levels)
        if self.sea is not None:
            yield from _at_sea(self.sea)

    def _record(self) -> Section:
        """What people write beside the log; of a ship also where standards apply to her."""
        rows = [tuple(row) for row in SAYS["record"]]
        words = [SAYS["standard_conditions"]] if "z" not in self.model.state_names else []
        title = "WRITE DOWN (ITTC 7.5-04-02-01)"
        return Section(title, words, (Table(("", ""), rows, words=(0, 1)),), heading=True, indent=2)

    def _range(self, name: str) -> str:
        """Range and rate of the orders of an input."""
        limits, unit = self.experiment.limits, self._units[name]
        rate = limits.rates.get(name)
        most = "" if rate is None else f", at most {quantity(rate, unit)}/s"
        return f"{name}: {span(*limits.inputs[name], unit)}{most}"

    def _start(self) -> list[str]:
        """State at the start, for a vehicle with velocities led by its speed in knots."""
        first = self.experiment.initial
        given = [f"{name} = {quantity(value, self._units[name])}" for name, value in first.items()]
        speed = float(np.linalg.norm([first.get(axis, 0.0) for axis in "uvw"]))
        if "u" not in self.model.state_names:
            # A speed that the equations hold constant is a fixed number in m/s.
            held = [one.value for one in self.model.parameters if one.fixed and one.unit == "m/s"]
            if len(held) != 1:
                return given
            speed = held[0]
        # A knot is 1852 m/h.
        return [f"speed {speed * 3600 / 1852:.3g} knots" if speed else "rest (no speed)", *given]

    def _orders(self) -> Section:
        """When each order begins, where it leads, and when it is reached; or the law of the run."""
        run, times = self.experiment, self.trajectory.times
        if run.reacts and run.excitation is not None:
            return Section("RUN", [run.excitation.describe()], heading=True, indent=2)
        found = sorted(one for name in self.model.input_names for one in self._ordered(name))
        if not found:
            words = ["no orders: leave all controls as they are"]
            return Section("RUN", words, heading=True, indent=2)
        begun = np.unique([begin for begin, _, _ in found])
        quick = float(np.diff(begun).min(initial=np.inf)) < BY_HAND
        rows = [(f"{begin:.6g}", order, f"{end:.6g}") for begin, end, order in found]
        rows.append((f"{times[-1]:.6g}", "end of the run: controls at trim, recover", ""))
        table = Table(("at t [s]", "order", "reached [s]"), rows, words=(1,))
        by = "AUTOPILOT ONLY, orders come within 10 s: " if quick else "By hand, or better: "
        words = [f"{by}play the table of commands."]
        return Section("RUN", words, (table,), heading=True, indent=2)

    def _ordered(self, name: str) -> Iterator[tuple[float, float, str]]:
        """When each order of an input begins, when it is reached, and what it is."""
        times, said = self.trajectory.times, ""
        way = np.sign(np.diff(self.trajectory.inputs[:, self.model.input_names.index(name)]))
        # A ramp within the rate limit is one order, not one for every sample.
        begins = np.flatnonzero(np.diff(way, prepend=0.0))
        for first, after in pairwise([*begins, len(way)]):
            # What reads as the order before, in whole degrees, is none.
            if way[first] and (order := self._order(name, after)) != said:
                yield times[first + 1], times[after], order
                said = order

    def _order(self, name: str, sample: int) -> str:
        """An order in words; an angle in whole degrees with the side that the vehicle goes to."""
        unit, run = self._units[name], self.trajectory
        command = run.inputs[:, self.model.input_names.index(name)]
        if unit != "rad":
            return f"{name} to {quantity(command[sample], unit)}"
        moved, answers = command - command[0], dict.fromkeys(_SIDES, 0.0)
        for rate in {*_SIDES} & {*run.state_names}:
            other = run.signal(rate)
            size = float(np.linalg.norm(moved) * np.linalg.norm(other))
            answers[rate] = float(moved @ other) / size if size else 0.0
        rate = max(answers, key=lambda one: abs(answers[one]))
        angle = round(degrees(command[sample]))
        if not (angle and answers[rate]):
            return f"{name} to {angle} deg"
        return f"{name} to {abs(angle)} deg {_SIDES[rate][angle * answers[rate] > 0]}"

    def _motion(self) -> Section:
        """Predicted ranges, what other vehicles would do, and limits."""
        model, safe = self.model, self.assurance
        rows = []
        for name in dict.fromkeys((*model.state_names, *model.output_names)):
            values, unit = self.trajectory.signal(name), self._units[name]
            other = None if safe is None else safe.ranges.get(name)
            limit = self.experiment.limits.signals.get(name)
            said = "-" if other is None else between(*other, unit)
            ends = "" if limit is None else span(*limit, unit)
            rows.append((name, between(values.min(), values.max(), unit), said, ends))
        table = Table(("", "predicted", "95 % of vehicles", "limit"), rows, words=(1, 2, 3))
        drawn = [] if safe is None else [f"vehicles: {safe.drawn}, {safe.n_checked} simulated"]
        return Section("EXPECT", drawn, (table,), heading=True, indent=2)

    def _watch(self) -> list[str]:
        """What is reached, how surely limits are kept, and when to stop."""
        limits, safe = self.experiment.limits.signals, self.assurance
        words = [] if limits else [SAYS["no_limit_given"]]
        if safe is not None and limits:
            words += [f"Certainty: {safe.report()}."]
            words += [] if safe.is_safe else [SAYS["not_safe"]]
        words += [f"reached in the prediction: {text}" for text in self.active]
        return [*words, SAYS["stop"]] if limits else words

    def _aborts(self) -> Section:
        """Where the crew stops, and how often that happens."""
        safe = self.assurance
        title = "STOP THE RUN (controls at trim, recover) when"
        if safe is None or not safe.rules:
            return Section(title)
        rows = [
            (rule.signal, outside(rule.lower, rule.upper, self._units[rule.signal]),
             "before its limit" if rule.limited else "outside what is expected",
             f"{rule.fires:.1%}")
            for rule in safe.rules
        ]  # fmt: skip
        table = Table(("signal", "is", "", "fires on"), rows, words=(1, 2))
        words = [f"Any of these fires on {safe.any_fires:.1%} of {safe.n_checked} vehicles."]
        return Section(title, words, (table,), heading=True, indent=2)


def _at_sea(sea: NoiseModel) -> Iterable[tuple[str, str]]:
    """What the sea of a run asks for, and is."""
    for one in sea.seas:
        if one.direction is not None:
            yield "run heading", f"begin with the swell from {bearing(one.direction)}"
    yield "disturbance forces", sea_words(sea)


def folded(lines: Sequence[str]) -> list[str]:
    """Lines of a card at most :data:`WIDTH` characters long."""
    found = []
    for line in lines:
        margin = " " * (len(line) - len(line.lstrip()) + 2)
        found += wrap(line, WIDTH, subsequent_indent=margin) if len(line) > WIDTH else [line]
    return found
