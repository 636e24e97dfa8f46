"""Question: what does the steady flight model of an underwater glider miss?

A glider's log gives pitch, pumped volume and density of the water; pressure and
the speed through the water are to be explained. The steady model is fitted to
three dives, what is missing is sought, and eight validation dives judge. Then the
rivals for the second place are fitted in turn: are they different answers?
"""

from oed_sysid import MultipleShooting, load_problem
from oed_sysid.evidence.improve import improve

RIVALS = ("pitch_scale", "speed_bias", "vertical_current")

problem = load_problem("slocum_glider")
data = problem.data()
train, test = data.split(test=[name for name in data.names if name.startswith("test")])

# A dive in still water lasts as long as disturbance forces that would explain it: none are
# admitted.
found = improve(
    problem.model, train, test, candidates=problem.effects, max_effects=2, disturbances="none"
)
print(found.report())
print()

# What the authors knew from elsewhere: their correction of the pitch, and the added mass.
known = problem.variant("corrected_pitch").model
fits = {
    "corrected pitch, steady": MultipleShooting(disturbances="none").fit(known, train),
    "corrected pitch, inertia": MultipleShooting(disturbances="none").fit(
        known + problem.effect("inertia"), train
    ),
}
for rival in RIVALS:
    pair = [problem.effect(name) for name in ("inertia", rival)]
    fits[f"inertia, {rival}"] = MultipleShooting(disturbances="none").fit(
        problem.model + pair, train
    )

print("error                        pressure      speed, validation dives")
for name, fit in fits.items():
    error = fit.predict(test).rms
    print(f"{name:26} {error['pressure']:8.0f} Pa {error['speed']:10.4f} m/s")
print()

fit = fits["inertia, pitch_scale"]
scale, doubt = fit.values["E_pitch_scale"], 1.96 * fit.std_errors["E_pitch_scale"]
print(
    f"Pitch scale {scale:+.3f} +/- {doubt:.3f} (95 %); the authors of the log correct it by -0.14."
)
errors = [fits[f"inertia, {rival}"].predict(test).rms["speed"] for rival in RIVALS]
print(
    f"Conclusion: {found.steps[0].added} is missing first. Of {', '.join(RIVALS)} each leaves "
    f"{min(errors):.3f} to {max(errors):.3f} m/s: measure speed on the climb to tell them apart."
)
