"""The rates of a results folder against those of SPICE attitude kernels."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.output.export import attitude_of, read_results
from sunspin.output.export.ck import ephemeris_time, kernel_rates


def against_kernels(
    folder: Path, kernels: Sequence[Path], frame: str, base: str, epoch: str | None
) -> tuple[dict[str, Any], str]:
    """Differences of the rates in body axes as data (deg/s) and in a line.

    Parameters
    ----------
    frame, base : the body's frame and an inertial one, as the kernels name them
    epoch : UTC of time zero where the results have none

    Raises
    ------
    InputError
        The kernels cover none of the times.
    """
    data, _ = read_results(folder)
    attitude = attitude_of(data, None, epoch)
    et = np.array(
        [ephemeris_time(attitude.epoch + timedelta(seconds=float(t))) for t in attitude.t_s]
    )
    theirs = kernel_rates([str(path) for path in kernels], frame, base, et)
    covered = np.isfinite(theirs).all(axis=1)
    if not covered.any():
        raise InputError(
            sentence(
                "the kernels do not cover any of these times",
                got=f"{attitude.utc(0)} to {attitude.utc(-1)}",
            )
        )
    difference = np.degrees(attitude.omega_B[covered] - theirs[covered])
    speed = np.degrees(
        np.linalg.norm(attitude.omega_B[covered], axis=1) - np.linalg.norm(theirs[covered], axis=1)
    )
    summary = {
        "samples": len(et),
        "covered": int(covered.sum()),
        "rms_deg_s": np.sqrt((difference**2).mean(axis=0)).tolist(),
        "rms_speed_deg_s": float(np.sqrt((speed**2).mean())),
    }
    shown = ", ".join(f"{value:.4g}" for value in summary["rms_deg_s"])
    line = (
        f"{summary['covered']} of {len(et)} times covered; rms difference of the rates ({shown}) deg/s in body axes, "
        f"of their size {summary['rms_speed_deg_s']:.4g} deg/s"
    )
    return summary, line
