"""From the equations to the source of the ensemble kernels.

The functions of :mod:`sunspin.dynamics.gyrostat` are traced with SymPy symbols, common subexpressions are named, and the
result is printed as straight-line scalar code: inside a loop over lanes, which LLVM turns into vector instructions, or for one
trajectory alone. Numbers of a vehicle are run-time parameters (so that one kernel serves every vehicle with the same
structure); exact zeros and ones among axis and normal components are structure and disappear from the code.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.ensemble.series import Recurrence
from sunspin.dynamics.torques.acting import (
    Torque,
    carried_names,
    directions_of,
    n_carried,
    n_parameters,
    outside,
    spun,
)
from sunspin.vehicle.response.planes import Clause

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

Component = int | None
Components = tuple[Component, Component, Component]


@dataclass(frozen=True)
class Structure:
    """All that the source depends on. Components are 0, 1, -1, or None for a run-time number."""

    axes: tuple[Components, ...]
    normals: tuple[Components, ...] = ()
    mask: tuple[Clause, ...] = ()  # disjunction; empty means every direction counts
    bins: int = 0  # 0: no histogram
    method: str = "series"  # or "split"
    oblique: bool = True  # split: whether a wheel has a component along the principal axis q
    torques: tuple[Torque, ...] = ()

    @property
    def masked(self) -> bool:
        """Whether some directions do not count."""
        return bool(self.mask)

    @property
    def precision(self) -> str:
        return "float32" if self.method == "split" else "float64"

    @property
    def layout(self) -> RowLayout:
        return RowLayout.under(self.torques, len(self.axes))

    @property
    def spin(self) -> sp.Expr:
        """The share of H in omega that is taken out: none where torques turn H in space, unless an axis stands for it."""
        return sp.Symbol("spin") if self.spun or not self.torques else sp.Integer(0)

    @property
    def spun(self) -> bool:
        """Whether r turns about an axis of its own (:func:`sunspin.dynamics.torques.acting.spun`)."""
        return spun(self.torques)

    @property
    def axis(self) -> int:
        """Where in the state the vector begins about which r turns: H, or what stands for it."""
        return self.layout.r + 6 if self.spun else 0


@dataclass(frozen=True)
class RowLayout:
    """Where each quantity of one trajectory lives in its row of numbers."""

    n_wheels: int
    n_more: int = 0  # of the state, behind r, where torques act: their directions, and the time
    n_parameters: int = 0  # of those torques

    @classmethod
    def under(cls, torques: Sequence[Torque], n_wheels: int) -> RowLayout:
        """With the torques that act."""
        return cls(n_wheels, n_carried(torques) + 1 if torques else 0, n_parameters(torques))

    @property
    def h(self) -> int:
        return 3

    @property
    def r(self) -> int:
        return 3 + self.n_wheels

    @property
    def n_state(self) -> int:
        return 6 + self.n_wheels + self.n_more

    @property
    def new(self) -> int:
        """State after the step just tried; same order as the state."""
        return self.n_state

    @property
    def dt(self) -> int:
        return 2 * self.n_state

    @property
    def body(self) -> int:
        """Which of the tables of modes is the row's."""
        return self.dt + 1

    @property
    def spin(self) -> int:
        """The share of H in omega that is taken out, 1/(kg m2)."""
        return self.body + 1

    @property
    def inverse(self) -> int:
        return self.spin + 1

    @property
    def frame(self) -> int:
        """Principal inverse moments (3) and axes (3, 3)."""
        return self.inverse + 6

    @property
    def held(self) -> int:
        return self.frame + 12

    def wheel(self, i: int) -> int:
        """First of the rows of wheel i, in the order of `WHEEL_ROWS`."""
        return self.held + 3 + len(WHEEL_ROWS) * i

    def of(self, i: int, name: str) -> int:
        """The row of one quantity of wheel i."""
        return self.wheel(i) + WHEEL_ROWS.index(name)

    @property
    def n_output(self) -> int:
        """What is told of a trajectory at an instant: its state, omega, and the wheels' speeds."""
        return self.n_state + 3 + self.n_wheels

    @property
    def torques(self) -> int:
        """Parameters of the torques, behind all else."""
        return self.wheel(self.n_wheels)

    @property
    def count(self) -> int:
        return self.torques + self.n_parameters


