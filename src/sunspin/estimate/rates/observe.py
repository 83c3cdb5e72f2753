"""From telemetry to what the smoother of :mod:`sunspin.estimate.rates` reads: passes, thinning, and what each sample gives."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError, sentence
from sunspin.estimate.rates.earth import differing
from sunspin.estimate.rates.state import Observations
from sunspin.telemetry.quality import panel_quality
from sunspin.telemetry.sun import signals
from sunspin.vehicle import Vehicle
from sunspin.vehicle.sensors import Gyro

RADIAL_SIGMA = 0.02
"""Sigma given to a direction along itself, so that its covariance can be inverted; a chord is shorter than its arc."""

GAP_FACTOR = 6.0
"""A gap longer than this many usual intervals ends a pass."""

MAX_PASS_S = 3000.0
"""Longer passes are cut: half an orbit, over which a rate's wandering is still small against a turn."""

MAX_SAMPLES = 40
"""Samples of a pass beyond this are thinned."""

GROWTH = 1.4
"""Ratio of neighbouring steps of the thinned samples: they leave from the file's own interval and widen to even steps."""

FIELD_FACTOR = 5.0
"""A field of more than this many times the usual size is a wrapped or broken reading: along an orbit it varies by three."""

SOURCES = ("sun_sensor", "panels", "directions")


def observations(vehicle: Vehicle, telemetry: xr.Dataset, source: str | None = None) -> tuple[Observations, np.ndarray, str]:
    """All samples as `Observations`, a sentence for each (n), and where the Sun comes from.

    `source`: "sun_sensor", "panels" or "directions" (`sun_B` with `sun_cov_B`, as `sun_directions` returns them); default:
    the first of directions, Sun sensors, panels that the telemetry has.
    """
    source = _source(telemetry, source)
    n = telemetry.sizes["time"]
    t = np.asarray(telemetry["time"], dtype=np.float64)
    why = np.full(n, "used", dtype=object)
    parts: dict[str, Any] = {
        "sun_B": np.full((n, 3), np.nan), "sun_cov": np.full((n, 3, 3), np.nan), "power": np.zeros((n, 0)),
        "power_sigma": np.zeros((n, 0)), "rows": np.zeros((0, 3)),
        "row_errors": np.zeros((0, 0, 3)), "row_unknowns": np.zeros((0, 0, 3)), "scale": np.ones(n), "scale_sigma": np.ones(n),
        "earth_unknowns": np.zeros((n, 0, 3)), "field_unknowns": np.zeros((n, 0, 3)),
        "whole_sigma": np.zeros((n, 0)), "zero_sigma": np.zeros(0),
    }  # fmt: skip
    if source == "panels":
        quality = panel_quality(vehicle, telemetry)
        errors = _gain_errors(vehicle, quality)
        told = np.isfinite(quality.attrs["spread"])  # by the brightness of the samples; else only a motion can tell the gains
        parts |= {
            "power": signals(telemetry), "power_sigma": quality["sigma"].values,
            "whole_sigma": quality["sigma_beside_earth"].values,
            "rows": quality["gain"].values[:, None] * vehicle.panel_normals_B, "row_errors": errors[: len(errors) * told],
            "row_unknowns": errors[len(errors) * told :],
            "scale": quality["scale"].values, "scale_sigma": quality["scale_sigma"].values,
            "earth_light": quality.attrs["earth_light"],
        }  # fmt: skip
        why = quality["why"].values.astype(object)
    else:
        sun, cov = ("sun_sensor_B", "sun_sensor_cov_B") if source == "sun_sensor" else ("sun_B", "sun_cov_B")
        parts |= {"sun_B": telemetry[sun].values, "sun_cov": _full_rank(telemetry[sun].values, telemetry[cov].values)}
        why[~np.isfinite(parts["sun_cov"][:, 0, 0])] = "no direction of the Sun: only the motion and other sensors bridge it"
    gyro = _or_nan(telemetry, "gyro_B", n)
    field = _without_outliers(_or_nan(telemetry, "field_B", n))
    sensors = vehicle.sensors
    noise = sensors.magnetometer.noise if sensors.magnetometer is not None else None
    gyro_sigma = sensors.gyro.noise_rad_s if sensors.gyro is not None else 1.0
    parts |= {"gyro": gyro, "gyro_sigma": gyro_sigma, "gyro_common": _common_errors(sensors.gyro, gyro)}
    parts |= {"field": field, "field_sigma": noise or np.inf}
    parts |= {"attitude": _attitudes(telemetry, n), "attitude_sigma": sensors.attitude.sigma_rad if sensors.attitude else np.inf}
    parts |= {"whole_power": parts["power"], "whole_scale_sigma": parts["scale_sigma"]}
    made = differing(Observations(t_s=t, momentum=np.zeros((n, 3)), **parts))
    late = np.concatenate([[False], t[1:] <= np.maximum.accumulate(t)[:-1]])
    why[late] = "dropped: a late or repeated frame (time does not increase)"
    return made, why, source


def _source(telemetry: xr.Dataset, wanted: str | None) -> str:
    has = {
        "directions": "sun_B" in telemetry and "sun_cov_B" in telemetry,
        "sun_sensor": "sun_sensor_B" in telemetry,
        "panels": "power_W" in telemetry or "current_A" in telemetry,
    }
    if wanted is None:
        wanted = next((name for name, there in has.items() if there), None)
    if wanted not in has or not has[wanted]:
        there = ", ".join(name for name, is_there in has.items() if is_there) or "nothing of the Sun"
        raise InputError(
            sentence(f"the telemetry has no Sun from {wanted or 'panels or Sun sensors'}", got=there, do=f"use {', '.join(has)}")
        )
    return wanted


