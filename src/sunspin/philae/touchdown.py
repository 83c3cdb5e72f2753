"""Back to the first touchdown, and what the heights of the Sun say of the motion (paper, section 3.2, Figs. 9 and 12).

EMD of r_z sees two angles, of the momentum H from the body's z axis (theta) and from the Sun (alpha), without telling which is
which, and neither the size of H nor the order of the samples. So what follows from the scan is stated in these angles, and as a
lower bound on the angular speed, which is the least over all sizes of H; an upper bound does not follow.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sunspin.philae.candidates import Chain
from sunspin.philae.coverage import CONFIDENCE
from sunspin.philae.row import Row, over_candidates, published_row, share_of_candidates

LEAST_STEP_RAD_S = 0.026
"""A lower bound says something if it exceeds the least speed of the scanned box by a diagonal step of the grid."""

HEIGHT_DEG = 7.0
"""How far the mean height of the Sun may be from the published one: a tenth of the published range, which is "roughly"."""

HALF_DIGIT = 0.00005
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
    case, chosen, box = chain.case, chain.chosen, chain.box
    recipe = float(chain.recipe.speed_touchdown.min())
    ours, possible = chosen.speed_range(), box.speed_range()
    level = "95 % probable" if chosen.probable else f"{CONFIDENCE:.0%}"
    bounded = bool(ours[0] > possible[0] + LEAST_STEP_RAD_S)
    smallest = published_row(
        case, "rate_at_touchdown_min", recipe, None,
        f"ours: smallest over {len(chain.recipe)} motions below 1.1 times the smallest EMD of this telemetry (the paper's recipe, "
        f"without an interval); low and high: angular speed over {chosen.about}",
    )  # fmt: skip
    bound = Row(
        "rate_at_touchdown_bound", f"angular speed just after the first touchdown lies above this, {level}",
        case.published["rate_at_touchdown_min"].value, ours[0], "rad/s", None, None,
        f"over {chosen.about}; the scanned box begins at {possible[0]:.4f} rad/s"
        + ("" if bounded else ": no lower bound follows from this telemetry"), "paper, section 3.2", kind="not_comparable",
        depends="candidates", chain=chain.name, low=ours[0], high=ours[1], prior_low=possible[0], prior_high=possible[1],
        informative=bounded,
    )  # fmt: skip
    above = over_candidates(
        Row("rate_at_touchdown_max", f"angular speed just after the first touchdown lies below this, {level}", "not stated",
            ours[1], "rad/s", None, None, _above_note(chain), "paper, section 3.2, not considered there", kind="not_comparable"),
        chain.name, ours, possible,
    )  # fmt: skip
    if not chosen.probable:
        above = replace(above, informative=False)
    return [over_candidates(smallest, chain.name, ours, possible, HALF_DIGIT), bound, above]


def _above_note(chain: Chain) -> str:
    if chain.chosen.probable:
        return "from the order and the times of the samples, which the posterior uses"
    return (
        "not informed: the size of the momentum does not change the heights of the Sun. A spin of 0.3 rad/s about z gives the same "
        "heights as no motion at all; the largest is that of the scanned box"
    )


def _angle_rows(chain: Chain) -> list[Row]:
    found = []
    for name, what, values in (
        ("smaller", "smaller", lambda c: c.smaller_angle), ("larger", "larger", lambda c: c.larger_angle),
    ):  # fmt: skip
        ours, possible = (_degrees(c.angle_range(values(c))) for c in (chain.chosen, chain.box))
        recipe = [float(np.degrees(f(values(chain.recipe)))) for f in (np.min, np.max)]
        row = Row(
            f"angle_{name}", f"the {what} of the angles from the momentum to the z axis and to the Sun", "not "
                "stated", recipe, "deg",
            None, None, f"ours: least and largest by the paper's recipe; low and high: over {chain.chosen.about}. "
            "The two angles fix where the Sun's height goes; which of them is which the heights do not tell",
            "paper, section 2.3, from the model", kind="not_comparable",
        )  # fmt: skip
        found.append(over_candidates(row, chain.name, ours, possible))
    return found


def _degrees(pair: tuple[float, float]) -> tuple[float, float]:
    return float(np.degrees(pair[0])), float(np.degrees(pair[1]))


def _height_row(chain: Chain) -> Row:
    """Mean of the smallest and of the largest height of the Sun up to the collision."""
    case = chain.case
    low, high = case.published["sun_height_range"].value
    ours = [estimate.value for estimate in chain.recipe.mean_height()]
    chosen, box = chain.chosen.mean_height(), chain.box.mean_height()
    agrees = all(abs(mine.value - theirs) <= HEIGHT_DEG for mine, theirs in zip(chosen, (low, high), strict=True))
    row = published_row(
        case, "sun_height_range", ours, None,
        f"means over motions of their smallest and largest height; published: roughly; criterion: within {HEIGHT_DEG:g} deg; "
        f"ours by the paper's recipe, low and high over {chain.chosen.about}",
    )  # fmt: skip
    each = [share_of_candidates(row, chain.name, mine, before, agrees) for mine, before in zip(chosen, box, strict=True)]
    informative = any(one.informative for one in each)
    merged = {key: [getattr(one, key) for one in each] for key in ("low", "high", "prior_low", "prior_high")}
    return replace(each[0], informative=informative, agrees=agrees if informative else None, **merged)


def sentences(chain: Chain) -> list[str]:
    """What the heights of the Sun say, one-sided, in words."""
    chosen, box = chain.chosen, chain.box
    level = "each with 95 % probability" if chosen.probable else f"{CONFIDENCE:.0%}"
    small, possible = (_degrees(c.angle_range(c.smaller_angle)) for c in (chosen, box))
    large = _degrees(chosen.angle_range(chosen.larger_angle))
    found = []
    if small[1] < 0.9 * possible[1] or small[0] > possible[0] + 1:
        parts = [f"above {small[0]:.0f} degrees"] if small[0] >= 1 else []
        parts += [f"below {small[1]:.0f} degrees"] if small[1] < 0.9 * possible[1] else []
        found.append(
            "The smaller of the angles from the momentum to the body's z axis and to the Sun is "
            f"{' and '.join(parts) or 'unknown'}, "
            f"{level}" + (f"; the momentum lies within {small[1]:.0f} degrees of z or of the Sun." if small[1] < STILL_DEG else ".")
        )
    else:
        found.append("The heights of the Sun leave the angles from the momentum to the z axis and to the Sun nearly open.")
    found[-1] = found[-1].removesuffix(".") + f"; the larger is between {large[0]:.0f} and {large[1]:.0f} degrees."
    slow, fast = chosen.speed_range()
    least = box.speed_range()[0]
    bound = (
        f"Just after the touchdown it turned at {slow:.2g} rad/s or faster, {level}"
        if slow > least + LEAST_STEP_RAD_S else "Just after the touchdown it may have stood still: no lower bound on its "
            "angular speed follows"
    )  # fmt: skip
    upper = f", at {fast:.3g} rad/s or slower" if chosen.probable else "; from above the heights of the Sun bound nothing"
    return [*found, bound + upper + "."]
