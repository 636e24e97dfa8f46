"""Find and load problems: shipped ones by name, any folder by path."""

from __future__ import annotations

import difflib
import hashlib
import importlib
import os
import sys
import traceback
import warnings
from contextlib import suppress
from pathlib import Path
from types import ModuleType

from oed_sysid.errors import ProblemError, listed
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.definition import Problem, faults

FILE = "problem.py"
_PACKAGE = Path(__file__).resolve().parent.parent


def catalogue_folder() -> Path | None:
    """Folder of the shipped problems; None if this installation has none.

    A wheel carries them inside the package; a checkout and an editable install
    have them beside it.
    """
    for folder in (_PACKAGE / "_problems", _PACKAGE.parent / "problems"):
        if folder.is_dir():
            return folder
    return None


def list_problems() -> tuple[str, ...]:
    """Names of the shipped problems; nothing is executed.

    Returns
    -------
    tuple of str
        In alphabetical order; empty where the package was installed without them.

    Examples
    --------
    >>> "kvlcc2" in list_problems()
    True
    """
    if (folder := catalogue_folder()) is None:
        return ()
    return tuple(sorted(file.parent.name for file in folder.glob(f"*/{FILE}")))


def load_problem(name_or_folder: str | Path, *, variant: str | None = None) -> Problem:
    """Load a shipped problem by name, or a problem of your own by folder.

    A plain word is first taken as a shipped name; write ``"./word"`` for a
    folder of that name. The folder's ``problem.py`` is executed: load only
    folders that you trust. It may import further modules of its folder as
    ``from .hull import HULL``.

    Parameters
    ----------
    name_or_folder : str or Path
        Name of a shipped problem, a folder with ``problem.py``, or that file.
    variant : str, optional
        Which of the problem's models to believe; see ``problem.variants``.

    Returns
    -------
    Problem

    Raises
    ------
    ProblemError
        If nothing is found, or ``problem.py`` fails or does not export
        ``problem``; the message names the file and the line.

    Examples
    --------
    >>> load_problem("kvlcc2").model.state_names
    ('psi', 'r')
    """
    problem = _load(_find(name_or_folder))
    return problem if variant is None else problem.variant(variant)


def _find(name_or_folder: str | Path) -> Path:
    """Return the ``problem.py`` that is meant."""
    if not isinstance(name_or_folder, str | os.PathLike) or not str(name_or_folder).strip():
        raise ProblemError(SAYS["names_no_problem"].format(given=name_or_folder))
    shipped = list_problems()
    folder = catalogue_folder()
    if folder is not None and str(name_or_folder) in shipped:
        return folder / str(name_or_folder) / FILE
    path = Path(name_or_folder).expanduser()
    for file in (path, path / FILE):
        if file.is_file() and file.suffix == ".py":
            return file
    raise _not_found(name_or_folder, path, shipped)


def _not_found(given: str | Path, path: Path, shipped: tuple[str, ...]) -> ProblemError:
    """What to do about a name that is neither shipped nor a folder with a problem."""
    if path.is_file():
        return ProblemError(SAYS["is_a_file"].format(path=path, file=FILE))
    if path.is_dir():
        found = ", ".join(sorted(entry.name for entry in path.iterdir())[:8]) or "nothing"
        return ProblemError(SAYS["no_problem_file"].format(path=path, file=FILE, found=found))
    near = difflib.get_close_matches(path.name, shipped, n=3, cutoff=0.5)
    hint = f" Did you mean {' or '.join(map(repr, near))}?" if near else ""
    is_path = isinstance(given, Path) or {os.sep, "/"} & set(str(given))
    looked = f"no folder {path}" if is_path else f"no folder of that name in {Path.cwd()}"
    facts = {"given": str(given), "looked": looked, "hint": hint, "shipped": listed(shipped)}
    return ProblemError(SAYS["no_problem"].format(**facts))


