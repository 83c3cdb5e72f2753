"""Simulated landing of Philae: synthetic telemetry with known truth, made from published facts.

The panel powers measured in flight are not public. This module simulates them. Quantities that the published facts do not determine
are drawn from a seed or chosen here:

- scale: `CELL_W` watts per cell, so that the lander makes some 8 W, about right at 2.99 AU; no result depends on it;
- noise: the vehicle file's, the same for each lit panel; dark panels read zero, lit ones never;
- panels: each misaligned by `tilt_rad`, and all together by `turned_rad` relative to the axes of inertia and wheel. Both are drawn
  with the vehicle file's sigmas. These were chosen so that the mean of twenty seeds has the published E and Delta of the descent;
  noise alone gives a tenth of that E. The published first direction is what the panels show, and the true one is computed from it;
- deployment: the rotation is as after it (the paper sees a slight variation only). Until sample 10 the folded legs block a fixed
  part of the light of each side panel;
- first rebound: the first sample has the published direction and the published wheel speed. Its rate, unless given, is a point of
  the published line L3. From this point |omega| is 2 pi / 13 s at the collision: the magnetometer's "13 s" is taken as the period;
- collision: a sticking impact on a leg, in a direction and at the speed of the paper's section 3.3;
- settling: the direction rotates evenly from that at the second touchdown to that at rest;
- rest: the comet moves the Sun along a great circle in body axes. Rocks shadow panel 1 wholly and panels 2 and 3 in part, then hide
  the Sun until it is below the panel plane. The orientation is chosen for the published lit patterns;
- first samples at rest (`rest_seen`): a rock covers panel 1 only after them, so that these give a direction, wrong by 25 degrees
  and with a large Delta: the paper's Fig. 4D has directions after the landing.

A landing of :func:`philae_twin` is drawn, not selected. The case's own telemetry is a landing that was selected from many, because
it agrees with what the paper prints: see :mod:`sunspin.philae.telemetry`.
"""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import xarray as xr
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.base.untrusted import require_whole
from sunspin.cases import Case, load_case
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.telemetry.synthetic import (
    draw_tilts,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
)
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

CELL_W = 0.02
"""Power of one cell at normal incidence at 2.99 AU: chosen, not measured."""

FOLDED_LEG_TRANSMISSION = (0.42, 0.72, 0.42, 0.72, 0.42, 1.0)
"""Part of the light that reaches each panel past the folded legs: gives n_z near 0.8 and Delta from 0.1 to 0.2."""

REST_TRANSMISSION = (0.0, 0.4, 0.4, 0.4, 0.4, 1.0)
"""Part of the light that reaches each panel at the final site: gives the lit patterns (2, 3, 6), (2, 3), (2)."""

BEFORE_THE_SHADOW = (0.15, 0.6, 0.3, 0.4, 0.4, 1.0)
"""The same before the shadow covers panel 1: the pattern (1, 2, 3, 6) gives a direction, with Delta from 0.1 to 0.2."""


class RestingSun(NamedTuple):
    """The Sun at rest: its great circle in body axes, and the part of its light that reaches each panel.

    The circle crosses the xy plane downwards at `azimuth_deg`, inclined to it by `inclination_deg`. `early` (n_panel): part of the
    light at the first samples at rest; `late` (n_panel): after a rock's shadow has covered panel 1.
    """

    azimuth_deg: float = 86.0
    inclination_deg: float = 80.0
    early: tuple[float, ...] = BEFORE_THE_SHADOW
    late: tuple[float, ...] = REST_TRANSMISSION


REST_ANGLES_DEG = (-60.0, -50.0, -40.0, 3.0)
"""Angles of the Sun along its great circle, from the point where it sinks below the xy plane: when the lander comes to rest, when
the shadow covers panel 1 (after some five samples), when the rocks begin and when they cease to hide the Sun.
"""

