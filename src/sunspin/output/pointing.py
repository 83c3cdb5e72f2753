"""Pointing of body axes: angles to the Sun, nadir, ram and ground stations, from a result of `rates`.

A body axis a and a unit direction d, both in body axes, make the angle theta = arccos(a . d). The error of the attitude is a small
rotation e in body axes; it changes d by e x d. The result gives the variance of e across the Sun direction (both directions
together) and about it. The first is taken as equal in all directions across the Sun, and both as independent. An error along the
track changes d as well. With t, the unit vector across d towards a, the change of the angle is -t . (change of d).

Nadir is the direction to the Earth's centre, ram that of the orbital velocity in J2000. Stations are on the ellipsoid of WGS 84.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.interpolate import CubicHermiteSpline
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError, printable
from sunspin.base.netcdf import read_groups
from sunspin.base.provenance import provenance
from sunspin.environment.earth import Instants, earth_from_J2000, rotate_vectors
from sunspin.environment.frames import J2000
from sunspin.environment.orbit import Orbit
from sunspin.output.export import motion_at
from sunspin.output.folder import MARKER, read_command, read_manifest, verify_file

LARGEST_SIGMA_RAD = float(np.radians(30.0))
"""An angle with a larger error is not given: beyond this the error is not proportional to that of the attitude."""

NEAR_SIGMAS = 2.0
"""Within so many sigma of a direction, or of the opposite one, the side on which an axis lies is not known."""

AXES = {
    sign + name: factor * vector
    for sign, factor in (("+", 1.0), ("-", -1.0))
    for name, vector in zip("xyz", np.eye(3), strict=True)
}
"""Body axes with names -> unit vectors."""

MOST_TIMES = 200_000
"""Largest number of times of one result: a table of some 50 MB."""

MOST_AXES, MOST_STATIONS = 12, 12
"""Largest numbers of axes and stations of one result."""

LOWEST_M, HIGHEST_M = -500.0, 9000.0
"""Altitudes of places on the ground."""

SUN, NADIR, RAM = "sun", "nadir", "ram"
"""Names of the targets that are not stations."""

NEEDED = {"sun_B", "sun_sigma_rad", "B_from_N", "pass_of", "decided", "why_not_decided"}
"""Variables of a result of `rates` without which there is no pointing."""

TRACK = ("position_J2000", "velocity_J2000", "along_track_sigma_s")
"""Variables of a result of `rates` that hold the orbit at the samples."""


class Station(NamedTuple):
    """A ground station: name, geodetic latitude and longitude (deg, north and east positive), altitude (m) above the ellipsoid."""

    name: str
    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    def checked(self) -> Station:
        """Return the station; raise `InputError` if there is no such place or its name is that of another target."""
        limits = {
            "latitude": (self.latitude_deg, -90.0, 90.0, "deg"),
            "longitude": (self.longitude_deg, -180.0, 360.0, "deg"),
            "altitude": (self.altitude_m, LOWEST_M, HIGHEST_M, "m"),
        }
        for name, (value, low, high, unit) in limits.items():
            if not low <= value <= high:
                what = f"the {name} of a station lies between {low:g} and {high:g} {unit}"
                do = "give latitude and longitude in deg and the altitude in m"
                raise InputError(what, got=f"{value:g}", do=do)
        if not self.name.isidentifier() or self.name in (SUN, NADIR, RAM):
            what = "the name of a station is made of letters and digits, and is not that of another target"
            raise InputError(what, got=self.name, do="name it for example graz")
        return self

    def position_J2000(self, when: Instants) -> np.ndarray:
        """Return the positions (n, 3) in m from the Earth's centre at instants (n), in J2000."""
        return rotate_vectors(np.swapaxes(earth_from_J2000(when), -1, -2), self._earth_fixed()[0])

    def up_J2000(self, when: Instants) -> np.ndarray:
        """Return the unit normals (n, 3) of the ellipsoid at instants (n), in J2000."""
        return rotate_vectors(np.swapaxes(earth_from_J2000(when), -1, -2), self._earth_fixed()[1])

    def _earth_fixed(self) -> tuple[np.ndarray, np.ndarray]:
        """Return position (3), m, and unit normal of the ellipsoid (3), in Earth-fixed axes."""
        import erfa

        longitude, latitude = np.radians([self.longitude_deg, self.latitude_deg])
        position = erfa.gd2gc(1, longitude, latitude, self.altitude_m)  # 1: WGS 84
        return position, erfa.s2c(longitude, latitude)


