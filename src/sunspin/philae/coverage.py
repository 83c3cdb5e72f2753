"""Coverage of the paper's method: it is repeated on twins whose truth is known (section 2.3, 3.2; its factor of 1.1)."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import xarray as xr

from sunspin.compute.rows import ensemble
from sunspin.estimate.scan.coverage import QUANTILES, UNITS, Twins, coverage_dataset, from_json
from sunspin.philae.coverage_twins import FACTORS, LEVELS, PRIORS, TwinRows
from sunspin.telemetry.case import Case
from sunspin.vehicle.changes import Change, Changes, changes_of

CONFIDENCE = 0.9

CHUNK = 4
"""Twins between two looks at the clock: a twin takes half a second."""

SHIPPED = "worth.json"
"""The result that comes with the case: 300 twins of each kind on the paper's whole grid, made by the command that it names."""


def compute(
    case: Case,
    n: int = 400,
    *,
    confidence: float = CONFIDENCE,
    seed: int = 0,
    coarser: int = 1,
    factor: float = 1.1,
    workers: int | None = None,
    store: str | Path | None = None,
    progress: bool = False,
    changes: Changes = None,
) -> xr.Dataset:
    """Repeat the method on n twins of each prior.

    Parameters
    ----------
    changes : dict or list of str, optional
        With which the case was loaded.
    confidence : float
        Of the region whose threshold figure and sentences show.
    coarser : int
        Use every n-th point of the paper's grid.
    factor : float
        The method's near-minimum factor (paper, eq. 14: 1.1).
    store : path, optional
        Folder in which finished twins are kept, as in :func:`sunspin.compute.rows.ensemble`; a part of it per prior.
    """
    found, points, asked = {}, 0, changes_of(changes)
    for prior in PRIORS:
        rows = TwinRows(case.name, prior, n, seed, coarser, factor, asked)
        points = len(rows.ground(workers, progress).points)
        kept = None if store is None else Path(store) / prior
        out = ensemble(
            rows,
            workers=workers,
            chunk=CHUNK,
            store=kept,
            progress=progress,
            label=f"twins, {prior}",
        )
        found[prior] = _condensed(out)
    result = coverage_dataset(
        found,
        seed=seed,
        coarser=coarser,
        factor=factor,
        grid_points=points,
        command=_command(n, seed, coarser, factor, asked),
        **({"changes": "\n".join(map(str, case.changes))} if case.changes else {}),
    )
    return _beside_the_paper(result, case, confidence)


def _command(n: int, seed: int, coarser: int, factor: float, changes: tuple[Change, ...]) -> str:
    more = "" if coarser == 1 else f" --coarser {coarser}"
    more += "" if factor == 1.1 else f" --factor {factor:g}"
    more += "".join(f" --set {shlex.quote(str(change))}" for change in changes)
    return f"sunspin coverage --twins {n} --seed {seed}{more}"


def _condensed(out: dict[str, np.ndarray]) -> Twins:
    truth = out["truth_touchdown_speed"]
    tables = []
    for name, at in (("level", LEVELS), ("factor", FACTORS)):
        count, speed = out[f"{name}_count"], out[f"{name}_speed"]
        empty = np.where(
            np.isnan(speed), np.inf, speed
        )  # an empty set bounds nothing: it counts as a bound that fails
        tables.append(
            {
                "at": at,
                "count": np.quantile(count, QUANTILES, axis=0).T,
                "speed": np.quantile(empty, QUANTILES, axis=0, method="higher").T,
                "holds": (empty <= truth[:, None]).sum(axis=0),
            }
        )
    return Twins({name: out[name] for name in UNITS}, *tables)


def _beside_the_paper(found: xr.Dataset, case: Case, confidence: float) -> xr.Dataset:
    """The result with what its figure and sentences compare it with."""
    return found.assign_attrs(
        confidence=confidence,
        published_emd_min=case.published["emd_min"].value,
        published_touchdown_speed_rad_s=case.published["rate_at_touchdown_min"].value,
    )


def shipped(case: Case) -> xr.Dataset | None:
    """The result that comes with the case, if one does."""
    path = case.folder / SHIPPED
    return (
        _beside_the_paper(from_json(path.read_text("utf-8"), str(path)), case, CONFIDENCE)
        if path.is_file()
        else None
    )
