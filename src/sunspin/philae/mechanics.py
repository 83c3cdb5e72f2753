"""The mechanical model: spin-down of the wheel, example motions, precession (paper, sections 2.2 and 3.2, Figs. 5 to 7).

|H|, |r| and H.r never change in free flight, so neither does the angle alpha between H and the Sun; the angle theta between H
and the z axis, the nutation, is constant for a body that is symmetric about that axis, whatever friction does, and wanders for one
that is not. The axis swings by up to 2 theta, the Sun's height over the xy plane by 2 min(theta, alpha): the paper takes the
second for the first.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from matplotlib.figure import Figure
from scipy.signal import find_peaks
from scipy.spatial.transform import Rotation

from sunspin.cases import Case
from sunspin.dynamics.friction import (
    fit_spin_down,
    spin_down_curve,
    spin_down_speed,
    spin_down_time,
)
from sunspin.dynamics.propagate import propagate
from sunspin.output.figures import COLOURS
from sunspin.philae.rebound import (
    LINE_RANGE,
    first_sun,
    nominal_wheel_speeds,
    points_on_lines,
    published_lines,
    published_window_s,
)
from sunspin.philae.row import Row, row
from sunspin.philae.sun_directions import sphere
from sunspin.vehicle import Vehicle

# ---- Wheel and example motions -----------------------------------------------------------------------------------------------


class Mechanics(NamedTuple):
    """`examples`: runs of Figs. 6 and 7 as `propagate` returns them; `spin_down`: see :func:`figure_5`."""

    case: Case
    examples: list[xr.Dataset]
    spin_down: dict[str, Any]


def compute(case: Case) -> Mechanics:
    """Nothing here depends on telemetry."""
    t = np.arange(0.0, 60.0 * case.published["example_duration"].value + 0.5, 1.0)
    start = first_sun(case), nominal_wheel_speeds(case.vehicle)
    rates = case.published["example_rates"].value
    runs = [propagate(case.vehicle, omega, *start, t) for omega in rates]
    return Mechanics(case, runs, figure_5(case))


def figure_5(case: Case) -> dict[str, Any]:
    """Fig. 5: the wheel on a body that stays at rest, with the fitted and with the printed friction; the fit recovered."""
    wheel = case.vehicle.wheels[0]
    rounded = case.vehicle.with_friction("printed").wheels[0].friction
    law = rounded.coulomb_N_m, rounded.viscous_N_m_s, wheel.inertia_kg_m2
    c1, c2, c3 = case.published["spin_down_coefficients"].value
    t = np.linspace(0.0, 0.999 * np.log(-c3 / c1) / c2, 200)  # up to just before the stop
    record = spin_down_curve(t, c1, c2, c3)
    return {
        "t_s": t,
        "record": record,
        "fit": fit_spin_down(t, record, wheel.inertia_kg_m2),
        "printed": spin_down_speed(*law, record[0], t),
        "stop_printed_s": spin_down_time(rounded, wheel.inertia_kg_m2, wheel.speed_rad_s),
    }


def rows(result: Mechanics) -> list[Row]:
    """Figures of section 2.2 beside ours."""
    row_of, fit = partial(row, result.case), result.spin_down["fit"]
    still = result.examples[0]
    z, stops = still["sun_B"].values[:, 2], still["event_time_s"].values / 60
    ends, still_z = [float(z.min()), float(z.max())], 0.01  # below it r_z counts as constant
    stop, printed = float(stops[0]) if len(stops) else None, result.spin_down["stop_printed_s"] / 60
    return [
        row_of("spin_down_coefficients", [fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s]),
        row_of("friction_coulomb", fit.friction.coulomb_N_m),
        row_of("friction_viscous", fit.friction.viscous_N_m_s),
        row_of("wheel_stop", stop, printed=printed),
        row_of("example_still_z", ends, tolerance=still_z, agrees=bool(np.ptp(z) < still_z)),
    ]


def figure_6(runs: list[xr.Dataset]) -> Figure:
    """The Sun's track on the sphere and its components for several initial rates (paper, Fig. 6)."""
    figure = Figure(figsize=(11, 7.5), layout="constrained")
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)[:, 0]
    components = lower.subplots(3, len(runs), sharex=True, sharey=True, squeeze=False)
    for k, run in enumerate(runs):
        r, minutes, axes = run["sun_B"].values, run["time"].values / 60, sphere(upper, len(runs), k)
        axes.plot(*r.T, lw=0.4, color=COLOURS[0])
        axes.set_title(_initial_rate(run), fontsize=9)
        for i, name in enumerate("xyz"):
            components[i, k].plot(minutes, r[:, i], lw=0.5, color=COLOURS[i])
            components[i, 0].set_ylabel(f"$r_{name}$")
        components[2, k].set_xlabel("time (min)")
    return figure


