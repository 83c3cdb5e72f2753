"""The search for a lander's motions: its grid, its fits, families, and that it lists the true motion."""

from dataclasses import replace

import numpy as np
import pytest

import sunspin as ss
from sunspin.estimate.lander.carrier import Shooting
from sunspin.estimate.lander.fit import FINAL_ERROR, FitProblem
from sunspin.estimate.lander.grid import Reference, choose_reference, grid_starts, settled_starts
from sunspin.estimate.lander.motions import LanderMotions
from sunspin.estimate.lander.rate_grid import RateGrid, Reached
from sunspin.estimate.lander.window import observe_window
from sunspin.estimate.posterior import search_nominal
from sunspin.estimate.settings import POSTERIOR
from sunspin.telemetry.assess import assess
from tests.estimate.plain_cells import (
    LookThrough,
)
from tests.support.landers import NOISE, OMEGA, PHILAE, SUN, lander_model, lander_telemetry, noisy
from tests.support.passes import slope_of
from tests.support.vehicles import units

GRID, SHOOTING = POSTERIOR.grid, POSTERIOR.shooting


def true_motion(after_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the true rate (3) and direction (3) some time after the first sample."""
    wheels = [wheel.speed_rad_s for wheel in PHILAE.wheels]
    run = ss.propagate(PHILAE, OMEGA, SUN, wheels, [0.0, max(after_s, 1e-9)])
    return run["omega_B"].values[-1], run["sun_B"].values[-1]


def placed(model, **changes):
    """Return a model with its reference where the search begins, and that reference."""
    reference = replace(choose_reference(model, GRID), **changes)
    return reference.about(model), reference


# ---- the grid --------------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def small_search():
    """Return a model with its reference where the search begins, that reference, and a grid of rates up to 0.12 rad/s."""
    model, reference = placed(lander_model(max_rate_rad_s=0.12), limit=0.12)
    reached, times = Reached.of(model, 0.12, reference.fastest), model.obs.t_s[reference.others]
    return model, reference, RateGrid.of(model, times, reached, reference.edge, GRID)


def test_every_motion_of_the_prior_reaches_a_rate_that_is_searched():
    """Rates of the ball at the first sample, also along the wheel that runs down; half of a wider ball is left out."""
    model = lander_model().after(800.0, 0.9)
    first = replace(model, after_s=0.0)
    rng = np.random.default_rng(8)
    direction = rng.standard_normal((300, 3))
    direction[:40, :2] *= 0.02  # nearly along the wheel
    direction = units(direction)
    none = np.zeros((300, len(model.unknowns)))
    rows = first.rows(LanderMotions(0.6 * direction, np.tile(SUN, (300, 1)), none))
    there = first.run(rows, np.array([800.0]), 1e-5).omega_B[:, 0]
    reached = Reached.of(model, 2.0, 0.6)
    assert reached.within(there, 0.0).all()
    assert np.sqrt(reached.energy(there).max()) > 0.97 * reached.most
    ball = 0.9 * rng.random((300, 1)) ** (1 / 3) * direction
    assert 0.3 < reached.within(ball, 0.0).mean() < 0.5


@pytest.mark.parametrize("throttled", [False, True])
def test_compiled_starts_are_those_of_the_plain_version(small_search, throttled):
    """All of them, where they settle and how well: both orders of sums differ by rounding, and one start in 200 by more."""
    model, reference, grid = small_search
    panels = replace(model.panels, throttled=throttled)
    some = replace(grid)
    object.__setattr__(some, "cells", grid.cells[:6000])
    look = LookThrough(grid, panels, reference, GRID)
    plain = look.settled_starts(some.cells)
    compiled = settled_starts(some, panels, reference, GRID)
    off = np.abs(plain[0][:, None] - compiled[0]).max(axis=2)
    off += np.abs(plain[1][:, None] - compiled[1]).max(axis=2)
    assert len(plain[0]) > 20
    assert np.mean(off.min(axis=1) > 1e-4) < 0.01
    assert np.mean(off.min(axis=0) > 1e-4) < 0.01
    nearest = off.argmin(axis=1)
    np.testing.assert_allclose(np.median(compiled[2][nearest] / plain[2]), 1.0, rtol=1e-4)
    assert np.all(compiled[2] <= GRID.settled)


def test_a_start_lies_near_the_true_motion():
    """So near at the samples next to the reference that a look at the next one does not drop it."""
    model, reference = placed(lander_model(noise=NOISE, max_rate_rad_s=0.12))
    ((window, starts),) = grid_starts(model, reference, GRID)
    assert window == reference.window
    omega, sun = true_motion(reference.after_s)
    reach = np.abs(model.obs.t_s[reference.others]).max()
    off = np.linalg.norm(starts.omega - omega, axis=1) * reach
    aside = np.linalg.norm(starts.sun - sun, axis=1)
    assert np.min(np.maximum(off, aside)) < SHOOTING.look_rad
    assert len(starts) < 20_000


# ---- fits ------------------------------------------------------------------------------------------------------------------


def test_derivatives_of_the_differences_are_those_of_runs():
    """By rate, direction, body, wheel and brightness, over all samples; 1 % of readings cross the edge of a panel."""
    model = lander_model().after(300.0, 0.6)
    count = len(model.unknowns)
    rng = np.random.default_rng(3)
    sun = units(rng.standard_normal((3, 3)))
    motions = LanderMotions(
        0.05 * rng.standard_normal((3, 3)), sun, 0.3 * rng.standard_normal((3, count))
    )
    problem = FitProblem(model, np.ones(count, dtype=bool), FINAL_ERROR)
    track, track_slopes = problem.track_with_slopes(motions)
    linear = problem.linear_readings(motions, track, track_slopes)
    nothing = np.zeros_like(track_slopes)

    def moved(step):
        """Return the differences after a step."""
        there = motions.moved(np.tile(step, (3, 1)))
        return problem.linear_readings(there, problem.track(there, 1e-9), nothing).residuals

    for k, coordinate in enumerate(problem.free_coordinates):
        size = 1e-5 if coordinate < 3 else 1e-4
        change = slope_of(moved, size * np.eye(model.dimension)[coordinate], size)
        off = np.abs(change - linear.jacobian[:, :, k])
        assert np.mean(off > 0.01 * np.abs(change).max() + 1e-6) < 0.02, coordinate


# ---- the search ------------------------------------------------------------------------------------------------------------


def test_the_search_lists_the_true_motion():
    """With its rate within 4.5 sigma, as the best; an angular speed seen otherwise does not change that."""
    telemetry, priors = lander_telemetry(60.0 * np.arange(12), NOISE), {"max_rate_rad_s": 0.15}
    speed = {"kind": "rate", "t_s": 30.0, "value": np.linalg.norm(OMEGA), "sigma": 0.01}
    assessment = assess(noisy(), telemetry)
    window = observe_window(assessment, observations=[speed])
    result = search_nominal(assessment, window, priors, workers=1)
    fit = result.fit
    off = fit.motions.omega[0] - true_motion(result.carrier.model.after_s)[0]
    covariance = np.linalg.inv(fit.motions.curvature[0])[:3, :3]
    assert off @ np.linalg.solve(covariance, off) < 4.5**2
    assert not any(doubt.left_out for doubt in fit.doubts)
    assert fit.log_evidence[0] == fit.log_evidence.max()


def shooting(**changes) -> tuple[Shooting, Reference]:
    """Return the search of the usual model, and its reference."""
    model, reference = placed(lander_model(), **changes)
    return Shooting(model, reference, POSTERIOR, 1), reference


def test_more_motions_than_can_be_followed_are_thinned_evenly_and_said():
    carrier, _ = shooting()
    none = np.zeros((100, 1))
    motions = LanderMotions(none + OMEGA, none + SUN, none, cost=0.1 * np.arange(100))
    kept = carrier._at_most(motions, 10, "(5 samples)")
    assert len(kept) == 10 and kept.cost[[0, -1]] == pytest.approx([0.0, 9.9])
    assert carrier.doubts[-1].left_out and "more trial solutions" in carrier.doubts[-1].text


def test_the_largest_rate_that_a_warning_advises_leaves_as_many_motions_as_are_followed(caplog):
    """Or shortens a search of starts to a minute. Both grow with the cube of the ball of rates; two digits are printed."""
    usual, reference = shooting()
    usual.announce_starts()
    assert not caplog.records
    usual._announce(6000, 2000, 5)
    shooting(edge=reference.limit / 150)[0].announce_starts()
    many, long = (record.getMessage() for record in caplog.records)
    assert "6000 motions may fit 5 samples; 2000 of them are followed" in many
    minutes = float(long.split("about ")[1].split()[0])
    for said, size, left in ((many, 6000, 2000), (long, minutes, 1.0)):
        share = float(said.split("max_rate_rad_s=")[1].split()[0]) / reference.prior_max_rate
        assert size * share**3 == pytest.approx(left, rel=0.1)
