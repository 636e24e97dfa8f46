"""One run of one estimator: which, on what, told what, and what came of it."""

from __future__ import annotations

import hashlib
import time
import warnings
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import lru_cache
from math import radians
from typing import Any, cast

import numpy as np

from oed_sysid import baselines as methods
from oed_sysid.baselines.kalman import RELATIVE_PRIOR
from oed_sysid.baselines.world import IDEAL, world_by_name
from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import ModelError, ProblemError, SimulationError, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Manoeuvre, ZigZag, ZigZagLike
from oed_sysid.experiments.problem import Problem, load_problem
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.information import information_of
from oed_sysid.likelihood.estimator import Estimator, Solver
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.multiple_shooting import MultipleShooting
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import THREE_DIGITS

UNITS = {"peak": "% of peak", "declared": "x declared noise"}


@dataclass(frozen=True)
class Scenario:
    """One problem as it is benchmarked.

    Attributes
    ----------
    name : str
        The problem's name, or the folder it came from.
    model : Model
        At the true values, without priors: what is measured is what the data say.
    train : tuple of Experiment
        Runs to learn from.
    test : Experiment
        A run that no estimator sees.
    peaks : ndarray (n_outputs,)
        Largest excursion of each output from its start, over the training runs.
    """

    name: str
    model: Model
    train: tuple[Experiment, ...]
    test: Experiment
    peaks: np.ndarray

    @property
    def truth(self) -> dict[str, float]:
        """True value of each free parameter."""
        return {name: self.model.values[name] for name in self.model.free_names}

    @property
    def digest(self) -> str:
        """Changes with the model, its true values and the runs."""
        content = f"({self.model.content}, {self.train!r}, {self.test!r})"
        return hashlib.sha256(content.encode()).hexdigest()[:16]

    @property
    def start(self) -> dict[str, float] | None:
        """True start state, where there is one training run; None where there are several."""
        if len(self.train) > 1:
            return None
        return {name: self.train[0].initial.get(name, 0.0) for name in self.model.state_names}

    def noise(self, level: float, unit: str = "peak") -> np.ndarray:
        """Standard deviations of the outputs, shape ``(n_outputs,)``, at a noise level.

        Parameters
        ----------
        level : float
            Per cent of the peak, or multiples of the declared noise.
        unit : str
            ``"peak"`` or ``"declared"``.
        """
        located(ProblemError, "Noise has no unit", [unit], UNITS)
        if level < 0:
            raise ProblemError(f"Noise level {level} is negative. Give 0 or more.")
        if unit == "peak":
            return level / 100.0 * self.peaks
        declared = given_levels(self.model.outputs)
        if np.isnan(declared).any():
            raise ProblemError(
                f"Problem {self.name!r} does not declare the noise of all outputs. Give noise as a "
                "share of the peak."
            )
        return level * declared

    def with_noise(self, sigma: np.ndarray) -> Model:
        """Return the true model with outputs that declare this noise, or a small one for none."""
        return self.model.with_noise(np.where(sigma > 0, sigma, THREE_DIGITS * self.peaks))


@lru_cache(maxsize=16)
def load_scenario(problem: str) -> Scenario:
    """Prepare a shipped problem by name, or one of your own by folder.

    All experiments but the last are learned from, and the last judges. Shipped
    problems whose source has a single manoeuvre are judged by another one that
    is given here.

    Raises
    ------
    ProblemError
        If the problem has fewer than two experiments, or a true value is zero.
    """
    loaded = load_problem(problem)
    model = loaded.true_model() if loaded.truth else loaded.model
    # Start values say nothing about the truth, so priors would be wrong or a gift.
    names = model.parameter_names
    model = model.changed(names, lambda p: replace(p, prior_mean=None, prior_std=None))
    train, test = _split(loaded, problem)
    if zero := [name for name in model.free_names if model.values[name] == 0.0]:
        raise ProblemError(
            f"The true value of {zero[0]!r} in problem {problem!r} is zero, so that no error can "
            "be relative to it. Fix the parameter or give it a value."
        )
    outputs = [simulate(model, experiment, noise=False).outputs for experiment in train]
    # Excursions from the start: an absolute depth or heading would hide small motions.
    peaks = np.max([np.abs(one - one[0]).max(axis=0) for one in outputs], axis=0)
    return Scenario(problem, model, train, test, peaks)


