"""The rates of a results folder compared with those of SPICE attitude kernels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import IsolatedRunError, is_nonempty_file, run_isolated
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.output.export import attitude_of, read_results
from sunspin.output.export.ck import ephemeris_time, spice
from sunspin.output.text import number_text

KERNEL_S = 20
"""CPU time in which rates are read from kernels, in another process: damaged ones end SPICE."""


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
        Kernels that cannot be read, or that cover none of the times.
    """
    spice()
    attitude = attitude_of(read_results(folder)[0], None, epoch)
    paths = [str(path) for path in kernels]
    for path in paths:
        if not (path.isprintable() and is_nonempty_file(Path(path))):
            what = "the kernels cannot be used, as there is no such file"
            raise InputError(what, got=path, do="give the paths of SPICE kernels")
    script, et = Path(__file__).with_name("spice_rates.py"), ephemeris_time(attitude.utc)
    # in another process: of 2,000 damaged kernels 1 ended this one (`validation corrupt --unguarded --only kernel.bc`)
    try:
        read = run_isolated(script, frame, base, *paths, seconds=KERNEL_S, content=et.tobytes())
    except IsolatedRunError as error:
        what = f"the kernels cannot be used ({error})"
        raise InputError(what, got=", ".join(paths)) from None
    rates = np.frombuffer(read, dtype=np.float64).reshape(-1, 3)
    if np.any(np.abs(rates) > MAX_RATE):
        what = f"the kernels hold rates beyond {MAX_RATE:g} rad/s"
        raise InputError(what, do="check them: they may be damaged")
    covered = np.isfinite(rates).all(axis=1)
    if not covered.any():
        got = f"{attitude.utc[0]} to {attitude.utc[-1]}"
        raise InputError("the kernels do not cover any of these times", got=got)
    ours, theirs = np.degrees(attitude.omega_B[covered]), np.degrees(rates[covered])
    speed = np.linalg.norm(ours, axis=1) - np.linalg.norm(theirs, axis=1)
    summary = {
        "samples": len(rates),
        "covered": int(covered.sum()),
        "rms_deg_s": np.sqrt(((ours - theirs) ** 2).mean(axis=0)).tolist(),
        "rms_speed_deg_s": float(np.sqrt((speed**2).mean())),
    }
    shown, size = (number_text(summary[name]) for name in ("rms_deg_s", "rms_speed_deg_s"))
    line = (
        f"{summary['covered']} of {len(rates)} times covered; rms difference of the rates {shown} deg/s in body axes, "
        f"of their size {size} deg/s"
    )
    return summary, line
