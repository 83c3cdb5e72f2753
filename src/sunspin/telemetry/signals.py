"""The panel readings of a telemetry Dataset, powers or currents, as one array."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError


def signals(telemetry: xr.Dataset) -> np.ndarray:
    """Return the panel readings (n, n_panel) of a telemetry Dataset: powers in W, or currents in A.

    Raises
    ------
    InputError
        The Dataset has neither.
    """
    name = next((key for key in ("power_W", "current_A") if key in telemetry), None)
    if name is None:
        raise InputError(
            "the telemetry has no panel powers or currents",
            do="give a file with a column per panel",
        )
    return np.asarray(telemetry[name].transpose("time", "panel"), dtype=np.float64)
