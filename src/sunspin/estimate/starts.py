"""Where a search starts: rates that take the Sun from one sample to the next.

Two directions of the Sun in the body, a known time apart, leave a family of constant rates: any angle from that between the two up
to its rest to a revolution, two axes for each angle, and whole revolutions more. If unequal moments or wheels change the rate in
the body between the two, a grid of rates takes the place of constant ones. The rate that a gyro reads is a start too.

Starts are coarse. Under Student's law of the readings a start that misses most samples would stay where it is. So starts are
compared and first fitted with errors as large as the distance between two starts.
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

SKY_DIRECTIONS, MOST_SPANNING, ALLOWED_COST = 500, 10, 3.0
"""If powers alone bound the Sun's direction at a sample: directions of the sphere that are tried (9 degrees apart), how many of the
allowed ones are starts, and how much more an allowed one may cost than the best."""

PRECESSION_RAD = 0.5
"""If the vector of the rate turns in the body by more than this between two samples, a constant rate is no start."""

COARSE_RAD = 0.6
"""A grid of rates whose step times the interval between two samples exceeds this may miss a motion."""

GYRO_RAD = 0.5
"""A gyro whose error adds up to less than this between two samples gives the only starts."""

DENSE_RAD = 2.2
"""If the body turns by less than this between samples at the largest rate, whole revolutions more are excluded."""

START_ERROR = 0.6
"""Error of a start, as a share of the distance between neighbouring starts."""

UNSEEN_FACTOR, BOUNDED_FACTOR = 100.0, 2.0
"""In the order of pairs an interval counts so many times longer if a sample does not see the Sun, or only bounds its direction."""

ANY_AXIS_RAD = 0.5
"""Between two directions of the Sun nearer to each other than this the body may make whole revolutions about any axis."""

MOST_AXES = 4000
"""Axes of whole revolutions that are tried, at most: enough for two revolutions. For more of them the axes are too few."""

STARTS_AT_ONCE = 4000
"""Starts that are propagated together, to limit the memory."""

OTHER_BODIES = np.array(list(permutations((1.0, 0.0, -1.0))))
"""(6, 3) Sigmas by which the three moments differ from those of a sphere: each order of long, middle and short axis."""

FAMILY_ANGLES = 200
"""Angles for which the family of rates between two directions is computed, before points at even distances are taken of it."""


class PairStarts(NamedTuple):
    """Starts at the first of two neighbouring samples: directions to the Sun `sun_B` (K, 3) and rates `omega` (K, 3), rad/s.

    `apart_rad`: distance of neighbouring starts, as rotation vectors between the two samples. Whole revolutions about any axis are
    twice as far apart.
    """

    sun_B: np.ndarray
    omega: np.ndarray
    apart_rad: float


def pair_starts(
    model: Model, s: SearchSettings, slowest: float = 0.0
) -> Iterator[tuple[slice, Track]]:
    """Yield windows of samples, each with the motions from which a search may begin there; that of the best pair of samples first.

    A window is a pair of neighbouring samples and `s.around` on either side. Starts are rates that take the Sun from the first
    sample of the pair to the second. They are compared with all samples of the window, and the best are fitted to them. `model`:
    that of the search, without unknowns. `slowest` (rad/s): slower rates are left out.
    """
    pairs = _ordered_pairs(model)
    gyro_suffices = gyro_decides(model, pairs[0])
    for number, first in enumerate(pairs):
        window = slice(max(0, first - s.around), min(len(model.obs), first + 2 + s.around))
        around, sample = model.seeing(window), first - window.start
        # a gyro is trusted at the first pair alone: further pairs are tried if nothing fits, and then it may be what is wrong
        pair = _starts_of_pair(around, sample, s, trust_gyro=gyro_suffices and number == 0)
        if slowest:
            fast = np.linalg.norm(pair.omega, axis=1) > slowest
            pair = pair._replace(sun_B=pair.sun_B[fast], omega=pair.omega[fast])
        if len(pair.omega) > s.crowd:
            pair = _best_of_crowd(around, sample, pair, s)
        if not len(pair.omega):
            continue
        motions = _best_starts(around, sample, pair, s.tried[2])
        # three fits, each with smaller errors of the readings: they allow for starts that are off by this share of their spacing
        for share in (1.0, 0.3, 0.0):
            loose = _loosen_terms(around, sample, share * pair.apart_rad)
            motions = fit_single_shooting(loose, sample, motions, 4)
            motions = motions.take(distinct(motions, around.obs.t_s, s, s.tried[2]))
        yield window, motions


def pairs_to_try(model: Model, s: SearchSettings) -> int:
    """Return from how many pairs of samples a search starts: one if a gyro, dense samples or a grid of rates leave no rate out.

    A grid has a start near every rate. But an error of the inertia may lead all of them away from the truth within the first
    window: of a long body at 15 deg/s, its products two sigmas off, every start near the truth was dropped there, and an alias that
    fits was decided. Then several pairs are tried if only the Sun is measured. With another sensor each pair determines the whole
    rotation between its samples: two spinners with a magnetometer were found from one, and three took all the computing budget.
    """
    if len(images_of(model)) > 1:
        # panels bound the Sun so little that no start of a pair may be near the truth
        return s.places_if_flat
    first = _ordered_pairs(model)[0]
    # of the first intervals, which mostly are the closest of the samples that the search keeps
    dense = np.diff(model.obs.t_s)[:3].max() * model.rate_max < DENSE_RAD
    led_away = model.obs.only_sun and inertia_leads_away(model, s)
    grid_suffices = not _constant_rate_holds(model, first) and not led_away
    return 1 if dense or gyro_decides(model, first) or grid_suffices else s.places


def inertia_leads_away(model: Model, s: SearchSettings) -> bool:
    """Return whether errors of a fixed inertia may turn the fastest body out of its basin between the first pair of samples."""
    first = _ordered_pairs(model)[0]
    interval_s = float(model.obs.t_s[first + 1] - model.obs.t_s[first])
    return model.body.angle_error * model.rate_max * interval_s > s.basin_rad / 2


def _ordered_pairs(model: Model) -> np.ndarray:
    """Return the first sample of each pair of neighbours (n - 1), first those close in time that determine the Sun's direction."""
    obs = model.obs
    sharp = [any(len(term.starts(i).directions) for term in obs.terms) for i in range(len(obs))]
    # if no sample sees the Sun, as with a magnetometer alone, that distinguishes none
    sees_sun = obs.sees_sun | (not obs.sees_sun.any())
    # the worse the directions at both ends are, the longer the interval counts
    penalty = np.where(sharp, 1.0, BOUNDED_FACTOR) * np.where(sees_sun, 1.0, UNSEEN_FACTOR)
    return np.argsort(np.diff(obs.t_s) * (penalty[1:] + penalty[:-1]), kind="stable")


