"""Magnetometer and Sun sensors calibrated in a known orbit, the attitude of each sample being unknown.

In each sample the Sun and the field have known directions in J2000, and the field a known strength; the attitude (three unknowns)
turns both into the body, where the sensors read them. Two angles of the Sun and three components of the field leave two conditions
a sample: the field's strength and its angle to the Sun; where a second face or the panels see the Sun too, more. Zero and matrix of
the magnetometer, bias and scale of each Sun sensor, the along-track offset and its drift are common to the whole file. They are
fitted together with all attitudes, under Student tails of each sample and with the noise of each kind of sensor estimated. This is
Deming's regression: that both angles read and angles by the field are noisy draws no scale down. Integrating the attitudes out
instead, as if any were as likely, would.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from sunspin.environment.earth import rotate_vectors
from sunspin.environment.orbit import Orbit
from sunspin.estimate.orbit.along_track import AlongTrack
from sunspin.estimate.orbit.invariants import (
    MATRIX_SIGMA,
    STUDENT,
    ZERO_SIGMA,
    earth_variance,
    spread_evenly,
    sun_by_panels,
)
from sunspin.solve.least_squares import least_squares
from sunspin.solve.linear import DenseSystem, solve_dense
from sunspin.solve.rotations import cross_matrix, rotate_attitude, tangent_basis
from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.repeats import GAP_FACTOR
from sunspin.vehicle import Vehicle

SCALE_FREE = 3.0
"""Prior sigma of the magnetometer's scale over the first, which is free."""

BIAS_SIGMA_RAD, ANGLE_SCALE_SIGMA = 0.1, 0.2
"""Of a Sun sensor's bias, and of its scales over those stated, where the vehicle file states none."""

MOST_SAMPLES = 600
"""Samples that magnetometer and Sun sensors are calibrated by, spread evenly."""

FEWEST = 40
"""Conditions that samples must put on the unknowns before magnetometer and Sun sensors are calibrated."""

SHIFTS = 31
"""Of these the one is taken from which the fit begins."""

REACH, STEP_S, MOST_STEPS = 4.0, 20.0, 24
"""The field is computed within so many sigmas of the shift, in such steps, with as many on a side; wider ones where they do not
suffice."""

PANEL_SIGMA_RAD = 0.03
"""What a direction from panels is off beside their noise: the Earth's light, normals."""

WEAK = 1e-4
"""Information (1/rad^2) that keeps a turn finite which no sensor of a sample sees."""

ROUNDING = 1e-12
"""The same as a part of all information, where a trial is far off and the information huge."""

INNER, ROUNDS, STEPS, TOLERANCE = 4, 12, 12, 0.01
WORSE = 1.3
"""A fit that leaves so many times more of the field's strength than its start rests in another minimum."""

STEADY = 0.01
"""Scatters and unknowns are fitted in turn until those change by less than this part."""

FEWEST_CLUSTERS = 6
"""With fewer passes they are cut into pieces."""


class Readings(NamedTuple):
    """What n samples show, NaN where not read: `angle` (n, F, 2) rad of each Sun sensor with `y_turned` (n, F); `sun` (n, 3) by
    panels and its sigma (n) rad; `field` (n, 3), in any unit; `pass_of` (n)."""

    t_s: np.ndarray
    angle: np.ndarray
    y_turned: np.ndarray
    sun: np.ndarray
    sun_sigma: np.ndarray
    field: np.ndarray
    pass_of: np.ndarray

    @property
    def has_sun(self) -> np.ndarray:
        return np.any(np.isfinite(self.angle[..., 0]), axis=1) | np.all(
            np.isfinite(self.sun), axis=1
        )

    @property
    def has_field(self) -> np.ndarray:
        return np.all(np.isfinite(self.field), axis=1)

    def take(self, which: np.ndarray) -> Readings:
        return Readings(*(part[which] for part in self))


class Start(NamedTuple):
    """Where the fit begins: field (T) = `matrix` reading - `zero_T`, at this shift (s) beside the orbit's own; `left_T`: the median
    that it leaves of the field's strength."""

    matrix: np.ndarray
    zero_T: np.ndarray
    shift_s: float = 0.0
    left_T: float = np.inf


