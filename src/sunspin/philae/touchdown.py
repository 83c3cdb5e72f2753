"""State at the first touchdown, and what the distribution of r_z determines of the motion (paper, section 3.2, Fig. 12).

The EMD of r_z depends on two angles of the angular momentum H: from the body's z axis (theta) and from the Sun (alpha). It cannot
tell one from the other, and depends neither on the size of H nor on the order of the samples. So the scan gives ranges of the
smaller and the larger angle. It also gives a lower bound on the angular speed, the least over all sizes of H, but no upper bound.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sunspin.landing.tally import estimate
from sunspin.output.figures import ABOVE, COLOURS, empty_figure, titled
from sunspin.output.text import count_text
from sunspin.philae.candidates import CandidateSets
from sunspin.philae.row import Row, judge_range, judge_share, make_row

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def has_lower_bound(candidate_sets: CandidateSets) -> bool:
    """Return whether the data give a lower bound on the angular speed.

    That is so if it exceeds the least speed in the scan range by more than the diagonal of a grid step.
    """
    step = np.sqrt(3) * candidate_sets.case.published["scan_step"].value
    return bool(
        candidate_sets.chosen.speed_range()[0] > candidate_sets.scan_range.speed_range()[0] + step
    )


def touchdown_rows(candidate_sets: CandidateSets) -> list[Row]:
    """Return the figures of section 3.2 on the touchdown compared with ours: angular speed, the two angles, the Sun's elevation."""
    return [
        *_speed_rows(candidate_sets),
        *_angle_rows(candidate_sets),
        _sun_elevation_row(candidate_sets),
    ]


def _speed_rows(candidate_sets: CandidateSets) -> list[Row]:
    """Return the rows on the angular speed just after the touchdown: by the paper's recipe, our lower bound, our largest speed.

    All three are judged by the same two ranges of the speed, over the chosen candidates and over the scan range.
    """
    case, chosen, source = candidate_sets.case, candidate_sets.chosen, candidate_sets.source
    speeds, possible_speeds = chosen.speed_range(), candidate_sets.scan_range.speed_range()
    by_recipe = candidate_sets.near_minimum.speed_touchdown
    study = case.assumptions.study
    note = f"smallest of {len(by_recipe)} motions below {study.near_minimum_factor:g} times the smallest EMD"
    smallest = make_row(case, "rate_at_touchdown_min", float(by_recipe.min()), note=note)

    # one-sided: the lower end of the 5 to 95 % interval of the posterior, or of a confidence set
    level = "95 % probable" if chosen.from_posterior else f"{study.confidence:.0%}"
    speed, bounded = "angular speed just after the first touchdown", has_lower_bound(candidate_sets)
    texts: dict[str, Any] = {"what": f"{speed} lies above this, {level}"}
    texts["note"] = f"over {chosen.about}; the scanned box begins at {possible_speeds[0]:.4f} rad/s"
    texts["note"] += "" if bounded else ": no lower bound follows from this telemetry"
    published = case.published["rate_at_touchdown_min"].value
    bound_row = make_row(case, "rate_at_touchdown_bound", speeds[0], published=published, **texts)
    note = "the largest of the scanned box: the distribution of r_z does not depend on the size of the momentum"
    if chosen.from_posterior:
        note = "from the order and the times of the samples, which the posterior uses"
    what = f"{speed} lies below this, {level}"
    largest = make_row(case, "rate_at_touchdown_max", speeds[1], what=what, note=note)

    smallest, bound_row, largest = (
        judge_range(row, source, speeds, possible_speeds) for row in (smallest, bound_row, largest)
    )
    # A narrow range is not all that counts here. The lower bound is informative exactly if the data give one. The largest speed is
    # that of the scan range unless a posterior bounds it, as the EMD does not depend on the size of the momentum.
    bound_row = replace(bound_row, informative=bounded)
    largest = replace(largest, informative=largest.informative and chosen.from_posterior)
    return [smallest, bound_row, largest]


