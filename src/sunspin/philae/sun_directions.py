"""Sun directions from the panels' powers: Delta, n_z, lit patterns, sampling (paper, sections 2.1 and 4, Fig. 4).

The directions (eq. 1 and 2) are those of :func:`sunspin.sun_directions`. This module estimates a file's own noise
(`apply_measured_noise`) and computes for each phase of the landing the figures that the paper states.
"""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.special import ndtri
from scipy.stats import chi2

from sunspin.cases import Case
from sunspin.output.figures import ABOVE, COLOURS, ON_PAPER, empty_figure, titled
from sunspin.philae.rebound import event_seconds, with_telemetry
from sunspin.philae.row import Row, interval_90, make_row
from sunspin.telemetry.health import PanelHealth, find_explanations, panel_health
from sunspin.telemetry.noise import HALF_NORMAL_MEDIAN
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import SunStatus, is_reconstructed, sun_directions
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import lit_patterns
from sunspin.vehicle.timeline import utc_seconds

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SHADOWED_PHASES = ("deployment", "settling", "rest")
"""Phases in which parts of the lander or the ground shadow the panels: the paper leaves them out of its statistics of Delta."""

LEAST = 8
"""Least number of readings for an estimate of sigma, which is then good to a third."""

ROUGH_SIGMAS = 6.0
"""Readings beyond this many rough sigma are not noise: a reflection, a shadow, a wrong column."""


# ---- The file's own noise ----------------------------------------------------------------------------------------------------


class ReadingNoise(NamedTuple):
    """Noise of the readings: sigma of a lit panel and lit threshold, in the unit of the readings, and their origin in words."""

    lit: float
    lit_threshold: float
    about: str


def apply_measured_noise(case: Case) -> tuple[Case, ReadingNoise]:
    """Return the case with the noise and lit threshold estimated from its own telemetry, and the estimate.

    The vehicle then carries them, so that every step of the study uses them. If telemetry noisier than the synthetic one were read
    with the figures of the latter, noise on dark panels would light them, in patterns that the Sun cannot make. With too few
    samples the vehicle file's figures are kept, as is a value set for this run. Noises of single panels keep their stated ratio.
    """
    vehicle, layout, power = case.vehicle, case.vehicle.telemetry, signals(case.telemetry)
    # the estimate is the rms over all panels; `rms_over_median` converts it to the noise of the median panel
    stated = vehicle.input_noise  # of each panel, or None
    stated_median = 1.0 if stated is None else float(np.median(stated))
    rms_over_median = 1.0
    if stated is not None:
        rms_over_median = float(np.sqrt(np.mean((stated / stated_median) ** 2)))
    unit = vehicle.gain_unit or ("W" if layout.quantity == "power_W" else "A")

    def rounded(value: float) -> float:
        """Return the value to three digits, so that rounding errors of a machine do not change the hash of a file."""
        return float(f"{value:.3g}")

    dark, n_dark = estimate_dark_sigma(vehicle, power)
    # Four sigma: of a thousand dark readings none is taken for lit. A reading above a tenth of the largest is not noise. On a dark
    # panel it must appear as an impossible lit pattern, so the threshold stays below.
    tenth_of_largest = 0.1 * float(np.nan_to_num(power).max(initial=0.0))
    threshold = max(layout.lit_threshold or 0.0, rounded(min(4.0 * dark, tenth_of_largest)))
    # direction and scale are fitted to L lit panels, so the squared misfit is chi-square with L - 3 degrees of freedom
    sun = sun_directions(vehicle, case.telemetry, lit_threshold=threshold)
    checked = unshadowed_samples(case, case.telemetry) & (sun["status"].values == SunStatus.OK)
    if (n_lit := int(checked.sum())) >= LEAST:
        freedom = sun["n_lit"].values[checked] - 3
        # Delta is the misfit relative to the readings of the sample
        total = np.linalg.norm(np.nan_to_num(power[checked]), axis=1)
        misfit = sun["delta"].values[checked] * total
        # a robust estimate from the median first, then the mean square without outliers
        rough_sigma = float(np.median(misfit / np.sqrt(chi2.ppf(0.5, freedom))))
        good = misfit < ROUGH_SIGMAS * rough_sigma * np.sqrt(freedom)
        rms = float(np.sqrt((misfit[good] ** 2).sum() / freedom[good].sum()))
        lit = rounded(rms / rms_over_median)
        origin = f"from the misfit of {n_lit} samples with more than three lit panels"
    else:
        lit = 0.0 if stated is None else stated_median
        origin = "the vehicle file's: too few samples to tell"
    zero = f"0 +- {dark:.2g} {unit} ({n_dark} readings)" if dark > 0 else "zero"
    about = f"noise of a lit panel {lit:g} {unit}, {origin}; dark panels read {zero}, lit above {threshold:g} {unit}"
    # a value that the user set for this run takes precedence over the estimate
    set_keys = {change.key for change in vehicle.changes}
    if "telemetry.noise" in set_keys and layout.noise is not None:
        lit = layout.noise
        about += f"; noise set to {lit:g} for this run"
    if "telemetry.lit_threshold" in set_keys and layout.lit_threshold is not None:
        threshold = layout.lit_threshold
        about += f"; lit threshold set to {threshold:g} for this run"
    # the noise of all panels, and that of a panel with one of its own, keep their ratio to the median panel
    common_noise = lit * ((layout.noise or stated_median) / stated_median)
    layout = replace(layout, noise=common_noise, lit_threshold=threshold)
    panels = tuple(
        replace(panel, noise=panel.noise and lit * (panel.noise / stated_median))
        for panel in vehicle.panels
    )
    changed_case = replace(case, vehicle=replace(vehicle, telemetry=layout, panels=panels))
    return with_telemetry(changed_case, case.telemetry), ReadingNoise(lit, threshold, about)


