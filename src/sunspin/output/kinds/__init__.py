"""Summary, figures and files of each kind of result. A module is imported when the first result of its kinds is used.

Each module registers its kinds in `KINDS`. Some bring the compiler or large parts of SciPy, which a command for results of another
kind would wait for.
"""

MODULES = {
    "calibration": "calibration",
    "collision": "collision",
    "comparison": "comparison",
    "history": "history",
    "trajectory": "motion",
    "impact": "motion",
    "spin_down": "motion",
    "outcomes": "outcomes",
    "panel_quality": "panels",
    "panel_health": "panels",
    "plan": "plan",
    "pointing": "pointing",
    "posterior": "posterior",
    "predictions": "predictions",
    "rates": "rates",
    "scan": "scan",
    "lines": "scan",
    "strategies": "strategies",
    "landing": "strategies",
    "telemetry": "telemetry",
    "sun_directions": "telemetry",
}
"""`attrs["kind"]` of a result -> the module of this package that registers the kind in `KINDS`."""
