"""Compile a model's kernel once and keep it on disk.

Safe against processes that compile the same model at the same time, and
against torn files: a library is loaded only when its digest is right. Libraries
run with the user's rights, so they are loaded only from a folder and from files
that nobody else can write to (:func:`oed_sysid.runtime.files.private`).
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
from collections.abc import Callable, Iterable, Mapping
from functools import lru_cache
from importlib.resources import files
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np

from oed_sysid.compiled.graph import (
    DIVERGED,
    FRACTIONS,
    NEWTON_MOST,
    STAGES,
    Graph,
    build,
    differentiated,
)
from oed_sysid.errors import FileError
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import RANK_TOLERANCE, ROUNDING
from oed_sysid.runtime.files import cache_folder, private, private_cache

# Flags of the user come last, so that they count: -Og compiles in a third of the time.
_FLAGS = (
    *("-O2", "-march=native", "-fno-math-errno", "-fno-trapping-math", "-w"),
    "-fno-semantic-interposition",  # no other library replaces functions of this one
    # Vectors are written where they pay: of numbers just stored one by one they wait for the cache.
    "-fno-tree-slp-vectorize",
    *os.environ.get("OED_SYSID_CFLAGS", "").split(),
)


@lru_cache(maxsize=1)
def _compiler() -> str | None:
    if os.environ.get("OED_SYSID_COMPILER") == "none":
        return None
    known = (os.environ.get("OED_SYSID_COMPILER"), os.environ.get("CC"), "gcc", "clang", "cc")
    return next((name for name in known if name and shutil.which(name)), None)


# What the code of a model is generated from.
_GENERATOR = (
    "compiled/graph.py",
    "text/expressions.py",
    "text/callables.py",
    "physics/structure.py",
    "compiled/compile.py",
    "compiled/trajectory.c",
    "compiled/filter.c",
)


@lru_cache(maxsize=1)
def _machine_digest() -> str:
    """Digest of the compiler and the processor the code is for."""
    facts = (ca.CasadiMeta.version(), _FLAGS, _compiler(), platform.machine())
    digest = hashlib.sha256(repr(facts).encode())
    try:  # -march=native: another processor needs its own code
        with open("/proc/cpuinfo") as handle:
            digest.update(next((line for line in handle if line.startswith("flags")), "").encode())
    except OSError:
        digest.update(platform.processor().encode())
    return digest.hexdigest()


@lru_cache(maxsize=1)
def _generator_digest() -> str:
    """Digest of the files that turn a model's structure into code."""
    texts = (files("oed_sysid").joinpath(name).read_bytes() for name in _GENERATOR)
    return hashlib.sha256(b"".join(texts)).hexdigest()


def load(model: Model, *, filtered: bool = False) -> ctypes.CDLL | None:
    """Return the library of a model, compiling it if need be; None without a compiler.

    With ``filtered`` the library holds the Kalman filter too, and the columns of the sensitivities
    are chosen at run time.
    """
    chosen = ["select", "filter"] if filtered else []
    return load_source(
        "-".join([model.structure_key(), *chosen]),
        lambda: source(build(model)),
        what=f"the equations of {model.name!r}",
        flags=tuple(f"-D{name.upper()}" for name in chosen),
        made_by=_generator_digest(),
    )


def load_source(
    key: str,
    write: Callable[[], str],
    *,
    what: str,
    flags: tuple[str, ...] = (),
    made_by: str | None = None,
) -> ctypes.CDLL | None:
    """Return the library of any generated C source, compiling it if need be.

    A library is found again under a name that holds the key and digests of its
    source, the flags, the compiler and the processor; another library's source
    does not enter, so that a change of one recompiles no other.

    Parameters
    ----------
    key : str
        What the source is, and digest of whatever shapes it.
    write : callable
        Returns the source; with ``made_by`` called only when it has to be compiled.
    what : str
        Words for the message while compiling.
    flags : tuple of str
        Further compiler flags.
    made_by : str, optional
        Digest of what writes the source, where writing takes long; by default
        the source itself is digested.
    """
    compiler = _compiler()
    if compiler is None:
        _say_interpreted("no C compiler (gcc or clang) was found")
        return None
    shape = (_machine_digest(), flags, made_by or write())
    digest = hashlib.sha256(repr(shape).encode()).hexdigest()[:16]
    try:
        library = private_cache() / f"{key}-{digest}.so"
        if not _intact(library):
            _compile(write, what, compiler, flags, library)
        return ctypes.CDLL(str(library))
    except (OSError, FileError) as error:  # a full disk, or one from which nothing may be run
        reason = f"{cache_folder()} cannot be written or run from ({error})"
    except subprocess.CalledProcessError as error:
        text = (error.stderr or b"").decode(errors="replace").strip().splitlines()
        said = next((line for line in text if "error" in line), text[-1] if text else str(error))
        reason = f"{compiler} failed: {said.strip()}"
    _say_interpreted(reason)
    return None


