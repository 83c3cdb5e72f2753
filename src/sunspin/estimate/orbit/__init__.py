"""Orbits compared with telemetry, and sensors calibrated along them."""
