r"""Whether a model fits: what a fit's own residuals say against its claims.

Let :math:`\epsilon_k` be the one-step errors of an output over their stated standard
deviation (``fit.whitened``), ``n`` of them. If model and noise are right they are white, normal
and of variance one. Tested are

*Noise level.* The factor by which the declared level is wrong is the root of the variance, and
of the variance of third differences, which slow residuals do not enter,

.. math:: f^2 = \frac{1}{n - m}\sum_k \epsilon_k^2, \qquad
    f_\Delta^2 = \operatorname{median}\,(\Delta^3 \epsilon)_k^2 \,/\, (0.4549 \cdot 20),

with standard errors :math:`1/\sqrt{2n}` and :math:`1.5/\sqrt{n}` of their logarithms and ``m``
the output's share of the unknowns. Large ``f`` with small :math:`f_\Delta` is
autocorrelation, not a larger standard deviation.

*Autocorrelation.* Ljung-Box statistic and effective sample size
(:mod:`oed_sysid.likelihood.information`).

*Narrow band.* Innovations with power about one frequency, as waves leave them
(:mod:`oed_sysid.likelihood.covariance`).

*Spikes* and *delays* are found by :mod:`oed_sysid.likelihood.noise_levels` and
:mod:`oed_sysid.likelihood.departures`.

*Integration.* Root mean square change of the outputs when the step is halved, in units of noise.

Every kind of concern has a function that finds it (:data:`CHECKS`) and a sentence, with what it
takes, in ``concerns.toml``.

What none of this can see: errors that the parameters absorb without a trace in the residuals.

How much of every output a fitted model explains on its own, and whether that is enough.

.. math::
    s^2 = \frac{\sum_k (y_k - \hat y_k)^2}{\sum_k (y_k - \bar y)^2}

with the model run on its own, :math:`\hat y`. A constant has :math:`s = 1`. Estimated noise, of
sensors or of forces, can absorb whatever a model does not explain, so that the misfit is one and
the iterations converge. :func:`grave` says so.

Whole runs of a vehicle that disturbances carry away, an unstable one above all, say nothing. There
the model's answer to the inputs counts, in innovations :math:`e` under the noise that the fit
states: with :math:`e^0` those where all inputs stay at their means,

.. math:: d^2 = \sum_k (e^0_k - e_k)^2 / S_k, \qquad g = \sum_k ({e^0_k}^2 - e_k^2) / S_k .

An output is explained where the answer shows, :math:`d > C`, and the records favour it,
:math:`g > 0`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain, islice
from typing import Any, TypeVar

import numpy as np
from scipy.special import chdtri, ndtr, stdtr

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import MINIMUM_SAMPLES
from oed_sysid.likelihood import noise_levels
from oed_sysid.likelihood.between_records import CHANCE, FEWEST, WORTH_TELLING
from oed_sysid.likelihood.covariance import Peak, clear_peaks
from oed_sysid.likelihood.departures import (
    CLEARLY,
    LEVERS,
    TWOFOLD,
    change_of_outputs,
    clear_departure,
    clear_starts,
    estimate_departures,
    outputs_of,
)
from oed_sysid.likelihood.disturbances import commands, declared_noise
from oed_sysid.likelihood.estimate import ActuatorStart, Departure, Estimate, once_a_fit
from oed_sysid.likelihood.information import COLOUR_LIMIT, Whiteness
from oed_sysid.likelihood.input_factors import input_factors
from oed_sysid.likelihood.integration import step_change
from oed_sysid.likelihood.laws import departures_beside, laws_of, loss_without, posed_again
from oed_sysid.likelihood.parabola import steepness
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import BEYOND, IMMATERIAL, MATERIAL, NEGLIGIBLE
from oed_sysid.runtime.display import TWO_SIDED_95, as_dict
from oed_sysid.runtime.tables import tables
from oed_sysid.text.units import shown_unit

# Sentences of every kind of concern, and what differs in them from case to case.
_TABLE = tables(__file__, "concerns")
SAYS, SO = _TABLE["says"], _TABLE["so"]
# A fit goes through the verdict as what it is.
Judged = TypeVar("Judged", bound=Estimate)
# Beyond so many times its scale no value is physical, and none that the records do not show.
UNPHYSICAL, UNSEEN = 1e8, 1e4
# A model that leaves this share of the squares about the mean explains nothing.
BARELY = 1.0 - NEGLIGIBLE
# What a fit that ended early asks first; with the check at hand `advised` says what it found.
LOOK = "See what the check of the log says (check, on the command line oed-sysid check)."
# Where positions and accelerations are measured, on either side of the origin; how an input reads
# that acts with more than was logged.
SIDES = {
    "ahead": ("ahead of", "astern of"),
    "to starboard": ("to starboard of", "to port of"),
    "below": ("below", "above"),
    "acts off": ("low", "high"),
}
# Kinds that make a fit not converged, worst first, and those with which it may converge and must
# still not be used.
FATAL = ("runaway", "integration", "degenerate")
GRAVE = ("input_factor", "absorbed", "degenerate", "few_samples")


@dataclass(frozen=True)
class Concern:
    """One way in which a fit is not what it claims.

    Attributes
    ----------
    kind : str
        ``noise_level``, ``autocorrelation``, ``narrow_band``, ``spikes``, ``delay``, ``offset``,
        ``zero``, ``scale``, ``clock``, ``lever``, ``actuator_start``, ``per_record_follows``,
        ``records_differ``, ``input_noise``, ``input_factor``, ``absorbed``, ``process_noise``,
        ``constraint``, ``curved``, ``integration``, ``finer_step``, ``runaway``, ``degenerate`` or
        ``few_samples``.
    signal : str
        Output, input, state or parameter; empty where it is the whole fit.
    record : str
        Empty where it is all records.
    size : float
        A factor of the level (``noise_level``, ``absorbed``), the share of independent samples
        (``autocorrelation``), a number of samples (``spikes``), seconds (``delay``,
        ``narrow_band``), m (``lever``), the unit of the signal (``offset``, ``zero``,
        ``actuator_start``), a share (``scale``, ``clock``), a correlation (``per_record_follows``),
        a factor of the standard error (``records_differ``) or of the rise that it says
        (``curved``), the true input over the logged one
        (``input_factor``), noise levels (``integration``, ``input_noise``), multiples of the scale
        (``runaway``) or of the signal (``degenerate``), samples per unknown (``few_samples``),
        standard errors (``constraint``, ``finer_step``), the score test's 2 delta ln L
        (``process_noise``).
    text : str
        What was expected, what was found, what to do.

    Examples
    --------
    >>> one = Concern("few_samples", "", "", 12.0, "12 samples for 4 parameters.")
    >>> one.kind, one.text
    ('few_samples', '12 samples for 4 parameters.')
    """

    kind: str
    signal: str
    record: str
    size: float
    text: str

    to_dict = as_dict("kind", "signal", "record", "size", "text")


@dataclass(frozen=True)
class Found:
    """One thing that speaks against a fit: its size, where it is, and what its sentence names.

    ``row`` is that of the sentence, where it is not the kind's.
    """

    size: float
    signal: str = ""
    record: str = ""
    facts: Mapping[str, Any] = field(default_factory=dict)
    row: str = ""


def concerns_of(fit: Estimate, *kinds: str) -> tuple[Concern, ...]:
    """Concerns of some kinds, in the order of :data:`CHECKS`."""
    return tuple(
        concern for kind, find in CHECKS if kind in kinds for concern in _in_words(kind, find(fit))
    )


def _in_words(kind: str, found: Iterable[Found]) -> Iterator[Concern]:
    """Concerns of a kind, by its sentence or that of another row of the table."""
    for one in found:
        text = SAYS[one.row or kind].format(**vars(one), **one.facts)
        yield Concern(kind, one.signal, one.record, float(one.size), text)


def with_verdict(fit: Judged) -> Judged:
    """The same fit; its status is not ``converged`` where its values must not be used."""
    if fit.status.code in ("stalled", "iterations"):
        steps = " ".join(concern.text for concern in concerns_of(fit, "integration"))
        advice = f"{fit.status.advice} {LOOK} {steps}".strip()
        return replace(fit, status=replace(fit.status, advice=advice))
    if not fit.status.ok:
        return fit
    for worst in fatal(fit):
        if worst.kind != "degenerate" or _stands_still(fit):
            return replace(fit, status=replace(fit.status, code=worst.kind, advice=worst.text))
    return fit


def judge(fit: Estimate) -> tuple[Concern, ...]:
    """Everything that speaks against a fit, the gravest first.

    Parameters
    ----------
    fit : Estimate
        With trajectories; of one that diverged only the runaway values are named, and too few
        samples, which may be why.
    """
    found = fatal(fit)
    if any(concern.kind == "runaway" for concern in found):
        return (*found, *concerns_of(fit, "few_samples"))
    if not _has_numbers(fit):
        return found
    return (*found, *concerns_of(fit, *({kind for kind, _ in CHECKS} - set(FATAL))))


def fatal(fit: Estimate) -> tuple[Concern, ...]:
    """Concerns that forbid the use of the values: runaway, integration, degenerate."""
    if not np.isfinite(fit.cost) and not _has_numbers(fit):
        return ()
    return concerns_of(fit, "runaway") or concerns_of(fit, "integration", "degenerate")


def grave(fit: Estimate, concerns: Sequence[Concern]) -> tuple[Concern, ...]:
    """What makes a fit useless although it converged: the noise holds what a model should.

    Parameters
    ----------
    fit : Estimate
    concerns : sequence of Concern
        What speaks against it, as :func:`judge` finds it.

    Returns
    -------
    tuple of Concern
        ``input_factor``, ``absorbed``, ``degenerate`` and ``few_samples``; empty where the fit can
        be used, or where its status says already that it cannot.
    """
    if not fit.status.ok:
        return ()
    found = [concern for concern in concerns if concern.kind in GRAVE]
    named = {concern.signal for concern in found}
    more = _in_words("degenerate", _unexplained(fit))
    return (*found, *(concern for concern in more if concern.signal not in named))


def _has_numbers(fit: Estimate) -> bool:
    """Whether the model, or the filter that goes along with the records, diverged."""
    if fit.innovations is None:
        return all(np.isfinite(part).all() for part in fit.predictions)
    return all(
        np.isfinite(part[np.isfinite(record.outputs)]).all()
        for part, record in zip(fit.innovations, fit.dataset, strict=True)
    )


# -- the noise ---------------------------------------------------------------------


def _levels(fit: Estimate) -> Iterator[Found]:
    """Declared noise levels that are not those found."""
    declared = noise_levels.given_levels(fit.model.outputs)
    if fit.innovations is None:  # those that it took where it was given others
        declared = np.where(fit.sigma_estimated, declared, fit.sigma)
    share = max(1.0 - fit.n_unknowns / max(fit.n_observations, 1), 0.1)
    # Of those that were estimated, which in place of what the records contradict.
    doubted = np.isnan(noise_levels.believed_levels(fit.model.outputs, fit.dataset))
    for column in np.flatnonzero(np.isfinite(declared) & (doubted | ~fit.sigma_estimated)).tolist():
        output, told = fit.model.outputs[column], _level(fit, column, share)
        if told is None:
            continue
        factor, error, tests = told
        # Declared is the noise of one measurement, white and autocorrelated together. A filter that
        # was told less white noise than there is finds the rest elsewhere.
        slow, whole = fit.noise.colour[column], fit.noise.sensors[column]
        factor *= float(whole / declared[column])
        if slow > 0.0:
            rest = fit.noise_std.get(f"colour of {output.name} level", 0.0)
            error = float(np.hypot(error, rest * (slow / whole) ** 2))
        if abs(np.log(factor)) < max(BEYOND * error, np.log1p(MATERIAL)):
            continue
        departure = departure_of(fit) if factor > 1.0 else None
        # What explains more than it leaves is no noise, in whatever it bends.
        if departure is not None and departure.share > 0.5:
            continue
        yield Found(factor, output.name, facts={
            "declared": declared[column], "found": factor * declared[column], "unit": output.unit,
            "low": factor * np.exp(-TWO_SIDED_95 * error),
            "high": factor * np.exp(TWO_SIDED_95 * error),
            "so": _so(factor, slow, tests=tests, own=bool(fit.sigma_estimated[column])),
        })  # fmt: skip


def _so(factor: float, slow: float, *, tests: bool, own: bool) -> str:
    """What a level that is not the declared one does to standard errors, and what to do."""
    case = "of_tests" if tests and factor > 1.0 else "with_memory" if slow > 0.0 else "white"
    case = "estimated" if own else case
    return SO[case].format(wrong="small" if factor > 1.0 else "large")


def _level(fit: Estimate, column: int, share: float) -> tuple[float, float, bool] | None:
    """Factor of the level, error of its logarithm, whether of tests alone; None if nothing tells.

    ``share`` is that of the samples which are not used up by unknowns.
    """
    present = np.concatenate([part[np.isfinite(part[:, column]), column] for part in fit.whitened])
    n = len(present)
    if n < 20:
        return None
    # A spike is not a level: what lies beyond four deviations is left out.
    size = max(noise_levels.robust_deviation(present), 1e-12)
    kept = present[np.abs(present) < 4.0 * size]
    if not len(kept):
        return None
    whole = float(np.sqrt(np.mean(kept**2) / share))
    ordered = [part[:, column] for part in fit.series]
    tests = not any(np.isfinite(part).any() for part in ordered)
    fast = whole if tests else noise_levels.fast_level(ordered)
    if not fast > 0.0:
        return None
    if whole > 1.0 and fast < whole * (1.0 - 2.5 * noise_levels.DIFFERENCE_ERROR / np.sqrt(n)):
        # Slow residuals raise the variance, not the level of the white noise.
        return max(fast, 1.0), float(noise_levels.DIFFERENCE_ERROR / np.sqrt(n)), tests
    return whole, float(np.sqrt(0.5 / n)), tests


@once_a_fit
def _peaks(fit: Estimate) -> list[Peak]:
    """Outputs whose innovations have a period of their own."""
    if fit.innovations is None:
        return []
    return clear_peaks(fit.series, tuple(fit.dataset), fit.model.output_names)


def _narrow_bands(fit: Estimate) -> Iterator[Found]:
    """Peaks that are no sea of the fit.

    Within an octave of one it is the shape of the spectrum that is not quite the assumed one, which
    standard errors hold.
    """
    periods = [float(sea.period or 0.0) for sea in fit.noise.seas]
    for peak in _peaks(fit):
        if any(0.5 < peak.period / period < 2.0 for period in periods):
            continue
        yield Found(peak.period, peak.output, facts={"ratio": peak.ratio})


def _zeros(fit: Estimate) -> Iterator[Found]:
    """Sensors that are off by more than any zero is trusted to where one is off."""
    noise = fit.noise
    far = np.flatnonzero(noise.zeros > (1.0 + MATERIAL) * noise.white)
    if not far.size:
        return
    problem, unknowns = posed_again(fit)
    # Of a constant the filter knows at the last sample what all of them say.
    last = [part.path[-1] for part in problem.passes(unknowns, columns=False)]
    off = np.array(last)[:, -len(problem.levels.coloured) :]
    for column in far:
        own = off[:, problem.levels.coloured.tolist().index(column)]
        factor, unit = shown_unit(fit.model.outputs[column].unit)
        span = dict.fromkeys(f"{factor * one:.3g}" for one in (own.min(), own.max()))
        facts = {"span": " to ".join(span), "unit": unit}
        name = fit.model.output_names[column]
        yield Found(float(own.mean()), name, facts=facts)


def _autocorrelations(fit: Estimate) -> Iterator[Found]:
    """One-step errors that remember, after all the noise that the fit knows."""
    found = [one for name, tests in fit.whiteness().items() if (one := _memory(fit, name, tests))]
    periodic = {peak.output for peak in _peaks(fit)} if found else set()
    yield from (one for one in found if one.signal not in periodic)


def _memory(fit: Estimate, name: str, tests: Sequence[Whiteness]) -> Found | None:
    """Correlated one-step errors of an output."""
    n = sum(test.n_samples for test in tests)
    effective = sum(test.effective_samples for test in tests)
    if not n or effective > COLOUR_LIMIT * n or not _remember(tests, n):
        return None
    what = "Innovations" if fit.innovations is not None else "Residuals"
    beside = "too_small" if fit.noise.has_forces else "too_small_without_forces"
    return Found(effective / n, name, facts={
        "what": what, "n": n, "effective": effective,
        "todo": SO["sandwich" if fit.coloured else beside],
    })  # fmt: skip


def _remember(tests: Sequence[Whiteness], n: int) -> bool:
    """Whether chance seldom makes errors of ``n`` samples so correlated."""
    lag_one = sum(test.lag_one * test.n_samples for test in tests) / n
    chance = len(tests) * min(test.p_value for test in tests)
    return bool(chance < 2.0 * ndtr(-BEYOND) or abs(lag_one) * np.sqrt(n) > BEYOND)


def _process_noise(fit: Estimate) -> Iterator[Found]:
    """Process noise that acts, but whose estimation failed."""
    test = fit.process_noise
    if test is not None and test.failed:
        yield Found(test.statistic, facts={"failed": test.failed})


def _binding(fit: Estimate) -> Iterator[Found]:
    """Bounds and constraints that the records would leave."""
    for one in fit.binding:
        name = one.text.split()[0]
        yield Found(one.distance, name if name in fit.names else "", facts=vars(one))


def _absorbed(fit: Estimate) -> Iterator[Found]:
    """Estimated levels that hold what the model does not explain."""
    if fit.innovations is not None or not fit.sigma_estimated.any():
        return
    floor, _ = noise_levels.white_levels(fit.dataset)
    for column, (name, (effective, n)) in enumerate(fit.effective_samples().items()):
        if not fit.sigma_estimated[column] or n < 20 or not floor[column] > 0:
            continue
        factor = float(fit.sigma[column] / floor[column])
        if factor > WORTH_TELLING and effective < COLOUR_LIMIT * n:
            yield Found(factor, name, facts={
                "sigma": fit.sigma[column], "floor": floor[column],
                "unit": fit.model.outputs[column].unit,
            })  # fmt: skip


# -- spikes ------------------------------------------------------------------------


def _excluded(fit: Estimate) -> Iterator[Found]:
    """Spikes that the fit has left out."""
    for name, (count, total) in fit.excluded.items():
        yield Found(count, name, facts={"total": total}, row="excluded")


def _spikes(fit: Estimate) -> Iterator[Found]:
    """Isolated outliers."""
    masks = noise_levels.spike_masks(fit.series, declared=~fit.sigma_estimated)
    sizes = noise_levels.spike_sizes(fit.series)
    every, marked, away = (np.vstack(parts) for parts in (fit.series, masks, sizes))
    for column, name in enumerate(fit.model.output_names):
        values = away[marked[:, column], column]
        n, count, up = np.isfinite(every[:, column]).sum(), len(values), int((values > 0).sum())
        if not count:
            continue
        one_sided = count > 4 and min(up, count - up) <= 0.1 * count
        yield Found(count, name, facts={
            "n": n, "side": ", one-sided" if one_sided else "",
            "largest": np.max(np.abs(values)), "expected": 2.0 * n * float(ndtr(-4.0)),
        })  # fmt: skip


# -- delays, starts, inputs: simulations -------------------------------------------------


def _own_residuals(fit: Estimate) -> bool:
    """Whether the model's own residuals, not those of its steps, tell what parameters bent to."""
    resolved = fit.status.code != "integration"
    return resolved and fit.innovations is None and bool(fit.names)


