"""A folder to begin with: a small problem that works, to be changed into the user's own."""

from __future__ import annotations

import re
import tempfile
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np

from oed_sysid.data.dataset import write_csv
from oed_sysid.errors import FileError, ProblemError
from oed_sysid.files import write_text
from oed_sysid.problem.catalogue import FILE, load_problem
from oed_sysid.simulate import simulate

# Example data is the same wherever it is made.
_SEED = 20240229


def new_problem(folder: str | Path) -> Path:
    """Write a starter folder: ``problem.py``, ``README.md`` and example data.

    Parameters
    ----------
    folder : str or Path
        Where to; its last part becomes the problem's name. It must not exist,
        or be empty.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ProblemError
        If the folder is in use or cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> from oed_sysid.problem import load_problem
    >>> with tempfile.TemporaryDirectory() as place:
    ...     made = new_problem(Path(place) / "my_ship")
    ...     problem = load_problem(made)
    ...     print(problem.name, problem.data().names)
    my_ship ('turning_circle', 'zigzag_10_10', 'zigzag_20_20')
    """
    place = Path(folder).expanduser()
    name = _identifier(place.resolve().name)
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise ProblemError(
            f"{place} exists already and is not an empty folder. Give a new name, or load it with "
            "oed_sysid.load_problem."
        )
    words = {"name": name, "title": name.replace("_", " ").capitalize(), "folder": place.as_posix()}
    is_new = not place.exists()
    try:
        place.mkdir(parents=True, exist_ok=True)
        # Made inside, hidden, and moved when all of it is there.
        with tempfile.TemporaryDirectory(dir=place, prefix=".") as made:
            _fill(Path(made), words)
            for entry in sorted(Path(made).iterdir()):
                entry.rename(place / entry.name)
    except (OSError, FileError) as error:
        if is_new:
            with suppress(OSError):
                place.rmdir()
        raise ProblemError(f"{place} cannot be written: {error}") from None
    return place


def _fill(place: Path, words: dict[str, str]) -> None:
    """Write the files of a starter folder."""
    for source, target in (("problem.txt", FILE), ("readme.txt", "README.md")):
        text = files("oed_sysid.problem").joinpath("starter_files", source).read_text("utf-8")
        write_text(place / target, Template(text).substitute(words))
    problem = load_problem(place / FILE)
    rng = np.random.default_rng(_SEED)
    true = problem.true_model()
    for experiment in problem.experiments.values():
        record = simulate(true, experiment, rng=rng)
        write_csv(record, place / "data" / f"{record.name}.csv")


def _identifier(text: str) -> str:
    """Turn a folder's name into a problem's name.

    >>> _identifier("my ship-2"), _identifier("2nd")
    ('my_ship_2', 'problem_2nd')
    """
    name = re.sub(r"\W+", "_", text).strip("_") or "problem"
    return name if name[0].isalpha() else f"problem_{name}"
