"""Pictures of the study: the steps that each is drawn from, its function, its caption.

The pictures of the three acts come first, then the others in the paper's order.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

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


def _signals_figure(study: Study, result: Any) -> Figure:
    """Draw the powers of the panels in the true, the best and the descent's motion; `result` is that of `motions.compute`."""
    titles = ("Truth", "Best fit", "Descent")
    motions = [(title, motion) for title, motion in result.items() if title in titles]
    return panel_signals_figure(study.case.telemetry, motions, study.case.vehicle)


def _measured_figure(study: Study, _: Any) -> Figure:
    """Draw measured powers and Sun directions against time with the events of the landing (paper, Fig. 3)."""
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


def _spin_down_figure(_: Study, result: Any) -> Figure:
    """Draw the spin-down of the wheel with fitted and rounded friction (paper, Fig. 5)."""
    curves = {
        "published fit, which gives the default friction": result.spin_down["record"],
        "rounded friction as printed": result.spin_down["printed"],
    }
    return motion.spin_down_figure(result.spin_down["t_s"], curves)


def _scan_figure(study: Study, result: Any) -> Figure:
    """Draw the near-minimum set of the scan of the telemetry (paper, Fig. 9)."""
    target = f"target: this telemetry{' (synthetic)' * study.synthetic}"
    title = f"EMD < {result.near.factor:g} EMD_min, {target}"
    return metrics.near_minimum_figure(study.case, result.near, title, result.truth.get("omega_B"))


def _distributions_figure(study: Study, result: Any) -> Figure:
    """Draw the distributions of r_z of the telemetry, of the published lines and of the truth."""
    pooled = study.parts["published_lines"].pooled
    rz_by_name = {f"L{k} as published": z for k, z in enumerate(pooled, 1)}
    if result.truth:
        rz_by_name["truth of the synthetic telemetry"] = result.truth["z"]
    label = "telemetry" + " (synthetic)" * study.synthetic
    return metrics.distributions_figure(result.rebound.z, label, rz_by_name)


def _lines_scan_figure(study: Study, result: Any) -> Figure:
    """Draw the near-minimum set for the common distribution of the published lines (paper, Fig. 9)."""
    title = (
        f"EMD < {result.clean.factor:g} EMD_min, target: common distribution of the printed lines"
    )
    return metrics.near_minimum_figure(study.case, result.clean, title)


PICTURES: dict[str, tuple[str, Callable[[Study, Any], Figure]]] = {
    "fig09_telemetry": ("level_set published_lines", _scan_figure),
    "fig12_touchdown": (
        "touchdown",
        lambda study, result: touchdown.touchdown_figure(result, study.synthetic),
    ),
    "timing": (
        "timing level_set",
        lambda study, result: timing.posterior_figure(
            result, study.parts["level_set"].near, study.synthetic
        ),
    ),
    "timing_speed": (
        "timing candidates",
        lambda study, result: timing.speeds_figure(
            result, study.parts["candidates"].near_minimum.speed_touchdown, study.synthetic
        ),
    ),
    "speed": ("speeds", lambda study, result: speed_figure(study.case, result, study.synthetic)),
    "signals": ("motions", _signals_figure),
    "fig03_measured": ("phases", _measured_figure),
    "fig04_phases": ("phases", lambda _, result: sun_directions.directions_figure(result)),
    "fig05_spin_down": ("mechanics", _spin_down_figure),
    "fig06_examples": ("mechanics", lambda _, result: mechanics.sun_tracks_figure(result.examples)),
    "fig07_histograms": (
        "mechanics",
        lambda _, result: mechanics.rz_histograms_figure(result.examples),
    ),
    "fig08_maps": ("sensitivity", lambda _, result: metrics.maps_figure(result)),
    "growth": ("sensitivity", lambda _, result: metrics.growth_figure(result)),
    "distributions": ("level_set published_lines", _distributions_figure),
    "fig10_11_descent": ("descent", lambda _, result: descent.descent_figure(result)),
    "fig13_after_collision": (
        "collision",
        lambda _, result: sun_height_figure(result.runs["chosen"]),
    ),
    "collision": ("collision", lambda _, result: collision.collision_figure(result.weighted)),
    "strategies": ("strategies", lambda _, result: strategies.strategies_figure(result.table)),
    "fig09_lines": ("published_lines", _lines_scan_figure),
    "fig12_lines": (
        "published_lines",
        lambda _, result: published_lines.lines_touchdown_figure(result),
    ),
    "fig13_lines": ("published_lines", lambda _, result: sun_height_figure(result.runs)),
    "health": ("phases", lambda _, result: sun_directions.lit_panels_figure(result)),
}
"""File name of each picture -> the steps of `study.STEPS` that it is drawn from, and a function of study and result that draws it.
The result is that of the first step.
"""