def gyro_decides(model: Model, first: int) -> bool:
    """Return whether a gyro determines the rotation from sample `first` to the next, so that no other rate need be tried."""
    sigma = min((term.starts(first).rate_sigma for term in model.obs.terms), default=np.inf)
    return bool(sigma * (model.obs.t_s[first + 1] - model.obs.t_s[first]) < GYRO_RAD)


def _constant_rate_holds(model: Model, first: int) -> bool:
    """Return whether a rate is nearly constant in the body from sample `first` to the next, for unequal moments and wheels."""
    low, middle, high = np.linalg.eigvalsh(model.body.inertia)
    # Both turn the vector of the rate in the body, at so many rad/s: unequal moments, by Euler's equations, at about the rate times
    # their relative difference.
    by_wheels = nutation(model.body.inertia, model.obs.momentum[first : first + 2]).max()
    by_moments = model.rate_max * (high - low) / middle
    interval_s = model.obs.t_s[first + 1] - model.obs.t_s[first]
    return bool((by_wheels + by_moments) * interval_s < PRECESSION_RAD)


def _starts_of_pair(model: Model, first: int, s: SearchSettings, *, trust_gyro: bool) -> PairStarts:
    """Return the starts of the samples `first` and `first` + 1; the body at rest is one of them unless a gyro is trusted.

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
    # `rates_of_suns`: rates (m, 3) for each direction to the Sun; `apart`: as `PairStarts.apart_rad`
    if trust_gyro and len(gyro_rates) and gyro_decides(model, first):
        sigma = min(sensor.rate_sigma for sensor in by_sensor)
        rates_of_suns, apart = [gyro_rates] * len(suns), max(s.step_rad, 2 * sigma * dt)
    elif not _constant_rate_holds(model, first):
        # wheels or moments turn the rate in the body, so that the rates that end at a direction have no closed form
        step = grid_step(len(suns), dt, rate_max, s)
        axis = np.arange(-np.floor(rate_max / step), np.floor(rate_max / step) + 1) * step
        cube = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), axis=-1).reshape(-1, 3)
        ball = cube[np.linalg.norm(cube, axis=1) <= rate_max]
        rates_of_suns, apart = [np.concatenate([ball, gyro_rates])] * len(suns), step * dt
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
    """Return directions to the Sun (c, 3) in body axes that a sample allows, the best first.

    They are those that a sensor measures. Powers of panels may only bound the Sun to a region of the sky: then they are a few that
    span the region. If no sensor of the model shows the Sun, any attitude will do, and the direction is z.
    """
    if not any(term.of_sun for term in model.obs.terms):
        return SUN_N[None]
    for term in model.obs.terms:
        if len(measured := term.starts(sample).directions):
            return measured
    grid = sphere(SKY_DIRECTIONS)
    still = Track.unfitted(facing(grid)[:, None], np.zeros((SKY_DIRECTIONS, 1, 3)))
    cost = costs(model.obs.take(slice(sample, sample + 1)), still)[:, 0]
    allowed = grid[cost < cost.min() + ALLOWED_COST]
    spanning = grid[[np.argmin(cost)]]
    while len(spanning) < min(MOST_SPANNING, len(allowed)):
        # add the direction that is farthest from all that are taken already
        farthest = np.argmin((allowed @ spanning.T).max(axis=1))
        spanning = np.concatenate([spanning, allowed[[farthest]]])
    return spanning


def constant_rates(
    first: np.ndarray, second: np.ndarray, dt: float, rate_max: float, step_rad: float
) -> np.ndarray:
    """Return constant rates (m, 3), up to `rate_max`, that move the Sun in the body from `first` (3) to `second` (3) in `dt` s.

    The axes of such rotations lie on the great circle that halves the angle between the two, through their middle m and their unit
    normal n. A rotation by the angle a, about an axis at the angle b from both directions, takes one to the other if sin b =
    sin(apart / 2) / sin(a / 2). The axis is then cos(b) / cos(apart / 2) m plus the rest along n. `step_rad`: spacing of rotations.
    """
    apart = float(np.arccos(np.clip(first @ second, -1, 1)))
    middle, normal = first + second, np.cross(first, second)
    # the same direction, or the opposite one: any axis normal to it
    if np.linalg.norm(normal) < 1e-6:
        normal = np.cross(first, np.eye(3)[np.argmin(np.abs(first))])
    if np.linalg.norm(middle) < 1e-6:
        middle = np.cross(normal, first)
    middle, normal = middle / np.linalg.norm(middle), normal / np.linalg.norm(normal)
    # From the smallest angle, near which most are taken as the axis changes fastest there, to pi. A rotation by more than pi is one
    # by its rest to a revolution about the opposite axis, and is added in the loop.
    angle = apart + (np.pi - apart) * np.linspace(0.0, 1.0, FAMILY_ANGLES) ** 2
    sin_b = np.clip(np.sin(apart / 2) / np.maximum(np.sin(angle / 2), 1e-9), 0, 1)
    # component of the axis along the middle
    along = np.sqrt(1 - sin_b**2) / max(np.cos(apart / 2), 1e-9)
    families = []  # curves of rotation vectors (FAMILY_ANGLES, 3) of the body
    for sign in (1.0, -1.0):  # two axes for each angle, on either side of the normal
        cosine = np.clip(sign * along, -1, 1)[:, None]
        axis = cosine * middle + np.sqrt(1 - cosine**2) * normal
        for whole in range(int(rate_max * dt / (2 * np.pi)) + 1):
            # the body rotates opposite to the Sun's motion in it, or by the rest to a revolution the other way
            families.append(-axis * (angle + 2 * np.pi * whole)[:, None])
            families.append(axis * (2 * np.pi * (whole + 1) - angle)[:, None])
    rates = np.concatenate([_spaced(family, step_rad) for family in families]) / dt
    return rates[np.linalg.norm(rates, axis=1) <= rate_max]


def whole_turns(dt: float, rate_max: float, spacing_rad: float) -> np.ndarray:
    """Return rates (m, 3), rad/s, of whole revolutions in `dt` s about axes all over the sphere, up to `rate_max`.

    Rotation vectors of the same number of revolutions are `spacing_rad` apart, or farther if that takes more than `MOST_AXES` axes.
    """
    rates = [np.zeros((0, 3))]
    for whole in range(1, int(rate_max * dt / (2 * np.pi)) + 1):
        angle = 2 * np.pi * whole
        axes = min(int(4 * np.pi * (angle / spacing_rad) ** 2), MOST_AXES)
        rates.append(sphere(axes) * angle / dt)
    return np.concatenate(rates)


def _spaced(path: np.ndarray, step: float) -> np.ndarray:
    """Return some of the points of a path (n, 3), with both ends, that are about `step` or less apart along it."""
    length = np.linalg.norm(np.diff(path, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(length)])
    marks = np.linspace(0.0, along[-1], int(np.ceil(along[-1] / step)) + 1)
    return path[np.unique(np.minimum(np.searchsorted(along, marks - 1e-12), len(path) - 1))]


def aliases(motions: Track, model: Model, s: AlternativeSettings) -> Track:
    """Return motions (K) with whole revolutions more and fewer about their angular momentum L between the samples.

    None exceeds the largest rate in the mean. The result is empty if the samples are uneven or a gyro excludes aliases.

    L is fixed in space for a free body: whole revolutions more about it between even samples show the same attitudes, and change
    the rate by a vector along L. How L moves in the body follows from the part of |L| I^-1 that differs between the axes. If the
    inertia I is known the faster body nutates faster, and hardly any alias fits. If it is not, an alias has the inertia for which
    that part is the same; without wheels it fits exactly.
    """
    step, rate_max = _alias_step(model, s), model.rate_max
    if step is None:
        return motions.take(slice(0))
    most = int(2 * rate_max / step)
    changes = step * np.array([k for k in range(-most, most + 1) if k])  # rad/s
    inertia, size, along = _momenta(model, motions.u, motions.omega)
    changed = motions.omega + changes[:, None, None, None] * along  # (changes, K, n, 3)
    of_change, of_motion = np.nonzero(np.linalg.norm(changed, axis=3).mean(axis=2) < rate_max)
    u = motions.u[of_motion]
    if model.body.sphere and len(model.body.errors):
        # |L| I^-1, the rates about the axes of the body if all of L were along each, and as much more for all of them
        rates = size.mean(axis=1)[of_motion, :, None] * np.linalg.inv(inertia[of_motion])
        rates += changes[of_change, None, None] * np.eye(3)
        u[:, model.inertia_slice] = _errors_of_body(model.body, rates, u[:, model.inertia_slice])
    return Track(motions.attitude[of_motion], changed[of_change, of_motion], u)


def aliases_about_two_axes(motions: Track, model: Model, s: AlternativeSettings) -> Track:
    """Return the most probable of K motions, the first, with whole revolutions more and fewer about L and about a body axis.

    A body with two like moments of inertia precesses about its angular momentum L and spins about its third axis, both at constant
    rates. If samples are evenly spaced, whole revolutions more of each between two samples show the same attitudes. The new motion
    obeys the equations of motion only if its own L stays fixed in space. That hardly ever holds for a known inertia. If the inertia
    is unknown, each new motion gets another one, with which it may hold. At most eight motions are returned; revolutions about L
    alone are left to :func:`aliases`. The result is empty if samples are uneven, a gyro excludes aliases, or a sensor other than
    those of the Sun is read.
    """
    step = _alias_step(model, s)
    if step is None or not len(motions) or not model.obs.only_sun:
        return motions.take(slice(0))
    best = motions.take(slice(1))
    inertia, size, along = (part[0] for part in _momenta(model, best.u, best.omega))
    # the principal axis whose angle to L varies least: the spin axis keeps that angle
    principal = np.linalg.eigh(inertia)[1]
    spin_axis = principal[:, np.argmin((along @ principal).std(axis=0))]
    cosine = float((along @ spin_axis).mean())  # of the angle between L and the spin axis

    # every pair of numbers of revolutions, up to six either way about each axis
    most = min(int(2 * model.rate_max / step), 6)
    whole = np.arange(-most, most + 1)
    about_L, about_axis = (grid.ravel() * step for grid in np.meshgrid(whole, whole))  # rad/s
    changed = best.omega[0] + about_L[:, None, None] * along + about_axis[:, None, None] * spin_axis
    slow = np.linalg.norm(changed, axis=2).mean(axis=1) < model.rate_max
    u = np.repeat(best.u, len(changed), axis=0)
    if model.body.sphere and len(model.body.errors):
        # The rate is A l, with l the direction of L and A = |L| I^-1. Revolutions about L and the spin axis e add a l + b e. So
        # A grows by a 1 + (b / cosine) e e^T, as e e^T l = cosine e. The new inertia is proportional to the inverse of A.
        rates = size.mean() * np.linalg.inv(inertia) + about_L[:, None, None] * np.eye(3)
        # if L is nearly normal to the spin axis, b does not determine the moment about it
        if abs(cosine) > 0.2:
            spin = np.outer(spin_axis, spin_axis)
            rates = rates + (about_axis / cosine)[:, None, None] * spin
        u[:, model.inertia_slice] = _errors_of_body(model.body, rates, u[:, model.inertia_slice])
    # Mean angle between the L of each new motion, under its inertia, and that of the old one, both in body axes in the same
    # attitudes. An L of the opposite sign is fixed in space too.
    cosine_of_L = (_momenta(model, u, changed)[2] * along).sum(axis=2)
    off = np.arccos(np.clip(np.abs(cosine_of_L), 0.0, 1.0)).mean(axis=1)
    tried = np.flatnonzero(slow & (about_axis != 0) & (off < s.momentum_off_rad))
    # first those whose inertia is nearest to the prior's, in tenths of a sigma, then those with the smallest angle
    sigmas = np.linalg.norm(u[tried][:, model.inertia_slice], axis=1).round(1)
    which = tried[np.lexsort((off[tried], sigmas))[:8]]
    return Track(np.repeat(best.attitude, len(which), axis=0), changed[which], u[which])


def _momenta(
    model: Model, u: np.ndarray, omega: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return inertia (K, 3, 3), and size (K, n, 1) and direction (K, n, 3) of the angular momentum L = I w + h of K motions.

    They have the unknowns u (K, m) and the rates `omega` (K, n, 3). L is in mean moments times rad/s, in body axes.
    """
    inertia = np.broadcast_to(model.body.inertia_at(u[:, model.inertia_slice]), (len(u), 3, 3))
    momentum = np.einsum("kij,knj->kni", inertia, omega) + model.obs.momentum
    size = np.linalg.norm(momentum, axis=2, keepdims=True)
    return inertia, size, momentum / np.maximum(size, 1e-12)


