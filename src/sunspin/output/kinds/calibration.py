"""Results of `sunspin calibrate-sensors`: a line for each key of the vehicle file, and a table of all numbers."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from sunspin.output.kind import KINDS, Kind, Summary, Table
from sunspin.output.text import capitalize_first, number_text, with_sigma

COLUMNS = (
    *("key", "component", "stated", "value", "sigma", "prior_sigma", "unit", "samples"),
    *("determined", "written", "moved"),
)
"""Columns of the table of a calibration; the page shows the first eight."""

FIELD = (
    *("shift_s", "shift_sigma_s", "drift_s_day", "drift_sigma_s_day"),
    *("field_residual_before_T", "field_residual_after_T"),
    *("sun_field_residual_before_rad", "sun_field_residual_after_rad", "field_noise_T"),
)
"""Attributes of a calibration in a known orbit."""


def calibration_summary(result: Any) -> Summary:
    """Return the summary of a calibration: the keys that the telemetry determines, those that moved first, then the other keys.

    A key is an entry of the vehicle file with one or several components. A calibration in a known orbit also has the residuals of
    the field and the along-track offset.
    """
    keys: dict[str, dict[str, Any]] = {}
    lines_of_moved, lines_of_unmoved, not_determined = [], [], []
    for name in dict.fromkeys(result["key"].values.tolist()):
        rows = result.isel(quantity=np.flatnonzero(result["key"].values == name))
        stated, value, sigma = (rows[column].values for column in ("stated", "value", "sigma"))
        moved, written = bool(rows["moved"].values.any()), bool(rows["written"].values.all())
        keys[name] = {
            column: rows[column].values.tolist() for column in ("stated", "value", "sigma")
        }
        keys[name] |= {"written": written, "moved": moved}
        if not written:
            not_determined.append(name)
            continue
        unit = str(rows["unit"].values[0]).removeprefix("1")  # "1": a number without unit
        single = value.size == 1
        now = with_sigma(value[0], sigma[0], unit) if single else with_sigma(value, sigma, unit)
        before = ", ".join(
            "-" if np.isnan(number) else number_text(number) for number in stated.tolist()
        )
        text = f"{name} = {now} (was {before})"
        if moved:
            lines_of_moved.append(f"  moved {text}")
        else:
            lines_of_unmoved.append(f"        {text}")
    lines = ["No key of the vehicle file is determined by this telemetry"]
    if determined := [*lines_of_moved, *lines_of_unmoved]:
        count = f"{len(lines_of_moved)} of them move by more than their sigma"
        lines = [f"{len(determined)} keys of the vehicle file are determined; {count}", *determined]
    if not_determined:
        why = "sigma not below half of what it was before"
        lines.append(f"Not determined ({why}), and left as they are: {', '.join(not_determined)}")
    numbers: dict[str, Any] = {"keys": keys}
    if "field_residual_after_T" in result.attrs:
        numbers |= {name: float(result.attrs[name]) for name in FIELD}
        lines += _orbit_lines(numbers)
    notes = [note for note in str(result.attrs["notes"]).split("\n") if note]
    numbers |= {"source": result.attrs["source"], "notes": notes}
    return Summary(numbers, lines, [capitalize_first(note) for note in notes])


def _orbit_lines(numbers: Mapping[str, float]) -> list[str]:
    """Return lines on the residuals and the along-track offset of a calibration in a known orbit; `numbers`: those of `FIELD`."""
    before_uT, after_uT = (
        1e6 * numbers[f"field_residual_{when}_T"] for when in ("before", "after")
    )
    residuals = f"of the field's strength {before_uT:.2f} uT before, {after_uT:.2f} uT after"
    before_deg, after_deg = (
        np.degrees(numbers[f"sun_field_residual_{when}_rad"]) for when in ("before", "after")
    )
    if np.isfinite(after_deg):
        residuals += (
            f"; of its angle to the Sun {before_deg:.1f} deg before, {after_deg:.1f} deg after"
        )
    offset = with_sigma(numbers["shift_s"], numbers["shift_sigma_s"], "s")
    drift = with_sigma(numbers["drift_s_day"], numbers["drift_sigma_s_day"], "s")
    return [
        f"Median residuals: {residuals}",
        f"Shift along the track {offset} at mid-file, drifting by {drift} a day",
    ]


def calibration_tables(result: Any) -> Iterator[Table]:
    """Yield the table `calibration`: a row for each component of each key."""
    import pandas as pd

    headings = {name: name.replace("_", " ") for name in COLUMNS[:8]}
    frame = pd.DataFrame({name: result[name].values for name in COLUMNS})
    yield Table("calibration", frame, "Keys of the vehicle file", headings)


_calibration = "calibrate-sensors", "calibration", calibration_summary
KINDS.update(calibration=Kind(*_calibration, tables=calibration_tables))
