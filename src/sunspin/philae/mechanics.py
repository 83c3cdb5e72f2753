"""The mechanical model: spin-down of the wheel, example motions (paper, section 2.2, Figs. 5 to 7)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr

from sunspin.dynamics.friction import (
    fit_spin_down,
    spin_down_curve,
    spin_down_speed,
    spin_down_time,
)
from sunspin.dynamics.propagate import propagate
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

STILL_Z = 0.01
"""r_z that changes by less than this counts as constant."""


@dataclass(frozen=True)
class Mechanics:
    """`examples`: runs of Figs. 6 and 7 as `propagate` returns them; `spin_down`: see `spin_down`."""

    case: Case
    examples: list[xr.Dataset]
    spin_down: dict[str, Any]


def compute(case: Case) -> Mechanics:
    """Nothing here depends on telemetry."""
    t = np.arange(0.0, 60.0 * case.published["example_duration"].value + 0.5, 1.0)
    start = rb.first_sun(case), rb.nominal_speed(case.vehicle)
    rates = case.published["example_rates"].value
    runs = [propagate(case.vehicle, omega, *start, t) for omega in rates]
    return Mechanics(case, runs, spin_down(case))


def spin_down(case: Case) -> dict[str, Any]:
    """Fig. 5: the wheel on a body that stays at rest, with the fitted and with the printed friction; the fit recovered."""
    wheel = case.vehicle.wheels[0]
    rounded = case.vehicle.with_friction("printed").wheels[0].friction
    law = rounded.coulomb_N_m, rounded.viscous_N_m_s, wheel.inertia_kg_m2
    c1, c2, c3 = case.published["spin_down_coefficients"].value
    t = np.linspace(0.0, 0.999 * np.log(-c3 / c1) / c2, 200)  # up to just before the stop
    record = spin_down_curve(t, c1, c2, c3)
    return {
        "t_s": t,
        "record": record,
        "fit": fit_spin_down(t, record, wheel.inertia_kg_m2),
        "printed": spin_down_speed(*law, record[0], t),
        "stop_printed_s": spin_down_time(rounded, wheel.inertia_kg_m2, wheel.speed_rad_s),
    }


def rows(result: Mechanics) -> list[Row]:
    """Figures of section 2.2 beside ours."""
    case, still, fit = result.case, result.examples[0], result.spin_down["fit"]
    z, stops = still["sun_B"].values[:, 2], still["event_time_s"].values / 60
    ends, constant = [float(z.min()), float(z.max())], bool(np.ptp(z) < STILL_Z)
    stop, rounded = float(stops[0]) if len(stops) else None, result.spin_down["stop_printed_s"] / 60
    return [
        row(case, "spin_down_coefficients", [fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s]),
        row(case, "friction_coulomb", fit.friction.coulomb_N_m),
        row(case, "friction_viscous", fit.friction.viscous_N_m_s),
        row(case, "wheel_stop", stop, printed=rounded),
        row(case, "example_still_z", ends, tolerance=STILL_Z, agrees=constant),
    ]
