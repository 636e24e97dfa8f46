"""Ten effects hidden in the vehicle with six degrees of freedom, and two runs with nothing hidden.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles.ten

Taken are the first cases of the benchmark (:mod:`.cases`) in white noise with one hidden effect
each, no effect twice, that are detectable: the expected gain of the truth, by the simulator's own
Kalman filter and without the package, is large enough (:mod:`.judge`). What the improvement makes
of them plays no part in the choice. The target is nine of ten found and nothing claimed where
nothing is hidden. Finished cases are kept in the benchmark's store and never computed again.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Sequence
from pathlib import Path

from benchmarks.other_vehicles.cases import draw_case, draws, single_effect
from benchmarks.other_vehicles.judge import CONFIRMABLE, DETECTABLE
from benchmarks.other_vehicles.measures import accepted, claims
from benchmarks.other_vehicles.run import STORE, load, run

VEHICLE = "auv"
COUNT, EMPTY = 10, 2
# Cases looked through; the pattern repeats after twenty, effects after nineteen.
MOST = 80


def chosen(*, tell: Callable[[str], None] = lambda text: None) -> tuple[list[int], list[int]]:
    """Numbers of the ten cases, and of those with nothing hidden.

    Parameters
    ----------
    tell : callable
        Told which effect each case hides, and its expected gain.

    Returns
    -------
    hiding, empty : list of int
    """
    hiding: list[int] = []
    empty: list[int] = []
    seen: set[str] = set()
    for draw in draws([VEHICLE], MOST):
        if draw.condition != "white":
            continue
        if draw.hidden == "none" and len(empty) < EMPTY:
            empty.append(draw.number)
        if draw.hidden != "single" or len(hiding) == COUNT or single_effect(draw) in seen:
            continue
        name = single_effect(draw)
        gain = draw_case(draw).gain(name)
        if gain.train >= DETECTABLE and gain.validation >= CONFIRMABLE:
            seen.add(name)
            hiding.append(draw.number)
            tell(f"{draw.number}: {name}, expected gain {gain.train:.0f}")
        if len(hiding) == COUNT and len(empty) == EMPTY:
            break
    return hiding, empty


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line of the ten cases."""
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.other_vehicles.ten", description=__doc__.splitlines()[0]
    )
    parser.add_argument("--store", type=Path, default=STORE)
    parser.add_argument("--limit", type=float, default=900.0, help="processor seconds for one case")
    parser.add_argument("--list", action="store_true", help="only say which cases these are")
    options = parser.parse_args(arguments)
    hiding, empty = chosen(tell=lambda text: print(text, flush=True))
    if options.list:
        return
    run(
        [VEHICLE],
        only=[*hiding, *empty],
        store=options.store,
        limit=options.limit,
        tell=lambda text: print(text, flush=True),
    )
    keys = {draw.key: draw.number for draw in draws([VEHICLE], MOST)}
    entries = {keys[one["key"]]: one for one in load(options.store) if one["key"] in keys}
    found = sum(number in entries and accepted(entries[number]) for number in hiding)
    false = sum(number in entries and claims(entries[number]) for number in empty)
    done = sum(number in entries for number in hiding)
    print(f"found {found} of {done} run (target 9 of {COUNT}); false claims {false} of {EMPTY}")


if __name__ == "__main__":
    main()