@dataclass(frozen=True)
class Calibration:
    """The answer, in the units and against the values of the vehicle file with which the telemetry was read.

    `matrix_T` (3, 3) and `zero` (3): field in T = matrix_T (reading - zero); `bias` (F, 2) rad still in each sensor's angles and
    `scale` (F, 3): true angle = (angle - bias) / scale, of x, y and turned y; `shift_s`, `drift_s_day`. `noise_T` of a component of
    the field, `sun_noise`, `panel_noise` in units of the stated sigmas. `values` (D) of all unknowns with their covariances (D, D):
    `model` by the curvature, `robust` by leaving out each pass (jackknife), and `prior`. `strength` (2) and `angle` (2): median
    residuals in T and rad before and after. `samples`: by what they show.
    """

    values: np.ndarray
    model: np.ndarray
    robust: np.ndarray
    prior: np.ndarray
    unit_T: float
    unit: float
    faces: int
    noise_T: float
    sun_noise: float
    panel_noise: float
    strength: np.ndarray
    angle: np.ndarray
    samples: dict[str, int]

    @property
    def matrix_T(self) -> np.ndarray:
        return np.linalg.inv(np.eye(3) + self.values[:9].reshape(3, 3)) * self.unit_T / self.unit

    @property
    def zero(self) -> np.ndarray:
        return self.unit * self.values[9:12]

    @property
    def covariance(self) -> np.ndarray:
        """That of the curvature (D, D), each sigma widened to that by the scatter between passes where this is larger."""
        wider = np.sqrt(np.maximum(np.diag(self.robust) / np.diag(self.model), 1.0))
        return self.model * np.outer(wider, wider)

    @property
    def shift_s(self) -> float:
        return float(self.values[12])

    @property
    def shift_sigma_s(self) -> float:
        return float(np.sqrt(self.covariance[12, 12]))

    @property
    def drift_s_day(self) -> float:
        return float(self.values[13])

    @property
    def drift_sigma_s_day(self) -> float:
        return float(np.sqrt(self.covariance[13, 13]))

    @property
    def bias(self) -> np.ndarray:
        return self.values[14:].reshape(self.faces, 5)[:, :2]

    @property
    def scale(self) -> np.ndarray:
        return 1 + self.values[14:].reshape(self.faces, 5)[:, 2:]


def fit_in_orbit(
    orbit: Orbit, vehicle: Vehicle, seen: Readings, start: Start, prior: np.ndarray
) -> Calibration:
    """Calibrate by these readings, from a start or from the sphere that explains the field's strength, whichever fits better;
    `prior` (D): one sigma of each unknown (those of :func:`priors`)."""
    half = int(np.clip(np.ceil(REACH * prior[12] / STEP_S), 4, MOST_STEPS))
    sky = AlongTrack.of(orbit, seen.t_s, REACH * prior[12] / half * np.arange(-half, half + 1))
    dark = sky.lit_at(start.shift_s) < 0.5  # what is seen there is not the Sun
    seen = seen._replace(
        angle=np.where(dark[:, None, None], np.nan, seen.angle),
        sun=np.where(dark[:, None], np.nan, seen.sun),
    )
    keep = seen.has_field | seen.has_sun
    seen, sky = seen.take(keep), sky.take(keep)
    unit_T = float(np.median(np.linalg.norm(sky.at(start.shift_s)[0], axis=1)))

    def begun(one: Start, unit: float) -> tuple[_Model, _State]:
        model = _Model(
            vehicle, seen._replace(field=seen.field / unit), sky, unit_T, _precision(prior, unit)
        )
        inverse, first = np.linalg.inv(one.matrix), np.zeros(len(prior))
        first[:9] = (inverse * unit_T / unit - np.eye(3)).ravel()
        first[9:12], first[12] = inverse @ one.zero_T / unit, one.shift_s
        return model, _State(first[None], model.triads(first)[None])

    found = []
    sphere = _sphere(seen, sky, prior[12])
    for one in (start,) if sphere is None else (sphere, start):
        unit = unit_T * abs(np.linalg.det(one.matrix)) ** (-1 / 3)
        unknown = _settled(*begun(one, unit), rounds=2)[1].unknown[0]
        back = np.linalg.inv(np.eye(3) + unknown[:9].reshape(3, 3)) * unit_T / unit
        own = unit_T * abs(np.linalg.det(back)) ** (
            -1 / 3
        )  # the prior is about a matrix near one in this unit
        model, state = _settled(*begun(Start(back, unit * back @ unknown[9:12], unknown[12]), own))
        found.append((model.left_of_both(state.unknown[0]), model, state, own))
    _, model, state, unit = min(found, key=lambda each: each[0])
    return model.answer(state, unit)


