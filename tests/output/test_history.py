"""The history of many passes: what it reads, its trend and jumps, its picture and files."""

from __future__ import annotations

import re
import shutil

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from click.testing import CliRunner
from scipy.stats import multivariate_normal

import sunspin as ss
from sunspin.cli import cli
from sunspin.output.history import _whiten, fit_trend
from sunspin.output.kinds.history import history_summary
from sunspin.output.report.page import write_report
from sunspin.vehicle.file import parse_vehicle
from tests.output.test_results import directions

VEHICLE = """
name = "a spinner"
[body]
inertia_kg_m2 = [[0.02, 0, 0], [0, 0.03, 0], [0, 0, 0.04]]
[telemetry]
time_column = "t"
[sun_vector]
columns = ["x", "y", "z"]
sigma_rad = 0.01
"""

SPIN = np.radians(1.2)
"""Rate about z of the simulated passes, rad/s."""


@pytest.fixture(scope="module")
def result():
    """Return rates of a body that spins about z, 60 degrees from the Sun, whose inertia is known."""
    t = np.arange(0.0, 600.0, 20.0)
    phase = SPIN * t
    sun = np.stack([np.cos(phase), -np.sin(phase), np.full(t.size, np.tan(np.pi / 6))], axis=1)
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    vehicle = parse_vehicle(VEHICLE, "test")
    return ss.rates(vehicle, directions(t, sun), max_rate_rad_s=np.radians(3.0))


def save(result, folder, day, speed_factor=1.0, decided=True, name="a spinner", text=VEHICLE):
    """Save the rates, without figures, as if the pass had been on another day and the body had had another speed."""
    utc = np.datetime64("2026-03-01T12:00:00", "ms") + np.timedelta64(round(day * 86_400_000), "ms")
    changed = result.copy(deep=True).assign_attrs(vehicle=name)
    for variable in ("speed_median", "speed_low", "speed_high", "omega_x", "omega_y", "omega_z"):
        changed[variable] = changed[variable] * speed_factor
    changed["omega_B"] = changed["omega_B"] * speed_factor
    for variable, minutes in (("utc_start", -5), ("utc_at", 0), ("utc_end", 5)):
        at = f"{utc + np.timedelta64(minutes, 'm')}Z"
        changed[variable] = changed[variable].dims, np.full(changed[variable].shape, at)
    changed["decided"] = changed["decided"] & decided
    vehicle = folder.parent / f"{folder.name}.toml"
    vehicle.parent.mkdir(exist_ok=True)
    vehicle.write_text(text.replace("a spinner", name), "utf-8")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sunspin.output.result.draw", lambda *_: [])
        changed.sunspin.save(folder, vehicle=vehicle)
    return folder


@pytest.fixture(scope="module")
def week(result, tmp_path_factory):
    """Return a folder with the results of eight days, on which the body slows down; day 3 is not decided."""
    folder = tmp_path_factory.mktemp("of") / "week"
    for day in range(8):
        save(result, folder / f"{day}", day, 1 - 0.05 * day, decided=day != 3)
    return folder


@pytest.fixture(scope="module")
def history(week):
    """Return the history of the week."""
    return ss.history([week])


def lines_of(data) -> str:
    return "\n".join(data.sunspin.summary().lines)


def test_passes_of_several_folders_are_in_order_of_time_with_axis_and_momentum(week):
    data, speed = ss.history([week / day for day in "201"]), SPIN * np.array([1.0, 0.95, 0.9])
    np.testing.assert_allclose(data["time"], [0.0, 86_400.0, 172_800.0])
    assert data["decided"].all()
    np.testing.assert_allclose(np.abs(data["spin_axis_B"].values[:, 2]), 1.0, atol=1e-3)
    np.testing.assert_allclose(data["speed_median"], speed, rtol=0.02)
    np.testing.assert_allclose(data["momentum"], 0.04 * speed, rtol=0.02)
    np.testing.assert_allclose(np.degrees(data["momentum_sun_rad"]), 60.0, atol=1.5)
    assert np.isnan(data["momentum_J2000"]).all() and np.isnan(data.attrs["trend"])


def test_axes_that_are_not_known_are_not_shown_and_the_momentum_has_the_error_of_the_rate(week):
    """A point with an error of hundreds of degrees is no direction."""
    data = ss.history([week / "0"])
    sigma = float(data["omega_sigma_B"][0, 2])  # the body spins about z
    np.testing.assert_allclose(data["momentum_sigma"], 0.04 * sigma, rtol=0.3)
    vague = data.assign(spin_axis_sigma_rad=data["spin_axis_sigma_rad"] * 0 + 6.0)
    assert "deg/s  about (" in data.sunspin.summary().lines[-1]
    assert "deg/s  about an unknown axis" in vague.sunspin.summary().lines[-1]
    axes = vague.sunspin.plot().axes[1]
    assert np.isnan([line.get_ydata()[0] for line in axes.get_lines()]).all()


