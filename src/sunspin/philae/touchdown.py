"""Back to the first touchdown, and what the heights of the Sun say of the motion (paper, section 3.2, Fig. 12).

EMD of r_z sees two angles, of the momentum H from the body's z axis (theta) and from the Sun (alpha), without telling which is
which, and neither the size of H nor the order of the samples. So what follows from the scan is stated in these angles, and as a
lower bound on the angular speed, which is the least over all sizes of H; an upper bound does not follow.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.landing.tally import estimate
from sunspin.output.figures import ABOVE, COLOURS, titled
from sunspin.output.text import count_text
from sunspin.philae.candidates import Chain
from sunspin.philae.row import Row, over_candidates, row, share_of_candidates


def bounded(chain: Chain) -> bool:
    """Whether a lower bound on the angular speed follows: one that exceeds the scan range's own by a diagonal step of the grid."""
    step = np.sqrt(3) * chain.case.published["scan_step"].value
    return bool(chain.chosen.speed_range()[0] > chain.box.speed_range()[0] + step)


def rows(chain: Chain) -> list[Row]:
    """Figures of section 3.2 on the touchdown compared with ours, and what is known of the two angles."""
    case, chosen, box, recipe = chain.case, chain.chosen, chain.box, chain.recipe
    minimum = case.published["rate_at_touchdown_min"].value
    ours, possible, lowest = chosen.speed_range(), box.speed_range(), bounded(chain)
    level = "95 % probable" if chosen.probable else f"{case.assumptions.study.confidence:.0%}"
    texts: dict[str, Any] = {"about": chosen.about, "level": level, "motions": len(recipe)}
    texts["prior_low"] = possible[0]

    def over(shown: Row, ours: Any, possible: Any) -> Row:
        return over_candidates(shown, chain.name, ours, possible)

    smallest = row(case, "rate_at_touchdown_min", float(recipe.speed_touchdown.min()), **texts)
    says = ("note",) if lowest else ("note", "note_unbounded")
    given = texts | {"published": minimum, "says": says}
    below = row(case, "rate_at_touchdown_bound", ours[0], **given)
    says = ("note_probable" if chosen.probable else "note",)
    above = over(row(case, "rate_at_touchdown_max", ours[1], says=says, **texts), ours, possible)
    every = [
        over(smallest, ours, possible),
        replace(over(below, ours, possible), informative=lowest),
        replace(above, informative=above.informative and chosen.probable),
    ]
    for which, name in enumerate(("smaller", "larger")):
        angles = np.degrees(recipe.angles[which])
        ends = [float(angles.min()), float(angles.max())]
        angle = row(case, "angle", ends, id=f"angle_{name}", which=name, **texts)
        ours, possible = (np.degrees(c.angle_range(which)).tolist() for c in (chosen, box))
        every.append(over(angle, ours, possible))

    # means of the smallest and of the largest height of the Sun; roughly: to a tenth of the published range
    of_chosen, of_box, of_recipe = (
        [estimate(height) for height in np.degrees(c.height).T] for c in (chosen, box, recipe)
    )
    ours, within = [height.value for height in of_recipe], 7.0
    off = np.subtract(
        [height.value for height in of_chosen], case.published["sun_height_range"].value
    )
    agrees = bool(np.all(np.abs(off) <= within))
    shown = row(case, "sun_height_range", ours, within=within, **texts)
    pairs = zip(of_chosen, of_box, strict=True)
    ends = [share_of_candidates(shown, chain.name, *pair, agrees) for pair in pairs]
    informative = any(end.informative for end in ends)
    keys = ("low", "high", "prior_low", "prior_high")
    given = {key: [getattr(end, key) for end in ends] for key in keys}
    agrees = agrees if informative else None
    return [*every, replace(ends[0], informative=informative, agrees=agrees, **given)]


def sentences(chain: Chain) -> list[str]:
    """What the heights of the Sun say, one-sided, in words."""
    chosen, box = chain.chosen, chain.box
    confidence = f"{chain.case.assumptions.study.confidence:.0%}"
    level = "each with 95 % probability" if chosen.probable else confidence
    small, large = (np.degrees(chosen.angle_range(which)) for which in (0, 1))
    possible = np.degrees(box.angle_range(0))
    above, below = small[0] >= 1, small[1] < 0.9 * possible[1]
    if below or small[0] > possible[0] + 1:
        limits = [f"above {small[0]:.0f} degrees"] if above else []
        limits += [f"below {small[1]:.0f} degrees"] if below else []
        angles = (
            "Angles of the angular momentum to the body z axis and to the Sun (not distinguishable): the smaller one is "
            f"{' and '.join(limits)} ({level})"
        )
        if small[1] < 20:  # such a lander does not tumble visibly: its Sun hardly changes height
            angles += f"; the momentum lies within {small[1]:.0f} degrees of z or of the Sun"
    else:
        angles = "Angles of the angular momentum to the body z axis and to the Sun: the smaller one is hardly constrained"
    angles += f", the larger one {large[0]:.0f} to {large[1]:.0f} degrees."
    slow, fast = chosen.speed_range()
    speed = f"at least {slow:.2g} rad/s ({level})"
    if not bounded(chain):
        speed = "it may have stood still, no lower bound"
    upper = f", at most {fast:.3g} rad/s." if chosen.probable else "; no upper bound."
    return [angles, f"Angular speed just after the touchdown: {speed}{upper}"]


