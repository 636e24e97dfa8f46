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
from dataclasses import replace

import numpy as np

from benchmarks.scoreboard.decays import FOLDER, Decay, further, read_decay
from benchmarks.scoreboard.row import Row, attempted, missing
from oed_sysid import Dataset, Fit, Model, MultipleShooting, load_problem
from problems.roll_decay.problem import END, RELEASE, decay

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
