"""Assessment of a telemetry file without a motion model: made once, then read by every estimator, command and figure."""

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
    find_late_frames,
    judge_readings,
    remove_negative_readings,
    remove_spikes,
)
from sunspin.telemetry.repeats import SENSORS, Repeats, find_repeats
from sunspin.telemetry.signals import signals
from sunspin.telemetry.sun import LIT_SIGMAS, is_reconstructed, sun_directions
from sunspin.telemetry.units import WrongUnit, panel_unit, wrong_units
from sunspin.vehicle import Vehicle

HEALTH_SAMPLES = 3000
"""Largest number of samples, evenly chosen, that are searched for impossible lit patterns: a day at 1 Hz must not take minutes."""

LOW_SHARE = 0.5
"""Largest reading of a panel, relative to the panel that reads most, below which its gain is doubtful. In a satellite that tumbles
about all axes the largest of 30 readings of each panel is above 0.8; panels of 3U and 6U satellites differ by factors of 2 to 6."""

DERIVED_FROM = dict.fromkeys(
    ("sun_sensor_cov_B", "sun_sensor_other_B", "sun_sensor_other_cov_B", "sun_sensor_angle"),
    "sun_sensor_B",
)
"""Variables of telemetry that are computed from another one: name -> name of that one."""


@dataclass(frozen=True, eq=False)
class Assessment:
    """Telemetry of a vehicle and properties of its readings.

    Each property is computed at its first access and cached, so that a command computes only what it reads. The Datasets must not
    be changed. `telemetry` is a Dataset of :func:`sunspin.read_telemetry`, or one with Sun directions instead of panel readings.
    """

    vehicle: Vehicle
    telemetry: xr.Dataset

    @property
    def has_panels(self) -> bool:
        """True if the file has panel readings."""
        return "power_W" in self.telemetry or "current_A" in self.telemetry

    @cached_property
    def quality(self) -> xr.Dataset:
        """Quality of each reading and sample, with gains, Earth's light and lost panels: the Dataset of :func:`panel_quality`."""
        return judge_readings(self.vehicle, self.telemetry, lambda: self.panel_unit, self.repeats)

    @cached_property
    def repeats(self) -> Repeats:
        """Samples that repeat earlier ones (frozen telemetry, copies of a frame, held values)."""
        usable = ~find_late_frames(self.telemetry)
        value = None  # panel readings without errors
        if self.has_panels:
            value, _ = remove_negative_readings(self.vehicle, signals(self.telemetry))
            usable &= np.isfinite(value).any(axis=1)
            value = remove_spikes(self.vehicle, value)
        return find_repeats(self.telemetry, value, usable)

    @cached_property
    def sensors(self) -> xr.Dataset:
        """Telemetry in which readings of sensors other than panels are NaN if they repeat an earlier one, as no new measurement."""
        masked = {}
        for name in (*SENSORS, *DERIVED_FROM):
            if name not in self.telemetry:
                continue
            # what is computed from a sensor repeats when it does
            repeated = self.repeats.repeated(DERIVED_FROM.get(name, name))
            if repeated.any():
                masked[name] = self.telemetry[name].where(xr.DataArray(~repeated, dims="time"))
        return self.telemetry.assign(masked) if masked else self.telemetry

    @cached_property
    def doubtful_gains(self) -> dict[str, float]:
        """Largest reading of each panel with signal by the largest of all, if the gains look like placeholders; else empty.

        They do if all are relative, without sigma, and a panel with signal reads less than `LOW_SHARE`. If the data determine the
        gains the estimators use these, and nothing is in doubt.
        """
        craft = self.vehicle
        stated = [craft.facts.get(f"panel.{panel.name}.relative_gain") for panel in craft.panels]
        unstated = all(fact is not None and not fact.sigma for fact in stated)
        if not (self.has_panels and unstated) or craft.channels or craft.telemetry.has_angles:
            return {}
        quality = self.quality
        readings = np.where(quality["reading"].values, signals(self.telemetry), np.nan)
        largest = np.nanmax(readings, axis=0, initial=0.0) / craft.input_gains
        share = largest / max(largest.max(), 1e-300)
        alive = ~quality["dead"].values
        if np.isfinite(quality.attrs["spread"]) or not (share < LOW_SHARE)[alive].any():
            return {}
        names = quality["panel"].values.astype(str)[alive].tolist()
        return dict(zip(names, share[alive].tolist(), strict=True))

    @cached_property
    def panel_unit(self) -> WrongUnit | None:
        """Wrong unit of the panel readings; None if they agree with the unit of the vehicle file."""
        return panel_unit(self.vehicle, signals(self.telemetry)) if self.has_panels else None

    @cached_property
    def noise(self) -> tuple[np.ndarray, str]:
        """Noise of a panel reading, one sigma (n_panel) in its unit, and its origin in words.

        The noise is that of the vehicle file, else it is estimated from readings below zero, else assumed. The estimate leaves out
        readings that are not light and late frames. :attr:`sun` instead estimates an unstated noise first from the redundancy of
        its directions.
        """
        stated = self.vehicle.input_noise
        if stated is not None:
            return stated, "given"
        value = np.where(self.quality["reading"].values, signals(self.telemetry), np.nan)
        dark = dark_noise(value)
        sigma = assumed_noise(value) if dark is None else dark
        return np.full(value.shape[1], sigma), ASSUMED_FROM if dark is None else DARK_FROM

    @cached_property
    def lit_threshold(self) -> np.ndarray | None:
        """Readings (n_panel), in their unit, above which the Sun and not the Earth lights a panel: twice the light on unlit panels.

        None if the vehicle file states a threshold, too few readings show the light on unlit panels, or this light is below six
        sigma of noise. That is judged on the panel with the largest gain.
        """
        if self.vehicle.telemetry.lit_threshold is not None:
            return None
        if self.telemetry.sizes["time"] < DEAD_SAMPLES:
            return None
        quality = self.quality.attrs
        unlit_light = quality["albedo"] * quality["full_sun"] * self.vehicle.input_gains
        noise = LIT_SIGMAS * self.quality["noise"].values.max()
        # twice the three sigma of noise from which a panel counts as lit without this threshold
        above_noise = unlit_light.max() > SURELY_LIT * noise
        enough_readings = quality["albedo_samples"] >= DEAD_SAMPLES
        if not (enough_readings and above_noise):
            return None
        # a panel with a small gain gets little light from the Earth, but has the noise of the others
        return np.asarray(np.maximum(SURELY_LIT * unlit_light, noise))

    @cached_property
    def sun(self) -> xr.Dataset:
        """Sun directions from the panels, with status and covariance: the Dataset of :func:`sun_directions`."""
        return sun_directions(
            self.vehicle,
            self.telemetry,
            lit_threshold=self.lit_threshold,
            wrong_unit=lambda: self.panel_unit,
            quality=self.quality,
        )

    @property
    def health_stride(self) -> int:
        """Stride of the samples of :attr:`health`: 1 for files of at most `HEALTH_SAMPLES`."""
        return -(-self.telemetry.sizes["time"] // HEALTH_SAMPLES)

    @cached_property
    def health(self) -> PanelHealth:
        """Impossible lit patterns and the panels whose loss would explain them, from every `health_stride`-th sample."""
        stride = slice(None, None, self.health_stride)
        samples, quality = self.telemetry.isel(time=stride), self.quality.isel(time=stride)
        return panel_health(
            self.vehicle, samples, lit_threshold=self.lit_threshold, quality=quality
        )

    @cached_property
    def still_directions(self) -> list[np.ndarray]:
        """Unit vectors (n, 3), body axes, of directions that are fixed in space over minutes; NaN without a reading.

        One array for each of Sun sensors, panels, and magnetometer (only if the vehicle file states its noise).
        """
        directions = []
        if "sun_sensor_B" in self.telemetry:
            directions.append(self.sensors["sun_sensor_B"].values)
        if self.has_panels:
            known = is_reconstructed(self.sun["status"])
            directions.append(np.where(known[:, None], self.sun["sun_B"].values, np.nan))
        magnetometer = self.vehicle.sensors.magnetometer
        if "field_B" in self.telemetry and magnetometer is not None and magnetometer.noise:
            field = self.sensors["field_B"].values
            strength = np.linalg.norm(field, axis=1, keepdims=True)
            unit = field / np.where(strength > 0, strength, 1.0)
            directions.append(np.where(strength > 0, unit, np.nan))
        return directions

    @cached_property
    def wrong_units(self) -> list[WrongUnit]:
        """Units of the vehicle file that the samples contradict."""
        panels = [self.panel_unit] if self.panel_unit else []
        return panels + wrong_units(self.vehicle, self.telemetry, lambda: self.still_directions)


def assess(vehicle: Vehicle, telemetry: xr.Dataset | Assessment) -> Assessment:
    """Return the assessment of telemetry; an assessment of the same vehicle is returned unchanged.

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
