"""What is said of rates: the Dataset with its numbers, what may be believed of each pass, and the verdict in words."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import printable
from sunspin.base.provenance import provenance
from sunspin.environment.frames import FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.environment.orbit import SunAlongZ
from sunspin.estimate.passes import (
    AS_STATED,
    UNCHECKED,
    PassMotions,
    drawn_speeds,
    padded,
    speed_of,
    speeds,
    table,
)
from sunspin.estimate.rates.alternatives import TORQUES_STRONGER
from sunspin.estimate.rates.dense import curve
from sunspin.estimate.rates.finish import Pass
from sunspin.estimate.rates.hypotheses import AS_STATED as AS_READ
from sunspin.estimate.rates.images import either_side, images_of
from sunspin.estimate.rates.smooth import cost_limit
from sunspin.estimate.rates.state import Motion, Observations
from sunspin.estimate.terms.panels import Panels
from sunspin.estimate.terms.sensors import SENSORS
from sunspin.estimate.verdict import answers, misfit
from sunspin.estimate.wheel_speeds import untold
from sunspin.solve.rotations import without_sign_jumps
from sunspin.telemetry.gains import FAINT

DECIDED = 0.9
"""A solution with at least this probability is called decided."""

ROUNDING = 1e-3
"""Negative part of a covariance's largest variance beyond which it is rounding: 0.6 for a panel that hardly sees the Sun."""

ANY_DIRECTION_RAD = float(np.sqrt((np.pi**2 - 4) / 2))
"""Rms angle between a direction and one that may be any."""

OF_SCATTER = "the vehicle file states none: the scatter of readings in full Sun and the light on panels that face away"
"""Where the error of panel readings comes from without a stated noise."""

SUSPECTED = "the data alone, not counted"
"""Where a lateness comes from that the vehicle file does not speak of."""


def dataset_of(
    vehicle, telemetry, o, why, found: list[Pass], source, motion, rate_max, chosen
) -> xr.Dataset:
    index = np.concatenate([p.index for p in found])
    best = [p.track.take(np.array([0])) for p in found]
    attitude = np.concatenate([track.attitude[0] for track in best])
    covariance = np.concatenate([track.covariance[0] for track in best])
    sun = np.concatenate([track.sun_B[0] for track in best])
    means = [(p.mean, p.mean_sigma) for p in found]
    pass_of = np.repeat(np.arange(len(found)), [len(p.index) for p in found])
    spread = np.array([_spread(*mean, p.weight) for mean, p in zip(means, found, strict=True)])
    sun_sigma = _sun_sigma(sun, covariance[:, :3, :3])
    attrs: dict[str, Any] = provenance("rates", telemetry, **vehicle.result_attributes) | {
        "source": source,
        "acceleration_noise": motion.noise,
        "max_rate_rad_s": rate_max,
        "acceleration_noise_from": "evidence of the data" if chosen else "given",
        "body": "nearly a sphere (no inertia)"
        if motion.body.spherical
        else "rigid body with the vehicle's inertia and wheels",
        "earth_light": max(
            (x.earth_share for x in o.terms if isinstance(x, Panels) and x.earth_share > FAINT),
            default=0.0,
        ),
        "frame_N": SUN_Z_LOCAL,
        "panels_left_out": ", ".join(
            name for x in o.terms if isinstance(x, Panels) for name in x.left_out
        ),
    }
    stated = vehicle.input_noise
    for counted in (x.sigma[np.isfinite(x.sigma)] for x in o.terms if isinstance(x, Panels)):
        if len(counted):
            attrs |= {
                "noise": float(np.median(counted if stated is None else stated)),
                "noise_from": OF_SCATTER if stated is None else "given",
            }
    read = {x.name for x in o.terms if isinstance(x, SENSORS) and x.present()[index].any()}
    attrs |= {f"{sensor.name}_used": int(sensor.name in read) for sensor in SENSORS}
    attrs["wheels_untold"] = "" if attrs["gyro_used"] else ", ".join(untold(vehicle, telemetry))
    mean, sigma = (padded(values) for values in zip(*means, strict=True))
    quaternion = without_sign_jumps(Rotation.from_matrix(attitude).as_quat(), pass_of)
    each = ("pass_id", "solution")
    result = xr.Dataset(
        {
            "omega_B": (("time", "axis"), np.concatenate([t.omega[0] for t in best])),
            "omega_cov_B": (("time", "axis", "axis2"), covariance[:, 3:, 3:]),
            "sun_B": (("time", "axis"), sun),
            "sun_sigma_rad": ("time", sun_sigma),
            "B_from_N": (("time", "quaternion"), quaternion),
            "pass_of": ("time", pass_of),
            "omega_mean_B": ((*each, "axis"), mean),
            "omega_sigma_B": ((*each, "axis"), sigma),
            "omega_sigma_all_B": (("pass_id", "axis"), spread),
            "cost": (each, padded([p.track.cost for p in found])),
            "cost_limit": ("pass_id", [cost_limit(o.take(p.kept)) for p in found]),
            "why": ("sample", why.astype(np.str_)),
        },
        coords={
            "time": o.t_s[index],
            "sample": o.t_s,
            "axis": ["x", "y", "z"],
            "pass_id": np.arange(len(found)),
            "quaternion": ["x", "y", "z", "w"],
        },
        attrs=attrs,
    )
    return with_curves(result, o, found, motion)


