"""Open binary files damaged in many ways: NetCDF, Parquet, stores of rows, SPICE kernels, zip archives.

Their readers are C libraries of other projects. A case runs in a worker of :mod:`validation.pool`, so that a crash is counted.
"""

from __future__ import annotations

import argparse
import io
import os
import runpy
import shutil
import sys
import warnings
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest import mock

import numpy as np

from sunspin.base.untrusted import IsolatedRunError
from tests.support.corruptions import BYTES
from validation import fuzz, pool
from validation.border import judge, sunspin
from validation.pool import Suite, Verdict

FORMATS = (
    "telemetry.nc",
    "telemetry.parquet",
    "scan.nc",
    "store",
    "kernel.bc",
    "orbit.bsp",
    "earth.bsp",
    "frames.zip",
)
ROWS = 60
"""Number of rows in the store."""


def damage(content: bytes, rng: np.random.Generator) -> bytes:
    """Return damaged content: by a method of `tests/support/corruptions.py`, or with numbers of the file's structure replaced."""
    if rng.random() < 0.5:
        return BYTES[int(rng.integers(len(BYTES) - 1))](content, rng)  # the last one is about text
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at, size = int(rng.integers(len(data))), int(rng.choice([1, 2, 4, 8, 64, 512]))
        fill = (b"\xff", b"\0", b"\x7f", b"\x01")[int(rng.integers(4))]
        data[at : at + size] = (fill * size)[: len(data[at : at + size])]
    return bytes(data)


