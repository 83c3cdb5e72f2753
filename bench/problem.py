"""The problem that all integrators solve: Philae between its first touchdown and its collision, with the stop of its wheel."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
import xarray as xr

import sunspin as ss
from sunspin.dynamics import gyrostat
from sunspin.philae import rebound
from sunspin.solve.linear import symmetric_inverse

AXES = ("omega_x", "omega_y", "omega_z")
SEED = 1


@dataclass(frozen=True)
class Problem:
    """Initial states and parameters of the scan of the Philae case."""

    case: ss.Case

    @property
    def vehicle(self) -> ss.Vehicle:
        """Vehicle of the case."""
        return self.case.vehicle

    @cached_property
    def sun_B(self) -> np.ndarray:
        """Sun direction (3) at the start."""
        return rebound.first_sun(self.case)

    @cached_property
    def wheel_speed_rad_s(self) -> np.ndarray:
        """Wheel speeds (1) at the start."""
        return np.array(rebound.nominal_wheel_speeds(self.vehicle))

    @cached_property
    def window_s(self) -> float:
        """Duration of the runs in s."""
        return rebound.published_window_s(self.case)

    @cached_property
    def target_z(self) -> np.ndarray:
        """Measured r_z that the scan compares with."""
        sun = ss.sun_directions(self.vehicle, self.case.telemetry)
        z = rebound.select_rebound(self.case, sun)["sun_B"].values[:, 2]
        return z[np.isfinite(z)]

    def axes(self, *counts: int) -> dict[str, np.ndarray]:
        """Return a regular grid of `counts` initial rates over the paper's ranges."""
        full = rebound.scan_grid(self.case)
        return {
            name: np.linspace(full[name][0], full[name][-1], n)
            for name, n in zip(AXES, counts, strict=True)
        }

    def scan(
        self,
        axes: dict[str, np.ndarray],
        workers: int | None = None,
        direction_error: float | None = None,
    ) -> xr.DataArray:
        """Run sunspin's scan of a grid: for an EMD good to 1e-3, or for a `direction_error` (rad)."""
        return ss.scan(
            self.vehicle,
            self.target_z,
            self.sun_B,
            **axes,
            wheel_speed_rad_s=self.wheel_speed_rad_s,
            duration_s=self.window_s,
            workers=workers,
            propagation=ss.Propagation(direction_error=direction_error),
        )

    def starts(self, omega_B: np.ndarray) -> np.ndarray:
        """Return states (n, 7) = (H, h, r) of motions with rates (n, 3), slow ones first.

        The order favours integrators that run in batches: a batch takes as long as its fastest member.
        """
        n = len(omega_B)
        speeds = np.tile(self.wheel_speed_rad_s, (n, 1))
        momentum = gyrostat.total_momentum(self.vehicle, omega_B, speeds)
        states = np.concatenate(
            [
                momentum,
                gyrostat.axial_momenta(self.vehicle, omega_B, speeds),
                np.tile(self.sun_B, (n, 1)),
            ],
            axis=1,
        )
        return states[np.argsort(np.linalg.norm(momentum, axis=1), kind="stable")]

    def rates(self, starts: np.ndarray) -> np.ndarray:
        """Return body rates (n, 3) of states, the inverse of `starts`."""
        return np.array([gyrostat.body_rate(y[:3], y[3:4], self.parameters(True)) for y in starts])

    def parameters(self, free: bool) -> gyrostat.Parameters:
        """Return the parameters of the equations of motion while the wheel turns freely, or after it has stopped."""
        (wheel,) = self.vehicle.wheels
        turning = gyrostat.WheelParameters(
            tuple(wheel.axis_B.tolist()),
            1.0 / wheel.inertia_kg_m2,
            float(free),
            wheel.friction.coulomb_N_m,
            wheel.friction.viscous_N_m_s,
        )
        return gyrostat.Parameters(
            tuple(symmetric_inverse(gyrostat.free_inertia(self.vehicle, [free])).tolist()),
            (0.0, 0.0, 0.0),
            (turning,),
        )


@cache
def philae() -> Problem:
    """Return the Philae case, loaded once."""
    return Problem(ss.load_case("philae"))


def grid_sample(axes: dict[str, np.ndarray], n: int, seed: int = SEED) -> np.ndarray:
    """Return rates (n, 3) of random grid points, without repeats if the grid has as many."""
    shape = tuple(len(axes[name]) for name in AXES)
    size = int(np.prod(shape))
    index = np.random.default_rng(seed).choice(size, n, replace=n > size)
    return np.stack(
        [axes[name][i] for name, i in zip(AXES, np.unravel_index(index, shape), strict=True)],
        axis=-1,
    )
