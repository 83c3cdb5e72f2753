"""Run as a script in another process: rates of a frame from SPICE kernels, which the C library may not survive if damaged.

Arguments: frame, base, kernels. Standard input: ephemeris times, 8 bytes each; standard output: rates (n, 3) in rad/s in the
axes of the frame, NaN where no kernel covers.
"""

import sys
from typing import Any

import numpy as np


def main() -> None:
    import spiceypy as sp

    frame, base, *kernels = sys.argv[1:]
    sp.furnsh(kernels)
    times = np.frombuffer(sys.stdin.buffer.read(), dtype=np.float64)
    rates = [rate(sp, frame, base, float(t)) for t in times]
    sys.stdout.buffer.write(np.array(rates, dtype=np.float64).tobytes())


def rate(sp: Any, frame: str, base: str, et: float) -> np.ndarray:
    try:
        transform = sp.sxform(base, frame, et)
    except sp.exceptions.SpiceNOFRAMECONNECT:
        return np.full(3, np.nan)
    rotation, omega_base = sp.xf2rav(transform)
    with np.errstate(all="ignore"):
        return rotation @ omega_base


if __name__ == "__main__":
    main()
