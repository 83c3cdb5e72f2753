"""The collision's impulse as evidence, beyond the paper: the landing kernel's change of velocity and simulated collisions.

Run `python -m studies.impulse OUT --data FOLDER`.

The Sun is the only direction known in both body and comet axes. So the change of velocity gives two numbers: its size and its angle
to the Sun. A third is the angle about the Sun direction. It follows only if the vertical at the first touchdown points up through
the lander's body within a stated cone. Each simulated collision is weighted by its likelihood for these numbers. The time of the
collision is free, as the lander made a revolution in seconds.
"""

from __future__ import annotations

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
from validation.campaign import command, rows_folder, study_parser
from validation.controls import prepare_case

SUN = ("philae_spk", "sun_from_67p_20141112.csv")
"""Path of the table of Sun directions below the data folder."""

POLE_DEG, MERIDIAN_DEG, DEG_PER_DAY = (69.54, 64.11), 114.69, 696.543884683
"""Axes of comet 67P: right ascension and declination of its pole (J2000); angle of the prime meridian at J2000 from the node of the
comet's equator, and its rate per day. Archinal et al., Celest. Mech. Dyn. Astr. 130, 22 (2018), Table 3, of March to September
2014.
"""

SPIN_COMET = np.array([0.0, 0.0, np.radians(DEG_PER_DAY) / 86400.0])
"""Rotation rate of the comet (3) in rad/s, in comet axes."""

AXES_SIGMA_RAD = float(np.radians(2.0))
"""One sigma of directions in November 2014. The constants end in September, and published spins differ by 0.01 degrees a day. The
landing kernel's axes may be those of a shape model that is a degree off.
"""

FREE_S, INSTANTS = 60.0, 8
"""Largest shift (s) of the collision from its time in the timeline, and number of instants that are tried."""

CONE_RAD = float(np.radians(30.0))
"""Half angle of the cone about the body's z axis in which the vertical at the touchdown lies, for the third number."""

LEAST_RUNS = 25.0
"""Least effective number of collisions for a weighted mean."""

SOURCES = {"scan": "90 % set of the built-in telemetry", "published": "printed lines"}
"""Sources of the motions (`sunspin reproduce --candidates`)."""


def comet_from_J2000(tdb_s: float) -> np.ndarray:
    """Return the matrix (3, 3) from J2000 to comet axes at TDB seconds past J2000; z is the pole, x the meridian."""
    right_ascension, declination = POLE_DEG
    meridian = (MERIDIAN_DEG + DEG_PER_DAY * tdb_s / 86400.0) % 360.0
    angles = [90.0 + right_ascension, 90.0 - declination, meridian]
    return Rotation.from_euler("ZXZ", angles, degrees=True).as_matrix().T


def velocity_J2000(tdb_s: float, state: np.ndarray) -> np.ndarray:
    """Return the velocity (3) in m/s in J2000 of a position and velocity (6), m and m/s, in rotating comet axes: v + w x r."""
    return comet_from_J2000(tdb_s).T @ (state[3:] + np.cross(SPIN_COMET, state[:3]))


@dataclass(frozen=True)
class VelocityChange:
    """Change of velocity: its size (m/s), its angle to the Sun, and the angle about the Sun from the touchdown's vertical (rad)."""

    change_m_s: float
    to_sun_rad: float
    about_sun_rad: float

    @property
    def direction_sigma_rad(self) -> float:
        """Standard error of its direction in space, rad."""
        return float(np.hypot(SIGMA_M_S / self.change_m_s, AXES_SIGMA_RAD))

    def weights(self, runs: xr.Dataset, numbers: int = 2) -> np.ndarray:
        """Return the likelihood (n) of simulated collisions for the first `numbers` of size, angle to the Sun and angle about it.

        It is 1 if these are exact, and 0 for runs that could not be computed (NaN).
        """
        about = runs["change_about_sun"].values - self.about_sun_rad
        about = np.remainder(about + np.pi, 2 * np.pi) - np.pi
        # in sigmas; a rotation about the Sun moves a direction at angle a to it by sin(a) of it
        differences = [
            (runs["velocity_change"].values - self.change_m_s) / SIGMA_M_S,
            (runs["change_to_sun"].values - self.to_sun_rad) / self.direction_sigma_rad,
            about * np.sin(self.to_sun_rad) / self.direction_sigma_rad,
        ]
        return np.nan_to_num(
            np.exp(-0.5 * np.sum(np.square(differences[:numbers]), axis=0)), nan=0.0
        )


