"""Names of the frames N, as they stand in ``attrs["frame_N"]`` of every result with an attitude."""

from __future__ import annotations

BODY_AT_START = "body_at_start"
"""The body axes at the first time."""

SUN_Z_LOCAL = "sun_z_local"
"""z to the Sun; the turn about it is arbitrary and another one in each pass."""

FIELD_Z_LOCAL = "field_z_local"
"""z along the magnetic field, whose direction in space is not known and turns; the turn about it is arbitrary."""

J2000 = "J2000"
"""The mean equator and equinox of J2000.0."""
