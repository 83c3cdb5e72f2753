"""Scenario after a touchdown, as data: times, speeds, distributions of unknown quantities, and commands of the wheels."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np

from sunspin.base.errors import InputError
from sunspin.base.untrusted import is_sensible, plain_number
from sunspin.cases import Case, case_names, load_case, read_timeline
from sunspin.dynamics.wheel_modes import Schedule, schedules
from sunspin.landing.contact import build_shape, is_leg_lowest
from sunspin.vehicle import Vehicle

SPIRAL = 20_000
"""Number of directions, evenly spread over the sphere and 1.5 degrees apart, from which the local vertical is drawn."""

FLATTEST_SINE = 0.2
"""Smallest ratio of normal speed to speed at the landing (12 degrees): flatter landings would last too long to sample."""

DRAWS = (
    "candidate",
    "leg",
    "polar",
    "azimuth",
    "vertical",
    "orbiter_polar",
    "orbiter_azimuth",
    "incidence",
    "heading",
)
"""Names of the uniform random numbers of a run, in the order in which its own generator draws them. Add new ones at the end."""


@dataclass(frozen=True)
class Scenario:
    """Events from a touchdown, through an optional collision, to the next contact with the ground. Time 0 is the touchdown.

    Attributes
    ----------
    sun_B, wheel_speed_rad_s
        Direction to the Sun (unit vector) and wheel speeds (rad/s) at the instant of the candidate rates.
    lead_s : s from the touchdown to the instant of the candidates. The motion in between is propagated backward, with wheels that
        coast, or stand still if they are at rest.
    before_s, after_s : s from the candidates' instant to the collision, and from there to the landing.
    collision_speed_m_s : speed of the centre of mass at the collision; None: no collision. Its direction is any with a component
        along `collision_axis_B`.
    landing_speed_m_s : speed at the landing. Its angle to the ground's normal is drawn by the cosine law: a plane is hit in
        proportion to the area that it shows to the velocity (see `FLATTEST_SINE`).
    restitution, damper : of the collision, see :func:`sunspin.impact`.
    vertical : distribution of the ground's normal at the landing, a direction fixed in space, body axes at the touchdown.
        "legs_down": all directions for which the end of a leg was the lowest point at the touchdown. "any": all directions. A
        number: within this angle (rad) of the opposite of the legs' mean direction (of z without legs). Three numbers: one
        direction. The rotation of a celestial body during the flight (67P: 54 degrees in 111 min) is neglected: no frame kernel
        gives its axis in the body frame, and the default distribution is far wider.
    orbiter : direction to the orbiter, fixed in space, body axes at the touchdown: "above_horizon" of the touchdown, "any", or
        three numbers.
    """

    sun_B: tuple[float, ...]
    wheel_speed_rad_s: tuple[float, ...]
    after_s: float
    before_s: float = 0.0
    lead_s: float = 0.0
    collision_speed_m_s: float | None = None
    collision_axis_B: tuple[float, ...] = (0.0, 0.0, -1.0)
    landing_speed_m_s: float = 0.2
    restitution: float = 0.0
    damper: float = 0.0
    vertical: Any = "legs_down"
    orbiter: Any = "above_horizon"

    def __post_init__(self) -> None:
        for name in ("sun_B", "wheel_speed_rad_s", "collision_axis_B"):
            # the class is frozen
            object.__setattr__(self, name, tuple(float(x) for x in np.ravel(getattr(self, name))))
        axis = np.array(self.collision_axis_B)
        if len(self.sun_B) != 3 or not abs(np.linalg.norm(self.sun_B) - 1) < 1e-2:
            raise InputError("sun_B must be a unit vector of three components", got=self.sun_B)
        if axis.shape != (3,) or not (np.all(np.isfinite(axis)) and np.linalg.norm(axis) > 0):
            what = "collision_axis_B must be three numbers, not all zero"
            raise InputError(what, got=self.collision_axis_B)
        object.__setattr__(self, "collision_axis_B", tuple(axis / np.linalg.norm(axis)))
        if isinstance(self.orbiter, str):
            is_valid = self.orbiter in ("above_horizon", "any")
        else:
            is_valid = np.shape(self.orbiter) == (3,) and np.linalg.norm(self.orbiter) > 0
        if not is_valid:
            what = 'orbiter must be "above_horizon", "any" or three numbers'
            raise InputError(what, got=self.orbiter)
        for name in ("restitution", "damper"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must be a share between 0 and 1", got=getattr(self, name))
        for name in ("before_s", "lead_s"):
            if not 0 <= getattr(self, name) < np.inf:
                what = f"{name} must be zero or a positive time in s"
                raise InputError(what, got=getattr(self, name))
        optional = () if self.collision_speed_m_s is None else ("collision_speed_m_s",)
        for name in ("after_s", "landing_speed_m_s", *optional):
            if getattr(self, name) is None or not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} must be positive", got=getattr(self, name))

    @property
    def collision_s(self) -> float:
        """Time of the collision, s from the touchdown."""
        return self.lead_s + self.before_s

    @property
    def landing_s(self) -> float:
        """Time of the landing, s from the touchdown."""
        return self.collision_s + self.after_s


def paper_scenario(case: Case) -> Scenario:
    """Return the scenario of section 3.3 of the paper.

    It begins at the first sample, with nominal wheel speed. The collision at 0.2355 m/s is 45 min later, the landing 65 min after
    it.
    """
    published = case.published
    return _build_case_scenario(
        case,
        before_s=60.0 * published["scan_duration"].value,
        after_s=60.0 * published["duration_after_collision"].value,
        collision_speed_m_s=published["collision_speed"].value,
    )


TIMES = {
    "lead_s": ("first_touchdown", "first_sample_after_touchdown"),
    "before_s": ("first_sample_after_touchdown", "collision"),
    "after_s": ("collision", "second_touchdown"),
}
"""Duration of a scenario -> the two events of a timeline that it lies between."""


def case_scenario(case: Case) -> Scenario:
    """Return the scenario of a case, with the times of its timeline and the speeds of its trajectory kernel.

    Candidate motions are at the first sample after the touchdown, as in the paper.

    Raises
    ------
    InputError
        The case has no timeline or no speeds.
    """
    if case.timeline is None or "kernel_speed_before" not in case.published:
        what = f"case {case.name!r} knows of no landing"
        raise InputError(what, do="give a Scenario of your own")
    times = {key: case.timeline.seconds(*ends) for key, ends in TIMES.items()}
    if case.assumptions.study.lead_s is not None:
        times["lead_s"] = case.assumptions.study.lead_s
    speed = case.published["kernel_speed_before"].value
    return _build_case_scenario(case, collision_speed_m_s=speed, **times)


def _build_case_scenario(case: Case, **fields: Any) -> Scenario:
    """Return a scenario with the given fields, and with the case's first Sun direction, wheels, landing speed and collision law."""
    sun = np.array(case.published["first_sun"].value)
    return Scenario(
        sun_B=tuple(sun / np.linalg.norm(sun)),
        wheel_speed_rad_s=tuple(wheel.speed_rad_s for wheel in case.vehicle.wheels),
        landing_speed_m_s=case.published["kernel_speed_before_landing"].value,
        restitution=case.assumptions.collision.restitution,
        damper=case.assumptions.collision.damper,
        **fields,
    )