def _alias_step(model: Model, s: AlternativeSettings) -> float | None:
    """Return the change of the rate (rad/s) that makes one revolution more between the two samples that are closest in time.

    None if it does not make about whole revolutions between all other samples, or if a gyro determines the rate.
    """
    dt = np.diff(model.obs.t_s)
    first = int(np.argmin(dt))
    revolutions = dt / dt[first]  # that the change adds in each interval
    uneven_rad = 2 * np.pi * np.abs(revolutions - np.round(revolutions)).max()
    if uneven_rad >= s.even_rad or gyro_decides(model, first):
        return None
    return float(2 * np.pi / dt[first])


def _errors_of_body(body: Body, rates: np.ndarray, otherwise: np.ndarray) -> np.ndarray:
    """Return the errors (K, e), in sigmas, of the inertias whose inverse is proportional to `rates` (K, 3, 3).

    Motions whose `rates` are not proportional to the inverse of an inertia keep the errors `otherwise` (K, e).
    """
    lowest, _, highest = np.linalg.eigvalsh(rates).T
    # the eigenvalues of an inverse inertia have one sign; here that is negative if the body turns the other way about L
    is_inertia = (lowest > 0) | (highest < 0)
    inertia = np.linalg.inv(np.where(is_inertia[:, None, None], rates, np.eye(3)))
    inertia *= 3 / np.trace(inertia, axis1=1, axis2=2)[:, None, None]  # in mean moments
    # least squares: u with inertia = body.inertia + sum of u errors
    off = (inertia - body.inertia).reshape(-1, 9)
    u = np.linalg.lstsq(body.errors.reshape(-1, 9).T, off.T, rcond=None)[0].T
    return np.where(is_inertia[:, None], body.possible_errors(u), otherwise)


