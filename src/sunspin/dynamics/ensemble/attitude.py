"""Attitude and momentum of many bodies over one interval each, compiled: the step of the smoother of :mod:`sunspin.estimate.rates`.

Wheels enter by their momentum, a magnetic field by the torque of a dipole in it, both linear in time over the interval. The
equations are traced from :mod:`sunspin.dynamics.gyrostat`, as for the kernels of whole trajectories.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.ensemble.codegen import assignments
from sunspin.dynamics.ensemble.compiled import kept_text, module_of, template
from sunspin.dynamics.ensemble.compiler import compiler
from sunspin.dynamics.torques.acting import Torque, directions_of, n_carried, n_parameters, outside
from sunspin.solve.linear import symmetric_inverse

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

NUMBERS = 19
"""Before the torques' own: inverse inertia (6), inertia (3, 3), dipole (3), and the unit of the momentum."""


def n_directions(torques: Sequence[Torque]) -> int:
    """Numbers of the state that directions in space take: the Sun's, and what torques carry; none where none acts."""
    return 3 + n_carried(torques) if torques else 0


def in_unit(one: g.OutsideTorque, unit: g.Scalar) -> g.OutsideTorque:
    """A torque in N m on a body whose momentum is counted in `unit` times N m s."""

    def torque(*given: Any) -> list[g.Scalar]:
        return [x / unit for x in one.torque(*given)]

    return one._replace(torque=torque)


def slopes(torques: Sequence[Torque], pulled: bool) -> list[str]:
    """Text that turns the state z = (H, directions, quaternion) into its derivatives d; `pulled`: a dipole is in a field."""
    n = n_directions(torques)
    names = [f"z_{i}" for i in range(3 + n + 4)]
    state, held, pull = sp.symbols(names), sp.symbols("load_0:3"), sp.symbols("pull_0:3")
    numbers, clock = sp.symbols(f"number_0:{NUMBERS + n_parameters(torques)}"), sp.Symbol("time")
    H, q = state[:3], state[3 + n :]
    acting = [in_unit(one, numbers[18]) for one in outside(torques, numbers[NUMBERS:])]
    p = g.Parameters(tuple(numbers[:6]), held, (), tuple(acting))
    omega = g.body_rate(H, (), p)
    directions = directions_of(torques, state[3 : 3 + n]) if torques else {}
    change = list(g.momentum_rate(H, omega, directions, p, clock))
    if pulled:
        inertia, torque = sp.Matrix(3, 3, numbers[6:15]), sp.Matrix(g.cross(numbers[15:18], pull))
        change = [c + x for c, x in zip(change, inertia * torque, strict=True)]
    moved = [x for direction in directions.values() for x in g.direction_rate(direction, omega)]
    derivatives = [*change, *moved, *g.quaternion_rate(q, omega)]
    used = set().union(*(sp.sympify(d).free_symbols for d in derivatives))
    given = [("z", state), ("load", held), ("pull", pull), ("numbers", numbers)]
    lines = [
        f"{symbol} = {name}[{k}]"
        for name, symbols in given
        for k, symbol in enumerate(symbols)
        if symbol in used
    ]
    return lines + assignments([f"d[{k}]" for k in range(len(derivatives))], derivatives, "x")


@lru_cache(maxsize=32)
def attitude_kernel(torques: tuple[Torque, ...], pulled: bool) -> Callable[..., None]:
    """The compiled `run` of attitude_template.py."""
    return module_of(
        kept_text(("attitude", torques, pulled), lambda: source(torques, pulled)), compiler()
    ).run


def source(torques: tuple[Torque, ...], pulled: bool) -> str:
    """Its text."""
    text = template("attitude").replace(
        '\nN_STATE = "N_STATE"', f"\nN_STATE = {7 + n_directions(torques)}"
    )
    indent = " " * 16
    body = "\n".join(indent + line for line in slopes(torques, pulled))
    return text.replace(f"{indent}pass  # SLOPE", body)


def carry(
    states: np.ndarray,
    dt: np.ndarray,
    counts: np.ndarray,
    held: Sequence[np.ndarray],
    field: Sequence[np.ndarray],
    clock: np.ndarray,
    numbers: Sequence[np.ndarray],
    torques: tuple[Torque, ...],
) -> np.ndarray:
    """States (n, n_state) after dt (n) s.

    Parameters
    ----------
    states : (n, 3 + n_directions + 4)
        Momentum, directions that the torques need, quaternion B_from_N with the scalar last.
    counts : (n) int
        Runge-Kutta steps of each.
    held, field
        Momentum of the wheels, magnetic field: (n, 3) at the start and at the end, in the body; `field` empty: no pull.
    clock : (n)
        Time at the start, s, on the clock of the torques' environment.
    numbers
        Inertia (3, 3), dipole (3) whose cross product with the field is an angular acceleration, unit of the momentum in N m s,
        and the parameters of the torques, whose own unit is N m.
    """
    inertia, dipole, unit, more = numbers
    given = np.concatenate(
        [symmetric_inverse(inertia), np.ravel(inertia), dipole, np.ravel(unit), np.ravel(more)]
    )
    ends = [np.ascontiguousarray(part, dtype=np.float64) for part in (*held, *(field or held))]
    moved = np.array(states, dtype=np.float64, order="C")
    run = attitude_kernel(torques, bool(field))
    run(
        moved,
        np.ascontiguousarray(dt),
        np.ascontiguousarray(counts),
        *ends,
        np.ascontiguousarray(clock),
        given,
    )
    return moved