def build_scenario(vehicle: str, craft: Vehicle, given: Mapping[str, Any]) -> Scenario:
    """Return the scenario of a vehicle from the fields that are given, and otherwise from its case or timeline.

    A vehicle with the name of a built-in case has that case's scenario, with the times of its own timeline if it has one. Any
    other vehicle has the times between those events of `TIMES` that its timeline has, and the defaults of `Scenario`.

    Parameters
    ----------
    vehicle : str
        Name or path from which `craft` was read. A `timeline.toml` in the same folder gives the times.
    given : mapping
        Fields of `Scenario`.

    Raises
    ------
    InputError
        The direction to the Sun or the time after the collision is not known.
    """
    timeline = read_timeline(vehicle)
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is not None and case.timeline is not None:
        case = replace(case, vehicle=craft, timeline=timeline or case.timeline)
        return replace(case_scenario(case), **given)
    fields: dict[str, Any] = {"wheel_speed_rad_s": [wheel.speed_rad_s for wheel in craft.wheels]}
    if timeline is not None:
        events = {event.name for event in timeline.events}
        fields |= {
            key: timeline.seconds(*ends) for key, ends in TIMES.items() if events.issuperset(ends)
        }
    fields |= given
    options = {"sun_B": "--sun X,Y,Z", "after_s": "--after SECONDS"}
    if missing := [option for key, option in options.items() if key not in fields]:
        what = f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} missing"
        do = (
            f"no Sun direction and times are built in for {craft.name!r}: give the Sun in body axes at the candidate rate, and "
            "the time from there (or from the collision) to the landing"
        )
        raise InputError(what, do=do)
    return Scenario(**fields)


@dataclass(frozen=True)
class Strategy:
    """Commands of all wheels from the touchdown on: `schedule` has pairs of (s after the touchdown, command)."""

    name: str
    schedule: Schedule


NAMED_STRATEGIES = {
    "off": ((0.0, "coast"),),
    "held": ((0.0, "hold"),),
    "brake": ((0.0, "brake"),),
    "after_rest": ((0.0, "hold"),),
}
"""Name of a strategy -> its schedule. In flight "after_rest" is equal to "held"; it differs on the ground
(`strategies.wheel_stop_at_rest`)."""


