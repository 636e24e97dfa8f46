"""Commands before a trial: rank, design."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from oed_sysid.cli.reading import read_records
from oed_sysid.cli.terminal import (
    deliver,
    drawn,
    journal,
    note,
    progress,
    write,
)
from oed_sysid.errors import DesignError, FileError, ProblemError

if TYPE_CHECKING:
    from oed_sysid.cli.terminal import Shown
    from oed_sysid.data.dataset import Dataset
    from oed_sysid.design import Design, PredictedTracks, Servo
    from oed_sysid.design.search import Progress as SearchProgress
    from oed_sysid.experiments.experiment import Experiment, Limits
    from oed_sysid.experiments.problem import Problem
    from oed_sysid.physics.model import Model
    from oed_sysid.runtime.journal import Journal

# Starts that are finished.
N_FINISHES = 3


def rank(
    problem: str,
    files: list[str] | None = None,
    experiment: list[str] | None = None,
    noise: list[str] | None = None,
    sea: str | None = None,
    priors: str | None = None,
    model: str | None = None,
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Rank parameters by what experiments tell about them, before fitting anything.

    [bold]Example[/bold]: oed-sysid rank remus_diving_plane --experiment zigzag_5_5 steps
    """
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.information import rank_parameters

    chosen = load_problem(problem, variant=model)
    runs = _runs(chosen, experiment or [], files or [])
    with progress("Ranking"):
        measured = _measured(chosen.model, noise or [])
        known, forces = _priors(measured, priors), _noise(chosen, measured, sea)
        ranking = rank_parameters(measured, runs, noise=forces, priors=known)
    deliver(
        ranking.document(title=chosen.title),
        {"ranking": ranking.to_dict(), "subset": ranking.together.to_dict()},
        picture=partial(drawn, "plot_sensitivity", ranking),
    )


def design(
    problem: str,
    like: str | None = None,
    duration: float | None = None,
    limit: list[str] | None = None,
    certainty: float | None = None,
    uncertainty: float = 0.3,
    criterion: str = "D",
    discriminate: list[str] | None = None,
    reveal: list[str] | None = None,
    family: str = "levels",
    avoid: list[str] | None = None,
    effort: str = "quick",
    after: Path | None = None,
    sea: str | None = None,
    out: Path | None = None,
    card: Path | None = None,
    length: float | None = None,
    servo: list[str] | None = None,
    overrides: Path | None = None,
    bag: Path | None = None,
    model: str | None = None,
    seed: int = 0,
    json_file: Path | None = None,
    html_file: Path | None = None,
    picture: Path | None = None,
    kept_in: Path | None = None,
    fresh: bool = False,
) -> None:
    """Design the manoeuvre that tells most about the parameters, within the limits.

    [bold]Example[/bold]: oed-sysid design auv_diving_plane --duration 120 --max-fin 10
    """
    import numpy as np

    from oed_sysid.cli.limit_words import with_limits
    from oed_sysid.design import (
        Caution,
        Knowledge,
        Search,
        Trial,
        design_experiment,
        predicted_tracks,
    )
    from oed_sysid.design.choices import EFFORTS, named
    from oed_sysid.experiments.problem import load_problem
    from oed_sysid.likelihood.fit import Fit

    chosen = load_problem(problem, variant=model)
    pattern = _pattern(chosen, like)
    limits, said = with_limits(chosen.model, chosen.limits, limit or [])
    for words in said:
        note(f"Limit: {words}.")
    # What cannot be written is said now, not after the work.
    servos = {} if overrides is None else _servos(servo or [], limits)
    _check_bag(bag)
    spread = None if after else uncertainty
    caution = Caution(certainty, spread) if certainty else _usual_caution(after, certainty)
    n_starts, _, n_steps = named("effort", effort, EFFORTS)
    nominal = Fit.load(after) if after else chosen.model
    noise = _noise(chosen, nominal, sea)
    with journal(kept_in, fresh) as keep:
        with progress("Designing") as show:
            found = design_experiment(
                nominal,
                Trial.like(pattern, limits, duration=duration),
                rng=np.random.default_rng(seed),
                criterion=_criterion(chosen, criterion, discriminate or [], reveal or []),
                search=Search(_family(family, avoid or []), *EFFORTS[effort]),
                knowledge=Knowledge(noise=noise),
                caution=caution,
                journal=keep,
                progress=partial(_tell, show, n_starts, n_steps),
            )
            found = _on_other_vehicles(found, limits, spread, seed, keep, show)
        deliver(
            found.document(title=chosen.title),
            found.to_dict(),
            text=None if card is not None else found.sea_trial_card(),
            picture=partial(drawn, "figure_design", found),
        )
        if out is not None:
            found.write_csv(out)
            note(f"Written: {out}")
        if card is not None:
            show_track = partial(
                predicted_tracks, found.model, found.experiment, spread=spread, sea=found.sea,
                prior=found.prior, rng=np.random.default_rng(seed), length=length,
            )  # fmt: skip
            _card(found, partial(keep.once, "track", show_track), card, chosen.title)
        _write_played(found, overrides, servos, bag)


