"""The search: its starts reach the next sample, it keeps a slow body, and a larger range of rates loses no motion."""

from dataclasses import replace

import numpy as np
import pytest

from sunspin.base.errors import InputError
from sunspin.estimate import starts
from sunspin.estimate.budget import Budget
from sunspin.estimate.chain import Chain, propagate
from sunspin.estimate.model import Body, Model, Noise, Observations, Track
from sunspin.estimate.search import search
from sunspin.estimate.settings import AlternativeSettings, SearchSettings
from sunspin.estimate.starts import (
    PairStarts,
    _best_starts,
    aliases,
    aliases_about_two_axes,
    constant_rates,
    fine_up_to,
    other_bodies,
    pair_starts,
    pairs_to_try,
    whole_turns,
)
from sunspin.estimate.terms.directions import SunDirections
from sunspin.estimate.terms.field import FieldChange
from sunspin.solve.rotations import rotate_attitude
from tests.support.vehicles import units

SEARCH = SearchSettings()

ELEMENTS = [(np.eye(3)[i], np.eye(3)[j]) for i in range(3) for j in range(i, 3)]
"""Axes that the elements of an inertia belong to."""


def watched(deg_s, apart_s=20.0, count=20, sigma=0.03, max_deg_s=8.0, seed=0):
    """Return a model for the search of directions that a body showed, and its true motion."""
    rng = np.random.default_rng(seed)
    moments = rng.uniform(0.8, 1.2, 3)
    body = Body(np.diag(moments / moments.mean()), np.zeros((0, 3, 3)))
    t_s = apart_s * np.arange(count)
    omega = np.radians(deg_s) * units(rng.normal(size=3))
    attitude, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    attitude *= np.sign(np.linalg.det(attitude))
    still = Observations(t_s, np.zeros((count, 3)), ())
    model = Model(still, body, Noise(1e-4), np.radians(max_deg_s) / 2)
    truth = propagate(model, 0, attitude[None], omega[None])
    sun = units(truth.sun_B[0] + sigma * rng.normal(size=(count, 3)))
    term = SunDirections.of(sun, np.tile(sigma**2 * np.eye(3), (count, 1, 1)))
    return replace(model, obs=replace(still, terms=(term,))), truth


@pytest.mark.parametrize("whole", [False, True])
def test_every_turn_between_two_directions_has_a_start_within_half_a_radian(whole):
    """Also nearly whole turns about any axis, which leave a direction where it is."""
    rng, dt, rate_max = np.random.default_rng(5), 20.0, 0.6
    for _ in range(100):
        axis = units(rng.normal(size=3))
        size = (2 * np.pi + 0.1 * rng.normal()) / dt if whole else rate_max * rng.random()
        omega, first = size * axis, units(rng.normal(size=3))
        second = rotate_attitude(np.eye(3), omega * dt) @ first
        rates = constant_rates(first, second, dt, rate_max, SEARCH.step_rad)
        if first @ second > np.cos(0.5):
            rates = np.concatenate([rates, whole_turns(dt, rate_max, 2 * SEARCH.basin_rad)])
        assert np.linalg.norm(rates - omega, axis=1).min() * dt < 0.5


def test_whole_turns_whose_axes_would_be_far_apart_make_a_search_coarse():
    """Their number is limited, so that the axes of many turns are farther apart."""
    dt = 20.0
    model, _ = watched(0.2, dt)
    sphere = replace(model, body=Body(np.eye(3), np.zeros((0, 3, 3))))
    limit = fine_up_to(replace(sphere, rate_sigma=1.0), SEARCH)
    for rate_max, answer in ((0.999 * limit, np.inf), (1.001 * limit, limit)):
        assert fine_up_to(replace(sphere, rate_sigma=rate_max / 2), SEARCH) == answer
    turns = int(limit * dt / (2 * np.pi))
    axes = units(np.random.default_rng(0).normal(size=(500, 3)))
    for more, near in ((0, True), (1, False)):
        size = 2 * np.pi * (turns + more)
        starts = whole_turns(dt, 1.001 * size / dt, 2 * SEARCH.basin_rad) * dt
        apart = np.linalg.norm(starts - size * axes[:, None], axis=2).min(axis=1)
        assert (apart.max() < 0.9) == near
    # no axis is in question where the Sun moves from sample to sample
    fast, _ = watched(4.0, dt)
    fast = replace(fast, body=sphere.body, rate_sigma=1.0)
    assert fine_up_to(fast, SEARCH) == np.inf


