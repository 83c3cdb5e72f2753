"""Directions of the Sun from the panels' powers: Delta, height of the Sun, lit patterns (paper, sections 2.1 and 4).

The directions (eq. 1 and 2) are those of :func:`sunspin.sun_directions`. Here a file's own noise is estimated
(`with_own_noise`), and what the paper states of Delta, n_z, sampling and lit panels is computed for each phase of the landing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.special import ndtri
from scipy.stats import chi2

from sunspin.output.figures import ABOVE, COLOURS, ON_PAPER, titled
from sunspin.philae.rebound import case_seconds, with_telemetry
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.telemetry.health import PanelHealth, explanations, noise_alone, panel_health
from sunspin.telemetry.noise import HALF_NORMAL_MEDIAN
from sunspin.telemetry.sun import SunStatus, is_reconstructed, signals, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.timeline import utc_seconds

SHADOWED_PHASES = ("deployment", "settling", "rest")
"""Phases in which parts of the lander or the ground shadow the panels: the paper leaves them out of its statistics of Delta."""

BRIGHT = 0.2
"""A panel that reads more than this part of the file's largest reading is in the Sun for certain."""

LEAST = 8
"""Readings needed for a sigma; it is then good to a third."""

DARK_SIGMAS = 4.0
"""A panel counts as lit above this many sigma of a dark one's reading: of a thousand dark readings none is taken for lit."""

MOST_OF_LARGEST = 0.1
"""The lit threshold is at most this part of the largest reading: what reads more on panels that should be dark is no noise, and
has to show as a lit pattern that no Sun makes."""

ROUGH_SIGMAS = 6.0
"""What lies beyond this many rough sigma is not noise: a reflection, a shadow, a wrong column."""


def samples_by_phase(case: Case, data: xr.Dataset) -> dict[str, np.ndarray]:
    """Name of each phase of the case's timeline -> which samples (n) lie in it."""
    timeline = case.require_timeline()
    time = data["time"].values - utc_seconds(timeline.epoch_utc, data.attrs["epoch_utc"])
    return {p.name: (time >= p.begin_s) & (time < p.end_s) for p in timeline.phases}


def whole_panels(case: Case, data: xr.Dataset) -> np.ndarray:
    """Which samples (n) lie outside the phases in which something shadows the panels."""
    by_phase = samples_by_phase(case, data)
    return ~np.any([by_phase[name] for name in SHADOWED_PHASES if name in by_phase], axis=0)


@dataclass(frozen=True)
class ReadingNoise:
    """`lit`: one sigma of a lit panel's reading; `dark`: of a dark one's; `lit_threshold`; all in the unit of the readings.

    `told`: in words, where they come from.
    """

    lit: float
    dark: float
    lit_threshold: float
    told: str


def with_own_noise(case: Case) -> tuple[Case, ReadingNoise]:
    """The case with noise and lit threshold of its own telemetry in its vehicle, so that every part uses them.

    So telemetry noisier than the synthetic one is not read with the latter's figures: noise on dark panels would light them, in
    patterns that the Sun cannot make. The vehicle file's figures stand in where the telemetry holds too few samples; a value set
    for this run is kept. Noises of single panels keep their stated ratio.
    """
    vehicle, form, power = case.vehicle, case.vehicle.telemetry, signals(case.telemetry)
    stated = vehicle.input_noise
    usual = 1.0 if stated is None else float(np.median(stated))
    ratio = 1.0 if stated is None else float(np.sqrt(np.mean((stated / usual) ** 2)))
    unit = vehicle.gain_unit or ("W" if form.quantity == "power_W" else "A")
    dark, n_dark = dark_sigma(vehicle, power)
    most = MOST_OF_LARGEST * float(np.nan_to_num(power).max(initial=0.0))
    threshold = max(form.lit_threshold or 0.0, _rounded(min(DARK_SIGMAS * dark, most)))
    # of L lit panels L - 3 are redundant, scale and direction being fitted: what the misfit leaves is their noise
    sun = sun_directions(vehicle, case.telemetry, lit_threshold=threshold)
    checked = whole_panels(case, case.telemetry) & (sun["status"].values == SunStatus.OK)
    n_lit = int(checked.sum())
    if n_lit >= LEAST:
        freedom = sun["n_lit"].values[checked] - 3
        size = np.linalg.norm(np.nan_to_num(power[checked]), axis=1)
        misfit = sun["delta"].values[checked] * size
        rough = float(np.median(misfit / np.sqrt(chi2.ppf(0.5, freedom))))
        sound = misfit < ROUGH_SIGMAS * rough * np.sqrt(freedom)
        lit = _rounded(float(np.sqrt((misfit[sound] ** 2).sum() / freedom[sound].sum()) / ratio))
        text = f"from the misfit of {n_lit} samples with more than three lit panels"
    else:
        lit = 0.0 if stated is None else usual
        text = "the vehicle file's: too few samples to tell"
    text = f"noise of a lit panel {lit:g} {unit}, {text}; dark panels read " + (
        f"0 +- {dark:.2g} {unit} ({n_dark} readings), lit above {threshold:g} {unit}"
        if dark > 0
        else f"zero, lit above {threshold:g} {unit}"
    )
    changed = {change.key for change in vehicle.changes}
    if "telemetry.noise" in changed and form.noise is not None:
        lit = form.noise
        text += f"; noise set to {lit:g} for this run"
    if "telemetry.lit_threshold" in changed and form.lit_threshold is not None:
        threshold = form.lit_threshold
        text += f"; lit threshold set to {threshold:g} for this run"
    form = replace(form, noise=lit * ((form.noise or usual) / usual), lit_threshold=threshold)
    panels = tuple(replace(x, noise=x.noise and lit * (x.noise / usual)) for x in vehicle.panels)
    copy = replace(case, vehicle=replace(vehicle, telemetry=form, panels=panels))
    return with_telemetry(copy, case.telemetry), ReadingNoise(lit, dark, threshold, text)


