"""Designed manoeuvres against zigzags of the same duration and limits.

    OMP_NUM_THREADS=1 python -m benchmarks.design [remus nps mariner] [--confirm 60]
    OMP_NUM_THREADS=1 python -m benchmarks.design nps --angles 10 --robust

Within the *envelope* of the zigzag N/N the design gets the zigzag's own actuator amplitude, rate
and largest attitude as limits; within the limits of the *vehicle* both may use what is allowed at
sea. Priors are ignored, start states are unknown.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from benchmarks.harness import command, known
from benchmarks.other_vehicles.models import modelled
from benchmarks.tables import tables
from oed_sysid import (
    AOptimal,
    DOptimal,
    EOptimal,
    Experiment,
    Limits,
    Model,
    design_experiment,
    load_problem,
)
from oed_sysid.design import Caution, Design, Knowledge, Levels, Search, Trial, assess_limits
from oed_sysid.design.vehicles import draw_models
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.experiments.manoeuvres import ZigZag
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.information import confirm_bound, information_of
from oed_sysid.likelihood.information import Information


@dataclass(frozen=True)
class System:
    """One vehicle with the settings of its trials."""

    model: Model
    control: str
    attitude: str
    sign: int
    rate: float
    duration: float
    sample_time: float
    initial: dict[str, float]
    constants: dict[str, float]
    corridor: dict[str, tuple[float, float]]
    vehicle: Limits

    def zigzag(self, degrees: float) -> Experiment:
        """Zigzag with equal rudder and switching angles, for the whole duration."""
        return Experiment(
            f"zigzag {degrees:g}/{degrees:g}",
            ZigZag(self.control, radians(degrees), radians(degrees), feedback=(self.attitude,),
                   rate=self.rate, sign=self.sign),
            duration=self.duration, sample_time=self.sample_time, constants=self.constants,
            initial=self.initial, feedback="true",
        )  # fmt: skip

    def trial(self, limits: Limits) -> Trial:
        """What a design may do."""
        return Trial(
            limits=limits, duration=self.duration, sample_time=self.sample_time,
            constants=self.constants, initial=self.initial,
        )  # fmt: skip

    def limits(self, degrees: float, *, envelope: bool) -> tuple[Limits, dict[str, float]]:
        """The zigzag's own amplitude, rate and largest attitude; or those of the vehicle."""
        if not envelope:
            return self.vehicle, {}
        record = simulate(self.model, self.zigzag(degrees), noise=False)
        run = simulate_inputs(self.model, record.times, inputs=record.inputs, initial=self.initial)
        reach = float(np.abs(run.signal(self.attitude)).max())
        # The design may use no more of the corridor than agreed, but the zigzag's share.
        spans = {
            name: (
                min(lower, float(run.signal(name).min())),
                max(upper, float(run.signal(name).max())),
            )
            for name, (lower, upper) in self.corridor.items()
        }
        own = Limits(
            inputs={self.control: (-radians(degrees), radians(degrees))},
            rates={self.control: self.rate},
            signals={self.attitude: (-reach, reach), **spans},
        )
        return own, {self.attitude: reach}


def remus() -> System:
    """REMUS-like AUV: eight derivatives, outputs u w q theta z."""
    model = load_problem("remus_diving_plane").model
    return System(
        model, "fin_command", "theta", -1, radians(20), 120.0, 0.5,
        {"u": 1.519, "z": 20.0}, {"thrust": 9.0}, {"z": (2.0, 60.0)},
        Limits({"fin_command": (-radians(20), radians(20))}, {"fin_command": radians(20)},
               {"theta": (-radians(45), radians(45)), "z": (2.0, 60.0)}),
    )  # fmt: skip