def estimate_dark_sigma(vehicle: Vehicle, power: np.ndarray) -> tuple[float, int]:
    """Return the sigma of a dark panel's reading, and the number of readings of dark panels, of any sign.

    `power`: (n, n_panel), NaN if missing. Sigma is zero if fewer than `LEAST` of these readings are positive. A panel is certainly
    dark if geometry never lights it together with one that is bright.
    """
    lit_together = np.zeros((len(vehicle.panels),) * 2, dtype=bool)
    for pattern in lit_patterns(vehicle):
        lit = np.array([name in pattern for name in vehicle.panel_names])
        lit_together |= np.outer(lit, lit)
    readings = np.where(np.isfinite(power), power, 0.0)
    bright = readings > 0.2 * readings.max(initial=0.0)  # certainly in the Sun
    # for each panel the number of bright ones with which it is never lit is above zero
    dark = (bright.astype(int) @ (~lit_together).astype(int) > 0) & ~bright & np.isfinite(power)
    # the positive half of the noise, which is complete even if negative readings were cut to zero
    positive = readings[dark & (readings > 0)]
    if positive.size < LEAST:
        return 0.0, int(dark.sum())
    rough_sigma = float(np.median(positive)) / HALF_NORMAL_MEDIAN
    # once more without outliers, such as reflections
    usual = positive[positive < ROUGH_SIGMAS * rough_sigma]
    sigma = float(np.median(usual)) / HALF_NORMAL_MEDIAN
    return sigma, int(dark.sum())


def samples_by_phase(case: Case, data: xr.Dataset) -> dict[str, np.ndarray]:
    """Return for each phase of the case's timeline the mask (n) of its samples."""
    timeline = case.require_timeline()
    time = data["time"].values - utc_seconds(timeline.epoch_utc, data.attrs["epoch_utc"])
    return {p.name: (time >= p.begin_s) & (time < p.end_s) for p in timeline.phases}


def unshadowed_samples(case: Case, data: xr.Dataset) -> np.ndarray:
    """Return the mask (n) of samples outside the phases in which something shadows the panels."""
    by_phase = samples_by_phase(case, data)
    return ~np.any([by_phase[name] for name in SHADOWED_PHASES if name in by_phase], axis=0)


def share_in_shadowed_range(case: Case, delta: np.ndarray) -> float:
    """Return the share of Delta (n) in the range that the paper prints for shadowed samples; 0 without any."""
    least, most = case.published["delta_shadowed"].value
    return float(np.mean((delta >= least) & (delta <= most))) if delta.size else 0.0


# ---- Delta, n_z, lit patterns and sampling of each phase ---------------------------------------------------------------------


class Phases(NamedTuple):
    """Sun directions (`sun_directions`) and lit panels (`panel_health`) of a whole landing.

    `phases`: mask (n_time) of the samples of each phase that has any. `impossible` (n_time): samples whose lit pattern no Sun
    makes.
    """

    case: Case
    sun: xr.Dataset
    health: PanelHealth
    phases: dict[str, np.ndarray]
    impossible: np.ndarray


