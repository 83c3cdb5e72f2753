# Between a row of numbers in body axes and lane j in the principal axes of its mode (split_lanes.py, principal.py). Text that is
# put into the driver (compiled.py); it is not imported as it stands.
# ruff: noqa
# pyright: basic


@jit
def relaxed(x):
    """(1 - exp(-x)) / x."""
    return -math.expm1(-x) / x if abs(x) > 1e-6 else 1.0 - 0.5 * x


@jit
def load(one, w, v, j):
    """The state of a row into lane j, with the lane's parameters."""
    r = 3 + N_WHEELS
    for k in range(3):
        at = FRAME + 3 + 3 * k
        a, b, c = one[at], one[at + 1], one[at + 2]
        w[(S_STATE + k) * LANES + j] = a * one[0] + b * one[1] + c * one[2]
        w[(S_STATE + r + k) * LANES + j] = a * one[r] + b * one[r + 1] + c * one[r + 2]
        w[(S_HELD + k) * LANES + j] = a * one[HELD] + b * one[HELD + 1] + c * one[HELD + 2]
        w[(S_INVERSE + k) * LANES + j] = one[FRAME + k]
        for l in range(3):
            w[(S_AXES + 3 * k + l) * LANES + j] = one[at + l]
        for i in range(N_WHEELS):
            axis = WHEEL + PER_WHEEL * i
            to = S_WHEEL + LANE_WHEEL_ROWS * i
            w[(to + k) * LANES + j] = a * one[axis] + b * one[axis + 1] + c * one[axis + 2]
    w[S_DIFFERENCE * LANES + j] = one[FRAME] - one[FRAME + 1]
    w[(S_DIFFERENCE + 1) * LANES + j] = one[FRAME + 2] - one[FRAME + 1]
    square = one[0] * one[0] + one[1] * one[1] + one[2] * one[2]
    w[S_SIZE * LANES + j] = 1.0 / square if square > 0.0 else 0.0
    dt = one[DT]
    w[S_DT * LANES + j] = dt
    v[V_DT * LANES + j] = dt
    for i in range(N_WHEELS):
        w[(S_STATE + 3 + i) * LANES + j] = one[3 + i]
        w[(S_LOW + i) * LANES + j] = 0.0
        at, to = WHEEL + PER_WHEEL * i, S_WHEEL + LANE_WHEEL_ROWS * i
        for k in range(3, LANE_WHEEL_ROWS):
            w[(to + k) * LANES + j] = one[at + k]
        rate = one[at + FREE] * one[at + VISCOUS] * one[at + INVERSE_INERTIA]
        for k in range(len(TIMES)):
            t = TIMES[k] * dt
            w[(S_WEAR + len(TIMES) * i + k) * LANES + j] = t * relaxed(rate * t)
    load_turn(one, w, j)


@jit
def unload(w, first, one, j):
    """The state of lane j whose rows begin at `first` into a row."""
    r = 3 + N_WHEELS
    for k in range(3):
        one[k] = 0.0
        one[r + k] = 0.0
        for l in range(3):
            one[k] += one[FRAME + 3 + 3 * l + k] * w[(first + l) * LANES + j]
            one[r + k] += one[FRAME + 3 + 3 * l + k] * w[(first + r + l) * LANES + j]
    for i in range(N_WHEELS):
        one[3 + i] = w[(first + 3 + i) * LANES + j]
