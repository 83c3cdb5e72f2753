"""Information in each component of the Sun direction: the paper keeps r_z and finds little in r_x and r_y (section 2.3).

Run `python -m studies.components OUT`.

The scan of the built-in telemetry is repeated with the distribution of each component, on every fifth grid point. The threshold of
each 90 % set is calibrated on the same simulated rebounds. A component is informative if its set is a small part of the scan range.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from sunspin.dynamics.batch import run
from sunspin.estimate.scan.directions import reconstructible_mask
from sunspin.estimate.scan.histogram import BINS, distances_to_target, target_segments
from sunspin.output.figures import COLOURS
from sunspin.philae.rebound import Rebound, make_rebound, scan_grid
from sunspin.philae.threshold import CONFIDENCE, simulate_similar_rebounds, threshold_index
from validation.campaign import command, rows_folder, study_parser
from validation.controls import prepare_case

STEP_S = 4.0
"""Interval (s) between instants of a simulated track; it counts as the time that a component spends in a bin."""

DIRECTION_ERROR, CHUNK = 1e-2, 256
"""Largest error of the directions (rad), less than a bin, and number of motions whose tracks are in memory at once (8 MB for 45
min).
"""


def histograms(rebound: Rebound, omega_B: np.ndarray) -> np.ndarray:
    """Return histograms (3, n, BINS) of r_x, r_y, r_z, for motions with rates omega_B (n, 3) in rad/s at the first sample.

    Only instants count at which the panels determine the direction.
    """
    vehicle, states = rebound.case.vehicle, rebound.states(omega_B)
    t = np.arange(STEP_S, rebound.window_s + STEP_S / 2, STEP_S)
    hist, mask = np.zeros((3, len(states), BINS), dtype=np.float32), reconstructible_mask(vehicle)
    for begin in range(0, len(states), CHUNK):
        index = np.arange(begin, min(begin + CHUNK, len(states)))
        track = run(vehicle, states.take(index), t, error=DIRECTION_ERROR).sun_B
        row, instant = np.nonzero(mask.contains(track))
        bins = np.clip(((track + 1) * BINS / 2).astype(int), 0, BINS - 1)[row, instant]
        for axis in range(3):
            np.add.at(hist[axis], (index[row], bins[:, axis]), 1)
    return hist


def calibrate_scans(rebound: Rebound, coarser: int, n_rebounds: int) -> list[dict]:
    """Return for x, y and z the EMD (n) of each motion of the grid, "emd", and the calibrated "factor" of the 90 % set.

    The factor is a quantile, over simulated rebounds, of the EMD of the true motion over the smallest of the scan.
    """
    axes = scan_grid(rebound.case, coarser).values()
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    simulated = simulate_similar_rebounds(rebound, n_rebounds, seed=0)
    # the motions of the grid, and after them the true motions of the simulated rebounds
    n_grid = len(grid)
    hist = histograms(rebound, np.concatenate([grid, [each.omega_B for each in simulated]]))
    measured, scans = rebound.samples["sun_B"].values[rebound.reconstructed], []
    for axis in range(3):
        ratio = []
        for k, each in enumerate(simulated):
            emd = distances_to_target(hist[axis], target_segments(each.seen_B[:, axis]))
            ratio.append(emd[n_grid + k] / emd[:n_grid].min())
        factor = np.sort(ratio)[threshold_index(len(ratio), CONFIDENCE)]
        emd = distances_to_target(hist[axis, :n_grid], target_segments(measured[:, axis]))
        scans.append({"emd": emd, "factor": float(factor)})
    return scans


def make_table(scans: list[dict]) -> str:
    """Return the results in Markdown, a line for each component."""
    text = "| component | smallest EMD | factor of the 90 % set | its share of the scanned box |\n"
    text += "|---|---|---|---|\n"
    for name, scan in zip("xyz", scans, strict=True):
        emd, least = scan["emd"], scan["emd"].min()
        share = np.mean(emd < scan["factor"] * least)
        text += f"| r_{name} | {least:.4f} | {scan['factor']:.2f} | {share:.1%} |\n"
    return text


def shares_figure(scans: list[dict]) -> Figure:
    """Draw the share of the scan range against the factor on the smallest EMD, with each 90 % set as a dot."""
    figure = Figure(figsize=(6.0, 4.2), layout="constrained")
    axes, factors = figure.subplots(), np.geomspace(1.0, 30.0, 200)
    for name, colour, scan in zip("xyz", COLOURS, scans, strict=False):
        ratio, factor = scan["emd"] / scan["emd"].min(), scan["factor"]
        share = (ratio[:, None] < factors).mean(axis=0)
        axes.semilogx(factors, share, color=colour, label=f"r_{name}")
        axes.plot(factor, np.mean(ratio < factor), "o", color=colour)
    axes.set(xlabel="factor on the smallest EMD", ylabel="share of the scanned box")
    axes.legend(fontsize=8)
    return figure


@command
def main(arguments: list[str] | None = None) -> None:
    """Run the study and write its table and figure."""
    parser = study_parser("components", __doc__)
    parser.add_argument("out", type=Path, help="folder of the results")
    parser.add_argument("--twins", type=int, default=60, help="synthetic rebounds")
    parser.add_argument("--coarser", type=int, default=5, help="every n-th point of the grid only")
    options = parser.parse_args(arguments)
    out, rebound = rows_folder(options.out), make_rebound(*prepare_case())
    scans = calibrate_scans(rebound, options.coarser, options.twins)
    (out / "components.md").write_text(make_table(scans), "utf-8")
    shares_figure(scans).savefig(out / "components.png", dpi=150)
    print(make_table(scans))


if __name__ == "__main__":
    sys.exit(main())
