"""Mathematics only: least squares for many problems at once, rotations. Knows nothing of spacecraft."""
