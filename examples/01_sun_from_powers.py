"""Sun direction from the powers of six panels, or the reason why there is none."""

import numpy as np

import sunspin as ss

philae = ss.load_vehicle("philae")
truth = np.array([[0.48, 0.36, 0.8], [0.8, 0.0, 0.6], [0.6, 0.0, -0.8]])
powers = ss.panel_power(
    philae, truth
)  # what the panels would read, in units of a cell at normal incidence
powers[0, 3] = 0.3  # panel 4 reads what it should not

sun = ss.sun_directions(philae, powers, noise=0.05)
for found, delta, why in zip(
    sun.sun_B.values, sun.delta.values, sun.status_text.values, strict=True
):
    print(found.round(3), f"Delta {delta:.3f}", why)

assert np.allclose(
    sun.sun_B.values[1], truth[1], atol=1e-9
)  # undisturbed powers give the direction back
assert np.isnan(sun.sun_B.values[2]).all()  # below the side panels only an arc is known
