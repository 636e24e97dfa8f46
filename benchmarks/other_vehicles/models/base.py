"""What a nominal model of a vehicle has to offer to the benchmark."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oed_sysid import Actuator, Force, Model, Output, Parameter, State, physics
from oed_sysid.physics import Effect, amplitude

RELATIVE_PRIOR = 0.3


def known(name: str, value: float, unit: str, description: str) -> Parameter:
    """A constant."""
    return Parameter(name, value, unit, fixed=True, description=description)


def guess(name: str, value: float, unit: str = "1", description: str = "") -> Parameter:
    """A parameter that is believed to within 30 per cent."""
    spread = RELATIVE_PRIOR * abs(value)
    return Parameter(name, value, unit, prior_mean=value, prior_std=spread, description=description)


def force(name: str, terms: Mapping[str, str], unit: str, scale: float, words: str) -> Force:
    """A force of one amplitude, which the terms are multiplied by."""
    size = amplitude(name, unit, scale=scale)
    scaled = {axis: f"{size.name}*({text})" for axis, text in terms.items()}
    return Force(name, scaled, (size,), description=words)


def zero(name: str, signal: str, unit: str, *, scale: float, bound: float = math.inf) -> Actuator:
    """The zero of an actuator, set anew before each run."""
    size = amplitude(name, unit, scale=scale, bound=bound, per_record=True)
    words = f"zero of {signal} set anew before each run"
    return Actuator(name, {signal: f"{signal} + {size.name}"}, (size,), description=words)


def wind(scale: float) -> Force:
    """A constant force from a fixed direction."""
    return Force(
        "wind_force",
        {
            "X": "E_wind_north*cos(psi) + E_wind_east*sin(psi)",
            "Y": "E_wind_east*cos(psi) - E_wind_north*sin(psi)",
        },
        (amplitude("wind_north", "N", scale=scale), amplitude("wind_east", "N", scale=scale)),
        description="constant force from a fixed direction",
        needs="several headings",
    )


def candidates(name: str, *own: Effect) -> tuple[Effect, ...]:
    """Effects of ``name.toml``; what is no function there is one of ``own``, by its name."""
    data = tomllib.loads(Path(__file__).with_name(f"{name}.toml").read_text(encoding="utf-8"))
    named = {effect.name: effect for effect in own}
    makers = vars(physics) | {maker.__name__: maker for maker in (force, zero, wind)}

    def made(kind: str, *words: Any) -> Effect:
        if kind in named:
            return named[kind]
        has_options = isinstance(words[-1], dict)
        return makers[kind](*words[:-1], **words[-1]) if has_options else makers[kind](*words)

    return tuple(made(*row) for row in data["candidates"])


def horizontal_plane(
    name: str,
    scales: Sequence[float],
    measured: Mapping[str, float],
    *,
    declared: bool,
    signals: Mapping[str, str] | None = None,
    **parts: Any,
) -> Model:
    """Surge, sway and yaw with heading and position, velocities through the water.

    Parameters
    ----------
    name : str
    scales : sequence of float
        Typical sizes of u, v, r, psi, x, y.
    measured : mapping
        Noise level of each output.
    declared : bool
        Whether the levels are stated.
    signals : mapping, optional
        Beside the relative velocities.
    **parts
        What else the model has.
    """
    units = {"u": "m/s", "v": "m/s", "r": "rad/s", "psi": "rad", "x": "m", "y": "m"}
    typical = dict(zip(units, scales, strict=True))
    return Model(
        name,
        states=tuple(State(n, unit, scale=typical[n]) for n, unit in units.items()),
        outputs=tuple(
            Output(n, units[n], noise_std=level if declared else None)
            for n, level in measured.items()
        ),
        axes={"X": "u", "Y": "v", "N": "r"},
        inertia={
            ("X", "u"): "m - X_udot", ("Y", "v"): "m - Y_vdot", ("N", "r"): "I_zz - N_rdot",
        },
        kinematics={
            "psi": "r", "x": "u*cos(psi) - v*sin(psi)", "y": "u*sin(psi) + v*cos(psi)",
        },
        signals={"u_r": "u", "v_r": "v", **(signals or {})},
        **parts,
    )  # fmt: skip


@dataclass(frozen=True)
class Nominal:
    """Model, candidates, and how hidden sizes read in their amplitudes.

    Attributes
    ----------
    model : callable
        ``(declared, lacking) -> Model``: noise levels declared or not, and without the
        effect named, if any.
    candidates : tuple of Effect
        What may be missing; a hidden effect has the same name here.
    part_of : dict
        Effects that the model usually has, which cases may leave out.
    """

    model: Callable[[bool, str | None], Model]
    candidates: tuple[Effect, ...]
    part_of: Mapping[str, Effect]

    def effects(self, lacking: str | None) -> tuple[Effect, ...]:
        """Candidates of a case whose nominal model lacks one of its usual parts."""
        if lacking is None:
            return self.candidates
        part = self.part_of[lacking]
        absent = part.with_values(dict.fromkeys(part.amplitude_names, 0.0))
        return (*self.candidates, absent)

    def effect(self, name: str) -> Effect:
        """One effect by name."""
        known = {e.name: e for e in (*self.candidates, *self.part_of.values())}
        return known[name]

    def values(self, name: str, sizes: Mapping[str, float]) -> dict[str, float]:
        """Amplitudes of an effect from the simulator's sizes, which stand in the same order.

        One amplitude for several keys (the lags of two propellers) has the size of the first.
        """
        return dict(zip(self.effect(name).amplitude_names, sizes.values(), strict=False))
