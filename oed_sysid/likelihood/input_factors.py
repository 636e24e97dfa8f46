r"""Inputs that act reversed, exchanged or in another unit than the start values say, and outputs.

An input of the other sign is a coefficient of the other sign: the fit converges, its residuals are
noise, and every controller designed with it steers to the wrong side. Kinematics cannot see it, but
the start values :math:`p_0` of the nominal model can. Where an estimate is strange against them,
clearly of the other sign or of the size that another unit gives, or held at a bound that lies on
its way there, the rival reading of each input, of all of a unit and of each two that may have
changed places is estimated too: the same likelihood, kinds of noise and start values, and inputs
:math:`k\,d`,

.. math:: D = 2\min_p L(k\,d, p) - 2 \min_p L(d, p), \qquad L = -\log \text{likelihood},

with :math:`k = -1`, a ratio of units, or the exchange of two columns. The rival is named where no
estimate is strange that was not before, fewer are, and the records do not speak against it:
:math:`D < c^2` where nothing held the estimates, which then are others for the same motion, and
:math:`-D > C^2` where a bound did (or the fit did not converge), in standard errors :math:`c, C`,
of residuals counted by their misfit and correlation. Where no input is, outputs that count the
other way are asked in the same manner. So one start value of the wrong sign among
several right ones says nothing: with the input reversed it is the others that are strange.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations, groupby

import numpy as np

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import OedSysidError
from oed_sysid.likelihood.departures import CLEARLY, TWOFOLD
from oed_sysid.likelihood.estimate import Estimate, by_name, once_a_fit
from oed_sysid.likelihood.gauss_newton import Solution, solve, solve_filtered
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.physics.channels import Input, Output
from oed_sysid.physics.model import Model
from oed_sysid.runtime.constants import BEYOND

# What a log may hold, by the unit that it was read in; only ratios that no guess is off by.
UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "rad": ((np.pi / 180.0, "degrees read as radians"), (180.0 / np.pi, "radians read as degrees")),
    "rad/s": ((2.0 * np.pi / 60.0, "rpm read as rad/s"), (30.0 / np.pi, "rad/s read as rpm")),
    "1/s": ((1.0 / 60.0, "rpm read as 1/s"), (60.0, "1/s read as rpm")),
    "N": ((1e3, "kN read as N"), (1e-3, "N read as kN")),
}


@dataclass(frozen=True)
class Reading:
    """Another reading of what a log holds of some inputs, or of an output.

    Attributes
    ----------
    channels : tuple of Input or Output
    factor : float
        The true signals over the logged ones: -1, or a ratio of units; 1 where two are exchanged.
    unit : str
        What the log seems to hold; empty for a sign, and for columns that are exchanged.
    """

    channels: tuple[Input | Output, ...]
    factor: float
    unit: str = ""

    @property
    def is_swap(self) -> bool:
        """Whether each of two inputs is in the column of the other."""
        return self.factor == 1.0

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the signals."""
        return tuple(one.name for one in self.channels)

    @property
    def strange(self) -> float:
        """Factor of an estimate that makes up for it; that of a sign where two are exchanged.

        What two inputs do alike needs no other estimate, and what they do against one another does.
        """
        return -1.0 if self.is_swap else self.factor

    def of(self, record: Record) -> Record:
        """A record so read."""
        if isinstance(self.channels[0], Output):
            turned = np.isin(record.channels.output_names, self.names)
            return record.with_outputs(record.outputs * np.where(turned, self.factor, 1.0))
        own = [record.channels.input_names.index(name) for name in self.names]
        inputs = record.inputs.copy()
        inputs[:, own] = self.factor * record.inputs[:, own[::-1] if self.is_swap else own]
        return replace(record, inputs=inputs)


