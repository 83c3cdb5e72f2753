"""How far the z axis swings and the Sun's height ranges, and how little both change while the wheel slows (sections 2.2, 3.2).

|H|, |r| and H.r never change in free flight, so neither does the angle alpha between H and the Sun; the angle theta between H
and the z axis, the nutation, is constant for a body that is symmetric about that axis, whatever friction does, and wanders for one
that is not. The axis swings by up to 2 theta, the Sun's height over the xy plane by 2 min(theta, alpha): the paper takes the
second for the first.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from sunspin.dynamics.propagate import propagate
from sunspin.output.figures import COLOURS
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.vehicle import Vehicle

STEP_S = 1.0

COMPARED_S = 600.0
"""First and last part of the window that are compared: ten minutes, some forty turns."""

LINE_POINTS = 11
"""Points of each published line, over `rebound.LINE_RANGE`."""

PEAK_BINS = 24
"""Bins between the smallest and the largest r_z in which peaks of its distribution are counted."""

PEAK_PROMINENCE = 0.2
"""A peak stands out by at least this part of the highest bin from the bins between it and a higher one."""

SAME_Z = 0.1
"""Either end of the range of r_z stays roughly the same where it changes by no more than this."""

SWING_DEG = 10.0
"""How far the swing of the axis may be from the range of the Sun's height."""


def swing(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: Any,
    duration_s: float,
    compared_s: float = COMPARED_S,
) -> dict[str, np.ndarray]:
    """Swing of the z axis and of the Sun's height, for motions from the rates omega_B (..., 3) in rad/s.

    `sun_B` (3) is the direction to the Sun at the start; the first and the last `compared_s` of `duration_s` are compared.

    Returns
    -------
    dict
        Smallest and largest (..., 2) of: r_z, "z", and in the first and the last part "z_first", "z_last"; "height" of the Sun;
        "nutation", the angle between the z axis and H. For each motion (...): its mean in the two parts, "nutation_first",
        "nutation_last"; "sun_angle" between H and the Sun; "axis_swing", the largest angle between the axis at two times in
        inertial space; "peaks" of the distribution of r_z. Angles in degrees.
    """
    starts = np.asarray(omega_B, dtype=np.float64)
    t = np.arange(0.0, duration_s + STEP_S / 2, STEP_S)
    first, last = t <= compared_s, t >= duration_s - compared_s
    motions = []
    for omega in starts.reshape(-1, 3):
        run = propagate(vehicle, omega, sun_B, wheel_speed_rad_s, t, rtol=1e-10)
        z, sun, H = run["sun_B"].values[:, 2], run["sun_B"].values[0], run["momentum_B"].values
        nutation = np.degrees(np.arctan2(np.hypot(H[:, 0], H[:, 1]), H[:, 2]))
        nutation[~H.any(axis=1)] = np.nan  # what does not turn has no axis
        axis_N = Rotation.from_quat(run["B_from_N"].values).inv().apply([0.0, 0.0, 1.0])
        motions.append(
            {
                "z": _ends(z),
                "z_first": _ends(z[first]),
                "z_last": _ends(z[last]),
                "height": np.degrees(np.arcsin(np.clip(_ends(z), -1, 1))),
                "nutation": _ends(nutation),
                "nutation_first": nutation[first].mean(),
                "nutation_last": nutation[last].mean(),
                "sun_angle": np.degrees(
                    np.arctan2(np.linalg.norm(np.cross(H[0], sun)), H[0] @ sun)
                ),
                "axis_swing": np.degrees(np.arccos(np.clip((axis_N @ axis_N.T).min(), -1, 1))),
                "peaks": count_peaks(z),
            }
        )
    columns = {name: np.array([motion[name] for motion in motions]) for name in motions[0]}
    shape = starts.shape[:-1]
    return {name: values.reshape((*shape, *values.shape[1:])) for name, values in columns.items()}


def _ends(values: np.ndarray) -> np.ndarray:
    return np.array([values.min(), values.max()])


