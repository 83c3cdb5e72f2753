"""All sensors of a vehicle calibrated by one telemetry file: what the file determines, in the keys of the vehicle file."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.linalg import polar
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError, MotionError
from sunspin.base.provenance import provenance
from sunspin.environment.orbit import Orbit
from sunspin.estimate.calibrate.gyro import FEWEST_PASSES, GyroFit, fit_gyro
from sunspin.estimate.orbit.check import Verdict, check_orbit, start_of
from sunspin.estimate.orbit.sensor_calibration import (
    FEWEST,
    SUN_KEYS,
    Calibration,
    Readings,
    fit_in_orbit,
    priors,
    readings,
)
from sunspin.estimate.rates.estimate import rates
from sunspin.estimate.verdict import NARROWER
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.gains import prior_sigmas, scale_gains
from sunspin.vehicle import Vehicle
from sunspin.vehicle.rewrite import NewValue
from sunspin.vehicle.timeline import utc_after

BLOCKS = 8
"""Parts of the file that are left out in turn."""

SMALL = 1e-5
"""Step of the differences by which covariances are carried to the keys of the file, in prior sigmas."""


class Key(NamedTuple):
    """A key of the vehicle file, `where` it stands (table, name of the part), and what was found; arrays of one shape."""

    where: tuple[str, ...]
    key: str
    stated: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    prior: np.ndarray
    unit: str
    samples: int
    together: bool | None = None
    """Whether all keys that only make sense with it are determined, and it with them; None: it stands for itself."""

    @property
    def name(self) -> str:
        return ".".join((*self.where, self.key))


def calibrate_sensors(
    vehicle: Vehicle, telemetry: xr.Dataset, orbit: Orbit | None = None, *, progress: bool = False
) -> xr.Dataset:
    """Calibrate panels, Sun sensors, magnetometer and gyro by the telemetry itself; no attitude is needed.

    Gains of panels come from the brightness of samples in full Sun. In an orbit the strength of the field and its angle to the Sun
    are known: they determine zero, matrix and scale of the magnetometer and bias and scale of each Sun sensor, for the whole file
    at once, with the shift along the track. The gyro is compared with the rates of passes that are decided without it.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`
        Read with this `vehicle`.
    orbit : Orbit, optional
        :func:`sunspin.environment.orbit.in_orbit`; without it magnetometer and Sun sensors are left as they are.
    progress : bool
        Show how many passes have been searched.

    Returns
    -------
    xarray.Dataset
        On `quantity`, a number of the vehicle file each: `key` (as ``magnetometer.zero``), `component`, `stated`, `value`, `sigma`,
        `prior_sigma`, `unit`, `determined` (sigma below half of the prior's), `written` (all of its key are), `moved` (by more than
        its sigma). attrs: `source` for the vehicle file, `notes`, the shift along the track, residuals before and after.

    Raises
    ------
    InputError
        Where the elements do not fit the telemetry, the field is read with the opposite sign, or no sensor can be calibrated.
    """
    keys: list[Key] = []
    notes: list[str] = []
    attrs: dict[str, Any] = {}
    calibrated = vehicle
    if "panel" in telemetry.coords:
        found, calibrated = _panels(assess(vehicle, telemetry), notes)
        keys += found
    if "field_B" in telemetry or "sun_sensor_angle" in telemetry:
        assessment = assess(calibrated, telemetry)
        seen = readings(assessment)
        made = _in_orbit(assessment, orbit, seen, notes, attrs)
        keys += (
            []
            if made is None
            else _magnetometer(vehicle, made) + list(_sun_sensors(vehicle, seen, made))
        )
    if "gyro_B" in telemetry and vehicle.sensors.gyro is not None:
        keys += _gyro(vehicle, telemetry, notes, progress)
    if not keys and not notes:
        what = "the telemetry has nothing that can be calibrated"
        do = "it needs columns of panels, Sun sensors, magnetometer or gyro that the vehicle names"
        raise InputError(what, do=do)
    return _dataset(vehicle, telemetry, keys, notes, attrs)


def new_values(found: xr.Dataset) -> list[NewValue]:
    """What a calibration has determined, for :func:`sunspin.vehicle.rewrite.rewrite_values`."""
    values = []
    for name in dict.fromkeys(found["key"].values.tolist()):
        part = found.isel(quantity=np.flatnonzero(found["key"].values == name))
        if not part["written"].values.all():
            continue
        table, *rest = name.split(".", 1)
        key = rest[0].rsplit(".", 1)  # the name of a part may have dots
        value, sigma = (
            _shaped(np.array([float(f"{one:.6g}") for one in part[which].values]))
            for which in ("value", "sigma")
        )
        source = str(found.attrs["source"]).format(samples=int(part["samples"].values[0]))
        values.append(NewValue((table, *key[:-1]), key[-1], value, sigma, source))
    return values


def _shaped(numbers: np.ndarray) -> Any:
    """One number, a vector, or the rows of a matrix, as a file has them."""
    return (
        numbers.item()
        if len(numbers) == 1
        else numbers.reshape(3, 3).tolist()
        if len(numbers) == 9
        else numbers.tolist()
    )


# ------------------------------------------------------------------------------------------------------------------------ panels


def _panels(assessment: Assessment, notes: list[str]) -> tuple[list[Key], Vehicle]:
    """Gains by the brightness of samples, and the vehicle with them."""
    vehicle = assessment.vehicle
    if vehicle.channels:
        notes.append("gains of panels: an input that panels share does not tell the gain of each")
        return [], vehicle
    quality = assessment.quality
    stated, gain = vehicle.panel_gains, quality["gain"].values
    if not np.isfinite(quality.attrs["spread"]):
        notes.append(f"gains of panels: {quality.attrs['gains_from']}")
        return [], vehicle
    jackknife = _jackknife(vehicle, assessment.telemetry)
    sigma = np.maximum(np.sqrt(np.diag(quality["gain_cov"].values)), jackknife)
    prior = prior_sigmas(vehicle) * stated
    key = {"W": "gain_W", "A": "gain_A", None: "relative_gain"}[vehicle.gain_unit]
    count = int((quality["use"].values == 0).sum())
    unit, at = vehicle.gain_unit or "1", [slice(k, k + 1) for k in range(len(stated))]
    keys = [
        Key(("panel", panel.name), key, stated[k], gain[k], sigma[k], prior[k], unit, count)
        for panel, k in zip(vehicle.panels, at, strict=True)
    ]
    return keys, scale_gains(vehicle, gain / stated)


def _jackknife(vehicle: Vehicle, telemetry: xr.Dataset) -> np.ndarray:
    """Sigma (n_panel) of the gains by leaving out each part of the file: what brightens or dims a panel lasts for a pass."""
    samples = np.arange(telemetry.sizes["time"])
    rest = [np.setdiff1d(samples, block) for block in np.array_split(samples, BLOCKS)]
    gain = np.array(
        [assess(vehicle, telemetry.isel(time=some)).quality["gain"].values for some in rest]
    )
    return np.sqrt((BLOCKS - 1) / BLOCKS * ((gain - gain.mean(axis=0)) ** 2).sum(axis=0))


# ---------------------------------------------------------------------------------------------------------------------- in orbit


def _in_orbit(
    assessment: Assessment,
    orbit: Orbit | None,
    seen: Readings,
    notes: list[str],
    attrs: dict[str, Any],
) -> Calibration | None:
    vehicle = assessment.vehicle
    what = "magnetometer and Sun sensors" if vehicle.sensors.sun_sensors else "magnetometer"
    if orbit is None:
        notes.append(
            f"{what}: not determined without an orbit, in which strength and direction of the field are known"
        )
        return None
    check = check_orbit(orbit, vehicle, assessment)
    if check.verdict is Verdict.REFUSED:
        do = "give the right elements, or calibrate without any"
        got = (
            str(check.sun_in_shadow)
            or f"{check.better} of {check.copies} orbits at random predict better"
        )
        raise InputError(
            "the elements do not fit the telemetry, which cannot be calibrated with them",
            got=got,
            do=do,
        )
    if check.sign_turned:
        what = "the magnetometer has the opposite sign, as its angle to the Sun shows, and is not calibrated so"
        do = "change the sign of `matrix` in the vehicle file: -1 in place of 1 on the diagonal if it has none"
        raise InputError(what, do=do)
    if check.turned_axes:
        what, _, do = check.turned_axes.partition("; ")
        raise InputError(f"{what}, and is not calibrated so", do=do)
    notes.append(f"orbit: {check.verdict.value}")
    start = start_of(check, orbit)
    if start is None or not seen.has_field.any():
        notes.append(f"{what}: not determined, too few samples show the field")
        return None
    made = check.made or fit_in_orbit(orbit, vehicle, seen, start, priors(vehicle, seen, orbit))
    if made.samples["field"] + made.samples["field and Sun"] < FEWEST:
        notes.append(f"{what}: not determined, too few samples show the field")
        return None
    attrs |= {
        "shift_s": orbit.shift_s + made.shift_s,
        "shift_sigma_s": made.shift_sigma_s,
        "drift_s_day": orbit.drift_s_day + made.drift_s_day,
        "drift_sigma_s_day": made.drift_sigma_s_day,
        "field_residual_before_T": made.strength[0],
        "field_residual_after_T": made.strength[1],
        "sun_field_residual_before_rad": made.angle[0],
        "sun_field_residual_after_rad": made.angle[1],
        "field_noise_T": made.noise_T,
        "sun_noise": made.sun_noise,
    }
    return made


def _carried(
    made: Calibration, to: Callable[[Calibration], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What a function (m) of the calibration is, its sigma, and its sigma before the data."""
    value, step = to(made), SMALL * np.sqrt(np.diag(made.prior))
    slope = np.stack(
        [(to(_moved(made, k, size)) - value) / size for k, size in enumerate(step)], axis=1
    )
    model, robust, prior = (
        np.sqrt(np.einsum("ij,jk,ik->i", slope, c, slope))
        for c in (made.model, made.robust, made.prior)
    )
    return value, np.maximum(model, robust), prior


def _moved(made: Calibration, k: int, size: float) -> Calibration:
    return replace(made, values=made.values + size * (np.arange(len(made.values)) == k))


def _magnetometer(vehicle: Vehicle, made: Calibration) -> list[Key]:
    part = vehicle.sensors.magnetometer
    if part is None or not made.samples["field"]:
        return []
    n = made.samples["field"]

    def zero(one: Calibration) -> np.ndarray:
        return part.zero + part.sign * np.linalg.solve(part.matrix, one.zero)

    def axes(one: Calibration) -> tuple[np.ndarray, np.ndarray]:
        turn, stretch = polar(one.matrix_T @ part.matrix, side="right")
        return Rotation.from_matrix(turn).as_rotvec(), stretch

    def scale(one: Calibration) -> np.ndarray:
        return np.array([np.cbrt(np.linalg.det(axes(one)[1]))])

    _, sigma, prior = _carried(made, lambda one: axes(one)[0])
    turn_known = bool(np.all(sigma < NARROWER * prior))

    def matrix(one: Calibration) -> np.ndarray:
        whole = one.matrix_T @ part.matrix if turn_known else axes(one)[1]
        return (whole / scale(one)).ravel()

    at = ("magnetometer",)
    keys = [
        Key(at, "zero", part.zero, *_carried(made, zero), "reading", n),
        Key(at, "matrix", part.matrix.ravel(), *_carried(made, matrix), "1", n),
        Key(
            at,
            "scale_T",
            np.array([np.nan if part.scale_T is None else part.scale_T]),
            *_carried(made, scale),
            "T",
            n,
        ),
    ]
    known = all(np.all(key.sigma < NARROWER * key.prior) for key in keys)
    if part.noise is None:
        noise = np.array([made.noise_T]) / scale(made)
        keys.append(
            Key(at, "noise", np.array([np.nan]), noise, noise / np.sqrt(2 * n), noise, "reading", n)
        )
    return [key._replace(together=known) for key in keys]


def _sun_sensors(vehicle: Vehicle, seen: Readings, made: Calibration) -> Iterator[Key]:
    for k, sensor in enumerate(vehicle.sensors.sun_sensors):
        x, y = np.isfinite(seen.angle[:, k]).T
        turned = seen.y_turned[:, k]
        counts = [x.sum(), y.sum(), x.sum(), (y & ~turned).sum(), (y & turned).sum()]
        stated = [
            sensor.x_bias_rad,
            sensor.y_bias_rad,
            sensor.x_scale,
            sensor.y_scale,
            sensor.y_turned_scale,
        ]

        def found(one: Calibration, k: int = k, stated: list[float | None] = stated) -> np.ndarray:
            scale = one.scale[k]
            return np.array(
                [
                    (stated[0] + one.bias[k, 0]) / scale[0],
                    (stated[1] + one.bias[k, 1]) / scale[1],
                    *((value or 0.0) / by for value, by in zip(stated[2:], scale, strict=True)),
                ]
            )

        value, sigma, prior = _carried(made, found)
        for i, (key, was) in enumerate(zip(SUN_KEYS, stated, strict=True)):
            if (
                was is not None
                and counts[i]
                and not (sensor.y_column is None and key.startswith("y"))
            ):
                one = (np.array([was]), value[i : i + 1], sigma[i : i + 1], prior[i : i + 1])
                yield Key(
                    ("sun_sensor", sensor.name),
                    key,
                    *one,
                    "rad" if i < 2 else "rad/reading",
                    int(counts[i]),
                )


# -------------------------------------------------------------------------------------------------------------------------- gyro


def _gyro(vehicle: Vehicle, telemetry: xr.Dataset, notes: list[str], progress: bool) -> list[Key]:
    gyro = vehicle.sensors.gyro
    assert gyro is not None
    try:
        found = rates(vehicle, telemetry.drop_vars("gyro_B"), progress=progress)
    except (InputError, MotionError) as error:
        notes.append(f"gyro: not determined, as without it there are no rates: {error}")
        return []
    fit = fit_gyro(gyro, telemetry, found)
    if fit is None:
        notes.append(
            f"gyro: not determined, as without it fewer than {FEWEST_PASSES} passes are decided"
        )
        return []
    notes.append(f"gyro: compared with {fit.passes} passes that are decided without it")
    return _gyro_keys(gyro, fit)


def _gyro_keys(gyro: Any, fit: GyroFit) -> list[Key]:
    zero, by = gyro.zero + gyro.sign * fit.values[:3] / gyro.scale_rad_s, fit.values[3]
    sigma = np.sqrt(np.maximum(np.diag(fit.model), np.diag(fit.robust)))
    size, one = abs(gyro.scale_rad_s), abs(gyro.scale_rad_s) / by**2
    return [
        Key(
            ("gyro",),
            "zero",
            gyro.zero,
            zero,
            sigma[:3] / size,
            fit.prior[:3] / size,
            "reading",
            fit.samples,
        ),
        Key(
            ("gyro",),
            "scale_rad_s",
            np.array([gyro.scale_rad_s]),
            np.array([gyro.scale_rad_s / by]),
            sigma[3:] * one,
            fit.prior[3:] * one,
            "rad/s",
            fit.samples,
        ),
    ]


# ------------------------------------------------------------------------------------------------------------------------ result


def _dataset(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    keys: list[Key],
    notes: list[str],
    attrs: dict[str, Any],
) -> xr.Dataset:
    epoch, time = str(telemetry.attrs["epoch_utc"]), telemetry["time"].values
    days = " to ".join(
        dict.fromkeys(utc_after(float(t), epoch)[:10] for t in (time.min(), time.max()))
    )
    columns: dict[str, list[Any]] = {
        name: []
        for name in (*FIELDS, "unit", "key", "component", "determined", "written", "samples")
    }
    for key in keys:
        known = key.sigma < NARROWER * key.prior
        for i in range(len(key.value)):
            for name, part in zip(
                FIELDS, (key.stated, key.value, key.sigma, key.prior), strict=True
            ):
                columns[name].append(float(part[i]))
            columns["key"].append(key.name)
            columns["component"].append(i)
            columns["unit"].append(key.unit)
            columns["determined"].append(bool(known[i]))
            columns["written"].append(bool(known.all()) if key.together is None else key.together)
            columns["samples"].append(key.samples)
    stated, value, sigma = (np.array(columns[name]) for name in ("stated", "value", "sigma"))
    moved = np.abs(value - stated) > sigma  # one that was not stated is new and has not moved
    file = telemetry.attrs.get("file", "telemetry")
    return xr.Dataset(
        {name: ("quantity", np.array(part)) for name, part in columns.items()}
        | {"moved": ("quantity", moved)},
        attrs=provenance("calibration", telemetry, vehicle=vehicle.name)
        | attrs
        | {
            "source": f"calibrate-sensors, {{samples}} samples of {file}, {days}",
            "notes": "\n".join(notes),
        },
    )


FIELDS = ("stated", "value", "sigma", "prior_sigma")
