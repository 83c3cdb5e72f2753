"""Run as a script in another process: states of an SPK's body about the Earth, which the C library may not survive if damaged.

Arguments: kernel, step (s), most states. Standard output: TDB seconds past J2000, position (km) and velocity (km/s) in J2000.
"""

import sys

import numpy as np

EARTH = 399


def main() -> None:
    import spiceypy as sp

    kernel, step, most = sys.argv[1], float(sys.argv[2]), int(sys.argv[3])
    rows = []
    try:
        sp.furnsh(kernel)
        bodies = [body for body in sp.spkobj(kernel) if body != EARTH]
        if len(bodies) != 1:
            sys.exit(f"it has {len(bodies)} bodies: {', '.join(map(str, bodies[:5]))}; keep yours")
        window = sp.spkcov(kernel, bodies[0])
        spans = [sp.wnfetd(window, k) for k in range(sp.wncard(window))]
        if sum(end - begin for begin, end in spans) / step > most:
            sys.exit(f"it covers more than {most * step / 86400:.0f} days: cut it")
        for begin, end in spans:
            for et in np.append(np.arange(begin, end, step), end):
                rows.append([et, *sp.spkgeo(bodies[0], et, "J2000", EARTH)[0]])
    except sp.exceptions.SpiceyError as error:
        sys.exit(f"SPICE says {type(error).__name__}")
    sys.stdout.buffer.write(np.array(rows, dtype=np.float64).tobytes())


if __name__ == "__main__":
    main()
