"""C code of one model structure: CasADi functions, sizes and sparse updates."""

from __future__ import annotations

from collections.abc import Iterable
from importlib.resources import files

import casadi as ca

from oed_sysid.compiled.graph import (
    FRACTIONS,
    NEWTON_FLOOR,
    NEWTON_MOST,
    NEWTON_STEP,
    STAGES,
    Graph,
    differentiated,
)


def _update(sparsity: ca.Sparsity, *, parameter: bool) -> str:
    """C statements that add ``J @ source`` (or the columns of ``J``) to rows of a target."""
    lines = []
    for index, (row, column) in enumerate(zip(*sparsity.get_triplet(), strict=True)):
        if parameter:
            lines.append(f"PARAMETER({row}, {column}, v[{index}])")
        else:
            lines.append(f"add_scaled(target[{row}], v[{index}], source[{column}]);")
    return " ".join(lines)


def _fill(sparsity: ca.Sparsity) -> str:
    """C statements that write the entries of a sparse matrix into a dense one."""
    triplets = enumerate(zip(*sparsity.get_triplet(), strict=True))
    return " ".join(f"matrix[{row}][{column}] = v[{i}];" for i, (row, column) in triplets)


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
        "ANY_LINEAR_INPUT": int(any(linear)),
        "LINEAR_INPUTS": "{" + ", ".join(str(int(flag)) for flag in linear or (0,)) + "}",
    }
    # Workspace of the larger of the plain and the differentiated function.
    for name, pair in {
        "ACTUATE": (graph.actuate, actuate),
        "RATES": (graph.rates, rates),
        "OBSERVE": (graph.observe, observe),
        "START": (start, start),
    }.items():
        sizes[f"W_{name}"] = max(f.sz_w() for f in pair)
        sizes[f"IW_{name}"] = max(f.sz_iw() for f in pair)
    updates: dict[str, str] = {}
    groups = (
        (("DDA", "DDP", "DAA", "DAP"), actuate),
        (("JXX", "JXD", "JXP"), rates),
        (("JYX", "JYD", "JYS", "JYP", "JSX", "JSD", "JSS", "JSP"), observe),
    )
    for labels, function in groups:
        for index, label in enumerate(labels, start=function.n_out() - len(labels)):
            sparsity = function.sparsity_out(index)
            sizes[f"NNZ_{label}"] = sparsity.nnz()
            updates[f"UPDATE_{label}"] = _update(sparsity, parameter=label.endswith("P"))
    if model.integrator == "implicit":
        updates["FILL_JXX"] = _fill(rates.sparsity_out(1))
        sizes |= {
            "IMPLICIT": 1,
            "STAGE_WEIGHTS": _braces(_braces(map(repr, row)) for row in STAGES),
            "STAGE_FRACTIONS": _braces(map(repr, FRACTIONS)),
            "NEWTON_STEP": repr(NEWTON_STEP),
            "NEWTON_FLOOR": repr(NEWTON_FLOOR),
            "NEWTON_MOST": NEWTON_MOST,
        }
    defines = [f"#define {name} {value}" for name, value in (sizes | updates).items()]
    folder = files("oed_sysid.compiled")
    loops = [folder.joinpath(name).read_text() for name in ("trajectory.c", "filter.c")]
    return "\n".join([generator.dump(), *defines, loops[0], "#ifdef FILTER", loops[1], "#endif"])


def _braces(items: Iterable[str]) -> str:
    return "{" + ", ".join(items) + "}"


def _start(graph: Graph) -> ca.Function:
    """Start function with its dense derivative, row by row, by own states and free parameters."""
    symbols = [ca.SX.sym(graph.start.name_in(i), graph.start.sparsity_in(i)) for i in range(4)]
    (z,) = graph.start.call(symbols)
    free = list(graph.free_indices)
    by_own = ca.jacobian(z, symbols[0])
    by_free = ca.jacobian(z, symbols[2])[:, free] if free else ca.SX(z.numel(), 0)
    # CasADi stores columns; the transpose hands rows to C.
    dense = ca.densify(ca.horzcat(by_own, by_free).T)
    return ca.Function("start_jac", symbols, [z, dense])
