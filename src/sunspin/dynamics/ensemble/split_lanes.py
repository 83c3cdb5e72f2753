"""Lanes that step by a product of rotations in principal axes (principal.py): fast, for distributions."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.ensemble.codegen import Component, wheel_symbols
from sunspin.dynamics.ensemble.lanes import NODE_ROWS, Lanes

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

MAIN = (0.07534696026989288842, 0.51791685468825678230, -0.09326381495814967072)
SIDE = (0.19022593937367661925, 0.84652407044352625706, -1.07350001963440575260)
"""Fractions of a step of the main rotation and of P and Q, up to the middle of the step: McLachlan's method of order (8, 4) for
perturbed systems, BIT 35 (1995), table 2; main first and last, SIDE[-1] is the middle one."""


def _first_half() -> list[tuple[str, float, float]]:
    flows, time = [], 0.0
    for main, side in zip(MAIN, SIDE, strict=True):
        flows.append(("main", main, time + main / 2))
        time += main
        flows.append(("side", side, time))
    return [*flows[:-1], ("side", SIDE[-1] / 2, 0.5)]


FIRST_HALF = _first_half()
SECOND_HALF = [(part, fraction, 1.0 - time) for part, fraction, time in reversed(FIRST_HALF)]
"""Flows of a step: part, fraction of the step, and when in the step the wheels are looked at."""

TIMES = tuple(dict.fromkeys([time for _, _, time in (*FIRST_HALF, *SECOND_HALF)] + [1.0]))

MAX_MAIN_ANGLE = 1.2
"""rad that the main rotation may turn in a step: sets the length of the series for sine and cosine."""

MAX_SIDE_ANGLE = 0.6
"""The same for P and Q."""

ROUNDING = 3e-8
"""First neglected term of the series."""


class SplitLanes(Lanes):
    """State: H (3), h, r (3) in the principal axes (p, q, m), in single precision; the first node is in the middle of a step."""

    lanes = 32

    def more_rows(self) -> dict[str, int]:
        return {
            "S_INVERSE": 3,
            "S_DIFFERENCE": 2,
            "S_HELD": 3,
            "S_AXES": 9,
            "S_LOW": self.n,
            "S_WEAR": len(TIMES) * self.n,
            "S_SPEEDS": 2,
            "S_SIZE": 1,
        }

    def axes(self) -> tuple[tuple[Component, ...], ...]:
        return ((None, None, None),) * self.n

    def parameters(self) -> g.Parameters:
        """In principal axes, a wheel's axis times whether it is free in fu<i>_<k>."""
        l, zero = sp.symbols("l0:3"), sp.Integer(0)
        wheels = tuple(wheel_symbols(i, (None, None, None)) for i in range(self.n))
        return g.Parameters(
            (l[0], zero, zero, l[1], zero, l[2]), tuple(sp.symbols("held0:3")), wheels
        )

    def load_parameters(self) -> None:
        self.add(*(f"l{k} = {self.row('S_INVERSE', k)}" for k in range(3)))
        self.add(*(f"held{k} = {self.row('S_HELD', k)}" for k in range(3)))
        self.load_wheels()

    # ---- one step --------------------------------------------------------------------------------------------------------

    def step(self) -> list[str]:
        self.load_parameters()
        self.keep_state()
        self._prepare()
        if self.structure.bins:
            self.first_node()
        for part, fraction, time in FIRST_HALF:
            self._flow(part, fraction, time, first_half=True)
        self._middle()
        for part, fraction, time in SECOND_HALF:
            self._flow(part, fraction, time, first_half=False)
        self._slow_down()
        self._renormalise()
        self.turn(self.nodes)
        self.add("r0 = x0", "r1 = x1", "r2 = x2")
        self._rates()
        if self.structure.bins:
            self._put_node(self.nodes, "r")
        self.store_state()
        self.margin()
        return self.take()

    def _prepare(self) -> None:
        """What the rates of the parts need; friction that does not depend on omega is followed exactly through the step."""
        self.add(
            f"dt = {self.row('S_DT')}",
            f"dp = {self.row('S_DIFFERENCE')}",
            f"dm = {self.row('S_DIFFERENCE', 1)}",
        )
        self.add(*(f"bias{k} = l{k} * held{k}" for k in range(3)))
        for i in range(self.n):
            self.add(
                *(f"fu{i}_{k} = free{i} * u{i}_{k}" for k in range(3)),
                *(f"w{i}_{k} = l{k} * fu{i}_{k}" for k in range(3)),
            )
            self.add(f"slow{i} = -free{i} * (coul{i} + visc{i} * iJ{i} * h{i})")

    def _renormalise(self) -> None:
        """Lengths of H and r: rounded sines and cosines of angles that hardly change would let them drift, by 1e-3 in a run."""
        for v, square in (("H", f" * {self.row('S_SIZE')}"), ("r", "")):
            self.add(f"square = ({v}0 * {v}0 + {v}1 * {v}1 + {v}2 * {v}2){square}")
            self.add(
                f"x = {self.number(1.5)} - {self.number(0.5)} * square",
                *(f"{v}{k} = {v}{k} * x" for k in range(3)),
            )

    def _wheels_at(self, time: float) -> None:
        """The wheels' momenta, at<i>, at a time in the step."""
        for i in range(self.n):
            self.add(
                f"at{i} = h{i} + slow{i} * {self.row('S_WEAR', len(TIMES) * i + TIMES.index(time))}"
            )

    def _flow(self, part: str, fraction: float, time: float, first_half: bool) -> None:
        """One flow; P and Q come in mirrored order in the second half."""
        self._wheels_at(time)
        self.add(f"share = {self.number(fraction)} * dt")
        if part == "main":
            self._rotate(
                f"share * (dm * H2 - {self._wheel_rate(2)})",
                0,
                1,
                MAX_MAIN_ANGLE * max(map(abs, MAIN)),
            )
            return
        bound = MAX_SIDE_ANGLE * max(map(abs, SIDE[:-1]))
        p = (f"share * (dp * H0 - {self._wheel_rate(0)})", 1, 2, bound)
        q = (f"-share * {self._wheel_rate(1)}", 2, 0, bound)
        for rotation in (p, q) if first_half else (q, p):
            if rotation is p or self.structure.oblique:
                self._rotate(*rotation)

    def _wheel_rate(self, k: int) -> str:
        """Component k of A^-1 (K + sum h u)."""
        return "(" + " + ".join([f"bias{k}", *(f"w{i}_{k} * at{i}" for i in range(self.n))]) + ")"

    def _rotate(self, angle: str, a: int, b: int, bound: float) -> None:
        """Turn H and r by an angle from axis b towards a: dv/dt = v x omega."""
        self.add(f"angle = {angle}", "square = angle * angle")
        sine, cosine = (self._series(first, bound) for first in (3, 2))
        self.add(
            f"s = angle + angle * square * ({sine})",
            f"c = {self.number(1.0)} + square * ({cosine})",
        )
        for v in ("H", "r"):
            self.add(
                f"x = c * {v}{a} + s * {v}{b}", f"{v}{b} = c * {v}{b} - s * {v}{a}", f"{v}{a} = x"
            )

    def _series(self, first: int, bound: float) -> str:
        """Horner form of what follows the leading term of sine (from x^3) or cosine (from x^2), in x^2."""
        powers = [first]
        while bound ** (powers[-1] + 2) / math.factorial(powers[-1] + 2) > ROUNDING:
            powers.append(powers[-1] + 2)
        form = ""
        for power in reversed(powers):
            value = self.number((-1.0) ** (power // 2) / math.factorial(power))
            form = f"{value} + square * ({form})" if form else value
        return form

    def _middle(self) -> None:
        """omega in the middle of the step, for the friction that depends on it; and the node there."""
        self._wheels_at(0.5)
        self._rates("at")
        for i in range(self.n):
            self.add(f"along{i} = {' + '.join(f'fu{i}_{k} * o{k}' for k in range(3))}")
        self._watch_speed()
        if self.structure.bins:
            self.turn(1)
            self._put_node(1, "x")

    def _watch_speed(self) -> None:
        """How slowly and how fast H has moved so far; slow and fast together are the mark of an unstable spin passed by."""
        change = g.cross(sp.symbols("H0:3"), sp.symbols("o0:3"))
        self.put(["speed"], [g.dot(change, change)])
        for k, choose in enumerate(("min", "max")):
            self.add(f"{self.row('S_SPEEDS', k)} = {choose}({self.row('S_SPEEDS', k)}, speed)")

    def _slow_down(self) -> None:
        """The wheels' momenta at the end, by Kahan's sum: many small equal steps would all be rounded alike."""
        for i in range(self.n):
            wear, low = self.row("S_WEAR", len(TIMES) * i + TIMES.index(1.0)), self.row("S_LOW", i)
            self.add(f"y = slow{i} * {wear} + visc{i} * dt * along{i} - {low}", f"x = h{i} + y")
            self.add(f"{low} = (x - h{i}) - y", f"h{i} = x")

    def _rates(self, h: str = "h") -> None:
        """omega, o0 to o2, from H and the wheels' momenta by the name h."""
        H, momenta = sp.symbols("H0:3"), tuple(sp.Symbol(f"{h}{i}") for i in range(self.n))
        p, one = self.parameters(), sp.Integer(1)
        wheels = tuple(
            w._replace(axis=sp.symbols(f"fu{i}_0:3"), free=one) for i, w in enumerate(p.wheels)
        )
        self.put(["o0", "o1", "o2"], list(g.body_rate(H, momenta, p._replace(wheels=wheels))))

    def _put_node(self, node: int, r: str) -> None:
        """The Sun's direction by the name r and its slope, turned into body axes."""
        direction, omega = sp.symbols(f"{r}0:3"), sp.symbols("o0:3")
        self.put(["s0", "s1", "s2"], list(g.cross(direction, omega)))
        for k in range(3):
            for offset, v in ((0, r), (3, "s")):
                turned = " + ".join(f"{self.row('S_AXES', 3 * l + k)} * {v}{l}" for l in range(3))
                self.add(f"{self.row('V_NODE', NODE_ROWS * node + offset + k)} = {turned}")
        self.put([self.row("V_NODE", NODE_ROWS * node + 6)], [g.dot(omega, omega)])
