r"""The law of a helmsman or an autopilot that holds a course, given or read from a record.

.. math::
    \delta_k = \delta_0 + K_p (\psi_\mathrm{ref}(t_k) - \psi_k) - K_d r_k ,

within a limit and at a limited rate; :math:`\psi_\mathrm{ref}` changes in steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import ArrayLike

from oed_sysid.data.record import Record
from oed_sysid.display import align
from oed_sysid.errors import DataError
from oed_sysid.predictions.course_fit import fit_course_law

DEGREE = math.degrees(1.0)
MOST_CHANGES = 8


@dataclass(frozen=True, eq=False)
class CourseEvidence:
    """What a record says of a course law.

    Attributes
    ----------
    names : tuple of str
        ``gain``, ``damping``, ``level 0``, ... (rudder at heading zero; ``neutral`` where the
        courses were given), ``rate``, ``limit``.
    values : ndarray (n_values,)
        SI.
    covariance : ndarray (n_values, n_values)
        Zero for a rate or limit that was not reached.
    explained : float
        Share of the rudder's variance that the law explains.
    rms : float
        Rudder that it does not explain, rad.
    memory : float
        Correlation of that from sample to sample.
    """

    names: tuple[str, ...]
    values: np.ndarray
    covariance: np.ndarray = field(repr=False)
    explained: float
    rms: float
    memory: float

    @property
    def std_errors(self) -> dict[str, float]:
        """Standard errors by name."""
        errors = np.sqrt(np.clip(np.diag(self.covariance), 0.0, None))
        return dict(zip(self.names, map(float, errors), strict=True))


@dataclass(frozen=True)
class CourseControl:
    """Proportional and damping law of a helmsman or an autopilot.

    Parameters
    ----------
    input : str
        Rudder.
    gain : float
        Rudder per heading error, 1.
    damping : float
        Rudder per yaw rate, s.
    course : float
        Heading that is held, rad.
    neutral : float
        Rudder at which it is held, rad.
    limit : float
        Largest rudder, rad.
    rate : float
        Largest rudder rate, rad/s.
    heading, yaw_rate : str
        Outputs that it sees.
    changes : tuple of (float, float)
        Time from the record's beginning, s, and the course from then on, rad.
    noise_share : float
        Share of the sensors' noise that it sees: 1, or 0 where it has better sensors.
    evidence : CourseEvidence, optional
        Standard errors, if it was read from a record.

    Examples
    --------
    >>> law = CourseControl("delta", 1.5, 6.0, 0.0, changes=((20.0, 0.4),))
    >>> [round(law.order(None, {"psi": 0.1, "r": 0.01, "time": t})[0], 2) for t in (10.0, 30.0)]
    [-0.21, 0.39]
    """

    input: str
    gain: float
    damping: float
    course: float
    neutral: float = 0.0
    limit: float = math.inf
    rate: float = math.inf
    heading: str = "psi"
    yaw_rate: str = "r"
    changes: tuple[tuple[float, float], ...] = ()
    noise_share: float = 1.0
    evidence: CourseEvidence | None = field(default=None, repr=False, compare=False)

    def start(self) -> None:
        """It has no memory."""

    def course_at(self, time: float) -> float:
        """Course at a time from the record's beginning, rad."""
        course = self.course
        for begin, new in self.changes:
            if time < begin:
                break
            course = new
        return course

    def order(self, memory: None, seen: Mapping[str, float]) -> tuple[float, None]:
        """See :class:`~oed_sysid.predictions.closed_loop.Control`."""
        course = self.course_at(seen["time"]) if self.changes else self.course
        error = course - seen[self.heading]
        wanted = self.neutral + self.gain * error - self.damping * seen[self.yaw_rate]
        return float(np.clip(wanted, -self.limit, self.limit)), memory

    def drawn(self, rng: np.random.Generator) -> CourseControl:
        """Law with numbers drawn from their uncertainty; itself where it was given."""
        if self.evidence is None:
            return self
        values = rng.multivariate_normal(
            self.evidence.values, self.evidence.covariance, method="eigh", check_valid="ignore"
        )
        return self._with(values)

    def disturbance(self, n_times: int, rng: np.random.Generator) -> np.ndarray:
        """Rudder that the law does not explain, drawn ``(n_times,)``, rad."""
        if self.evidence is None:
            return np.zeros(n_times)
        noise = rng.standard_normal(n_times)
        memory = float(np.clip(self.evidence.memory, 0.0, 0.99))
        for k in range(1, n_times):
            noise[k] = memory * noise[k - 1] + math.sqrt(1 - memory**2) * noise[k]
        return self.evidence.rms * noise

    def _with(self, values: np.ndarray) -> CourseControl:
        """The law with other values of the evidence's names."""
        names = self.evidence.names if self.evidence else ()
        value = dict(zip(names, map(float, values), strict=True))
        new = replace(
            self,
            gain=value["gain"],
            damping=value["damping"],
            rate=abs(value["rate"]),
            limit=abs(value["limit"]),
        )
        if "neutral" in value:
            return replace(new, neutral=value["neutral"])
        levels = [value[name] for name in names if name.startswith("level")]
        courses = [level / value["gain"] for level in np.cumsum(levels)]
        times = [time for time, _ in self.changes]
        return replace(new, course=courses[0], changes=tuple(zip(times, courses[1:], strict=True)))

    def report(self) -> str:
        """Return the law with standard errors, and what it explains, as a table."""
        errors = self.evidence.std_errors if self.evidence else {}
        rows = [("", "value", "std error")]

        def add(name: str, value: float, error: float) -> None:
            if math.isfinite(value):
                rows.append((name, f"{value:.4g}", f"{error:.2g}" if error > 0 else ""))

        add("gain", self.gain, errors.get("gain", 0.0))
        add("damping [s]", self.damping, errors.get("damping", 0.0))
        courses = ((0.0, self.course), *self.changes)
        for number, ((time, course), error) in enumerate(
            zip(courses, self._course_errors(), strict=True)
        ):
            since = f" from {time:.4g} s" if number else ""
            add(f"course{since} [deg]", DEGREE * course, DEGREE * error)
        if self.neutral or "neutral" in errors:
            add("neutral [deg]", DEGREE * self.neutral, DEGREE * errors.get("neutral", 0.0))
        add("rate [deg/s]", DEGREE * self.rate, DEGREE * errors.get("rate", 0.0))
        add("limit [deg]", DEGREE * self.limit, DEGREE * errors.get("limit", 0.0))
        lines = [f"course law of {self.input}", *(f"  {line}" for line in align(rows))]
        if self.evidence:
            lines.append(
                f"  explains {100 * self.evidence.explained:.0f} % of the rudder's variance, rms "
                f"{DEGREE * self.evidence.rms:.2g} deg left"
            )
        return "\n".join(lines)

    def _course_errors(self) -> list[float]:
        """Standard errors of the courses, rad; zero where they were given."""
        if self.evidence is None or "neutral" in self.evidence.names:
            return [0.0] * (1 + len(self.changes))
        names, covariance = self.evidence.names, self.evidence.covariance
        errors = []
        total = np.zeros(len(names))
        for position, name in enumerate(names):
            if not name.startswith("level"):
                continue
            total[position] = 1.0
            slope = total / self.gain
            slope[0] = -float(self.evidence.values[total > 0].sum()) / self.gain**2
            errors.append(math.sqrt(max(slope @ covariance @ slope, 0.0)))
        return errors

    @classmethod
    def of(
        cls,
        record: Record,
        input: str,
        *,
        heading: str = "psi",
        yaw_rate: str = "r",
        courses: ArrayLike | str | None = None,
        most_changes: int = MOST_CHANGES,
    ) -> CourseControl:
        """Identify the law from a record; equations in :mod:`oed_sysid.predictions.course_fit`.

        Parameters
        ----------
        record : Record
            With a rudder that was steered by a course law throughout.
        input : str
            The rudder.
        heading, yaw_rate : str
            Outputs that the law sees.
        courses : array_like (n_times,) or str, optional
            The ordered course, rad, or the input or output that holds it; by default constant
            with changes that are found. The rudder amidships and the course then cannot be told
            apart: the course is that at which the rudder is zero.
        most_changes : int
            Most changes of a course that is found.

        Raises
        ------
        DataError
            If the rudder is constant, if heading and yaw rate explain less than half of what
            changes of course leave of it, or if the law would drive the ship off its course.

        Examples
        --------
        >>> from oed_sysid.channels import Channels, Input, Output
        >>> channels = Channels(
        ...     (Input("delta", "rad"),), (Output("psi", "rad"), Output("r", "rad/s")))
        >>> t = np.arange(0.0, 30.0, 0.5)
        >>> psi, r = 0.1 * np.sin(0.3 * t), 0.03 * np.cos(0.3 * t)
        >>> rudder = 0.02 + 1.5 * (0.05 - psi) - 4.0 * r
        >>> log = Record("held", t, rudder[:, None], np.column_stack([psi, r]), channels)
        >>> law = CourseControl.of(log, "delta")
        >>> print(round(law.gain, 2), round(law.damping, 2))
        1.5 4.0
        """
        series = None if courses is None else _series(record, courses)
        fit = fit_course_law(
            record,
            input,
            heading=heading,
            yaw_rate=yaw_rate,
            courses=series,
            most_changes=most_changes,
        )
        followed = fit.followed
        left = followed.residuals
        n_levels = len(followed.law) - 2
        levels = ["neutral"] if series is not None else []
        levels = levels or [f"level {i}" for i in range(n_levels)]
        evidence = CourseEvidence(
            ("gain", "damping", *levels, "rate", "limit"),
            np.array([*followed.law, followed.rate, followed.limit]),
            followed.covariance,
            fit.explained,
            float(np.sqrt(np.mean(left**2))),
            followed.memory,
        )
        times = record.times - record.times[0]
        # A change lies between two samples.
        changes = [(float((times[k] + times[k - 1]) / 2), 0.0) for k in fit.changes]
        course = 0.0
        if series is not None:
            course = float(series[0])
            changes = [
                (float((times[k] + times[k - 1]) / 2), float(series[k]))
                for k in np.flatnonzero(np.diff(series)) + 1
            ]
        law = cls(
            input,
            0.0,
            0.0,
            course,
            heading=heading,
            yaw_rate=yaw_rate,
            changes=tuple(changes),
            noise_share=float(fit.sees_noise),
            evidence=evidence,
        )
        return law._with(evidence.values)


def _series(record: Record, courses: ArrayLike | str) -> np.ndarray:
    """The ordered course, sample by sample."""
    if isinstance(courses, str):
        known = courses in record.channels.input_names
        return record.input(courses) if known else record.output(courses)
    series = np.array(courses, dtype=float)
    if series.shape != record.times.shape or not np.isfinite(series).all():
        raise DataError(
            f"The ordered courses have the shape {series.shape}, {np.isfinite(series).sum()} of "
            f"them numbers. Expected {record.times.shape} for record {record.name!r}, in rad."
        )
    return series
