"""Where what was seen meets what would be seen: scans, rates, posteriors."""
