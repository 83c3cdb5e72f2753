"""Contradictions of the paper about the model, the motion before the collision, the collision and rest (sections 2.2, 3, 4)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.cases import Case
from sunspin.infer.lines import point_at
from sunspin.motion import gyrostat as g
from sunspin.motion.friction import spin_down_time
from sunspin.motion.propagate import propagate
from sunspin.study import rebound as rb
from sunspin.study.row import Row, statement
from sunspin.study.strategies import settling

LINE_POINTS = 13


@dataclass(frozen=True)
class Lines:
    """Of motions that begin on the published lines.

    Attributes
    ----------
    at_collision : drawing rule -> (n,) angular speed (rad/s) just before the collision
    still : angular speed (rad/s) then of a lander that was at rest at the first sample
    nutation, sun_angle : (4,) angle (rad) between H and z, H and the Sun at the printed points
    """

    at_collision: dict[str, np.ndarray]
    still: float
    nutation: np.ndarray
    sun_angle: np.ndarray


def lines(case: Case) -> Lines:
    """Run points of the lines to the collision, even in omega_z over the compared range, or even along them in the box."""
    published = rb.published_lines(case)
    box = np.array([case.published[f"scan_omega_{axis}"].value for axis in "xyz"])
    rules = {
        f"even in omega_z over {list(rb.LINE_RANGE)}": [
            point_at(point, along, 2, np.linspace(*rb.LINE_RANGE, LINE_POINTS)) for point, along in published
        ],
        "even along the lines within the scanned box": [_within(point, along, box) for point, along in published],
    }
    momentum = np.array([_momentum(case, point) for point, _ in published])
    unit = momentum / np.linalg.norm(momentum, axis=1, keepdims=True)
    return Lines(
        {rule: _speeds(case, np.concatenate(starts)) for rule, starts in rules.items()}, float(_speeds(case, np.zeros((1, 3)))[0]),
        np.arccos(unit[:, 2]), np.arccos(unit @ (rb.first_sun(case) / np.linalg.norm(rb.first_sun(case)))),
    )  # fmt: skip


def _within(point: np.ndarray, along: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Points (n, 3) evenly along the part of a line inside a box (3, 2)."""
    ends = np.sort((box - point[:, None]) / along[:, None], axis=1)
    return point + np.linspace(ends[:, 0].max(), ends[:, 1].min(), LINE_POINTS)[:, None] * along


def _momentum(case: Case, omega: np.ndarray) -> np.ndarray:
    return g.total_momentum(case.vehicle, omega[None], np.array([rb.nominal_speed(case.vehicle)]))[0]


def _speeds(case: Case, starts: np.ndarray) -> np.ndarray:
    vehicle, end = case.vehicle, rb.window_s(case)
    return np.array([
        np.linalg.norm(propagate(vehicle, omega, rb.first_sun(case), rb.nominal_speed(vehicle), [0.0, end], rtol=1e-8)
                       ["omega_B"].values[-1]) for omega in starts
    ])  # fmt: skip


def model_rows(case: Case) -> list[Row]:
    """Friction, wheel speed, signs (section 2.2 and appendix)."""
    wheel, published = case.vehicle.wheels[0], {key: figure.value for key, figure in case.published.items()}
    c1, c2, c3 = published["spin_down_coefficients"]
    friction = wheel.friction
    slowing = -(friction.coulomb_N_m + friction.viscous_N_m_s * wheel.speed_rad_s) / wheel.inertia_kg_m2
    coasted = rb.speed_at_first_sample(case)
    both = [rb.smallest_on_lines(case, rb.published_lines(case), speed) for speed in (wheel.speed_rad_s, coasted)]
    printed = case.vehicle.with_friction("printed").wheels[0].friction
    stop = spin_down_time(printed, wheel.inertia_kg_m2, wheel.speed_rad_s) / 60
    return [
        statement(
            "mu_1", "axial inertia of the wheel that the printed mu_1 implies, beside Table 2", wheel.inertia_kg_m2,
            published["friction_viscous"] / -c2, "kg m2", 1e-5, "Table 2 rounds; changes: mu_1 by 0.4 %", "section 2.2 and Table 2",
        ),
        statement(
            "wheel_stop_printed", "time in which the wheel stops with the printed, rounded friction", published["wheel_stop"], stop,
            "min", 0.5, "the unrounded fit gives the published 42.0 min; changes: the body's rate for the last minutes before the "
            "collision. Default: the fit, `with_friction(\"printed\")` the other", "sections 1 and 2.2",
        ),
        statement(
            "wheel_speed_twice", "wheel speed at the first sample if it was switched off at 865 rad/s at the touchdown",
            published["wheel_speed"], coasted, "rad/s", 5.0,
            f"{rb.after_touchdown_s(case):.0f} s of friction; 865 rad/s is used for both instants. Changes: the smallest angular "
            f"speed "
            f"after the touchdown from {both[0]:.4f} to {both[1]:.4f} rad/s on the published lines", "sections 2.2 and 2.3",
        ),
        statement(
            "friction_sign", "appendix: acceleration of the turning wheel if M_f is the z component of M, and as the flight test "
            "has it",
            -slowing, c2 * (wheel.speed_rad_s - c3), "rad/s2", 1e-2,
            "M acts on the body and -M on the wheel, so the first sentence would speed the wheel up; the later equation has the "
            "right "
            "sign and is what is used. c_2, too, must be counted from the joint centre of mass, which Fig. 2 does not do; eq. "
            "for F "
            "lacks a bracket", "appendix",
        ),
        statement(
            "spin_down_start", "wheel speed at the start of the fitted record, c1 + c3, beside the nominal speed",
            published["wheel_speed"], c1 + c3, "rad/s", None, "the flight test began a little faster; no contradiction",
            "section 2.2, Fig. 5",
        ),
    ]  # fmt: skip


