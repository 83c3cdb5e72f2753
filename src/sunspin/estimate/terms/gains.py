"""Errors of the panels' gains that all samples of a pass share."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.estimate.terms.term import Unknown
from sunspin.vehicle import Vehicle

MOST_SIGMAS = 4.0
"""No trial gain is further from that of the vehicle's file than this, in its sigmas."""


def errors(vehicle: Vehicle, quality: xr.Dataset) -> np.ndarray:
    """One sigma (m, n_panel) of each independent error of the factors on the vehicle's gains, estimated or as its file has them."""
    return np.linalg.cholesky(quality["gain_cov"].values).T / vehicle.input_gains


def unknowns(free: np.ndarray) -> tuple[Unknown, ...]:
    """Those that are estimated (m, n_panel)."""
    sizes = np.linalg.norm(free, axis=1)
    return tuple(
        Unknown(f"gain_{i}", "gain", "1", 0.0, float(size), i, limit=MOST_SIGMAS)
        for i, size in enumerate(sizes)
    )
