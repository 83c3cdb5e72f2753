"""From the nodes of the Sun's path to the histogram of r_z: what part of the way between two nodes counts, and where it lies."""

from __future__ import annotations

import math

from sunspin.dynamics.ensemble.lanes import NODE_ROWS, Lanes

PARTS = 4
"""Pieces, an even number, of the way between two nodes in which the crossing of the mask's edge is looked for."""


OUTER = 5 / 18
"""Weight of the outer two of Gauss's three points."""


def deposit_body(o: Lanes, node: int) -> list[str]:
    """The way from one node to the next: what part of it counts, and three points that stand for that part.

    Between the nodes r follows the cubic of its values and slopes, with the fourth-order term of a rotation at the rate of
    the step. The mask is a signed number, positive where the direction counts; in each of PARTS pieces its sign change is
    placed by a parabola. Time that counts has a length, a mean and a spread; three points with these are Gauss's quadrature where
    all of it counts.
    """
    _way(o, node)
    if o.structure.masked:
        _counted(o)
    else:
        half, spread = o.number(0.5), o.number(0.5 / math.sqrt(3.0))
        o.add(f"length = {o.number(1.0)}", f"mean = {half}", f"spread = {spread}")
    o.add("time = length * abs(dt)", f"weights[j] = {o.number(OUTER)} * time")
    o.add(f"weights[{o.lanes} + j] = {o.number(1 - 2 * OUTER)} * time")
    o.add(f"spread = {o.number(math.sqrt(0.5 / OUTER))} * spread")
    bins, last = o.number(o.structure.bins / 2), o.number(o.structure.bins - 1)
    for k, x in enumerate(("mean - spread", "mean + spread", "mean")):
        o.add(f"x = {x}", "z = p2 + x * (b2 + x * (quadratic + x * (cubic + x * quartic)))")
        o.add(
            f"place = (z + {o.number(1.0)}) * {bins}",
            f"place = place if place > {o.number(0.0)} else {o.number(0.0)}",
        )
        o.add(
            f"place = place if place < {last} else {last}"
        )  # a number that is none ends in the first bin, not beyond
        o.add(f"bins[{k * o.lanes} + j] = np.int32(place)")
    return o.take()


