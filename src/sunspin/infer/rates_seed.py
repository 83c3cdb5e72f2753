"""Where :mod:`sunspin.infer.rates` starts from: every turn, and every number of turns, that takes one direction to the next.

Two directions a known time apart leave a family of constant rates: one angle, the sign of the axis, and whole turns. The
family of a pair of neighbours is laid out, tried on the samples around, the best are smoothed there, and the window grows by
a sample at either end while hypotheses that have become alike or improbable are dropped.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.errors import InputError, sentence
from sunspin.infer.rates_motion import nutation, step, turn
from sunspin.infer.rates_smooth import Motion, Observations, Track, measured, smooth
from sunspin.measure.panels import sphere

ANGLES = 36
"""Turns tried in each full turn, 10 degrees apart: the smoother's basin is wider than that."""

GRID = 500
"""Directions on the sphere (about 9 degrees apart) tried where powers alone bound the Sun."""

CANDIDATES = 10
"""Directions kept of such a region."""

SHARP_RAD = 0.15
"""A direction better than this is a point to start from; a worse one is a region."""

WINDOW = 2
"""Samples on either side of the first pair on which the rates are first tried."""

DENSE_RAD = 2.2
"""Samples so close that the body turns by less than this between them leave no doubt about whole turns."""

PRECESSION_RAD = 0.5
"""Wheels that turn the body's rate by more than this between samples: a constant rate is no start then."""

GRID_RAD, GRID_RATES = 0.35, 1500
"""Step of the grid of rates, as a turn between the first pair of samples, and about how many rates at most."""

SEED_NOISE = 1e-4
"""rad/s^1.5; hypotheses grow under at least this much of unknown torque, however well the motion is known."""

COOLING = 1.7
"""The unknown torque falls by exp(1.7) at each step from there to what is asked for."""

GROW_SHARE = 6
"""The window grows by a sixth of its samples at either end: what is known then still carries."""

MAX_TURNS = 100
"""Whole turns between two samples, at most: where both bound the Sun only, as many would make a million rates to try."""

KEEP_FIRST, KEEP = 120, 32
"""Hypotheses kept after the first trial, and while the window grows."""

DROP = 18.0
"""Hypotheses less probable than the best by exp(-18) are dropped."""

ALIKE_RAD = 0.25
"""Two hypotheses whose turns between neighbours differ by less everywhere are one."""


def facing(sun_B: np.ndarray) -> np.ndarray:
    """Some attitude (..., 3, 3), B_from_N, that shows the Sun of N in the direction `sun_B` (..., 3)."""
    other = np.where(np.abs(sun_B[..., :1]) < 0.7, [1.0, 0.0, 0.0], [0.0, 1.0, 0.0])
    x = np.cross(other, sun_B)
    x = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return np.stack([x, np.cross(sun_B, x), sun_B], axis=-1)


