"""Designed manoeuvres against zigzags of the same duration and limits.

    OMP_NUM_THREADS=1 python -m benchmarks.design [remus nps mariner] [--confirm 60] [--robust]

Two comparisons: within the *envelope* of the zigzag N/N the design gets the
zigzag's own actuator amplitude, rate and largest attitude as limits; within
the limits of the *vehicle* both may use what is allowed at sea (the zigzag
does not use all of it). Priors are ignored, start states are unknown.
``--confirm`` repeats both experiments with noise and fits each; ``--robust``
replays designs on vehicles whose every coefficient is off by up to 30 per cent.
"""

from __future__ import annotations

import argparse
import time

import numpy as np

from benchmarks.design_systems import SYSTEMS, System
from oed_sysid.design import Design, DOptimal, Levels, Robust, design_experiment
from oed_sysid.errors import SimulationError
from oed_sysid.experiment import Experiment
from oed_sysid.model import Model
from oed_sysid.sensitivity import confirm_bound, information_of
from oed_sysid.simulate import simulate_inputs


def designed(
    system: System, degrees: float, criterion: DOptimal | Robust, *, envelope: bool
) -> Design:
    limits, _ = system.limits(degrees, envelope=envelope)
    return design_experiment(
        system.model, limits=limits, duration=system.duration, sample_time=system.sample_time,
        criterion=criterion, parametrisation=Levels(60), constants=system.constants,
        initial=system.initial, prior=None, rng=np.random.default_rng(1), n_workers=2,
    )  # fmt: skip


def gains(model: Model, zigzag: Experiment, other: Experiment) -> tuple[float, float]:
    """Ratio of geometric means and of largest relative standard errors."""
    sizes = np.abs([model.values[name] for name in model.free_names])
    theirs = information_of(model, zigzag, priors=None).std_errors / sizes
    ours = information_of(model, other, priors=None).std_errors / sizes
    return float(np.exp(np.mean(np.log(theirs / ours)))), float(theirs.max() / ours.max())


def compare(name: str, system: System, degrees: float, n_confirm: int, *, envelope: bool) -> Design:
    zigzag = system.zigzag(degrees)
    _, reach = system.limits(degrees, envelope=envelope)
    began = time.perf_counter()
    design = designed(system, degrees, DOptimal(), envelope=envelope)
    mean, worst = gains(system.model, zigzag, design.experiment)
    words = (
        ", ".join(f"|{k}| <= {np.degrees(v):.1f} deg" for k, v in reach.items())
        or "vehicle's limits"
    )
    print(
        f"{name} against {zigzag.name} ({words}): geometric mean {mean:.2f}x, worst {worst:.2f}x "
        f"smaller; {time.perf_counter() - began:.1f} s, log det {design.value:.1f}",
        flush=True,
    )
    for label, experiment in (("design", design.experiment), ("zigzag", zigzag)):
        if n_confirm:
            found = confirm_bound(
                system.model, experiment, rng=np.random.default_rng(7), n_runs=n_confirm
            )
            low, high = found.interval
            sizes = np.abs([system.model.values[n] for n in found.names])
            print(
                f"  {label}: found/predicted error {found.ratios.min():.2f} to "
                f"{found.ratios.max():.2f} over parameters (99 %: {low:.2f} to {high:.2f}), "
                f"{found.n_failed} of {n_confirm} failed, relative errors found: geometric mean "
                f"{np.exp(np.mean(np.log(found.found / sizes))):.2%}, worst "
                f"{np.max(found.found / sizes):.2%}",
                flush=True,
            )
    return design


def robustness(name: str, system: System, degrees: float, plain: Design, n_draws: int = 12) -> None:
    """Replay designs on wrong vehicles; the zigzag closes its loop on each of them."""
    limits, _ = system.limits(degrees, envelope=False)
    robust = designed(system, degrees, Robust(DOptimal(), spread=0.3, n_sets=4), envelope=False)
    zigzag = system.zigzag(degrees)
    for label, design in (("nominal design", plain), ("robust design", robust)):
        nominal, _ = gains(system.model, zigzag, design.experiment)
        rng = np.random.default_rng(3)
        kept, outside = [], 0
        for _ in range(n_draws):
            wrong = {
                n: system.model.values[n] * (1 + 0.3 * rng.uniform(-1, 1))
                for n in system.model.free_names
            }
            truth = system.model.with_values(wrong)
            try:
                run = simulate_inputs(
                    truth,
                    design.trajectory.times,
                    inputs=design.trajectory.inputs,
                    initial=system.initial,
                )
                kept.append(gains(truth, zigzag, design.experiment)[0])
                outside += bool(limits.violations(run.times, run.signals))
            except SimulationError:
                outside += 1
        print(
            f"  {label}: gain {nominal:.2f} at the nominal values; on {n_draws} wrong vehicles "
            f"median {np.median(kept):.2f} ({np.median(kept) / nominal:.0%}), lowest "
            f"{min(kept):.2f}; {outside} leave the limits",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("systems", nargs="*", default=list(SYSTEMS))
    parser.add_argument("--angles", nargs="+", type=float, default=[5.0, 10.0])
    parser.add_argument("--confirm", type=int, default=0)
    parser.add_argument("--robust", action="store_true")
    parser.add_argument("--vehicle", action="store_true", help="only within the vehicle's limits")
    options = parser.parse_args()
    for name in options.systems:
        system = SYSTEMS[name]()
        for degrees in options.angles:
            for envelope in (True, False):
                if envelope and options.vehicle:
                    continue
                design = compare(name, system, degrees, options.confirm, envelope=envelope)
            if options.robust:
                robustness(name, system, degrees, design)


if __name__ == "__main__":
    main()
