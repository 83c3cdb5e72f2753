"""Comparison of a result of `rates` with sensors that it did not use: differences, and differences over their joint error.

The normalised difference is the difference over one sigma of result and reading together; its rms is about 1 if both errors are
right. The sigma of a reading includes those of zero and scale, which are common to all samples of a pass.

A difference of attitudes is the rotation vector, in body axes, from the attitude of the reading to that of the result. Without an
orbit the frame N of a result is local to each pass. The rotation from N to the reference frame of the readings, constant in a pass,
is then estimated and removed: the comparison shows whether the motions agree, not the frames.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.environment.frames import J2000
from sunspin.output.figures import BLACK, COLOURS, GREY, axes_grid, escape_name, styled
from sunspin.output.figures.rates import largest_passes
from sunspin.output.kind import Drawing, Table
from sunspin.output.text import clock_text, count_text, number_text, size_text, times_text
from sunspin.telemetry.withheld import EXACT, Withheld
from sunspin.vehicle.sensors import Attitude, Gyro

PARTS = ["across", "about"]
"""Parts of a difference of attitudes: the Sun direction itself, and the rotation about it."""

RATE, ATTITUDE = "compared_rate_B", "compared_attitude_difference"
"""Variables by which a result shows that it was compared."""


def compare_with(result: xr.Dataset, withheld: Withheld, readings: xr.DataArray) -> xr.Dataset:
    """Return a result of `rates` with the readings of a withheld sensor and their differences at its samples.

    Parameters
    ----------
    readings : DataArray of :func:`sunspin.telemetry.withheld.read_withheld`

    Raises
    ------
    InputError
        No sample of the result has a reading.
    """
    t_s = result["time"].values
    values = readings.values
    at = np.clip(np.searchsorted(readings["time"].values, t_s), 0, len(values) - 1)
    same = readings["time"].values[at] == t_s
    read = np.where(same[:, None], values[at], np.nan)
    if not np.isfinite(read).all(axis=1).any():
        what = "no sample of the result has a reading to compare with"
        raise InputError(what, got=", ".join(withheld.columns), do="look at these columns")
    if withheld.late_s:
        from sunspin.output.export import motion_at

        # the readings are older than the Sun of their row: the motion is evaluated when they were taken
        motion = motion_at(result, t_s - withheld.late_s)
        moved = {name: motion[name].values for name in ("omega_B", "B_from_N")}
    else:
        moved = {name: result[name].values for name in ("omega_B", "B_from_N")}
    columns = ", ".join(withheld.columns)
    if isinstance(withheld.sensor, Gyro):
        return _compare_rates(result, withheld.sensor, read, moved["omega_B"], columns)
    return _compare_attitudes(result, withheld.sensor, read, moved["B_from_N"], columns)


def _compare_rates(
    result: xr.Dataset, gyro: Gyro, read: np.ndarray, omega: np.ndarray, columns: str
) -> xr.Dataset:
    """Return the result with readings (n, 3) of rates, and their differences to the estimated rates `omega` (n, 3), rad/s."""
    zero = gyro.scale_rad_s * gyro.zero_sigma
    scale = gyro.scale_sigma / abs(gyro.scale_rad_s) * read
    own = result["omega_cov_B"].values[:, [0, 1, 2], [0, 1, 2]]
    sigma = np.sqrt(own + gyro.noise_rad_s**2 + zero**2 + scale**2)
    axes, difference = ("time", "axis"), omega - read
    variables = {
        RATE: (axes, read),
        "compared_rate_difference": (axes, difference),
        "compared_rate_normalised": (axes, difference / sigma),
    }
    about = columns + ("; error of the readings not stated" if gyro.noise_rad_s <= EXACT else "")
    return result.assign(variables).assign_attrs(compared_rate=about)


def _compare_attitudes(
    result: xr.Dataset, reading: Attitude, read: np.ndarray, estimated: np.ndarray, columns: str
) -> xr.Dataset:
    """Return the result with its differences to attitudes `read` (n, 4), B_from_N, as rotation vectors in body axes, rad.

    `estimated` (n, 4): quaternions of the result. The parts are across the Sun direction, with two components, and about it.
    """
    from scipy.spatial.transform import Rotation

    known = np.isfinite(read).all(axis=1) & np.isfinite(estimated).all(axis=1)
    difference, pass_of = np.full((len(read), 3), np.nan), result["pass_of"].values
    in_space = result.attrs.get("frame_N") == J2000
    for k in np.unique(pass_of[known]):
        inside = known & (pass_of == k)
        if not in_space and inside.sum() < 2:
            continue  # a single reading gives the frame, and no difference
        ours, theirs = Rotation.from_quat(estimated[inside]), Rotation.from_quat(read[inside])
        # from N to the reference frame of the readings: the same for J2000, else the mean over the pass
        frame = Rotation.identity() if in_space else (theirs.inv() * ours).mean()
        difference[inside] = (ours * frame.inv() * theirs.inv()).as_rotvec()
    sun = result["sun_B"].values
    about = np.sum(difference * sun, axis=1)
    across = np.linalg.norm(difference - about[:, None] * sun, axis=1)
    # across the Sun there are two components, each with the error of the reading
    sigma_across = np.sqrt(result["sun_sigma_rad"].values ** 2 + 2 * reading.sigma_rad**2)
    sigma_about = np.full(len(about), np.nan)
    if in_space and "turn_sigma_rad" in result:
        sigma_about = np.hypot(result["turn_sigma_rad"].values, reading.sigma_rad)
    variables = {
        ATTITUDE: (("time", "axis"), difference),
        "compared_attitude_normalised": (
            ("time", "part"),
            np.stack([across / sigma_across, about / sigma_about], axis=1),
        ),
    }
    about_text = f"{columns}; scalar {reading.scalar}, {reading.rotates}"
    about_text += "; error of the readings not stated" if reading.sigma_rad <= EXACT else ""
    attrs = {
        "compared_attitude": about_text,
        "compared_frame": J2000 if in_space else "constant rotation of each pass removed",
    }
    return result.assign(variables).assign_coords(part=PARTS).assign_attrs(attrs)


def compared_summary(result: Any) -> tuple[dict[str, Any], list[str]]:
    """Return entries and lines of the summary on withheld sensors; only decided passes count. Both are empty without any."""
    entries: dict[str, Any] = {}
    lines: list[str] = []
    decided = result["decided"].values.astype(bool)[result["pass_of"].values]
    for name, sensor, variable in (("rate", "rates", RATE), ("attitude", "attitude", ATTITUDE)):
        if variable not in result:
            continue
        difference = variable if name == "attitude" else "compared_rate_difference"
        values = np.degrees(result[difference].values)
        ratio = result[f"compared_{name}_normalised"].values
        used = decided & np.isfinite(values).all(axis=1)
        about = str(result.attrs[f"compared_{name}"])
        entry: dict[str, Any] = {"readings": int(used.sum()), "columns": about}
        text = f"  withheld {sensor} ({about}): {count_text(int(used.sum()), 'reading')} in decided passes"
        if used.any():
            rms, normalised = (
                np.sqrt(np.mean(part[used] ** 2, axis=0)) for part in (values, ratio)
            )
            unit = "deg/s" if name == "rate" else "deg"
            entry |= {
                f"rms_{unit.replace('/', '_')}": rms.tolist(),
                "rms_normalised": normalised.tolist(),
            }
            shown = ", ".join(size_text(float(part), 2) for part in rms)
            over_sigma = number_text([float(part) for part in normalised if np.isfinite(part)], 2)
            which = (
                ""
                if name == "rate"
                else " across the Sun and about it"
                if np.isfinite(normalised[1])
                else " across the Sun"
            )
            text += (
                f"; rms difference x, y, z ({shown}) {unit}; over joint sigma{which} {over_sigma}"
            )
        if name == "attitude":
            entry["frame"] = str(result.attrs["compared_frame"])
            text += (
                ""
                if entry["frame"] == J2000
                else "; a constant rotation of each pass is removed, as N is local"
            )
        entries[name] = entry
        lines.append(text)
    return ({"compared": entries} if entries else {}), lines


def compared_tables(result: Any) -> Iterator[Table]:
    """Yield the table `compared`: a row for each sample with a reading of a withheld sensor; none if nothing was compared."""
    if RATE not in result and ATTITUDE not in result:
        return
    pass_of = result["pass_of"].values
    columns: dict[str, Any] = {
        "time_s": result["time"].values,
        "utc": times_text(result),
        "pass_id": result["pass_id"].values[pass_of],
        "decided": result["decided"].values[pass_of],
    }
    headings = {"utc": "UTC", "decided": "decided"}
    if RATE in result:
        for k, axis in enumerate("xyz"):
            for part, variable in (
                ("estimated", "omega_B"),
                ("read", RATE),
                ("difference", "compared_rate_difference"),
            ):
                columns[f"omega_{axis}_{part}_deg_s"] = np.degrees(result[variable].values[:, k])
            columns[f"omega_{axis}_normalised"] = result["compared_rate_normalised"].values[:, k]
            headings |= {f"omega_{axis}_difference_deg_s": f"ω{axis} difference, deg/s"}
            headings |= {f"omega_{axis}_normalised": "over sigma"}
    if ATTITUDE in result:
        difference = np.degrees(result[ATTITUDE].values)
        columns |= {f"rotation_{axis}_deg": difference[:, k] for k, axis in enumerate("xyz")}
        columns["rotation_deg"] = np.linalg.norm(difference, axis=1)
        for k, part in enumerate(PARTS):
            columns[f"{part}_sun_normalised"] = result["compared_attitude_normalised"].values[:, k]
        headings |= {"rotation_deg": "attitude difference, deg"}
        headings |= {f"{part}_sun_normalised": f"{part} the Sun, over sigma" for part in PARTS}
    frame = pd.DataFrame(columns)
    read = [name for name in frame if str(name).endswith(("_read_deg_s", "rotation_deg"))]
    comment = "estimate minus reading; normalised: over one sigma of both; likeliest solution of each pass"
    kept = frame[frame[read].notna().any(axis=1)]
    yield Table("compared", kept, "Sensors that were withheld", headings, comment=comment)


def compared_drawings(result: Any) -> Iterator[Drawing]:
    """Yield a figure of the differences to withheld sensors, if there are any."""
    if RATE in result or ATTITUDE in result:
        yield Drawing(
            "compared",
            lambda: compared_figure(result),
            "Differences between the estimate and sensors that it did not use, against time in each pass.",
            "Estimate minus reading of sensors that were not used. The rms of differences over sigma, that of estimate and reading "
            "together, is about 1 if both errors are right. Passes that are not decided are grey.",
        )


@styled
def compared_figure(result: Any) -> Any:
    """Draw differences (deg/s, deg) and normalised differences in the passes with the most samples, a column each."""
    rows = []  # label, values (n, k), names of the k curves
    if RATE in result:
        rows.append(
            ("rate (deg/s)", np.degrees(result["compared_rate_difference"].values), list("xyz"))
        )
        rows.append(("rate over sigma", result["compared_rate_normalised"].values, list("xyz")))
    if ATTITUDE in result:
        rows.append(("rotation (deg)", np.degrees(result[ATTITUDE].values), list("xyz")))
        rows.append(
            (
                "over sigma",
                result["compared_attitude_normalised"].values,
                [f"{x} the Sun" for x in PARTS],
            )
        )
    passes = largest_passes(result)
    title = f"{escape_name(result.attrs['vehicle'])}: estimate minus withheld sensors"
    size = max(7.5, 2.1 * len(passes)), 1.2 + 1.9 * len(rows)
    figure, grid = axes_grid(
        *size, len(rows), len(passes), title, sharey="row", sharex="col", squeeze=False
    )
    for column, number in zip(grid.T, passes, strict=True):
        inside = result["pass_of"].values == number
        t = result["time"].values[inside]
        column[0].set_title(clock_text(result, t[0]), fontsize=8)
        column[-1].set_xlabel("time (min)")
        for axes, (_, values, names) in zip(column, rows, strict=True):
            axes.axhline(0, color=BLACK, lw=0.5)
            for k, name in enumerate(names):
                colour = COLOURS[k] if result["decided"].values[number] else GREY
                axes.plot((t - t[0]) / 60, values[inside, k], ".", color=colour, ms=4, label=name)
    for row, (label, _, _) in zip(grid, rows, strict=True):
        row[0].set_ylabel(label)
        row[0].legend(ncols=3, fontsize=7)
    return figure
