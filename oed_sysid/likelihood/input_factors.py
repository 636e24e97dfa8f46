r"""Inputs that act reversed, or in another unit, than the start values say.

An input of the other sign is a coefficient of the other sign: the fit converges, its residuals are
noise, and every controller designed with it steers to the wrong side. Kinematics cannot see it, but
the start values :math:`p_0` of the nominal model can. Where an estimate is strange against them,
clearly of the other sign or of the size that another unit gives, or held at a bound that lies on
its way there, the rival reading of each input is estimated too: the same likelihood, kinds of noise
and start values, and :math:`k` times that input,

.. math:: D = 2\min_p L(k\,d, p) - 2 \min_p L(d, p), \qquad L = -\log \text{likelihood},

with :math:`k = -1`, or a ratio of units. The rival is named where no estimate is strange that was
not before, fewer are, and the records do not speak against it: :math:`D < c^2` where nothing held
the estimates, which then are others for the same motion, and :math:`-D > C^2` where a bound did (or
the fit did not converge), in standard errors :math:`c, C`, of residuals counted by their misfit and
correlation. So one start value of the wrong sign among several right ones says nothing: with the
input reversed it is the others that are strange.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import OedSysidError
from oed_sysid.likelihood.departures import CLEARLY, TWOFOLD
from oed_sysid.likelihood.estimate import Estimate, by_name, once_a_fit
from oed_sysid.likelihood.gauss_newton import Solution, solve, solve_filtered
from oed_sysid.likelihood.laws import posed_again
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.physics.channels import Input
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
class InputFactor:
    """An input that acts otherwise than the start values say.

    Attributes
    ----------
    channel : Input
    factor : float
        The true input over the logged one: -1, or a ratio of units.
    unit : str
        What the log seems to hold; empty for a sign.
    values : mapping of str to (float, float)
        Parameters concerned: what was found, and the start value.
    held : tuple of str
        Those of them that a bound kept from the other sign or size.
    gain : float
        Twice the log-likelihood ratio of the input so read to the input as logged.
    """

    channel: Input
    factor: float
    unit: str
    values: Mapping[str, tuple[float, float]]
    held: tuple[str, ...] = ()
    gain: float = 0.0

    @property
    def text(self) -> str:
        """What was expected, what was found, what to do."""
        name, unit = self.channel.name, self.channel.unit
        told = ", ".join(
            f"{key} is {a:.3g}{', at its bound,' if key in self.held else ''} for {b:.3g}"
            for key, (a, b) in self.values.items()
        )
        as_well = "the same fit" if not self.held else f"a fit likelier by 2ΔlnL = {self.gain:.0f}"
        if not self.unit:
            line = f'Input("{name}", "{unit}", sign={-self.channel.sign:g})'
            return (
                f"Input {name} acts with the sign reversed against the start values ({told}). With "
                f"it reversed {as_well} has the signs that were expected. If the log counts it "
                f"the other way, write {line}; if the start values are wrong, change their signs."
            )
        return (
            f"Input {name} acts {abs(self.factor):.3g} times as strongly as the start values say "
            f"({told}): its log seems to hold {self.unit}, and {as_well} has the sizes that were "
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
    return tuple(
        one
        for column, channel in enumerate(fit.model.inputs)
        if np.ptp(np.concatenate([record.inputs[:, column] for record in fit.dataset]))
        for one in _otherwise(fit, found, column, channel)
    )


def _otherwise(fit: Estimate, found: _Values, column: int, channel: Input) -> Iterator[InputFactor]:
    """How an input acts other than expected: reversed, or in another unit; the first that holds."""
    # What is strange by its value stays so in the rival, where errors may call it clear.
    certain = replace(found, errors=dict.fromkeys(found.errors, 0.0))
    for factor, unit in ((-1.0, ""), *UNITS.get(channel.unit, ())):
        strange = found.strange(factor)
        told = _reread(fit, found.nominal, column, factor) if strange else None
        if told is None:
            continue
        rival, gain = told
        moved = [n for n in fit.names if n in strange and rival.expected(n, factor)]
        held = tuple(name for name in moved if found.held(name, factor))
        needed = BEYOND**2 if held or not fit.status.ok else -(CLEARLY**2)
        if moved and gain > needed and rival.strange(factor) <= certain.strange(factor) - {*moved}:
            values = {name: (fit.values[name], found.nominal[name]) for name in moved}
            yield InputFactor(channel, factor, unit, values, held, gain)
            return


def _reread(
    fit: Estimate, nominal: Mapping[str, float], column: int, factor: float
) -> tuple[_Values, float] | None:
    """The fit with an input times a factor, and how much likelier it is; None where it fails.

    Levels of the noise are estimated for both: under feedback those of the wrong reading, which
    hold what it does not explain, would bend the estimates of the right one.
    """
    scales = np.ones(len(fit.model.inputs))
    scales[column] = factor
    reread = Dataset(tuple(replace(one, inputs=one.inputs * scales) for one in fit.dataset))
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