def figure(chain: Chain, synthetic: bool) -> Figure:
    """Share of the motions by angular speed at the touchdown, and the smaller and the larger angle of the momentum (Fig. 12)."""
    picture = Figure(figsize=(11, 4.6), layout="constrained")
    speed, angles = picture.subplots(1, 2)
    box, chosen, recipe = chain.box, chain.chosen, chain.recipe
    names = {
        "scan": "the set of the scan",
        "posterior": "draws of the posterior",
        "published": "the published lines, for any data",
    }
    left = names.get(chain.name, f"motions of {chain.name}")
    if chain.calibration is not None:
        level = chain.calibration.factor()[0]
        left = f"the {chain.calibration.confidence:.0%} set, EMD < {level:.2f} EMD_min"

    # bins so wide that 30 motions are in each on average: fewer would show the steps of the grid
    speeds = box.speed_touchdown, chosen.speed_touchdown
    bins = int(np.clip(min(map(len, speeds)) / 30, 5, 40))
    edges = np.linspace(0.0, float(max(each.max() for each in speeds)), bins + 1)
    before, after = (np.histogram(each, edges, density=True)[0] for each in speeds)
    style: dict[str, Any] = {"color": "#9a9a9a", "fill": True, "alpha": 0.45}
    speed.stairs(before, edges, lw=1.8, label="possible before the data", **style)
    speed.stairs(after, edges, lw=1.8, color=COLOURS[0], label=f"left: {left}")
    if bounded(chain):
        # the range counts the cells of the grid, and so begins below the least
        low, _ = chosen.speed_range()
        speed.axvspan(0, low, color=COLOURS[0], alpha=0.12, lw=0)
        label = f"our lower bound: {low:.3f} rad/s"
        speed.axvline(low, color=COLOURS[0], lw=1.4, ls=":", label=label)
    else:
        speed.plot([], [], " ", label="no lower bound follows")
    published = float(chain.case.published["rate_at_touchdown_min"].value)
    label = f"published lower bound: {published:g} rad/s"
    speed.axvline(published, color=COLOURS[1], ls="--", lw=1.4, label=label)
    speed.set(xlabel="angular speed just after the first touchdown (rad/s)", xlim=(0, edges[-1]))
    speed.set_ylabel("density (s/rad)")
    speed.legend(fontsize=8, ncols=2, **ABOVE)

    factor = chain.case.assumptions.study.near_minimum_factor
    for name, motions, marker, colour, size in (
        ("possible before the data", box, "s", "#cccccc", 3.0),
        (f"left: {left}", chosen, "o", COLOURS[0], 1.8),
        (f"the paper's recipe, EMD < {factor:g} EMD_min", recipe, "D", COLOURS[1], 4.0),
    ):
        both = np.degrees(motions.angles)
        # an even choice of 6,000 where there are more, and those at the ends of either angle
        ends = *both.argmin(axis=1), *both.argmax(axis=1)
        shown = np.union1d(np.arange(0, len(motions), -(-len(motions) // 6000)), ends)
        style = {"ms": size, "mew": 0, "color": colour, "rasterized": True}
        label = f"{name} ({count_text(len(motions), 'motion')})"
        angles.plot(*both[:, shown], marker, label=label, **style)
    small, large = np.degrees(box.angles.max(axis=1))
    angles.set(
        xlim=(0, small + 2),
        ylim=(0, 1.3 * large),
        xticks=range(0, int(small) + 2, 15),
        yticks=range(0, int(large) + 16, 30),
        xlabel="smaller of the angles from the momentum to z and to the Sun (deg)",
        ylabel="larger of the two (deg)",
    )
    for handle in angles.legend(fontsize=8, loc="upper left").legend_handles:
        handle.set_markersize(6)
    cell = float(np.degrees(chosen.angle_cell))
    spread = f"; a cell of the grid: {cell:.2g} deg" if cell > 0 else ""
    angles.set_title(f"Angles of the momentum{spread}", fontsize=9)
    angles.grid(lw=0.3)
    title = "What this telemetry leaves of the motion after the first touchdown"
    picture.suptitle(titled(title, synthetic), fontsize=11)
    return picture
