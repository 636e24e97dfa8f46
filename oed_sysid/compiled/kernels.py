"""Compiled trajectories and sensitivities of a model.

The code of a model structure is generated and compiled once, kept on disk
under the digest of everything that shapes it, and loaded in milliseconds.
Values of parameters, inputs and initial states are arguments, so neither more
data nor other values compile anything again. Without a C compiler the same
functions run in CasADi's interpreter, slower, and this is said once.

The cache folder is ``$OED_SYSID_CACHE``, or ``~/.cache/oed_sysid``.

Least squares over independent segments needs of each the products of its sensitivities and
residuals only (:meth:`Kernel.gather`). Compiled code sums them sample by sample, so that
sensitivities are never written to memory; without a compiler NumPy forms the same sums.
"""

from __future__ import annotations

import ctypes
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from oed_sysid.compiled.compile import call, doubles, load
from oed_sysid.compiled.interpreter import interpreted
from oed_sysid.errors import ModelError
from oed_sysid.physics.model import Model

# Sums of squares from here on have products that are no numbers: root of the largest number.
LARGEST = np.sqrt(np.finfo(float).max)


@dataclass(frozen=True, eq=False)
class Run:
    """What a kernel returns for one record.

    Attributes
    ----------
    outputs : ndarray (n_times, n_outputs)
        Model outputs; NaN after a failure.
    states : ndarray (n_times, n_full)
        Full state before each measurement.
    output_sensitivities : ndarray (n_times, n_outputs, n_columns)
        Derivatives by the start state of the segment, then by free parameters; without columns
        where none were asked for.
    ends : ndarray (n_segments, n_full)
        State at the end of each segment, that is at the next one's first sample.
    end_sensitivities : ndarray (n_segments, n_full, n_columns)
        Its derivatives.
    failed_at : int
        First sample whose state is not finite, or -1.
    """

    outputs: np.ndarray
    states: np.ndarray
    output_sensitivities: np.ndarray
    ends: np.ndarray
    end_sensitivities: np.ndarray
    failed_at: int

    @property
    def ok(self) -> bool:
        """Whether the whole trajectory is finite."""
        return self.failed_at < 0


@dataclass(frozen=True, eq=False)
class Blocks:
    """Sums over the samples of each segment.

    Attributes
    ----------
    gram : ndarray (n_segments, n_columns + 1, n_columns + 1)
        Products ``[J r]' [J r]`` of scaled sensitivities, by the segment's start
        state and the free parameters, and scaled residuals (measured minus model).
    ends : ndarray (n_segments, n_full)
        State at the next segment's first sample; of no meaning where segments are not linked.
    end_sensitivities : ndarray (n_segments, n_full, n_columns)
        Its derivatives.
    """

    gram: np.ndarray
    ends: np.ndarray
    end_sensitivities: np.ndarray


