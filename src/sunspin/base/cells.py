"""Cells of CSV files that every reader takes for the same cells."""

from __future__ import annotations

from typing import Any

UNQUOTED = {",": ";", "#": "No.", '"': "'", "\n": " ", "\r": " "}
"""What stands in a text for a character that `numpy.genfromtxt`, which knows no quotation marks, would take for a mark."""


def plain_cell(cell: Any) -> Any:
    """Return a cell, a text without the marks of a CSV file."""
    if isinstance(cell, str):
        for mark, text in UNQUOTED.items():
            cell = cell.replace(mark, text)
    return cell
