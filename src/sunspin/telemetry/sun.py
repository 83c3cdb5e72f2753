"""The inverse model of the panels: measured powers -> direction to the Sun, exactly, with its uncertainty and status.

The misfit is Delta(n) = |P(n)/|P(n)| - M/|M|| (paper, eq. 2). Its global minimum, ranks and arcs are computed by the panels'
response (:mod:`sunspin.vehicle.response`); this module derives from them the status and the uncertainty of each sample.
"""

from __future__ import annotations

from collections.abc import Callable
from enum import IntEnum
from functools import lru_cache
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.base.provenance import provenance
from sunspin.telemetry.noise import ASSUMED_FROM, DARK_FROM, assumed_noise, dark_noise
from sunspin.telemetry.quality import BELOW_FULL, IDLE, judge_readings
from sunspin.telemetry.signals import signals
from sunspin.telemetry.units import WrongUnit, panel_unit, reading_unit
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.panels import Pattern, patterns_by_name

LIT_FRACTION = 0.02
"""Without a known noise, a panel counts as lit above this fraction of the largest value in the data."""

LIT_SIGMAS = 3.0
"""With a known noise, a panel counts as lit above this many sigma."""

ALIKE, APART_RAD = 0.05, 0.02
"""Two directions fit equally well if their Delta differs by less than the first number, or by less than the noise explains. They
are different directions if they are farther apart than the second. Used only if panels share inputs."""


class SunStatus(IntEnum):
    """Reason why a sample gives, or does not give, a direction; the sentence is in `STATUS_TEXT`."""

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
    SunStatus.OK: "direction determined and checked (more than three panels lit)",
    SunStatus.UNCHECKED: "direction determined, not checked (exactly three panels lit: no redundancy)",
    SunStatus.IMPOSSIBLE: "impossible illumination pattern (noise, albedo, shadow, failed panel or wrong column)",
    SunStatus.RULE: "excluded by a rule of the vehicle",
    SunStatus.ARC: "direction known only to an arc (normals of the lit panels are coplanar)",
    SunStatus.REGION: "direction known only to a region (lit panels have the same normal)",
    SunStatus.DARK: "no panel lit",
    SunStatus.SEVERAL: "ambiguous: several directions fit equally well",
    SunStatus.MISSING: "the telemetry of this sample is missing or flagged",
}

HIDDEN = "a panel without signal may be sunlit"
"""Reason of a sample without a direction because a lost panel may have been in the Sun."""

ON_EDGE = 1e-9
"""Share of full Sun below which a panel is not lit: its plane contains the Sun."""

ROUNDING = 1e-9
"""Share of the largest reading below which residuals are rounding errors."""

RECONSTRUCTED = (SunStatus.OK, SunStatus.UNCHECKED)
"""Status codes of samples that have a direction."""


def is_reconstructed(status: Any) -> np.ndarray:
    """Return whether each status code means that the sample has a direction."""
    return np.isin(np.asarray(status), RECONSTRUCTED)


def reconstructible_patterns(vehicle: Vehicle) -> frozenset[Pattern]:
    """Return the illumination patterns that geometry allows and that determine a direction.

    Three of the lit panels have independent normals, and no rule of the vehicle excludes the pattern. Panels that share an input do
    not make several directions fit.
    """
    vehicle.require_panels()
    response = vehicle.response_in()
    sun_B, lit = response.regions()
    ambiguous = lit[_is_ambiguous(vehicle, response.power(sun_B), noise=0.0)]
    reconstructed = lit[is_reconstructed([status for status, _ in _statuses(vehicle, lit)])]
    return patterns_by_name(vehicle, reconstructed) - patterns_by_name(vehicle, ambiguous)


