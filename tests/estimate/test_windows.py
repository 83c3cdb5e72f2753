"""The rate in short windows of passes that no free body explains: when it is said that something acts, and what is written."""

import numpy as np
import pytest
import xarray as xr

from sunspin.base.errors import InputError
from sunspin.estimate import short_windows
from sunspin.estimate.observe import COAST_FROM
from sunspin.estimate.short_windows import FEWEST_WINDOWS, rates_in_windows
from sunspin.output.windows import window_drawings, window_lines, window_numbers, window_tables
from sunspin.vehicle import Vehicle, Wheel
from validation.passes import FACES, MOMENTS, make_tumbling, observe, spin

BODY = Vehicle("simulated", inertia_kg_m2=np.diag(MOMENTS))
SIGMA_RAD_S = 5e-4
START = np.array([0.05, 0.01, 0.02])


def table(omega, t_s, sigma=SIGMA_RAD_S, fits=True):
    """Return windows at times t_s (n, s) with these rates (n, 3)."""
    n = len(t_s)
    return xr.Dataset(
        {
            "window_time": ("window", t_s),
            "window_omega_B": (("window", "axis"), omega),
            "window_sigma_B": (("window", "axis"), np.full((n, 3), sigma)),
            "window_unique": ("window", np.ones(n, dtype=bool)),
            "window_fits": ("window", np.broadcast_to(fits, n)),
        }
    )


def said(vehicle, omega, t_s, **changes):
    """Return what is said of windows with these rates, which have errors of one sigma."""
    rng = np.random.default_rng(0)
    read = omega + SIGMA_RAD_S * rng.normal(size=omega.shape)
    telemetry = xr.Dataset(coords={"time": t_s})
    return short_windows._as_no_free_body(vehicle, telemetry, table(read, t_s, **changes))


def test_a_tumbling_body_is_not_accused_and_a_driven_one_is():
    t_s = np.linspace(0.0, 900.0, 12)
    free, _ = spin(START, t_s)
    assert np.ptp(free[:, 1]) > 100 * SIGMA_RAD_S  # its rate changes in the body, freely
    assert said(BODY, free, t_s) == ""
    driven = free.copy()
    driven[6:] *= 1.3
    words = said(BODY, driven, t_s)
    assert words.startswith("the rate changes as no free body's does (") and "deg/s within" in words
    # too uncertain, too few windows, too many that do not fit themselves
    assert said(BODY, driven, t_s, sigma=0.05) == ""
    assert said(BODY, driven[5:7], t_s[5:7]) == "" and FEWEST_WINDOWS > 2
    assert said(BODY, driven, t_s, fits=np.arange(12) % 3 > 0) == ""
    # an uncertain inertia allows more
    assert said(Vehicle("no inertia"), driven, t_s) == ""
    assert said(Vehicle("no inertia"), driven * np.where(t_s < 450, 0.1, 1.0)[:, None], t_s)


def test_a_wheel_whose_speed_is_known_is_counted_in():
    """A wheel that was driven to another speed explains the rate, where its speed is read."""
    wheel = Wheel("w", [0, 0, 1], 1e-4, speed_rad_s=0.0)
    vehicle = Vehicle("wheeled", inertia_kg_m2=np.diag(MOMENTS), wheels=[wheel])
    t_s = np.linspace(0.0, 90.0, 10)
    speed = np.where(t_s < 45, 0.0, 6.0)
    omega = np.zeros((10, 3))
    omega[:, 2] = (MOMENTS[2] * 0.04 - 1e-4 * speed) / MOMENTS[2]
    unread, part = xr.Dataset(coords={"time": t_s}), table(omega, t_s)
    read = unread.assign(wheel_speed_rad_s=(("time", "wheel"), speed[:, None]))
    assert short_windows._as_no_free_body(vehicle, read, part) == ""
    assert short_windows._as_no_free_body(vehicle, unread, part)


@pytest.fixture(scope="module")
def controlled():
    """Return a pass whose rate is set anew every seven samples, and its result of `rates`, taken for one that does not fit."""
    rng = np.random.default_rng(3)
    t_s = 6.0 * np.arange(28)
    rates_of = np.radians([[3.0, 0.0, 1.0], [0.0, 1.0, 1.0], [-2.0, 4.0, 2.0], [0.5, 0.0, -1.0]])
    omega = np.repeat(rates_of, 7, axis=0)
    parts, attitude = [], np.eye(3)
    for k in range(4):
        turns = spin(omega[7 * k], t_s[:8], moments=np.ones(3))[1]
        parts.append(turns[:7] @ attitude)
        attitude = turns[7] @ attitude
    made = observe(FACES, omega, np.concatenate(parts), t_s, 0.01, rng)
    options = {"max_rate_rad_s": 0.15, "column_tests": False, "effort": 1e-6}
    result = short_windows.rates(made.vehicle, made.telemetry, **options)
    return made, result.assign(fits=("pass_id", [False]))


def test_a_pass_that_does_not_fit_is_given_in_windows(controlled):
    made, result = controlled
    found = rates_in_windows(made.vehicle, made.telemetry, result, max_rate_rad_s=0.15)
    assert found["window_samples"].values.tolist() == [short_windows.WINDOW_SAMPLES] * 4
    assert found["window_pass"].values.tolist() == [0] * 4
    truth = made.omega[np.searchsorted(made.telemetry["time"], found["window_time"])]
    off = (found["window_omega_B"].values - truth) / found["window_sigma_B"].values
    assert np.abs(off[found["window_decided"].values]).max() < 5
    assert found.attrs["controlled"].startswith("pass 0: the rate changes as no free body's does")
    assert "no free body" in str(found["why_not_decided"].values[0])
    assert found.attrs["verdict"].endswith(found.attrs["controlled"])
    doubted = result.assign_attrs(columns_doubt="CHECK THE COLUMNS")
    # a window has too few samples to contradict exchanged columns
    assert found["window_decided"].any()
    assert rates_in_windows(made.vehicle, made.telemetry, doubted) is doubted

    (line,) = window_lines(found)
    assert "4 short windows" in line
    (written,) = window_tables(found)
    assert len(written.frame) == 4
    speed = np.degrees(np.linalg.norm(found["window_omega_B"].values, axis=1))
    np.testing.assert_allclose(written.frame["speed_deg_s"], speed)
    assert window_numbers(found)["windows"][0]["samples"] == int(found["window_samples"].values[0])
    (drawing,) = window_drawings(found.assign_attrs(vehicle="cube"))
    assert len(drawing.make().axes) == 3


def test_windows_are_given_the_time_from_which_wheels_of_the_file_coast(controlled, monkeypatch):
    made, result = controlled
    given = []

    def fail(vehicle, telemetry, **options):
        given.append(telemetry)
        raise InputError("no motion")

    monkeypatch.setattr(short_windows, "rates", fail)
    before = made.telemetry.assign_coords(time=made.telemetry["time"] - 3600.0)
    both = xr.concat([before, made.telemetry], "time")
    assert rates_in_windows(made.vehicle, both, result) is result
    assert given[0].sizes["time"] == 28 and given[0].attrs[COAST_FROM] == -3600.0


def test_a_result_that_fits_is_returned_as_it_is():
    made = make_tumbling(np.random.default_rng(0))
    result = xr.Dataset({"fits": ("pass_id", [True])}, {"pass_id": [0]})
    assert rates_in_windows(made.vehicle, made.telemetry, result) is result
    assert window_lines(result) == [] and window_numbers(result) == {}
    assert not list(window_tables(result)) and not list(window_drawings(result))
