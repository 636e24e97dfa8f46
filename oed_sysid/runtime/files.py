"""Files: written whole or not at all, and trusted only where nobody else can write.

A file is written beside its place under a name of its own, brought to the disk,
and then renamed: whoever looks finds the older file or the newer one, never a
part. A full disk, a missing permission or a killed process leave the older file
as it was.

What is executed from disk (compiled kernels, pickled results) has to come from
a :func:`private` place: one that belongs to the user or to the system's
administrator, like every folder above it, and that no one else can change.
"""

from __future__ import annotations

import atexit
import hashlib
import os
import secrets
import shutil
import stat
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from pathlib import Path

from oed_sysid.errors import DataError, FileError

# Of the key that signs cached code: that of SHA-256.
KEY_BYTES = hashlib.sha256().digest_size


@contextmanager
def whole_file(path: str | Path, *, ending: str | None = None) -> Iterator[Path]:
    """Give a name to write to; what was written appears under ``path`` at the end.

    Parameters
    ----------
    path : str or Path
        The file. Missing folders are made, a link is followed, and what is no
        regular file (``/dev/stdout``, a pipe) is written to directly.
    ending : str, optional
        Ending of the name to write to; by default that of the file.

    Yields
    ------
    Path
        A hidden name in the same folder.

    Raises
    ------
    FileError
        If the file cannot be written; the older one is untouched.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     place = Path(folder) / "runs" / "note.txt"
    ...     with whole_file(place) as part:
    ...         _ = part.write_text("all of it")
    ...         print(place.exists())
    ...     print(place.read_text())
    False
    all of it
    """
    target = Path(path)
    try:
        real = Path(os.path.realpath(target))
        if _is_stream(real):
            yield real
            return
        if words := _refusal(real):
            raise FileError(f"{str(target)!r} cannot be written: {words}")
        real.parent.mkdir(parents=True, exist_ok=True)
        ending = real.suffix if ending is None else ending
        part = real.with_name(f".{secrets.token_hex(8)}{ending}")
        try:
            # Made here, so that nobody's link of that name is followed and the user's mask holds.
            os.close(os.open(part, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666))
            if real.exists():
                shutil.copymode(real, part)
            yield part
            _to_disk(part)
            os.replace(part, real)
        finally:
            with suppress(OSError):
                part.unlink(missing_ok=True)
    except OSError as error:
        words = _obstacle(real.parent) or (
            f"{error.strerror or error}. Nothing was changed there. Make room, or give "
            "another place."
        )
        raise FileError(f"{str(target)!r} cannot be written: {words}") from error


def make_folder(folder: str | Path) -> Path:
    """Make a folder and those above it that are missing.

    Raises
    ------
    FileError
        If it cannot be made; the message says what stands in the way.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     print(make_folder(Path(folder) / "trial" / "sea").is_dir())
    True
    """
    place = Path(folder)
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        words = _obstacle(place) or f"{error.strerror or error}. Give another place."
        raise FileError(f"The folder {str(place)!r} cannot be made: {words}") from error
    return place


def check_place(path: str | Path, *, folder: bool = False) -> None:
    """Raise if a file, or files in a folder, could not be written; nothing is left behind.

    To be asked before a long calculation, whose result would have no place to go.

    Parameters
    ----------
    path : str or Path
        The file or folder; neither has to exist.
    folder : bool
        Whether it is a folder.

    Raises
    ------
    FileError
        The message says what stands in the way, and what to do.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as place:
    ...     note = Path(place) / "note"
    ...     _ = note.write_text("in the way")
    ...     check_place(note)
    ...     try:
    ...         check_place(note / "fit.json")
    ...     except FileError as error:
    ...         print(str(error).replace(os.path.realpath(place), "..."))
    '.../note/fit.json' cannot be written: '.../note' is a file where a folder is needed. Move it \
away, or give another place.
    """
    target = Path(path)
    real = Path(os.path.realpath(target))
    if not folder and _is_stream(real):
        return
    cannot = f"{str(target)!r} cannot be written: "
    home = real if folder else real.parent
    if words := ("" if folder else _refusal(real)) or _obstacle(home):
        raise FileError(cannot + words)
    try:  # What the permissions promise, a system of its own kind (/proc) need not keep.
        tempfile.TemporaryFile(dir=_nearest(home)).close()
    except OSError as error:
        reason = error.strerror or error
        raise FileError(
            f"{cannot}nothing can be made in {str(_nearest(home))!r} ({reason}). Give another "
            "place."
        ) from error


