r"""Inputs that act the other way round, or in another unit, than the start values say.

An input of the other sign is a coefficient of the other sign: the fit converges, its residuals are
noise, and every controller designed with it steers to the wrong side. Kinematics cannot see it, but
the start values of the nominal model can. With :math:`y(d, p)` the model's outputs for an input
:math:`d`, parameters :math:`p_j` of a set :math:`F` that went to a value of about :math:`k` times
their start values, and all others left alone, the input is named where

.. math:: \left\| \frac{y(k\,d,\; p_F / k) - y(d,\; p)}{\sigma} \right\|_{rms} < \epsilon :

read in another unit (:math:`k = 180/\pi`, say) or with the other sign (:math:`k = -1`), the same
trajectories have the parameters that were expected. No parameter that the records give and that
has the expected sign can be part of :math:`F`, so that one start value of the wrong sign among
several right ones says nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.likelihood.delays import values_of
from oed_sysid.likelihood.estimate import Estimate
from oed_sysid.physics.channels import Input

DEGREE = np.pi / 180.0
# What a log may hold, by the unit that it was read in; only ratios that no guess is off by.
UNITS: dict[str, tuple[tuple[float, str], ...]] = {
    "rad": ((DEGREE, "degrees read as radians"), (1.0 / DEGREE, "radians read as degrees")),
    "rad/s": ((2.0 * np.pi / 60.0, "rpm read as rad/s"), (30.0 / np.pi, "rad/s read as rpm")),
    "1/s": ((1.0 / 60.0, "rpm read as 1/s"), (60.0, "1/s read as rpm")),
    "N": ((1e3, "kN read as N"), (1e-3, "N read as kN")),
}
# Standard errors from which on a value is not zero.
CLEAR = 3.0
# Factor within which a start value has to be what the other unit would give.
NEAR = 2.0
# Change of the outputs, in noise levels, below which two runs are the same.
SAME = 0.1


@dataclass(frozen=True)
class OtherWay:
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
    """

    channel: Input
    factor: float
    unit: str
    values: Mapping[str, tuple[float, float]]

    @property
    def text(self) -> str:
        """What was expected, what was found, what to do."""
        name, unit = self.channel.name, self.channel.unit
        told = ", ".join(f"{key} is {a:.3g} for {b:.3g}" for key, (a, b) in self.values.items())
        if not self.unit:
            line = f'Input("{name}", "{unit}", sign={-self.channel.sign:g})'
            return (
                f"Input {name} acts the other way round than the start values say ({told}). With "
                "it reversed the same fit has the signs that were expected. If the log counts it "
                f"the other way, write {line}; if the start values are wrong, change their signs."
            )
        return (
            f"Input {name} acts {abs(self.factor):.3g} times as strongly as the start values say "
            f"({told}): its log seems to hold {self.unit}. Check the unit in its header; if that "
            "is right, change the start values."
        )


def other_way(fit: Estimate, nominal: Mapping[str, float]) -> tuple[OtherWay, ...]:
    """Inputs that act with another sign or in another unit than the start values say.

    Parameters
    ----------
    fit : Estimate
        Converged.
    nominal : mapping of str to float
        Values that the parameters were expected to have; zero says nothing.
    """
    errors = dict(zip(fit.names, np.sqrt(np.diag(fit.covariance)), strict=True))
    ratios, loose = {}, []
    for name, value in zip(fit.names, fit.estimates, strict=True):
        if name not in nominal or not nominal[name] or not abs(value) > CLEAR * errors[name]:
            loose.append(name)  # the records do not say its sign, or nobody did before
        else:
            ratios[name] = float(value) / nominal[name]
    found = []
    for column, channel in enumerate(fit.model.inputs):
        for factor, unit in ((-1.0, ""), *UNITS.get(channel.unit, ())):
            if factor < 0.0:
                moved = [name for name, ratio in ratios.items() if ratio < 0.0]
            else:
                moved = [n for n, r in ratios.items() if 1.0 / NEAR < r / factor < NEAR]
            if moved and _is_the_same(fit, column, factor, moved, loose):
                values = {n: (float(fit.values[n]), nominal[n]) for n in moved}
                found.append(OtherWay(channel, factor, unit, values))
                break
    return tuple(found)


def _is_the_same(
    fit: Estimate, column: int, factor: float, moved: list[str], loose: list[str]
) -> bool:
    """Whether an input times a factor, and parameters divided by it, give the same outputs.

    Of parameters that say nothing those join that are needed: a coefficient that the records hardly
    show is divided, too, and the zero of a rudder is multiplied.
    """
    powers = dict.fromkeys(moved, -1)
    change = _change(fit, column, factor, powers)
    while change >= SAME:
        tried = {
            (name, power): _change(fit, column, factor, {**powers, name: power})
            for name in loose
            if name not in powers
            for power in ((-1,) if factor == -1.0 else (-1, 1))
        }
        best = min(tried, key=lambda one: tried[one], default=None)
        if best is None or not tried[best] < change:
            return False
        change = tried[best]
        powers[best[0]] = best[1]
    return True


def _change(fit: Estimate, column: int, factor: float, powers: Mapping[str, int]) -> float:
    """Root mean square change of the outputs, in noise levels; infinite where none can be said."""
    runner, change, count = kernel(fit.model), 0.0, 0
    scales = np.ones(len(fit.model.parameter_names))
    for name, power in powers.items():
        scales[fit.model.parameter_names.index(name)] = factor**power
    for index, record in enumerate(fit.dataset):
        if not np.ptp(record.inputs[:, column]):
            continue
        values, inputs = values_of(fit, index), np.array(record.inputs)
        other = values * scales
        inputs[:, column] *= factor
        ends = []
        for commands, numbers in ((record.inputs, values), (inputs, other)):
            own = fit.initial_states[index]
            start, _ = runner.start(own, commands[0], numbers, record.times[0])
            ends.append(runner.run(record.times, commands, numbers, start).outputs)
        scaled = ((ends[1] - ends[0]) / fit.sigma)[np.isfinite(record.outputs)]
        with np.errstate(over="ignore", invalid="ignore"):
            change, count = change + float(scaled @ scaled), count + len(scaled)
    size = float(np.sqrt(change / count)) if count else np.inf
    return size if np.isfinite(size) else np.inf
