"""Results in Python: each knows its kind and source, and is summarised, drawn and saved."""

import json
import re
from functools import cache
from importlib import import_module

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from matplotlib.figure import Figure

import sunspin as ss
from sunspin.dynamics.curve import with_curve
from sunspin.output.kind import KINDS
from sunspin.output.kinds import MODULES
from sunspin.output.text import rate_text

NO_FIGURE = {"impact", "lines", "calibration"}
PHILAE = ss.load_case("philae")
VEHICLE, TELEMETRY = PHILAE.vehicle, PHILAE.telemetry
OMEGA, SUN, SPEED = [0.1, 0.0, 0.2], [0.0, 0.6, 0.8], VEHICLE.wheels[0].speed_rad_s


def motion():
    """A motion with output times so far apart that a curve between them is stored."""

    def at(t_s):
        return ss.propagate(VEHICLE, OMEGA, SUN, SPEED, t_s)

    return with_curve(at(np.linspace(0.0, 60.0, 4)), VEHICLE.inertia_kg_m2, at)


def scan():
    grid = [-0.1, 0.0, 0.1], [-0.1, 0.0, 0.1], [0.0, 0.1]
    return ss.scan(VEHICLE, [0.1, 0.3, 0.6], SUN, *grid, SPEED, 300.0)


@cache
def rates():
    t = np.arange(0.0, 300.0, 30.0)
    turn = np.radians(0.6) * t
    sun = np.stack([np.cos(turn), np.sin(turn) * 0.8, np.sin(turn) * 0.6], axis=1)
    return ss.rates(ss.load_vehicle("skcube"), directions(t, sun), max_rate_rad_s=np.radians(2.0))


def directions(t, sun):
    covariance = np.tile(1e-4 * np.eye(3), (t.size, 1, 1))
    data = {
        "sun_sensor_B": (("time", "axis"), sun),
        "sun_sensor_cov_B": (("time", "axis", "axis2"), covariance),
        "flag": ("time", np.zeros(t.size, dtype=np.uint8)),
    }
    attrs = {"epoch_utc": "2024-01-01T00:00:00Z"}
    return xr.Dataset(data, {"time": t, "axis": ["x", "y", "z"]}, attrs)


RUNNING_DOWN = [0.0, 60.0, 120.0, 180.0], [864.0, 830.0, 800.0, 771.0]
MADE = {
    "telemetry": lambda: TELEMETRY,
    "sun_directions": lambda: ss.sun_directions(VEHICLE, TELEMETRY),
    "panel_quality": lambda: ss.panel_quality(VEHICLE, TELEMETRY),
    "panel_health": lambda: ss.panel_health(VEHICLE, TELEMETRY),
    "spin_down": lambda: ss.fit_spin_down(*RUNNING_DOWN, 0.0058),
    "calibration": lambda: ss.calibrate_sensors(VEHICLE, TELEMETRY),
    "rates": rates,
    "pointing": lambda: ss.pointing(rates()),
    "trajectory": motion,
    "impact": lambda: ss.impact(VEHICLE, OMEGA, SPEED, [0.0, 0.0, -0.3], 0),
    "scan": scan,
    "lines": lambda: ss.fit_lines(np.random.default_rng(1).normal(size=(30, 3)), 2),
    "outcomes": lambda: ss.outcomes(VEHICLE, [OMEGA], "off", 20, 0),
}
"""Kind -> how a public function makes it, small."""


@pytest.mark.parametrize("kind", MADE)
def test_every_result_is_summarised_drawn_and_saved_by_its_kind(kind, tmp_path, framed):
    result = MADE[kind]()
    given = result.copy(deep=True)
    assert result.attrs["kind"] == kind and result.attrs["sunspin_version"] == ss.__version__
    summary = result.sunspin.summary()
    assert isinstance(summary, dict) and json.dumps(summary) and str(summary).strip()
    if kind in NO_FIGURE:
        with pytest.raises(ss.InputError, match="has no figure; print its summary"):
            result.sunspin.plot()
    else:
        result.sunspin.plot().canvas.draw()
        with pytest.raises(ss.InputError, match="no figure of this name"):
            result.sunspin.plot("nonsense")
    folder = result.sunspin.save(tmp_path / "saved")
    names = {path.name for path in folder.iterdir()}
    assert {f"{KINDS[kind].main}.nc", "summary.json", "manifest.json"} <= names
    assert (kind in NO_FIGURE) is not any(n.endswith(".svg") for n in names)
    assert result.identical(given)  # what is saved says more than what was given, which stays
    stored = xr.load_dataset(folder / f"{KINDS[kind].main}.nc", engine="h5netcdf")
    assert stored.attrs["kind"] == kind and stored.sunspin.summary() == summary
    for name, variable in stored.variables.items():
        assert variable.attrs.get("units") and variable.attrs.get("long_name"), name
    assert json.loads((folder / "summary.json").read_text("utf-8"))["version"] == ss.__version__


