"""What leaves the page: fits, models for other programs, problem folders, the whole study."""

from __future__ import annotations

import io
import tempfile
import zipfile
from collections.abc import Iterable, Mapping
from pathlib import Path

from oed_sysid.app import script
from oed_sysid.app.plans import commands_csv
from oed_sysid.app.records import archive
from oed_sysid.app.shelf import Asked
from oed_sysid.app.study import Study
from oed_sysid.app.tasks import Outcome
from oed_sysid.design import Design
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.experiments.problem import list_problems
from oed_sysid.export import export
from oed_sysid.likelihood.fit import Fit

# Kinds of oed_sysid.export, in words.
KINDS = {
    "c": "C (C99, no dependency)",
    "python": "Python (NumPy only)",
    "casadi": "CasADi functions",
    "fmu": "FMU (FMI 2.0 co-simulation)",
    "matlab": "MATLAB / Octave",
    "control": "linear, python-control",
    "sympy": "SymPy and LaTeX",
    "latex": "LaTeX",
}
# Endings of a problem folder's files that belong to it.
_OF_A_PROBLEM = (".py", ".md", ".toml", ".txt")
_LARGEST = 5_000_000  # bytes of one such file

Finished = Iterable[tuple[Asked, Outcome]]


def fits_of(done: Finished) -> dict[str, tuple[str, Fit]]:
    """Fitted models by what they are called: name of a file, and the fit; the latest of a name.

    Parameters
    ----------
    done : iterable of (Asked, Outcome)
        What was computed.
    """
    found: dict[str, tuple[str, Fit]] = {}
    for _, outcome in done:
        for name, fit in outcome.fits.items():
            file = "".join(letter if letter.isalnum() else "_" for letter in name)
            found[name] = file, fit
    return found


def saved(fit: Fit) -> bytes:
    """The file that ``oed-sysid fit --save`` writes: for `report`, `export` and ``Fit.load``."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "fit.json"
        fit.save(path)
        return path.read_bytes()


def model_archive(fit: Fit, kind: str, trim: Mapping[str, float] | None = None) -> bytes:
    """The model of a fit for another program, as a ZIP file.

    Parameters
    ----------
    fit : Fit
        Whose model it is.
    kind : str
        One of ``KINDS``.
    trim : mapping of str to float, optional
        For ``"control"``: inputs and states of the trim, SI.

    Raises
    ------
    OedSysidError
        If the model cannot be written so.
    """
    target = io.BytesIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for file in export(fit, kind, folder, trim=trim or None):
            packed.write(file, Path(file).name)
    return target.getvalue()


def problem_archive(study: Study, fits: Mapping[str, tuple[str, Fit]]) -> bytes:
    """The folder of the problem with the records of the study and its fits, as a ZIP file."""
    name = study.problem.name
    target = io.BytesIO(archive(study.train, study.test, under=f"{name}/"))
    with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as packed:
        folder = folder_of(study.source)
        for file in sorted(folder.rglob("*")):
            parts = file.relative_to(folder).parts
            hidden = any(part.startswith((".", "__pycache__")) for part in parts)
            fits_in = file.suffix in _OF_A_PROBLEM or parts[0] == "data"
            if file.is_file() and not hidden and fits_in and file.stat().st_size <= _LARGEST:
                packed.write(file, "/".join((name, *parts)))
        for title, fit in fits.values():
            packed.writestr(f"{name}/{title}.json", saved(fit))
    return target.getvalue()


def folder_of(source: str) -> Path:
    """Folder of a shipped problem or of the user's own."""
    shipped = catalogue_folder()
    if shipped is not None and source in list_problems():
        return shipped / source
    own = Path(source).expanduser()
    return own.parent if own.is_file() else own


def commands(done: Finished) -> str:
    """Commands that repeat what was computed."""
    return "\n".join(dict.fromkeys(line for a, _ in done for line in a.command.splitlines()))


def everything(study: Study, done: list[tuple[Asked, Outcome]]) -> bytes:
    """Records, reports, fits, commands, script and a designed trial in one ZIP file."""
    target = io.BytesIO(archive(study.train, study.test))
    with zipfile.ZipFile(target, "a", zipfile.ZIP_DEFLATED) as packed:
        packed.writestr("commands.sh", commands(done) + "\n")
        packed.writestr("study.py", script.whole(study, [about.code for about, _ in done]))
        for title, fit in fits_of(done).values():
            packed.writestr(f"{title}.json", saved(fit))
        for about, outcome in done:
            packed.writestr(f"{about.file}.html", outcome.page.html())
            if isinstance(outcome.result, Design):
                packed.writestr("design.csv", commands_csv(outcome.result))
                packed.writestr("card.txt", outcome.result.sea_trial_card() + "\n")
    return target.getvalue()
