"""Directions to the Sun that the panel readings of a sample allow, and by how much readings contradict other directions.

Both are coarse tests of the search, with a tolerance for noise (`sigmas`), for brightness and gains (`brightness`) and for outliers
(`cap`) from :class:`GridSettings`. n samples with p inputs; directions are unit vectors in body axes.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from sunspin.estimate.settings import GridSettings
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.vehicle.response.planes import sphere


def possible_directions(panels: PanelPowers, sample: int, s: GridSettings) -> np.ndarray:
    """Return directions to the Sun (c, 3), body axes, that the readings of the sample with index `sample` allow; the best first.

    They are more than `directions_rad` apart, and each allowed direction is within `directions_rad` of one of them.
    """
    at_sample = panels.take(slice(sample, sample + 1))
    around = sphere(s.directions)
    power = panels.brightness * panels.response.power(around)[:, None]  # (directions, 1, p)
    if panels.throttled:
        power = at_sample.best_factor(power)[0] * power
    # a reading may be off by its noise, and by a share of the largest reading of its input, `full` (p)
    full = panels.brightness * panels.response.power(panels.response.facing_B).diagonal()
    tolerance = np.hypot(s.sigmas * panels.sigma, s.brightness * full)
    square = np.minimum(((power[:, 0] - at_sample.power[0]) / tolerance) ** 2, s.cap)
    misfit = square @ at_sample.used[0]
    order = np.argsort(misfit, kind="stable")
    # allowed: not worse than the best by one tolerance, squared
    allowed = around[order][misfit[order] < misfit.min() + 1.0]
    # next choose the direction farthest from all chosen ones, until each is near a chosen one
    chosen, nearest_cosine = allowed[:1], allowed @ allowed[0]
    while nearest_cosine.min() < np.cos(s.directions_rad):
        chosen = np.concatenate([chosen, allowed[[np.argmin(nearest_cosine)]]])
        nearest_cosine = np.maximum(nearest_cosine, allowed @ chosen[-1])
    return chosen


def shortfall(
    panels: PanelPowers, sun_B: np.ndarray, angle_rad: float, s: GridSettings
) -> np.ndarray:
    """Return a lower bound (K, n) of the misfit of readings, in squared sigmas, for all directions within an angle of `sun_B`.

    `sun_B` (K, n, 3): a direction for each sample. The power of an input within that angle is in an interval. A reading counts by
    its distance from the interval, less `sigmas` sigmas. Each reading of a throttled sample allows an interval of factors. If any
    factor agrees with all readings, one of the ends of these intervals does, so only the ends are tried.
    """
    low, high = panels.response.bounds(sun_B, angle_rad)
    low = panels.brightness * low * (1 - s.brightness)
    high = panels.brightness * high * (1 + s.brightness)
    tolerance = s.sigmas * panels.sigma
    factors: list[np.ndarray | float] = [1.0]
    if panels.throttled:
        # smallest factors, (reading - tolerance) / high, then largest ones, (reading + tolerance) / low: (K, n, 1) for each input
        factors = []
        for bound, value in ((high, panels.power - tolerance), (low, panels.power + tolerance)):
            usable = panels.used & (bound > 0)
            value = np.maximum(value, 0.0) + np.zeros_like(bound)
            ends = np.divide(value, bound, out=np.zeros_like(bound), where=usable)
            factors += list(np.moveaxis(ends, -1, 0)[..., None])
    least = np.full(low.shape[:2], np.inf)
    for factor in factors:
        outside = np.maximum(factor * low - panels.power, panels.power - factor * high)
        beyond = np.maximum(outside / panels.sigma - s.sigmas, 0.0)
        square = np.where(panels.used, np.minimum(beyond**2, s.cap), 0.0).sum(axis=2)
        least = np.minimum(least, square)
    return least


def cube_nodes(size: int) -> np.ndarray:
    """Return directions (6 (size + 1)^2, 3) on a grid over the sphere, at which misfits of readings are tabulated.

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
