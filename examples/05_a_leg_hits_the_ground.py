"""A leg hits the ground and sticks for an instant: how the impact changes the rotation."""

import numpy as np

import sunspin as ss

philae = ss.load_vehicle("philae")
legs = [leg.name for leg in philae.legs]
omega, velocity = [0.0, 0.1, 0.35], [0.05, 0.0, -0.2]
for leg in legs:
    after = ss.impact(philae, omega, wheel_speed_rad_s=120, velocity_B=velocity, leg=leg)
    tip = next(item.tip_B_m for item in philae.legs if item.name == leg)
    left = after.velocity_B.values + np.cross(
        after.omega_B.values, tip
    )  # the leg's end has stopped
    print(
        f"{leg}: rate {after.omega_B.values.round(3)} rad/s, impulse {np.linalg.norm(after.impulse_B):.1f} N s"
    )
    assert np.abs(left).max() < 1e-12
