"""The study's parts together: order, ids, figures; telemetry that does not hold everything."""

import re
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from sunspin.cases import load_case
from sunspin.errors import InputError, TelemetryError
from sunspin.study import inputs
from sunspin.study import rebound as rb
from sunspin.study import reproduce as rp
from sunspin.tell import pictures
from sunspin.tell.reproduction import conclusions

CASE = load_case("philae")
QUICK = ("phases", "mechanics", "level_set", "descent", "touchdown", "worth", "inputs", "contradictions")
"""Parts that take seconds on a coarse grid; the others have tests of their own."""


def without(*phases: str) -> xr.Dataset:
    data = CASE.telemetry
    return data.isel(time=np.flatnonzero(~np.isin(data["phase"].values, phases)))


@pytest.fixture
def quick(monkeypatch):
    monkeypatch.setattr(rp, "PARTS", tuple(part for part in rp.PARTS if part.name in QUICK))
    return lambda case: rp.compute(case, coarser=25)


def test_telemetry_without_the_descent_reproduces_the_rest_and_says_so(quick):
    found = quick(rb.with_telemetry(CASE, without("descent", "deployment")))
    assert list(found.missing) == ["descent"] and "no sample before the first touchdown" in found.missing["descent"]
    assert set(found.rows_by_part) == set(QUICK) - {"descent"}
    assert any(said.startswith("Section 3.1: the descent: not reproduced") for said in conclusions(found))
    ids = [row.id for row in found.rows]
    assert len(ids) == len(set(ids)) and not {"descent_E", "descent_unique"} & set(ids)
    sheets = [sheet for part, make in pictures.SHEETS if part in found.parts for sheet in make(found, found.parts[part])]
    names = {sheet.name for sheet in sheets}
    assert "fig10_11_descent" not in names and {"fig03_measured", "fig09_lines", "fig12_touchdown", "worth"} <= names
    assert all(sheet.alt and sheet.caption for sheet in sheets)


def test_telemetry_without_the_first_rebound_is_refused_at_once(quick):
    with pytest.raises(TelemetryError, match="between first touchdown and collision"):
        quick(rb.with_telemetry(CASE, without("first_rebound")))


def test_a_case_without_twins_says_how_to_make_them(quick, monkeypatch):
    monkeypatch.setattr(rp.worth, "SHIPPED", "nothing.json")
    inputs = rp.Inputs(CASE, rp.sun_directions(CASE.vehicle, CASE.telemetry), done={"level_set": None})
    with pytest.raises(InputError, match="sunspin worth"):
        rp._worth(inputs)


def test_every_figure_of_the_paper_has_a_sheet_in_its_order():
    parts = [name for name, _ in pictures.SHEETS]
    assert set(parts) <= {part.name for part in rp.PARTS}
    order = ["phases", "mechanics", "sensitivity", "level_set", "descent", "precession", "touchdown", "landing"]
    assert [name for name in dict.fromkeys(parts) if name in order] == order


def test_every_published_figure_has_a_row_somewhere():
    """Rows are made by the parts; what they take over is listed, and no key is in neither."""
    folder = Path(rp.__file__).parent
    text = "".join(path.read_text("utf-8") for path in folder.glob("*.py") if path.name != "inputs.py")
    pattern = r'case, "{0}"|Row\(\s*"{0}"'
    made = {key for key in CASE.published if re.search(pattern.format(key), text)} | {f"line_L{k}" for k in range(1, 5)}
    sun = rp.sun_directions(CASE.vehicle, CASE.telemetry)
    checked = {row.id for row in inputs.rows(inputs.Taken(CASE, sun))}
    assert set(CASE.published) <= made | checked
    assert not made & set(inputs.TAKEN)
