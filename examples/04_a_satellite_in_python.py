"""A satellite described in Python: simulated powers of six panels, and the body rate estimated from them."""

import numpy as np

import sunspin as ss

axes = np.concatenate([np.eye(3), -np.eye(3)])
panels = [
    ss.Panel(name, normal, gain=0.5)
    for name, normal in zip(["+X", "+Y", "+Z", "-X", "-Y", "-Z"], axes, strict=True)
]
cube = ss.Vehicle(
    "cube", inertia_kg_m2=np.diag([0.0018, 0.0020, 0.0022]), panels=panels, gain_unit="A"
)

t = np.array([0.0, 9, 21, 30, 38, 51, 60, 72])  # uneven times tell whole turns apart
truth = {"omega_B": [0.03, 0.02, -0.04], "sun_B": [0.48, 0.6, 0.64], "t_s": t, "noise": 0.01}
seen = ss.twin(cube, truth, seed=3)
found = ss.rates(
    cube,
    ss.sun_directions(cube, seen, noise=0.01),
    source="directions",
    max_rate_rad_s=0.15,
    acceleration_noise=1e-5,
)

best, sigma = found.omega_B.values[0], np.sqrt(np.diagonal(found.omega_cov_B.values[0]))
print(
    f"true rate {truth['omega_B']} rad/s, estimate {best.round(4)} +- {sigma.round(4)}, "
    f"probability {found.probability.values[0, 0]:.2f}"
)
print(found.attrs["verdict"])
assert np.all(np.abs(best - truth["omega_B"]) < 4 * sigma)
