"""Directions to the Sun that a scan compares: measured ones, and simulated ones from which the panels would give a direction.

A simulated direction is counted only if the panels would have allowed to reconstruct it (paper, section 2.3).
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
    """Return the set of Sun directions that can be reconstructed from the readings of the vehicle's panels.

    A direction is in it if the panels that it lights, its pattern, determine a direction (:func:`reconstructible_patterns`). The
    set is a logical formula of half-spaces, which the compiled scan evaluates at every step. `InputError` if it is empty.
    """
    names = vehicle.input_names
    reconstructible = reconstructible_patterns(vehicle)
    # all patterns that the Sun can make; the set's formula need not be right for any other one
    patterns = [frozenset(pattern) for pattern in lit_patterns(vehicle)]
    sufficient = [pattern for pattern in patterns if pattern in reconstructible]
    insufficient = [pattern for pattern in patterns if pattern not in reconstructible]
    if not sufficient:
        raise InputError(
            f"no direction of the Sun can be reconstructed with the panels of {vehicle.name!r}",
            do="three lit panels with independent normals are needed somewhere",
        )

    def as_rows(patterns: list[frozenset[str]]) -> np.ndarray:
        """Return which inputs are lit in each pattern, as booleans (n_pattern, n_input); n_pattern may be 0."""
        rows = [[name in pattern for name in names] for pattern in patterns]
        return np.array(rows, dtype=bool).reshape(-1, len(names))

    return vehicle.response_in().direction_set(as_rows(sufficient), as_rows(insufficient))


def directions_within(
    vehicle: Vehicle, telemetry: xr.Dataset | Assessment, begin_s: float | None, end_s: float | None
) -> xr.Dataset:
    """Return the directions `sun_B (time, axis)` measured from `begin_s` to `end_s` (s of the file's clock; None: no limit).

    Samples without a direction are left out. `time` (s) is counted from the first direction. Raises `InputError` if fewer than two
    samples of the window give a direction.
    """
    assessment = assess(vehicle, telemetry)
    sun = assessment.sun
    time = sun["time"].values
    in_window = np.ones(len(time), dtype=bool)
    if begin_s is not None:
        in_window &= time >= begin_s
    if end_s is not None:
        in_window &= time <= end_s
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
    """Return the weights (n) of the samples at the times t_s (n), s, in the measured distribution of directions; None: all equal.

    `rule`: "equal", or "interval": half the interval to the previous sample plus half the interval to the next one.
    """
    if rule == "equal" or len(t_s) < 2:
        return None
    edges = np.concatenate([t_s[:1], (t_s[1:] + t_s[:-1]) / 2, t_s[-1:]])
    return np.diff(edges)
