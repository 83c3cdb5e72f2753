"""The rate of a pass in words, and the figures of rates: residuals, left-out panels, passes far apart."""

from __future__ import annotations

import random
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.environment.frames import J2000
from sunspin.output.curves import pass_motions
from sunspin.output.figures import render
from sunspin.output.figures.panel_signals import panel_signals_figure
from sunspin.output.figures.rates import attitude_figure, rates_figure, sensors_text
from sunspin.output.figures.residuals import residuals_figure
from sunspin.output.figures.time_axis import build_time_axis
from sunspin.output.kind import Context
from sunspin.output.kinds.rates import rate_at, rates_drawings
from sunspin.output.kinds.telemetry import sun_directions_figure
from sunspin.output.report.read import Results
from sunspin.output.report.views import read_motions
from sunspin.telemetry.synthetic import telemetry_dataset
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from tests.support.vehicles import FACES

PANELS = [Panel(name, n, 5.0) for name, n in FACES.items()]
FORM = TelemetryForm(noise=0.05)
CUBE = Vehicle("cube", np.diag([0.02, 0.021, 0.01]), panels=PANELS, gain_unit="W", telemetry=FORM)
PIECES = "$ \\ _ ^ { } % & # ~ \\frac $x$ $$ a é 中 _{ <b> ' \" -".split()
OMEGA = np.radians([1.5, 0.5, 3.0])


def tumble(
    n: int = 60, step: float = 10.0, noise: float = 0.05, seed: int = 0
) -> tuple[xr.Dataset, xr.Dataset]:
    """A result of `rates` that is the truth, and its samples."""
    t = step * np.arange(n)
    run = ss.propagate(CUBE, OMEGA, [0.6, 0.0, 0.8], None, t)
    power = ss.panel_power(CUBE, run["sun_B"].values)
    power = power + noise * np.random.default_rng(seed).normal(size=power.shape)
    samples = telemetry_dataset(CUBE, t, power, run["sun_B"].values, "2026-01-01T00:00:00Z", {})
    covariance = np.tile(np.diag([1e-8, 4e-8, 9e-8]), (n, 1, 1))
    result = xr.Dataset(
        {
            **{name: run[name] for name in ("omega_B", "sun_B")},
            "pass_of": ("time", np.zeros(n, dtype=int)),
            "omega_cov_B": (("time", "axis", "axis2"), covariance),
            "omega_sigma_all_B": (("pass_id", "axis"), [[3e-4, 1e-4, 1e-4]]),
            "probability": (("pass_id", "solution"), [[1.0]]),
            "omega_sigma_B": (("pass_id", "solution", "axis"), [[[1e-4, 1e-4, 1e-4]]]),
        },
        coords={"time": t, "pass_id": [0]},
        attrs={"epoch_utc": "2026-01-01T00:00:00Z", "source": "panels", "vehicle": "cube"},
    )
    return result, samples


def test_the_speed_of_a_pass_is_the_mean_of_speeds():
    result, _ = tumble()
    rate = rate_at(result, 0)
    speed = np.degrees(np.linalg.norm(result["omega_B"].values, axis=1))
    assert (rate.low, rate.high) == pytest.approx((speed.min(), speed.max()), rel=1e-9)
    size_of_mean = np.degrees(np.linalg.norm(result["omega_B"].values.mean(axis=0)))
    assert rate.mean == pytest.approx(speed.mean(), rel=1e-9) and rate.mean > 1.05 * size_of_mean
    at = int(np.argmin(np.abs(result["time"].values - 295)))
    np.testing.assert_allclose(rate.omega, np.degrees(result["omega_B"].values[at]), rtol=1e-9)
    other = np.sqrt([1e-8 + 8e-8, 4e-8, 9e-8])  # own error and what the other modes add
    np.testing.assert_allclose(rate.sigma, np.degrees(other), rtol=1e-6)


def test_gyro_readings_are_drawn_less_the_zero_that_was_estimated():
    result, samples = tumble()
    zero = np.radians([0.4, -0.3, 0.0])
    samples = samples.assign(gyro_B=(("time", "axis"), result["omega_B"].values + zero))
    estimates = xr.Dataset(coords={"estimate": ["gyro_zero_x", "gyro_zero_y"]})
    estimates["estimate_value"] = ("pass_id", "estimate"), [zero[:2]]
    for known, off in ((result.merge(estimates), np.zeros(3)), (result, zero)):
        figure = rates_figure(known, samples)
        for k, axes in enumerate(figure.axes[:3]):
            (crosses,) = (line for line in axes.lines if line.get_marker() == "x")
            expected = np.degrees(result["omega_B"].values[:, k] + off[k])
            np.testing.assert_allclose(crosses.get_ydata(), expected, atol=1e-9)
        label = figure.legends[0].get_texts()[-1].get_text()
        assert label == ("gyro" if off.any() else "gyro, less its estimated zero")


