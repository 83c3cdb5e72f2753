"""What was seen: telemetry, panel powers and the Sun directions that they tell."""
