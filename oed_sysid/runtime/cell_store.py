"""Finished calculations on disk, one file each.

Safe against several writers (a file appears whole or not at all, and equal
cells have equal results), against torn files, and against files from elsewhere:
results are pickled, and to read a pickle is to run it, so a digest made with the
user's secret key (:func:`oed_sysid.runtime.files.secret_key`) heads every file. What does
not fit it is never unpickled; it is calculated again.
"""

from __future__ import annotations

import hashlib
import hmac
import pickle
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oed_sysid.errors import DataError
from oed_sysid.runtime.files import secret_key, write_bytes

_SUFFIX = ".cell"


@dataclass(frozen=True)
class CellStore:
    """A folder of results by name.

    Only results that this user's processes wrote are read back; to carry a store to
    another machine, carry the key of the private cache as well.

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
        write_bytes(self.path(key), sealed(content))

    def keys(self) -> Iterator[str]:
        """Yield the names of all intact results."""
        for path in sorted(self.folder.glob(f"*{_SUFFIX}")):
            entry = self._entry(path)
            if entry is not None:
                yield entry[0]

    @staticmethod
    def _entry(path: Path) -> tuple[str, Any] | None:
        """Name and result in a file; None where it is missing, torn or not from this user."""
        try:
            body = unsealed(path.read_bytes())
        except OSError:
            return None
        if body is None:
            return None
        try:
            key, result = pickle.loads(body)
        except Exception:  # a class that has since been renamed or changed
            return None
        return key, result


def sealed(body: bytes) -> bytes:
    """A body and, in front of it, the digest that says who wrote it.

    >>> unsealed(sealed(b"result"))
    b'result'
    """
    return _digest(body) + body


def unsealed(content: bytes) -> bytes | None:
    """The body that this user sealed; None of what is torn or of another writer.

    >>> unsealed(b"planted") is None
    True
    """
    digest, body = content[:32], content[32:]
    return body if hmac.compare_digest(_digest(body), digest) else None


def _digest(content: bytes) -> bytes:
    """Digest that only who knows the user's key can make."""
    return hmac.new(secret_key(), content, hashlib.sha256).digest()
