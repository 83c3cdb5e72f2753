"""Alternative models of what else may have moved the body, or of wrong sensors: the nominal model with one entry changed.

Each is fitted from the motions of the nominal model, and has the same prior probability unless it says otherwise. Sigmas are never
enlarged by hand: an alternative that explains the readings adds its own motion and errors to the sum. Samples between the kept ones
are propagated to by the equations of the nominal model (:func:`sunspin.estimate.dense.propagate_to_all`). So an alternative may add
torques and change sensors, but not the momentum of the wheels. That belongs to the nominal model of the file:
:func:`sunspin.estimate.wheels.decide_wheels` chooses it, and :mod:`sunspin.estimate.changed_wheel` changes it within a pass.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from sunspin.estimate.chain import RATE, Fit, defects, fit
from sunspin.estimate.evidence import best_cost, best_fit, best_nominal_fit
from sunspin.estimate.model import Model, Track
from sunspin.estimate.settings import AlternativeSettings
from sunspin.estimate.terms.field import FieldChange
from sunspin.estimate.terms.inertial import GyroRates
from sunspin.estimate.terms.panels import TILT_SIGMA_RAD, Panels
from sunspin.estimate.terms.torques import WORDS, ConstantTorque

MISALIGNED = "misaligned panels"
"""Begin of the name of that model; the panel that shows it most follows."""

LEAST_STEP = 1e-3
"""Least size of a rate step, in sigmas of the rate before the data."""


def alternatives(nominal: Model, fits: Sequence[Fit], s: AlternativeSettings) -> Iterator[Model]:
    """Yield the models that are tried in addition to the nominal one.

    A constant torque in the body, and one in space; a gyro or a magnetometer whose zero is off; a gyro whose zero drifts, or whose
    scale is off; misaligned panels; steps of the rate. `fits`: all fits so far. The caller must append the fits of each model to
    this list before it takes the next one, since a further step of the rate is tried only if the one before it raised the evidence.
    """
    duration_s = float(np.ptp(nominal.obs.t_s))
    for frame, words in WORDS.items():
        torque = ConstantTorque.turning(
            frame, s.torque_turns_rad, duration_s, nominal.body.inertia, nominal.obs.momentum
        )
        yield nominal.plus(torque, f"a steady torque in {words}")
    yield from another_zero(nominal, s)
    yield from drifting_zero(nominal, s)
    yield from another_scale(nominal, s)
    yield from misaligned_panels(nominal, fits, s)
    yield from steps_of_the_rate(nominal, fits, s)


def another_zero(nominal: Model, s: AlternativeSettings) -> Iterator[Model]:
    """Yield models of a gyro whose zero is off by more than the file states, and of a magnetometer without a stated zero sigma.

    A gyro with a wrong zero makes the motion wrong: with a zero off by 0.5 deg/s and stated to 0.006 a pass was decided and wrong
    by 8 sigma, as the scale of the gyro took the error. The verdict still tests the gyro with the zero that the file states.

    A file that states no sigma of a magnetometer's zero does not say that it is calibrated. So the odds are even, and it fits with
    the zero that is estimated. Without this model, readings with a zero of a tenth of the field decided a pass 8 sigma off.
    """
    for term in nominal.obs.terms:
        if not term.present().any():
            continue
        if isinstance(term, GyroRates) and not term.any_zero:
            log_odds = s.zero_odds
        elif isinstance(term, FieldChange) and not len(term.zero_B):
            log_odds = 0.0
        else:
            continue
        yield replace(
            nominal,
            obs=nominal.obs.replacing(term, term.with_any_zero()),
            what=f"another zero offset of the {term.label}",
            log_prior=nominal.log_prior + log_odds,
        )


def drifting_zero(nominal: Model, s: AlternativeSettings) -> Iterator[Model]:
    """Yield the model of a gyro whose zero offset drifts evenly during the pass.

    Of 18 decided passes with a drift of 0.2 deg/s five were off by more than 4.5 sigma at some sample without this model.
    """
    gyro, t_s = nominal.obs.of_kind(GyroRates), nominal.obs.t_s
    if gyro is not None and gyro.present().sum() > 2:
        yield replace(
            nominal,
            obs=nominal.obs.replacing(gyro, gyro.drifting((float(t_s[0]), float(t_s[-1])))),
            what="a drifting zero offset of the gyro",
            log_prior=nominal.log_prior + s.drift_odds,
        )


def another_scale(nominal: Model, s: AlternativeSettings) -> Iterator[Model]:
    """Yield the model of a gyro whose scale is off, if the file states no sigma of it and the error may exceed the noise.

    The scale of a small gyro is often off by 1 or 2 %. A file without a sigma does not say that it is calibrated, so the odds are
    even. Of eight passes at 35 deg/s with a scale off by 1.5 % three were decided 12 to 28 sigma off without this, and none of the
    others was decided; now all are decided and right.
    """
    gyro = nominal.obs.of_kind(GyroRates)
    if gyro is None or gyro.scale_sigma or not gyro.present().any():
        return
    if s.gyro_scale_sigma * np.nanmax(np.abs(gyro.rate_B)) > gyro.sigma:
        with_scale = replace(gyro, scale_sigma=s.gyro_scale_sigma)
        obs = nominal.obs.replacing(gyro, with_scale)
        yield replace(nominal, obs=obs, what="another scale of the gyro")


def misaligned_panels(
    nominal: Model, fits: Sequence[Fit], s: AlternativeSettings
) -> Iterator[Model]:
    """Yield the model of panels that are tilted from the directions in the vehicle file, if the residuals of a panel show it.

    A misaligned panel reads too much on one side of the Sun and too little on the other. An error of the rates can explain much of
    that: with a panel off by 17 degrees a pass was decided and wrong by 17 sigma. `fits` as in :func:`alternatives`.
    """
    # the panels are the first term; `own`: their unknowns
    panels, own = nominal.terms_with_slices[0] if nominal.obs.only_sun else (None, slice(0))
    # their tilts must become the last unknowns of the model: those that a motion lacks are added at its end when it is fitted
    if not isinstance(panels, Panels) or own.stop < len(nominal.unknowns):
        return
    # if nothing fits, as with exchanged columns, large tilts of all panels must not explain that
    if best_cost(fits) > nominal.obs.cost_limit:
        return
    motion = best_nominal_fit(fits).motions
    (residual,) = panels.residuals(motion, motion.u[:, own])
    _, weights = residual.law(residual.value)
    weight = weights[0]  # of each sample (n), as outliers count less
    assert residual.by_turn is not None
    # half of what two tilt angles of each panel take from the weighted square of its residuals, by least squares
    gains = []
    for panel, axes in enumerate(panels.tilt_axes()):
        # residuals (n) of the panel, and their derivative (n, 2) by its tilt about two axes
        slope, value = residual.by_turn[0, :, panel] @ axes.T, residual.value[0, :, panel]
        matrix, gradient = slope.T @ (weight[:, None] * slope), slope.T @ (weight * value)
        gains.append(float(gradient @ np.linalg.pinv(matrix, hermitian=True) @ gradient) / 2)
    if max(gains, default=0.0) > s.tilt_shows:
        name = panels.names[int(np.argmax(gains))]
        obs = nominal.obs.replacing(panels, replace(panels, tilt_sigma=TILT_SIGMA_RAD))
        yield replace(nominal, obs=obs, what=f"{MISALIGNED}, {name} most")


def steps_of_the_rate(
    nominal: Model, fits: Sequence[Fit], s: AlternativeSettings
) -> Iterator[Model]:
    """Yield models in which the rate changes suddenly in one interval, then in a second one too, as long as the evidence grows.

    A step is tried in the interval in which the best motion so far violates the equations of motion most. Unknown torques that are
    strong enough for a step are too strong for all other intervals, and make the rate next to the step too sure: without steps one
    of twelve passes with a thrust was decided and wrong by 6 sigma. The interval of a step is not known, which costs the log of the
    number of intervals in evidence. Near a sample the data hardly show whether a step came before or after it, so each step is also
    tried one interval earlier and later. `fits` as in :func:`alternatives`.
    """
    # the most probable motion with the steps so far, at first with none
    best = best_nominal_fit(fits)
    steps: tuple[tuple[int, float], ...] = ()  # interval, size in rad/s
    intervals = len(nominal.obs) - 1
    price = np.log(intervals) + s.step_sizes
    for _ in range(min(s.most_steps, intervals - 1)):
        defect = defects(best.model, best.motions).value[0]
        defect_square = (defect**2).sum(axis=1)  # of each interval
        defect_square[[interval for interval, _ in steps]] = 0.0
        worst = int(np.argmax(defect_square))
        # Under the weakest torques a step gains at most half the squared defect of its interval. Under stronger ones other
        # intervals gain too, as weaker torques then suffice there, which only the fit can show.
        weakest = min(fitted.model.noise.acceleration for fitted in fits)
        if best.model.noise.acceleration == weakest and defect_square[worst] / 2 < price:
            return
        sigma = _size_of_step(best.model, best.motions, worst)
        steps = (*steps, (worst, sigma))
        model = _with_steps(nominal, steps, price)
        yield model
        with_step = [fitted for fitted in fits if fitted.model.what == model.what]
        if not with_step or best_fit(with_step).log_evidence[0] <= best.log_evidence[0]:
            return
        best = best_fit(with_step)
        used = [interval for interval, _ in steps]
        for interval in (worst - 1, worst + 1):
            if 0 <= interval < intervals and interval not in used:
                yield _with_steps(nominal, (*steps[:-1], (interval, sigma)), price)


def _size_of_step(model: Model, motion: Track, interval: int) -> float:
    """Return the size (rad/s) of a step of the rate that the data suggest in an interval: the root mean square of its components.

    The motion (K = 1) is fitted with a step whose prior is as wide as that of the rate itself. The step is then the difference
    between the rate at the end of the interval and the one that the equations of motion give there.
    """
    widest = model.rate_sigma
    noise = replace(model.noise, steps=(*model.noise.steps, (interval, widest)))
    with_free_step = replace(model, noise=noise)
    fitted = fit(with_free_step, motion, steps=6).motions
    change = changes_of_rate(with_free_step, fitted)[interval]
    return float(np.clip(np.linalg.norm(change) / np.sqrt(3), LEAST_STEP * widest, widest))


def changes_of_rate(model: Model, motion: Track) -> np.ndarray:
    """Return by how much the rate at the end of each interval differs from the one that the equations of motion give there.

    The motion has K = 1. The result (n - 1, 3) is in rad/s and body axes.
    """
    defect = defects(model, motion)
    return defect.unwhitened(defect.value)[0, :, RATE]


def _with_steps(nominal: Model, steps: tuple[tuple[int, float], ...], price: float) -> Model:
    """Return the nominal model with steps of the rate (interval, size in rad/s); each costs `price` in log evidence."""
    t_s = nominal.obs.t_s
    times = sorted((t_s[interval] + t_s[interval + 1]) / 2 for interval, _ in steps)
    at = ", ".join(f"{time:.0f}" for time in times)
    return replace(
        nominal,
        noise=replace(nominal.noise, steps=steps),
        what=f"{'steps' if len(steps) > 1 else 'a step'} of the rate at {at} s",
        log_prior=nominal.log_prior - len(steps) * price,
    )
