"""An observed rotation period as evidence among the solutions of a pass: of radio fading, a light curve, a magnetometer's signal.

An observer of a period does not know which rotation it is of: of the body's axis about the momentum (precession), of the body about
its axis (spin), or of both together (their sum). The three are equally likely before; solutions are weighted by the mean of the
three densities.

The periods of a solution are computed so: its rate, at the sample nearest to the time of the observed period, has a normal
distribution. Rates are drawn from it, and inertias from the errors of the vehicle file. Each draw moves freely over four of the
observed periods. Its rates of precession and spin are those of Euler's angles about the total momentum, wheels included, averaged
over that time. Only probabilities change: the rates of a solution stay as they are.
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
"""Rotations of which an observed period may be that of one."""

HALF_SPAN, INSTANTS = 2.0, 9
"""Number of observed periods before and after the instant over which rates are averaged, and number of instants of that mean."""

PARALLEL = 1e-6
"""Squared sine of the angle between momentum and axis below which precession and spin cannot be separated; their sum can."""

FAR_SIGMAS = 4.0
"""A draw has an observed period if one of its own is within this many sigmas of it."""

LEAST_DRAWS = 200.0
"""Effective draws with which a median is known to a tenth of its sigma."""

INERTIAS, DRAWS = 8, 500
"""Number of inertias that are drawn, and of rates of each solution with each inertia."""

MOST_TRIES = 50
"""Most rounds of draws until enough inertias are possible for a body; with sigmas as large as the moments about one in 20 is."""

LEAST_SHARE = 0.05
"""The samples contradict the periods if the solutions that have them are less probable than this. Without this bound, half of the
true period, as of a light curve that repeats twice in a revolution, decided one of 24 simulated passes wrongly."""


SQRT_2PI = np.sqrt(2 * np.pi)
"""The peak of a normal density with the sigma s is 1 / (s SQRT_2PI)."""


@dataclass(frozen=True)
class Period:
    """A period (s) with one sigma (s), observed at `t_s` (s from the epoch of the telemetry)."""

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
"""An observed period: stated by the user, or found in a column of the telemetry."""


def possible_periods(seen: PeriodSeen) -> Sequence[LikelyPeriod]:
    """Return the values that an observed period may have, with their probabilities: a column may leave several aliases."""
    if isinstance(seen, FoundPeriod):
        return seen.every
    return (LikelyPeriod(seen.period_s, seen.sigma_s, 1.0),)


class WeightedDraws(NamedTuple):
    """Draws (n) of motions, weighted by observed periods.

    `density` (n): product over the periods of the probability density of each observation; `weight` (n): posterior weights, or the
    prior ones if no draw has the periods. `shares` (seen, 3): probability that each period is of each of the :data:`ROTATIONS`;
    `nearest_sigmas`: distance of the nearest draw from the period that fits worst; `effective`: number of effective draws.
    """

    density: np.ndarray
    weight: np.ndarray
    shares: np.ndarray
    nearest_sigmas: float
    effective: float


def weigh_by_periods(
    passes: Sequence[Solutions], body: Body, seen: Sequence[PeriodSeen], pass_ids: Sequence[int]
) -> tuple[list[Solutions], dict[str, str]]:
    """Return the passes with probabilities weighted by the observed periods, and the attribute `periods` on what each period did.

    `pass_ids`: numbers of the passes in the file. The probabilities of a pass stay if none of its solutions has its periods, if the
    samples contradict them, or if too few draws have them. The attribute is JSON, with for each period: `pass`, `t_s`, `period_s`,
    `sigma_s`; `shares` by rotation; `nearest_sigmas`, `effective` draws; `carried`, the prior probability of the solutions that
    have the periods; `told`, whether they changed the probabilities; and `without`, the prior probability of the solution that is
    the likeliest after them, and of the one that was before.
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
        weighed[k], rows_of_pass = _weigh_pass(weighed[k], body, by_pass[k])
        rows += [{"pass": int(pass_ids[k])} | row for row in rows_of_pass]
    return weighed, {"periods": json.dumps(rows)}


def without_periods(passes: Sequence[Solutions]) -> dict[str, Any]:
    """Return the variable `probability_without_periods (pass_id, solution)`; nothing if no periods were observed."""
    before = [of_pass.without_periods for of_pass in passes]
    if any(part is None for part in before):
        return {}
    about = {"units": "1", "long_name": "probability of each solution without the periods seen"}
    values = padded([part for part in before if part is not None])
    return {"probability_without_periods": (("pass_id", "solution"), values, about)}