def parse_strategy(vehicle: Vehicle, given: Any) -> Strategy:
    """Return a strategy from its name ("off", "held", "brake", "after_rest", "delay:SECONDS"), a schedule or a `Strategy`.

    Raises
    ------
    InputError, MotionError
        The name is unknown, the delay is negative or not a number, or the vehicle does not have the brake.
    """
    if isinstance(given, Strategy):
        strategy = given
    elif isinstance(given, str) and given in NAMED_STRATEGIES:
        strategy = Strategy(given, NAMED_STRATEGIES[given])
    elif isinstance(given, str) and given.startswith("delay:"):
        delay = plain_number(given.removeprefix("delay:"))
        if not (is_sensible(delay) and delay >= 0):
            what = "a delay must be zero or a positive number of seconds below 1e30"
            raise InputError(what, got=given.removeprefix("delay:"), do="for example delay:600")
        strategy = delayed_switch_off(delay)
    elif isinstance(given, Sequence) and not isinstance(given, str):
        strategy = Strategy("schedule", tuple((float(t), str(command)) for t, command in given))
    else:
        known = f"{', '.join(NAMED_STRATEGIES)}, delay:SECONDS"
        raise InputError("there is no wheel strategy of this name", got=given, do=f"known: {known}")
    schedules(vehicle, strategy.schedule)  # raises an error if the commands do not fit the wheels
    return strategy


def delayed_switch_off(delay_s: float) -> Strategy:
    """Return the strategy that holds the wheels' speed from the touchdown on and switches them off `delay_s` later."""
    if delay_s == 0:  # a schedule has one command at a time
        return Strategy("delay:0", NAMED_STRATEGIES["off"])
    return Strategy(f"delay:{delay_s:g}", ((0.0, "hold"), (float(delay_s), "coast")))


def spiral(count: int = SPIRAL) -> np.ndarray:
    """Return directions (count, 3) evenly spread over the sphere (Fibonacci spiral)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1
    )


def possible_verticals(vehicle: Vehicle, wanted: Any) -> tuple[np.ndarray, str]:
    """Return equally probable directions up from the ground (m, 3), body axes at the touchdown, and their description.

    `wanted` is the field `vertical` of a `Scenario`.

    Raises
    ------
    InputError
        `wanted` is not valid, or no leg of the vehicle can be its lowest point.
    """
    shape, everywhere = build_shape(vehicle), spiral()
    # up if the vehicle stands on its legs: opposite to their mean direction
    away_from_legs = (
        -np.sum([leg.tip_B_m for leg in vehicle.legs], axis=0) if vehicle.legs else np.zeros(3)
    )
    up = np.array([0.0, 0.0, 1.0])  # without legs
    if away_from_legs.any():
        up = away_from_legs / np.linalg.norm(away_from_legs)
    if isinstance(wanted, str) and wanted == "any":
        return everywhere, "every direction"
    if isinstance(wanted, str) and wanted == "legs_down":
        if not vehicle.legs or shape is None:
            return everywhere, "every direction (the vehicle has no legs)"
        if not shape.complete:
            # which part is lowest is not known; a lander stands on its legs
            words = "every direction on the legs' side (no hull is given)"
            return everywhere[everywhere @ up > 0], words
        allowed = everywhere[is_leg_lowest(shape, everywhere)]
        if not len(allowed):
            what = "no leg of this vehicle can be its lowest point"
            raise InputError(what, do="check the hull, or give a vertical")
        words = "every direction for which an end of a leg was the lowest point at the touchdown"
        return allowed, words
    if not isinstance(wanted, str) and np.ndim(wanted) == 0 and 0 < float(wanted) <= np.pi:
        near = everywhere[everywhere @ up >= np.cos(float(wanted))]
        return near, f"within {np.degrees(float(wanted)):g} degrees of {up}"
    if np.shape(wanted) == (3,) and np.linalg.norm(wanted) > 0:
        return np.atleast_2d(np.array(wanted, float) / np.linalg.norm(wanted)), "one direction"
    what = 'vertical must be "legs_down", "any", an angle up to 180 degrees or three numbers'
    is_angle = isinstance(wanted, int | float)
    raise InputError(what, got=f"{np.degrees(wanted):g} degrees" if is_angle else wanted)


def draw_uniform(seed: int, index: np.ndarray) -> dict[str, np.ndarray]:
    """Draw uniform numbers in [0, 1) for the runs with the numbers `index` (n): name of `DRAWS` -> (n).

    The numbers of a run depend only on the seed and the number of the run.
    """
    table = [_draw_run(seed, i) for i in index.tolist()]
    return dict(zip(DRAWS, np.array(table).reshape(-1, len(DRAWS)).T, strict=True))


@lru_cache(maxsize=1 << 15)
def _draw_run(seed: int, i: int) -> np.ndarray:
    """Draw the numbers of one run; cached, because strategies and scenarios are compared on the same draws."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,))).random(len(DRAWS))


def directions_at_angle(
    axis_B: np.ndarray, cosine: np.ndarray, revolutions: np.ndarray
) -> np.ndarray:
    """Return unit vectors (n, 3) at the angle with this `cosine` (n) from an axis (unit vectors, n, 3).

    `revolutions` (n) is the angle about the axis, from 0 to 1; its zero is arbitrary.
    """
    # a direction that is not along the axis gives two vectors at right angles to it
    helper = np.where(np.abs(axis_B[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(axis_B, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis_B, first)
    sine, angle = np.sqrt(np.maximum(1 - cosine**2, 0.0)), 2 * np.pi * revolutions
    side = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return cosine[:, None] * axis_B + sine[:, None] * side