class Kernel:
    """Trajectories and exact sensitivities of one model structure.

    Sizes: ``n_full`` (length of the full state), ``n_own`` (the model's own
    states), ``n_free`` (free parameters), ``n_columns = n_full + n_free``.

    Parameters
    ----------
    model : Model
        The model; only its structure matters, values are arguments.
    compiled : bool
        Whether compiled code runs where there is a compiler, or the interpreter in any case.
    """

    def __init__(self, model: Model, *, compiled: bool = True) -> None:
        self.model = model
        self.n_parameters = len(model.all_parameters)
        self.n_inputs = len(model.inputs)
        self.n_outputs = len(model.outputs)
        self.n_own = len(model.states)
        self.n_free = len(model.free_parameters)
        self.n_full = self.n_own + sum(len(e.states) + len(e.memory) for e in model.effects)
        self.n_columns = self.n_full + self.n_free
        self._compiled = compiled

    @cached_property
    def library(self) -> ctypes.CDLL | None:
        """Compiled code, made when something is run; None where the interpreter runs."""
        return load(self.model) if self._compiled else None

    def __reduce__(self) -> tuple[Any, ...]:
        return kernel, (self.model,)

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """Full state implied by the model's own states.

        Parameters
        ----------
        own : ndarray (n_own,)
            The model's own states.
        inputs : ndarray (n_inputs,)
            First inputs.
        values : ndarray (n_parameters,)
            All parameter values.
        time : float
            Time of the first sample, s.

        Returns
        -------
        z : ndarray (n_full,)
        dz : ndarray (n_full, n_own + n_free)
            Derivatives by own states and free parameters.
        """
        own, inputs, values = doubles(own, inputs, values)
        if self.library is None:
            return interpreted(self.model).start(own, inputs, values, time)
        z = np.empty(self.n_full)
        dz = np.empty((self.n_full, self.n_own + self.n_free))
        call(self.library.kernel_start, own, inputs, values, float(time), z, dz)
        return z, dz

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        *,
        starts: np.ndarray | None = None,
        from_nodes: int | None = None,
        sensitivities: bool = False,
        n_columns: int | None = None,
    ) -> Run:
        """Integrate one record, in one or several segments.

        Parameters
        ----------
        times : ndarray (n_times,)
            Sample times, s.
        inputs : ndarray (n_times, n_inputs)
            Commands at the samples.
        values : ndarray (n_parameters,)
            All parameter values.
        nodes : ndarray (n_segments, n_full)
            Full state at the start of each segment; the first row alone where
            nothing else is taken from nodes.
        starts : ndarray of int (n_segments,), optional
            Index of the first sample of each segment; one segment by default.
        from_nodes : int, optional
            How many of the states, the first ones, the segments after the first take from
            their nodes; the others go on from the end of the segment before. All by default;
            with none the trajectory is continuous. Sensitivities begin anew at each segment.
        sensitivities : bool
            Also return derivatives.
        n_columns : int, optional
            Return derivatives in so many columns, which the caller has chosen in the library.
        """
        times, inputs, values, nodes = doubles(times, inputs, values, nodes)
        inputs, nodes = inputs.reshape(len(times), self.n_inputs), nodes.reshape(-1, self.n_full)
        starts = np.ascontiguousarray([0] if starts is None else starts, dtype=np.intc)
        n, n_segments = len(times), len(starts)
        from_nodes = self.n_full if from_nodes is None else from_nodes
        if values.shape != (expected := (self.n_parameters,)):
            raise ModelError(f"Got {values.shape} parameter values, expected {expected}.")
        if len(nodes) != (n_segments if from_nodes else 1):
            raise ModelError(f"Got {len(nodes)} node states for {n_segments} segments.")
        y = np.full((n, self.n_outputs), np.nan)
        z = np.full((n, self.n_full), np.nan)
        ends = np.full((n_segments, self.n_full), np.nan)
        width = n_columns or sensitivities * self.n_columns
        dy = np.empty((n, self.n_outputs, width))
        dends = np.empty((n_segments, self.n_full, width))
        if self.library is None:
            failed = interpreted(self.model).run(
                times, inputs, values, nodes, starts, from_nodes, (z, y, dy, ends, dends)
            )
        else:
            failed = call(
                self.library.kernel_run, n, times, inputs, values, float(self.model.step),
                n_segments, starts, nodes, from_nodes, z, y, dy, ends, dends,
            )  # fmt: skip
        if failed >= 0:
            dy[failed:] = np.nan
        return Run(y, z, dy, ends, dends, failed)

    def gather(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        measured: np.ndarray,
        sigma: np.ndarray,
        *,
        starts: np.ndarray,
        linked: bool,
    ) -> Blocks | None:
        """Integrate the segments of one record and gather their normal equations.

        Parameters
        ----------
        times, inputs, values, starts
            As :meth:`oed_sysid.compiled.kernels.Kernel.run` takes them.
        nodes : ndarray (n_segments, n_full)
            Full state at the start of each segment.
        measured : ndarray (n_times, n_outputs)
            Measurements; NaN weighs nothing.
        sigma : ndarray (n_outputs,)
            Standard deviations of the noise.
        linked : bool
            Whether ends and their derivatives are wanted.

        Returns
        -------
        Blocks or None
            None where a trajectory or a sum is not finite.
        """
        n_segments, size = len(starts), self.n_columns + 1
        if self.library is None:
            run = self.run(times, inputs, values, nodes, starts=starts, sensitivities=True)
            return _summed(run, measured, sigma, starts)
        starts = np.ascontiguousarray(starts, dtype=np.intc)
        gram = np.empty((n_segments, size, size))
        ends = np.empty((n_segments * linked, self.n_full))
        dends = np.empty((n_segments * linked, self.n_full, self.n_columns))
        times, inputs, values, nodes, measured, weight = doubles(
            times, inputs, values, nodes, measured, 1.0 / sigma
        )
        failed = call(
            self.library.kernel_gather, len(times), times, inputs, values, float(self.model.step),
            n_segments, starts, nodes, measured, weight, gram, ends, dends,
        )  # fmt: skip
        return Blocks(gram, ends, dends) if failed < 0 and summable(gram) else None

    def simulate(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        own: np.ndarray,
        *,
        sensitivities: bool = False,
    ) -> Run:
        """Integrate a whole record from the model's own states.

        Parameters
        ----------
        times, inputs, values, sensitivities
            As of :meth:`run`.
        own : ndarray (n_own,)
            The model's own states at the first sample.

        Returns
        -------
        Run
            Derivatives of outputs are by own states and free parameters,
            ``(n_times, n_outputs, n_own + n_free)``; there are none of its end.
        """
        z, dz = self.start(own, inputs[0], values, float(times[0]))
        found = self.run(times, inputs, values, z, sensitivities=sensitivities)
        if not sensitivities:
            return found
        chained = by_unknowns(found.output_sensitivities, dz, self.n_own)
        none = found.end_sensitivities[:, :, :0]
        return replace(found, output_sensitivities=chained, end_sensitivities=none)


