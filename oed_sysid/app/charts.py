r"""Pictures to zoom and point into (plotly), for people: angles in degrees, a unit on every axis.

The tabs of a result's page that hold them are at the end: :func:`tabs_of`.

Signals of one record stand above each other on one axis of time: zoom one, and all follow. A band
holds 95 % of new measurements (1.96 standard deviations either way).

A replay shows the track and the attitude: a hull of unit length in space, turned from body axes
into north, east and down by the Euler angles that were measured or predicted (:math:`c = \cos`,
:math:`s = \sin`):

.. math::

    R(\phi, \theta, \psi) = R_z(\psi) R_y(\theta) R_x(\phi) = \begin{bmatrix}
    c\psi\,c\theta & c\psi\,s\theta\,s\phi - s\psi\,c\phi & c\psi\,s\theta\,c\phi + s\psi\,s\phi \\
    s\psi\,c\theta & s\psi\,s\theta\,s\phi + c\psi\,c\phi & s\psi\,s\theta\,c\phi - c\psi\,s\phi \\
    -s\theta & c\theta\,s\phi & c\theta\,c\phi \end{bmatrix}

``phi`` (roll), ``theta`` (pitch) and ``psi`` (heading) are in rad inside and in degrees in words.
An angle that a record does not hold is drawn as zero and left out of the words. Fossen (2021),
*Handbook of marine craft hydrodynamics and motion control*, eq. 2.31.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
import plotly.graph_objects as go
import streamlit as st
from plotly.subplots import make_subplots
from scipy.spatial.transform import Rotation

from oed_sysid import Dataset, Fit, Input, Output, Record, State
from oed_sysid.app import visit
from oed_sysid.cli.study import Outcome
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.locate import CLEAR, Located
from oed_sysid.likelihood.disturbances import Place
from oed_sysid.results.chart import Chart, Mark
from oed_sysid.results.fit_plots import Said, chart_signal, said_of
from oed_sysid.results.improvement_plots import chart_residual, clearest
from oed_sysid.results.style import COLOURS, DATA, NEUTRAL, TRUTH, model_style, shown
from oed_sysid.text.units import shown_unit

MEASURED = "#8a929a"
_SYMBOLS = {"s": "square-open", "_": "line-ew-open"}
DASHES: dict[Any, str] = {"--": "dash", "-": "solid", "-.": "dashdot", ":": "dot"}
# On dark ground: the first two colours of models, as light as the others.
_LIT = dict(zip(COLOURS, ("#F08A3C", "#56B4E9"), strict=False))
# Samples of one line that a browser draws without stutter.
_MOST = 4000


def name_of(channel: Input | Output | State) -> str:
    """Words, symbol and unit of a signal, as people read it.

    >>> name_of(Output("r", "rad/s", "yaw rate")), name_of(Input("n", "1/s"))
    ('yaw rate r [deg/s]', 'n [1/s]')
    """
    words = [channel.label] if channel.label and channel.label != channel.name else []
    return " ".join([*words, channel.name, f"[{shown_unit(channel.unit)[1] or '-'}]"])


def signals(record: Record, models: Sequence[Said] = ()) -> go.Figure:
    """Draw outputs and inputs of a record, and what models say about it, over one axis of time.

    Parameters
    ----------
    record : Record
        What was measured.
    models : sequence of Said
        From :func:`~oed_sysid.results.fit_plots.said_of`.

    Returns
    -------
    plotly.graph_objects.Figure
        One row of axes per signal.

    Examples
    --------
    >>> from oed_sysid import Channels
    >>> channels = Channels((Input("rudder", "rad"),), (Output("psi", "rad"),))
    >>> record = Record("a", np.arange(5.0), [0.1] * 5, np.pi * np.arange(5.0) / 4, channels)
    >>> [round(float(y), 1) for y in signals(record).data[0].y]
    [0.0, 45.0, 90.0, 135.0, 180.0]
    """
    rows: list[Output | Input] = [*record.channels.outputs, *record.channels.inputs]
    charts = [chart_signal(record, channel, models) for channel in rows]
    return drawn(*charts, height=150 * (len(rows) + 1))


def lit(colour: str) -> str:
    """The colour of a model, lighter where the page is dark."""
    return _LIT.get(colour, colour) if st.context.theme.type == "dark" else colour


def drawn(*charts: Chart, height: int = 340) -> go.Figure:
    """Draw what :class:`~oed_sysid.results.chart.Chart` describes, to zoom and point into.

    Several stand above each other on one axis.
    """
    rows, named = len(charts), set[str]()
    figure = make_subplots(rows, 1, shared_xaxes=True, vertical_spacing=0.12 / max(rows, 2))
    for row, chart in enumerate(charts, start=1):
        place: dict[str, Any] = {"row": row, "col": 1}
        for trace in (one for mark in chart.marks for one in _traces(mark)):
            first = bool(trace.name) and trace.name not in named
            named.add(trace.name)
            figure.add_trace(trace.update(showlegend=first, legendgroup=trace.name), **place)
        _axes_of(figure, chart, place)  # an empty one would take no line across
    figure.update_xaxes(title_text=plain(charts[-1].x_label), row=rows, col=1)
    return laid_out(figure, height)


def _axes_of(figure: go.Figure, chart: Chart, place: dict[str, Any]) -> None:
    """What is written along the axes of a chart, and across them."""
    *words, label = plain(chart.y_label).split("\n")
    figure.update_yaxes(title_text=label, title_font_size=13, **place)
    for text in words:
        figure.add_annotation(
            text=text, xref="x domain", yref="y domain", x=0.0, y=1.0, xanchor="left",
            yanchor="bottom", showarrow=False, font={"size": 12}, **place,
        )  # fmt: skip
    if chart.level is not None:
        low, high = chart.level - chart.band, chart.level + chart.band
        figure.add_hrect(y0=low, y1=high, fillcolor=MEASURED, opacity=0.3, line_width=0, **place)
        figure.add_hline(y=chart.level, line_width=1, line_color=MEASURED, **place)
    if chart.logarithmic:
        values = [digit * 10.0**power for power in range(-3, 7) for digit in (1, 2, 5)]
        texts = [f"{value:g}" for value in values]
        every = np.concatenate([np.asarray(mark.y, float) for mark in chart.marks])
        span = np.log10([0.8 * np.nanmin(every), 1.7 * np.nanmax(every)]).tolist()
        figure.update_yaxes(type="log", tickvals=values, ticktext=texts, range=span, **place)
    if chart.names:
        ends = [-0.4, len(chart.names) - 0.4]
        ticks = {"tickvals": list(range(len(chart.names))), "ticktext": chart.names}
        figure.update_xaxes(**ticks, range=ends, **place)


def _traces(mark: Mark) -> Iterator[go.Scatter]:
    """The band of a mark, where it has one, and its points."""
    kept = slice(None, None, max(-(-np.size(mark.x) // _MOST), 1))  # every n-th of many
    x, y = (np.asarray(one)[kept] for one in (mark.x, mark.y))
    half = None if mark.half is None else np.asarray(mark.half)[kept]
    colour = MEASURED if mark.colour in (DATA, NEUTRAL, TRUTH) else lit(mark.colour)
    if half is not None and mark.dashes:
        if np.isfinite(half).all():
            yield _band(x, y - half, y + half, colour, mark.band or f"95 % ({mark.label})")
        half = None
    yield go.Scatter(
        x=x, y=y, name=mark.label, mode=_mode(mark),
        marker={"size": 3 if mark.marker == "." else 9, "color": colour,
                "symbol": _SYMBOLS.get(mark.marker, "circle"),
                "opacity": 0.35 if mark.faint else 1.0},
        line={"color": colour, "width": 1.8, "dash": DASHES.get(mark.dashes, "longdash"),
              "shape": "hv" if mark.held else None},
        error_y={"array": half, "visible": half is not None}, text=list(mark.texts),
        textposition="top right", hoverinfo="skip" if mark.faint else None,
    )  # fmt: skip


def _mode(mark: Mark) -> str:
    """What is drawn of a mark, in plotly's words."""
    parts = {"lines": mark.dashes, "markers": mark.marker, "text": any(mark.texts)}
    return "+".join(name for name, there in parts.items() if there)


