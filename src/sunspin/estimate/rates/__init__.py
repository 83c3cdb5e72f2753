"""Body rates and attitude of a satellite whose Sun is seen now and then.

What sensors read, and errors in common, are terms (:mod:`sunspin.estimate.terms`). `estimate` is the way through: `observe`
telemetry pass by pass, `start` and `seed` the search (`shoot` fits a start), `smooth` what it finds with the `motion` of a step and
the speeds of the `wheels`, and tell how far it may be off: `common` errors, `clock`, `spread`. `dense` carries the answer to all
samples of a pass, `link` lets neighbouring passes help, `residuals` says what does not fit, `hypotheses` leaves sensors out,
`alternatives` are other models, `wandering` counts all ways of one, `side_by_side` estimates passes in several processes, and
`rough` says meanwhile what was found first.
"""
