"""What telemetry shows however the body is turned, and a magnetometer's calibration by it along an orbit.

Strength of the field, the angle between field and Sun, and whether the Sun is up depend on the place alone. The field is matrix
(scale, soft iron, axes) times reading less a zero; both are fitted at each of several shifts along the track, under Student tails
and with the scatter of strength and angle estimated.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.environment.orbit import Orbit
from sunspin.estimate.equivalence import Change, Observed, alike, column_changes
from sunspin.estimate.orbit.along_track import AlongTrack
from sunspin.estimate.wiring import axes_matrix, signed_axes, to_write
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.quality import find_late_frames
from sunspin.telemetry.sun import SunStatus, signals
from sunspin.vehicle.response.panels import opposite_panels

MOST_SAMPLES = 200
"""Samples of the file that are compared; those that show field and Sun are kept first, the others are spread evenly."""

MOST_WITH_SUN = 0.5
"""Part of them that is kept for field and Sun: the night tells the strength of the field and the shadow."""

EARTH_MOST, EARTH_RAD, EARTH_ALIKE = 0.3, 0.1, 10
"""Of a panel with no other opposite to it, nothing in the file separates the Sun from the Earth's light. It counts as sunlit
above this part of full Sun; a direction that rests on it is off by this angle (rad); and the errors of at most so many samples
average out, as a spinner shows the same side in all of them. On 10 simulated spinners with three to five such panels the angle
to the field turned the calibration by 4 to 130 deg without these limits, by 0.3 to 4 deg with them."""

STUDENT = 4.0
"""Degrees of freedom of the residuals' distribution: a beacon in eight is worse than a Gaussian allows."""

MATRIX_SIGMA = 0.2
"""Of each element of the magnetometer's matrix over its scale: soft iron, axes."""

TIED, LEAST_SCALE = 8, 1e-3
"""Elements of the matrix beside its scale, and the smallest scale over the first one."""

ZERO_SIGMA = 1.0
"""Of its zero, in medians of its readings: the file's may be missing."""

LEAST_FIELD, LEAST_SINE = 0.003, 0.5
"""The smallest scatter that residuals may have, as a part of the field and in units of the Sun's sigma: models are no better. Where
few samples have a Sun, a calibration fits their angles nearly exactly, and they would then outvote the field's strength."""

SEEN_IN_SHADOW = 0.02
"""Samples that show a Sun where there is none: a clock's jitter, the Moon, noise."""

FEWEST = 20
"""Fewer readings of field or light, or of the angle between field and Sun, than this are not compared."""

MOST_ANGLE_RAD, CLEARER = 0.15, 0.5
"""Right elements leave no larger median of the angle between field and Sun, in addition to the error of the Sun's direction: 0.01
to 0.07 rad on simulated spinners whose panels get 10 to 30 % of the Earth's light. Axes that are turned are named if they leave
less than this part of what the stated axes, and any others, leave."""

ROUNDS, STEPS, TOLERANCE = 2, 10, 0.05


class Seen(NamedTuple):
    """What n samples show whatever the attitude: `t_s`; `field` (n, 3), any unit, NaN where none; `sun` (n, 3) and its
    covariance, NaN where none; `light` (n): 1 the Sun is up, 0 it is dark, NaN not known."""

    t_s: np.ndarray
    field: np.ndarray
    sun: np.ndarray
    covariance: np.ndarray
    light: np.ndarray


class Predicted(NamedTuple):
    """For K shifts: strength of the field (K, n) T, its component to the Sun (K, n) T, part of the Sun seen (K, n)."""

    strength: np.ndarray
    to_sun: np.ndarray
    lit: np.ndarray

    def take(self, shifts: Any) -> Predicted:
        return Predicted(*(part[shifts] for part in self))


class Fits(NamedTuple):
    """For K shifts: the cost; matrix and zero of the magnetometer (K, 12); scatter (K, 2) of strength (part of the field) and of
    the component to the Sun (sigmas of the Sun)."""

    cost: np.ndarray
    calibration: np.ndarray
    scatter: np.ndarray


