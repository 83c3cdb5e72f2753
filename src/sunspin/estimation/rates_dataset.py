"""The result of `rates` as a Dataset: the numbers of the best solutions on time, and of all solutions by pass."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import printable
from sunspin.base.provenance import provenance
from sunspin.environment import Environment
from sunspin.environment.frames import FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimation.dense import curve
from sunspin.estimation.images import either_side
from sunspin.estimation.model import Model
from sunspin.estimation.observe import FileReadings, Pass, wheels_untold
from sunspin.estimation.solutions import Solutions
from sunspin.estimation.terms.field import FieldDirection, KnownField
from sunspin.estimation.terms.panels import Panels
from sunspin.estimation.terms.rate_size import RateSize
from sunspin.estimation.verdict import (
    COLUMNS_STATED,
    COLUMNS_UNCHECKED,
    OTHER_SENSORS,
    PassRow,
    answers,
    misfit,
    padded,
    passes_table,
)
from sunspin.solve.rotations import without_sign_jumps
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.gains import FAINT
from sunspin.vehicle import Vehicle

ROUNDING = 1e-3
"""Negative part of a covariance's largest variance beyond which it is rounding: 0.6 for a panel that hardly sees the Sun."""

ANY_DIRECTION_RAD = float(np.sqrt((np.pi**2 - 4) / 2))
"""Rms angle between a direction and one that may be any."""

OF_SCATTER = "the vehicle file states none: the scatter of readings in full Sun and the light on panels that face away"
"""Where the error of panel readings comes from without a stated noise."""

CLOCK = "late_s"
"""Name of the estimate of how late sensors other than the Sun's are."""


def dataset(
    assessment: Assessment,
    seen: FileReadings,
    why: np.ndarray,
    passes: Sequence[Pass],
    solved: Sequence[Solutions],
    stated: Model,
    noise_stated: bool,
) -> xr.Dataset:
    """Return the numbers of all passes.

    `why` (n): what became of each sample of the file; `stated`: the nominal model, under the strength of torques that the file
    as a whole has.
    """
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    index = np.concatenate([one.samples for one in passes])
    best = [one.track.take(slice(0, 1)) for one in solved]
    attitude, omega, covariance, sun = (
        np.concatenate([getattr(track, name)[0] for track in best])
        for name in ("attitude", "omega", "covariance", "sun_B")
    )
    pass_of = np.repeat(np.arange(len(passes)), [len(one.samples) for one in passes])
    quaternion = without_sign_jumps(Rotation.from_matrix(attitude).as_quat(), pass_of)
    each = ("pass_id", "solution")
    spread = [spread_of(one.mean, one.mean_sigma, one.probability) for one in solved]
    result = xr.Dataset(
        {
            "omega_B": (("time", "axis"), omega),
            "omega_cov_B": (("time", "axis", "axis2"), covariance[:, 3:, 3:]),
            "sun_B": (("time", "axis"), sun),
            "sun_sigma_rad": ("time", _sun_sigma(sun, covariance[:, :3, :3])),
            "B_from_N": (("time", "quaternion"), quaternion),
            "pass_of": ("time", pass_of),
            "omega_mean_B": ((*each, "axis"), padded([one.mean for one in solved])),
            "omega_sigma_B": ((*each, "axis"), padded([one.mean_sigma for one in solved])),
            "omega_sigma_all_B": (("pass_id", "axis"), np.array(spread)),
            "cost": (each, padded([one.track.cost for one in solved])),
            "cost_limit": ("pass_id", [one.cost_limit for one in solved]),
            "why": ("sample", why.astype(np.str_)),
        },
        coords={
            "time": seen.obs.t_s[index],
            "sample": seen.obs.t_s,
            "axis": ["x", "y", "z"],
            "pass_id": np.arange(len(passes)),
            "quaternion": ["x", "y", "z", "w"],
        },
        attrs=_attributes(vehicle, telemetry, seen, index, stated, noise_stated),
    )
    return result.assign(_curves(solved, stated))


