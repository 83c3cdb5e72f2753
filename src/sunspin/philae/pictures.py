"""The figures of the study, in the paper's order: which part each belongs to, how it is drawn, what it shows."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from sunspin.output import figures
from sunspin.output.figures.panel_signals import panel_signals_figure
from sunspin.output.kind import Drawing, synthetic_words
from sunspin.output.kinds import collision, motion, outcomes, strategies, telemetry
from sunspin.philae import descent as figures_descent
from sunspin.philae import metrics, published_lines, touchdown
from sunspin.philae import precession as figures_precession
from sunspin.philae import rebound as rb
from sunspin.philae import sun_directions as figures_health
from sunspin.philae.candidates import Chain
from sunspin.philae.collision import AfterCollision
from sunspin.philae.figures import directions as figures_directions
from sunspin.philae.metrics import TelemetryScan
from sunspin.philae.motions import Motions, speed_figure
from sunspin.philae.published_lines import PublishedLines
from sunspin.philae.strategies import Strategies
from sunspin.philae.study import Reproduction

Sheets = Callable[[Reproduction, Any], Iterator[Drawing]]


class Gallery:
    """The figures, drawn by a thread of its own as soon as their parts are there, and written at the end.

    Drawing holds Python's lock, which the kernels of the other parts hardly need.
    """

    def __init__(self) -> None:
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="figures")
        self._sheets: dict[int, Future] = {}

    def __enter__(self) -> Gallery:
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.shutdown(wait=False, cancel_futures=True)

    def begin(self, result: Reproduction) -> None:
        """Draw what can be drawn by now."""
        for k, (parts, sheets) in enumerate(SHEETS):
            if k not in self._sheets and result.parts.keys() >= {*parts}:
                self._sheets[k] = self._pool.submit(_drawn, sheets, result, parts[0])

    def write(self, result: Reproduction, folder: Path) -> list[Drawing]:
        """Write all figures of the parts that were computed, as PNG and SVG."""
        self.begin(result)
        sheets = [sheet for k in sorted(self._sheets) for sheet in self._sheets[k].result()]
        for drawing, files in sheets:
            figures.write(files, folder, drawing.name)
        return [drawing for drawing, _ in sheets]


def _drawn(
    sheets: Sheets, result: Reproduction, part: str
) -> list[tuple[Drawing, dict[str, bytes]]]:
    return [(sheet, figures.drawn(sheet.make())) for sheet in sheets(result, result.parts[part])]


def _note(result: Reproduction) -> str:
    return synthetic_words(result.synthetic)


def _motions(result: Reproduction, part: Motions) -> Iterator[Drawing]:
    chain = str(part.speed.attrs["chain"])
    meaning = {
        "scan": "; every motion in the band fits and none is preferred, and the distribution of r_z bounds it from below only",
        "published": "; this telemetry does not enter",
    }.get(chain, "")
    yield Drawing(
        "speed",
        lambda: speed_figure(result.case, part.speed, result.synthetic),
        "Angular speed against time: the descent as a line, then a band of rates to the collision and another after it",
        f"How fast Philae turned. Band: {part.speed.attrs['about_candidates']}, slowest to fastest{meaning}. Dashed: "
        f"{part.speed.attrs['about_recipe']}; it has no stated confidence. After the collision: 95 % of simulated collisions of "
        "the same motions. Diamonds: the magnetometer, which was not used." + _note(result),
    )
    runs = [(title, run) for title, run in part.candidates.items() if title in SHOWN_MOTIONS]
    yield Drawing(
        "signals",
        lambda: panel_signals_figure(result.case.telemetry, runs, result.case.vehicle),
        "Power of each panel against time in two motions: samples as dots, the motion's prediction as a line",
        "Panel powers: dots are samples, lines the prediction of a motion in the first 15 minutes after the touchdown, with one "
        "common factor. Motions that fit share how often the Sun stands at each height, not when: only one can meet the dots "
        "one by one." + _note(result),
    )


SHOWN_MOTIONS = ("Truth", "Best fit", "Descent")
"""Motions whose panel powers are drawn."""


def _measured(result: Reproduction, _: Any) -> Iterator[Drawing]:
    note = _note(result)
    yield Drawing(
        "fig03_measured",
        lambda: telemetry.sun_directions_figure(result.sun, result.case.telemetry, _events(result)),
        "Panel powers, components of the Sun direction and Delta against time",
        "Panel powers and reconstructed directions, events of Table 1 (paper, Fig. 3). Grey marks below: samples that give no "
        "direction, by reason." + note,
    )
    yield Drawing(
        "fig04_phases",
        lambda: figures_directions.descent_and_rebound_figure(
            _phases(result.sun), result.synthetic
        ),
        "Sun directions on the unit sphere in four phases",
        "Directions in each phase (paper, Fig. 4). Orange: "
        "best fits to sets of lit panels that the Sun alone cannot light." + note,
    )


def _events(result: Reproduction) -> dict[str, float]:
    """The events that are drawn, those that lie within the telemetry."""
    last = float(result.sun["time"].values[-1])
    shown = (
        "separation",
        "unfolding_ends",
        "first_touchdown",
        "collision",
        "second_touchdown",
        "rest",
    )
    at = {name.replace("_", " "): rb.case_seconds(result.case, result.sun, name) for name in shown}
    first = float(result.sun["time"].values[0])
    return {name: second for name, second in at.items() if first - 600 <= second <= last}


def _mechanics(_: Reproduction, part: Any) -> Iterator[Drawing]:
    fall = part.spin_down
    curves = {
        "published fit, which gives the default friction": fall["record"],
        "rounded friction as printed": fall["printed"],
    }
    yield Drawing(
        "fig05_spin_down",
        lambda: motion.spin_down_figure(fall["t_s"], curves),
        "Wheel speed falling to zero",
        "Spin-down of the wheel (paper, Fig. 5), drawn from the published coefficients.",
    )
    yield Drawing(
        "fig06_examples",
        lambda: figures_directions.examples_figure(part.examples),
        "Tracks of the Sun on the sphere and its components against time for three initial rates",
        "Simulated tracks of the Sun in body axes (paper, Fig. 6).",
    )
    yield Drawing(
        "fig07_histograms",
        lambda: figures_directions.histograms_figure(part.examples),
        "Three histograms of the Sun's z component",
        "Distribution of the z component in those simulations (paper, Fig. 7).",
    )


def _sensitivity(result: Reproduction, part: Any) -> Iterator[Drawing]:
    yield Drawing(
        "fig08_maps",
        lambda: metrics.maps_figure(part),
        "Two maps of E with many slanted valleys",
        "E over initial rates and over parameters (paper, Fig. 8), with the direction at the start as the paper quotes it."
        + _note(result),
    )
    yield Drawing(
        "growth",
        lambda: metrics.growth_figure(part),
        "Growth of direction errors, valleys of E in three windows, E and EMD under changes of one percent, width of the valley",
        "Why a direct fit fails: errors grow with the window, the valley of E narrows below the scan's step, EMD hardly moves. "
        "Simulated motions only.",
    )


def _level_set(result: Reproduction, part: TelemetryScan) -> Iterator[Drawing]:
    note, near = _note(result), part.near
    synthetic = " (synthetic)" if result.synthetic else ""
    yield Drawing(
        "fig09_telemetry",
        lambda: metrics.near_minimum_figure(
            result.case,
            near,
            f"EMD < {near.factor:g} EMD_min, target: this telemetry{synthetic}",
            part.truth.get("omega_B"),
        ),
        "Near-minimum points in rate space for the telemetry",
        f"The paper's recipe on this telemetry (paper, Fig. 9): {len(near.points)} points, smallest EMD {part.smallest:.4f}; "
        f"{part.lines_found} of the four printed lines (dashed) come out of them." + note,
    )
    lines: PublishedLines = result.parts["published_lines"]
    shown = {f"L{k + 1} as published": z for k, z in enumerate(lines.pooled)}
    if part.truth:
        shown["truth of the synthetic telemetry"] = part.truth["z"]
    yield Drawing(
        "distributions",
        lambda: metrics.distributions_figure(part.rebound.z, f"telemetry{synthetic}", shown),
        "Cumulative distributions of the z component",
        "z components of the telemetry's directions, and motions begun on the printed lines: these four are nearly one "
        "distribution (EMD to "
        f"their mean at most {lines.spread:.4f}), which is why a line cannot be narrowed to a point."
        + note,
    )


def _published_lines(_: Reproduction, part: PublishedLines) -> Iterator[Drawing]:
    clean = part.clean
    yield Drawing(
        "fig09_lines",
        lambda: metrics.near_minimum_figure(
            part.case,
            clean,
            f"EMD < {clean.factor:g} EMD_min, target: common distribution of the printed lines",
        ),
        "Near-minimum points in rate space along four lines",
        f"No telemetry: near-minimum set against the printed lines' own distribution (paper, Fig. 9), {len(clean.points)} "
        f"points at {clean.factor:g} times the smallest EMD. The factor is ours: the paper's 1.1 would leave a handful of "
        f"points, the minimum against so clean a target being {float(clean.emd.min()):.4f}.",
    )
    yield Drawing(
        "thresholds",
        lambda: published_lines.thresholds_figure(part),
        "Size of the near-minimum set and distance of its lines against the factor",
        "What the factor does: points in the set, and how far its four lines are from the printed ones. Dashed: the factor "
        "used above. Fewer points than four lines need have no line.",
    )
    yield Drawing(
        "fig12_lines",
        lambda: published_lines.touchdown_figure(part),
        "Body rates at the first touchdown of motions on the printed lines",
        "No telemetry: rates at the first touchdown by running the printed lines, and the set above, backward (paper, Fig. 12).",
    )
    yield Drawing(
        "fig13_lines",
        lambda: outcomes.sun_height_figure(part.runs),
        "Densities of the z component after the collision for motions on the printed lines, wheel off and held",
        f"No telemetry: the Sun's height after the collision (paper, Fig. 13), {part.runs['off'].sizes['run']} simulated "
        "collisions of motions on the printed lines; each area is 1.",
    )


def _descent(result: Reproduction, part: Any) -> Iterator[Drawing]:
    yield Drawing(
        "fig10_11_descent",
        lambda: figures_descent.draw(part),
        "The telemetry's directions and the fitted ones, the fitted rate, E against the rate",
        "The descent: directions of the telemetry and fitted ones (paper, Fig. 10), E against the rate (Fig. 11), here over all "
        "aliases of the sampling too." + _note(result),
    )


def _precession(_: Reproduction, part: Any) -> Iterator[Drawing]:
    yield Drawing(
        "precession",
        lambda: figures_precession.draw(part),
        "Height of the Sun, nutation angle and swing of the z axis along the four published lines",
        "What section 3.2 says of the amplitude of precession: the Sun's height ranges as published, the z axis swings further "
        "than that on L1 and L2.",
    )


def _touchdown(result: Reproduction, part: Chain) -> Iterator[Drawing]:
    yield Drawing(
        "fig12_touchdown",
        lambda: touchdown.figure(part, result.synthetic),
        "Angular speed after the first touchdown and the angles of the momentum, over the candidates and the scanned box",
        "What this telemetry leaves (paper, Fig. 12): angular speed just after the touchdown, and the two angles that the "
        f"distribution of r_z determines, over {part.chosen.about}; grey: all that was possible."
        + _note(result),
    )


def _of_telemetry(result: Reproduction) -> dict[str, int]:
    return {"synthetic": int(result.synthetic)}


def _collision(result: Reproduction, part: AfterCollision) -> Iterator[Drawing]:
    own = _of_telemetry(result)
    after = {name: runs.assign_attrs(own) for name, runs in part.runs["chosen"].items()}
    about = result.parts["candidates"].chosen.about
    yield Drawing(
        "fig13_after_collision",
        lambda: outcomes.sun_height_figure(after),
        "Densities of the z component between collision and second touchdown, wheel off and held",
        f"The Sun's height after the collision (paper, Fig. 13), {after['off'].sizes['run']} simulated collisions of {about}; "
        "each area is 1." + _note(result),
    )
    yield Drawing(
        "collision",
        lambda: collision.collision_figure(part.known.assign_attrs(own)),
        "Simulated collisions against the trajectory kernel's speeds",
        "The simulated collisions against what the trajectory kernel and the magnetometer say of them."
        + _note(result),
    )


def _strategies(result: Reproduction, part: Strategies) -> Iterator[Drawing]:
    about = result.parts["candidates"].chosen.about
    yield Drawing(
        "strategies",
        lambda: strategies.strategies_figure(part.table.assign_attrs(_of_telemetry(result))),
        "What touches first, antenna, speeds and the Sun's height for several commands to the wheel",
        f"What other commands to the wheel would have done (paper, section 4), from the same draws of {about}."
        + _note(result),
    )


def _health(result: Reproduction, part: Any) -> Iterator[Drawing]:
    yield Drawing(
        "health",
        lambda: figures_health.draw(part),
        "Lit panels sample by sample and the probability of forbidden patterns",
        "Which panels are lit, which patterns the Sun alone cannot make, and how improbable noise makes them (paper, section 4)."
        + _note(result),
    )


SHEETS: tuple[tuple[tuple[str, ...], Sheets], ...] = (
    (("motions",), _motions),
    (("phases",), _measured),
    (("mechanics",), _mechanics),
    (("sensitivity",), _sensitivity),
    (("level_set", "published_lines"), _level_set),
    (("descent",), _descent),
    (("precession",), _precession),
    (("touchdown",), _touchdown),
    (("collision",), _collision),
    (("strategies",), _strategies),
    (("published_lines",), _published_lines),
    (("phases",), _health),
)
"""Steps of `study.STEPS`, the first the one drawn, and its figures, in the paper's order."""


def _phases(sun: xr.Dataset) -> dict[str, xr.Dataset]:
    """The Sun samples by phase, in order of time."""
    if "phase" not in sun.coords:
        return {"all samples": sun}
    groups = {
        "descent": ["descent"],
        "first touchdown to collision": ["first_rebound"],
        "collision to second touchdown": ["second_rebound"],
        "after the second touchdown": ["settling", "rest"],
    }
    return {
        name: sun.isel(time=np.flatnonzero(np.isin(sun["phase"].values, parts)))
        for name, parts in groups.items()
    }
