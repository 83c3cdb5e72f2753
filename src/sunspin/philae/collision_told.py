"""Collisions of `sunspin outcomes --condition` weighted by the trajectory kernel."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, sentence
from sunspin.philae.collision import KERNEL, condition, kernel_facts
from sunspin.telemetry.case import case_names, load_case


def against_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> xr.Dataset:
    """The simulated collisions `runs` against the kernel in the folder `data`, or against the facts that come with the case.

    Raises
    ------
    InputError
        No such kernel is known for the case, or the runs have no collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    if case is None or "kernel_speed_before" not in case.published or not np.isfinite(runs["speed_after"]).any():
        raise InputError(sentence("--condition needs collisions of a case with a trajectory kernel", do="use it with philae"))
    there = data if data is not None and data.joinpath(*KERNEL).is_file() else None
    return condition(case, runs, None if there is None else kernel_facts(case, there))
