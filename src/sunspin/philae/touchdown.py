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
    return [*_speed_rows(chain), *_angle_rows(chain), _height_row(chain)]


def _speed_rows(chain: Chain) -> list[Row]:
    case, chosen = chain.case, chain.chosen
    ours, possible = chosen.speed_range(), chain.box.speed_range()
    level = "95 % probable" if chosen.probable else f"{case.assumptions.study.confidence:.0%}"
    bounded = bool(ours[0] > possible[0] + LEAST_STEP_RAD_S)
    recipe = float(chain.recipe.speed_touchdown.min())
    smallest = row(
        case, "rate_at_touchdown_min", recipe, motions=len(chain.recipe), about=chosen.about
    )
    bound = row(
        case,
        "rate_at_touchdown_bound",
        ours[0],
        says=("note",) if bounded else ("note", "note_unbounded"),
        published=case.published["rate_at_touchdown_min"].value,
        level=level,
        about=chosen.about,
        prior_low=possible[0],
    )
    above = row(
        case,
        "rate_at_touchdown_max",
        ours[1],
        says=("note_probable" if chosen.probable else "note",),
        level=level,
    )
    smallest, bound, above = (
        over_candidates(one, chain.name, ours, possible) for one in (smallest, bound, above)
    )
    return [
        smallest,
        replace(bound, informative=bounded),
        above if chosen.probable else replace(above, informative=False),
    ]


def _angle_rows(chain: Chain) -> list[Row]:
    found = []
    for which, values in (
        ("smaller", lambda c: c.smaller_angle),
        ("larger", lambda c: c.larger_angle),
    ):
        ours, possible = (_degrees(c.angle_range(values(c))) for c in (chain.chosen, chain.box))
        recipe = [float(np.degrees(f(values(chain.recipe)))) for f in (np.min, np.max)]
        one = row(
            chain.case, "angle", recipe, id=f"angle_{which}", which=which, about=chain.chosen.about
        )
        found.append(over_candidates(one, chain.name, ours, possible))
    return found


def _degrees(pair: tuple[float, float]) -> tuple[float, float]:
    return float(np.degrees(pair[0])), float(np.degrees(pair[1]))


def _height_row(chain: Chain) -> Row:
    """Mean of the smallest and of the largest height of the Sun up to the collision."""
    case = chain.case
    low, high = case.published["sun_height_range"].value
    ours = [estimate.value for estimate in chain.recipe.mean_height()]
    chosen, box = chain.chosen.mean_height(), chain.box.mean_height()
    agrees = all(
        abs(mine.value - theirs) <= HEIGHT_DEG
        for mine, theirs in zip(chosen, (low, high), strict=True)
    )
    shown = row(case, "sun_height_range", ours, within=HEIGHT_DEG, about=chain.chosen.about)
    each = [
        share_of_candidates(shown, chain.name, mine, before, agrees)
        for mine, before in zip(chosen, box, strict=True)
    ]
    informative = any(one.informative for one in each)
    merged = {
        key: [getattr(one, key) for one in each]
        for key in ("low", "high", "prior_low", "prior_high")
    }
    return replace(
        each[0], informative=informative, agrees=agrees if informative else None, **merged
    )


def sentences(chain: Chain) -> list[str]:
    """What the heights of the Sun say, one-sided, in words."""
    chosen, box = chain.chosen, chain.box
    level = (
        "each with 95 % probability"
        if chosen.probable
        else f"{chain.case.assumptions.study.confidence:.0%}"
    )
    small, possible = (_degrees(c.angle_range(c.smaller_angle)) for c in (chosen, box))
    large = _degrees(chosen.angle_range(chosen.larger_angle))
    found = []
    if small[1] < 0.9 * possible[1] or small[0] > possible[0] + 1:
        parts = [f"above {small[0]:.0f} degrees"] if small[0] >= 1 else []
        parts += [f"below {small[1]:.0f} degrees"] if small[1] < 0.9 * possible[1] else []
        found.append(
            "The smaller of the angles from the momentum to the body's z axis and to the Sun is "
            f"{' and '.join(parts) or 'unknown'}, "
            f"{level}"
            + (
                f"; the momentum lies within {small[1]:.0f} degrees of z or of the Sun."
                if small[1] < STILL_DEG
                else "."
            )
        )
    else:
        found.append(
            "The heights of the Sun leave the angles from the momentum to the z axis and to the Sun nearly open."
        )
    found[-1] = (
        found[-1].removesuffix(".")
        + f"; the larger is between {large[0]:.0f} and {large[1]:.0f} degrees."
    )
    slow, fast = chosen.speed_range()
    least = box.speed_range()[0]
    bound = (
        f"Just after the touchdown it turned at {slow:.2g} rad/s or faster, {level}"
        if slow > least + LEAST_STEP_RAD_S
        else "Just after the touchdown it may have stood still: no lower bound on its "
        "angular speed follows"
    )
    upper = (
        f", at {fast:.3g} rad/s or slower"
        if chosen.probable
        else "; from above the heights of the Sun bound nothing"
    )
    return [*found, bound + upper + "."]
