"""Fit scale and zero of skCUBE's gyro to its Sun sensors: python docs/skcube_gyro.py DATA_FOLDER (see docs/data.md for the data).

Between two beacons the mean of the two gyro readings turns the Sun from where one beacon's sensors saw it to where the next
one's did. Scale and zero that do this best, under a Student law of the sensors' stated errors, are printed for 23 to 27 June,
with each day left out, and for the passes with and without driven coils. The gyro of 28 June is not read.
"""

import sys
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize
from scipy.spatial.transform import Rotation

import sunspin as ss
from sunspin.estimate.terms.term import student

FREE_S = 219_600
"""25 June, 20:03 UTC, seconds after the first beacon: the coils are off."""

LONGEST_S = 60.0
"""Beacons farther apart than this are no pair."""

SCALES = np.arange(0.0060, 0.0101, 0.0005)
"""deg/s per count from which the fit begins."""


class Pairs(NamedTuple):
    """Neighbouring beacons: start (s), interval (s), gyro counts (n, 3), the Sun at both with covariances, the day."""

    t_s: np.ndarray
    dt_s: np.ndarray
    counts: np.ndarray
    first: np.ndarray
    second: np.ndarray
    first_cov: np.ndarray
    second_cov: np.ndarray
    day: np.ndarray

    def take(self, which: np.ndarray) -> "Pairs":
        return Pairs(*(part[which] for part in self))


def pairs(craft: ss.Vehicle, beacons) -> Pairs:
    """All pairs of neighbours up to 27 June whose sensors saw the Sun."""
    t = beacons["time"].values
    day = (
        np.datetime64(beacons.attrs["epoch_utc"][:-1]) + (1e9 * t).astype("timedelta64[ns]")
    ).astype("datetime64[D]")
    sun, cov = beacons["sun_sensor_B"].values, beacons["sun_sensor_cov_B"].values
    gyro = craft.sensors.gyro
    counts = beacons["gyro_B"].values / gyro.scale_rad_s + gyro.zero
    good = (
        np.isfinite(sun).all(axis=1)
        & np.isfinite(counts).all(axis=1)
        & (day < np.datetime64("2017-06-28"))
    )
    i = np.flatnonzero(good[:-1] & good[1:] & (np.diff(t) < LONGEST_S) & (np.diff(t) > 0))
    mean = (counts[i] + counts[i + 1]) / 2
    return Pairs(t[i], np.diff(t)[i], mean, sun[i], sun[i + 1], cov[i], cov[i + 1], day[i])


def cost(unknown: np.ndarray, p: Pairs, noise: float) -> float:
    """Minus the log likelihood of scale (deg/s per 1000 counts) and zero (counts / 10)."""
    rate = np.radians(unknown[0] / 1000) * (p.counts - 10 * unknown[1:])
    turn = Rotation.from_rotvec(
        -rate * p.dt_s[:, None]
    ).as_matrix()  # the Sun goes round the other way
    carried = np.einsum("nij,nj->ni", turn, p.first)
    drift = noise**2 * p.dt_s**3 / 12  # of the turn about that of the mean of both ends
    spread = (
        turn @ p.first_cov @ np.swapaxes(turn, -1, -2)
        + p.second_cov
        + drift[:, None, None] * np.eye(3)
    )
    white = np.linalg.inv(np.linalg.cholesky(spread))
    value = np.einsum("nij,nj->ni", white, p.second - carried)
    return float(student(value)[1].sum() + np.log(np.linalg.det(spread)).sum() / 2)


def fit(p: Pairs, noise: float) -> tuple[np.ndarray, np.ndarray, float]:
    """Scale (deg/s per count) and zero (counts), their sigmas, and the cost."""
    starts = [np.array([1000 * scale, *(np.median(p.counts, axis=0) / 10)]) for scale in SCALES]
    found = [
        minimize(
            cost,
            start,
            (p, noise),
            method="Nelder-Mead",
            options={"maxiter": 2000, "xatol": 1e-3, "fatol": 1e-3},
        )
        for start in starts + [np.array([7.9, -4.5, -7.2, 8.8])]
    ]
    best = min(found, key=lambda one: one.fun)
    step = np.array([0.05, 0.1, 0.1, 0.1])
    curved = np.empty((4, 4))
    for a in range(4):
        for b in range(4):
            moved = [
                cost(best.x + step * (sa * np.eye(4)[a] + sb * np.eye(4)[b]), p, noise)
                for sa in (1, -1)
                for sb in (1, -1)
            ]
            curved[a, b] = (moved[0] - moved[1] - moved[2] + moved[3]) / (4 * step[a] * step[b])
    sigma = np.sqrt(np.diag(np.linalg.inv(curved)))
    size = np.array([1e-3, 10, 10, 10])
    return best.x * size, sigma * size, float(best.fun)


def told(folder: Path) -> list[str]:
    """The lines that the script prints."""
    craft = ss.load_vehicle("skcube")
    noise = craft.sensors.disturbance.acceleration_noise
    p = pairs(craft, ss.read_telemetry(folder / "skcube" / "skcube_adcs.csv", craft))
    kinds = {
        "all": np.ones(len(p.t_s), dtype=bool),
        "free": p.t_s > FREE_S,
        "driven": p.t_s <= FREE_S,
    }
    kinds |= {f"without {day}": p.day != day for day in np.unique(p.day)}
    lines = []
    for name, which in kinds.items():
        value, sigma, _ = fit(p.take(which), noise)
        zero = ", ".join(f"{z:.0f} +- {s:.0f}" for z, s in zip(value[1:], sigma[1:], strict=True))
        lines.append(
            f"{name:20s} {which.sum():4d} pairs  {value[0]:.4f} +- {sigma[0]:.4f} deg/s per count  zero ({zero})"
        )
    return lines


if __name__ == "__main__":
    print("\n".join(told(Path(sys.argv[1]))))