def _angle_rows(candidate_sets: CandidateSets) -> list[Row]:
    """Return the rows on the smaller and on the larger angle of the angular momentum, to the z axis and to the Sun."""
    result = []
    for which, name in enumerate(("smaller", "larger")):
        by_recipe = np.degrees(candidate_sets.near_minimum.angles[which])
        ends = [float(by_recipe.min()), float(by_recipe.max())]
        what = f"the {name} of the angles from the momentum to the z axis and to the Sun"
        row = make_row(candidate_sets.case, "angle", ends, id=f"angle_{name}", what=what)
        chosen_deg, possible_deg = (
            np.degrees(candidates.angle_range(which)).tolist()
            for candidates in (candidate_sets.chosen, candidate_sets.scan_range)
        )
        result.append(judge_range(row, candidate_sets.source, chosen_deg, possible_deg))
    return result


def _sun_elevation_row(candidate_sets: CandidateSets) -> Row:
    """Return the row on the range of the Sun's elevation: means over the motions of the smallest and of the largest one (deg)."""
    chosen, possible, by_recipe = (
        [estimate(elevation) for elevation in np.degrees(candidates.sun_elevation).T]
        for candidates in (
            candidate_sets.chosen,
            candidate_sets.scan_range,
            candidate_sets.near_minimum,
        )
    )
    # the paper says "roughly" of its two angles: that is taken for a tenth of its range of 70 degrees
    tolerance_deg = 7.0
    published_deg = candidate_sets.case.published["sun_height_range"].value
    difference_deg = np.subtract([elevation.value for elevation in chosen], published_deg)
    agrees = bool(np.all(np.abs(difference_deg) <= tolerance_deg))
    note = f"means over motions of the smallest and of the largest height; criterion: within {tolerance_deg:g} deg"
    ours = [elevation.value for elevation in by_recipe]
    row = make_row(candidate_sets.case, "sun_height_range", ours, note=note)
    smallest, largest = (
        judge_share(row, candidate_sets.source, of_chosen, of_possible, agrees)
        for of_chosen, of_possible in zip(chosen, possible, strict=True)
    )
    # both ends of the range stand in one row: each interval is a pair, and the row is informative if one of its ends is
    intervals = {
        key: [getattr(smallest, key), getattr(largest, key)]
        for key in ("low", "high", "prior_low", "prior_high")
    }
    informative = smallest.informative or largest.informative
    agrees = agrees if informative else None
    return replace(smallest, informative=informative, agrees=agrees, **intervals)


def describe_motion(candidate_sets: CandidateSets) -> list[str]:
    """Return two sentences: on the angles of the angular momentum, and on the angular speed just after the touchdown."""
    chosen, scan_range = candidate_sets.chosen, candidate_sets.scan_range
    if chosen.from_posterior:
        probability = "each with 95 % probability"
    else:
        probability = f"{candidate_sets.case.assumptions.study.confidence:.0%}"
    (small_low, small_high), (large_low, large_high) = (
        np.degrees(chosen.angle_range(which)) for which in (0, 1)
    )
    possible_low, possible_high = np.degrees(scan_range.angle_range(0))
    # the smaller angle is limited if the data exclude a degree at the lower end, or a tenth of the scan range at the upper
    limited_below = small_low > possible_low + 1
    limited_above = small_high < 0.9 * possible_high
    if limited_below or limited_above:
        limits = [f"above {small_low:.0f} degrees"] if limited_below else []
        limits += [f"below {small_high:.0f} degrees"] if limited_above else []
        angles = (
            "Angles of the angular momentum to the body z axis and to the Sun (not distinguishable): the smaller one is "
            f"{' and '.join(limits)} ({probability})"
        )
        # such a lander does not tumble visibly: the Sun's elevation hardly changes
        if small_high < 20:
            angles += f"; the momentum lies within {small_high:.0f} degrees of z or of the Sun"
    else:
        angles = "Angles of the angular momentum to the body z axis and to the Sun: the smaller one is hardly constrained"
    angles += f", the larger one {large_low:.0f} to {large_high:.0f} degrees."
    slow, fast = chosen.speed_range()
    if has_lower_bound(candidate_sets):
        speed = f"at least {slow:.2g} rad/s ({probability})"
    else:
        speed = "it may have stood still, no lower bound"
    # only the posterior uses the order of the samples, from which an upper bound follows
    upper = f", at most {fast:.3g} rad/s." if chosen.from_posterior else "; no upper bound."
    return [angles, f"Angular speed just after the touchdown: {speed}{upper}"]


