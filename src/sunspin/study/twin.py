"""Synthetic telemetry with known truth.

:func:`twin` makes panel signals of any vehicle from a known motion. The landing of Philae, phase by phase, is in
:mod:`sunspin.study.twin_philae`; ``python -m sunspin.study.twin --seed N OUT.csv`` writes it as a telemetry file.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from sunspin.cases import Case, case_names, load_case
from sunspin.errors import InputError, sentence
from sunspin.measure.panels import panel_power
from sunspin.motion.propagate import propagate
from sunspin.study.command import command
from sunspin.study.twin_data import (
    csv_text,
    generator,
    noisy_power,
    on_time_grid,
    telemetry_dataset,
    truth_text,
    write_new,
)
from sunspin.vehicle import Vehicle

EPOCH_UTC = "2000-01-01T12:00:00Z"
"""Epoch of a twin whose vehicle names none: a twin need not happen on any day."""

NOISE_OF_LARGEST = 0.02
"""Where gains are relative, the scale makes the vehicle's noise this part of the largest panel's full signal."""


@dataclass(frozen=True)
class Truth:
    """The motion behind a twin: the state at ``t_s[0]``, the sample times, and how the panels see it.

    `omega_B` (3) rad/s and `sun_B` (3) in body axes; `t_s` (n) s from the epoch; `wheel_speed_rad_s` as in `propagate`
    (default: the vehicle's nominal speeds); `scale` the signal of a panel of gain one at normal incidence (default: 1,
    or with relative gains what makes the vehicle's noise `NOISE_OF_LARGEST`); `noise` one sigma in the unit of the
    signal (default: the vehicle's, zero where it states none).
    """

    omega_B: npt.ArrayLike
    sun_B: npt.ArrayLike
    t_s: npt.ArrayLike
    wheel_speed_rad_s: npt.ArrayLike | None = None
    wheel_mode: Any = "coast"
    scale: float | None = None
    noise: float | None = None


def twin(source: Case | Vehicle | str, truth: Truth | Mapping[str, Any] | None = None, seed: int = 0) -> xr.Dataset:
    """Synthetic telemetry of a vehicle that moves as `truth` says.

    Parameters
    ----------
    source : Case, Vehicle or name of a case
        ``"philae"`` without `truth` gives the whole landing, see :func:`sunspin.study.twin_philae.philae_twin`.
    truth : Truth, or a mapping with its fields
    seed : int
        Of the noise. The same seed gives the same bits.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with the true direction `true_sun_B (time, axis)` and the truth in attributes
        ``truth_omega_B``, ``truth_sun_B``, ``truth_wheel_speed_rad_s``, ``truth_noise``, ``truth_scale``,
        ``truth_seed`` ...

    Raises
    ------
    InputError
        A truth with unknown or missing fields, a negative noise.
    """
    if isinstance(source, str):
        source = load_case(source)
    if truth is None:
        if isinstance(source, Case) and source.name == "philae":
            from sunspin.study.twin_philae import philae_twin

            return philae_twin(seed)
        raise InputError(sentence("a twin needs a truth", do="give omega_B, sun_B and t_s"))
    vehicle = source.vehicle if isinstance(source, Case) else source
    vehicle.require_panels()
    known = _truth(truth)
    scale, noise = _scale(known, vehicle), _noise(known, vehicle)
    speeds = known.wheel_speed_rad_s
    if speeds is None:
        speeds = [wheel.speed_rad_s for wheel in vehicle.wheels]
    t = on_time_grid(np.atleast_1d(known.t_s))
    track = propagate(vehicle, known.omega_B, known.sun_B, speeds, t, wheel_mode=known.wheel_mode)
    sun = track["sun_B"].values
    power = noisy_power(vehicle, scale * panel_power(vehicle, sun), noise, generator(seed, 0))
    told = {
        "omega_B": np.array(known.omega_B, dtype=np.float64),
        "sun_B": np.array(known.sun_B, dtype=np.float64),
        "wheel_speed_rad_s": np.atleast_1d(np.array(speeds, dtype=np.float64)),
        "wheel_mode": str(known.wheel_mode),
        "scale": scale,
        "noise": noise,
        "seed": seed,
    }
    return telemetry_dataset(vehicle, t, power, sun, vehicle.telemetry.epoch_utc or EPOCH_UTC, told)


def _truth(truth: Truth | Mapping[str, Any]) -> Truth:
    if isinstance(truth, Truth):
        return truth
    names = [field.name for field in fields(Truth)]
    unknown = sorted(set(truth) - set(names))
    missing = [name for name in ("omega_B", "sun_B", "t_s") if name not in truth]
    if unknown or missing:
        raise InputError(
            sentence(
                f"a truth has the fields {', '.join(names)}",
                got=", ".join([f"unknown {name}" for name in unknown] + [f"no {name}" for name in missing]),
            )
        )
    return Truth(**truth)


def _scale(truth: Truth, vehicle: Vehicle) -> float:
    if truth.scale is None:
        noise = vehicle.telemetry.noise
        if vehicle.gain_unit is not None or noise is None:
            return 1.0
        return noise / (NOISE_OF_LARGEST * float(vehicle.panel_gains.max()))
    if not (np.isfinite(truth.scale) and truth.scale > 0):
        raise InputError(sentence("the scale of a twin must be positive", got=truth.scale))
    return float(truth.scale)


def _noise(truth: Truth, vehicle: Vehicle) -> float:
    noise = truth.noise if truth.noise is not None else vehicle.telemetry.noise or 0.0
    if not (np.isfinite(noise) and noise >= 0):
        raise InputError(sentence("the noise of a twin must be zero or positive", got=noise))
    return float(noise)


@command
def main(arguments: list[str] | None = None) -> None:
    """Write the synthetic telemetry of a built-in case and, beside it, its truth."""
    parser = argparse.ArgumentParser(prog="python -m sunspin.study.twin", description=main.__doc__)
    parser.add_argument("out", type=Path, help="CSV file to write; the truth goes to twin_truth.toml beside it")
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--case", default="philae", choices=case_names())
    parser.add_argument("--force", action="store_true", help="replace existing files")
    given = parser.parse_args(arguments)
    case = load_case(given.case)
    telemetry = twin(case, seed=given.seed)
    comments = [
        f"synthetic: not measured; made by sunspin {metadata.version('sunspin')} from published facts",
        f"synthetic: python -m sunspin.study.twin --case {given.case} --seed {given.seed} {given.out.name}",
    ]
    more = ["synthetic: powers in W on an arbitrary scale; the truth behind them is in twin_truth.toml"]
    write_new(given.out, csv_text(case.vehicle, telemetry, comments + more), given.force)
    about = [f"The truth behind {given.out.name}; see sunspin.study.twin_philae for how each part was chosen."]
    write_new(given.out.parent / "twin_truth.toml", truth_text(telemetry, comments + about), given.force)


if __name__ == "__main__":
    sys.exit(main())
