"""First contact with the ground, and the facet on which the vehicle comes to rest: the convex hull of its parts and a plane.

The support function of a set of points is S(d) = max over its points x of x.d. It is the reach of the vehicle from its centre of
mass in the direction d. With d straight down it is the height of the centre of mass over flat ground at contact.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

from sunspin.base.errors import InputError
from sunspin.vehicle import Vehicle

KINDS = ("leg", "panel", "body")
"""Part to which a point of the shape belongs; a corner that panels share with the bare body counts as panel."""

LEG, PANEL, BODY = range(3)
"""Indices in `KINDS`."""

COPLANAR = 1e-6
"""Two facets are one if their normals, and their distances over the size of the shape, differ by less than this."""

REFINE = 16
"""Number of instants at which the sampling interval of the first contact is searched."""


@dataclass(frozen=True)
class Shape:
    """Points that can touch the ground, and the facets of their convex hull.

    Attributes
    ----------
    points_B_m : (n_point, 3) m from the centre of mass, body axes.
    kind : (n_point) index in `KINDS`.
    leg : (n_point) number of the leg whose end the point is, or -1.
    panels : (n_point, n_panel) True if the point is a corner of that panel.
    outward_B, distances_m : outward unit vectors (n_facet, 3) of the facets and their distances (n_facet) from the centre of mass;
        None if the hull has no volume around the centre of mass.
    facet_kind : (n_facet) index in `KINDS` of the part on which the vehicle rests: "leg" if on ends of legs only, "panel" if a
        corner of a panel takes part; None as above.
    complete : False if the vehicle file gives no hull, so that the points are the ends of the legs only.
    """

    points_B_m: np.ndarray
    kind: np.ndarray
    leg: np.ndarray
    panels: np.ndarray
    outward_B: np.ndarray | None
    distances_m: np.ndarray | None
    facet_kind: np.ndarray | None
    complete: bool

    @property
    def reach_m(self) -> float:
        """Largest distance of a point from the centre of mass."""
        return float(np.linalg.norm(self.points_B_m, axis=1).max())


def build_shape(vehicle: Vehicle) -> Shape | None:
    """Return the shape of a vehicle, from the parts of its hull and the ends of its legs; None if the file gives neither.

    Points that agree to 1e-9 m are one point, which can belong to a leg and to several panels.
    """
    entries: dict[
        tuple, dict
    ] = {}  # point -> number of its leg (-1: none), and numbers of its panels
    for part in vehicle.hull:
        for point in part.points_B_m:
            entry = entries.setdefault(tuple(np.round(point, 9)), {"leg": -1, "panels": set()})
            if part.panel is not None:
                entry["panels"].add(vehicle.panel_names.index(part.panel))
    for k, leg in enumerate(vehicle.legs):
        entries.setdefault(tuple(np.round(leg.tip_B_m, 9)), {"panels": set()})["leg"] = k
    if not entries:
        return None
    points = np.array(list(entries))
    legs = np.array([entry["leg"] for entry in entries.values()])
    panels = np.zeros((len(points), len(vehicle.panels)), dtype=bool)
    for row, entry in zip(panels, entries.values(), strict=True):
        row[list(entry["panels"])] = True
    kind = np.where(legs >= 0, LEG, np.where(panels.any(axis=1), PANEL, BODY))
    return Shape(points, kind, legs, panels, *_facets(points, kind), bool(vehicle.hull))


def _facets(
    points: np.ndarray, kind: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray] | tuple[None, None, None]:
    """Return outward normals (n_facet, 3), distances (n_facet) and kinds (n_facet) of the hull's facets.

    All are None if the hull has no volume, or if the centre of mass (the origin) is not inside.
    """
    try:
        # rows (normal, offset) of each triangle: normal . x + offset <= 0 inside
        equations = ConvexHull(points).equations
    except QhullError:
        return None, None, None
    size = np.linalg.norm(points, axis=1).max()
    if np.any(equations[:, 3] >= -COPLANAR * size):
        return None, None, None
    # triangles in one plane are one facet: their rows are equal in the grid of 10 COPLANAR
    _, first = np.unique(np.round(equations / COPLANAR / 10), axis=0, return_index=True)
    facets = equations[np.sort(first)]
    outward, distances = facets[:, :3], -facets[:, 3]
    # points in the plane of a facet, with a margin of ten grid steps
    is_corner = np.abs(points @ outward.T - distances) < 100 * COPLANAR * size  # (point, facet)
    facet_kind = []
    for corner_kinds in (kind[corners] for corners in is_corner.T):
        if np.all(corner_kinds == LEG):
            facet_kind.append(LEG)
        else:
            facet_kind.append(PANEL if np.any(corner_kinds == PANEL) else BODY)
    return outward, distances, np.array(facet_kind)


def support(points_B_m: np.ndarray, direction_B: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the support function S(d) in m (...), and the number of the point that reaches it (...).

    If several points do, it is the first.

    Parameters
    ----------
    points_B_m : (n_point, 3) m
    direction_B : (..., 3) unit vectors d
    """
    heights = direction_B @ points_B_m.T
    index = np.argmax(heights, axis=-1)
    return np.take_along_axis(heights, index[..., None], axis=-1)[..., 0], index