class Directions(NamedTuple):
    """Directions to a target at n times, in body axes: unit vectors `direction` (n, 3), and their change `along_track` (n, 3) for
    one sigma along the track.
    """

    direction: np.ndarray
    along_track: np.ndarray


class OrbitTrack(NamedTuple):
    """Position (n, 3) m and velocity (n, 3) m/s in J2000 at n times, one sigma along the track (n) s, and the instants."""

    position: np.ndarray
    velocity: np.ndarray
    sigma_s: np.ndarray
    when: Instants


def with_track(result: xr.Dataset, orbit: Orbit | None) -> xr.Dataset:
    """Return a result of `rates` with the orbit at its samples: the variables `TRACK`; without an orbit the result itself."""
    if orbit is None:
        return result
    when = orbit.instants(result["time"].values)
    position, velocity = orbit.states(when)
    values = (("time", "axis"), position), (("time", "axis"), velocity)
    sigma = "time", orbit.ahead_sigma_s(when)
    track = dict(zip(TRACK, (*values, sigma), strict=True))
    return result.assign(track).assign_attrs(orbit_clock_s=orbit.clock_s)


def pointing(
    rates: xr.Dataset | str | Path,
    axes: Sequence[str | npt.ArrayLike] = ("+z",),
    stations: Sequence[tuple[str, float, float, float]] = (),
    orbit: Any = None,
    step_s: float | None = None,
) -> xr.Dataset:
    """Return the angles of body axes to the Sun, nadir, ram and ground stations, with errors, at the samples of `rates`.

    Parameters
    ----------
    rates : xarray.Dataset or path
        A result of `rates`, or the folder that `sunspin rates --out` wrote.
    axes : sequence
        Body axes: "+x" to "-z", or vectors (3) of any length.
    stations : sequence of (name, latitude, longitude, altitude)
        Ground stations: geodetic latitude and longitude in deg, altitude in m above the WGS 84 ellipsoid.
    orbit : Orbit, optional
        The orbit that `rates` used, for a Dataset of the Python function; a folder holds it.
    step_s : float, optional
        Interval (s) of the times in each pass, along the estimated motion; default: at the samples. Between samples the error grows
        with the distance in time to the nearest sample times the error of the rate.

    Returns
    -------
    xarray.Dataset
        Over `body_axis`, `target` and `time` (s): `pointing_angle` in rad with one sigma `pointing_sigma`. The angle is NaN in
        passes that are not decided, and if its error exceeds 30 degrees. Over `station` and `time`: `station_elevation` (rad) of
        the spacecraft above the horizon, and `station_range` (m). Over `curve_time`: `curve_pointing_angle` between the samples.
        `pass_of`, and of each pass `decided` and `why_not_decided`.

        The only target is the Sun if the result has no orbit, or if its attitude is not known in J2000.

    Raises
    ------
    InputError
        The result is not one of `rates`, or knows no Sun direction; an axis or a station is not valid; or there are stations
        and no attitude in J2000.
    """
    vectors, ground = _read_axes(axes), _read_stations(stations)
    data = rates if isinstance(rates, xr.Dataset) else _read_rates(Path(rates))
    if data.attrs.get("kind") != "rates" or not NEEDED <= set(data):
        raise InputError("pointing needs a result of `rates`", got=str(data.attrs.get("kind")))
    try:
        with np.errstate(all="ignore"):
            return _pointing(with_track(data, orbit), vectors, ground, step_s)
    except InputError:
        raise
    except (LookupError, TypeError, ValueError, OverflowError, np.linalg.LinAlgError) as error:
        what = (
            f"the result holds something else than `rates` writes ({type(error).__name__}: {error})"
        )
        raise InputError(printable(what), do="run `sunspin rates` again") from None