COMET_TURN_S = 12.4 * 3600.0  # 67P on the day
SPIN_PERIOD_S = 13.0  # before the collision: ROMAP team, 2014; read here as 2 pi / |omega|
SAMPLES_BEFORE_DESCENT, SAMPLES_OF_REBOUND = 9, 23
DEPLOYMENT_INTERVAL_S = 102.0  # nine samples between separation and 08:50:30 leave no more
REBOUND_INTERVAL_S = 120.0  # paper, section 1: about 2 min
SETTLING_INTERVAL_S = 150.0
REST_DURATION_S = 4.0 * 3600.0
JITTER_S = 6.0  # sample times are irregular by up to this, as housekeeping is
MAX_DRAWS = 200  # of what has to be possible, before it is refused


def twin(
    source: Case | Vehicle | str,
    truth: Truth | Mapping[str, Any] | None = None,
    seed: int = 0,
    **landing: Any,
) -> xr.Dataset:
    """Return synthetic telemetry of a vehicle that moves as `truth` says.

    Parameters
    ----------
    source : Case, Vehicle or name of a case
        ``"philae"`` without `truth` gives the whole landing, see :func:`philae_twin`.
    truth : Truth, or a mapping with its fields
    seed : int
        Of the noise and of all other random quantities. The same seed gives the same data.
    landing
        Options of the whole landing: `noise`, `omega_B`, `tilt_rad`, `turned_rad`, `rest_seen` of :func:`philae_twin`.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with the true direction `true_sun_B (time, axis)` and the truth in attributes
        ``truth_omega_B``, ``truth_sun_B``, ``truth_wheel_speed_rad_s``, ``truth_noise``, ``truth_scale``,
        ``truth_seed`` ...

    Raises
    ------
    InputError
        A truth with unknown or missing fields, a negative noise, options of the landing together with a truth.
    """
    if isinstance(source, str):
        source = load_case(source)
    require_whole("seed", seed, 0)
    if truth is None:
        if isinstance(source, Case) and source.name == "philae":
            return philae_twin(seed, **landing)
        raise InputError("a twin needs a truth", do="give omega_B, sun_B and t_s")
    if landing:
        what = "a twin with a truth takes no options of the landing"
        raise InputError(what, got=", ".join(landing))
    return synthetic_telemetry(source.vehicle if isinstance(source, Case) else source, truth, seed)


# ---- The landing of Philae ---------------------------------------------------------------------------------------------------


class State(NamedTuple):
    """State of a motion: time in s, rate (3) in rad/s, Sun direction (3), wheel speeds (n_wheel) in rad/s."""

    t_s: float
    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray


class PhaseSamples(NamedTuple):
    """Samples of one phase: times (n) in s, true Sun directions (n, 3), and the part of the light that reaches each panel.

    `transmission` is of shape (n, n_panel) or is broadcast to it.
    """

    phase: str
    t_s: np.ndarray
    sun_B: np.ndarray
    transmission: Any = 1.0

    def exact_power(self, vehicle: Vehicle, tilt: np.ndarray | None) -> np.ndarray:
        """Return the powers (n, n_panel) in W without noise of panels that are rotated by `tilt` (n_panel, 3)."""
        return CELL_W * vehicle.response_in().power(self.sun_B, tilt=tilt) * self.transmission


class SimulatedCollision(NamedTuple):
    """A simulated collision: the states just before and after it, the leg that hits, and the velocity (3) in m/s at the impact."""

    before: State
    after: State
    leg: str
    velocity_B: np.ndarray