def _way(o: Lanes, node: int) -> None:
    """r at the inner points (x<part>_<k>) and the coefficients of r_z."""
    start, end = (
        [o.row("V_NODE", NODE_ROWS * n + k) for k in range(NODE_ROWS)] for n in (node, node + 1)
    )
    share = o.number(1.0 / o.nodes)
    o.add(f"dt = {o.row('V_DT')} * {share}", f"turn = dt * dt * {end[6]} * {o.number(1 / 24)}")
    inner = [part / PARTS for part in range(1, PARTS // 2 + 1)]
    for m, t in enumerate(inner, 1):
        # values of the basis: of begin - end, where the bubble t^2 (1 - t)^2 is proportional to it, too
        o.add(f"even{m} = {o.number(t * (1 - t) / 2)} + {o.number((t * (1 - t)) ** 2)} * turn")
    for k in range(3):
        o.add(
            f"p{k} = {start[k]}",
            f"q{k} = {end[k]}",
            f"b{k} = dt * {start[3 + k]}",
            f"e{k} = dt * {end[3 + k]}",
        )
        o.add(
            f"way = q{k} - p{k}",
            f"bend = b{k} - e{k}",
            f"both = b{k} + e{k}",
            f"middle = {o.number(0.5)} * (p{k} + q{k})",
        )
        for m, t in enumerate(inner, 1):
            o.add(f"even = middle + even{m} * bend")
            if m == PARTS // 2:  # the very middle
                o.add(f"x{m}_{k} = even")
                continue
            # odd part of the cubic about the middle, of the way and of the sum of the slopes
            odd_way, odd_both = t * t * (3 - 2 * t) - 0.5, t * (1 - t) * (1 - 2 * t) / 2
            o.add(f"odd = {o.number(odd_way)} * way + {o.number(odd_both)} * both")
            o.add(f"x{m}_{k} = even + odd", f"x{PARTS - m}_{k} = even - odd")
    o.add(
        "bubble = turn * bend",
        "quartic = bubble",
        f"two = {o.number(2.0)} * bubble",
        "cubic = both - way - way - two",
    )
    o.add("quadratic = way - b2 - cubic - quartic")


def _counted(o: Lanes) -> None:
    """Length, mean and spread of the part of the way that counts."""
    o.add(f"m0 = {o.row('V_SIGNED')}")
    for part in range(1, PARTS + 1):
        point = [f"x{part}_{k}" if part < PARTS else f"q{k}" for k in range(3)]
        o.add(*signed_lines(o, point), f"m{part} = signed")
    o.add(f"{o.row('V_SIGNED')} = m{PARTS}")
    half, one, zero = o.number(0.5), o.number(1.0), o.number(0.0)
    for part in range(1, PARTS):
        o.add(f"s{part} = m{part - 1} - m{part} - m{part} + m{part + 1}")
    o.add(f"length = {zero}", f"first = {zero}", f"second = {zero}")
    for part in range(PARTS):
        a, b = f"m{part}", f"m{part + 1}"
        curvature = (
            f"{half} * (s{part} + s{part + 1})" if 0 < part < PARTS - 1 else f"s{max(part, 1)}"
        )
        o.add(f"inverse = {one} / ({b} - {a} + {o.number(1e-30)})", f"t = -{a} * inverse")
        o.add(
            f"t = t + {half} * ({curvature}) * t * ({one} - t) * inverse",
            f"t = min(max(t, {zero}), {one})",
        )
        o.add(f"t = t if {a} * {b} < {zero} else {one}", f"up = {a} > {zero}")
        o.add(f"f = t if up else {one} - t", f"c = {half} * t if up else {half} + {half} * t")
        o.add(f"c = c + {o.number(part)}", "first = first + f * c", "length = length + f")
        o.add(f"second = second + f * (c * c + {o.number(1 / 12)} * f * f)")
    o.add(f"inverse = {one} / (length + {o.number(1e-30)})", "mean = first * inverse")
    o.add(
        f"spread = math.sqrt(max(second * inverse - mean * mean, {zero})) * {o.number(1 / PARTS)}"
    )
    o.add(f"mean = mean * {o.number(1 / PARTS)}", f"length = length * {o.number(1 / PARTS)}")


def signed_lines(o: Lanes, point: list[str]) -> list[str]:
    """The mask at a point as one number, `signed`: the largest over the clauses of the smallest of their distances."""
    lines, used = [], sorted({k for clause in o.structure.mask for k, _ in clause})
    for k in used:
        terms = []
        for c, part in enumerate(o.structure.normals[k]):
            if part is None:
                terms.append(f"normals[{3 * k + c}] * {point[c]}")
            elif part:
                terms.append(f"{'-' if part < 0 else ''}{point[c]}")
        lines.append(f"d{k} = {' + '.join(terms) or o.number(0.0)}")
    clauses = []
    for clause in o.structure.mask:
        value = ""
        for k, lit in clause:
            distance = f"{'' if lit else '-'}d{k}"
            value = f"min({value}, {distance})" if value else distance
        clauses.append(value or o.number(1.0))
    value = clauses[0]
    for clause in clauses[1:]:
        value = f"max({value}, {clause})"
    return [*lines, f"signed = {value}"]


def signed_body(o: Lanes) -> list[str]:
    """The signed mask at the last node, for the next way to begin with."""
    if not o.structure.masked:
        return []
    point = [o.row("V_NODE", NODE_ROWS * o.nodes + k) for k in range(3)]
    o.add(*signed_lines(o, point), f"{o.row('V_SIGNED')} = signed")
    return o.take()
