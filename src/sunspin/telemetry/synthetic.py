"""Parts of simulated cases: noise on powers, a Dataset in the form of `read_telemetry`, and its CSV file."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import xarray as xr

from sunspin.base.errors import OutputError
from sunspin.base.provenance import provenance
from sunspin.solve.rotations import tangent_basis
from sunspin.vehicle import Vehicle

TIME_STEP_S = 1e-3
"""Times of simulated cases are whole multiples of this, so that a CSV file holds them without loss."""

LEAST_LIT = 2.0
"""A lit panel reads at least this many lit thresholds, so that noise does not make it count as dark."""


def generator(seed: int, *key: int) -> np.random.Generator:
    """Return the random generator of one independent part of a simulated case.

    `key` is the number of the part, followed by that of the draw if the part is drawn many times.
    """
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=key))


def noisy_power(
    vehicle: Vehicle, power: np.ndarray, sigma: npt.ArrayLike | None, rng: np.random.Generator
) -> np.ndarray:
    """Return powers (..., n_panel) with Gaussian noise on the lit panels; dark panels read zero.

    A lit panel reads at least `LEAST_LIT` lit thresholds, or its power if that is less.

    Parameters
    ----------
    power : (..., n_panel)
    sigma : float or (n_panel), optional
        One sigma of the noise, in the unit of the powers; default: as the vehicle file states it.
    """
    each: Any = vehicle.input_noise if sigma is None else sigma
    noise = np.asarray(each, dtype=np.float64) * rng.standard_normal(power.shape)
    least = np.minimum(power, LEAST_LIT * (vehicle.telemetry.lit_threshold or 0.0))
    return np.where(power > 0, np.maximum(power + noise, least), 0.0)


def draw_tilts(
    vehicle: Vehicle, sigma_rad: float | np.ndarray, rng: np.random.Generator
) -> np.ndarray:
    """Draw a random misalignment of each panel: rotation vectors (n_panel, 3), rad, body axes.

    The components along two axes perpendicular to the panel's normal are Gaussian.

    Parameters
    ----------
    sigma_rad : float or (n_panel)
        Their standard deviation.
    """
    across = np.stack(tangent_basis(vehicle.panel_normals_B), axis=1)
    return np.einsum(
        "p,ps,psi->pi",
        np.broadcast_to(sigma_rad, len(across)),
        rng.standard_normal(across.shape[:2]),
        across,
    )


def on_time_grid(t_s: Any) -> np.ndarray:
    """Return times in s rounded to `TIME_STEP_S`."""
    return np.round(np.asarray(t_s, dtype=np.float64) / TIME_STEP_S) * TIME_STEP_S


def telemetry_dataset(
    vehicle: Vehicle,
    t_s: np.ndarray,
    power: np.ndarray,
    sun_B: np.ndarray,
    epoch_utc: str,
    truth: Mapping[str, Any],
    phase: np.ndarray | None = None,
) -> xr.Dataset:
    """Return synthetic telemetry in the form of `read_telemetry`, with the known truth.

    Parameters
    ----------
    t_s : (n), s from the epoch
    power : (n, n_panel)
        Readings, in the quantity of the vehicle's telemetry (W or A).
    sun_B : (n, 3)
        True direction to the Sun, which becomes the variable `true_sun_B`.
    truth : mapping
        Other true values; each becomes an attribute ``truth_...``.
    phase : (n), optional
        Name of the phase of each sample.
    """
    quantity = vehicle.telemetry.variable
    coords: dict[str, Any] = {
        "time": ("time", t_s, {"units": "s", "long_name": "time since the epoch"}),
        "panel": list(vehicle.input_names),
        "axis": ["x", "y", "z"],
    }
    if phase is not None:
        coords["phase"] = ("time", np.asarray(phase, dtype=np.str_))
    attrs = provenance(
        "telemetry",
        vehicle=vehicle.name,
        epoch_utc=epoch_utc if epoch_utc.endswith("Z") else epoch_utc + "Z",
        quantity=quantity,
        synthetic=1,
        **{f"truth_{key}": value for key, value in truth.items()},
    )
    long_name = "true direction to the Sun, body axes"
    return xr.Dataset(
        {
            quantity: (("time", "panel"), power, {"units": "W" if quantity == "power_W" else "A"}),
            "flag": ("time", np.zeros(len(t_s), dtype=np.uint8)),
            "true_sun_B": (("time", "axis"), sun_B, {"units": "1", "long_name": long_name}),
        },
        coords=coords,
        attrs=attrs,
    )


def csv_text(vehicle: Vehicle, telemetry: xr.Dataset, comments: list[str]) -> str:
    """Return the telemetry as CSV text: comment lines, UTC to the millisecond, values to 1e-6, and the phase if there is one."""
    form, epoch = vehicle.telemetry, datetime.fromisoformat(telemetry.attrs["epoch_utc"])
    columns = [form.columns.get(name, f"P{name}_W") for name in vehicle.input_names]
    table = pd.DataFrame(telemetry[form.variable].values, columns=columns)
    moments = [epoch + timedelta(milliseconds=round(1000 * t)) for t in telemetry["time"].values]
    table.insert(
        0, form.time_column, [f"{t.astimezone(UTC):%Y-%m-%dT%T.%f}"[:-3] + "Z" for t in moments]
    )
    if "phase" in telemetry.coords:
        table["phase"] = telemetry["phase"].values
    lines = table.to_csv(index=False, float_format="%.6f", lineterminator="\n")
    return "".join(f"# {comment}\n" for comment in comments) + lines


def truth_text(telemetry: xr.Dataset, comments: list[str]) -> str:
    """Return the truth of a simulated case (attributes ``truth_...``) as TOML text with comment lines."""
    import tomlkit

    truth = {
        key.removeprefix("truth_"): value.tolist() if hasattr(value, "tolist") else value
        for key, value in telemetry.attrs.items()
        if key.startswith("truth_")
    }
    return "".join(f"# {comment}\n" for comment in comments) + tomlkit.dumps(truth)


def refuse_existing(path: Path, force: bool) -> None:
    """Raise `OutputError` if the file exists and is not to be replaced (`force`)."""
    if path.exists() and not force:
        raise OutputError(
            "the file exists", do="choose another name or add --force", where=str(path)
        )


def write_new(path: Path, text: str, force: bool) -> None:
    """Write a text file in UTF-8; an existing file is replaced only with `force`.

    Raises
    ------
    OutputError
        The file exists, or cannot be written.
    """
    refuse_existing(path, force)
    try:
        path.write_text(text, encoding="utf-8", newline="\n")
    except OSError as error:
        raise OutputError(
            f"the file cannot be written ({error.strerror or error})",
            do="choose another place",
            where=str(path),
        ) from None
