"""What touches first is named as the vehicle file names it, and only parts of the hull are listed."""

from dataclasses import replace

import numpy as np

import sunspin as ss
from sunspin.landing.scenario import Scenario
from sunspin.output.kinds.outcomes import _first_contacts
from sunspin.vehicle import HullPart
from tests.support.vehicles import small_lander

SCENARIO = Scenario(sun_B=(0.0, 0.0, 1.0), after_s=100.0, wheel_speed_rad_s=())


def test_legs_have_their_names_and_panels_without_a_hull_are_not_listed() -> None:
    """A panel with corners in the hull is listed."""
    lander, rate = small_lander(), np.radians([[3.0, 1.0, 2.0]])
    corners = lander.hull[0].points_B_m
    lid = HullPart("lid", corners[corners[:, 2] > 0], panel="z")
    for vehicle, parts in (
        (lander, ["bare body"]),
        (replace(lander, hull=(*lander.hull, lid)), ["panel z"]),
    ):
        runs = ss.outcomes(vehicle, rate, "off", 200, 1, scenario=SCENARIO, workers=1)
        found = _first_contacts(runs)
        assert [name for name in found if name != "bare body" or name in parts] == [
            *("leg a", "leg b", "leg c"),
            *parts,
        ]
        assert sum(each.value for each in found.values()) > 0.99
