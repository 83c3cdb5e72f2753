"""Which changes of columns, panels, wheel signs and sensor axes look the same in the telemetry.

Two changes of a vehicle file are equivalent if a rotation or a mirror M of the body maps the readings under the one onto those
under the other. That is s' = M s for directions, omega' = det(M) M omega for rates and momenta, and M Theta M^T for the inertia.
Then no data distinguish them. One function decides it, :func:`equivalence`: normals of lit panels propose matrices M (Procrustes),
which other sensors, dark panels, inertia and wheels may refuse. Stated errors allow small differences, at a cost in log evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, islice, permutations, product
from types import MappingProxyType

import numpy as np
import xarray as xr

from sunspin.estimate.model import Body
from sunspin.estimate.settings import INERTIA
from sunspin.telemetry.gains import prior_sigmas
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

CLEARLY = 10.0
"""Log evidence by which a change must be better before it is named. Changes are equivalent if the errors of the file that they
need cost no more than this."""

NORMALS_ALIKE = 0.01
"""Difference of two unit normals without a stated sigma that costs `CLEARLY`: 40 samples of 1 % noise show a smaller one."""

AXES_ALIKE = 0.05
"""Largest difference of two matrices of axes that are the same axes."""

LIT_SHARE, LIT_SAMPLES, BRIGHTEST = 0.15, 2, 0.9
"""A panel was lit if so many samples exceed this share of full Sun: more than the Earth's light on a dark side often is. If the
gains have no unit full Sun is this quantile of the largest reading of a sample."""

WHEEL_SIGMA, WEAK_RAD = 0.02, 0.05
"""Relative sigma of a wheel's momentum and direction; and the turn of the rate (rad) in the whole file below which wheels are not
seen."""

SAME_WAY = 0.01
"""One less the cosine between normals that may be mirror images of each other; `equivalence` decides."""

FLAT = 0.05
"""Share of the largest singular value of end^T start (:func:`_procrustes`) below which another one counts as zero. For vectors that
match, these values are the squares of the singular values of the vectors themselves: there the share is 0.22."""

MOST_ASSIGNMENTS = 1000
"""Assignments of the panels of shared inputs to each other that are tried."""

WHEEL_SIGNS = "axis_B, speed_rad_s and speed_scale_rad_s"
"""Keys of a wheel that may have the wrong sign."""

READINGS = ("power_W", "current_A")
"""What telemetry calls the readings of panels."""


@dataclass(frozen=True)
class ColumnChange:
    """One way in which columns, signs or axes of a vehicle file may be wrong.

    `what`: in words. `columns`: input k reads the column `columns[k]`; if empty, the one that the file states. `reversed_panels`,
    `reversed_wheels`: numbers of panels and wheels with the opposite normal or axis. `axes`: variable of telemetry -> matrix (3, 3)
    by which its readings are multiplied. `do`: what to write in the file, in words; `errors`: how many mistakes it supposes.
    """

    what: str
    columns: tuple[int, ...] = ()
    reversed_panels: tuple[int, ...] = ()
    reversed_wheels: tuple[int, ...] = ()
    axes: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    do: str = ""
    errors: int = 1

    def with_wheels(self, wheels: tuple[int, ...], names: Sequence[str]) -> ColumnChange:
        """Return this change together with reversed wheels."""
        what = f"{self.what} and {_wheel_words(wheels, names)}"
        keys = f"look at the signs of {WHEEL_SIGNS}"
        do = f"{self.do}, and {keys} of {' and '.join(names[k] for k in wheels)}"
        return replace(self, what=what, reversed_wheels=wheels, do=do, errors=self.errors + 1)

    def applied(self, vehicle: Vehicle, telemetry: xr.Dataset) -> tuple[Vehicle, xr.Dataset]:
        """Return vehicle and telemetry as they are if the file is wrong in this way."""
        panels, wheels = list(vehicle.panels), list(vehicle.wheels)
        for k in self.reversed_panels:
            panels[k] = replace(panels[k], normal_B=-panels[k].normal_B)
        for k in self.reversed_wheels:
            wheels[k] = replace(wheels[k], axis_B=-wheels[k].axis_B)
        if self.reversed_panels or self.reversed_wheels:
            vehicle = replace(vehicle, panels=tuple(panels), wheels=tuple(wheels))
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


AS_WRITTEN = ColumnChange("the file as it is written", errors=0)
"""No change."""


def exchange(vehicle: Vehicle, a: int, b: int) -> ColumnChange:
    """Return the change that exchanges the columns of two inputs."""
    order = list(range(len(vehicle.inputs)))
    order[a], order[b] = b, a
    names = vehicle.input_names
    do = f"exchange the columns of {names[a]} and {names[b]} under [telemetry.columns] of the vehicle file"
    return ColumnChange(
        f"the columns of panels {names[a]} and {names[b]} exchanged", columns=tuple(order), do=do
    )


def _wheel_words(wheels: tuple[int, ...], names: Sequence[str]) -> str:
    """Return in words which wheels turn the other way."""
    return f"wheel{'s' if len(wheels) > 1 else ''} {' and '.join(names[k] for k in wheels)} turning the other way"


def column_changes(vehicle: Vehicle, telemetry: xr.Dataset) -> list[ColumnChange]:
    """Return each exchange of two inputs and each reversed panel with an input of its own; none without readings of panels."""
    if not any(name in telemetry for name in READINGS):
        return []
    pairs = [exchange(vehicle, a, b) for a, b in combinations(range(len(vehicle.inputs)), 2)]
    alone = sorted(
        panel_input.panels[0] for panel_input in vehicle.inputs if len(panel_input.panels) == 1
    )
    names = vehicle.panel_names
    return pairs + [
        ColumnChange(
            f"panel {names[k]} looking the other way",
            reversed_panels=(k,),
            do=f"reverse normal_B of panel {names[k]}",
        )
        for k in alone
    ]


def wheel_change(vehicle: Vehicle, wheels: tuple[int, ...]) -> ColumnChange:
    """Return the change that gives wheels the opposite sign."""
    names = [wheel.name for wheel in vehicle.wheels]
    do = f"look at the signs of its {WHEEL_SIGNS}"
    return ColumnChange(_wheel_words(wheels, names), reversed_wheels=wheels, do=do)


def wheel_changes(vehicle: Vehicle) -> list[ColumnChange]:
    """Return the changes that reverse each wheel, and all of them."""
    count = len(vehicle.wheels)
    which = dict.fromkeys([*((k,) for k in range(count)), tuple(range(count))])
    return [wheel_change(vehicle, numbers) for numbers in which if numbers]


@dataclass(frozen=True)
class Observed:
    """What a telemetry file has read, as far as that distinguishes changes.

    `lit` (n_input): columns that were in sunlight. `momenta` (n_wheel, n, 3): of each wheel in the file, in mean moments of inertia
    times rad/s. `span_s`: length of the file; `sensors`: variables of other sensors that were read. `in_orbit`: elements make the
    Sun and the field known in space. `sun_B` (n, 3): the Sun's directions of an estimated motion, empty if there is none. `panels`:
    whether the panels were used.
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
        """Return what a Dataset of `read_telemetry` has read; `more`: fields that it does not say, as `momenta`."""
        name = next((variable for variable in READINGS if variable in telemetry), None)
        lit = np.zeros(len(vehicle.inputs), dtype=bool)
        if name is not None:
            power = np.nan_to_num(telemetry[name].transpose("time", "panel").values)
            share = power / vehicle.input_gains
            full_sun = 1.0
            # gains in the unit of the readings, W or A, say what full Sun is
            if vehicle.gain_unit != name[-1] and len(share):
                full_sun = max(float(np.quantile(share.max(axis=1), BRIGHTEST)), 1e-300)
            lit = (share > LIT_SHARE * full_sun).sum(axis=0) >= LIT_SAMPLES
        names = ("gyro_B", "field_B", "attitude_B_from_N", "sun_sensor_B")
        were_read = frozenset(
            variable
            for variable in names
            if variable in telemetry and bool(telemetry[variable].notnull().any())
        )
        span = float(np.ptp(telemetry["time"].values)) if telemetry.sizes.get("time") else 0.0
        return cls(vehicle, lit, span_s=span, sensors=were_read, panels=name is not None, **more)

    @cached_property
    def free_scale(self) -> bool:
        """Return whether only the ratios of the gains count."""
        return self.vehicle.throttled or self.vehicle.gain_unit is None


