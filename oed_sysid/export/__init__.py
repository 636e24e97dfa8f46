"""Models out: a fitted model where it works next, with the covariance of its parameters.

:func:`export` writes a fit, or a model, as CasADi functions, C, Python, MATLAB, a Functional
Mock-up Unit, a linear model for python-control, SymPy or LaTeX. All but the last three repeat the
package's simulation, step for step.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path

from oed_sysid.data.record import closest
from oed_sysid.errors import ModelError
from oed_sysid.export.c_code import write_c, write_fmu
from oed_sysid.export.program import Program, program_of
from oed_sysid.export.scripts import write_casadi, write_control, write_matlab, write_python
from oed_sysid.export.symbolic import write_latex, write_sympy
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import write_text

__all__ = ["KINDS", "Program", "export", "program_of"]

KINDS: dict[str, Callable[..., tuple[Path, ...]]] = {
    "c": write_c,
    "python": write_python,
    "casadi": write_casadi,
    "fmu": write_fmu,
    "matlab": write_matlab,
    "control": write_control,
    "sympy": write_sympy,
    "latex": write_latex,
}


def export(
    source: Fit | Model, kind: str, path: str | Path, *, trim: Mapping[str, float] | None = None
) -> tuple[Path, ...]:
    """Write a model for another program.

    Parameters
    ----------
    source : Fit or Model
        A fit, as estimators and ``improve`` return it, brings the covariance of its parameters.
    kind : str
        ``"c"``, ``"python"``, ``"casadi"``, ``"fmu"``, ``"matlab"``, ``"control"``,
        ``"sympy"`` or ``"latex"``.
    path : str or Path
        A folder; of kinds with a single file also the file.
    trim : mapping of str to float, optional
        For ``"control"``: inputs and states that are given at the trim.

    Returns
    -------
    tuple of Path
        The files that were written.

    Raises
    ------
    ModelError
        If the kind is unknown, or the model cannot be written so.

    Examples
    --------
    >>> import tempfile, importlib.util
    >>> from oed_sysid import load_problem
    >>> model = load_problem("nomoto_sparse_heading").model
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     (file,) = export(model, "python", folder)
    ...     spec = importlib.util.spec_from_file_location("ship", file)
    ...     ship = importlib.util.module_from_spec(spec)
    ...     spec.loader.exec_module(ship)
    >>> psi = ship.simulate([0.0, 30.0, 60.0], [[0.1], [0.1], [0.1]])
    >>> print(psi[:, 0].round(4))
    [ 0.    5.94 11.94]
    """
    if kind not in KINDS:
        raise ModelError(
            f"There is no export {kind!r}. Choose one of {', '.join(KINDS)}."
            + closest(str(kind), KINDS)
        )
    program = program_of(source)
    place = Path(path).expanduser()
    if kind == "control":
        return write_control(program, place, trim)
    if trim:
        raise ModelError(f"A trim is for kind 'control'; {kind!r} is the whole model.")
    written = KINDS[kind](program, place)
    beside = {file.suffix for file in written} & {".json", ".fmu"}
    if program.is_plain or beside:
        return written
    # What people called things, where code cannot carry it.
    names = written[0].with_suffix(".json")
    write_text(names, json.dumps(program.describe(), indent=2) + "\n")
    return (*written, names)
