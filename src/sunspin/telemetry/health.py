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

from sunspin.base.errors import InputError, sentence
from sunspin.base.provenance import provenance
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import Dense, dense
from sunspin.telemetry.noise import ASSUMED_FROM, BRIGHT_QUANTILE
from sunspin.telemetry.sun import SunStatus, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import (
    lit_patterns,
    observable_patterns,
    panel_power,
    turned_sigma,
)
from sunspin.vehicle.response.protocol import PanelResponse

STEPS, ROUNDING = 60, 1e-12
"""Steps of the search for the Sun that contradicts the readings least, of which a dozen are usually enough; and the gain, in sigma
squared, at which it ends."""

NOISE_ALONE = 0.01
"""Noise alone does not make forbidden patterns where it would show such readings in so many of a file's samples with a smaller
probability than this; nor do panels turned by their stated sigmas where any of a file's samples is less probable."""

CHUNK = 2000
"""Samples searched at once: each from every cell of the sphere."""


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
            verdicts = map(
                NoiseVerdict, *(self[name].values.tolist() for name in NoiseVerdict._fields)
            )
            known = zip(named_panels(self, "impossible_lit"), verdicts, strict=True)
            return {pattern: verdict for pattern, verdict in known if not np.isnan(verdict.largest)}
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
    patterns = [tuple(names[lit].tolist()) for lit in np.asarray(sun["lit"])[forbidden]]
    counts = {pattern: patterns.count(pattern) for pattern in dict.fromkeys(patterns)}
    threshold, verdicts = float(sun.attrs["lit_threshold"]), {}
    sigma = (
        UNKNOWN if sun.attrs["noise_from"] == ASSUMED_FROM else float(sun.attrs["noise"])
    )  # what is assumed explains nothing
    probability, turned = np.zeros(len(patterns)), {}
    if not is_sun and patterns and np.isfinite(sigma) and sigma > 0:
        power = _values(telemetry)
        made = noise_alone(vehicle, power[forbidden], sigma, threshold)
        probability = made.probability
        verdicts = {pattern: _verdict(made, [p == pattern for p in patterns]) for pattern in counts}
        bright = _brightness(vehicle, power, sun["best_B"].values)[forbidden]
        turned = _turned(vehicle, power[forbidden], bright, sigma, threshold, patterns)
    limit = np.inf if could_be_noise is None else could_be_noise
    n = sun.sizes["time"]
    by_turns = {
        pattern for pattern, least in turned.items() if could_be_turned and _shown(least, n)
    }
    needed = [
        p
        for p, chance in zip(patterns, probability, strict=True)
        if chance < limit and p not in by_turns
    ]
    about = provenance("panel_health", sun, **vehicle.said)
    about |= {"noise_sigma": sigma, "lit_threshold": threshold}
    return _health(
        vehicle, counts, explanations(vehicle, list(dict.fromkeys(needed))), verdicts, turned, about
    )


def _brightness(vehicle: Vehicle, power: np.ndarray, sun_B: np.ndarray) -> np.ndarray:
    """Factor (n) between gains and full Sun: of a sample in which the Sun stands aside of all panels, that of the brighter ones."""
    shape = panel_power(vehicle, sun_B)
    own = np.nan_to_num((power * shape).sum(axis=1) / np.maximum((shape**2).sum(axis=1), 1e-300))
    return np.maximum(own, np.quantile(own, BRIGHT_QUANTILE))


def _turned(
    vehicle: Vehicle,
    power: np.ndarray,
    bright: np.ndarray,
    sigma: float,
    threshold: float,
    patterns: list[tuple[str, ...]],
) -> dict[tuple[str, ...], float]:
    """Of each pattern the least probability that noise and panels turned by their stated sigmas make one of its samples."""
    by_turn = turned_sigma(vehicle)
    if not by_turn.any():
        return {}
    chance = noise_alone(
        vehicle, power, sigma, threshold, bright[:, None] * by_turn
    ).probability.tolist()
    return {
        pattern: min(p for p, own in zip(chance, patterns, strict=True) if own == pattern)
        for pattern in set(patterns)
    }


def _shown(least: float, n: int) -> bool:
    """Whether `n` samples of which the least probable has the probability `least` may be those of turned panels: these are the same
    in all samples, so that samples are not independent and only the smallest counts."""
    return bool(least * n > NOISE_ALONE)


UNKNOWN = float("nan")