TEXTS = """
speed: Angular speed against time: the descent as a line, then a band of rates to the collision and another after it.
How fast Philae turned. Band: {result.attrs[about]}, slowest to fastest{meaning}. After the collision: 95 % of simulated \
collisions of the same motions. Diamonds: the magnetometer, which was not used.{synthetic}

signals: Power of each panel against time in two motions: samples as dots, the motion's prediction as a line.
Panel powers: dots are samples, lines the prediction of a motion in the first 15 minutes after the touchdown, with one common \
factor. Motions that fit share how often the Sun stands at each height, not when: only one can meet the dots one by one.{synthetic}

fig03_measured: Panel powers, components of the Sun direction and Delta against time.
Panel powers and reconstructed directions, events of Table 1 (paper, Fig. 3). Grey marks below: samples that give no direction, \
by reason.{synthetic}

fig04_phases: Sun directions on the unit sphere in four phases.
Directions in each phase (paper, Fig. 4). Orange: best fits to sets of lit panels that the Sun alone cannot light.{synthetic}

fig05_spin_down: Wheel speed falling to zero.
Spin-down of the wheel (paper, Fig. 5), drawn from the published coefficients.

fig06_examples: Tracks of the Sun on the sphere and its components against time for three initial rates.
Simulated tracks of the Sun in body axes (paper, Fig. 6).

fig07_histograms: Three histograms of the Sun's z component.
Distribution of the z component in those simulations (paper, Fig. 7).

fig08_maps: Two maps of E with many slanted valleys.
E over initial rates and over parameters (paper, Fig. 8), with the direction at the start as the paper quotes it.{synthetic}

growth: Growth of direction errors with the window; E and EMD under changes of one percent.
Why a direct fit fails: errors grow with the window, and a change of 1 % changes E much and EMD hardly. Simulated motions only.

fig09_telemetry: Near-minimum points in rate space for the telemetry.
The paper's recipe on this telemetry (paper, Fig. 9): {result.near.points.shape[0]} points, smallest EMD {result.smallest:.4f}; \
{result.lines_recovered} of the four printed lines (dashed) come out of them.{synthetic}

distributions: Cumulative distributions of the z component.
z components of the telemetry's directions, and motions begun on the printed lines: these four are nearly one distribution (EMD \
to their mean at most {spread:.4f}), which is why a line cannot be narrowed to a point.{synthetic}

fig10_11_descent: The telemetry's directions and the fitted ones, E against the rate.
The descent: directions of the telemetry and fitted ones (paper, Fig. 10), E against the rate (Fig. 11), here over all aliases \
of the sampling too.{synthetic}

fig12_touchdown: Angular speed after the first touchdown and the angles of the momentum, over the candidates and the scanned box.
What this telemetry leaves (paper, Fig. 12): angular speed just after the touchdown, and the two angles that the distribution of \
r_z determines, over {about}; grey: all that was possible.{synthetic}

fig13_after_collision: Densities of the z component between collision and second touchdown, wheel off and held.
The Sun's height after the collision (paper, Fig. 13), {result.runs[chosen][off].sizes[run]} simulated collisions of {about}; \
each area is 1.{synthetic}

collision: Simulated collisions against the trajectory kernel's speeds.
The simulated collisions against what the trajectory kernel and the magnetometer say of them.{synthetic}

strategies: What touches first, antenna, speeds and the Sun's height for several commands to the wheel.
What other commands to the wheel would have done (paper, section 4), from the same draws of {about}.{synthetic}

fig09_lines: Near-minimum points in rate space along four lines.
No telemetry: near-minimum set against the printed lines' own distribution (paper, Fig. 9), {result.clean.points.shape[0]} points \
at {result.clean.factor:g} times the smallest EMD. The factor is ours: the paper's 1.1 would leave a handful of points, the \
minimum against so clean a target being {smallest:.4f}.

fig12_lines: Body rates at the first touchdown of motions on the printed lines.
No telemetry: rates at the first touchdown by running the printed lines, and the set above, backward (paper, Fig. 12).

fig13_lines: Densities of the z component after the collision for motions on the printed lines, wheel off and held.
No telemetry: the Sun's height after the collision (paper, Fig. 13), {result.runs[off].sizes[run]} simulated collisions of motions \
on the printed lines; each area is 1.

timing: Draws of the posterior in rate space at one place of the four published lines.
Past the paper: the posterior of the same samples, which uses their order and times, in the space of initial rates. Grey: the \
motions of the paper's recipe, which uses neither.{synthetic}

timing_speed: Angular speed just after the touchdown, up to the collision, and after it.
Past the paper: what the posterior predicts. After the collision the leg that hits and the direction of the impact are not known; \
simulated as in section 3.3 of the paper, wheel off.{synthetic}

health: Lit panels sample by sample.
Which panels are lit, and which patterns the Sun alone cannot make (paper, section 4).{synthetic}
"""
"""For each picture its file name with a description for readers who cannot see it, then its caption. A caption has fields of the
`result` that is drawn and of `_caption_fields`.
"""


