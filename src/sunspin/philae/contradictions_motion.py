"""Contradictions of the paper about the wheel, the motion before the collision, the collision and rest (sections 2.2, 3, 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.friction import spin_down_time
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.lines import point_at
from sunspin.landing.strategies import settling
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

LINE_POINTS = 13

ENERGY_AT_MOST_J = 55.0
"""What the published 50 J may stand for if they are rounded to tens."""

SAMPLE_TIME_UNCERTAINTY_S = 30.0
"""The time of the first sample after the touchdown follows from "45 min", so it is known to half a minute."""


@dataclass(frozen=True)
class Lines:
    """Of motions that begin on the published lines.

    Attributes
    ----------
    at_collision : drawing rule -> (n,) angular speed (rad/s) just before the collision
    still : angular speed (rad/s) then of a lander that was at rest at the first sample
    nutation, sun_angle : (4,) angle (rad) between H and z, H and the Sun at the printed points
    nutation_along : (4, n) angle (rad) between H and z at points even in omega_z over the compared range
    """

    at_collision: dict[str, np.ndarray]
    still: float
    nutation: np.ndarray
    sun_angle: np.ndarray
    nutation_along: np.ndarray


def lines(case: Case) -> Lines:
    """Run points of the lines to the collision, even in omega_z over the compared range, or even along them in the box."""
    published = rb.published_lines(case)
    box = np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])
    rules = {
        f"evenly in omega_z over {list(rb.LINE_RANGE)}": [
            point_at(point, along, 2, np.linspace(*rb.LINE_RANGE, LINE_POINTS))
            for point, along in published
        ],
        "evenly along the lines within the scanned box": [
            _within(point, along, box) for point, along in published
        ],
    }
    unit = np.array([_momentum_direction(case, point) for point, _ in published])
    along_z = [
        [_momentum_direction(case, start)[2] for start in starts]
        for starts in next(iter(rules.values()))
    ]
    return Lines(
        {rule: _speeds(case, np.concatenate(starts)) for rule, starts in rules.items()},
        float(_speeds(case, np.zeros((1, 3)))[0]),
        np.arccos(unit[:, 2]),
        np.arccos(unit @ (rb.first_sun(case) / np.linalg.norm(rb.first_sun(case)))),
        np.arccos(np.array(along_z)),
    )


def _within(point: np.ndarray, along: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Points (n, 3) evenly along the part of a line inside a box (3, 2)."""
    ends = np.sort((box - point[:, None]) / along[:, None], axis=1)
    return point + np.linspace(ends[:, 0].max(), ends[:, 1].min(), LINE_POINTS)[:, None] * along


def _momentum_direction(case: Case, omega: np.ndarray) -> np.ndarray:
    momentum = g.total_momentum(
        case.vehicle, omega[None], np.array([rb.nominal_speed(case.vehicle)])
    )[0]
    return momentum / np.linalg.norm(momentum)


def _speeds(case: Case, starts: np.ndarray) -> np.ndarray:
    vehicle, end = case.vehicle, rb.window_s(case)
    return np.array(
        [
            np.linalg.norm(
                propagate(
                    vehicle,
                    omega,
                    rb.first_sun(case),
                    rb.nominal_speed(vehicle),
                    [0.0, end],
                    rtol=1e-8,
                )["omega_B"].values[-1]
            )
            for omega in starts
        ]
    )


def model_rows(case: Case) -> list[Row]:
    """Speed of the wheel, sign of its friction (section 2.2 and appendix)."""
    wheel, published = (
        case.vehicle.wheels[0],
        {key: figure.value for key, figure in case.published.items()},
    )
    _, c2, c3 = published["spin_down_coefficients"]
    friction, speed, since = wheel.friction, wheel.speed_rad_s, rb.after_touchdown_s(case)
    slowing = -(friction.coulomb_N_m + friction.viscous_N_m_s * speed) / wheel.inertia_kg_m2
    coasted = rb.speed_at_first_sample(case)
    both = [
        rb.smallest_on_lines(case, rb.published_lines(case), start) for start in (speed, coasted)
    ]
    before = _coasted(case, speed, -since)
    losses = [
        speed - _coasted(case, speed, since + shift * SAMPLE_TIME_UNCERTAINTY_S)
        for shift in (-1, 1)
    ]
    stop = spin_down_time(friction, wheel.inertia_kg_m2, before) / 60
    return [
        row(
            case,
            "contradiction_wheel_speed_twice",
            coasted,
            published=published["wheel_speed"],
            losses=losses,
            before=before,
            stop=stop,
            both=both,
            since=since,
        ),
        row(case, "contradiction_friction_sign", c2 * (speed - c3), published=-slowing),
    ]