def _split(problem: Problem, name: str) -> tuple[tuple[Experiment, ...], Experiment]:
    """Runs to learn from, and one to judge by."""
    if name in _SPLITS:
        own, changes, other, manoeuvre = _SPLITS[name]
        single = replace(problem.experiment(own), **changes)
        return (single,), replace(single, name=other, manoeuvre=manoeuvre(problem))
    *train, test = problem.experiments.values() or (None,)
    if not train or test is None:
        raise ProblemError(
            f"Problem {problem.name!r} has {len(problem.experiments)} experiments; the benchmark "
            "learns from all but the last and judges by that. Add experiments to its problem.py."
        )
    return tuple(train), test


# Problems whose source has a single manoeuvre: it is learned from, with the changes given, and
# another one of the same kind judges, by its name.
_SPLITS: Mapping[str, tuple[str, Mapping[str, Any], str, Callable[[Problem], Manoeuvre]]] = {
    "auv_diving_plane": (
        "zigzag_5_5",
        {},
        "zigzag_3.5_2.5",
        lambda _: ZigZagLike("delta_s", radians(3.5), radians(2.5), rate=radians(2.5)),
    ),
    # The published fine sampling; a factor of five gives the published coarse one.
    "nomoto_sparse_heading": (
        "zigzag_15_15",
        {"sample_time": 0.1},
        "zigzag_10_10",
        lambda problem: ZigZag(
            "delta", radians(10.0), radians(10.0), rate=problem.limits.rates["delta"]
        ),
    ),
    "torpedo": (
        "pitching",
        {},
        "pitching_gently",
        lambda _: ZigZagLike(
            "delta",
            tuple(map(radians, (18.0, 10.0, 22.0, 15.0))),
            tuple(map(radians, (20.0, 30.0, 10.0))),
        ),
    ),
}


OURS = "multiple_shooting"
OURS_DISTURBED = "multiple_shooting_disturbed"
OURS_IPOPT = "multiple_shooting_ipopt"
OURS_DISTURBED_IPOPT = "multiple_shooting_disturbed_ipopt"
OURS_BELIEVING = "multiple_shooting_prior"
OURS_DISTURBED_BELIEVING = "multiple_shooting_disturbed_prior"
OURS_DISTURBED_TOLD = "multiple_shooting_disturbed_told"
# Noise of the sensors alone, and the fit's own choice of noise.
PLAIN = MultipleShooting(disturbances="none", loss="square")
AUTOMATIC = MultipleShooting(disturbances="auto", loss="auto")


# Take start values as a prior by their nature.
BELIEVERS = ("ekf", "ukf", "ekf_tuned", "ukf_tuned")


@dataclass(frozen=True)
class FromStart:
    """An estimator by multiple shooting whose records all begin at a known state.

    Parameters
    ----------
    estimator : MultipleShooting
    initial : mapping of str to float, optional
        States, in their units; those not named are free.
    """

    estimator: MultipleShooting
    initial: Mapping[str, float] | None = None

    @property
    def name(self) -> str:
        """Of the estimator, and what it is told."""
        return f"{self.estimator.name}, told the start"

    def fit(self, model: Model, dataset: Dataset) -> Fit:
        """Estimate the free parameters."""
        return self.estimator.fit(model, dataset, start_states=self.initial)


