r"""Further roll decay tests: which part of a log is the free decay.

A log shows rest, the push, the decay and perhaps what came after the tow was stopped. The decay
begins at the first turning point after the largest angle, which is where the model was let go. With
amplitudes

.. math:: a_k = |\phi_{k+1} - \phi_k| / 2

of successive turning points, free of a constant heel, it ends before the first that is below a
fifth of the first or one degree, or above the smallest so far by a tenth (a free decay never
grows), and where the speed falls below nine tenths of that at the beginning.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from benchmarks.scoreboard.row import place
from benchmarks.scoreboard.table import read_table
from oed_sysid import Channels, Record
from oed_sysid.errors import DataError
from problems.roll_decay.problem import SCALE

FOLDER = "kvlcc2_roll_decay"
KNOWN = ("model_test_21337", "model_test_parameters", "model_test_units")
# Speeds of the tests by their publisher, knots of the ship; used where the log itself does not
# show that the model was towed.
STATED = {"model_test_21338": 0.0, "model_test_21340": 15.5}
KNOT = 0.514444  # m/s
SAMPLING = 0.05  # s kept, as in the problem's own records
LEAST_SHARE, LEAST_ANGLE = 0.2, np.radians(1.0)  # of the first amplitude; rad
GROWTH = 1.1
SLOWED, TOWED = 0.9, 0.1  # share of the speed at the beginning; m/s of the model
SWINGS = 5  # turning points of the least decay that tells something
LARGEST = 1.0  # rad
TOLD_HEEL = 0.05  # deg; above it the note says that the models have none
COLUMNS = {
    "t_s": ("t", "time", "time_s", ""),
    "x_m": ("x",),
    "y_m": ("y",),
    "phi_rad": ("phi",),
}


@dataclass(frozen=True)
class Decay:
    """The free part of one test.

    Parameters
    ----------
    record : Record
        Roll angle from the first turning point after the release, times from zero.
    begin : float
        Where this is in the log, s.
    speed : float
        Mean speed of the model in it, m/s.
    knots : float
        The ship's speed, as measured; as stated if the log shows none.
    first, last : float
        Amplitudes at its ends, rad.
    remark : str
        What must be said about it; empty if nothing.
    """

    record: Record
    begin: float
    speed: float
    knots: float
    first: float
    last: float
    remark: str = ""

    @property
    def towed(self) -> bool:
        """Whether the model had a speed."""
        return self.knots > TOWED * np.sqrt(SCALE) / KNOT

    @property
    def text(self) -> str:
        """Speed, duration and amplitudes."""
        first, last = np.degrees([self.first, self.last])
        return (
            f"{self.knots:.1f} kn; {self.record.duration:.0f} s from {self.begin:.1f} s on, "
            f"{first:.1f} to {last:.1f} deg" + (f"; {self.remark}" if self.remark else "")
        )


def further() -> list[Path]:
    """Decay tests in the data folder beside the registered one."""
    found = place(FOLDER).glob("*.csv")
    return sorted(path for path in found if path.stem not in KNOWN)


def read_decay(path: Path, channels: Channels) -> Decay:
    """The free decay of a log in the form of ``model_test_21337.csv``.

    Raises
    ------
    DataError
        If the log has no such decay, or cannot be read.
    """
    table = read_table(path, COLUMNS)
    times, phi = table.numbers("t_s"), table.numbers("phi_rad")
    places = np.column_stack([table.numbers("x_m"), table.numbers("y_m")])
    step = _step(path.name, times)
    if np.abs(phi).max() > LARGEST:
        raise DataError(
            f"{path.name}: the roll angle reaches {np.abs(phi).max():.3g}; expected less than "
            f"{LARGEST:g} rad. Is it in degrees? Give radians."
        )
    speeds = _speeds(times, places, step)
    points = _turning_points(path.name, phi, step)
    amplitudes = np.abs(np.diff(phi[points])) / 2
    begin = points[0]
    swings = _ends(amplitudes)
    whole = swings == len(amplitudes)
    end = len(phi) - 1 if whole else points[swings]
    early = speeds[begin : begin + round(10.0 / step)]
    own = float(np.median(early))
    remark = ""
    if own > TOWED:
        slow = np.flatnonzero(speeds[begin:end] < SLOWED * own)
        if len(slow):
            end = begin + int(slow[0])
            remark = f"cut where the tow slows down, {times[end]:.1f} s"
    inside = np.flatnonzero(points <= end)
    if len(inside) < SWINGS:
        raise DataError(
            f"{path.name} has {len(inside)} turning points of the roll angle in its free decay; "
            f"expected {SWINGS} or more. Put a longer test there."
        )
    knots = own * np.sqrt(SCALE) / KNOT
    stated = STATED.get(path.stem)
    if own <= TOWED:
        knots = stated or 0.0
        if stated:
            remark = f"speed as stated, positions show {own:.2f} m/s"
    used = phi[points[inside]]
    heel = float(np.degrees(np.mean(0.5 * (used[1:] + used[:-1]))))
    if abs(heel) > TOLD_HEEL:
        remark = "; ".join(filter(None, (remark, f"about a heel of {heel:.2f} deg, not modelled")))
    thin = max(1, round(SAMPLING / step))
    rows = slice(begin, end + 1, thin)
    record = Record(
        path.stem,
        times[rows] - times[begin],
        np.empty((len(times[rows]), 0)),
        phi[rows, np.newaxis],
        channels,
        path.name,
    )
    last = amplitudes[min(inside[-1], len(amplitudes)) - 1]
    return Decay(
        record, float(times[begin]), own, float(knots), float(amplitudes[0]), float(last), remark
    )


def _step(file: str, times: np.ndarray) -> float:
    """Time between samples, s, which must not have gaps."""
    if len(times) < 100:
        raise DataError(f"{file} has {len(times)} samples; expected a test of some minutes.")
    steps = np.diff(times)
    step = float(np.median(steps))
    if steps.min() <= 0 or steps.max() > 5 * step:
        k = int(np.argmin(steps) if steps.min() <= 0 else np.argmax(steps))
        raise DataError(
            f"{file}: after {times[k]:.2f} s the next sample is at {times[k + 1]:.2f} s; expected "
            f"steps near {step:.3g} s. Sort the rows, and cut the log at its gaps."
        )
    if step > 2 * SAMPLING:
        raise DataError(
            f"{file} has {step:.3g} s between samples; expected {2 * SAMPLING:g} s at most, with "
            "the time in s."
        )
    return step


def _speeds(times: np.ndarray, places: np.ndarray, step: float) -> np.ndarray:
    """Speed over a second about each sample, m/s, ``(n,)``."""
    half = max(1, round(0.5 / step))
    index = np.arange(len(times))
    low, high = np.maximum(index - half, 0), np.minimum(index + half, len(times) - 1)
    return np.hypot(*(places[high] - places[low]).T) / (times[high] - times[low])


def _turning_points(file: str, phi: np.ndarray, step: float) -> np.ndarray:
    """Samples of the turning points from the first after the largest angle on."""
    span = float(phi.max() - phi.min())
    width = max(1, round(0.1 / step))
    smooth = np.convolve(np.pad(phi, width, mode="edge"), np.ones(width) / width, mode="same")
    smooth = smooth[width:-width]
    prominence = max(0.05 * span, np.radians(0.3))
    found = [find_peaks(sign * smooth, prominence=prominence)[0] for sign in (1, -1)]
    points = _alternating(*found)
    if span / 2 < 1.5 * LEAST_ANGLE or len(points) < SWINGS:
        raise DataError(
            f"{file}: the roll angle spans {np.degrees(span):.2f} degrees with {len(points)} "
            f"turning points; expected a decay from {1.5 * np.degrees(LEAST_ANGLE):g} degrees or "
            "more. Is phi_rad the roll angle in radians?"
        )
    rest = float(np.median(phi[: points[0]])) if points[0] > round(5.0 / step) else 0.0
    release = int(np.argmax(np.abs(smooth[points] - rest)))
    return points[release + 1 :]


def _alternating(crests: np.ndarray, troughs: np.ndarray) -> np.ndarray:
    """Crests and troughs in turn; of neighbours of one kind (a flat top has two) the first."""
    signs = np.concatenate([np.ones(len(crests)), -np.ones(len(troughs))])
    points = np.concatenate([crests, troughs])
    order = np.argsort(points)
    points, signs = points[order], signs[order]
    return points[np.diff(signs, prepend=0.0) != 0]


def _ends(amplitudes: np.ndarray) -> int:
    """How many amplitudes belong to the free decay."""
    if not len(amplitudes):
        return 0
    least = max(LEAST_SHARE * amplitudes[0], LEAST_ANGLE)
    smallest = np.minimum.accumulate(amplitudes)
    over = np.flatnonzero((amplitudes < least) | (amplitudes > GROWTH * smallest))
    return int(over[0]) if len(over) else len(amplitudes)