def philae_twin(
    seed: int,
    noise: float | None = None,
    *,
    omega_B: npt.ArrayLike | None = None,
    tilt_rad: float | None = None,
    turned_rad: float | None = None,
    rest_seen: bool = True,
) -> xr.Dataset:
    """Return synthetic telemetry of the whole landing; the same seed gives the same data.

    `noise` is one sigma of a reading in W; zero gives the powers of the true directions. `omega_B` (3) is the true rate in rad/s at
    the first sample after the touchdown; default: the point of the line L3 with one revolution in 13 s at the collision. `tilt_rad`
    is one sigma of the angle by which each panel normal is off in two directions, `turned_rad` of the angle by which all panels are
    rotated about each axis; zero gives panels as drawn. The default of these and of `noise` is the vehicle file's. `rest_seen` says
    whether the first samples at rest give a direction.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with coordinate `phase (time)`, `true_sun_B (time, axis)` and the truth in
        ``truth_...`` attributes.

    Raises
    ------
    InputError
        The panels are rotated so far that no Sun makes them show the published first direction; another seed may work.
    """
    case = load_case("philae")
    vehicle = case.vehicle
    own_sigma, common_sigma = misalignment_sigma(vehicle)
    own_sigma = own_sigma if tilt_rad is None else tilt_rad
    common_sigma = common_sigma if turned_rad is None else turned_rad
    # each part has a stream of random numbers of its own, so that one can change and the others stay
    tilt = draw_panel_rotations(vehicle, own_sigma, common_sigma, generator(seed, 7))
    start = find_first_state(case, tilt, omega_B)
    collision = simulate_collision(case, start, generator(seed, 3))
    rebound_t = draw_rebound_times(case, generator(seed, 2))
    phases = [
        *simulate_descent(case, generator(seed, 1)),
        PhaseSamples("first_rebound", rebound_t, propagate_directions(vehicle, start, rebound_t)),
        simulate_second_rebound(case, collision.after, generator(seed, 4)),
        *simulate_ground_phases(
            case, collision.after, generator(seed, 5), generator(seed, 6), rest_seen
        ),
    ]
    power, noise_rng = [], generator(seed, 0)
    for samples in phases:
        add = add_rebound_noise if samples.phase == "first_rebound" else add_noise
        power.append(add(vehicle, samples, tilt, noise, noise_rng))
    truth = {
        "seed": seed,
        "noise": vehicle.require_noise() if noise is None else noise,
        **describe_truth(case, start, collision),
    }
    if tilt is not None:
        truth |= {"tilt_sigma_rad": own_sigma, "turned_sigma_rad": common_sigma}
        truth["tilt_B_rad"] = tilt.ravel()
    return join_phases(case, phases, power, truth)


def describe_truth(case: Case, start: State, collision: SimulatedCollision) -> dict[str, Any]:
    """Return the true state at the first sample after the touchdown, the collision and the descent's rate, by name."""
    before, after = collision.before, collision.after
    return {
        "scale": CELL_W,
        **start._asdict(),
        "collision_t_s": before.t_s,
        "collision_omega_before_B": before.omega_B,
        "collision_omega_after_B": after.omega_B,
        "collision_sun_B": before.sun_B,
        "collision_wheel_speed_after_rad_s": after.wheel_speed_rad_s,
        "collision_leg": collision.leg,
        "collision_velocity_B": collision.velocity_B,
        "descent_rate_cubic": np.array(case.published["descent_rate_cubic"].value),
    }


def join_phases(
    case: Case, phases: list[PhaseSamples], power: list[np.ndarray], truth: dict[str, Any]
) -> xr.Dataset:
    """Return the telemetry of all phases, with the readings (n, n_panel) of each, in the form of `read_telemetry`."""
    return telemetry_dataset(
        case.vehicle,
        np.concatenate([samples.t_s for samples in phases]),
        np.concatenate(power),
        np.concatenate([samples.sun_B for samples in phases]),
        case.require_timeline().epoch_utc,
        truth,
        np.repeat([samples.phase for samples in phases], [samples.t_s.size for samples in phases]),
    )


def draw_panel_rotations(
    vehicle: Vehicle, tilt_rad: float | np.ndarray, turned_rad: float, rng: np.random.Generator
) -> np.ndarray | None:
    """Draw rotation vectors (n_panel, 3) in rad of the panels: an own misalignment each, and a common one.

    None if both sigmas are zero.
    """
    if not (np.any(tilt_rad) or turned_rad):
        return None
    return turned_rad * rng.standard_normal(3) + draw_tilts(vehicle, tilt_rad, rng)


