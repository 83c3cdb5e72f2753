"""Negative controls of `reproduce`: telemetry of landers that did not move as Philae did, and files with errors.

Each is the built-in synthetic telemetry with one change, so that the conclusions of a study can be compared with the truth.
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
from sunspin.philae.simulation import PhaseSamples, add_rebound_noise
from sunspin.philae.sun_directions import apply_measured_noise
from sunspin.telemetry.sun import sun_directions
from sunspin.telemetry.synthetic import generator

STILL = (0.0, 0.0, 0.0)
TUMBLING = (0.35, -0.2, 0.15)
"""Rate at the first sample in rad/s of a motion away from the published lines."""


def simulate_motion(
    case: Case, omega_B: Any, wheel_mode: str = "coast", seed: int = 0, noise: float | None = None
) -> xr.Dataset:
    """Return the case's telemetry with another first rebound: that of a lander with rate `omega_B` (rad/s) at the first sample."""
    data = case.telemetry.copy(deep=True)
    inside = np.flatnonzero(data["phase"].values == "first_rebound")
    t, known = data["time"].values[inside], read_truth(case)
    speed = nominal_wheel_speeds(case.vehicle)
    run = propagate(
        case.vehicle, omega_B, known["sun_B"], speed, t - t[0], wheel_mode=wheel_mode, rtol=1e-9
    )
    samples = PhaseSamples("first_rebound", t, run["sun_B"].values)
    tilt, rng = np.array(known["tilt_B_rad"]).reshape(-1, 3), generator(seed, 20)
    data["power_W"].values[inside] = add_rebound_noise(case.vehicle, samples, tilt, noise, rng)
    data.attrs.pop("sha256", None)  # no longer the file whose truth ships with the case
    return data


def shuffle_panels(case: Case, seed: int = 0) -> xr.Dataset:
    """Return telemetry with the readings of each panel shuffled in time, so that no sample is consistent with sunlight."""
    data, rng = _copy_telemetry(case), generator(seed, 21)
    for k in range(data.sizes["panel"]):
        data["power_W"].values[:, k] = rng.permutation(data["power_W"].values[:, k])
    return data


def shuffle_samples(case: Case, seed: int = 0) -> xr.Dataset:
    """Return telemetry with the samples shuffled within each phase, so that every sample is right but there is no motion."""
    data, rng = _copy_telemetry(case), generator(seed, 22)
    phase = data["phase"].values
    for name in dict.fromkeys(phase):
        inside = np.flatnonzero(phase == name)
        data["power_W"].values[inside] = data["power_W"].values[rng.permutation(inside)]
    return data


def exchange_panels(case: Case, first: str = "1", second: str = "2") -> xr.Dataset:
    """Return telemetry with the columns of two panels exchanged."""
    data, names = _copy_telemetry(case), list(case.vehicle.panel_names)
    pair = [names.index(first), names.index(second)]
    data["power_W"].values[:, pair] = data["power_W"].values[:, pair[::-1]]
    return data


def _copy_telemetry(case: Case) -> xr.Dataset:
    """Return a copy of the case's telemetry without the hash that identifies its truth."""
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
"""Telemetry of each control by name."""

NOT_CONCLUDED = ("each panel shuffled", "panels 1 and 2 exchanged")
"""Controls from whose readings nothing may be concluded."""

COARSER = 3
"""Grid of the scan: every third point, 34 x 34 x 14 motions."""

SIMULATIONS = 60
"""Number of simulated rebounds in the calibration."""


@dataclass(frozen=True)
class ControlResult:
    """Result of a control: data check, scan and candidates, or the reason `why` there are none."""

    case: Case
    check: data_check.DataCheck
    scan: metrics.TelemetryScan | None
    chain: candidates.CandidateSets | None
    why: str

    @property
    def rows(self) -> dict[str, Row]:
        """Rows of scan and touchdown by id, as they are counted."""
        rows = metrics.scan_rows(self.scan) if self.scan else []
        rows = rows + (touchdown.touchdown_rows(self.chain) if self.chain else [])
        return {row.id: settle(row) for row in rows}


def prepare_case(telemetry: xr.Dataset | None = None) -> tuple[Case, xr.Dataset]:
    """Return the case with this telemetry (default: the built-in one) and its measured noise, and its Sun directions."""
    case = load_case("philae")
    case = case if telemetry is None else with_telemetry(case, telemetry)
    case, _ = apply_measured_noise(case)
    return case, sun_directions(case.vehicle, case.telemetry)


def run_chain(
    telemetry: xr.Dataset | None = None,
    **options: Any,
) -> ControlResult:
    """Run data check, scan and candidates on telemetry (default: the built-in one). `options` are fields of `Options`."""
    case, sun = prepare_case(telemetry)
    options = Options(**{"coarser": COARSER, "simulations": SIMULATIONS} | options)
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
