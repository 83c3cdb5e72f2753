"""Readings of what an orbit predicts: magnetic field, direction to the Sun, and whether the Sun is up."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import xarray as xr

from sunspin.telemetry.assess import Assessment
from sunspin.telemetry.quality import find_late_frames
from sunspin.telemetry.repeats import GAP_FACTOR
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import SunStatus
from sunspin.vehicle.response.panels import opposite_panels

WITH_BOTH = 0.5
"""Share of the chosen samples that is reserved for those with field and Sun. The others, also in the night, show the field's
strength and the shadow."""

EARTH_SHARE, EARTH_RAD, EARTH_INDEPENDENT = 0.3, 0.1, 10
"""Nothing in a file separates the Sun from the Earth's light on a panel without an opposite one. Such a panel counts as sunlit
above `EARTH_SHARE` of full Sun. A direction that rests on it has an error of `EARTH_RAD` (rad). A spinner shows the Earth the same
side all the time, so that the errors of a file average out as those of only `EARTH_INDEPENDENT` samples. On 10 simulated spinners
with three to five such panels the calibration was rotated by 4 to 130 deg without these limits, and by 0.3 to 4 deg with them."""

PANEL_RAD = 0.03
"""Error of a direction from panels in addition to their noise, rad: the Earth's light, panel normals."""


class Readings(NamedTuple):
    """Readings of n samples at times `t_s` (s), NaN if there are none; directions are unit vectors in body axes.

    `field` (n, 3): magnetometer, in any unit. `sun` (n, 3) and its `covariance` (n, 3, 3): direction to the Sun by panels or by Sun
    sensors as the vehicle file states them. `light` (n): 1 if the Sun is up, 0 if it is dark. `angle` (n, F, 2): x and y angles of
    each of F Sun sensors, rad; `y_turned` (n, F): the reading of y wraps and has the scale `y_turned_scale`. `panel_sun` (n, 3):
    direction by panels, or by a Sun vector sensor; `panel_sigma` (n): its error about each axis, rad. `pass_of` (n): its pass.
    """

    t_s: np.ndarray
    field: np.ndarray
    sun: np.ndarray
    covariance: np.ndarray
    light: np.ndarray
    angle: np.ndarray
    y_turned: np.ndarray
    panel_sun: np.ndarray
    panel_sigma: np.ndarray
    pass_of: np.ndarray

    @property
    def has_field(self) -> np.ndarray:
        """True (n) if the magnetometer was read."""
        return _whole(self.field)

    @property
    def has_sun(self) -> np.ndarray:
        """True (n) if some reading shows the direction to the Sun, or one angle of it."""
        by_sensors = np.asarray(np.isfinite(self.angle[..., 0]).any(axis=1))
        return _whole(self.sun) | _whole(self.panel_sun) | by_sensors

    @property
    def has_angle(self) -> np.ndarray:
        """True (n) if a sample shows the angle between field and Sun."""
        return _whole(self.field + self.sun)

    def take(self, which: np.ndarray) -> Readings:
        """Return the readings of some samples, by index or mask."""
        return Readings(*(part[which] for part in self))

    def without_sun(self) -> Readings:
        """Return the readings without directions to the Sun; the light stays."""
        return self._replace(sun=np.full_like(self.sun, np.nan))

    def with_axes(self, matrix: np.ndarray) -> Readings:
        """Return the readings with those of the field multiplied by a matrix (3, 3)."""
        return self._replace(field=self.field @ matrix.T)

    def with_stated_sun(self) -> Readings:
        """Return the readings for a fit that keeps Sun sensors as stated: their directions replace panels', angles are NaN."""
        by_sensors = np.isfinite(self.angle[..., 0]).any(axis=1) & _whole(self.sun)
        sigma = np.sqrt(np.trace(self.covariance, axis1=1, axis2=2) / 2)  # about each of two axes
        return self._replace(
            angle=np.full_like(self.angle, np.nan),
            panel_sun=np.where(by_sensors[:, None], self.sun, self.panel_sun),
            panel_sigma=np.where(by_sensors, sigma, self.panel_sigma),
        )


def _whole(vectors: np.ndarray) -> np.ndarray:
    """Return which of the vectors (n, d) have no NaN."""
    return np.asarray(np.isfinite(vectors).all(axis=1))


