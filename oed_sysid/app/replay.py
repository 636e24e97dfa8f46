r"""A record replayed: the track as measured and as models follow it, and the vehicle's attitude.

The attitude is drawn as a hull of unit length in space, turned from body axes into north, east and
down by the Euler angles that were measured or predicted (:math:`c = \cos`, :math:`s = \sin`):

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

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import plotly.graph_objects as go
from plotly.subplots import make_subplots

from oed_sysid.app.charts import MEASURED, laid_out, line_of_model, name_of
from oed_sysid.data.dataset import Record

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
    (cr, cp, cy), (sr, sp, sy) = np.cos((phi, theta, psi)), np.sin((phi, theta, psi))
    return np.array([
        (cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr),
        (sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr),
        (-sp, cp * sr, cp * cr),
    ])  # fmt: skip


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
        colour, dash = line_of_model(number)
        paths.append(_Path(name, record, np.asarray(rows), colour, dash))
    if axes:
        for path in paths:
            x, y = (path.rows[:, record.channels.output_names.index(one)] for one in axes[::-1])
            seen = np.isfinite(x) & np.isfinite(y)
            figure.add_scatter(
                x=x[seen], y=y[seen], mode="lines", name=path.name, legendgroup=path.name,
                line={"color": path.colour, "dash": path.dash, "width": 1.6}, row=1, col=1,
            )  # fmt: skip
    still = len(figure.data)
    moments = np.linspace(record.times[0], record.times[-1], frames)
    for trace, column in _vehicles(paths, axes, turned, float(moments[0])):
        figure.add_trace(trace, row=1, col=column)
    moved = list(range(still, len(figure.data)))
    figure.frames = [
        go.Frame(
            data=[trace for trace, _ in _vehicles(paths, axes, turned, float(moment))],
            traces=moved, name=f"{moment:.1f}",
            layout={"annotations": _words(paths, float(moment), axes) if turned else []},
        )
        for moment in moments
    ]  # fmt: skip
    if turned:
        figure.update_layout(annotations=_words(paths, float(moments[0]), axes))
        _scene(figure)
    if axes:
        _map(figure, record, axes)
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
            # The arrow shows the heading, or in a vertical plane the pitch.
            vertical = axes[0] == "z"
            angle = attitude.get("theta" if vertical else "psi")
            points = 0.0 if angle is None else float(np.degrees(angle))
            if vertical and angle is not None:
                points = 90.0 - points
            look = {"size": 16, "symbol": "circle" if angle is None else "arrow",
                    "angle": points, "color": path.colour}  # fmt: skip
            x, y = ([path.at(moment, name)] for name in axes[::-1])
            yield go.Scatter(x=x, y=y, mode="markers", showlegend=False, hoverinfo="skip",
                             legendgroup=path.name, marker=look), 1  # fmt: skip
        if turned:
            north, east, down = rotation(*(attitude.get(name, 0.0) for name in ANGLES)) @ HULL.T
            dash = path.dash if path.dash in ("solid", "dash", "dot") else "dash"
            line = {"color": path.colour, "width": 6, "dash": dash}
            yield go.Scatter3d(x=east, y=north, z=-down, mode="lines", name=path.name, line=line,
                               legendgroup=path.name, showlegend=axes is None,
                               hoverinfo="skip"), 2 if axes else 1  # fmt: skip


def _words(paths: list[_Path], moment: float, axes: tuple[str, str] | None) -> list[dict]:
    """The angles of all vehicles at a moment, degrees, above the picture."""
    lines = []
    for path in paths:
        said = ", ".join(
            f"{ANGLES[name][1]} {np.degrees(angle):.1f}°"
            for name, angle in path.attitude(moment).items()
        )
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


def _map(figure: go.Figure, record: Record, axes: tuple[str, str]) -> None:
    """Axes of the track: the same scale on both, names with units, depth downwards."""
    by_name = {channel.name: channel for channel in record.channels.outputs}
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
    figure.update_layout(
        sliders=[{
            "currentvalue": {"prefix": "t = ", "suffix": " s"}, "pad": {"t": 60}, "len": 0.84,
            "x": 0.16, "steps": [
                {"label": frame.name, "method": "animate", "args": [[frame.name], still]}
                for frame in figure.frames
            ],
        }],
        updatemenus=[{
            "type": "buttons", "direction": "left", "x": 0.0, "y": -0.12, "yanchor": "top",
            "xanchor": "left", "pad": {"t": 50}, "showactive": False,
            "buttons": [
                {"label": "Play", "method": "animate", "args": [None, play]},
                {"label": "Pause", "method": "animate", "args": [[None], still]},
            ],
        }],
    )  # fmt: skip
