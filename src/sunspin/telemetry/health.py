"""Panel health: lit patterns that geometry forbids, which panels' loss would explain them (paper, section 4), and whether
noise, or panels that do not stand quite as drawn, might have made them.
"""

from __future__ import annotations

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.special import gammaln

from sunspin.base.provenance import provenance
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.telemetry.noise import ASSUMED_FROM, BRIGHT_QUANTILE
from sunspin.telemetry.sun import SunStatus, of_panels, powers, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import (
    brightness,
    lit_patterns,
    misalignment_signal_sigma,
    observable_patterns,
)

STEPS, ROUNDING = 60, 1e-12
"""Steps of the search for the Sun that contradicts the readings least, of which a dozen are usually enough; and the gain, in sigma
squared, at which it ends."""

NOISE_ALONE = 0.01
"""Noise alone does not make forbidden patterns where it would show such readings in so many of a file's samples with a smaller
probability than this; nor do panels turned by their stated sigmas where any of a file's samples is less probable."""

CHUNK = 2000
"""Samples searched at once: each from every cell of the sphere."""

NOISE, TURNS = "noise alone", "noise and the stated turns of panels"
"""What may make forbidden patterns although no panel is lost."""


class NoiseVerdict(NamedTuple):
    """All samples of one forbidden pattern: the largest `probability` of `NoiseMade` among them, and log10 of the product of
    these probabilities, as the samples' noise is independent."""

    largest: float
    log10_together: float


