"""How often the paper's method finds the truth: the study of simulated rebounds that comes with the case, and its rows.

`python -m studies.coverage` repeats the method on rebounds whose rates are known and writes the file that is read here. The
near-minimum set has a threshold that was chosen, not derived. The study shows how often the truth lies in it, which threshold
holds the truth with a given probability, and what the smallest angular speed of the set becomes with that threshold.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.special import ndtri

from sunspin.base.errors import InputError, sentence
from sunspin.philae import rebound as rb
from sunspin.philae.row import Row, row
from sunspin.philae.threshold import CONFIDENCE, holding
from sunspin.telemetry.case import Case

SHIPPED = "worth.json"
"""The study that comes with the case: 300 twins of each kind on the paper's whole grid, made by the command that it names."""

KINDS = {"lines": "truth on the published lines", "grid": "truth anywhere in the scanned box"}
"""Where true rates are drawn: omega_z even over `rebound.LINE_RANGE` on a published line, or even over the scanned box."""


@dataclass(frozen=True)
class Share:
    """A share k of n with its 95 % interval (Wilson's, which stays inside 0..1)."""

    k: int
    n: int

    @property
    def value(self) -> float:
        return self.k / self.n if self.n else float("nan")

    @property
    def interval(self) -> tuple[float, float]:
        if not self.n:
            return 0.0, 1.0
        z, p = float(ndtri(0.975)), self.value
        centre, half = (
            p + z**2 / (2 * self.n),
            z * np.sqrt(p * (1 - p) / self.n + z**2 / (4 * self.n**2)),
        )
        return float((centre - half) / (1 + z**2 / self.n)), float(
            (centre + half) / (1 + z**2 / self.n)
        )

    def __str__(self) -> str:
        low, high = self.interval
        return f"{self.value:.1%} ({low:.1%} to {high:.1%})"


@dataclass(frozen=True)
class Twins:
    """The method on n simulated rebounds (twins) of one kind.

    Attributes
    ----------
    twin : name -> (n, ...): "n_told" directions, "emd_min" of the scan, "emd_truth", "points" of the near-minimum set, rad/s from
        the truth to its nearest point ("truth_to_set") and line ("truth_to_line"); for each fitted line "line_angle" (rad) to its
        published partner and "line_distance" (rad/s); rad/s at the touchdown: "truth_touchdown_speed", smallest of the set
        ("bound_set") and of the lines ("bound_lines")
    levels, factors : "at" (m), thresholds on EMD or on its ratio to the smallest; "count" and "speed" (m, 3), quantiles 5, 50
        and 95 % over the twins of the size of the level set and of its smallest angular speed at the touchdown (rad/s);
        "holds" (m), number of twins whose true speed is no smaller than that
    """

    twin: dict[str, np.ndarray]
    levels: dict[str, np.ndarray]
    factors: dict[str, np.ndarray]

    @property
    def n(self) -> int:
        return len(self.twin["emd_min"])

    @property
    def ratio(self) -> np.ndarray:
        """EMD of the truth over the smallest of the scan, (n)."""
        return self.twin["emd_truth"] / self.twin["emd_min"]

    def in_set(self, factor: float) -> Share:
        """How often the truth lies in the level set of this factor."""
        return Share(int((self.ratio < factor).sum()), self.n)

    def threshold(self, confidence: float, relative: bool) -> tuple[float, float, float]:
        """Threshold that holds the truth with this probability, and its 95 % interval: on EMD, or relative to the smallest."""
        return holding(self.ratio if relative else self.twin["emd_truth"], confidence)

    def at(self, threshold: float, relative: bool) -> dict[str, Any]:
        """Size, smallest speed (5, 50, 95 %) and how often it is a bound, at the kept threshold next above."""
        table = self.factors if relative else self.levels
        k = min(int(np.searchsorted(table["at"], threshold)), len(table["at"]) - 1)
        return {
            "threshold": float(table["at"][k]),
            "count": table["count"][k],
            "speed": table["speed"][k],
            "holds": Share(int(table["holds"][k]), self.n),
        }

    def bound_threshold(self, confidence: float, relative: bool) -> float | None:
        """Smallest kept threshold from which on the level set's smallest speed is a bound with this probability."""
        table = self.factors if relative else self.levels
        fails = np.flatnonzero(table["holds"] < confidence * self.n)
        k = 0 if fails.size == 0 else int(fails[-1]) + 1
        return float(table["at"][k]) if k < len(table["at"]) else None


