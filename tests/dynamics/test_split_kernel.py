"""The split kernel: its flows against exact rotations, its histograms against the Taylor kernel's, and what it leaves to that."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.dynamics import batch
from sunspin.dynamics.kernels import split
from sunspin.dynamics.kernels.rows import L
from sunspin.dynamics.processor import njit
from tests.support.vehicles import FIRST_SUN, philae_body, random_vehicle

SUN = FIRST_SUN / np.linalg.norm(FIRST_SUN)


def start(omega, speeds) -> batch.Rows:
    """Rates (n, 3) and wheel speeds (n, n_wheel) of motions with the first Sun."""
    return batch.Rows(np.asarray(omega, float), np.tile(SUN, (len(omega), 1)), np.asarray(speeds))


def by_both_methods(monkeypatch, vehicle, initial, duration_s, command="coast"):
    """Seconds at each height by the split kernel and by the Taylor kernel, and which motions the first has left to the second."""
    left = []
    choose = batch._count_by_split_kernel

    def note(*given):
        left.append(choose(*given))
        return left[0]

    monkeypatch.setattr(batch, "_count_by_split_kernel", note)
    fast = batch.sun_heights(vehicle, initial, duration_s, command=command).seconds
    exact = batch.sun_heights(vehicle, initial, duration_s, command=command, error=1e-6).seconds
    return fast, exact, left[0]


def emd(one, two):
    """Distances (n) of histograms (n, bins) over r_z."""
    shares = [x / x.sum(axis=1, keepdims=True, dtype=float) for x in (one, two)]
    return np.abs(np.cumsum(shares[0] - shares[1], axis=1)).mean(axis=1)


# ---- flows ---------------------------------------------------------------------------------------
@njit
def half_steps(w, part, there_and_back):
    """Take the first half of a step and, if asked for, its reverse with time running backward."""
    for k in range(3):
        split.go_forward(w, part, k)
    if there_and_back:
        for l in range(L):
            w[split.DT + l] = -w[split.DT + l]
        for k in range(2, -1, -1):  # in reverse order, with the wheels of the same times
            main, side = part.main[k], part.side[k]
            for l in range(L):
                v = split.state_of(w, l)
                v = split.turn_sides(w, l, side, part.side_time[k], v)
                split.set_state(w, l, split.turn_main(w, l, main, part.main_time[k], v))


def lanes_of_numbers(rng, side=0.6):
    """Lanes with states, and rates of all parts of which no step turns by more than the law of steps lets it."""
    w = np.zeros(split.NUMBERS * L)
    rows = w.reshape(split.NUMBERS, L)
    for first in (split.H, split.SUN):
        vector = rng.normal(size=(3, L))
        rows[first // L : first // L + 3] = vector / np.linalg.norm(vector, axis=0)
    rows[split.DT // L] = 1.0
    rows[split.DM // L], rows[split.DP // L] = 0.6, 0.5 * side
    spread = np.array([[side], [side], [0.5]])
    rows[split.W0 // L : split.W0 // L + 3] = rng.uniform(-0.5, 0.5, (3, L)) * spread
    rows[split.W1 // L : split.W1 // L + 3] = 0.01 * rng.uniform(-1, 1, (3, L))
    return w.astype(np.float32)


def test_flows_are_rotations_and_the_second_half_of_a_step_reverses_the_first():
    before = lanes_of_numbers(np.random.default_rng(0))
    half, back = before.copy(), before.copy()
    half_steps(half, split.fractions_of_step(), False)
    half_steps(back, split.fractions_of_step(), True)

    def invariants(w):
        H, r = w[: 3 * L].reshape(3, L), w[3 * L : 6 * L].reshape(3, L)
        return np.stack([(H * H).sum(axis=0), (r * r).sum(axis=0), (H * r).sum(axis=0)])

    assert np.abs(half - before)[: 6 * L].max() > 0.3
    np.testing.assert_allclose(invariants(half), invariants(before), atol=2e-6)
    np.testing.assert_allclose(back[: 6 * L], before[: 6 * L], atol=2e-6)


@njit
def sides(w, fraction, pieces):
    """Apply P and Q for the fraction of the step, in so many pieces."""
    for _ in range(pieces):
        for l in range(L):
            v = split.turn_sides(w, l, fraction / pieces, 0.0, split.state_of(w, l))
            split.set_state(w, l, v)


def test_the_error_of_p_and_q_together_is_of_third_order():
    """Half the fraction has an eighth of the error; P and Q in any one order would leave a quarter."""
    errors = []
    for fraction in (0.8, 0.4):
        w = lanes_of_numbers(np.random.default_rng(1)).astype(np.float64)
        exact = w.copy()
        sides(w, fraction, 1)
        sides(exact, fraction, 500)
        errors.append(np.linalg.norm((w - exact)[: 6 * L]))
    assert 6.0 < errors[0] / errors[1] < 10.0


# ---- histograms ----------------------------------------------------------------------------------
def philae_with(axes, **changes):
    """Philae's body with its wheel on other axes (n_wheel, 3)."""
    body, units = philae_body(), [axis / np.linalg.norm(axis) for axis in axes]
    wheel = replace(body.wheels[0], **changes)
    wheels = [replace(wheel, name=f"w{i}", axis_B=axis) for i, axis in enumerate(units)]
    return replace(body, wheels=wheels)


