"""Lines on panels that `sunspin check` prints: sides, illumination patterns, a wrong unit."""

import json

import numpy as np
import pytest
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.cli.values import parse_limits, select_interval
from sunspin.output.check.samples import _count_lit_sides
from sunspin.output.kinds.panels import SETS, health_lines
from sunspin.telemetry.synthetic import telemetry_dataset
from sunspin.vehicle.file import parse_vehicle
from tests.support.vehicles import FACES
from validation.border import sunspin


def satellite(each: int, scale: float = 1.0) -> str:
    """So many panels on each of six faces, read in W."""
    names = {f"{face}{k}": normal for face, normal in FACES.items() for k in range(each)}
    form = '[[panel]]\nname = "{}"\nnormal_B = {}\ngain_W = 2.0\n'
    panels = "".join(form.format(*each) for each in names.items())
    columns = "".join(f'"{name}" = "{name}"\n' for name in names)
    return f'name = "v"\n{panels}[telemetry]\nscale = {scale}\nnoise = 0.01\n[telemetry.columns]\n{columns}'


def readings(each: int, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(each)
    sun = rng.normal(size=(n, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    power = np.repeat(2.0 * np.clip(sun @ np.array(list(FACES.values())).T, 0, None), each, axis=1)
    return sun, np.clip(power + 0.01 * rng.normal(size=power.shape), 0, None)


@pytest.mark.parametrize("each", [1, 2, 3])
def test_check_counts_panels_of_one_face_as_one_side(each):
    craft = parse_vehicle(satellite(each), "v.toml")
    sun, power = readings(each)
    lit = lit_sides(craft, power, sun, 0.01)
    assert np.all(lit[np.abs(sun).min(axis=1) > 0.05] == 3) and lit.max() <= 3


def lit_sides(craft, power, sun, noise):
    """Return how many sides are lit in each sample of panels with this noise in W."""
    samples = telemetry_dataset(craft, np.arange(len(sun)), power, sun, "2026-01-01T00:00:00Z", {})
    quality = xr.Dataset({"noise": ("panel", np.full(power.shape[1], noise))})
    return _count_lit_sides(craft, samples, quality.assign_attrs(albedo=0.01, full_sun=1.0))


def test_check_counts_no_side_as_lit_by_noise_alone():
    craft = parse_vehicle(satellite(1), "v.toml")
    dark = np.abs(0.05 * np.random.default_rng(0).normal(size=(40, 6)))
    lit = lit_sides(craft, dark, np.tile([1.0, 0.0, 0.0], (40, 1)), 0.05)
    assert np.count_nonzero(lit) <= 3  # at two hundredths of full Sun, 0.04 W, nearly all were


@pytest.mark.parametrize("count", [1, SETS, SETS + 1, 500])
def test_check_names_the_most_frequent_illumination_patterns_and_counts_the_others(count):
    seen = {f"set {k}": k + 1 for k in range(count)}
    told = {"impossible": seen, "explanations": [], "noise_probability": {"set 0": 0.0}}
    (line,) = health_lines(told)
    assert len(line) < 400
    assert f"set {count - 1} ({count})" in line
    assert "probability of at most 0" not in line
    assert (f"and {count - SETS} other sets" in line) == (count > SETS)


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_check_reports_no_directions_gains_or_sides_if_the_unit_is_wrong(
    scale, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    craft = satellite(2, scale)
    (tmp_path / "v.toml").write_text(craft)
    names = [line.split('"')[1] for line in craft.splitlines() if line.startswith('"')]
    cells = [",".join(f"{x:.4f}" for x in row) for row in readings(2)[1]]
    rows = [f"2026-01-01T00:{k // 6:02d}:{k % 6}0Z,{row}" for k, row in enumerate(cells)]
    (tmp_path / "t.csv").write_text("\n".join([",".join(["time", *names]), *rows]))
    said = sunspin("check", "v.toml", "t.csv").out
    words = ("direction determined", "gains:", "faces lit", "impossible")
    assert ("WRONG UNIT" in said) == (scale != 1.0) == ("not reported until" in said)
    assert scale == 1.0 or not any(word in said for word in words)
    assert scale != 1.0 or ("direction determined" in said and "faces lit:" in said)
    if scale != 1.0:
        about = json.loads(sunspin("check", "v.toml", "t.csv", "--json").out)
        assert about["telemetry"]["panels_misread"]


def test_rates_posterior_and_scan_select_the_same_time_range():
    attrs = {"epoch_utc": "2026-01-01T12:00:00Z"}
    samples = xr.Dataset(coords={"time": np.arange(0, 600, 60.0)}, attrs=attrs)
    assert parse_limits(samples, "2026-01-01T12:01", "180") == (60.0, 180.0)
    assert parse_limits(samples, None, None) == (None, None)
    part = select_interval(samples, "2026-01-01T12:01", "180")
    assert part["time"].values.tolist() == [60.0, 120.0, 180.0]
    with pytest.raises(InputError, match="--from takes s from the epoch, or UTC"):
        parse_limits(samples, "soon", None)
