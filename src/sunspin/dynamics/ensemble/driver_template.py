# The driver of the generated ensemble kernels. This file is text: compiled.py fills in the marked bodies and constants and
# compiles the result under a name made of its hash. It is not imported as it stands.
#
# LANES trajectories advance together, one vector of numbers per quantity. A step in which a wheel's event lies is repeated for
# that lane alone, in double precision (events_template.py), and the lane comes back with the parameters of its new mode.
# ruff: noqa
# pyright: basic
import math

import numpy as np
from sunspin.dynamics.processor import njit

FLOAT = "FLOAT"
LANES = "LANES"
N_WHEELS = "N_WHEELS"
# a row of numbers: one trajectory in body axes
N_STATE = "N_STATE"
ROWS = "ROWS"
NEW = "NEW"
DT = "DT"
BODY = "BODY"
MODE_NUMBERS = "MODE_NUMBERS"
SPIN = "SPIN"  # first of the numbers that depend on which wheels are free
INVERSE = "INVERSE"
FRAME = "FRAME"
COMMON = "COMMON"  # the share of H in omega that is taken out, by this method
HELD = "HELD"
WHEEL = "WHEEL"  # first wheel row
PER_WHEEL = "PER_WHEEL"
INVERSE_INERTIA = "INVERSE_INERTIA"
FREE = "FREE"
COULOMB = "COULOMB"
VISCOUS = "VISCOUS"
INERTIA = "INERTIA"
WATCH = "WATCH"
INVERSE_LIMIT2 = "INVERSE_LIMIT2"
DRY = "DRY"
KEPT = "KEPT"
SPEED = "SPEED"
TORQUE = "TORQUE"
# the work array of the lanes: first rows
S_STATE = "S_STATE"
S_OLD = "S_OLD"
S_DT = "S_DT"
S_MARGIN = "S_MARGIN"  # negative where an event lies in the last step
S_LEAST = "S_LEAST"
S_TURN = "S_TURN"  # of r about H, up to each node
S_WHEEL = "S_WHEEL"
S_SPIN = "S_SPIN"
S_INVERSE = "S_INVERSE"
S_DIFFERENCE = "S_DIFFERENCE"
S_HELD = "S_HELD"
S_AXES = "S_AXES"
S_LOW = "S_LOW"
S_WEAR = "S_WEAR"
S_SPEEDS = "S_SPEEDS"  # smallest and largest speed squared of H so far
S_SIZE = "S_SIZE"  # 1 / |H|^2
S_ROWS = "S_ROWS"
TIMES = "TIMES"  # in a step, when the wheels are looked at
LANE_WHEEL_ROWS = "LANE_WHEEL_ROWS"
# the nodes of the lanes
V_NODE = "V_NODE"
V_DT = "V_DT"
V_SIGNED = "V_SIGNED"
V_ROWS = "V_ROWS"
NODE_ROWS = "NODE_ROWS"
NODES = "NODES"  # per step
BINS = "BINS"
# outcomes
FINE = "FINE"
CHATTERS = "CHATTERS"
PAST_UNKNOWN = "PAST_UNKNOWN"
NOT_FINITE = "NOT_FINITE"
PIECES = (
    4  # of a step with events: a wheel held at the end of each may have slipped only between them
)
MAX_EVENTS_PER_STEP = 64
EVENT_TOLERANCE = "EVENT_TOLERANCE"  # of the place of an event in its step
jit = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})
estimate = njit(
    cache=True, nogil=True, error_model="numpy", fastmath={"contract", "arcp", "afn"}
)  # of reciprocals, refined
"CONSTANTS"


"EVENTS"


