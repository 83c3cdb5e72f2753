"""The law by which panels see light is in one place: other laws than the cosine, and every public result that follows them.

Three laws beside the cosine's: losses at grazing incidence, a wall (the panel at +x is dark wherever y > 0.3: neither symmetric nor
smooth, and one reading has two directions), and a panel tilted by an unknown.
"""

from dataclasses import replace

import numpy as np
import pytest
import xarray as xr
from scipy.spatial.transform import Rotation
from scipy.stats import wasserstein_distance

import sunspin as ss
from sunspin.estimate.scan.mask import allows, reconstructible_mask
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import Dense, dense
from sunspin.telemetry.gains import brightness
from sunspin.telemetry.health import noise_alone
from sunspin.telemetry.sun import (
    SunStatus,
    best_directions,
    is_reconstructed,
    reconstructible_patterns,
)
from sunspin.vehicle import Panel, TelemetryForm, Vehicle
from sunspin.vehicle.file import parse_vehicle
from sunspin.vehicle.response.choice import ResponseForm
from sunspin.vehicle.response.cosine import Cosine
from sunspin.vehicle.response.cube import SphereTable
from sunspin.vehicle.response.grazing import Grazing
from sunspin.vehicle.response.inside import between, seen
from sunspin.vehicle.response.panels import lit_patterns, observable_patterns
from sunspin.vehicle.response.protocol import sphere
from sunspin.vehicle.response.tabled import Tabled
from sunspin.vehicle.response.tilted import Tilted
from sunspin.vehicle.response.wall import Wall
from vehicles import FIRST_SUN

PHILAE = ss.load_vehicle("philae")
NOISE = 0.004
CUBE = Vehicle(
    "cube",
    gain_unit="A",
    panels=[
        Panel(f"{'+-'[k // 3]}{'xyz'[k % 3]}", normal, 0.5)
        for k, normal in enumerate(np.vstack([np.eye(3), -np.eye(3)]))
    ],
    telemetry=TelemetryForm(quantity="current_A", noise=NOISE),
)
TURN = np.array([0.0, 0.12, 0.15])
BODY = replace(CUBE, inertia_kg_m2=np.diag([0.010, 0.012, 0.008]))
KNOWN = {"max_rate_rad_s": 0.1, "inertia": 0.0, "steady_torque": 0.0}
FACING = Rotation.from_rotvec(TURN).apply([1.0, 0.0, 0.0])
LAWS = {"grazing": Grazing(0.6), "wall": Wall("+x", [0, 1, 0], 0.3), "tilted": Tilted("+x", TURN)}


OF_PHILAE = LAWS | {"wall": Wall("3", [0, 0, 1], 0.5), "tilted": Tilted("3", TURN)}


def under(law, vehicle=CUBE):
    given = LAWS if vehicle is CUBE else OF_PHILAE
    return (
        vehicle
        if law == "cosine"
        else replace(vehicle, panel_response=ResponseForm(**{law: given[law]}))
    )


def directions(n, seed=0):
    sun = np.random.default_rng(seed).normal(size=(n, 3))
    return sun / np.linalg.norm(sun, axis=1, keepdims=True)


def readings(vehicle, n, seed=0, sigma=NOISE):
    sun = directions(n, seed)
    noise = sigma * np.random.default_rng(seed + 1).normal(size=(n, len(vehicle.panels)))
    return np.maximum(ss.panel_power(vehicle, sun) + noise, 0.0), sun


def _tangent(slope, sun):
    return slope - (slope * sun[:, None]).sum(axis=-1, keepdims=True) * sun[:, None]


def telemetry(value):
    time = np.arange(len(value)) * 30.0
    return xr.Dataset(
        {"current_A": (("time", "panel"), value)}, {"time": time, "panel": list(CUBE.panel_names)}
    )


def tumbling(vehicle, samples, seed=0):
    """Telemetry of a cube that turns at 3 deg/s, a reading in 20 s, and its rate at the first."""
    body = replace(BODY, panel_response=vehicle.panel_response)
    rate, sun = 0.05 * directions(1, seed)[0], directions(1, seed + 1)[0]
    return ss.twin(
        body,
        {"omega_B": rate, "sun_B": sun, "t_s": 20.0 * np.arange(samples), "scale": 1.0},
        seed=seed,
    ), rate