def _caption_fields(study: Study, name: str, result: Any) -> dict[str, Any]:
    """Return the values for the fields of the caption of picture `name`; `result` is what it is drawn from."""
    fields = {"result": result, "synthetic": synthetic_words(study.synthetic)}
    if (candidate_sets := study.candidate_sets) is not None:
        bound = "every motion in the band fits and none is preferred, and the distribution of r_z bounds it from below only"
        meaning = {"scan": f"; {bound}", "published": "; this telemetry does not enter"}
        fields |= {
            "about": candidate_sets.chosen.about,
            "meaning": meaning.get(candidate_sets.source, ""),
        }
    if name == "distributions":
        fields["spread"] = study.parts["published_lines"].spread
    if name == "fig09_lines":
        fields["smallest"] = float(result.clean.emd.min())
    return fields


def make_drawing(study: Study, name: str) -> Drawing | None:
    """Return a picture of the study with its texts; None if a step that it is drawn from was not computed."""
    steps, make = PICTURES[name]
    needed = steps.split()
    if not study.parts.keys() >= {*needed}:
        return None
    result = study.parts[needed[0]]
    # a text begins with the file name; its first line, up to the period, describes the picture for those who cannot see it
    text = next(text for text in TEXTS.split("\n\n") if text.strip().startswith(f"{name}: "))
    alt, caption = text.strip().removeprefix(f"{name}: ").split(".\n", 1)
    return Drawing(
        name,
        lambda: make(study, result),
        alt,
        caption.format_map(_caption_fields(study, name, result)),
    )


Drawn = dict[str, tuple[Drawing, dict[str, bytes]]]
"""File name of each picture -> its texts for the report, and the content of its files by suffix."""


def draw_pictures(study: Study, drawn: Drawn) -> None:
    """Add to `drawn` the pictures that can be drawn now, while other steps of the study run."""
    for name in PICTURES:
        if name not in drawn and (drawing := make_drawing(study, name)):
            drawn[name] = drawing, figures.render(drawing.make())


def write_pictures(drawn: Drawn, folder: Path) -> list[Drawing]:
    """Write the pictures as PNG and SVG, and return their texts in the paper's order."""
    names = [name for name in PICTURES if name in drawn]
    for name in names:
        figures.write_files(drawn[name][1], folder, name)
    return [drawn[name][0] for name in names]
