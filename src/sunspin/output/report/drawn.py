"""The figures that a folder's results have of their own (:mod:`sunspin.output.kinds`), drawn from the stored data for the page."""

from __future__ import annotations

from collections.abc import Iterator

from markupsafe import Markup

from sunspin.output.figures.inline import inline_svg
from sunspin.output.kinds import KINDS
from sunspin.output.kinds.kind import Beside, Drawing
from sunspin.output.kinds.outcomes import runs_drawings
from sunspin.output.kinds.scan import DIMS
from sunspin.output.report.read import Results
from sunspin.output.report.section import Drawn

HOLDS = {
    "rates": ("omega_B", "omega_cov_B", "pass_of", "weight"),
    "sun_directions": ("sun_B", "status", "status_text", "sigma_rad"),
    "strategies": ("value", "error", "gain"),
    "trajectory": ("omega_B", "momentum_B", "wheel_speed_rad_s"),
}
"""Kind of result -> variables by which it is recognised: a file may say of itself what it wants."""

FIRST = ("corner", "rates", "strategies", "sun-height", "scan", "trajectory", "sun")
"""Which figure stands on the first screen, by name."""


def drawings(results: Results, *kinds: str) -> Iterator[Drawing]:
    """The figures of the results of these kinds in the folder."""
    beside = Beside(results.data.get("telemetry"), results.vehicle)
    for kind in kinds:
        if kind == "posterior":
            tree = results.tree("posterior")
            yield from () if tree is None else KINDS[kind].drawings(tree, beside)
        elif kind == "outcomes":
            runs = results.runs()
            yield from runs_drawings(runs) if runs else ()
        elif kind == "scan":
            found = [
                (data, metric)
                for metric in ("emd", "E")
                for _, data in results.having(metric, *DIMS)
            ]
            scan = next(
                (data for data, metric in found if set(data[metric].dims) == set(DIMS)), None
            )
            yield from () if scan is None else KINDS[kind].drawings(scan, beside)
        else:
            for name, data in results.having(*HOLDS[kind]):
                if not name.startswith("motion-"):
                    yield from KINDS[kind].drawings(data, beside)


def drawn(results: Results, *kinds: str) -> list[Drawn]:
    """The same as parts of the page; a figure that is on it already is not drawn again."""
    new = list(
        {
            one.name: one for one in drawings(results, *kinds) if one.name not in results.drawn
        }.values()
    )
    items = []
    for drawing in new:
        try:
            items.append(item(results, drawing))
        # data of any origin: tables without a figure are worth more than no section
        except Exception as error:
            why = f"{drawing.name} ({type(error).__name__}: {error})"
            results.problems.append(f"A figure could not be drawn: {why}.")
    return items


def first(results: Results, names: tuple[str, ...] = FIRST) -> Drawn | None:
    """The figure of the first screen."""
    found = {
        d.name: d
        for d in drawings(
            results,
            "posterior",
            "rates",
            "strategies",
            "outcomes",
            "scan",
            "trajectory",
            "sun_directions",
        )
    }
    name = next((name for name in names if name in found), None)
    return None if name is None else item(results, found[name])


def item(results: Results, drawing: Drawing) -> Drawn:
    """A figure as a part of the page."""
    svg = inline_svg(drawing.make(), f"s{len(results.drawn)}-")
    results.drawn.add(drawing.name)
    return Drawn(drawing.name, Markup(svg), drawing.alt, drawing.caption)
