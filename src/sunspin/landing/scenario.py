"""What may happen after a touchdown, as data: times, speeds, what is not known and how it is drawn, what the wheels are told."""

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
from sunspin.landing.contact import legs_down, shape_of
from sunspin.vehicle import Vehicle

SPIRAL = 20_000
"""Directions, evenly over the sphere, among which the local vertical is drawn: 1.5 degrees apart."""

STEEPEST_SINE = 0.2
"""Landings flatter than this (normal speed over speed; 12 degrees) are left out: they would last too long to sample."""

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
"""What is drawn for each run, in this order: uniform numbers of its own generator. New ones are added at the end."""


@dataclass(frozen=True)
class Scenario:
    """From a touchdown over a collision to the next contact with the ground. Time 0 is the touchdown.

    Attributes
    ----------
    sun_B, wheel_speed_rad_s
        Direction to the Sun and wheel speeds that go with the candidate rates.
    lead_s : s from the touchdown to the instant of the candidates; the motion in between is run back, wheels coasting
        or, at rest, standing still.
    before_s, after_s : s from the candidates' instant to the collision, and from there to the landing.
    collision_speed_m_s : speed of the centre of mass at the collision, its direction any with a component along
        `collision_axis_B`; None: no collision.
    landing_speed_m_s : speed at the landing; its angle to the ground's normal follows from a plane of any direction being
        hit in proportion to the area it shows (cosine law), see `STEEPEST_SINE`.
    restitution, damper : of the collision, see :func:`sunspin.impact`.
    vertical : how the ground's normal at the landing is drawn, as a direction fixed in space, body axes at the touchdown.
        "legs_down": any for which the ends of legs were the lowest points at the touchdown; "any"; a number: within this
        angle (rad) of the opposite of the legs' mean direction (of z without legs); three numbers: this one. The turning of
        a celestial body under the flight (67P: 54 degrees in 111 min) is not followed: no frame kernel says about which axis
        of the body frame, and the default is far wider.
    orbiter : "above_horizon" of the touchdown, "any", or three numbers: direction to the orbiter, likewise.
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
            object.__setattr__(self, name, tuple(float(x) for x in np.ravel(getattr(self, name))))
        axis = np.array(self.collision_axis_B)
        if len(self.sun_B) != 3 or not abs(np.linalg.norm(self.sun_B) - 1) < 1e-2:
            raise InputError("sun_B must be a unit vector of three components", got=self.sun_B)
        if axis.shape != (3,) or not (np.all(np.isfinite(axis)) and np.linalg.norm(axis) > 0):
            what = "collision_axis_B must be three numbers, not all zero"
            raise InputError(what, got=self.collision_axis_B)
        object.__setattr__(self, "collision_axis_B", tuple(axis / np.linalg.norm(axis)))
        if isinstance(self.orbiter, str):
            known = self.orbiter in ("above_horizon", "any")
        else:
            known = np.shape(self.orbiter) == (3,) and np.linalg.norm(self.orbiter) > 0
        if not known:
            what = 'orbiter must be "above_horizon", "any" or three numbers'
            raise InputError(what, got=self.orbiter)
        for name in ("restitution", "damper"):
            if not 0 <= getattr(self, name) <= 1:
                raise InputError(f"{name} must be a share between 0 and 1", got=getattr(self, name))
        for name in ("before_s", "lead_s"):
            if not 0 <= getattr(self, name) < np.inf:
                what = f"{name} must be zero or a positive time in s"
                raise InputError(what, got=getattr(self, name))
        blow = () if self.collision_speed_m_s is None else ("collision_speed_m_s",)
        for name in ("after_s", "landing_speed_m_s", *blow):
            if getattr(self, name) is None or not 0 < getattr(self, name) < np.inf:
                raise InputError(f"{name} must be positive", got=getattr(self, name))

    @property
    def collision_s(self) -> float:
        return self.lead_s + self.before_s

    @property
    def landing_s(self) -> float:
        return self.collision_s + self.after_s


def paper_scenario(case: Case) -> Scenario:
    """Section 3.3 of the paper: from the first sample at nominal wheel speed, 45 min, speed 0.2355 m/s, 65 min on."""
    published = case.published
    return _of_case(
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
"""Time of a scenario -> the events between which it is."""


def case_scenario(case: Case) -> Scenario:
    """The case with the times of its timeline and the speeds of its trajectory kernel; candidates as in the paper."""
    if case.timeline is None or "kernel_speed_before" not in case.published:
        what = f"case {case.name!r} knows of no landing"
        raise InputError(what, do="give a Scenario of your own")
    times = {key: case.timeline.seconds(*ends) for key, ends in TIMES.items()}
    if case.assumptions.study.lead_s is not None:
        times["lead_s"] = case.assumptions.study.lead_s
    speed = case.published["kernel_speed_before"].value
    return _of_case(case, collision_speed_m_s=speed, **times)


def _of_case(case: Case, **fields: Any) -> Scenario:
    """A scenario with the case's first direction, wheels, landing speed and law of the collision."""
    sun = np.array(case.published["first_sun"].value)
    return Scenario(
        sun_B=tuple(sun / np.linalg.norm(sun)),
        wheel_speed_rad_s=tuple(wheel.speed_rad_s for wheel in case.vehicle.wheels),
        landing_speed_m_s=case.published["kernel_speed_before_landing"].value,
        restitution=case.assumptions.collision.restitution,
        damper=case.assumptions.collision.damper,
        **fields,
    )


