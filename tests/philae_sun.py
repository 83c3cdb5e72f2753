"""The built-in telemetry of Philae and its Sun directions, computed once for all tests that read them.

AS_DRAWN is the case as it was before: panels that stand as drawn, no direction at rest, and of forty seeds the one whose speed
after the collision is nearest to what the magnetometer saw.
"""

import tomllib
from dataclasses import replace
from pathlib import Path

import sunspin as ss
from sunspin.philae.rebound import with_telemetry
from sunspin.vehicle import Vehicle

CASE = ss.load_case("philae")
SUN = ss.sun_directions(CASE.vehicle, CASE.telemetry)


def as_drawn(vehicle: Vehicle) -> Vehicle:
    """The vehicle without the sigmas of how its panels stand."""
    turns = {key for key in vehicle.facts if key.endswith(("normal_B", "turned_B_rad"))}
    return replace(
        vehicle,
        facts={
            key: replace(x, sigma=None) if key in turns else x for key, x in vehicle.facts.items()
        },
    )


FORMER = Path(__file__).parent / "philae" / "panels_as_drawn.csv"
FORMER_TRUTH = tomllib.loads(FORMER.with_suffix(".toml").read_text("utf-8"))
AS_DRAWN = with_telemetry(
    replace(CASE, vehicle=as_drawn(CASE.vehicle)), ss.read_telemetry(FORMER, CASE.vehicle)
)
SUN_AS_DRAWN = ss.sun_directions(AS_DRAWN.vehicle, AS_DRAWN.telemetry)