def _rounded(value: float) -> float:
    """To three digits, so that no machine's last bit changes a file's identity."""
    return float(f"{value:.3g}")


def dark_sigma(vehicle: Vehicle, power: np.ndarray) -> tuple[float, int]:
    """One sigma of a dark panel's reading (zero where they read exactly zero or less), and from how many readings.

    Dark for certain is a panel that geometry never lights together with one that is bright.
    """
    together = np.zeros((len(vehicle.panels),) * 2, dtype=bool)
    for pattern in lit_patterns(vehicle):
        lit = np.array([name in pattern for name in vehicle.panel_names])
        together |= np.outer(lit, lit)
    known = np.where(np.isfinite(power), power, 0.0)
    bright = known > BRIGHT * known.max(initial=0.0)
    dark = (bright.astype(int) @ (~together).astype(int) > 0) & ~bright & np.isfinite(power)
    # half of the noise, also where negative readings were cut to zero
    above = known[dark & (known > 0)]
    if above.size < LEAST:
        return 0.0, int(dark.sum())
    rough = float(np.median(above)) / HALF_NORMAL_MEDIAN
    sigma = float(np.median(above[above < ROUGH_SIGMAS * rough])) / HALF_NORMAL_MEDIAN
    return sigma, int(dark.sum())


@dataclass(frozen=True)
class Phases:
    """Sun directions and lit panels of a whole landing.

    Attributes
    ----------
    sun : Dataset of `sun_directions`
    health : as returned by `panel_health`
    phases : name -> which samples (n_time) lie in it, for every phase that has samples
    log10_probability : (n_time,) log10 of the bound on the probability that noise alone made a sample, NaN unless its pattern
        is impossible
    """

    case: Case
    sun: xr.Dataset
    health: PanelHealth
    phases: dict[str, np.ndarray]
    log10_probability: np.ndarray

    @property
    def impossible(self) -> np.ndarray:
        """Which samples (n_time) have a lit pattern that no Sun makes."""
        return self.sun["status"].values == SunStatus.IMPOSSIBLE

    @property
    def twin(self) -> str:
        """What notes begin with: whether the telemetry is synthetic."""
        return "synthetic telemetry; " if self.sun.attrs.get("synthetic") else ""


def compute(case: Case) -> Phases:
    """Directions, health of the panels, and phases of the case's telemetry."""
    vehicle, data = case.vehicle, case.telemetry
    sun, health = sun_directions(vehicle, data), panel_health(vehicle, data)
    log10 = np.full(sun.sizes["time"], np.nan)
    phases = {name: own for name, own in samples_by_phase(case, sun).items() if own.any()}
    result = Phases(case, sun, health, phases, log10)
    if health["noise"]:
        power = signals(data)[result.impossible]
        by_noise = noise_alone(vehicle, power, sun["noise"].values, sun["lit_threshold"].values)
        log10[result.impossible] = by_noise.log_probability / np.log(10)
    return result


def rows(result: Phases) -> list[Row]:
    """Figures of sections 2.1, 3.1 and 4 on the telemetry with ours."""
    return [*_delta_rows(result), *_pattern_rows(result), *_sampling_rows(result)]