def seen_in(assessment: Assessment, most: int = MOST_SAMPLES) -> Seen:
    """At most so many samples of a telemetry file, those that show field and Sun first."""
    telemetry = assessment.sensors
    time = telemetry["time"].values
    n, nothing = len(time), np.full((len(time), 3), np.nan)
    reading = telemetry["field_B"].values if "field_B" in telemetry else nothing
    sun, covariance, light = nothing, np.full((n, 3, 3), np.nan), np.full(n, np.nan)
    by_earth = np.zeros(n, dtype=bool)
    if assessment.has_panels:
        found, by_earth = sun_by_panels(assessment)
        sun, covariance = found["sun_B"].values, found["sun_cov_B"].values
        status = found["status"].values
        light = np.where(
            status == SunStatus.MISSING, np.nan, np.where(status == SunStatus.DARK, 0.0, 1.0)
        )
    if "sun_sensor_B" in telemetry:
        there = np.array(np.isfinite(telemetry["sun_sensor_B"].values).all(axis=1))
        sun = np.where(there[:, None], telemetry["sun_sensor_B"].values, sun)
        covariance = np.where(
            there[:, None, None], telemetry["sun_sensor_cov_B"].values, covariance
        )
        light = np.where(there, 1.0, np.where(np.isfinite(light), light, 0.0))
        by_earth &= ~there
    known = np.asarray(
        np.isfinite(covariance).all(axis=(1, 2))
    )  # without an error it is no reading
    sun = np.where(known[:, None], sun, np.nan)
    field = np.asarray(np.isfinite(reading).all(axis=1))
    use = spread_evenly(
        telemetry,
        field | np.isfinite(light),
        most,
        field & np.asarray(np.isfinite(sun).all(axis=1)),
    )
    seen, by_earth = (
        Seen(*(part[use] for part in (time, reading, sun, covariance, light))),
        by_earth[use],
    )
    return seen._replace(
        covariance=seen.covariance
        + earth_variance(by_earth.sum()) * by_earth[:, None, None] * np.eye(3)
    )


def sun_by_panels(assessment: Assessment) -> tuple[xr.Dataset, np.ndarray]:
    """Sun directions without those of panels that the Earth may have lit, and which samples (n) rest on a panel with no other
    opposite to it, of which nothing tells the Earth's light."""
    found, vehicle = assessment.sun, assessment.vehicle
    facing = vehicle.response_in().facing_B
    alone = ~opposite_panels(facing).any(axis=1)
    full = assessment.quality.attrs["full_sun"] * vehicle.input_gains
    share = signals(assessment.telemetry) / full
    rests = found["lit"].values & alone
    doubtful = (rests & (share < EARTH_MOST)).any(axis=1)
    return found.assign(
        sun_B=found["sun_B"].where(~xr.DataArray(doubtful, dims="time"))
    ), rests.any(axis=1) & ~doubtful


def earth_variance(count: int) -> float:
    """Of each component of a direction that rests on a panel with no other opposite to it, rad^2, where so many samples do."""
    return EARTH_RAD**2 * max(count / EARTH_ALIKE, 1.0)


def spread_evenly(
    telemetry: xr.Dataset, shows: np.ndarray, most: int, first: np.ndarray | None = None
) -> np.ndarray:
    """The samples that show something (n, of true and false) and came in time, at most so many of them, spread over the file. Of
    those that come `first` (n), as many are kept as an even spread has, or `MOST_WITH_SUN` of all if that is more."""
    use = np.flatnonzero(shows & ~find_late_frames(telemetry))
    even = _even(use, most)
    wanted = use[first[use]] if first is not None else use[:0]
    if (
        first is None
        or len(even) == len(use)
        or first[even].sum() >= min(len(wanted), int(MOST_WITH_SUN * most))
    ):
        return even
    kept = _even(wanted, int(MOST_WITH_SUN * most))
    return np.sort(np.concatenate([kept, _even(np.setdiff1d(use, wanted), most - len(kept))]))


def _even(index: np.ndarray, most: int) -> np.ndarray:
    return (
        index[np.unique(np.linspace(0, len(index) - 1, min(len(index), most)).astype(int))]
        if len(index)
        else index
    )


def predict(
    orbit: Orbit, seen: Seen, shifts: np.ndarray, node_rad: float = 0.0, phase_s: float = 0.0
) -> Predicted:
    """What samples should show at shifts (K) s beside the orbit's own, its node turned and itself so many s farther along."""
    sky = AlongTrack.of(orbit, seen.t_s, shifts, node_rad, phase_s)
    return Predicted(
        np.linalg.norm(sky.field, axis=-1), (sky.field * sky.sun).sum(axis=-1), sky.lit
    )


