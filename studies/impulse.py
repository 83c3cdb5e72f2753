"""The collision's impulse as evidence, beyond the paper: the landing kernel's change of velocity against simulated collisions.

    python -m studies.impulse OUT --data FOLDER

The Sun is the only direction that body and comet axes share. So the change of velocity gives two numbers: its size and its angle to
the Sun. A third, the angle about the Sun, follows only if the vertical at the first touchdown points up through the lander's body
within a stated cone. Each simulated collision is weighted by how well it gives these numbers. The time of the collision is free, as
the lander turned once in seconds.
"""

from __future__ import annotations

import argparse
import os
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from sunspin.base.errors import InputError
from sunspin.base.tables import read_table
from sunspin.cases import Case, load_case
from sunspin.landing.flight import angle_about
from sunspin.landing.outcomes import outcomes
from sunspin.landing.tally import effective_runs, estimate
from sunspin.output.figures import COLOURS
from sunspin.philae import candidates, data_check, metrics
from sunspin.philae.collision import KERNEL, SIGMA_M_S, event_tdb_s, read_kernel_states
from sunspin.philae.rebound import Options
from validation.campaign import command, rows_folder
from validation.controls import prepare_case

SUN = ("philae_spk", "sun_from_67p_20141112.csv")

POLE_DEG, MERIDIAN_DEG, DEG_PER_DAY = (69.54, 64.11), 114.69, 696.543884683
"""Axes of comet 67P: right ascension and declination of its pole (J2000); the prime meridian's angle at J2000 from the node of the
comet's equator, and its growth. Archinal et al., Celest. Mech. Dyn. Astr. 130, 22 (2018), Table 3, of March to September 2014."""

SPIN_COMET = np.array([0.0, 0.0, np.radians(DEG_PER_DAY) / 86400.0])
"""rad/s, in comet axes."""

AXES_SIGMA_RAD = float(np.radians(2.0))
"""One sigma of directions in November 2014: the constants end in September, published spins differ by 0.01 degrees a day, and the
landing kernel's axes may be those of a shape model that is a degree off."""

FREE_S, INSTANTS = 60.0, 8
"""The collision may have come this long before or after its time in the timeline; instants tried."""

CONE_RAD = float(np.radians(30.0))
"""Half angle of the cone about upright in which the vertical at the touchdown lies, for the third number."""

LEAST_RUNS = 25.0
"""Effective collisions below which a weighted mean is not given."""

SOURCES = {"scan": "90 % set of the built-in telemetry", "published": "printed lines"}
"""Where the motions come from (`sunspin reproduce --candidates`)."""


def comet_from_J2000(tdb_s: float) -> np.ndarray:
    """Matrix (3, 3) from components in J2000 to those in comet axes, at TDB seconds past J2000; z is the pole, x the meridian."""
    right_ascension, declination = POLE_DEG
    meridian = (MERIDIAN_DEG + DEG_PER_DAY * tdb_s / 86400.0) % 360.0
    angles = [90.0 + right_ascension, 90.0 - declination, meridian]
    return Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix().T


def velocity_J2000(tdb_s: float, state: np.ndarray) -> np.ndarray:
    """Velocity (3) m/s in J2000 of a position and velocity (6), m and m/s, over the turning comet: v + w x r."""
    return comet_from_J2000(tdb_s).T @ (state[3:] + np.cross(SPIN_COMET, state[:3]))


@dataclass(frozen=True)
class Seen:
    """The change of velocity: its size (m/s), its angle to the Sun, and about it from the vertical of the touchdown (rad)."""

    change_m_s: float
    to_sun_rad: float
    about_sun_rad: float

    @property
    def direction_sigma_rad(self) -> float:
        """Of its direction in space."""
        return float(np.hypot(SIGMA_M_S / self.change_m_s, AXES_SIGMA_RAD))

    def weights(self, runs: xr.Dataset, numbers: int = 2) -> np.ndarray:
        """Likelihood (n) of simulated collisions by the first of size, angle to the Sun, angle about it; 1 where they are exact."""
        about = runs["change_about_sun"].values - self.about_sun_rad
        about = np.remainder(about + np.pi, 2 * np.pi) - np.pi
        off = [
            (runs["velocity_change"].values - self.change_m_s) / SIGMA_M_S,
            (runs["change_to_sun"].values - self.to_sun_rad) / self.direction_sigma_rad,
            about * np.sin(self.to_sun_rad) / self.direction_sigma_rad,
        ]
        return np.nan_to_num(np.exp(-0.5 * np.sum(np.square(off[:numbers]), axis=0)), nan=0.0)


