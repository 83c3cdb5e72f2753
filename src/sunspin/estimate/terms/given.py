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

NUMBERS = {"rate": 1, "gyro": 3, "direction": 3, "field": 3}
"""How many numbers the value of each kind has. They are the angular speed about any axis in rad/s, as a period in a radio signal or
a light curve shows it; the rate of the body in rad/s; the direction to the Sun, seen otherwise than by panels; and a direction seen
in the body at a known angle from the Sun, such as the magnetic field's."""

LEAST_SINE = 1e-3
"""Least sine of the angle between Sun and field by which its derivative is divided."""


@dataclass(frozen=True)
class Given(Term):
    """A reading of a kind at one of n samples, with one `sigma` (n), which is infinite at all others.

    `value` (n, r): for each sample its numbers, of a field the angle (rad) of the Sun from the direction `axis_B` (n, 3).
    """

    name: ClassVar[str] = "given"
    label: ClassVar[str] = "stated reading"
    per_sample: ClassVar[tuple[str, ...]] = ("value", "sigma", "axis_B")

    kind: str
    value: np.ndarray
    sigma: np.ndarray
    axis_B: np.ndarray

    @classmethod
    def of(cls, observation: Mapping[str, Any], at: int, count: int) -> Self:
        """Return the term of one reading at sample `at` of `count` samples; refuse values that are none."""
        kind, sigma = str(observation["kind"]), float(observation["sigma"])
        numbers = NUMBERS[kind]
        value = np.atleast_1d(np.asarray(observation["value"], dtype=np.float64))
        right = value.shape == (numbers,) and np.all(np.isfinite(value))
        if not (right and np.isfinite(sigma) and sigma > 0):
            what = f"a {kind} is {numbers} finite numbers with a positive sigma"
            raise InputError(what, got=str(dict(observation)))
        axis = np.array([0.0, 0.0, 1.0])
        if kind == "field":
            length, angle = np.linalg.norm(value), float(observation["angle_rad"])
            if not (0 <= angle <= np.pi and length > 0):
                what = "a field is a direction and an angle from 0 to pi (rad)"
                raise InputError(what, got=str(dict(observation)))
            axis, value = value / length, np.array([angle])
        is_read = np.arange(count) == at
        return cls(
            kind,
            np.where(is_read[:, None], value, 0.0),
            np.where(is_read, sigma, np.inf),
            np.tile(axis, (count, 1)),
        )

    def present(self) -> np.ndarray:
        """Return which samples (n) have a reading."""
        return np.isfinite(self.sigma)

    @property
    def explained(self) -> float:
        """Return how many numbers a motion must explain."""
        return float(self.present().sum() * self.value.shape[1])

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the difference (K, n, r) in sigmas, with its derivative by the rate, or by a turn of the body."""
        by_rate = by_turn = None
        moves = cross_matrix(states.sun_B)  # a turn t of the body moves the Sun by sun x t
        if self.kind == "rate":
            predicted = np.linalg.norm(states.omega, axis=-1, keepdims=True)
            by_rate = (states.omega / np.maximum(predicted, 1e-12))[..., None, :]
        elif self.kind == "gyro":
            predicted, by_rate = states.omega, np.broadcast_to(np.eye(3), (*states.omega.shape, 3))
        elif self.kind == "direction":
            predicted, by_turn = states.sun_B, moves
        else:
            # the angle between Sun and field; its cosine changes by axis . (sun x turn)
            cosine = np.clip(np.sum(states.sun_B * self.axis_B, axis=-1), -1.0, 1.0)
            sine = np.maximum(np.sqrt(1 - cosine**2), LEAST_SINE)
            predicted = np.arccos(cosine)[..., None]
            by_turn = -(self.axis_B[:, None, :] @ moves) / sine[..., None, None]
        inverse = 1 / self.sigma[:, None]
        by_turn, by_rate = (
            None if slope is None else slope * inverse[..., None] for slope in (by_turn, by_rate)
        )
        yield Residual((predicted - self.value) * inverse, by_turn, by_rate, law=gaussian)


def require_known(given: Sequence[Mapping[str, Any]], start_s: float, end_s: float) -> None:
    """Refuse observations of no known kind, with other keys than theirs, or outside the window."""
    for observation in given:
        kind = str(observation.get("kind"))
        keys = {*KEYS, "angle_rad"} if kind == "field" else set(KEYS)
        if kind not in NUMBERS or keys != set(observation):
            more = "a field also angle_rad, the Sun's from it"
            raise InputError(
                f"an observation has kind ({', '.join(NUMBERS)}), t_s, value and sigma, {more}",
                got=str(dict(observation)),
            )
        if not start_s <= float(observation["t_s"]) <= end_s:
            raise InputError(
                "an observation lies outside the window",
                got=f"t_s {float(observation['t_s']):g}",
                do=f"from {start_s:g} to {end_s:g}",
            )