def compute(case: Case) -> Phases:
    """Compute directions, health of the panels, and phases of the case's telemetry."""
    vehicle, data = case.vehicle, case.telemetry
    sun, health = sun_directions(vehicle, data), panel_health(vehicle, data)
    phases = {name: inside for name, inside in samples_by_phase(case, sun).items() if inside.any()}
    impossible = sun["status"].values == SunStatus.IMPOSSIBLE
    return Phases(case, sun, health, phases, impossible)


def rows(landing: Phases) -> list[Row]:
    """Return the figures of sections 2.1, 3.1 and 4 on the telemetry compared with ours.

    They are Delta, n_z with the legs folded, lit patterns and sampling.
    """
    return [*_delta_rows(landing), *_pattern_rows(landing), *_sampling_rows(landing)]


def _delta_rows(landing: Phases) -> list[Row]:
    """Return the rows on Delta outside and inside the shadowed phases, and on n_z with the legs folded."""
    case, sun, phases = landing.case, landing.sun, landing.phases
    status, delta, n_lit = (sun[name].values for name in ("status", "delta", "n_lit"))
    seen, result = is_reconstructed(status), []

    # outside the shadowed phases; with exactly three lit panels Delta is zero and checks nothing
    kept = seen & unshadowed_samples(case, sun)
    checked, directions = delta[kept & (n_lit > 3)], int(kept.sum())
    if directions:
        mean, error = float(delta[kept].mean()), float(delta[kept].std() / np.sqrt(directions))
        low, high = interval_90(mean, error)
        note = f"{directions} directions, {directions - checked.size} of them from exactly three panels, whose Delta is 0"
        result.append(make_row(case, "delta_mean", mean, note=note, low=low, high=high))
    if checked.size:
        # 5 and 95 % quantiles of the largest of n absolute values of a Gaussian, whose sigma follows from their mean
        single = np.array([0.05, 0.95]) ** (1 / checked.size)  # probabilities of a single value
        sigma = float(checked.mean()) * np.sqrt(np.pi / 2)
        low, high = (sigma * ndtri((1 + single) / 2)).tolist()
        note = f"criterion: noise of one size gives {low:.3f} to {high:.3f} as the largest of {checked.size}"
        note += " in nine of ten data sets"
        verdict: dict[str, Any] = {"tolerance": high - low, "note": note}
        verdict["agrees"] = bool(low <= case.published["delta_max"].value <= high)
        largest = float(checked.max())
        result.append(make_row(case, "delta_max", largest, low=low, high=high, **verdict))

    # by phase; direction and scale fit any two panels, so an impossible pattern has a misfit only from three lit panels on
    fits = (status == SunStatus.OK) | (landing.impossible & (n_lit >= 3))
    by_phase = {name: delta[inside & fits] for name, inside in phases.items()}
    by_phase = {name: values for name, values in by_phase.items() if values.size}
    shadowed = ("deployment", "rest")  # phases in which Delta is large according to the paper
    # the empty list lets the concatenation succeed if neither phase has samples
    large = np.concatenate([[], *(by_phase[name] for name in shadowed if name in by_phase)])
    share = share_in_shadowed_range(case, large)
    ranges, means = [], []
    for name, values in by_phase.items():
        if name in shadowed:
            ranges.append(f"{name} {values.min():.3f} to {values.max():.3f} ({values.size})")
        else:
            mean, largest = values.mean(), values.max()
            means.append(f"{name} mean {mean:.4f}, largest {largest:.3f} ({values.size})")
    ours = [float(large.min()), float(large.max())] if large.size else None
    others = f"the others: {'; '.join(means)}".replace("_", " ")
    note = f"{share:.0%} inside, nine tenths are asked for; {'; '.join(ranges)}; {others}"
    result.append(make_row(case, "delta_shadowed", ours, note=note, agrees=share >= 0.9))

    folded = phases.get("deployment", np.zeros(len(status), dtype=bool))
    z = sun["sun_B"].values[folded & seen, 2]
    if z.size:
        note = f"mean of {z.size} directions, {z.min():.2f} to {z.max():.2f}"
        result.append(make_row(case, "nz_folded", float(z.mean()), note=note))
    return result


