"""Every motion of a lander that panel readings allow, under every model that may explain it (docs/posterior.md).

Here up to the fits about which the posterior is sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import xarray as xr

from sunspin.estimation.budget import Budget
from sunspin.estimation.grid import Place, grid_starts, reference
from sunspin.estimation.lander import LanderModel
from sunspin.estimation.priors import constant_torques, with_priors
from sunspin.estimation.search import search
from sunspin.estimation.settings import POSTERIOR, PosteriorSettings
from sunspin.estimation.shooting import Shooting
from sunspin.estimation.shots import ShotFit
from sunspin.estimation.window import Window, observe_window
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Vehicle


class Searched(NamedTuple):
    """A search under the nominal model: what was seen, the reference, the fits, and the priors in words."""

    window: Window
    place: Place
    carrier: Shooting
    fit: ShotFit
    said: dict[str, str]


def searched(
    vehicle: Vehicle,
    telemetry: xr.Dataset,
    priors: Mapping[str, Any] | None = None,
    *,
    begin_s: float | None = None,
    end_s: float | None = None,
    phase: str | None = None,
    observations: Sequence[Mapping[str, Any]] = (),
    wheel_mode: str | Sequence[str] = "coast",
    workers: int | None = None,
    settings: PosteriorSettings = POSTERIOR,
) -> Searched:
    """Return every motion that the readings of a stretch allow under the nominal model, fitted to all samples.

    Arguments as in :func:`sunspin.posterior`.
    """
    assessment = assess(vehicle, telemetry)
    window = observe_window(assessment, begin_s, end_s, phase, observations)
    stated, said = with_priors(assessment, window, priors, wheel_mode)
    place = reference(stated, settings.grid, bool((priors or {}).get("max_rate_rad_s")))
    carrier = Shooting(place.about(stated), place, settings, workers)
    fit = search_under(carrier, settings)
    return Searched(window, place, carrier, fit, said)


def search_under(carrier: Shooting, settings: PosteriorSettings) -> ShotFit:
    """Return every motion that the readings allow under the model of a carrier, fitted to all samples."""
    starts = grid_starts(carrier.model, carrier.place, settings.grid, carrier.workers)
    found = search(carrier, starts, settings.search, Budget(settings.motions))
    return carrier.curved(found)


def under_torques(
    nominal: Searched, priors: Mapping[str, Any] | None, model: LanderModel | None = None
) -> list[Shooting]:
    """Return carriers of the models with a constant torque, in body axes and in space, of the same readings."""
    stated = nominal.carrier.model if model is None else model
    return [nominal.carrier.of(torque) for torque in constant_torques(stated, priors)]
