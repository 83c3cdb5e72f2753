"""What a type checker must make of the public face. Checked, never run: `make lint`."""

from typing import assert_type

import numpy as np
import xarray as xr

import sunspin as ss

assert_type(ss.__version__, str)
vehicle = ss.load_vehicle("philae")
assert_type(vehicle, ss.Vehicle)
case = ss.load_case("philae")
assert_type(case, ss.Case)
assert_type(case.telemetry, xr.Dataset)
assert_type(vehicle.panels, tuple[ss.Panel, ...])
assert_type(vehicle.wheels[0].friction, ss.Friction)
assert_type(vehicle.legs, tuple[ss.Leg, ...])
assert_type(vehicle.hull, tuple[ss.HullPart, ...])
assert_type(vehicle.antenna, ss.Antenna | None)

seen = ss.read_telemetry("telemetry.csv", vehicle)
assert_type(seen, xr.Dataset)
power: np.ndarray = ss.panel_power(vehicle, [0.0, 0.0, 1.0])
assert_type(ss.sun_directions(vehicle, seen), xr.Dataset)
status: int = ss.SunStatus.OK
assert_type(ss.panel_quality(vehicle, seen), xr.Dataset)
health: xr.Dataset = ss.panel_health(vehicle, seen)
fit: xr.Dataset = ss.fit_spin_down([0, 1, 2, 3], [4, 3, 2, 1], 0.0058)
assert_type(vehicle.require_noise(), float)
assert_type(case.require_timeline().event("collision").t_s, float)
assert_type(ss.rates(vehicle, seen, max_rate_rad_s=0.1), xr.Dataset)

run = ss.propagate(
    vehicle,
    omega_B=[0.1, 0, 0],
    sun_B=[0, 0, 1],
    wheel_speed_rad_s=865,
    t_s=[0, 60.0],
    wheel_mode="hold",
)
assert_type(run, xr.Dataset)
assert_type(ss.impact(vehicle, [0, 0, 0], 865, [0, 0, -0.2], "1"), xr.Dataset)
assert_type(ss.fit_spin_down([0, 1, 2, 3], [4, 3, 2, 1], 0.0058).friction, ss.Friction)
assert_type(ss.twin("philae", seed=1), xr.Dataset)

assert_type(ss.emd([0.1], [0.2]), float)
assert_type(ss.direction_error(run, run), float)
volume = ss.scan(vehicle, [0.5], [0, 0, 1], [0.1], [0.0], [0.0], 865, 60.0, workers=2, store="rows")
assert_type(volume, xr.DataArray)
points: np.ndarray = ss.near_minimum(volume, factor=1.2)
assert_type(ss.fit_lines(points, n_lines=2), xr.Dataset)
scenario = ss.Scenario(sun_B=(0, 0, 1), wheel_speed_rad_s=(865,), after_s=60.0)
assert_type(ss.outcomes(vehicle, points, "off", 100, 0, scenario=scenario), xr.Dataset)

tree = ss.posterior(vehicle, seen, {"max_rate_rad_s": 0.3}, seed=1)
assert_type(tree, xr.DataTree)

try:
    ss.reproduce("results")
except (ss.VehicleError, ss.TelemetryError, ss.MotionError, ss.InputError, ss.OutputError) as error:
    wrong: ss.SunspinError = error