def orbit_readings(assessment: Assessment, most: int) -> Readings:
    """Return the readings of at most `most` samples that show field, Sun or light, spread over the file.

    Samples with field and Sun are preferred. The direction `sun` is that of the Sun sensors if they were read, else of the panels.
    """
    telemetry, vehicle = assessment.sensors, assessment.vehicle
    time = telemetry["time"].values
    n, n_sensors = len(time), len(vehicle.sensors.sun_sensors)
    field = telemetry["field_B"].values if "field_B" in telemetry else np.full((n, 3), np.nan)
    angle, y_turned = np.full((n, n_sensors, 2), np.nan), np.zeros((n, n_sensors), dtype=bool)
    if "sun_sensor_angle" in telemetry:
        angle = telemetry["sun_sensor_angle"].values
        y_turned = telemetry["sun_sensor_y_turned"].values != 0

    sun, covariance = np.full((n, 3), np.nan), np.full((n, 3, 3), np.nan)
    light, panel_sigma = np.full(n, np.nan), np.full(n, np.nan)
    by_earth = np.zeros(n, dtype=bool)  # the Earth's light gives the direction an unknown error
    if assessment.has_panels:
        directions, by_earth = sun_by_panels(assessment)
        sun, covariance = directions["sun_B"].values, directions["sun_cov_B"].values
        panel_sigma = directions["sigma_rad"].values / np.sqrt(2)  # about one of two axes
        status = directions["status"].values
        light = np.where(status == SunStatus.DARK, 0.0, 1.0)
        light[status == SunStatus.MISSING] = np.nan
    # directions by panels are kept too, for fits in which the Sun sensors may be off
    panel_sun, panels_by_earth = sun, by_earth
    if "sun_sensor_B" in telemetry:
        by_sensors = telemetry["sun_sensor_B"].values
        known = _whole(by_sensors)
        sun = np.where(known[:, None], by_sensors, sun)
        sensor_covariance = telemetry["sun_sensor_cov_B"].values
        covariance = np.where(known[:, None, None], sensor_covariance, covariance)
        light = np.where(known, 1.0, np.where(np.isfinite(light), light, 0.0))  # neither: dark
        by_earth = by_earth & ~known
        sun_vector = vehicle.sensors.sun_vector
        if sun_vector is not None and not n_sensors and not assessment.has_panels:
            panel_sun, panel_sigma = by_sensors, np.full(n, sun_vector.sigma_rad)
    # a direction without an error is no reading
    sun = np.where(_whole(covariance.reshape(n, 9))[:, None], sun, np.nan)
    panel_sun = np.where(np.isfinite(panel_sigma)[:, None], panel_sun, np.nan)

    usual = np.median(np.diff(time)) if n > 1 else 1.0
    pass_of = np.concatenate([[0], np.cumsum(np.diff(time) > GAP_FACTOR * usual)])[:n]
    readings = Readings(
        time, field, sun, covariance, light, angle, y_turned, panel_sun, panel_sigma, pass_of
    )
    # choose the samples
    shows_anything = readings.has_field | readings.has_sun | np.isfinite(light)
    use = spread_evenly(telemetry, shows_anything, most, readings.has_field & readings.has_sun)
    by_earth, panels_by_earth, readings = by_earth[use], panels_by_earth[use], readings.take(use)
    # add the errors that the chosen samples have in common: by the Earth's light, and of the panels
    earth = earth_variance(by_earth.sum()) * by_earth[:, None, None] * np.eye(3)
    variance = np.nan_to_num(readings.panel_sigma, nan=1.0) ** 2 + PANEL_RAD**2
    variance = variance + earth_variance(panels_by_earth.sum()) * panels_by_earth
    return readings._replace(covariance=readings.covariance + earth, panel_sigma=np.sqrt(variance))


def sun_by_panels(assessment: Assessment) -> tuple[xr.Dataset, np.ndarray]:
    """Return the Sun directions by panels, and which of them (n) have an unknown error by the Earth's light.

    The latter use a panel without an opposite one: nothing determines how much of the Earth's light is on it. Directions that may
    be those to the Earth are NaN, as such a panel is weakly lit.
    """
    directions, vehicle = assessment.sun, assessment.vehicle
    has_no_opposite = ~opposite_panels(vehicle.response_in().facing_B).any(axis=1)
    full = assessment.quality.attrs["full_sun"] * vehicle.input_gains
    uses_such_panel = directions["lit"].values & has_no_opposite
    weak = signals(assessment.telemetry) / full < EARTH_SHARE
    doubtful = (uses_such_panel & weak).any(axis=1)
    sun_B = directions["sun_B"].where(~xr.DataArray(doubtful, dims="time"))
    return directions.assign(sun_B=sun_B), uses_such_panel.any(axis=1) & ~doubtful


def earth_variance(count: int) -> float:
    """Return the variance (rad^2) of each component of the `count` directions of a file that the Earth's light may disturb.

    It grows with their number, so that their mean is no better than that of :data:`EARTH_INDEPENDENT` samples.
    """
    return EARTH_RAD**2 * max(count / EARTH_INDEPENDENT, 1.0)


def spread_evenly(
    telemetry: xr.Dataset, shows: np.ndarray, most: int, preferred: np.ndarray
) -> np.ndarray:
    """Return the indices of at most `most` samples, spread over those that show something (n) and did not arrive late.

    At least the share `WITH_BOTH` of them are `preferred` ones (n), if the file has as many.
    """
    usable = np.flatnonzero(shows & ~find_late_frames(telemetry))
    spread, usable_preferred = _every_few(usable, most), usable[preferred[usable]]
    enough = min(len(usable_preferred), int(WITH_BOTH * most))
    if len(spread) == len(usable) or preferred[spread].sum() >= enough:
        return spread
    chosen = _every_few(usable_preferred, enough)
    others = _every_few(np.setdiff1d(usable, usable_preferred), most - len(chosen))
    return np.sort(np.concatenate([chosen, others]))


def _every_few(values: np.ndarray, most: int) -> np.ndarray:
    """Return at most `most` of these values (n), evenly spaced in their order."""
    index = np.linspace(0, len(values) - 1, min(len(values), most)) if len(values) else []
    return values[np.unique(np.asarray(index, dtype=int))]
