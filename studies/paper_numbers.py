"""Numbers of `studies.contradictions`: results of the paper's own figures, the equations and public facts for its statements.

Each number has a name that the texts in `contradictions.toml` use. Rates are in rad/s.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from sunspin.cases import Case
from sunspin.dynamics.friction import spin_down_time
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.landing.strategies import wheel_stop_at_rest
from sunspin.philae.rebound import (
    LINE_RANGE,
    first_sample_lead_s,
    first_sun,
    line_in_scan_range,
    momentum_angles,
    nominal_wheel_speeds,
    points_on_lines,
    published_lines,
    published_window_s,
    smallest_touchdown_speed,
    start_states,
    wheel_speed_at_first_sample,
)
from sunspin.philae.spin import error_of_rate, rotated_sun

LINE_POINTS = 13
"""Number of motions on each published line."""

ENERGY_AT_MOST_J = 55.0
"""Largest energy that the published 50 J may stand for if they are rounded to tens."""

SAMPLE_TIME_UNCERTAINTY_S = 30.0
"""Uncertainty of the time of the first sample after the touchdown, which follows from "45 min"."""

ALIASES = 100
"""Number of regular samples on which three rates are shown to fit equally well."""

HALF_DIGITS = (0.5e-5, 0.5e-11, 0.5e-15, 0.5e-20)
"""Half a unit of the last printed digit of omega_0 to omega_3 (rad/s, rad/s2, rad/s3, rad/s4)."""


class Lines(NamedTuple):
    """Motions that begin on the published lines.

    `at_collision`: angular speed (n) in rad/s just before the collision, by the rule that selects the points. `nutation_deg` (4,
    n): angle between the angular momentum and the z axis at points of each line, along `omega_z`.
    """

    at_collision: dict[str, np.ndarray]
    nutation_deg: np.ndarray
    omega_z: np.ndarray


def simulate_lines(case: Case) -> Lines:
    """Propagate points of the lines to the collision: even in omega_z over `LINE_RANGE`, and even along the lines in the scan
    range.
    """
    omega_z, printed = np.linspace(*LINE_RANGE, LINE_POINTS), published_lines(case)
    even = points_on_lines(printed, omega_z)
    inside = [line_in_scan_range(case, line, LINE_POINTS) for line in printed]
    starts = {
        f"evenly in omega_z over {list(LINE_RANGE)}": even.reshape(-1, 3),
        "evenly along the lines within the scanned box": np.concatenate(inside),
    }
    at_collision = {
        rule: np.array([speed_at_collision(case, omega) for omega in omegas])
        for rule, omegas in starts.items()
    }
    nutation, *_ = momentum_angles(case.vehicle, start_states(case, even, first_sun(case)))
    return Lines(at_collision, np.degrees(nutation.reshape(len(even), -1)), omega_z)


def speed_at_collision(case: Case, omega_B: np.ndarray) -> float:
    """Return the angular speed (rad/s) just before the collision of a motion with this rate at the first sample."""
    first, speeds = first_sun(case), nominal_wheel_speeds(case.vehicle)
    motion = propagate(
        case.vehicle, omega_B, first, speeds, [0.0, published_window_s(case)], rtol=1e-8
    )
    return float(np.linalg.norm(motion["omega_B"].values[-1]))


def descent_numbers(case: Case, paper: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers on measured directions, times and the descent (sections 1, 2.1, 2.3 and 3.1)."""
    between = case.require_timeline().seconds
    # first Sun direction as quoted for the study of E, which is no unit vector, and as printed elsewhere
    quoted, first = np.array(paper["first_sun_E_study"]), first_sun(case)
    length = np.linalg.norm(quoted)
    # x and y as quoted, and the z that makes it a unit vector
    unit_length = np.array([*quoted[:2], np.sqrt(1 - quoted[:2] @ quoted[:2])])
    cosines = np.array([first @ quoted / length, first @ unit_length]) / np.linalg.norm(first)
    angle, still_apart = np.degrees(np.arccos(cosines))

    # samples of the descent, numbered from the first to the last of the fit
    first_number, last_number = paper["descent_samples"]
    span, interval = 3600.0 * paper["descent_span"], 60.0 * paper["sampling_interval"]  # s
    spacing = span / (last_number - first_number) / 60  # min
    early = between("descent_fit_begins", "unfolding_ends")
    # Sun directions of one revolution about z, and the share that the panels determine
    z = paper["nz_descent"]
    start, axis = [np.sqrt(1 - z**2), 0.0, z], [0, 0, 1]
    azimuth = np.linspace(0.0, 2 * np.pi, 3600, endpoint=False)
    share = np.mean(reconstructible_mask(case.vehicle).contains(rotated_sun(start, axis, azimuth)))
    flight = between("first_touchdown", "collision") / 60

    # rate of the descent by the printed cubic
    cubic, (low, high) = paper["descent_rate_cubic"], paper["descent_rate_range"]
    t = np.linspace(0.0, span, 100_001)
    rate = np.polynomial.polynomial.polyval(t, cubic)
    half_digit = HALF_DIGITS[0]
    ratio = case.vehicle.require_inertia()[2, 2] / case.vehicle.wheels[0].inertia_kg_m2
    # rates that differ by one revolution between regular samples give the same directions
    aliases = cubic[0] + 2 * np.pi / interval * np.array([-1, 0, 1])
    regular = interval * np.arange(ALIASES)
    seen = rotated_sun(start, axis, cubic[0] * regular)
    return {
        "length": length,
        "apart_deg": angle,
        "still_apart_deg": still_apart,
        "other_z": unit_length[2],
        "E_bound": (1 - length) / 2,
        "rms_deg": np.degrees(2 * np.arcsin(np.sqrt(paper["descent_E"]))),
        "delta_deg": np.degrees(paper["delta_mean"]),
        "spacing_min": spacing,
        "after_collision_min": paper["duration_after_collision"] / paper["samples_after_collision"],
        "share_percent": 100 * share,
        "seen_min": spacing * share,
        "flight_min": flight,
        "times": (flight / paper["window_before_collision"]) ** 2,
        "smallest_rate": rate.min(),
        "largest_rate": rate.max(),
        "largest_at_s": t[np.argmax(rate)],
        "mean_rate": rate.mean(),
        "rounding": np.polynomial.polynomial.polyval(span, HALF_DIGITS),
        "inside_percent": 100 * np.mean((rate >= low - half_digit) & (rate <= high + half_digit)),
        "change": ratio * np.array([high - low, np.ptp(rate)]),
        "early_min": -early / 60,
        "first_at_min": (first_number - 1) * spacing,
        "shadowed": early / 60 / spacing,
        "interval_s": interval,
        "slow": np.pi / interval,
        "tied_rates": aliases,
        "worst_E": max(1e-15, *(error_of_rate([alias], regular, seen) for alias in aliases)),
    }


