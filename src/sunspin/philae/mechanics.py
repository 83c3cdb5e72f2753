"""Mechanical model: spin-down of the wheel, example motions, precession (paper, sections 2.2 and 3.2, Figs. 5 to 7).

In free flight |H|, |r| and H.r are constant, so the angle alpha between the angular momentum H and the Sun is constant. The angle
theta between H and the z axis is the nutation. It is constant for a body that is symmetric about z, even with friction, and varies
otherwise. In inertial space the z axis moves by up to 2 theta. The Sun's elevation over the x-y plane varies by 2 min(theta,
alpha). The paper takes the second for the first.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
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
from sunspin.output.figures import COLOURS, empty_figure
from sunspin.philae.rebound import (
    LINE_RANGE,
    first_sun,
    nominal_wheel_speeds,
    points_on_lines,
    published_lines,
    published_window_s,
)
from sunspin.philae.row import Row, make_row, read_tables
from sunspin.philae.sun_directions import sphere_axes
from sunspin.vehicle import Vehicle

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- Wheel and example motions -----------------------------------------------------------------------------------------------


class Mechanics(NamedTuple):
    """Example motions and spin-down of the wheel.

    `examples`: motions of Figs. 6 and 7 as `propagate` returns them. `spin_down`: see :func:`simulate_spin_down`.
    """

    case: Case
    examples: list[xr.Dataset]
    spin_down: dict[str, Any]


def compute(case: Case) -> Mechanics:
    """Propagate the example motions and simulate the spin-down. Nothing here depends on telemetry."""
    t = np.arange(0.0, 60.0 * case.published["example_duration"].value + 0.5, 1.0)
    sun_B, wheel_speeds = first_sun(case), nominal_wheel_speeds(case.vehicle)
    examples = [
        propagate(case.vehicle, omega_B, sun_B, wheel_speeds, t)
        for omega_B in case.published["example_rates"].value
    ]
    return Mechanics(case, examples, simulate_spin_down(case))


def simulate_spin_down(case: Case) -> dict[str, Any]:
    """Return the spin-down of the wheel on a body at rest (Fig. 5).

    Keys: times "t_s"; wheel speeds "record" with the published fit and "printed" with the rounded friction, rad/s; "fit" of a
    friction law to the record; "stop_printed_s", the time to the stop with the rounded friction.
    """
    wheel = case.vehicle.wheels[0]
    rounded = case.vehicle.with_friction("printed").wheels[0].friction
    c1, c2, c3 = case.published["spin_down_coefficients"].value
    # the published curve c1 exp(c2 t) + c3 reaches zero at the stop; up to just before it
    stop_s = np.log(-c3 / c1) / c2
    t = np.linspace(0.0, 0.999 * stop_s, 200)
    record = spin_down_curve(t, c1, c2, c3)
    printed = spin_down_speed(
        rounded.coulomb_N_m, rounded.viscous_N_m_s, wheel.inertia_kg_m2, record[0], t
    )
    return {
        "t_s": t,
        "record": record,
        "fit": fit_spin_down(t, record, wheel.inertia_kg_m2),
        "printed": printed,
        "stop_printed_s": spin_down_time(rounded, wheel.inertia_kg_m2, wheel.speed_rad_s),
    }


def rows(result: Mechanics) -> list[Row]:
    """Return the figures of section 2.2 compared with ours."""
    fit = result.spin_down["fit"]
    # the first example starts at rest: its r_z hardly changes, and its first event is the stop of the wheel
    at_rest = result.examples[0]
    z = at_rest["sun_B"].values[:, 2]
    z_range, constant_z = [float(z.min()), float(z.max())], 0.01  # r_z that varies less is constant
    is_constant = bool(np.ptp(z) < constant_z)
    stops_min = at_rest["event_time_s"].values / 60
    stop_min = float(stops_min[0]) if len(stops_min) else None
    notes = {
        "wheel_stop": f"with the printed, rounded friction {result.spin_down['stop_printed_s'] / 60:.1f} min",
        "example_still_z": f"criterion: it changes by less than {constant_z:g}; Philae is not quite axisymmetric, so it is nearly "
        "constant",
    }
    row_of = partial(make_row, result.case, notes=notes)
    return [
        row_of("spin_down_coefficients", [fit.c1_rad_s, fit.c2_per_s, fit.c3_rad_s]),
        row_of("friction_coulomb", fit.friction.coulomb_N_m),
        row_of("friction_viscous", fit.friction.viscous_N_m_s),
        row_of("wheel_stop", stop_min),
        row_of("example_still_z", z_range, tolerance=constant_z, agrees=is_constant),
    ]


def sun_tracks_figure(motions: list[xr.Dataset]) -> Figure:
    """Draw the Sun's track on the sphere and its components for several initial rates (paper, Fig. 6)."""
    figure = empty_figure(11, 7.5)
    upper, lower = figure.subfigures(2, 1, height_ratios=(1.2, 1), squeeze=False)[:, 0]
    components = lower.subplots(3, len(motions), sharex=True, sharey=True, squeeze=False)
    for k, motion in enumerate(motions):
        sun_B, minutes = motion["sun_B"].values, motion["time"].values / 60
        axes = sphere_axes(upper, len(motions), k)
        axes.plot(*sun_B.T, lw=0.4, color=COLOURS[0])
        axes.set_title(_initial_rate(motion), fontsize=9)
        for i, name in enumerate("xyz"):
            components[i, k].plot(minutes, sun_B[:, i], lw=0.5, color=COLOURS[i])
            components[i, 0].set_ylabel(f"$r_{name}$")
        components[2, k].set_xlabel("time (min)")
    return figure


