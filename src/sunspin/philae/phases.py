"""The telemetry phase by phase: Delta, height of the Sun, lit patterns; panels that explain the impossible ones (paper, sections
2.1, 3.1 and 4)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import xarray as xr
from scipy.special import ndtri

from sunspin.philae.carries import whole_panels
from sunspin.philae.rebound import case_seconds
from sunspin.philae.row import Row, published_row, source_of
from sunspin.telemetry.case import Case
from sunspin.telemetry.health import explanations, noise_alone, panel_health
from sunspin.telemetry.sun import SunStatus, is_reconstructed, sun_directions
from sunspin.vehicle.timeline import utc_seconds

CHECKING_PANELS = 3
"""Panels that must be lit for Delta to be looked at where the lit pattern is impossible: a direction and a scale fit any two."""

SHADOWED = ("deployment", "rest")
"""Phases of which the paper says that Delta is large."""


@dataclass(frozen=True)
class PhaseStatistics:
    """One phase: number of samples, with a direction, with an impossible pattern; Delta where something checks it; n_z.

    `delta` (n_checked) and `z` (n_reconstructed) are arrays.
    """

    name: str
    samples: int
    impossible: int
    delta: np.ndarray
    z: np.ndarray


@dataclass(frozen=True)
class Phases:
    """Statistics of every phase, and the health of the panels.

    Attributes
    ----------
    phases : one `PhaseStatistics` per phase of the case that has samples
    health : as returned by `panel_health`
    sun : Dataset of `sun_directions`
    log10_probability : (n_time,) log10 of the bound on the probability that noise alone made a sample, NaN unless its pattern
        is impossible
    """

    case: Case
    phases: list[PhaseStatistics]
    health: dict[str, Any]
    sun: xr.Dataset
    log10_probability: np.ndarray

    @property
    def synthetic(self) -> bool:
        return bool(self.sun.attrs.get("synthetic"))

    def named(self, name: str) -> PhaseStatistics | None:
        """The phase called `name`, if it has samples."""
        return next((phase for phase in self.phases if phase.name == name), None)


def compute(case: Case, telemetry: xr.Dataset | None = None) -> Phases:
    """Statistics of the case's own telemetry, or of another in its place."""
    data = case.telemetry if telemetry is None else telemetry
    sun = sun_directions(case.vehicle, data)
    health = panel_health(case.vehicle, data)
    status = sun["status"].values
    log10 = np.full(status.size, np.nan)
    forbidden = status == SunStatus.IMPOSSIBLE
    if health["noise"]:
        power = np.asarray(data[case.vehicle.telemetry.quantity].transpose("time", "panel"))[forbidden]
        made = noise_alone(case.vehicle, power, sun.attrs["noise"], sun.attrs["lit_threshold"])
        log10[forbidden] = made.log_probability / np.log(10)
    timeline = case.require_timeline()
    shift = utc_seconds(timeline.epoch_utc, sun.attrs["epoch_utc"])
    found = [
        _statistics(phase.name, sun, (sun["time"].values >= phase.begin_s + shift) & (sun["time"].values < phase.end_s + shift))
        for phase in timeline.phases
    ]
    return Phases(case, [phase for phase in found if phase.samples], health, sun, log10)


def _statistics(name: str, sun: xr.Dataset, member: np.ndarray) -> PhaseStatistics:
    status = sun["status"].values
    impossible = status == SunStatus.IMPOSSIBLE
    checked = member & ((status == SunStatus.OK) | (impossible & (sun["n_lit"].values >= CHECKING_PANELS)))
    z = sun["sun_B"].values[member & is_reconstructed(status), 2]
    return PhaseStatistics(name, int(member.sum()), int((impossible & member).sum()), sun["delta"].values[checked], z)


def rows(result: Phases) -> list[Row]:
    """Figures of sections 2.1, 3.1 and 4 on the telemetry beside ours."""
    return [*_measure_rows(result), *_delta_rows(result), *_pattern_rows(result), *_health_rows(result), *_sampling_rows(result)]


def _twin(r: Phases, text: str) -> str:
    return f"synthetic telemetry; {text}" if r.synthetic else text


