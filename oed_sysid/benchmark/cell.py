"""One run of one estimator: which, on what, and what came of it."""

from __future__ import annotations

import hashlib
import time
import warnings
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from oed_sysid.benchmark.contestants import contestant_by_name
from oed_sysid.benchmark.scenarios import Scenario, load_scenario
from oed_sysid.benchmark.world import IDEAL, world_by_name
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError, SimulationError
from oed_sysid.experiment import Experiment
from oed_sysid.fitting.fit import Fit
from oed_sysid.information import Information
from oed_sysid.model import Model
from oed_sysid.noise.model import NoiseModel
from oed_sysid.sensitivity import information_of
from oed_sysid.simulation import simulate, simulate_inputs

# Raised whenever the same cell would give another result.
FORMAT, WORLD_FORMAT = 1, 3
# What numerical methods end with on hard data; everything else is a fault of a program, which
# has no place in a table of methods.
GAVE_UP = (ValueError, ArithmeticError, RuntimeError, np.linalg.LinAlgError)


@dataclass(frozen=True)
class Cell:
    """What determines one run.

    Parameters
    ----------
    problem, estimator : str
        Names.
    noise : float
        Level, in the unit ``noise_unit``.
    noise_unit : str
        ``"peak"`` (per cent) or ``"declared"`` (multiples).
    sampling : int
        Times the problem's sample time.
    seed : int
        Of noise, start values and random searches.
    spread : float
        Start values are off by up to this share, uniformly.
    world : str
        What the records hold that no model says; see :mod:`oed_sysid.benchmark.world`.
    """

    problem: str
    estimator: str
    noise: float
    noise_unit: str = "peak"
    sampling: int = 1
    seed: int = 0
    spread: float = 0.3
    world: str = IDEAL

    @property
    def key(self) -> str:
        """Name in a store: everything that shapes the result but the code of the estimators."""
        settings = contestant_by_name(self.estimator)
        fields = asdict(self)
        if self.world == IDEAL:  # as runs were named before there were worlds
            del fields["world"]
        else:
            fields["world"] = (world_by_name(self.world), WORLD_FORMAT)
        content = f"{FORMAT} {fields} {load_scenario(self.problem).digest} {settings!r}"
        digest = hashlib.sha256(content.encode()).hexdigest()[:12]
        world = "" if self.world == IDEAL else f"{self.world} "
        return (
            f"{self.problem} {self.estimator} {world}noise {self.noise:g} seed {self.seed} "
            f"sampling {self.sampling} {digest}"
        )

    def rng(self, purpose: str) -> np.random.Generator:
        """Random numbers that all estimators and noise levels share."""
        word = f"{self.problem} {purpose} {self.sampling}"
        return np.random.default_rng([zlib.crc32(word.encode()), self.seed])


@dataclass(frozen=True)
class Outcome:
    """What came of one run.

    Attributes
    ----------
    cell : Cell
    status : str
        That of the fit; ``refused`` if the estimator cannot treat the problem,
        ``error`` if it gave up.
    message : str
        In words, where it is not ``converged``.
    errors : mapping of str to float
        Estimate over truth, minus one; empty where there is no estimate.
    covered : mapping of str to bool
        Whether the stated 95 % interval holds the truth; empty without noise.
    bounds : mapping of str to float
        Least relative standard error that these data allow (Cramér-Rao), start
        states unknown, random forces and colour of the world counted as noise;
        infinite where they say nothing.
    prediction : float
        Root mean square error of the model on the validation run, from the true
        start state and against the truth, in units of the noise (of 0.1 % of
        the peak where there is none); infinite where it diverges.
    iterations : int
    seconds : float
        Of the fit alone, compilation of the model included if it is the first.
    """

    cell: Cell
    status: str
    message: str
    errors: Mapping[str, float]
    covered: Mapping[str, bool]
    bounds: Mapping[str, float]
    prediction: float
    iterations: int
    seconds: float

    @property
    def failed(self) -> bool:
        """Whether a user would be left without values to rely on."""
        return self.status != "converged"


