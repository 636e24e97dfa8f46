"""The result of an estimation: values that are never without their uncertainty."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood.archive import (
    check_fit,
    dataclasses_of,
    decode_result,
    encode,
    made_by,
    write_result,
)
from oed_sysid.likelihood.departures import CLEARLY
from oed_sysid.likelihood.disturbances import places
from oed_sysid.likelihood.estimate import (
    ActuatorStart,
    Attempts,
    CaptiveErrors,
    Delay,
    Estimate,
    Posterior,
    ProcessNoiseTest,
    checked_scatter,
)
from oed_sysid.likelihood.judgement import Concern, grave, judge
from oed_sysid.likelihood.prediction import Initial, Prediction, predict
from oed_sysid.likelihood.whole_runs import WholeRuns, judged_runs
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
    digits,
    interval,
    rounded,
    share,
)
from oed_sysid.text.units import shown_unit

# Multiple of the noise from which residuals are no measure: filtered logs have next to no noise.
SMOOTHED = 100.0
# Correlation of two estimates from which on they can hardly be told apart.
ALIKE = 0.95
# Records that a page draws, and correlated pairs that are named.
MOST_DRAWN, MOST_PAIRS = 8, 6


@dataclass(frozen=True, eq=False)
class Fit(Estimate):
    """Estimated parameters with uncertainty, residuals and a status that advises.

    Attributes
    ----------
    model : Model
        The model at the estimated values.
    dataset : Dataset
        What it was fitted to.
    estimator : str
        Name and settings of the estimator.
    names : tuple of str
        Estimated parameters.
    estimates : ndarray (n_free,)
        Their values.
    information : Information
        Of the estimated parameters, initial states eliminated, as if the
        residuals were white.
    covariance : ndarray (n_free, n_free)
        The covariance that is reported: the inverse information, or the
        sandwich covariance where residuals are coloured.
    coloured : bool
        Whether the sandwich is in use.
    sigma : ndarray (n_outputs,)
        Noise standard deviations, given or estimated.
    sigma_estimated : ndarray of bool (n_outputs,)
        Which of them were estimated.
    predictions, residuals : tuple of ndarray (n_times, n_outputs)
        Model outputs, and measured minus model, per record.
    states : tuple of ndarray (n_times, n_full)
        State trajectories, per record.
    initial_states : tuple of ndarray (n_own,)
        Estimated initial states, per record.
    local_values : tuple of mapping
        Values of per-record parameters, per record.
    cost : float
        Half the sum of squares of the one-step errors in units of their standard
        deviation, priors included.
    status : Status
        How the estimation ended.
    iterations : int
    seconds : float
    noise : NoiseModel
        All that is random: white levels as in ``sigma``, colour, disturbance forces.
    noise_std : mapping
        Standard errors of the estimated levels and times, by ``(name, "level" or "time")``;
        of levels relative.
    innovations, innovation_std : tuple of ndarray (n_times, n_outputs), or None
        One-step prediction errors of the filter and their standard deviations, per
        record, where the noise is not white; else None and ``residuals`` say the same.
    start_states : tuple of mapping
        Start states that were not free, per record: value and standard error, zero
        where the state was held. Empty where all were free.
    record_scatter : RecordScatter, or None
        How the estimates scatter between records, to first order; None for fewer than four, or
        where the estimator does not tell. :attr:`record_errors` and :meth:`record_interval` are
        of it.
    sources : Sources, or None
        What priors and each record say of the shared parameters, apart from one another; None
        where the estimator does not tell. See :mod:`oed_sysid.likelihood.between_records`.
    nominal : mapping of str to float
        Start values of the estimated parameters; empty where the estimator does not tell.
    excluded : mapping of str to pair of int
        Samples that were left out as spikes, of how many, by output.
    process_noise : ProcessNoiseTest, or None
        What the fit to white noise said of process noise; None where it was not tested for.
    tests_scatter : bool
        Whether independent tests scatter more than their noise, so that their part of the
        standard errors is from their residuals.
    captive : CaptiveErrors, or None
        Errors of captive tests that were fitted along.
    horizon : float, or None
        Seconds ahead that the fit predicts, in ``n_windows`` windows; None for whole records.
    n_windows : int
    attempts : Attempts, or None
        Where all starts ended; None where there was one.
    posterior : Posterior, or None
        Draws of a sampler.
    purpose : str
        ``"derivatives"``, or ``"replay"`` of one that
        :func:`~oed_sysid.likelihood.replay.replayed` has made for runs of a model that lacks
        physics.
    binding : tuple of Binding
        Bounds and constraints at which it ends, the farthest exceeded first.
    extras : mapping
        What else an estimator tells of its way, such as the course of a recursion. Nothing in the
        package is decided by it.
    """

    @classmethod
    def of_saved(cls, **content: Any) -> Fit:
        """Build a fit of the fields of a file; of version 0.1 some were told in ``extras``."""
        return cls(**_typed(content))

    @cached_property
    def concerns(self) -> tuple[Concern, ...]:
        """What speaks against the fit; see :mod:`oed_sysid.likelihood.judgement`."""
        return judge(self)

    @cached_property
    def grave(self) -> tuple[Concern, ...]:
        """Why the values must not be used although the fit converged; see :mod:`.explained`."""
        return grave(self, self.concerns)

    @cached_property
    def whole_runs(self) -> WholeRuns:
        """Errors of whole runs, and whether noise as estimated could have left them."""
        return judged_runs(self, unasked=self._unasked)

    def runs_on(self, dataset: Dataset) -> WholeRuns:
        """The same on records that the fit has not seen."""
        return judged_runs(self, dataset, unasked=self._unasked)

    @property
    def _unasked(self) -> str:
        """Why runs under the noise model would not be those of the sea; empty where they would."""
        waves = [one for one in self.concerns if one.kind == "swing"]
        # Where a sea was looked for, and none or one was found, what is left is no such wave.
        asked = self.process_noise is not None or self.noise.seas
        if not waves or asked or not self.noise.has_forces:
            return ""
        return (
            f"innovations are narrow-band about {waves[0].size:.2g} s, which the noise model "
            "does not hold"
        )

    @property
    def _records_differ(self) -> bool:
        """Whether the stated errors do not hold what differs between records."""
        return any(concern.kind == "records_differ" for concern in self.concerns)

    @property
    def caveat(self) -> str:
        """What to add to every interval that follows from the standard errors; often empty."""
        found = []
        if self._records_differ:
            found.append(
                "Records of the fit differ by more than its standard errors say, so these "
                "intervals are too narrow: predict from fit.with_record_errors()."
            )
        if self.purpose == "replay":
            found.append(
                "These values are for runs of a model that lacks physics: intervals hold about 60 "
                "in place of 95 of 100. The scatter between records says more."
            )
        elif self.noise.has_forces and self.whole_runs.took_the_work:
            found.append(
                "Process noise has taken the work of physics, and these values are for "
                "derivatives: runs are better with those of replayed(fit)."
            )
        return " ".join(found)

    def predict(self, dataset: Dataset, *, initial: Initial = "fit") -> Prediction:
        """Predict other records; see :func:`oed_sysid.likelihood.prediction.predict`.

        Parameters
        ----------
        dataset : Dataset
            Records with the model's channels.
        initial : str or mapping
            ``"fit"`` estimates the initial states on each record with all
            shared parameters held, ``"first"`` takes the first measurements,
            a mapping gives the states, as numbers or as pairs ``(value, std)``.
        """
        covariance = self.shared_covariance
        found = predict(self.model, dataset, covariance, self.noise, initial=initial)
        return replace(found, caveat=self.caveat)

    def with_record_errors(self) -> Fit:
        """Return the same fit, its covariance that of the scatter between records.

        Standard errors, predictions and what is drawn from the fit (turning circles) then hold what
        differs from record to record. Parameters that one record alone tells keep their own.

        Raises
        ------
        DataError
            If there are fewer than four records.
        """
        scatter = checked_scatter(self)
        found = np.diag(scatter.covariance)
        covariance = np.where(np.isfinite(scatter.covariance), scatter.covariance, 0.0)
        alone = ~np.isfinite(found)
        covariance[alone, alone] = np.diag(self.covariance)[alone]
        return replace(self, covariance=covariance)

    def save(self, path: str | Path, **made: Any) -> None:
        """Write the fit, its model and its data to a JSON file; :meth:`load` reads it.

        The file appears whole or not at all. ``command=`` and ``settings=`` say how the
        fit was made; see :func:`oed_sysid.likelihood.archive.made_by`.
        """
        settings = {"estimator": self.estimator, **made.pop("settings", {})}
        made_of = made_by([self.dataset], settings=settings, **made)
        write_result(path, "fit", encode(self), made_of)

    @staticmethod
    def load(path: str | Path) -> Fit:
        """Read a fit that :meth:`save` wrote, also of an older version."""
        fit = decode_result(path, "fit", ARCHIVED)
        check_fit(fit, str(path))
        return fit

    _repr_html_ = as_html

    def __repr__(self) -> str:
        return (
            f"<Fit of {self.model.name!r}: {self.status.code}, {len(self.names)} parameters, "
            f"residuals {self.normalised_rms:.3g} x noise>"
        )

    # -- words ---------------------------------------------------------------------

    def document(self, comparison: Any = None, *, log: Any = None, style: int = 0) -> Report:
        """Return what the fit says.

        Parameters
        ----------
        comparison : Comparison, optional
            Of the fit with other records.
        log : LogCheck, optional
            What a check of the records found; said first.
        style : int
            Position of the model in a comparison, for its colour.
        """
        way = self.estimator.replace(", ", " with ", 1)
        effective = sum(count for count, _ in self.effective_samples().values())
        tested = "samples" if self.innovations is None else "innovations"
        misfit = f"{self._misfit:.3f} x noise over all outputs"
        return Report(
            title=self.model.name,
            subtitle=f"Fitted by {way} to {', '.join(self._record_words())}",
            headline=f"{self.model.name} fitted by {self.estimator}",
            answer=self._answer(comparison),
            warnings=(
                *([] if log is None else log.warning().splitlines()),
                *(f"Do not use these values: {concern.text}" for concern in self.grave),
                *self._taken(),
            ),
            head=(
                ("records", ", ".join(self._record_words())),
                ("observations", f"{self.n_observations}"),
                ("status", f"{self.status} ({self.iterations} iterations, {self.seconds:.2g} s)"),
                ("misfit", misfit),
                ("one step", f"{self.one_step_rms:.3f} x its standard deviation"),
                ("whole runs", self.whole_runs.sizes or "none"),
            ),
            numbers=(
                ("misfit", f"{self._misfit:.3g} × noise"),
                ("parameters", str(len(self.names))),
                ("samples", f"{self.n_observations:,}".replace(",", " ")),
                (f"independent {tested}", f"{effective:,.0f}".replace(",", " ")),
                ("status", self.status.code),
            ),
            sections=(
                self._estimates(),
                *self._intervals(),
                self._residuals(style),
                *self._random(),
                *self._records(style),
                *([] if comparison is None else comparison.document().sections),
                Section("Equations", listing=self.model.equations(), only="page"),
            ),
            verdict=self._remarks(),
        )

    report = as_text

    @property
    def _misfit(self) -> float:
        """Error of whole runs over all outputs, in units of the noise."""
        return self.normalised_rms if self.innovations is None else self.whole_runs.relative

    def _taken(self) -> list[str]:
        """Words where process noise has taken the work of physics."""
        if not self.whole_runs.took_the_work:
            return []
        return [
            "Process noise has taken the work of physics: "
            f"{'; '.join(self.whole_runs.objections)}. Look for what is missing with improve(); "
            "for runs, simulation and export take the values of replayed(fit)."
        ]

    def _answer(self, comparison: Any) -> str:
        """Whether the fit can be used, how certain it is, and how well it fits and predicts."""
        if not self.status.ok:
            return f"Not usable: the fit of {self.model.name} ended as {self.status.code}."
        if self.grave:
            return f"Not usable: {self.grave[0].text}"
        errors = {
            name: TWO_SIDED_95 * self.std_errors[name] / abs(value) if value else np.inf
            for name, value in self.values.items()
        }
        words = f"{self.model.name}: {counted(len(self.names), 'parameter')} estimated"
        if errors:
            worst = max(errors, key=lambda name: errors[name])
            words += f", the least certain {worst} ± {share(errors[worst])} (95 %)"
        words += f"; residuals are {self._misfit:.3g} × noise"
        if self._misfit > SMOOTHED:
            words += (
                ": the model is far off, or the log was smoothed and shows no noise; read errors "
                "in units"
            )
        elif self.whole_runs.objections:
            words += ", so the model lacks something"
        if self.whole_runs.sizes:
            words += f"; whole runs are off {self.whole_runs.sizes}"
        if comparison is not None:
            size = comparison.best.relative
            words += f"; errors on the validation records {size:.3g} × noise"
        return f"{words}."

    def _estimates(self) -> Section:
        size = 2.0 + 0.42 * len(self.names)
        drawings = [
            Figure(
                "plot_intervals", self,
                "Estimates with 95 % intervals, divided by the prior (grey bars), or by "
                "themselves where nothing was.",
                size=(7.6, 1.3 + 0.34 * len(self.names)),
            ),
            Figure(
                "plot_correlation", self,
                "Correlation of the estimates. Two that are close to ±1 can be told apart only "
                "by other manoeuvres.",
                size=(size + 0.8, size),
            ),
        ]  # fmt: skip
        return Section(
            "Estimates", (*self._local_lines(), *self._start_lines()), self._parameter_table(),
            drawings[: len(self.names)], indent=2,
        )  # fmt: skip

    def _intervals(self) -> list[Section]:
        """What was known before and what is known now, on a page."""
        rows = []
        for name in self.names:
            parameter, (low, high) = self.model.parameter(name), self.interval(name)
            mean, spread = parameter.prior_mean, parameter.prior_spread
            prior = "" if mean is None else interval(mean, TWO_SIDED_95 * (spread or 0.0))
            ends = (rounded(end, 0.5 * (high - low)) for end in (low, high))
            said = " to ".join(ends) if np.isfinite(high - low) else "unbounded"
            rows.append((name, said, prior, parameter.unit))
        table = Table(("parameter", "95 % interval", "prior ± (95 %)", "unit"), rows)
        return [Section("Intervals", tables=(table,), only="page")] if rows else []

    def _residuals(self, style: int) -> Section:
        words = self._captive_lines()
        if self.innovations is not None:
            words += [
                "Effective samples are of the one-step prediction errors, measured less expected "
                "from all earlier samples; residuals are measured less the model running on its "
                "own."
            ]
        drawing = Figure(
            "figure_whiteness", self,
            "Autocorrelation of the residuals, one line per record. White noise stays inside the "
            "grey band; slow curves are physics or sensor dynamics that the model lacks.",
            options={"style": style},
        )  # fmt: skip
        return Section("Residuals", words, (self._output_table(),), (drawing,), indent=2)

    def _records(self, style: int) -> list[Section]:
        """Data and model of the first records, on a page."""
        drawings = [
            Figure(
                "figure_fit", self,
                f"{name}: dots are measured, the line is the model and its band holds 95 % of the "
                "noise around it. Right: measured minus model, with the band of the noise.",
                (index,), {"style": style},
            )
            for index, name in enumerate(self.dataset.names[:MOST_DRAWN])
        ]  # fmt: skip
        rest = len(self.dataset) - len(drawings)
        words = (f"{rest} further records are not drawn.",) if rest else ()
        return [Section("Records", words, figures=drawings, only="page")]

    def _record_words(self) -> list[str]:
        """Names of the records; of many independent tests the first and the last."""
        words = [record.name for record in self.dataset if not record.independent]
        tests = [record for record in self.dataset if record.independent]
        if tests:
            measured = (np.isfinite(record.outputs).any(axis=1) for record in tests)
            count = sum(int(rows.sum()) for rows in measured)
            span = tests[0].name if len(tests) == 1 else f"{tests[0].name} to {tests[-1].name}"
            words.append(f"{span} ({count} {'test' if count == 1 else 'tests'})")
        return words

    def _captive_lines(self) -> list[str]:
        """Forces at given motion that were fitted along, one line each."""
        told = self.captive or CaptiveErrors({}, {})
        lines = [
            f"captive {axis}: error {size:.3g} x noise"
            + (
                f", {100 * told.relative[axis]:.3g} % of its rms"
                if told.relative[axis] < np.inf
                else ""
            )
            for axis, size in told.in_noise.items()
            if np.isfinite(size)
        ]
        if self.tests_scatter:
            lines.append(
                "Forces of the captive tests scatter more than their noise allows: their part "
                "of the standard errors is from their residuals, in whatever order."
            )
        return lines

    def _parameter_table(self) -> list[Table]:
        if not self.names:
            return [Table(("no free parameter: initial states only",), ())]
        # A column of its own where the stated errors do not hold what differs between records.
        differ = self._records_differ
        scattered = self.record_errors
        head = ("std. error", "between records") if differ else ("std. error",)
        headers = ("parameter", "value", *head, "rel. %", "unit", "")
        rows = []
        errors = self.std_errors
        for name, value in self.values.items():
            parameter = self.model.parameter(name)
            relative = 100 * errors[name] / abs(value) if value else np.inf
            note = ""
            if value <= parameter.lower or value >= parameter.upper:
                note = "at bound"
            elif not np.isfinite(errors[name]):
                note = "not identifiable"
            rows.append(
                (
                    name,
                    rounded(value, errors[name]),
                    f"{errors[name]:.2g}",
                    *((f"{scattered[name]:.2g}",) if differ else ()),
                    f"{relative:.2g}",
                    parameter.unit,
                    note,
                )
            )
        return [Table(headers, rows)]

    def _local_lines(self) -> list[str]:
        """Values of per-record parameters, one line each."""
        lines = []
        for name in self.local_values[0] if self.local_values else ():
            pairs = zip(self.dataset.names, self.local_values, strict=True)
            listed = ", ".join(f"{record} {values[name]:.4g}" for record, values in pairs)
            lines.append(f"{name} per record: {listed} {self.model.parameter(name).unit}".rstrip())
        return lines

    def _start_lines(self) -> list[str]:
        """Start states that were not free, one line per record."""
        lines = []
        for record, known in zip(self.dataset, self.start_states, strict=False):
            if record.independent:
                continue
            words = [
                f"{name} {value:.4g} held"
                if std == 0.0
                else f"{name} {interval(value, TWO_SIDED_95 * std)}"
                for name, (value, std) in known.items()
            ]
            if words:
                lines.append(f"start of {record.name} given: {', '.join(words)} (95 %)")
        return lines

    def _output_table(self) -> Table:
        headers = ("output", "rms residual", "noise", "", "eff. samples", "of", "unit")
        rows = []
        effective = self.effective_samples()
        rms = self.rms
        for output, sigma, estimated in zip(
            self.model.outputs, self.sigma, self.sigma_estimated, strict=True
        ):
            count, total = effective[output.name]
            if not total and self.tests_alone:
                continue
            factor, unit = shown_unit(output.unit)  # angles are read in degrees
            rows.append(
                (
                    output.name,
                    f"{factor * rms[output.name]:.3g}",
                    f"{factor * sigma:.3g}",
                    ("estimated" if estimated else "given") if total else "not measured",
                    f"{count:.0f}",
                    f"{total}",
                    unit,
                )
            )
        return Table(headers, rows)

    def _random(self) -> list[Section]:
        """Disturbance forces and coloured sensors, one line each."""
        noise = self.noise
        if noise.is_white:
            return []
        units = {place.name: place.unit for place in places(self.model)}
        headers = ("random", "level", "95 %", "time [s]", "unit")
        rows = []
        for name, level, time in zip(noise.places, noise.force, noise.force_time, strict=True):
            rows.append(self._noise_row(name, level, time, units.get(name, "")))
        for output, level, time in zip(
            self.model.outputs, noise.colour, noise.colour_time, strict=True
        ):
            if level > 0:
                rows.append(self._noise_row(f"colour of {output.name}", level, time, output.unit))
        sections = [Section("Random", tables=(Table(headers, rows),), indent=2)] if rows else []
        return sections + [self._sea(number, units) for number in range(len(noise.seas))]

    def _sea(self, number: int, units: Mapping[str, str]) -> Section:
        """Period, width and significant level of a sea."""
        sea = self.noise.seas[number]
        label = f"sea {number + 1}" if len(self.noise.seas) > 1 else "sea"

        def told(name: str, size: float, count: int = 3) -> str:
            known = self.noise_std.get(name)
            half = np.nan if known is None else TWO_SIDED_95 * known * size
            return digits(size, count) if known is None else interval(size, half)

        period, width = float(sea.period or 0.0), 100.0 * float(sea.bandwidth or 0.0)
        words = (
            "Disturbance forces have a period, as waves give them (or motion that the model "
            f"lacks): {told(f'{label} period', period)} s, "
            f"{told(f'{label} bandwidth', width, 2)} % wide (95 %)"
        )
        words += "." if sea.shape == "velocity" else ", with a tail at low frequencies."
        rows = [
            (
                place,
                told(f"sea {place} level", level) if level > 0 else "absent",
                units.get(place, ""),
            )
            for place, level in sea.significant.items()
        ]
        headers = ("waves", "significant amplitude", "unit")
        return Section("Sea", (words,), (Table(headers, rows),), indent=2)

    def _noise_row(self, name: str, level: float, time: float, unit: str) -> tuple[str, ...]:
        if level <= 0:
            return name, "absent", "", "", unit
        known = self.noise_std.get(f"{name} level")
        half = np.nan if known is None else TWO_SIDED_95 * known * level
        spread = "" if known is None else f"± {digits(half)}"
        return name, rounded(level, half), spread, digits(time), unit

    def _remarks(self) -> list[str]:
        """What else to know before the values are used, one sentence each."""
        said_first = {self.status.advice, *(concern.text for concern in self.grave)}
        lines = [one.text for one in self.concerns if one.text not in said_first]
        return lines + [sentence for remark in REMARKS for sentence in remark(self)]

    to_dict = as_dict(
        "estimator", "iterations", "seconds", "cost", "normalised_rms", "covariance", "rms",
        "noise_std", "concerns", "grave", "status", "one_step_rms", "whole_runs",
        model="model.name", records="dataset.names", coloured_residuals="coloured",
        # Null where nothing tells: three records or fewer, another estimator.
        parameters=lambda self: [
            {
                "name": name,
                "value": value,
                "std_error": self.std_errors[name],
                "record_error": self.record_errors.get(name),
                "unit": self.model.parameter(name).unit,
            }
            for name, value in self.values.items()
        ],
        noise=lambda self: dict(zip(self.model.output_names, self.sigma, strict=True)),
        effective_samples=lambda self: self.effective_samples(), noise_model="noise",
    )  # fmt: skip


def _still_inputs(fit: Fit) -> Iterator[str]:
    commands = np.vstack([record.inputs for record in fit.dataset])
    for channel, series in zip(fit.model.inputs, commands.T, strict=True):
        if np.ptp(series) == 0.0 and not fit.tests_alone:
            yield (
                f"Input {channel.name} never moves in any record: what it does cannot be "
                "told from what else is constant."
            )


def _correlated_residuals(fit: Fit) -> Iterator[str]:
    if fit.coloured:
        yield (
            "Residuals are correlated in time (see eff. samples): standard errors are from "
            "the sandwich covariance."
        )


def _unidentified(fit: Fit) -> Iterator[str]:
    for text in fit.information.null_directions():
        yield f"Not identifiable: {text}."


def _at_bounds(fit: Fit) -> Iterator[str]:
    own = {name: fit.model.parameter(name) for name in fit.names}
    if bounded := [n for n, v in fit.values.items() if not own[n].lower < v < own[n].upper]:
        yield (
            f"{', '.join(bounded)} at bound: widen it if it may be wrong. A log that counts "
            "an angle the other way does this too: Input(..., sign=-1)."
        )


def _off_priors(fit: Fit) -> Iterator[str]:
    far = []
    for name, value in fit.values.items():
        parameter = fit.model.parameter(name)
        mean, spread = parameter.prior_mean, parameter.prior_spread
        if mean is not None and spread is not None and abs(value - mean) > CLEARLY * spread:
            far.append(name)
    if far:
        yield (
            f"Further than {CLEARLY:g} standard deviations from the prior: "
            f"{', '.join(far)}. A model that lacks an effect bends others to replace it."
        )


def _correlated_pairs(fit: Fit) -> Iterator[str]:
    correlation = np.tril(fit.correlation, -1)
    pairs = [
        (abs(correlation[i, j]), fit.names[i], fit.names[j], correlation[i, j])
        for i, j in zip(*np.nonzero(np.abs(correlation) > ALIKE), strict=True)
    ]
    for _, first, second, value in sorted(pairs, reverse=True)[:MOST_PAIRS]:
        yield f"Correlation of {first} and {second}: {value:+.3f}."


REMARKS: tuple[Callable[[Fit], Iterator[str]], ...] = (
    _still_inputs,
    _correlated_residuals,
    _unidentified,
    _at_bounds,
    _off_priors,
    _correlated_pairs,
)


def _typed(content: dict[str, Any]) -> dict[str, Any]:
    """Fields of a fit, with what version 0.1 kept in ``extras`` as what it is now."""
    extras = dict(content.get("extras", {}))
    told: dict[str, Any] = {}
    for name, field in (("nominal", "nominal"), ("excluded", "excluded"), ("horizon", "horizon"),
                        ("tests_scatter", "tests_scatter"), ("windows", "n_windows")):  # fmt: skip
        if name in extras:
            told[field] = extras.pop(name)
    if extras.keys() & {"disturbance_test", "process_noise_failed"}:
        delay = extras.pop("white_delay", None)
        told["process_noise"] = ProcessNoiseTest(
            extras.pop("disturbance_test", np.inf),
            extras.pop("process_noise_failed", ""),
            None if delay is None else Delay(*(*delay, np.nan, np.nan)),
            tuple(ActuatorStart(*one) for one in extras.pop("white_starts", ())),
        )
    if "captive" in extras:
        errors = extras.pop("captive")
        told["captive"] = CaptiveErrors(errors, extras.pop("captive_misfit", {}))
    for field, kind in (("attempts", Attempts), ("posterior", Posterior)):
        names = [one.name for one in fields(kind)]
        if extras.keys() >= set(names):
            told[field] = kind(*(extras.pop(name) for name in names))
    extras.pop("magnitudes", None)
    return {**content, **told, "extras": extras} if "extras" in content else content


# Everything that a saved fit is made of.
ARCHIVED = dataclasses_of(Fit)