def _band(x: np.ndarray, low: np.ndarray, high: np.ndarray, colour: str, name: str) -> go.Scatter:
    """What lies between two curves."""
    red, green, blue = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return go.Scatter(
        x=[*x, *x[::-1]], y=[*high, *low[::-1]], fill="toself", name=name, hoverinfo="skip",
        fillcolor=f"rgba({red},{green},{blue},0.18)", line={"width": 0},
    )  # fmt: skip


def plain(label: str) -> str:
    r"""A label of matplotlib without its mathematics.

    >>> plain(r"yaw rate $r$ [deg/s]"), plain(r"residual $\dot{r}$")
    ('yaw rate r [deg/s]', 'residual r')
    """
    return re.sub(r"\$[^$]*\$", lambda m: re.sub(r"\\(dot|mathrm)?|[{}$_]", "", m[0]), label)


def chain(located: Located) -> str:
    """Return the signal chain as HTML, each place coloured by how close it comes to the best."""
    stages = []
    for stage, words in _STAGES.items():
        here = [place for place in located.places if place.stage == stage]
        if not here and stage != "command":
            continue
        inner = (
            "".join(_box(located, place) for place in here)
            or '<span class="place l0">as logged</span>'
        )
        stages.append(f'<div class="stage"><h4>{words}</h4>{inner}</div>')
    return f'<div class="oed-chain">{"<b>→</b>".join(stages)}</div>'


