"""Any law of light: directions, lit sets, ranks and bounds from its powers alone, by looking all over the sphere.

A law says what share of its gain a panel gives; it need be neither smooth nor symmetric. What the closed form of the cosine knows
from planes is found here on even directions (`LOOKS`, `NODES`) and refined by slopes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING

import numpy as np

from sunspin.base.errors import InputError, sentence
from sunspin.solve.least_squares import Stop, least_squares
from sunspin.solve.linear import Dense, dense
from sunspin.solve.rotations import moved, seen_turned, tangents
from sunspin.vehicle.response.cosine import RANK_TOLERANCE, Flat, blurred
from sunspin.vehicle.response.protocol import (
    Counted,
    Law,
    Regions,
    Slopes,
    misfit,
    sphere,
    unit_readings,
)

if TYPE_CHECKING:
    from sunspin.vehicle.response.cube import SphereTable
    from sunspin.vehicle.response.inside import Inside

LOOKS, NODES = 40_000, 4000
"""Directions, 1 and 3.2 degrees apart, at which regions are told apart, and from which the best direction is sought."""

STEP = 1e-5
"""rad of the differences that slopes are made of."""

JUMP = 1e-3
"""Slopes to both sides that differ by more than this share of the gain lie at an edge."""

GRAZING = 1.5
"""A panel of a smaller share than so many rad of its slope may be dark next to this direction."""

BASINS = 10
"""Local minima of Delta among the nodes, at most."""

TIE = 1e-13
"""Of the cosine between readings and powers, from one node to the next: no difference between others is as small."""

HOPELESS, NEARLY, NEARLY_ON_EDGE = 0.15, 0.03, 1e-3
"""A node whose Delta exceeds the best by more than the first is in no better basin: neighbours differ by less. What slopes have
left at an edge may lose as much as the second when it is polished, what lies on one already the third."""

THINNED = 4
"""Of the directions on edges at which no power jumps one in so many is looked at: half a degree from the next."""

STEPS, ROUNDING = 25, 1e-18
"""Trials of least squares from a local minimum, and the gain in Delta squared at which they end."""

AROUND, CLOSELY = (
    np.stack([np.cos(a), np.sin(a)], axis=-1)
    for a in (np.arange(n) * 2 * np.pi / n for n in (16, 64))
)
FIRST_RAD, LAST_RAD = 0.01, 1e-9
"""Directions in which the polish looks for something better, at first so far away, at last so near. Along an edge only directions
nearly along it lead on: what is left there of Delta is a few 1e-5 at most."""

HALVINGS = 40
"""Of the way between two neighbours, to the edge between them."""

NUMBERS = 8_000_000
"""Samples times directions looked at together."""

ARC_STEP = 0.05
"""rad of a step along an arc, halved at its end."""

EARTH_RAD = np.radians(66.0)
"""Radius of the Earth's disc seen from 550 km."""

SIZES = (32, 64, 128, 256, 512)
"""Cells along an edge of the cube that a table may have."""

MASK_SIZE = 96
"""The same of a mask: 0.9 degrees."""

CAP_SIZE, CAP_LOOKS, COARSE = 40, 10_000, 2e-3
"""The same of bounds, 2.3 degrees, of directions 2 degrees apart; the error (share of the gain) of powers inside compiled code."""


@lru_cache(maxsize=4)
def _even(n: int) -> np.ndarray:
    """Even directions (n, 3), turned so that none lies on an axis or plane that a vehicle is likely to have."""
    found = seen_turned(sphere(n), np.array([0.3, 0.5, 0.7]))
    found.setflags(write=False)
    return found


@lru_cache(maxsize=1)
def _neighbours() -> np.ndarray:
    """Pairs (m, 2) of even directions that are next to each other."""
    from scipy.spatial import KDTree

    return KDTree(_even(LOOKS)).query_pairs(1.3 * _gap(LOOKS), output_type="ndarray")


