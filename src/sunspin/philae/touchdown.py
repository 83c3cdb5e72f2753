"""State at the first touchdown, and what the distribution of r_z determines of the motion (paper, section 3.2, Fig. 12).

The EMD of r_z depends on two angles of the angular momentum H: from the body's z axis (theta) and from the Sun (alpha). It cannot
tell one from the other, and depends neither on the size of H nor on the order of the samples. So the scan gives ranges of the
smaller and the larger angle. It also gives a lower bound on the angular speed, the least over all sizes of H, but no upper bound.
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
from sunspin.philae.row import Row, judge_range, judge_share, make_row


def has_lower_bound(chain: Chain) -> bool:
    """Return whether the data give a lower bound on the angular speed.

    That is so if it exceeds the least speed in the scan range by more than the diagonal of a grid step.
    """
    step = np.sqrt(3) * chain.case.published["scan_step"].value
    return bool(chain.chosen.speed_range()[0] > chain.scan_range.speed_range()[0] + step)


def rows(chain: Chain) -> list[Row]:
    """Return the figures of section 3.2 on the touchdown compared with ours: angular speed, the two angles, r_z range."""
    case, chosen = chain.case, chain.chosen
    scan_range, near_minimum = chain.scan_range, chain.near_minimum
    published = case.published["rate_at_touchdown_min"].value
    ours, possible = chosen.speed_range(), scan_range.speed_range()
    bounded = has_lower_bound(chain)
    level = "95 % probable" if chosen.from_posterior else f"{case.assumptions.study.confidence:.0%}"
    texts: dict[str, Any] = {"about": chosen.about, "level": level, "motions": len(near_minimum)}
    texts["prior_low"] = possible[0]

    def judge(shown: Row, ours: Any, possible: Any) -> Row:
        """Return the row judged by its ranges over chosen candidates and scan range."""
        return judge_range(shown, chain.name, ours, possible)

    # the paper's recipe for the smallest speed, then our lower bound, then our largest speed
    least = float(near_minimum.speed_touchdown.min())
    smallest = make_row(case, "rate_at_touchdown_min", least, **texts)
    notes = ("note",) if bounded else ("note", "note_unbounded")
    given = texts | {"published": published, "notes": notes}
    bound = make_row(case, "rate_at_touchdown_bound", ours[0], **given)
    notes = ("note_probable" if chosen.from_posterior else "note",)
    largest = judge(
        make_row(case, "rate_at_touchdown_max", ours[1], notes=notes, **texts), ours, possible
    )
    result = [
        judge(smallest, ours, possible),
        replace(judge(bound, ours, possible), informative=bounded),
        replace(largest, informative=largest.informative and chosen.from_posterior),
    ]
    for which, name in enumerate(("smaller", "larger")):
        angles = np.degrees(near_minimum.angles[which])
        ends = [float(angles.min()), float(angles.max())]
        angle = make_row(case, "angle", ends, id=f"angle_{name}", which=name, **texts)
        ours, possible = (
            np.degrees(motions.angle_range(which)).tolist() for motions in (chosen, scan_range)
        )
        result.append(judge(angle, ours, possible))

    # means over the motions of the smallest and of the largest elevation of the Sun (deg); "roughly": a tenth of the range
    of_chosen, of_scan_range, of_near_minimum = (
        [estimate(elevation) for elevation in np.degrees(motions.sun_elevation).T]
        for motions in (chosen, scan_range, near_minimum)
    )
    ours, within = [elevation.value for elevation in of_near_minimum], 7.0
    difference = np.subtract(
        [elevation.value for elevation in of_chosen], case.published["sun_height_range"].value
    )
    agrees = bool(np.all(np.abs(difference) <= within))
    shown = make_row(case, "sun_height_range", ours, within=within, **texts)
    # both ends of the range in one row: it is informative if one of them is
    pairs = zip(of_chosen, of_scan_range, strict=True)
    ends = [judge_share(shown, chain.name, *pair, agrees) for pair in pairs]
    informative = any(end.informative for end in ends)
    keys = ("low", "high", "prior_low", "prior_high")
    given = {key: [getattr(end, key) for end in ends] for key in keys}
    agrees = agrees if informative else None
    return [*result, replace(ends[0], informative=informative, agrees=agrees, **given)]


def describe_motion(chain: Chain) -> list[str]:
    """Return two sentences: on the angles of the angular momentum, and on the angular speed just after the touchdown."""
    chosen, scan_range = chain.chosen, chain.scan_range
    confidence = f"{chain.case.assumptions.study.confidence:.0%}"
    level = "each with 95 % probability" if chosen.from_posterior else confidence
    small, large = (np.degrees(chosen.angle_range(which)) for which in (0, 1))
    possible = np.degrees(scan_range.angle_range(0))
    # a limit is printed if it excludes a degree at the lower end, or a tenth of the scan range at the upper
    limited_below, limited_above = small[0] >= 1, small[1] < 0.9 * possible[1]
    if limited_above or small[0] > possible[0] + 1:
        limits = [f"above {small[0]:.0f} degrees"] if limited_below else []
        limits += [f"below {small[1]:.0f} degrees"] if limited_above else []
        angles = (
            "Angles of the angular momentum to the body z axis and to the Sun (not distinguishable): the smaller one is "
            f"{' and '.join(limits)} ({level})"
        )
        if (
            small[1] < 20
        ):  # such a lander does not tumble visibly: the Sun's elevation hardly changes
            angles += f"; the momentum lies within {small[1]:.0f} degrees of z or of the Sun"
    else:
        angles = "Angles of the angular momentum to the body z axis and to the Sun: the smaller one is hardly constrained"
    angles += f", the larger one {large[0]:.0f} to {large[1]:.0f} degrees."
    slow, fast = chosen.speed_range()
    speed = f"at least {slow:.2g} rad/s ({level})"
    if not has_lower_bound(chain):
        speed = "it may have stood still, no lower bound"
    upper = f", at most {fast:.3g} rad/s." if chosen.from_posterior else "; no upper bound."
    return [angles, f"Angular speed just after the touchdown: {speed}{upper}"]


def touchdown_figure(chain: Chain, synthetic: bool) -> Figure:
    """Draw the angular speed at the touchdown and the two angles of the angular momentum over the sets of motions (Fig. 12)."""
    picture = Figure(figsize=(11, 4.6), layout="constrained")
    speed, angles = picture.subplots(1, 2)
    scan_range, chosen, near_minimum = chain.scan_range, chain.chosen, chain.near_minimum
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
    speeds = scan_range.speed_touchdown, chosen.speed_touchdown
    bins = int(np.clip(min(map(len, speeds)) / 30, 5, 40))
    edges = np.linspace(0.0, float(max(values.max() for values in speeds)), bins + 1)
    before, after = (np.histogram(values, edges, density=True)[0] for values in speeds)
    style: dict[str, Any] = {"color": "#9a9a9a", "fill": True, "alpha": 0.45}
    speed.stairs(before, edges, lw=1.8, label="possible before the data", **style)
    speed.stairs(after, edges, lw=1.8, color=COLOURS[0], label=f"left: {left}")
    if has_lower_bound(chain):
        # the range includes half a cell of the grid, so it begins below the slowest motion
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
        ("possible before the data", scan_range, "s", "#cccccc", 3.0),
        (f"left: {left}", chosen, "o", COLOURS[0], 1.8),
        (f"the paper's recipe, EMD < {factor:g} EMD_min", near_minimum, "D", COLOURS[1], 4.0),
    ):
        pairs = np.degrees(motions.angles)
        # at most 6,000 points, evenly chosen, and the motions at the ends of either angle
        ends = *pairs.argmin(axis=1), *pairs.argmax(axis=1)
        shown = np.union1d(np.arange(0, len(motions), -(-len(motions) // 6000)), ends)
        style = {"ms": size, "mew": 0, "color": colour, "rasterized": True}
        label = f"{name} ({count_text(len(motions), 'motion')})"
        angles.plot(*pairs[:, shown], marker, label=label, **style)
    small, large = np.degrees(scan_range.angles.max(axis=1))
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
    cell = float(np.degrees(chosen.angle_cell_rad))
    spread = f"; a cell of the grid: {cell:.2g} deg" if cell > 0 else ""
    angles.set_title(f"Angles of the momentum{spread}", fontsize=9)
    angles.grid(lw=0.3)
    title = "What this telemetry leaves of the motion after the first touchdown"
    picture.suptitle(titled(title, synthetic), fontsize=11)
    return picture