@lru_cache(maxsize=4096)
def _status_cached(
    response: PanelResponse, possible: frozenset, rules: tuple, lit: tuple[bool, ...]
) -> tuple[SunStatus, str]:
    """Return status and sentence of one pattern `lit` (n_panel).

    `possible` are the patterns that geometry allows; `rules` are pairs of the panels, one of which must be lit, and the reason. The
    first status that applies is returned, in the order of the body.
    """
    mask = np.array(lit)
    if not mask.any():
        return SunStatus.DARK, STATUS_TEXT[SunStatus.DARK]
    if lit not in possible:
        return SunStatus.IMPOSSIBLE, STATUS_TEXT[SunStatus.IMPOSSIBLE]
    rank = response.rank(mask)
    if rank < 3:
        status = SunStatus.ARC if rank == 2 else SunStatus.REGION
        return status, STATUS_TEXT[status]
    for panels, reason in rules:
        if not any(lit[k] for k in panels):
            return SunStatus.RULE, f"{STATUS_TEXT[SunStatus.RULE]}: {reason}"
    status = SunStatus.OK if mask.sum() > 3 else SunStatus.UNCHECKED
    return status, STATUS_TEXT[status]


def _statuses(vehicle: Vehicle, lit: np.ndarray) -> list[tuple[SunStatus, str]]:
    """Return status and sentence of each pattern of lit panels (n, n_panel)."""
    names, response = vehicle.input_names, vehicle.response_in()
    # of directions inside the cells of the sphere, and of those on their edges, where the Sun is in a panel's plane
    patterns = np.concatenate([response.regions().lit, response.edges()])
    possible = frozenset(map(tuple, patterns.tolist()))
    rules = tuple(
        (tuple(names.index(name) for name in rule.all_dark), rule.reason)
        for rule in vehicle.sun_rules
    )
    return [_status_cached(response, possible, rules, tuple(row)) for row in lit.tolist()]


