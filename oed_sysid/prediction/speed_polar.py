"""Speed polars of sailing vehicles, with the uncertainty of what was fitted.

The steady speed over the direction of the wind is what a sailor asks of a model.
It weighs parameters as sailing does: terms that no steady sailing needs may be
unknown without any harm to it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from oed_sysid.errors import ModelError, located
from oed_sysid.experiments.experiment import Limits
from oed_sysid.experiments.simulation import equilibrium
from oed_sysid.likelihood.fit import Fit
from oed_sysid.physics.model import Model
from oed_sysid.prediction.draws import asked, parameter_sets
from oed_sysid.runtime.display import Figure, Report, Section, Table, as_dict, as_text


@dataclass(frozen=True)
class SailingNames:
    """What the channels of a sailing model are called.

    Parameters
    ----------
    wind_speed, wind_from : str
        Inputs: true wind speed, m/s, and the direction that it comes from, rad.
    sheet : str
        Input that trims the sail, rad; the polar takes the best.
    helm : str
        Input that is solved for: it holds the course.
    speed, heading : str
        States: speed over the water ahead, m/s, and heading, rad.
    """

    wind_speed: str = "wind_speed"
    wind_from: str = "wind_from"
    sheet: str = "sheet"
    helm: str = "delta"
    speed: str = "u"
    heading: str = "psi"

    def check(self, model: Model) -> None:
        """Raise :class:`ModelError` where the model has no such channel."""
        for needed, have, kind in (
            ((self.wind_speed, self.wind_from, self.sheet, self.helm), model.input_names, "input"),
            ((self.speed, self.heading), model.state_names, "state"),
        ):
            advice = "Say what it is called with names=SailingNames(...)."
            located(ModelError, f"Model {model.name!r} has no {kind}", needed, have, advice)


@dataclass(frozen=True, eq=False)
class SpeedPolar:
    """Best steady speed over the angle to the true wind.

    Attributes
    ----------
    model : str
        Name of the model.
    wind_speed : float
        True wind, m/s.
    angles : ndarray (n_angles,)
        Angle between heading and true wind, rad, wind from starboard.
    speeds : ndarray (n_angles,)
        Speed at the fitted values, m/s; NaN where no steady state was found.
    sheets : ndarray (n_angles,)
        The best of the sheet angles that were tried, rad.
    states : mapping of str to ndarray (n_angles,)
        All steady states and the helm.
    draws : ndarray (n_draws, n_angles)
        Speeds of parameters drawn from the fit, m/s; NaN without a steady state.
    caveat : str
        Why the band is too narrow; empty where nothing says so.
    """

    model: str
    wind_speed: float
    angles: np.ndarray
    speeds: np.ndarray
    sheets: np.ndarray
    states: Mapping[str, np.ndarray] = field(repr=False)
    draws: np.ndarray = field(repr=False)
    caveat: str = ""

    def interval(self, level: float = 0.95) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper ends ``(n_angles,)`` of the credible band; NaN without draws."""
        tail = (1.0 - level) / 2.0
        seen = np.where(np.isfinite(self.draws), self.draws, math.nan)
        enough = np.isfinite(seen).sum(axis=0) > 1
        ends = np.full((2, len(self.angles)), math.nan)
        # Quantiles, not a normal band: a polar has an edge where sailing ends.
        ends[:, enough] = np.nanquantile(seen[:, enough], [tail, 1.0 - tail], axis=0)
        return ends[0], ends[1]

    @property
    def missing(self) -> int:
        """Pairs of draw and angle that have no steady state; the band is without them."""
        return int(np.count_nonzero(~np.isfinite(self.draws)))

    def document(self) -> Report:
        """Return the polar as a table and a picture."""
        rows = []
        columns = np.degrees(self.angles), self.speeds, *self.interval(), np.degrees(self.sheets)
        for angle, speed, low, high, sheet in np.column_stack(columns):
            known = math.isfinite(speed)
            band = f"{low:.3f} to {high:.3f}" if known and math.isfinite(low + high) else ""
            rows.append((f"{angle:.0f}", f"{speed:.3f}" if known else "none", band, f"{sheet:.0f}"))
        headers = ("wind angle [deg]", "speed [m/s]", "95 % of draws", "sheet [deg]")
        missing = f"{self.missing} of {self.draws.size} draws have no steady state."
        notes = (missing if self.missing else "", self.caveat)
        return Report(
            f"speed polar at {self.wind_speed:g} m/s true wind, by {self.model}",
            sections=(
                Section("Polar", tuple(filter(None, notes)), (Table(headers, rows),), indent=2),
                Section(
                    "Picture", only="page",
                    figures=(Figure("plot_polar", self, "Speed over the angle to the true wind; "
                                    "the band holds 95 % of the draws.", size=None),),
                ),
            ),
        )  # fmt: skip

    report = as_text

    to_dict = as_dict(
        "model", "wind_speed", "angles", "speeds", "sheets", "missing", "caveat",
        low=lambda self: self.interval()[0], high=lambda self: self.interval()[1],
    )  # fmt: skip