def _coasted(case: Case, speed_rad_s: float, time_s: float) -> float:
    """Speed (rad/s) of a wheel that coasts on a body at rest; a negative time goes back."""
    wheel = case.vehicle.wheels[0]
    ratio = wheel.friction.coulomb_N_m / wheel.friction.viscous_N_m_s
    decay = wheel.friction.viscous_N_m_s / wheel.inertia_kg_m2
    return float((speed_rad_s + ratio) * np.exp(-decay * time_s) - ratio)


def precession_rows(case: Case, found: Lines) -> list[Row]:
    """The swing of the z axis, and the energy at the touchdown (section 3.2)."""
    published = {key: figure.value for key, figure in case.published.items()}
    height = 2 * np.degrees(np.minimum(found.nutation, found.sun_angle))
    swing, along = 2 * np.degrees(found.nutation), 2 * np.degrees(found.nutation_along)
    wide, narrow = along[:2], along[2:]
    low, high = published["sun_height_range"]
    mass, speed = case.vehicle.require_mass(), published["trajectory_speed_after_touchdown"]
    left, before = mass * speed**2 / 2, published["touchdown_energy_before"]
    return [
        row(
            case,
            "contradiction_axis_swing",
            swing.tolist(),
            published=[high - low] * 4,
            narrow=[narrow.min(), narrow.max()],
            wide=[wide.min(), wide.max()],
            height=", ".join(f"{x:.0f}" for x in height),
        ),
        row(
            case,
            "contradiction_energy_absorbed",
            100 * (1 - left / before),
            published=published["energy_absorbed"],
            at_most_J=ENERGY_AT_MOST_J,
            of_most=100 * (1 - left / ENERGY_AT_MOST_J),
            left=left,
        ),
    ]


def collision_rows(case: Case, found: Lines) -> list[Row]:
    """Speeds and rates at the collision (sections 3.3 and 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    slow, fast, rate = (
        published["landing_speed"],
        published["collision_speed"],
        published["rate_at_collision"],
    )
    kernel, path = published["kernel_speed_before"], published["kernel_path_length"]
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    turn = 2 * np.pi / published["romap_period_before"]
    rates = found.at_collision
    means = {rule: float(values.mean()) for rule, values in rates.items()}
    slower = [100 * float(np.mean(values < rate)) for values in rates.values()]
    largest = max(float(values.max()) for values in rates.values())
    wheel = case.vehicle.wheels[0]
    passed = wheel.inertia_kg_m2 * wheel.speed_rad_s / case.vehicle.require_inertia()[2, 2]
    return [
        row(
            case,
            "contradiction_speed_twice",
            [kernel, kernel, path],
            published=[slow, fast, published["path_length"]],
            fast=fast + longest * rate,
            kernel=kernel + longest * rate,
            slow=slow + longest * rate,
            spun=fast + longest * turn,
        ),
        row(
            case,
            "contradiction_rate_at_collision",
            list(means.values()),
            published=[rate] * len(means),
            slower=slower,
            largest=largest,
            still=found.still,
            passed=passed,
            turn=turn,
            rules="; ".join(means),
            times=[min(means.values()) / rate, max(means.values()) / rate],
        ),
    ]


def rest_rows(case: Case) -> list[Row]:
    """Whether switching the wheel off at rest would have moved the lander (section 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    rest = next(
        entry for entry in settling(case.vehicle, published["gravity"]) if entry["way"] == "off"
    )
    stated = [published["final_friction_torque"], published["final_foot_force"]]
    return [
        row(
            case,
            "contradiction_final_torque",
            [rest["torque_N_m"], rest["foot_force_N"]],
            published=stated,
            rest=rest,
        )
    ]