def other_bodies(motions: Track, model: Model) -> Track:
    """Return the most probable of K motions, the first, once for each of the six orders of the three moments of inertia.

    This is for a body without a stated inertia, which the search took for a sphere; for any other body the result is empty. The
    moments change by +1, 0 and -1 sigma; attitudes and rates stay the same. A fit that begins at the sphere may never leave it,
    since a rotation about a principal axis is the same for a body with slightly other moments.
    """
    if not (model.body.sphere and len(model.body.errors) and len(motions)):
        return motions.take(slice(0))
    best = motions.take(np.zeros(len(OTHER_BODIES), dtype=int))
    # (3, e) 1 where an unknown of the inertia is the error of that moment; 0 for the other moments and the products of inertia
    sizes = np.linalg.norm(model.body.errors, axis=(1, 2))
    is_error_of_moment = np.einsum("eii->ie", model.body.errors) / sizes
    u = best.u.copy()
    u[:, model.inertia_slice] += OTHER_BODIES @ is_error_of_moment
    return Track(best.attitude, best.omega, u)


def grid_step(directions: int, dt: float, rate_max: float, s: SearchSettings) -> float:
    """Return the step (rad/s) of a grid of rates up to `rate_max`: points are `s.basin_rad` apart, as rotations in `dt` s.

    So every rate has a point of the grid within its basin. The step is wider if the grids of all `directions` to the Sun would have
    more than `s.most_starts` points together.
    """
    # a ball of the radius r has 4 pi / 3 (r / step)^3 points
    widest = rate_max * (4 * np.pi / 3 * directions / s.most_starts) ** (1 / 3)
    return max(s.basin_rad / dt, widest)


