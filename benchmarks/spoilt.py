"""Wrong logs through the search for missing physics: none may be certified.

    python -m benchmarks.spoilt [NAME ...]

The records of one hidden-effect case (nothing hidden) are spoilt in fifteen ways, training and
validation alike, and given to ``improve``. Printed is what it says, and whether that certifies a
log that is wrong: ``adequate`` or ``random forces`` without a word about the fault.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence

from benchmarks.compatibility import SPOILS, data_folder, hidden_effect_cases, named_as, spoil
from benchmarks.harness import command, markdown
from oed_sysid.data.dataset import read_csv
from oed_sysid.evidence.check import check
from oed_sysid.evidence.improve import improve

HEAD = ("spoilt", "check", "improve", "added", "certified", "s")


def main(names: Sequence[str] = tuple(SPOILS)) -> int:
    """Print a table; 1 if a spoilt log was certified."""
    cases = hidden_effect_cases()
    if not cases:
        print("no hidden_effects folder below OED_SYSID_DATA")
        return 1
    problem, train = cases["case_010"]
    files = sorted((data_folder() / "hidden_effects" / "case_010").glob("test_*.csv"))
    test = read_csv(files, problem.channels)
    rows = []
    for name in names:
        kind, signal, _ = SPOILS[name]
        began = time.perf_counter()
        bad, held = spoil(train, name), spoil(test, name)
        found = check(bad, problem)
        result = improve(problem.model, bad, held, candidates=problem.effects)
        added = [step.added for step in result.steps]
        # A sensor effect on the signal that is wrong names the fault, in its own way.
        named = result.remains.kind == "log suspect" or any(
            step.effect.stage == "sensor" and signal in " ".join(map(str, step.effect.terms))
            for step in result.steps
        )
        wrong = not named and result.remains.kind in ("adequate", "disturbance")
        said = "named" if named_as(found, name) else found.verdict
        seconds = f"{time.perf_counter() - began:.0f}"
        rows.append((f"{kind} {signal}", said, result.remains.kind, ", ".join(added) or "-",
                     "YES" if wrong else "no", seconds))  # fmt: skip
        print(" | ".join(rows[-1]), flush=True)
    certified = sum(row[-2] == "YES" for row in rows)
    print("\n".join([*markdown(HEAD, rows), "", f"{certified} of {len(rows)} certified"]))
    return 1 if certified else 0


if __name__ == "__main__":
    sys.exit(command(main))