WHEEL_ROWS = (
    "axis_x",
    "axis_y",
    "axis_z",
    "inverse_inertia",
    "free",
    "coulomb",
    "viscous",  # as in gyrostat.WheelParameters
    "inertia",
    "watch",  # sign of the speed while a stop must be watched for, else 0
    "inverse_limit2",  # 1 / limit^2 while stuck, else 0
    "dry",  # friction limit in N m (Coulomb and brake)
    "kept",  # speed of a wheel that is not free
    "speed",  # output: W
    "torque",  # output: holding torque
)


def component(value: float) -> Component:
    """The structural part of an axis component: 0, 1 or -1 exactly, else None (a run-time number)."""
    return int(value) if value in (0.0, 1.0, -1.0) else None


def components(vector: Iterable[float]) -> Components:
    """The structural parts of three components."""
    x, y, z = (component(value) for value in vector)
    return x, y, z


@lru_cache(maxsize=1)
def _printer() -> Any:
    """A printer that writes powers as products: exact, and vectorised everywhere."""
    from sympy.printing.pycode import PythonCodePrinter

    class Printer(PythonCodePrinter):
        def _print_Pow(self, expr: sp.Pow, rational: bool = False) -> str:
            if isinstance(expr.exp, sp.Integer) and 1 < int(expr.exp) <= 4:
                base = self._print(expr.base)
                base = base if expr.base.is_Symbol else f"({base})"
                return "*".join([base] * int(expr.exp))
            return super()._print_Pow(expr, rational)

    return Printer()


def assignments(names: list[str], expressions: list[Any], prefix: str) -> list[str]:
    """Straight-line assignments of the expressions to the names, common subexpressions first."""
    shared, final = sp.cse(expressions, symbols=sp.numbered_symbols(prefix))
    printer = _printer()
    lines = [f"{symbol} = {printer.doprint(expression)}" for symbol, expression in shared]
    return lines + [
        f"{name} = {printer.doprint(sp.sympify(e))}" for name, e in zip(names, final, strict=True)
    ]


def wheel_symbols(i: int, axis: Components) -> g.WheelParameters:
    """Wheel i: parameters u<i>_<k>, iJ<i>, free<i>, coul<i>, visc<i>."""
    parts = [sp.Integer(c) if c is not None else sp.Symbol(f"u{i}_{k}") for k, c in enumerate(axis)]
    inverse_inertia, free, coulomb, viscous = (
        sp.Symbol(f"{name}{i}") for name in ("iJ", "free", "coul", "visc")
    )
    return g.WheelParameters(tuple(parts), inverse_inertia, free, coulomb, viscous)


def parameter_symbols(structure: Structure) -> g.Parameters:
    """The parameters in body axes."""
    wheels = tuple(wheel_symbols(i, axis) for i, axis in enumerate(structure.axes))
    acting = outside(structure.torques, torque_symbols(structure))
    return g.Parameters(tuple(sp.symbols("inv0:6")), tuple(sp.symbols("held0:3")), wheels, acting)


def torque_symbols(structure: Structure) -> tuple[sp.Symbol, ...]:
    """Parameters of the torques."""
    return tuple(sp.Symbol(f"torque_{k}") for k in range(n_parameters(structure.torques)))


TIME = "clock"
"""Time (s) on the clock of the torques' environment: part of the state, so that it has a series too."""


def state_names(structure: Structure) -> list[str]:
    more = [*carried_names(structure.torques), TIME] if structure.torques else []
    return [
        "H0",
        "H1",
        "H2",
        *(f"h{i}" for i in range(len(structure.axes))),
        "r0",
        "r1",
        "r2",
        *more,
    ]


