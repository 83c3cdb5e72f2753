"""What a Dataset of collisions that were weighted by what is known of the blow holds (kind "collision")."""

from __future__ import annotations

from typing import Any

from sunspin.landing.tally import Estimate

WITHOUT_ERROR = ("effective_runs", "median_period_after")
"""Quantities that are numbers and no means."""


def facts_of(found: Any) -> dict[str, float]:
    """What the trajectory shows, by name."""
    return dict(
        zip(found["fact"].values.tolist(), found["fact_value"].values.tolist(), strict=True)
    )


def weightings(found: Any) -> list[dict[str, Any]]:
    """A line for each weighting: its `name`, and each quantity as an `Estimate` or a number."""
    quantities = found["quantity"].values.tolist()
    return [
        {"name": str(name)}
        | {
            quantity: float(value)
            if quantity in WITHOUT_ERROR
            else Estimate(float(value), float(error))
            for quantity, value, error in zip(quantities, values, errors, strict=True)
        }
        for name, values, errors in zip(
            found["weighting"].values, found["value"].values, found["error"].values, strict=True
        )
    ]


def explained(found: Any) -> Estimate:
    """The share of collisions, as drawn, that come near the trajectory's speeds."""
    return Estimate(float(found["explained"]), float(found["explained_error"]))
