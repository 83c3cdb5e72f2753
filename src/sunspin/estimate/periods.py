"""A period seen from outside as evidence among the solutions of a pass: radio fading, a light curve, a magnetometer's swing.

Who sees a period does not know what rotated: the body's axis about the momentum (precession), the body about its axis (spin), or
both together (the sum). Each of the three is as likely before; solutions are weighted by the mean of the three densities.

How the periods of a solution are computed: its rate, at the sample nearest to the time at which a period was seen, is a Gaussian.
Rates are drawn from it, and inertias from the errors of the vehicle file. Each draw moves freely over four of the periods seen. Its
rates of precession and spin are those of Euler's angles about the total momentum, wheels included, averaged over that time. Only
probabilities change: the rates of a solution stay those of the samples.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.carry import RATE, step
from sunspin.estimate.model import Body
from sunspin.estimate.solutions import Solutions
from sunspin.estimate.verdict import padded
from sunspin.solve.weights import effective_draws
from sunspin.telemetry.periodicity import FoundPeriod, LikelyPeriod

ROTATIONS = ("precession", "spin", "sum")
"""What a period may be of."""

HALF_SPAN, INSTANTS = 2.0, 9
"""Periods before and after the instant over which rates are averaged, and at how many instants."""

PARALLEL = 1e-6
"""Squared sine between momentum and axis below which precession and spin fit equally well; their sum can."""

FAR_SIGMAS = 4.0
"""A period contradicts all solutions if none has one as near as this."""

LEAST_DRAWS = 200.0
"""Effective draws from which a median is known to a tenth of its sigma."""

INERTIAS, DRAWS = 8, 500
"""Inertias drawn, and rates of each solution with each of them."""

MOST_TRIES = 50
"""Rounds of draws at most until enough inertias are those of bodies; with sigmas as large as the moments about one in 20 is."""

LEAST_SHARE = 0.05
"""Probability of the solutions that have the periods, below which the samples contradict the periods. Without this bound, half of
the true period, as of a light curve that repeats twice in a revolution, decided one of 24 simulated passes wrongly."""


SQRT_2PI = np.sqrt(2 * np.pi)
"""By which the sigma of a normal law is multiplied for one over its height."""


@dataclass(frozen=True)
class Period:
    """A period (s) with one sigma (s), seen at `t_s` (s from the epoch of the telemetry)."""

    t_s: float
    period_s: float
    sigma_s: float

    def __post_init__(self) -> None:
        """Refuse values that are no numbers, and periods and sigmas that are not positive."""
        for name in ("t_s", "period_s", "sigma_s"):
            value = getattr(self, name)
            if not np.isfinite(value) or (name != "t_s" and not value > 0):
                wanted = "a number of seconds" if name == "t_s" else "a positive number of seconds"
                raise InputError(f"{name} of a period must be {wanted}", got=value)


PeriodSeen = Period | FoundPeriod
"""A period that a person states, or one that was found in a column."""


def every_of(seen: PeriodSeen) -> Sequence[LikelyPeriod]:
    """Return the periods that one which was seen may be, with their probabilities: a column may leave several."""
    if isinstance(seen, FoundPeriod):
        return seen.every
    return (LikelyPeriod(seen.period_s, seen.sigma_s, 1.0),)


class Weighed(NamedTuple):
    """What periods say of draws (n).

    `density` (n) of all that was seen; `weight` (n) after it, as before if no draw has the periods. `shares` (seen, 3) by
    :data:`ROTATIONS`; `nearest_sigmas`: how far the nearest draw is off; `effective`: how many draws hold the weight.
    """

    density: np.ndarray
    weight: np.ndarray
    shares: np.ndarray
    nearest_sigmas: float
    effective: float


def weigh_by_periods(
    passes: Sequence[Solutions], body: Body, seen: Sequence[PeriodSeen], pass_ids: Sequence[int]
) -> tuple[list[Solutions], dict[str, str]]:
    """Return the passes with probabilities that count the periods in, and the attribute `periods`: JSON, what each decided.

    If no solution of a pass has its periods, the samples contradict them, or too few draws have them, its probabilities stay. JSON
    has for each period: `pass`, `t_s`, `period_s`, `sigma_s`; `shares` by rotation; `nearest_sigmas`, `effective` draws; `carried`,
    the probability without it of the solutions that have it; a flag whether it counts; and `without`, the probability without it
    of the solution that is the likeliest now, and of the one that was then.
    """
    by_pass: dict[int, list[PeriodSeen]] = {}  # indices of passes
    for period in seen:
        if (k := pass_of_period(passes, period)) is not None:
            by_pass.setdefault(k, []).append(period)
    if not by_pass:
        return list(passes), {}
    weighed = [replace(of_pass, without_periods=of_pass.probability) for of_pass in passes]
    rows: list[dict[str, Any]] = []
    for k in sorted(by_pass):
        weighed[k], decided = _weigh(weighed[k], body, by_pass[k])
        rows += [{"pass": int(pass_ids[k])} | row for row in decided]
    return weighed, {"periods": json.dumps(rows)}


def without_periods(passes: Sequence[Solutions]) -> dict[str, Any]:
    """Return the variable `probability_without_periods (pass_id, solution)`, if periods were counted in."""
    before = [of_pass.without_periods for of_pass in passes]
    if any(part is None for part in before):
        return {}
    about = {"units": "1", "long_name": "probability of each solution without the periods seen"}
    values = padded([part for part in before if part is not None])
    return {"probability_without_periods": (("pass_id", "solution"), values, about)}


def _weigh(
    solved: Solutions, body: Body, seen: Sequence[PeriodSeen]
) -> tuple[Solutions, list[dict[str, Any]]]:
    """Return a pass with the probabilities that its periods give it, and for each period the row that `weigh_by_periods` describes.

    All periods of a pass are weighed together, so that the rows share all but the period itself and its `shares`.
    """
    before, draws_each = solved.probability / solved.probability.sum(), INERTIAS * DRAWS
    periods = [periods_of(solved, body, period) for period in seen]
    weighed = weigh_draws(seen, periods, np.repeat(before / draws_each, draws_each))

    # A solution has the periods if one of its draws is within FAR_SIGMAS of them. `peak`: the density of a draw that has a period
    # exactly, as its precession, spin or sum (one of three ROTATIONS). A period that was found in a column may be one of several:
    # then the one with the lowest peak.
    density = weighed.density.reshape(len(before), draws_each)
    peak = [
        min(
            part.probability / (len(ROTATIONS) * part.sigma_s * SQRT_2PI)
            for part in every_of(period)
        )
        for period in seen
    ]
    has_periods = density.max(axis=1) > np.exp(-0.5 * FAR_SIGMAS**2) * np.prod(peak)
    share_with_periods = float(before[has_periods].sum())
    counts = (
        weighed.effective >= LEAST_DRAWS
        and weighed.nearest_sigmas <= FAR_SIGMAS
        and share_with_periods >= LEAST_SHARE
    )
    after = before
    if counts:
        after = weighed.weight.reshape(len(before), draws_each).sum(axis=1)
    about = {
        "nearest_sigmas": weighed.nearest_sigmas,
        "effective": weighed.effective,
        "carried": share_with_periods,
        "told": counts,
        "without": [float(before[np.argmax(after)]), float(before.max())],
    }
    rows = [
        {
            "t_s": period.t_s,
            "period_s": period.period_s,
            "sigma_s": period.sigma_s,
            "shares": shares,
        }
        | about
        for period, shares in zip(seen, weighed.shares.tolist(), strict=True)
    ]
    return replace(solved, probability=after), rows


def weigh_draws(
    seen: Sequence[PeriodSeen], periods: Sequence[np.ndarray], weight: np.ndarray
) -> Weighed:
    """Return what periods say of draws with weights (n) that add to one; `periods`: those of the draws (n, 3), for each seen.

    The density of a period seen is the mean, over the three rotations of a draw, of normal laws about each period that it may be.
    Bayes' rule gives the weights.
    """
    by_rotation = []  # of each period seen: densities (n, 3)
    relative = []  # and how far below its peak the nearest draw is
    for period, of_draws in zip(seen, periods, strict=True):
        known, likely = np.nan_to_num(of_draws, nan=np.inf), every_of(period)
        # exp(-d^2 / 2) of the distances d, in sigmas, from each period that it may be (k, n, 3)
        law = np.array(
            [np.exp(-0.5 * ((known - part.period_s) / part.sigma_s) ** 2) for part in likely]
        )
        sizes = np.array([part.probability / (part.sigma_s * SQRT_2PI) for part in likely])
        relative.append(float(law.max()))
        by_rotation.append(np.einsum("k,knr->nr", sizes, law))
    density = np.prod([part.mean(axis=1) for part in by_rotation], axis=0)
    nearest = float(np.sqrt(-2 * np.log(np.clip(min(relative), 1e-300, 1.0))))
    total = float(weight @ density)
    if not total > 0:
        return Weighed(density, weight, np.zeros((len(seen), 3)), nearest, 0.0)
    after = weight * density / total
    shares = []
    for part in by_rotation:
        share_of_draw = part / np.maximum(part.sum(axis=1, keepdims=True), 1e-300)
        shares.append((after[:, None] * share_of_draw).sum(axis=0))
    return Weighed(density, after, np.array(shares), nearest, effective_draws(after))


def pass_of_period(passes: Sequence[Solutions], seen: PeriodSeen) -> int | None:
    """Return the index of the pass in which a period was seen. A pass reaches beyond its ends by its widest gap.

    Outside all passes: None for a period that was found in a column, InputError for one that a person states.
    """
    times = [of_pass.obs.t_s for of_pass in passes]
    away = [max(t[0] - seen.t_s, seen.t_s - t[-1], 0.0) for t in times]
    k = int(np.argmin(away))
    if away[k] <= np.diff(times[k]).max():
        return k
    if isinstance(seen, FoundPeriod):
        return None
    spans = ", ".join(f"{t[0]:.0f} to {t[-1]:.0f}" for t in times[:6])
    rest = ", ..." if len(times) > 6 else ""
    raise InputError(
        "a period was seen at a time of no pass",
        got=f"{seen.t_s:g} s",
        do=f"passes are at {spans}{rest} s",
    )


def periods_of(solved: Solutions, body: Body, seen: PeriodSeen) -> np.ndarray:
    """Return periods (K x `INERTIAS` x `DRAWS`, 3) in s by :data:`ROTATIONS` of draws of the K solutions of a pass.

    Without an inertia precession and spin are not known, NaN; the sum is then the period of the angular speed.
    """
    t_s, rng = solved.obs.t_s, np.random.default_rng(0)
    instants = seen.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s
    at = int(np.argmin(np.abs(t_s - seen.t_s)))
    # widened by what the rate wanders between that sample and the time of the period
    wander = solved.noise**2 * abs(seen.t_s - t_s[at])
    covariance = solved.track.covariance[:, at, RATE, RATE] + wander[:, None, None] * np.eye(3)
    variance, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]  # root root^T is the covariance
    momentum = np.stack(
        [np.interp(instants, t_s, solved.obs.momentum[:, i]) for i in range(3)], axis=1
    )
    parts = []
    for inertia in drawn_inertias(body, rng):
        normal = rng.standard_normal((DRAWS, 3))
        omega = solved.track.omega[:, at, None] + np.einsum("kij,nj->kni", root, normal)
        rates = _euler_rates_of(inertia, omega.reshape(-1, 3), instants - t_s[at], momentum, body)
        with np.errstate(divide="ignore"):
            periods = 2 * np.pi / np.abs(rates)
        parts.append(periods.reshape(len(omega), DRAWS, 3))
    return np.stack(parts, axis=1).reshape(-1, 3)


def _euler_rates_of(
    inertia: np.ndarray, omega: np.ndarray, after_s: np.ndarray, momentum: np.ndarray, body: Body
) -> np.ndarray:
    """Return Euler's rates (n, 3) in rad/s, in the mean over times (m) in s, of motions with rates omega (n, 3) at time zero.

    `inertia` (3, 3) in mean moments, that of the draws; `momentum` (m, 3): of the wheels at those times.
    """
    axis, rates = own_axis(body.inertia), []
    last, wheels_last = 0.0, momentum[0]
    # the motions are propagated from each time to the next
    for t, wheels in zip(after_s, momentum, strict=True):
        if t != last:
            ends = wheels_last[None], wheels[None]
            omega = step(inertia, omega[:, None], np.array([t - last]), ends).omega[:, 0]
        if body.sphere:
            speed = np.linalg.norm(omega, axis=1)
            rates.append(np.stack([*np.full((2, len(omega)), np.nan), speed], axis=1))
        else:
            rates.append(euler_rates(omega, omega @ inertia + wheels, axis))
        last, wheels_last = t, wheels
    return np.mean(rates, axis=0)


def own_axis(inertia: np.ndarray) -> np.ndarray:
    """Return the principal axis (3) whose moment of inertia (3, 3) differs most from the other two, about which a body spins."""
    moments, axes = np.linalg.eigh(inertia)
    apart = [np.abs(np.delete(moments, i) - moments[i]).min() for i in range(3)]
    return axes[:, int(np.argmax(apart))]


def euler_rates(omega_B: np.ndarray, momentum_B: np.ndarray, axis_B: np.ndarray) -> np.ndarray:
    """Return precession, spin and their sum (..., 3), rad/s.

    Of rates omega_B (..., 3) with momentum (..., 3), about an axis (3) of the body: omega = precession h + spin e + (nutation
    across both), h along the momentum, e the axis. With c = h . e this gives omega . h = precession + c spin and omega . e = c
    precession + spin, two equations for both. They are NaN if h and e are parallel; the sum is known then too.
    """
    along = momentum_B / np.linalg.norm(momentum_B, axis=-1, keepdims=True)
    c, about_h, about_e = along @ axis_B, np.sum(omega_B * along, axis=-1), omega_B @ axis_B
    determinant = np.where(1 - c**2 > PARALLEL, 1 - c**2, np.nan)
    precession = (about_h - c * about_e) / determinant
    spin = (about_e - c * about_h) / determinant
    # the sum of rotations about opposite directions is their difference
    total = np.where(c < 0, about_h - about_e, about_h + about_e) / (1 + np.abs(c))
    return np.stack([precession, spin, total], axis=-1)


def drawn_inertias(body: Body, rng: np.random.Generator) -> np.ndarray:
    """Return `INERTIAS` tensors (`INERTIAS`, 3, 3), drawn from the errors of the file; only tensors that a body can have.

    A body of unknown inertia stays a sphere.
    """
    possible = np.zeros((0, 3, 3))
    for _ in range(MOST_TRIES):
        u = rng.standard_normal((INERTIAS, len(body.errors))) * (not body.sphere)
        drawn = np.broadcast_to(body.inertia_at(u), (INERTIAS, 3, 3))
        # `Body.possible` returns errors of a possible body unchanged
        is_possible = (body.possible(u) == u).all(axis=1)
        possible = np.concatenate([possible, drawn[is_possible]])
        if len(possible) >= INERTIAS:
            break
    # if there are too few, the nominal inertia stands for the rest
    return np.concatenate([possible, np.tile(body.inertia, (INERTIAS, 1, 1))])[:INERTIAS]