def read_velocity_change(case: Case, folder: Path) -> VelocityChange:
    """Read the change of velocity from the kernel and the Sun directions in the data folder.

    Raises
    ------
    InputError
        A file is missing or damaged, or has no Sun direction at the time of the collision.
    """
    path = folder.joinpath(*KERNEL)
    touchdown, before = (event_tdb_s(case, name) for name in ("first_touchdown", "collision"))
    after = before + 1.0  # the kernel has a state each second
    at_touchdown, state_before, state_after = read_kernel_states(
        path, [np.ceil(touchdown), before, after]
    )
    sun = sun_J2000(folder, before)
    change = velocity_J2000(after, state_after) - velocity_J2000(before, state_before)
    up = comet_from_J2000(touchdown).T @ at_touchdown[:3]  # away from the comet's centre
    size = float(np.linalg.norm(change))
    if not (np.isfinite(size) and size > 0):
        what = "the trajectory kernel holds no collision"
        raise InputError(what, do="download it again", where=str(path))
    to_sun, about = (float(angle[0]) for angle in angle_about(change[None], sun[None], up[None]))
    return VelocityChange(size, to_sun, about)


def sun_J2000(folder: Path, tdb_s: float) -> np.ndarray:
    """Read the Sun direction (3) in J2000 from the data folder; raise `InputError` if there is none at that time."""
    path = folder.joinpath(*SUN)
    if not path.is_file():
        do = "docs/data.md says where they come from"
        raise InputError("the Sun's directions are not there", do=do, where=str(path))
    try:
        values = read_table(path).cells.iloc[:, 1:5].astype(float).to_numpy()  # time, x, y, z
    except ValueError:
        values = np.zeros((0, 4))  # refused below
    if values.shape[1] < 4 or not len(values) or not values[0, 0] <= tdb_s <= values[-1, 0]:
        what = "the file has no direction of the Sun at the collision"
        raise InputError(what, do="download it again", where=str(path))
    sun = np.array([np.interp(tdb_s, values[:, 0], values[:, k]) for k in (1, 2, 3)])
    return sun / np.linalg.norm(sun)


def load_motions(source: str, seed: int) -> candidates.CandidateSets:
    """Return the motions of the built-in telemetry, as `sunspin reproduce --candidates` selects them."""
    case, sun = prepare_case()
    options = Options(source, seed=seed)
    scan = metrics.scan_telemetry(case, sun, options)
    return candidates.compute(scan, data_check.compute(case, sun, None, seed), options)