def _load(file: Path) -> Problem:
    """Execute a ``problem.py`` and return its ``problem``, if it is sound."""
    file = file.resolve()
    digest = hashlib.sha256(str(file).encode()).hexdigest()[:8]
    module = ModuleType(f"oed_sysid_problem_{file.parent.name}_{digest}")
    try:
        _execute(module, file)
        problem = getattr(module, "problem", None)
        if not isinstance(problem, Problem):
            raise ProblemError(f"{file} does not export 'problem'; {_found_instead(module, file)}.")
        unsound = list[str]()
        for one in (problem, *problem.others.values()):
            unsound += faults(one.name, one.models, one.effects)
        if unsound:
            more = f" ({len(unsound) - 1} more of this kind.)" if len(unsound) > 1 else ""
            raise ProblemError(f"{file}: {unsound[0]}{more}")
    except ProblemError:
        sys.modules.pop(module.__name__, None)
        raise
    return problem


def _execute(module: ModuleType, file: Path) -> None:
    """Run a file as a package of its folder; raise a problem's error for whatever goes wrong."""
    name = module.__name__
    module.__file__ = str(file)
    # A package, so that ``from .hull import HULL`` finds ``hull.py`` in the same folder,
    # and finds it anew, should it have been edited since.
    module.__path__ = [str(file.parent)]
    module.__package__ = name
    for part in [key for key in sys.modules if key.startswith(f"{name}.")]:
        del sys.modules[part]
    importlib.invalidate_caches()
    # Registered, so that what the file defines can be pickled and inspected.
    sys.modules[name] = module
    here, keyboard = os.getcwd(), sys.stdin
    try:
        # What the file does to filters and folders stays with it, and it cannot wait for a key.
        with warnings.catch_warnings(), open(os.devnull) as nothing:
            sys.stdin = nothing
            # Compiled here, not imported: no stale bytecode, nothing written into the folder.
            exec(compile(file.read_bytes(), str(file), "exec"), vars(module))
    except KeyboardInterrupt:
        raise
    except BaseException as error:
        raise ProblemError(_fault(file, error)) from None
    finally:
        sys.stdin = keyboard
        with suppress(OSError):
            os.chdir(here)


def _found_instead(module: ModuleType, file: Path) -> str:
    """Say what a file defines in place of a problem."""
    if others := [key for key, value in vars(module).items() if isinstance(value, Problem)]:
        return f"it has a Problem called {others[0]!r}: rename it to 'problem'"
    if (problem := getattr(module, "problem", None)) is not None:
        return f"its 'problem' is a {type(problem).__name__}: use problem = Problem(...)"
    public = [key for key in vars(module) if not key.startswith("_")]
    found = f"it defines {', '.join(public) or 'nothing'}: end it with problem = Problem(...)"
    if b"__main__" in file.read_bytes():
        found += ", above and outside of if __name__ == '__main__'"
    return found


def _fault(file: Path, error: BaseException) -> str:
    """Say where in the problem's own file an exception came from, and what it is."""
    if isinstance(error, SyntaxError):
        return _syntax(file, error)
    words = str(error) or "no message"
    kinds = {kind.__name__ for kind in type(error).__mro__}
    said = next(said for kind, part, said in SAYS["faults"] if kind in kinds and part in words)
    return f"{_place(file, error)}: {said.format(kind=type(error).__name__, words=words)}"


def _syntax(file: Path, error: SyntaxError) -> str:
    if "null bytes" in error.msg and file.read_bytes()[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return f"{file} is UTF-16 text. Save it as UTF-8."
    place = f"{error.filename or file}, line {error.lineno or '?'}"
    return f"{place}: {error.msg}. Correct this line of the problem."


def _place(file: Path, error: BaseException) -> str:
    """File and line of the problem's own folder that an exception came from."""
    for frame in reversed(traceback.extract_tb(error.__traceback__)):
        if Path(frame.filename).parent == file.parent:
            return f"{frame.filename}, line {frame.lineno}"
    return str(file)
