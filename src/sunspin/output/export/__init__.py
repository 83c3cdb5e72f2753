"""Export of attitude and rates of a results folder for other tools: at the samples or on a grid, as NetCDF and Parquet.

:mod:`sunspin.output.export.aem` writes a CCSDS attitude ephemeris message, :mod:`sunspin.output.export.ck` a SPICE C-kernel.
Their readers interpolate between two records along the shorter rotation. Both files therefore have records so dense that the body
rotates by that way. NetCDF and Parquet are tables of samples.

The Sun alone does not determine the rotation about the Sun direction. The frame N of such a result is local to its pass, and
the files name it so; a celestial frame is written only if the result states that its N is one.
"""

from __future__ import annotations

import io
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from sunspin.base.errors import InputError, OutputError, printable
from sunspin.base.netcdf import read_groups
from sunspin.dynamics.curve import CURVE_RAD, MOST_INSTANTS, rotations
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.environment.frames import BODY_AT_START, FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.output.folder import read_manifest, verify_file, write_netcdf, write_whole
from sunspin.solve.rotations import without_sign_jumps

LOCAL_FRAME = "SUNSPIN_LOCAL"
"""Name of a frame whose orientation in space is not known."""

ORIENTATIONS = {
    SUN_Z_LOCAL: "its z axis points to the Sun, the rotation about it is arbitrary and differs from pass to pass",
    FIELD_Z_LOCAL: "its z axis follows the magnetic field, the rotation about it is arbitrary and differs from pass to pass",
    BODY_AT_START: "its axes are those of the body at the start of the run",
}
"""Orientation of a local frame, by `frame_N` of the results."""

LARGEST_STEP_RAD = 1.0
"""Largest rotation (rad) between neighbouring instants of a motion that is interpolated with cubics. The errors of ten torque-free
tumbling bodies were at most 0.01 degrees with instants 1 rad apart, and 4e-6 degrees with 0.1 rad."""

DENSE_RAD = 0.1
"""Largest rotation (rad) between records of a file whose readers interpolate."""

BEND_RAD = 1e-3
"""Largest angle (rad, 0.06 degrees) between the motion and a uniform rotation from one such record to the next."""

RATE_SHARE = 0.03
"""Largest error of a linear interpolation of the rate between two such records, as a fraction of the largest rate."""

COARSEST_RAD = np.radians(30.0)
"""Largest rotation (rad) between such records of a very long motion. A reader would rotate backward if it exceeded 180 degrees, and
near 180 degrees the axis of rotation is uncertain."""

MOST_DENSE = 200_000
"""Records up to which `DENSE_RAD` is kept: a CK of 13 MB, an AEM of 20 MB. Longer motions get records farther apart."""

TINY = 1e-12
"""Lower limit of the largest rate (rad/s), so that it can be divided by."""

TOGETHER = 1e-3
"""An instant of a curve counts as a sample if it is nearer to it than this fraction of the usual interval of the curve."""

MAX_ATTITUDES = 1_000_000
"""Largest number of records: an AEM of that many is 100 MB."""

MAX_TIME_S = 1e10
"""Largest time (s) from the epoch, three centuries; larger ones are damage of the file."""

SOURCES = ("rates.nc", "trajectory.nc")
"""Files of a results folder that hold an attitude; the first one that exists is exported."""


