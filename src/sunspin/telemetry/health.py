"""Panel health: lit patterns that geometry forbids, which panels' loss would explain them (paper, section 4), and whether
noise, or panels that do not stand quite as drawn, might have made them.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.base.provenance import provenance
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import Dense, dense
from sunspin.telemetry.noise import ASSUMED_FROM, BRIGHT_QUANTILE
from sunspin.telemetry.sun import SunStatus, of_panels, powers, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.flat import PanelResponse
from sunspin.vehicle.response.panels import (
    brightness,
    lit_patterns,
    observable_patterns,
    turned_sigma,
)

STEPS, ROUNDING = 60, 1e-12
"""Steps of the search for the Sun that contradicts the readings least, of which a dozen are usually enough; and the gain, in sigma
squared, at which it ends."""

NOISE_ALONE = 0.01
"""Noise alone does not make forbidden patterns where it would show such readings in so many of a file's samples with a smaller
probability than this; nor do panels turned by their stated sigmas where any of a file's samples is less probable."""

CHUNK = 2000
"""Samples searched at once: each from every cell of the sphere."""


class NoiseVerdict(NamedTuple):
    """All samples of one forbidden pattern: the largest `probability` and `pattern_probability` of `NoiseMade` among them,
    and log10 of the product of `probability` over them, as their noise is independent."""

    largest: float
    largest_of_pattern: float
    log10_together: float


