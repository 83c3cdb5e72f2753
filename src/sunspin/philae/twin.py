"""Synthetic telemetry with known truth: a vehicle's own motion, or the landing of a built-in case.

The landing of Philae, phase by phase, is in :mod:`sunspin.philae.twin_philae`; ``python -m sunspin.philae.twin --seed N OUT.csv``
writes it as a telemetry file.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.base.errors import InputError, SunspinError
from sunspin.base.provenance import version
from sunspin.estimate.synthetic import Truth, synthetic_telemetry
from sunspin.philae.twin_philae import philae_twin
from sunspin.telemetry.case import Case, case_names, load_case
from sunspin.telemetry.synthetic import csv_text, truth_text, write_new
from sunspin.vehicle import Vehicle


def twin(
    source: Case | Vehicle | str,
    truth: Truth | Mapping[str, Any] | None = None,
    seed: int = 0,
    **landing: Any,
) -> xr.Dataset:
    """Synthetic telemetry of a vehicle that moves as `truth` says.

    Parameters
    ----------
    source : Case, Vehicle or name of a case
        ``"philae"`` without `truth` gives the whole landing, see :func:`sunspin.philae.twin_philae.philae_twin`.
    truth : Truth, or a mapping with its fields
    seed : int
        Of the noise and of what else is drawn. The same seed gives the same data.
    landing
        Of the whole landing: `noise`, `tilt_rad`, `turned_rad`, `rest_seen` of
        :func:`sunspin.philae.twin_philae.philae_twin`.

    Returns
    -------
    xarray.Dataset
        As from `read_telemetry`, with the true direction `true_sun_B (time, axis)` and the truth in attributes
        ``truth_omega_B``, ``truth_sun_B``, ``truth_wheel_speed_rad_s``, ``truth_noise``, ``truth_scale``,
        ``truth_seed`` ...

    Raises
    ------
    InputError
        A truth with unknown or missing fields, a negative noise, options of the landing beside a truth.
    """
    if isinstance(source, str):
        source = load_case(source)
    if truth is None:
        if isinstance(source, Case) and source.name == "philae":
            return philae_twin(seed, **landing)
        raise InputError("a twin needs a truth", do="give omega_B, sun_B and t_s")
    if landing:
        raise InputError(
            "a twin with a truth takes no options of the landing", got=", ".join(landing)
        )
    return synthetic_telemetry(source.vehicle if isinstance(source, Case) else source, truth, seed)


def main(arguments: list[str] | None = None) -> int:
    """Write the synthetic telemetry of a built-in case and, beside it, its truth."""
    parser = argparse.ArgumentParser(prog="python -m sunspin.philae.twin", description=main.__doc__)
    parser.add_argument(
        "out", type=Path, help="CSV file to write; the truth goes to twin_truth.toml beside it"
    )
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument(
        "--tilt",
        type=float,
        help="sigma of each panel's normal to each side, degrees; default: vehicle file's",
    )
    parser.add_argument(
        "--turn",
        type=float,
        help="sigma of one turn of all panels about each axis, degrees; default: the same",
    )
    parser.add_argument(
        "--rest-seen",
        action=argparse.BooleanOptionalAction,
        default=True,
        help="the first samples at rest give a direction (default)",
    )
    parser.add_argument("--case", default="philae", choices=case_names())
    parser.add_argument("--force", action="store_true", help="replace existing files")
    given = parser.parse_args(arguments)
    try:
        case = load_case(given.case)
        turns = {
            name: value
            for name, value in (("tilt", given.tilt), ("turn", given.turn))
            if value is not None
        }
        asked = "".join(
            f" --{name} {value:g}" for name, value in turns.items()
        ) + " --no-rest-seen" * (not given.rest_seen)
        keys = {"tilt": "tilt_rad", "turn": "turned_rad"}
        radians: dict[str, Any] = {
            keys[name]: float(np.radians(value)) for name, value in turns.items()
        }
        telemetry = twin(case, seed=given.seed, rest_seen=given.rest_seen, **radians)
        comments = [
            f"synthetic: not measured; made by sunspin {version()} from published facts",
            f"synthetic: python -m sunspin.philae.twin --case {given.case} --seed {given.seed}{asked} {given.out.name}",
        ]
        more = [
            "synthetic: powers in W on an arbitrary scale; the truth behind them is in twin_truth.toml"
        ]
        write_new(given.out, csv_text(case.vehicle, telemetry, comments + more), given.force)
        about = [
            f"The truth behind {given.out.name}; see sunspin.philae.twin_philae for how each part was chosen."
        ]
        write_new(
            given.out.parent / "twin_truth.toml",
            truth_text(telemetry, comments + about),
            given.force,
        )
    except SunspinError as error:
        print(error, file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
