"""Where a search of :mod:`sunspin.estimate.rates.search` starts: rates that take the Sun from one sample to the next.

Two directions a known time apart leave a family of constant rates: one angle, the sign of the axis, and whole turns. Where the
body's own motion or its wheels turn the rate between the two, no constant rate is a start, and a grid of rates takes its place.
What a gyro or an attitude sensor says is a start as well.
"""

from __future__ import annotations

import numpy as np

from sunspin.estimate.rates.images import imaged, images_of, one_of_each
from sunspin.estimate.rates.motion import Body, nutation
from sunspin.estimate.rates.smooth import costs
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.term import SUN_N, facing
from sunspin.vehicle.response.planes import sphere

ANGLES = 36
"""Turns tried in each full turn, 10 degrees apart: the smoother's basin is wider than that."""

GRID = 500
"""Directions on the sphere (about 9 degrees apart) tried where powers alone bound the Sun."""

CANDIDATES = 10
"""Directions kept of such a region."""

PRECESSION_RAD = 0.5
"""A rate that turns in the body by more than this between samples: a constant rate is no start then."""

COARSE_RAD = 0.6
"""A grid with wider steps than this, as turns between two samples, may miss a motion."""

GYRO_RAD = 0.5
"""A gyro that errs by less than this between two samples is a start good enough to be the only one."""

ALIASED = 3
"""Motions, the likeliest, of which aliases are tried."""

EVEN_RAD = 0.5
"""Samples are even where whole turns between the closest two are whole turns between all others, to this."""

GRID_RAD, GRID_MOST = 0.35, 200_000
"""Step of the grid of rates, as a turn between the first pair of samples, and how many starts it may make."""


def blind_axis(o: Observations) -> np.ndarray | None:
    """The direction (3) along which nothing sees the Sun, where it is known from panels in one plane alone; else None."""
    if o.points.any():
        return None
    axes = [term.blind_axis() for term in o.of_sun]
    return axes[0] if len(axes) == 1 else None


def mirrored(track: Track, axis: np.ndarray) -> Track:
    """Hypotheses as a mirror across the plane of `axis` shows them: panels in that plane read the same."""
    return imaged(track, np.eye(3) - 2 * np.outer(axis, axis))


def candidates(o: Observations, index: int) -> np.ndarray:
    """Directions (n, 3) of the Sun that the sample `index` allows, best first; where nothing sees it, its own."""
    if not o.of_sun:
        return SUN_N[None]
    for term in o.of_sun:
        if (sharp := term.directions(index)) is not None:
            return sharp
    grid = sphere(GRID)
    still = Track(facing(grid)[:, None], np.zeros((GRID, 1, 3)))
    cost = costs(o.part(index, index + 1), still)[:, 0]
    allowed = grid[cost < cost.min() + 3.0]
    first = images_of(o) @ grid[np.argmin(cost)]
    while len(first) < min(
        CANDIDATES, len(allowed)
    ):  # the farthest from those taken already: they span the region
        first = np.concatenate([first, allowed[[np.argmin((allowed @ first.T).max(axis=1))]]])
    return first


def rates_between(first: np.ndarray, second: np.ndarray, dt: float, rate_max: float) -> np.ndarray:
    """Constant rates (n, 3) rad/s that carry one direction (3) in the body to another (3) in `dt` s, `rate_max` at most."""
    apart = float(np.arccos(np.clip(first @ second, -1, 1)))
    middle = first + second
    side = np.cross(first, second)
    if np.linalg.norm(side) < 1e-6:
        side = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    if np.linalg.norm(middle) < 1e-6:
        middle = np.cross(side, first)
    middle, side = middle / np.linalg.norm(middle), side / np.linalg.norm(side)
    angle = np.linspace(
        apart, np.pi, ANGLES // 2
    )  # larger ones are turns the other way about the opposite axis
    tilt = np.clip(
        np.sin(apart / 2) / np.maximum(np.sin(angle / 2), 1e-9), 0, 1
    )  # sine of the axis's angle from the Sun
    along = np.sqrt(1 - tilt**2) / max(np.cos(apart / 2), 1e-9)
    along = np.clip(np.concatenate([along, -along]), -1, 1)
    axis = along[:, None] * middle + np.sqrt(1 - along**2)[:, None] * side
    turns = np.arange(int(rate_max * dt / (2 * np.pi)) + 1)
    total = np.concatenate([angle, angle])[:, None] + 2 * np.pi * turns
    # the body's turn is the opposite of the Sun's; a turn by the rest of a circle goes the other way about the axis
    found: list[np.ndarray] = []
    found += [
        -axis[:, None] * total[..., None] / dt,
        axis[:, None] * (2 * np.pi * (turns + 1) - total[:, :1])[..., None] / dt,
    ]
    if apart < 0.5 and len(turns) > 1:  # nearly whole turns: about any axis
        found.append(sphere(80)[:, None] * (2 * np.pi * turns[1:])[:, None] / dt)
    rates = np.concatenate([np.reshape(rate, (-1, 3)) for rate in found])
    return rates[np.linalg.norm(rates, axis=1) <= rate_max]