def count_peaks(z: np.ndarray) -> int:
    """Number of distinct peaks of the distribution of values (n); 1 where they hardly vary."""
    if np.ptp(z) < 1e-3:
        return 1
    density = np.histogram(z, bins=PEAK_BINS)[0].astype(np.float64)
    smooth = np.convolve(np.pad(density, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    peaks, _ = find_peaks(np.pad(smooth, 1), prominence=PEAK_PROMINENCE * smooth.max())
    return len(peaks)


class Precession(NamedTuple):
    """Philae between first touchdown and collision: `swing` of the example motions, and of points of each published line.

    `omega_z` (n): rate about z in rad/s at the first sample of the points.
    """

    case: Case
    examples: dict[str, np.ndarray]
    lines: dict[str, np.ndarray]
    omega_z: np.ndarray


def compute(case: Case) -> Precession:
    """The swing of the examples of Figs. 6, 7 and of points of the published lines."""
    start = rb.first_sun(case), rb.nominal_speed(case.vehicle)
    duration = 60.0 * case.published["example_duration"].value
    examples = swing(case.vehicle, case.published["example_rates"].value, *start, duration)
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    points = rb.on_lines(rb.published_lines(case), omega_z)
    return Precession(
        case, examples, swing(case.vehicle, points, *start, rb.window_s(case)), omega_z
    )


def rows(result: Precession) -> list[Row]:
    """Statements of sections 2.2, 2.3 and 3.2 on the amplitude of precession beside ours."""
    case, examples, lines, _ = result
    low, high = case.published["sun_height_range"].value
    height, tenth = lines["height"], (high - low) / 10
    typical, ends = height.mean(axis=(0, 1)).tolist(), [height.min(), height.max()]
    doubled = (lines["nutation_first"] + lines["nutation_last"]).mean(axis=1)
    widest = lines["axis_swing"].mean(axis=1)
    as_wide = bool(np.all(np.abs(widest - (high - low)) <= SWING_DEG))
    z_change, of_lines = (np.abs(each["z_last"] - each["z_first"]) for each in (examples, lines))
    changed = [
        np.nanmax(np.abs(s["nutation_last"] - s["nutation_first"])) for s in (examples, lines)
    ]
    first, last = ("{:.3f}..{:.3f}".format(*examples[of][1]) for of in ("z_first", "z_last"))
    wander = zip(
        lines["nutation"].min(axis=(1, 2)), lines["nutation"].max(axis=(1, 2)), strict=True
    )
    peaks = np.concatenate([examples["peaks"][1:], lines["peaks"].ravel()])
    return [
        row(
            case,
            "sun_height_lines",
            typical,
            published=[low, high],
            tolerance=tenth,
            points=height.shape[0] * height.shape[1],
            height=ends,
        ),
        row(
            case,
            "axis_swing",
            widest.tolist(),
            tolerance=SWING_DEG,
            twice=", ".join(f"{angle:.0f}" for angle in doubled),
            agrees=as_wide,
        ),
        row(
            case,
            "range_of_z_examples",
            float(z_change.max()),
            tolerance=SAME_Z,
            agrees=bool(z_change.max() <= SAME_Z),
            omega=list(case.published["example_rates"].value[1]),
            first=first,
            last=last,
        ),
        row(
            case,
            "range_of_z_lines",
            [float(np.median(of_lines)), float(of_lines.max())],
            tolerance=SAME_Z,
            agrees=bool(of_lines.max() <= SAME_Z),
            share=float(np.mean(of_lines <= SAME_Z)),
        ),
        row(
            case,
            "nutation_constant",
            float(max(changed)),
            each="; ".join(f"{a:.0f} to {b:.0f} (L{k})" for k, (a, b) in enumerate(wander, 1)),
        ),
        row(
            case,
            "rz_peaks",
            float(np.median(peaks)),
            two=np.mean(peaks == 2),
            distributions=peaks.size,
        ),
    ]


def draw(result: Precession) -> Figure:
    """Height of the Sun on each line, whole window and its first and last ten minutes; nutation angle; swing of the axis."""
    case, _, lines, omega_z = result
    figure = Figure(figsize=(11.5, 7), layout="constrained")
    upper, lower = figure.subfigures(2, 1, squeeze=False)[:, 0]
    heights, (nutation, swings) = upper.subplots(1, 4, sharey=True), lower.subplots(1, 2)
    low, high = case.published["sun_height_range"].value
    along = {"xlabel": r"$\omega_z$ at the first sample (rad/s)"}
    for k, axes in enumerate(heights):
        name, colour = f"L{k + 1}", COLOURS[k]
        style: dict[str, Any] = {
            "color": COLOURS[5],
            "alpha": 0.4,
            "lw": 0,
            "label": "whole window",
        }
        axes.fill_between(omega_z, *lines["height"][k].T, **style)
        for line, label, of in (("--", "first 10 min", "z_first"), ("-", "last 10 min", "z_last")):
            ends = np.degrees(np.arcsin(lines[of][k]))
            axes.plot(omega_z, ends, line, lw=1.2, color=COLOURS[6], label=[label, None])
        for height, label in ((low, "published"), (high, None)):
            axes.axhline(height, ls=":", lw=1.2, color=COLOURS[1], label=label)
        axes.set(title=name, **along)
        nutation.fill_between(omega_z, *lines["nutation"][k].T, color=colour, alpha=0.15, lw=0)
        nutation.plot(omega_z, lines["nutation_first"][k], "--", lw=1.2, color=colour)
        nutation.plot(omega_z, lines["nutation_last"][k], "-", lw=1.2, color=colour, label=name)
        style = {"ms": 5, "mfc": "none", "color": colour, "label": name}
        swings.plot(np.ptp(lines["height"][k], axis=1), lines["axis_swing"][k], "os^D"[k], **style)
    heights[0].set_ylabel("height of the Sun (deg)")
    heights[0].set_ylim(min(-5.0, *(axes.dataLim.y0 for axes in heights)) - 1, 92)
    labels = heights[0].get_legend_handles_labels()
    upper.legend(*labels, fontsize=8, ncols=4, loc="outside lower center", frameon=False)
    nutation.set(ylabel="angle between z and H (deg)", **along)
    nutation.set_ylim(20, max(70.0, 8 + lines["nutation"].max()))
    nutation.legend(fontsize=8, ncols=4)
    title = "nutation: range in the window, mean of first (dashed) and last 10 min"
    nutation.set_title(title, fontsize=9)
    swings.plot([50, 130], [50, 130], lw=0.8, color=COLOURS[7])
    swings.text(100, 103, "equal", fontsize=8, color="#555555", rotation=38)
    swings.plot(high - low, high - low, "*", ms=12, color=COLOURS[6], label="published")
    swings.set(xlabel="range of the Sun's height (deg)")
    swings.set(ylabel="swing of the z axis in inertial space (deg)", xlim=(55, 120))
    swings.set_ylim(55, max(130.0, 1.05 * lines["axis_swing"].max()))
    swings.legend(fontsize=8, loc="lower right")
    swings.set_title("the height's range is not the axis's swing", fontsize=9)
    title = "Precession on the paper's lines, simulated from the first sample to the collision"
    figure.suptitle(title, fontsize=11)
    return figure