def _departure(kinds: Sequence[str], fit: Estimate) -> Iterator[Found]:
    """The departure of a signal that explains most, where it is of these kinds."""
    best = departure_of(fit)
    if best is not None and best.kind in kinds:
        yield Found(best.size, best.signal, facts=_facts_of(best, fit))


@once_a_fit
def departure_of(fit: Estimate) -> Departure | None:
    """What explains most of a fit's departures: each kind of concern asks for the same."""
    if fit.innovations is None:
        return clear_departure(fit, estimate_departures(fit)) if _own_residuals(fit) else None
    beside = departures_beside(fit)
    asked = fit.process_noise
    before = None if asked is None else asked.departure
    if asked is None or before is None:
        # What makes forces follow the motion is physics, and looks like a sensor that is wrong.
        found = clear_departure(fit, beside)
        return None if found is None or laws_of(fit) else found
    # Disturbance forces absorb a departure, so that its size is that before them; and what an
    # autopilot does about them is none, so that it has to show beside them as well, unless it needs
    # no forces to be the likelier of the two.
    return before if asked.departure_likelier or _shows(before, beside) else None


def _shows(before: Departure, beside: Sequence[Departure]) -> bool:
    """Whether a departure is clear, with its sign, beside the process noise as well."""
    same = (one for one in beside if (one.signals, one.kind) == (before.signals, before.kind))
    return any(one.size * np.sign(before.size) > TWO_SIDED_95 * one.std for one in same)