class PanelHealth(xr.Dataset):
    """A Dataset that also answers to what :func:`panel_health` is asked for by name: ``allowed``, ``impossible``, ``explanations``
    and ``noise``, as plain Python objects. Read back from a file it is a Dataset without these; `named_panels` makes them."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        sets = {"allowed": "allowed_lit", "explanations": "lost"}
        if key in sets:
            return named_panels(self, sets[key])
        if key not in ("impossible", "noise"):
            return super().__getitem__(key)
        patterns = named_panels(self, "impossible_lit")
        if key == "impossible":
            return dict(zip(patterns, self["samples"].values.tolist(), strict=True))
        figures = np.column_stack([self[name].values for name in NoiseVerdict._fields]).tolist()
        verdicts = zip(patterns, figures, strict=True)
        return {pattern: NoiseVerdict(*f) for pattern, f in verdicts if not np.isnan(f[0])}


def named_panels(health: xr.Dataset, name: str) -> list[tuple[str, ...]]:
    """Sets of panels, a tuple of names each, of a variable (n, panel) of true and false."""
    panels = health["panel"].values
    return [tuple(panels[row].tolist()) for row in health[name].values.astype(bool)]


def panel_health(vehicle: Vehicle, telemetry: Any, **options: Any) -> PanelHealth:
    """Which observed lit patterns the Sun alone cannot make, and the smallest sets of panels whose loss explains all.

    A pattern is explained by a set of panels if adding some of them to the lit ones gives a possible pattern: those were in
    the Sun and gave nothing, being shadowed or dead (paper, section 4). A pattern that panels turned by the sigmas which the
    vehicle's file states of their normals may show needs no explanation.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, (n, n_panel) powers, or Dataset of `sun_directions` (which holds no powers, so
        that nothing can be said of noise)
    **options
        `noise` and `lit_threshold`, as for `sun_directions`.

    Returns
    -------
    xarray.Dataset
        `allowed_lit (allowed_pattern, panel)`: the lit patterns that geometry allows, for directions in no panel's plane;
        `impossible_lit (pattern, panel)` with `samples (pattern)`, their number; `lost (explanation, panel)`: the smallest sets
        of panels, none where nothing needs explaining or nothing explains it; `largest` and `log10_together (pattern)` as in
        `NoiseVerdict`, NaN without powers or without a noise figure; `turned (pattern)`, a bound on the probability that noise
        and the stated turns of panels make its least likely sample, NaN where no turns are stated either. As returned it also has
        ``["allowed"]`` (tuples of names), ``["impossible"]`` ({pattern: number of samples}), ``["explanations"]`` (tuples) and
        ``["noise"]`` ({pattern: `NoiseVerdict`}).
    """
    is_sun = isinstance(telemetry, xr.Dataset) and "lit" in telemetry
    sun = telemetry if is_sun else sun_directions(vehicle, telemetry, **options)
    forbidden = np.flatnonzero(np.asarray(sun["status"]) == SunStatus.IMPOSSIBLE)
    names = np.array(vehicle.input_names)
    of_sample = [tuple(names[lit].tolist()) for lit in np.asarray(sun["lit"])[forbidden]]
    patterns = list(dict.fromkeys(of_sample))
    members = [np.array([own == pattern for own in of_sample]) for pattern in patterns]
    threshold = sun["lit_threshold"].values
    # assumed noise explains nothing
    sigma = sun["noise"].values * (np.nan if sun.attrs["noise_from"] == ASSUMED_FROM else 1.0)
    largest, together, turned = np.full((3, len(patterns)), np.nan)
    if not is_sun and patterns and (sigma > 0).all():
        power, _ = powers(vehicle, telemetry)
        log_chance = noise_alone(vehicle, power[forbidden], sigma, threshold).log_probability
        largest = np.array([np.exp(log_chance[own].max()) for own in members])
        together = np.array([log_chance[own].sum() / np.log(10) for own in members])
        if (tilt := misalignment_signal_sigma(vehicle)).any():
            # the factor between gains and full Sun; that of the brighter samples where the Sun is oblique to all panels
            bright = np.nan_to_num(brightness(vehicle, power, sun["best_B"].values))
            bright = np.maximum(bright, np.quantile(bright, BRIGHT_QUANTILE))[forbidden, None]
            by_turns = noise_alone(vehicle, power[forbidden], sigma, threshold, bright * tilt)
            turned = np.array([by_turns.probability[own].min() for own in members])
    excused = turned * sun.sizes["time"] > NOISE_ALONE
    needed = [pattern for pattern, turns in zip(patterns, excused, strict=True) if not turns]
    sets = {
        "allowed_lit": ("allowed_pattern", lit_patterns(vehicle), "lit panels, as possible"),
        "impossible_lit": ("pattern", patterns, "lit panels, as seen and impossible"),
        "lost": (
            "explanation",
            explanations(vehicle, needed),
            "panels whose loss explains all impossible patterns",
        ),
    }
    figures = {
        "samples": (
            np.array([own.sum() for own in members], dtype=np.int64),
            "samples that show the pattern",
        ),
        "largest": (largest, "bound on the probability that noise alone made the likeliest sample"),
        "log10_together": (together, "log10 of that bound for all samples together"),
        "turned": (
            turned,
            "bound on the probability that noise and panels turned by their stated sigmas make the least likely sample",
        ),
    }
    health = PanelHealth(
        coords={"panel": names.tolist()},
        attrs=provenance("panel_health", sun, **vehicle.result_attributes)
        | {"noise_sigma": float(np.median(sigma)), "lit_threshold": float(np.median(threshold))},
    )
    for key, (dimension, panels, long_name) in sets.items():
        rows = np.array([np.isin(names, list(each)) for each in panels]).reshape(-1, len(names))
        health[key] = (dimension, "panel"), rows.astype(bool), {"long_name": long_name}
    for key, (values, long_name) in figures.items():
        health[key] = "pattern", values, {"units": "1", "long_name": long_name}
    return health


def made_by(health: PanelHealth, n: int) -> str:
    """`NOISE` or `TURNS` if that may have made all forbidden patterns of `panel_health` among `n` samples, else nothing.
    Of noise counts the bound of how probable it is that any so many of them read so."""
    count = int(health["samples"].sum())
    if count and not health["largest"].isnull().any():
        any_of_them = gammaln(n + 1) - gammaln(count + 1) - gammaln(n - count + 1)
        log10 = float(health["log10_together"].sum()) + any_of_them / np.log(10)
        if log10 > np.log10(NOISE_ALONE):
            return NOISE
    # turns are the same in all samples: only the least probable counts
    least = health["turned"].values
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

    `chi_square` (n): squared distance, in sigma, from the nearest readings that any Sun makes; `log_probability` (n): natural
    logarithm of an upper bound on the probability that noise takes readings so far from those of a Sun.
    """

    chi_square: np.ndarray
    log_probability: np.ndarray

    @property
    def probability(self) -> np.ndarray:
        """That bound (n) itself; 0 where it is too small for a float."""
        return np.exp(self.log_probability)


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

    The search for the nearest Sun, direction times brightness, runs from each region of the sphere (inside one the squared
    distance of flat panels is a convex piece), and the best end is taken.

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
    from scipy.stats import chi2

    readings, _ = powers(vehicle, power)
    sigma = of_panels(vehicle, sigma, np.greater, "sigma must be the positive noise of a reading")
    be = "lit_threshold must be zero or positive"
    threshold = of_panels(vehicle, lit_threshold, np.greater_equal, be)
    unit, response = sigma.min(), vehicle.response_in()
    readings, threshold = readings / unit, threshold / unit
    total = np.hypot(sigma / unit, np.asarray(besides) / unit)
    weight = 1 / np.broadcast_to(total, readings.shape)
    scale = response.largest_power  # so that the unknown is of the size of the readings
    cells, _ = response.regions()
    light, _ = response.light_power(cells, scale)

    def linearise(state: tuple[np.ndarray, ...]) -> DenseSystem:
        sun, seen, counts = state
        mean, slope = response.light_power(sun, scale)
        lit = seen > threshold
        value = np.where(lit, mean - seen, np.maximum(0.0, mean - threshold))
        active = (mean > 0) & (lit | (mean > threshold))
        return DenseSystem.from_residuals(
            counts * value, (counts * active)[..., None] * slope, np.ones_like(sun)
        )

    def retract(state: tuple[np.ndarray, ...], step: np.ndarray) -> tuple[np.ndarray, ...]:
        return state[0] + step, *state[1:]

    square = np.zeros(len(readings))
    for start in range(0, len(readings), CHUNK):
        some = slice(start, start + CHUNK)
        bright = np.maximum(readings[some] @ light.T, 0.0)
        bright /= np.maximum((light**2).sum(axis=1), 1e-300)
        starts = (bright[:, :, None] * cells).reshape(-1, 3)
        seen, counts = (np.repeat(each[some], len(cells), axis=0) for each in (readings, weight))
        ends = least_squares(
            linearise, retract, solve_dense, (starts, seen, counts), steps=STEPS, tolerance=ROUNDING
        )
        square[some] = 2 * ends.system.cost.reshape(-1, len(cells)).min(axis=1)
    return NoiseMade(square, chi2.logsf(square, readings.shape[1]))
