"""Attitudes of `sunspin rates`, which are known at the samples only, on even times between them."""

from __future__ import annotations

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.environment.frames import J2000

MOST_PASSES = 12
"""The longest passes are shown."""

TURN = 0.1
"""rad between instants at the fastest rate."""

MOST_INSTANTS = 6000


def dense(rates: xr.Dataset) -> list[tuple[str, xr.Dataset]]:
    """Each pass as a Dataset like that of `propagate`, without momentum: (title, data).

    Between two samples the body is carried on from the first and back from the second, each at the rate found there, and the
    two are blended: exact where the rate is constant, and continuous where it is not.
    """
    pass_of = rates["pass_of"].values
    lengths = {int(k): float(np.ptp(rates["time"].values[pass_of == k])) for k in np.unique(pass_of)}
    chosen = sorted(sorted(lengths, key=lambda k: -lengths[k])[:MOST_PASSES])
    found = []
    for k in chosen:
        part = rates.isel(time=np.flatnonzero(pass_of == k))
        if part.sizes["time"] >= 2:
            found.append((f"Pass {k + 1}", _dense(part, rates)))
    return found


def _dense(part: xr.Dataset, rates: xr.Dataset) -> xr.Dataset:
    t, omega = part["time"].values, part["omega_B"].values
    fastest = max(float(np.linalg.norm(omega, axis=1).max()), 1e-6)
    step = min(TURN / fastest, float(np.ptp(t)) / 50)
    count = min(int(np.ptp(t) / step) + 1, MOST_INSTANTS)
    when = t[0] + step * np.arange(count)
    i = np.clip(np.searchsorted(t, when, side="right") - 1, 0, t.size - 2)
    ahead, behind = (when - t[i])[:, None], (when - t[i + 1])[:, None]
    known = Rotation.from_quat(part["B_from_N"].values)
    first = Rotation.from_rotvec(-omega[i] * ahead) * known[i]
    second = Rotation.from_rotvec(-omega[i + 1] * behind) * known[i + 1]
    share = ahead / (t[i + 1] - t[i])[:, None]
    attitude = Rotation.from_rotvec(share * (second * first.inv()).as_rotvec()) * first
    to_sun = known[0].inv().apply(part["sun_B"].values[0])
    about = f"the likeliest motion of {t.size} samples; between samples carried on at the rates found there"
    if rates.attrs.get("frame_N") != J2000:
        about += ", and the turn about the line to the Sun at its start is arbitrary"
    return xr.Dataset(
        {
            "omega_B": (("time", "axis"), (1 - share) * omega[i] + share * omega[i + 1]),
            "B_from_N": (("time", "quaternion"), attitude.as_quat()),
            "sun_B": (("time", "axis"), attitude.apply(to_sun)),
        },
        coords={"time": when},
        attrs={
            "epoch_utc": str(rates.attrs.get("epoch_utc", "")),
            "about": about,
        },
    )
