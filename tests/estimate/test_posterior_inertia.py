"""Unphysical inertias are cut off from the prior of the posterior, in draws, fits and derivatives."""

from __future__ import annotations

import re
import warnings
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import sunspin as ss
from sunspin.base.errors import InputError, SunspinError
from sunspin.dynamics import batch
from sunspin.dynamics.bodies import Bodies
from sunspin.estimate.inertia import is_body
from sunspin.estimate.posterior import estimate, importance, modes
from sunspin.estimate.posterior.data import readings
from sunspin.estimate.posterior.fit import Fit
from sunspin.estimate.posterior.importance import Weigh
from sunspin.estimate.posterior.likelihood import Likelihood
from sunspin.estimate.posterior.model import State, model, require_computable
from sunspin.vehicle import Fact, Friction, Panel, TelemetryForm, Vehicle, Wheel
from tests.support.vehicles import LOWER_CASE_FACES, small_cube

SUN = np.array([0.3, 0.5, 0.8]) / np.linalg.norm([0.3, 0.5, 0.8])


def craft(kind: str, relative: float, products: float = 0.0, noise: float = 0.03) -> Vehicle:
    """A vehicle whose file states sigmas of its moments, and of its products in units of the least moment."""
    masses = {"box": [0.005, 0.007, 0.003], "plate": [1e-4, 0.01, 0.008], "wheel": [0.2, 0.5, 0.4]}
    tensor = np.diag(np.sum(masses[kind]) - masses[kind])
    sigma = np.diag(relative * np.diag(tensor))
    sigma += products * np.diag(tensor).min() * (1 - np.eye(3))
    wheel = Wheel("w", [0.6, 0.0, 0.8], 0.01, 80.0, Friction(1e-5, 1e-7))
    return Vehicle(
        kind,
        inertia_kg_m2=tensor,
        panels=[Panel(name, normal, 1.0) for name, normal in LOWER_CASE_FACES.items()],
        wheels=[wheel] if kind == "wheel" else [],
        telemetry=TelemetryForm(quantity="current_A", noise=noise),
        facts={"body.inertia_kg_m2": Fact(tensor, sigma=sigma)},
    )


def seen(vehicle: Vehicle, deg_s: float, count: int, step_s: float):
    """Telemetry of a vehicle at a rate about an oblique axis."""
    omega = np.radians(deg_s) * np.array([0.36, -0.48, 0.8])
    truth = {"omega_B": omega, "sun_B": SUN, "t_s": step_s * np.arange(count), "scale": 1.0}
    return omega, ss.twin(vehicle, truth, seed=1)


def test_a_tensor_is_physical_with_and_without_the_wheels():
    cube, wheeled = small_cube(), craft("wheel", 0.1)
    tensors = np.array(
        [
            np.diag([1.0, 2.0, 2.9]),
            np.diag([1.0, 2.0, 3.1]),
            np.diag([-1.0, 2.0, 2.0]),
            np.diag([1e-6, 2.0, 2.0]),
            [[2.0, 1.0, 0.0], [1.0, 2.0, 0.0], [0.0, 0.0, 2.0]],
            [[2.0, 1.9, 0.0], [1.9, 2.0, 0.0], [0.0, 0.0, 2.0]],
        ]
    )
    allowed = is_body(Bodies.rigid(0.01 * tensors), cube)
    assert allowed.tolist() == [True, False, False, False, True, False]
    variants = Bodies.of(wheeled, 3)
    heavy = replace(
        variants, wheel_inertia_kg_m2=variants.wheel_inertia_kg_m2 * [[1.0], [10.0], [100.0]]
    )
    assert is_body(heavy, wheeled).tolist() == [True, True, False]
    assert is_body(Bodies.of(craft("plate", 0.1), 1), craft("plate", 0.1)).all()


