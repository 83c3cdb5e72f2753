"""Telemetry of landers that did something else than Philae, and of files with something wrong: negative controls of `reproduce`.

Each is the built-in synthetic telemetry with one thing changed, so that whatever a study concludes from it can be held against
the truth that made it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import SunspinError
from sunspin.cases import Case, load_case
from sunspin.dynamics.propagate import propagate
from sunspin.philae import candidates, data_check, descent, metrics, touchdown
from sunspin.philae.rebound import Options, nominal_wheel_speeds, read_truth, with_telemetry
from sunspin.philae.row import Row, settle
from sunspin.philae.sun_directions import apply_measured_noise
from sunspin.philae.telemetry import CELL_W, add_noise
from sunspin.telemetry.sun import sun_directions
from sunspin.telemetry.synthetic import generator

STILL = (0.0, 0.0, 0.0)
TUMBLING = (0.35, -0.2, 0.15)
"""rad/s at the first sample: a motion off the printed lines."""


def simulate_motion(
    case: Case, omega_B: Any, wheel_mode: str = "coast", seed: int = 0, noise: float | None = None
) -> xr.Dataset:
    """The case's telemetry and panels, with the first rebound of a lander that turns at `omega_B` (rad/s) at its first sample."""
    data = case.telemetry.copy(deep=True)
    inside = np.flatnonzero(data["phase"].values == "first_rebound")
    t, known = data["time"].values[inside], read_truth(case)
    speed = nominal_wheel_speeds(case.vehicle)
    run = propagate(
        case.vehicle, omega_B, known["sun_B"], speed, t - t[0], wheel_mode=wheel_mode, rtol=1e-9
    )
    sun, tilt = run["sun_B"].values, np.array(known["tilt_B_rad"]).reshape(-1, 3)
    exact = CELL_W * case.vehicle.response_in().power(sun, tilt=tilt)
    sigma = case.vehicle.require_noise() if noise is None else noise
    power = add_noise(case.vehicle, sun, exact, sigma, generator(seed, 20))
    data["power_W"].values[inside] = power
    data.attrs.pop("sha256", None)  # no longer the file whose truth ships with the case
    return data


def shuffle_panels(case: Case, seed: int = 0) -> xr.Dataset:
    """Each panel's readings shuffled in time, apart from the others: no Sun is left in any sample."""
    data, rng = _copy_telemetry(case), generator(seed, 21)
    for k in range(data.sizes["panel"]):
        data["power_W"].values[:, k] = rng.permutation(data["power_W"].values[:, k])
    return data


def shuffle_samples(case: Case, seed: int = 0) -> xr.Dataset:
    """Whole samples shuffled within each phase: every sample is right, no motion is left."""
    data, rng = _copy_telemetry(case), generator(seed, 22)
    phase = data["phase"].values
    for name in dict.fromkeys(phase):
        inside = np.flatnonzero(phase == name)
        data["power_W"].values[inside] = data["power_W"].values[rng.permutation(inside)]
    return data


def exchange_panels(case: Case, first: str = "1", second: str = "2") -> xr.Dataset:
    """The columns of two panels exchanged."""
    data, names = _copy_telemetry(case), list(case.vehicle.panel_names)
    pair = [names.index(first), names.index(second)]
    data["power_W"].values[:, pair] = data["power_W"].values[:, pair[::-1]]
    return data


def _copy_telemetry(case: Case) -> xr.Dataset:
    data = case.telemetry.copy(deep=True)
    data.attrs.pop("sha256", None)
    return data


CONTROLS: dict[str, Callable[[Case], xr.Dataset]] = {
    "as it is": lambda case: case.telemetry,
    "never tumbled": lambda case: simulate_motion(case, STILL),
    "spins about z": lambda case: simulate_motion(case, (0.0, 0.0, 0.3)),
    "another motion": lambda case: simulate_motion(case, TUMBLING),
    "wheel held": lambda case: simulate_motion(case, read_truth(case)["omega_B"], "hold"),
    "each panel shuffled": shuffle_panels,
    "samples shuffled": shuffle_samples,
    "panels 1 and 2 exchanged": exchange_panels,
}
"""Name -> telemetry."""

NOT_CONCLUDED = ("each panel shuffled", "panels 1 and 2 exchanged")
"""Controls from whose readings nothing may be concluded."""

COARSER = 3
"""34 x 34 x 14 motions."""

TWINS = 60


@dataclass(frozen=True)
class ControlResult:
    """What the file carries; its scan and its chain of candidates, or why there is none."""

    case: Case
    check: data_check.DataCheck
    scan: metrics.TelemetryScan | None
    chain: candidates.Chain | None
    why: str

    @property
    def rows(self) -> dict[str, Row]:
        """Rows of the scan and of the touchdown as they count."""
        found = metrics.scan_rows(self.scan) if self.scan else []
        found = found + (touchdown.rows(self.chain) if self.chain else [])
        return {row.id: settle(row) for row in found}


def prepare_case(telemetry: xr.Dataset | None = None) -> tuple[Case, xr.Dataset]:
    """The case with this telemetry, the built-in one unless given, and its own noise; its Sun directions."""
    case = load_case("philae")
    case = case if telemetry is None else with_telemetry(case, telemetry)
    case, _ = apply_measured_noise(case)
    return case, sun_directions(case.vehicle, case.telemetry)


def run_chain(
    telemetry: xr.Dataset | None = None,
    **options: Any,
) -> ControlResult:
    """The chain on a telemetry file, the built-in one unless given."""
    case, sun = prepare_case(telemetry)
    options = Options(**{"coarser": COARSER, "twins": TWINS} | options)
    try:
        fit = descent.compute(case, sun)
    except SunspinError:
        fit = None
    check = data_check.compute(case, sun, fit)
    scan = chain = None
    why = ""
    try:
        scan = metrics.scan_telemetry(case, sun, options)
        chain = candidates.compute(scan, check, options)
    except SunspinError as error:
        why = str(error)
    return ControlResult(case, check, scan, chain, why)
