"""The inverse model of the panels: measured powers -> direction to the Sun, exactly, with its uncertainty and status.

The misfit is Delta(n) = |P(n)/|P(n)| - M/|M|| (paper, eq. 2). Its global minimum, ranks and arcs are the business of the law by
which the panels see light (:mod:`sunspin.vehicle.response`); what they mean for a sample is said here.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.base.provenance import provenance
from sunspin.telemetry.noise import ASSUMED_FROM, DARK_FROM, assumed_noise, dark_noise
from sunspin.telemetry.panel_unit import WrongUnit, panel_unit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import Pattern, lit_patterns, named, observable_patterns
from sunspin.vehicle.response.protocol import PanelResponse

LIT_FRACTION = 0.02
"""Without a noise figure, a panel counts as lit above this fraction of the largest value in the data."""

LIT_SIGMAS = 3.0
"""With one, above this many sigma."""

ALIKE, APART_RAD = 0.05, 0.02
"""Where panels share inputs, directions whose Delta exceeds the smallest by less than the first (or than the noise makes) fit
alike, unless they are nearer to each other than the second."""


class SunStatus(IntEnum):
    """Why a sample gives, or does not give, a direction; the sentence is in `STATUS_TEXT`."""

    OK = 0
    UNCHECKED = 1
    IMPOSSIBLE = 2
    RULE = 3
    ARC = 4
    REGION = 5
    DARK = 6
    MISSING = 7
    SEVERAL = 8


STATUS_TEXT = {
    SunStatus.OK: "reconstructed; more than three panels lit, so Delta checks it",
    SunStatus.UNCHECKED: "reconstructed from exactly three lit panels: nothing is redundant and Delta checks nothing",
    SunStatus.IMPOSSIBLE: "the Sun alone cannot light these panels: noise, other light, a shadow, a panel dead or read wrong",
    SunStatus.RULE: "excluded by a rule of the vehicle",
    SunStatus.ARC: "lit panels face directions in one plane only: the Sun lies somewhere on an arc",
    SunStatus.REGION: "lit panels all face one way: the Sun lies somewhere in a region",
    SunStatus.DARK: "no panel lit",
    SunStatus.SEVERAL: "several directions fit alike: the panels that would be lit there do not tell one from the other",
    SunStatus.MISSING: "the telemetry of this sample is missing or flagged",
}

ON_EDGE = 1e-9
"""Share of full Sun below which a panel is not lit: its edge is on the Sun."""

ROUNDING = 1e-9
"""Share of the largest reading below which residuals are rounding."""

RECONSTRUCTED = (SunStatus.OK, SunStatus.UNCHECKED)


def is_reconstructed(status: Any) -> np.ndarray:
    """Whether each status code comes with a direction that may be used."""
    return np.isin(np.asarray(status), RECONSTRUCTED)


def reconstructible_patterns(vehicle: Vehicle) -> frozenset[Pattern]:
    """The lit patterns that geometry allows and from which a direction follows: three panels that look in
    independent directions, no rule against, and no panels that share an input so that several directions fit."""
    patterns = lit_patterns(vehicle)
    response = vehicle.response_in()
    regions = response.regions()
    doubtful = named(vehicle, regions.lit[_several(vehicle, response.power(regions.sun_B), 0.0)])
    patterns = tuple(pattern for pattern in patterns if pattern not in doubtful)
    found = _pattern_statuses(
        vehicle, [tuple(name in pattern for name in vehicle.input_names) for pattern in patterns]
    )
    return frozenset(
        pattern
        for pattern, (status, _) in zip(patterns, found, strict=True)
        if status in RECONSTRUCTED
    )


@lru_cache(maxsize=4096)
def _status_cached(
    response: PanelResponse, possible: frozenset, rules: tuple, lit: tuple[bool, ...]
) -> tuple[SunStatus, str]:
    mask = np.array(lit)
    if not mask.any():
        return SunStatus.DARK, STATUS_TEXT[SunStatus.DARK]
    if lit not in possible:
        return SunStatus.IMPOSSIBLE, STATUS_TEXT[SunStatus.IMPOSSIBLE]
    rank = response.rank(mask)
    if rank < 3:
        status = SunStatus.ARC if rank == 2 else SunStatus.REGION
        return status, STATUS_TEXT[status]
    for dark, reason in rules:
        if not any(lit[k] for k in dark):
            return SunStatus.RULE, f"{STATUS_TEXT[SunStatus.RULE]}: {reason}"
    status = SunStatus.OK if mask.sum() > 3 else SunStatus.UNCHECKED
    return status, STATUS_TEXT[status]


def _pattern_statuses(
    vehicle: Vehicle, patterns: list[tuple[bool, ...]]
) -> list[tuple[SunStatus, str]]:
    names = vehicle.input_names
    possible = frozenset(
        tuple(name in pattern for name in names) for pattern in observable_patterns(vehicle)
    )
    rules = tuple(
        (tuple(names.index(name) for name in rule.all_dark), rule.reason)
        for rule in vehicle.sun_rules
    )
    return [_status_cached(vehicle.response_in(), possible, rules, lit) for lit in patterns]


def sun_directions(
    vehicle: Vehicle,
    telemetry: Any,
    *,
    noise: float | None = None,
    lit_threshold: float | None = None,
    wrong_unit: Callable[[], WrongUnit | None] | None = None,
) -> xr.Dataset:
    """Direction to the Sun for each sample of panel powers.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, or (n, n_panel) powers (or currents) in the order of the vehicle's panels
    noise : float, optional
        One-sigma noise of a panel's value, in its unit; default: the vehicle's, else estimated from the redundancy, else from
        readings below zero, which are dark panels', else assumed (:func:`sunspin.telemetry.noise.assumed_noise`).
        attrs `noise` and `noise_from` say which. Assumed noise sets errors alone: lit panels and statuses are as without it.
    lit_threshold : float, optional
        A panel counts as lit above this; default: the vehicle's, else three sigma, else 2 % of the largest value or, if
        readings below zero tell more, three sigma of those.
    wrong_unit : callable, optional
        Gives the wrong unit of the readings, which is named where no panel is lit; default: it is looked for.

    Returns
    -------
    xarray.Dataset
        On `time`: `sun_B` (unit, body axes; NaN where `status` says that no direction follows), `best_B` (a minimiser of
        Delta, whatever the status), `delta` (paper, eq. 2),
        `sigma_rad` (rms angle of the error), `sun_cov_B` (tangent covariance), both finite where `sun_B` is; `status`
        (`SunStatus`) with `status_text`, `lit` and `n_lit`, and for status ARC the two ends of the arc, `sun_arc_B`.

    Raises
    ------
    InputError
        Powers of other panels than the vehicle's; a noise that is not positive, a threshold that is negative or no number.
    """
    if noise is not None and not (np.isfinite(noise) and noise > 0):
        raise InputError(sentence("the noise of a panel reading must be positive", got=noise))
    if lit_threshold is not None and not (np.isfinite(lit_threshold) and lit_threshold >= 0):
        raise InputError(sentence("lit_threshold must be zero or positive", got=lit_threshold))
    power, base = _powers(vehicle, telemetry)
    noise = noise if noise is not None else vehicle.telemetry.noise
    threshold = lit_threshold if lit_threshold is not None else vehicle.telemetry.lit_threshold
    finite = np.all(np.isfinite(power), axis=1) & ~_flagged(base, len(power))
    clean = np.where(finite[:, None], power, 0.0)
    dark = dark_noise(clean) if noise is None else None
    if threshold is None:
        untold = max(LIT_FRACTION * float(clean.max(initial=0.0)), LIT_SIGMAS * (dark or 0.0))
        threshold = LIT_SIGMAS * noise if noise is not None else untold
    lit = (clean > threshold) & finite[:, None]
    status, texts = _statuses(vehicle, lit, finite)
    if np.any(status == SunStatus.DARK):
        wrong = panel_unit(vehicle, clean) if wrong_unit is None else wrong_unit()
        if wrong is not None:
            texts = np.where(status == SunStatus.DARK, str(wrong), texts)
    direction, delta = best_directions(vehicle, clean)
    told = is_reconstructed(status)
    noise_from = (
        "given"
        if noise is not None
        else "estimated from the redundancy of samples with more than three lit panels"
    )
    if noise is None:
        noise = _pooled_noise(clean, delta, lit, status)
    if np.isnan(noise) and dark is not None:
        noise, noise_from = dark, DARK_FROM
    doubtful = told.copy()
    doubtful[told] = _several(vehicle, clean[told], noise) | _free(vehicle, direction[told])
    if np.isnan(noise):
        noise, noise_from = assumed_noise(clean), ASSUMED_FROM
    covariance = _covariances(vehicle, clean, lit, told & ~doubtful, noise)
    doubtful |= told & ~np.isfinite(covariance).all(axis=(1, 2))
    if doubtful.any():
        status[doubtful], texts = (
            SunStatus.SEVERAL,
            np.where(doubtful, STATUS_TEXT[SunStatus.SEVERAL], texts),
        )
        told &= ~doubtful
    arcs = _arcs(vehicle, clean, lit, status)
    return _dataset(
        vehicle,
        base,
        direction,
        told,
        delta,
        covariance,
        status,
        texts,
        lit,
        arcs,
        noise,
        noise_from,
        threshold,
    )


def signals(telemetry: xr.Dataset) -> np.ndarray:
    """The powers or currents (time, panel) of a telemetry Dataset."""
    name = next((key for key in ("power_W", "current_A") if key in telemetry), None)
    if name is None:
        raise InputError(
            sentence(
                "the telemetry has no panel powers or currents",
                do="give a file with a column per panel",
            )
        )
    return np.asarray(telemetry[name].transpose("time", "panel"), dtype=np.float64)


def _powers(vehicle: Vehicle, telemetry: Any) -> tuple[np.ndarray, xr.Dataset | None]:
    vehicle.require_panels()
    n_panel = len(vehicle.inputs)
    if isinstance(telemetry, xr.Dataset):
        return signals(telemetry), telemetry
    power = np.atleast_2d(np.asarray(telemetry, dtype=np.float64))
    if power.ndim != 2 or power.shape[1] != n_panel:
        raise InputError(
            sentence(
                f"powers must have one column for each of the {n_panel} panels", got=power.shape
            )
        )
    return power, None


def _flagged(base: xr.Dataset | None, n: int) -> np.ndarray:
    return (
        np.zeros(n, dtype=bool)
        if base is None or "flag" not in base
        else np.asarray(base["flag"]) != 0
    )


def _statuses(
    vehicle: Vehicle, lit: np.ndarray, finite: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    patterns, inverse = np.unique(lit, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    found = _pattern_statuses(vehicle, [tuple(row) for row in patterns.tolist()])
    status = np.array([code for code, _ in found], dtype=np.int8)[inverse]
    texts = np.array([text for _, text in found], dtype=object)[inverse]
    status[~finite] = SunStatus.MISSING
    texts[~finite] = STATUS_TEXT[SunStatus.MISSING]
    return status, texts.astype(np.str_)


def best_directions(vehicle: Vehicle, power: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The direction (n, 3) with the smallest Delta (n) for each sample of powers (n, n_panel): the global minimum."""
    return vehicle.response_in().best(power)


