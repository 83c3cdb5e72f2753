"""Calibration of a vehicle's sensors by one telemetry file, as new values of keys of the vehicle file."""

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
from sunspin.estimate.orbit.calibration import (
    FEWEST,
    MOST_SAMPLES,
    SUN_KEYS,
    Calibration,
    fit_sensors,
    priors,
    with_common_sun_error,
)
from sunspin.estimate.orbit.check import OrbitCheck, Verdict, check_orbit
from sunspin.estimate.orbit.invariants import STUDENT
from sunspin.estimate.orbit.readings import Readings, orbit_readings
from sunspin.estimate.rates import rates
from sunspin.estimate.verdict import COLUMNS_DOUBTED, NARROWER
from sunspin.telemetry.assess import Assessment, assess
from sunspin.telemetry.gains import prior_sigmas, scale_gains
from sunspin.vehicle import Vehicle
from sunspin.vehicle.rewrite import NewValue
from sunspin.vehicle.sensors import Gyro
from sunspin.vehicle.timeline import utc_after

BLOCKS = 8
"""Number of parts of the file that a jackknife of the panels' gains leaves out in turn."""

SMALL = 1e-5
"""Step, in prior sigmas, of the finite differences by which errors are propagated to the keys of the file."""

GYRO_SCALE = 0.2
"""One sigma of a gyro's scale, relative to the stated one, if the vehicle file states none."""

GYRO_ROUNDS, NOISE_STEP = 8, (0.5, 3.0)
"""Alternations of a gyro's zero and scale with the size of the errors, and the limits of the factor by which the size changes in
one."""

FEWEST_PASSES = 3
"""A gyro is calibrated with no fewer passes, as nothing would show the errors of their rates. On one pass of five samples a torque
was fitted that did not exist, and the gyro's scale became 2.6 times too large, with a sigma of 0.6."""

VARIABLES = tuple(
    "stated value sigma prior_sigma unit key component determined written samples".split()
)
"""Variables of the result; the first four are numbers in the unit of the key."""


class Key(NamedTuple):
    """A calibrated key of the vehicle file with m components: `where` it is (table, name of the part), and its numbers (m).

    `stated`: in the file; `value`, `sigma`: estimated; `prior`: sigma before the data. `samples`: how many show it. `written`:
    whether the key goes into the file, for keys that make sense only together; None if it does once it is determined itself.
    """

    where: tuple[str, ...]
    key: str
    stated: np.ndarray
    value: np.ndarray
    sigma: np.ndarray
    prior: np.ndarray
    unit: str
    samples: int
    written: bool | None = None

    @property
    def determined(self) -> np.ndarray:
        """True (m) for components that the data constrain."""
        return self.sigma < NARROWER * self.prior


def calibrate_sensors(
    vehicle: Vehicle, telemetry: xr.Dataset, orbit: Orbit | None = None, *, progress: bool = False
) -> xr.Dataset:
    """Calibrate panels, Sun sensors, magnetometer and gyro by the telemetry itself; no attitude is needed.

    Gains of panels come from the brightness of samples in full Sun. In an orbit the strength of the field and its angle to the Sun
    are known: they determine zero, matrix and scale of the magnetometer, and bias and scale of each Sun sensor, for the whole file
    at once, with the along-track offset. The gyro is compared with the rates of passes that are decided without it.

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
        its sigma). attrs: `source` for the vehicle file, `notes`, the along-track offset, residuals before and after.

    Raises
    ------
    InputError
        The elements do not fit the telemetry, the field is read with other signs or axes, or there is nothing to calibrate.
    """
    notes: list[str] = []
    keys: list[Key] = []
    attrs: dict[str, Any] = {}
    calibrated = vehicle
    if "panel" in telemetry.coords:
        keys, calibrated = _panel_keys(assess(vehicle, telemetry), notes)
    if "field_B" in telemetry or "sun_sensor_angle" in telemetry:
        assessment = assess(calibrated, telemetry)
        readings = orbit_readings(assessment, MOST_SAMPLES)
        fitted = _fit_in_orbit(assessment, orbit, readings, notes)
        if fitted is not None and orbit is not None:
            keys += _magnetometer_keys(vehicle, fitted, notes)
            keys += _sun_sensor_keys(vehicle, readings, fitted)
            attrs = _fit_attributes(fitted, orbit)
    if "gyro_B" in telemetry and vehicle.sensors.gyro is not None:
        keys += _gyro_by_rates(vehicle.sensors.gyro, vehicle, telemetry, notes, progress)
    if not keys and not notes:
        raise InputError(
            "the telemetry has nothing that can be calibrated",
            do="it needs columns of panels, Sun sensors, magnetometer or gyro that the vehicle names",
        )
    return _dataset(vehicle, telemetry, keys, notes, attrs)


