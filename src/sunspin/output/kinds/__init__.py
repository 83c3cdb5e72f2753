"""What each kind of result can do: its numbers in words, its figures, its files. A new kind, or a figure more, is a line here."""

from __future__ import annotations

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
from sunspin.output.kinds.kind import Kind

KINDS: dict[str, Kind] = {
    "telemetry": Kind(
        "telemetry", "telemetry.nc", telemetry.telemetry_summary, telemetry.telemetry_drawings
    ),
    "sun_directions": Kind(
        "sun", "sun.nc", telemetry.sun_summary, telemetry.sun_drawings, telemetry.sun_tables
    ),
    "panel_quality": Kind(
        "panel_quality", "panel-quality.nc", telemetry.quality_summary, telemetry.quality_drawings
    ),
    "panel_health": Kind(
        "panel_health", "panel-health.nc", telemetry.health_summary, telemetry.health_drawings
    ),
    "calibration": Kind(
        "calibrate-sensors",
        "calibration.nc",
        calibration.calibration_summary,
        tables=calibration.calibration_tables,
    ),
    "rates": Kind(
        "rates", "rates.nc", rates.rates_summary, rates.rates_drawings, rates.rates_tables
    ),
    "trajectory": Kind(
        "simulate", "trajectory.nc", motion.trajectory_summary, motion.trajectory_drawings
    ),
    "impact": Kind("impact", "impact.nc", motion.impact_summary),
    "spin_down": Kind(
        "spin_down", "spin-down.nc", motion.spin_down_summary, motion.spin_down_drawings
    ),
    "scan": Kind("scan", "scan.nc", scan.scan_summary, scan.scan_drawings),
    "lines": Kind("lines", "lines.nc", scan.lines_summary),
    "posterior": Kind(
        "posterior",
        "posterior.nc",
        posterior.posterior_summary,
        posterior.posterior_drawings,
        posterior.posterior_tables,
    ),
    "predictions": Kind(
        "predictions",
        "predictions.nc",
        posterior.predictions_summary,
        posterior.predictions_drawings,
        posterior.predictions_tables,
    ),
    "outcomes": Kind(
        "outcomes", "outcomes.nc", outcomes.outcomes_summary, outcomes.outcomes_drawings
    ),
    "strategies": Kind(
        "outcomes", "strategies.nc", outcomes.strategies_summary, outcomes.strategies_drawings
    ),
    "collision": Kind(
        "outcomes", "collision.nc", collision.collision_summary, collision.collision_drawings
    ),
    "comparison": Kind(
        "compare",
        "comparison.nc",
        comparison.comparison_summary,
        comparison.comparison_drawings,
        comparison.comparison_tables,
    ),
    "landing": Kind(
        "outcomes", "", outcomes.landing_summary, outcomes.landing_drawings, outcomes.landing_tables
    ),
}
"""`attrs["kind"]` -> what can be said, drawn and written of it."""
