"""The mixture from which motions are proposed: heavy-tailed components in coordinates bent along the sheets that modes are."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import gammaln

from sunspin.estimate.posterior.family import coordinates
from sunspin.estimate.posterior.model import State
from sunspin.solve.rotations import move_on_sphere

FREEDOM = 5.0
"""Degrees of freedom of the mixture's Student components."""


@dataclass(frozen=True)
class Sheet:
    """Which of D coordinates are stiff (q) and answer to those along the sheet (D - q); of these `bending` do so in the square too.

    Stiff are the brightness, which the readings tell better than any prior, and what is not soft of rate and direction: soft are
    those of their directions that may vary by much though u is known (the azimuth of H in the body first).
    """

    stiff: list[int]
    along: list[int]
    bending: list[int]

    @classmethod
    def of(
        cls, dimension: int, softs: int, moving: Sequence[int], brightness: Sequence[int]
    ) -> Sheet:
        """`softs`: how many are soft; `moving`: places in u of what the motion depends on; `brightness`: of that of the Sun."""
        bright, soft = [5 + i for i in brightness], list(range(softs))
        along = [i for i in range(5, dimension) if i not in bright] + soft
        return cls([*range(softs, 5), *bright], along, [*soft, *(5 + i for i in moving)])

    @property
    def softs(self) -> int:
        """How many are soft."""
        return sum(i < 5 for i in self.along)

    @property
    def terms(self) -> int:
        """How many monomials there are."""
        return len(self.along) + len(self.products)

    @property
    def products(self) -> list[tuple[int, int]]:
        """The pairs of coordinates whose products bend it, in the order of `monomials`."""
        return [(one, other) for i, one in enumerate(self.bending) for other in self.bending[i:]]

    def lent(self, other: Sheet, bend: np.ndarray) -> np.ndarray:
        """The products' part (pairs, q) of the bend (M, q) of a sheet without some of the unknowns; these bend nothing."""
        row = {pair: i for i, pair in enumerate(self.products)}
        found = np.zeros((len(row), len(self.stiff)))
        found[[row[pair] for pair in other.products]] = bend[len(other.along) :]
        return found