@pytest.mark.parametrize("kind", ["box", "plate", "wheel"])
@pytest.mark.parametrize(("relative", "products"), [(0.3, 0.0), (1.0, 0.0), (2.0, 1.0)])
def test_no_draw_has_an_unphysical_inertia(kind, relative, products):
    """Whatever the unknowns say; and those of bodies that can exist stay as they are, to the last bit."""
    vehicle = craft(kind, relative, products)
    unknown, _ = model(vehicle, {"wheel_inertia": 1.0} if vehicle.wheels else {}, 1.0)
    u = 3.0 * np.random.default_rng(0).standard_normal((500, len(unknown.unknowns)))
    raw = unknown._bodies(u)
    fine, made = is_body(raw, vehicle), unknown.bodies(u)
    assert 0 < fine.sum() < 500 and is_body(made, vehicle).all()
    np.testing.assert_array_equal(made.inertia_kg_m2[fine], raw.inertia_kg_m2[fine])
    np.testing.assert_array_equal(unknown.possible(u, 0.9)[fine], u[fine])
    assert is_body(unknown._bodies(unknown.possible(u, 0.9)), vehicle).all()


def test_the_inertia_prior_is_normalised_over_physical_bodies():
    """Against an integral on a grid; small sigmas are not cut, to the last bit."""
    vehicle = craft("box", 0.5)
    unknown, _ = model(vehicle, {}, 1.0)
    x = np.linspace(-5, 5, 101)
    grid = np.stack(np.meshgrid(x, x, x, indexing="ij"), axis=-1).reshape(-1, 3)
    moments = np.diag(vehicle.inertia_kg_m2) * (1 + 0.5 * grid)
    body = (moments.min(axis=1) > 0) & (2 * moments.max(axis=1) <= moments.sum(axis=1))
    density = np.exp(-0.5 * (grid**2).sum(axis=1))
    assert np.exp(unknown.log_truncated) == pytest.approx(
        density[body].sum() / density.sum(), rel=0.05
    )
    state = State(np.zeros((1, 3)), SUN[None], np.zeros((1, len(unknown.unknowns))))
    sure, _ = model(craft("box", 0.01), {}, 1.0)
    assert sure.log_truncated == 0.0
    more = unknown.log_prior(state) - sure.log_prior(state)
    assert more == pytest.approx(-unknown.log_truncated)


QUICK = [
    ("box", 2.0, 1.0, 3.0, 5, 60.0),
    ("plate", 1.0, 0.0, 60.0, 20, 1.0),
    ("wheel", 1.0, 0.3, 0.0, 5, 60.0),
]

EVERY = [
    (kind, relative, products, *motion)
    for kind in ("box", "plate", "wheel")
    for relative, products in ((0.0, 0.0), (0.3, 0.3), (1.0, 0.0), (2.0, 1.0))
    for motion in ((0.0, 20, 120.0), (3.0, 5, 60.0), (60.0, 60, 1.0))
]


