"""What long calculations have finished on disk, so that the next call goes on from there.

A calculation that always takes the same steps from the same content writes what each
step returned as soon as it is done. Killed, interrupted or out of disk space, it is
called again: steps that are there are read, the rest is calculated. The result is the same
to the last bit, because a step is only ever read as it was written, with the state of the
random numbers after it.

Steps lie in a folder named by a digest of everything that shapes them: content as the
caller states it, the text of this package, and the versions of what it calculates with.
They are pickles under the key of the user; what others wrote is never read.

Calculations that do not depend on each other lie in a :class:`CellStore` by name. It is safe
against several writers (a file appears whole or not at all, and equal cells have equal results),
against torn files, and against files from elsewhere: to read a pickle is to run it, so a digest
made with the user's secret key (:func:`oed_sysid.runtime.files.secret_key`) heads every file. What
does not fit it is never unpickled; it is calculated again.
"""

from __future__ import annotations

import hashlib
import hmac
import io
import json
import pickle
import platform
import secrets
import shutil
import signal
import threading
import time
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields, is_dataclass, replace
from datetime import timedelta
from functools import lru_cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from oed_sysid.errors import DataError, FileError
from oed_sysid.runtime.constants import NEGLIGIBLE
from oed_sysid.runtime.files import private_cache, secret_key, write_bytes, write_text

Result = TypeVar("Result")

_ENDINGS = ".step", ".state"  # of finished steps, and of the one in work