def fine_up_to(model: Model, s: SearchSettings) -> float:
    """Return the rate (rad/s) up to which the starts of a search are dense enough; infinity if that covers all rates of the model.

    As the number of starts is limited, they are farther apart if rates may be larger. Their distance is measured as a rotation in
    the shortest interval between two samples. Points of a grid of rates (:func:`grid_step`) may be `COARSE_RAD` apart. Whole
    revolutions (:func:`whole_turns`) may be twice as far apart. They are tried only if the Sun may have nearly the same direction
    at both samples; without them no rate is too large.

    The limit of a grid is that for one direction to the Sun at the first of the two samples. Several share the points, so that the
    grid is coarser. This is ignored: if it counted, two of ten correct files of spinning satellites were undecided, although the
    search had found their true motions.
    """
    intervals_s = np.diff(model.obs.t_s)
    first = int(np.argmin(intervals_s))
    dt = float(intervals_s[first])
    if _constant_rate_holds(model, first):
        searched = model.for_search(model.noise)[0]
        before, after = (allowed_directions(searched, first + k) for k in (0, 1))
        may_be_alike = (before @ after.T).max() > np.cos(ANY_AXIS_RAD)
        # MOST_AXES axes over the sphere are sqrt(4 pi / MOST_AXES) rad apart: rotations by rate dt about them, rate dt times that
        farthest = 2 * COARSE_RAD * np.sqrt(MOST_AXES / (4 * np.pi)) / dt
        limit = farthest if may_be_alike else np.inf
    else:
        # the rate for which the step of the grid times dt is COARSE_RAD
        limit = COARSE_RAD / dt * (s.most_starts / (4 * np.pi / 3)) ** (1 / 3)
    return limit if model.rate_max > limit else np.inf


