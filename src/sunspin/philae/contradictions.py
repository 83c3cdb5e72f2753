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
from sunspin.philae.row import Row, statement
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
        *_direction_rows(case), *motion.model_rows(case), *_time_rows(case), *_descent_rows(case),
        *motion.precession_rows(case, result.lines), *motion.collision_rows(case, result.lines), *motion.rest_rows(case),
        *_text_rows(case),
    ]  # fmt: skip


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
        statement(
            "first_direction_length",
            "second quoted value of the first Sun direction after the touchdown: its length, and its angle from the other value",
            [1.0, 0.0], [length, apart], "1, deg", [1e-3, 1.0], "section 2.3",
            sentence="the study of E starts from \"the first measured direction of the Sun after TD1\", "
            f"{list(published['first_sun_E_study'])}; the scan starts from the direction of \"the first solar panel power "
            f"measurement\", {list(published['first_sun'])}.",
            other_reading="Two reconstructions of one sample might differ by as much as the directions err (the row on Delta and "
            f"E), but a direction has length one. If only z is misprinted, {other_z[2]:.4f} gives length one, and the two are "
            f"still {_degrees_between(first, other_z):.1f} deg apart.",
            changes=f"Used as printed, the second value keeps E above {(1 - length) / 2:.4f} whatever the motion, so no point of "
            f"Fig. 8 can fit as well as the descent did (E = {published['descent_E']}). Fig. 8 only illustrates why E was not "
            "used.",
            note="The angle is that of the unit vectors. Each part here uses the value quoted for it.",
        ),
        statement(
            "two_errors", "direction error that Delta and E each suggest: mean Delta as an angle, and the rms angle of E",
            float(np.degrees(published["delta_mean"])), rms, "deg", None, "sections 2.1 and 3.1", weak=True,
            sentence="Delta \"can be used to estimate the reliability of the reconstruction\", and its mean of "
            f"{published['delta_mean']} \"indicates a fairly reliable reconstruction\"; the fit of the descent has E = "
            f"{published['descent_E']}.",
            other_reading="The two measure different things, so no figure is wrong: Delta is the part of the error of the powers "
            "that no Sun direction can explain, and E also contains errors of the fitted motion. The paper itself announces "
            "further tests.",
            changes=f"The directions may be wrong by {rms:.0f} deg rms. Delta alone suggests an error several times smaller and "
            "should not be used as the error of a direction.",
        ),
    ]  # fmt: skip


def _descent_spacing_s(case: Case) -> float:
    """Mean time (s) between the samples of the descent's fit."""
    first, last = case.published["descent_samples"].value
    return 3600.0 * case.published["descent_span"].value / (last - first)


def _time_rows(case: Case) -> list[Row]:
    published, between = {key: figure.value for key, figure in case.published.items()}, case.require_timeline().seconds
    descent = _descent_spacing_s(case) / 60
    minutes, samples = published["duration_after_collision"], published["samples_after_collision"]
    usual, flight, stated = (
        published["sampling_interval"], between("first_touchdown", "collision") / 60, published["window_before_collision"]
    )  # fmt: skip
    z = published["nz_descent"]
    around = np.linspace(0.0, 2 * np.pi, TURN_POINTS, endpoint=False)
    seen = turned([np.sqrt(1 - z**2), 0.0, z], [0, 0, 1], around)
    share = float(np.mean(allows(reconstructible_mask(case.vehicle), seen)))
    first, last = published["descent_samples"]
    return [
        statement(
            "sampling_descent", "mean time between samples: during the descent, and after the collision", [usual, usual],
            [descent, minutes / samples], "min", 0.5, "sections 1, 3.1 and 3.3", weak=True,
            sentence=f"the powers were sampled at \"an approximate rate of {usual:g} min/sample\", but measurements {first} to "
            f"{last} span \"about six and a half hours\", and there are {samples} measurements in the {minutes:g} min after the "
            "collision.",
            other_reading=f"If the numbers count only the samples that allow a reconstruction, {100 * share:.1f} % of a turn "
            f"during the descent, the descent was sampled every {descent * share:.2f} min. \"Available\" may mean that other "
            "samples after the collision were lost. The paper says neither.",
            changes="The interval decides which rates of the descent can be told apart. The number of samples between touchdown "
            "and collision is not given; the synthetic telemetry assumes 23, at 2 min.",
        ),
        statement(
            "window", "time from the first touchdown to the collision", stated, flight, "min", 1.0,
            "section 2.3, direct fitting, and Table 1", weak=True,
            sentence=f"\"the long time window ({stated:g} minutes between TD1 and the next collision)\" makes E sensitive; by "
            "Table 1 it is 46 min.",
            other_reading=f"A round figure in an explanation: the same paragraph has {published['window_first_sample']:g} min "
            "from the first sample to the collision, and the simulations use that.",
            changes="Nothing that was computed. In the explanation, phase errors from friction, which grow with the square of "
            f"the window, are {(flight / stated) ** 2:.2f} times larger.",
        ),
    ]  # fmt: skip


