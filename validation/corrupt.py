"""Binary files damaged in many ways and opened: NetCDF, Parquet, stores of rows, SPICE kernels, zip archives.

Their readers are other people's C; a case runs in a worker of :mod:`validation.pool`, so a crash there is seen and counted.
"""

from __future__ import annotations

import io
import json
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

from sunspin.base.provenance import UNITS
from sunspin.base.untrusted import Elsewhere
from sunspin.output.folder import MARKER
from tests.corrupted import BYTES
from validation import fuzz
from validation.border import judge, sunspin
from validation.pool import Verdict
from validation.suite import Suite

FORMATS = """
telemetry.nc telemetry.parquet trajectory.nc rates.nc scan.nc store kernel.bc orbit.bsp
earth.bsp frames.zip report attributes summary
""".split()
SUN, ROWS = (0.1959, 0.5690, 0.7986), 60


def damaged(content: bytes, rng: np.random.Generator) -> bytes:
    """One way or another: what `tests/corrupted.py` does, or numbers of the file's own structure replaced."""
    if rng.random() < 0.5:
        return BYTES[int(rng.integers(len(BYTES) - 1))](content, rng)  # the last one is about text
    data = bytearray(content)
    for _ in range(int(rng.integers(1, 4))):
        at, size = int(rng.integers(len(data))), int(rng.choice([1, 2, 4, 8, 64, 512]))
        fill = (b"\xff", b"\0", b"\x7f", b"\x01")[int(rng.integers(4))]
        data[at : at + size] = (fill * size)[: len(data[at : at + size])]
    return bytes(data)


