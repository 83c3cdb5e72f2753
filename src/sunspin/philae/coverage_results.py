"""`ss.coverage`: the paper's method on twins of known truth, and its results folder."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import xarray as xr

import sunspin.output.result  # noqa: F401  (results answer to `.sunspin` from here on)
from sunspin.estimate.scan.coverage import check_confidence
from sunspin.output.folder import results_folder
from sunspin.output.report import write_report
from sunspin.philae import coverage as study
from sunspin.philae import coverage_rows
from sunspin.telemetry.case import load_case
from sunspin.vehicle.assumptions import split
from sunspin.vehicle.changes import Changes
from sunspin.vehicle.file import changed_file

NAMES = (
    "version",
    "title",
    "command",
    "seed",
    "confidence",
    "seconds",
    "sentences",
    "changes",
    "figures",
    "folder",
    "synthetic_telemetry",
)
"""What a coverage answers to beside its variables."""


class Coverage(xr.Dataset):
    """A Dataset of kind "coverage" that also answers to the names of its summary: ``figures``, ``sentences``, ``seconds``,
    ``folder`` and others, as plain Python objects. Read back from a file it is a Dataset without these: ask its summary."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:
        return (
            self.said()[key] if isinstance(key, str) and key in NAMES else super().__getitem__(key)
        )

    def said(self) -> dict[str, Any]:
        """The summary with the time that it took, the version and the folder, as plain data."""
        about = {
            "version": self.attrs["sunspin_version"],
            "command": self.attrs["command"],
            "seconds": self.attrs["seconds"],
        }
        changes = str(self.attrs.get("changes", "")).splitlines()
        return (
            about
            | self.sunspin.summary()
            | {"changes": changes, "folder": self.attrs.get("folder")}
        )


def coverage(
    out: str | Path | None = None,
    twins: int = 400,
    *,
    case: str = "philae",
    confidence: float = study.CONFIDENCE,
    changes: Changes = None,
    **options: Any,
) -> Coverage:
    """Coverage of the paper's method: how often what it concludes holds the truth.

    With `out`, `coverage.nc`, `worth.json`, a figure and `report.html` are written there.

    Parameters
    ----------
    out : path, optional
        Results folder.
    case : str
        Name of a built-in case.
    twins : int
        Synthetic rebounds of each kind: truth on the published lines, truth anywhere in the scanned box.
    confidence : float
        Of the region whose threshold is looked for, in (0, 1).
    changes : dict or list of str, optional
        Values of the vehicle or the assumptions to change, as in :func:`sunspin.load_case`.
    options
        seed, coarser, factor, workers, store, progress: see :func:`sunspin.philae.coverage.compute`.

    Returns
    -------
    xarray.Dataset
        Over `prior` (where truths were drawn) and `twin`: `emd_min` of the scan, `emd_truth`, `truth_touchdown_speed`,
        `bound_set` and `bound_lines` (rad/s), `line_angle` (rad) and `line_distance` (rad/s) of the four fitted `line`s, ...;
        over thresholds on EMD, `level`, and on its ratio to the smallest, `factor`: quantiles of the size of the set
        (`level_count`) and of its smallest speed (`level_speed`, rad/s), and how many true speeds it bounds (`level_holds`).
        As returned it also has ``["figures"]`` (rows as in the summary of `reproduce`), ``["sentences"]``, ``["seconds"]`` and
        ``["folder"]``.
    """
    began = time.perf_counter()
    known = load_case(case, changes)
    folder = (
        None if out is None else results_folder(out, "worth")
    )  # refused before the work, not after it
    check_confidence(twins, confidence)
    found = study.compute(known, twins, confidence=confidence, changes=changes, **options)
    figures = json.dumps([asdict(row) for row in coverage_rows.rows(known, found)])
    seconds = round(time.perf_counter() - began, 1)
    found = Coverage(
        found.data_vars, found.coords, found.attrs | {"figures": figures, "seconds": seconds}
    )
    if folder is None:
        return found
    more = {"seconds": seconds, "changes": found["changes"]}
    found.sunspin.save(
        folder,
        vehicle=changed_file(case, split(changes)[0]),
        command=found.attrs["command"],
        also=more,
    )
    write_report(folder, ours=True)
    return found.assign_attrs(folder=str(folder))


worth = coverage
"""The earlier name of `coverage`."""
