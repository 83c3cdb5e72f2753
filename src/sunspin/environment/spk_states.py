"""Script for a separate process: states of a body about the Earth from an SPK, as SPICE may crash on a damaged file.

Arguments: kernel, time step (s), largest number of states. Standard output: TDB seconds past J2000, position (km) and velocity
(km/s) in J2000, as float64.
"""

import sys

import numpy as np

EARTH = 399
"""NAIF number of the Earth."""


def main() -> None:
    """Write the states of the only body in the kernel, one every time step and at the end of each covered interval.

    With no body or several, too many states, or an error of SPICE, the process ends with a message.
    """
    import spiceypy

    kernel, step, max_states = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    rows = []
    try:
        spiceypy.furnsh(kernel)
        bodies = [body for body in spiceypy.spkobj(kernel) if body != EARTH]
        if len(bodies) != 1:
            sys.exit(f"it has {len(bodies)} bodies: {', '.join(map(str, bodies[:5]))}; keep yours")
        window = spiceypy.spkcov(kernel, bodies[0])  # SPICE's set of intervals
        intervals = [spiceypy.wnfetd(window, k) for k in range(spiceypy.wncard(window))]
        if sum(end - begin for begin, end in intervals) / step > max_states:
            sys.exit(f"it covers more than {max_states * step / 86400:.0f} days: cut it")
        for begin, end in intervals:
            for et in np.append(np.arange(begin, end, step), end):
                rows.append([et, *spiceypy.spkgeo(bodies[0], et, "J2000", EARTH)[0]])
    except spiceypy.exceptions.SpiceyError as error:
        sys.exit(f"SPICE says {type(error).__name__}")
    sys.stdout.buffer.write(np.array(rows, dtype=np.float64).tobytes())


if __name__ == "__main__":
    main()
