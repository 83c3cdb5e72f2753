"""The chain of the Philae study on the printed lines, with small sets beside them."""

from __future__ import annotations

import numpy as np

from sunspin.cases import Case
from sunspin.philae import candidates
from sunspin.philae import rebound as rb
from sunspin.telemetry.sun import sun_directions


def chain_on_the_lines(case: Case) -> candidates.Chain:
    """The printed lines as candidates, a coarse grid as the box and some of it as the paper's own set."""
    rebound = rb.make_rebound(case, sun_directions(case.vehicle, case.telemetry))
    grid = np.stack(np.meshgrid(*rb.scan_grid(case, 15).values(), indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    lines = rb.published_candidates(case)
    sets = {
        "set": ("published", lines),
        "scan_range": ("scan", grid),
        "near_minimum": ("scan", lines[::7]),
    }
    chosen, scan_range, near_minimum = (
        candidates.make_candidates(
            rebound, rebound.states(points), 0, chain=chain, about=f"{name} of the test"
        )
        for name, (chain, points) in sets.items()
    )
    return candidates.Chain(case, rebound, chosen, scan_range, near_minimum, None, float("nan"))
