"""Simulated telemetry: reproducible from its seed, consistent with published facts, exact without noise."""

import re
import tomllib

import numpy as np
import pytest

import sunspin as ss
from sunspin.philae import telemetry as selection
from sunspin.philae.simulation import philae_twin
from sunspin.philae.telemetry import find_printed_rebounds, main, make_landing
from sunspin.telemetry.sun import is_reconstructed
from sunspin.vehicle import Panel, Vehicle
from tests.support.philae import AS_DRAWN, AS_DRAWN_FILE, AS_DRAWN_TRUTH, SUN_AS_DRAWN

case = ss.load_case("philae")
vehicle = case.vehicle
committed = case.telemetry
truth = tomllib.loads((case.folder / "twin_truth.toml").read_text("utf-8"))
phase = committed["phase"].values
former_phase = AS_DRAWN.telemetry["phase"].values
published = {key: figure.value for key, figure in case.published.items()}
FLIGHTS = ["descent", "first_rebound", "second_rebound"]
KNOWN = {"omega_B": [0, 0, 0.1], "sun_B": [0.6, 0, 0.8], "t_s": [0.0, 1.0]}


@pytest.fixture
def synthesise(monkeypatch):
    """Run the command, for which every draw is the built-in landing: (exit code, the draw that it asked for)."""
    landing = committed.assign_attrs({f"truth_{key}": value for key, value in truth.items()})

    def run(draw, out):
        asked = []
        monkeypatch.setattr(
            selection, "make_landing", lambda _, *drawn: asked.append(drawn) or landing
        )
        return main(["--seed", str(truth["seed"]), "--draw", str(draw), str(out)]), asked

    return run


@pytest.fixture(scope="module")
def sun():
    return ss.sun_directions(vehicle, committed)


@pytest.mark.evidence("twin", "verified", "the telemetry file of the package")
@pytest.mark.slow
def test_the_built_in_telemetry_follows_from_its_seed_and_draw():
    """To make the landing takes most of a minute."""
    made = make_landing(case, truth["seed"], truth["draw"])
    # the file holds 6 decimals and whole milliseconds
    np.testing.assert_allclose(
        committed["power_W"].values, made["power_W"].values, rtol=0, atol=0.51e-6
    )
    np.testing.assert_allclose(committed["time"].values, made["time"].values, rtol=0, atol=1e-6)
    assert np.array_equal(phase, made["phase"].values)
    for key, value in truth.items():
        expected = made.attrs[f"truth_{key}"]
        number = isinstance(expected, str) or pytest.approx(expected, rel=1e-9, abs=1e-12)
        assert value == (expected if isinstance(expected, str) else number)


def test_synthesise_writes_the_built_in_telemetry_and_overwrites_nothing_unasked(
    synthesise, tmp_path, capsys
):
    """A draw that was not selected does not say so."""
    out, other = tmp_path / "telemetry.csv", truth["draw"] - 1
    assert synthesise(truth["draw"], out) == (0, [(truth["seed"], truth["draw"])])
    power = ss.read_telemetry(out, vehicle)["power_W"].values
    np.testing.assert_allclose(power, committed["power_W"].values, rtol=0, atol=1.01e-6)
    written = out.read_bytes()
    assert f"draw {truth['draw']} of first rebounds, selected because" in written.decode()
    assert synthesise(truth["draw"], out) == (2, [])
    assert "the file exists" in capsys.readouterr().err
    assert out.read_bytes() == written
    (tmp_path / "other").mkdir()
    assert synthesise(other, tmp_path / "other" / "a.csv") == (0, [(truth["seed"], other)])
    text = (tmp_path / "other" / "a.csv").read_text("utf-8")
    assert f"draw {other} of first rebounds, not compared with what the paper prints" in text
    assert "selected because" not in text


