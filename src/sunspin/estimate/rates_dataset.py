"""The result of `rates` as a Dataset: the numbers of the best solutions on time, and of all solutions by pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import printable
from sunspin.base.provenance import provenance
from sunspin.environment import Environment
from sunspin.environment.frames import FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimate.carry import RATE, TURN
from sunspin.estimate.dense import curve
from sunspin.estimate.images import either_side
from sunspin.estimate.model import Model
from sunspin.estimate.observe import (
    FileReadings,
    Pass,
    middle_sample,
    wheels_of_unknown_speed,
)
from sunspin.estimate.solutions import Solutions
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.field import FieldDirection, KnownField
from sunspin.estimate.terms.inertial import RateMagnitudes
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.verdict import (
    COLUMNS_STATED,
    COLUMNS_UNCHECKED,
    OTHER_SENSORS,
    AtOnce,
    PassRow,
    answers,
    join_reasons,
    misfit,
    padded,
    passes_table,
    spread_of,
)
from sunspin.solve.rotations import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    without_sign_jumps,
)
from sunspin.telemetry.assess import LOW_SHARE, Assessment
from sunspin.telemetry.gains import FAINT
from sunspin.telemetry.signals import signals
from sunspin.telemetry.units import reading_unit
from sunspin.vehicle import Vehicle

ROUNDING = 1e-3
"""A covariance is dominated by rounding errors if it has a negative variance of more than this part of its largest one. The part is
0.6 for a panel that hardly sees the Sun."""

ANY_DIRECTION_RAD = float(np.sqrt((np.pi**2 - 4) / 2))
"""Root mean square angle (rad) between a direction and one that is uniform on the sphere."""

OF_SCATTER = "the vehicle file states none: the scatter of readings in full Sun and the light on panels that face away"
"""Source of the noise of panel readings if none is stated."""

LEAST_PASSES, MOST_UNFITTED = 3, 0.5
"""Passes of a file, and the share of them that do not fit, from which on no pass of the file is decided."""

OTHERS_DO_NOT_FIT = "half of the passes do not fit"
"""Why a pass is then not decided although it fits."""

LATENCY = "late_s"
"""Name of the estimated latency of sensors other than the Sun's."""


def motion_dataset(
    assessment: Assessment,
    readings: FileReadings,
    passes: Sequence[Pass],
    solved: Sequence[Solutions],
    nominal: Model,
    torques_stated: bool,
) -> xr.Dataset:
    """Return the result of `rates` without its verdict: the best motion of each pass at all samples used, and all solutions.

    `solved`: the solutions of each of the `passes`, the most probable first. `nominal`: the nominal model under the most probable
    strength of torques of the whole file; `torques_stated`: whether the vehicle file or the user gives that strength.
    """
    used = np.concatenate([a_pass.samples for a_pass in passes])  # indices of samples of the file
    best = [of_pass.track.take(slice(0, 1)) for of_pass in solved]
    # one pass after the other along time
    attitude, omega, covariance, sun = (
        np.concatenate([getattr(track, name)[0] for track in best])
        for name in ("attitude", "omega", "covariance", "sun_B")
    )
    pass_of = np.repeat(np.arange(len(passes)), [len(a_pass.samples) for a_pass in passes])
    quaternion = without_sign_jumps(quaternion_from_matrix(attitude), pass_of)
    by_solution = ("pass_id", "solution")
    spread = [
        spread_of(of_pass.mean, of_pass.mean_sigma**2, of_pass.probability) for of_pass in solved
    ]
    result = xr.Dataset(
        {
            "omega_B": (("time", "axis"), omega),
            "omega_cov_B": (("time", "axis", "axis2"), covariance[:, RATE, RATE]),
            "sun_B": (("time", "axis"), sun),
            "sun_sigma_rad": ("time", _sun_sigma(sun, covariance[:, TURN, TURN])),
            "B_from_N": (("time", "quaternion"), quaternion),
            "pass_of": ("time", pass_of),
            "omega_mean_B": ((*by_solution, "axis"), padded([of_pass.mean for of_pass in solved])),
            "omega_sigma_B": (
                (*by_solution, "axis"),
                padded([of_pass.mean_sigma for of_pass in solved]),
            ),
            "omega_sigma_all_B": (("pass_id", "axis"), np.array(spread)),
            "cost": (by_solution, padded([of_pass.track.cost for of_pass in solved])),
            "cost_limit": ("pass_id", [of_pass.cost_limit for of_pass in solved]),
            "why": ("sample", readings.why.astype(np.str_)),
        },
        coords={
            "time": readings.obs.t_s[used],
            "sample": readings.obs.t_s,
            "axis": ["x", "y", "z"],
            "pass_id": [a_pass.number for a_pass in passes],
            "quaternion": ["x", "y", "z", "w"],
        },
        attrs=_attributes(assessment, readings, used, nominal, torques_stated),
    )
    return result.assign(_curves(solved, nominal))