class Journal:
    """A folder that keeps the finished steps of one calculation.

    Parameters
    ----------
    folder : path, optional
        Where; a folder for each calculation is made in it. None keeps nothing.
    fresh : bool
        Forget what an earlier call has kept.
    tell : callable, optional
        Told in words if the calculation goes on from an earlier one.

    Examples
    --------
    >>> import tempfile
    >>> def measure(folder):
    ...     journal = Journal(folder)
    ...     journal.open({"task": "doctest"})
    ...     return journal.once("a long step", lambda: np.random.default_rng().random())
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     measure(folder) == measure(folder)
    True
    """

    def __init__(
        self,
        folder: str | Path | None = None,
        *,
        fresh: bool = False,
        tell: Callable[[str], None] | None = None,
    ) -> None:
        self.folder = None if folder is None else Path(folder)
        self.n_read = 0
        self._fresh, self._tell = fresh, tell
        self._count = 0
        self._stores: tuple[CellStore, ...] = ()
        self._last, self._took = -np.inf, 0.0

    def open(self, content: Any, *, shared: Mapping[str, Any] | None = None) -> None:
        """Begin a calculation.

        Parameters
        ----------
        content : plain data
            All that shapes the results, as JSON can hold it.
        shared : mapping of str to object, optional
            What the caller has anyway (records, say) and steps refer to: it is not
            written with every step.
        """
        self._count, self.n_read = 0, 0
        if self.folder is None:
            return
        text = json.dumps(content, sort_keys=True, default=str)
        digest = hashlib.sha256(f"{package_digest()}\n{text}".encode()).hexdigest()[:20]
        store = CellStore(self.folder / digest)
        self._stores = tuple(replace(store, ending=ending) for ending in _ENDINGS)
        for name, value in (shared or {}).items():
            self._share(name, value)
        if self._fresh:
            self.close()
        self._sweep()
        kept = self.n_steps
        if kept and self._tell is not None:
            steps = "step" if kept == 1 else "steps"
            self._tell(f"Going on after {kept} {steps} of an earlier call, kept in {self.place}.")

    @property
    def place(self) -> Path | None:
        """Folder of the calculation; None where nothing is kept."""
        return self._stores[0].folder if self._stores else None

    @property
    def n_steps(self) -> int:
        """Number of steps that are kept now, an unfinished one with its state included."""
        return sum(len([*one.folder.glob(f"*{one.ending}")]) for one in self._stores)

    def once(
        self, label: str, work: Callable[[], Result], *, rng: np.random.Generator | None = None
    ) -> Result:
        """Return what a step returned in an earlier call, or do it and keep it.

        Parameters
        ----------
        label : str
            What the step does. Steps are told apart by label and order.
        work : callable
            Does it. It is done once more if it was cut short by Ctrl-C, also where an
            estimator answered that with the best it had.
        rng : numpy.random.Generator, optional
            Random numbers that the step draws; left as the step left them.

        Raises
        ------
        KeyboardInterrupt
            If the step was interrupted.
        """
        self._count += 1
        key = f"{self._count:03d} {label}"
        kept = self._read(key)
        if kept is None:
            with _to_the_end():
                result = work()
            with _to_the_end(at_once=False):
                self._write(key, (result, None if rng is None else rng.bit_generator.state))
                for unfinished in self._stores[1:]:
                    with suppress(OSError):
                        unfinished.path(self._key_of_work()).unlink(missing_ok=True)
        else:
            result, state = kept
            self.n_read += 1
            if rng is not None:
                rng.bit_generator.state = state
        self._share(key, result)
        return result

    # -- states of an unfinished step ------------------------------------------------

    def state(self) -> Any:
        """State that the step now in work had reached in an earlier call; None without one."""
        return self._read(self._key_of_work(), part=True)

    def keep(self, state: Any) -> None:
        """Keep the state of the step now in work, as often as that takes next to no time."""
        begun = time.monotonic()
        if self.place is None or NEGLIGIBLE * (begun - self._last) < self._took:
            return
        self._write(self._key_of_work(), state, part=True)
        self._last = time.monotonic()
        self._took = self._last - begun

    def _key_of_work(self) -> str:
        return f"{self._count:03d} state"

    # -- the end -----------------------------------------------------------------------

    def close(self) -> None:
        """Forget the steps: the calculation, and what was made of it, is done."""
        if self.place is None:
            return
        # All of them at once: a part of them would be done again.
        with suppress(OSError):
            self.place.rename(self.place.with_name(f".{self.place.name}{secrets.token_hex(4)}"))
        self._sweep()

    def _sweep(self) -> None:
        """Remove what a closed journal, also of a killed process, has left."""
        assert self.place is not None
        for other in self.place.parent.glob(f".{self.place.name}*"):
            shutil.rmtree(other, ignore_errors=True)

    # -- files ---------------------------------------------------------------------------

    def _read(self, key: str, *, part: bool = False) -> Any:
        return self._stores[part].find([key]).get(key) if self._stores else None

    def _write(self, key: str, content: Any, *, part: bool = False) -> None:
        if self.place is None:
            return
        try:
            if not self.place.is_dir():
                self._begin(self.place)
            self._stores[part].write(key, content)
        except (FileError, OSError, pickle.PicklingError, TypeError, AttributeError) as error:
            self._stores = ()
            warnings.warn(
                f"Finished steps are no longer kept, so an interruption will cost them: {error}",
                stacklevel=3,
            )

    def _begin(self, place: Path) -> None:
        """Make the folder, say what it is, and drop what was abandoned long ago."""
        write_text(
            place / "README.txt",
            "Finished steps of a calculation of oed_sysid that has not ended. The same call goes "
            "on from them.\nThis folder can be deleted.\n",
        )
        for other in place.parent.glob("*/README.txt"):
            with suppress(OSError):
                newest = max(path.stat().st_mtime for path in other.parent.iterdir())
                if time.time() - newest > timedelta(days=30).total_seconds():
                    shutil.rmtree(other.parent, ignore_errors=True)

    def _share(self, name: str, value: Any) -> None:
        """Let later steps refer to a result and to what it is made of."""
        for store in self._stores[:1]:  # both have the same names
            for path, part in _parts(name, value, depth=2):
                # The same object under two names keeps the first; names last as long as objects.
                store.names.setdefault(id(part), path)
                store.shared[path] = part


def opened(
    journal: Journal | None,
    task: str,
    content: Callable[[], Any],
    *,
    shared: Mapping[str, Any] | None = None,
) -> Journal:
    """Open a journal for one calculation.

    Parameters
    ----------
    journal : Journal or None
        None keeps nothing.
    task : str
        What is calculated.
    content : callable
        Returns all that shapes the results, as JSON can hold it; asked only where something
        is kept. Where it raises a :class:`DataError`, equality cannot be told: nothing is kept.
    shared : mapping of str to object, optional
        As of :meth:`Journal.open`.

    Returns
    -------
    Journal
        With steps of an earlier call with equal content, if there was one.
    """
    keep = journal or Journal()
    if keep.folder is None:
        return keep
    try:
        keep.open({"task": task, "content": content()}, shared=shared)
    except DataError:
        return Journal()
    return keep