@pytest.mark.evidence("twin", "verified", "a telemetry file simulated with panels as drawn")
def test_the_telemetry_of_panels_as_drawn_follows_from_its_seed():
    again = philae_twin(AS_DRAWN_TRUTH["seed"], tilt_rad=0.0, turned_rad=0.0, rest_seen=False)
    np.testing.assert_allclose(
        AS_DRAWN.telemetry["power_W"].values, again["power_W"].values, rtol=0, atol=0.51e-6
    )
    assert "truth_tilt_B_rad" not in again.attrs
    assert "--seed 16 telemetry.csv" in AS_DRAWN_FILE.read_text("utf-8")
    known = is_reconstructed(SUN_AS_DRAWN["status"])
    mean = SUN_AS_DRAWN["delta"].values[known & np.isin(former_phase, FLIGHTS)].mean()
    assert mean == pytest.approx(published["delta_mean"], abs=0.0015)
    assert 14 <= known[former_phase == "first_rebound"].sum() <= 17


def test_the_built_in_telemetry_states_that_it_is_synthetic_and_how_it_was_made():
    comments = committed.attrs["comments"].splitlines()
    assert committed.attrs["synthetic"] == 1
    assert all(comment.startswith("synthetic:") for comment in comments)
    assert re.search(r"sunspin \d+\.\d+\.\d+", comments[0])
    command = f"python -m sunspin.philae.telemetry --seed {truth['seed']} --draw {truth['draw']} "
    assert command in comments[1] and "selected" in comments[2]


def test_the_first_direction_after_the_touchdown_is_the_published_one(sun):
    expected = np.array(published["first_sun"])
    for found, at in ((sun, phase), (SUN_AS_DRAWN, former_phase)):
        i = np.flatnonzero(at == "first_rebound")[0]
        unit = expected / np.linalg.norm(expected)
        np.testing.assert_allclose(found["sun_B"].values[i], unit, atol=1e-6)
    np.testing.assert_array_equal(AS_DRAWN_TRUTH["sun_B"], expected)
    # what turned panels show is not where the Sun stands
    assert 0.01 < np.linalg.norm(np.array(truth["sun_B"]) - expected) < 0.35


@pytest.mark.slow
@pytest.mark.evidence(
    "twin", "verified", "the search that selected the telemetry file of the package"
)
def test_the_search_finds_the_built_in_draw():
    """From the descent before it, to spare an hour: no other draw of the two descents is accepted."""
    draws = find_printed_rebounds(case, truth["seed"], truth["draw"] - 500)
    assert next(draws) == truth["draw"]


def test_a_simulated_landing_takes_a_true_rate():
    drawn, chosen = (ss.twin("philae", seed=3, omega_B=rate) for rate in (None, truth["omega_B"]))
    assert chosen.attrs["truth_omega_B"].tolist() == truth["omega_B"]
    before = drawn["phase"].values == "descent"
    np.testing.assert_array_equal(drawn["power_W"][before], chosen["power_W"][before])
    other = drawn["phase"].values == "first_rebound"
    assert np.abs(drawn["power_W"][other] - chosen["power_W"][other]).max() > 1.0


def test_sun_directions_of_noise_free_telemetry_are_the_true_ones():
    clean = philae_twin(0, noise=0.0, tilt_rad=0.0, turned_rad=0.0)
    found = ss.sun_directions(vehicle, clean)
    at = np.isin(phase, FLIGHTS) & is_reconstructed(found["status"])
    true = clean["true_sun_B"].values
    true = true / np.linalg.norm(true, axis=1, keepdims=True)
    assert at.sum() > 100
    np.testing.assert_allclose(found["sun_B"].values[at], true[at], rtol=0, atol=1e-9)
    assert np.abs(found["delta"].values[at]).max() < 1e-9


@pytest.fixture(scope="module")
def tilted():
    return philae_twin(3, tilt_rad=np.radians(1.0), turned_rad=np.radians(5.0), rest_seen=True)


