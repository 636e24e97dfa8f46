"""A folder to begin with: a small problem that works, to be changed into the user's own.

Each template is a ``problem.py`` as text; example data is simulated from the truth that it
states. From a log, the template is filled with channels and units from its header and a linear
model from its numbers: every measured signal answers linearly to the signals that are rates or
angles of the vehicle, and to the commands; angles, positions and depth follow from the kinematics
of a rigid body, and an angle without its rate, or positions without their speeds, bring these as
states which are not measured. A log with other names, or of another format, is read by
its numbers first (:mod:`~oed_sysid.data.recognise`). Start values come from least squares on
differences, and are no more than that.
"""

from __future__ import annotations

import keyword
import re
import shlex
import shutil
import tempfile
import tomllib
import warnings
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property
from importlib.resources import files
from pathlib import Path
from string import Template
from textwrap import indent

import numpy as np

from oed_sysid.data.dataset import write_csv
from oed_sysid.data.formats import clock_of
from oed_sysid.data.frames import is_time
from oed_sysid.data.logs import Log, LogMapping, Series, Source, draft, import_log, open_log
from oed_sysid.data.recognise import RATES
from oed_sysid.errors import (
    DataError,
    FileError,
    ProblemError,
    UnitWarning,
    listed,
    located,
)
from oed_sysid.experiments import SAYS
from oed_sysid.experiments.catalogue import FILE, load_problem
from oed_sysid.experiments.simulation import simulate
from oed_sysid.runtime.files import make_folder, write_text
from oed_sysid.text.csv_table import read_table
from oed_sysid.text.expressions import CONSTANTS, FUNCTIONS
from oed_sysid.text.typeset import safe
from oed_sysid.text.units import parse_header, to_si

_COMMAND = re.compile(
    r"rudder|delta|fin|plane|elevator|aileron|thrust|throttle|rpm|prop|cmd|command|servo|pwm|"
    r"sail|sheet|motor|torque|voltage|current_a|^n$|^n_|^d[rse]$",
    re.IGNORECASE,
)
# Kinematics of a rigid body: forms of each equation, the fullest first.
_EQUATIONS: dict[str, list[tuple[str, str]]] = tomllib.loads(
    files("oed_sysid.data").joinpath("kinematics.toml").read_text("utf-8")
)["equations"]
_TAKEN = {*CONSTANTS, *FUNCTIONS, "t", "h", "dot", "force"}


_FILES = files("oed_sysid.experiments").joinpath("starter_files")
# What each template is, the columns of its data, the run to judge by and what is hidden.
TEMPLATES: dict[str, dict[str, str]] = tomllib.loads(
    _FILES.joinpath("templates.toml").read_text("utf-8")
)


def new_problem(
    folder: str | Path,
    *,
    template: str = "generic",
    log: str | Path | None = None,
    inputs: Sequence[str] = (),
) -> Path:
    """Write a starter folder: ``problem.py``, ``README.md`` and example data.

    Parameters
    ----------
    folder : str or Path
        Where to; its last part becomes the problem's name. It must not exist,
        or be empty.
    template : str
        What kind of vehicle: ``generic`` (a heading that answers to a rudder), ``ship``,
        ``auv``, ``usv``, ``torpedo`` or ``sailboat``.
    log : str or Path, optional
        A log of any format: channels, units and a first linear model are taken from it, and
        its records are put into the folder; no template is used.
    inputs : sequence of str
        With a log, fields that are commands, ``"thruster [N]"`` where the log states no unit; by
        default those whose names say so.

    Returns
    -------
    Path
        The folder.

    Raises
    ------
    ProblemError
        If the folder is in use or cannot be written, or the template is not known.
    DataError
        If the log cannot be read.

    Examples
    --------
    >>> import tempfile
    >>> from oed_sysid.experiments.problem import load_problem
    >>> with tempfile.TemporaryDirectory() as place:
    ...     made = new_problem(Path(place) / "my_ship")
    ...     problem = load_problem(made)
    ...     print(problem.name, problem.data().names)
    my_ship ('turning_circle', 'zigzag_10_10', 'zigzag_20_20')
    """
    place = Path(folder).expanduser()
    name = _identifier(place.resolve().name)
    if place.exists() and (not place.is_dir() or any(place.iterdir())):
        raise ProblemError(SAYS["folder_exists"].format(place=place))
    located(ProblemError, "This package has no template", [template], TEMPLATES)
    words = {
        "name": name,
        "title": name.replace("_", " ").capitalize(),
        "folder": shlex.quote(place.as_posix()),
    }
    is_new = not place.exists()
    try:
        make_folder(place)
        # Made inside, hidden, and moved when all of it is there.
        with tempfile.TemporaryDirectory(dir=place, prefix=".") as made:
            if log is not None:
                write_from_log(Path(made), Path(log), tuple(inputs), words)
            else:
                _write_template(Path(made), template, words)
            for entry in sorted(Path(made).iterdir()):
                entry.rename(place / entry.name)
    except BaseException as error:
        if is_new:
            with suppress(OSError):
                place.rmdir()
        if isinstance(error, FileError):
            raise ProblemError(str(error)) from None
        if isinstance(error, OSError):
            raise ProblemError(f"{place} cannot be written: {error}") from None
        raise
    return place


