"""The directions to the Sun that a scan compares: those measured in a window of the file, and those that a simulation may count.

A simulated direction counts only where the panels would have allowed to reconstruct it (paper, section 2.3).
"""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.sun import is_reconstructed, reconstructible_patterns
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.response.planes import DirectionSet


def reconstructible_mask(vehicle: Vehicle) -> DirectionSet:
    """Return the set of Sun directions that the vehicle's panels allow to reconstruct.

    The rule of the telemetry says which sets of lit panels suffice. The response of the panels turns it into data that the
    compiled scan evaluates at every step: a short logical formula of half-spaces, or a table over the sphere.
    """
    names = vehicle.input_names
    allowed = reconstructible_patterns(vehicle)
    possible = [frozenset(pattern) for pattern in lit_patterns(vehicle)]
    good = [pattern for pattern in possible if pattern in allowed]
    bad = [pattern for pattern in possible if pattern not in allowed]
    if not good:
        raise InputError(
            f"no direction of the Sun can be reconstructed with the panels of {vehicle.name!r}",
            do="three lit panels with independent normals are needed somewhere",
        )
    lit_if_good, lit_if_bad = (
        # also if there is no pattern
        np.array([[name in pattern for name in names] for pattern in patterns], dtype=bool).reshape(
            -1, len(names)
        )
        for patterns in (good, bad)
    )
    return vehicle.response_in().direction_set(lit_if_good, lit_if_bad)


def directions_within(
    vehicle: Vehicle,
    telemetry: xr.Dataset | Assessment,
    begin_s: float | None,
    end_s: float | None,
) -> xr.Dataset:
    """Return the directions `sun_B (time, axis)` measured from `begin_s` to `end_s` (s of the file's clock; None: no bound).

    Samples without a direction are left out. `time` (s) is counted from the first direction.

    Raises
    ------
    InputError
        Fewer than two samples of the window give a direction.
    """
    assessment = assess(vehicle, telemetry)
    sun = assessment.sun
    time = sun["time"].values
    low, high = -np.inf if begin_s is None else begin_s, np.inf if end_s is None else end_s
    in_window = (time >= low) & (time <= high)
    use = is_reconstructed(sun["status"]) & in_window
    if use.sum() < 2:
        raise InputError(
            "fewer than two samples in this window give a direction of the Sun",
            got=f"{int(use.sum())} of {int(in_window.sum())} samples",
            do="widen --from and --to; `sunspin sun` says why samples give none",
            where=str(assessment.telemetry.attrs.get("file", "")),
        )
    track = sun[["sun_B"]].isel(time=np.flatnonzero(use))
    return track.assign_coords(time=track["time"] - track["time"].values[0])


def target_weights(rule: str, t_s: np.ndarray) -> np.ndarray | None:
    """Return the weights (n) in the measured distribution of directions at the times t_s (n), s.

    `rule` "equal": None, all weigh the same; "interval": half the interval to the previous sample and half that to the next.
    """
    if rule == "equal" or len(t_s) < 2:
        return None
    edges = np.concatenate([t_s[:1], (t_s[1:] + t_s[:-1]) / 2, t_s[-1:]])
    return np.diff(edges)