def _pointing(
    data: xr.Dataset, vectors: dict[str, np.ndarray], ground: list[Station], step_s: float | None
) -> xr.Dataset:
    """Return the Dataset of :func:`pointing` from a result of `rates` with its track, for checked axes and stations."""
    if not np.isfinite(data["sun_B"].values).any():
        what = "this result knows no Sun direction, and so no pointing"
        raise InputError(what, do="give `rates` panels, Sun sensors or an orbit")
    if step_s is not None:
        data = _on_grid(data, step_s)
    missing = _why_sun_only(data)
    if missing and ground:
        do = "give `rates` an orbit (--tle) and a magnetometer, or leave the stations out"
        raise InputError(f"the angle to a station is not known: {missing}", do=do)
    targets = _targets(data, "", ground, not missing)
    angle = _angles(vectors, targets)
    sigma = _sigmas(vectors, targets, _attitude_covariance(data))
    decided = data["decided"].values[data["pass_of"].values].astype(bool)
    given = decided & (sigma <= LARGEST_SIGMA_RAD)
    dims = ("body_axis", "target", "time")
    variables: dict[str, Any] = {
        "pointing_angle": (dims, np.where(given, angle, np.nan)),
        "pointing_sigma": (dims, np.where(decided, sigma, np.nan)),
        "pass_of": data["pass_of"],
        "decided": data["decided"],
        "why_not_decided": data["why_not_decided"],
    }
    if "curve_time" in data.coords and "curve_B_from_N" in data:
        between = _angles(vectors, _targets(data, "curve_", ground, not missing))
        # a curve is shown in passes in which the angle is given at all times
        passes = range(data.sizes["pass_id"])
        known = np.array([given[..., data["pass_of"].values == k].all(axis=-1) for k in passes])
        on_curve = np.moveaxis(known, 0, -1)[..., data["curve_pass_of"].values]
        variables["curve_pointing_angle"] = (
            ("body_axis", "target", "curve_time"),
            np.where(on_curve, between, np.nan),
        )
        variables["curve_pass_of"] = data["curve_pass_of"]
    if ground:
        track = _track(data, data["time"].values, interpolated=False)
        seen = np.array([_seen_from(station, track) for station in ground])
        variables["station_elevation"] = (("station", "time"), seen[:, 0])
        variables["station_range"] = (("station", "time"), seen[:, 1])
    coords = {"body_axis": list(vectors), "target": list(targets), "pass_id": data["pass_id"]}
    coords |= {"station": [station.name for station in ground]} if ground else {}
    attrs = {
        name: data.attrs[name] for name in ("vehicle", "orbit", "orbit_name") if name in data.attrs
    }
    unchecked = decided & (_columns_checked(data) != "as_stated")
    attrs |= {"columns_unchecked": int(unchecked.any())}
    attrs |= {"sun_only": missing, "stations": "; ".join(map(_station_text, ground))}
    return xr.Dataset(variables, coords, provenance("pointing", data, **attrs))


def _read_rates(folder: Path) -> xr.Dataset:
    """Return the Dataset of a results folder of `rates`; raise `InputError` for another folder, or if the file is damaged."""
    manifest = read_manifest(folder)
    if (command := read_command(folder / MARKER)) != "rates":
        what = "pointing needs a results folder of `sunspin rates`"
        do = "run `sunspin rates ... --out DIR` first"
        raise InputError(what, got=f"results of {command}", do=do, where=str(folder))
    path = verify_file(folder, manifest, "rates.nc")
    return read_groups(path, str(path), InputError, probe=False)["/"]


