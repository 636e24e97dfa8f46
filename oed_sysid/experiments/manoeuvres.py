"""Manoeuvres: what is commanded during an experiment, and the indices of standard tests.

Examples
--------
>>> from math import radians
>>> from oed_sysid.experiments.manoeuvres import Combined, Constant, ZigZag
>>> trial = Combined((Constant("thrust", 700.0), ZigZag("rudder", radians(10), radians(10))))
>>> trial.describe()
'thrust constant at 700; zigzag 10/10 deg of rudder, reversed on psi, positive side first, from 0 s'
"""

from oed_sysid import errors
from oed_sysid.experiments import base
from oed_sysid.experiments.base import (
    Controller,
    Excitation,
    Manoeuvre,
    OpenLoop,
    Stepwise,
    command_all,
)
from oed_sysid.experiments.indices import (
    TurningIndices,
    ZigZagIndices,
    turning_indices,
    zigzag_indices,
)
from oed_sysid.experiments.reacting import (
    Combined,
    RateLimited,
    ReverseSpiral,
    Saturated,
    Sequence,
    ZigZag,
    ZigZagLike,
)
from oed_sysid.experiments.schedules import (
    PRBS,
    Chirp,
    Constant,
    Doublet,
    FromRecord,
    Multisine,
    Piecewise,
    PullOut,
    Spiral,
    ThreeTwoOneOne,
    TurningCircle,
    maximum_length_sequence,
    schroeder_phases,
)
from oed_sysid.runtime.version import exported

__all__ = exported(globals())

_respelled = errors.respelled(
    errors.ModelError, {older: f"{newer}=..." for older, newer in base.OLDER.items()}
)
for _kind in [kind for kind in map(globals().get, __all__) if isinstance(kind, type)]:
    if issubclass(_kind, base.Timed):
        _kind.__init__ = _respelled(_kind.__init__)  # type: ignore[method-assign]