def _facts_of(one: Departure, fit: Estimate) -> dict[str, Any]:
    """What the sentences name of a departure."""
    units = {output.name: output.unit for output in fit.model.outputs}
    units |= {channel.name: channel.unit for channel in fit.model.inputs}
    factor, unit = shown_unit(units[one.signal]) if one.kind.endswith("off") else (1.0, "")
    many = one.size > 0
    logged = "are logged" if one.together else "is logged"
    sides = SIDES.get(one.kind, ("high", "low"))
    return {
        "what": " and ".join(one.signals), "verb": "acts" if one.kind == "acts late" else logged,
        "unit": unit, "value": abs(factor * one.size), "error": TWO_SIDED_95 * factor * one.std,
        "late": "late" if many else "early", "side": sides[0 if many else 1],
        "turned": ", as of the other sign," * (one.kind == "scale" and one.size < -1.0),
        "share": 100.0 * one.size, "doubt": 100.0 * TWO_SIDED_95 * one.std,
        "or": f", or {' or '.join(one.rivals)}," if one.rivals else "",
        "cure": ", or add a delay or lag to the model" * many,
    }  # fmt: skip


def _starts(fit: Estimate) -> Iterator[Found]:
    """Actuators that did not begin at their first command, the clearest record of each."""
    clear = () if fit.process_noise is None else fit.process_noise.actuator_starts
    clear = clear or (clear_starts(fit) if _own_residuals(fit) else ())
    units = {channel.name: channel.unit for channel in fit.model.inputs}
    first: dict[tuple[str, str], ActuatorStart] = {}
    for one in clear:
        first.setdefault((one.effect, one.signal), one)
    for one in first.values():
        more = len({other.record for other in clear if other.effect == one.effect}) - 1
        factor, shown = shown_unit(units.get(one.signal, ""))
        yield Found(one.size, one.signal, one.record, facts={
            "others": f" and {more} more records" if more else "", "effect": one.effect,
            "value": factor * one.size, "error": TWO_SIDED_95 * factor * one.std, "unit": shown,
        })  # fmt: skip


