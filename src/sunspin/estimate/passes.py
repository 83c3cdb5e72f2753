"""The table of a posterior, with the columns of that of `rates`: a row for every motion, with what may be believed of it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from sunspin.estimate.verdict import Answers, Speed
from sunspin.vehicle.timeline import utc_after

AS_STATED, UNCHECKED = "as_stated", "unchecked"
"""Whether the data confirm which column is which: they do; they cannot."""

SPEEDS = (0.05, 0.5, 0.95)
"""Quantiles of the angular speed that are reported."""

DRAWS = 10_000
"""Draws behind them, where a motion is known by mean and covariance: the 95 % quantile of one normal number is then known to 2 %
of its sigma."""

UPPER = 0.95
"""Probability of an upper limit of the speed."""


class PassMotions(NamedTuple):
    """The K motions of one pass at the instant `at_s`: samples used, first and last instant (s from the epoch), probabilities (K),
    rates (K, 3) with sigmas (K, 3), quantiles of the angular speed (K, 3), rad/s."""

    samples: int
    first_s: float
    last_s: float
    at_s: float
    probability: np.ndarray
    omega: np.ndarray
    sigma: np.ndarray
    speed: np.ndarray
    answers: Answers
    columns_checked: str


def drawn_speeds(omega: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return draws (K, `DRAWS`) of the angular speed of rates (K, 3) with covariances (K, 3, 3), the same ones every time."""
    normal = np.random.default_rng(0).standard_normal((DRAWS, 3))
    values, axes = np.linalg.eigh(covariance)
    spread = axes * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    return np.linalg.norm(omega[:, None] + np.einsum("kij,nj->kni", spread, normal), axis=-1)


def speeds(omega: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the quantiles `SPEEDS` (K, 3) of the angular speed of rates (K, 3) with covariances (K, 3, 3)."""
    return np.quantile(drawn_speeds(omega, covariance), SPEEDS, axis=1).T


def speed_of(omega: np.ndarray, drawn: list[np.ndarray], probability: np.ndarray) -> Speed:
    """Return the speed of the rate `omega` (3), with its error and its upper limit.

    `drawn`: speeds drawn from each of K solutions, the first of which has the rate; `probability` (K), by which they count. The
    error is that of the first: an unlikely alias makes it no larger. The limit counts all. Near zero the speed is not normally
    distributed, so both are computed from draws and not by linear propagation.
    """
    value = float(np.linalg.norm(omega))
    speed = np.concatenate(drawn)
    if not (np.isfinite(value) and np.isfinite(speed).all()):
        return Speed(value, np.nan, np.nan)
    shares = np.asarray(probability) / np.sum(probability)
    each = np.concatenate(
        [np.full(len(part), share / len(part)) for part, share in zip(drawn, shares, strict=True)]
    )
    order = np.argsort(speed)
    passed = np.searchsorted(np.cumsum(each[order]), UPPER)
    below = float(speed[order[min(passed, len(order) - 1)]])
    return Speed(value, float(np.sqrt(np.mean((drawn[0] - value) ** 2))), below)


def padded(values: Sequence[np.ndarray]) -> np.ndarray:
    """Values (n_solution, ...) of each pass as one array (n_pass, most solutions, ...), NaN where a pass has fewer."""
    out = np.full((len(values), max(map(len, values)), *values[0].shape[1:]), np.nan)
    for row, value in zip(out, values, strict=True):
        row[: len(value)] = value
    return out


def table(passes: Sequence[PassMotions], epoch_utc: str | None) -> dict[str, Any]:
    """Variables for a Dataset over (`pass_id`, `solution`), those of `passes.csv`; NaN where a pass has fewer solutions."""

    def utc(seconds: float) -> str:
        return "" if epoch_utc is None else utc_after(seconds, epoch_utc, 3)

    def flags(values: list[bool]) -> Any:
        return "pass_id", np.array(values, dtype=bool)

    each = ("pass_id", "solution")
    variables: dict[str, Any] = {
        "utc_start": ("pass_id", [utc(one.first_s) for one in passes]),
        "utc_end": ("pass_id", [utc(one.last_s) for one in passes]),
        "samples": ("pass_id", [one.samples for one in passes]),
        "probability": (each, padded([one.probability for one in passes])),
        "decided": flags([one.answers.decided for one in passes]),
        "unique": flags([one.answers.unique for one in passes]),
        **{
            f"constrained_{axis}": flags([one.answers.constrained[k] for one in passes])
            for k, axis in enumerate("xyz")
        },
        "fits": flags([one.answers.fits for one in passes]),
        "search_complete": flags([one.answers.search_complete for one in passes]),
        "columns_checked": ("pass_id", [one.columns_checked for one in passes]),
        "utc_at": ("pass_id", [utc(one.at_s) for one in passes]),
    }
    for k, name in enumerate(("speed_low", "speed_median", "speed_high")):
        variables[name] = each, padded([one.speed[:, k] for one in passes])
    for name in ("omega", "sigma"):
        for k, axis in enumerate("xyz"):
            values = padded([getattr(one, name)[:, k] for one in passes])
            variables[f"{name}_{axis}"] = each, values
    known = [one.answers.speed or Speed(np.nan, np.nan, np.nan) for one in passes]
    variables["constrained_speed"] = flags([one.answers.speed_constrained for one in passes])
    variables["speed_sigma"] = "pass_id", [speed.sigma for speed in known]
    variables["speed_below"] = "pass_id", [speed.below for speed in known]
    variables["why_not_decided"] = ("pass_id", [one.answers.why_not for one in passes])
    return variables