def _delta_rows(r: Phases) -> list[Row]:
    """Delta outside the shadowed phases and in them, n_z before the legs unfolded."""
    row_of, result = partial(row, r.case), []
    status, delta, n_lit = (r.sun[name].values for name in ("status", "delta", "n_lit"))
    kept = is_reconstructed(status) & whole_panels(r.case, r.sun)
    if kept.any():
        checked = delta[kept & (n_lit > 3)]
        low = high = np.nan
        judged: dict[str, Any] = {}
        if checked.size:
            # 5 and 95 % of the largest of as many absolute values of a Gaussian with this mean
            sigma = float(checked.mean()) * np.sqrt(np.pi / 2)
            ends = np.array([0.05, 0.95]) ** (1 / checked.size)
            low, high = (sigma * ndtri((1 + ends) / 2)).tolist()
            inside = bool(low <= r.case.published["delta_max"].value <= high)
            judged = {"tolerance": high - low, "agrees": inside, "low": low, "high": high}
        directions, mean, largest = int(kept.sum()), delta[kept].mean(), delta[kept].max()
        origin = "the telemetry is synthetic: its noise was chosen for this figure; "
        result = [
            row_of(
                "delta_mean",
                float(mean),
                sigma=float(delta[kept].std() / np.sqrt(directions)),
                chosen=origin if r.twin else "",
                directions=directions,
                of_three=directions - checked.size,
            ),
            row_of(
                "delta_max", float(largest), checked=checked.size, least=low, most=high, **judged
            ),
        ]
    # a direction and a scale fit any two panels: with three an impossible pattern leaves a misfit
    checked = (status == SunStatus.OK) | (r.impossible & (n_lit >= 3))
    by_phase = {name: delta[own & checked] for name, own in r.phases.items()}
    by_phase = {name: values for name, values in by_phase.items() if values.size}
    shadowed = ("deployment", "rest")  # of which the paper says that Delta is large
    large = np.concatenate([[], *(by_phase[name] for name in shadowed if name in by_phase)])
    least, most = r.case.published["delta_shadowed"].value
    inside = float(np.mean((large >= least) & (large <= most))) if large.size else 0.0
    each, others = [], []
    for name, d in by_phase.items():
        if name in shadowed:
            each.append(f"{name} {d.min():.3f} to {d.max():.3f} ({d.size})")
        else:
            others.append(f"{name} mean {d.mean():.4f}, largest {d.max():.3f} ({d.size})")
    result.append(
        row_of(
            "delta_shadowed",
            [float(large.min()), float(large.max())] if large.size else None,
            published=[least, most],
            agrees=inside >= 0.9,
            twin=r.twin,
            inside=inside,
            each="; ".join(each).replace("_", " "),
            others="; ".join(others).replace("_", " "),
        )
    )
    folded = r.phases.get("deployment", np.zeros(len(status), dtype=bool))
    z = r.sun["sun_B"].values[folded & is_reconstructed(status), 2]
    if z.size:
        row_of = partial(row_of, z=z, least=z.min(), most=z.max())
        result.append(row_of("nz_folded", float(z.mean()), twin=r.twin))
    return result


def _pattern_rows(r: Phases) -> list[Row]:
    """Section 4: patterns that no Sun makes, the panels that explain them, and whether noise does."""
    row_of, vehicle, twin = partial(row, r.case), r.case.vehicle, r.twin
    early = r.sun["time"].values < case_seconds(r.case, r.sun, "second_touchdown")
    impossible, verdicts = r.health["impossible"], r.health["noise"]
    phases = [f"{name} {np.count_nonzero(own & r.impossible)}" for name, own in r.phases.items()]
    explained = [list(panels) for panels in r.health["explanations"]]
    pairs = [
        "-".join(pair)
        for pair in explanations(vehicle, list(impossible), size=2)
        if not any(panel in pair for panels in explained for panel in panels)
    ]
    each = "; ".join(
        f"({'-'.join(p)}) {impossible[p]} samples, the likeliest {v.largest:.2g}, all 1e{v.log10_together:.0f}"
        for p, v in verdicts.items()
    )
    noise = float(sum(v.log10_together for v in verdicts.values())) if verdicts else None
    published = {frozenset(map(str, p)) for p in r.case.published["lit_patterns_at_rest"].value}
    ours = {frozenset(pattern) for pattern in impossible}
    origin = "synthetic telemetry, made with panel 1 in shadow at rest" if r.twin else ""
    # whether turning panel 1 to the Sun was a risk: samples that only its loss explains
    panel_1 = sum(n for p, n in impossible.items() if explanations(vehicle, [p]) == [("1",)])
    allowed = ["-".join(pattern) for pattern in r.health["allowed"]]
    return [
        row_of("lit_patterns_allowed", len(allowed), published=None, patterns="; ".join(allowed)),
        row_of(
            "lit_patterns_before",
            int(np.count_nonzero(r.impossible & early)),
            samples=int(early.sum()),
            phases=", ".join(phases).replace("_", " "),
            twin=twin,
        ),
        row_of(
            "shadowed_panel_alternatives", ", ".join(pairs) or "none", published=None, twin=twin
        ),
        row_of(
            "lit_patterns_noise", noise, published=None, attrs=r.sun.attrs, each=each, twin=twin
        ),
        row_of(
            "lit_patterns_at_rest",
            sorted(map(sorted, ours)),
            published=sorted(map(sorted, published)),
            agrees=published <= ours,
            made=origin,
        ),
        row_of(
            "shadowed_panel", explained, published=[["1"]], agrees=explained == [["1"]], made=origin
        ),
        row_of(
            "panel_1_rotation", panel_1, agrees=panel_1 > 0, made=f"; {origin}" if origin else ""
        ),
    ]


