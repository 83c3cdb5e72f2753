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
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case
from sunspin.telemetry.health import PanelHealth, explanations, noise_alone, panel_health
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
    health: PanelHealth
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
        power = np.asarray(data[case.vehicle.telemetry.quantity].transpose("time", "panel"))[
            forbidden
        ]
        made = noise_alone(case.vehicle, power, sun["noise"].values, sun["lit_threshold"].values)
        log10[forbidden] = made.log_probability / np.log(10)
    timeline = case.require_timeline()
    shift = utc_seconds(timeline.epoch_utc, sun.attrs["epoch_utc"])
    found = [
        _statistics(
            phase.name,
            sun,
            (sun["time"].values >= phase.begin_s + shift)
            & (sun["time"].values < phase.end_s + shift),
        )
        for phase in timeline.phases
    ]
    return Phases(case, [phase for phase in found if phase.samples], health, sun, log10)


def _statistics(name: str, sun: xr.Dataset, member: np.ndarray) -> PhaseStatistics:
    status = sun["status"].values
    impossible = status == SunStatus.IMPOSSIBLE
    checked = member & (
        (status == SunStatus.OK) | (impossible & (sun["n_lit"].values >= CHECKING_PANELS))
    )
    z = sun["sun_B"].values[member & is_reconstructed(status), 2]
    return PhaseStatistics(
        name, int(member.sum()), int((impossible & member).sum()), sun["delta"].values[checked], z
    )


def rows(result: Phases) -> list[Row]:
    """Figures of sections 2.1, 3.1 and 4 on the telemetry beside ours."""
    return [
        *_measure_rows(result),
        *_delta_rows(result),
        *_pattern_rows(result),
        *_health_rows(result),
        *_sampling_rows(result),
    ]


def _twin(r: Phases) -> str:
    return "synthetic telemetry; " if r.synthetic else ""


def _delta_rows(r: Phases) -> list[Row]:
    low, high = r.case.published["delta_shadowed"].value
    shadowed = [
        phase for name in SHADOWED if (phase := r.named(name)) is not None and phase.delta.size
    ]
    delta = np.concatenate([phase.delta for phase in shadowed]) if shadowed else np.zeros(0)
    inside = float(np.mean((delta >= low) & (delta <= high))) if delta.size else 0.0
    each = "; ".join(
        f"{p.name.replace('_', ' ')} {p.delta.min():.3f} to {p.delta.max():.3f} ({p.delta.size})"
        for p in shadowed
    )
    others = "; ".join(
        f"{p.name.replace('_', ' ')} mean {p.delta.mean():.4f}, largest {p.delta.max():.3f} ({p.delta.size})"
        for p in r.phases
        if p.name not in SHADOWED and p.delta.size
    )
    ours = [float(delta.min()), float(delta.max())] if delta.size else None
    found = [
        row(
            r.case,
            "delta_shadowed",
            ours,
            published=[low, high],
            agrees=inside >= 0.9,
            twin=_twin(r),
            inside=inside,
            each=each,
            others=others,
        )
    ]
    folded = r.named("deployment")
    if folded is not None and folded.z.size:
        z = folded.z
        found.append(
            row(
                r.case,
                "nz_folded",
                float(z.mean()),
                twin=_twin(r),
                z=z,
                least=z.min(),
                most=z.max(),
            )
        )
    return found


def _pattern_rows(r: Phases) -> list[Row]:
    case, end = (
        r.case,
        utc_seconds(
            r.case.require_timeline().event("second_touchdown").utc, r.sun.attrs["epoch_utc"]
        ),
    )
    early = r.sun["time"].values < end
    wrong = int(np.count_nonzero((r.sun["status"].values == SunStatus.IMPOSSIBLE) & early))
    pairs = explanations(case.vehicle, list(r.health["impossible"]), size=2)
    others = ", ".join(
        "-".join(pair)
        for pair in pairs
        if not set(pair) & {p for one in r.health["explanations"] for p in one}
    )
    verdicts = r.health["noise"]
    each = "; ".join(
        f"({'-'.join(p)}) {r.health['impossible'][p]} samples, the likeliest {v.largest:.2g}, all 1e{v.log10_together:.0f}"
        for p, v in verdicts.items()
    )
    together = float(sum(v.log10_together for v in verdicts.values())) if verdicts else None
    allowed = r.health["allowed"]
    return [
        row(
            case,
            "lit_patterns_allowed",
            len(allowed),
            published=None,
            patterns="; ".join("-".join(p) for p in allowed),
        ),
        row(
            case,
            "lit_patterns_before",
            wrong,
            twin=_twin(r),
            samples=int(early.sum()),
            phases=", ".join(f"{p.name.replace('_', ' ')} {p.impossible}" for p in r.phases),
        ),
        row(case, "shadowed_panel_alternatives", others or "none", published=None, twin=_twin(r)),
        row(
            case,
            "lit_patterns_noise",
            together,
            published=None,
            twin=_twin(r),
            attrs=r.sun.attrs,
            each=each,
        ),
    ]