@pytest.mark.evidence(
    "twin",
    "modelled",
    "misaligned panels: the published first direction, forbidden patterns, directions at rest",
)
def test_a_landing_simulated_with_misaligned_panels_has_the_published_misfit(tilted):
    """Of turned panels the first direction is still what is shown; the truth lies behind it; no pattern becomes forbidden."""
    at, seen = tilted["phase"].values, ss.sun_directions(vehicle, tilted)
    first, expected = np.flatnonzero(at == "first_rebound")[0], np.array(published["first_sun"])
    expected /= np.linalg.norm(expected)
    np.testing.assert_allclose(seen["sun_B"].values[first], expected, atol=1e-9)
    true = tilted["true_sun_B"].values[first]
    assert np.radians(0.5) < np.arccos(true @ expected) < np.radians(20)
    known = is_reconstructed(seen["status"])
    free = known & np.isin(at, FLIGHTS)
    cosine = np.sum(seen["sun_B"].values[free] * tilted["true_sun_B"].values[free], axis=1)
    off = np.arccos(np.clip(cosine, -1, 1))
    assert np.radians(2) < np.sqrt(np.mean(off**2)) < np.radians(20)
    delta = seen["delta"].values
    assert delta[free].mean() == pytest.approx(published["delta_mean"], abs=0.004)
    assert np.count_nonzero(known & (at == "rest")) == 5
    assert delta[known & (at == "rest")].min() > 3 * delta[free].mean()
    turns = tilted.attrs["truth_tilt_B_rad"].reshape(6, 3)
    assert turns.std(axis=0).max() < np.radians(4)
    assert np.linalg.norm(turns.mean(axis=0)) > np.radians(1)


def test_impossible_panel_misalignments_are_refused():
    with pytest.raises(ss.InputError, match="no Sun makes panels turned so far"):
        ss.twin(case, seed=0, turned_rad=2.0)
    with pytest.raises(ss.InputError, match="no options of the landing .found tilt_rad"):
        ss.twin(case, KNOWN, tilt_rad=0.1)


# ---- twins of any vehicle --------------------------------------------------------------------------------------------


@pytest.mark.evidence("twin", "modelled", "its own inverse")
def test_simulated_telemetry_of_any_vehicle_stores_its_truth_and_gives_it_back():
    normals = np.concatenate([np.eye(3), -np.eye(3)])
    faces = [Panel(str(k), normal, 2.0) for k, normal in enumerate(normals)]
    cube = Vehicle("cube", np.diag([0.01, 0.012, 0.015]), 1.0, panels=faces, gain_unit="W")
    known = {"omega_B": [0.1, -0.05, 0.2], "sun_B": [0.0, 0.6, 0.8]}
    known["t_s"] = np.arange(0.0, 600.0, 7.0)
    telemetry = ss.twin(cube, known, seed=4)
    run = ss.propagate(cube, known["omega_B"], known["sun_B"], None, known["t_s"])
    np.testing.assert_array_equal(telemetry["true_sun_B"].values, run["sun_B"].values)
    np.testing.assert_allclose(np.linalg.norm(telemetry["power_W"].values, axis=1), 2.0, rtol=1e-9)
    assert telemetry.attrs["truth_omega_B"].tolist() == known["omega_B"]
    assert telemetry.attrs["truth_noise"] == 0.0
    power = telemetry["power_W"].values
    noisy = ss.twin(cube, known | {"noise": 0.01}, seed=4)["power_W"].values
    assert (noisy - power)[power > 0.1].std() == pytest.approx(0.01, rel=0.2)
    assert np.all(noisy[power == 0] == 0)


@pytest.mark.parametrize(
    ("of", "truth", "options", "text"),
    [
        (case, KNOWN | {"rate": 1}, {}, "unknown rate"),
        (case, KNOWN | {"noise": -1.0}, {}, "zero or positive"),
        (case, KNOWN | {"scale": 0.0}, {}, "scale of a twin must be positive"),
        (case, {"omega_B": [0, 0, 0], "t_s": [0.0]}, {}, "no sun_B"),
        ("philae", None, {"seed": -1}, "seed must be a whole number"),
        (vehicle, None, {}, "needs a truth"),
    ],
)
def test_a_truth_without_valid_rates_and_sun_is_refused(of, truth, options, text):
    with pytest.raises(ss.InputError, match=text):
        ss.twin(of, truth, **options)


def test_an_existing_file_is_refused_before_the_search(tmp_path, monkeypatch, capsys):
    def search(*_):
        raise AssertionError("searched")

    monkeypatch.setattr(selection, "find_printed_rebounds", search)
    (tmp_path / "twin_truth.toml").write_text("mine", "utf-8")
    assert main([str(tmp_path / "telemetry.csv")]) == 2
    assert "the file exists" in capsys.readouterr().err
    assert not (tmp_path / "telemetry.csv").exists()