def scenario_of(vehicle: str, craft: Vehicle, given: Mapping[str, Any]) -> Scenario:
    """The case's own scenario with what is given instead, or one made of what is given and the timeline beside the vehicle file.

    Parameters
    ----------
    vehicle : name or path from which `craft` was read
    given : fields of `Scenario`
    """
    timeline = read_timeline(vehicle)
    case = load_case(craft.name) if craft.name in case_names() else None
    if case is not None and case.timeline is not None:
        case = replace(case, vehicle=craft, timeline=timeline or case.timeline)
        return replace(case_scenario(case), **given)
    known: dict[str, Any] = {"wheel_speed_rad_s": [wheel.speed_rad_s for wheel in craft.wheels]}
    if timeline is not None:
        named = {event.name for event in timeline.events}
        known |= {k: timeline.seconds(*ends) for k, ends in TIMES.items() if named.issuperset(ends)}
    known |= given
    for key, option in (("sun_B", "--sun"), ("after_s", "--after")):
        if key not in known:
            do = f"no times and directions are known of {craft.name!r}"
            raise InputError(f"{option} is missing", do=do)
    return Scenario(**known)


@dataclass(frozen=True)
class Strategy:
    """What all wheels are told from the touchdown on: (s after it, command) pairs."""

    name: str
    schedule: Schedule


NAMED = {
    "off": ((0.0, "coast"),),
    "held": ((0.0, "hold"),),
    "brake": ((0.0, "brake"),),
    "after_rest": ((0.0, "hold"),),
}
"""Strategies by name. "after_rest" flies as "held" does: what differs happens on the ground (`strategies.settling`)."""


def strategy_of(vehicle: Vehicle, given: Any) -> Strategy:
    """A strategy from its name ("off", "held", "brake", "after_rest", "delay:SECONDS"), a schedule or a Strategy.

    Raises
    ------
    InputError, MotionError
        Unknown names, delays that are no positive number, a brake that the vehicle does not have.
    """
    if isinstance(given, Strategy):
        strategy = given
    elif isinstance(given, str) and given in NAMED:
        strategy = Strategy(given, NAMED[given])
    elif isinstance(given, str) and given.startswith("delay:"):
        delay = plain_number(given.removeprefix("delay:"))
        if not (is_sensible(delay) and delay >= 0):
            what = "a delay must be zero or a positive number of seconds below 1e30"
            raise InputError(what, got=given.removeprefix("delay:"), do="for example delay:600")
        strategy = delayed(delay)
    elif isinstance(given, Sequence) and not isinstance(given, str):
        strategy = Strategy("schedule", tuple((float(t), str(command)) for t, command in given))
    else:
        known = f"{', '.join(NAMED)}, delay:SECONDS"
        raise InputError("there is no wheel strategy of this name", got=given, do=f"known: {known}")
    schedules(vehicle, strategy.schedule)
    return strategy


