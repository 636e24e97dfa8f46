r"""Roll decay of KVLCC2: small angles of one test, and further tests predicted from it.

.. math:: I \ddot\phi = K_p \dot\phi + K_{|p|p} |\dot\phi| \dot\phi - C \phi + K_{\phi^3} \phi^3

Tests at zero speed are predicted with inertia, restoring and damping of the registered test
(21337), their start state estimated, nothing else. At speed the damping is another: there, besides,
damping (and inertia) are fitted to the first half of the decay, and its second half is predicted.
What all zero-speed tests together say about linear and quadratic damping is told with standard
errors.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from benchmarks.harness import TWO_SIDED_95
from benchmarks.scoreboard.row import Row, attempted, columns, missing, place
from oed_sysid import Channels, Dataset, Fit, Model, MultipleShooting, Record, load_problem
from oed_sysid.errors import DataError
from problems.roll_decay.problem import END, RELEASE, SCALE, decay

FOLDER = "kvlcc2_roll_decay"
REGISTERED = "model_test_21337"
KNOWN = (REGISTERED, "model_test_parameters", "model_test_units")
AWAITED = {"21338": "0 kn", "21340": "15.5 kn"}  # further tests of the source
KNOT = 0.514444  # m/s
SAMPLING = 0.05  # s kept, as in the problem's own records
LEAST_SHARE, LEAST_ANGLE = 0.2, np.radians(1.0)  # of the first amplitude; rad
GROWTH, LARGEST = 1.1, 1.0  # rad
SLOWED, TOWED = 0.9, 0.1  # share of the speed at the beginning; m/s of the model
SWINGS = 5  # turning points of the least decay that tells something
STRUCTURES = {
    "linear": (),
    "quadratic damping": ("roll_quadratic_damping",),
    "cubic restoring and quadratic damping": ("roll_cubic_restoring", "roll_quadratic_damping"),
}
FULL = "cubic restoring and quadratic damping"
LINEAR, QUADRATIC, INERTIA = "K_p", "E_roll_quadratic_damping", "I_xx"
SYMBOLS = {LINEAR: "K_p", QUADRATIC: "K_abspp"}
ESTIMATOR = MultipleShooting(disturbances="none")
# Two terms are separated if each is outside its 95 % interval about zero, and the estimates
# correlate by less than this.
MOST_CORRELATED = 0.97


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
    amplitudes : ndarray
        Half the differences of its successive turning points, rad.
    """

    record: Record
    begin: float
    speed: float
    amplitudes: np.ndarray

    @property
    def towed(self) -> bool:
        """Whether the model had a speed."""
        return self.speed > TOWED

    @property
    def title(self) -> str:
        """Run and speed of the ship."""
        knots = self.speed * np.sqrt(SCALE) / KNOT if self.towed else 0.0
        return f"roll decay {self.record.name.removeprefix('model_test_')} ({knots:.3g} kn)"

    @property
    def text(self) -> str:
        """Duration and amplitudes."""
        first, last = np.degrees(self.amplitudes[[0, -1]])
        span = f"{self.record.duration:.0f} s from {self.begin:.1f} s on"
        return f"{span}, {first:.1f} to {last:.1f} deg"


def further() -> list[Path]:
    """Decay tests in the data folder beside the registered one."""
    found = place(FOLDER).glob("*.csv")
    return sorted(path for path in found if path.stem not in KNOWN)