def _box(located: Located, place: Place) -> str:
    """One place of the chain, coloured by how far its gain is behind the best one."""
    gain = located.gains.get(place.name, 0.0)
    behind = located.top - gain
    best = " best" if place.name == located.best else ""
    level = 4 if place.name in located.group else 0
    if not level and gain > CLEAR:
        # Three strengths of one colour.
        level = 1 + (behind < 0.5 * located.top) + (behind < 0.1 * located.top)
    said = "best" if best else f"{behind:,.0f} behind" if gain > CLEAR else "chance"
    size = located.levels.get(place.name, 0.0)
    tip = f"{place.name}: likelihood-ratio statistic {gain:.0f}; size {size:.2g} {place.unit}"
    return (
        f'<span class="place l{level}{best}" title="{escape(tip)}">'
        f"{escape(place.signal)}<small>{said}</small></span>"
    )


# Stages of the chain, and what they are called.
_STAGES = {
    "command": "command", "actuator": "actuator", "flow": "flow", "force": "forces",
    "kinematics": "kinematics", "sensor": "sensors",
}  # fmt: skip


def laid_out(figure: go.Figure, height: int) -> go.Figure:
    """Give a picture its height (px), its margins and its legend above."""
    figure.update_layout(
        height=height, margin={"l": 70, "r": 20, "t": 50, "b": 50}, hovermode="closest",
        legend={"orientation": "h", "y": 1.0, "yref": "container", "yanchor": "top", "x": 0.0,
                "itemsizing": "constant"},
    )  # fmt: skip
    figure.update_xaxes(showspikes=True, spikemode="across", spikethickness=1)
    figure.update_yaxes(exponentformat="power")  # 10⁻⁷ N, not 100n
    return figure


# -- replay -------------------------------------------------------------------------------

# A track: outputs on the upward and on the rightward axis, the first pair that is measured.
TRACKS = (("x", "y"), ("north", "east"), ("x0", "y0"), ("z", "x"))
# Names of the Euler angles among outputs, and what people call them.
ANGLES: Mapping[str, tuple[tuple[str, ...], str]] = {
    "phi": (("phi", "roll"), "roll"),
    "theta": (("theta", "pitch"), "pitch"),
    "psi": (("psi", "heading", "yaw"), "heading"),
}
HULL = np.loadtxt(Path(__file__).with_name("hull.csv"), delimiter=",")


