"""What the twins say of the paper's answer, in sentences and rows (see :mod:`sunspin.philae.coverage`)."""

from __future__ import annotations

from typing import Any

import numpy as np

from sunspin.philae import rebound as rb
from sunspin.philae.coverage import CONFIDENCE, Share, Twins, Worth
from sunspin.philae.row import Row
from sunspin.telemetry.case import Case

SECTION = "paper, sections 2.3 and 3.2; not considered there"

KINDS = {"lines": "truth on the published lines", "grid": "truth anywhere in the scanned box"}


def _middle(values: np.ndarray) -> list[float]:
    """5, 50 and 95 % of the values that are known; NaN where none is (no lines could be fitted)."""
    known = values[np.isfinite(values)]
    return [float(x) for x in np.quantile(known, [0.05, 0.5, 0.95])] if known.size else [float("nan")] * 3


def _range(values: np.ndarray, digits: int = 3) -> str:
    low, middle, high = _middle(values)
    return f"median {middle:.{digits}f}, 5 to 95 % {low:.{digits}f} to {high:.{digits}f}"


def rows(case: Case, worth: Worth, confidence: float = CONFIDENCE) -> list[Row]:
    """Rows of the method's worth."""
    how = f"synthetic: {worth.twins['lines'].n} twins of each kind on {worth.grid_points} grid points; `{worth.command}`"
    return [
        *_data_rows(case, worth, how), *_line_rows(worth, how), *_set_rows(case, worth, confidence, how),
        *_bound_rows(case, worth, confidence, how),
    ]  # fmt: skip


def _data_rows(case: Case, worth: Worth, how: str) -> list[Row]:
    lines, published = worth.twins["lines"], case.published["emd_min"].value
    above = Share(int((lines.twin["emd_min"] >= published).sum()), lines.n)
    told = lines.twin["n_told"]
    return [
        Row(
            "worth_emd_min", "smallest EMD of a data set as sampling noise alone makes it: 5, 50, 95 %", published,
            _middle(lines.twin["emd_min"]), "1", None, None,
            f"{KINDS['lines']}, {int(told.min())} to {int(told.max())} directions; as large as the published one or larger in "
            f"{above} of the twins; {how}", SECTION,
        )
    ]  # fmt: skip


def _line_rows(worth: Worth, how: str) -> list[Row]:
    lines, grid = worth.twins["lines"], worth.twins["grid"]
    fitted = Share(int(np.isfinite(lines.twin["line_angle"][:, 0]).sum()), lines.n)
    near = [Share(int((t.twin["truth_to_line"] <= 0.03).sum()), t.n) for t in (lines, grid)]
    return [
        Row(
            "worth_line_angle", "how far the four lines turn from one data set to another: 5, 50, 95 % of the angle", "not "
                "considered",
            np.degrees(_middle(lines.twin["line_angle"])).tolist(), "deg", None, None,
            f"against the published lines, on which the truth lies; four lines could be fitted in {fitted} of the twins, the other "
            f"sets have fewer than 8 points; {how}", SECTION,
        ),
        Row(
            "worth_line_distance", "how far they move: 5, 50, 95 % of the mean distance", "not considered",
            _middle(lines.twin["line_distance"]), "rad/s", None, None,
            f"over omega_z in {list(rb.LINE_RANGE)} rad/s; points in the set: "
            f"{_range(lines.twin['points'], 0)}", SECTION,
        ),
        Row(
            "worth_truth_on_line", "how often the truth is within two grid steps (0.03 rad/s) of a fitted line", "not considered",
            near[0].value, "1", None, None,
            f"{near[0]}; {KINDS['grid']}: {near[1]}; distance of the truth from the nearest point of the set "
            f"{_range(lines.twin['truth_to_set'])} rad/s", SECTION,
        ),
    ]  # fmt: skip