def _health(
    vehicle: Vehicle,
    counts: dict[tuple[str, ...], int],
    lost: list[tuple[str, ...]],
    verdicts: dict[tuple[str, ...], NoiseVerdict],
    turned: dict[tuple[str, ...], float],
    about: dict[str, Any],
) -> PanelHealth:
    names = vehicle.input_names

    def rows(sets: Sequence[Any]) -> np.ndarray:
        return np.array([[name in one for name in names] for one in sets], dtype=bool).reshape(
            -1, len(names)
        )

    noise = [verdicts.get(pattern, NoiseVerdict(UNKNOWN, UNKNOWN, UNKNOWN)) for pattern in counts]
    of_noise = (
        "bound on the probability that noise alone made the likeliest sample",
        "probability that noise shows this pattern, at most",
        "log10 of that bound for all samples together",
    )
    least = np.array([turned.get(pattern, UNKNOWN) for pattern in counts], dtype=np.float64)
    said = "bound on the probability that noise and panels turned by their stated sigmas make the least likely sample"
    return PanelHealth(
        {
            "allowed_lit": (
                ("allowed_pattern", "panel"),
                rows(lit_patterns(vehicle)),
                {"long_name": "lit panels, as possible"},
            ),
            "impossible_lit": (
                ("pattern", "panel"),
                rows(list(counts)),
                {"long_name": "lit panels, as seen and impossible"},
            ),
            "samples": ("pattern", np.array(list(counts.values()), dtype=np.int64), {"units": "1"}),
            "lost": (
                ("explanation", "panel"),
                rows(lost),
                {"long_name": "panels whose loss explains all impossible patterns"},
            ),
        }
        | {
            name: (
                "pattern",
                np.array([verdict[k] for verdict in noise]),
                {"units": "1", "long_name": of_noise[k]},
            )
            for k, name in enumerate(NoiseVerdict._fields)
        }
        | {"turned": ("pattern", least, {"units": "1", "long_name": said})},
        coords={"panel": list(names)},
        attrs=about,
    )


NOISE, TURNS = "noise alone", "noise and the stated turns of panels"
"""What may make forbidden patterns although no panel is lost."""


def made_by(health: PanelHealth, n: int) -> str:
    """`NOISE` or `TURNS` if that may have made all forbidden patterns that `panel_health` found among `n` samples, else nothing."""
    if noise_made(health, n):
        return NOISE
    least = health["turned"].values
    return TURNS if least.size and all(_shown(p, n) for p in least) else ""


def noise_made(health: PanelHealth, n: int) -> bool:
    """Whether noise alone may have made all forbidden patterns that `panel_health` found among `n` samples: by the bound of how
    probable it is that any so many of them read so."""
    from scipy.special import gammaln

    count = sum(health["impossible"].values())
    if not count or set(health["noise"]) != set(health["impossible"]):
        return False
    log10 = sum(verdict.log10_together for verdict in health["noise"].values())
    any_of_them = gammaln(n + 1) - gammaln(count + 1) - gammaln(n - count + 1)
    return bool(log10 + any_of_them / np.log(10) > np.log10(NOISE_ALONE))


def _values(telemetry: Any) -> np.ndarray:
    if not isinstance(telemetry, xr.Dataset):
        return np.atleast_2d(np.asarray(telemetry, dtype=np.float64))
    name = "power_W" if "power_W" in telemetry else "current_A"
    return np.asarray(telemetry[name].transpose("time", "panel"), dtype=np.float64)


def explanations(
    vehicle: Vehicle, patterns: list[tuple[str, ...]], size: int | None = None
) -> list[tuple[str, ...]]:
    """The smallest sets of panels that make every given lit pattern possible, several if equally small; or all of a `size`."""
    possible = observable_patterns(vehicle)
    if not patterns:
        return []
    sizes = range(1, len(vehicle.input_names) + 1) if size is None else [size]
    for count in sizes:
        found = [
            lost
            for lost in combinations(vehicle.input_names, count)
            if all(_explained(p, lost, possible) for p in patterns)
        ]
        if found:
            return found
    return []


def _explained(pattern: tuple[str, ...], lost: tuple[str, ...], possible: frozenset) -> bool:
    """Whether some possible pattern lights all of `pattern` and nothing else but lost panels."""
    seen = frozenset(pattern)
    return any(seen <= other and other - seen <= frozenset(lost) for other in possible)


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


class NoiseVerdict(NamedTuple):
    """All samples of one forbidden pattern: the largest `probability` and `pattern_probability` of `NoiseMade` among them,
    and log10 of the product of `probability` over them, as their noise is independent."""

    largest: float
    largest_of_pattern: float
    log10_together: float