def rotation(phi: float, theta: float, psi: float) -> np.ndarray:
    """Return the matrix ``(3, 3)`` that turns body axes into north, east, down.

    Parameters
    ----------
    phi, theta, psi : float
        Roll, pitch, heading, rad.

    Examples
    --------
    The bow of a vehicle that heads east and pitches up by 30 degrees points east and upwards.

    >>> (rotation(0.0, np.pi / 6, np.pi / 2) @ [1.0, 0.0, 0.0]).round(3).tolist()
    [0.0, 0.866, -0.5]
    """
    return np.asarray(Rotation.from_euler("ZYX", (psi, theta, phi)).as_matrix())


def track_axes(record: Record) -> tuple[str, str] | None:
    """Outputs that make a track: up and right; None where positions are not measured."""
    names = record.channels.output_names
    for up, right in TRACKS:
        if up in names and right in names:
            seen = np.isfinite(record.output(up)) & np.isfinite(record.output(right))
            if seen.sum() > 1:
                return up, right
    return None


def angles_of(record: Record) -> dict[str, str]:
    """Outputs that were measured of the attitude, by Euler angle.

    >>> from oed_sysid import Channels, Output
    >>> channels = Channels((), (Output("pitch", "rad"), Output("z", "m")))
    >>> angles_of(Record("a", np.arange(5.0), [], np.zeros((5, 2)), channels))
    {'theta': 'pitch'}
    """
    measured = {*record.channels.output_names} - {*record.missing_outputs}
    found = {angle: next(filter(measured.__contains__, names), "")
             for angle, (names, _) in ANGLES.items()}  # fmt: skip
    return {angle: name for angle, name in found.items() if name}


def can_replay(record: Record) -> bool:
    """Whether a record holds a track or an attitude."""
    return track_axes(record) is not None or bool(angles_of(record))


@dataclass(frozen=True, eq=False)
class _Path:
    """One vehicle: what was measured of it, or what a model says.

    Parameters
    ----------
    name : str
        What it is called.
    record : Record
        Its times and channels.
    rows : ndarray (n_times, n_outputs)
        Outputs, SI.
    colour, dash : str
        How it is drawn.
    """

    name: str
    record: Record
    rows: np.ndarray
    colour: str
    dash: str

    def at(self, moment: float, output: str, *, angle: bool = False) -> float:
        """Value of an output at a moment, s; on a line between samples, angles without jumps."""
        column = self.rows[:, self.record.channels.output_names.index(output)]
        seen = np.isfinite(column)
        if not seen.any():
            return 0.0
        values = np.unwrap(column[seen]) if angle else column[seen]
        return float(np.interp(moment, self.record.times[seen], values))

    def attitude(self, moment: float) -> dict[str, float]:
        """Euler angles at a moment, rad; those that are not measured are left out."""
        found = angles_of(self.record)
        return {angle: self.at(moment, name, angle=True) for angle, name in found.items()}