def _weigh_pass(
    solved: Solutions, body: Body, seen: Sequence[PeriodSeen]
) -> tuple[Solutions, list[dict[str, Any]]]:
    """Return a pass with probabilities weighted by its periods, and for each period the row that `weigh_by_periods` describes.

    All periods of a pass are counted together, so that the rows share all but the period itself and its `shares`.
    """
    before, draws_each = solved.probability / solved.probability.sum(), INERTIAS * DRAWS
    periods = [periods_of(solved, body, period) for period in seen]
    weighed = weigh_draws(seen, periods, np.repeat(before / draws_each, draws_each))

    # A solution has the periods if one of its draws is within FAR_SIGMAS of them. `peaks`: the density, for each period, of a draw
    # that has it exactly as one of three rotations; of several possible periods the one with the lowest peak counts.
    density = weighed.density.reshape(len(before), draws_each)
    peaks = [
        min(
            part.probability / (len(ROTATIONS) * part.sigma_s * SQRT_2PI)
            for part in possible_periods(period)
        )
        for period in seen
    ]
    has_periods = density.max(axis=1) > np.exp(-0.5 * FAR_SIGMAS**2) * np.prod(peaks)
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
        {name: getattr(period, name) for name in ("t_s", "period_s", "sigma_s")}
        | {"shares": shares}
        | about
        for period, shares in zip(seen, weighed.shares.tolist(), strict=True)
    ]
    return replace(solved, probability=after), rows


def weigh_draws(
    seen: Sequence[PeriodSeen], periods: Sequence[np.ndarray], weight: np.ndarray
) -> WeightedDraws:
    """Return draws weighted by observed periods, from prior weights (n) that add to one.

    `periods`: for each observed period those of the draws (n, 3), s, by :data:`ROTATIONS`. The density of an observed period is the
    mean over the three rotations of a draw, of normal densities about each value that the period may have. Bayes' rule gives the
    weights.
    """
    densities = []  # (n, 3) of each observed period
    nearest_relative = []  # density of the draw nearest to it, over the peak
    for period, of_draws in zip(seen, periods, strict=True):
        known, possible = np.nan_to_num(of_draws, nan=np.inf), possible_periods(period)
        # exp(-d^2 / 2) with the distance d in sigmas from each possible value (k, n, 3)
        relative = np.array(
            [np.exp(-0.5 * ((known - part.period_s) / part.sigma_s) ** 2) for part in possible]
        )
        peaks = np.array([part.probability / (part.sigma_s * SQRT_2PI) for part in possible])
        nearest_relative.append(float(relative.max()))
        densities.append(np.einsum("k,knr->nr", peaks, relative))
    density = np.prod([part.mean(axis=1) for part in densities], axis=0)
    nearest = float(np.sqrt(-2 * np.log(np.clip(min(nearest_relative), 1e-300, 1.0))))
    total = float(weight @ density)
    if not total > 0:
        return WeightedDraws(density, weight, np.zeros((len(seen), 3)), nearest, 0.0)
    after = weight * density / total
    shares = []
    for part in densities:
        share_of_draw = part / np.maximum(part.sum(axis=1, keepdims=True), 1e-300)
        shares.append((after[:, None] * share_of_draw).sum(axis=0))
    return WeightedDraws(density, after, np.array(shares), nearest, effective_draws(after))