def nps() -> System:
    """NPS AUV II in Gertler-Hagen form: the ten stronger coefficients.

    Those that no 5-degree manoeuvre shows (see the sensitivity order of the
    problem's README) are held, as the paper's reduced model drops them.
    """
    model = load_problem("auv_diving_plane").model
    weak = ("X_qq_prime", "X_wq_prime", "X_ww_prime", "Z_absww_prime", "Z_wabsq_prime",
            "Z_uabsw_prime", "M_absww_prime", "M_uabsw_prime", "X_T")  # fmt: skip
    kept = [o for o in model.outputs if o.name in ("u", "w", "q", "theta", "z")]
    model = replace(model.fix(*(n for n in weak if n in model.free_names)), outputs=tuple(kept))
    return System(
        model, "delta_s", "theta", -1, radians(2.5), 120.0, 0.5,
        {"u": 1.47, "z": 100.0}, {}, {"z": (80.0, 120.0)},
        Limits({"delta_s": (-radians(15), radians(15))}, {"delta_s": radians(2.5)},
               {"theta": (-radians(20), radians(20)), "z": (80.0, 120.0)}),
    )  # fmt: skip


def mariner() -> System:
    """Mariner-class ship: Abkowitz form, fourteen coefficients free."""
    model = modelled(tables(__file__, "mariner"))
    return System(
        model, "rudder", "psi", -1, radians(5), 600.0, 2.0, {"u": 7.7175}, {}, {},
        Limits({"rudder": (-radians(20), radians(20))}, {"rudder": radians(5)},
               {"psi": (-radians(40), radians(40)), "u": (5.0, 9.0)}),
    )  # fmt: skip


SYSTEMS = {"remus": remus, "nps": nps, "mariner": mariner}
CRITERIA = {"D": DOptimal(), "A": AOptimal(), "E": EOptimal()}


def gains(model: Model, zigzag: Experiment, other: Experiment) -> tuple[float, float]:
    """Ratio of geometric means and of largest relative standard errors."""
    sizes = np.abs([model.values[name] for name in model.free_names])
    theirs = information_of(model, zigzag, priors=None).std_errors / sizes
    ours = information_of(model, other, priors=None).std_errors / sizes
    return float(np.exp(np.mean(np.log(theirs / ours)))), float(theirs.max() / ours.max())


def compare(
    name: str, system: System, degrees: float, n_confirm: int, criterion: str, *, envelope: bool
) -> None:
    """Print how much smaller errors are than those of a zigzag, and of other references."""
    zigzag = system.zigzag(degrees)
    limits, reach = system.limits(degrees, envelope=envelope)
    began = time.perf_counter()
    search = Search(family=Levels(60), n_workers=2)
    design = designed(system, limits, search, criterion=criterion)
    mean, worst = gains(system.model, zigzag, design.experiment)
    parts = (f"|{k}| <= {np.degrees(v):.1f} deg" for k, v in reach.items())
    words = ", ".join(parts) or "vehicle's limits"
    say(
        f"{name} against {zigzag.name} ({words}): geometric mean {mean:.2f}x, worst {worst:.2f}x "
        f"smaller; criterion {criterion} {design.value:.1f}, {time.perf_counter() - began:.1f} s"
    )
    for reference in design.references:
        if reference.note:
            mean, worst = design.gain(reference)
            say(f"  {reference.name} {reference.note}: {mean:.2f}x, worst {worst:.2f}x")
    confirmed = {"design": design.experiment, "zigzag": zigzag} if n_confirm else {}
    for label, experiment in confirmed.items():
        rng = np.random.default_rng(7)
        found = confirm_bound(system.model, experiment, rng=rng, n_runs=n_confirm)
        low, high = found.interval
        errors = found.found / np.abs([system.model.values[n] for n in found.names])
        say(
            f"  {label}: found/predicted error {found.ratios.min():.2f} to "
            f"{found.ratios.max():.2f} over parameters (99 %: {low:.2f} to {high:.2f}), "
            f"{found.n_failed} of {n_confirm} failed, relative errors found: geometric mean "
            f"{np.exp(np.mean(np.log(errors))):.2%}, worst {errors.max():.2%}"
        )


def say(text: str) -> None:
    """Print at once: designs take a while."""
    print(text, flush=True)


