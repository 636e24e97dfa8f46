"""Finished calculations on disk, one file each.

Safe against several writers (a file appears whole or not at all, and equal
cells have equal results) and against torn files (a digest heads every file;
what does not fit it is calculated again).
"""

from __future__ import annotations

import hashlib
import os
import pickle
import tempfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oed_sysid.errors import DataError

_SUFFIX = ".cell"


@dataclass(frozen=True)
class CellStore:
    """A folder of results by name.

    Results are pickled: open only folders that you or your cluster have written.

    Parameters
    ----------
    folder : Path
        Made when the first result is written.
    """

    folder: Path

    def path(self, key: str) -> Path:
        """File of one cell: names are free, file names are not."""
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}{_SUFFIX}"

    def find(self, keys: Iterable[str]) -> dict[str, Any]:
        """Return the results that are there, of the cells that are asked for."""
        entries = {key: self._entry(self.path(key)) for key in keys}
        return {key: entry[1] for key, entry in entries.items() if entry is not None}

    def read(self, key: str) -> Any:
        """Return one result.

        Raises
        ------
        DataError
            If there is none.
        """
        found = self.find([key])
        if not found:
            raise DataError(f"The store {self.folder} holds no cell {key!r}.")
        return found[key]

    def write(self, key: str, result: Any) -> None:
        """Keep a result."""
        content = pickle.dumps((key, result), protocol=pickle.HIGHEST_PROTOCOL)
        self.folder.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=self.folder, suffix=".part")
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(hashlib.sha256(content).digest())
                file.write(content)
                file.flush()
                os.fsync(file.fileno())
            os.replace(name, self.path(key))
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise

    def keys(self) -> Iterator[str]:
        """Yield the names of all intact results."""
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            entry = self._entry(path)
            if entry is not None:
                yield entry[0]

    @staticmethod
    def _entry(path: Path) -> tuple[str, Any] | None:
        """Name and result in a file; None where it is missing or torn."""
        try:
            content = path.read_bytes()
        except FileNotFoundError:
            return None
        digest, body = content[:32], content[32:]
        if hashlib.sha256(body).digest() != digest:
            return None
        key, result = pickle.loads(body)
        return key, result