@dataclass(frozen=True, eq=False)
class Tabled(Flat):
    """A law as a :class:`sunspin.vehicle.response.protocol.PanelResponse`; names and shapes as there."""

    law: Law
    names: tuple[str, ...]

    def power(
        self,
        sun_B: np.ndarray,
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
        blur_rad: float = 0.0,
    ) -> np.ndarray:
        if blur_rad:
            return blurred(lambda sun: self.power(sun, gain=gain, tilt=tilt), sun_B, blur_rad)
        normals = self.normals_B if tilt is None else self.turned(tilt)
        return self.strengths(gain) * np.maximum(
            0.0, self.law.share(self.names, sun_B, normals, self.cosines(sun_B, tilt))
        )

    @cached_property
    def _facing(self) -> np.ndarray:
        sun, far = _even(LOOKS)[np.argmax(self._base._seen, axis=0)], _gap(LOOKS)
        own = np.arange(len(sun))
        while far > LAST_RAD:
            around = np.concatenate(
                [
                    sun[None],
                    *[moved(sun, np.tile(far * step, (len(sun), 1)))[None] for step in AROUND],
                ]
            )
            best = np.argmax(self.power(around)[:, own, own], axis=0)
            sun, far = around[best, own], far / (1 if best.any() else 2)
        return sun

    @property
    def facing_B(self) -> np.ndarray:
        return self._base._facing

    @property
    def largest(self) -> float:
        return float(self.gains.max())

    # -------------------------------------------------------------------------------------------------------------- derivatives

    def slopes(
        self, sun_B: np.ndarray, *, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> Slopes:
        power, to_sun = self._along_sphere(sun_B, gain, tilt)
        if tilt is None:
            return Slopes(power, to_sun, None)
        turned = [
            [self.power(sun_B, gain=gain, tilt=tilt + sign * STEP * one) for sign in (1, -1)]
            for one in np.eye(3)
        ]
        return Slopes(
            power, to_sun, np.stack([self._lit_side(power, *both) for both in turned], axis=-1)
        )

    def _along_sphere(
        self, sun_B: np.ndarray, gain: np.ndarray | None = None, tilt: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Powers (..., n_panel) and their slopes (..., n_panel, 3) by the Sun."""
        flat = np.asarray(sun_B, dtype=np.float64).reshape(-1, 3)

        def to_both_sides(step: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            ends = [
                moved(flat, np.tile(sign * step, (len(flat), 1))).reshape(sun_B.shape)
                for sign in (1, -1)
            ]
            return self.power(ends[0], gain=gain, tilt=tilt), self.power(
                ends[1], gain=gain, tilt=tilt
            )

        power = self.power(sun_B, gain=gain, tilt=tilt)
        frame = [axis.reshape(*sun_B.shape[:-1], 1, 3) for axis in tangents(flat)]
        along = [self._lit_side(power, *to_both_sides(step)) for step in STEP * np.eye(2)]
        to_sun = along[0][..., None] * frame[0] + along[1][..., None] * frame[1]
        return power, to_sun

    def _lit_side(self, here: np.ndarray, ahead: np.ndarray, behind: np.ndarray) -> np.ndarray:
        """The slope (..., n_panel) from powers a `STEP` ahead and behind: across an edge that of the side that is lit like here."""
        forward, back = (ahead - here) / STEP, (here - behind) / STEP
        smaller = np.where(np.abs(forward) < np.abs(back), forward, back)
        return np.where(np.abs(forward - back) > JUMP * self.gains, smaller, (forward + back) / 2)

    def along(
        self,
        sun_B: np.ndarray,
        steps: Sequence[np.ndarray],
        *,
        gain: np.ndarray | None = None,
        tilt: np.ndarray | None = None,
    ) -> list[np.ndarray]:
        power, to_sun = self._along_sphere(sun_B, gain, tilt)
        to_sun = np.where(power[..., None] > 0, to_sun, 0.0)
        return [np.einsum("...pi,...i->...p", to_sun, step) for step in steps]

    def under(self, light_B: np.ndarray, unit: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
        size = np.linalg.norm(light_B, axis=-1, keepdims=True)
        sun = light_B / np.where(size > 0, size, 1.0)
        sun = np.where(size > 0, sun, [0.0, 0.0, 1.0])
        return self.power(sun) * size / unit, self.design(sun) / unit

    def design(self, sun_B: np.ndarray) -> np.ndarray:
        """The derivative (..., n_panel, 3) of powers by the vector brightness times direction, at brightness 1."""
        power, to_sun = self._along_sphere(sun_B)
        return power[..., None] * sun_B[..., None, :] + to_sun

    def disc(self, axis_B: np.ndarray, strength: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """As the average over an evenly bright disc, what a flat panel of gain 1 that looks there gets being 1."""
        strength = np.asarray(strength, dtype=np.float64)[..., None]
        flat = np.asarray(axis_B, dtype=np.float64).reshape(-1, 3)

        def seen(axis: np.ndarray) -> np.ndarray:
            first, second = tangents(axis)
            frame = np.stack([first, second, axis], axis=1)
            return (
                np.mean([self.power(one @ frame) for one in _CAP], axis=0).reshape(
                    *axis_B.shape[:-1], -1
                )
                / _CAP[:, 2].mean()
            )

        light = seen(flat)
        to_axis = [
            (
                seen(moved(flat, np.tile(step, (len(flat), 1))))
                - seen(moved(flat, np.tile(-step, (len(flat), 1))))
            )
            / (2 * 1e-3)
            for step in 1e-3 * np.eye(2)
        ]
        frame = [axis.reshape(*axis_B.shape[:-1], 1, 3) for axis in tangents(flat)]
        slope = light[..., None] * axis_B[..., None, :] + sum(
            d[..., None] * e for d, e in zip(to_axis, frame, strict=True)
        )
        return light * strength, slope

    def bounds(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        from sunspin.vehicle.response.inside import nearest

        near = nearest(
            CAP_SIZE, np.ascontiguousarray(sun_B, dtype=np.float64).reshape(-1, 3)
        ).reshape(sun_B.shape[:-1])
        found = np.where(
            np.isfinite(sun_B)[..., None, :1], _caps(self._base, float(angle))[near], np.nan
        )
        return self.gains * found[..., 0], self.gains * found[..., 1]

    def inside(self, angles: tuple[float, ...]) -> Inside:
        from sunspin.vehicle.response.inside import Inside

        return Inside.of(
            self.normals_B,
            self.gains,
            angles,
            self._base._coarse,
            [_caps(self._base, angle) for angle in angles],
        )

    @cached_property
    def _coarse(self) -> SphereTable:
        return self.table(COARSE)

    # ------------------------------------------------------------------------------------------------------------------ regions

    @cached_property
    def _base(self) -> Tabled:
        """The same law with gains of one, whose looks are shared by all gains."""
        return _of_unit_gains(
            type(self),
            self.law,
            self.names,
            tuple(map(tuple, self.normals_B.tolist())),
            len(self.gains),
        )

    @cached_property
    def _seen(self) -> np.ndarray:
        """Shares (LOOKS, n_panel) all over the sphere."""
        return self.power(_even(LOOKS)) / self.gains

    def sides(self, sun_B: np.ndarray) -> np.ndarray:
        """What (..., m) is the same all over a region."""
        return self.power(sun_B) > 0

    @cached_property
    def _regions(self) -> Regions:
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import connected_components
        from scipy.spatial import KDTree

        lit, where = self._seen > 0, _even(LOOKS)
        side, (a, b) = _code(self.sides(where)), _neighbours().T
        same = side[a] == side[b]
        pairs = coo_array((np.ones(same.sum()), (a[same], b[same])), shape=(LOOKS, LOOKS))
        count, part = connected_components(pairs, directed=False)
        border = np.unique(np.concatenate([a[~same], b[~same]]))
        inside = np.full(LOOKS, np.pi) if not len(border) else KDTree(where[border]).query(where)[0]
        order = np.lexsort((-inside, part))
        chosen = order[np.searchsorted(part[order], np.arange(count))]
        return Regions(where[chosen], lit[chosen])

    def regions(self) -> Regions:
        return self._base._regions

    @cached_property
    def _borders(self) -> tuple[np.ndarray, np.ndarray]:
        """Directions (m, 3) at edges, to both sides where a power jumps, and their shares (m, n_panel)."""
        code = _code(self.sides(_even(LOOKS)))
        a, b = _neighbours()[code[_neighbours()[:, 0]] != code[_neighbours()[:, 1]]].T
        low, high = _even(LOOKS)[a], _even(LOOKS)[b]
        for _ in range(HALVINGS):
            middle = low + high
            middle /= np.linalg.norm(middle, axis=1, keepdims=True)
            near = (_code(self.sides(middle)) == code[a])[:, None]
            low, high = np.where(near, middle, low), np.where(near, high, middle)
        jump = (np.abs(self.power(low) - self.power(high)) > JUMP).any(axis=1)
        found = np.concatenate([low[jump], high[jump], low[~jump][::THINNED]])
        return found, self.power(found)

    @cached_property
    def _edges(self) -> Regions:
        """Where panels graze, with those that do left out."""
        grazing = self._seen < GRAZING * _gap(LOOKS)
        lit, first = np.unique((self._seen > 0) & ~grazing, axis=0, return_index=True)
        return Regions(_even(LOOKS)[first], lit)

    def edges(self) -> np.ndarray:
        return self._base._edges.lit

    def rank(self, lit: np.ndarray, sun_B: np.ndarray | None = None) -> int:
        if not lit.any():
            return 0
        if sun_B is None:
            every = Regions(
                *(
                    np.concatenate(both)
                    for both in zip(self._base._regions, self._base._edges, strict=True)
                )
            )
            there = every.sun_B[(every.lit == lit).all(axis=1)]
            return max((self.rank(lit, sun) for sun in there), default=min(int(lit.sum()), 3))
        design = (self.design(sun_B) / self.gains[:, None])[lit]
        return int(np.count_nonzero(np.linalg.svd(design, compute_uv=False) > RANK_TOLERANCE))

    # --------------------------------------------------------------------------------------------------------------- directions

    def candidates(self, share: np.ndarray) -> np.ndarray:
        target = unit_readings(share)
        return np.concatenate([self._candidates(target[part])[0] for part in _chunks(len(target))])

    def _candidates(self, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n, BASINS or one more, 3), and how much of Delta (n, ...) a polish across edges may take from them: none
        where slopes have come to a minimum."""
        found = self._basins(target)
        away = misfit(self.power(found), target[:, None])
        sample, which = np.nonzero(away < away.min(axis=1, keepdims=True) + HOPELESS)
        left = np.zeros(found.shape[:2])
        found[sample, which], settled = self._refined(found[sample, which], target[sample])
        left[sample, which] = np.where(settled, 0.0, NEARLY)
        edge, shape = self._base._borders
        if len(edge):
            nearest = edge[np.argmax(target @ unit_readings(self.gains * shape).T, axis=1)]
            found = np.concatenate([found, nearest[:, None]], axis=1)
            left = np.concatenate([left, np.full((len(target), 1), NEARLY_ON_EDGE)], axis=1)
        return found, left

    def _basins(self, target: np.ndarray) -> np.ndarray:
        """Nodes (n, BASINS, 3) at which Delta is less than at their neighbours."""
        shares, neighbours = self._base._nodes
        along = target @ unit_readings(self.gains * shares).T + TIE * np.arange(
            NODES
        )  # a plateau has one highest node
        highest = np.full(along.shape, -np.inf)
        for column in neighbours.T:
            np.maximum(highest, along[:, column], out=highest)
        ranked = np.where(along >= highest, along, along - 10.0)
        first = np.argpartition(-ranked, BASINS, axis=1)[:, :BASINS]
        return _even(NODES)[first]

    @cached_property
    def _nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """Shares at the nodes (NODES, n_panel), and the numbers of the eight neighbours of each, of those
        of another region its own: each region has its minima."""
        from scipy.spatial import KDTree

        neighbours = np.asarray(KDTree(_even(NODES)).query(_even(NODES), k=9)[1])
        power = self.power(_even(NODES))
        code = _code(self.sides(_even(NODES)))
        neighbours = np.where(code[neighbours] == code[:, None], neighbours, neighbours[:, :1])
        return power, neighbours[:, 1:]

    def _refined(self, start: np.ndarray, target: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Directions (n, 3) taken down to the local minimum of Delta by their slopes, as far as no edge lies between, and which (n)
        came to one."""

        def linearise(state: tuple[np.ndarray, np.ndarray]) -> Dense:
            sun, wanted = state
            power, to_sun = self._along_sphere(sun)
            size = np.linalg.norm(power, axis=1)[:, None]
            shape = power / np.where(size > 0, size, 1.0)
            change = (
                to_sun @ np.stack(tangents(sun), axis=-1) / np.where(size > 0, size, 1.0)[..., None]
            )
            change = change - shape[..., None] * np.einsum("np,npi->ni", shape, change)[:, None]
            system = Dense.of(shape - wanted, change, np.ones((len(sun), 2)))
            return system._replace(cost=np.where(size[:, 0] > 0, system.cost, 2.0))

        found = least_squares(
            linearise,
            lambda s, step: (moved(s[0], step), s[1]),
            dense,
            (start, target),
            steps=STEPS,
            tolerance=ROUNDING,
        )
        return found.state[0], found.stop == Stop.ARRIVED

    def best(self, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        target, direction = unit_readings(readings), np.zeros((len(readings), 3))
        for part in _chunks(len(target)):
            wanted = target[part]
            found, left = self._candidates(wanted)
            away = misfit(self.power(found), wanted[:, None])
            sample, which = np.nonzero((left > 0) & (away < away.min(axis=1, keepdims=True) + left))
            found[sample, which] = self._polished(found[sample, which], wanted[sample])
            least = np.argmin(misfit(self.power(found), wanted[:, None]), axis=1)
            direction[part] = found[np.arange(len(found)), least]
        return direction, misfit(self.power(direction), target)

    def alike(self, readings: np.ndarray, slack: np.ndarray) -> np.ndarray:
        best, delta = self.best(readings)
        found = np.concatenate([best[:, None], self.candidates(readings)], axis=1)
        away = misfit(self.power(found), unit_readings(readings)[:, None])
        return np.where((away <= (delta + slack)[:, None])[..., None], found, np.nan)

    @property
    def images(self) -> np.ndarray:
        return np.eye(3)[None]

    def _polished(self, start: np.ndarray, target: np.ndarray) -> np.ndarray:
        """Directions (n, 3) moved to better ones around them, on whatever side of an edge, ever nearer."""
        sun = start.copy()
        for around in (AROUND, CLOSELY):
            self._look_around(sun, target, around)
        return sun

    def _look_around(self, sun: np.ndarray, target: np.ndarray, around: np.ndarray) -> None:
        """Move directions (n, 3), in place."""
        delta, far = misfit(self.power(sun), target), np.full(len(sun), FIRST_RAD)
        while len(on := np.flatnonzero(far > LAST_RAD)):
            steps = far[on, None, None] * around
            tried = moved(np.repeat(sun[on], len(around), axis=0), steps.reshape(-1, 2)).reshape(
                len(on), len(around), 3
            )
            new = misfit(self.power(tried), target[on, None])
            best = np.argmin(new, axis=1)
            least = new[np.arange(len(on)), best]
            better = least < delta[on] * (1 - 1e-12)
            sun[on[better]], delta[on[better]] = tried[better, best[better]], least[better]
            far[on[~better]] /= 3

    def covariance(self, readings: np.ndarray, lit: np.ndarray, noise: float) -> np.ndarray:
        sun, _ = self.best(readings)
        design = self.design(sun) * lit[:, None]
        power = self.power(sun) * lit
        bright = (readings * power).sum(axis=1) / np.maximum((power**2).sum(axis=1), 1e-300)
        tangent = np.eye(3) - sun[:, :, None] * sun[:, None, :]
        found = np.full((len(sun), 3, 3), np.nan)
        normal = np.swapaxes(design, -1, -2) @ design
        fine = (np.linalg.cond(normal) < RANK_TOLERANCE**-2) & (bright > 0)
        found[fine] = (
            tangent[fine]
            @ (noise**2 * np.linalg.inv(normal[fine]) / bright[fine, None, None] ** 2)
            @ tangent[fine]
        )
        return found

    def arc(self, readings: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """Followed from the best direction to both sides, along which the lit panels' powers keep their proportions."""
        target = np.where(lit, readings, 0.0)[None]
        shown = _even(LOOKS)[((self._base._seen > 0) == lit).all(axis=1)]
        if not len(shown):
            return np.full((2, 3), np.nan)
        away = misfit(self.power(shown) * lit, unit_readings(target))
        begin = shown[np.argmin(away)]
        refined = self._refined(begin[None], unit_readings(target))[0][0]
        begin = refined if np.array_equal(self.power(refined) > 0, lit) else begin
        return np.array([self._followed(begin, lit, sign) for sign in (1.0, -1.0)])

    def _followed(self, begin: np.ndarray, lit: np.ndarray, sign: float) -> np.ndarray:
        """The end of the arc, where another panel is lit or one of them dark, or half a circle on."""
        sun, along, step = begin, sign * self._unseen(begin, lit), ARC_STEP
        while step > LAST_RAD:
            halfway = np.cos(step / 2) * sun + np.sin(step / 2) * along
            ahead = None
            if np.array_equal(self.power(halfway) > 0, lit):
                middle = self._unseen(halfway, lit)
                middle = (middle - (middle @ sun) * sun) * np.copysign(1.0, middle @ along)
                ahead = np.cos(step) * sun + np.sin(step) * middle / np.linalg.norm(middle)
            if (
                ahead is None
                or not np.array_equal(self.power(ahead) > 0, lit)
                or ahead @ begin < -1 + 1e-3
            ):
                step /= 2
                continue
            new = self._unseen(ahead, lit)
            sun, along = ahead, new * np.copysign(1.0, new @ along)
        return sun

    def _unseen(self, sun: np.ndarray, lit: np.ndarray) -> np.ndarray:
        """The tangent (3) at a direction (3) along which the proportions of the lit panels' powers change least."""
        frame = np.stack(tangents(sun[None]), axis=-1)[0]
        power, to_sun = (value[lit] for value in self._along_sphere(sun))
        across = to_sun @ frame
        across = across - np.outer(power, power @ across) / (power @ power)
        return frame @ np.linalg.svd(across)[2][1]

    # ------------------------------------------------------------------------------------------------------------------- tables

    def counted(self, good: np.ndarray, bad: np.ndarray) -> Counted:
        return Counted(
            self.normals_B, (), _border(self._base, tuple(np.unique(_code(good)).tolist()))
        )

    def table(self, error: float) -> SphereTable:
        """The smallest table that gives powers to `error`, a share of the gain, beside edges."""
        from sunspin.vehicle.response.cube import SphereTable, nodes

        asked, reached = _even(LOOKS), np.inf
        for size in SIZES:
            power, to_sun = self._along_sphere(nodes(size))
            numbers = np.concatenate([power[..., None], to_sun], axis=-1) / self.gains[:, None]
            found = SphereTable(size, numbers.astype(np.float32), np.nan, np.nan)
            away = np.abs(found.read(asked)[0] - self._base._seen)
            least, most = self._around(asked, 2.0 / size)
            edge = ((least > 0) != (most > 0)) | (most - least > 6.0 / size)
            reached = float(away[~edge].max(initial=0.0))
            if reached <= error:
                return found._replace(error=reached, edges=float(edge.any(axis=1).mean()))
        what = (
            f"no table of {SIZES[-1]} cells along an edge of the cube tells the panels' law so well"
        )
        raise InputError(sentence(what, got=f"error {error:g}", do=f"allow {reached:.1g}"))

    def _around(self, sun_B: np.ndarray, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Least and largest share (n, n_panel) on a ring around directions (n, 3)."""
        ring = (
            np.stack(
                [
                    self.power(moved(sun_B, np.tile(angle * step, (len(sun_B), 1))))
                    for step in AROUND[::2]
                ]
            )
            / self.gains
        )
        return ring.min(axis=0), ring.max(axis=0)


@lru_cache(maxsize=16)
def _of_unit_gains(
    kind: type[Tabled],
    law: Law,
    names: tuple[str, ...],
    normals_B: tuple[tuple[float, ...], ...],
    readings: int,
) -> Tabled:
    return kind(np.array(normals_B).reshape(-1, 3), np.ones(readings), law, names)


@lru_cache(maxsize=16)
def _border(response: Tabled, wanted: tuple[int, ...]) -> np.ndarray:
    """The table of a mask of directions in which one of these sets of panels is lit."""
    from sunspin.vehicle.response.border import angle_to_border

    found = angle_to_border(lambda sun: np.isin(_code(response.power(sun) > 0), wanted), MASK_SIZE)
    found.setflags(write=False)
    return found


@lru_cache(maxsize=16)
def _caps(response: Tabled, angle: float) -> np.ndarray:
    """Least and largest share (6 (CAP_SIZE + 1)^2, n_panel, 2) within `angle` of whatever lies nearest to a node of the cube: of
    directions `CAP_LOOKS`, each of which stands for those around it up to its slope."""
    from sunspin.vehicle.response.cube import nodes
    from sunspin.vehicle.response.inside import over_caps

    looks, gap = _even(CAP_LOOKS), _gap(CAP_LOOKS)
    power, to_sun = response._along_sphere(looks)
    more = np.linalg.norm(to_sun, axis=-1) * gap
    reach = min(angle + np.sqrt(2) / CAP_SIZE + gap, np.pi)
    found = over_caps(
        nodes(CAP_SIZE), np.cos(reach), looks, np.maximum(power - more, 0.0), power + more
    )
    found.setflags(write=False)
    return found


def _code(lit: np.ndarray) -> np.ndarray:
    """Sets of lit panels (..., n_panel) as numbers (...)."""
    return lit @ (1 << np.arange(lit.shape[-1], dtype=np.int64))


def _chunks(n: int) -> list[slice]:
    """Of n samples, those that are looked at together."""
    size = max(1, NUMBERS // NODES)
    return [slice(at, at + size) for at in range(0, max(n, 1), size)]


def _gap(n: int) -> float:
    """About the distance (rad) between neighbours of `n` even directions."""
    return float(np.sqrt(4 * np.pi / n))


def _cap(radius: float, n: int = 300) -> np.ndarray:
    """Even directions (n, 3) within `radius` (rad) of +z."""
    z = 1 - (1 - np.cos(radius)) * (np.arange(n) + 0.5) / n
    longitude = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    return np.stack(
        [np.sqrt(1 - z**2) * np.cos(longitude), np.sqrt(1 - z**2) * np.sin(longitude), z], axis=-1
    )


_CAP = _cap(EARTH_RAD)