@dataclass(frozen=True)
class InputFactor:
    """Inputs that act otherwise than the start values say.

    Attributes
    ----------
    reading : Reading
        How they would act as expected.
    values : mapping of str to (float, float)
        Parameters concerned: what was found, and the start value.
    held : tuple of str
        Those of them that a bound kept from the other sign or size.
    gain : float
        Twice the log-likelihood ratio of the inputs so read to the inputs as logged.
    """

    reading: Reading
    values: Mapping[str, tuple[float, float]]
    held: tuple[str, ...] = ()
    gain: float = 0.0

    @property
    def text(self) -> str:
        """What was expected, what was found, what to do."""
        told = ", ".join(
            f"{key} is {a:.3g}{', at its bound,' if key in self.held else ''} for {b:.3g}"
            for key, (a, b) in self.values.items()
        )
        as_well = "the same fit" if not self.held else f"a fit likelier by 2ΔlnL = {self.gain:.0f}"
        one, names = self.reading, " and ".join(self.reading.names)
        s = "" if len(one.names) > 1 else "s"
        if one.is_swap:
            pairs = zip(one.channels, reversed(one.names), strict=True)
            lines = (f'Input("{c.name}", "{c.unit}", column="{other}")' for c, other in pairs)
            return (
                f"Inputs {names} act in each other's place against the start values ({told}). "
                f"Exchanged, {as_well} has the signs that were expected. If they are in each "
                f"other's column, write {' and '.join(lines)}; if the start values are wrong, "
                "change their signs."
            )
        if not one.unit:
            is_input = isinstance(one.channels[0], Input)
            kind, acts = ("Input", f"act{s}") if is_input else ("Output", f"read{s}")
            lines = (f'{kind}("{c.name}", "{c.unit}", sign={-c.sign:g})' for c in one.channels)
            return (
                f"{kind} {names} {acts} with the sign reversed against the start values ({told}). "
                f"With it reversed {as_well} has the signs that were expected. If the log counts "
                f"it the other way, write {' and '.join(lines)}; if the start values are wrong, "
                "change their signs."
            )
        return (
            f"Input {names} act{s} {abs(one.factor):.3g} times as strongly as the start values say "
            f"({told}): the log seems to hold {one.unit}, and {as_well} has the sizes that were "
            "expected. Check the unit in its header; if that is right, change the start values."
        )


@dataclass(frozen=True)
class _Values:
    """Estimates and what the start values say of them.

    Attributes
    ----------
    model : Model
        Bounds of the parameters.
    values, errors, nominal : mapping of str to float
        Estimates, their standard errors, and their start values; zero says nothing.
    """

    model: Model
    values: Mapping[str, float]
    errors: Mapping[str, float]
    nominal: Mapping[str, float]

    def ratio(self, name: str) -> float:
        """An estimate over its start value; NaN where the records or nobody told it."""
        clear = abs(self.values[name]) > CLEARLY * self.errors[name]
        return self.values[name] / self.nominal[name] if clear else np.nan

    def held(self, name: str, factor: float) -> bool:
        """Whether a bound keeps an estimate from a factor times its start value."""
        one, value, wanted = self.model.parameter(name), self.values[name], self.nominal[name]
        if one.log:  # comes near zero without end
            return factor < 0.0 and bool(np.isnan(self.ratio(name)))
        below, above = factor * wanted < one.lower, factor * wanted > one.upper
        return bool((below and value <= one.lower) or (above and value >= one.upper))

    def strange(self, factor: float) -> set[str]:
        """Estimates of the other sign, as large as another unit makes them, or held from that."""
        # A size is strange from half of what the unit makes of it.
        far = np.log(max(abs(factor), 1.0 / abs(factor)) / TWOFOLD)

        def is_strange(name: str) -> bool:
            ratio = self.ratio(name)
            other = ratio < 0.0 if factor < 0.0 else ratio > 0.0 and abs(np.log(ratio)) > far
            return bool(other) or self.held(name, factor)

        return {name for name in self.values if self.nominal.get(name) and is_strange(name)}

    def expected(self, name: str, factor: float) -> bool:
        """Whether an estimate clearly has the sign, or the size, of its start value."""
        ratio = self.ratio(name)
        most = np.inf if factor < 0.0 else TWOFOLD
        return bool(1.0 / most < ratio < most)


@once_a_fit
def input_factors(fit: Estimate, nominal: Mapping[str, float]) -> tuple[InputFactor, ...]:
    """Inputs that act with another sign or in another unit than the start values say.

    Parameters
    ----------
    fit : Estimate
        Of finite cost.
    nominal : mapping of str to float
        Values that the parameters were expected to have; zero says nothing.
    """
    if not np.isfinite(fit.cost):
        return ()
    found = _Values(fit.model, fit.values, fit.std_errors, nominal)
    moving = [
        channel
        for column, channel in enumerate(fit.model.inputs)
        if np.ptp(np.concatenate([record.inputs[:, column] for record in fit.dataset]))
    ]
    return tuple(_otherwise(fit, found, moving))


