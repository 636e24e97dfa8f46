"""Records for a study: with the problem, simulated, or uploaded; and back to files."""

from __future__ import annotations

import io
import re
import tempfile
import warnings
import zipfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from oed_sysid.data.dataset import Dataset, Record, read_csv, write_csv
from oed_sysid.data.third_party import data_folder, registered
from oed_sysid.errors import DataError
from oed_sysid.experiments.problem import Problem
from oed_sysid.experiments.simulation import simulate


def read_uploads(
    problem: Problem, files: Mapping[str, bytes]
) -> tuple[Dataset | None, dict[str, str], tuple[str, ...]]:
    """Read uploaded CSV files with the checks and messages of :func:`read_csv`.

    Parameters
    ----------
    problem : Problem
        Whose channels are looked for.
    files : mapping of str to bytes
        Contents by file name.

    Returns
    -------
    records : Dataset or None
        Of the files that can be used.
    refused : dict of str to str
        Why the others cannot, by file name.
    notes : tuple of str
        What looks odd in those that can.
    """
    read: list[Record] = []
    refused: dict[str, str] = {}
    with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings(record=True) as odd:
        warnings.simplefilter("always", UserWarning)
        for name, content in files.items():
            path = Path(folder) / plain_name(name)
            path.write_bytes(content)
            try:
                read += read_csv(path, problem.channels)
            except DataError as error:
                refused[name] = str(error).replace(f"{folder}/", "")
    notes = tuple(str(one.message) for one in odd if issubclass(one.category, UserWarning))
    return (Dataset(tuple(read)) if read else None), refused, notes


def plain_name(name: str) -> str:
    """Name of an uploaded file without what could lead out of a folder.

    >>> plain_name("../../x.csv"), plain_name(".."), plain_name("dive 1.csv")
    ('x.csv', 'upload.csv', 'dive 1.csv')
    """
    last = re.split(r"[\\/]", name)[-1]
    kept = re.sub(r"[^\w.,()+\- ]", "_", last).lstrip(".")[-100:]
    return kept or "upload.csv"


def simulated(problem: Problem, *, seed: int = 0) -> Dataset:
    """Simulate every experiment of a problem, its truth where it states one.

    The same as ``oed-sysid simulate PROBLEM [--truth] --seed SEED``.

    Parameters
    ----------
    problem : Problem
        With experiments.
    seed : int
        Of the measurement noise.
    """
    if not problem.experiments:
        raise DataError(
            f"Problem {problem.name!r} has no experiments to simulate. Add one to its problem.py, "
            "or upload records."
        )
    model = problem.true_model() if problem.truth else problem.model
    rng = np.random.default_rng(seed)
    runs = [simulate(model, one, rng=rng) for one in problem.experiments.values()]
    return Dataset(tuple(runs))


def measured_sets(folder: Path) -> tuple[str, ...]:
    """Files of third-party data that a problem's programs name, by their sets.

    Parameters
    ----------
    folder : Path
        Of the problem.
    """
    code = "".join(
        file.read_text(encoding="utf-8", errors="replace") for file in sorted(folder.glob("*.py"))
    )
    return tuple(path for path in registered() if path.partition("/")[0] in code)


def at_hand(folder: Path) -> bool:
    """Whether the records of a problem can be read without a download.

    Parameters
    ----------
    folder : Path
        Of the problem: its records are in its ``data``, or measured by others and fetched before.
    """
    if any(folder.glob("data/*")):
        return True
    files = measured_sets(folder)
    return bool(files) and all((data_folder() / path).is_file() for path in files)


def likely_test(names: tuple[str, ...]) -> tuple[str, ...]:
    """Records that look as if they were meant for the test; else the last of several.

    Examples
    --------
    >>> likely_test(("train_1", "test_1")), likely_test(("a", "b")), likely_test(("a",))
    (('test_1',), ('b',), ())
    """
    named = tuple(name for name in names if name.lower().startswith(("test", "valid")))
    if named and len(named) < len(names):
        return named
    return names[-1:] if len(names) > 1 else ()


def archive(train: Dataset | None, test: Dataset | None, *, under: str = "") -> bytes:
    """Return a ZIP file with the folders ``train`` and ``test``, one CSV file per record."""
    target = io.BytesIO()
    with (
        tempfile.TemporaryDirectory() as folder,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as packed,
    ):
        for part, dataset in (("train", train), ("test", test)):
            for record in dataset or ():
                name = f"{record.name.replace('/', '_')}.csv"
                write_csv(record, Path(folder) / name)
                packed.write(Path(folder) / name, f"{under}{part}/{name}")
    return target.getvalue()
