r"""What keeps real records from being what a model simulates.

Where data come from the very equations that are fitted, with the very noise that is declared,
every method looks better than at sea. A :class:`World` changes one thing at a time: disturbance
forces on all equations of motion,

.. math:: w_{k+1} = \varphi w_k + \sigma_w \sqrt{1 - \varphi^2}\, \varepsilon_k, \qquad
    \sigma_w = \text{share} \cdot \max |F|,

with :math:`\max|F|` the largest sum of forces of the undisturbed run (largest acceleration, where
an equation is written as one) and a time of four samples; swell, which is narrow-band instead;
sensor noise with a memory; noise of another size than declared; sensors that are off; numbers that
are taken as known and are not; physics that the model does not have; spikes; start values off by
far.
Commands are those of the undisturbed run, and white noise is drawn alike in all worlds.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from oed_sysid.data.record import Record
from oed_sysid.errors import ProblemError, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.manoeuvres import Piecewise
from oed_sysid.experiments.simulation import simulate, simulate_inputs
from oed_sysid.likelihood.disturbances import Place, with_disturbance_inputs
from oed_sysid.likelihood.noise_levels import given_levels
from oed_sysid.likelihood.noise_model import NoiseModel, Sea
from oed_sysid.physics.base import Force
from oed_sysid.physics.channels import Output
from oed_sysid.physics.model import Model
from oed_sysid.runtime.tables import tables

# Correlation time of forces and of a sensor's noise, in samples.
LASTING = 4.0
# Steps per sample in which disturbance forces are drawn and integrated.
SUBSTEPS = 4


@dataclass(frozen=True)
class World:
    """How records depart from the model that is fitted.

    Parameters
    ----------
    title : str
        For tables.
    forces : float
        Level of disturbance forces, share of the largest force.
    swell : float
        The same of narrow-band forces.
    period, bandwidth : float
        Of the swell: s, at most a tenth of the run; and its width as a share of the frequency.
    hidden : float
        Quadratic damping that the fitted model does not have, at the largest velocity of the
        undisturbed run, share of the largest force; not of a velocity that a run starts with.
    colour : float
        Share of the sensor noise's variance that has a memory of five samples.
    declared : float
        Declared noise over the true one.
    wrong : float
        Largest relative error of the numbers that are taken as known.
    spikes : float
        Share of samples that are off by twenty times the noise.
    offset : float
        Constant error of every sensor, in multiples of its noise, up or down.
    sparse : int
        Every how many samples outputs are kept; inputs are known at all.
    start : float
        Start values are off by up to this factor either way; 1 leaves the benchmark's 30 %.
    """

    title: str
    forces: float = 0.0
    swell: float = 0.0
    period: float = 8.0
    bandwidth: float = 0.2
    hidden: float = 0.0
    colour: float = 0.0
    declared: float = 1.0
    wrong: float = 0.0
    spikes: float = 0.0
    offset: float = 0.0
    sparse: int = 1
    start: float = 1.0

    def record(
        self, model: Model, experiment: Experiment, *, rng: np.random.Generator, noise: bool
    ) -> Record:
        """Simulate one run of this world.

        Parameters
        ----------
        model : Model
            At the truth; its outputs declare the true noise.
        experiment : Experiment
        rng : numpy.random.Generator
            Of the white noise of the sensors, which is that of every other world; everything else
            comes from generators that it spawns.
        noise : bool
            Whether sensors are noisy; without it only what is not noise of a sensor acts.
        """
        for_forces, for_colour, for_spikes, for_offset = rng.spawn(4)
        std = given_levels(model.outputs)
        acts = self.forces or self.swell or self.hidden
        if acts or self.colour:
            run = simulate(model, experiment, noise=False)
            if acts:
                run = self._pushed(model, run, experiment, for_forces)
            outputs = run.outputs.copy()
            if noise:
                errors = np.sqrt(1 - self.colour) * rng.standard_normal(outputs.shape)
                if self.colour:
                    memory = _gauss_markov(outputs.shape, LASTING, for_colour)
                    errors += np.sqrt(self.colour) * memory
                outputs += std * errors
        else:  # as in the ideal world, commands that answer noisy measurements included
            run = simulate(model, experiment, rng=rng, noise=noise)
            outputs = run.outputs.copy()
        if self.spikes:
            struck = for_spikes.random(outputs.shape) < self.spikes
            outputs += 20.0 * struck * std * np.sign(for_spikes.standard_normal(outputs.shape))
        if self.offset:
            outputs += self.offset * std * np.sign(for_offset.standard_normal(len(std)))
        outputs[np.arange(len(outputs)) % self.sparse > 0] = np.nan
        return run.with_outputs(outputs)

    def _pushed(
        self, model: Model, clean: Record, experiment: Experiment, rng: np.random.Generator
    ) -> Record:
        """The same commands with what acts on every equation of motion."""
        largest = _largest_forces(model, clean, experiment)
        places = tuple(largest)
        damped = model + self._damping(model, clean, experiment, largest) if self.hidden else model
        pushed = with_disturbance_inputs(damped, [Place("force", place) for place in places])
        pushes = pushed.inputs[len(model.inputs) :]
        linear = (replace(push, interpolation="linear") for push in pushes)
        pushed = replace(pushed, inputs=(*model.inputs, *linear))
        n = len(clean.times)
        fine = np.interp(np.arange((n - 1) * SUBSTEPS + 1) / SUBSTEPS, np.arange(n), clean.times)
        columns = [
            Piecewise(one.name, clean.times, values, interpolation=one.interpolation).commands(fine)
            for one, values in zip(model.inputs, clean.inputs.T, strict=True)
        ]
        # Forces run linearly through the fine points, so that substeps see no jumps.
        shape = len(fine), len(places)
        push = self.forces * _gauss_markov(shape, LASTING * SUBSTEPS, rng)
        if self.swell:
            period = self._period(clean) / experiment.sample_time * SUBSTEPS
            push += self.swell * _narrow_band(shape, period, self.bandwidth, rng)
        inputs = np.column_stack([*columns, push * np.array(list(largest.values()))])
        path = simulate_inputs(pushed, fine, inputs=inputs, initial=experiment.initial)
        return clean.with_outputs(path.outputs[::SUBSTEPS])

    def _period(self, clean: Record) -> float:
        return min(self.period, 0.1 * float(np.ptp(clean.times)))

    def _damping(
        self, model: Model, clean: Record, experiment: Experiment, largest: Mapping[str, float]
    ) -> Force:
        """Quadratic damping of the velocities that a run does not start with."""
        speeds = _largest(model, clean, experiment, model.state_names)
        fastest = dict(zip(model.state_names, speeds, strict=True))
        terms = {}
        for place, force in largest.items():
            speed = model.axes.get(place, place)
            if abs(experiment.initial.get(speed, 0.0)) < 0.5 * fastest[speed]:
                size = self.hidden * force / fastest[speed] ** 2
                terms[place] = f"-{size!r}*{speed}*abs({speed})"
        return Force("hidden_damping", terms)

    def noise(self, model: Model, experiment: Experiment) -> NoiseModel:
        """Everything random of one run but spikes, as an estimator that knew it would be told.

        Parameters
        ----------
        model : Model
            At the truth; its outputs declare the true noise.
        experiment : Experiment
        """
        std = given_levels(model.outputs)
        largest: dict[str, float] = {}
        seas: tuple[Sea, ...] = ()
        if self.forces or self.swell:
            clean = simulate(model, experiment, noise=False)
            largest = _largest_forces(model, clean, experiment)
        if self.swell:
            levels = {place: self.swell * force for place, force in largest.items()}
            seas = (Sea(self._period(clean), self.bandwidth, levels, "displacement"),)
        forces = {place: self.forces * force for place, force in largest.items() if self.forces}
        return NoiseModel(
            np.sqrt(max(1.0 - self.colour, 0.01)) * std,  # a filter needs some white noise
            np.sqrt(self.colour) * std,
            np.array(list(forces.values())),
            LASTING * experiment.sample_time,
            LASTING * experiment.sample_time,
            model.output_names,
            tuple(f"force {place}" for place in forces),
            seas,
        )

    def believed(self, model: Model, rng: np.random.Generator) -> Model:
        """The model as an estimator is handed it: levels as declared, known numbers nominal."""
        model = model.with_noise(self.declared * given_levels(model.outputs))
        if not self.wrong:
            return model
        known = [p for p in model.all_parameters if p.fixed and p.value]
        off = {p.name: p.value * (1 + self.wrong * rng.uniform(-1.0, 1.0)) for p in known}
        return model.within_bounds(off)


def _largest_forces(model: Model, clean: Record, experiment: Experiment) -> dict[str, float]:
    """Largest force on each equation of the undisturbed run, by axis or state."""
    # Axes of a model, or its states that are velocities and have a rate.
    speeds = (state.name for state in model.states if state.unit in ("rad/s", "m/s"))
    places = tuple(model.axes) or tuple(name for name in speeds if name in model.kinematics)
    if not places:
        raise ProblemError(f"Model {model.name!r} has no equation of motion to push.")
    sums = (f'force("{key}")' if key in model.axes else f"dot({key})" for key in places)
    return dict(zip(places, _largest(model, clean, experiment, tuple(sums)), strict=True))


def _largest(
    model: Model, clean: Record, experiment: Experiment, texts: Sequence[str]
) -> list[float]:
    """Largest magnitudes of expressions along the undisturbed run."""
    # The same vehicle whose only outputs are these.
    probe = replace(
        model,
        outputs=tuple(Output(f"seen_{i}", "1", expression=text) for i, text in enumerate(texts)),
        effects=tuple(effect for effect in model.effects if effect.stage != "sensor"),
    )
    run = simulate_inputs(probe, clean.times, inputs=clean.inputs, initial=experiment.initial)
    return [float(x) for x in np.abs(run.outputs).max(axis=0)]


def _gauss_markov(shape: tuple[int, ...], time: float, rng: np.random.Generator) -> np.ndarray:
    """First-order noise of unit variance, ``(n_times, n_signals)``; ``time`` in samples."""
    keep = np.exp(-1.0 / time)
    white = rng.standard_normal(shape)
    white[1:] *= np.sqrt(1 - keep**2)
    return lfilter([1.0], [1.0, -keep], white, axis=0)


def _narrow_band(
    shape: tuple[int, ...], period: float, bandwidth: float, rng: np.random.Generator
) -> np.ndarray:
    r"""Second-order noise of unit variance, ``(n_times, n_signals)``; ``period`` in samples.

    .. math:: w_k = 2 r \cos\omega\, w_{k-1} - r^2 w_{k-2} + \varepsilon_k, \qquad
        r = e^{-\omega b / 2}
    """
    omega = 2 * np.pi / period
    r = np.exp(-0.5 * bandwidth * omega)
    before = int(np.ceil(5.0 / (1.0 - r)))  # until e^-5 is left of a start at rest
    white = rng.standard_normal((shape[0] + before, *shape[1:]))
    wave = lfilter([1.0], [1.0, -2 * r * np.cos(omega), r**2], white, axis=0)[before:]
    variance = (1 + r**2) / ((1 - r**2) * (1 + r**4 - 2 * r**2 * np.cos(2 * omega)))
    return wave / np.sqrt(variance)


IDEAL = "ideal"
_TABLE = tables(__file__, "worlds")
WORLDS: Mapping[str, World] = {name: World(**row) for name, row in _TABLE.items()}


def world_by_name(name: str) -> World:
    """Return one world.

    Examples
    --------
    >>> world_by_name("forces_5").forces
    0.05
    """
    located(ProblemError, "The benchmark has no world", [name], WORLDS)
    return WORLDS[name]
