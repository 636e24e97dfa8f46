"""The command line ``oed-sysid``: thin commands over the public API.

==========  =============================================================
exit code   meaning
==========  =============================================================
0           done
1           ended without a usable result (a fit did not converge)
2           the command line, a file or a problem has to be corrected
3           an unexpected error: a fault of this program
4           the log is suspect: whatever was made of it is not to be used
130         interrupted
==========  =============================================================
"""

from __future__ import annotations

import signal
import sys
import traceback
import warnings
from collections.abc import Sequence

# The table above; 128 plus the number of the signal, as shells count.
DONE, NO_RESULT, BAD_INPUT, UNEXPECTED, SUSPECT = range(5)
INTERRUPTED = 128 + signal.SIGINT


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command and return its exit code.

    Every error of the package is said in words here, and only here.

    Parameters
    ----------
    arguments : sequence of str, optional
        The command line after the program's name; by default that of the process.
    """
    from oed_sysid.cli.application import app
    from oed_sysid.errors import OedSysidError

    given = list(sys.argv[1:] if arguments is None else arguments)
    with warnings.catch_warnings():
        warnings.showwarning = _say_warning
        try:
            # What was given is kept for results that say how they were made.
            app(args=given, prog_name="oed-sysid", obj=tuple(given))
        except SystemExit as end:
            # A reader that stopped, as `head` does, is no failure.
            closed = isinstance(end.__context__, BrokenPipeError)
            return DONE if closed else int(end.code or 0)
        except KeyboardInterrupt:
            print("Interrupted.", file=sys.stderr)
            return INTERRUPTED
        except Exception as error:
            if "--debug" in given:
                traceback.print_exc()
            known = isinstance(error, OedSysidError)
            said = f"Error: {error}" if known else (
                f"Unexpected error: {type(error).__name__}: {error}\nThis is a fault of the "
                "program. Repeat the command with --debug to see where, and report it."
            )  # fmt: skip
            print(said, file=sys.stderr)
            return BAD_INPUT if known else UNEXPECTED
    return DONE


def _say_warning(message: Warning | str, *_: object, **__: object) -> None:
    """Print a warning as a sentence, without file and line of this package."""
    from oed_sysid.cli.terminal import note
    from oed_sysid.errors import UnitWarning

    if isinstance(message, UnitWarning):  # so likely wrong that --quiet does not hide it
        print(f"Note: {message}", file=sys.stderr)
    # Of a trial step that overflowed, results say how it ended.
    elif not isinstance(message, RuntimeWarning):
        note(f"Note: {message}")
