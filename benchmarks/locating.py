"""How often the right place is accused, and the right term proposed.

    OMP_NUM_THREADS=1 python -m benchmarks.locating

The cases are those of ``benchmarks/missing_physics``. Nothing but the nominal model is given:
no candidate effects, no amplitudes.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.missing_physics.cases import draws, simulate_draws
from benchmarks.missing_physics.judge import datasets
from benchmarks.missing_physics.simulator import NOISE_STD, Case, Records
from oed_sysid import Dataset, Force, Parameter, Problem, load_problem
from oed_sysid.evidence.locate import Located, locate
from oed_sysid.evidence.propose import Proposals, propose
from oed_sysid.evidence.study import Study
from oed_sysid.likelihood.gauss_newton import FilteredSolution

# Without the unknown moment w^3 of positive sign, which throws the vehicle over.
PLAN = "single/white:40 none/white:10 unknown/white:5 unknown/white:6-15 unknown/white:16-20"

SURGE = ("force X", "actuator T")
# Places that are right, by the beginning of an effect's name.
PLACES: dict[str, tuple[str, ...]] = {
    "heave_added": ("force Z", "force M"),
    "heave": ("force Z",),
    "pitch_added": ("force M",),
    "pitch": ("force M",),
    "surge": SURGE,
    "excess_buoyancy": ("force Z", "force X"),
    "cg_offset": ("force M",),
    "hull_asymmetry_heave": ("force Z",),
    "hull_asymmetry_pitch": ("force M",),
    "hull_compressibility": ("force Z",),
    "current": ("flow u_r", "flow w_r"),
    "thrust": SURGE,
    "fluid_memory": ("force Z",),
    "wave": ("force Z",),
    "fin": ("actuator ds",),
    "bias_u": ("sensor u",),
    "bias_w": ("sensor w",),
    "bias_q": ("sensor q",),
    "bias_theta": ("sensor theta",),
    "scale_u": ("sensor u",),
    "scale_w": ("sensor w",),
    "scale_q": ("sensor q",),
    "scale_z": ("sensor z",),
    "dvl": ("sensor w", "sensor u"),
    "depth_lag": ("sensor z",),
}
# Equation and product of the terms that no vocabulary holds.
TERMS: dict[str, tuple[str, str]] = {
    "unknown_cubic_pitch_damping": ("M", "q**3"),
    "unknown_speed_pitch_damping": ("M", "u_r*abs(q)*q"),
    "unknown_pitch_moment_wq": ("M", "w_r*q"),
    "unknown_heave_rate_drag": ("Z", "w_r*abs(q)"),
    "unknown_pitch_drift_damping": ("M", "abs(w_r)*q"),
    "unknown_cubic_moment": ("M", "w_r**3"),
    "unknown_cubic_drag": ("X", "u_r**3"),
    "unknown_thrust_moment": ("M", "T"),
    "unknown_fin_in_slipstream": ("M", "ds*T"),
    "unknown_double_angle_moment": ("M", "sin(theta)*cos(theta)"),
}


@dataclass(frozen=True)
class Outcome:
    """What was found in one case.

    Attributes
    ----------
    name : str
        Hidden effect, empty where nothing is hidden.
    located : Located
    right : tuple of str
        Places that are right.
    proposals : Proposals or None
        For unknown effects.
    ratio : float
        Test error with the proposed term over that with the true one.
    seconds : float
        Of locating.
    """

    name: str
    located: Located
    right: tuple[str, ...]
    proposals: Proposals | None
    ratio: float
    seconds: float


def outcome(problem: Problem, case: Case, records: Sequence[Records]) -> Outcome:
    """Locate, and propose where the hidden effect is in no vocabulary."""
    train, test = datasets(problem, records)
    name = next(iter(case.effects), "")
    true: tuple[Force, ...] = ()
    right: tuple[str, ...] = ()
    if name in TERMS:
        axis, product = TERMS[name]
        size = Parameter("E_true", 0.0, scale=abs(case.effects[name]))
        true = (Force("true", {axis: f"E_true*{product}"}, (size,)),)
        right = SURGE if axis == "X" else (f"force {axis}",)
    elif name:
        right = next(places for start, places in PLACES.items() if name.startswith(start))
    study, fit = Study.begin(problem.model, train, test, true, known_noise=False)
    began = time.perf_counter()
    located = locate(fit, study.unit)
    seconds = time.perf_counter() - began
    if not true:
        return Outcome(name, located, right, None, np.nan, seconds)
    proposals = propose(study, fit)
    best = proposals[0]
    wide = study.with_candidates([best.effect])
    ratio = _error(wide, best.fit, test) / _error(
        study, _with_truth(study, fit, case.effects[name]), test
    )
    return Outcome(name, located, right, proposals, ratio, seconds)


def _with_truth(study: Study, fit: FilteredSolution, size: float) -> FilteredSolution:
    """Fit of the true structure, from nothing and from the truth."""
    found = [
        study.estimate(
            study.candidates, dict(fit.values) | {"E_true": start}, fit,
            noise=study.loosened(fit.noise), max_iterations=25,
        )
        for start in (0.0, size)
    ]  # fmt: skip
    return min((f for f in found if f is not None), key=lambda f: f.objective)


def _error(study: Study, fit: FilteredSolution, test: Dataset) -> float:
    """Error of a model on its own, over all outputs, in units of the noise."""
    return float(np.sqrt(np.mean((study.rms(fit, test) / NOISE_STD) ** 2)))


def rows(outcomes: Sequence[Outcome]) -> list[tuple[str, str]]:
    """Measures as pairs of words and numbers."""
    hidden = [o for o in outcomes if o.name]
    seen = [o for o in hidden if o.located.best is not None]
    nothing = [o for o in outcomes if not o.name]
    unknown = [o for o in outcomes if o.proposals is not None]
    second = [{p.name for p in o.located.places[:2]} | set(o.located.group) for o in seen]
    ratios = np.array([o.ratio for o in unknown])
    share = "{} of {}".format
    return [
        ("a place is accused, something hidden", share(len(seen), len(hidden))),
        ("right place first", share(sum(o.located.best in o.right for o in seen), len(seen))),
        (
            "right place in the first two or in the group",
            share(
                sum(bool(s & set(o.right)) for s, o in zip(second, seen, strict=True)), len(seen)
            ),
        ),
        (
            "false accusations, nothing hidden",
            share(sum(o.located.best is not None for o in nothing), len(nothing)),
        ),
        ("seconds to locate, median", f"{np.median([o.seconds for o in outcomes]):.1f}"),
        (
            "unknown term: right equation",
            share(
                sum(o.proposals[0].term.equation == TERMS[o.name][0] for o in unknown),  # type: ignore[index]
                len(unknown),
            ),
        ),
        (
            "unknown term: the true one first",
            share(
                sum(
                    (o.proposals[0].term.equation, o.proposals[0].term.expression)  # type: ignore[index]
                    == TERMS[o.name]
                    for o in unknown
                ),
                len(unknown),
            ),
        ),
        (
            "unknown term: test error within 1.05 of the true term's",
            share(int(np.sum(ratios <= 1.05)), len(unknown)),
        ),
    ]


def main() -> None:
    """Run a plan and print the measures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("plan", nargs="?", default=PLAN)
    plan = draws(parser.parse_args().plan)
    problem = load_problem("remus_diving_plane")
    outcomes = []
    for draw, (case, records) in zip(plan, simulate_draws(plan), strict=True):
        found = outcome(problem, case, records)
        outcomes.append(found)
        text = f"{draw.key} {found.name or 'nothing'}: {', '.join(found.located.group) or 'noise'}"
        if found.proposals is not None:
            text += f"; {found.proposals[0].text}, error {found.ratio:.3f} of the true term's"
        print(text, flush=True)
    print("\n| measure | value |\n|---|---|")
    for words, value in rows(outcomes):
        print(f"| {words} | {value} |")


if __name__ == "__main__":
    main()
