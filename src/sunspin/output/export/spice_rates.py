"""Run as a script in another process: rates of a frame from SPICE kernels, which the C library may not survive if damaged.

Arguments: frame, base, kernels. Standard input: ephemeris times, 8 bytes each; standard output: rates (n, 3) in rad/s in the
axes of the frame, NaN where no kernel covers.
"""

import sys

import numpy as np


def main() -> None:
    import spiceypy as sp

    frame, base, *kernels = sys.argv[1:]
    sp.furnsh(kernels)
    rates = []
    for et in np.frombuffer(sys.stdin.buffer.read(), dtype=np.float64).tolist():
        try:
            rotation, omega_base = sp.xf2rav(sp.sxform(base, frame, et))
            with np.errstate(all="ignore"):
                rates.append(rotation @ omega_base)
        except sp.exceptions.SpiceNOFRAMECONNECT:
            rates.append(np.full(3, np.nan))
    sys.stdout.buffer.write(np.array(rates, dtype=np.float64).tobytes())


if __name__ == "__main__":
    main()
