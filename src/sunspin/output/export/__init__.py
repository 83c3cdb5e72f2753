"""Attitude and rates for other tools: the attitude of a results folder, at its samples or on a grid, as NetCDF and Parquet.

:mod:`sunspin.output.export.aem` writes a CCSDS attitude ephemeris message, :mod:`sunspin.output.export.ck` a SPICE C-kernel.
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

from sunspin.base.errors import InputError, OutputError
from sunspin.base.netcdf import read_groups
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.environment.frames import BODY_AT_START, FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.output.folder import as_written, read_manifest, write_netcdf, write_whole
from sunspin.solve.rotations import continuous

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
apart, attitudes are off by at most 0.01 degrees and rates by 2 %; at 0.1 rad by 4e-6 degrees and 0.03 %."""

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
            t = data["time"].values if "time" in data.variables else np.zeros(0)
            backward = t.ndim == 1 and len(t) > 1 and np.all(np.diff(t) < 0)
            return data.isel(time=slice(None, None, -1)) if backward else data, path
    got = "neither " + " nor ".join(SOURCES)
    do = "write one with `sunspin rates ... --out DIR` or `sunspin simulate ... --out DIR`"
    raise InputError("no attitude here", got=got, where=str(folder), do=do)


def attitude_of(
    data: xr.Dataset,
    frame: str | None = None,
    epoch_utc: str | None = None,
    step_s: float | None = None,
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
        One attitude every so many s of each pass, from the curves that results of `rates` have between their samples, else
        from the samples: by cubics that have the attitudes and rates of both neighbours, rates by straight lines.

    Raises
    ------
    InputError
        Another frame, no epoch, damaged results; with `step_s` a rotation of more than `LARGEST_STEP_RAD` between neighbours,
        or more than `MAX_ATTITUDES`.
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
    prefix = "curve_" if step_s is not None and "curve_time" in data.variables else ""
    names = [f"{prefix}{name}" for name in ("time", "B_from_N", "omega_B", "pass_of")]
    if missing := [name for name in names[:3] if name not in data.variables]:
        raise InputError(f"the results have no {', '.join(missing)}")
    single = xr.DataArray(np.zeros(data.sizes.get("time", 0), dtype=int))
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
    epoch = str(epoch_utc or data.attrs.get("epoch_utc"))
    try:
        moment = datetime.fromisoformat(epoch)
        moment = moment.astimezone(UTC).replace(tzinfo=None) if moment.tzinfo else moment
    except (ValueError, OverflowError):
        what, do = "the results have no UTC of their time zero", "give --epoch 2026-01-01T00:00:00Z"
        raise InputError(what, got=epoch, do=do) from None
    number, name = (str(data.attrs.get(key, "")) for key in ("orbit", "orbit_name"))
    synthetic = ", synthetic telemetry" if data.attrs.get("synthetic", 0) else ""
    attitude = Attitude(
        t_s=t,
        epoch=np.datetime64(moment, "us"),
        quaternion=continuous(quaternion / size[:, None], pass_of),
        omega_B=omega,
        pass_of=pass_of,
        name=name if number and name else str(data.attrs.get("vehicle", "UNKNOWN")),
        number=number,
        centre="EARTH" if "orbit" in data.attrs else "UNKNOWN",
        frame=written,
        orientation=orientation if local else "",
        source=f"sunspin{synthetic}",
    )
    return attitude if step_s is None else _on_grid(attitude, step_s)


def _on_grid(attitude: Attitude, step_s: float) -> Attitude:
    """The attitude every `step_s` s of each pass."""
    from scipy.interpolate import CubicHermiteSpline

    t, q, omega, pass_of = attitude.t_s, attitude.quaternion, attitude.omega_B, attitude.pass_of
    starts, spans = np.transpose([(t[i[0]], t[i[-1]] - t[i[0]]) for i in attitude.passes()])
    counts = (np.minimum(spans / step_s + 1e-9, 10.0 * MAX_ATTITUDES)).astype(int) + 1
    if counts.sum() > MAX_ATTITUDES:
        what = f"this would be more than {MAX_ATTITUDES} attitudes"
        raise InputError(what, got=step_s, do="give a longer --step")
    if len(t) == 1:
        return attitude
    angle = 2 * np.arccos(np.minimum(np.abs(np.einsum("ni,ni->n", q[1:], q[:-1])), 1.0))
    angle = np.maximum(angle, np.linalg.norm(omega[:-1], axis=1) * np.diff(t))
    largest = np.max(angle[pass_of[1:] == pass_of[:-1]], initial=0.0)
    if largest > LARGEST_STEP_RAD:
        what = f"the body turns by up to {np.degrees(largest):.0f} degrees between the instants that these results hold"
        do = "export without --step, or a shorter stretch of time: `sunspin rates --from --to`"
        raise InputError(what, do=do)
    at = np.concatenate([t0 + step_s * np.arange(n) for t0, n in zip(starts, counts, strict=True)])
    vector, scalar = q[:, :3], q[:, 3:]
    rate = -0.5 * np.hstack(  # dq/dt of B_from_N
        [scalar * omega + np.cross(omega, vector), -np.sum(omega * vector, axis=1, keepdims=True)]
    )
    dense = CubicHermiteSpline(t, q, rate)(at)
    dense /= np.linalg.norm(dense, axis=1, keepdims=True)
    number = np.repeat(np.unique(pass_of), counts)
    dense = continuous(dense, number)
    rates = np.stack([np.interp(at, t, component) for component in omega.T], axis=1)
    return attitude._replace(t_s=at, quaternion=dense, omega_B=rates, pass_of=number)


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
