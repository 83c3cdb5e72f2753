"""How far the z axis swings and the Sun's height ranges, and how little both change while the wheel slows (paper, section 3.2).

Any axis of the body will do. |H|, |r| and H.r never change in free flight, so neither does the angle alpha between H and the
Sun; the angle theta between H and the axis, the nutation, is constant for a body that is symmetric about the axis, whatever
friction does, and wanders for one that is not. The axis swings by up to 2 theta, the Sun's height over the plane normal to it
by 2 min(theta, alpha): the paper takes the second for the first.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.dynamics.propagate import propagate
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


@dataclass(frozen=True)
class Swing:
    """Of n motions: arrays (n, ...) in rad unless said otherwise.

    Attributes
    ----------
    omega_B : (n, 3) rad/s at the start
    z : (n, 2) smallest and largest component of the Sun's direction along the axis
    z_first, z_last : (n, 2) the same in the first and last part of the window
    nutation : (n, 2) smallest and largest angle between the axis and H
    nutation_first, nutation_last : (n,) mean of that angle in the first and last part
    sun_angle : (n,) angle between H and the Sun, which is constant
    axis_swing : (n,) largest angle between the axis at two times, in inertial space
    peaks : (n,) number of peaks of the distribution of z
    """

    omega_B: np.ndarray
    z: np.ndarray
    z_first: np.ndarray
    z_last: np.ndarray
    nutation: np.ndarray
    nutation_first: np.ndarray
    nutation_last: np.ndarray
    sun_angle: np.ndarray
    axis_swing: np.ndarray
    peaks: np.ndarray

    @property
    def height(self) -> np.ndarray:
        """Smallest and largest height of the Sun over the plane normal to the axis, (n, 2)."""
        return np.arcsin(np.clip(self.z, -1, 1))


def swing(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: Any,
    duration_s: float,
    *,
    axis_B: npt.ArrayLike = (0.0, 0.0, 1.0),
    compared_s: float = COMPARED_S,
) -> Swing:
    """Swing of a body axis and of the Sun's height over it, for motions from the rates omega_B (n, 3) in rad/s.

    Parameters
    ----------
    sun_B : (3,)
        Direction to the Sun at the start.
    duration_s, compared_s : s
        Length of the motions, and of the first and last part that are compared.
    axis_B : (3,)
        Unit vector.
    """
    if not 0 < compared_s <= duration_s:
        raise InputError("compared_s must be positive and at most duration_s", got=compared_s)
    starts, axis = (
        np.atleast_2d(np.asarray(omega_B, dtype=np.float64)),
        np.asarray(axis_B, dtype=np.float64),
    )
    if axis.shape != (3,) or abs(np.linalg.norm(axis) - 1) > 1e-3:
        raise InputError("axis_B must be a unit vector of three components", got=axis_B)
    t = np.arange(0.0, duration_s + STEP_S / 2, STEP_S)
    parts = t <= compared_s, t >= duration_s - compared_s
    found = [
        _one(propagate(vehicle, omega, sun_B, wheel_speed_rad_s, t, rtol=1e-10), axis, parts)
        for omega in starts
    ]
    return Swing(starts, *(np.array(values) for values in zip(*found, strict=True)))


def _one(run: xr.Dataset, axis: np.ndarray, parts: tuple[np.ndarray, np.ndarray]) -> tuple:
    sun, momentum = run["sun_B"].values, run["momentum_B"].values
    size = np.linalg.norm(momentum, axis=1, keepdims=True)
    unit = np.where(
        size > 0, momentum / np.where(size > 0, size, 1.0), np.nan
    )  # what does not turn has no axis
    z, nutation = sun @ axis, _angle(unit, axis)
    sun_angle = _angle(unit[:1], sun[0] / np.linalg.norm(sun[0]))[0]
    first, last = parts
    return (
        _range(z),
        _range(z[first]),
        _range(z[last]),
        _range(nutation),
        nutation[first].mean(),
        nutation[last].mean(),
        sun_angle,
        _widest(_axis_N(run, axis)),
        count_peaks(z),
    )


def _range(values: np.ndarray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _angle(units: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Angles (n) between unit vectors (n, 3) and another (3), well conditioned near 0 and pi."""
    return np.arctan2(np.linalg.norm(np.cross(units, other), axis=1), units @ other)


def _axis_N(run: xr.Dataset, axis: np.ndarray) -> np.ndarray:
    """The axis in inertial space (n, 3); `B_from_N` is scalar last and turns components in N to components in B."""
    return Rotation.from_quat(run["B_from_N"].values).inv().apply(axis)


