"""Experiments that make rival explanations fail: T-optimality, linearised."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.design.criteria import Measure
from oed_sysid.design.elimination import eliminate
from oed_sysid.effects import Effect
from oed_sysid.errors import DesignError
from oed_sysid.model import Model

_SMALLEST = 1e-9
# Width of the soft minimum over pairs, in units of log misfit.
_SOFTNESS = 0.1


@dataclass(frozen=True)
class Discriminate:
    r"""Maximise the misfit that remains when the wrong rival has been refitted.

    Every rival shifts the outputs by :math:`d_i` (whitened difference to the
    nominal model, at a nominal amplitude). The part of it that the free
    parameters and start states could imitate is projected out, and, against
    another rival, the part that this rival could imitate at any amplitude:

    .. math:: T_{i|j} = d_i' P d_i - (d_i' P d_j)^2 / d_j' P d_j

    The criterion is the logarithm of the smallest :math:`T` over all pairs,
    the nominal model included. :math:`T` is the expected gain of
    :math:`2 \Delta \log L` of the truth over its best rival, a noncentral
    chi-square's parameter: above 16 to 25 the choice is nearly certain.

    Parameters
    ----------
    rivals : sequence of Effect or Model
        Effects are added to the model, at their value or else a share of their scale;
        models replace it and must have the same inputs and outputs.
    against_believed : bool
        Whether each rival has also to be told from the model without it.
    size : float
        Amplitude of effects without a value, as a share of their scale. Choose
        it small: what separates weak effects separates strong ones, while the
        shift by a strong effect says little about how a refit would go.

    References
    ----------
    W. G. Hunter, A. M. Reiner, Designs for discriminating between two rival
    models, *Technometrics* 7 (1965) 307-323.
    A. C. Atkinson, V. V. Fedorov, The design of experiments for discriminating
    between two rival models, *Biometrika* 62 (1975) 57-70.
    """

    rivals: Sequence[Effect | Model]
    against_believed: bool = True
    size: float = 0.1

    def __post_init__(self) -> None:
        object.__setattr__(self, "rivals", tuple(self.rivals))
        names = self.rival_names
        if not names or len(set(names)) < len(names):
            raise DesignError(
                f"The rivals are {', '.join(names) or 'none'}; give one or more, each once."
            )
        if not self.size > 0:
            raise DesignError(f"size is {self.size}. Give a share of the scale above zero.")
        if len(names) == 1 and not self.against_believed:
            raise DesignError("One rival alone can only be told from the nominal model.")

    @property
    def rival_names(self) -> tuple[str, ...]:
        """Names of the rivals."""
        return tuple(rival.name for rival in self.rivals)

    @property
    def name(self) -> str:
        """Name for reports."""
        return f"discrimination of {', '.join(self.rival_names)}"

    def models(self, believed: Model) -> tuple[Model, ...]:
        """Return the rival models, at nominal amplitudes, built on the believed one."""
        found = []
        for rival in self.rivals:
            if isinstance(rival, Model):
                if rival.channels != believed.channels:
                    raise DesignError(
                        f"The rival {rival.name!r} has other inputs or outputs than "
                        f"{believed.name!r}. Give it the same channels."
                    )
                found.append(rival)
                continue
            values = {
                p.name: p.value or self.size * p.magnitude
                for p in rival.parameters
                if p.name in rival.amplitude_names
            }
            base = believed.without(rival.name) if rival.name in believed.effect_names else believed
            found.append(base + rival.with_values(values))
        return tuple(found)

    def bind_rivals(self, n_parameters: int) -> Measure:
        """Return the criterion of the information on ``[parameters, rival shifts]``."""

        def measure(matrix: np.ndarray) -> tuple[float, np.ndarray]:
            gram, mapping = eliminate(matrix, n_parameters)
            pairs = pair_misfits(gram, against_believed=self.against_believed)
            logs = np.array([np.log(max(value, _SMALLEST)) for _, _, value in pairs])
            smallest = logs.min()
            weights = np.exp(-(logs - smallest) / _SOFTNESS)
            value = smallest - _SOFTNESS * np.log(np.mean(weights))
            weights /= weights.sum()
            by_gram = np.zeros_like(gram)
            for weight, (i, j, misfit) in zip(weights, pairs, strict=True):
                if misfit <= _SMALLEST:
                    continue
                direction = np.zeros(len(gram))
                direction[i] = 1.0
                if j >= 0:
                    direction[j] = -gram[i, j] / max(gram[j, j], _SMALLEST)
                by_gram += weight / misfit * np.outer(direction, direction)
            return float(value), mapping.T @ by_gram @ mapping

        return measure


def pair_misfits(gram: np.ndarray, *, against_believed: bool) -> list[tuple[int, int, float]]:
    """Misfit of each rival ``i`` after the best refit of rival ``j`` (-1: none).

    Parameters
    ----------
    gram : ndarray (n_rivals, n_rivals)
        Inner products of the projected shifts.
    against_believed : bool
        Whether the pairs with ``j = -1`` count.
    """
    n = len(gram)
    pairs = []
    for i in range(n):
        if against_believed or n == 1:
            pairs.append((i, -1, float(gram[i, i])))
        for j in range(n):
            if j != i:
                explained = gram[i, j] ** 2 / max(gram[j, j], _SMALLEST)
                pairs.append((i, j, float(gram[i, i] - explained)))
    return pairs