class AttitudeHistory(NamedTuple):
    """An attitude history to export, with what a file says of its object and frame.

    Attributes
    ----------
    t_s : times (n), s from `epoch`
    epoch : UTC of time zero
    quaternion : B_from_N (n, 4), scalar last
    omega_B : body rates (n, 3) in body axes, rad/s
    pass_of : number of the pass of each attitude (n)
    name, number : name and catalogue number of the spacecraft
    centre : the body that it orbits
    frame : name of the frame N
    orientation : orientation of N in words, if N is a local frame
    source : program, and whether the telemetry was synthetic
    undecided : number of each pass that is not decided -> a sentence with the reason
    """

    t_s: np.ndarray
    epoch: np.datetime64
    quaternion: np.ndarray
    omega_B: np.ndarray
    pass_of: np.ndarray
    name: str
    number: str
    centre: str
    frame: str
    orientation: str
    source: str
    undecided: dict[int, str]

    @property
    def utc(self) -> np.ndarray:
        """Times (n) in UTC, to the microsecond."""
        return self.epoch + np.round(self.t_s * 1e6).astype("timedelta64[us]")

    def largest_rotation(self) -> float:
        """Return the largest rotation (rad) from one attitude to the next of the same pass."""
        samples = AttitudeSamples(self.t_s, self.quaternion, self.omega_B, self.pass_of)
        return float(samples.rotations().max(initial=0.0))

    def passes(self) -> list[np.ndarray]:
        """Return the indices of the attitudes of each pass."""
        return [np.flatnonzero(self.pass_of == number) for number in np.unique(self.pass_of)]


def read_attitude_data(folder: Any) -> tuple[xr.Dataset, Path]:
    """Read the Dataset of a results folder that holds the attitude, and return it, sorted by time, with the path of its file.

    Raises
    ------
    InputError
        The folder is no results folder, is damaged, or holds no attitude.
    """
    manifest = read_manifest(Path(folder))
    for name in SOURCES:
        if name in manifest["data"]:
            path = verify_file(Path(folder), manifest, name)
            data = read_groups(path, str(path), InputError, probe=False, times=True)["/"]
            for axis in ("time", "curve_time"):
                t = data[axis].values if axis in data.variables else np.zeros(0)
                if t.ndim == 1 and len(t) > 1 and np.all(np.diff(t) < 0):  # simulated backward
                    data = data.isel({axis: slice(None, None, -1)})
            return data, path
    got = "neither " + " nor ".join(SOURCES)
    do = "write one with `sunspin rates ... --out DIR` or `sunspin simulate ... --out DIR`"
    raise InputError("no attitude here", got=got, where=str(folder), do=do)


def build_attitude(
    data: xr.Dataset,
    frame: str | None = None,
    epoch_utc: str | None = None,
    step_s: float | None = None,
    dense: bool = False,
) -> AttitudeHistory:
    """Return the attitude history of a result of `rates` or `propagate` as it is exported.

    Parameters
    ----------
    frame : str, optional
        Name of the frame N in the file: `LOCAL_FRAME` or another name that contains LOCAL. A celestial frame is accepted only if
        ``frame_N`` of the result is J2000 or its attribute ``celestial_frame`` names that frame.
    epoch_utc : str, optional
        UTC of time zero, for results without one.
    step_s : float, optional
        Interval (s) of the attitudes in each pass; default: at the samples. Attitudes are interpolated between the instants of the
        result, samples and curve, by cubics that match attitude and rate of both neighbours.
    dense : bool
        Whether readers of the file interpolate. If the body rotates by more than `DENSE_RAD` from one sample to the next,
        attitudes are added in between. With `step_s` none is added, but a step of more than `COARSEST_RAD` is refused.

    Raises
    ------
    InputError
        The frame is not known for the result, its epoch is missing or another, or it is damaged. With `step_s` or `dense` also: the
        instants of the result are more than `LARGEST_STEP_RAD` apart, or there would be more than `MAX_ATTITUDES`.
    """
    frame_name, orientation = _choose_frame(data, frame)
    samples = _read_samples(data)
    known = data.attrs.get("epoch_utc")
    epoch = stored = _parse_epoch(str(epoch_utc or known))
    with suppress(InputError):  # a damaged one is replaced
        stored = _parse_epoch(str(known))
    if epoch != stored:
        what = "the results have another UTC of their time zero"
        raise InputError(what, got=f"{epoch_utc}, and {known} there", do="leave --epoch out")
    if step_s is not None:
        samples = _resample(_add_curve(data, samples), step_s, dense)
    elif dense:
        motion = _add_curve(data, samples)
        if not _readers_follow(samples, motion):
            samples = _fill_between(motion)
    number, name = (str(data.attrs.get(key, "")) for key in ("orbit", "orbit_name"))
    synthetic = ", synthetic telemetry" if data.attrs.get("synthetic", 0) else ""
    return AttitudeHistory(
        t_s=samples.t_s,
        epoch=epoch,
        quaternion=samples.quaternion,
        omega_B=samples.omega_B,
        pass_of=samples.pass_of,
        name=name if number and name else str(data.attrs.get("vehicle", "UNKNOWN")),
        number=number,
        centre="EARTH" if "orbit" in data.attrs else "UNKNOWN",
        frame=frame_name,
        orientation=orientation,
        source=f"sunspin{synthetic}",
        undecided=_undecided(data),
    )


