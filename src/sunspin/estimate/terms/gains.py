"""Errors of the panels' gains that all samples of a pass share."""

from __future__ import annotations

import numpy as np
import xarray as xr

from sunspin.estimate.terms.term import Unknown
from sunspin.vehicle import Vehicle

MOST_SIGMAS = 4.0
"""No trial gain is further from that of the vehicle's file than this, in its sigmas."""


def errors(vehicle: Vehicle, quality: xr.Dataset) -> np.ndarray:
    """One sigma (m, n_panel, 3) of each independent error of gain times normal, estimated or as the vehicle file has them."""
    return np.linalg.cholesky(quality["gain_cov"].values).T[:, :, None] * vehicle.panel_normals_B


def unknowns(free: np.ndarray, rows: np.ndarray) -> tuple[Unknown, ...]:
    """Those that are estimated (m, n_panel, 3), of panels `rows` (n_panel, 3), relative to the gains."""
    sizes = np.linalg.norm(free, axis=(1, 2)) / max(float(np.linalg.norm(rows, axis=1).max()), 1e-300)
    return tuple(Unknown(f"gain_{i}", "gain", "1", 0.0, float(size), i, limit=MOST_SIGMAS) for i, size in enumerate(sizes))