def _attributes(
    assessment: Assessment,
    readings: FileReadings,
    used: np.ndarray,
    nominal: Model,
    torques_stated: bool,
) -> dict[str, Any]:
    """Return the attributes on the sensors that were used and on what was assumed; `used`: indices of the samples in a pass."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    panels = readings.obs.of_kind(Panels)
    earth_share = 0.0 if panels is None else panels.earth_share
    attrs: dict[str, Any] = provenance("rates", telemetry, **vehicle.result_attributes) | {
        "source": readings.source,
        "acceleration_noise": nominal.noise.acceleration,
        "max_rate_rad_s": nominal.rate_max,
        "acceleration_noise_from": "given" if torques_stated else "evidence of the data",
        "body": "nearly a sphere (no inertia)"
        if nominal.body.sphere
        else "rigid body with the vehicle's inertia and wheels",
        "earth_light": earth_share if earth_share > FAINT else 0.0,
        "frame_N": SUN_Z_LOCAL,
        "panels_left_out": "" if panels is None else ", ".join(panels.left_out),
    }
    if panels is not None and np.isfinite(panels.sigma).any():
        noise = vehicle.input_noise
        sigma = panels.sigma[np.isfinite(panels.sigma)]
        attrs["noise"] = float(np.median(sigma if noise is None else noise))
        attrs["noise_from"] = OF_SCATTER if noise is None else "given"
        # empty for relative readings
        attrs["noise_unit"] = reading_unit(vehicle, signals(telemetry))
    sensors = [
        term for term in readings.obs.terms if term.name in (*OTHER_SENSORS, RateMagnitudes.name)
    ]
    read = {term.name for term in sensors if term.present()[used].any()}
    attrs |= {f"{name}_used": int(name in read) for name in OTHER_SENSORS}
    if any(term.name == RateMagnitudes.name for term in readings.obs.terms):
        attrs["rate_size_used"] = int(RateMagnitudes.name in read)
    # a gyro measures the rate whatever the wheels do
    wheels = [] if attrs["gyro_used"] else wheels_of_unknown_speed(vehicle, telemetry)
    gains = assessment.doubtful_gains if readings.source == "panels" else {}
    return attrs | {
        "wheels_untold": ", ".join(wheels),
        "gains_unknown": ", ".join(name for name, share in gains.items() if share < LOW_SHARE),
    }


def _curves(solved: Sequence[Solutions], nominal: Model) -> dict[str, Any]:
    """Return the variables on `curve_time` (s), from which figures draw curves: the best motion of each pass at even intervals.

    Rates and their sigmas are in rad/s, body axes. `solved`: the solutions of each pass, the best first; `curve_pass_of` indexes
    it. `nominal`: its samples are replaced by those of each pass.
    """
    times, tracks = [], []
    for of_pass in solved:
        model = replace(nominal, obs=of_pass.obs)
        instants, track = curve(model, of_pass.track.take(slice(0, 1)), float(of_pass.noise[0]))
        times.append(instants)
        tracks.append(track)
    # of the only motion in each track, all passes in one array
    attitude, omega, covariance = (
        np.concatenate([getattr(track, name)[0] for track in tracks])
        for name in ("attitude", "omega", "covariance")
    )
    pass_of = np.repeat(np.arange(len(solved)), [len(instants) for instants in times])
    quaternion = without_sign_jumps(quaternion_from_matrix(attitude), pass_of)
    sigma = np.sqrt(np.einsum("nii->ni", covariance[:, RATE, RATE]))
    return {
        "curve_omega_B": (("curve_time", "axis"), omega),
        "curve_omega_sigma_B": (("curve_time", "axis"), sigma),
        "curve_B_from_N": (("curve_time", "quaternion"), quaternion),
        "curve_pass_of": ("curve_time", pass_of),
        "curve_time": np.concatenate(times),
    }


def latency_attributes(vehicle: Vehicle, solved: Sequence[Solutions]) -> dict[str, Any]:
    """Return the attributes on the latency of sensors other than the Sun's, estimated from all passes together.

    The estimate of each pass combines the prior of the vehicle file with its own readings: precisions 1 / sigma^2 add, and so do
    values times precisions. The prior counts once, and each pass adds what exceeds it.
    """
    clock = vehicle.sensors.clock
    late_s, sigma_s, source = np.nan, np.nan, "taken as read together"
    if clock is not None:
        late_s, sigma_s, source = clock.late_s, clock.sigma_s, "vehicle file"
    # unit, value and sigma of each pass that has the estimate
    rows = [of_pass.estimates[0][LATENCY] for of_pass in solved if LATENCY in of_pass.estimates[0]]
    if clock is not None and rows:
        _, values, sigmas = (np.array(part) for part in zip(*rows, strict=True))
        prior_precision = clock.sigma_s**-2
        prior_weighted = clock.late_s * prior_precision
        added_precision = np.maximum(sigmas**-2 - prior_precision, 0.0)
        weighted = prior_weighted + (values / sigmas**2 - prior_weighted).sum()
        sigma_s = (prior_precision + added_precision.sum()) ** -0.5
        late_s, source = weighted * sigma_s**2, "vehicle file and data"
    return {
        "sensors_late_s": float(late_s),
        "sensors_late_sigma_s": float(sigma_s),
        "sensors_late_from": source,
    }


def with_space_axes(
    result: xr.Dataset,
    local: Environment | None,
    solved: Sequence[Solutions],
    readings: FileReadings,
) -> xr.Dataset:
    """Return the result with what is known of the axes N in space from an orbit, or without a Sun from a magnetometer.

    With an orbit it has the sigma of the rotation about the Sun direction, and attitudes from J2000 if a magnetometer was used.
    With a magnetometer alone it has field directions instead of Sun directions. `local`: the environment in axes along the Sun.
    """
    if readings.obs.of_kind(FieldDirection) is not None:
        about = {"units": "1", "long_name": "direction of the magnetic field, smoothed"}
        return result.assign(
            field_direction_B=result["sun_B"].assign_attrs(about),
            sun_B=result["sun_B"] * np.nan,
            sun_sigma_rad=result["sun_sigma_rad"] * np.nan,
        ).assign_attrs(frame_N=FIELD_Z_LOCAL)
    if not isinstance(local, SunAlongZ):
        return result
    best = [of_pass.track.take(slice(0, 1)) for of_pass in solved]
    sun = np.concatenate([track.sun_B[0] for track in best])
    covariance = np.concatenate([track.covariance[0, :, TURN, TURN] for track in best])
    sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", sun, covariance, sun), 0.0))
    about = {"units": "rad", "long_name": "one sigma of the turn about the Sun"}
    orbit = local.orbit
    result = result.assign(turn_sigma_rad=("time", sigma, about)).assign_attrs(
        orbit=orbit.elements[0].number,
        orbit_name=printable(orbit.elements[0].name),
        orbit_shift_s=orbit.shift_s,
        orbit_drift_s_day=orbit.drift_s_day,
        orbit_shift_sigma_s=orbit.offset_sigma_s,
    )
    if readings.obs.of_kind(KnownField) is None:
        return result
    # The field shows the rotation about the Sun direction, so that attitudes are known in space: B_from_J2000 = B_from_N
    # N_from_J2000.
    from_J2000 = {}
    for name, time, pass_of in (
        ("B_from_N", "time", "pass_of"),
        ("curve_B_from_N", "curve_time", "curve_pass_of"),
    ):
        attitude = matrix_from_quaternion(result[name].values)
        attitude = attitude @ local.N_from_J2000(result[time].values)
        quaternion = quaternion_from_matrix(attitude)
        quaternion = without_sign_jumps(quaternion, result[pass_of].values)
        from_J2000[name] = (time, "quaternion"), quaternion
    return result.assign(from_J2000).assign_attrs(frame_N=J2000)


def _sun_sigma(sun: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the sigmas (n), rad, of Sun directions (n, 3) from covariances (n, 3, 3) of the attitude.

    If a covariance is only rounding errors, with negative variances, because readings determine too little, the sigma is that of
    any direction.
    """
    # Only rotations across the Sun direction s move it: the variance is the trace of P C P^T with P = I - s s^T.
    across = np.eye(3) - sun[:, :, None] * sun[:, None, :]
    variance = np.einsum("nij,njk,nik->n", across, covariance, across)
    values = np.linalg.eigvalsh((covariance + np.swapaxes(covariance, -1, -2)) / 2)
    is_rounding = (values[:, 0] < -ROUNDING * np.abs(values[:, -1])) | (variance <= 0)
    return np.where(is_rounding, ANY_DIRECTION_RAD, np.sqrt(np.maximum(variance, 0.0)))


