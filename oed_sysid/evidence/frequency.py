r"""Frequency responses of records beside those of models.

Spectra are means over windows of all records, half overlapping, tapered by Hann's window and free
of a linear trend (Welch; :func:`scipy.signal.csd`). With inputs :math:`u` and an output :math:`y`,

.. math::
    H = G_{uu}^{-1} G_{uy}, \quad G_{ee} = G_{yy} - G_{yu} G_{uu}^{-1} G_{uy}, \quad
    \gamma_i^2 = \frac{|H_i|^2}{|H_i|^2 + G_{ee}\,[G_{uu}^{-1}]_{ii}}

are the responses to each input with the others accounted for, what no input explains, and the
partial coherence. The multiple coherence is :math:`1 - G_{ee}/G_{yy}`. With :math:`n` independent
windows and :math:`q` inputs,

.. math::
    \sigma_i^2 = \frac{1}{2n} \frac{n}{n - q}\, G_{ee}\,[G_{uu}^{-1}]_{ii}

is the variance of the real and of the imaginary part of :math:`H_i`, thus of its magnitude, and,
over :math:`|H_i|`, of its phase: :math:`\sqrt{1 - \gamma_i^2}\,/\,(|\gamma_i| \sqrt{2n})` of
Bendat and Piersol, without its bias for few windows.

**Over which band a model holds.** The model's run on the same inputs goes through the same windows,
so that leakage, sampling, actuators and nonlinearity are in both responses. At a frequency the
record *tells* of a response where its partial coherence is at least 0.6; there the model *holds*
where

.. math:: \frac{|H_i - H_i^\text{model}|^2}{2 \sigma_i^2} \le F_{1 - \alpha/m}(2,\, 2(n - q))

with :math:`m` such frequencies and responses and :math:`\alpha` of a hundredth altogether. Errors
of the model's own parameters are left out, and so is leakage, which at the lowest frequencies, and
beside steep peaks and troughs of spectra at any, moves a response by more than its random error:
against a closed form these count for little.

**Feedback.** Where inputs answer outputs, as a zigzag's and a helmsman's do, disturbances reach the
inputs, and the response of a record is drawn towards minus the inverse of the controller (Ljung
1999, section 6.4), the more the lower the coherence. The model's run, which no disturbance moves,
is not: a failure at low coherence may be the controller's.

References
----------
J. S. Bendat, A. G. Piersol, *Random Data*, Wiley, 4th ed. (2010), chapters 7 and 9.
P. D. Welch, *IEEE Transactions on Audio and Electroacoustics* 15 (1967) 70-73.
L. Ljung, *System Identification*, 2nd ed. (1999).
M. B. Tischler, R. K. Remple, *Aircraft and Rotorcraft System Identification*, AIAA, 2nd ed. (2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np
from scipy.signal import csd, get_window
from scipy.stats import f as f_distribution

from oed_sysid.data.dataset import Dataset, Record
from oed_sysid.errors import DataError
from oed_sysid.evidence.chance import FALSE_CLAIMS
from oed_sysid.evidence.compare import Comparison
from oed_sysid.evidence.sentences import SAYS, say
from oed_sysid.runtime.display import Figure, Report, Section, Table, as_dict, as_text

# Partial coherence from which a record tells of a response: with ten windows the random error is
# 18 per cent; the rule of Tischler and Remple. Higher narrows the bands that are judged.
TOLD = 0.6
# Lengths of a window in all records together: more give smaller random errors and coarser
# frequencies.
WINDOWS = 10


HOLDS, FAILS, UNTOLD = "holds", "fails", "untold"


@dataclass(frozen=True, eq=False)
class FrequencyResponse:
    """What records say of the response of every output to every input.

    Attributes
    ----------
    inputs, outputs : tuple of str
        Inputs that move, and outputs that were measured.
    frequencies : ndarray (n_frequencies,)
        Hz.
    values : ndarray of complex (n_frequencies, n_outputs, n_inputs)
        Responses, SI; NaN where inputs cannot be told apart.
    errors : ndarray (n_frequencies, n_outputs, n_inputs)
        Standard deviations of the real and of the imaginary part.
    coherence : ndarray (n_frequencies, n_outputs, n_inputs)
        Partial coherence, squared.
    multiple : ndarray (n_frequencies, n_outputs)
        Multiple coherence, squared.
    input_spectra, output_spectra : ndarray (n_frequencies, n_inputs or n_outputs)
        One-sided power spectral densities, SI squared per Hz.
    window : float
        Length of a window, s.
    sample_time : float
        s.
    averages : float
        Independent windows.
    records : tuple of str
        Records that are long enough.
    """

    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    frequencies: np.ndarray
    values: np.ndarray
    errors: np.ndarray
    coherence: np.ndarray
    multiple: np.ndarray
    input_spectra: np.ndarray
    output_spectra: np.ndarray
    window: float
    sample_time: float
    averages: float
    records: tuple[str, ...]

    to_dict = as_dict()

    @property
    def told(self) -> np.ndarray:
        """Where the records tell of a response, ``(n_frequencies, n_outputs, n_inputs)``."""
        return self.coherence >= TOLD


def frequency_response(
    dataset: Dataset, *, outputs: Sequence[np.ndarray] | None = None, window: float | None = None
) -> FrequencyResponse:
    """Estimate the frequency responses of records.

    Parameters
    ----------
    dataset : Dataset
        Records; gaps are bridged linearly, and uneven samples are interpolated.
    outputs : sequence of ndarray (n_times, n_outputs), optional
        What stands in the place of the measured outputs, such as a model's; only where these
        were measured.
    window : float, optional
        Length of a window, s; by default a tenth of all records together, at most the longest.

    Raises
    ------
    DataError
        If records are independent tests, no input moves, or too few windows are at hand.
    """
    if dataset.only_tests:
        raise DataError(SAYS["refused"]["tests"])
    step = float(np.median([record.sample_time for record in dataset]))
    moving, seen = _signals(dataset)
    n_inputs = len(moving)
    size = _window(dataset, step, window)
    runs = [record.outputs for record in dataset] if outputs is None else outputs
    parts = {
        record.name: _spectra(_series(record, run, step, moving, seen), step, size)
        for record, run in zip(dataset, runs, strict=True)
    }
    used = {name: part for name, part in parts.items() if part[1]}
    count = sum(own for _, own in used.values())
    averages = _independent(count, size)
    if averages <= n_inputs + 1.0:
        facts = {"averages": averages, "size": size * step, "inputs": n_inputs}
        raise DataError(say("refused", "windows", **facts))
    # Neither the mean, which the trend takes, nor half the sampling rate, where spectra are real.
    kept = slice(1, (size + 1) // 2)
    total = np.sum([own * part for part, own in used.values()], axis=0)
    matrix = np.moveaxis(total / count, -1, 0)[kept]
    power = np.einsum("kii->ki", matrix).real
    return FrequencyResponse(
        _named(dataset.channels.input_names, moving), _named(dataset.channels.output_names, seen),
        np.fft.rfftfreq(size, step)[kept], *_responses(matrix, n_inputs, averages),
        power[:, :n_inputs], power[:, n_inputs:], size * step, step, averages, tuple(used),
    )  # fmt: skip


def _window(dataset: Dataset, step: float, window: float | None) -> int:
    """Samples of a window: as given, or a share of all records, at most the longest."""
    durations = [record.duration for record in dataset]
    return max(round((window or min(sum(durations) / WINDOWS, max(durations))) / step), 1)


def _named(names: Sequence[str], columns: Sequence[int]) -> tuple[str, ...]:
    return tuple(names[column] for column in columns)


def _signals(dataset: Dataset) -> tuple[list[int], list[int]]:
    """Columns of the inputs that move and of the outputs that every record has."""
    inputs, outputs = dataset.channels.input_names, dataset.channels.output_names
    moving = [i for i, name in enumerate(inputs) if any(np.ptp(r.input(name)) for r in dataset)]
    seen = [
        j
        for j, name in enumerate(outputs)
        if all(np.isfinite(record.output(name)).sum() > 1 for record in dataset)
    ]
    if not moving or not seen:
        raise DataError(SAYS["refused"]["still"])
    return moving, seen


def _spectra(series: np.ndarray, step: float, size: int) -> tuple[np.ndarray, int]:
    """Mean of all spectra ``(n_signals, n_signals, n_frequencies)`` over windows, and their count.

    None of a record that is shorter than a window.
    """
    count = max((series.shape[1] - size) // (size - size // 2) + 1, 0)
    if not count:
        return np.empty(0), 0
    _, found = csd(
        series[:, np.newaxis], series[np.newaxis], 1.0 / step, nperseg=size, noverlap=size // 2,
        detrend="linear",
    )  # fmt: skip
    return found, count


def _series(
    record: Record, run: np.ndarray, step: float, moving: list[int], seen: list[int]
) -> np.ndarray:
    """Moving inputs and seen outputs at even times, ``(n_signals, n_even)``."""
    even = record.times[0] + step * np.arange(int(record.duration / step + 1e-6) + 1)
    found = [np.interp(even, record.times, record.inputs[:, i]) for i in moving]
    for j in seen:
        present = np.isfinite(record.outputs[:, j]) & np.isfinite(run[:, j])
        if not present.any():
            raise DataError(f"The run of {record.name!r} diverges: it has no frequency response.")
        found.append(np.interp(even, record.times[present], run[present, j]))
    return np.array(found)


def _independent(count: int, size: int) -> float:
    """Windows without overlap that average as well as ``count`` half overlapping ones (Welch)."""
    taper = get_window("hann", size)
    lag = size - size // 2
    shared = float(taper[:-lag] @ taper[lag:] / (taper @ taper)) ** 2
    return count / (1.0 + 2.0 * shared * (count - 1) / max(count, 1))


def _responses(
    matrix: np.ndarray, n_inputs: int, averages: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Responses, errors, partial and multiple coherence from all spectra ``(n, n_all, n_all)``."""
    own, cross = matrix[:, :n_inputs, :n_inputs], matrix[:, :n_inputs, n_inputs:]
    power = np.einsum("kjj->kj", matrix[:, n_inputs:, n_inputs:]).real
    scale = np.sqrt(np.maximum(np.einsum("kii->ki", own).real, np.finfo(float).tiny))
    alike = own / (scale[:, :, np.newaxis] * scale[:, np.newaxis])
    apart = np.linalg.matrix_rank(alike, hermitian=True) == n_inputs
    inverse = np.full(own.shape, np.nan, dtype=complex)
    inverse[apart] = np.linalg.inv(alike[apart])
    inverse /= scale[:, :, np.newaxis] * scale[:, np.newaxis]
    values = inverse @ cross
    explained = np.einsum("kij,kij->kj", cross.conj(), values).real
    left = np.maximum(power - explained, 0.0)
    spread = np.einsum("kj,kii->kji", left, inverse).real
    values = np.swapaxes(values, 1, 2)
    size = np.abs(values) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        partial = np.nan_to_num(size / (size + spread))
        multiple = np.nan_to_num(explained / power)
    errors = np.sqrt(spread / (2.0 * (averages - n_inputs)))
    return values, errors, partial, multiple


