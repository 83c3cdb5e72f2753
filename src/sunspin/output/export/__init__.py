"""Attitude and rates for other tools: the attitude of a results folder, at its samples or on a grid, as NetCDF and Parquet.

:mod:`sunspin.output.export.aem` writes a CCSDS attitude ephemeris message, :mod:`sunspin.output.export.ck` a SPICE C-kernel.
Their readers interpolate between two records along the shorter way. The records of both are therefore so dense that the body takes
that way. NetCDF and Parquet are tables of samples.

The Sun alone does not determine the rotation about the Sun direction. The frame N of such a result is local to its pass, and
the files name it so; a celestial frame is written only if the result states that its N is one.
"""

from __future__ import annotations

import io
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation, Slerp

from sunspin.base.errors import InputError, OutputError
from sunspin.base.netcdf import read_groups
from sunspin.dynamics.curve import CURVE_RAD, MOST_INSTANTS, rotations
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.environment.frames import BODY_AT_START, FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.output.folder import as_written, read_manifest, write_netcdf, write_whole
from sunspin.solve.rotations import without_sign_jumps

LOCAL_FRAME = "SUNSPIN_LOCAL"
"""Name of a frame whose orientation in space is not known."""

ORIENTATIONS = {
    SUN_Z_LOCAL: "its z axis points to the Sun, the turn about it is arbitrary and another in each pass",
    FIELD_Z_LOCAL: "its z axis follows the magnetic field, the turn about it is arbitrary and another in each pass",
    BODY_AT_START: "its axes are those of the body at the start of the run",
}
"""Orientation of a local frame, by `frame_N` of the results."""

LARGEST_STEP_RAD = 1.0
"""Largest rotation between neighbours of a motion that is interpolated. Of ten torque-free tumbling bodies with neighbours 1 rad
apart, attitudes are off by at most 0.01 degrees; at 0.1 rad by 4e-6 degrees."""

DENSE_RAD, BEND_RAD = 0.1, 1e-3
"""Rotation (rad) between records of a file whose readers interpolate, and by how much a uniform rotation from one to the next may
miss the motion: a twentieth of a degree."""

RATE_SHARE = 0.03
"""Of the largest rate: by how much a straight line between the rates of two records may miss the rate."""

COARSEST_RAD = np.radians(30.0)
"""Largest rotation between such records: beyond 180 degrees a reader goes backward, and near to it the axis is lost."""

MOST_DENSE = 200_000
"""Records that are filled in up to `DENSE_RAD`: a CK of 13 MB, an AEM of 20 MB. Longer motions get records farther apart."""

TINY = 1e-12
"""rad/s; no body turns so slowly that its rates differ by this."""

TOGETHER = 1e-3
"""Of the time between two instants of a curve: one so near to a sample is that sample."""

MAX_ATTITUDES = 1_000_000
"""An AEM of so many is 100 MB."""

MAX_TIME_S = 1e10
"""Three centuries: more is no time of a mission."""

SOURCES = ("rates.nc", "trajectory.nc")
"""Files of a results folder that hold an attitude."""


