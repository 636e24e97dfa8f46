"""Arguments and options of all commands: one table.

A command declares what it takes in its signature, in plain types or in groups of them; the row of
a parameter's name, or of ``command.name`` where a command means something of its own by it, says
how it is written and what it is. :func:`described` joins the two for typer, the page asks for its
options by the same rows (:func:`oed_sysid.app.panels.ask`), and :func:`line_of` writes the command
that repeats what the page was asked.
"""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, is_dataclass
from functools import wraps
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import typer

from oed_sysid.cli.study import DEFAULT_MODEL, Option, Study, Task, grouped, options_of
from oed_sysid.errors import FileError
from oed_sysid.runtime.files import check_place

# Formats of --picture.
PICTURES = (".png", ".pdf", ".svg")


def file_place(value: Any) -> Any:
    """Say before the work where a file could not be written; an option's callback."""
    if value is not None:
        check_place(value)
    return value


def json_place(value: Any) -> Any:
    """As :func:`file_place`; ``-`` is standard output. An option's callback."""
    return value if str(value) == "-" else file_place(value)


def folder_place(value: Any) -> Any:
    """Say before the work where files of a folder could not be written; an option's callback."""
    if value is not None:
        check_place(value, folder=True)
    return value


def picture_place(value: Any) -> Any:
    """As :func:`file_place`, of a picture; an option's callback."""
    return ending_of(value, PICTURES, "a picture")


def ending_of(value: Any, endings: tuple[str, ...], what: str) -> Any:
    """As :func:`file_place`, of a file whose ending says how it is written."""
    if value is not None and Path(value).suffix.lower() not in endings:
        raise FileError(f"{str(value)!r} does not end as {what} does. Choose {', '.join(endings)}.")
    return file_place(value)


def card_place(value: Any) -> Any:
    """As :func:`file_place`, of a sea-trial card; an option's callback."""
    return ending_of(value, (".txt", ".html", ".pdf"), "a card")


def _problems(incomplete: str) -> list[str]:
    """Shipped problems whose names begin so; folders are completed by the shell itself."""
    from oed_sysid.experiments.problem import list_problems

    return [name for name in list_problems() if name.startswith(incomplete)]


@dataclass(frozen=True)
class Row:
    """One argument or option.

    Parameters
    ----------
    help : str
        What it is.
    metavar : str
        What stands for its value; choices are divided by ``|``.
    flag : str or None
        How an option is written, by default as the parameter is called; empty for an argument.
    check : callable, optional
        Refuses a value before the work.
    shown : bool or str
        What is said of the default.
    least : int, optional
        Least number.
    label : str
        What the page calls it; by default the first sentence of the help.
    offered : tuple
        What the page offers; by default the choices of ``metavar``.
    words : mapping of str to str
        What the page calls these.
    """

    help: str
    metavar: str = ""
    flag: str | None = None
    check: Callable[[Any], Any] | None = None
    shown: bool | str = True
    least: int | None = None
    label: str = ""
    offered: tuple[Any, ...] = ()
    words: Mapping[str, str] = field(default_factory=dict)

    @property
    def choices(self) -> tuple[Any, ...]:
        """What there is to choose from; empty where anything can be given."""
        named = self.metavar.split("|") if "|" in self.metavar else []
        return self.offered or tuple(w for w in named if len(w) == 1 or w.islower())

    def declared(self, name: str, default: Any) -> Any:
        """Return what typer is told about a parameter of a command."""
        required = default is inspect.Parameter.empty
        settings: dict[str, Any] = {
            "help": self.help,
            "metavar": self.metavar or None,
            "callback": self.check,
            "show_default": False if required or (default is None and self.shown is True)
            else self.shown,
            "min": self.least,
        }  # fmt: skip
        if self.flag == "":
            known = _problems if self.metavar == "PROBLEM" else None
            return typer.Argument(**settings, autocompletion=known)
        complete = _one_of(self.choices) if default in self.choices else None
        return typer.Option(self.written(name), **settings, autocompletion=complete)

    def written(self, name: str) -> str:
        """How the option of a parameter is written."""
        return self.flag or f"--{name.replace('_', '-')}"


