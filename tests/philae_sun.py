"""The built-in telemetry of Philae and its Sun directions, computed once for all tests that read them."""

import sunspin as ss

CASE = ss.load_case("philae")
SUN = ss.sun_directions(CASE.vehicle, CASE.telemetry)
