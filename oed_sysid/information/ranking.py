"""Which derivatives matter: the literature's index beside the information.

Smaller models: which derivatives can go, and what prediction loses by it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.errors import DesignError, listed, located, respelled
from oed_sysid.experiments.simulation import simulate_inputs
from oed_sysid.information.bound import COLOURED, RunInformation
from oed_sysid.information.identifiability import SAYS, Subset, identifiable_subset
from oed_sysid.information.noise import Levels
from oed_sysid.information.response import CommandedRun, Run, commanded_runs
from oed_sysid.likelihood.fit import Fit
from oed_sysid.likelihood.information import Information
from oed_sysid.likelihood.noise_model import NoiseModel
from oed_sysid.physics.model import Model
from oed_sysid.runtime.display import Figure, Report, Section, Table, as_dict, as_text, plain, share
from oed_sysid.runtime.threads import single_threaded


@dataclass(frozen=True)
class Sensitivity:
    """One parameter in both views.

    Attributes
    ----------
    name, unit : str
    value : float
    output_change : float
        Relative change of the outputs for a relative change of the parameter,
        summed over the signals (Perez & Blanke); per change, not per unit change.
    peak_change : float
        Relative change of the peaks per relative change of the parameter
        (Hwang; Rhee & Kim), averaged over the signals.
    error_alone : float
        Relative standard error if the other parameters were known (start states are not, unless
        ``start`` says so).
    error : float
        Relative standard error with all unknowns estimated together.

    Examples
    --------
    One of ``rank_parameters(...).rows``; see :func:`rank_parameters`.
    """

    name: str
    unit: str
    value: float
    output_change: float
    peak_change: float
    error_alone: float
    error: float

    @property
    def inflation(self) -> float:
        """How much the other unknowns enlarge the error."""
        return self.error / self.error_alone if self.error_alone > 0 else float("inf")


@dataclass(frozen=True)
class SensitivityRanking:
    """Parameters of a model by what a manoeuvre tells about them.

    Attributes
    ----------
    rows : tuple of Sensitivity
        Best determined first.
    change : float
        Relative change of the parameters behind ``output_change``.
    signals, runs : tuple of str
        What was compared, in which manoeuvres.
    information : Information
        Behind the errors.
    together : Subset
        Which of them the runs alone determine together, and what each costs.

    Examples
    --------
    What :func:`rank_parameters` returns; see there.
    """

    rows: tuple[Sensitivity, ...]
    change: float
    signals: tuple[str, ...]
    runs: tuple[str, ...]
    information: Information
    together: Subset

    @property
    def by_information(self) -> tuple[str, ...]:
        """Names, best determined first."""
        return tuple(row.name for row in self.rows)

    @property
    def by_output_change(self) -> tuple[str, ...]:
        """Names, largest change of the outputs first."""
        return tuple(r.name for r in sorted(self.rows, key=lambda r: -r.output_change))

    def row(self, name: str) -> Sensitivity:
        """Return one parameter."""
        lacking = "The ranking has no parameter"
        return self.rows[located(DesignError, lacking, [name], self.by_information)[0]]

    def document(self, *, title: str = "") -> Report:
        """Return the ranking, and which parameters can be estimated together."""
        change_rank = {name: i + 1 for i, name in enumerate(self.by_output_change)}
        headers = (
            "", "parameter", "rel. error", "alone", "inflation", "output change", "place",
            "peak index",
        )  # fmt: skip
        rows = [
            (
                f"{rank}",
                row.name,
                share(row.error),
                share(row.error_alone),
                f"{row.inflation:.3g}",
                f"{row.output_change:.3g}",
                f"{change_rank[row.name]}",
                f"{row.peak_change:.3g}",
            )
            for rank, row in enumerate(self.rows, start=1)
        ]
        height = 1.4 + 0.3 * len(rows)
        drawing = Figure("plot_sensitivity", self, SAYS["ranking_drawn"], size=(7.6, height))
        said = [f"Not determined: {text}." for text in self.information.null_directions()]
        best, worst = self.rows[0], self.rows[-1]
        runs, signals = ", ".join(self.runs), ", ".join(self.signals)
        return Report(
            title=title or "What these experiments tell",
            subtitle=f"Parameters in {runs}",
            headline=SAYS["ranking"].format(self, n=len(rows), runs=runs, signals=signals),
            answer=self.together.words(f" from {runs}"),
            numbers=(
                (f"std. error, best: {best.name}", share(best.error)),
                (f"std. error, worst: {worst.name}", share(worst.error)),
            ),
            sections=(
                Section("Accuracy to expect", (), (Table(headers, rows, words=(1,)),), (drawing,)),
                Section("What this says", said),
                *self.together.document().sections,
            ),
        )

    report = as_text

    to_dict = as_dict(
        "runs", "signals", "change", "by_information", "by_output_change",
        parameters=lambda self: [plain(row) | {"inflation": row.inflation} for row in self.rows],
        null_directions=lambda self: self.information.null_directions(),
    )  # fmt: skip


@respelled(DesignError, COLOURED)
@single_threaded
def rank_parameters(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    noise: Levels | NoiseModel | Fit = None,
    priors: str | Mapping[str, float] | Information | None = None,
    start: str | Mapping[str, float] = "unknown",
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
    signals: Sequence[str] | None = None,
    change: float = 0.2,
) -> SensitivityRanking:
    r"""Rank free parameters by the literature's index and by information.

    The index is the relative change of the outputs when one coefficient is
    multiplied by :math:`1 + \varepsilon`, inputs unchanged,

    .. math:: S_j = \sum_y \sum_k |y_j(k) - y(k)| \,/\, \sum_k |y(k)| .

    It says what moves the outputs, not what can be told apart: two
    coefficients with the same effect both look important. The information
    says with which error each can be estimated, alone and with the others.

    Parameters
    ----------
    model, runs, noise, priors, start, initial_states
        See :func:`~oed_sysid.information.bound.information_of`.
    signals : sequence of str, optional
        Outputs or states in the index; all outputs by default. Leave out
        positions that start far from zero: they hide every change.
    change : float
        Relative change of each coefficient.

    Returns
    -------
    SensitivityRanking
        Best determined first.

    Raises
    ------
    DesignError
        If the change is zero or not finite.

    References
    ----------
    T. Perez, M. Blanke, Mathematical ship modelling for control applications,
    Technical University of Denmark (2002): index as used for manoeuvring
    coefficients; the working form here is the one above.
    W. Y. Hwang, Application of system identification to ship maneuvering, PhD
    thesis, MIT (1980), and K. Rhee, K. Kim (1999): relative change of a
    response per relative change of a coefficient.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> found = rank_parameters(ship.model, next(iter(ship.experiments.values())))
    >>> [row.name for row in found.rows]
    ['K', 'T']
    """
    if not change or change <= -1:
        raise DesignError(f"change is {change}. Give a relative change such as 0.2.")
    histories = commanded_runs(model, runs, initial_states=initial_states)
    expected = RunInformation(model, noise, start)
    factors = [expected.factor(given) for given in histories]
    information = expected.joint(factors, priors)
    wanted = tuple(signals) if signals is not None else model.output_names
    base = _signals(model, histories, wanted)
    with np.errstate(divide="ignore"):
        # The norm of a column of R is the root of the information on that parameter alone.
        alone = 1.0 / np.linalg.norm(information.factor / information.scales, axis=0)

    def seen(name: str, *errors: float) -> Sensitivity:
        """One parameter in both views."""
        parameter = model.parameter(name)
        value, size = parameter.value, parameter.reference
        changed = model.with_values({name: value + change * (value or size)})
        total, peaks = _indices(base, _signals(changed, histories, wanted))
        one, together = (float(error / size) for error in errors)
        return Sensitivity(name, parameter.unit, value, total, peaks / abs(change), one, together)

    rows = sorted(
        map(seen, information.names, alone, information.std_errors), key=lambda row: row.error
    )
    # States and inputs in all runs, one behind the other.
    states = np.vstack(_signals(model, histories, model.state_names))
    moved = np.hstack([states, np.vstack([given.inputs for given in histories])])
    subset = identifiable_subset(
        expected.joint(factors, None),
        model.values,
        assumed={p.name: p.prior_spread for p in model.free_parameters if p.prior_spread},
        motions=dict(zip((*model.state_names, *model.input_names), moved.T, strict=True)),
    )
    return SensitivityRanking(
        tuple(rows), change, wanted, tuple(given.name for given in histories), information, subset
    )


def _signals(
    model: Model, histories: Sequence[CommandedRun], names: Sequence[str]
) -> list[np.ndarray]:
    """Chosen outputs or states of each run, shape ``(n_times, n_names)``."""
    found = []
    for given in histories:
        run = simulate_inputs(
            model, given.times, inputs=given.inputs, initial=given.initial, throw=False
        )
        columns = (*run.states.T, *run.outputs.T)
        known = dict(zip((*run.state_names, *run.output_names), columns, strict=True))
        located(DesignError, f"Model {model.name!r} has no output or state", names, known)
        found.append(np.column_stack([known[name] for name in names]))
    return found


def _indices(base: list[np.ndarray], new: list[np.ndarray]) -> tuple[float, float]:
    """Output change summed over signals, and mean relative change of the peaks."""
    whole, changed = np.vstack(base), np.vstack(new)
    size = np.abs(whole).sum(axis=0)
    peaks = np.mean(
        [
            # Peaks of either sign: a zigzag overshoots to both sides.
            np.abs(np.abs(b).max(axis=0) / np.maximum(np.abs(a).max(axis=0), 1e-300) - 1)
            for a, b in zip(base, new, strict=True)
        ]
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        shares = np.where(size > 0, np.abs(changed - whole).sum(axis=0) / size, 0.0)
    total = float(np.sum(shares))
    # A diverging variant is a very large change, not a missing number.
    return (total, float(peaks)) if np.isfinite(total) else (float("inf"), float("inf"))


@dataclass(frozen=True)
class Drop:
    """One parameter that was set to zero, after those before it.

    Attributes
    ----------
    name : str
    cost : float
        Increase of the whitened sum of squares by all drops so far, the
        remaining parameters refitted (linearised): below 2 per dropped
        parameter the data do not notice (Akaike).
    predicted_rms : float
        Root mean square change of the outputs that this means, in noise units.

    Examples
    --------
    >>> Drop("N_vvv", cost=0.8, predicted_rms=0.02).cost
    0.8
    """

    name: str
    cost: float
    predicted_rms: float

    to_dict = as_dict()


@dataclass(frozen=True, eq=False)
class Reduction:
    """A model without the derivatives that a manoeuvre does not notice.

    Attributes
    ----------
    model : Model
        Dropped parameters at zero and fixed; the others unchanged.
    full : Model
        The model before.
    drops : tuple of Drop
        In order; those beyond ``n_dropped`` show what more would cost.
    n_dropped : int
        How many were dropped.
    n_samples : int
        Measured samples behind the costs.

    Examples
    --------
    What :func:`reduce_model` returns; see there.
    """

    model: Model
    full: Model
    drops: tuple[Drop, ...]
    n_dropped: int
    n_samples: int

    @property
    def dropped(self) -> tuple[str, ...]:
        """Names of the dropped parameters."""
        return tuple(drop.name for drop in self.drops[: self.n_dropped])

    def document(self) -> Report:
        """Return the order of dropping and its cost as a table."""
        title = (
            f"{self.full.name}: {self.n_dropped} of {len(self.drops)} parameters dropped "
            f"({listed(self.dropped)})"
        )
        rows = [
            (str(index), drop.name, f"{drop.cost:.3g}", f"{drop.predicted_rms:.3g}",
             "x" if index > self.n_dropped else "")
            for index, drop in enumerate(self.drops, start=1)
        ]  # fmt: skip
        table = Table(("", "dropped", "chi-square", "rms/noise", "kept"), rows, words=(1,))
        return Report(title, sections=(Section("Order of dropping", tables=(table,)),))

    report = as_text

    to_dict = as_dict("dropped", "n_samples", model="full.name", steps="drops")


@respelled(DesignError, COLOURED)
def reduce_model(
    model: Model,
    runs: Run | Dataset | Iterable[Run],
    *,
    noise: Levels | NoiseModel | Fit = None,
    initial_states: Sequence[Mapping[str, float] | np.ndarray] | None = None,
    keep: Sequence[str] = (),
) -> Reduction:
    r"""Drop free parameters one by one, the least missed first.

    With the others refitted, setting the parameters of a set :math:`D` to zero
    raises the sum of squares by :math:`p_D' C_{DD}^{-1} p_D`, where :math:`C`
    is the bound: neither simulation nor refit is needed for the order. They go as long as the sum
    of squares grows by less than 2 per dropped parameter (Akaike).

    Parameters
    ----------
    model, runs, noise, initial_states
        See :func:`~oed_sysid.information.bound.information_of`; start states
        are refitted.
    keep : sequence of str
        Parameters that stay in any case, as do those whose bounds leave zero out.

    Returns
    -------
    Reduction
        The smaller model, and what each drop costs.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> ship = load_problem("nomoto_sparse_heading")
    >>> reduce_model(ship.model, next(iter(ship.experiments.values()))).n_dropped
    0
    """
    histories = commanded_runs(model, runs, initial_states=initial_states)
    expected = RunInformation(model, noise)
    information = expected.joint([expected.factor(given) for given in histories], None)
    n_samples = sum(int(given.present.sum()) for given in histories)
    names = information.names
    values = np.array([model.values[name] for name in names]) / information.scales
    parameters = map(model.parameter, names)
    may = [one.name not in keep and one.lower <= 0.0 <= one.upper for one in parameters]
    order = _dropping(information.factor, values, may)
    drops = tuple(Drop(names[i], cost, float(np.sqrt(cost / n_samples))) for i, cost in order)
    # The first that is missed ends it: costs grow faster than the number of parameters.
    missed = (i for i, drop in enumerate(drops) if drop.cost > 2.0 * (i + 1))
    n_dropped = next(missed, len(drops))
    gone = [drop.name for drop in drops[:n_dropped]]
    small = model.with_values(dict.fromkeys(gone, 0.0)).fix(*gone)
    named = replace(small, name=f"{model.name}, reduced")
    return Reduction(named, model, drops, n_dropped, n_samples)


def _dropping(
    factor: np.ndarray, values: np.ndarray, may_go: Sequence[bool]
) -> list[tuple[int, float]]:
    """Parameters in the order in which they are missed least, and the cost of all up to each."""
    gone: list[int] = []
    found = []
    rest = [i for i, one in enumerate(may_go) if one]
    while rest:
        costs = [_cost(factor, values, [*gone, candidate]) for candidate in rest]
        best = int(np.argmin(costs))
        gone.append(rest.pop(best))
        found.append((gone[-1], costs[best]))
    return found


def _cost(factor: np.ndarray, values: np.ndarray, gone: list[int]) -> float:
    """Increase of the sum of squares when ``gone`` are zero and the others refitted."""
    rest = [i for i in range(len(values)) if i not in gone]
    lost = factor[:, gone] @ values[gone]
    refit = np.linalg.lstsq(factor[:, rest], lost, rcond=None)[0]
    return float(np.sum((lost - factor[:, rest] @ refit) ** 2))