def candidates(o: Observations, index: int) -> np.ndarray:
    """Directions (n, 3) of the Sun that the sample `index` allows, best first."""
    if o.told[index] and np.trace(o.sun_cov[index]) < 3 * SHARP_RAD**2:
        return o.sun_B[index : index + 1]
    grid = sphere(GRID)
    still = Track(facing(grid)[:, None], np.zeros((GRID, 1, 3)))
    cost = measured(o.part(index, index + 1), still)[2][:, 0]
    allowed = grid[cost < cost.min() + 3.0]
    first = grid[np.argmin(cost)][None]
    while len(first) < min(CANDIDATES, len(allowed)):  # the farthest from those taken already: they span the region
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
    angle = np.linspace(apart, np.pi, ANGLES // 2)  # larger ones are turns the other way about the opposite axis
    tilt = np.clip(np.sin(apart / 2) / np.maximum(np.sin(angle / 2), 1e-9), 0, 1)  # sine of the axis's angle from the Sun
    along = np.sqrt(1 - tilt**2) / max(np.cos(apart / 2), 1e-9)
    along = np.clip(np.concatenate([along, -along]), -1, 1)
    axis = along[:, None] * middle + np.sqrt(1 - along**2)[:, None] * side
    turns = np.arange(int(rate_max * dt / (2 * np.pi)) + 1)
    total = np.concatenate([angle, angle])[:, None] + 2 * np.pi * turns
    # the body's turn is the opposite of the Sun's; a turn by the rest of a circle goes the other way about the axis
    found = [-axis[:, None] * total[..., None] / dt, axis[:, None] * (2 * np.pi * (turns + 1) - total[:, :1])[..., None] / dt]
    if apart < 0.5 and len(turns) > 1:  # nearly whole turns: about any axis
        found.append(sphere(80)[:, None] * (2 * np.pi * turns[1:])[:, None] / dt)
    rates = np.concatenate([np.reshape(rate, (-1, 3)) for rate in found])
    return rates[np.linalg.norm(rates, axis=1) <= rate_max]


def wider(o: Observations, noise: float, middle_s: float) -> Observations:
    """The same measurements, trusted less the farther they are from `middle_s`, as a constant rate holds only near it."""
    drift = noise * np.sqrt(np.abs(o.t_s - middle_s) ** 3 / 3)
    size = np.linalg.norm(np.nan_to_num(o.field), axis=1).max(initial=0.0)
    return replace(
        o,
        sun_cov=o.sun_cov + (drift**2)[:, None, None] * np.eye(3),
        power_sigma=np.hypot(o.power_sigma, drift[:, None] * np.linalg.norm(o.rows, axis=1) * o.scale[:, None]),
        field_sigma=np.hypot(o.field_sigma, drift.max() * size / 2),
    )


def first_tracks(o: Observations, index: int, motion: Motion, rate_max: float) -> tuple[Track, int, int]:
    """The best constant rates around the pair (index, index + 1), smoothed on samples low to high - 1."""
    low, high = max(0, index - WINDOW), min(len(o), index + 2 + WINDOW)
    o = o.part(low, high)
    dt = o.t_s[1 + index - low] - o.t_s[index - low]
    if not rate_max * dt < 2 * np.pi * MAX_TURNS:
        raise InputError(
            sentence("too many whole turns fit between two samples to try them all", got=f"{rate_max * dt / (2 * np.pi):.3g} turns",
                     do="give a smaller --max-rate (max_rate_rad_s)")
        )  # fmt: skip
    precession = nutation(motion.body, o.momentum) * dt
    family = _wheel_family if precession > PRECESSION_RAD else _constant_family
    track = family(o, index - low, motion, rate_max)
    if track is None:
        return Track(np.zeros((0, len(o), 3, 3)), np.zeros((0, len(o), 3))), low, high
    rate = track.omega[:, index - low]
    loose = wider(o, motion.noise, o.t_s[index - low] + dt / 2)
    parts = np.array_split(np.arange(len(rate)), 1 + len(rate) // 4000)
    cost = np.concatenate([measured(loose, track.take(part))[2].sum(axis=1) for part in parts])
    cost += (rate**2).sum(axis=1) / (2 * motion.rate_prior**2)
    track = track.take(np.argsort(cost, kind="stable")[:KEEP_FIRST])
    return distinct(smooth(o, track, motion, steps=6), o.t_s), low, high


def _constant_family(o: Observations, index: int, motion: Motion, rate_max: float) -> Track | None:
    """Constant rates that carry the Sun of sample `index` to that of the next, over all samples of `o`."""
    start, rate = [], []
    for s0 in candidates(o, index):
        for s1 in candidates(o, index + 1):
            found = rates_between(s0, s1, o.t_s[index + 1] - o.t_s[index], rate_max)
            start.append(np.broadcast_to(s0, found.shape))
            rate.append(found)
    sun, rates = np.concatenate(start), np.concatenate(rate)
    if not len(rates):
        return None
    times = o.t_s - o.t_s[index]
    attitude = turn(facing(sun)[:, None], rates[:, None] * times[None, :, None])
    return Track(attitude, np.repeat(rates[:, None], len(times), axis=1))


def _wheel_family(o: Observations, index: int, motion: Motion, rate_max: float) -> Track:
    """Where wheels turn the rate itself between two samples: rates on a grid in a ball, moved by the equations of motion."""
    size = max(GRID_RAD / (o.t_s[index + 1] - o.t_s[index]), rate_max * (4 * np.pi / 3 / GRID_RATES) ** (1 / 3))
    axis = np.arange(-np.floor(rate_max / size), np.floor(rate_max / size) + 1) * size
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    grid = grid[np.linalg.norm(grid, axis=1) <= rate_max]
    suns = candidates(o, index)
    omega = [np.tile(grid, (len(suns), 1))]
    attitude = [np.repeat(facing(suns), len(grid), axis=0)]
    for way in (1, -1):
        first, last = (index, len(o) - 1) if way == 1 else (index, 0)
        for i in range(first, last, way):
            at = -1 if way == 1 else 0
            made, rate = step(motion.body, omega[at], np.full(len(omega[at]), o.t_s[i + way] - o.t_s[i]), o.wheels(i, i + way))
            place = len(omega) if way == 1 else 0
            attitude.insert(place, made @ attitude[at])
            omega.insert(place, rate)
    return Track(np.stack(attitude, axis=1), np.stack(omega, axis=1))


def distinct(track: Track, times: np.ndarray, keep: int = KEEP) -> Track:
    """Without the improbable and without copies, best first."""
    order = np.argsort(track.cost, kind="stable")
    if not len(order):
        return track
    order = order[track.cost[order] < track.cost[order[0]] + DROP]
    turns = np.diff(times)[:, None] if len(times) > 1 else np.ones((1, 1))
    chosen: list[int] = []
    for i in order:
        apart = [np.max(np.linalg.norm((track.omega[i, :-1] - track.omega[j, :-1]) * turns, axis=-1)) for j in chosen]
        if not apart or min(apart) > ALIKE_RAD:
            chosen.append(int(i))
        if len(chosen) == keep:
            break
    return track.take(np.array(chosen, dtype=int))


def grow(o: Observations, track: Track, low: int, high: int, motion: Motion) -> Track:
    """Carry hypotheses of samples low to high - 1 over all samples."""
    while len(track.omega) and (low > 0 or high < len(o)):
        attitude, omega = track.attitude, track.omega
        for _ in range(max(1, (high - low) // GROW_SHARE)):
            if high < len(o):
                dt = np.full(len(omega), o.t_s[high] - o.t_s[high - 1])
                made, rate = step(motion.body, omega[:, -1], dt, o.wheels(high - 1, high))
                attitude = np.concatenate([attitude, (made @ attitude[:, -1])[:, None]], axis=1)
                omega = np.concatenate([omega, rate[:, None]], axis=1)
                high += 1
            if low > 0:
                dt = np.full(len(omega), o.t_s[low - 1] - o.t_s[low])
                made, rate = step(motion.body, omega[:, 0], dt, o.wheels(low, low - 1))
                attitude = np.concatenate([(made @ attitude[:, 0])[:, None], attitude], axis=1)
                omega = np.concatenate([rate[:, None], omega], axis=1)
                low -= 1
        part = o.part(low, high)
        track = distinct(smooth(part, Track(attitude, omega), motion, steps=4), part.t_s)
    return track


def search(o: Observations, motion: Motion, rate_max: float, pairs: int | None = None) -> Track:
    """All modes of a pass, best first."""
    loose = replace(motion, noise=max(motion.noise, SEED_NOISE))
    return cooled(o, seeds(o, loose, rate_max, pairs), loose.noise, motion)


def cooled(o: Observations, track: Track, noise: float, motion: Motion) -> Track:
    """Hypotheses of a loose motion (`noise`) brought to a stiffer one by steps: at once, they would stay where they are."""
    steps = int(np.ceil(abs(np.log(noise / motion.noise)) / COOLING))
    for level in np.geomspace(noise, motion.noise, steps + 1)[1:]:
        track = distinct(smooth(o, track, replace(motion, noise=float(level)), steps=12), o.t_s)
    return distinct(smooth(o, track, motion, steps=25), o.t_s)


def seeds(o: Observations, motion: Motion, rate_max: float, pairs: int | None = None) -> Track:
    """Modes under a loose motion: from the `pairs` shortest intervals, grown over the whole pass and joined.

    Default: three, or one where the samples begin so close together that no rate hides between them.
    """
    dense = np.diff(o.t_s)[:3].max(initial=0.0) * rate_max < DENSE_RAD
    pairs = pairs or (1 if dense else 3)
    quality = np.where(o.told, 1.0, 2.0)
    order = np.argsort(np.diff(o.t_s) * (quality[1:] + quality[:-1]), kind="stable")[:pairs]
    tracks = [grow(o, *first_tracks(o, int(i), motion, rate_max), motion) for i in order]
    tracks = [track for track in tracks if len(track.omega)]
    if not tracks:
        raise InputError(
            sentence(
                "no rate up to the largest allowed takes the Sun from one sample to the next",
                got=f"largest rate {rate_max:.4g} rad/s", do="raise --max-rate, or check the times and the directions",
            )
        )  # fmt: skip
    joined = Track(*(np.concatenate(parts) for parts in zip(*((t.attitude, t.omega, t.cost) for t in tracks), strict=True)))
    return distinct(joined, o.t_s)

