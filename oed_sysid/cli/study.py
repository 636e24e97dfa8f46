"""What is asked about, what is asked, and what comes of it: the same on a page and a command line.

A :class:`Study` is a problem with its records. A :class:`Task` is one row of
:data:`oed_sysid.cli.tasks.TASKS`: a function of a study, with its options as keyword parameters,
some of them in groups (frozen dataclasses). Its :class:`Outcome` holds the result, the document
that text, page and download are renderings of, and what else is offered. The command line, the
widgets of the page, the command that the page shows and the script that repeats a study are all
made from these rows and the table of options, :data:`oed_sysid.cli.options.ROWS`.
"""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, get_type_hints

from oed_sysid.errors import DataError

if TYPE_CHECKING:
    from oed_sysid import Dataset, Fit, Problem
    from oed_sysid.evidence.compare import Comparison
    from oed_sysid.likelihood.noise_model import Disturbances
    from oed_sysid.physics.base import Effect
    from oed_sysid.runtime.display import Figure, Report

# The problem's own nominal model.
DEFAULT_MODEL = "default"


@dataclass(frozen=True, eq=False)
class Study:
    """A problem and the records that were chosen for it.

    Parameters
    ----------
    source : str
        Shipped name or folder of the problem, as the user gave it.
    variant : str
        Which of its models is the nominal one.
    problem : Problem
        The problem, that model as the nominal one.
    train, test : Dataset or None
        Training records; validation records.
    known_noise : bool
        Whether the declared noise levels are trusted.
    disturbances : str
        Where disturbance forces may act: ``"auto"``, ``"none"``, ``"all"``, or names of equations
        and ``sea``, by commas.
    saved : mapping of str to Fit
        Fits at hand, by the names of the files that the commands keep them in.
    """

    source: str
    variant: str
    problem: Problem
    train: Dataset | None = None
    test: Dataset | None = None
    known_noise: bool = False
    disturbances: str = "auto"
    saved: Mapping[str, Fit] = field(default_factory=dict)

    @classmethod
    def named(cls, source: str, model: str | None = None) -> Study:
        """Return a problem without records."""
        from oed_sysid.experiments.problem import load_problem

        return cls(source, model or DEFAULT_MODEL, load_problem(source, variant=model))

    @cached_property
    def equipped(self) -> Problem:
        """The problem, with usual candidates where it names none."""
        from oed_sysid.evidence.usual import equipped

        return equipped(self.problem, self.train)

    @property
    def effects(self) -> Sequence[Effect]:
        """Candidates: those of the problem, or usual ones with sizes from the training records."""
        return self.problem.effects if self.train is None else self.equipped.effects

    @property
    def key(self) -> tuple[str, ...]:
        """What it is, by content: equal studies have equal results."""
        model = self.problem.model
        return (
            self.source,
            self.variant,
            digest(model.content, repr(self.problem.effects), repr(self.problem.limits)),
            _content(self.train),
            _content(self.test),
            f"{self.known_noise} {self.disturbances}",
        )

    @property
    def noise(self) -> str:
        """The estimator's setting for noise levels."""
        return "given" if self.known_noise else "auto"

    @property
    def acting(self) -> Disturbances:
        """Where disturbance forces may act, as estimators take it."""
        if self.disturbances in ("auto", "none", "all"):
            return self.disturbances
        names = (name.strip() for name in self.disturbances.split(","))
        return tuple(name for name in names if name)

    def without_records(self) -> Study:
        """Return the problem alone."""
        return replace(self, train=None, test=None)

    def training(self) -> Dataset:
        """Return the training records.

        Raises
        ------
        DataError
            If none were chosen.
        """
        return _chosen(self.train, "training")

    def records(self) -> Dataset:
        """Return all chosen records.

        Raises
        ------
        DataError
            If there are none.
        """
        from oed_sysid.data.dataset import together

        if self.train is None or self.test is None:
            return self.training() if self.test is None else self.test
        return together(self.train, self.test)

    def validation(self) -> Dataset:
        """Return the validation records.

        Raises
        ------
        DataError
            If none were chosen.
        """
        return _chosen(self.test, "validation")


def _chosen(dataset: Dataset | None, kind: str) -> Dataset:
    if dataset is None:
        raise DataError(f"There is no {kind} record. Choose one on the page Data.")
    return dataset


def _content(dataset: Dataset | None) -> str:
    """Digest of the names and numbers of records."""
    return "none" if dataset is None else digest(*(f"{r.name} {r.content_hash}" for r in dataset))


def digest(*parts: str | bytes) -> str:
    """Short hash of texts or bytes."""
    total = hashlib.sha256()
    for part in parts:
        total.update(part.encode() if isinstance(part, str) else part)
        total.update(b"\0")
    return total.hexdigest()[:16]


