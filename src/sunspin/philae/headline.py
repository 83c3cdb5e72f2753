"""The study of Philae in sentences: the headline for somebody who has a minute, the score, and the conclusions.

Nothing is said that does not follow from the telemetry given, or is called the record's (times of events) or the paper's.
"""

from __future__ import annotations

import numpy as np

from sunspin.output.text import period_text
from sunspin.philae import touchdown
from sunspin.philae.study import Study
from sunspin.philae.threshold import CONFIDENCE


def headline(study: Study) -> list[str]:
    """What happened, how sure that is, what it rests on: a sentence each."""
    chain, check, fit = study.chain, study.parts["carries"], study.parts.get("descent")
    if fit is None:
        descent = "Descent: too few samples to estimate the rotation."
    elif not check.descent_order or not check.one_sun:
        descent = "Descent: the rotation does not follow from this telemetry."
    else:
        rate = float(np.mean(fit.rate_range(fit.fit.coefficients)))
        descent = f"Descent: rotation period {period_text(rate)}."
    synthetic = (
        "The panel powers measured in flight are not public. This run uses synthetic ones made from published facts: it tests "
        "the method and does not measure Philae again."
    )
    measured = "The panel powers were read from a file that does not call itself synthetic."
    origin = synthetic if study.synthetic else measured
    if chain is None:
        missing = study.missing
        failed = missing.get("level_set", missing.get("candidates", "no motion was found"))
        reason = failed.split(" as ", 1)[-1].split(";")[0].rstrip(".")
        why = "; ".join(check.reasons) or reason
        motion = f"After the first touchdown: the motion cannot be concluded, as {why}."
        return [descent, motion, "No conclusions on touchdown, collision and landing.", origin]

    slow, fast = chain.chosen.speed_range()
    if chain.name == "published":
        motion = "After the first touchdown: the motions are those of the published lines, for any telemetry."
    elif chain.chosen.probable:
        motion = f"Just after the first touchdown: angular speed {slow:.3g} to {fast:.3g} rad/s ({CONFIDENCE:.0%})."
    elif not touchdown.bounded(chain):
        motion = "After the first touchdown: the data are also consistent with no rotation."
    else:
        motion = (
            f"After the first touchdown: rotation period at most {period_text(slow)} "
            f"({chain.case.assumptions.study.confidence:.0%} confidence); the data give no lower limit on the period."
        )
    if (calibration := chain.calibration) is None:
        verdict = f" {chain.verdict.rstrip('.')}." if chain.verdict else ""
        extent = f"The motions are {chain.chosen.about}.{verdict}"
    else:
        extent = (
            f"The {calibration.confidence:.0%} confidence set contains {chain.share:.0%} of the scanned initial rates (EMD below "
            f"{calibration.factor()[0]:.2f} times the minimum; calibrated on {len(calibration.ratio)} simulated data sets)."
        )
    return [descent, motion, extent, touchdown.sentences(chain)[0], origin]


def score(study: Study) -> list[str]:
    """The score in lines: tests on this telemetry, tests without any, what else there is."""
    of_section = study.counts()
    here, lines, paper = (of_section[name] for name in ("telemetry", "no_telemetry", "paper"))
    put_in, arithmetic, not_comparable = (
        sum(counts[kind] for counts in of_section.values())
        for kind in ("put_in", "arithmetic", "not_comparable")
    )
    return [
        f"Comparison with the paper, using this telemetry: {here['agree']} agree, {here['differ']} differ, "
        f"{here['uninformative']} not constrained",
        f"Comparison with the paper, equations only: {lines['agree'] + paper['agree']} agree, "
        f"{lines['differ'] + paper['differ']} differ",
        f"Not counted as tests: {put_in} inputs, {arithmetic} checks of the paper's arithmetic, {not_comparable} not comparable",
    ]


def conclusions(study: Study) -> list[str]:
    """What the headline rests on, a sentence each; what differs from the paper or could not be computed."""
    sentences = [study.parts["carries"].first_line, f"Readings: {study.noise.about}."]
    if (chain := study.chain) is not None:
        if chain.calibration is not None:
            sentences.append(f"The confidence set: EMD below {chain.calibration}.")
        sentences += touchdown.sentences(chain)[1:]
    differ = [row for row in study.rows if row.agrees is False]
    texts = [f"{row.what} ({row.source.removeprefix('paper, ')})" for row in differ]
    if texts:
        sentences.append(f"Not as published: {'; '.join(texts)}.")
    return sentences + [f"{why.rstrip('.')}." for why in study.missing.values()]
