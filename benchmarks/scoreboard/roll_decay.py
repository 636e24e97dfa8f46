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
from pathlib import Path

import numpy as np
from scipy.signal import find_peaks

from benchmarks.scoreboard.row import Row, attempted, missing, place, read_table
from oed_sysid import Channels, Dataset, Fit, Model, MultipleShooting, Record, load_problem
from oed_sysid.errors import DataError
from problems.roll_decay.problem import END, RELEASE, SCALE, decay

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


STRUCTURES = {
    "linear": (),
    "quadratic damping": ("roll_quadratic_damping",),
    "cubic restoring and quadratic damping": ("roll_cubic_restoring", "roll_quadratic_damping"),
}


FULL = "cubic restoring and quadratic damping"


LINEAR, QUADRATIC, INERTIA = "K_p", "E_roll_quadratic_damping", "I_xx"


SYMBOLS = {LINEAR: "K_p", QUADRATIC: "K_abspp"}


PUBLISHED = "-"


NOTE = "fitted to the large angles; the small ones confirmed the effects"


AWAITED = {"21338": "0 kn", "21340": "15.5 kn"}


ESTIMATOR = MultipleShooting(disturbances="none")


# Two terms are separated if each is outside its 95 % interval about zero, and the estimates
# correlate by less than this.
TWO_SIDED_95, MOST_CORRELATED = 1.96, 0.97


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
        Row(f"{title(test)}, {name}", error_of(fit, data), PUBLISHED, "deg", note)
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
        title_ = f"{title(test)}, second half, {what} of this speed"
        rows.append(Row(title_, error_of(fit, second), PUBLISHED, "deg", note))
    return rows


def title(test: Decay) -> str:
    """Run and speed."""
    return f"roll decay {test.record.name.removeprefix('model_test_')} ({test.knots:.3g} kn)"


def pooled(tests: list[Decay], model: Model) -> Row:
    """Linear and quadratic damping from all tests at zero speed."""
    own = decay(RELEASE, END, "model_test_21337")
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
    return Row(what, float(np.degrees(error)), PUBLISHED, "deg", note)


def score() -> list[Row]:
    """Small angles of the registered test, further tests, and the damping of all at rest."""
    problem = load_problem("roll_decay")
    train, test = problem.data().split(test="test_small")
    candidates = models()
    rows = []
    for name, model in candidates.items():
        error = error_of(ESTIMATOR.fit(model, train), test)
        what = f"roll decay 21337 (0 kn), small angles, {name}"
        rows.append(Row(what, error, PUBLISHED, "deg", NOTE))
    paths = further()
    for run, speed in AWAITED.items():
        if f"model_test_{run}" not in [path.stem for path in paths]:
            path = f"{FOLDER}/model_test_{run}.csv"
            what = f"roll decay {run} ({speed})"
            rows.append(missing(what, PUBLISHED, path, "the test in the same form"))
    tests: list[Decay] = []
    if paths:
        registered = Dataset((decay(RELEASE, END, "model_test_21337"),))
        fits = {name: ESTIMATOR.fit(model, registered) for name, model in candidates.items()}
    for path in paths:

        def score_one(path=path) -> list[Row]:
            one = read_decay(path, problem.model.channels)
            if not one.towed:
                tests.append(one)
            return at_speed(one, fits) if one.towed else at_rest(one, fits)

        rows += attempted(f"roll decay {path.stem}", PUBLISHED, path.name, score_one)
    rows += attempted(
        "roll decay, tests at zero speed fitted together",
        PUBLISHED,
        ", ".join([f"{FOLDER}/model_test_21337.csv", *(one.record.source for one in tests)]),
        lambda: [pooled(tests, candidates[FULL])],
    )
    return rows
