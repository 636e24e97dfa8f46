r"""The engine under the estimators: one set of unknowns, one likelihood.

.. math::
    -2 \log L(p, x_0, \eta) = \sum_k \frac{e_k^2}{S_k} + \log S_k + \text{priors}

over innovations ``e`` of variance ``S``. Unknown are parameters ``p`` (shared, or of each record),
start states :math:`x_0`, and levels and times :math:`\eta` of the noise (``unknowns``). White
sensors alone make ``S`` constant: condensed multiple shooting (``shooting``).
Disturbance forces make it that of an extended Kalman filter (``filtered``, ``random_forces``). One
search serves both (``gauss_newton``): damped Gauss-Newton steps within bounds

.. math::
    \min_{\ell \le \delta \le u} \tfrac12 \delta' (H + \Lambda) \delta - b' \delta

on cheap derivatives first (sums of products; frozen gain), then on exact ones.

=============================== ===========================================================
module                          subject
=============================== ===========================================================
``unknowns``                    layout, bounds, priors, scales
``start_guess``                 where to begin: measurements, kinematics
``windows``                     windows with free start states: globalisation, horizons
``shooting``                    white sensors: nodes, condensed derivatives, losses
``captive``                     forces measured at given motion, in the same likelihood
``filtered``, ``random_forces`` process noise and autocorrelated sensors: filter, levels
``score_test``                  whether process noise acts at all; scores of what is absent
``sea_search``, ``noise_parts`` whether that is a sea; other parts of a noise model, one search
``gauss_newton``                direction, step control, convergence: the one solver
``multiple_shooting``           from records to a fit: the estimator
``covariance``, ``summary``     what the end says about errors, as a :class:`~.fit.Fit`
``between_records``             errors from what records say apart, and whether they agree
``noise_levels``                high-frequency noise, and spikes
``departures``                  delays, starts of actuators, signs and noise of inputs
``judgement``                   what a fit says against itself
``prediction``                  other records, with bands
``multistart``                  several starts, and profiles of the likelihood
``archive``                     fits as files
=============================== ===========================================================
"""