def sun_directions(
    vehicle: Vehicle,
    telemetry: Any,
    *,
    noise: npt.ArrayLike | None = None,
    lit_threshold: npt.ArrayLike | None = None,
    wrong_unit: Callable[[], WrongUnit | None] | None = None,
    quality: xr.Dataset | None = None,
) -> xr.Dataset:
    """Estimate the direction to the Sun for each sample of panel powers.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, or (n, n_panel) powers (or currents) in the order of the vehicle's panels
    noise : float or (n_panel,), optional
        One-sigma noise of a panel reading, in its unit. Default: that of the vehicle file. If it states none, one value for all
        panels is estimated from the redundancy, else from readings below zero (dark panels). The last resort is an assumption
        (:func:`sunspin.telemetry.noise.assumed_noise`). attrs `noise` (median over panels) and `noise_from` name it. An assumed
        noise only sets the errors; it does not change which panels are lit, nor a status.
    lit_threshold : float or (n_panel,), optional
        Reading above which a panel counts as lit. Default: that of the vehicle file; else three sigma of the noise. If no noise is
        known: 2 % of the largest value, or three sigma estimated from readings below zero if that is larger.
    wrong_unit : callable, optional
        Returns the wrong unit of the readings, which is named if no panel is lit. Default: the unit is tested here.
    quality : Dataset of `panel_quality`, optional
        Marks the readings of a telemetry Dataset that are measured; only these give directions. Default: it is computed.

    Returns
    -------
    xarray.Dataset
        On `time`: `sun_B`, unit vector in body axes, NaN if the `status` has no direction; `best_B`, a minimiser of Delta for any
        status; `delta` (paper, eq. 2). Finite if `sun_B` is: `sigma_rad`, rms angle of the error, and `sun_cov_B`, the tangent
        covariance. `status` (`SunStatus`) with `status_text`; `lit`, `n_lit`; for status ARC the two ends of the arc, `sun_arc_B`.
        On `panel`: the `noise` and `lit_threshold` that were used.

    Raises
    ------
    InputError
        The powers do not fit the vehicle's panels, the noise is not positive, or the threshold is negative or not a number.
    """
    power = panel_readings(vehicle, telemetry)
    base = telemetry if isinstance(telemetry, xr.Dataset) else None
    each_panel = np.ones(power.shape[1])  # times one number for all panels
    sigma, threshold = vehicle.input_noise, vehicle.telemetry.lit_threshold
    if noise is not None:
        message = "the noise of a panel reading must be positive"
        sigma = per_panel(vehicle, noise, np.greater, message)
    if lit_threshold is not None:
        message = "lit_threshold must be zero or positive"
        threshold = per_panel(vehicle, lit_threshold, np.greater_equal, message)
    # `usable` (n): samples that are finite and not excluded by flags or quality
    usable = np.all(np.isfinite(power), axis=1)
    excluded: dict[int, str] = {}  # sample -> reason
    lost = np.zeros(power.shape[1], dtype=bool)
    if base is not None:
        if "flag" in base:
            usable &= np.asarray(base["flag"]) == 0
        unit = wrong_unit or (lambda: panel_unit(vehicle, power))
        quality = judge_readings(vehicle, base, unit) if quality is None else quality
        excluded, lost = _excluded(quality, usable), quality["missed"].values
        usable[list(excluded)] = False
    clean = np.where(usable[:, None], power, 0.0)
    dark = dark_noise(clean) if sigma is None else None
    if threshold is None and sigma is not None:
        threshold = LIT_SIGMAS * sigma
    elif threshold is None:
        threshold = max(LIT_FRACTION * float(clean.max(initial=0.0)), LIT_SIGMAS * (dark or 0.0))
    lit = (clean > threshold) & usable[:, None]
    # the status follows from the illumination pattern, of which a file has few; `inverse` (n) is that of each sample
    patterns, inverse = np.unique(lit, axis=0, return_inverse=True)
    inverse = inverse.ravel()
    pattern_statuses = _statuses(vehicle, patterns)
    status = np.array([code for code, _ in pattern_statuses], dtype=np.int8)[inverse]
    texts = np.array([text for _, text in pattern_statuses], dtype=object)[inverse]
    status[~usable], texts[~usable] = SunStatus.MISSING, STATUS_TEXT[SunStatus.MISSING]
    for sample, reason in excluded.items():
        texts[sample] = f"{STATUS_TEXT[SunStatus.MISSING]}: {reason}"
    # a lost panel may have been in the Sun, so that the direction is not known
    hidden = is_reconstructed(status) & _may_lack_lost_panel(vehicle, patterns, lost)[inverse]
    status[hidden], texts[hidden] = SunStatus.MISSING, f"{STATUS_TEXT[SunStatus.MISSING]}: {HIDDEN}"
    if np.any(status == SunStatus.DARK):
        wrong = panel_unit(vehicle, clean) if wrong_unit is None else wrong_unit()
        if wrong is not None:
            texts[status == SunStatus.DARK] = str(wrong)
    direction, delta = vehicle.response_in().best_direction(clean)
    known = is_reconstructed(status)
    noise_from = "given"
    if sigma is None:
        sigma = each_panel * _pooled_noise(clean, delta, lit, status)
        noise_from = "estimated from the redundancy of samples with more than three lit panels"
    if np.isnan(sigma).any() and dark is not None:
        sigma, noise_from = each_panel * dark, DARK_FROM
    ambiguous = known.copy()
    ambiguous[known] = _is_ambiguous(vehicle, clean[known], sigma)
    ambiguous[known] |= _is_undetermined(vehicle, direction[known])
    # assumed last, so that an assumed noise makes no direction ambiguous
    if np.isnan(sigma).any():
        sigma, noise_from = each_panel * assumed_noise(clean), ASSUMED_FROM
    response = vehicle.response_in()
    covariance, arcs = np.full((len(power), 3, 3), np.nan), np.full((len(power), 2, 3), np.nan)
    for k, pattern in enumerate(patterns):
        samples = np.flatnonzero((inverse == k) & known & ~ambiguous)
        if samples.size:
            covariance[samples] = response.covariance(clean[samples], pattern, sigma)
    ambiguous |= known & ~np.isfinite(covariance).all(axis=(1, 2))
    status[ambiguous], texts[ambiguous] = SunStatus.SEVERAL, STATUS_TEXT[SunStatus.SEVERAL]
    known &= ~ambiguous
    for i in np.flatnonzero(status == SunStatus.ARC):
        arcs[i] = response.arc(clean[i], lit[i])
    sun_B = np.where(known[:, None], direction, np.nan)
    sigma_rad = np.sqrt(np.trace(covariance, axis1=1, axis2=2))
    values = {
        "sun_B": sun_B,
        "best_B": direction,
        "delta": delta,
        "sigma_rad": sigma_rad,
        "sun_cov_B": covariance,
        "n_lit": lit.sum(axis=1).astype(np.int32),
        "sun_arc_B": arcs,
        "status": status,
        "status_text": texts.astype(np.str_),
        "lit": lit,
        "noise": sigma,
        "lit_threshold": each_panel * threshold,
    }
    return _directions_dataset(vehicle, base, values, noise_from).assign_attrs(
        noise_unit=reading_unit(vehicle, power)
    )


