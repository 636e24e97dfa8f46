"""Every file of the catalogue is read, noted or refused with the words that it must get."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest
from bad_input.csv_files import CHANNELS, GOOD, NOTED, READ, REFUSED

from oed_sysid.data.dataset import Record, read_csv
from oed_sysid.errors import DataError


def write(folder: Path, content: str | bytes) -> Path:
    """Put a file of the catalogue into a folder."""
    path = folder / "log.csv"
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def read(folder: Path, content: str | bytes) -> tuple[Record, str]:
    """The record in a file, and what was noted about it."""
    with warnings.catch_warnings(record=True) as noted:
        warnings.simplefilter("always")
        record = read_csv(write(folder, content), CHANNELS)[0]
    return record, " ".join(str(one.message) for one in noted)


@pytest.mark.parametrize(
    ("content", "words"), [one[1:] for one in REFUSED], ids=[one[0] for one in REFUSED]
)
def test_refused_in_its_own_words(
    tmp_path: Path, content: str | bytes, words: tuple[str, ...]
) -> None:
    """A file that cannot be read safely is refused, and the message names culprit and remedy."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        with pytest.raises(DataError) as caught:
            read_csv(write(tmp_path, content), CHANNELS)
    message = str(caught.value)
    for word in words:
        assert word in message
    assert len(message) < 1000


@pytest.mark.parametrize(
    ("content", "words"), [one[1:] for one in NOTED], ids=[one[0] for one in NOTED]
)
def test_read_and_noted(tmp_path: Path, content: str | bytes, words: tuple[str, ...]) -> None:
    """What can be read safely is read, and what was made of it is said."""
    record, noted = read(tmp_path, content)
    assert record.n_samples == 12
    for word in words:
        assert word in noted


@pytest.mark.parametrize("content", [one[1] for one in READ], ids=[one[0] for one in READ])
def test_read_as_the_good_file(tmp_path: Path, content: str | bytes) -> None:
    """Another spelling of the same numbers gives the same record, without a note."""
    good, _ = read(tmp_path, GOOD)
    record, noted = read(tmp_path, content)
    assert record.content_hash == good.content_hash
    assert noted == ""


def test_clocks_give_the_same_times(tmp_path: Path) -> None:
    """Times of every clock of the catalogue are those of the good file, from zero."""
    good, _ = read(tmp_path, GOOD)
    clocks = [one for one in NOTED if "1970" in one[0] or "time" in one[0]]
    assert len(clocks) >= 6
    for _, content, _ in clocks:
        record, _ = read(tmp_path, content)
        np.testing.assert_allclose(record.times, good.times, atol=1e-6)


def test_catalogue_is_large_enough() -> None:
    """At least a hundred files are refused, and every one of them is another file."""
    contents = [one[1] for one in (*REFUSED, *NOTED)]
    assert len(REFUSED) >= 100
    assert len({c if isinstance(c, bytes) else c.encode() for c in contents}) == len(contents)


def test_page_of_errors_is_current() -> None:
    """docs/errors.md holds every kind of the catalogues, and of files the very messages."""
    from bad_input.problem_files import REFUSED as FOLDERS

    from benchmarks.bad_input import NOTED_AND_REFUSED, PAGE, csv_message, table

    page = PAGE.read_text(encoding="utf-8")
    rows = table((kind, csv_message(content)) for kind, content, _ in NOTED_AND_REFUSED)
    assert rows in page, "run: python -m benchmarks.bad_input --write"
    for kind, _, _ in FOLDERS:
        assert f"| {kind} |" in page
