"""Whom the page obeys: whose problem files are run, and who may ask it for anything.

A ``problem.py`` is a program. Those that come with the package and the one named when the
application was started are run; any other only after the user of the session has agreed. The
agreement is to a folder where nobody else can write to it, otherwise to its present content.

Every program and every user of this computer can reach a port of it. A secret in the address
tells the browser that this user opened from all others.
"""

from __future__ import annotations

import hashlib
import hmac
import os
from collections.abc import Mapping
from pathlib import Path

from oed_sysid import OedSysidError, list_problems
from oed_sysid.experiments.catalogue import catalogue_folder
from oed_sysid.runtime.files import private

# The secret of this run, from who starts the server to the script that it executes.
SECRET = "OED_SYSID_APP_SECRET"
# Uploads of one session, together.
MOST_BYTES = 400 * 1024**2


class NotTrustedError(OedSysidError):
    """A problem's file is not run before the user agrees."""


def folder_of(source: str) -> Path:
    """Folder of a shipped problem or of the user's own."""
    shipped = catalogue_folder()
    if shipped is not None and source in list_problems():
        return shipped / source
    own = Path(source).expanduser()
    return own.parent if own.is_file() else own


def code_of(source: str) -> dict[Path, str]:
    """Files of a folder that would be run, with their text; empty for a shipped problem.

    Parameters
    ----------
    source : str
        Shipped name, folder, or ``problem.py`` itself.
    """
    place, folder = Path(source).expanduser(), folder_of(source)
    if source in list_problems() or not (place.is_file() or (folder / "problem.py").is_file()):
        return {}
    files = [one for form in ("*.py", "*/*.py") for one in sorted(folder.glob(form))[:1000]]
    return {path: path.read_text(encoding="utf-8", errors="replace") for path in files}


def consent(source: str) -> str:
    """What an agreement is about: the folder, or the folder as it is now."""
    folder = Path(source).expanduser().resolve()
    if private(folder):
        return str(folder)
    digest = hashlib.sha256(str(folder).encode())
    for path, text in code_of(source).items():
        digest.update(f"{path}\0{text}\0".encode())
    return digest.hexdigest()


def check_trusted(source: str, agreed: Mapping[str, bool]) -> None:
    """Raise :class:`NotTrustedError` unless a problem may be run.

    Parameters
    ----------
    source : str
        Shipped name or folder.
    agreed : mapping
        Agreements of this session, from :func:`consent`.
    """
    if code_of(source) and not agreed.get(consent(source)):
        raise NotTrustedError(
            f"{source} holds a program, problem.py, which is run when the problem is opened. Agree "
            "to that on the page Data, if you know where it comes from."
        )


def is_user(secret: str | None) -> bool:
    """Whether an address carries the secret of this run; without one, everybody's does."""
    wanted = os.environ.get(SECRET, "")
    return not wanted or hmac.compare_digest(wanted, secret or "")


def check_uploads(held: Mapping[str, bytes]) -> None:
    """Raise :class:`OedSysidError` if the files of a session are larger than they may be."""
    total = sum(map(len, held.values()))
    if total > MOST_BYTES:
        raise OedSysidError(
            f"There are {len(held)} files with {total / 1e6:.0f} MB; the page takes up to "
            f"{MOST_BYTES / 1e6:.0f} MB together. Use the command line, or leave some out."
        )