def unfinished_folder() -> Path:
    """Folder in the user's cache for journals of commands.

    Returns
    -------
    Path
        It need not exist yet.
    """
    return private_cache() / "unfinished"


@lru_cache(maxsize=1)
def package_digest() -> str:
    """Digest of what steps are calculated with: this package's text, and its libraries."""
    digest = hashlib.sha256(platform.python_version().encode())
    for name in ("numpy", "scipy", "casadi"):
        with suppress(PackageNotFoundError):
            digest.update(f"{name} {version(name)}".encode())
    folder = Path(__file__).resolve().parents[1]
    for path in sorted(folder.rglob("*")):
        if path.suffix in (".py", ".c", ".toml"):
            digest.update(path.relative_to(folder).as_posix().encode())
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _parts(name: str, value: Any, *, depth: int) -> Iterator[tuple[str, Any]]:
    """Objects worth a name: dataclasses, what they hold, and the entries of tuples."""
    if isinstance(value, tuple | list):
        for index, entry in enumerate(value):
            yield from _parts(f"{name}[{index}]", entry, depth=depth)
    elif is_dataclass(value) and not isinstance(value, type):
        yield name, value
        if depth:
            for one in fields(value):
                yield from _parts(f"{name}.{one.name}", getattr(value, one.name), depth=depth - 1)
    elif hasattr(value, "__dict__") and not isinstance(value, type):
        yield name, value


@contextmanager
def _to_the_end(*, at_once: bool = True) -> Iterator[None]:
    """Raise at the end if Ctrl-C came on the way and was answered with less than the whole.

    Estimators keep their best point when they are interrupted; a step of a longer
    calculation must not go on with it. What must not be cut, being short, hears of it at the end.
    """
    before = signal.getsignal(signal.SIGINT)
    if threading.current_thread() is not threading.main_thread() or not callable(before):
        yield
        return
    came = False

    def note(number: int, frame: Any) -> None:
        nonlocal came
        came = True
        if at_once:
            before(number, frame)

    signal.signal(signal.SIGINT, note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if came:
        raise KeyboardInterrupt


# -- independent calculations -----------------------------------------------------------


@dataclass(frozen=True)
class CellStore:
    """A folder of results by name.

    Only results that this user's processes wrote are read back; to carry a store to
    another machine, carry the key of the private cache as well.

    Parameters
    ----------
    folder : Path
        Made when the first result is written.
    ending : str
        Of the files.
    names, shared : dict
        Objects that a reader has anyway: names by identity, and the objects by name, which alone
        are written in their place.
    pickler : class
        Writes results; that of cloudpickle takes functions of a problem's own file, too.
    """

    folder: Path
    ending: str = ".cell"
    names: dict[int, str] = field(default_factory=dict, repr=False)
    shared: dict[str, Any] = field(default_factory=dict, repr=False)
    pickler: Any = pickle.Pickler

    def path(self, key: str) -> Path:
        """File of one cell: names are free, file names are not."""
        return self.folder / f"{hashlib.sha256(key.encode()).hexdigest()[:32]}{self.ending}"

    def find(self, keys: Iterable[str]) -> dict[str, Any]:
        """Return the results that are there, of the cells that are asked for."""
        entries = {key: self._kept(key) for key in keys}
        return {key: entry[1] for key, entry in entries.items() if entry is not None}

    def write(self, key: str, result: Any) -> None:
        """Keep a result."""
        body = io.BytesIO()
        writer = self.pickler(body, protocol=pickle.HIGHEST_PROTOCOL)
        if self.names:
            writer.persistent_id = lambda one: self.names.get(id(one))
        writer.dump((key, result))
        write_bytes(self.path(key), sealed(body.getvalue()))

    def _kept(self, key: str) -> tuple[str, Any] | None:
        """Name and content of a cell; None where it is missing, torn or not from this user."""
        try:
            body = unsealed(self.path(key).read_bytes())
            reader = pickle.Unpickler(io.BytesIO(body or b""))
            reader.persistent_load = self.shared.__getitem__  # type: ignore[method-assign]
            return reader.load()
        except Exception:  # no file, a class that has since been changed, a part that has gone
            return None


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
