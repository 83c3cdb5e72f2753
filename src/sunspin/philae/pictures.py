"""Pictures of the study: each with its file name, the function that draws it, and its texts.

The pictures of the three acts come first, then the others in the paper's order. A picture is left out until the results that it
shows have been computed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from sunspin.output import figures
from sunspin.output.figures.panel_signals import panel_signals_figure
from sunspin.output.kind import Drawing, synthetic_words
from sunspin.output.kinds import collision, motion, strategies, telemetry
from sunspin.output.kinds.outcomes import sun_height_figure
from sunspin.philae import (
    descent,
    mechanics,
    metrics,
    published_lines,
    sun_directions,
    timing,
    touchdown,
)
from sunspin.philae.motions import speed_figure
from sunspin.philae.rebound import event_seconds
from sunspin.philae.study import Study

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Drawn = dict[str, dict[str, bytes]]
"""File name of each picture that was drawn -> the content of its files by suffix."""


def draw_pictures(study: Study, drawn: Drawn) -> None:
    """Add to `drawn` the pictures that can be drawn now, while other steps of the study run."""
    for drawing in list_drawings(study):
        if drawing.name not in drawn:
            drawn[drawing.name] = figures.render(drawing.make())


def write_pictures(study: Study, drawn: Drawn, folder: Path) -> list[Drawing]:
    """Write the pictures that were drawn as PNG and SVG, and return them with their texts in the order of the page."""
    drawings = [drawing for drawing in list_drawings(study) if drawing.name in drawn]
    for drawing in drawings:
        figures.write_files(drawn[drawing.name], folder, drawing.name)
    return drawings


def list_drawings(study: Study) -> Iterator[Drawing]:
    """Yield the pictures of the results that have been computed, in the order of the page."""
    synthetic = synthetic_words(study.synthetic)
    yield from _drawings_of_acts(study, synthetic)
    yield from _drawings_of_figures_3_to_8(study, synthetic)
    yield from _drawings_of_telemetry(study, synthetic)
    yield from _drawings_of_published_lines(study)
    if (phases := study.phases.result) is not None:
        yield Drawing(
            "health",
            lambda: sun_directions.lit_panels_figure(phases),
            "Lit panels sample by sample",
            f"Which panels are lit, and which patterns the Sun alone cannot make (paper, section 4).{synthetic}",
        )


def _drawings_of_acts(study: Study, synthetic: str) -> Iterator[Drawing]:
    """Yield the pictures of the study's three acts (Figs. 9 and 12 of the paper, and the posterior), and of single motions."""
    scan, candidate_sets, timed = study.scan.result, study.touchdown.result, study.timing.result
    if scan is not None and study.published_lines.result is not None:
        target = f"target: this telemetry{' (synthetic)' * study.synthetic}"
        title = f"EMD < {scan.near.factor:g} EMD_min, {target}"
        truth = scan.truth.get("omega_B")
        yield Drawing(
            "fig09_telemetry",
            lambda: metrics.near_minimum_figure(study.case, scan.near, title, truth),
            "Near-minimum points in rate space for the telemetry",
            f"The paper's recipe on this telemetry (paper, Fig. 9): {len(scan.near.points)} points, smallest EMD "
            f"{scan.smallest:.4f}; {scan.lines_recovered} of the four printed lines (dashed) come out of them.{synthetic}",
        )
    if candidate_sets is not None:
        yield Drawing(
            "fig12_touchdown",
            lambda: touchdown.touchdown_figure(candidate_sets, study.synthetic),
            "Angular speed after the first touchdown and the angles of the momentum, over the candidates and the scanned box",
            "What this telemetry leaves (paper, Fig. 12): angular speed just after the touchdown, and the two angles that the "
            f"distribution of r_z determines, over {candidate_sets.chosen.about}; grey: all that was possible.{synthetic}",
        )
    if scan is not None and timed is not None:
        yield Drawing(
            "timing",
            lambda: timing.posterior_figure(timed, scan.near, study.synthetic),
            "Draws of the posterior in rate space at one place of the four published lines",
            "Past the paper: the posterior of the same samples, which uses their order and times, in the space of initial rates. "
            f"Grey: the motions of the paper's recipe, which uses neither.{synthetic}",
        )
    if candidate_sets is not None and timed is not None:
        near_minimum = candidate_sets.near_minimum.speed_touchdown
        yield Drawing(
            "timing_speed",
            lambda: timing.speeds_figure(timed, near_minimum, study.synthetic),
            "Angular speed just after the touchdown, up to the collision, and after it",
            "Past the paper: what the posterior predicts. After the collision the leg that hits and the direction of the impact "
            f"are not known; simulated as in section 3.3 of the paper, wheel off.{synthetic}",
        )
    if (speeds := study.speeds.result) is not None:
        meaning = {
            "scan": "; every motion in the band fits and none is preferred, and the distribution of r_z bounds it from below only",
            "published": "; this telemetry does not enter",
        }.get(speeds.attrs["chain"], "")
        yield Drawing(
            "speed",
            lambda: speed_figure(study.case, speeds, study.synthetic),
            "Angular speed against time: the descent as a line, then a band of rates to the collision and another after it",
            f"How fast Philae turned. Band: {speeds.attrs['about']}, slowest to fastest{meaning}. After the collision: 95 % of "
            f"simulated collisions of the same motions. Diamonds: the magnetometer, which was not used.{synthetic}",
        )
    if (motions := study.motions.result) is not None:
        titles = ("Truth", "Smallest EMD", "Descent")
        shown = [(title, motion) for title, motion in motions.items() if title in titles]
        yield Drawing(
            "signals",
            lambda: panel_signals_figure(study.case.telemetry, shown, study.case.vehicle),
            "Power of each panel against time in two motions: samples as dots, the motion's prediction as a line",
            "Panel powers: dots are samples, lines the prediction of a motion in the first 15 minutes after the touchdown, with "
            "one common factor. Motions that fit share how often the Sun stands at each height, not when: only one can meet the "
            f"dots one by one.{synthetic}",
        )