def call(function: Callable[..., int], *arguments: Any) -> int:
    """Call compiled code: arrays by their address, floats as doubles; None and empty are NULL."""
    passed: list[Any] = []
    for value in arguments:
        if isinstance(value, np.ndarray):
            address = value.__array_interface__["data"][0] if value.size else None
            passed.append(ctypes.c_void_p(address))
        else:
            passed.append(ctypes.c_double(value) if isinstance(value, float) else value)
    return function(*passed)


def doubles(*arrays: np.ndarray) -> list[np.ndarray]:
    """Arrays as compiled code reads them: contiguous, of doubles."""
    return [np.ascontiguousarray(array, dtype=float) for array in arrays]


def _intact(library: Path) -> bool:
    """Whether a cached library is the one that was written, by this user and whole."""
    if not (private(library) and private(library.with_suffix(".sha256"))):
        return False
    try:
        stated = library.with_suffix(".sha256").read_text()
        return hashlib.sha256(library.read_bytes()).hexdigest() == stated
    except OSError:
        return False


@lru_cache
def _announce(what: str, folder: Path) -> None:
    """Say once in a process what takes the seconds, however many of its libraries there are."""
    print(f"oed_sysid: compiling {what} (once; kept in {folder})", file=sys.stderr)


def _compile(
    write: Callable[[], str], what: str, compiler: str, flags: tuple[str, ...], library: Path
) -> None:
    _announce(what, library.parent)
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        code = Path(folder) / "kernel.c"
        built = Path(folder) / "kernel.so"
        code.write_text(write())
        subprocess.run(
            [compiler, *_FLAGS, *flags, "-fPIC", "-shared", str(code), "-o", str(built), "-lm"],
            check=True,
            capture_output=True,
        )
        built.chmod(0o700)
        digest = Path(folder) / "kernel.sha256"
        digest.write_text(hashlib.sha256(built.read_bytes()).hexdigest())
        digest.chmod(0o600)
        # Digest first, library last: a reader that sees both sees a matching pair. A link that
        # somebody has put there is replaced, not followed, and nothing is ever taken away that
        # another process may just have finished.
        os.replace(digest, library.with_suffix(".sha256"))
        os.replace(built, library)


@lru_cache(maxsize=1)
def _say_interpreted(reason: str) -> None:
    warnings.warn(
        f"Models run in CasADi's interpreter, 15 to 60 times slower, because {reason}.",
        stacklevel=2,
    )


# -- C code of one model structure: CasADi functions, sizes and sparse updates --------------


def _products(target: str, n_rows: int, *terms: tuple[str, ca.Sparsity, str]) -> str:
    """C statements that set rows to sums of sparse matrices (values, places) times other rows."""
    sums: list[list[str]] = [[] for _ in range(n_rows)]
    for values, sparsity, source in terms:
        for index, (row, column) in enumerate(zip(*sparsity.get_triplet(), strict=True)):
            sums[row].append(f"{values}[{index}] * FOUR({source}, {column})")
    return " ".join(
        f"FOUR({target}, {row}) = {' + '.join(one) or '(four_t){0.0}'};"
        for row, one in enumerate(sums)
    )


def _parameters(target: str, values: str, sparsity: ca.Sparsity) -> str:
    """C statements that add the derivatives by parameters to the columns of these."""
    triplets = enumerate(zip(*sparsity.get_triplet(), strict=True))
    return " ".join(f"PARAMETER({target}[{i}], {j}, {values}[{k}])" for k, (i, j) in triplets)


def _fill(sparsity: ca.Sparsity) -> str:
    """C statements that write the entries of a sparse matrix into a dense one."""
    triplets = enumerate(zip(*sparsity.get_triplet(), strict=True))
    return " ".join(f"matrix[{row}][{column}] = v[{i}];" for i, (row, column) in triplets)


# Before the generated functions. They are called from the loops alone: private, they become a part
# of these. Every lag that is absent asks at every step for an exponential that is less than half
# the smallest number, hence zero, to which the library comes by its slow way, of underflow.
_BEFORE = """
#include <math.h>
#define CASADI_SYMBOL_EXPORT static
static inline double exponential(double x) { return x < -746.0 ? 0.0 : exp(x); }
#define exp exponential
"""


