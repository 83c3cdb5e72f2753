"""Which changes of columns, panels, wheel signs and sensor axes in a vehicle file the telemetry cannot distinguish.

Two changes are equivalent if a rotation or a mirror M of the body maps the readings under the one onto those under the other:
s' = M s for directions, omega' = det(M) M omega for rates and momenta, and M Theta M^T for the inertia. Then no data distinguish
them. One function decides it, :func:`equivalence`: normals of lit panels propose matrices M (Procrustes), which other sensors, dark
panels, inertia and wheels may exclude. Stated errors allow small differences, at a cost in log evidence.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, islice, permutations, product
from types import MappingProxyType

import numpy as np
import xarray as xr

from sunspin.estimate.model import Body
from sunspin.estimate.settings import INERTIA
from sunspin.telemetry.gains import prior_sigmas
from sunspin.telemetry.quality import remove_spikes
from sunspin.vehicle import Vehicle
from sunspin.vehicle.response.panels import misalignment_sigma

CLEARLY = 10.0
"""Log evidence by which a change must fit better to be named. Changes are equivalent if the errors of the file that they need cost
no more than this."""

NORMALS_ALIKE = 0.01
"""Difference of two unit normals without a stated sigma that costs `CLEARLY`: 40 samples of 1 % noise show a smaller one."""

AXES_ALIKE = 0.05
"""Largest difference between elements of two matrices of axes that count as the same axes."""

LIT_SHARE, LIT_SAMPLES, FULL_SUN_QUANTILE = 0.15, 2, 0.9
"""A panel was lit if at least LIT_SAMPLES readings exceed LIT_SHARE of full Sun, which is more than albedo on an unlit panel often
is. If gains have no unit, full Sun is the quantile FULL_SUN_QUANTILE of the largest reading of a sample."""

WHEEL_SIGMA, WEAK_RAD = 0.02, 0.05
"""Relative sigma of a wheel's momentum and direction; and the angle (rad) by which wheels must turn the rate of the body in the
whole file to be observable."""

SAME_WAY = 0.01
"""Largest 1 - cosine between normals that are tried as mirror images of each other; `equivalence` decides."""

FLAT = 0.05
"""Singular values of end^T start (:func:`_procrustes`) below this part of the largest count as zero. For matching vectors they are
the squares of the singular values of the vectors themselves, of which 0.22 is the corresponding part."""

MOST_ASSIGNMENTS = 1000
"""Most assignments of the panels on shared inputs to each other that are tried."""

WHEEL_SIGNS = "axis_B, speed_rad_s and speed_scale_rad_s"
"""Keys of a wheel that may have the wrong sign."""

READINGS = ("power_W", "current_A")
"""Variables of telemetry with the readings of panels."""


@dataclass(frozen=True)
class ColumnChange:
    """One way in which columns, signs or axes of a vehicle file may be wrong.

    `what`: in words. `columns`: input k reads the column `columns[k]`; if empty, the one that the file states. `reversed_panels`,
    `reversed_wheels`: numbers of panels and wheels with the opposite normal or axis. `axes`: variable of telemetry -> matrix by
    which its readings are multiplied, (3, 3), of a quaternion (4, 4). `do`: what to write in the file, in words; `errors`: number
    of mistakes in the file. `what` and `do` are printed as they are.
    """

    what: str
    columns: tuple[int, ...] = ()
    reversed_panels: tuple[int, ...] = ()
    reversed_wheels: tuple[int, ...] = ()
    axes: Mapping[str, np.ndarray] = field(default_factory=lambda: MappingProxyType({}))
    do: str = ""
    errors: int = 1

    def with_wheels(self, wheels: tuple[int, ...], names: Sequence[str]) -> ColumnChange:
        """Return this change together with reversed `wheels` (numbers); `names`: of all wheels."""
        what = f"{self.what} and {_wheel_words(wheels, names)}"
        keys = f"look at the signs of {WHEEL_SIGNS}"
        do = f"{self.do}, and {keys} of {' and '.join(names[k] for k in wheels)}"
        return replace(self, what=what, reversed_wheels=wheels, do=do, errors=self.errors + 1)

    def applied(self, vehicle: Vehicle, telemetry: xr.Dataset) -> tuple[Vehicle, xr.Dataset]:
        """Return vehicle and telemetry after the change, as they are if the file is wrong in this way."""
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
"""No change of columns, signs or axes. The model as in the file: `model.AS_STATED`."""


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
    """Return in words that `wheels` (numbers) turn the other way; `names`: of all wheels."""
    return f"wheel{'s' if len(wheels) > 1 else ''} {' and '.join(names[k] for k in wheels)} turning the other way"


def column_changes(vehicle: Vehicle, telemetry: xr.Dataset) -> list[ColumnChange]:
    """Return all exchanges of two inputs, and all reversals of a panel with an input of its own; none without panel readings."""
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
    """Return the change that gives `wheels` (numbers) the opposite sign."""
    names = [wheel.name for wheel in vehicle.wheels]
    do = f"look at the signs of its {WHEEL_SIGNS}"
    return ColumnChange(_wheel_words(wheels, names), reversed_wheels=wheels, do=do)


def wheel_changes(vehicle: Vehicle) -> list[ColumnChange]:
    """Return the changes that reverse one wheel each, and the one that reverses all of them."""
    count = len(vehicle.wheels)
    # without duplicates: one wheel is also all of them
    which = dict.fromkeys([*((k,) for k in range(count)), tuple(range(count))])
    return [wheel_change(vehicle, numbers) for numbers in which if numbers]


@dataclass(frozen=True)
class Observed:
    """What was read in a telemetry file, as far as it distinguishes changes.

    `lit` (n_input): whether each column was in sunlight. `momenta` (n_wheel, n, 3): of each wheel in body axes, in mean moments of
    inertia times rad/s. `span_s`: duration of the file; `sensors`: variables of other sensors that were read. `in_orbit`: orbital
    elements give the Sun and the field in space. `sun_B` (n, 3): Sun directions of an estimated motion, empty if there is none.
    `panels`: whether panels were read.
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
    def of(cls, vehicle: Vehicle, telemetry: xr.Dataset, **rest) -> Observed:
        """Return what was read in a Dataset of `read_telemetry`; `rest`: fields that it does not give, such as `momenta`."""
        name = next((variable for variable in READINGS if variable in telemetry), None)
        lit = np.zeros(len(vehicle.inputs), dtype=bool)
        if name is not None:
            power = telemetry[name].transpose("time", "panel").values
            read = np.nan_to_num(remove_spikes(vehicle, power))
            lit = (read > LIT_SHARE * full_sun_readings(vehicle, name, read)).sum(axis=0)
            lit = lit >= LIT_SAMPLES
        names = ("gyro_B", "field_B", "attitude_B_from_N", "sun_sensor_B")
        were_read = frozenset(
            variable
            for variable in names
            if variable in telemetry and bool(telemetry[variable].notnull().any())
        )
        span = float(np.ptp(telemetry["time"].values)) if telemetry.sizes.get("time") else 0.0
        return cls(vehicle, lit, span_s=span, sensors=were_read, panels=name is not None, **rest)