def _undecided(data: xr.Dataset) -> dict[int, str]:
    """Return the passes that are not decided, by their number in `pass_of`, each with a sentence; none for a simulation."""
    names = ("pass_id", "decided", "why_not_decided")
    if any(name not in data or data[name].dims != ("pass_id",) for name in names):
        return {}
    passes = zip(*(data[name].values for name in names), strict=True)
    return {
        place: printable(
            f"pass {number} is not decided ({why}): another motion may be the right one"
        )
        for place, (number, decided, why) in enumerate(passes)
        if not decided
    }


def motion_at(data: xr.Dataset, times: Any) -> xr.Dataset:
    """Return attitude and rate of a result of `rates` or `propagate` at any times.

    Parameters
    ----------
    times : (n)
        Seconds from the epoch of the result, or UTC times such as "2026-01-31T12:00:00Z".

    Returns
    -------
    xarray.Dataset
        Over `time` (s from the epoch): `B_from_N` (time, quaternion), `omega_B` (time, axis) in rad/s and `pass_of` (time), the
        number of the pass; NaN and -1 at times outside all passes. `frame_N` as in the result. Attitudes are interpolated as in
        :func:`build_attitude`. The frame N of different passes may differ (`ORIENTATIONS`).

    Raises
    ------
    InputError
        A time cannot be read, or the instants of the result are too far apart to interpolate between them.
    """
    t = _parse_times(times, data.attrs.get("epoch_utc"))
    motion = _add_curve(data, _read_samples(data))
    quaternion, omega = np.full((t.size, 4), np.nan), np.full((t.size, 3), np.nan)
    pass_of = np.full(t.size, -1)
    for number in np.unique(motion.pass_of):
        of_pass = AttitudeSamples(*(array[motion.pass_of == number] for array in motion))
        inside = (t >= of_pass.t_s[0]) & (t <= of_pass.t_s[-1])
        if inside.any():
            found = of_pass.interpolate(t[inside], np.full(inside.sum(), number))
            quaternion[inside], omega[inside] = found.quaternion, found.omega_B
            pass_of[inside] = number
    names = {"axis": ["x", "y", "z"], "quaternion": ["x", "y", "z", "w"]}
    attrs = {
        key: data.attrs[key] for key in ("epoch_utc", "frame_N", "synthetic") if key in data.attrs
    }
    return xr.Dataset(
        {
            "B_from_N": (("time", "quaternion"), quaternion),
            "omega_B": (("time", "axis"), omega),
            "pass_of": ("time", pass_of),
        },
        {"time": t, **names},
        attrs,
    )


def _parse_times(times: Any, epoch_utc: str | None) -> np.ndarray:
    """Return times (n) in s from the epoch of a result, from seconds or UTC; raise `InputError` if one cannot be read."""
    values = np.atleast_1d(np.asarray(times))
    if values.ndim > 1:
        what, got = "the times have several dimensions", f"shape {values.shape}"
        raise InputError(what, got=got, do="give a list of times")
    if values.dtype.kind in "iuf":
        return values.astype(np.float64)
    if not epoch_utc:
        what = "the result has no UTC of its time zero"
        raise InputError(what, got=str(values[:1]), do="give times in seconds")
    if values.dtype.kind != "M":
        do = "give seconds from the epoch of the result, or UTC such as 2026-01-31T12:00:00Z"
        values = np.array(
            [_parse_utc(str(text), "this time cannot be read", do) for text in values]
        )
    return (values.astype("datetime64[us]") - _parse_epoch(epoch_utc)) / np.timedelta64(1, "s")