def _otherwise(fit: Estimate, found: _Values, moving: Sequence[Input]) -> Iterator[InputFactor]:
    """Rivals that hold: of each input the first, of several what none of them alone explains."""
    told = set[str]()
    for one in _readings(moving):
        if told.isdisjoint(one.names) and (rival := _rival(fit, found, one)):
            told.update(one.names)
            yield rival
    # An output of the other sign is that of all inputs where each depends on these.
    for output in () if told else fit.model.outputs:
        if rival := _rival(fit, found, Reading((output,), -1.0)):
            yield rival


def _readings(moving: Sequence[Input]) -> Iterator[Reading]:
    """Other readings of inputs: of each its sign and unit, of two their columns, then of all."""
    ordered = sorted(moving, key=lambda one: one.unit)
    alike = [tuple(some) for _, some in groupby(ordered, key=lambda one: one.unit)]
    groups = [(one,) for one in moving]
    for group in groups:
        yield from _factors(group)
    for some in alike:
        yield from (Reading(pair, 1.0) for pair in combinations(some, 2))
    for some in alike:
        if len(some) > 1:
            yield from _factors(some)


def _factors(group: tuple[Input, ...]) -> Iterator[Reading]:
    """The other sign and the other units of inputs of one unit."""
    yield Reading(group, -1.0)
    yield from (Reading(group, factor, unit) for factor, unit in UNITS.get(group[0].unit, ()))


def _rival(fit: Estimate, found: _Values, one: Reading) -> InputFactor | None:
    """A reading of inputs with which fewer estimates are strange, if the records allow it."""
    # What is strange by its value stays so in the rival, where errors may call it clear.
    certain = replace(found, errors=dict.fromkeys(found.errors, 0.0))
    strange = found.strange(one.strange)
    told = _reread(fit, found.nominal, one) if strange else None
    if told is None:
        return None
    rival, gain = told
    moved = [n for n in fit.names if n in strange and rival.expected(n, one.strange)]
    held = tuple(name for name in moved if found.held(name, one.strange))
    needed = BEYOND**2 if held or not fit.status.ok else -(CLEARLY**2)
    left = certain.strange(one.strange) - {*moved}
    if not moved or gain <= needed or not rival.strange(one.strange) <= left:
        return None
    values = {name: (fit.values[name], found.nominal[name]) for name in moved}
    return InputFactor(one, values, held, gain)


def _reread(
    fit: Estimate, nominal: Mapping[str, float], reading: Reading
) -> tuple[_Values, float] | None:
    """The fit with inputs read otherwise, and how much likelier it is; None where it fails.

    Levels of the noise are estimated for both: under feedback those of the wrong reading, which
    hold what it does not explain, would bend the estimates of the right one.
    """
    reread = Dataset(tuple(map(reading.of, fit.dataset)))
    begun = {name: nominal.get(name, value) for name, value in fit.values.items()}
    other = replace(fit, model=fit.model.with_values(begun), dataset=reread)
    try:
        end, cost = _ended(other), _as_logged(fit)
    except (OedSysidError, np.linalg.LinAlgError):
        return None
    if not (np.isfinite(end.cost) and np.isfinite(cost)):
        return None
    unknowns, layout, limits = end.point.unknowns, end.problem.layout, end.problem.limits
    matrix, _ = limits.with_priors(end.matrix, end.right, unknowns)
    values, slopes = layout.shared_values(unknowns)
    errors = slopes * np.sqrt(np.diag(inverse_of(matrix)))[: len(values)]
    names = layout.shared_names
    rival = _Values(fit.model, by_name(names, values), by_name(names, errors), nominal)
    independent = sum(some for some, _ in fit.effective_samples().values())
    return rival, 2.0 * (cost - end.cost) / max(2.0 * cost / max(independent, 1.0), 1.0)


@once_a_fit
def _as_logged(fit: Estimate) -> float:
    """What the same costs with the inputs as they were logged."""
    return _ended(fit, again=True).cost


def _ended(fit: Estimate, *, again: bool = False) -> Solution:
    """Where the likelihood of a fit ends, from its model's values or ``again`` from its end."""
    if fit.innovations is not None:
        problem, _ = posed_again(fit, levels=True)
        return solve_filtered(problem, problem.point(fit.initial_states, fit.local_values))
    shooting = Shooting(fit.model, fit.dataset, fit.sigma)
    return solve(shooting, shooting.warm_point(fit if again else None))
