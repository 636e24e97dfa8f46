"""Numbers of `docs/measured_data.md`: the examples on measured records, run as they are."""

from __future__ import annotations

import contextlib
import io
import runpy
from typing import Any

from benchmarks.documents.page import ROOT, Numbers, Page
from oed_sysid import MultipleShooting, improve, load_problem
from oed_sysid.evidence.improvement import Improvement, Step
from oed_sysid.likelihood.noise_levels import white_levels


def ran(example: str) -> dict[str, Any]:
    """What the names of an example stand for after it ran; what it prints is left."""
    with contextlib.redirect_stdout(io.StringIO()):
        return runpy.run_path(str(ROOT / "examples" / f"{example}.py"), run_name="__main__")


def of(found: Improvement) -> Numbers:
    """A search: its steps, errors in units of each output, and what is left."""
    after = found.steps[-1].rms if found.steps else found.base_rms
    names = [output.name for output in found.yardstick.outputs]
    words = {step.added: _words(found, step) for step in found.steps}
    return {
        "steps": [
            {
                "words": words[step.added],
                "names": list(step.group),
                "gain": step.claim.training,
                "needed": step.claim.needed,
                "test_gain": step.claim.validation,
            }
            for step in found.steps
        ],
        "in_order": "; ".join(words.values()),
        "gains": [refit.gain for refit in found.ranking.refits],
        "order": [refit.name for refit in found.ranking.refits],
        "kind": found.remains.kind,
        "left": found.remains.sentence,
        "verdict": found.verdict,
        "before": {
            part: dict(zip(names, rms, strict=True)) for part, rms in found.base_rms.items()
        },
        "after": {part: dict(zip(names, rms, strict=True)) for part, rms in after.items()},
        "spread": dict(zip(names, found.yardstick.spread["train"], strict=True)),
        "notes": list(found.notes),
    }


def _words(found: Improvement, step: Step) -> str:
    """An effect and its rivals; of a proposed term, which it is and what it takes the place of."""
    words = " *or* ".join(step.group)
    for term in found.proposed:
        if term["name"] == step.added:
            words = f"a proposed term, {term['term']} in the equation of {term['equation']}"
            words += ", in the place of " + ", ".join(term["replaces"]) if term["replaces"] else ""
    return words.replace("_", " ")


def roll_decay() -> Numbers:
    """The roll decay, its search, and the last periods alone; angles in rad."""
    names = ran("roll_decay")
    errors = {
        name: fit.predict(names["test"]).rms["phi"]
        for name, fit in (("linear", names["linear"]), ("improved", names["better"]))
    }
    return {
        "found": of(names["found"]),
        "errors": errors,
        "tail": {
            "steps": [step.added for step in names["refused"].steps],
            "nonlinear": names["nonlinear"],
            "duration": names["tail"][0].duration,
        },
    }


def silverbox() -> Numbers:
    """The Silverbox, V: the search, and the same structures as plain fits."""
    names = ran("silverbox")
    errors = {name: fit.predict(names["test"]).rms["y"] for name, fit in names["errors"].items()}
    return {"found": of(names["found"]), "errors": errors}


def drive() -> Numbers:
    """The positioning drive, m: the search, and its parameters with their intervals."""
    names = ran("positioning_drive")
    fit = names["fit"]
    return {
        "found": of(names["found"]),
        "errors": names["errors"],
        "held": [
            name
            for name, value in names["published"].items()
            if name in fit.names and fit.interval(name)[0] <= value <= fit.interval(name)[1]
        ],
    }


def tanks() -> Numbers:
    """The cascaded tanks, V, from two models, without and with disturbance forces."""
    return {
        f"{name.replace(' ', '_')}_{forces}": of(found)
        for (name, forces), found in ran("cascaded_tanks")["found"].items()
    }


def esso_osaka() -> Numbers:
    """Esso Osaka: the wind named, its size by two sets of records, and the untouched runs."""
    names = ran("esso_osaka_wind")
    found, effect, fit = names["improvement"], names["first"], names["found"]
    own = found.steps[0].fit
    return {
        "found": of(found),
        "windows": [len(names["learning"]), len(names["confirming"])],
        "size": {n: [fit.values[n], *fit.interval(n)] for n in effect.amplitude_names},
        "own": {n: [own.values[n], own.std_errors[n]] for n in effect.amplitude_names},
        "ahead": names["mean"],
    }


def slocum_glider() -> Numbers:
    """The glider without disturbance forces (the example), with them, and four explanations."""
    names = ran("slocum_glider")
    train, test, problem = names["train"], names["test"], names["problem"]
    fits = {label: fit.predict(test).rms for label, fit in names["fits"].items()}
    scaled = problem.model + [problem.effect(name) for name in ("inertia", "speed_scale")]
    fits["inertia, speed_scale"] = (
        MultipleShooting(disturbances="none").fit(scaled, train).predict(test).rms
    )
    return {
        "found": of(names["found"]),
        "pitch_scale": [names["scale"], names["doubt"] / 1.96],
        "errors": {label: dict(rms) for label, rms in fits.items()},
        "by_default": of(improve(problem.model, train, test, candidates=problem.effects)),
    }


def noise() -> Numbers:
    """White levels of the training records' signals, and whether the signal shows them."""
    found = {}
    for name, test in (
        ("roll_decay", "test_small"),
        ("cascaded_tanks", "test_second_half"),
        ("silverbox", "test_third_realisation"),
    ):
        levels, seen = white_levels(load_problem(name).data().split(test=test)[0])
        found[name] = {"level": float(levels[0]), "seen": bool(seen[0])}
    return found


PAGE = Page(
    "measured_data",
    {
        section.__name__: section
        for section in (roll_decay, silverbox, drive, tanks, esso_osaka, slocum_glider, noise)
    },
)
