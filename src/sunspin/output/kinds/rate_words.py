"""The rate of a pass as people read it: its size, with its range over the pass, and its components at a stated time.

Their mean over the pass is neither: of a body that tumbles, x and y average out, and the size of the mean is not the speed.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sunspin.output.text import digits_of
from sunspin.vehicle.timeline import utc_after


class RateAt(NamedTuple):
    """Of the likeliest motion of a pass, deg/s: least, mean and largest speed; rate (3) and its sigma (3), all modes counted, at
    the sample nearest to the middle, `at_s` s from the epoch."""

    low: float
    mean: float
    high: float
    at_s: float
    omega: np.ndarray
    sigma: np.ndarray

    @property
    def speed(self) -> str:
        """3.10 (2.98 to 3.21)"""
        digits = digits_of([max(self.high - self.low, 0.01 * self.mean, float(self.sigma.min()))])
        return f"{self.mean:.{digits}f} ({self.low:.{digits}f} to {self.high:.{digits}f})"

    @property
    def components(self) -> str:
        """(1.1, -1.7, 2.9) +- (0.1, 0.1, 0.1)"""
        digits = digits_of(self.sigma)
        omega, sigma = (
            ", ".join(f"{value:z.{digits}f}" for value in values)
            for values in (self.omega, self.sigma)
        )
        return f"({omega}) +- ({sigma})"


def rate_at(result: Any, k: int) -> RateAt:
    """The rate of pass number `k` of a result of `rates`."""
    at = np.flatnonzero(result["pass_of"].values == k)
    t, omega = result["time"].values[at], np.degrees(result["omega_B"].values[at])
    speed = np.linalg.norm(omega, axis=1)
    middle = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
    own = np.degrees(np.sqrt(np.diagonal(result["omega_cov_B"].values[at[middle]])))
    every, best = (
        np.degrees(result[name].values[where])
        for name, where in (("omega_sigma_all_B", k), ("omega_sigma_B", (k, 0)))
    )
    sigma = np.sqrt(
        own**2 + np.nan_to_num(np.maximum(every**2 - best**2, 0.0))
    )  # what the other modes add to it
    return RateAt(
        float(speed.min()),
        float(speed.mean()),
        float(speed.max()),
        float(t[middle]),
        omega[middle],
        sigma,
    )


def clock_of(result: Any, seconds: float) -> str:
    """A time of the result: UTC, or s where its epoch is not known."""
    epoch = result.attrs.get("epoch_utc")
    return f"{seconds:z.0f} s" if not epoch else utc_after(seconds, str(epoch))