def figure_7(runs: list[xr.Dataset]) -> Figure:
    """Distribution of r_z over each run, as densities of area 1 (paper, Fig. 7)."""
    figure = Figure(figsize=(10, 3.2), layout="constrained")
    for axes, run in zip(figure.subplots(1, len(runs)), runs, strict=True):
        axes.hist(run["sun_B"].values[:, 2], bins=60, range=(-1, 1), density=True, color=COLOURS[0])
        axes.set(xlabel="$r_z$", ylabel="density")
        axes.set_title(_initial_rate(run), fontsize=9)
    return figure


def _initial_rate(run: xr.Dataset) -> str:
    rate = ", ".join(f"{x:.4g}" for x in run["omega_B"].values[0])
    return rf"$\omega(0)$ = [{rate}] rad/s"


# ---- Precession --------------------------------------------------------------------------------------------------------------


def swing(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: Any,
    duration_s: float,
    compared_s: float = 600.0,
) -> dict[str, np.ndarray]:
    """Swing of the z axis and of the Sun's height, for motions from the rates omega_B (..., 3) in rad/s.

    `sun_B` (3) is the direction to the Sun at the start; the first and the last `compared_s` of `duration_s` are compared
    (ten minutes: some forty turns).

    Returns
    -------
    dict
        Smallest and largest (..., 2) of: r_z, "z", and in the first and the last part "z_first", "z_last"; "height" of the Sun;
        "nutation", the angle between the z axis and H. For each motion (...): its mean in the two parts, "nutation_first",
        "nutation_last"; "axis_swing", the largest angle between the axis at two times in inertial space; "peaks" of the
        distribution of r_z. Angles in degrees.
    """
    starts = np.asarray(omega_B, dtype=np.float64)
    t = np.arange(0.0, duration_s + 0.5, 1.0)
    first, last = t <= compared_s, t >= duration_s - compared_s

    def ends(values: np.ndarray) -> np.ndarray:
        return np.array([values.min(), values.max()])

    motions = []
    for omega in starts.reshape(-1, 3):
        run = propagate(vehicle, omega, sun_B, wheel_speed_rad_s, t, rtol=1e-10)
        z, H = run["sun_B"].values[:, 2], run["momentum_B"].values
        nutation = np.degrees(np.arctan2(np.hypot(H[:, 0], H[:, 1]), H[:, 2]))
        nutation[~H.any(axis=1)] = np.nan  # what does not turn has no axis
        axis_N = Rotation.from_quat(run["B_from_N"].values).inv().apply([0.0, 0.0, 1.0])
        motion = {
            "z": ends(z),
            "z_first": ends(z[first]),
            "z_last": ends(z[last]),
            "height": np.degrees(np.arcsin(np.clip(ends(z), -1, 1))),
            "nutation": ends(nutation),
            "nutation_first": nutation[first].mean(),
            "nutation_last": nutation[last].mean(),
            "axis_swing": np.degrees(np.arccos(np.clip((axis_N @ axis_N.T).min(), -1, 1))),
            "peaks": count_peaks(z),
        }
        motions.append(motion)
    columns = {name: np.array([motion[name] for motion in motions]) for name in motions[0]}
    shape = starts.shape[:-1]
    return {name: values.reshape((*shape, *values.shape[1:])) for name, values in columns.items()}


