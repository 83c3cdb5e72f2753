"""Run as a script in another process: states of an SPK's first segment, which the C library may not survive if damaged.

Argument: kernel. Standard input: TDB seconds past J2000. Standard output: position (km) and velocity (km/s) in the segment's own
axes about its own centre, so that no frame kernel is needed.
"""

import sys

import numpy as np


def main() -> None:
    import spiceypy as sp

    times = np.frombuffer(sys.stdin.buffer.read(), dtype=np.float64)
    try:
        handle = sp.spklef(sys.argv[1])
        sp.dafbfs(handle)
        if not sp.daffna():
            sys.exit("it has no segments")
        summary = sp.dafgs(5)
        states = np.array([sp.spkpvn(handle, summary, t)[1] for t in times], dtype=np.float64)
    except sp.exceptions.SpiceyError as error:
        sys.exit(f"SPICE says {type(error).__name__}")
    sys.stdout.buffer.write(states.tobytes())


if __name__ == "__main__":
    main()