def _choose_frame(data: xr.Dataset, frame: str | None) -> tuple[str, str]:
    """Return the name of the frame N in the file, and its orientation in words, which is empty for a celestial frame.

    `frame`: the name that the user wants, or None. Raises `InputError` for the name of a celestial frame that is not that of the
    result.
    """
    frame_N = data.attrs.get("frame_N")
    celestial = data.attrs.get("celestial_frame", J2000 if frame_N == J2000 else None)
    name = frame or celestial or LOCAL_FRAME
    orientation = ORIENTATIONS.get(str(frame_N), "its orientation in space is not known")
    if "LOCAL" in name.upper():
        return name, orientation
    if name != celestial:
        remedy = "" if frame_N == BODY_AT_START else ", or give `rates` an orbit and a magnetometer"
        what = f"this attitude is known in no celestial frame, but in a local one: {orientation}"
        raise InputError(what, got=name, do=f"export in {LOCAL_FRAME}{remedy}")
    return name, ""


def _parse_epoch(epoch: str) -> np.datetime64:
    """Return the UTC of time zero from an ISO-8601 text; raise `InputError` for other text."""
    what, do = "the results have no UTC of their time zero", "give --epoch 2026-01-01T00:00:00Z"
    return _parse_utc(epoch, what, do)


def _parse_utc(text: str, what: str, do: str) -> np.datetime64:
    """Return UTC from an ISO-8601 text, with any time zone or none (UTC); raise `InputError` (`what`, `do`) for other text."""
    try:
        moment = datetime.fromisoformat(text)
        moment = moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment
    except (ValueError, OverflowError):
        raise InputError(what, got=text, do=do) from None
    return np.datetime64(moment, "us")


class AttitudeSamples(NamedTuple):
    """Attitudes and rates at instants of a motion: the arrays of :class:`AttitudeHistory`."""

    t_s: np.ndarray
    quaternion: np.ndarray
    omega_B: np.ndarray
    pass_of: np.ndarray

    def rotations(self) -> np.ndarray:
        """Return the rotations (n - 1), rad, from each instant to the next of the same pass; 0 from one pass to another."""
        same = self.pass_of[1:] == self.pass_of[:-1]
        return np.where(same, rotations(self.t_s, self.omega_B, self.quaternion), 0.0)

    def interpolate(self, t_s: np.ndarray, pass_of: np.ndarray) -> AttitudeSamples:
        """Return attitudes and rates at times `t_s` (m) within the passes `pass_of` (m), by cubics through attitudes and rates.

        A single instant, between which and others nothing can be interpolated, is returned as it is.
        """
        if len(self.t_s) == 1:
            return self
        omega, vector, scalar = self.omega_B, self.quaternion[:, :3], self.quaternion[:, 3:]
        # dq/dt = -(omega, 0) q / 2, a product of quaternions with scalar last, for q = B_from_N
        derivative = -0.5 * np.hstack(
            [scalar * omega + np.cross(omega, vector), -np.sum(omega * vector, 1, keepdims=True)]
        )
        cubic = CubicHermiteSpline(self.t_s, self.quaternion, derivative)
        # the cubic leaves the unit sphere a little, so both are divided by its norm
        norm = np.linalg.norm(cubic(t_s), axis=1, keepdims=True)
        q, q_dot = cubic(t_s) / norm, cubic(t_s, 1) / norm
        # the same equation solved for the rate: (omega, 0) = -2 dq/dt conjugate(q), of which the vector part is
        scalar_terms = q[:, 3:] * q_dot[:, :3] - q_dot[:, 3:] * q[:, :3]
        omega_interpolated = -2 * (scalar_terms - np.cross(q_dot[:, :3], q[:, :3]))
        return AttitudeSamples(t_s, without_sign_jumps(q, pass_of), omega_interpolated, pass_of)