class PanelHealth(xr.Dataset):
    """A Dataset that also answers to what :func:`panel_health` is asked for by name: ``allowed``, ``impossible``, ``explanations``
    and ``noise``, as plain Python objects. Read back from a file it is a Dataset without these; `named_panels` makes them."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        if key == "allowed":
            return named_panels(self, "allowed_lit")
        if key == "impossible":
            return dict(
                zip(
                    named_panels(self, "impossible_lit"),
                    self["samples"].values.tolist(),
                    strict=True,
                )
            )
        if key == "explanations":
            return named_panels(self, "lost")
        if key == "noise":
            figures = zip(
                *(self[name].values.tolist() for name in NoiseVerdict._fields), strict=True
            )
            verdicts = zip(named_panels(self, "impossible_lit"), figures, strict=True)
            return {p: NoiseVerdict(*of_p) for p, of_p in verdicts if not np.isnan(of_p[0])}
        return super().__getitem__(key)


def named_panels(health: xr.Dataset, name: str) -> list[tuple[str, ...]]:
    """Sets of panels, a tuple of names each, of a variable (n, panel) of true and false."""
    panels = health["panel"].values
    return [tuple(panels[row].tolist()) for row in health[name].values.astype(bool)]


def panel_health(
    vehicle: Vehicle,
    telemetry: Any,
    *,
    could_be_noise: float | None = None,
    could_be_turned: bool = False,
    **options: Any,
) -> PanelHealth:
    """Which observed lit patterns the Sun alone cannot make, and the smallest sets of panels whose loss explains all.

    A pattern is explained by a set of panels if adding some of them to the lit ones gives a possible pattern: those were in
    the Sun and gave nothing, being shadowed or dead (paper, section 4).

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, (n, n_panel) powers, or Dataset of `sun_directions` (which holds no powers, so
        that nothing can be said of noise)
    could_be_noise : float, optional
        Samples that noise alone makes with at least this probability need no explanation. Default: all need one.
    could_be_turned : bool
        Nor do patterns that panels turned by the sigmas which the vehicle's file states of their normals may show.
    **options
        `noise` and `lit_threshold`, as for `sun_directions`.

    Returns
    -------
    xarray.Dataset
        `allowed_lit (allowed_pattern, panel)`: the lit patterns that geometry allows, for directions in no panel's plane;
        `impossible_lit (pattern, panel)` with `samples (pattern)`, their number; `lost (explanation, panel)`: the smallest sets
        of panels, none where nothing needs explaining or nothing explains it; `largest`, `largest_of_pattern` and
        `log10_together (pattern)` as in `NoiseVerdict`, NaN without powers or without a noise figure; `turned (pattern)`, a bound
        on the probability that noise and the stated turns of panels make its least likely sample, NaN where no turns are
        stated either. As returned it also has
        ``["allowed"]`` (tuples of names), ``["impossible"]`` ({pattern: number of samples}), ``["explanations"]`` (tuples) and
        ``["noise"]`` ({pattern: `NoiseVerdict`}).
    """
    is_sun = isinstance(telemetry, xr.Dataset) and "lit" in telemetry
    sun = telemetry if is_sun else sun_directions(vehicle, telemetry, **options)
    forbidden = np.flatnonzero(np.asarray(sun["status"]) == SunStatus.IMPOSSIBLE)
    names = np.array(vehicle.input_names)
    of_sample = [tuple(names[lit].tolist()) for lit in np.asarray(sun["lit"])[forbidden]]
    patterns, n = list(dict.fromkeys(of_sample)), sun.sizes["time"]
    members = [np.array([own == pattern for own in of_sample]) for pattern in patterns]
    threshold = sun["lit_threshold"].values
    # assumed noise explains nothing
    sigma = sun["noise"].values * (np.nan if sun.attrs["noise_from"] == ASSUMED_FROM else 1.0)
    chance, turned = np.zeros(len(of_sample)), np.full(len(patterns), np.nan)
    noise = np.full((len(patterns), 3), np.nan)
    if not is_sun and patterns and (sigma > 0).all():
        power, _ = powers(vehicle, telemetry)
        by_noise = noise_alone(vehicle, power[forbidden], sigma, threshold)
        chance = by_noise.probability
        for k, own in enumerate(members):
            together = by_noise.log_probability[own].sum() / np.log(10)
            noise[k] = chance[own].max(), by_noise.pattern_probability[own].max(), together
        if (tilt := turned_sigma(vehicle)).any():
            # the factor between gains and full Sun; that of the brighter samples where the Sun is oblique to all panels
            bright = np.nan_to_num(brightness(vehicle, power, sun["best_B"].values))
            bright = np.maximum(bright, np.quantile(bright, BRIGHT_QUANTILE))[forbidden, None]
            by_turns = noise_alone(vehicle, power[forbidden], sigma, threshold, bright * tilt)
            turned = np.array([by_turns.probability[own].min() for own in members])
    limit = np.inf if could_be_noise is None else could_be_noise
    needed = [
        pattern
        for pattern, own, least in zip(patterns, members, turned, strict=True)
        if (chance[own] < limit).any() and not (could_be_turned and least * n > NOISE_ALONE)
    ]

    def rows(sets: Sequence[Any]) -> np.ndarray:
        members = np.array([[name in panels for name in names] for panels in sets], dtype=bool)
        return members.reshape(-1, len(names))

    about = {
        "largest": "bound on the probability that noise alone made the likeliest sample",
        "largest_of_pattern": "probability that noise shows this pattern, at most",
        "log10_together": "log10 of that bound for all samples together",
        "turned": "bound on the probability that noise and panels turned by their stated sigmas make the least likely sample",
    }
    figures = np.column_stack([noise, turned]).T
    counts = np.array([own.sum() for own in members], dtype=np.int64)
    sets = {
        "allowed_lit": ("allowed_pattern", lit_patterns(vehicle), "lit panels, as possible"),
        "impossible_lit": ("pattern", patterns, "lit panels, as seen and impossible"),
        "lost": (
            "explanation",
            explanations(vehicle, needed),
            "panels whose loss explains all impossible patterns",
        ),
    }
    attrs = provenance("panel_health", sun, **vehicle.said)
    return PanelHealth(
        {
            name: ((dimension, "panel"), rows(panels), {"long_name": long_name})
            for name, (dimension, panels, long_name) in sets.items()
        }
        | {
            "samples": (
                "pattern",
                counts,
                {"units": "1", "long_name": "samples that show the pattern"},
            )
        }
        | {
            name: ("pattern", value, {"units": "1", "long_name": long_name})
            for (name, long_name), value in zip(about.items(), figures, strict=True)
        },
        coords={"panel": names.tolist()},
        attrs=attrs
        | {"noise_sigma": float(np.median(sigma)), "lit_threshold": float(np.median(threshold))},
    )


NOISE, TURNS = "noise alone", "noise and the stated turns of panels"
"""What may make forbidden patterns although no panel is lost."""


def made_by(health: PanelHealth, n: int) -> str:
    """`NOISE` or `TURNS` if that may have made all forbidden patterns that `panel_health` found among `n` samples, else nothing.
    Of noise counts the bound of how probable it is that any so many of them read so."""
    from scipy.special import gammaln

    count = int(health["samples"].sum())
    if count and not health["largest"].isnull().any():
        any_of_them = gammaln(n + 1) - gammaln(count + 1) - gammaln(n - count + 1)
        log10 = float(health["log10_together"].sum()) + any_of_them / np.log(10)
        if log10 > np.log10(NOISE_ALONE):
            return NOISE
    least = health[
        "turned"
    ].values  # turns are the same in all samples: only the least probable counts
    return TURNS if least.size and (least * n > NOISE_ALONE).all() else ""


def explanations(
    vehicle: Vehicle, patterns: list[tuple[str, ...]], size: int | None = None
) -> list[tuple[str, ...]]:
    """The smallest sets of panels that make every given lit pattern possible, several if equally small; or all of a `size`. A set
    explains a pattern if some possible pattern lights all of it and nothing else but panels of the set."""
    possible = observable_patterns(vehicle)
    if not patterns:
        return []
    for count in range(1, len(vehicle.input_names) + 1) if size is None else [size]:
        sets = [
            lost
            for lost in combinations(vehicle.input_names, count)
            if all(
                any(set(p) <= lit and lit - set(p) <= set(lost) for lit in possible)
                for p in patterns
            )
        ]
        if sets:
            return sets
    return []


class NoiseMade(NamedTuple):
    """Whether noise alone may have made each sample's readings; arrays over samples.

    `chi_square` (n): squared distance, in sigma, from the nearest readings that any Sun makes; `probability` (n): upper
    bound on the probability that noise takes readings so far from those of a Sun; `pattern_probability` (n): probability
    that noise shows this lit pattern under the least contradictory Sun; `sun_B` (n, 3): that Sun, times the scale of the
    powers; `log_probability` (n): natural logarithm of `probability`, where that is too small for a float.
    """

    chi_square: np.ndarray
    probability: np.ndarray
    pattern_probability: np.ndarray
    sun_B: np.ndarray
    log_probability: np.ndarray


def noise_alone(
    vehicle: Vehicle,
    power: npt.ArrayLike,
    sigma: npt.ArrayLike,
    lit_threshold: npt.ArrayLike,
    besides: npt.ArrayLike = 0.0,
) -> NoiseMade:
    """How well each sample's readings agree with some Sun of any direction and brightness, panels being whole.

    A lit panel must read what the Sun gives it; a dark one tells only that it got no more than the threshold. With z the
    noise of each panel in sigma, the distance from the true Sun's readings is at most |z|, and that from the nearest Sun's
    is no more: so chi-square with one degree per panel bounds the probability from above.

    Parameters
    ----------
    power : (n, n_panel)
        Readings, in the unit of `sigma` and `lit_threshold`.
    sigma : float or (n_panel,)
        One-sigma Gaussian noise of a reading.
    lit_threshold : float or (n_panel,)
        Readings above it count as lit.
    besides : (n, n_panel) or what broadcasts to it
        One sigma of what else is off in each reading, in that unit: with it, it is not noise alone.
    """
    from scipy.stats import chi2, norm

    readings, _ = powers(vehicle, power)
    n_panel = readings.shape[1]
    sigma = of_panels(vehicle, sigma, np.greater, "sigma must be the positive noise of a reading")
    be = "lit_threshold must be zero or positive"
    threshold = of_panels(vehicle, lit_threshold, np.greater_equal, be)
    response = vehicle.response_in()
    scale = response.largest  # so that the unknown is of the size of the readings
    unit = sigma.min()
    each = np.broadcast_to(np.hypot(sigma / unit, np.asarray(besides) / unit), readings.shape)
    found = [
        _nearest_sun(
            response,
            scale,
            readings[at : at + CHUNK] / unit,
            threshold / unit,
            1 / each[at : at + CHUNK],
        )
        for at in range(0, len(readings), CHUNK)
    ]
    sun = np.concatenate([part[0] for part in found]) if found else np.zeros((0, 3))
    square = np.concatenate([part[1] for part in found]) if found else np.zeros(0)
    mean, _ = response.under(sun, scale)
    lit = readings > threshold
    shown = norm.sf(threshold / unit, mean, each), norm.cdf(threshold / unit, mean, each)
    pattern = np.prod(np.where(lit, *shown), axis=1)
    return NoiseMade(
        square, chi2.sf(square, n_panel), pattern, sun * unit / scale, chi2.logsf(square, n_panel)
    )


def _nearest_sun(
    response: PanelResponse,
    scale: float,
    readings: np.ndarray,
    threshold: np.ndarray,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The Sun (n, 3), direction times brightness, nearest to readings (n, n_panel) in units of the least sigma, and the squared
    distance; a residual counts `weight` (n, n_panel).

    A search runs from each region (inside one the squared distance of flat panels is a convex piece), and the best end is taken.
    """
    cells, _ = response.regions()
    light, _ = response.under(cells, scale)
    bright = np.maximum(readings @ light.T, 0.0) / np.maximum((light**2).sum(axis=1), 1e-300)
    starts = (bright[:, :, None] * cells[None]).reshape(-1, 3)
    each, weights = (np.repeat(values, len(cells), axis=0) for values in (readings, weight))

    def linearise(state: tuple[np.ndarray, ...]) -> Dense:
        sun, seen, counts = state
        mean, slope = response.under(sun, scale)
        lit = seen > threshold
        value = np.where(lit, mean - seen, np.maximum(0.0, mean - threshold))
        active = (mean > 0) & (lit | (mean > threshold))
        return Dense.of(counts * value, (counts * active)[..., None] * slope, np.ones_like(sun))

    def retract(state: tuple[np.ndarray, ...], step: np.ndarray) -> tuple[np.ndarray, ...]:
        return state[0] + step, *state[1:]

    found = least_squares(
        linearise, retract, dense, (starts, each, weights), steps=STEPS, tolerance=ROUNDING
    )
    cost = found.system.cost.reshape(len(readings), -1)
    best = np.argmin(cost, axis=1) + len(cells) * np.arange(len(readings))
    return found.state[0][best], 2 * found.system.cost[best]
