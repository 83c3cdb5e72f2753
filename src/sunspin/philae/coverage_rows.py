"""What the twins say of the paper's answer, in rows (see :mod:`sunspin.philae.coverage`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.estimate.scan.coverage import Share, Twins, twins_of
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.telemetry.case import Case

KINDS = {"lines": "truth on the published lines", "grid": "truth anywhere in the scanned box"}


def _middle(values: np.ndarray) -> list[float]:
    """5, 50 and 95 % of the values that are known; NaN where none is (no lines could be fitted)."""
    known = values[np.isfinite(values)]
    return (
        [float(x) for x in np.quantile(known, [0.05, 0.5, 0.95])]
        if known.size
        else [float("nan")] * 3
    )


def _range(values: np.ndarray, digits: int = 3) -> str:
    low, middle, high = _middle(values)
    return f"median {middle:.{digits}f}, 5 to 95 % {low:.{digits}f} to {high:.{digits}f}"


def rows(case: Case, found: xr.Dataset) -> list[Row]:
    """Rows of a coverage of the method."""
    about, twins = found.attrs, twins_of(found)
    how = f"synthetic: {twins['lines'].n} twins of each kind on {about['grid_points']} grid points; `{about['command']}`"
    return [
        *_data_rows(case, twins, how),
        *_line_rows(case, twins, how),
        *_set_rows(case, twins, about, how),
        *_bound_rows(case, twins, about, how),
    ]


def _data_rows(case: Case, twins: dict[str, Twins], how: str) -> list[Row]:
    lines, published = twins["lines"], case.published["emd_min"].value
    above = Share(int((lines.twin["emd_min"] >= published).sum()), lines.n)
    told, known = lines.twin["n_told"], _middle(lines.twin["emd_min"])
    return [
        row(
            case,
            "worth_emd_min",
            known,
            published=published,
            least=int(told.min()),
            most=int(told.max()),
            above=above,
            how=how,
        )
    ]


def _line_rows(case: Case, twins: dict[str, Twins], how: str) -> list[Row]:
    lines, grid = twins["lines"], twins["grid"]
    fitted = Share(int(np.isfinite(lines.twin["line_angle"][:, 0]).sum()), lines.n)
    near = [Share(int((t.twin["truth_to_line"] <= 0.03).sum()), t.n) for t in (lines, grid)]
    return [
        row(
            case,
            "worth_line_angle",
            np.degrees(_middle(lines.twin["line_angle"])).tolist(),
            fitted=fitted,
            how=how,
        ),
        row(
            case,
            "worth_line_distance",
            _middle(lines.twin["line_distance"]),
            omega_z=list(rb.LINE_RANGE),
            points=_range(lines.twin["points"], 0),
        ),
        row(
            case,
            "worth_truth_on_line",
            near[0].value,
            near=near,
            to_set=_range(lines.twin["truth_to_set"]),
        ),
    ]


def _set_rows(case: Case, twins: dict[str, Twins], about: dict[str, Any], how: str) -> list[Row]:
    smallest, factor, confidence = (
        case.published["emd_min"].value,
        about["factor"],
        about["confidence"],
    )
    inside = {kind: twins[kind].in_set(factor) for kind in KINDS}
    each = "; ".join(f"{KINDS[kind]}: {share}" for kind, share in inside.items())
    found = [
        row(
            case,
            "worth_truth_in_set",
            inside["lines"].value,
            published=None,
            factor=factor,
            each=each,
            how=how,
        )
    ]
    for relative, name in ((True, "worth_factor"), (False, "worth_threshold")):
        values = {kind: twins[kind].threshold(confidence, relative) for kind in KINDS}
        size = twins["lines"].at(values["lines"][0], relative)["count"] / about["grid_points"]
        found.append(
            row(
                case,
                name,
                values["lines"][0],
                id=f"{name}_{100 * confidence:g}",
                published=factor if relative else None,
                confidence=confidence,
                size=size,
                flown=values["lines"][0] * (smallest if relative else 1 / smallest),
                each="; ".join(
                    f"{KINDS[k]}: {v[0]:.4g} ({v[1]:.4g} to {v[2]:.4g})" for k, v in values.items()
                ),
            )
        )
    return found


def _bound_rows(case: Case, twins: dict[str, Twins], about: dict[str, Any], how: str) -> list[Row]:
    lines, grid = twins["lines"], twins["grid"]
    published, confidence = case.published["rate_at_touchdown_min"].value, about["confidence"]
    found = [
        row(
            case,
            "worth_bound",
            _holds(lines, "bound_set").value,
            published=None,
            factor=about["factor"],
            how=how,
            held={name: _holds(lines, name) for name in ("bound_set", "bound_lines")},
            box=_holds(grid, "bound_set"),
            speed={
                name: _range(lines.twin[name])
                for name in ("bound_set", "bound_lines", "truth_touchdown_speed")
            },
        )
    ]
    best = min(
        (False, True),
        key=lambda r: float(lines.at(lines.threshold(confidence, r)[0], r)["count"][1]),
    )
    for relative in (False, True):
        threshold, low, high = lines.threshold(confidence, relative)
        between = " to ".join(f"{lines.at(end, relative)['speed'][1]:.3f}" for end in (high, low))
        region, direct = lines.at(threshold, relative), lines.bound_threshold(confidence, relative)
        says = [
            "note",
            "note_none" if direct is None else "note_direct",
            *(["note_best"] if relative == best else []),
        ]
        reached = (
            {}
            if direct is None
            else {"direct": direct, "bound": lines.at(direct, relative)["speed"][1]}
        )
        found.append(
            row(
                case,
                "worth_bound_region",
                [float(x) for x in region["speed"]],
                says=tuple(says),
                published=published,
                id=f"worth_bound_{100 * confidence:g}_{'relative' if relative else 'absolute'}",
                confidence=confidence,
                on="as a multiple of the smallest EMD" if relative else "on EMD itself",
                region=region,
                between=between,
                **reached,
            )
        )
    return found


def _holds(twins: Twins, name: str) -> Share:
    bound = twins.twin[name]
    known = np.isfinite(bound)
    return Share(
        int((bound[known] <= twins.twin["truth_touchdown_speed"][known]).sum()), int(known.sum())
    )
