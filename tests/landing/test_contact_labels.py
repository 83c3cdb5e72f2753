"""What touches first is named as the vehicle file names it, and only parts of the hull are listed."""

from dataclasses import replace

import numpy as np

import sunspin as ss
from sunspin.landing.scenario import Scenario
from sunspin.output.kinds.outcomes import _first_contacts
from sunspin.vehicle import HullPart, Leg, Panel, Vehicle, Wheel

BOX = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.2, 0.2) for z in (-0.2, 0.3)])
TIPS = {"north": [0.5, 0.0, -0.5], "east": [-0.25, 0.43, -0.5], "west": [-0.25, -0.43, -0.5]}
LANDER = Vehicle(
    "lander",
    np.diag([1.9, 2.1, 1.6]),
    panels=[Panel("roof", [0, 0, 1], 1.0), Panel("side", [1, 0, 0], 1.0)],
    wheels=[Wheel("w", [0, 0, 1], 2e-3, 400.0)],
    legs=[Leg(name, tip) for name, tip in TIPS.items()],
    hull=(HullPart("box", BOX),),
)
SCENARIO = Scenario(sun_B=(0.0, 0.0, 1.0), after_s=100.0, wheel_speed_rad_s=(400.0,))


def contacts(vehicle: Vehicle) -> dict:
    rate = np.radians([[3.0, 1.0, 2.0]])
    return _first_contacts(ss.outcomes(vehicle, rate, "held", 200, 1, scenario=SCENARIO, workers=1))


def test_legs_have_their_names_and_panels_without_a_hull_are_not_listed() -> None:
    found = contacts(LANDER)
    assert list(found) == ["leg north", "leg east", "leg west", "bare body"]
    assert sum(each.value for each in found.values()) > 0.99


def test_a_panel_with_corners_in_the_hull_is_listed() -> None:
    roof = HullPart("lid", BOX[BOX[:, 2] > 0], panel="roof")
    found = contacts(replace(LANDER, hull=(*LANDER.hull, roof)))
    assert "panel roof" in found and "panel side" not in found