@pytest.mark.parametrize("command", ["coast", "hold", "brake"])
@pytest.mark.parametrize("n_wheels", [0, 1, 2, 3, 4])
def test_histograms_are_those_of_the_series_for_wheels_on_any_axes(n_wheels, command, monkeypatch):
    """A third begins with wheels at rest, where friction may not hold them; most others stop on the way, one after the other."""
    rng = np.random.default_rng(n_wheels)
    vehicle = philae_with(rng.normal(size=(n_wheels, 3)), brake_torque_N_m=2e-4)
    n = 24
    speeds = rng.uniform(-40, 40, (n, n_wheels)) * (np.arange(n) % 3 > 0)[:, None]
    initial = start(0.3 * rng.normal(size=(n, 3)), speeds)
    fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 1500.0, command)
    own = np.setdiff1d(np.arange(n), left)
    assert len(own) >= n // 3
    away = emd(fast, exact)[own]
    assert np.median(away) < 1e-3 and away.max() < 3e-3
    np.testing.assert_allclose(fast.sum(axis=1), 1500.0, rtol=1e-4)


@pytest.mark.parametrize("n_wheels", [1, 2])
@pytest.mark.parametrize("rate", [0.03, 0.3])
def test_fast_wheels_across_the_axes_of_random_bodies_do_not_spoil_histograms(
    n_wheels, rate, monkeypatch
):
    """They need more steps, or the Taylor kernel: with the law of steps of a body like Philae a tenth erred by 3e-3 to 0.3."""
    rng = np.random.default_rng(5)
    worst, own = [], 0
    for _ in range(5):
        vehicle = random_vehicle(rng, n_wheels, dry=1e-3, viscous=1e-5)
        speeds = rng.uniform(20, 50, (24, n_wheels)) * rng.choice([-1, 1], (24, n_wheels))
        initial = start(rate * rng.normal(size=(24, 3)), speeds)
        fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 2700.0)
        monkeypatch.undo()
        worst.append(emd(fast, exact))
        own += 24 - len(left)
    away = np.concatenate(worst)
    assert own > 3 and np.quantile(away, 0.95) < 2e-3 and away.max() < 6e-3


