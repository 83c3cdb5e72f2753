"""Compile the integrators once for this processor: ``python -m sunspin.dynamics``."""

from __future__ import annotations

import numpy as np

from sunspin.dynamics import batch, step
from sunspin.vehicle import Vehicle


def main() -> None:
    """Compute one motion, one histogram and one step of `rates`, so that everything is compiled and stored on disk."""
    body = Vehicle("body", np.diag([1.0, 1.2, 0.8]))
    start = batch.Rows(np.full((1, 3), 0.1), np.array([[0.0, 0.0, 1.0]]), np.zeros((1, 0)))
    batch.run(body, start, 1.0)
    batch.sun_heights(body, start, 1.0)
    step.load()


if __name__ == "__main__":
    main()