def touchdown_figure(candidate_sets: CandidateSets, synthetic: bool) -> Figure:
    """Draw the angular speed at the touchdown and the two angles of the angular momentum over the sets of motions (Fig. 12)."""
    picture = empty_figure(11, 4.6)
    speed, angles = picture.subplots(1, 2)
    scan_range, chosen, near_minimum = (
        candidate_sets.scan_range,
        candidate_sets.chosen,
        candidate_sets.near_minimum,
    )
    set_texts = {
        "posterior": "draws of the posterior",
        "published": "the published lines, for any data",
    }
    chosen_text = set_texts.get(candidate_sets.source, f"motions of {candidate_sets.source}")
    if (calibration := candidate_sets.calibration) is not None:  # source "scan"
        factor = calibration.factor().value
        chosen_text = f"the {calibration.confidence:.0%} set, EMD < {factor:.2f} EMD_min"

    # bins so wide that 30 motions are in each on average: fewer would show the steps of the grid
    speeds = scan_range.speed_touchdown, chosen.speed_touchdown
    bins = int(np.clip(min(map(len, speeds)) / 30, 5, 40))
    edges = np.linspace(0.0, float(max(values.max() for values in speeds)), bins + 1)
    possible_density, chosen_density = (
        np.histogram(values, edges, density=True)[0] for values in speeds
    )
    style: dict[str, Any] = {"color": "#9a9a9a", "fill": True, "alpha": 0.45}
    speed.stairs(possible_density, edges, lw=1.8, label="possible before the data", **style)
    speed.stairs(chosen_density, edges, lw=1.8, color=COLOURS[0], label=f"left: {chosen_text}")
    if has_lower_bound(candidate_sets):
        # the range includes half a cell of the grid, so it begins below the slowest motion
        low, _ = chosen.speed_range()
        speed.axvspan(0, low, color=COLOURS[0], alpha=0.12, lw=0)
        label = f"our lower bound: {low:.3f} rad/s"
        speed.axvline(low, color=COLOURS[0], lw=1.4, ls=":", label=label)
    else:
        speed.plot([], [], " ", label="no lower bound follows")
    published = float(candidate_sets.case.published["rate_at_touchdown_min"].value)
    label = f"published lower bound: {published:g} rad/s"
    speed.axvline(published, color=COLOURS[1], ls="--", lw=1.4, label=label)
    speed.set(xlabel="angular speed just after the first touchdown (rad/s)", xlim=(0, edges[-1]))
    speed.set_ylabel("density (s/rad)")
    speed.legend(fontsize=8, ncols=2, **ABOVE)

    factor = candidate_sets.case.assumptions.study.near_minimum_factor
    for name, motions, marker, colour, size in (
        ("possible before the data", scan_range, "s", "#cccccc", 3.0),
        (f"left: {chosen_text}", chosen, "o", COLOURS[0], 1.8),
        (f"the paper's recipe, EMD < {factor:g} EMD_min", near_minimum, "D", COLOURS[1], 4.0),
    ):
        pairs = np.degrees(motions.angles)
        # at most 6,000 points, evenly chosen, and the motions at the ends of either angle
        ends = *pairs.argmin(axis=1), *pairs.argmax(axis=1)
        every = -(-len(motions) // 6000)  # rounded up
        drawn = np.union1d(np.arange(0, len(motions), every), ends)
        style = {"ms": size, "mew": 0, "color": colour, "rasterized": True}
        label = f"{name} ({count_text(len(motions), 'motion')})"
        angles.plot(*pairs[:, drawn], marker, label=label, **style)
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
