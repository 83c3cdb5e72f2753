"""Files with one row for each packet: only rows that give a direction are counted, and messages name the reason."""

import json
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner

from sunspin.base.errors import InputError
from sunspin.cli import cli
from sunspin.cli.check import check
from sunspin.estimate.observe import observe, split_passes
from sunspin.estimate.settings import RATES
from sunspin.estimate.verdict import upper_text
from sunspin.output.check.samples import noise_lines
from sunspin.output.template import write_templates
from sunspin.telemetry.assess import assess
from sunspin.telemetry.reader import read_telemetry
from sunspin.vehicle import load_vehicle

PACKETS = (("px", "mx"), ("py", "my"), ("pz",))
"""Columns of the three packets of one time, 0.4 s apart."""


@pytest.fixture
def place(tmp_path):
    write_templates(tmp_path)
    vehicle = (tmp_path / "vehicle.toml").read_text().replace('= "refuse"', '= "flag"')
    (tmp_path / "vehicle.toml").write_text(vehicle)
    whole = pd.read_csv(tmp_path / "telemetry.csv", comment="#")
    moment = pd.to_datetime(whole["time_utc"])
    rows = []
    for k, columns in enumerate(PACKETS):
        part = whole[["time_utc", *columns]].copy()
        part["time_utc"] = (moment + pd.Timedelta(0.4 * k, "s")).dt.strftime("%FT%T.%fZ")
        rows.append(part)
    sparse = pd.concat(rows).sort_values("time_utc")
    sparse[whole.columns].to_csv(tmp_path / "sparse.csv", index=False)
    return tmp_path


def printed(place, name):
    done = CliRunner().invoke(check, [str(place / "vehicle.toml"), str(place / name)])
    return done.output


def test_check_counts_directions_and_not_rows(place):
    sparse, whole = printed(place, "sparse.csv"), printed(place, "telemetry.csv")
    assert "unambiguous" not in sparse and "even sampling" not in sparse
    assert "too few directions to estimate a rate: 0 of 120 samples give one" in sparse
    assert (
        "readings of 2 of 5 panels at most: set sample_span_s under [telemetry] to the time in which all are read"
        in sparse
    )
    # the advice: the file with one row for each time
    assert "rates up to 8.57 deg/s are unambiguous" in whole and "too few" not in whole


def test_rates_refuse_a_file_with_too_few_directions(place):
    words = ["rates", str(place / "vehicle.toml"), str(place / "sparse.csv")]
    done = CliRunner().invoke(cli, [*words, "--out", str(place / "results")])
    assert isinstance(done.exception, InputError) and not (place / "results").exists()
    said = str(done.exception)
    assert "too few Sun directions" in said and "2 of 5 panels at most" in said
    assert "max-rate" not in said


@pytest.mark.parametrize("spoil", ["empty column", "a third of the cells", "eclipse"])
def test_the_sampling_interval_counts_only_rows_with_a_direction(place, spoil):
    whole = pd.read_csv(place / "telemetry.csv", comment="#")
    if spoil == "empty column":
        whole["mx"] = np.nan
    elif spoil == "eclipse":
        dark = whole.iloc[-1:].copy()
        dark["time_utc"] = "2026-01-01T00:13:20.000Z"
        dark[["px", "mx", "py", "my", "pz"]] = 0.0
        whole = pd.concat([whole, dark])
    else:
        whole.loc[::3, "mx"] = np.nan
    whole.to_csv(place / "other.csv", index=False)
    assert "rates up to 8.57 deg/s are unambiguous" in printed(place, "other.csv")


def test_too_few_directions_because_of_shadow_are_explained_by_the_orbit(place):
    vehicle = load_vehicle(place / "vehicle.toml")
    found = assess(vehicle, read_telemetry(place / "telemetry.csv", vehicle))
    seen = observe(found)
    (panels,) = seen.obs.terms
    panels = replace(panels, sun_up=np.zeros(len(seen.obs)))
    dark = replace(seen, obs=replace(seen.obs, terms=(panels,)))
    with pytest.raises(InputError, match="by the orbit 40 are in the Earth's shadow") as error:
        split_passes(dark, None, RATES.passes)
    assert "dropped" not in str(error.value)


def test_counts_are_printed_without_unit_and_exponent(place):
    text = (place / "vehicle.toml").read_text()
    for old, new in (("power_W", "current_A"), ("noise = 0.02 ", "# noise = 0.02 ")):
        text = text.replace(old, new)
    counts = pd.read_csv(place / "telemetry.csv", comment="#")
    panels = ["px", "mx", "py", "my", "pz"]
    counts[panels] = (counts[panels].clip(lower=0) * 7000).round()
    counts.to_csv(place / "counts.csv", index=False)
    for scale, unit in (("scale = 1.0", ""), ("", ""), ("scale = 0.0001", " A")):
        (place / "counts.toml").write_text(text.replace("scale = 1.0", scale))
        vehicle = load_vehicle(place / "counts.toml")
        (line,) = noise_lines(assess(vehicle, read_telemetry(place / "counts.csv", vehicle)))
        assert "e+" not in line
        assert (" A, 3%" in line) == bool(unit)
        assert ("(in the unit of the readings)" in line) != bool(unit)


