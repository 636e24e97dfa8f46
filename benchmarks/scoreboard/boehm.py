"""PEtab problem Boehm et al. (2014): nine parameters of a signalling pathway, from its files.

The files are looked for in ``boehm_2014/`` of the data folder under the names of
Benchmark-Models-PEtab; where the package ``petab-gui``, which carries the same problem as its
example, is installed, they are taken from there. Their equations are read from the SBML, not
written down here; all eight states, unmeasured, begin where the SBML says.
"""

from __future__ import annotations

import csv
import importlib.util
import xml.etree.ElementTree as ElementTree
from pathlib import Path

import numpy as np

from benchmarks.scoreboard.row import Row, missing, place
from oed_sysid import Dataset, Model, MultipleShooting, Output, Parameter, Record, State
from oed_sysid.language.expressions import to_numpy

FILES = {
    "measurements": ("measurementData_Boehm_JProteomeRes2014.tsv", "meas.tsv"),
    "observables": ("observables_Boehm_JProteomeRes2014.tsv", "obs.tsv"),
    "parameters": ("parameters_Boehm_JProteomeRes2014.tsv", "para.tsv"),
    "model": ("model_Boehm_JProteomeRes2014.xml", "sbml_model.xml"),
}
FOLDER = "boehm_2014"
BEST = "138.22 (negative log-likelihood), Benchmark-Models-PEtab"
STARTS, SEED = 8, 0
# Start values are drawn over this share of the logarithmic ranges about their middle.
RANGE = 0.4
SPREADS = ("sd_pSTAT5A_rel", "sd_pSTAT5B_rel", "sd_rSTAT5A_rel")
SBML, MATH = "{http://www.sbml.org/sbml/level2/version4}", "{http://www.w3.org/1998/Math/MathML}"
OPERATORS = {"plus": "+", "minus": "-", "times": "*", "divide": "/", "power": "**"}


def files() -> dict[str, Path] | None:
    """Paths of the four files, None where some are missing."""
    found = {key: place(f"{FOLDER}/{names[0]}") for key, names in FILES.items()}
    if all(path.is_file() for path in found.values()):
        return found
    package = importlib.util.find_spec("petab_gui")
    if package is None or package.origin is None:
        return None
    example = Path(package.origin).parent / "example" / "Boehm"
    found = {key: example / names[1] for key, names in FILES.items()}
    return found if all(path.is_file() for path in found.values()) else None


def text_of(node: ElementTree.Element) -> str:
    """MathML as text."""
    tag = node.tag.removeprefix(MATH)
    if tag == "math":
        return text_of(node[0])
    if tag == "ci":
        return (node.text or "").strip()
    if tag == "csymbol":
        return "t"
    if tag == "cn":
        parts = [(node.text or "").strip(), *((child.tail or "").strip() for child in node)]
        return f"({'e'.join(parts)})"
    operator, *operands = list(node)
    name, inner = operator.tag.removeprefix(MATH), [text_of(one) for one in operands]
    if name in OPERATORS:
        joined = OPERATORS[name].join(inner)
        return f"({joined})" if len(inner) > 1 else f"({OPERATORS[name]}{joined})"
    return f"{name}({', '.join(inner)})"