def _attributes(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    seen: FileReadings,
    used: np.ndarray,
    stated: Model,
    noise_stated: bool,
) -> dict[str, Any]:
    """Return what was used and believed."""
    panels = [term for term in seen.obs.terms if isinstance(term, Panels)]
    attrs: dict[str, Any] = provenance("rates", telemetry, **vehicle.result_attributes) | {
        "source": seen.source,
        "acceleration_noise": stated.noise.acceleration,
        "max_rate_rad_s": 2 * stated.rate_sigma,
        "acceleration_noise_from": "given" if noise_stated else "evidence of the data",
        "body": "nearly a sphere (no inertia)"
        if stated.body.sphere
        else "rigid body with the vehicle's inertia and wheels",
        "earth_light": max(
            (term.earth_share for term in panels if term.earth_share > FAINT), default=0.0
        ),
        "frame_N": SUN_Z_LOCAL,
        "panels_left_out": ", ".join(name for term in panels for name in term.left_out),
    }
    sigmas = [term.sigma[np.isfinite(term.sigma)] for term in panels]
    if sigmas and len(sigmas[0]):
        noise = vehicle.input_noise
        attrs["noise"] = float(np.median(sigmas[0] if noise is None else noise))
        attrs["noise_from"] = OF_SCATTER if noise is None else "given"
    sensors = [term for term in seen.obs.terms if term.name in (*OTHER_SENSORS, RateSize.name)]
    read = {term.name for term in sensors if term.present()[used].any()}
    attrs |= {f"{name}_used": int(name in read) for name in OTHER_SENSORS}
    if any(term.name == RateSize.name for term in seen.obs.terms):
        attrs["rate_size_used"] = int(RateSize.name in read)
    untold = [] if attrs["gyro_used"] else wheels_untold(vehicle, telemetry)
    return attrs | {"wheels_untold": ", ".join(untold)}


def _curves(solved: Sequence[Solutions], stated: Model) -> dict[str, Any]:
    """Return variables of the best motion of each pass on even instants between its samples."""
    times, tracks = [], []
    for one in solved:
        model = replace(stated, obs=one.obs)
        instants, track = curve(model, one.track.take(slice(0, 1)), float(one.noise[0]))
        times.append(instants)
        tracks.append(track)
    attitude, omega, covariance = (
        np.concatenate([getattr(track, name)[0] for track in tracks])
        for name in ("attitude", "omega", "covariance")
    )
    pass_of = np.repeat(np.arange(len(solved)), [len(instants) for instants in times])
    quaternion = without_sign_jumps(Rotation.from_matrix(attitude).as_quat(), pass_of)
    sigma = np.sqrt(np.einsum("nii->ni", covariance[:, 3:, 3:]))
    return {
        "curve_omega_B": (("curve_time", "axis"), omega),
        "curve_omega_sigma_B": (("curve_time", "axis"), sigma),
        "curve_B_from_N": (("curve_time", "quaternion"), quaternion),
        "curve_pass_of": ("curve_time", pass_of),
        "curve_time": np.concatenate(times),
    }


def latency_attributes(vehicle: Vehicle, solved: Sequence[Solutions]) -> dict[str, Any]:
    """Return attributes on the clock of sensors other than the Sun's, by all passes together.

    Each pass knows the latency from the vehicle file and its own readings. What it adds is weighed with what the others add.
    """
    clock = vehicle.sensors.clock
    if clock is None:
        late, sigma, words = np.nan, np.nan, "taken as read together"
    else:
        late, sigma, words = clock.late_s, clock.sigma_s, "vehicle file"
    rows = [one.estimates[0][CLOCK] for one in solved if CLOCK in one.estimates[0]]
    if rows and clock is not None:
        values, sigmas = (np.array([row[k] for row in rows]) for k in (1, 2))
        added = np.maximum(sigmas**-2 - sigma**-2, 0.0)
        # a pass has the mean of what it knew and what it has read, with the precision of both
        weighted = clock.late_s * sigma**-2 + (values / sigmas**2 - clock.late_s * sigma**-2).sum()
        sigma = (sigma**-2 + added.sum()) ** -0.5
        late, words = weighted * sigma**2, "vehicle file and data"
    return {
        "sensors_late_s": float(late),
        "sensors_late_sigma_s": float(sigma),
        "sensors_late_from": words,
    }


