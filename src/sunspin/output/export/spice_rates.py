"""Script that reads rates from SPICE kernels. It runs in a process of its own, which a damaged kernel may end.

Arguments: frame, base, kernels. Standard input: ephemeris times as float64. Standard output: rates (n, 3) of the frame relative to
the base, rad/s in the axes of the frame, as float64; NaN at times that no kernel covers.
"""

import sys

import numpy as np


def main() -> None:
    """Read times from standard input, and write the rates to standard output."""
    import spiceypy

    frame, base, *kernels = sys.argv[1:]
    spiceypy.furnsh(kernels)
    rates = []
    for et in np.frombuffer(sys.stdin.buffer.read(), dtype=np.float64).tolist():
        try:
            rotation, omega_base = spiceypy.xf2rav(spiceypy.sxform(base, frame, et))
            with np.errstate(all="ignore"):
                rates.append(rotation @ omega_base)
        except spiceypy.exceptions.SpiceNOFRAMECONNECT:
            rates.append(np.full(3, np.nan))
    sys.stdout.buffer.write(np.array(rates, dtype=np.float64).tobytes())


if __name__ == "__main__":
    main()
