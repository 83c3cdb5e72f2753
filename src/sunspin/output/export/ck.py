"""SPICE C-kernel, with the clock kernel and the frame kernel that it needs.

The clock kernel defines ticks of one microsecond from a second before the epoch of the result. The frame kernel names the body
frame, whose orientation the C-kernel gives, and the local frame N. N is not related to any other frame, so SPICE refuses to convert
from it to J2000.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError, OutputError
from sunspin.environment.earth import TT_AHEAD_OF_TAI_S
from sunspin.output.export import AttitudeHistory
from sunspin.output.folder import write_whole

SPACECRAFT = -999_001
"""Id of the spacecraft in the kernels written here, far from those that NAIF has assigned."""

BODY_ID, LOCAL_ID = SPACECRAFT * 1000, SPACECRAFT * 1000 - 1
BODY_NAME = "SUNSPIN_BODY"
TICKS_PER_S = 1_000_000


def ephemeris_time(utc: Any) -> np.ndarray:
    """Return SPICE's ephemeris time (TDB seconds past J2000) of UTC instants, with an error below 0.05 ms.

    TDB - TT is the formula of NAIF's leap-seconds kernel: 1.657 ms times the sine of the Earth's eccentric anomaly.
    """
    import erfa

    utc = np.asarray(utc, dtype="datetime64[us]")
    if np.any(utc < np.datetime64("1972-01-01")):
        raise InputError("UTC before 1972 has no leap seconds", got=str(utc.min()))
    month = utc.astype("datetime64[M]").astype(int)  # since 1970; leap seconds begin with a month
    with warnings.catch_warnings():  # years beyond the announced leap seconds
        warnings.simplefilter("ignore", erfa.ErfaWarning)
        tai_ahead = erfa.dat(1970 + month // 12, month % 12 + 1, 1, 0.0)
    utc_s = (utc - np.datetime64("2000-01-01T12:00")) / np.timedelta64(1, "s")
    tt_s = utc_s + tai_ahead + TT_AHEAD_OF_TAI_S  # past J2000
    # constants of the kernel: DELTET/M (mean anomaly), DELTET/K and DELTET/EB
    mean_anomaly = 6.239996 + 1.99096871e-7 * tt_s
    return tt_s + 1.657e-3 * np.sin(mean_anomaly + 1.671e-2 * np.sin(mean_anomaly))


def import_spice() -> Any:
    """Return the module spiceypy; raise `OutputError` with how to install it if it is missing."""
    try:
        import spiceypy
    except ImportError:
        what, do = "SPICE kernels need spiceypy", 'pip install "sunspin[spice]"'
        raise OutputError(what, do=do) from None
    return spiceypy


def write_ck(folder: Path, attitude: AttitudeHistory) -> list[Path]:
    """Write the C-kernel sunspin.bc (type 3, with rates), its clock sunspin.tsc and frames sunspin.tf, and return their paths.

    Each pass is an interpolation interval. Between two records SPICE interpolates along the shorter rotation, so `attitude` must be
    dense: from :func:`sunspin.output.export.build_attitude` with `dense`.
    """
    from scipy.spatial.transform import Rotation

    spiceypy = import_spice()
    if not str(folder).isprintable():
        what, do = "SPICE takes no such folder name", "give one of plain letters"
        raise OutputError(what, got=str(folder), do=do)
    # Tick 0: a second before the epoch or an earlier first sample, whose time SPICE may round down. Ticks count TDB: in weeks it
    # gains or loses milliseconds on seconds of UTC, and a second at a leap second.
    et = ephemeris_time(attitude.utc)
    start = min(float(ephemeris_time(attitude.epoch)), float(et[0])) - 1.0
    ticks = np.round((et - start) * TICKS_PER_S)
    if np.any(np.diff(ticks) <= 0):
        raise InputError("a C-kernel needs times that increase by a microsecond or more")
    clock, frames = (
        write_whole(folder / name, text.encode("ascii"))
        for name, text in _text_kernels(start, attitude.frame).items()
    )
    # SPICE: scalar first, and the matrix of its quaternion takes components in N to B, as B_from_N does
    # A pass begins a tick early and ends a tick late, along its motion: SPICE rounds times, and would not cover its ends.
    beyond = np.zeros(len(ticks))
    for samples in attitude.passes():
        if len(samples) > 1:
            beyond[samples[[0, -1]]] = -1.0, 1.0
    turned = Rotation.from_rotvec(-attitude.omega_B * beyond[:, None] / TICKS_PER_S)
    B_from_N, ticks = turned * Rotation.from_quat(attitude.quaternion), ticks + beyond
    quaternion = np.roll(B_from_N.as_quat(), 1, axis=1)
    rate_N = B_from_N.inv().apply(attitude.omega_B)
    starts = np.array([ticks[samples[0]] for samples in attitude.passes()])
    # arguments of SPICE's ckw03; True: the segment has rates
    descriptor = ticks[0], ticks[-1], BODY_ID, attitude.frame, True, "sunspin"
    records = len(ticks), ticks, quaternion, rate_N, len(starts), starts

    def write(path: Path) -> None:
        """Write the C-kernel to a path, with a function that `write_whole` calls."""
        handle = spiceypy.ckopn(str(path), "sunspin attitude", 0)
        try:
            spiceypy.ckw03(handle, *descriptor, *records)
        finally:
            spiceypy.ckcls(handle)

    # SPICE needs clock and frames while it writes
    spiceypy.furnsh([str(clock), str(frames)])
    try:
        return [write_whole(folder / "sunspin.bc", write), clock, frames]
    except spiceypy.exceptions.SpiceyError as error:
        what = f"SPICE refused the kernel ({' '.join(str(error).split())[:200]})"
        raise OutputError(what, where=str(folder)) from None
    finally:
        spiceypy.unload([str(clock), str(frames)])


def _text_kernels(start: float, frame: str) -> dict[str, str]:
    """Return the text of the clock kernel and of the frame kernel, by file name.

    The ticks of the clock are microseconds of TDB from `start` (TDB seconds past J2000). The frames are that of the body and, if
    `frame` is local, that one: a CK frame to which no kernel gives an orientation.
    """
    number = -SPACECRAFT  # the keys of a clock have the positive id
    clock = f"""KPL/SCLK
