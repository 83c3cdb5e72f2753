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
            f"How it moved after the first touchdown cannot be concluded: {why}.",
            "So nothing is said of the touchdown, the collision and what followed.",
        ]
    else:
        sure = [_rebound(chain), _extent(chain), touchdown.sentences(chain)[0]]
    synthetic = (
        "The flown panel powers are not public: this run uses synthetic ones made from published facts, so it tests the method "
        "and does not measure Philae anew."
    )
    measured = "The panel powers were read from a file that does not call itself synthetic."
    return [_descent(study), *sure, synthetic if study.synthetic else measured]


def _descent(study: Reproduction) -> str:
    if "descent" not in study.parts:
        return "Of the descent this telemetry holds too little to say how the lander turned."
    if not study.parts["carries"].descent_order or not study.parts["carries"].one_sun:
        return "How the lander turned during the descent does not follow from this telemetry."
    rate = float(np.mean(study.parts["descent"].rate_range()))
    return f"During the descent the lander turned once in {turn_text(rate)}."


def _rebound(chain: Chain) -> str:
    slow, fast = chain.chosen.speed_range()
    if chain.name == "published":
        return "After the first touchdown it is taken to move as on the paper's printed lines, whatever this telemetry says."
    if chain.chosen.probable:
        return f"Just after the first touchdown it turned at {slow:.3g} to {fast:.3g} rad/s ({CONFIDENCE:.0%})."
    if slow <= chain.box.speed_range()[0] + touchdown.LEAST_STEP_RAD_S:
        return "After the first touchdown it need not have tumbled at all: a lander at rest fits as well."
    level = f"{chain.case.assumptions.study.confidence:.0%}"
    return (
        f"After the first touchdown it tumbled, at least once in {turn_text(slow)} ({level} confidence); this method gives no "
        "upper limit."
    )


def _extent(chain: Chain) -> str:
    found = chain.calibration
    if found is None:
        verdict = f" {chain.verdict.rstrip('.')}." if chain.verdict else ""
        return f"Its motion is taken from {chain.chosen.about}.{verdict}"
    return (
        f"{chain.share:.0%} of the scanned motions fit: their EMD is below {found.factor()[0]:.2f} times the smallest, a "
        f"threshold that kept the true motion in {found.confidence:.0%} of {found.n} synthetic flights like this one."
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
        f"Tests on this telemetry: {here['agree']} agree, {here['differ']} differ, {here['uninformative']} uninformative",
        f"Tests without telemetry (equations, printed lines): {lines['agree'] + paper['agree']} agree, "
        f"{lines['differ'] + paper['differ']} differ",
        f"No tests: {put_in} figures put in, {arithmetic} of the paper's own arithmetic, {not_comparable} not comparable",
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
        f"Against the {scanned.measured_z.size} reconstructed directions of this telemetry between touchdown and collision the "
        f"smallest EMD is {scanned.scan.smallest:.4f}; {len(scanned.near.points)} grid points lie within "
        f"{scanned.near.factor} times it, and {scanned.lines_found} of the four printed lines come out of them"
    )
    if scanned.truth:
        text += (
            f". At the true rate behind the synthetic telemetry it is {scanned.truth['emd']:.4f}"
        )
    if chain is not None and chain.calibration is not None:
        text += (
            f". For {100 * chain.calibration.confidence:g} %: {chain.calibration.told}; that set holds {chain.share:.0%} of the "
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