@dataclass(frozen=True, eq=False)
class ModelResponse:
    """Frequency responses of one model beside those of the records.

    Attributes
    ----------
    label : str
    values : ndarray of complex (n_frequencies, n_outputs, n_inputs)
        Of the model's run on the records' inputs, through the same windows.
    verdicts : ndarray of str (n_frequencies, n_outputs, n_inputs)
        ``holds``, ``fails`` or ``untold``.
    """

    label: str
    values: np.ndarray
    verdicts: np.ndarray

    to_dict = as_dict("label", "values")


@dataclass(frozen=True)
class Band:
    """A response of a model over neighbouring frequencies of one verdict.

    Attributes
    ----------
    model, input, output : str
    low, high : float
        Hz.
    verdict : str
        ``holds``, ``fails`` or ``untold``.
    ratio : float
        Magnitude of the model's response over that of the records, mean of the logarithms.
    phase : float
        Mean of the model's phase minus that of the records, rad.
    count : int
        Frequencies.
    """

    model: str
    input: str
    output: str
    low: float
    high: float
    verdict: str
    ratio: float
    phase: float
    count: int


@dataclass(frozen=True, eq=False)
class FrequencyComparison:
    """Frequency responses of records and of models, and the bands over which these hold.

    Attributes
    ----------
    record : FrequencyResponse
    models : tuple of ModelResponse
    """

    record: FrequencyResponse
    models: tuple[ModelResponse, ...]

    def bands_of(self, one: ModelResponse, command: str, output: str) -> tuple[Band, ...]:
        """Bands of a model for one response, in the order of their frequencies."""
        record, found = self.record, list[Band]()
        at = slice(None), record.outputs.index(output), record.inputs.index(command)
        said = one.verdicts[at]
        edges = [0, *(np.flatnonzero(said[1:] != said[:-1]) + 1), len(said)]
        with np.errstate(divide="ignore", invalid="ignore"):
            apart = np.log(one.values[at] / record.values[at])
        for low, high in pairwise(edges):
            mean = apart[low:high].mean()
            found.append(Band(
                one.label, command, output, float(record.frequencies[low]),
                float(record.frequencies[high - 1]), str(said[low]),
                float(np.exp(mean.real)), float(mean.imag), int(high - low),
            ))  # fmt: skip
        return tuple(found)

    @property
    def bands(self) -> tuple[Band, ...]:
        """Bands of every model and response."""
        each = (self.bands_of(one, *key) for one in self.models for key in self._responses)
        return tuple(chain.from_iterable(each))

    def said_of(self, command: str, output: str) -> tuple[str, ...]:
        """Over which bands each model holds for one response, in sentences."""
        return tuple(self._sentence(one, command, output) for one in self.models)

    @property
    def verdict(self) -> tuple[str, ...]:
        """Over which bands each model holds, one sentence for each response."""
        return tuple(self._sentence(one, *key) for one in self.models for key in self._responses)

    @property
    def _responses(self) -> list[tuple[str, str]]:
        """Input and output of every response."""
        return [(command, out) for out in self.record.outputs for command in self.record.inputs]

    def _sentence(self, one: ModelResponse, command: str, output: str) -> str:
        """Where a model holds for one response."""
        bands, head = self.bands_of(one, command, output), f"{one.label}, {command} to {output}: "
        told = [band for band in bands if band.verdict != UNTOLD]
        if not told:
            return f"{head}the records tell nothing at any frequency."
        spans, missed = ([band for band in told if band.verdict == one] for one in (HOLDS, FAILS))
        if min(len(spans), len(missed)) < 2:
            words = f"holds over {_spans(spans)}" if spans else "holds nowhere"
            more = f", fails over {_spans(missed)}" if missed else ""
            return f"{head}{words}{more}; elsewhere the records tell nothing."
        # Of verdicts that alternate the reader wants the extent, the share and the worst.
        worst = max(missed, key=lambda band: abs(np.log(band.ratio) + 1j * band.phase))
        n, total = sum(band.count for band in spans), sum(band.count for band in told)
        facts = {"count": n, "total": total, "low": told[0].low, "high": told[-1].high}
        off = {"worst": _spans([worst]), "apart": ", ".join(_apart(worst))}
        return head + say("compared", "alternates", **facts, **off)

    def section(self) -> Section:
        """Return the comparison as a part of a document."""
        rows = [
            (one.model, f"{one.input} to {one.output}", f"{one.low:.3g} to {one.high:.3g}",
             one.verdict, *_apart(one))
            for one in self.bands
            if one.verdict != UNTOLD
        ]  # fmt: skip
        record = self.record
        facts = {"averages": record.averages, "window": record.window, "told": TOLD}
        words = (say("compared", "windows", **facts), *self.verdict)
        heads = ("model", "response", "band [Hz]", "verdict", "magnitude", "phase [deg]")
        drawn = [
            Figure("figure_frequency", self, say("captions", "figure_frequency", output=n), (n,))
            for n in record.outputs
        ]
        tables = (Table(heads, rows, words=(1, 3)),) if rows else ()
        return Section("Frequency responses", words, tables, drawn, heading=True, indent=2)

    def document(self) -> Report:
        """Return the comparison."""
        records = ", ".join(self.record.records)
        return Report(f"frequency responses of {records}", sections=(self.section(),))

    report = as_text

    to_dict = as_dict("record", "bands", "verdict", "models")