def lit_names(vehicle, sun):
    names = vehicle.panel_names
    codes, which = np.unique(
        (ss.panel_power(vehicle, sun) > 0) @ (1 << np.arange(len(names))), return_inverse=True
    )
    patterns = [
        frozenset(name for k, name in enumerate(names) if code >> k & 1) for code in codes.tolist()
    ]
    return [patterns[k] for k in which]


# ------------------------------------------------------------------------------------------------------------------ what a law is


@pytest.mark.parametrize(
    ("law", "sun", "power"),
    [
        (
            "grazing",
            [0.6, 0.8, 0.0],
            [0.5 * 0.6 * (1 - 0.6 * 0.4**5), 0.5 * 0.8 * (1 - 0.6 * 0.2**5), 0, 0, 0, 0],
        ),
        ("wall", [0.8, 0.6, 0.0], [0.0, 0.3, 0, 0, 0, 0]),
        ("wall", [0.8, -0.6, 0.0], [0.4, 0, 0, 0, 0.3, 0]),
        ("tilted", FACING, [0.5, *(0.5 * FACING[1:]), 0, 0, 0]),
    ],
)
def test_powers_by_hand(law, sun, power):
    expected = np.maximum(power, 0) + [0, 0, 0, 0, 0, 0.5 * max(-sun[2], 0)]
    np.testing.assert_allclose(ss.panel_power(under(law), sun), expected, atol=1e-15)


@pytest.mark.parametrize("law", ["cosine", *LAWS])
def test_slopes_are_those_of_the_powers(law):
    """On directions farther than the step of the differences from an edge, the Sun's and the panels' tilt both."""
    response, sun, step = under(law).response_in(), directions(200, 1), 1e-4
    tilt = 0.05 * np.random.default_rng(2).normal(size=(200, 6, 3))
    power, to_sun, _ = response.slopes(sun, tilt=tilt)
    assert np.array_equal(power, response.power(sun, tilt=tilt))
    for axis in np.eye(3):
        ahead, behind = (Rotation.from_rotvec(sign * step * axis).apply(sun) for sign in (1, -1))
        of_sun = (response.power(ahead, tilt=tilt) - response.power(behind, tilt=tilt)) / (2 * step)
        smooth = (
            np.abs(response.power(ahead, tilt=tilt) + response.power(behind, tilt=tilt) - 2 * power)
            < 1e-7
        )
        np.testing.assert_allclose(
            of_sun[smooth], (to_sun @ np.cross(axis, sun)[..., None])[..., 0][smooth], atol=2e-6
        )
        turned = [
            response.power(sun, tilt=sign * step * axis + np.zeros((6, 3))) for sign in (1, -1)
        ]
        about_none = response.slopes(sun, tilt=np.zeros((6, 3))).to_tilt @ axis
        smooth = np.abs(turned[0] + turned[1] - 2 * response.power(sun)) < 1e-7
        np.testing.assert_allclose(
            ((turned[0] - turned[1]) / (2 * step))[smooth], about_none[smooth], atol=2e-6
        )
    assert smooth.mean() > 0.95
    steps = [np.cross(axis, sun) for axis in np.eye(3)]
    for turned in (None, tilt):
        plain = response.slopes(sun, tilt=turned)
        for step, along in zip(
            steps, response.along(sun, steps, gain=np.full(6, 1.1), tilt=turned), strict=True
        ):
            expected = np.where(
                plain.power > 0, 1.1 * np.einsum("npi,ni->np", plain.to_sun, step), 0.0
            )
            np.testing.assert_allclose(along, expected, atol=1e-9)


