"""The result of an improvement: every step kept, printable, and plain data on request."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, takewhile
from typing import Any

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import listed
from oed_sysid.evidence.check import LogCheck
from oed_sysid.evidence.claim import Claim, rests
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.locate import Located
from oed_sysid.evidence.propose import Proposals
from oed_sysid.evidence.rank import Ranking, hopeful
from oed_sysid.evidence.remainder import Remains
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.study import RISE, worse
from oed_sysid.information.shifts import GROUP_WIDTH
from oed_sysid.likelihood.fit import MOST_DRAWN, Fit
from oed_sysid.likelihood.noise_levels import signal_spread
from oed_sysid.physics import Effect
from oed_sysid.physics.base import SPAN, Force
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.physics.words import in_words
from oed_sysid.runtime import display
from oed_sysid.text.expressions import names, to_numpy
from oed_sysid.text.units import shown_unit

# Root mean square errors of every output, ``(n_outputs,)``, on ``train`` and ``test`` records.
Errors = Mapping[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class Yardstick:
    """What errors are compared with.

    Attributes
    ----------
    records : mapping
        Training and validation records as they were searched, ``train`` and, if any, ``test``.
    sigma : ndarray (n_outputs,)
        Noise levels.
    """

    records: Mapping[str, Dataset]
    sigma: np.ndarray

    @property
    def outputs(self) -> tuple[Output, ...]:
        """Outputs whose errors are told."""
        return self.records["train"].channels.outputs

    @property
    def spread(self) -> Errors:
        """Standard deviation of each signal over training and validation records."""
        return {name: signal_spread(part) for name, part in self.records.items()}

    def relative(self, errors: Errors) -> dict[str, float]:
        """Errors over all outputs in units of the noise; NaN where nothing was measured."""
        found = dict.fromkeys(errors, np.nan)
        for name, part in self.records.items():
            count = np.sum([np.isfinite(r.outputs).sum(axis=0) for r in part], axis=0)
            seen = count > 0
            squares = count[seen] * (errors[name][seen] / self.sigma[seen]) ** 2
            if seen.any():
                found[name] = float(np.sqrt(np.sum(squares) / count.sum()))
        return found

    def table(self, before: Errors, after: Errors | None) -> display.Table:
        """Errors of the nominal and the improved model, in units and per cent of the signal."""
        models = {"nominal": before} | ({"improved": after} if after else {})
        rows = []
        for index, output in enumerate(self.outputs):
            # Angles are read in degrees.
            factor, unit = shown_unit(output.unit)
            for kind, records in (("train", "training"), ("test", "validation")):
                if not np.isnan(before[kind][index]):  # measured
                    errors = (self._cell(kind, one, index) for one in models.values())
                    noise = f"{factor * self.sigma[index]:.2g}"
                    rows.append((output.name, records, *errors, noise, unit))
        return display.Table(("output", "records", *models, "noise", "unit"), rows, words=(1,))

    def notes(self) -> Sequence[str]:
        """Where noise levels are from, if nobody declared them."""
        unknown = ", ".join(output.name for output in self.outputs if output.noise_std is None)
        measure = SAYS["errors"]["measure"]
        return [measure, say("errors", "noise", names=unknown)] if unknown else [measure]

    def _cell(self, kind: str, errors: Errors, index: int) -> str:
        error = errors[kind][index]
        if not np.isfinite(error):
            return "diverges" if np.isinf(error) else "-"
        value = shown_unit(self.outputs[index].unit)[0] * error
        share = error / self.spread[kind][index]
        percent = f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"
        return f"{value:.3g} ({percent})"


def proposed_terms(
    proposals: Proposals | None, steps: Sequence[Step], replaces: Sequence[str]
) -> tuple[dict[str, Any], ...]:
    """The term of the last step, where one was added, and the effects whose place it takes."""
    if proposals is None:
        return ()
    step, term = steps[-1], proposals.proposals[0].term
    (parameter,) = step.effect.parameters
    told = {
        "term": term.text, "name": step.effect.name, "equation": term.equation,
        "expression": term.expression, "parameter": parameter.name, "value": parameter.value,
        "unit": parameter.unit, "gain": step.claim.training,
        "test_gain": None if np.isnan(step.claim.validation) else step.claim.validation,
        "group": list(proposals.group), "replaces": list(replaces),
    }  # fmt: skip
    return (told,)


@dataclass(frozen=True, eq=False)
class Step:
    """One effect added.

    Attributes
    ----------
    effect : Effect
        What was added, at its estimates after the step.
    group : tuple of str
        Identifiers that these data cannot tell from it, itself first.
    claim : Claim
        The decision with every term of it (:mod:`oed_sysid.evidence.claim`).
    fit : Fit
        The fit after the step.
    rms : dict
        Prediction errors of each output in its unit, ``train`` and ``test``, ``(n_outputs,)``.
    errors : dict
        The same over all outputs, in units of the noise.

    Examples
    --------
    One of ``improve(...).steps``; see :func:`~oed_sysid.evidence.improve`.
    """

    effect: Effect
    group: tuple[str, ...]
    claim: Claim
    fit: Fit
    rms: Errors
    errors: Mapping[str, float]

    to_dict = display.as_dict(
        "added", "group", "train_error", "test_error",
        gain="claim.training", test_gain="claim.validation",
        statistic="claim.statistic", needed="claim.needed",
    )  # fmt: skip

    @property
    def added(self) -> str:
        """Identifier of the effect."""
        return self.effect.name

    @property
    def train_error(self) -> float:
        """Prediction error after the step on training records, in units of the noise."""
        return self.errors["train"]

    @property
    def test_error(self) -> float:
        """The same on validation records; NaN without any."""
        return self.errors["test"]


# Verdicts of whole runs that are as noise and disturbances would leave them.
EXPLAINED = ("adequate", "disturbance")
# Those that leave open what an effect that was found stands for.
OPEN = ("structure missing", "not known")


@dataclass(frozen=True, eq=False)
class Improvement:
    """What is missing, step by step, with the errors before and after.

    Attributes
    ----------
    base_fit : Fit
        Of the nominal model.
    base_rms : dict
        Its errors of each output in its unit, ``train`` and ``test``, ``(n_outputs,)``.
    steps : tuple of Step
    ranking : Ranking
        Of the first round.
    location : Located
        Where the nominal model fails: stage, equation or sensor, and when.
    remains : Remains
        What is left unexplained after the last step.
    yardstick : Yardstick
        Noise and spread of the signals, to compare errors with.
    last : Ranking or None
        Of the last round, in which everything found was part of the model; it tells what the
        records would not have shown. None where the first was the last.
    decisions : tuple of Claim
        Everything that was asked, with every term of the decision.

    Examples
    --------
    What :func:`~oed_sysid.evidence.improve` returns; see there.
    """

    base_fit: Fit
    base_rms: Errors
    steps: tuple[Step, ...]
    ranking: Ranking
    location: Located
    remains: Remains
    yardstick: Yardstick
    proposed: tuple[Mapping[str, Any], ...] = ()
    notes: tuple[str, ...] = ()
    log: LogCheck | None = None
    last: Ranking | None = None
    decisions: tuple[Claim, ...] = ()

    _repr_html_ = display.as_html

    def __repr__(self) -> str:
        added = ", ".join(step.added for step in self.steps) or "nothing"
        errors = " to ".join(f"{e['test']:.3g}" for e in (self.base_error, self.final_error))
        return (
            f"<Improvement of {self.base.name!r}: added {added}; validation error {errors} x noise>"
        )

    @property
    def fits(self) -> tuple[Fit, ...]:
        """The fit of the nominal model, then that of every step."""
        return (self.base_fit, *(step.fit for step in self.steps))

    @property
    def fit(self) -> Fit:
        """The fit after the last step: to save, predict with, and hand to a design."""
        return self.fits[-1]

    @property
    def base(self) -> Model:
        """The nominal model at its estimates."""
        return self.base_fit.model

    @property
    def model(self) -> Model:
        """The improved model at its estimates."""
        return self.fit.model

    @property
    def base_error(self) -> Mapping[str, float]:
        """Errors of the nominal model, ``train`` and ``test``, in units of the noise."""
        return self.yardstick.relative(self.base_rms)

    @property
    def final_error(self) -> Mapping[str, float]:
        """Errors of the improved model, ``train`` and ``test``, in units of the noise."""
        return self.steps[-1].errors if self.steps else self.base_error

    @property
    def parameters(self) -> tuple[Mapping[str, Any], ...]:
        """Name, value, standard error and unit of every estimated parameter."""
        fit, errors = self.fit, self.fit.std_errors
        return tuple(
            {"name": name, "value": value, "std_error": errors[name], "unit": unit}
            for name, value in fit.values.items()
            for unit in [fit.model.parameter(name).unit]
        )

    @property
    def rejected(self) -> tuple[str, ...]:
        """What the training records alone would have claimed."""
        added = {step.added for step in self.steps}
        asked = (d.name for d in self.decisions if d.training > d.needed and not d.stands)
        return tuple(name for name in dict.fromkeys(asked) if name not in added)

    @property
    def conclusion(self) -> str:
        """What is left, as a kind and a size; see :class:`~.remainder.Remains`."""
        return self.remains.sentence

    @property
    def verdict(self) -> str:
        """``missing``, ``unexplained`` (more than noise, no claim) or ``nothing_missing``.

        A claim with which whole validation runs get worse is none where structure is left.
        """
        if self.headlined and self.remains.kind != "log suspect":
            return "missing"
        return "nothing_missing" if self.remains.kind in EXPLAINED else "unexplained"

    @property
    def headlined(self) -> tuple[Step, ...]:
        """The steps up to the first with which whole validation runs get worse.

        Beside disturbance forces runs of the better model may wander; where structure is left,
        forces are no excuse.
        """
        if self.remains.kind not in OPEN:
            return self.steps
        before = (self.base_error["test"], *(step.test_error for step in self.steps[:-1]))
        pairs = zip(self.steps, before, strict=False)  # without a step one more
        kept = takewhile(lambda pair: not worse(pair[1], pair[0].test_error, RISE), pairs)
        return tuple(step for step, _ in kept)

    @property
    def located(self) -> dict[str, float]:
        """Likelihood-ratio statistic of a disturbance at each place of the signal chain."""
        return dict(self.location.gains)

    @property
    def advice(self) -> list[str]:
        """What to believe, what not, and what to do next at sea; one line each."""
        return advice(self)

    @property
    def remainder(self) -> float:
        """Gain in twice the log-likelihood that unknown forces would still bring."""
        return self.remains.forces

    @property
    def explained(self) -> bool:
        """Whether what remains is noise: no disturbance is needed, and no sensor has to drift."""
        return self.remains.kind == "adequate"

    def at_step(self, count: int) -> Model:
        """Return the model after the first steps only: what came later is undone.

        Parameters
        ----------
        count : int
            Steps kept, 0 for the nominal model; negative numbers count from the
            end, so that ``at_step(-1)`` undoes the last one.

        Returns
        -------
        Model
            At the estimates that were found after that step.
        """
        return self.fits[len(self.steps[:count])].model

    to_dict = display.as_dict(
        "verdict", "steps", "located", "base_error", "final_error", "remains", "conclusion",
        "notes", "parameters", "decisions",
        ranking=lambda self: self.ranking.scored(), proposed_terms="proposed", noise="fit.noise",
    )  # fmt: skip

    @property
    def _judged(self) -> tuple[str, str]:
        """Which errors count: on validation records where there are any; and their name."""
        tested = np.isfinite(self.final_error["test"])
        return ("test", "validation") if tested else ("train", "training")

    def document(
        self, comparison: Comparison | None = None, *, train: Dataset | None = None, title: str = ""
    ) -> display.Report:
        """Return what is missing, step by step.

        Parameters
        ----------
        comparison : Comparison, optional
            Of the nominal and the improved model, best on validation records.
        train : Dataset, optional
            The training records, to draw residual forces against their signals.
        title : str
            Heading; by default the name of the model.
        """
        before, after = self.base_error, self.final_error
        which, records = self._judged
        tested = f", on the validation records {before['test']:.3g}"
        errors = self.yardstick.table(self.base_rms, self.steps[-1].rms if self.steps else None)
        return display.Report(
            title=title or self.base.name,
            subtitle="What the model lacks, and what it predicts with it",
            headline=f"{self.base.name}\n  nominal model: error on the training records "
            f"{before['train']:.3g} × noise" + ("" if np.isnan(before["test"]) else tested),
            answer=self._answer(),
            warnings=() if self.log is None else self.log.warning().splitlines(),
            numbers=(
                (f"error on {records} records, nominal", f"{before[which]:.3g} × noise"),
                ("improved", f"{after[which]:.3g} × noise"),
                ("effects added", str(len(self.steps))),
                ("candidates", str(len(self.ranking.scores))),
            ),
            sections=(
                self._glance(train),
                *self.location.document(train).sections,
                *self.ranking.document(hidden=self.last is None).sections,
                self._story(),
                display.Section("Errors", self.yardstick.notes(), (errors,)),
                display.Section("What to believe, and what to do next at sea", self.advice),
                *([] if comparison is None else comparison.document().sections),
                self._estimates(),
                display.Section(
                    "Equations of the improved model", listing=self.model.equations(), only="page"
                ),
            ),
            verdict=self._closing(),
        )

    report = display.as_text

    def _answer(self) -> str:
        """What is missing, and what it is worth on the validation records."""
        which, records = self._judged
        steps = self.headlined
        path = (self.base_error, *(step.errors for step in steps))
        before, after = path[0][which], path[-1][which]
        kind = self.remains.kind
        effects = (f"{in_words(step.effect, self.base)} ({step.added})" for step in steps)
        size = f" ({self.remains.size})" * bool(self.remains.size and len(steps) == len(self.steps))
        return say(
            "answer", self._row("answer"),
            model=self.base.name, effects=" and ".join(effects), records=records, kind=kind,
            them="it" if len(steps) == 1 else "them", error=before, after=after,
            goes="falls" if after < before else "does not fall: it goes", size=size,
        )  # fmt: skip

    def _row(self, table: str) -> str:
        """Row of a table of sentences: of the verdict, or of verdict and what is left."""
        verdict, kind = self.verdict, self.remains.kind
        row = f"{verdict}, {'open' if verdict == 'missing' and kind in OPEN else kind}"
        return row if row in SAYS[table] else verdict

    def _story(self) -> display.Section:
        """The steps, or why there is none, and what the training records alone would have said."""
        tables, lines = self._asked(), list[str]()
        if self.steps:
            headers = ("effect added", *TERMS, "training error", "validation error")
            rows = [("(nominal)", "", "", "", "", *_cells(".3g", *self.base_error.values()))]
            for step in self.steps:
                errors = _cells(".3g", step.train_error, step.test_error)
                rows.append((step.added, *_terms(step.claim), *errors))
                if others := ", ".join(step.group[1:]):
                    lines.append(say("story", "alike", name=step.added, others=others))
            tables = (display.Table(headers, rows), *tables)
        else:
            lines.append(SAYS["story"][self._row("story")])
            best = self.ranking.refits[0] if self.ranking.refits else None
            if best is not None and hopeful(best, 0.0) and best.gain < best.needed:
                gains = {"gain": best.gain, "needed": best.needed}
                lines.append(say("story", "hint", name=best.name, **gains))
        if self.rejected:
            lines.append(say("story", "refused", names=", ".join(self.rejected)))
        return display.Section("What is missing", lines, tables)

    def _asked(self) -> tuple[display.Table, ...]:
        """Every decision with every term of it."""
        if not self.decisions:
            return ()
        headers = ("asked", *TERMS, "whole runs before", "after", "decision")
        rows = [
            (one.name, *_terms(one), *_cells(".3g", one.before, one.after), one.decision)
            for one in self.decisions
        ]
        return (display.Table(headers, rows, words=(7,)),)

    def _glance(self, train: Dataset | None) -> display.Section:
        """What was found, in two pictures; on a page."""
        half = 5.6, 3.6  # inches, of one of two pictures beside each other
        caption = SAYS["captions"]["plot_error_fall"]
        figures = [display.Figure("plot_error_fall", self, caption, size=half)]
        if train is not None and self.location.forces:
            leaves = ", and what the effect that was found would leave there" * bool(self.steps)
            caption = say("captions", "plot_force_found", leaves=leaves)
            figures.append(display.Figure("plot_force_found", self, caption, (train,), size=half))
        return display.Section(
            "At a glance", [*self._meanings()], figures=figures, only="page", beside=True
        )

    def _meanings(self) -> Iterator[str]:
        """What the effects added are, in words with their formulas, and how large."""
        sizes = {row["name"]: row for row in self.parameters}
        for step in self.steps:
            parts = (in_words(step.effect, self.base), *_shown(step, sizes))
            yield f"{step.added}: {'; '.join(parts)}."

    def _estimates(self) -> display.Section:
        """Estimates after the last step, beside those without the effects; on a page."""
        nominal = self.base.values
        rows = []
        for one in self.parameters:
            name, value, error = one["name"], one["value"], one["std_error"]
            relative = f"{100 * error / abs(value):.2g} %" if value else ""
            without = f"{nominal[name]:.5g}" if name in nominal else ""
            shown = display.rounded(value, display.TWO_SIDED_95 * error)
            rows.append((name, shown, f"{error:.2g}", relative, without, one["unit"]))
        headers = ("parameter", "value", "std. error", "relative", "without the effects", "unit")
        added = {parameter.name for step in self.steps for parameter in step.effect.parameters}
        marked = tuple(i for i, row in enumerate(rows) if row[0] in added)
        table = display.Table(headers, rows, marked=marked)
        return display.Section("Estimates", tables=(table,), only="page")

    def _closing(self) -> list[str]:
        lines = []
        for term in self.proposed:
            lines.append(say("story", "term", **term))
            others = [name for name in term["group"] if name != term["term"]]
            if others:
                lines.append(say("story", "alike_term", others=", ".join(others[:MOST_DRAWN])))
            if term["replaces"]:
                lines.append(say("story", "replaces", names=", ".join(term["replaces"])))
        return [*lines, *(f"Note: {note}" for note in self.notes), f"Verdict: {self.conclusion}"]


def _cells(form: str, *values: float) -> list[str]:
    """Numbers of a table; a dash for what there is not."""
    return ["-" if np.isnan(value) else f"{value:{form}}" for value in values]


# The terms of a decision, as tables have them.
TERMS = ("training", "validation", "T", "threshold")


def _terms(one: Claim) -> list[str]:
    """The terms of a decision: training, validation, T and threshold."""
    return _cells(".1f", one.training, one.validation, one.statistic, one.needed)


def advice(result: Improvement) -> list[str]:
    """Sentences for whoever goes to sea again.

    Parameters
    ----------
    result : Improvement
        Its steps and estimates; its rankings, of which the last says what would not have shown.
    """
    known = {score.effect.name: score.effect for score in result.ranking.scores}
    estimates = {row["name"]: row for row in result.parameters}
    believe, doubt, sea = list[str](), list[str](), list[str]()
    before, kind = result.base_error["test"], result.remains.kind
    for step in result.steps:
        other = _other_law(step, result.steps, estimates)
        stands_for = "what is still missing" if kind in OPEN else other
        found, doubts = _judged(step, estimates, before, stands_for, sized=kind in EXPLAINED)
        believe += found * (step in result.headlined)
        doubt += doubts
        sea += _manoeuvre(step.group, known, bool(result.base.inputs))
        before = step.test_error
    doubt += _left_open(result.steps, result.last or result.ranking, kind)
    lists = {
        "Only if the log is right" if kind == "log suspect" else "Believe": believe,
        "Do not believe": doubt,
        "Next at sea": list(dict.fromkeys(sea)),
    }
    filled = ([f"{title}:", *(f"  - {one}" for one in of)] for title, of in lists.items() if of)
    return [*chain.from_iterable(filled)]


def _other_law(step: Any, steps: Sequence[Any], estimates: Mapping[str, Mapping[str, Any]]) -> str:
    """The law that an effect may stand for together with one that acts against it, in words.

    Two forces that are functions of one signal in one equation are one law of it; where one undoes
    part of the other, neither is that law.
    """
    found = _law(step.effect, estimates)
    for other in steps if found else ():
        rival = _law(other.effect, estimates)
        if found and rival and found[0] == rival[0] and found[1] * rival[1] < 0.0:
            return f"another law of {found[0][1]}, as {other.added} acts against it"
    return ""


def _law(
    effect: Effect, estimates: Mapping[str, Mapping[str, Any]]
) -> tuple[tuple[str, str], float] | None:
    """Equation and signal of a force that is a function of one, and its value at one unit of it."""
    own = {p.name: estimates.get(p.name, {}).get("value", p.value) for p in effect.parameters}
    terms = list(effect.terms.items()) if isinstance(effect, Force) else []
    if len(terms) != 1 or len(signals := names(terms[0][1]) - own.keys()) != 1:
        return None
    ((axis, text),), (signal,) = terms, signals
    return (str(axis), signal), float(to_numpy(text, {**own, signal: 1.0}, effect.callable))


def _judged(
    step: Any,
    estimates: Mapping[str, Mapping[str, Any]],
    before: float,
    stands_for: str,
    *,
    sized: bool,
) -> tuple[list[str], list[str]]:
    """What one step claims, perhaps with sizes, and what is not to be believed."""
    own = [(estimates[p.name], p) for p in step.effect.parameters if p.name in estimates]
    shown = ", ".join(_shown(step, estimates))
    unknown = ", ".join(p.name for row, p in own if not _is_told(row, p))
    rivals, predicted = step.group[1:], step.claim.validation
    # Correlated residuals widen the interval after a claim.
    told = any(abs(row["value"]) > display.TWO_SIDED_95 * row["std_error"] for row, _ in own)
    absent = {"zero": own and not told, "elsewhere": predicted < -GROUP_WIDTH}
    doubts = absent | {
        "size": unknown,
        "alone": step.test_error > RISE * before,
        "rivals": rivals,
        "untested": np.isnan(predicted),
    }
    facts = {
        "what": " or ".join(step.group), "added": step.added, "shown": shown, "unknown": unknown,
        "rivals": ", ".join(rivals), "do": "does" if len(rivals) == 1 else "do",
        "sized": f": {shown}" * bool(sized and shown and not rivals), "stands_for": stands_for,
        "agree": ", the validation records agree" * (predicted > 0), "predicted": predicted,
        "error": before, "after": step.test_error,
    }  # fmt: skip
    helps = say("believe", "stands" if stands_for else "missing", **facts)
    said = [say("doubt", row, **facts) for row, applies in doubts.items() if applies]
    return [] if any(absent.values()) else [helps], said


def _left_open(steps: Sequence[Any], ended: Ranking, kind: str) -> list[str]:
    """What would not have shown in these records, is free already, or makes errors too small."""
    added = {name for step in steps for name in (step.added, *step.group)}
    imitated = [name for name in ended.imitated() if name not in added]
    hidden = sorted(set(ended.undetectable()) - added - set(imitated))
    are, their = ("is", "its") if len(hidden) == 1 else ("are", "their")
    names = {"hidden": listed(hidden, MOST_DRAWN), "imitated": listed(imitated, MOST_DRAWN)}
    doubts = {
        "hidden": hidden,
        "imitated": imitated,
        "errors": kind not in (*EXPLAINED, "not known"),
        "errors, not known": kind == "not known",
    }
    facts = names | {"are": are, "their": their}
    return [say("doubt", row, **facts) for row, applies in doubts.items() if applies]


def _manoeuvre(group: Sequence[str], known: Mapping[str, Any], commanded: bool) -> list[str]:
    """What tells the members of a group apart; nothing of one alone."""
    if len(group) < 2:
        return []
    members = [name for name in group if name in known]
    needs = "; ".join(sorted({known[name].needs for name in members} - {""}))
    lines = [say("next", "apart", names=" from ".join(group[:3]), needs=needs)] if needs else []
    return lines + [say("next", "design", names=" ".join(members))] * commanded


def _is_told(row: Mapping[str, Any], parameter: Parameter) -> bool:
    """Whether the records give a size: its interval leaves out what was possible, or nothing."""
    widest = min(parameter.upper - parameter.lower, 2.0 * SPAN * parameter.magnitude)
    return bool(display.TWO_SIDED_95 * row["std_error"] < max(widest, abs(row["value"])))


def _unit(unit: str) -> str:
    return "" if unit in ("", "1") else f" {unit}"


def _size(row: Mapping[str, Any], parameter: Parameter) -> str:
    name, value, unit = row["name"], f"{row['value']:.3g}", _unit(row["unit"])
    if rests(parameter, row["value"]):
        return f"{name} = {value}{unit}, at its bound"
    if not _is_told(row, parameter):
        return f"{name} about {value}{unit}"
    size = display.interval(row["value"], display.TWO_SIDED_95 * row["std_error"])
    return f"{name} = {size}{unit} (95 %)"


def _shown(step: Any, estimates: Mapping[str, Mapping[str, Any]]) -> Iterator[str]:
    """The sizes of an effect, and the ranges of those that differ from record to record."""
    own = step.effect.parameters
    yield from (_size(estimates[p.name], p) for p in own if p.name in estimates)
    for parameter in own:
        if parameter.per_record:
            name = parameter.name
            found = [local[name] for local in step.fit.local_values if name in local]
            low, high = f"{min(found):.3g}", f"{max(found):.3g}"
            yield f"{name} from {low} to {high}{_unit(parameter.unit)}, by record"
