"""Back to the first touchdown, and what the heights of the Sun say of the motion (paper, section 3.2, Figs. 9 and 12).

EMD of r_z sees two angles, of the momentum H from the body's z axis (theta) and from the Sun (alpha), without telling which is
which, and neither the size of H nor the order of the samples. So what follows from the scan is stated in these angles, and as a
lower bound on the angular speed, which is the least over all sizes of H; an upper bound does not follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row, over_candidates, row, share_of_candidates

LEAST_STEP_RAD_S = 0.026
"""A lower bound says something if it exceeds the least speed of the scanned box by a diagonal step of the grid."""

HEIGHT_DEG = 7.0
"""How far the mean height of the Sun may be from the published one: a tenth of the published range, which is "roughly"."""

STILL_DEG = 20.0
"""A smaller angle that lies below this leaves a lander that does not tumble visibly: its Sun hardly changes height."""


def compute(chain: Chain) -> Chain:
    """All that is needed is in the candidates."""
    return chain


def lower_bound(chain: Chain) -> float:
    """Angular speed (rad/s) after the first touchdown above which all candidates, or 95 % of the draws, turn."""
    return chain.chosen.speed_range()[0]


def rows(chain: Chain) -> list[Row]:
    """Figures of section 3.2 on the touchdown beside ours, and what is known of the two angles."""
    case, chosen, box, about = chain.case, chain.chosen, chain.box, chain.chosen.about
    ours, possible = chosen.speed_range(), box.speed_range()
    bounded = bool(ours[0] > possible[0] + LEAST_STEP_RAD_S)
    level = "95 % probable" if chosen.probable else f"{case.assumptions.study.confidence:.0%}"
    recipe = float(chain.recipe.speed_touchdown.min())
    smallest = row(case, "rate_at_touchdown_min", recipe, motions=len(chain.recipe), about=about)
    below = row(
        case,
        "rate_at_touchdown_bound",
        ours[0],
        says=("note",) if bounded else ("note", "note_unbounded"),
        published=case.published["rate_at_touchdown_min"].value,
        level=level,
        about=about,
        prior_low=possible[0],
    )
    says = ("note_probable" if chosen.probable else "note",)
    above = row(case, "rate_at_touchdown_max", ours[1], says=says, level=level)
    smallest, below, above = (
        over_candidates(each, chain.name, ours, possible) for each in (smallest, below, above)
    )
    below = replace(below, informative=bounded)
    above = replace(above, informative=above.informative and chosen.probable)
    angles = []
    for which in ("smaller", "larger"):
        values = getattr(chain.recipe, f"{which}_angle")
        recipe = np.degrees([values.min(), values.max()]).tolist()
        angle = row(case, "angle", recipe, id=f"angle_{which}", which=which, about=about)
        ours, possible = (
            np.degrees(c.angle_range(getattr(c, f"{which}_angle"))).tolist() for c in (chosen, box)
        )
        angles.append(over_candidates(angle, chain.name, ours, possible))
    return [smallest, below, above, *angles, _height_row(chain)]


def _height_row(chain: Chain) -> Row:
    """Mean of the smallest and of the largest height of the Sun up to the collision."""
    case, chosen = chain.case, chain.chosen.mean_height()
    published = case.published["sun_height_range"].value
    ours = [height.value for height in chain.recipe.mean_height()]
    agrees = bool(np.all(np.abs([h.value for h in chosen] - np.array(published)) <= HEIGHT_DEG))
    shown = row(case, "sun_height_range", ours, within=HEIGHT_DEG, about=chain.chosen.about)
    ends = [
        share_of_candidates(shown, chain.name, after, before, agrees)
        for after, before in zip(chosen, chain.box.mean_height(), strict=True)
    ]
    informative = any(end.informative for end in ends)
    intervals = {
        key: [getattr(end, key) for end in ends]
        for key in ("low", "high", "prior_low", "prior_high")
    }
    agrees = agrees if informative else None
    return replace(ends[0], informative=informative, agrees=agrees, **intervals)


def sentences(chain: Chain) -> list[str]:
    """What the heights of the Sun say, one-sided, in words."""
    chosen, box = chain.chosen, chain.box
    confidence = f"{chain.case.assumptions.study.confidence:.0%}"
    level = "each with 95 % probability" if chosen.probable else confidence
    small, possible = (np.degrees(c.angle_range(c.smaller_angle)) for c in (chosen, box))
    large = np.degrees(chosen.angle_range(chosen.larger_angle))
    above, below = small[0] >= 1, small[1] < 0.9 * possible[1]
    if below or small[0] > possible[0] + 1:
        limits = [f"above {small[0]:.0f} degrees"] if above else []
        limits += [f"below {small[1]:.0f} degrees"] if below else []
        angles = (
            "Angles of the angular momentum to the body z axis and to the Sun (not distinguishable): the smaller one is "
            f"{' and '.join(limits)} ({level})"
        )
        if small[1] < STILL_DEG:
            angles += f"; the momentum lies within {small[1]:.0f} degrees of z or of the Sun"
    else:
        angles = "Angles of the angular momentum to the body z axis and to the Sun: the smaller one is hardly constrained"
    angles += f", the larger one {large[0]:.0f} to {large[1]:.0f} degrees."
    slow, fast = chosen.speed_range()
    if slow > box.speed_range()[0] + LEAST_STEP_RAD_S:
        speed = f"Angular speed just after the touchdown: at least {slow:.2g} rad/s ({level})"
    else:
        speed = "Angular speed just after the touchdown: it may have stood still, no lower bound"
    if chosen.probable:
        return [angles, f"{speed}, at most {fast:.3g} rad/s."]
    return [angles, f"{speed}; no upper bound."]
