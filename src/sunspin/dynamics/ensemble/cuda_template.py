# The entry of the generated kernels on a GPU, in the place of the driver's `run` (cuda.py): one thread for one trajectory. Text
# that is put behind the driver's; it is not imported as it stands.
# ruff: noqa
# pyright: basic


@cuda.jit(cache=True)
def run(work, plans, begins, modes, normals, steps, dts, output, hist, track, outcome, evenness):
    """Advance the rows of `work` (n, ROWS), each by the plan plans[i] (n) of its own.

    Plan p is the segments begins[p] to begins[p + 1] of steps, dts and output, which are, like modes and normals, as in the
    driver. hist (n, BINS), track (n, n_output, what is told), outcome (n) and evenness (n) are written, with zeros first.
    """
    i = cuda.grid(1)
    if i >= plans.size:
        return
    rows = cuda.local.array((LANES, ROWS), np.float64)
    w = cuda.local.array(S_ROWS, FLOAT)
    v = cuda.local.array(V_ROWS, np.float32)
    bins = cuda.local.array(3, np.int32)
    weights = cuda.local.array(2, np.float32)
    index = cuda.local.array(1, np.int64)
    for k in range(ROWS):
        rows[0, k] = 0.0
    for k in range(S_ROWS):
        w[k] = 0.0
    for k in range(V_ROWS):
        v[k] = 0.0
    for k in range(BINS):
        hist[i, k] = 0.0
    index[0] = i
    evenness[i] = 1.0
    begin = begins[plans[i]]
    end = begins[plans[i] + 1]
    run_block(
        work,
        index,
        modes,
        normals,
        steps[begin:end],
        dts[begin:end],
        output[begin:end],
        rows,
        w,
        v,
        bins,
        weights,
        hist[i],
        track,
        outcome[i : i + 1],
        evenness[i : i + 1],
    )
