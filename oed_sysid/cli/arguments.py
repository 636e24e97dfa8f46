"""Command lines with several values after one option: ``--train a.csv b.csv``.

The shell expands ``--train runs/*.csv`` to such a line, while the parser below
expects the option in front of each value. This module puts it there. It also turns limits
in words of the trade (``--max-fin 10``) into values of one option.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

# Words for one channel each, whatever its name in the model.
SIGNALS = {
    "pitch": "theta", "heel": "phi", "roll": "phi", "heading": "psi", "yaw": "psi",
    "depth": "z", "speed": "u", "surge": "u", "sway": "v", "heave": "w",
    "distance": "x", "advance": "x", "transfer": "y",
    "pitch-rate": "q", "roll-rate": "p", "yaw-rate": "r",
}  # fmt: skip


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


def limit_options(arguments: Sequence[str]) -> list[str]:
    """Rewrite ``--max-NAME VALUE``, ``--min-NAME VALUE`` as ``--limit`` of commands that plan.

    Examples
    --------
    >>> limit_options(["design", "my_auv", "--max-fin", "10", "--min-depth=80"])
    ['design', 'my_auv', '--limit', 'max:fin=10', '--limit', 'min:depth=80']
    """
    if not arguments or arguments[0] not in ("design", "programme", "campaign"):
        return list(arguments)
    result: list[str] = []
    rest = list(arguments)
    while rest:
        word = rest.pop(0)
        side, _, tail = word[2:].partition("-") if word.startswith("--") else ("", "", "")
        name, given, value = tail.partition("=")
        if word.startswith("--") and not tail and side.partition("=")[0] in SIGNALS:
            name, given, value = side.partition("=")
            side = ""
        elif side not in ("max", "min") or not name:
            result.append(word)
            continue
        if not given:
            value = rest.pop(0) if rest else ""
        result += ["--limit", f"{side}:{name}={value}" if side else f"{name}={value}"]
    return result
