"""A first problem from a log: channels and units from its header, a linear model from its numbers.

Every measured signal answers linearly to the signals that are rates or angles of the
vehicle, and to the commands; an angle whose rate is measured as well is its integral.
Start values come from least squares on differences, and are no more than that.
"""

from __future__ import annotations

import keyword
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from oed_sysid.data.csv_columns import TIME_NAMES
from oed_sysid.errors import DataError, ProblemError
from oed_sysid.experiments.catalogue import FILE
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
_INTEGRALS = {"psi": "r", "theta": "q", "phi": "p"}
_TAKEN = {*CONSTANTS, *FUNCTIONS, "t", "h", "dot", "force"}


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
        CSV file with units in its headers.
    inputs : tuple of str
        Columns that are commands; empty lets their names decide.
    words : dict of str to str
        ``name``, ``title`` and ``folder`` of the problem.
    """
    times, signals = _signals(log)
    commands = _commands(log, signals, inputs)
    measured = [s for s in signals if s not in commands]
    if not measured:
        raise ProblemError(f"All columns of {log.name} are commands; at least one is an output.")
    code = _problem(words, times, commands, measured, safe(log.name))
    make_folder(place / "data")
    shutil.copyfile(log, place / "data" / f"{log.stem}.csv")
    write_text(place / FILE, code)
    listed = ", ".join(f"`{s.name}` [{s.unit}]" for s in (*commands, *measured))
    write_text(
        place / "README.md",
        f"# {words['title']}\n\n"
        f"Written from `{log.name}`: {listed}. Commands: "
        f"{', '.join(s.name for s in commands) or 'none'}. The model is linear and a beginning "
        "only: put in what you know of the vehicle.\n\n"
        f"```\noed-sysid problems {words['folder']}\n"
        f"oed-sysid fit {words['folder']} {words['folder']}/data/{log.stem}.csv\n```\n",
    )


def _signals(log: Path) -> tuple[np.ndarray, list[_Signal]]:
    table = read_table(log)
    times: np.ndarray | None = None
    found: list[_Signal] = []
    without: list[str] = []
    for header, column in zip(table.headers, table.values.T, strict=True):
        name, unit = parse_header(header)
        if times is None and name in (*TIME_NAMES, "Time", "TIME"):
            times = to_si(column, unit or "s")[0]
        elif unit is None:
            without.append(header)
        elif np.isfinite(column).sum() > 2:
            values, si = to_si(column, unit)
            found.append(_Signal(_identifier(name, found), name, si, values))
    if times is None:
        raise DataError(f"{log.name} has no time column. Call it 't [s]'.")
    if without and not found:
        raise DataError(
            f"{log.name} has no units: {', '.join(without)}. Write them as '{without[0]} [deg]'."
        )
    return times, found


def _identifier(name: str, before: list[_Signal]) -> str:
    text = re.sub(r"\W+", "_", name).strip("_") or "signal"
    text = text if text[0].isalpha() else f"s_{text}"
    taken = {signal.name for signal in before} | _TAKEN
    while text in taken or keyword.iskeyword(text):
        text += "_"
    return text


def _commands(log: Path, signals: list[_Signal], inputs: tuple[str, ...]) -> list[_Signal]:
    if inputs:
        known = {s.column: s for s in signals} | {s.name: s for s in signals}
        if unknown := [name for name in inputs if name not in known]:
            raise ProblemError(
                f"{log.name} has no column {unknown[0]!r} with a unit. It has {', '.join(known)}."
            )
        return [known[name] for name in inputs]
    found = [s for s in signals if _COMMAND.search(s.name) and np.isfinite(s.values).all()]
    if not found:
        raise ProblemError(
            f"No column of {log.name} looks like a command: "
            f"{', '.join(s.column for s in signals)}. Name them with inputs=(...), or "
            "--input on the command line."
        )
    return found


def _filled(times: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A signal without gaps, for start values only."""
    good = np.isfinite(values)
    return np.interp(times, times[good], values[good])