def _measured_figure(study: Study) -> Figure:
    """Draw measured powers and Sun directions against time with the events of the landing."""
    names = "separation unfolding_ends first_touchdown collision second_touchdown rest".split()
    event_s = {name: event_seconds(study.case, study.sun, name) for name in names}
    # events during the samples, or up to ten minutes before: the separation precedes the first sample
    first_s, last_s = study.sun["time"].values[[0, -1]]
    events = {
        name.replace("_", " "): t_s
        for name, t_s in event_s.items()
        if first_s - 600 <= t_s <= last_s
    }
    return telemetry.sun_directions_figure(study.sun, study.case.telemetry, events)


def _drawings_of_figures_3_to_8(study: Study, synthetic: str) -> Iterator[Drawing]:
    """Yield the pictures of the Sun directions, the wheel, the example motions and the maps of E."""
    if (phases := study.phases.result) is not None:
        yield Drawing(
            "fig03_measured",
            lambda: _measured_figure(study),
            "Panel powers, components of the Sun direction and Delta against time",
            "Panel powers and reconstructed directions, events of Table 1 (paper, Fig. 3). Grey marks below: samples that give no "
            f"direction, by reason.{synthetic}",
        )
        yield Drawing(
            "fig04_phases",
            lambda: sun_directions.directions_figure(phases),
            "Sun directions on the unit sphere in four phases",
            "Directions in each phase (paper, Fig. 4). Orange: best fits to sets of lit panels that the Sun alone cannot light."
            f"{synthetic}",
        )
    if (examples := study.mechanics.result) is not None:
        spin_down = examples.spin_down
        curves = {
            "published fit, which gives the default friction": spin_down["record"],
            "rounded friction as printed": spin_down["printed"],
        }
        yield Drawing(
            "fig05_spin_down",
            lambda: motion.spin_down_figure(spin_down["t_s"], curves),
            "Wheel speed falling to zero",
            "Spin-down of the wheel (paper, Fig. 5), drawn from the published coefficients.",
        )
        yield Drawing(
            "fig06_examples",
            lambda: mechanics.sun_tracks_figure(examples.examples),
            "Tracks of the Sun on the sphere and its components against time for three initial rates",
            "Simulated tracks of the Sun in body axes (paper, Fig. 6).",
        )
        yield Drawing(
            "fig07_histograms",
            lambda: mechanics.rz_histograms_figure(examples.examples),
            "Three histograms of the Sun's z component",
            "Distribution of the z component in those simulations (paper, Fig. 7).",
        )
    if (sensitivity := study.sensitivity.result) is not None:
        yield Drawing(
            "fig08_maps",
            lambda: metrics.maps_figure(sensitivity),
            "Two maps of E with many slanted valleys",
            "E over initial rates and over parameters (paper, Fig. 8), with the direction at the start as the paper quotes it."
            f"{synthetic}",
        )
        yield Drawing(
            "growth",
            lambda: metrics.growth_figure(sensitivity),
            "Growth of direction errors with the window; E and EMD under changes of one percent",
            "Why a direct fit fails: errors grow with the window, and a change of 1 % changes E much and EMD hardly. Simulated "
            "motions only.",
        )


