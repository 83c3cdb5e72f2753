"""Lanes that step by Taylor series in body axes: any vehicle, any accuracy of the direction."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sunspin.base.lazy import lazy
from sunspin.dynamics import gyrostat as g
from sunspin.dynamics.ensemble.codegen import (
    parameter_symbols,
    recurrence,
    state_names,
    torque_symbols,
)
from sunspin.dynamics.ensemble.lanes import NODE_ROWS, Lanes
from sunspin.dynamics.ensemble.series import value_at

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

ORDER = 14
"""Multiplications per radian turned are fewest between 12 and 20; beyond 14 compilation takes longer for nothing."""


class SeriesLanes(Lanes):
    """State: H (3), h, r (3) in body axes, in double precision."""

    lanes = 16

    def more_rows(self) -> dict[str, int]:
        torques = self.structure.layout.n_parameters
        return {"S_SPIN": 1, "S_INVERSE": 6, "S_HELD": 3} | (
            {"S_TORQUES": torques} if torques else {}
        )

    def parameters(self) -> g.Parameters:
        return parameter_symbols(self.structure)

    def load_parameters(self) -> None:
        self.add(f"spin = {self.row('S_SPIN')}")
        self.add(*(f"inv{k} = {self.row('S_INVERSE', k)}" for k in range(6)))
        self.add(*(f"held{k} = {self.row('S_HELD', k)}" for k in range(3)))
        self.load_wheels()
        self.add(
            *(
                f"{symbol} = {self.row('S_TORQUES', k)}"
                for k, symbol in enumerate(torque_symbols(self.structure))
            )
        )

    def load_torques(self) -> list[str]:
        """From a row of numbers into the lane."""
        layout = self.structure.layout
        return [
            f"{self.row('S_TORQUES', k)} = one[{layout.torques + k}]"
            for k in range(layout.n_parameters)
        ]

    def step(self) -> list[str]:
        names, histogram = state_names(self.structure), bool(self.structure.bins)
        self.load_parameters()
        self.add(f"dt = {self.row('S_DT')}")
        self.keep_state("_0")
        self.add(*recurrence(self.structure).lines(ORDER))
        if histogram:
            self.first_node()
        for node in range(1, self.nodes + 1):
            self.add(*(f"{name} = {value_at(name, ORDER, node / self.nodes)}" for name in names))
            self.turn(node)
            self.add("r0 = x0", "r1 = x1", "r2 = x2")
            self.rates()
            if histogram:
                self._put_node(node)
        self.store_state()
        self.margin()
        return self.take()

    def _put_node(self, node: int) -> None:
        slope = g.cross(sp.symbols("r0:3"), sp.symbols("o0:3"))
        square = g.dot(sp.symbols("o0:3"), sp.symbols("o0:3"))
        self.put(
            [f"{self.row('V_NODE', NODE_ROWS * node + k)}" for k in range(NODE_ROWS)],
            [*sp.symbols("r0:3"), *slope, square],
        )