@pytest.mark.parametrize("law", ["cosine", *LAWS])
def test_what_a_response_promises(law):
    response, sun = under(law).response_in(), directions(60, 4)
    power = response.power(sun)
    assert power.min() >= 0 and np.isnan(response.power(np.full((2, 3), np.nan))).all()
    np.testing.assert_allclose(response.power(sun, gain=np.full(6, 1.1)), 1.1 * power, rtol=1e-14)
    light, by = response.under(sun * 3.0)
    np.testing.assert_allclose(light, 3 * power, atol=1e-12)
    np.testing.assert_allclose(
        np.where(power > 0, (by @ sun[..., None])[..., 0], 0), power, atol=1e-9
    )
    low, high = response.bounds(sun, 0.2)
    turns = Rotation.from_rotvec(
        0.2 * directions(300, 5) * np.random.default_rng(6).uniform(0, 1, (300, 1))
    )
    near = np.array([response.power(turn.apply(sun)) for turn in turns])
    assert (near >= low - 1e-12).all() and (near <= high + 1e-12).all()
    assert (high - low).max() < 0.5 * (1 if law == "wall" else 0.7)  # of use, too
    assert np.isnan(response.bounds(np.full((2, 3), np.nan), 0.2)).all()
    errors = Rotation.from_rotvec(0.1 * np.random.default_rng(7).normal(size=(2000, 3)))
    blurred = np.mean([response.power(error.apply(sun)) for error in errors], axis=0)
    np.testing.assert_allclose(
        response.power(sun, blur_rad=0.1), blurred, atol=0.5 * (0.12 if law == "wall" else 0.015)
    )


@pytest.mark.parametrize("law", ["cosine", "grazing", "tilted"])
def test_the_earths_light_has_the_slope_it_says(law):
    response, axis, step = under(law).response_in(), directions(30, 8), 1e-4
    light, slope = response.disc(axis, np.full(30, 0.3))
    cosine = CUBE.response_in().disc(axis, np.full(30, 0.3))
    for one in np.eye(3):
        ends = [axis * 0.3 + sign * step * one for sign in (1, -1)]
        size = [np.linalg.norm(end, axis=1) for end in ends]
        ahead, behind = (
            response.disc(end / length[:, None], length)[0]
            for end, length in zip(ends, size, strict=True)
        )
        np.testing.assert_allclose((ahead - behind) / (2 * step), slope @ one, atol=0.02 * 0.5)
    alike = slice(1 if law == "tilted" else 0, None)
    np.testing.assert_allclose(light[:, alike], cosine[0][:, alike], atol=0.04 * 0.5)


def test_body_and_sun_turned_together_change_nothing():
    turn = Rotation.from_rotvec([0.4, -1.0, 0.3])
    normals = turn.apply(CUBE.panel_normals_B)
    turned = replace(
        CUBE,
        panels=[replace(p, normal_B=n) for p, n in zip(CUBE.panels, normals, strict=True)],
        panel_response=ResponseForm(wall=Wall("+x", turn.apply([0, 1, 0]), 0.3)),
    )
    power, sun = readings(under("wall"), 300)
    np.testing.assert_allclose(
        ss.panel_power(turned, turn.apply(sun)), ss.panel_power(under("wall"), sun), atol=1e-14
    )
    np.testing.assert_allclose(
        best_directions(turned, power)[1], best_directions(under("wall"), power)[1], atol=1e-5
    )  # at edges


# ---------------------------------------------------------------------------------- the table's way, where the closed form knows


