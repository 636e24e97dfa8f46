"""Pictures on the pages: signals of a record, where a model fails, the track."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np
import streamlit as st

from oed_sysid.app import charts, choices, replay
from oed_sysid.app.commands import factor
from oed_sysid.data.dataset import Dataset
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.locate import CLEAR, Located
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.channels import Input, Output, State

Tabs = dict[str, Callable[[], None]]
_SETTINGS = {"displaylogo": False, "scrollZoom": False}


def chart(figure: object, key: str) -> None:
    """Show a picture."""
    st.plotly_chart(figure, width="stretch", key=key, config=_SETTINGS)


def of_fit(fit: Fit, key: str) -> Tabs:
    """Signals of a fit over its training records."""

    def draw() -> None:
        index = _record(fit.dataset, key)
        said = fit.predictions[index]
        models = {"nominal": (said, np.broadcast_to(fit.sigma, said.shape))}
        chart(charts.signals(fit.dataset[index], models), f"chart:{key}")
        st.caption("The band holds 95 % of the noise. Drag to zoom, double-click to go back.")

    return {"Signals": draw}


def of_comparison(found: Comparison, key: str) -> Tabs:
    """Signals of predictions; track and attitude where they are measured."""

    def draw() -> None:
        index = _record(found.dataset, key)
        chart(charts.comparison(found, index), f"chart:{key}")
        st.caption(
            "The band holds 95 % of new measurements: uncertain parameters and noise together. "
            "Drag to zoom, double-click to go back; a click on the legend hides a line."
        )

    tabs: Tabs = {"Signals": draw}
    if any(replay.can_replay(record) for record in found.dataset):
        tabs["Replay"] = partial(_replay, found, key)
    return tabs


def of_located(located: Located, dataset: Dataset, fit: Fit | None, key: str) -> Tabs:
    """The signal chain, and residual forces against any signal or state."""

    def draw() -> None:
        st.html(charts.chain(located))
        st.caption(
            "How far the likelihood-ratio statistic of something unknown at each place is behind "
            f"that of the best, {max(located.gains.values(), default=0.0):,.0f}: the stronger the "
            f"colour, the likelier the place. Outlined: the best. Chance gains up to {CLEAR:.0f}."
        )

    tabs: Tabs = {"Signal chain": draw}
    if located.force_names and charts.states_of(dataset, located):
        tabs["Residual force"] = partial(_force, located, dataset, fit, key)
    return tabs


def _record(dataset: Dataset, key: str) -> int:
    """Ask which record."""
    if len(dataset) == 1:
        return 0
    name = st.selectbox("Record", dataset.names, key=f"record:{key}")
    return dataset.names.index(name) if name in dataset.names else 0


def _replay(found: Comparison, key: str) -> None:
    names = [record.name for record in found.dataset if replay.can_replay(record)]
    name = names[0]
    if len(names) > 1:
        name = st.selectbox("Record", names, key=f"replay record:{key}") or names[0]
    index = found.dataset.names.index(name)
    record = found.dataset[index]
    models = {part.label: part.prediction.outputs[index] for part in found.models}
    chart(replay.replay(record, models), f"replay:{key}")
    measured = replay.angles_of(record)
    absent = [words for angle, (_, words) in replay.ANGLES.items() if angle not in measured]
    said = "Drag the hull to look at it from another side. " if measured else ""
    if measured and absent:
        said += f"Not measured, and drawn as zero: {', '.join(absent)}."
    if said:
        st.caption(said)


def _force(located: Located, dataset: Dataset, fit: Fit | None, key: str) -> None:
    left, right = st.columns(2)
    worst = (located.best or "").removeprefix("force ")
    first = located.force_names.index(worst) if worst in located.force_names else 0
    equation = left.selectbox(
        "Residual force of", located.force_names, index=first, key=f"equation:{key}"
    )
    axes = _axes(dataset, fit)
    series = {name: where for name, (_, where) in axes.items()}
    clearest = charts.clearest(located, str(equation), series)
    against = right.selectbox("Against", list(axes), index=clearest, key=f"against:{key}")
    if equation not in located.force_names or against not in axes:
        return
    channel, where = axes[against]
    turn = factor(channel.unit)
    chart(charts.against(located, equation, where, charts.name_of(channel), turn=turn),
          f"force:{key}")  # fmt: skip
    st.caption(
        "The smoothed residual force is what the free parameters could not absorb of the missing "
        "force, not the missing force itself."
    )


def _axes(
    dataset: Dataset, fit: Fit | None
) -> Mapping[str, tuple[Input | Output | State, np.ndarray]]:
    """Signals at all times of all records: states of the fit, commands, measurements."""
    found: dict[str, tuple[Input | Output | State, np.ndarray]] = {}
    if fit is not None and _same_times(fit, dataset):
        for column, state in enumerate(fit.model.states):
            values = np.concatenate([rows[:, column] for rows in fit.states])
            found[f"{charts.name_of(state)}, state"] = state, values
    for column, one in enumerate(dataset.channels.inputs):
        values = np.concatenate([record.inputs[:, column] for record in dataset])
        found[f"{charts.name_of(one)}, command"] = one, values
    for column, output in enumerate(dataset.channels.outputs):
        values = np.concatenate([record.outputs[:, column] for record in dataset])
        if np.isfinite(values).any():
            found[f"{charts.name_of(output)}, measured"] = output, values
    return found


def _same_times(fit: Fit, dataset: Dataset) -> bool:
    rows: Sequence[np.ndarray] = fit.states
    return [len(one) for one in rows] == [record.times.size for record in dataset]


def look_at(dataset: Dataset, key: str) -> None:
    """Signals of records as they were measured."""
    name = st.selectbox("Look at", dataset.names, key=choices.kept("look", key))
    if name in dataset.names:
        record = dataset[name]
        if record.missing_outputs:
            st.caption(f"Not measured: {', '.join(record.missing_outputs)}")
        if record.ignored_columns:
            st.caption(f"Columns not used: {', '.join(record.ignored_columns)}")
        chart(charts.signals(record), f"look:{key}")
