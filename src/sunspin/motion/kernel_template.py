# The driver of the generated ensemble kernel. This file is text: codegen fills in the marked bodies and constants and
# kernel.py compiles the result under a name made of its hash. It is not imported as it stands.
#
# A block of LANES trajectories advances together. A step in which a wheel's event lies (it stops, or breaks away) is
# repeated for that lane alone, in scalar code, up to the event, the wheel's mode is changed, and the rest of the step follows.
# ruff: noqa
# pyright: basic
import numpy as np
from numba import njit

LANES = "LANES"
N_WHEELS = "N_WHEELS"
N_STATE = "N_STATE"
ROWS = "ROWS"
NEW = "NEW"
DT = "DT"
INVERSE = "INVERSE"
WHEEL = "WHEEL"  # first wheel row
PER_WHEEL = "PER_WHEEL"
BINS = "BINS"
SAMPLES = "SAMPLES"
# rows of a wheel, from its first
FREE = "FREE"
COULOMB = "COULOMB"
INERTIA = "INERTIA"
WATCH = "WATCH"
INVERSE_LIMIT2 = "INVERSE_LIMIT2"
DRY = "DRY"
SPEED = "SPEED"
TORQUE = "TORQUE"
# outcomes
FINE = "FINE"
CHATTERS = "CHATTERS"
PAST_UNKNOWN = "PAST_UNKNOWN"
NOT_FINITE = "NOT_FINITE"
MAX_EVENTS_PER_STEP = 64
jit = njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract"})


@jit
def step(w):
    for j in range(LANES):
        pass  # STEP_LANES


@jit
def start(w):
    for j in range(LANES):
        pass  # START_LANES


@jit
def sample(w, normals, bins):
    for j in range(LANES):
        pass  # SAMPLE_LANES


@jit
def observe(w):
    missed = 0
    for j in range(LANES):
        pass  # OBSERVE_LANES
    return missed


@jit
def step_one(w):
    j = 0
    pass  # STEP_ONE


@jit
def observe_one(w):
    missed = 0
    j = 0
    pass  # OBSERVE_ONE
    return missed


@jit
def commit_one(w):
    for i in range(N_STATE):
        w[i] = w[NEW + i]


@jit
def set_modes(w, inverses):
    """Load the inverse inertia for the set of wheels that are now free."""
    free = 0
    for i in range(N_WHEELS):
        if w[WHEEL + PER_WHEEL * i + FREE] > 0.5:
            free |= 1 << i
    for k in range(6):
        w[INVERSE + k] = inverses[free * 6 + k]


@jit
def stick(w, i):
    at = WHEEL + PER_WHEEL * i
    w[at + FREE] = 0.0
    w[at + COULOMB] = 0.0
    w[at + WATCH] = 0.0
    w[at + INVERSE_LIMIT2] = 1.0 / (w[at + DRY] * w[at + DRY])


@jit
def slip(w, i, sign):
    at = WHEEL + PER_WHEEL * i
    w[at + FREE] = 1.0
    w[at + COULOMB] = sign * w[at + DRY]
    w[at + WATCH] = sign
    w[at + INVERSE_LIMIT2] = 0.0


@jit
def rest_momentum(w, i, omega):
    """h of wheel i at rest on the body."""
    at = WHEEL + PER_WHEEL * i
    w[3 + i] = w[at + INERTIA] * (w[at] * omega[0] + w[at + 1] * omega[1] + w[at + 2] * omega[2])


@jit
def body_rate(w, omega):
    """omega at the committed state, from the parameters in force."""
    j = 0
    pass  # OMEGA_ONE


@jit
def settle(w, inverses):
    """Release the stuck wheels that friction cannot hold, the most overloaded first."""
    omega = np.empty(3)
    for _ in range(N_WHEELS + 1):
        for i in range(N_STATE):
            w[NEW + i] = w[i]
        observe_one(w)
        worst, load = -1, 1.0
        for i in range(N_WHEELS):
            at = WHEEL + PER_WHEEL * i
            overload = w[at + TORQUE] * w[at + TORQUE] * w[at + INVERSE_LIMIT2]
            if overload > load:
                worst, load = i, overload
        if worst < 0:
            return
        sign = -1.0 if w[WHEEL + PER_WHEEL * worst + TORQUE] > 0 else 1.0
        body_rate(w, omega)
        rest_momentum(w, worst, omega)
        slip(w, worst, sign)
        set_modes(w, inverses)


