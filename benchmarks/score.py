"""How long it takes to score every candidate effect without refitting.

    OMP_NUM_THREADS=1 python -m benchmarks.score

The three training records of ``remus_diving_plane`` (2,703 samples of five
outputs, with something hidden in them) against all candidate effects of the
problem. The first fit, on which the scores rest, is made once and not counted.
"""

from __future__ import annotations

import cProfile
import io
import pstats
import sys

from benchmarks.measure import elapsed, least, machine, verdict
from oed_sysid import Dataset, load_problem
from oed_sysid.evidence.score import scores
from oed_sysid.evidence.study import Study


def main() -> None:
    """Print the time of the score test."""
    problem = load_problem("remus_diving_plane")
    records = problem.data()
    train = Dataset(tuple(r for r in records if r.name.startswith("train")))
    candidates = list(problem.effects)
    study, fit = Study.begin(problem.model, train, None, candidates, known_noise=False)

    def work() -> object:
        return scores(study, fit, study.candidates)

    seconds, clock = least(work, 12), elapsed(work, 5)
    ranked, _ = scores(study, fit, study.candidates)
    n_samples = sum(record.n_samples for record in train)
    print(machine())
    print(
        f"{len(candidates)} candidates on {n_samples} samples; best: "
        f"{', '.join(s.effect.name for s in ranked[:3])}; on the clock {clock:.3f} s"
    )
    print(verdict("score test of all candidates, processor time", seconds, 0.3, "s"))
    print(f"for 40 candidates, in proportion: {40 * seconds / len(candidates):.3f} s")
    if "--profile" in sys.argv:
        profile = cProfile.Profile()
        profile.runcall(work)
        text = io.StringIO()
        pstats.Stats(profile, stream=text).sort_stats("tottime").print_stats(12)
        print(text.getvalue())


if __name__ == "__main__":
    main()