def _sampling_rows(r: Phases) -> list[Row]:
    """How often the file samples: between first touchdown and collision, and from there to the second touchdown."""
    whose = "synthetic telemetry, made so" if r.twin else "the telemetry"
    row_of = partial(row, r.case, whose=whose)
    names, time = ("first_touchdown", "collision", "second_touchdown"), r.sun["time"].values
    touchdown, collision, second = (case_seconds(r.case, r.sun, name) for name in names)
    flight = time[(time >= touchdown) & (time < collision)]
    after = int(np.count_nonzero((time >= collision) & (time < second)))
    interval = float(np.median(np.diff(flight))) / 60 if flight.size > 1 else None
    unjudged: dict[str, Any] = {"tolerance": None} if interval is None else {}
    return [
        row_of("sampling_interval", interval, **unjudged),
        row_of("samples_after_collision", after),
    ]


def draw(r: Phases) -> Figure:
    """Lit panels sample by sample, and the probability of the forbidden samples under noise (paper, section 4)."""
    figure = Figure(figsize=(9, 7.4), layout="constrained")
    upper, lower = figure.subplots(2, 1, height_ratios=(1, 1.15), sharex=True)
    lit, names = r.sun["lit"].values, r.sun["panel"].values
    number = np.arange(1, len(lit) + 1)
    for chosen, colour, label in (
        (~r.impossible, COLOURS[0], "allowed"),
        (r.impossible, COLOURS[1], "forbidden"),
    ):
        sample, panel = np.nonzero(lit & chosen[:, None])
        upper.plot(number[sample], panel, "|", ms=9, mew=1.6, color=colour)
        upper.plot([], [], "s", color=colour, label=label)
    upper.set_yticks(range(len(names)), [str(name) for name in names])
    upper.set(ylabel="panel lit", ylim=(-0.6, len(names) + 0.6))
    upper.legend(ncols=2, fontsize=9, **ABOVE)
    explained = " or ".join("-".join(panels) for panels in r.health["explanations"]) or "none"
    what = "smallest set of panels in shadow or dead that explains every forbidden pattern"
    upper.set_title(f"{what}: {explained}", fontsize=10, pad=20)

    log10 = r.log10_probability
    bottom = max(-20.0, float(np.nanmin(log10, initial=-1.0)))  # what is less probable stands there
    for k, pattern in enumerate(r.health["impossible"]):
        at = np.isfinite(log10) & np.all(lit == np.isin(names, pattern), axis=1)
        if at.any():
            lower.plot(
                number[at],
                np.maximum(log10[at], bottom),
                "os^Dv"[k % 5],
                ms=5,
                mfc="none",
                color=COLOURS[k % 8],
                label=f"({'-'.join(pattern)})",
            )
    lower.set(xlabel="number of the sample", ylabel="log10 of the probability, at most")
    lower.set(ylim=(bottom - 1, 2.5))
    what = "probability that noise alone made the readings of a forbidden sample, by lit panels"
    lower.set_title(what, fontsize=10, pad=20)
    if r.health["noise"]:
        lower.legend(fontsize=9, ncols=5, columnspacing=0.8, handletextpad=0.2, **ABOVE)
    edge = 0.5
    for k, (name, own) in enumerate(r.phases.items()):
        if k:
            for axes in (upper, lower):
                axes.axvline(edge, lw=0.8, color=COLOURS[7])
        middle, height = edge + own.sum() / 2, 0.6 + k % 2
        edge += own.sum()
        if own.sum() > 8:
            label = {"ha": "center", "fontsize": 8, "color": "#555555", "bbox": ON_PAPER}
            lower.text(middle, height, name.replace("_", " "), **label)
    figure.suptitle(titled("Health of the panels", r.twin), fontsize=11)
    return figure