def count_peaks(z: np.ndarray) -> int:
    """Peaks of the distribution of values (n) that stand out by a fifth of the highest; 1 where the values hardly vary."""
    if np.ptp(z) < 1e-3:
        return 1
    density = np.histogram(z, bins=24)[0].astype(np.float64)
    smooth = np.convolve(np.pad(density, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    peaks, _ = find_peaks(np.pad(smooth, 1), prominence=0.2 * smooth.max())
    return len(peaks)


class Precession(NamedTuple):
    """Philae between first touchdown and collision: `swing` of the example motions, and of points of each published line."""

    case: Case
    examples: dict[str, np.ndarray]
    lines: dict[str, np.ndarray]


def precession(case: Case) -> Precession:
    """The swing of the examples of Figs. 6, 7 and of points of the published lines."""
    start = first_sun(case), nominal_wheel_speeds(case.vehicle)
    duration = 60.0 * case.published["example_duration"].value
    examples = swing(case.vehicle, case.published["example_rates"].value, *start, duration)
    points = points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 11))
    lines = swing(case.vehicle, points, *start, published_window_s(case))
    return Precession(case, examples, lines)


def precession_rows(result: Precession) -> list[Row]:
    """Statements of sections 2.2, 2.3 and 3.2 on the amplitude of precession beside ours."""
    case, examples, lines = result
    low, high = case.published["sun_height_range"].value
    height, widest = lines["height"], lines["axis_swing"].mean(axis=1)
    typical = height.mean(axis=(0, 1)).tolist()
    doubled = (lines["nutation_first"] + lines["nutation_last"]).mean(axis=1)
    of_examples, of_lines = (np.abs(each["z_last"] - each["z_first"]) for each in (examples, lines))
    nutation = (each["nutation_last"] - each["nutation_first"] for each in (examples, lines))
    changed = float(max(np.nanmax(np.abs(each)) for each in nutation))
    least, most = (end(lines["nutation"], axis=(1, 2)) for end in (np.min, np.max))
    wander = enumerate(zip(least, most, strict=True), 1)
    peaks = np.concatenate([examples["peaks"][1:], lines["peaks"].ravel()])
    # the ends of the range of r_z stay roughly the same within this; the swing is as wide as the height ranges within 10 deg
    same_z, swing_deg = 0.1, 10.0
    texts = {
        "points": height[..., 0].size,
        "height": [height.min(), height.max()],
        "twice": ", ".join(f"{angle:.0f}" for angle in doubled),
        "omega": list(case.published["example_rates"].value[1]),
        "first": "{:.3f}..{:.3f}".format(*examples["z_first"][1]),
        "last": "{:.3f}..{:.3f}".format(*examples["z_last"][1]),
        "share": float(np.mean(of_lines <= same_z)),
        "each": "; ".join(f"{a:.0f} to {b:.0f} (L{k})" for k, (a, b) in wander),
        "two": np.mean(peaks == 2),
        "distributions": peaks.size,
    }
    row_of, alike = partial(row, case, **texts), {"tolerance": same_z}
    as_wide = bool(np.all(np.abs(widest - (high - low)) <= swing_deg))
    kept_examples, kept_lines = (bool(each.max() <= same_z) for each in (of_examples, of_lines))
    median_and_most, tenth = [float(np.median(of_lines)), float(of_lines.max())], (high - low) / 10
    return [
        row_of("sun_height_lines", typical, published=[low, high], tolerance=tenth),
        row_of("axis_swing", widest.tolist(), tolerance=swing_deg, agrees=as_wide),
        row_of("range_of_z_examples", float(of_examples.max()), agrees=kept_examples, **alike),
        row_of("range_of_z_lines", median_and_most, agrees=kept_lines, **alike),
        row_of("nutation_constant", changed),
        row_of("rz_peaks", float(np.median(peaks))),
    ]
