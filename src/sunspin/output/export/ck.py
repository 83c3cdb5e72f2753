"""SPICE C-kernel with the clock and frame kernels that it needs, and the comparison with somebody else's attitude kernels.

The clock kernel makes one tick a microsecond from the epoch of the result; the frame kernel names the body's frame, which the
C-kernel orients, and the local frame N, which is not related to any other: SPICE refuses to go from it to J2000, as it should.
"""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from sunspin.base.errors import InputError, OutputError, sentence
from sunspin.base.untrusted import Elsewhere, elsewhere, is_plain
from sunspin.dynamics.propagate import MAX_RATE
from sunspin.output.export import Attitude
from sunspin.output.folder import write_whole

SPACECRAFT = -999_001
"""Ids made up for the kernels written here, far from those that NAIF has given out."""

BODY_ID, LOCAL_ID = SPACECRAFT * 1000, SPACECRAFT * 1000 - 1
BODY_NAME = "SUNSPIN_BODY"
TICKS_PER_S = 1_000_000

KERNEL_S = 20
"""CPU time in which rates are read from kernels: they are read in another process, as damaged ones end SPICE."""

LEAP_SECONDS = (
    (1972, 1, 10),
    (1972, 7, 11),
    (1973, 1, 12),
    (1974, 1, 13),
    (1975, 1, 14),
    (1976, 1, 15),
    (1977, 1, 16),
    (1978, 1, 17),
    (1979, 1, 18),
    (1980, 1, 19),
    (1981, 7, 20),
    (1982, 7, 21),
    (1983, 7, 22),
    (1985, 7, 23),
    (1988, 1, 24),
    (1990, 1, 25),
    (1991, 1, 26),
    (1992, 7, 27),
    (1993, 7, 28),
    (1994, 7, 29),
    (1996, 1, 30),
    (1997, 7, 31),
    (1999, 1, 32),
    (2006, 1, 33),
    (2009, 1, 34),
    (2012, 7, 35),
    (2015, 7, 36),
    (2017, 1, 37),
)
"""TAI - UTC in s from the first of (year, month) on; IERS Bulletin C, no further one announced until 2026."""


def ephemeris_time(moment: datetime) -> float:
    """SPICE's ephemeris time (TDB seconds past J2000) of a UTC moment, to 0.05 ms (NAIF time-kernel formula)."""
    offsets = [
        seconds
        for year, month, seconds in LEAP_SECONDS
        if moment >= datetime(year, month, 1, tzinfo=UTC)
    ]
    if not offsets:
        raise InputError(sentence("UTC before 1972 has no leap seconds", got=moment.isoformat()))
    since = (moment - datetime(2000, 1, 1, 12, tzinfo=UTC)).total_seconds() + offsets[-1] + 32.184
    anomaly = 6.239996 + 1.99096871e-7 * since
    return since + 1.657e-3 * float(np.sin(anomaly + 1.671e-2 * np.sin(anomaly)))


def spice() -> Any:
    """The spiceypy module, or a sentence on how to install it."""
    try:
        import spiceypy
    except ImportError:
        raise OutputError(
            sentence("SPICE kernels need spiceypy", do='pip install "sunspin[spice]"')
        ) from None
    return spiceypy