def source(graph: Graph) -> str:
    """Return the complete C source of a model's kernel."""
    free = graph.free_indices
    actuate = differentiated(graph.actuate, (0, 2), 2, free, "jac")
    rates = differentiated(graph.rates, (0, 1, 2), 2, free, "jac")
    observe = differentiated(graph.observe, (0, 1, 2, 3), 3, free, "jac")
    generator = ca.CodeGenerator("kernel.c", {"with_header": False})
    for function in (graph.actuate, graph.rates, graph.observe, actuate, rates, observe):
        generator.add(function)
    start = _start(graph)
    generator.add(start)
    model = graph.model
    linear = graph.linear_inputs
    sizes = {
        "NX": graph.n_states,
        "NA": graph.n_actuator_memory,
        "NS": graph.n_sensor_memory,
        "NZ": graph.n_full,
        "ND": len(model.actuator_signals),
        "NU": len(model.inputs),
        "NY": len(model.outputs),
        "NP": len(model.all_parameters),
        "NF": len(free),
        "NC": graph.n_full + len(free),
        "N_OWN": graph.n_own,
        "DIVERGED": DIVERGED,
        "ANY_LINEAR_INPUT": int(any(linear)),
        "LINEAR_INPUTS": _braces(str(int(flag)) for flag in linear or (0,)),
    }
    # Workspace of the larger of the plain and the differentiated function.
    plain = (graph.actuate, graph.rates, graph.observe, start)
    labels = ("ACTUATE", "RATES", "OBSERVE", "START")
    for label, *pair in zip(labels, plain, (actuate, rates, observe, start), strict=True):
        sizes[f"W_{label}"] = max(map(ca.Function.sz_w, pair))
        sizes[f"IW_{label}"] = max(map(ca.Function.sz_iw, pair))
    begin = start.sparsity_out(1)
    sizes |= {"NNZ_START": begin.nnz(), "START_PLACES": _places(begin)}
    acting = {"sd": {"dda": "sa", "ddp": ""}, "sa_next": {"daa": "sa", "dap": ""}}
    moving = {"sk": {"jxx": "s", "jxd": "sd", "jxp": ""}}
    sensing = {
        "sy": {"jyx": "s", "jyd": "sd", "jys": "ss", "jyp": ""},
        "snext": {"jsx": "s", "jsd": "sd", "jss": "ss", "jsp": ""},
    }
    updates = dict[str, str]()
    for function, targets in ((actuate, acting), (rates, moving), (observe, sensing)):
        updates |= _updates(function, targets, sizes)
    if model.integrator == "implicit":
        updates["FILL_JXX"] = _fill(rates.sparsity_out(1))
        updates["ROWS_SK_BESIDE"] = _products(
            "sk", graph.n_states, ("jxd", rates.sparsity_out(2), "sd")
        )
        sizes |= {
            "IMPLICIT": 1,
            "STAGE_WEIGHTS": _braces(_braces(map(repr, row)) for row in STAGES),
            "STAGE_FRACTIONS": _braces(map(repr, FRACTIONS)),
            "NEWTON_STEP": repr(ROUNDING),
            "NEWTON_FLOOR": repr(ROUNDING * RANK_TOLERANCE),
            "NEWTON_MOST": NEWTON_MOST,
        }
    defines = [f"#define {name} {value}" for name, value in (sizes | updates).items()]
    folder = files("oed_sysid.compiled")
    loops = [folder.joinpath(name).read_text() for name in ("trajectory.c", "filter.c")]
    code = [_BEFORE, generator.dump(), *defines, loops[0], "#ifdef FILTER", loops[1], "#endif"]
    return "\n".join(code)


def _updates(
    function: ca.Function, targets: Mapping[str, Mapping[str, str]], sizes: dict[str, Any]
) -> dict[str, str]:
    """C statements that apply the derivatives of a function, its last results; sizes noted.

    Rows, the ``targets``, are sums of Jacobians times other rows, and of a Jacobian by parameters,
    which stands behind these, without rows.
    """
    updates, index = {}, len(targets)
    for target, factors in targets.items():
        places = {name: function.sparsity_out(index + i) for i, name in enumerate(factors)}
        index += len(factors)
        sizes |= {f"NNZ_{name.upper()}": one.nnz() for name, one in places.items()}
        last, by_parameters = [*places.items()][-1]
        products = [(name, places[name], rows) for name, rows in factors.items() if rows]
        updates[f"ROWS_{target.upper()}"] = _products(target, by_parameters.size1(), *products)
        updates[f"PARAMETERS_{target.upper()}"] = _parameters(target, last, by_parameters)
    return updates


def _braces(items: Iterable[str]) -> str:
    return "{" + ", ".join(items) + "}"


def _start(graph: Graph) -> ca.Function:
    """Start function with its sparse derivative, row by row, by own states and free parameters."""
    symbols = graph.start.sx_in()
    found = differentiated(graph.start, (0, 2), 2, graph.free_indices, "own")
    z, by_own, by_free = found.call(symbols)
    # CasADi stores columns; the transpose hands rows to C.
    return ca.Function("start_jac", symbols, [z, ca.horzcat(by_own, by_free).T])


def _places(sparsity: ca.Sparsity) -> str:
    """Where the entries of a sparse matrix stand in a dense one, column by column."""
    rows, columns = (np.array(part, dtype=int) for part in sparsity.get_triplet())
    return _braces(map(str, (columns * sparsity.size1() + rows).tolist() or [0]))
