r"""What absent effects would do to a run, beside what the parameters do.

An effect of amplitudes :math:`a` (in units of the size that counts) moves the outputs by
:math:`\sum_k a_k d_k`, the parameters by :math:`J\,\Delta\theta`, both in units of the noise
(whitened, or as innovations under disturbance forces). With start states and parameters of the run
eliminated, all runs together hold

.. math::
    \mathcal M = \sum_r \begin{pmatrix} J_r' M_r J_r & J_r' M_r d_r \\
    d_r' M_r J_r & d_r' M_r d_r \end{pmatrix}, \qquad M_r = I - J_{0r}(J_{0r}'J_{0r})^+J_{0r}'

and the Schur complement :math:`G` of the parameters in it is what they cannot imitate:
:math:`a'Ga` is the non-centrality of the score test of the effect
(:mod:`oed_sysid.evidence.score`), the expected gain of twice the log-likelihood by adding it.

``d`` is a derivative at zero where an amplitude may have either sign, else the change from nothing
to the whole size: backlash and dead bands have a kink at zero. Shape parameters (a frequency, a
time) are at their values.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.compiled.kernels import kernel
from oed_sysid.errors import DesignError, SimulationError
from oed_sysid.information.response import SAYS, TANGENT, CommandedRun
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.physics.parameters import Parameter
from oed_sysid.runtime.constants import TOLD_APART

# Statistics within it are the same.
GROUP_WIDTH = TOLD_APART


@dataclass(frozen=True, eq=False)
class Group:
    """Columns of one effect, or of a rival model.

    Attributes
    ----------
    name : str
    columns : ndarray of int
        Positions among the shifts.
    weight : ndarray (n_columns, n_columns)
        Non-centrality is the trace of this times the Gram matrix: of known amplitudes their
        products, of unknown ones the mean over directions.
    freedom : int
        Amplitudes and shapes that a fit would estimate.
    sizes : mapping of str to float
        Amplitudes that count as one, SI units.
    """

    name: str
    columns: np.ndarray
    weight: np.ndarray
    freedom: int
    sizes: Mapping[str, float]


@dataclass(frozen=True, eq=False)
class Shifts:
    """Models that each differ in one respect from the nominal one.

    Attributes
    ----------
    models : tuple of Model
        One for each column.
    factors : ndarray (n_columns,)
        From the difference of the outputs to the column.
    groups : tuple of Group
    """

    models: tuple[Model, ...]
    factors: np.ndarray
    groups: tuple[Group, ...]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the effects or rival models."""
        return tuple(group.name for group in self.groups)

    def __len__(self) -> int:
        return len(self.models)

    @classmethod
    def of(cls, nominal: Model, rivals: Sequence[Effect | Model], *, size: float = 1.0) -> Shifts:
        """Return the shifts by effects and rival models.

        Parameters
        ----------
        nominal : Model
        rivals : sequence of Effect or Model
            Effects count at their amplitudes, or at a share of their scale where these are zero;
            models as they are.
        size : float
            That share.

        Raises
        ------
        DesignError
            If a rival model has other channels, or an effect has no amplitude.

        Examples
        --------
        >>> from oed_sysid import load_problem
        >>> problem = load_problem("remus_diving_plane")
        >>> drag, wave = problem.effect("fin_stall"), problem.effect("wave_heave_force")
        >>> found = Shifts.of(problem.model, [drag, wave])
        >>> len(found), [group.freedom for group in found.groups]
        (3, [1, 3])
        """
        effects = tuple(r for r in rivals if isinstance(r, Effect))
        fresh = tuple(e.absent() for e in effects if e.name not in nominal.effect_names)
        # One structure for all: compiled once, values are arguments.
        wide = nominal + fresh if fresh else nominal
        models, factors, groups = list[Model](), list[float](), list[Group]()
        for rival in rivals:
            if isinstance(rival, Model):
                group, moved, factor = _of_model(nominal, rival)
            else:
                group, moved, factor = _of_effect(nominal, wide, rival, size)
            # One effect or model each, beside one another.
            groups.append(replace(group, columns=len(models) + np.arange(len(moved))))
            models += moved
            factors += [factor] * len(moved)
        return cls(tuple(models), np.array(factors), tuple(groups))

    def columns(self, given: CommandedRun, outputs: np.ndarray) -> np.ndarray:
        """Changes of the outputs in one run, ``(n_times, n_outputs, n_columns)``.

        Parameters
        ----------
        given : CommandedRun
        outputs : ndarray (n_times, n_outputs)
            Of the nominal model.

        Raises
        ------
        SimulationError
            If the vehicle with an effect diverges.
        """
        found = np.empty((*outputs.shape, len(self)))
        for position, rival in enumerate(self.models):
            run = kernel(rival).simulate(
                given.times, given.inputs, rival.value_vector, given.initial
            )
            if not run.ok:
                name = next(g.name for g in self.groups if position in g.columns)
                raise SimulationError(SAYS["too_much_of_it"].format(name=name, given=given))
            found[:, :, position] = self.factors[position] * (run.outputs - outputs)
        return found