class Corrupt(Suite):
    """Damaged files of every format that is read."""

    def prepare(self) -> None:
        """Make good files, and shorten work that would take long."""
        for change in fuzz.shorten_work():
            self.stack.enter_context(change)
        os.chdir(self.home)
        self.good = make_files(self.home)

    def __call__(self, index: int) -> Verdict:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        self.last = self.only or FORMATS[int(rng.integers(len(FORMATS)))]
        place = self.home / "case"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        # the method of the format: telemetry.nc -> try_telemetry_nc
        verdict = getattr(self, "try_" + self.last.replace(".", "_"))(place, rng)
        return verdict._replace(shown=f"{self.last}: {verdict.shown}") if verdict.bad else verdict

    def _write_damaged(self, name: str, place: Path, rng: np.random.Generator) -> Path:
        """Write a damaged copy of a good file into a folder."""
        target = place / Path(name).name
        target.write_bytes(damage(self.good[name], rng))
        return target

    def _run_command(self, *arguments: object) -> Verdict:
        """Run the command line and judge the result."""
        self.result = sunspin(*map(str, arguments))
        return judge(self.result)

    def try_telemetry_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Read a damaged NetCDF file as telemetry."""
        return self._run_command(
            "sun", "stock/vehicle.toml", self._write_damaged("telemetry.nc", place, rng)
        )

    def try_telemetry_parquet(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Read a damaged Parquet file as telemetry."""
        return self._run_command(
            "sun", "stock/vehicle.toml", self._write_damaged("telemetry.parquet", place, rng)
        )

    def try_scan_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Read a damaged scan."""
        bad = self._write_damaged("scan.nc", place, rng)
        return self._run_command(
            "outcomes",
            "stock/vehicle.toml",
            "--scan",
            bad,
            "--sun=0,0.6,0.8",
            "--after=60",
            "--runs=4",
        )

    def try_kernel_bc(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Compare results with a damaged attitude kernel; sometimes its text kernels are damaged too."""
        bad = self._write_damaged("kernel.bc", place, rng)
        text_kernels = ["kernels/sunspin.tsc", "kernels/sunspin.tf"]
        if rng.random() < 0.3:
            k = int(rng.integers(2))
            text = place / Path(text_kernels[k]).name
            text.write_bytes(damage(Path(text_kernels[k]).read_bytes(), rng))
            text_kernels[k] = str(text)
        names = ["--frame=SUNSPIN_BODY", "--base=SUNSPIN_LOCAL", "--epoch=2026-01-01T00:00:00Z"]
        return self._run_command("compare", "stock/results", bad, *text_kernels, *names)

    def try_orbit_bsp(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Read a damaged trajectory kernel of the rebound."""
        from sunspin.cases import load_case
        from sunspin.philae.collision import KERNEL, kernel_facts

        (place / KERNEL[0]).mkdir()
        place.joinpath(*KERNEL).write_bytes(damage(self.good["orbit.bsp"], rng))
        return _judge_call(lambda: kernel_facts(load_case("philae"), place))

    def try_earth_bsp(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Read a damaged kernel as an orbit."""
        from sunspin.environment.ephemeris import read_orbit

        bad = self._write_damaged("earth.bsp", place, rng)
        return _judge_call(lambda: read_orbit(bad))

    def try_frames_zip(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Decode a damaged archive of frames."""
        return self._run_command(
            "decode", self._write_damaged("frames.zip", place, rng), "--out", place / "out"
        )

    def try_store(self, place: Path, rng: np.random.Generator) -> Verdict:
        """Resume from a damaged store of rows; the result must be that of good rows."""
        from sunspin.compute.rows import ensemble

        shutil.copytree("store", place / "store")
        files = sorted(path for path in (place / "store").rglob("*") if path.is_file())
        for path in rng.choice(np.array(files, dtype=object), size=int(rng.integers(1, 4))):
            content = path.read_bytes()
            path.write_bytes(damage(content, rng) if content else b"x")
        resumed: dict[str, Any] = {}
        verdict = _judge_call(
            lambda: resumed.update(
                ensemble(self.good["rows"], store=place / "store", workers=1, chunk=7)
            )
        )
        if verdict.what == "fine" and any(
            not np.allclose(resumed[k], v, rtol=1e-9, equal_nan=True)
            for k, v in self.good["result"].items()
        ):
            return Verdict("wrong result", True, "damage passed unseen")
        return verdict


class Unguarded(Corrupt):
    """The same with everything read in this process, which counts the crashes that the separate processes prevent."""

    def prepare(self) -> None:
        """Replace reading in another process by reading in this one."""
        super().prepare()
        for place, read in (
            ("base.netcdf.run_isolated", lambda *_, **__: b""),
            ("environment.ephemeris.run_isolated", run_here),
            ("output.export.against.run_isolated", run_here),
            ("philae.collision.run_isolated", run_here),
        ):
            self.stack.enter_context(mock.patch(f"sunspin.{place}", read))


def run_here(script: Path, *arguments: str, content: bytes = b"", seconds: int) -> bytes:  # noqa: ARG001
    """Run a script in this process instead of another one, with the interface of `sunspin.base.untrusted.run_isolated`."""
    import spiceypy

    given, printed = (SimpleNamespace(buffer=io.BytesIO(text)) for text in (content, b""))
    with mock.patch.multiple(sys, argv=[str(script), *arguments], stdin=given, stdout=printed):
        try:
            runpy.run_path(str(script), run_name="__main__")
        except (Exception, SystemExit) as error:
            raise IsolatedRunError(" ".join(str(error).split())[:200]) from None
        finally:
            spiceypy.kclear()
    return printed.buffer.getvalue()


def _judge_call(call: Any) -> Verdict:
    """Return the verdict on a function call: it must return or raise one printable sentence, without warnings."""
    from sunspin.base.errors import SunspinError

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RuntimeWarning)
        try:
            call()
        except SunspinError as error:
            return Verdict("refused", not str(error).isprintable(), repr(str(error)))
        except Exception as error:
            return Verdict("traceback", True, f"{type(error).__name__}: {error}")
    noise = [
        str(warning.message) for warning in caught if issubclass(warning.category, RuntimeWarning)
    ]
    return Verdict("noise", True, "; ".join(noise)) if noise else Verdict("fine")


def make_files(home: Path) -> dict[str, Any]:
    """Make one good file of each format in the current folder, and return their contents by name."""
    import xarray as xr

    from sunspin.compute.rows import ensemble
    from tests.support.rows import Waves

    fuzz.make_stock(home / "stock")
    rows = (home / "stock" / "telemetry.csv").read_text("utf-8").splitlines()[1:]
    header, cells = rows[0].split(","), [row.split(",") for row in rows[1:]]
    columns: dict[str, Any] = {
        name: np.array([float(row[k]) for row in cells]) for k, name in enumerate(header) if k
    }
    utc = np.array([row[0].rstrip("Z") for row in cells], dtype="datetime64[ns]")
    table = xr.Dataset(
        {name: ("row", v) for name, v in columns.items()} | {"time_utc": ("row", utc)}
    )
    table.to_netcdf("telemetry.nc", engine="h5netcdf")
    write_parquet("telemetry.parquet", columns | {"time_utc": utc.astype("datetime64[us]")})
    axes = {f"omega_{x}": np.array([0.0, 0.1]) for x in "xyz"}
    dims = tuple(axes)
    volume = xr.DataArray(
        np.linspace(0.1, 0.2, 8).reshape(2, 2, 2), dims=dims, coords=axes, name="emd"
    )
    volume.assign_coords(outcome=(dims, np.zeros((2, 2, 2), dtype=np.int8))).to_dataset().to_netcdf(
        "scan.nc", engine="h5netcdf"
    )
    exported = sunspin(
        "export", "stock/results", "--epoch=2026-01-01T00:00:00Z", "--format=ck", "--out=kernels"
    )
    if exported.code != 0:
        raise RuntimeError(exported.err)
    write_orbits(home)
    function = Waves(n_rows=ROWS)
    result = ensemble(function, store="store", chunk=7, workers=1)
    content = {
        name: Path(name).read_bytes()
        for name in ("telemetry.nc", "telemetry.parquet", "scan.nc", "orbit.bsp", "earth.bsp")
    }
    content["kernel.bc"] = Path("kernels/sunspin.bc").read_bytes()
    content["frames.zip"] = Path("stock/frames.zip").read_bytes()
    return content | {"rows": function, "result": result}


def write_parquet(path: str, columns: dict[str, np.ndarray]) -> None:
    """Write columns as a Parquet file."""
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), path)


def write_orbits(home: Path) -> None:
    """Write a made-up trajectory of the lander with the ids and times of the case's kernel, and an orbit of the Earth."""
    import spiceypy

    from sunspin.cases import load_case
    from sunspin.philae import collision

    case = load_case("philae")
    begin = collision.event_tdb_s(case, "first_touchdown") - 100
    end = collision.event_tdb_s(case, "second_touchdown") + 100
    t = np.linspace(begin, end, 200)
    states = np.column_stack(
        [1 + 1e-5 * (t - begin), 2 - 1e-5 * (t - begin), 0 * t, 1e-5 + 0 * t, -1e-5 + 0 * t, 0 * t]
    )
    angle = (t - begin) * 2 * np.pi / 5600
    speed, still = 6900 * 2 * np.pi / 5600, 0 * t
    circle = [np.cos(angle), np.sin(angle), still, -np.sin(angle), np.cos(angle), still]
    orbit = np.column_stack(circle) * [6900, 6900, 0, speed, speed, 0]
    for name, body, centre, table in (
        ("orbit.bsp", -226800, 1000012, states),
        ("earth.bsp", -99, 399, orbit),
    ):
        handle = spiceypy.spkopn(str(home / name), "made up", 0)
        spiceypy.spkw09(handle, body, centre, "J2000", begin, end, "made up", 3, len(t), table, t)
        spiceypy.spkcls(handle)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    pool.options(parser)
    parser.add_argument("--only", choices=FORMATS)
    about = "read in the same process what sunspin reads in another, and count crashes and hangs"
    parser.add_argument("--unguarded", action="store_true", help=about)


def main(given: argparse.Namespace) -> int:
    """Print the campaign's figures; return 1 if it has findings."""
    return pool.main(Unguarded if given.unguarded else Corrupt, given)
