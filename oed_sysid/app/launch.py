"""Start the application: one local server, no telemetry, nothing fetched."""

from __future__ import annotations

import os
import secrets
import socket
import tempfile
import threading
import time
import webbrowser
from contextlib import suppress
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from oed_sysid import OedSysidError, load_problem
from oed_sysid.app.trust import SECRET
from oed_sysid.runtime.tables import tables

_SCRIPT = Path(__file__).with_name("frame.py")


def orders(problem: str | None = None, *, port: int = 8501) -> list[str]:
    """Return what ``streamlit`` is told to do.

    Parameters
    ----------
    problem : str, optional
        Problem to begin with: a shipped name or a folder.
    port : int
        Port of this computer; the server answers nobody else.

    Raises
    ------
    OedSysidError
        If the port or the problem cannot be, or streamlit is not installed.
    """
    if not 1024 <= port <= 65535:
        raise OedSysidError(f"The port is {port}. Give one from 1024 to 65535, such as 8501.")
    if find_spec("streamlit") is None:
        raise OedSysidError(
            "The application needs the library streamlit, which is not installed. Install it with: "
            'pip install "oed_sysid[app]"'
        )
    if problem is not None:
        load_problem(problem)  # said here, before a browser opens, if it cannot be
    table = tables(__file__, "server")
    options = [f"--{name}={value}" for name, value in {**table, "server.port": port}.items()]
    given = [] if problem is None else ["--", problem]
    return ["run", str(_SCRIPT), *options, *given]


def start(problem: str | None = None, *, port: int = 8501, browser: bool = True) -> None:
    """Run the server in this process until it is interrupted.

    Every user of this computer can reach its ports, so that the address carries a secret.

    Parameters
    ----------
    problem, port
        As for :func:`orders`.
    browser : bool
        Whether to open a browser.

    Raises
    ------
    OedSysidError
        As :func:`orders`, or if another program holds the port.
    """
    given = orders(problem, port=port)
    with socket.socket() as free:
        free.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            free.bind(("localhost", port))
        except OSError:
            raise OedSysidError(
                f"Port {port} is taken by another program, perhaps by this application in another "
                f"terminal. Take another one: oed-sysid app --port {port + 1}"
            ) from None

    from streamlit.web.cli import main

    secret = secrets.token_urlsafe(24)
    os.environ[SECRET] = secret
    address = f"http://localhost:{port}/?key={secret}"
    print(f"Open {address}", flush=True)
    # What the first page needs is read while server and browser start.
    threading.Thread(target=import_module, args=("oed_sysid.app.frame",), daemon=True).start()
    if browser:
        threading.Thread(target=_open, args=(address, port), daemon=True).start()
    main(given, prog_name="streamlit", standalone_mode=False)


def _open(address: str, port: int) -> None:
    """Open a browser once the server answers.

    By way of a file that only the user can read: command lines can be read by everybody.
    """
    for _ in range(300):
        with suppress(OSError), socket.create_connection(("localhost", port), timeout=0.2):
            break
        time.sleep(0.1)
    handle, name = tempfile.mkstemp(prefix="oed_sysid-", suffix=".html")
    with os.fdopen(handle, "w", encoding="utf-8") as file:
        file.write(f'<meta http-equiv="refresh" content="0; url={address}">')
    webbrowser.open(Path(name).as_uri())
    time.sleep(20.0)
    Path(name).unlink(missing_ok=True)
