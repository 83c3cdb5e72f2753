"""A synthetic landing of Philae: telemetry of every phase, made from published facts, with its truth.

The measured panel powers are not public, so this stands in for them. What the facts leave open is drawn from the seed
or chosen here, and said where it is:

- scale: `CELL_W` watts per cell, so that the lander makes some 8 W, about right at 2.99 AU; no result depends on it;
- noise: the vehicle file's, the same for each lit panel; dark panels read zero, lit ones never;
- deployment: rotation as after it (the paper sees a slight variation only); the folded legs take a fixed part of the
  light of each side panel, until sample 10;
- first rebound: the state at the first sample is the published direction, the published wheel speed, and the rate on
  the published line L3 that has |omega| = 2 pi / 13 s at the collision (the magnetometer's "13 s" read as the angular
  speed);
- collision: a sticking impact on a leg, in a direction and at the speed of the paper's section 3.3;
- settling: the direction turns from where it was at the second touchdown to where it is at rest, evenly;
- rest: the comet turns the Sun along a great circle in body axes; rocks shadow panel 1 wholly and panels 2 and 3 in
  part, then hide the Sun until it stands below the panel plane. The orientation is chosen for the published lit
  patterns.

- panels: each off by `tilt_rad`, and all together turned by `turned_rad` against the axes of inertia and wheel, drawn from the
  seed with the vehicle file's sigmas. These were chosen so that E and Delta of the descent are as published in the mean of
  twenty seeds, and noise alone gives a tenth of that E; the published first direction is what the panels show, and the true one
  what lies behind it;
- first samples at rest (`rest_seen`): a rock covers panel 1 only after them, so that these give a direction, wrong by 25 degrees
  and with a large Delta: the paper's Fig. 4D has directions after the landing.

The seed of the committed file is 0, the first: none was picked.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import propagate
from sunspin.telemetry.case import Case, load_case
from sunspin.telemetry.synthetic import (
    drawn_tilts,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
)
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import stated_sigma

CELL_W = 0.02
"""Power of one cell at normal incidence at 2.99 AU: chosen, not measured."""

FOLDED_LEG_TRANSMISSION = (0.42, 0.72, 0.42, 0.72, 0.42, 1.0)
"""Part of the light that reaches each panel past the folded legs: gives n_z near 0.8 and Delta in 0.1 .. 0.2."""

REST_TRANSMISSION = (0.0, 0.4, 0.4, 0.4, 0.4, 1.0)
"""The same past the rocks at the final site: gives the lit patterns (2, 3, 6), (2, 3), (2)."""

BEFORE_THE_SHADOW = (0.15, 0.6, 0.3, 0.4, 0.4, 1.0)
"""The same before the shadow is all over panel 1: the pattern (1, 2, 3, 6) has a direction, with Delta in 0.1 .. 0.2."""

SHADOW_ANGLE_DEG = -50.0
"""That lasts until the Sun is at this angle along its circle: for some five samples."""

COMET_TURN_S = 12.4 * 3600.0
"""Rotation period of 67P on the day."""

SPIN_PERIOD_S = 13.0
"""Turn before the collision: ROMAP team, 2014; read here as 2 pi / |omega|."""

SAMPLES_BEFORE_DESCENT, SAMPLES_OF_REBOUND = 9, 23
DEPLOYMENT_INTERVAL_S = 102.0  # nine samples between separation and 08:50:30 leave no more
REBOUND_INTERVAL_S = 120.0  # paper, section 1: about 2 min
SETTLING_INTERVAL_S = 150.0
REST_DURATION_S = 4.0 * 3600.0
JITTER_S = 6.0
"""Sample times are irregular by up to this, as housekeeping is."""

MASK_ANGLES_DEG = (-40.0, 3.0)
"""At rest the rocks hide the Sun while its angle along its circle is between these."""


MAX_DRAWS = 200
"""Draws of what has to be possible, before it is refused."""


class Part(NamedTuple):
    """The samples of one phase: times, true directions (n, 3), part of the light reaching each panel (n, n_panel)."""

    phase: str
    t_s: np.ndarray
    sun_B: np.ndarray
    transmission: np.ndarray


@dataclass(frozen=True)
class State:
    """A state of the motion: t_s, omega_B, sun_B, wheel speed (n_wheel)."""

    t_s: float
    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray


def philae_twin(
    seed: int,
    noise: float | None = None,
    *,
    tilt_rad: float | None = None,
    turned_rad: float | None = None,
    rest_seen: bool = True,
) -> xr.Dataset:
    """Synthetic telemetry of the whole landing.

    Parameters
    ----------
    seed : int
        The same seed gives the same data.
    noise : float, optional
        One sigma in W; default: the vehicle file's. Zero gives the powers that the true directions make.
    tilt_rad, turned_rad : float, optional
        One sigma of the angles by which each panel's normal is off to each side, and all panels together about each axis; default:
        the vehicle file's. Zero for panels as drawn.
    rest_seen : bool
        Whether the first samples at rest give a direction.

    Raises
    ------
    InputError
        Turns so large that no Sun makes the panels show the published first direction: another seed may.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with coordinate `phase (time)`, `true_sun_B (time, axis)` and the truth in
        ``truth_...`` attributes.
    """
    case = load_case("philae")
    vehicle = case.vehicle
    sigma = vehicle.require_noise() if noise is None else noise
    own, common = stated_sigma(vehicle)
    own, common = (
        own if tilt_rad is None else tilt_rad,
        common if turned_rad is None else turned_rad,
    )
    tilt = panel_turns(vehicle, own, common, generator(seed, 7))
    timeline, start = case.require_timeline(), first_state(case, tilt)
    before_blow, after_blow, blow = collision(case, start, generator(seed, 3))
    landed = _state_at(vehicle, after_blow, timeline.event("second_touchdown").t_s)
    parts = [
        *_descent(case, generator(seed, 1)),
        _rebound(case, "first_rebound", start, rebound_times(case, generator(seed, 2))),
        _rebound(case, "second_rebound", after_blow, _sparse_times(case, generator(seed, 4))),
        _settling(case, landed.sun_B, generator(seed, 5)),
        _rest(case, generator(seed, 6), rest_seen),
    ]
    t, sun, seen, phase = _joined(parts)
    exact = CELL_W * vehicle.response_in().power(sun, tilt=tilt) * seen
    power = noisy_power(vehicle, exact, noise, generator(seed, 0))
    first = int(np.flatnonzero(phase == "first_rebound")[0])
    power[first] = keep_direction(vehicle, sun[first], exact[first], power[first])
    truth = {
        "seed": seed,
        "noise": sigma,
        "scale": CELL_W,
        "t_s": start.t_s,
        "omega_B": start.omega_B,
        "sun_B": start.sun_B,
        "wheel_speed_rad_s": start.wheel_speed_rad_s,
        "collision_t_s": before_blow.t_s,
        "collision_omega_before_B": before_blow.omega_B,
        "collision_omega_after_B": after_blow.omega_B,
        "collision_sun_B": before_blow.sun_B,
        "collision_wheel_speed_after_rad_s": after_blow.wheel_speed_rad_s,
        **blow,
        **(
            {}
            if tilt is None
            else {"tilt_sigma_rad": own, "turned_sigma_rad": common, "tilt_B_rad": tilt.ravel()}
        ),
        "descent_rate_cubic": np.array(case.published["descent_rate_cubic"].value),
    }
    return telemetry_dataset(vehicle, t, power, sun, timeline.epoch_utc, truth, phase)


def panel_turns(
    vehicle: Vehicle, tilt_rad: float | np.ndarray, turned_rad: float, rng: np.random.Generator
) -> np.ndarray | None:
    """Turns (n_panel, 3) in rad of the panels: each its own, and one of all; None where neither is asked for."""
    if not (np.any(tilt_rad) or turned_rad):
        return None
    return turned_rad * rng.standard_normal(3) + drawn_tilts(vehicle, tilt_rad, rng)


def drawn_panels(
    vehicle: Vehicle, shown_B: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray | None, np.ndarray]:
    """Turns (n_panel, 3) of the panels, drawn with the sigmas of the vehicle's file (None where it has none), and the direction (3)
    behind what they show; drawn again where no Sun makes them show it."""
    sigmas = stated_sigma(vehicle)
    for _ in range(MAX_DRAWS):
        tilt = panel_turns(vehicle, *sigmas, rng)
        if tilt is None:
            return None, shown_B
        with suppress(InputError):
            return tilt, behind(vehicle, shown_B, tilt)
    raise InputError(
        f"no Sun makes panels show this direction in {MAX_DRAWS} draws", got=f"sigmas {sigmas}"
    )


def behind(vehicle: Vehicle, shown_B: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """The direction (3) of the Sun that panels turned by `tilt` (n_panel, 3) show as `shown_B` (3) where there is no noise."""
    response = vehicle.response_in()
    lit = (response.power(shown_B) > 0)[:, None]
    turned = response.slopes(shown_B, tilt=tilt)
    rows = (
        turned.to_sun + turned.power[:, None] * shown_B
    )  # power is linear in the direction while the same panels are lit
    drawn = np.where(lit, response.under(shown_B)[1], 0.0)
    sun = np.linalg.solve(np.linalg.pinv(drawn) @ np.where(lit, rows, 0.0), shown_B)
    sun /= np.linalg.norm(sun)
    if not np.array_equal(response.power(sun, tilt=tilt) > 0, lit[:, 0]):
        raise InputError(
            "no Sun makes panels turned so far show the published direction", do="take another seed"
        )
    return sun


def first_state(case: Case, tilt: np.ndarray | None = None) -> State:
    """The true state at the first sample after the first touchdown; `tilt` (n_panel, 3): turns of the panels."""
    timeline = case.require_timeline()
    t = timeline.event("first_sample_after_touchdown").t_s
    sun = np.array(case.published["first_sun"].value)
    sun = sun if tilt is None else behind(case.vehicle, sun, tilt)
    speed = np.array([case.published["wheel_speed"].value])
    duration = timeline.event("collision").t_s - t
    point, along = np.array(case.published["line_L3"].value)

    def excess(step: float) -> float:
        run = propagate(case.vehicle, point + step * along, sun, speed, [0.0, duration])
        return float(np.linalg.norm(run["omega_B"].values[-1])) - 2 * np.pi / SPIN_PERIOD_S

    step = brentq(excess, 0.0, 0.2, xtol=1e-14)
    return State(t, point + step * along, sun, speed)


def collision(
    case: Case, start: State, rng: np.random.Generator
) -> tuple[State, State, dict[str, Any]]:
    """The states just before and after the collision, and what hit: leg and velocity."""
    before = _state_at(case.vehicle, start, case.require_timeline().event("collision").t_s)
    legs = case.vehicle.legs
    leg = legs[int(rng.integers(len(legs)))].name
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    direction[2] = -abs(direction[2])  # paper, section 3.3: any direction, but towards -z
    velocity = case.published["collision_speed"].value * direction
    blow = case.assumptions.collision
    after = impact(
        case.vehicle,
        before.omega_B,
        before.wheel_speed_rad_s,
        velocity,
        leg,
        restitution=blow.restitution,
        damper=blow.damper,
    )
    told = {"collision_leg": leg, "collision_velocity_B": velocity}
    state = State(
        before.t_s, after["omega_B"].values, before.sun_B, after["wheel_speed_rad_s"].values
    )
    return before, state, told


def _state_at(vehicle: Vehicle, state: State, t_s: float) -> State:
    run = propagate(vehicle, state.omega_B, state.sun_B, state.wheel_speed_rad_s, [state.t_s, t_s])
    return State(t_s, *(run[key].values[-1] for key in ("omega_B", "sun_B", "wheel_speed_rad_s")))


def _jittered(t_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return t_s + rng.uniform(-JITTER_S, JITTER_S, t_s.size)


def _descent(case: Case, rng: np.random.Generator) -> tuple[Part, Part]:
    """Samples 1 to 9 with folded legs, then 10 to the touchdown: rotation about z at the published cubic rate."""
    begin, end = (
        case.require_timeline().event(name).t_s
        for name in ("descent_fit_begins", "first_touchdown")
    )
    first, last = case.published["descent_samples"].value
    interval = case.published["descent_span"].value * 3600.0 / (last - first)
    folded = begin - DEPLOYMENT_INTERVAL_S * np.arange(SAMPLES_BEFORE_DESCENT, 0, -1)
    later = begin + interval * np.arange(1, int((end - begin - JITTER_S) / interval) + 1)
    folded, later = on_time_grid(_jittered(folded, rng)), on_time_grid(_jittered(later, rng))
    unfolded = np.concatenate([[begin], later])
    azimuth = rng.uniform(0, 2 * np.pi)
    return (
        Part(
            "deployment",
            folded,
            _descent_sun(case, folded - begin, azimuth),
            _constant(FOLDED_LEG_TRANSMISSION, folded),
        ),
        Part(
            "descent",
            unfolded,
            _descent_sun(case, unfolded - begin, azimuth),
            _constant((1.0,) * 6, unfolded),
        ),
    )


def _descent_sun(case: Case, t: np.ndarray, azimuth: float) -> np.ndarray:
    """Directions (n, 3) at t (s from sample 10): the Sun goes round backward; before t = 0 at the first rate."""
    rate = case.published["descent_rate_cubic"].value
    angle = sum(c * np.maximum(t, 0.0) ** (k + 1) / (k + 1) for k, c in enumerate(rate)) + rate[
        0
    ] * np.minimum(t, 0.0)
    z = case.published["nz_descent"].value
    flat = np.sqrt(1 - z**2)
    return np.stack(
        [flat * np.cos(azimuth - angle), flat * np.sin(azimuth - angle), np.full(t.shape, z)],
        axis=-1,
    )


def rebound_times(case: Case, rng: np.random.Generator) -> np.ndarray:
    """Times (n) in s of the samples of the first rebound: even but for `JITTER_S`, the first where it is known to be."""
    begin = case.require_timeline().event("first_sample_after_touchdown").t_s
    later = begin + REBOUND_INTERVAL_S * np.arange(1, SAMPLES_OF_REBOUND)
    return on_time_grid(np.concatenate([[begin], _jittered(later, rng)]))


def _sparse_times(case: Case, rng: np.random.Generator) -> np.ndarray:
    """The published number of samples, spread over the time between collision and second touchdown."""
    timeline = case.require_timeline()
    begin, duration = (
        timeline.event("collision").t_s,
        timeline.seconds("collision", "second_touchdown"),
    )
    n = case.published["samples_after_collision"].value
    return on_time_grid(_jittered(begin + duration * (np.arange(n) + 0.5) / n, rng))


def _rebound(case: Case, phase: str, state: State, t: np.ndarray) -> Part:
    times = t if t[0] == state.t_s else np.concatenate([[state.t_s], t])
    run = propagate(case.vehicle, state.omega_B, state.sun_B, state.wheel_speed_rad_s, times)
    return Part(phase, t, run["sun_B"].values[-t.size :], _constant((1.0,) * 6, t))


def _settling(case: Case, sun_B: np.ndarray, rng: np.random.Generator) -> Part:
    begin, end = (case.require_timeline().event(name).t_s for name in ("second_touchdown", "rest"))
    t = np.arange(begin + SETTLING_INTERVAL_S / 2, end - JITTER_S, SETTLING_INTERVAL_S)
    t = on_time_grid(_jittered(t, rng))
    start, goal = sun_B / np.linalg.norm(sun_B), _rest_sun(np.zeros(1))[0]
    turn = np.cross(start, goal)
    turn *= np.arctan2(np.linalg.norm(turn), start @ goal) / np.linalg.norm(turn)
    sun = Rotation.from_rotvec(((t - begin) / (end - begin))[:, None] * turn).apply(start)
    return Part("settling", t, sun, _constant((1.0,) * 6, t))


def _rest(case: Case, rng: np.random.Generator, seen_first: bool) -> Part:
    timeline = case.require_timeline()
    begin = timeline.event("rest").t_s
    interval = (
        timeline.seconds("collision", "second_touchdown")
        / case.published["samples_after_collision"].value
    )
    t = on_time_grid(
        _jittered(begin + interval * (np.arange(int(REST_DURATION_S / interval)) + 0.5), rng)
    )
    angle = np.degrees(_rest_angle(t - begin))
    hidden = (angle > MASK_ANGLES_DEG[0]) & (angle < MASK_ANGLES_DEG[1])
    early = seen_first & (angle < SHADOW_ANGLE_DEG)
    seen = np.where(early[:, None], BEFORE_THE_SHADOW, REST_TRANSMISSION) * ~hidden[:, None]
    return Part("rest", t, _rest_sun(t - begin), seen)


def _rest_angle(t: np.ndarray) -> np.ndarray:
    """Angle (rad) along the Sun's circle, from where it sinks below the xy plane."""
    return np.radians(-60.0) + 2 * np.pi * t / COMET_TURN_S


