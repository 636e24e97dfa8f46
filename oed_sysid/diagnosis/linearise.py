"""One linearisation from which everything is asked: residuals, sensitivities, deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid import expressions
from oed_sysid.dataset import Dataset
from oed_sysid.diagnosis.innovations import Deviations
from oed_sysid.effects import Effect, Force
from oed_sysid.kernels import SelectableKernel, kernel, selectable_kernel
from oed_sysid.model import Model
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


def deviations(model: Model, dataset: Dataset, initial: Sequence[np.ndarray]) -> list[Deviations]:
    """Linearise a model along its own trajectories.

    Parameters
    ----------
    model : Model
        At the values to linearise at.
    dataset : Dataset
        Gives times and inputs.
    initial : sequence of ndarray (n_own,)
        Initial states, per record.
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
    result = []
    for record, own in zip(dataset, initial, strict=True):
        z0, _ = compiled.start(own, record.inputs[0], values, record.times[0])
        run = compiled.run(
            record.times,
            record.inputs,
            values,
            z0,
            starts=np.arange(len(record.times), dtype=np.intc),
            carry=True,
            sensitivities=True,
        )
        assert run.end_sensitivities is not None
        assert run.output_sensitivities is not None
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
    """

    base: Model
    candidates: tuple[Effect, ...]
    model: Model
    kernel: SelectableKernel

    @classmethod
    def build(cls, base: Model, candidates: Sequence[Effect]) -> SuperModel:
        """Join a base model and candidate effects."""
        joined = base
        known = set(base.effect_names)
        left = tuple(e.absent() for e in candidates if e.name not in known)
        joined = base + left
        return cls(base, left, joined, selectable_kernel(joined))

    def values(self, changes: Mapping[str, float]) -> np.ndarray:
        """Values of all parameters with some replaced, shape ``(n_parameters,)``."""
        vector = self.model.value_vector
        if changes:
            names = self.model.parameter_names
            for name, value in changes.items():
                vector[names.index(name)] = value
        return vector

    def outputs(
        self,
        dataset: Dataset,
        initial: Sequence[np.ndarray],
        changes: Mapping[str, float],
        names: Sequence[str] = (),
        *,
        sensitivities: bool = True,
    ) -> tuple[list[np.ndarray], list[np.ndarray]] | None:
        """Outputs and their derivatives along every record, or None where one diverges.

        Returns
        -------
        outputs : list of ndarray (n_times, n_outputs)
        jacobians : list of ndarray (n_times, n_outputs, n_own + len(names))
        """
        values = self.values(changes)
        outputs, jacobians = [], []
        for record, own in zip(dataset, initial, strict=True):
            y, dy, ok = self.kernel.run(
                record.times, record.inputs, values, own, names, sensitivities=sensitivities
            )
            if not ok:
                return None
            outputs.append(y)
            if dy is not None:
                jacobians.append(dy)
        return outputs, jacobians
