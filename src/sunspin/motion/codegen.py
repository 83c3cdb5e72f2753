"""From the equations to the source of the ensemble kernel.

The functions of :mod:`sunspin.motion.gyrostat` are traced with SymPy symbols, common subexpressions are named, and the
result is printed as straight-line scalar code inside a loop over lanes, which LLVM turns into vector instructions. Numbers
of a vehicle are run-time parameters (so that one kernel serves every vehicle with the same structure); exact zeros and ones
among axis and normal components are structure and disappear from the code.

The work array of a block is one flat float64 array, row r of lane j at ``r * LANES + j``: one base pointer with constant
offsets is what lets LLVM prove that rows do not overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import sympy as sp
from scipy.integrate import DOP853
from sympy.printing.pycode import PythonCodePrinter

from sunspin.motion import gyrostat as g

Literals = tuple[tuple[int, bool], ...]  # a conjunction: (panel index, lit?) ...


@dataclass(frozen=True)
class Structure:
    """All that the source depends on: axis patterns of the wheels, the mask, bins, lanes. Components: 0, 1, -1 or None."""

    axes: tuple[tuple[int | None, int | None, int | None], ...]
    normals: tuple[tuple[int | None, int | None, int | None], ...] = ()
    mask: tuple[Literals, ...] = ()  # disjunction; empty means every direction counts
    bins: int = 0  # 0: no histogram
    samples: int = 4  # of r_z per step, for the histogram
    lanes: int = 16


@dataclass(frozen=True)
class Rows:
    """Where each quantity of a lane lives in the work array (row numbers)."""

    n_wheels: int

    @property
    def h(self) -> int:
        return 3

    @property
    def r(self) -> int:
        return 3 + self.n_wheels

    @property
    def n_state(self) -> int:
        return 6 + self.n_wheels

    @property
    def new(self) -> int:
        """State after the step just tried; same order as the state."""
        return self.n_state

    @property
    def dt(self) -> int:
        return 2 * self.n_state

    @property
    def slope(self) -> int:
        """dr/dt at the state, for the samples inside a step."""
        return self.dt + 1

    @property
    def inverse(self) -> int:
        return self.slope + 3

    @property
    def held(self) -> int:
        return self.inverse + 6

    def wheel(self, i: int) -> int:
        """First of the rows of wheel i, in the order of `WHEEL_ROWS`."""
        return self.held + 3 + len(WHEEL_ROWS) * i

    def of(self, i: int, name: str) -> int:
        """The row of one quantity of wheel i."""
        return self.wheel(i) + WHEEL_ROWS.index(name)

    @property
    def count(self) -> int:
        return self.wheel(self.n_wheels)


WHEEL_ROWS = (
    "axis_x", "axis_y", "axis_z", "inverse_inertia", "free", "coulomb", "viscous",  # as in gyrostat.WheelParameters
    "inertia",
    "watch",  # sign of the speed while a stop must be watched for, else 0
    "inverse_limit2",  # 1 / limit^2 while stuck, else 0
    "dry",  # friction limit in N m (Coulomb and brake)
    "speed",  # output: W
    "torque",  # output: holding torque
)  # fmt: skip


def component(value: float) -> int | None:
    """The structural part of an axis component: 0, 1 or -1 exactly, else None (a run-time number)."""
    return int(value) if value in (0.0, 1.0, -1.0) else None


class _Printer(PythonCodePrinter):
    """Powers as products: exact, and vectorised everywhere."""

    def _print_Pow(self, expr, rational=False, sqrt="math.sqrt"):
        if expr.exp.is_Integer and 1 < expr.exp <= 4:
            base = self._print(expr.base)
            base = base if expr.base.is_Symbol else f"({base})"
            return "*".join([base] * int(expr.exp))
        return super()._print_Pow(expr, rational, sqrt)


def _assignments(names: list[str], expressions: list, prefix: str) -> list[str]:
    """Straight-line assignments of the expressions to the names, common subexpressions first."""
    shared, final = sp.cse(expressions, symbols=sp.numbered_symbols(prefix))
    printer = _Printer()
    lines = [f"{symbol} = {printer.doprint(expression)}" for symbol, expression in shared]
    return lines + [f"{name} = {printer.doprint(sp.sympify(e))}" for name, e in zip(names, final, strict=True)]


def _parameters(structure: Structure) -> g.Parameters:
    def symbol(name: str):
        return sp.Symbol(name)

    wheels = []
    for i, axis in enumerate(structure.axes):
        parts = [sp.Integer(c) if c is not None else symbol(f"u{i}_{k}") for k, c in enumerate(axis)]
        wheels.append(
            g.WheelParameters(
                tuple(parts), symbol(f"iJ{i}"), symbol(f"free{i}"), symbol(f"coul{i}"), symbol(f"visc{i}")
            )
        )
    inverse = tuple(symbol(f"inv{k}") for k in range(6))
    return g.Parameters(inverse, tuple(symbol(f"held{k}") for k in range(3)), tuple(wheels))


def _state_names(n: int) -> list[str]:
    return ["H0", "H1", "H2", *(f"h{i}" for i in range(n)), "r0", "r1", "r2"]


def _symbolic_state(n: int):
    symbols = sp.symbols(_state_names(n))
    return symbols[:3], symbols[3 : 3 + n], symbols[3 + n :]


def _loads(structure: Structure, rows: Rows, lanes: int, at: str) -> list[str]:
    """Load the parameters of lane `at` into the names that the traced expressions use."""
    lines = [f"inv{k} = w[{(rows.inverse + k) * lanes} + {at}]" for k in range(6)]
    lines += [f"held{k} = w[{(rows.held + k) * lanes} + {at}]" for k in range(3)]
    for i, axis in enumerate(structure.axes):
        lines += [f"u{i}_{k} = w[{(rows.wheel(i) + k) * lanes} + {at}]" for k, c in enumerate(axis) if c is None]
        named = (("iJ", "inverse_inertia"), ("free", "free"), ("coul", "coulomb"), ("visc", "viscous"))
        lines += [f"{symbol}{i} = w[{rows.of(i, name) * lanes} + {at}]" for symbol, name in named]
    return lines


def step_body(structure: Structure, lanes: int) -> list[str]:
    """One step of the eighth-order method of Dormand and Prince (SciPy's DOP853 coefficients) for lane j."""
    n = len(structure.axes)
    rows, names = Rows(n), _state_names(n)
    H, h, r = _symbolic_state(n)
    dH, dh, dr = g.rhs(H, h, r, _parameters(structure))
    lines = _loads(structure, rows, lanes, "j") + [f"dt = w[{rows.dt * lanes} + j]"]
    lines += [f"y{i} = w[{i * lanes} + j]" for i in range(rows.n_state)]
    derivative = [*dH, *dh, *dr]
    for stage in range(DOP853.n_stages):
        lines += [
            f"{name} = {_combination(i, DOP853.A[stage][:stage])}" for i, name in enumerate(names)
        ]
        lines += _assignments([f"k{stage}_{i}" for i in range(rows.n_state)], derivative, f"a{stage}_")
    for i in range(rows.n_state):
        lines.append(f"w[{(rows.new + i) * lanes} + j] = {_combination(i, DOP853.B)}")
    return lines


def _combination(i: int, weights) -> str:
    terms = [f"{float(weight)!r} * k{stage}_{i}" for stage, weight in enumerate(weights) if weight != 0]
    return f"y{i} + dt * ({' + '.join(terms)})" if terms else f"y{i}"


def observe_body(structure: Structure, lanes: int) -> list[str]:
    """At the new state of lane j: wheel speeds and holding torques, and whether an event was missed."""
    n = len(structure.axes)
    if not n:
        return []
    rows = Rows(n)
    lines = [f"{name} = w[{(rows.new + i) * lanes} + j]" for i, name in enumerate(_state_names(n)[: 3 + n])]
    return lines + _loads(structure, rows, lanes, "j") + _wheel_checks(structure, rows, lanes)


def _wheel_checks(structure: Structure, rows: Rows, lanes: int) -> list[str]:
    n = len(structure.axes)
    H, h, _ = _symbolic_state(n)
    p = _parameters(structure)
    omega = g.body_rate(H, h, p)
    outputs, names = [], []
    for i in range(n):
        outputs += [g.wheel_speed(h[i], omega, p.wheels[i])]
        outputs += [g.holding_torque(H, h, p, p.wheels[i], sp.Symbol(f"J{i}"))]
        names += [f"speed{i}", f"torque{i}"]
    lines = [f"J{i} = w[{rows.of(i, 'inertia') * lanes} + j]" for i in range(n)]
    lines += _assignments(names, outputs, "b")
    tests = []
    for i in range(n):
        lines.append(f"w[{rows.of(i, 'speed') * lanes} + j] = speed{i}")
        lines.append(f"w[{rows.of(i, 'torque') * lanes} + j] = torque{i}")
        tests.append(f"(w[{rows.of(i, 'watch') * lanes} + j] * speed{i} < 0.0)")
        tests.append(f"(torque{i} * torque{i} * w[{rows.of(i, 'inverse_limit2') * lanes} + j] > 1.0)")
    return [*lines, f"missed += 1 if {' | '.join(tests)} else 0"]


def omega_body(structure: Structure) -> list[str]:
    """The body rate of the committed state of a single lane, into omega."""
    n = len(structure.axes)
    rows = Rows(n)
    H, h, _ = _symbolic_state(n)
    lines = [f"{name} = w[{i}]" for i, name in enumerate(_state_names(n)[: 3 + n])]
    lines += _loads(structure, rows, 1, "j")
    return lines + _assignments([f"omega[{k}]" for k in range(3)], list(g.body_rate(H, h, _parameters(structure))), "c")


def slope_body(structure: Structure, lanes: int, where: int) -> list[str]:
    """dr/dt at the state whose rows begin at `where`, into s0..s2."""
    n = len(structure.axes)
    rows = Rows(n)
    H, h, r = _symbolic_state(n)
    p = _parameters(structure)
    lines = [f"{name} = w[{(where + i) * lanes} + j]" for i, name in enumerate(_state_names(n))]
    lines += _loads(structure, rows, lanes, "j")
    return lines + _assignments(["s0", "s1", "s2"], list(g.cross(r, g.body_rate(H, h, p))), "d")


def start_body(structure: Structure, lanes: int) -> list[str]:
    """Note the slope of r before the first step."""
    rows = Rows(len(structure.axes))
    lines = slope_body(structure, lanes, 0)
    return lines + [f"w[{(rows.slope + k) * lanes} + j] = s{k}" for k in range(3)]


def sample_body(structure: Structure, lanes: int) -> list[str]:
    """Bins of r_z at `samples` equal fractions of the step just made, r by cubic Hermite interpolation."""
    rows = Rows(len(structure.axes))
    lines = slope_body(structure, lanes, rows.new) + [f"dt = w[{rows.dt * lanes} + j]"]
    for k in range(3):
        lines.append(f"p{k} = w[{(rows.r + k) * lanes} + j]")
        lines.append(f"e{k} = r{k} - p{k}")
        lines.append(f"m{k} = dt * w[{(rows.slope + k) * lanes} + j]")
        lines.append(f"n{k} = dt * s{k}")
        lines.append(f"w[{(rows.slope + k) * lanes} + j] = s{k}")
    for m in range(1, structure.samples + 1):
        x = m / structure.samples
        end, first, last = x * x * (3 - 2 * x), x * (1 - x) ** 2, x * x * (x - 1)
        for k in range(3):
            value = f"p{k} + {end!r} * e{k} + {first!r} * m{k} + {last!r} * n{k}"
            lines.append(f"x{k} = {value if m < structure.samples else f'r{k}'}")
        lines += _bin_lines(structure, f"bins[{(m - 1) * lanes} + j]")
    return lines


def _bin_lines(structure: Structure, target: str) -> list[str]:
    """Bin of x2 in [-1, 1], or the extra last bin where the Sun x could not have been reconstructed."""
    lines = []
    used = {k for conjunction in structure.mask for k, _ in conjunction}
    for k, normal in enumerate(structure.normals):
        terms = []
        for c, part in enumerate(normal):
            if part is None:
                terms.append(f"normals[{3 * k + c}] * x{c}")
            elif part:
                terms.append(f"{'-' if part < 0 else ''}x{c}")
        if k in used:
            lines.append(f"lit{k} = ({' + '.join(terms) or '0.0'}) > 0.0")
    clauses = [
        " & ".join(f"lit{k}" if lit else f"(not lit{k})" for k, lit in conjunction) or "True"
        for conjunction in structure.mask
    ]
    seen = " | ".join(f"({clause})" for clause in clauses) or "True"
    lines.append(f"place = (x2 + 1.0) * {structure.bins / 2!r}")
    lines.append(f"place = min(max(place, 0.0), {structure.bins - 1!r}.0)")
    lines.append(f"{target} = np.int32(place) if {seen} else np.int32({structure.bins})")
    return lines