def _or_nan(telemetry: xr.Dataset, name: str, n: int) -> np.ndarray:
    return np.asarray(telemetry[name], dtype=np.float64) if name in telemetry else np.full((n, 3), np.nan)


def _gain_errors(vehicle: Vehicle, quality: xr.Dataset) -> np.ndarray:
    """One sigma (m, n_panel, 3) of each independent error of the gains, estimated or as the vehicle file has them."""
    return np.linalg.cholesky(quality["gain_cov"].values).T[:, :, None] * vehicle.panel_normals_B


def _attitudes(telemetry: xr.Dataset, n: int) -> np.ndarray:
    """Attitudes (n, 3, 3) of an attitude sensor, NaN where there is none."""
    found = np.full((n, 3, 3), np.nan)
    if "attitude_B_from_N" in telemetry:
        quaternion = np.asarray(telemetry["attitude_B_from_N"], dtype=np.float64)
        good = np.isfinite(quaternion).all(axis=1)
        found[good] = Rotation.from_quat(quaternion[good]).as_matrix().reshape(-1, 3, 3)
    return found


def _common_errors(gyro: Gyro | None, rate: np.ndarray) -> np.ndarray:
    """One sigma (n, 4, 3) rad/s of the gyro's zero, axis by axis, and of its scale."""
    errors = np.zeros((len(rate), 4, 3))
    if gyro is not None:
        errors[:, :3] = np.diag(gyro.scale_rad_s * gyro.zero_sigma)
        errors[:, 3] = np.nan_to_num(rate) * gyro.scale_sigma / abs(gyro.scale_rad_s)
    return errors


def _without_outliers(field: np.ndarray) -> np.ndarray:
    """Fields (n, 3) with readings far beyond the usual size, which the Earth's field cannot reach, made NaN."""
    size = np.linalg.norm(np.nan_to_num(field), axis=1)
    usual = np.median(size[size > 0]) if np.any(size > 0) else 0.0
    return np.where((size <= FIELD_FACTOR * usual)[:, None], field, np.nan)


def _full_rank(direction: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    n = direction[:, :, None] * direction[:, None, :]
    along = np.einsum("nij,nij->n", covariance, n)
    add = np.where(along < RADIAL_SIGMA**2, RADIAL_SIGMA**2, 0.0)
    return np.where(np.isfinite(direction[:, :1, None]), covariance + add[:, None, None] * n, np.nan)


def informative(o: Observations) -> np.ndarray:
    """Which samples (n) say something of the Sun."""
    return o.told | (np.isfinite(o.power_sigma).any(axis=1) if o.power.size else False)


def usable(o: Observations, why: np.ndarray) -> np.ndarray:
    """Indices of the samples that are used."""
    return np.flatnonzero(informative(o) & np.array([not text.startswith("dropped") for text in why]))


def passes(o: Observations, why: np.ndarray, gap_s: float | None = None) -> list[np.ndarray]:
    """Indices of the samples of each pass, thinned; gaps longer than `gap_s` (default: six usual intervals) part them."""
    use = usable(o, why)
    if len(use) < 3:
        lost = Counter(text.removeprefix("dropped: ") for text in why if text != "used").most_common(1)
        raise InputError(
            sentence("fewer than three samples say where the Sun is", got=f"{len(use)} of {len(o)}",
                     do=(f"{lost[0][1]} dropped: {lost[0][0]}; " if lost else "") + "`sunspin check` says why samples are dropped")
        )  # fmt: skip
    times = o.t_s[use]
    gap = GAP_FACTOR * float(np.median(np.diff(times))) if gap_s is None else gap_s
    found = []
    for part in np.split(use, np.flatnonzero(np.diff(times) > gap) + 1):
        pieces = max(1, int(np.ceil((o.t_s[part[-1]] - o.t_s[part[0]]) / MAX_PASS_S)))
        edges = o.t_s[part[0]] + np.arange(1, pieces) * (o.t_s[part[-1]] - o.t_s[part[0]]) / pieces
        found += [thinned(piece) for piece in np.split(part, np.searchsorted(o.t_s[part], edges)) if len(piece) >= 3]
    if not found:
        raise InputError(sentence("no pass has three samples", got=f"gap between passes {gap:.4g} s", do="raise --gap"))
    return found


def thinned(index: np.ndarray, most: int = MAX_SAMPLES) -> np.ndarray:
    """At most `most` of the samples: close together at first, where the rate is found, then ever farther apart.

    Each step is at most `GROWTH` times the one before, so that what is known of the rate always carries to the next sample.
    """
    if len(index) <= most:
        return index
    low, high = 1.0, float(len(index))
    for _ in range(60):  # the largest step for which the steps reach the end
        widest = (low + high) / 2
        steps = np.minimum(GROWTH ** np.arange(most - 1), widest)
        low, high = (widest, high) if steps.sum() < len(index) - 1 else (low, widest)
    place = np.concatenate([[0.0], np.cumsum(np.minimum(GROWTH ** np.arange(most - 1), high))])
    return index[np.unique(np.minimum(np.round(place), len(index) - 1).astype(int))]
