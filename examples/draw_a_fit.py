"""Question: what does a misfit look like, and what does the report say about it?

A problem folder is made as `oed-sysid new` makes it. Its model lacks an effect,
which shows in the residuals. The pictures and the report go to out/example.
"""

import tempfile
from pathlib import Path

import matplotlib as mpl

mpl.use("Agg")

import oed_sysid
from oed_sysid.results import plot_autocorrelation, plot_zigzag

place = Path("out/example")
place.mkdir(parents=True, exist_ok=True)

with tempfile.TemporaryDirectory() as temporary:
    folder = oed_sysid.new_problem(Path(temporary) / "my_ship")
    problem = oed_sysid.load_problem(folder)
    data = problem.data()

# Disturbance forces, admitted by default, would explain what is missing from sample to sample.
estimator = oed_sysid.MultipleShooting(disturbances="none")
nominal = estimator.fit(problem.model, data)
better = estimator.fit(problem.model + problem.effect("yaw_quadratic_damping"), data)

labels = ["linear", "with quadratic damping"]
axes = plot_zigzag(data["zigzag_20_20"], [nominal, better], labels=labels)
axes.figure.savefig(place / "zigzag.png", dpi=150)
axes = plot_autocorrelation(nominal, "r")
axes.figure.savefig(place / "autocorrelation.png", dpi=150)
better.document(style=1).write(place / "better.html")

print(f"Pictures and report: {place.resolve()}")
for label, fit in zip(labels, (nominal, better), strict=True):
    white = sum(test.is_white for tests in fit.whiteness().values() for test in tests)
    total = sum(len(tests) for tests in fit.whiteness().values())
    print(
        f"{label}: misfit {fit.normalised_rms:.3f} x noise; the residuals of {white} of {total} "
        "signals look like white noise"
    )
