"""The contract of a problem folder, to be run on every problem that is added.

>>> import tempfile
>>> from pathlib import Path
>>> from oed_sysid.experiments.problem import new_problem
>>> with tempfile.TemporaryDirectory() as place:
...     check_problem(new_problem(Path(place) / "my_ship"), rng=np.random.default_rng(1))

The contract of an effect, to be run on every effect that is added.

>>> from oed_sysid.physics.channels import Input, Output, State
>>> from oed_sysid.physics import quadratic_drag
>>> from oed_sysid.physics.model import Model
>>> from oed_sysid.physics.parameters import Parameter
>>> roll = Model(
...     "roll",
...     states=(State("phi", "rad"), State("p", "rad/s")),
...     inputs=(),
...     outputs=(Output("phi", "rad"),),
...     axes={"K": "p"},
...     inertia={("K", "p"): "I_xx"},
...     kinematics={"phi": "p"},
...     parameters=(Parameter("I_xx", 2.0, "kg m^2"),),
... )
>>> damping = quadratic_drag("damping", "K", "p", scale=0.2)
>>> check_effect(damping, roll, rng=np.random.default_rng(1), mirror=("phi", "p"))
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from oed_sysid import Dataset, Experiment, Model, OedSysidError, Problem, load_problem, simulate
from oed_sysid.compiled.kernels import Kernel
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.experiments.definition import effect_faults
from oed_sysid.information import information_of
from oed_sysid.physics import Effect
from oed_sysid.runtime.constants import DIFFERENCE_STEP

# -- the contract of an effect ---------------------------------------------------------


def check_effect(
    effect: Effect,
    model: Model,
    *,
    rng: np.random.Generator,
    initial: Mapping[str, float] | None = None,
    inputs: Mapping[str, tuple[float, float]] | None = None,
    mirror: Collection[str] = (),
    amplitude_sign: int = 1,
    n_times: int = 40,
    n_points: int = 2,
) -> None:
    """Check everything that the package relies on in an effect.

    * It is described, cited, and says what it needs; amplitudes may be zero.
    * The units of its terms follow from those of its parameters.
    * At zero amplitude the outputs are those of the model without it.
    * At its typical amplitude they are not.
    * Sensitivities equal finite differences, at random points and, from the
      side of growing amplitude, at zero.
    * Where a symmetry is claimed, mirrored motion stays mirrored.

    Parameters
    ----------
    effect : Effect
        The effect, at any value of its parameters.
    model : Model
        A model that can carry it, and does not yet.
    rng : numpy.random.Generator
        Source of the random points.
    initial : mapping, optional
        Mean initial states, zero by default.
    inputs : mapping, optional
        Lowest and highest command of each input, by default -1 and 1.
    mirror : collection of str, optional
        States, inputs and outputs that change sign when the motion is mirrored
        (port and starboard, up and down); empty claims nothing.
    amplitude_sign : int
        -1 where the amplitude changes sign in the mirror too, as an offset does.
    n_times, n_points : int
        Samples of a trajectory and number of random points.

    Raises
    ------
    AssertionError
        With a line for every broken promise.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("nomoto_sparse_heading")
    >>> for effect in problem.effects[:1]:
    ...     check_effect(effect, problem.model, rng=np.random.default_rng(0))
    """
    probe = _Probe(effect, model, dict(initial or {}), dict(inputs or {}), n_times)
    broken = [*_words(effect), *effect_faults([effect], model)]
    broken += probe.absent_at_zero(rng)
    for _ in range(n_points):
        broken += probe.jacobian(rng)
    broken += probe.slope_at_zero(rng)
    if mirror:
        broken += probe.mirrored(rng, frozenset(mirror), amplitude_sign)
    refuse(f"Effect {effect.name!r}", broken)


def refuse(who: str, broken: Iterable[str]) -> None:
    """Raise with a line for every broken promise, if there is one."""
    lines = "".join(f"\n- {line}" for line in dict.fromkeys(broken))
    if lines:
        raise AssertionError(f"{who}:{lines}")


def unkept(claims: Iterable[tuple[Any, str]]) -> list[str]:
    """What is said of the claims that do not hold."""
    return [words for holds, words in claims if not holds]


def _words(effect: Effect) -> list[str]:
    claims = [
        (getattr(effect, word), f"has no {word}") for word in ("description", "source", "needs")
    ]
    for p in effect.parameters:
        if p.name in effect.amplitude_names:
            claims += [
                (p.lower <= 0.0 <= p.upper, f"amplitude {p.name} cannot be zero"),
                (p.scale is not None, f"amplitude {p.name} has no typical scale"),
            ]
    return unkept(claims)


# -- trajectories ------------------------------------------------------------------


@dataclass(frozen=True)
class _Probe:
    """Runs of a model with and without one effect."""

    effect: Effect
    model: Model
    initial: dict[str, float]
    ranges: dict[str, tuple[float, float]]
    n_times: int

    @property
    def zero(self) -> dict[str, float]:
        """Amplitudes at which the effect is absent."""
        return dict.fromkeys(self.effect.amplitude_names, 0.0)

    def with_effect(self, values: Mapping[str, float]) -> Model:
        """Model that carries the effect, only the effect's parameters free."""
        return self.model.fix(*self.model.parameter_names) + self.effect.with_values(values)

    def scenario(self, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Random initial states ``(n_own,)`` and held commands ``(n_times, n_inputs)``."""
        own = np.array([self.initial.get(name, 0.0) for name in self.model.state_names])
        own += 0.3 * rng.uniform(-1, 1, len(own)) * [state.scale for state in self.model.states]
        commands = np.empty((self.n_times, len(self.model.inputs)))
        for column, name in enumerate(self.model.input_names):
            low, high = self.ranges.get(name, (-1.0, 1.0))
            levels = rng.uniform(low, high, self.n_times)
            holds = np.repeat(levels, rng.integers(2, 8, self.n_times))
            commands[:, column] = holds[: self.n_times]
        return own, commands

    def outputs(self, model: Model, own: np.ndarray, commands: np.ndarray) -> np.ndarray:
        """Outputs of a trajectory, ``(n_times, n_outputs)``."""
        return self._run(model, own, commands, sensitivities=False).outputs

    def _run(
        self, model: Model, own: np.ndarray, commands: np.ndarray, *, sensitivities: bool = True
    ) -> Any:
        times = model.step * np.arange(self.n_times)
        run = Kernel(model, compiled=False).simulate(
            times, commands, model.value_vector, own, sensitivities=sensitivities
        )
        if not run.ok:
            raise AssertionError(
                f"Effect {self.effect.name!r}: the trajectory is not finite after "
                f"{times[run.failed_at]:g} s. Give smaller initial states, inputs or scales."
            )
        return run

    def random_values(self, rng: np.random.Generator) -> dict[str, float]:
        """Values of the effect's estimated parameters about their typical sizes."""
        values = {}
        for parameter in self.effect.parameters:
            if parameter.name in self.effect.amplitude_names:
                sign = 1.0 if parameter.lower >= 0 else rng.choice([-1.0, 1.0])
                values[parameter.name] = sign * rng.uniform(0.3, 1.0) * parameter.magnitude
            elif not parameter.fixed:
                values[parameter.name] = parameter.value + 0.3 * rng.uniform() * parameter.magnitude
        return values

    def absent_at_zero(self, rng: np.random.Generator) -> list[str]:
        """Zero amplitude changes nothing; a typical one changes something."""
        own, commands = self.scenario(rng)
        without = self.outputs(self.model, own, commands)
        zero = self.outputs(self.with_effect(self.zero), own, commands)
        typical = self.outputs(self.with_effect(self.random_values(rng)), own, commands)
        size = np.abs(without).max(axis=0) + 1.0
        broken = []
        if self.effect.amplitude_names and np.any(np.abs(zero - without) > 1e-12 * size):
            worst = np.abs(zero - without).max()
            broken.append(f"is not absent at zero amplitude: outputs differ by {worst:.1e}")
        if np.abs(typical - without).max() < 1e-9:
            broken.append("changes no output at its typical amplitude")
        return broken

    def jacobian(self, rng: np.random.Generator) -> list[str]:
        """Sensitivities against central differences at a random point."""
        own, commands = self.scenario(rng)
        values = self.random_values(rng)
        model = self.with_effect(values)
        exact = self._run(model, own, commands).output_sensitivities
        names = [*model.state_names, *model.free_names]
        sizes = [state.scale for state in model.states]
        sizes += [parameter.magnitude for parameter in model.free_parameters]
        point, n_own = np.array([*own, *(model.values[n] for n in model.free_names)]), len(own)
        broken = []
        for column, (name, size) in enumerate(zip(names, sizes, strict=True)):
            sides = []
            for sign in (1.0, -1.0):
                moved = point.copy()
                moved[column] += sign * DIFFERENCE_STEP * size
                changed = model.with_values(dict(zip(names[n_own:], moved[n_own:], strict=True)))
                sides.append(self.outputs(changed, moved[:n_own], commands))
            difference = (sides[0] - sides[1]) / (2 * DIFFERENCE_STEP * size)
            pair = exact[:, :, column] * size, difference * size
            broken += _compare(*pair, sides[0], name, DIFFERENCE_STEP)
        return broken

    def slope_at_zero(self, rng: np.random.Generator) -> list[str]:
        """Sensitivities at zero amplitude against growing amplitude."""
        own, commands = self.scenario(rng)
        model = self.with_effect(self.zero)
        run = self._run(model, own, commands)
        base, exact = run.outputs, run.output_sensitivities
        broken = []
        for name in self.effect.amplitude_names:
            column = len(own) + model.free_names.index(name)
            size = model.parameter(name).magnitude
            grown = self.outputs(model.with_values({name: DIFFERENCE_STEP * size}), own, commands)
            difference = (grown - base) / DIFFERENCE_STEP
            pair = exact[:, :, column] * size, difference
            broken += _compare(*pair, base, f"{name} at zero", 2e-3)
        return broken

    def mirrored(
        self, rng: np.random.Generator, mirror: frozenset[str], amplitude_sign: int
    ) -> list[str]:
        """Outputs of the mirrored motion against mirrored outputs."""
        own, commands = self.scenario(rng)
        values = self.random_values(rng)
        amplitudes = self.effect.amplitude_names
        other = {k: v * (amplitude_sign if k in amplitudes else 1) for k, v in values.items()}
        flips = [
            np.array([-1.0 if name in mirror else 1.0 for name in names])
            for names in (self.model.state_names, self.model.input_names, self.model.output_names)
        ]
        straight = self.outputs(self.with_effect(values), own, commands)
        reflected = self.outputs(self.with_effect(other), own * flips[0], commands * flips[1])
        gap = np.abs(reflected - straight * flips[2]).max()
        return [f"is not symmetric: mirrored outputs differ by {gap:.1e}"] if gap > 1e-9 else []


def _compare(
    exact: np.ndarray, difference: np.ndarray, outputs: np.ndarray, name: str, tolerance: float
) -> list[str]:
    """Compare, per typical size, up to a relative tolerance and the rounding of outputs."""
    gap, rounding = np.abs(exact - difference).max(), 1e-14 * np.abs(outputs).max()
    if gap <= tolerance * np.abs(difference).max() + rounding / DIFFERENCE_STEP:
        return []
    return [
        f"sensitivity to {name} is {np.abs(exact).max():.3g} at most, finite differences give "
        f"{np.abs(difference).max():.3g} and differ by {gap:.1e} (per typical size)"
    ]


# -- the contract of a problem folder --------------------------------------------------


# What a README speaks of, and words that show it does.
TOPICS = {
    "where it comes from": r"source|paper|doi|published|reference|simulated from",
    "its axes or units": r"\baxes\b|\bunits?\b|\bSI\b|positive|\brad\b",
}
# What success means stands under a heading or a bold word of its own.
SUCCESS = r"^(#+ .*|\*\*[^*]*)success"


def check_problem(
    name_or_folder: str | Path,
    *,
    rng: np.random.Generator,
    effects: bool = True,
    records: bool = True,
) -> None:
    """Check everything that the commands rely on in a problem folder.

    * It loads, so that dimensions follow from its terms, and its README says where it comes
      from, in which axes or units, and what success means. In which unit bare numbers
      were read is printed.
    * Every candidate effect keeps the contract of :func:`check_effect`, among it that it
      is absent at zero; the problem's references may stand for its own.
    * Every experiment can be simulated, within finite numbers.
    * Its records can be read, and have the model's channels.
    * Every free parameter influences the experiments or records in a way of its own, or
      the README names it.

    Parameters
    ----------
    name_or_folder : str or Path
        As for :func:`oed_sysid.load_problem`.
    rng : numpy.random.Generator
        Source of the random points.
    effects : bool
        Whether to check the candidates, which takes about a second each.
    records : bool
        Whether to read the records; they may be third-party data that is not there.

    Raises
    ------
    AssertionError
        With a line for every broken promise.

    Examples
    --------
    In a test of a folder of one's own::

        check_problem("my_vehicle", rng=np.random.default_rng(0))
    """
    try:
        problem = load_problem(name_or_folder)
    except OedSysidError as error:
        raise AssertionError(f"Problem {name_or_folder}:\n- does not load: {error}") from None
    for note in problem.notes():
        print(f"Problem {problem.name!r}: {note}")
    text, broken = _readme(name_or_folder)
    data = None
    if records and problem.records is not None:
        data, more = _records(problem)
        broken += more
    broken += _simulations(problem)
    broken += _identifiable(problem, data, text)
    if effects:
        for effect in problem.effects:
            broken += _effect(problem, effect, rng)
    refuse(f"Problem {problem.name!r}", broken)


def _readme(name_or_folder: str | Path) -> tuple[str, list[str]]:
    shipped = catalogue_folder()
    folder = Path(name_or_folder).expanduser()
    if shipped is not None and (shipped / str(name_or_folder)).is_dir():
        folder = shipped / str(name_or_folder)
    file = (folder if folder.is_dir() else folder.parent) / "README.md"
    if not file.is_file():
        return "", [f"has no README.md in {file.parent}"]
    text = file.read_text(encoding="utf-8")
    broken = [
        f"README.md does not say {topic}"
        for topic, words in TOPICS.items()
        if not re.search(words, text, re.IGNORECASE)
    ]
    if not re.search(SUCCESS, text, re.IGNORECASE | re.MULTILINE):
        broken.append("README.md has no heading or bold word that says what success means")
    return text, broken


def _records(problem: Problem) -> tuple[Dataset | None, list[str]]:
    try:
        data = problem.data()
    except OedSysidError as error:
        return None, [f"its records cannot be read: {error}"]
    found, measured = data.channels.output_names, problem.channels.output_names
    words = f"its records hold {found}, its model measures {measured}"
    claims = [(len(data), "its records are none"), (found == measured or not len(data), words)]
    claims += [
        (np.isfinite(one.outputs).any(), f"record {one.name!r} holds no measurement")
        for one in data
    ]
    return data, unkept(claims)


def _simulations(problem: Problem) -> list[str]:
    broken = []
    for name, experiment in problem.experiments.items():
        try:
            record = simulate(problem.model, experiment, noise=False)
        except OedSysidError as error:
            broken.append(f"experiment {name!r} cannot be simulated: {error}")
            continue
        if not (np.isfinite(record.outputs).all() and np.isfinite(record.inputs).all()):
            broken.append(f"experiment {name!r} diverges")
    return broken


def _identifiable(problem: Problem, data: Dataset | None, readme: str) -> list[str]:
    """Combinations of free parameters that nothing shows and the README does not name."""
    runs: list[Experiment] | Dataset = list(problem.experiments.values())
    runs = runs or data or []
    if not runs or not problem.model.free_parameters:
        return []
    # An unmeasured output has no size of error; any will do to see what influences what.
    noise = {o.name: o.noise_std or 1e-2 for o in problem.model.outputs}
    try:
        information = information_of(problem.model, runs, noise=noise, priors=None)
    except OedSysidError as error:
        return [f"what its parameters do cannot be told: {error}"]
    said = set(re.findall(r"\w+", readme))
    return [
        f"not identifiable, and README.md does not say so: {words}"
        for words in information.null_directions()
        if not said & set(information.names) & set(re.findall(r"\w+", words))
    ]


def _effect(problem: Problem, effect: Effect, rng: np.random.Generator) -> list[str]:
    inputs = {
        name: bounds
        for name, bounds in problem.limits.inputs.items()
        if name in problem.model.input_names and np.isfinite(bounds).all()
    }
    first = next(iter(problem.experiments.values()), None)
    start = {} if first is None else first.initial
    initial = {name: start[name] for name in problem.model.state_names if name in start}
    try:
        check_effect(
            effect, problem.model, rng=rng, initial=initial, inputs=inputs, n_times=20, n_points=1
        )
    except AssertionError as error:
        # The problem's own references may be those of its candidates; and without an experiment
        # nobody says where a run begins that would wake an effect up.
        excused = ("has no source",) * bool(problem.references)
        excused += ("changes no output",) * (not problem.experiments)
        return [
            f"candidate {effect.name!r} {line}"
            for line in str(error).split("\n- ")[1:]
            if not line.startswith(excused)
        ]
    return []
