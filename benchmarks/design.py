"""Designed manoeuvres against zigzags of the same duration and limits.

    OMP_NUM_THREADS=1 python -m benchmarks.design [remus nps mariner] [--confirm 60]
    OMP_NUM_THREADS=1 python -m benchmarks.design nps --angles 10 --robust
    OMP_NUM_THREADS=1 python -m benchmarks.design nps --angles 10 --everywhere

Two comparisons: within the *envelope* of the zigzag N/N the design gets the
zigzag's own actuator amplitude, rate and largest attitude as limits; within
the limits of the *vehicle* both may use what is allowed at sea (the zigzag
does not use all of it). Priors are ignored, start states are unknown.
``--confirm`` repeats both experiments with noise and fits each; ``--robust``
replays designs with and without caution on vehicles with other coefficients;
``--everywhere`` looks for better optima inside the envelope.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import replace

import numpy as np

from benchmarks.design_systems import SYSTEMS, System
from oed_sysid.design import (
    AOptimal,
    Caution,
    Design,
    DOptimal,
    EOptimal,
    Knowledge,
    Levels,
    Multisines,
    Search,
    Trial,
    assess_limits,
    design_experiment,
)
from oed_sysid.design.vehicles import draw_models
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.information import confirm_bound, information_of
from oed_sysid.physics.model import Model


def designed(
    system: System, degrees: float, criterion: AOptimal | DOptimal | EOptimal, *, envelope: bool
) -> Design:
    limits, _ = system.limits(degrees, envelope=envelope)
    return design_experiment(
        system.model,
        Trial(
            limits=limits,
            duration=system.duration,
            sample_time=system.sample_time,
            constants=system.constants,
            initial=system.initial,
        ),
        criterion=criterion,
        rng=np.random.default_rng(1),
        search=Search(family=Levels(60), n_workers=2),
        knowledge=Knowledge(prior=None),
    )


def gains(model: Model, zigzag: Experiment, other: Experiment) -> tuple[float, float]:
    """Ratio of geometric means and of largest relative standard errors."""
    sizes = np.abs([model.values[name] for name in model.free_names])
    theirs = information_of(model, zigzag, priors=None).std_errors / sizes
    ours = information_of(model, other, priors=None).std_errors / sizes
    return float(np.exp(np.mean(np.log(theirs / ours)))), float(theirs.max() / ours.max())


def compare(
    name: str,
    system: System,
    degrees: float,
    n_confirm: int,
    criterion: AOptimal | DOptimal | EOptimal,
    *,
    envelope: bool,
) -> None:
    zigzag = system.zigzag(degrees)
    _, reach = system.limits(degrees, envelope=envelope)
    began = time.perf_counter()
    design = designed(system, degrees, criterion, envelope=envelope)
    mean, worst = gains(system.model, zigzag, design.experiment)
    words = (
        ", ".join(f"|{k}| <= {np.degrees(v):.1f} deg" for k, v in reach.items())
        or "vehicle's limits"
    )
    print(
        f"{name} against {zigzag.name} ({words}): geometric mean {mean:.2f}x, worst {worst:.2f}x "
        f"smaller; criterion {criterion.name} {design.value:.1f}, "
        f"{time.perf_counter() - began:.1f} s",
        flush=True,
    )
    for reference in design.references:
        if reference.note:
            mean, worst = design.gain(reference)
            print(
                f"  {reference.name} {reference.note}: {mean:.2f}x, worst {worst:.2f}x", flush=True
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


def robustness(
    name: str, system: System, degrees: float, *, informed: bool, n_draws: int = 100
) -> None:
    """Replay designs on other vehicles; zigzag and gain are theirs, the integration finer."""
    limits, _ = system.limits(degrees, envelope=False)
    zigzag = system.zigzag(degrees)
    prior = information_of(system.model, system.zigzag(5.0), priors=None) if informed else None
    spread = None if informed else 0.3
    what = "drawn from what a 5/5 zigzag tells" if informed else "off by up to 30 %"
    print(f"{name}, coefficients {what}:", flush=True)
    standard = assess_limits(
        system.model,
        zigzag,
        limits=limits,
        spread=spread,
        prior=prior,
        vehicles=100,
        rng=np.random.default_rng(3),
    )
    print(f"  {zigzag.name} itself: {standard.report()}", flush=True)
    nominal = 0.0
    for label, caution in (("nominal", None), ("cautious", Caution(0.95, spread))):
        began = time.perf_counter()
        try:
            design = design_experiment(
                system.model,
                Trial(
                    limits=limits,
                    duration=system.duration,
                    sample_time=system.sample_time,
                    constants=system.constants,
                    initial=system.initial,
                ),
                caution=caution,
                rng=np.random.default_rng(1),
                search=Search(
                    family=Levels(30), n_starts=1, n_candidates=40, n_steps=12, n_workers=2
                ),
                knowledge=Knowledge(prior=prior),
            )
        except DesignError as error:
            print(f"  {label} design: {error}", flush=True)
            continue
        seconds = time.perf_counter() - began
        gain, worst = gains(system.model, zigzag, design.experiment)
        nominal = nominal or gain
        found, outside = [], 0
        for index, truth in enumerate(
            draw_models(system.model, spread, n_draws, prior, np.random.default_rng(3))
        ):
            finer = replace(truth, step=truth.step / 5)
            try:
                run = simulate_inputs(
                    finer,
                    design.trajectory.times,
                    inputs=design.trajectory.inputs,
                    initial=system.initial,
                )
                outside += bool(limits.violations(run.times, run.signals))
                if index < 20:
                    found.append(gains(truth, zigzag, design.experiment)[0])
            except SimulationError:
                outside += 1
        stated = "" if design.assurance is None else f"; stated: {design.assurance.report()}"
        print(
            f"  {label} design: gain {gain:.2f} (worst {worst:.2f}) at the nominal values, "
            f"median of 20 others {np.median(found):.2f} ({np.median(found) / nominal:.0%} of the "
            f"nominal design's {nominal:.2f}), lowest {min(found):.2f}; {outside} of {n_draws} "
            f"leave the limits{stated}; {seconds:.0f} s",
            flush=True,
        )


def globally(name: str, system: System, degrees: float) -> None:
    """Several families from many starts, inside the zigzag's envelope: is there anything better?"""
    limits, _ = system.limits(degrees, envelope=True)
    zigzag = system.zigzag(degrees)
    families = (Levels(60), Levels(30), Levels(40, "linear"), Multisines(20))
    for family in families:
        design = design_experiment(
            system.model,
            Trial(
                limits=limits,
                duration=system.duration,
                sample_time=system.sample_time,
                constants=system.constants,
                initial=system.initial,
            ),
            rng=np.random.default_rng(11),
            search=Search(family=family, n_starts=6, n_candidates=200, n_steps=15, n_workers=2),
            knowledge=Knowledge(prior=None),
        )
        mean, worst = gains(system.model, zigzag, design.experiment)
        ends = ", ".join(f"{value:.2f}" for value in sorted(design.start_values))
        print(
            f"{name} {degrees:g}/{degrees:g} envelope, {family.name}: starts end at {ends}, "
            f"best {design.value:.2f}, gain {mean:.2f}, worst {worst:.2f}, {design.seconds:.0f} s",
            flush=True,
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("systems", nargs="*", default=list(SYSTEMS))
    parser.add_argument("--angles", nargs="+", type=float, default=[5.0, 10.0])
    parser.add_argument("--confirm", type=int, default=0)
    parser.add_argument("--robust", action="store_true")
    parser.add_argument("--everywhere", action="store_true", help="many starts, many families")
    parser.add_argument("--vehicle", action="store_true", help="only within the vehicle's limits")
    parser.add_argument("--criterion", choices=list("DAE"), default="D")
    options = parser.parse_args()
    criteria: dict[str, AOptimal | DOptimal | EOptimal]
    criteria = {"D": DOptimal(), "A": AOptimal(), "E": EOptimal()}
    criterion = criteria[options.criterion]
    for name in options.systems:
        system = SYSTEMS[name]()
        for degrees in options.angles:
            for envelope in (True, False):
                if envelope and options.vehicle:
                    continue
                if not (options.robust or options.everywhere):
                    compare(name, system, degrees, options.confirm, criterion, envelope=envelope)
            if options.robust:
                for informed in (False, True):
                    robustness(name, system, degrees, informed=informed)
            if options.everywhere:
                globally(name, system, degrees)


if __name__ == "__main__":
    main()