def write_ck(folder: Path, attitude: Attitude) -> list[Path]:
    """Write sunspin.bc (type 3, with rates), sunspin.tsc and sunspin.tf into `folder`; one interpolation interval per pass."""
    sp = spice()
    if not str(folder).isprintable():
        raise OutputError(
            sentence(
                "SPICE takes no such folder name", got=str(folder), do="give one of plain letters"
            )
        )
    clock = write_whole(
        folder / "sunspin.tsc", lambda part: part.write_text(_clock_kernel(attitude), "ascii")
    )
    frames = write_whole(
        folder / "sunspin.tf", lambda part: part.write_text(_frame_kernel(attitude), "ascii")
    )
    ticks = np.round((attitude.t_s - min(0.0, attitude.t_s.min())) * TICKS_PER_S)
    if np.any(np.diff(ticks) <= 0):
        raise InputError(sentence("a C-kernel needs times that increase by a microsecond or more"))
    matrix = body_from_local(attitude)
    quaternion = np.array([sp.m2q(m) for m in matrix])
    rate = np.einsum("nji,nj->ni", matrix, attitude.omega_B)  # SPICE wants it in the base frame
    starts = np.array([ticks[part[0]] for part in attitude.parts()])

    def write(path: Path) -> None:
        handle = sp.ckopn(str(path), "sunspin attitude", 0)
        try:
            sp.ckw03(
                handle,
                ticks[0],
                ticks[-1],
                BODY_ID,
                attitude.frame,
                True,
                "sunspin",
                len(ticks),
                ticks,
                quaternion,
                rate,
                len(starts),
                starts,
            )
        finally:
            sp.ckcls(handle)

    sp.furnsh([str(clock), str(frames)])
    try:
        return [write_whole(folder / "sunspin.bc", write), clock, frames]
    except sp.exceptions.SpiceyError as error:
        raise OutputError(
            sentence(f"SPICE refused the kernel ({_short(error)})", where=str(folder))
        ) from None
    finally:
        sp.unload([str(clock), str(frames)])


def body_from_local(attitude: Attitude) -> np.ndarray:
    """Matrices B_from_N (n, 3, 3)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(attitude.quaternion).as_matrix()


def _clock_kernel(attitude: Attitude) -> str:
    """Ticks count microseconds from the epoch (or the first sample, if that is earlier), parallel to TDB."""
    start = ephemeris_time(attitude.epoch) + min(0.0, float(attitude.t_s.min()))
    number = -SPACECRAFT
    return f"""KPL/SCLK
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


def _frame_kernel(attitude: Attitude) -> str:
    """The body's frame, and the local frame as one without a relation to any other (a CK frame that no kernel orients)."""
    local = [] if "LOCAL" not in attitude.frame.upper() else [(attitude.frame.upper(), LOCAL_ID)]
    lines = []
    for name, number in [(BODY_NAME, BODY_ID), *local]:
        lines += [
            f"FRAME_{name} = {number}",
            f"FRAME_{number}_NAME = '{name}'",
            f"FRAME_{number}_CLASS = 3",
            f"FRAME_{number}_CLASS_ID = {number}",
            f"FRAME_{number}_CENTER = {SPACECRAFT}",
            f"CK_{number}_SCLK = {SPACECRAFT}",
            f"CK_{number}_SPK = {SPACECRAFT}",
        ]
    return (
        "KPL/FK\nFrames of sunspin's attitude kernel.\n\\begindata\n"
        + "\n".join(lines)
        + "\n\\begintext\n"
    )


def kernel_rates(kernels: list[str], frame: str, base: str, et: np.ndarray) -> np.ndarray:
    """Angular velocity (n, 3) rad/s of `frame` against `base`, in axes of `frame`, from SPICE kernels; NaN where none covers."""
    spice()
    # in another process: of 2,000 damaged kernels 1 ended this one (`validation corrupt --unguarded --only kernel.bc`, seeds 0, 1)
    pool = [str(path) for path in kernels]
    for path in pool:
        if not (path.isprintable() and is_plain(Path(path))):
            what = "the kernels cannot be used, as there is no such file"
            raise InputError(sentence(what, got=path, do="give the paths of SPICE kernels"))
    try:
        printed = elsewhere(
            Path(__file__).with_name("spice_rates.py"),
            frame,
            base,
            *pool,
            seconds=KERNEL_S,
            content=np.asarray(et, dtype=np.float64).tobytes(),
        )
    except Elsewhere as error:
        what = f"the kernels cannot be used ({error})"
        raise InputError(sentence(what, got=", ".join(pool))) from None
    rates = np.frombuffer(printed, dtype=np.float64).reshape(-1, 3)
    if np.any(np.abs(rates) > MAX_RATE):
        raise InputError(
            sentence(
                f"the kernels hold rates beyond {MAX_RATE:g} rad/s",
                do="check them: they may be damaged",
            )
        )
    return rates


def _short(error: Exception) -> str:
    return " ".join(str(error).split())[:200]
