"""Faulty panel readings: each fault is detected, modelled and reported. The telemetry is synthetic."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.equivalence import Observed
from sunspin.estimate.terms.panels import Panels
from sunspin.telemetry.assess import assess, panel_quality
from sunspin.telemetry.quality import ALBEDO_DEFAULT, DOWNWEIGHTED, DROPPED, USED
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS as NORMALS
from tests.support.vehicles import CUBE_OF_CURRENTS as CUBE

THIRD = [k == 2 for k in range(6)]
"""Whether each panel is the third."""


def telemetry(value, flag=None, vehicle=CUBE):
    data = telemetry_of(vehicle, 30.0 * np.arange(len(value)), value)
    return data if flag is None else data.assign(flag=("time", flag))


def clean(n, seed=0):
    rng = np.random.default_rng(seed)
    sun = rng.normal(size=(n, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    return ss.panel_power(CUBE, sun) + 0.002 * rng.uniform(size=(n, 6)), sun


def test_clean_samples_are_all_used():
    """Also those of a body at rest, whose readings are not called stale."""
    quality = panel_quality(CUBE, telemetry(clean(40)[0]))
    assert np.all(quality["use"] == USED) and not quality["dead"].any()
    assert set(quality["why"].values) == {"used"}
    assert np.isfinite(quality["sigma"]).all()
    still = np.tile(ss.panel_power(CUBE, [0.6, 0.0, 0.8]), (30, 1))
    assert np.all(panel_quality(CUBE, telemetry(still))["use"] == USED)
    with pytest.raises(ss.InputError, match="no panel powers or currents"):
        panel_quality(CUBE, telemetry(still).drop_vars("current_A"))


@pytest.mark.evidence("panel_quality", "modelled", "a panel set to zero")
def test_a_dead_panel_is_named_and_left_out():
    value, _ = clean(60)
    value[:, 2] = 0.0
    quality = panel_quality(CUBE, telemetry(value))
    assert quality["dead"].values.tolist() == THIRD
    assert np.isinf(quality["sigma"].values[:, 2]).all()
    assert quality["missed"].values.tolist() == THIRD
    assert Panels.read(assess(CUBE, telemetry(value)))[0].left_out == ("p2",)
    assert not Panels.read(assess(CUBE, telemetry(clean(60)[0])))[0].left_out


@pytest.mark.parametrize("fill", [999.0, 65535.0])
def test_fill_values_are_no_signal_of_a_dead_panel(fill):
    """Rows of fill values made a dead panel seem alive, and lit."""
    value, _ = clean(60)
    value[:, 2] = 0.0
    value[[5, 9, 30]] = fill
    data = telemetry(value)
    assert panel_quality(CUBE, data)["dead"].values.tolist() == THIRD
    assert Observed.of(CUBE, data).lit.tolist() == [not third for third in THIRD]


def test_in_few_samples_a_panel_is_called_dead_only_for_missing_light_on_a_path():
    angle = np.linspace(-1.2, 1.2, 10)
    sun = np.stack([np.cos(angle), 0.3 * np.ones(10), np.sin(angle)], axis=1) / np.sqrt(1.09)
    value = ss.panel_power(CUBE, sun)
    value[:, 2] = 0.0
    found = panel_quality(CUBE, telemetry(value))
    assert found["missed"].values.tolist() == found["dead"].values.tolist() == THIRD
    whole = ss.panel_power(CUBE, np.where(np.arange(3) == 2, -np.abs(sun), sun))
    assert not panel_quality(CUBE, telemetry(whole))["dead"].any()
    # one sample of ten that a battery may have dimmed, and no path that says otherwise
    anywhere = clean(10)[0]
    anywhere[:, 2] = 0.0
    assert not panel_quality(CUBE, telemetry(anywhere))["missed"].any()


@pytest.mark.evidence("panel_quality", "modelled", "currents scaled down")
@pytest.mark.parametrize(
    ("share", "use", "word"),
    [(0.6, DOWNWEIGHTED, "battery-limited current"), (0.2, DROPPED, "far below")],
)
def test_power_limited_samples_are_distinguished_from_sunlight(share, use, word):
    value, _ = clean(40)
    value[10:20] *= share
    quality = panel_quality(CUBE, telemetry(value))
    assert np.all(quality["use"].values[10:20] == use)
    assert all(word in text for text in quality["why"].values[10:20])
    assert np.all(quality["use"].values[:10] == USED)
    if use == DOWNWEIGHTED:
        assert np.all(quality["scale_sigma"].values[10:20] > 1)


@pytest.mark.evidence("panel_quality", "modelled", "known faults in clean simulated samples")
def test_outliers_and_stale_late_and_empty_frames_are_reported():
    value, _ = clean(40)
    value[3, 1] = 65.535
    value[6] = value[5]
    value[8] = np.nan
    flag = np.zeros(40, np.uint8)
    flag[9] = 4
    quality = panel_quality(CUBE, telemetry(value, flag=flag))
    why = quality["why"].values
    assert "wrapped count or spike" in why[3] and np.isinf(quality["sigma"].values[3, 1])
    assert np.isfinite(quality["sigma"].values[3, 0])  # the others of that sample still count
    assert "stale" in why[6] and "no panel has a number" in why[8] and "out-of-order" in why[9]
    assert quality["use"].values[[3, 6, 8, 9]].tolist() == [DOWNWEIGHTED, DROPPED, DROPPED, DROPPED]


@pytest.mark.parametrize("told", ["stated", "below zero", "cut to zero"])
def test_noise_in_shadow_is_not_taken_for_an_oblique_sun(told):
    """Four sides see nothing of a Sun along z, so noise on them looks like one; in the dark nothing but noise is read."""
    panels = [Panel(f"p{k}", n, 0.5) for k, n in enumerate(NORMALS[[0, 1, 3, 4]])]
    form = TelemetryForm(quantity="current_A", noise=0.015 if told == "stated" else None)
    sides = Vehicle("sides", gain_unit="A", panels=panels, telemetry=form)
    rng = np.random.default_rng(2)
    sun = rng.normal(size=(200, 3))
    sun /= np.linalg.norm(sun, axis=1, keepdims=True)
    lit = np.arange(200) < 100
    value = ss.panel_power(sides, sun) * lit[:, None] + 0.015 * rng.normal(size=(200, 4))
    value = np.maximum(value, 0.0) if told == "cut to zero" else value
    use = panel_quality(sides, telemetry(value, vehicle=sides))["use"].values
    seen = np.hypot(sun[:, 0], sun[:, 1]) > 0.35
    assert (use[~lit] == DROPPED).all() and (use[lit & seen] == USED).all()


def test_albedo_is_estimated_from_panels_opposite_to_lit_ones():
    value, sun = clean(300)
    rng = np.random.default_rng(1)
    dark = sun @ NORMALS.T < 0
    lit = value + dark * 0.5 * rng.uniform(0, 0.2, size=value.shape)
    quality = panel_quality(CUBE, telemetry(lit))
    # 84 % point of a uniform law up to 0.2
    assert quality.attrs["albedo"] == pytest.approx(0.168, abs=0.03)
    assert panel_quality(CUBE, telemetry(value[:3])).attrs["albedo"] == ALBEDO_DEFAULT


def test_noise_of_dark_panels_is_no_fill_value_if_most_samples_lie_in_the_shadow():
    rng = np.random.default_rng(2)
    value = clean(100)[0]
    value[:75] = 0.0
    value = np.round(value + 0.006 * rng.normal(size=value.shape), 3)
    value[80, 1] = -1.0  # a fill value still is one
    craft = replace(CUBE, telemetry=replace(CUBE.telemetry, noise=None))
    why = panel_quality(craft, telemetry(value))["why"].values
    assert [k for k in range(100) if "negative" in str(why[k])] == [80]