def new_values(result: xr.Dataset) -> list[NewValue]:
    """Return the new values of keys of the vehicle file, for :func:`sunspin.vehicle.rewrite.rewrite_values`.

    `result`: of :func:`calibrate_sensors`, with an entry for each component of a key. Keys that are not `written` are left out.
    """
    values = []
    for name in dict.fromkeys(result["key"].values.tolist()):
        part = result.isel(quantity=np.flatnonzero(result["key"].values == name))
        if not part["written"].values.all():
            continue
        # magnetometer.zero is table.key, panel.PX.gain_W is table.part.key; the name of a part may have dots
        table, _, rest = name.partition(".")
        part_name, _, key = rest.rpartition(".")
        where = (table, part_name) if part_name else (table,)
        value, sigma = (_in_toml(part[column].values) for column in ("value", "sigma"))
        source = str(result.attrs["source"]).format(samples=int(part["samples"].values[0]))
        values.append(NewValue(where, key, value, sigma, source))
    return values


def _in_toml(numbers: np.ndarray) -> Any:
    """Return numbers (m) as a vehicle file has them, with six digits: one number, a vector, or the rows of a matrix (m = 9)."""
    rounded = [float(f"{x:.6g}") for x in numbers]
    if len(rounded) == 1:
        return rounded[0]
    return rounded if len(rounded) != 9 else [rounded[:3], rounded[3:6], rounded[6:]]


def _panel_keys(assessment: Assessment, notes: list[str]) -> tuple[list[Key], Vehicle]:
    """Return the keys of the panels' gains, none with a note if they are not determined, and the vehicle with these gains."""
    vehicle, telemetry, quality = assessment.vehicle, assessment.telemetry, assessment.quality
    if vehicle.channels:
        notes.append("gains of panels: an input that panels share does not tell the gain of each")
        return [], vehicle
    if not np.isfinite(quality.attrs["spread"]):  # the telemetry does not determine the gains
        notes.append(f"gains of panels: {quality.attrs['gains_from']}")
        return [], vehicle
    stated, gain = vehicle.panel_gains, quality["gain"].values
    # Jackknife: leave out each part of the file in turn, as errors of the brightness last for a pass.
    samples, gains_without = np.arange(telemetry.sizes["time"]), []
    for block in np.array_split(samples, BLOCKS):
        rest = telemetry.isel(time=np.setdiff1d(samples, block))
        gains_without.append(assess(vehicle, rest).quality["gain"].values)
    deviation = np.array(gains_without) - np.mean(gains_without, axis=0)
    jackknife = np.sqrt((1 - 1 / BLOCKS) * (deviation**2).sum(axis=0))
    sigma = np.maximum(np.sqrt(np.diag(quality["gain_cov"].values)), jackknife)
    prior = prior_sigmas(vehicle) * stated
    name = {"W": "gain_W", "A": "gain_A", None: "relative_gain"}[vehicle.gain_unit]
    unit, count = vehicle.gain_unit or "1", int((quality["use"].values == 0).sum())
    # (n_panel, 4, 1): a key has arrays of its components, here one
    numbers = np.stack([stated, gain, sigma, prior], axis=1)[..., None]
    keys = [
        Key(("panel", panel.name), name, old, new, error, before, unit, count)
        for panel, (old, new, error, before) in zip(vehicle.panels, numbers, strict=True)
    ]
    return keys, scale_gains(vehicle, gain / stated)


# ---------------------------------------------------------------------------------------------------------------------- in an orbit


