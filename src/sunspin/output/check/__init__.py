"""The checks of `sunspin check` in words: vehicle file, telemetry, repeated samples, orbit. Each returns `Findings`."""
