"""What is asked about how panels see light: the rest of the package asks nothing else about it.

Directions `sun_B` (..., 3) are unit vectors in body axes, results (..., n_panel); all is batched over leading axes, NaN gives
NaN and no power is negative. If body and Sun turn together nothing changes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

import numpy as np

Literals = tuple[tuple[int, bool], ...]
"""A conjunction: (panel index, lit?) ..."""


class Slopes(NamedTuple):
    """`power` (..., n_panel), and its derivatives (..., n_panel, 3): `to_sun`, along the sphere; `to_tilt`, by a turn (rad, B) of
    each panel, None unless turns were given. At an edge those of the lit side."""

    power: np.ndarray
    to_sun: np.ndarray
    to_tilt: np.ndarray | None


class Regions(NamedTuple):
    """Open regions of the sphere in which the same panels are lit: one direction inside each (n, 3), and `lit` (n, n_panel)."""

    sun_B: np.ndarray
    lit: np.ndarray


@dataclass(frozen=True)
class Counted:
    """A signed function on the sphere, above 0 where a direction counts: as data, for kernels and for Python.

    It is the largest over `clauses` of the smallest of distances from the planes of `normals_B` (n, 3), each clause a conjunction
    of (number of the plane, which side?).
    """

    normals_B: np.ndarray
    clauses: tuple[Literals, ...]

    def holds(self, sun_B: np.ndarray) -> np.ndarray:
        """Whether each direction (..., 3) counts."""
        lit = sun_B @ self.normals_B.T > 0
        clauses = [
            np.all([lit[..., k] == wanted for k, wanted in clause], axis=0)
            for clause in self.clauses
        ]
        return np.any([np.broadcast_to(clause, lit.shape[:-1]) for clause in clauses], axis=0)

    @property
    def numbers(self) -> np.ndarray:
        """What compiled code reads, in float32."""
        return np.asarray(self.normals_B, dtype=np.float32).ravel()


class PanelResponse(Protocol):
    """How panels of one vehicle see light."""

    def __hash__(self) -> int: ...

    @property
    def facing_B(self) -> np.ndarray:
        """The direction (n_panel, 3) in which each panel gets most."""
        ...

    @property
    def largest(self) -> float:
        """A number of the size of the largest power."""
        ...

    def power(
        self,
        sun_B: np.ndarray,
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
        blur_rad: float = 0.0,
    ) -> np.ndarray:
        """Signal of each panel; with factors `gain` (..., n_panel) on its gain, turned by `tilt` (..., n_panel, 3) rad in B, or
        averaged over directions that err by `blur_rad`, one sigma to each side."""
        ...

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        """The same with its derivatives."""
        ...

    def along(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        """How powers change (each (..., n_panel)) with the Sun along each of `steps` (..., 3): not at all where they are zero."""
        ...

    def under(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        """Signals (..., n_panel), in `unit`s, under a light `light_B` (..., 3), direction times brightness, and their derivative by
        it, which (..., n_panel, 3) or (n_panel, 3) holds where the signal is not zero."""
        ...

    def disc(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Signals (..., n_panel) under the Earth about `axis_B`, `strength` (...) being what a panel of gain 1 gets that looks
        there; and their derivative (..., n_panel, 3) by the vector strength times axis."""
        ...

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest signal for any Sun within `angle` rad, or a little beyond."""
        ...

    def regions(self) -> Regions:
        """Which panels can be lit together, and where."""
        ...

    def edges(self) -> np.ndarray:
        """What is lit (m, n_panel) in directions between regions, where a panel that the Sun grazes may read as dark."""
        ...

    def candidates(self, share: np.ndarray) -> np.ndarray:
        """Directions (n, k, 3), one of which is at, or in the basin of, the global minimum of Delta for readings (n, n_panel)."""
        ...

    def best(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The direction (n, 3) with the smallest Delta (n) (paper, eq. 2) for readings (n, n_panel): the global minimum."""
        ...

    def alike(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        """Directions (n, k, 3), the best first, with a Delta that exceeds the smallest by no more than `slack` (n); else NaN. Of
        one law, the cosine's, the best alone: there no two fit alike."""
        ...

    @property
    def images(self) -> np.ndarray:
        """Mirrors and turns (m, 3, 3) of the body that change readings little or not at all, the first of them none at all."""
        ...

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        """How many numbers of three, direction and brightness, panels `lit` (n_panel) tell there, by default where they are lit."""
        ...

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: np.ndarray) -> np.ndarray:
        """Tangent covariance (n, 3, 3) of directions told by readings (n, n_panel), of which `lit` (n_panel) count; `noise`
        (n_panel): their sigmas."""
        ...

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Ends (2, 3) of the arc of directions that panels `lit` (n_panel), of rank 2, with readings (n_panel) leave; else NaN."""
        ...

    def counted(self, good: np.ndarray, bad: np.ndarray) -> Counted:
        """The directions in which one of the sets of panels `good` (m, n_panel) is lit and none of `bad`, all of them shown."""
        ...


def misfit(shape: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Delta (...) between signals (..., n_panel) of any brightness and unit vectors `target` (..., n_panel); 2 in the dark."""
    size = np.linalg.norm(shape, axis=-1, keepdims=True)
    unit = shape / np.where(size > 0, size, 1.0)
    return np.where(size[..., 0] > 0, np.linalg.norm(unit - target, axis=-1), 2.0)


def unit_readings(readings: np.ndarray) -> np.ndarray:
    """Readings (n, n_panel) as unit vectors; zeros stay."""
    size = np.linalg.norm(readings, axis=1)
    return readings / np.where(size > 0, size, 1.0)[:, None]


def sphere(n: int) -> np.ndarray:
    """About evenly spread directions (n, 3), by Fibonacci's spiral."""
    z = 1 - (2 * np.arange(n) + 1) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(longitude), np.sqrt(1 - z**2) * np.sin(longitude), z], axis=-1
    )


BLUR_NODES = np.array(
    [[0.0, 0.0]] + [[2 * np.cos(a), 2 * np.sin(a)] for a in np.arange(6) * np.pi / 3]
)
BLUR_WEIGHTS = np.array([1 / 2] + 6 * [1 / 12])
"""A rule for averages under a Gaussian law of the plane, of one sigma to each side: exact up to fifth powers."""