def read_model(path: Path, observables: Path, parameters: Path) -> tuple[Model, dict[str, float]]:
    """The model, and its start state."""
    root = ElementTree.parse(path).getroot()[0]

    def every(kind: str) -> list[ElementTree.Element]:
        return list(root.iter(f"{SBML}{kind}"))

    volumes = {one.get("id", ""): float(one.get("size", "1")) for one in every("compartment")}
    species = {one.get("id", ""): one.get("compartment", "") for one in every("species")}
    constants = {one.get("id", ""): float(one.get("value", "0")) for one in every("parameter")}
    rules = {r.get("variable", ""): text_of(r[0]) for r in every("assignmentRule")}
    start = {s.get("id", ""): float(s.get("initialConcentration", "0")) for s in every("species")}
    for one in every("initialAssignment"):
        # Constants alone stand in these; they come from the file, which is a benchmark's.
        start[one.get("symbol", "")] = float(to_numpy(text_of(one[0]), constants))
    rates: dict[str, list[str]] = {name: [] for name in species}
    for reaction in every("reaction"):
        (law,) = reaction.iter(f"{SBML}kineticLaw")
        rate = text_of(law[0])
        for kind, sign in (("listOfReactants", "-"), ("listOfProducts", "+")):
            for one in reaction.findall(f"{SBML}{kind}/{SBML}speciesReference"):
                name, many = one.get("species", ""), float(one.get("stoichiometry", "1"))
                rates[name].append(f"{sign}{many:g}*({rate})/{species[name]}")
    with parameters.open(newline="", encoding="utf-8") as lines:
        table = {row["parameterId"]: row for row in csv.DictReader(lines, delimiter="\t")}
    declared = []
    for name, row in table.items():
        if name in SPREADS:
            continue
        if row["estimate"] == "1":
            low, high = float(row["lowerBound"]), float(row["upperBound"])
            declared.append(Parameter(name, np.sqrt(low * high), lower=low, upper=high, log=True))
        else:
            declared.append(Parameter(name, float(row["nominalValue"]), fixed=True))
    declared += [Parameter(name, size, fixed=True) for name, size in volumes.items()]
    with observables.open(newline="", encoding="utf-8") as lines:
        outputs = tuple(
            Output(row["observableId"], "1", expression=row["observableFormula"])
            for row in csv.DictReader(lines, delimiter="\t")
        )
    model = Model(
        "Boehm et al. (2014)",
        states=tuple(State(name, "1", scale=100.0) for name in species),
        inputs=(),
        outputs=outputs,
        kinematics={name: " ".join(terms) for name, terms in rates.items()},
        signals=rules,
        parameters=tuple(declared),
        step=1.0,
        integrator="implicit",
    )
    return model, start


def read_record(path: Path, model: Model) -> Record:
    """All observables at their times."""
    with path.open(newline="", encoding="utf-8") as lines:
        rows = list(csv.DictReader(lines, delimiter="\t"))
    times = np.array(sorted({float(row["time"]) for row in rows}))
    outputs = np.full((len(times), len(model.outputs)), np.nan)
    for row in rows:
        column = model.output_names.index(row["observableId"])
        outputs[np.searchsorted(times, float(row["time"])), column] = float(row["measurement"])
    return Record("Boehm", times, np.empty((len(times), 0)), outputs, model.channels)


def score() -> list[Row]:
    """Negative log-likelihood at the best of some starts, and how many reach it."""
    what = "PEtab Boehm 2014, negative log-likelihood"
    found = files()
    if found is None:
        names = ", ".join(names[0] for names in FILES.values())
        return [missing(what, BEST, f"{FOLDER}/", f"{names} (or install petab-gui)")]
    model, start = read_model(found["model"], found["observables"], found["parameters"])
    data = Dataset((read_record(found["measurements"], model),))
    estimator = MultipleShooting(disturbances="none", noise="estimate", max_iterations=200)
    rng = np.random.default_rng(SEED)
    reached = []
    for _ in range(STARTS):
        values = {}
        for p in model.free_parameters:
            low, high = np.log([p.lower, p.upper])
            off = 0.5 * RANGE * (high - low) * rng.uniform(-1, 1)
            values[p.name] = float(np.exp(0.5 * (low + high) + off))
        fit = estimator.fit(model.with_values(values), data, start_states=start)
        # Spreads at their maximum of likelihood, which the estimator's, corrected for the
        # number of unknowns, are not.
        residuals = np.vstack(fit.residuals)
        mean = np.nanmean(residuals**2, axis=0)
        count = np.isfinite(residuals).sum(axis=0)
        objective = 0.5 * float(np.sum(count * (np.log(2 * np.pi * mean) + 1)))
        reached.append(objective if np.isfinite(objective) else np.inf)
    best = min(reached)
    near = sum(one < best + 0.1 for one in reached)
    note = (
        f"{near} of {STARTS} starts, drawn over {100 * RANGE:.0f} % of the logarithmic ranges, end "
        "within 0.1 of it; spreads estimated"
    )
    return [Row(what, best, BEST, "", note)]