def _inputs(fit: Estimate) -> Iterator[Found]:
    """Logged inputs whose estimated noise is clear, and reaches the outputs.

    The vehicle answers to the true input, not to its log; a fit to the log lets coefficients
    shrink and errors look white (Fuller 1987, *Measurement error models*). How rough a log is does
    not tell: gusts, a servo's steps and a helmsman's answers are as white, and move the vehicle.
    Noise that the outputs do not ask for is none. Where it was estimated beside forces it explains
    what these do not; where in their place, they explain as much, and nothing tells which acts.
    """
    known = {process.place for process in declared_noise(fit.model)}
    logged = {place.name: place.channel for place in commands(fit.model)}
    names, rng = fit.model.input_names, np.random.default_rng(0)
    for place, level in zip(fit.noise.places, fit.noise.force, strict=True):
        name = logged.get(place, "")
        if place in known or name not in names or not level > 0.0:
            continue
        # At zero, a bound, half of all statistics are none.
        if not loss_without(fit, place) > chdtri(1, 2.0 * noise_levels.RARE) or laws_of(fit):
            continue
        column = names.index(name)
        size = change_of_outputs(fit, partial(_with_input_noise, fit, column, level, rng))
        if IMMATERIAL < size < np.inf:
            beside = any(not one.startswith("actuator ") for one in fit.noise.places)
            yield Found(size, name, facts={
                "level": level, "unit": fit.model.inputs[column].unit,
                "how": SO["beside_forces" if beside else "for_forces"],
            })  # fmt: skip


