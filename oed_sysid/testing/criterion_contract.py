r"""The contract of a design criterion, to be run on every criterion that is added.

A criterion maps the information :math:`F` on scaled parameters to a number, larger is
better. With :math:`S` a change of units and :math:`v v'` one more measurement,

.. math::
    \phi(F + v v') \ge \phi(F), \qquad
    \phi_S(S F_1 S) - \phi_S(S F_2 S) = \phi(F_1) - \phi(F_2)

the first for all that measure size, the second for those that are invariant.

>>> from oed_sysid.physics.channels import Input, Output, State
>>> from oed_sysid.design import DOptimal
>>> from oed_sysid.physics.model import Model
>>> from oed_sysid.physics.parameters import Parameter
>>> nomoto = Model(
...     "Nomoto",
...     (State("psi", "rad"), State("r", "rad/s")),
...     (Input("delta", "rad"),),
...     (Output("psi", "rad", noise_std=0.01),),
...     {"psi": "r", "r": "(K*delta - r)/T"},
...     parameters=(Parameter("K", 0.2, "1/s"), Parameter("T", 15.0, "s")),
... )
>>> check_criterion(DOptimal(), nomoto, rng=np.random.default_rng(1), invariant=True)
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from oed_sysid.design.criteria import Criterion, Setting
from oed_sysid.errors import OedSysidError
from oed_sysid.information.noise import noise_of
from oed_sysid.physics.model import Model

# Of finite differences, relative to the information; and what they leave.
_STEP, _GRADIENT = 1e-5, 1e-5
# Relative to the values: rounding of eigenvalues and inverses.
_ROUNDING = 1e-8


def check_criterion(
    criterion: Criterion,
    model: Model,
    *,
    rng: np.random.Generator,
    invariant: bool = False,
    monotone: bool = True,
    n_points: int = 4,
) -> None:
    """Check everything that the search for experiments relies on in a criterion.

    * It has a name, and ``bind`` gives a value and a symmetric derivative of the shape of
      the information; both are finite, also where nothing is known of a parameter.
    * It gives the same result twice and leaves the matrix alone.
    * Its derivative equals finite differences.
    * More information never counts less, where that is claimed.
    * Comparisons of designs do not hang on the parameters' units, where that is claimed.

    Parameters
    ----------
    criterion : Criterion
        The criterion, as configured.
    model : Model
        With two or more free parameters, and outputs that state their noise.
    rng : numpy.random.Generator
        Source of the matrices.
    invariant : bool
        Whether it claims invariance under a change of units (D does, A and E do not).
    monotone : bool
        Whether it claims that information never harms (a condition number cannot).
    n_points : int
        Random information matrices.

    Raises
    ------
    AssertionError
        With a line for every broken promise.
    """
    names = tuple(p.name for p in model.free_parameters if not p.per_record)
    scales = np.array([model.parameter(name).magnitude for name in names])
    setting = Setting(model, names, scales, noise_of(model))
    name = str(getattr(criterion, "name", ""))
    if not name or not isinstance(criterion, Criterion):
        raise AssertionError("A criterion has a name and bind(setting).")
    try:
        measure = criterion.bind(setting)
    except OedSysidError as error:
        raise AssertionError(f"Criterion {name!r}:\n- does not bind: {error}") from None
    broken: list[str] = []
    units = np.exp(rng.uniform(-1.0, 1.0, len(names)))
    # The same parameters in other units: so much smaller scales, so much less information.
    rescaled = criterion.bind(replace(setting, scales=scales * units)) if invariant else None
    before: tuple[float, float] | None = None
    for _ in range(n_points):
        matrix = _matrix(rng, len(names))
        kept = matrix.copy()
        value, gradient = measure(matrix)
        again, _ = measure(matrix)
        if not np.array_equal(matrix, kept):
            broken.append("changes the matrix that it is given")
            matrix = kept
        if value != again:
            broken.append("gives two results for the same information")
        if gradient.shape != matrix.shape or not np.isfinite(gradient).all():
            broken.append(f"returns a derivative of shape {gradient.shape} or not finite")
            break
        if not np.allclose(gradient, gradient.T, rtol=1e-6, atol=1e-9 * np.abs(gradient).max()):
            broken.append("returns a derivative that is not symmetric")
        broken += _derivative(measure, matrix, gradient, rng)
        if monotone:
            row = rng.normal(size=len(names)) * np.sqrt(np.diag(matrix))
            more, _ = measure(matrix + np.outer(row, row))
            if more < value - _ROUNDING * max(abs(value), 1.0):
                broken.append(f"falls from {value:.6g} to {more:.6g} by one more measurement")
        if rescaled is not None:
            other, _ = rescaled(matrix * units[:, None] * units)
            if before is not None:
                one, two = value - before[0], other - before[1]
                if abs(one - two) > 1e-6 * max(abs(one), abs(two), 1.0):
                    broken.append(f"prefers by {one:.6g}, in other units by {two:.6g}")
            before = value, other
    blind = _matrix(rng, len(names))
    blind[0], blind[:, 0] = 0.0, 0.0
    value, gradient = measure(blind)
    if not (np.isfinite(value) and np.isfinite(gradient).all()):
        broken.append("is not finite where nothing is known of a parameter")
    if broken:
        lines = "\n".join(f"- {line}" for line in dict.fromkeys(broken))
        raise AssertionError(f"Criterion {name!r}:\n{lines}")


def _matrix(rng: np.random.Generator, n: int) -> np.ndarray:
    """A well conditioned information matrix with errors of some per cent."""
    rows = rng.normal(size=(4 * n, n)) * np.exp(rng.uniform(1.0, 3.0, n))
    return rows.T @ rows


def _derivative(
    measure: Any, matrix: np.ndarray, gradient: np.ndarray, rng: np.random.Generator
) -> list[str]:
    row = rng.normal(size=len(matrix)) * np.sqrt(np.diag(matrix))
    direction = np.outer(row, row)
    up, down = (measure(matrix + sign * _STEP * direction)[0] for sign in (1, -1))
    slope = (up - down) / (2.0 * _STEP)
    stated = float(np.sum(gradient * direction))
    if abs(slope - stated) > _GRADIENT * max(abs(slope), abs(stated), 1e-3):
        return [f"states the slope {stated:.6g} where differences find {slope:.6g}"]
    return []
