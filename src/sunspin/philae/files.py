"""The results of the Philae study as files: all that its report is made from, and what a reader may want to compute with."""

from __future__ import annotations

from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.provenance import version
from sunspin.philae import rebound as rb
from sunspin.philae.study import Reproduction


def datasets(result: Reproduction) -> dict[str, xr.Dataset]:
    """File name -> data of every part that was computed."""
    parts = result.parts
    tables = [("sun", result.sun), *_scans(result), *_touchdown(result)]
    if "sensitivity" in parts:
        tables += [
            ("map_rates", parts["sensitivity"].rates.to_dataset()),
            ("map_parameters", _parameters(parts["sensitivity"])),
        ]
    if "collision" in parts:
        tables += [
            (f"outcomes-{name}", runs) for name, runs in parts["collision"].runs["chosen"].items()
        ]
    if "strategies" in parts:
        tables.append(("strategies", parts["strategies"].table))
    if "motions" in parts:
        tables += [
            (f"motion-{_file(name)}", run.assign_attrs(title=name))
            for name, run in parts["motions"].candidates.items()
        ]
        tables.append(("speed", parts["motions"].speed))
    attrs = {"synthetic": int(result.synthetic), "seed": result.seed, "sunspin_version": version()}
    return {name: data.assign_attrs(attrs) for name, data in tables}


def _file(name: str) -> str:
    return name.lower().replace(" ", "-")


def _scans(result: Reproduction) -> list[tuple[str, xr.Dataset]]:
    """The scan of the telemetry, and that of the printed lines' distribution."""
    found, lines = [], rb.published_lines(result.case)
    families = [
        (
            "scan_published_lines",
            result.parts["published_lines"].clean,
            "against the common distribution of the printed lines",
        )
    ]
    scan = result.parts.get("level_set")
    if scan is not None:
        families.insert(
            0, ("scan_telemetry", scan.near, "against the directions of this telemetry")
        )
    for name, family, about in families:
        data = family.emd.to_dataset()
        if family.lines is not None:
            data = data.merge(family.lines.rename({"axis": "line_axis", "n": "near_point"}))
        data["near_minimum"] = (
            ("near_point", "rate_axis"),
            family.points,
            {"units": "rad s-1", "factor": family.factor},
        )
        data["published_point"] = (
            ("published_line", "rate_axis"),
            np.array([p for p, _ in lines]),
            {"units": "rad s-1"},
        )
        data["published_direction"] = (
            ("published_line", "rate_axis"),
            np.array([d for _, d in lines]),
            {"units": "1"},
        )
        if name == "scan_telemetry" and scan is not None and scan.truth:
            data["truth"] = ("rate_axis", scan.truth["omega_B"], {"units": "rad s-1"})
        found.append((name, data.assign_attrs(kind="scan", about=about)))
    return found


MOST_CANDIDATES = 20_000
"""Candidates that are written: an even draw where there are more."""


def _touchdown(result: Reproduction) -> list[tuple[str, xr.Dataset]]:
    """Rates at the touchdown of the printed lines' set; the candidates with their speeds and angles."""
    lines = result.parts["published_lines"]
    data = {
        "omega_B": (("point", "axis"), lines.near_touchdown, {"units": "rad s-1"}),
        "published_B": (("published", "axis"), lines.on_lines_touchdown, {"units": "rad s-1"}),
    }
    found = [("touchdown", xr.Dataset(data, coords={"axis": ["x", "y", "z"]}))]
    if result.chain is None:
        return found
    chosen = result.chain.chosen
    every = -(-len(chosen) // MOST_CANDIDATES)
    table = chosen.dataset().assign(
        speed_touchdown=(
            "candidate",
            chosen.speed_touchdown,
            {"units": "rad s-1", "long_name": "just after the first touchdown"},
        ),
        theta=(
            "candidate",
            chosen.theta,
            {"units": "rad", "long_name": "angle from the momentum to the z axis"},
        ),
        alpha=(
            "candidate",
            chosen.alpha,
            {"units": "rad", "long_name": "angle from the momentum to the Sun"},
        ),
    )
    return [*found, ("candidates", table.isel(candidate=slice(None, None, every)))]


def _parameters(part: Any) -> xr.Dataset:
    data = part.parameters.to_dataset()
    data["mu_0"].attrs["units"] = "N m"
    data["theta_xx"].attrs["units"] = "kg m2"
    return data