@jit
def load_turn(one, w, j):
    """By how much r turns about H up to each node of the step DT, because of the common share of omega."""
    r = 3 + N_WHEELS
    pass  # ABOUT
    size = math.sqrt(square)
    for node in range(NODES):
        angle = one[COMMON] * size * one[DT] * (node + 1) / NODES
        at = S_TURN + 3 * node
        w[at * LANES + j] = math.cos(angle)
        w[(at + 1) * LANES + j] = math.sin(angle) / size if size > 0.0 else 0.0
        w[(at + 2) * LANES + j] = (1.0 - math.cos(angle)) * along / square if size > 0.0 else 0.0


"METHOD"


@jit
def step(w, v):
    for j in range(LANES):
        pass  # STEP


@jit
def least_margin(w):
    """The smallest margin of the lanes, by halving: negative if an event lies in some lane's last step."""
    for j in range(LANES // 2):
        w[S_LEAST * LANES + j] = min(w[S_MARGIN * LANES + j], w[S_MARGIN * LANES + LANES // 2 + j])
    pass  # HALVE
    return w[S_LEAST * LANES]


@jit
def break_away(w):
    """The torques that hold the stuck wheels."""
    for j in range(LANES):
        pass  # BREAK_AWAY


@jit
def signed_mask(v, normals):
    for j in range(LANES):
        pass  # SIGNED


"DEPOSITS"


@jit
def add_up(bins, weights, hist):
    for j in range(LANES):
        hist[j * BINS + bins[j]] += weights[j]
        hist[j * BINS + bins[LANES + j]] += weights[j]
        hist[j * BINS + bins[2 * LANES + j]] += weights[LANES + j]


@jit
def put_node(one, node, v, j):
    """The node of lane j from the state of its row."""
    omega = np.empty(3)
    body_rate(one, omega)
    at = V_NODE + NODE_ROWS * node
    for k in range(3):
        a, b = (k + 1) % 3, (k + 2) % 3
        r = 3 + N_WHEELS
        v[(at + k) * LANES + j] = one[r + k]
        v[(at + 3 + k) * LANES + j] = one[r + a] * omega[b] - one[r + b] * omega[a]
    v[(at + 6) * LANES + j] = omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2]


@jit
def any_stuck(w):
    stuck = False
    for i in range(N_WHEELS):
        for j in range(LANES):
            stuck |= w[(S_WHEEL + LANE_WHEEL_ROWS * i + LANE_WHEEL_ROWS - 1) * LANES + j] > 0.0
    return stuck


@jit
def repair(w, v, rows, modes, outcome):
    """Redo the step, in pieces, for each lane in which an event may have been missed; returns whether any wheel is stuck."""
    for j in range(LANES):
        if w[S_MARGIN * LANES + j] < 0.0:
            one = rows[j]
            unload(w, S_OLD, one, j)
            dt = one[DT]
            for _ in range(PIECES):
                one[DT] = dt / PIECES
                result = through_events(one, modes)
                if result != FINE:
                    give_up(one)
                    outcome[j] = result
                    one[DT] = dt / PIECES
                    step_one(one)
                commit_one(one)
            one[DT] = dt
            load(one, w, v, j)
            if BINS:
                put_node(one, NODES, v, j)
    return any_stuck(w)


@jit
def prepare(work, index, modes, dt, rows, w, v, outcome):
    """Rows into lanes (the last one repeated); wheels at rest may have to slip at once."""
    for j in range(LANES):
        one = rows[j]
        for k in range(
            ROWS
        ):  # a slice would bring in numba's sentence on shapes that differ: four seconds of compilation
            one[k] = work[index[min(j, index.size - 1)], k]
        one[DT] = dt
        outcome[j] = FINE
        if N_WHEELS and dt > 0.0:
            settle(one, modes)
        for i in range(N_WHEELS):
            if one[WHEEL + PER_WHEEL * i + INVERSE_LIMIT2] > 0.0 and dt < 0.0:
                outcome[j] = PAST_UNKNOWN
        load(one, w, v, j)
        if BINS:
            put_node(one, NODES, v, j)
    return any_stuck(w)


@jit
def tell(one, out):
    """The state of a row, its body rate and the speeds of its wheels."""
    omega = np.empty(3)
    speeds = np.empty(N_WHEELS)
    body_rate(one, omega)
    wheel_speeds(one, omega, speeds)
    for k in range(N_STATE):
        out[k] = one[k]
    for k in range(3):
        out[N_STATE + k] = omega[k]
    for i in range(N_WHEELS):
        out[N_STATE + 3 + i] = speeds[i]


@jit
def run_block(
    work,
    index,
    modes,
    normals,
    steps,
    dts,
    output,
    rows,
    w,
    v,
    bins,
    weights,
    hist,
    track,
    outcome,
    evenness,
):
    """Advance one block of at most LANES rows of `work`; see `run`."""
    stuck = prepare(work, index, modes, dts[-1], rows, w, v, outcome)
    if BINS:
        signed_mask(v, normals)
    if S_SPEEDS:
        for j in range(LANES):
            w[S_SPEEDS * LANES + j] = FLOAT(np.inf)
            w[(S_SPEEDS + 1) * LANES + j] = 0.0
            evenness[j] = 1.0
    for s in range(steps.size):
        for j in range(LANES):
            unload(w, S_STATE, rows[j], j)
            rows[j, DT] = dts[s]
            load(rows[j], w, v, j)
        for _ in range(steps[s]):
            step(w, v)
            if N_WHEELS:
                if stuck:
                    break_away(w)
                if least_margin(w) < 0.0:
                    stuck = repair(w, v, rows, modes, outcome)
            if BINS:
                pass  # DEPOSIT_ALL
        if output[s] >= 0 and track.shape[1] > 0:
            for j in range(index.size):
                unload(w, S_STATE, rows[j], j)
                tell(rows[j], track[index[j], output[s]])
    for j in range(LANES):
        if S_SPEEDS and w[(S_SPEEDS + 1) * LANES + j] > 0.0:
            evenness[j] = w[S_SPEEDS * LANES + j] / w[(S_SPEEDS + 1) * LANES + j]
        for k in range(S_STATE, S_STATE + N_STATE):
            if not np.isfinite(w[k * LANES + j]) and outcome[j] == FINE:
                outcome[j] = NOT_FINITE


@jit
def run(work, index, modes, normals, steps, dts, output, hist, track, outcome, evenness):
    """Advance the rows `index` of `work` (n, ROWS), all with the same steps.

    modes (n_body, 2^n, MODE_NUMBERS): what depends on which wheels are free, for each body; steps and dts (n_segment): each segment is steps[s]
    steps of dts[s] seconds, after which the output output[s] is due if it is not negative; hist (n, BINS) gets the time that
    counts, in s, by r_z; track (n, n_output, N_STATE + 3 + N_WHEELS), if it has
    room, takes the states in body axes, the body rates and the wheels' speeds;
    outcome (n); evenness (n): smallest over largest speed squared of H.
    """
    rows = np.zeros((LANES, ROWS))
    w = np.zeros(S_ROWS * LANES, dtype=FLOAT)
    v = np.zeros(V_ROWS * LANES, dtype=np.float32)
    bins = np.zeros(3 * LANES, dtype=np.int32)
    weights = np.zeros(2 * LANES, dtype=np.float32)
    block = np.zeros(LANES * BINS, dtype=np.float32)
    ends = np.zeros(LANES, dtype=np.int64)
    even = np.ones(LANES)
    for start in range(0, index.size, LANES):
        take = index[start : start + LANES]
        block[:] = 0.0
        run_block(
            work,
            take,
            modes,
            normals,
            steps,
            dts,
            output,
            rows,
            w,
            v,
            bins,
            weights,
            block,
            track,
            ends,
            even,
        )
        for j in range(take.size):
            outcome[take[j]] = ends[j]
            evenness[take[j]] = even[j]
            for b in range(BINS):
                hist[take[j], b] = block[j * BINS + b]
