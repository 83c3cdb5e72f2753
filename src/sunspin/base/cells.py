"""CSV cells that every reader interprets alike, with or without support for quotation marks."""

from __future__ import annotations

from typing import Any

UNQUOTED = {",": ";", "#": "No.", '"': "'", "\n": " ", "\r": " "}
"""Replacements for characters that `numpy.genfromtxt`, which ignores quotation marks, would take for CSV syntax."""


def plain_cell(cell: Any) -> Any:
    """Return a cell in which a text has no character with a meaning in CSV; other values are returned unchanged."""
    if isinstance(cell, str):
        for mark, text in UNQUOTED.items():
            cell = cell.replace(mark, text)
        # control characters and other ends of lines, of which a text from a radio may be full
        cell = "".join(mark if mark.isprintable() else " " for mark in cell)
    return cell
