"""What each kind of result can do: its numbers in words, its figures, its files. A new kind, or a figure more, is a line here."""

from __future__ import annotations

from sunspin.output.kind import Kind
from sunspin.output.kinds import (
    calibration,
    collision,
    comparison,
    motion,
    outcomes,
    posterior,
    rates,
    scan,
    telemetry,
)

KINDS: dict[str, Kind] = {
    "telemetry": Kind(
        "telemetry", "telemetry", telemetry.telemetry_summary, telemetry.telemetry_drawings
    ),
    "sun_directions": Kind(
        "sun", "sun", telemetry.sun_summary, telemetry.sun_drawings, telemetry.sun_tables
    ),
    "panel_quality": Kind(
        "panel_quality", "panel-quality", telemetry.quality_summary, telemetry.quality_drawings
    ),
    "panel_health": Kind(
        "panel_health", "panel-health", telemetry.health_summary, telemetry.health_drawings
    ),
    "calibration": Kind(
        "calibrate-sensors",
        "calibration",
        calibration.calibration_summary,
        tables=calibration.calibration_tables,
    ),
    "rates": Kind("rates", "rates", rates.rates_summary, rates.rates_drawings, rates.rates_tables),
    "trajectory": Kind(
        "simulate", "trajectory", motion.trajectory_summary, motion.trajectory_drawings
    ),
    "impact": Kind("impact", "impact", motion.impact_summary),
    "spin_down": Kind(
        "spin_down", "spin-down", motion.spin_down_summary, motion.spin_down_drawings
    ),
    "scan": Kind("scan", "scan", scan.scan_summary, scan.scan_drawings, scan.scan_tables),
    "lines": Kind("lines", "lines", scan.lines_summary),
    "posterior": Kind(
        "posterior",
        "posterior",
        posterior.posterior_summary,
        posterior.posterior_drawings,
        posterior.posterior_tables,
        posterior.posterior_datasets,
    ),
    "predictions": Kind(
        "predictions",
        "predictions",
        posterior.predictions_summary,
        posterior.predictions_drawings,
        posterior.predictions_tables,
    ),
    "outcomes": Kind("outcomes", "outcomes", outcomes.outcomes_summary, outcomes.outcomes_drawings),
    "strategies": Kind(
        "outcomes",
        "strategies",
        outcomes.strategies_summary,
        outcomes.strategies_drawings,
        outcomes.strategies_tables,
    ),
    "collision": Kind(
        "outcomes", "collision", collision.collision_summary, collision.collision_drawings
    ),
    "comparison": Kind(
        "compare",
        "comparison",
        comparison.comparison_summary,
        comparison.comparison_drawings,
        comparison.comparison_tables,
    ),
    "landing": Kind(
        "outcomes",
        "",
        outcomes.landing_summary,
        outcomes.landing_drawings,
        outcomes.landing_tables,
        outcomes.landing_datasets,
    ),
}
"""`attrs["kind"]` -> what can be said, drawn and written of it."""