def _with_input_noise(
    fit: Estimate, column: int, level: float, rng: np.random.Generator, index: int
) -> np.ndarray:
    """Outputs of a record whose input is noisier than its log."""
    moved = fit.dataset[index].inputs.copy()
    moved[:, column] += level * rng.standard_normal(len(moved))
    return outputs_of(fit, index, moved)


def _input_factors(fit: Estimate) -> Iterator[Found]:
    """Inputs that act reversed, or in another unit, than the start values say."""
    if fit.nominal:
        for one in input_factors(fit, fit.nominal):
            names = " and ".join(one.reading.names)
            yield Found(one.reading.factor, names, facts={"text": one.text})


def _curved(fit: Estimate) -> Iterator[Found]:
    """The parameter that is told least, where its error is no plus or minus."""
    known = steepness(fit) if fit.status.ok else None
    if known is None:
        return
    name, rises = known
    far = np.abs(np.log(np.maximum(rises, NEGLIGIBLE**2)))
    worst = int(np.argmax(far))
    if far[worst] > 2.0 * np.log(TWOFOLD):
        facts = {"side": ("below", "above")[worst], "parameter": name}
        yield Found(float(rises[worst]), name, facts=facts)


# -- the trajectory ------------------------------------------------------------------


def _runaway(fit: Estimate) -> Iterator[Found]:
    """The first value far beyond any scale."""
    yield from islice(chain(_far_values(fit), _far_outputs(fit)), 1)


