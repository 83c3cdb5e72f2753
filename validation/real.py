"""Compare rates of real satellites with withheld measurements, and write the page on it: ``python -m validation real``."""

from __future__ import annotations

import argparse
import os
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import xarray as xr

import sunspin as ss
from studies.skcube_data import FREE_S
from studies.skcube_gyro import fit, neighbouring_beacons
from sunspin.compute.pool import worker_count

PAGE = Path(__file__).parents[1] / "build" / "real-data.md"
"""Where the page is written, unless `--page` names another place; its main figures are in `docs/accuracy.md`."""

SIDES = {"Sun sensors and magnetometer": ["gyro_B"], "Sun sensors alone": ["gyro_B", "field_B"]}
"""Sensors given to `rates`, and the variables that are withheld."""

DRAWS = 4000
"""Number of resamplings of passes for the range of a share."""


class Gyro(NamedTuple):
    """Gyro calibration: scale (deg/s per count), zero (3) in counts, and one sigma of each."""

    scale: float
    zero: np.ndarray
    scale_sigma: float
    zero_sigma: np.ndarray


class PassComparison(NamedTuple):
    """Comparison of a pass with the gyro: begin, number of samples, whether the coils were off (`free`), verdict (`status`).

    In deg/s: mean `rate` (3) and its `sigma` (3), `miss` (3), its difference from the gyro (NaN without one), and one sigma of the
    gyro (3).
    """

    utc: str
    samples: int
    free: bool
    status: str
    rate: np.ndarray
    sigma: np.ndarray
    miss: np.ndarray
    gyro_sigma: np.ndarray

    @property
    def pull(self) -> np.ndarray:
        """Normalised error: difference over both sigmas together."""
        return self.miss / np.hypot(self.sigma, self.gyro_sigma)


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this campaign."""
    parser.add_argument(
        "--data", type=Path, default=os.environ.get("SUNSPIN_DATA"), help="folder of docs/data.md"
    )
    parser.add_argument("--page", type=Path, default=PAGE, help="where the page is written")


def main(options: Any) -> int:
    """Estimate the rates of skCUBE and write the page that compares them with its gyro; return 1 if the data are missing."""
    if options.data is None or not (Path(options.data) / "skcube" / "skcube_adcs.csv").is_file():
        print(
            "no skcube/skcube_adcs.csv: name the folder with --data or SUNSPIN_DATA (docs/data.md says what is in it)"
        )
        return 1
    craft = ss.load_vehicle("skcube")
    data = ss.read_telemetry(Path(options.data) / "skcube" / "skcube_adcs.csv", craft)
    gyros = fit_gyros(craft, data)
    comparisons = {}
    for name, without in SIDES.items():
        comparisons[name] = compare_with_gyro(
            craft, data, ss.rates(craft, data.drop_vars(without), workers=worker_count(None)), gyros
        )
        print(f"{name}: {len(comparisons[name])} passes", flush=True)
    options.page.parent.mkdir(parents=True, exist_ok=True)
    options.page.write_text(page(comparisons, gyros), "utf-8")
    print(f"written: {options.page}")
    return 0


def fit_gyros(craft: ss.Vehicle, data: xr.Dataset) -> dict[str, Gyro]:
    """Return, for each day with a gyro, its scale and zero as fitted to the Sun sensors of all other days."""
    pairs = neighbouring_beacons(craft, data)
    noise = craft.sensors.disturbance.acceleration_noise
    gyros = {}
    for day in np.unique(pairs.day):
        value, sigma, _ = fit(pairs.take(pairs.day != day), noise)
        gyros[str(day)] = Gyro(value[0], value[1:], sigma[0], sigma[1:])
    return gyros


def compare_with_gyro(
    craft: ss.Vehicle, data: xr.Dataset, result: xr.Dataset, gyros: dict[str, Gyro]
) -> list[PassComparison]:
    """Return the comparison of each pass of a result with the gyro's counts at the same samples.

    `gyros` has the calibration of each UTC day. A pass of another day, or without counts, has no difference (NaN).
    """
    gyro = craft.sensors.gyro
    assert gyro is not None
    counts = (data["gyro_B"] / gyro.scale_rad_s + gyro.zero).sel(time=result["time"]).values
    rows = []
    for k in range(result.sizes["pass_id"]):
        in_pass = result["pass_of"].values == k
        utc = str(result["utc_start"].values[k])
        with_gyro = in_pass & np.isfinite(counts).all(axis=1)
        miss, gyro_sigma = np.full(3, np.nan), np.full(3, np.nan)
        if with_gyro.any() and utc[:10] in gyros:
            of_day = gyros[utc[:10]]
            gyro_rate = of_day.scale * (counts[with_gyro] - of_day.zero)  # deg/s
            miss = (np.degrees(result["omega_B"].values[with_gyro]) - gyro_rate).mean(axis=0)
            gyro_sigma = np.hypot(
                of_day.scale * of_day.zero_sigma,
                gyro_rate.mean(axis=0) * of_day.scale_sigma / of_day.scale,
            )
        rows.append(
            PassComparison(
                utc[:16].replace("T", " "),
                int(in_pass.sum()),
                bool(result["time"].values[in_pass][0] > FREE_S),
                str(result["why_not_decided"].values[k]) or "decided",
                np.degrees(result["omega_mean_B"].values[k, 0]),
                np.degrees(result["omega_sigma_all_B"].values[k]),
                miss,
                gyro_sigma,
            )
        )
    return rows


def figures(rows: list[PassComparison]) -> str:
    """Return the figures of these passes as cells of a table.

    They are passes, decided ones, shares of components within one and two sigma with 90 % ranges over resampled passes, rms and
    largest normalised error, median sigma and median error.
    """
    rows = [row for row in rows if np.isfinite(row.miss).all()]
    if not rows:
        return "0 | | | | | | | "
    pull = np.abs([row.pull for row in rows])
    resampled = np.random.default_rng(0).integers(len(rows), size=(DRAWS, len(rows)))
    shares = []
    for limit in (1.0, 2.0):
        inside = (pull < limit).mean(axis=1)  # share of the components of each pass
        low, high = np.quantile(inside[resampled].mean(axis=1), [0.05, 0.95])
        shares.append(f"{inside.mean():.0%} ({low:.0%} to {high:.0%})")
    decided = sum(row.status == "decided" for row in rows)
    sigma, miss = (
        np.median(np.abs([getattr(row, name) for row in rows])) for name in ("sigma", "miss")
    )
    rms = np.sqrt((pull**2).mean())
    return f"{len(rows)} | {decided} | {' | '.join(shares)} | {rms:.2f} | {pull.max():.1f} | {sigma:.2f} | {miss:.2f}"


SUMMARY_HEADER = (
    "| given | passes | with gyro | decided | in 1 sigma (68 %) | in 2 sigma (95 %) | rms normalised error "
    "| largest | median sigma, deg/s | median error, deg/s |"
)
PASSES_HEADER = "| began (UTC) | samples | coils | status | rate, deg/s | one sigma | error, deg/s | largest normalised error |"

KINDS = {
    "free, decided": (True, True),
    "free, not decided": (True, False),
    "coils driven, decided": (False, True),
    "coils driven, not decided": (False, False),
}


def page(comparisons: dict[str, list[PassComparison]], gyros: dict[str, Gyro]) -> str:
    """Return the page in Markdown."""
    lines = [HEAD, SUMMARY_HEADER, "|---" * SUMMARY_HEADER.count(" |") + "|"]
    for name, rows in comparisons.items():
        for kind, (free, decided) in KINDS.items():
            of_kind = [
                row for row in rows if row.free == free and (row.status == "decided") == decided
            ]
            lines.append(f"| {name} | {kind} | {figures(of_kind)} |")
    lines += [GYRO, "| day left out | scale, deg/s per count | zero, counts |", "|---|---|---|"]
    for day, gyro in gyros.items():
        zero = ", ".join(
            f"{value:.0f} +- {sigma:.0f}"
            for value, sigma in zip(gyro.zero, gyro.zero_sigma, strict=True)
        )
        lines.append(f"| {day} | {gyro.scale:.4f} +- {gyro.scale_sigma:.4f} | {zero} |")
    for name, rows in comparisons.items():
        lines += [
            f"\n## All passes: {name}\n",
            PASSES_HEADER,
            "|---" * PASSES_HEADER.count(" |") + "|",
        ]
        # largest normalised error first, passes without a gyro last
        for row in sorted(rows, key=lambda row: -np.nan_to_num(np.abs(row.pull).max(), nan=-1.0)):
            rate, sigma, miss = (
                ", ".join(f"{v:.2f}" for v in part) for part in (row.rate, row.sigma, row.miss)
            )
            error_cells = (
                (miss, f"{np.abs(row.pull).max():.1f}")
                if np.isfinite(row.miss).all()
                else ("no gyro in this file", "")
            )
            coils = "off" if row.free else "driven"
            lines.append(
                f"| {row.utc} | {row.samples} | {coils} | {row.status} | {rate} | {sigma} | {' | '.join(error_cells)} |"
            )
    return "\n".join(lines) + "\n"


HEAD = """# Accuracy on real data

