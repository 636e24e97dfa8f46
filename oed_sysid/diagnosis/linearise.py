"""One linearisation from which everything is asked: residuals, sensitivities, deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import SelectableKernel, SelectedRun, kernel, selectable_kernel
from oed_sysid.data.dataset import Dataset
from oed_sysid.effects import Effect, Force
from oed_sysid.errors import ModelError, SimulationError
from oed_sysid.language import expressions
from oed_sysid.model import Model
from oed_sysid.noise.kalman import Deviations
from oed_sysid.parameters import Parameter

DISTURBANCE = "disturbance_"


def disturbed_equations(model: Model) -> tuple[str, ...]:
    """Equations in which a force may be missing: axes, or states whose rate is no identity."""
    if model.axes:
        return tuple(model.axes)
    parameters = set(model.parameter_names)
    return tuple(
        state for state, rate in model.kinematics.items() if expressions.names(rate) & parameters
    )


def deviations(model: Model, dataset: Dataset, states: Sequence[np.ndarray]) -> list[Deviations]:
    """Linearise a model along given trajectories.

    Parameters
    ----------
    model : Model
        At the values to linearise at.
    dataset : Dataset
        Gives times and inputs.
    states : sequence of ndarray (n_times, n_own)
        The model's own states, per record. Where effects of the model add
        states or memory, only the first row is used and the model's own
        trajectory is followed.
    """
    equations = disturbed_equations(model)
    held = model.fix(*model.free_names)
    held += [
        Force(
            f"{DISTURBANCE}{name}",
            {name: f"{DISTURBANCE}{name}"},
            (Parameter(f"{DISTURBANCE}{name}", 0.0),),
        )
        for name in equations
    ]
    compiled = kernel(held)
    values = held.value_vector
    n = compiled.n_full
    follow = n > compiled.n_own
    result = []
    for record, own in zip(dataset, states, strict=True):
        nodes = own
        if follow:
            nodes, _ = compiled.start(own[0], record.inputs[0], values, record.times[0])
        run = compiled.run(
            record.times,
            record.inputs,
            values,
            nodes,
            starts=np.arange(len(record.times), dtype=np.intc),
            carry=follow,
            sensitivities=True,
        )
        if run.end_sensitivities is None or run.output_sensitivities is None or not run.ok:
            raise SimulationError(
                f"Model {model.name!r} diverges along record {record.name!r} at sample "
                f"{run.failed_at}. Start from other values, or bound the parameters."
            )
        result.append(
            Deviations(
                transition=np.ascontiguousarray(run.end_sensitivities[:, :, :n]),
                force_gain=np.ascontiguousarray(run.end_sensitivities[:, :, n:]),
                output=np.ascontiguousarray(run.output_sensitivities[:, :, :n]),
                present=np.isfinite(record.outputs).astype(float),
                sample_time=record.sample_time,
            )
        )
    return result


@dataclass(frozen=True, eq=False)
class SuperModel:
    """A model together with every candidate effect, compiled once.

    Attributes
    ----------
    base : Model
        What is believed at present.
    candidates : tuple of Effect
        Candidates not in the base, absent.
    model : Model
        Both together.
    kernel : SelectableKernel
        Its compiled form.
    skipped : tuple of str
        Candidates that do not fit the base.
    """

    base: Model
    candidates: tuple[Effect, ...]
    model: Model
    kernel: SelectableKernel
    skipped: tuple[str, ...] = ()

    @classmethod
    def build(cls, base: Model, candidates: Sequence[Effect]) -> SuperModel:
        """Join a base model and every candidate effect that fits it.

        A candidate that acts on signals the model does not have, or that the
        base already holds, is left out and listed in ``skipped``.
        """
        absent = [effect.absent() for effect in candidates]
        skipped: list[str] = []
        try:
            joined, left = base + absent, absent
        except ModelError:  # find out which ones do not fit
            joined, left = base, []
            for effect in absent:
                try:
                    joined = joined + effect
                except ModelError:
                    skipped.append(effect.name)
                else:
                    left.append(effect)
        return cls(base, tuple(left), joined, selectable_kernel(joined), tuple(skipped))

    def values(self, changes: Mapping[str, float]) -> np.ndarray:
        """Values of all parameters with some replaced, shape ``(n_parameters,)``."""
        vector = self.model.value_vector
        if changes:
            names = self.model.parameter_names
            for name, value in changes.items():
                vector[names.index(name)] = value
        return vector

    def run(
        self,
        dataset: Dataset,
        initial: Sequence[np.ndarray],
        changes: Mapping[str, float],
        names: Sequence[str] = (),
        *,
        sensitivities: bool = True,
    ) -> list[SelectedRun] | None:
        """Run along every record; None where one diverges.

        Parameters
        ----------
        dataset : Dataset
        initial : sequence of ndarray (n_own,)
            Initial states, per record.
        changes : mapping
            Values of parameters that differ from the super-model's.
        names : sequence of str
            Parameters that get a sensitivity.
        sensitivities : bool
            Whether to return derivatives at all.
        """
        values = self.values(changes)
        runs = []
        for record, own in zip(dataset, initial, strict=True):
            run = self.kernel.run(
                record.times, record.inputs, values, own, names, sensitivities=sensitivities
            )
            if not run.ok:
                return None
            runs.append(run)
        return runs
