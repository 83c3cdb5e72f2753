"""Which changes of columns, panels, wheel signs and sensor axes look the same in the telemetry.

Two changes of a vehicle file are equivalent if a rotation or a mirror M of the body maps what the telemetry has read under the one
onto what it has read under the other: s' = M s for directions, omega' = det(M) M omega for rates and momenta, M Theta M^T for the
inertia. Then no data can tell them apart. One function decides it (`equivalence`); advice, and what is said of columns that
cannot be checked, use it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, islice, permutations, product
from types import MappingProxyType

import numpy as np
import xarray as xr

from sunspin.estimate.inertia import ASSUMED, inertia_errors
from sunspin.telemetry.gains import prior_sigmas
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

CLEARLY = 10.0
"""Log evidence by which a change, or a pass without one of its sensors, must be better before that is named. Changes are equivalent
if what the file states must be off by no more than this costs."""

ALIKE = 0.01
"""Difference of two unit normals without a stated sigma that costs `CLEARLY`: 40 samples of 1 % noise tell more than that."""

AXES_ALIKE = 0.05
"""Largest difference of two matrices of axes that are the same axes."""

LIT_SHARE, LIT_SAMPLES, BRIGHTEST = 0.15, 2, 0.9
"""A panel was lit if so many samples exceed this share of full Sun: more than the Earth's light on a dark side often is. If the
gains have no unit full Sun is this quantile of the largest reading of a sample."""

WHEEL_SIGMA, WEAK_RAD = 0.02, 0.05
"""Relative sigma of a wheel's momentum and direction; and wheels that turn a rate by less than this (rad) in the whole file are
not seen."""

SAME_WAY = 0.01
"""One less the cosine between normals that may be mirror images of each other; `equivalence` decides."""

FLAT = 0.05
"""Smallest singular value of the normals of lit panels, as a share of the largest, below which they lie in one plane."""

MOST_ASSIGNMENTS = 1000
"""Assignments of the panels of shared inputs to each other that are tried."""

READINGS = ("power_W", "current_A")
"""What telemetry calls the readings of panels."""


@dataclass(frozen=True)
class Change:
    """One way in which columns, signs or axes of a vehicle file may be wrong.

    `what`: in words; `columns`: input k reads the column `columns[k]`, as the file states it where empty; `reversed_panels`,
    `reversed_wheels`: numbers of panels and wheels with the opposite normal or axis; `axes`: variable of telemetry -> matrix (3, 3)
    by which its readings are multiplied; `do`: what to write in the file, in words; `errors`: mistakes that it supposes.
    """

    what: str
    columns: tuple[int, ...] = ()
    reversed_panels: tuple[int, ...] = ()
    reversed_wheels: tuple[int, ...] = ()
    axes: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    do: str = ""
    errors: int = 1

    def applied(self, vehicle: Vehicle, telemetry: xr.Dataset) -> tuple[Vehicle, xr.Dataset]:
        """Vehicle and telemetry as they are if the file is wrong in this way."""
        if self.reversed_panels:
            turned = (
                replace(p, normal_B=-p.normal_B) if k in self.reversed_panels else p
                for k, p in enumerate(vehicle.panels)
            )
            vehicle = replace(vehicle, panels=tuple(turned))
        if self.reversed_wheels:
            turned = (
                replace(w, axis_B=-w.axis_B) if k in self.reversed_wheels else w
                for k, w in enumerate(vehicle.wheels)
            )
            vehicle = replace(vehicle, wheels=tuple(turned))
        for name in READINGS if self.columns else ():
            if name in telemetry:
                value = telemetry[name].transpose("time", "panel")
                telemetry = telemetry.assign(
                    {name: (value.dims, value.values[:, list(self.columns)], value.attrs)}
                )
        for name, matrix in self.axes.items():
            value = telemetry[name]
            telemetry = telemetry.assign({name: (value.dims, value.values @ matrix.T, value.attrs)})
        return vehicle, telemetry


AS_WRITTEN = Change("the file as it is written", errors=0)
"""No change."""


def exchange(vehicle: Vehicle, a: int, b: int) -> Change:
    """The columns of two inputs exchanged."""
    order = list(range(len(vehicle.inputs)))
    order[a], order[b] = b, a
    names = vehicle.input_names
    do = f"exchange the columns of {names[a]} and {names[b]} under [telemetry.columns] of the vehicle file"
    return Change(
        f"the columns of panels {names[a]} and {names[b]} exchanged", columns=tuple(order), do=do
    )


def column_changes(vehicle: Vehicle, telemetry: xr.Dataset) -> list[Change]:
    """Each pair of inputs exchanged, and each panel with an input of its own reversed; none without readings of panels."""
    if not any(name in telemetry for name in READINGS):
        return []
    pairs = [exchange(vehicle, a, b) for a, b in combinations(range(len(vehicle.inputs)), 2)]
    alone = sorted(one.panels[0] for one in vehicle.inputs if len(one.panels) == 1)
    names = vehicle.panel_names
    return pairs + [
        Change(
            f"panel {names[k]} looking the other way",
            reversed_panels=(k,),
            do=f"reverse normal_B of panel {names[k]}",
        )
        for k in alone
    ]


@dataclass(frozen=True)
class Observed:
    """What a telemetry file has read, as far as it tells changes apart.

    `lit` (n_input): columns that were in sunlight; `momenta` (n_wheel, n, 3): of each wheel as stated, in mean moments of inertia
    times rad/s; `span_s`: length of the file; `sensors`: variables of other sensors that were read; `in_orbit`: elements make the
    Sun and the field known in space; `sun_B` (n, 3): the Sun's directions of the motion estimated under `estimated_with`, empty
    where none is known; `panels`: the panels were used.
    """

    vehicle: Vehicle
    lit: np.ndarray
    momenta: np.ndarray = field(default_factory=lambda: np.zeros((0, 1, 3)))
    span_s: float = 0.0
    sensors: frozenset[str] = frozenset()
    in_orbit: bool = False
    sun_B: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))
    panels: bool = True

    @classmethod
    def of(cls, vehicle: Vehicle, telemetry: xr.Dataset, **more) -> Observed:
        """That of `read_telemetry`."""
        name = next((one for one in READINGS if one in telemetry), None)
        lit = np.zeros(len(vehicle.inputs), dtype=bool)
        if name is not None:
            share = (
                np.nan_to_num(telemetry[name].transpose("time", "panel").values)
                / vehicle.input_gains
            )
            known = vehicle.gain_unit == name[-1] or not len(share)
            bright = 1.0 if known else max(float(np.quantile(share.max(axis=1), BRIGHTEST)), 1e-300)
            lit = (share > LIT_SHARE * bright).sum(axis=0) >= LIT_SAMPLES
        read = ("gyro_B", "field_B", "attitude_B_from_N", "sun_sensor_B")
        known = frozenset(
            one for one in read if one in telemetry and bool(telemetry[one].notnull().any())
        )
        span = float(np.ptp(telemetry["time"].values)) if telemetry.sizes.get("time") else 0.0
        return cls(vehicle, lit, span_s=span, sensors=known, panels=name is not None, **more)

    @cached_property
    def free_scale(self) -> bool:
        """Whether only the ratios of the gains count."""
        return self.vehicle.throttled or self.vehicle.gain_unit is None


def equivalence(observed: Observed, first: Change, second: Change) -> np.ndarray:
    """Rotations and mirrors of the body (m, 3, 3) by which two changes look the same in the telemetry, the best first; none
    (0, 3, 3) where the data tell them apart.

    With such an M, directions under the second change are M times those under the first, and rates det(M) M times.
    `observed.sun_B` is that of a motion under the first change.
    """
    if first.axes.get("attitude_B_from_N") is not second.axes.get("attitude_B_from_N"):
        return np.zeros((0, 3, 3))
    kept: list[tuple[float, np.ndarray]] = []
    for m, cost in _panel_maps(observed, first, second):
        if (
            cost > CLEARLY
            or not _sensors_agree(observed, first, second, m)
            or not _stays_dark(observed, second, m)
        ):
            continue
        cost += _inertia_cost(observed.vehicle, m) + _wheel_cost(observed, first, second, m)
        if cost <= CLEARLY and all(np.abs(m - other).max() > AXES_ALIKE for _, other in kept):
            kept.append((cost, m))
    kept.sort(key=lambda one: one[0])
    return np.array([m for _, m in kept]).reshape(-1, 3, 3)


def rate_under(matrix: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Rates (..., 3) as a rotation or mirror of the body (3, 3) shows them."""
    return np.linalg.det(matrix) * (omega @ matrix.T)


