"""The paper, row by row: its chain from telemetry to conclusions, its figures, its page."""