def _several(vehicle: Vehicle, power: np.ndarray, noise: float) -> np.ndarray:
    """Which samples (n) of powers (n, n_panel) have several directions that fit alike."""
    if not vehicle.channels or not len(power):
        return np.zeros(len(power), dtype=bool)
    size = np.linalg.norm(power, axis=1)
    made = (
        LIT_SIGMAS
        * np.nan_to_num(noise)
        * np.sqrt(power.shape[1])
        / np.where(size > 0, size, np.inf)
    )
    found = vehicle.response_in().alike(power, np.maximum(made, ALIKE))
    away = np.linalg.norm(found - found[:, :1], axis=-1)
    return np.asarray((np.nan_to_num(away) > APART_RAD).any(axis=1))


def _free(vehicle: Vehicle, direction: np.ndarray) -> np.ndarray:
    """Which directions (n, 3) may move without a reading's changing: some panel reads that the Sun there does not light, and those
    that it lights tell less than three numbers."""
    response = vehicle.response_in()
    lit, inverse = np.unique(
        response.power(direction) > ON_EDGE * vehicle.input_gains, axis=0, return_inverse=True
    )
    return np.array([response.rank(one) < 3 for one in lit], dtype=bool)[inverse.ravel()]


def _pooled_noise(
    power: np.ndarray, delta: np.ndarray, lit: np.ndarray, status: np.ndarray
) -> float:
    """Sigma of one value from what is redundant: of L lit panels L - 3 are left after scale and direction. NaN where nothing is
    redundant, or readings are exact to rounding: what was computed has no noise."""
    checked = status == SunStatus.OK
    freedom = (lit[checked].sum(axis=1) - 3).sum()
    if freedom == 0:
        return float("nan")
    residual = delta[checked] * np.linalg.norm(power[checked], axis=1)
    noise = float(np.sqrt((residual**2).sum() / freedom))
    return noise if noise > ROUNDING * power.max() else float("nan")


