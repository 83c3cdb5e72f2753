"""How well a vehicle's inertia is known."""

from __future__ import annotations

import numpy as np

from sunspin.dynamics import gyrostat
from sunspin.dynamics.bodies import Bodies
from sunspin.solve.linear import extreme_eigenvalues
from sunspin.vehicle import Vehicle
from sunspin.vehicle.craft import SYMMETRY_TOLERANCE

ASSUMED = 0.01
"""Relative sigma of each moment where the vehicle's file states none: known exactly, they would make any answer too sure; and that
of each product, in units of the mean moment: principal axes are off the body's by a degree or more."""

LEAST_MOMENT = 0.01
"""Least principal moment of a variant with free wheels, as a part of the nominal body's. The rates at a given momentum, and so the
steps of a run, grow with the inverse of the moment: without a bound, few draws would take longer than all others. A normal prior
with a sigma of 100 % has 0.2 % of its mass below it."""


def is_body(bodies: Bodies, nominal: Vehicle | Bodies) -> np.ndarray:
    """Return which variants (n) of a vehicle's body can exist.

    The largest principal moment is at most the sum of the other two. With all wheels free, the least moment is positive: at least
    `LEAST_MOMENT` of that of the `nominal` body.
    """
    moments = extreme_eigenvalues(bodies.inertia_kg_m2)
    others = np.trace(bodies.inertia_kg_m2, axis1=-2, axis2=-1) - moments[1]
    every = [True] * bodies.n_wheels
    free = extreme_eigenvalues(gyrostat.free_inertia(bodies, every))[0]
    least = extreme_eigenvalues(gyrostat.free_inertia(Bodies.of(nominal), every))[0]
    allowed = moments[1] <= others * (1 + SYMMETRY_TOLERANCE)
    return np.asarray(allowed & (free >= LEAST_MOMENT * least))


def stated_sigma(vehicle: Vehicle) -> np.ndarray | None:
    """One sigma (3, 3) of the elements of the tensor, kg m2, if the vehicle's file states it."""
    fact = vehicle.facts.get("body.inertia_kg_m2")
    if fact is None or fact.sigma is None:
        return None
    return np.array(np.broadcast_to(np.asarray(fact.sigma, dtype=np.float64), (3, 3)))


def inertia_errors(vehicle: Vehicle) -> np.ndarray:
    """Changes (m, 3, 3) of the tensor by one sigma of each independent error, kg m2: of each element for which the file states one,
    else of all."""
    tensor, sigma = np.array(vehicle.require_inertia()), stated_sigma(vehicle)
    if sigma is None:
        moments = np.diag(tensor)
        sigma = ASSUMED * np.where(np.eye(3, dtype=bool), np.diag(moments), moments.mean())
    return _one_by_one(sigma)


def _one_by_one(sigma: np.ndarray) -> np.ndarray:
    """Symmetric tensors (m, 3, 3) with one of the elements' sigmas (3, 3) each, those of zero left out."""
    made = []
    for a in range(3):
        for b in range(a, 3):
            if sigma[a, b] > 0:
                error = np.zeros((3, 3))
                error[a, b] = error[b, a] = sigma[a, b]
                made.append(error)
    return np.array(made).reshape(-1, 3, 3)
