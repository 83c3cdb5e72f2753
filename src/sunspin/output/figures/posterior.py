"""The posterior: rates against each other, and how the search and the sampling went."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure

from sunspin.output.figures import COLOURS, named, titled

SHOWN_DRAWS = 3000

MOST_ROUNDS = 8
"""Rounds of sampling that are named on the axis."""


def corner_figure(tree: Any) -> Figure:
    """Components of the rate at the first sample and its size, every pair of them, one colour to a mode."""
    posterior = tree["posterior"]
    omega = np.degrees(posterior["omega_B"].values.reshape(-1, 3)[:SHOWN_DRAWS])
    solution = posterior["solution_id"].values.ravel()[:SHOWN_DRAWS]
    value = np.column_stack([omega, np.linalg.norm(omega, axis=1)])
    names = (r"$\omega_x$", r"$\omega_y$", r"$\omega_z$", r"$|\omega|$")
    figure = Figure(figsize=(9, 9), layout="constrained")
    grid = figure.subplots(4, 4, sharex="col")
    for i in range(4):
        for j in range(4):
            axes = grid[i, j]
            if j > i:
                axes.axis("off")
            elif i == j:
                _histogram(axes, value[:, i], solution)
                axes.set_yticks([])
            else:
                for k in np.unique(solution):
                    axes.plot(
                        *value[solution == k][:, [j, i]].T,
                        ".",
                        ms=1.5,
                        alpha=0.4,
                        color=COLOURS[int(k) % 8],
                        rasterized=True,
                    )
            if i == 3:
                axes.set_xlabel(f"{names[j]} (deg/s)")
                axes.tick_params(axis="x", labelrotation=45, labelsize=7)
            if j == 0 and i > 0:
                axes.set_ylabel(f"{names[i]} (deg/s)")
            axes.tick_params(axis="y", labelsize=7)
    word = f": {named(tree.attrs['verdict_word'])}" if "verdict_word" in tree.attrs else ""
    text = f"Body rate of {named(tree.attrs.get('vehicle', 'the body'))} at the first sample{word}"
    figure.suptitle(titled(text, tree.attrs.get("synthetic")), fontsize=10)
    return figure


def _histogram(axes: Any, value: np.ndarray, solution: np.ndarray) -> None:
    edges = np.histogram_bin_edges(value, 60)
    for k in np.unique(solution):
        axes.hist(
            value[solution == k], edges, histtype="stepfilled", color=COLOURS[int(k) % 8], alpha=0.7
        )


def search_figure(tree: Any) -> Figure:
    """Hypotheses before and after each window, and the log evidence of each round of sampling."""
    search, sampling = tree["search"], tree["sampling"]
    figure = Figure(figsize=(9, 3.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    stage = np.arange(search.sizes["stage"])
    left.semilogy(
        stage, np.maximum(search["hypotheses"].values, 1), "o-", color=COLOURS[0], label="fitted"
    )
    left.semilogy(stage, np.maximum(search["kept"].values, 1), "s-", color=COLOURS[1], label="kept")
    left.set_xticks(stage, [str(n) for n in search["samples"].values], fontsize=7)
    left.set_xlabel("samples in the window")
    left.set_ylabel("hypotheses")
    left.legend(fontsize=8)
    right.plot(sampling["log_evidence"].values, "o-", color=COLOURS[0])
    right.set_xlabel("round, effective share, Pareto's k")
    right.set_ylabel("log evidence")
    rounds = np.arange(sampling.sizes["round"])[
        :: max(1, -(-sampling.sizes["round"] // MOST_ROUNDS))
    ]
    shares, tails = sampling["effective_share"].values[rounds], sampling["pareto_k"].values[rounds]
    right.set_xticks(
        rounds,
        [f"{i}\n{s:.0%}\n{k:.2f}" for i, s, k in zip(rounds, shares, tails, strict=True)],
        fontsize=7,
    )
    figure.suptitle(titled("Search and sampling", tree.attrs.get("synthetic")), fontsize=10)
    return figure
