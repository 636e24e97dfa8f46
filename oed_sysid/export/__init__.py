"""Models out: a fitted model where it works next, with the covariance of its parameters.

:func:`export` writes a fit, or a model, as CasADi functions, C, Python, MATLAB, a Functional
Mock-up Unit, a linear model for python-control, SymPy or LaTeX. All but the last three repeat the
package's simulation, step for step.
"""

from __future__ import annotations

import json
import warnings
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from pathlib import Path

from oed_sysid.errors import ModelError, located
from oed_sysid.export import scripts
from oed_sysid.export.c_code import example_test, header, source, write_fmu
from oed_sysid.export.program import Program, identifier, program_of
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.replay import replayed
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import write_text

__all__ = ["KINDS", "Program", "export", "program_of"]

Text = Callable[..., str]  # of a program and the file that it is for
Writer = Callable[[Program, Path], tuple[Path, ...]]
# Kinds in words, and their texts by the ends of their files' names (of C they need one another's
# names) or, where a kind is more than texts, what writes it.
_KINDS: dict[str, tuple[str, dict[str, Text] | Writer]] = {
    "fmu3": ("FMU (FMI 3.0)", partial(write_fmu, version="3.0")),
    "fmu": ("FMU (FMI 2.0)", write_fmu),
    "c": ("C (C99, no dependency)", {".h": header, ".c": source, "_test.c": example_test}),
    "python": ("Python (NumPy only)", {".py": scripts.python_text}),
    "casadi": ("CasADi functions", scripts.write_casadi),
    "matlab": ("MATLAB / Octave", {".m": scripts.matlab_text}),
    "control": ("linear, python-control", {"_linear.py": scripts.control_text}),
    "sympy": ("SymPy and LaTeX", {"_sympy.py": scripts.module_text, ".tex": scripts.latex_text}),
    "latex": ("LaTeX", {".tex": scripts.latex_text}),
}
#: Kinds of export, in words.
KINDS = {kind: words for kind, (words, _) in _KINDS.items()}


def export(
    source: Fit | Model, kind: str, path: str | Path, *, trim: Mapping[str, float] | None = None
) -> tuple[Path, ...]:
    """Write a model for another program.

    Parameters
    ----------
    source : Fit or Model
        A fit, as estimators and ``improve`` return it, brings the covariance of its parameters.
        Where its process noise has taken the work of physics, the values are those of
        :func:`~oed_sysid.likelihood.replay.replayed`, and a warning says so.
    kind : str
        ``"c"``, ``"python"``, ``"casadi"``, ``"fmu"`` (FMI 2.0), ``"fmu3"`` (FMI 3.0),
        ``"matlab"``, ``"control"``, ``"sympy"`` or ``"latex"``.
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
    located(ModelError, "There is no export", [kind], KINDS)
    program, place = program_of(_for_runs(source)), Path(path).expanduser()
    if trim and kind != "control":
        raise ModelError(f"A trim is for kind 'control'; {kind!r} is the whole model.")
    made = _KINDS[kind][1]
    if callable(made):
        return made(program, place)
    given = {"trim": trim} if kind == "control" else {}
    files = _files(program, [*made], place, alone=kind != "c")
    written = {file: made[tail](program, file, **given) for tail, file in files}
    if not program.is_plain:  # what people called things, where code cannot carry it
        names = next(iter(written)).with_suffix(".json")
        written[names] = json.dumps(program.describe(), indent=2) + "\n"
    for file, text in written.items():
        write_text(file, text)
    return tuple(written)


def _for_runs(source: Fit | Model) -> Fit | Model:
    """A fit with the values for whole runs, where process noise has taken the work of physics."""
    runs = replayed(source) if isinstance(source, Fit) else source
    if runs is not source and isinstance(runs, Fit):
        warnings.warn(
            f"{runs.model.name}: process noise has taken the work of physics; the exported "
            f"values are those for runs ({runs.estimator}).",
            UserWarning,
            stacklevel=3,
        )
    return runs


def _files(
    program: Program, tails: list[str], place: Path, *, alone: bool
) -> Iterator[tuple[str, Path]]:
    """Files by the ends of their names: in a folder or, of some, as a user names the first."""
    first = tails[0]
    for tail in tails:
        ending = tail[tail.index(".") :]
        if alone and place.suffix == first[first.index(".") :]:
            file = place.with_suffix(ending)
        else:
            file = place / f"{program.identifier}{tail}"
        # MATLAB calls a function by the name of its file.
        yield tail, file.with_name(f"{identifier(file.stem)}.m") if ending == ".m" else file
