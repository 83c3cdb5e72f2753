"""Periods seen from outside, as evidence among the modes of a pass: each weighs by how well its motion has them.

A mode is a Gaussian of the rate at the sample nearest to what was seen; its draws, each with an inertia as it may be, are run
freely over the periods, wheels as in the fit. Only weights change: within a mode the rates stay those of the samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.dynamics.bodies import Bodies
from sunspin.dynamics.torques import NOTHING
from sunspin.estimate.inertia import is_body
from sunspin.estimate.passes import padded
from sunspin.estimate.rates.finish import Pass
from sunspin.estimate.rates.motion import Body, Ends, step
from sunspin.estimate.rates.state import Motion, Observations
from sunspin.estimate.terms.period import (
    FAR_SIGMAS,
    READINGS,
    Period,
    euler_rates,
    evidence,
    mean_periods,
    own_axis,
)

INERTIAS, DRAWS = 8, 500
"""Inertias drawn, and rates of each mode with each of them."""

MOST_TRIES = 50
"""Rounds of draws at most until enough inertias are those of bodies; with sigmas as large as the moments about one in 20 is."""

LEAST_SHARE = 0.05
"""Weight of the motions that have the periods, below which the samples speak against these. Without this bound, half of the true
period, as of a light curve that repeats twice in a turn, decided one of 24 simulated passes wrongly."""


def weighted(
    o: Observations, found: list[Pass], motion: Motion, seen: Sequence[Period]
) -> tuple[list[Pass], list[dict[str, Any]]]:
    """The passes with weights that count the periods in, `before` being those without, and what each period decided.

    Where no motion of a pass has its periods, the samples speak against them, or too few draws carry them, its weights stay.

    Returns
    -------
    passes, decided
        For each period: `pass`, its place in `found`; `t_s`, `period_s`, `sigma_s`; `shares` by reading; `nearest_sigmas`,
        `effective` draws; `carried`, the weight without of the motions that have the periods; `told`, whether they count;
        `without`, the weight without of the motion that is likeliest now, and of the one that was then.

    Raises
    ------
    InputError
        A period was seen at a time of no pass.
    """
    place = [_pass_of(o, found, one) for one in seen]
    changed, said = [p._replace(before=p.weight) for p in found], []
    for k in sorted(set(place)):
        own = [one for one, at in zip(seen, place, strict=True) if at == k]
        changed[k], decided = _decided(o, changed[k], motion, own)
        said += [{"pass": k, **one} for one in decided]
    return changed, said


def _decided(
    o: Observations, p: Pass, motion: Motion, seen: list[Period]
) -> tuple[Pass, list[dict[str, Any]]]:
    """One pass with the weights that its periods give it, and what they decided."""
    weight, each = p.weight / p.weight.sum(), INERTIAS * DRAWS
    found = evidence(
        seen, [periods_of(o, p, motion, one) for one in seen], np.repeat(weight / each, each)
    )
    carried = float(weight[_have(found.density.reshape(len(weight), each), seen)].sum())
    counts = found.told and carried >= LEAST_SHARE
    after = found.weight.reshape(len(weight), each).sum(axis=1) if counts else weight
    about = {
        "nearest_sigmas": found.nearest_sigmas,
        "effective": found.effective,
        "carried": carried,
        "told": counts,
        "without": [float(weight[np.argmax(after)]), float(weight.max())],
    }
    shares = zip(seen, found.shares.tolist(), strict=True)
    return p._replace(weight=after), [
        {**asdict(one), "shares": share, **about} for one, share in shares
    ]


def _have(density: np.ndarray, seen: Sequence[Period]) -> np.ndarray:
    """Which modes (K), by the densities (K, n) of their draws, come as near to the periods as `FAR_SIGMAS`."""
    highest = np.prod([1 / (len(READINGS) * one.sigma_s * np.sqrt(2 * np.pi)) for one in seen])
    return density.max(axis=1) > np.exp(-0.5 * FAR_SIGMAS**2) * highest


def _pass_of(o: Observations, found: list[Pass], seen: Period) -> int:
    """The pass in which a period was seen, or from whose ends it is no further away than samples are from each other."""
    spans = [(t[0], t[-1], np.diff(t).max()) for t in (o.t_s[p.index] for p in found)]
    away = [max(first - seen.t_s, seen.t_s - last, 0.0) for first, last, _ in spans]
    k = int(np.argmin(away))
    if away[k] > spans[k][2]:
        each = ", ".join(f"{first:.0f} to {last:.0f}" for first, last, _ in spans[:6]) + (
            ", ..." if len(spans) > 6 else ""
        )
        raise InputError(
            "a period was seen at a time of no pass",
            got=f"{seen.t_s:g} s",
            do=f"passes are at {each} s",
        )
    return k


def periods_of(o: Observations, p: Pass, motion: Motion, seen: Period) -> np.ndarray:
    """Periods (K x `INERTIAS` x `DRAWS`, 3) in s by `READINGS` of draws of the modes of a pass.

    Without an inertia nobody knows what precesses; the sum is then that of the angular speed.
    """
    t_s, times, rng = o.t_s[p.index], seen.instants_s, np.random.default_rng(0)
    at = int(np.argmin(np.abs(t_s - seen.t_s)))
    wander = motion.noise**2 * abs(seen.t_s - t_s[at]) * np.eye(3)
    width, axes = np.linalg.eigh(p.track.covariance[:, at, 3:, 3:] + wander)
    spread = axes * np.sqrt(np.maximum(width, 0.0))[:, None, :]
    momentum = np.stack(
        [np.interp(times, t_s, o.momentum[p.index][:, i]) for i in range(3)], axis=1
    )
    parts = []
    for body in _bodies(motion.body, rng):
        drawn = p.track.omega[:, at, None] + np.einsum(
            "kij,nj->kni", spread, rng.standard_normal((DRAWS, 3))
        )
        parts.append(
            _periods(body, drawn.reshape(-1, 3), times - t_s[at], momentum).reshape(
                len(drawn), DRAWS, 3
            )
        )
    return np.stack(parts, axis=1).reshape(-1, 3)


def _periods(
    body: Body, omega: np.ndarray, after_s: np.ndarray, momentum: np.ndarray
) -> np.ndarray:
    """Periods (n, 3) of motions with rates (n, 3) now over times (m) from now, the wheels' momentum (m, 3) there."""
    axis, found, now, held = own_axis(body.inertia), [], 0.0, momentum[0]
    for t, wheels in zip(after_s, momentum, strict=True):
        if t != now:
            _, omega = step(
                body, omega, np.full(len(omega), t - now), Ends(momentum=held, momentum_end=wheels)
            )
        rates = euler_rates(omega, omega @ body.inertia + wheels, axis)
        if body.spherical:
            rates = np.stack(
                [*np.full((2, len(omega)), np.nan), np.linalg.norm(omega, axis=1)], axis=1
            )
        found.append(rates)
        now, held = t, wheels
    return mean_periods(found)


