r"""After data: where a model fails, which effect it lacks, and what is left.

A claim needs three things: a gain :math:`2\Delta\log L` on the training records that chance
rarely gives; a gain on the validation records, judged with noise levels and start states estimated
there and the parameters' uncertainty taken along; and an error there that is finite and does not
rise. What remains has a kind and a size: noise of the sensors, disturbance forces, or structure.

=============================== ===========================================================
module                          question
=============================== ===========================================================
``compare``, ``forecasts``      how far are models from records: where, when, in which regime
``preparation``                 what a search reads of the records
``study``                       what stays the same while models are compared
``locate``                      at which place of the chain does it fail
``score``, ``rank``             which effect would explain it
``propose``, ``dictionary``     which term would, if no known effect does
``improve``, ``improvement``    the loop, and its result
``standing``, ``reconsider``    where the loop stands, and its second thoughts
``smoothers``                   which effects only smooth the noise of a logged input
``unknown_term``                when a term is taken that is in no vocabulary
``usual``, ``sizes``            candidates where nobody named any
``remainder``                   what is left
=============================== ===========================================================
"""
