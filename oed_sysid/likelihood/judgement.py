r"""Whether a model fits: what a fit's own residuals say against its claims.

Let :math:`\epsilon_k` be the one-step errors of an output over their stated standard
deviation (``fit.whitened``), ``n`` of them. If model and noise are right they are white, normal
and of variance one. Tested are

*Noise level.* The factor by which the declared level is wrong is the root of the variance, and
of the variance of third differences, which slow residuals do not enter,

.. math:: f^2 = \frac{1}{n - m}\sum_k \epsilon_k^2, \qquad
    f_\Delta^2 = \operatorname{median}\,(\Delta^3 \epsilon)_k^2 \,/\, (0.4549 \cdot 20),

with standard errors :math:`1/\sqrt{2n}` and :math:`1.5/\sqrt{n}` of their logarithms and ``m``
the output's share of the unknowns. Large ``f`` with small :math:`f_\Delta` is colour, not level.

*Colour.* Ljung-Box statistic and effective sample size (:mod:`oed_sysid.likelihood.information`).

*Swing.* Innovations with power about one frequency, as waves leave them
(:mod:`oed_sysid.likelihood.covariance`).

*Spikes* and *delays* are found by :mod:`oed_sysid.likelihood.noise_levels` and
:mod:`oed_sysid.likelihood.departures`.

*Integration.* Root mean square change of the outputs when the step is a quarter, in units of noise.

What none of this can see: errors that the parameters absorb without a trace in the residuals.

How much of every output a fitted model explains on its own, and whether that is enough.

.. math::
    s^2 = \frac{\sum_k (y_k - \hat y_k)^2}{\sum_k (y_k - \bar y)^2}, \qquad
    s_h^2 = \frac{\sum_k (\Delta_h y_k - \Delta_h \hat y_k)^2}{\sum_k (\Delta_h y_k)^2}

with the model run on its own, :math:`\hat y`. A constant has :math:`s = 1`. Disturbance forces make
a heading or a position drift away although the model answers rightly to every command; there the
increments over :math:`h` samples count too, and the smallest of all shares is taken.

Estimated noise, of sensors or of forces, can absorb whatever a model does not explain, so that
the misfit is one and the iterations converge. :func:`grave` says so.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.special import ndtr, stdtr

from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.covariance import clear_peaks
from oed_sysid.likelihood.departures import (
    CLEAR,
    COLOUR_SHARE,
    clear_delay,
    clear_starts,
    estimate_delays,
    fast_level,
    noisy_inputs,
    other_way,
    values_of,
)
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.likelihood.noise_levels import signal_spread, spike_masks, spike_sizes, white_levels
from oed_sysid.runtime.display import TWO_SIDED_95, as_dict
from oed_sysid.text.units import shown_unit

# A fit goes through the verdict as what it is.
Found = TypeVar("Found", bound=Estimate)
# Wrong noise levels from which intervals are worth a word (they are wrong by the same factor).
LEVEL_FACTOR = 1.15
# Chance of the statistic from which on residuals are coloured.
COLOUR_CHANCE = 1e-5
# Standard error of the logarithm of a level from third differences, times the root of n.
DIFFERENCE_ERROR = 1.5
# Change by a quarter of the step, in noise levels, that a trajectory must not show.
STEP_CHANGE = 0.5
FINER = 4
# Samples over which the step is tried where disturbance forces move the vehicle.
PIECE = 20
# Beyond so many times its scale no value is physical, and none that the records do not show.
RUNAWAY, UNSEEN = 1e8, 1e4
# Motion of the model, as a share of the signal's, from which on it is no constant.
STILL = 1e-2
# A model that leaves this share of the squares about the mean explains nothing.
BARELY = 0.99
# A signal this many times its noise moves.
MOVES = 3.0
FEW = 3.0
ABSORBED = 1.5
# Chance of a correlation over records; the fewest records for one.
FOLLOWS_CHANCE, FOLLOWS_RECORDS = 0.05, 4
# Effect on the outputs of noise in a logged input, in noise levels.
INPUT_EFFECT = 0.1
# Parameters that are named where records differ.
NAMED = 3
# Kinds that make a fit not converged, worst first.
FATAL = ("runaway", "integration", "degenerate")


@dataclass(frozen=True)
class Concern:
    """One way in which a fit is not what it claims.

    Attributes
    ----------
    kind : str
        ``noise_level``, ``colour``, ``swing``, ``spikes``, ``delay``, ``actuator_start``,
        ``per_record_follows``, ``records_differ``, ``input_noise``, ``other_way``, ``absorbed``,
        ``process_noise``, ``integration``, ``runaway``, ``degenerate`` or ``few_samples``.
    signal : str
        Output, input, state or parameter; empty where it is the whole fit.
    record : str
        Empty where it is all records.
    size : float
        A factor of the level (``noise_level``, ``absorbed``), the share of independent samples
        (``colour``), a number of samples (``spikes``), seconds (``delay``, ``swing``), the unit of
        a command (``actuator_start``), a correlation (``per_record_follows``), a factor of the
        standard error (``records_differ``), the true input over the logged one (``other_way``),
        noise levels (``integration``, ``input_noise``), multiples of the scale (``runaway``) or of
        the signal (``degenerate``), samples per unknown (``few_samples``), the score test's
        2 delta ln L (``process_noise``).
    text : str
        What was expected, what was found, what to do.
    """

    kind: str
    signal: str
    record: str
    size: float
    text: str

    to_dict = as_dict("kind", "signal", "record", "size", "text")


def with_verdict(fit: Found) -> Found:
    """The same fit; its status is not ``converged`` where its values must not be used."""
    if fit.status.code in ("stalled", "iterations"):
        steps = " ".join(concern.text for concern in _integration(fit))
        advice = f"{fit.status.advice} {steps}".rstrip()
        return replace(fit, status=replace(fit.status, advice=advice))
    if not fit.status.ok:
        return fit
    found = {concern.kind: concern for concern in reversed(fatal(fit))}
    if "degenerate" in found and not _stands_still(fit):
        del found["degenerate"]
    for kind in FATAL:
        if kind in found:
            return replace(fit, status=replace(fit.status, code=kind, advice=found[kind].text))
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
        return (*found, *_few_samples(fit))
    if not _has_numbers(fit):
        return found
    spikes = spike_concerns(fit)
    colours, swings = colour_concerns(fit), swing_concerns(fit)
    return (
        *found,
        *_few_samples(fit),
        *_process_noise(fit),
        *_other_way(fit),
        *_records_differ(fit),
        *spikes,
        *delay_concerns(fit),
        *start_concerns(fit),
        *level_concerns(fit),
        *_absorbed(fit),
        *input_concerns(fit),
        *swings,
        *(colour for colour in colours if colour.signal not in {swing.signal for swing in swings}),
        *_follows(fit),
    )


def fatal(fit: Estimate) -> tuple[Concern, ...]:
    """Concerns that forbid the use of the values: runaway, integration, degenerate."""
    if not np.isfinite(fit.cost) and not _has_numbers(fit):
        return ()
    if away := _runaway(fit):
        return away
    return (*_integration(fit), *_degenerate(fit))


def _has_numbers(fit: Estimate) -> bool:
    """Whether the model, or the filter that goes along with the records, diverged."""
    if fit.innovations is None:
        return all(np.isfinite(part).all() for part in fit.predictions)
    return all(
        np.isfinite(part[np.isfinite(record.outputs)]).all()
        for part, record in zip(fit.innovations, fit.dataset, strict=True)
    )


# -- the noise ---------------------------------------------------------------------


def level_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """Declared noise levels that are not those found."""
    found = []
    declared = _declared(fit)
    total = max(fit.n_observations, 1)
    for column, output in enumerate(fit.model.outputs):
        if fit.sigma_estimated[column] or not np.isfinite(declared[column]):
            continue
        parts = [part[:, column] for part in fit.whitened]
        present = np.concatenate([part[np.isfinite(part)] for part in parts])
        n = len(present)
        if n < 20:
            continue
        # A spike is not a level: what lies beyond four deviations is left out.
        size = max(1.4826 * float(np.median(np.abs(present))), 1e-12)
        kept = present[np.abs(present) < 4.0 * size]
        if not len(kept):
            continue
        share = max(1.0 - fit.n_unknowns / total, 0.1)
        whole = float(np.sqrt(np.mean(kept**2) / share))
        ordered = [part[:, column] for part in fit.series]
        tests = not any(np.isfinite(part).any() for part in ordered)
        fast = whole if tests else fast_level(ordered)
        if not fast > 0.0:
            continue
        factor, error = whole, np.sqrt(0.5 / n)
        if whole > 1.0 and fast < whole * (1.0 - 2.5 * DIFFERENCE_ERROR / np.sqrt(n)):
            # Slow residuals raise the variance, not the level of the white noise.
            factor, error = max(fast, 1.0), DIFFERENCE_ERROR / np.sqrt(n)
        # A filter that was told less white noise than there is finds the rest elsewhere.
        factor *= float(fit.sigma[column] / declared[column])
        if abs(np.log(factor)) < max(CLEAR * error, np.log(LEVEL_FACTOR)):
            continue
        low, high = factor * np.exp(-TWO_SIDED_95 * error), factor * np.exp(TWO_SIDED_95 * error)
        wrong = "small" if factor > 1.0 else "large"
        so = f"Standard errors are too {wrong} for it: set noise_std, or noise='estimate'."
        if tests and factor > 1.0:
            so = (
                "Standard errors are from the scatter of the tests. Look for what the model "
                "lacks, or state a larger noise."
            )
        found.append(
            Concern(
                "noise_level",
                output.name,
                "",
                factor,
                f"Noise of {output.name}: declared {declared[column]:.3g} {output.unit}, found "
                f"{factor * declared[column]:.3g} ({factor:.2f} times, 95 % {low:.2f} to "
                f"{high:.2f}). {so}",
            )
        )
    return tuple(found)


def _declared(fit: Estimate) -> np.ndarray:
    """Declared noise levels, those that the fit took where it was given others."""
    levels = [np.nan if o.noise_std is None else o.noise_std for o in fit.model.outputs]
    given = np.array(levels, dtype=float)
    if fit.innovations is None:
        return np.where(fit.sigma_estimated, given, fit.sigma)
    return given


def colour_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """One-step errors that remember, after all the noise that the fit knows."""
    found = []
    for name, tests in fit.whiteness().items():
        if not tests:
            continue
        effective = sum(test.effective_samples for test in tests)
        n = sum(test.n_samples for test in tests)
        lag_one = sum(test.lag_one * test.n_samples for test in tests) / n
        clear = min(test.p_value for test in tests) < COLOUR_CHANCE / len(tests)
        if not (clear or abs(lag_one) * np.sqrt(n) > CLEAR) or effective > COLOUR_SHARE * n:
            continue
        what = "Innovations" if fit.innovations is not None else "Residuals"
        todo = (
            "Standard errors are from the sandwich covariance, which needs noise that does not "
            "depend on the manoeuvre; look for what is missing with improve()."
            if fit.coloured
            else "Standard errors are too small; look for what is missing with improve(), or let "
            "random forces in."
        )
        found.append(
            Concern(
                "colour",
                name,
                "",
                effective / n,
                f"{what} of {name} are correlated: {n} samples count as {effective:.0f}, expected "
                f"{n}. {todo}",
            )
        )
    return tuple(found)


def _process_noise(fit: Estimate) -> tuple[Concern, ...]:
    """Process noise that acts, but whose estimation failed."""
    test = fit.process_noise
    if test is None or not test.failed:
        return ()
    return (
        Concern(
            "process_noise",
            "",
            "",
            test.statistic,
            f"Process noise seems to act (2 delta ln L is about {test.statistic:.3g} by the score "
            f"test), but the fit with it ended with {test.failed!r}: these values are from the "
            "fit without it. Look for what is missing with improve() and for faults of the log "
            "with `oed-sysid check`, or name the disturbed equations, such as "
            "disturbances=('Z', 'M').",
        ),
    )


def swing_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """Innovations that swing with a period of their own.

    Within an octave of a sea that the fit has, it is the shape of its spectrum that is not quite
    the assumed one, which standard errors hold.
    """
    if fit.innovations is None:
        return ()
    periods = [float(sea.period or 0.0) for sea in fit.noise.seas]
    peaks = [
        peak
        for peak in clear_peaks(fit.series, tuple(fit.dataset), fit.model.output_names)
        if not any(0.5 < peak.period / period < 2.0 for period in periods)
    ]
    return tuple(
        Concern(
            "swing",
            peak.output,
            "",
            peak.period,
            f"Innovations of {peak.output} swing with a period of about {peak.period:.2g} s "
            f"({peak.ratio:.1f} times the power of white ones): waves that one sea does not "
            "describe, or motion that the model lacks. Standard errors are from the sandwich "
            "covariance, which holds the swing; estimates are not as precise as they could be.",
        )
        for peak in peaks
    )


def _absorbed(fit: Estimate) -> tuple[Concern, ...]:
    """Estimated levels that hold what the model does not explain."""
    if fit.innovations is not None or not fit.sigma_estimated.any():
        return ()
    found = []
    floor, _ = white_levels(fit.dataset)
    for column, (name, (effective, n)) in enumerate(fit.effective_samples().items()):
        if not fit.sigma_estimated[column] or n < 20 or not floor[column] > 0:
            continue
        factor = float(fit.sigma[column] / floor[column])
        if factor > ABSORBED and effective < COLOUR_SHARE * n:
            unit = fit.model.outputs[column].unit
            found.append(
                Concern(
                    "absorbed",
                    name,
                    "",
                    factor,
                    f"The estimated noise of {name}, {fit.sigma[column]:.3g} {unit}, is "
                    f"{factor:.3g} times its high-frequency content ({floor[column]:.3g}): it "
                    "holds what the model does not explain. A misfit of one says nothing here; "
                    "declare noise_std, check signs and units, or look for what is missing.",
                )
            )
    return tuple(found)


# -- spikes ------------------------------------------------------------------------


def spike_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """Isolated outliers, and those that the fit has left out."""
    found = []
    for name, (count, total) in fit.excluded.items():
        found.append(
            Concern(
                "spikes",
                name,
                "",
                float(count),
                f"{count} of {total} samples of {name} excluded as spikes. Look at them: a "
                "sensor that jumps is repaired, not fitted.",
            )
        )
    masks = spike_masks(fit.series, declared=~fit.sigma_estimated)
    sizes = spike_sizes(fit.series)
    for column, name in enumerate(fit.model.output_names):
        count = int(sum(mask[:, column].sum() for mask in masks))
        if not count:
            continue
        n = int(sum(np.isfinite(part[:, column]).sum() for part in fit.series))
        values = np.concatenate(
            [part[mask[:, column], column] for part, mask in zip(sizes, masks, strict=True)]
        )
        up = int((values > 0).sum())
        side = ", one-sided" if count > 4 and min(up, count - up) <= 0.1 * count else ""
        expected = 2.0 * n * float(ndtr(-4.0))
        found.append(
            Concern(
                "spikes",
                name,
                "",
                float(count),
                f"{count} of {n} samples of {name} stand out alone{side}, by up to "
                f"{np.max(np.abs(values)):.3g} times their usual distance from their neighbours "
                f"(normal noise: {expected:.1g} beyond four). They bias the fit "
                "and its errors: mark them NaN, or use MultipleShooting(loss='auto'), which leaves "
                "them out.",
            )
        )
    return tuple(found)


# -- delays, noise of inputs: simulations ----------------------------------------------


def delay_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """A delay of one signal: the one that explains most, others follow once it is mended."""
    best = None if fit.process_noise is None else fit.process_noise.delay
    if best is not None:
        pass  # found before disturbance forces absorbed it
    elif fit.innovations is not None or not fit.names:
        return ()
    else:
        best = clear_delay(fit, estimate_delays(fit))
    if best is None:
        return ()
    verb = "is logged" if best.kind == "output" else "acts"
    late = "late" if best.seconds > 0 else "early"
    return (
        Concern(
            "delay",
            best.signal,
            "",
            best.seconds,
            f"The residuals look as if {best.signal} {verb} {abs(best.seconds):.3g} +/- "
            f"{TWO_SIDED_95 * best.std:.2g} s {late} (expected none). Compare the clocks of "
            f"the log, and shift {best.signal}, or add a delay or lag to the model.",
        ),
    )


def start_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """Actuators that did not begin at their first command, the clearest record of each."""
    clear = () if fit.process_noise is None else fit.process_noise.actuator_starts
    if clear:
        pass  # found before disturbance forces absorbed it
    elif fit.innovations is not None or not fit.names:
        return ()
    else:
        clear = clear_starts(fit)
    found: dict[tuple[str, str], Concern] = {}
    for one in clear:
        same = {other.record for other in clear if other.effect == one.effect}
        others = f" and {len(same) - 1} more records" if len(same) > 1 else ""
        unit = next((i.unit for i in fit.model.inputs if i.name == one.signal), "")
        factor, shown = shown_unit(unit)
        found.setdefault(
            (one.effect, one.signal),
            Concern(
                "actuator_start",
                one.signal,
                one.record,
                one.size,
                f"In {one.record!r}{others} {one.effect} did not begin at the first command of "
                f"{one.signal}, but {factor * one.size:.2g} +/- "
                f"{TWO_SIDED_95 * factor * one.std:.2g} {shown} beside it, and "
                "parameters bend to that. Let the start of each record be estimated: "
                "unknown_start(effect, std) of oed_sysid.physics, or begin records "
                "later.",
            ),
        )
    return tuple(found.values())


def input_concerns(fit: Estimate) -> tuple[Concern, ...]:
    """Logged inputs whose white noise reaches the outputs.

    The vehicle answers to the true input, not to its log; a fit to the log lets coefficients
    shrink and errors look white (Fuller 1987, *Measurement error models*).
    """
    found = []
    runner = kernel(fit.model)
    levels = noisy_inputs(fit.dataset)
    for column, channel in enumerate(fit.model.inputs):
        if channel.name not in levels:
            continue
        level = levels[channel.name]
        rng = np.random.default_rng(0)
        change, count = 0.0, 0
        for index, record in enumerate(fit.dataset):
            moved = record.inputs.copy()
            moved[:, column] += level * rng.standard_normal(record.n_samples)
            values = values_of(fit, index)
            own = fit.initial_states[index]
            z0, _ = runner.start(own, record.inputs[0], values, record.times[0])
            ends = runner.run(record.times, moved, values, z0).outputs - fit.predictions[index]
            scaled = (ends / fit.sigma)[np.isfinite(record.outputs)]
            scaled = scaled[np.isfinite(scaled)]
            change, count = change + float(scaled @ scaled), count + len(scaled)
        size = float(np.sqrt(change / max(count, 1)))
        if not size > INPUT_EFFECT:
            continue
        found.append(
            Concern(
                "input_noise",
                channel.name,
                "",
                size,
                f"The log of input {channel.name} carries white noise of {level:.3g} "
                f"{channel.unit}; fed to the model it moves the outputs by {size:.2g} noise "
                "levels. The vehicle answers to the true input: fit the command instead of the "
                "measurement, or smooth the log, or allow a disturbance force at its actuator.",
            )
        )
    return tuple(found)


def _other_way(fit: Estimate) -> tuple[Concern, ...]:
    """Inputs that act reversed, or in another unit, than the start values say."""
    if not fit.status.ok or not fit.nominal:
        return ()
    return tuple(
        Concern("other_way", one.channel.name, "", one.factor, one.text)
        for one in other_way(fit, fit.nominal)
    )


# -- the trajectory ------------------------------------------------------------------


def _runaway(fit: Estimate) -> tuple[Concern, ...]:
    """Values far beyond any scale."""
    for name, value in fit.values.items():
        parameter = fit.model.parameter(name)
        scale = parameter.scale or 0.0
        if name in fit.nominal:
            scale = replace(parameter, value=fit.nominal[name]).magnitude
        # Without a scale: beyond what any coefficient in SI units can be.
        most = RUNAWAY if np.isfinite(fit.std_errors.get(name, 0.0)) else UNSEEN
        limit = most * scale if scale > 0 else 1e15
        if not abs(value) <= max(limit, 1.0):
            return (_ran_away(name, value, abs(value) / (scale or 1.0), parameter.unit),)
    spread = signal_spread(fit.dataset)
    highest = np.nanmax(np.abs(np.vstack([r.outputs for r in fit.dataset])), axis=0, initial=0.0)
    # An unstable vehicle leaves every scale on its own; what counts is the filter's error.
    parts = fit.predictions if fit.innovations is None else fit.innovations
    tops = np.max([np.max(np.abs(np.nan_to_num(p)), axis=0, initial=0.0) for p in parts], axis=0)
    for column, output in enumerate(fit.model.outputs):
        scale = float(max(highest[column], spread[column], fit.sigma[column]))
        if tops[column] > RUNAWAY * scale:
            return (_ran_away(output.name, tops[column], tops[column] / scale, output.unit),)
    return ()


def _ran_away(name: str, value: float, size: float, unit: str) -> Concern:
    return Concern(
        "runaway",
        name,
        "",
        size,
        f"{name} ran away to {value:.3g} {unit}".rstrip() + ", far beyond any scale. Start closer, "
        "bound the parameters, or fix those that the records do not show.",
    )


def step_change(fit: Estimate, finer: int = FINER) -> tuple[float, str, str]:
    """Change of the outputs with a finer step in noise levels: the worst, its output and record.

    With disturbance forces the model alone may drift away; there pieces of ``PIECE`` samples begin
    at the states of the simulation.
    """
    coarse, fine = kernel(fit.model), kernel(replace(fit.model, step=fit.model.step / finer))
    sigma = fit.sigma
    if fit.sigma_estimated.any():
        sigma = np.where(
            fit.sigma_estimated, np.minimum(sigma, white_levels(fit.dataset)[0]), sigma
        )
        # Filtered or exact records: a thousandth of the signal is no visible error.
        sigma = np.maximum(sigma, 1e-3 * signal_spread(fit.dataset) * fit.sigma_estimated)
    worst = (0.0, "", "")
    for index, record in enumerate(fit.dataset):
        values, before = values_of(fit, index), fit.predictions[index]
        states = fit.states[index]
        if fit.innovations is None or states.shape[1] != coarse.n_full:
            own = fit.initial_states[index]
            z0, _ = fine.start(own, record.inputs[0], values, record.times[0])
            after = fine.run(record.times, record.inputs, values, z0).outputs
        else:
            last = int(np.isfinite(states).all(axis=1).cumprod().sum())
            starts = np.arange(0, record.n_samples, PIECE)
            starts = starts[starts < last] if last else starts[:1]
            after = fine.run(
                record.times, record.inputs, values, states[starts], starts=starts
            ).outputs
        measured = np.isfinite(record.outputs).any(axis=0)
        known = np.isfinite(before).all(axis=1)
        if not known.any():
            continue
        with np.errstate(invalid="ignore", over="ignore"):
            change = np.sqrt(np.mean(((after - before)[known] / sigma) ** 2, axis=0))
        change = np.where(np.isnan(change), np.inf, change)
        for name, size, seen in zip(fit.model.output_names, change, measured, strict=True):
            if seen and size > worst[0]:
                worst = (float(size), name, record.name)
    return worst


def _integration(fit: Estimate) -> tuple[Concern, ...]:
    """Trajectories that hang on the integration step."""
    if not _has_numbers(fit):
        return ()
    # Half the step shows nearly as much, and costs half.
    if step_change(fit, 2)[0] < 0.5 * STEP_CHANGE:
        return ()
    size, output, record = step_change(fit)
    if size < STEP_CHANGE:
        return ()
    step, stiff = fit.model.step, ""
    if fit.model.integrator != "implicit":
        stiff = ", or take Model(integrator='implicit') if some motions die out within a step"
    return (
        Concern(
            "integration",
            output,
            record,
            size,
            f"The trajectories hang on the integration step: with {step / FINER:g} s instead of "
            f"{step:g} s, {output} of record {record!r} changes by {size:.3g} noise levels "
            f"(expected below {STEP_CHANGE:g}). Reduce model.step and fit again{stiff}; if that "
            "does not help, a force of the model jumps where the state passes some value: make it "
            "continuous.",
        ),
    )


def _degenerate(fit: Estimate) -> tuple[Concern, ...]:
    """Outputs that a constant would explain as well."""
    if fit.innovations is not None or not _has_numbers(fit):
        return ()
    count, own, moved, left = np.zeros((4, len(fit.model.outputs)))
    for record, part in zip(fit.dataset, fit.predictions, strict=True):
        seen = np.isfinite(record.outputs)
        n = seen.sum(axis=0)
        count += n
        signal, model = (np.where(seen, values, 0.0) for values in (record.outputs, part))
        left += ((signal - model) ** 2).sum(axis=0)
        for values, total in ((signal, own), (model, moved)):
            total += ((values - values.sum(axis=0) / np.maximum(n, 1)) ** 2 * seen).sum(axis=0)
    suspects = np.flatnonzero((count >= 10) & (left >= BARELY * own))
    if not len(suspects):
        return ()
    noise, _ = white_levels(fit.dataset)
    noise = np.where(fit.sigma_estimated, noise, np.minimum(noise, fit.sigma))
    found = []
    for column in suspects:
        output = fit.model.outputs[column]
        if own[column] <= (MOVES * noise[column]) ** 2 * count[column]:
            continue
        size = float(np.sqrt(left[column] / own[column]))
        still = moved[column] < STILL**2 * own[column]
        how = "the model stands still" if still else "the model moves otherwise"
        found.append(
            Concern(
                "degenerate",
                output.name,
                "",
                size,
                f"The residual of {output.name} is {size:.3g} times as large as the signal about "
                f"its mean ({how}): a constant explains it as well. Start closer (start='near' "
                "with values of the right sign and size), check signs and units, or bound the "
                "parameters.",
            )
        )
    return tuple(found)


def _stands_still(fit: Estimate) -> bool:
    """Whether a constant per output explains all outputs together better than the model does."""
    left = own = 0.0
    for record, part in zip(fit.dataset, fit.predictions, strict=True):
        signal = np.where(np.isfinite(record.outputs), record.outputs, np.nan) / fit.sigma
        seen = np.isfinite(signal).any(axis=0)
        signal, model = signal[:, seen], part[:, seen] / fit.sigma[seen]
        own += float(np.nansum((signal - np.nanmean(signal, axis=0)) ** 2))
        left += float(np.nansum((signal - model) ** 2))
    return left >= BARELY * own


# -- unknowns ------------------------------------------------------------------------


def _few_samples(fit: Estimate) -> tuple[Concern, ...]:
    ratio = fit.n_observations / max(fit.n_unknowns, 1)
    if ratio >= FEW or not fit.n_unknowns:
        return ()
    return (
        Concern(
            "few_samples",
            "",
            "",
            ratio,
            f"{fit.n_observations} samples for {fit.n_unknowns} unknowns: residuals are small "
            f"whatever the model is (at least {FEW:g} samples per unknown expected). Measure "
            "longer, or fix what is known.",
        ),
    )


def _records_differ(fit: Estimate) -> tuple[Concern, ...]:
    """Estimates that scatter between records by more than their standard errors say."""
    scatter = fit.record_scatter
    if scatter is None:
        return ()
    with np.errstate(invalid="ignore"):
        white = np.diag(fit.information.covariance)
    factor, clear = scatter.exceeds(np.diag(fit.covariance), white)
    if not clear.any():
        return ()
    order = [int(i) for i in np.argsort(-factor) if clear[i]]
    worst = ", ".join(f"{fit.names[i]} {factor[i]:.2g} times" for i in order[:NAMED])
    more = f" and {len(order) - NAMED} more" if len(order) > NAMED else ""
    return (
        Concern(
            "records_differ",
            fit.names[order[0]],
            "",
            float(factor[order[0]]),
            f"Estimates scatter between the {scatter.n_records} records by more than their "
            f"standard errors say: {worst}{more}. Something acts that no parameter says and that "
            "differs from record to record. Use the errors between records (fit.record_errors, "
            "fit.with_record_errors(); jackknife() refits), and look for what is missing with "
            "improve().",
        ),
    )


def _follows(fit: Estimate) -> tuple[Concern, ...]:
    """Parameters of records that follow the amplitude of a signal over the records."""
    n = len(fit.dataset)
    names = fit.local_values[0] if fit.local_values else {}
    if n < FOLLOWS_RECORDS or not names:
        return ()
    sizes = {
        channel.name: np.array([np.max(np.abs(r.inputs[:, i])) for r in fit.dataset])
        for i, channel in enumerate(fit.model.inputs)
    }
    sizes = {name: size for name, size in sizes.items() if np.ptp(size) > 1e-2 * np.max(size)}
    found = []
    for name in names:
        values = np.array([local[name] for local in fit.local_values])
        if not np.ptp(values) > 0:
            continue
        best = ("", 0.0, 1.0)
        for signal, size in sizes.items():
            correlation = float(np.corrcoef(values, size)[0, 1])
            t = abs(correlation) * np.sqrt((n - 2) / max(1.0 - correlation**2, 1e-12))
            chance = 2.0 * float(stdtr(n - 2, -t))
            if chance < best[2]:
                best = (signal, correlation, chance)
        signal, correlation, chance = best
        if chance * len(sizes) > FOLLOWS_CHANCE:
            continue
        found.append(
            Concern(
                "per_record_follows",
                name,
                "",
                correlation,
                f"{name}, estimated per record, follows the amplitude of {signal} over {n} records "
                f"(correlation {correlation:+.2f}, by chance in {100 * chance:.1g} % of cases): it "
                f"stands for physics that grows with {signal}, and predictions beyond these "
                "amplitudes will err. Make it one value for all records and look for what is "
                "missing with improve().",
            )
        )
    return tuple(found)


# Concerns with which a fit may converge and must still not be used.
GRAVE = ("absorbed", "degenerate", "few_samples")
# Lengths of increments as shares of a record; fewer samples than FEWEST say nothing.
HORIZONS, FEWEST = (0.02, 0.05, 0.125), 10


def unexplained(fit: Estimate) -> dict[str, float]:
    """Share of every output's movement that the model on its own leaves, by name.

    Parameters
    ----------
    fit : Estimate
        With or without disturbance forces.

    Returns
    -------
    dict
        Root of the smallest ratio of squares: 0 where everything is explained, 1 where a
        constant is as good; NaN where nothing, or next to nothing, was measured.
    """
    found = {}
    for column, name in enumerate(fit.model.output_names):
        pairs = []
        for record, part in zip(fit.dataset, fit.predictions, strict=True):
            seen = np.isfinite(record.outputs[:, column])
            if seen.any():
                pairs.append((record.outputs[seen, column], part[seen, column]))
        shares = [_share([(y - y.mean(), y - model) for y, model in pairs])]
        for horizon in HORIZONS if fit.innovations is not None else ():
            moved = []
            for y, model in pairs:
                h = max(int(horizon * len(y)), 1)
                moved.append((y[h:] - y[:-h], (y - model)[h:] - (y - model)[:-h]))
            shares.append(_share(moved))
        few = sum(len(y) for y, _ in pairs) < FEWEST
        found[name] = np.nan if few else float(np.nanmin([*shares, np.inf]))
    return {name: share if np.isfinite(share) else np.nan for name, share in found.items()}


def _share(pairs: list[tuple[np.ndarray, np.ndarray]]) -> float:
    """Root of the squares that are left over the squares that were there."""
    own = sum(float(signal @ signal) for signal, _ in pairs)
    with np.errstate(over="ignore", invalid="ignore"):
        left = sum(float(rest @ rest) for _, rest in pairs)
    if not own > 0.0:
        return np.nan
    return float(np.sqrt(left / own)) if np.isfinite(left) else np.inf


def grave(fit: Estimate, concerns: Sequence[Concern]) -> tuple[Concern, ...]:
    """What makes a fit useless although it converged: the noise holds what a model should.

    Parameters
    ----------
    fit : Estimate
    concerns : sequence of Concern
        What speaks against it, as :func:`.judgement.judge` finds it.

    Returns
    -------
    tuple of Concern
        ``absorbed``, ``degenerate`` and ``few_samples``; empty where the fit can be used, or
        where its status says already that it cannot.
    """
    if not fit.status.ok:
        return ()
    found = [concern for concern in concerns if concern.kind in GRAVE]
    named = {concern.signal for concern in found}
    shares = {name: share for name, share in unexplained(fit).items() if not np.isnan(share)}
    poor = [name for name, share in shares.items() if share >= BARELY]
    if not poor or not fit.dataset.channels.inputs:
        return tuple(found)
    everything = len(poor) == len(shares)
    moving = _moving(fit)
    what = "random forces hold the rest" if fit.innovations is not None else "the noise is the rest"
    for name in poor:
        if name in named or not (everything or name in moving):
            continue
        found.append(
            Concern(
                "degenerate",
                name,
                "",
                shares[name],
                f"A constant explains {name} as well as the model on its own does (what is left "
                f"is {shares[name]:.3g} times its movement; {what}). Check signs, units and "
                "clocks with `oed-sysid check`, and look for what is missing with improve().",
            )
        )
    return tuple(found)


def _moving(fit: Estimate) -> set[str]:
    """Outputs that move by more than their noise."""
    noise, _ = white_levels(fit.dataset)
    found = set()
    for column, name in enumerate(fit.model.output_names):
        own, count = 0.0, 0
        for record in fit.dataset:
            y = record.outputs[:, column]
            y = y[np.isfinite(y)]
            if len(y):
                own, count = own + float(np.sum((y - y.mean()) ** 2)), count + len(y)
        if count and own > (MOVES * noise[column]) ** 2 * count:
            found.add(name)
    return found
