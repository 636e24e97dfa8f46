"""What accelerometers and load cells see, as expressions of an output."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from oed_sysid.errors import ModelError
from oed_sysid.physics.channels import Output
from oed_sysid.physics.texts import Place, cross, minus, plus, text_of, times


def accelerometer_text(
    axis: str, active: Collection[str], at: Place, down: Sequence[str], gravity: float
) -> str:
    """Specific force along a body axis; ``down`` is the direction of gravity in body axes.

    >>> accelerometer_text("y", "uvr", (0.3, 0, 0), ("0", "0", "1"), 9.81)
    'dot(v) + r*u + dot(r)*0.3'
    """
    if axis not in ("x", "y", "z"):
        raise ModelError(f"An accelerometer along {axis!r} does not exist. Choose x, y or z.")
    i = "xyz".index(axis)

    def present(names: str) -> list[str]:
        return [name if name in active else "0" for name in names]

    def rates(names: str) -> list[str]:
        return [f"dot({name})" if name in active else "0" for name in names]

    place, spin, speed = [text_of(c) for c in at], present("pqr"), present("uvw")
    turning = cross(spin, cross(spin, place))
    parts = (rates("uvw"), cross(spin, speed), cross(rates("pqr"), place), turning)
    weight = "0" if gravity == 0 else minus(times(text_of(gravity), down[i]))
    return plus(*(part[i] for part in parts), weight)


def load_cell(
    name: str,
    axis: str,
    effect: str | None = None,
    *,
    unit: str = "N",
    noise_std: float | None = None,
) -> Output:
    """Force on an axis as a measured signal: of all effects, or of one.

    >>> load_cell("stock", "Y", "rudder").source
    'force("Y", "rudder")'
    """
    text = f'force("{axis}")' if effect is None else f'force("{axis}", "{effect}")'
    return Output(name, unit, f"measured force {axis}", text, noise_std=noise_std)