def _verdict(made: NoiseMade, member: list[bool]) -> NoiseVerdict:
    together = made.log_probability[member].sum() / np.log(10)
    largest, of_pattern = (
        float(made.probability[member].max()),
        float(made.pattern_probability[member].max()),
    )
    return NoiseVerdict(largest, of_pattern, float(together))


def noise_alone(
    vehicle: Vehicle,
    power: npt.ArrayLike,
    sigma: float,
    lit_threshold: float,
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
    sigma : float
        One-sigma Gaussian noise of a reading.
    lit_threshold : float
        Readings above it count as lit.
    besides : (n, n_panel) or what broadcasts to it
        One sigma of what else is off in each reading, in that unit: with it, it is not noise alone.
    """
    from scipy.stats import chi2, norm

    readings = np.atleast_2d(np.asarray(power, dtype=np.float64))
    vehicle.require_panels()
    n_panel = len(vehicle.inputs)
    if readings.ndim != 2 or readings.shape[1] != n_panel:
        raise InputError(
            sentence(
                f"powers must have one column for each of the {n_panel} panels", got=readings.shape
            )
        )
    if not (np.isfinite(sigma) and sigma > 0):
        raise InputError(sentence("sigma must be the positive noise of a reading", got=sigma))
    if not (np.isfinite(lit_threshold) and lit_threshold >= 0):
        raise InputError(sentence("lit_threshold must be zero or positive", got=lit_threshold))
    response = vehicle.response_in()
    scale = response.largest  # so that the unknown is of the size of the readings
    each = np.broadcast_to(np.hypot(1.0, np.asarray(besides) / sigma), readings.shape)
    found = [
        _nearest_sun(
            response,
            scale,
            readings[at : at + CHUNK] / sigma,
            lit_threshold / sigma,
            1 / each[at : at + CHUNK],
        )
        for at in range(0, len(readings), CHUNK)
    ]
    sun = np.concatenate([part[0] for part in found]) if found else np.zeros((0, 3))
    square = np.concatenate([part[1] for part in found]) if found else np.zeros(0)
    mean, _ = response.under(sun, scale)
    lit = readings > lit_threshold
    shown = norm.sf(lit_threshold / sigma, mean, each), norm.cdf(lit_threshold / sigma, mean, each)
    pattern = np.prod(np.where(lit, *shown), axis=1)
    return NoiseMade(
        square, chi2.sf(square, n_panel), pattern, sun * sigma / scale, chi2.logsf(square, n_panel)
    )


def _nearest_sun(
    response: PanelResponse,
    scale: float,
    readings: np.ndarray,
    threshold: float,
    weight: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """The Sun (n, 3), direction times brightness, nearest to readings (n, n_panel) in sigma, and the squared distance; a residual
    counts `weight` (n, n_panel).

    A search runs from each region (inside one the squared distance of flat panels is a convex piece), and the best end is taken.
    """
    cells, _ = response.regions()
    light, _ = response.under(cells, scale)
    bright = np.maximum(readings @ light.T, 0.0) / np.maximum((light**2).sum(axis=1), 1e-300)
    starts = (bright[:, :, None] * cells[None]).reshape(-1, 3)
    each, weights = (np.repeat(values, len(cells), axis=0) for values in (readings, weight))

    def linearise(state: tuple[np.ndarray, ...]) -> Dense:
        value, jacobian = _distance(response, scale, *state[:2], state[1] > threshold, threshold)
        return Dense.of(state[2] * value, state[2][..., None] * jacobian, np.ones_like(state[0]))

    def retract(state: tuple[np.ndarray, ...], step: np.ndarray) -> tuple[np.ndarray, ...]:
        return state[0] + step, *state[1:]

    found = least_squares(
        linearise, retract, dense, (starts, each, weights), steps=STEPS, tolerance=ROUNDING
    )
    cost = found.system.cost.reshape(len(readings), -1)
    best = np.argmin(cost, axis=1) + len(cells) * np.arange(len(readings))
    return found.state[0][best], 2 * found.system.cost[best]


def _distance(
    response: PanelResponse,
    scale: float,
    sun: np.ndarray,
    readings: np.ndarray,
    lit: np.ndarray,
    threshold: float,
) -> tuple[np.ndarray, np.ndarray]:
    """Residuals (..., n_panel) in sigma of readings under a Sun (..., 3), and their Jacobian (..., n_panel, 3)."""
    mean, slope = response.under(sun, scale)
    value = np.where(lit, mean - readings, np.maximum(0.0, mean - threshold))
    active = (mean > 0) & (lit | (mean > threshold))
    return value, active[..., None] * slope
