"""Comparison of a results folder with SPICE attitude kernels, or with an attitude ephemeris message."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.base.untrusted import IsolatedRunError, is_nonempty_file, run_isolated
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.output.export import AttitudeHistory, build_attitude, read_attitude_data
from sunspin.output.export.attitude_message import is_message, read_message
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
        if is_message(Path(path)):
            what, do = (
                "an attitude message (AEM) is no SPICE kernel",
                "give it alone, without --frame",
            )
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
    return describe_rates(attitude, rates, "kernels")


def against_message(
    folder: Path, path: Path, epoch: str | None = None
) -> tuple[dict[str, Any], str]:
    """Return the differences between a result and an attitude ephemeris message (AEM), as data and as a line of text.

    They are those of :func:`against_kernels`, and of the attitudes too if both have the same frame in space. `epoch`: UTC of time
    zero, for results without one.
    """
    attitude = build_attitude(read_attitude_data(folder)[0], None, epoch)
    rates, angles = np.full((len(attitude.t_s), 3), np.nan), np.full(len(attitude.t_s), np.nan)
    of_result = Rotation.from_quat(attitude.quaternion)
    for segment in read_message(path):
        B_from_N, segment_rates = segment.at(attitude.utc)
        shown = np.isfinite(segment_rates).all(axis=1)
        rates[shown] = segment_rates[shown]
        if segment.frame == attitude.frame and shown.any():
            of_message = Rotation.from_quat(B_from_N[shown])
            angles[shown] = (of_result[shown] * of_message.inv()).magnitude()
    summary, line = describe_rates(attitude, rates, "attitudes of the message")
    compared = angles[np.isfinite(angles)]
    if not len(compared):
        return summary, f"{line}; attitudes not compared, as their frames differ"
    rms, largest = np.degrees([np.sqrt((compared**2).mean()), compared.max()]).tolist()
    summary |= {"rms_attitude_deg": rms, "largest_attitude_deg": largest}
    return (
        summary,
        f"{line}; of the attitudes {number_text(rms)} deg, at most {number_text(largest)}",
    )


def describe_rates(
    attitude: AttitudeHistory, rates: np.ndarray, of: str
) -> tuple[dict[str, Any], str]:
    """Return the differences between the rates of a result and others (n, 3), rad/s, as data (deg/s) and as a line of text.

    `rates` are NaN at instants that are not covered; `of` names their source in the error if none is.
    """
    covered = np.isfinite(rates).all(axis=1)
    if not covered.any():
        got = f"{attitude.utc[0]} to {attitude.utc[-1]}"
        raise InputError(f"the {of} cover none of these times", got=got)
    of_result, others = np.degrees(attitude.omega_B[covered]), np.degrees(rates[covered])
    difference = of_result - others
    speed_difference = np.linalg.norm(of_result, axis=1) - np.linalg.norm(others, axis=1)
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
