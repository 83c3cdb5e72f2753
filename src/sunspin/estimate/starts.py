"""Where a search starts: rates that take the Sun from one sample to the next.

Two directions a known time apart leave a family of constant rates: one angle, the sign of the axis, and whole turns. Where moments
or wheels turn the rate between the two, no constant rate is a start, and a grid of rates takes its place. What a gyro says is a
start as well. Starts are coarse, and Student's law lets a start that misses most samples rest where it is: so they are tried, and
first fitted, with errors as wide as they are apart.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations
from typing import NamedTuple

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.carry import nutation
from sunspin.estimate.chain import costs, fit_single_shooting, propagate
from sunspin.estimate.copies import distinct
from sunspin.estimate.images import images_of
from sunspin.estimate.model import SUN_N, Body, Model, Track
from sunspin.estimate.settings import AlternativeSettings, SearchSettings
from sunspin.estimate.terms.term import facing
from sunspin.vehicle.response.planes import sphere

GRID, CANDIDATES, ALLOWED = 500, 10, 3.0
"""Directions (9 degrees apart) tried where powers alone bound the Sun; how many of such a region are kept; how much more than the
best one they may cost."""

PRECESSION_RAD = 0.5
"""If a rate turns in the body by more than this between two samples, a constant rate is no start."""

COARSE_RAD = 0.6
"""A grid with wider steps than this, as turns between two samples, may miss a motion."""

GYRO_RAD = 0.5
"""A gyro that errs by less than this between two samples is a start good enough to be the only one."""

DENSE_RAD = 2.2
"""Samples between which the body turns by less than this leave no doubt about whole turns."""

BLUR = 0.6
"""Errors of starts as a share of their distance from each other."""

UNSEEN, BOUNDED = 100.0, 2.0
"""Intervals count so many times longer if a sample does not see the Sun, and if it only bounds its direction."""

ANY_AXIS_RAD = 0.5
"""Two directions nearer to each other than this may be whole turns apart, about any axis."""

MOST_AXES = 4000
"""Axes of whole turns that are tried, at most: enough for two turns. For more turns they are farther apart."""

AT_ONCE = 4000
"""Starts that are carried together: memory."""

OTHER_BODIES = np.array(list(permutations((1.0, 0.0, -1.0))))
"""Sigmas by which the three moments differ from those of a sphere."""

FINE = 200
"""Turns by which the family of rates between two directions is drawn before its points are spaced evenly."""


class PairStarts(NamedTuple):
    """States at a sample from which a body may reach the next one: directions to the Sun `sun_B` (K, 3) and rates `omega` (K, 3).

    `apart_rad`: how far the turn between the two samples may be from that of the nearest start.
    """

    sun_B: np.ndarray
    omega: np.ndarray
    apart_rad: float


def pair_starts(
    model: Model, s: SearchSettings, slowest: float = 0.0
) -> Iterator[tuple[slice, Track]]:
    """Yield windows, each with the motions from which a search may begin there: those that a pair of neighbouring samples allows.

    The most promising pair comes first. Rates that take the Sun from its first sample to the second are tried on the samples around
    the pair, the window, and the best are fitted there. `model`: without unknowns, for the search. `slowest` (rad/s): slower rates
    are left out.
    """
    pairs = _pairs(model)
    trusted = gyro_decides(model, pairs[0])
    for number, first in enumerate(pairs):
        window = slice(max(0, first - s.around), min(len(model.obs), first + 2 + s.around))
        around, sample = model.seeing(window), first - window.start
        # a gyro is trusted at the first pair alone: further pairs are tried if nothing fits, and then it may be what is wrong
        begin = starts(around, sample, s, trusted and number == 0)
        if slowest:
            fast = np.linalg.norm(begin.omega, axis=1) > slowest
            begin = begin._replace(sun_B=begin.sun_B[fast], omega=begin.omega[fast])
        if len(begin.omega) > s.crowd:
            begin = _thinned(around, sample, begin, s)
        if not len(begin.omega):
            continue
        motions = _best_starts(around, sample, begin, s.tried[2])
        # three fits, each of which trusts the readings more: at first a start may be as far off as the starts are apart
        for share in (1.0, 0.3, 0.0):
            loose = _loosen_terms(around, sample, share * begin.apart_rad)
            motions = fit_single_shooting(loose, sample, motions, 4)
            motions = motions.take(distinct(motions, around.obs.t_s, s, s.tried[2]))
        yield window, motions


def pairs_to_try(model: Model, s: SearchSettings) -> int:
    """Return how many pairs of samples a search starts from: one if a gyro, dense samples or a grid leave no rate out.

    A grid leaves none out unless errors of the inertia turn the body off it within the first window: of a long body at 15 deg/s,
    its products two sigmas off, every start near the truth was dropped there, and an alias that fits was decided. With another
    sensor each pair of samples determines the whole turn between them: two spinners with a magnetometer were found from one pair,
    and three took all the computing budget.
    """
    if len(images_of(model)) > 1:
        # panels bound the Sun so little that one pair may start from nothing
        return s.places_if_flat
    first = _pairs(model)[0]
    dense = np.diff(model.obs.t_s)[:3].max() * model.rate_max < DENSE_RAD
    interval_s = float(model.obs.t_s[first + 1] - model.obs.t_s[first])
    off_grid = model.body.wander * model.rate_max * interval_s > s.basin_rad / 2
    grid_decides = not _constant_rate_holds(model, first) and not (off_grid and model.obs.only_sun)
    return 1 if dense or gyro_decides(model, first) or grid_decides else s.places


def _pairs(model: Model) -> np.ndarray:
    """Return the first samples (n - 1) of all pairs of neighbours, the most promising first: short, and sharp directions."""
    obs = model.obs
    sharp = [any(len(term.starts(i).directions) for term in obs.terms) for i in range(len(obs))]
    sees_sun = obs.sees_sun | (not obs.sees_sun.any())
    # the interval counts as longer the worse the directions at both ends are
    penalty = np.where(sharp, 1.0, BOUNDED) * np.where(sees_sun, 1.0, UNSEEN)
    return np.argsort(np.diff(obs.t_s) * (penalty[1:] + penalty[:-1]), kind="stable")


def gyro_decides(model: Model, first: int) -> bool:
    """Return whether a gyro determines the turn from sample `first` to the next, so that no other rate need be tried."""
    sigma = min((term.starts(first).rate_sigma for term in model.obs.terms), default=np.inf)
    return bool(sigma * (model.obs.t_s[first + 1] - model.obs.t_s[first]) < GYRO_RAD)


def _constant_rate_holds(model: Model, first: int) -> bool:
    """Return whether unequal moments and wheels hardly turn any rate in the body from sample `first` to the next."""
    low, middle, high = np.linalg.eigvalsh(model.body.inertia)
    wheels = nutation(model.body.inertia, model.obs.momentum[first : first + 2]).max()
    turning = wheels + model.rate_max * (high - low) / middle
    return bool(turning * (model.obs.t_s[first + 1] - model.obs.t_s[first]) < PRECESSION_RAD)


def starts(model: Model, first: int, s: SearchSettings, trust_gyro: bool) -> PairStarts:
    """Return the starts of a pair of neighbouring samples, the earlier of which is `first`; rest is one unless a gyro is trusted.

    Each direction to the Sun that the first sample allows has rates of its own: those that a trusted gyro reads; or a grid, if
    moments or wheels turn the rate between the samples; or else all constant rates that end at a direction of the second sample.
    """
    dt = float(model.obs.t_s[first + 1] - model.obs.t_s[first])
    rate_max = model.rate_max
    if not rate_max * dt < 2 * np.pi * s.most_turns:
        raise InputError(
            "too many whole turns fit between two samples to try them all",
            got=f"{rate_max * dt / (2 * np.pi):.3g} turns",
            do="give a smaller --max-rate-deg-s (max_rate_rad_s)",
        )
    by_sensor = [term.starts(first) for term in model.obs.terms]
    gyro_rates = np.concatenate([np.zeros((0, 3)), *(sensor.rates for sensor in by_sensor)])
    gyro_rates = gyro_rates[np.linalg.norm(gyro_rates, axis=1) <= rate_max]
    suns = allowed_directions(model, first)
    # `rates_of_suns`: rates (m, 3) for each direction to the Sun; `apart`: from a turn to that of the nearest start, rad, at most
    if trust_gyro and len(gyro_rates) and gyro_decides(model, first):
        sigma = min(sensor.rate_sigma for sensor in by_sensor)
        rates_of_suns, apart = [gyro_rates] * len(suns), max(s.step_rad, 2 * sigma * dt)
    elif not _constant_rate_holds(model, first):
        # wheels or moments turn the rate in the body, so that the rates that end at a direction have no closed form
        size = grid_step(len(suns), dt, rate_max, s)
        grid = np.concatenate([_rate_grid(size, rate_max), gyro_rates])
        rates_of_suns, apart = [grid] * len(suns), size * dt
    else:
        ends, rest = allowed_directions(model, first + 1), np.zeros((1, 3))
        rates_of_suns = []
        for sun in suns:
            rates = [constant_rates(sun, end, dt, rate_max, s.step_rad) for end in ends]
            # If the directions are alike, whole turns about any axis end there too. They are two basins apart: three quarters of
            # all axes have one within a basin, and further pairs of samples give the others another chance.
            if (ends @ sun).max() > np.cos(ANY_AXIS_RAD):
                rates.append(whole_turns(dt, rate_max, 2 * s.basin_rad))
            rates_of_suns.append(np.concatenate([rest, *rates, gyro_rates]))
        apart = s.step_rad
    sun_B = np.repeat(suns, [len(rates) for rates in rates_of_suns], axis=0)
    return PairStarts(sun_B, np.concatenate(rates_of_suns), apart)


def allowed_directions(model: Model, sample: int) -> np.ndarray:
    """Return directions to the Sun (c, 3) that a sample allows, best first.

    They are those of a Sun sensor; or of powers, which bound the Sun to a region of the sky, some that span the region. If nothing
    shows the Sun, any attitude will do, and the direction is z.
    """
    if not any(term.of_sun for term in model.obs.terms):
        return SUN_N[None]
    for term in model.obs.terms:
        if len(sharp := term.starts(sample).directions):
            return sharp
    grid = sphere(GRID)
    still = Track.free(facing(grid)[:, None], np.zeros((GRID, 1, 3)))
    cost = costs(model.obs.take(slice(sample, sample + 1)), still)[:, 0]
    allowed = grid[cost < cost.min() + ALLOWED]
    spanning = grid[[np.argmin(cost)]]
    while len(spanning) < min(CANDIDATES, len(allowed)):
        # next the direction whose nearest one of those taken is farthest away
        farthest = np.argmin((allowed @ spanning.T).max(axis=1))
        spanning = np.concatenate([spanning, allowed[[farthest]]])
    return spanning


def constant_rates(
    first: np.ndarray, second: np.ndarray, dt: float, rate_max: float, step_rad: float
) -> np.ndarray:
    """Return constant rates (m, 3) that carry a direction (3) of the body to another (3) in dt s, `rate_max` at most.

    The axes of such turns lie on the great circle that halves the angle between the two, through their middle m and a unit vector s
    across both. A turn by the angle a whose axis is at the angle b from both directions takes one to the other if sin b = sin(apart
    / 2) / sin(a / 2). The axis is then cos(b) / cos(apart / 2) m plus the rest along s. `step_rad`: spacing of the turns that are
    tried.
    """
    apart = float(np.arccos(np.clip(first @ second, -1, 1)))
    middle, side = first + second, np.cross(first, second)
    if np.linalg.norm(side) < 1e-6:  # the same direction, or the opposite one: any axis across
        side = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    if np.linalg.norm(middle) < 1e-6:
        middle = np.cross(side, first)
    middle, side = middle / np.linalg.norm(middle), side / np.linalg.norm(side)
    # most angles near the smallest, where the axis turns fastest; beyond pi they are turns the other way about the opposite axis
    angle = apart + (np.pi - apart) * np.linspace(0.0, 1.0, FINE) ** 2
    sin_b = np.clip(np.sin(apart / 2) / np.maximum(np.sin(angle / 2), 1e-9), 0, 1)
    # component of the axis along the middle
    along = np.sqrt(1 - sin_b**2) / max(np.cos(apart / 2), 1e-9)
    families = []
    for side_of_middle in (1.0, -1.0):
        cosine = np.clip(side_of_middle * along, -1, 1)[:, None]
        axis = cosine * middle + np.sqrt(1 - cosine**2) * side
        for turns in range(int(rate_max * dt / (2 * np.pi)) + 1):
            # the turn of the body is opposite to that of the Sun; by the rest of a circle it goes the other way about the axis
            families.append(-axis * (angle + 2 * np.pi * turns)[:, None])
            families.append(axis * (2 * np.pi * (turns + 1) - angle)[:, None])
    rates = np.concatenate([_spaced(family, step_rad) for family in families]) / dt
    return rates[np.linalg.norm(rates, axis=1) <= rate_max]


def whole_turns(dt: float, rate_max: float, spacing_rad: float) -> np.ndarray:
    """Return rates (m, 3) of whole turns in dt s about axes all over the sphere, `rate_max` at most.

    As rotation vectors those of equal size are `spacing_rad` apart.
    """
    rates = [np.zeros((0, 3))]
    for turns in range(1, int(rate_max * dt / (2 * np.pi)) + 1):
        angle = 2 * np.pi * turns
        axes = min(int(4 * np.pi * (angle / spacing_rad) ** 2), MOST_AXES)
        rates.append(sphere(axes) * angle / dt)
    return np.concatenate(rates)


def _spaced(path: np.ndarray, step: float) -> np.ndarray:
    """Return some points of a path (n, 3), its ends among them, that are about a `step` or less apart along it."""
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    marks = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / step)) + 1)
    return path[np.unique(np.minimum(np.searchsorted(along, marks - 1e-12), len(path) - 1))]


def aliases(motions: Track, model: Model, s: AlternativeSettings) -> Track:
    """Return motions (K) with whole revolutions more and fewer between the samples, up to the largest rate.

    None if the samples are uneven, or a gyro excludes them. The angular momentum L of a free body is fixed in space: whole
    revolutions more about it between the samples show the same attitudes, and change the rate by a vector along L. How L moves in
    the body follows from the part of |L| I^-1 that differs between the axes. If the inertia I is known the faster body nutates
    faster, and hardly any alias fits. If it is not, a body fits for which that part is the same: exactly, without wheels.
    """
    turn, rate_max = _turn_of_aliases(model, s), model.rate_max
    if turn is None:
        return motions.take(slice(0))
    most = int(2 * rate_max / turn)
    changes = turn * np.array([k for k in range(-most, most + 1) if k])
    inertia, size, along = _momenta(model, motions.u, motions.omega)
    faster = motions.omega + changes[:, None, None, None] * along  # (changes, K, n, 3)
    change, which = np.nonzero(np.linalg.norm(faster, axis=3).mean(axis=2) < rate_max)
    u = motions.u[which]
    if model.body.sphere and len(model.body.errors):
        # rates about the axes of the body if all of L were along each: |L| I^-1, and as much more for all of them
        rates = size.mean(axis=1)[which, :, None] * np.linalg.inv(inertia[which])
        rates += changes[change, None, None] * np.eye(3)
        u[:, model.inertia_slice] = _errors_of_body(model.body, rates, u[:, model.inertia_slice])
    return Track(motions.attitude[which], faster[change, which], u)


def aliases_about_two_axes(motions: Track, model: Model, s: AlternativeSettings) -> Track:
    """Return the most probable motion (K) with whole revolutions more and fewer about L and about an axis of the body.

    None under the conditions of :func:`aliases`. A body with two like moments precesses about its angular momentum L and spins
    about its third axis, both at constant rates. Whole revolutions more of each between even samples show the same attitudes. The
    new motion must keep L fixed in space: that hardly ever holds for a known inertia, and gives another inertia for an unknown one.
    """
    turn = _turn_of_aliases(model, s)
    if turn is None or not len(motions) or not model.obs.only_sun:
        return motions.take(slice(0))
    best = motions.take(slice(1))
    inertia, size, along = (part[0] for part in _momenta(model, best.u, best.omega))
    # the axis about which the body spins: L makes a constant angle with it
    principal = np.linalg.eigh(inertia)[1]
    spin_axis = principal[:, np.argmin((along @ principal).std(axis=0))]
    cosine = float((along @ spin_axis).mean())

    most = min(int(2 * model.rate_max / turn), 6)  # either way about each axis
    whole = np.arange(-most, most + 1)
    about_L, about_axis = (grid.ravel() * turn for grid in np.meshgrid(whole, whole))
    faster = best.omega[0] + about_L[:, None, None] * along + about_axis[:, None, None] * spin_axis
    slow = np.linalg.norm(faster, axis=2).mean(axis=1) < model.rate_max
    u = np.repeat(best.u, len(faster), axis=0)
    if model.body.sphere and len(model.body.errors):
        # as in `aliases`; the rate about the spin axis if all of L were along it
        rates = size.mean() * np.linalg.inv(inertia) + about_L[:, None, None] * np.eye(3)
        if abs(cosine) > 0.2:  # else L is across the axis, and tells no moment about it
            spin = np.outer(spin_axis, spin_axis)
            rates = rates + (about_axis / cosine)[:, None, None] * spin
        u[:, model.inertia_slice] = _errors_of_body(model.body, rates, u[:, model.inertia_slice])
    # how far L is from its place in space, whichever way it points, rad; single revolutions are tried by `aliases`
    cosine_of_L = (_momenta(model, u, faster)[2] * along).sum(axis=2)
    off = np.arccos(np.clip(np.abs(cosine_of_L), 0.0, 1.0)).mean(axis=1)
    tried = np.flatnonzero(slow & (about_axis != 0) & (off < s.momentum_off_rad))
    # the bodies nearest to what is known of it first, eight at most; a known inertia is the same for all
    sigmas = np.linalg.norm(u[tried][:, model.inertia_slice], axis=1).round(1)
    which = tried[np.lexsort((off[tried], sigmas))[:8]]
    return Track(np.repeat(best.attitude, len(which), axis=0), faster[which], u[which])


def _momenta(
    model: Model, u: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return inertias (K, 3, 3), and size (K, n, 1) and direction (K, n, 3) of the angular momenta, in mean moments times rad/s.

    Of motions with unknowns u (K, m) and rates (K, n, 3): L = I w + h.
    """
    inertia = np.broadcast_to(model.body.inertia_at(u[:, model.inertia_slice]), (len(u), 3, 3))
    momentum = np.einsum("kij,knj->kni", inertia, omega) + model.obs.momentum
    size = np.linalg.norm(momentum, axis=2, keepdims=True)
    return inertia, size, momentum / np.maximum(size, 1e-12)


