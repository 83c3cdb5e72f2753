"""Coverage of the paper's method on twins whose truth is known."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.estimate.scan.coverage import to_json, twins_of
from sunspin.output.folder import write_json
from sunspin.output.kinds.kind import Beside, Drawing, Summary


def coverage_summary(found: Any) -> Summary:
    """The findings in sentences, and the rows that were made of them."""
    figures = json.loads(found.attrs.get("figures", "[]"))
    numbers = {
        "title": "What the answer is worth",
        "synthetic_telemetry": True,
        "seed": int(found.attrs["seed"]),
        "confidence": float(found.attrs["confidence"]),
        "sentences": coverage_sentences(found),
        "figures": figures,
    }
    return Summary(
        numbers,
        numbers["sentences"],
        [f"  {row['what']}: {_value(row['ours'])} ({row['note']})" for row in figures],
    )


def _value(ours: Any) -> str:
    return ", ".join(f"{x:.4g}" for x in ours) if isinstance(ours, list) else f"{ours:.4g}"


def coverage_sentences(found: Any) -> list[str]:
    """The findings for readers of the report."""
    about, lines = found.attrs, twins_of(found)["lines"]
    chosen, confidence = about["factor"], about["confidence"]
    factor, threshold = (lines.threshold(confidence, relative)[0] for relative in (True, False))
    region = lines.at(factor, True)
    share = region["count"][1] / about["grid_points"]
    angles = np.degrees(lines.twin["line_angle"])
    known = angles[np.isfinite(angles)]
    turn = (
        f"the fitted lines turn by {np.median(known):.0f} degrees in the median"
        if known.size
        else "no set has four lines"
    )
    return [
        f"The method repeated on {lines.n} synthetic rebounds whose truth lies on the published lines: the truth lies in the set "
        f"within {chosen:g} times the smallest EMD in {lines.in_set(chosen)} of them, and {turn}. "
        f"For {confidence:.0%} the threshold must be {factor:.2g} times the smallest EMD (or EMD < {threshold:.3f}); the set then "
        f"holds {share:.0%} of the scanned box, and the lower bound on the angular speed after the touchdown is "
        f"{region['speed'][1]:.3f} rad/s, both in the median twin. Repeat with `{about['command']}`."
    ]


def coverage_drawings(found: Any, _: Beside) -> Iterator[Drawing]:
    from sunspin.output.figures.coverage import coverage_figure

    yield Drawing(
        "worth",
        lambda: coverage_figure(found),
        "EMD of the truth, coverage of the level set, scatter of the lines and of the lower bound over many twins",
        "What the answer is worth: the paper's method repeated on synthetic rebounds whose truth is known. Bands: 95 % sampling "
        f"error above, 5 to 95 % of the twins below. Made with `{found.attrs['command']}`.",
    )


def coverage_tables(found: Any, folder: Path, _: Beside) -> None:
    """The twins as `worth.json`, the file that comes with the case."""
    write_json(folder / "worth.json", to_json(found))
