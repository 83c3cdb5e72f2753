"""Results folders that somebody changed: changed files are named, and no file outside is read."""

from __future__ import annotations

import base64
import hashlib
import json
import shutil

import h5py
import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.base.errors import InputError
from sunspin.base.netcdf import read_groups, read_netcdf
from sunspin.output import folder as folders
from sunspin.output.export import read_attitude_data as exported
from sunspin.output.folder import MANIFEST, MARKER, write_netcdf
from sunspin.output.report import read, write_report
from sunspin.output.report.read import read_results

SECRET = "a word that stands nowhere else 7f3b"
HOSTILE = ("<script>alert(1)</script>", "$\\frac$", "\u202egnp", "x" * 5000)


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """The results folder of a motion of the example, with its vehicle and a figure."""
    vehicle, _ = ss.load_example()
    run = ss.propagate(vehicle, [0.02, -0.05, 0.03], [0.0, 0.6, 0.8], 0.0, np.arange(0, 100, 2.5))
    return run.sunspin.save(tmp_path_factory.mktemp("of") / "results", vehicle="philae")


@pytest.fixture
def folder(written, tmp_path):
    return shutil.copytree(written, tmp_path / "results")


def page_of(folder) -> str:
    return write_report(folder).read_text("utf-8", "replace")


def test_an_unchanged_results_folder_is_shown_whole(folder):
    assert read_results(folder).problems == [] and "trajectory.nc" not in exported(folder)[0].attrs
    files = {path.name for path in folder.iterdir()} - {MANIFEST}
    assert {*json.loads((folder / MANIFEST).read_text())["sha256"]} == files


def change(path, way) -> None:
    """Change a file in this way; if it becomes a link, then one to a file with the secret."""
    content, secret = path.read_bytes(), path.parents[1] / "secret"
    secret.write_text(SECRET)
    path.unlink()
    if way == "link":
        path.symlink_to(secret)
    elif way == "folder":
        path.mkdir()
    elif way != "gone":
        half = len(content) // 2
        changed = {"cut": content[:half], "empty": b"", "another": SECRET.encode()}
        changed["a byte"] = content[:half] + bytes([content[half] ^ 1]) + content[half + 1 :]
        path.write_bytes(changed[way])


@pytest.mark.parametrize("way", ["a byte", "cut", "empty", "another", "link", "folder", "gone"])
def test_a_changed_file_is_named_and_the_rest_is_shown(way, folder):
    manifest = json.loads((folder / MANIFEST).read_text("utf-8"))
    figure, kept = manifest["figures"][0]["file"], read_results(folder)
    names = ["summary.json", "vehicle.toml", "trajectory.nc", figure]
    for name in names:
        change(folder / name, way)
    results, text = read_results(folder), page_of(folder)
    assert {problem.split(" could not")[0] for problem in results.problems} == set(names)
    assert len(results.problems) == 4 and len(results.figures) == len(kept.figures) - 1
    for name in names:
        assert f"{name} could not be read or shown" in text
    assert SECRET not in text and base64.b64encode(SECRET.encode()).decode()[:40] not in text
    with pytest.raises(InputError, match="changed or damaged|not a regular file"):
        exported(folder)


def test_a_folder_whose_marker_is_a_link_is_no_results_folder(folder):
    (folder / MARKER).unlink()
    (folder.parent / "secret").write_text(SECRET)
    (folder / MARKER).symlink_to("../secret")
    with pytest.raises(InputError, match="not a results folder"):
        read_results(folder)


NO_DIGESTS = '{"data": [], "figures": [], "tables": []}'


@pytest.mark.parametrize("text", ["[]", "3", "{", '{"data": 3}', "[" * 10_000, NO_DIGESTS])
def test_a_manifest_of_another_form_is_refused_in_one_sentence(text, folder):
    (folder / MANIFEST).write_text(text, "utf-8")
    for reader in (read_results, exported):
        with pytest.raises(InputError, match="is damaged; run the"):
            reader(folder)


@pytest.mark.parametrize("text", ["[1]", "3", "{", "[" * 10_000])
def test_a_summary_that_is_no_json_object_is_named(text, folder):
    manifest = json.loads((folder / MANIFEST).read_text("utf-8"))
    manifest["sha256"]["summary.json"] = hashlib.sha256(text.encode()).hexdigest()
    (folder / MANIFEST).write_text(json.dumps(manifest), "utf-8")
    (folder / "summary.json").write_text(text)
    assert "summary.json could not be read or shown" in page_of(folder)