class State(NamedTuple):
    """Unknowns (K, 12): the matrix over its first scale less one, by rows, and the zero over the field; predictions; scatters, and
    the scale (K) over the first, which is any where the zero is large: how far soft iron can bend the matrix is a part of it."""

    unknown: np.ndarray
    strength: np.ndarray
    to_sun: np.ndarray
    scatter: np.ndarray
    scale: np.ndarray


class Calibrated(NamedTuple):
    """A magnetometer calibrated at K shifts: the model and its state, in units of the readings (theirs) and of the field (T)."""

    model: Model
    state: State
    unit: float
    unit_T: float

    @property
    def values(self) -> np.ndarray:
        """Matrix and zero (K, 12): field (T) = matrix reading - zero."""
        scale = self.unit_T / self.unit
        matrix, zero = (
            scale * (np.eye(3).ravel() + self.state.unknown[:, :9]),
            self.unit_T * self.state.unknown[:, 9:],
        )
        return np.concatenate([matrix, zero], axis=1)


def calibrated(
    seen: Seen, there: Predicted, scatter: np.ndarray | None = None, steps: int = STEPS
) -> Calibrated:
    """The magnetometer's calibration at each shift by samples that have a field; residuals have Student's tails, and their scatter
    is fitted too, or given (2).

    First the strength of the field is fitted, which gets near from anywhere. But noise in the readings draws such a fit to a matrix
    that is too small, with far too large a zero (regression dilution). So, from there, the distance of the readings is.
    """
    size = np.linalg.norm(seen.field, axis=1)
    unit = float(np.median(size[size > 0])) if (size > 0).any() else 1.0
    unit_T, n_shift = float(np.median(there.strength)), len(there.strength)
    state = State(
        np.zeros((n_shift, 12)),
        there.strength / unit_T,
        there.to_sun / unit_T,
        np.tile([0.1, 1.0] if scatter is None else scatter, (n_shift, 1)),
        np.ones(n_shift),
    )
    model = Model(seen.field / unit, seen.sun, seen.covariance)
    state = _in_turn(
        model,
        _better_start(model, state, _sphere(seen.field / unit, state)),
        scatter is None,
        steps,
    )
    model = Model(seen.field / unit, seen.sun, seen.covariance, of_readings=True)
    if scatter is not None:
        return Calibrated(model, _in_turn(model, state, False, steps), unit, unit_T)
    state = _in_turn(model, state._replace(scatter=model.scatter(state)), True, steps)
    best = np.full(n_shift, model.linearise(state).cost.argmin())
    other = state._replace(
        unknown=state.unknown[best], scatter=state.scatter[best], scale=state.scale[best]
    )
    other = _in_turn(
        model, other, True, steps
    )  # from the calibration of the best shift: each may rest in a minimum of its own
    return Calibrated(model, _better_start(model, state, other), unit, unit_T)


def _sphere(reading: np.ndarray, state: State) -> State:
    """The state with the zero and the one scale for all axes that fit the strengths (K, n), linear in both: r^2 = 2 r.z - z^2 +
    (B / scale)^2. It is near the truth if the zero is several times the field, which a search from no zero need not reach."""
    n_shift = len(state.strength)
    design = np.empty((*state.strength.shape, 5))
    design[..., :3], design[..., 3], design[..., 4] = 2 * reading, 1.0, state.strength**2
    turned = np.swapaxes(design, 1, 2)
    weak = 1e-9 * np.einsum("kii->k", turned @ design)[:, None, None] * np.eye(5)
    best = np.linalg.solve(turned @ design + weak, turned @ (reading**2).sum(axis=1)[:, None])[
        ..., 0
    ]
    scale = np.where(best[:, 4] > 0, np.maximum(best[:, 4], 1e-12) ** -0.5, 1.0).clip(
        LEAST_SCALE, 1 / LEAST_SCALE
    )
    matrix = (scale - 1)[:, None] * np.eye(3).ravel()
    zero = np.where(best[:, 4:] > 0, scale[:, None] * best[:, :3], 0.0)
    return state._replace(
        unknown=np.concatenate([matrix, zero], axis=1), scale=scale * np.ones(n_shift)
    )


