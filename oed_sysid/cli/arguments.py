"""Command lines with several values after one option: ``--train a.csv b.csv``.

The shell expands ``--train runs/*.csv`` to such a line, while the parser below
expects the option in front of each value. This module puts it there.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence


def spread(arguments: Sequence[str], options: Iterable[str]) -> list[str]:
    """Repeat each option before every value that follows it.

    Parameters
    ----------
    arguments : sequence of str
        The command line after the program's name.
    options : iterable of str
        Options that take one or more values.

    Returns
    -------
    list of str
        ``--train a b`` becomes ``--train a --train b``; what comes before the
        first option, other options and what follows ``--`` stay as they are.

    Examples
    --------
    >>> spread(["fit", "ship", "--train", "a.csv", "b.csv", "--json", "out"], ["--train"])
    ['fit', 'ship', '--train', 'a.csv', '--train', 'b.csv', '--json', 'out']
    """
    several = set(options)
    result: list[str] = []
    option, n_values = "", 0
    for position, argument in enumerate(arguments):
        if argument == "--":
            return result + list(arguments[position:])
        if argument in several:
            # An option without a value stays alone, for the parser to complain about.
            result.append(argument)
            option, n_values = argument, 0
        elif argument.startswith("-") and len(argument) > 1:
            result.append(argument)
            option = ""
        else:
            if option and n_values:
                result.append(option)
            result.append(argument)
            n_values += 1
    return result
