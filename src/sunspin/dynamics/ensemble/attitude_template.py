# Attitude and momentum of many bodies, each over its own interval, by classical Runge-Kutta steps (attitude.py). Text that a
# kernel is made of; it is not imported as it stands.
# ruff: noqa
# pyright: basic

import numpy as np

from sunspin.dynamics.ensemble.compiler import njit

N_STATE = "N_STATE"


@njit(cache=True, nogil=True, error_model="numpy", fastmath={"contract", "nsz"})
def run(states, dt, counts, held, held_end, field, field_end, clock, numbers):
    """Take each row of `states` over its dt in its number of steps; what acts is linear in time between its two ends."""
    y, z, sums, d = np.empty(N_STATE), np.empty(N_STATE), np.empty(N_STATE), np.empty(N_STATE)
    load, pull = np.empty(3), np.empty(3)
    for i in range(len(states)):
        for m in range(N_STATE):
            y[m] = states[i, m]
        h = dt[i] / counts[i]
        for k in range(counts[i]):
            for m in range(N_STATE):
                z[m] = y[m]
                sums[m] = 0.0
            for stage in range(4):
                s = (k + 0.5 * ((stage + 1) // 2)) / counts[i]
                for m in range(3):
                    load[m] = (1.0 - s) * held[i, m] + s * held_end[i, m]
                    pull[m] = (1.0 - s) * field[i, m] + s * field_end[i, m]
                time = clock[i] + s * dt[i]
                pass  # SLOPE
                share = 1.0 if stage == 0 or stage == 3 else 2.0
                reach = h if stage == 2 else 0.5 * h
                for m in range(N_STATE):
                    sums[m] += share * d[m]
                    z[m] = y[m] + reach * d[m]
            for m in range(N_STATE):
                y[m] += h / 6.0 * sums[m]
        for m in range(N_STATE):
            states[i, m] = y[m]