def aliases(o: Observations, track: Track, rate_max: float) -> Track:
    """Motions that are seen in the same attitudes as some (K), the likeliest first, and turn whole turns more or less between
    samples, no faster than `rate_max`: none where uneven times or a gyro tell them apart, or no turn hides between samples."""
    steps = np.diff(o.t_s)
    index = int(np.argmin(steps))
    turn, uneven = 2 * np.pi / steps[index], steps / steps[index] - np.round(steps / steps[index])
    told = gyro_decides(o, index) or 2 * np.pi * np.abs(uneven).max() > EVEN_RAD
    speed = np.linalg.norm(track.omega, axis=2, keepdims=True)
    most = 0 if told else int(2 * rate_max / turn)
    more = turn * np.array([k for k in range(-most, most + 1) if k])[:, None, None, None]
    near = track.omega[:ALIASED] * (
        1 + more / np.maximum(speed[:ALIASED], 1e-12)
    )  # (turns, K, n, 3)
    which, motion = np.nonzero(np.linalg.norm(near, axis=3).mean(axis=2) < rate_max)
    return Track(track.attitude[motion], near[which, motion])


def unsteadiness(body: Body, momentum: np.ndarray, rate_max: float) -> float:
    """rad/s at which uneven moments and the wheels' momenta (..., 3) turn a rate of `rate_max` round in the body, at most."""
    low, middle, high = np.linalg.eigvalsh(body.inertia)
    return float(np.max(nutation(body, momentum), initial=0.0)) + rate_max * (high - low) / middle


def steady(o: Observations, index: int, motion: Motion, rate_max: float) -> bool:
    """Whether rates up to the largest hardly turn in the body from sample `index` to the next."""
    turned = unsteadiness(motion.body, o.momentum[index : index + 2], rate_max) * (
        o.t_s[index + 1] - o.t_s[index]
    )
    return bool(turned < PRECESSION_RAD)


def gyro_decides(o: Observations, index: int) -> bool:
    """Whether a gyro tells the turn from sample `index` to the next, so that no other rate need be tried."""
    return bool(rate_sigma(o, index) * (o.t_s[index + 1] - o.t_s[index]) < GYRO_RAD)


def rate_sigma(o: Observations, index: int) -> float:
    """rad/s to which some sensor reads the rate at sample `index` and the next."""
    return min((term.rate_sigma(index) for term in o.terms), default=np.inf)


def starts(
    o: Observations, index: int, motion: Motion, rate_max: float, trust: bool = False
) -> tuple[np.ndarray, np.ndarray, float]:
    """Directions of the Sun (K, 3) and rates (K, 3) at sample `index` from which the next sample may be reached, and how far
    (rad) the turn between the two may be from that of the nearest start. `trust`: take the gyro's word, where it decides."""
    dt = float(o.t_s[index + 1] - o.t_s[index])
    suns = one_of_each(o, candidates(o, index))
    told = told_rates(o, index, rate_max)
    if trust and gyro_decides(o, index) and len(told):
        apart = max(2 * np.pi / ANGLES, 2 * rate_sigma(o, index) * dt)
        return np.repeat(suns, len(told), axis=0), np.tile(told, (len(suns), 1)), apart
    if not steady(o, index, motion, rate_max):
        size = grid_step(len(suns), dt, rate_max)
        rates = np.concatenate([_ball(size, rate_max), told])
        return np.repeat(suns, len(rates), axis=0), np.tile(rates, (len(suns), 1)), size * dt
    found = [
        (
            s0,
            np.concatenate(
                [*(rates_between(s0, s1, dt, rate_max) for s1 in candidates(o, index + 1)), told]
            ),
        )
        for s0 in suns
    ]
    return (
        np.concatenate([np.broadcast_to(s0, rates.shape) for s0, rates in found]),
        np.concatenate([rates for _, rates in found]),
        2 * np.pi / ANGLES,
    )


def grid_step(suns: int, dt: float, rate_max: float) -> float:
    """Step (rad/s) of a grid of rates: fine enough for the smoother, unless that were too many."""
    return max(GRID_RAD / dt, rate_max * (4 * np.pi / 3 * suns / GRID_MOST) ** (1 / 3))


def coarse(o: Observations, motion: Motion, rate_max: float) -> bool:
    """Whether the shortest interval of a pass is so long for the largest rate that the grid of starts may miss a motion."""
    index = int(np.argmin(np.diff(o.t_s)))
    dt = float(o.t_s[index + 1] - o.t_s[index])
    return not steady(o, index, motion, rate_max) and grid_step(1, dt, rate_max) * dt > COARSE_RAD


def finest(o: Observations) -> float:
    """The largest rate (rad/s) up to which the grid of starts of a pass misses no motion; see `coarse`."""
    return COARSE_RAD / float(np.diff(o.t_s).min()) * (GRID_MOST / (4 * np.pi / 3)) ** (1 / 3)


def _ball(size: float, rate_max: float) -> np.ndarray:
    axis = np.arange(-np.floor(rate_max / size), np.floor(rate_max / size) + 1) * size
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.linalg.norm(grid, axis=1) <= rate_max]


def told_rates(o: Observations, index: int, rate_max: float) -> np.ndarray:
    """Rates (n, 3) that a gyro or the change of a given attitude tells at sample `index`, with whole turns more or less."""
    dt = float(o.t_s[index + 1] - o.t_s[index])
    found = [np.zeros((0, 3)), *(term.rates(index, dt, rate_max) for term in o.terms)]
    rates = np.concatenate(found)
    rates = rates[np.isfinite(rates).all(axis=1)]
    return rates[np.linalg.norm(rates, axis=1) <= rate_max]