def is_leg_lowest(shape: Shape, up_B: np.ndarray) -> np.ndarray:
    """Return whether the lowest point of the shape is the end of a leg, for the ground's normal up_B (..., 3)."""
    _, lowest = support(shape.points_B_m, -up_B)
    return shape.kind[lowest] == LEG


def rest_facet(shape: Shape, up_B: np.ndarray) -> np.ndarray:
    """Return the facet (n) on which a vehicle comes to rest that is set down with the ground's normal at up_B (n, 3).

    The vehicle rolls without speed. The plumb line from the centre of mass meets one facet, onto which the vehicle tips. This is
    repeated until the foot of the perpendicular on the facet lies inside it. Each step lowers the centre of mass, so that the
    iteration ends: if the plumb line meets facet g while the vehicle rests on facet f, then d_g <= d_f n_g.n_f < d_f.
    """
    outward, distances = shape.outward_B, shape.distances_m
    if outward is None or distances is None:
        raise InputError(
            "this shape has no facet to rest on",
            do="give a hull with a volume around the centre of mass",
        )
    down = -up_B
    facet = np.full(len(up_B), -1)
    for _ in range(len(distances) + 1):
        met = np.argmax(down @ outward.T / distances, axis=1)  # facet that the plumb line meets
        if np.array_equal(met, facet):
            break
        facet, down = met, outward[met]
    return facet


@dataclass(frozen=True)
class Contact:
    """First contact with flat ground: time (n) s, number of the point (n), ground's normal (n, 3) and body rate (n, 3) rad/s."""

    t_s: np.ndarray
    point: np.ndarray
    up_B: np.ndarray
    omega_B: np.ndarray


def first_contact(
    shape: Shape, t_s: np.ndarray, up_B: np.ndarray, omega_B: np.ndarray, approach_m_s: np.ndarray
) -> Contact:
    """Return the first contact with flat ground of each of n vehicles that rotate while they descend.

    Within the sampling interval in which the lowest point first passes the plane, the contact is searched at `REFINE` instants. The
    normal is interpolated between samples by cubic Hermite polynomials, with du/dt = u x omega.

    Parameters
    ----------
    t_s : (n_t,)
        Instants, increasing; at the last one the centre of mass would reach the plane.
    up_B : (n, n_t, 3)
        The ground's normal in body axes at these instants.
    omega_B : (n, n_t, 3) rad/s
    approach_m_s : (n,)
        Speed of the centre of mass towards the plane, taken as constant: the gravity of a comet would change the path by
        millimetres.

    Samples must be so close that the vehicle rotates by a fraction of a radian in between.
    """
    rows = np.arange(len(up_B))
    height = approach_m_s[:, None] * (t_s[-1] - t_s)  # of the centre of mass over the plane
    reach, _ = support(
        shape.points_B_m, -up_B
    )  # depth of the lowest point below the centre of mass
    # first sample (n) at which the lowest point is in or below the plane; the interval before it is searched
    after = np.maximum(np.argmax(height <= reach, axis=1), 1)
    before = after - 1
    span = t_s[after] - t_s[before]
    s = np.linspace(0.0, 1.0, REFINE + 1)[:, None]  # share of the interval
    u0, u1 = up_B[rows, before][:, None], up_B[rows, after][:, None]
    w0, w1 = omega_B[rows, before][:, None], omega_B[rows, after][:, None]
    slope0, slope1 = (np.cross(u, w) * span[:, None, None] for u, w in ((u0, w0), (u1, w1)))
    # cubic Hermite polynomials of the normal, normalised
    up = (
        u0 * (1 + 2 * s) * (1 - s) ** 2
        + slope0 * s * (1 - s) ** 2
        + u1 * s**2 * (3 - 2 * s)
        - slope1 * s**2 * (1 - s)
    )
    up /= np.linalg.norm(up, axis=-1, keepdims=True)
    t = t_s[before][:, None] + span[:, None] * s[:, 0]
    reach, point = support(shape.points_B_m, -up)
    hit = np.argmax(approach_m_s[:, None] * (t_s[-1] - t) <= reach, axis=1)
    omega = w0[:, 0] + (w1 - w0)[:, 0] * s[hit]
    return Contact(t[rows, hit], point[rows, hit], up[rows, hit], omega)
