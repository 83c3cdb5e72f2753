"""Alternative models of a pass: constant torques, rate steps, oscillation, and their probabilities.

All telemetry is synthetic, made by the equations of `validation/passes.py` and not by the package's."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from sunspin.estimate.rates.alternatives import (
    Others,
    Trial,
    _sized,
    alternatives,
    counted,
    pooled,
    weighed,
)
from sunspin.estimate.rates.common_errors import with_common
from sunspin.estimate.rates.hypotheses import AS_STATED, Hypothesis
from sunspin.estimate.rates.motion import Body
from sunspin.estimate.rates.observe import observations, passes
from sunspin.estimate.rates.state import Motion, Observations, Track
from sunspin.estimate.terms.steady_torque import SteadyTorque
from sunspin.estimate.terms.sun_direction import SunDirection
from sunspin.estimate.terms.term import Seen, facing
from sunspin.solve.rotations import rotation_between
from sunspin.vehicle.sensors import Gyro, Sensors
from validation.passes import FACES, MOMENTS, observe, spin, unit

INERTIA = np.diag(MOMENTS) / MOMENTS.mean()
START = np.radians([2.0, -1.0, 1.5])
BODY = Body(INERTIA, np.zeros(3), False, np.zeros((0, 3, 3)))
T_S = np.arange(0.0, 300.0, 10.0)


def pushed(size, in_body):
    """The acceleration of a torque `size` (3), rad/s2, over the mean moment."""
    return lambda _, attitude: (size if in_body else attitude @ size) * MOMENTS.mean() / MOMENTS


@pytest.mark.parametrize("frame", ["B", "N"])
def test_the_effect_of_a_steady_torque_agrees_with_the_equations_of_motion(frame):
    """Over 10 s at 2.7 deg/s, for a torque as weak as differences allow."""
    t, size = np.array([0.0, 10.0]), 1e-6 * np.array([1.0, -2.0, 1.5])
    free, turned = spin(START, t)
    moved, attitude = spin(START, t, pushed(size, frame == "B"))
    expected = np.concatenate([rotation_between(turned, attitude)[1], (moved - free)[1]])
    made = (
        SteadyTorque(1.0, frame, INERTIA).pushes(Seen(turned[None], free[None]), np.diff(t))[0, 0]
        @ size
    )
    np.testing.assert_allclose(made, expected, atol=5e-3 * np.abs(expected[:3]).max())


def test_the_evidence_of_a_smaller_torque_agrees_with_its_integral():
    """One unknown x, log likelihood -(x - 2)^2 / 0.08, priors of sigma 1 and 0.3."""
    x = np.linspace(-10, 10, 20001)
    like = np.exp(-((x - 2) ** 2) / 0.08)
    log = [np.log(np.trapezoid(like * np.exp(-((x / s) ** 2) / 2) / s, x)) for s in (1.0, 0.3)]
    variance = 1 / (1 / 0.04 + 1)
    found = _sized(
        np.array([[2 * variance / 0.04]]), np.array([[[variance]]]), np.array([1.0, 0.3])
    )
    assert found[0, 0] == pytest.approx(0.0, abs=1e-12)
    assert found[1, 0] == pytest.approx(log[1] - log[0], rel=1e-6)


def motions(log_evidence, deg_s):
    """A trial with one mode of each rate about z, all as well known as if the rate were even before the data, to 8 deg/s."""
    prior, count = np.radians(8.0), len(deg_s)
    omega = np.zeros((count, 1, 3))
    omega[:, 0, 2] = np.radians(deg_s)
    covariance = np.tile(np.radians(0.1) ** 2 * np.eye(6), (count, 1, 1, 1))
    one = Hypothesis(
        AS_STATED,
        Observations(T_S[:1], np.zeros((1, 3)), ()),
        np.arange(1),
        Motion(BODY, 1e-6, prior),
    )
    fit: Any = SimpleNamespace(
        track=Track(np.tile(np.eye(3), (count, 1, 1, 1)), omega, covariance=covariance)
    )
    return Trial(one, fit, np.array(log_evidence) - (omega**2).sum(axis=(1, 2)) / (2 * prior**2))


@pytest.mark.parametrize(
    ("slower", "faster", "low", "high"),
    [
        (0.0, 0.0, 0.4, 0.9),  # as good: open
        (-4.0, 0.0, 0.4, 0.6),  # the faster one is ahead only if every rate is as likely
        (0.0, -4.0, 0.9, 1.0),
        (-20.0, 0.0, 0.0, 0.01),  # nothing but the data counts
    ],
)
def test_the_likelier_alias_does_not_depend_on_the_rate_prior(slower, faster, low, high):
    weight = pooled([motions([slower, faster], [1.4, 12.0])])
    assert weight.sum() == pytest.approx(1.0) and low < weight[0] < high


def tried(push, noise, zero_deg_s=None, zero_sigma=0.0):
    """All hypotheses of a pass moved so, begun at its true motion, with the noise that explains it as unknown torques; with a gyro
    whose zero is so much off though its file takes it for known, or known to `zero_sigma` (rad/s), if one is given."""
    sun = unit(np.random.default_rng(3))  # as `observe` draws it
    omega, attitude = spin(START, T_S, push)
    made = observe(FACES, omega, attitude, T_S, 0.01, np.random.default_rng(3))
    vehicle, telemetry = made.vehicle, made.telemetry
    if zero_deg_s is not None:
        gyro = Gyro(("x", "y", "z"), 1.0, np.zeros(3), 1e-3, zero_sigma=np.full(3, zero_sigma))
        vehicle = replace(vehicle, sensors=Sensors(gyro=gyro))
        read = (
            omega
            + np.radians(zero_deg_s)
            + 1e-3 * np.random.default_rng(4).normal(size=omega.shape)
        )
        telemetry = telemetry.assign(gyro_B=(("time", "axis"), read))
    o, why, _ = observations(vehicle, telemetry)
    index = passes(o, why)[0]
    axes = np.array([*np.linalg.svd(sun[None])[2][1:], sun])
    axes[0] *= np.sign(np.linalg.det(axes))
    motion = Motion(Body.of(vehicle), noise, 0.075)
    one = Hypothesis(AS_STATED, o.take(index), np.arange(len(index)), motion)
    fit = with_common(
        one.fitted(), Track((attitude[index] @ axes.T)[None], omega[index][None]), motion, None
    )
    return alternatives(weighed(one, fit), Others(True, "{:.0f} s".format)), omega[index]


@pytest.mark.parametrize(
    ("push", "noise", "words"),
    [
        (None, 1e-6, AS_STATED),
        (
            pushed(1e-4 * np.array([1.0, -0.5, 0.5]), True),
            3e-4,
            "a steady torque of 0.0001 rad/s2 in body axes",
        ),
        (
            pushed(1e-4 * np.array([1.0, -0.5, 0.5]), False),
            3e-4,
            "a steady torque of 0.0001 rad/s2 in axes fixed in space",
        ),
        (
            lambda t, _: np.radians([1.0, 0.0, 0.0]) * (124 <= t < 126),
            3e-4,
            "a step of the rate at 125 s",
        ),
    ],
)
def test_an_unmodelled_torque_or_step_is_named_and_the_rates_are_right(push, noise, words):
    found, omega = tried(push, noise)
    best = max(found, key=lambda trial: trial.best)
    assert best.hypothesis.what == words
    k = counted(found)[0].members[0][1]
    sigma = np.sqrt(np.einsum("nii->ni", best.fit.track.covariance[k, :, 3:, 3:]))
    assert np.abs((best.fit.track.omega[k] - omega) / sigma).max() < 4.5


@pytest.mark.parametrize(
    ("zero", "words"),
    [([0.0, 0.0, 0.0], AS_STATED), ([0.3, 0.0, -0.2], "a zero of the gyro of (0.")],
)
def test_an_unstated_gyro_zero_is_named_and_the_rates_are_right(zero, words):
    """Before, such a body was said to swing quicker than the samples."""
    found, omega = tried(None, 1e-6, zero)
    best = max(found, key=lambda trial: trial.best)
    assert best.hypothesis.what.startswith(words)
    off = np.degrees(np.abs(best.fit.track.omega[counted(found)[0].members[0][1]] - omega).max())
    assert off < 0.05


def test_a_gyro_zero_stated_with_a_sigma_needs_no_alternative_model():
    """What the name of the other zero asks for is done, and the pass is explained as stated."""
    named = max(
        tried(None, 1e-6, [0.3, 0.0, -0.2])[0], key=lambda trial: trial.best
    ).hypothesis.what
    assert named.endswith("besides that of the file: state its zero with a sigma")
    found, omega = tried(None, 1e-6, [0.3, 0.0, -0.2], np.radians(0.5))
    best = max(found, key=lambda trial: trial.best)
    assert best.hypothesis.what == AS_STATED
    assert (
        np.degrees(np.abs(best.fit.track.omega[counted(found)[0].members[0][1]] - omega).max())
        < 0.05
    )


def test_alternative_models_of_one_motion_share_its_probability():
    groups = counted(tried(None, 1e-6)[0])
    assert (
        len(groups) == 1
        and groups[0].weights.sum() == pytest.approx(1.0)
        and len(groups[0].members) > 1
    )


def short(off_rad):
    """What is made of six directions of the Sun, 20 s apart and good to 0.05 rad, the fourth of which is so far off."""
    rng, t = np.random.default_rng(5), np.arange(0.0, 120.0, 20.0)
    omega, attitude = spin(START, t)
    sun = np.einsum("nij,j->ni", attitude, axes := unit(rng)) + 0.05 * rng.normal(size=(6, 3))
    sun[3] = Rotation.from_rotvec(off_rad * np.cross(sun[3], unit(rng))).apply(sun[3])
    known = SunDirection.of(
        sun / np.linalg.norm(sun, axis=1, keepdims=True), np.tile(0.05**2 * np.eye(3), (6, 1, 1))
    )
    one = Hypothesis(
        AS_STATED,
        Observations(t, np.zeros((6, 3)), (known,)),
        np.arange(6),
        Motion(BODY, 1e-6, 0.075),
    )
    fit = with_common(
        one.fitted(), Track((attitude @ facing(axes))[None], omega[None]), one.motion, None
    )
    found = alternatives(weighed(one, fit), Others(False, "{:.0f} s".format))
    total = np.logaddexp.reduce(np.concatenate([trial.log_evidence for trial in found]))
    return {trial.hypothesis.what: float(np.exp(trial.best - total)) for trial in found}


def test_an_outlier_of_a_short_pass_is_left_out():
    assert short(0.7)["without the reading of the Sun at 60 s"] > 0.8
    assert sum(weight for what, weight in short(0.0).items() if what.startswith("without")) < 0.02
