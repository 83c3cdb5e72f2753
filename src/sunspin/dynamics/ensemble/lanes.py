"""Writing code for a block of lanes: where quantities are, and what the methods of integration share.

Quantities of a block live in one flat array, row k of lane j at ``k * LANES + j``: one base pointer with constant offsets is what
lets LLVM prove that rows do not overlap. Constants are named, since a literal would turn float32 into float64. The state is in
the array w in the kernel's precision, nodes of the Sun's path are in v in float32, which is plenty for a histogram.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.ensemble.codegen import (
    TIME,
    Component,
    Structure,
    assignments,
    axis_symbols,
    momentum_names,
    state_names,
    state_symbols,
)

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

NODE_ROWS = 7
"""Of a node: the Sun's direction and its slope in body axes, and the squared rate of turning."""

NODES_PER_STEP = 2

NEARLY_AWAY = 0.25
"""Squared share of its friction at which a stuck wheel is looked at closely: it may break away and be held again in one step."""

LANE_WHEEL_ROWS = (
    "axis_x",
    "axis_y",
    "axis_z",
    "inverse_inertia",
    "free",
    "coulomb",
    "viscous",
    "inertia",
    "watch",
    "inverse_limit2",
)
"""Rows of a wheel, in this order."""


class Lanes:
    """Collects lines of one lane's code, and knows where everything is; each method of integration is a subclass."""

    lanes: int = 32
    """Trajectories of a block on a processor with vectors, unless told."""

    def __init__(self, structure: Structure, lanes: int | None = None):
        self.structure = structure
        self.lanes = type(self).lanes if lanes is None else lanes
        self.n: int = len(structure.axes)
        self.constants: dict[tuple[str, float], str] = {}
        self.lines: list[str] = []
        n_state = structure.layout.n_state
        self.at: dict[str, int] = _places(
            {
                "S_STATE": n_state,
                "S_OLD": n_state,
                "S_DT": 1,
                "S_MARGIN": 1,
                "S_LEAST": 1,
                "S_TURN": 3 * self.nodes,
                "S_WHEEL": len(LANE_WHEEL_ROWS) * self.n,
                **self.more_rows(),
                "S_ROWS": 0,
            }
        ) | _places({"V_NODE": NODE_ROWS * (self.nodes + 1), "V_DT": 1, "V_SIGNED": 1, "V_ROWS": 0})
        if self.lanes == 1:
            self.at["S_LEAST"] = self.at["S_MARGIN"]  # the least of one, with nothing to halve

    @property
    def nodes(self) -> int:
        """Nodes per step; none is needed where no histogram is wanted, but for the end."""
        return NODES_PER_STEP if self.structure.bins else 1

    def more_rows(self) -> dict[str, int]:
        """Rows that a method has besides."""
        raise NotImplementedError

    def step(self) -> list[str]:
        """One step: the old state is kept, the new one put in its place, with nodes on the way and the margin of the wheels."""
        raise NotImplementedError

    def load_torques(self) -> list[str]:
        """Code that puts the torques' parameters of a row into a lane: nothing where none act."""
        return []

    def parameters(self) -> g.Parameters:
        """Symbols of the parameters in the axes of the state."""
        raise NotImplementedError

    def load_parameters(self) -> None:
        """Assign them."""
        raise NotImplementedError

    def number(self, value: float, kind: str = "float32") -> str:
        """A constant by name."""
        return self.constants.setdefault((kind, float(value)), f"C{len(self.constants)}")

    def definitions(self) -> str:
        return "\n".join(
            f"{name} = np.{kind}({value!r})" for (kind, value), name in self.constants.items()
        )

    def add(self, *lines: str) -> None:
        self.lines.extend(lines)

    def row(self, first: str, k: int = 0) -> str:
        """A row of the work array w or, where the name begins with V, of the nodes v."""
        return f"{'v' if first.startswith('V') else 'w'}[{(self.at[first] + k) * self.lanes} + j]"

    def wheel(self, i: int, name: str) -> str:
        return self.row("S_WHEEL", i * len(LANE_WHEEL_ROWS) + LANE_WHEEL_ROWS.index(name))

    def put(self, places: list[str], expressions: list[Any]) -> None:
        """Assign SymPy expressions."""
        self.add(*assignments(places, expressions, "a"))

    def take(self) -> list[str]:
        lines, self.lines = self.lines, []
        return lines

    # ---- what the methods share --------------------------------------------------------------------------------------

    def load_wheels(self) -> None:
        for i, axis in enumerate(self.axes()):
            self.add(
                *(
                    f"u{i}_{k} = {self.wheel(i, 'axis_' + 'xyz'[k])}"
                    for k, c in enumerate(axis)
                    if c is None
                )
            )
            named = (
                ("iJ", "inverse_inertia"),
                ("free", "free"),
                ("coul", "coulomb"),
                ("visc", "viscous"),
            )
            self.add(*(f"{symbol}{i} = {self.wheel(i, name)}" for symbol, name in named))

    def axes(self) -> tuple[tuple[Component, ...], ...]:
        """Components of the wheels' axes, None for run-time numbers."""
        return self.structure.axes

    def keep_state(self, suffix: str = "") -> None:
        """Read the state into its names, and keep it in case the step has to be done again."""
        for k, name in enumerate(state_names(self.structure)):
            self.add(
                f"{name}{suffix} = {self.row('S_STATE', k)}",
                f"{self.row('S_OLD', k)} = {name}{suffix}",
            )

    def store_state(self) -> None:
        self.add(
            *(
                f"{self.row('S_STATE', k)} = {name}"
                for k, name in enumerate(state_names(self.structure))
            )
        )

    def turn(self, node: int) -> None:
        """Turn r about H by the common share of omega since the beginning of the step, up to a node (1 ..)."""
        names = ("cosine", "sine", "along")
        self.add(
            *(f"{name} = {self.row('S_TURN', 3 * (node - 1) + k)}" for k, name in enumerate(names))
        )
        turned = g.spun(axis_symbols(self.structure), sp.symbols("r0:3"), *sp.symbols(names))
        self.put(["x0", "x1", "x2"], list(turned))

    def first_node(self) -> None:
        """The last node of the step before is the first of this one."""
        last = NODE_ROWS * self.nodes
        self.add(
            *(f"{self.row('V_NODE', k)} = {self.row('V_NODE', last + k)}" for k in range(NODE_ROWS))
        )

    def rates(self) -> None:
        """omega, o0 to o2, at the state in the names."""
        H, h, _ = state_symbols(self.structure)
        self.put(["o0", "o1", "o2"], list(g.body_rate(H, h, self.parameters())))

    def margin(self) -> None:
        """Negative if a wheel that is watched has passed zero; omega is in o0 to o2."""
        if not self.n:
            return
        _, h, _ = state_symbols(self.structure)
        wheels = self.parameters().wheels
        speeds = [g.wheel_speed(h[i], sp.symbols("o0:3"), wheels[i]) for i in range(self.n)]
        self.put([f"speed{i}" for i in range(self.n)], speeds)
        for i in range(self.n):
            self.add(f"passed = {self.wheel(i, 'watch')} * speed{i}")
            self.add("margin = passed" if i == 0 else "margin = min(margin, passed)")
        self.add(f"{self.row('S_MARGIN')} = margin")

    def break_away(self) -> list[str]:
        """Make the margin negative where friction may not hold a wheel that is stuck."""
        if not self.n:
            return []
        self.load_parameters()
        H, h, directions = state_symbols(self.structure)
        self.add(
            *(
                f"{name} = {self.row('S_STATE', k)}"
                for k, name in enumerate(momentum_names(self.structure))
            )
        )
        self.add(*(f"J{i} = {self.wheel(i, 'inertia')}" for i in range(self.n)))
        p = self.parameters()
        torques = [
            g.holding_torque(H, h, p, p.wheels[i], sp.Symbol(f"J{i}"), directions, sp.Symbol(TIME))
            for i in range(self.n)
        ]
        self.put([f"torque{i}" for i in range(self.n)], torques)
        self.add(f"margin = {self.row('S_MARGIN')}")
        near = self.number(NEARLY_AWAY, self.structure.precision)
        for i in range(self.n):
            self.add(
                f"margin = min(margin, {near} - torque{i} * torque{i} * {self.wheel(i, 'inverse_limit2')})"
            )
        self.add(f"{self.row('S_MARGIN')} = margin")
        return self.take()

    def halve(self) -> list[str]:
        """The smallest of the first half of row S_LEAST into its first lane; each loop is a single vector operation."""
        width, lines, at = self.lanes // 4, [], self.at["S_LEAST"] * self.lanes
        while width:
            lines += [
                f"for j in range({width}):",
                f"    w[{at} + j] = min(w[{at} + j], w[{at + width} + j])",
            ]
            width //= 2
        return lines


def _places(sizes: dict[str, int]) -> dict[str, int]:
    places, at = {}, 0
    for name, size in sizes.items():
        places[name] = at
        at += size
    return places
