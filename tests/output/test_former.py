"""A result of the former version is refused in one sentence that says which name is new; nothing is written."""

import json
import subprocess
import sys

import pytest
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.output.folder import MANIFEST, MARKER, write_netcdf
from sunspin.output.kind import RENAMED

FORMER = xr.Dataset(
    {
        "weight": (("pass_id", "mode"), [[1.0]]),
        "wiring": ("pass_id", ["as_stated"]),
        "model_weight": ("pass_id", [1.0]),
        "informed_x": ("pass_id", [True]),
    },
    {"time": ("time", [0.0, 1.0], {"units": "s"})},
    {"kind": "rates"},
)


@pytest.mark.parametrize("command", ["report", "export", "compare"])
def test_a_folder_of_the_former_version_is_refused(command, tmp_path):
    write_netcdf(tmp_path / "rates.nc", FORMER)
    passes = [{"pass_id": 0, "wiring": "as_stated", "modes": [{"mode": 0, "weight": 1.0}]}]
    texts = {
        MANIFEST: {"data": ["rates.nc"], "figures": [], "tables": []},
        "summary.json": {"passes": passes},
    }
    for name, content in texts.items():
        (tmp_path / name).write_text(json.dumps(content))
    (tmp_path / MARKER).write_text("rates\n")
    before = sorted(tmp_path.rglob("*"))
    more = {"report": [], "export": ["--out", "new"], "compare": ["."]}[command]
    program = [sys.executable, "-m", "sunspin.cli", command, ".", *more]
    done = subprocess.run(program, cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 2 and done.stderr.count("\n") == 1, done.stderr
    assert "`wiring` is `columns_checked` now" in done.stderr
    assert done.stderr.endswith("; run the command again\n")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_dataset_of_the_former_version_says_which_names_are_new():
    with pytest.raises(InputError, match="written by an earlier version") as error:
        FORMER.sunspin.summary()
    for name in ("weight", "mode", "informed_x", "wiring", "model_weight"):
        assert f"`{name}` is `{RENAMED[name]}` now" in str(error.value)
    draws = xr.Dataset({"mode_id": (("chain", "draw"), [[0, 0]])})
    tree = xr.DataTree.from_dict({"posterior": draws})
    tree.attrs["kind"] = "posterior"
    with pytest.raises(InputError, match="`mode_id` is `solution_id` now"):
        tree.sunspin.summary()
