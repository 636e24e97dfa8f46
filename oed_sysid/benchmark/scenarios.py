"""What a problem becomes in the benchmark: a truth, runs to learn from, and one to judge by."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from oed_sysid.errors import ProblemError
from oed_sysid.experiment import Experiment
from oed_sysid.manoeuvres import ZigZag, ZigZagLike
from oed_sysid.model import Model
from oed_sysid.parameters import Parameter
from oed_sysid.problem import Problem, load_problem
from oed_sysid.simulation import simulate

# Noise that estimators assume where the data has none, as a share of the peak.
ASSUMED_SHARE = 1e-3
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
        if unit not in UNITS:
            raise ProblemError(f"The unit of noise is {unit!r}. Choose one of {', '.join(UNITS)}.")
        if level < 0:
            raise ProblemError(f"Noise level {level} is negative. Give 0 or more.")
        if unit == "peak":
            return level / 100.0 * self.peaks
        declared = [output.noise_std for output in self.model.outputs]
        if any(std is None for std in declared):
            raise ProblemError(
                f"Problem {self.name!r} does not declare the noise of all outputs. Give noise as a "
                "share of the peak."
            )
        return level * np.array(declared, dtype=float)

    def with_noise(self, sigma: np.ndarray) -> Model:
        """Return the true model with outputs that declare this noise, or a small one for none."""
        stated = np.where(sigma > 0, sigma, ASSUMED_SHARE * self.peaks)
        outputs = tuple(
            replace(output, noise_std=float(std))
            for output, std in zip(self.model.outputs, stated, strict=True)
        )
        return replace(self.model, outputs=outputs)


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
    model = _without_priors(loaded.true_model() if loaded.truth else loaded.model)
    train, test = _SPLITS.get(problem, _default)(loaded)
    if zero := [name for name in model.free_names if model.values[name] == 0.0]:
        raise ProblemError(
            f"The true value of {zero[0]!r} in problem {problem!r} is zero, so that no error can "
            "be relative to it. Fix the parameter or give it a value."
        )
    outputs = [simulate(model, experiment, noise=False).outputs for experiment in train]
    peaks = np.max([np.abs(one - one[0]).max(axis=0) for one in outputs], axis=0)
    return Scenario(problem, model, train, test, peaks)


def _default(problem: Problem) -> tuple[tuple[Experiment, ...], Experiment]:
    *train, test = problem.experiments.values() or (None,)
    if not train or test is None:
        raise ProblemError(
            f"Problem {problem.name!r} has {len(problem.experiments)} experiments; the benchmark "
            "learns from all but the last and judges by that. Add experiments to its problem.py."
        )
    return tuple(train), test


def _without_priors(model: Model) -> Model:
    """Start values say nothing about the truth, so priors would be wrong or a gift."""

    def bare(parameter: Parameter) -> Parameter:
        return replace(parameter, prior_mean=None, prior_std=None)

    effects = tuple(
        replace(effect, parameters=tuple(bare(p) for p in effect.parameters))
        for effect in model.effects
    )
    return replace(model, effects=effects, parameters=tuple(bare(p) for p in model.parameters))


def _auv(problem: Problem) -> tuple[tuple[Experiment, ...], Experiment]:
    train = problem.experiment("zigzag_5_5")
    weaker = ZigZagLike("delta_s", math.radians(3.5), math.radians(2.5), rate=math.radians(2.5))
    return (train,), replace(train, name="zigzag_3.5_2.5", manoeuvre=weaker)


def _nomoto(problem: Problem) -> tuple[tuple[Experiment, ...], Experiment]:
    # The published fine sampling; a factor of five gives the published coarse one.
    train = replace(problem.experiment("zigzag_15_15"), sample_time=0.1)
    angle = math.radians(10.0)
    other = ZigZag("delta", angle, angle, rate=problem.limits.rates["delta"])
    return (train,), replace(train, name="zigzag_10_10", manoeuvre=other)


def _torpedo(problem: Problem) -> tuple[tuple[Experiment, ...], Experiment]:
    train = problem.experiment("pitching")
    other = ZigZagLike(
        "delta",
        tuple(math.radians(a) for a in (18.0, 10.0, 22.0, 15.0)),
        tuple(math.radians(a) for a in (20.0, 30.0, 10.0)),
    )
    return (train,), replace(train, name="pitching_gently", manoeuvre=other)


_SPLITS: Mapping[str, Callable[[Problem], tuple[tuple[Experiment, ...], Experiment]]] = {
    "auv_diving_plane": _auv,
    "nomoto_sparse_heading": _nomoto,
    "torpedo": _torpedo,
}