def _write_template(place: Path, template: str, words: dict[str, str]) -> None:
    """Write the files of a template, and example data simulated from its truth."""
    kind = TEMPLATES[template]
    write_text(place / FILE, _filled_template(template, words))
    problem = load_problem(place / FILE)
    runs = [run for run in problem.experiments if run != kind.get("test")]
    words = words | kind | {"train": " ".join(f"{words['folder']}/data/{r}.csv" for r in runs)}
    write_text(place / "README.md", _filled_template("readme" if kind else "generic_readme", words))
    rng = np.random.default_rng(20240229)  # example data is the same wherever it is made
    true = problem.true_model()
    for experiment in problem.experiments.values():
        record = simulate(true, experiment, rng=rng)
        write_csv(record, place / "data" / f"{record.name}.csv")


def _filled_template(name: str, words: dict[str, str]) -> str:
    """Text of a starter file with its words filled in."""
    return Template(_FILES.joinpath(f"{name}.txt").read_text("utf-8")).substitute(words)


def _identifier(text: str) -> str:
    """Turn a folder's name into a problem's name.

    >>> _identifier("my ship-2"), _identifier("2nd")
    ('my_ship_2', 'problem_2nd')
    """
    name = re.sub(r"\W+", "_", text).strip("_") or "problem"
    return name if name[0].isalpha() else f"problem_{name}"


# -- from a log -------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class _Signal:
    """One column of the log in SI."""

    name: str
    column: str
    unit: str
    values: np.ndarray

    def declared(self, kind: str, extra: str = "") -> str:
        column = "" if self.column == self.name else f", column={self.column!r}"
        return f'{kind}("{self.name}", "{self.unit}"{column}{extra}),'


def write_from_log(place: Path, log: Path, inputs: tuple[str, ...], words: dict[str, str]) -> None:
    """Write a problem folder around a log.

    Parameters
    ----------
    place : Path
        The folder to make.
    log : Path
        Any log.
    inputs : tuple of str
        Fields that are commands, with a unit where the log states none; empty lets names decide.
    words : dict of str to str
        ``name``, ``title`` and ``folder`` of the problem.
    """
    told = _told(log, place, inputs)
    given, log, inputs = log, *(told or (log, inputs))
    times, signals, without = _signals(log)
    if without:
        lost = f"{log.name}: left out for want of a unit: {', '.join(without)}."
        warnings.warn(lost, UnitWarning, stacklevel=3)
    commands = _commands(log, signals, inputs)
    if not (measured := [s for s in signals if s not in commands]):
        raise ProblemError(f"All columns of {log.name} are commands; at least one is an output.")
    parts = _Log(times, commands, measured).parts() | {"log": safe(given.name)}
    code = _filled_template("from_log", words | parts)
    make_folder(place / "data")
    if told is None:
        shutil.copyfile(log, place / "data" / f"{log.stem}.csv")
    write_text(place / FILE, code)
    listed = {
        "log": given.name,
        "stem": log.stem,
        "signals": ", ".join(f"`{s.name}` [{s.unit}]" for s in (*commands, *measured)),
        "commands": ", ".join(s.name for s in commands) or "none",
    }
    write_text(place / "README.md", _filled_template("from_log_readme", words | listed))


def _told(log: Path, place: Path, inputs: tuple[str, ...]) -> tuple[Path, tuple[str, ...]] | None:
    """Records of a log by what its numbers tell, with the mapping beside them, and the commands.

    None where it is a table with names and units that are used as they are.
    """
    names = set[str]()
    with suppress(DataError):
        names = {name for one in _signals(log)[1] for name in (one.name, one.column)}
    usual = {*_EQUATIONS, *RATES.values()}
    if names >= {*inputs} if names and inputs else names & usual:
        return None
    opened = open_log(log)
    mapping = _commanded(draft(opened), opened, inputs)
    if mapping is None and names:
        return None
    if mapping is None:
        raise ProblemError(SAYS["no_commands_told"].format(log=log, names=listed(opened.names)))
    data = place / "data"
    make_folder(data)
    (record,) = import_log(opened, mapping).dataset
    target = data / f"{log.stem}.csv"
    write_csv(record, target)
    mapping.write(data / "mapping.toml")
    return target, tuple(mapping.inputs)


