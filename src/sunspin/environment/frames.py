"""Names of the frames N, the values of ``attrs["frame_N"]`` in results with an attitude."""

from __future__ import annotations

BODY_AT_START = "body_at_start"
"""The body axes at the first time."""

SUN_Z_LOCAL = "sun_z_local"
"""z points to the Sun; the rotation about it is arbitrary and differs between passes."""

FIELD_Z_LOCAL = "field_z_local"
"""z is along the magnetic field, whose direction in space is unknown and changes; the rotation about it is arbitrary."""

J2000 = "J2000"
"""The mean equator and equinox of J2000.0."""
