r"""Several inputs at once: multisines that share no line, with phases that keep peaks low.

.. math:: u_j(t) = \sum_{k \in K_j} a_{jk} \cos(2\pi k t/T + \varphi_{jk}), \qquad
    K_i \cap K_j = \emptyset

Over one period ``T`` signals with disjoint lines are orthogonal, also delayed against each other,
so that the answers to rudder and propeller can be told apart although both move at the same time
(Morelli 2012, *Flight test maneuvers for efficient aerodynamic modeling*, J. Aircraft 49). Phases
begin as Schroeder's; the signal is clipped, and the phases of what is left are taken, over and
over (van der Ouderaa, Schoukens & Renneboog 1988, IEEE Trans. Instrum. Meas. 37): the peak factor

.. math:: \mathrm{PF} = \frac{\max u - \min u}{2 \sqrt 2\, \mathrm{rms}(u)}

of one sine is one, that of Schroeder's phases for the lines of several inputs often 1.3 to 2.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from oed_sysid.errors import ModelError
from oed_sysid.experiments.checks import FloatArray
from oed_sysid.experiments.sines import Multisine, schroeder_phases

_SWEEPS = 400
_OVERSAMPLING = 16
# Clipping begins here, as a share of the peak, and ends at the peak itself.
_FIRST_CLIP = 0.75


def orthogonal_multisines(
    peaks: Mapping[str, float],
    *,
    period: float,
    lowest: float,
    highest: float,
    spectra: Mapping[str, Callable[[FloatArray], FloatArray]] | None = None,
    start: float = 0.0,
    neutral: Mapping[str, float] | None = None,
) -> tuple[Multisine, ...]:
    """Return one multisine for each input, on lines that no other has.

    Parameters
    ----------
    peaks : mapping of str to float
        Largest departure from neutral by input, in its unit.
    period : float
        Common period [s]; lines are multiples of its inverse.
    lowest, highest : float
        Band [Hz].
    spectra : mapping of str to callable, optional
        Relative amplitude over frequency [Hz] by input; flat by default.
    start : float
        Time at which all begin [s].
    neutral : mapping of str to float, optional
        Command about which each swings.

    Returns
    -------
    tuple of Multisine
        In the order of ``peaks``; give them to one experiment together.

    Raises
    ------
    ModelError
        If the band holds fewer than two lines for each input.

    Examples
    --------
    >>> rudder, propeller = orthogonal_multisines(
    ...     {"rudder": 0.2, "propeller": 1.0}, period=100.0, lowest=0.01, highest=0.2
    ... )
    >>> set(rudder.frequencies) & set(propeller.frequencies)
    set()
    >>> round(peak_factor(rudder), 2), round(peak_factor(propeller), 2)
    (1.02, 1.07)
    """
    if not peaks or not (np.isfinite(period) and period > 0) or not 0 < lowest < highest:
        raise ModelError(
            f"Orthogonal multisines of {', '.join(peaks) or 'no input'} with period {period} s and "
            f"band {lowest} to {highest} Hz. Give inputs with peaks, a period and a rising band."
        )
    for given in (spectra, neutral):
        if unknown := [name for name in given or {} if name not in peaks]:
            raise ModelError(f"{unknown[0]!r} has no peak. Inputs are {', '.join(peaks)}.")
    first = int(np.ceil(lowest * period - 1e-9))
    last = int(np.floor(highest * period + 1e-9))
    lines = np.arange(max(first, 1), last + 1)
    if len(lines) < 2 * len(peaks):
        raise ModelError(
            f"The band {lowest:g} to {highest:g} Hz holds {len(lines)} lines of period "
            f"{period:g} s for {len(peaks)} inputs. Give a longer period or a wider band: two "
            "lines each."
        )
    found = []
    for position, (name, peak) in enumerate(peaks.items()):
        own = lines[position :: len(peaks)]
        frequencies = own / period
        amplitudes = np.ones(len(own))
        if spectra is not None and name in spectra:
            amplitudes = np.asarray(spectra[name](frequencies), dtype=float)
        found.append(
            Multisine(
                name, frequencies.tolist(), amplitudes=amplitudes.tolist(),
                phases=low_peak_phases(own, amplitudes).tolist(), peak=peak, start=start,
                neutral=(neutral or {}).get(name, 0.0),
            )
        )  # fmt: skip
    return tuple(found)


def low_peak_phases(lines: np.ndarray, amplitudes: np.ndarray) -> FloatArray:
    """Return phases [rad] that give a sum of cosines a low peak.

    Parameters
    ----------
    lines : ndarray of int (n,)
        Multiples of the base frequency.
    amplitudes : ndarray (n,)

    Returns
    -------
    ndarray (n,)
    """
    n = _OVERSAMPLING * int(lines.max())
    phases = schroeder_phases(amplitudes.tolist())
    best, best_peak = phases, np.inf
    for sweep in range(_SWEEPS):
        spectrum = np.zeros(n // 2 + 1, dtype=complex)
        spectrum[lines] = 0.5 * n * amplitudes * np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, n)
        peak = float(np.abs(signal).max())
        if peak < best_peak:
            best, best_peak = phases, peak
        share = _FIRST_CLIP + (1 - _FIRST_CLIP) * sweep / _SWEEPS
        clipped = np.clip(signal, -share * peak, share * peak)
        phases = np.angle(np.fft.rfft(clipped)[lines])
    found: FloatArray = best
    return found


def peak_factor(signal: Multisine) -> float:
    """Half the range of a periodic multisine over that of a sine of equal power."""
    if signal.period is None:
        raise ModelError("The multisine has no period, so its peak factor is not known.")
    n = 64 * round(signal.period * signal.frequencies[-1])
    values = signal._sum(np.arange(n) * signal.period / n)
    return float(np.ptp(values) / (2 * np.sqrt(2) * np.sqrt(np.mean(values**2))))
