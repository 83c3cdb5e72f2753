"""Sensors of a vehicle calibrated by its own telemetry."""
