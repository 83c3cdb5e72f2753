"""Distance of simulated motions from the telemetry between first touchdown and collision (paper, section 2.3).

E compares directions sample by sample. It depends so strongly on the initial state that a direct fit fails (Fig. 8). EMD compares
distributions of r_z. It serves for a scan of initial rates against the telemetry, the near-minimum set of this scan, and the lines
through the set (Fig. 9).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from scipy.signal import find_peaks

from sunspin.base.errors import InputError
from sunspin.cases import Case
from sunspin.compute.pool import worker_count
from sunspin.dynamics.batch import Outcome
from sunspin.dynamics.propagate import propagate
from sunspin.estimate.scan.lines import Line, fit_lines, line_deviation, match_lines
from sunspin.estimate.scan.metrics import emd
from sunspin.estimate.scan.near_minimum import near_minimum
from sunspin.estimate.scan.volume import Histograms, make_table, scan
from sunspin.output.figures import COLOURS, empty_figure, titled
from sunspin.philae import error_growth
from sunspin.philae.rebound import (
    LINE_RANGE,
    Options,
    Rebound,
    direction_mask,
    distances_from_lines,
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
from sunspin.philae.row import Row, make_row

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NEAR_RAD_S = 0.03
"""Largest mean distance (rad/s) of a fitted line from a published one that counts as recovered: two grid steps."""

LARGEST_GAP_STEPS = 4
"""Largest gap, in steps of the scan's grid, between neighbouring motions along a fitted line. With the paper's step of 0.015 rad/s
the lines of the case's own telemetry have gaps up to 0.03 rad/s, and lines fitted through separate clusters of 0.1 and more.
"""


# ---- E: why a direct fit fails -----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Sensitivity:
    """Change of E and EMD under small changes of the inputs.

    Attributes
    ----------
    n_directions : directions of the telemetry
    start_length : length of the start direction as the paper quotes it, with which both maps are computed
    rates, parameters : E over (omega_x, omega_y) and over (mu_0, theta_xx), Fig. 8 A and B, for the telemetry
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


