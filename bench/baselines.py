"""Competing integrators: heyoka in batches, and SciPy. Both integrate `sunspin.dynamics.gyrostat.rhs`.

Each propagates states (n, 7) over the window, detects the stop of the wheel, and does nothing else: no mask, no distribution, no
distance. A stopped wheel is assumed to stay stuck, which it does for every motion of the grid; otherwise the direction errors in
the table would show it.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any, NamedTuple

import heyoka as hk
import numpy as np
from scipy.integrate import solve_ivp

from bench.problem import Problem
from sunspin.dynamics import gyrostat
from sunspin.dynamics.friction import spin_down_time

LOOK_AHEAD_S = 4.0
"""Length (s) of the pieces in which free motion is propagated. The stops of a batch are about this close together."""

N_STATE = 7
"""Components of a state: momentum (3), momentum of the wheel, Sun direction (3)."""


class End(NamedTuple):
    """Sun directions (n, 3) at the end of the window, and times (n) in s at which the wheel stopped."""

    sun_B: np.ndarray
    stop_s: np.ndarray


Contestant = Callable[[np.ndarray], End]


def free_system(problem: Problem) -> tuple[list, Any]:
    """Return heyoka's system of (H, h, r) while the wheel turns, and the wheel's speed.

    Parameters enter as numbers, as heyoka folds zeros.
    """
    variables = hk.make_vars("Hx", "Hy", "Hz", "h", "rx", "ry", "rz")
    H, h, r = variables[:3], variables[3:4], variables[4:]
    p = problem.parameters(True)
    dH, dh, dr = gyrostat.rhs(H, h, r, p)
    speed = gyrostat.wheel_speed(h[0], gyrostat.body_rate(H, h, p), p.wheels[0])
    return list(zip(variables, [*dH, *dh, *dr], strict=True)), speed


def stuck_system(problem: Problem) -> list:
    """Return heyoka's system of (H, r) after the wheel has stopped, when its momentum is no variable."""
    variables = hk.make_vars("Hx", "Hy", "Hz", "rx", "ry", "rz")
    H, r = variables[:3], variables[3:]
    dH, _, dr = gyrostat.rhs(H, [0.0], r, problem.parameters(False))
    return list(zip(variables, [*dH, *dr], strict=True))


class TaylorBatch:
    """heyoka's batch integrator, `size` motions at once.

    A terminal event would halt a whole batch at the stop of its first wheel. So the stop is detected by an event that does not end
    the run, and the state there is taken from the dense output. The batch continues until all of its wheels have stopped. From the
    stops on, each at its own time, a system of six variables takes over.
    """

    def __init__(self, problem: Problem, tol: float, size: int) -> None:
        stops: dict[int, tuple[float, np.ndarray]] = {}

        # heyoka copies its callbacks deeply, and only a plain function comes out of that as itself
        def note(ta: Any, time: float, sign: int, lane: int) -> None:
            """Store the time and the state of the stop of a motion."""
            if lane not in stops:
                stops[lane] = (time, ta.update_d_output(time)[:, lane].copy())

        system, speed = free_system(problem)
        event = hk.nt_event_batch(speed, note, direction=hk.event_direction.negative)
        self.problem, self.size, self.stops = problem, size, stops
        (wheel,) = problem.vehicle.wheels
        # on a body that does not turn, W' = -(c + v W) / J: stops of the motions lie around that one
        self.first_s = spin_down_time(wheel.friction, wheel.inertia_kg_m2, wheel.speed_rad_s)
        self.free = hk.taylor_adaptive_batch(
            system, np.zeros((N_STATE, size)), nt_events=[event], tol=tol
        )
        self.stuck = hk.taylor_adaptive_batch(stuck_system(problem), np.zeros((6, size)), tol=tol)

    def __call__(self, starts: np.ndarray) -> End:
        """Propagate states (n, 7) over the window, batch by batch."""
        ends = [self._batch(starts[i : i + self.size]) for i in range(0, len(starts), self.size)]
        return End(
            np.concatenate([end.sun_B for end in ends]),
            np.concatenate([end.stop_s for end in ends]),
        )

    def _batch(self, starts: np.ndarray) -> End:
        """Return the ends of one batch of at most `size` motions."""
        n, free, stuck = len(starts), self.free, self.stuck
        # heyoka's batches are full: the last motion is repeated
        full = np.concatenate([starts, np.repeat(starts[-1:], self.size - n, axis=0)])
        self.stops.clear()
        free.set_time(0.0)
        free.state[:] = full.T
        until = self.first_s
        while len(self.stops) < self.size:  # friction sees to it that this ends
            until += LOOK_AHEAD_S
            free.propagate_until(until)
        stops = [self.stops[lane] for lane in range(self.size)]
        times = np.array([time for time, _ in stops])
        states = np.array([state for _, state in stops])
        stuck.set_time(times)
        stuck.state[:] = np.delete(states, 3, axis=1).T  # without the wheel's momentum
        stuck.propagate_until(self.problem.window_s)
        return End(stuck.state[3:, :n].T.copy(), times[:n])


