"""Proposal densities of the outer coordinates of a ridge: mixtures of Student distributions, straight or bent.

A quadratic transform bends the draws of a mixture onto a thin, curved cloud of points.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.special import gammaln, logsumexp

from sunspin.estimate.settings import SamplingSettings
from sunspin.solve.weights import effective_draws

LEAST_PART = 1e-4
"""Share of the draws' weight that a component of a mixture must have proposed to be kept."""


def monomials(y: np.ndarray, curved: np.ndarray) -> np.ndarray:
    """Return the terms (n, M) of a polynomial of y (n, d): one, y, and the products (and squares) of the coordinates `curved`."""
    i, j = np.triu_indices(len(curved))
    factors = y[:, curved]
    return np.concatenate([np.ones((len(y), 1)), y, factors[:, i] * factors[:, j]], axis=1)


class QuadraticTransform(NamedTuple):
    """A change of coordinates that straightens a thin, curved cloud of points y (d).

    In t thin directions the points follow a quadratic function of their f = d - t other coordinates. The straight point is y less
    the value of that function. `to_free` (f, d) gives the f coordinates of y - `centre` (d), each of variance one; `thin_axes`
    (d, t): the thin directions; `coefficients` (M, t): of the function, by :func:`monomials` of the f coordinates. The transform
    keeps volumes, since `to_free` times `thin_axes` is zero.
    """

    centre: np.ndarray
    thin_axes: np.ndarray
    to_free: np.ndarray
    coefficients: np.ndarray

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return the straight points (n, d) of points y (n, d)."""
        return y - self._offset(y)

    def bent(self, straight: np.ndarray) -> np.ndarray:
        """Return the points y (n, d) of straight points (n, d): the inverse of :meth:`straight`."""
        return straight + self._offset(straight)

    def _offset(self, points: np.ndarray) -> np.ndarray:
        """Return the value (n, d) of the quadratic function at points (n, d); it is the same at y and at its straight point."""
        free = (points - self.centre) @ self.to_free.T
        return monomials(free, np.arange(free.shape[1])) @ self.coefficients @ self.thin_axes.T

    @classmethod
    def of(
        cls, y: np.ndarray, weight: np.ndarray, settings: SamplingSettings
    ) -> QuadraticTransform | None:
        """Return the transform that straightens draws y (n, d) with weights (n) of sum one.

        It is None if the draws are not curved in any thin direction, or too few for the regression. Thin are the principal
        directions of the correlation matrix with a small variance. If a quadratic in the other directions hardly reduces the
        variance in a thin one, that direction counts among the others, and the regression is repeated.
        """
        centre, count = weight @ y, effective_draws(weight)
        off = y - centre
        sigma = np.sqrt(weight @ off**2)
        if not np.all(sigma > 0):
            return None
        correlation = (weight[:, None] * off).T @ off / np.outer(sigma, sigma)
        variance, directions = np.linalg.eigh(correlation)  # directions are columns
        # sigma along each direction; it would be one for all if the coordinates were independent
        size = np.sqrt(variance.clip(1e-12))
        white = (off / sigma) @ directions / size  # (n, d), of unit variance along each direction
        root_weight = np.sqrt(weight)[:, None]
        thin = size < settings.thin
        while thin.any():
            terms = monomials(white[:, ~thin], np.arange(int(np.sum(~thin))))
            if count < settings.draws_per_term * terms.shape[1]:
                return None
            weighted = root_weight * terms, root_weight * white[:, thin]
            coefficients = np.linalg.lstsq(*weighted, rcond=1e-10)[0]
            left = weight @ (white[:, thin] - terms @ coefficients) ** 2
            # variance that is left of one, corrected for the degrees of freedom that the regression uses
            not_curved = left * count / (count - terms.shape[1]) > settings.straight**2
            if not not_curved.any():
                # from the white coordinates back to y
                thin_axes = directions[:, thin] * (size[thin] * sigma[:, None])
                to_free = (directions[:, ~thin] / size[~thin] / sigma[:, None]).T
                return cls(centre, thin_axes, to_free, coefficients)
            thin[np.flatnonzero(thin)[not_curved]] = False
        return None


class StudentMixture(NamedTuple):
    """A mixture of C Student distributions from which outer coordinates y (d) are drawn.

    `weight` (C), which need not add to one; `mean` (C, d); `covariance` (C, d, d): the scale matrices. With a `transform` means and
    covariances are those of straight points.
    """

    weight: np.ndarray
    mean: np.ndarray
    covariance: np.ndarray
    transform: QuadraticTransform | None = None

    def straight(self, y: np.ndarray) -> np.ndarray:
        """Return points y (n, d) in the coordinates of the means: straight ones if there is a transform."""
        return y if self.transform is None else self.transform.straight(y)

    def draw(self, n: int, rng: np.random.Generator, freedom: float) -> np.ndarray:
        """Return n draws (n, d) with `freedom` degrees of freedom, each component getting its share of them (stratified)."""
        edges = np.cumsum(self.weight) / self.weight.sum()
        component = np.searchsorted(edges, (np.arange(n) + rng.random()) / n)
        component = np.minimum(component, len(edges) - 1)
        step, _ = student_draws(np.linalg.cholesky(self.covariance)[component], rng, freedom)
        y = self.mean[component] + step
        return y if self.transform is None else self.transform.bent(y)

    def log_densities(self, y: np.ndarray, freedom: float) -> np.ndarray:
        """Return the log of each component's part (n, C) in the density at y (n, d); the density is the sum of the parts."""
        root, y = np.linalg.cholesky(self.covariance), self.straight(y)
        # This is called for all draws in each round. A product with the inverse takes a sixth of the time of solving equations.
        parts = [
            student_log_density((y - mean) @ whitening.T, freedom)
            + np.log(np.diag(whitening)).sum()
            for whitening, mean in zip(np.linalg.inv(root), self.mean, strict=True)
        ]
        with np.errstate(divide="ignore"):
            return np.stack(parts, axis=1) + np.log(self.weight / self.weight.sum())

    def adapted(
        self, y: np.ndarray, weight: np.ndarray, settings: SamplingSettings
    ) -> StudentMixture:
        """Return the mixture adapted to draws y (N, d) with weights (N) of sum one, by one step of expectation and maximisation.

        Each draw is shared by the components in proportion to their densities at y. A component takes mean and covariance of its
        shares, the latter as scale matrix; one with hardly any share is left out. The transform is fitted to the draws again.
        """
        log_densities = self.log_densities(y, settings.freedom)
        # (N, C) weight of each draw in each component
        part = np.exp(log_densities - logsumexp(log_densities, axis=1, keepdims=True))
        part = part * weight[:, None]
        used = np.flatnonzero(part.sum(axis=0) > LEAST_PART)
        part, mean, covariance = part[:, used], self.mean[used], self.covariance[used]
        # put the old means into the straight coordinates of the new transform; the covariances are not changed by it
        transform = QuadraticTransform.of(y, weight, settings)
        if self.transform is not None:
            mean = self.transform.bent(mean)
        if transform is not None:
            mean, y = transform.straight(mean), transform.straight(y)
        for i, of_component in enumerate(part.T):
            own = of_component / of_component.sum()
            # with fewer than four effective draws for each coordinate, old and new values are averaged
            learnt = min(1.0, effective_draws(own) / (4.0 * mean.shape[1]))
            mean[i] = learnt * (own @ y) + (1 - learnt) * mean[i]
            off = y - mean[i]
            covariance[i] = learnt * ((own[:, None] * off).T @ off) + (1 - learnt) * covariance[i]
        # a billionth of each variance more keeps the matrices positive definite
        variances = np.einsum("cii,ij->cij", covariance, np.eye(mean.shape[1]))
        return StudentMixture(part.sum(axis=0), mean, covariance + 1e-9 * variances, transform)

    @staticmethod
    def joined(parts: Sequence[tuple[float, StudentMixture]]) -> StudentMixture:
        """Return one mixture of several, each with its share of the weight; all take the transform of the first."""
        weights = [share * mixture.weight / mixture.weight.sum() for share, mixture in parts]
        mean = np.concatenate([mixture.mean for _, mixture in parts])
        covariance = np.concatenate([mixture.covariance for _, mixture in parts])
        return StudentMixture(np.concatenate(weights), mean, covariance, parts[0][1].transform)


def student_draws(
    root: np.ndarray, rng: np.random.Generator, freedom: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return one draw (n, d) about zero from each Student distribution, and the same draws in sigmas, without `root`.

    `root` (n, d, d): Cholesky factors of their scale matrices.
    """
    n, d = root.shape[:2]
    white = rng.standard_normal((n, d)) * np.sqrt(freedom / rng.chisquare(freedom, n))[:, None]
    return np.einsum("nij,nj->ni", root, white), white


def student_log_density(white: np.ndarray, freedom: float) -> np.ndarray:
    """Return the log density (n) of the Student distribution with unit scale matrix at points `white` (n, d)."""
    d = white.shape[1]
    constant = gammaln((freedom + d) / 2) - gammaln(freedom / 2) - d / 2 * np.log(freedom * np.pi)
    return constant - (freedom + d) / 2 * np.log1p((white**2).sum(axis=1) / freedom)
