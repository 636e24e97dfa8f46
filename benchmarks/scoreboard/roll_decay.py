"""Roll decay of KVLCC2 at zero speed: fitted to the large angles, judged on the small ones."""

from __future__ import annotations

from benchmarks.scoreboard.row import Row, wanted
from oed_sysid import MultipleShooting, load_problem

STRUCTURES = {
    "linear": (),
    "quadratic damping": ("roll_quadratic_damping",),
    "cubic restoring and quadratic damping": ("roll_cubic_restoring", "roll_quadratic_damping"),
}
PUBLISHED = "-"
NOTE = "fitted to the large angles; the small ones confirmed the effects"


def score() -> list[Row]:
    """Error on the small angles for three structures, and which runs are not at hand."""
    problem = load_problem("roll_decay")
    train, test = problem.data().split(test="test_small")
    rows: list[Row] = []
    for name, effects in STRUCTURES.items():
        model = problem.model + [problem.effect(effect) for effect in effects]
        fit = MultipleShooting(disturbances="none").fit(model, train)
        (error,) = fit.predict(test).rms.values()
        what = f"roll decay 21337 (0 kn), small angles, {name}"
        rows.append(Row(what, 57.29577951 * error, PUBLISHED, "deg", NOTE))
    for run, speed in (("21338", "0 kn"), ("21340", "15.5 kn")):
        path = f"kvlcc2_roll_decay/model_test_{run}.csv"
        lacking = wanted(
            f"roll decay {run} ({speed})", PUBLISHED, path, "the test in the same form"
        )
        if lacking:
            rows.append(lacking)
    return rows