def momentum_names(structure: Structure) -> list[str]:
    """Of the state, what holding torques depend on: H, h, and all of it where torques act."""
    return state_names(structure)[: None if structure.torques else 3 + len(structure.axes)]


def state_symbols(
    structure: Structure,
) -> tuple[tuple[sp.Symbol, ...], tuple[sp.Symbol, ...], dict[str, g.Direction]]:
    """H, h, and the directions, that of the Sun first."""
    n, symbols = len(structure.axes), tuple(sp.Symbol(name) for name in state_names(structure))
    directions = directions_of(structure.torques, symbols[3 + n :])
    if structure.spun:
        directions = {name: g.Direction(direction.vector) for name, direction in directions.items()}
    return symbols[:3], symbols[3 : 3 + n], directions


def axis_symbols(structure: Structure) -> tuple[sp.Symbol, ...]:
    """The vector about which r turns."""
    return tuple(
        sp.Symbol(name) for name in state_names(structure)[structure.axis : structure.axis + 3]
    )


def load_parameters(structure: Structure, at: Callable[[str, int], str]) -> Iterator[str]:
    """Assign the parameters in body axes; `at` gives the place of a quantity ("inverse", "held", "spin", "torques" or of a wheel)
    by index."""
    yield f"spin = {at('spin', 0)}"
    yield from (f"inv{k} = {at('inverse', k)}" for k in range(6))
    yield from (f"held{k} = {at('held', k)}" for k in range(3))
    for i, axis in enumerate(structure.axes):
        yield from (
            f"u{i}_{k} = {at('axis_' + 'xyz'[k], i)}" for k, c in enumerate(axis) if c is None
        )
        named = (
            ("iJ", "inverse_inertia"),
            ("free", "free"),
            ("coul", "coulomb"),
            ("visc", "viscous"),
        )
        yield from (f"{symbol}{i} = {at(name, i)}" for symbol, name in named)
    yield from (
        f"{symbol} = {at('torques', k)}" for k, symbol in enumerate(torque_symbols(structure))
    )


def recurrence(structure: Structure) -> Recurrence:
    """The Taylor coefficients of the motion, r seen from axes that turn about H."""
    axis = axis_symbols(structure) if structure.spun else None
    dH, dh, dr = g.rhs(
        *state_symbols(structure),
        parameter_symbols(structure),
        sp.Symbol(TIME),
        structure.spin,
        axis,
    )
    return Recurrence(
        state_names(structure), [*dH, *dh, *dr, *([sp.Integer(1)] if structure.torques else [])]
    )


# ---- one trajectory, in its row of numbers -------------------------------------------------------------------------------


def _in_row(layout: RowLayout) -> Callable[[str, int], str]:
    def at(name: str, k: int) -> str:
        known = {
            "inverse": layout.inverse,
            "held": layout.held,
            "spin": layout.spin,
            "torques": layout.torques,
        }
        place = known[name] + k if name in known else None
        return f"w[{layout.of(k, name) if place is None else place}]"

    return at


def step_one_body(structure: Structure, order: int) -> list[str]:
    """One Taylor step of the row w; r is left in the axes that have turned about H. In loops: it is compiled for every kernel."""
    layout, steps = structure.layout, recurrence(structure)
    lines = [*load_parameters(structure, _in_row(layout)), f"dt = w[{layout.dt}]"]
    lines += [f"series = np.empty(({steps.loop_rows()}, {order + 1}))"]
    lines += [f"series[{i}, 0] = w[{i}]" for i in range(layout.n_state)]
    lines += steps.loop_lines(order)
    lines += [
        f"for i in range({layout.n_state}):",
        "    value = 0.0",
        f"    for k in range({order}, -1, -1):",
    ]
    return lines + ["        value += series[i, k]", f"    w[{layout.new} + i] = value"]