def draw_misaligned_panels(
    vehicle: Vehicle, shown_B: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray | None, np.ndarray]:
    """Draw panel rotations (n_panel, 3) with the vehicle file's sigmas, and return them with the true Sun direction (3).

    The true direction is the one that these panels show as `shown_B` (3). Rotations for which there is none are drawn again.
    Without sigmas in the vehicle file the result is None and `shown_B`.
    """
    sigmas = misalignment_sigma(vehicle)
    for _ in range(MAX_DRAWS):
        tilt = draw_panel_rotations(vehicle, *sigmas, rng)
        if tilt is None:
            return None, shown_B
        with suppress(InputError):
            return tilt, true_sun_direction(vehicle, shown_B, tilt)
    what = f"no Sun makes panels show this direction in {MAX_DRAWS} draws"
    raise InputError(what, got=f"sigmas {sigmas}")


def true_sun_direction(vehicle: Vehicle, shown_B: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """Return the true Sun direction (3) that panels rotated by `tilt` (n_panel, 3) show as `shown_B` (3) without noise.

    Raises `InputError` if no Sun makes them show it.
    """
    response = vehicle.response_in()
    lit = (response.power(shown_B) > 0)[:, None]
    misaligned = response.slopes(shown_B, tilt=tilt)
    # while the same panels are lit, power = rows @ sun is linear in the direction. The estimator inverts it with the rows of
    # panels as drawn, pinv(drawn) @ power, so the true direction solves pinv(drawn) @ rows @ sun = shown_B.
    rows = misaligned.to_sun + misaligned.power[:, None] * shown_B
    drawn = np.where(lit, response.light_power(shown_B)[1], 0.0)
    sun = np.linalg.solve(np.linalg.pinv(drawn) @ np.where(lit, rows, 0.0), shown_B)
    sun /= np.linalg.norm(sun)
    if not np.array_equal(response.power(sun, tilt=tilt) > 0, lit[:, 0]):
        what = "no Sun makes panels turned so far show the published direction"
        raise InputError(what, do="take another seed")
    return sun


def add_noise(
    vehicle: Vehicle,
    samples: PhaseSamples,
    tilt: np.ndarray | None,
    sigma: float | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the readings (n, n_panel) in W of a phase: powers of panels rotated by `tilt`, with noise of `sigma`.

    `tilt` (n_panel, 3) is in rad, None for panels as drawn; `sigma` in W, None for the vehicle file's.
    """
    return noisy_power(vehicle, samples.exact_power(vehicle, tilt), sigma, rng)


def add_rebound_noise(
    vehicle: Vehicle,
    samples: PhaseSamples,
    tilt: np.ndarray | None,
    sigma: float | None,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the readings (n, n_panel) in W of the first rebound, as `add_noise` does; its first sample shows what is published.

    The first direction after the touchdown is published as measured. So the noise of the first sample is projected onto the
    combinations of panels that raise Delta without changing the direction.
    """
    exact = samples.exact_power(vehicle, tilt)
    power = noisy_power(vehicle, exact, sigma, rng)
    lit = (exact[0] > 0)[:, None]
    rows = np.where(lit, vehicle.response_in().light_power(samples.sun_B[0])[1], 0.0)
    noise = power[0] - exact[0]
    power[0] = exact[0] + noise - rows @ (np.linalg.pinv(rows) @ noise)
    return power


def find_first_state(
    case: Case, tilt: np.ndarray | None = None, omega_B: npt.ArrayLike | None = None
) -> State:
    """Return the true state at the first sample after the first touchdown.

    `tilt` (n_panel, 3): rotations of the panels in rad. `omega_B` (3): the true rate in rad/s, None for that on the line L3.
    """
    timeline, published = case.require_timeline(), case.published
    t = timeline.event("first_sample_after_touchdown").t_s
    sun = np.array(published["first_sun"].value)
    sun = sun if tilt is None else true_sun_direction(case.vehicle, sun, tilt)
    speed = np.array([published["wheel_speed"].value])
    if omega_B is not None:
        return State(t, np.asarray(omega_B, dtype=np.float64), sun, speed)
    duration = timeline.event("collision").t_s - t
    point, along = np.array(published["line_L3"].value)

    def excess(step: float) -> float:
        """Return |omega| at the collision minus the rate of one revolution in 13 s, `step` along the line L3."""
        run = propagate(case.vehicle, point + step * along, sun, speed, [0.0, duration])
        return float(np.linalg.norm(run["omega_B"].values[-1])) - 2 * np.pi / SPIN_PERIOD_S

    step = brentq(excess, 0.0, 0.2, xtol=1e-14)
    return State(t, point + step * along, sun, speed)


def simulate_collision(case: Case, start: State, rng: np.random.Generator) -> SimulatedCollision:
    """Simulate the collision of the motion through `start`: draw leg and direction, apply the impact."""
    t = case.require_timeline().event("collision").t_s
    run = _propagate_to(case.vehicle, start, np.array([t]))
    before = State(t, *(run[key].values[-1] for key in State._fields[1:]))
    legs, assumed = case.vehicle.legs, case.assumptions.collision
    leg = legs[int(rng.integers(len(legs)))].name
    direction = rng.standard_normal(3)
    direction /= np.linalg.norm(direction)
    direction[2] = -abs(direction[2])  # paper, section 3.3: any direction, but towards -z
    velocity = case.published["collision_speed"].value * direction
    bounce: dict[str, Any] = {"restitution": assumed.restitution, "damper": assumed.damper}
    motion = before.omega_B, before.wheel_speed_rad_s
    after = impact(case.vehicle, *motion, velocity, leg, **bounce)
    omega, speed = after["omega_B"].values, after["wheel_speed_rad_s"].values
    return SimulatedCollision(before, State(t, omega, before.sun_B, speed), leg, velocity)


def _propagate_to(vehicle: Vehicle, state: State, t_s: np.ndarray) -> xr.Dataset:
    """Propagate a state to times t_s (n), the first of which may be the state's own time."""
    times = t_s if t_s[0] == state.t_s else np.concatenate([[state.t_s], t_s])
    return propagate(vehicle, *state[1:], times).isel(time=slice(-t_s.size, None))


def _add_jitter(t_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Return times (n) shifted at random by up to `JITTER_S`."""
    return on_time_grid(t_s + rng.uniform(-JITTER_S, JITTER_S, t_s.size))


def draw_rebound_times(case: Case, rng: np.random.Generator) -> np.ndarray:
    """Draw times (n) in s of the samples of the first rebound: the published first one, then even ones with jitter."""
    begin = case.require_timeline().event("first_sample_after_touchdown").t_s
    later = begin + REBOUND_INTERVAL_S * np.arange(1, SAMPLES_OF_REBOUND)
    return np.concatenate([on_time_grid([begin]), _add_jitter(later, rng)])


def simulate_second_rebound(case: Case, after: State, rng: np.random.Generator) -> PhaseSamples:
    """Return the samples between collision and second touchdown; `after`: state just after the collision."""
    t = _draw_sparse_times(case, "collision", rng)
    return PhaseSamples("second_rebound", t, propagate_directions(case.vehicle, after, t))


def propagate_directions(vehicle: Vehicle, state: State, t_s: np.ndarray) -> np.ndarray:
    """Return the true Sun directions (n, 3) at times t_s (n) of the motion through a state."""
    return _propagate_to(vehicle, state, t_s)["sun_B"].values


def _draw_sparse_times(
    case: Case, event: str, rng: np.random.Generator, duration_s: float | None = None
) -> np.ndarray:
    """Draw times (n) from an event on, at the mean interval of the published samples after the collision.

    There are as many as published, or as fit into `duration_s`.
    """
    n = case.published["samples_after_collision"].value
    interval = case.require_timeline().seconds("collision", "second_touchdown") / n
    n = n if duration_s is None else int(duration_s / interval)
    begin = case.require_timeline().event(event).t_s
    return _add_jitter(begin + interval * (np.arange(n) + 0.5), rng)


def simulate_descent(
    case: Case,
    rng: np.random.Generator,
    sun_z: float | None = None,
) -> tuple[PhaseSamples, PhaseSamples]:
    """Return samples 1 to 9 with folded legs, then 10 to the touchdown, rotating about z at the published cubic rate.

    `sun_z`: z component of the true Sun direction; default: the published n_z, as panels as drawn show it.
    """
    timeline, published = case.require_timeline(), case.published
    begin, end = (timeline.event(name).t_s for name in ("descent_fit_begins", "first_touchdown"))
    first, last = published["descent_samples"].value
    interval = published["descent_span"].value * 3600.0 / (last - first)
    count = int((end - begin - JITTER_S) / interval)
    folded = begin - DEPLOYMENT_INTERVAL_S * np.arange(SAMPLES_BEFORE_DESCENT, 0, -1)
    folded = _add_jitter(folded, rng)
    unfolded = np.append(begin, _add_jitter(begin + interval * np.arange(1, count + 1), rng))
    azimuth = rng.uniform(0, 2 * np.pi)
    rate = published["descent_rate_cubic"].value
    z = published["nz_descent"].value if sun_z is None else sun_z

    def sun(t_s: np.ndarray) -> np.ndarray:
        """Return Sun directions (n, 3): the Sun moves opposite to the body's spin; before sample 10 at the first rate."""
        before, after = np.minimum(t_s - begin, 0.0), np.maximum(t_s - begin, 0.0)
        angle = sum(c * after ** (k + 1) / (k + 1) for k, c in enumerate(rate)) + rate[0] * before
        flat = np.sqrt(1 - z**2)
        x, y = flat * np.cos(azimuth - angle), flat * np.sin(azimuth - angle)
        return np.stack([x, y, np.full(t_s.shape, z)], axis=-1)

    return (
        PhaseSamples("deployment", folded, sun(folded), FOLDED_LEG_TRANSMISSION),
        PhaseSamples("descent", unfolded, sun(unfolded)),
    )


def simulate_ground_phases(
    case: Case,
    after: State,
    settling_rng: np.random.Generator,
    rest_rng: np.random.Generator,
    rest_seen: bool = True,
    resting_sun: RestingSun | None = None,
) -> tuple[PhaseSamples, PhaseSamples]:
    """Return the samples of two phases: settling after the second touchdown, and rest among the rocks.

    `after` is the state just after the collision. While settling the direction rotates evenly from that at the second touchdown to
    that at rest. At rest the Sun moves along its great circle. `rest_seen`: whether the first samples at rest give a direction.
    """
    timeline = case.require_timeline()
    touchdown = np.array([timeline.event("second_touchdown").t_s])
    sun_B = propagate_directions(case.vehicle, after, touchdown)[0]
    begin, end = (timeline.event(name).t_s for name in ("second_touchdown", "rest"))
    at_first, shadow, hides, shows = np.radians(REST_ANGLES_DEG)
    resting_sun = resting_sun or RestingSun()
    azimuth, inclination = np.radians([resting_sun.azimuth_deg, resting_sun.inclination_deg])
    node = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    flat = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down = np.cos(inclination) * flat - np.sin(inclination) * np.array([0.0, 0.0, 1.0])

    def on_circle(angle: np.ndarray) -> np.ndarray:
        """Return the Sun directions (n, 3) at angles (n) in rad along its great circle."""
        return np.cos(angle)[..., None] * node + np.sin(angle)[..., None] * down

    t = np.arange(begin + SETTLING_INTERVAL_S / 2, end - JITTER_S, SETTLING_INTERVAL_S)
    t = _add_jitter(t, settling_rng)
    start, goal = sun_B / np.linalg.norm(sun_B), on_circle(at_first)
    rotation = np.cross(start, goal)  # rotation vector from start to goal
    rotation *= np.arctan2(np.linalg.norm(rotation), start @ goal) / np.linalg.norm(rotation)
    sun = Rotation.from_rotvec(((t - begin) / (end - begin))[:, None] * rotation).apply(start)
    settling = PhaseSamples("settling", t, sun)

    t = _draw_sparse_times(case, "rest", rest_rng, REST_DURATION_S)
    angle = at_first + 2 * np.pi * (t - end) / COMET_TURN_S
    hidden = (angle > hides) & (angle < shows)
    early = rest_seen & (angle < shadow)
    by_panel = np.where(early[:, None], resting_sun.early, resting_sun.late)
    return settling, PhaseSamples("rest", t, on_circle(angle), by_panel * ~hidden[:, None])