def read_decay(path: Path, channels: Channels) -> Decay:
    """The free decay of a log in the form of ``model_test_21337.csv``.

    It begins at the first turning point after the largest angle, and ends before the first
    amplitude below :data:`LEAST_SHARE` of the first or :data:`LEAST_ANGLE`, or above
    :data:`GROWTH` times the smallest so far, or where the tow slows down.

    Raises
    ------
    DataError
        If the log has no such decay, or cannot be read.
    """
    times, phi, north, east = columns(path, "t_s", "phi_rad", "x_m", "y_m")
    steps = np.diff(times)
    step = float(np.median(steps)) if len(steps) else 0.0
    if not 0 < step <= 2 * SAMPLING or steps.min() <= 0 or steps.max() > 5 * step:
        raise DataError(
            f"{path.name}: expected steps in time of {2 * SAMPLING:g} s at most, without gaps. "
            "Sort the rows, and cut the log at its gaps."
        )
    if np.abs(phi).max() > LARGEST:
        raise DataError(f"{path.name}: phi_rad exceeds {LARGEST:g} rad. Give radians.")
    points = _turning_points(phi, step)
    amplitudes = np.abs(np.diff(phi[points])) / 2
    smallest = np.minimum.accumulate(amplitudes)
    least = np.maximum(LEAST_SHARE * amplitudes[:1], LEAST_ANGLE)
    over = np.flatnonzero((amplitudes < least) | (amplitudes > GROWTH * smallest))
    end = points[over[0]] if len(over) else len(phi) - 1
    half = max(1, round(0.5 / step))
    low = np.maximum(np.arange(len(phi)) - half, 0)
    high = np.minimum(np.arange(len(phi)) + half, len(phi) - 1)
    speeds = np.hypot(north[high] - north[low], east[high] - east[low]) / (times[high] - times[low])
    begin = points[0] if len(points) else end
    speed = float(np.median(speeds[begin : begin + round(10.0 / step)]))
    slow = np.flatnonzero(speeds[begin:end] < SLOWED * speed) if speed > TOWED else []
    end = begin + slow[0] if len(slow) else end
    inside = int(np.sum(points <= end))
    if inside < SWINGS:
        raise DataError(
            f"{path.name} has {inside} turning points of the roll angle in its free decay; "
            f"expected {SWINGS} or more. Put a longer test there, with the angle in radians."
        )
    rows = slice(begin, end + 1, max(1, round(SAMPLING / step)))
    own = times[rows] - times[begin]
    record = Record(path.stem, own, np.empty((len(own), 0)), phi[rows, None], channels, path.name)
    return Decay(record, float(times[begin]), speed, amplitudes[: inside - 1])


def _turning_points(phi: np.ndarray, step: float) -> np.ndarray:
    """Samples of crests and troughs in turn, from the first after the largest angle on."""
    width = max(1, round(0.1 / step))
    smooth = np.convolve(np.pad(phi, width, mode="edge"), np.ones(width) / width, mode="same")
    smooth = smooth[width:-width]
    prominence = max(0.05 * float(np.ptp(phi)), np.radians(0.3))
    crests, troughs = (find_peaks(sign * smooth, prominence=prominence)[0] for sign in (1, -1))
    points = np.concatenate([crests, troughs])
    signs = np.concatenate([np.ones(len(crests)), -np.ones(len(troughs))])
    order = np.argsort(points)
    # Of neighbours of one kind (a flat top has two) the first.
    points = points[order][np.diff(signs[order], prepend=0.0) != 0]
    if not len(points):
        return points
    rest = float(np.median(phi[: points[0]])) if points[0] > round(5.0 / step) else 0.0
    return points[int(np.argmax(np.abs(smooth[points] - rest))) + 1 :]


def models() -> dict[str, Model]:
    """The structures of the board."""
    problem = load_problem("roll_decay")
    return {
        name: problem.model + [problem.effect(effect) for effect in effects]
        for name, effects in STRUCTURES.items()
    }


def error_of(fit: Fit, test: Dataset) -> float:
    """Rms error of the roll angle, start state estimated, deg."""
    (error,) = fit.predict(test).rms.values()
    return float(np.degrees(error))


def damping(fit: Fit) -> str:
    """Estimates of the damping with standard errors, and whether its parts are separated."""
    free = [name for name in SYMBOLS if name in fit.names]
    text = ", ".join(
        f"{SYMBOLS[name]} {fit.values[name]:.3g} (standard error {fit.std_errors[name]:.2g}) "
        f"{fit.model.parameter(name).unit}"
        for name in free
    )
    if QUADRATIC not in free:
        return text
    correlation = float(fit.correlation[fit.names.index(LINEAR), fit.names.index(QUADRATIC)])
    weak = [
        f"{SYMBOLS[name]} is {abs(fit.values[name]) / fit.std_errors[name]:.1f} standard errors "
        "from zero"
        for name in free
        if not abs(fit.values[name]) > TWO_SIDED_95 * fit.std_errors[name]
    ]
    weak += [f"{SYMBOLS[name]} feeds the roll" for name in free if fit.values[name] > 0]
    if abs(correlation) > MOST_CORRELATED:
        weak.append(f"the estimates correlate by more than {MOST_CORRELATED:g}")
    if not fit.status.ok:
        weak.append(f"the fit did not converge ({fit.status.code})")
    verdict = f"not separated, because {' and '.join(weak)}" if weak else "separated"
    return f"{text}, correlation {correlation:.2f}: {verdict}"