def compare_frequency(
    comparison: Comparison, *, window: float | None = None
) -> FrequencyComparison:
    """Say over which band of frequencies the models of a comparison hold.

    Parameters
    ----------
    comparison : Comparison
        Of :func:`~oed_sysid.evidence.compare.compare`.
    window : float, optional
        Length of a window, s; see :func:`frequency_response`.

    Raises
    ------
    DataError
        If the records have no frequency response, or a model's run diverges.
    """
    dataset = comparison.dataset
    record = frequency_response(dataset, window=window)
    models = []
    for one in comparison.models:
        run = frequency_response(dataset, outputs=one.prediction.outputs, window=window)
        verdicts = _verdicts(record, run.values)
        models.append(ModelResponse(one.label, run.values, verdicts))
    return FrequencyComparison(record, tuple(models))


def _verdicts(record: FrequencyResponse, values: np.ndarray) -> np.ndarray:
    """Verdict on a model's responses at every frequency."""
    told, n_inputs = record.told, len(record.inputs)
    chance = 1.0 - FALSE_CLAIMS / max(int(told.sum()), 1)
    most = f_distribution.ppf(chance, 2, 2.0 * (record.averages - n_inputs))
    off = np.abs(record.values - values) ** 2 > most * 2.0 * record.errors**2
    return np.where(told, np.where(off, FAILS, HOLDS), UNTOLD)


def _apart(band: Band) -> tuple[str, str]:
    """Mean distance of model and record over a band, in words."""
    return f"x {band.ratio:.3g}", f"{np.degrees(band.phase):+.1f}"


def _spans(bands: Sequence[Band]) -> str:
    return ", ".join(f"{band.low:.3g} to {band.high:.3g} Hz" for band in bands)