def _turn_of_aliases(model: Model, s: AlternativeSettings) -> float | None:
    """Return by how much, rad/s, a whole revolution between even samples changes the rate; None if no such alias is possible."""
    dt = np.diff(model.obs.t_s)
    first = int(np.argmin(dt))
    uneven = dt / dt[first] - np.round(dt / dt[first])
    if 2 * np.pi * np.abs(uneven).max() >= s.even_rad or gyro_decides(model, first):
        return None
    return float(2 * np.pi / dt[first])


def _errors_of_body(body: Body, rates: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return the errors (K, e) of the inertia, in sigmas, of bodies whose I^-1 is proportional to `rates` (K, 3, 3).

    Where that is no inertia of any body they are `otherwise` (K, e).
    """
    lowest, _, highest = np.linalg.eigvalsh(rates).T
    sound = (lowest > 0) | (highest < 0)  # the other way about L all are negative
    inertia = np.linalg.inv(np.where(sound[:, None, None], rates, np.eye(3)))
    inertia *= 3 / np.trace(inertia, axis1=1, axis2=2)[:, None, None]
    off = (inertia - body.inertia).reshape(-1, 9)
    u = np.linalg.lstsq(body.errors.reshape(-1, 9).T, off.T, rcond=None)[0].T
    return np.where(sound[:, None], body.possible_errors(u), otherwise)


def other_bodies(motions: Track, model: Model) -> Track:
    """Return the most probable motion of K with each axis of a body without an inertia the longest, the middle and the shortest.

    A rotation about a principal axis does not change if the moments change a little, so that a fit that begins at a sphere may stay
    there. None if an inertia is known.
    """
    if not (model.body.sphere and len(model.body.errors) and len(motions)):
        return motions.take(slice(0))
    best = motions.take(np.zeros(len(OTHER_BODIES), dtype=int))
    sizes = np.linalg.norm(model.body.errors, axis=(1, 2))
    u = best.u.copy()
    u[:, model.inertia_slice] += OTHER_BODIES @ np.einsum("eii->ie", model.body.errors) / sizes
    return Track(best.attitude, best.omega, u)


def grid_step(suns: int, dt: float, rate_max: float, s: SearchSettings) -> float:
    """Return the step (rad/s) of a grid of rates: a basin as a turn in dt s, or coarser, for `s.most_starts` starts at most.

    `suns`: number of directions to the Sun, each of which has the whole grid.
    """
    return max(s.basin_rad / dt, rate_max * (4 * np.pi / 3 * suns / s.most_starts) ** (1 / 3))


def _rate_grid(size: float, rate_max: float) -> np.ndarray:
    """Return a grid of rates (m, 3) with this step, up to the largest, rest among them."""
    axis = np.arange(-np.floor(rate_max / size), np.floor(rate_max / size) + 1) * size
    grid = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[np.linalg.norm(grid, axis=1) <= rate_max]


def fine_up_to(model: Model, s: SearchSettings) -> float:
    """Return the largest rate (rad/s) for which starts are not too far apart; infinity if that is beyond the model's largest rate.

    Where their number is limited, their distance grows with the rate. A grid of rates (:func:`grid_step`) may be `COARSE_RAD`
    apart, as turns between the two samples. Whole turns (:func:`whole_turns`) may be twice as far apart; they are tried only if the
    Sun may have nearly the same direction at both samples. The two samples are those nearest in time.

    A grid counts as for one direction to the Sun. Where a sample allows several it is coarser, and is not doubted for that: two of
    ten right files of spinning satellites were undecided so, and their true motions were found.
    """
    first = int(np.argmin(np.diff(model.obs.t_s)))
    dt = float(np.diff(model.obs.t_s).min())
    if _constant_rate_holds(model, first):
        searched = model.for_search(model.noise)[0]
        before, after = (allowed_directions(searched, first + k) for k in (0, 1))
        cosine = (before @ after.T).max()
        # MOST_AXES axes at the angle rate dt are (rate dt) / sqrt(MOST_AXES / 4 pi) apart
        farthest = 2 * COARSE_RAD * np.sqrt(MOST_AXES / (4 * np.pi)) / dt
        limit = farthest if cosine > np.cos(ANY_AXIS_RAD) else np.inf
    else:
        # the rate for which the step of the grid, as a turn, is COARSE_RAD
        limit = COARSE_RAD / dt * (s.most_starts / (4 * np.pi / 3)) ** (1 / 3)
    return limit if model.rate_max > limit else np.inf


def _loosen_terms(model: Model, sample: int, apart_rad: float) -> Model:
    """Return the model with the errors of the terms enlarged by what starts at a sample may be off at the others.

    Starts are `apart_rad` apart at the next sample. The farther away a sample is, the more unknown torques and errors of the
    inertia have changed the motion: three percent of it turned a long body with 9 deg/s by 0.2 rad from sample to sample, 37 s
    apart.
    """
    obs, q = model.obs, model.noise.acceleration
    away = np.abs(obs.t_s - obs.t_s[sample])
    off_rad_s = BLUR * apart_rad / (obs.t_s[sample + 1] - obs.t_s[sample])
    off_rad_s = np.hypot(off_rad_s, model.body.wander * model.rate_max)
    # torques of the strength q turn the body by q T^1.5 / sqrt(3) in the time T, and change its rate by q T^0.5
    drift = np.hypot(q * np.sqrt(away**3 / 3), off_rad_s * away)
    drift_rad_s = float(np.hypot(off_rad_s, q * np.sqrt(away.max())))
    terms = tuple(term.loosened(drift, drift_rad_s) for term in obs.terms)
    return replace(model, obs=replace(obs, terms=terms))


def _best_starts(model: Model, sample: int, begin: PairStarts, most: int) -> Track:
    """Return the `most` starts that fit all samples best, propagated to them, the slowest of all among them."""
    loose = _loosen_terms(model, sample, begin.apart_rad)
    tracks, costs_of_parts = [], []
    for part in np.array_split(np.arange(len(begin.omega)), 1 + len(begin.omega) // AT_ONCE):
        rates = begin.omega[part]
        track = propagate(model, sample, facing(begin.sun_B[part]), rates)
        prior = (rates**2).sum(axis=1) / (2 * model.rate_sigma**2)
        cost = costs(loose.obs, track).sum(axis=1) + prior
        keep = np.argsort(cost, kind="stable")[:most]
        tracks.append(track.take(keep))
        costs_of_parts.append(cost[keep])
    track, cost = Track.joined(tracks), np.concatenate(costs_of_parts)
    order = np.argsort(cost, kind="stable")
    speed = np.linalg.norm(track.omega[:, sample], axis=1)
    slowest = order[np.argmin(speed[order])]
    keep = order[:most] if slowest in order[:most] else np.append(order[: most - 1], slowest)
    return track.take(keep)


def _thinned(model: Model, sample: int, begin: PairStarts, s: SearchSettings) -> PairStarts:
    """Return the better ones of a crowd of starts: the best by the pair alone, of these the best after a fit to four samples."""
    apart = begin.apart_rad
    pair = model.seeing(slice(sample, sample + 2))
    motions = _best_starts(pair, 0, begin, s.tried[0])
    window = slice(max(0, sample - 1), min(len(model.obs), sample + 3))
    around, sample = model.seeing(window), sample - window.start
    of_pair = PairStarts(motions.sun_B[:, 0], motions.omega[:, 0], apart)
    motions = _best_starts(around, sample, of_pair, s.tried[1])
    motions = fit_single_shooting(_loosen_terms(around, sample, apart), sample, motions, 3)
    motions = motions.take(distinct(motions, around.obs.t_s, s, s.tried[1], drop=np.inf))
    return PairStarts(motions.sun_B[:, sample], motions.omega[:, sample], apart)