@pytest.mark.parametrize(
    ("kind", "relative", "products", "deg_s", "count", "step_s"),
    [*QUICK, *(pytest.param(*case, marks=pytest.mark.long) for case in EVERY)],
)
def test_fits_and_weights_keep_to_physical_bodies_without_a_warning(
    kind, relative, products, deg_s, count, step_s
):
    """The two places where motions with drawn inertias are run, from starts far out in the priors."""
    vehicle = craft(kind, relative, products)
    omega, telemetry = seen(vehicle, deg_s, count, step_s)
    data, *_ = readings(vehicle, telemetry)
    unknown, _ = model(vehicle, {"max_rate_rad_s": max(1.2 * np.radians(deg_s), 0.01)}, 1.0)
    likelihood, rng = Likelihood(unknown, data), np.random.default_rng(0)
    n = 8
    start = State(
        omega + 0.05 / data.reach_s * rng.standard_normal((n, 3)),
        np.tile(SUN, (n, 1)),
        2.0 * rng.standard_normal((n, len(unknown.unknowns))),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        found = Fit(likelihood, start, ((3.0, 2), (1.0, 3)), curved=True)(np.arange(n))
        weighed = Weigh(likelihood, start)(np.arange(n))
    best = State(found["omega"], found["sun"], found["u"])
    assert np.isfinite(found["cost"]).any() and np.isfinite(found["hessian"]).all()
    assert np.isfinite(unknown.log_prior(best)).all()
    assert not np.isnan(weighed["log_likelihood"]).any()


def test_one_motion_that_exceeds_its_steps_does_not_end_the_others():
    cube = small_cube()
    rows = batch.Rows(
        np.array([[0.1, 0.0, 0.0], [1e6, 0.0, 0.0]]), np.tile(SUN, (2, 1)), np.zeros((2, 0))
    )
    with pytest.raises(SunspinError, match="needs"):
        batch.run(cube, rows, [100.0])
    run = batch.run(cube, rows, [100.0], leave_long=True)
    assert run.outcome.tolist() == [batch.Outcome.FINE, batch.Outcome.NOT_FINITE]
    alone = batch.run(cube, rows.take(np.array([0])), [100.0])
    np.testing.assert_array_equal(run.sun_B[0], alone.sun_B[0])
    assert np.isnan(run.sun_B[1]).all()


def test_a_wheel_too_fast_for_the_window_is_refused_with_a_window_that_works():
    slow = craft("wheel", 0.1)
    fast = replace(slow, wheels=[replace(slow.wheels[0], speed_rad_s=5e5)])
    unknown, _ = model(fast, {"max_rate_rad_s": 0.1, "wheel_speed": 0.0}, 1.0)
    t = np.linspace(-3600.0, 3600.0, 20)
    with pytest.raises(InputError, match="wheels at 5e\\+05 rad/s") as refused:
        require_computable(unknown, t, 0.1)
    window = re.search(r"use ([\d.e+]+) s of them", str(refused.value))
    assert window is not None
    require_computable(unknown, t * float(window[1]) / 7200.0, 0.1)
    require_computable(model(slow, {"max_rate_rad_s": 0.1}, 1.0)[0], t, 0.1)


@pytest.fixture
def quick(monkeypatch):
    """Few draws and a short search."""
    for name in ("DRAWS", "LAST_DRAWS", "MOST_DRAWS"):
        monkeypatch.setattr(importance, name, 400)
    monkeypatch.setattr(importance, "ROUNDS", 2)
    monkeypatch.setattr(importance, "MOST_BENT", 1)
    monkeypatch.setattr(estimate, "MOST_EFFORT", 1e5)
    monkeypatch.setattr(modes, "MOST_SEARCH", 2000)


def test_an_inertia_as_uncertain_as_its_moments_gives_physical_draws(quick):
    vehicle = craft("box", 1.0, 0.5)
    _, telemetry = seen(vehicle, 3.0, 8, 10.0)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        tree = ss.posterior(
            vehicle, telemetry, {"max_rate_rad_s": 0.1, "steady_torque": 0.0}, draws=200, workers=1
        )
    drawn = np.zeros((200, 3, 3))
    for a, b in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2)):
        value = tree["posterior"][f"inertia_{'xyz'[a]}{'xyz'[b]}"].values.ravel()
        drawn[:, a, b] = drawn[:, b, a] = value
    assert is_body(Bodies.rigid(drawn), vehicle).all()
    assert "truncated" in tree.attrs["priors"]