def full_sun_readings(vehicle: Vehicle, name: str, read: np.ndarray) -> np.ndarray:
    """Return the reading of each input (n_input) in full Sun on its panels, in the unit of `read` (n, n_input).

    `name`: variable of the readings, whose last letter is their unit, W or A. Gains in that unit are full Sun. Relative gains,
    numbers of cells and gains in the other unit are full Sun but for a factor: the quantile :data:`FULL_SUN_QUANTILE` of the
    largest reading of a sample divided by its gain.
    """
    gains = vehicle.input_gains
    if vehicle.gain_unit == name[-1] or not len(read):
        return gains
    return gains * max(float(np.quantile((read / gains).max(axis=1), FULL_SUN_QUANTILE)), 1e-300)


def equivalence(observed: Observed, first: ColumnChange, second: ColumnChange) -> np.ndarray:
    """Return the rotations and mirrors M of the body (m, 3, 3) by which two changes are equivalent, the least costly first.

    There are none, (0, 3, 3), if the data distinguish the changes. Directions under the second change are M times those under the
    first, and rates det(M) M times. `observed.sun_B` is that of a motion under the first change. The cost of M is the log evidence
    of the errors of gains, normals, inertia and wheels that it needs; it is at most :data:`CLEARLY`.
    """
    if first.axes.get("attitude_B_from_N") is not second.axes.get("attitude_B_from_N"):
        return np.zeros((0, 3, 3))
    distinct: list[tuple[float, np.ndarray]] = []  # cost and M
    for m, panels_cost in _panel_maps(observed, first, second):
        # the conditions that are computed fastest come first
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
    """Return rates omega (..., 3) mapped by a rotation or mirror M (3, 3) of the body: det(M) M omega, as rates are axial
    vectors."""
    return np.linalg.det(matrix) * (omega @ matrix.T)


