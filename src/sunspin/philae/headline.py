"""What the study of Philae found, in sentences: the headline for somebody who has a minute, and the conclusions beside it.

Nothing is said that does not follow from the telemetry given, or is called the record's (times of events) or the paper's.
"""

from __future__ import annotations

import numpy as np

from sunspin.output.text import number_text, turn_text
from sunspin.philae import touchdown
from sunspin.philae.candidates import Chain
from sunspin.philae.study import Reproduction
from sunspin.philae.threshold import CONFIDENCE


def headline(study: Reproduction) -> list[str]:
    """What happened, how sure that is, what it rests on: a sentence each."""
    chain = study.chain
    if chain is None:
        reasons = study.parts["carries"].reasons
        missing = study.missing
        told = missing.get("candidates", missing.get("level_set", "no motion was found"))
        why = "; ".join(reasons) or told.split(" as ", 1)[-1].split(";")[0].rstrip(".")
        sure = [
            f"After the first touchdown: the motion cannot be concluded, as {why}.",
            "No conclusions on touchdown, collision and landing.",
        ]
    else:
        sure = [_rebound(chain), _extent(chain), touchdown.sentences(chain)[0]]
    synthetic = (
        "The flown panel powers are not public. This run uses synthetic ones made from published facts: it tests the method and "
        "does not measure Philae again."
    )
    measured = "The panel powers were read from a file that does not call itself synthetic."
    return [_descent(study), *sure, synthetic if study.synthetic else measured]


def _descent(study: Reproduction) -> str:
    if "descent" not in study.parts:
        return "Descent: too few samples to estimate the rotation."
    if not study.parts["carries"].descent_order or not study.parts["carries"].one_sun:
        return "Descent: the rotation does not follow from this telemetry."
    rate = float(np.mean(study.parts["descent"].rate_range()))
    return f"Descent: rotation period {turn_text(rate)}."


def _rebound(chain: Chain) -> str:
    slow, fast = chain.chosen.speed_range()
    if chain.name == "published":
        return "After the first touchdown: the motions are those of the published lines, for any telemetry."
    if chain.chosen.probable:
        return f"Just after the first touchdown: angular speed {slow:.3g} to {fast:.3g} rad/s ({CONFIDENCE:.0%})."
    if not touchdown.bounded(chain):
        return "After the first touchdown: the data are also consistent with no rotation."
    level = f"{chain.case.assumptions.study.confidence:.0%}"
    return (
        f"After the first touchdown: rotation period at most {turn_text(slow)} ({level} confidence); the data give no lower limit "
        "on the period."
    )


def _extent(chain: Chain) -> str:
    calibration = chain.calibration
    if calibration is None:
        verdict = f" {chain.verdict.rstrip('.')}." if chain.verdict else ""
        return f"The motions are {chain.chosen.about}.{verdict}"
    return (
        f"The {calibration.confidence:.0%} confidence set contains {chain.share:.0%} of the scanned initial rates (EMD below "
        f"{calibration.factor()[0]:.2f} times the minimum; calibrated on {len(calibration.ratio)} simulated flights)."
    )


def score(study: Reproduction) -> list[str]:
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


def conclusions(study: Reproduction) -> list[str]:
    """What follows from the telemetry; what the printed lines give without any; what differs or could not be computed."""
    sentences = [study.parts["carries"].first_line, f"Readings: {study.noise.told}."]
    if "level_set" in study.parts:
        sentences.append(_of_scan(study))
    if study.chain is not None:
        sentences += touchdown.sentences(study.chain)
    sentences += _of_lines(study)
    apart = [
        f"{row.what} ({row.source.removeprefix('paper, ')})"
        for row in study.rows
        if row.agrees is False
    ]
    if apart:
        sentences.append(f"Not as published: {'; '.join(apart)}.")
    return sentences + [f"{why.rstrip('.')}." for why in study.missing.values()]


def _of_scan(study: Reproduction) -> str:
    scanned, chain = study.parts["level_set"], study.chain
    text = (
        f"Against the {scanned.rebound.z.size} reconstructed directions of this telemetry between touchdown and collision the "
        f"smallest EMD is {scanned.smallest:.4f}; {len(scanned.near.points)} grid points lie within "
        f"{scanned.near.factor} times it, and {scanned.lines_found} of the four printed lines come out of them"
    )
    if scanned.truth:
        text += (
            f". At the true rate behind the synthetic telemetry it is {scanned.truth['emd']:.4f}"
        )
    if chain is not None and chain.calibration is not None:
        text += (
            f". For {100 * chain.calibration.confidence:g} %: {chain.calibration}; that set holds {chain.share:.0%} of the "
            "scanned box"
        )
    return text + "."


def _of_lines(study: Reproduction) -> list[str]:
    """What the printed lines give, which no telemetry changes."""
    lowest = study.row("rate_at_touchdown_min_lines")
    sentences = [
        f"Without telemetry: motions on the four printed lines turn at {number_text(lowest.ours)} rad/s or faster after the first "
        f"touchdown (published: {number_text(lowest.published)}; {number_text(lowest.low, 4)} to "
        f"{number_text(lowest.high, 4)} with the first sample's time and the wheel's speed uncertain)."
    ]
    clean = study.parts["published_lines"].clean
    if distances := [deviation["mean"] for deviation in clean.deviation]:
        sentences.append(
            f"Against those lines' own distribution of r_z the scan finds four lines that are {min(distances):.3f} to "
            f"{max(distances):.3f} rad/s from the printed ones on average (grid step "
            f"{study.case.published['scan_step'].value} rad/s)."
        )
    return sentences
