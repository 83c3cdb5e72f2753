"""Initial states of many trajectories, and each as the row of numbers that the kernels work on."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from sunspin.base.errors import InputError
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics import wheel_modes as m
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.ensemble import codegen as c
from sunspin.dynamics.ensemble import principal
from sunspin.dynamics.torques import NOTHING, Acting
from sunspin.dynamics.torques.acting import needed, needed_around, spun
from sunspin.solve.linear import extreme_eigenvalues, symmetric_inverse
from sunspin.vehicle import Vehicle


@dataclass(frozen=True)
class Rows:
    """Initial states of n trajectories: omega_B (n, 3) rad/s, sun_B (n, 3), wheel speeds (n, n_wheel) rad/s.

    `bodies` gives each its own inertia and friction, leading shape (n,); without it all have the vehicle's. `B_from_N` (n, 4),
    quaternions with the scalar last, is what torques need that depend on directions beside the Sun's.
    """

    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray
    bodies: Bodies | None = None
    B_from_N: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.omega_B)

    def take(self, index: np.ndarray) -> Rows:
        bodies = None if self.bodies is None else self.bodies.take(index)
        attitude = None if self.B_from_N is None else self.B_from_N[index]
        return Rows(
            self.omega_B[index], self.sun_B[index], self.wheel_speed_rad_s[index], bodies, attitude
        )

    def carried(self, acting: Acting, own: np.ndarray) -> np.ndarray:
        """What torques need of directions (n, n_carried), `own` as `Acting.own` gives it; `InputError` for rows without attitudes
        where some is needed."""
        if not needed(acting.torques):
            return np.zeros((len(self), 0))
        if self.B_from_N is None and needed_around(acting.torques):
            raise InputError(
                "torques that depend on directions need the attitude of each row",
                do="give B_from_N",
            )
        from scipy.spatial.transform import Rotation

        attitude = (
            np.tile([0.0, 0.0, 0.0, 1.0], (len(self), 1))
            if self.B_from_N is None
            else self.B_from_N
        )
        return acting.carried(Rotation.from_quat(attitude).as_matrix(), own=own)

    def bodies_of(self, vehicle: Vehicle) -> Bodies:
        """The numbers of these rows, leading shape (n,) or, where all have the same, (1,)."""
        return Bodies.of(vehicle, 1) if self.bodies is None else self.bodies


def common_spin(free: np.ndarray) -> np.ndarray:
    """The share (...) of H in omega, 1/(kg m2), without which the rest is slowest: half way between the extreme 1 / moments.

    `free` is the inertia A (..., 3, 3).
    """
    smallest, largest = extreme_eigenvalues(free)
    return 0.5 * (1.0 / smallest + 1.0 / largest)


def mode_table(vehicle: Vehicle, bodies: Bodies, with_frames: bool = True) -> np.ndarray:
    """For every body and set of free wheels, (n, 2^n_wheel, 19): spin, inverse inertia, principal inverse moments and axes.

    The latter take more than half of the time, and zeros stand in their place unless they are asked for: only the split method,
    which is for histograms, reads them.
    """
    numbers = np.concatenate(
        [bodies.inertia_kg_m2.reshape(-1, 9), bodies.wheel_inertia_kg_m2], axis=-1
    )
    same = np.ascontiguousarray(numbers).view([("", np.float64)] * numbers.shape[1]).ravel()
    _, first, which = np.unique(same, return_index=True, return_inverse=True)
    if len(first) < len(numbers):
        return _mode_table(vehicle, bodies.take(first), with_frames)[which.ravel()]
    return _mode_table(vehicle, bodies, with_frames)


def _mode_table(vehicle: Vehicle, bodies: Bodies, with_frames: bool) -> np.ndarray:
    free = principal.free_inertias(bodies)
    parts = [common_spin(free)[..., None], symmetric_inverse(free)]
    if with_frames:
        frame = principal.frames(vehicle, bodies)
        parts += [frame.inverse, frame.axes.reshape(*frame.axes.shape[:-2], 9)]
    else:
        parts += [np.zeros((*free.shape[:-2], 12))]
    table = np.concatenate(parts, axis=-1)
    return np.ascontiguousarray(np.moveaxis(table, 0, 1))


def _wheel_modes(
    vehicle: Vehicle, speeds: np.ndarray, commands: Sequence[str], coulomb: np.ndarray
) -> Iterator[tuple[np.ndarray, list[m.WheelState]]]:
    """Rows that begin with their wheels in the same mode, and that mode; its speeds and limits are those of one of them."""
    held = np.array([command == "hold" for command in commands], dtype=bool)
    keys = np.concatenate(
        [np.where(held, 0.0, np.sign(speeds)), np.broadcast_to(coulomb > 0, speeds.shape)], axis=1
    )
    _, first, group = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(group.ravel(), kind="stable")
    edges = np.searchsorted(group.ravel()[order], np.arange(1, len(first)))
    coulomb = np.broadcast_to(coulomb, speeds.shape)
    for row, members in zip(first, np.split(order, edges), strict=True):
        wheels = zip(vehicle.wheels, commands, speeds[row], coulomb[row], strict=True)
        yield (
            members,
            [
                m.state_under(wheel, command, float(speed), float(dry))
                for wheel, command, speed, dry in wheels
            ],
        )


def work_array(
    vehicle: Vehicle,
    rows: Rows,
    commands: Sequence[str],
    modes: np.ndarray,
    acting: Acting = NOTHING,
) -> np.ndarray:
    """The kernel's row of numbers for each trajectory, (n, rows); `modes` as `mode_table` gives it for their bodies."""
    layout, bodies = c.RowLayout.under(acting.torques, len(vehicle.wheels)), rows.bodies_of(vehicle)
    speeds = np.asarray(rows.wheel_speed_rad_s, dtype=np.float64)
    work = np.zeros((len(rows), layout.count))
    work[:, :3] = g.total_momentum(bodies, rows.omega_B, speeds)
    work[:, 3 : layout.r] = g.axial_momenta(bodies, rows.omega_B, speeds)
    work[:, layout.r : layout.r + 3] = rows.sun_B
    if acting.torques:
        work[:, layout.r + 3 : layout.n_state - 1] = rows.carried(acting, acting.own(bodies))
        if spun(acting.torques):
            work[:, layout.r + 6 : layout.r + 9] = work[:, :3]  # H as it is at the start
        work[:, layout.n_state - 1] = acting.start_s
        work[:, layout.torques : layout.count] = acting.values(bodies)
    own = np.arange(len(rows)) if len(modes) > 1 else np.zeros(len(rows), dtype=np.int64)
    work[:, layout.body] = own
    for members, states in _wheel_modes(vehicle, speeds, commands, bodies.coulomb_N_m):
        free = sum(1 << i for i, state in enumerate(states) if state.turning is m.Turning.FREE)
        work[members, layout.spin : layout.held] = modes[own[members], free]
        still = np.array([state.turning is not m.Turning.FREE for state in states], dtype=bool)
        spins = np.where(still, bodies.wheel_inertia_kg_m2 * speeds, 0.0)
        work[members, layout.held : layout.held + 3] = (spins @ bodies.axes_B)[members]
        for i, (wheel, state) in enumerate(zip(vehicle.wheels, states, strict=True)):
            _fill_wheel(work, layout, i, members, own, wheel, state, bodies, speeds[:, i])
    return work


