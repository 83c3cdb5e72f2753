"""Scale and zero of skCUBE's gyro, fitted to its Sun sensors.

    python -m studies.skcube_gyro --data FOLDER

Between two beacons, the mean of the two gyro readings rotates the Sun direction that the sensors measured at the first beacon.
The fitted scale and zero bring it closest to the direction at the second beacon, under a Student law with the sensors' stated
errors. The study prints the fit to all pairs of beacons from 23 to 27 June 2017, to those before and after the coils were switched
off, and without each day in turn. The gyro readings of 28 June are not used.
"""

from __future__ import annotations

import sys
from typing import NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import sunspin as ss
from studies.skcube_data import FREE_S, LAST_DAY, add_data_option, read_beacons, utc
from sunspin.estimate.terms.term import student
from validation.campaign import command, study_parser

LONGEST_S = 60.0
"""Longest interval between the two beacons of a pair."""

UNITS = np.array([1e-3, 10.0, 10.0, 10.0])
"""Scale (deg/s per count) and zero (counts) are fitted in these units, in which all four unknowns are of order 1 to 10."""

START_SCALES = np.arange(0.0060, 0.0101, 0.0005)
"""Scales (deg/s per count) from which the fit starts, with the median readings as the zero."""

FURTHER_START = np.array([7.9, -4.5, -7.2, 8.8])
"""Scale and zero of the vehicle file, rounded, in `UNITS`: one more start of the fit."""

STEPS = np.array([0.05, 0.1, 0.1, 0.1])
"""Steps, in `UNITS`, of the second differences that give the sigmas."""


class Pairs(NamedTuple):
    """Neighbouring beacons: start (s), interval (s), mean gyro counts (n, 3), Sun directions at both with covariances, UTC day."""

    t_s: np.ndarray
    dt_s: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    second: np.ndarray
    first_cov: np.ndarray
    second_cov: np.ndarray
    day: np.ndarray

    def take(self, chosen: np.ndarray) -> Pairs:
        """Return some of the pairs, chosen by index or mask."""
        return Pairs(*(values[chosen] for values in self))


def neighbouring_beacons(craft: ss.Vehicle, beacons: xr.Dataset) -> Pairs:
    """Return all pairs of neighbouring beacons up to 27 June that have a Sun direction and a gyro reading each."""
    gyro = craft.sensors.gyro
    assert gyro is not None
    t, day = beacons["time"].values, utc(beacons).astype("datetime64[D]")
    sun, cov = beacons["sun_sensor_B"].values, beacons["sun_sensor_cov_B"].values
    # the readings again, from the rates that the vehicle file makes of them
    counts = beacons["gyro_B"].values / gyro.scale_rad_s + gyro.zero
    measured = np.isfinite(sun).all(axis=1) & np.isfinite(counts).all(axis=1)
    usable, dt = measured & (day < LAST_DAY), np.diff(t)
    # i: index of the first beacon of each pair
    i = np.flatnonzero(usable[:-1] & usable[1:] & (dt < LONGEST_S) & (dt > 0))
    mean = (counts[i] + counts[i + 1]) / 2
    return Pairs(t[i], dt[i], mean, sun[i], sun[i + 1], cov[i], cov[i + 1], day[i])


def cost(unknowns: np.ndarray, pairs: Pairs, acceleration_noise: float) -> float:
    """Return minus the log likelihood of scale and zero (4), in `UNITS`.

    `acceleration_noise` (rad/s^1.5) is the vehicle's: the rate between two beacons is a random walk.
    """
    scale, zero = unknowns[0] * UNITS[0], unknowns[1:] * UNITS[1:]
    omega = np.radians(scale) * (pairs.counts - zero)
    # in body axes the Sun rotates opposite to the body
    rotation = Rotation.from_rotvec(-omega * pairs.dt_s[:, None]).as_matrix()
    propagated = np.einsum("nij,nj->ni", rotation, pairs.first)
    # variance of the rotation angle of a random walk, given the mean of the rates at both ends
    drift = acceleration_noise**2 * pairs.dt_s**3 / 12
    covariance = rotation @ pairs.first_cov @ np.swapaxes(rotation, -1, -2) + pairs.second_cov
    covariance += drift[:, None, None] * np.eye(3)
    whitening = np.linalg.inv(np.linalg.cholesky(covariance))
    residuals = np.einsum("nij,nj->ni", whitening, pairs.second - propagated)
    return float(student(residuals)[0].sum() + np.log(np.linalg.det(covariance)).sum() / 2)


def fit(pairs: Pairs, acceleration_noise: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Return scale (deg/s per count) and zero (counts) as (4), their sigmas (4), and the cost at the best fit.

    The sigmas are those of the inverse Hessian of the cost, by second differences.
    """
    zero = np.median(pairs.counts, axis=0) / UNITS[1:]
    starts = [np.array([scale / UNITS[0], *zero]) for scale in START_SCALES]
    options = {"maxiter": 2000, "xatol": 1e-3, "fatol": 1e-3}
    fits = [
        minimize(cost, start, (pairs, acceleration_noise), method="Nelder-Mead", options=options)
        for start in [*starts, FURTHER_START]
    ]
    best = min(fits, key=lambda result: result.fun)
    hessian = np.empty((4, 4))
    for a, row in enumerate(np.eye(4)):
        for b, column in enumerate(np.eye(4)):
            # costs at (+, +), (+, -), (-, +), (-, -) steps along both unknowns
            corners = [
                cost(best.x + STEPS * (i * row + j * column), pairs, acceleration_noise)
                for i in (1, -1)
                for j in (1, -1)
            ]
            mixed = corners[0] - corners[1] - corners[2] + corners[3]
            hessian[a, b] = mixed / (4 * STEPS[a] * STEPS[b])
    sigma = np.sqrt(np.diag(np.linalg.inv(hessian)))
    return best.x * UNITS, sigma * UNITS, float(best.fun)


def lines_of_fits(pairs: Pairs, acceleration_noise: float) -> list[str]:
    """Return a line of text for each selection of pairs, with scale, zero and their sigmas."""
    # before and after the coils were switched off, and without each day
    selections = {
        "all": np.ones(len(pairs.t_s), dtype=bool),
        "free": pairs.t_s > FREE_S,
        "driven": pairs.t_s <= FREE_S,
    }
    selections |= {f"without {day}": pairs.day != day for day in np.unique(pairs.day)}
    lines = []
    for name, chosen in selections.items():
        value, sigma, _ = fit(pairs.take(chosen), acceleration_noise)
        scale = f"{value[0]:.4f} +- {sigma[0]:.4f} deg/s per count"
        zero = ", ".join(f"{z:.0f} +- {s:.0f}" for z, s in zip(value[1:], sigma[1:], strict=True))
        lines.append(f"{name:20s} {chosen.sum():4d} pairs  {scale}  zero ({zero})")
    return lines


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("skcube_gyro", __doc__)
    add_data_option(parser)
    craft = ss.load_vehicle("skcube")
    beacons = read_beacons(craft, parser.parse_args(arguments).data)
    pairs = neighbouring_beacons(craft, beacons)
    print("\n".join(lines_of_fits(pairs, craft.sensors.disturbance.acceleration_noise)))


if __name__ == "__main__":
    sys.exit(main())
