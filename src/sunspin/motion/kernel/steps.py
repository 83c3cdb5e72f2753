"""Initial states, and how many steps each needs for the accuracy asked for.

The step of a row is a function of that row alone, taken from a fixed ladder, so that rows of one rung can share a block.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from sunspin.errors import InputError, MotionError, sentence
from sunspin.motion import gyrostat as g
from sunspin.motion import modes as m
from sunspin.motion.friction import spin_down_speed
from sunspin.motion.kernel import principal
from sunspin.motion.kernel.lanes import NODES_PER_STEP
from sunspin.motion.kernel.series_lanes import ORDER
from sunspin.motion.kernel.split_lanes import MAX_MAIN_ANGLE, MAX_SIDE_ANGLE
from sunspin.vehicle import Vehicle

MAX_STEPS = 10**8
LADDER = 2.0**0.125
"""Ratio of neighbouring step counts: at most 9 % more steps than asked for, few enough rungs to fill blocks."""

@dataclass(frozen=True)
class Rows:
    """Initial states of n trajectories: omega_B (n, 3) rad/s, sun_B (n, 3), wheel speeds (n, n_wheel) rad/s."""

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray

    def __len__(self) -> int:
        return len(self.omega_B)

    def take(self, index: np.ndarray) -> Rows:
        return Rows(self.omega_B[index], self.sun_B[index], self.wheel_speed_rad_s[index])


def rates_of_turning(vehicle: Vehicle, rows: Rows) -> tuple[np.ndarray, np.ndarray]:
    """How fast each row turns (n), rad/s: at the beginning, and once the wheels' momentum is the body's."""
    momentum = g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    later = np.linalg.solve(vehicle.require_inertia(), momentum.T).T
    return np.linalg.norm(rows.omega_B, axis=1), np.linalg.norm(later, axis=1)


def rate_scale(vehicle: Vehicle, rows: Rows) -> np.ndarray:
    """The larger of the rates of turning (n), rad/s."""
    return np.maximum(*rates_of_turning(vehicle, rows))


def free_inertias(vehicle: Vehicle) -> list[np.ndarray]:
    """The inertia (3, 3) for every set of free wheels (bit i: wheel i is free)."""
    n = len(vehicle.wheels)
    return [g.free_inertia(vehicle, [bool(bits >> i & 1) for i in range(n)]) for bits in range(2**n)]


def common_spin(inverse: Sequence[float]) -> float:
    """The share of H in omega, 1/(kg m2), without which the rest is slowest: half way between the extreme 1 / moments.

    `inverse` is A^-1 as (xx, xy, xz, yy, yz, zz).
    """
    xx, xy, xz, yy, yz, zz = inverse
    extreme = np.linalg.eigvalsh(np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]))[[0, -1]]
    return float(extreme.mean())


# ---- accuracy --------------------------------------------------------------------------------------------------------------

DIRECTION_ERROR = 1e-5
"""Default error of the Sun's direction at the end of a run, rad."""

SMALLEST_DIRECTION_ERROR = 1e-11
"""What double precision can promise over some thousand radians."""

EMD_ERROR = 1e-3
SMALLEST_EMD_ERROR = 2e-4
"""Below it the histogram's bins, and the two points that stand for a way, set a limit."""

NODE_ANGLE = 0.9
"""rad turned between nodes of the histogram where an EMD may err by EMD_ERROR; the error goes with its third power."""

PHASE_ERROR = 0.1
"""Error of the direction at the end (rad) where an EMD may err by EMD_ERROR: the same path, run through early or late."""

MIN_WAYS = 1024
"""Ways between nodes in a run: the distribution of a slow motion would be coarse otherwise."""


@dataclass(frozen=True)
class Accuracy:
    """What a run must reach: direction at the end (rad), longest way between nodes (rad), and whether only the EMD counts."""

    direction_error: float
    node_angle: float
    distribution_only: bool

    @classmethod
    def of_direction(cls, error: float | None) -> Accuracy:
        """For an error (rad) of the Sun's direction at the end; a histogram is then as good as EMD_ERROR."""
        error = DIRECTION_ERROR if error is None else error
        return cls(_checked("direction_error", error, SMALLEST_DIRECTION_ERROR), NODE_ANGLE, False)

    @classmethod
    def of_emd(cls, error: float) -> Accuracy:
        """For an error of the EMD."""
        share = _checked("emd_error", error, SMALLEST_EMD_ERROR) / EMD_ERROR
        return cls(PHASE_ERROR * share, NODE_ANGLE * min(1.0, share) ** (1 / 3), share >= 1.0)


    def with_true_phase(self) -> Accuracy:
        """The same with the direction as good as it must be for the distribution of a motion that hangs on it."""
        return replace(self, direction_error=0.1 * self.direction_error, distribution_only=False)


