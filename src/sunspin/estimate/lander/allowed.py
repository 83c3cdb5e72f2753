"""Directions to the Sun that the readings of a sample allow, and by how much readings contradict other directions."""

from __future__ import annotations

from itertools import product

import numpy as np

from sunspin.estimate.settings import GridSettings
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.vehicle.response.planes import sphere


def possible_directions(panels: PanelPowers, sample: int, s: GridSettings) -> np.ndarray:
    """Return directions to the Sun (c, 3) that the readings of a sample allow, `directions_rad` apart; the best one first."""
    panels_then = panels.take(slice(sample, sample + 1))
    around = sphere(s.directions)
    light = panels.brightness * panels.response.power(around)[:, None]
    if panels.throttled:
        light = panels_then.best_factor(light)[0] * light
    full = panels.brightness * panels.response.power(panels.response.facing_B).diagonal()
    tolerance = np.hypot(s.sigmas * panels.sigma, s.brightness * full)
    square = np.minimum(((light[:, 0] - panels_then.power[0]) / tolerance) ** 2, s.cap)
    misfit = square @ panels_then.used[0]
    order = np.argsort(misfit, kind="stable")
    allowed = around[order][misfit[order] < misfit.min() + 1.0]
    # choose the direction farthest from all chosen ones next, until each is near a chosen one
    chosen, nearest = allowed[:1], allowed @ allowed[0]  # cosines
    while nearest.min() < np.cos(s.directions_rad):
        chosen = np.concatenate([chosen, allowed[[np.argmin(nearest)]]])
        nearest = np.maximum(nearest, allowed @ chosen[-1])
    return chosen


def shortfall(
    panels: PanelPowers, sun_B: np.ndarray, angle_rad: float, s: GridSettings
) -> np.ndarray:
    """Return by how much (K, n) readings contradict all directions within an angle of `sun_B` (K, n, 3): squares of sigmas.

    The power of an input within that angle is in an interval. A reading beyond it by more than the tolerance is a contradiction.
    Each reading of a throttled sample allows an interval of factors. If a factor agrees with all readings, one of the ends of these
    intervals does, so that only the ends are tried.
    """
    low, high = panels.response.bounds(sun_B, angle_rad)
    low = panels.brightness * low * (1 - s.brightness)
    high = panels.brightness * high * (1 + s.brightness)
    slack = s.sigmas * panels.sigma
    factors: list[np.ndarray | float] = [1.0]
    if panels.throttled:
        factors = []
        for bound, value in ((high, panels.power - slack), (low, panels.power + slack)):
            usable = panels.used & (bound > 0)
            ends = np.divide(
                np.maximum(value, 0.0) + np.zeros_like(bound),
                bound,
                out=np.zeros_like(bound),
                where=usable,
            )
            factors += list(np.moveaxis(ends, -1, 0)[..., None])
    least = np.full(low.shape[:2], np.inf)
    for factor in factors:
        short = np.maximum(factor * low - panels.power, panels.power - factor * high)
        beyond = np.maximum(short / panels.sigma - s.sigmas, 0.0)
        square = np.where(panels.used, np.minimum(beyond**2, s.cap), 0.0).sum(axis=2)
        least = np.minimum(least, square)
    return least


def cube_nodes(size: int) -> np.ndarray:
    """Return directions (6 (size + 1)^2, 3) on a grid over the sphere, for tables of what readings say of a direction.

    They are projected from nodes on a cube: (size + 1) rows and columns on each of the faces +x, -x, +y, -y, +z, -z, along the next
    two axes.
    """
    side = np.linspace(-1, 1, size + 1)
    row, column = np.meshgrid(side, side, indexing="ij")
    faces = []
    for axis, sign in product(range(3), (1.0, -1.0)):
        face = np.empty((size + 1, size + 1, 3))
        face[..., axis], face[..., (axis + 1) % 3] = sign, row
        face[..., (axis + 2) % 3] = column
        faces.append(face.reshape(-1, 3))
    nodes = np.concatenate(faces)
    return nodes / np.linalg.norm(nodes, axis=1, keepdims=True)