def speed_polar(
    fit_or_model: Fit | Model,
    *,
    wind_speed: float,
    angles: Sequence[float] | np.ndarray,
    sheets: Sequence[float] | np.ndarray,
    names: SailingNames | None = None,
    guess: Mapping[str, float] | None = None,
    limits: Limits | None = None,
    n_draws: int = 100,
    rng: np.random.Generator | None = None,
) -> SpeedPolar:
    """Static velocity prediction: steady sailing at every wind angle, sail trimmed best.

    For draws the sheet stays at the best of the fitted values: near an optimum
    another trim changes the speed in second order only.

    Parameters
    ----------
    fit_or_model : Fit or Model
        A fit gives a band, a model only its values. A fit by Gibbs sampling
        brings its own draws, others are drawn from their covariance.
    wind_speed : float
        True wind, m/s.
    angles : sequence of float (n_angles,)
        Between heading and true wind, rad; positive for wind from starboard.
    sheets : sequence of float
        Sheet angles to try, rad.
    names : SailingNames, optional
        What the channels are called.
    guess : mapping of str to float
        Where the search for the first angle begins; the others begin at their
        neighbour.
    limits : Limits, optional
        Ranges of the helm and of states.
    n_draws : int
        Parameter sets for the band.
    rng : numpy.random.Generator, optional
        Source of the draws; by default one with a fixed seed.

    Returns
    -------
    SpeedPolar

    Raises
    ------
    ModelError
        If the model lacks a channel, or no angle or sheet is given.

    References
    ----------
    Larsson & Eliasson (2000), Principles of yacht design, 2nd ed., ch. 16, for
    velocity prediction by equilibrium.

    Examples
    --------
    Of a yacht's fit, with a band from draws of its parameters::

        polar = speed_polar(fit, wind_speed=6.0, angles=np.radians([45, 90, 135]),
                            sheets=np.radians([10, 30, 60]), rng=np.random.default_rng(0))
    """
    fit, model = asked(fit_or_model)
    names = names or SailingNames()
    names.check(model)
    angles, sheets = np.asarray(angles, dtype=float), np.asarray(sheets, dtype=float)
    if not angles.size or not sheets.size:
        raise ModelError("A polar needs at least one angle and one sheet angle.")

    keys = (*model.state_names, names.helm)

    def start(point: Mapping[str, float]) -> dict[str, float]:
        """States and helm of a steady point, from which another is looked for."""
        return {key: point[key] for key in keys}

    def steady(
        sailing: Model, angle: float, sheet: float, guess: Mapping[str, float]
    ) -> dict[str, float] | None:
        """States and inputs of steady sailing; None where there is none ahead."""
        point = equilibrium(
            sailing,
            inputs={names.sheet: float(sheet), names.wind_speed: wind_speed, names.wind_from: 0.0},
            # With the wind from north, wind from starboard means a heading to port of it.
            fixed={names.heading: -float(angle)},
            free=(names.helm,),
            guess={key: value for key, value in guess.items() if key != names.heading},
            limits=limits,
        )
        found = {**point.states, **point.inputs}
        return found if point.ok and found[names.speed] > 0 else None

    def trimmed(angle: float, known: Mapping[str, float] | None) -> dict[str, float] | None:
        """The fastest of the sheets at one angle; None where no sheet sails."""
        found: list[dict[str, float]] = []
        for sheet in sheets:
            # From the neighbouring sheet or angle, or as told, whichever leads somewhere.
            starts = [*map(start, filter(None, (*found[-1:], known))), begin]
            points = (steady(model, angle, sheet, one) for one in starts)
            if (point := next(filter(None, points), None)) is not None:
                found.append(point)
        return max(found, key=lambda point: point[names.speed], default=None)

    def speeds(values: Mapping[str, float]) -> Iterator[float]:
        """Speeds at other values, sheets as they are best."""
        other = model.with_values(dict(values))
        for angle, point in zip(angles, best, strict=True):
            found = point and steady(other, angle, point[names.sheet], start(point))
            yield found[names.speed] if found else math.nan

    begin = dict(guess or {names.speed: 0.3 * wind_speed})
    best: list[dict[str, float] | None] = []
    for angle in angles:
        best.append(trimmed(angle, best[-1] if best else None))
    sets = parameter_sets(fit, model, n_draws, rng)[1:]
    draws = np.full((len(sets), len(angles)), math.nan)
    for row, values in enumerate(sets):
        draws[row] = [*speeds(dict(zip(model.parameter_names, values.tolist(), strict=True)))]
    states = {key: _along(best, key) for key in (*keys, names.sheet)}
    return SpeedPolar(
        model.name, wind_speed, angles, states[names.speed], states[names.sheet], states, draws,
        "" if fit is None else fit.caveat,
    )  # fmt: skip


def _along(points: Sequence[Mapping[str, float] | None], key: str) -> np.ndarray:
    """One number of steady points, NaN where there is none, ``(n_points,)``."""
    return np.array([math.nan if point is None else point[key] for point in points])
