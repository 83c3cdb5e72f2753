"""What :mod:`sunspin.estimate.rates` works on: what a pass measured, hypotheses of how the body moved, and what moves it."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from sunspin.estimate.rates.motion import SUN_N, Body, Ends

FIELD_TURN_RATE = 2.2e-3
"""rad/s; a satellite in low orbit sees the Earth's field turn at about twice its own rate of 1.1e-3 rad/s."""

PER_SAMPLE = (
    "t_s", "sun_B", "sun_cov", "power", "power_sigma", "scale", "scale_sigma", "gyro", "gyro_common", "field", "momentum",
    "attitude", "whole_power", "whole_sigma", "whole_scale_sigma", "earth_unknowns", "field_unknowns",
)  # fmt: skip
"""What `Observations` holds for each sample."""


def drifting(t_s: np.ndarray, sigma: float, rate_rad_s: float) -> np.ndarray:
    """Unknowns (n, 6, 3) of a vector that drifts evenly over a pass, at its times (n): one sigma of each component in its middle,
    and of each component's drift, as fast as a turn at this rate."""
    away = rate_rad_s * (t_s - t_s.mean())
    return (sigma * np.stack([np.ones(len(t_s)), away], axis=1)[:, :, None, None] * np.eye(3)).reshape(len(t_s), 6, 3)


@dataclass(frozen=True)
class Observations:
    """What a pass measured, at n samples. NaN or infinite sigma: nothing measured there.

    `t_s` (n); `sun_B` (n, 3), `sun_cov` (n, 3, 3) its covariance (of full rank; NaN: no direction); `power` (n, n_panel) or for
    each hypothesis (K, n, n_panel), `power_sigma` (n, n_panel), `rows` (n_panel, 3) or for each hypothesis (K, n_panel, 3) gain
    times normal with `row_errors` (m, n_panel, 3), one sigma of errors that all samples share, and `row_unknowns`
    (m, n_panel, 3), one sigma of those that are to be estimated; `scale` (n) and `scale_sigma` (n): the factor of all powers of a
    sample and its relative uncertainty; `gyro` (n, 3) rad/s with `gyro_sigma` and `gyro_common` (n, m, 3), one sigma of errors
    that all samples share; `field` (n, 3) with `field_sigma`, in any unit; `momentum` (n, 3) of the wheels, in the body's mean
    moment of inertia times rad/s; `attitude` (n, 3, 3) B_from_N of some inertial frame with `attitude_sigma` (rad), of which only
    the turn from sample to sample is used; `earth_light`: how much of full Sun a panel gets that looks at the Earth, where no fit
    estimates it. For those that do, `whole_power`, `whole_sigma` (n, n_panel) and `whole_scale_sigma` (n) are what was read, and
    how well, beside that light; `earth_unknowns` (n, m, 3), shares of full Sun in N, one sigma of each unknown of the beam, and
    `beam_N` (K, n, 3), that of each hypothesis; `zero_sigma` (n_panel) and `zero` (K, 1, n_panel) the same of what each panel reads
    too much all the time, unit of the powers. `field_unknowns` (n, m, 3): one sigma of each unknown of the field's rate of change
    in N, and `field_turn_rate` (rad/s) what it turns beside that, any way.
    """

    t_s: np.ndarray
    sun_B: np.ndarray
    sun_cov: np.ndarray
    power: np.ndarray
    power_sigma: np.ndarray
    rows: np.ndarray
    row_errors: np.ndarray
    row_unknowns: np.ndarray
    scale: np.ndarray
    scale_sigma: np.ndarray
    gyro: np.ndarray
    gyro_common: np.ndarray
    gyro_sigma: float
    field: np.ndarray
    field_sigma: float
    momentum: np.ndarray
    attitude: np.ndarray
    attitude_sigma: float
    whole_power: np.ndarray
    whole_sigma: np.ndarray
    whole_scale_sigma: np.ndarray
    earth_unknowns: np.ndarray
    field_unknowns: np.ndarray
    zero_sigma: np.ndarray
    earth_light: float = 0.0
    beam_N: np.ndarray | None = None
    zero: np.ndarray | float = 0.0
    field_turn_rate: float = FIELD_TURN_RATE

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def light_unknowns(self) -> int:
        """How many unknowns the light has that is not the Sun's."""
        return self.earth_unknowns.shape[1] + len(self.zero_sigma)

    @property
    def told(self) -> np.ndarray:
        """Which samples have a direction (n)."""
        return np.isfinite(self.sun_cov[:, 0, 0])

    def take(self, index: np.ndarray | slice) -> Observations:
        """The samples `index`."""
        return replace(self, **{name: getattr(self, name)[index] for name in PER_SAMPLE})

    def part(self, low: int, high: int) -> Observations:
        """Samples low to high - 1."""
        return self.take(slice(low, high))

    def wheels(self, start: int, end: int) -> Ends:
        """What the wheels do between two samples."""
        return Ends(momentum=self.momentum[start], momentum_end=self.momentum[end])


UNTOLD = np.zeros(0)
"""What stands in a `Track` for what no fit has told yet."""


@dataclass(frozen=True)
class Track:
    """K hypotheses: attitudes B_from_N (K, n, 3, 3), rates (K, n, 3), and once smoothed their `cost` (K) (minus the log of
    the posterior density) and `log_weight` (K) (log of the mass of the mode, by Laplace), `covariance` (K, n, 6, 6)."""

    attitude: np.ndarray
    omega: np.ndarray
    cost: np.ndarray = field(default_factory=lambda: UNTOLD)
    log_weight: np.ndarray = field(default_factory=lambda: UNTOLD)
    covariance: np.ndarray = field(default_factory=lambda: UNTOLD)

    def take(self, index: np.ndarray | slice) -> Track:
        told = (x if x is UNTOLD else x[index] for x in (self.cost, self.log_weight, self.covariance))
        return Track(self.attitude[index], self.omega[index], *told)

    @property
    def sun_B(self) -> np.ndarray:
        return self.attitude @ SUN_N


def joined(tracks: list[Track]) -> Track:
    """All hypotheses of smoothed tracks."""
    each = [(t.attitude, t.omega, t.cost, t.log_weight, t.covariance) for t in tracks]
    return Track(*(np.concatenate(parts) for parts in zip(*each, strict=True)))


@dataclass(frozen=True)
class Motion:
    """How the body moves: the body, the white angular acceleration `noise` (rad/s^1.5), the prior sigma of a rate (rad/s), and that
    of the acceleration by a magnetic torque (rad/s2), where it is an unknown of a pass."""

    body: Body
    noise: float
    rate_prior: float
    torque: float = 0.0
