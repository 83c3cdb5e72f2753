"""How many steps each row needs for the accuracy asked for.

The step of a row is a function of that row alone, taken from a fixed ladder, so that rows of one rung can share a block.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from sunspin.base.errors import MotionError
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics import wheel_modes as m
from sunspin.dynamics.ensemble import principal
from sunspin.dynamics.ensemble.lanes import NODES_PER_STEP
from sunspin.dynamics.ensemble.rows import Rows
from sunspin.dynamics.ensemble.series_lanes import ORDER
from sunspin.dynamics.ensemble.split_lanes import MAX_MAIN_ANGLE, MAX_SIDE_ANGLE
from sunspin.dynamics.ensemble.tolerance import MIN_WAYS, NODE_ANGLE, Accuracy
from sunspin.dynamics.friction import spin_down_speed
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.dynamics.torques.acting import spun
from sunspin.solve.linear import extreme_eigenvalues, symmetric_inverse, symmetric_product
from sunspin.vehicle import Vehicle

MAX_STEPS = 2_000_000
"""Steps of one row, some seconds of computing and a thousand times what 45 min of tumbling take: more is a slip of units."""

LADDER = 2.0**0.125
"""Ratio of neighbouring step counts: at most 9 % more steps than asked for, few enough rungs to fill blocks."""

SERIES_GROWTH = 2.1
MAX_SLOW_ANGLE = 0.8
"""rad turned per step, less the common share: beyond it the error law no longer holds."""

CONVERGENCE = 1.2
"""rad that H may turn in body axes because of unequal moments before its series no longer converges: such motions are elliptic
functions of time, with poles off the real axis."""

CARRIED_ANGLE = 1.3
"""rad that a torque which stands in space turns in body axes per step at most: it errs by 1e-7 of itself in a thousand steps."""

SAFETY = 0.003
"""Share of the error that the laws may use up: motions near an unstable spin multiply what is left out."""

SEGMENTS = 8
"""Parts of a run by series with steps of their own: a wheel that slows down lets them grow."""

PROFILES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)
"""Rates at the slow end of a run, in units of that at the fast one, to which a row's is rounded up."""