def _delta_rows(r: Phases) -> list[Row]:
    low, high = r.case.published["delta_shadowed"].value
    shadowed = [phase for name in SHADOWED if (phase := r.named(name)) is not None and phase.delta.size]
    delta = np.concatenate([phase.delta for phase in shadowed]) if shadowed else np.zeros(0)
    inside = float(np.mean((delta >= low) & (delta <= high))) if delta.size else 0.0
    each = "; ".join(f"{p.name} {p.delta.min():.3f} to {p.delta.max():.3f} ({p.delta.size})" for p in shadowed)
    others = "; ".join(
        f"{p.name} mean {p.delta.mean():.4f}, largest {p.delta.max():.3f} ({p.delta.size})"
        for p in r.phases if p.name not in SHADOWED and p.delta.size
    )  # fmt: skip
    ours = [float(delta.min()), float(delta.max())] if delta.size else None
    found = [
        Row(
            "delta_shadowed", r.case.published["delta_shadowed"].what, [low, high], ours, "1", None, inside >= 0.9,
            _twin(r, f"{inside:.0%} inside, nine tenths are asked for; {each}; the others: {others}"),
            f"paper, {r.case.published['delta_shadowed'].place}",
        )
    ]  # fmt: skip
    folded = r.named("deployment")
    if folded is not None and folded.z.size:
        note = _twin(r, f"mean of {folded.z.size} directions, {folded.z.min():.2f} to {folded.z.max():.2f}")
        found.append(published_row(r.case, "nz_folded", float(folded.z.mean()), 0.05, note))
    return found


def _pattern_rows(r: Phases) -> list[Row]:
    end = utc_seconds(r.case.require_timeline().event("second_touchdown").utc, r.sun.attrs["epoch_utc"])
    early = r.sun["time"].values < end
    wrong = int(np.count_nonzero((r.sun["status"].values == SunStatus.IMPOSSIBLE) & early))
    impossible = list(r.health["impossible"])
    pairs = explanations(r.case.vehicle, impossible, size=2)
    others = ", ".join("-".join(pair) for pair in pairs if not set(pair) & {p for one in r.health["explanations"] for p in one})
    verdicts = r.health["noise"]
    each = "; ".join(
        f"({'-'.join(p)}) {r.health['impossible'][p]} samples, the likeliest {v.largest:.1e}, all {v.log10_together:.0f}"
        for p, v in verdicts.items()
    )  # fmt: skip
    together = float(sum(v.log10_together for v in verdicts.values())) if verdicts else None
    return [
        Row(
            "lit_patterns_allowed", "lit patterns that the geometry of the panels allows", None, len(r.health["allowed"]), "1",
            None, None, "; ".join("-".join(p) for p in r.health["allowed"]), "paper, section 4, from the panels' normals",
        ),
        Row(
            "lit_patterns_before", "inconsistent lit patterns before the second touchdown", "none", wrong, "1", 0, wrong == 0,
            _twin(r, f"{int(early.sum())} samples; by phase " + ", ".join(f"{p.name} {p.impossible}" for p in r.phases)),
            "paper, section 4",
        ),
        Row(
            "shadowed_panel_alternatives", "sets of two panels that explain the inconsistent patterns without the single one",
            None, others or "none", "1", None, None, _twin(r, "a set of two that holds the single panel explains them as well"),
            "paper, section 4",
        ),
        Row(
            "lit_patterns_noise", "log10 of the probability that noise alone made all the inconsistent samples, at most", None,
            together, "1", None, None,
            _twin(r, f"sigma {r.sun.attrs['noise']:.3g}, lit above {r.sun.attrs['lit_threshold']:.3g}; {each}"),
            "paper, section 4, not considered there",
        ),
    ]  # fmt: skip


