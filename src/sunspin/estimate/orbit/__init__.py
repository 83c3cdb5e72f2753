"""Whether telemetry was taken in a given orbit, and what along it calibrates the sensors."""
