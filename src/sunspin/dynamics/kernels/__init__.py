"""Compiled integration of many motions side by side (docs/model.md, "How the equations are integrated").

`flow`, `wheels` and `motions` integrate by Taylor series: states at given times, all events of wheels, torques. `split` is faster
and gives histograms of r_z only. `histogram` turns a piece of a motion into its share of the histogram, for both. `rows` names
where numbers lie. Python calls them through :mod:`sunspin.dynamics.batch`.
"""