def _measure_rows(r: Phases) -> list[Row]:
    case, sun = r.case, r.sun
    kept = is_reconstructed(sun["status"]) & whole_panels(case, sun)
    delta = sun["delta"].values[kept]
    if not delta.size:
        return []
    checked = sun["delta"].values[kept & (sun["n_lit"].values > CHECKING_PANELS)]
    low, high = _largest_of(checked) if checked.size else (np.nan, np.nan)
    largest = case.published["delta_max"]
    chosen = "the telemetry is synthetic: its noise was chosen for this figure; " if sun.attrs.get("synthetic") else ""
    return [
        published_row(
            case, "delta_mean", float(delta.mean()), 0.002,
            f"{chosen}{delta.size} directions, {delta.size - checked.size} of them from exactly three panels, whose Delta is 0",
            sigma=float(delta.std() / np.sqrt(delta.size)),
        ),
        Row(
            "delta_max", largest.what, largest.value, float(delta.max()), "1", high - low if checked.size else None,
            bool(low <= largest.value <= high) if checked.size else None,
            f"noise of one size (half a Gaussian of this mean) makes the largest of {checked.size} {low:.3f} to {high:.3f} in nine "
            "of ten data sets; the published one is compared with this range", source_of(largest.place),
            low=low if checked.size else None, high=high if checked.size else None,
        ),
    ]  # fmt: skip


def _largest_of(delta: np.ndarray) -> tuple[float, float]:
    """5 and 95 % of the largest of as many absolute values of a Gaussian as `delta` (n), with its mean."""
    sigma = float(delta.mean()) * np.sqrt(np.pi / 2)
    low, high = (float(sigma * ndtri((1 + q ** (1 / delta.size)) / 2)) for q in (0.05, 0.95))
    return low, high


def _health_rows(r: Phases) -> list[Row]:
    case, sun, health = r.case, r.sun, r.health
    published = {frozenset(map(str, pattern)) for pattern in case.published["lit_patterns_at_rest"].value}
    ours = {frozenset(pattern) for pattern in health["impossible"]}
    note = "synthetic telemetry, made with panel 1 in shadow at rest" if sun.attrs.get("synthetic") else ""
    explained = [list(panels) for panels in health["explanations"]]
    return [
        Row(
            "lit_patterns_at_rest", case.published["lit_patterns_at_rest"].what, sorted(map(sorted, published)),
            sorted(map(sorted, ours)), "1", 0, bool(published <= ours), note, "paper, section 4",
        ),
        Row(
            "shadowed_panel", case.published["shadowed_panel"].what, [["1"]], explained, "1", 0,
            bool(explained == [["1"]]), note, "paper, section 4",
        ),
        _rotation_row(r, note),
    ]  # fmt: skip


def _rotation_row(r: Phases, note: str) -> Row:
    """Whether turning panel 1 to the Sun was a risk: what the samples at rest say of it."""
    needed = [pattern for pattern in r.health["impossible"] if explanations(r.case.vehicle, [pattern]) == [("1",)]]
    count = sum(r.health["impossible"][pattern] for pattern in needed)
    told = f"{count} samples whose lit pattern asks for panel 1 and nothing else, and which give nothing from it"
    return Row(
        "panel_1_rotation", "samples that speak for a dead panel 1: was it a risk to turn it to the "
            "Sun?", "risky", count, "1", None,
        count > 0,
        f"{told}; criterion: at least one. A dead panel and a shadowed one read alike, so the risk was real; panel 1 worked "
        "when the lander woke up, so it had been in shadow" + (f"; {note}" if note else ""), "paper, section 4",
    )  # fmt: skip


def _sampling_rows(r: Phases) -> list[Row]:
    """How often the file samples: between first touchdown and collision, and from there to the second touchdown."""
    time = r.sun["time"].values
    touchdown, collision, second = (
        case_seconds(r.case, r.sun, name) for name in ("first_touchdown", "collision", "second_touchdown")
    )
    flight, note = (time >= touchdown) & (time < collision), "synthetic telemetry, made so" if r.synthetic else "the telemetry"
    several = flight.sum() > 1
    interval = float(np.median(np.diff(time[flight]))) / 60 if several else None
    return [
        published_row(
            r.case, "sampling_interval", interval, 0.3 if several else None, f"median between first touchdown and collision; {note}"
        ),
        published_row(
            r.case, "samples_after_collision", int(np.count_nonzero((time >= collision) & (time < second))), 0.0, note,
        ),
    ]  # fmt: skip