def test_table_summary_and_netcdf_agree_on_a_body_at_rest(tmp_path):
    """Few noisy samples of a body at rest: the speed has an upper limit, and no file calls the pass decided."""
    write_templates(tmp_path)
    rng, rows = np.random.default_rng(5), ["time_utc,px,mx,py,my,pz"]
    still = np.array([2.4, 0.0, 3.1, 0.0, 1.0])
    for k in range(6):
        light = np.maximum(still + 0.4 * (still > 0) * rng.normal(size=5), 0.0)
        cells = ",".join(f"{x:.3f}" for x in light)
        rows.append(f"2026-01-01T00:0{k // 4}:{15 * (k % 4):02d}Z,{cells}")
    (tmp_path / "still.csv").write_text("\n".join(rows) + "\n")
    text = (tmp_path / "vehicle.toml").read_text().replace("noise = 0.02 ", "noise = 0.4 ")
    text = text[: text.index("[[wheel]]")] + text[text.index("# [[leg]]") :]  # faster without
    (tmp_path / "vehicle.toml").write_text(text)
    out = tmp_path / "still"
    words = ["rates", str(tmp_path / "vehicle.toml"), str(tmp_path / "still.csv")]
    quick = ["--no-column-tests", "--acceleration-noise", "1e-5", "--out", str(out)]
    done = CliRunner().invoke(cli, [*words, *quick])
    assert done.exit_code == 0, done.exception
    table = pd.read_csv(out / "passes.csv", comment="#").iloc[0]
    numbers = json.loads((out / "summary.json").read_text())["passes"][0]
    with xr.open_dataset(out / "rates.nc") as result:
        decided = bool(result["decided"].values[0])
        known = bool(result["constrained_speed"].values[0])
    assert not known and not decided
    assert not table["decided"] and not numbers["decided"] and not table["constrained_speed"]
    limit = f"speed below {upper_text(table['speed_below_deg_s'])} deg/s (95 %)"
    assert limit in numbers["why_not_decided"] and limit in done.output
    assert table["why_not_decided"] == numbers["why_not_decided"]
    assert "(95 %)" in done.output
    assert "0 of 1 passes decided" in done.output and "decided, coarse" not in done.output


@pytest.mark.parametrize("first", [False, True])
def test_rows_of_columns_that_are_not_used_are_no_samples(place, first):
    """Temperatures at times of their own: they neither shorten the sampling interval nor count as samples with lost readings."""
    whole = pd.read_csv(place / "telemetry.csv", comment="#")
    moment = pd.to_datetime(whole["time_utc"]) + pd.Timedelta(-5 if first else 5, "s")
    hot = pd.DataFrame({"time_utc": moment.dt.strftime("%FT%TZ"), "temp": 21.0})
    lost = pd.DataFrame({"time_utc": ["2026-01-01T00:20:00Z"]})  # no reading of anything
    pd.concat([whole, hot, lost]).to_csv(place / "hot.csv", index=False)
    vehicle = load_vehicle(place / "vehicle.toml")
    samples = read_telemetry(place / "hot.csv", vehicle)
    plain = read_telemetry(place / "telemetry.csv", vehicle)
    assert samples.attrs["rows_of_others"] == len(hot)
    assert samples.attrs["epoch_utc"] == plain.attrs["epoch_utc"]
    np.testing.assert_allclose(samples["time"][:-1], plain["time"], atol=1e-6)
    np.testing.assert_allclose(samples["power_W"][:-1], plain["power_W"])
    assert samples["flag"].values[-1] != 0 and "temp" in samples.attrs["unused_columns"]
    output = printed(place, "hot.csv")
    assert f"{len(hot)}  rows left out: only columns that are not used have a value" in output
    assert "1  flagged" in output


def test_rows_with_readings_of_any_sensor_are_samples(place):
    """A packet of the gyro that the vehicle file names is kept, and joins the panels with a span."""
    whole = pd.read_csv(place / "telemetry.csv", comment="#")
    moment = pd.to_datetime(whole["time_utc"]) + pd.Timedelta(1, "s")
    rate = dict.fromkeys(("gyro_x", "gyro_y", "gyro_z"), 1.0)
    packets = pd.DataFrame({"time_utc": moment.dt.strftime("%FT%TZ"), **rate})
    pd.concat([whole, packets]).to_csv(place / "gyro.csv", index=False)
    text = (place / "vehicle.toml").read_text()
    gyro = f"[gyro]\ncolumns = {list(rate)}\nscale_rad_s = 0.0174533\nnoise_rad_s = 8e-4\n"
    text = text.replace("[disturbance]", f"{gyro}[disturbance]")
    (place / "gyro.toml").write_text(text)
    samples = read_telemetry(place / "gyro.csv", load_vehicle(place / "gyro.toml"))
    assert "rows_of_others" not in samples.attrs
    assert samples.sizes["time"] == len(whole) + len(packets)