@pytest.mark.parametrize(
    "vehicle",
    [pytest.param(PHILAE, marks=pytest.mark.long, id="philae"), pytest.param(CUBE, id="cube")],
)
def test_what_is_looked_up_agrees_with_the_closed_form(vehicle, monkeypatch):
    """No loss at all is the cosine's law, and everything that is found by looking must be what the planes give."""
    sigma = 0.008 * vehicle.panel_gains.max()
    power, _ = readings(vehicle, 200, sigma=sigma)
    exact = vehicle.response_in()
    looked = Tabled(vehicle.panel_normals_B, vehicle.panel_gains, Grazing(0.0), vehicle.panel_names)
    assert isinstance(exact, Cosine)
    above = (
        looked.best(power)[1] - exact.best(power)[1]
    )  # along an edge; in a corner where three panels graze the look is coarser
    assert (
        above.max() < 0.01 and np.quantile(above, 0.98) < 2e-4 and np.median(np.abs(above)) < 1e-12
    )
    before, patterns, seen = (
        ss.sun_directions(vehicle, power, noise=sigma),
        lit_patterns(vehicle),
        observable_patterns(vehicle),
    )
    mask, health = reconstructible_mask(vehicle), ss.panel_health(vehicle, power, noise=sigma)
    monkeypatch.setattr(Vehicle, "response_in", lambda self, phase=None: looked)
    after = ss.sun_directions(vehicle, power, noise=sigma)
    # a look may end on an arc of equals that the planes leave by some 1e-4 of Delta
    other = (after["status"] != before["status"]).values
    assert other.mean() <= 0.01 and (after["status"].values[other] == SunStatus.SEVERAL).all()
    same = is_reconstructed(before["status"].values)
    assert same.any()
    same[same] = np.abs(after["sun_B"].values - before["sun_B"].values)[same].max(axis=1) < 1e-6
    assert (
        same.sum() > 0.9 * is_reconstructed(before["status"].values).sum()
    )  # the others' minimum is on an edge
    assert (
        np.median(np.abs(after["sigma_rad"].values / before["sigma_rad"].values - 1)[same]) < 0.05
    )
    ours, theirs = (np.sort(ds["sun_arc_B"].values[..., 2], axis=1) for ds in (after, before))
    both = np.isfinite(theirs).all(axis=1) & np.isfinite(ours).all(
        axis=1
    )  # no region of the cube leaves an arc
    assert both.any() == (vehicle is PHILAE) and np.abs(ours - theirs)[both].max(initial=0.0) < 1e-3
    assert lit_patterns(vehicle) == patterns and observable_patterns(vehicle) >= seen
    assert ss.panel_health(vehicle, power, noise=sigma)["allowed"] == health["allowed"]
    sun = directions(100_000, 3)
    assert np.mean(allows(reconstructible_mask(vehicle), sun) != allows(mask, sun)) < 5e-4


@pytest.mark.parametrize("law", ["cosine", *LAWS])
def test_compiled_code_reads_the_same_law(law):
    """Powers, slopes and bounds, on directions away from edges, where a table is no table's error off."""
    response, sun, angles = under(law).response_in(), directions(40, 21), (0.1, 0.35)
    inside, exact = response.inside(angles), response.slopes(sun)
    read = np.array([[seen(inside, k, *one) for k in range(6)] for one in sun])
    low, high = response.bounds(sun, 0.06)
    lit, away = low > 0, (low > 0) | (high == 0)
    assert away.mean() > 0.7
    np.testing.assert_allclose(
        0.5 * read[..., 0][away], exact.power[away], atol=1e-15 if law == "cosine" else 2e-3
    )
    np.testing.assert_allclose(
        0.5 * _tangent(read[..., 1:], sun)[lit],
        exact.to_sun[lit],
        atol=1e-15 if law == "cosine" else 0.05,
    )
    for number, angle in enumerate(angles):
        bounds = np.array([[between(inside, number, k, *one) for k in range(6)] for one in sun])
        np.testing.assert_allclose(
            0.5 * np.moveaxis(bounds, -1, 0), response.bounds(sun, angle), atol=1e-7
        )


@pytest.mark.parametrize("law", ["grazing", "wall", "tilted"])
def test_the_table_reads_to_the_error_it_states(law):
    response, sun = under(law).response_in(), directions(20_000, 9)
    table = response.table(1e-3)
    assert (
        isinstance(table, SphereTable) and table.numbers.dtype == np.float32 and table.error <= 1e-3
    )
    power, slope = table.read(sun)
    away = np.abs(power - response.power(sun) / 0.5)
    assert np.mean((away > 1.2 * table.error).any(axis=1)) < table.edges < 0.3
    exact = response.slopes(sun).to_sun / 0.5
    assert (
        np.median(np.abs(slope - exact)) < 1e-3 and np.percentile(np.abs(slope - exact), 90) < 0.02
    )
    assert np.isnan(table.read(np.full((1, 3), np.nan))[0]).all()