def test_a_later_pass_that_was_estimated_alone_keeps_its_momentum(result, tmp_path):
    """`rates --pass 3` leaves one pass, whose number is 3 and whose place in the result is 0."""
    data = ss.history([save(result.assign_coords(pass_id=[3]), tmp_path / "alone", 0.0)])
    np.testing.assert_allclose(data["momentum"], 0.04 * SPIN, rtol=0.02)
    data["speed_sigma"] = data["speed_sigma"] * 0 + np.radians(2e-4)  # printed with two digits
    lines = "\n".join(data.sunspin.summary().lines)
    assert ": 1 pass from" in lines and "± 0.00020 deg/s" in lines


def test_the_history_is_summarised_drawn_saved_and_shown_on_a_page(week, history, tmp_path, framed):
    out = tmp_path / "history"
    done = CliRunner().invoke(cli, ["history", str(week), "--out", str(out)])
    assert done.exit_code == 0, done.output
    assert "8 passes from 2026-03-01T12:00 to 2026-03-08T12:00 UTC, 7 decided" in done.output
    assert "it slows down, by half in" in done.output and "not decided" in done.output
    table = pd.read_csv(out / "history.csv", comment="#")
    # the days count from the speed of the last decided pass
    latest = table["speed_median_deg_s"][table["decided"] == 1].iloc[-1]
    days = float(re.search(r"by half in ([\d.]+) days after the last decided pass", done.output)[1])
    assert days == pytest.approx(
        -latest / (2 * history.sunspin.summary()["trend_deg_s_day"]), rel=0.01
    )
    slope = np.polyfit(np.arange(8), table["speed_median_deg_s"], 1)[0]
    summary = history.sunspin.summary()
    assert summary["trend_deg_s_day"] == pytest.approx(slope, rel=0.02)
    stored = xr.load_dataset(out / "history.nc", engine="h5netcdf")
    assert all(v.attrs.get("units") and v.attrs.get("long_name") for v in stored.variables.values())
    assert "a spinner" in write_report(out).read_text("utf-8")


def test_the_line_on_passes_that_are_not_listed_is_right_with_a_folder_for_the_table_too(week):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sunspin.output.kinds.history.MOST_LINES", 5)
        notes = history_summary(ss.history([week])).notes
    assert "  and 3 more passes: --out writes the whole table" in notes


def test_a_trend_that_rests_on_a_gap_of_most_days_is_named(result, week, history, tmp_path):
    late = [save(result, tmp_path / f"{day}", day, 1 - 0.05 * day / 2) for day in (20, 21, 22)]
    apart = ss.history([*(week / day for day in "012"), *late])
    assert "gap of 18 of 22 days" in lines_of(apart) and "gap of" not in lines_of(history)


def test_axes_of_passes_that_are_not_decided_are_named_in_the_figure(week):
    figure = ss.history([week / "3"]).sunspin.plot()
    assert [text.get_text() for text in figure.axes[1].get_legend().get_texts()] == ["x", "y", "z"]
    assert len({line.get_color() for line in figure.axes[1].get_lines()}) == 3


def test_vehicle_files_of_one_name_that_differ_are_named_and_those_that_agree_are_not(
    result, week, history, tmp_path
):
    heavier = VEHICLE.replace("0.02, 0, 0", "0.05, 0, 0")
    other = save(result, tmp_path / "other", 1.0, text=heavier)
    assert "VEHICLE FILES DIFFER" in lines_of(ss.history([week / "0", other]))
    assert "VEHICLE FILES DIFFER" not in lines_of(history)


@pytest.mark.parametrize(
    ("day", "name", "message"),
    [
        (1.0, "another", "several satellites"),
        (0.0, "a spinner", "two results hold the same pass"),
        (1 / 288, "a spinner", "two results hold the same pass"),
    ],
)
def test_results_that_do_not_belong_together_are_refused(
    day, name, message, result, week, tmp_path
):
    with pytest.raises(ss.InputError, match=message):
        ss.history([week / "0", save(result, tmp_path / "b", day, name=name)])