def mismatched(data: Any, rng: np.random.Generator) -> Any:
    """A Dataset with one to three of its variables gone, cut short, of another type, or with numbers that are none."""
    for name in rng.choice(sorted(data.variables), size=int(rng.integers(1, 4)), replace=False):
        values, dims = data[name].values, data[name].dims
        kind = int(rng.integers(5))
        about, data = data[name].attrs, data.drop_vars(name)
        if kind == 1:
            values, dims = values[: len(values) // 2], (f"other_{name}", *dims[1:])
        elif kind == 2:
            values = np.full(values.shape, rng.choice([np.nan, np.inf, -1e300]))
        elif kind == 3:
            values = np.full(values.shape, "x")
        elif kind == 4:
            values = values[::-1] * 1e9
        data = data if kind == 0 else data.assign({name: (dims, values, about)})
    return data


ATTRIBUTES = """
units units units long_name about title flag_meanings flag_values _FillValue missing_value
scale_factor add_offset calendar dtype coordinates _Unsigned kind epoch_utc vehicle strategy
frame_N chain title verdict periods priors seed passes cut_passes panels_left_out source changes
""".split()
"""Of variables and files: those that a reader, xarray or a page asks for."""

CONTENTS: tuple[Any, ...] = (
    7,
    -1,
    2.5,
    np.nan,
    np.inf,
    np.array([1.0, 2.0]),
    np.zeros(0),
    True,
    "",
    " ",
    "<script>alert(1)</script>",
    "$\\frac$",
    "$x_$",
    "\u202egnp",
    "\x1b[2J",
    "a\nb",
    "x" * 5000,
    np.bytes_(b"\xff\xfe"),
    *(
        "days since 0001-01-01|seconds since 2026-01-01|seconds since yesterday|deg/s|rad/s|s|ms|"
        '1|%s{0}|bool|time|nothing else|true|noleap|null|[]|{|{"a": 1}|../../etc/passwd|'
        "2026-01-01T00:00:00Z|9999-12-31T23:59:59Z|philae|J2000"
    ).split("|"),
)
"""What somebody may write there."""

DELETED = object()
JSON: tuple[Any, ...] = (
    None,
    True,
    0,
    -1,
    1e308,
    10**400,
    "",
    "x" * 5000,
    "<img src=x onerror=alert(1)>",
    "\u202e",
    "\ud800",
    "$\\frac$",
    [],
    {},
    [[]],
    [None],
    [{}],
    {"": None},
    {"a": {"b": []}},
    "2026-01-01",
    "nan",
    [1, 2, 3],
    [1e400],
    DELETED,
)


def relabelled(path: Path, rng: np.random.Generator) -> None:
    """Attributes of a NetCDF file changed, of one to three variables or of the file, or taken away."""
    import h5py

    with h5py.File(path, "r+") as file:
        found: list[Any] = [file]
        file.visititems(lambda _, item: found.append(item))
        for _ in range(int(rng.integers(1, 4))):
            item = found[int(rng.integers(len(found)))]
            own = [
                name
                for name in item.attrs
                if name not in ("DIMENSION_LIST", "REFERENCE_LIST", "CLASS", "NAME")
            ]
            name = str(rng.choice([*ATTRIBUTES, *own * 4]))
            if name in item.attrs and rng.random() < 0.2:
                del item.attrs[name]
            else:
                item.attrs[name] = CONTENTS[int(rng.integers(len(CONTENTS)))]


def reworded(value: Any, rng: np.random.Generator) -> Any:
    """Plain data with something else in one place."""
    if isinstance(value, dict | list) and value and rng.random() < 0.85:
        keys = list(value) if isinstance(value, dict) else range(len(value))
        key = keys[int(rng.integers(len(keys)))]
        new = reworded(value[key], rng)
        if isinstance(value, list):
            return [*value[:key], *([] if new is DELETED else [new]), *value[key + 1 :]]
        return {
            k: new if k == key else v for k, v in value.items() if k != key or new is not DELETED
        }
    return JSON[int(rng.integers(len(JSON)))]


def made_rates() -> Any:
    """A result of `rates` in small, with the curves between its samples."""
    import xarray as xr

    import sunspin as ss

    craft = ss.Vehicle("cube", np.diag([0.02, 0.021, 0.01]))
    times = (np.arange(0.0, 300.0, step) for step in (30.0, 3.0))
    run, fine = (ss.propagate(craft, [0.01, 0.02, 0.03], [0.6, 0.0, 0.8], None, t) for t in times)
    n, m = run.sizes["time"], fine.sizes["time"]
    curve = {
        "curve_omega_B": "omega_B",
        "curve_omega_sigma_B": "omega_B",
        "curve_B_from_N": "B_from_N",
    }
    made = xr.Dataset(
        {name: (run[name].dims, run[name].values) for name in ("omega_B", "B_from_N", "sun_B")}
        | {name: (("curve_time", fine[of].dims[1]), fine[of].values) for name, of in curve.items()}
        | {
            "pass_of": ("time", np.zeros(n, dtype=int)),
            "curve_pass_of": ("curve_time", np.zeros(m, dtype=int)),
            "omega_cov_B": (("time", "axis", "axis2"), np.tile(1e-8 * np.eye(3), (n, 1, 1))),
            "omega_sigma_all_B": (("pass_id", "axis"), np.full((1, 3), 1e-4)),
            "weight": (("pass_id", "mode"), [[1.0]]),
            "omega_mean_B": (("pass_id", "mode", "axis"), np.full((1, 1, 3), 0.02)),
            "omega_sigma_B": (("pass_id", "mode", "axis"), np.full((1, 1, 3), 1e-4)),
        },
        coords={"time": run["time"].values, "curve_time": fine["time"].values, "pass_id": [0]},
        attrs={
            "kind": "rates",
            "epoch_utc": "2026-01-01T00:00:00Z",
            "source": "panels",
            "vehicle": "cube",
        },
    )
    for name in {*made.variables} & {*UNITS}:
        made[name].attrs["units"] = UNITS[str(name)]
    return made


class Corrupt(Suite):
    """Damaged files of every format that is read."""

    def prepare(self) -> None:
        """Good files, and shorter work."""
        os.chdir(self.home)
        self.good = make_files(self.home)
        self.kinds = make_kinds()  # in full: its kernel may have to be compiled first
        for change in fuzz.cut_short():
            self.stack.enter_context(change)

    def __call__(self, index: int) -> Verdict:
        rng = np.random.default_rng(np.random.SeedSequence(self.seed, spawn_key=(index,)))
        self.last = self.only or FORMATS[int(rng.integers(len(FORMATS)))]
        place = self.home / "case"
        shutil.rmtree(place, ignore_errors=True)
        place.mkdir()
        verdict = getattr(self, "try_" + self.last.replace(".", "_"))(place, rng)
        return verdict._replace(shown=f"{self.last}: {verdict.shown}") if verdict.bad else verdict

    def _bad(self, name: str, place: Path, rng: np.random.Generator) -> Path:
        target = place / Path(name).name
        target.write_bytes(damaged(self.good[name], rng))
        return target

    def _told(self, *arguments: object) -> Verdict:
        self.told = sunspin(*map(str, arguments))
        return judge(self.told)

    def try_telemetry_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        return self._told("sun", "stock/vehicle.toml", self._bad("telemetry.nc", place, rng))

    def try_telemetry_parquet(self, place: Path, rng: np.random.Generator) -> Verdict:
        return self._told("sun", "stock/vehicle.toml", self._bad("telemetry.parquet", place, rng))

    def try_trajectory_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        self._bad("trajectory.nc", place, rng)
        form = str(rng.choice(["aem", "ck", "netcdf", "parquet"]))
        return self._told(
            "export",
            place,
            "--epoch=2026-01-01T00:00:00Z",
            f"--format={form}",
            "--out",
            place / "out",
        )

    def try_rates_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        """A page is made of rates whose variables do not belong together: curves without a pass, of other lengths, not finite."""
        shutil.copytree("stock/results", place / "results")
        mismatched(self.good["rates"], rng).to_netcdf(
            place / "results" / "rates.nc", engine="h5netcdf"
        )
        return self._told("report", place / "results")

    def _read_by(self, folder: Path, place: Path, rng: np.random.Generator) -> Verdict:
        """One of the commands that read a results folder."""
        more = {
            "report": [folder],
            "compare": [folder, self.kinds[folder.name]],
            "export": [
                folder,
                "--epoch=2026-01-01T00:00:00Z",
                f"--format={rng.choice(['aem', 'netcdf'])}",
                "--out",
                place / "out",
            ],
        }
        command = str(rng.choice(list(more)))
        return self._told(command, *more[command])

    def _folder(self, place: Path, rng: np.random.Generator) -> Path:
        name = str(rng.choice(sorted(self.kinds)))
        return Path(shutil.copytree(self.kinds[name], place / name))

    def try_attributes(self, place: Path, rng: np.random.Generator) -> Verdict:
        folder = self._folder(place, rng)
        files = sorted(folder.glob("*.nc"))
        path = files[int(rng.integers(len(files)))]
        relabelled(path, rng)
        if path.name == "telemetry.nc" and rng.random() < 0.5:
            return self._told("sun", "stock/vehicle.toml", path)
        return self._read_by(folder, place, rng)

    def try_summary(self, place: Path, rng: np.random.Generator) -> Verdict:
        folder = self._folder(place, rng)
        path = folder / str(rng.choice(["summary.json", "summary.json", "figures.json"]))
        said = json.loads(path.read_text("utf-8")) if path.exists() else []
        for _ in range(int(rng.integers(1, 4))):
            said = reworded(said, rng)
            said = {} if said is DELETED else said
        path.write_text(json.dumps(said), "utf-8")
        return self._read_by(folder, place, rng)

    def try_scan_nc(self, place: Path, rng: np.random.Generator) -> Verdict:
        bad = self._bad("scan.nc", place, rng)
        return self._told(
            "outcomes",
            "stock/vehicle.toml",
            "--scan",
            bad,
            "--sun=0,0.6,0.8",
            "--after=60",
            "--runs=4",
        )

    def try_kernel_bc(self, place: Path, rng: np.random.Generator) -> Verdict:
        bad = self._bad("kernel.bc", place, rng)
        more = ["kernels/sunspin.tsc", "kernels/sunspin.tf"]
        if rng.random() < 0.3:
            k = int(rng.integers(2))
            text = place / Path(more[k]).name
            text.write_bytes(damaged(Path(more[k]).read_bytes(), rng))
            more[k] = str(text)
        names = ["--frame=SUNSPIN_BODY", "--base=SUNSPIN_LOCAL", "--epoch=2026-01-01T00:00:00Z"]
        return self._told("compare", "stock/results", bad, *more, *names)

    def try_orbit_bsp(self, place: Path, rng: np.random.Generator) -> Verdict:
        from sunspin.philae.collision import KERNEL, kernel_facts
        from sunspin.telemetry.case import load_case

        (place / KERNEL[0]).mkdir()
        place.joinpath(*KERNEL).write_bytes(damaged(self.good["orbit.bsp"], rng))
        return _sentence(lambda: kernel_facts(load_case("philae"), place))

    def try_earth_bsp(self, place: Path, rng: np.random.Generator) -> Verdict:
        from sunspin.environment.ephemeris import read_ephemeris

        bad = self._bad("earth.bsp", place, rng)
        return _sentence(lambda: read_ephemeris(bad))

    def try_frames_zip(self, place: Path, rng: np.random.Generator) -> Verdict:
        return self._told("decode", self._bad("frames.zip", place, rng), "--out", place / "out")

    def try_report(self, place: Path, rng: np.random.Generator) -> Verdict:
        """A page is made all the same, of what can be read; the file is named on it."""
        shutil.copytree("stock/results", place / "results")
        files = sorted(
            path
            for path in (place / "results").iterdir()
            if path.name != MARKER and path.stat().st_size
        )
        for path in rng.choice(np.array(files, dtype=object), size=int(rng.integers(1, 3))):
            path.write_bytes(damaged(path.read_bytes(), rng) if path.stat().st_size else b"x")
        return self._told("report", place / "results")

    def try_store(self, place: Path, rng: np.random.Generator) -> Verdict:
        from sunspin.compute.rows import ensemble

        shutil.copytree("store", place / "store")
        files = sorted(path for path in (place / "store").rglob("*") if path.is_file())
        for path in rng.choice(np.array(files, dtype=object), size=int(rng.integers(1, 4))):
            path.write_bytes(
                damaged(path.read_bytes(), rng)
            ) if path.stat().st_size else path.write_bytes(b"x")
        found: dict[str, Any] = {}
        verdict = _sentence(
            lambda: found.update(
                ensemble(self.good["rows"], store=place / "store", workers=1, chunk=7)
            )
        )
        if verdict.what == "fine" and any(
            found[k].tobytes() != v.tobytes() for k, v in self.good["result"].items()
        ):
            return Verdict("wrong result", True, "damage passed unseen")
        return verdict


class Unguarded(Corrupt):
    """The same with everything read in this process, which counts what the processes apart are for."""

    def prepare(self) -> None:
        super().prepare()
        for place, read in (
            ("base.netcdf._in_another_process", lambda *_, **__: None),
            ("environment.ephemeris.elsewhere", run_here),
            ("output.export.ck.elsewhere", run_here),
        ):
            self.stack.enter_context(mock.patch(f"sunspin.{place}", read))


def run_here(script: Path, *arguments: str, content: bytes = b"", seconds: int) -> bytes:  # noqa: ARG001
    """What `sunspin.base.untrusted.elsewhere` does, without another process."""
    import spiceypy as sp

    given, printed = (SimpleNamespace(buffer=io.BytesIO(text)) for text in (content, b""))
    with mock.patch.multiple(sys, argv=[str(script), *arguments], stdin=given, stdout=printed):
        try:
            runpy.run_path(str(script), run_name="__main__")
        except (Exception, SystemExit) as error:
            raise Elsewhere(" ".join(str(error).split())[:200]) from None
        finally:
            sp.kclear()
    return printed.buffer.getvalue()


def _sentence(call: Any) -> Verdict:
    """Whether a call returns or says one sentence."""
    from sunspin.base.errors import SunspinError

    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always", RuntimeWarning)
        try:
            call()
        except SunspinError as error:
            return Verdict("refused", not str(error).isprintable(), repr(str(error)))
        except Exception as error:
            return Verdict("traceback", True, f"{type(error).__name__}: {error}")
    noise = [str(w.message) for w in said if issubclass(w.category, RuntimeWarning)]
    return Verdict("noise", True, "; ".join(noise)) if noise else Verdict("fine")


def make_kinds() -> dict[str, Path]:
    """A results folder of each kind that is made soon, in the present folder; those of a few minutes are not among them."""
    found = {"simulate": Path("stock/results")}
    files, start = (
        ["stock/vehicle.toml", "stock/telemetry.csv"],
        ["--sun=0,0.6,0.8", "--after=60", "--collision-speed=0"],
    )
    grid = ["--omega-x=0:0.02:0.02", "--omega-y=-0.03:-0.03:1", "--omega-z=0.05:0.05:1"]
    for command, *arguments in (
        ("sun", *files),
        ("scan", *files, "--to=160", "--lines=0", *grid),
        ("rates", *files, "--noise=1e-4", "--effort=0.01"),
        ("outcomes", files[0], "--runs=8", "--omega=0.1,0,0", *start),
    ):
        told = sunspin(command, *arguments, "--out", f"kinds/{command}")
        if told.code != 0:
            raise RuntimeError(f"the results of {command} could not be made: {told}")
        found[command] = Path("kinds", command)
    return found


def make_files(home: Path) -> dict[str, Any]:
    """One good file of each kind, in the present folder; contents by name."""
    import xarray as xr

    from sunspin.compute.rows import ensemble
    from tests.rowsets import Waves

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
    made = sunspin(
        "export", "stock/results", "--epoch=2026-01-01T00:00:00Z", "--format=ck", "--out=kernels"
    )
    if made.code != 0:
        raise RuntimeError(made.err)
    write_orbits(home)
    function = Waves(n_rows=ROWS)
    result = ensemble(function, store="store", chunk=7, workers=1)
    content = {
        name: Path(name).read_bytes()
        for name in ("telemetry.nc", "telemetry.parquet", "scan.nc", "orbit.bsp", "earth.bsp")
    }
    content["trajectory.nc"] = Path("stock/results/trajectory.nc").read_bytes()
    content["kernel.bc"] = Path("kernels/sunspin.bc").read_bytes()
    content["frames.zip"] = Path("stock/frames.zip").read_bytes()
    return content | {"rows": function, "result": result, "rates": made_rates()}


def write_parquet(path: str, columns: dict[str, np.ndarray]) -> None:
    import pyarrow as pa
    import pyarrow.parquet as pq

    pq.write_table(pa.table(columns), path)


def write_orbits(home: Path) -> None:
    """A made-up trajectory of the lander where the case's kernel would be, with its ids and times, and an orbit of the Earth."""
    import spiceypy as sp

    from sunspin.philae import collision
    from sunspin.telemetry.case import load_case

    case = load_case("philae")
    begin = collision.tdb_of(case, "first_touchdown") - 100
    end = collision.tdb_of(case, "second_touchdown") + 100
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
        handle = sp.spkopn(str(home / name), "made up", 0)
        sp.spkw09(handle, body, centre, "J2000", begin, end, "made up", 3, len(t), table, t)
        sp.spkcls(handle)
