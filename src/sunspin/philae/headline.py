"""The study of Philae in sentences: the headline, the score and the conclusions.

Every sentence follows from the telemetry given, or names the record (times of events) or the paper as its source.
"""

from __future__ import annotations

import numpy as np

from sunspin.output.text import period_text
from sunspin.philae import touchdown
from sunspin.philae.study import Study
from sunspin.philae.threshold import CONFIDENCE


def headline(study: Study) -> list[str]:
    """Return the main results as sentences: descent, motion after the touchdown, their extent, and the origin of the telemetry."""
    candidate_sets, check, fit = (
        study.candidate_sets,
        study.parts["carries"],
        study.parts.get("descent"),
    )
    if fit is None:
        descent = "Descent: too few samples to estimate the rotation."
    elif not check.descent_has_spin or not check.consistent_with_sun:
        descent = "Descent: the rotation does not follow from this telemetry."
    else:
        middle_rate = float(np.mean(fit.rate_range(fit.fit.coefficients)))
        descent = f"Descent: rotation period {period_text(middle_rate)}."
    synthetic = (
        "The panel powers measured in flight are not public. This run uses synthetic ones made from published facts: it tests "
        "the method and does not measure Philae again."
    )
    measured = "The panel powers were read from a file that does not call itself synthetic."
    origin = synthetic if study.synthetic else measured
    if candidate_sets is None:
        # why the scan failed, else why no candidates could be selected from it
        missing = study.missing
        failed = missing.get("level_set", missing.get("candidates", "no motion was found"))
        # "STEP: not reproduced, as REASON; got ...": only the reason is repeated
        reason = failed.split(" as ", 1)[-1].split(";")[0].rstrip(".")
        why = (
            "; ".join(check.reasons) or reason
        )  # the data check explains more than its consequence
        motion = f"After the first touchdown: the motion cannot be concluded, as {why}."
        return [descent, motion, "No conclusions on touchdown, collision and landing.", origin]

    slow, fast = candidate_sets.chosen.speed_range()
    if candidate_sets.source == "published":
        motion = "After the first touchdown: the motions are those of the published lines, for any telemetry."
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
        extent = f"The motions are {candidate_sets.chosen.about}.{verdict}"
    else:
        extent = (
            f"The {calibration.confidence:.0%} confidence set contains {candidate_sets.share:.0%} of the scanned initial rates "
            f"(EMD below "
            f"{calibration.factor()[0]:.2f} times the minimum; calibrated on {len(calibration.ratio)} simulated data sets)."
        )
    return [descent, motion, extent, touchdown.describe_motion(candidate_sets)[0], origin]


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
        f"Not counted as tests: {put_in} inputs, {arithmetic} checks of the paper's arithmetic, {not_comparable} not comparable",
    ]


def conclusions(study: Study) -> list[str]:
    """Return the evidence for the headline as sentences, then what differs from the paper and what could not be computed."""
    sentences = [study.parts["carries"].first_line, f"Readings: {study.noise.about}."]
    if (candidate_sets := study.candidate_sets) is not None:
        if candidate_sets.calibration is not None:
            sentences.append(f"The confidence set: EMD below {candidate_sets.calibration}.")
        sentences += touchdown.describe_motion(candidate_sets)[1:]
    differ = [row for row in study.rows if row.agrees is False]
    texts = [f"{row.what} ({row.source.removeprefix('paper, ')})" for row in differ]
    if texts:
        sentences.append(f"Not as published: {'; '.join(texts)}.")
    return sentences + [f"{why.rstrip('.')}." for why in study.missing.values()]
