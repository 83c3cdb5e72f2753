"""Where the documentation explains a status or a warning that a command prints."""

from __future__ import annotations

from collections.abc import Iterable

PAGE = "docs/howto/verdicts.md"
COMMANDS = ("rates", "posterior", "check", "sun")

ANCHORS = {
    "several-solutions": (
        *("several solutions", "several motions", " aliases, ", "a line of solutions"),
        *("gives the same readings", "sign of the Sun direction is ambiguous"),
    ),
    "poor-fit": ("POOR FIT", "NO SOLUTION FITS", "not explained:", "the other readings fit: look"),
    "check-the-columns": ("CHECK THE COLUMNS", "CHECK THE SIGNS", "columns unchecked"),
    "not-constrained": ("NOT CONSTRAINED", "constrained: ", "not all rate components"),
    "upper-limit": ("speed below ",),
    "incomplete-search": (
        "SEARCH STOPPED",
        "coarse search",
        "search incomplete",
        "not every other",
    ),
    "not-sure": ("not sure:",),
    "wheel-speed-unknown": ("WHEEL SPEED UNKNOWN",),
    "give-its-inertia": ("GIVE ITS INERTIA",),
    "seem-late": ("SEEM LATE",),
    "messages-of-check": (
        *("WRONG UNIT", "WRONG AXES", "WEAK PANEL", "NOISE NOT STATED", "no signal in any sample"),
        *("impossible illumination patterns", "HELD VALUES", "FROZEN from", "held values?"),
    ),
    "orbit": (
        *("elements not consistent", "inconclusive:", "NOT USED", "cannot judge it", "NO ORBIT"),
        "HAS THE OPPOSITE SIGN",
    ),
    "sun-status": (
        *("direction known only to", "ambiguous: several directions", "no panel lit"),
        *("impossible illumination pattern (", "excluded by a rule", "missing or flagged"),
    ),
}
"""Label on `PAGE` -> words of the printed lines that it explains."""


def explained(command: str, lines: Iterable[str]) -> list[str]:
    """Labels of `PAGE` that explain the verdicts and warnings in printed lines; none where all is well."""
    text = "\n".join(lines) if command in COMMANDS else ""
    return [label for label, words in ANCHORS.items() if any(word in text for word in words)]
