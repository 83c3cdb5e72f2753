"""Rates of skCUBE with and without an orbit, against its gyro: python docs/skcube_orbit.py DATA_FOLDER (see docs/data.md).

Free passes of 25 to 27 June 2017; the gyro is withheld from the estimates. The orbit is that of VZLUSAT-1, two months later, its
place along the track unknown to 150 s; it is judged, and the magnetometer calibrated, with the whole file. Pulls are of a pass's
mean rate, with the errors of the gyro's zero and scale that the vehicle file states beside the sigma.
"""

import sys
from pathlib import Path

import numpy as np

import sunspin as ss
from sunspin.environment.elements import parse_elements
from sunspin.environment.orbit import in_orbit
from sunspin.estimate.orbit.check import start_of
from sunspin.estimate.orbit.field_calibration import field_calibration
from sunspin.estimate.orbit.judged import judged_orbit
from sunspin.estimate.orbit.sensor_calibration import by_sun_sensors
from sunspin.telemetry.assess import assess

VZLUSAT = """1 42790U 17036AB  17236.90928386  .00002510  00000-0  11640-3 0  9996
2 42790  97.4437 295.9456 0012835  41.8426 318.3788 15.20921507  9461"""
FREE_S = 219_600


def compared(result, gyro, part) -> np.ndarray:
    """Pulls (n, 3) of the mean rates of passes against a gyro of this part of a vehicle, and their sigmas (n, 3) rad/s."""
    rows = []
    for k in range(result.sizes["pass_id"]):
        at = result["time"].values[result["pass_of"].values == k]
        read = gyro.sel(time=at).values
        sigma = result["omega_sigma_all_B"].values[k]
        mean = np.nanmean(read, axis=0)
        own = np.hypot(
            part.scale_rad_s * part.zero_sigma, mean * part.scale_sigma / part.scale_rad_s
        )
        rows.append([(result["omega_mean_B"].values[k, 0] - mean) / np.hypot(sigma, own), sigma])
        pull = ", ".join(f"{x:+.1f}" for x in rows[-1][0])
        print(
            f"  {result['utc_start'].values[k]} {len(at):3d} samples  pulls {pull}  sigma {np.degrees(sigma).round(3)}  "
            f"{result['why_not_decided'].values[k] or 'decided'}",
            flush=True,
        )
    return np.array(rows)


def by_parts(orbit, found, craft, telemetry, elements) -> None:
    """The shift of halves and thirds of the file, each found by itself, beside that of the whole file drifting evenly."""
    t, epoch = telemetry["time"].values, telemetry.attrs["epoch_utc"]
    for count in (2, 3):
        for part in np.array_split(np.arange(len(t)), count):
            own = in_orbit(elements, epoch, t[part], shift_sigma_s=150.0)
            made = by_sun_sensors(
                own,
                assess(craft, telemetry.isel(time=part)),
                start_of(found, own)._replace(left_T=np.inf),
            )
            expected = float(orbit.ahead_s(orbit.instants(t[part])).mean())
            sigma = np.hypot(
                made.shift_sigma_s, float(orbit.ahead_sigma_s(orbit.instants([t[part].mean()]))[0])
            )
            pull = (made.shift_s - expected) / sigma
            print(
                f"  day {t[part].mean() / 86400:.1f}: {made.shift_s:+.0f} +- {made.shift_sigma_s:.0f} s alone, {expected:+.0f} s "
                f"by the whole file, {pull:+.1f} sigma apart"
            )


def main(folder: Path) -> None:
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(folder / "skcube" / "skcube_adcs.csv", craft)
    utc = np.datetime64(data.attrs["epoch_utc"][:-1]) + (1e9 * data["time"].values).astype(
        "timedelta64[ns]"
    )
    gyro, blind = data["gyro_B"], data.drop_vars("gyro_B")
    elements = parse_elements(VZLUSAT, "VZLUSAT-1")
    given = in_orbit(elements, data.attrs["epoch_utc"], data["time"].values, shift_sigma_s=150.0)
    orbit, found, words = judged_orbit(given, craft, blind)
    print(words)
    by_parts(orbit, found, craft, blind, elements)
    calibration = field_calibration(orbit, craft, blind, found.made)
    zero = 1e6 * np.sqrt((calibration.errors[:, 9:12] ** 2).sum(axis=0))
    print(f"magnetometer: noise {1e6 * calibration.noise_T:.2f} uT, zero to {zero.round(2)} uT")
    free = blind.isel(time=(blind["time"].values > FREE_S) & (utc < np.datetime64("2017-06-28")))
    for name, environment in (("with the orbit", orbit), ("without", None)):
        print(name)
        result = ss.rates(
            craft,
            free,
            environment=environment,
            calibration=None if environment is None else calibration,
        )
        pulls, sigma = np.moveaxis(compared(result, gyro, craft.sensors.gyro), 1, 0)
        inside = [float((np.abs(pulls) < limit).mean()) for limit in (1.0, 1.96)]
        print(
            f"{name}: {len(pulls)} passes, {int(result['decided'].sum())} decided; inside 68 %: {inside[0]:.2f}, inside 95 %: "
            f"{inside[1]:.2f}; rms pull {np.sqrt((pulls**2).mean()):.2f} {np.sqrt((pulls**2).mean(0)).round(2)}; median sigma "
            f"{np.degrees(np.median(sigma)):.3f} {np.degrees(np.median(sigma, axis=0)).round(3)} deg/s"
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]))
