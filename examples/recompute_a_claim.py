"""Question: how does anybody who doubts a claim get its numbers again?

What a decision is made of is saved: minus twice the log-likelihood of the training records, and of
the validation records the misfit with the information before and after. Ten lines of NumPy do the
rest; the saved fits tell the training term once more, without what priors cost.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.stats import chi2

from oed_sysid import Fit, improve, load_problem

problem = load_problem("remus_diving_plane")
train, test = problem.data().split(test=["test_steps", "test_zigzag_15_12"])
found = improve(problem.model, train, test, candidates=problem.effects, terms=False)
claim = found.decisions[0]

with TemporaryDirectory() as folder:
    files = [Path(folder) / name for name in ("nominal.json", "improved.json")]
    for fit, file in zip(found.fits, files, strict=True):
        fit.save(file)
    np.savez(
        Path(folder) / "claim.npz",
        training=[objective for objective, _ in claim.models],
        misfit=[prediction.misfit for _, prediction in claim.models],
        **{f"known_{i}": prediction.known for i, (_, prediction) in enumerate(claim.models)},
        **{f"joint_{i}": prediction.joint for i, (_, prediction) in enumerate(claim.models)},
    )
    fits = [Fit.load(file) for file in files]
    saved = dict(np.load(Path(folder) / "claim.npz"))

# The ten lines.
occam = [
    np.linalg.slogdet(saved[f"joint_{i}"])[1] - np.linalg.slogdet(saved[f"known_{i}"])[1]
    for i in (0, 1)
]
training = saved["training"][0] - saved["training"][1]
validation = saved["misfit"][0] + occam[0] - saved["misfit"][1] - occam[1]
statistic = training + validation
threshold = chi2.isf(0.01 / len(problem.effects), 1)
by_fits = 2.0 * (fits[1].log_likelihood - fits[0].log_likelihood)

print(f"{claim.name}: training {training:.1f} ({by_fits:.0f} without priors, by the saved fits)")
print(f"validation {validation:.1f}, T = {statistic:.1f}, threshold {threshold:.1f}")
assert np.isclose(statistic, claim.statistic)
assert np.isclose(threshold, claim.needed)
print(f"\nConclusion: T of {claim.name} is {statistic / threshold:.0f} times its threshold.")
