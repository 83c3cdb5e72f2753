"""The pictures of the study, in the paper's order: from which steps each is drawn, how, and what it shows."""

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
from sunspin.philae import descent, mechanics, metrics, published_lines, sun_directions, touchdown
from sunspin.philae.motions import speed_figure
from sunspin.philae.rebound import event_seconds
from sunspin.philae.study import Study


def _signals(s: Study, r: Any) -> Figure:
    shown = ("Truth", "Best fit", "Descent")
    runs = [(title, run) for title, run in r.items() if title in shown]
    return panel_signals_figure(s.case.telemetry, runs, s.case.vehicle)


def _figure_3(s: Study, _: Any) -> Figure:
    events = "separation unfolding_ends first_touchdown collision second_touchdown rest"
    at = {name: event_seconds(s.case, s.sun, name) for name in events.split()}
    first, last = s.sun["time"].values[[0, -1]]
    at = {name.replace("_", " "): t for name, t in at.items() if first - 600 <= t <= last}
    return telemetry.sun_directions_figure(s.sun, s.case.telemetry, at)


def _figure_5(_: Study, r: Any) -> Figure:
    curves = {
        "published fit, which gives the default friction": r.spin_down["record"],
        "rounded friction as printed": r.spin_down["printed"],
    }
    return motion.spin_down_figure(r.spin_down["t_s"], curves)


def _scan(s: Study, r: Any) -> Figure:
    target = f"target: this telemetry{' (synthetic)' * s.synthetic}"
    title = f"EMD < {r.near.factor:g} EMD_min, {target}"
    return metrics.near_minimum_figure(s.case, r.near, title, r.truth.get("omega_B"))


def _distributions(s: Study, r: Any) -> Figure:
    shown = {f"L{k} as published": z for k, z in enumerate(s.parts["published_lines"].pooled, 1)}
    if r.truth:
        shown["truth of the synthetic telemetry"] = r.truth["z"]
    about = "telemetry" + " (synthetic)" * s.synthetic
    return metrics.distributions_figure(r.rebound.z, about, shown)


def _lines_scan(s: Study, r: Any) -> Figure:
    title = f"EMD < {r.clean.factor:g} EMD_min, target: common distribution of the printed lines"
    return metrics.near_minimum_figure(s.case, r.clean, title)


PICTURES: dict[str, tuple[str, Callable[[Study, Any], Figure]]] = {
    "speed": ("speeds", lambda s, r: speed_figure(s.case, r, s.synthetic)),
    "signals": ("motions", _signals),
    "fig03_measured": ("phases", _figure_3),
    "fig04_phases": ("phases", lambda _, r: sun_directions.figure_4(r)),
    "fig05_spin_down": ("mechanics", _figure_5),
    "fig06_examples": ("mechanics", lambda _, r: mechanics.figure_6(r.examples)),
    "fig07_histograms": ("mechanics", lambda _, r: mechanics.figure_7(r.examples)),
    "fig08_maps": ("sensitivity", lambda _, r: metrics.maps_figure(r)),
    "growth": ("sensitivity", lambda _, r: metrics.growth_figure(r)),
    "fig09_telemetry": ("level_set published_lines", _scan),
    "distributions": ("level_set published_lines", _distributions),
    "fig10_11_descent": ("descent", lambda _, r: descent.draw(r)),
    "fig12_touchdown": ("touchdown", lambda s, r: touchdown.figure(r, s.synthetic)),
    "fig13_after_collision": ("collision", lambda _, r: sun_height_figure(r.runs["chosen"])),
    "collision": ("collision", lambda _, r: collision.collision_figure(r.known)),
    "strategies": ("strategies", lambda _, r: strategies.strategies_figure(r.table)),
    "fig09_lines": ("published_lines", _lines_scan),
    "fig12_lines": ("published_lines", lambda _, r: published_lines.touchdown_figure(r)),
    "fig13_lines": ("published_lines", lambda _, r: sun_height_figure(r.runs)),
    "health": ("phases", lambda _, r: sun_directions.draw(r)),
}
"""Name of the file -> steps of `study.STEPS`, the first the one whose result is drawn, and the figure of study and result."""