@jit
def event_value(w, i, stuck):
    """Positive before the event of wheel i, negative after it."""
    at = WHEEL + PER_WHEEL * i
    if stuck:
        return 1.0 - w[at + TORQUE] * w[at + TORQUE] * w[at + INVERSE_LIMIT2]
    return w[at + WATCH] * w[at + SPEED]


@jit
def event_fraction(w, i):
    """Fraction of the step dt (in w) after which the event of wheel i happens: regula falsi, Illinois variant."""
    at = WHEEL + PER_WHEEL * i
    stuck = w[at + INVERSE_LIMIT2] > 0.0
    dt = w[DT]
    for k in range(N_STATE):
        w[NEW + k] = w[k]
    observe_one(w)
    low, f_low = 0.0, event_value(w, i, stuck)
    if f_low <= 0.0:
        return 0.0
    step_one(w)
    observe_one(w)
    high, f_high = 1.0, event_value(w, i, stuck)
    if f_high > 0.0:
        return 2.0
    for _ in range(60):
        middle = (low * f_high - high * f_low) / (f_high - f_low)
        if high - low < 1e-13 or f_high == 0.0:
            break
        w[DT] = middle * dt
        step_one(w)
        observe_one(w)
        f = event_value(w, i, stuck)
        if f > 0.0:
            if abs(f) < 1e-12 * abs(f_low):
                high = middle
                break
            low, f_low, f_high = middle, f, f_high * 0.5
        else:
            if abs(f) < 1e-14:
                high = middle
                break
            high, f_high, f_low = middle, f, f_low * 0.5
    w[DT] = dt
    return high


@jit
def through_events(w, inverses):
    """Redo the step of one lane through the wheel events inside it; returns its outcome."""
    left = w[DT]
    omega = np.empty(3)
    for _ in range(MAX_EVENTS_PER_STEP):
        w[DT] = left
        step_one(w)
        if observe_one(w) == 0:
            return FINE
        first, fraction = -1, 2.0
        for i in range(N_WHEELS):
            at = WHEEL + PER_WHEEL * i
            if w[at + WATCH] != 0.0 or w[at + INVERSE_LIMIT2] > 0.0:
                w[DT] = left
                theta = event_fraction(w, i)
                if theta < fraction:
                    first, fraction = i, theta
        if first < 0:
            w[DT] = left
            step_one(w)
            observe_one(w)
            return FINE
        w[DT] = fraction * left
        step_one(w)
        commit_one(w)
        before = left
        left -= fraction * left
        if before < 0.0:
            # backward in time a turning wheel meets zero only where it reversed: what can hold it never let it start
            slip(w, first, -w[WHEEL + PER_WHEEL * first + WATCH])
            continue
        stuck = w[WHEEL + PER_WHEEL * first + INVERSE_LIMIT2] > 0.0
        if not stuck:
            body_rate(w, omega)
            rest_momentum(w, first, omega)
            stick(w, first)
            set_modes(w, inverses)
        settle(w, inverses)
    return CHATTERS


@jit
def gather(w, one, j):
    for k in range(ROWS):
        one[k] = w[k * LANES + j]


@jit
def scatter(one, w, j, dt):
    for k in range(ROWS):
        w[k * LANES + j] = one[k]
    w[DT * LANES + j] = dt


@jit
def give_up(w):
    """Stop watching the wheels of a lane that failed, so that it costs no more; its outcome says why."""
    for i in range(N_WHEELS):
        w[WHEEL + PER_WHEEL * i + WATCH] = 0.0
        w[WHEEL + PER_WHEEL * i + INVERSE_LIMIT2] = 0.0


