"""Hypotheses that are copies of each other, or of one family: how far apart they are, joined, and with neighbours between them."""

from __future__ import annotations

from itertools import product

import numpy as np

from sunspin.estimate.posterior.model import State
from sunspin.solve.rotations import move_on_sphere, tangent_basis

APART = 0.6
"""rad at the end of the next window: hypotheses nearer to each other are one."""

SUN_APART = 0.3
"""The same of the direction at the reference: where few panels are lit it is as uncertain as the rate."""

LOOSE, BESIDE = 0.5, 0.65
"""rad: a hypothesis free by more than this at the end of the next window is one of a family, and gets neighbours this far away."""

AGAIN = 1.35
"""Growth of the window's end after which a hypothesis that has got neighbours, or is one, gets others."""

JOINED = 2.0
"""Squared distance, in sigmas, below which hypotheses are one while the window grows."""

FREE = 3
"""Directions of a family along which neighbours are set, the loosest."""

SAME = 9.0
"""Squared distance, in sigmas of both, below which two fits are one mode."""


def offset(state: State, i: int, others: np.ndarray) -> np.ndarray:
    """Coordinates (m, D) of hypotheses `others` as seen from number `i`: rates, tangent of the direction, u."""
    return coordinates(state.take(others), state.take(np.array([i])))


def coordinates(state: State, centre: State) -> np.ndarray:
    """Coordinates (n, D) of states about one centre: the direction by the great circle to it."""
    e1, e2 = tangent_basis(centre.sun)
    return _chart(
        state,
        centre,
        np.stack([state.sun @ e1[0], state.sun @ e2[0]], axis=1),
        state.sun @ centre.sun[0],
    )


def apart(state: State, centre: State) -> np.ndarray:
    """The same (n, D) of states about a centre each."""
    across = np.stack(tangent_basis(centre.sun), axis=1)
    return _chart(
        state,
        centre,
        (across @ state.sun[:, :, None])[:, :, 0],
        np.sum(state.sun * centre.sun, axis=1),
    )


def _chart(state: State, centre: State, side: np.ndarray, along: np.ndarray) -> np.ndarray:
    """Coordinates of directions with the components `side` (n, 2) across and `along` (n) that of a centre."""
    size = np.linalg.norm(side, axis=1)
    stretch = np.divide(np.arctan2(size, along), size, out=np.ones_like(size), where=size > 1e-15)
    return np.concatenate(
        [state.omega - centre.omega, side * stretch[:, None], state.u - centre.u], axis=1
    )


def same_mode(
    state: State, hessian: np.ndarray, i: int, kept: list[int], within: float = SAME
) -> int | None:
    """Which of the kept ones the fit `i` is a copy of, if any."""
    if not kept:
        return None
    d = offset(state, i, np.array(kept))
    distance = np.minimum(
        np.einsum("mi,mij,mj->m", d, hessian[kept], d), np.einsum("mi,ij,mj->m", d, hessian[i], d)
    )
    nearest = int(np.argmin(distance))
    return nearest if distance[nearest] < within else None


def _square(d: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Squares (m) of vectors (m, D) under one metric (1, D, D) or one each (m, D, D)."""
    return np.sum((d[:, None, :] @ metric)[:, 0] * d, axis=1)


def _reach(normal: np.ndarray) -> np.ndarray:
    """How far (n, 3) rates may be from a hypothesis and still be joined with it, by its curvature (n, D, D) alone: of thousands,
    few are so near that their distances are asked."""
    size = np.sqrt(np.einsum("nii->ni", normal.astype(np.float64))).clip(1e-12)
    values, vectors = np.linalg.eigh(normal / (size[:, :, None] * size[:, None, :]))
    across = np.sum(vectors[:, :3] ** 2 / values[:, None].clip(1e-300), axis=2)
    return np.where(values[:, :1] > 1e-12, np.sqrt(1.01 * JOINED * across) / size[:, :3], np.inf)


def joined(state: State, normal: np.ndarray, hits: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Hypotheses (best first) without those that lie on the sheet of a better one, and the starts that each stands for.

    Unknown moments, friction and wheel speed make a sheet of each motion: boxes of rate and direction cut it into many.
    """
    reach, kept, count, left = _reach(normal), [], [], np.arange(len(state))
    while len(left):
        first = left[:1]
        near = np.all(
            np.abs(state.omega[left] - state.omega[first]) <= np.maximum(reach[left], reach[first]),
            axis=1,
        )
        near[0] = True
        d = offset(state, int(first[0]), left[near])
        one = np.minimum(_square(d, normal[first]), _square(d, normal[left[near]])) < JOINED
        one[0] = True
        near[near] = one
        kept.append(int(first[0]))
        count.append(int(hits[left[near]].sum()))
        left = left[~near]
    return np.array(kept), np.array(count)


def denser(
    state: State,
    normal: np.ndarray,
    hits: np.ndarray,
    beside: np.ndarray,
    reach_s: float,
    widest: float,
) -> tuple[State, np.ndarray, np.ndarray, np.ndarray]:
    """Hypotheses, and neighbours of those that are one of a family, the starts that each stands for, `beside`, and whose neighbour
    each is.

    The fits of neighbouring starts stay a step apart where the readings leave a family of motions, and with the window that step
    grows: without others between them the true one would be lost. `normal` (n, D, D): curvature; u as it is, since what differs by
    u alone is found from either. `beside` (n): end of the window (s) for which neighbours were set last, 0 for none; as long as it
    has hardly grown they are near enough. `widest`: largest rate.
    """
    size = np.array([reach_s] * 3 + [1.0] * 2)
    spread = np.linalg.inv(
        normal[:, :5, :5].astype(np.float64) + np.diag([widest**-2] * 3 + [1.0] * 2)
    )
    values, vectors = np.linalg.eigh(spread * size[:, None] * size)
    free = (np.sqrt(values[:, ::-1][:, :FREE].clip(0)) > LOOSE) & (AGAIN * beside < reach_s)[
        :, None
    ]
    beside = np.where(free.any(axis=1), reach_s, beside)
    parts, parent = [state], [np.arange(len(state))]
    for signs in product((0, 1, -1), repeat=FREE):
        along = np.flatnonzero(signs)
        rows = np.flatnonzero(free[:, along].all(axis=1)) if len(along) else along
        if len(rows):
            step = (
                BESIDE
                * vectors[rows][:, :, ::-1][:, :, :FREE]
                @ np.array(signs, dtype=np.float64)
                / size
            )
            parts.append(
                State(
                    state.omega[rows] + step[:, :3],
                    move_on_sphere(state.sun[rows], step[:, 3:]),
                    state.u[rows],
                )
            )
            parent.append(rows)
    every, origin = State.joined(parts), np.concatenate(parent)
    _, first = np.unique(boxes(every, reach_s), axis=0, return_index=True)
    kept = np.union1d(first, np.arange(len(state)))  # the fits themselves stay
    return (
        every.take(kept),
        np.where(kept < len(state), hits[origin[kept]], 1),
        beside[origin[kept]],
        origin[kept],
    )


def boxes(state: State, reach_s: float) -> np.ndarray:
    """Boxes (n, 6) of rate and direction, `APART` wide at `reach_s` s."""
    return np.floor(
        np.concatenate([state.omega * (reach_s / APART), state.sun / SUN_APART], axis=1)
    ).astype(np.int64)
