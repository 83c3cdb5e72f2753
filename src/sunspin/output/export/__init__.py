"""Attitude and rates in the formats that other tools read: what is common to them.

A CCSDS attitude ephemeris message (:mod:`sunspin.output.export.aem`), a SPICE C-kernel (:mod:`sunspin.output.export.ck`), NetCDF
with CF attributes and Parquet (here). The Sun alone leaves the turn about the Sun line free: the frame N of a result is local
to its pass, the files name it so, and no celestial frame is written unless the result says that its N is one.
"""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, OutputError, sentence
from sunspin.base.netcdf import read_netcdf
from sunspin.base.untrusted import is_own
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.environment.frames import BODY_AT_START, FIELD_Z_LOCAL, J2000, SUN_Z_LOCAL
from sunspin.output.folder import write_netcdf, write_whole
from sunspin.solve.rotations import continuous, cross, matrix_of, turn, turn_between

LOCAL_FRAME = "SUNSPIN_LOCAL"
"""Name of a frame of which nobody knows how it stands in space."""

STANDS = {
    SUN_Z_LOCAL: "its z axis points to the Sun, the turn about it is arbitrary and another in each pass",
    FIELD_Z_LOCAL: "its z axis follows the magnetic field, the turn about it is arbitrary and another in each pass",
    BODY_AT_START: "its axes are those of the body at the start of the run",
}
"""How a local frame stands, by what the results call it."""

WIDEST_RAD = 1.0
"""Between neighbours of a motion that is interpolated the body may turn by so much. Of ten torque-free tumbling bodies, seed 0,
with neighbours 1 rad apart, attitudes are off by at most 0.02 degrees and rates by 2 %; at 0.1 rad, as `rates` stores most of its
curves, by 4e-6 degrees and 0.03 %."""

MOST_ATTITUDES = 1_000_000
"""An AEM of so many is 100 MB."""

LONGEST_S = 1e10
"""Three centuries: what is farther from the epoch is no time of a mission."""

FIRST_YEAR, LAST_YEAR = 1000, 9000

SOURCES = ("rates.nc", "trajectory.nc")
"""Files of a results folder that hold an attitude."""


class Attitude(NamedTuple):
    """What is exported: times (n) in s from `epoch`, quaternions B_from_N (n, 4) scalar last, rates (n, 3) rad/s in B,
    the number of the pass of each sample (n), the object's name, the frame of N, whether the telemetry was synthetic,
    how N `stands`, in words, where it is local; the object's number and what it orbits, where elements were used."""

    t_s: np.ndarray
    epoch: datetime
    quaternion: np.ndarray
    omega_B: np.ndarray
    part: np.ndarray
    name: str
    frame: str
    synthetic: bool
    stands: str
    number: str = ""
    centre: str = "UNKNOWN"

    def utc(self, i: int) -> str:
        """Time of sample `i`, ISO-8601 UTC to the microsecond, without a zone."""
        return (self.epoch + timedelta(seconds=float(self.t_s[i]))).strftime("%Y-%m-%dT%H:%M:%S.%f")

    def parts(self) -> list[np.ndarray]:
        """Indices of the samples of each pass."""
        return [np.flatnonzero(self.part == number) for number in np.unique(self.part)]


def read_results(folder: Any) -> tuple[xr.Dataset, Path]:
    """The Dataset with the attitude of a results folder, and the file it comes from."""
    for name in SOURCES:
        path = Path(folder) / name
        if path.is_symlink():
            raise InputError(
                sentence(
                    "this is a link, and a results folder has files of its own",
                    do="copy the file here",
                    where=str(path),
                )
            )
        if is_own(path):
            return _forward(read_netcdf(path, str(path), InputError)), path
    raise InputError(
        sentence(
            "no attitude here",
            got="neither " + " nor ".join(SOURCES),
            where=str(folder),
            do="write one with `sunspin rates ... --out DIR` or `sunspin simulate ... --out DIR`",
        )
    )


def _forward(data: xr.Dataset) -> xr.Dataset:
    """Of a motion that was simulated backward the samples in the order of time."""
    t = data["time"].values if "time" in data.variables else np.zeros(0)
    return (
        data.isel(time=slice(None, None, -1))
        if t.ndim == 1 and len(t) > 1 and np.all(np.diff(t) < 0)
        else data
    )