def _far_values(fit: Estimate) -> Iterator[Found]:
    """Parameters beyond what can be physical."""
    for name, value in fit.values.items():
        parameter = fit.model.parameter(name)
        scale = parameter.scale or 0.0
        if name in fit.nominal:
            scale = replace(parameter, value=fit.nominal[name]).magnitude
        # Without a scale: beyond what any coefficient in SI units can be.
        most = UNPHYSICAL if np.isfinite(fit.std_errors.get(name, 0.0)) else UNSEEN
        limit = most * scale if scale > 0 else 1e15
        if not abs(value) <= max(limit, 1.0):
            cure = _scale_to_say(parameter, fit, scale)
            facts = {"value": value, "unit": f" {parameter.unit}".rstrip(), "cure": cure}
            yield Found(abs(value) / (scale or 1.0), name, facts=facts)


def _scale_to_say(parameter: Parameter, fit: Estimate, taken: float) -> str:
    """What to say of a parameter that starts at zero, whose size was ``taken``; often nothing."""
    name = parameter.name
    if not taken > 0.0 or parameter.scale is not None or fit.nominal[name]:
        return ""
    return SO["scale"].format(taken=taken, name=name, size=abs(fit.values[name]))


def _far_outputs(fit: Estimate) -> Iterator[Found]:
    """Outputs of the model, or innovations, beyond all that was measured."""
    spread = noise_levels.signal_spread(fit.dataset)
    highest = np.nanmax(np.abs(np.vstack([r.outputs for r in fit.dataset])), axis=0, initial=0.0)
    # An unstable vehicle leaves every scale on its own; what counts is the filter's error.
    parts = fit.predictions if fit.innovations is None else fit.innovations
    tops = np.max([np.max(np.abs(np.nan_to_num(p)), axis=0, initial=0.0) for p in parts], axis=0)
    sizes = tops / np.max([highest, spread, fit.sigma], axis=0)
    for column in np.flatnonzero(sizes > UNPHYSICAL):
        output = fit.model.outputs[column]
        facts = {"value": tops[column], "unit": f" {output.unit}".rstrip(), "cure": ""}
        yield Found(sizes[column], output.name, facts=facts)


def _integration(fit: Estimate) -> Iterator[Found]:
    """Trajectories that depend on the integration step."""
    if _has_numbers(fit) and (change := step_change(fit)).size >= MATERIAL:
        stiff = "" if fit.model.integrator == "implicit" else SO["implicit"]
        step = fit.model.step
        facts = {"finer": 0.5 * step, "step": step, "stiff": stiff, "limit": MATERIAL}
        yield Found(change.size, change.output, change.record, facts)


def _finer(fit: Estimate) -> Iterator[Found]:
    """A fit by finer steps than those of its model."""
    told = fit.integration
    if told is not None:
        by = f": {told.parameter} by {told.shift:.2g} standard errors" if told.parameter else ""
        facts = {"step": fit.model.step, "own": told.step, "by": by}
        yield Found(told.shift, told.parameter, facts=facts)