@dataclass(frozen=True)
class Contestant:
    """An estimator and what it is told besides the data and the start values.

    Parameters
    ----------
    estimator : Estimator
        With its settings.
    believes : bool
        Take start values as a prior of relative width 0.5. A Kalman filter
        does by its nature; for others it is a choice, and a fair comparison
        with the filter makes it.
    knows_start : bool
        Be told the true start state where there is one training run, as in the
        source of the differential swarm, and a region (:func:`with_region`). A search by a
        population needs it; for others it is a choice, and a fair comparison with one makes it.
    """

    estimator: Estimator
    believes: bool = False
    knows_start: bool = False

    def prepared(
        self, model: Model, start: Mapping[str, float] | None, seed: int
    ) -> tuple[Estimator, Model]:
        """Return the estimator with a seed, and the model with what is believed of it."""
        changes: dict[str, Any] = {"seed": seed} if hasattr(self.estimator, "seed") else {}
        if self.knows_start:
            model = with_region(model)
            if start is not None:
                changes["initial"] = dict(start)
        estimator = cast(Estimator, replace(cast(Any, self.estimator), **changes))
        return estimator, with_beliefs(model) if self.believes else model


# Defaults, but for what a benchmark needs: the published online weight, one process for a
# swarm that runs beside others, and Gibbs draws enough for a mean and an interval.
CONTESTANTS: Mapping[str, Contestant] = {
    OURS: Contestant(PLAIN),
    OURS_DISTURBED: Contestant(AUTOMATIC),
    OURS_IPOPT: Contestant(replace(PLAIN, solver=Solver("ipopt"))),
    OURS_DISTURBED_IPOPT: Contestant(replace(AUTOMATIC, solver=Solver("ipopt"))),
    OURS_BELIEVING: Contestant(PLAIN, believes=True),
    OURS_DISTURBED_BELIEVING: Contestant(AUTOMATIC, believes=True),
    OURS_DISTURBED_TOLD: Contestant(FromStart(AUTOMATIC), knows_start=True),
    "output_error": Contestant(methods.OutputError()),
    "equation_error": Contestant(methods.EquationError()),
    "equation_error_simpson": Contestant(methods.EquationError(rule="simpson")),
    "total_least_squares": Contestant(methods.TotalLeastSquares()),
    "ls_svm": Contestant(methods.LeastSquaresSVM()),
    "ls_svm_tuned": Contestant(
        methods.LeastSquaresSVM(C="cross-validated", scale="unit", rule="local")
    ),
    "online_ls_svm": Contestant(methods.OnlineRegression(C=3e5)),
    "svr": Contestant(methods.SupportVectorRegression()),
    "gibbs": Contestant(methods.GibbsRegression(n_draws=500, burn_in=200)),
    "ekf": Contestant(methods.JointKalmanFilter()),
    "ukf": Contestant(methods.JointKalmanFilter(kind="unscented")),
    "ekf_tuned": Contestant(methods.JointKalmanFilter(process_std="likeliest")),
    "ukf_tuned": Contestant(methods.JointKalmanFilter(kind="unscented", process_std="likeliest")),
    "heading_differences": Contestant(methods.HeadingDifferences()),
    "heading_differences_central": Contestant(methods.HeadingDifferences("central")),
    "differential_swarm": Contestant(methods.DifferentialSwarm(n_workers=1), knows_start=True),
    "differential_evolution": Contestant(
        methods.DifferentialEvolution(n_workers=1), knows_start=True
    ),
    "cma_es": Contestant(methods.CovarianceMatrixAdaptation(n_workers=1), knows_start=True),
    "particle_swarm": Contestant(methods.ParticleSwarm(n_workers=1), knows_start=True),
}


# Searches by whole populations of trajectories: minutes where others take fractions of a second.
POPULATIONS = tuple(
    name for name, one in CONTESTANTS.items() if one.knows_start and name != OURS_DISTURBED_TOLD
)


# Tuned to the record that they are given, by fits of it again and again; and a second solver.
TUNED = (OURS_IPOPT, OURS_DISTURBED_IPOPT, "ls_svm_tuned", "ekf_tuned", "ukf_tuned")