def _on_grid(data: xr.Dataset, step_s: float) -> xr.Dataset:
    """Return a result of `rates` at times `step_s` (s) apart in each pass: attitude, Sun, track, and their errors.

    The variance at a time dt from a sample is that at the sample plus dt^2 times that of the rate, which neglects that both errors
    are correlated; of the two samples around it, the one with the smaller sum counts.
    """
    if not 0 < step_s < np.inf:
        raise InputError("the step of pointing must be positive, in s", got=step_s)
    time, pass_of = data["time"].values, data["pass_of"].values
    spans = [time[pass_of == k][[0, -1]] for k in range(data.sizes["pass_id"])]
    if sum(np.ptp(span) / step_s + 1 for span in spans) > MOST_TIMES:
        what, do = f"pointing takes at most {MOST_TIMES} times", "give a larger step"
        raise InputError(what, got=f"a step of {step_s:g} s", do=do)
    # rounding may put the last time of a pass beyond its end
    grids = [np.minimum(np.arange(begin, end + 1e-6 * step_s, step_s), end) for begin, end in spans]
    grid = np.concatenate(grids)
    motion = motion_at(data, grid)
    attitude, number = Rotation.from_quat(motion["B_from_N"].values), motion["pass_of"].values
    # the sample before each time and the one after it; at the last sample of a pass the latter is of the next pass, and farther
    after = np.clip(np.searchsorted(time, grid, side="right"), 1, len(time) - 1)
    neighbours = np.stack([after - 1, after])
    apart = (grid - time[neighbours]) ** 2
    rate, sun = data["omega_cov_B"].values, data["sun_B"].values
    about = np.einsum("ni,nij,nj->n", sun, rate, sun)
    across = np.maximum(np.einsum("nii->n", rate) - about, 0.0)
    grown = data["sun_sigma_rad"].values[neighbours] ** 2 + apart * across[neighbours]
    values: dict[str, Any] = {"sun_sigma_rad": ("time", np.sqrt(grown.min(axis=0)))}
    if "turn_sigma_rad" in data:
        grown = data["turn_sigma_rad"].values[neighbours] ** 2 + apart * about[neighbours]
        values["turn_sigma_rad"] = ("time", np.sqrt(grown.min(axis=0)))
    values |= {
        "B_from_N": (("time", "quaternion"), attitude.as_quat()),
        "sun_B": (("time", "axis"), _sun_between(data, attitude, number)),
        "pass_of": ("time", number),
    }
    if all(name in data for name in TRACK):
        track = _track(data, grid, interpolated=True)
        parts = (
            (("time", "axis"), track.position),
            (("time", "axis"), track.velocity),
            ("time", track.sigma_s),
        )
        values |= dict(zip(TRACK, parts, strict=True))
    return data.drop_dims("time").assign(values).assign_coords(time=grid)


def _read_axes(axes: Sequence[str | npt.ArrayLike]) -> dict[str, np.ndarray]:
    """Return the unit vectors (3) of body axes by name; raise `InputError` for an axis that is none."""
    vectors = {}
    for axis in axes:
        if isinstance(axis, str):
            name = axis if axis[:1] in "+-" else f"+{axis}"
            vector = AXES.get(name.lower())
            name = name.lower()
        else:
            numbers = np.asarray(axis, dtype=np.float64)
            length = float(np.linalg.norm(numbers)) if numbers.shape == (3,) else np.nan
            vector = numbers / length if 0 < length < np.inf else None
            name = "(" + " ".join(f"{x:g}" for x in np.ravel(numbers)[:4]) + ")"
        if vector is None:
            what = "a body axis is one of " + ", ".join(AXES) + ", or three numbers"
            raise InputError(what, got=printable(str(axis)), do="for example +z or 0,0.6,0.8")
        vectors[name] = vector
    if not 0 < len(vectors) <= MOST_AXES:
        raise InputError(f"pointing takes 1 to {MOST_AXES} body axes", got=len(vectors))
    return vectors


def _read_stations(stations: Sequence[tuple[str, float, float, float]]) -> list[Station]:
    """Return checked stations; raise `InputError` if one is not valid, or if two have the same name."""
    ground = [Station(*station).checked() for station in stations]
    if len({station.name for station in ground}) < len(ground) or len(ground) > MOST_STATIONS:
        what = f"there are at most {MOST_STATIONS} stations, each with a name of its own"
        raise InputError(what, got=", ".join(station.name for station in ground))
    return ground