@dataclass(frozen=True, eq=False)
class _Motion:
    """How measured signals move, and what the model on its own leaves of it, by output.

    Sums of squares ``(n_outputs,)``: about the mean of each record of the signals ``own`` and of
    the model ``moved``, and of their difference ``left``.
    """

    count: np.ndarray
    own: np.ndarray
    moved: np.ndarray
    left: np.ndarray

    @classmethod
    def of(cls, fit: Estimate) -> _Motion:
        """Of all records."""
        sums = np.zeros((4, len(fit.model.outputs)))
        for record, part in zip(fit.dataset, fit.predictions, strict=True):
            for column, series in enumerate(record.outputs.T):
                seen = np.isfinite(series)
                signal, model = series[seen], part[seen, column]
                if not len(signal):
                    continue
                with np.errstate(over="ignore", invalid="ignore"):
                    apart = signal - signal.mean(), model - model.mean(), signal - model
                    squares = (part @ part for part in apart)
                    sums[:, column] += (len(signal), *squares)
        return cls(*sums)

    @property
    def share(self) -> np.ndarray:
        """Root of the squares that are left over the squares that were there; NaN of nothing."""
        with np.errstate(divide="ignore", invalid="ignore"):
            found = np.sqrt(self.left / self.own)
        return np.where(self.own > 0.0, np.nan_to_num(found, nan=np.inf), np.nan)

    def beyond(self, noise: np.ndarray) -> np.ndarray:
        """Which signals move by more than their noise."""
        return self.own > (CLEARLY * noise) ** 2 * self.count


def _degenerate(fit: Estimate) -> Iterator[Found]:
    """Outputs that a constant would explain as well."""
    if fit.innovations is not None or not _has_numbers(fit):
        return
    motion = _Motion.of(fit)
    suspects = (motion.count >= MINIMUM_SAMPLES) & (motion.left >= BARELY * motion.own)
    if not suspects.any():
        return
    noise, _ = noise_levels.white_levels(fit.dataset)
    noise = np.where(fit.sigma_estimated, noise, np.minimum(noise, fit.sigma))
    for column in np.flatnonzero(suspects & motion.beyond(noise)):
        still = motion.moved[column] < 1e-4 * motion.own[column]
        how = "the model stands still" if still else "the model moves otherwise"
        yield Found(motion.share[column], fit.model.output_names[column], facts={"how": how})


def _stands_still(fit: Estimate) -> bool:
    """Whether a constant per output explains all outputs together better than the model does."""
    motion = _Motion.of(fit)
    weight = np.where(motion.count > 0, fit.sigma**-2.0, 0.0)
    return bool(weight @ motion.left >= BARELY * (weight @ motion.own))


def unexplained(fit: Estimate) -> dict[str, float]:
    """Share of every output's movement that the model on its own leaves, by name.

    Parameters
    ----------
    fit : Estimate
        With or without disturbance forces.

    Returns
    -------
    dict
        Root of a ratio of squares: 0 where everything is explained, 1 where a constant is as good;
        NaN where nothing, or next to nothing, was measured.
    """
    motion = _Motion.of(fit)
    told = np.isfinite(motion.share) & (motion.count >= MINIMUM_SAMPLES)
    shares = np.where(told, motion.share, np.nan)
    return dict(zip(fit.model.output_names, map(float, shares), strict=True))


def _unexplained(fit: Estimate) -> Iterator[Found]:
    """Outputs that move, or all outputs, of which noise or forces hold nearly everything."""
    shares = np.array(list(unexplained(fit).values()))
    poor = shares >= BARELY
    if not poor.any() or not fit.dataset.channels.inputs:
        return
    moving = _Motion.of(fit).beyond(noise_levels.white_levels(fit.dataset)[0])
    found, what = poor & (moving | poor[~np.isnan(shares)].all()), "the noise is the rest"
    if fit.innovations is not None:
        what = "disturbance forces hold the rest"
        found &= ~_carried_away(fit) if found.any() else found
    for column in np.flatnonzero(found):
        name = fit.model.output_names[column]
        yield Found(shares[column], name, facts={"what": what}, row="unexplained")


def _carried_away(fit: Estimate) -> np.ndarray:
    """Outputs of which disturbances leave runs no better than a constant, ``(n_outputs,)``.

    Those whose innovations the model's answer to the inputs makes smaller; where there are any,
    also those for which neither the fit nor its start values state an answer that would show.
    """
    begun = {name: value for name, value in fit.nominal.items() if name in fit.model.values}
    stated, gained = _answers(fit)
    at_first, _ = _answers(replace(fit, model=fit.model.with_values(begun)))
    answered = (stated > BEYOND) & (gained > 0.0)
    silent = (stated <= BEYOND) & (at_first <= BEYOND) & answered.any()
    return np.asarray(answered | silent)