def replay(record: Record, models: Mapping[str, np.ndarray], frames: int = 60) -> go.Figure:
    """Draw track and attitude as measured and as models follow them, to be replayed with a slider.

    Parameters
    ----------
    record : Record
        With positions, or with at least one Euler angle.
    models : mapping of str to ndarray
        Outputs ``(n_times, n_outputs)`` by name, SI.
    frames : int
        Moments of the replay.

    Returns
    -------
    plotly.graph_objects.Figure
        The track on the left and the hull in space on the right, as far as they are measured.
    """
    axes, turned = track_axes(record), bool(angles_of(record))
    kinds = ([{"type": "xy"}] if axes else []) + ([{"type": "scene"}] if turned else [])
    figure = make_subplots(1, len(kinds), specs=[kinds], horizontal_spacing=0.04)
    paths = [_Path("measured", record, record.outputs, MEASURED, "solid")]
    for number, (name, rows) in enumerate(models.items()):
        look = model_style(number)
        dash = DASHES.get(str(look.dashes), "longdash")
        paths.append(_Path(name, record, np.asarray(rows), lit(look.colour), dash))
    if axes:
        _map(figure, paths, axes)
    still = len(figure.data)
    moments = np.linspace(record.times[0], record.times[-1], frames).tolist()
    for trace, column in _vehicles(paths, axes, turned, moments[0]):
        figure.add_trace(trace, row=1, col=column)
    figure.frames = [
        go.Frame(
            data=[trace for trace, _ in _vehicles(paths, axes, turned, moment)],
            traces=list(range(still, len(figure.data))), name=f"{moment:.1f}",
            layout={"annotations": _words(paths, moment, axes) if turned else []},
        )
        for moment in moments
    ]  # fmt: skip
    if turned:
        figure.update_layout(annotations=_words(paths, moments[0], axes))
        _scene(figure)
    _controls(figure, redraw=turned)
    figure.update_layout(margin={"l": 70, "r": 20, "t": 40 + 20 * len(paths) * turned, "b": 60})
    return figure


def _vehicles(
    paths: list[_Path], axes: tuple[str, str] | None, turned: bool, moment: float
) -> Iterator[tuple[go.Scatter | go.Scatter3d, int]]:
    """What moves, and in which column: a mark on the track and a hull in space, per vehicle."""
    for path in paths:
        attitude = path.attitude(moment)
        if axes:
            yield _mark(path, attitude, axes, moment), 1
        if turned:
            north, east, down = rotation(*(attitude.get(name, 0.0) for name in ANGLES)) @ HULL.T
            dash = path.dash if path.dash in ("solid", "dash", "dot") else "dash"
            line = {"color": path.colour, "width": 6, "dash": dash}
            hull = go.Scatter3d(x=east, y=north, z=-down, mode="lines", name=path.name, line=line,
                                legendgroup=path.name, showlegend=axes is None,
                                hoverinfo="skip")  # fmt: skip
            yield hull, 2 if axes else 1


def _mark(
    path: _Path, attitude: Mapping[str, float], axes: tuple[str, str], moment: float
) -> go.Scatter:
    """A vehicle on its track: an arrow along its heading or, in a vertical plane, its pitch."""
    vertical = axes[0] == "z"
    angle = attitude.get("theta" if vertical else "psi")
    look = {"size": 16, "symbol": "circle", "color": path.colour}
    if angle is not None:
        points = float(np.degrees(angle))
        look |= {"symbol": "arrow", "angle": 90.0 - points if vertical else points}
    x, y = ([path.at(moment, name)] for name in axes[::-1])
    return go.Scatter(x=x, y=y, mode="markers", showlegend=False, hoverinfo="skip",
                      legendgroup=path.name, marker=look)  # fmt: skip


def _words(paths: list[_Path], moment: float, axes: tuple[str, str] | None) -> list[dict]:
    """The angles of all vehicles at a moment, degrees, above the picture."""
    lines = []
    for path in paths:
        turned = path.attitude(moment).items()
        said = ", ".join(f"{ANGLES[name][1]} {np.degrees(angle):.1f}°" for name, angle in turned)
        lines.append(f"{path.name}: {said}")
    return [{
        "text": "<br>".join(lines), "xref": "paper", "yref": "paper", "align": "left",
        "x": 0.56 if axes else 0.0, "y": 1.0, "xanchor": "left", "yanchor": "bottom",
        "showarrow": False, "font": {"size": 13},
    }]  # fmt: skip


def _scene(figure: go.Figure) -> None:
    """Axes of space: the same scale on all, seen from astern, starboard and above."""
    span = {"range": [-0.55, 0.55], "showticklabels": False, "showspikes": False}
    figure.update_scenes(
        xaxis={**span, "title": {"text": "east"}},
        yaxis={**span, "title": {"text": "north"}},
        zaxis={**span, "title": {"text": "up"}},
        aspectmode="cube",
        camera={"eye": {"x": 1.35, "y": -1.6, "z": 0.85}},
        dragmode="orbit",
    )


