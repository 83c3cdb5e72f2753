"""The motions from which `sunspin outcomes` starts, and what a case's trajectory kernel says of its collisions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate.scan.chosen import stored_near_minimum, stored_vehicle
from sunspin.philae.collision import KERNEL, condition, kernel_facts
from sunspin.philae.rebound import moves_and_sees_alike, published_candidates
from sunspin.telemetry.case import case_names, load_case
from sunspin.vehicle import Vehicle


def starts(
    craft: Vehicle, omega: list[list[float]], scan: Path | None, factor: float
) -> tuple[np.ndarray, str]:
    """Candidate rates (m, 3) in rad/s, and in words where they come from and whose they are.

    They are `omega` where any are given, else the near-minimum set of a stored scan, else the case's printed lines, which are
    those of the case's own body: for another they are refused.
    """
    if scan is not None and omega:
        raise InputError("candidates come from --scan or from --omega-deg-s", do="give one of them")
    if omega:
        return np.array(omega), "as given"
    if scan is not None:
        of, mine = stored_vehicle(scan), craft.said
        other = (
            ""
            if of == mine
            else f"; of another body than this run's: {_told(of)}, here {_told(mine)}"
        )
        return stored_near_minimum(scan, factor), f"the near-minimum set of {scan.name}{other}"
    return _printed(craft)


def _told(said: dict[str, str]) -> str:
    return ", ".join(
        [
            said.get("vehicle", "a vehicle without a name"),
            *said.get("changes", "as in its file").splitlines(),
        ]
    )


def _printed(craft: Vehicle) -> tuple[np.ndarray, str]:
    """The lines that the paper prints, of the case's own body."""
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is None or "line_L1" not in case.published:
        do = "give --omega-deg-s x,y,z or --scan scan.nc"
        raise InputError("no candidate motions are given", do=do)
    if not moves_and_sees_alike(craft, case.vehicle):
        raise InputError(
            "the printed lines were found for another body, wheel or panels than these",
            got=_told(craft.said),
            do="scan these with the same --set and give --scan scan.nc, or give --omega-deg-s",
        )
    return published_candidates(case), "the lines that the paper prints"


def against_kernel(case_name: str, runs: xr.Dataset, data: Path | None) -> xr.Dataset:
    """The simulated collisions `runs` against the kernel in the folder `data`, or against the facts that come with the case.

    Raises
    ------
    InputError
        No such kernel is known for the case, or the runs have no collision.
    """
    case = load_case(case_name) if case_name in case_names() else None
    if (
        case is None
        or "kernel_speed_before" not in case.published
        or not np.isfinite(runs["speed_after"]).any()
    ):
        raise InputError(
            "--condition needs collisions of a case with a trajectory kernel",
            do="use it with philae",
        )
    there = data if data is not None and data.joinpath(*KERNEL).is_file() else None
    return condition(case, runs, None if there is None else kernel_facts(case, there))