def attitude_of(
    data: xr.Dataset, frame: str | None = None, epoch_utc: str | None = None
) -> Attitude:
    """The attitude of results of `rates` or `propagate`.

    `frame`: the frame to write. Without a second direction N is local and only `LOCAL_FRAME` (or a name of one's own that
    contains LOCAL) may be written; a result of an orbit that is known (``frame_N`` J2000), or whose attrs name a
    ``celestial_frame``, may be written in that one. `epoch_utc`: UTC of time zero, where the result has none.
    """
    frame_N = data.attrs.get("frame_N")
    known = data.attrs.get("celestial_frame", J2000 if frame_N == J2000 else None)
    wanted = frame or known or LOCAL_FRAME
    local = "LOCAL" in wanted.upper()
    stands = STANDS.get(str(frame_N), "nobody knows how it stands in space")
    if wanted != known and not local:
        more = "" if frame_N == BODY_AT_START else ", or give `rates` an orbit and a magnetometer"
        what = f"this attitude is not known in a celestial frame, but in a local one: {stands}"
        raise InputError(sentence(what, got=wanted, do=f"export in {LOCAL_FRAME}{more}"))
    missing = [name for name in ("B_from_N", "omega_B", "time") if name not in data.variables]
    if missing:
        raise InputError(sentence(f"the results have no {', '.join(missing)}"))
    quaternion = np.asarray(data["B_from_N"], dtype=np.float64)
    size = np.linalg.norm(
        np.clip(quaternion, -2.0, 2.0), axis=-1
    )  # a damaged file may hold what cannot be squared
    if quaternion.ndim != 2 or quaternion.shape[1] != 4 or not np.all(np.abs(size - 1) < 1e-6):
        raise InputError(
            sentence(
                "the attitude of these results is not a list of unit quaternions",
                got=quaternion.shape,
            )
        )
    t, omega = (np.asarray(data[name], dtype=np.float64) for name in ("time", "omega_B"))
    if (
        t.shape != quaternion.shape[:1]
        or omega.shape != (len(t), 3)
        or not np.isfinite(omega).all()
    ):
        shapes = f"{t.shape}, {omega.shape}"
        raise InputError(
            sentence(
                "the times or rates of these results do not belong to their attitudes", got=shapes
            )
        )
    if np.any(np.abs(omega) > MAX_RATE):
        raise InputError(
            sentence(f"these results hold rates beyond {MAX_RATE:g} rad/s", do="write them again")
        )
    part = np.asarray(data["pass_of"]) if "pass_of" in data else np.zeros(len(t), dtype=int)
    if part.shape != t.shape:
        raise InputError(
            sentence(
                "the passes of these results do not belong to their times",
                got=f"{part.shape}, {t.shape}",
            )
        )
    if not len(t) or not np.all(np.abs(t) < LONGEST_S) or np.any(np.diff(t) <= 0):
        raise InputError(
            sentence(
                "the times of these results do not increase, or are no times", got=f"{len(t)} times"
            )
        )
    number, name = (str(data.attrs.get(key, "")) for key in ("orbit", "orbit_name"))
    return Attitude(
        t,
        _epoch(epoch_utc or data.attrs.get("epoch_utc")),
        continuous(quaternion / size[:, None], part),
        omega,
        part,
        name if number and name else str(data.attrs.get("vehicle", "UNKNOWN")),
        wanted,
        bool(data.attrs.get("synthetic", 0)),
        stands if local else "",
        number,
        "EARTH" if "orbit" in data.attrs else "UNKNOWN",
    )


def between_samples(attitude: Attitude, data: xr.Dataset, step_s: float) -> Attitude:
    """The attitude every `step_s` s of each pass, from the curves that results of `rates` have between their samples, else from
    the samples themselves: attitudes by cubics of the rotation vector that have the rates at both ends, rates by straight lines.

    Raises
    ------
    InputError
        The body turns by more than `WIDEST_RAD` between neighbours, or there would be more than `MOST_ATTITUDES`.
    """
    from scipy.spatial.transform import Rotation

    if "curve_time" in data.variables:
        curves = [name for name in data.variables if str(name).startswith("curve_")]
        curve = data[curves].rename({name: str(name).removeprefix("curve_") for name in curves})
        attitude = attitude_of(curve, attitude.frame, attitude.epoch.isoformat())
    spans = [attitude.t_s[part[-1]] - attitude.t_s[part[0]] for part in attitude.parts()]
    counts = [int(min(span / step_s + 1e-9, 10.0 * MOST_ATTITUDES)) + 1 for span in spans]
    if sum(counts) > MOST_ATTITUDES:
        raise InputError(
            sentence(
                f"this would be more than {MOST_ATTITUDES} attitudes",
                got=step_s,
                do="give a longer --step",
            )
        )
    times, quaternions, rates = [], [], []
    for part, count in zip(attitude.parts(), counts, strict=True):
        t, omega, known = (
            attitude.t_s[part],
            attitude.omega_B[part],
            matrix_of(attitude.quaternion[part]),
        )
        at = t[0] + step_s * np.arange(count)
        times.append(at)
        if len(part) > 1:
            first = np.clip(np.searchsorted(t, at, side="right") - 1, 0, len(t) - 2)
            turns = _turns(
                np.diff(t),
                turn_between(known[:-1], known[1:]),
                omega,
                first,
                (at - t[first]) / np.diff(t)[first],
            )
            known = turn(known[first], turns)
        quaternions.append(Rotation.from_matrix(known).as_quat())
        rates.append(np.stack([np.interp(at, t, x) for x in omega.T], axis=1))
    parts = np.repeat(np.unique(attitude.part), counts)
    quaternion = continuous(np.concatenate(quaternions), parts)
    return attitude._replace(
        t_s=np.concatenate(times), quaternion=quaternion, omega_B=np.concatenate(rates), part=parts
    )