def _widest(units: np.ndarray) -> float:
    """Largest angle between two of the unit vectors (n, 3)."""
    smallest = min(
        float((units[at : at + 500] @ units.T).min()) for at in range(0, len(units), 500)
    )
    return float(np.arccos(np.clip(smallest, -1, 1)))


def count_peaks(z: np.ndarray) -> int:
    """Number of distinct peaks of the distribution of values (n); 1 where they hardly vary."""
    low, high = _range(z)
    if high - low < 1e-3:
        return 1
    density = np.histogram(z, bins=PEAK_BINS, range=(low, high))[0].astype(np.float64)
    smooth = np.convolve(np.pad(density, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    places, _ = find_peaks(
        np.concatenate([[0.0], smooth, [0.0]]), prominence=PEAK_PROMINENCE * smooth.max()
    )
    return len(places)


@dataclass(frozen=True)
class Precession:
    """Philae between first touchdown and collision: the example motions, points of each published line.

    `omega_z` (n): rate about z at the first sample of the points.
    """

    case: Case
    examples: Swing
    lines: list[Swing]
    omega_z: np.ndarray


def compute(case: Case) -> Precession:
    """The swing of the examples of Figs. 6, 7 and of points of the published lines."""
    vehicle, first, speed = case.vehicle, rb.first_sun(case), rb.nominal_speed(case.vehicle)
    duration = 60.0 * case.published["example_duration"].value
    examples = swing(vehicle, case.published["example_rates"].value, first, speed, duration)
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    lines = [
        swing(vehicle, rb.point_at(point, along, 2, omega_z), first, speed, rb.window_s(case))
        for point, along in rb.published_lines(case)
    ]
    return Precession(case, examples, lines, omega_z)


def rows(result: Precession) -> list[Row]:
    """Statements of sections 2.2, 2.3 and 3.2 on the amplitude of precession beside ours."""
    return [*_height_rows(result), *_constancy_rows(result)]


def _height_rows(r: Precession) -> list[Row]:
    height = np.degrees(np.array([line.height for line in r.lines]))
    typical = height.mean(axis=(0, 1))
    twice = [
        2 * float(np.degrees((line.nutation_first + line.nutation_last).mean() / 2))
        for line in r.lines
    ]
    widest = [float(np.degrees(line.axis_swing).mean()) for line in r.lines]
    low, high = r.case.published["sun_height_range"].value
    tenth = (high - low) / 10
    return [
        row(
            r.case,
            "sun_height_lines",
            typical.tolist(),
            published=[low, high],
            tolerance=tenth,
            points=height.shape[0] * height.shape[1],
            height=[height.min(), height.max()],
        ),
        row(
            r.case,
            "axis_swing",
            widest,
            tolerance=SWING_DEG,
            twice=", ".join(f"{x:.0f}" for x in twice),
            agrees=bool(np.all(np.abs(np.array(widest) - (high - low)) <= SWING_DEG)),
        ),
    ]


def _constancy_rows(r: Precession) -> list[Row]:
    change = np.abs(r.examples.z_last - r.examples.z_first)
    on_lines = np.array([np.abs(line.z_last - line.z_first) for line in r.lines])
    nutation = [
        np.nanmax(np.degrees(np.abs(s.nutation_last - s.nutation_first)))
        for s in (r.examples, *r.lines)
    ]
    wander = np.degrees(np.array([line.nutation for line in r.lines]))
    counts = np.concatenate([r.examples.peaks[1:], *(line.peaks for line in r.lines)])
    ranges = zip(wander[..., 0].min(axis=1), wander[..., 1].max(axis=1), strict=True)
    return [
        row(
            r.case,
            "range_of_z_examples",
            float(change.max()),
            tolerance=SAME_Z,
            agrees=bool(change.max() <= SAME_Z),
            omega=r.examples.omega_B[1].tolist(),
            first=_pair(r.examples.z_first[1]),
            last=_pair(r.examples.z_last[1]),
        ),
        row(
            r.case,
            "range_of_z_lines",
            [float(np.median(on_lines)), float(on_lines.max())],
            tolerance=SAME_Z,
            agrees=bool(on_lines.max() <= SAME_Z),
            share=float(np.mean(on_lines <= SAME_Z)),
        ),
        row(
            r.case,
            "nutation_constant",
            float(max(nutation)),
            each="; ".join(
                f"{low:.0f} to {high:.0f} (L{k + 1})" for k, (low, high) in enumerate(ranges)
            ),
        ),
        row(
            r.case,
            "rz_peaks",
            float(np.median(counts)),
            two=np.mean(counts == 2),
            distributions=counts.size,
        ),
    ]


def _pair(values: np.ndarray) -> str:
    return f"{values[0]:.3f}..{values[1]:.3f}"
