"""The pages on the tasks of a study: check, fit, compare, improve, plan."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import cycle
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import streamlit as st

from oed_sysid.app import visit
from oed_sysid.app.panels import (
    FITTED,
    IMPROVED,
    ask,
    download,
    message,
    result_of,
    written,
    zipped,
)
from oed_sysid.app.takeaway import finished, fits_of
from oed_sysid.cli.study import Outcome, Study
from oed_sysid.cli.tasks import Corrected, Played, Tables, patterns_of
from oed_sysid.errors import DesignError, ProblemError
from oed_sysid.evidence.check import why_not_more
from oed_sysid.evidence.preparation import prepared
from oed_sysid.physics.channels import Input, Output, State
from oed_sysid.text.units import shown_unit

if TYPE_CHECKING:
    from oed_sysid.evidence.improvement import Improvement

_RECORDS = "Training records"


def check(study: Study) -> None:
    """Whether the records agree with themselves; quick, so that nobody has to ask for it."""
    study.records()
    outcome = result_of(study, "check", {}, "Check", unasked=True)
    if outcome is not None and outcome.result.suspect:
        st.error(outcome.result.verdict, icon=":material/warning:")
        _files("Corrected copies (ZIP)", Corrected, outcome, study, "corrected.zip")
        if reason := why_not_more(outcome.result):
            st.warning(f"Not corrected: {reason}.")


def _files(label: str, kind: Any, outcome: Outcome, study: Study, file: str) -> None:
    """Offer the files that the command writes into a folder."""
    download(label, lambda: zipped(lambda to: [*kind(to).write(outcome, study)]), file)


def fit(study: Study) -> None:
    """Estimate the parameters of the nominal model."""
    study.training()
    result_of(study, "fit", {}, "Fit")


def compare(study: Study) -> None:
    """Where the model fails, on validation records and in the training records."""
    if _view("view", "Validation records", "Signal chain") == "Signal chain":
        study.training()
        result_of(study, "diagnose", {}, "Diagnose")
        return
    study.training(), study.validation()
    added = ask("compare", study, "added", [effect.name for effect in study.effects])
    result_of(study, "compare", {"added": added}, "Compare")


def improve(study: Study) -> None:
    """Find the missing effects, or keep a choice of them."""
    study.training()
    if study.test is None:
        none = (
            "There is no validation record, so what is found cannot be tested. Choose one on "
            "the page Data."
        )
        st.warning([*prepared(study.training(), None, enough=sys.maxsize).notes, none][0])
    found, below = st.container(), st.container()
    with below.expander("How the search is done"):
        most = int(ask("improve", study, "max_effects", place=st.columns(3)[0], max_value=6))
    with found:
        options = {"max_effects": most}
        outcome = result_of(study, "improve", options, "Find what is missing", glance=True)
        if outcome is not None:
            _tell_apart(study, outcome.result)
    if outcome is not None and study.test is not None:
        with below.expander("Take a step back: keep other effects, and compare the choices"):
            _step_back(study, outcome.result)


def plan(study: Study) -> None:
    """What a manoeuvre tells, and the manoeuvre or the programme that tells most."""
    views = {"Design": _design, "Programme": _programme, "Rank": _rank}
    left, right = st.columns(2, vertical_alignment="bottom")
    with left:
        view = views[_view("plan", *views)]
    with right:
        study, after = _known(study)
    view(study, {} if after is None else {"after": after})


# Models that a trial is planned for.
_IMPROVED, _FITTED, _NOMINAL = "improved model", "nominal model, as fitted", "nominal model"


def _models(study: Study) -> tuple[str, dict[str, str]]:
    """Key of the choice of a model, and files of the fits that there are; the best comes first."""
    files = {_IMPROVED: IMPROVED} if "improved" in fits_of(finished(study)) else {}
    files |= {_FITTED: FITTED} if study.train is not None else {}
    return visit.kept(study.source, study.variant, "planned for", *files.values()), files


def _known(study: Study) -> tuple[Study, Path | None]:
    """Ask which model a trial is planned for; what was found is carried on unless told so."""
    key, files = _models(study)
    offered = [*files, _NOMINAL]
    chosen = st.selectbox("Planned for the", offered, key=visit.preset(key, offered[0]))
    fits = fits_of(finished(study))
    saved = {file: fits[name] for file, name in ((IMPROVED, "improved"), (FITTED, "nominal"))
             if name in fits}  # fmt: skip
    file = files.get(str(chosen))
    return replace(study, saved=saved), None if file is None else Path(file)


def _view(name: str, *options: str) -> str:
    """Ask which part of a page is shown."""
    key = visit.preset(visit.kept(name), options[0])
    chosen = st.segmented_control(
        "View", options, required=True, key=key, label_visibility="collapsed"
    )
    return str(chosen)


# -- improve -----------------------------------------------------------------------------


def _tell_apart(study: Study, found: Improvement) -> None:
    """Lead from effects that cannot be told apart to the trial that tells them apart."""
    known = {effect.name for effect in study.effects}
    key = visit.kept(study.source, study.variant, "design", "discriminate")
    for step in found.steps:
        group = [name for name in step.group if name in known]
        words = f"Design the trial that tells {' and '.join(group)} apart"
        if len(group) > 1 and st.button(words, key=f"apart:{step.added}"):
            # The rivals are told apart from the model that has none of them.
            planned = {visit.kept("plan"): "Design", _models(study)[0]: _FITTED}
            st.session_state.update({key: group, **planned})
            st.switch_page(st.session_state["pages"]["Plan the next trial"])


def _step_back(study: Study, found: Improvement) -> None:
    """Choose which effects to keep, and judge several such choices side by side."""
    groups = _chosen_groups(study, found)
    if not groups:
        st.caption("Without an effect this is the nominal model.")
        return
    st.caption("Side by side: nominal; " + "; ".join(groups))
    title = f"Improve: with {'; '.join(groups)}"
    result_of(study, "compare", {"added": groups}, "Fit with these", file="kept", title=title)


def _chosen_groups(study: Study, found: Improvement) -> tuple[str, ...]:
    """Ask for groups of effects, kept one beside the other; ``a+b`` is a group of two."""
    known = [effect.name for effect in study.effects]
    keys = partial(visit.kept, study.source, study.variant)
    state, beside = st.session_state, keys("beside")
    held = [group for group in state.get(beside, []) if set(group.split("+")) <= set(known)]
    left, middle, right = st.columns([4, 1, 1], vertical_alignment="bottom")
    added = [step.added for step in found.steps if step.added in known]
    key = visit.preset(keys("effects"), added)
    now = "+".join(left.multiselect("Effects to keep", known, key=key, wrap=True))
    is_new = bool(now) and now not in held
    if middle.button("Add", key="add", help="Keep this choice, and put another beside it.",
                     disabled=not is_new, width="stretch"):  # fmt: skip
        state[beside] = [*held, now]
        st.rerun()
    if right.button("Undo", key="undo", help="Take the choice that was added last away.",
                    disabled=not held, width="stretch"):  # fmt: skip
        state[beside] = held[:-1]
        st.rerun()
    return (*held, *([now] if is_new else []))


# -- plan --------------------------------------------------------------------------------


def _rank(study: Study, known: dict[str, Any]) -> None:
    names = tuple(study.problem.experiments)
    offered = (*names, *([_RECORDS] if study.train is not None else ()))
    picked = ask("rank", study, "experiment", offered, first=names or offered)
    if not picked:
        st.caption("Choose a planned experiment, or the training records.")
        return
    runs = tuple(name for name in names if name in picked)
    known = {name: file for name, file in known.items() if file.name in study.saved}
    if _RECORDS not in picked:
        result_of(study.without_records(), "rank", {"experiment": runs, **known}, "Rank")
    elif runs:
        raise ProblemError(f"Choose either planned experiments or {_RECORDS.lower()}, not both.")
    else:
        result_of(study, "rank", known, "Rank")


def _ask_all(task: str, study: Study, names: str, offers: dict[str, Any]) -> dict[str, Any]:
    """Ask for options in rows of four."""
    listed = names.split()
    found = {}
    for place in range(0, len(listed), 4):
        for column, name in zip(st.columns(4), listed[place : place + 4], strict=False):
            found[name] = ask(task, study, name, offers.get(name), place=column)
    return found


def _of_trials(study: Study) -> dict[str, Any]:
    """What there is to choose from for a trial."""
    patterns_of(study.problem, None)  # which says it where there is none
    effects = [effect.name for effect in study.effects]
    runs = list(study.problem.experiments)
    return {"like": runs, "patterns": runs, "discriminate": effects, "detect": effects}


def _design(study: Study, known: dict[str, Any]) -> None:
    names = "like duration effort family discriminate detect criterion sea certainty"
    options = _ask_all("design", study, names, _of_trials(study))
    limits = tuple(_limits(study, options["like"]))
    outcome = result_of(study, "design", {**options, **known, "limit": limits}, "Design")
    if outcome is None:
        return
    if danger := risk(outcome.result):
        message(danger)
    left, right, _ = st.columns([1, 1, 3])
    with left:
        download("Commands (CSV)", partial(commands_csv, outcome, study), "design.csv")
    with right:
        download("Card", outcome.result.sea_trial_card, "card.txt")


def commands_csv(outcome: Outcome, study: Study) -> bytes:
    """Return the commands of a design as the file that an autopilot plays."""
    return written("design.csv", lambda path: [*Played(path).write(outcome, study)])


def _programme(study: Study, known: dict[str, Any]) -> None:
    """Plan several runs together."""
    offers = _of_trials(study)
    names = "runs hours turnaround criterion patterns discriminate detect sea"
    options = _ask_all("programme", study, names, offers)
    options["runs"] = options["runs"] or 4
    outcome = result_of(study, "programme", {**options, **known}, "Plan the runs")
    if outcome is not None:
        _files("Commands of all runs (ZIP)", Tables, outcome, study, "runs.zip")


def risk(design: Any) -> str:
    """Say what a design risks, where it leaves the limits more often than may be.

    Returns
    -------
    str
        Empty where limits are kept on the share of vehicles that was wanted, or on 90 %.
    """
    stated = design.assurance
    if stated is None or stated.is_safe:
        return ""
    return (
        f"{stated.danger} Left first: {', '.join(stated.left)}. Take narrower commands, wider "
        "limits, or ask for limits that are kept on uncertain vehicles."
    )


def _limits(study: Study, like: str) -> Iterator[str]:
    """Ask for ranges and rates of commands and for corridors of signals; say what is changed."""
    limits, model = study.problem.limits, study.problem.model
    constants = study.problem.experiment(like).constants
    keys = partial(visit.kept, study.source, study.variant)
    for channel in model.inputs:
        if channel.name not in limits.inputs or channel.name in constants:
            continue
        left, right = st.columns([2, 1], vertical_alignment="bottom")
        yield from _range(left, channel, limits.inputs[channel.name], keys(channel.name, "range"))
        yield from _rate(right, channel, limits.rates.get(channel.name), keys(channel.name, "rate"))
    signals: dict[str, State | Output] = {one.name: one for one in model.states}
    signals |= {one.name: one for one in model.outputs}
    bounded = {n: ends for n, ends in limits.signals.items() if np.isfinite(ends).all()}
    columns = cycle(st.columns(2))
    for name in filter(signals.__contains__, bounded):
        yield from _range(next(columns), signals[name], bounded[name], keys("corridor", name))


def _rate(place: Any, channel: Input, declared: float | None, key: str) -> Iterator[str]:
    """Ask for the largest rate of a command; nothing if it is as before."""
    turn, unit = shown_unit(channel.unit)
    first = None if declared is None else turn * declared
    rate = place.number_input(
        f"Largest rate [{unit or '1'}/s]", min_value=0.0, format="%.4g",
        placeholder="no limit" if first is None else "as in the problem",
        key=visit.preset(key, first),
    )  # fmt: skip
    if rate is not None and rate != first:
        yield f"{channel.name}-rate={rate:.12g}"


def _range(
    place: Any, channel: Input | Output | State, limits: tuple[float, float], key: str
) -> Iterator[str]:
    """Ask for a range with a slider that reaches half as far again; nothing if it is as before."""
    turn, unit = shown_unit(channel.unit)
    lower, upper = turn * limits[0], turn * limits[1]
    more = 0.5 * (upper - lower)
    words = channel.label or channel.name
    visit.preset(key, (lower, upper))
    least, most = place.slider(
        f"{words} {channel.name} [{unit or '-'}]", min_value=lower - more, max_value=upper + more,
        step=float(f"{(upper - lower) / 100.0:.1g}"), format="%.4g", key=key,
    )  # fmt: skip
    if abs(least - lower) + abs(most - upper) > 1e-6 * (upper - lower):
        if not least < most:
            raise DesignError(f"The limits of {words} leave nothing between them: draw them apart.")
        yield f"{channel.name}={least:.12g}:{most:.12g}"
