"""Proposal densities of the outer coordinates of a ridge: mixtures of Student laws, straight or bent by a quadratic transform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimate.settings import SamplingSettings
from sunspin.solve.weights import effective_draws

LEAST_PART = 1e-4
"""Share of the draws' weight that a component of a law must have proposed to be kept."""


def monomials(y: np.ndarray, curved: np.ndarray) -> np.ndarray:
    """Return (n, M): one, the coordinates y (n, d), and the products of any two of those with the indices `curved`."""
    i, j = np.triu_indices(len(curved))
    some = y[:, curved]
    return np.concatenate([np.ones((len(y), 1)), y, some[:, i] * some[:, j]], axis=1)


class Bend(NamedTuple):
    """A quadratic transform that makes a thin, curved cloud of points y (d) straight.

    The offset of y along t thin directions is a quadratic function of its coordinates along the f others; the straight point is y
    less this offset. `along` (f, d): gives the f coordinates of y - `centre` (d), each of variance one; `across` (d, t): the thin
    directions; `coefficients` (M, t): offsets per :func:`monomials` of the f coordinates. The transform keeps volumes, since
    `along` times `across` is zero.
    """

    centre: np.ndarray
    across: np.ndarray
    along: np.ndarray
    coefficients: np.ndarray

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return the straight points (n, d) of points y (n, d)."""
        return y - self._offset(y)

    def bent(self, straight: np.ndarray) -> np.ndarray:
        """Return the points y (n, d) of straight points (n, d)."""
        return straight + self._offset(straight)

    def _offset(self, y: np.ndarray) -> np.ndarray:
        """Return the offset (n, d) of points along the thin directions; it is the same for y and for its straight point."""
        free = (y - self.centre) @ self.along.T
        return monomials(free, np.arange(free.shape[1])) @ self.coefficients @ self.across.T

    @classmethod
    def of(cls, y: np.ndarray, weight: np.ndarray, s: SamplingSettings) -> Bend | None:
        """Return the transform of weighted draws y (n, d); None if no thin direction is bent, or if the draws are too few.

        Directions are thin if their variance in the correlation matrix is small. If the regression on the others hardly reduces
        that variance, a direction is not bent: it is moved to the others, and the regression is repeated.
        """
        centre, count = weight @ y, effective_draws(weight)
        off = y - centre
        sigma = np.sqrt(weight @ off**2)
        if not np.all(sigma > 0):
            return None
        # `vector`: principal directions (columns) of the correlation matrix of the coordinates in their sigmas; `size`: sigma along
        # each, one for all if the coordinates are independent; `white` (n, d): draws along them in units of these
        value, vector = np.linalg.eigh((weight[:, None] * off).T @ off / np.outer(sigma, sigma))
        size = np.sqrt(value.clip(1e-12))
        white, root_weight = (off / sigma) @ vector / size, np.sqrt(weight)[:, None]
        thin = size < s.thin
        while thin.any():
            terms = monomials(white[:, ~thin], np.arange(int(np.sum(~thin))))
            if count < s.draws_per_term * terms.shape[1]:
                return None
            weighted = root_weight * terms, root_weight * white[:, thin]
            coefficients = np.linalg.lstsq(*weighted, rcond=1e-10)[0]
            left = weight @ (white[:, thin] - terms @ coefficients) ** 2
            # what is left, by degrees of freedom: of a straight direction hardly less than all, which is one
            unbent = left * count / (count - terms.shape[1]) > s.straight**2
            if not unbent.any():
                # back to the coordinates themselves
                across = vector[:, thin] * (size[thin] * sigma[:, None])
                along = (vector[:, ~thin] / size[~thin] / sigma[:, None]).T
                return cls(centre, across, along, coefficients)
            thin[np.flatnonzero(thin)[unbent]] = False
        return None


class OuterLaw(NamedTuple):
    """A mixture of C Student laws from which outer coordinates (d) are drawn: `weight` (C), `mean` (C, d), `covariance` (C, d, d).

    Means and covariances are those of the straight points of `bend`, if there is one.
    """

    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    bend: Bend | None = None

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return points y (n, d) as the means are given: straight if there is a bend."""
        return y if self.bend is None else self.bend.straight(y)

    def draw(self, n: int, rng: np.random.Generator, freedom: float) -> np.ndarray:
        """Return n draws (n, d), stratified over the components."""
        edges = np.cumsum(self.weight) / self.weight.sum()
        which = np.searchsorted(edges, (np.arange(n) + rng.random()) / n)
        which = np.minimum(which, len(edges) - 1)
        step, _ = student_draws(np.linalg.cholesky(self.covariance)[which], rng, freedom)
        y = self.mean[which] + step
        return y if self.bend is None else self.bend.bent(y)

    def log_densities(self, y: np.ndarray, freedom: float) -> np.ndarray:
        """Return the log density (n, C) of each component times its weight at y (n, d)."""
        root, y = np.linalg.cholesky(self.covariance), self.straight(y)
        # This is called for all draws in each round. A product with the inverse takes a sixth of the time of solving equations.
        parts = [
            student_log_density((y - mean) @ whitening.T, freedom)
            + np.log(np.diag(whitening)).sum()
            for whitening, mean in zip(np.linalg.inv(root), self.mean, strict=True)
        ]
        with np.errstate(divide="ignore"):
            return np.stack(parts, axis=1) + np.log(self.weight / self.weight.sum())

    def moved_to(self, y: np.ndarray, weight: np.ndarray, s: SamplingSettings) -> OuterLaw:
        """Return the law with its components moved to weighted draws y (N, d): a step of expectation and maximisation.

        A draw is divided among the components in proportion to the densities with which they propose it, times its `weight` (N). A
        component takes mean and covariance of its parts. One with hardly any is left out.
        """
        log_densities = self.log_densities(y, s.freedom)
        part = np.exp(log_densities - logsumexp(log_densities, axis=1, keepdims=True))
        part = part * weight[:, None]
        used = np.flatnonzero(part.sum(axis=0) > LEAST_PART)
        part, mean, covariance = part[:, used], self.mean[used], self.covariance[used]
        # means and covariances are of straight points: from those of the former bend to those of the new one
        bend = Bend.of(y, weight, s)
        if self.bend is not None:
            mean = self.bend.bent(mean)
        if bend is not None:
            mean, y = bend.straight(mean), bend.straight(y)
        for i, of_component in enumerate(part.T):
            own = of_component / of_component.sum()
            # fewer than four effective draws for each coordinate move a component less
            learnt = min(1.0, effective_draws(own) / (4.0 * mean.shape[1]))
            mean[i] = learnt * (own @ y) + (1 - learnt) * mean[i]
            off = y - mean[i]
            covariance[i] = learnt * ((own[:, None] * off).T @ off) + (1 - learnt) * covariance[i]
        least = np.einsum("cii,ij->cij", covariance, np.eye(mean.shape[1]))
        return OuterLaw(part.sum(axis=0), mean, covariance + 1e-9 * least, bend)

    @staticmethod
    def joined(parts: Sequence[tuple[float, OuterLaw]]) -> OuterLaw:
        """Return one mixture of several in these shares, all with the bend of the first."""
        weight = np.concatenate([share * law.weight / law.weight.sum() for share, law in parts])
        mean = np.concatenate([law.mean for _, law in parts])
        covariance = np.concatenate([law.covariance for _, law in parts])
        return OuterLaw(weight, mean, covariance, parts[0][1].bend)


def student_draws(
    root: np.ndarray, rng: np.random.Generator, freedom: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return a draw (n, d) about zero of each Student law with the Cholesky factor `root` (n, d, d), and the same in sigmas."""
    n, d = root.shape[:2]
    white = rng.standard_normal((n, d)) * np.sqrt(freedom / rng.chisquare(freedom, n))[:, None]
    return np.einsum("nij,nj->ni", root, white), white


def student_log_density(white: np.ndarray, freedom: float) -> np.ndarray:
    """Return the log density (n) of a Student law at distances (n, d) in sigmas."""
    d = white.shape[1]
    constant = gammaln((freedom + d) / 2) - gammaln(freedom / 2) - d / 2 * np.log(freedom * np.pi)
    return constant - (freedom + d) / 2 * np.log1p((white**2).sum(axis=1) / freedom)
