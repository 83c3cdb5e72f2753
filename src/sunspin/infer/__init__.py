"""Where what was seen meets what would be seen: metrics, scans, fits."""