def verdict_variables(
    passes: Sequence[Pass],
    solved: Sequence[Solutions],
    left_open_of: Sequence[str],
    rate_sigma: float,
    epoch_utc: str | None,
) -> dict[str, Any]:
    """Return the variables with the verdict on each pass (:func:`answers`), and its solutions at the sample nearest to mid-pass.

    `left_open_of`: what the search of each pass may have left out and what would help, in words; empty if nothing. `rate_sigma`
    (rad/s): prior sigma of a component of the rate.
    """
    sensors = sorted({name for of_pass in solved for name in of_pass.residual})
    misfits = np.full((len(solved), len(sensors), 3), np.nan)
    residual = np.full((len(sensors), sum(len(a_pass.samples) for a_pass in passes)), np.nan)
    rows, begin = [], 0  # index on `time` of the first sample of the pass
    for k, (of_pass, left_open) in enumerate(zip(solved, left_open_of, strict=True)):
        t_s = of_pass.obs.t_s
        mid = middle_sample(t_s)
        on_time = slice(begin, begin + len(t_s))
        begin += len(t_s)
        by_sensor = {}
        for name, residuals in of_pass.residual.items():
            of_best = residuals[0]  # of the most probable solution
            by_sensor[name] = misfit(of_best)
            misfits[k, sensors.index(name)] = by_sensor[name]
            residual[sensors.index(name), on_time] = of_best
        omega = of_pass.track.omega[:, mid]
        covariance = of_pass.track.covariance[:, mid, RATE, RATE]
        motions = AtOnce(of_pass.probability, omega, covariance, either_side(of_pass.track))
        explained = bool(of_pass.track.cost[0] <= of_pass.cost_limit)
        checks, speed = answers(
            motions, rate_sigma, by_sensor, explained, left_open, of_pass.denied[0]
        )
        sigma = np.sqrt(np.einsum("kii->ki", covariance))
        # Directions of one kind alone, of the Sun or of the field, do not confirm the columns: a reversed axis fits with the
        # mirrored motion, whose speed is the same.
        seen = SunDirections if of_pass.obs.of_kind(FieldDirection) is None else FieldDirection
        unconfirmed = set(by_sensor) <= {seen.label, RateMagnitudes.label}
        columns_checked = COLUMNS_UNCHECKED if unconfirmed else COLUMNS_STATED
        of_solutions = of_pass.probability, omega, sigma, speed, checks, columns_checked
        rows.append(PassRow(len(t_s), t_s[0], t_s[-1], t_s[mid], *of_solutions))
    return (
        passes_table(rows, epoch_utc)
        | _estimates([of_pass.estimates[0] for of_pass in solved])
        | {
            "misfit": (("pass_id", "sensor", "figure"), misfits),
            "residual": (("sensor", "time"), residual),
            "sensor": sensors,
            "figure": ["readings", "beyond", "chance"],
            "model": ("pass_id", [of_pass.model[0] for of_pass in solved]),
            "model_probability": ("pass_id", [of_pass.model[1] for of_pass in solved]),
        }
    )