def seen_in(case: Case, folder: Path) -> Seen:
    """What the kernel and the Sun's directions in the data folder say.

    Raises
    ------
    InputError
        A file that is missing, damaged, or holds no Sun at the time of the collision.
    """
    path = folder.joinpath(*KERNEL)
    touchdown, before = (event_tdb_s(case, name) for name in ("first_touchdown", "collision"))
    states = read_kernel_states(path, [np.ceil(touchdown), before, before + 1.0])
    sun = sun_J2000(folder, before)
    change = velocity_J2000(before + 1.0, states[2]) - velocity_J2000(before, states[1])
    up = comet_from_J2000(touchdown).T @ states[0][:3]
    size = float(np.linalg.norm(change))
    if not (np.isfinite(size) and size > 0):
        what = "the trajectory kernel holds no collision"
        raise InputError(what, do="download it again", where=str(path))
    to_sun, about = (float(x[0]) for x in angle_about(change[None], sun[None], up[None]))
    return Seen(size, to_sun, about)


def sun_J2000(folder: Path, tdb_s: float) -> np.ndarray:
    """Direction (3) to the Sun in J2000, from the data folder; an `InputError` where it has none at that time."""
    path = folder.joinpath(*SUN)
    if not path.is_file():
        do = "docs/data.md says where they come from"
        raise InputError("the Sun's directions are not there", do=do, where=str(path))
    try:
        values = read_table(path).cells.iloc[:, 1:5].astype(float).to_numpy()
    except ValueError:
        values = np.zeros((0, 4))
    if values.shape[1] < 4 or not len(values) or not values[0, 0] <= tdb_s <= values[-1, 0]:
        what = "the file has no direction of the Sun at the collision"
        raise InputError(what, do="download it again", where=str(path))
    sun = np.array([np.interp(tdb_s, values[:, 0], values[:, k]) for k in (1, 2, 3)])
    return sun / np.linalg.norm(sun)


def motions(source: str, seed: int) -> candidates.Chain:
    """The motions that `sunspin reproduce --candidates` takes, of the built-in telemetry."""
    case, sun = prepare_case()
    options = Options(source, seed=seed)
    scan = metrics.scan_telemetry(case, sun, options)
    return candidates.compute(scan, data_check.compute(case, sun, None, seed), options)