def _read_samples(data: xr.Dataset, prefix: str = "") -> AttitudeSamples:
    """Return attitudes and rates of a result: its samples, or with the prefix "curve_" its curve between them.

    Raises
    ------
    InputError
        A variable is missing, or the values are not those of a motion.
    """
    names = [f"{prefix}{name}" for name in ("time", "B_from_N", "omega_B", "pass_of")]
    if missing := [name for name in names[:3] if name not in data.variables]:
        raise InputError(f"the results have no {', '.join(missing)}")
    single_pass = xr.DataArray(np.zeros(data.sizes.get(names[0], 0), dtype=int))
    t, quaternion, omega, pass_of = (data.get(name, single_pass).values for name in names)
    arrays = (t, quaternion, omega, pass_of)
    numeric = all(array.dtype.kind in "iuf" for array in arrays)  # integers and floats
    shapes = [array.shape for array in arrays]
    if not numeric or not t.size or shapes != [(t.size,), (t.size, 4), (t.size, 3), (t.size,)]:
        what = "times, attitudes, rates and passes of these results do not belong together"
        raise InputError(what, got=shapes, do="run the command again")
    # clipped, as the square of a huge number in a damaged file would overflow
    norm = np.linalg.norm(np.clip(quaternion, -2.0, 2.0), axis=1)
    increasing = np.append(True, t[1:] > t[:-1])
    for what, valid in (
        (
            "the times do not increase, or are no times",
            increasing & (np.abs(t) < MAX_TIME_S) & np.isfinite(pass_of),
        ),
        ("the attitudes are not unit quaternions", np.abs(norm - 1) < 1e-6),
        (f"rates are not within {MAX_RATE:g} rad/s", np.abs(omega) <= MAX_RATE),
    ):
        if not np.all(valid):
            raise InputError(f"{what} in these results", do="run the command again")
    unit_quaternion = without_sign_jumps(quaternion / norm[:, None], pass_of)
    return AttitudeSamples(t, unit_quaternion, omega, pass_of)


def _add_curve(data: xr.Dataset, samples: AttitudeSamples) -> AttitudeSamples:
    """Return the samples together with the instants of the curve that the result holds between them.

    Raises
    ------
    InputError
        The instants are too far apart for cubics to follow the motion; the message names the command that makes them denser.
    """
    motion = samples
    if "curve_time" in data.variables:
        curve = _read_samples(data, "curve_")
        # an instant within rounding of a sample is that sample: a cubic between the two would have no length
        middles = (samples.t_s[1:] + samples.t_s[:-1]) / 2
        # time of the sample nearest to each instant
        nearest_sample = samples.t_s[np.searchsorted(middles, curve.t_s)]
        usual_interval = np.median(np.diff(curve.t_s)) if len(curve.t_s) > 1 else 0.0
        is_new = np.abs(curve.t_s - nearest_sample) > TOGETHER * usual_interval
        joined = [
            np.concatenate([of_samples, of_curve[is_new]])
            for of_samples, of_curve in zip(samples, curve, strict=True)
        ]
        by_time = np.argsort(joined[0], kind="stable")
        motion = AttitudeSamples(*(array[by_time] for array in joined))
        motion = motion._replace(quaternion=without_sign_jumps(motion.quaternion, motion.pass_of))
    rotation = motion.rotations()
    largest = rotation.max(initial=0.0)
    if largest <= LARGEST_STEP_RAD:
        return motion
    what = f"the body rotates by up to {np.degrees(largest):.0f} degrees between the instants that these results hold"
    what += ", so an interpolation would take the wrong way"
    do = "estimate a shorter stretch of time: `sunspin rates --from --to`"
    if data.attrs.get("kind") != "rates":
        do = f"simulate it again with --step {_round_down(CURVE_RAD / _largest_speed(motion))}"
        # fraction of the motion for which a simulation would write instants close enough
        share = MOST_INSTANTS * CURVE_RAD / rotation.sum()
        if share < 1:
            # half, as the rotation may be faster in a part
            duration = share / 2 * np.ptp(motion.t_s)
            do = f"simulate it in parts, with a --duration of {_round_down(duration)}"
    raise InputError(what, do=do)