# ------------------------------------------------------------------------------------------------------------- directions follow


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("share", [0.01, 0.1])
def test_the_minimum_of_delta_is_global(law, share, reached):
    """Against 200,000 directions: readings with little and with much noise."""
    vehicle = under(law)
    exact = ss.panel_power(vehicle, directions(100, 11))
    power = np.maximum(
        exact + 0.5 * share * np.random.default_rng(12).normal(size=exact.shape), 0.0
    )
    shape = ss.panel_power(vehicle, sphere(200_000))
    shape /= np.linalg.norm(shape, axis=1, keepdims=True)
    least = np.sqrt(
        np.maximum(
            2 - 2 * (power / np.linalg.norm(power, axis=1, keepdims=True) @ shape.T).max(axis=1), 0
        )
    )
    _, delta = best_directions(vehicle, power)
    reached("Delta above the best of the grid", (delta - least).max(), "", 1e-6)
    assert (delta - least).max() < 1e-6
    if law != "wall":  # where the cosine's law has its minimum, too, or the same elsewhere
        away = ss.panel_power(vehicle, best_directions(CUBE, power)[0])
        away = away / np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-300)
        assert (
            np.linalg.norm(away - power / np.linalg.norm(power, axis=1, keepdims=True), axis=1)
            > delta + 1e-4
        ).mean() > 0.2


@pytest.mark.parametrize("law", ["grazing", pytest.param("tilted", marks=pytest.mark.long)])
def test_directions_come_back_and_err_as_they_say(law):
    vehicle = under(law)
    power, sun = readings(vehicle, 300)
    found = ss.sun_directions(vehicle, power)
    told = is_reconstructed(found["status"].values)
    angle = np.arccos(np.clip((found["sun_B"].values * sun).sum(axis=1), -1, 1))[told]
    assert told.mean() > 0.85
    squared = (angle / found["sigma_rad"].values[told]) ** 2
    assert np.median(squared) == pytest.approx(np.log(2), rel=0.25)  # two degrees of freedom
    biased = ss.sun_directions(replace(vehicle, panel_response=ResponseForm()), power)
    wrong = np.arccos(np.clip((biased["sun_B"].values * sun).sum(axis=1), -1, 1))
    assert (
        np.nanpercentile((wrong / biased["sigma_rad"].values) ** 2, 80) > 6
    )  # 3.2 where all is well


def test_behind_a_wall_one_reading_has_two_directions():
    """The panel at +x dark and those at +y and +z lit: the Sun may stand to either side of the plane of x where y > 0.3."""
    vehicle = under("wall")
    twice = ss.panel_power(
        vehicle, [[0.0, 0.6, 0.8], [0.5, 0.6 * np.sqrt(0.75), 0.8 * np.sqrt(0.75)]]
    )
    twice /= np.linalg.norm(twice, axis=1, keepdims=True)
    np.testing.assert_allclose(twice[0], twice[1], atol=1e-12)
    found = ss.sun_directions(vehicle, twice)
    assert (found["delta"].values < 1e-7).all() and not is_reconstructed(
        found["status"].values
    ).any()


def test_a_tilted_panel_is_a_panel_that_stands_elsewhere():
    """Directions, quality and health as of a vehicle whose file says so."""
    stands = replace(
        CUBE,
        panels=[
            replace(CUBE.panels[0], normal_B=Rotation.from_rotvec(TURN).apply([1, 0, 0])),
            *CUBE.panels[1:],
        ],
    )
    power, _ = readings(stands, 60)
    ours, theirs = (ss.sun_directions(vehicle, power) for vehicle in (under("tilted"), stands))
    assert np.array_equal(ours["status"], theirs["status"])
    np.testing.assert_allclose(ours["sun_B"], theirs["sun_B"], atol=1e-6)
    ours, theirs = (
        ss.panel_quality(vehicle, telemetry(power)) for vehicle in (under("tilted"), stands)
    )
    np.testing.assert_allclose(ours["gain"], theirs["gain"], rtol=1e-4)
    np.testing.assert_allclose(ours["sigma"], theirs["sigma"], rtol=1e-3)
    assert (
        ss.panel_health(under("tilted"), power)["allowed"]
        == ss.panel_health(stands, power)["allowed"]
    )