def test_a_large_drawing_is_shown_as_png(written, tmp_path, monkeypatch):
    run, _ = exported(written)
    monkeypatch.setattr(folders, "LARGEST_SVG_BYTES", 1000)
    folder = run.sunspin.save(tmp_path / "results")
    figures = read_results(folder).figures
    assert figures and all(figure.name.endswith(".png") for figure in figures)


def test_manifest_entries_outside_the_folder_are_not_read(folder):
    (folder.parent / "secret").write_text(SECRET)
    manifest = json.loads((folder / MANIFEST).read_text("utf-8"))
    odd = [3, None, "../secret", "/etc/hostname", "a\nb", {}, {"file": "../secret"}, "x" * 999]
    changed = {"data": odd, "figures": odd, "tables": odd}
    digests = manifest["sha256"] | {"../secret": "0"}
    (folder / MANIFEST).write_text(json.dumps(manifest | changed | {"sha256": digests}))
    results = read_results(folder)
    assert len(results.problems) == 3 * len(odd) and not results.data
    assert SECRET not in page_of(folder)


def test_data_larger_than_the_limit_are_named_and_not_read(folder, monkeypatch):
    monkeypatch.setattr(read, "MAX_DATA_BYTES", 100)
    assert "trajectory.nc could not" in read_results(folder).problems[0]


def test_hostile_text_of_a_variable_is_escaped_on_the_page(written, tmp_path, framed):
    run, _ = exported(written)
    for name, text in zip(("omega_B", "sun_B", "momentum_B", "B_from_N"), HOSTILE, strict=True):
        run[name] = run[name].assign_attrs(units="rad s-1", long_name=text)
    folder = run.assign_attrs(title=" ".join(HOSTILE)).sunspin.save(tmp_path / "results")
    page = page_of(folder)
    assert read_results(folder).problems == []
    assert "<script>alert" not in page and "\u202e" not in page


@pytest.mark.parametrize("way", ["external link", "external storage", "virtual"])
def test_netcdf_files_with_external_data_are_refused(way, tmp_path):
    secret, path = tmp_path / "secret.h5", tmp_path / "file.nc"
    with h5py.File(secret, "w") as file:
        file["x"] = np.frombuffer(SECRET.encode(), dtype="u1")
    with h5py.File(path, "w") as file:
        if way == "external link":
            file["x"] = h5py.ExternalLink(str(secret), "x")
        elif way == "external storage":
            place = secret.read_bytes().index(SECRET.encode())
            file.create_dataset("x", (len(SECRET),), "u1", external=[(str(secret), place, 36)])
        else:
            layout = h5py.VirtualLayout((len(SECRET),), "u1")
            layout[:] = h5py.VirtualSource(secret, "x", (len(SECRET),))
            file.create_virtual_dataset("x", layout)
    with pytest.raises(InputError, match="takes data from another file"):
        read_netcdf(path, "file.nc", InputError)


def test_an_attribute_that_is_not_utf_8_is_refused(tmp_path):
    path = tmp_path / "file.nc"
    xr.Dataset(attrs={"title": "abcd"}).to_netcdf(path, engine="h5netcdf")
    assert read_netcdf(path, "file.nc", InputError).attrs["title"] == "abcd"
    path.write_bytes(path.read_bytes().replace(b"abcd", b"ab\xefd"))
    with pytest.raises(InputError, match="file.nc: a name or an attribute in it is not UTF-8 text"):
        read_netcdf(path, "file.nc", InputError)


def test_saved_files_do_not_keep_the_packing_of_their_source(tmp_path):
    """A fill value that is a text ended the export in a traceback."""
    path = tmp_path / "rates.nc"
    xr.Dataset({"sigma_x": ("x", [0.5])}).to_netcdf(path, engine="h5netcdf")
    with h5py.File(path, "r+") as file:
        file["sigma_x"].attrs["_FillValue"] = "a"
    data = read_groups(path, "rates.nc", InputError, probe=False)["/"]
    assert write_netcdf(tmp_path / "again.nc", data).exists()