def _measure_rows(r: Phases) -> list[Row]:
    case, sun = r.case, r.sun
    kept = is_reconstructed(sun["status"]) & whole_panels(case, sun)
    delta = sun["delta"].values[kept]
    if not delta.size:
        return []
    checked = sun["delta"].values[kept & (sun["n_lit"].values > CHECKING_PANELS)]
    low, high = _largest_of(checked) if checked.size else (np.nan, np.nan)
    made = "the telemetry is synthetic: its noise was chosen for this figure; "
    chosen = made if sun.attrs.get("synthetic") else ""
    judged: dict[str, Any] = {}
    if checked.size:
        inside = bool(low <= case.published["delta_max"].value <= high)
        judged = {"tolerance": high - low, "agrees": inside, "low": low, "high": high}
    return [
        row(
            case,
            "delta_mean",
            float(delta.mean()),
            sigma=float(delta.std() / np.sqrt(delta.size)),
            chosen=chosen,
            directions=delta.size,
            of_three=delta.size - checked.size,
        ),
        row(
            case,
            "delta_max",
            float(delta.max()),
            checked=checked.size,
            least=low,
            most=high,
            **judged,
        ),
    ]


def _largest_of(delta: np.ndarray) -> tuple[float, float]:
    """5 and 95 % of the largest of as many absolute values of a Gaussian as `delta` (n), with its mean."""
    sigma = float(delta.mean()) * np.sqrt(np.pi / 2)
    low, high = (float(sigma * ndtri((1 + q ** (1 / delta.size)) / 2)) for q in (0.05, 0.95))
    return low, high


def _health_rows(r: Phases) -> list[Row]:
    case, health = r.case, r.health
    published = {
        frozenset(map(str, pattern)) for pattern in case.published["lit_patterns_at_rest"].value
    }
    ours = {frozenset(pattern) for pattern in health["impossible"]}
    made = "synthetic telemetry, made with panel 1 in shadow at rest" if r.synthetic else ""
    explained = [list(panels) for panels in health["explanations"]]
    return [
        row(
            case,
            "lit_patterns_at_rest",
            sorted(map(sorted, ours)),
            published=sorted(map(sorted, published)),
            agrees=bool(published <= ours),
            made=made,
        ),
        row(
            case,
            "shadowed_panel",
            explained,
            published=[["1"]],
            agrees=bool(explained == [["1"]]),
            made=made,
        ),
        _rotation_row(r, made),
    ]


def _rotation_row(r: Phases, made: str) -> Row:
    """Whether turning panel 1 to the Sun was a risk: what the samples at rest say of it."""
    needed = [
        pattern
        for pattern in r.health["impossible"]
        if explanations(r.case.vehicle, [pattern]) == [("1",)]
    ]
    count = sum(r.health["impossible"][pattern] for pattern in needed)
    return row(
        r.case, "panel_1_rotation", count, agrees=count > 0, made=f"; {made}" if made else ""
    )


def _sampling_rows(r: Phases) -> list[Row]:
    """How often the file samples: between first touchdown and collision, and from there to the second touchdown."""
    time = r.sun["time"].values
    touchdown, collision, second = (
        case_seconds(r.case, r.sun, name)
        for name in ("first_touchdown", "collision", "second_touchdown")
    )
    flight, whose = (
        (time >= touchdown) & (time < collision),
        "synthetic telemetry, made so" if r.synthetic else "the telemetry",
    )
    several = flight.sum() > 1
    interval = float(np.median(np.diff(time[flight]))) / 60 if several else None
    unjudged: dict[str, Any] = {} if several else {"tolerance": None}
    return [
        row(r.case, "sampling_interval", interval, whose=whose, **unjudged),
        row(
            r.case,
            "samples_after_collision",
            int(np.count_nonzero((time >= collision) & (time < second))),
            whose=whose,
        ),
    ]