def _turns(
    span_s: np.ndarray, angle: np.ndarray, omega: np.ndarray, first: np.ndarray, share: np.ndarray
) -> np.ndarray:
    """Rotation vectors (m, 3) of the body at parts `share` (m) of the intervals number `first` (m): cubics that have the rates
    `omega` (n, 3) at both ends of each interval of `span_s` (n - 1), in which the body turns by `angle` (n - 1, 3)."""
    widest = max(
        float(np.linalg.norm(angle, axis=1).max()),
        float((np.linalg.norm(omega, axis=1)[:-1] * span_s).max()),
    )
    if widest > WIDEST_RAD:
        what = f"the body turns by up to {np.degrees(widest):.0f} degrees between the instants that these results hold"
        raise InputError(
            sentence(
                what,
                do="export without --step, or a shorter stretch of time: `sunspin rates --from --to`",
            )
        )
    size = np.linalg.norm(angle, axis=1, keepdims=True)
    over = np.where(
        size > 1e-3,
        (1 - size / 2 / np.tan(np.maximum(size, 1e-3) / 2)) / np.maximum(size, 1e-3) ** 2,
        1 / 12,
    )
    end = (
        omega[1:] + cross(angle, omega[1:]) / 2 + over * cross(angle, cross(angle, omega[1:]))
    )  # the vector's own rate of change
    begin, end, s = (
        span_s[first, None] * omega[first],
        span_s[first, None] * end[first],
        share[:, None],
    )
    return s * (1 - s) ** 2 * begin + s**2 * (3 - 2 * s) * angle[first] - s**2 * (1 - s) * end


def _epoch(text: Any) -> datetime:
    try:
        moment = datetime.fromisoformat(str(text))
        moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
        if (
            not FIRST_YEAR <= moment.year <= LAST_YEAR
        ):  # the longest time from it must still be a date
            raise ValueError
    except (ValueError, OverflowError):
        raise InputError(
            sentence(
                "the results do not say which UTC their time zero is",
                got=str(text),
                do="give --epoch 2026-01-01T00:00:00Z",
            )
        ) from None
    return moment


def write_cf(target: Path, data: xr.Dataset, attitude: Attitude) -> Path:
    """NetCDF with CF attributes: time as a CF coordinate, units, long names, conventions, the frame."""
    out = data.copy()
    if not np.array_equal(data["time"].values, attitude.t_s):  # at instants of their own
        out = data.drop_dims("time").assign(pass_of=("time", attitude.part))
    epoch = attitude.epoch.strftime("%Y-%m-%d %H:%M:%S.%f")
    out["time"] = (
        "time",
        attitude.t_s,
        {"units": f"seconds since {epoch} UTC", "standard_name": "time", "calendar": "standard"},
    )
    about = {
        "units": "1",
        "long_name": f"attitude quaternion, scalar last, {attitude.frame} to body",
    }
    out["B_from_N"] = (("time", "quaternion"), attitude.quaternion, about)
    out["omega_B"] = (
        ("time", "axis"),
        attitude.omega_B,
        {"units": "rad s-1", "long_name": "angular velocity, body axes"},
    )
    out.attrs |= {
        "Conventions": "CF-1.11",
        "title": f"Attitude of {attitude.name}",
        "frame": attitude.frame,
    }
    out.attrs["source"] = _source(attitude)
    return write_netcdf(target, out)


def _source(attitude: Attitude) -> str:
    return "sunspin, synthetic telemetry" if attitude.synthetic else "sunspin"


def columns(attitude: Attitude) -> dict[str, np.ndarray]:
    """The attitude as columns of a table."""
    table: dict[str, Any] = {
        "time_utc": np.array(
            [attitude.utc(i) for i in range(len(attitude.t_s))], dtype="datetime64[us]"
        ),
        "time_s": attitude.t_s,
        "pass": attitude.part,
    }
    for k, name in enumerate("xyzw"):
        table[f"q_{name}_B_from_N"] = attitude.quaternion[:, k]
    for k, name in enumerate("xyz"):
        table[f"omega_{name}_B_rad_s"] = attitude.omega_B[:, k]
    return table


def write_parquet(target: Path, attitude: Attitude) -> Path:
    """One row per sample; frame, object and source in the file's metadata."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ImportError:
        raise OutputError(
            sentence("Parquet needs pyarrow", do='pip install "sunspin[parquet]"')
        ) from None
    table = pa.table(columns(attitude))
    about = {
        "frame": attitude.frame,
        "object": attitude.name,
        "epoch_utc": attitude.epoch.isoformat(),
        "source": _source(attitude),
    }

    def write(part: Path) -> None:
        with open(part, "wb") as file:  # pyarrow takes no name that is not UTF-8
            pq.write_table(table.replace_schema_metadata(about), file)

    return write_whole(target, write)
