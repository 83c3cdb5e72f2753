"""`sunspin coverage`: the paper's method on twins of known truth, into a results folder."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

from sunspin.base.provenance import version
from sunspin.output import figures as fig
from sunspin.output.folder import Picture, results_folder, write_json, write_run
from sunspin.output.report import write_report
from sunspin.philae import coverage as study
from sunspin.philae import coverage_told
from sunspin.philae.pictures import worth_sheet
from sunspin.telemetry.case import load_case
from sunspin.vehicle.assumptions import split
from sunspin.vehicle.changes import Changes
from sunspin.vehicle.file import changed_file


def coverage(
    out: str | Path | None = None,
    twins: int = 400,
    *,
    case: str = "philae",
    confidence: float = study.CONFIDENCE,
    changes: Changes = None,
    **options: Any,
) -> dict[str, Any]:
    """Coverage of the paper's method: how often what it concludes holds the truth.

    With `out`, `worth.json`, a figure and `report.html` are written there.

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
    dict
        `figures`: rows as in the summary of `reproduce`, each with its unit (thresholds on EMD in [0, 1], rates in rad/s);
        `sentences`; `seconds`; `folder`.
    """
    began = time.perf_counter()
    known = load_case(case, changes)
    folder = None if out is None else results_folder(out, "worth")  # refused before the work, not after it
    study.check_confidence(twins, confidence)
    found = study.compute(known, twins, changes=changes, **options)
    rows, told = coverage_told.rows(known, found, confidence), coverage_told.sentences(found, confidence)
    summary = {
        "version": version(), "synthetic_telemetry": True, "title": "What the answer is worth",
        "command": found.command, "seed": found.seed,
        "confidence": confidence, "seconds": round(time.perf_counter() - began, 1), "sentences": told,
        "changes": [str(one) for one in known.changes],
        "figures": [asdict(row) for row in rows],
    }  # fmt: skip
    if folder is not None:
        write_json(folder / "worth.json", study.to_json(found))
        sheet = worth_sheet(found, known.published, confidence)
        picture = Picture(fig.save(sheet.make(), folder, sheet.name)[0], sheet.alt, sheet.caption)
        write_run(folder, summary, changed_file(case, split(changes)[0]), None, [picture])
        write_report(folder, ours=True)
    return summary | {"folder": None if folder is None else str(folder)}


worth = coverage
"""The earlier name of `coverage`."""
