"""Starts of the search for a lander's motions: the reference sample, and a grid of rates there.

The reference is the sample at which rate and direction to the Sun define a motion. Rotations from it to the two samples next to it
are computed on a grid of rates that is fine enough to be interpolated. They do not depend on the direction to the Sun.

In each cell of the grid the readings are compared at points a quarter of the edge apart. The best point of each eighth of a cell is
a start, unless no direction near it agrees with the readings. From there least squares on interpolated rotations lead to the
nearest solution. So each motion has a start within an eighth of a cell.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from sunspin.base.errors import InputError
from sunspin.dynamics import batch
from sunspin.estimate.lander.allowed import cube_nodes, possible_directions, shortfall
from sunspin.estimate.lander.cells import (
    OF_CELL,
    OF_MISFIT,
    OF_PLACE,
    OF_STEP,
    OF_SUN,
    Cells,
    Limits,
    PanelTable,
    Tables,
    search_cells,
)
from sunspin.estimate.lander.model import LanderModel
from sunspin.estimate.lander.motions import Doubt, LanderMotions
from sunspin.estimate.lander.rate_grid import CORNERS, TRIAL_ERROR, RateGrid, Reached
from sunspin.estimate.settings import GridSettings
from sunspin.estimate.terms.powers import PanelPowers
from sunspin.solve.rotations import move_on_sphere, tangent_basis

CELLS_AT_ONCE, RUNS_AT_ONCE = 20_000, 4096
"""Cells that one thread searches together, and starts that it propagates back to the first sample together."""

STRETCH, HANDED_OVER = (1.05, 1.5), 1.3
"""Limits of the factor by which the angular speed of a body with unequal moments may grow until the reference, and a factor on the
rate that the body gets from slowing wheels. The ellipsoid of :class:`Reached` bounds the rates more closely."""

MIDDLES = 0.25 + 0.5 * CORNERS
"""Middles (8, 3) of the eighths of a cell, in parts of its edge."""

POINTS = 0.5 * CORNERS[:, None] + 0.25 * (0.5 + CORNERS)
"""Points (8 eighths, 8, 3) at which readings are compared, in parts of the edge."""

NO_SAMPLES = slice(0, 0)
"""An empty window."""


@dataclass(frozen=True)
class Reference:
    """The sample at which rate and direction define a motion, and the grid of rates there on which the search begins.

    `sample`: its index; `after_s`: its time after the first sample; `window`: it and its two neighbours, whose indices are `others`
    (m). The search tries the directions to the Sun `suns` (c, 3), body axes, with rates on a cubic grid, `edge` apart.

    Four largest rates (rad/s). At the first sample: `prior_max_rate`, the stated one, and `fastest`, which has a margin: faster
    motions are left out. At the reference: `max_rate`, to which a rate may grow from there and up to which the prior is uniform,
    and `limit`, that of the grid. `limit` is `max_rate`, or less than `prior_max_rate` if the grid would have too many cells.
    """

    sample: int
    after_s: float
    window: slice
    others: np.ndarray
    edge: float
    suns: np.ndarray
    limit: float
    max_rate: float
    fastest: float
    prior_max_rate: float

    @property
    def doubts(self) -> list[Doubt]:
        """Return the doubt in a list that not all rates can be searched; an empty list if they can."""
        if self.limit >= self.max_rate * (1 - 1e-9):
            return []
        text = f"only rates up to {np.degrees(self.limit):.3g} deg/s could be searched"
        return [Doubt(text, left_out=True)]

    def about(self, model: LanderModel) -> LanderModel:
        """Return the model with this sample as its reference, from which its times count."""
        return model.after(self.after_s, self.max_rate)


# ---- the reference ---------------------------------------------------------------------------------------------------------


def choose_reference(
    model: LanderModel, s: GridSettings, given_rate: bool = False, besides: slice = NO_SAMPLES
) -> Reference:
    """Return the reference with the shortest search, among samples at which no wheel can have stopped.

    If it can, it is away from the window `besides`, so that its own window has none of these samples. `given_rate`: whether the
    caller stated the largest rate. Then InputError if it needs more starts than can be tried. InputError also for motions that need
    too many integration steps.
    """
    reference, needed = _shortest_search(model, s, besides)
    if given_rate and needed > s.most_starts:
        # find the largest rate that can be searched, for the message; another reference may then be the best one
        smaller, of_smaller, starts = model, reference, needed
        while starts > s.most_starts:
            limit = 0.99 * rate_limit(s.most_starts / len(of_smaller.suns), of_smaller.edge)
            smaller = replace(smaller, max_rate=float(f"{limit:.3g}"))
            of_smaller, starts = _shortest_search(smaller, s, besides)
        what = f"max_rate_rad_s asks for {needed:.2g} starts, and {s.most_starts:.0e} at most can be tried in an hour"
        raise InputError(
            what,
            got=f"{model.max_rate:g}",
            do=f"with these samples give {smaller.max_rate:.3g} at most",
        )
    placed = reference.about(model)
    _require_computable(placed, placed.obs.t_s, reference.limit)
    return reference


def _shortest_search(
    model: LanderModel, s: GridSettings, besides: slice
) -> tuple[Reference, float]:
    """Return the reference with the shortest search, and the number of its starts with rates up to the limit of the prior.

    The time of a search is estimated: that of the starts, plus that of the motions which fit the first few samples. The number of
    these is about the product of the numbers of directions that the samples allow, times the volume of rates in units of
    1 / (time to the farthest sample)^3. That favours a reference halfway through a file, from which the samples are half as far.
    """
    t_s, panels = model.obs.t_s, model.panels
    read = np.flatnonzero(panels.present())  # samples with any reading
    lit = np.flatnonzero(panels.lit.any(axis=1))
    if besides != NO_SAMPLES:
        away = lit[(lit + 1 < besides.start) | (lit - 1 >= besides.stop)]
        lit = away if len(away) else lit
    # The reference may be a lit sample at which all wheels still run and have lost little momentum. Some of these are tried.
    choices = [k for k in lit if _wheels_run(model, t_s[k], s)] or [lit[0]]
    slow = [k for k in choices if model.spun_up(t_s[k]) <= s.most_spun * model.max_rate]
    choices = slow or choices[:1]
    evenly = np.linspace(0, len(choices) - 1, s.choices).round().astype(int)
    suns: dict[int, np.ndarray] = {}  # directions that each sample allows
    shortest_s, best, starts = np.inf, None, 0.0
    for sample in (choices[i] for i in np.unique(evenly)):
        near = read[np.argsort(np.abs(t_s[read] - t_s[sample]), kind="stable")[: s.few]]
        for k in (*near, sample):
            if k not in suns:
                suns[k] = possible_directions(panels, k, s)
        # the reference and the samples before and after it; at an end of the file both are on one side
        position = int(np.searchsorted(read, sample))
        first = min(max(position - 1, 0), max(len(read) - 3, 0))
        tried = read[first : first + 3]
        others = tried[tried != sample]
        after_s = float(t_s[sample])
        edge = s.turn_rad / (s.amplified * float(np.abs(t_s[others] - after_s).max()))
        if model.vehicle.channels:
            edge = min(edge, s.shared_edge * model.max_rate)
        max_rate, fastest = _rate_limits(model, after_s, s)
        reach_s = float(np.abs(t_s[near] - after_s).max())
        combinations = np.prod([len(suns[k]) for k in near], dtype=float)
        takes_s = s.start_cost * len(suns[sample]) * cell_count(max_rate, edge)
        takes_s += s.window_cost * (fastest * reach_s) ** 3 * combinations
        if best is not None and takes_s >= shortest_s:
            continue
        limit = min(model.max_rate, rate_limit(s.most_cells / len(suns[sample]), edge))
        shortest_s, starts = takes_s, cell_count(model.max_rate, edge) * len(suns[sample])
        best = Reference(
            sample=int(sample),
            after_s=after_s,
            window=slice(int(tried[0]), int(tried[-1]) + 1),
            others=others,
            edge=edge,
            suns=suns[sample],
            # all rates that may result from the prior, unless not even those of the prior can be searched
            limit=limit if limit < model.max_rate else max_rate,
            max_rate=max_rate,
            fastest=fastest,
            prior_max_rate=model.max_rate,
        )
    assert best is not None
    return best, starts


def _wheels_run(model: LanderModel, after_s: float, s: GridSettings) -> bool:
    """Return whether every wheel still has the part `speed_left` of its speed at `after_s`, or is held by its motor.

    Only then motions can be propagated back from there: friction that has stopped a wheel hides its past.
    """
    at_first, at_reference = (np.abs(model.nominal_speeds(time_s)) for time_s in (0.0, after_s))
    held = np.array([command == "hold" for command in model.commands], dtype=bool)
    return after_s == 0.0 or bool(np.all((at_reference > s.speed_left * at_first) | held))


def _rate_limits(model: LanderModel, after_s: float, s: GridSettings) -> tuple[float, float]:
    """Return two limits of the rate (rad/s): at a reference `after_s` (s) after the first sample, and at the first sample.

    The prior limits the rate at the first sample. Until the reference the body may become faster: wheels that run down give it
    their momentum, and with unequal moments of inertia its speed varies. So the first limit is higher than the prior's. Most
    motions within it were too fast at the first sample: those above the second limit are left out. That is the prior's with a
    margin (`faster_at_first`) and an allowance for the uncertain friction of the wheels (`spun_unsure`).
    """
    at_first = s.faster_at_first * model.max_rate
    if after_s == 0.0:
        return model.max_rate, at_first
    moments = np.linalg.eigvalsh(model.vehicle.require_inertia())
    by_wheels = model.spun_up(after_s)
    # at constant kinetic energy the speed grows at most by the square root of the largest over the least moment
    stretch = float(np.clip(np.sqrt(moments[-1] / moments[0]), *STRETCH))
    at_reference = model.max_rate * stretch + HANDED_OVER * by_wheels
    return at_reference, at_first + s.spun_unsure * by_wheels


def cell_count(limit: float, edge: float) -> float:
    """Return the approximate number of cells of a grid of rates up to `limit`, `edge` apart: the volume of a ball, and a margin."""
    return 4 / 3 * np.pi * (limit / edge + 1.0) ** 3


def rate_limit(cells: float, edge: float) -> float:
    """Return the limit of rates (rad/s) for a grid of about so many cells; the inverse of :func:`cell_count`."""
    return edge * ((cells / (4 / 3 * np.pi)) ** (1 / 3) - 1)


def _require_computable(model: LanderModel, t_s: np.ndarray, rate_rad_s: float) -> None:
    """Raise InputError if the nominal body, at this rate, needs too many integration steps over the samples.

    `t_s` (n): their times from the reference. A wheel speed in the wrong unit may be the cause. The message names a window that is
    short enough.
    """
    # the same rate about all axes; the direction to the Sun does not matter
    omega = np.full((1, 3), rate_rad_s / np.sqrt(3))
    rows = model.rows(model.at_centres(omega, np.array([[0.0, 0.0, 1.0]])))
    problem = batch.Problem(model.vehicle, rows, model.commands, model.acting)
    # part of the samples' span, halved until it is short enough
    part = 1.0
    while any(
        batch.steps_needed(problem, part * end)[0] > batch.MAX_STEPS
        for end in (t_s.min(), t_s.max())
    ):
        part /= 2
    if part < 1.0:
        span, speeds = float(np.ptp(t_s)), np.abs(rows.wheel_speed_rad_s).max(initial=0.0)
        raise InputError(
            f"the motion over the {span:.6g} s of the samples needs too many steps",
            got=f"rates up to {rate_rad_s:.3g} rad/s, wheels at {speeds:.3g} rad/s",
            do=f"use {part * span:.3g} s of them at most with --from and --to (begin_s, end_s), or check wheel speeds and inertias",
        )


# ---- starts ----------------------------------------------------------------------------------------------------------------


def grid_starts(
    model: LanderModel, reference: Reference, s: GridSettings, workers: int = 1
) -> Iterator[tuple[slice, LanderMotions]]:
    """Yield the window about the reference with starts near all motions that its readings allow, the best first.

    Times of `model` count from the reference. The body is the nominal one: torques are left out, as they hardly move a body in
    three samples. If no start settles, rest and rotations about the axes are the starts, so that the verdict can state by how much
    no motion fits. There is one window; it is yielded because :func:`sunspin.estimate.search.search` takes any number.
    """
    nominal = replace(model, frame="", max_rate=reference.limit)
    reached = Reached.of(nominal, reference.limit, reference.fastest)
    times_s = nominal.obs.t_s[reference.others]
    grid = RateGrid.of(nominal, times_s, reached, reference.edge, s, workers)
    omega, sun, misfit = settled_starts(grid, nominal.panels, reference, s, workers)
    # least squares may have exceeded the limit
    speed = np.linalg.norm(omega, axis=1, keepdims=True)
    omega = omega * np.minimum(1.0, reference.limit / np.maximum(speed, 1e-12))
    # keep the best start in each box of rate and direction
    order = np.argsort(misfit, kind="stable")
    reach_s = float(np.abs(grid.times_s).max())
    box = np.concatenate([omega[order] * reach_s, sun[order]], axis=1) / s.apart_rad
    _, first, count = np.unique(
        np.floor(box).astype(np.int64), axis=0, return_index=True, return_counts=True
    )
    by_misfit = np.argsort(first)
    best = order[first[by_misfit]]
    motions = replace(model.at_centres(omega[best], sun[best]), starts=count[by_misfit])
    # Leave out motions that were too fast at the first sample. There may be no motion at all, hence the empty array below.
    begins = range(0, len(motions), RUNS_AT_ONCE)
    pieces = [motions.take(slice(k, k + RUNS_AT_ONCE)) for k in begins]
    with ThreadPoolExecutor(workers) as pool:
        speeds = list(pool.map(lambda piece: nominal.first_speed(piece, TRIAL_ERROR), pieces))
    starts = motions.take(np.concatenate([np.zeros(0), *speeds]) <= reference.fastest)
    if not len(starts):
        axes = np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
        # 1e-4 rad/s about all axes, so that no motion is exactly at rest
        omega = axes * min(0.3, 0.5 * model.max_rate) + 1e-4
        sun = np.tile(reference.suns[0], (len(omega), 1))
        ones = np.ones(len(omega), dtype=np.int64)
        starts = replace(model.at_centres(omega, sun), starts=ones)
    yield reference.window, starts


def settled_starts(
    grid: RateGrid, panels: PanelPowers, reference: Reference, s: GridSettings, workers: int = 1
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the starts that :func:`search_cells` finds: rates (n, 3) and directions (n, 3) at the reference, and misfits (n).

    First its :class:`Tables` of the other samples are computed, for directions all over the sphere, the nodes.
    """
    nodes, others = cube_nodes(s.nodes), panels.take(reference.others)
    directions = np.repeat(nodes[:, None], len(reference.others), axis=1)
    near, far = (
        shortfall(others, directions, angle + s.node_rad, s).T for angle in (s.near_rad, s.far_rad)
    )
    power = panels.brightness * others.response.power(directions)
    if others.throttled:
        power = others.best_factor(power)[0] * power
    square = np.minimum(((power - others.power) / others.sigma) ** 2, s.largest_misfit)
    misfit = np.where(others.used, square, 0.0).sum(axis=2).T
    tables = Tables(*(np.ascontiguousarray(x, dtype=np.float32) for x in (near, far, misfit)))
    readings = PanelTable.of(panels.take(np.array([reference.sample, *reference.others])))
    limits = Limits(*(getattr(s, name) for name in Limits._fields))
    suns = np.stack([reference.suns, *tangent_basis(reference.suns)], axis=1)
    corners = grid.corner_offsets, grid.row_of, grid.quaternions
    all_cells = Cells(grid.cells, *corners, suns, MIDDLES, POINTS)
    pieces = np.array_split(grid.cells, max(1, -(-len(grid.cells) // CELLS_AT_ONCE)))
    parts = [all_cells._replace(lowest=lowest) for lowest in pieces]
    with ThreadPoolExecutor(workers) as pool:
        settled = pool.map(lambda cells: search_cells(cells, tables, readings, limits), parts)
        starts = np.concatenate(list(settled))
    omega = grid.rates(starts[:, OF_CELL].astype(np.int64)) + starts[:, OF_PLACE] * grid.edge
    # a start has the direction sun + step, normalised: it is atan(|step|) away from `sun`, not |step|
    length = np.linalg.norm(starts[:, OF_STEP], axis=1, keepdims=True)
    ratio = np.divide(np.arctan(length), length, out=np.ones_like(length), where=length > 0)
    sun = move_on_sphere(
        reference.suns[starts[:, OF_SUN].astype(np.int64)], starts[:, OF_STEP] * ratio
    )
    return omega, sun, starts[:, OF_MISFIT]