class DormandPrince:
    """SciPy's DOP853 with the stop as a terminal event.

    It uses lists of floats, which are faster than arrays for seven components.
    """

    def __init__(self, problem: Problem, rtol: float) -> None:
        self.window_s, self.rtol = problem.window_s, rtol
        self.free, self.stuck = problem.parameters(True), problem.parameters(False)

    def _rate(self, t: float, y: np.ndarray, p: gyrostat.Parameters) -> list[float]:
        """Return the derivative (7) of a state y (7)."""
        values = y.tolist()
        dH, dh, dr = gyrostat.rhs(values[:3], values[3:4], values[4:], p)
        return [*dH, *dh, *dr]

    def _piece(
        self, start: float, y: np.ndarray, p: gyrostat.Parameters, events: list | None
    ) -> Any:
        """Return SciPy's solution from time `start` to the end of the window or to a terminal event."""
        span = (start, self.window_s)
        return solve_ivp(
            self._rate, span, y, "DOP853", args=(p,), rtol=self.rtol, atol=self.rtol, events=events
        )

    def __call__(self, starts: np.ndarray) -> End:
        """Propagate states (n, 7) over the window, one after the other."""

        def stop(t: float, y: np.ndarray, p: gyrostat.Parameters) -> float:
            """Return the wheel speed, whose zero ends the run."""
            values = y.tolist()
            return gyrostat.wheel_speed(
                values[3], gyrostat.body_rate(values[:3], values[3:4], p), p.wheels[0]
            )

        stop.terminal, stop.direction = True, -1.0
        sun_B, stop_s = np.empty((len(starts), 3)), np.empty(len(starts))
        for i, start in enumerate(starts):
            before = self._piece(0.0, start, self.free, [stop])
            after = self._piece(before.t[-1], before.y[:, -1], self.stuck, None)
            sun_B[i], stop_s[i] = after.y[4:, -1], before.t[-1]
        return End(sun_B, stop_s)


def on_cores(
    contestants: list[Contestant], starts: np.ndarray, block: int = 1
) -> Callable[[], None]:
    """Return a function that divides the work among as many threads as there are contestants.

    Blocks of rows are assigned in turn, so that all threads have equal work. heyoka releases the interpreter while it integrates. A
    thread that has finished its rows waits for the others.
    """
    thread = np.arange(len(starts)) // block % len(contestants)  # of each row
    parts = [starts[thread == k] for k in range(len(contestants))]

    def work() -> None:
        """Propagate all rows."""
        with ThreadPoolExecutor(len(contestants)) as pool:
            list(pool.map(lambda pair: pair[0](pair[1]), zip(contestants, parts, strict=True)))

    return work
