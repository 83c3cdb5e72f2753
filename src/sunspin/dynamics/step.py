"""Attitude and rate of many bodies, each over its own interval: the integration of :func:`sunspin.estimate.carry.step`.

The equations are those of a body without torques, with the momentum of its wheels given
(:mod:`sunspin.dynamics.kernels.intervals`). All wheels count as held, so that A is the inertia with locked wheels. Friction enters
through the momentum alone: the caller computes how the wheels run down (`wheel_speeds` in :mod:`sunspin.estimate.observe`). The
momentum is linear in time from one end of the interval to the other, in body axes. The method is that of Runge and Kutta, of fourth
order, with steps of fixed length: derivatives are computed as differences of runs, and with other steps in each run they would be
those of the integration errors. Momenta are in units of mean moment of inertia times rad/s.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from sunspin.dynamics.machine_code import compiled_function
from sunspin.solve.linear import symmetric_inverse

SOURCES = ("kernels/intervals.py", "processor.py")
"""Files of this package that the machine code is compiled from. They import numba, and so are not imported here."""

ARRAYS, SIZES = "ddiddddd", 4
"""Arguments of the compiled function: its arrays, of float64 (d) and int64 (i), and how many sizes follow them."""


def carry_bodies(
    inertia: np.ndarray,
    omega: np.ndarray,
    dt_s: np.ndarray,
    counts: np.ndarray,
    momenta: tuple[np.ndarray, np.ndarray],
) -> tuple[np.ndarray, np.ndarray]:
    """Return attitudes and rates after n intervals, for r runs of K motions; each interval starts with its own rate.

    Attitudes (r, K, n, 3, 3) are rotation matrices from body axes at the start of the interval to those at its end.

    Parameters
    ----------
    inertia : (r, K, 3, 3) or (r, 1, 3, 3)
        In mean moments of inertia, for each motion of each run, or for all motions of a run.
    omega : (r, K, n, 3), rad/s
        Rates at the start of each interval.
    dt_s : (n) or, for each motion, (K, n)
        Length of the intervals, s; may be negative.
    counts : (K, n)
        Number of steps, the same in all runs.
    momenta : two (n, 3)
        Momentum of the wheels at the start and at the end of each interval.
    """
    rates = np.array(omega, dtype=np.float64, order="C")
    attitudes = np.empty((*rates.shape, 3))
    runs, motions, n = rates.shape[:3]
    bodies = inertia.shape[1]
    # the compiled code gets addresses alone, so shapes are made sure of here
    arrays = (
        rates,
        _plain(dt_s, (motions, n)),
        _plain(counts, (motions, n), np.int64),
        *(_plain(momentum, (n, 3)) for momentum in momenta),
        _plain(inertia, (runs, bodies, 3, 3)),
        _plain(symmetric_inverse(inertia), (runs, bodies, 6)),
        attitudes,
    )
    _carry()(*(array.ctypes.data for array in arrays), runs, motions, n, bodies)
    return attitudes, rates


@cache
def _carry() -> Callable[..., Any]:
    """Return the compiled function :func:`sunspin.dynamics.kernels.intervals.carry`."""
    return compiled_function("intervals", SOURCES, (len(ARRAYS), SIZES), _compile)


def _compile() -> tuple[str, bytes]:
    """Compile the step, and return its name and object code. Only this imports numba."""
    from sunspin.dynamics.kernels.intervals import carry
    from sunspin.dynamics.processor import object_code

    print("compiling the step of rates, once (some 2 s)", file=sys.stderr, flush=True)
    return object_code(carry, ARRAYS, SIZES)


def load() -> None:
    """Load the compiled step, or compile it. Done before a process is forked, it is not repeated in each child."""
    _carry()


def _plain(values: np.ndarray, shape: tuple[int, ...], kind: type = np.float64) -> np.ndarray:
    """Return values as a contiguous array of a shape, to which they are broadcast if they have another one."""
    if values.shape != shape:
        values = np.broadcast_to(values, shape)
    return np.ascontiguousarray(values, kind)
