"""Compiled trajectories and sensitivities of a model.

The code of a model structure is generated and compiled once, kept on disk
under the digest of everything that shapes it, and loaded in milliseconds.
Values of parameters, inputs and initial states are arguments, so neither more
data nor other values compile anything again. Without a C compiler the same
functions run in CasADi's interpreter, slower, and this is said once.

The cache folder is ``$OED_SYSID_CACHE``, or ``~/.cache/oed_sysid``.
"""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import warnings
from dataclasses import dataclass
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid import graph as graph_module
from oed_sysid.errors import ModelError
from oed_sysid.graph import Graph
from oed_sysid.model import Model

_FLAGS = ("-O3", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-w")


@dataclass(frozen=True, eq=False)
class Run:
    """What a kernel returns for one record.

    Attributes
    ----------
    outputs : ndarray (n_times, n_outputs)
        Model outputs; NaN after a failure.
    states : ndarray (n_times, n_full)
        Full state before each measurement.
    output_sensitivities : ndarray (n_times, n_outputs, n_columns) or None
        Derivatives by the start state of the segment, then by free parameters.
    ends : ndarray (n_segments, n_full)
        State at the end of each segment, that is at the next one's first sample.
    end_sensitivities : ndarray (n_segments, n_full, n_columns) or None
        Its derivatives.
    failed_at : int
        First sample whose state is not finite, or -1.
    """

    outputs: np.ndarray
    states: np.ndarray
    output_sensitivities: np.ndarray | None
    ends: np.ndarray
    end_sensitivities: np.ndarray | None
    failed_at: int

    @property
    def ok(self) -> bool:
        """Whether the whole trajectory is finite."""
        return self.failed_at < 0


class Kernel:
    """Trajectories and exact sensitivities of one model structure.

    Sizes: ``n_full`` (length of the full state), ``n_own`` (the model's own
    states), ``n_free`` (free parameters), ``n_columns = n_full + n_free``.

    Parameters
    ----------
    model : Model
        The model; only its structure matters, values are arguments.
    compiled : bool or None
        Force (True) or refuse (False) compiled code; None takes what is there.
    """

    def __init__(self, model: Model, *, compiled: bool | None = None) -> None:
        self.model = model
        self.n_parameters = len(model.all_parameters)
        self.n_inputs = len(model.inputs)
        self.n_outputs = len(model.outputs)
        self.n_own = len(model.states)
        self.n_free = len(model.free_parameters)
        n_extra = sum(len(effect.states) for effect in model.effects)
        n_memory = sum(len(effect.memory) for effect in model.effects)
        self.n_full = self.n_own + n_extra + n_memory
        self.n_columns = self.n_full + self.n_free
        self._library = None if compiled is False else _load(model)
        if compiled is True and self._library is None:
            raise ModelError(
                "Compiled code was asked for, but no C compiler was found. Install gcc or clang, "
                "or leave compiled=None to use CasADi's interpreter."
            )

    def __reduce__(self) -> tuple[Any, ...]:
        return kernel, (self.model,)

    @property
    def is_compiled(self) -> bool:
        """Whether compiled code runs, rather than the interpreter."""
        return self._library is not None

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
        own, inputs, values = (np.ascontiguousarray(a, dtype=float) for a in (own, inputs, values))
        if self._library is None:
            z, dense = _interpreted(self.model).start(own, inputs, values, time)
            return z, dense
        z = np.empty(self.n_full)
        dz = np.empty((self.n_full, self.n_own + self.n_free))
        self._library.kernel_start(
            _pointer(own),
            _pointer(inputs),
            _pointer(values),
            ctypes.c_double(time),
            _pointer(z),
            _pointer(dz),
        )
        return z, dz

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        *,
        starts: np.ndarray | None = None,
        carry: bool = False,
        sensitivities: bool = False,
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
            Full state at the start of each segment; with ``carry`` only the
            first row is read and the trajectory is continuous, while
            sensitivities still begin anew at each segment.
        starts : ndarray of int (n_segments,), optional
            Index of the first sample of each segment; one segment by default.
        carry : bool
            Continue from the end of the previous segment.
        sensitivities : bool
            Also return derivatives.
        """
        times = np.ascontiguousarray(times, dtype=float)
        inputs = np.ascontiguousarray(inputs, dtype=float).reshape(len(times), self.n_inputs)
        values = np.ascontiguousarray(values, dtype=float)
        nodes = np.ascontiguousarray(nodes, dtype=float).reshape(-1, self.n_full)
        starts = np.ascontiguousarray([0] if starts is None else starts, dtype=np.intc)
        n, n_segments = len(times), len(starts)
        if values.shape != (self.n_parameters,):
            raise ModelError(
                f"Got {values.shape} parameter values, expected ({self.n_parameters},)."
            )
        if len(nodes) != (1 if carry else n_segments):
            raise ModelError(f"Got {len(nodes)} node states for {n_segments} segments.")
        y = np.full((n, self.n_outputs), np.nan)
        z = np.full((n, self.n_full), np.nan)
        ends = np.full((n_segments, self.n_full), np.nan)
        dy = dends = None
        if sensitivities:
            dy = np.empty((n, self.n_outputs, self.n_columns))
            dends = np.empty((n_segments, self.n_full, self.n_columns))
        if self._library is None:
            failed = _interpreted(self.model).run(
                times, inputs, values, nodes, starts, carry, (z, y, dy, ends, dends)
            )
        else:
            failed = self._library.kernel_run(
                n,
                _pointer(times),
                _pointer(inputs),
                _pointer(values),
                ctypes.c_double(self.model.step),
                n_segments,
                starts.ctypes.data_as(ctypes.c_void_p),
                _pointer(nodes),
                int(carry),
                _pointer(z),
                _pointer(y),
                _pointer(dy),
                _pointer(ends),
                _pointer(dends),
            )
        if failed >= 0 and dy is not None:
            dy[failed:] = np.nan
        return Run(y, z, dy, ends, dends, failed)


@lru_cache(maxsize=256)
def _kernel(key: str, step: float, holder: graph_module._Holder) -> Kernel:
    return Kernel(holder.model)


def kernel(model: Model) -> Kernel:
    """Return the kernel of a model, compiled at most once per structure."""
    return _kernel(model.structure_key(), model.step, graph_module._Holder(model))


def cache_folder() -> Path:
    """Folder that keeps compiled kernels."""
    stated = os.environ.get("OED_SYSID_CACHE")
    return Path(stated) if stated else Path.home() / ".cache" / "oed_sysid"


# -- compiling ---------------------------------------------------------------------


def _pointer(array: np.ndarray | None) -> ctypes.c_void_p | None:
    return None if array is None else ctypes.c_void_p(array.ctypes.data)


@lru_cache(maxsize=1)
def _compiler() -> str | None:
    if os.environ.get("OED_SYSID_COMPILER") == "none":
        return None
    for name in (os.environ.get("OED_SYSID_COMPILER"), os.environ.get("CC"), "gcc", "clang", "cc"):
        if name and shutil.which(name):
            return name
    return None


@lru_cache(maxsize=1)
def _tool_digest() -> str:
    """Digest of the generator, the libraries and the machine the code is for."""
    digest = hashlib.sha256()
    package = files("oed_sysid")
    for name in (
        "graph.py",
        "expressions.py",
        "native/generate.py",
        "native/trajectory.c",
    ):
        digest.update(package.joinpath(name).read_bytes())
    digest.update(repr((ca.__version__, _FLAGS, _compiler(), platform.machine())).encode())
    try:  # -march=native: another processor needs its own code
        with open("/proc/cpuinfo") as handle:
            digest.update(next((line for line in handle if line.startswith("flags")), "").encode())
    except OSError:
        digest.update(platform.processor().encode())
    return digest.hexdigest()[:16]


def _load(model: Model) -> ctypes.CDLL | None:
    compiler = _compiler()
    if compiler is None:
        _say_interpreted("no C compiler (gcc or clang) was found")
        return None
    name = f"{model.structure_key()}-{_tool_digest()}"
    library = cache_folder() / f"{name}.so"
    if not _intact(library):
        try:
            _compile(model, compiler, library)
        except OSError as error:
            _say_interpreted(f"{cache_folder()} cannot be written ({error})")
            return None
        except subprocess.CalledProcessError as error:
            text = (error.stderr or b"").decode(errors="replace").strip().splitlines()
            _say_interpreted(f"{compiler} failed: {text[-1] if text else error}")
            return None
    loaded = ctypes.CDLL(str(library))
    sizes = (ctypes.c_int * 8)()
    loaded.kernel_sizes(sizes)
    return loaded


def _intact(library: Path) -> bool:
    """Whether a cached library is the one that was written: a torn file would crash."""
    try:
        stated = library.with_suffix(".sha256").read_text()
        return hashlib.sha256(library.read_bytes()).hexdigest() == stated
    except OSError:
        return False


def _compile(model: Model, compiler: str, library: Path) -> None:
    from oed_sysid.native.generate import source

    library.parent.mkdir(parents=True, exist_ok=True)
    print(
        f"oed_sysid: compiling the equations of {model.name!r} (once; kept in {library.parent})",
        file=sys.stderr,
    )
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        code = Path(folder) / "kernel.c"
        built = Path(folder) / "kernel.so"
        code.write_text(source(graph_module.build(model)))
        subprocess.run(
            [compiler, *_FLAGS, "-fPIC", "-shared", str(code), "-o", str(built), "-lm"],
            check=True,
            capture_output=True,
        )
        # Digest first, library last: a reader that sees both sees a matching pair.
        digest = Path(folder) / "kernel.sha256"
        digest.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
        os.replace(digest, library.with_suffix(".sha256"))
        os.replace(built, library)


@lru_cache(maxsize=1)
def _say_interpreted(reason: str) -> None:
    warnings.warn(
        f"Models run in CasADi's interpreter, 15 to 60 times slower, because {reason}.",
        stacklevel=2,
    )


# -- interpreter -------------------------------------------------------------------


class _Interpreted:
    """The same results from CasADi's interpreter, one call per step."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        free = list(graph.free_indices)

        def differentiated(function: ca.Function, z_index: int, p_index: int) -> ca.Function:
            symbols = [
                ca.SX.sym(function.name_in(i), function.sparsity_in(i))
                for i in range(function.n_in())
            ]
            results = function.call(symbols)
            blocks = []
            for result in results:
                by_p = ca.jacobian(result, symbols[p_index])[:, free]
                blocks.append(ca.densify(ca.horzcat(ca.jacobian(result, symbols[z_index]), by_p)))
            return ca.Function(
                f"{function.name()}_dense", symbols, [*results, *blocks], {"cse": True}
            )

        self._advance = differentiated(graph.advance, 0, 3)
        self._sample = differentiated(graph.sample, 0, 2)
        self._start = differentiated(graph.start, 0, 2)

    def start(
        self, own: np.ndarray, inputs: np.ndarray, values: np.ndarray, time: float
    ) -> tuple[np.ndarray, np.ndarray]:
        z, dz = self._start(own, inputs, values, time)
        return np.array(z).ravel(), np.array(dz)

    def run(
        self,
        times: np.ndarray,
        inputs: np.ndarray,
        values: np.ndarray,
        nodes: np.ndarray,
        starts: np.ndarray,
        carry: bool,
        results: tuple[np.ndarray, np.ndarray, np.ndarray | None, np.ndarray, np.ndarray | None],
    ) -> int:
        z_out, y_out, dy_out, ends, dends = results
        n, n_full = len(times), self.graph.n_full
        linear = np.array(self.graph.linear_inputs, dtype=float)
        derive = dy_out is not None
        z = nodes[0]
        s = np.eye(n_full, dy_out.shape[2]) if dy_out is not None else np.empty((0, 0))
        for segment, first in enumerate(starts):
            stop = starts[segment + 1] if segment + 1 < len(starts) else n
            z = z if carry else nodes[segment]
            if derive:
                s = np.eye(n_full, s.shape[1])
            for k in range(first, stop):
                if not np.isfinite(z).all():
                    return k
                z_out[k] = z
                since = times[k] - times[k - 1] if k else (times[1] - times[0] if n > 1 else 1.0)
                y, after, dy, dafter = self._sample(z, inputs[k], values, times[k], since)
                y_out[k] = np.array(y).ravel()
                z = np.array(after).ravel()
                if dy_out is not None:
                    dy_out[k] = _chain_rule(np.array(dy), s)
                    s = _chain_rule(np.array(dafter), s)
                if k + 1 == n:
                    break
                interval = times[k + 1] - times[k]
                steps = max(1, int(np.ceil(interval / self.graph.model.step - 1e-9)))
                slope = linear * (inputs[k + 1] - inputs[k]) / steps
                for i in range(steps):
                    begin, end = inputs[k] + i * slope, inputs[k] + (i + 1) * slope
                    t, h = times[k] + i * interval / steps, interval / steps
                    moved, dmoved = self._advance(z, begin, end, values, t, h)
                    z = np.array(moved).ravel()
                    if derive:
                        s = _chain_rule(np.array(dmoved), s)
            ends[segment] = z
            if dends is not None:
                dends[segment] = s
        return -1


def _chain_rule(jacobian: np.ndarray, s: np.ndarray) -> np.ndarray:
    """Combine a dense ``[d/dz, d/dp]`` with the sensitivities ``s`` of ``z``."""
    n_full = len(s)
    result = jacobian[:, :n_full] @ s
    result[:, n_full:] += jacobian[:, n_full:]
    return result


@lru_cache(maxsize=64)
def _interpreted_cached(key: str, step: float, holder: graph_module._Holder) -> _Interpreted:
    return _Interpreted(graph_module.build(holder.model))


def _interpreted(model: Model) -> _Interpreted:
    return _interpreted_cached(model.structure_key(), model.step, graph_module._Holder(model))
