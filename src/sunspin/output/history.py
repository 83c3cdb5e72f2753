"""The history of a satellite from results of `rates`: a point for each pass, the trend of the speed, and its jumps.

The speed is the sum of a line in time, a random walk (unmodelled torques), steps at jumps, a scatter and the error of each pass.
The scatter is independent from pass to pass: a pass shows the speed of a tumbling body at some phase of its nutation. All is linear
and Gaussian: for each strength of walk and scatter a Kalman filter whitens the data, and weighted least squares give the trend with
its error. Both are means over the strengths, weighted by their probability.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.environment.frames import J2000
from sunspin.output.folder import MARKER, read_command
from sunspin.output.report.read import Results, read_results
from sunspin.output.text import signed_text
from sunspin.vehicle import Vehicle

DAY_S = 86_400.0

STRENGTHS = 12
"""Number of trial strengths of the random walk, and of the scatter; one of each is zero."""

JUMP = 25.0
"""Twice the gain in log likelihood from which a step is a jump: five sigma, to which 2 log(number of places) is added."""

MOST_JUMPS = 5
"""Largest number of jumps."""

SPARE = 3
"""Least number of passes more than fitted numbers: fewer give no trend, as its error would mean nothing."""


class Trend(NamedTuple):
    """The speed as a line in time, with steps.

    `slope`, `slope_sigma` rad/s per day; `walk` rad/s per square root of a day; `scatter` of a pass, rad/s; `jumps`: index of the
    first pass after each jump, with its size and error in rad/s.
    """

    slope: float
    slope_sigma: float
    walk: float
    scatter: float
    jumps: list[tuple[int, float, float]]


def history(folders: Sequence[str | Path]) -> xr.Dataset:
    """Collect the passes of results of `rates`.

    Parameters
    ----------
    folders : sequence of path
        Folders that `rates --out` wrote, or folders of such folders. They may be of one satellite only.

    Returns
    -------
    xarray.Dataset
        Over `time`, the middles of the passes in s from ``attrs["epoch_utc"]``: `utc_at`, `decided`, `probability`, `samples` and
        `why_not_decided` of the most probable solution; its `speed_median` with `speed_sigma`, rad/s; `omega_B` with
        `omega_sigma_B` (time, axis); `spin_axis_B` (time, axis), the direction of the rate, with `spin_axis_sigma_rad`. `momentum`,
        size of the angular momentum of the body in N m s, with `momentum_sigma`; `momentum_sun_rad`, its angle to the Sun;
        `momentum_J2000` (time, axis), its direction where an orbit was given. These four are NaN without an inertia.

        attrs: `trend`, `trend_sigma` (rad/s per day), `walk` (rad/s per square root of a day), `scatter` (rad/s), from the decided
        passes, NaN if too few; `jumps`: a sentence for each; `vehicles_differ`: two folders whose vehicle files differ in panels or
        inertia, else "".

    Raises
    ------
    InputError
        A folder holds no results of `rates`, or results of another satellite, or of a pass that another holds too.
    """
    paths = [path for folder in folders for path in _results_below(Path(folder))]
    rows = [row for path in paths for row in _read_passes(path)]
    if not rows:
        raise InputError(
            "no pass was found",
            got=", ".join(map(str, folders)),
            do="run `sunspin rates` with --out",
        )
    vehicles = sorted({row["vehicle"] for row in rows})
    if len(vehicles) > 1:
        what = "the results are of several satellites"
        raise InputError(what, got=", ".join(vehicles[:4]), do="give those of one")
    rows.sort(key=lambda row: row["start"])
    for earlier, later in zip(rows, rows[1:], strict=False):
        if later["start"] < earlier["end"] or later["start"] == earlier["start"]:
            what = "two results hold the same pass"
            got = f"{earlier['folder']} and {later['folder']}, {later['start']}Z"
            raise InputError(what, got=got, do="give one of them")
    epoch = rows[0]["utc"]
    time = np.array([(row["utc"] - epoch) / np.timedelta64(1, "ms") / 1e3 for row in rows])
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    omega, sigma = columns["omega_B"], columns["omega_sigma_B"]
    size = np.linalg.norm(omega, axis=1)
    axis = omega / np.where(size > 0, size, np.nan)[:, None]
    # error of the direction: that of the components across it, the larger of the two
    across = np.sqrt(np.maximum(np.sum(sigma**2 * (1 - axis**2), axis=1), 0.0))
    decided = columns["decided"]
    trend = fit_trend(
        time[decided] / DAY_S, columns["speed_median"][decided], columns["speed_sigma"][decided]
    )
    numbers = np.flatnonzero(decided)
    variables: dict[str, Any] = {
        "utc_at": ("time", np.array([f"{row['utc']}Z" for row in rows])),
        **{
            name: ("time", columns[name])
            for name in (
                *("decided", "probability", "samples", "why_not_decided", "folder"),
                *(
                    "speed_median",
                    "speed_low",
                    "speed_high",
                    "speed_sigma",
                    "momentum",
                    "momentum_sigma",
                    "momentum_sun_rad",
                ),
            )
        },
        "omega_B": (("time", "axis"), omega),
        "omega_sigma_B": (("time", "axis"), sigma),
        "spin_axis_B": (("time", "axis"), axis),
        "spin_axis_sigma_rad": ("time", across / np.where(size > 0, size, np.nan)),
        "momentum_J2000": (("time", "axis"), columns["momentum_J2000"]),
    }
    jumps = [
        f"{_utc_text(rows[numbers[k]]['utc'])}: {signed_text(np.degrees(step), np.degrees(error), 'deg/s')}"
        for k, step, error in trend.jumps
    ]
    # the last folder of each vehicle
    bodies = {row["body"]: row["folder"] for row in rows if row["body"]}
    differ = " and ".join(list(bodies.values())[:2]) if len(bodies) > 1 else ""
    attrs = provenance(
        "history",
        epoch_utc=f"{epoch}Z",
        vehicle=vehicles[0],
        vehicles_differ=differ,
        synthetic=int(any(row["synthetic"] for row in rows)),
        trend=trend.slope,
        trend_sigma=trend.slope_sigma,
        walk=trend.walk,
        scatter=trend.scatter,
        jumps="\n".join(jumps),
        results=len(paths),
    )
    return xr.Dataset(variables, {"time": time, "axis": ["x", "y", "z"]}, attrs)


def _utc_text(utc: np.datetime64) -> str:
    """Return a time to the minute."""
    return f"{str(utc)[:16].replace('T', ' ')} UTC"


def _results_below(folder: Path) -> list[Path]:
    """Return the folder if it is a results folder, else the results of `rates` in it, in the order of their names."""
    if (folder / MARKER).exists() or not folder.is_dir():
        return [folder]
    markers = sorted(folder.glob(f"*/{MARKER}"))
    inside = [marker.parent for marker in markers if read_command(marker) == "rates"]
    if not inside:
        what = "the folder holds no results"
        raise InputError(
            what, do="give folders that `sunspin rates --out` wrote", where=str(folder)
        )
    return inside


def _read_passes(folder: Path) -> list[dict[str, Any]]:
    """Return a dict for each pass of a result of `rates`; raise `InputError` if the folder holds anything else."""
    results = read_results(folder)
    if results.command != "rates":
        what = f"the folder holds results of `sunspin {results.command}`"
        raise InputError(what, do="give results of `sunspin rates`", where=str(folder))
    data = results.first_with("omega_mean_B", "utc_at", "utc_start", "utc_end", "decided")
    if data is None or results.problems:
        why = results.problems[0] if results.problems else "rates.nc is missing"
        raise InputError(
            f"the results cannot be read: {why}", do="run the command again", where=str(folder)
        )
    inertia = None if results.vehicle is None else results.vehicle.inertia_kg_m2
    common = {
        "vehicle": str(data.attrs.get("vehicle", "")),
        "synthetic": results.synthetic,
        "folder": str(folder),
        "body": _body_text(results.vehicle),
    }
    rows = []
    for place in range(data.sizes["pass_id"]):
        row = data.isel(pass_id=place, solution=0)
        rows.append(
            common
            | {
                **{
                    name: np.datetime64(str(row[of_pass].values).rstrip("Z"), "ms")
                    for name, of_pass in (
                        ("utc", "utc_at"),
                        ("start", "utc_start"),
                        ("end", "utc_end"),
                    )
                },
                "decided": bool(row["decided"]),
                "why_not_decided": str(row["why_not_decided"].values),
                "samples": int(row["samples"]),
                **{
                    name: float(row[name])
                    for name in (
                        "probability",
                        "speed_median",
                        "speed_low",
                        "speed_high",
                        "speed_sigma",
                    )
                },
                "omega_B": np.array([float(row[f"omega_{axis}"]) for axis in "xyz"]),
                "omega_sigma_B": np.array([float(row[f"sigma_{axis}"]) for axis in "xyz"]),
            }
            | _momentum(results, data, place, inertia)
        )
    return rows


def _body_text(vehicle: Vehicle | None) -> str:
    """Return panels and inertia of a vehicle as text, which differs for two satellites of one name; empty without a vehicle.

    Gains are left out: an operator corrects them from week to week.
    """
    if vehicle is None:
        return ""
    panels = [f"{one.name} {np.round(one.normal_B, 3).tolist()}" for one in vehicle.panels]
    inertia = "" if vehicle.inertia_kg_m2 is None else f"{np.round(vehicle.inertia_kg_m2, 9)}"
    return "; ".join([*panels, inertia])


def _momentum(
    results: Results, data: xr.Dataset, place: int, inertia: np.ndarray | None
) -> dict[str, Any]:
    """Return size and directions of the body's angular momentum in a pass, means over its samples; NaN if they are not known.

    `place`: of the pass in the result, which is not its pass_id if only some passes were estimated.
    The error of the size is the mean too, as the errors of neighbouring rates are alike; that of the inertia is not in it.
    Wheels are left out: their momentum is not that of the body, and their speeds may be unknown.
    """
    unknown = {
        "momentum": np.nan,
        "momentum_sigma": np.nan,
        "momentum_sun_rad": np.nan,
        "momentum_J2000": np.full(3, np.nan),
    }
    has_wheels = results.vehicle is not None and bool(results.vehicle.wheels)
    inside = data["pass_of"].values == place
    omega = data["omega_B"].values[inside]
    known = np.isfinite(omega).all(axis=1)
    if inertia is None or has_wheels or not known.any():
        return unknown
    momentum_B = omega[known] @ inertia.T
    found = unknown | {"momentum": float(np.linalg.norm(momentum_B, axis=1).mean())}
    direction = momentum_B / np.linalg.norm(momentum_B, axis=1, keepdims=True)
    along = direction @ inertia  # change of the size with the rate
    variance = np.einsum("ni,nij,nj->n", along, data["omega_cov_B"].values[inside][known], along)
    found["momentum_sigma"] = float(np.sqrt(np.maximum(variance, 0.0)).mean())
    cosine = np.sum(direction * data["sun_B"].values[inside][known], axis=1)
    if np.isfinite(cosine).any():
        found["momentum_sun_rad"] = float(np.arccos(np.clip(np.nanmean(cosine), -1, 1)))
    if data.attrs.get("frame_N") == J2000 and "B_from_N" in data:
        quaternions = data["B_from_N"].values[inside][known]
        attitude = np.isfinite(quaternions).all(axis=1)
        if attitude.any():
            in_space = Rotation.from_quat(quaternions[attitude]).inv().apply(direction[attitude])
            mean = in_space.mean(axis=0)
            found["momentum_J2000"] = mean / np.linalg.norm(mean)
    return found


def fit_trend(t_days: np.ndarray, speed: np.ndarray, sigma: np.ndarray) -> Trend:
    """Return the trend of speeds (n) in rad/s with errors `sigma` (n) at increasing times (n) in days; NaN if there are too few."""
    n = len(speed)
    if n < 2 + SPARE or not np.ptp(t_days) > 0:
        return Trend(np.nan, np.nan, np.nan, np.nan, [])
    columns = [np.ones(n), t_days - t_days.mean()]
    # a step before each pass but the first two and the last: fewer passes on one side would be one outlier
    places = list(range(2, n - 1))
    jumps: list[int] = []
    best = _fit(t_days, speed, sigma, np.array(columns))
    while places and len(jumps) < MOST_JUMPS and len(columns) + 1 + SPARE <= n:
        steps = np.array([(np.arange(n) >= k).astype(float) for k in places])
        trials = _fit(t_days, speed, sigma, np.array(columns), steps)
        k = int(np.argmax(trials.log_likelihood))
        gain = 2 * float(trials.log_likelihood[k] - best.log_likelihood[0])
        if gain < JUMP + 2 * np.log(len(places)):
            break
        jumps.append(places.pop(k))
        columns.append(steps[k])
        best = _fit(t_days, speed, sigma, np.array(columns))
    value, error = best.value[0], np.sqrt(np.diag(best.covariance[0]))
    sized = [(k, float(value[2 + i]), float(error[2 + i])) for i, k in enumerate(jumps)]
    walk, scatter = float(best.walk[0]), float(best.scatter[0])
    return Trend(float(value[1]), float(error[1]), walk, scatter, sorted(sized))


class _Fits(NamedTuple):
    """Fits of k models.

    `log_likelihood` (k): the largest over all strengths of walk and scatter. `walk` (k), `scatter` (k), `value` (k, m) of the
    coefficients of the columns and `covariance` (k, m, m): means over the strengths. No walk is as likely before the data as all
    other strengths together, and so is no scatter.
    """

    log_likelihood: np.ndarray
    walk: np.ndarray
    scatter: np.ndarray
    value: np.ndarray
    covariance: np.ndarray


def _fit(
    t: np.ndarray,
    y: np.ndarray,
    sigma: np.ndarray,
    columns: np.ndarray,
    extra: np.ndarray | None = None,
) -> _Fits:
    """Fit y (n) with the columns (m, n) and each of the columns `extra` (k, n) in turn, for all strengths of walk and scatter."""
    trials = np.zeros((1, 0, len(y))) if extra is None else extra[:, None]
    k, m = len(trials), len(columns)
    # variances, rad^2/s^2: from one that is lost in the errors to one that makes all of the scatter; the walk has it over all days
    largest = 3 * np.ptp(y) ** 2 + 1e-300
    least = min(1e-3 * np.median(sigma) ** 2, largest / 10)
    variances = np.concatenate([[0.0], np.geomspace(least, largest, STRENGTHS - 1)])
    prior_of_one = np.where(variances > 0, 1 / (STRENGTHS - 1), 1.0)
    walks, scatters = (grid.ravel() for grid in np.meshgrid(variances / np.ptp(t), variances))
    log_likelihood, restricted, values, covariances = [], [], [], []
    stacked = np.concatenate([y[None], columns, trials.reshape(-1, len(y))])
    for walk, scatter in zip(walks, scatters, strict=True):
        white, log_determinant = _whiten(t, np.sqrt(sigma**2 + scatter), walk, stacked)
        shared = np.broadcast_to(white[1 : 1 + m], (k, m, len(y)))
        design = np.concatenate([shared, white[1 + m :].reshape(trials.shape)], axis=1)
        covariance = np.linalg.inv(design @ np.swapaxes(design, 1, 2))
        value = np.einsum("kij,kj->ki", covariance, design @ white[0])
        residual = white[0] - np.einsum("ki,kin->kn", value, design)
        log_likelihood.append(-0.5 * (np.sum(residual**2, axis=1) + log_determinant))
        # of the strengths alone, the coefficients integrated out: else they would come out too small
        restricted.append(log_likelihood[-1] + 0.5 * np.linalg.slogdet(covariance)[1])
        values.append(value)
        covariances.append(covariance)
    prior = np.outer(prior_of_one, prior_of_one).ravel()[:, None]
    weight = prior * np.exp(restricted - np.max(restricted, axis=0))
    weight /= weight.sum(axis=0)
    mean = np.einsum("sk,ski->ki", weight, np.array(values))
    apart = np.array(values) - mean
    spread = np.einsum("sk,ski,skj->kij", weight, apart, apart)
    covariance = np.einsum("sk,skij->kij", weight, np.array(covariances)) + spread
    sizes = np.sqrt(walks) @ weight, np.sqrt(scatters) @ weight
    return _Fits(np.max(log_likelihood, axis=0), *sizes, mean, covariance)


def _whiten(
    t: np.ndarray, sigma: np.ndarray, strength: float, rows: np.ndarray
) -> tuple[np.ndarray, float]:
    """Return rows (k, n) as independent numbers of variance one, and the log determinant of their covariance.

    The covariance is that of a random walk, which is zero at the first time, plus independent errors `sigma` (n): the innovations
    of a scalar Kalman filter, over their sigma.
    """
    state, variance = np.zeros(len(rows)), 0.0
    white, log_determinant = np.empty_like(rows), 0.0
    for i in range(len(t)):
        variance += strength * (t[i] - t[i - 1]) if i else 0.0
        total = variance + sigma[i] ** 2
        innovation = rows[:, i] - state
        white[:, i] = innovation / np.sqrt(total)
        log_determinant += np.log(total)
        state = state + variance / total * innovation
        variance *= sigma[i] ** 2 / total
    return white, log_determinant
