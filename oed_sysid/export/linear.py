r"""A linear model for python-control, about a trim.

.. math:: \dot x = A x + B u, \qquad y = C x + D u,

all being deviations from the trim; actuators and sensors are settled. The covariance
:math:`\Sigma` of the parameters becomes standard errors of the entries of A and B, through their
derivatives :math:`J` by the parameters (the trim moves with them), :math:`J \Sigma J^T`.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from string import Template
from typing import Any

import numpy as np

from oed_sysid.errors import ModelError, SimulationError
from oed_sysid.experiments.steady import equilibrium, linearise
from oed_sysid.export.program import Program
from oed_sysid.physics.model import Model
from oed_sysid.runtime.files import write_text
from oed_sysid.text.typeset import safe

_TEXT = Template('''"""$origin.

Linear about the trim below: deviations of states, inputs and outputs, SI units and radians.
Needs python-control; `python $file` prints the poles.
"""

import control
import numpy as np

TRIM = {
    "states": $states,
    "inputs": $inputs,
}
A = np.array($a)
B = np.array($b)
C = np.array($c)
D = np.array($d)
# Standard errors of the entries of A and B that follow from those of the parameters.
A_STD = np.array($a_std)
B_STD = np.array($b_std)
PARAMETERS = $parameters
ESTIMATED = $estimated
COVARIANCE = np.array($covariance).reshape(len(ESTIMATED), len(ESTIMATED))

system = control.ss(
    A,
    B,
    C,
    D,
    inputs=$input_names,
    outputs=$output_names,
    states=$state_names,
    name=$name,
)

if __name__ == "__main__":
    for pole in system.poles():
        print(f"{pole:.6g}")
''')


def write_control(
    program: Program, path: Path, trim: Mapping[str, float] | None = None
) -> tuple[Path, ...]:
    """Write a Python file that makes a ``control.StateSpace``.

    Parameters
    ----------
    program : Program
        The model.
    path : Path
        ``name.py``, or a folder for ``NAME_linear.py``.
    trim : mapping of str to float, optional
        Inputs and states that are given there; inputs that are left out are zero, states are
        solved for.

    Returns
    -------
    tuple of Path
        The file.

    Raises
    ------
    ModelError
        If a name is unknown or there is no equilibrium.
    """
    model = program.model
    matrices, point = _linear(model, dict(trim or {}))
    steps = np.sqrt(np.maximum(np.diag(program.covariance), 0.0))
    slopes = []
    for name, step in zip(program.free, steps, strict=True):
        # A thousandth of the standard error is far below the curvature and above rounding.
        size = 1e-3 * step or 1e-9
        up, _ = _linear(_moved(model, name, size), dict(trim or {}), guess=point)
        down, _ = _linear(_moved(model, name, -size), dict(trim or {}), guess=point)
        slopes.append([(p - m) / (2 * size) for p, m in zip(up, down, strict=True)])
    spread = [
        np.sqrt(
            np.maximum(
                np.einsum(
                    "iab,ij,jab->ab",
                    np.array([one[k] for one in slopes]),
                    program.covariance,
                    np.array([one[k] for one in slopes]),
                ),
                0.0,
            )
        )
        if slopes
        else np.zeros_like(matrices[k])
        for k in (0, 1)
    ]
    file = path if path.suffix == ".py" else path / f"{program.identifier}_linear.py"
    names, values = program.names, [float(value) for value in model.value_vector]
    a, b, c, d = (_rows(one) for one in matrices)
    write_text(
        file,
        _TEXT.substitute(
            origin=program.origin,
            file=safe(file.name),
            states=dict(zip(names.states, point.states.values(), strict=False)),
            inputs=dict(zip(names.inputs, point.inputs.values(), strict=True)),
            a=a,
            b=b,
            c=c,
            d=d,
            a_std=_rows(spread[0]),
            b_std=_rows(spread[1]),
            parameters=dict(zip(names.parameters, values, strict=True)),
            estimated=names.free,
            covariance=program.covariance.tolist(),
            input_names=list(names.inputs),
            output_names=list(names.outputs),
            state_names=list(names.states),
            name=repr(program.identifier),
        ),
    )
    return (file,)


def _moved(model: Model, name: str, by: float) -> Model:
    return model.with_values({name: model.values[name] + by})


def _linear(
    model: Model, trim: dict[str, float], guess: Any = None
) -> tuple[tuple[np.ndarray, ...], Any]:
    """Matrices and equilibrium of a model."""
    inputs = {name: trim.pop(name, 0.0) for name in model.input_names}
    start = dict(guess.states) if guess is not None else None
    try:
        point = equilibrium(model, inputs=inputs, fixed=trim, guess=start)
        system = linearise(model, point)
    except SimulationError as error:
        raise ModelError(
            f"There is no trim to linearise about. {error} Inputs that are not given are zero: "
            "give them, or states to be held, with --at NAME=VALUE or trim={...}."
        ) from None
    return (system.A, system.B, system.C, system.D), point


def _rows(matrix: np.ndarray) -> str:
    rows = [str([float(value) for value in row]) for row in np.atleast_2d(matrix)]
    return "[\n    " + ",\n    ".join(rows) + ",\n]"