def _round_down(value: float) -> str:
    """Return a positive number with two significant digits, rounded down, so that it is within the limit that it states."""
    last_digit = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / last_digit) * last_digit:g}"


def _largest_speed(motion: AttitudeSamples) -> float:
    """Return the largest angular speed (rad/s)."""
    return float(np.linalg.norm(motion.omega_B, axis=1).max())


def _count_parts(motion: AttitudeSamples) -> np.ndarray:
    """Return into how many parts (n - 1) each interval must be divided so that uniform rotations follow the motion.

    The numbers are not rounded: one below 1 means that a single uniform rotation is more than close enough.
    """
    rate_change = np.linalg.norm(np.diff(motion.omega_B, axis=0), axis=1)
    # If the rate changes linearly by w within dt, the motion departs from a uniform rotation by up to w dt / 8, at half time.
    # The departure falls with the square of the number of parts.
    departure = rate_change * np.diff(motion.t_s) / 8
    departure = np.where(motion.pass_of[1:] == motion.pass_of[:-1], departure, 0.0)
    return np.maximum(motion.rotations() / DENSE_RAD, np.sqrt(departure / BEND_RAD))


def _readers_follow(samples: AttitudeSamples, motion: AttitudeSamples) -> bool:
    """Return whether a reader that interpolates between the samples follows the motion, in attitude and in rate.

    `motion`: the samples with the curve between them. A reader interpolates attitudes by uniform rotations and rates linearly.
    """
    if np.any(_count_parts(samples) > 1):
        return False
    if len(samples.t_s) == 1:
        return True
    # at the instants of the dense motion: angle to the interpolated attitude, and error of the interpolated rate
    read = Slerp(samples.t_s, Rotation.from_quat(samples.quaternion))(motion.t_s)
    angle = (read.inv() * Rotation.from_quat(motion.quaternion)).magnitude()
    rates = np.stack(
        [np.interp(motion.t_s, samples.t_s, component) for component in samples.omega_B.T], axis=1
    )
    error = np.abs(rates - motion.omega_B).max() / max(np.abs(motion.omega_B).max(), TINY)
    return bool(angle.max() < BEND_RAD and error < RATE_SHARE)


def _fill_between(motion: AttitudeSamples) -> AttitudeSamples:
    """Return the motion with instants added between its own, so close that uniform rotations between them follow it.

    Raises
    ------
    InputError
        More than `MAX_ATTITUDES` would be needed.
    """
    rotation, parts = motion.rotations(), _count_parts(motion)
    # a motion that needs more than `MOST_DENSE` gets fewer everywhere, but never steps of more than `COARSEST_RAD`
    parts *= MOST_DENSE / max(parts.sum(), MOST_DENSE)
    parts = np.ceil(np.maximum(parts, np.maximum(rotation / COARSEST_RAD, 1.0))).astype(int)
    if parts.sum() >= MAX_ATTITUDES:
        what = f"this motion would take more than {MAX_ATTITUDES} attitudes"
        do = f"give --step {_round_down(COARSEST_RAD / _largest_speed(motion))}"
        raise InputError(what, got=int(parts.sum()) + 1, do=do)
    # the part of its interval that has passed at each instant
    share = np.concatenate([np.arange(n) / n for n in parts])
    t_s = np.repeat(motion.t_s[:-1], parts) + share * np.repeat(np.diff(motion.t_s), parts)
    pass_of = np.repeat(motion.pass_of[:-1], parts)
    return motion.interpolate(
        np.append(t_s, motion.t_s[-1]), np.append(pass_of, motion.pass_of[-1])
    )


