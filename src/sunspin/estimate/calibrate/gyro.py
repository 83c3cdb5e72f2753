"""Zero and scale of a gyro, from the rates of passes that were found without it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.estimate.passes import rate_known
from sunspin.vehicle.sensors import Gyro

SCALE_SIGMA = 0.2
"""Prior sigma of the scale over that stated, where the vehicle file states none."""

STUDENT, ROUNDS = 4.0, 8

FEWEST_PASSES = 3
"""With fewer passes nothing shows the errors of their rates: a torque fitted to one pass of five samples, where there was none,
made its gyro's scale 2.6 times as large as it was, with a sigma of 0.6."""


class GyroFit(NamedTuple):
    """Reading (rad/s, as stated) = `values[3]` rate + `values[:3]`, with the covariances (4, 4) by the curvature and by the scatter
    between passes, the `prior` sigmas (4), and how many samples and passes there are."""

    values: np.ndarray
    model: np.ndarray
    robust: np.ndarray
    prior: np.ndarray
    samples: int
    passes: int


def fit_gyro(gyro: Gyro, telemetry: xr.Dataset, found: xr.Dataset) -> GyroFit | None:
    """Fit to the passes of `found` (a result of `rates` without the gyro) that are decided; None where there are too few.

    The error of a pass's rate is taken as common to its samples, as smoothing leaves it, beside the noise of each reading.
    """
    times, first = np.unique(telemetry["time"].values, return_index=True)
    at = first[np.clip(np.searchsorted(times, found["time"].values), 0, len(times) - 1)]
    read = telemetry["gyro_B"].values[at]
    # a body that hardly rotates, whose speed is only an upper limit, shows the zero of a gyro as well as any
    decided = rate_known(found)[found["pass_of"].values]
    use = (
        np.isfinite(read).all(axis=1)
        & decided
        & (telemetry["time"].values[at] == found["time"].values)
    )
    if len(np.unique(found["pass_of"].values[use])) < FEWEST_PASSES:
        return None
    rate, cov, pass_of = (
        found["omega_B"].values[use],
        found["omega_cov_B"].values[use],
        found["pass_of"].values[use],
    )
    read = read[use]
    stated = np.abs(gyro.scale_rad_s * gyro.zero_sigma)
    unstated = float(np.sqrt((read**2).mean()))
    prior = np.append(
        np.where(stated > 0, stated, unstated),
        gyro.scale_sigma / abs(gyro.scale_rad_s) or SCALE_SIGMA,
    )
    value, more, covariance = np.array([0.0, 0.0, 0.0, 1.0]), 1.0, np.diag(prior**2)
    passes, scores = np.unique(pass_of), np.zeros(0)
    for _ in range(ROUNDS):
        model, right = np.diag(prior**-2.0), prior**-2.0 * [0.0, 0.0, 0.0, 1.0]
        scores, squares, count = np.zeros((len(passes), 4)), 0.0, 0
        for k, design, target in _whitened(
            read, rate, cov, [pass_of == p for p in passes], gyro.noise_rad_s, more
        ):
            left = design @ value - target
            weight = (STUDENT + len(left)) / (STUDENT + left @ left)
            model += weight * design.T @ design
            right += weight * design.T @ target
            scores[k] += weight * design.T @ left
            squares, count = squares + weight * left @ left, count + len(left)
        covariance = np.linalg.inv(model)
        value = covariance @ right
        more *= float(np.clip(np.sqrt(squares / max(count - 4, 1)), 0.5, 3.0))
    meat = scores.T @ scores * len(passes) / (len(passes) - 1) + np.diag(prior**-2.0)
    return GyroFit(
        value, covariance, covariance @ meat @ covariance, prior, int(use.sum()), len(passes)
    )


def _whitened(
    read: np.ndarray,
    rate: np.ndarray,
    cov: np.ndarray,
    of_passes: list[np.ndarray],
    noise: float,
    more: float,
) -> Iterator[tuple[int, np.ndarray, np.ndarray]]:
    """Of each pass, and axis by axis: its number, and design (m, 4) and readings (m) with errors of unit size."""
    for k, rows in enumerate(of_passes):
        for axis in range(3):
            design = np.zeros((rows.sum(), 4))
            design[:, axis], design[:, 3] = 1.0, rate[rows, axis]
            white = _whitening(more * noise, more**2 * cov[rows, axis, axis])
            yield k, white @ design, white @ read[rows, axis]


def _whitening(noise: float, common: np.ndarray) -> np.ndarray:
    """What makes errors (m, m) of unit size of readings that have noise and the error of a pass in common (m: its variances)."""
    sigma = np.sqrt(common)
    return np.linalg.inv(np.linalg.cholesky(noise**2 * np.eye(len(sigma)) + np.outer(sigma, sigma)))
