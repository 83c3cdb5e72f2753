# Between a row of numbers and lane j, both in body axes (series_lanes.py). Text that is put into the driver (compiled.py); it is
# not imported as it stands.
# ruff: noqa
# pyright: basic


@jit
def load(one, w, v, j):
    """The state of a row into lane j, with the lane's parameters."""
    for k in range(N_STATE):
        w[(S_STATE + k) * LANES + j] = one[k]
    w[S_DT * LANES + j] = one[DT]
    v[V_DT * LANES + j] = one[DT]
    w[S_SPIN * LANES + j] = one[SPIN]
    for k in range(6):
        w[(S_INVERSE + k) * LANES + j] = one[INVERSE + k]
    for k in range(3):
        w[(S_HELD + k) * LANES + j] = one[HELD + k]
    for i in range(N_WHEELS):
        for k in range(LANE_WHEEL_ROWS):
            w[(S_WHEEL + LANE_WHEEL_ROWS * i + k) * LANES + j] = one[WHEEL + PER_WHEEL * i + k]
    pass  # LOAD_TORQUES
    load_turn(one, w, j)


@jit
def unload(w, first, one, j):
    """The state of lane j whose rows begin at `first` into a row."""
    for k in range(N_STATE):
        one[k] = w[(first + k) * LANES + j]