def equivalent_changes(
    observed: Observed, first: ColumnChange, others: Sequence[ColumnChange]
) -> list[tuple[ColumnChange, np.ndarray]]:
    """Return those of the `others` that are equivalent to the first change, each with its best M (3, 3) (:func:`equivalence`)."""
    maps = [(other, equivalence(observed, first, other)) for other in others]
    return [(other, matrices[0]) for other, matrices in maps if len(matrices)]


def unseen_changes(
    observed: Observed, telemetry: xr.Dataset
) -> list[tuple[ColumnChange, np.ndarray]]:
    """Return changes of columns and panels, each with its M (3, 3), that are equivalent to the file as written, but with another
    motion.

    Changes that suppose one mistake are tried first. If none of them is equivalent, exchanges of several columns by a symmetry of
    the panels are tried. Of the equivalent ones those with the fewest mistakes are returned.
    """
    of_one_mistake = column_changes(observed.vehicle, telemetry)
    if not of_one_mistake:  # no readings of panels, or nothing to change
        return []
    for changes in (of_one_mistake, _symmetric_exchanges(observed.vehicle)):
        # det(M) M maps rates: if it is the identity, the motion is the same
        unseen = [
            (change, m)
            for change, m in equivalent_changes(observed, AS_WRITTEN, changes)
            if np.abs(np.linalg.det(m) * m - np.eye(3)).max() > AXES_ALIKE
        ]
        if unseen:
            fewest = min(change.errors for change, _ in unseen)
            return [(change, m) for change, m in unseen if change.errors == fewest]
    return []


def columns_seen(vehicle: Vehicle, telemetry: xr.Dataset) -> bool:
    """Return whether panels alone, without other sensors, show which column is which: no change is equivalent to the file.

    Wheels count at their nominal speed.
    """
    observed = Observed.of(vehicle, telemetry, momenta=nominal_momenta(vehicle))
    return not unseen_changes(replace(observed, sensors=frozenset()), telemetry)


def nominal_momenta(vehicle: Vehicle) -> np.ndarray:
    """Return the momentum (n_wheel, 1, 3) of each wheel at its nominal speed, the same at all times, in body axes.

    It is divided by the mean moment of inertia of the body: rad/s. Without an inertia the result is empty, (0, 1, 3).
    """
    if vehicle.inertia_kg_m2 is None:
        return np.zeros((0, 1, 3))
    mean_moment = np.trace(vehicle.inertia_kg_m2) / 3
    momenta = [w.inertia_kg_m2 * w.speed_rad_s / mean_moment * w.axis_B for w in vehicle.wheels]
    return np.array(momenta).reshape(-1, 1, 3)


def _symmetric_exchanges(vehicle: Vehicle) -> list[ColumnChange]:
    """Return changes that exchange several pairs of columns at once, as a symmetry of the panel layout exchanges the panels.

    Symmetries are mirrors that map all panel normals onto each other, and products of two such mirrors at right angles, which are
    half revolutions. There are no such changes for panels that share inputs.
    """
    if any(len(panel_input.panels) > 1 for panel_input in vehicle.inputs):
        return []
    normals, count = np.array(vehicle.panel_normals_B), len(vehicle.panels)

    def order_of(m: np.ndarray) -> tuple[int, ...] | None:
        """Return the number of the panel onto which m (3, 3) maps each normal; None if m does not map them one to one."""
        cosine = normals @ (normals @ m.T).T  # (panel, mapped normal)
        order = tuple(cosine.argmax(axis=0).tolist())
        all_mapped = cosine.max(axis=0).min(initial=1.0) > 1 - SAME_WAY
        return order if all_mapped and len(set(order)) == count else None

    mirrors: list[np.ndarray] = []
    for a, b in combinations(range(count), 2):
        # the mirror that exchanges both normals, I - 2 d d^T / d^2 with their difference d (Householder)
        difference = normals[a] - normals[b]
        square = float(difference @ difference)
        if square <= 1e-6:
            continue
        mirror = np.eye(3) - 2 * np.outer(difference, difference) / square
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
    """Return for each column the numbers of the panels that it shows under a change: column `columns[k]` belongs to input k."""
    inputs = observed.vehicle.inputs
    columns = change.columns or tuple(range(len(inputs)))
    shown: list[tuple[int, ...]] = [()] * len(inputs)
    for k, column in enumerate(columns):
        shown[column] = inputs[k].panels
    return shown