def _on_other_vehicles(
    found: Design, limits: Limits, spread: float | None, seed: int, keep: Journal, show: Shown
) -> Design:
    """State how likely the limits are kept and, at sea, how accurate other vehicles become."""
    from dataclasses import replace

    import numpy as np

    from oed_sysid.design import accuracy_range, assess_limits

    if found.assurance is None:
        show.say("simulating other vehicles")
        stated = partial(
            assess_limits, found.model, found.experiment, limits=limits, spread=spread,
            prior=found.prior, rng=np.random.default_rng(seed), vehicles=200, sea=found.sea,
        )  # fmt: skip
        found = replace(found, assurance=keep.once("assurance", stated))
    if found.sea is not None:
        show.say("accuracy on other vehicles")
        other = partial(
            accuracy_range, found.model, found.experiment, rng=np.random.default_rng(seed),
            noise=found.sea, spread=spread, prior=found.prior,
        )  # fmt: skip
        found = replace(found, spread=keep.once("accuracy", other))
    return found


def _write_played(
    found: Design, overrides: Path | None, servos: dict[str, Servo], bag: Path | None
) -> None:
    """Write the commands for an autopilot: as servo pulses, or as a bag."""
    from oed_sysid.design import write_bag, write_overrides

    played = found.trajectory.times, found.trajectory.inputs
    if overrides is not None:
        note(f"Written: {write_overrides(overrides, found.model, *played, servos=servos)}")
    if bag is not None:
        note(f"Written: {write_bag(bag, found.model, *played)}")


def _tell(show: Shown, n_starts: int, n_steps: int, now: SearchProgress) -> None:
    show.say(f"designing: start {now.start + 1}, round {now.round + 1}, {now.value:.4g}")
    # After the starts the best three are finished, in up to twice the rounds each.
    rounds = (n_starts + 2 * N_FINISHES) * n_steps
    done = min(now.start, n_starts) + 2 * max(now.start - n_starts, 0)
    show.share((done * n_steps + now.round + 1) / rounds, at_most=True)


def _check_bag(bag: Path | None) -> None:
    if bag is not None and bag.exists():
        raise FileError(f"{str(bag)!r} exists already. Name a folder that does not.")


def _usual_caution(after: Path | None, certainty: float | None) -> str | None:
    """How limits are kept where nobody said how surely: after a fit they are, else not."""
    return "auto" if after is not None and certainty is None else None


def _card(
    design: Design, tracks: Callable[[], PredictedTracks | None], path: Path, title: str
) -> None:
    """Write the card as text, as a page or as one sheet of A4."""
    from oed_sysid.results import figure_card, save_figure

    kind = path.suffix.lower()
    if kind == ".txt":
        write(design.sea_trial_card() + "\n", path)
        return
    if kind == ".html":
        design.card(tracks(), title=title).write(path)
    else:
        save_figure(figure_card(design, tracks()), path)
    note(f"Written: {path}")


def _servos(given: list[str], limits: Limits) -> dict[str, Servo]:
    """Servos of the inputs, from one end of their limits to the other."""
    from oed_sysid.design import Servo

    found = {}
    for text in given:
        name, _, channel = text.partition("=")
        if name not in limits.inputs or not channel.isdigit():
            raise DesignError(
                f"--servo {text}: write INPUT=CHANNEL, an input with a range: "
                f"{', '.join(limits.inputs)}."
            )
        found[name] = Servo(int(channel), *limits.inputs[name])
    if not found:
        raise DesignError("--overrides needs the channels of the inputs: --servo fin_command=1.")
    return found