def _map(figure: go.Figure, paths: Sequence[_Path], axes: tuple[str, str]) -> None:
    """The tracks: the same scale on both axes, names with units, depth downwards."""
    by_name = {channel.name: channel for channel in paths[0].record.channels.outputs}
    for path in paths:
        x, y = (path.rows[:, list(by_name).index(one)] for one in axes[::-1])
        seen = np.isfinite(x) & np.isfinite(y)
        figure.add_scatter(
            x=x[seen], y=y[seen], mode="lines", name=path.name, legendgroup=path.name,
            line={"color": path.colour, "dash": path.dash, "width": 1.6}, row=1, col=1,
        )  # fmt: skip
    figure.update_xaxes(title_text=name_of(by_name[axes[1]]))
    figure.update_yaxes(title_text=name_of(by_name[axes[0]]), scaleanchor="x", scaleratio=1)
    if axes[0] == "z":
        figure.update_yaxes(autorange="reversed")


def _controls(figure: go.Figure, *, redraw: bool) -> None:
    """A slider over time, and buttons that play and pause; hulls in space need a redraw."""
    laid_out(figure, 600)
    still = {"mode": "immediate", "frame": {"duration": 0, "redraw": redraw}}
    play = {"frame": {"duration": 80, "redraw": redraw}, "fromcurrent": True,
            "transition": {"duration": 0}}  # fmt: skip

    def animate(label: str, frames: Any, how: dict[str, Any]) -> dict[str, Any]:
        return {"label": label, "method": "animate", "args": [frames, how]}

    figure.update_layout(
        sliders=[{
            "currentvalue": {"prefix": "t = ", "suffix": " s"}, "pad": {"t": 60}, "len": 0.84,
            "x": 0.16, "steps": [animate(one.name, [one.name], still) for one in figure.frames],
        }],
        updatemenus=[{
            "type": "buttons", "direction": "left", "x": 0.0, "y": -0.12, "yanchor": "top",
            "xanchor": "left", "pad": {"t": 50}, "showactive": False,
            "buttons": [animate("Play", None, play), animate("Pause", [None], still)],
        }],
    )  # fmt: skip


# -- tabs --------------------------------------------------------------------------------

Tabs = dict[str, Callable[[], None]]


def chart(figure: go.Figure, key: str) -> None:
    """Show a picture."""
    settings = {"displaylogo": False, "scrollZoom": False}
    st.plotly_chart(figure, width="stretch", key=key, config=settings)


def tabs_of(outcome: Outcome, train: Dataset | None, key: str) -> Tabs:
    """Tabs of pictures of an outcome: signals, replay, signal chain, residual force.

    Parameters
    ----------
    outcome : Outcome
    train : Dataset or None
        Training records.
    key : str
        Of the widgets.
    """
    found, located = outcome.comparison, getattr(outcome.result, "location", None)
    tabs: Tabs = {}
    if found is not None:
        said = "The band holds 95 % of new measurements: uncertain parameters and noise together."
        models = {part.label: part.prediction for part in found.models}
        tabs["Signals"] = partial(_signals, found.dataset, models, said, key)
        if any(map(can_replay, found.dataset)):
            tabs["Replay"] = partial(_replay, found, key)
    elif isinstance(fit := outcome.result, Fit):
        said = "The band holds 95 % of the noise."
        tabs["Signals"] = partial(_signals, fit.dataset, {"nominal": fit}, said, key)
    return tabs if located is None else tabs | _located(outcome.result, located, train, key)


def _located(result: Any, located: Located, train: Dataset | None, key: str) -> Tabs:
    """Tabs on where a model fails."""
    tabs: Tabs = {"Signal chain": partial(_chain, located)}
    fit = getattr(result, "base_fit", None)
    records = train if fit is None else fit.dataset
    lengths = [one.times.size for one in located.forces]
    if located.force_names and records and lengths == [one.times.size for one in records]:
        tabs["Residual force"] = partial(_force, located, records, fit, key)
    return tabs


