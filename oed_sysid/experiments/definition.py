"""What a problem is: a system, what may be missing in its model, and how to test it."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import closest
from oed_sysid.errors import OedSysidError, ProblemError
from oed_sysid.experiments.experiment import Experiment, Limits
from oed_sysid.experiments.soundness import notes
from oed_sysid.physics import Effect
from oed_sysid.physics.channels import Channels
from oed_sysid.physics.model import Model

DEFAULT = "default"
_NAME = re.compile(r"[A-Za-z]\w*")


# What a description says where no candidate effects are named.
USUAL = "none named: usual ones are made from the records"


@dataclass(frozen=True)
class Problem:
    """One system to identify.

    Parameters
    ----------
    name : str
        Identifier: letters, digits and underscores.
    model : Model
        What is believed before the data.
    title : str
        The same in words.
    effects : tuple of Effect
        Candidates for what the model lacks.
    experiments : mapping of str to Experiment
        Runs that make sense for this system, by name.
    limits : Limits
        What any experiment has to keep.
    truth : mapping of str to float, optional
        True parameter values, where the data is simulated.
    models : mapping of str to Model
        Other models of the same system, by name; ``"default"`` is ``model``.
    others : mapping of str to Problem
        Problems of the same system with other channels or candidates, such as
        a ship seen as a heading response and as a body in three degrees of
        freedom. :meth:`variant` finds them by name too.
    records : callable, optional
        Returns the measured records, ``() -> Dataset``; called when they are
        wanted.
    published : mapping
        Numbers from the literature to compare with.
    references : tuple of str
        Citations.
    description : str
        What the system is, and what success means.

    Raises
    ------
    ProblemError
        If the parts do not fit together.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Output, State
    >>> decay = Model("decay", (State("x", "m"),), (), (Output("x", "m"),), {"x": "-x"})
    >>> Problem("decay", decay, title="A decay").channels.output_names
    ('x',)
    """

    name: str
    model: Model
    _: KW_ONLY
    title: str = ""
    effects: tuple[Effect, ...] = ()
    experiments: Mapping[str, Experiment] = field(default_factory=dict)
    limits: Limits = field(default_factory=Limits)
    truth: Mapping[str, float] | None = None
    models: Mapping[str, Model] = field(default_factory=dict)
    others: Mapping[str, Problem] = field(default_factory=dict)
    records: Callable[[], Dataset] | None = None
    published: Mapping[str, Any] = field(default_factory=dict)
    references: tuple[str, ...] = ()
    description: str = ""

    def __post_init__(self) -> None:
        self._check_kinds()
        if not _NAME.fullmatch(self.name):
            raise ProblemError(
                f"Problem name {self.name!r} is no identifier. Use letters, digits and "
                "underscores, beginning with a letter."
            )
        object.__setattr__(self, "effects", tuple(self.effects))
        object.__setattr__(self, "references", tuple(self.references))
        object.__setattr__(self, "experiments", dict(self.experiments))
        others = {name: model for name, model in self.models.items() if name != DEFAULT}
        if DEFAULT in self.models and self.models[DEFAULT] != self.model:
            raise ProblemError(
                f"Problem {self.name!r} has two default models. Leave {DEFAULT!r} out of models."
            )
        object.__setattr__(self, "models", {DEFAULT: self.model, **others})
        object.__setattr__(self, "others", dict(self.others))
        if twice := [name for name in self.others if name in self.models]:
            raise ProblemError(
                f"Problem {self.name!r} has a model and a problem called {twice[0]!r}. Rename one."
            )
        if not self.title:
            object.__setattr__(self, "title", self.name.replace("_", " "))
        self._check_effects()
        self._check_truth()
        try:
            for experiment in self.experiments.values():
                experiment.check_model(self.model)
            self.limits.check_names(self.model)
            for experiment in self.experiments.values():
                self._check_constants(experiment)
        except OedSysidError as error:
            raise ProblemError(f"Problem {self.name!r}: {error}") from None

    def _check_constants(self, experiment: Experiment) -> None:
        """Refuse an input that is held outside the limits of every experiment."""
        for name, value in experiment.constants.items():
            lower, upper = self.limits.inputs.get(name, (-math.inf, math.inf))
            if not lower <= value <= upper:
                raise ProblemError(
                    f"Experiment {experiment.name!r} holds {name!r} at {value:g}, outside the "
                    f"problem's limits [{lower:g}, {upper:g}]. Correct one of them."
                )

    def _check_kinds(self) -> None:
        """Refuse parts of another kind before anything is asked of them."""

        def check(what: str, value: object, kind: type | tuple[type, ...], words: str) -> None:
            if not isinstance(value, kind):
                raise ProblemError(
                    f"Problem {self.name!r:.60}: {what} is a {type(value).__name__}, expected "
                    f"{words}."
                )

        check("name", self.name, str, "text")
        check("model", self.model, Model, "a Model")
        for what in ("title", "description"):
            check(what, getattr(self, what), str, "text")
        for what in ("effects", "references"):
            value = getattr(self, what)
            check(what, value, tuple | list, f"a tuple; one alone is ({what[:-1]},)")  # type: ignore[arg-type]
        for effect in self.effects:
            check("one of its effects", effect, Effect, "an Effect, such as Force(...)")
        for reference in self.references:
            check("one of its references", reference, str, "text")
        for what, kind in (
            ("experiments", Experiment),
            ("models", Model),
            ("others", Problem),
            ("published", object),
        ):
            entries = getattr(self, what)
            check(what, entries, Mapping, "a mapping from names")
            for key, value in entries.items():
                check(f"a name in {what}", key, str, "text")
                check(f"{what}[{key!r}]", value, kind, f"a {kind.__name__}")
        check("limits", self.limits, Limits, "Limits(...)")
        if self.records is not None and not callable(self.records):
            raise ProblemError(
                f"Problem {self.name!r}: records is a {type(self.records).__name__}, expected a "
                "function without arguments that returns the Dataset."
            )
        if self.truth is not None:
            check("truth", self.truth, Mapping, "a mapping from names to numbers")
            for key, value in self.truth.items():
                number = isinstance(value, int | float) and not isinstance(value, bool)
                if not number or not math.isfinite(value):
                    raise ProblemError(
                        f"Problem {self.name!r}: the truth of {key!r} is {value!r:.40}. Give "
                        "a number."
                    )

    def _check_effects(self) -> None:
        seen: set[str] = set()
        for effect in self.effects:
            if effect.name in seen:
                raise ProblemError(
                    f"Problem {self.name!r} has two candidates called {effect.name!r}. Rename one."
                )
            seen.add(effect.name)
            if effect.name in self.model.effect_names:
                raise ProblemError(
                    f"Problem {self.name!r} has the candidate {effect.name!r}, which its model "
                    "contains already. Remove it from one of the two."
                )
            try:
                self.model + effect
            except OedSysidError as error:
                raise ProblemError(
                    f"Problem {self.name!r}: the candidate {effect.name!r} does not fit the "
                    f"model. {error}"
                ) from None

    def _check_truth(self) -> None:
        """Refuse true values of parameters that there are not, or beyond their bounds."""
        models = self.models.values()
        everything = [p for owner in models for p in owner.all_parameters]
        everything += [p for effect in self.effects for p in effect.parameters]
        known = dict.fromkeys(p.name for p in everything)
        truth = self.truth or {}
        if unknown := [name for name in truth if name not in known]:
            raise ProblemError(
                f"Problem {self.name!r} states the truth of {unknown[0]!r}, which is a parameter "
                f"of none of its models and candidates.{closest(unknown[0], known)}"
            )
        for parameter in everything:
            true = truth.get(parameter.name)
            if true is not None and not parameter.lower <= true <= parameter.upper:
                raise ProblemError(
                    f"Problem {self.name!r} states the truth of {parameter.name!r} as {true:g}, "
                    f"outside its bounds [{parameter.lower:g}, {parameter.upper:g}]: it could "
                    "never be found. Correct one of them."
                )

    @property
    def channels(self) -> Channels:
        """Inputs and outputs that a record of this system holds."""
        return self.model.channels

    @property
    def variants(self) -> tuple[str, ...]:
        """Names of the models, then of the other problems of the same system."""
        return (*self.models, *self.others)

    def variant(self, name: str) -> Problem:
        """Return the problem with another of its models as the nominal one.

        Candidates that this model contains already are left out.
        """
        if name in self.others:
            return self.others[name]
        if name not in self.models:
            raise ProblemError(
                f"Problem {self.name!r} has no model {name!r}. It has {', '.join(self.variants)} "
                f"({DEFAULT} is the nominal one)." + closest(name, self.variants)
            )
        if name == DEFAULT:
            return self
        model = self.models[name]
        others = {key: other for key, other in self.models.items() if key not in (DEFAULT, name)}
        effects = tuple(e for e in self.effects if e.name not in model.effect_names)
        return replace(self, model=model, models=others, effects=effects)

    def true_model(self) -> Model:
        """Return the model that made simulated data: true values, and the candidates they need.

        Raises
        ------
        ProblemError
            If the truth is not known.
        """
        if self.truth is None:
            raise ProblemError(
                f"The truth of problem {self.name!r} is not known: its data was measured."
            )
        truth, model = self.truth, self.model
        hidden = [e for e in self.effects if any(truth.get(p.name) for p in e.parameters)]
        model = model + hidden
        return model.with_values({n: v for n, v in truth.items() if n in model.parameter_names})

    def effect(self, name: str) -> Effect:
        """Return one candidate effect by name."""
        names = [effect.name for effect in self.effects]
        if name not in names:
            raise ProblemError(
                f"Problem {self.name!r} has no candidate {name!r}. It has "
                f"{', '.join(names) or 'none'}." + closest(name, names)
            )
        return self.effects[names.index(name)]

    def experiment(self, name: str) -> Experiment:
        """Return one experiment by name."""
        if name not in self.experiments:
            raise ProblemError(
                f"Problem {self.name!r} has no experiment {name!r}. It has "
                f"{', '.join(self.experiments) or 'none'}." + closest(name, self.experiments)
            )
        return self.experiments[name]

    def data(self) -> Dataset:
        """Return the measured records of this problem.

        Raises
        ------
        ProblemError
            If it comes without records.
        """
        if self.records is None:
            raise ProblemError(
                f"Problem {self.name!r} comes without records. Read your own with "
                "oed_sysid.read_csv(path, problem.channels), or simulate an experiment."
            )
        try:
            found = self.records()
        except OedSysidError:
            raise
        except Exception as error:
            raise ProblemError(
                f"The records of problem {self.name!r} cannot be had: its function failed with "
                f"{type(error).__name__}: {str(error) or 'no message'}."
            ) from error
        if not isinstance(found, Dataset):
            raise ProblemError(
                f"The records of problem {self.name!r} are a {type(found).__name__}, expected a "
                "Dataset."
            )
        return found

    def notes(self) -> tuple[str, ...]:
        """Say in which units the bare numbers of its models and candidates were read.

        ``0.5*1025*2500*U*v`` is a force if its numbers stand for a density and an
        area; what unit a number stands for follows from where it stands.
        """
        problems = (self, *self.others.values())
        found = [line for one in problems for line in notes(one.models.values(), one.effects)]
        return tuple(dict.fromkeys(found))

    def describe(self) -> str:
        """Return what the problem holds, in words."""
        inputs, outputs = ", ".join(self.model.input_names), ", ".join(self.model.output_names)
        lines = [
            f"{self.name}: {self.title}",
            self.description,
            f"model        {self.model.name}: {len(self.model.free_names)} parameters to "
            f"estimate, {len(self.model.state_names)} states",
            f"inputs       {inputs or 'none'}",
            f"outputs      {outputs}",
            f"models       {', '.join(self.variants)}",
            f"candidates   {', '.join(effect.name for effect in self.effects) or USUAL}",
            f"experiments  {', '.join(self.experiments) or 'none'}",
            *(f"[{number}] {text}" for number, text in enumerate(self.references, start=1)),
            *(f"note: {text}" for text in self.notes()),
        ]
        return "\n".join(line for line in lines if line)
