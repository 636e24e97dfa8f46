"""Page 5: what a manoeuvre tells, and the manoeuvre that tells most."""

from __future__ import annotations

from functools import partial

import streamlit as st

from oed_sysid.app import choices, commands, plans
from oed_sysid.app.panels import Asked, command, download, html_download, work
from oed_sysid.app.panels import show as show_page
from oed_sysid.app.study import Study
from oed_sysid.errors import ProblemError
from oed_sysid.experiment import Experiment

_CRITERIA = {
    "D": "all parameters together (D)",
    "A": "mean error (A)",
    "E": "the worst combination (E)",
}
_RECORDS = "Training records"


def show(study: Study) -> None:
    """Draw the page."""
    st.header("Plan the next trial")
    view = st.segmented_control(
        "View",
        ("Rank", "Design"),
        required=True,
        key=choices.preset(choices.kept("plan"), "Rank"),
        label_visibility="collapsed",
    )
    if view == "Rank":
        _rank(study)
    else:
        _design(study)


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
    about = Asked("What trials tell", "rank", line)
    outcome = work("Rank", ("rank", runs, *study.key), about, partial(plans.rank, study, runs))
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
    about = Asked("Designed trial", "design", line)
    outcome = work(
        "Design", ("design", wish, *study.key), about, partial(plans.design, study, wish)
    )
    if outcome is not None:
        show_page(outcome.page)
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
    effort = third.selectbox("Effort", list(plans.EFFORTS), key=keep("effort"))
    ranges, rates = _limits(study, pattern)
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
        criterion,
        family,
        effort,
        rivals,
        bool(after),
        certainty or None,
    )


def _limits(
    study: Study, pattern: Experiment
) -> tuple[tuple[tuple[str, float, float], ...], tuple[tuple[str, float], ...]]:
    """Ask for range and rate of each commanded input; only changes are returned."""
    limits, ranges, rates = study.problem.limits, [], []
    for channel in study.problem.model.inputs:
        if channel.name not in limits.inputs or channel.name in pattern.constants:
            continue
        turn, words = commands.factor(channel.unit), channel.label or channel.name
        lower, upper = limits.inputs[channel.name]
        believed = limits.rates.get(channel.name)
        keys = partial(choices.kept, study.source, study.variant, channel.name)
        one, two, three = st.columns(3)
        least = one.number_input(
            f"{words}, least [{commands.shown(channel.unit)}]",
            format="%.4g",
            key=choices.preset(keys("least"), turn * lower),
        )
        most = two.number_input(
            f"largest [{commands.shown(channel.unit)}]",
            format="%.4g",
            key=choices.preset(keys("most"), turn * upper),
        )
        rate = three.number_input(
            f"rate [{commands.shown_rate(channel.unit)}]",
            min_value=0.0,
            value=None,
            placeholder="no limit" if believed is None else "as in the problem",
            format="%.4g",
            key=choices.preset(keys("rate"), believed and turn * believed),
        )
        if abs(least - turn * lower) + abs(most - turn * upper) > 1e-9 * abs(turn * upper):
            ranges.append((channel.name, least / turn, most / turn))
        if rate is not None and rate != (believed and turn * believed):
            rates.append((channel.name, rate / turn))
    return tuple(ranges), tuple(rates)
