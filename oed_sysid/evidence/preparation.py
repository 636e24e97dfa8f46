r"""What a search reads of the records that it is given.

**Validation.** A claim is tested on records that nothing was chosen on. Where one record is given
and no other, its last part is kept for that, :math:`t > t_0 + \alpha\,(t_N - t_0)`; of a series of
independent tests, whose order says nothing, as many are drawn by lot.

**Sampling.** Evidence grows with the samples, and so does the time of the search; but a vehicle
that turns within seconds is not known better at 50 Hz than the noise of its sensors, averaged,
allows. Of a very long log every :math:`k`-th sample is read,

.. math:: \tilde y_j = y(t_{jk}), \qquad
    \tilde u_j = \frac{1}{t_{(j+1)k} - t_{jk}} \int_{t_{jk}}^{t_{(j+1)k}} u\,dt,

the mean of an input that is held keeping what its switching moves. :math:`k` is as small as the
wanted number of samples allows, and never so large that a signal bends between two of them: what a
straight line through :math:`k + 1` neighbours leaves has to be noise,

.. math:: \operatorname{rms}(y - \ell_k) \le \max(\lambda\,\sigma,\ \epsilon\,s_y),

with the level :math:`\sigma` of the high-frequency content and the spread :math:`s_y` of the
signal.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from oed_sysid.data.dataset import Dataset
from oed_sysid.data.record import Record
from oed_sysid.evidence.sentences import say
from oed_sysid.evidence.traces import LEAST
from oed_sysid.likelihood.between_records import WORTH_TELLING
from oed_sysid.likelihood.noise_levels import credible_levels, signal_spread
from oed_sysid.runtime.constants import NEGLIGIBLE

# Share of a record that is learnt from, and least samples of either part.
LEARNT = 0.6
LEAST_SAMPLES = 5 * LEAST


@dataclass(frozen=True, eq=False)
class Prepared:
    """Records as a search reads them.

    Attributes
    ----------
    train : Dataset
    validation : Dataset or None
    notes : tuple of str
        What was done to the records, in sentences.
    whole : Dataset or None
        Training records with all samples, where some were left out.
    """

    train: Dataset
    validation: Dataset | None
    notes: tuple[str, ...] = ()
    whole: Dataset | None = None


def prepared(train: Dataset, validation: Dataset | None, *, enough: int = 20_000) -> Prepared:
    """Keep a part for validation where none is given, and thin what is very long.

    Parameters
    ----------
    train : Dataset
    validation : Dataset or None
    enough : int
        About how many samples are read: a search then takes minutes.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Input, Output
    >>> channels = Channels((Input("fin", "rad"),), (Output("q", "rad/s"),))
    >>> t = np.arange(1000) * 0.1
    >>> run = Record("dive", t, np.sin(t)[:, None], np.cos(t)[:, None], channels)
    >>> found = prepared(Dataset((run,)), None)
    >>> print(found.train.n_samples, found.validation.n_samples)
    600 400
    """
    ready, tests = Prepared(train, validation), train.only_tests
    least = LEAST if tests else LEAST_SAMPLES  # a test tells as much as many samples
    if validation is None and len(train) == 1 and train[0].n_samples >= 2.5 * least:
        ready = _parted(train[0])
    # To leave some tests out would lose what they alone tell.
    strides = [1] if tests else _strides(ready.train, ready.validation, enough)
    return ready if max(strides) == 1 else _thinned(ready, strides)


def _thinned(ready: Prepared, strides: Sequence[int]) -> Prepared:
    """The same records, of each one sample in so many."""
    pairs = [*zip([*ready.train, *(ready.validation or ())], strides, strict=True)]
    gap = max(n * part.sample_time for part, n in pairs if n > 1)
    few = min(strides) == 1
    which = "Quickly sampled records were" if few else f"One sample in {max(strides)} was"
    before = min(part.sample_time for part, _ in pairs)
    words = say("records", "thinned", which=which, gap=gap, before=before)
    thinned, count = [coarser(*pair) for pair in pairs], len(ready.train)
    train, rest = Dataset(tuple(thinned[:count])), tuple(thinned[count:])
    validation = Dataset(rest) if rest else ready.validation
    return Prepared(train, validation, (*ready.notes, words), ready.train)


def _parted(record: Record) -> Prepared:
    """A part to learn from, and one to validate on: the last, of tests drawn by lot."""
    name = record.name
    if record.independent:  # their order says nothing
        lot = np.random.default_rng(0).permutation(record.n_samples)
        count = round(LEARNT * record.n_samples)
        first = record.tests(np.sort(lot[:count]), f"{name}, drawn")
        rest = record.tests(np.sort(lot[count:]), f"{name}, the others")
        counts = {"all": record.n_samples, "some": rest.n_samples}
        words = say("records", "drawn", record=name, **counts)
    else:
        rows = np.searchsorted(record.times, record.times[0] + LEARNT * record.duration)
        first = record.window(-np.inf, record.times[rows - 1]).rename(f"{name}, first part")
        rest = record.window(record.times[rows], np.inf).rename(f"{name}, last part")
        words = say("records", "kept", record=name, duration=rest.duration, begin=rest.times[0])
    return Prepared(Dataset((first,)), Dataset((rest,)), (words,))


def coarser(record: Record, every: int) -> Record:
    """One sample in so many, with the mean of held inputs in between.

    Parameters
    ----------
    record : Record
    every : int
        Samples per new one.

    Returns
    -------
    Record
        With ``ceil(n_samples / every)`` samples; those of inputs that are joined by straight
        lines, and of outputs, are the logged ones.

    Examples
    --------
    >>> from oed_sysid.physics.channels import Channels, Input, Output
    >>> channels = Channels((Input("fin", "rad"),), (Output("q", "rad/s"),))
    >>> t = np.arange(20.0)
    >>> run = Record("dive", t, (t >= 2)[:, None].astype(float), t[:, None], channels)
    >>> print(coarser(run, 4).inputs.ravel(), coarser(run, 4).outputs.ravel())
    [0.5 1.  1.  1.  1. ] [ 0.  4.  8. 12. 16.]
    """
    kept = np.arange(0, record.n_samples, every)
    inputs = record.inputs[kept].copy()
    steps = np.diff(record.times)
    if len(steps):
        held = np.array([i.interpolation == "hold" for i in record.channels.inputs], dtype=bool)
        # The last sample is held for as long as the one before.
        lasting = np.append(steps, steps[-1])[:, None]
        area = np.add.reduceat(record.inputs * lasting, kept, axis=0)
        inputs[:, held] = (area / np.add.reduceat(lasting, kept, axis=0))[:, held]
    return record.thin(every).with_inputs(inputs)


def _strides(train: Dataset, validation: Dataset | None, enough: int) -> list[int]:
    """Largest strides that are needed and that no signal forbids, one for each record.

    All leave about the same time between samples: what was logged slowly is read as it is.
    """
    parts = [*train, *(validation or ())]
    whole = [1] * len(parts)
    least = min(record.sample_time for record in parts)

    def strides(count: int) -> list[int]:
        return [max(int(count * least / part.sample_time + 1e-9), 1) for part in parts]

    def read(count: int) -> int:
        return sum(-(-part.n_samples // n) for n, part in zip(strides(count), parts, strict=True))

    most = max(part.n_samples for part in parts)
    wanted = next((n for n in range(1, most) if read(n) <= enough), most)
    if wanted < 2:
        return whole
    noise, _ = credible_levels(train)
    allowed = np.maximum(WORTH_TELLING * noise, NEGLIGIBLE * signal_spread(train))
    for count in range(wanted, 1, -1):
        found = strides(count)
        if np.all(_bend(train, found) <= allowed):
            return found
    return whole


def _bend(dataset: Dataset, strides: Sequence[int]) -> np.ndarray:
    """Rms of what straight lines through ``stride + 1`` neighbours leave, ``(n_outputs,)``."""
    from scipy.signal import detrend  # takes half a second

    squares, count = np.zeros((2, len(dataset.channels.outputs)))
    for record, every in zip(dataset, strides, strict=False):
        width = every + 1
        rows = record.n_samples // width
        if every == 1 or not rows:
            continue
        groups = record.outputs[: rows * width].reshape(rows, width, -1)
        whole = np.isfinite(groups).all(axis=1)
        left = detrend(np.nan_to_num(groups), axis=1)
        squares += np.sum(whole * np.sum(left**2, axis=1) / max(width - 2, 1), axis=0)
        count += whole.sum(axis=0)
    return np.sqrt(squares / np.maximum(count, 1))
