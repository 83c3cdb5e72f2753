"""What the study of Philae found, for somebody who has a minute: three sentences, each number in them from this run."""

from __future__ import annotations

import numpy as np

from sunspin.study.reproduce import Reproduction
from sunspin.study.row import STATEMENT
from sunspin.tell.text import turn_text


def headline(result: Reproduction) -> list[str]:
    """What happened, how sure that is, what it rests on."""
    return [_happened(result), _how_sure(result), _rests_on(result)]


def _happened(result: Reproduction) -> str:
    stop = result.row("wheel_stop").ours
    text = "When Philae bounced off comet 67P on 12 November 2014, its momentum wheel was switched off and "
    text += "" if stop is None else f"in {stop:.0f} minutes "
    text += "passed its spin to the lander"
    if "descent" in result.parts:
        mean = np.mean(result.parts["descent"].rate_range())
        text += f": from one slow turn in {turn_text(mean)} on the way down"
    if "motions" in result.parts:
        middle = _set(result, "lines", "middle")
        text += f" it came to tumble, about once in {turn_text(middle)}, until it hit a crater's rim after 46 minutes"
    else:
        text += " it came to tumble, until it hit a crater's rim after 46 minutes"
    return text + " and tumbled on for another hour."


def _set(result: Reproduction, name: str, level: str) -> float:
    """Angular speed of a set of motions at the collision, rad/s."""
    return float(result.parts["motions"].speed["speed"].sel(set=name, level=level).isel(time=-1))


def _how_sure(result: Reproduction) -> str:
    lowest = result.row("rate_at_touchdown_min")
    text = (
        "That it tumbled is sure; how fast is not: the panel powers allow four families of motions, all of them turning with at "
        f"least {lowest.ours:.2f} rad/s (a turn in {turn_text(lowest.ours)} or less) after the touchdown"
    )
    if "motions" in result.parts and "region" in result.parts["motions"].speed["set"]:
        low, high = (_set(result, "region", level) for level in ("low", "high"))
        confidence = result.parts["motions"].speed.attrs["confidence"]
        bound = result.parts["worth"][2][0].relative[2]
        text += (
            f", but tested on synthetic flights a region that holds the truth {confidence:.0%} of the time is far wider, from "
            f"{low:.2g} to {high:.2g} rad/s at the collision, and lowers that bound to {bound:.2f} rad/s"
        )
    return text + "."


def _rests_on(result: Reproduction) -> str:
    judged = [row for row in result.rows if row.agrees is not None and not row.id.startswith(STATEMENT)]
    agreeing = sum(bool(row.agrees) for row in judged)
    text = f"{agreeing} of {len(judged)} comparable figures of the paper come out again"
    if result.synthetic:
        return (
            "The flown panel powers are not public, so this run uses synthetic ones made from published facts: it tests the method "
            f"and the model ({text}), and does not measure Philae anew."
        )
    return f"The panel powers were read from a file that does not call itself synthetic; {text}."
