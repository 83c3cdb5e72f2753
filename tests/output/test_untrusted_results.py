"""A results folder from somebody else: nothing from outside it is read, and it ends in a page or a sentence, soon."""

from __future__ import annotations

import base64
import json
import os
import random
import time
from pathlib import Path

import h5py
import numpy as np
import pytest
import xarray as xr

from sunspin.base.errors import InputError, printable
from sunspin.base.netcdf import read_groups, read_netcdf
from sunspin.base.provenance import LABELS, vocabulary
from sunspin.output.export import read_results as exported
from sunspin.output.folder import MANIFEST, MARKER, write_netcdf
from sunspin.output.report import write_report
from sunspin.output.report.read import MAX_FILES, read_results

KINDS = {name: row["kind"] for name, row in vocabulary("attributes.csv").items()}
FIXED = [name for name, row in vocabulary().items() if row["fixed"]]
SECRET = "a word that stands nowhere else 7f3b"
PNG = b"\x89PNG\r\n\x1a\n" + SECRET.encode()
READ = (
    "summary.json",
    "vehicle.toml",
    "timeline.toml",
    "rates.nc",
    "trajectory.nc",
    "telemetry.nc",
    "sun.svg",
    "sun.csv",
)
ODD = ("a\nb", "é\udce9", '"><script>', "..", "-", "\u202e", "$x$", "\x1b[2J", "a" * 200)


@pytest.fixture
def folder(tmp_path) -> Path:
    made = tmp_path / "results"
    made.mkdir()
    (made / MARKER).write_text("rates\n", "utf-8")
    manifest = {
        "data": ["rates.nc", "trajectory.nc", "telemetry.nc"],
        "figures": [{"file": "sun.svg"}],
        "tables": [{"file": "sun.csv", "shown": {"a": "a"}}],
    }
    (made / MANIFEST).write_text(json.dumps(manifest), "utf-8")
    return made


def outside(home: Path, name: str) -> Path:
    """A file beside the results that a reader of `name` would understand, with the secret in it."""
    path = home / f"outside{Path(name).suffix}"
    if path.suffix == ".nc":
        write_netcdf(
            path,
            xr.Dataset(
                {"x": ("time", np.arange(3.0), {"note": SECRET})}, attrs={"vehicle": SECRET}
            ),
        )
    else:
        texts = {
            ".json": f'{{"command": "{SECRET}", "figures": "{SECRET}"}}'
            if name == "summary.json"
            else "",
            ".toml": f'name = "{SECRET}"\n'
            if name == "vehicle.toml"
            else f'epoch_utc = "{SECRET}"\n',
        }
        texts |= {".svg": PNG.decode("latin-1"), ".csv": f"a\n{SECRET}\n"}
        path.write_bytes(texts[path.suffix].encode("latin-1"))
    return path


def told(folder: Path) -> str:
    """All that the page and the reader say of a folder."""
    page = write_report(folder).read_text("utf-8", "replace")
    return page + repr(read_results(folder))


def secretive(text: str) -> bool:
    return SECRET in text or base64.b64encode(PNG).decode()[:40] in text


WAYS = ("symbolic", "relative", "chain", "folder")
ONE_READER = ("trajectory.nc", "telemetry.nc")
"""Opened as `rates.nc` is."""


@pytest.mark.parametrize(
    ("name", "way"),
    [(name, way) for name in READ for way in WAYS[: 1 if name in ONE_READER else None]],
)
def test_no_link_leads_out_of_the_folder(name, way, folder):
    secret = outside(folder.parent, name)
    if way == "folder":
        (folder / name).symlink_to(folder.parent, target_is_directory=True)
    elif way == "chain":
        (folder / "step").symlink_to(secret)
        (folder / name).symlink_to("step")
    else:
        (folder / name).symlink_to(secret if way == "symbolic" else f"../{secret.name}")
    text = told(folder)
    assert not secretive(text) and f"{name} could not be read or shown" in text
    with pytest.raises(
        InputError, match="link" if name in ("rates.nc", "trajectory.nc") else "no attitude here"
    ):
        exported(folder)
    (folder / name).unlink()
    os.rename(secret, folder / name)  # negative control: as a file of its own it is read
    assert secretive(told(folder)) or name in ("timeline.toml",)


