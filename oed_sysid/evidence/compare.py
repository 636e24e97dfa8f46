"""Compare models with records: where, when and how much they differ, and whether it is noise.

One look without adding anything: where a model fails and what might be missing.

Error of predictions a short time ahead, started again and again along a record.

Over a whole record a small error of a parameter grows into a large one of the
trajectory. A forecast of a few seconds from a state that is known shows what
the equations get wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.compiled.kernels import Kernel, kernel
from oed_sysid.data.dataset import Dataset, Record, check_disjoint
from oed_sysid.errors import DataError
from oed_sysid.evidence.locate import Located, likeliest, locate
from oed_sysid.evidence.misfit import OutputMisfit, output_misfit
from oed_sysid.evidence.rank import Ranking, rank
from oed_sysid.evidence.result import LogCheck
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.evidence.study import Study, total_error
from oed_sysid.evidence.usual import settled
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.fit import MOST_DRAWN, Fit
from oed_sysid.likelihood.gauss_newton import FIRST_STEPS, Convergence, Descent
from oed_sysid.likelihood.noise_levels import believed_levels, credible_levels, root_mean_square
from oed_sysid.likelihood.noise_model import Disturbances
from oed_sysid.likelihood.prediction import WAYS, Initial, Prediction, predict
from oed_sysid.likelihood.projection import inverse_of
from oed_sysid.likelihood.shooting import Shooting
from oed_sysid.likelihood.start_guess import VAGUE, check_channels
from oed_sysid.likelihood.windows import HELD, Part, Windows
from oed_sysid.physics import Effect
from oed_sysid.physics.model import Model
from oed_sysid.runtime import display
from oed_sysid.runtime.threads import single_threaded
from oed_sysid.text.units import shown_unit


@dataclass(frozen=True, eq=False)
class ModelMisfit:
    """How one model does on the records.

    Attributes
    ----------
    label : str
        What the model is called in the comparison.
    model : Model
        At the compared values.
    prediction : Prediction
        Outputs, bands and initial states, per record.
    outputs : tuple of OutputMisfit
        One per output.
    forecasts : Forecasts
        Predictions a short time ahead.
    """

    label: str
    model: Model
    prediction: Prediction
    outputs: tuple[OutputMisfit, ...]
    forecasts: Forecasts

    to_dict = display.as_dict(
        "label", "relative", "is_noise", "verdict", "outputs",
        initial_states="prediction.initial_states", forecast="forecasts",
    )  # fmt: skip

    def section(self) -> display.Section:
        """Return the misfit by output, and of forecasts, as a part of a document."""
        ahead, words = self.forecasts, []
        if ahead.n_forecasts:
            facts = {"size": display.digits(ahead.overall, 3), "count": ahead.n_forecasts}
            words.append(say("compared", "ahead", horizon=ahead.horizon, **facts))
        if ahead.failed:
            words.append(f"{ahead.failed} of the forecasts diverged.")
        title = f"{self.label}: {self.relative:.3g} × noise over all outputs"
        return display.Section(title, words, (_table(self),), heading=True, indent=2)

    @property
    def relative(self) -> float:
        """Root mean square residual over all outputs, in units of the noise."""
        measured = [part for part in self.outputs if part.n_samples]
        total = sum(part.n_samples * part.relative**2 for part in measured)
        return float(np.sqrt(total / max(sum(part.n_samples for part in measured), 1)))

    @property
    def is_noise(self) -> bool:
        """Whether no output shows more than noise."""
        return all(part.is_noise for part in self.outputs)

    @property
    def verdict(self) -> str:
        """The misfit in one sentence, the worst output first."""
        if self.is_noise:
            return f"{self.label}: the misfit is noise ({self.relative:.3g} x noise overall)."
        wrong = [part for part in self.outputs if not part.is_noise]
        wrong.sort(key=lambda part: -part.relative)
        return f"{self.label}: " + "; ".join(part.verdict for part in wrong) + "."

    def output(self, name: str) -> OutputMisfit:
        """Misfit of one output."""
        return next(part for part in self.outputs if part.output.name == name)


@dataclass(frozen=True, eq=False)
class Comparison:
    """One or several models against the same records.

    Attributes
    ----------
    dataset : Dataset
    models : tuple of ModelMisfit
        In the order given.
    sigma : ndarray (n_outputs,)
        Noise levels that all models are measured with.
    notes : tuple of str
        What to keep in mind.

    Examples
    --------
    What :func:`~oed_sysid.evidence.compare` returns; see there.
    """

    dataset: Dataset
    models: tuple[ModelMisfit, ...]
    sigma: np.ndarray
    notes: tuple[str, ...]

    _repr_html_ = display.as_html

    def __repr__(self) -> str:
        errors = ", ".join(f"{part.label} {part.relative:.3g} x noise" for part in self.models)
        return f"<Comparison on {len(self.dataset)} records: {errors}>"

    def __getitem__(self, key: str | int) -> ModelMisfit:
        if isinstance(key, int):
            return self.models[key]
        named = {part.label: part for part in self.models}
        if key not in named:
            raise DataError(f"The comparison has no model {key!r}. It has: {', '.join(named)}.")
        return named[key]

    @property
    def best(self) -> ModelMisfit:
        """The model with the smallest misfit over all outputs."""
        return min(self.models, key=lambda part: part.relative)

    @property
    def verdict(self) -> str:
        """The comparison in words."""
        lines = [part.verdict for part in self.models]
        if len(self.models) > 1:
            best = self.best
            lines.append(
                f"Closest: {best.label}, {best.relative:.3g} x noise against {self._others}."
            )
        return "\n".join(lines)

    @property
    def _others(self) -> str:
        """Errors of the models that are not the best."""
        others = (part for part in self.models if part is not self.best)
        return ", ".join(f"{part.relative:.3g} ({part.label})" for part in others)

    def document(
        self, *, title: str = "Models and records", log: LogCheck | None = None
    ) -> display.Report:
        """Return what the comparison says: misfit by output, and predictions."""
        names = self.dataset.names
        way = f"initial states: {WAYS[self.models[0].prediction.way]}"
        if self.dataset.only_tests:
            way = SAYS["compared"]["tests"]
        caption = SAYS["captions"]["plot_comparison"]
        bars = display.Figure("plot_comparison", self, caption, size=(8.4, 3.8))
        labels = {"labels": [part.label for part in self.models]}
        predictions = [part.prediction for part in self.models]
        drawings = [
            display.Figure(
                "figure_predictions", predictions, say("captions", "figure_predictions", record=n),
                (n,), labels,
            )
            for n in names[:MOST_DRAWN]
        ]  # fmt: skip
        rest = len(self.dataset) - len(drawings)
        words = (f"{rest} further records are not drawn.",) if rest else ()
        return display.Report(
            title=title,
            subtitle=f"Compared on {', '.join(names)}",
            headline=f"comparison on {', '.join(names)}\n  {way}",
            answer=self._answer(),
            warnings=() if log is None else log.warning().splitlines(),
            numbers=[(part.label, f"{part.relative:.3g} × noise") for part in self.models],
            sections=(
                *(part.section() for part in self.models),
                display.Section(
                    "Where the models differ from the records", figures=(bars,), only="page"
                ),
                display.Section("Predictions", words, figures=drawings, only="page"),
            ),
            verdict=(*self.verdict.splitlines(), *(f"Note: {note}" for note in self.notes)),
        )

    report = display.as_text

    def _answer(self) -> str:
        """Which model predicts best, and whether what is left is noise."""
        best = self.best
        left = "noise is left" if best.is_noise else "more than noise is left"
        if len(self.models) == 1:
            return f"{best.label} predicts to {best.relative:.3g} × noise: {left}."
        return (
            f"{best.label} predicts best, to {best.relative:.3g} × noise: {left}; the others to "
            f"{self._others}."
        )

    to_dict = display.as_dict(
        "models", "verdict", "notes",
        records="dataset.names", best="best.label",
        noise=lambda self: dict(zip(self.dataset.channels.output_names, self.sigma, strict=True)),
    )  # fmt: skip


@single_threaded
def compare(
    fits: Fit | Model | Sequence[Fit | Model] | Mapping[str, Fit | Model],
    dataset: Dataset,
    *,
    initial: Initial = "fit",
    horizon: float = 10.0,
    sigma: np.ndarray | None = None,
) -> Comparison:
    """Compare models with records, best validation records.

    No shared parameter is estimated again; initial states (and parameters
    that differ from record to record) are, because no record starts from a
    known state.

    Parameters
    ----------
    fits : Fit, Model, a sequence or a mapping of them
        What to judge; a mapping names the models. A model stands for itself at
        its values, without uncertainty.
    dataset : Dataset
        Records with the models' channels.
    initial : str or mapping
        Initial states, as :func:`oed_sysid.likelihood.prediction.predict` takes them.
    horizon : float
        How far ahead forecasts look, and length of the windows in which the
        misfit is located, s.
    sigma : ndarray (n_outputs,), optional
        Noise levels that errors are measured with, SI. By default those declared by the model, or
        that a fit was given; else the smallest that a fit estimated.

    Returns
    -------
    Comparison

    Raises
    ------
    DataError
        If nothing was given or a model has other channels than the records.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> found = compare(problem.model, Dataset((problem.data()["test_steps"],)))
    >>> found.models[0].outputs[0].output.name, found.models[0].is_noise
    ('u', False)
    """
    if isinstance(fits, Mapping):
        labels, given = tuple(fits), tuple(fits.values())
    else:
        given = (fits,) if isinstance(fits, Fit | Model) else tuple(fits)
        labels = _labels([_model(item) for item in given])
    if not given:
        raise DataError("Nothing to compare: give at least one fit or model.")
    if not horizon > 0:
        raise DataError(f"horizon is {horizon} s. Give a length above zero.")
    sigma, notes = _levels(given, dataset) if sigma is None else (np.asarray(sigma), ())
    notes = (*_training_notes(given, dataset), *notes)
    parts = tuple(
        _misfit(label, item, dataset, sigma, initial, horizon)
        for label, item in zip(labels, given, strict=True)
    )
    return Comparison(dataset, parts, sigma, notes)


def _training_notes(given: Sequence[Fit | Model], dataset: Dataset) -> tuple[str, ...]:
    """Say so where a fit is judged on records that it was fitted to, whatever they are called."""
    trained = [item for item in given if isinstance(item, Fit)]
    try:
        for fit in trained:
            check_disjoint(fit.dataset, dataset)
    except DataError as error:
        return (f"this is no validation: {error}",)
    return ()


def _misfit(
    label: str,
    item: Fit | Model,
    dataset: Dataset,
    sigma: np.ndarray,
    initial: Initial,
    horizon: float,
) -> ModelMisfit:
    model = _model(item)
    n_shared = sum(not p.per_record for p in model.free_parameters)
    covariance = item.covariance if isinstance(item, Fit) else np.zeros((n_shared, n_shared))
    # What start states may be bent by is what a fit admits.
    own = item.noise if isinstance(item, Fit) else None
    noise = sigma if own is None or own.is_white else own
    prediction = predict(model, dataset, covariance, noise, initial=initial)
    inside = [
        np.abs(residual) <= display.TWO_SIDED_95 * std
        for residual, std in zip(prediction.residuals, prediction.std, strict=True)
    ]
    residuals = [_distance(r, found) for r, found in zip(dataset, prediction.outputs, strict=True)]

    def of(series: Sequence[np.ndarray], column: int) -> list[np.ndarray]:
        return [part[:, column] for part in series]

    outputs = tuple(
        output_misfit(
            output, of(residuals, column), float(level), of(inside, column), dataset, horizon
        )
        for column, (output, level) in enumerate(zip(model.outputs, sigma, strict=True))
    )
    ahead = forecasts(model, dataset, sigma, horizon=horizon, local=prediction.local_values)
    return ModelMisfit(label, model, prediction, outputs, ahead)


def _model(item: Fit | Model) -> Model:
    return item.model if isinstance(item, Fit) else item


def _distance(record: Record, predicted: np.ndarray) -> np.ndarray:
    """Residuals; infinite where there is a measurement but no prediction."""
    lost = np.isfinite(record.outputs) & ~np.isfinite(predicted)
    return np.where(lost, np.inf, record.residuals(predicted))


def _levels(given: Sequence[Fit | Model], dataset: Dataset) -> tuple[np.ndarray, tuple[str, ...]]:
    """One set of noise levels for all models, and what is doubtful about it.

    In this order: a level that a fit was given, a declared one, the smallest
    that a fit estimated, and the high-frequency content of the records. A filter along the records
    estimates declared levels again: errors are still in units of what was declared.
    """
    fits = [item for item in given if isinstance(item, Fit)]
    floor, _ = credible_levels(dataset)
    sigma = believed_levels(_model(given[0]).outputs, dataset)
    for fit in reversed(fits):
        own = fit.sigma_estimated | ((fit.innovations is not None) & np.isfinite(sigma))
        sigma = np.where(own, sigma, fit.noise.sensors)
    names, unknown = np.array(dataset.channels.output_names), np.isnan(sigma)
    if not unknown.any():
        return sigma, ()
    if not fits:
        note = say("compared", "assumed", names=", ".join(names[unknown]))
        return np.where(unknown, floor, sigma), (note,)
    # A sensor's noise is all of it, white and coloured.
    sigma = np.where(unknown, np.min([fit.noise.sensors for fit in fits], axis=0), sigma)
    high = unknown & (sigma > WORTH_TELLING * floor)
    told = zip(names[high], sigma[high], floor[high], strict=True)
    return sigma, tuple(
        say("compared", "estimated", name=name, level=level, low=low) for name, level, low in told
    )


def _labels(models: Sequence[Model]) -> tuple[str, ...]:
    """Names that tell models apart, by their effects if need be."""
    names = [model.name for model in models]
    if len(set(names)) == len(names):
        return tuple(names)
    common = set.intersection(*(set(model.effect_names) for model in models))
    labels = list[str]()
    for position, model in enumerate(models, start=1):
        first = "base" if len(set(names)) == 1 else model.name
        label = " + ".join([first, *(n for n in model.effect_names if n not in common)])
        labels.append(f"{label} ({position})" if label in labels else label)
    return tuple(labels)


def _table(part: ModelMisfit) -> display.Table:
    headers = (
        "output", "rmse", "unit", "x noise", "in band", "eff. samples", "of", "ahead", "worst",
    )  # fmt: skip
    rows = []
    for output, ahead in zip(part.outputs, part.forecasts.relative, strict=True):
        if not (output.n_samples or output.in_time):  # captive tests measure forces alone
            continue
        factor, unit = shown_unit(output.output.unit)  # angles are read in degrees
        rows.append(
            (
                output.output.name,
                f"{factor * output.rmse:.3g}",
                unit,
                display.digits(output.relative, 3),
                f"{100 * output.coverage:.0f} %",
                f"{output.effective_samples:.0f}",
                f"{output.n_samples}",
                display.digits(ahead, 3) if output.in_time else "-",
                f"{output.worst[3]:.2g} in {output.where}" if output.where else "",
            )
        )
    return display.Table(headers, rows)


@dataclass(frozen=True, eq=False)
class Diagnosis:
    """Where a model fails on some records, and which effects would explain it.

    Attributes
    ----------
    model : Model
        The nominal model.
    location : Located
    ranking : Ranking

    Examples
    --------
    What :func:`~oed_sysid.evidence.diagnose` returns; see there.
    """

    model: Model
    location: Located
    ranking: Ranking

    _repr_html_ = display.as_html

    def __repr__(self) -> str:
        return f"<Diagnosis of {self.model.name!r}: lacks {', '.join(self.group) or 'nothing'}>"

    @property
    def best(self) -> Effect | None:
        """The likeliest effect, ready to be added; None where chance explains its gain."""
        for refit in self.ranking.refits[:1]:
            if refit.gain >= refit.needed:
                return refit.score.effect.with_values(refit.fit.values)
        return None

    @property
    def group(self) -> tuple[str, ...]:
        """Identifiers of the best effect and of those that cannot be told from it here."""
        if self.best is None:
            return ()
        return self.ranking.claimed_with(self.ranking.refits[0])

    @property
    def verdict(self) -> str:
        """Which effect is missing, as far as these records can tell."""
        group = self.group
        if not group:
            return f"{self.model.name}: no candidate explains more than chance does."
        others = f"; these records cannot tell it from {', '.join(group[1:])}" if group[1:] else ""
        return f"{self.model.name} lacks {group[0]}{others}."

    def document(self, train: Dataset | None = None, *, title: str = "") -> display.Report:
        """Return the diagnosis; with its records, residual forces against their signals."""
        return display.Report(
            title=title or self.model.name,
            subtitle="Where the model fails and what may be missing; nothing was added",
            headline=self.model.name,
            answer=self.verdict,
            sections=(
                *self.location.document(train).sections,
                *self.ranking.document().sections,
                display.Section(
                    "Equations of the nominal model", listing=self.model.equations(), only="page"
                ),
            ),
            verdict=(
                self.verdict,
                "Nothing has been added, and no validation record been asked: that is `improve`.",
            ),
        )

    report = display.as_text

    to_dict = display.as_dict(
        "group",
        best=lambda self: None if self.best is None else self.best.name,
        located="location.gains", ranking=lambda self: self.ranking.scored(),
        undetectable=lambda self: self.ranking.undetectable(),
    )  # fmt: skip


@single_threaded
def diagnose(
    model: Model,
    dataset: Dataset,
    *,
    candidates: Sequence[Effect] | None = None,
    known_noise: bool = False,
    disturbances: Disturbances = "auto",
) -> Diagnosis:
    """Locate where a model fails and rank what may be missing, adding nothing.

    Parameters
    ----------
    model : Model
        The nominal model.
    dataset : Dataset
        Measured records.
    candidates : sequence of Effect, optional
        What may be missing; without any, what usually is
        (:func:`~oed_sysid.evidence.usual.usual_effects`).
    known_noise : bool
    disturbances : str or sequence of str
        See :func:`oed_sysid.evidence.improve.improve`.

    Returns
    -------
    Diagnosis
        ``location`` and ``ranking``, and one ``report()`` of both.

    Raises
    ------
    DataError
        If the records have other channels than the model, or too few samples for its unknowns.

    Examples
    --------
    >>> from oed_sysid import load_problem
    >>> problem = load_problem("remus_diving_plane")
    >>> train = Dataset((problem.data()["train_steps"].window(0.0, 30.0),))
    >>> found = diagnose(problem.model, train, candidates=problem.effects[:3])
    >>> found.location.best, found.ranking.order[0]
    ('force Z', 'heave_crossflow_drag')
    """
    check_channels(model, dataset)
    candidates, _ = settled(model, dataset, candidates)
    study, fit = Study.begin(
        model, dataset, None, candidates, known_noise=known_noise, disturbances=disturbances
    )
    ranking = rank(study, fit, study.candidates)
    return Diagnosis(model, locate(fit, study.unit, likeliest(ranking)), ranking)


# -- a short time ahead ---------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Forecasts:
    """Errors of forecasts of one model.

    Attributes
    ----------
    horizon : float
        How far ahead, s.
    errors : tuple of ndarray (n_starts, n_ahead, n_outputs)
        Measured minus forecast, per record; NaN where nothing was measured or
        the forecast diverged.
    expected : tuple of ndarray (n_starts, n_ahead, n_outputs)
        Standard deviation of these errors if the model were right: noise, and
        the error of the start state.
    failed : int
        Number of forecasts that diverged.
    """

    horizon: float
    errors: tuple[np.ndarray, ...]
    expected: tuple[np.ndarray, ...]
    failed: int

    to_dict = display.as_dict("horizon", "n_forecasts", "failed", "rmse", "relative", "overall")

    @property
    def n_forecasts(self) -> int:
        """Number of forecasts over all records."""
        return sum(map(len, self.errors))

    @property
    def rmse(self) -> np.ndarray:
        """Root mean square error of each output, shape ``(n_outputs,)``; infinite if one failed."""
        return self._rms(self.errors)

    @property
    def relative(self) -> np.ndarray:
        """The same in units of what a right model would leave; 1 is perfect."""
        pairs = zip(self.errors, self.expected, strict=True)
        return self._rms([error / size for error, size in pairs])

    @property
    def overall(self) -> float:
        """Relative error over all outputs."""
        return np.inf if self.failed else total_error(self.relative)

    def _rms(self, parts: Sequence[np.ndarray]) -> np.ndarray:
        result = root_mean_square([part.reshape(-1, part.shape[2]) for part in parts])
        return np.where(np.isfinite(result), np.inf, result) if self.failed else result


def forecasts(
    model: Model,
    dataset: Dataset,
    sigma: np.ndarray,
    *,
    horizon: float = 10.0,
    local: Sequence[Mapping[str, float]] | None = None,
) -> Forecasts:
    """Forecast every stretch of ``horizon`` seconds from the one before it.

    The state at the start of a stretch of half the horizon is estimated from
    that stretch (:mod:`oed_sysid.likelihood.windows`); the model then runs on over the horizon
    without measurements.

    Parameters
    ----------
    model : Model
        At the values to judge.
    dataset : Dataset
        Records; those shorter than one and a half horizons give no forecast, nor do independent
        tests.
    sigma : ndarray (n_outputs,)
        Noise levels.
    horizon : float
        How far ahead, s.
    local : sequence of mapping, optional
        Values of per-record parameters.
    """
    held = model.fix(*model.free_names)
    compiled, every = kernel(held), local or [{}] * len(dataset)
    pairs = zip(dataset, every, strict=True)
    parts = [_ahead(compiled, held.with_values(v), r, sigma, horizon) for r, v in pairs]
    errors, expected = zip(*parts, strict=True)
    failed = sum(int(np.isnan(size).any(axis=(1, 2)).sum()) for size in expected)
    return Forecasts(horizon, errors, expected, failed)


def _ahead(
    compiled: Kernel, model: Model, record: Record, sigma: np.ndarray, horizon: float
) -> tuple[np.ndarray, np.ndarray]:
    """Errors and their expected size along one record; NaN where a forecast diverges."""
    ahead = max(2, round(horizon / record.sample_time))
    before = max(2, ahead // 2)
    # Nothing follows from one independent test to the next.
    count = 0 if record.independent else record.n_samples
    first = np.arange(0, count - before - ahead + 1, ahead)
    errors = np.full((len(first), ahead, len(sigma)), np.nan)
    expected = errors.copy()
    if not len(first):
        return errors, expected
    shooting = Shooting(model, Dataset((record,)), sigma, runner=compiled)
    unknowns = shooting.start_unknowns()
    _, by_own = shooting.full_start(unknowns, 0)
    # A play or a lag is where its commands have left it; what follows from the states (a late
    # sensor) is estimated with these.
    memory = ~by_own[:, : compiled.n_own].any(axis=1)
    weight = np.where(memory, HELD, (VAGUE * shooting.state_scale) ** -2.0)
    starts = np.unique([*first, *(first[:-1] + before)]).astype(np.intc)
    part = Part(0, starts, np.isin(starts, first), int(first[-1]) + before)
    problem = Windows(shooting, [part], weight[None], unknowns)
    descent = Descent(problem.at(problem.start), Windows.at, Convergence(1e-3))
    descent.run(FIRST_STEPS)
    (nodes,) = descent.lowest.point.nodes
    gram = problem.products(part, unknowns, nodes)
    known = np.diag(weight) if gram is None else gram[:, :-1, :-1] + np.diag(weight)
    known = np.broadcast_to(known, (len(first), len(weight), len(weight)))
    for row, (begin, node) in enumerate(zip(first, nodes[part.counted], strict=True)):
        seen = slice(begin, begin + before + ahead)
        times, inputs = record.times[seen], record.inputs[seen]
        run = compiled.run(times, inputs, model.value_vector, node, sensitivities=True)
        if run.ok:
            later = run.output_sensitivities[before:, :, : compiled.n_full]
            variance = np.einsum("tij,jk,tik->ti", later, inverse_of(known[row]), later)
            errors[row] = (record.outputs[seen] - run.outputs)[before:]
            expected[row] = np.sqrt(variance + sigma**2)
    return errors, expected