def test_folders_of_other_commands_and_empty_ones_are_refused(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(ss.InputError, match="the folder holds no results; give folders that"):
        ss.history([tmp_path / "empty"])
    with pytest.raises(ss.InputError, match="there is no such folder"):
        ss.history([tmp_path / "none"])
    data = ss.panel_health(ss.load_vehicle("philae"), ss.load_case("philae").telemetry)
    data.sunspin.save(tmp_path / "other")
    with pytest.raises(ss.InputError, match="results of `sunspin"):
        ss.history([tmp_path / "other"])
    with pytest.raises(ss.InputError, match="the folder holds no results"):
        ss.history([tmp_path])


def test_results_of_other_commands_beside_those_of_rates_do_not_matter(week, tmp_path):
    """Nor do files beside the folders."""
    shutil.copytree(week / "0", tmp_path / "monday")
    shutil.copy(week / "0" / "rates.nc", tmp_path / "x.nc")
    (tmp_path / "attitude").mkdir()
    (tmp_path / "attitude" / ".sunspin-results").write_text("export\n", "utf-8")
    assert ss.history([tmp_path]).sizes["time"] == 1


def simulated(rng, n, slope, walk, jump=0.0):
    t = np.sort(rng.uniform(0, 30, n))
    sigma = rng.uniform(0.5, 2.0, n) * 1e-4
    steps = walk * np.sqrt(np.diff(t, prepend=t[0])) * rng.normal(size=n)
    speed = 0.05 + slope * t + np.cumsum(steps) + sigma * rng.normal(size=n) + jump * (t > 15)
    return t, speed, sigma


def test_the_filter_gives_the_likelihood_of_the_walk_written_as_a_matrix():
    t, speed, sigma = simulated(np.random.default_rng(2), 12, 1e-4, 2e-4)
    strength, since = 4e-8, t - t[0]
    covariance = strength * np.minimum.outer(since, since) + np.diag(sigma**2)
    white, log_determinant = _whiten(t, sigma, strength, np.array([speed, np.ones(12)]))
    weight = np.linalg.inv(covariance)
    rows = np.array([speed, np.ones(12)])
    np.testing.assert_allclose(white @ white.T, rows @ weight @ rows.T, rtol=1e-6)
    density = multivariate_normal(np.zeros(12), covariance).logpdf(speed)
    log_likelihood = -0.5 * (white[0] @ white[0] + log_determinant + 12 * np.log(2 * np.pi))
    assert log_likelihood == pytest.approx(density, rel=1e-9)


@pytest.mark.parametrize("walk", [0.0, 3e-4])
def test_trends_have_errors_of_the_right_size_and_rarely_a_jump_that_is_none(walk):
    rng, pulls, jumps = np.random.default_rng(5), [], 0
    for _ in range(30):
        slope = rng.normal() * 1e-4
        trend = fit_trend(*simulated(rng, 25, slope, walk))
        jumps += len(trend.jumps)
        pulls.append((trend.slope - slope) / trend.slope_sigma)
    assert 0.7 < np.sqrt(np.mean(np.square(pulls))) < 1.35
    assert jumps <= 1


def test_the_nutation_of_a_tumbling_body_is_no_jump_and_hides_no_trend():
    """The speed of each pass is that at some phase of the nutation: 30 sigma of scatter, independent from pass to pass."""
    rng, pulls = np.random.default_rng(9), []
    for _ in range(15):
        t, speed, sigma = simulated(rng, 25, -1e-4, 0.0)
        trend = fit_trend(t, speed + 4.2e-3 * np.sin(rng.uniform(0, 2 * np.pi, 25)), sigma)
        assert trend.jumps == [] and 1e-3 < trend.scatter < 6e-3
        pulls.append((trend.slope + 1e-4) / trend.slope_sigma)
        assert trend.slope_sigma < 3e-4  # 1e-4 if the scatter were known
    assert 0.5 < np.sqrt(np.mean(np.square(pulls))) < 1.35


@pytest.mark.parametrize("walk", [0.0, 1e-4])
def test_a_jump_is_found_with_place_and_size(walk):
    rng = np.random.default_rng(7)
    for _ in range(5):
        t, speed, sigma = simulated(rng, 25, 1e-5, walk, jump=4e-3)
        trend = fit_trend(t, speed, sigma)
        ((k, size, error),) = trend.jumps
        assert k == int(np.argmax(t > 15)) and abs(size - 4e-3) < 4.5 * error


def test_few_passes_give_no_trend():
    t, speed, sigma = simulated(np.random.default_rng(1), 4, 1e-4, 0.0)
    assert np.isnan(fit_trend(t, speed, sigma).slope)
