"""A wheel slows down and rotates the body: Philae's flywheel after its motor was switched off."""

import numpy as np

import sunspin as ss

philae = ss.load_vehicle("philae")
t = np.arange(0, 2761, 60.0)
run = ss.propagate(
    philae, omega_B=[0.1, 0, 0], sun_B=[0.1959, 0.5690, 0.7986], wheel_speed_rad_s=865, t_s=t
)

stop = float(run.event_time_s[0])
print(
    f"the wheel stops after {stop / 60:.1f} min; the body then turns at {run.omega_B.values[-1, 2]:.2f} rad/s about z"
)

size = np.linalg.norm(
    run.momentum_B.values, axis=1
)  # friction is an inner torque: it cannot change the total
print(f"total momentum {size[0]:.3f} N m s, changed by {np.ptp(size) / size[0]:.0e} of itself")
assert abs(stop / 60 - 42.0) < 0.05 and np.ptp(size) < 1e-10 * size[0]

back = ss.propagate(
    philae, run.omega_B.values[-1], run.sun_B.values[-1], 0.0, t[::-1], stopped_at_s=stop
)
speed = float(back.wheel_speed_rad_s[-1, 0])
print(
    f"run backward: {back.omega_B.values[-1].round(6) + 0.0} rad/s again, the wheel at {speed:.3f} rad/s"
)
assert np.allclose(back.omega_B.values[-1], [0.1, 0, 0], atol=1e-8)
