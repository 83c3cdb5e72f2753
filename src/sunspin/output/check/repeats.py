"""The check for samples that repeat earlier ones: frozen stretches, copies of frames, held values."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.output.check.findings import Findings
from sunspin.output.text import clock_text, count_text
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.repeats import PANELS

FROZEN = 3
"""Number of successive repeats from which they are called a frozen stretch; fewer are copies of a frame."""

EACH_SHARE = 0.5
"""Every reading counts as repeated if there are more runs of repeats than this fraction of the distinct samples."""

NAMES = {PANELS: "panels", "sun_sensor_B": "Sun sensors", "gyro_B": "gyro"}
NAMES |= {"field_B": "magnetometer", "attitude_B_from_N": "attitude"}
"""Names of the sensors, by variable of telemetry."""

PLURAL = (PANELS, "sun_sensor_B")
"""Sensors with a plural name."""


def describe_repeats(assessment: Assessment) -> Findings:
    """Return what the check says of samples and readings that repeat earlier ones; empty if none does."""
    repeats, samples = assessment.repeats, assessment.telemetry
    summary: dict[str, Any] = {}
    lines: list[str] = []
    stretches = _stretches(repeats.frozen)  # begin and end (exclusive) of each run of repeats
    count, distinct = int(repeats.frozen.sum()), int((~repeats.frozen).sum())
    # With a run of repeats after most distinct samples, all readings are repeated. Else long runs are frozen, short ones copies.
    if len(stretches) > EACH_SHARE * distinct:
        repeats_of_each = round(float(np.mean([end - begin for begin, end in stretches])))
        summary["repeated_each"] = repeats_of_each + 1  # with the reading itself
        lines.append(
            f"  each reading is repeated {summary['repeated_each']} times: held values or copies of frames; "
            f"{count_text(count, 'repeat')} left out"
        )
    else:
        frozen = [(begin, end) for begin, end in stretches if end - begin >= FROZEN]
        copies = count - sum(end - begin for begin, end in frozen)
        time = samples["time"].values
        summary["frozen"] = [[float(time[begin]), float(time[end - 1])] for begin, end in frozen]
        for (begin, end), times in zip(frozen, summary["frozen"], strict=True):
            first, last = (clock_text(samples, time_s) for time_s in times)
            lines.append(
                f"  FROZEN from {first} to {last}: {count_text(end - begin, 'sample')} equal to earlier ones; left out, like a gap"
            )
        if copies:
            summary["copies"] = copies
            lines.append(
                f"  {count_text(copies, 'sample')} identical to an earlier one (copies of a frame); left out"
            )
    for sensor, held in repeats.held.items():
        if held.any():
            summary.setdefault("held", {})[NAMES[sensor]] = int(held.sum())
            verb = "repeat" if sensor in PLURAL else "repeats"
            lines.append(
                f"  HELD VALUES: the {NAMES[sensor]} {verb} the last reading in {count_text(int(held.sum()), 'sample')} while "
                "other sensors change; left out"
            )
    if repeats.columns is not None and repeats.columns.any():
        names = samples["panel"].values.astype(str)
        repeat_counts = {
            name: int(n) for name, n in zip(names, repeats.columns.sum(axis=0), strict=True) if n
        }
        summary["held_panels"] = repeat_counts
        panels = ", ".join(
            f"{name} in {count_text(n, 'sample')}" for name, n in repeat_counts.items()
        )
        lines.append(
            f"  HELD VALUES: panels that are read less often than the samples repeat their last reading: {panels}; left out"
        )
    if repeats.doubt:
        summary["repeats_doubtful"] = int(repeats.unsure.sum())
        lines.append(
            f"  {repeats.doubt} Too few different readings to tell; `sunspin rates` does not decide these passes"
        )
    return Findings({key: value for key, value in summary.items() if value}, lines)


def _stretches(repeated: np.ndarray) -> list[tuple[int, int]]:
    """Return begin and end (exclusive) of each run of repeated samples (n)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], repeated.astype(int), [0]])))
    return [(int(a), int(b)) for a, b in zip(edges[::2], edges[1::2], strict=True)]
