"""Every motion that panel readings allow, with its probability.

`estimate` is the way through: `data` and `model` pose the question, `likelihood` weighs an answer, `cells` give starts, `fit`
settles them, `modes` follows them over growing windows, `importance` draws (`turns`: those of the panels; `tags`: with time tags
that are off), `check` compares with replicated readings, `verdict` says it in words. `predict` and `motion` run the draws to other
times.
"""