def test_residuals_are_drawn_by_sensor_with_the_share_beyond_the_limit():
    result, _ = tumble()
    value = np.full((3, 60), np.nan)
    value[0], value[2, :10] = np.linspace(0, 5, 60), 9.0
    found = result.assign(residual=(("sensor", "time"), value), sensor=["Sun", "gyro", "$x_"])
    figure = residuals_figure(found)
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert len(labels) == 2 and labels[0] == "Sun (sigma)\n40.0% beyond 3" and "100.0%" in labels[1]
    assert np.nanmax(figure.axes[1].lines[0].get_ydata()) < figure.axes[1].get_ylim()[1]
    assert all(render(figure).values())


@pytest.mark.parametrize(
    ("fits", "decided", "said"),
    [
        (True, True, "probability 1.00"),
        (True, False, "probability 1.00, not decided"),
        (False, False, "probability 1.00, poor fit"),
    ],
)
def test_a_pass_that_must_not_be_used_is_marked_in_its_figure(fits, decided, said):
    result, _ = tumble(20, 30.0)
    found = result.assign(fits=("pass_id", [fits]), decided=("pass_id", [decided]))
    found["probability"] = ("pass_id", "solution"), [[1.0]]
    assert rates_figure(found).axes[0].get_title().splitlines()[1] == said


@pytest.mark.parametrize(
    ("used", "said"),
    [((), "panel signals"), (("gyro", "field"), "panel signals, gyro and magnetometer")],
)
def test_the_summary_of_rates_names_the_sensors_used(used, said):
    result, _ = tumble()
    assert sensors_text(result.assign_attrs({f"{name}_used": 1 for name in used})) == said
    assert sensors_text(result.assign_attrs(source="field", field_used=1)) == "magnetometer"


def with_curve(result: xr.Dataset, omega=OMEGA) -> xr.Dataset:
    """The same with the motion between its samples, and attitudes."""
    t = np.linspace(0.0, result["time"].values[-1], 800)
    coarse, fine = (
        ss.propagate(CUBE, omega, [0.6, 0.0, 0.8], None, at) for at in (result["time"].values, t)
    )
    rate = fine["omega_B"].values
    return result.assign(
        omega_B=coarse["omega_B"],
        B_from_N=coarse["B_from_N"],
        curve_omega_B=(("curve_time", "axis"), rate),
        curve_omega_sigma_B=(("curve_time", "axis"), np.full(rate.shape, 1e-4)),
        curve_B_from_N=(("curve_time", "quaternion"), fine["B_from_N"].values),
        curve_pass_of=("curve_time", np.zeros(t.size, dtype=int)),
    ).assign_coords(curve_time=t)


def test_drawn_rates_follow_the_motion_and_fill_their_axes():
    """No straight lines between samples, and no axis stretched to a zero that is out of sight."""
    result, _ = tumble(20, 30.0)
    result = with_curve(result)
    figure = rates_figure(result)
    for k, axes in enumerate(figure.axes[:3]):
        solid = [line for line in axes.lines if line.get_linestyle() == "-"]
        curve = next(line for line in solid if len(line.get_xdata()) > 2)
        drawn, (low, high) = np.asarray(curve.get_ydata()), axes.get_ylim()
        expected = np.degrees(result["curve_omega_B"].values[:, k])
        np.testing.assert_allclose(drawn, expected, rtol=1e-12)
        assert np.ptp(drawn) > 0.5 * (high - low)
    texts = [text.get_text() for text in figure.legends[0].get_texts()]
    assert len(texts) == 2 and "between them" in texts[0] and "sigma" in texts[1]
    title, run = pass_motions(result)[0]
    assert title == "Pass 0" and "equations of motion" in run.attrs["about"]
    exact = ss.propagate(CUBE, OMEGA, [0.6, 0.0, 0.8], None, run["time"].values)
    np.testing.assert_allclose(run["sun_B"].values, exact["sun_B"].values, atol=1e-6)
    assert pass_motions(result.drop_vars("curve_pass_of")) == []


