"""Random forces and imperfect sensors: are intervals honest, and errors as small as they can be?

Many simulated data sets go through ``MultipleShooting(disturbances="auto")`` by the public API;
what it states is held against the truth, and against a full extended-Kalman maximum likelihood
that was written for this purpose and shares no code with the package.

**Truth** (:mod:`~benchmarks.random_forces.simulator`). Vehicles, manoeuvres and
:data:`~benchmarks.random_forces.scenarios.SCENARIOS` stand in ``scenarios.toml``. Zigzags turn on
the *measured* angle: the forces move the reversals, so a fit that takes what they do for sensor
noise is biased, not only inefficient (``medium_clock`` shows the difference).

**Fit** (:mod:`~benchmarks.random_forces.trial`). All derivatives are free, without priors, and
start at the believed values.

**Reference** (:mod:`~benchmarks.random_forces.reference`). It starts at the truth; a noisy log of
the fin it knows for one, rudder zeros it always has. Its results are kept in
``benchmarks/results``, one line a data set with a fingerprint of the data.

**Aimed at** are coverage and prediction of 93 to 97 % (90 to 97 % for large forces, the unstable
vehicle and weak trials), errors up to 1.1 times the reference's, no more than 5 % false warnings,
and with wrong sensors a warning in 95 % of the runs. A data set counts once in every Monte-Carlo
error: its parameters are correlated.

::

    export OMP_NUM_THREADS=1
    python -m benchmarks.random_forces.reference               # what is missing (gcc; minutes)
    python -m benchmarks.random_forces tiny small --sets 200
"""