def run_cell(cell: Cell) -> Outcome:
    """Simulate, fit and judge; a failure of the estimator is a result, not an error."""
    scenario, world = load_scenario(cell.problem), world_by_name(cell.world)
    sigma = scenario.noise(cell.noise, cell.noise_unit)
    model = scenario.with_noise(sigma)
    runs = tuple(_at(experiment, cell.sampling) for experiment in scenario.train)
    rng, noisy = cell.rng("noise"), bool(sigma.any())
    if cell.world == IDEAL:
        dataset = Dataset(tuple(simulate(model, run, rng=rng, noise=noisy) for run in runs))
    else:
        dataset = Dataset(tuple(world.record(model, run, rng=rng, noise=noisy) for run in runs))
    noise = [world.noise(model, run) for run in runs]
    bounds = dict(zip(model.free_names, _bounds(model, dataset, noise), strict=True))
    contestant = contestant_by_name(cell.estimator)
    handed = world.believed(_away(model, cell, world.start), cell.rng("known"))
    estimator, start = contestant.prepared(handed, scenario.start, cell.seed)
    began = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # the status says it
            fit = estimator.fit(start, dataset)
    except GAVE_UP as error:
        status = "refused" if isinstance(error, ModelError) else "error"
        seconds = time.perf_counter() - began
        return Outcome(cell, status, _brief(error), {}, {}, bounds, np.inf, 0, seconds)
    return Outcome(
        cell,
        fit.status.code if np.isfinite(fit.estimates).all() else "diverged",
        fit.status.advice,
        _errors(fit, scenario.truth),
        _covered(fit, scenario.truth) if noisy else {},
        bounds,
        _prediction(fit, scenario, model),
        fit.iterations,
        fit.seconds,
    )


def _at(experiment: Experiment, sampling: int) -> Experiment:
    """Sampled more rarely, commands too, so that every estimator knows the inputs exactly."""
    return replace(experiment, sample_time=sampling * experiment.sample_time)


def _away(model: Model, cell: Cell, factor: float = 1.0) -> Model:
    """Start values away from the truth, within bounds."""
    rng = cell.rng("start")
    values = {}
    for parameter in model.free_parameters:
        off = rng.uniform(-1.0, 1.0)
        moved = parameter.value * (factor**off if factor > 1 else 1.0 + cell.spread * off)
        values[parameter.name] = float(np.clip(moved, parameter.lower, parameter.upper))
    return model.with_values(values)


def _bounds(model: Model, dataset: Dataset, noise: Sequence[NoiseModel]) -> list[float]:
    """Relative standard errors that nobody can undercut who is told all that is random."""
    truth = np.array([abs(model.values[name]) for name in model.free_names])
    known: Information | None = None
    for record, levels in zip(dataset, noise, strict=True):
        known = information_of(model, record, noise=levels, priors=known)
    assert known is not None
    return [float(x) for x in known.std_errors / truth]


def _errors(fit: Fit, truth: Mapping[str, float]) -> dict[str, float]:
    finite = np.isfinite(fit.estimates).all()
    # Without a covariance a diverged fit only hands its start values back; a regression
    # has values of its own even where the model that they make runs away.
    if not finite or (fit.status.code == "diverged" and not np.isfinite(fit.covariance).all()):
        return {}
    return {name: value / truth[name] - 1.0 for name, value in fit.values.items()}


def _covered(fit: Fit, truth: Mapping[str, float]) -> dict[str, bool]:
    intervals = {name: fit.interval(name) for name in fit.names}
    return {
        name: bool(low <= truth[name] <= high) if np.isfinite([low, high]).all() else False
        for name, (low, high) in intervals.items()
    }


def _prediction(fit: Fit, scenario: Scenario, model: Model) -> float:
    test = simulate(model, scenario.test, noise=False)
    try:
        run = simulate_inputs(
            fit.model, test.times, inputs=test.inputs, initial=scenario.test.initial
        )
    except SimulationError:
        return float(np.inf)
    sigma = np.array([output.noise_std for output in model.outputs], dtype=float)
    error = float(np.sqrt(np.mean(((run.outputs - test.outputs) / sigma) ** 2)))
    return error if np.isfinite(error) else float(np.inf)


def _brief(error: Exception) -> str:
    """First sentence of an error, short enough for a table."""
    text = str(error).partition(". ")[0].strip().rstrip(".")
    words = text if len(text) <= 150 else text[:147].rsplit(" ", 1)[0] + " ..."
    return words if isinstance(error, ValueError) else f"{type(error).__name__}: {words}"
