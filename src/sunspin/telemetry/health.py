"""Panel health: illumination patterns that geometry forbids, and what explains them (paper, section 4).

Explanations are lost panels, noise, and panels that are slightly misaligned.
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
from sunspin.telemetry.sun import SunStatus, panel_readings, per_panel, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import (
    brightness,
    lit_patterns,
    misalignment_signal_sigma,
    observable_patterns,
)

STEPS, ROUNDING = 60, 1e-12
"""Largest number of iterations of the search for the best-fitting Sun (a dozen are usually enough), and the decrease of chi-square
at which it ends."""

NOISE_ALONE = 0.01
"""Smallest probability of an accepted explanation. For noise alone it is the probability that any so many of a file's samples show
impossible patterns; for misaligned panels that of the least probable sample, times the number of samples."""

CHUNK = 2000
"""Samples searched at once; the search of each starts from every cell of the sphere."""

NOISE, TURNS = "noise alone", "noise and the stated turns of panels"
"""Explanations of impossible patterns without a lost panel."""


class NoiseVerdict(NamedTuple):
    """Probability that noise made the samples of one impossible pattern.

    `largest`: largest `probability` of `NoiseFit` among the samples; `log10_together`: log10 of the product of these probabilities,
    because the noise of the samples is independent.
    """

    largest: float
    log10_together: float


class PanelHealth(xr.Dataset):
    """Dataset of :func:`panel_health` with four additional keys, whose values are plain Python objects.

    The keys are ``allowed``, ``impossible``, ``explanations`` and ``noise``. A Dataset read back from a file lacks these;
    `named_panels` makes the tuples of names from its variables.
    """

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        """Return the value of one of the additional keys, or the variable or coordinate `key` of the Dataset."""
        variable_of_key = {"allowed": "allowed_lit", "explanations": "lost"}
        if key in variable_of_key:
            return named_panels(self, variable_of_key[key])
        if key not in ("impossible", "noise"):
            return super().__getitem__(key)
        patterns = named_panels(self, "impossible_lit")
        if key == "impossible":
            return dict(zip(patterns, self["samples"].values.tolist(), strict=True))
        rows = zip(*(self[name].values.tolist() for name in NoiseVerdict._fields), strict=True)
        verdicts = dict(zip(patterns, (NoiseVerdict(*row) for row in rows), strict=True))
        # NaN: the probability of noise was not computed
        return {pattern: v for pattern, v in verdicts.items() if not np.isnan(v.largest)}


def named_panels(health: xr.Dataset, name: str) -> list[tuple[str, ...]]:
    """Return the sets of panels that the rows of the boolean variable `name` (n, panel) mark, each as a tuple of names."""
    panels = health["panel"].values
    return [tuple(panels[row].tolist()) for row in health[name].values.astype(bool)]


def panel_health(vehicle: Vehicle, telemetry: Any, **options: Any) -> PanelHealth:
    """Find the observed illumination patterns that the Sun alone cannot make, and the panels whose loss explains them.

    A set of panels explains a pattern if the lit panels and some panels of the set form a possible pattern. These panels were in
    the Sun and gave nothing, because they were shadowed or dead (paper, section 4). A pattern that noise and the misalignments
    stated in the vehicle file can make needs no explanation.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, (n, n_panel) powers, or Dataset of `sun_directions`
        The latter has no powers, so that no probabilities are computed.
    **options
        `noise`, `lit_threshold`, `wrong_unit` and `quality`, as for `sun_directions`; not used with a Dataset of it.

    Returns
    -------
    xarray.Dataset
        `allowed_lit (allowed_pattern, panel)`: patterns of the Sun directions that graze no panel (`lit_patterns`).
        `impossible_lit (pattern, panel)`: impossible patterns, with `samples (pattern)`, their number of samples.
        `lost (explanation, panel)`: the smallest sets of panels whose loss explains all impossible patterns but those that noise
        and the stated misalignments can make; no rows if nothing is left to explain, or no set explains it.
        `largest` and `log10_together (pattern)`: as in `NoiseVerdict`; NaN without powers, or if the noise is only assumed.
        `turned (pattern)`: upper bound on the probability that noise and the stated misalignments together make the least probable
        sample of the pattern; NaN also if no misalignments are stated.

        The returned object also has ``["allowed"]`` (tuples of names), ``["impossible"]`` ({pattern: number of samples}),
        ``["explanations"]`` (tuples of names) and ``["noise"]`` ({pattern: `NoiseVerdict`}).
    """
    is_directions = isinstance(telemetry, xr.Dataset) and "lit" in telemetry
    directions = telemetry if is_directions else sun_directions(vehicle, telemetry, **options)
    impossible = np.flatnonzero(np.asarray(directions["status"]) == SunStatus.IMPOSSIBLE)
    names = np.array(vehicle.input_names)
    sample_patterns = [
        tuple(names[lit].tolist()) for lit in np.asarray(directions["lit"])[impossible]
    ]
    patterns = list(dict.fromkeys(sample_patterns))
    # for each pattern, which of the impossible samples show it
    shows = [np.array([shown == pattern for shown in sample_patterns]) for pattern in patterns]
    threshold = directions["lit_threshold"].values
    # a noise that is only assumed explains nothing
    sigma = directions["noise"].values * (
        np.nan if directions.attrs["noise_from"] == ASSUMED_FROM else 1.0
    )
    largest, together, turned = np.full((3, len(patterns)), np.nan)
    if not is_directions and patterns and (sigma > 0).all():
        power = panel_readings(vehicle, telemetry)
        log_chance = noise_alone(vehicle, power[impossible], sigma, threshold).log_probability
        largest = np.array([np.exp(log_chance[samples].max()) for samples in shows])
        together = np.array([log_chance[samples].sum() / np.log(10) for samples in shows])
        if (tilt := misalignment_signal_sigma(vehicle)).any():
            # A misalignment changes a reading in proportion to the brightness. That of a sample with the Sun oblique to all panels
            # is underestimated, so no sample is taken to be darker than the bright ones of the file (BRIGHT_QUANTILE).
            bright = np.nan_to_num(brightness(vehicle, power, directions["best_B"].values))
            bright = np.maximum(bright, np.quantile(bright, BRIGHT_QUANTILE))[impossible, None]
            tilted = noise_alone(vehicle, power[impossible], sigma, threshold, bright * tilt)
            turned = np.array([tilted.probability[samples].min() for samples in shows])
    # That any of the n samples of the file is so improbable has at most n times the probability for one sample. A comparison with
    # NaN, a probability that was not computed, is false and excuses no pattern.
    by_misalignment = turned * directions.sizes["time"] > NOISE_ALONE
    unexplained = [
        pattern for pattern, excused in zip(patterns, by_misalignment, strict=True) if not excused
    ]
    sets = {
        "allowed_lit": ("allowed_pattern", lit_patterns(vehicle), "lit panels, as possible"),
        "impossible_lit": ("pattern", patterns, "lit panels, as seen and impossible"),
        "lost": (
            "explanation",
            find_explanations(vehicle, unexplained),
            "panels whose loss explains all impossible patterns",
        ),
    }
    figures = {
        "samples": (
            np.array([samples.sum() for samples in shows], dtype=np.int64),
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
        attrs=provenance("panel_health", directions, **vehicle.result_attributes)
        | {"noise_sigma": float(np.median(sigma)), "lit_threshold": float(np.median(threshold))},
    )
    for key, (dimension, panel_sets, long_name) in sets.items():
        # the reshape gives an empty list of sets its second dimension
        rows = np.array([np.isin(names, list(panels)) for panels in panel_sets])
        rows = rows.reshape(-1, len(names))
        health[key] = (dimension, "panel"), rows.astype(bool), {"long_name": long_name}
    for key, (values, long_name) in figures.items():
        health[key] = "pattern", values, {"units": "1", "long_name": long_name}
    return health


def find_cause_without_loss(health: PanelHealth, n: int) -> str:
    """Return `NOISE` or `TURNS` if it may have made all impossible patterns of `panel_health` in `n` samples, else an empty text.

    For noise, the product of the samples' probabilities is multiplied by the number of ways to choose so many of `n` samples.
    """
    count = int(health["samples"].sum())
    if count and not health["largest"].isnull().any():  # else the noise is not known
        log_ways = gammaln(n + 1) - gammaln(count + 1) - gammaln(n - count + 1)
        log10 = float(health["log10_together"].sum()) + log_ways / np.log(10)
        if log10 > np.log10(NOISE_ALONE):
            return NOISE
    # misalignments are the same in all samples, so only the least probable sample of each pattern counts
    least_probable = health["turned"].values
    by_misalignment = least_probable.size > 0 and (least_probable * n > NOISE_ALONE).all()
    return TURNS if by_misalignment else ""


def find_explanations(
    vehicle: Vehicle, patterns: list[tuple[str, ...]], size: int | None = None
) -> list[tuple[str, ...]]:
    """Return the smallest sets of panels whose loss explains all impossible patterns; all sets of that size, if several do.

    A set explains a pattern if the lit panels and some panels of the set form a possible pattern.

    Parameters
    ----------
    patterns : list of tuple
        Names of the lit panels of each impossible pattern.
    size : int, optional
        Search only sets of this number of panels.
    """
    possible = observable_patterns(vehicle)
    if not patterns:
        return []

    def explains(lost: tuple[str, ...], pattern: tuple[str, ...]) -> bool:
        """Return whether some possible pattern contains all panels of this one, and otherwise only lost panels."""
        return any(set(pattern) <= lit and lit - set(pattern) <= set(lost) for lit in possible)

    for count in range(1, len(vehicle.input_names) + 1) if size is None else [size]:
        explanations = [
            lost
            for lost in combinations(vehicle.input_names, count)
            if all(explains(lost, pattern) for pattern in patterns)
        ]
        if explanations:
            return explanations
    return []


class NoiseFit(NamedTuple):
    """Distance of each sample's readings (n) from those of the best-fitting Sun.

    `chi_square` (n): sum of squares in units of sigma; `log_probability` (n): natural logarithm of an upper bound on the
    probability that noise makes a chi-square at least as large.
    """

    chi_square: np.ndarray
    log_probability: np.ndarray

    @property
    def probability(self) -> np.ndarray:
        """Upper bound (n) on the probability; 0 if it is too small for a float."""
        return np.exp(self.log_probability)


def noise_alone(
    vehicle: Vehicle,
    power: npt.ArrayLike,
    sigma: npt.ArrayLike,
    lit_threshold: npt.ArrayLike,
    extra_sigma: npt.ArrayLike = 0.0,
) -> NoiseFit:
    """Fit a Sun of any direction and brightness to the readings of each sample, if no panel is lost.

    A lit panel must read what the Sun gives it; a dark panel only constrains the light to at most the threshold. Let z be the noise
    of each panel in sigma. The distance of the readings from those of the true Sun is at most |z|, and from those of the
    best-fitting Sun it is not larger. The chi-square distribution with one degree of freedom for each panel therefore gives an
    upper bound on the probability.

    The unknown is a vector, the direction times the brightness. The search starts in each cell of the sphere in which the same
    panels are lit, where the squared distance of flat panels is convex. The best result is taken.

    Parameters
    ----------
    power : (n, n_panel)
        Readings, in the unit of `sigma` and `lit_threshold`.
    sigma : float or (n_panel,)
        One-sigma Gaussian noise of a reading.
    lit_threshold : float or (n_panel,)
        Readings above it count as lit.
    extra_sigma : (n, n_panel) or broadcastable to it
        One sigma of another error of each reading, in that unit, for example from misaligned panels.
    """
    from scipy.stats import chi2

    readings = panel_readings(vehicle, power)
    sigma = per_panel(vehicle, sigma, np.greater, "sigma must be the positive noise of a reading")
    message = "lit_threshold must be zero or positive"
    threshold = per_panel(vehicle, lit_threshold, np.greater_equal, message)
    # from here on in units of the smallest noise, so that no square overflows
    unit, response = sigma.min(), vehicle.response_in()
    readings, threshold = readings / unit, threshold / unit
    total_sigma = np.hypot(sigma / unit, np.asarray(extra_sigma) / unit)
    weight = 1 / np.broadcast_to(total_sigma, readings.shape)
    scale = response.largest_power  # then the unknown vector is of the size of the readings
    cells, _ = response.regions()  # a direction (n_cell, 3) in each cell of the sphere
    light, _ = response.light_power(
        cells, scale
    )  # readings (n_cell, n_panel) at a brightness of one

    def linearise(state: tuple[np.ndarray, ...]) -> DenseSystem:
        """Return the weighted residuals of the panels and their derivatives with respect to the Sun vector.

        `state`: Sun vectors (m, 3), direction times brightness; readings and weights 1 / sigma (m, n_panel) of each.
        """
        sun, measured, weights = state
        model, slope = response.light_power(sun, scale)
        lit = measured > threshold
        # of a lit panel the model minus the reading, of a dark one what the model has above the threshold
        residual = np.where(lit, model - measured, np.maximum(0.0, model - threshold))
        # elsewhere the residual does not change with the Sun
        active = (model > 0) & (lit | (model > threshold))
        jacobian = (weights * active)[..., None] * slope
        return DenseSystem.from_residuals(weights * residual, jacobian, np.ones_like(sun))

    def retract(state: tuple[np.ndarray, ...], step: np.ndarray) -> tuple[np.ndarray, ...]:
        """Return the state with the Sun vectors moved by `step` (m, 3); readings and weights stay."""
        return state[0] + step, *state[1:]

    chi_square = np.zeros(len(readings))
    for start in range(0, len(readings), CHUNK):
        chunk = slice(start, start + CHUNK)
        # starts: a direction in each cell, with the brightness (sample, cell) that fits best there
        bright = np.maximum(readings[chunk] @ light.T, 0.0)
        bright /= np.maximum((light**2).sum(axis=1), 1e-300)
        suns = (bright[:, :, None] * cells).reshape(-1, 3)
        measured, weights = (np.repeat(each[chunk], len(cells), 0) for each in (readings, weight))
        state = suns, measured, weights
        solution = least_squares(
            linearise, retract, solve_dense, state, steps=STEPS, tolerance=ROUNDING
        )
        # the cost is half the chi-square; the best of the cells counts
        chi_square[chunk] = 2 * solution.system.cost.reshape(-1, len(cells)).min(axis=1)
    return NoiseFit(chi_square, chi2.logsf(chi_square, readings.shape[1]))
