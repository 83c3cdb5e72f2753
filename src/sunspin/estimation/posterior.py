"""Every motion of a lander that panel readings allow, under every model that may explain it (docs/posterior.md).

Here up to the fits about which the posterior is sampled.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

from sunspin.estimation.budget import Budget
from sunspin.estimation.grid import Place, grid_starts, reference
from sunspin.estimation.priors import constant_torques, with_priors
from sunspin.estimation.search import search
from sunspin.estimation.settings import POSTERIOR, PosteriorSettings
from sunspin.estimation.shooting import Shooting
from sunspin.estimation.shots import ShotFit, Trials
from sunspin.estimation.window import Window, observe_window
from sunspin.telemetry.assess import assess
from sunspin.vehicle import Vehicle


class Searched(NamedTuple):
    """A search under the nominal model.

    `window`: what was seen; `place`: the reference; `motions`: what the search ended with; `fit`: these fitted to all samples with
    all unknowns; `said`: the priors and their sources in words.
    """

    window: Window
    place: Place
    carrier: Shooting
    motions: Trials
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
    motions = searched_by(carrier, settings)
    return Searched(window, place, carrier, motions, carrier.curved(motions), said)


def searched_by(carrier: Shooting, settings: PosteriorSettings) -> Trials:
    """Return every motion that the readings allow under the model of a carrier, from the grid of rates on."""
    starts = grid_starts(carrier.model, carrier.place, settings.grid, carrier.workers)
    return search(carrier, starts, settings.search, Budget(settings.motions))


def under_torques(nominal: Searched, priors: Mapping[str, Any] | None) -> list[Shooting]:
    """Return carriers of the models with a constant torque, in body axes and in space, of the same readings.

    Their motions are those of the nominal model, fitted by :func:`refitted`. If none of these fits, a torque may hide the true one,
    and :func:`searched_by` looks for it under the torque from the first samples on.
    """
    carrier = nominal.carrier
    return [carrier.of(torque) for torque in constant_torques(carrier.model, priors)]


def refitted(carrier: Shooting, nominal: Searched) -> ShotFit:
    """Return the motions of the nominal model fitted under that of a carrier, whose further unknowns begin at their centres.

    All begin with which the search ended, also those far worse than the best: under another model they may fit.
    """
    names = [unknown.name for unknown in carrier.model.unknowns]
    places = np.array([names.index(one.name) for one in nominal.carrier.model.unknowns])
    shots = nominal.motions.shots.with_unknowns(places, len(names))
    return carrier.curved(Trials(shots, nominal.motions.starts))