def test_a_search_from_a_grid_begins_at_one_pair_if_a_magnetometer_determines_whole_turns():
    """An uncertain inertia asks for three if only the Sun is seen; three took all the budget of two spinners."""
    model, truth = watched(2.0)
    long = Body(np.diag([0.3, 1.35, 1.35]), np.zeros((0, 3, 3)), angle_error=0.1)
    by_sun = replace(model, body=long)
    field = FieldChange(model.obs.t_s, truth.attitude[0] @ [2e4, 0.0, 2e4], 300.0)
    by_field = replace(by_sun, obs=replace(model.obs, terms=(*model.obs.terms, field)))
    assert pairs_to_try(by_sun, SEARCH) == SEARCH.places
    assert pairs_to_try(by_field, SEARCH) == 1


def test_more_turns_than_can_be_tried_are_refused():
    fast, s = replace(watched(2.0)[0], rate_sigma=100.0), SEARCH
    with pytest.raises(InputError, match="too many whole turns"):
        search(Chain(fast, s), pair_starts(fast, s), s, Budget(np.inf), pairs_to_try(fast, s))


def test_a_search_of_faster_starts_alone_finds_a_motion_beyond_the_largest_rate():
    model, truth = watched(15.0, max_deg_s=20.0)
    slowest = np.radians(10.0)
    motions = search(
        Chain(model, SEARCH), pair_starts(model, SEARCH, slowest), SEARCH, Budget(np.inf), 1
    )
    turned = np.linalg.norm(motions.omega - truth.omega, axis=2).max(axis=1) * 20.0
    assert turned.min() < 0.35
    model, _ = watched(15.0, max_deg_s=10.0)
    assert not list(pair_starts(model, SEARCH, slowest))


@pytest.mark.parametrize("at_once", [1000, 10])
def test_the_slowest_start_is_kept_however_badly_it_fits(monkeypatch, at_once):
    """Also if starts are tried in parts: a slow body is lost without it."""
    monkeypatch.setattr(starts, "STARTS_AT_ONCE", at_once)
    model, truth = watched(5.0)
    near = truth.omega[0, 0] + 1e-3 * np.random.default_rng(1).normal(size=(40, 3))
    rates = np.concatenate([np.zeros((1, 3)), near])
    pair = PairStarts(np.tile(truth.sun_B[0, 0], (41, 1)), rates, 0.1)
    speed = np.linalg.norm(_best_starts(model, 0, pair, 4).omega[:, 0], axis=1)
    assert len(speed) == 4 and speed.min() == 0.0 and np.median(speed) > np.radians(4.0)


def test_aliases_of_a_motion_turn_whole_revolutions_more():
    model, truth = watched(4.0, max_deg_s=40.0)
    others = aliases(truth, model, AlternativeSettings())
    turns = np.linalg.norm(others.omega - truth.omega, axis=-1) * 20.0 / (2 * np.pi)
    assert len(others) and np.allclose(turns, np.round(turns), atol=1e-6)
    assert set(np.round(turns[:, 0]).astype(int)) == {1, 2}
    uneven = replace(model.obs, t_s=model.obs.t_s * (1 + 0.01 * np.arange(20)))
    assert not len(aliases(truth, replace(model, obs=uneven), AlternativeSettings()))


def test_a_nutating_body_without_an_inertia_has_aliases_with_the_same_attitudes_and_another_inertia():
    model, _ = watched(4.0, max_deg_s=50.0)
    errors = np.array([(np.outer(i, j) + np.outer(j, i)) for i, j in ELEMENTS]) * 0.1
    unknown = replace(model, body=Body(np.eye(3), errors, sphere=True))
    u = np.array([[0.8, 0.2, -0.3, -0.6, 0.1, -1.0]])

    def free(u, attitude, omega):
        body = Body(unknown.body.inertia_at(u)[0], np.zeros((0, 3, 3)))
        return propagate(replace(model, body=body), 0, attitude, omega)

    truth = free(u, np.eye(3)[None], np.radians([[6.0, -4.0, 7.0]]))
    others = aliases(Track(truth.attitude, truth.omega, u), unknown, AlternativeSettings())
    along = truth.omega[0] / np.linalg.norm(truth.omega[0], axis=1, keepdims=True)
    assert np.degrees(np.arccos(along @ along[0])).max() > 15  # it nutates
    assert len(others) >= 3
    for k in range(len(others)):
        alone = others.take([k])
        again = free(alone.u, alone.attitude[:, 0], alone.omega[:, 0])
        # twenty intervals of one to three turns, in each of which the equations of motion are solved to some 1e-4
        assert np.abs(again.attitude - truth.attitude).max() < 0.01
        assert np.abs(again.omega - alone.omega).max() < 1e-3
        assert np.abs(alone.u - u).max() > 0.2


