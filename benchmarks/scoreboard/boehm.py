"""PEtab problem Boehm et al. (2014): six rates of a signalling pathway, from its files.

The files are looked for in ``boehm_2014/`` of the data folder under the names of
Benchmark-Models-PEtab. Their equations are read from the SBML (by ``libsbml``), not written down
here; the eight states, unmeasured, begin where the SBML says. The likelihood has several maxima,
two of which starts from all over the ranges reach most often: 138.2 and 147.5.
"""

from __future__ import annotations

import csv
import re
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.scoreboard.row import Row, missing, place
from oed_sysid import Dataset, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.text.expressions import to_numpy

FILES = {
    "measurements": "measurementData_Boehm_JProteomeRes2014.tsv",
    "observables": "observables_Boehm_JProteomeRes2014.tsv",
    "parameters": "parameters_Boehm_JProteomeRes2014.tsv",
    "model": "model_Boehm_JProteomeRes2014.xml",
}
FOLDER = "boehm_2014"
BEST = "138.22 (negative log-likelihood), Benchmark-Models-PEtab"
STARTS, SEED = 24, 0
# Start values are drawn over this share of the logarithmic ranges about their middle.
RANGE = 0.9
# Longest step of the implicit integrator, min: with 1 min the likelihood is 0.13 off.
STEP = 0.25


def read_model(path: Path, observables: Path, parameters: Path) -> tuple[Model, dict[str, float]]:
    """The model, and its start state."""
    import libsbml

    sbml = libsbml.readSBML(str(path)).getModel()

    def text(node: Any) -> str:
        # Time has the name t here.
        words = libsbml.formulaToL3String(node).replace("^", "**")
        return re.sub(r"\btime\b", "t", words)

    volumes = {one.getId(): one.getSize() for one in sbml.getListOfCompartments()}
    species = {one.getId(): one.getCompartment() for one in sbml.getListOfSpecies()}
    constants = {one.getId(): one.getValue() for one in sbml.getListOfParameters()}
    rules = {one.getVariable(): text(one.getMath()) for one in sbml.getListOfRules()}
    start = {one.getId(): one.getInitialConcentration() for one in sbml.getListOfSpecies()}
    for one in sbml.getListOfInitialAssignments():
        start[one.getSymbol()] = float(to_numpy(text(one.getMath()), constants))
    rates: dict[str, list[str]] = {name: [] for name in species}
    for reaction in sbml.getListOfReactions():
        rate = text(reaction.getKineticLaw().getMath())
        for sign, taking_part in (
            ("-", reaction.getListOfReactants()),
            ("+", reaction.getListOfProducts()),
        ):
            for one in taking_part:
                name = one.getSpecies()
                rates[name].append(f"{sign}{one.getStoichiometry():g}*({rate})/{species[name]}")
    table = {row["parameterId"]: row for row in rows_of(parameters)}
    declared = []
    for name, row in table.items():
        if name.startswith("sd_"):
            continue  # spreads of the measurements: levels of the outputs' noise
        if row["estimate"] == "1":
            low, high = float(row["lowerBound"]), float(row["upperBound"])
            declared.append(Parameter(name, np.sqrt(low * high), lower=low, upper=high, log=True))
        else:
            declared.append(Parameter(name, float(row["nominalValue"]), fixed=True))
    declared += [Parameter(name, size, fixed=True) for name, size in volumes.items()]
    outputs = tuple(
        Output(row["observableId"], "1", expression=row["observableFormula"])
        for row in rows_of(observables)
    )
    model = Model(
        "Boehm et al. (2014)",
        states=tuple(State(name, "1", scale=100.0) for name in species),
        inputs=(),
        outputs=outputs,
        kinematics={name: " ".join(terms) for name, terms in rates.items()},
        signals=rules,
        parameters=tuple(declared),
        step=STEP,
        integrator="implicit",
    )
    return model, start


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a table separated by tabs."""
    with path.open(newline="", encoding="utf-8") as lines:
        return list(csv.DictReader(lines, delimiter="\t"))


def read_record(path: Path, model: Model) -> Record:
    """All observables at their times."""
    rows = rows_of(path)
    times = np.array(sorted({float(row["time"]) for row in rows}))
    outputs = np.full((len(times), len(model.outputs)), np.nan)
    for row in rows:
        column = model.output_names.index(row["observableId"])
        outputs[np.searchsorted(times, float(row["time"])), column] = float(row["measurement"])
    return Record("Boehm", times, np.empty((len(times), 0)), outputs, model.channels)


def negative_log_likelihood(residuals: np.ndarray) -> float:
    """At the spreads that make it least: one for each observable."""
    mean = np.nanmean(residuals**2, axis=0)
    count = np.isfinite(residuals).sum(axis=0)
    return 0.5 * float(np.sum(count * (np.log(2 * np.pi * mean) + 1)))


def score() -> list[Row]:
    """Negative log-likelihood at the best of some starts, and how many reach it."""
    what = "PEtab Boehm 2014, negative log-likelihood"
    found = {key: place(f"{FOLDER}/{name}") for key, name in FILES.items()}
    if lacking := [path.name for path in found.values() if not path.is_file()]:
        return [missing(what, BEST, f"{FOLDER}/", ", ".join(lacking))]
    try:
        model, start = read_model(found["model"], found["observables"], found["parameters"])
    except ImportError:
        return [Row(what, None, BEST, note="the model is SBML: pip install python-libsbml")]
    data = Dataset((read_record(found["measurements"], model),))
    estimator = MultipleShooting(
        disturbances="none", noise="estimate", start="near", loss="square", max_iterations=200
    )
    rng = np.random.default_rng(SEED)
    reached = []
    for _ in range(STARTS):
        values = {}
        for p in model.free_parameters:
            low, high = np.log([p.lower, p.upper])
            away = 0.5 * RANGE * (high - low) * rng.uniform(-1, 1)
            values[p.name] = float(np.exp(0.5 * (low + high) + away))
        fit = estimator.fit(model.with_values(values), data, start_states=start)
        objective = negative_log_likelihood(np.vstack(fit.residuals))
        reached.append(objective if np.isfinite(objective) else np.inf)
    best = min(reached)
    near = sum(one < best + 0.1 for one in reached)
    note = (
        f"{near} of {STARTS} starts, drawn over {100 * RANGE:.0f} % of the logarithmic ranges, end "
        "within 0.1 of it; spreads estimated"
    )
    return [Row(what, best, BEST, "", note)]
