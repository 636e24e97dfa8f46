"""Problems: one folder for each system, shipped or the user's own.

:func:`load_problem` finds a shipped problem by name or any folder by path;
:func:`new_problem` writes a folder to begin with.
"""

from oed_sysid.experiments.catalogue import catalogue_folder, list_problems, load_problem
from oed_sysid.experiments.definition import Problem
from oed_sysid.experiments.starter import new_problem
from oed_sysid.runtime.version import exported

__all__ = exported(globals())
