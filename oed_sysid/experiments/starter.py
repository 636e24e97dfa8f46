"""A folder to begin with: a small problem that works, to be changed into the user's own.

Each template is a ``problem.py`` as text; example data is simulated from the truth that it
states. From a log, the template is written anew: see :mod:`oed_sysid.experiments.from_log`.
"""

from __future__ import annotations

import re
import shlex
import tempfile
from collections.abc import Sequence
from contextlib import suppress
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np

from oed_sysid.data.dataset import write_csv
from oed_sysid.errors import FileError, ProblemError
from oed_sysid.experiments.catalogue import FILE, load_problem
from oed_sysid.experiments.from_log import write_from_log
from oed_sysid.experiments.simulation import simulate
from oed_sysid.runtime.files import make_folder, write_text

# Example data is the same wherever it is made.
_SEED = 20240229


# What each template is, the columns of its data, the run to judge by and what is hidden.
TEMPLATES: dict[str, dict[str, str]] = {
    "generic": {},
    "ship": {
        "what": "A ship in surge, sway and yaw, with rudder and propeller",
        "columns": "rudder [deg], thrust [kN], psi [deg], r [deg/s]",
        "test": "circle",
        "hidden": "surge_rudder_drag",
    },
    "auv": {
        "what": "An underwater vehicle in six degrees of freedom",
        "columns": "ds [deg], dr [deg], T [N], theta [deg], q [deg/s]",
        "test": "wide",
        "hidden": "fin_lag",
    },
    "usv": {
        "what": "A catamaran that steers by its two propellers",
        "columns": "n_port [rpm], n_starboard [rpm], psi [deg], r [deg/s]",
        "test": "turns",
        "hidden": "propeller_lag",
    },
    "torpedo": {
        "what": "A torpedo-shaped vehicle in the diving plane",
        "columns": "stern [deg], thrust [N], theta [deg], q [deg/s]",
        "test": "zigzag_15",
        "hidden": "fin_lag",
    },
    "sailboat": {
        "what": "A sailing drone that surges, sways, rolls and yaws in measured wind",
        "columns": "rudder [deg], wind [m/s], angle [deg], phi [deg], psi [deg]",
        "test": "broad",
        "hidden": "rudder_lag",
    },
}


def new_problem(
    folder: str | Path,
    *,
    template: str = "generic",
    log: str | Path | None = None,
    inputs: Sequence[str] = (),
) -> Path:
    """Write a starter folder: ``problem.py``, ``README.md`` and example data.

    Parameters
    ----------
    folder : str or Path
        Where to; its last part becomes the problem's name. It must not exist,
        or be empty.
    template : str
        What kind of vehicle: ``generic`` (a heading that answers to a rudder), ``ship``,
        ``auv``, ``usv``, ``torpedo`` or ``sailboat``.
    log : str or Path, optional
        A CSV file with units in its headers: channels, units and a first linear model are
        taken from it, and it is copied to the folder; no template is used.
    inputs : sequence of str
        With a log, columns that are commands; by default those whose names say so.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ProblemError
        If the folder is in use or cannot be written, or the template is not known.
    DataError
        If the log cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from oed_sysid.experiments.problem import load_problem
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
            f"{place} exists already and is not an empty folder. Give a new name, or go on with "
            "it: oed-sysid problems FOLDER, in Python oed_sysid.load_problem(folder)."
        )
    if template not in TEMPLATES:
        raise ProblemError(f"No template is called {template!r}. Choose {', '.join(TEMPLATES)}.")
    words = {
        "name": name,
        "title": name.replace("_", " ").capitalize(),
        "folder": shlex.quote(place.as_posix()),
    }
    is_new = not place.exists()
    try:
        make_folder(place)
        # Made inside, hidden, and moved when all of it is there.
        with tempfile.TemporaryDirectory(dir=place, prefix=".") as made:
            if log is not None:
                write_from_log(Path(made), Path(log), tuple(inputs), words)
            else:
                _write_template(Path(made), template, words)
            for entry in sorted(Path(made).iterdir()):
                entry.rename(place / entry.name)
    except BaseException as error:
        if is_new:
            with suppress(OSError):
                place.rmdir()
        if isinstance(error, FileError):
            raise ProblemError(str(error)) from None
        if isinstance(error, OSError):
            raise ProblemError(f"{place} cannot be written: {error}") from None
        raise
    return place


def _write_template(place: Path, template: str, words: dict[str, str]) -> None:
    """Write the files of a template, and example data simulated from its truth."""
    kind = TEMPLATES[template]
    folder = files("oed_sysid.experiments").joinpath("starter_files")
    code = Template(folder.joinpath(f"{template}.txt").read_text("utf-8")).substitute(words)
    write_text(place / FILE, code)
    problem = load_problem(place / FILE)
    runs = [run for run in problem.experiments if run != kind.get("test")]
    words = words | kind | {"train": " ".join(f"{words['folder']}/data/{r}.csv" for r in runs)}
    page = folder.joinpath("readme.txt" if kind else "generic_readme.txt").read_text("utf-8")
    write_text(place / "README.md", Template(page).substitute(words))
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