def _fit_in_orbit(
    assessment: Assessment, orbit: Orbit | None, readings: Readings, notes: list[str]
) -> Calibration | None:
    """Return magnetometer and Sun sensors fitted along the orbit; None, with a note, if the data do not determine them.

    Raises InputError for an orbit that the telemetry contradicts. With Sun sensors the check may have made this fit already.
    """
    vehicle = assessment.vehicle
    what = "magnetometer and Sun sensors" if vehicle.sensors.sun_sensors else "magnetometer"
    if orbit is None:
        notes.append(
            f"{what}: not determined without an orbit, in which strength and direction of the field are known"
        )
        return None
    check = check_orbit(orbit, vehicle, assessment)
    _require_consistent(check)
    notes.append(f"orbit: {check.verdict.value}")
    start = check.start(orbit)  # the magnetometer as the check fitted it, None if it did not
    if start is not None and readings.has_field.any():
        fitted = check.fitted_sensors or fit_sensors(
            orbit, vehicle, readings, start, priors(vehicle, readings, orbit)
        )
        if fitted.samples["field"] + fitted.samples["field and Sun"] >= FEWEST:
            return with_common_sun_error(fitted, assessment)
    notes.append(f"{what}: not determined, too few samples show the field")
    return None


def _require_consistent(check: OrbitCheck) -> None:
    """Raise InputError if the check forbids a calibration: wrong elements, or a magnetometer with another sign or other axes."""
    if check.verdict is Verdict.REFUSED:
        ranked = f"{check.better} of {check.copies} orbits at random predict better"
        raise InputError(
            "the elements do not fit the telemetry, which cannot be calibrated with them",
            got=str(check.sun_in_shadow) or ranked,
            do="give the right elements, or calibrate without any",
        )
    if check.sign_turned:
        raise InputError(
            "the magnetometer has the opposite sign, as its angle to the Sun shows, and is not calibrated so",
            do="change the sign of `matrix` in the vehicle file: -1 in place of 1 on the diagonal if it has none",
        )
    if check.turned_axes:
        what, _, do = check.turned_axes.partition("; ")
        raise InputError(f"{what}, and is not calibrated so", do=do)


def _fit_attributes(fitted: Calibration, orbit: Orbit) -> dict[str, Any]:
    """Return the attributes of the result for a fit along the orbit: offset, drift, residuals before and after, noise."""
    return {
        "shift_s": orbit.shift_s + fitted.shift_s,
        "shift_sigma_s": fitted.shift_sigma_s,
        "drift_s_day": orbit.drift_s_day + fitted.drift_s_day,
        "drift_sigma_s_day": fitted.drift_sigma_s_day,
        "field_residual_before_T": fitted.strength[0],
        "field_residual_after_T": fitted.strength[1],
        "sun_field_residual_before_rad": fitted.angle[0],
        "sun_field_residual_after_rad": fitted.angle[1],
        "field_noise_T": fitted.noise_T,
        "sun_noise": fitted.sun_noise,
    }