@dataclass(frozen=True)
class Mixture:
    """Student components in bent coordinates.

    centres (m), bases (m, 5, 5), bends (m, M, q), means (m, D) and covariances (m, D, D) in these coordinates, weights (m) that
    add to one. A basis turns rate and
    direction into coordinates of which the first are soft: they may vary by much within the noise. A bend says how the
    other stiff ones answer to these and to u: polynomials (see `monomials`), which are subtracted. That leaves volumes as they are,
    and straightens the thin curved sheet that uncertain inertias, friction and wheel speeds make of a mode. `sheet`: which
    coordinates are which.
    """

    centre: State
    basis: np.ndarray
    bend: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    weight: np.ndarray
    sheet: Sheet

    def take(self, index: np.ndarray) -> Mixture:
        """Some of the components."""
        parts = {
            name: getattr(self, name)[index]
            for name in ("basis", "bend", "mean", "covariance", "weight")
        }
        return Mixture(centre=self.centre.take(index), sheet=self.sheet, **parts)

    @classmethod
    def joined(cls, parts: list[Mixture]) -> Mixture:
        """The components of several, one after the other."""
        columns = ("basis", "bend", "mean", "covariance", "weight")
        every = {name: np.concatenate([getattr(part, name) for part in parts]) for name in columns}
        return cls(
            centre=State.joined([part.centre for part in parts]), sheet=parts[0].sheet, **every
        )

    def counted_in(self, units: np.ndarray) -> Mixture:
        """The same where u (k) is counted in units so many times as large."""
        size = np.concatenate([np.ones(5), units])
        terms = np.concatenate(
            [size[self.sheet.along], [size[i] * size[j] for i, j in self.sheet.products]]
        )
        bend = self.bend * terms[:, None] / size[self.sheet.stiff]
        centre = replace(self.centre, u=self.centre.u / units)
        covariance = self.covariance / (size[:, None] * size)
        return replace(self, centre=centre, bend=bend, mean=self.mean / size, covariance=covariance)

    def coordinates(self, state: State, m: int) -> np.ndarray:
        """Bent coordinates (n, D) of states about component m."""
        x = coordinates(state, self.centre.take(np.array([m])))
        x[:, :5] = x[:, :5] @ self.basis[m].T
        along, stiff = self.sheet.along, self.sheet.stiff
        if self.bend[m, len(along) :].any():
            x[:, stiff] -= monomials(x, self.sheet) @ self.bend[m]
        else:  # most of many components: their products would cost most of all
            x[:, stiff] -= x[:, along] @ self.bend[m, : len(along)]
        return x

    def charts(self, state: State, which: np.ndarray) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Those of the components `which` that have their bent coordinates in common, and these (n, D): what is learnt of a
        component, or differs by the size of a torque, has its chart."""
        parts = (
            *(getattr(self.centre, name) for name in ("omega", "sun", "u")),
            self.basis,
            self.bend,
        )
        chart = np.concatenate([part[which].reshape(len(which), -1) for part in parts], axis=1)
        number = np.unique(chart, axis=0, return_inverse=True)[1].ravel()
        for i in np.unique(number):
            alike = which[number == i]
            yield alike, self.coordinates(state, int(alike[0]))

    def states(self, x: np.ndarray, which: np.ndarray) -> State:
        """The states (n) with bent coordinates x (n, D) about the components `which` (n)."""
        centre = self.centre.take(which)
        x = np.array(x)
        x[:, self.sheet.stiff] += np.einsum(
            "nm,nmj->nj", monomials(x, self.sheet), self.bend[which]
        )
        step = np.linalg.solve(self.basis[which], x[:, :5, None])[:, :, 0]
        return State(
            centre.omega + step[:, :3],
            move_on_sphere(centre.sun, np.clip(step[:, 3:], -np.pi, np.pi)),
            centre.u + x[:, 5:],
        )

    def draw(self, n: int, rng: np.random.Generator) -> State:
        """n draws: systematic over the components, so that each gets its share."""
        edges = np.cumsum(self.weight) / self.weight.sum()
        which = np.minimum(
            np.searchsorted(edges, (np.arange(n) + rng.random()) / n), len(edges) - 1
        )
        root = np.linalg.cholesky(self.covariance)
        x = np.einsum("nij,nj->ni", root[which], rng.standard_normal((n, self.covariance.shape[1])))
        return self.states(
            self.mean[which] + x * np.sqrt(FREEDOM / rng.chisquare(FREEDOM, n))[:, None], which
        )

    def log_densities(self, state: State) -> np.ndarray:
        """Log density (n, m) of each component times its weight, over rates, the sphere and u."""
        out = np.empty((len(state), len(self.weight)))
        d = self.covariance.shape[1]
        constant = (
            gammaln((FREEDOM + d) / 2) - gammaln(FREEDOM / 2) - 0.5 * d * np.log(FREEDOM * np.pi)
        )
        for alike, x in self.charts(state, np.arange(len(self.weight))):
            angle = np.arccos(np.clip(state.sun @ self.centre.sun[alike[0]], -1.0, 1.0))
            sphere = -np.log(np.maximum(np.sinc(angle / np.pi), 1e-12))
            for m in alike:
                root = np.linalg.cholesky(self.covariance[m])
                square = np.sum(((x - self.mean[m]) @ np.linalg.inv(root).T) ** 2, axis=1)
                volume = np.linalg.slogdet(self.basis[m])[1] - np.log(np.diag(root)).sum()
                out[:, m] = (
                    constant + volume - 0.5 * (FREEDOM + d) * np.log1p(square / FREEDOM) + sphere
                )
        with np.errstate(divide="ignore"):
            return out + np.log(self.weight)


@dataclass(frozen=True)
class Blend:
    """Mixtures (of sheets of different kinds) in shares that add to one, as one mixture."""

    parts: tuple[Mixture, ...]
    share: np.ndarray

    def draw(self, n: int, rng: np.random.Generator) -> State:
        """n draws, each part's share of them."""
        counts = np.diff(np.round(np.cumsum([0.0, *self.share]) * n).astype(int))
        return State.joined(
            [part.draw(int(count), rng) for part, count in zip(self.parts, counts, strict=True)]
        )

    def log_densities(self, state: State) -> np.ndarray:
        """Log density (n, m) of each component of all parts times its weight."""
        every = zip(self.parts, self.share, strict=True)
        return np.concatenate(
            [part.log_densities(state) + np.log(share) for part, share in every], axis=1
        )


def monomials(x: np.ndarray, sheet: Sheet) -> np.ndarray:
    """Of bent coordinates (n, D): those along the sheet, and the products of any two of them that bend it."""
    part = x[:, sheet.bending]
    i, j = np.triu_indices(part.shape[1])
    return np.concatenate([x[:, sheet.along], part[:, i] * part[:, j]], axis=1)
