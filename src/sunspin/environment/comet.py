"""The axes of comet 67P in space: where its pole and its prime meridian point, and velocities over its surface in J2000.

Archinal et al., "Report of the IAU Working Group on Cartographic Coordinates and Rotational Elements: 2015", Celest. Mech. Dyn.
Astr. 130, 22 (2018), Table 3: of March to September 2014. Later poles, such as RA 69.6, Dec 64.0 degrees, differ by 0.1 degree.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

POLE_DEG = (69.54, 64.11)
"""Right ascension and declination, J2000."""

MERIDIAN_DEG, DEG_PER_DAY = 114.69, 696.543884683
"""The prime meridian's angle at J2000 from the node of the comet's equator, and how fast it grows."""

SPIN_COMET = np.array([0.0, 0.0, np.radians(DEG_PER_DAY) / 86400.0])
"""rad/s, in comet axes."""

AXES_SIGMA_RAD = float(np.radians(2.0))
"""One sigma of directions in November 2014: the constants end in September, published spins differ by 0.01 degrees a day, and the
landing kernel's axes may be those of a shape model that is a degree off."""


def comet_from_J2000(tdb_s: float) -> np.ndarray:
    """Matrix (3, 3) from components in J2000 to those in comet axes, at TDB seconds past J2000; z is the pole, x the meridian."""
    right_ascension, declination = POLE_DEG
    meridian = (MERIDIAN_DEG + DEG_PER_DAY * tdb_s / 86400.0) % 360.0
    turns = Rotation.from_euler(
        "ZXZ", [90.0 + right_ascension, 90.0 - declination, meridian], degrees=True
    )
    return turns.as_matrix().T


def velocity_J2000(tdb_s: float, state: np.ndarray) -> np.ndarray:
    """Velocity (3) m/s in J2000 of a position and velocity (6), m and m/s, over the turning comet: v + w x r."""
    return comet_from_J2000(tdb_s).T @ (state[3:] + np.cross(SPIN_COMET, state[:3]))
