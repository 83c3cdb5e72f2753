"""The Taylor kernel: it loads motions into lanes, advances them step by step, and writes their results.

Each lane takes steps of its own length, and takes the next motion as soon as its own has ended. A step has six parts, marked
in `advance`: series, length, events, outputs, state, and the end of the step. No number of one lane enters another: the result of a
motion does not depend on its neighbours, to the last bit. Names are those of :mod:`~sunspin.dynamics.kernels.flow`.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from sunspin.dynamics.kernels import flow, histogram, nodes, rows, wheels
from sunspin.dynamics.kernels.flow import (
    move,
    rows_in_use,
    value_at,
    write_series,
    write_share,
)
from sunspin.dynamics.kernels.histogram import take_out
from sunspin.dynamics.kernels.nodes import (
    begin,
    deposit_step,
    longest_step,
    write_inner_nodes,
)
from sunspin.dynamics.kernels.rows import (
    ALLOWED,
    AXIAL,
    AXIS,
    CHATTERS,
    DRY,
    DT,
    FREE,
    HELD,
    INERTIA,
    INVERSE_H,
    INVERSE_J,
    KEPT,
    NADIR,
    NOT_FINITE,
    NUMBERS,
    NX,
    NY,
    OVERLOADED,
    PAST_UNKNOWN,
    PER_WHEEL,
    PULL,
    RESTS,
    ROWS,
    STATE_ROWS,
    SUN,
    TORQUE,
    TORQUE_B,
    TURN,
    VISCOUS,
    WHEELS,
    H,
    L,
    Lanes,
)
from sunspin.dynamics.kernels.wheels import (
    are_watched,
    first_event,
    follow_momentum,
    pass_event,
    set_mode,
    settle,
    slip,
    stick,
    write_body_rate,
    write_seen,
)
from sunspin.dynamics.processor import cached, compiled, digest

FIRST_ANGLE = 0.3
"""Length of the first step, rad of rotation; after two or three steps their length is that allowed (`flow.write_share`)."""

GROWTH = 2.0
"""Largest ratio of a step to the one before."""

TIME_ROUNDING = 1e-12
"""Share of a run within which an output counts as reached."""


class LaneClock(NamedTuple):
    """Progress of the lanes, (L) each.

    `row`: number of the motion, -1 for an idle lane; `due`: number of the next output; `left` and `until`: seconds to the end of
    the run and to that output; `planned`: length of the next step, s; `steps`: number of steps; `wheel`: the wheel whose event ends
    the step, or -1; `stops`: within a step, whether an output, an event or the end of the motion is due in it; after the step,
    whether the motion has ended.
    """

    row: np.ndarray
    due: np.ndarray
    left: np.ndarray
    until: np.ndarray
    planned: np.ndarray
    steps: np.ndarray
    wheel: np.ndarray
    stops: np.ndarray


# ---- into a lane ---------------------------------------------------------------------------------
@compiled
def load(lanes, clock, motions, task, l, row):
    """Load motion `row` in its initial state into lane l; return whether its numbers are finite."""
    y, p, u = lanes.y, lanes.p, lanes.u
    n_wheels = len(motions.axes)
    body = row if len(motions.inertia) > 1 else 0
    inertia, wheel, modes = motions.inertia[body], motions.wheels[body], motions.modes[body]
    steady = motions.steady[body]
    nadir = motions.nadir[row if len(motions.nadir) > 1 else 0]
    omega, speeds = motions.omega_B[row], motions.speeds[row]
    for j in range(ROWS):
        y[j * L + l] = 0.0
    for k in range(3):  # H without the wheels, which are added below
        y[H + k * L + l] = (
            inertia[k, 0] * omega[0] + inertia[k, 1] * omega[1] + inertia[k, 2] * omega[2]
        )
        y[SUN + k * L + l] = motions.sun_B[row, k]
        y[TORQUE + k * L + l] = steady[1, k]
        y[NADIR + k * L + l] = nadir[0, k]
        y[TURN + k * L + l] = nadir[1, k]
        p[TORQUE_B + k * L + l] = steady[0, k]
        p[HELD + k * L + l] = 0.0
    y[NX + l], y[NY + L + l] = 1.0, 1.0
    for i in range(n_wheels):
        w = i * PER_WHEEL + l
        axis, axial_inertia, dry = motions.axes[i], wheel[i, 0], wheel[i, 1]
        along = axis[0] * omega[0] + axis[1] * omega[1] + axis[2] * omega[2]
        # h = J (W + u.omega)
        y[AXIAL + i * L + l] = axial_inertia * (speeds[i] + along)
        for k in range(3):
            u[w + AXIS + k * L] = axis[k]
        u[w + INVERSE_J], u[w + DRY], u[w + VISCOUS] = 1.0 / axial_inertia, dry, wheel[i, 2]
        u[w + KEPT] = 0.0
        if motions.driven[i]:
            u[w + KEPT], u[w + DRY] = speeds[i], 0.0
            stick(u, w)
        elif speeds[i] == 0.0 and dry > 0.0:
            stick(u, w)  # `settle` below releases it if friction cannot hold it
        else:
            # a wheel at rest gets here only without dry friction, and then `slip` does not use the sign
            slip(u, w, 1.0 if speeds[i] > 0.0 else -1.0)
        for k in range(3):
            y[H + k * L + l] += axial_inertia * speeds[i] * axis[k]
            if u[w + FREE] < 0.5:
                p[HELD + k * L + l] += axial_inertia * speeds[i] * axis[k]
    p[PULL + l] = motions.pull
    at = 0
    for a in range(3):
        for b in range(a, 3):
            p[INERTIA + at * L + l] = inertia[a, b]
            at += 1
    lanes.since[l] = 0.0
    set_mode(lanes, n_wheels, l, modes, task.torques)
    size = math.sqrt(y[H + l] ** 2 + y[H + L + l] ** 2 + y[H + 2 * L + l] ** 2)
    p[INVERSE_H + l] = 1.0 / size if size > 0.0 else 0.0
    p[ALLOWED + l] = task.allowed
    # a rough largest rate, for the first step: the present one, plus that of a body with locked wheels that has all of H along x
    rate = math.sqrt(omega[0] ** 2 + omega[1] ** 2 + omega[2] ** 2) + modes[0, 1] * size
    end = task.ends[-1]
    p[DT + l] = math.copysign(min(FIRST_ANGLE / max(rate, 1e-9), max(abs(end), 1e-9)), end)
    if end > 0.0:  # backward in time `batch.run` and `propagate` treat wheels that begin at rest
        settle(lanes, n_wheels, l, modes, task.torques)
    clock.row[l], clock.due[l], clock.steps[l], clock.wheel[l] = row, 0, 0, -1
    clock.left[l], clock.until[l] = abs(end), abs(task.ends[0])
    return math.isfinite(size) and math.isfinite(rate) and math.isfinite(y[SUN + l])


@compiled
def idle(lanes, clock, l):
    """Give lane l steps of no length: no motion is left for it."""
    clock.row[l], clock.left[l], clock.until[l], lanes.p[DT + l] = -1, 0.0, np.inf, 0.0


# ---- out of a lane -------------------------------------------------------------------------------
@compiled
def write_state(lanes, n_wheels, l, task, seconds, state):
    """Write the state of lane l in `lanes.spare` into `state`, in the order of :class:`rows.Answer`.

    `seconds`: time since directions were last straightened.
    """
    y, u = lanes.spare, lanes.u
    vector, omega = np.empty(3), np.empty(3)
    write_body_rate(y, lanes, n_wheels, l, omega)
    at = 3 + n_wheels
    for k in range(3):
        state[k] = y[H + k * L + l]
        state[at + 3 + k] = omega[k]
    for i in range(n_wheels):
        w = i * PER_WHEEL + l
        along = u[w + AXIS] * omega[0] + u[w + AXIS + L] * omega[1] + u[w + AXIS + 2 * L] * omega[2]
        if u[w + FREE] > 0.5:
            state[3 + i] = y[AXIAL + i * L + l]
            state[at + 6 + i] = y[AXIAL + i * L + l] * u[w + INVERSE_J] - along
        else:  # h of a wheel that is held is not integrated
            state[3 + i] = (along + u[w + KEPT]) / u[w + INVERSE_J]
            state[at + 6 + i] = u[w + KEPT]
    write_seen(y, SUN, lanes, l, seconds, task.torques, vector)
    for k in range(3):
        state[at + k] = vector[k]
    if task.attitude:
        for first, V in ((at + 6 + n_wheels, NX), (at + 9 + n_wheels, NY)):
            write_seen(y, V, lanes, l, seconds, task.torques, vector)
            for k in range(3):
                state[first + k] = vector[k]


@compiled
def write_output(lanes, n_wheels, l, task, x, state):
    """Write the state of lane l at the share x of its step into `state`, before the step is taken."""
    for j in range(rows_in_use(n_wheels, task.torques, task.attitude)):
        lanes.spare[j * L + l] = value_at(lanes.c, task.order, j * L + l, x)
    seconds = lanes.since[l] + x * lanes.p[DT + l]
    write_state(lanes, n_wheels, l, task, seconds, state)


@compiled
def write_last(lanes, n_wheels, l, task, state):
    """Write the state that lane l has reached into `state`."""
    for j in range(STATE_ROWS):
        lanes.spare[j * L + l] = lanes.y[j * L + l]
    write_state(lanes, n_wheels, l, task, lanes.since[l], state)


@compiled
def write_due(lanes, clock, n_wheels, l, task, states):
    """Write the outputs of lane l that fall into its step into `states` (n_out, size)."""
    ends = task.ends
    duration, dt = abs(ends[-1]), abs(lanes.p[DT + l])
    last = len(ends) - 1
    while clock.due[l] <= last and not clock.until[l] > TIME_ROUNDING * duration:
        if states.shape[1]:
            # `back`: seconds from the end of the step to the output, not positive. If the step ends the run, the last output is at
            # its end: there `until` differs from zero only by rounding.
            inside = clock.due[l] < last or clock.wheel[l] >= 0
            back = clock.until[l] if inside else 0.0
            x = lanes.share[l] + back / max(dt, 1e-300)
            write_output(lanes, n_wheels, l, task, x, states[clock.due[l]])
        clock.due[l] += 1
        clock.until[l] += abs(ends[min(clock.due[l], last)]) - abs(ends[clock.due[l] - 1])


# ---- the run -------------------------------------------------------------------------------------
@compiled
def end_step(lanes, clock, motions, task, answer, l):
    """Apply the event of a wheel that ends the step of lane l, if any; return whether the motion in the lane has ended.

    It has ended if all outputs are reached, or for a reason that is written into `answer.outcome`: PAST_UNKNOWN, CHATTERS (too many
    events) or NOT_FINITE (also too many steps). The event and its time are written into `answer`, as far as there is room.
    """
    n_wheels, row = len(motions.axes), clock.row[l]
    done = clock.due[l] >= len(task.ends)
    if clock.wheel[l] >= 0:
        body = row if len(motions.modes) > 1 else 0  # one body for all motions, or one for each
        what = pass_event(lanes, n_wheels, l, motions.modes[body], task.torques, clock.wheel[l])
        count = answer.n_events[row]
        if count < answer.events.shape[1]:
            duration = abs(task.ends[-1])
            answer.events[row, count, 0] = math.copysign(duration - clock.left[l], task.ends[-1])
            answer.events[row, count, 1], answer.events[row, count, 2] = clock.wheel[l], what
        answer.n_events[row] += 1
        clock.wheel[l] = -1
        if what == RESTS or what == OVERLOADED:  # backward: its past is not determined
            answer.outcome[row], done = PAST_UNKNOWN, True
        elif answer.n_events[row] >= task.most_events:
            answer.outcome[row], done = CHATTERS, True
    finite = math.isfinite(lanes.y[H + l]) and math.isfinite(lanes.y[SUN + l])
    if not finite or clock.steps[l] >= task.most_steps:
        answer.outcome[row], done = NOT_FINITE, True
    return done


@compiled
def take_next(lanes, clock, motions, task, answer, queue):
    """Load the next motion of the queue into each lane whose motion has ended; return how many lanes find none and become idle.

    `clock.stops` marks the lanes whose motion has ended, and all lanes at the start of a run. A motion whose initial numbers are
    not finite is not run: `answer` gets NOT_FINITE and NaN for it, and the lane takes the motion after it.

    queue : (n + 1) int
        Numbers of the motions in the order in which they are run; the last entry counts how many have been taken.
    """
    idle_lanes = 0
    for l in range(L):
        if not clock.stops[l]:
            continue
        loaded = False
        while not loaded and queue[-1] < len(queue) - 1:
            row = queue[queue[-1]]
            queue[-1] += 1
            loaded = load(lanes, clock, motions, task, l, row)
            if not loaded:
                answer.outcome[row] = NOT_FINITE
                answer.states[row, :, :] = np.nan
                answer.last[row, :] = np.nan
        if not loaded:
            idle(lanes, clock, l)
            idle_lanes += 1
    return idle_lanes


@compiled
def advance(queue, motions, task, answer, work):
    """Compute the motions of the queue, and write their results into `answer`.

    queue : (n + 1) int
        As of `take_next`.
    work : histogram.Nodes
        Working arrays of the histogram, used if `answer.hist` has bins.
    """
    n_wheels, order = len(motions.axes), task.order
    orders = 4 * ((order + 3) // 4) + 2
    lanes = Lanes(
        c=np.zeros((orders, ROWS * L)),
        y=np.zeros(ROWS * L),
        p=np.zeros(NUMBERS * L),
        u=np.zeros(WHEELS * PER_WHEEL),
        share=np.zeros(STATE_ROWS * L),
        since=np.zeros(L),
        slope=np.zeros(6 * L),
        sums=np.zeros(ROWS * L),
        polynomial=np.zeros(orders),
        spare=np.zeros(ROWS * L),
    )
    clock = LaneClock(
        row=np.full(L, -1),
        due=np.zeros(L, np.int64),
        left=np.zeros(L),
        until=np.full(L, np.inf),
        planned=np.zeros(L),
        steps=np.zeros(L, np.int64),
        wheel=np.full(L, -1),
        stops=np.full(L, True),
    )
    margin, share = np.zeros(L), lanes.share
    n_rows = rows_in_use(n_wheels, task.torques, task.attitude)
    duration = abs(task.ends[-1])
    with_histogram = answer.hist.shape[1] > 0
    busy = L - take_next(lanes, clock, motions, task, answer, queue)
    if with_histogram:
        begin(lanes, work, n_wheels)
    while busy:
        # series of the motion, from the state
        write_series(lanes, n_wheels, order, task.torques, task.attitude)
        # length: the error allowed determines that of the next step; this step ends at the end of the run at the latest
        write_share(lanes, order)
        for l in range(L):
            dt = abs(lanes.p[DT + l])
            x = min(share[l], GROWTH)
            if with_histogram:
                x = min(x, longest_step(work, l, duration) / max(dt, 1e-300))
            clock.planned[l] = x * lanes.p[DT + l]
            share[l] = min(x, clock.left[l] / max(dt, 1e-300))
        # events: the step ends at the first event of a wheel
        if n_wheels and are_watched(lanes, n_wheels, order, margin):
            for l in range(L):
                if margin[l] <= 0.0 and clock.row[l] >= 0:
                    clock.wheel[l], share[l] = first_event(lanes, n_wheels, order, l, share[l])
        # outputs in the step
        any_stops = False
        for l in range(L):
            seconds = share[l] * abs(lanes.p[DT + l])
            clock.left[l] -= seconds
            clock.until[l] -= seconds
            clock.steps[l] += 1
            reached = not clock.until[l] > TIME_ROUNDING * duration
            clock.stops[l] = reached or clock.wheel[l] >= 0 or clock.steps[l] >= task.most_steps
            any_stops |= clock.stops[l]
        if any_stops:
            for l in range(L):
                if clock.stops[l] and clock.row[l] >= 0:
                    write_due(lanes, clock, n_wheels, l, task, answer.states[clock.row[l]])
        # state at the end of the step
        for j in range(L, n_rows * L):
            share[j] = share[j - L]
        if with_histogram:
            write_inner_nodes(lanes, work, n_wheels, order)
        move(lanes, order, n_rows)
        for l in range(L):
            lanes.since[l] += share[l] * lanes.p[DT + l]
        if task.torques:
            follow_momentum(lanes, task.torques)
        if with_histogram:
            deposit_step(lanes, work, n_wheels)
        for l in range(L):
            lanes.p[DT + l] = clock.planned[l]
        # the end of the step: events, and motions that have ended
        if any_stops:
            for l in range(L):
                row = clock.row[l]
                clock.stops[l] = (
                    clock.stops[l] and row >= 0 and end_step(lanes, clock, motions, task, answer, l)
                )
                if clock.stops[l]:
                    answer.steps[row] = clock.steps[l]
                    write_last(lanes, n_wheels, l, task, answer.last[row])
                    if answer.outcome[row]:
                        answer.states[row, clock.due[l] :, :] = np.nan
                    if with_histogram:
                        take_out(work, l, answer.hist[row])
            busy -= take_next(lanes, clock, motions, task, answer, queue)
            if with_histogram:
                begin(lanes, work, n_wheels)


def _entry(sources: int) -> Any:
    """Return the entry point, whose machine code is stored on disk and compiled again when a source file has changed.

    `sources`: the digest of the files that it is compiled from (:func:`sunspin.dynamics.processor.digest`).
    """

    @cached("compiling the integrator of motions, once (some 20 s)")
    def run(queue, motions, task, answer, work):
        """Compute the motions of a queue (:func:`advance`)."""
        _ = sources  # so the closure holds the digest, which becomes a key of numba's cache
        advance(queue, motions, task, answer, work)

    return run


run = _entry(
    digest(*(str(module.__file__) for module in (rows, flow, wheels, histogram, nodes)), __file__)
)
