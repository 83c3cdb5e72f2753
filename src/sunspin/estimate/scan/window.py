"""The directions of the Sun that a scan is held against: those of a window of the file, on a clock that starts at the first."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Vehicle


def target_weights(rule: str, t_s: np.ndarray) -> np.ndarray | None:
    """What directions at these times (n, s) count in a distribution: "equal" (all the same: None), "interval" (half their gaps)."""
    if rule == "equal" or len(t_s) < 2:
        return None
    edges = np.concatenate([t_s[:1], (t_s[1:] + t_s[:-1]) / 2, t_s[-1:]])
    return np.diff(edges)


def directions_within(
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    begin_s: float | None,
    end_s: float | None,
) -> xr.Dataset:
    """`sun_B (time, axis)` of the samples from `begin_s` to `end_s` (s of the file's clock; None: no bound) that give one.

    `time` is counted from the first of them.

    Raises
    ------
    InputError
        Fewer than two samples of the window give a direction.
    """
    assessment = assess(vehicle, telemetry)
    sun = assessment.sun
    time = sun["time"].values
    low, high = -np.inf if begin_s is None else begin_s, np.inf if end_s is None else end_s
    use = is_reconstructed(sun["status"]) & (time >= low) & (time <= high)
    if use.sum() < 2:
        raise InputError(
            "fewer than two samples in this window give a direction of the Sun",
            got=f"{int(use.sum())} of {int(((time >= low) & (time <= high)).sum())} samples",
            do="widen --from and --to; `sunspin sun` says why samples give none",
            where=str(assessment.telemetry.attrs.get("file", "")),
        )
    track = sun[["sun_B"]].isel(time=np.flatnonzero(use))
    return track.assign_coords(time=track["time"] - track["time"].values[0])