def _descent_rows(case: Case) -> list[Row]:
    published, between = {key: figure.value for key, figure in case.published.items()}, case.require_timeline().seconds
    cubic, duration = np.array(published["descent_rate_cubic"]), 3600.0 * published["descent_span"]
    t = np.linspace(0.0, duration, CUBIC_POINTS)
    rate = np.polynomial.polynomial.polyval(t, cubic)
    low, high = published["descent_rate_range"]
    rounding = float(np.polynomial.polynomial.polyval(duration, HALF_DIGITS))
    inside = float(np.mean((rate >= low - 0.5e-5) & (rate <= high + 0.5e-5)))
    wheel, inertia = case.vehicle.wheels[0], case.vehicle.require_inertia()
    change = [float(inertia[2, 2] * span / wheel.inertia_kg_m2) for span in (high - low, np.ptp(rate))]
    early, spacing = between("descent_fit_begins", "unfolding_ends"), _descent_spacing_s(case)
    number = published["descent_samples"][0]
    interval = 60.0 * published["sampling_interval"]
    tied = cubic[0] + 2 * np.pi / interval * np.array([-1, 0, 1])
    regular, z = interval * np.arange(ALIASES), published["nz_descent"]
    seen = turned([np.sqrt(1 - z**2), 0.0, z], [0, 0, 1], cubic[0] * regular)
    worst = max(error_of_rate([one], regular, seen) for one in tied)
    return [
        statement(
            "cubic_range", "smallest and largest rate of the printed cubic over the span of the fit", [low, high],
            [float(rate.min()), float(rate.max())], "rad/s", 1e-5, "section 3.1",
            sentence=f"the coefficients of the fitted rate are printed, and the rate \"varies in the range of {low}...{high}\".",
            other_reading=f"Rounding of the four printed coefficients moves the rate by {rounding:.1e} rad/s at most. The printed "
            f"range holds for {100 * inside:.0f} % of the span only. Whether a coefficient or the range is misprinted cannot be "
            f"decided: the magnetometer's {published['descent_rate_romap']} rad/s is within 1 % of the middle of both.",
            changes=f"If the coefficients are right, the wheel's speed changed by {change[1]:.1f} instead of {change[0]:.1f} "
            f"rad/s during the descent, still little of {wheel.speed_rad_s:g} rad/s.",
            note=f"The largest rate is {t[np.argmax(rate)]:.0f} s after the start, the smallest at the end; the mean is "
            f"{rate.mean():.5f} rad/s.",
        ),
        statement(
            "descent_start", "first sample of the descent's fit, counted from the end of the unfolding", 0.0, -early / 60, "min",
            published["sampling_interval"], "section 3.1 and Table 1", weak=True,
            sentence="the fit begins with \"the first measurement after deployment of the legs\", at 08:50:30; Table 1 has the "
            "landing gear unfold until 09:01.",
            other_reading="The legs may have left the panels' light before the landing gear was fully unfolded. Or the clock "
            f"time is misprinted: at the mean interval of the fit, measurement {number} comes {(number - 1) * spacing / 60:.1f} "
            "min after the first; if that was at the separation (08:35), it falls at 09:01.",
            changes=f"If the times are right, about {early / spacing:.0f} of the fit's samples may still be shadowed by the legs.",
        ),
        statement(
            "descent_alias", f"rates about z that samples exactly {interval:g} s apart cannot distinguish", "one", tied.tolist(),
            "rad/s", None, "sections 1 and 3.1", weak=True,
            sentence="the powers were sampled \"on a regular time basis\", and the fit of the descent has \"a well-defined, "
            "unique optimum\".",
            other_reading=f"Among slow rates, below {np.pi / interval:.4f} rad/s, the optimum is unique, and the magnetometer "
            "confirms that the rotation was slow. Irregular sample times would also make it unique; they are not published.",
            changes="The panels determine the rate only together with a bound on it, or with irregular sample times.",
            note=f"E is at most {max(worst, 1e-15):.0e} for each of the three rates.",
        ),
    ]  # fmt: skip


def _text_rows(case: Case) -> list[Row]:
    published = {key: figure.value for key, figure in case.published.items()}
    return [
        statement(
            "promised_probability", "probability that such a landing harms the lander", "insight announced", "no number given", "1",
            None, "abstract", weak=True,
            sentence="the study \"gives insight into\" \"the probability that a similar landing scenario harms the operability "
            "of this type of spacecraft\".",
            other_reading="Insight need not be a number: section 4 concludes that there was \"a significant chance\" of damage "
            "and of an upside-down rest.",
            changes="The paper gives no probability to compare with. Here the rows on the first contact and on coming to rest "
            "have one.",
        ),
        statement(
            "section_5", "sections that are referred to, and those that have the content: the shadows, the amplitude of precession",
            [published["cited_section"], 2.3], [published["last_section"], 2.2], "section", 0.0, "sections 2.1 and 2.3", weak=True,
            sentence=f"shadowing is discussed \"in Sec. {published['cited_section']}\", and the amplitude of precession was found "
            "constant \"in Sec. 2.3\", which is the section that says so.",
            other_reading=f"Two numbers left over from an earlier draft: section {published['last_section']}, the last, discusses "
            "the shadows, and the end of section 2.2 the amplitude.",
            changes="Nothing.",
        ),
    ]  # fmt: skip