def accuracy(direction_error: float | None, emd_error: float | None) -> Accuracy:
    """What is asked for, checked: one of the two errors, or none for the default of the direction's."""
    if direction_error is not None and emd_error is not None:
        raise InputError(sentence("ask for an error of the direction or of the EMD", got="both", do="give one of them"))
    return Accuracy.of_direction(direction_error) if emd_error is None else Accuracy.of_emd(emd_error)


def _checked(name: str, error: float, smallest: float) -> float:
    if not smallest <= error < np.inf:
        raise InputError(sentence(f"{name} must be at least {smallest:g}", got=error, do="ask for less"))
    return float(error)


SERIES_GROWTH = 2.1
MAX_SLOW_ANGLE = 0.8
"""rad turned per step, less the common share: beyond it the error law no longer holds."""

CONVERGENCE = 1.2
"""rad that H may turn in body axes because of unequal moments before its series no longer converges: such motions are elliptic
functions of time, with poles off the real axis."""

SAFETY = 0.003
"""Share of the error that the laws may use up: motions near an unstable spin multiply what is left out."""

SEGMENTS = 8
"""Parts of a run by series with steps of their own: a wheel that slows down lets them grow."""

PROFILES = (1.0, 0.75, 0.5, 0.35, 0.25, 0.15)
"""Rates at the slow end of a run, in units of that at the fast one, to which a row's is rounded up."""


def uneven_rate(vehicle: Vehicle, rows: Rows) -> np.ndarray:
    """A bound (n), rad/s, of how fast H turns in body axes because the moments of inertia differ."""
    spread = max(np.ptp(np.linalg.eigvalsh(np.linalg.inv(inertia))) for inertia in free_inertias(vehicle))
    momentum = g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    return 0.5 * spread * np.linalg.norm(momentum, axis=1)


def wheel_rate(vehicle: Vehicle, rows: Rows, commands: Sequence[str], t: float) -> np.ndarray:
    """A bound (n), rad/s, of what the wheels' momenta make of omega at the time t (s)."""
    rate, body = np.zeros(len(rows)), rate_scale(vehicle, rows)
    inertias = free_inertias(vehicle)
    for i, (wheel, command) in enumerate(zip(vehicle.wheels, commands, strict=True)):
        speed = np.abs(rows.wheel_speed_rad_s[:, i])
        if command != "hold":
            dry = m.friction_limit(wheel, command)
            speed = spin_down_speed(replace(wheel.friction, coulomb_N_m=dry), wheel.inertia_kg_m2, speed, t)
        response = max(np.linalg.norm(np.linalg.solve(inertia, wheel.axis_B)) for inertia in inertias)
        rate += response * wheel.inertia_kg_m2 * (speed + body)
    return rate


def series_steps(
    vehicle: Vehicle, rows: Rows, commands: Sequence[str], duration_s: float, accuracy: Accuracy
) -> tuple[np.ndarray, np.ndarray]:
    """Number of steps (n) by Taylor series if all were as short as the shortest, and ratio (n) of the slow end to the fast.

    At the rate s of omega less its common share, coefficients of order k fall like (SERIES_GROWTH s h)^k / k!, and at the rate
    u of unevenness like (u h / CONVERGENCE)^k; the error left out adds up over all steps. Between its ends s is taken to
    change in proportion to time.
    """
    uneven = np.maximum(uneven_rate(vehicle, rows), 1e-12)
    ends = [uneven + wheel_rate(vehicle, rows, commands, t) for t in (0.0, duration_s)]
    allowed = SAFETY * accuracy.direction_error / (0.5 * (ends[0] + ends[1]) * abs(duration_s))
    angle = (allowed * math.factorial(ORDER + 1)) ** (1 / ORDER) / SERIES_GROWTH ** (1 + 1 / ORDER)
    angle = np.minimum(angle, MAX_SLOW_ANGLE)
    shortest = uneven / (CONVERGENCE * np.minimum(allowed ** (1 / ORDER), 0.35))
    fast, slow = (np.maximum(choose(*ends) / angle, shortest) for choose in (np.maximum, np.minimum))
    return fast * abs(duration_s), slow / fast