def equivalence(observed: Observed, first: ColumnChange, second: ColumnChange) -> np.ndarray:
    """Return rotations and mirrors of the body (m, 3, 3) by which two changes look the same in the telemetry, the best first.

    There are none (0, 3, 3) if the data distinguish the changes.

    With such an M, directions under the second change are M times those under the first, and rates det(M) M times.
    `observed.sun_B` is that of a motion under the first change. The cost of a matrix is the log evidence that it costs the stated
    errors of gains and normals, of the inertia and of the wheels.
    """
    if first.axes.get("attitude_B_from_N") is not second.axes.get("attitude_B_from_N"):
        return np.zeros((0, 3, 3))
    distinct: list[tuple[float, np.ndarray]] = []
    for m, panels_cost in _panel_maps(observed, first, second):
        # the refusals that are computed fastest come first
        if not (_sensors_agree(observed, first, second, m) and _stays_dark(observed, second, m)):
            continue
        cost = panels_cost + _inertia_cost(observed.vehicle, m)
        cost += _wheel_cost(observed, first, second, m)
        is_new = all(np.abs(m - other).max() > AXES_ALIKE for _, other in distinct)
        if cost <= CLEARLY and is_new:
            distinct.append((cost, m))
    distinct.sort(key=lambda pair: pair[0])
    return np.array([m for _, m in distinct]).reshape(-1, 3, 3)