def test_an_unknown_tilt_follows_from_the_readings_by_the_slopes():
    """300 readings of known directions give it back within its error, from none."""
    rng, sun, sigma = np.random.default_rng(3), directions(300, 14), 0.002
    tilt = np.zeros((6, 3))
    tilt[0] = [0.0, 0.05, -0.08]
    value = CUBE.response_in().power(sun, tilt=tilt) + sigma * rng.normal(size=(300, 6))

    def linearise(state):
        power, _, to_tilt = CUBE.response_in().slopes(
            sun, tilt=np.concatenate([state, np.zeros((5, 3))])
        )
        return Dense.of(
            (power - value)[None, :, 0] / sigma, to_tilt[None, :, 0] / sigma, np.ones((1, 3))
        )

    found = least_squares(
        linearise, lambda state, step: state + step, dense, np.zeros((1, 3)), steps=20
    )
    error = found.state[0] - tilt[0]
    assert (np.abs(error[1:]) < 4 * sigma / 0.5 / np.sqrt(50)).all() and np.abs(
        found.state[0, 1:]
    ).min() > 0.03


# -------------------------------------------------------------------------------------------------- quality, gains, health, mask


@pytest.mark.parametrize("law", [pytest.param("grazing", marks=pytest.mark.long), "wall", "tilted"])
def test_quality_finds_nothing_wrong_with_readings_of_the_law_itself(law):
    """Full Sun is full Sun by the law that holds, and gains come out as they are; by the cosine's law it is not."""
    vehicle = under(law)
    power, _ = readings(vehicle, 200)
    quality = ss.panel_quality(vehicle, telemetry(power))
    assert (quality["use"].values == 0).mean() > 0.99 and np.abs(
        quality["gain"].values / 0.5 - 1
    ).max() < 0.02
    if (
        law != "wall"
    ):  # a Sun in front of it and another behind may read the same but for their brightness
        ours, cosine = (np.abs(brightness(v, power) - 1).mean() for v in (vehicle, CUBE))
        assert ours < 0.03 and cosine > 1.5 * ours


@pytest.mark.parametrize(
    "law", ["grazing", *(pytest.param(law, marks=pytest.mark.long) for law in ("wall", "tilted"))]
)
def test_health_knows_what_the_law_lights(law):
    vehicle = under(law, PHILAE)
    shown = set(lit_names(vehicle, directions(100_000, 15)))
    clean = ss.panel_power(
        vehicle, directions(60 if law == "wall" else 30, 16)
    )  # few of them fall on the wall
    assert {
        frozenset(pattern) for pattern in ss.panel_health(vehicle, clean[:5])["allowed"]
    } == shown
    assert ss.panel_health(vehicle, clean, lit_threshold=0.1)["impossible"] == {}
    assert ("1",) in ss.panel_health(vehicle, clean * [0, 1, 1, 1, 1, 1], lit_threshold=0.1)[
        "explanations"
    ]
    if law == "wall":  # the cosine's law would accuse the panel in the shadow
        assert ss.panel_health(PHILAE, clean, lit_threshold=0.1)["explanations"] == [("3",)]


@pytest.mark.parametrize("law", LAWS)
def test_noise_alone_finds_the_nearest_sun_of_the_law(law):
    """Against a grid of directions with the best brightness of each."""
    vehicle = under(law)
    power, _ = readings(vehicle, 20, 18)
    power[:, 2] *= 0.3
    found = noise_alone(vehicle, power, NOISE, 3 * NOISE)
    shape = ss.panel_power(vehicle, sphere(20_000))
    lit = power > 3 * NOISE
    for value, on, ours in zip(power, lit, found.chi_square, strict=True):
        seen = shape * on
        bright = np.maximum(seen @ value, 0) / np.maximum((seen**2).sum(axis=1), 1e-12)
        away = (
            np.where(
                on,
                bright[:, None] * shape - value,
                np.maximum(bright[:, None] * shape - 3 * NOISE, 0),
            )
            / NOISE
        )
        assert ours <= (away**2).sum(axis=1).min() + 1e-3