def _sun_sigma(sun: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """One sigma (n) of directions of the Sun (n, 3), rad, from covariances (n, 3, 3) of the attitude. Where readings determine so
    little that rounding is left of a covariance, which then has negative variances, the direction may be any."""
    across = np.eye(3) - sun[:, :, None] * sun[:, None, :]
    variance = np.einsum("nij,njk,nik->n", across, covariance, across)
    values = np.linalg.eigvalsh((covariance + np.swapaxes(covariance, -1, -2)) / 2)
    lost = (values[:, 0] < -ROUNDING * np.abs(values[:, -1])) | (variance <= 0)
    return np.where(lost, ANY_DIRECTION_RAD, np.sqrt(np.maximum(variance, 0.0)))


def with_curves(
    result: xr.Dataset, o: Observations, found: list[Pass], motion: Motion
) -> xr.Dataset:
    """The result with the best motion of each pass between its samples, too, as the equations of motion carry it."""
    each = [curve(o.take(p.index), p.track.take(np.array([0])), motion) for p in found]
    attitude, omega, covariance = (
        np.concatenate([getattr(track, x)[0] for _, track in each])
        for x in ("attitude", "omega", "covariance")
    )
    sigma = np.sqrt(np.einsum("nii->ni", covariance[:, 3:, 3:]))
    pass_of = np.repeat(np.arange(len(found)), [len(t) for t, _ in each])
    quaternion = without_sign_jumps(Rotation.from_matrix(attitude).as_quat(), pass_of)
    return result.assign(
        curve_omega_B=(("curve_time", "axis"), omega),
        curve_omega_sigma_B=(("curve_time", "axis"), sigma),
        curve_B_from_N=(("curve_time", "quaternion"), quaternion),
        curve_pass_of=("curve_time", pass_of),
    ).assign_coords(curve_time=np.concatenate([t for t, _ in each]))


def in_space(
    result: xr.Dataset, local: SunAlongZ, found: list[Pass], o: Observations
) -> xr.Dataset:
    """The result with the turn about the Sun and its sigma; where a magnetometer was used, with attitudes from J2000."""
    best = [p.track.take(np.array([0])) for p in found]
    sun, covariance = (
        np.concatenate(parts)
        for parts in zip(*((t.sun_B[0], t.covariance[0]) for t in best), strict=True)
    )
    sigma = np.sqrt(np.maximum(np.einsum("ni,nij,nj->n", sun, covariance[:, :3, :3], sun), 0.0))
    about = {"units": "rad", "long_name": "one sigma of the turn about the Sun"}
    result = result.assign(turn_sigma_rad=("time", sigma, about)).assign_attrs(
        orbit=local.orbit.elements[0].number,
        orbit_name=printable(local.orbit.elements[0].name),
        orbit_shift_s=local.orbit.shift_s,
        orbit_drift_s_day=local.orbit.drift_s_day,
        orbit_shift_sigma_s=float(np.hypot(local.orbit.shift_sigma_s, local.orbit.clock_sigma_s)),
    )
    if o.freed().field_N is None:
        return result
    turned = {}
    for name, time, part in (
        ("B_from_N", "time", "pass_of"),
        ("curve_B_from_N", "curve_time", "curve_pass_of"),
    ):
        attitude = Rotation.from_quat(result[name].values).as_matrix() @ local.N_from_J2000(
            result[time].values
        )
        quaternion = without_sign_jumps(
            Rotation.from_matrix(attitude).as_quat(), result[part].values
        )
        turned[name] = (time, "quaternion"), quaternion, {"units": "1"}
    return result.assign(turned).assign_attrs(frame_N=J2000)


def in_the_field(result: xr.Dataset) -> xr.Dataset:
    """The result of a magnetometer alone, without an orbit: what was taken for the Sun is the field, the Sun is not known."""
    nothing = result["sun_B"] * np.nan
    about = {"units": "1", "long_name": "direction of the magnetic field, smoothed"}
    return result.assign(
        field_direction_B=result["sun_B"].assign_attrs(about),
        sun_B=nothing.assign_attrs(result["sun_B"].attrs),
        sun_sigma_rad=result["sun_sigma_rad"] * np.nan,
    ).assign_attrs(frame_N=FIELD_Z_LOCAL, field_used=1)


def more_effort(given: float) -> str:
    """What to do where an effort of `given` was spent: an option that gives ten times the usual one, or ten times that."""
    return f"give more effort (`--effort {10 * max(given, 1.0):g}`)"


def slower(limit_rad_s: float) -> str:
    """What to do where the search is fine enough up to `limit_rad_s` only, which is given in three figures, rounded down."""
    limit = np.degrees(limit_rad_s)
    figure = 10.0 ** (np.floor(np.log10(limit)) - 2)
    return f"if no rate is faster than {np.floor(limit / figure) * figure:.4g} deg/s, give it as `--max-rate-deg-s`"


def cures(
    attrs: dict[str, Any], cut: np.ndarray, coarse: np.ndarray, unmet: np.ndarray
) -> list[str]:
    """Of each pass what the search may have left out and what would help, in words; empty where nothing. `cut` (n), `coarse` (n)
    and `unmet` (n): where it was cut short, was coarse, or may not have met the motion; `attrs` of the result: effort, rate up to
    which the search is fine, wheels whose speed nothing tells."""
    wheels = attrs["wheels_untold"]
    every = {
        f"budget reached: {more_effort(attrs['effort_given'])}": cut,
        f"coarse: {slower(attrs['fine_up_to_rad_s'])}": coarse,
        "torques too strong for a satellite, or the body is no sphere: give its inertia": unmet,
        f"the speed of wheel {wheels} is unknown: give speed_rad_s or a speed_column": np.full(
            len(cut), wheels != ""
        ),
    }
    return ["; ".join(words for words, which in every.items() if which[k]) for k in range(len(cut))]


def believed(
    o: Observations, found: list[Pass], motion: Motion, cure: list[str], epoch_utc: str | None
) -> dict[str, Any]:
    """What may be believed of each pass, and its motions at the sample nearest to its middle; `cure` as `cures` has it."""
    rows, names = [], sorted({name for p in found for name in p.residual})
    misfits = np.full((len(found), len(names), 3), np.nan)
    residual = np.full((len(names), sum(len(p.index) for p in found)), np.nan)
    ends = np.cumsum([len(p.index) for p in found])
    for k, (p, missed) in enumerate(zip(found, cure, strict=True)):
        t = o.t_s[p.index]
        at = int(np.argmin(np.abs(t - (t[0] + t[-1]) / 2)))
        omega, covariance = p.track.omega[:, at], p.track.covariance[:, at, 3:, 3:]
        sigma = np.sqrt(np.einsum("kii->ki", covariance))
        told = {name: misfit(left[0]) for name, left in p.residual.items()}
        for name, left in p.residual.items():
            misfits[k, names.index(name)] = told[name]
            residual[names.index(name), ends[k] - len(t) : ends[k]] = left[0]
        explained = p.track.cost[0] <= cost_limit(o.take(p.kept))
        one = either_side(p.track) if len(images_of(o)) > 1 else np.arange(len(p.weight)) == 0
        unique = bool(p.weight[one].sum() >= DECIDED)
        spread = _spread(omega, sigma, p.weight)
        speed = speed_of(omega[0], [*drawn_speeds(omega, covariance)], p.weight)
        said = answers(unique, spread, motion.rate_prior, told, explained, not missed, missed)
        said = said._replace(speed=speed)
        checked = UNCHECKED if list(told) == ["Sun"] else AS_STATED
        solutions = p.weight, omega, sigma, speeds(omega, covariance)
        rows.append(PassMotions(len(t), t[0], t[-1], t[at], *solutions, said, checked))
    best = [p.estimates[0] if p.estimates else {} for p in found]
    units = {name: row[0] for one in best for name, row in one.items()}
    values = np.full((len(found), len(units), 2), np.nan)
    for k, one in enumerate(best):
        for name, (_, *value) in one.items():
            values[k, list(units).index(name)] = value
    return table(rows, epoch_utc) | {
        "misfit": (("pass_id", "sensor", "figure"), misfits),
        "residual": (("sensor", "time"), residual),
        "estimate_value": (("pass_id", "estimate"), values[..., 0]),
        "estimate_sigma": (("pass_id", "estimate"), values[..., 1]),
        "estimate_unit": ("estimate", [units[name] for name in units]),
        "estimate": list(units),
        "sensor": names,
        "figure": ["readings", "beyond", "chance"],
        "model": ("pass_id", _models(found, motion)),
        "model_probability": ("pass_id", [p.model[1] for p in found]),
    }


def _models(found: list[Pass], motion: Motion) -> list[str]:
    """The likeliest model of each pass, in words. Torques that are stronger in most passes are not "stronger than in the rest"."""
    names = [p.model[0] for p in found]
    if 2 * sum(TORQUES_STRONGER in name for name in names) <= len(names):
        return names
    return [
        name.replace(
            TORQUES_STRONGER, f"unknown torques stronger than {motion.noise:.2g} rad/s^1.5"
        )
        for name in names
    ]


def _spread(mean: np.ndarray, sigma: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Sigma (3) about the best mode's mean rate when the other modes, by their weights, are counted in."""
    share = (weight / weight.sum())[:, None]
    return np.sqrt((share * (sigma**2 + (mean - mean[0]) ** 2)).sum(axis=0))


def _left_open(result: xr.Dataset, one: np.ndarray, several: np.ndarray) -> list[str]:
    """What is said of passes with `one` motion that may see the Sun on either side, and of those with `several`."""
    notes = []
    if sides := int((one & (result["probability"].values[:, 0] < DECIDED)).sum()):
        notes.append(
            f"{passes(sides)}: the sign of the Sun direction is ambiguous; rates are unaffected, attitude is unknown"
        )
    unlisted = int(result.attrs.get("symmetric_unlisted", 0))
    if unlisted:
        notes.append(
            f"{passes(unlisted)}: a rotation or mirror of the body gives the same readings; that solution is not listed"
        )
    count = int(several.sum()) - unlisted
    if count and "alike" in result.attrs:
        notes.append(f"{passes(count)} with several solutions: {result.attrs['alike']}")
    elif count:
        notes.append(
            f"{passes(count)} with several solutions, which mostly differ by whole revolutions between samples: see passes.csv"
        )
    return notes


def passes(count: int) -> str:
    """1 pass, 2 passes."""
    return f"{count} pass" + "es" * (count > 1)


def verdict(result: xr.Dataset) -> str:
    """What the data can tell: how many passes are decided, then a line for each note."""
    decided, unique, fits = (result[name].values for name in ("decided", "unique", "fits"))
    constrained = np.all([result[f"constrained_{axis}"].values for axis in "xyz"], axis=0)
    attrs, effort = result.attrs, more_effort(result.attrs["effort_given"])
    notes = [
        f"{int(decided.sum())} of {len(decided)} passes decided (unique, all components and the speed constrained, fits, "
        "search complete)"
    ]
    if count := int((~fits).sum()):
        notes.append(
            f"{passes(count)}: NO SOLUTION FITS. Possible causes: external torque, changing wheel speed, faulty data"
        )
    notes += [attrs[doubt] for doubt in ("columns_doubt", "odd_sensor") if doubt in attrs]
    if count := int((fits & unique & ~constrained).sum()):
        notes.append(
            f"{passes(count)}: single solution, but not all rate components are constrained"
        )
    speed_known = result["constrained_speed"].values
    if count := int((fits & unique & constrained & ~speed_known).sum()):
        notes.append(
            f"{passes(count)}: the error of the speed exceeds the speed, so only an upper limit is given"
        )
    if count := sum(model != AS_READ for model in result["model"].values):
        notes.append(f"{passes(count)}: an alternative model fits better, as named below")
    notes += _left_open(result, fits & unique, fits & ~unique)
    if count := attrs["cut_passes"]:
        notes.append(
            f"{passes(count)}: SEARCH STOPPED at the computing budget, best solution so far is shown: {effort}"
        )
    if attrs.get("column_tests_cut"):
        notes.append(f"not every other order of columns was tried: {effort}")
    if count := attrs["coarse_passes"]:
        notes.append(
            f"{passes(count)}: coarse search, a solution may be missing: {slower(attrs['fine_up_to_rad_s'])}"
        )
    if unsure := attrs["wheels_untold"]:
        notes.append(
            f"WHEEL SPEED UNKNOWN ({unsure}): assumed 0, so the solution may be wrong. Give speed_rad_s or a speed_column, or "
            "remove the wheel if it is at rest"
        )
    late, error = attrs["sensors_late_s"], attrs["sensors_late_sigma_s"]
    if attrs["sensors_late_from"] == SUSPECTED:
        notes.append(
            f"gyro, magnetometer or attitude SEEM LATE by {late:.2f} +- {error:.2f} s (not corrected). If they are, state "
            f"sensors_late_s = {{ value = {late:.2f}, sigma = {max(1.0, error):.2f} }} under [clock] of the vehicle file"
        )
    elif np.isfinite(late):
        source = attrs["sensors_late_from"]
        notes.append(
            f"gyro, magnetometer and attitude are {late:.2f} +- {error:.2f} s late ({source})"
        )
    return "\n".join([*notes, *_seen_alone(result)])


def _seen_alone(result: xr.Dataset) -> list[str]:
    """What is not known where a single kind of direction was used."""
    if result.attrs["frame_N"] == FIELD_Z_LOCAL:
        return [
            "magnetometer only, NO ORBIT: rates are relative to the field direction (itself rotating by about 0.1 deg/s, included "
            "in the errors); inertial attitude and Sun direction are not available"
        ]
    if any(result.attrs[f"{sensor.name}_used"] for sensor in SENSORS):
        return []
    notes = [
        "only Sun directions were used: rotation about the Sun direction is constrained only by the dynamics"
    ]
    if count := result.attrs["no_sphere"]:
        notes.append(
            f"{passes(count)}: the search assumed a sphere, which does not fit this motion: GIVE ITS INERTIA (inertia_kg_m2)"
        )
    return notes