@dataclass(frozen=True)
class Coverage:
    """The study: twins of each of `KINDS`, near-minimum factor, motions of the scan's grid, command that makes it."""

    twins: dict[str, Twins]
    factor: float
    grid_points: int
    command: str


def from_json(text: str, where: str) -> Coverage:
    """What the study wrote."""

    def arrays(part: dict[str, Any]) -> dict[str, np.ndarray]:
        return {name: np.array(values, dtype=np.float64) for name, values in part.items()}

    try:
        data = json.loads(text)
        twins = {
            kind: Twins(*(arrays(parts[name]) for name in ("twin", "levels", "factors")))
            for kind, parts in data["twins"].items()
        }
        return Coverage(twins, data["factor"], data["grid_points"], data["command"])
    except (ValueError, KeyError, TypeError) as error:
        raise InputError(
            sentence(f"this is no study of the paper's method ({error})", where=where)
        ) from None


def shipped(case: Case) -> Coverage | None:
    """The study that comes with the case, if one does."""
    path = case.folder / SHIPPED
    return from_json(path.read_text("utf-8"), str(path)) if path.is_file() else None


def told(study: Coverage) -> str:
    """The findings for readers of the report."""
    lines = study.twins["lines"]
    factor, threshold = (lines.threshold(CONFIDENCE, relative)[0] for relative in (True, False))
    region = lines.at(factor, True)
    angles = np.degrees(lines.twin["line_angle"])
    known = angles[np.isfinite(angles)]
    turn = (
        f"the fitted lines turn by {np.median(known):.0f} degrees in the median"
        if known.size
        else "no set has four lines"
    )
    return (
        f"The method repeated on {lines.n} synthetic rebounds whose truth lies on the published lines: the truth lies in the set "
        f"within {study.factor:g} times the smallest EMD in {lines.in_set(study.factor)} of them, and {turn}. "
        f"For {CONFIDENCE:.0%} the threshold must be {factor:.2g} times the smallest EMD (or EMD < {threshold:.3f}); the set then "
        f"holds {region['count'][1] / study.grid_points:.0%} of the scanned box, and the lower bound on the angular speed after "
        f"the touchdown is {region['speed'][1]:.3f} rad/s, both in the median twin. Repeat with `{study.command}`."
    )


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


def rows(case: Case, study: Coverage) -> list[Row]:
    """Rows of the study."""
    twins = study.twins
    how = f"synthetic: {twins['lines'].n} twins of each kind on {study.grid_points} grid points; `{study.command}`"
    return [
        *_data_rows(case, twins, how),
        *_line_rows(case, twins, how),
        *_set_rows(case, study, how),
        *_bound_rows(case, study, how),
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


def _set_rows(case: Case, study: Coverage, how: str) -> list[Row]:
    twins, factor, smallest = study.twins, study.factor, case.published["emd_min"].value
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
        values = {kind: twins[kind].threshold(CONFIDENCE, relative) for kind in KINDS}
        size = twins["lines"].at(values["lines"][0], relative)["count"] / study.grid_points
        found.append(
            row(
                case,
                name,
                values["lines"][0],
                id=f"{name}_{100 * CONFIDENCE:g}",
                published=factor if relative else None,
                confidence=CONFIDENCE,
                size=size,
                flown=values["lines"][0] * (smallest if relative else 1 / smallest),
                each="; ".join(
                    f"{KINDS[k]}: {v[0]:.4g} ({v[1]:.4g} to {v[2]:.4g})" for k, v in values.items()
                ),
            )
        )
    return found


def _bound_rows(case: Case, study: Coverage, how: str) -> list[Row]:
    lines, grid = study.twins["lines"], study.twins["grid"]
    published = case.published["rate_at_touchdown_min"].value
    found = [
        row(
            case,
            "worth_bound",
            _holds(lines, "bound_set").value,
            published=None,
            factor=study.factor,
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
        key=lambda r: float(lines.at(lines.threshold(CONFIDENCE, r)[0], r)["count"][1]),
    )
    for relative in (False, True):
        threshold, low, high = lines.threshold(CONFIDENCE, relative)
        between = " to ".join(f"{lines.at(end, relative)['speed'][1]:.3f}" for end in (high, low))
        region, direct = lines.at(threshold, relative), lines.bound_threshold(CONFIDENCE, relative)
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
                id=f"worth_bound_{100 * CONFIDENCE:g}_{'relative' if relative else 'absolute'}",
                confidence=CONFIDENCE,
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
