"""Tables of results as `numpy.genfromtxt`, which knows no quotation marks, and pandas read them."""

import numpy as np
import pandas as pd
import pytest

import sunspin as ss
from sunspin.base.tables import read_table
from sunspin.output.folder import Contents, table_text, write_data, write_manifest
from sunspin.output.kind import Table
from sunspin.telemetry.decoders.skcube import Beacons, beacons_csv


def columns(path):
    """The columns of a table as both programs read it, once they agree on its size."""
    frame = pd.read_csv(path, comment="#")
    cells = np.genfromtxt(path, delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert len(np.atleast_1d(cells)) == len(frame) and len(cells.dtype.names) == len(frame.columns)
    return cells, frame


def test_texts_in_a_table_hold_no_separator(tmp_path):
    names = ['panel "x", outer', "no mark", "panel #2,\nagain"]
    frame = pd.DataFrame({"name": names, "value": [1.5, -2.0, 3.25], "sure": [True, False, True]})
    table = Table("t", frame, comment="time_s from 2026-01-01; body axes, N: z to the Sun, local")
    contents = Contents(tables=[table], synthetic=True)
    write_data(tmp_path, contents)
    write_manifest(tmp_path, {}, contents)
    cells, read = columns(tmp_path / "t.csv")
    assert cells["name"].tolist() == read["name"].tolist()
    assert read["name"].tolist() == ["panel 'x'; outer", "no mark", "panel No.2; again"]
    assert cells["value"].tolist() == [1.5, -2.0, 3.25]
    assert cells["sure"].tolist() == frame["sure"].tolist()
    assert names == frame["name"].tolist()  # the table itself is as it was
    # sentences keep their commas, in quotation marks
    prose = Table("t", pd.DataFrame({"sentence": ["first, second"]}), prose=True)
    assert table_text(prose, False) == 'sentence\n"first, second"\n'


def test_times_far_from_their_epoch_keep_their_digits(tmp_path):
    """Days of a spreadsheet count from 1899, ephemeris time from 2000: nine digits are 10 s and 1 s."""
    time = [3982629600.25, 826783200.125, np.nan]
    frame = pd.DataFrame({"time_s": time, "speed_rad_s": [1 / 3, 1e-9, 2.0]})
    (tmp_path / "t.csv").write_text(table_text(Table("t", frame), False), "utf-8")
    cells, read = columns(tmp_path / "t.csv")
    np.testing.assert_array_equal(cells["time_s"], time)
    np.testing.assert_array_equal(read["time_s"], time)
    np.testing.assert_allclose(read["speed_rad_s"], frame["speed_rad_s"], rtol=1e-8)


def test_the_tables_of_sun_are_read_by_numpy_and_pandas(tmp_path, undrawn):
    vehicle, telemetry = ss.load_example("cubesat")
    folder = ss.sun_directions(vehicle, telemetry).sunspin.save(tmp_path / "sun")
    cells, frame = columns(folder / "sun.csv")
    assert np.allclose(cells["sun_x_B"], frame["sun_x_B"], rtol=1e-12, equal_nan=True)
    assert len(frame) == 40
    last = (folder / "sun.csv").read_text("utf-8").splitlines()[-2:]
    assert last[0] == "# synthetic telemetry" and last[1].startswith("# time_s from 2026")


def test_decoded_beacons_of_a_station_with_commas_are_read_by_numpy(tmp_path):
    rows = {"OTHER": [(1.5e9, "OK1ABC, Prague #2", ("00ff",)), (1.5e9 + 1, "me", ("01",))]}
    (tmp_path / "b.csv").write_text(beacons_csv(Beacons(rows, {}), "OTHER"), "utf-8")
    cells, frame = columns(tmp_path / "b.csv")
    assert frame["station"].tolist() == ["OK1ABC; Prague No.2", "me"]
    assert cells["station"].tolist() == frame["station"].tolist()


@pytest.mark.parametrize("place", [0, 1, 2, 3])
def test_comments_in_telemetry_can_be_on_any_line(place, tmp_path):
    lines = ["time_s,px", "0,1.5", "10,2.5"]
    lines.insert(place, "# synthetic: made up, for tests")
    (tmp_path / "t.csv").write_text("\n".join(lines) + "\n", "utf-8")
    table = read_table(tmp_path / "t.csv")
    assert table.comments == ["synthetic: made up, for tests"]
    assert table.numbers(["time_s", "px"]).tolist() == [[0, 1.5], [10, 2.5]]
    assert table.cells.index[-1] == (3 if place == 3 else 4)  # the line in the file
