r"""What a manoeuvre makes a model do, and how that depends on every unknown.

Information of a run under disturbance forces and coloured sensors, before any data exist.

The likelihood of a disturbed record is that of the innovations of a filter
(:mod:`oed_sysid.compiled.filtering`). Along the *nominal* trajectory, the one without noise, every
innovation is zero, and what is left of the filter are its gains and the columns ``X``, derivatives
of its state by start states and parameters:

.. math::
    S = h' P h + r, \quad g = P h, \quad
    \partial e = -(h' X + D), \quad X \leftarrow X + \frac{g}{S}\,\partial e, \quad
    H = \sum_k \frac{\partial e\,\partial e'}{S}

.. math:: F = H_{pp} - H_{p0} H_{00}^{-1} H_{0p}

``p`` are the parameters that all runs share, ``0`` start states and parameters of the run. Start
states have a covariance of zero and a column each. Levels and times of the noise are not
correlated with parameters along the nominal trajectory, where the mean of a disturbance is zero
whatever its level; derivatives of the gain are left out. The rows of ``H`` are kept and
triangularised, so that null directions stay null.

Information must not be averaged over noisy filtered paths: their regressors hold noise, which
counts as information that is not there.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from oed_sysid.compiled.filtering import Along, filter_kernel
from oed_sysid.compiled.kernels import kernel
from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DesignError, located
from oed_sysid.experiments.experiment import Experiment
from oed_sysid.experiments.simulation import simulate_inputs, trajectory_of
from oed_sysid.experiments.trajectory import start_array
from oed_sysid.likelihood.disturbances import chosen_places
from oed_sysid.likelihood.filtered import disturbed_model
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.likelihood.start_guess import check_channels, first_state
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import THREE_DIGITS
from oed_sysid.runtime.tables import tables

# Sentences of the information in runs.
SAYS: dict[str, Any] = tables(__file__, "sentences")
Run = Experiment | Record
# Standard deviations of the outputs' noise.
Levels = Mapping[str, float] | Sequence[float] | np.ndarray | None


@dataclass(frozen=True, eq=False)
class Response:
    """Outputs of one run and their derivatives.

    Attributes
    ----------
    outputs : ndarray (n_times, n_outputs)
        Noise-free outputs.
    states : ndarray (n_times, n_full)
        Full states.
    jacobian : ndarray (n_times, n_outputs, n_own + n_free)
        Derivatives of the outputs by own start states, then by free parameters.

    Examples
    --------
    What :func:`respond` returns; see there.
    """

    outputs: np.ndarray
    states: np.ndarray
    jacobian: np.ndarray


@dataclass(frozen=True, eq=False)
class CommandedRun:
    """Inputs and start of a run, with feedback already resolved.

    Attributes
    ----------
    name : str
    times : ndarray (n_times,)
    inputs : ndarray (n_times, n_inputs)
    initial : ndarray (n_own,)
    present : ndarray of bool (n_times, n_outputs)
        Which samples are (or will be) measured.
    noise : mapping of str to float
        Noise levels that differ from the model's in this run.

    Examples
    --------
    One of those that :func:`commanded_runs` returns; see there.
    """

    name: str
    times: np.ndarray
    inputs: np.ndarray
    initial: np.ndarray
    present: np.ndarray
    noise: Mapping[str, float] = field(default_factory=dict)


def commanded_runs(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
) -> tuple[CommandedRun, ...]:
    """Return what is commanded in each run, and from which start.

    The commands of an experiment with feedback are those of a run of this
    model without noise; afterwards they are a given history, as they are for
    an estimator that gets the logged commands.

    Parameters
    ----------
    model : Model
        The model.
    runs : Experiment, Record, Dataset or iterable of these
        What is to be run, or was run.
    initial_states : sequence of mapping or ndarray (n_own,), optional
        Start states per run; by default those of the experiment, or the
        smoothed first measurements of a record.

    Returns
    -------
    tuple of CommandedRun
        One for each run.

    Raises
    ------
    DesignError
        If there is no run, or another number of start states.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> [given] = commanded_runs(ship.model, next(iter(ship.experiments.values())))
    >>> given.inputs.shape
    (4001, 1)
    """
    listed = (runs,) if isinstance(runs, Experiment | Record) else tuple(runs)
    if not listed:
        raise DesignError("There is no experiment or record. Give at least one.")
    if initial_states is not None and len(initial_states) != len(listed):
        raise DesignError(
            f"There are {len(initial_states)} start states for {len(listed)} runs. Give one each."
        )
    found = []
    for index, run in enumerate(listed):
        given = _of_experiment(model, run) if isinstance(run, Experiment) else _recorded(model, run)
        if initial_states is not None:
            start = initial_states[index]
            if isinstance(start, Mapping):
                start = {**dict(zip(model.state_names, given.initial, strict=True)), **start}
            given = replace(given, initial=start_array(model, start))
        found.append(given)
    return tuple(found)


def respond(model: Model, given: CommandedRun) -> Response:
    """Simulate one run with derivatives.

    Returns
    -------
    Response
        Outputs, states and derivatives.

    Raises
    ------
    SimulationError
        If the trajectory diverges, with the state that grew.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> [given] = commanded_runs(ship.model, next(iter(ship.experiments.values())))
    >>> respond(ship.model, given).jacobian.shape
    (4001, 1, 4)
    """
    values = model.value_vector
    run = kernel(model).simulate(
        given.times, given.inputs, values, given.initial, sensitivities=True
    )
    if not run.ok:
        # The simulator says in words which state grew and what to do.
        simulate_inputs(model, given.times, inputs=given.inputs, initial=given.initial)
        raise DesignError(f"The sensitivities of run {given.name!r} are not finite. Shorten it.")
    return Response(run.outputs, run.states, run.output_sensitivities)


def _of_experiment(model: Model, experiment: Experiment) -> CommandedRun:
    # Resolved once: for whoever gets the log, commands are given numbers.
    run = trajectory_of(model, experiment)
    own = start_array(model, experiment.initial)
    present = np.ones(run.outputs.shape, dtype=bool)
    return CommandedRun(
        experiment.name, run.times, run.inputs, own, present, dict(experiment.noise)
    )


def _recorded(model: Model, record: Record) -> CommandedRun:
    check_channels(model, Dataset((record,)))
    own = first_state(model, record)
    return CommandedRun(record.name, record.times, record.inputs, own, np.isfinite(record.outputs))


# A change of this share of what counts stands for a derivative: of the noise where it is put
# through a filter, of an effect's size.
TANGENT = THREE_DIGITS


@dataclass(frozen=True, eq=False)
class Innovations:
    """A model under disturbance forces, made ready once for any number of runs.

    Attributes
    ----------
    model : Model
    noise : NoiseModel
        Sensors in the order of the model's outputs.
    wide : Model
        The model with its disturbances.
    disturbances : tuple of str
        Their parameters in the wide model.
    """

    model: Model
    noise: NoiseModel
    wide: Model
    disturbances: tuple[str, ...]

    @classmethod
    def of(cls, model: Model, noise: NoiseModel) -> Innovations:
        """Return what is the same for all runs.

        Raises
        ------
        DesignError
            If the noise does not fit the model.
        """
        noise = acting(model, checked_noise(model, noise))
        names = noise.disturbed().disturbances
        return cls(model, noise, disturbed_model(model, names), names)

    def rows(
        self, given: CommandedRun, changes: Callable[[np.ndarray], np.ndarray] | None = None
    ) -> np.ndarray:
        """Derivatives of the innovations of one run, in units of their standard deviations.

        Parameters
        ----------
        given : CommandedRun
            Inputs and start of the run.
        changes : callable, optional
            What else may move the outputs, ``(n_times, n_outputs, n_changes)`` of those without
            noise ``(n_times, n_outputs)``; each is put through the same filter.

        Returns
        -------
        ndarray (n_rows, n_own + n_free + n_changes)
            By own start states, free parameters and changes; samples that are not measured left
            out.

        Raises
        ------
        DesignError
            If the run diverges.
        """
        model, noise, wide = self.model, self.noise, self.wide
        white = noise.white.copy()
        for name, std in given.noise.items():
            white[model.output_names.index(name)] = std
        random = replace(noise, white=white).disturbed()
        held = noise.longest_step(given.times)
        kernel = filter_kernel(wide)
        # A disturbance is random, and no parameter to be estimated.
        free = tuple(name for name in model.free_names if name not in self.disturbances)
        values = wide.value_vector
        if not (nominal := kernel.simulate(given.times, given.inputs, values, given.initial)).ok:
            raise DesignError(SAYS["diverges"].format(given=given, model=model))
        # Fed with what the model says, innovations vanish and their derivatives are those at the
        # truth.
        measured = np.where(given.present, nominal.outputs, np.nan)
        along = Along(
            given.times, given.inputs, values, given.initial, measured, random, longest_step=held
        )
        swept = kernel.filter(along, names=free, rows=True, gains=changes is not None)
        if not swept.ok:
            raise DesignError(SAYS["filter_diverges"].format(given=given))
        seen = np.isfinite(measured)
        rows = swept.rows[seen]
        if changes is None:
            return rows
        roots, moved = np.sqrt(swept.variances[seen]), []
        for change in np.moveaxis(changes(nominal.outputs), 2, 0):
            # Small, so that the filter stays on the nominal trajectory, where it is linear.
            share = TANGENT / max(float(np.abs(change / white).max()), 1.0)
            moving = replace(along, measured=measured + share * change)
            innovations, _ = kernel.replay(moving, swept.gains)
            # A model that had the change would lower the innovations by it.
            moved.append(-innovations[seen] / share / roots)
        return np.column_stack([rows, *moved])


def expected_noise(
    model: Model, noise: Levels | NoiseModel | Fit
) -> tuple[NoiseModel | None, Levels]:
    """Split the noise to expect: disturbance forces and colour (None where there are none), levels.

    Levels are standard deviations of the sensors' noise, white and coloured together.
    """
    if isinstance(noise, Fit):
        if not isinstance(noise.noise, NoiseModel) or noise.noise.is_white:
            return None, noise.sigma
        noise = noise.noise
    if not isinstance(noise, NoiseModel):
        return None, noise
    noise = checked_noise(model, noise)
    return None if noise.is_white else noise, noise.sensors


def acting(model: Model, noise: NoiseModel) -> NoiseModel:
    """The same noise with the disturbances that act alone, at places that the model has."""
    forces = noise.only(noise.force > 0).on()
    seas = tuple(sea for sea in forces.seas if sea.acts)
    chosen_places(model, [place for sea in seas for place in sea.places])
    places = tuple(place.name for place in chosen_places(model, forces.places))
    return replace(forces, places=places, seas=seas)


def checked_noise(model: Model, noise: NoiseModel) -> NoiseModel:
    """Return the noise model with its sensors in the order of a model's outputs.

    Raises
    ------
    DesignError
        If sensors are missing, have no level, or a place is none of the model.
    """
    names = model.output_names
    if noise.outputs and tuple(noise.outputs) != names:
        lacking = f"The noise has no level for an output of model {model.name!r},"
        order = located(DesignError, lacking, names, noise.outputs, "Add it.")
        noise = replace(
            noise, white=noise.white[order], colour=noise.colour[order],
            colour_time=noise.colour_time[order], outputs=names,
        )  # fmt: skip
    if len(noise.white) != len(names):
        raise DesignError(
            f"The noise has {len(noise.white)} sensors, model {model.name!r} has {len(names)} "
            "outputs. Give one level each."
        )
    if len(noise.places) != len(noise.force):
        raise DesignError(
            f"The noise has {len(noise.force)} disturbance forces at {len(noise.places)} places. "
            "Name the place of each, such as 'force Z'."
        )
    if not np.all(noise.white > 0):
        poor = [n for n, level in zip(names, noise.white, strict=True) if not level > 0]
        raise DesignError(SAYS["no_white_noise"].format(names=", ".join(poor)))
    return noise
