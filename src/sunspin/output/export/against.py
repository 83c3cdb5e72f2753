"""Comparison of the rates of a results folder with those of SPICE attitude kernels."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import IsolatedRunError, is_nonempty_file, run_isolated
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.output.export import build_attitude, read_attitude_data
from sunspin.output.export.ck import ephemeris_time, import_spice
from sunspin.output.text import number_text

KERNEL_S = 20
"""CPU time (s) that the process that reads the kernels may take."""


def against_kernels(
    folder: Path, kernels: Sequence[Path], frame: str, base: str, epoch: str | None
) -> tuple[dict[str, Any], str]:
    """Return the differences between the rates of a result and those of kernels, as data (deg/s) and as a line of text.

    Compared are the samples of the result whose times the kernels cover.

    Parameters
    ----------
    frame, base : names of the body frame and of an inertial frame in the kernels
    epoch : UTC of time zero, for results without one

    Raises
    ------
    InputError
        The kernels cannot be read, or cover none of the times.
    """
    import_spice()
    attitude = build_attitude(read_attitude_data(folder)[0], None, epoch)
    paths = [str(path) for path in kernels]
    for path in paths:
        if not (path.isprintable() and is_nonempty_file(Path(path))):
            what = "the kernels cannot be used, as there is no such file"
            raise InputError(what, got=path, do="give the paths of SPICE kernels")
        with open(path, "rb") as file:
            if file.read(9).startswith((b"CCSDS_AEM", b"<?xml")):
                what = "an attitude message (AEM) is no SPICE kernel"
                do = "give a CK; `sunspin export --format ck` writes one"
                raise InputError(what, got=path, do=do)
    script, et = Path(__file__).with_name("spice_rates.py"), ephemeris_time(attitude.utc)
    # In another process, because SPICE ends its process on some damaged kernels: 1 of 2,000 in
    # `python -m validation corrupt --unguarded --only kernel.bc`.
    try:
        rate_bytes = run_isolated(
            script, frame, base, *paths, seconds=KERNEL_S, content=et.tobytes()
        )
    except IsolatedRunError as error:
        what = f"the kernels cannot be used ({error})"
        raise InputError(what, got=", ".join(paths)) from None
    rates = np.frombuffer(rate_bytes, dtype=np.float64).reshape(-1, 3)
    if np.any(np.abs(rates) > MAX_RATE):
        what = f"the kernels hold rates beyond {MAX_RATE:g} rad/s"
        raise InputError(what, do="check them: they may be damaged")
    covered = np.isfinite(rates).all(axis=1)
    if not covered.any():
        got = f"{attitude.utc[0]} to {attitude.utc[-1]}"
        raise InputError("the kernels do not cover any of these times", got=got)
    of_result, of_kernels = np.degrees(attitude.omega_B[covered]), np.degrees(rates[covered])
    difference = of_result - of_kernels
    speed_difference = np.linalg.norm(of_result, axis=1) - np.linalg.norm(of_kernels, axis=1)
    summary = {
        "samples": len(rates),
        "covered": int(covered.sum()),
        "rms_deg_s": np.sqrt((difference**2).mean(axis=0)).tolist(),
        "rms_speed_deg_s": float(np.sqrt((speed_difference**2).mean())),
    }
    components, speed = (number_text(summary[name]) for name in ("rms_deg_s", "rms_speed_deg_s"))
    line = (
        f"{summary['covered']} of {len(rates)} times covered; rms difference of the rates {components} deg/s in body axes, "
        f"of their size {speed} deg/s"
    )
    return summary, line
