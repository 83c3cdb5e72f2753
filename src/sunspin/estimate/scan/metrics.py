"""Distances between a simulated and a measured track of Sun directions: E (paper, eq. 12), and EMD of z components (eq. 13)."""

from __future__ import annotations

from typing import Any, overload

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError

Z_TOLERANCE = 1e-3
"""A z component may exceed 1 by this much, because directions are published with few digits."""


@overload
def direction_error(sun_sim: xr.Dataset, sun_meas: xr.Dataset) -> float: ...
@overload
def direction_error(
    sun_sim: npt.ArrayLike | xr.Dataset, sun_meas: npt.ArrayLike | xr.Dataset
) -> Any: ...
def direction_error(
    sun_sim: npt.ArrayLike | xr.Dataset, sun_meas: npt.ArrayLike | xr.Dataset
) -> Any:
    """Return E, the mean of (1 - r.n) / 2 over the samples: 0 for a perfect fit, 1 for opposite directions (paper, eq. 12).

    Parameters
    ----------
    sun_sim, sun_meas : (..., n_time, 3) or Datasets with `sun_B`
        Unit vectors r and n in body axes at the same times. Samples with NaN in `sun_meas` (not reconstructible) are left out.

    Returns
    -------
    float, or an array over the leading axes.
    """
    sim, meas = _track(sun_sim, "sun_sim"), _track(sun_meas, "sun_meas")
    if sim.shape[-2] != meas.shape[-2]:
        raise InputError(
            "both tracks must have the same samples", got=f"{sim.shape[-2]} and {meas.shape[-2]}"
        )
    known = np.all(np.isfinite(meas), axis=-1)
    if not np.all(np.any(known, axis=-1)):
        raise InputError("the measured track holds no direction to compare with")
    product = np.einsum("...i,...i->...", sim, np.where(known[..., None], meas, 0.0))
    # zero also where only the simulated direction is NaN
    cosine = np.where(known, product, 0.0)
    count = np.broadcast_to(known, cosine.shape).sum(axis=-1)
    error = (1.0 - cosine.sum(axis=-1) / count) / 2
    return float(error) if np.ndim(error) == 0 else error


def _track(track: Any, name: str) -> np.ndarray:
    """Return a track as an array (..., n_time, 3); raise `InputError` with its name if it has another shape."""
    values = track["sun_B"].transpose("time", "axis") if isinstance(track, xr.Dataset) else track
    array = np.asarray(values, dtype=np.float64)
    if array.ndim < 2 or array.shape[-1] != 3:
        raise InputError(f"{name} must have the shape (..., n_time, 3)", got=array.shape)
    return array


def emd(
    z_a: npt.ArrayLike,
    z_b: npt.ArrayLike,
    weights_a: npt.ArrayLike | None = None,
    weights_b: npt.ArrayLike | None = None,
) -> float:
    """Return the earth mover's distance (paper, eq. 13) between two samples of z: half the first Wasserstein distance, in [0, 1].

    Parameters
    ----------
    z_a, z_b : (n,), (m,)
        Values in [-1, 1].
    weights_a, weights_b : (n,), (m,), optional
        Not negative, not all zero; default equal.
    """
    from scipy.stats import wasserstein_distance

    a, b = _sample(z_a, "z_a"), _sample(z_b, "z_b")
    return 0.5 * float(
        wasserstein_distance(
            a, b, _weights(weights_a, a, "weights_a"), _weights(weights_b, b, "weights_b")
        )
    )


def _sample(z: npt.ArrayLike, name: str) -> np.ndarray:
    """Return z components as an array (n); raise `InputError` if there are none or one lies outside [-1, 1]."""
    values = np.asarray(z, dtype=np.float64).ravel()
    if values.size == 0:
        raise InputError(f"{name} is empty", do="give at least one z component")
    if not np.all(np.abs(values) <= 1 + Z_TOLERANCE):
        raise InputError(
            f"{name} must hold z components in [-1, 1]",
            got=float(values[~(np.abs(values) <= 1)][0]),
        )
    return values


def _weights(weights: npt.ArrayLike | None, z: np.ndarray, name: str) -> np.ndarray | None:
    """Return the weights of z (n) as an array (n), None for equal ones; raise `InputError` if they cannot be weights."""
    if weights is None:
        return None
    values = np.asarray(weights, dtype=np.float64).ravel()
    valid = values.shape == z.shape and np.all(values >= 0) and np.isfinite(values).all()
    if not valid or values.sum() == 0:
        raise InputError(
            f"{name} must give one value >= 0 per z component, not all zero", got=values.shape
        )
    return values