def _commanded(mapping: LogMapping | None, log: Log, inputs: tuple[str, ...]) -> LogMapping | None:
    """The mapping with the fields that are commands, by name; None without inputs or outputs."""
    if mapping is None:
        return None
    if not inputs:
        return mapping if mapping.inputs else None
    fields = {key: one for one in log.series for key in _names_of(one.name)}
    chosen = dict(_command(text, log.path.name, fields, mapping) for text in inputs)
    used = {one.field for one in chosen.values()}
    outputs = {name: one for name, one in mapping.outputs.items() if one.field not in used}
    return replace(mapping, inputs=chosen, outputs=outputs)


def _command(
    text: str, log: str, fields: Mapping[str, Series], mapping: LogMapping
) -> tuple[str, Source]:
    """Name and source of a command that was named, with its unit where the log states none."""
    name, said = (text, None) if text in fields else parse_header(text)
    located(ProblemError, f"{log} has no field called", [name], fields)
    field = fields[name]
    told = next((one for one in mapping.inputs.items() if one[1].field == field.name), None)
    if told is not None:
        return told[0], replace(told[1], unit=said or told[1].unit)
    if unit := said or field.unit:
        return _column_name(parse_header(name)[0], []), Source(field.name, unit=unit)
    raise ProblemError(f"{text!r} has no unit in {log}. Say it with the name, as '{text} [N]'.")


def _names_of(field: str) -> set[str]:
    """What a field may be called: with its topic, without it, and without its unit."""
    header = field.partition(".")[2]
    return {field, header, parse_header(header)[0]}


def _signals(log: Path) -> tuple[np.ndarray, list[_Signal], list[str]]:
    """Times ``(n_times,)`` in s of a table, its columns with a unit, and headers without one."""
    table = read_table(log)
    columns = dict(zip(table.headers, table.values.T, strict=True))
    clock = next(filter(is_time, columns), None) or clock_of(columns)
    if clock is None:
        raise DataError(f"{log.name} has no time column. Call it 't [s]'.")
    times = to_si(columns.pop(clock), parse_header(clock)[1] or "s")[0]
    found: list[_Signal] = []
    without: list[str] = []
    for header, column in columns.items():
        name, unit = parse_header(header)
        if unit is None:
            without.append(header)
        elif np.isfinite(column).sum() > 2:
            values, si = to_si(column, unit)
            found.append(_Signal(_column_name(name, found), name, si, values))
    if without and not found:
        raise DataError(
            f"{log.name} has no units: {', '.join(without)}. Write them as '{without[0]} [deg]'."
        )
    return times, found, without


def _column_name(name: str, before: list[_Signal]) -> str:
    """Name of a column as an identifier that nothing else has."""
    text = re.sub(r"\W+", "_", name).strip("_") or "signal"
    text = text if text[0].isalpha() else f"s_{text}"
    taken = {signal.name for signal in before} | _TAKEN
    while text in taken or keyword.iskeyword(text):
        text += "_"
    return text


def _commands(log: Path, signals: list[_Signal], inputs: tuple[str, ...]) -> list[_Signal]:
    if inputs:
        known = {s.column: s for s in signals} | {s.name: s for s in signals}
        located(ProblemError, f"{log.name} has no column with a unit called", inputs, known)
        return [known[name] for name in inputs]
    found = [s for s in signals if _COMMAND.search(s.name) and np.isfinite(s.values).all()]
    if not found:
        raise ProblemError(
            f"No column of {log.name} looks like a command: "
            f"{', '.join(s.column for s in signals)}. Name them with inputs=(...), or "
            "--input on the command line."
        )
    return found


