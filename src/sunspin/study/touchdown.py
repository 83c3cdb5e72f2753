"""Back to the first touchdown: which rates it can have left (paper, section 3.2, Fig. 12)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from sunspin.cases import Case
from sunspin.infer.lines import point_at
from sunspin.study import rebound as rb
from sunspin.study.row import Row, published_row

LINE_POINTS = 41


@dataclass(frozen=True)
class Touchdown:
    """Body rates (n, 3) in rad/s just after the first touchdown: of a near-minimum set, and on the published lines."""

    case: Case
    omega_B: np.ndarray
    published_B: np.ndarray


def compute(case: Case, points: np.ndarray) -> Touchdown:
    """Run rates `points` (n, 3) at the first sample back to the touchdown, and points of the published lines too."""
    speed = rb.nominal_speed(case.vehicle)[0]
    omega_z = np.linspace(*rb.LINE_RANGE, LINE_POINTS)
    on_lines = np.concatenate([point_at(point, direction, 2, omega_z) for point, direction in rb.published_lines(case)])
    return Touchdown(case, rb.at_touchdown(case, points, speed), rb.at_touchdown(case, on_lines, speed))


def rows(result: Touchdown) -> list[Row]:
    """Figures of section 3.2 beside ours."""
    case = result.case
    nominal, coasted = rb.nominal_speed(case.vehicle)[0], rb.speed_at_first_sample(case)
    lines = rb.published_lines(case)
    as_published = rb.smallest_on_lines(case, lines, nominal)
    as_coasted = rb.smallest_on_lines(case, lines, coasted)
    ours = float(np.linalg.norm(result.omega_B, axis=1).min())
    return [
        published_row(
            case, "rate_at_touchdown_min", as_published, 0.01,
            f"on the published lines, wheel at {nominal:g} rad/s at the first sample; at {coasted:.0f} rad/s there (865 at "
            f"touchdown) {as_coasted:.4f}",
        ),
        Row(
            "rate_at_touchdown_min_scan", "the same, over the near-minimum set of the published lines' distribution",
            case.published["rate_at_touchdown_min"].value, ours, "rad/s", 0.01,
            bool(abs(ours - case.published["rate_at_touchdown_min"].value) <= 0.01),
            f"{len(result.omega_B)} grid points, run back with the wheel at {nominal:g} rad/s at the first sample",
            "paper, section 3.2",
        ),
    ]  # fmt: skip