def _pattern_rows(landing: Phases) -> list[Row]:
    """Return the rows on impossible lit patterns, the panels whose loss explains them, and noise as their cause."""
    case, vehicle, health = landing.case, landing.case.vehicle, landing.health
    early = landing.sun["time"].values < event_seconds(case, landing.sun, "second_touchdown")
    noise, lit_threshold = (landing.sun.attrs[name] for name in ("noise", "lit_threshold"))
    counts = ", ".join(
        f"{name} {np.count_nonzero(inside & landing.impossible)}"
        for name, inside in landing.phases.items()
    ).replace("_", " ")

    # the smallest sets of panels that explain all impossible patterns, and pairs that explain them without such a panel
    impossible = health["impossible"]  # pattern -> number of samples
    explained = [list(panels) for panels in health["explanations"]]
    explaining = {panel for panels in explained for panel in panels}
    pairs = find_explanations(vehicle, list(impossible), size=2)
    alternatives = ["-".join(pair) for pair in pairs if not explaining & {*pair}]
    allowed = ["-".join(pattern) for pattern in health["allowed"]]

    # probability that noise made the impossible patterns
    noise_verdicts = health["noise"]
    by_pattern = "; ".join(
        f"({'-'.join(pattern)}) {impossible[pattern]} samples, the likeliest {verdict.largest:.2g}, all "
        f"1e{verdict.log10_together:.0f}"
        for pattern, verdict in noise_verdicts.items()
    )
    log10_noise = None
    if noise_verdicts:
        log10_noise = float(sum(verdict.log10_together for verdict in noise_verdicts.values()))

    at_rest = sorted(
        sorted(map(str, pattern)) for pattern in case.published["lit_patterns_at_rest"].value
    )
    missing = {*map(frozenset, at_rest)} - {*map(frozenset, impossible)}
    # was it a risk to rotate panel 1 to the Sun? Number of samples that only its loss explains
    panel_1 = sum(
        count
        for pattern, count in impossible.items()
        if find_explanations(vehicle, [pattern]) == [("1",)]
    )
    patterns: dict[str, Any] = {"published": at_rest, "agrees": not missing}
    lost: dict[str, Any] = {"published": [["1"]], "agrees": explained == [["1"]]}
    notes = {
        "lit_patterns_allowed": "; ".join(allowed),
        "lit_patterns_before": f"{early.sum()} samples; by phase {counts}",
        "lit_patterns_noise": f"sigma {noise:.3g}, lit above {lit_threshold:.3g}; {by_pattern}",
        "panel_1_rotation": f"{panel_1} samples have a pattern that only panel 1 explains; criterion: at least one. A dead and a "
        "shadowed panel read alike; panel 1 worked when the lander woke up, so it was in shadow",
    }
    row_of = partial(make_row, case, notes=notes)
    return [
        row_of("lit_patterns_allowed", len(allowed)),
        row_of("lit_patterns_before", np.count_nonzero(landing.impossible & early)),
        row_of("shadowed_panel_alternatives", ", ".join(alternatives) or "none"),
        row_of("lit_patterns_noise", log10_noise),
        row_of("lit_patterns_at_rest", sorted(map(sorted, impossible)), **patterns),
        row_of("shadowed_panel", explained, **lost),
        row_of("panel_1_rotation", panel_1, agrees=panel_1 > 0),
    ]


def _sampling_rows(landing: Phases) -> list[Row]:
    """Return the rows on the sampling interval before the collision, and on the number of samples after it.

    With fewer than two samples before the collision there is no interval, and nothing is judged.
    """
    case, sun, time = landing.case, landing.sun, landing.sun["time"].values
    first, collision, second = (
        event_seconds(case, sun, name)
        for name in ("first_touchdown", "collision", "second_touchdown")
    )
    flight = time[(time >= first) & (time < collision)]
    interval_min = float(np.median(np.diff(flight))) / 60 if flight.size > 1 else None
    unjudged: dict[str, Any] = {"tolerance": None} if interval_min is None else {}
    after = int(np.count_nonzero((time >= collision) & (time < second)))
    return [
        make_row(case, "sampling_interval", interval_min, **unjudged),
        make_row(case, "samples_after_collision", after),
    ]


# ---- Pictures ----------------------------------------------------------------------------------------------------------------