def in_space(
    result: xr.Dataset, local: Environment | None, solved: Sequence[Solutions], seen: FileReadings
) -> xr.Dataset:
    """Return the result with what an orbit, or a field that stands for the Sun, says of the axes.

    In an orbit it has the turn about the Sun with its sigma, and if a magnetometer was used attitudes from J2000. A magnetometer
    alone gives directions of the field in place of the Sun's.
    """
    if any(isinstance(term, FieldDirection) for term in seen.obs.terms):
        about = {"units": "1", "long_name": "direction of the magnetic field, smoothed"}
        return result.assign(
            field_direction_B=result["sun_B"].assign_attrs(about),
            sun_B=result["sun_B"] * np.nan,
            sun_sigma_rad=result["sun_sigma_rad"] * np.nan,
        ).assign_attrs(frame_N=FIELD_Z_LOCAL)
    if not isinstance(local, SunAlongZ):
        return result
    best = [one.track.take(slice(0, 1)) for one in solved]
    sun = np.concatenate([track.sun_B[0] for track in best])
    covariance = np.concatenate([track.covariance[0, :, :3, :3] for track in best])
    sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", sun, covariance, sun), 0.0))
    about = {"units": "rad", "long_name": "one sigma of the turn about the Sun"}
    orbit = local.orbit
    result = result.assign(turn_sigma_rad=("time", sigma, about)).assign_attrs(
        orbit=orbit.elements[0].number,
        orbit_name=printable(orbit.elements[0].name),
        orbit_shift_s=orbit.shift_s,
        orbit_drift_s_day=orbit.drift_s_day,
        orbit_shift_sigma_s=float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s)),
    )
    if not any(isinstance(term, KnownField) for term in seen.obs.terms):
        return result
    turned = {}
    for name, time, pass_of in (
        ("B_from_N", "time", "pass_of"),
        ("curve_B_from_N", "curve_time", "curve_pass_of"),
    ):
        attitude = Rotation.from_quat(result[name].values).as_matrix()
        attitude = attitude @ local.N_from_J2000(result[time].values)
        quaternion = Rotation.from_matrix(attitude).as_quat()
        quaternion = without_sign_jumps(quaternion, result[pass_of].values)
        turned[name] = (time, "quaternion"), quaternion
    return result.assign(turned).assign_attrs(frame_N=J2000)


def spread_of(mean: np.ndarray, sigma: np.ndarray, probability: np.ndarray) -> np.ndarray:
    """Return one sigma (3) about the best of K solutions' rates (K, 3) with all solutions counted."""
    share = (probability / probability.sum())[:, None]
    return np.sqrt((share * (sigma**2 + (mean - mean[0]) ** 2)).sum(axis=0))