@pytest.mark.long
def test_a_posterior_and_its_predictions_are_summarised_and_saved(user_runs, tmp_path, framed):
    tree = xr.load_datatree(user_runs["posterior"] / "posterior.nc")
    assert tree.attrs["kind"] == "posterior" and tree["predictions"].attrs["kind"] == "predictions"
    summary = tree.sunspin.summary()
    printed = json.loads((user_runs["posterior"] / "summary.json").read_text("utf-8"))
    assert summary["verdict"] == printed["verdict"]
    assert len(summary["predicted"]) == len(printed["predicted"]) == 20
    for name in ("corner", "search", "predicted"):
        assert isinstance(tree.sunspin.plot(name), Figure)
    found = tree["predictions"].to_dataset()
    assert isinstance(found.sunspin.plot(), Figure) and "at 600 s" in str(found.sunspin.summary())
    tree.sunspin.save(tmp_path / "saved")
    names = {path.name for path in (tmp_path / "saved").iterdir()}
    assert {"posterior.nc", "solutions.csv", "corner.svg", "predicted.csv"} <= names


def test_rates_name_a_panel_that_was_left_out():
    result = rates()
    assert result.attrs["panels_left_out"] == "" and "left out" not in str(result.sunspin.summary())
    said = result.assign_attrs(panels_left_out="+X, -Y").sunspin.summary()
    assert said["panels_left_out"] == ["+X", "-Y"]
    assert "panel +X, -Y: no signal in any sample" in str(said)


def test_rates_are_printed_in_degrees_a_second(user_runs):
    tree, made = xr.load_datatree(user_runs["posterior"] / "posterior.nc"), [scan(), motion()]
    shown = re.search(r"omega \((.*?)\) deg/s", str(tree.sunspin.summary()))
    likeliest = np.degrees(tree["solutions"]["omega_B"].values[0])
    values = [float(text.split(" ± ")[0]) for text in shown[1].split(", ")] if shown else []
    assert values == pytest.approx(likeliest, abs=0.01)
    for result, key in zip(made, ("best_omega_B", "omega_B"), strict=True):
        summary = result.sunspin.summary()
        assert rate_text(summary[key]) in str(summary)
    assert rate_text([0.1, 0.0, -np.pi]) == "(5.73, 0, -180) deg/s"
    modes = pd.read_csv(user_runs["posterior"] / "solutions.csv", comment="#")
    np.testing.assert_allclose(
        modes["omega_x_B_deg_s"], np.degrees(modes["omega_x_B_rad_s"]), rtol=1e-7
    )


def test_outcomes_of_strategies_are_printed_side_by_side(user_runs):
    table = xr.load_dataset(user_runs["outcomes"] / "strategies.nc")
    assert table.attrs["kind"] == "strategies" and isinstance(table.sunspin.plot(), Figure)
    printed = json.loads((user_runs["outcomes"] / "summary.json").read_text("utf-8"))
    assert table.sunspin.summary()["strategies"] == printed["strategies"]
    runs = xr.load_dataset(user_runs["outcomes"] / "outcomes-held.nc")
    assert runs.attrs["kind"] == "outcomes"
    assert runs.attrs["seed"] == 0
    assert "wheels held: 20 runs" in str(runs.sunspin.summary())


def test_simulated_telemetry_is_saved_as_telemetry():
    truth = {"omega_B": OMEGA, "sun_B": SUN, "t_s": np.arange(0.0, 300.0, 60.0)}
    assert ss.twin(VEHICLE, truth, seed=1).attrs["kind"] == "telemetry"


def test_panel_health_keeps_its_panel_names():
    """Scripts ask a health by these names and iterate over them; a Dataset is what is stored."""
    health = ss.panel_health(VEHICLE, TELEMETRY)
    assert isinstance(health, xr.Dataset)
    assert health["lost"].values.tolist() == [[True, *5 * [False]]]
    assert health["explanations"] == [("1",)] and len(health["allowed"]) == 16
    assert all(n > 0 for n in health["impossible"].values())
    assert list(health["noise"]) == list(health["impossible"])
    assert all(one.log10_together < 0 for one in health["noise"].values())
    directions = ss.panel_health(VEHICLE, ss.sun_directions(VEHICLE, TELEMETRY))
    assert directions["noise"] == {} and np.isnan(directions["largest"]).all()
    none = ss.panel_health(VEHICLE, ss.panel_power(VEHICLE, [SUN]))
    assert none["impossible"] == {} and none["explanations"] == []
    assert "all illumination patterns" in str(none.sunspin.summary())
    assert isinstance(none.sunspin.plot(), Figure)


@pytest.mark.parametrize("attrs", [{}, {"kind": "house"}, {"kind": 3}])
def test_a_dataset_that_is_no_result_is_refused_in_one_sentence(attrs, tmp_path):
    result = xr.Dataset(attrs=attrs).sunspin
    for use in (result.summary, result.plot, lambda: result.save(tmp_path / "never")):
        with pytest.raises(ss.InputError, match="this Dataset is no result of sunspin") as told:
            use()
        assert "\n" not in str(told.value)
    assert not (tmp_path / "never").exists()


def test_each_kind_of_result_is_registered_by_the_module_that_is_imported_for_it():
    modules = set(MODULES.values())
    for module in modules:
        import_module(f"sunspin.output.kinds.{module}")
    assert set(KINDS) == set(MODULES)
    for name, kind in KINDS.items():
        assert kind.summary.__module__ == f"sunspin.output.kinds.{MODULES[name]}", name