def _normals(observed: Observed, change: ColumnChange) -> np.ndarray:
    """Return the panel normals (n_panel, 3) under a change."""
    normals = np.array(observed.vehicle.panel_normals_B)
    normals[list(change.reversed_panels)] *= -1
    return normals


def _panel_maps(
    observed: Observed, first: ColumnChange, second: ColumnChange
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield orthogonal matrices (3, 3) that may map the panels of lit columns under the first change onto those under the second.

    Each comes with its cost: the log evidence of the errors of gains and normals that it needs, at most :data:`CLEARLY`. A column
    shows one panel, or the sum or the largest of several on a shared input; of these, up to :data:`MOST_ASSIGNMENTS` assignments to
    the panels of the other change are tried. Without panels all maps of axes are possible.
    """
    vehicle = observed.vehicle
    if not observed.panels:
        for m in _maps_of_axes(observed):
            yield m, 0.0
        return
    lit = np.flatnonzero(observed.lit)
    first_panels, second_panels = _panels_of(observed, first), _panels_of(observed, second)
    # a column must show as many panels under both changes, and show them in the same way: their sum or the largest
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
    log_gain, log_gain_sigma = np.log(vehicle.panel_gains), np.zeros(len(vehicle.panels))
    for panel_input, value in zip(vehicle.inputs, prior_sigmas(vehicle), strict=True):
        log_gain_sigma[list(panel_input.panels)] = value
    first_normals, second_normals = _normals(observed, first), _normals(observed, second)
    # a, b: numbers of panels; the panel a[i] under the first change is mapped onto b[i] under the second
    a = [k for column in lit for k in first_panels[column]]
    assignments = product(*(permutations(second_panels[column]) for column in lit))
    for assigned in islice(assignments, MOST_ASSIGNMENTS):
        b = [k for panels in assigned for k in panels]
        gain_off = log_gain[a] - log_gain[b]
        weight = 1 / (log_gain_sigma[a] ** 2 + log_gain_sigma[b] ** 2)
        if vehicle.throttled or vehicle.gain_unit is None:
            # only ratios of gains are known: a common factor costs nothing
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

    With the singular value decomposition U S V^T of the sum of end start^T the best is U V^T. It is unique if the vectors span
    space. If they lie in a plane, a mirror across it is undetermined, and there are two. If they lie on a line, the rotation about
    it is undetermined: each map of the axes of the body is tried, changed as little as possible so that it maps the line.
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
            # the nearest orthogonal matrix; none is unique if m maps the plane across the line onto less than a plane
            left, sizes, right_T = np.linalg.svd(mapped)
            if sizes[2] > FLAT:
                yield left @ right_T


def _maps_of_axes(observed: Observed) -> Iterator[np.ndarray]:
    """Yield the 48 signed permutations (3, 3) of the principal axes of the body; of its axes if no inertia is known."""
    inertia = observed.vehicle.inertia_kg_m2
    frame = np.eye(3) if inertia is None else np.linalg.eigh(inertia)[1]
    for order in permutations(range(3)):
        for sign in product((1.0, -1.0), repeat=3):
            yield frame @ (np.eye(3)[list(order)] * np.array(sign)[:, None]) @ frame.T


def _stays_dark(observed: Observed, second: ColumnChange, m: np.ndarray) -> bool:
    """Return whether panels whose columns were never lit also face away from the Sun, mapped by m, under the second change."""
    dark = np.flatnonzero(~observed.lit)
    if not observed.panels or not len(dark) or not len(observed.sun_B):
        return True
    shown = _panels_of(observed, second)
    panels = [k for column in dark for k in shown[column]]
    # readings (n, panel) over full Sun
    light = observed.sun_B @ m.T @ _normals(observed, second)[panels].T
    return bool(((light > 2 * LIT_SHARE).sum(axis=0) < LIT_SAMPLES).all())


def _inertia_cost(vehicle: Vehicle, m: np.ndarray) -> float:
    """Return the cost (log evidence) of M Theta M^T instead of the stated inertia Theta: half the sum of the squared changes of the
    six elements, in sigmas; zero if the file states no inertia."""
    if vehicle.inertia_kg_m2 is None:
        return 0.0
    body = Body.of(vehicle)
    tensor = body.inertia
    # (3, 3) sigma of each element; one that is stated exactly gets a small one
    sigma = np.maximum(np.abs(body.errors).max(axis=0, initial=0.0), 1e-6 * np.trace(tensor))
    square = ((m @ tensor @ m.T - tensor) / sigma) ** 2
    return float(square[np.triu_indices(3)].sum()) / 2


def _wheel_cost(
    observed: Observed, first: ColumnChange, second: ColumnChange, m: np.ndarray
) -> float:
    """Return the log evidence of the error of the wheels' momentum that m needs: zero if it maps the momenta onto each other.

    The total momentum under the second change must be det(M) M times that under the first.
    """
    if not len(observed.momenta) or observed.vehicle.inertia_kg_m2 is None:
        return 0.0
    totals = []  # (n, 3) of each change
    for change in (first, second):
        sign = np.ones(len(observed.momenta))
        sign[list(change.reversed_wheels)] = -1
        totals.append(np.einsum("w,wni->ni", sign, observed.momenta))
    off = float(np.linalg.norm(rate_under(m, totals[0]) - totals[1], axis=1).max(initial=0.0))
    # A reversed wheel is off by twice its momentum, which in mean moments is about the frequency at which it turns the rate of the
    # body. Wheels that turn it too little are not observable.
    if off / 2 * observed.span_s < WEAK_RAD:
        return 0.0
    size = float(np.linalg.norm(observed.momenta, axis=2).max(initial=0.0))
    return float((off / (max(WHEEL_SIGMA, INERTIA) * size)) ** 2) / 2


def _sensors_agree(
    observed: Observed, first: ColumnChange, second: ColumnChange, m: np.ndarray
) -> bool:
    """Return whether m, as the map from the first change to the second, agrees with every other sensor that was read.

    A sensor agrees with m if its axes (3, 3) under the second change are m times those under the first for directions, and det(m) m
    times those under the first for rates.
    """
    determinant = float(np.linalg.det(m))  # -1 for a mirror
    dipole = observed.vehicle.sensors.disturbance.dipole
    for name in observed.sensors:
        axes, second_axes = (change.axes.get(name, np.eye(3)) for change in (first, second))
        possible: list[np.ndarray] = []  # axes under the second change that fit
        if name == "attitude_B_from_N":  # shows the attitude itself, so that only the identity fits
            possible = [np.eye(3)] if np.abs(m - np.eye(3)).max() < AXES_ALIKE else []
        elif name == "gyro_B":
            possible = [determinant * m @ axes]
        elif name == "sun_sensor_B":
            possible = [m @ axes]
        else:  # a magnetometer
            # The direction of the field in space is unknown, and so is its sign. In orbit field and Sun are known, which excludes
            # mirrors.
            signs = [1.0, -1.0] if not observed.in_orbit else [1.0] if determinant > 0 else []
            if dipole is not None:
                # the torque d x b of a stated dipole d stays the same for the field s m b only if m d = s d
                limit = AXES_ALIKE * np.linalg.norm(dipole)
                signs = [s for s in signs if np.linalg.norm(m @ dipole - s * dipole) <= limit]
            possible = [s * m @ axes for s in signs]
        # if no axes are possible, this is true: the sensor excludes m
        if all(np.abs(candidate - second_axes).max() > AXES_ALIKE for candidate in possible):
            return False
    return True