def _better_start(model: Model, state: State, other: State) -> State:
    """Of two states, for each shift, the one that costs less."""
    better = model.linearise(other).cost < model.linearise(state).cost
    return State(
        *(
            np.where(better.reshape(-1, *(1,) * (new.ndim - 1)), new, old)
            for new, old in zip(other, state, strict=True)
        )
    )


def _in_turn(model: Model, state: State, free: bool, steps: int) -> State:
    """Unknowns, their scale and, if `free`, the scatters fitted in turn."""
    for _ in range(ROUNDS if free else 1):
        state = least_squares(
            model.linearise, stepped, solve_dense, state, steps=steps, tolerance=TOLERANCE
        ).state
        state = state._replace(
            scatter=model.scatter(state) if free else state.scatter, scale=model.scale(state)
        )
    return state


def fit(seen: Seen, there: Predicted, prior: np.ndarray, scatter: np.ndarray | None = None) -> Fits:
    """What each shift (K) costs beside its `prior` (K), and the magnetometer's calibration there; `scatter`: see `calibrated`."""
    use = np.isfinite(seen.field).all(axis=1)
    cost = prior + eclipse_cost(seen.light, there.lit)
    if use.sum() < FEWEST:
        return Fits(cost, np.full((len(prior), 12), np.nan), np.full((len(prior), 2), np.nan))
    some = Predicted(*(part[:, use] for part in there))
    found = calibrated(Seen(*(part[use] for part in seen)), some, scatter)
    system = found.model.linearise(found.state)
    cost = (
        cost + system.cost + np.linalg.slogdet(system.matrix)[1] / 2
    )  # all calibrations count, not the best alone
    return Fits(cost, found.values, found.state.scatter)


def stepped(state: State, step: np.ndarray) -> State:
    return state._replace(unknown=state.unknown + step)


