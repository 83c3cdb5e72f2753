"""Statements of the paper that contradict its own figures or public facts, each recomputed and read as fairly as possible.

Every other part does by default what the paper did; these rows stand beside it. Each names the paper's sentence, the fairest
other reading and what follows. Rows marked `weak` are matters of wording, harmless, or nearly explained by the other reading.
What only rounds, or what the paper never states, has no row. Here: measured directions, times, the descent, references. The
wheel, the motion before the collision, the collision and rest are in :mod:`sunspin.philae.contradictions_motion`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.estimate.spin import error_of_rate, turned
from sunspin.philae import contradictions_motion as motion
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

ALIASES = 100
"""Regular samples on which three rates are shown to fit equally well."""

CUBIC_POINTS = 100_001
TURN_POINTS = 3600

HALF_DIGITS = (0.5e-5, 0.5e-11, 0.5e-15, 0.5e-20)
"""Half a unit of the last printed digit of omega_0 to omega_3 (rad/s, rad/s2, rad/s3, rad/s4)."""


@dataclass(frozen=True)
class Contradictions:
    """The case, and what of the motions on the published lines the statements need (`contradictions_motion.Lines`)."""

    case: Case
    lines: motion.Lines


def compute(case: Case) -> Contradictions:
    """A second of work: motions from points of the published lines to the collision."""
    return Contradictions(case, motion.lines(case))


def rows(result: Contradictions) -> list[Row]:
    """One row for each statement; `holds` says whether it stands."""
    case = result.case
    return [
        *_direction_rows(case),
        *motion.model_rows(case),
        *_time_rows(case),
        *_descent_rows(case),
        *motion.precession_rows(case, result.lines),
        *motion.collision_rows(case, result.lines),
        *motion.rest_rows(case),
        *_text_rows(case),
    ]


def _degrees_between(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.degrees(np.arccos(a @ b / np.linalg.norm(a) / np.linalg.norm(b))))


def _direction_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    first, quoted = rb.first_sun(case), np.array(published["first_sun_E_study"])
    length = float(np.linalg.norm(quoted))
    apart = _degrees_between(first, quoted)
    other_z = np.array([*quoted[:2], np.sqrt(1 - quoted[:2] @ quoted[:2])])
    rms = float(np.degrees(2 * np.arcsin(np.sqrt(published["descent_E"]))))
    return [
        row(
            case,
            "contradiction_first_direction_length",
            [length, apart],
            quoted=list(published["first_sun_E_study"]),
            first=list(published["first_sun"]),
            other_z=other_z[2],
            still=_degrees_between(first, other_z),
            bound=(1 - length) / 2,
        ),
        row(
            case,
            "contradiction_two_errors",
            rms,
            published=float(np.degrees(published["delta_mean"])),
        ),
    ]


def _descent_spacing_s(case: Case) -> float:
    """Mean time (s) between the samples of the descent's fit."""
    first, last = case.published["descent_samples"].value
    return 3600.0 * case.published["descent_span"].value / (last - first)


def _time_rows(case: Case) -> list[Row]:
    published, between = (
        {key: figure.value for key, figure in case.published.items()},
        case.require_timeline().seconds,
    )
    descent = _descent_spacing_s(case) / 60
    minutes, samples = published["duration_after_collision"], published["samples_after_collision"]
    usual, flight, stated = (
        published["sampling_interval"],
        between("first_touchdown", "collision") / 60,
        published["window_before_collision"],
    )
    z = published["nz_descent"]
    around = np.linspace(0.0, 2 * np.pi, TURN_POINTS, endpoint=False)
    seen = turned([np.sqrt(1 - z**2), 0.0, z], [0, 0, 1], around)
    share = float(np.mean(allows(reconstructible_mask(case.vehicle), seen)))
    return [
        row(
            case,
            "contradiction_sampling_descent",
            [descent, minutes / samples],
            published=[usual, usual],
            share=100 * share,
            seen=descent * share,
        ),
        row(case, "contradiction_window", flight, published=stated, times=(flight / stated) ** 2),
    ]


def _descent_rows(case: Case) -> list[Row]:
    published, between = (
        {key: figure.value for key, figure in case.published.items()},
        case.require_timeline().seconds,
    )
    cubic, duration = np.array(published["descent_rate_cubic"]), 3600.0 * published["descent_span"]
    t = np.linspace(0.0, duration, CUBIC_POINTS)
    rate = np.polynomial.polynomial.polyval(t, cubic)
    low, high = published["descent_rate_range"]
    rounding = float(np.polynomial.polynomial.polyval(duration, HALF_DIGITS))
    inside = float(np.mean((rate >= low - 0.5e-5) & (rate <= high + 0.5e-5)))
    wheel, inertia = case.vehicle.wheels[0], case.vehicle.require_inertia()
    change = [
        float(inertia[2, 2] * span / wheel.inertia_kg_m2) for span in (high - low, np.ptp(rate))
    ]
    early, spacing = between("descent_fit_begins", "unfolding_ends"), _descent_spacing_s(case)
    number = published["descent_samples"][0]
    interval = 60.0 * published["sampling_interval"]
    tied = cubic[0] + 2 * np.pi / interval * np.array([-1, 0, 1])
    regular, z = interval * np.arange(ALIASES), published["nz_descent"]
    seen = turned([np.sqrt(1 - z**2), 0.0, z], [0, 0, 1], cubic[0] * regular)
    worst = max(error_of_rate([one], regular, seen) for one in tied)
    return [
        row(
            case,
            "contradiction_cubic_range",
            [float(rate.min()), float(rate.max())],
            published=[low, high],
            rounding=rounding,
            inside=100 * inside,
            change=change,
            wheel=wheel.speed_rad_s,
            largest_at=t[np.argmax(rate)],
            mean=rate.mean(),
        ),
        row(
            case,
            "contradiction_descent_start",
            -early / 60,
            tolerance=published["sampling_interval"],
            after=(number - 1) * spacing / 60,
            shadowed=early / spacing,
        ),
        row(
            case,
            "contradiction_descent_alias",
            tied.tolist(),
            interval=interval,
            slow=np.pi / interval,
            worst=max(worst, 1e-15),
        ),
    ]


def _text_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    return [
        row(case, "contradiction_promised_probability", "no number given"),
        row(
            case,
            "contradiction_section_5",
            [published["last_section"], 2.2],
            published=[published["cited_section"], 2.3],
        ),
    ]