QUICK = tuple(
    name for name in CONTESTANTS if name not in (*POPULATIONS, *TUNED, OURS_DISTURBED_TOLD)
)


def contestant_by_name(name: str) -> Contestant:
    """Return one estimator of the comparison.

    Examples
    --------
    >>> contestant_by_name("output_error").estimator.name
    'output error (single shooting)'
    """
    located(ModelError, "The benchmark has no estimator", [name], CONTESTANTS)
    return CONTESTANTS[name]


def with_region(model: Model, factor: float = 4.0) -> Model:
    """Return the model whose free parameters lie within a factor of their values.

    Bounds that the problem states stay.
    """

    def bounded(p: Parameter) -> Parameter:
        low, high = sorted((p.value / factor, p.value * factor))
        return replace(
            p,
            lower=p.lower if np.isfinite(p.lower) else low,
            upper=p.upper if np.isfinite(p.upper) else high,
        )

    return model.changed(model.free_names, bounded)


def with_beliefs(model: Model) -> Model:
    """Return the model whose free parameters have their values as prior means."""

    def believed(p: Parameter) -> Parameter:
        return replace(p, prior_mean=p.value, prior_std=RELATIVE_PRIOR * p.magnitude)

    return model.changed(model.free_names, believed)


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
        What the records hold that no model says; see :mod:`oed_sysid.baselines.world`.
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
            fields["world"] = (world_by_name(self.world), 4)
        # Numbers (1 here, 4 of worlds) are raised whenever the same cell would give another result.
        content = f"1 {fields} {load_scenario(self.problem).digest} {settings!r}"
        digest = hashlib.sha256(content.encode()).hexdigest()[:12]
        world = "" if self.world == IDEAL else f"{self.world} "
        return (
            f"{self.problem} {self.estimator} {world}noise {self.noise:g} seed {self.seed} "
            f"sampling {self.sampling} {digest}"
        )

    def rng(self, purpose: str) -> np.random.Generator:
        """Random numbers that all estimators and noise levels share."""
        # Neither estimator nor noise level is in the seed: all are given the same draws.
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
        states unknown, disturbance forces and colour of the world counted as noise;
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
    # Sampled more rarely, commands too, so that every estimator knows the inputs exactly.
    runs = tuple(replace(e, sample_time=cell.sampling * e.sample_time) for e in scenario.train)
    rng, noisy = cell.rng("noise"), bool(sigma.any())
    dataset = Dataset(tuple(world.record(model, run, rng=rng, noise=noisy) for run in runs))
    noise = [world.noise(model, run) for run in runs]
    # Cramer-Rao bounds at the truth, with all that is random told.
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
    status = fit.status.code if np.isfinite(fit.estimates).all() else "diverged"
    covered = _covered(fit, scenario.truth) if noisy else {}
    judged = _errors(fit, scenario.truth), covered, bounds, _prediction(fit, scenario, model)
    return Outcome(cell, status, fit.status.advice, *judged, fit.iterations, fit.seconds)


def _away(model: Model, cell: Cell, factor: float = 1.0) -> Model:
    """Start values away from the truth, within bounds."""
    rng = cell.rng("start")
    values = {}
    for parameter in model.free_parameters:
        off = rng.uniform(-1.0, 1.0)
        moved = parameter.value * (factor**off if factor > 1 else 1.0 + cell.spread * off)
        values[parameter.name] = moved
    return model.within_bounds(values)


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
    off = (run.outputs - test.outputs) / given_levels(model.outputs)
    error = float(np.sqrt(np.mean(off**2)))
    return error if np.isfinite(error) else float(np.inf)


def _brief(error: Exception) -> str:
    """First sentence of an error, short enough for a table."""
    text = str(error).partition(". ")[0].strip().rstrip(".")
    words = text if len(text) <= 150 else text[:147].rsplit(" ", 1)[0] + " ..."
    return words if isinstance(error, ValueError) else f"{type(error).__name__}: {words}"
