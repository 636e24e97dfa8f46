r"""Do fits to disjoint measured zigzags differ by what their errors say?

python -m benchmarks.disjoint [--partitions 10] [--repeats 200] [--only Nomoto] [--write]

The ten KVLCC2 zigzags are cut into halves at random. Both are fitted, and with the difference of a
quantity and its two standard errors

.. math:: z = (q_A - q_B) / \sqrt{s_A^2 + s_B^2}

Errors are those stated by the fit; those between records, to first order (``fit.record_errors``);
and those of refits without each record (``jackknife``). Three numbers say whether they are honest:
the rms of *z*, one if the errors were known; the median of its size over that of Student's
distribution, as the rms of a variable with few degrees of freedom is that of its tails (with four,
1.41); and how often a 95 % interval of the difference holds zero, of Welch's degrees of freedom.

Ten records are few: halves at random share them, so that what is pooled over partitions are no
independent trials, and for a plain mean over runs the jackknife passes by its algebra. Two things
keep it from being a formality: the weak half against the strong one, which is no random
half, and simulated records whose truth is known and whose parameters vary from run to run.
``--write`` writes the tables into docs/extrapolation.md.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.special import stdtrit

from benchmarks.harness import between, command
from oed_sysid import Dataset, Fit, Model, MultipleShooting, Record, load_problem
from oed_sysid.errors import OedSysidError
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.prediction.structures import Structure, peak_input
from problems.kvlcc2.mavmm import MAVMM, wake
from problems.kvlcc2.structures import REGRESSION, ahead, circles

PAGE = Path(__file__).resolve().parent.parent / "docs" / "extrapolation.md"
BEGIN, END = "<!-- disjoint: begin -->", "<!-- disjoint: end -->"
Purpose = Callable[[Fit], Mapping[str, float]]
Subset = tuple[int, ...]
WHITE = MultipleShooting(disturbances="none")
# Differences by a parameter, as a share of its standard error.
NUDGE = 0.1
KINDS = ("stated by the fit", "between records", "refits without each")
# Noise of the simulated logs, and by how much their parameters vary from run to run.
HEADING_NOISE, RATE_NOISE, VARIATION = math.radians(0.1), math.radians(0.02), 0.1


def parameters(fit: Fit) -> Mapping[str, float]:
    """The estimates themselves."""
    return fit.values


@dataclass(frozen=True, eq=False)
class Answer:
    """Wanted quantities of one fit; standard errors are NaN where the fit tells none."""

    values: np.ndarray
    stated: np.ndarray
    between: np.ndarray


@dataclass(frozen=True, eq=False)
class Case:
    """A structure with what is wanted of it; fits of the same records are made once."""

    name: str
    structure: Structure
    dataset: Dataset
    purpose: Purpose = parameters
    fits: dict[Subset, Fit | None] = field(default_factory=dict)
    values: dict[Subset, np.ndarray | None] = field(default_factory=dict)

    def fit(self, chosen: Subset) -> Fit | None:
        """Fit some of the records; None where that fails."""
        if chosen not in self.fits:
            try:
                data = Dataset(tuple(self.dataset[i] for i in chosen))
                self.fits[chosen] = self.structure.fit(data)
            except OedSysidError:
                self.fits[chosen] = None
        return self.fits[chosen]

    def value(self, chosen: Subset) -> np.ndarray | None:
        """Quantities from some of the records; None where these cannot be had."""
        if chosen not in self.values:
            fit = self.fit(chosen)
            self.values[chosen] = None if fit is None else self._wanted(fit)
        return self.values[chosen]

    def _wanted(self, fit: Fit) -> np.ndarray | None:
        try:
            found = np.array(list(self.purpose(fit).values()))
        except OedSysidError:
            return None
        return found if np.isfinite(found).all() else None

    def answer(self, chosen: Subset) -> Answer | None:
        """Quantities with both errors that the fit itself tells."""
        fit, values = self.fit(chosen), self.value(chosen)
        if fit is None or values is None:
            return None
        slopes = np.eye(len(values)) if self.purpose is parameters else self._slopes(fit, values)
        errors = [_errors(slopes, fit.covariance)]
        between = None if fit.record_scatter is None else fit.record_scatter.covariance
        errors.append(_errors(slopes, between))
        return Answer(values, *errors)

    def _slopes(self, fit: Fit, values: np.ndarray) -> np.ndarray | None:
        """Derivatives of the quantities by the parameters, ``(n_quantities, n_parameters)``."""
        columns = []
        for name, value in fit.values.items():
            step = NUDGE * fit.std_errors[name]
            if not math.isfinite(step) or step == 0.0:
                return None
            ends = []
            for sign in (1.0, -1.0):
                moved = fit.model.with_values({name: value + sign * step})
                ends.append(self._wanted(replace(fit, model=moved)))
            if ends[0] is None or ends[1] is None:
                return None
            columns.append((ends[0] - ends[1]) / (2.0 * step))
        return np.column_stack(columns)

    def jackknife(self, chosen: Subset) -> tuple[np.ndarray | None, int]:
        """Standard errors by refits without each record, and their degrees of freedom."""
        rows = [self.value(tuple(i for i in chosen if i != left)) for left in chosen]
        table = np.array([row for row in rows if row is not None])
        n = len(table)
        if n < 2:
            return None, 0
        squares = ((table - table.mean(axis=0)) ** 2).sum(axis=0)
        return np.sqrt((n - 1) / n * squares), n - 1


def _errors(slopes: np.ndarray | None, covariance: np.ndarray | None) -> np.ndarray:
    """Standard errors of what depends on parameters of a covariance."""
    if slopes is None or covariance is None:
        return np.full(1 if slopes is None else len(slopes), np.nan)
    return np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slopes, covariance, slopes), 0.0))


@dataclass(frozen=True, eq=False)
class Scores:
    """Differences over errors of one kind, flat over partitions and quantities.

    ``freedom`` is of Welch & Satterthwaite; infinite for errors of residuals.
    """

    z: np.ndarray
    freedom: np.ndarray

    @property
    def rms(self) -> float:
        """Root mean square."""
        return float(np.sqrt(np.mean(self.z**2)))

    @property
    def median(self) -> float:
        """Median size over that of Student's distribution."""
        return float(np.median(np.abs(self.z) / stdtrit(self.freedom, 0.75)))

    @property
    def coverage(self) -> float:
        """Share of 95 % intervals that hold zero."""
        return float(np.mean(np.abs(self.z) < stdtrit(self.freedom, 0.975)))