def rz_histograms_figure(motions: list[xr.Dataset]) -> Figure:
    """Draw the distribution of r_z over each motion, as densities of area 1 (paper, Fig. 7)."""
    figure = empty_figure(10, 3.2)
    for axes, motion in zip(figure.subplots(1, len(motions)), motions, strict=True):
        z = motion["sun_B"].values[:, 2]
        axes.hist(z, bins=60, range=(-1, 1), density=True, color=COLOURS[0])
        axes.set(xlabel="$r_z$", ylabel="density")
        axes.set_title(_initial_rate(motion), fontsize=9)
    return figure


def _initial_rate(motion: xr.Dataset) -> str:
    """Return the initial rate of a motion as text for a title."""
    rate = ", ".join(f"{x:.4g}" for x in motion["omega_B"].values[0])
    return rf"$\omega(0)$ = [{rate}] rad/s"


# ---- Precession --------------------------------------------------------------------------------------------------------------


def precession_amplitudes(
    vehicle: Vehicle,
    omega_B: npt.ArrayLike,
    sun_B: npt.ArrayLike,
    wheel_speed_rad_s: Any,
    duration_s: float,
    compared_s: float = 600.0,
) -> dict[str, np.ndarray]:
    """Return how far the z axis and the Sun's elevation move, for motions from the rates omega_B (..., 3) in rad/s.

    `sun_B` (3) is the Sun direction at the start. The first and the last `compared_s` of `duration_s` are compared (ten minutes:
    some forty revolutions).

    Returns
    -------
    dict
        Least and largest value (..., 2): of r_z, "z", and in the first and last part, "z_first", "z_last"; of the Sun's elevation,
        "height"; of the angle between z axis and H, "nutation". One value for each motion (...): mean nutation in the two parts,
        "nutation_first", "nutation_last"; largest angle between the z axis at two times in inertial space, "axis_swing"; number of
        peaks in the distribution of r_z, "peaks". Angles in degrees.
    """
    starts = np.asarray(omega_B, dtype=np.float64)
    t = np.arange(0.0, duration_s + 0.5, 1.0)
    first, last = t <= compared_s, t >= duration_s - compared_s

    rows = []
    for omega in starts.reshape(-1, 3):
        motion = propagate(vehicle, omega, sun_B, wheel_speed_rad_s, t, rtol=1e-10)
        z, H = motion["sun_B"].values[:, 2], motion["momentum_B"].values
        nutation = np.degrees(np.arctan2(np.hypot(H[:, 0], H[:, 1]), H[:, 2]))
        nutation[~H.any(axis=1)] = np.nan  # without angular momentum there is no nutation
        z_axis_N = Rotation.from_quat(motion["B_from_N"].values).inv().apply([0.0, 0.0, 1.0])
        # cosine of the largest angle between the z axis at any two times; in parts that fit the processor's cache
        parts = np.array_split(z_axis_N, 1 + len(z_axis_N) // 100)
        least_cosine = min((part @ z_axis_N.T).min() for part in parts)
        row = {
            "z": _extremes(z),
            "z_first": _extremes(z[first]),
            "z_last": _extremes(z[last]),
            "height": np.degrees(np.arcsin(np.clip(_extremes(z), -1, 1))),
            "nutation": _extremes(nutation),
            "nutation_first": nutation[first].mean(),
            "nutation_last": nutation[last].mean(),
            "axis_swing": np.degrees(np.arccos(np.clip(least_cosine, -1, 1))),
            "peaks": count_peaks(z),
        }
        rows.append(row)
    # one array for each quantity, with the shape of the given rates in front
    columns = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    shape = starts.shape[:-1]
    return {name: values.reshape((*shape, *values.shape[1:])) for name, values in columns.items()}


def _extremes(values: np.ndarray) -> np.ndarray:
    """Return the least and the largest value (2)."""
    return np.array([values.min(), values.max()])


def count_peaks(z: np.ndarray) -> int:
    """Return the number of peaks in the distribution of values (n) that rise by a fifth of the highest peak above their
    surroundings.

    It is 1 if the values vary by less than 0.001, as a histogram of rounding errors has peaks without a meaning.
    """
    if np.ptp(z) < 1e-3:
        return 1
    density = np.histogram(z, bins=24)[0].astype(np.float64)
    smooth = np.convolve(np.pad(density, 1, mode="edge"), [0.25, 0.5, 0.25], mode="valid")
    # zeros on both sides: a peak may be at an end of the range
    peaks, _ = find_peaks(np.pad(smooth, 1), prominence=0.2 * smooth.max())
    return len(peaks)


class Precession(NamedTuple):
    """Philae between first touchdown and collision: `precession_amplitudes` of the example motions and of points of each published
    line.
    """

    case: Case
    examples: dict[str, np.ndarray]
    lines: dict[str, np.ndarray]


def compute_precession(case: Case) -> Precession:
    """Return the precession of the examples of Figs. 6 and 7, and of eleven points of each published line."""
    start = first_sun(case), nominal_wheel_speeds(case.vehicle)
    duration_s = 60.0 * case.published["example_duration"].value
    examples = precession_amplitudes(
        case.vehicle, case.published["example_rates"].value, *start, duration_s
    )
    points = points_on_lines(published_lines(case), np.linspace(*LINE_RANGE, 11))
    lines = precession_amplitudes(case.vehicle, points, *start, published_window_s(case))
    return Precession(case, examples, lines)


def precession_rows(result: Precession) -> list[Row]:
    """Return the statements of sections 2.2, 2.3 and 3.2 on the amplitude of precession compared with ours."""
    case, examples, lines = result
    low, high = case.published["sun_height_range"].value
    elevation, axis_swing = lines["height"], lines["axis_swing"].mean(axis=1)
    mean_range = elevation.mean(axis=(0, 1)).tolist()  # mean smallest and mean largest elevation
    twice_nutation = (lines["nutation_first"] + lines["nutation_last"]).mean(axis=1)
    # changes between the first and the last ten minutes: of the range of r_z, and of the mean nutation
    z_examples, z_lines = (
        np.abs(motions["z_last"] - motions["z_first"]) for motions in (examples, lines)
    )
    nutation_changes = (
        motions["nutation_last"] - motions["nutation_first"] for motions in (examples, lines)
    )
    nutation_change = float(max(np.nanmax(np.abs(changes)) for changes in nutation_changes))
    least, most = (extreme(lines["nutation"], axis=(1, 2)) for extreme in (np.min, np.max))
    of_each = "; ".join(
        f"{a:.0f} to {b:.0f} (L{k})" for k, (a, b) in enumerate(zip(least, most, strict=True), 1)
    )
    # the first example starts at rest: its r_z is constant
    peaks = np.concatenate([examples["peaks"][1:], lines["peaks"].ravel()])
    # criteria: the range of r_z is constant if its ends change by less than 0.1; the axis moves as far as the elevation of the
    # Sun if both ranges are equal within 10 degrees
    same_z, same_deg = 0.1, 10.0
    twice = ", ".join(f"{angle:.0f}" for angle in twice_nutation)
    omega = list(case.published["example_rates"].value[1])
    first, last = ("{:.3f}..{:.3f}".format(*examples[name][1]) for name in ("z_first", "z_last"))
    most_deg = read_tables(case)["nutation_constant"]["at_most"]
    notes = {
        "sun_height_lines": f"criterion: a tenth of the range; mean over {elevation[..., 0].size} points of the lines, which have "
        f"{elevation.min():.1f} to {elevation.max():.1f}",
        "axis_swing": "counted among the contradictions; the height ranges over twice the smaller of two angles of the momentum, "
        f"to z and to the Sun; the axis swings by twice that to z ({twice} deg on average), so on L1 and L2 it does not follow "
        "where the legs point",
        "range_of_z_examples": f"criterion: {same_z:g}; {omega} rad/s: {first} to {last}",
        "range_of_z_lines": f"criterion: {same_z:g}, which {np.mean(z_lines <= same_z):.0%} of the points meet; the range widens "
        "as the wheel's momentum goes to an unsymmetric body",
        "nutation_constant": f"criterion: {most_deg:g} deg; within a run it wanders from {of_each} deg",
        "rz_peaks": f"{np.mean(peaks == 2):.0%} of {peaks.size} distributions have exactly two",
    }
    row_of = partial(make_row, case, notes=notes)
    as_wide = bool(np.all(np.abs(axis_swing - (high - low)) <= same_deg))
    kept_examples, kept_lines = (bool(changes.max() <= same_z) for changes in (z_examples, z_lines))
    median_and_most, tenth = [float(np.median(z_lines)), float(z_lines.max())], (high - low) / 10
    return [
        row_of("sun_height_lines", mean_range, published=[low, high], tolerance=tenth),
        row_of("axis_swing", axis_swing.tolist(), tolerance=same_deg, agrees=as_wide),
        row_of(
            "range_of_z_examples", float(z_examples.max()), tolerance=same_z, agrees=kept_examples
        ),
        row_of("range_of_z_lines", median_and_most, tolerance=same_z, agrees=kept_lines),
        row_of("nutation_constant", nutation_change),
        row_of("rz_peaks", float(np.median(peaks))),
    ]
