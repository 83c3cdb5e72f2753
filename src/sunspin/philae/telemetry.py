"""Synthetic telemetry with known truth: of a vehicle that moves as told, or of the whole landing of Philae.

The measured panel powers are not public, so the landing stands in for them, made from published facts;
``python -m sunspin.philae.telemetry --seed N OUT.csv`` writes it as a telemetry file. What the facts leave open is drawn from the
seed or chosen here, and said where it is:

- scale: `CELL_W` watts per cell, so that the lander makes some 8 W, about right at 2.99 AU; no result depends on it;
- noise: the vehicle file's, the same for each lit panel; dark panels read zero, lit ones never;
- panels: each off by `tilt_rad`, and all together turned by `turned_rad` against the axes of inertia and wheel, drawn from the
  seed with the vehicle file's sigmas. These were chosen so that E and Delta of the descent are as published in the mean of
  twenty seeds, and noise alone gives a tenth of that E; the published first direction is what the panels show, and the true one
  what lies behind it;
- deployment: rotation as after it (the paper sees a slight variation only); the folded legs take a fixed part of the
  light of each side panel, until sample 10;
- first rebound: the state at the first sample is the published direction, the published wheel speed, and the rate on
  the published line L3 that has |omega| = 2 pi / 13 s at the collision (the magnetometer's "13 s" read as the angular
  speed);
- collision: a sticking impact on a leg, in a direction and at the speed of the paper's section 3.3;
- settling: the direction turns from where it was at the second touchdown to where it is at rest, evenly;
- rest: the comet turns the Sun along a great circle in body axes; rocks shadow panel 1 wholly and panels 2 and 3 in
  part, then hide the Sun until it stands below the panel plane. The orientation is chosen for the published lit
  patterns;
- first samples at rest (`rest_seen`): a rock covers panel 1 only after them, so that these give a direction, wrong by 25 degrees
  and with a large Delta: the paper's Fig. 4D has directions after the landing.

The seed of the committed file is 0, the first: none was picked.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError, SunspinError
from sunspin.base.provenance import version
from sunspin.cases import Case, load_case
from sunspin.dynamics.impact import impact
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.telemetry.synthetic import (
    csv_text,
    draw_tilts,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
    truth_text,
    write_new,
)
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

CELL_W = 0.02
"""Power of one cell at normal incidence at 2.99 AU: chosen, not measured."""

FOLDED_LEG_TRANSMISSION = (0.42, 0.72, 0.42, 0.72, 0.42, 1.0)
"""Part of the light that reaches each panel past the folded legs: gives n_z near 0.8 and Delta in 0.1 .. 0.2."""

REST_TRANSMISSION = (0.0, 0.4, 0.4, 0.4, 0.4, 1.0)
"""Past the rocks at the final site: gives the lit patterns (2, 3, 6), (2, 3), (2)."""

BEFORE_THE_SHADOW = (0.15, 0.6, 0.3, 0.4, 0.4, 1.0)
"""Before the shadow is all over panel 1: the pattern (1, 2, 3, 6) has a direction, with Delta in 0.1 .. 0.2."""

REST_ANGLES_DEG = (-60.0, -50.0, -40.0, 3.0)
"""Angle of the Sun along its circle from where it sinks below the xy plane: when the lander comes to rest; until where the shadow
leaves panel 1 free (some five samples); between which the rocks hide the Sun."""

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
    """Synthetic telemetry of a vehicle that moves as `truth` says.

    Parameters
    ----------
    source : Case, Vehicle or name of a case
        ``"philae"`` without `truth` gives the whole landing, see :func:`sunspin.philae.telemetry.philae_twin`.
    truth : Truth, or a mapping with its fields
    seed : int
        Of the noise and of what else is drawn. The same seed gives the same data.
    landing
        Of the whole landing: `noise`, `tilt_rad`, `turned_rad`, `rest_seen` of
        :func:`sunspin.philae.telemetry.philae_twin`.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with the true direction `true_sun_B (time, axis)` and the truth in attributes
        ``truth_omega_B``, ``truth_sun_B``, ``truth_wheel_speed_rad_s``, ``truth_noise``, ``truth_scale``,
        ``truth_seed`` ...

    Raises
    ------
    InputError
        A truth with unknown or missing fields, a negative noise, options of the landing beside a truth.
    """
    if isinstance(source, str):
        source = load_case(source)
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
    """A state of the motion: t_s, omega_B, sun_B, wheel speed (n_wheel)."""

    t_s: float
    omega_B: np.ndarray
    sun_B: np.ndarray
    wheel_speed_rad_s: np.ndarray


class PhaseSamples(NamedTuple):
    """The samples of one phase: times (n), true directions (n, 3), part of the light that reaches each panel, (n, n_panel) or as
    broadcast to it."""

    phase: str
    t_s: np.ndarray
    sun_B: np.ndarray
    transmission: Any = 1.0


def philae_twin(
    seed: int,
    noise: float | None = None,
    *,
    tilt_rad: float | None = None,
    turned_rad: float | None = None,
    rest_seen: bool = True,
) -> xr.Dataset:
    """Synthetic telemetry of the whole landing; the same seed gives the same data.

    `noise`: one sigma in W (zero: the powers that the true directions make); `tilt_rad`, `turned_rad`: one sigma of the angles by
    which each panel's normal is off to each side, and all panels together about each axis (zero: panels as drawn); default: the
    vehicle file's. `rest_seen`: whether the first samples at rest give a direction. An `InputError` where the turns are so large
    that no Sun makes the panels show the published first direction: another seed may.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with coordinate `phase (time)`, `true_sun_B (time, axis)` and the truth in
        ``truth_...`` attributes.
    """
    case = load_case("philae")
    vehicle, timeline = case.vehicle, case.require_timeline()
    own, common = misalignment_sigma(vehicle)
    own = own if tilt_rad is None else tilt_rad
    common = common if turned_rad is None else turned_rad
    tilt = panel_turns(vehicle, own, common, generator(seed, 7))

    start = first_state(case, tilt)
    before, after, blow = collide(case, start, generator(seed, 3))
    first_t = rebound_times(case, generator(seed, 2))
    second_t = _sparse_times(case, "collision", generator(seed, 4))
    landed = _flown(vehicle, after, np.array([timeline.event("second_touchdown").t_s]))
    phases = [
        *_descent(case, generator(seed, 1)),
        PhaseSamples("first_rebound", first_t, _flown(vehicle, start, first_t)["sun_B"].values),
        PhaseSamples("second_rebound", second_t, _flown(vehicle, after, second_t)["sun_B"].values),
        *_on_the_ground(case, landed["sun_B"].values[-1], seed, rest_seen),
    ]
    t, sun = (np.concatenate([getattr(each, key) for each in phases]) for key in ("t_s", "sun_B"))
    phase = np.repeat([each.phase for each in phases], [each.t_s.size for each in phases])
    panels = len(vehicle.panels)
    seen = [np.broadcast_to(each.transmission, (each.t_s.size, panels)) for each in phases]

    exact = CELL_W * vehicle.response_in().power(sun, tilt=tilt) * np.concatenate(seen)
    first = int(np.flatnonzero(phase == "first_rebound")[0])
    power = noisy_readings(vehicle, sun, exact, noise, generator(seed, 0), first)
    truth = {
        "seed": seed,
        "noise": vehicle.require_noise() if noise is None else noise,
        "scale": CELL_W,
        **start._asdict(),
        "collision_t_s": before.t_s,
        "collision_omega_before_B": before.omega_B,
        "collision_omega_after_B": after.omega_B,
        "collision_sun_B": before.sun_B,
        "collision_wheel_speed_after_rad_s": after.wheel_speed_rad_s,
        **blow,
    }
    if tilt is not None:
        truth |= {"tilt_sigma_rad": own, "turned_sigma_rad": common, "tilt_B_rad": tilt.ravel()}
    truth["descent_rate_cubic"] = np.array(case.published["descent_rate_cubic"].value)
    return telemetry_dataset(vehicle, t, power, sun, timeline.epoch_utc, truth, phase)


def panel_turns(
    vehicle: Vehicle, tilt_rad: float | np.ndarray, turned_rad: float, rng: np.random.Generator
) -> np.ndarray | None:
    """Turns (n_panel, 3) in rad of the panels: each its own, and one of all; None where neither is asked for."""
    if not (np.any(tilt_rad) or turned_rad):
        return None
    return turned_rad * rng.standard_normal(3) + draw_tilts(vehicle, tilt_rad, rng)


def drawn_panels(
    vehicle: Vehicle, shown_B: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray | None, np.ndarray]:
    """Turns (n_panel, 3) of the panels, drawn with the sigmas of the vehicle's file (None where it has none), and the direction (3)
    behind what they show; drawn again where no Sun makes them show it."""
    sigmas = misalignment_sigma(vehicle)
    for _ in range(MAX_DRAWS):
        tilt = panel_turns(vehicle, *sigmas, rng)
        if tilt is None:
            return None, shown_B
        with suppress(InputError):
            return tilt, behind(vehicle, shown_B, tilt)
    what = f"no Sun makes panels show this direction in {MAX_DRAWS} draws"
    raise InputError(what, got=f"sigmas {sigmas}")


def behind(vehicle: Vehicle, shown_B: np.ndarray, tilt: np.ndarray) -> np.ndarray:
    """The direction (3) of the Sun that panels turned by `tilt` (n_panel, 3) show as `shown_B` (3) where there is no noise."""
    response = vehicle.response_in()
    lit = (response.power(shown_B) > 0)[:, None]
    turned = response.slopes(shown_B, tilt=tilt)
    # power is linear in the direction while the same panels are lit
    rows = turned.to_sun + turned.power[:, None] * shown_B
    drawn = np.where(lit, response.light_power(shown_B)[1], 0.0)
    sun = np.linalg.solve(np.linalg.pinv(drawn) @ np.where(lit, rows, 0.0), shown_B)
    sun /= np.linalg.norm(sun)
    if not np.array_equal(response.power(sun, tilt=tilt) > 0, lit[:, 0]):
        what = "no Sun makes panels turned so far show the published direction"
        raise InputError(what, do="take another seed")
    return sun


def noisy_readings(
    vehicle: Vehicle,
    sun_B: np.ndarray,
    exact: np.ndarray,
    sigma: float | None,
    rng: np.random.Generator,
    first: int = 0,
) -> np.ndarray:
    """Powers (n, n_panel) that are `exact` with the Sun at sun_B (n, 3), with noise of `sigma` (None: the vehicle file's); that of
    sample `first` is confined to what its redundancy shows.

    The first direction after the touchdown is published as measured: so this sample's noise may raise Delta but not turn the
    direction.
    """
    power = noisy_power(vehicle, exact, sigma, rng)
    rows = np.where(
        (exact[first] > 0)[:, None], vehicle.response_in().light_power(sun_B[first])[1], 0.0
    )
    noise = power[first] - exact[first]
    power[first] = exact[first] + noise - rows @ (np.linalg.pinv(rows) @ noise)
    return power


def first_state(case: Case, tilt: np.ndarray | None = None) -> State:
    """The true state at the first sample after the first touchdown; `tilt` (n_panel, 3): turns of the panels."""
    timeline, published = case.require_timeline(), case.published
    t = timeline.event("first_sample_after_touchdown").t_s
    sun = np.array(published["first_sun"].value)
    sun = sun if tilt is None else behind(case.vehicle, sun, tilt)
    speed = np.array([published["wheel_speed"].value])
    duration = timeline.event("collision").t_s - t
    point, along = np.array(published["line_L3"].value)

    def excess(step: float) -> float:
        run = propagate(case.vehicle, point + step * along, sun, speed, [0.0, duration])
        return float(np.linalg.norm(run["omega_B"].values[-1])) - 2 * np.pi / SPIN_PERIOD_S

    step = brentq(excess, 0.0, 0.2, xtol=1e-14)
    return State(t, point + step * along, sun, speed)


def collide(
    case: Case, start: State, rng: np.random.Generator
) -> tuple[State, State, dict[str, Any]]:
    """The states just before and after the collision, and what hit: leg and velocity."""
    t = case.require_timeline().event("collision").t_s
    run = _flown(case.vehicle, start, np.array([t]))
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
    hit = {"collision_leg": leg, "collision_velocity_B": velocity}
    return before, State(t, omega, before.sun_B, speed), hit


def _flown(vehicle: Vehicle, state: State, t_s: np.ndarray) -> xr.Dataset:
    """The motion from a state at t_s (n), the first of which may be the state's own time."""
    times = t_s if t_s[0] == state.t_s else np.concatenate([[state.t_s], t_s])
    return propagate(vehicle, *state[1:], times).isel(time=slice(-t_s.size, None))


def _jittered(t_s: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return on_time_grid(t_s + rng.uniform(-JITTER_S, JITTER_S, t_s.size))


def rebound_times(case: Case, rng: np.random.Generator) -> np.ndarray:
    """Times (n) in s of the samples of the first rebound: even but for `JITTER_S`, the first where it is known to be."""
    begin = case.require_timeline().event("first_sample_after_touchdown").t_s
    later = begin + REBOUND_INTERVAL_S * np.arange(1, SAMPLES_OF_REBOUND)
    return np.concatenate([on_time_grid([begin]), _jittered(later, rng)])


def _sparse_times(
    case: Case, event: str, rng: np.random.Generator, duration_s: float | None = None
) -> np.ndarray:
    """Times (n) from an event on, as close as the published number after the collision; that number, or for a duration."""
    n = case.published["samples_after_collision"].value
    interval = case.require_timeline().seconds("collision", "second_touchdown") / n
    n = n if duration_s is None else int(duration_s / interval)
    begin = case.require_timeline().event(event).t_s
    return _jittered(begin + interval * (np.arange(n) + 0.5), rng)


def _descent(case: Case, rng: np.random.Generator) -> tuple[PhaseSamples, PhaseSamples]:
    """Samples 1 to 9 with folded legs, then 10 to the touchdown: rotation about z at the published cubic rate."""
    timeline, published = case.require_timeline(), case.published
    begin, end = (timeline.event(name).t_s for name in ("descent_fit_begins", "first_touchdown"))
    first, last = published["descent_samples"].value
    interval = published["descent_span"].value * 3600.0 / (last - first)
    count = int((end - begin - JITTER_S) / interval)
    folded = begin - DEPLOYMENT_INTERVAL_S * np.arange(SAMPLES_BEFORE_DESCENT, 0, -1)
    folded = _jittered(folded, rng)
    unfolded = np.append(begin, _jittered(begin + interval * np.arange(1, count + 1), rng))
    azimuth = rng.uniform(0, 2 * np.pi)
    rate, z = published["descent_rate_cubic"].value, published["nz_descent"].value

    def sun(t_s: np.ndarray) -> np.ndarray:
        """The Sun goes round backward; before sample 10 at the first rate."""
        before, after = np.minimum(t_s - begin, 0.0), np.maximum(t_s - begin, 0.0)
        angle = sum(c * after ** (k + 1) / (k + 1) for k, c in enumerate(rate)) + rate[0] * before
        flat = np.sqrt(1 - z**2)
        x, y = flat * np.cos(azimuth - angle), flat * np.sin(azimuth - angle)
        return np.stack([x, y, np.full(t_s.shape, z)], axis=-1)

    return (
        PhaseSamples("deployment", folded, sun(folded), FOLDED_LEG_TRANSMISSION),
        PhaseSamples("descent", unfolded, sun(unfolded)),
    )


def _on_the_ground(
    case: Case, sun_B: np.ndarray, seed: int, seen_first: bool
) -> tuple[PhaseSamples, PhaseSamples]:
    """Settling, from the direction at the second touchdown evenly to that at rest; rest: along the Sun's circle, past the rocks."""
    timeline = case.require_timeline()
    begin, end = (timeline.event(name).t_s for name in ("second_touchdown", "rest"))
    at_first, shadow, hides, shows = np.radians(REST_ANGLES_DEG)
    # a great circle, 80 degrees to xy, which it meets at azimuth 86
    azimuth, tilt = np.radians(86.0), np.radians(80.0)
    node = np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    flat = np.array([-np.sin(azimuth), np.cos(azimuth), 0.0])
    down = np.cos(tilt) * flat - np.sin(tilt) * np.array([0.0, 0.0, 1.0])

    def on_circle(angle: np.ndarray) -> np.ndarray:
        return np.cos(angle)[..., None] * node + np.sin(angle)[..., None] * down

    t = np.arange(begin + SETTLING_INTERVAL_S / 2, end - JITTER_S, SETTLING_INTERVAL_S)
    t = _jittered(t, generator(seed, 5))
    start, goal = sun_B / np.linalg.norm(sun_B), on_circle(at_first)
    turn = np.cross(start, goal)
    turn *= np.arctan2(np.linalg.norm(turn), start @ goal) / np.linalg.norm(turn)
    sun = Rotation.from_rotvec(((t - begin) / (end - begin))[:, None] * turn).apply(start)
    settling = PhaseSamples("settling", t, sun)

    t = _sparse_times(case, "rest", generator(seed, 6), REST_DURATION_S)
    angle = at_first + 2 * np.pi * (t - end) / COMET_TURN_S
    hidden = (angle > hides) & (angle < shows)
    early = seen_first & (angle < shadow)
    seen = np.where(early[:, None], BEFORE_THE_SHADOW, REST_TRANSMISSION) * ~hidden[:, None]
    return settling, PhaseSamples("rest", t, on_circle(angle), seen)


# ---- The command -------------------------------------------------------------------------------------------------------------


def main(arguments: list[str] | None = None) -> int:
    """Write the synthetic telemetry of Philae's landing and, beside it, its truth."""
    parser = argparse.ArgumentParser(
        prog="python -m sunspin.philae.telemetry", description=main.__doc__
    )
    add = parser.add_argument
    add("out", type=Path, help="CSV file to write; the truth goes to twin_truth.toml there")
    add("--seed", type=int, required=True, help="of all that is drawn")
    add("--force", action="store_true", help="replace existing files")
    given = parser.parse_args(arguments)
    name, truth = given.out.name, given.out.parent / "twin_truth.toml"
    comments = [
        f"synthetic: not measured; made by sunspin {version()} from published facts",
        f"synthetic: python -m sunspin.philae.telemetry --seed {given.seed} {name}",
    ]
    behind_them = "the truth behind them is in twin_truth.toml"
    scale = f"synthetic: powers in W on an arbitrary scale; {behind_them}"
    about = f"The truth behind {name}; see sunspin.philae.telemetry for how each part was chosen."
    try:
        telemetry, vehicle = philae_twin(given.seed), load_case("philae").vehicle
        write_new(given.out, csv_text(vehicle, telemetry, [*comments, scale]), given.force)
        write_new(truth, truth_text(telemetry, [*comments, about]), given.force)
    except SunspinError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