TEXTS = """
speed: Angular speed against time: the descent as a line, then a band of rates to the collision and another after it.
How fast Philae turned. Band: {r.attrs[about]}, slowest to fastest{meaning}. After the collision: 95 % of simulated \
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
The paper's recipe on this telemetry (paper, Fig. 9): {r.near.points.shape[0]} points, smallest EMD {r.smallest:.4f}; \
{r.lines_found} of the four printed lines (dashed) come out of them.{synthetic}

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
The Sun's height after the collision (paper, Fig. 13), {r.runs[chosen][off].sizes[run]} simulated collisions of {about}; each \
area is 1.{synthetic}

collision: Simulated collisions against the trajectory kernel's speeds.
The simulated collisions against what the trajectory kernel and the magnetometer say of them.{synthetic}

strategies: What touches first, antenna, speeds and the Sun's height for several commands to the wheel.
What other commands to the wheel would have done (paper, section 4), from the same draws of {about}.{synthetic}

fig09_lines: Near-minimum points in rate space along four lines.
No telemetry: near-minimum set against the printed lines' own distribution (paper, Fig. 9), {r.clean.points.shape[0]} points at \
{r.clean.factor:g} times the smallest EMD. The factor is ours: the paper's 1.1 would leave a handful of points, the minimum \
against so clean a target being {smallest:.4f}.

fig12_lines: Body rates at the first touchdown of motions on the printed lines.
No telemetry: rates at the first touchdown by running the printed lines, and the set above, backward (paper, Fig. 12).

fig13_lines: Densities of the z component after the collision for motions on the printed lines, wheel off and held.
No telemetry: the Sun's height after the collision (paper, Fig. 13), {r.runs[off].sizes[run]} simulated collisions of motions on \
the printed lines; each area is 1.

health: Lit panels sample by sample.
Which panels are lit, and which patterns the Sun alone cannot make (paper, section 4).{synthetic}
"""
"""Of each picture its name and what a reader who cannot see it is told; then its caption, with fields of the study `s`, of the
result `r` that is drawn, and of `_fields`."""


def _fields(s: Study, name: str, r: Any) -> dict[str, Any]:
    fields = {"r": r, "synthetic": synthetic_words(s.synthetic)}
    if s.chain is not None:
        bound = "every motion in the band fits and none is preferred, and the distribution of r_z bounds it from below only"
        meaning = {"scan": f"; {bound}", "published": "; this telemetry does not enter"}
        fields |= {"about": s.chain.chosen.about, "meaning": meaning.get(s.chain.name, "")}
    if name == "distributions":
        fields["spread"] = s.parts["published_lines"].spread
    if name == "fig09_lines":
        fields["smallest"] = float(r.clean.emd.min())
    return fields


def drawing(s: Study, name: str) -> Drawing | None:
    """A picture of the study; None where a step that it is drawn from was not computed."""
    steps, make = PICTURES[name]
    needed = steps.split()
    if not s.parts.keys() >= {*needed}:
        return None
    r = s.parts[needed[0]]
    text = next(text for text in TEXTS.split("\n\n") if text.strip().startswith(f"{name}: "))
    alt, caption = text.strip().removeprefix(f"{name}: ").split(".\n", 1)
    return Drawing(name, lambda: make(s, r), alt, caption.format_map(_fields(s, name, r)))


Drawn = dict[str, tuple[Drawing, dict[str, bytes]]]
"""Name of each picture -> what the report says of it, and its files by their suffix."""


def draw(study: Study, drawn: Drawn) -> None:
    """Add to `drawn` the pictures that can be drawn by now, while the other steps of the study go on."""
    for name in PICTURES:
        if name not in drawn and (sheet := drawing(study, name)):
            drawn[name] = sheet, figures.drawn(sheet.make())


def write(drawn: Drawn, folder: Path) -> list[Drawing]:
    """Write the pictures as PNG and SVG, in the paper's order."""
    names = [name for name in PICTURES if name in drawn]
    for name in names:
        figures.write(drawn[name][1], folder, name)
    return [drawn[name][0] for name in names]
