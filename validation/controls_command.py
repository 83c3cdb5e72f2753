"""``python -m validation controls``."""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
import xarray as xr

from sunspin.philae import touchdown
from sunspin.philae.twin_philae import philae_twin
from sunspin.telemetry.case import load_case
from validation.controls import CONTROLS, chain_of


def options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--coarser", type=int, default=1, help="every n-th grid point of the scan")
    parser.add_argument(
        "--seeds",
        type=int,
        default=0,
        help="right files made with this many seeds instead of the controls",
    )
    parser.add_argument(
        "--twins", type=int, default=60, help="synthetic flights of each calibration"
    )


def run(options: Any) -> int:
    """Print what each file leaves; one if a right file is accused or a wrong one is not."""
    case, wrong = load_case("philae"), 0
    named = [(name, make(case)) for name, make in CONTROLS.items()]
    if options.seeds:
        named = [(f"seed {seed}", philae_twin(seed)) for seed in range(options.seeds)]
    for name, telemetry in named:
        told, concluded = _look(telemetry, options)
        print(f"{name}: {told}", flush=True)
        wrong += concluded is (name in NOT_CONCLUDED)
    return 1 if wrong else 0


NOT_CONCLUDED = ("each panel shuffled", "panels 1 and 2 exchanged")
"""Controls from whose readings nothing may be concluded."""


def _look(telemetry: xr.Dataset, options: Any) -> tuple[str, bool]:
    found = chain_of(telemetry, coarser=options.coarser, twins=options.twins)
    looked, scan, chain = found.carries, found.scan, found.chain
    head = f"Delta {looked.delta:.4f}, {looked.impossible} forbidden patterns of {looked.early}, "
    head += f"descent {'ordered' if looked.descent_order else 'without order'}"
    if scan is None or chain is None:
        return f"{head}; nothing concluded: {found.why}", False
    chosen = chain.chosen
    small, large = (
        np.degrees(chosen.angle_range(values))
        for values in (chosen.smaller_angle, chosen.larger_angle)
    )
    assert chain.calibration is not None
    return (
        f"{head}; smallest EMD {chain.emd_min:.4f} (as large in {chain.calibration.share_as_large(chain.emd_min):.0%}), set below "
        f"{chain.calibration.factor()[0]:.2f} times it, {chain.share:.0%} of the box; smaller angle {small[0]:.0f} to "
        f"{small[1]:.0f} deg, larger {large[0]:.0f} to {large[1]:.0f}; speed at least {touchdown.lower_bound(chain):.3f} "
        f"rad/s; {scan.lines_found} lines; {len(chain.recipe)} motions by the paper's recipe"
    ), True