def delayed(delay_s: float) -> Strategy:
    """Held from the touchdown on, switched off `delay_s` later."""
    if delay_s == 0:
        return Strategy("delay:0", NAMED["off"])
    return Strategy(f"delay:{delay_s:g}", ((0.0, "hold"), (float(delay_s), "coast")))


def spiral(count: int = SPIRAL) -> np.ndarray:
    """Directions (count, 3) evenly spread over the sphere (Fibonacci spiral)."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle = np.arange(count) * np.pi * (3 - np.sqrt(5))
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=-1
    )


def verticals(vehicle: Vehicle, wanted: Any) -> tuple[np.ndarray, str]:
    """Equally likely directions up from the ground (m, 3), body axes at the touchdown, and in words what they are."""
    shape, everywhere = shape_of(vehicle), spiral()
    standing = (
        -np.sum([leg.tip_B_m for leg in vehicle.legs], axis=0) if vehicle.legs else np.zeros(3)
    )
    up = standing / np.linalg.norm(standing) if standing.any() else np.array([0.0, 0.0, 1.0])
    if isinstance(wanted, str) and wanted == "any":
        return everywhere, "every direction"
    if isinstance(wanted, str) and wanted == "legs_down":
        if not vehicle.legs or shape is None:
            return everywhere, "every direction (the vehicle has no legs)"
        if not shape.complete:
            words = "every direction on the legs' side (no hull is given)"
            return everywhere[everywhere @ up > 0], words
        low = everywhere[legs_down(shape, everywhere)]
        if not len(low):
            what = "no leg of this vehicle can be its lowest point"
            raise InputError(what, do="check the hull, or give a vertical")
        words = "every direction for which an end of a leg was the lowest point at the touchdown"
        return low, words
    if not isinstance(wanted, str) and np.ndim(wanted) == 0 and 0 < float(wanted) <= np.pi:
        near = everywhere[everywhere @ up >= np.cos(float(wanted))]
        return near, f"within {np.degrees(float(wanted)):g} degrees of {up}"
    if np.shape(wanted) == (3,) and np.linalg.norm(wanted) > 0:
        return np.atleast_2d(np.array(wanted, float) / np.linalg.norm(wanted)), "one direction"
    what = 'vertical must be "legs_down", "any", an angle up to pi (rad) or three numbers'
    raise InputError(what, got=wanted)


def draws(seed: int, index: np.ndarray) -> dict[str, np.ndarray]:
    """Uniform numbers in [0, 1) for the runs `index` (n): each of `DRAWS` -> (n). A run's numbers are its own."""
    table = [_drawn(seed, i) for i in index.tolist()]
    return dict(zip(DRAWS, np.array(table).reshape(-1, len(DRAWS)).T, strict=True))


@lru_cache(maxsize=1 << 15)
def _drawn(seed: int, i: int) -> np.ndarray:
    """Kept, because strategies and scenarios are compared on the same draws."""
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(i,))).random(len(DRAWS))


def about(axis_B: np.ndarray, cosine: np.ndarray, turn: np.ndarray) -> np.ndarray:
    """Unit vectors (n, 3) at the given cosine from axis_B (n, 3), turned about it by 2 pi `turn`."""
    helper = np.where(np.abs(axis_B[:, 2:]) < 0.9, [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]])
    first = np.cross(axis_B, helper)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    second = np.cross(axis_B, first)
    sine, angle = np.sqrt(np.maximum(1 - cosine**2, 0.0)), 2 * np.pi * turn
    side = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return cosine[:, None] * axis_B + sine[:, None] * side