def _rest_sun(t: np.ndarray) -> np.ndarray:
    """Directions (n, 3) at t (s from coming to rest): a great circle, 80 degrees to xy, which it meets at 86."""
    azimuth, tilt, angle = np.radians(86.0), np.radians(80.0), _rest_angle(t)[:, None]
    node = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    flat = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    return np.cos(angle) * node + np.sin(angle) * (
        np.cos(tilt) * flat - np.sin(tilt) * np.array([0.0, 0.0, 1.0])
    )


def _constant(transmission: tuple[float, ...], t: np.ndarray) -> np.ndarray:
    return np.tile(transmission, (t.size, 1))


def _joined(parts: list[Part]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    t, sun, transmission = (
        np.concatenate([getattr(part, key) for part in parts])
        for key in ("t_s", "sun_B", "transmission")
    )
    return (
        t,
        sun,
        transmission,
        np.concatenate([np.full(part.t_s.size, part.phase) for part in parts]),
    )


def keep_direction(
    vehicle: Vehicle, sun_B: np.ndarray, exact: np.ndarray, noisy: np.ndarray
) -> np.ndarray:
    """Confine the noise of one sample, the Sun at sun_B, to what its redundancy shows, so that the measured direction
    is the one without noise.

    The first direction after the touchdown is published as measured: so this sample's noise may raise Delta but not turn the
    direction.
    """
    rows = np.where((exact > 0)[:, None], vehicle.response_in().under(sun_B)[1], 0.0)
    noise = noisy - exact
    return exact + noise - rows @ (np.linalg.pinv(rows) @ noise)
