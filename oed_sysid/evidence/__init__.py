r"""After data: where a model fails, which effect it lacks, and what is left.

One rule claims (:mod:`oed_sysid.evidence.claim`): the likelihood-ratio statistic of the training
records plus that of the prediction of the validation records exceeds one threshold, whole
validation runs are no worse, and no size is held
back by a bound. What remains has a kind and a size: noise
of the sensors, disturbance forces, or structure.

=============================== ===========================================================
module                          question
=============================== ===========================================================
``compare``                     how far are models from records: where and when
``frequency``                   over which band of frequencies they hold
``preparation``                 what a search reads of the records
``study``                       what stays the same while models are compared
``locate``                      at which place of the chain does it fail
``score``, ``rank``             which effect would explain it
``propose``                     which term would, if no known effect does
``claim``                       is it claimed, and why
``search``                      what is asked, added, asked again, a term of no vocabulary, too
``improve``, ``improvement``    the whole call, and its result
``usual``                       candidates where nobody named any
``remainder``                   what is left
=============================== ===========================================================
"""