def by_sun_sensors(orbit: Orbit, assessment: Assessment, start: Start) -> Calibration | None:
    """The calibration of a file whose Sun sensors may be off, from a start; None where it has none, too few samples show them
    and the field, or the fit is clearly worse than its start."""
    vehicle = assessment.vehicle
    if "sun_sensor_angle" not in assessment.telemetry or not vehicle.sensors.sun_sensors:
        return None
    seen = readings(assessment)
    if seen.has_field.sum() + (seen.has_field & seen.has_sun).sum() < FEWEST:
        return None
    made = fit_in_orbit(orbit, vehicle, seen, start, priors(vehicle, seen, orbit))
    return made if made.strength[1] < WORSE * start.left_T else None


def _settled(model: _Model, state: _State, rounds: int = ROUNDS) -> tuple[_Model, _State]:
    """Unknowns and scatters fitted in turn."""
    for _ in range(rounds):
        solution = least_squares(
            model.linearise, _stepped, solve_dense, state, steps=STEPS, tolerance=TOLERANCE
        )
        state = solution.state._replace(attitude=solution.system.extras[0])
        before, model = model, model.with_scatter(state)
        if np.allclose(model.scatter, before.scatter, rtol=STEADY):
            break
    return model, state


def _sphere(seen: Readings, sky: AlongTrack, sigma_s: float) -> Start | None:
    """Zero and one scale for all axes by the field's strength alone, at the shift within three of its sigmas where they fit best:
    r^2 = 2 r.z - z^2 + (B / scale)^2 is linear in z, z^2 and 1 / scale^2. None where no such scale is positive."""
    use = seen.has_field
    best: tuple[float, Start | None] = (np.inf, None)
    reading, some = seen.field[use], sky.take(seen.has_field)
    size = float(np.median(np.linalg.norm(reading, axis=1)))
    for shift in np.linspace(-3, 3, SHIFTS) * sigma_s:
        strength = np.linalg.norm(some.at(shift)[0], axis=1)
        middle = float(np.median(strength))
        design = np.column_stack(
            [2 * reading / size, np.ones(len(reading)), (strength / middle) ** 2]
        )
        target = (reading**2).sum(axis=1) / size**2
        found = np.linalg.lstsq(design, target, rcond=None)[0]
        left = float(np.abs(design @ found - target).sum()) / max(
            found[4], 1e-9
        )  # in units of the field
        if found[4] > 0 and left < best[0]:
            scale = middle / size / np.sqrt(found[4])
            best = left, Start(scale * np.eye(3), scale * size * found[:3], shift)
    return best[1]


def priors(vehicle: Vehicle, seen: Readings, orbit: Orbit) -> np.ndarray:
    """One sigma of each unknown before the data, the zero's in the unit of the readings: that of the vehicle file, else ours."""
    along = float(np.hypot(orbit.shift_sigma_s, orbit.clock_sigma_s))
    part, median = vehicle.sensors.magnetometer, 1.0
    if part is not None and seen.has_field.any():
        median = float(
            np.nanmedian(
                np.linalg.norm(seen.field @ np.linalg.inv(part.matrix).T + part.zero, axis=1)
            )
        )
    zero_sigma = (
        part.zero_sigma if part is not None and part.zero_sigma.any() else ZERO_SIGMA * median
    )
    found = [
        np.full(9, MATRIX_SIGMA),
        np.broadcast_to(zero_sigma, 3),
        [along, orbit.drift_sigma_s_day],
    ]
    for sensor in vehicle.sensors.sun_sensors:
        stated = {key: vehicle.facts.get(f"sun_sensor.{sensor.name}.{key}") for key in SUN_KEYS}
        own = [
            float(fact.sigma)
            if fact is not None and isinstance(fact.sigma, float) and fact.sigma > 0
            else None
            for fact in stated.values()
        ]
        size = [
            1.0,
            1.0,
            *(
                abs(value or 1.0)
                for value in (sensor.x_scale, sensor.y_scale, sensor.y_turned_scale)
            ),
        ]
        usual = [BIAS_SIGMA_RAD] * 2 + [ANGLE_SCALE_SIGMA] * 3
        found.append([usual[i] if one is None else one / size[i] for i, one in enumerate(own)])
    return np.concatenate(found)


