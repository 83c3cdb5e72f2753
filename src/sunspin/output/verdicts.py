"""Explanations of the verdicts and warnings that commands print."""

from __future__ import annotations

import re
from collections.abc import Iterable
from difflib import get_close_matches
from importlib import resources
from pathlib import Path

from sunspin.base.errors import InputError

PAGE = "docs/howto/verdicts.md"
"""Page that explains them, a section for each label."""

COMMANDS = ("rates", "posterior", "check", "sun")
"""Commands whose output is searched for verdicts and warnings."""

ANCHORS = {
    "several-solutions": (
        *("several solutions", "several motions", " aliases, ", "a line of solutions"),
        *("gives the same readings", "sign of the Sun direction is ambiguous"),
    ),
    "poor-fit": (
        *("POOR FIT", "NO SOLUTION FITS", "not explained:", "the other readings fit: look"),
        *("as no free body's does", "contradicts the other readings", "of the passes do not fit"),
    ),
    "check-the-columns": (
        "CHECK THE COLUMNS",
        "CHECK THE SIGNS",
        "columns unchecked",
        "fits only with a zero offset",
    ),
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
    "a-wheel-changed-its-speed": ("a wheel changed its speed",),
    "give-its-inertia": ("GIVE ITS INERTIA",),
    "messages-of-check": (
        *("WRONG UNIT", "WRONG AXES", "WEAK PANEL", "NOISE NOT STATED", "no signal in any sample"),
        *("GAINS NOT KNOWN", "the samples would look the same with"),
        *("impossible illumination patterns", "HELD VALUES", "FROZEN from", "held values?"),
    ),
    "orbit": (
        *("elements not consistent", "inconclusive:", "NOT USED", "cannot judge it", "NO ORBIT"),
        *("HAS THE OPPOSITE SIGN", "FIELD AND SUN DISAGREE"),
    ),
    "sun-status": (
        *("direction known only to", "ambiguous: several directions", "no panel lit"),
        *("impossible illumination pattern (", "excluded by a rule", "missing or flagged"),
    ),
}
"""Label of a section of `PAGE` -> words by which the printed lines that it explains are recognised."""


def find_labels(command: str, lines: Iterable[str]) -> list[str]:
    """Return the labels of the sections of `PAGE` that explain verdicts and warnings in printed lines.

    Only output of `COMMANDS` has any: for other commands the list is empty.
    """
    text = "\n".join(lines) if command in COMMANDS else ""
    return [label for label, words in ANCHORS.items() if any(word in text for word in words)]


def read_section(label: str) -> str:
    """Return the section of `PAGE` that a label names, as plain text.

    Raises
    ------
    InputError
        No section has this label.
    """
    if label not in ANCHORS:
        near = get_close_matches(label, ANCHORS, n=1, cutoff=0.4)
        do = f"did you mean {near[0]}?" if near else f"known: {', '.join(ANCHORS)}"
        raise InputError("no verdict or warning has this label", got=label, do=do)
    # a section begins with a line "(label)=" and a heading, and ends before the next such line
    label_line = re.escape(f"({label})=")
    match = re.search(rf"^{label_line}\n## (.+?)(?=^\([a-z-]+\)=$|\Z)", _read_page(), re.M | re.S)
    text = match[1] if match else ""
    # a link to another section becomes the label to ask for; other links keep their words
    text = re.sub(r"\[([^]]+)\]\(#([a-z-]+)\)", r"\1 (`sunspin explain \2`)", text)
    return re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", text).strip()


def _read_page() -> str:
    """Return the text of `PAGE`, which an installed package holds next to this module, and a checkout in its docs."""
    installed = resources.files("sunspin").joinpath("output", "verdicts.md")
    if installed.is_file():
        return installed.read_text("utf-8")
    return (Path(__file__).parents[3] / PAGE).read_text("utf-8")