@pytest.mark.parametrize("moments", [[2.0, 2.0, 2.0], [2.0, 2.0, 3.0]], ids=["sphere", "top"])
def test_bodies_with_equal_moments_and_a_wheel_that_stops_within_a_step_are_followed(
    moments, monkeypatch
):
    """Without a wheel, and with one at rest, slow and fast."""
    wheel = ss.Wheel("w", [0.0, 0.6, 0.8], 0.01, 1.0, ss.Friction(2e-3, 1e-6))
    omega = np.array([[0.0, 0.02, 0.1], [0.03, -0.02, 0.01], [0.0, 0.0, 0.0]])
    speeds = np.repeat([0.0, 1e-3, 30.0], 3)[:, None]
    for wheels, initial in (
        ((), start(omega, np.zeros((3, 0)))),
        ((wheel,), start(np.tile(omega, (3, 1)), speeds)),
    ):
        body = replace(philae_body(), inertia_kg_m2=np.diag(moments), wheels=wheels)
        fast, exact, _ = by_both_methods(monkeypatch, body, initial, 600.0)
        monkeypatch.undo()
        assert emd(fast, exact).max() < 1e-3


def test_a_wheel_without_dry_friction_never_stops(monkeypatch):
    vehicle = philae_with([[0.1, 0.0, 1.0]], friction=ss.Friction(0.0, 1e-5))
    initial = start([[0.05, 0.02, 0.1], [-0.02, 0.03, 0.04]], [[0.0], [25.0]])
    fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 900.0)
    assert len(left) == 0 and emd(fast, exact).max() < 1e-3


# ---- what is left to the Taylor kernel -----------------------------------------------------------
def test_a_stuck_wheel_that_breaks_away_is_left_to_the_series(monkeypatch):
    vehicle = philae_body(ss.Friction(1e-4, 1e-6))
    initial = start([[0.8, 0.5, -0.6], [0.05, 0.02, 0.01]], np.zeros((2, 1)))
    fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 600.0)
    assert left.tolist() == [0]
    series = batch.sun_heights(vehicle, initial, 600.0, error=1e-2).seconds
    assert np.array_equal(fast[0], series[0])
    assert emd(fast, exact).max() < 1e-3


def test_a_wheel_that_reverses_instead_of_sticking_is_left_to_the_series(monkeypatch):
    """It comes to rest while the body needs more torque than friction has: the kernel would hold it at rest."""
    vehicle = philae_with([[1.0, 0.3, 0.0]], friction=ss.Friction(2e-5, 0.0))
    initial = start([[0.1, 0.4, 0.3]], [[0.02]])
    track = ss.propagate(vehicle, [0.1, 0.4, 0.3], SUN, 0.02, [0.0, 300.0])
    assert "reverses" in track["event_what"].values
    fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 300.0)
    assert left.tolist() == [0] and emd(fast, exact).max() < 1e-3


def test_motions_next_to_an_unstable_spin_are_left_to_the_series(monkeypatch):
    vehicle = replace(philae_body(), wheels=())
    axes = np.linalg.eigh(vehicle.inertia_kg_m2)[1]
    away = np.array([1e-7, 1e-6, 1e-5, 0.3, 0.5])
    omega = 0.5 * (axes[:, 1] + away[:, None] * axes[:, 0])
    initial = start(omega, np.zeros((5, 0)))
    fast, exact, left = by_both_methods(monkeypatch, vehicle, initial, 2700.0)
    assert left.tolist() == [0, 1, 2] and emd(fast, exact).max() < 2e-3


def test_numbers_that_are_none_have_an_outcome_and_leave_neighbours_alone(monkeypatch):
    vehicle, n = philae_body(), 40
    rng = np.random.default_rng(2)
    initial = start(0.2 * rng.normal(size=(n, 3)), np.full((n, 1), 865.0))
    good = batch.sun_heights(vehicle, initial, 300.0).seconds
    omega, speeds = initial.omega_B.copy(), initial.wheel_speed_rad_s.copy()
    omega[[3, 11], 1] = speeds[[17, 30], 0] = np.nan, np.inf
    spoilt = replace(initial, omega_B=omega, wheel_speed_rad_s=speeds)
    monkeypatch.setattr(batch, "require_followable", lambda *_: None)  # infinite rates are refused
    heights = batch.sun_heights(vehicle, spoilt, 300.0)
    others = np.delete(np.arange(n), [3, 11, 17, 30])
    assert np.flatnonzero(heights.outcome).tolist() == [3, 11, 17, 30]
    assert np.array_equal(heights.seconds[others], good[others])
