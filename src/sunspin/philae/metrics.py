"""How far simulated motions are from the telemetry between first touchdown and collision (paper, section 2.3).

E compares directions sample by sample; it reacts so strongly to small changes that a direct fit fails (Fig. 8). EMD compares
distributions of r_z: a scan of initial rates against the telemetry, its near-minimum set, and the lines through it (Fig. 9).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from scipy.signal import find_peaks

from sunspin.base.errors import InputError
from sunspin.cases import Case
from sunspin.compute.pool import worker_count
from sunspin.dynamics.ensemble import Outcome
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan import error_growth as gr
from sunspin.estimate.scan.lines import Line, fit_lines, line_deviation, match_lines
from sunspin.estimate.scan.mask import allows
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.parameters import nominal
from sunspin.estimate.scan.table import Table, make_table
from sunspin.estimate.scan.volume import near_minimum, scan
from sunspin.output.figures import COLOURS, titled
from sunspin.philae.rebound import (
    LINE_RANGE,
    Options,
    Rebound,
    direction_mask,
    first_sun,
    line_in_scan_range,
    make_rebound,
    nominal_wheel_speeds,
    points_on_lines,
    published_lines,
    published_window_s,
    read_truth,
    scan_grid,
    scan_limits,
    select_rebound,
)
from sunspin.philae.row import Row, row

NEAR_RAD_S = 0.03
"""A published line comes out of a set where a fitted one is nearer on average than this, two grid steps."""


# ---- E: why a direct fit fails -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sensitivity:
    """How E and EMD react to small changes.

    Attributes
    ----------
    n_directions : directions of the telemetry
    start_length : length of the direction at the start as the paper quotes it, with which both maps are made
    rates, parameters : E over (omega_x, omega_y) and over (mu_0, theta_xx), Fig. 8 A and B, against the telemetry
    motions : Dataset over (motion, input, time) of `error_growth.growth` and `error_growth.one_percent`, and `angular_speed`
        (rad/s); first the motion of Fig. 8 B, then one from a point of each published line
    valley : DataArray (window, change) of `error_growth.valleys`, for the motion of Fig. 8 B
    """

    case: Case
    synthetic: bool
    n_directions: int
    start_length: float
    rates: xr.DataArray
    parameters: xr.DataArray
    motions: xr.Dataset
    valley: xr.DataArray


def sensitivity(case: Case, sun: xr.Dataset, options: Options) -> Sensitivity:
    """Maps of E against the rebound's samples in `sun` (of `sun_directions`, whole landing); growth of errors."""
    paper = {key: figure.value for key, figure in case.published.items()}
    vehicle, samples, workers = case.vehicle, select_rebound(case, sun), options.workers
    speed, window = nominal_wheel_speeds(vehicle), published_window_s(case)
    quoted, box = np.array(paper["first_sun_E_study"]), paper["E_study_box"]
    length = float(np.linalg.norm(quoted))

    # neighbours in rates differ by a third of a radian in phase after 45 min, in parameters by 1.4; of the second map each point
    # is a vehicle of its own and takes 4 ms, 30 times a point of the first
    spans = (*box[:2], paper["E_study_coulomb"], paper["E_study_inertia"])
    omega_x, omega_y, mu_0, theta_xx = (
        np.linspace(*span, max(n // options.coarser, 2))
        for span, n in zip(spans, (151, 91, 71, 71), strict=True)
    )
    rates = scan(
        vehicle, samples, quoted / length, omega_x, omega_y, box[2][:1], speed, workers=workers
    ).isel(omega_z=0)
    drawn = gr.Motion.of(vehicle, paper["E_study_omega"], quoted, speed, window)
    parameters = gr.parameter_map(drawn, samples, {"mu_0": mu_0, "theta_xx": theta_xx}, workers)

    interval, first = 60.0 * paper["sampling_interval"], first_sun(case)
    motions = {"Fig. 8 B": drawn} | {
        f"L{k}": gr.Motion.of(vehicle, omega, first, speed, window)
        for k, (omega,) in enumerate(points_on_lines(published_lines(case), [0.1]), 1)
    }
    changes = [
        xr.merge([gr.growth(motion), gr.one_percent(motion, interval)], combine_attrs="drop")
        .assign(angular_speed=float(np.linalg.norm(motion.omega_B)))
        .expand_dims(motion=[name])
        for name, motion in motions.items()
    ]
    change = np.linspace(-0.05, 0.05, 1001 // options.coarser // 2 * 2 + 1)
    windows = 60.0 * np.array([5.0, 15.0, 45.0])
    return Sensitivity(
        case,
        bool(sun.attrs.get("synthetic")),
        int(np.isfinite(samples["sun_B"].values[:, 0]).sum()),
        length,
        gr.of_length(rates, length).assign_attrs(units="1"),
        gr.of_length(parameters, length).assign_attrs(units="1"),
        xr.concat(changes, "motion"),
        gr.valleys(drawn, change, windows, interval, workers),
    )


def valleys_crossed(values: np.ndarray) -> list[float]:
    """Valleys that a straight walk across a map (n, m) crosses along each axis: median over the walks.

    Minima of the map itself would count the steps of a grid over slanted valleys. A minimum counts if it is deeper than 0.03, a
    tenth of what E ranges over.
    """
    return [
        float(np.median([len(find_peaks(-walk, prominence=0.03)[0]) for walk in walks]))
        for walks in (values.T, values)
    ]


def sensitivity_rows(r: Sensitivity) -> list[Row]:
    """What the paper says of E and EMD in section 2.3, in numbers."""
    case, motions = r.case, r.motions
    paper = {key: figure.value for key, figure in case.published.items()}
    box, omega = np.mean(paper["E_study_box"], axis=1), np.array(paper["E_study_omega"])

    def of_map(name: str, error: xr.DataArray, start: np.ndarray, **texts: Any) -> Row:
        ours = [float(error.min()), float(error.max()), *valleys_crossed(error.values)]
        away = [np.cross(start - point, along) for point, along in published_lines(case)]
        apart = min(float(np.linalg.norm(each)) for each in away)
        return row(case, name, ours, apart=apart, **texts)

    first, quoted = first_sun(case), np.array(paper["first_sun_E_study"])
    cosine = first @ quoted / np.linalg.norm(first) / np.linalg.norm(quoted)
    apart = float(np.degrees(np.arccos(cosine)))

    of_E, of_emd = (motions[name].max("input").values for name in ("E", "emd"))
    each = zip(motions["motion"].values, of_E, of_emd, strict=True)
    of_each = "; ".join(f"{name} {error:.2f} and {distance:.4f}" for name, error, distance in each)
    in_E, in_emd, least = float(of_E.min()), float(of_emd.max()), paper["emd_min"]

    # a frequency that is off shifts the phase in proportion to time, friction with its square
    rates, tolerance = list(gr.RATES), 0.3
    linear, square = (motions["power"].sel(input=inputs).values for inputs in (rates, "mu_0"))
    off = max(np.abs(linear - 1).max(), np.abs(square - 2).max())
    growth, agrees = [float(linear.mean()), float(square.mean())], bool(off < tolerance)
    last = motions["error_rad"].isel(time=-1)
    at_end, per_rate = last.max("input") * gr.ONE_PERCENT, last / motions["angular_speed"]
    ends = {"at_end": at_end, "per_rate": per_rate.sel(input=rates)}
    sizes: dict[str, Any] = {name: (float(x.min()), float(x.max())) for name, x in ends.items()}

    windows = ", ".join(f"{seconds / 60:g}" for seconds in r.valley["window"].values)
    width = gr.valley_width(r.valley).tolist()
    return [
        of_map("E_map_rates", r.rates, box, directions=r.n_directions, motions=r.rates.size),
        of_map("E_map_parameters", r.parameters, omega, outside=nominal(case.vehicle, "mu_0")),
        row(case, "E_study_bound", (1 - r.start_length) / 2, length=r.start_length, apart=apart),
        row(case, "one_percent_E", in_E, agrees=in_E > 0.1, of_each=of_each),
        row(case, "one_percent_emd", in_emd, tolerance=least, agrees=in_emd < least),
        row(case, "phase_growth", growth, tolerance=tolerance, agrees=agrees, **sizes),
        row(case, "valley_width", width, windows=windows),
    ]


def symbol(name: str) -> str:
    """An input as the paper writes it."""
    letter, index = name.replace("wheel_speed", "omega_rot").split("_")
    return f"$\\{letter}_{{{index}}}$"


def maps_figure(result: Sensitivity) -> Figure:
    """E over (omega_x, omega_y) and over (mu_0, theta_xx), the axes of the paper's Fig. 8."""
    figure = Figure(figsize=(11, 4.4), layout="constrained")
    omega = ", ".join(f"{x:g}" for x in result.case.published["E_study_omega"].value)
    omega_z = float(result.rates["omega_z"])
    panels = (
        (result.rates, 1.0, rf"A: initial rates, $\omega_z$ = {omega_z:g} rad/s"),
        (result.parameters, 1e3, rf"B: parameters, $\omega(0)$ = [{omega}] rad/s"),
    )
    units = {"mu_0": "$10^{-3}$ N m", "theta_xx": "kg m$^2$"}
    for axes, (error, scale, title) in zip(figure.subplots(1, 2), panels, strict=True):
        x, y = map(str, error.dims)
        points = error[x].values * scale, error[y].values, error.transpose(y, x).values
        image = axes.pcolormesh(*points, shading="nearest", cmap="cividis_r", rasterized=True)
        figure.colorbar(image, ax=axes, label="E")
        axes.set_xlabel(f"{symbol(x)} ({units.get(x, 'rad/s')})")
        axes.set_ylabel(f"{symbol(y)} ({units.get(y, 'rad/s')})")
        axes.set_title(title, fontsize=10)
    length = f"$|r(0)|$ = {result.start_length:.4f} as quoted"
    title = f"E against {result.n_directions} directions of the telemetry, {length}"
    figure.suptitle(titled(title, result.synthetic), fontsize=10)
    return figure


def growth_figure(result: Sensitivity) -> Figure:
    """Why the direct fit fails: errors grow with the window, and EMD does not follow E."""
    figure = Figure(figsize=(9.5, 5.2), layout="constrained")
    grow, changes = figure.subplots(1, 2)
    motions, emd_min = result.motions, result.case.published["emd_min"].value
    names, inputs = (motions[dim].values.tolist() for dim in ("motion", "input"))
    minutes, drawn = motions["time"].values[1:] / 60, motions.isel(motion=0)
    for k, name in enumerate(inputs):
        error = gr.ONE_PERCENT * drawn["error_rad"].sel(input=name).values[1:]
        style = "-" if name in gr.RATES else "--" if name.startswith("theta") else ":"
        label = f"{symbol(name)}, power {float(drawn['power'].sel(input=name)):.1f}"
        colour = COLOURS[k] if k < len(COLOURS) else "#555555"
        grow.loglog(minutes, error, style, lw=1.3, color=colour, label=label)
    grow.axhline(1.0, lw=0.8, color=COLOURS[7])
    grow.text(0.13, 1.1, "one radian", fontsize=9, color="#555555")
    grow.set(xlabel="length of the window (min)", xlim=(0.1, None), ylim=(1e-4, 60))
    grow.set_ylabel("direction error of 1 %, to first order (rad)")
    below: dict[str, Any] = {"loc": "upper center", "bbox_to_anchor": (0.5, -0.16)}
    grow.legend(fontsize=9, ncols=2, frameon=False, **below)
    grow.set_title(f"growth of errors, rates of {names[0]}", fontsize=10)

    for k, name in enumerate(names):
        place = np.arange(len(inputs)) + (k - (len(names) - 1) / 2) * 0.15
        in_E, in_emd = (motions[of].values[k] for of in ("E", "emd"))
        changes.semilogy(place, in_E, "o", ms=5, color=COLOURS[k], label=name)
        changes.semilogy(place, in_emd, "^", ms=5, mfc="none", color=COLOURS[k])
    changes.set_xticks(np.arange(len(inputs)), [symbol(name) for name in inputs])
    changes.axhline(emd_min, ls="--", lw=1, color=COLOURS[7])
    text = "smallest EMD of the paper's scan"
    changes.text(len(inputs) - 0.5, 1.1 * emd_min, text, ha="right", fontsize=9)
    changes.set(xlabel="input changed by 1 %", ylabel="E (filled), EMD (open)", ylim=(5e-4, 2.5))
    changes.legend(fontsize=9, ncols=len(names), loc="upper center")
    changes.set_title("E and EMD between a motion\nand the changed one, 45 min", fontsize=10)
    title = "Why a direct fit fails after the touchdown (simulated motions only)"
    figure.suptitle(title, fontsize=11)
    return figure


# ---- EMD: the scan and its near-minimum set ----------------------------------------------------------------------------------


def run_grid(case: Case, sun_B: np.ndarray, duration_s: float, options: Options) -> Table:
    """Every motion of the grid from this direction (3) of the Sun, run once for any target."""
    axes, speed = scan_grid(case, options.coarser), nominal_wheel_speeds(case.vehicle)
    mask = None if direction_mask(case) is None else "reconstructible"
    how: dict[str, Any] = {"workers": options.workers, "progress": options.progress}
    return make_table(case.vehicle, sun_B, axes, speed, duration_s, mask=mask, **how)


def simulated_z(case: Case, omega_B: np.ndarray) -> np.ndarray:
    """The reconstructible r_z of one motion over the paper's window, every half second."""
    t = np.arange(0.0, published_window_s(case) + 0.25, 0.5)
    speed, mask = nominal_wheel_speeds(case.vehicle), direction_mask(case)
    run = propagate(case.vehicle, omega_B, first_sun(case), speed, t, rtol=1e-9)
    track = run["sun_B"].values
    return track[slice(None) if mask is None else allows(mask, track), 2]


class NearMinimum(NamedTuple):
    """The near-minimum set of a scan and the lines through it.

    Attributes
    ----------
    emd : over the grid
    points : (n, 3) rad/s, with EMD below `factor` times the smallest
    lines : of `fit_lines`; None where there are too few points
    deviation : for each published line the fitted one nearest to it, "line", and their `line_deviation`
    """

    emd: xr.DataArray
    factor: float
    points: np.ndarray
    lines: xr.Dataset | None
    deviation: list[dict[str, Any]]


def fitted_lines(lines: xr.Dataset) -> list[Line]:
    """Lines of `fit_lines` as (point, unit direction)."""
    return list(zip(lines["point"].values, lines["direction"].values, strict=True))


def near_minimum_set(case: Case, emd: xr.DataArray, factor: float, seed: int) -> NearMinimum:
    """Near-minimum set of a scan, four lines through it, and their distance from the published ones."""
    points, published = near_minimum(emd, factor), published_lines(case)
    try:
        lines = fit_lines(points, len(published), seed=seed)
    except InputError:  # a ragged level set may have fewer points than four lines need
        return NearMinimum(emd, factor, points, None, [])
    over: dict[str, Any] = {"low": LINE_RANGE[0], "high": LINE_RANGE[1]}
    ours = [fitted_lines(lines)[k] for k in match_lines(lines, published, **over)]
    pairs = zip(ours, published, strict=True)
    deviation = [{"line": mine} | line_deviation(mine, theirs, **over) for mine, theirs in pairs]
    return NearMinimum(emd, factor, points, lines, deviation)


@dataclass(frozen=True)
class TelemetryScan:
    """The scan against the telemetry.

    Attributes
    ----------
    emd : (n) of every motion of the table, infinite where it failed
    near : near-minimum set by the paper's factor, and the lines fitted to it
    truth : "omega_B" (3) rad/s, "sun_B" (3), "emd" and its "z" where the telemetry is the case's own twin, else empty
    """

    rebound: Rebound
    table: Table
    emd: np.ndarray
    near: NearMinimum
    truth: dict[str, Any]

    @property
    def smallest(self) -> float:
        return float(self.emd.min())

    @property
    def lines_found(self) -> int:
        """How many of the published lines come out of the near-minimum set."""
        return sum(bool(apart["mean"] <= NEAR_RAD_S) for apart in self.near.deviation)


def scan_telemetry(case: Case, sun: xr.Dataset, options: Options) -> TelemetryScan:
    """Scan the grid against the directions `sun` (of `sun_directions`, whole landing); `options.seed` is that of the line fit.

    For a twin `truth` holds its true rate and Sun at the first sample after the touchdown, and the EMD that a scan finds at this
    rate, from the direction that the panels show.
    """
    rebound = make_rebound(case, sun)
    table = run_grid(case, rebound.sun_B, rebound.window_s, options)
    volume = table.volume(rebound.z, rebound.weights, worker_count(options.workers))
    truth: dict[str, Any] = {}
    if twin := read_truth(case):
        z = simulated_z(case, np.array(twin["omega_B"]))
        truth = {name: np.array(twin[name]) for name in ("omega_B", "sun_B")}
        truth |= {"emd": emd(z, rebound.z, weights_b=rebound.weights), "z": z}
    distance = np.where(table.outcome == Outcome.FINE, volume.values.ravel(), np.inf)
    factor = case.assumptions.study.near_minimum_factor
    near = near_minimum_set(case, volume, factor, options.seed)
    return TelemetryScan(rebound, table, distance, near, truth)


def scan_rows(result: TelemetryScan) -> list[Row]:
    """Figures of section 2.3 that need telemetry, compared with ours."""
    rebound, near = result.rebound, result.near
    case = rebound.case
    points = f"{len(near.points)} grid points below {near.factor} times the smallest"
    if result.truth:
        points += f"; at the true rate of the synthetic telemetry it is {result.truth['emd']:.4f}"
    apart = ", ".join(f"L{k} {apart['mean']:.3f}" for k, apart in enumerate(near.deviation, 1))
    each = f"mean distances of the fitted lines (rad/s): {apart}"
    texts: dict[str, Any] = {
        "near": points,
        "each": each if apart else "too few points in the set for four lines",
        "within": NEAR_RAD_S,
        "omega_z": list(LINE_RANGE),
        "directions": rebound.z.size,
    }
    lines = published_lines(case)
    # a coarser grid is asked for by the user, and is no other count of the paper's
    whole = near.emd.size == case.published["scan_runs"].value or None
    return [
        row(case, "emd_min", result.smallest, **texts),
        row(case, "scan_runs", int(near.emd.size), agrees=whole),
        row(case, "lines_found", result.lines_found, published=len(lines), **texts),
    ]


def rate_axes(figure: Figure, *place: int) -> Any:
    """Axes in perspective over the three rates (rad/s), with as many ticks as stand apart."""
    axes, ticks = figure.add_subplot(*place, projection="3d"), (-0.4, 0.0, 0.4, 0.8)
    axes.set(xlabel=r"$\omega_x$ (rad/s)", ylabel=r"$\omega_y$ (rad/s)")
    axes.set(zlabel=r"$\omega_z$ (rad/s)", xticks=ticks, yticks=ticks)
    return axes


def near_minimum_figure(
    case: Case, near: NearMinimum, title: str, truth: np.ndarray | None = None
) -> Figure:
    """Near-minimum points in rate space with fitted (solid) and published (dashed) lines (paper, Fig. 9)."""
    figure = Figure(figsize=(11, 5.2), layout="constrained")
    points, lines = near.points, near.lines
    member = np.zeros(len(points), int) if lines is None else lines["member"].values
    views = (("perspective", 22, -62), ("from +z", 90, -90))
    for k, (name, elevation, azimuth) in enumerate(views):
        axes = rate_axes(figure, 1, 2, k + 1)
        axes.view_init(elevation, azimuth)
        axes.scatter(*points.T, s=8, c=[COLOURS[m % 8] for m in member], depthshade=False)
        for i, line in enumerate(published_lines(case)):
            label = "the paper's lines" if i == 0 else None
            axes.plot(*line_in_scan_range(case, line).T, "--", lw=1, color="#555555", label=label)
        for i, line in enumerate([] if lines is None else fitted_lines(lines)):
            label = f"fitted line {i + 1} ({int((member == i).sum())} motions)"
            axes.plot(
                *line_in_scan_range(case, line).T, "-", lw=1.6, color=COLOURS[i % 8], label=label
            )
        if truth is not None:
            label = "truth of the synthetic telemetry"
            axes.scatter(*truth, marker="*", s=130, color="#000000", label=label)
        if k:
            axes.set(zlabel="", zticks=[])
        axes.set(**dict(zip(("xlim", "ylim", "zlim"), scan_limits(case), strict=True)))
        axes.set_title(name, fontsize=9)
    figure.suptitle(title, fontsize=11)
    labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, ncols=3, loc="outside lower center", frameon=False)
    return figure


def distributions_figure(z: np.ndarray, label: str, motions: dict[str, np.ndarray]) -> Figure:
    """Cumulative distributions of r_z that the EMD compares: of directions `z` (n), and of motions by name."""
    figure = Figure(figsize=(7, 4.2), layout="constrained")
    axes, level = figure.subplots(), np.arange(1, len(z) + 1) / len(z)
    axes.step(np.sort(z), level, where="post", color=COLOURS[6], label=label)
    for k, (name, values) in enumerate(motions.items()):
        # nearly one curve in pairs: each second one in dashes over the first
        dashes = (0, (1.5, 1.5)) if k % 2 else "-"
        style: dict[str, Any] = {"lw": 5.0, "ls": dashes, "color": COLOURS[k]}
        if name.startswith("truth"):
            style = {"lw": 1.4, "ls": (0, (1, 2)), "color": COLOURS[6]}
        axes.plot(np.sort(values), np.linspace(0, 1, len(values)), label=name, **style)
    axes.set(xlabel="$z$ component of the Sun's direction", ylabel="cumulative distribution")
    axes.set_xlim(-0.05, 1.02)
    axes.legend(fontsize=9)
    axes.set_title("What the EMD compares", fontsize=11)
    return figure
