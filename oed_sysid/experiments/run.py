"""Records of experiments: open loop in one go, manoeuvres with feedback sample by sample."""

from __future__ import annotations

import numpy as np

from oed_sysid.data.dataset import Record
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.experiments.closed_loop import closed_loop
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.trajectory import simulate_inputs
from oed_sysid.physics.model import Model


def simulate(
    model: Model,
    experiment: Experiment,
    *,
    rng: np.random.Generator | None = None,
    noise: bool = True,
    name: str | None = None,
) -> Record:
    """Run an experiment on a model and return what would be logged.

    Parameters
    ----------
    model : Model
        The model, at its parameter values.
    experiment : Experiment
        What is commanded, and from which state.
    rng : numpy.random.Generator
        Source of the measurement noise; needed if there is any.
    noise : bool
        Add white normal noise of each output's ``noise_std``.
    name : str, optional
        Name of the record; by default that of the experiment.

    Returns
    -------
    Record
        Inputs as commanded and outputs as measured.

    Raises
    ------
    DesignError
        If the experiment does not fit the model, or its commands break a limit.
    SimulationError
        If the trajectory diverges, or noise is wanted but not known.

    Notes
    -----
    A manoeuvre with feedback decides at each sample on the measurement of that
    sample, which is taken while the previous command still acts. An input that
    is interpolated linearly then moves from the previous command to the new
    one; the measurement on which a decision is taken still has it constant.

    Examples
    --------
    >>> from math import radians
    >>> from oed_sysid.physics.channels import Input, Output, State
    >>> from oed_sysid.experiments.manoeuvres import ZigZag
    >>> nomoto = Model(
    ...     "Nomoto", (State("psi", "rad"), State("r", "rad/s")), (Input("rudder", "rad"),),
    ...     (Output("psi", "rad", noise_std=0.002),), {"psi": "r", "r": "(0.1*rudder - r)/10"},
    ... )
    >>> test = Experiment("zigzag", ZigZag("rudder", 0.2, 0.2), duration=90.0, sample_time=0.5)
    >>> record = simulate(nomoto, test, rng=np.random.default_rng(1))
    >>> record.n_samples, int((np.diff(record.input("rudder")) != 0).sum())
    (181, 2)
    """
    if not isinstance(model, Model) or not isinstance(experiment, Experiment):
        found = " and ".join(type(one).__name__ for one in (model, experiment))
        raise SimulationError(f"Expected a model and an experiment, in this order; got {found}.")
    experiment.check_model(model)
    times = experiment.times
    noise_values = _draw_noise(model, experiment, len(times), rng) if noise else None
    if experiment.reacts:
        inputs = closed_loop(model, experiment, noise_values)
        _check_commands(model, experiment, inputs)
    else:
        inputs = experiment.commands(model.input_names)
    trajectory = simulate_inputs(model, times, inputs=inputs, initial=experiment.initial)
    outputs = trajectory.outputs if noise_values is None else trajectory.outputs + noise_values
    return Record(
        name or experiment.name,
        times,
        inputs,
        outputs,
        model.channels,
        source=f"simulation of {model.name}: {experiment.describe()}",
    )


def _draw_noise(
    model: Model, experiment: Experiment, n_times: int, rng: np.random.Generator | None
) -> np.ndarray:
    """Noise of all outputs, shape ``(n_times, n_outputs)``."""
    stds = {output.name: output.noise_std for output in model.outputs} | dict(experiment.noise)
    unknown = [name for name, std in stds.items() if std is None]
    if unknown:
        raise SimulationError(
            f"The noise of {', '.join(unknown)} is not known. Give Output(noise_std=...), "
            f"Experiment(noise={{{unknown[0]!r}: ...}}), or simulate without noise (noise=False, "
            "on the command line --no-noise)."
        )
    scales = np.array([stds[name] for name in model.output_names], dtype=float)
    if not scales.any():
        return np.zeros((n_times, len(scales)))
    if rng is None:
        raise SimulationError(
            "Noise needs a generator: pass rng=np.random.default_rng(seed), or noise=False."
        )
    return rng.standard_normal((n_times, len(scales))) * scales


def _check_commands(model: Model, experiment: Experiment, inputs: np.ndarray) -> None:
    """Raise if commands that only the run could tell break a limit."""
    signals = dict(zip(model.input_names, inputs.T, strict=True))
    broken = experiment.limits.violations(experiment.times, signals)
    if broken:
        raise DesignError(
            f"Experiment {experiment.name!r} breaks its limits: {'; '.join(broken)}. Make the "
            "manoeuvre smaller or slower (Saturated, RateLimited), or widen the limit."
        )
