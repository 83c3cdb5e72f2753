"""Draw docs/images/calibration.png: PYTHONPATH=. python docs/calibration_figure.py FOLDER [PICTURE].

FOLDER as `make calibrate` fills it.
"""

import sys
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from scipy.stats import beta, binom

from validation.calibrate import QUANTITIES, read

NAMES = (
    r"$\omega_x$",
    r"$\omega_y$",
    r"$\omega_z$",
    "|H|",
    r"$\theta$",
    r"$\alpha$",
    "log-likelihood",
)
BINS = 10

rows = read(Path(sys.argv[1]))["unknown"]
picture = (
    Path(sys.argv[2]) if len(sys.argv) > 2 else Path(__file__).parent / "images" / "calibration.png"
)
n = len(rows)
figure = Figure(figsize=(10, 5), layout="constrained")
grid = figure.subplots(2, 4)
low, high = binom.ppf([0.025, 0.975], n, 1 / BINS)
for axes, key, name in zip(grid.ravel(), QUANTITIES, NAMES, strict=False):
    axes.axhspan(low, high, color="0.88", lw=0)
    axes.hist(
        [row["ranks"][key] for row in rows],
        np.linspace(0, 1, BINS + 1),
        color="C0",
        edgecolor="white",
    )
    axes.set_title(f"rank of {name}", fontsize=9)
    axes.set_ylim(0, max(high * 1.6, 5))
axes = grid.ravel()[-1]
level = np.sort([row["level"] for row in rows])
order = np.arange(1, n + 1)
axes.fill_betweenx(
    order / n,
    beta.ppf(0.025, order, n - order + 1),
    beta.ppf(0.975, order, n - order + 1),
    color="0.88",
    lw=0,
)
axes.step(level, order / n, where="post", color="C0")
axes.plot([0, 1], [0, 1], color="0.4", lw=0.8)
axes.set_title("share of truths inside", fontsize=9)
axes.set_xlabel("probability of the region", fontsize=8)
for axes in grid.ravel():
    axes.tick_params(labelsize=7)
figure.suptitle(
    f"{n} synthetic twins of Philae; grey: 95 % of what a right posterior gives in each bin",
    fontsize=10,
)
figure.savefig(picture, dpi=110)