def test_a_marker_that_is_a_link_makes_no_results_folder(folder):
    (folder / MARKER).unlink()
    (folder.parent / "secret").write_text(SECRET)
    (folder / MARKER).symlink_to("../secret")
    with pytest.raises(InputError, match="not a results folder"):
        read_results(folder)


@pytest.mark.parametrize("way", ["external link", "external storage", "virtual"])
def test_no_netcdf_file_takes_data_from_another(way, folder):
    secret = folder.parent / "secret.h5"
    with h5py.File(secret, "w") as file:
        file["x"] = np.frombuffer(SECRET.encode(), dtype="u1")
    with h5py.File(folder / "rates.nc", "w") as file:
        if way == "external link":
            file["x"] = h5py.ExternalLink(str(secret), "x")
        elif way == "external storage":
            file.create_dataset(
                "x",
                (len(SECRET),),
                "u1",
                external=[(str(secret), secret.read_bytes().index(SECRET.encode()), 36)],
            )
        else:
            layout = h5py.VirtualLayout((len(SECRET),), "u1")
            layout[:] = h5py.VirtualSource(secret, "x", (len(SECRET),))
            file.create_virtual_dataset("x", layout)
    found = read_results(folder)
    assert not found.data and "takes data from another file" in " ".join(found.problems)
    with pytest.raises(InputError, match="takes data from another file"):
        exported(folder)


def test_odd_names_and_kinds_of_files_end_in_a_page(folder):
    rng = random.Random(1)
    names = []
    for k in range(60):
        name = f"{rng.choice(ODD)}{k}{rng.choice(['.nc', '.png', '.json', '.toml', ''])}"
        names.append(name)
        path = folder / name.encode("utf-8", "surrogateescape").decode("utf-8", "surrogateescape")
        kind = rng.randrange(4)
        if kind == 0:
            path.mkdir()
        elif kind == 1:
            os.mkfifo(path)
        else:
            path.write_bytes(b"" if kind == 2 else rng.randbytes(50))
    manifest = {
        "data": names,
        "figures": [{"file": n} for n in names],
        "tables": [{"file": n} for n in names],
    }
    (folder / MANIFEST).write_bytes(json.dumps(manifest).encode("utf-8", "surrogateescape"))
    found = read_results(folder)
    assert found.problems and all(printable(problem) == problem for problem in found.problems)
    assert "<script>1" not in write_report(folder).read_text("utf-8", "replace")


def test_very_many_damaged_files_end_soon(folder):
    began = time.monotonic()
    names = [f"{k:04d}.nc" for k in range(3 * MAX_FILES)]
    for name in names:
        (folder / name).touch()
    (folder / MANIFEST).write_text(json.dumps({"data": names}), "utf-8")
    problems = read_results(folder).problems
    assert len(problems) == 13 and f"more than {MAX_FILES} data" in problems[1]
    assert (
        problems[-1] == "Data listed after 0009.nc were not read." and time.monotonic() - began < 20
    )


@pytest.mark.parametrize("name", READ)
def test_sizes_are_looked_at_before_reading(name, folder):
    with open(folder / name, "wb") as file:
        file.truncate(10**12)  # takes no room on the disk
    assert any(problem.startswith(name) for problem in read_results(folder).problems)


@pytest.mark.parametrize("name", ["vehicle.toml", "timeline.toml"])
@pytest.mark.parametrize(
    "text",
    [
        "a = " + "[" * 50_000,
        "a = " + "[" * 400 + "]" * 400,
        "a." * 50_000 + "a = 1",
        "a = " + "9" * 5000,
    ],
)
def test_toml_that_is_a_bomb_is_named(name, text, folder):
    (folder / name).write_text(text, "utf-8")
    assert read_results(folder).problems[-1].startswith(f"{name} could not be read")