def _without_gaps(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A signal without gaps, for start values only."""
    good = np.isfinite(values)
    return np.interp(times, times[good], values[good])


@dataclass(frozen=True, eq=False)
class _Log:
    """What was commanded and measured, and the linear model that is written from it."""

    times: np.ndarray
    commands: list[_Signal]
    measured: list[_Signal]

    @cached_property
    def hidden(self) -> list[_Signal]:
        """Rates and velocities that are not measured, as angles and positions change."""
        names = [s.name for s in self.measured]
        found = self.velocities()
        for angle in (s for s in self.measured if s.name in RATES and s.unit == "rad"):
            if (rate := RATES[angle.name]) not in names:
                values = np.gradient(_without_gaps(self.times, angle.values), self.times)
                found.append(_Signal(rate, rate, "rad/s", values))
        return found

    def velocities(self) -> list[_Signal]:
        """Ahead and abeam, where the positions and the heading are measured without them."""
        signals = {s.name: _without_gaps(self.times, s.values) for s in self.measured}
        if not signals.keys() >= {"x", "y", "psi"}:
            return []
        north, east = (np.gradient(signals[name], self.times) for name in "xy")
        cos, sin = np.cos(signals["psi"]), np.sin(signals["psi"])
        ways = {"u": north * cos + east * sin, "v": east * cos - north * sin}
        return [_Signal(n, n, "m/s", way) for n, way in ways.items() if n not in signals]

    @cached_property
    def states(self) -> list[_Signal]:
        """What is measured, and the rates that are not."""
        return [*self.measured, *self.hidden]

    @cached_property
    def integral(self) -> dict[str, str]:
        """Angles and positions with the kinematics that they follow from."""
        names = {s.name for s in self.states}
        forms = {
            name: next((text for need, text in _EQUATIONS[name] if names >= {*need.split()}), "")
            for name in names & _EQUATIONS.keys()
        }
        return {s.name: forms[s.name] for s in self.states if forms.get(s.name)}

    @cached_property
    def acting(self) -> list[_Signal]:
        """What acts on the motion: all but positions and headings."""
        alone = len(self.states) == 1
        return [s for s in self.states if alone or s.name not in ("x", "y", "z", "psi")]

    @cached_property
    def moving(self) -> list[_Signal]:
        """Commands that change: of one held all the time no log tells what it does."""
        return [s for s in self.commands if f"{s.values.min():.4g}" != f"{s.values.max():.4g}"]

    @cached_property
    def scales(self) -> dict[str, float]:
        """Size of every measured signal."""
        spreads = ((s.name, np.std(_without_gaps(self.times, s.values))) for s in self.states)
        return {name: float(spread) or 1.0 for name, spread in spreads}

    def parts(self) -> dict[str, str]:
        """What the template of a first model is filled with."""
        kinematics = {name: f'"{name}": "{text}",' for name, text in self.integral.items()}
        parameters: list[str] = []
        for signal in self.states:
            if signal.name not in self.integral:
                kinematics[signal.name], own = self.linear_rate(signal)
                parameters += own
        step = float(np.median(np.diff(self.times)))
        states = ((s.name, s.unit, self.scales[s.name]) for s in self.states)
        ranges = ((s.name, np.min(s.values), np.max(s.values)) for s in self.moving)
        lists = {
            "states": [f'State("{n}", "{unit}", scale={size:.3g}),' for n, unit, size in states],
            "inputs": [s.declared("Input") for s in self.commands],
            "outputs": [s.declared("Output") for s in self.measured],
            "kinematics": [kinematics[s.name] for s in self.states],
            "parameters": parameters,
            "effects": self.candidates(5 * step),
            "limits": [f'"{n}": ({low:.4g}, {high:.4g}),' for n, low, high in ranges],
        }
        indents = {"effects": 4, "limits": 12}
        text = {
            name: indent("\n".join(lines), " " * indents.get(name, 8))
            for name, lines in lists.items()
        }
        return text | {"step": f"{step:.4g}"}

    def candidates(self, lag: float) -> list[str]:
        """Quadratic damping of every motion, and a lag of every command."""
        found = [
            f'Force("{s.name}_quadratic", {{"{s.name}": "-E_{s.name}*{s.name}*abs({s.name})"}}, '
            f'(Parameter("E_{s.name}", 0.0, scale={0.1 / self.scales[s.name]:.3g}),),\n'
            f'    description="damping that grows with {s.name}"),'
            for s in self.acting
            if s.name not in self.integral
        ]
        names = [s.name for s in self.moving]
        return found + [f'actuator_lag("{n}_lag", "{n}", scale={lag:.3g}),' for n in names]

    def linear_rate(self, signal: _Signal) -> tuple[str, list[str]]:
        """Rate linear in what acts on it, and parameters by regularised least squares."""
        times, factors = self.times, [*self.acting, *self.moving]
        columns = np.column_stack([_without_gaps(times, s.values) for s in factors])
        means, sizes = columns.mean(axis=0), columns.std(axis=0)
        sizes[sizes == 0.0] = 1.0
        rows = np.column_stack([(columns - means) / sizes, np.ones(len(times))])
        rate = np.gradient(_without_gaps(times, signal.values), times)
        scale = self.scales[signal.name]
        ridge = 1e-3 * len(times) * np.eye(rows.shape[1])
        slope = np.linalg.solve(rows.T @ rows + ridge, rows.T @ rate)
        terms, parameters = [], []
        for factor, size, value in zip(factors, sizes, slope[:-1], strict=True):
            unit = scale / (size * float(np.ptp(times)) / len(times) * 20)
            terms.append(f"{signal.name}_{factor.name}*{factor.name}")
            parameters.append(
                f'Parameter("{signal.name}_{factor.name}", {value / size:.4g}, '
                f"scale={max(abs(unit), 1e-9):.3g}),"
            )
        constant = slope[-1] - float(np.sum(slope[:-1] * means / sizes))
        parameters.append(f'Parameter("{signal.name}_0", {constant:.4g}, scale={scale:.3g}),')
        return f'"{signal.name}": "{" + ".join([*terms, f"{signal.name}_0"])}",', parameters
