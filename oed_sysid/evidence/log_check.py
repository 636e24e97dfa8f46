r"""Compatibility of logs: what signals say about each other, before any model of forces.

In flight test this is called data compatibility or flight-path reconstruction (Klein & Morelli
2006, Aircraft System Identification, chapter 10; Jategaonkar 2015, Flight Vehicle System
Identification, chapter 10). Kinematics relate measured signals whatever the forces are,

.. math:: \dot y = f(s_1, s_2, \dots):

heading and yaw rate; positions, heading and velocities; depth, pitch and speeds; attitudes and
rates. If they do not hold, a sensor, a unit, a sign or a clock is wrong, and no model can be
right. The check goes from what is obvious to what is subtle, and each step undoes what it found
before the next one looks:

0. single signals: spikes, steps, drop-outs, frozen, cut-off, dead, held or coarse signals, gaps,
   copies (:mod:`~oed_sysid.evidence.screens`);
1. faults that are there or not: sign, unit, swapped columns, axes of the velocities
   (:mod:`~oed_sysid.evidence.discrete`);
2. faults with a size: bias, scale, delay, lever arm, misalignment, drift
   (:mod:`~oed_sysid.evidence.continuous`, on the residuals of
   :mod:`~oed_sysid.evidence.blocks` with the noise of
   :mod:`~oed_sysid.evidence.colour`);
3. equations that fail although all of this is undone
   (:mod:`~oed_sysid.evidence.unexplained`);
4. signs and units of inputs, against the nominal model and its priors
   (:mod:`~oed_sysid.evidence.inputs`).

The equations come from the model's own text, or follow from standard names of signals
(:mod:`~oed_sysid.evidence.relations`).
"""

from oed_sysid.evidence.check import check, quick_check, signal_check
from oed_sysid.evidence.copies import corrected_copies, why_not_more
from oed_sysid.evidence.result import Balance, Correction, Finding, LogCheck

__all__ = [
    "Balance",
    "Correction",
    "Finding",
    "LogCheck",
    "check",
    "corrected_copies",
    "quick_check",
    "signal_check",
    "why_not_more",
]
