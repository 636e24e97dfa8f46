"""Simulation: records of experiments, trajectories, batches, and steady states.

================================  ==================================================
:func:`simulate`                  a record of an experiment, with noise
:func:`simulate_inputs`           a trajectory for given inputs
:func:`simulate_batch`            many parameter sets or start states at once
:func:`reference_trajectory`      the same with error control, to check the step
:func:`equilibrium`               a trim condition
:func:`linearise`                 a linear state-space model around it
================================  ==================================================
"""

from oed_sysid.experiments.batch import simulate_batch
from oed_sysid.experiments.reference import reference_trajectory
from oed_sysid.experiments.run import simulate
from oed_sysid.experiments.steady import Equilibrium, equilibrium, linearise
from oed_sysid.experiments.trajectory import Trajectory, simulate_inputs
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