def _one_of(choices: tuple[str, ...]) -> Callable[[str], list[str]]:
    return lambda incomplete: [one for one in choices if one.startswith(incomplete)]


_CRITERIA = {
    "D": "all parameters together (D)",
    "A": "mean error (A)",
    "E": "the worst combination (E)",
}

# fmt: off
ROWS = {
    "problem": Row(
        "A shipped problem (see: oed-sysid problems) or the path of a folder of your own.",
        "PROBLEM", flag=""),
    "app.problem": Row(
        "Problem to begin with: a shipped one or a folder of your own.", "[PROBLEM]", flag=""),
    "problems.problem": Row(
        "A shipped problem or a folder: says what it holds, with its equations.",
        "[PROBLEM]", flag=""),
    "import_.problem": Row(
        "Whose channels these are; by default what the mapping says.", "PROBLEM"),
    "campaign.problem": Row("Begins a campaign: what is to be identified.", "PROBLEM"),
    "port": Row("Port of this computer."),
    "no_browser": Row("Do not open a browser; only say the address."),
    "problems": Row(
        "Shipped problems or folders; by default the six with published methods.", "PROBLEM..."),
    "names": Row(
        "By default all that do not search by whole populations; 'all' takes these too.",
        "NAME...", flag="--estimators"),
    "noise": Row("Per cent of each output's peak.", "LEVEL...", shown="0 0.5 1 3"),
    "rank.noise": Row(
        "Standard deviations of outputs in SI units, in place of the problem's.", "OUTPUT=STD...",
        shown="those of the problem"),
    "priors": Row(
        "What is known besides: none, the problem's own (model), or every value to a share such as "
        "0.3.", "none|model|SHARE", shown="none"),
    "declared": Row("Noise in multiples of what the problem declares instead."),
    "sampling": Row("Multiples of the problem's sample time.", "FACTOR...", shown="1"),
    "seeds": Row("Repetitions.", "N", least=1),
    "jobs": Row("Processes.", "N"),
    "out": Row(
        "Tables, picture and finished runs, which are never run again.",
        "FOLDER", check=folder_place),
    "missing_physics.out": Row(
        "Where finished cases are kept, and the table; by default the checkout's own.",
        "FOLDER", check=folder_place),
    "simulate.out": Row(
        "File to write, or a folder for one file per experiment.", "CSV", shown="<experiment>.csv"),
    "export.out": Row("Folder, or the file where there is one.", "PATH"),
    "report.out": Row("The report, one HTML file.", "FILE", check=file_place),
    "import_.out": Row("Where the records go, as CSV.", "FOLDER", check=folder_place),
    "design.out": Row("Commands to play, one row per sample.", "CSV", check=file_place),
    "programme.out": Row("Commands of every run as tables to play.", "FOLDER", check=folder_place),
    "json_file": Row(
        "Also write the result to FILE as JSON; to standard output where it is -.", "FILE",
        flag="--json", check=json_place),
    "picture": Row("Also draw the result (PNG, PDF, SVG).", "FILE", check=picture_place),
    "plan": Row(
        "Kinds and numbers of cases, such as 'single/white:40 none/white:20'.",
        flag="", shown="all of the published benchmark, hours"),
    "files": Row("Training records: files, folders or patterns.", "CSV...", flag=""),
    "rank.files": Row("Records in hand instead of planned experiments.", "[CSV...]", flag=""),
    "validate": Row("Validation records; nothing is fitted to them.", "CSV..."),
    "improve.validate": Row(
        "Validation records; nothing is fitted to them. Without any, the last two fifths of a "
        "single record are kept for that.", "CSV..."),
    "model": Row("Which of the problem's models is the nominal one, if it has several.", "NAME"),
    "html_file": Row(
        "Also write a report with pictures, one file that can be mailed.",
        "FILE", flag="--html", check=file_place),
    "fix": Row(
        "Write corrected copies of the records to FOLDER; the originals are left alone.",
        "FOLDER", check=folder_place),
    "folder": Row("The folder to make; its name names the problem.", flag=""),
    "campaign.folder": Row(
        "Where the journal of the trial is kept.", "FOLDER", flag="", check=folder_place),
    "template": Row("generic, ship, auv, usv, torpedo or sailboat.", "KIND"),
    "log": Row(
        "A log with units in its headers: channels and a first linear model come from it.",
        "CSV", flag="--from"),
    "import_.log": Row(
        "ULog, DataFlash .bin, ROS bag, MCAP, NMEA 0183, .mat, Excel, Parquet or CSV.",
        "LOG", flag=""),
    "inputs": Row(
        "With --from: a column that is a command; by default its name says so.",
        "NAME...", flag="--input"),
    "experiment": Row("Which experiments; by default all of them.", "NAME..."),
    "rank.experiment": Row(
        "Planned experiments, together; by default all of the problem.", "NAME...",
        label="What is run"),
    "seed": Row("Seed of the search.", least=0),
    "simulate.seed": Row("Seed of the measurement noise.", least=0),
    "no_noise": Row("Without noise."),
    "truth": Row("Simulate the problem's truth, where it states one."),
    "fit": Row("What `fit --save FIT` or `improve --save FIT` kept.", "FIT", flag=""),
    "kind": Row("c, python, casadi, fmu, matlab, control, sympy or latex.", "KIND", flag="--as"),
    "at": Row("With --as control: inputs and states of the trim, SI.", "NAME=VALUE..."),
    "known_noise": Row(
        "Trust the noise levels that the problem declares instead of estimating them."),
    "disturbances": Row(
        "Where disturbance forces may act: found out, nowhere, everywhere, or in the equations "
        "named, as Z,M.", "auto|none|all|NAMES"),
    "save": Row(
        "Keep the whole fit, data included, for report, export, compare --with, design --after "
        "and Fit.load.", "FILE", check=file_place),
    "improve.save": Row(
        "Keep the fit of the improved model, for report, export, compare --with and design "
        "--after.", "FILE", check=file_place),
    "kept_in": Row(
        "Where finished steps are kept until the command ends, so that it goes on from them "
        "when it is called again after an interruption.",
        "FOLDER", flag="--journal", check=folder_place, shown="in the user's cache"),
    "fresh": Row("Start over: forget what an interrupted call has finished."),
    "added": Row(
        "Also compare the model with these candidates added, one by one; a+b adds two. A file "
        "that --save wrote joins with the fit that it holds.", "EFFECT|FIT...", flag="--with",
        label="Also with one effect added"),
    "saved": Row("What `oed-sysid fit --save FIT` kept, or the numbers of --json.", "FIT", flag=""),
    "max_effects": Row("Most effects to add.", least=1, label="Most effects to add"),
    "no_terms": Row(
        "Look for no term beyond the candidates: the slowest stage.",
        label="Look for no unknown term"),
    "listing": Row("Show every field with rate, span, unit and range.", flag="--list"),
    "find": Row("With --list: fields that hold TEXT.", "TEXT"),
    "mapping": Row(
        "Which field is which channel, and where to cut; the same file serves the next log.",
        "TOML", flag="--map"),
    "draft": Row(
        "With --problem: write a first mapping from names and units, to be corrected.",
        "TOML", check=file_place),
    "like": Row(
        "Experiment that lends its length, sampling, constant inputs and start state.",
        "EXPERIMENT", shown="the problem's first", label="Start and sampling as in"),
    "duration": Row("Length of each run, s.", "S"),
    "design.duration": Row("Length of the run, s.", "S", label="Length [s]"),
    "limit": Row(
        "What must be kept, in degrees and SI units; also as --max-pitch 20, --min-depth 80.",
        "NAME=VALUE...", shown="those of the problem"),
    "design.limit": Row(
        "What must be kept, in degrees and SI units: pitch=20, depth=80:120. The problem's own "
        "options are easier: `oed-sysid design PROBLEM --help` lists them.",
        "NAME=VALUE...", shown="those of the problem"),
    "certainty": Row(
        "Keep the limits with this probability although coefficients are uncertain; takes a "
        "minute. 0 only states the probability.", "P", shown="0.95 with --after, else 0",
        label="Keep limits on uncertain vehicles",
        offered=(0.9, 0.95, 0.99),
        words={"0.9": "in 90% of them", "0.95": "in 95% of them", "0.99": "in 99% of them"}),
    "uncertainty": Row(
        "How wrong coefficients may be; without it their priors or the fit's covariance.", "SHARE"),
    "design.uncertainty": Row(
        "How wrong coefficients may be; after a fit its own covariance is used.", "SHARE"),
    "criterion": Row(
        "What shall be small: D the errors of all parameters together, A their mean, E the "
        "worst combination.", "D|A|E", label="Sharpen",
        words=_CRITERIA),
    "programme.criterion": Row(
        "What shall be small: D the errors of all parameters together, A their mean.", "D|A",
        label="Sharpen", words=_CRITERIA),
    "discriminate": Row(
        "Tell these candidates apart instead of sharpening parameters.", "EFFECT...",
        label="Tell apart"),
    "reveal": Row(
        "Make these candidates visible, should they be missing, or all of the problem; with "
        "--after what its records have shown already counts.", "EFFECT...|all",
        label="Make visible"),
    "family": Row("Kind of command.", "levels|multisine|pulses", label="Commands"),
    "avoid": Row(
        "Frequencies that must not be excited, Hz; for --family multisine.", "LOW:HIGH..."),
    "effort": Row(
        "How many starts and steps: seconds, a minute, several minutes.", "quick|normal|thorough",
        label="Effort"),
    "after": Row("Complete what a fit knows already, as kept by --save of fit or improve.", "FIT"),
    "programme.after": Row(
        "Complete what a fit knows already; its disturbance forces are those expected.", "FIT"),
    "sea": Row(
        "Random forces to expect: still, calm, moderate, rough, or levels by equation as "
        "Z=0.3,M=0.06,time=2; with a fit those that it found.", "STATE", label="Sea",
        offered=("still", "calm", "moderate", "rough")),
    "card": Row(
        "One page for those on board: .txt, .html or .pdf (these with the track and the sea "
        "room that it needs).", "FILE", check=card_place),
    "length": Row("Of the vehicle, for the sea room.", "M"),
    "servo": Row(
        "RC channels of the inputs for --overrides and --controller ardupilot; their ends are "
        "those of the limits.",
        "INPUT=CHANNEL..."),
    "overrides": Row(
        "Commands as servo pulses, to send as MAVLink RC_CHANNELS_OVERRIDE.",
        "CSV", check=file_place),
    "bag": Row("Commands as a ROS 2 bag to play.", "FOLDER", check=folder_place),
"controller": Row(
        "What flies the run, feedback and abort rules included: ardupilot, ros2, moos or words.",
        "KIND=FILE..."),
    "source": Row(
        "A file that grows, - for standard input, udp://HOST:PORT (lines of CSV or NMEA 0183) or "
        "mavlink://HOST:PORT.", "SOURCE"),
    "period": Row("Between samples; by default that of the first experiment.", "S"),
    "watch.duration": Row("Expected length of a run; by default the first experiment's.", "S"),
    "band": Row("Frequencies that count; by default those of the motion.", "LOW:HIGH"),
    "waves": Row("Frequencies left out, Hz.", "LOW:HIGH"),
    "watch.goal": Row("Standard error that is enough.", "PERCENT"),
    "places": Row(
        "Where channels are in sentences and messages: psi=HDT.heading:deg.",
        "CHANNEL=TOPIC.FIELD...", flag="--map"),
    "silence": Row("The run is over after so long without a word.", "S"),
    "runs": Row("Largest number of runs.", "N", least=1, label="Most runs"),
    "hours": Row("Time for everything, h.", "H", label="Hours for everything"),
    "campaign.hours": Row("Time for the whole trial.", "H"),
    "patterns": Row(
        "Experiments that lend speeds, starts and sampling; by default all of the problem.",
        "EXPERIMENT...", label="Speeds and starts as in"),
    "turnaround": Row("Between two runs, min.", "MIN", label="Between two runs [min]"),
    "sensor": Row(
        "Outputs that need not be measured, and the hours that each costs.", "OUTPUT=H..."),
    "rounds": Row("Rounds of refined commands.", "N", least=0),
    "goal": Row("What is to be known, such as M_uw=3 or all=5.", "PARAMETER=PERCENT..."),
    "record": Row("Log of the run just done.", "CSV"),
}
# fmt: on