@dataclass(frozen=True, eq=False)
class Outcome:
    """What a task came to.

    Parameters
    ----------
    result : object
        The result.
    said : Report
        What is printed; its answer first.
    facts : mapping
        For JSON.
    make : callable, optional
        Returns the page, where that is another document.
    figure : Figure, optional
        The picture of the result.
    text : str
        What is printed below the answer, where that is another text.
    above : str
        What must be read before everything else.
    notes : tuple of str
        What is worth knowing besides.
    fits : mapping of str to Fit
        Fitted models that may be kept and exported, by what they are called.
    comparison : Comparison, optional
        What these predict.
    status : int
        Exit code.
    settings : mapping
        How it was made, where more of it can be asked for.
    page : Report, optional
        The page with its figures drawn, once :meth:`drawn`.
    """

    result: Any
    said: Report
    facts: Mapping[str, Any]
    make: Callable[[], Report] | None = None
    figure: Figure | None = None
    text: str = ""
    above: str = ""
    notes: tuple[str, ...] = ()
    fits: Mapping[str, Fit] = field(default_factory=dict)
    comparison: Comparison | None = None
    status: int = 0
    settings: Mapping[str, Any] = field(default_factory=dict)
    page: Report | None = None

    def document(self) -> Report:
        """Return the page."""
        if self.page is not None:
            return self.page
        return self.said if self.make is None else self.make()

    def drawn(self) -> Outcome:
        """Return the outcome with its page drawn, to be kept."""
        return replace(self, page=self.document().drawn(), make=None, figure=None, facts={})


# -- options -----------------------------------------------------------------------------


@dataclass(frozen=True)
class Option:
    """One option of a function, on its own or in a group.

    Parameters
    ----------
    name : str
        Of the parameter, or of the group's field.
    kind : object
        Its type.
    default : object
        ``inspect.Parameter.empty`` where it must be given.
    group : str
        Parameter that the group is; empty where it stands alone.
    """

    name: str
    kind: Any
    default: Any
    group: str = ""


def options_of(function: Callable[..., Any]) -> Iterator[Option]:
    """Options of a task or a command: its parameters, those in groups one by one.

    Examples
    --------
    >>> from oed_sysid.cli.tasks import Aim
    >>> def plan(study, *, runs: int = 3, aim: Aim = Aim("A")): ...
    >>> [(one.name, one.default) for one in options_of(plan)][:2]
    [('runs', 3), ('criterion', 'A')]
    """
    hints = get_type_hints(function)
    for name, one in inspect.signature(function).parameters.items():
        kind = hints.get(name)
        if name in ("study", "show"):  # what a task is about, and who is told
            continue
        if isinstance(kind, type) and is_dataclass(kind):
            for part in options_of(kind):
                yield replace(part, default=getattr(one.default, part.name), group=name)
        else:
            yield Option(name, kind, one.default)


def grouped(function: Callable[..., Any], values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the keyword arguments of a function from values by option; the rest by default."""
    found: dict[str, Any] = {}
    groups: dict[str, dict[str, Any]] = {}
    for one in options_of(function):
        if one.name in values:
            value = values[one.name]
            value = tuple(value or ()) if str(one.kind).startswith("tuple") else value
            (groups.setdefault(one.group, {}) if one.group else found)[one.name] = value
    parameters = inspect.signature(function).parameters
    return found | {name: replace(parameters[name].default, **v) for name, v in groups.items()}


@dataclass(frozen=True)
class Task:
    """One thing that can be asked of a study.

    Parameters
    ----------
    run : callable
        ``(study, show, **options) -> Outcome``; its name is that of the command, its first
        paragraph the help.
    title : str
        What it is, on the page Report.
    doing : str
        What is said while it begins.
    reads : str
        Records and settings of its command: ``files``, ``[files]``, ``validate``, ``[validate]``,
        ``noise``, ``journal``.
    writes : type, optional
        Options of the command for files to be written; see :mod:`oed_sysid.cli.tasks`.
    keeps : str
        Options of the command that the page shows, for the files that it takes home.
    """

    run: Callable[..., Outcome]
    title: str
    doing: str
    reads: str
    writes: Any = None
    keeps: str = ""

    @property
    def name(self) -> str:
        """Name of the command."""
        return self.run.__name__

    def __call__(self, study: Study, show: Any, options: Mapping[str, Any]) -> Outcome:
        """Do it."""
        return self.run(study, show, **grouped(self.run, options))

    def given(self, options: Mapping[str, Any]) -> dict[str, Any]:
        """Options that are not as they are by default."""
        defaults = {one.name: one.default for one in options_of(self.run)}
        return {name: value for name, value in options.items() if value != defaults[name]}