def at_rest(test: Decay, fits: Mapping[str, Fit]) -> list[Row]:
    """Prediction of a further test with the fits of the registered one."""
    note = f"{test.text}; fitted to 21337, here its start state only"
    data = Dataset((test.record,))
    return [
        Row(f"{test.title}, {name}", error_of(fit, data), "-", "deg", note)
        for name, fit in fits.items()
    ]


def at_speed(test: Decay, fits: Mapping[str, Fit]) -> list[Row]:
    """The same, and with the damping of this speed from the first half of the test."""
    whole, middle = test.record, test.record.duration / 2
    first = Dataset((whole.window(0.0, middle).rename("first half"),))
    second = Dataset((whole.window(middle, whole.times[-1]).rename("second half"),))
    known = fits[FULL].model
    rows = at_rest(test, fits)
    held = [name for name in known.free_names if name not in (LINEAR, QUADRATIC)]
    for what, free in (
        ("linear damping", {LINEAR}),
        ("linear damping and inertia", {LINEAR, INERTIA}),
        ("linear and quadratic damping and inertia", {LINEAR, QUADRATIC, INERTIA}),
    ):
        model = known.fix(*(name for name in held if name not in free))
        # At speed lift damps in proportion to the roll rate, several times more than at rest.
        start = {LINEAR: 10 * load_problem("roll_decay").model.values[LINEAR]}
        if QUADRATIC not in free:
            model = model.with_values({QUADRATIC: 0.0}).fix(QUADRATIC)
        fit = ESTIMATOR.fit(model.with_values(start), first)
        note = (
            f"{test.text}; {what} fitted to the first half, the rest held as in 21337; "
            f"{damping(fit)}"
        )
        title = f"{test.title}, second half, {what} of this speed"
        rows.append(Row(title, error_of(fit, second), "-", "deg", note))
    return rows


def pooled(tests: list[Decay], model: Model) -> Row:
    """Linear and quadratic damping from all tests at zero speed."""
    own = decay(RELEASE, END, REGISTERED)
    data = Dataset((own, *(test.record for test in tests)))
    if tests:
        # A period that is off by a few parts in a thousand must not look like damping.
        own_inertia = replace(model.parameter(INERTIA), per_record=True)
        model = model.with_parameter(own_inertia)
    fit = ESTIMATOR.fit(model, data)
    (error,) = fit.rms.values()
    runs = ", ".join(name.removeprefix("model_test_") for name in data.names)
    what = f"roll decay, tests at zero speed fitted together ({runs}), residual"
    note = f"no test{', inertia by run' if tests else ''}; {damping(fit)}"
    return Row(what, float(np.degrees(error)), "-", "deg", note)


def score() -> list[Row]:
    """Small angles of the registered test, further tests, and the damping of all at rest."""
    problem = load_problem("roll_decay")
    train, test = problem.data().split(test="test_small")
    candidates = models()
    rows = []
    for name, model in candidates.items():
        error = error_of(ESTIMATOR.fit(model, train), test)
        what = f"roll decay 21337 (0 kn), small angles, {name}"
        note = "fitted to the large angles; the small ones confirmed the effects"
        rows.append(Row(what, error, "-", "deg", note))
    paths = further()
    for run, speed in AWAITED.items():
        if f"model_test_{run}" not in [path.stem for path in paths]:
            path = f"{FOLDER}/model_test_{run}.csv"
            what = f"roll decay {run} ({speed})"
            rows.append(missing(what, "-", path, "the test in the same form"))
    tests: list[Decay] = []
    if paths:
        registered = Dataset((decay(RELEASE, END, REGISTERED),))
        fits = {name: ESTIMATOR.fit(model, registered) for name, model in candidates.items()}

    def score_one(path: Path) -> list[Row]:
        one = read_decay(path, problem.model.channels)
        if one.towed:
            return at_speed(one, fits)
        tests.append(one)
        return at_rest(one, fits)

    for path in paths:
        rows += attempted(f"roll decay {path.stem}", "-", path.name, partial(score_one, path))
    rows += attempted(
        "roll decay, tests at zero speed fitted together",
        "-",
        ", ".join([f"{FOLDER}/model_test_21337.csv", *(one.record.source for one in tests)]),
        lambda: [pooled(tests, candidates[FULL])],
    )
    return rows