def _columns_checked(data: xr.Dataset) -> np.ndarray:
    """Return of each time (n) whether `rates` could check columns and signs of the vehicle file, in its words."""
    if "columns_checked" not in data:
        return np.full(data.sizes["time"], "as_stated")
    return data["columns_checked"].values.astype(str)[data["pass_of"].values]


def _why_sun_only(data: xr.Dataset) -> str:
    """Return in words why only the angle to the Sun is known; an empty text if the attitude is known in J2000 and the orbit too."""
    if "orbit" not in data.attrs:
        return "the rates were estimated without an orbit, so the rotation about the Sun direction is free"
    if data.attrs.get("frame_N") != J2000 or "turn_sigma_rad" not in data:
        return "no magnetometer was used, so the rotation about the Sun direction is free"
    if any(name not in data for name in TRACK):
        return "the result does not hold the orbit's positions"
    return ""


def _sun_between(data: xr.Dataset, attitude: Rotation, pass_of: np.ndarray) -> np.ndarray:
    """Return the Sun (n, 3) in body axes for attitudes (n) in passes `pass_of` (n), at other times than those of the samples.

    The Sun is fixed in N during a pass: its direction at the first sample is rotated with the body.
    """
    first = np.array([np.argmax(data["pass_of"].values == k) for k in range(data.sizes["pass_id"])])
    at_first = Rotation.from_quat(data["B_from_N"].values[first])
    sun_N = at_first.inv().apply(data["sun_B"].values[first])
    return attitude.apply(sun_N[pass_of])


def _track(data: xr.Dataset, t_s: np.ndarray, interpolated: bool) -> OrbitTrack:
    """Return the track at the times `t_s` (n) of the samples, or at others, where it is `interpolated` by cubics.

    At samples 10 minutes apart the error of the cubic is 4 km, or 0.03 deg of nadir.
    """
    time = data["time"].values
    position, velocity, sigma = (data[name].values for name in TRACK)
    when = Instants.of(str(data.attrs["epoch_utc"]), t_s + float(data.attrs["orbit_clock_s"]))
    if not interpolated:
        return OrbitTrack(position, velocity, sigma, when)
    if len(time) < 2:  # no cubic through one sample: its state is repeated
        position, velocity = (np.repeat(x, len(t_s), axis=0) for x in (position, velocity))
        return OrbitTrack(position, velocity, np.repeat(sigma, len(t_s)), when)
    cubic = CubicHermiteSpline(time, position, velocity)
    return OrbitTrack(cubic(t_s), cubic(t_s, 1), np.interp(t_s, time, sigma), when)


def _targets(
    data: xr.Dataset, prefix: str, ground: Sequence[Station], in_space: bool
) -> dict[str, Directions]:
    """Return target -> its directions in body axes, at the samples (`prefix` "") or at the times of the curve (`prefix` "curve_").

    The targets are the Sun and, if the attitude in J2000 and the orbit are known (`in_space`), nadir, ram and the stations
    `ground`. An error along the track does not change the direction of the Sun.
    """
    attitude = Rotation.from_quat(data[f"{prefix}B_from_N"].values)
    t_s, pass_of = data[f"{prefix}time"].values, data[f"{prefix}pass_of"].values
    sun = data["sun_B"].values
    if prefix:
        sun = _sun_between(data, attitude, pass_of)
    targets = {SUN: Directions(sun, np.zeros_like(sun))}
    if not in_space:
        return targets
    position, velocity, sigma_s, when = _track(data, t_s, interpolated=bool(prefix))
    # changes by one sigma (`sigma_s`) along the track: `ahead` (m) of the position, and `velocity_change` (m/s) by the gravity,
    # which is v^2 / r in a round orbit
    ahead = velocity * sigma_s[:, None]
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    distance = np.linalg.norm(position, axis=1, keepdims=True)
    velocity_change = -position / distance**2 * speed**2 * sigma_s[:, None]
    # target -> vector to it (n, 3) in J2000, of any length, and the change of that vector
    lines = {NADIR: (-position, -ahead), RAM: (velocity, velocity_change)}
    for station in ground:
        lines[station.name] = (station.position_J2000(when) - position, -ahead)
    for name, (line, change) in lines.items():
        length = np.linalg.norm(line, axis=1, keepdims=True)
        unit = line / length
        # change of the unit vector: the part of the change across the line, over its length
        across = (change - unit * np.sum(unit * change, axis=1, keepdims=True)) / length
        targets[name] = Directions(attitude.apply(unit), attitude.apply(across))
    return targets