def _problem(
    words: dict[str, str],
    times: np.ndarray,
    commands: list[_Signal],
    measured: list[_Signal],
    log: str,
) -> str:
    """Text of ``problem.py``."""
    names = [s.name for s in measured]
    integral = {a: r for a, r in _INTEGRALS.items() if a in names and r in names}
    # Positions and headings do not act on the motion; everything else may.
    acting = [s for s in measured if s.name not in ("x", "y", "z", "psi") or len(measured) == 1]
    columns = [_filled(times, s.values) for s in acting] + [s.values for s in commands]
    means = [float(np.mean(c)) for c in columns]
    sizes = [float(np.std(c)) or 1.0 for c in columns]
    scaled = np.column_stack([(c - m) / s for c, m, s in zip(columns, means, sizes, strict=True)])
    kinematics, parameters, states, outputs = [], [], [], []
    for signal in measured:
        clean = _filled(times, signal.values)
        scale = float(np.std(clean)) or 1.0
        states.append(f'State("{signal.name}", "{signal.unit}", scale={scale:.3g}),')
        outputs.append(signal.declared("Output"))
        if signal.name in integral:
            kinematics.append(f'"{signal.name}": "{integral[signal.name]}",')
            continue
        rows = np.column_stack([scaled, np.ones(len(times))])
        ridge = 1e-3 * len(times) * np.eye(rows.shape[1])
        slope = np.linalg.solve(rows.T @ rows + ridge, rows.T @ np.gradient(clean, times))
        terms = []
        factors = [s.name for s in (*acting, *commands)]
        for factor, size, value in zip(factors, sizes, slope[:-1], strict=True):
            parameter = f"{signal.name}_{factor}"
            unit = scale / (size * float(np.ptp(times)) / len(times) * 20)
            terms.append(f"{parameter}*{factor}")
            parameters.append(
                f'Parameter("{parameter}", {value / size:.4g}, scale={max(abs(unit), 1e-9):.3g}),'
            )
        constant = slope[-1] - float(np.sum(slope[:-1] * np.array(means) / np.array(sizes)))
        parameters.append(f'Parameter("{signal.name}_0", {constant:.4g}, scale={scale:.3g}),')
        kinematics.append(f'"{signal.name}": "{" + ".join([*terms, f"{signal.name}_0"])}",')
    step = float(np.median(np.diff(times)))
    effects = []
    for signal in acting:
        if signal.name not in integral:
            bend = float(np.std(_filled(times, signal.values))) or 1.0
            effects.append(
                f'Force("{signal.name}_quadratic", {{"{signal.name}": '
                f'"-E_{signal.name}*{signal.name}*abs({signal.name})"}}, '
                f'(Parameter("E_{signal.name}", 0.0, scale={0.1 / bend:.3g}),),\n'
                f'        description="damping that grows with {signal.name}"),'
            )
    for signal in commands:
        effects.append(f'actuator_lag("{signal.name}_lag", "{signal.name}", scale={5 * step:.3g}),')
    limits = []
    for signal in commands:
        low, high = float(np.min(signal.values)), float(np.max(signal.values))
        limits.append(f'"{signal.name}": ({low:.4g}, {high:.4g}),')

    def block(lines: list[str], indent: int = 8) -> str:
        return "\n".join(" " * indent + line for line in lines)

    return f'''"""{words["title"]}: a first model, written from {log}.

Linear, with start values from the log: a beginning, not a claim. Put in what you know of
the vehicle, for instance with oed_sysid.physics.rigid_body.
"""

from pathlib import Path

from oed_sysid import Force, Input, Limits, Model, Output, Parameter, Problem, State, read_csv
from oed_sysid.physics import actuator_lag

FOLDER = Path(__file__).parent

model = Model(
    name="{words["name"]}",
    states=(
{block(states)}
    ),
    inputs=(
{block([s.declared("Input") for s in commands])}
    ),
    outputs=(
{block(outputs)}
    ),
    kinematics={{
{block(kinematics)}
    }},
    parameters=(
{block(parameters)}
    ),
    step={step:.4g},
)

# What may be missing. Zero means absent; oed_sysid.physics has many more.
effects = (
{block(effects, 4)}
)

problem = Problem(
    "{words["name"]}",
    model,
    title="{words["title"]}",
    effects=effects,
    # As far as the log went.
    limits=Limits(
        inputs={{
{block(limits, 12)}
        }}
    ),
    records=lambda: read_csv(FOLDER / "data", model.channels),
)
'''
