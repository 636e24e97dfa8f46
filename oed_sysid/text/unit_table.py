"""Every unit that is understood, with its factor to SI."""

from __future__ import annotations

import math

# Symbols that the package calculates with.
SI = ("kg", "m", "s", "A", "K", "rad", "N", "Pa", "J", "W", "V", "Ohm", "Hz")
# unit: (factor to SI, SI unit). Factors are exact by definition of the unit.
_DEGREE = math.pi / 180.0
_KNOT = 1852.0 / 3600.0
UNITS: dict[str, tuple[float, str]] = {
    **{symbol: (1.0, symbol) for symbol in SI},
    **{"1": (1.0, "1"), "-": (1.0, "1"), "%": (0.01, "1"), "percent": (0.01, "1")},
    **{"um": (1e-6, "m"), "mm": (1e-3, "m"), "cm": (1e-2, "m"), "dm": (0.1, "m")},
    **{"km": (1e3, "m"), "nmi": (1852.0, "m"), "ft": (0.3048, "m")},
    **{
        "ns": (1e-9, "s"),
        "us": (1e-6, "s"),
        "ms": (1e-3, "s"),
        "min": (60.0, "s"),
        "h": (3600.0, "s"),
    },
    **{"g": (1e-3, "kg"), "t": (1e3, "kg")},
    **{"deg": (_DEGREE, "rad"), "°": (_DEGREE, "rad"), "mrad": (1e-3, "rad"), "rev": (1.0, "1")},
    **{"kn": (_KNOT, "m/s"), "kt": (_KNOT, "m/s"), "mps": (1.0, "m/s")},
    **{"mmps": (1e-3, "m/s"), "cmps": (1e-2, "m/s"), "kmh": (1 / 3.6, "m/s")},
    **{"mps2": (1.0, "m/s^2"), "radps": (1.0, "rad/s"), "degps": (_DEGREE, "rad/s")},
    **{"mradps": (1e-3, "rad/s"), "radps2": (1.0, "rad/s^2"), "degps2": (_DEGREE, "rad/s^2")},
    **{"rps": (1.0, "1/s"), "rpm": (1 / 60.0, "1/s"), "kHz": (1e3, "Hz"), "mHz": (1e-3, "Hz")},
    **{"mN": (1e-3, "N"), "kN": (1e3, "N"), "MN": (1e6, "N"), "kgf": (9.80665, "N")},
    **{"Nm": (1.0, "N m"), "mNm": (1e-3, "N m"), "kNm": (1e3, "N m"), "MNm": (1e6, "N m")},
    **{"hPa": (1e2, "Pa"), "kPa": (1e3, "Pa"), "MPa": (1e6, "Pa")},
    **{"mbar": (1e2, "Pa"), "dbar": (1e4, "Pa"), "bar": (1e5, "Pa")},
    **{"cc": (1e-6, "m^3"), "ml": (1e-6, "m^3"), "l": (1e-3, "m^3")},
    **{"kgm3": (1.0, "kg/m^3"), "kgm2": (1.0, "kg m^2")},
    **{"uV": (1e-6, "V"), "mV": (1e-3, "V"), "kV": (1e3, "V"), "mA": (1e-3, "A")},
    **{"mW": (1e-3, "W"), "kW": (1e3, "W"), "kJ": (1e3, "J"), "degC": (1.0, "K")},
}
# Zero of the scale in SI; such a unit cannot be part of a product.
OFFSETS = {"degC": 273.15}
SPELLINGS = {"°C": "degC", "µ": "u", "μ": "u", "Ω": "Ohm", "²": "^2", "³": "^3", "⁻": "-"}