def _attitude_covariance(data: xr.Dataset) -> np.ndarray:
    """Return the covariance (n, 3, 3) of the attitude as a small rotation in body axes, rad^2.

    Half of the variance of the Sun direction belongs to each direction across it. Without an orbit the rotation about the Sun
    has no error of its own, as only the angle to the Sun is asked for.
    """
    sun = data["sun_B"].values
    along = sun[:, :, None] * sun[:, None, :]
    across = data["sun_sigma_rad"].values[:, None, None] ** 2 / 2 * (np.eye(3) - along)
    if "turn_sigma_rad" not in data:
        return across
    return across + data["turn_sigma_rad"].values[:, None, None] ** 2 * along


def _angles(vectors: dict[str, np.ndarray], targets: dict[str, Directions]) -> np.ndarray:
    """Return the angles (n_axis, n_target, n) of axes to targets, rad."""
    direction = np.array([target.direction for target in targets.values()])
    angles = []
    for axis in vectors.values():
        # from sine and cosine: the arc cosine alone would lose digits near 0 and 180 degrees
        sine = np.linalg.norm(np.cross(direction, axis), axis=-1)
        angles.append(np.arctan2(sine, direction @ axis))
    return np.array(angles)


def _sigmas(
    vectors: dict[str, np.ndarray], targets: dict[str, Directions], covariance: np.ndarray
) -> np.ndarray:
    """Return one sigma (n_axis, n_target, n) of the angles, rad, from the covariance (n, 3, 3) of the attitude and the track.

    If the axis is near the direction or the opposite one, the side on which it lies is not known, and the largest error counts.
    """
    sigma = np.empty((len(vectors), len(targets), len(covariance)))
    for k, (direction, along_track) in enumerate(targets.values()):
        # change of the direction for each component of the rotation: e x d = cross @ e
        cross = np.cross(np.eye(3), direction[:, None, :]).swapaxes(1, 2)
        spread = cross @ covariance @ np.swapaxes(cross, 1, 2)
        spread = spread + along_track[:, :, None] * along_track[:, None, :]
        largest = np.linalg.eigvalsh(np.nan_to_num(spread))[:, -1]
        for i, axis in enumerate(vectors.values()):
            towards = axis - (direction @ axis)[:, None] * direction
            sine = np.linalg.norm(towards, axis=1)
            towards /= np.maximum(sine, 1e-12)[:, None]
            variance = np.einsum("ni,nij,nj->n", towards, spread, towards)
            near = sine < NEAR_SIGMAS * np.sqrt(largest)
            sigma[i, k] = np.sqrt(np.maximum(np.where(near, largest, variance), 0.0))
    return sigma


def _seen_from(station: Station, track: OrbitTrack) -> tuple[np.ndarray, np.ndarray]:
    """Return the elevation (n), rad, of the spacecraft above the horizon of a station, and its distance (n), m."""
    line = track.position - station.position_J2000(track.when)
    distance = np.linalg.norm(line, axis=1)
    sine = np.sum(line * station.up_J2000(track.when), axis=1) / distance
    return np.arcsin(np.clip(sine, -1.0, 1.0)), distance


def _station_text(station: Station) -> str:
    """Return a station in words."""
    place = f"latitude {station.latitude_deg:g} deg, longitude {station.longitude_deg:g} deg"
    return f"{station.name}: {place}, altitude {station.altitude_m:g} m"