def designed(
    system: System, limits: Limits, search: Search, *, criterion: str = "D",
    caution: Caution | str | None = "auto", prior: Information | None = None,
) -> Design:  # fmt: skip
    """A design of a vehicle of which no more than the prior information is known."""
    return design_experiment(
        system.model, system.trial(limits), criterion=CRITERIA[criterion], caution=caution,
        rng=np.random.default_rng(1), search=search, knowledge=Knowledge(prior=prior),
    )  # fmt: skip


def robustness(
    name: str, system: System, degrees: float, *, informed: bool, n_draws: int = 100
) -> None:
    """Replay designs on other vehicles; zigzag and gain are theirs, the integration finer."""
    limits, _ = system.limits(degrees, envelope=False)
    zigzag = system.zigzag(degrees)
    prior = information_of(system.model, system.zigzag(5.0), priors=None) if informed else None
    spread = None if informed else 0.3
    what = "drawn from what a 5/5 zigzag tells" if informed else "off by up to 30 %"
    say(f"{name}, coefficients {what}:")
    standard = assess_limits(
        system.model, zigzag, limits=limits, spread=spread, prior=prior, vehicles=100,
        rng=np.random.default_rng(3),
    )  # fmt: skip
    say(f"  {zigzag.name} itself: {standard.report()}")
    nominal, few = 0.0, Levels(30)
    search = Search(family=few, n_starts=1, n_candidates=40, n_steps=12, n_workers=2)
    for label, caution in (("nominal", None), ("cautious", Caution(0.95, spread))):
        began = time.perf_counter()
        try:
            design = designed(system, limits, search, caution=caution, prior=prior)
        except DesignError as error:
            say(f"  {label} design: {error}")
            continue
        seconds = time.perf_counter() - began
        gain, worst = gains(system.model, zigzag, design.experiment)
        nominal = nominal or gain
        vehicles = draw_models(system.model, spread, n_draws, prior, np.random.default_rng(3))
        found, outside = replayed(system, limits, design, zigzag, vehicles)
        stated = "" if design.assurance is None else f"; stated: {design.assurance.report()}"
        say(
            f"  {label} design: gain {gain:.2f} (worst {worst:.2f}) at the nominal values, "
            f"median of 20 others {np.median(found):.2f} ({np.median(found) / nominal:.0%} of the "
            f"nominal design's {nominal:.2f}), lowest {min(found):.2f}; {outside} of {n_draws} "
            f"leave the limits{stated}; {seconds:.0f} s"
        )


def replayed(
    system: System, limits: Limits, design: Design, zigzag: Experiment, vehicles: Sequence[Model]
) -> tuple[list[float], int]:
    """Gains on the first twenty of other vehicles, and how many of all leave the limits."""
    found, outside, played = [], 0, design.trajectory
    for index, truth in enumerate(vehicles):
        finer = replace(truth, step=truth.step / 5)
        try:
            run = simulate_inputs(finer, played.times, inputs=played.inputs, initial=system.initial)
            outside += bool(limits.violations(run.times, run.signals))
            if index < 20:
                found.append(gains(truth, zigzag, design.experiment)[0])
        except SimulationError:
            outside += 1
    return found, outside


def main(
    systems: Sequence[str] = tuple(SYSTEMS),
    *,
    angles: Sequence[float] = (5.0, 10.0),
    confirm: int = 0,
    robust: bool = False,
    vehicle: bool = False,
    criterion: str = "D",
) -> None:
    """Compare, or replay on other vehicles.

    Parameters
    ----------
    systems : sequence of str
        remus, nps, mariner
    angles : sequence of float
        of the zigzags, degrees
    confirm : int
        repetitions with noise
    robust : bool
        replay designs on vehicles with other coefficients instead
    vehicle : bool
        only within the vehicle's limits
    criterion : str
        D, A or E
    """
    known(criterion, CRITERIA, "criterion")
    for name in systems:
        system = SYSTEMS[known(name, SYSTEMS, "system")]()
        for degrees in angles:
            if robust:
                for informed in (False, True):
                    robustness(name, system, degrees, informed=informed)
                continue
            for envelope in (False,) if vehicle else (True, False):
                compare(name, system, degrees, confirm, criterion, envelope=envelope)


if __name__ == "__main__":
    command(main)
