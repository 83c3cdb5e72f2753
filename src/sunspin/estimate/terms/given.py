"""Readings of a lander that a person states in addition to its panels: each with its own time and one Gaussian sigma.

They are simpler than sensors of a telemetry file, as they have no axes, gains or common errors.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from sunspin.base.errors import InputError
from sunspin.estimate.model import States
from sunspin.estimate.terms.term import Residual, Term, gaussian
from sunspin.solve.rotations import cross_matrix

KEYS = ("kind", "t_s", "value", "sigma")
"""What a person states of each reading; of a field also the angle between it and the Sun, `angle_rad`."""

LEAST_SINE = 1e-3
"""Least sine of the angle between Sun and field by which its derivative is divided."""


@dataclass(frozen=True)
class Given(Term):
    """Readings `value` (n, r) of one kind with one `sigma` (n) each, which is infinite at samples without a reading."""

    keys: ClassVar[tuple[str, ...]] = KEYS
    numbers: ClassVar[int] = 3
    per_sample: ClassVar[tuple[str, ...]] = ("value", "sigma")

    value: np.ndarray
    sigma: np.ndarray

    @classmethod
    def of(cls, observation: Mapping[str, Any], at: int, count: int) -> Self:
        """Return the term of one reading at sample `at` of `count` samples."""
        value = np.zeros((count, cls.numbers))
        value[at] = checked(observation, cls.numbers)
        return cls(value, _only(at, count, float(observation["sigma"])))

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading."""
        return np.isfinite(self.sigma)

    @property
    def explained(self) -> float:
        """Return how many numbers a motion must explain."""
        return float(self.present().sum() * self.value.shape[1])

    def _differences(self, off: np.ndarray, **slopes: np.ndarray) -> Residual:
        """Return differences (K, n, r) and their derivatives (K, n, r, 3) in sigmas, zero without a reading."""
        inverse = 1 / self.sigma[:, None]
        scaled = {name: slope * inverse[..., None] for name, slope in slopes.items()}
        return Residual(off * inverse, law=gaussian, **scaled)


@dataclass(frozen=True)
class GivenSpeed(Given):
    """Angular speed in rad/s about any axis: a period seen in a radio signal or a light curve."""

    name: ClassVar[str] = "rate"
    label: ClassVar[str] = "angular speed"
    numbers: ClassVar[int] = 1

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the difference (K, n, 1), with its derivative by the rate."""
        speed = np.linalg.norm(states.omega, axis=-1, keepdims=True)
        axis = states.omega / np.maximum(speed, 1e-12)
        yield self._differences(speed - self.value, by_rate=axis[..., None, :])


@dataclass(frozen=True)
class GivenRate(Given):
    """Body rate in rad/s."""

    name: ClassVar[str] = "gyro"
    label: ClassVar[str] = "body rate"

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the difference (K, n, 3), with its derivative by the rate."""
        same = np.broadcast_to(np.eye(3), (*states.omega.shape, 3))
        yield self._differences(states.omega - self.value, by_rate=same)


@dataclass(frozen=True)
class GivenDirection(Given):
    """Direction to the Sun, seen otherwise than by panels."""

    name: ClassVar[str] = "direction"
    label: ClassVar[str] = "Sun direction"

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the difference (K, n, 3), with its derivative by a turn: the Sun moves by sun x turn."""
        yield self._differences(states.sun_B - self.value, by_turn=cross_matrix(states.sun_B))


@dataclass(frozen=True)
class GivenAngle(Given):
    """Angle (rad) of the Sun from a direction `axis_B` (n, 3) seen in the body, such as the magnetic field's."""

    name: ClassVar[str] = "field"
    label: ClassVar[str] = "field direction"
    keys: ClassVar[tuple[str, ...]] = (*KEYS, "angle_rad")
    per_sample: ClassVar[tuple[str, ...]] = ("value", "sigma", "axis_B")

    axis_B: np.ndarray

    @classmethod
    def of(cls, observation: Mapping[str, Any], at: int, count: int) -> Self:
        """Return one reading at sample `at` of `count`."""
        direction, angle = checked(observation, 3), float(observation["angle_rad"])
        length = np.linalg.norm(direction)
        if not (0 <= angle <= np.pi and length > 0):
            raise InputError(
                "a field is a direction and an angle from 0 to pi (rad)", got=str(dict(observation))
            )
        axis = np.tile([0.0, 0.0, 1.0], (count, 1))
        axis[at] = direction / length
        return cls(np.full((count, 1), angle), _only(at, count, float(observation["sigma"])), axis)

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the difference (K, n, 1), with its derivative by a turn."""
        cosine = np.clip(np.sum(states.sun_B * self.axis_B, axis=-1), -1.0, 1.0)
        sine = np.maximum(np.sqrt(1 - cosine**2), LEAST_SINE)
        # the cosine changes by axis . (sun x turn)
        moves = self.axis_B[:, None, :] @ cross_matrix(states.sun_B)
        off = np.arccos(cosine)[..., None] - self.value
        yield self._differences(off, by_turn=-moves / sine[..., None, None])


KINDS: dict[str, type[Given]] = {
    kind.name: kind for kind in (GivenSpeed, GivenRate, GivenDirection, GivenAngle)
}


def require_known(given: Sequence[Mapping[str, Any]], start_s: float, end_s: float) -> None:
    """Refuse observations of no known kind, with other keys than theirs, or outside the window."""
    for observation in given:
        kind = KINDS.get(str(observation.get("kind")))
        if kind is None or set(kind.keys) != set(observation):
            more = "a field also angle_rad, the Sun's from it"
            raise InputError(
                f"an observation has kind ({', '.join(KINDS)}), t_s, value and sigma, {more}",
                got=str(dict(observation)),
            )
        if not start_s <= float(observation["t_s"]) <= end_s:
            raise InputError(
                "an observation lies outside the window",
                got=f"t_s {float(observation['t_s']):g}",
                do=f"from {start_s:g} to {end_s:g}",
            )


def checked(observation: Mapping[str, Any], numbers: int) -> np.ndarray:
    """Return the numbers of an observation, which are finite and as many as they must be, with a positive sigma."""
    value = np.atleast_1d(np.asarray(observation["value"], dtype=np.float64))
    sigma = float(observation["sigma"])
    right = value.shape == (numbers,) and np.all(np.isfinite(value))
    if not (right and np.isfinite(sigma) and sigma > 0):
        what = f"a {observation['kind']} is {numbers} finite numbers with a positive sigma"
        raise InputError(what, got=str(dict(observation)))
    return value


def _only(at: int, count: int, sigma: float) -> np.ndarray:
    """Return sigmas (count) that are infinite but at one sample."""
    sigmas = np.full(count, np.inf)
    sigmas[at] = sigma
    return sigmas
