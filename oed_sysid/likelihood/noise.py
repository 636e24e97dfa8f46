r"""What disturbs a vehicle and its sensors.

A record is the output of

.. math::
    \dot x = f(x, u, p) + G(x)\, w, \qquad y_k = h(x_k, p) + c_k + v_k

with first-order Gauss-Markov disturbances ``w`` (level :math:`\sigma_j`, time :math:`\tau_j`),
coloured errors ``c`` and white errors ``v`` of the sensors.

=============================== ===========================================================
module                          question
=============================== ===========================================================
``model``                       which levels and times there are: :class:`~.model.NoiseModel`
``levels``                      which of them are unknown, as what: :class:`~.levels.Levels`
``realisation``                 what a sea does to one simulated record
``disturbances``                at which places of the chain something may act
``smoother``                    residual forces: disturbances given the whole record
=============================== ===========================================================

Parameters and their errors come from the filtered path (:mod:`oed_sysid.likelihood.filtered`):
regressors along a smoothed path hold the noise.
"""
