"""The orbit that a result rests on, or that was refused: its elements, and what the telemetry says of them."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.report.read import Results
from sunspin.output.report.section import Section, Table

DEGREE = float(np.degrees(1.0))

VERDICTS = {
    "fits": "they fit the telemetry",
    "refused": "they do not fit the telemetry",
    "undecided": "the telemetry cannot tell",
}


def section(results: Results) -> Section | None:
    """The entry `orbit` of a summary as a table."""
    found = results.summary.get("orbit")
    if not isinstance(found, dict):
        return None
    rows = [[what, str(text)] for what, text in _rows(found) if text]
    used = (
        "The orbit is used."
        if found.get("used") is True
        else "The orbit is NOT USED: the results are those without it."
    )
    return Section("orbit", "The orbit", [used], [Table(["", ""], rows)])


def _rows(found: dict[str, Any]) -> list[tuple[str, str | bool]]:
    age = _number(found, "age_days", "{:.1f}")
    shift, sigma = _number(found, "shift_s", "{:+z.0f}"), _number(found, "shift_sigma_s", "{:.0f}")
    drift, drift_sigma = (
        _number(found, "drift_s_day", "{:+z.1f}"),
        _number(found, "drift_sigma_s_day", "{:.1f}"),
    )
    better, copies = _number(found, "better_copies", "{:.0f}"), _number(found, "copies", "{:.0f}")
    turn, times = (
        _number(found, "node_turn_rad", "{:+z.0f}", DEGREE),
        _number(found, "node_turn_times", "{:.2f}"),
    )
    shadow, seen = (
        _number(found, "in_shadow", "{:.0f}"),
        _number(found, "in_shadow_with_sun", "{:.0f}"),
    )
    field = _number(found, "field_residual_T", "{:.2f} uT", 1e6)
    angle = _number(found, "sun_field_residual_rad", "{:.1f} deg", DEGREE)
    hours, samples = _number(found, "clock_behind_s", "{:+z.0f}", 1 / 3600), found.get("samples")
    compared = (
        ", ".join(f"{what} of {n}" for what, n in samples.items())
        if isinstance(samples, dict)
        else ""
    )
    notes = found.get("notes")
    return [
        (
            "elements of",
            " ".join(str(found[key]) for key in ("name", "satellite") if found.get(key)),
        ),
        ("epoch of the elements", str(found.get("epoch_utc", ""))),
        ("age in the middle of the telemetry", age and f"{age} days"),
        ("verdict", VERDICTS.get(str(found.get("verdict")), "")),
        (
            "copies with node and phase turned at random that predict better",
            better and copies and f"{better} of {copies}",
        ),
        (
            "residuals with another plane",
            turn and times not in ("", "1.00") and f"{times} times smaller, node {turn} deg on",
        ),
        (
            "ahead of the elements along the track",
            shift and f"{shift} s, sigma {sigma or 'not known'} s",
        ),
        ("change of that in a day", drift and f"{drift} s, sigma {drift_sigma or 'not known'} s"),
        (
            "clock behind UTC with which the elements would fit",
            "" if hours in ("", "+0", "-0") else f"{hours} h",
        ),
        (
            "magnetometer",
            "reads the field with the opposite sign" if found.get("sign_turned") is True else "",
        ),
        ("median residual of the field's strength", field),
        ("median residual of its angle to the Sun", angle),
        (
            "samples in the Earth's shadow",
            shadow and shadow != "0" and f"{shadow}, of which {seen or 'none'} show a Sun",
        ),
        ("samples compared", compared),
        ("beside", "; ".join(map(str, notes)) if isinstance(notes, list) else ""),
    ]


def _number(found: dict[str, Any], key: str, form: str, unit: float = 1.0) -> str:
    """A number of the summary in words, nothing where there is none."""
    value = found.get(key)
    known = isinstance(value, int | float) and not isinstance(value, bool) and np.isfinite(value)
    return form.format(unit * value) if known else ""