class Model:
    """Residuals of readings (n, 3), in units of their median, with Sun directions (n, 3; NaN: none) and their covariance; those of
    the strength in the field, or `of_readings`: how far the reading is from one of the strength predicted."""

    def __init__(
        self,
        reading: np.ndarray,
        sun: np.ndarray,
        covariance: np.ndarray,
        of_readings: bool = False,
    ) -> None:
        self.of_readings = of_readings
        self.reading, self.with_sun = reading, np.isfinite(sun).all(axis=1)
        self.sun = sun[self.with_sun]
        size = np.linalg.norm(reading[self.with_sun], axis=1, keepdims=True)
        unit = reading[self.with_sun] / np.where(size > 0, size, 1.0)
        across = unit - (unit * self.sun).sum(axis=1, keepdims=True) * self.sun
        self.sigma = np.sqrt(
            np.einsum("ni,nij,nj->n", across, covariance[self.with_sun], across) + 0.02**2
        )
        # the mean of the diagonal is the scale, which is free
        isotropic = np.eye(3).ravel() / np.sqrt(3)
        tied = np.eye(9) - np.outer(isotropic, isotropic)
        self.free, self.tied = np.diag(np.repeat([0.1, ZERO_SIGMA**-2], [9, 3])), np.zeros((12, 12))
        self.tied[:9, :9] = tied / MATRIX_SIGMA**2

    def prior(self, state: State) -> np.ndarray:
        """Information (K, 12, 12) on the unknowns before the data."""
        return self.free + self.tied / state.scale[:, None, None] ** 2

    @staticmethod
    def scale(state: State) -> np.ndarray:
        """The scale (K) that the matrix has."""
        determinant = np.linalg.det(np.eye(3) + state.unknown[:, :9].reshape(-1, 3, 3))
        return np.maximum(np.cbrt(np.abs(determinant)), LEAST_SCALE)

    def residuals(self, state: State) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Of strength (K, n) and component to the Sun (K, m), in units of their scatter, and their Jacobians (K, ., 12)."""
        matrix, field, length, unit = self.fields(state)
        read = unit @ matrix
        steep = self.steepness(unit, matrix)
        strength = (length - state.strength) / steep / state.scatter[:, :1]
        along = unit / state.scatter[:, :1, None]
        if self.of_readings:
            bent = read @ np.swapaxes(matrix, 1, 2) - (steep**2)[..., None] * unit
            along = along - (strength / length / steep)[..., None] * bent
        by_strength = self._by_unknown(along / steep[..., None], self.reading)
        if self.of_readings:
            spun = (strength / steep**2)[..., None, None] * unit[..., :, None] * read[..., None, :]
            by_strength[..., :9] -= spun.reshape(*strength.shape, 9)
        there = state.strength[:, self.with_sun]
        weight = 1 / (there * self.sigma * state.scatter[:, 1:])
        to_sun = (
            (field[:, self.with_sun] * self.sun).sum(axis=2) - state.to_sun[:, self.with_sun]
        ) * weight
        by_sun = self._by_unknown(
            np.broadcast_to(self.sun, (len(field), *self.sun.shape)), self.reading[self.with_sun]
        )
        return strength, to_sun, by_strength, by_sun * weight[..., None]

    def fields(self, state: State) -> tuple[np.ndarray, ...]:
        """Matrices (K, 3, 3), fields (K, n, 3), their strengths (K, n) and directions (K, n, 3)."""
        matrix = np.eye(3) + state.unknown[:, :9].reshape(-1, 3, 3)
        field = self.reading @ np.swapaxes(matrix, 1, 2) - state.unknown[:, None, 9:]
        length = np.maximum(np.linalg.norm(field, axis=2), 1e-9)
        return matrix, field, length, field / length[..., None]

    def steepness(self, unit: np.ndarray, matrix: np.ndarray) -> np.ndarray:
        """By how much the strength (K, n) of fields in directions (K, n, 3) changes with the reading: a matrix (K, 3, 3) that
        shrinks readings shrinks their noise."""
        return (
            np.maximum(np.linalg.norm(unit @ matrix, axis=2), 1e-9)
            if self.of_readings
            else np.ones(unit.shape[:2])
        )

    @staticmethod
    def _by_unknown(direction: np.ndarray, reading: np.ndarray) -> np.ndarray:
        rows = (direction[..., :, None] * reading[None, :, None, :]).reshape(
            *direction.shape[:2], 9
        )
        return np.concatenate([rows, -direction], axis=2)

    def linearise(self, state: State) -> DenseSystem:
        strength, to_sun, by_strength, by_sun = self.residuals(state)
        matrix = self.prior(state)
        slope = (matrix @ state.unknown[..., None])[..., 0]
        cost = (slope * state.unknown).sum(axis=1) / 2 + TIED * np.log(state.scale)
        for k, (residual, by) in enumerate(((strength, by_strength), (to_sun, by_sun))):
            weight = student_weight(residual)
            cost = cost + (STUDENT + 1) / 2 * np.log1p(residual**2 / STUDENT).sum(axis=1)
            cost = cost + residual.shape[1] * np.log(state.scatter[:, k])
            turned = np.swapaxes(by * weight[..., None], 1, 2)
            slope = slope + (turned @ residual[..., None])[..., 0]
            matrix = matrix + turned @ by
        return DenseSystem(cost, matrix, slope)

    def scatter(self, state: State) -> np.ndarray:
        """The scatters (K, 2) that make the residuals likeliest, given their weights and how much of them has been fitted."""
        least, covariance = (
            np.array([LEAST_FIELD, LEAST_SINE]),
            np.linalg.inv(self.linearise(state).matrix),
        )
        found = []
        strength, to_sun, by_strength, by_sun = self.residuals(state)
        for k, (residual, by) in enumerate(((strength, by_strength), (to_sun, by_sun))):
            weight = student_weight(residual)
            free = residual.shape[1] - ((by @ covariance) * by).sum(axis=(1, 2))
            rms = (
                np.sqrt((weight * residual**2).sum(axis=1) / np.maximum(free, 1.0))
                if residual.shape[1]
                else 1.0
            )
            found.append(np.maximum(state.scatter[:, k] * rms, least[k]))
        return np.stack(found, axis=1)


def student_weight(residual: np.ndarray) -> np.ndarray:
    """How much residuals (...), in units of their scatter, count under the Student law."""
    return (STUDENT + 1) / (STUDENT + residual**2)


def angles(field: np.ndarray, sun: np.ndarray) -> np.ndarray:
    """Angles (n) in rad between fields and Suns (n, 3), NaN where one is not known."""
    return np.arccos(np.clip((field * sun).sum(axis=-1) / np.linalg.norm(field, axis=-1), -1, 1))


def contradicted(seen: Seen, there: Predicted, calibration: np.ndarray) -> bool:
    """Whether `FEWEST` samples or more show an angle between field and Sun that is not the one predicted (one shift)."""
    off = np.abs(
        angles(seen.field @ calibration[:9].reshape(3, 3).T - calibration[9:], seen.sun)
        - predicted_angles(there)
    )
    both = np.isfinite(off)
    stated = np.sqrt(np.trace(seen.covariance[both], axis1=1, axis2=2) / 2)
    return bool(
        both.sum() >= FEWEST
        and np.median(off[both]) > MOST_ANGLE_RAD + np.median(np.minimum(stated, MOST_ANGLE_RAD))
    )


def predicted_angles(there: Predicted) -> np.ndarray:
    """Angles (n) in rad between field and Sun where an orbit at its one shift puts them."""
    return np.arccos(np.clip(there.to_sun[0] / there.strength[0], -1, 1))


def turned_axes(seen: Seen, there: Predicted) -> tuple[str, list[int], tuple[float, ...]] | None:
    """How the columns of a magnetometer must be read as axes (as :func:`signed_axes` lists it) for its angle to the Sun to be
    the one predicted (one shift), if as stated it is not; None if it is, or if another reading does as well.

    The strength of the field determines zero and matrix but for a rotation or mirror, so readings are compared by the angle
    alone. That all axes point the other way is the business of the check.
    """
    use = np.isfinite(seen.field).all(axis=1)
    if (use & np.isfinite(seen.sun).all(axis=1)).sum() < FEWEST:
        return None
    some, part = Seen(*(each[use] for each in seen)), Predicted(*(each[:, use] for each in there))
    values = calibrated(some._replace(sun=np.full_like(some.sun, np.nan)), part).values[0]
    field = some.field @ values[:9].reshape(3, 3).T - values[9:]
    ways, known = list(signed_axes()), predicted_angles(part)
    left = np.array(
        [
            np.nanmedian(np.abs(angles(field[:, order] * sign, some.sun) - known))
            for _, order, sign in ways
        ]
    )
    best, second = np.argsort(left)[:2]
    reversed_all = np.array_equal(axes_matrix(*ways[best][1:]), -np.eye(3))
    clear = left[best] < min(CLEARER * min(left[0], left[second]), MOST_ANGLE_RAD)
    return ways[best] if clear and not reversed_all else None


def axes_words(way: tuple[str, list[int], tuple[float, ...]], assessment: Assessment) -> str:
    """What :func:`turned_axes` says, in words, and what to write into the vehicle file."""
    vehicle, telemetry = assessment.vehicle, assessment.telemetry
    what, order, sign = way
    magnetometer = vehicle.sensors.magnetometer
    do = (
        ""
        if magnetometer is None
        else f"; {to_write('magnetometer', magnetometer.keys_for_axes(order, sign))}"
    )
    change = Change("the magnetometer", axes={"field_B": axes_matrix(order, sign)})
    same = alike(Observed.of(vehicle, telemetry), change, column_changes(vehicle, telemetry))
    others = " or ".join(one.what for one, _ in same)
    instead = f", or, which looks the same, {others}: find out which before you set it"
    return (
        f"the magnetometer {what} has the angle to the Sun that the orbit predicts, and with the columns of the file it does not"
        f"{do}{instead if others else ''}"
    )


def eclipse_cost(light: np.ndarray, part: np.ndarray) -> np.ndarray:
    """Minus the log likelihood (K) of light and dark where part (K, n) of the Sun is predicted; how often it is dark in the Sun
    (a face that sees nothing, an idle panel) is fitted."""
    known = np.isfinite(light)
    dark, sunny = light[known] == 0, part[:, known]
    in_sun = (sunny * dark).sum(axis=1) / np.maximum(sunny.sum(axis=1), 1)
    in_sun = np.clip(in_sun, 0.5 / max(len(dark), 1), 1 - SEEN_IN_SHADOW)[:, None]
    chance = sunny * in_sun + (1 - sunny) * (1 - SEEN_IN_SHADOW)
    return -np.where(dark, np.log(chance), np.log1p(-chance)).sum(axis=1)