def _covariances(
    vehicle: Vehicle, power: np.ndarray, lit: np.ndarray, told: np.ndarray, noise: float
) -> np.ndarray:
    """Tangent covariance (n, 3, 3) of the direction from the noise of the powers, NaN where there is no direction."""
    covariance = np.full((len(power), 3, 3), np.nan)
    patterns, inverse = np.unique(lit, axis=0, return_inverse=True)
    for k, pattern in enumerate(patterns):
        samples = np.flatnonzero((inverse.ravel() == k) & told)
        if samples.size:
            covariance[samples] = vehicle.response_in().covariance(power[samples], pattern, noise)
    return covariance


def _arcs(vehicle: Vehicle, power: np.ndarray, lit: np.ndarray, status: np.ndarray) -> np.ndarray:
    """Ends (n, 2, 3) of the arc of equally good directions where the lit panels leave one."""
    ends = np.full((len(power), 2, 3), np.nan)
    for i in np.flatnonzero(status == SunStatus.ARC):
        ends[i] = vehicle.response_in().arc(power[i], lit[i])
    return ends


def _dataset(
    vehicle,
    base,
    direction,
    told,
    delta,
    covariance,
    status,
    texts,
    lit,
    arcs,
    noise,
    noise_from,
    threshold,
):
    coords: dict[str, Any] = {"axis": ["x", "y", "z"], "panel": list(vehicle.input_names)}
    if base is not None:
        coords |= {name: base[name] for name in ("time", "utc", "phase") if name in base.coords}
    attrs = {} if base is None else dict(base.attrs)
    attrs |= provenance("sun_directions", **vehicle.said) | {
        "noise": float(noise),
        "noise_from": noise_from,
        "lit_threshold": float(threshold),
        "source": "paper, eqs. 1 and 2, minimised exactly",
    }
    flags = {
        "flag_values": [int(s) for s in SunStatus],
        "flag_meanings": " ".join(s.name.lower() for s in SunStatus),
    }
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    return xr.Dataset(
        {
            "sun_B": (
                ("time", "axis"),
                np.where(told[:, None], direction, np.nan),
                {"units": "1", "long_name": "direction to the Sun, body axes"},
            ),
            "best_B": (
                ("time", "axis"),
                direction,
                {"units": "1", "long_name": "a minimiser of Delta, whatever the status"},
            ),
            "delta": ("time", delta, {"units": "1", "long_name": "misfit Delta, paper eq. 2"}),
            "sigma_rad": (
                "time",
                sigma,
                {"units": "rad", "long_name": "rms angle of the error from panel noise"},
            ),
            "sun_cov_B": (
                ("time", "axis", "axis2"),
                covariance,
                {"units": "1", "long_name": "tangent covariance"},
            ),
            "status": ("time", status, flags),
            "status_text": ("time", texts),
            "lit": (("time", "panel"), lit),
            "n_lit": ("time", lit.sum(axis=1).astype(np.int32), {"units": "1"}),
            "sun_arc_B": (
                ("time", "end", "axis"),
                arcs,
                {"units": "1", "long_name": "ends of the arc of directions"},
            ),
        },
        coords=coords,
        attrs=attrs,
    )