SPLIT_CONSTANT = 7e-4
"""Measured on Philae, where the wheel's part of the law counts, and on random bodies of very unequal moments."""


def split_steps(vehicle: Vehicle, rows: Rows, duration_s: float, accuracy: Accuracy) -> np.ndarray:
    """Number of steps (n) by splitting, not yet on the ladder.

    With m and s the rates of the main part and of the others, and m' and s' those without wheels, the phase errs by about
    SPLIT_CONSTANT (s' (m' + s')^4 + s^2 m^3) h^4 T: what the wheels add is constant in body axes, and errors of first order
    in s average out over its turns.
    """
    momentum = np.linalg.norm(g.total_momentum(vehicle, rows.omega_B, rows.wheel_speed_rad_s), axis=1)
    axial = g.axial_momenta(vehicle, rows.omega_B, rows.wheel_speed_rad_s)
    main, *side = principal.part_rates(vehicle, momentum, axial)
    plain_main, *plain_side = principal.part_rates(vehicle, momentum, 0.0 * axial)
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
                yield index, str(self.method[first]), int(self.steps[first]), PROFILES[self.profile[first]]


def plan(
    vehicle: Vehicle, rows: Rows, commands: Sequence[str], duration_s: float, accuracy: Accuracy, histogram: bool,
    min_steps: int,
) -> Plan:  # fmt: skip
    """The plan of each row, a function of the row alone."""
    rate = rate_scale(vehicle, rows)
    least = np.full(len(rows), float(max(min_steps, 1)))
    if histogram:
        typical = 0.5 * sum(rates_of_turning(vehicle, rows))
        ways = np.maximum(typical * abs(duration_s), MIN_WAYS * NODE_ANGLE) / accuracy.node_angle
        least = np.maximum(least, ways / NODES_PER_STEP)
    wanted, ratio = series_steps(vehicle, rows, commands, duration_s, accuracy)
    ratio = np.maximum(ratio, np.minimum(least / wanted, 1.0))
    profile = len(PROFILES) - np.searchsorted(PROFILES[::-1], ratio * (1 - 1e-12), side="left") - 1
    steps = on_ladder(np.maximum(wanted, least), rate, duration_s)
    method = np.full(len(rows), "series")
    if accuracy.distribution_only and histogram:
        split = on_ladder(np.maximum(split_steps(vehicle, rows, duration_s, accuracy), least), rate, duration_s)
        use = split < SPLIT_ADVANTAGE * steps
        return Plan(np.where(use, "split", method), np.where(use, split, steps), np.where(use, 0, profile))
    return Plan(method, steps, profile)


SPLIT_ADVANTAGE = 5.0
"""How many steps by splitting cost as much as one of the series."""


def segments(ends: np.ndarray, steps: int, ratio: float, parts: int, growing: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Steps and their lengths (s) in each segment of a run, and which output (-1: none) is due at its end.

    Segments end at the outputs `ends` and where the run is cut into equal parts. Steps are as short as in a run of `steps` of
    equal length at the fast end, which is the first (or, `growing`, the last), and longer by 1 / ratio at the other.
    """
    duration = ends[-1]
    cuts = np.union1d(np.abs(ends), np.abs(duration) * np.arange(1, parts + 1) / parts if ratio < 1 else [])
    output = np.full(len(cuts), -1)
    output[np.searchsorted(cuts, np.abs(ends))] = np.arange(len(ends))
    gaps = np.diff(cuts, prepend=0.0)
    x = (cuts if growing else cuts - gaps) / (abs(duration) or 1.0)
    share = 1.0 - (1.0 - ratio) * (1.0 - x if growing else x)
    counts = np.maximum(np.ceil(steps * share * gaps / (abs(duration) or 1.0) - 1e-9), gaps > 0).astype(np.int64)
    return counts, np.copysign(gaps, duration) / np.maximum(counts, 1), output


def on_ladder(wanted: np.ndarray, rate: np.ndarray, duration_s: float) -> np.ndarray:
    """Step counts rounded up to the ladder; `MotionError` where they are beyond all measure."""
    steps = np.ceil(LADDER ** np.ceil(np.log(wanted) / np.log(LADDER) - 1e-9))
    if steps.max(initial=0) > MAX_STEPS:
        raise MotionError(
            sentence(
                f"a run of {duration_s:g} s at {rate.max():.3g} rad/s needs {steps.max():.3g} steps",
                do="shorten the window, or check the unit of the rates",
            )
        )
    return steps.astype(np.int64)