def rate_under(matrix: np.ndarray, omega: np.ndarray) -> np.ndarray:
    """Return rates (..., 3) as a rotation or mirror of the body (3, 3) shows them."""
    return np.linalg.det(matrix) * (omega @ matrix.T)


def alike(
    observed: Observed, first: ColumnChange, others: Sequence[ColumnChange]
) -> list[tuple[ColumnChange, np.ndarray]]:
    """Return those of the changes that look the same as the first, with the best M (3, 3) of each (:func:`equivalence`)."""
    maps = [(other, equivalence(observed, first, other)) for other in others]
    return [(other, matrices[0]) for other, matrices in maps if len(matrices)]


def unseen_changes(
    observed: Observed, telemetry: xr.Dataset
) -> list[tuple[ColumnChange, np.ndarray]]:
    """Return changes of columns and panels, each with its M (3, 3), that look the same as the file but show another motion.

    First changes of one mistake are tried. If none of them looks the same, exchanges of several columns by a symmetry of the panels
    are, and those of the fewest pairs are returned.
    """
    of_one_mistake = column_changes(observed.vehicle, telemetry)
    if not of_one_mistake:  # no readings of panels, or nothing to change
        return []
    for changes in (of_one_mistake, symmetric_exchanges(observed.vehicle)):
        # det(M) M maps rates: where it is the identity, the motion is the same
        same = [
            (change, m)
            for change, m in alike(observed, AS_WRITTEN, changes)
            if np.abs(np.linalg.det(m) * m - np.eye(3)).max() > AXES_ALIKE
        ]
        if same:
            fewest = min(change.errors for change, _ in same)
            return [(change, m) for change, m in same if change.errors == fewest]
    return []


