"""Scan of initial rates: a small grid, compared with the distribution of r_z and with Sun directions (synthetic)."""

import numpy as np

import sunspin as ss

vehicle = ss.load_vehicle("philae")
t = np.arange(0, 900, 30.0)
truth = {
    "omega_B": [-0.2, 0.05, 0.0],
    "sun_B": [0.196, 0.569, 0.799],
    "t_s": t,
    "wheel_speed_rad_s": [865],
}
seen = ss.twin(vehicle, truth, seed=1)
sun = ss.sun_directions(vehicle, seen).dropna("time", subset=["sun_B"])
start = seen.true_sun_B.values[0]

grid = np.arange(-0.3, 0.31, 0.05), np.arange(-0.3, 0.31, 0.05), np.array([-0.05, 0.0, 0.05])
volume = ss.scan(
    vehicle, sun.sun_B.values[:, 2], start, *grid, wheel_speed_rad_s=865, duration_s=870
)
near = ss.near_minimum(volume, factor=2)
print(
    f"{len(near)} of {volume.size} motions come within twice the smallest EMD: heights alone leave much open"
)

at_truth = float(volume.sel(omega_x=-0.2, omega_y=0.05, omega_z=0.0, method="nearest"))
print(f"the truth has EMD {at_truth:.3f}, the smallest is {float(volume.min()):.3f}")
assert at_truth < 0.1
