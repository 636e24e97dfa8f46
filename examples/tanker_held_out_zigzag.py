"""Question: how well does a fitted tanker predict a zigzag that no fit has seen?

Nine zigzags of the KVLCC2 tanker (7 m model, HSVA) train two models, Nomoto's
first-order equation and the MMG model of Yasukawa and Yoshimura (2015) with
effects added while runs left out of the training get better. Run 20/5 judges.
"""

import math

import numpy as np

from oed_sysid import MultipleShooting, load_problem
from oed_sysid.experiments.simulation import simulate_inputs

HELD_OUT = "20_05"
JUDGES = ("10_05", "15_05", "25_05")  # left out of the training in turn
CANDIDATES = ("helm_zero", "rudder_lift_shape", "propeller_wake_by_drift", "propeller_race")
ENOUGH = 0.95  # an effect stays if the error falls by more than five per cent

ship = load_problem("kvlcc2", variant="mmg")
train, test = ship.data().split(HELD_OUT)
estimator = MultipleShooting(disturbances="none")


def error_left_out(model):
    """Prediction error of runs left out of the training, in units of the believed accuracy."""
    squares = []
    for name in JUDGES:
        rest, judge = train.split(name)
        prediction = estimator.fit(model, rest).predict(judge)
        squares.append(np.mean((prediction.residuals[0] / prediction.sigma) ** 2))
    return math.sqrt(np.mean(squares))


model = ship.model
error = error_left_out(model)
print(f"{'MMG model, fitted':34s} error of a run left out {error:.3f}")
for name in CANDIDATES:
    richer = model + ship.effect(name)
    new = error_left_out(richer)
    print(f"  + {name:30s} error of a run left out {new:.3f}")
    if new < ENOUGH * error:
        model, error = richer, new

fit = estimator.fit(model, train)
zeros = [local["E_helm_zero"] for local in fit.local_values]
shown = np.degrees(zeros).round(1).tolist()
print("Rudder zeros, deg:", *(f"{n} {zero}" for n, zero in zip(train.names, shown, strict=True)))

heading = load_problem("kvlcc2")
nomoto_train, nomoto_test = heading.data().split(HELD_OUT)
nomoto = estimator.fit(heading.model, nomoto_train)


def strict(model, record):
    """Heading error, deg, with nothing of the run but its first sample and its rudder."""
    start = dict(zip(model.output_names, record.outputs[0], strict=True))
    run = simulate_inputs(model, record.times, inputs=record.inputs, initial=start)
    return math.degrees(np.sqrt(np.mean((record.output("psi") - run.output("psi")) ** 2)))


usual = fit.model.with_values({"E_helm_zero": float(np.median(zeros))})
before, after = nomoto.predict(nomoto_test).rms, fit.predict(test).rms
rows = {
    "heading, start estimated": [math.degrees(e["psi"]) for e in (before, after)],
    "heading, from first sample": [strict(nomoto.model, nomoto_test[0]), strict(usual, test[0])],
    "yaw rate per second": [math.degrees(e["r"]) for e in (before, after)],
}
print(f"\nrms error over run {HELD_OUT}, degrees   Nomoto    MMG")
for words, (first, second) in rows.items():
    print(f"  {words:32s}{first:9.3f}{second:8.3f}")
print(
    f"  surge and sway of the MMG model: {1000 * after['u']:.1f} and {1000 * after['v']:.1f} mm/s"
)
print(
    f"\nWith initial state and rudder zero estimated on the run, its heading is predicted "
    f"{before['psi'] / after['psi']:.1f} times better than by Nomoto's equation; from the first "
    f"sample alone, {strict(nomoto.model, nomoto_test[0]) / strict(usual, test[0]):.1f} times: a "
    "tanker is hardly stable on course, and each run has its own zero of the rudder."
)