@dataclass(frozen=True)
class Scales:
    """How large and how fast everything is in the motions that begin in these rows (n), with one command per wheel."""

    vehicle: Vehicle
    rows: Rows
    commands: Sequence[str]
    acting: Acting = NOTHING

    @cached_property
    def inertias(self) -> np.ndarray:
        """A (n_set, n or 1, 3, 3) for every set of free wheels."""
        return principal.free_inertias(self.rows.bodies_of(self.vehicle))

    @cached_property
    def inverses(self) -> np.ndarray:
        """Their inverses (n_set, n or 1, 6), as `symmetric_inverse` gives them; the first is the whole body's: no wheel is free."""
        return symmetric_inverse(self.inertias)

    @cached_property
    def momentum(self) -> np.ndarray:
        """H (n, 3)."""
        return g.total_momentum(
            self.rows.bodies_of(self.vehicle), self.rows.omega_B, self.rows.wheel_speed_rad_s
        )

    @cached_property
    def momentum_size(self) -> np.ndarray:
        """|H| (n)."""
        return np.linalg.norm(self.momentum, axis=1)

    @cached_property
    def turning(self) -> tuple[np.ndarray, np.ndarray]:
        """How fast each row turns (n), rad/s: at the beginning, and once the wheels' momentum is the body's."""
        later = symmetric_product(self.inverses[0], self.momentum)
        return np.linalg.norm(self.rows.omega_B, axis=1), np.linalg.norm(later, axis=1)

    @property
    def rate(self) -> np.ndarray:
        """The larger of the rates of turning (n), rad/s."""
        return np.maximum(*self.turning)

    def uneven(self) -> np.ndarray:
        """A bound (n), rad/s, of how fast H turns in body axes because the moments of inertia differ."""
        slow, fast = self.inverse_moments
        return 0.5 * (fast - slow).max(axis=0) * self.momentum_size

    @cached_property
    def inverse_moments(self) -> tuple[np.ndarray, np.ndarray]:
        """Smallest and largest of the inverse moments of inertia (mode; n or 1), 1/(kg m2)."""
        smallest, largest = extreme_eigenvalues(self.inertias)
        return 1.0 / largest, 1.0 / smallest

    def outside_rate(self, duration_s: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What torques from outside add to :meth:`uneven` and, as then no share of H is taken out, to the rest of the rates; and
        how fast those of them turn that are carried while it is.

        The largest torque, all through the run, makes H so much larger; a body swings under it at the root of its share of the
        inertia; and directions turn. Where an axis stands for H its share is taken out, but not that of what H is away from it.
        """
        still = np.zeros(len(self.rows))
        if not self.acting.torques:
            return still, still, still
        bodies = self.rows.bodies_of(self.vehicle)
        own = self.acting.own(bodies)
        torque = self.acting.largest(self.acting.values(bodies)) + np.linalg.norm(own, axis=-1)
        slow, fast = self.inverse_moments
        gained = torque * abs(duration_s)
        carried = self.rows.carried(self.acting, own).reshape(len(self.rows), -1, 2, 3)[:, :, 1]
        turning = np.linalg.norm(carried, axis=-1).max(axis=1, initial=0.0)
        swing = np.sqrt(torque * fast.max(axis=0))
        common = 0.5 * (slow + fast).max(axis=0)
        whole, pushed = (
            common * (self.momentum_size + gained),
            0.5 * (fast - slow).max(axis=0) * gained + swing,
        )
        return (
            (pushed, common * gained + still, whole)
            if spun(self.acting.torques)
            else (pushed, whole + turning, still)
        )

    @cached_property
    def responses(self) -> list[np.ndarray]:
        """What a unit of each wheel's momentum makes of omega at most (n_wheel; n or 1), 1/(kg m2)."""
        axes = self.rows.bodies_of(self.vehicle).axes_B
        return [
            np.linalg.norm(symmetric_product(self.inverses, axis), axis=-1).max(axis=0)
            for axis in axes
        ]

    def wheel_rate(self, t: float) -> np.ndarray:
        """A bound (n), rad/s, of what the wheels' momenta make of omega at the time t (s)."""
        bodies, rate = self.rows.bodies_of(self.vehicle), np.zeros(len(self.rows))
        for i, (wheel, command) in enumerate(zip(self.vehicle.wheels, self.commands, strict=True)):
            inertia, speed = (
                bodies.wheel_inertia_kg_m2[:, i],
                np.abs(self.rows.wheel_speed_rad_s[:, i]),
            )
            if command != "hold":
                dry = m.friction_limit(wheel, command, bodies.coulomb_N_m[:, i])
                speed = spin_down_speed(dry, bodies.viscous_N_m_s[:, i], inertia, speed, t)
            rate += self.responses[i] * inertia * (speed + self.rate)
        return rate


def series_steps(
    scales: Scales, duration_s: float, accuracy: Accuracy
) -> tuple[np.ndarray, np.ndarray]:
    """Number of steps (n) by Taylor series if all were as short as the shortest, and ratio (n) of the slow end to the fast.

    At the rate s of omega less its common share, coefficients of order k fall like (SERIES_GROWTH s h)^k / k!, and at the rate
    u of unevenness like (u h / CONVERGENCE)^k; the error left out adds up over all steps. Between its ends s is taken to
    change in proportion to time.
    """
    pushed, more, carried = scales.outside_rate(duration_s)
    uneven = np.maximum(scales.uneven() + pushed, 1e-12)
    ends = [uneven + scales.wheel_rate(t) + more for t in (0.0, duration_s)]
    allowed = SAFETY * accuracy.direction_error / (0.5 * (ends[0] + ends[1]) * abs(duration_s))
    angle = (allowed * math.factorial(ORDER + 1)) ** (1 / ORDER) / SERIES_GROWTH ** (1 + 1 / ORDER)
    angle = np.minimum(angle, MAX_SLOW_ANGLE)
    shortest = uneven / (CONVERGENCE * np.minimum(allowed ** (1 / ORDER), 0.35))
    shortest = np.maximum(shortest, carried / CARRIED_ANGLE)
    fast, slow = (
        np.maximum(choose(*ends) / angle, shortest) for choose in (np.maximum, np.minimum)
    )
    return fast * abs(duration_s), slow / fast


SPLIT_CONSTANT = 7e-4
"""Measured on Philae, where the wheel's part of the law counts, and on random bodies of very unequal moments."""


def split_steps(scales: Scales, duration_s: float, accuracy: Accuracy) -> np.ndarray:
    """Number of steps (n) by splitting, not yet on the ladder.

    With m and s the rates of the main part and of the others, and m' and s' those without wheels, the phase errs by about
    SPLIT_CONSTANT (s' (m' + s')^4 + s^2 m^3) h^4 T: what the wheels add is constant in body axes, and errors of first order
    in s average out over its turns.
    """
    vehicle, rows = scales.vehicle, scales.rows
    bodies = rows.bodies_of(vehicle)
    axial, frame = (
        g.axial_momenta(bodies, rows.omega_B, rows.wheel_speed_rad_s),
        principal.frames(vehicle, bodies),
    )
    main, *side = principal.part_rates(bodies, frame, scales.momentum_size, axial)
    plain_main, *plain_side = principal.part_rates(bodies, frame, scales.momentum_size, 0.0 * axial)
    others, plain = np.sum(side, axis=0), np.sum(plain_side, axis=0)
    law = (plain * (plain_main + plain) ** 4 + others**2 * main**3).max(axis=0)
    duration = abs(duration_s)
    steps = duration * (SPLIT_CONSTANT * law * duration / accuracy.direction_error) ** 0.25
    steps = np.maximum(steps, main.max(axis=0) * duration / MAX_MAIN_ANGLE)
    return np.maximum(steps, np.max(side, axis=(0, 1)) * duration / MAX_SIDE_ANGLE)


UNEVEN = 3e-5
"""Where the smallest speed squared of H in body axes is below this share of the largest, the motion has come near an unstable
spin: what follows hangs on the last digits, and the row is run again by series."""


@dataclass(frozen=True)
class Plan:
    """How each row (n) is run: by "series" or "split", its number of steps were all as short as the shortest, its profile."""

    method: np.ndarray
    steps: np.ndarray
    profile: np.ndarray

    def groups(self) -> Iterator[tuple[np.ndarray, str, int, float]]:
        """Rows that can share a block: their numbers, method, steps, and profile as a ratio."""
        keys = np.stack([self.method == "split", self.steps, self.profile])
        order = np.lexsort(keys[::-1])
        edges = np.flatnonzero(np.any(np.diff(keys[:, order], axis=1) != 0, axis=0)) + 1
        for index in np.split(order, edges):
            if len(index):
                first = index[0]
                yield (
                    index,
                    str(self.method[first]),
                    int(self.steps[first]),
                    PROFILES[self.profile[first]],
                )


def plan(
    scales: Scales,
    duration_s: float,
    accuracy: Accuracy,
    histogram: bool,
    min_steps: int,
    most: float = MAX_STEPS,
) -> Plan:
    """The plan of each row, a function of the row alone; `MotionError` where a row needs more than `most` steps."""
    least = np.full(len(scales.rows), float(max(min_steps, 1)))
    if histogram:
        typical = 0.5 * sum(scales.turning)
        ways = np.maximum(typical * abs(duration_s), MIN_WAYS * NODE_ANGLE) / accuracy.node_angle
        least = np.maximum(least, ways / NODES_PER_STEP)
    wanted, ratio = series_steps(scales, duration_s, accuracy)
    ratio = np.maximum(ratio, np.minimum(least / wanted, 1.0))
    profile = len(PROFILES) - np.searchsorted(PROFILES[::-1], ratio * (1 - 1e-12), side="left") - 1
    steps = on_ladder(np.maximum(wanted, least), scales.rate, duration_s, most)
    method = np.full(len(scales.rows), "series")
    if accuracy.distribution_only and histogram and not scales.acting.torques:
        split = on_ladder(
            np.maximum(split_steps(scales, duration_s, accuracy), least),
            scales.rate,
            duration_s,
            most,
        )
        use = split < SPLIT_ADVANTAGE * steps
        return Plan(
            np.where(use, "split", method), np.where(use, split, steps), np.where(use, 0, profile)
        )
    return Plan(method, steps, profile)


SPLIT_ADVANTAGE = 5.0
"""How many steps by splitting cost as much as one of the series."""


def segments(
    ends: np.ndarray, steps: int, ratio: float, parts: int, growing: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps and their lengths (s) in each segment of a run, and which output (-1: none) is due at its end.

    Segments end at the outputs `ends` and where the run is cut into equal parts. Steps are as short as in a run of `steps` of
    equal length at the fast end, which is the first (or, `growing`, the last), and longer by 1 / ratio at the other.
    """
    duration = ends[-1]
    cuts = np.union1d(
        np.abs(ends), np.abs(duration) * np.arange(1, parts + 1) / parts if ratio < 1 else []
    )
    output = np.full(len(cuts), -1)
    output[np.searchsorted(cuts, np.abs(ends))] = np.arange(len(ends))
    gaps = np.diff(cuts, prepend=0.0)
    x = (cuts if growing else cuts - gaps) / (abs(duration) or 1.0)
    share = 1.0 - (1.0 - ratio) * (1.0 - x if growing else x)
    counts = np.maximum(
        np.ceil(steps * share * gaps / (abs(duration) or 1.0) - 1e-9), gaps > 0
    ).astype(np.int64)
    return counts, np.copysign(gaps, duration) / np.maximum(counts, 1), output


def on_ladder(
    wanted: np.ndarray, rate: np.ndarray, duration_s: float, most: float = MAX_STEPS
) -> np.ndarray:
    """Step counts rounded up to the ladder; `MotionError` where they are beyond all measure, more than `most`."""
    steps = np.ceil(LADDER ** np.ceil(np.log(wanted) / np.log(LADDER) - 1e-9))
    if steps.max(initial=0) > most:
        raise MotionError(
            f"a run of {duration_s:g} s at {rate.max():.3g} rad/s ({np.degrees(rate.max()):.3g} deg/s) needs "
            f"{steps.max():.3g} steps",
            do="shorten the window, or check the unit of the rates: rad/s, not deg/s",
        )
    steps = np.where(np.isnan(steps), 1.0, steps)  # what begins with no number ends with none
    return np.minimum(steps, 2.0 * MAX_STEPS).astype(np.int64)