SUN_KEYS = ("x_bias_rad", "y_bias_rad", "x_scale", "y_scale", "y_turned_scale")
"""Keys of a Sun sensor in the order of its unknowns."""


def readings(assessment: Assessment) -> Readings:
    """Those of a telemetry file that show field or Sun, spread evenly."""
    vehicle, telemetry = assessment.vehicle, assessment.sensors
    time = telemetry["time"].values
    sun, sun_sigma = _sun_by_panels(assessment)
    n, faces = len(time), len(vehicle.sensors.sun_sensors)
    angle, is_turned = np.full((n, faces, 2), np.nan), np.zeros((n, faces), dtype=bool)
    if "sun_sensor_angle" in telemetry:
        angle, is_turned = (
            telemetry["sun_sensor_angle"].values,
            telemetry["sun_sensor_y_turned"].values != 0,
        )
    field = telemetry["field_B"].values if "field_B" in telemetry else np.full((n, 3), np.nan)
    usual = np.median(np.diff(time)) if n > 1 else 1.0
    passes = np.concatenate([[0], np.cumsum(np.diff(time) > GAP_FACTOR * usual)])
    seen = Readings(
        time, angle, is_turned, sun, np.hypot(sun_sigma, PANEL_SIGMA_RAD), field, passes
    )
    both = seen.has_field & seen.has_sun
    return seen.take(spread_evenly(telemetry, seen.has_field | seen.has_sun, MOST_SAMPLES, both))


def _sun_by_panels(assessment: Assessment) -> tuple[np.ndarray, np.ndarray]:
    """Directions (n, 3) by panels, or Sun vectors as they are given, NaN where none, and sigma (n) rad of each of two angles."""
    vehicle, telemetry = assessment.vehicle, assessment.sensors
    n = telemetry.sizes["time"]
    sun, sigma = np.full((n, 3), np.nan), np.full(n, np.nan)
    if assessment.has_panels:
        found, by_earth = sun_by_panels(assessment)
        earth = np.sqrt(2 * earth_variance(min(by_earth.sum(), MOST_SAMPLES)))
        sun, sigma = found["sun_B"].values, np.hypot(found["sigma_rad"].values, earth * by_earth)
    elif (
        vehicle.sensors.sun_vector is not None
        and not vehicle.sensors.sun_sensors
        and "sun_sensor_B" in telemetry
    ):
        sun, sigma = (
            telemetry["sun_sensor_B"].values,
            np.full(n, np.sqrt(2) * vehicle.sensors.sun_vector.sigma_rad),
        )
    known = np.isfinite(sigma)  # a direction without an error is no reading
    return np.where(known[:, None], sun, np.nan), np.where(known, sigma, 1.0) / np.sqrt(2)


def _precision(prior: np.ndarray, unit: float) -> np.ndarray:
    """The prior's inverse covariance (D, D): of the matrix, its scale is free."""
    sigma = prior.copy()
    sigma[9:12] /= unit
    found = np.diag(sigma**-2.0)
    isotropic = np.eye(3).ravel() / np.sqrt(3)
    found[:9, :9] += (SCALE_FREE**-2 - MATRIX_SIGMA**-2) * np.outer(isotropic, isotropic)
    return found


# ------------------------------------------------------------------------------------------------------------------------ fitting


class _State(NamedTuple):
    """Unknowns (1, D) and attitudes (1, n, 3, 3) from which those of the best fit are sought."""

    unknown: np.ndarray
    attitude: np.ndarray


def _stepped(state: _State, step: np.ndarray) -> _State:
    return state._replace(unknown=state.unknown + step)