VARIABLES: dict[str, tuple[tuple[str, ...], dict[str, Any]]] = {
    "sun_B": (("time", "axis"), {"units": "1", "long_name": "direction to the Sun, body axes"}),
    "best_B": (
        ("time", "axis"),
        {"units": "1", "long_name": "a minimiser of Delta, for any status"},
    ),
    "delta": (("time",), {"units": "1", "long_name": "misfit Delta, paper eq. 2"}),
    "sigma_rad": (
        ("time",),
        {"units": "rad", "long_name": "rms angle of the error from panel noise"},
    ),
    "sun_cov_B": (("time", "axis", "axis2"), {"units": "1", "long_name": "tangent covariance"}),
    "n_lit": (("time",), {"units": "1", "long_name": "number of lit panels"}),
    "sun_arc_B": (
        ("time", "end", "axis"),
        {"units": "1", "long_name": "ends of the arc of directions"},
    ),
    "status": (
        ("time",),
        {
            "long_name": "why a sample gives a direction or not",
            "flag_values": [int(s) for s in SunStatus],
            "flag_meanings": " ".join(s.name.lower() for s in SunStatus),
        },
    ),
    "status_text": (("time",), {"long_name": "status in words"}),
    "lit": (("time", "panel"), {"long_name": "panel is lit"}),
    "noise": (("panel",), {"units": "as the readings"}),
    "lit_threshold": (("panel",), {"units": "as the readings"}),
}
"""Variables of the Dataset of `sun_directions`: name -> dimensions and attributes."""


def _directions_dataset(
    vehicle: Vehicle, base: xr.Dataset | None, values: dict[str, np.ndarray], noise_from: str
) -> xr.Dataset:
    """Return the Dataset of `sun_directions` from the values of its `VARIABLES`.

    The telemetry `base`, if it is a Dataset, gives times and attributes; `noise_from` is the origin of the noise in words.
    """
    data = xr.Dataset(
        {name: (VARIABLES[name][0], value, VARIABLES[name][1]) for name, value in values.items()},
        coords={"axis": ["x", "y", "z"], "panel": list(vehicle.input_names)},
        attrs=({} if base is None else dict(base.attrs))
        | provenance("sun_directions", **vehicle.result_attributes)
        | {
            "noise": float(np.median(values["noise"])),
            "noise_from": noise_from,
            "lit_threshold": float(np.median(values["lit_threshold"])),
            "source": "paper, eqs. 1 and 2, minimised exactly",
        },
    )
    if base is not None:
        coords = {name: base[name] for name in ("time", "utc", "phase") if name in base.coords}
        data = data.assign_coords(coords)
    return data


def _excluded(quality: xr.Dataset, usable: np.ndarray) -> dict[int, str]:
    """Return index -> reason of the samples, among the `usable` ones (n), that give no direction.

    A panel was not read (lost panels apart), or the battery and not the Sun determines all readings. The reason is the part of the
    sentence `why` after "dropped: " or "down-weighted: ".
    """
    reasons, measured = quality["why"].values.astype(str), quality["measured"].values
    complete = quality["reading"].values | quality["missed"].values
    follows_battery = np.isin(reasons, [IDLE, BELOW_FULL]) & ~measured.any(axis=1)
    excluded = usable & (~complete.all(axis=1) | follows_battery)
    return {int(k): reasons[k].partition(": ")[2] for k in np.flatnonzero(excluded)}


