"""Term of a single reading of a lander that the user states in addition to its panels, with a time and a Gaussian sigma.

It is simpler than a sensor of a telemetry file, as it has no axes, gains or common errors. Shapes: K motions, n samples. A turn is
a small rotation of the body, as a rotation vector in body axes B (rad).
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
"""Keys of a stated reading; a reading of the kind "field" also has `angle_rad`, the angle between the field and the Sun."""

COMPONENTS = {"rate": 1, "gyro": 3, "direction": 3, "field": 3}
"""Kind of a reading -> number of components of its value. "rate": angular speed about any axis (rad/s), as the period of a radio
signal or a light curve gives it. "gyro": body rate (rad/s, B). "direction": direction to the Sun (B). "field": a direction (B) at
a known angle from the Sun, such as that of the magnetic field."""

LEAST_SINE = 1e-3
"""Lower limit of the sine by which the derivative of the angle between Sun and field is divided."""


@dataclass(frozen=True)
class Given(Term):
    """A reading of one `kind` (a key of `COMPONENTS`) at one of n samples. Its `sigma` (n) is infinite at all other samples.

    `value` (n, r): the numbers read, zero at the other samples. For the kind "field" r is 1: the angle (rad) between the Sun and
    the unit vector `axis_B` (n, 3), the field in the body.
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
        """Return the term of one reading, at the sample with index `at` of `count` samples; raise `InputError` for invalid values.

        `observation`: the reading as the user states it. Its kind and keys are valid (:func:`require_usable`).
        """
        kind, sigma = str(observation["kind"]), float(observation["sigma"])
        numbers = COMPONENTS[kind]
        value = np.atleast_1d(np.asarray(observation["value"], dtype=np.float64))
        valid = value.shape == (numbers,) and np.all(np.isfinite(value))
        if not (valid and np.isfinite(sigma) and sigma > 0):
            size = "one finite number" if numbers == 1 else f"{numbers} finite numbers"
            what = f"a {kind} is {size} with a positive sigma"
            raise InputError(what, got=str(dict(observation)))
        length = np.linalg.norm(value)
        if kind == "direction":
            if not length > 0:
                raise InputError("a direction is not zero", got=str(dict(observation)))
            value = value / length
        if kind == "rate" and value[0] < 0:
            what = "a rate is an angular speed, zero or positive"
            raise InputError(what, got=str(dict(observation)))
        axis = np.array([0.0, 0.0, 1.0])  # without a meaning, unless the kind is "field"
        if kind == "field":
            angle = float(observation["angle_rad"])
            if not (0 <= angle <= np.pi and length > 0):
                what = "a field is a direction and an angle from 0 to pi (rad)"
                raise InputError(what, got=str(dict(observation)))
            # the user states the field's direction as the value; what the term compares is its angle to the Sun
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
        """Return how many numbers were read: those that a motion must explain."""
        return float(self.present().sum() * self.value.shape[1])

    def residuals(self, states: States, u: np.ndarray) -> Iterator[Residual]:
        """Yield the predicted less the read value (K, n, r) in sigmas, with its derivative by the rate or by a turn."""
        by_rate = by_turn = None
        # a turn t of the body moves the Sun in body axes by sun x t
        sun_by_turn = cross_matrix(states.sun_B)
        if self.kind == "rate":
            predicted = np.linalg.norm(states.omega, axis=-1, keepdims=True)
            by_rate = (states.omega / np.maximum(predicted, 1e-12))[..., None, :]
        elif self.kind == "gyro":
            predicted, by_rate = states.omega, np.broadcast_to(np.eye(3), (*states.omega.shape, 3))
        elif self.kind == "direction":
            predicted, by_turn = states.sun_B, sun_by_turn
        else:
            # the angle between Sun and field: a turn changes its cosine by axis . (sun x turn)
            cosine = np.clip(np.sum(states.sun_B * self.axis_B, axis=-1), -1.0, 1.0)
            sine = np.maximum(np.sqrt(1 - cosine**2), LEAST_SINE)
            predicted = np.arccos(cosine)[..., None]
            by_turn = -(self.axis_B[:, None, :] @ sun_by_turn) / sine[..., None, None]
        inverse = 1 / self.sigma[:, None]
        by_turn, by_rate = (
            None if slope is None else slope * inverse[..., None] for slope in (by_turn, by_rate)
        )
        yield Residual((predicted - self.value) * inverse, by_turn, by_rate, law=gaussian)


def require_usable(observations: Sequence[Mapping[str, Any]], start_s: float, end_s: float) -> None:
    """Raise `InputError` for stated readings of an unknown kind, with wrong keys, or outside the window from start to end (s)."""
    for observation in observations:
        kind = str(observation.get("kind"))
        keys = {*KEYS, "angle_rad"} if kind == "field" else set(KEYS)
        if kind not in COMPONENTS or keys != set(observation):
            raise InputError(
                f"an observation has kind ({', '.join(COMPONENTS)}), t_s, value and sigma; "
                "a field has angle_rad too, the angle between the field and the Sun",
                got=str(dict(observation)),
            )
        if not start_s <= float(observation["t_s"]) <= end_s:
            raise InputError(
                "an observation lies outside the window",
                got=f"t_s {float(observation['t_s']):g}",
                do=f"from {start_s:g} to {end_s:g}",
            )