class _At(NamedTuple):
    """Residuals (n, R) in sigmas, their slopes by a turn (n, R, 3) and by the unknowns (n, R, D)."""

    value: np.ndarray
    by_turn: np.ndarray
    by_unknown: np.ndarray


@dataclass(frozen=True)
class _Model:
    """Residuals of readings, the field in its unit; `scatter`: of Sun sensors and panels over their sigmas, and of the field."""

    vehicle: Vehicle
    seen: Readings
    sky: AlongTrack
    unit_T: float
    precision: np.ndarray
    scatter: tuple[float, float, float] = (0.5, 1.0, 0.02)

    @property
    def kinds(self) -> np.ndarray:
        """Kind of each residual (R): 0 Sun sensor, 1 panels, 2 field."""
        return np.repeat([0, 1, 2], [2 * len(self.vehicle.sensors.sun_sensors), 2, 3])

    @property
    def read(self) -> np.ndarray:
        """Which residuals (n, R) there are."""
        n = len(self.seen.t_s)
        return np.concatenate(
            [
                np.isfinite(self.seen.angle).reshape(n, -1),
                np.isfinite(self.seen.sun[:, :2]),
                np.isfinite(self.seen.field),
            ],
            axis=1,
        )

    @property
    def conditions(self) -> np.ndarray:
        """How many conditions (n) the readings of a sample put on the unknowns, beside those that its attitude takes up."""
        read = self.read
        sun, field = read[:, :-3].sum(axis=1), read[:, -3:].all(axis=1)
        return np.maximum(read.sum(axis=1) - np.where(field & (sun > 0), 3, 2), 0)

    def triads(self, unknown: np.ndarray) -> np.ndarray:
        """Attitudes (n, 3, 3) to begin with, from one reading of the Sun and the field."""
        sun_N, field_N = self.sky.sun, self.sky.at(unknown[12], unknown[13])[0]
        sun_N, field_N = sun_N * self.seen.has_sun[:, None], field_N * self.seen.has_field[:, None]
        sun = np.nan_to_num(self.seen.sun)
        for k, sensor in enumerate(self.vehicle.sensors.sun_sensors):
            x, y = np.nan_to_num(self.seen.angle[:, k]).T
            side = np.cross(sensor.normal_B, sensor.x_axis_B)
            direction = (
                sensor.normal_B + np.tan(x)[:, None] * sensor.x_axis_B + np.tan(y)[:, None] * side
            )
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            sun = sun + np.isfinite(self.seen.angle[:, k, :1]) * direction
        field = (
            np.nan_to_num(self.seen.field - unknown[9:12])
            @ np.linalg.inv(np.eye(3) + unknown[:9].reshape(3, 3)).T
        )
        return _triad(field, sun) @ np.swapaxes(_triad(field_N, sun_N), -1, -2)

    def _residuals(
        self,
        unknown: np.ndarray,
        attitude: np.ndarray,
        sky: tuple[np.ndarray, ...],
        whole: bool = True,
    ) -> _At:
        sun_N, field_N, by_shift = sky[:3]
        sun, field = rotate_vectors(attitude, sun_N), rotate_vectors(attitude, field_N)
        n, d = len(sun), len(unknown) if whole else 0
        parts = [
            self._of_sensor(k, unknown, sun, d)
            for k in range(len(self.vehicle.sensors.sun_sensors))
        ]
        e1, e2 = tangent_basis(
            np.nan_to_num(self.seen.sun) + (~np.isfinite(self.seen.sun)) * [0.0, 0.0, 1.0]
        )
        weight = 1 / (self.seen.sun_sigma * self.scatter[1])
        value = np.column_stack([(e1 * sun).sum(axis=1), (e2 * sun).sum(axis=1)]) * weight[:, None]
        by_turn = np.stack([e1, e2], axis=1) @ cross_matrix(sun) * weight[:, None, None]
        parts.append((value, by_turn, np.zeros((n, 2, d))))
        matrix = np.eye(3) + unknown[:9].reshape(3, 3)
        by_unknown = np.zeros((n, 3, d))
        for i in range(3 if whole else 0):
            by_unknown[:, i, 3 * i : 3 * i + 3] = field
            by_unknown[:, i, 9 + i] = 1.0
        if whole:
            along = rotate_vectors(attitude, by_shift) @ matrix.T
            by_unknown[:, :, 12], by_unknown[:, :, 13] = along, along * self.sky.days[:, None]
        value = field @ matrix.T + unknown[9:12] - self.seen.field
        parts.append(
            tuple(
                part / self.scatter[2] for part in (value, matrix @ cross_matrix(field), by_unknown)
            )
        )
        read = self.read
        value, by_turn, by_unknown = (
            np.concatenate(part, axis=1) for part in zip(*parts, strict=True)
        )
        return _At(
            np.where(read, value, 0.0),
            np.where(read[..., None], by_turn, 0.0),
            np.where(read[..., None], by_unknown, 0.0),
        )

    def _of_sensor(
        self, k: int, unknown: np.ndarray, sun: np.ndarray, d: int
    ) -> tuple[np.ndarray, ...]:
        """Residuals (n, 2) of a Sun sensor's angles and their slopes."""
        sensor, place = self.vehicle.sensors.sun_sensors[k], 14 + 5 * k
        n, high = len(sun), sun @ sensor.normal_B
        value, by_turn, by_unknown = np.zeros((n, 2)), np.zeros((n, 2, 3)), np.zeros((n, 2, d))
        for side, axis in enumerate((sensor.x_axis_B, np.cross(sensor.normal_B, sensor.x_axis_B))):
            wide = sun @ axis
            true = np.arctan2(wide, high)
            which = place + np.where((side == 1) & self.seen.y_turned[:, k], 4, 2 + side)
            scale = 1 + unknown[which]
            inverse = 1 / ((sensor.x_sigma_rad, sensor.y_sigma_rad)[side] * self.scatter[0])
            value[:, side] = (
                scale * true + unknown[place + side] - self.seen.angle[:, k, side]
            ) * inverse
            by_sun = (high[:, None] * axis - wide[:, None] * sensor.normal_B) / np.maximum(
                high**2 + wide**2, 1e-6
            )[:, None]
            by_turn[:, side] = (
                inverse * scale[:, None] * (by_sun[:, None] @ cross_matrix(sun))[:, 0]
            )
            if d:
                by_unknown[np.arange(n), side, which] = true * inverse
                by_unknown[:, side, place + side] = inverse
        return value, by_turn, by_unknown

    def _sky(self, unknown: np.ndarray) -> tuple[np.ndarray, ...]:
        field, slope = self.sky.at(unknown[12], unknown[13])
        return self.sky.sun, field / self.unit_T, slope / self.unit_T

    def _settled(
        self, unknown: np.ndarray, attitude: np.ndarray
    ) -> tuple[np.ndarray, _At, np.ndarray]:
        """Attitudes that fit best, what is there, and the inverse of the turns' information (n, 3, 3)."""
        sky = self._sky(unknown)
        for _ in range(INNER):
            at = self._residuals(unknown, attitude, sky, whole=False)
            back = np.linalg.inv(_information(at.by_turn))
            step = -rotate_vectors(back, np.einsum("nri,nr->ni", at.by_turn, at.value))
            attitude = rotate_attitude(attitude, np.clip(step, -0.5, 0.5))
        at = self._residuals(unknown, attitude, sky)
        return attitude, at, np.linalg.inv(_information(at.by_turn))

    def linearise(self, state: _State) -> DenseSystem:
        unknown = state.unknown[0]
        attitude, scores, matrix, cost = self._scores(unknown, state.attitude[0])
        slope = self.precision @ unknown + scores.sum(axis=0)
        total = unknown @ self.precision @ unknown / 2 + cost
        return DenseSystem(
            np.array([total]),
            (self.precision + matrix)[None],
            slope[None],
            extras=(attitude[None],),
        )

    def _scores(
        self, unknown: np.ndarray, attitude: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
        """Attitudes, slope (n, D) of each sample's cost, curvature (D, D) and the cost, the prior left out."""
        attitude, at, back = self._settled(unknown, attitude)
        alone = self._projected(at, back)
        square = (at.value**2).sum(axis=1)
        weight = (STUDENT + self.conditions) / (STUDENT + square)
        scores = weight[:, None] * np.einsum("nrd,nr->nd", at.by_unknown, at.value)
        matrix = _summed(weight, alone)
        cost = ((STUDENT + self.conditions) / 2 * np.log1p(square / STUDENT)).sum()
        logs = (self.read.sum(axis=0) * np.log(np.array(self.scatter)[self.kinds])).sum()
        return attitude, scores, matrix, float(cost + logs)

    @staticmethod
    def _projected(at: _At, back: np.ndarray) -> np.ndarray:
        """Slopes (n, R, D) of residuals by the unknowns when the attitudes follow these."""
        return at.by_unknown - at.by_turn @ (
            back @ (np.swapaxes(at.by_turn, -1, -2) @ at.by_unknown)
        )

    def with_scatter(self, state: _State) -> _Model:
        """With the scatters that make the residuals likeliest, given their weights and what has been fitted to them."""
        unknown = state.unknown[0]
        _, at, back = self._settled(unknown, state.attitude[0])
        alone = self._projected(at, back)
        weight = (STUDENT + self.conditions) / (STUDENT + (at.value**2).sum(axis=1))
        covariance = np.linalg.inv(self.precision + _summed(weight, alone))
        taken = ((at.by_turn @ back) * at.by_turn).sum(axis=2)
        taken = taken + weight[:, None] * ((alone @ covariance) * alone).sum(axis=2)
        free = np.where(self.read, 1 - taken, 0.0)
        found = []
        for k, old in enumerate(self.scatter):
            which = self.kinds == k
            left = free[:, which].sum()
            ratio = (weight[:, None] * at.value**2)[:, which].sum() / left if left > 3 else 1.0
            found.append(float(np.clip(old * np.sqrt(ratio), 1e-3, 100)))
        return replace(self, scatter=(found[0], found[1], found[2]))

    def answer(self, state: _State, unit: float) -> Calibration:
        unknown = state.unknown[0]
        _, scores, _, _ = self._scores(unknown, state.attitude[0])
        _, at, back = self._settled(unknown, state.attitude[0])
        alone, conditions = self._projected(at, back), self.conditions
        expected = (STUDENT + conditions) / (
            STUDENT + conditions + 2
        )  # of the Student law, on average
        whole = self.precision + _summed(expected, alone)
        covariance = np.linalg.inv(whole)
        clusters = _clusters(self.seen.pass_of)
        parts = [clusters == k for k in range(clusters.max() + 1)]
        without = np.array(
            [
                np.linalg.solve(whole - _summed(expected[p], alone[p]), scores[p].sum(axis=0))
                for p in parts
            ]
        )
        without -= without.mean(axis=0)
        robust = (
            1 - 1 / len(parts)
        ) * without.T @ without + covariance @ self.precision @ covariance
        before, after = self._left(self._stated(unknown)), self._left(unknown)
        read = self.seen
        samples = {
            "field": int(read.has_field.sum()),
            "Sun": int(read.has_sun.sum()),
            "passes": len(np.unique(read.pass_of)),
            "field and Sun": int((read.has_field & read.has_sun).sum()),
        }
        return Calibration(
            unknown,
            covariance,
            robust,
            np.linalg.inv(self.precision),
            self.unit_T,
            unit,
            len(self.vehicle.sensors.sun_sensors),
            self.scatter[2] * self.unit_T,
            self.scatter[0],
            self.scatter[1],
            np.array([before[0], after[0]]) * self.unit_T,
            np.array([before[1], after[1]]),
            samples,
        )

    def _stated(self, unknown: np.ndarray) -> np.ndarray:
        """The unknowns as the vehicle file has them, at the shift found and with the scale that fits best."""
        field = self._sky(unknown)[1]
        plain = np.zeros(len(unknown))
        scale = np.nanmedian(
            np.linalg.norm(self.seen.field, axis=1) / np.linalg.norm(field, axis=1)
        )
        plain[:9], plain[12:14] = (
            ((scale if np.isfinite(scale) else 1.0) * np.eye(3) - np.eye(3)).ravel(),
            unknown[12:14],
        )
        return plain

    def left_of_both(self, unknown: np.ndarray) -> float:
        """Minus a log likelihood of what is left of strength and angle, by their medians: the cost of the fit itself, in which each
        sample has an attitude, does not tell a noisy field from noisy Suns."""
        strength, angle = self._left(unknown)
        both = (self.seen.has_field & self.seen.has_sun).sum()
        return float(
            self.seen.has_field.sum() * np.log(strength)
            + (both * np.log(angle) if np.isfinite(angle) else 0.0)
        )

    def _left(self, unknown: np.ndarray) -> tuple[float, float]:
        """Medians of what is left of the field's strength, in its unit, and of its angle to the Sun (rad)."""
        sun_N, field_N, _ = self._sky(unknown)
        read = (self.seen.field - unknown[9:12]) @ np.linalg.inv(
            np.eye(3) + unknown[:9].reshape(3, 3)
        ).T
        size = np.linalg.norm(read, axis=1)
        strength = np.abs(size - np.linalg.norm(field_N, axis=1))
        both = self.seen.has_field & self.seen.has_sun
        if not both.any():
            return float(np.nanmedian(strength)), np.nan
        weight = [
            np.where(np.isfinite(self.seen.sun), self.seen.sun, 0.0)
            / self.seen.sun_sigma[:, None] ** 2
        ]
        for k, sensor in enumerate(self.vehicle.sensors.sun_sensors):
            place = 14 + 5 * k
            which = 3 + self.seen.y_turned[:, k]
            x = (self.seen.angle[:, k, 0] - unknown[place]) / (1 + unknown[place + 2])
            y = (self.seen.angle[:, k, 1] - unknown[place + 1]) / (1 + unknown[place + which])
            side = np.cross(sensor.normal_B, sensor.x_axis_B)
            direction = (
                sensor.normal_B
                + np.tan(x)[:, None] * sensor.x_axis_B
                + np.tan(np.nan_to_num(y))[:, None] * side
            )
            direction /= np.linalg.norm(direction, axis=1, keepdims=True)
            weight.append(np.nan_to_num(direction) / sensor.x_sigma_rad**2)
        sun = np.sum(weight, axis=0)[both]
        cosine = (sun * read[both]).sum(axis=1) / np.linalg.norm(sun, axis=1) / size[both]
        known = (sun_N * field_N).sum(axis=1)[both] / np.linalg.norm(field_N[both], axis=1)
        return float(np.nanmedian(strength)), float(
            np.median(np.abs(np.arccos(np.clip(cosine, -1, 1)) - np.arccos(known)))
        )


def _summed(weight: np.ndarray, slope: np.ndarray) -> np.ndarray:
    """Information (D, D) that samples with a weight (n) and slopes (n, R, D) have together."""
    flat = (np.sqrt(weight)[:, None, None] * slope).reshape(-1, slope.shape[2])
    return flat.T @ flat


def _information(by_turn: np.ndarray) -> np.ndarray:
    found = np.swapaxes(by_turn, -1, -2) @ by_turn
    weak = WEAK + ROUNDING * np.einsum("nii->n", found)
    return found + weak[:, None, None] * np.eye(3)


def _triad(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Axes (n, 3, 3) by columns: the first vector, what is at right angles to both, the third; any where a vector is zero."""
    size = np.linalg.norm(first, axis=1, keepdims=True)
    near = np.linalg.norm(second, axis=1, keepdims=True)
    second = np.where(
        near > 0,
        second / np.maximum(near, 1e-300),
        tangent_basis(first / np.maximum(size, 1e-300) + (size == 0))[0],
    )
    one = np.where(size > 0, first / np.maximum(size, 1e-300), tangent_basis(second)[0])
    across = np.cross(one, second)
    across = np.where(
        np.linalg.norm(across, axis=1, keepdims=True) > 1e-6, across, tangent_basis(one)[0]
    )
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    return np.stack([one, across, np.cross(one, across)], axis=2)


def _clusters(pass_of: np.ndarray) -> np.ndarray:
    """Numbers (n) from zero of what may err as one: the passes, in pieces where they are few."""
    _, clusters = np.unique(pass_of, return_inverse=True)
    pieces = -(-FEWEST_CLUSTERS // (clusters.max() + 1))
    place = np.arange(len(clusters)) - np.searchsorted(
        clusters, clusters
    )  # in its pass; samples are in the order of time
    return np.unique(
        clusters * pieces + place * pieces // np.bincount(clusters)[clusters], return_inverse=True
    )[1]
