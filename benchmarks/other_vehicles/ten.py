"""Ten effects hidden in the vehicle with six degrees of freedom, and two runs with nothing hidden.

    OMP_NUM_THREADS=1 python -m benchmarks.other_vehicles.ten

Taken are the first cases of the benchmark (:mod:`.cases`) in white noise with one hidden effect
each, no effect twice, that are detectable: the expected gain of the truth, by the simulator's own
Kalman filter and without the package, is large enough (:mod:`.judge`). What the improvement makes
of them plays no part in the choice. The target is nine of ten found and nothing claimed where
nothing is hidden. Finished cases are kept in the benchmark's store and never computed again.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path

from benchmarks.harness import Store, command
from benchmarks.other_vehicles.cases import draw_case, draws, single_effect
from benchmarks.other_vehicles.judge import CONFIRMABLE, DETECTABLE
from benchmarks.other_vehicles.measures import accepted
from benchmarks.other_vehicles.run import STORE, run
from benchmarks.rates import claims

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


def main(*, store: Path = STORE, limit: float = 900.0, list: bool = False) -> None:
    """Run what is missing of the ten cases.

    Parameters
    ----------
    store : Path
        store of finished cases
    limit : float
        processor seconds for one case
    list : bool
        only say which cases these are
    """
    tell = partial(print, flush=True)
    hiding, empty = chosen(tell=tell)
    if list:
        return
    run([VEHICLE], only=[*hiding, *empty], store=store, limit=limit, tell=tell)
    done, keys = Store(store).done(), {draw.number: draw.key for draw in draws([VEHICLE], MOST)}
    ready = [done[keys[number]] for number in hiding if keys[number] in done]
    false = sum(keys[number] in done and claims(done[keys[number]]) for number in empty)
    print(f"found {sum(map(accepted, ready))} of {len(ready)} run (target 9 of {COUNT}); "
          f"false claims {false} of {EMPTY}")  # fmt: skip


if __name__ == "__main__":
    command(main)