def _pattern(problem: Problem, name: str | None) -> Experiment:
    """Experiment that lends what the design leaves open: the named one, or the first."""
    if name is not None:
        return problem.experiment(name)
    if not problem.experiments:
        raise ProblemError(f"Problem {problem.name!r} has no experiment to take settings from.")
    return next(iter(problem.experiments.values()))


def _measured(model: Model, noise: list[str]) -> Model:
    """The model with other standard deviations of its outputs."""
    levels = {}
    for text in noise:
        name, _, number = text.partition("=")
        try:
            levels[name] = float(number)
        except ValueError:
            raise DesignError(f"--noise {text!r} is no OUTPUT=STD. Write r=0.001, say.") from None
    if unknown := [name for name in levels if name not in model.output_names]:
        raise DesignError(
            f"--noise names {unknown[0]!r}; outputs are {', '.join(model.output_names)}."
        )
    outputs = tuple(replace(o, noise_std=levels.get(o.name, o.noise_std)) for o in model.outputs)
    return replace(model, outputs=outputs)


def _priors(model: Model, words: str | None) -> Any:
    """What is known besides the runs: nothing, the problem's priors, or values to a share."""
    if words in (None, "none", "model"):
        return "model" if words == "model" else None
    try:
        share = float(words or "")
    except ValueError:
        share = 0.0
    if not share > 0:
        raise DesignError(f"--priors is {words!r}. Give none, model, or a share such as 0.3.")
    return {p.name: share * p.reference for p in model.free_parameters}


def _noise(problem: Problem, nominal: Any, sea: str | None) -> Any:
    """Noise of a sea in words; None leaves it to the fit, or to the declared levels."""
    if sea is None:
        return None
    from oed_sysid.information import sea_noise, sea_words
    from oed_sysid.likelihood.fit import Fit

    model = nominal.model if isinstance(nominal, Fit) else nominal
    found = sea_noise(model, sea, problem.experiments.values())
    note(f"Random forces: {sea_words(found)}.")
    return found


def _criterion(problem: Problem, name: str, rivals: list[str], hidden: list[str]) -> Any:
    from oed_sysid.design import Detect, Discriminate
    from oed_sysid.design.choices import CRITERIA, named
    from oed_sysid.evidence.usual import equipped

    if rivals and hidden:
        raise DesignError("Give --discriminate or --reveal: one run has one aim.")
    if rivals or hidden:
        problem = equipped(problem)
    if rivals:
        return Discriminate([problem.effect(rival) for rival in rivals])
    if hidden == ["all"]:
        if not problem.effects:
            raise DesignError(f"Problem {problem.name!r} has no candidate effect. Name none.")
        return Detect(problem.effects)
    if hidden:
        return Detect([problem.effect(one) for one in hidden])
    return named("criterion", name, CRITERIA)()


def _family(name: str, avoid: list[str]) -> Any:
    from oed_sysid.design.choices import FAMILIES, named

    if avoid and name != "multisine":
        raise DesignError("Frequencies can be avoided by sines only: add --family multisine.")
    try:
        bands = [(float(low), float(high)) for low, _, high in (b.partition(":") for b in avoid)]
    except ValueError:
        raise DesignError(f"--avoid {' '.join(avoid)}: write bands as 0.1:0.2, in Hz.") from None
    settings = {"forbidden": bands} if bands else {}
    return named("family", name, FAMILIES)(**settings)


def _runs(
    problem: Problem, experiments: list[str], records: list[str]
) -> Dataset | list[Experiment]:
    if records and experiments:
        raise ProblemError("Give either --experiment or records, not both.")
    if records:
        return read_records(records, problem)
    names = experiments or list(problem.experiments)
    if not names:
        raise ProblemError(
            f"Problem {problem.name!r} has no experiments. Add one to its problem.py, or give "
            "records."
        )
    return [problem.experiment(name) for name in names]
