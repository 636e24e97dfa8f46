"""Random forces and imperfect sensors: are intervals honest, and errors as small as they can be?

Many simulated data sets go through ``MultipleShooting(disturbances="auto")`` by the public API;
what it states is held against the truth, and against a full extended-Kalman maximum likelihood
that was written for this purpose and shares no code with the package.

**Truth** (:mod:`~benchmarks.random_forces.simulator`). The diving plane of a REMUS-like AUV with
the eight derivatives of ``remus_diving_plane`` drawn 9 % about the believed ones; three records of
60 s at 0.1 s, zigzags of 5/5, 10/10 and 15/12 degrees that turn on the *measured* pitch angle: the
forces move the fin's reversals, so a fit that takes what they do for sensor noise is biased, not
only inefficient (``medium_clock`` shows the difference); white sensor noise as the problem
declares it; first-order Gauss-Markov forces on X, Z and M. *Medium* is 0.1 N, 0.3 N and 0.06 N m
with a time of 2 s. Runge-Kutta at 0.01 s (yaw: 0.1 s), forces drawn at the same step. And a ship in
yaw with a rudder zero of each record, known to the fitted model or not.
:data:`~benchmarks.random_forces.scenarios.SCENARIOS` lists all.

**Fit** (:mod:`~benchmarks.random_forces.trial`). All eight derivatives are free, without priors,
and start at the believed values.

**Reference** (:mod:`~benchmarks.random_forces.reference`). It starts at the truth; a noisy log of
the fin it knows for one, rudder zeros it always has. Its results are kept in ``reference.json``,
one line a data set with a fingerprint of the data.

**Measures**, by scenario:

coverage
    Share of 95 % intervals that hold the truth, over all parameters, with its Monte-Carlo error
    (a data set counts once: its parameters are correlated).
z
    Root mean square of error over stated standard error; 1 is honest, 100 the most that counts.
error / reference
    Root mean square over all parameters of the errors, each divided by the root mean square error
    of the reference for that parameter on the same data sets.
flagged
    Share of fits that warn: not converged, or anything in ``fit.concerns``.
prediction, from first
    Share of a fresh record of 60 s within the 95 % band of ``fit.predict``, with start states
    estimated on that record and from its first measurements.
levels
    ``fit.noise.force`` and ``force_time`` over the true ones, where the fit has them.

Targets, missed where beyond twice the Monte-Carlo error: coverage 93 to 97 % (90 to 97 % for
large forces, the unstable vehicle and weak trials), or with wrong sensors a warning in 95 % of the
runs; errors up to 1.1 times the reference's; prediction 93 to 97 %; no more than 5 % false
warnings.

**Recipe.** ::

    export OMP_NUM_THREADS=1
    python -m benchmarks.random_forces --reference             # fills reference.json (gcc; minutes)
    python -m benchmarks.random_forces                         # all scenarios, 40 sets each
    python -m benchmarks.random_forces tiny small --sets 200 --seed 0 --json out/forces.json
    python -m benchmarks.random_forces medium --disturbances none

Sets are numbered; a set is the same whatever their number, and scenarios share their random draws,
so that rows differ by what was changed. Times are processor time of ``fit`` alone.
"""
