"""How probable the Sun's readings of a pass are if the body swings at random between them: by all ways, not by the likeliest few.

A fit counts the ways of the body that it has found. Where readings are coarse and the body swings, there are so many that each
holds next to nothing, and some body that turns evenly fits better than any of them by chance. Over the sphere all are summed: the
Sun's direction in the body spreads as heat does, by spherical harmonics, and each reading weighs it.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from scipy.special import sph_harm_y

from sunspin.estimate.rates.smooth import measured
from sunspin.estimate.rates.state import Observations
from sunspin.estimate.terms.term import EVERYWHERE, Seen, facing, normal
from sunspin.vehicle.response.planes import sphere

DEGREE = 24
"""Of the harmonics: a way of 0.15 rad from one reading to the next is told from none."""


@cache
def harmonics() -> tuple[np.ndarray, np.ndarray]:
    """Real harmonics (`EVERYWHERE`, m) at directions all over the sphere, and l (l + 1) of each (m)."""
    x, y, z = sphere(EVERYWHERE).T
    l, m = (part[np.tril_indices(DEGREE + 1)] for part in np.indices((DEGREE + 1, DEGREE + 1)))
    made = sph_harm_y(l, m, np.arccos(z)[:, None], np.arctan2(y, x)[:, None]) * np.where(
        m > 0, np.sqrt(2.0), 1.0
    )
    values, degree = (
        np.concatenate([made.real, made.imag[:, m > 0]], axis=1),
        np.concatenate([l, l[m > 0]]),
    )
    return values, (degree * (degree + 1)).astype(np.float64)


def log_evidence(o: Observations, wander: np.ndarray) -> np.ndarray:
    """Log (s) of the mean likelihood of the Sun's readings over all ways of a body that wanders by `wander` (s), rad s^-0.5 about
    each axis, and has no rate beside; its first attitude may be any. Likelihoods are in the measure of the terms' costs."""
    everywhere = Seen(
        np.repeat(facing(sphere(EVERYWHERE))[:, None], len(o), axis=1),
        np.zeros((EVERYWHERE, len(o), 3)),
    )
    cost = np.sum([normal(term, everywhere)[2] for term in o.of_sun], axis=0)
    least = cost.min(axis=0)
    values, order = harmonics()
    density, total = np.ones((EVERYWHERE, len(wander))), np.full(len(wander), -least.sum())
    for k in range(len(o)):
        if k:
            spread = np.exp(-order[:, None] * wander**2 * (o.t_s[k] - o.t_s[k - 1]) / 2)
            density = np.maximum(
                values @ (spread * (values.T @ density)) * (4 * np.pi / EVERYWHERE), 0.0
            )
        density = density * np.exp(least[k] - cost[:, k])[:, None]
        mean = np.maximum(density.mean(axis=0), 1e-300)
        density, total = density / mean, total + np.log(mean)
    return total


def about_most(o: Observations, seen: Seen, wander: np.ndarray) -> np.ndarray:
    """What `log_evidence` (s) would be about if each reading were met as well as can be, and as sharp as at one motion `seen`: by
    the part of the directions within reach that it allows. Quick, and far below any motion's where the readings are sharp."""
    across = np.linalg.eigvalsh(measured(o, seen)[0][0, :, :3, :3])[
        :, 1:
    ]  # the turn about the Sun is not seen
    allowed = 1 / np.sqrt(np.maximum(across.prod(axis=1), 1e-300))
    reach = np.minimum(
        wander[:, None] ** 2 * np.diff(o.t_s, prepend=-np.inf), 2.0
    )  # all directions are 4 pi
    return np.minimum(np.log(allowed / reach), 0.0).sum(axis=1)