def test_an_attribute_of_another_kind_is_one_sentence(tmp_path, folder):
    """Every attribute that is read back; a file of others may have attributes of the same names, of any kind."""
    good = {"text": "2026-01-01T00:00:00Z", "number": 1.0}
    whole = {name: good[kind] for name, kind in KINDS.items()}
    path, wrong = tmp_path / "file.nc", {"text": np.array([1.0, 2.0]), "number": "text"}
    xr.Dataset(attrs=whole).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path, "file.nc", InputError).attrs["synthetic"] == 1  # negative control
    cases = [(name, wrong[kind]) for name, kind in KINDS.items()]
    for name, value in [*cases, ("synthetic", 7), ("seed", wrong["text"])]:
        xr.Dataset(attrs=whole | {name: value}).to_netcdf(path, engine="h5netcdf")
        with pytest.raises(
            InputError,
            match=f"^file.nc: this file was changed .* attribute {name} must be .*; make it again",
        ):
            read_groups(path, "file.nc", InputError, probe=False)
    foreign = {
        name: value for name, value in whole.items() if name not in ("kind", "sunspin_version")
    } | {"synthetic": "no"}
    xr.Dataset(attrs=foreign).to_netcdf(path, engine="h5netcdf")
    assert read_groups(path, "file.nc", InputError, probe=False)["/"].attrs["synthetic"] == "no"
    xr.Dataset(attrs={"kind": "rates", "synthetic": "no"}).to_netcdf(
        folder / "rates.nc", engine="h5netcdf"
    )
    assert "rates.nc: this file was changed" in told(folder)


def test_an_attribute_that_is_no_text_of_utf_8_is_refused(tmp_path):
    path = tmp_path / "file.nc"
    xr.Dataset(attrs={"title": "abcd"}).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path, "file.nc", InputError).attrs["title"] == "abcd"
    path.write_bytes(path.read_bytes().replace(b"abcd", b"ab\xefd"))
    with pytest.raises(InputError, match="file.nc: a name or an attribute in it is not UTF-8 text"):
        read_netcdf(path, "file.nc", InputError)


def test_the_unit_of_a_variable_is_ours_and_what_is_said_of_it_a_text(tmp_path):
    """Every unit that is read back, missing, of another kind or another unit; in files of others they are nobody's business."""
    path = tmp_path / "file.nc"

    def read(attrs, **about):
        xr.Dataset(
            {
                name: (
                    "x",
                    [0.0],
                    {"units": vocabulary().get(name, {"units": "1"})["units"]} | about,
                )
                for name in names
            },
            attrs=attrs,
        ).to_netcdf(path, engine="h5netcdf")
        return read_groups(path, "file.nc", InputError, probe=False)["/"]

    names = [*FIXED, "another"]
    assert set(read({"kind": "rates"}).data_vars) == set(names)  # negative control
    wrong = ("deg/s", 1.0, np.array([1.0, 2.0]), "")
    for k, name in enumerate(FIXED):
        names, why = [name], rf"changed .* variable {name} must be .*; make it again"
        with pytest.raises(InputError, match=f"file.nc: this file was {why}"):
            read({"kind": "rates"}, units=wrong[k % 4])
    assert read({"title": "of somebody else"}, units="deg/s")[name].attrs["units"] == "deg/s"
    names = ["another"]
    for label in sorted(LABELS):
        with pytest.raises(
            InputError, match=rf"attribute {label} of its variable another must be a text"
        ):
            read({"sunspin_version": "0.1"}, **{label: 7.0})
        assert read({"kind": "rates"}, **{label: "<script>\x1b[2J"})


@pytest.mark.parametrize("text", ["<script>alert(1)</script>", "$\\frac$", "\u202egnp", "x" * 5000])
def test_hostile_text_of_a_variable_is_escaped_on_the_page(text, folder):
    t = np.arange(3.0)
    about = {"units": "rad s-1", "long_name": text}
    data = {
        "omega_B": (("time", "axis"), np.ones((3, 3)), about),
        "y": ("time", t, {"units": text}),
    }
    made = xr.Dataset(
        data,
        {"time": ("time", t, {"units": "s", "long_name": text})},
        {"kind": "motion", "title": text},
    )
    write_netcdf(folder / "trajectory.nc", made)
    page = write_report(folder).read_text("utf-8")
    assert (
        "<script>alert" not in page
        and "\u202e" not in page
        and "trajectory.nc could not" not in page
    )


def test_how_a_stored_file_was_packed_is_not_handed_on(folder):
    """A fill value that is a text ended the export in a traceback."""
    path = folder / "rates.nc"
    xr.Dataset({"sigma_x": ("x", [0.5], {"units": "rad s-1"})}, attrs={"kind": "rates"}).to_netcdf(
        path, engine="h5netcdf"
    )
    with h5py.File(path, "r+") as file:
        file["sigma_x"].attrs["_FillValue"] = "a"
    read = read_groups(path, "rates.nc", InputError, probe=False)["/"]
    assert write_netcdf(folder / "again.nc", read).exists()