def alike(
    observed: Observed, first: Change, others: Sequence[Change]
) -> list[tuple[Change, np.ndarray]]:
    """Those of the changes that look the same as the first, with the best M (3, 3) of each."""
    maps = [(one, equivalence(observed, first, one)) for one in others]
    return [(one, each[0]) for one, each in maps if len(each)]


def unseen_changes(observed: Observed, telemetry: xr.Dataset) -> list[tuple[Change, np.ndarray]]:
    """Changes of columns and panels that look the same as the file as it is written but show another motion, with the M (3, 3)
    of each: those of one mistake, else those with the fewest exchanges."""
    singles = column_changes(observed.vehicle, telemetry)
    if not singles:
        return []
    for level in (singles, symmetric_exchanges(observed.vehicle)):
        same = [(change, m) for change, m in alike(observed, AS_WRITTEN, level) if _moves(m)]
        if same:
            return [
                (change, m)
                for change, m in same
                if change.errors == min(one.errors for one, _ in same)
            ]
    return []


def columns_seen(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Whether panels alone tell which column is which: no change of columns looks the same. Wheels count at their nominal speed."""
    momenta = np.zeros((0, 1, 3))
    if vehicle.inertia_kg_m2 is not None:
        unit = np.trace(vehicle.inertia_kg_m2) / 3
        each = [
            w.inertia_kg_m2 * w.speed_rad_s / unit * np.asarray(w.axis_B) for w in vehicle.wheels
        ]
        momenta = np.array(each).reshape(-1, 1, 3)
    observed = replace(Observed.of(vehicle, telemetry, momenta=momenta), sensors=frozenset())
    return not unseen_changes(observed, telemetry)


def _moves(matrix: np.ndarray) -> bool:
    """Whether rates change by a map."""
    return bool(np.abs(np.linalg.det(matrix) * matrix - np.eye(3)).max() > AXES_ALIKE)


def symmetric_exchanges(vehicle: Vehicle) -> list[Change]:
    """Pairs of columns exchanged together, as a mirror that maps the normals of all panels onto each other exchanges them, or two
    such mirrors at right angles; none for panels that share inputs."""
    if any(len(one.panels) > 1 for one in vehicle.inputs):
        return []
    normals, count = np.array(vehicle.panel_normals_B), len(vehicle.panels)

    def order_of(m: np.ndarray) -> tuple[int, ...] | None:
        near = normals @ (normals @ m.T).T
        order = near.argmax(axis=0)
        fits = (
            near.max(axis=0).min(initial=1.0) > 1 - SAME_WAY and len(set(order.tolist())) == count
        )
        return tuple(order.tolist()) if fits else None

    mirrors: list[np.ndarray] = []
    for a, b in combinations(range(count), 2):
        apart = normals[a] - normals[b]
        if (size := float(apart @ apart)) > 1e-6 and order_of(
            m := np.eye(3) - 2 * np.outer(apart, apart) / size
        ) is not None:
            mirrors += [] if any(np.abs(m - other).max() < AXES_ALIKE for other in mirrors) else [m]
    turns = [a @ b for a, b in combinations(mirrors, 2) if np.abs(a @ b - b @ a).max() < AXES_ALIKE]
    found: dict[tuple[int, ...], Change] = {}
    for order in filter(None, map(order_of, [*mirrors, *turns])):
        pairs = [exchange(vehicle, a, b).what for a, b in enumerate(order) if a < b]
        found[order] = Change(", and ".join(pairs), columns=order, errors=len(pairs))
    return list(found.values())


def _panels_of(observed: Observed, change: Change) -> list[tuple[int, ...]]:
    """Panels whose light each column shows under a change: the readings of column `columns[k]` belong to input k."""
    inputs, columns = (
        observed.vehicle.inputs,
        change.columns or tuple(range(len(observed.vehicle.inputs))),
    )
    shown: list[tuple[int, ...]] = [()] * len(inputs)
    for k, column in enumerate(columns):
        shown[column] = inputs[k].panels
    return shown


def _normals(observed: Observed, change: Change) -> np.ndarray:
    normals = np.array(observed.vehicle.panel_normals_B)
    normals[list(change.reversed_panels)] *= -1
    return normals


def _panel_maps(
    observed: Observed, first: Change, second: Change
) -> Iterator[tuple[np.ndarray, float]]:
    """Orthogonal matrices that may map the panels of lit columns under the first change onto those under the second, each with the
    log evidence that gains and normals cost."""
    vehicle = observed.vehicle
    if not observed.panels:
        for m in _any_maps(observed):
            yield m, 0.0
        return
    lit = np.flatnonzero(observed.lit)
    own, other = _panels_of(observed, first), _panels_of(observed, second)
    if any(len(own[k]) != len(other[k]) for k in lit) or not len(lit):
        return
    sums = {one.panels: one.largest for one in vehicle.inputs}
    if any(len(own[k]) > 1 and sums[own[k]] != sums[other[k]] for k in lit):
        return
    from_normals, to_normals = _normals(observed, first), _normals(observed, second)
    sigma = np.hypot(misalignment_sigma(vehicle)[0], ALIKE / np.sqrt(2 * CLEARLY) / np.sqrt(2))
    gain_sigma = np.zeros(len(vehicle.panels))
    for one, value in zip(vehicle.inputs, prior_sigmas(vehicle), strict=True):
        gain_sigma[list(one.panels)] = value
    a = [k for column in lit for k in own[column]]
    log_gain = np.log(vehicle.panel_gains)
    for assigned in islice(
        product(*(permutations(other[column]) for column in lit)), MOST_ASSIGNMENTS
    ):
        b = [k for panels in assigned for k in panels]
        gains = log_gain[a] - log_gain[b]
        weight = 1 / (gain_sigma[a] ** 2 + gain_sigma[b] ** 2)
        gains = gains - (np.average(gains, weights=weight) if observed.free_scale else 0.0)
        gain_cost = float(weight @ gains**2) / 2
        if gain_cost > CLEARLY:
            continue
        for m in _procrustes(observed, from_normals[a], to_normals[b]):
            off = np.linalg.norm(from_normals[a] @ m.T - to_normals[b], axis=1)
            cost = gain_cost + float((off**2 / (sigma[a] ** 2 + sigma[b] ** 2)).sum()) / 2
            if cost <= CLEARLY:
                yield m, cost


def _procrustes(observed: Observed, start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """Orthogonal matrices that map unit vectors (n, 3) best onto others: one where they span space, two where they lie in a plane,
    and where they lie on a line those that carry axes of the body to each other too."""
    u, size, v = np.linalg.svd(end.T @ start)
    if size[2] > FLAT * size[0]:
        yield u @ v
    elif size[1] > FLAT * size[0]:
        for side in (1.0, -1.0):
            yield u @ np.diag([1.0, 1.0, side]) @ v
    else:
        for m in _any_maps(observed):
            turned = u[:, :1] @ v[:1] + (np.eye(3) - u[:, :1] @ u[:, :1].T) @ m @ (
                np.eye(3) - v[:1].T @ v[:1]
            )
            left, sizes, right = np.linalg.svd(turned)
            if sizes[2] > FLAT:
                yield left @ right


def _any_maps(observed: Observed) -> Iterator[np.ndarray]:
    """Signed permutations of the principal axes of the body."""
    inertia = observed.vehicle.inertia_kg_m2
    frame = np.eye(3) if inertia is None else np.linalg.eigh(inertia)[1]
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            yield frame @ (np.eye(3)[list(order)] * np.array(sign)[:, None]) @ frame.T


def _stays_dark(observed: Observed, second: Change, m: np.ndarray) -> bool:
    """Whether panels whose columns were never lit face away from the Sun under the second change too."""
    dark = np.flatnonzero(~observed.lit)
    if not observed.panels or not len(dark) or not len(observed.sun_B):
        return True
    shown = _panels_of(observed, second)
    panels = [k for column in dark for k in shown[column]]
    light = observed.sun_B @ m.T @ _normals(observed, second)[panels].T
    return bool(((light > 2 * LIT_SHARE).sum(axis=0) < LIT_SAMPLES).all())


def _inertia_cost(vehicle: Vehicle, m: np.ndarray) -> float:
    """Log evidence that M Theta M^T costs in place of Theta; nothing where the inertia is not known."""
    if vehicle.inertia_kg_m2 is None:
        return 0.0
    tensor = np.array(vehicle.inertia_kg_m2)
    errors = inertia_errors(vehicle)
    sigma = np.maximum(np.abs(errors).max(axis=0, initial=0.0), 1e-6 * np.trace(tensor))
    square = ((m @ tensor @ m.T - tensor) / sigma) ** 2
    return float(square[np.triu_indices(3)].sum()) / 2


def _wheel_cost(observed: Observed, first: Change, second: Change, m: np.ndarray) -> float:
    """Log evidence that the wheels cost: their momentum, det(M) M times, must be that under the second change."""
    if not len(observed.momenta) or observed.vehicle.inertia_kg_m2 is None:
        return 0.0
    own, other = (np.ones(len(observed.momenta)) for _ in range(2))
    own[list(first.reversed_wheels)] = -1
    other[list(second.reversed_wheels)] = -1
    before, after = (np.einsum("w,wni->ni", sign, observed.momenta) for sign in (own, other))
    off = float(np.linalg.norm(rate_under(m, before) - after, axis=1).max(initial=0.0))
    if off / 2 * observed.span_s < WEAK_RAD:
        return 0.0
    size = float(np.linalg.norm(observed.momenta, axis=2).max(initial=0.0))
    return float((off / (max(WHEEL_SIGMA, ASSUMED) * size)) ** 2) / 2


def _sensors_agree(observed: Observed, first: Change, second: Change, m: np.ndarray) -> bool:
    """Whether the other sensors that were read fit both changes."""
    side = float(np.linalg.det(m))
    dipole = observed.vehicle.sensors.disturbance.dipole
    for name in observed.sensors:
        own, other = (change.axes.get(name, np.eye(3)) for change in (first, second))
        if name == "attitude_B_from_N":
            ways: list[np.ndarray] = [np.eye(3)] if np.abs(m - np.eye(3)).max() < AXES_ALIKE else []
        elif name == "gyro_B":
            ways = [side * m @ own]
        elif name == "sun_sensor_B":
            ways = [m @ own]
        else:  # the field: in space it is known only from elements
            ways = (
                [m @ own]
                if observed.in_orbit and side > 0
                else []
                if observed.in_orbit
                else [m @ own, -m @ own]
            )
            if dipole is not None:  # its torque pulls another way
                off = min(np.linalg.norm(m @ dipole - sign * dipole) for sign in (1.0, -1.0))
                ways = ways if off <= AXES_ALIKE * np.linalg.norm(dipole) else []
        if all(np.abs(way - other).max() > AXES_ALIKE for way in ways):
            return False
    return True