def _bodies(body: Body, rng: np.random.Generator) -> list[Body]:
    """Return `INERTIAS` bodies that move freely, their inertias drawn from the file's errors and cut to those that can exist.

    A body of unknown inertia stays a sphere.
    """
    free = replace(body, acting=NOTHING, dipole=np.zeros(3))
    nominal, kept = Bodies.rigid(body.inertia), np.zeros((0, 3, 3))
    for _ in range(MOST_TRIES):
        drawn = rng.standard_normal((INERTIAS, len(body.errors))) * (not body.spherical)
        inertias = body.inertia + np.einsum("am,mij->aij", drawn, body.errors)
        kept = np.concatenate([kept, inertias[is_body(Bodies.rigid(inertias), nominal)]])
        if len(kept) >= INERTIAS:
            break
    kept = np.concatenate([kept, np.tile(body.inertia, (INERTIAS, 1, 1))])[:INERTIAS]
    return [replace(free, inertia=one) for one in kept]


def without_periods(found: list[Pass]) -> dict[str, Any]:
    """The variable `probability_without_periods (pass_id, solution)`, where periods were counted in."""
    if all(p.before is None for p in found):
        return {}
    before = [p.weight if p.before is None else p.before for p in found]
    about = {"units": "1", "long_name": "probability of each solution without the periods seen"}
    return {"probability_without_periods": (("pass_id", "solution"), padded(before), about)}
