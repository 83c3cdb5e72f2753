"""What a telemetry file shows by itself: assessed once, then read by every estimator, command and figure."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import xarray as xr

from sunspin.telemetry.health import PanelHealth, panel_health
from sunspin.telemetry.noise import ASSUMED_FROM, DARK_FROM, assumed_noise, dark_noise
from sunspin.telemetry.quality import (
    DEAD_SAMPLES,
    SURELY_LIT,
    came_late,
    judge_readings,
    known_readings,
    without_spikes,
)
from sunspin.telemetry.repeats import SENSORS, Repeats, find_repeats
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import LIT_SIGMAS, is_reconstructed, sun_directions
from sunspin.telemetry.units import WrongUnit, panel_unit, wrong_units
from sunspin.vehicle import Vehicle

HEALTH_SAMPLES = 3000
"""Impossible lit patterns are explained on at most this many samples, evenly chosen: a day at 1 Hz must not take minutes."""


OF_SENSOR = dict.fromkeys(
    ("sun_sensor_cov_B", "sun_sensor_other_B", "sun_sensor_other_cov_B", "sun_sensor_angle"),
    "sun_sensor_B",
)
"""Variables of telemetry that follow from another one."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """A telemetry file and what its readings show. Each property is computed at its first use and kept, so that a command pays for
    what it reads, and only once. The Datasets must not be changed.

    `telemetry` is a Dataset of :func:`sunspin.read_telemetry`, or one with Sun directions in place of panel readings.
    """

    vehicle: Vehicle
    telemetry: xr.Dataset

    @property
    def has_panels(self) -> bool:
        """Whether the file has readings of panels."""
        return "power_W" in self.telemetry or "current_A" in self.telemetry

    @cached_property
    def quality(self) -> xr.Dataset:
        """Usable or the reason, sigma and brightness factor of each sample; gains, Earth's light, lost panels of the file: the
        Dataset of :func:`panel_quality`."""
        return judge_readings(self.vehicle, self.telemetry, lambda: self.panel_unit, self.repeats)

    @cached_property
    def repeats(self) -> Repeats:
        """Samples that repeat earlier ones: frozen telemetry, copies of a frame, held values."""
        usable, value = ~came_late(self.telemetry), None
        if self.has_panels:
            value, _ = known_readings(self.vehicle, signals(self.telemetry))
            usable &= np.isfinite(value).any(axis=1)
            value = without_spikes(self.vehicle, value)
        return find_repeats(self.telemetry, value, usable)

    @cached_property
    def sensors(self) -> xr.Dataset:
        """The telemetry without what sensors other than panels repeat: NaN there."""
        kept = {}
        for name in (name for name in (*SENSORS, *OF_SENSOR) if name in self.telemetry):
            repeated = self.repeats.of(OF_SENSOR.get(name, name))
            if repeated.any():
                kept[name] = self.telemetry[name].where(xr.DataArray(~repeated, dims="time"))
        return self.telemetry.assign(kept) if kept else self.telemetry

    @cached_property
    def panel_unit(self) -> WrongUnit | None:
        """The wrong unit of the panels' readings; None if they are in the unit of the vehicle file."""
        return panel_unit(self.vehicle, signals(self.telemetry)) if self.has_panels else None

    @cached_property
    def noise(self) -> tuple[np.ndarray, str]:
        """One sigma of a reading of each panel (n_panel), in its unit, and where it comes from: the vehicle file, else readings
        below zero of the whole file, else assumed; readings that no light explains, and late frames, do not count. :attr:`sun`
        asks the redundancy of its directions before the latter two."""
        stated, value = self.vehicle.input_noise, signals(self.telemetry)
        if stated is not None:
            return stated, "given"
        value = np.where(self.quality["reading"].values, value, np.nan)
        dark = dark_noise(value)
        sigma = assumed_noise(value) if dark is None else dark
        return np.full(value.shape[1], sigma), ASSUMED_FROM if dark is None else DARK_FROM

    @cached_property
    def lit_threshold(self) -> float | None:
        """What a reading must exceed to count as lit by the Sun and not by the Earth, in its unit: twice the light on unlit panels.

        None if the vehicle file gives a threshold, too few samples show that light, or it is below six sigma of noise.
        """
        if self.vehicle.telemetry.lit_threshold is not None:
            return None
        if self.telemetry.sizes["time"] < DEAD_SAMPLES:
            return None
        file = self.quality.attrs
        light = file["albedo"] * file["full_sun"] * float(self.vehicle.input_gains.max())
        above_noise = light > SURELY_LIT * LIT_SIGMAS * self.quality["noise"].values.max()
        known = file["albedo_samples"] >= DEAD_SAMPLES and above_noise
        return SURELY_LIT * light if known else None

    @cached_property
    def sun(self) -> xr.Dataset:
        """Sun directions by the panels, with status and covariance: the Dataset of :func:`sun_directions`."""
        return sun_directions(
            self.vehicle,
            self.telemetry,
            lit_threshold=self.lit_threshold,
            wrong_unit=lambda: self.panel_unit,
            quality=self.quality,
        )

    @property
    def health_stride(self) -> int:
        """Every how many samples lit patterns are explained."""
        return -(-self.telemetry.sizes["time"] // HEALTH_SAMPLES)

    @cached_property
    def health(self) -> PanelHealth:
        """Impossible lit patterns and the panels whose loss would explain them, of every `health_stride`-th sample."""
        some = self.telemetry.isel(time=slice(None, None, self.health_stride))
        quality = self.quality.isel(time=slice(None, None, self.health_stride))
        return panel_health(self.vehicle, some, lit_threshold=self.lit_threshold, quality=quality)

    @cached_property
    def still_directions(self) -> list[np.ndarray]:
        """Unit directions (n, 3), body axes, that keep still in space for minutes: the Sun by each kind of sensor, and the field if
        the vehicle file states its noise. NaN where nothing is seen."""
        directions = []
        if "sun_sensor_B" in self.telemetry:
            directions.append(self.sensors["sun_sensor_B"].values)
        if self.has_panels:
            seen = is_reconstructed(self.sun["status"])
            directions.append(np.where(seen[:, None], self.sun["sun_B"].values, np.nan))
        magnetometer = self.vehicle.sensors.magnetometer
        if "field_B" in self.telemetry and magnetometer is not None and magnetometer.noise:
            field = self.sensors["field_B"].values
            size = np.linalg.norm(field, axis=1, keepdims=True)
            directions.append(np.where(size > 0, field / np.where(size > 0, size, 1.0), np.nan))
        return directions

    @cached_property
    def wrong_units(self) -> list[WrongUnit]:
        """Every unit that the samples contradict."""
        panels = [self.panel_unit] if self.panel_unit else []
        return panels + wrong_units(self.vehicle, self.telemetry, lambda: self.still_directions)


def assess(vehicle: Vehicle, telemetry: xr.Dataset | Assessment) -> Assessment:
    """What a telemetry file of a vehicle shows by itself; an assessment of the same vehicle is returned as it is.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, or its Assessment
    """
    if isinstance(telemetry, Assessment):
        if telemetry.vehicle is vehicle:
            return telemetry
        telemetry = telemetry.telemetry
    return Assessment(vehicle, telemetry)


def panel_quality(vehicle: Vehicle, telemetry: xr.Dataset | Assessment) -> xr.Dataset:
    """Judge every reading and every sample of panel powers or currents: :attr:`Assessment.quality`.

    Parameters
    ----------
    telemetry : Dataset of `read_telemetry`, or its Assessment

    Returns
    -------
    xarray.Dataset
        On (time, panel): `sigma`, in W or A. On `time`: `use` (0 used, 1 down-weighted, 2 dropped), `why`, `scale` and its
        relative uncertainty `scale_sigma`. On `panel`: `dead`, `missed`, `weak`, `gain` and `gain_sigma`.
    """
    return assess(vehicle, telemetry).quality