@pytest.mark.parametrize(
    "law", ["wall", *(pytest.param(law, marks=pytest.mark.long) for law in ("grazing", "tilted"))]
)
def test_the_mask_allows_what_the_law_allows(law):
    vehicle = under(law, PHILAE)
    good, sun = reconstructible_patterns(vehicle), directions(100_000, 19)
    expected = np.array([pattern in good for pattern in lit_names(vehicle, sun)])
    assert 0.1 < expected.mean() < 1
    assert np.mean(allows(reconstructible_mask(vehicle), sun) != expected) < 1e-3
    if law == "wall":
        assert np.mean(allows(reconstructible_mask(PHILAE), sun) != expected) > 0.02


def test_the_scan_counts_what_the_law_allows(reached):
    """Philae with a wall beside its third panel: the kernel's table against the reference's motion and the law itself."""
    vehicle = under("wall", PHILAE)
    target, rng = np.random.default_rng(1).uniform(0.05, 0.98, 15), np.random.default_rng(20)
    good, error, moved = reconstructible_patterns(vehicle), [], []
    for omega in np.column_stack(
        [rng.uniform(-0.5, 1, 5), rng.uniform(-0.5, 1, 5), rng.uniform(-0.3, 0.3, 5)]
    ):
        track = ss.propagate(
            vehicle, omega, FIRST_SUN, 865.0, np.linspace(0, 900, 18001), rtol=1e-9
        )["sun_B"].values
        counts = np.array([pattern in good for pattern in lit_names(vehicle, track)])
        ours = [
            ss.scan(v, target, FIRST_SUN, *omega[:, None], 865.0, 900.0).item()
            for v in (vehicle, PHILAE)
        ]
        error.append(abs(ours[0] - wasserstein_distance(track[counts, 2], target) / 2))
        moved.append(abs(ours[0] - ours[1]))
    reached("largest difference of EMD", max(error), "", 2e-3)
    assert max(error) < 2e-3 and np.median(moved) > 10 * max(error)


# ------------------------------------------------------------------------------------------------------- one place, and its file


@pytest.mark.long
def test_replacing_the_response_moves_every_public_result(monkeypatch):
    """Whatever asks how panels see light asks `vehicle.response_in`."""
    power, _ = readings(PHILAE, 60)
    value, flight = telemetry(readings(CUBE, 60)[0]), tumbling(CUBE, 8)[0]

    def results():
        truth = {"omega_B": [0.1, 0.2, 0.3], "sun_B": [0.6, 0.0, 0.8], "t_s": np.arange(20) * 10.0}
        synthetic = ss.twin(PHILAE, truth=truth)
        sun = ss.sun_directions(PHILAE, power, noise=NOISE)
        return {
            "panel_power": ss.panel_power(PHILAE, [0.6, 0.0, 0.8]),
            "sun_B": sun["sun_B"].values,
            "delta": sun["delta"].values,
            "sun_cov_B": sun["sun_cov_B"].values,
            "status": sun["status"].values,
            "health": [str(ss.panel_health(PHILAE, power)["allowed"])],
            "noise": noise_alone(PHILAE, power, NOISE, 3 * NOISE).chi_square,
            "quality": ss.panel_quality(CUBE, value)["gain"].values,
            "twin": synthetic["power_W"].values,
            "mask": allows(reconstructible_mask(PHILAE), directions(4000)),
            "rates": ss.rates(BODY, flight)["omega_B"].values,
            "posterior": ss.posterior(BODY, flight, KNOWN, draws=50, workers=1)["posterior"][
                "omega_B"
            ].values,
        }

    def other(self, phase=None):
        return Tabled(
            self.panel_normals_B,
            self.panel_gains,
            Wall(self.panel_names[2], [0, 0, 1], 0.2),
            self.panel_names,
        )

    before = results()
    monkeypatch.setattr(Vehicle, "response_in", other)
    after = results()
    assert not [
        name
        for name in before
        if np.asarray(before[name]).tobytes() == np.asarray(after[name]).tobytes()
    ]


FILE = """
name = "one"
[[panel]]
name = "a"
normal_B = [1, 0, 0]
gain_W = 1.0
"""