def precessing(model, long, cosine, turn):
    """Return a body with two like moments, `long` times the third, and its motion with a revolution in 2 pi / `turn` s about L.

    `cosine`: of the angle between L and the third axis, z.
    """
    moments = np.array([long, long, 1.0])
    body = Body(np.diag(moments / moments.mean()), np.zeros((0, 3, 3)))
    known = replace(model, body=body)
    along = np.array([np.sqrt(1 - cosine**2), 0.0, cosine])
    omega = turn * long * along / moments
    return known, propagate(known, 0, np.eye(3)[None], omega[None])


def test_a_precessing_body_has_an_alias_that_precesses_and_spins_a_revolution_more():
    """The spin relative to the precession is (long - 1) cosine: one here, so that one revolution more of both is a motion too."""
    model, _ = watched(4.0, max_deg_s=60.0)
    known, truth = precessing(model, 4.0, 1 / 3, np.radians(5.0))
    others = aliases_about_two_axes(truth, known, AlternativeSettings())
    again = propagate(known, 0, others.attitude[:, 0], others.omega[:, 0])
    same = np.abs(again.attitude - truth.attitude).max(axis=(1, 2, 3)) < 0.05
    more = np.linalg.norm(others.omega - truth.omega, axis=2).min(axis=1) * 20.0 > 3
    assert (same & more).any()
    # a body whose spin does not fit has none of these, and uneven samples exclude all
    known, truth = precessing(model, 2.3, 1 / 3, np.radians(5.0))
    near = replace(AlternativeSettings(), momentum_off_rad=0.02)
    assert not len(aliases_about_two_axes(truth, known, near))
    uneven = replace(known.obs, t_s=known.obs.t_s * (1 + 0.01 * np.arange(20)))
    assert not len(aliases_about_two_axes(truth, replace(known, obs=uneven), near))


def test_revolutions_about_two_axes_give_another_body_if_no_inertia_is_known():
    model, _ = watched(4.0, max_deg_s=40.0)
    errors = np.array([(np.outer(i, j) + np.outer(j, i)) for i, j in ELEMENTS]) * 0.1
    unknown = replace(model, body=Body(np.eye(3), errors, sphere=True))
    known, truth = precessing(model, 1.3, 0.8, np.radians(8.0))
    off = (known.body.inertia - np.eye(3)).ravel()
    u = np.linalg.lstsq(errors.reshape(-1, 9).T, off, rcond=None)[0][None]
    begin = Track(truth.attitude, truth.omega, u)
    others = aliases_about_two_axes(begin, unknown, AlternativeSettings())
    assert len(others) >= 3
    for k in range(len(others)):
        body = Body(unknown.body.inertia_at(others.u[[k]])[0], np.zeros((0, 3, 3)))
        alone = others.take([k])
        again = propagate(replace(model, body=body), 0, alone.attitude[:, 0], alone.omega[:, 0])
        assert np.abs(again.attitude - truth.attitude).max() < 0.05


def test_a_body_without_an_inertia_is_tried_in_six_shapes():
    model, truth = watched(4.0, max_deg_s=8.0)
    assert not len(other_bodies(truth, model))
    errors = np.array([0.3 * np.diag(row) for row in np.eye(3)])
    model = replace(model, body=Body(np.eye(3), errors, sphere=True))
    motion = Track(truth.attitude, truth.omega, np.zeros((1, 3)))
    shapes = other_bodies(motion, model).u.round(6)
    assert len({tuple(row) for row in shapes}) == 6 and np.allclose(shapes.sum(axis=1), 0)
