r"""The engine under the estimators: one set of unknowns, one likelihood.

.. math::
    -2 \log L(p, x_0, \eta) = \sum_k \frac{e_k^2}{S_k} + \log S_k + \text{priors}

over innovations ``e`` of variance ``S``. Unknown are parameters ``p`` (shared, or of each record),
start states :math:`x_0`, and levels and times :math:`\eta` of the noise (``unknowns``). White
sensors alone make ``S`` constant: condensed multiple shooting (``shooting``, ``iterates``).
Random forces make it that of an extended Kalman filter (``filtered``, ``random_forces``). One
search serves both (``gauss_newton``): damped Gauss-Newton steps within bounds

.. math::
    \min_{\ell \le \delta \le u} \tfrac12 \delta' (H + \Lambda) \delta - b' \delta

on cheap derivatives first (sums of products; frozen gain), then on exact ones.

=============================== ===========================================================
module                          subject
=============================== ===========================================================
``unknowns``                    layout, bounds, priors, scales
``start_guess``, ``beginning``  where to begin: measurements, kinematics, an earlier fit
``free_nodes``                  the wide way in: short intervals, all starts free
``shooting``, ``iterates``      white sensors: nodes, condensed derivatives
``horizons``                    predictions a short time ahead, start states eliminated
``captive``                     forces measured at given motion, in the same likelihood
``filtered``, ``random_forces`` random forces and coloured sensors: filter, levels, tests
``gauss_newton``                the search
``covariance``, ``summary``     what the end says about errors, as a :class:`~.fit.Fit`
``narrow_band``                 errors where innovations swing with a period, as in a swell
``between_records``             errors from what records say apart from one another
``agreement``                   whether records and priors can all be right about one model
``prediction``                  other records, with bands
``archive``                     fits as files
=============================== ===========================================================
"""
