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
from sunspin.philae.row import Row, statement
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
            point_at(point, along, 2, np.linspace(*rb.LINE_RANGE, LINE_POINTS)) for point, along in published
        ],
        "evenly along the lines within the scanned box": [_within(point, along, box) for point, along in published],
    }
    unit = np.array([_momentum_direction(case, point) for point, _ in published])
    along_z = [[_momentum_direction(case, start)[2] for start in starts] for starts in next(iter(rules.values()))]
    return Lines(
        {rule: _speeds(case, np.concatenate(starts)) for rule, starts in rules.items()}, float(_speeds(case, np.zeros((1, 3)))[0]),
        np.arccos(unit[:, 2]), np.arccos(unit @ (rb.first_sun(case) / np.linalg.norm(rb.first_sun(case)))),
        np.arccos(np.array(along_z)),
    )  # fmt: skip


def _within(point: np.ndarray, along: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Points (n, 3) evenly along the part of a line inside a box (3, 2)."""
    ends = np.sort((box - point[:, None]) / along[:, None], axis=1)
    return point + np.linspace(ends[:, 0].max(), ends[:, 1].min(), LINE_POINTS)[:, None] * along


def _momentum_direction(case: Case, omega: np.ndarray) -> np.ndarray:
    momentum = g.total_momentum(case.vehicle, omega[None], np.array([rb.nominal_speed(case.vehicle)]))[0]
    return momentum / np.linalg.norm(momentum)


def _speeds(case: Case, starts: np.ndarray) -> np.ndarray:
    vehicle, end = case.vehicle, rb.window_s(case)
    return np.array([
        np.linalg.norm(propagate(vehicle, omega, rb.first_sun(case), rb.nominal_speed(vehicle), [0.0, end], rtol=1e-8)
                       ["omega_B"].values[-1]) for omega in starts
    ])  # fmt: skip


def model_rows(case: Case) -> list[Row]:
    """Speed of the wheel, sign of its friction (section 2.2 and appendix)."""
    wheel, published = case.vehicle.wheels[0], {key: figure.value for key, figure in case.published.items()}
    _, c2, c3 = published["spin_down_coefficients"]
    friction, speed, since = wheel.friction, wheel.speed_rad_s, rb.after_touchdown_s(case)
    slowing = -(friction.coulomb_N_m + friction.viscous_N_m_s * speed) / wheel.inertia_kg_m2
    coasted = rb.speed_at_first_sample(case)
    both = [rb.smallest_on_lines(case, rb.published_lines(case), start) for start in (speed, coasted)]
    before = _coasted(case, speed, -since)
    losses = [speed - _coasted(case, speed, since + shift * SAMPLE_TIME_UNCERTAINTY_S) for shift in (-1, 1)]
    stop = spin_down_time(friction, wheel.inertia_kg_m2, before) / 60
    return [
        statement(
            "wheel_speed_twice", "wheel speed at the first sample after the touchdown, if it was switched off there at 865 rad/s",
            published["wheel_speed"], coasted, "rad/s", 5.0, "sections 2.2 and 2.3, Table 1",
            sentence="the wheel turned at about 865 rad/s in the descent and was switched off at the touchdown; 865 rad/s is "
            "also the \"estimated value at first data point shortly after TD1\".",
            other_reading=f"The first sample's time is known to half a minute, so friction took {losses[0]:.0f} to "
            f"{losses[1]:.0f} rad/s. If 865 rad/s holds at the first sample, the wheel had {before:.0f} rad/s at the touchdown "
            f"and stopped {stop:.1f} min after it, where the paper has {published['wheel_stop']:g} min.",
            changes=f"The smallest angular speed at the touchdown, for the published lines, is {both[1]:.4f} instead of "
            f"{both[0]:.4f} rad/s.",
            note=f"{since:.0f} s of friction.",
        ),
        statement(
            "friction_sign", "acceleration of the wheel at 865 rad/s: with M_f as the z component of M, and from the flight test",
            -slowing, c2 * (speed - c3), "rad/s2", 1e-2, "appendix", weak=True,
            sentence="\"the z component of M is identical to the moment M_f associated with friction\", where M acts on the "
            "lander body; a later equation has M_f as the z component of -M.",
            other_reading="Identical may mean equal in size. The final equations have the right sign.",
            changes="Nothing in the results. Who follows the first sentence gets a wheel that speeds up.",
            note="Other slips of the derivation are harmless too: the vector c_2 must begin at the joint centre of mass, while "
            "Fig. 2 has a vector c_0 to it; the equation for F lacks a bracket; two steps treat the wheel as if its inertia were "
            "the same about every axis, and the two errors cancel.",
        ),
    ]  # fmt: skip


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
        statement(
            "axis_swing", "swing of the lander's z axis on L1 to L4, taken to be the range of the Sun's height", [high - low] * 4,
            swing.tolist(), "deg", 10.0, "section 3.2",
            sentence=f"the Sun's height ranged over ({low:g}...{high:g}) deg, and \"the size of this interval corresponds to the "
            "amplitude of the oscillation of the z axis of the lander in global frame\".",
            other_reading=f"\"Corresponds\" may mean roughly equal. That holds on L3 and L4 ({narrow.min():.0f} to "
            f"{narrow.max():.0f} deg) but not on L1 and L2 ({wide.min():.0f} to {wide.max():.0f} deg), which the paper keeps. The "
            "Sun's height shows the swing only where the Sun is farther from the angular momentum H than z is.",
            changes="On L1 and L2 it does not follow that the legs pointed to the ground until the collision.",
            note="Twice the angle between H and z at the printed points, for a symmetric lander. The Sun's height ranges over "
            f"{', '.join(f'{x:.0f}' for x in height)} deg there: twice the smaller of that angle and the Sun's angle from H.",
        ),
        statement(
            "energy_absorbed", "largest part of the kinetic energy that the damper can have absorbed at the first touchdown",
            published["energy_absorbed"], 100 * (1 - left / before), "%", 0.1, "section 3.2", weak=True,
            sentence=f"\"the dampers in the legs absorbed over {published['energy_absorbed']:g}% of the kinetic energy\".",
            other_reading=f"{before:g} J may be rounded to tens: of {ENERGY_AT_MOST_J:g} J the part is "
            f"{100 * (1 - left / ENERGY_AT_MOST_J):.1f} %. With {published['touchdown_energy_after']:g} J left, as published in "
            "2016, it is 90 % exactly.",
            changes="Nothing: no result depends on it.",
            note=f"{speed:.3f} m/s after the touchdown (trajectory kernel) are {left:.2f} J of {before:g} J (Roll and Witte, "
            "2016), and the lander turned as well.",
        ),
    ]  # fmt: skip


def collision_rows(case: Case, found: Lines) -> list[Row]:
    """Speeds and rates at the collision (sections 3.3 and 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    slow, fast, rate = published["landing_speed"], published["collision_speed"], published["rate_at_collision"]
    kernel, path, straight = (
        published["kernel_speed_before"], published["kernel_path_length"], published["trajectory_straight_path"]
    )  # fmt: skip
    longest = max(float(np.linalg.norm(leg.tip_B_m)) for leg in case.vehicle.legs)
    turn = 2 * np.pi / published["romap_period_before"]
    rates = found.at_collision
    means = {rule: float(values.mean()) for rule, values in rates.items()}
    slower = [100 * float(np.mean(values < rate)) for values in rates.values()]
    largest = max(float(values.max()) for values in rates.values())
    wheel = case.vehicle.wheels[0]
    passed = wheel.inertia_kg_m2 * wheel.speed_rad_s / case.vehicle.require_inertia()[2, 2]
    descent = published["descent_rate_cubic"][0]
    return [
        statement(
            "speed_twice", "speed of the centre of mass at the collision in sections 4 and 3.3, and the path flown until then",
            [slow, fast, published["path_length"]], [kernel, kernel, path], "m/s, m/s, m", [0.01, 0.01, 20.0], "sections 3.3 and 4",
            sentence=f"in section 4 the translational velocity at the collision \"was only\" about {slow} m/s; in section 3.3 it "
            f"is {fast} m/s, from about {published['path_length']:g} m along the surface in 46 min.",
            other_reading=f"{slow} is no misprint of 0.2, as only {slow} gives the printed {published['leg_tip_speed']} m/s of a "
            f"leg's end, and the kernel has no such speed before the second touchdown. The {published['path_length']:g} m are an "
            f"early figure of another source, and the paper calls {fast} m/s an estimate; but no path along the surface is "
            f"shorter than the straight line of {straight:.0f} m.",
            changes=f"A leg's end reaches {fast + longest * rate:.3f} m/s with the speed of section 3.3 and "
            f"{kernel + longest * rate:.3f} m/s with that of the kernel instead of {slow + longest * rate:.3f} m/s "
            f"({fast + longest * turn:.3f} m/s with section 3.3 and a turn in 13 s). The impulse grows with the speed.",
            note=f"Ours: trajectory kernel, comet-fixed; {published['kernel_speed_after']:.4f} m/s after the collision and "
            f"{published['kernel_speed_before_landing']:.4f} m/s before the second touchdown.",
        ),
        statement(
            "rate_at_collision", "angular speed at the collision, mean over motions that begin on the published lines",
            [rate] * len(means), list(means.values()), "rad/s", 0.1, "section 4",
            sentence=f"leg ends \"could move by as much as\" {published['leg_tip_speed']} m/s, with \"a crude estimation\" of the "
            f"angular speed of {rate} rad/s.",
            other_reading=f"As a crude middle value: {slower[0]:.0f} and {slower[1]:.0f} % of the motions turn more slowly. But "
            f"\"as much as\" names a largest value, and the motions reach {largest:.2f} rad/s. {rate} is nearly what a lander "
            f"gets from the wheel alone: {found.still:.3f} rad/s from rest (simulated), {descent:.3f} + {passed:.3f} rad/s if it "
            "turned as in the descent.",
            changes=f"The rotation moves leg ends {min(means.values()) / rate:.1f} to {max(means.values()) / rate:.1f} times as "
            f"fast, on average. The magnetometer's 13 s would be {turn:.3f} rad/s.",
            note=f"Motions that begin {'; '.join(means)}.",
        ),
    ]  # fmt: skip


def rest_rows(case: Case) -> list[Row]:
    """Whether switching the wheel off at rest would have moved the lander (section 4)."""
    published = {key: figure.value for key, figure in case.published.items()}
    rest = next(entry for entry in settling(case.vehicle, published["gravity"]) if entry["way"] == "off")
    torque, force = published["final_friction_torque"], published["final_foot_force"]
    return [
        statement(
            "final_torque", "friction torque when the wheel is switched off at rest, and the force at each leg that balances it",
            [torque, force], [rest["torque_N_m"], rest["foot_force_N"]], "N m, N", [0.5, 0.1], "section 4",
            sentence=f"the friction model \"predicts a frictional torque of order\" {torque:g} N m, which takes {force:g} N at "
            "each leg, more than friction on the ground can hold.",
            other_reading=f"{torque:g} is the wheel's angular momentum, {rest['momentum_N_m_s']:.2f} N m s, and would be the "
            "torque of a brake that stops it in one second. But the sentence refers to bearing friction, which takes 42 min.",
            changes=f"A coefficient of friction of {rest['friction_coefficient']:.3f} holds the lander, as each leg carries "
            f"{rest['weight_per_foot_N']:.3f} N. It does not follow that the lander would slide, so this argument for switching "
            "the wheel off at the touchdown fails.",
        ),
    ]  # fmt: skip