def with_doubted_repeats(result: xr.Dataset, assessment: Assessment) -> xr.Dataset:
    """Return the result with each pass undecided whose readings may repeat held values (`Repeats.unsure`), and with the reason."""
    repeats = assessment.repeats
    repeated_s = assessment.telemetry["time"].values[repeats.unsure]
    passes_with_repeats = result["pass_of"].values[np.isin(result["time"].values, repeated_s)]
    decided, why = result["decided"].values.copy(), result["why_not_decided"].values.tolist()
    for k in np.unique(passes_with_repeats):
        decided[k] = False
        why[k] = join_reasons(why[k], repeats.doubt)
    return result.assign(decided=("pass_id", decided), why_not_decided=("pass_id", why))


def with_doubted_passes(result: xr.Dataset) -> xr.Dataset:
    """Return the result with no pass decided if half of the passes or more do not fit, of three or more; those that fit say why.

    What keeps a pass from fitting, such as wrong columns, mostly acts in all passes of a file, and some fit by chance: of a spinner
    whose magnetometer was read along other axes two of four passes were decided, 40 deg/s off. All 32 passes of skCUBE fit.
    """
    unfitted = ~result["fits"].values
    if len(unfitted) < LEAST_PASSES or unfitted.mean() < MOST_UNFITTED:
        return result
    why = [
        join_reasons(reason, "" if bad else OTHERS_DO_NOT_FIT)
        for reason, bad in zip(result["why_not_decided"].values, unfitted, strict=True)
    ]
    decided = np.zeros(len(unfitted), dtype=bool)
    return result.assign(decided=("pass_id", decided), why_not_decided=("pass_id", why))


def _estimates(best: Sequence[dict[str, tuple[str, float, float]]]) -> dict[str, Any]:
    """Return variables of the result: value, sigma and unit of each unknown that was estimated along with the best motions.

    `best`: for each pass, name of an unknown of its best motion -> unit, value and sigma. Passes may have different unknowns. Value
    and sigma are NaN in a pass that lacks an unknown.
    """
    units = {name: unit for of_pass in best for name, (unit, _, _) in of_pass.items()}
    names = list(units)
    value, sigma = np.full((2, len(best), len(names)), np.nan)
    for k, of_pass in enumerate(best):
        for name, (_, *numbers) in of_pass.items():
            value[k, names.index(name)], sigma[k, names.index(name)] = numbers
    return {
        "estimate_value": (("pass_id", "estimate"), value),
        "estimate_sigma": (("pass_id", "estimate"), sigma),
        "estimate_unit": ("estimate", list(units.values())),
        "estimate": names,
    }