def _resample(motion: AttitudeSamples, step_s: float, dense: bool) -> AttitudeSamples:
    """Return attitudes and rates every `step_s` seconds (above zero) of each pass, from its first instant on.

    `motion`: instants near enough to each other for cubics to interpolate. `dense`: readers of the file interpolate.

    Raises
    ------
    InputError
        There would be more than `MAX_ATTITUDES`, or, if `dense`, the body rotates by more than `COARSEST_RAD` in a step.
    """
    if not np.isfinite(step_s):
        raise InputError("--step must be a time in s", got=step_s, do="give a number of seconds")
    passes = np.unique(motion.pass_of)
    ends = np.array([motion.t_s[motion.pass_of == number][[0, -1]] for number in passes])
    starts, durations = ends[:, 0], ends[:, 1] - ends[:, 0]
    # Instants of each pass. Without 1e-9 of a step, rounding would lose the last instant if the duration is a multiple of the step.
    # A tiny step would overflow the integer: the number is limited to one that is refused below.
    counts = (np.minimum(durations / step_s + 1e-9, 10.0 * MAX_ATTITUDES)).astype(int) + 1
    if counts.sum() > MAX_ATTITUDES:
        what = f"this would be more than {MAX_ATTITUDES} attitudes"
        raise InputError(what, got=step_s, do="give a longer --step")
    times = [start + step_s * np.arange(n) for start, n in zip(starts, counts, strict=True)]
    grid = motion.interpolate(np.concatenate(times), np.repeat(passes, counts))
    largest = grid.rotations().max(initial=0.0)
    if dense and largest > COARSEST_RAD:
        what = f"the body rotates by up to {np.degrees(largest):.0f} degrees in this --step, and readers of the file interpolate"
        do = f"give --step {_round_down(COARSEST_RAD / _largest_speed(motion))} or less, or none"
        raise InputError(what, got=f"{step_s:g} s", do=do)
    return grid


def write_cf(target: Path, data: xr.Dataset, attitude: AttitudeHistory) -> Path:
    """Write a result with its attitude as exported to NetCDF with CF attributes, and return the path."""
    # Other variables over time hold at the samples only: they are left out if the attitudes are at other times.
    if not np.array_equal(data["time"].values, attitude.t_s):
        data = data.drop_dims("time").assign(pass_of=("time", attitude.pass_of))
    time = {"units": f"seconds since {str(attitude.epoch).replace('T', ' ')} UTC"}
    time |= {"standard_name": "time", "long_name": "UTC", "calendar": "standard"}
    what = f"attitude quaternion, scalar last, {attitude.frame} to body"
    quaternion = {"units": "1", "long_name": what}
    omega = {"units": "rad s-1", "long_name": "angular velocity, body axes"}
    data = data.assign_coords(time=("time", attitude.t_s, time)).assign(
        B_from_N=(("time", "quaternion"), attitude.quaternion, quaternion),
        omega_B=(("time", "axis"), attitude.omega_B, omega),
    )
    conventions = {"Conventions": "CF-1.11", "title": f"Attitude of {attitude.name}"}
    origin = {"frame": attitude.frame, "source": attitude.source}
    return write_netcdf(target, data.assign_attrs(conventions | origin))


def write_parquet(target: Path, attitude: AttitudeHistory) -> Path:
    """Write an attitude as Parquet, a row for each instant, and return the path.

    Frame, object and source are in the metadata of the file. Raises `OutputError` if pyarrow is not installed.
    """
    try:
        import pyarrow
        import pyarrow.parquet
    except ImportError:
        what, do = "Parquet needs pyarrow", 'pip install "sunspin[parquet]"'
        raise OutputError(what, do=do) from None
    decided = ~np.isin(attitude.pass_of, list(attitude.undecided))
    columns = {"time_utc": attitude.utc, "time_s": attitude.t_s, "pass": attitude.pass_of}
    columns |= {"decided": decided}
    columns |= {f"q_{k}_B_from_N": q for k, q in zip("xyzw", attitude.quaternion.T, strict=True)}
    columns |= {f"omega_{k}_B_rad_s": w for k, w in zip("xyz", attitude.omega_B.T, strict=True)}
    metadata = {"frame": attitude.frame, "object": attitude.name, "source": attitude.source}
    metadata["epoch_utc"] = f"{attitude.epoch}Z"
    buffer = io.BytesIO()  # pyarrow refuses file names that are not UTF-8
    table = pyarrow.table(columns).replace_schema_metadata(metadata)
    pyarrow.parquet.write_table(table, buffer)
    return write_whole(target, buffer.getvalue())
