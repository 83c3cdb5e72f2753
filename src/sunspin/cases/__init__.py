"""Built-in cases: vehicle, timeline, telemetry and published figures, as data."""
