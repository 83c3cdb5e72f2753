"""What a calibration of sensors found: a line a key of the vehicle file, and a table of all numbers."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from sunspin.output.kind import Summary, Table

COLUMNS = (
    "key",
    "component",
    "stated",
    "value",
    "sigma",
    "prior_sigma",
    "unit",
    "samples",
    "determined",
    "written",
    "moved",
)


def calibration_summary(found: Any) -> Summary:
    """The keys that were found, those that moved first, and those that the telemetry does not determine."""
    names = list(dict.fromkeys(found["key"].values.tolist()))
    rows = [_of_key(found, name) for name in names]
    written, left = (
        [row for row in rows if row["written"]],
        [row for row in rows if not row["written"]],
    )
    moved = sum(row["moved"] for row in written)
    lines = [
        f"{len(written)} keys of the vehicle file are determined; {moved} of them move by more than their sigma"
    ]
    lines = lines if written else ["No key of the vehicle file is determined by this telemetry"]
    lines += [f"  {row['text']}" for row in sorted(written, key=lambda row: not row["moved"])]
    if left:
        names = ", ".join(row["key"] for row in left)
        lines.append(
            f"Not determined (sigma not below half of what it was before), and left as they are: {names}"
        )
    of_each = ("stated", "value", "sigma", "written", "moved")
    numbers: dict[str, Any] = {
        "keys": {row["key"]: {name: row[name] for name in of_each} for row in rows}
    }
    if "field_residual_after_T" in found.attrs:
        was, now = (1e6 * found.attrs[f"field_residual_{when}_T"] for when in ("before", "after"))
        lines.append(
            f"Residuals in the middle: of the field's strength {was:.2f} uT before, {now:.2f} uT after"
        )
        was, now = (
            np.degrees(found.attrs[f"sun_field_residual_{when}_rad"])
            for when in ("before", "after")
        )
        if np.isfinite(now):
            lines[-1] += f"; of its angle to the Sun {was:.1f} deg before, {now:.1f} deg after"
        names = ("shift_s", "shift_sigma_s", "drift_s_day", "drift_sigma_s_day")
        shift, sigma, drift, drift_sigma = (found.attrs[name] for name in names)
        each_day = f"drifting by {drift:+z.1f} +- {drift_sigma:.1f} s a day"
        lines.append(
            f"Shift along the track {shift:+z.1f} +- {sigma:.1f} s in the middle of the file, {each_day}"
        )
        about = (
            *names,
            "field_residual_before_T",
            "field_residual_after_T",
            "sun_field_residual_before_rad",
            "sun_field_residual_after_rad",
            "field_noise_T",
        )
        numbers |= {name: float(found.attrs[name]) for name in about}
    notes = [note for note in str(found.attrs["notes"]).split("\n") if note]
    numbers |= {"source": found.attrs["source"], "notes": notes}
    return Summary(numbers, lines, [note[0].upper() + note[1:] for note in notes])


def _of_key(found: Any, name: str) -> dict[str, Any]:
    part = found.isel(quantity=np.flatnonzero(found["key"].values == name))
    stated, value, sigma = (part[key].values for key in ("stated", "value", "sigma"))
    moved = bool(part["moved"].values.any())
    texts = [f"{v:.{_digits(v, s)}g} +- {s:.2g}" for v, s in zip(value, sigma, strict=True)]
    text = texts[0] if len(texts) == 1 else f"[{', '.join(texts)}]"
    was = ", ".join("-" if np.isnan(one) else f"{one:.4g}" for one in stated)
    unit = str(part["unit"].values[0])
    text = f"{'moved ' if moved else '      '}{name} = {text}{'' if unit == '1' else ' ' + unit} (was {was})"
    return {
        "key": name,
        "stated": stated.tolist(),
        "value": value.tolist(),
        "sigma": sigma.tolist(),
        "moved": moved,
        "written": bool(part["written"].values.all()),
        "text": text,
    }


def _digits(value: float, sigma: float) -> int:
    """Significant digits of a value, down to the second of its sigma."""
    if not (sigma > 0 and value):
        return 4
    return int(np.clip(np.floor(np.log10(abs(value))) - np.floor(np.log10(sigma)) + 2, 2, 8))


def calibration_tables(found: Any) -> Iterator[Table]:
    import pandas as pd

    shown = {name: name.replace("_", " ") for name in COLUMNS[:8]}
    frame = pd.DataFrame({name: found[name].values for name in COLUMNS})
    yield Table("calibration", frame, "Keys of the vehicle file", shown)