def _sun_sigma(sun: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return one sigma (n) in rad of directions of the Sun (n, 3) from covariances (n, 3, 3) of the attitude.

    If readings determine so little that a covariance is rounding, with negative variances, the direction may be any.
    """
    across = np.eye(3) - sun[:, :, None] * sun[:, None, :]
    variance = np.einsum("nij,njk,nik->n", across, covariance, across)
    values = np.linalg.eigvalsh((covariance + np.swapaxes(covariance, -1, -2)) / 2)
    lost = (values[:, 0] < -ROUNDING * np.abs(values[:, -1])) | (variance <= 0)
    return np.where(lost, ANY_DIRECTION_RAD, np.sqrt(np.maximum(variance, 0.0)))


def believed(
    passes: Sequence[Pass],
    solved: Sequence[Solutions],
    cures: Sequence[str],
    rate_sigma: float,
    epoch_utc: str | None,
) -> dict[str, Any]:
    """Return variables that say what may be believed of each pass, with its solutions at the sample nearest to the middle.

    `cures`: what the search of each pass may have left out and what would help, in words; empty if nothing.
    """
    names = sorted({name for one in solved for name in one.residual})
    misfits = np.full((len(solved), len(names), 3), np.nan)
    residual = np.full((len(names), sum(len(one.samples) for one in passes)), np.nan)
    rows, begin = [], 0
    for k, (one, cure) in enumerate(zip(solved, cures, strict=True)):
        t_s = one.obs.t_s
        at = int(np.argmin(np.abs(t_s - (t_s[0] + t_s[-1]) / 2)))
        by_sensor = {name: misfit(part[0]) for name, part in one.residual.items()}
        for name, part in one.residual.items():
            misfits[k, names.index(name)] = by_sensor[name]
            residual[names.index(name), begin : begin + len(t_s)] = part[0]
        begin += len(t_s)
        omega, covariance = one.track.omega[:, at], one.track.covariance[:, at, 3:, 3:]
        explained = bool(one.track.cost[0] <= one.cost_limit)
        said, speed = answers(
            one.probability,
            omega,
            covariance,
            rate_sigma,
            by_sensor,
            explained,
            cure,
            either_side(one.track),
        )
        sigma = np.sqrt(np.einsum("kii->ki", covariance))
        # exchanged columns give a motion of the same size, so that a size confirms none
        blind = set(by_sensor) <= {"Sun", RateSize.label}
        checked = COLUMNS_UNCHECKED if blind else COLUMNS_STATED
        solution = one.probability, omega, sigma, speed, said, checked
        rows.append(PassRow(len(t_s), t_s[0], t_s[-1], t_s[at], *solution))
    return (
        passes_table(rows, epoch_utc)
        | _estimates([one.estimates[0] for one in solved])
        | {
            "misfit": (("pass_id", "sensor", "figure"), misfits),
            "residual": (("sensor", "time"), residual),
            "sensor": names,
            "figure": ["readings", "beyond", "chance"],
            "model": ("pass_id", [one.model[0] for one in solved]),
            "model_probability": ("pass_id", [one.model[1] for one in solved]),
        }
    )


def repeats_doubted(result: xr.Dataset, assessment: Assessment) -> xr.Dataset:
    """Return the result with no pass decided whose samples may be held values: too few different ones are left to tell."""
    repeats = assessment.repeats
    times = assessment.telemetry["time"].values[repeats.unsure]
    of_pass = result["pass_of"].values[np.isin(result["time"].values, times)]
    unsure = np.isin(np.arange(result.sizes["pass_id"]), of_pass)
    why = [
        "; ".join(filter(None, (str(reason), repeats.doubt if doubted else "")))
        for reason, doubted in zip(result["why_not_decided"].values, unsure, strict=True)
    ]
    decided = result["decided"].values & ~unsure
    return result.assign(decided=("pass_id", decided), why_not_decided=("pass_id", why))


def _estimates(best: Sequence[dict[str, tuple[str, float, float]]]) -> dict[str, Any]:
    """Return variables with what was estimated with the best solution of each pass; NaN if a pass has no such number."""
    units = {name: row[0] for one in best for name, row in one.items()}
    values = np.full((len(best), len(units), 2), np.nan)
    for k, one in enumerate(best):
        for name, (_, *value) in one.items():
            values[k, list(units).index(name)] = value
    return {
        "estimate_value": (("pass_id", "estimate"), values[..., 0]),
        "estimate_sigma": (("pass_id", "estimate"), values[..., 1]),
        "estimate_unit": ("estimate", list(units.values())),
        "estimate": list(units),
    }
