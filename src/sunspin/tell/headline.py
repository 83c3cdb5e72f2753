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
    text = "Philae came down to comet 67P"
    if "descent" in result.parts:
        text += f" turning slowly, once in {turn_text(np.mean(result.parts['descent'].rate_range()))}"
    text += "; when it bounced, its momentum wheel was switched off and "
    text += "" if stop is None else f"in {stop:.0f} minutes "
    text += "handed its spin to the lander, which came to tumble"
    if "motions" in result.parts:
        text += f" about once in {turn_text(_set(result, 'lines', 'middle'))}"
    return text + ", hit the rim of a crater after 46 minutes, tumbled on for another hour and came to rest."


def _set(result: Reproduction, name: str, level: str) -> float:
    """Angular speed of a set of motions at the collision, rad/s."""
    return float(result.parts["motions"].speed["speed"].sel(set=name, level=level).isel(time=-1))


def _how_sure(result: Reproduction) -> str:
    lowest = result.row("rate_at_touchdown_min")
    text = (
        "How fast it turned is poorly known: the paper's criterion leaves motions on four lines, all turning at least once in "
        f"{turn_text(lowest.ours)} after the bounce (published: {turn_text(lowest.published)})"
    )
    if "worth" in result.parts:
        inside = result.row("worth_truth_in_set").ours
        text += f", but on synthetic flights of known motion it keeps the true one in only {inside:.0%} of cases"
    if "motions" in result.parts and "region" in result.parts["motions"].speed["set"]:
        low, high = (_set(result, "region", level) for level in ("low", "high"))
        text += (
            f"; a wider one that keeps it in {result.parts['motions'].speed.attrs['confidence']:.0%} allows a turn in anything "
            f"from "
            f"{turn_text(high)} to {turn_text(low)} just before the collision"
        )
    return text + "."


def _rests_on(result: Reproduction) -> str:
    judged = [row for row in result.rows if row.agrees is not None and not row.id.startswith(STATEMENT)]
    free = [bool(row.agrees) for row in judged if not row.by_construction]
    text = f"{sum(free)} of {len(free)} comparable figures of the paper come out again"
    if len(judged) > len(free):
        text += f", and {sum(bool(row.agrees) for row in judged if row.by_construction)} more that were put in"
    if result.synthetic:
        return (
            "The flown panel powers are not public, so this run uses synthetic ones made from published facts: it tests the method "
            f"and the model ({text}), and does not measure Philae anew."
        )
    return f"The panel powers were read from a file that does not call itself synthetic; {text}."
