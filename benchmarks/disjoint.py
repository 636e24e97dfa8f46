"""Do fits to disjoint measured zigzags differ by what their errors say?

python -m benchmarks.disjoint [--partitions 5]

The ten KVLCC2 zigzags are cut into halves at random. Both are fitted; the difference of each
parameter is divided by what its two standard errors allow. One is honest. Errors are those of the
fit, from residuals alone, and those of records, a jackknife over the runs of each half, which holds
what no parameter says and differs from run to run.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence

import numpy as np

from oed_sysid import Dataset, MultipleShooting, load_problem
from oed_sysid.predictions.structures import Structure, record_errors
from problems.kvlcc2.mavmm import MAVMM, wake
from problems.kvlcc2.structures import REGRESSION, ahead, circles


def ratios(
    structure: Structure, dataset: Dataset, purpose, partitions: int
) -> tuple[np.ndarray, np.ndarray]:
    """Differences over stated errors, ``(n_partitions, n_quantities)``: of the fit, of records."""
    by_fit, by_record = [], []
    for seed in range(partitions):
        order = np.random.default_rng(seed).permutation(len(dataset))
        half = len(dataset) // 2
        values, stated, scattered = [], [], []
        for part in (order[:half], order[half:]):
            data = Dataset(tuple(dataset[int(i)] for i in sorted(part)))
            fit = structure.fit(data)
            wanted = purpose(fit)
            values.append(np.array(list(wanted.values())))
            own = [fit.std_errors.get(name, np.nan) for name in wanted]
            stated.append(np.array(own))
            found = record_errors(structure, data, purpose)
            scattered.append(np.array([found[name] for name in wanted]))
        by_fit.append((values[0] - values[1]) / np.hypot(*stated))
        by_record.append((values[0] - values[1]) / np.hypot(*scattered))
    return np.array(by_fit), np.array(by_record)


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line per model and quantity."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--partitions", type=int, default=5)
    given = parser.parse_args(arguments)
    motion = load_problem("kvlcc2", variant="mmg").data()
    heading = load_problem("kvlcc2")
    full = REGRESSION.fit(MAVMM.with_values(wake()), motion).model
    cases = (
        (
            "Nomoto, K and T",
            Structure("Nomoto", heading.model, MultipleShooting(disturbances="none")),
            heading.data(),
            lambda fit: fit.values,
        ),
        ("MAVMM, derivatives", Structure("one step", full, REGRESSION), motion,
         lambda fit: fit.values),
        ("MAVMM 10 s ahead, derivatives", Structure("10 s", full, ahead(10.0)), motion,
         lambda fit: fit.values),
        ("MAVMM, circles", Structure("circles", full, REGRESSION), motion, circles),
    )  # fmt: skip
    print(f"{'rms of difference over stated error':40} of the fit   of records")
    for name, structure, data, purpose in cases:
        fit, record = ratios(structure, data, purpose, given.partitions)
        shown = "-" if np.isnan(fit).all() else f"{np.sqrt(np.mean(fit**2)):.2f}"
        print(f"{name:40} {shown:>10} {np.sqrt(np.mean(record**2)):12.2f}", flush=True)


if __name__ == "__main__":
    main()
