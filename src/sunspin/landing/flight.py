"""Propagation of many motions under one schedule of wheel commands, and of directions that are fixed in space.

A schedule is a sequence of (time, command for all wheels). The kernel takes one command at a time, so that a motion is a chain of
runs from switch to switch. Total momentum and the direction to the Sun are two directions fixed in space. Together they determine
the body components of any third one, except across an impact, which changes the momentum.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.dynamics.batch import EMD_ERROR, Rows, run, sun_heights
from sunspin.dynamics.wheel_modes import Schedule, command_at, switch_times
from sunspin.vehicle import Vehicle

DIRECTION_ERROR = 1e-2
"""Accuracy (rad) of each run of a chain, sufficient for statistics over motions that are uncertain by much more."""


@dataclass(frozen=True)
class FlightStates:
    """Motions (n) at instants (n_t), in body axes.

    Total momentum (N m s), direction to the Sun and rate (rad/s) are (n, n_t, 3), wheel speeds (rad/s) are (n, n_t, n_wheel).
    `outcome` (n): code of `sunspin.dynamics.batch.Outcome`, 0 if the motion was computed.
    """

    momentum_B: np.ndarray
    sun_B: np.ndarray
    omega_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    outcome: np.ndarray

    def at(self, i: int) -> Rows:
        """Return the states at instant number `i`, as initial states of another run."""
        return Rows(self.omega_B[:, i], self.sun_B[:, i], self.wheel_speed_rad_s[:, i])


def split_at_switches(
    schedule: Schedule, begin_s: float, end_s: float
) -> list[tuple[float, float, str]]:
    """Return the intervals between the switches of a schedule as (begin, end, command); backward in time if end < begin."""
    edges = [begin_s, *switch_times([schedule], begin_s, end_s), end_s]
    return [(a, b, command_at(schedule, min(a, b))) for a, b in zip(edges, edges[1:], strict=False)]


def fly(
    vehicle: Vehicle, rows: Rows, schedule: Schedule, begin_s: float, times_s: np.ndarray
) -> FlightStates:
    """Propagate motions from `begin_s` and return them at `times_s`.

    A motion that fails in one of the pieces between switches has the outcome of the first failure.

    Parameters
    ----------
    rows : Rows
        Initial states (n) at `begin_s`.
    times_s : (n_t,)
        Either later than `begin_s` and increasing, or earlier and decreasing.
    """
    times = np.asarray(times_s, dtype=np.float64)
    pieces, outcome = [], np.zeros(len(rows), dtype=np.int64)
    for begin, end, command in split_at_switches(schedule, begin_s, times[-1]):
        low, high = sorted((begin, end))
        wanted = times[(times >= low) & (times <= high) & (times != begin)]
        # the state at the switch is needed to go on, also if it is none of `times`
        stops = wanted if len(wanted) and wanted[-1] == end else np.append(wanted, end)
        motion = run(vehicle, rows, stops - begin, command=command, error=DIRECTION_ERROR)
        outcome = np.where(outcome == 0, motion.outcome, outcome)
        values = motion.momentum_B, motion.sun_B, motion.omega_B, motion.wheel_speed_rad_s
        rows = FlightStates(*values, outcome).at(-1)
        pieces.append([value[:, : len(wanted)] for value in values])
    joined = (np.concatenate(parts, axis=1) for parts in zip(*pieces, strict=True))
    return FlightStates(*joined, outcome)


def rz_time_shares(
    vehicle: Vehicle, rows: Rows, schedule: Schedule, begin_s: float, end_s: float, bins: int
) -> tuple[np.ndarray, np.ndarray]:
    """Return the share of the time (n, bins) that r_z spends in each of `bins` equal bins of [-1, 1], and the outcome (n).

    `rows` are the initial states (n) at `begin_s`. The outcome is that of the first failure, as in :func:`fly`.
    """
    shares, outcome = np.zeros((len(rows), bins)), np.zeros(len(rows), dtype=np.int64)
    for begin, end, command in split_at_switches(schedule, begin_s, end_s):
        result = sun_heights(
            vehicle, rows, end - begin, command=command, emd_error=EMD_ERROR, bins=bins
        )
        seconds = result.seconds.astype(np.float64)
        weight = (end - begin) / (end_s - begin_s)
        shares += seconds / seconds.sum(axis=1, keepdims=True) * weight
        outcome = np.where(outcome == 0, result.outcome, outcome)
        if end != end_s:  # the next interval begins with the states at the switch
            rows = fly(vehicle, rows, ((begin, command),), begin, np.array([end])).at(-1)
    return shares, outcome


def _unit(vector: np.ndarray, smallest: float = 0.0) -> np.ndarray:
    """Return the vectors (..., 3) scaled to unit length; NaN for vectors no longer than `smallest`."""
    length = np.linalg.norm(vector, axis=-1, keepdims=True)
    return np.where(length > smallest, vector / np.where(length > smallest, length, 1.0), np.nan)


def transfer_directions(
    direction_B: np.ndarray,
    start: tuple[np.ndarray, np.ndarray],
    end: tuple[np.ndarray, np.ndarray],
) -> np.ndarray:
    """Return the body components, at the end of a motion, of directions that are fixed in space.

    Parameters
    ----------
    direction_B : (n, 3) or (n_direction, n, 3)
        Body components at the start.
    start, end : (momentum_B, sun_B)
        Total momentum and direction to the Sun, (n, 3) at the start and (n, ..., 3) at the end. Both are fixed in space, so there
        must be no impact in between.

    Returns
    -------
    (n, ..., 3) or (n_direction, n, ..., 3)
        NaN if momentum and Sun are parallel.
    """

    # components in the triad, which is fixed in space, are the same at start and end
    components = np.einsum("nij,...nj->...ni", _momentum_sun_triad(*start), direction_B)
    triads = _momentum_sun_triad(*end)
    # an axis of length 1 for each axis that only the end has, such as the instants
    components = components.reshape(*components.shape[:-1], *(1,) * (triads.ndim - 3), 3)
    return sum((components[..., i, None] * triads[..., i, :] for i in range(3)), np.zeros(3))


def _momentum_sun_triad(momentum_B: np.ndarray, sun_B: np.ndarray) -> np.ndarray:
    """Return the orthonormal triads (..., 3, 3) of momentum and Sun; the rows are unit vectors in body axes.

    They are the momentum, the part of the Sun at right angles to it, and their normal; NaN if the two are parallel.
    """
    first = _unit(momentum_B)
    third = _unit(np.cross(first, sun_B), smallest=1e-6)
    return np.stack([first, np.cross(third, first), third], axis=-2)


def angle_about(
    vector: np.ndarray, axis: np.ndarray, zero: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the angles (n), rad, of vectors (n, 3) to an axis (n, 3), and about the axis.

    The angle about the axis is counted from the direction `zero` (n, 3). NaN if a vector has no length.
    """
    unit_axis = _unit(axis)
    cosine = np.sum(_unit(vector) * unit_axis, axis=-1)
    # cross and scalar product of the parts of `zero` and `vector` at right angles to the axis: sine and cosine of the angle
    sine_part = np.sum(unit_axis * np.cross(zero, vector), axis=-1)
    cosine_part = np.sum(zero * vector, axis=-1) - np.sum(zero * unit_axis, axis=-1) * np.sum(
        vector * unit_axis, axis=-1
    )
    return np.arccos(np.clip(cosine, -1.0, 1.0)), np.arctan2(sine_part, cosine_part)
