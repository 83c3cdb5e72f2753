"""The study of Philae in sentences: the headline, the score and the conclusions.

Every sentence follows from the telemetry given, or names the record (times of events) or the paper as its source.
"""

from __future__ import annotations

import numpy as np

from sunspin.output.text import period_text
from sunspin.philae import timing, touchdown
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.rebound import published_lines, read_truth
from sunspin.philae.study import Study
from sunspin.philae.threshold import CONFIDENCE


def headline(study: Study) -> list[str]:
    """Return the main results in sentences: descent, the three acts of the study, and the origin of the telemetry.

    The acts are the paper's method, what it cannot say, and what the times of the samples add. Without conclusions on the motion
    two sentences say why there are none.
    """
    synthetic = (
        "The panel powers measured in flight are not public. This run uses synthetic ones made from published facts: it tests "
        "the method and does not measure Philae again."
    )
    measured = "The panel powers were read from a file that does not call itself synthetic."
    origin = synthetic if study.synthetic else measured
    scan, candidate_sets = study.scan.result, study.candidate_sets.result
    if scan is None or candidate_sets is None:
        return [_descent_sentence(study), *_without_conclusions(study), origin]
    acts = [_method_sentence(study, scan, candidate_sets), _limits_sentence(candidate_sets)]
    if study.timing.result is not None:
        acts.append(timing.describe(study.timing.result))
    numbered = [f"{number}. {act}" for number, act in enumerate(acts, 1)]
    return [_descent_sentence(study), *numbered, origin]


def _descent_sentence(study: Study) -> str:
    """Return the rotation period of the descent in a sentence, or why there is none."""
    check, fit = study.check.get(), study.descent.result
    if fit is None:
        return "Descent: too few samples to estimate the rotation."
    if not check.descent_has_spin or not check.consistent_with_sun:
        return "Descent: the rotation does not follow from this telemetry."
    middle_rate = float(np.mean(fit.rate_range(fit.fit.coefficients)))
    return f"Descent: rotation period {period_text(middle_rate)}."


def _without_conclusions(study: Study) -> list[str]:
    """Return two sentences for telemetry from which no motion after the touchdown follows."""
    error = study.candidate_sets.error
    problem = error.problem if error else "no motion was found"
    # the data check explains more than its consequence
    why = "; ".join(study.check.get().reasons) or problem.rstrip(".")
    motion = f"After the first touchdown: the motion cannot be concluded, as {why}."
    return [motion, "No conclusions on touchdown, collision and landing."]


def _method_sentence(study: Study, scan: TelemetryScan, candidate_sets: CandidateSets) -> str:
    """Return the first act: what the paper's own recipe gives with this telemetry, compared with the published figures."""
    published = study.case.published
    rows = {row.id: row for row in study.rows}
    lines = len(published_lines(study.case))
    text = (
        f"The paper's method: smallest EMD {scan.smallest:.4f} (paper {published['emd_min'].value}); "
        f"{scan.lines_recovered} of the {lines} published lines come out of the motions below {scan.near.factor:g} times it"
    )
    if scan.near.deviation:
        apart = [deviation["mean"] for deviation in scan.near.deviation]
        text += f" (mean distances {min(apart):.3f} to {max(apart):.3f} rad/s)"
    least = float(candidate_sets.near_minimum.speed_touchdown.min())
    text += (
        f"; smallest angular speed just after the touchdown {least:.3f} rad/s (paper "
        f"{published['rate_at_touchdown_min'].value})"
    )
    if "rz_range_wheel_off" in rows:
        low, high = rows["rz_range_wheel_off"].ours
        text += (
            f"; after the collision r_z from {low:.2f} to {high:.2f} with the wheel off (paper: -1 to 1), down to "
            f"{rows['rz_min_wheel_held'].ours:.2f} with the wheel held (paper: never below "
            f"{published['rz_min_wheel_held'].value})"
        )
    if read_truth(study.case):
        text += ". The built-in telemetry was selected for the lines and this EMD, so that they test nothing"
    return f"{text}."


def _limits_sentence(candidate_sets: CandidateSets) -> str:
    """Return the second act: what remains possible if the threshold of the method is calibrated."""
    slow, fast = candidate_sets.chosen.speed_range()
    angles = touchdown.describe_motion(candidate_sets)[0]
    if candidate_sets.source == "published":
        motion = "The motions are those of the published lines, for any telemetry."
    elif candidate_sets.chosen.from_posterior:
        motion = f"Just after the first touchdown: angular speed {slow:.3g} to {fast:.3g} rad/s ({CONFIDENCE:.0%})."
    elif not touchdown.has_lower_bound(candidate_sets):
        motion = "After the first touchdown: the data are also consistent with no rotation."
    else:
        motion = (
            f"After the first touchdown: rotation period at most {period_text(slow)} "
            f"({candidate_sets.case.assumptions.study.confidence:.0%} confidence); the data give no lower limit on the period."
        )
    if (calibration := candidate_sets.calibration) is None:
        verdict = f" {candidate_sets.verdict.rstrip('.')}." if candidate_sets.verdict else ""
        return f"The chosen motions: {candidate_sets.chosen.about}.{verdict} {motion} {angles}"
    return (
        f"What it cannot say: the {calibration.confidence:.0%} confidence set contains {candidate_sets.share:.0%} of the scanned "
        f"initial rates (EMD below {calibration.factor()[0]:.2f} times the minimum; calibrated on {len(calibration.ratio)} "
        f"simulated data sets). {motion} {angles}"
    )


def score(study: Study) -> list[str]:
    """Return three lines: tests on this telemetry, tests without telemetry, and the rows that are not tests."""
    by_section = study.counts()
    telemetry, equations, paper = (
        by_section[name] for name in ("telemetry", "no_telemetry", "paper")
    )
    put_in, arithmetic, not_comparable = (
        sum(counts[kind] for counts in by_section.values())
        for kind in ("put_in", "arithmetic", "not_comparable")
    )
    return [
        f"Comparison with the paper, using this telemetry: {telemetry['agree']} agree, {telemetry['differ']} differ, "
        f"{telemetry['uninformative']} not constrained",
        f"Comparison with the paper, equations only: {equations['agree'] + paper['agree']} agree, "
        f"{equations['differ'] + paper['differ']} differ",
        f"Not counted as tests: {put_in} figures from which the telemetry was made or selected, {arithmetic} checks of the paper's "
        f"arithmetic, {not_comparable} not comparable",
    ]


def conclusions(study: Study) -> list[str]:
    """Return the evidence for the headline as sentences, then what differs from the paper and what could not be computed."""
    sentences = [study.check.get().first_line, f"Readings: {study.noise.about}."]
    if (candidate_sets := study.candidate_sets.result) is not None:
        if candidate_sets.calibration is not None:
            sentences.append(f"The confidence set: EMD below {candidate_sets.calibration}.")
        sentences += touchdown.describe_motion(candidate_sets)[1:]
    differ = [row for row in study.rows if row.agrees is False]
    texts = [f"{row.what} ({row.source.removeprefix('paper, ')})" for row in differ]
    if texts:
        sentences.append(f"Not as published: {'; '.join(texts)}.")
    return sentences + [f"{why.rstrip('.')}." for why in study.missing.values()]