def _record(dataset: Dataset, key: str) -> int:
    """Ask which record."""
    if len(dataset) == 1:
        return 0
    name = st.selectbox("Record", dataset.names, key=f"record:{key}")
    return dataset.names.index(name) if name in dataset.names else 0


def _signals(dataset: Dataset, models: Mapping[str, Any], said: str, key: str) -> None:
    """Signals of one record and what models say about them."""
    record = dataset[_record(dataset, key)]
    said_by = said_of([*models.values()], record, [*models])
    chart(signals(record, said_by), f"chart:{key}")
    st.caption(f"{said} Drag to zoom, double-click to go back; a click on the legend hides a line.")


def _replay(found: Comparison, key: str) -> None:
    able = [record for record in found.dataset if can_replay(record)]
    record = able[_record(Dataset(tuple(able)), f"replay:{key}")]
    index = found.dataset.names.index(record.name)
    models = {part.label: part.prediction.outputs[index] for part in found.models}
    chart(replay(record, models), f"replay:{key}")
    measured = angles_of(record)
    absent = [words for angle, (_, words) in ANGLES.items() if angle not in measured]
    said = "Drag the hull to look at it from another side. " if measured else ""
    if measured and absent:
        said += f"Not measured, and drawn as zero: {', '.join(absent)}."
    if said:
        st.caption(said)


def _chain(located: Located) -> None:
    st.html(chain(located))
    st.caption(
        "How far the likelihood-ratio statistic of something unknown at each place is behind "
        f"that of the best, {located.top:,.0f}: the stronger the "
        "colour, the likelier the place. Outlined: the best. By chance "
        f"the statistic is up to {CLEAR:.0f}."
    )


def _force(located: Located, dataset: Dataset, fit: Fit | None, key: str) -> None:
    left, right = st.columns(2)
    first = located.force_names.index(located.equation)
    equation = left.selectbox(
        "Residual force of", located.force_names, index=first, key=f"equation:{key}"
    )
    axes = _axes(dataset, fit)
    best = clearest(located, str(equation), {name: where for name, (_, where) in axes.items()})
    first = list(axes).index(best)
    signal = right.selectbox("Against", list(axes), index=first, key=f"against:{key}")
    if equation not in located.force_names or signal not in axes:
        return
    channel, where = axes[signal]
    where = shown(channel, where)
    made = chart_residual(located, equation, where, name_of(channel), channel.name)
    chart(drawn(made), f"force:{key}")
    st.caption(
        "The smoothed residual force is what the free parameters could not absorb of the missing "
        "force, not the missing force itself."
    )


def _axes(
    dataset: Dataset, fit: Fit | None
) -> dict[str, tuple[Input | Output | State, np.ndarray]]:
    """Signals at all times of all records: states of the fit, commands, measurements."""
    found: dict[str, tuple[Input | Output | State, np.ndarray]] = {}

    kinds: list[tuple[str, Sequence[Input | Output | State], Sequence[Any]]] = [
        ("command", dataset.channels.inputs, [record.inputs for record in dataset]),
        ("measured", dataset.channels.outputs, [record.outputs for record in dataset]),
    ]
    if fit is not None and [*map(len, fit.states)] == [record.times.size for record in dataset]:
        kinds.insert(0, ("state", fit.model.states, fit.states))
    for kind, channels, rows in kinds:
        for column, channel in enumerate(channels):
            values = np.concatenate([one[:, column] for one in rows])
            if np.isfinite(values).any():
                found[f"{name_of(channel)}, {kind}"] = channel, values
    return found


def look_at(dataset: Dataset, key: str) -> None:
    """Signals of records as they were measured."""
    name = st.selectbox("Look at", dataset.names, key=visit.kept("look", key))
    if name in dataset.names:
        record = dataset[name]
        if record.missing_outputs:
            st.caption(f"Not measured: {', '.join(record.missing_outputs)}")
        if record.ignored_columns:
            st.caption(f"Columns not used: {', '.join(record.ignored_columns)}")
        chart(signals(record), f"look:{key}")
