"""Dead panels detected by missing light, with misalignment and power limits. All telemetry is synthetic."""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr

import sunspin as ss
from sunspin.output.check.files import _describe_panels
from sunspin.telemetry.assess import assess, panel_quality
from sunspin.telemetry.synthetic import draw_tilts
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.parts import Fact
from tests.support.simulate import telemetry_of
from tests.support.vehicles import CUBE_NORMALS

NOISE = 0.02


def drawn(seed: int, i: int, dead: bool) -> tuple[Vehicle, xr.Dataset, str]:
    """Six faces, or six to ten panels that look all around, turned by 1 to 5 degrees as the file states, 15 to 60 samples of a
    tumble at 0.5 to 4 deg/s; and the panel that is `dead`, if one is."""
    rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,)))
    normals = CUBE_NORMALS if i % 2 == 0 else np.full((6, 3), 1.0)
    while np.linalg.norm(normals.sum(axis=0)) > 1.8:
        normals = rng.normal(size=(int(rng.integers(6, 11)), 3))
        normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    sigma, names = np.radians(rng.uniform(1, 5)), [f"p{k}" for k in range(len(normals))]
    panels = tuple(Panel(name, normal, 1.0) for name, normal in zip(names, normals, strict=True))
    craft = Vehicle(
        "turned",
        inertia_kg_m2=np.diag([0.042, 0.05, 0.03]),
        gain_unit="W",
        panels=panels,
        telemetry=TelemetryForm(noise=NOISE),
    )
    t = np.cumsum(rng.uniform(4, 18, int(rng.integers(15, 61))))
    omega, sun = (each / np.linalg.norm(each) for each in rng.normal(size=(2, 3)))
    run = ss.propagate(craft, np.radians(rng.uniform(0.5, 4)) * omega, sun, None, t)
    tilt = draw_tilts(craft, sigma, rng)
    tilts = np.broadcast_to(tilt, (len(t), *tilt.shape))
    power = craft.response_in().power(run["sun_B"].values, tilt=tilts)
    lost = int(rng.integers(len(names)))
    power[:, lost] *= not dead
    power = np.maximum(power + NOISE * rng.normal(size=power.shape), 0.0)
    facts = {f"panel.{name}.normal_B": Fact((0.0, 0.0, 0.0), float(sigma)) for name in names}
    return replace(craft, facts=facts), telemetry_of(craft, t, power), names[lost]


def blamed(craft: Vehicle, data: xr.Dataset) -> set[str]:
    """Panels that `check` calls dead, or whose loss it says would explain what is lit."""
    quality, health = panel_quality(craft, data), _describe_panels(assess(craft, data))[0]
    named = set(quality["panel"].values[quality["missed"].values].tolist())
    return named.union(*([] if health["made_by"] else health["explanations"]))


@pytest.mark.parametrize(
    ("count", "named"), [(12, 7), pytest.param(70, 50, marks=pytest.mark.long)]
)
@pytest.mark.evidence(
    "panel_quality",
    "modelled",
    "simulated files of panels misaligned within their sigmas, with and without a dead one",
)
def test_with_misaligned_panels_a_dead_one_is_named_and_a_good_one_never(count, named):
    broken, whole = ([drawn(0, i, dead) for i in range(count)] for dead in (True, False))
    found = [(blamed(craft, data), lost) for craft, data, lost in broken]
    assert all(names <= {lost} for names, lost in found)
    assert sum(names == {lost} for names, lost in found) >= named
    assert not any(blamed(craft, data) for craft, data, _ in whole)


@pytest.mark.parametrize(
    ("count", "apart"), [(8, 1.0), pytest.param(60, 1.0, marks=pytest.mark.long), (12, 10.0)]
)
@pytest.mark.evidence(
    "panel_quality",
    "modelled",
    "simulated files without a dead panel, power-limited in single samples or in a time range",
)
def test_a_good_panel_is_not_called_dead_in_power_limited_samples(count, apart):
    accused = 0
    for i in range(count):
        craft, data, _ = drawn(9, i, False)
        rng = np.random.default_rng([9, i])
        power, n = data["power_W"].values, data.sizes["time"]
        dim = (
            rng.uniform(size=n) < 0.15 if i % 2 else np.abs(np.arange(n) - rng.integers(n)) < n // 8
        )
        power[dim] *= rng.uniform(0.1, 0.75)
        # shuffled, a path cannot be followed
        order = np.argsort(np.random.default_rng(i).random(n)) if apart > 1 else np.arange(n)
        data = data.assign(power_W=(("time", "panel"), power[order]))
        accused += bool(panel_quality(craft, data)["missed"].any())
    assert accused <= count // 60


def test_power_limited_samples_call_no_panel_dead_that_was_never_lit():
    panels = [Panel(f"p{k}", CUBE_NORMALS[k], 1.0) for k in range(6)]
    form = TelemetryForm(noise=0.01)
    craft = Vehicle("cube", gain_unit="W", panels=panels, telemetry=form)
    rng = np.random.default_rng(3)
    sun = rng.normal(size=(60, 3)) * [1, 1, 0.5] - [0, 0, 1]
    sun[:, 2] = -np.abs(sun[:, 2])
    power = ss.panel_power(craft, sun / np.linalg.norm(sun, axis=1, keepdims=True))
    power[::5] *= 0.6
    data = telemetry_of(craft, 10.0 * np.arange(60), power)
    assert panel_quality(craft, data)["dead"].values.tolist() == [k == 2 for k in range(6)]
    assert not panel_quality(craft, data)["missed"].any()
