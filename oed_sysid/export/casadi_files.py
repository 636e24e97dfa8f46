"""CasADi functions as files that any CasADi of the same or a later version loads.

``rates``, ``actuate``, ``observe`` and ``start`` are those of the model; ``advance`` is one
integration step and ``sample`` one measurement. ``model.json`` has names, values and covariance.
"""

from __future__ import annotations

import json
from pathlib import Path

from oed_sysid.compiled.graph import build
from oed_sysid.export.program import Program
from oed_sysid.runtime.files import whole_file, write_text


def write_casadi(program: Program, folder: Path) -> tuple[Path, ...]:
    """Write one file per function, and ``model.json``.

    Parameters
    ----------
    program : Program
        The model.
    folder : Path
        Where the files go.

    Returns
    -------
    tuple of Path
        The files.
    """
    graph = build(program.model)
    functions = [graph.rates, graph.actuate, graph.observe, graph.start]
    if not program.implicit:
        functions += [graph.advance, graph.sample]
    files = []
    for function in functions:
        file = folder / f"{function.name()}.casadi"
        with whole_file(file) as part:
            function.save(str(part))
        files.append(file)
    words = {
        function.name(): {
            "arguments": function.name_in(),
            "shapes": [list(function.size_in(i)) for i in range(function.n_in())],
        }
        for function in functions
    }
    text = json.dumps(program.describe() | {"functions": words}, indent=2)
    write_text(folder / "model.json", text + "\n")
    return (*files, folder / "model.json")