def motion_numbers(case: Case, paper: dict[str, Any], lines: Lines) -> dict[str, Any]:
    """Return the numbers on wheel, motion before the collision, collision and rest (sections 2.2, 3.2, 3.3 and 4)."""
    wheel, since = case.vehicle.wheels[0], first_sample_lead_s(case)
    ratio = wheel.friction.coulomb_N_m / wheel.friction.viscous_N_m_s
    decay = wheel.friction.viscous_N_m_s / wheel.inertia_kg_m2
    # speed of a wheel that coasts on a body at rest: at the touchdown, and at the earliest and latest first sample after it if
    # the nominal speed is that at the touchdown
    speed = wheel.speed_rad_s
    sample_times = since + SAMPLE_TIME_UNCERTAINTY_S * np.array([-1, 1])
    before, *later = (speed + ratio) * np.exp(-decay * np.array([-since, *sample_times])) - ratio
    now, printed = wheel_speed_at_first_sample(case), published_lines(case)
    _, c2, c3 = paper["spin_down_coefficients"]

    points = start_states(case, np.array([point for point, _ in printed]), first_sun(case))
    nutation, to_sun = np.degrees(momentum_angles(case.vehicle, points)[:2])
    wide, narrow = 2 * lines.nutation_deg[:2], 2 * lines.nutation_deg[2:]
    left = case.vehicle.require_mass() * paper["trajectory_speed_after_touchdown"] ** 2 / 2
    absorbed = 100 * (1 - left / np.array([paper["touchdown_energy_before"], ENERGY_AT_MOST_J]))

    rate, speeds = paper["rate_at_collision"], list(lines.at_collision.values())
    spin_rate = 2 * np.pi / paper["romap_period_before"]
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    means = np.array([each.mean() for each in speeds])
    inertia_z = case.vehicle.require_inertia()[2, 2]
    rest = next(
        way for way in wheel_stop_at_rest(case.vehicle, paper["gravity"]) if way["way"] == "off"
    )
    return {
        "since_s": since,
        "speed_now": now,
        "speed_before": before,
        "losses": speed - np.array(later),
        "stop_min": spin_down_time(wheel.friction, wheel.inertia_kg_m2, before) / 60,
        "least_rates": [smallest_touchdown_speed(case, start) for start in (speed, now)],
        "wrong_sign": decay * (speed + ratio),
        "slowing": c2 * (speed - c3),
        "swing_deg": 2 * nutation,
        "height_range_deg": [float(np.diff(paper["sun_height_range"])[0])] * len(printed),
        "heights": ", ".join(f"{2 * angle:.0f}" for angle in np.minimum(nutation, to_sun)),
        "wide": [wide.min(), wide.max()],
        "narrow": [narrow.min(), narrow.max()],
        "left_J": left,
        "absorbed_percent": absorbed[0],
        "at_most_J": ENERGY_AT_MOST_J,
        "of_most_percent": absorbed[1],
        "tip_slow": paper["landing_speed"] + longest * rate,
        "tip_fast": paper["collision_speed"] + longest * rate,
        "tip_kernel": paper["kernel_speed_before"] + longest * rate,
        "tip_spun": paper["collision_speed"] + longest * spin_rate,
        "rates_at_collision": means,
        "rules": "; ".join(lines.at_collision),
        "slower_percent": [100 * np.mean(each < rate) for each in speeds],
        "fastest": max(each.max() for each in speeds),
        "from_rest": speed_at_collision(case, np.zeros(3)),
        "passed": wheel.inertia_kg_m2 * speed / inertia_z,
        "turn": spin_rate,
        "faster": [means.min() / rate, means.max() / rate],
        "rest": rest,
        "rest_torque": rest["torque_N_m"],
        "rest_force": rest["foot_force_N"],
    }