def _set_rows(case: Case, worth: Worth, confidence: float, how: str) -> list[Row]:
    found, smallest = [], case.published["emd_min"].value
    inside = {kind: worth.twins[kind].in_set(worth.factor) for kind in KINDS}
    found.append(
        Row(
            "worth_truth_in_set", f"how often the truth lies in the set EMD < {worth.factor:g} EMD_min (nothing is claimed)", None,
            inside["lines"].value, "1", None, None,
            "; ".join(f"{KINDS[kind]}: {share}" for kind, share in inside.items()) + f"; {how}", SECTION,
        )
    )  # fmt: skip
    for relative, name, what in (
        (True, "worth_factor", "factor on the smallest EMD"), (False, "worth_threshold", "threshold on EMD"),
    ):  # fmt: skip
        values = {kind: worth.twins[kind].threshold(confidence, relative) for kind in KINDS}
        size = worth.twins["lines"].at(values["lines"][0], relative)["count"] / worth.grid_points
        flown = values["lines"][0] * (smallest if relative else 1 / smallest)
        other = f"that is {flown:.3f}" if relative else f"that is {flown:.2f} times it"
        found.append(
            Row(
                f"{name}_{100 * confidence:g}", f"{what} that makes the level set a {confidence:.0%} confidence region",
                worth.factor if relative else None, values["lines"][0], "1", None, None,
                "; ".join(f"{KINDS[k]}: {v[0]:.4g} ({v[1]:.4g} to {v[2]:.4g})" for k, v in values.items())
                + f"; the set then holds {size[1]:.1%} of the scanned box in the median twin, {size[0]:.1%} to {size[2]:.1%} in "
f"nine of ten; for the published smallest EMD {other}", SECTION,
            )
        )  # fmt: skip
    return found


def _bound_rows(case: Case, worth: Worth, confidence: float, how: str) -> list[Row]:
    lines, grid = worth.twins["lines"], worth.twins["grid"]
    published = case.published["rate_at_touchdown_min"].value
    held = {name: _holds(lines, name) for name in ("bound_set", "bound_lines")}
    found = [
        Row(
            "worth_bound", f"how often the smallest speed of the set EMD < {worth.factor:g} EMD_min is a bound on the true one",
            None, held["bound_set"].value, "1", None, None,
            f"of the points: {held['bound_set']}, {_range(lines.twin['bound_set'])} rad/s; along the lines fitted to them: "
            f"{held['bound_lines']}, {_range(lines.twin['bound_lines'])} rad/s; {KINDS['grid']}, points: "
            f"{_holds(grid, 'bound_set')}; the true speeds on the published lines: "
            f"{_range(lines.twin['truth_touchdown_speed'])} rad/s; {how}", SECTION,
        )
    ]  # fmt: skip
    best = min((False, True), key=lambda r: float(lines.at(lines.threshold(confidence, r)[0], r)["count"][1]))
    for relative in (False, True):
        threshold, low, high = lines.threshold(confidence, relative)
        between = " to ".join(f"{lines.at(end, relative)['speed'][1]:.3f}" for end in (high, low))
        region, direct = lines.at(threshold, relative), lines.bound_threshold(confidence, relative)
        enough = "no threshold kept does" if direct is None else (
            f"{direct:.4g} does, median bound {lines.at(direct, relative)['speed'][1]:.3f} rad/s")  # fmt: skip
        kind = "relative" if relative else "absolute"
        found.append(
            Row(
                f"worth_bound_{100 * confidence:g}_{kind}",
                f"smallest angular speed just after the first touchdown over the {confidence:.0%} region, threshold "
                f"{'as a multiple of the smallest EMD' if relative else 'on EMD itself'}: 5, 50, 95 % of the twins", published,
                [float(x) for x in region["speed"]], "rad/s", None, None,
                f"a bound on the true speed in {region['holds']} of the twins (threshold {region['threshold']:.4g}; median "
                f"{between} over the threshold's own 95 % interval); for the bound "
                f"alone to hold in {confidence:.0%}, {enough}"
                + ("; the smaller of the two regions" if relative == best else ""), SECTION,
            )
        )  # fmt: skip
    return found


def _holds(twins: Twins, name: str) -> Share:
    bound = twins.twin[name]
    known = np.isfinite(bound)
    return Share(int((bound[known] <= twins.twin["truth_touchdown_speed"][known]).sum()), int(known.sum()))


def sentences(worth: Worth, confidence: float = CONFIDENCE) -> list[str]:
    """The findings for readers of the report."""
    lines: Twins = worth.twins["lines"]
    factor, threshold = (lines.threshold(confidence, relative)[0] for relative in (True, False))
    region: dict[str, Any] = lines.at(factor, True)
    share = region["count"][1] / worth.grid_points
    angle = _middle(np.degrees(lines.twin["line_angle"]))[1]
    return [
        f"The method repeated on {lines.n} synthetic rebounds whose truth lies on the published lines: the truth lies in the set "
        f"within {worth.factor:g} times the smallest EMD in {lines.in_set(worth.factor)} of them, and the fitted lines turn by "
        f"{angle:.0f} degrees in the median. For {confidence:.0%} the threshold must be {factor:.2g} times the smallest EMD (or "
        f"EMD < {threshold:.3f}); the set then holds {share:.0%} of the scanned box, and the lower bound on the angular speed "
        f"after the touchdown is {region['speed'][1]:.3f} rad/s, both in the median twin. Repeat with `{worth.command}`."
    ]
