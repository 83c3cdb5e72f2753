"""What a posterior's verdict owes to its priors: the same draws under halved and doubled widths.

The importance draws are weighted anew by the ratio of the priors; they come from a heavy-tailed proposal, so that wider priors can
be asked too. Where too few draws carry the new weight, these draws do not tell, and that is said instead.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy.special import logsumexp

from sunspin.estimate.posterior.hypotheses import Mixed
from sunspin.estimate.posterior.model import Model
from sunspin.estimate.posterior.verdict import Found, word_of
from sunspin.estimate.verdict import LEAST_DRAWS
from sunspin.solve.weights import effective_draws, pareto_tail

FACTORS = (0.5, 2.0)

KEYS = {
    "inertia": ("inertia",),
    "wheel_speed": ("wheel_speed",),
    "wheel_inertia": ("wheel_inertia",),
    "friction": ("coulomb", "viscous"),
    "gain": ("gain",),
    "tilt": ("tilt",),
    "tilt_common": ("tilt_common",),
    "noise": ("noise",),
    "scale": ("scale",),
    "wheel_off": ("wheel_off",),
}
"""Key of `priors` -> kinds of its unknowns."""

RATE = "max_rate_rad_s"

LARGEST_TAIL = 0.7
"""Pareto's k up to which the number of effective draws can be believed."""


def prior_widths(model: Model, drawn: Mixed, found: Found) -> list[dict[str, Any]]:
    """For each prior and factor on its width what becomes of the verdict.

    Each entry: `prior`, `factor`; `told`, whether these draws tell; and if so `word`, the verdict's; `weight` of the first region;
    `shift`, by which the mean rate moves at most in a component, in its sigma before; `width`, the sigma of a component over that
    before, of the component where it changes most; `effective` draws.
    """
    asked = [key for key, kinds in KEYS.items() if any(model.where(kind) for kind in kinds)]
    return [_one(model, drawn, found, key, factor) for key in (*asked, RATE) for factor in FACTORS]


def _one(model: Model, drawn: Mixed, found: Found, key: str, factor: float) -> dict[str, Any]:
    said: dict[str, Any] = {"prior": key, "factor": factor, "told": False}
    if key == RATE and factor > 1:
        return said | {"effective": 0.0}  # nothing was drawn beyond the ball
    log_weight = drawn.log_weight + _log_ratio(model, drawn, key, factor)
    if not np.any(np.isfinite(log_weight)):
        return said | {"effective": 0.0}
    before, after = (np.exp(x - logsumexp(x)) for x in (drawn.log_weight, log_weight))
    effective = effective_draws(after)
    if effective < LEAST_DRAWS or pareto_tail(log_weight[np.isfinite(log_weight)]) > LARGEST_TAIL:
        return said | {"effective": effective}
    (old, was), (new, now) = (_moments(weight, drawn.state.omega) for weight in (before, after))
    regions = np.array([after[drawn.region == k].sum() for k in range(len(found.weight))])
    ratio = now / was
    order = np.argsort(-regions, kind="stable")
    changed = replace(
        found,
        weight=regions[order],
        rate=found.rate[order],
        length=found.length[order],
        hits=found.hits[order],
        doubts=[],
        tail=0.0,
        effective=np.inf,
    )
    return said | {
        "told": True,
        "word": word_of(changed),
        "weight": float(regions.max(initial=0.0)),
        "effective": effective,
        "shift": float(np.max(np.abs(new - old) / was)),
        "width": float(ratio[np.argmax(np.abs(np.log(ratio)))]),
    }


def _log_ratio(model: Model, drawn: Mixed, key: str, factor: float) -> np.ndarray:
    """Log of the other prior over the one that was used (n); unknowns are in their prior's sigmas."""
    if key == RATE:
        inside = np.linalg.norm(drawn.state.omega, axis=1) <= factor * model.max_rate
        return np.where(inside, 0.0, -np.inf)
    u = drawn.state.u[:, [i for kind in KEYS[key] for i in model.where(kind)]]
    return np.sum(-0.5 * u**2 * (factor**-2 - 1), axis=1) - u.shape[1] * np.log(factor)


def _moments(weight: np.ndarray, omega: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    mean = weight @ omega
    return mean, np.sqrt(np.maximum(weight @ (omega - mean) ** 2, 1e-300))


def prior_sentences(word: str, told: list[dict[str, Any]]) -> list[str]:
    """In words: what stays, what changes, and what these draws do not tell; `word` of the verdict as it is without its doubts."""
    known = [one for one in told if one["told"]]
    open_ = [one for one in told if not one["told"]]
    other = [one for one in known if one["word"] != word]
    found = []
    if known:
        most = max(known, key=lambda one: one["shift"])
        stays = (
            f'the verdict stays "{word}"'
            if not other
            else "the verdict changes with "
            + ", ".join(f'{_named(one)} ("{one["word"]}")' for one in other)
        )
        found.append(
            f"priors halved and doubled: {stays}; the rate moves by {most['shift']:.2g} sigma at most ({_named(most)})"
        )
    if open_:
        found.append(
            f"not known, as these draws do not reach so far: the verdict with {', '.join(map(_named, open_))}"
        )
    return found


def _named(one: dict[str, Any]) -> str:
    return f"{one['prior']} {'doubled' if one['factor'] > 1 else 'halved'}"