def _answers(fit: Estimate) -> tuple[np.ndarray, np.ndarray]:
    """What innovations change by where inputs are held at their means, each ``(n_outputs,)``.

    The root sum of squares in units of their standard deviations, and how much larger their own
    sum of squares is then.
    """
    mean = np.concatenate([one.inputs for one in fit.dataset if not one.independent]).mean(axis=0)
    held = [
        one if one.independent else replace(one, inputs=np.tile(mean, (one.n_samples, 1)))
        for one in fit.dataset
    ]
    # One wave in several equations would pass the answer of one on to the others.
    seas = tuple(replace(one, phases=None, coherence=None) for one in fit.noise.seas)
    apart, passes = replace(fit, noise=replace(fit.noise, seas=seas)), []
    for records in (fit.dataset, Dataset(tuple(held))):
        problem, unknowns = posed_again(replace(apart, dataset=records))
        passes.append(problem.passes(unknowns, columns=False))
    answer, gained = np.zeros((2, len(fit.model.outputs)))
    for own, without in zip(*passes, strict=True):
        std = np.sqrt(own.variances)
        before, after = own.innovations / std, without.innovations / std
        answer += np.nansum((after - before) ** 2, axis=0)
        gained += np.nansum(after**2 - before**2, axis=0)
    return np.sqrt(answer), gained


# -- unknowns ------------------------------------------------------------------------


def _few_samples(fit: Estimate) -> Iterator[Found]:
    ratio = fit.n_observations / max(fit.n_unknowns, 1)
    # As many as degrees of freedom from which a scatter tells something.
    least = FEWEST - 1
    if ratio < least and fit.n_unknowns:
        facts = {"n": fit.n_observations, "unknowns": fit.n_unknowns, "least": least}
        yield Found(ratio, facts=facts)


def _records_differ(fit: Estimate) -> Iterator[Found]:
    """Estimates that scatter between records by more than their standard errors say."""
    scatter = fit.record_scatter
    if scatter is None:
        return
    with np.errstate(invalid="ignore"):
        white = np.diag(fit.information.covariance)
    factor, clear = scatter.exceeds(np.diag(fit.covariance), white)
    order = [int(i) for i in np.argsort(-factor) if clear[i]]
    if order:
        worst = ", ".join(f"{fit.names[i]} {factor[i]:.2g} times" for i in order[:3])
        more = f" and {len(order) - 3} more" if len(order) > 3 else ""
        facts = {"n": scatter.n_records, "worst": worst, "more": more}
        yield Found(factor[order[0]], fit.names[order[0]], facts=facts)


def _follows(fit: Estimate) -> Iterator[Found]:
    """Parameters of records that follow the amplitude of a signal over the records."""
    n = len(fit.dataset)
    amplitudes = np.array([np.max(np.abs(record.inputs), axis=0) for record in fit.dataset])
    moving = np.ptp(amplitudes, axis=0) > 1e-2 * np.max(amplitudes, axis=0)
    for name in fit.local_values[0] if n >= FEWEST and fit.local_values and moving.any() else ():
        values = np.array([local[name] for local in fit.local_values])
        if np.ptp(values) > 0:
            told = np.corrcoef(values, amplitudes[:, moving].T)[0, 1:]
            best = int(np.argmax(np.abs(told)))
            t = abs(told[best]) * np.sqrt((n - 2) / max(1.0 - told[best] ** 2, 1e-12))
            chance = 2.0 * float(stdtr(n - 2, -t))
            if chance * len(told) <= CHANCE:
                signal = fit.model.input_names[np.flatnonzero(moving)[best]]
                facts = {"follows": signal, "n": n, "chance": 100 * chance}
                yield Found(told[best], name, facts=facts)


# How every kind of concern is found, the gravest first.
CHECKS: tuple[tuple[str, Callable[[Estimate], Iterable[Found]]], ...] = (
    ("runaway", _runaway),
    ("integration", _integration),
    ("degenerate", _degenerate),
    ("few_samples", _few_samples),
    ("process_noise", _process_noise),
    ("curved", _curved),
    ("constraint", _binding),
    ("input_factor", _input_factors),
    ("records_differ", _records_differ),
    ("finer_step", _finer),
    ("spikes", _excluded),
    ("spikes", _spikes),
    ("delay", partial(_departure, ("late", "acts late"))),
    ("offset", partial(_departure, ("off", "acts off"))),
    ("zero", _zeros),
    ("scale", partial(_departure, ("scale",))),
    ("clock", partial(_departure, ("slow",))),
    ("lever", partial(_departure, tuple(LEVERS))),
    ("actuator_start", _starts),
    ("noise_level", _levels),
    ("absorbed", _absorbed),
    ("input_noise", _inputs),
    ("narrow_band", _narrow_bands),
    ("autocorrelation", _autocorrelations),
    ("per_record_follows", _follows),
)