def columns_seen(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Return whether panels alone tell which column is which: no change of columns looks the same as the file.

    Wheels count at their nominal speed.
    """
    observed = Observed.of(vehicle, telemetry, momenta=nominal_momenta(vehicle))
    return not unseen_changes(replace(observed, sensors=frozenset()), telemetry)


def nominal_momenta(vehicle: Vehicle) -> np.ndarray:
    """Return the momentum (n_wheel, 1, 3) of each wheel at its nominal speed, in mean moments of inertia times rad/s.

    Without an inertia the momenta have no unit, and there are none (0, 1, 3).
    """
    if vehicle.inertia_kg_m2 is None:
        return np.zeros((0, 1, 3))
    unit = np.trace(vehicle.inertia_kg_m2) / 3
    momenta = [w.inertia_kg_m2 * w.speed_rad_s / unit * w.axis_B for w in vehicle.wheels]
    return np.array(momenta).reshape(-1, 1, 3)


def symmetric_exchanges(vehicle: Vehicle) -> list[ColumnChange]:
    """Return changes that exchange several pairs of columns, as a symmetry of all panels together exchanges the panels.

    Symmetries are mirrors that map the normals of all panels onto each other, and the half turns by two such mirrors at right
    angles. There are no such changes for panels that share inputs.
    """
    if any(len(panel_input.panels) > 1 for panel_input in vehicle.inputs):
        return []
    normals, count = np.array(vehicle.panel_normals_B), len(vehicle.panels)

    def order_of(m: np.ndarray) -> tuple[int, ...] | None:
        """Return which panel each normal is mapped onto by m (3, 3); None if one is mapped onto none."""
        cosine = normals @ (normals @ m.T).T  # (panel, mapped normal)
        order = tuple(cosine.argmax(axis=0).tolist())
        all_mapped = cosine.max(axis=0).min(initial=1.0) > 1 - SAME_WAY
        return order if all_mapped and len(set(order)) == count else None

    mirrors: list[np.ndarray] = []
    for a, b in combinations(range(count), 2):
        across = normals[a] - normals[b]  # the normal of the plane of a mirror that exchanges both
        square = float(across @ across)
        if square <= 1e-6:
            continue
        mirror = np.eye(3) - 2 * np.outer(across, across) / square
        is_new = all(np.abs(mirror - other).max() >= AXES_ALIKE for other in mirrors)
        if is_new and order_of(mirror) is not None:
            mirrors.append(mirror)
    # mirrors at right angles commute
    half_turns = [
        a @ b for a, b in combinations(mirrors, 2) if np.abs(a @ b - b @ a).max() < AXES_ALIKE
    ]
    changes: dict[tuple[int, ...], ColumnChange] = {}
    for symmetry in [*mirrors, *half_turns]:
        order = order_of(symmetry)
        if order:
            pairs = [exchange(vehicle, a, b).what for a, b in enumerate(order) if a < b]
            changes[order] = ColumnChange(", and ".join(pairs), columns=order, errors=len(pairs))
    return list(changes.values())


def _panels_of(observed: Observed, change: ColumnChange) -> list[tuple[int, ...]]:
    """Return the panels whose light each column shows under a change: readings of column `columns[k]` belong to input k."""
    inputs = observed.vehicle.inputs
    columns = change.columns or tuple(range(len(inputs)))
    shown: list[tuple[int, ...]] = [()] * len(inputs)
    for k, column in enumerate(columns):
        shown[column] = inputs[k].panels
    return shown


def _normals(observed: Observed, change: ColumnChange) -> np.ndarray:
    """Return the normals (n_panel, 3) under a change."""
    normals = np.array(observed.vehicle.panel_normals_B)
    normals[list(change.reversed_panels)] *= -1
    return normals


def _panel_maps(
    observed: Observed, first: ColumnChange, second: ColumnChange
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield orthogonal matrices that may map the panels of lit columns under the first change onto those under the second.

    With each comes the log evidence that it costs the stated errors of gains and normals, at most :data:`CLEARLY`. A column shows
    one panel, or the sum or the largest of several on a shared input. Then assignments of these panels to those of the other change
    are tried, :data:`MOST_ASSIGNMENTS` at most.
    """
    vehicle = observed.vehicle
    if not observed.panels:
        for m in _maps_of_axes(observed):
            yield m, 0.0
        return
    lit = np.flatnonzero(observed.lit)
    first_panels, second_panels = _panels_of(observed, first), _panels_of(observed, second)
    if any(len(first_panels[k]) != len(second_panels[k]) for k in lit) or not len(lit):
        return
    shows_largest = {panel_input.panels: panel_input.largest for panel_input in vehicle.inputs}
    for k in lit:
        shared = len(first_panels[k]) > 1
        if shared and shows_largest[first_panels[k]] != shows_largest[second_panels[k]]:
            return
    # One sigma of each component of a normal: two normals that differ by NORMALS_ALIKE cost CLEARLY. The cost of a difference d is
    # d^2 / (2 (sigma^2 + sigma^2)), as both normals have errors.
    least_sigma = NORMALS_ALIKE / np.sqrt(2 * CLEARLY) / np.sqrt(2)
    sigma = np.hypot(misalignment_sigma(vehicle)[0], least_sigma)
    gain_sigma = np.zeros(len(vehicle.panels))
    for shown, value in zip(vehicle.inputs, prior_sigmas(vehicle), strict=True):
        gain_sigma[list(shown.panels)] = value
    log_gain = np.log(vehicle.panel_gains)
    first_normals, second_normals = _normals(observed, first), _normals(observed, second)
    a = [k for column in lit for k in first_panels[column]]
    assignments = product(*(permutations(second_panels[column]) for column in lit))
    for assigned in islice(assignments, MOST_ASSIGNMENTS):
        b = [k for panels in assigned for k in panels]  # panel a[i] is mapped onto panel b[i]
        # logs of gains, each with its sigma; a common factor costs nothing if only ratios of gains are known
        gain_off = log_gain[a] - log_gain[b]
        weight = 1 / (gain_sigma[a] ** 2 + gain_sigma[b] ** 2)
        if observed.free_scale:
            gain_off = gain_off - np.average(gain_off, weights=weight)
        gain_cost = float(weight @ gain_off**2) / 2
        if gain_cost > CLEARLY:
            continue
        for m in _procrustes(observed, first_normals[a], second_normals[b]):
            off = np.linalg.norm(first_normals[a] @ m.T - second_normals[b], axis=1)
            cost = gain_cost + float((off**2 / (sigma[a] ** 2 + sigma[b] ** 2)).sum()) / 2
            if cost <= CLEARLY:
                yield m, cost


def _procrustes(observed: Observed, start: np.ndarray, end: np.ndarray) -> Iterator[np.ndarray]:
    """Yield orthogonal matrices that map unit vectors `start` (n, 3) best onto `end` (n, 3) in least squares (Procrustes).

    With the singular value decomposition U S V^T of the sum of end start^T the best is U V^T. There is one if the vectors span
    space. In a plane a mirror across it is open, which makes two. On a line the turn about it is open: each map of axes of the body
    is tried, bent so that it maps the line.
    """
    u, size, v_T = np.linalg.svd(end.T @ start)
    if size[2] > FLAT * size[0]:
        yield u @ v_T
    elif size[1] > FLAT * size[0]:
        for side in (1.0, -1.0):
            yield u @ np.diag([1.0, 1.0, side]) @ v_T
    else:
        end_line, start_line = u[:, :1], v_T[:1].T  # (3, 1)
        across_end = np.eye(3) - end_line @ end_line.T
        across_start = np.eye(3) - start_line @ start_line.T
        for m in _maps_of_axes(observed):
            mapped = end_line @ start_line.T + across_end @ m @ across_start
            # The nearest orthogonal matrix. There is no single one if m flattens the plane across the line: then m is left out.
            left, sizes, right = np.linalg.svd(mapped)
            if sizes[2] > FLAT:
                yield left @ right


def _maps_of_axes(observed: Observed) -> Iterator[np.ndarray]:
    """Yield the 48 signed permutations (3, 3) of the principal axes of the body; of its axes if no inertia is known."""
    inertia = observed.vehicle.inertia_kg_m2
    frame = np.eye(3) if inertia is None else np.linalg.eigh(inertia)[1]
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            yield frame @ (np.eye(3)[list(order)] * np.array(sign)[:, None]) @ frame.T


def _stays_dark(observed: Observed, second: ColumnChange, m: np.ndarray) -> bool:
    """Return whether panels whose columns were never lit face away from the Sun under the second change too, mapped by m."""
    dark = np.flatnonzero(~observed.lit)
    if not observed.panels or not len(dark) or not len(observed.sun_B):
        return True
    shown = _panels_of(observed, second)
    panels = [k for column in dark for k in shown[column]]
    light = observed.sun_B @ m.T @ _normals(observed, second)[panels].T
    return bool(((light > 2 * LIT_SHARE).sum(axis=0) < LIT_SAMPLES).all())


def _inertia_cost(vehicle: Vehicle, m: np.ndarray) -> float:
    """Return the log evidence that M Theta M^T costs in place of Theta; zero if the inertia is not known."""
    if vehicle.inertia_kg_m2 is None:
        return 0.0
    body = Body.of(vehicle)
    tensor = body.inertia
    # each element has an error of its own, if any
    sigma = np.maximum(np.abs(body.errors).max(axis=0, initial=0.0), 1e-6 * np.trace(tensor))
    square = ((m @ tensor @ m.T - tensor) / sigma) ** 2
    return float(square[np.triu_indices(3)].sum()) / 2


def _wheel_cost(
    observed: Observed, first: ColumnChange, second: ColumnChange, m: np.ndarray
) -> float:
    """Return the log evidence that wheels cost: the momentum must be det(M) M times that under the first change."""
    if not len(observed.momenta) or observed.vehicle.inertia_kg_m2 is None:
        return 0.0
    totals = []
    for change in (first, second):
        sign = np.ones(len(observed.momenta))
        sign[list(change.reversed_wheels)] = -1
        totals.append(np.einsum("w,wni->ni", sign, observed.momenta))
    off = float(np.linalg.norm(rate_under(m, totals[0]) - totals[1], axis=1).max(initial=0.0))
    # momenta are over the mean moment of inertia, so that a momentum of 1 rad/s turns the rate of the body by about 1 rad/s
    if off / 2 * observed.span_s < WEAK_RAD:
        return 0.0
    size = float(np.linalg.norm(observed.momenta, axis=2).max(initial=0.0))
    return float((off / (max(WHEEL_SIGMA, INERTIA) * size)) ** 2) / 2


def _sensors_agree(
    observed: Observed, first: ColumnChange, second: ColumnChange, m: np.ndarray
) -> bool:
    """Return whether the other sensors that were read fit both changes.

    A sensor does if its axes (3, 3) under the second change are those under the first, mapped by m as its readings are: directions
    by m, rates by det(m) m.
    """
    side = float(np.linalg.det(m))  # -1 for a mirror
    dipole = observed.vehicle.sensors.disturbance.dipole
    for name in observed.sensors:
        axes, second_axes = (change.axes.get(name, np.eye(3)) for change in (first, second))
        mapped: list[np.ndarray] = []  # axes that fit
        if name == "attitude_B_from_N":  # shows how the body itself turns: no other body will do
            mapped = [np.eye(3)] if np.abs(m - np.eye(3)).max() < AXES_ALIKE else []
        elif name == "gyro_B":
            mapped = [side * m @ axes]
        elif name == "sun_sensor_B":
            mapped = [m @ axes]
        elif not observed.in_orbit:  # a field of unknown direction in space has no sign either
            mapped = [m @ axes, -m @ axes]
        elif side > 0:  # with the Sun, a known field excludes mirrors
            mapped = [m @ axes]
        if name == "field_B" and dipole is not None:  # the torque must be the same
            off = min(np.linalg.norm(m @ dipole - sign * dipole) for sign in (1.0, -1.0))
            mapped = mapped if off <= AXES_ALIKE * np.linalg.norm(dipole) else []
        if all(np.abs(candidate - second_axes).max() > AXES_ALIKE for candidate in mapped):
            return False
    return True
