"""Mathematics without spacecraft: rotations, and least squares for many problems at once."""
