"""Forces measured at given motion, alone and beside free-running records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oed_sysid import Dataset, Experiment, MultipleShooting, ZigZag
from oed_sysid.errors import DataError, ModelError
from oed_sysid.fitting.captive import CaptiveTests
from oed_sysid.simulate import simulate
from tests.turning_ship import turning_ship

RUDDER = np.radians([-20.0, -10.0, 0.0, 10.0, 20.0, 0.0, 0.0, 0.0, 0.0])
DRIFT = np.radians([0.0, 0.0, 0.0, 0.0, 0.0, -12.0, -6.0, 6.0, 12.0])