@pytest.mark.parametrize("passes", [4, 6])
def test_a_page_of_more_motions_than_it_shows_says_so(passes: int) -> None:
    result = with_curve(tumble(60, 30.0)[0])
    of_samples = np.arange(60) * passes // 60
    share = result["curve_time"].values / result["curve_time"].values[-1]
    of_curve = np.minimum(share * passes, passes - 1).astype(int)
    result = result.drop_dims("pass_id").assign_coords(pass_id=np.arange(passes))
    result = result.assign(pass_of=("time", of_samples), curve_pass_of=("curve_time", of_curve))
    motions = read_motions(Results(Path("any"), "rates", data={"rates": result}))
    says = [motion.attrs["about"].endswith("Shown are 4 of 6 motions") for _, motion in motions]
    assert says == [passes > 4] * 4


def test_the_attitude_is_drawn_where_an_orbit_gives_it():
    result = with_curve(tumble(20, 30.0)[0]).assign(decided=("pass_id", [True]))
    sigmas = {f"{name}_sigma_rad": ("time", np.full(20, 0.03)) for name in ("sun", "turn")}
    known = result.assign(sigmas).assign_attrs(frame_N=J2000)
    drawn, others = ([x.name for x in rates_drawings(one, Context())] for one in (known, result))
    assert "attitude" in drawn and "attitude" not in others
    axes = attitude_figure(known).axes[0]
    assert axes.get_title().endswith("one sigma 2.4 deg") and len(axes.lines) == 4


@pytest.mark.parametrize("passes", [2, 5, 30])
def test_passes_far_apart_are_drawn_side_by_side(passes):
    one = np.arange(0.0, 600.0, 30.0)
    time = np.concatenate([one + 5700 * k for k in range(passes)])
    place = build_time_axis(time)
    x = place.x(time / 3600)
    assert np.all(np.diff(x) > 0)
    pauses = np.diff(x)[one.size - 1 :: one.size]
    assert pauses.sum() < 0.5 * np.ptp(x) + 1e-9 or passes == 30
    within = np.diff(x)[: one.size - 1]
    np.testing.assert_allclose(within, np.diff(one) / 3600, rtol=1e-6)
    assert build_time_axis(one).hours.size == 0
    samples = [tumble(20, 30.0)[1].assign_coords(time=one + 5700 * k) for k in range(passes)]
    sun = xr.concat(samples, "time")
    figure = sun_directions_figure(ss.sun_directions(CUBE, sun), sun)
    assert "pauses, shortened" in figure.axes[-1].get_xlabel()
    assert len(figure.axes[-1].get_xticks()) <= 13


def test_names_that_look_like_formulas_are_drawn_unchanged():
    rng = random.Random(0)
    names = []
    while len(names) < 6:
        name = "".join(rng.choice(PIECES) for _ in range(rng.randint(1, 4))).strip()
        if name and name not in names:
            names.append(name)
    panels = tuple(replace(p, name=n) for p, n in zip(CUBE.panels, names, strict=True))
    odd = replace(CUBE, name=names[0], panels=panels)
    samples = tumble(12)[1].assign_coords(panel=names)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        drawn = render(sun_directions_figure(ss.sun_directions(odd, samples), samples))
    assert all(drawn.values())


def test_predicted_panel_signals_have_the_gains_estimated_with_the_motion():
    """A panel with half of its stated gain is drawn at half, not below samples of the others."""
    result, samples = tumble(noise=0.0)
    factor = np.ones(samples.sizes["panel"])
    factor[2] = 0.5
    dimmed = samples.assign(power_W=samples["power_W"] * factor)
    names = [f"gain_{name}" for name in samples["panel"].values]
    values = (("pass_id", "estimate"), [[1.1, *factor[:3]]])
    estimated = with_curve(result).assign(estimate_value=values)
    estimated = estimated.assign_coords(estimate=["inertia_xx", *names[:3]])
    ((_, motion),) = pass_motions(estimated)
    figure = panel_signals_figure(dimmed, [("Pass 0", motion)], CUBE)
    for axes in figure.axes:
        line, dots = axes.get_lines()
        drawn = np.interp(dots.get_xdata(), line.get_xdata(), line.get_ydata())
        assert np.abs(drawn - dots.get_ydata()).max() < 0.2
