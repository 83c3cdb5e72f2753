"""Steps by Taylor series: the coefficients of the solution, order by order, as straight-line code.

The right-hand side of :mod:`sunspin.dynamics.gyrostat` is polynomial: the coefficient of order k of a sum or product follows
from those of its parts up to k (Cauchy), and the state's of order k + 1 from those of its derivative. Coefficients are scaled
by the step, so that the value at the fraction x of it is ``sum c_k x^k``.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias, cast

from sunspin.base.lazy import lazy

if TYPE_CHECKING:
    import sympy as sp
else:
    sp = lazy("sympy")

Sums: TypeAlias = "dict[tuple[sp.Expr, sp.Expr], str]"
"""Products of two series and the names of their sums."""


def _parts(expression: sp.Expr) -> tuple[sp.Expr, ...]:
    """The terms of a sum or the factors of a product, which SymPy declares more widely."""
    return cast("tuple[sp.Expr, ...]", expression.args)


class Recurrence:
    """Code for the Taylor coefficients of dy/dt = f(y), f polynomial in the states and in parameters."""

    def __init__(self, states: Sequence[str], derivatives: Sequence[sp.Expr]):
        from sympy.printing.pycode import PythonCodePrinter

        self.states: list[str] = list(states)
        self._series = {sp.Symbol(name) for name in states}
        self._print = PythonCodePrinter({"fully_qualified_modules": False}).doprint
        self.constants: list[str] = []
        self._named_so_far = 0
        self._definitions: list[tuple[sp.Symbol, sp.Expr]] = []
        found: Any = sp.cse([sp.sympify(d) for d in derivatives], symbols=sp.numbered_symbols("q"))
        shared, final = found
        for symbol, expression in shared:
            self._define(symbol, expression)
        self._derivatives = [self._prepared(expression) for expression in final]

    def _define(self, symbol: sp.Symbol, expression: sp.Expr) -> None:
        if self._series.isdisjoint(expression.free_symbols):
            self.constants.append(f"{symbol} = {self._print(expression)}")
            return
        prepared = self._prepared(expression)
        self._series.add(symbol)
        self._definitions.append((symbol, prepared))

    def _prepared(self, expression: sp.Expr) -> sp.Expr:
        """The same with every factor that is a series in a product of series given a name."""
        if isinstance(expression, sp.Add):
            return sp.Add(*(self._prepared(part) for part in _parts(expression)), evaluate=False)
        if isinstance(expression, sp.Pow):
            base = self._named(expression.base)
            return sp.Mul(*([base] * int(expression.exp)), evaluate=False)
        if not isinstance(expression, sp.Mul):
            return expression
        constants, series = self._split(expression)
        named = [self._named(factor) for factor in series]
        while len(named) > 2:
            named = [self._named(named[0] * named[1], product=True), *named[2:]]
        return sp.Mul(*constants, *named, evaluate=False)

    def _named(self, factor: sp.Expr, product: bool = False) -> sp.Symbol:
        if isinstance(factor, sp.Symbol) and not product:
            return factor
        self._named_so_far += 1
        symbol = sp.Symbol(f"m{self._named_so_far}")
        self._define(symbol, factor)
        return symbol

    def _split(self, product: sp.Expr) -> tuple[list[sp.Expr], list[sp.Expr]]:
        constants = [f for f in _parts(product) if self._series.isdisjoint(f.free_symbols)]
        return constants, [f for f in _parts(product) if f not in constants]

    def lines(self, order: int) -> Iterator[str]:
        """Assignments of ``<state>_<k>`` for k = 1 .. order, given ``<state>_0`` and the step dt."""
        yield from self.constants
        for k in range(order):
            for symbol, expression in self._definitions:
                yield f"{symbol}_{k} = {self._coefficient(expression, k) or '0.0'}"
            yield f"part_{k} = dt * {1.0 / (k + 1)!r}"
            yield from self._derivative_lines(k)

    def _derivative_lines(self, k: int) -> Iterator[str]:
        """The states' coefficients of order k + 1; all products grow together, so that a coefficient is read for several.

        No name is given a value twice: each one that is costs numba's compilation a pass over all lines.
        """
        sums: Sums = {}
        values = [self._with_sums(expression, k, sums) for expression in self._derivatives]
        # the newest coefficients last: the rest of a sum does not wait for them
        for n, i in enumerate(sorted(range(k + 1), key=lambda i: abs(2 * i - k))):
            for (a, b), name in sums.items():
                yield f"{name}_{k}_{n} = {f'{name}_{k}_{n - 1} + ' if n else ''}{a}_{i} * {b}_{k - i}"
        for name, value in zip(self.states, values, strict=True):
            yield f"{name}_{k + 1} = {f'part_{k} * ({value})' if value else 'dt * 0.0'}"

    def _with_sums(self, expression: sp.Expr, k: int, sums: Sums) -> str:
        """As `_coefficient`, with products of two series by the names of their sums."""
        if expression.is_Add:
            return " + ".join(
                filter(None, (self._with_sums(part, k, sums) for part in _parts(expression)))
            )
        constants, series = self._split(expression) if expression.is_Mul else ([], [])
        if len(series) != 2:
            return self._coefficient(expression, k)
        name = sums.setdefault((series[0], series[1]), f"sum{len(sums)}")
        return " * ".join([*(f"({self._print(c)})" for c in constants), f"{name}_{k}_{k}"])

    def _coefficient(self, expression: sp.Expr, k: int) -> str:
        """Code for the coefficient of order k; empty where it is zero."""
        if expression.is_Add:
            return " + ".join(
                filter(None, (self._coefficient(part, k) for part in _parts(expression)))
            )
        if self._series.isdisjoint(expression.free_symbols):
            return f"({self._print(expression)})" if k == 0 else ""
        if expression.is_Symbol:
            return f"{expression}_{k}"
        constants, series = self._split(expression)
        if len(series) == 1:
            value = f"{series[0]}_{k}"
        else:
            a, b = series if len(series) == 2 else (series[0], series[0])
            value = "(" + " + ".join(f"{a}_{i} * {b}_{k - i}" for i in range(k + 1)) + ")"
        return " * ".join([*(f"({self._print(c)})" for c in constants), value])

    # ---- the same in loops: slower, and compiled in a moment -----------------------------------------------------------

    def loop_lines(self, order: int) -> Iterator[str]:
        """Fill ``series[i, k]``, k = 0 .. order, of the states i in their order, given ``series[i, 0]`` and the step dt."""
        yield from self.constants
        yield f"for k in range({order}):"
        yield "    first = 1.0 if k == 0 else 0.0"
        places: dict[sp.Expr, int] = {sp.Symbol(name): i for i, name in enumerate(self.states)}
        for symbol, expression in self._definitions:
            places[symbol] = len(places)
            yield from self._loop([(f"series[{places[symbol]}, k]", expression)], places)
        yield "    part = dt / (k + 1)"
        targets = [f"series[{i}, k + 1]" for i in range(len(self.states))]
        yield from self._loop(list(zip(targets, self._derivatives, strict=True)), places, "part * ")

    def loop_rows(self) -> int:
        """Rows of `series`."""
        return len(self.states) + len(self._definitions)

    def _loop(
        self, targets: list[tuple[str, sp.Expr]], places: dict[sp.Expr, int], scale: str = ""
    ) -> Iterator[str]:
        sums: Sums = {}
        lines = [
            f"    {target} = {scale}({self._looped(expression, places, sums)})"
            for target, expression in targets
        ]
        if sums:
            yield from (f"    {name} = 0.0" for name in sums.values())
            yield "    for i in range(k + 1):"
            yield from (
                f"        {n} += series[{places[a]}, i] * series[{places[b]}, k - i]"
                for (a, b), n in sums.items()
            )
        yield from lines

    def _looped(self, expression: sp.Expr, places: dict[sp.Expr, int], sums: Sums) -> str:
        if expression.is_Add:
            return " + ".join(self._looped(part, places, sums) for part in _parts(expression))
        if self._series.isdisjoint(expression.free_symbols):
            return f"first * ({self._print(expression)})"
        if expression.is_Symbol:
            return f"series[{places[expression]}, k]"
        constants, series = self._split(expression)
        value = f"series[{places[series[0]]}, k]"
        if len(series) == 2:
            value = sums.setdefault((series[0], series[1]), f"sum{len(sums)}")
        return " * ".join([*(f"({self._print(c)})" for c in constants), value])


def value_at(name: str, order: int, fraction: float = 1.0, written: str = "") -> str:
    """Code for the value of a series at a fraction of the step; `written` is how the fraction is named there."""
    if fraction == 1.0:
        return " + ".join(f"{name}_{k}" for k in range(order, -1, -1))
    form = f"{name}_{order}"
    for k in range(order - 1, -1, -1):
        form = f"{name}_{k} + {written or repr(fraction)} * ({form})"
    return form