def directions_figure(landing: Phases) -> Figure:
    """Draw the reconstructed directions on the sphere for each phase of the motion (paper, Fig. 4)."""
    samples = {"all samples": slice(None)}
    if "phase" in landing.sun.coords:
        groups = {
            "descent": ["descent"],
            "first touchdown to collision": ["first_rebound"],
            "collision to second touchdown": ["second_rebound"],
            "after the second touchdown": ["settling", "rest"],
        }
        phase = landing.sun["phase"].values
        samples = {name: np.flatnonzero(np.isin(phase, of)) for name, of in groups.items()}
    figure = empty_figure(11, 3.4)
    for k, (name, chosen) in enumerate(samples.items()):
        axes, sun = sphere_axes(figure, len(samples), k), landing.sun.isel(time=chosen)
        n = sun["sun_B"].values
        n = n[np.isfinite(n[:, 0])]
        axes.plot(*n.T, ":", lw=0.6, color=COLOURS[7])
        axes.scatter(*n.T, s=9, color=COLOURS[0], depthshade=False)
        doubtful = (sun["status"].values == SunStatus.IMPOSSIBLE) & (sun["n_lit"].values >= 3)
        best = sun["best_B"].values[doubtful]
        axes.scatter(*best.T, s=9, color=COLOURS[1], depthshade=False)
        suffix = f", {len(best)} doubtful" if len(best) else ""
        title = f"{chr(65 + k)}: {name}\n{len(n)} of {sun.sizes['time']} samples{suffix}"
        axes.set_title(title, fontsize=9)
    title = titled("Directions to the Sun in body axes", landing.sun.attrs.get("synthetic"))
    figure.suptitle(title, fontsize=10)
    return figure


def sphere_axes(figure: Any, columns: int, k: int) -> Any:
    """Return new axes, number `k` of a row of `columns`, of a figure or subfigure, with the unit sphere of body axes."""
    axes = figure.add_subplot(1, columns, k + 1, projection="3d")
    u, v = np.mgrid[0 : 2 * np.pi : 25j, 0 : np.pi : 13j]
    x, y, z = np.cos(u) * np.sin(v), np.sin(u) * np.sin(v), np.cos(v)
    axes.plot_wireframe(x, y, z, lw=0.25, color="#cccccc")
    axes.set_box_aspect((1, 1, 1), zoom=1.05)
    for name in "xyz":
        getattr(axes, f"set_{name}ticks")([-1, 0, 1])
        axes.tick_params(axis=name, labelsize=6, pad=-3)
    axes.set_xlabel("x", labelpad=-6, fontsize=8)
    axes.set_ylabel("y", labelpad=-6, fontsize=8)
    # matplotlib's own label of z is lost behind the next sphere
    axes.text(1.15, 1.15, 1.35, "z", ha="center", fontsize=8)
    return axes


def lit_panels_figure(landing: Phases) -> Figure:
    """Draw the lit panels of each sample, impossible patterns in another colour (paper, section 4)."""
    figure = empty_figure(9, 4.2)
    axes, lit, names = figure.subplots(), landing.sun["lit"].values, landing.sun["panel"].values
    number = np.arange(1, len(lit) + 1)
    for colour, label, chosen in (
        (COLOURS[0], "allowed", ~landing.impossible),
        (COLOURS[1], "forbidden", landing.impossible),
    ):
        sample, panel = np.nonzero(lit & chosen[:, None])
        axes.plot(number[sample], panel, "|", ms=9, mew=1.6, color=colour)
        axes.plot([], [], "s", color=colour, label=label)
    axes.set_yticks(range(len(names)), [str(name) for name in names])
    axes.set(xlabel="number of the sample", ylabel="panel lit", ylim=(-0.6, len(names) + 0.3))
    axes.legend(ncols=2, fontsize=9, **ABOVE)
    # a line where each phase begins; samples are numbered from 1, so the first one begins at 0.5
    begin = 0.5
    for k, (name, inside) in enumerate(landing.phases.items()):
        count = inside.sum()
        axes.axvline(begin, lw=0.8, color=COLOURS[7])
        if count > 8:  # a shorter phase has no space for its name
            style: dict[str, Any] = {"ha": "center", "fontsize": 8, "color": "#555555"}
            # names at two heights, so that neighbours do not overlap
            height = len(names) - 0.5 + 0.4 * (k % 2)
            text = name.replace("_", " ")
            axes.text(begin + count / 2, height, text, bbox=ON_PAPER, **style)
        begin += count
    explained = " or ".join("-".join(panels) for panels in landing.health["explanations"]) or "none"
    what = "Smallest set of panels in shadow or dead that explains every forbidden pattern"
    title = titled(f"{what}: {explained}", landing.sun.attrs.get("synthetic"))
    figure.suptitle(title, fontsize=11)
    return figure