def _drawings_of_telemetry(study: Study, synthetic: str) -> Iterator[Drawing]:
    """Yield the other pictures of what follows from the telemetry (paper, Figs. 10, 11 and 13, and section 4)."""
    scan, lines, spin = study.scan.result, study.published_lines.result, study.descent.result
    if scan is not None and lines is not None:
        rz_by_name = {f"L{k} as published": z for k, z in enumerate(lines.pooled, 1)}
        if scan.truth:
            rz_by_name["truth of the synthetic telemetry"] = scan.truth["z"]
        label = "telemetry" + " (synthetic)" * study.synthetic
        yield Drawing(
            "distributions",
            lambda: metrics.distributions_figure(scan.rebound.z, label, rz_by_name),
            "Cumulative distributions of the z component",
            "z components of the telemetry's directions, and motions begun on the printed lines: these four are nearly one "
            f"distribution (EMD to their mean at most {lines.spread:.4f}), which is why a line cannot be narrowed to a point."
            f"{synthetic}",
        )
    if spin is not None:
        yield Drawing(
            "fig10_11_descent",
            lambda: descent.descent_figure(spin),
            "The telemetry's directions and the fitted ones, E against the rate",
            "The descent: directions of the telemetry and fitted ones (paper, Fig. 10), E against the rate (Fig. 11), here over "
            f"all aliases of the sampling too.{synthetic}",
        )
    if (collisions := study.collision.result) is not None:
        runs, about = collisions.runs["chosen"], collisions.candidate_sets.chosen.about
        yield Drawing(
            "fig13_after_collision",
            lambda: sun_height_figure(runs),
            "Densities of the z component between collision and second touchdown, wheel off and held",
            f"The Sun's height after the collision (paper, Fig. 13), {runs['off'].sizes['run']} simulated collisions of {about}; "
            f"each area is 1.{synthetic}",
        )
        yield Drawing(
            "collision",
            lambda: collision.collision_figure(collisions.weighted),
            "Simulated collisions against the trajectory kernel's speeds",
            f"The simulated collisions against what the trajectory kernel and the magnetometer say of them.{synthetic}",
        )
    if (by_strategy := study.strategies.result) is not None:
        yield Drawing(
            "strategies",
            lambda: strategies.strategies_figure(by_strategy.table),
            "What touches first, antenna, speeds and the Sun's height for several commands to the wheel",
            "What other commands to the wheel would have done (paper, section 4), from the same draws of "
            f"{by_strategy.candidate_sets.chosen.about}.{synthetic}",
        )


def _drawings_of_published_lines(study: Study) -> Iterator[Drawing]:
    """Yield the pictures that follow from the published lines without telemetry (paper, Figs. 9, 12 and 13)."""
    if (lines := study.published_lines.result) is None:
        return
    near, least = lines.clean, float(lines.clean.emd.min())
    title = f"EMD < {near.factor:g} EMD_min, target: common distribution of the printed lines"
    yield Drawing(
        "fig09_lines",
        lambda: metrics.near_minimum_figure(study.case, near, title),
        "Near-minimum points in rate space along four lines",
        "No telemetry: near-minimum set against the printed lines' own distribution (paper, Fig. 9), "
        f"{len(near.points)} points at {near.factor:g} times the smallest EMD. The factor is ours: the paper's 1.1 would leave a "
        f"handful of points, the minimum against so clean a target being {least:.4f}.",
    )
    yield Drawing(
        "fig12_lines",
        lambda: published_lines.lines_touchdown_figure(lines),
        "Body rates at the first touchdown of motions on the printed lines",
        "No telemetry: rates at the first touchdown by running the printed lines, and the set above, backward (paper, Fig. 12).",
    )
    yield Drawing(
        "fig13_lines",
        lambda: sun_height_figure(lines.runs),
        "Densities of the z component after the collision for motions on the printed lines, wheel off and held",
        f"No telemetry: the Sun's height after the collision (paper, Fig. 13), {lines.runs['off'].sizes['run']} simulated "
        "collisions of motions on the printed lines; each area is 1.",
    )