def _summed(run: Run, measured: np.ndarray, sigma: np.ndarray, starts: np.ndarray) -> Blocks | None:
    """The same sums by NumPy, from a run with its sensitivities."""
    if not run.ok:
        return None
    present = np.isfinite(measured)
    with np.errstate(over="ignore", invalid="ignore"):
        scaled = np.where(present, measured - run.outputs, 0.0) / sigma
        rows = run.output_sensitivities * (present / sigma)[:, :, None]
        both = np.concatenate([rows, scaled[:, :, None]], axis=2)
        # A segment's gram is [J r]' [J r] over its own rows.
        parts = [part.reshape(-1, both.shape[2]) for part in np.split(both, starts[1:])]
        gram = np.array([part.T @ part for part in parts])
    return Blocks(gram, run.ends, run.end_sensitivities) if summable(gram) else None


def summable(squares: np.ndarray) -> bool:
    """Whether sums of squares are numbers, and so are their own products and sums."""
    return bool(np.abs(squares).max(initial=0.0) < LARGEST)


def by_unknowns(by_start: np.ndarray, dz: np.ndarray, n_own: int) -> np.ndarray:
    """Chain derivatives by a full state with those of that state by the unknowns.

    Parameters
    ----------
    by_start : ndarray (n_times, n_outputs, n_full + n_free)
        Of the outputs of a run.
    dz : ndarray (n_full, n_own + n_free)
        Derivatives of the full state.
    n_own : int
        Number of the model's own states.

    Returns
    -------
    ndarray (n_times, n_outputs, n_own + n_free)
    """
    n_full = len(dz)
    n_times, n_outputs, n_columns = by_start.shape
    if np.array_equal(dz, np.eye(*dz.shape)):
        return by_start  # the full state is the model's own, the usual case without memory
    flat = by_start.reshape(-1, n_columns)
    with np.errstate(over="ignore", invalid="ignore"):  # an explosion is told by the states
        jacobian = flat[:, :n_full] @ dz
        jacobian[:, n_own:] += flat[:, n_full:]
    return jacobian.reshape(n_times, n_outputs, -1)


_CACHE: dict[tuple[str, float], Kernel] = {}


def kernel(model: Model) -> Kernel:
    """Return the kernel of a model, compiled at most once per structure."""
    key = (model.structure_key(), model.step)
    if key not in _CACHE:
        _CACHE[key] = Kernel(model)
    return _CACHE[key]