def _is_stream(real: Path) -> bool:
    """Whether something is written to as it is: a device or a pipe."""
    return real.exists() and not real.is_file() and not real.is_dir()


def _refusal(real: Path) -> str:
    """What keeps a file that is there from being replaced, and what to do; empty if nothing."""
    if real.is_dir():
        return "it is a folder. Give a file in it."
    # Renaming would get around the protection that the user gave the file.
    if real.exists() and not os.access(real, os.W_OK):
        return "it is write-protected. Give another place."
    return ""


def _nearest(folder: Path) -> Path:
    """The folder, or what stands in its place or the nearest above it."""
    return next((one for one in (folder, *folder.parents) if os.path.lexists(one)), folder)


def _obstacle(folder: Path) -> str:
    """What keeps a folder from being made or written to, and what to do; empty if unknown."""
    found = _nearest(folder)
    if not found.is_dir():
        if not found.is_file():
            return f"{str(found)!r} is no folder, and one is needed there. Give another place."
        return (
            f"{str(found)!r} is a file where a folder is needed. Move it away, or give another "
            "place."
        )
    if not os.access(found, os.W_OK | os.X_OK):
        return f"you have no permission to write in {str(found)!r}. Give another place."
    return ""


def _to_disk(path: Path) -> None:
    """Have the system write what it still holds in memory."""
    handle = os.open(path, os.O_RDONLY if os.name == "posix" else os.O_RDWR)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def write_bytes(path: str | Path, content: bytes) -> None:
    """Write a file whole or not at all; see :func:`whole_file`."""
    with whole_file(path, ending=".part") as part:
        part.write_bytes(content)


def write_text(path: str | Path, text: str) -> None:
    """Write a text as UTF-8 with its line ends as they are; see :func:`whole_file`."""
    # Names from outside may hold what is no text: it is written as \udc80, not refused.
    write_bytes(path, text.encode("utf-8", errors="backslashreplace"))


def check_file(path: str | Path) -> None:
    """Raise :class:`DataError` for what is no file that can be read."""
    if "\0" in str(path) or not Path(path).exists():
        raise DataError(f"There is no file {str(path)!r}. Check the path.")
    if Path(path).is_dir():
        raise DataError(f"{str(path)!r} is a folder. Give a file in it.")
    if not Path(path).is_file():
        raise DataError(
            f"{str(path)!r} is a device or a pipe, not a file. Copy it to a file first."
        )


def read_bytes(path: str | Path, most: int = -1) -> bytes:
    """Bytes of a file, all or the first of them.

    Raises
    ------
    DataError
        If there is no such file, or it cannot be read.
    """
    check_file(path)
    try:
        with Path(path).open("rb") as stream:
            return stream.read(most)
    except OSError as error:
        raise DataError(f"{path} cannot be read: {error.strerror or error}.") from None


# -- whom to trust ---------------------------------------------------------------------


def private(path: str | Path) -> bool:
    """Tell whether a file or folder can be changed by the user and by no one else.

    It and every folder above it have to belong to the user or to the system's
    administrator, and must not be writable by others. Above it, a folder with
    the sticky bit (``/tmp``) and the user's own group are allowed. Where the
    system knows no owners (Windows) the answer is yes.

    Examples
    --------
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     before = private(folder)
    ...     Path(folder).chmod(0o777)
    ...     print(before, private(folder))
    True False
    """
    if os.name != "posix":
        return True
    place = Path(os.path.realpath(path))
    try:
        if not _is_ours(place.stat(), strict=True):
            return False
        return all(_is_ours(parent.stat(), strict=False) for parent in place.parents)
    except OSError:
        return False


def _is_ours(found: os.stat_result, *, strict: bool) -> bool:
    if found.st_uid not in ((user(),) if strict else (user(), 0)):
        return False
    writable = stat.S_IMODE(found.st_mode) & (stat.S_IWGRP | stat.S_IWOTH)
    if not writable:
        return True
    if strict:
        return False
    return bool(found.st_mode & stat.S_ISVTX) or (
        writable == stat.S_IWGRP and _is_own_group(found.st_gid)
    )


