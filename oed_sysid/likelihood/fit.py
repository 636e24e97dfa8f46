"""The result of an estimation: values that are never without their uncertainty."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.likelihood import archive, estimate, judgement, prediction
from oed_sysid.likelihood.departures import CLEARLY
from oed_sysid.likelihood.disturbances import places
from oed_sysid.likelihood.laws import Law, laws_of, unresolved
from oed_sysid.likelihood.noise_model import Sea
from oed_sysid.likelihood.whole_runs import WholeRuns, judged_runs
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import NEGLIGIBLE
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
from oed_sysid.runtime.tables import tables
from oed_sysid.text.units import shown_unit

# Sentences of a report.
SAYS = tables(__file__)
# Records that a page draws.
MOST_DRAWN = 8
# Correlation of two estimates from which on they can hardly be told apart.
ALIKE = 0.95


@dataclass(frozen=True, eq=False)
class Fit(estimate.Estimate):
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
    integration : Integration, or None
        Why ``model.step`` is finer than that of the model that was given; None where it is not.
    extras : mapping
        What else an estimator tells of its way, such as the course of a recursion. Nothing in the
        package is decided by it.

    Examples
    --------
    What an estimator returns; see :class:`~oed_sysid.likelihood.estimator.Estimator`.
    """

    @classmethod
    def of_saved(cls, **content: Any) -> Fit:
        """Build a fit of the fields of a file; of version 0.1 some were told in ``extras``."""
        extras = dict(content.get("extras", {}))
        told: dict[str, Any] = {}
        for name in {"nominal", "excluded", "horizon", "tests_scatter", "windows"} & {*extras}:
            told["n_windows" if name == "windows" else name] = extras.pop(name)
        if extras.keys() & {"disturbance_test", "process_noise_failed"}:
            delay = extras.pop("white_delay", None)
            told["process_noise"] = estimate.ProcessNoiseTest(
                extras.pop("disturbance_test", np.inf),
                extras.pop("process_noise_failed", ""),
                _late(*delay) if delay else None,
                tuple(estimate.ActuatorStart(*one) for one in extras.pop("white_starts", ())),
            )
        if "captive" in extras:
            errors = extras.pop("captive")
            told["captive"] = estimate.CaptiveErrors(errors, extras.pop("captive_misfit", {}))
        for field, kind in (("attempts", estimate.Attempts), ("posterior", estimate.Posterior)):
            names = [one.name for one in fields(kind)]
            if extras.keys() >= set(names):
                told[field] = kind(*(extras.pop(name) for name in names))
        extras.pop("magnitudes", None)
        return cls(**content | told | ({"extras": extras} if "extras" in content else {}))

    @cached_property
    def concerns(self) -> tuple[judgement.Concern, ...]:
        """What speaks against the fit; see :mod:`oed_sysid.likelihood.judgement`."""
        return judgement.judge(self)

    @cached_property
    def grave(self) -> tuple[judgement.Concern, ...]:
        """Why the values must not be used although the fit converged; see :mod:`.explained`."""
        return judgement.grave(self, self.concerns)

    @cached_property
    def whole_runs(self) -> WholeRuns:
        """Errors of whole runs, and whether noise as estimated could have left them."""
        return replace(judged_runs(self, unasked=self._unasked), follows=self._laws)

    def runs_on(self, dataset: Dataset) -> WholeRuns:
        """The same on records that the fit has not seen."""
        return replace(judged_runs(self, dataset, unasked=self._unasked), follows=self._laws)

    @cached_property
    def _laws(self) -> tuple[Law, ...] | None:
        """Laws that process noise holds; None where that was not asked."""
        return laws_of(self) if self.noise.has_forces and not self._unasked else None

    @property
    def _unasked(self) -> str:
        """Why runs under the noise model would not be those of the sea; empty where they would."""
        if fast := unresolved(self.model, self.dataset, self.noise):
            return fast
        waves = [one for one in self.concerns if one.kind == "narrow_band"]
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
            found.append(SAYS["errors_too_small"])
        if self.purpose == "replay":
            found.append(SAYS["for_runs"])
        elif self.noise.has_forces and self.whole_runs.took_the_work:
            found.append(SAYS["for_derivatives"])
        return " ".join(found)

    def predict(
        self, dataset: Dataset, *, initial: prediction.Initial = "fit"
    ) -> prediction.Prediction:
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
        found = prediction.predict(self.model, dataset, covariance, self.noise, initial=initial)
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
        found = estimate.checked_scatter(self).covariance
        own = np.diag(np.diag(self.covariance))
        return replace(self, covariance=np.where(np.isfinite(found), found, own))

    def save(self, path: str | Path, **made: Any) -> None:
        """Write the fit, its model and its data to a JSON file; :meth:`load` reads it.

        The file appears whole or not at all. ``command=`` and ``settings=`` say how the
        fit was made; see :func:`oed_sysid.likelihood.archive.made_by`.
        """
        settings = {"estimator": self.estimator, **made.pop("settings", {})}
        made_of = archive.made_by([self.dataset], settings=settings, **made)
        archive.write_result(path, "fit", archive.encode(self), made_of)

    @staticmethod
    def load(path: str | Path) -> Fit:
        """Read a fit that :meth:`save` wrote, also of an older version."""
        fit = archive.decode_result(path, "fit", ARCHIVED)
        archive.check_fit(fit, str(path))
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
        misfit = f"{self._misfit:.3g} × noise over all outputs"
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
                ("one step", f"{digits(self.one_step_rms, 3)} x its standard deviation"),
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

    @property
    def _ran(self) -> bool:
        """Whether the model ran along the records: only then something tells of directions."""
        return self.status.code != "diverged"

    def _taken(self) -> list[str]:
        """Words where process noise has taken the work of physics, or of a single departure."""
        if not self.status.ok:
            return []
        asked = self.process_noise
        if asked is not None and asked.departure is not None and asked.departure_likelier:
            size = asked.departure.size
            return [SAYS["departed"].format(c) for c in self.concerns if c.size == size]
        if not self.whole_runs.took_the_work:
            return []
        return [SAYS["taken"].format(said="; ".join(self.whole_runs.said))]

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
        # Filtered logs have next to no noise, of which residuals are no measure.
        if NEGLIGIBLE * self._misfit > 1.0:
            words += SAYS["far_off"]
        elif self.whole_runs.said:
            words += ", so the model lacks something"
        if self.whole_runs.sizes:
            words += f"; whole runs are off {self.whole_runs.sizes}"
        if comparison is not None:
            size = comparison.best.relative
            words += f"; errors on the validation records {size:.3g} × noise"
        return f"{words}."

    def _estimates(self) -> Section:
        n = len(self.names)
        size = 2.0 + 0.42 * n
        drawings = [
            Figure("plot_intervals", self, SAYS["intervals"], size=(7.6, 1.3 + 0.34 * n)),
            Figure("plot_correlation", self, SAYS["correlation"], size=(size + 0.8, size)),
        ]
        return Section(
            "Estimates", (*self._local_lines(), *self._start_lines()), self._parameter_table(),
            drawings[:n], indent=2,
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
            words.append(SAYS["one_step"])
        options = {"style": style}
        drawing = Figure("figure_whiteness", self, SAYS["whiteness"], options=options)
        return Section("Residuals", words, (self._output_table(),), (drawing,), indent=2)

    def _records(self, style: int) -> list[Section]:
        """Data and model of the first records, on a page."""
        drawings = [
            Figure("figure_fit", self, SAYS["record"].format(name=name), (i,), {"style": style})
            for i, name in enumerate(self.dataset.names[:MOST_DRAWN])
        ]
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
        lines = []
        told = self.captive or estimate.CaptiveErrors({}, {})
        for axis, size in told.in_noise.items():
            of_rms = 100.0 * told.relative[axis]
            more = f", {of_rms:.3g} % of its rms" if of_rms < np.inf else ""
            if np.isfinite(size):
                lines.append(f"captive {axis}: error {size:.3g} x noise{more}")
        if self.tests_scatter:
            lines.append(SAYS["tests_scatter"])
        return lines

    def _parameter_table(self) -> list[Table]:
        if not self.names:
            return [Table(("no free parameter: initial states only",), ())]
        # A column of its own where the stated errors do not hold what differs between records.
        scattered = self.record_errors if self._records_differ else {}
        rows = []
        for (name, value), error in zip(self.values.items(), self.std_errors.values(), strict=True):
            parameter = self.model.parameter(name)
            relative = 100 * error / abs(value) if value else np.inf
            note = "" if np.isfinite(error) or not self._ran else "not identifiable"
            note = "at bound" if value <= parameter.lower or value >= parameter.upper else note
            between = (f"{scattered[name]:.2g}",) if scattered else ()
            sizes = (rounded(value, error), f"{error:.2g}", *between, f"{relative:.2g}")
            rows.append((name, *sizes, parameter.unit, note))
        head = ("std. error", "between records") if scattered else ("std. error",)
        return [Table(("parameter", "value", *head, "rel. %", "unit", ""), rows)]

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
        return [
            f"start of {record.name} given: {', '.join(map(_start, known.items()))} (95 %)"
            for record, known in zip(self.dataset, self.start_states, strict=False)
            if known and not record.independent
        ]

    def _output_table(self) -> Table:
        rows = []
        for output, sigma, estimated, rms, (count, total) in zip(
            self.model.outputs, self.sigma, self.sigma_estimated, self.rms.values(),
            self.effective_samples().values(), strict=True,
        ):  # fmt: skip
            if not total and self.dataset.only_tests:
                continue
            factor, unit = shown_unit(output.unit)  # angles are read in degrees
            origin = ("estimated" if estimated else "given") if total else "not measured"
            sizes = (f"{factor * rms:.3g}", f"{factor * sigma:.3g}", origin)
            rows.append((output.name, *sizes, f"{count:.0f}", f"{total}", unit))
        return Table(("output", "rms residual", "noise", "", "eff. samples", "of", "unit"), rows)

    def _random(self) -> list[Section]:
        """Disturbance forces and coloured sensors, one line each, and seas."""
        noise, units = self.noise, {place.name: place.unit for place in places(self.model)}
        forces = zip(noise.places, noise.force, noise.force_time, strict=True)
        colours = zip(self.model.outputs, noise.colour, noise.colour_time, strict=True)
        rows = [self._noise_row(*one, units.get(one[0], "")) for one in forces]
        rows += [
            (
                f"{'zero' if np.isinf(time) else 'autocorrelated noise'} of {output.name}",
                *self._noise_row(f"colour of {output.name}", level, time, output.unit)[1:],
            )
            for output, level, time in colours
            if level > 0
        ]
        table = Table(("process noise", "std. deviation", "95 %", "time [s]", "unit"), rows)
        sections = [Section("Process noise", tables=(table,), indent=2)] if rows else []
        seas = [self._sea(*one, units) for one in zip(noise.sea_names, noise.seas, strict=True)]
        return [] if noise.is_white else sections + seas

    def _sea(self, label: str, sea: Sea, units: Mapping[str, str]) -> Section:
        """Period, width and significant level of a sea."""

        def told(name: str, size: float, count: int = 3) -> str:
            half = self._half(name, size)
            return digits(size, count) if np.isnan(half) else interval(size, half)

        period, width = float(sea.period or 0.0), 100.0 * float(sea.bandwidth or 0.0)
        where = f" on {', '.join(sea.records)}" if sea.records else ""
        words = (
            f"Disturbance forces{where} have a period, as waves give them (or motion that the "
            f"model lacks): {told(f'{label} period', period)} s, "
            f"{told(f'{label} bandwidth', width, 2)} % wide (95 %)"
            f"{'' if sea.shape == 'velocity' else ', with a tail at low frequencies'}."
        )
        head: tuple[str, ...] = ("waves", "significant amplitude", "unit")
        rows: list[tuple[str, ...]] = [
            (p, told(f"{label} {p} level", one) if one > 0 else "absent", units.get(p, ""))
            for p, one in sea.significant.items()
        ]
        if sea.phases is not None:
            words += f" One wave acts in all, behind that in {sea.places[0]} by a phase."
            head = (*head, "phase [deg]", "common [% of variance]")
            both = zip(rows, sea.common, strict=True)
            rows = [(*row, f"{angle:.0f}", f"{share:.0f}") for row, (angle, share) in both]
        return Section("Sea", (words,), (Table(head, rows),), indent=2)

    def _half(self, name: str, size: float) -> float:
        """Half of the 95 % interval of a level or time of the noise; NaN where none is known."""
        return TWO_SIDED_95 * self.noise_std.get(name, np.nan) * size

    def _noise_row(self, name: str, level: float, time: float, unit: str) -> tuple[str, ...]:
        factor, unit = shown_unit(unit)
        if level <= 0:
            return name, "absent", "", "", unit
        half = factor * self._half(f"{name} level", level)
        spread = "" if np.isnan(half) else f"± {digits(half)}"
        lasting = "constant" if np.isinf(time) else digits(time)
        return name, rounded(factor * level, half), spread, lasting, unit

    def _remarks(self) -> list[str]:
        """What else to know before the values are used, one sentence each."""
        said_first = {self.status.advice, *(concern.text for concern in self.grave)}
        lines = [one.text for one in self.concerns if one.text not in said_first]
        lines += [SAYS["still_input"].format(name=name) for name in self._still_inputs()]
        if self.coloured:
            lines.append(SAYS["coloured"])
        if self._ran:
            lines += [f"Not identifiable: {text}." for text in self.information.null_directions()]
        return lines + self._value_lines() + self._correlated_pairs()

    def _value_lines(self) -> list[str]:
        """Values at their bounds, and far from what was known before."""
        lines = []
        own = [(self.model.parameter(name), value) for name, value in self.values.items()]
        if bounded := [one.name for one, value in own if not one.lower < value < one.upper]:
            lines.append(f"{', '.join(bounded)} at bound: widen it if it may be wrong.")
        if far := [one.name for one, value in own if _off_prior(one, value)]:
            lines.append(SAYS["far_from_prior"].format(far=CLEARLY, names=", ".join(far)))
        return lines

    def _still_inputs(self) -> list[str]:
        spans = np.ptp(np.vstack([record.inputs for record in self.dataset]), axis=0)
        names = zip(self.model.input_names, spans, strict=True)
        return [name for name, span in names if span == 0.0 and not self.dataset.only_tests]

    def _correlated_pairs(self) -> list[str]:
        correlation = np.tril(self.correlation, -1)
        pairs = [
            (abs(correlation[i, j]), self.names[i], self.names[j], correlation[i, j])
            for i, j in zip(*np.nonzero(np.abs(correlation) > ALIKE), strict=True)
        ]
        return [
            f"Correlation of {first} and {second}: {value:+.3f}."
            for _, first, second, value in sorted(pairs, reverse=True)[:6]
        ]

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


def _start(known: tuple[str, tuple[float, float]]) -> str:
    """A start state that was given, in words."""
    name, (value, std) = known
    told = f"{value:.4g} held" if std == 0.0 else interval(value, TWO_SIDED_95 * std)
    return f"{name} {told}"


def _off_prior(parameter: Parameter, value: float) -> bool:
    """Whether a value is far from what was known before."""
    mean, spread = parameter.prior_mean, parameter.prior_spread
    return mean is not None and spread is not None and abs(value - mean) > CLEARLY * spread


def _late(signal: str, kind: str, size: float, std: float) -> estimate.Departure:
    """A delay as version 0.1 kept it."""
    how = "acts late" if kind == "input" else "late"
    return estimate.Departure(signal, how, size, std, np.nan, np.nan)


# Everything that a saved fit is made of.
ARCHIVED = archive.dataclasses_of(Fit)