def _fill_wheel(
    work: np.ndarray,
    layout: c.RowLayout,
    i: int,
    members: np.ndarray,
    own: np.ndarray,
    wheel: m.Wheel,
    state: m.WheelState,
    bodies: Bodies,
    speeds: np.ndarray,
) -> None:
    """The numbers of wheel i, in the rows `members`, which begin in the same state."""
    body = own[members]
    inertia = bodies.wheel_inertia_kg_m2[body, i]
    free = state.turning is m.Turning.FREE
    dry = m.friction_limit(wheel, state.command, bodies.coulomb_N_m[body, i])
    stuck = state.turning is m.Turning.STUCK
    values = {
        "inverse_inertia": 1.0 / inertia,
        "free": float(free),
        "coulomb": state.sign * dry,
        "viscous": bodies.viscous_N_m_s[body, i],
        "inertia": inertia,
        "watch": np.where(dry > 0, state.sign, 0.0) if free else 0.0,
        "inverse_limit2": 1.0 / dry**2 if stuck else 0.0,
        "dry": dry,
        "kept": 0.0 if free else speeds[members],
        **{f"axis_{name}": value for name, value in zip("xyz", bodies.axes_B[i], strict=True)},
    }
    for name, value in values.items():
        work[members, layout.of(i, name)] = value