def row_of(command: str, name: str) -> Row:
    """Return the row of a command's option."""
    return ROWS.get(f"{command}.{name}") or ROWS[name]


def described(command: Callable[..., None]) -> Callable[..., None]:
    """Return a command whose signature says what the table does; groups are taken apart."""
    name = command.__name__
    hints = get_type_hints(command)
    listed = [
        Option(one.name, hints[one.name], one.default)
        for one in inspect.signature(command).parameters.values()
        if not is_dataclass(hints[one.name])
    ]
    listed += [one for one in options_of(command) if one.group]

    @wraps(command)
    def called(**values: Any) -> None:
        grouped_values = {one.name for one in listed if one.group}
        alone = {key: value for key, value in values.items() if key not in grouped_values}
        inner = {key: value for key, value in values.items() if key in grouped_values}
        command(**alone, **grouped(command, inner))

    return declared(called, name, listed)


def declared(
    command: Callable[..., None], name: str, options: Iterable[Option]
) -> Callable[..., None]:
    """Give a function of keyword arguments the signature that typer reads."""
    listed = []
    for one in options:
        several = str(one.kind).startswith("tuple")
        kind = list[str] | None if several else one.kind
        default = None if several and one.default == () else one.default
        listed.append(
            inspect.Parameter(
                one.name,
                inspect.Parameter.KEYWORD_ONLY,
                default=default,
                annotation=Annotated[kind, row_of(name, one.name).declared(one.name, default)],
            )
        )
    command.__signature__ = inspect.Signature(listed)  # type: ignore[attr-defined]
    command.__annotations__ = {one.name: one.annotation for one in listed}
    return command


