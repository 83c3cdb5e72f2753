"""Fill values in the columns of a gyro or a magnetometer are not used as readings."""

import numpy as np
import pandas as pd
import pytest

import sunspin as ss
from sunspin.vehicle.file import parse_vehicle

VEHICLE = """
name = "cube"
[telemetry]
time_column = "t"
time_format = "unix"
[gyro]
columns = ["gx", "gy", "gz"]
scale_rad_s = 0.0174533
noise_rad_s = 1e-3
[magnetometer]
columns = ["mx", "my", "mz"]
noise = 1.0
"""


def read(tmp_path, rates_deg_s, field):
    columns = {"t": 1.7e9 + 10.0 * np.arange(len(field))}
    columns |= {f"g{axis}": rates_deg_s[:, k] for k, axis in enumerate("xyz")}
    columns |= {f"m{axis}": field[:, k] for k, axis in enumerate("xyz")}
    pd.DataFrame(columns).to_csv(tmp_path / "t.csv", index=False)
    return ss.read_telemetry(tmp_path / "t.csv", parse_vehicle(VEHICLE, "cube"))


@pytest.mark.parametrize("fill", [-999, 999, 65535, 32767, -32768])
def test_fill_values_of_a_gyro_or_magnetometer_are_no_readings(tmp_path, fill):
    """A true reading as large is kept: a field in nT reaches 30,000 and more, and 32767 is one of its values."""
    rng = np.random.default_rng(0)
    rates, field = rng.normal(0, 3, (40, 3)), np.round(rng.uniform(-45e3, 45e3, (40, 3)))
    field[5] = [32767, -999, 999]
    wrong = [4, 9, 21]
    for whole_row in (False, True):
        rates[wrong, : 3 if whole_row else 1] = fill
        data = read(tmp_path, rates, field)
        known = np.isfinite(data["gyro_B"].values)
        assert not known[wrong, 0].any() and known[wrong, 2].all() == (not whole_row)
        assert np.delete(known, wrong, axis=0).all()
        assert np.isfinite(data["field_B"].values).all()