def compute_sensitivity(case: Case, sun: xr.Dataset, options: Options) -> Sensitivity:
    """Compute maps of E for the rebound's samples in `sun` (of `sun_directions`, whole landing), and the growth of errors."""
    paper = {key: figure.value for key, figure in case.published.items()}
    vehicle, samples, workers = case.vehicle, select_rebound(case, sun), options.workers
    speed, window = nominal_wheel_speeds(vehicle), published_window_s(case)
    # start direction as the paper quotes it: its length is not 1
    quoted = np.array(paper["first_sun_E_study"])
    length = float(np.linalg.norm(quoted))
    # (3, 2): ranges of omega_x, omega_y, omega_z
    box = paper["E_study_box"]

    # After 45 min neighbours in rates differ by a third of a radian in phase, neighbours in parameters by 1.4 rad. The second map
    # is coarser because each of its points is another vehicle, which takes 4 ms, 30 times a point of the first map.
    # Ranges and numbers of points of the four axes. The rate omega_z of the first map is fixed.
    spans = (*box[:2], paper["E_study_coulomb"], paper["E_study_inertia"])
    omega_x, omega_y, mu_0, theta_xx = (
        np.linspace(*span, max(n // options.coarser, 2))
        for span, n in zip(spans, (151, 91, 71, 71), strict=True)
    )
    rates = scan(
        vehicle, samples, quoted / length, omega_x, omega_y, box[2][:1], speed, workers=workers
    ).isel(omega_z=0)
    # `ReferenceMotion.of` makes the direction a unit vector
    motion_8B = error_growth.ReferenceMotion.of(
        vehicle, paper["E_study_omega"], quoted, speed, window
    )
    parameters = error_growth.parameter_map(
        motion_8B, samples, {"mu_0": mu_0, "theta_xx": theta_xx}, workers
    )

    # the motion of Fig. 8 B, and one on each published line, at omega_z = 0.1 rad/s
    interval_s, first = 60.0 * paper["sampling_interval"], first_sun(case)
    motions = {"Fig. 8 B": motion_8B} | {
        f"L{k}": error_growth.ReferenceMotion.of(vehicle, omega, first, speed, window)
        for k, (omega,) in enumerate(points_on_lines(published_lines(case), [0.1]), 1)
    }
    changes = [
        xr.merge(
            [error_growth.growth(motion), error_growth.one_percent(motion, interval_s)],
            combine_attrs="drop",
        )
        .assign(angular_speed=float(np.linalg.norm(motion.omega_B)))
        .expand_dims(motion=[name])
        for name, motion in motions.items()
    ]
    # changes of omega_x in the motion of Fig. 8 B; their number is odd so that zero is among them
    change_rad_s = np.linspace(-0.05, 0.05, 1001 // options.coarser // 2 * 2 + 1)
    windows_s = 60.0 * np.array([5.0, 15.0, 45.0])
    return Sensitivity(
        case,
        synthetic=bool(sun.attrs.get("synthetic")),
        n_directions=int(np.isfinite(samples["sun_B"].values[:, 0]).sum()),
        start_length=length,
        # E of a unit start direction, converted to one of the quoted length
        rates=error_growth.error_of_start_length(rates, length).assign_attrs(units="1"),
        parameters=error_growth.error_of_start_length(parameters, length).assign_attrs(units="1"),
        motions=xr.concat(changes, "motion"),
        valley=error_growth.valleys(motion_8B, change_rad_s, windows_s, interval_s, workers),
    )


def count_valleys(values: np.ndarray) -> list[float]:
    """Return the number of valleys that a straight walk across a map (n, m) crosses along each axis: median over the walks.

    A minimum of a walk counts if it is deeper than 0.03, a tenth of the range of E. Minima of the map itself would count the steps
    of a grid over slanted valleys.
    """
    return [
        float(np.median([len(find_peaks(-walk, prominence=0.03)[0]) for walk in walks]))
        for walks in (values.T, values)
    ]


def sensitivity_rows(sensitivity: Sensitivity) -> list[Row]:
    """Return the statements of section 2.3 on E and EMD compared with ours."""
    case, motions = sensitivity.case, sensitivity.motions
    paper = {key: figure.value for key, figure in case.published.items()}
    box, omega = np.mean(paper["E_study_box"], axis=1), np.array(paper["E_study_omega"])

    # distances of the starts of the two maps from the nearest published line
    box_apart, omega_apart = (distances_from_lines(case, start).min() for start in (box, omega))

    # the paper quotes another first direction here than for the scan
    first, quoted = first_sun(case), np.array(paper["first_sun_E_study"])
    cosine = first @ quoted / np.linalg.norm(first) / np.linalg.norm(quoted)
    apart_deg = float(np.degrees(np.arccos(cosine)))

    # largest change of E and of EMD over the inputs that are changed by 1 %, for each motion
    E_change, emd_change = (motions[name].max("input").values for name in ("E", "emd"))
    changes = zip(motions["motion"].values, E_change, emd_change, strict=True)
    of_each = "; ".join(f"{name} {in_E:.2f} and {in_emd:.4f}" for name, in_E, in_emd in changes)
    least_E, largest_emd, emd_min = float(E_change.min()), float(emd_change.max()), paper["emd_min"]

    # a frequency that is off shifts the phase in proportion to time, friction with its square
    rates, tolerance = list(error_growth.RATES), 0.3
    rate_power, friction_power = (
        motions["power"].sel(input=inputs).values for inputs in (rates, "mu_0")
    )
    difference = max(np.abs(rate_power - 1).max(), np.abs(friction_power - 2).max())
    growth = [float(rate_power.mean()), float(friction_power.mean())]
    agrees = bool(difference < tolerance)
    # direction errors at the end of the window (rad): of a change of 1 %, and of one of a rate per angular speed
    last = motions["error_rad"].isel(time=-1)
    at_end = float(last.max()) * error_growth.ONE_PERCENT
    per_rate = (last / motions["angular_speed"]).sel(input=rates)

    windows = ", ".join(f"{seconds / 60:g}" for seconds in sensitivity.valley["window"].values)
    width = error_growth.valley_width(sensitivity.valley).tolist()
    mu_0 = error_growth.nominal_value(case.vehicle, "mu_0")
    notes = {
        "E_map_rates": f"{sensitivity.n_directions} directions, {sensitivity.rates.size} motions; the box is {box_apart:.2f} rad/s "
        "from the nearest line",
        "E_map_parameters": f"the range of mu_0 leaves out the lander's {mu_0:.3g} N m, that of theta_xx "
        f"begins at theta_yy; nearest line {omega_apart:.2f} rad/s away",
        "E_study_bound": f"its length is {sensitivity.start_length:.4f}; as a unit vector it is {apart_deg:.1f} deg from the first "
        "direction of the scan",
        "one_percent_E": f"criterion: more than 0.1; of unrelated directions E is 0.5; largest E and EMD of each motion: {of_each}",
        "phase_growth": f"criterion: 1 and 2 within {tolerance:g}; after 45 min the direction errs by up to {at_end:.0f} rad (to "
        f"first order) if an input is off by 1 %; by {per_rate.min():.0f} to {per_rate.max():.0f} rad per rad/s of a rate",
        "valley_width": f"rates of Fig. 8 B, own directions every 2 min; the scan's step is {paper['scan_step']} rad/s",
    }
    row_of = partial(make_row, case, notes=notes)
    of_rates, of_parameters = (
        [float(E.min()), float(E.max()), *count_valleys(E.values)]
        for E in (sensitivity.rates, sensitivity.parameters)
    )
    what = f"full width of the valley of E in omega_x in windows of {windows} min"
    return [
        row_of("E_map_rates", of_rates),
        row_of("E_map_parameters", of_parameters),
        row_of("E_study_bound", (1 - sensitivity.start_length) / 2),
        row_of("one_percent_E", least_E, agrees=least_E > 0.1),
        row_of("one_percent_emd", largest_emd, tolerance=emd_min, agrees=largest_emd < emd_min),
        row_of("phase_growth", growth, tolerance=tolerance, agrees=agrees),
        row_of("valley_width", width, what=what),
    ]


def input_symbol(name: str) -> str:
    """Return the paper's symbol of an input such as "omega_x" or "theta_xx", as mathematical text for matplotlib."""
    letter, index = name.replace("wheel_speed", "omega_rot").split("_")
    return f"$\\{letter}_{{{index}}}$"


def maps_figure(result: Sensitivity) -> Figure:
    """Draw E over (omega_x, omega_y) and over (mu_0, theta_xx), the axes of the paper's Fig. 8."""
    figure = empty_figure(11, 4.4)
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
        axes.set_xlabel(f"{input_symbol(x)} ({units.get(x, 'rad/s')})")
        axes.set_ylabel(f"{input_symbol(y)} ({units.get(y, 'rad/s')})")
        axes.set_title(title, fontsize=10)
    length = f"$|r(0)|$ = {result.start_length:.4f} as quoted"
    title = f"E against {result.n_directions} directions of the telemetry, {length}"
    figure.suptitle(titled(title, result.synthetic), fontsize=10)
    return figure


def growth_figure(result: Sensitivity) -> Figure:
    """Draw why the direct fit fails: errors grow with the window, and EMD does not follow E."""
    figure = empty_figure(9.5, 5.2)
    grow, changes = figure.subplots(1, 2)
    motions, emd_min = result.motions, result.case.published["emd_min"].value
    names, inputs = (motions[dim].values.tolist() for dim in ("motion", "input"))
    # the error at time 0 cannot be drawn on a logarithmic axis
    minutes, drawn = motions["time"].values[1:] / 60, motions.isel(motion=0)
    for k, name in enumerate(inputs):
        error = error_growth.ONE_PERCENT * drawn["error_rad"].sel(input=name).values[1:]
        style = "-" if name in error_growth.RATES else "--" if name.startswith("theta") else ":"
        label = f"{input_symbol(name)}, power {float(drawn['power'].sel(input=name)):.1f}"
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
        # the motions stand side by side above each input
        x = np.arange(len(inputs)) + (k - (len(names) - 1) / 2) * 0.15
        in_E, in_emd = (motions[metric].values[k] for metric in ("E", "emd"))
        changes.semilogy(x, in_E, "o", ms=5, color=COLOURS[k], label=name)
        changes.semilogy(x, in_emd, "^", ms=5, mfc="none", color=COLOURS[k])
    changes.set_xticks(np.arange(len(inputs)), [input_symbol(name) for name in inputs])
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


def propagate_grid(
    case: Case, sun_B: np.ndarray, duration_s: float, options: Options
) -> Histograms:
    """Propagate every motion of the grid from the Sun direction sun_B (3), once for any target distribution."""
    axes, speed = scan_grid(case, options.coarser), nominal_wheel_speeds(case.vehicle)
    mask = None if direction_mask(case) is None else "reconstructible"
    return make_table(
        case.vehicle,
        sun_B,
        axes,
        speed,
        duration_s,
        mask=mask,
        workers=options.workers,
        progress=options.progress,
    )


def simulate_rz(case: Case, omega_B: np.ndarray) -> np.ndarray:
    """Return the r_z (n) of one motion over the paper's window every half second, in view of the panels only."""
    t = np.arange(0.0, published_window_s(case) + 0.25, 0.5)
    speed, mask = nominal_wheel_speeds(case.vehicle), direction_mask(case)
    sun_B = propagate(case.vehicle, omega_B, first_sun(case), speed, t, rtol=1e-9)["sun_B"].values
    in_view = slice(None) if mask is None else mask.contains(sun_B)
    return sun_B[in_view, 2]


class NearMinimum(NamedTuple):
    """The near-minimum set of a scan and the lines through it.

    Attributes
    ----------
    emd : EMD over the grid
    factor : factor on the smallest EMD that limits the set
    points : (n, 3) rad/s, the rates of the set
    lines : result of `fit_lines`; None if the set has too few points
    deviation : for each published line the nearest fitted one, "line", and their `line_deviation`
    """

    emd: xr.DataArray
    factor: float
    points: np.ndarray
    lines: xr.Dataset | None
    deviation: list[dict[str, Any]]


def list_lines(lines: xr.Dataset) -> list[Line]:
    """Return the lines of `fit_lines` as (point, unit direction)."""
    return list(zip(lines["point"].values, lines["direction"].values, strict=True))


def make_near_minimum_set(case: Case, emd: xr.DataArray, factor: float, seed: int) -> NearMinimum:
    """Return the near-minimum set of a scan, four lines through it, and their distance from the published ones."""
    points, published = near_minimum(emd, factor), published_lines(case)
    try:
        lines = fit_lines(points, len(published), seed=seed)
    except InputError:  # a ragged level set may have fewer points than four lines need
        return NearMinimum(emd, factor, points, None, [])
    limits: dict[str, Any] = {"low": LINE_RANGE[0], "high": LINE_RANGE[1]}
    fitted = list_lines(lines)
    nearest = [fitted[k] for k in match_lines(lines, published, **limits)]
    deviation = [
        {"line": line} | line_deviation(line, reference, **limits)
        for line, reference in zip(nearest, published, strict=True)
    ]
    return NearMinimum(emd, factor, points, lines, deviation)


@dataclass(frozen=True)
class TelemetryScan:
    """Scan of initial rates against the telemetry.

    Attributes
    ----------
    emd : (n) of every motion of the table, infinite if it failed
    near : near-minimum set by the paper's factor, and the lines fitted to it
    truth : for the case's own synthetic telemetry the true state: "omega_B" (3) rad/s, "sun_B" (3), with its "emd" and its r_z,
        "z"; else empty
    """

    rebound: Rebound
    table: Histograms
    emd: np.ndarray
    near: NearMinimum
    truth: dict[str, Any]

    @property
    def smallest(self) -> float:
        """Smallest EMD of the scan."""
        return float(self.emd.min())

    @property
    def lines_recovered(self) -> int:
        """Number of published lines that have a fitted line near them."""
        return sum(bool(deviation["mean"] <= NEAR_RAD_S) for deviation in self.near.deviation)


def scan_telemetry(case: Case, sun: xr.Dataset, options: Options) -> TelemetryScan:
    """Scan the grid against the directions `sun` (of `sun_directions`, whole landing); `options.seed` is that of the line fit.

    For the case's own synthetic telemetry `truth` holds the true rate and Sun at the first sample after the touchdown. Its EMD is
    that of the true rate from the published first direction, over the paper's window.
    """
    rebound = make_rebound(case, sun)
    table = propagate_grid(case, rebound.sun_B, rebound.window_s, options)
    volume = table.volume(rebound.z, rebound.weights, worker_count(options.workers))
    truth: dict[str, Any] = {}
    if true_values := read_truth(case):
        z = simulate_rz(case, np.array(true_values["omega_B"]))
        truth = {name: np.array(true_values[name]) for name in ("omega_B", "sun_B")}
        truth |= {"emd": emd(z, rebound.z, weights_b=rebound.weights), "z": z}
    # EMD of each motion for other steps; infinite if its propagation failed, so that it is in no set
    distance = np.where(table.outcome == Outcome.FINE, volume.values.ravel(), np.inf)
    factor = case.assumptions.study.near_minimum_factor
    near = make_near_minimum_set(case, volume, factor, options.seed)
    return TelemetryScan(rebound, table, distance, near, truth)


def scan_rows(result: TelemetryScan) -> list[Row]:
    """Return the figures of section 2.3 that need telemetry, compared with ours."""
    rebound, near = result.rebound, result.near
    case = rebound.case
    set_text = f"{len(near.points)} grid points below {near.factor} times the smallest"
    if result.truth:
        set_text += f"; at the true rate of the synthetic telemetry it is {result.truth['emd']:.4f}"
    distances = ", ".join(
        f"L{k} {deviation['mean']:.3f}" for k, deviation in enumerate(near.deviation, 1)
    )
    line_text = "too few points in the set for four lines"
    if distances:
        line_text = f"mean distances of the fitted lines (rad/s): {distances}"
    notes = {
        "emd_min": f"{rebound.z.size} directions; {set_text}",
        "lines_found": f"criterion: mean distance of a fitted line below {NEAR_RAD_S:g} rad/s over omega_z in {list(LINE_RANGE)}; "
        f"{line_text}; {set_text}",
    }
    row_of, lines = partial(make_row, case, notes=notes), published_lines(case)
    # the number of runs is compared only on the paper's own grid, not on a coarser one
    is_paper_grid = near.emd.size == case.published["scan_runs"].value
    return [
        row_of("emd_min", result.smallest),
        row_of("scan_runs", int(near.emd.size), agrees=is_paper_grid or None),
        row_of("lines_found", result.lines_recovered, published=len(lines)),
    ]


def rate_axes(figure: Figure, *subplot: int) -> Any:
    """Return new axes of a figure in perspective over the three rates (rad/s), with few enough ticks to stay apart.

    `subplot` holds rows, columns and number of the axes as in `Figure.add_subplot`; default: one for the whole figure.
    """
    axes, ticks = figure.add_subplot(*subplot, projection="3d"), (-0.4, 0.0, 0.4, 0.8)
    axes.set(xlabel=r"$\omega_x$ (rad/s)", ylabel=r"$\omega_y$ (rad/s)")
    axes.set(zlabel=r"$\omega_z$ (rad/s)", xticks=ticks, yticks=ticks)
    return axes


def rate_space_views(figure: Figure, case: Case) -> Iterator[Any]:
    """Yield axes of two views of the scan range in rate space, in perspective and from +z, each to be drawn into.

    Artists cover each other by their `zorder`, not by their depth, so that lines are drawn over points.
    """
    for k, (name, elevation, azimuth) in enumerate(
        (("perspective", 22, -62), ("from +z", 90, -90))
    ):
        axes = rate_axes(figure, 1, 2, k + 1)
        axes.computed_zorder = False
        axes.view_init(elevation, azimuth)
        yield axes
        if name == "from +z":
            axes.set(zlabel="", zticks=[])
        axes.set(**dict(zip(("xlim", "ylim", "zlim"), scan_limits(case), strict=True)))
        axes.set_title(name, fontsize=9)


def line_stretch(points: np.ndarray, line: Line, step_rad_s: float) -> tuple[float, float] | None:
    """Return the first and last position (rad/s, from the line's point) of points (n, 3) along a line that they make.

    None if they make none: somewhere along it they leave a gap of more than `LARGEST_GAP_STEPS` steps of the scan's grid.
    """
    point, along = line
    position = np.sort((points - point) @ along)
    if position.size < 2 or np.diff(position).max() > LARGEST_GAP_STEPS * step_rad_s:
        return None
    return float(position[0]), float(position[-1])


def draw_published_lines(axes: Any, case: Case) -> None:
    """Draw the published lines in rate space, dashed, from one face of the scan range to another, each with its name at its end."""
    for k, line in enumerate(published_lines(case), 1):
        ends = line_in_scan_range(case, line)
        label = "the paper's lines" if k == 1 else None
        axes.plot(*ends.T, "--", lw=1.1, color="#000000", label=label, zorder=3)
        axes.text(*ends[-1], f"L{k}", fontsize=9, zorder=5)


def near_minimum_figure(
    case: Case, near: NearMinimum, title: str, truth: np.ndarray | None = None
) -> Figure:
    """Draw near-minimum points in rate space with fitted (solid) and published (dashed) lines (paper, Fig. 9).

    A fitted line is drawn from the first to the last of its points, and only if they make a line (`line_stretch`).
    """
    figure = empty_figure(11, 5.6)
    points, lines = near.points, near.lines
    member = np.zeros(len(points), int) if lines is None else lines["member"].values
    step = float(np.diff(near.emd["omega_x"].values[:2])[0])
    for axes in rate_space_views(figure, case):
        colours = [COLOURS[m % 8] for m in member]
        axes.scatter(*points.T, s=5, c=colours, alpha=0.5, linewidths=0, zorder=1)
        for i, line in enumerate([] if lines is None else list_lines(lines)):
            stretch = line_stretch(points[member == i], line, step)
            if stretch is None:
                continue
            point, along = line
            ends = point + np.array(stretch)[:, None] * along
            label = f"fitted line, {int((member == i).sum())} motions"
            axes.plot(*ends.T, "-", lw=2.2, color=COLOURS[i % 8], label=label, zorder=2)
        draw_published_lines(axes, case)
        if truth is not None:
            label = "truth of the synthetic telemetry"
            axes.scatter(*truth, marker="*", s=150, color="#000000", label=label, zorder=4)
    figure.suptitle(title, fontsize=11)
    labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(*labels, fontsize=9, ncols=3, loc="outside lower center", frameon=False)
    return figure


def distributions_figure(z: np.ndarray, label: str, motions: dict[str, np.ndarray]) -> Figure:
    """Draw cumulative distributions of r_z that the EMD compares: of measured directions `z` (n), and of motions by name.

    A name that begins with "truth" gives a thin dotted line, as its curve lies on that of the measured directions.
    """
    figure = empty_figure(7, 4.2)
    axes, level = figure.subplots(), np.arange(1, len(z) + 1) / len(z)
    axes.step(np.sort(z), level, where="post", color=COLOURS[6], label=label)
    for k, (name, values) in enumerate(motions.items()):
        # pairs of curves nearly coincide: every second one is drawn in dashes over the first
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