def collisions(chain: candidates.Chain, n: int, seed: int) -> xr.Dataset:
    """Some `n` simulated collisions of the motions at free times, with `speed_touchdown` (rad/s) of each motion.

    Nothing after the blow matters, so that the flight ends a second later.
    """
    (_, real), starts = chain.rebound.scenarios(), chain.chosen.dataset()
    each = []
    for k, shift in enumerate(FREE_S * (2 * (np.arange(INSTANTS) + 0.5) / INSTANTS - 1)):
        before_s = real.before_s + float(shift)
        scenario = replace(real, before_s=before_s, after_s=1.0, vertical=CONE_RAD)
        count, number = max(n // INSTANTS, 1), seed + 1000 + k
        each.append(outcomes(chain.case.vehicle, starts, "off", count, number, scenario=scenario))
    runs = xr.concat(each, "run", combine_attrs="drop_conflicts")
    speed = chain.chosen.speed_touchdown[runs["candidate"].values]
    return runs.assign(speed_touchdown=("run", speed))


def rates(runs: xr.Dataset) -> dict[str, np.ndarray]:
    """Angular speeds (n) in rad/s at three instants."""
    before, after = (
        np.linalg.norm(runs[f"omega_{name}_B"].values, axis=1) for name in ("before", "after")
    )
    return {
        "just after the first touchdown": runs["speed_touchdown"].values,
        "just before the collision": before,
        "just after the collision": after,
    }


def table_of(name: str, runs: xr.Dataset, seen: Seen) -> str:
    """Mean rates in Markdown, by no number of the impulse and by one, two and three."""
    weights = [np.ones(runs.sizes["run"]), *(seen.weights(runs, numbers) for numbers in (1, 2, 3))]
    effective = [effective_runs(weight) for weight in weights]
    text = (
        f"| {name}: mean angular speed, rad/s | without | size | size and angle | with the third "
    )
    text += "number |\n|---|---|---|---|---|\n"
    for instant, values in rates(runs).items():
        cells = [
            str(estimate(values, weight)) if worth >= LEAST_RUNS else "not known"
            for weight, worth in zip(weights, effective, strict=True)
        ]
        text += "| " + " | ".join([instant, *cells]) + " |\n"
    counts = [f"{worth:,.0f}" for worth in effective]
    return text + "| " + " | ".join(["effective number of collisions", *counts]) + " |\n"


def draw(each: dict[str, xr.Dataset], seen: Seen) -> Figure:
    """Size and direction of the simulated blows beside the kernel's, and what their weights do to the rate after."""
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    blows, after = figure.subplots(1, 2)
    runs = each["scan"]
    angle = np.degrees(runs["change_to_sun"].values[::20])
    blows.plot(runs["velocity_change"].values[::20], angle, ".", ms=2, color=COLOURS[5])
    sigma = np.degrees(seen.direction_sigma_rad)
    kernel = seen.change_m_s, np.degrees(seen.to_sun_rad), sigma, SIGMA_M_S
    blows.errorbar(*kernel, fmt="o", ms=4, capsize=3, color=COLOURS[1], label="landing kernel")
    blows.plot([], [], ".", color=COLOURS[5], label="simulated collisions, every 20th")
    blows.set(xlabel="change of velocity (m/s)", ylabel="angle to the Sun (deg)")
    bins = np.linspace(0.0, 1.5, 46)
    for k, (source, simulated) in enumerate(each.items()):
        speed = rates(simulated)["just after the collision"]
        for weight, line, what in ((None, ":", "without"), (seen.weights(simulated), "-", "with")):
            style = {"histtype": "step", "density": True, "color": COLOURS[k], "ls": line}
            after.hist(speed, bins, weights=weight, label=f"{SOURCES[source]}, {what}", **style)
    after.set(xlabel="angular speed just after the collision (rad/s)", ylabel="density (s/rad)")
    for axes in (blows, after):
        axes.legend(fontsize=8)
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(prog="python -m studies.impulse", description=__doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    data = os.environ.get("SUNSPIN_DATA")
    parser.add_argument("--data", type=Path, default=data, help="default: SUNSPIN_DATA")
    parser.add_argument("--runs", type=int, default=40_000, help="simulated collisions")
    parser.add_argument("--seed", type=int, default=0)
    given, case = parser.parse_args(arguments), load_case("philae")
    if given.data is None:
        do = "give --data, or set SUNSPIN_DATA (docs/data.md)"
        raise InputError("the landing kernel is not in this repository", do=do)
    seen, out = seen_in(case, Path(given.data)), rows_folder(given.out)
    each = {}
    for source in SOURCES:
        each[source] = collisions(motions(source, given.seed), given.runs, given.seed)
    text = f"Change of velocity {seen.change_m_s:.4f} m/s, {np.degrees(seen.to_sun_rad):.1f} deg from the Sun.\n"
    for source, runs in each.items():
        text += "\n" + table_of(SOURCES[source], runs, seen)
    (out / "impulse.md").write_text(text, "utf-8")
    draw(each, seen).savefig(out / "impulse.png", dpi=150)
    print(text)


if __name__ == "__main__":
    sys.exit(main())
