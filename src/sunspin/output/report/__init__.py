"""A results folder as one HTML page that opens from disk, asks the network for nothing and can be turned by hand.

read.py reads the folder and trusts nothing in it; each module of sections (overview, measured, lander, rate_space, landing, rows,
quality, runs, other) turns what it recognises into :class:`section.Section`; page.py puts them into page.html.j2 with page.css,
page.js, lander.js and plotly's bundled script.
"""

from sunspin.output.report.page import write_report

__all__ = ["write_report"]