@jit
def settle_all(w, one, inverses):
    """Before the first step: wheels at rest may have to slip at once."""
    for j in range(LANES):
        gather(w, one, j)
        settle(one, inverses[j])
        scatter(one, w, j, one[DT])


@jit
def repair(w, one, inverses, outcome):
    """Redo the step for each lane in which an event was missed."""
    for j in range(LANES):
        missed = False
        for i in range(N_WHEELS):
            at = (WHEEL + PER_WHEEL * i) * LANES + j
            torque = w[at + TORQUE * LANES]
            missed |= w[at + WATCH * LANES] * w[at + SPEED * LANES] < 0.0
            missed |= torque * torque * w[at + INVERSE_LIMIT2 * LANES] > 1.0
        if missed:
            gather(w, one, j)
            dt = one[DT]
            result = through_events(one, inverses[j])
            if result != FINE:
                give_up(one)
                outcome[j] = result
                one[DT] = dt
                step_one(one)
                observe_one(one)
            scatter(one, w, j, dt)


@jit
def run(w, inverses, normals, steps, dts, hist, track, outcome):
    """Advance one block.

    w (ROWS * LANES), inverses (LANES, 2^n * 6), steps and dts (n_segment): each segment is steps[s] steps of dts[s]
    seconds; hist (LANES, BINS + 1) is added to after each step; track (n_segment, N_STATE, LANES), if it has room, takes
    the state after each segment; outcome (LANES).
    """
    one = np.zeros(ROWS)
    bins = np.zeros(SAMPLES * LANES, dtype=np.int32)
    if N_WHEELS and dts[-1] > 0.0:
        settle_all(w, one, inverses)
    for i in range(N_WHEELS):
        for j in range(LANES):
            if dts[-1] < 0.0 and w[(WHEEL + PER_WHEEL * i + INVERSE_LIMIT2) * LANES + j] > 0.0:
                outcome[j] = PAST_UNKNOWN
    if BINS:
        start(w)
    for s in range(steps.size):
        for j in range(LANES):
            w[DT * LANES + j] = dts[s]
        for _ in range(steps[s]):
            step(w)
            if N_WHEELS:
                if observe(w):
                    repair(w, one, inverses, outcome)
            if BINS:
                sample(w, normals, bins)
                for j in range(LANES):
                    for m in range(SAMPLES):
                        hist[j, bins[m * LANES + j]] += 1
            for k in range(N_STATE * LANES):
                w[k] = w[NEW * LANES + k]
        if s < track.shape[0]:
            for k in range(N_STATE):
                for j in range(LANES):
                    track[s, k, j] = w[k * LANES + j]
    for j in range(LANES):
        for k in range(N_STATE):
            if not np.isfinite(w[k * LANES + j]) and outcome[j] == FINE:
                outcome[j] = NOT_FINITE


@jit
def emd_rows(hist, bin_of, low, high, level, emd, seen):
    """EMD of each row's histogram to a target: half the integral of |C_r - C_n| over [-1, 1] (paper, eq. 13).

    C_r is linear inside a bin. The target's CDF is constant on segments: segment s lies in bin bin_of[s] from fraction
    low[s] to high[s] of that bin, with C_n = level[s]. A row that was never seen gets NaN in emd and 0 in seen.
    """
    width = 2.0 / BINS
    for j in range(hist.shape[0]):
        total = 0
        for b in range(BINS):
            total += hist[j, b]
        seen[j] = total
        if total == 0:
            emd[j] = np.nan
            continue
        below, current, area = 0.0, 0, 0.0
        for s in range(bin_of.size):
            while current < bin_of[s]:
                below += hist[j, current] / total
                current += 1
            slope = hist[j, current] / total
            a = below + slope * low[s] - level[s]
            b = below + slope * high[s] - level[s]
            length = (high[s] - low[s]) * width
            if a * b >= 0.0:
                area += 0.5 * abs(a + b) * length
            else:
                area += 0.5 * (a * a + b * b) / abs(b - a) * length
        emd[j] = 0.5 * area
