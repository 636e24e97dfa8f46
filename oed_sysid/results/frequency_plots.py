"""Pictures in the frequency domain: magnitude, phase and coherence of records and models."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from oed_sysid.errors import DataError, located
from oed_sysid.evidence.frequency import TOLD, FrequencyComparison
from oed_sysid.results import style as draw
from oed_sysid.runtime.display import TWO_SIDED_95


def figure_frequency(found: FrequencyComparison, output: str) -> Figure:
    """Draw magnitude, phase and coherence of one output, a column for each input.

    Parameters
    ----------
    found : FrequencyComparison
        Of :func:`oed_sysid.evidence.frequency.compare_frequency`.
    output : str
        Which output.

    Returns
    -------
    Figure
        What was drawn on; the labels of its axes are what they show, in words.
    """
    record = found.record
    (j,) = located(DataError, "The comparison has no output", [output], record.outputs)
    figure, axes = draw.new_figure(
        3, len(record.inputs), size=(0.8 + 4.8 * len(record.inputs), 7.2), sharex=True
    )
    hertz = record.frequencies
    for i, command in enumerate(record.inputs):
        gain, turn, share = axes[:, i]
        told = record.told[:, j, i]
        # Where the records tell nothing their response is noise and would set the scale.
        measured = np.where(told, record.values[:, j, i], np.nan)
        half = TWO_SIDED_95 * record.errors[:, j, i]
        size = np.abs(measured)
        # In dB and degrees an error as large as the response itself has no lower end.
        low = 20.0 * np.log10(size / np.maximum(size - half, 0.01 * size))
        high = 20.0 * np.log10(1.0 + half / size)
        phase = _phase(measured, told)
        near = _nearest(phase, told)
        wide = np.degrees(np.minimum(half / size, np.pi))
        dots = {"fmt": ".", "color": draw.DATA, "elinewidth": 0.8, "label": "records"}
        gain.errorbar(hertz, _decibel(measured), np.array([low, high]), **dots)
        turn.errorbar(hertz, phase, wide, **dots)
        for place, one in enumerate(found.models):
            look, run = draw.model_style(place), one.values[:, j, i]
            gain.plot(hertz, _decibel(run), **look.line, label=one.label)
            turn.plot(hertz, _beside(run, near), **look.line)
        share.plot(hertz, record.coherence[:, j, i], color=draw.DATA, label="partial")
        share.plot(hertz, record.multiple[:, j], color=draw.NEUTRAL, ls="--", label="multiple")
        share.axhline(TOLD, color=draw.TRUTH, lw=0.8, ls=":")
        for ax in (gain, turn, share):
            low_end, high_end = ax.get_ylim()
            ax.fill_between(
                hertz, low_end, high_end, where=~told, color="0.93", step="mid", lw=0, zorder=0
            )
            ax.set(xscale="log", ylim=(low_end, high_end))
        said = " ".join(found.said_of(command, output))
        draw.done(gain, said, ylabel=f"{command} to {output}\nmagnitude [dB]", legend=3)
        draw.done(turn, ylabel="phase [deg]")
        share.set_ylim(0.0, 1.02)
        draw.done(share, ylabel="coherence", xlabel="frequency [Hz]", legend=2)
    return figure


def _decibel(values: np.ndarray) -> np.ndarray:
    """Magnitude in dB, SI."""
    return np.asarray(20.0 * np.log10(np.maximum(np.abs(values), np.finfo(float).tiny)))


def _phase(values: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Phase in degrees, continuous where the records tell of it."""
    phase = np.angle(values)
    if told.any():
        phase[told] = np.unwrap(phase[told])
    return np.degrees(phase)


def _beside(values: np.ndarray, phase: np.ndarray) -> np.ndarray:
    """Continuous phase in degrees, on the turn that is nearest to another on the whole."""
    found = np.degrees(np.unwrap(np.angle(np.nan_to_num(values))))
    return np.asarray(found + 360.0 * np.round(np.median(phase - found) / 360.0))


def _nearest(phase: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Phase at every frequency, where the records tell nothing that of the nearest told one."""
    if not told.any():
        return np.zeros(len(phase))
    known = np.flatnonzero(told)
    return np.interp(np.arange(len(phase)), known, phase[known])