def reads_of(task: Task) -> Iterator[Option]:
    """Options of the command of a task for what it is asked about."""
    empty = inspect.Parameter.empty
    yield Option("problem", str, empty)
    for word in task.reads.split():
        name = word.strip("[]")
        if name in ("files", "validate"):
            yield (
                Option(name, list[str] | None, None)
                if word.startswith("[")
                else Option(name, list[str], empty)
            )
    yield Option("model", str | None, None)
    if "noise" in task.reads:
        yield Option("known_noise", bool, False)
        yield Option("disturbances", str, "auto")


def results_of(task: Task) -> Iterator[Option]:
    """Options of the command of a task for what becomes of the result."""
    for name in ("json_file", "html_file", "picture"):
        yield Option(name, Path | None, None)
    if "journal" in task.reads:
        yield Option("kept_in", Path | None, None)
        yield Option("fresh", bool, False)


def line_of(task: Task, study: Study, options: Mapping[str, Any], file: str = "") -> str:
    """Return the command that asks for a task, its records in the folders train and test.

    Examples
    --------
    >>> from oed_sysid.cli.tasks import TASKS
    >>> study = Study.named("remus_diving_plane")
    >>> line_of(TASKS["rank"], study, {"experiment": ("steps", "zigzag_5_5")})
    'oed-sysid rank remus_diving_plane --experiment steps zigzag_5_5 --html rank.html'
    """
    words = ["oed-sysid", task.name, study.source, *_asked_about(task, study)]
    for name, value in task.given(options).items():
        values = value if isinstance(value, tuple) else () if value is True else (value,)
        words += [row_of(task.name, name).written(name), *map(_word, values)]
    return f"{shlex.join(words)} {task.keeps} --html {file or task.name}.html".replace("  ", " ")


def _asked_about(task: Task, study: Study) -> Iterator[str]:
    """Words of a command for the records and settings of a study."""
    if study.variant != DEFAULT_MODEL:
        yield from ("--model", study.variant)
    present = [name for name in ("train", "test") if getattr(study, name) is not None]
    if "files" in task.reads:
        yield from present[:1]
    if "validate" in task.reads and len(present) > 1:
        yield from ("--validate", "test")
    if "noise" in task.reads and study.known_noise:
        yield "--known-noise"


def _word(value: Any) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)
