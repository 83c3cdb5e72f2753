"""Script for another process: read states of the first segment of an SPK, as a damaged file may crash the C library.

Argument: kernel. Standard input: TDB seconds past J2000 (float64). Standard output: position (km) and velocity (km/s) of each time,
in the axes of the segment and relative to its centre, so that no frame kernel is needed.
"""

import sys

import numpy as np


def main() -> None:
    """Write the states of the kernel in `sys.argv` to standard output, or exit with the reason why not."""
    import spiceypy

    times = np.frombuffer(sys.stdin.buffer.read(), dtype=np.float64)
    try:
        handle = spiceypy.spklef(sys.argv[1])
        spiceypy.dafbfs(handle)
        if not spiceypy.daffna():
            sys.exit("it has no segments")
        summary = spiceypy.dafgs(5)
        states = np.array([spiceypy.spkpvn(handle, summary, t)[1] for t in times], dtype=np.float64)
    except spiceypy.exceptions.SpiceyError as error:
        sys.exit(f"SPICE says {type(error).__name__}")
    sys.stdout.buffer.write(states.tobytes())


if __name__ == "__main__":
    main()