class Attitude(NamedTuple):
    """What is exported.

    `t_s` (n): s from `epoch`; `quaternion` (n, 4): B_from_N, scalar last; `omega_B` (n, 3): rad/s in B; `pass_of` (n): number of
    the pass; `name`, `number`: of the object; `centre`: what it orbits; `frame`: N; `orientation`: of a local N, in words.
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

    @property
    def utc(self) -> np.ndarray:
        """Times (n) as UTC, to the microsecond."""
        return self.epoch + np.round(self.t_s * 1e6).astype("timedelta64[us]")

    def largest_rotation(self) -> float:
        """Return the largest rotation, rad, from one attitude to the next of the same pass."""
        motion = Motion(self.t_s, self.quaternion, self.omega_B, self.pass_of)
        return float(motion.rotations().max(initial=0.0))

    def passes(self) -> list[np.ndarray]:
        """Indices of the samples of each pass."""
        return [np.flatnonzero(self.pass_of == number) for number in np.unique(self.pass_of)]


def read_results(folder: Any) -> tuple[xr.Dataset, Path]:
    """The Dataset with the attitude of a results folder, in the order of time, and the file it comes from."""
    manifest = read_manifest(Path(folder))
    for name in SOURCES:
        if name in manifest["data"]:
            path = as_written(Path(folder), manifest, name)
            data = read_groups(path, str(path), InputError, probe=False, times=True)["/"]
            for axis in ("time", "curve_time"):
                t = data[axis].values if axis in data.variables else np.zeros(0)
                if t.ndim == 1 and len(t) > 1 and np.all(np.diff(t) < 0):  # simulated backward
                    data = data.isel({axis: slice(None, None, -1)})
            return data, path
    got = "neither " + " nor ".join(SOURCES)
    do = "write one with `sunspin rates ... --out DIR` or `sunspin simulate ... --out DIR`"
    raise InputError("no attitude here", got=got, where=str(folder), do=do)


def attitude_of(
    data: xr.Dataset,
    frame: str | None = None,
    epoch_utc: str | None = None,
    step_s: float | None = None,
    dense: bool = False,
) -> Attitude:
    """The attitude of results of `rates` or `propagate`.

    Parameters
    ----------
    frame : str, optional
        The frame to write: `LOCAL_FRAME` or a name of one's own that contains LOCAL; a celestial one only for results whose
        ``frame_N`` is J2000 or whose attributes name it as ``celestial_frame``.
    epoch_utc : str, optional
        UTC of time zero, for results without one.
    step_s : float, optional
        One attitude every so many s of each pass, from the samples and the curve that results hold between them: by cubics that
        have the attitudes and rates of both neighbours.
    dense : bool
        For readers that interpolate. Attitudes are added between the samples if the body rotates by more than `DENSE_RAD` from
        one to the next. With `step_s` none is added, but a step of more than `COARSEST_RAD` is refused.

    Raises
    ------
    InputError
        Another frame, no epoch, damaged results; with `step_s` or `dense` a rotation of more than `LARGEST_STEP_RAD` between
        instants of the results, or more than `MAX_ATTITUDES`.
    """
    frame_N = data.attrs.get("frame_N")
    known = data.attrs.get("celestial_frame", J2000 if frame_N == J2000 else None)
    written = frame or known or LOCAL_FRAME
    local = "LOCAL" in written.upper()
    orientation = ORIENTATIONS.get(str(frame_N), "its orientation in space is not known")
    if written != known and not local:
        more = "" if frame_N == BODY_AT_START else ", or give `rates` an orbit and a magnetometer"
        what = f"this attitude is known in no celestial frame, but in a local one: {orientation}"
        raise InputError(what, got=written, do=f"export in {LOCAL_FRAME}{more}")
    motion = _motion_of(data)
    epoch = str(epoch_utc or data.attrs.get("epoch_utc"))
    try:
        moment = datetime.fromisoformat(epoch)
        moment = moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment
    except (ValueError, OverflowError):
        what, do = "the results have no UTC of their time zero", "give --epoch 2026-01-01T00:00:00Z"
        raise InputError(what, got=epoch, do=do) from None
    if step_s is not None:
        motion = _on_grid(_with_curve(data, motion), step_s, dense)
    elif dense and not _follow(motion, whole := _with_curve(data, motion)):
        motion = _filled(whole)
    number, name = (str(data.attrs.get(key, "")) for key in ("orbit", "orbit_name"))
    synthetic = ", synthetic telemetry" if data.attrs.get("synthetic", 0) else ""
    return Attitude(
        t_s=motion.t_s,
        epoch=np.datetime64(moment, "us"),
        quaternion=motion.quaternion,
        omega_B=motion.omega_B,
        pass_of=motion.pass_of,
        name=name if number and name else str(data.attrs.get("vehicle", "UNKNOWN")),
        number=number,
        centre="EARTH" if "orbit" in data.attrs else "UNKNOWN",
        frame=written,
        orientation=orientation if local else "",
        source=f"sunspin{synthetic}",
    )


class Motion(NamedTuple):
    """Instants of a motion, with the first four arrays of :class:`Attitude`."""

    t_s: np.ndarray
    quaternion: np.ndarray
    omega_B: np.ndarray
    pass_of: np.ndarray

    def rotations(self) -> np.ndarray:
        """Rotation (n - 1), rad, from each instant to the next of the same pass; 0 from one pass to another."""
        same = self.pass_of[1:] == self.pass_of[:-1]
        return np.where(same, rotations(self.t_s, self.omega_B, self.quaternion), 0.0)

    def at(self, t_s: np.ndarray, pass_of: np.ndarray) -> Motion:
        """Return the motion at times (m) within its passes, by cubics through attitudes and rates."""
        if len(self.t_s) == 1:
            return self
        omega, vector, scalar = self.omega_B, self.quaternion[:, :3], self.quaternion[:, 3:]
        change = -0.5 * np.hstack(  # dq/dt of B_from_N
            [scalar * omega + np.cross(omega, vector), -np.sum(omega * vector, 1, keepdims=True)]
        )
        cubic = CubicHermiteSpline(self.t_s, self.quaternion, change)
        q, change = cubic(t_s), cubic(t_s, 1)
        size = np.linalg.norm(q, axis=1, keepdims=True)
        q, change = q / size, change / size
        # the rate from dq/dt: the same equation, solved for it
        omega = q[:, 3:] * change[:, :3] - change[:, 3:] * q[:, :3]
        omega = -2 * (omega - np.cross(change[:, :3], q[:, :3]))
        return Motion(t_s, without_sign_jumps(q, pass_of), omega, pass_of)


def _motion_of(data: xr.Dataset, prefix: str = "") -> Motion:
    """Return the samples of results, or with the prefix "curve_" their curve, if they are a motion at all."""
    names = [f"{prefix}{name}" for name in ("time", "B_from_N", "omega_B", "pass_of")]
    if missing := [name for name in names[:3] if name not in data.variables]:
        raise InputError(f"the results have no {', '.join(missing)}")
    single = xr.DataArray(np.zeros(data.sizes.get(names[0], 0), dtype=int))
    t, quaternion, omega, pass_of = (data.get(name, single).values for name in names)
    numeric = all(each.dtype.kind in "iuf" for each in (t, quaternion, omega, pass_of))
    shapes = [each.shape for each in (t, quaternion, omega, pass_of)]
    if not numeric or not t.size or shapes != [(t.size, *more) for more in ((), (4,), (3,), ())]:
        what = "times, attitudes, rates and passes of these results do not belong together"
        raise InputError(what, got=shapes, do="run the command again")
    size = np.linalg.norm(np.clip(quaternion, -2.0, 2.0), axis=1)
    order = np.append(True, t[1:] > t[:-1]) & (np.abs(t) < MAX_TIME_S) & np.isfinite(pass_of)
    for what, right in (
        ("the times do not increase, or are no times", order),
        ("the attitudes are not unit quaternions", np.abs(size - 1) < 1e-6),
        (f"rates are not within {MAX_RATE:g} rad/s", np.abs(omega) <= MAX_RATE),
    ):
        if not np.all(right):
            raise InputError(f"{what} in these results", do="run the command again")
    return Motion(t, without_sign_jumps(quaternion / size[:, None], pass_of), omega, pass_of)


def _with_curve(data: xr.Dataset, samples: Motion) -> Motion:
    """Return the samples and the instants between them that the results hold, so close that cubics follow the motion.

    Raises
    ------
    InputError
        The instants are too far apart, with the command that makes them dense.
    """
    motion = samples
    if "curve_time" in data.variables:
        curve = _motion_of(data, "curve_")
        # an instant within rounding of a sample would make a piece without length
        middles = (samples.t_s[1:] + samples.t_s[:-1]) / 2
        distance = np.abs(curve.t_s - samples.t_s[np.searchsorted(middles, curve.t_s)])
        usual = np.median(np.diff(curve.t_s)) if len(curve.t_s) > 1 else 0.0
        apart = distance > TOGETHER * usual
        both = [np.concatenate([a, b[apart]]) for a, b in zip(samples, curve, strict=True)]
        motion = Motion(*(each[np.argsort(both[0], kind="stable")] for each in both))
        motion = motion._replace(quaternion=without_sign_jumps(motion.quaternion, motion.pass_of))
    rotation = motion.rotations()
    largest = rotation.max(initial=0.0)
    if largest <= LARGEST_STEP_RAD:
        return motion
    what = f"the body rotates by up to {np.degrees(largest):.0f} degrees between the instants that these results hold"
    what += ", so an interpolation would take the wrong way"
    do = "estimate a shorter stretch of time: `sunspin rates --from --to`"
    if data.attrs.get("kind") != "rates":
        do = f"simulate it again with --step {_figures(CURVE_RAD / _fastest(motion))}"
        share = MOST_INSTANTS * CURVE_RAD / rotation.sum()
        if share < 1:
            do = f"simulate it in parts, with a --duration of {_figures(share / 2 * np.ptp(motion.t_s))}"
    raise InputError(what, do=do)


def _figures(value: float) -> str:
    """Return a positive number in two figures, rounded down."""
    figure = 10.0 ** (np.floor(np.log10(value)) - 1)
    return f"{np.floor(value / figure) * figure:g}"


def _fastest(motion: Motion) -> float:
    """Return the largest angular speed of a motion, rad/s."""
    return float(np.linalg.norm(motion.omega_B, axis=1).max())


def _parts(motion: Motion) -> np.ndarray:
    """Return the number of uniform rotations (n - 1), no integers, that follow the motion from each instant to the next."""
    change = np.linalg.norm(np.diff(motion.omega_B, axis=0), axis=1) * np.diff(motion.t_s)
    change = np.where(motion.pass_of[1:] == motion.pass_of[:-1], change, 0.0)
    # a rate that changes by w in dt bends the way by w dt / 8
    return np.maximum(motion.rotations() / DENSE_RAD, np.sqrt(change / (8 * BEND_RAD)))


def _follow(samples: Motion, motion: Motion) -> bool:
    """Return whether uniform rotations from one sample to the next follow the motion."""
    if np.any(_parts(samples) > 1):
        return False
    if len(samples.t_s) == 1:
        return True
    path = Slerp(samples.t_s, Rotation.from_quat(samples.quaternion))(motion.t_s)
    bend = (path.inv() * Rotation.from_quat(motion.quaternion)).magnitude()
    rates = np.stack([np.interp(motion.t_s, samples.t_s, x) for x in samples.omega_B.T], axis=1)
    missed = np.abs(rates - motion.omega_B).max() / max(np.abs(motion.omega_B).max(), TINY)
    return bool(bend.max() < BEND_RAD and missed < RATE_SHARE)


def _filled(motion: Motion) -> Motion:
    """Return the motion with instants between its own, so close that a uniform rotation from one to the next follows it."""
    rotation, parts = motion.rotations(), _parts(motion)
    parts *= MOST_DENSE / max(parts.sum(), MOST_DENSE)
    parts = np.ceil(np.maximum(parts, np.maximum(rotation / COARSEST_RAD, 1.0))).astype(int)
    if parts.sum() >= MAX_ATTITUDES:
        what = f"this motion would take more than {MAX_ATTITUDES} attitudes"
        do = f"give --step {_figures(COARSEST_RAD / _fastest(motion))}"
        raise InputError(what, got=int(parts.sum()) + 1, do=do)
    share = np.concatenate([np.arange(n) / n for n in parts])
    at = np.repeat(motion.t_s[:-1], parts) + share * np.repeat(np.diff(motion.t_s), parts)
    at, number = (
        np.append(at, motion.t_s[-1]),
        np.append(np.repeat(motion.pass_of[:-1], parts), motion.pass_of[-1]),
    )
    return motion.at(at, number)


def _on_grid(motion: Motion, step_s: float, dense: bool) -> Motion:
    """Return the motion every `step_s` s of each pass; `dense`: only if readers may interpolate."""
    if not np.isfinite(step_s):
        raise InputError("--step must be a time in s", got=step_s, do="give a number of seconds")
    t, pass_of = motion.t_s, motion.pass_of
    numbers = np.unique(pass_of)
    ends = [t[pass_of == number][[0, -1]] for number in numbers]
    starts, spans = np.array([(first, last - first) for first, last in ends]).T
    counts = (np.minimum(spans / step_s + 1e-9, 10.0 * MAX_ATTITUDES)).astype(int) + 1
    if counts.sum() > MAX_ATTITUDES:
        what = f"this would be more than {MAX_ATTITUDES} attitudes"
        raise InputError(what, got=step_s, do="give a longer --step")
    at = np.concatenate([t0 + step_s * np.arange(n) for t0, n in zip(starts, counts, strict=True)])
    grid = motion.at(at, np.repeat(numbers, counts))
    largest = grid.rotations().max(initial=0.0)
    if dense and largest > COARSEST_RAD:
        what = f"the body rotates by up to {np.degrees(largest):.0f} degrees in this --step, and readers of the file interpolate"
        do = f"give --step {_figures(COARSEST_RAD / _fastest(motion))} or less, or none"
        raise InputError(what, got=f"{step_s:g} s", do=do)
    return grid


def write_cf(target: Path, data: xr.Dataset, attitude: Attitude) -> Path:
    """NetCDF with CF attributes: the results with the attitude as exported, time as a CF coordinate."""
    if not np.array_equal(data["time"].values, attitude.t_s):  # on a grid
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
    about = {"frame": attitude.frame, "source": attitude.source}
    return write_netcdf(target, data.assign_attrs(conventions | about))


def write_parquet(target: Path, attitude: Attitude) -> Path:
    """One row per sample; frame, object and source in the file's metadata."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        what, do = "Parquet needs pyarrow", 'pip install "sunspin[parquet]"'
        raise OutputError(what, do=do) from None
    columns = {"time_utc": attitude.utc, "time_s": attitude.t_s, "pass": attitude.pass_of}
    columns |= {f"q_{k}_B_from_N": q for k, q in zip("xyzw", attitude.quaternion.T, strict=True)}
    columns |= {f"omega_{k}_B_rad_s": w for k, w in zip("xyz", attitude.omega_B.T, strict=True)}
    about = {"frame": attitude.frame, "object": attitude.name, "source": attitude.source}
    about["epoch_utc"] = f"{attitude.epoch}Z"
    buffer = io.BytesIO()  # pyarrow takes no name that is not UTF-8
    pq.write_table(pa.table(columns).replace_schema_metadata(about), buffer)
    return write_whole(target, buffer.getvalue())
