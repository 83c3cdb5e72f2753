"""Where the paper is ambiguous or contradicts itself or public facts: each statement, recomputed, and what it changes.

The default of every other part is what the paper did; these rows stand beside. Here: measured directions, times, the descent,
what is announced and not given. The model, the collision and rest are in :mod:`sunspin.study.contradictions_motion`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.cases import Case
from sunspin.infer.metrics import emd
from sunspin.infer.spin import error_of_rate, turned
from sunspin.study import contradictions_motion as motion
from sunspin.study import rebound as rb
from sunspin.study.row import Row, statement
from sunspin.timeline import utc_seconds

ALIASES = 100
"""Regular samples on which three rates are shown to tie."""


@dataclass(frozen=True)
class Contradictions:
    """The case, and what of the motions on the published lines the statements need (`contradictions_motion.Lines`)."""

    case: Case
    lines: motion.Lines


def compute(case: Case) -> Contradictions:
    """A second of work: motions from points of the published lines to the collision."""
    return Contradictions(case, motion.lines(case))


def rows(result: Contradictions) -> list[Row]:
    """One row for each statement; `agrees` says whether it stands."""
    case = result.case
    return [
        *_direction_rows(case), *motion.model_rows(case), *_time_rows(case), *_descent_rows(case), *_study_rows(case),
        *motion.precession_rows(case, result.lines), *motion.collision_rows(case, result.lines), *motion.rest_rows(case),
        *_promise_rows(case),
    ]  # fmt: skip


def _direction_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    first, quoted = rb.first_sun(case), np.array(published["first_sun_E_study"])
    length = float(np.linalg.norm(quoted))
    apart = float(np.degrees(np.arccos(first @ quoted / length / np.linalg.norm(first))))
    rms = float(np.degrees(2 * np.arcsin(np.sqrt(published["descent_E"]))))
    return [
        statement(
            "first_direction_length", "length of the first direction after the touchdown as quoted for the study of E", 1.0, length,
            "1", 1e-3,
            f"changes: used as it stands E cannot fall below {(1 - length) / 2:.4f} whatever the motion; its z is 1/sqrt(2) to "
            f"the last "
            "digit", "section 2.3, direct fitting",
        ),
        statement(
            "first_direction_twice", "angle between the two first directions that are quoted for one sample", 0.0, apart, "deg",
            1.0,
            "the second made a unit vector; changes: the scan and the study of E begin from different skies. Each part here uses "
            "the "
            "one quoted for it", "section 2.3",
        ),
        statement(
            "two_errors", "rms direction error: what Delta tells and what E of the descent tells",
            float(np.degrees(published["delta_mean"])), rms, "deg", None,
            f"a Delta of {published['delta_mean']} turns a unit vector of powers by so much; E = {published['descent_E']} is the "
            "other. They measure different things, but the directions are several times worse than Delta alone suggests",
            "sections 2.1 and 3.1",
        ),
        statement(
            "emd_names", "change of EMD when the two distributions, named the wrong way round below the formula, are exchanged",
            0.0,
            abs(emd([0.1, 0.4, 0.9], [0.3, 0.8]) - emd([0.3, 0.8], [0.1, 0.4, 0.9])), "1", 1e-15,
            "the text calls C_r reconstructed and C_n simulated, elsewhere r is simulated and n measured; harmless",
            "section 2.3, eq. 13",
        ),
    ]  # fmt: skip


def _time_rows(case: Case) -> list[Row]:
    timeline = case.require_timeline()
    published, between = {key: figure.value for key, figure in case.published.items()}, timeline.seconds
    first, last = published["descent_samples"]
    descent_s = 3600.0 * published["descent_span"] / (last - first)
    after_s = 60.0 * published["duration_after_collision"] / published["samples_after_collision"]
    usual, flight = published["sampling_interval"], between("first_touchdown", "collision") / 60
    left = between("descent_fit_begins", "first_touchdown") - 3600.0 * published["descent_span"]
    refined = {event.name: (event.utc, event.refined_utc) for event in timeline.events if event.refined_utc}
    off = [abs(utc_seconds(utc, better)) for utc, better in refined.values()]
    return [
        statement(
            "sampling_descent", f"time between samples {first} and {last} of the descent, on average", usual, descent_s / 60, "min",
            0.5, "changes: the range of rates among which the descent's fit is unique", "sections 1 and 3.1",
        ),
        statement(
            "sampling_after_collision", "time between samples after the collision, on average", usual, after_s / 60, "min", 0.5,
            f"{published['samples_after_collision']} samples in {published['duration_after_collision']:g} min; the number between "
            "touchdown and collision is not given, 23 at 2 min are assumed for the synthetic telemetry", "sections 1 and 3.3",
        ),
        statement(
            "descent_end", "time left between the end of the descent's fit and the touchdown, six and a half hours after 08:50:30",
            0.0, left / 60, "min", usual, f"changes: {left / descent_s:.0f} samples at the fit's own rate are left out without a "
            f"word",
            "section 3.1",
        ),
        statement(
            "window", "first touchdown to collision, where the failure of E is explained", published["window_before_collision"],
            flight, "min", 1.0,
            f"Table 1; the same section has {published['window_first_sample']:g} min from the first sample on. Changes: phase "
            f"errors "
            f"by friction grow with the square of the window, {(flight / published['window_before_collision']) ** 2:.2f} times",
            "section 2.3, direct fitting",
        ),
        statement(
            "kernel_times", "largest difference of the events in Table 1 from the trajectory kernel", 0.0,
            max(off), "s", 0.5,
            "; ".join(f"{name} {better[11:]}" for name, (_, better) in refined.items()) + " UTC", "Table 1",
        ),
    ]  # fmt: skip


def _descent_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    cubic, duration = np.array(published["descent_rate_cubic"]), 3600.0 * published["descent_span"]
    rate = np.polynomial.polynomial.polyval(np.linspace(0.0, duration, 100_001), cubic)
    peak = float(np.linspace(0.0, duration, 100_001)[np.argmax(rate)])
    early = case.require_timeline().seconds("descent_fit_begins", "unfolding_ends")
    interval = 60.0 * published["sampling_interval"]
    tied = cubic[0] + 2 * np.pi / interval * np.array([-1, 0, 1])
    t = interval * np.arange(ALIASES)
    z = published["nz_descent"]
    seen = turned([np.sqrt(1 - z**2), 0.0, z], [0, 0, 1], cubic[0] * t)
    errors = [error_of_rate([one], t, seen) for one in tied]
    half_digit = 0.5e-5 * duration
    even = np.linspace(0.0, duration, 400)
    shifted = error_of_rate([cubic[0] + 0.5e-5], even, turned(seen[0], [0, 0, 1], cubic[0] * even))
    fixed = (1 - z**2) * float(np.mean(1 - np.cos(0.5e-5 * even))) / 2
    return [
        statement(
            "cubic_range", "smallest and largest rate of the printed cubic over the span of the fit",
            list(published["descent_rate_range"]), [float(rate.min()), float(rate.max())], "rad/s", 1e-5,
            f"largest {peak:.0f} s after the start, smallest at the end; the printed range holds only the constant term. "
            f"Changes: the "
            "change of the wheel's speed that it implies", "section 3.1",
        ),
        statement(
            "cubic_rounding", "E that half a unit of the last printed digit of omega_0 can make", 0.0, float(shifted), "1",
            published["descent_E"] / 10,
            f"{half_digit:.2f} rad at the end, direction at the start chosen best; {fixed:.4f} with the direction at the start "
            f"as it "
            "was. The published E can be recomputed from the printed coefficients to no better than this", "section 3.1",
        ),
        statement(
            "descent_start", "t = 0, called the first sample after the unfolding: time from the end of the unfolding in Table 1",
            0.0,
            -early / 60, "min", published["sampling_interval"],
            "08:50:30 against 09:01; changes: samples in between may still be shadowed. By the rule on Delta used here they are "
            "not "
            "in the synthetic telemetry, of which nothing follows for the flown one", "section 3.1 and Table 1",
        ),
        statement(
            "descent_alias", f"rates about z that samples exactly {interval:g} s apart cannot tell from the published one", "none",
            tied.tolist(), "rad/s", None,
            f"E {max(errors):.0e} or less for each; the optimum is unique only among rates below pi over the interval, "
            f"{np.pi / interval:.4f} rad/s, or for irregular times", "section 3.1",
        ),
    ]  # fmt: skip


def _study_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    box, omega = np.array(published["E_study_box"]), np.array(published["E_study_omega"])
    inertia, mu_0 = case.vehicle.require_inertia(), case.vehicle.wheels[0].friction.coulomb_N_m
    low, high = published["E_study_coulomb"]
    outside = np.maximum(np.maximum(box[:, 0] - omega, omega - box[:, 1]), 0.0)
    away = [_from_lines(case, point) for point in (box.mean(axis=1), omega)]
    return [
        statement(
            "study_mu_0", "Fig. 8 B: how far the lander's mu_0 is below the range that is varied", 0.0,
            max(low - mu_0, mu_0 - high, 0.0),
            "N m", 1e-9, f"mu_0 = {mu_0:.4g} N m, range {low:g} to {high:g}; changes: the map does not hold the vehicle it is "
            f"about",
            "Fig. 8 B",
        ),
        statement(
            "study_theta", "Fig. 8 B: range called theta_xx beside theta_yy and theta_xx of Table 2",
            list(published["E_study_inertia"]),
            [float(inertia[1, 1]), float(inertia[0, 0])], "kg m2", None,
            "the same two numbers: what is called a range of theta_xx runs from the one moment of inertia to the other",
            "Fig. 8 B and Table 2",
        ),
        statement(
            "study_omega", "Fig. 8 B: distance of its rate from the box of panel A, along omega_x, omega_y, omega_z",
            [0.0, 0.0, 0.0],
            outside.tolist(), "rad/s", 1e-6, "the two panels share no point", "Fig. 8",
        ),
        statement(
            "study_lines", "distance of the middle of panel A and of the rate of panel B from the nearest published line",
            [0.0, 0.0],
            away, "rad/s", 0.05, "changes: the sensitivity is shown for motions that the paper itself rules out; on the lines it "
            "is "
            "as strong (see the rows on one percent)", "Fig. 8 and section 2.3",
        ),
    ]  # fmt: skip


def _from_lines(case: Case, omega: np.ndarray) -> float:
    return min(float(np.linalg.norm(np.cross(omega - point, along))) for point, along in rb.published_lines(case))


def _promise_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    return [
        statement(
            "promised_probability", "probability that such a landing harms the lander, announced in the abstract", "announced",
            "not given there", "1", None,
            "the text asks and gives no number; computed here: the rows on the first contact and on coming to rest", "abstract",
        ),
        statement(
            "section_5", "section cited for the unmodelled shadows, and the last that there is", published["cited_section"],
            published["last_section"], "1", 0.0, "section 4 has the discussion that is meant", "section 2.1",
        ),
        statement(
            "own_section", "where the constancy of the amplitude of precession is shown, cited from section 2.3 as section 2.3",
            "2.3",
            "2.2", "section", None, "a section that cites itself; the finding is at the end of section 2.2", "section 2.3",
        ),
    ]  # fmt: skip