def user() -> int:
    """Number of the user on whose behalf this process acts."""
    return os.geteuid() if hasattr(os, "geteuid") else 0


@lru_cache(maxsize=64)
def _is_own_group(group: int) -> bool:
    """Whether a group is the one that a system makes for each user alone."""
    try:
        import grp
        import pwd

        name = pwd.getpwuid(user()).pw_name
        entry = grp.getgrgid(group)
    except (ImportError, KeyError):
        return False
    return entry.gr_name == name and set(entry.gr_mem) <= {name}


def cache_folder() -> Path:
    """Folder that keeps compiled kernels: that of ``OED_SYSID_CACHE``, or one at home."""
    stated = os.environ.get("OED_SYSID_CACHE")
    return Path(stated) if stated else _home_cache()


def _home_cache() -> Path:
    try:
        return Path.home() / ".cache" / "oed_sysid"
    except RuntimeError:  # a user without a home
        return Path(tempfile.gettempdir()) / f"oed_sysid-{user()}"


def private_cache() -> Path:
    """Cache folder that nobody else can write to, made if it is missing.

    The stated one (:func:`cache_folder`); where others can write to it, the one
    at home, and where that is so too, one that lasts as long as this process.
    A warning says so.

    Raises
    ------
    OSError
        If the stated folder cannot be made.
    """
    stated = cache_folder()
    make_private(stated)
    if private(stated):
        return stated
    chosen = _private_instead()
    _say_not_private(str(stated), str(chosen))
    return chosen


def make_private(folder: Path) -> None:
    """Make a folder, and those above it that are missing, for the user alone."""
    for place in (*reversed(folder.parents), folder):
        if not place.exists():
            with suppress(FileExistsError):
                place.mkdir(mode=0o700)
    folder.mkdir(exist_ok=True)  # says it where a file stands in the way


@lru_cache(maxsize=1)
def _private_instead() -> Path:
    home = _home_cache()
    with suppress(OSError):
        make_private(home)
        if private(home):
            return home
    folder = Path(tempfile.mkdtemp(prefix="oed_sysid-"))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@lru_cache(maxsize=8)
def _say_not_private(stated: str, chosen: str) -> None:
    warnings.warn(
        f"Others can write to {stated} (or to a folder above it), so no code is loaded from there; "
        f"{chosen} is used. Protect it with chmod go-w, or name another with OED_SYSID_CACHE.",
        stacklevel=3,
    )


def secret_key() -> bytes:
    """Key of this user, with which what this package wrote can be told from anything else.

    Kept in ``key`` of the private cache, readable by the user only; made at
    first use. Where it cannot be kept, a new one is drawn for each process.

    Returns
    -------
    bytes
        32 random bytes.
    """
    return _key_in(str(cache_folder()), user())


@lru_cache(maxsize=8)
def _key_in(_stated: str, _user: int) -> bytes:
    try:
        folder = private_cache()
        place = folder / "key"
        if not _is_key(place):
            handle, name = tempfile.mkstemp(prefix=".", dir=folder)  # readable by the user only
            part = Path(name)
            try:
                with os.fdopen(handle, "wb") as file:
                    file.write(secrets.token_bytes(KEY_BYTES))
                _to_disk(part)
                if place.exists():  # one that cannot be trusted
                    os.replace(part, place)
                else:
                    with suppress(FileExistsError):  # another process was quicker: its key counts
                        os.link(part, place)
            finally:
                part.unlink(missing_ok=True)
        return place.read_bytes()
    except OSError as error:
        warnings.warn(
            f"No key can be kept in {cache_folder()} ({error.strerror or error}), so results that "
            "this process keeps are calculated anew by the next.",
            stacklevel=4,
        )
        return secrets.token_bytes(KEY_BYTES)


def _is_key(place: Path) -> bool:
    try:
        found = place.lstat()
    except OSError:
        return False
    mode = stat.S_IMODE(found.st_mode)
    own = os.name != "posix" or (found.st_uid == user() and not mode & 0o077)
    return stat.S_ISREG(found.st_mode) and own and found.st_size == KEY_BYTES
