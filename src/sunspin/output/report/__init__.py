"""A results folder as one HTML page that opens from disk and asks the network for nothing.

read.py reads what the folder's manifest lists and trusts nothing in it; body.py and views.py draw the three interactive views;
rows.py compares a study with the paper; page.py fills page.html.j2.
"""

from sunspin.output.report.page import write_report

__all__ = ["write_report"]
