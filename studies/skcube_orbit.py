"""Rates of skCUBE from Sun sensors and magnetometer, with and without an orbit, compared with its gyro.

    python -m studies.skcube_orbit --data FOLDER

The estimates do not use the gyro. The passes are those of 25 to 27 June 2017, after the coils were switched off. The orbit is that
of VZLUSAT-1, a satellite of the same launch, two months later, with an along-track offset unknown to 150 s. The whole file tests
this orbit and calibrates the magnetometer. A normalised error is the difference between a pass's mean rate and the gyro's, divided
by both sigmas together; the vehicle file states the errors of the gyro's zero and scale.
"""

from __future__ import annotations

import sys

import numpy as np
import xarray as xr

import sunspin as ss
from studies.skcube_data import FREE_S, LAST_DAY, add_data_option, read_beacons, utc
from sunspin.base.errors import InputError
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import Orbit, in_orbit
from sunspin.estimate.orbit.calibration import (
    MOST_SAMPLES,
    calibrate_magnetometer,
    calibrate_with_sun_sensors,
)
from sunspin.estimate.orbit.check import OrbitCheck
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.estimate.orbit.readings import orbit_readings
from sunspin.telemetry.assess import assess
from validation.campaign import command, study_parser

VZLUSAT_1 = """1 42790U 17036AB  17236.90928386  .00002510  00000-0  11640-3 0  9996
2 42790  97.4437 295.9456 0012835  41.8426 318.3788 15.20921507  9461"""

OFFSET_SIGMA_S = 150.0
"""One sigma of the along-track offset before the telemetry is used, in seconds of flight."""

LIMITS = {"68 %": 1.0, "95 %": 1.96}
"""Central intervals of the normal distribution, in sigmas."""


def vzlusat_orbit(telemetry: xr.Dataset) -> Orbit:
    """Return the orbit of VZLUSAT-1 at the times of a telemetry Dataset, its along-track offset unknown to `OFFSET_SIGMA_S`."""
    elements = parse_elements(VZLUSAT_1, "VZLUSAT-1")
    epoch, t = telemetry.attrs["epoch_utc"], telemetry["time"].values
    return in_orbit(elements, epoch, t, shift_sigma_s=OFFSET_SIGMA_S)


def print_offsets_by_part(
    orbit: Orbit, check: OrbitCheck, craft: ss.Vehicle, telemetry: xr.Dataset
) -> None:
    """Print the along-track offset of halves and thirds of the file, each estimated alone, and that of the whole file.

    `orbit` and `check` are the results for the whole file, whose offset drifts linearly.
    """
    t = telemetry["time"].values
    for count in (2, 3):
        for part in np.array_split(np.arange(len(t)), count):
            samples = telemetry.isel(time=part)
            unknown = vzlusat_orbit(samples)
            # the residual of the whole file is no limit for a part
            start = check.start(unknown)._replace(residual_T=np.inf)
            readings = orbit_readings(assess(craft, samples), MOST_SAMPLES)
            alone = calibrate_with_sun_sensors(unknown, craft, readings, start)
            # offset of the whole file in this part
            expected = float(orbit.ahead_s(orbit.instants(t[part])).mean())
            expected_sigma = float(orbit.ahead_sigma_s(orbit.instants([t[part].mean()]))[0])
            sigma = np.hypot(alone.shift_sigma_s, expected_sigma)
            print(
                f"  day {t[part].mean() / 86400:.1f}: {alone.shift_s:+.0f} +- {alone.shift_sigma_s:.0f} s alone, "
                f"{expected:+.0f} s by the whole file, {(alone.shift_s - expected) / sigma:+.1f} sigma apart"
            )


def normalised_errors(
    craft: ss.Vehicle, result: xr.Dataset, gyro_B: xr.DataArray
) -> tuple[np.ndarray, np.ndarray]:
    """Print each pass of a result of `rates`; return normalised errors (n, 3) of the mean rates, and sigmas (n, 3) in rad/s.

    `gyro_B` has the gyro's rates in rad/s. The normalised errors include the gyro's errors, the sigmas do not.
    """
    gyro, errors = craft.sensors.gyro, []
    assert gyro is not None
    sigmas = result["omega_sigma_all_B"].values
    for k, sigma in enumerate(sigmas):
        t = result["time"].values[result["pass_of"].values == k]
        mean = np.nanmean(gyro_B.sel(time=t).values, axis=0)
        gyro_sigma = np.hypot(
            gyro.scale_rad_s * gyro.zero_sigma, mean * gyro.scale_sigma / gyro.scale_rad_s
        )
        difference = result["omega_mean_B"].values[k, 0] - mean
        errors.append(difference / np.hypot(sigma, gyro_sigma))
        text = ", ".join(f"{x:+.1f}" for x in errors[-1])
        print(
            f"  {result['utc_start'].values[k]} {len(t):3d} samples  normalised errors {text}  sigma "
            f"{np.degrees(sigma).round(3)}  {result['why_not_decided'].values[k] or 'decided'}",
            flush=True,
        )
    return np.array(errors), sigmas


@command
def main(arguments: list[str] | None = None) -> None:
    parser = study_parser("skcube_orbit", __doc__)
    add_data_option(parser)
    craft = ss.load_vehicle("skcube")
    beacons = read_beacons(craft, parser.parse_args(arguments).data)
    without_gyro = beacons.drop_vars("gyro_B")
    orbit, check, conclusion = judged_orbit(vzlusat_orbit(beacons), craft, without_gyro)
    print(conclusion)
    if orbit is None:
        raise InputError("the beacons refuse the orbit of VZLUSAT-1", do="download them again")
    print_offsets_by_part(orbit, check, craft, without_gyro)
    calibration = calibrate_magnetometer(orbit, assess(craft, without_gyro), check.fitted_sensors)
    zero_sigma = 1e6 * np.sqrt((calibration.errors[:, 9:12] ** 2).sum(axis=0))
    noise = f"noise {1e6 * calibration.noise_T:.2f} uT"
    print(f"magnetometer: {noise}, sigma of the zero {zero_sigma.round(2)} uT")
    free = without_gyro.isel(time=(beacons["time"].values > FREE_S) & (utc(beacons) < LAST_DAY))
    for name, environment in (("with the orbit", orbit), ("without the orbit", None)):
        print(name)
        used = None if environment is None else calibration
        result = ss.rates(craft, free, environment=environment, calibration=used)
        errors, sigma = normalised_errors(craft, result, beacons["gyro_B"])
        shares = [
            f"inside {share}: {(np.abs(errors) < limit).mean():.2f}"
            for share, limit in LIMITS.items()
        ]
        rms = np.sqrt((errors**2).mean()), np.sqrt((errors**2).mean(axis=0)).round(2)
        median = np.degrees(np.median(sigma)), np.degrees(np.median(sigma, axis=0)).round(3)
        print(
            f"{name}: {len(errors)} passes, {int(result['decided'].sum())} decided; {', '.join(shares)}; "
            f"rms normalised error {rms[0]:.2f} {rms[1]}; median sigma {median[0]:.3f} {median[1]} deg/s"
        )


if __name__ == "__main__":
    sys.exit(main())