def halves(n: int, partitions: int) -> list[tuple[Subset, Subset]]:
    """Random halves of ``n`` records."""
    found = []
    for seed in range(partitions):
        order = np.random.default_rng(seed).permutation(n)
        parts = order[: n // 2], order[n // 2 :]
        found.append((_sorted(parts[0]), _sorted(parts[1])))
    return found


def weak_and_strong(dataset: Dataset) -> tuple[Subset, Subset]:
    """The half with the smaller rudder angles, and the other."""
    order = np.argsort([peak_input("delta")(record) for record in dataset], kind="stable")
    return _sorted(order[: len(order) // 2]), _sorted(order[len(order) // 2 :])


def _sorted(chosen: np.ndarray) -> Subset:
    return tuple(sorted(int(i) for i in chosen))


def compare(case: Case, partitions: Sequence[tuple[Subset, Subset]]) -> tuple[dict, int]:
    """Scores by kind of error, and how many partitions could not be compared."""
    found: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {kind: [] for kind in KINDS}
    lost = 0
    for pair in partitions:
        answers = [case.answer(part) for part in pair]
        refits = [case.jackknife(part) for part in pair]
        if answers[0] is None or answers[1] is None:
            lost += 1
            continue
        difference = answers[0].values - answers[1].values
        freedom = [len(part) - 1 for part in pair]
        sizes = {
            KINDS[0]: ([one.stated for one in answers], [math.inf, math.inf]),
            KINDS[1]: ([one.between for one in answers], freedom),
            KINDS[2]: ([errors for errors, _ in refits], [count for _, count in refits]),
        }
        for kind, (errors, counts) in sizes.items():
            if all(one is not None and np.isfinite(one).all() for one in errors):
                found[kind].append(_score(difference, errors, counts))
    return {
        kind: Scores(*(np.concatenate(part) for part in zip(*parts, strict=True)))
        for kind, parts in found.items()
        if parts
    }, lost


def _score(
    difference: np.ndarray, errors: Sequence[np.ndarray], freedom: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Difference over errors, and degrees of freedom of the two together."""
    squares = [np.maximum(one, 1e-300) ** 2 for one in errors]
    total = squares[0] + squares[1]
    share = sum(one**2 / count for one, count in zip(squares, freedom, strict=True))
    with np.errstate(divide="ignore"):
        welch = np.where(share > 0, total**2 / share, np.inf)
    return difference / np.sqrt(total), welch


def cases() -> list[Case]:
    """Models of the tanker with estimators, and what is asked of each."""
    motion, heading = load_problem("kvlcc2", variant="mmg").data(), load_problem("kvlcc2")
    full = REGRESSION.fit(MAVMM.with_values(wake()), motion).model
    mmg = load_problem("kvlcc2", variant="mmg").model
    found = [
        Case("Nomoto, white: K, T", Structure("", heading.model, WHITE), heading.data()),
        Case(
            "Nomoto, default: K, T",
            Structure("", heading.model, MultipleShooting()),
            heading.data(),
        ),
    ]
    for name, model, estimator in (
        ("MAVMM, one step", full, REGRESSION),
        ("MAVMM, 10 s ahead", full, ahead(10.0)),
        ("MMG, white", mmg, WHITE),
        ("MMG, default", mmg, MultipleShooting()),
    ):
        one = Case(f"{name}: derivatives", Structure("", model, estimator), motion)
        found += [one, replace(one, name=f"{name}: circles", purpose=circles, values={})]
    return found


def table(chosen: Sequence[Case], partitions: int) -> list[str]:
    """One line per case: random halves by each kind of error, then weak against strong."""
    lines = [
        "| quantities | " + " | ".join(KINDS) + " | weak against strong half | lost |",
        "|" + "---|" * (len(KINDS) + 3),
    ]
    for case in chosen:
        random, lost = compare(case, halves(len(case.dataset), partitions))
        extreme, _ = compare(case, [weak_and_strong(case.dataset)])
        cells = [_cell(random.get(kind)) for kind in KINDS]
        ends = " / ".join(
            "-" if kind not in extreme else f"{extreme[kind].rms:.2f}" for kind in KINDS
        )
        lines.append(f"| {case.name} | " + " | ".join(cells) + f" | {ends} | {lost} |")
        print(lines[-1], flush=True)
    return lines


def _cell(scores: Scores | None) -> str:
    if scores is None:
        return "-"
    return f"{scores.rms:.2f}, {scores.median:.2f}, {100 * scores.coverage:.0f} %"


def whole_table() -> list[str]:
    """All records fitted together: how far the scatter between them exceeds stated errors."""
    heading, motion = load_problem("kvlcc2"), load_problem("kvlcc2", variant="mmg")
    esso = load_problem("esso_osaka")
    zigzags = Dataset(tuple(r for r in esso.data() if r.name.startswith("zigzag")))
    lines = [
        "| all records together | records | parameters | told | most | median of all |",
        "|---|---|---|---|---|---|",
    ]
    for ship, model, data in (
        ("KVLCC2, Nomoto", heading.model, heading.data()),
        ("KVLCC2, MMG", motion.model, motion.data()),
        ("Esso Osaka zigzags, MMG with wind", esso.models["wind"], zigzags),
    ):
        for name, estimator in (("white", WHITE), ("default", MultipleShooting())):
            fit = estimator.fit(model, data)
            assert fit.record_scatter is not None
            factor, clear = fit.record_scatter.exceeds(
                np.diag(fit.covariance), np.diag(fit.information.covariance)
            )
            most = f"{fit.names[int(np.argmax(factor))]} {factor.max():.1f} times"
            lines.append(
                f"| {ship}, {name} | {len(data)} | {len(factor)} | {int(clear.sum())} | "
                f"{most} | {np.median(factor):.1f} times |"
            )
            print(lines[-1], flush=True)
    return lines


# -- a truth that is known ---------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Trial:
    """Estimates of simulated data sets about their truth.

    Attributes
    ----------
    errors : ndarray (n_repeats, n_parameters)
        Estimates less what is true on average over runs.
    stated, between : ndarray (n_repeats, n_parameters)
        Standard errors, of the fit and between records.
    told : float
        Share of fits that say that their records differ.
    n_records : int
    """

    errors: np.ndarray
    stated: np.ndarray
    between: np.ndarray
    told: float
    n_records: int

    def row(self, name: str) -> str:
        """Ratios and coverages as a line of a table."""
        cells = []
        for size, freedom in ((self.stated, math.inf), (self.between, self.n_records - 1)):
            ratio = math.sqrt(np.mean(self.errors**2 / np.mean(size**2, axis=0)))
            held = np.mean(np.abs(self.errors) < stdtrit(freedom, 0.975) * size)
            cells.append(f"{ratio:.2f}, {100 * held:.0f} %")
        return f"| {name} | {self.n_records} | {' | '.join(cells)} | {100 * self.told:.0f} % |"


def simulated(
    model: Model, logs: Sequence[Record], variation: float, repeats: int, *, seed: int = 0
) -> Trial:
    """Fit logs whose measured rudder moves a ship that is a little another one in each run.

    Parameters
    ----------
    model : Model
        The truth on average, with two outputs, heading and rate.
    logs : sequence of Record
        Their times and inputs are taken.
    variation : float
        Relative standard deviation of each free parameter from run to run.
    repeats : int
        Data sets.
    """
    names = model.free_names
    levels = np.array([HEADING_NOISE, RATE_NOISE])
    outputs = tuple(
        replace(output, noise_std=float(level))
        for output, level in zip(model.outputs, levels, strict=True)
    )
    model = replace(model, outputs=outputs)
    true = np.array([model.values[name] for name in names])
    errors, stated, between, told = [], [], [], 0
    for repeat in range(repeats):
        rng = np.random.default_rng((seed, repeat))
        runs = []
        for log in logs:
            own = true * (1.0 + variation * rng.standard_normal(len(true)))
            at = model.with_values(dict(zip(names, map(float, own), strict=True)))
            run = simulate_inputs(at, log.times, inputs=log.inputs, initial={})
            noisy = run.outputs + levels * rng.standard_normal(run.outputs.shape)
            runs.append(Record(log.name, log.times, log.inputs, noisy, model.channels))
        fit = WHITE.fit(model, Dataset(tuple(runs)))
        errors.append(fit.estimates - true)
        stated.append([fit.std_errors[name] for name in names])
        between.append([fit.record_errors[name] for name in names])
        told += any(concern.kind == "records_differ" for concern in fit.concerns)
    return Trial(np.array(errors), np.array(stated), np.array(between), told / repeats, len(logs))


def truth_table(repeats: int) -> list[str]:
    """Nomoto's equation with the measured rudder of all zigzags, or of every second one."""
    problem = load_problem("kvlcc2")
    logs = list(problem.data())
    model = problem.model.with_values({"K": -0.2, "T": 12.0})
    lines = [
        "| simulated truth | records | stated by the fit | between records | told |",
        "|---|---|---|---|---|",
    ]
    for name, variation in (
        ("K and T the same in all runs", 0.0),
        (f"K and T vary by {100 * VARIATION:.0f} % from run to run", VARIATION),
    ):
        for chosen in (logs, logs[::2]):
            lines.append(simulated(model, chosen, variation, repeats).row(name))
            print(lines[-1], flush=True)
    return lines


def main(*, partitions: int = 10, repeats: int = 200, only: str = "", write: bool = False) -> None:
    """Print all tables; write them into the page if asked to.

    Parameters
    ----------
    partitions : int
        random halves
    repeats : int
        simulated data sets
    only : str
        cases whose name contains this
    write : bool
        write docs/extrapolation.md
    """
    lines = table([case for case in cases() if only in case.name], partitions)
    if not only:
        lines += ["", *whole_table()]
    if repeats:
        lines += ["", *truth_table(repeats)]
    if write:
        page = PAGE.read_text(encoding="utf-8")
        PAGE.write_text(between(page, BEGIN, END, lines), encoding="utf-8")


if __name__ == "__main__":
    command(main)