Written by `make validate-real` (`python -m validation real`) from the data in the folder `SUNSPIN_DATA`, whose layout is in
`docs/data.md`. skCUBE's telemetry is the only public set so far in which another sensor has measured the motion.

- **skCUBE**, a 1U CubeSat, 23 to 28 June 2017: Sun sensors, magnetometer, gyro of unknown scale, 40 s apart in passes of ten
  minutes. *Source*: raw frames in the public repository `yangwao/skCube-data-collector` (MIT licence, commit
  59258b0de91c7828915a3137cc758bbdbec15402), folder `rawdata`; `sunspin decode ZIP --out skcube` makes tables of them.
  *Compared*: rates from the Sun sensors, with and without the magnetometer, with the gyro, which these rates do not use.

**The gyro is not independent of the Sun sensors.** Its scale and zero are in no document; they were fitted to the Sun directions of
these sensors. Each day is therefore compared with a fit on all *other* days, and the uncertainty of this fit counts. The gyro
readings of 28 June are not in this file. The scales of the sensors and the strength of the torques were chosen on 23 to 27 June too
(`cases/skcube/vehicle.toml`), which favours these passes. While the coils are driven (until 25 June 18:41) a torque acts that is
not modelled.

The normalised error is the difference of a pass's mean rate divided by both sigmas together. The range behind a share is that of
nine in ten resamplings of whole passes, because the components of one pass are not independent.

## Summary
"""

GYRO = """
Scale and zero of the gyro for each day, fitted to the Sun directions of the other days:
"""