def _may_lack_lost_panel(vehicle: Vehicle, patterns: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Return for each pattern of lit panels (n, n_panel) whether a `lost` panel (n_panel) may have been in the Sun as well."""
    if not lost.any():
        return np.zeros(len(patterns), dtype=bool)
    possible = vehicle.response_in().regions().lit
    # what the patterns with a lost panel look like without it
    without_lost = possible[(possible & lost).any(axis=1)] & ~lost
    return np.array([(without_lost == pattern).all(axis=1).any() for pattern in patterns & ~lost])


def per_panel(
    vehicle: Vehicle, value: npt.ArrayLike, compare: Callable[..., np.ndarray], message: str
) -> np.ndarray:
    """Return one number for each panel (n_panel), from one number for all panels or one for each.

    Raises
    ------
    InputError
        With the text `message`, if a number is not finite or ``compare(number, 0)`` is false.
    """
    each = np.asarray(value, dtype=np.float64)
    right_size = each.shape in ((), (len(vehicle.inputs),))
    if not (right_size and np.isfinite(each).all() and compare(each, 0.0).all()):
        do = None if right_size else "give one number, or one for each panel"
        raise InputError(message, got=value, do=do)
    return each * np.ones(len(vehicle.inputs))


def panel_readings(vehicle: Vehicle, telemetry: Any) -> np.ndarray:
    """Return the panel readings (n, n_panel) of a telemetry Dataset or of an array.

    Raises
    ------
    InputError
        The array does not have one column for each panel of the vehicle.
    """
    vehicle.require_panels()
    n_panel = len(vehicle.inputs)
    if isinstance(telemetry, xr.Dataset):
        return signals(telemetry)
    power = np.atleast_2d(np.asarray(telemetry, dtype=np.float64))
    if power.ndim != 2 or power.shape[1] != n_panel:
        raise InputError(
            f"powers must have one column for each of the {n_panel} panels", got=power.shape
        )
    return power


def _is_ambiguous(vehicle: Vehicle, power: np.ndarray, noise: npt.ArrayLike) -> np.ndarray:
    """Return whether several directions fit the powers of each sample (n, n_panel) equally well, given the noise of a reading.

    This happens only if panels share inputs (channels of the vehicle file). An unknown noise (NaN) counts as zero.
    """
    if not vehicle.channels or not len(power):
        return np.zeros(len(power), dtype=bool)
    length = np.linalg.norm(power, axis=1)
    # Delta compares unit vectors of powers, and noise changes it by its ratio to their length
    by_noise = (
        LIT_SIGMAS * np.linalg.norm(np.nan_to_num(noise)) / np.where(length > 0, length, np.inf)
    )
    tolerance = np.maximum(by_noise, ALIKE)
    # the best direction of each sample first, then others that fit as well, then NaN
    alike = vehicle.response_in().near_best(power, tolerance)
    apart = np.linalg.norm(alike - alike[:, :1], axis=-1)
    return np.asarray((np.nan_to_num(apart) > APART_RAD).any(axis=1))


def _is_undetermined(vehicle: Vehicle, direction: np.ndarray) -> np.ndarray:
    """Return whether the panels that the Sun lights at each direction (n, 3) have fewer than three independent normals.

    The direction can then change without a change of the readings. This happens if some reading is not sunlight at the
    best-fitting direction.
    """
    response = vehicle.response_in()
    lit, inverse = np.unique(
        response.power(direction) > ON_EDGE * vehicle.input_gains, axis=0, return_inverse=True
    )
    return np.array([response.rank(pattern) < 3 for pattern in lit], dtype=bool)[inverse.ravel()]


def _pooled_noise(
    power: np.ndarray, delta: np.ndarray, lit: np.ndarray, status: np.ndarray
) -> float:
    """Return the sigma of a reading, estimated from the residuals of all samples with more than three lit panels.

    `power` and `lit` (n, n_panel), `delta` and `status` (n) are of all samples. Brightness and direction are three numbers, so L
    lit panels leave L - 3 degrees of freedom. The sigma is NaN if no sample has more than three lit panels, or if the residuals are
    only rounding errors, as in computed powers without noise.
    """
    redundant = status == SunStatus.OK  # more than three panels lit
    degrees_of_freedom = (lit[redundant].sum(axis=1) - 3).sum()
    if degrees_of_freedom == 0:
        return float("nan")
    # Delta is the misfit of unit vectors of powers; times their length it is that of the powers
    residual = delta[redundant] * np.linalg.norm(power[redundant], axis=1)
    noise = float(np.sqrt((residual**2).sum() / degrees_of_freedom))
    return noise if noise > ROUNDING * power.max() else float("nan")