def simulate_collisions(chain: candidates.CandidateSets, n: int, seed: int) -> xr.Dataset:
    """Simulate about `n` collisions of the motions at free times, with `speed_touchdown` (rad/s) of each motion.

    Nothing after the impact matters, so the flight ends a second later.
    """
    (_, real), starts = chain.rebound.scenarios(), chain.chosen.dataset()
    vehicle, count = chain.case.vehicle, max(n // INSTANTS, 1)
    runs_at_instant = []
    # middles of equal parts of the interval from -FREE_S to FREE_S
    for k, shift_s in enumerate(FREE_S * (2 * (np.arange(INSTANTS) + 0.5) / INSTANTS - 1)):
        before_s = real.before_s + float(shift_s)
        scenario = replace(real, before_s=before_s, after_s=1.0, vertical=CONE_RAD)
        instant_seed = seed + 1000 + k
        runs_at_instant.append(
            outcomes(vehicle, starts, "off", count, instant_seed, scenario=scenario)
        )
    runs = xr.concat(runs_at_instant, "run", combine_attrs="drop_conflicts")
    speed = chain.chosen.speed_touchdown[runs["candidate"].values]
    return runs.assign(speed_touchdown=("run", speed))


def angular_speeds(runs: xr.Dataset) -> dict[str, np.ndarray]:
    """Return the angular speeds (n) in rad/s at three instants."""
    before, after = (
        np.linalg.norm(runs[f"omega_{name}_B"].values, axis=1) for name in ("before", "after")
    )
    return {
        "just after the first touchdown": runs["speed_touchdown"].values,
        "just before the collision": before,
        "just after the collision": after,
    }


def make_table(name: str, runs: xr.Dataset, change: VelocityChange) -> str:
    """Return the mean rates in Markdown: without the impulse, and with one, two and three of its numbers.

    A mean of fewer than `LEAST_RUNS` effective collisions is "not known".
    """
    weights = [
        np.ones(runs.sizes["run"]),
        *(change.weights(runs, numbers) for numbers in (1, 2, 3)),
    ]
    effective = [effective_runs(weight) for weight in weights]
    text = f"| {name}: mean angular speed, rad/s "
    text += "| without | size | size and angle | with the third number |\n|---|---|---|---|---|\n"
    for instant, values in angular_speeds(runs).items():
        cells = [
            str(estimate(values, weight)) if size >= LEAST_RUNS else "not known"
            for weight, size in zip(weights, effective, strict=True)
        ]
        text += "| " + " | ".join([instant, *cells]) + " |\n"
    counts = [f"{size:,.0f}" for size in effective]
    return text + "| " + " | ".join(["effective number of collisions", *counts]) + " |\n"


def impulse_figure(runs_of: dict[str, xr.Dataset], change: VelocityChange) -> Figure:
    """Draw the simulated impulses with the kernel's (size, angle to the Sun), and the rate after the collision.

    The rate is drawn with the weights of the impulse and without. `runs_of`: name of `SOURCES` -> its simulated collisions.
    """
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    impacts, after = figure.subplots(1, 2)
    runs = runs_of["scan"]
    angle = np.degrees(runs["change_to_sun"].values[::20])
    impacts.plot(runs["velocity_change"].values[::20], angle, ".", ms=2, color=COLOURS[5])
    sigma = np.degrees(change.direction_sigma_rad)
    kernel = change.change_m_s, np.degrees(change.to_sun_rad), sigma, SIGMA_M_S
    impacts.errorbar(*kernel, fmt="o", ms=4, capsize=3, color=COLOURS[1], label="landing kernel")
    impacts.plot([], [], ".", color=COLOURS[5], label="simulated collisions, every 20th")
    impacts.set(xlabel="change of velocity (m/s)", ylabel="angle to the Sun (deg)")
    bins = np.linspace(0.0, 1.5, 46)
    for k, (source, simulated) in enumerate(runs_of.items()):
        speed = angular_speeds(simulated)["just after the collision"]
        for weight, line_style, label in (
            (None, ":", f"{SOURCES[source]}, without"),
            (change.weights(simulated), "-", f"{SOURCES[source]}, with"),
        ):
            style = {"histtype": "step", "density": True, "color": COLOURS[k], "ls": line_style}
            after.hist(speed, bins, weights=weight, label=label, **style)
    after.set(xlabel="angular speed just after the collision (rad/s)", ylabel="density (s/rad)")
    for axes in (impacts, after):
        axes.legend(fontsize=8)
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its table and figure."""
    parser = study_parser("impulse", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    data = os.environ.get("SUNSPIN_DATA")
    parser.add_argument("--data", type=Path, default=data, help="default: SUNSPIN_DATA")
    parser.add_argument("--runs", type=int, default=40_000, help="simulated collisions")
    parser.add_argument("--seed", type=int, default=0)
    options, case = parser.parse_args(arguments), load_case("philae")
    if options.data is None:
        do = "give --data, or set SUNSPIN_DATA (docs/data.md)"
        raise InputError("the landing kernel is not in this repository", do=do)
    change, out = read_velocity_change(case, Path(options.data)), rows_folder(options.out)
    runs_of = {
        source: simulate_collisions(load_motions(source, options.seed), options.runs, options.seed)
        for source in SOURCES
    }
    text = f"Change of velocity {change.change_m_s:.4f} m/s, {np.degrees(change.to_sun_rad):.1f} deg from the Sun.\n"
    for source, runs in runs_of.items():
        text += "\n" + make_table(SOURCES[source], runs, change)
    (out / "impulse.md").write_text(text, "utf-8")
    impulse_figure(runs_of, change).savefig(out / "impulse.png", dpi=150)
    print(text)


if __name__ == "__main__":
    sys.exit(main())
