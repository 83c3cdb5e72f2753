"""A magnetometer in an orbit that is known: the field's direction and strength in space are no unknowns.

What stays unknown of a pass is what the calibration with the whole file has left open, of the sensor's zero and matrix (scale, soft
iron, axes) and, with them, of the place along the track, which moves the field of all samples together.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from sunspin.estimate.terms.sun_direction import SunDirection
from sunspin.estimate.terms.term import Residual, Seen, StateTerm, Unknown, facing
from sunspin.solve.rotations import cross_matrix, rotate_by_smallest

MOST_OFF = 0.2
"""Error of a sensor's zero and matrix, as a part of the field, beyond which a search takes its directions for no worse."""


@dataclass(frozen=True)
class KnownField(StateTerm):
    """Readings calibrated to T `read_B` (n, 3), NaN where none, `sigma_T` (n) of each component; the field there `field_N` (n, 3)
    T; what one sigma of each of e errors that are estimated changes in both: `own_B`, `along_N` (n, e, 3) T. `field_B` (n, 3) are
    the readings as they came, which pull at a dipole that is given in their unit."""

    name: ClassVar[str] = "field"
    called: ClassVar[str] = "magnetometer"
    per_sample: ClassVar[tuple[str, ...]] = (
        "field_B",
        "read_B",
        "sigma_T",
        "field_N",
        "own_B",
        "along_N",
    )
    measured: ClassVar[tuple[str, ...]] = ("read_B",)

    field_B: np.ndarray
    read_B: np.ndarray
    sigma_T: np.ndarray
    field_N: np.ndarray
    own_B: np.ndarray
    along_N: np.ndarray

    def present(self) -> np.ndarray:
        return np.all(np.isfinite(self.read_B), axis=1)

    def readings(self) -> int:
        return int(self.present().sum())

    def directions(self) -> SunDirection:
        """Its directions in the body as if they were the Sun's: what a search begins with where no Sun is seen."""
        size = np.linalg.norm(self.field_N, axis=1)
        own = np.sqrt((self.own_B**2).sum(axis=(1, 2)) / 3)
        sigma = np.hypot(self.sigma_T, np.minimum(own, MOST_OFF * size)) / size
        unit = self.read_B / np.linalg.norm(self.read_B, axis=1, keepdims=True)
        return SunDirection.of(
            unit, np.where(self.present(), sigma**2, np.nan)[:, None, None] * np.eye(3)
        )

    def frames(self) -> np.ndarray:
        """Matrices (n, 3, 3) from N to axes whose z is the field, turned as little as it turns."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        made = [facing(unit[0]).T]
        for before, after in zip(unit, unit[1:], strict=False):
            back = rotate_by_smallest(
                np.tile(after, (3, 1)), np.tile(before, (3, 1)), np.eye(3)
            ).T  # takes the new direction to the old
            made.append(made[-1] @ back)
        return np.array(made)

    def turning(self, t_s: np.ndarray) -> np.ndarray:
        """Rates (n, 3) rad/s, in N, at which those axes turn at times (n)."""
        unit = self.field_N / np.linalg.norm(self.field_N, axis=1, keepdims=True)
        return np.cross(unit, np.gradient(unit, t_s, axis=0))

    def unrelated(self, t_s: np.ndarray) -> float:
        """A direction to a sigma fills that part of the sphere."""
        read = self.present()
        share = self.sigma_T[read] ** 2 / (2 * (self.field_N[read] ** 2).sum(axis=1))
        return float(np.minimum(np.log(share), 0.0).sum())

    def unknowns(self) -> tuple[Unknown, ...]:
        if not self.present().any():
            return ()
        sizes = np.linalg.norm(self.own_B, axis=2).max(axis=0)
        return tuple(
            Unknown(f"magnetometer_{i}", "magnetometer", "T", 0.0, float(size), i)
            for i, size in enumerate(sizes)
        )

    def begin(self, seen: Seen) -> np.ndarray:
        """Attitudes (K, n, 3, 3) turned about the Sun so that the readings fit best: the search knows only the Sun."""
        there = self.present()
        read_N = np.einsum("knji,nj->kni", seen.attitude[:, there], self.read_B[there])
        known, weight = self.field_N[there], 1 / self.sigma_T[there] ** 2
        # N is turned by the angle about z that carries the known field to the one read, as far as both lie across z
        sine = ((known[:, 0] * read_N[..., 1] - known[:, 1] * read_N[..., 0]) * weight).sum(axis=1)
        cosine = ((known[:, :2] * read_N[..., :2]).sum(axis=2) * weight).sum(axis=1)
        angle = np.arctan2(sine, cosine)
        about = np.zeros((len(angle), 3, 3))
        about[:, 0, 0] = about[:, 1, 1] = np.cos(angle)
        about[:, 1, 0], about[:, 0, 1] = np.sin(angle), -np.sin(angle)
        about[:, 2, 2] = 1.0
        return seen.attitude @ about[:, None]

    def residuals(self, seen: Seen, error: np.ndarray | None = None) -> Iterator[Residual]:
        there = self.present()
        if not there.any():
            return
        inverse = np.where(there, 1 / self.sigma_T, 0.0)[:, None]
        field = np.einsum("knij,nj->kni", seen.attitude, self.field_N)
        read, parts = np.nan_to_num(self.read_B), []
        if error is not None and error.shape[1]:
            along, own = (
                np.einsum("knij,nej->knie", seen.attitude, self.along_N),
                np.swapaxes(np.nan_to_num(self.own_B), 1, 2),
            )
            field = field + np.einsum("knie,ke->kni", along, error)
            read = read + np.einsum("nie,ke->kni", own, error)
            parts = [along - own]
        off = field - read
        slope = [
            cross_matrix(field),
            np.zeros((*field.shape, 3)),
            *parts,
        ]  # a turn moves the field by field x turn
        yield off * inverse, np.concatenate(slope, axis=-1) * inverse[..., None]
