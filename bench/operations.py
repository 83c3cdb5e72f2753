"""How much arithmetic the scan's kernel does for a row: counted in its generated source, per step and per way between nodes."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np

from bench.problem import Problem
from sunspin.dynamics import ensemble as k
from sunspin.dynamics.ensemble.lanes import NODES_PER_STEP
from sunspin.estimate.scan.mask import reconstructible_mask
from sunspin.estimate.scan.rows import BINS

ARITHMETIC = (ast.Add, ast.Sub, ast.Mult, ast.Div)


def operations_per_row(problem: Problem, rates: np.ndarray) -> float:
    """Additions, multiplications and divisions for a row of the scan, the mean over some rates (n, 3), rad/s.

    Each way between nodes counts with its share of `deposit`; events, set-up and distances are left out.
    """
    n = len(rates)
    rows = k.Rows(rates, np.tile(problem.sun_B, (n, 1)), np.tile(problem.wheel_speed_rad_s, (n, 1)))
    mask = reconstructible_mask(problem.vehicle)
    result = k.run_rows(
        problem.vehicle, rows, problem.window_s, emd_error=k.EMD_ERROR, mask=mask, bins=BINS
    )
    per_step = {
        name: _in_a_step(k.kernel(k.structure_of(problem.vehicle, mask, BINS, name)))
        for name in set(result.method)
    }
    return float(
        np.mean(
            [
                per_step[name] * steps
                for name, steps in zip(result.method, result.steps, strict=True)
            ]
        )
    )


def _in_a_step(module) -> int:
    functions = {
        node.name: node
        for node in ast.parse(Path(module.__file__).read_text("utf-8")).body
        if hasattr(node, "name")
    }
    names = ["step", *(f"deposit_{node}" for node in range(NODES_PER_STEP))]
    return sum(_count(functions[name]) for name in names)


def _count(function: ast.AST) -> int:
    """Operations of one lane; places in arrays are not counted."""
    inside = {
        id(node)
        for item in ast.walk(function)
        if isinstance(item, ast.Subscript)
        for node in ast.walk(item.slice)
    }
    return sum(
        isinstance(n, ast.BinOp) and isinstance(n.op, ARITHMETIC) and id(n) not in inside
        for n in ast.walk(function)
    )