def spin_one_body(structure: Structure) -> list[str]:
    """Turn r of the new state about its H."""
    layout = structure.layout
    r, axis = layout.new + layout.r, layout.new + structure.axis
    lines = [f"H{k} = w[{axis + k}]" for k in range(3)] + [f"r{k} = w[{r + k}]" for k in range(3)]
    turned = g.spun(sp.symbols("H0:3"), sp.symbols("r0:3"), *sp.symbols("cosine sine along"))
    return lines + assignments([f"w[{r + k}]" for k in range(3)], list(turned), "t")


def about_body(structure: Structure) -> list[str]:
    """Of the vector about which r, whose place is in `r`, turns: its square, and its product with r."""
    x, y, z = (f"one[{structure.axis + k}]" for k in range(3))
    return [
        f"square = {x} * {x} + {y} * {y} + {z} * {z}",
        f"along = {x} * one[r] + {y} * one[r + 1] + {z} * one[r + 2]",
    ]


def observe_one_body(structure: Structure) -> list[str]:
    """At the new state of the row: wheel speeds and holding torques, and whether an event was missed."""
    n = len(structure.axes)
    if not n:
        return []
    layout = structure.layout
    H, h, directions = state_symbols(structure)
    p = parameter_symbols(structure)
    omega = g.body_rate(H, h, p)
    lines = [f"{name} = w[{layout.new + i}]" for i, name in enumerate(momentum_names(structure))]
    lines += load_parameters(structure, _in_row(layout))
    lines += [f"J{i} = w[{layout.of(i, 'inertia')}]" for i in range(n)]
    speeds = [g.wheel_speed(h[i], omega, p.wheels[i]) for i in range(n)]
    torques = [
        g.holding_torque(H, h, p, p.wheels[i], sp.Symbol(f"J{i}"), directions, sp.Symbol(TIME))
        for i in range(n)
    ]
    lines += assignments(
        [*(f"speed{i}" for i in range(n)), *(f"torque{i}" for i in range(n))], speeds + torques, "b"
    )
    tests = []
    for i in range(n):
        lines.append(f"w[{layout.of(i, 'speed')}] = speed{i}")
        lines.append(f"w[{layout.of(i, 'torque')}] = torque{i}")
        tests.append(f"(w[{layout.of(i, 'watch')}] * speed{i} < 0.0)")
        tests.append(f"(torque{i} * torque{i} * w[{layout.of(i, 'inverse_limit2')}] > 1.0)")
    return [*lines, f"missed = 1 if {' | '.join(tests)} else 0"]


def omega_body(structure: Structure) -> list[str]:
    """The body rate of the committed state of the row, into omega."""
    n = len(structure.axes)
    H, h, _ = state_symbols(structure)
    lines = [f"{name} = w[{i}]" for i, name in enumerate(state_names(structure)[: 3 + n])]
    lines += load_parameters(structure, _in_row(structure.layout))
    omega = g.body_rate(H, h, parameter_symbols(structure))
    return lines + assignments([f"omega[{k}]" for k in range(3)], list(omega), "c")


def speeds_body(structure: Structure) -> list[str]:
    """The wheels' speeds of the committed state of the row, which turns at omega, into speeds."""
    n = len(structure.axes)
    layout, p = structure.layout, parameter_symbols(structure)
    lines = [f"h{i} = w[{3 + i}]" for i in range(n)] + [f"o{k} = omega[{k}]" for k in range(3)]
    lines += load_parameters(structure, _in_row(layout))
    free = [g.wheel_speed(sp.Symbol(f"h{i}"), sp.symbols("o0:3"), p.wheels[i]) for i in range(n)]
    lines += assignments([f"turning{i}" for i in range(n)], free, "c")
    return lines + [
        f"speeds[{i}] = turning{i} if free{i} > 0.5 else w[{layout.of(i, 'kept')}]"
        for i in range(n)
    ]