def pass_of_period(passes: Sequence[Solutions], seen: PeriodSeen) -> int | None:
    """Return the index of the pass in which a period was observed; a pass extends beyond its ends by its widest gap.

    Outside all passes return None for a period that was found in a column, and raise InputError for one that the user states.
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
    """Return the periods (K x `INERTIAS` x `DRAWS`, 3), s, by :data:`ROTATIONS`, of draws of the K solutions of a pass.

    Without an inertia precession and spin are not known, NaN; the sum is then the period of the angular speed.
    """
    t_s, rng = solved.obs.t_s, np.random.default_rng(0)
    instants = seen.t_s + np.linspace(-HALF_SPAN, HALF_SPAN, INSTANTS) * seen.period_s
    nearest = int(np.argmin(np.abs(t_s - seen.t_s)))
    # variance that unknown torques add between that sample and the time of the period
    added = solved.noise**2 * abs(seen.t_s - t_s[nearest])
    covariance = solved.track.covariance[:, nearest, RATE, RATE] + added[:, None, None] * np.eye(3)
    variance, axes = np.linalg.eigh(covariance)
    root = axes * np.sqrt(np.maximum(variance, 0.0))[:, None, :]  # root root^T is the covariance
    momentum = np.stack(
        [np.interp(instants, t_s, solved.obs.momentum[:, i]) for i in range(3)], axis=1
    )
    by_inertia = []  # (K, DRAWS, 3) each
    for inertia in draw_inertias(body, rng):
        normal = rng.standard_normal((DRAWS, 3))
        omega = solved.track.omega[:, nearest, None] + np.einsum("kij,nj->kni", root, normal)
        after_s = instants - t_s[nearest]
        rates = _mean_euler_rates(inertia, omega.reshape(-1, 3), after_s, momentum, body)
        with np.errstate(divide="ignore"):
            periods = 2 * np.pi / np.abs(rates)
        by_inertia.append(periods.reshape(len(omega), DRAWS, 3))
    return np.stack(by_inertia, axis=1).reshape(-1, 3)


def _mean_euler_rates(
    inertia: np.ndarray, omega: np.ndarray, after_s: np.ndarray, momentum: np.ndarray, body: Body
) -> np.ndarray:
    """Return the mean rates (n, 3) of n motions over the times `after_s` (m), in rad/s, for each of :data:`ROTATIONS`.

    `inertia` (3, 3): the drawn one, in mean moments; `omega` (n, 3): rates of the motions at time zero; `momentum` (m, 3): of the
    wheels at the m times; `body`: the nominal one, which defines the axis. For a sphere only the sum is known: the angular speed.
    """
    axis, rates = spin_axis(body.inertia), []
    last_s, last_momentum = 0.0, momentum[0]
    # From zero to the first time, mostly backward and with the momentum of then; after that from each time to the next.
    for t, wheels in zip(after_s, momentum, strict=True):
        if t != last_s:
            momenta = last_momentum[None], wheels[None]
            omega = step(inertia, omega[:, None], np.array([t - last_s]), momenta).omega[:, 0]
        if body.sphere:
            speed = np.linalg.norm(omega, axis=1)
            rates.append(np.stack([*np.full((2, len(omega)), np.nan), speed], axis=1))
        else:
            rates.append(euler_rates(omega, omega @ inertia + wheels, axis))
        last_s, last_momentum = t, wheels
    return np.mean(rates, axis=0)


def spin_axis(inertia: np.ndarray) -> np.ndarray:
    """Return the spin axis (3) of a body with an inertia (3, 3): the principal axis whose moment differs most from the others."""
    moments, axes = np.linalg.eigh(inertia)
    apart = [np.abs(np.delete(moments, i) - moments[i]).min() for i in range(3)]
    return axes[:, int(np.argmax(apart))]


def euler_rates(omega_B: np.ndarray, momentum_B: np.ndarray, axis_B: np.ndarray) -> np.ndarray:
    """Return precession, spin and their sum (..., 3), rad/s, of rates omega_B (..., 3) about an axis (3) of the body.

    With the unit vectors h of the momentum (..., 3) and e of the axis: omega = precession h + spin e + (nutation across both). With
    c = h . e this gives omega . h = precession + c spin and omega . e = c precession + spin, two equations for both. They are NaN
    if h and e are parallel; the sum is known even then.
    """
    h = momentum_B / np.linalg.norm(momentum_B, axis=-1, keepdims=True)
    c, about_h, about_e = h @ axis_B, np.sum(omega_B * h, axis=-1), omega_B @ axis_B
    determinant = np.where(1 - c**2 > PARALLEL, 1 - c**2, np.nan)
    precession = (about_h - c * about_e) / determinant
    spin = (about_e - c * about_h) / determinant
    # the sum of rotations about opposite directions is their difference
    total = np.where(c < 0, about_h - about_e, about_h + about_e) / (1 + np.abs(c))
    return np.stack([precession, spin, total], axis=-1)


def draw_inertias(body: Body, rng: np.random.Generator) -> np.ndarray:
    """Return inertias (`INERTIAS`, 3, 3) in mean moments, drawn from the errors of the file: only those that a body can have.

    If the inertia is unknown, all are a sphere's.
    """
    possible = np.zeros((0, 3, 3))
    for _ in range(MOST_TRIES):
        u = rng.standard_normal((INERTIAS, len(body.errors))) * (not body.sphere)
        drawn = np.broadcast_to(body.inertia_at(u), (INERTIAS, 3, 3))
        # `Body.possible_errors` returns errors of a possible body unchanged
        is_possible = (body.possible_errors(u) == u).all(axis=1)
        possible = np.concatenate([possible, drawn[is_possible]])
        if len(possible) >= INERTIAS:
            break
    # if there are too few, the nominal inertia stands for the rest
    return np.concatenate([possible, np.tile(body.inertia, (INERTIAS, 1, 1))])[:INERTIAS]
