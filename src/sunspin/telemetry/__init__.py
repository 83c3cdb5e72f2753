"""Telemetry files: reading, quality of the readings, and Sun directions from the power of the panels."""