# Columns of an effect or a rival, their models, and the factor of their changes.
_Part = tuple[Group, list[Model], float]


def _of_model(nominal: Model, rival: Model) -> _Part:
    """The whole difference that a rival model makes."""
    # Levels of noise may differ: those of the nominal model count.
    if (rival.input_names, rival.output_names) != (nominal.input_names, nominal.output_names):
        raise DesignError(SAYS["other_channels"].format(rival=rival, nominal=nominal))
    return Group(rival.name, np.arange(1), np.eye(1), 1, {}), [rival], 1.0


def _of_effect(nominal: Model, wide: Model, effect: Effect, size: float) -> _Part:
    """A tangent for each amplitude that may have either sign, else one whole change."""
    sizes = _sizes(effect, size)
    base = wide
    if effect.name in nominal.effect_names:
        base = nominal.without(effect.name) + effect.absent()
    # An effect that the nominal model has already is taken out: the shift is its whole change.
    smooth = two_sided(effect) and base is wide
    parts = [{name: value} for name, value in sizes.items()] if smooth else [sizes]
    share = TANGENT if smooth else 1.0
    shapes = {p.name: p.value for p in effect.parameters if p.name not in sizes}
    models = [
        base.with_values(shapes | {n: share * value for n, value in part.items()}) for part in parts
    ]
    n, freedom = len(parts), len(sizes) + len(effect.shape_names)
    group = Group(effect.name, np.arange(n), _weight(effect, n), freedom, sizes)
    return group, models, 1.0 / share


def _weight(effect: Effect, n: int) -> np.ndarray:
    """Products of amplitudes that are known, else the mean over directions, ``(n, n)``."""
    amplitudes = [p for p in effect.parameters if p.name in effect.amplitude_names]
    # Amplitudes that are stated count with their signs together; unknown ones by the mean over
    # directions, which is the trace over their number.
    given = np.array([float(p.value != 0) for p in amplitudes])
    return np.outer(given, given) if given.any() and n > 1 else np.eye(n) / n


def two_sided(effect: Effect) -> bool:
    """Whether amplitudes may have either sign; other effects often have a kink at zero."""
    return all(p.lower < 0 for p in effect.parameters if p.name in effect.amplitude_names)


def _sizes(effect: Effect, size: float) -> dict[str, float]:
    if not effect.amplitude_names:
        raise DesignError(SAYS["no_amplitude"].format(effect=effect))
    chosen = [p for p in effect.parameters if p.name in effect.amplitude_names]
    # Beside a known amplitude the others give directions only, whose length is no matter.
    share = TANGENT * size if any(p.value for p in chosen) else size
    return {p.name: p.value or _signed(p, share) for p in chosen}


def _signed(parameter: Parameter, size: float) -> float:
    """Typical amplitude of a sign that the bounds allow, and within them."""
    value = size * parameter.magnitude
    if parameter.upper < value:
        value = max(-value, parameter.lower) if parameter.upper <= 0 else parameter.upper
    return value
