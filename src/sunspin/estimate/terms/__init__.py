"""What motions are compared with: one sensor or one common error a file, each a :class:`sunspin.estimate.terms.term.Term`.

`term` says what one can be asked; `sensors` lists those that telemetry may have.
"""