def test_the_vehicle_file_names_the_law():
    wall = parse_vehicle(
        FILE + "[panel_response.wall]\npanel = 'a'\ntoward_B = [0, 1, 0]\nabove = 0.3", "file"
    )
    assert ss.panel_power(wall, [0.8, 0.6, 0.0]).tolist() == [0.0]
    turn = "turn_B_rad = { value = [0, 0, 0.1], sigma = 0.02, source = 'drawing' }"
    tilted = parse_vehicle(f"{FILE}[panel_response.tilted]\npanel = 'a'\n{turn}", "file")
    assert tilted.facts["panel_response.tilted.turn_B_rad"].sigma == 0.02
    assert ss.panel_power(tilted, [1.0, 0, 0]) == pytest.approx(np.cos(0.1))
    assert tilted.response_in() is tilted.response_in("rest")


@pytest.mark.parametrize(
    ("table", "words"),
    [
        (
            "[panel_response.grazing]\nloss = 1.5",
            ["panel_response.grazing.loss", "between 0 and 1", "1.5"],
        ),
        ("[panel_response.mirror]\nloss = 1", ["panel_response.mirror", "unknown key", "grazing"]),
        (
            "[panel_response]\ngrazing.loss = 0.1\ntilted = { panel = 'a', turn_B_rad = [0, 0, 0] }",
            ["one law", "keep one"],
        ),
        (
            "[panel_response.wall]\npanel = 'b'\ntoward_B = [0, 1, 0]\nabove = 0.3",
            ["panel_response", "not have", "panels: ['a']"],
        ),
    ],
)
def test_a_wrong_law_is_refused_in_one_sentence(table, words):
    with pytest.raises(ss.VehicleError) as error:
        parse_vehicle(FILE + table, "my.toml")
    assert all(word in str(error.value) for word in ["my.toml", *words])


@pytest.mark.long
@pytest.mark.parametrize("law", ["grazing", "tilted"])
def test_rates_follow(law, reached):
    """A cube that turns at 1.5 deg/s, 30 readings in five minutes: by the law that holds, and by the cosine's."""
    body = replace(CUBE, inertia_kg_m2=np.diag([0.002, 0.0021, 0.0022]))
    vehicle = replace(body, panel_response=under(law).panel_response)
    run = ss.propagate(
        vehicle,
        np.radians(1.5) * directions(1)[0],
        directions(1, 5)[0],
        [],
        np.arange(0, 300, 10.0),
    )
    power = ss.panel_power(vehicle, run["sun_B"].values)
    power = np.maximum(power + NOISE * np.random.default_rng(0).normal(size=power.shape), 0.0)
    data = telemetry(power).assign_coords(time=run["time"].values)
    error = [
        float(np.abs(ss.rates(v, data)["omega_B"].values - run["omega_B"].values).max())
        for v in (vehicle, body)
    ]
    reached("error of the rate over the cosine's", error[0] / error[1])
    assert error[0] < error[1] / 3


def sigmas_off(vehicle, flight, rate):
    """How far (sigmas) the true rate is from the heaviest region, and what the verdict is."""
    body = replace(BODY, panel_response=vehicle.panel_response)
    found = ss.posterior(body, flight, KNOWN, draws=500, workers=1)
    off = rate - found["modes"]["omega_B"].values[0]
    return float(
        np.sqrt(off @ np.linalg.solve(found["modes"]["omega_cov_B"].values[0], off))
    ), found.attrs["verdict_word"]


@pytest.mark.long
@pytest.mark.parametrize("law", LAWS)
def test_posteriors_follow(law, reached):
    """A cube that turns at 3 deg/s, 24 readings: the law that holds has the truth, the cosine in its place is off or refused."""
    flight, rate = tumbling(under(law), 24)
    away, word = sigmas_off(under(law), flight, rate)
    reached("distance of the true rate", away, "sigmas", 16.3**0.5)
    assert away < 16.3**0.5 and word == "unique"  # 99.9 % of three numbers
    if law != "wall":  # this motion does not come near it
        away, word = sigmas_off(CUBE, flight, rate)
        assert word == "not explained" or away > 16.3**0.5
