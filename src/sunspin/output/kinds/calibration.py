"""Results of `sunspin calibrate-sensors`: a line for each key of the vehicle file, and a table of all numbers."""

from __future__ import annotations

from collections.abc import Iterator
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
    """Return the summary of a calibration: keys that the telemetry determines, first those that moved, then the other keys."""
    keys, texts = {}, []
    for name in dict.fromkeys(result["key"].values.tolist()):
        rows = result.isel(quantity=np.flatnonzero(result["key"].values == name))
        stated, value, sigma = (rows[key].values for key in ("stated", "value", "sigma"))
        moved, written = bool(rows["moved"].values.any()), bool(rows["written"].values.all())
        keys[name] = {key: rows[key].values.tolist() for key in ("stated", "value", "sigma")}
        keys[name] |= {"written": written, "moved": moved}
        unit = str(rows["unit"].values[0]).removeprefix("1")
        now = with_sigma(value[0], sigma[0], unit) if value.size == 1 else ""
        was = ", ".join(
            "-" if np.isnan(number) else number_text(number) for number in stated.tolist()
        )
        text = f"{name} = {now or with_sigma(value, sigma, unit)} (was {was})"
        texts.append((written, moved, f"  {'moved ' if moved else '      '}{text}"))
    determined = sorted(
        ((moved, text) for written, moved, text in texts if written), key=lambda row: not row[0]
    )
    lines = ["No key of the vehicle file is determined by this telemetry"]
    if determined:
        count = f"{sum(moved for moved, _ in determined)} of them move by more than their sigma"
        lines = [f"{len(determined)} keys of the vehicle file are determined; {count}"]
        lines += [text for _, text in determined]
    if left := [name for name, row in keys.items() if not row["written"]]:
        why = "sigma not below half of what it was before"
        lines.append(f"Not determined ({why}), and left as they are: {', '.join(left)}")
    numbers: dict[str, Any] = {"keys": keys}
    if "field_residual_after_T" in result.attrs:
        numbers |= {name: float(result.attrs[name]) for name in FIELD}
        was, now = (1e6 * numbers[f"field_residual_{when}_T"] for when in ("before", "after"))
        strength = f"of the field's strength {was:.2f} uT before, {now:.2f} uT after"
        lines.append(f"Median residuals: {strength}")
        angles = (numbers[f"sun_field_residual_{when}_rad"] for when in ("before", "after"))
        was, now = map(np.degrees, angles)
        if np.isfinite(now):
            lines[-1] += f"; of its angle to the Sun {was:.1f} deg before, {now:.1f} deg after"
        shift = with_sigma(numbers["shift_s"], numbers["shift_sigma_s"], "s")
        drift = with_sigma(numbers["drift_s_day"], numbers["drift_sigma_s_day"], "s")
        lines.append(f"Shift along the track {shift} at mid-file, drifting by {drift} a day")
    notes = [note for note in str(result.attrs["notes"]).split("\n") if note]
    numbers |= {"source": result.attrs["source"], "notes": notes}
    return Summary(numbers, lines, [capitalize_first(note) for note in notes])


def calibration_tables(result: Any) -> Iterator[Table]:
    """Yield the table `calibration`: a row for each number of each key."""
    import pandas as pd

    shown = {name: name.replace("_", " ") for name in COLUMNS[:8]}
    frame = pd.DataFrame({name: result[name].values for name in COLUMNS})
    yield Table("calibration", frame, "Keys of the vehicle file", shown)


_calibration = "calibrate-sensors", "calibration", calibration_summary
KINDS.update(calibration=Kind(*_calibration, tables=calibration_tables))
