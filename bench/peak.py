"""The most floating-point work this machine does: fused multiply-adds on independent accumulators that stay in registers.

Written in LLVM's own language and compiled by llvmlite, numba's compiler: the width of the vectors and the number of
accumulators are then what is asked for, and not what an optimiser makes of a loop.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache, partial

import llvmlite.binding as llvm
import numba  # noqa: F401  (sets up llvmlite's native target)

from bench.table import Table
from bench.timing import Timing, cores, medians, say

TYPES = {"float64": ("double", "f64", 64), "float32": ("float", "f32", 32)}
QUICK_S, FULL_S = 0.05, 0.3
"""Seconds that one measurement should last, about."""


def run(quick: bool) -> Table:
    """GFLOP/s per core and on all cores; a fused multiply-add counts as two operations."""
    wanted = QUICK_S if quick else FULL_S
    columns = (
        "numbers",
        "vector bits",
        "GFLOP/s, one core",
        f"GFLOP/s, {cores()} cores",
        "all / one",
    )
    table = Table("peak", "measured peak of fused multiply-adds", columns)
    for kind in TYPES:
        for bits in widths():
            say(f"peak: {kind}, {bits} bits")
            one, every = measured(kind, bits, wanted)
            table.add(kind, bits, one, every, every / one)
    return table


def peak(kind: str = "float64", every_core: bool = False, seconds: float = FULL_S) -> float:
    """The largest GFLOP/s over the vector widths of this machine, on one core or on every core at once."""
    return max(measured(kind, bits, seconds)[every_core] for bits in widths())


@cache
def measured(kind: str, bits: int, seconds: float) -> tuple[float, float]:
    """GFLOP/s on one core and on all."""
    burn, flops = burner(kind, bits)
    n = _passages(burn, seconds)
    team = cores()

    def together() -> None:
        with ThreadPoolExecutor(team) as pool:
            list(pool.map(burn, [n] * team))

    times = medians({"one": partial(burn, n), "all": together}, 5)
    return n * flops / times["one"] / 1e9, n * flops * team / times["all"] / 1e9


def _passages(burn: Callable[[int], object], seconds: float) -> int:
    """How often to go through the accumulators so that it takes about so long."""
    n = 100_000
    while True:
        trial = Timing()
        trial.take(partial(burn, n))
        if trial.median > seconds / 10:
            return int(n * seconds / trial.median)
        n *= 4


def widths() -> list[int]:
    """Vector widths (bits) that this processor computes with, widest first."""
    features = llvm.get_host_cpu_features()
    known = {512: "avx512f", 256: "avx2", 128: None}
    return [bits for bits, feature in known.items() if feature is None or features.get(feature)]


def accumulators(bits: int) -> int:
    """More than latency times throughput (4 to 5 cycles, 2 a cycle) asks for, as many as the registers hold."""
    return 12 if bits < 512 else 24


@cache
def burner(kind: str, bits: int) -> tuple[Callable[[int], object], int]:
    """A function that goes n times through its accumulators, and the operations of one passage."""
    scalar, suffix, size = TYPES[kind]
    lanes, count = bits // size, accumulators(bits)
    module = llvm.parse_assembly(source(scalar, suffix, lanes, count))
    module.verify()
    target = llvm.Target.from_default_triple()
    features = llvm.get_host_cpu_features().flatten()
    machine = target.create_target_machine(cpu=llvm.get_host_cpu_name(), features=features, opt=2)
    engine = llvm.create_mcjit_compiler(module, machine)
    engine.finalize_object()
    real = ctypes.c_double if kind == "float64" else ctypes.c_float
    function = ctypes.CFUNCTYPE(real, ctypes.c_int64, real, real)(
        engine.get_function_address("burn")
    )

    def burn(n: int, engine: object = engine) -> float:
        """x = x a + b, n times; a and b such that x neither grows nor gets slow to handle. ctypes releases the GIL."""
        return function(n, 0.999, 0.001)

    return burn, 2 * lanes * count


def source(scalar: str, suffix: str, lanes: int, count: int) -> str:
    """LLVM assembly of ``burn(n, a, b)``: a loop over `count` vectors of `lanes` numbers, their sum at the end."""
    vector = f"<{lanes} x {scalar}>"
    fma = f"@llvm.fma.v{lanes}{suffix}"

    def splat(name: str) -> list[str]:
        return [
            f"  %{name}0 = insertelement {vector} poison, {scalar} %{name}, i32 0",
            f"  %{name}v = shufflevector {vector} %{name}0, {vector} poison, <{lanes} x i32> zeroinitializer",
        ]

    start = [f"  %s{k} = fmul {vector} %bv, splat ({scalar} {float(k + 1)})" for k in range(count)]
    phis = [f"  %x{k} = phi {vector} [ %s{k}, %entry ], [ %y{k}, %loop ]" for k in range(count)]
    steps = [
        f"  %y{k} = call {vector} {fma}({vector} %x{k}, {vector} %av, {vector} %bv)"
        for k in range(count)
    ]
    sums = [f"  %t{k} = fadd {vector} %t{k - 1}, %y{k}" for k in range(1, count)]
    lines = [
        f"declare {vector} {fma}({vector}, {vector}, {vector})",
        f"define {scalar} @burn(i64 %n, {scalar} %a, {scalar} %b) {{",
        "entry:",
        *splat("a"),
        *splat("b"),
        *start,
        "  br label %loop",
        "loop:",
        "  %i = phi i64 [ 0, %entry ], [ %j, %loop ]",
        *phis,
        *steps,
        "  %j = add i64 %i, 1",
        "  %more = icmp slt i64 %j, %n",
        "  br i1 %more, label %loop, label %exit",
        "exit:",
        f"  %t0 = fadd {vector} %y0, zeroinitializer",
        *sums,
        f"  %r = extractelement {vector} %t{count - 1}, i32 0",
        f"  ret {scalar} %r",
        "}",
    ]
    return "\n".join(lines)