def random_case(number: int):
    """A vehicle with a tensor, a sigma of 0 to 200 % of it and a wheel or none, its telemetry, and priors."""
    rng = np.random.default_rng([5, number])
    masses = 0.01 * rng.uniform(0.05, 1.0, 3) * 10 ** rng.uniform(-1, 3)
    axes = np.linalg.qr(rng.standard_normal((3, 3)))[0] if number % 2 else np.eye(3)
    tensor = axes @ np.diag(masses.sum() - masses) @ axes.T
    tensor = (tensor + tensor.T) / 2
    relative, products = rng.uniform(0.0, 2.0), rng.choice([0.0, rng.uniform(0.0, 1.0)])
    sigma = np.diag(relative * np.diag(tensor))
    sigma += relative * products * np.diag(tensor).min() * (1 - np.eye(3))
    axis = rng.standard_normal(3)
    axis /= np.linalg.norm(axis)
    small = 10 ** rng.uniform(-4, -1) / (axis @ np.linalg.solve(tensor, axis))
    wheel = Wheel("w", axis, small, 10 ** rng.uniform(0, 2.5), Friction(1e-6, 1e-8))
    vehicle = Vehicle(
        "random",
        inertia_kg_m2=tensor,
        panels=[Panel(name, normal, 1.0) for name, normal in LOWER_CASE_FACES.items()],
        wheels=[wheel] if number % 3 == 2 else [],
        telemetry=TelemetryForm(quantity="current_A", noise=rng.uniform(0.01, 0.1)),
        facts={"body.inertia_kg_m2": Fact(tensor, sigma=sigma)},
    )
    deg_s = rng.choice([0.0, 0.01, 0.3, 3.0, 60.0])
    step_s = min(rng.choice([1.0, 10.0, 120.0]), 60.0 / max(deg_s, 0.5))
    _, telemetry = seen(vehicle, deg_s, int(rng.choice([5, 12, 20])), step_s)
    priors = {"max_rate_rad_s": float(max(1.2 * np.radians(deg_s), 0.3 / step_s / 2))}
    return vehicle, telemetry, priors | ({} if number % 2 else {"steady_torque": 0.0})


@pytest.mark.long
@pytest.mark.parametrize("number", range(8))
def test_any_inertia_and_rate_gives_a_posterior_or_advice_that_works(number, quick):
    """No other exception and no warning; what a refusal asks for is done, and then there is a result."""
    vehicle, telemetry, priors = random_case(number)
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        for _ in range(4):
            try:
                tree = ss.posterior(vehicle, telemetry, priors, draws=100, workers=1)
                break
            except SunspinError as refused:
                asked = re.search(r"give --prior (\w+)=([\d.e+-]+)", str(refused))
                assert asked is not None, refused
                priors = priors | {asked[1]: float(asked[2])}
        else:
            pytest.fail("advice was followed four times, and there is no result")
    assert np.isfinite(tree["posterior"]["omega_B"].values).all()


def nothing_drawn(vehicle, priors=None):
    """The refusal where no draw was possible, and its advice."""
    unknown, _ = model(vehicle, {"max_rate_rad_s": 0.1} | (priors or {}), 1.0)
    stated = SimpleNamespace(likelihood=SimpleNamespace(model=unknown))
    text = str(estimate._nothing_drawn(stated))
    return text, re.search(r"give --prior (\w+)=([\d.e+-]+)", text)


def test_if_nothing_can_be_drawn_the_message_names_the_largest_rate():
    assert nothing_drawn(craft("box", 0.0, 0.0))[1].groups() == ("max_rate_rad_s", "0.2")


@pytest.mark.parametrize("rod", [False, True])
def test_the_inertia_sigma_in_the_advice_keeps_most_of_the_prior_physical(rod):
    """A long thin body is at the edge of the triangle rule: a sigma of 1 % is too much for it."""
    vehicle = craft("box", 2.0, 1.0)
    if rod:
        vehicle = replace(vehicle, inertia_kg_m2=np.diag([1.0, 1.0, 0.003]), facts={})
    text, advice = nothing_drawn(vehicle)
    assert "hardly any inertia" in text and advice[1] == "inertia"
    narrower = model(vehicle, {"inertia": float(advice[2])}, 1.0)[0]
    assert np.exp(narrower.log_truncated) > 0.5
