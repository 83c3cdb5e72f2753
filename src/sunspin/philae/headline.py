"""What the study of Philae found, for somebody who has a minute: three sentences, each number in them from this run.

Nothing is said that does not follow from the telemetry given, or is called the record's (times of events) or the paper's.
"""

from __future__ import annotations

import numpy as np

from sunspin.output.text import turn_text
from sunspin.philae import touchdown
from sunspin.philae.candidates import Chain
from sunspin.philae.study import Reproduction
from sunspin.philae.threshold import CONFIDENCE


def headline(result: Reproduction) -> list[str]:
    """What happened, how sure that is, what it rests on."""
    return [_happened(result), _how_sure(result), _rests_on(result)]


def _happened(result: Reproduction) -> str:
    return " ".join((_descent(result), _rebound(result)))


def _descent(result: Reproduction) -> str:
    if "descent" not in result.parts:
        return "Of the descent this telemetry holds too little to say how the lander turned."
    if not result.parts["carries"].descent_order or not result.parts["carries"].one_sun:
        return "How the lander turned during the descent does not follow from this telemetry."
    return f"During the descent the lander turned once in {turn_text(np.mean(result.parts['descent'].rate_range()))}."


def _rebound(result: Reproduction) -> str:
    chain = result.chain
    if chain is None:
        return f"What it did after the first touchdown cannot be concluded: {_why(result)}."
    slow, fast = chain.chosen.speed_range()
    level = f"{chain.case.assumptions.study.confidence:.0%}"
    if chain.name == "published":
        return "After the first touchdown it is taken to move as on the paper's printed lines, whatever this telemetry says."
    if chain.chosen.probable:
        return f"Just after the first touchdown it turned at {slow:.3g} to {fast:.3g} rad/s, {CONFIDENCE:.0%}."
    if slow <= chain.box.speed_range()[0] + touchdown.LEAST_STEP_RAD_S:
        return "After the first touchdown it need not have tumbled at all: a lander at rest fits as well."
    return (
        f"After the first touchdown it turned once in {turn_text(slow)} or faster ({level}); how much faster the heights "
        "of the Sun do not say."
    )


def _why(result: Reproduction) -> str:
    """Why there are no candidates, in a clause."""
    reasons = result.parts["carries"].reasons
    if reasons:
        return "; ".join(reasons)
    told = result.missing.get("candidates", result.missing.get("level_set", "no motion was found"))
    return told.split(" as ", 1)[-1].split(";")[0].rstrip(".")


def _how_sure(result: Reproduction) -> str:
    chain = result.chain
    if chain is None:
        return "Nothing is said of the touchdown, the collision and what followed."
    return " ".join((_extent(chain), *touchdown.sentences(chain)))


def _extent(chain: Chain) -> str:
    if chain.calibration is not None:
        return (
            f"The motions that fit make up {chain.share:.0%} of those scanned: EMD below {chain.calibration.factor()[0]:.2f} "
            f"times the smallest, a threshold that held the truth in {chain.calibration.confidence:.0%} of "
            f"{chain.calibration.n} synthetic flights like this one."
        )
    return f"Candidates: {chain.chosen.about}." + (
        f" {chain.verdict.rstrip('.')}." if chain.verdict else ""
    )


def score(result: Reproduction) -> list[str]:
    """The score in lines: tests on this telemetry, tests without any, what else there is."""
    found = result.counts()
    here, lines, paper = (found[name] for name in ("telemetry", "no_telemetry", "paper"))
    other = {
        name: sum(counts[name] for counts in found.values())
        for name in ("put_in", "arithmetic", "not_comparable")
    }
    return [
        f"Tests on this telemetry: {here['agree']} agree, {here['differ']} differ, {here['uninformative']} uninformative",
        f"Tests without telemetry (equations, printed lines): {lines['agree'] + paper['agree']} agree, "
        f"{lines['differ'] + paper['differ']} differ",
        f"No tests: {other['put_in']} figures put in, {other['arithmetic']} of the paper's own arithmetic, "
        f"{other['not_comparable']} not comparable",
    ]


def _rests_on(result: Reproduction) -> str:
    here = result.counts()["telemetry"]
    text = (
        f"of the paper's figures that can be tested on it {here['agree']} agree, {here['differ']} differ, and "
        f"{here['uninformative']} are uninformative"
    )
    text += (
        ", as these data leave nearly all that was possible"
        if result.chain is not None and here["uninformative"]
        else ""
    )
    if result.synthetic:
        return (
            "The flown panel powers are not public; this run uses synthetic ones made from published facts, so it tests the "
            f"method and does not measure Philae anew: {text}."
        )
    return f"The panel powers were read from a file that does not call itself synthetic: {text}."