def propagated(
    fitted: Calibration, quantity: Callable[[Calibration], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the m numbers that `quantity` computes from a calibration, their sigmas, and their sigmas before the data: (m) each.

    Errors are propagated linearly: a covariance C of the unknowns becomes S C S^T, with the derivatives S (m, D) from differences.
    A sigma is the larger one of that by the curvature and that by the jackknife over parts of the file; to it comes, in squares,
    that by the error which all directions to the Sun have in common.
    """
    value, columns = quantity(fitted), []
    for k, step in enumerate(SMALL * np.sqrt(np.diag(fitted.prior))):
        changed = fitted.values.copy()
        changed[k] += step
        columns.append((quantity(replace(fitted, values=changed)) - value) / step)
    slope = np.stack(columns, axis=1)
    # roots of the diagonal of S C S^T; one that is zero may be rounded below it
    by_curvature, by_jackknife, by_common, prior = (
        np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", slope, covariance, slope), 0.0))
        for covariance in (fitted.by_curvature, fitted.by_jackknife, fitted.by_common, fitted.prior)
    )
    return value, np.hypot(np.maximum(by_curvature, by_jackknife), by_common), prior


def _magnetometer_keys(vehicle: Vehicle, fitted: Calibration, notes: list[str]) -> list[Key]:
    """Return the keys of the magnetometer, field = scale_T matrix (column - zero); none without readings of it.

    A note is added to `notes` if the rotation of its axes is not determined.

    `fitted.matrix_T` (3, 3) is scale and matrix together, relative to the matrix of the file. The product of both is split into a
    rotation and a stretch (polar decomposition), and the stretch into its scale, the cube root of the determinant, and the rest.
    """
    stated, n = vehicle.sensors.magnetometer, fitted.samples["field"]
    if stated is None or not n:
        return []

    def zero(calibration: Calibration) -> np.ndarray:
        """Return the zero (3) in the unit of the columns: the telemetry holds matrix times (column - zero)."""
        return stated.zero + stated.sign * np.linalg.solve(stated.matrix, calibration.zero)

    def rotation_and_stretch(calibration: Calibration) -> tuple[np.ndarray, np.ndarray]:
        """Return the rotation vector (3) of the axes, and the symmetric stretch (3, 3) before it, in T for a unit of a column."""
        rotation, stretch = polar(calibration.matrix_T @ stated.matrix, side="right")
        return Rotation.from_matrix(rotation).as_rotvec(), stretch

    def scale(calibration: Calibration) -> np.ndarray:
        """Return the scale (1) in T for a unit of a column."""
        return np.array([np.cbrt(np.linalg.det(rotation_and_stretch(calibration)[1]))])

    # Strengths alone, without the Sun, do not determine the rotation of the axes: then the matrix is the stretch alone.
    _, sigma, prior = propagated(fitted, lambda calibration: rotation_and_stretch(calibration)[0])
    axes_known = bool((sigma < NARROWER * prior).all())
    if not axes_known:
        notes.append(
            "matrix of the magnetometer: determined up to a rotation of its axes, which only the Sun shows"
        )

    def matrix(calibration: Calibration) -> np.ndarray:
        """Return the matrix (9), by rows, without its scale."""
        stretch = rotation_and_stretch(calibration)[1]
        whole = calibration.matrix_T @ stated.matrix if axes_known else stretch
        return (whole / scale(calibration)).ravel()

    where = ("magnetometer",)
    stated_scale = np.array([np.nan if stated.scale_T is None else stated.scale_T])
    keys = [
        Key(where, "zero", stated.zero, *propagated(fitted, zero), "reading", n),
        Key(where, "matrix", stated.matrix.ravel(), *propagated(fitted, matrix), "1", n),
        Key(where, "scale_T", stated_scale, *propagated(fitted, scale), "T", n),
    ]
    all_determined = all(key.determined.all() for key in keys)
    if stated.noise is None:
        noise = np.array([fitted.noise_T]) / scale(fitted)
        # stated, value, sigma of a standard deviation by n samples, prior
        numbers = (np.array([np.nan]), noise, noise / np.sqrt(2 * n), noise)
        keys.append(Key(where, "noise", *numbers, "reading", n))
    return [key._replace(written=all_determined) for key in keys]


def _sun_sensor_keys(vehicle: Vehicle, readings: Readings, fitted: Calibration) -> Iterator[Key]:
    """Yield the keys of Sun sensors that have readings: true angle = scale reading - bias.

    The fit is relative to the angle (scale reading - bias) by the keys stated in the file: true angle = (angle - fitted bias) /
    fitted scale. So the new scale is stated scale / fitted scale, and the new bias (stated + fitted bias) / fitted scale.
    """
    biases, scales = slice(0, 2), slice(2, 5)  # of SUN_KEYS
    for k, sensor in enumerate(vehicle.sensors.sun_sensors):
        x_read, y_read = np.isfinite(readings.angle[:, k]).T
        wraps = readings.y_turned[:, k]
        # samples that show each of SUN_KEYS
        shown_by = (x_read, y_read, x_read, y_read & ~wraps, y_read & wraps)
        stated = np.array([getattr(sensor, key) for key in SUN_KEYS], dtype=float)  # None: NaN

        def corrected_keys(
            calibration: Calibration, k: int = k, stated: np.ndarray = stated
        ) -> np.ndarray:
            """Return the values (5) of SUN_KEYS of sensor k by a calibration."""
            bias = (stated[biases] + calibration.bias[k]) / calibration.scale[k, :2]
            return np.concatenate([bias, stated[scales] / calibration.scale[k]])

        # stated, value, sigma and prior of each key (5, 4, 1): a key has arrays of its components, here one
        numbers = np.stack([stated, *propagated(fitted, corrected_keys)], axis=1)[..., None]
        for key, samples, of_key in zip(SUN_KEYS, shown_by, numbers, strict=True):
            has_column = sensor.y_column is not None or not key.startswith("y")
            if has_column and samples.any() and np.isfinite(of_key[0, 0]):
                unit = "rad" if key.endswith("bias_rad") else "rad/reading"
                where, count = ("sun_sensor", sensor.name), int(samples.sum())
                old, new, error, before = of_key
                yield Key(where, key, old, new, error, before, unit, count)


# ----------------------------------------------------------------------------------------------------------------------------- gyro


class GyroFit(NamedTuple):
    """Zero of each axis and scale of a gyro, `values` (4): reading = scale rate + zero, in rad/s, the reading by the vehicle file.

    `sigma` (4): the larger one of those by the curvature and by the scatter between passes; `prior`: sigmas before the data (4);
    numbers of samples and passes.
    """

    values: np.ndarray
    sigma: np.ndarray
    prior: np.ndarray
    samples: int
    passes: int


def fit_gyro(gyro: Gyro, telemetry: xr.Dataset, result: xr.Dataset) -> GyroFit | None:
    """Return zero and scale of a gyro by the passes whose rates are known without it; None if they are too few.

    `result`: of `rates` without the gyro. Weighted least squares of reading = scale rate + zero. Errors of the samples of a pass
    along one axis are correlated: that of the rate is taken as common to all of them, and each reading adds its noise. The readings
    of one axis in one pass share a weight by Student's law. One factor on all errors is estimated alternately with the unknowns.
    """
    # the gyro's reading at each sample of the result
    times, first = np.unique(telemetry["time"].values, return_index=True)
    index = np.clip(np.searchsorted(times, result["time"].values), 0, len(times) - 1)
    reading = telemetry["gyro_B"].values[first[index]]
    use = rate_known(result)[result["pass_of"].values]
    use &= np.isfinite(reading).all(axis=1) & (times[index] == result["time"].values)
    reading, pass_of = reading[use], result["pass_of"].values[use]
    rate, covariance_B = result["omega_B"].values[use], result["omega_cov_B"].values[use]
    passes = np.unique(pass_of)
    if len(passes) < FEWEST_PASSES:
        return None

    # unknowns: the zero of each axis (0 to 2), and the scale relative to the stated one (3)
    stated_sigma = np.abs(gyro.scale_rad_s * gyro.zero_sigma)
    usual = float(np.sqrt((reading**2).mean()))  # one sigma of a zero without a stated one
    scale_sigma = gyro.scale_sigma / abs(gyro.scale_rad_s) or GYRO_SCALE
    prior = np.append(np.where(stated_sigma > 0, stated_sigma, usual), scale_sigma)
    centre = np.array([0.0, 0.0, 0.0, 1.0])  # of the prior
    values, covariance, factor = centre, np.diag(prior**2), 1.0
    for _ in range(GYRO_ROUNDS):
        # sums over passes and axes: normal equations, gradients of each pass, weighted squares and their number
        normal, right = np.diag(prior**-2.0), prior**-2.0 * centre
        gradients, squares, count = np.zeros((len(passes), 4)), 0.0, 0
        for k, number in enumerate(passes):
            rows = pass_of == number
            for axis in range(3):
                sigma = np.sqrt(covariance_B[rows, axis, axis])
                errors = gyro.noise_rad_s**2 * np.eye(len(sigma)) + np.outer(sigma, sigma)
                whitening = np.linalg.inv(np.linalg.cholesky(factor**2 * errors))
                design = np.zeros((len(sigma), 4))
                design[:, axis], design[:, 3] = 1.0, rate[rows, axis]
                design, target = whitening @ design, whitening @ reading[rows, axis]
                residual = design @ values - target
                weight = (STUDENT + len(residual)) / (STUDENT + residual @ residual)
                normal += weight * design.T @ design
                right = right + weight * design.T @ target
                gradients[k] += weight * design.T @ residual
                squares, count = squares + weight * residual @ residual, count + len(residual)
        covariance = np.linalg.inv(normal)
        values = covariance @ right
        factor *= float(np.clip(np.sqrt(squares / max(count - 4, 1)), *NOISE_STEP))  # 4 unknowns
    # the sandwich estimate of the covariance, with the scatter of the passes' gradients in the middle
    scatter = gradients.T @ gradients * len(passes) / (len(passes) - 1) + np.diag(prior**-2.0)
    robust = covariance @ scatter @ covariance
    sigma = np.sqrt(np.maximum(np.diag(covariance), np.diag(robust)))
    return GyroFit(values, sigma, prior, int(use.sum()), len(passes))


def rate_known(result: xr.Dataset) -> np.ndarray:
    """Return whether the rate vector of each pass (n_pass) is known well enough to calibrate a gyro with it.

    It is if the pass is decided, or if only the check of the speed fails. A body that hardly rotates has well-known components near
    zero, and a speed smaller than its error: it shows the zero of a gyro as well as any. Its columns must not be doubtful.
    """
    decided = np.asarray(result["decided"].values)
    if "constrained_speed" not in result:
        return decided
    checks = ("unique", "fits", "search_complete", *(f"constrained_{axis}" for axis in "xyz"))
    all_but_speed = np.all([result[name].values for name in checks], axis=0)
    return decided | (all_but_speed & (result["columns_checked"].values != COLUMNS_DOUBTED))


def _gyro_by_rates(
    gyro: Gyro, vehicle: Vehicle, telemetry: xr.Dataset, notes: list[str], progress: bool
) -> list[Key]:
    """Return the keys of the gyro by the rates without it; none, with a note, if these do not determine them."""
    try:
        result = rates(
            vehicle, telemetry.drop_vars("gyro_B"), column_tests=False, progress=progress
        )
    except (InputError, MotionError) as error:
        notes.append(f"gyro: not determined, as without it there are no rates: {error}")
        return []
    fit = fit_gyro(gyro, telemetry, result)
    if fit is None:
        notes.append(
            f"gyro: not determined, as without it fewer than {FEWEST_PASSES} passes are decided"
        )
        return []
    notes.append(f"gyro: compared with {fit.passes} passes that are decided without it")
    return gyro_keys(gyro, fit)


def gyro_keys(gyro: Gyro, fit: GyroFit) -> list[Key]:
    """Return the keys of a gyro by its fit: rate = scale_rad_s (column - zero), with the sign of each column.

    The reading by the file, stated scale_rad_s (column - stated zero), is fitted as scale rate + zero. So the new scale_rad_s is
    the stated one / scale, and the fitted zero / stated scale_rad_s is added to the stated zero.
    """
    scale, size = fit.values[3], abs(gyro.scale_rad_s)
    zero = gyro.zero + gyro.sign * fit.values[:3] / gyro.scale_rad_s
    of_zero = (gyro.zero, zero, fit.sigma[:3] / size, fit.prior[:3] / size)
    # a change d of the fitted scale changes stated / scale by stated / scale^2 d
    stated, slope = np.array([gyro.scale_rad_s]), size / scale**2
    of_scale = (stated, stated / scale, fit.sigma[3:] * slope, fit.prior[3:] * slope)
    return [
        Key(("gyro",), "zero", *of_zero, "reading", fit.samples),
        Key(("gyro",), "scale_rad_s", *of_scale, "rad/s", fit.samples),
    ]


# --------------------------------------------------------------------------------------------------------------------------- result


def _dataset(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    keys: list[Key],
    notes: list[str],
    attrs: dict[str, Any],
) -> xr.Dataset:
    """Return the result: an entry for each component of each key, with the variables :data:`VARIABLES` and `moved`."""
    rows: list[tuple[Any, ...]] = []  # in the order of VARIABLES
    for key in keys:
        determined, name = key.determined, ".".join((*key.where, key.key))
        written = bool(determined.all()) if key.written is None else key.written
        numbers = zip(key.stated, key.value, key.sigma, key.prior, determined, strict=True)
        for component, (*four_numbers, is_determined) in enumerate(numbers):
            row = (*four_numbers, key.unit, name, component, is_determined, written, key.samples)
            rows.append(row)
    columns = zip(*rows, strict=True) if rows else [()] * len(VARIABLES)
    values = {name: np.array(part) for name, part in zip(VARIABLES, columns, strict=True)}
    variables = {name: ("quantity", part) for name, part in values.items()}
    # a number that was not stated is NaN: the comparison is false, it has not moved
    moved = np.abs(values["value"] - values["stated"]) > values["sigma"]
    variables["moved"] = ("quantity", moved)
    epoch, time = str(telemetry.attrs["epoch_utc"]), telemetry["time"].values
    days = dict.fromkeys(utc_after(float(t), epoch)[:10] for t in (time.min(), time.max()))
    file = telemetry.attrs.get("file", "telemetry")
    # `{samples}` stays in the text: `new_values` fills in the number of each key
    source = f"calibrate-sensors, {{samples}} samples of {file}, {' to '.join(days)}"
    described = provenance("calibration", telemetry, vehicle=vehicle.name) | attrs
    return xr.Dataset(variables, attrs=described | {"source": source, "notes": "\n".join(notes)})
