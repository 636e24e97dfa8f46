"""Page 5: what a manoeuvre tells, and the manoeuvre that tells most."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import streamlit as st

from oed_sysid.app import choices, commands, plans, script
from oed_sysid.app.panels import command, download, html_download, message, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study
from oed_sysid.design.choices import EFFORTS
from oed_sysid.errors import DesignError, ProblemError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.physics.channels import Input, Output, State

_CRITERIA = {
    "D": "all parameters together (D)",
    "A": "mean error (A)",
    "E": "the worst combination (E)",
}
_RECORDS = "Training records"
Range = tuple[str, float, float]


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Plan the next trial")
    view = st.segmented_control(
        "View",
        ("Rank", "Design", "Programme"),
        required=True,
        key=choices.preset(choices.kept("plan"), "Rank"),
        label_visibility="collapsed",
    )
    if view == "Rank":
        _rank(study)
    elif view == "Design":
        _design(study)
    else:
        _programme(study)


def _rank(study: Study) -> None:
    names = tuple(study.problem.experiments)
    options = (*names, *([_RECORDS] if study.train is not None else ()))
    key = choices.preset(choices.kept("runs", study.source, study.variant), list(names or options))
    picked = st.multiselect("What is run", options, key=key)
    if not picked:
        st.caption("Choose a planned experiment, or the training records.")
        return
    if _RECORDS in picked and len(picked) > 1:
        raise ProblemError(f"Choose either planned experiments or {_RECORDS.lower()}, not both.")
    runs = () if _RECORDS in picked else tuple(name for name in names if name in picked)
    line = commands.rank(study, runs)
    about = Asked("Rank: what trials tell", "rank", line, script.rank(study, runs))
    outcome = work("Rank", about, study, plans.rank, runs)
    if outcome is not None:
        show_page(outcome.page)
        html_download(outcome.page, "rank")
    command(line)


def _design(study: Study) -> None:
    problem = study.problem
    if not problem.experiments:
        raise ProblemError(
            f"Problem {problem.name!r} has no experiment to take sampling and start from. Add one "
            "to its problem.py."
        )
    wish = _wish(study)
    line = commands.design(study, wish)
    if wish.after_fit:
        line = f"{commands.fit(study)}\n{line}"
    about = Asked("Design: the next trial", "design", line, script.design(study, wish))
    outcome = work("Design", about, study, plans.design, wish)
    if outcome is not None:
        page = outcome.page
        if danger := plans.risk(outcome.result):
            message(danger)
            page = replace(page, warnings=())
        show_page(page)
        for column, offer in zip(
            st.columns([1, 1, 1, 3]),
            (
                partial(html_download, outcome.page, "design"),
                partial(download, "Commands (CSV)", partial(plans.commands_csv, outcome.result),
                        "design.csv", "text/csv"),
                partial(download, "Card", outcome.result.sea_trial_card, "card.txt", "text/plain"),
            ),
            strict=False,
        ):  # fmt: skip
            with column:
                offer()
    command(line)


def _programme(study: Study) -> None:
    """Plan several runs together."""
    if not study.problem.experiments:
        raise ProblemError(
            f"Problem {study.problem.name!r} has no experiment to take settings from. Add one to "
            "its problem.py."
        )
    keys = partial(choices.kept, study.source, study.variant, "programme")
    columns = st.columns(4)
    runs = columns[0].number_input("Most runs", 1, 30, key=choices.preset(keys("runs"), 4))
    hours = columns[1].number_input(
        "Hours for everything", 0.0, value=None, placeholder="as many as it takes",
        key=choices.preset(keys("hours"), None), format="%.3g",
    )  # fmt: skip
    turnaround = columns[2].number_input(
        "Between two runs [min]", 0.0, key=choices.preset(keys("turnaround"), 10.0), format="%.3g"
    )
    criterion = columns[3].selectbox(
        "Sharpen", ("A", "D"), format_func=_CRITERIA.__getitem__, key=keys("criterion")
    )
    wish = plans.ProgrammeWish(int(runs), hours or None, float(turnaround), criterion)
    line = commands.programme(study, wish)
    about = Asked("Programme: several runs", "programme", line, script.programme(study, wish))
    outcome = work("Plan the runs", about, study, plans.programme, wish)
    if outcome is not None:
        show_page(outcome.page)
        left, right, _ = st.columns([1, 1, 2])
        with left:
            html_download(outcome.page, "programme")
        with right:
            made = partial(plans.tables, outcome.result)
            download("Commands of all runs (ZIP)", made, "runs.zip", "application/zip")
    command(line)


def _wish(study: Study) -> plans.DesignWish:
    """Ask what the experiment shall be."""
    problem, keep = study.problem, partial(choices.kept, study.source, study.variant)
    first, second, third = st.columns(3)
    like = first.selectbox("Start and sampling as in", list(problem.experiments), key=keep("like"))
    pattern = problem.experiment(like)
    duration = second.number_input(
        "Length [s]",
        1.0,
        1e5,
        format="%.4g",
        key=choices.preset(keep("duration", like), float(pattern.duration or 60.0)),
    )
    effort = third.selectbox("Effort", list(EFFORTS), key=keep("effort"))
    ranges, rates, corridors = _limits(study, pattern)
    first, second, third = st.columns(3)
    rivals = tuple(
        first.multiselect(
            "Tell apart",
            [effect.name for effect in problem.effects],
            key=choices.kept("rivals", study.source, study.variant),
            help="Candidates between which the trial shall decide. Empty: sharpen parameters.",
        )
    )
    criterion = second.selectbox(
        "Sharpen", list(_CRITERIA), format_func=_CRITERIA.__getitem__, disabled=bool(rivals),
        key=keep("criterion"),
    )  # fmt: skip
    family = third.selectbox("Commands", ("levels", "multisine", "pulses"), key=keep("family"))
    first, second, _ = st.columns(3, vertical_alignment="bottom")
    certainty = first.selectbox(
        "Keep limits on uncertain vehicles",
        (0.0, 0.9, 0.95, 0.99),
        format_func=lambda share: f"in {share:.0%} of them" if share else "only state the risk",
        key=keep("certainty"),
    )
    after = second.toggle(
        "Complete what the training records tell",
        key=keep("after"),
        disabled=study.train is None,
    )
    return plans.DesignWish(
        like,
        duration,
        ranges,
        rates,
        corridors,
        criterion,
        family,
        effort,
        rivals,
        bool(after),
        certainty or None,
    )


def _limits(
    study: Study, pattern: Experiment
) -> tuple[tuple[Range, ...], tuple[tuple[str, float], ...], tuple[Range, ...]]:
    """Ask for ranges and rates of commands and for corridors of signals; changes are returned."""
    limits, model = study.problem.limits, study.problem.model
    ranges: list[Range] = []
    corridors: list[Range] = []
    rates = []
    asked = [one for one in model.inputs
             if one.name in limits.inputs and one.name not in pattern.constants]  # fmt: skip
    signals: dict[str, State | Output] = {one.name: one for one in model.states}
    signals |= {one.name: one for one in model.outputs}
    for channel in asked:
        keys = partial(choices.kept, study.source, study.variant, channel.name)
        one, two = st.columns([2, 1], vertical_alignment="bottom")
        with one:
            ranges += _range(channel, limits.inputs[channel.name], keys("range"))
        turn, declared = commands.factor(channel.unit), limits.rates.get(channel.name)
        rate = two.number_input(
            f"Largest rate [{commands.shown_rate(channel.unit)}]",
            min_value=0.0,
            value=None,
            placeholder="no limit" if declared is None else "as in the problem",
            format="%.4g",
            key=choices.preset(keys("rate"), declared and turn * declared),
        )
        if rate is not None and rate != (declared and turn * declared):
            rates.append((channel.name, rate / turn))
    columns = st.columns(2)
    for place, (name, corridor) in enumerate(limits.signals.items()):
        if name in signals and np.isfinite(corridor).all():
            key = choices.kept(study.source, study.variant, "corridor", name)
            with columns[place % 2]:
                corridors += _range(signals[name], corridor, key)
    return tuple(ranges), tuple(rates), tuple(corridors)


def _range(channel: Input | Output | State, limits: tuple[float, float], key: str) -> list[Range]:
    """Ask for a range with a slider that reaches half as far again; nothing if it is as before."""
    turn = commands.factor(channel.unit)
    lower, upper = turn * limits[0], turn * limits[1]
    more = 0.5 * (upper - lower)
    step = float(f"{(upper - lower) / 100.0:.1g}")
    words = channel.label or channel.name
    choices.preset(key, (lower, upper))
    st.session_state[key] = tuple(st.session_state[key])  # a list, where it was kept
    chosen: Any = st.slider(
        f"{words} {channel.name} [{commands.shown(channel.unit)}]",
        min_value=lower - more,
        max_value=upper + more,
        step=step,
        format="%.4g",
        key=key,
    )
    least, most = chosen
    if abs(least - lower) + abs(most - upper) <= 1e-6 * (upper - lower):
        return []
    if not least < most:
        raise DesignError(f"The limits of {words} leave nothing between them. Draw them apart.")
    return [(channel.name, least / turn, most / turn)]