def precession_rows(case: Case, found: Lines) -> list[Row]:
    """The swing of the z axis and the energy at the touchdown (section 3.2)."""
    published = {key: figure.value for key, figure in case.published.items()}
    height = 2 * np.degrees(np.minimum(found.nutation, found.sun_angle))
    swing = 2 * np.degrees(found.nutation)
    low, high = published["sun_height_range"]
    mass, speed = case.vehicle.require_mass(), published["trajectory_speed_after_touchdown"]
    left, before = mass * speed**2 / 2, published["touchdown_energy_before"]
    return [
        statement(
            "axis_swing", "swing of the z axis on L1 to L4, taken to be the range of the Sun's height", [high - low] * 4,
            swing.tolist(), "deg", 10.0,
            f"twice the angle between H and z at the printed points, for a symmetric lander; the Sun's height ranges over "
            f"{', '.join(f'{x:.0f}' for x in height)}, twice the smaller of that angle and the Sun's from H. Changes: on L1 and L2 "
            "that the legs pointed to the ground does not follow", "section 3.2",
        ),
        statement(
            "energy_absorbed", "largest part of the kinetic energy that the damper can have taken at the first touchdown",
            published["energy_absorbed"], 100 * (1 - left / before), "%", 0.1,
            f"{speed:.3f} m/s after it (trajectory kernel) are {left:.2f} J of {before:g} J (Roll and Witte, 2016), before "
            f"counting "
            "rotation; the paper has more than 90 %. "
            f"{published['touchdown_energy_after']:g} J, as quoted in 2016, would be 90 % exactly", "section 3.2",
        ),
    ]  # fmt: skip


def collision_rows(case: Case, found: Lines) -> list[Row]:
    """Speeds and rates at the collision (sections 3.3 and 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    slow, fast, rate = published["landing_speed"], published["collision_speed"], published["rate_at_collision"]
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    turn = 2 * np.pi / published["romap_period_before"]
    means = {rule: float(values.mean()) for rule, values in found.at_collision.items()}
    wheel = case.vehicle.wheels[0]
    passed = wheel.inertia_kg_m2 * wheel.speed_rad_s / case.vehicle.require_inertia()[2, 2]
    descent = published["descent_rate_cubic"][0]
    return [
        statement(
            "speed_twice", "speed of the centre of mass before the second touchdown, and at the collision in section 3.3", slow,
            fast,
            "m/s", 0.01,
            f"one motion, two speeds. Trajectory kernel, comet-fixed: {published['kernel_speed_before']:.4f} before and "
            f"{published['kernel_speed_after']:.4f} m/s after the collision, {published['kernel_speed_before_landing']:.4f} m/s "
            f"at the "
            f"second touchdown. Changes: the speed of a leg's end from {slow + longest * rate:.3f} to "
            f"{fast + longest * rate:.3f} m/s, "
            f"{fast + longest * turn:.3f} with a turn in 13 s as well", "sections 3.3 and 4",
        ),
        statement(
            "speed_at_collision", "speed of the centre of mass at the collision", fast, published["kernel_speed_before"], "m/s",
            0.01,
            f"ours: trajectory kernel; a blow that changed the velocity by {published['kernel_velocity_change']:.4f} m/s. "
            f"Changes: the "
            "impulse and all rates after the collision", "section 3.3",
        ),
        statement(
            "path", "path from the first touchdown to the collision", published["path_length"], published["kernel_path_length"],
            "m",
            20.0, "ours: trajectory kernel, comet-fixed; the published one is along the surface", "section 3.3",
        ),
        statement(
            "rate_at_collision", "angular speed at the collision, mean over motions that begin on the published lines", rate,
            list(means.values()), "rad/s", 0.05,
            "; ".join(means) + f". 0.33 is nearly what the wheel alone passes to a body at rest, {found.still:.3f} (simulated) or "
            f"{descent:.3f} + {passed:.3f} rad/s. The magnetometer's 13 s would be {turn:.3f} rad/s. Changes: the speed of a "
            f"leg's end",
            "section 4",
        ),
    ]  # fmt: skip


def rest_rows(case: Case) -> list[Row]:
    """Whether switching the wheel off at rest would have moved the lander (section 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    rest = next(entry for entry in settling(case.vehicle, published["gravity"]) if entry["way"] == "off")
    return [
        statement(
            "final_torque", "friction torque when the wheel is switched off at rest, by the paper's own law",
            published["final_friction_torque"], rest["torque_N_m"], "N m", 0.5,
            f"5 is the wheel's angular momentum, {rest['momentum_N_m_s']:.2f} N m s. Changes the argument, next row", "section 4",
        ),
        statement(
            "final_force", "force at each leg that balances that torque", published["final_foot_force"], rest["foot_force_N"], "N",
            0.1,
            f"a weight of {rest['weight_per_foot_N']:.3f} N per leg holds the lander with a coefficient of friction of "
            f"{rest['friction_coefficient']:.3f}: that the lander would have slid does not follow, and with it the advantage of "
            "switching off at the touchdown", "section 4",
        ),
        statement(
            "round_mass", "mass in the estimate of the weight, beside Table 2", published["round_mass"],
            case.vehicle.require_mass(), "kg", 5.0, "rounded; harmless", "section 4 and Table 2",
        ),
    ]  # fmt: skip