def _loosen_terms(model: Model, sample: int, apart_rad: float) -> Model:
    """Return the model with larger errors of its readings: by how much a motion that starts at `sample` may be off at each sample.

    Starts are `apart_rad` apart, as rotations from `sample` to the next one. Unknown torques and errors of the inertia also change
    a motion, the more the farther a sample is away: three percent of the inertia turned a long body at 9 deg/s by 0.2 rad in 37 s.
    """
    obs, q = model.obs, model.noise.acceleration
    away = np.abs(obs.t_s - obs.t_s[sample])  # s
    off_rad_s = START_ERROR * apart_rad / (obs.t_s[sample + 1] - obs.t_s[sample])
    off_rad_s = np.hypot(off_rad_s, model.body.angle_error * model.rate_max)
    # torques of the strength q turn the body by q sqrt(T^3 / 3) in the time T, and change its rate by q sqrt(T)
    drift = np.hypot(q * np.sqrt(away**3 / 3), off_rad_s * away)
    drift_rad_s = float(np.hypot(off_rad_s, q * np.sqrt(away.max())))
    terms = tuple(term.loosened(drift, drift_rad_s) for term in obs.terms)
    return replace(model, obs=replace(obs, terms=terms))


def _best_starts(model: Model, sample: int, pair: PairStarts, most: int) -> Track:
    """Return the `most` starts at `sample` that fit all samples of the model best, as motions at all these samples.

    Readings are given errors as large as the starts are apart. The slowest start is always kept, as a slow body is lost without it.
    """
    loose = _loosen_terms(model, sample, pair.apart_rad)
    tracks, costs_of_parts = [], []
    # in parts, to limit the memory: the best of each part, and below the best of these
    for part in np.array_split(np.arange(len(pair.omega)), 1 + len(pair.omega) // STARTS_AT_ONCE):
        rates = pair.omega[part]
        track = propagate(model, sample, facing(pair.sun_B[part]), rates)
        prior = (rates**2).sum(axis=1) / (2 * model.rate_sigma**2)
        cost = costs(loose.obs, track).sum(axis=1) + prior
        best = _best_with_slowest(cost, np.linalg.norm(rates, axis=1), most)
        tracks.append(track.take(best))
        costs_of_parts.append(cost[best])
    track = Track.joined(tracks)
    speed = np.linalg.norm(track.omega[:, sample], axis=1)
    return track.take(_best_with_slowest(np.concatenate(costs_of_parts), speed, most))


def _best_with_slowest(cost: np.ndarray, speed: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of the `most` smallest of the costs (K), the last of which gives way to the slowest if that is not one."""
    order = np.argsort(cost, kind="stable")
    slowest = order[np.argmin(speed[order])]
    return order[:most] if slowest in order[:most] else np.append(order[: most - 1], slowest)


def _best_of_crowd(model: Model, sample: int, pair: PairStarts, s: SearchSettings) -> PairStarts:
    """Return the better ones of many starts at `sample`: the best by the pair alone, of these the best fits to four samples."""
    alone = model.seeing(slice(sample, sample + 2))
    motions = _best_starts(alone, 0, pair, s.tried[0])
    four = slice(max(0, sample - 1), min(len(model.obs), sample + 3))
    around, sample = model.seeing(four), sample - four.start
    best = PairStarts(motions.sun_B[:, 0], motions.omega[:, 0], pair.apart_rad)
    motions = _best_starts(around, sample, best, s.tried[1])
    loose = _loosen_terms(around, sample, pair.apart_rad)
    motions = fit_single_shooting(loose, sample, motions, 3)
    motions = motions.take(distinct(motions, around.obs.t_s, s, s.tried[1], drop=np.inf))
    return PairStarts(motions.sun_B[:, sample], motions.omega[:, sample], pair.apart_rad)