Clock made up by sunspin: one tick is a microsecond, tick 0 is TDB {start:.9f} s past J2000.
\\begindata
SCLK_KERNEL_ID = ( @2026-01-01/00:00:00 )
SCLK_DATA_TYPE_{number} = ( 1 )
SCLK01_TIME_SYSTEM_{number} = ( 1 )
SCLK01_N_FIELDS_{number} = ( 2 )
SCLK01_MODULI_{number} = ( 10000000000 {TICKS_PER_S} )
SCLK01_OFFSETS_{number} = ( 0 0 )
SCLK01_OUTPUT_DELIM_{number} = ( 1 )
SCLK_PARTITION_START_{number} = ( 0.0 )
SCLK_PARTITION_END_{number} = ( 1.0E16 )
SCLK01_COEFFICIENTS_{number} = ( 0.0 {start:.9f} 1.0 )
\\begintext
"""
    frames = "KPL/FK\nFrames of sunspin's attitude kernel.\n\\begindata\n"
    local = {frame.upper(): LOCAL_ID} if "LOCAL" in frame.upper() else {}
    for name, frame_id in ({BODY_NAME: BODY_ID} | local).items():
        frames += f"""FRAME_{name} = {frame_id}
FRAME_{frame_id}_NAME = '{name}'
FRAME_{frame_id}_CLASS = 3
FRAME_{frame_id}_CLASS_ID = {frame_id}
FRAME_{frame_id}_CENTER = {SPACECRAFT}
CK_{frame_id}_SCLK = {SPACECRAFT}
CK_{frame_id}_SPK = {SPACECRAFT}
"""
    return {"sunspin.tsc": clock, "sunspin.tf": frames + "\\begintext\n"}
